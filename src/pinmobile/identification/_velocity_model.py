"""`VelocityModel` and `CarModel`: numbers of robots with velocity inputs that logs identify."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, bounded, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.identification._commands import (
    BLOCK,
    CAR_COMMANDS,
    CHANNELS,
    Lag,
    Part,
    Run,
    explained_parts,
    lead_of,
    runs_of,
    segments_of,
)
from pinmobile.identification._estimates import Identification, check_identifiable
from pinmobile.identification._estimator import solve_robustly
from pinmobile.identification._log import Log
from pinmobile.identification._planar_model import POSE
from pinmobile.identification._simulation import PhysicalNumbers, Segments, simulate_states
from pinmobile.identification._velocity_robot import (
    ABOVE_ZERO,
    THETA,
    VelocityCar,
    VelocityRobot,
    curvature_of,
    faster_of,
    rates_of,
    rolling_of,
)

_NOTE_SHARE = 0.8  # explained share of the motion below which a note follows
_NEUTRAL = {"theta_3": 0.0, "theta_4": 1.0, "theta_5": 0.0, "theta_6": 1.0}  # without losses and offset
_QUICKEST = 0.1  # shortest time constant that a log shows, as a share of its time step
_FINE = 0.3  # longest time step of the integrator, as a share of the shortest time constant
_BENDS = 4  # factor on the number of steps where a limit of acceleration may end within a step
_MOST_STEPS = 40  # largest number of steps per sample
_TOP = 100.0  # value of a limit that the log does not show, per first estimate
_GAINS = 0.1, 10.0  # range of the command per steady speed or yaw rate
_LONGEST, _STEERING_GAINS = (0.03, 10.0), (1e-4, 1e4)  # ranges of the wheelbase [m], and of gains
_AT_SPEED = "understeer", "cornering_drag"
_NEAR_DEGREES = 0.3  # relative difference of a gain from that of commands in degrees
_ZEROS = "steering_offset", *_AT_SPEED  # neutral numbers of a car
_STEERING = 4  # index of the wheelbase, or of the gain of the steering if the wheelbase is known


class ModelNumber(NamedTuple):
    """Number of a model: a `Quantity` with its prior value, its typical and its smallest size.

    The prior value of a limit is infinite; a typical size of NaN is that of the number.
    """

    name: str
    unit: str
    nonnegative: bool
    prior: float
    size: float = np.nan
    least: float = 1e-3
    path: str = ""


DELAY = ModelNumber("delay", "s", True, 0.0, 0.3, 0.1)
AHEAD = ModelNumber("ahead", "m", False, 0.0, 1.0, 0.1, path="ahead")
_LARGEST_SPEED = ModelNumber("largest_speed_command", "m/s", False, np.inf)


@dataclass(frozen=True, eq=False)
class VelocityModel(PhysicalNumbers):
    """Model of a robot with velocity inputs: theta and further numbers.

    Parameters
    ----------
    free : tuple of str
        Further estimated numbers: ``"delay"``, ``"ahead"``, and limits of accelerations and commands.
    fixed : mapping of str to float
        Values of the numbers that are not estimated [s, m, m/s^2, rad/s^2, m/s, rad/s].
    lead : int
        Largest delay [samples].
    dt : float
        Time step [s].
    is_pose : bool
        Whether poses are measured; otherwise speed and yaw rate are.
    longest : float
        Largest length of a segment [s].
    phase : float
        That of the commands of the first run, see `Run`.
    """

    free: tuple[str, ...]
    fixed: dict[str, float]
    lead: int
    dt: float
    is_pose: bool
    longest: float = np.inf
    phase: float = 0.0

    summary_size: ClassVar[int] = 6
    columns: ClassVar[slice] = slice(None)
    delay_index: ClassVar[int | None] = None
    is_linear: ClassVar[bool] = True
    inputs: ClassVar[Mapping[str, str]] = CHANNELS
    neutral: ClassVar[Mapping[str, float]] = _NEUTRAL
    first: ClassVar[tuple[ModelNumber, ...]] = tuple(
        ModelNumber(name, unit, True, _NEUTRAL.get(name, 0.3), np.nan, 1e-6, path=f"theta.{name}")
        if k in ABOVE_ZERO
        else ModelNumber(name, unit, False, 0.0, 1.0, 0.1, path=f"theta.{name}")
        for k, (name, unit) in enumerate(THETA.items())
    )
    limit_rows: ClassVar[tuple[ModelNumber, ...]] = (
        ModelNumber("acceleration", "m/s^2", False, np.inf, path="accelerations.acceleration"),
        ModelNumber("yaw_acceleration", "rad/s^2", False, np.inf, path="accelerations.yaw_acceleration"),
        _LARGEST_SPEED,
        ModelNumber("largest_yaw_rate_command", "rad/s", False, np.inf),
    )
    rate_limits: ClassVar[str] = "accelerations"  # field of the robot

    @classmethod
    def limits(cls) -> list[str]:
        """Return the names of the limits: of both rates, then of both commands."""
        return [item.name for item in cls.limit_rows]

    @cached_property
    def quantities(self) -> tuple[ModelNumber, ...]:
        """Estimated numbers."""
        others = {item.name: item for item in (DELAY, AHEAD, *self.limit_rows)}
        return (*self.first, *(others[name] for name in self.free))

    def drop(self, names: Sequence[str]) -> tuple[VelocityModel, list[int]]:
        """Return the model without some free numbers, and the indices of the others."""
        indices = [k for k, name in enumerate(self.free) if name not in names]
        rows = [*range(len(self.first)), *(len(self.first) + k for k in indices)]
        return replace(self, free=tuple(self.free[k] for k in indices)), rows

    @cached_property
    def _sizes(self) -> Array:
        return np.asarray([(item.prior, item.size, item.least) for item in self.quantities]).T

    @property
    def measured(self) -> tuple[tuple[str, str], ...]:
        """Names and units of the measurements."""
        return POSE if self.is_pose else tuple(CHANNELS.items())

    def sizes(self, p: Array) -> Array:
        """Return the typical sizes of numbers near p, shape (P,)."""
        return np.asarray(np.maximum(np.abs(p), self._sizes[2]))

    def natural(self, p: Array) -> tuple[Array, Array]:
        """Return the typical sizes of numbers near p, and their prior values, shape (P,) each."""
        first, given, _ = self._sizes
        return np.where(np.isnan(given), np.abs(p), given), np.where(np.isinf(first), _TOP * np.abs(p), first)

    def others(self, p: Array) -> dict[str, Array]:
        """Return delay, distance ahead of the axle and limits by name, shape (K,) each, for p (K, P)."""
        values = {name: np.full(len(p), value) for name, value in self.fixed.items()}
        return values | {name: p[:, len(self.first) + k] for k, name in enumerate(self.free)}

    def other_values(self, p: Array) -> dict[str, float]:
        """Return delay, distance ahead of the axle and limits by name, for numbers p (P,)."""
        return {name: float(x[0]) for name, x in self.others(p[None]).items()}

    def time_constants(self, p: Array) -> Array:
        """Return the time constants of both channels, shape (..., 2) [s]."""
        return np.asarray(p[..., :2] / p[..., [3, 5]])

    def is_possible(self, p: Array) -> bool:
        """Return whether the numbers p, shape (P,), are possible and the delay is within its range."""
        lag, quickest = self.others(p[None])["delay"][0] / self.dt, self.time_constants(p).min()
        is_possible = np.isfinite(p).all() and self.are_possible(p) and quickest > _QUICKEST * self.dt
        return bool(is_possible and -1 < lag <= self.lead)

    def are_possible(self, p: Array) -> Any:
        """Return which numbers, shape (..., P), a robot can have; delay and losses may be below zero."""
        is_positive = [(x.nonnegative and x.prior > 0) or np.isinf(x.prior) for x in self.quantities]
        return (p[..., np.array(is_positive)] > 0).all(axis=-1)

    def rate_numbers(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return the numbers of the rates, delays [samples] and the longest time step [s]."""
        others = self.others(p)
        columns = [p[:, : len(self.first)], others["ahead"], *(others[name] for name in self.limits())]
        numbers = np.column_stack(columns)[:, None]
        bends = _BENDS if np.isfinite(numbers[..., -4:-2]).any() else 1
        fastest = bends / self.time_constants(p.real).min()
        longest = self.dt / float(np.clip(self.dt * fastest / _FINE, 1, _MOST_STEPS))
        return numbers, others["delay"] / self.dt, longest

    def rates(self, z: Any, u: Any, numbers: Any) -> Any:
        """Return the rates of speed and yaw rate, and of x, y and psi if poses are measured."""
        given = np.minimum(np.maximum(u, -numbers[9:]), numbers[9:])
        faster = rates_of(numbers[:6], numbers[7:9], z[:2], given)
        return np.concatenate([faster, rolling_of(numbers[6], z[2:], z[:2])]) if self.is_pose else faster

    def outputs(self, segments: Segments, states: Array, numbers: Array) -> Array:
        """Return the measurements: poses, or speed and yaw rate."""
        return states[..., 2:] if self.is_pose else states

    def complete_states(self, parts: Sequence[Part], p: Array) -> list[Part]:
        """Return parts with the states of a robot with numbers p that are not measured."""
        return list(parts)

    def plausible(self, p: Array, covariance: Array) -> Array:
        """Return the numbers unchanged."""
        return p

    def robot(self, estimates: Identification) -> VelocityRobot:
        """Return the identified robot; see `Identification.robot`."""
        check_identifiable("robot", estimates.unseen)
        return VelocityRobot(estimates.theta, **self.fields(estimates))

    def fields(self, estimates: Identification) -> dict[str, Any]:
        """Return the fields of the identified robot beside the first numbers."""
        others = self.other_values(estimates.phi)
        rates, limits = np.split(np.array([others[name] for name in self.limits()]), 2)
        source = f"identified from {estimates.samples} samples in {estimates.segments} segments"
        return {"ahead": others["ahead"], "limits": limits, self.rate_limits: rates, "source": source}

    def notes(self, estimates: Identification) -> list[str]:
        """Return notes on numbers that may be neutral, and on numbers that no robot can have."""
        bounds = estimates.interval()
        neutral = [n for n, x in self.neutral.items() if bounds[n][0] <= x <= bounds[n][1]]
        notes = [
            f"the interval of {n} contains {self.neutral[n]:g}, with which it has no effect"
            for n in neutral
            if np.isfinite(bounds[n][0])
        ]
        if estimates.explained < _NOTE_SHARE:
            notes.append(
                f"the model explains {estimates.explained:.0%} of a motion: do commands and motion come "
                "from one robot, with times of one clock?"
            )
        return notes + (self.problems(estimates, neutral) if not estimates.unseen else [])

    def problems(self, estimates: Identification, neutral: Sequence[str]) -> list[str]:
        """Return values that no robot can have, in words; those that may be neutral count as neutral."""
        pairs = zip(estimates.names, estimates.theta.tolist(), strict=False)
        return [*VelocityRobot([self.neutral[n] if n in neutral else x for n, x in pairs]).problems]

    def predicted(
        self, estimates: Identification, log: Log, seconds: float | None
    ) -> tuple[Segments, Array, NDArray[np.bool_], Array]:
        """Return segments of a log, residuals, mask of good samples, and the noise."""
        runs, length = self.runs([log]), scalar("seconds", BLOCK if seconds is None else seconds)
        bounded("seconds", length, least=3 * runs[0].dt, unit="s")
        lead = max(lead_of(runs), int(np.ceil(max(estimates.delay, 0.0) / runs[0].dt)) + 1)
        model = replace(self, dt=runs[0].dt, lead=lead, phase=runs[0].phase)
        segments, calm = segments_of(model.explained_runs(runs, estimates.phi), lead, length, fill=False)
        fit, _ = solve_robustly(model, segments, estimates.phi, calm=calm)
        return segments, fit.linear.residual, fit.good, estimates.noise

    def runs(self, logs: list[Log]) -> list[Run]:
        """Return the checked logs at equal time steps."""
        return runs_of(logs, self.is_pose, self.inputs)

    def explained_runs(self, runs: Sequence[Run], p: Array) -> list[Part]:
        """Return the parts of runs that the commands explain, also by a poor model with numbers p."""
        return self.complete_states(explained_parts(runs, self.lags(p), minimum=-np.inf), p)

    def lags(self, p: Array) -> list[Lag]:
        """Return the lags of both channels without coupling."""
        rows = ((1 / p[b], p[a] / p[b]) for a, b in ((0, 3), (1, 5)))
        return self.lags_of(p, *rows)

    def lags_of(self, p: Array, *gains: tuple[float, float], scale: float = 1.0) -> list[Lag]:
        """Return lags with gains and time constants, and the delay and the limits of the numbers p.

        The limit of the second rate is multiplied by `scale`.
        """
        others = self.other_values(p)
        delay = max(0, round(others["delay"] / self.dt + self.phase))
        top, turning, *bounds = (others[name] for name in self.limits())
        rows = zip(gains, bounds, (top, scale * turning), strict=True)
        return [Lag(*gain, delay, limit, steepest) for gain, limit, steepest in rows]

    def start(self, lags: Sequence[Lag]) -> Array:
        """Return first estimates of the first numbers from the lags of both channels."""
        theta = np.array([0.3, 0.3, 0.0, 1.0, 0.0, 1.0])
        for a, b, lag in zip((0, 1), (3, 5), lags, strict=True):
            if lag.gain > 0:
                theta[[a, b]] = lag.tau / lag.gain, 1 / lag.gain
        return theta

    def of_lags(self, lags: Sequence[Lag]) -> tuple[VelocityModel, Array]:
        """Return the model of lags without coupling, and its numbers."""
        given = {"ahead": 0.0, "delay": self.delay_of(lags)}
        bare = replace(self, free=(), fixed=self.fixed | given | self.limits_of(lags))
        return bare, bare.start([lag if lag.gain > 0 else lag._replace(gain=1.0) for lag in lags])

    def delay_of(self, lags: Sequence[Lag]) -> float:
        """Return the mean delay of lags [s]."""
        return self.dt * max(0.0, float(np.mean([lag.delay for lag in lags])) - self.phase)

    def limits_of(self, lags: Sequence[Lag]) -> dict[str, float]:
        """Return the limits that lags have, by name."""
        values = [*(lag.rate_limit for lag in lags), *(lag.limit for lag in lags)]
        return dict(zip(self.limits(), values, strict=True))

    @property
    def ranges(self) -> dict[int, tuple[float, float, str]]:
        """Range and meaning of gains and lengths, by index."""
        return {3: (*_GAINS, " (command per steady speed)"), 5: (*_GAINS, " (command per steady yaw rate)")}

    def check(self, p: Array, weak: NDArray[np.bool_]) -> None:
        """Reject numbers of wrong units.

        Raises
        ------
        InvalidArgument
            If a number is out of its range: the steady motion differs too much from the commands.
        """
        for k, (low, high, meaning) in self.ranges.items():
            if not (weak[k] or low < abs(p[k]) < high):
                raise InvalidArgument(
                    f"log leads to {self.quantities[k].name} = {p[k]:.3g}{meaning}, expected {low:g} to "
                    f"{high:g}: are commands in {' and '.join(self.inputs.values())}, poses in m and rad?"
                )


