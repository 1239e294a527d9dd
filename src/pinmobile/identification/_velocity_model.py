"""`VelocityModel`: theta, delay and limits of a robot with velocity inputs, as numbers that logs identify."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, bounded, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.identification._commands import (
    BLOCK,
    CHANNELS,
    Part,
    explained_parts,
    lead_of,
    runs_of,
    segments_of,
)
from pinmobile.identification._estimates import Identification, check_identifiable
from pinmobile.identification._estimator import solve_robustly
from pinmobile.identification._lag import Lag
from pinmobile.identification._log import Log
from pinmobile.identification._planar_model import POSE
from pinmobile.identification._simulation import Quantity, Segments
from pinmobile.identification._velocity_robot import ABOVE_ZERO, THETA, VelocityRobot, rates_of, rolling_of

_EXPLAINED = 0.8  # explained share of the motion below which a note follows
_NEUTRAL = {"theta_3": 0.0, "theta_4": 1.0, "theta_5": 0.0, "theta_6": 1.0}  # without losses and offset
_QUICKEST = 0.1  # shortest time constant that a log shows, as a share of its time step
_FINE = 0.3  # longest time step of the integrator, as a share of the shortest time constant
_BENDS = 4  # factor on the number of steps where a limit of acceleration may end within a step
_MOST_STEPS = 40  # largest number of steps per sample
_FAR = 100.0  # value of a limit that the log does not show, per first estimate
_GAINS = 0.1, 10.0  # range of the command per steady speed or yaw rate


class Sized(NamedTuple):
    """Number of a model: the identified quantity, its prior value, its typical and its smallest size.

    The prior value of a limit is infinite; a typical size of NaN is that of the number.
    """

    quantity: Quantity
    prior: float
    size: float = np.nan
    least: float = 1e-3


def _theta() -> Iterator[Sized]:
    for k, (name, unit, _) in enumerate(THETA):
        sizes = (_NEUTRAL.get(name, 0.3), np.nan, 1e-6) if k in ABOVE_ZERO else (0.0, 1.0, 0.1)
        yield Sized(Quantity(name, unit, k in ABOVE_ZERO, f"theta.{name}"), *sizes)


DELAY = Sized(Quantity("delay", "s", True), 0.0, 0.3, 0.1)
AHEAD = Sized(Quantity("ahead", "m", False, "ahead"), 0.0, 1.0, 0.1)


@dataclass(frozen=True, eq=False)
class VelocityModel:
    """Model of a robot with velocity inputs: theta and further numbers.

    Parameters
    ----------
    free : tuple of str
        Further estimated numbers: ``"delay"``, ``"ahead"``, and limits of accelerations and commands.
    given : mapping of str to float
        Values of the numbers that are not estimated [s, m, m/s^2, rad/s^2, m/s, rad/s].
    lead : int
        Largest delay [samples].
    dt : float
        Time step [s].
    is_pose : bool
        Whether poses are measured; otherwise speed and yaw rate are.
    longest : float
        Largest length of a segment [s].
    """

    free: tuple[str, ...]
    given: dict[str, float]
    lead: int
    dt: float
    is_pose: bool
    longest: float = np.inf

    told_first: ClassVar[int] = 6
    columns: ClassVar[slice] = slice(None)
    shifted: ClassVar[int | None] = None
    is_linear: ClassVar[bool] = True
    inputs: ClassVar[Mapping[str, str]] = CHANNELS
    neutral: ClassVar[Mapping[str, float]] = _NEUTRAL
    first: ClassVar[tuple[Sized, ...]] = tuple(_theta())
    steepest: ClassVar[tuple[Sized, Sized]] = (
        Sized(Quantity("acceleration", "m/s^2", False, "accelerations.acceleration"), np.inf),
        Sized(Quantity("yaw_acceleration", "rad/s^2", False, "accelerations.yaw_acceleration"), np.inf),
    )
    most: ClassVar[tuple[Sized, Sized]] = (
        Sized(Quantity("largest_speed_command", "m/s", False), np.inf),
        Sized(Quantity("largest_yaw_rate_command", "rad/s", False), np.inf),
    )

    @classmethod
    def limits(cls) -> list[str]:
        """Return the names of the limits: of both rates, then of both commands."""
        return [one.quantity.name for one in (*cls.steepest, *cls.most)]

    @cached_property
    def _numbers(self) -> list[Sized]:
        others = {one.quantity.name: one for one in (DELAY, AHEAD, *self.steepest, *self.most)}
        return [*self.first, *(others[name] for name in self.free)]

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Estimated numbers."""
        return tuple(one.quantity for one in self._numbers)

    @cached_property
    def _sizes(self) -> Array:
        return np.asarray([one[1:] for one in self._numbers]).T

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
        return np.where(np.isnan(given), np.abs(p), given), np.where(np.isinf(first), _FAR * np.abs(p), first)

    def others(self, p: Array) -> dict[str, Array]:
        """Return delay, distance ahead of the axle and limits by name, shape (K,) each, for p (K, P)."""
        known = {name: np.full(len(p), value) for name, value in self.given.items()}
        return known | {name: p[:, len(self.first) + k] for k, name in enumerate(self.free)}

    def time_constants(self, p: Array) -> Array:
        """Return the time constants of both channels, shape (..., 2) [s]."""
        return np.asarray(p[..., :2] / p[..., [3, 5]])

    def is_possible(self, p: Array) -> bool:
        """Return whether the numbers p, shape (P,), are possible and the delay is within its range."""
        late, quickest = self.others(p[None])["delay"][0] / self.dt, self.time_constants(p).min()
        is_possible = np.isfinite(p).all() and self.are_possible(p) and quickest > _QUICKEST * self.dt
        return bool(is_possible and -1 < late <= self.lead)

    def are_possible(self, p: Array) -> Any:
        """Return which numbers, shape (..., P), a robot can have."""
        limits = self.limits()
        above = [k for k, one in enumerate(self.quantities) if one.bounded and one.name != "delay"]
        above += [k for k, one in enumerate(self.quantities) if one.name in limits]
        return (p[..., above] > 0).all(axis=-1)

    def resolved(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
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

    def observed(self, segments: Segments, states: Array, numbers: Array) -> Array:
        """Return the measurements: poses, or speed and yaw rate."""
        return states[..., 2:] if self.is_pose else states

    def started(self, parts: Sequence[Part], p: Array) -> list[Part]:
        """Return parts with the states of a robot with numbers p that are not measured."""
        return list(parts)

    def to_physical(self, p: Array) -> Array:
        """Return the numbers unchanged."""
        return p

    def slopes(self, p: Array) -> Array:
        """Return the identity: the derivatives of `to_physical`, shape (P, P)."""
        return np.eye(len(p))

    def plausible(self, p: Array, covariance: Array) -> Array:
        """Return the numbers unchanged."""
        return p

    def robot(self, found: Identification) -> VelocityRobot:
        """Return the identified robot; see `Identification.robot`."""
        check_identifiable("robot", found.unseen)
        others = {name: float(x[0]) for name, x in self.others(found.phi[None]).items()}
        source = f"identified from {found.samples} samples in {found.segments} segments"
        limits = [others[name] for name in self.limits()]
        return VelocityRobot(found.theta, others["ahead"], limits[2:], limits[:2], source=source)

    def forces(self, found: Identification) -> list[Any]:
        """Return no forces: theta includes the losses."""
        return []

    def notes(self, found: Identification) -> list[str]:
        """Return notes on numbers that may be neutral, and on numbers that no robot can have."""
        bounds = found.interval()
        neutral = [n for n, x in self.neutral.items() if bounds[n][0] <= x <= bounds[n][1]]
        told = [
            f"the interval of {n}{' - 1' * bool(self.neutral[n])} contains zero"
            for n in neutral
            if np.isfinite(bounds[n][0])
        ]
        if found.explained < _EXPLAINED:
            told.append(
                f"the model explains {found.explained:.0%} of a motion: do commands and motion come from one "
                "robot, with times of one clock?"
            )
        return told + (self.problems(found, neutral) if not found.unseen else [])

    def problems(self, found: Identification, neutral: Sequence[str]) -> list[str]:
        """Return values that no robot can have, in words; those that may be neutral count as neutral."""
        pairs = zip(found.names, found.theta.tolist(), strict=False)
        return [*VelocityRobot([self.neutral[n] if n in neutral else x for n, x in pairs]).problems]

    def predicted(
        self, found: Identification, log: Log, seconds: float | None
    ) -> tuple[Segments, Array, NDArray[np.bool_], Array]:
        """Return segments of a log, residuals, mask of good samples, and the noise."""
        runs, length = (
            runs_of([log], self.is_pose, self.inputs),
            scalar("seconds", BLOCK if seconds is None else seconds),
        )
        bounded("seconds", length, least=3 * runs[0].dt, unit="s")
        lead = max(lead_of(runs), int(np.ceil(max(found.delay, 0.0) / runs[0].dt)) + 1)
        model = replace(self, dt=runs[0].dt, lead=lead)
        parts = explained_parts(runs, model.lags(found.phi), least=-np.inf)  # also of a poor model
        parts = model.started(parts, found.phi)
        segments, calm = segments_of(parts, model.lead, length, filled=False)
        left, _ = solve_robustly(model, segments, found.phi, calm=calm)
        return segments, left.near.residual, left.good, found.noise

    def lags(self, p: Array) -> list[Lag]:
        """Return the lags of both channels without coupling."""
        rows = ((1 / p[b], p[a] / p[b]) for a, b in ((0, 3), (1, 5)))
        return self.lags_of(p, *rows)

    def lags_of(self, p: Array, *gains: tuple[float, float], scale: float = 1.0) -> list[Lag]:
        """Return lags with gains and time constants, and the delay and the limits of the numbers p.

        The limit of the second rate is multiplied by `scale`.
        """
        others = {name: float(x[0]) for name, x in self.others(p[None]).items()}
        late = max(0, round(others["delay"] / self.dt))
        top, turning, *most = (others[name] for name in self.limits())
        rows = zip(gains, most, (top, scale * turning), strict=True)
        return [Lag(*gain, late, limit, steepest) for gain, limit, steepest in rows]

    def start(self, lags: Sequence[Lag]) -> Array:
        """Return first estimates of the first numbers from the lags of both channels."""
        theta = np.array([0.3, 0.3, 0.0, 1.0, 0.0, 1.0])
        for a, b, lag in zip((0, 1), (3, 5), lags, strict=True):
            if lag.gain > 0:
                theta[[a, b]] = lag.tau / lag.gain, 1 / lag.gain
        return theta

    def of_lags(self, lags: Sequence[Lag]) -> tuple[VelocityModel, Array]:
        """Return the model of lags without coupling, and its numbers."""
        given = {"ahead": 0.0, "delay": self.dt * float(np.mean([lag.late for lag in lags]))}
        bare = replace(self, free=(), given=self.given | given | self.limits_of(lags))
        return bare, bare.start([lag if lag.gain > 0 else lag._replace(gain=1.0) for lag in lags])

    def limits_of(self, lags: Sequence[Lag]) -> dict[str, float]:
        """Return the limits that lags have, by name."""
        values = [*(lag.steepest for lag in lags), *(lag.limit for lag in lags)]
        return dict(zip(self.limits(), values, strict=True))

    def check(self, p: Array, lost: NDArray[np.bool_]) -> None:
        """Reject numbers of wrong units.

        Raises
        ------
        InvalidArgument
            If the steady motion differs too much from the commands.
        """
        for k in (3, 5):
            if not (lost[k] or _GAINS[0] < p[k] < _GAINS[1]):
                raise InvalidArgument(
                    f"log leads to {THETA[k][0]} = {p[k]:.3g} ({THETA[k][2].partition(':')[0]}), expected "
                    "about 1: are commands in m/s and rad/s, positions in metres and psi in radians?"
                )