@dataclass(frozen=True, eq=False)
class CarModel(VelocityModel):
    """Model of a car: time constants, gains, offset of the steering, wheelbase, understeer, further numbers.

    The gain of the steering is 1 unless `fixed` has the ``"wheelbase"``: curvatures are the ratio of both.
    """

    inputs: ClassVar[Mapping[str, str]] = CAR_COMMANDS
    neutral: ClassVar[Mapping[str, float]] = {"speed_gain": 1.0} | dict.fromkeys(_ZEROS, 0.0)
    limit_rows: ClassVar[tuple[ModelNumber, ...]] = (
        ModelNumber("acceleration", "m/s^2", False, np.inf, path="rate_limits.acceleration"),
        ModelNumber("steering_rate", "rad/s", False, np.inf, path="rate_limits.steering_rate"),
        _LARGEST_SPEED,
        ModelNumber("largest_steering_command", "rad", False, np.inf),
    )
    rate_limits: ClassVar[str] = "rate_limits"

    @property
    def first(self) -> tuple[ModelNumber, ...]:  # type: ignore[override]
        """First seven numbers."""
        steering = (
            ("steering_gain", "", False, 1.0) if "wheelbase" in self.fixed else ("wheelbase", "m", True, 0.3)
        )
        rows: tuple[tuple[Any, ...], ...] = (
            ("speed_time_constant", "s", True, 0.3, np.nan, 1e-6),
            ("speed_gain", "", False, 1.0),
            ("steering_time_constant", "s", True, 0.1, np.nan, 1e-6),
            ("steering_offset", "rad", False, 0.0, 0.3, 0.03),
            steering,
            ("understeer", "rad s^2/m", False, 0.0, 0.02, 0.005),
            ("cornering_drag", "", False, 0.0, 1.0, 0.1),
        )
        return tuple(ModelNumber(*row)._replace(path=row[0]) for row in rows)

    @property
    def is_linear(self) -> bool:  # type: ignore[override]
        """Whether the measurements are linear functions of the states: a yaw rate is not."""
        return self.is_pose

    def time_constants(self, p: Array) -> Array:
        """Return the time constants of the speed, and of both poles of the steering, shape (..., 2) [s]."""
        return np.asarray(p[..., [0, 2]] * [1.0, 0.5])

    def rate_numbers(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return the numbers of the rates, delays [samples] and the longest time step [s]."""
        numbers, delays, longest = super().rate_numbers(segments, p)
        steering = np.stack(self._by_steering(p), axis=-1)
        return np.concatenate([numbers, steering[:, None]], axis=-1), delays, longest

    def rates(self, z: Any, u: Any, numbers: Any) -> Any:
        """Return the rates of speed, steering angle and steering rate, and of the pose if it is measured."""
        car, u = self._car(numbers), np.minimum(np.maximum(u, -numbers[10:12]), numbers[10:12])
        faster = np.stack(faster_of(car, (z[0], z[1], z[2]), u))
        if not self.is_pose:
            return faster
        twist = np.stack([z[0], z[0] * curvature_of(car, z[0], z[1])])
        return np.concatenate([faster, rolling_of(numbers[7], z[3:], twist)])

    def _car(self, numbers: Any) -> SimpleNamespace:
        """Return the numbers of a `VelocityCar`, of the numbers that `rate_numbers` returns."""
        fields = {item.name: numbers[..., k] for k, item in enumerate(self.first)}
        fields |= {"steering_gain": numbers[..., 12], "wheelbase": numbers[..., 13]}
        return SimpleNamespace(**fields, rate_limits=numbers[..., 8:10])

    def outputs(self, segments: Segments, states: Array, numbers: Array) -> Array:
        """Return the measurements: poses, or speed and yaw rate."""
        if self.is_pose:
            return states[..., 3:]
        speed, car = states[..., 0], self._car(numbers[:, :, None])
        return np.stack([speed, speed * curvature_of(car, speed, states[..., 1])], axis=-1)

    def complete_states(self, parts: Sequence[Part], p: Array) -> list[Part]:
        """Return parts whose steering has followed the commands since the start of its log."""
        runs = {id(part.run): part.run for part in parts}
        complete = {key: self._steered_run(run, p) for key, run in runs.items()}
        return [part._replace(run=complete[id(part.run)]) for part in parts]

    def _steered_run(self, run: Run, p: Array) -> Run:
        count, free = len(run.u), replace(self, is_pose=False)
        bare_run = run._replace(y=run.nu, calm=run.nu, is_valid=np.ones(count, bool))
        length = self.dt * (count - self.lead)
        segments, _ = segments_of([Part(bare_run, 0, count)], self.lead, length, fill=False)
        segments.start[:, 1] = self._by_steering(p)[0] * segments.applied(0, 1)[0, :, 0, 1] + p[3]
        states = simulate_states(free, segments, p[None], segments.start[None])[0][0, 0]
        states = np.concatenate([np.repeat(states[:1], count - len(states), axis=0), states])
        return run._replace(state=np.column_stack([run.state[:, 0], states[:, 1:]]))

    def _by_steering(self, p: Array) -> tuple[Any, Any]:
        """Return the gain of the steering and the wheelbase, of numbers (..., P)."""
        number, base = p[..., _STEERING], self.fixed.get("wheelbase")
        return (1.0 + 0.0 * number, number) if base is None else (number, base + 0.0 * number)

    def robot(self, estimates: Identification) -> Any:
        """Return the identified car; effects of its speed that are not identifiable are zero."""
        pairs = zip(self.first, estimates.hidden > 0, strict=False)
        if any(is_weak and item.name not in _AT_SPEED for item, is_weak in pairs):
            check_identifiable("robot", estimates.unseen)
        values = dict(zip(estimates.names, estimates.phi[: len(self.first)].tolist(), strict=False))
        return VelocityCar(**{"wheelbase": self.fixed.get("wheelbase")} | values, **self.fields(estimates))

    def problems(self, estimates: Identification, neutral: Sequence[str]) -> list[str]:
        """Return gains that other signs or units of the commands would explain, in words."""
        gain, found = (estimates.theta[_STEERING] if "wheelbase" in self.fixed else 1.0), []
        if gain < 0:
            found.append("the car turns to the other side than its commands: are they positive to the left?")
        if abs(abs(gain) / np.radians(1.0) - 1.0) < _NEAR_DEGREES:
            found.append("steering_gain is near pi / 180: are the steering commands in degrees?")
        return found

    def lags(self, p: Array) -> list[Lag]:
        """Return the lags of speed and curvature."""
        gain, wheelbase = self._by_steering(p)
        speed, curvature = self.lags_of(p, (p[1], p[0]), (gain / wheelbase, p[2]), scale=1 / wheelbase)
        limit = np.tan(min(curvature.limit, np.pi / 2))
        return [speed, curvature._replace(offset=p[3] / wheelbase, limit=limit)]

    def start(self, lags: Sequence[Lag]) -> Array:
        """Return first estimates of the first numbers from the lags of speed and curvature.

        Raises
        ------
        InvalidArgument
            If the car turns to the other side than its commands, and the wheelbase is not known.
        """
        speed, curvature = lags
        base, gain = self.fixed.get("wheelbase"), curvature.gain or 1.0
        if base is None and gain < 0:
            raise InvalidArgument(
                "log has steering commands that turn the car to the other side, expected positive angles "
                "to the left: change their sign, or give wheelbase"
            )
        steering = 1 / gain if base is None else gain * base
        offset = curvature.offset * (1 / gain if base is None else base)
        return np.array([speed.tau, speed.gain or 1.0, curvature.tau, offset, steering, 0.0, 0.0])

    def limits_of(self, lags: Sequence[Lag]) -> dict[str, float]:
        """Return the limits that lags have, by name: those of curvature as angles."""
        speed, curvature = lags
        wheelbase = self.fixed.get("wheelbase", 1 / (curvature.gain or 1.0))
        limit = np.inf if np.isinf(curvature.limit) else float(np.arctan(curvature.limit))
        turns = curvature._replace(rate_limit=curvature.rate_limit * abs(wheelbase), limit=limit)
        return super().limits_of([speed, turns])

    @property
    def ranges(self) -> dict[int, tuple[float, float, str]]:
        """Range of the gain of the steering, or of the wheelbase."""
        return {_STEERING: (*(_STEERING_GAINS if "wheelbase" in self.fixed else _LONGEST), "")}
