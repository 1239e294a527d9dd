"""`identify_velocity`: theta from a log of commands and motion, with confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, bounded, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.identification._estimates import Identification, check_identifiable
from pinmobile.identification._estimator import Fit, Whiteness, jackknife, solve_robustly, unexplained
from pinmobile.identification._log import Log, Samples, check_steps, check_units, logs_of
from pinmobile.identification._planar_model import PlanarModel
from pinmobile.identification._preprocessing import mean_inputs, twist_of, without_outliers
from pinmobile.identification._simulation import Quantity, Segments, simulate
from pinmobile.identification._velocity_robot import ABOVE_ZERO, THETA, VelocityRobot, rates_of, rolling_of
from pinmobile.identification._weak_form import Bump, fitted, scanned

_LEAST_SEGMENTS, _SECONDS = 20, 2.0  # number and length [s] of segments
_LATEST, _MOST_LATE = 0.6, 60  # largest delay, in s and samples
_STILL = 1e-9  # [m/s, rad/s]: commands that change less do not
_TOGETHER = 0.2  # correlation of residuals of neighbouring samples that is more than noise
_EXPLAINED, _LEAST = 0.8, 0.5  # share of the measurements below which something is wrong, or the robot
_GAINS = 0.1, 10.0  # command per steady speed or yaw rate of any robot
_FARTHEST = 10.0  # [m]: ahead of the axle
_NEUTRAL = {"theta_3": 0.0, "theta_4": 1.0, "theta_5": 0.0, "theta_6": 1.0}  # of a robot without losses
_WINDOW = 0.8  # [s] of the weak form that gives a start
_FINEST = 1e-4  # [m, rad]: least noise of poses
_FINE = 0.3  # of the shortest time constant: longest time step of Runge and Kutta
_BENDS = 4  # times as many where a limit of acceleration ends within one
_MOST_STEPS = 40  # of it per sample
_SLOPE = 1e-4  # of the size of a number, in differences
_COUPLING = [2, 4]  # theta_3 and theta_5
_LIMITS = "acceleration", "yaw_acceleration"
_OTHERS = {
    "delay": Quantity("delay", "s", False),
    "ahead": Quantity("ahead", "m", False, "ahead"),
    _LIMITS[0]: Quantity(_LIMITS[0], "m/s^2", False, f"accelerations.{_LIMITS[0]}"),
    _LIMITS[1]: Quantity(_LIMITS[1], "rad/s^2", False, f"accelerations.{_LIMITS[1]}"),
}
_SIZES = {  # value without information, size where it is not that of the number, least size
    **dict.fromkeys(("theta_1", "theta_2"), (0.3, np.nan, 1e-6)),
    **dict.fromkeys(("theta_4", "theta_6"), (1.0, np.nan, 1e-6)),
    **dict.fromkeys(("theta_3", "theta_5"), (0.0, 1.0, 0.1)),
    **{"delay": (0.0, 0.3, 0.1), "ahead": (0.0, 1.0, 0.1)},
    **{_LIMITS[0]: (1.0, np.nan, 1e-3), _LIMITS[1]: (3.0, np.nan, 1e-3)},
}


@dataclass(frozen=True, eq=False)
class VelocityModel:
    """Robot with velocity inputs: theta, and further numbers.

    Parameters
    ----------
    free : tuple of str
        Further numbers: ``"delay"``, ``"ahead"``, ``"acceleration"`` and ``"yaw_acceleration"``.
    given : mapping of str to float
        Values of those that are not identified [s, m, m/s^2, rad/s^2].
    lead : int
        Largest delay, in samples.
    dt : float
        Time between two samples [s].
    is_pose : bool
        Whether poses are measured, otherwise speed and yaw rate.
    """

    free: tuple[str, ...]
    given: dict[str, float]
    lead: int
    dt: float
    is_pose: bool

    told_first: ClassVar[int] = 6

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """Identified numbers."""
        theta = [Quantity(name, unit, False, f"theta.{name}") for name, unit, _ in THETA]
        return (*theta, *(_OTHERS[name] for name in self.free))

    @cached_property
    def _sizes(self) -> Array:
        return np.asarray([_SIZES[one.name] for one in self.quantities]).T

    @property
    def measured(self) -> tuple[tuple[str, str], ...]:
        """Names and units of the measurements."""
        return PlanarModel.measured if self.is_pose else (("speed", "m/s"), ("yaw rate", "rad/s"))

    def sizes(self, p: Array) -> Array:
        """Return the sizes of numbers like p, shape (P,)."""
        return np.asarray(np.maximum(np.abs(p), self._sizes[2]))

    def natural(self, p: Array) -> tuple[Array, Array]:
        """Return the sizes of numbers like p, shape (P,), and their values without information."""
        first, given, _ = self._sizes
        return np.where(np.isnan(given), np.abs(p), given), first

    def others(self, p: Array) -> dict[str, Array]:
        """Return delay, distance ahead of the axle and limits of numbers p (K, P), shape (K,) each."""
        known = {name: np.full(len(p), value) for name, value in self.given.items()}
        return known | {name: p[:, 6 + k] for k, name in enumerate(self.free)}

    def is_possible(self, p: Array) -> bool:
        """Return whether there is a robot of such numbers, shape (P,), that is not too late."""
        late = self.others(p[None])["delay"][0] / self.dt
        return bool(np.isfinite(p).all() and self.are_possible(p) and -1 < late < self.lead)

    def are_possible(self, p: Array) -> Any:
        """Return which numbers, shape (..., P), are of a robot."""
        above = [k for k, one in enumerate(self.quantities) if k in ABOVE_ZERO or one.name in _LIMITS]
        return (p[..., above] > 0).all(axis=-1)

    def increments(self, p: Array) -> Array:
        """Return the steps of differences."""
        return _SLOPE * self.sizes(p)

    def resolved(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return theta, distance ahead of the axle and limits, delays and the longest time step."""
        others, theta = self.others(p), p[:, :6]
        numbers = np.column_stack([theta, others["ahead"], *(others[name] for name in _LIMITS)])[:, None]
        bends = _BENDS if np.isfinite(numbers[..., 7:]).any() else 1
        fastest = bends * (theta[:, [3, 5]] / theta[:, [0, 1]]).max()
        longest = self.dt / float(np.clip(self.dt * fastest / _FINE, 1, _MOST_STEPS))
        return numbers, others["delay"] / self.dt, longest

    def rates(self, z: Any, u: Any, numbers: Any) -> Any:
        """Return the rates of speed and yaw rate, then of x, y and psi where poses are measured."""
        faster = rates_of(numbers[:6], numbers[7:], z[:2], u)
        return np.concatenate([faster, rolling_of(numbers[6], z[2:], z[:2])]) if self.is_pose else faster

    def observed(self, segments: Segments, states: Array) -> Array:
        """Return poses, or speeds and yaw rates."""
        return states[..., 2:] if self.is_pose else states

    def to_physical(self, p: Array) -> Array:
        """Return the numbers as they are."""
        return p

    def slopes(self, p: Array) -> Array:
        """Return the derivatives of the numbers by themselves, shape (P, P)."""
        return np.eye(len(p))

    def plausible(self, p: Array, covariance: Array) -> Array:
        """Return the numbers as they are."""
        return p

    def robot(self, found: Identification) -> VelocityRobot:
        """Return the robot as identified; see `Identification.robot`."""
        check_identifiable("robot", found.unseen)
        others = {name: float(x[0]) for name, x in self.others(found.phi[None]).items()}
        source = f"identified from {found.samples} samples in {found.segments} segments"
        most = [others[name] for name in _LIMITS]
        return VelocityRobot(found.theta, others["ahead"], accelerations=most, source=source)

    def forces(self, found: Identification) -> list[Any]:
        """Return none: losses are in theta."""
        return []

    def notes(self, found: Identification) -> list[str]:
        """Return which numbers may be neutral, and which no robot has."""
        bounds = found.interval()
        neutral = [n for n, x in _NEUTRAL.items() if bounds[n][0] <= x <= bounds[n][1]]
        told = [f"{n}{' - 1' * bool(_NEUTRAL[n])} may as well be zero" for n in neutral]
        if found.explained < _EXPLAINED:
            told.append(
                f"the model explains {found.explained:.0%} of the measurements: are commands and motion of "
                "one robot, and by one clock?"
            )
        if not found.unseen:
            pairs = zip(found.names, found.theta.tolist(), strict=False)
            told += VelocityRobot([_NEUTRAL[n] if n in neutral else x for n, x in pairs]).problems
        return told

    def predicted(
        self, found: Identification, log: Log, seconds: float | None
    ) -> tuple[Segments, Array, NDArray[np.bool_], Array]:
        """Return segments of a log, measured less simulated, good samples, and the noise."""
        length = found.seconds if seconds is None else scalar("seconds", seconds)
        segments, calm, _ = _cut([log], length, 1, self.is_pose)
        model = replace(self, dt=float(segments.dt[0]), lead=segments.lead - 1)
        left, _ = solve_robustly(model, segments, found.phi, calm=calm)
        return segments, left.near.residual, left.good, found.noise


def identify_velocity(
    log: Log | Sequence[Log],
    *,
    delay: float | None = None,
    ahead: float | None = 0.0,
    accelerations: ArrayLike | None = np.inf,
) -> Identification:
    """Estimate the theta of a `VelocityRobot` from a log of its commands and its motion.

    The inputs of the log are commands of speed and yaw rate; measured is the twist where the log has one,
    such as from encoders, otherwise the pose. Output error: simulations of segments of 2 s, from free first
    states, are fitted to the measurements, weighted by the covariance of the residual, without samples
    beyond six standard deviations. Intervals are those of the jackknife over segments with Student's t. They
    are valid where noise is correlated too; they do not cover the error of a wrong structure. The weak form
    gives the start and the first delay.

    Speed and yaw rate must change often and independently, such as by `RandomSteps`.

    Parameters
    ----------
    log : Log, or sequence of these
        Commands and motion, of at least 20 segments.
    delay : float, optional
        Delay of measurements relative to commands, beside theta [s]; default: estimated, and intervals of the
        other numbers include its uncertainty.
    ahead : float, optional
        Distance of the measured point ahead of the axle [m]; None: estimated from poses.
    accelerations : array_like, shape () or (2,), optional
        Largest |u'| and |w'| that the firmware allows [m/s^2, rad/s^2]; None: estimated from a log that
        reaches them.

    Raises
    ------
    InvalidArgument
        If the log is too short, its input is of another robot or in other units, commands do not change or
        explain less than half of the motion, or an argument is not in its range.
    """
    logs = logs_of(log)
    segments, calm, runs = _cut(logs, _SECONDS, _LEAST_SEGMENTS)
    dt, lead, is_pose = runs[0].dt, _lead(runs), runs[0].twist is None
    if ahead is None and not is_pose:
        raise InvalidArgument("ahead is None, and the log measures a twist, which does not tell it: give it")
    sought = {"delay": delay is None, "ahead": ahead is None, **dict.fromkeys(_LIMITS, accelerations is None)}
    most = VelocityRobot(np.ones(6), accelerations=np.inf if accelerations is None else accelerations)
    given = {
        "delay": bounded(
            "delay", scalar("delay", 0.0 if delay is None else delay), least=0, most=lead * dt, unit="s"
        ),
        "ahead": bounded(
            "ahead",
            scalar("ahead", 0.0 if ahead is None else ahead),
            least=-_FARTHEST,
            most=_FARTHEST,
            unit="m",
        ),
        **dict(zip(_LIMITS, most.accelerations.tolist(), strict=True)),
    }
    model = VelocityModel(tuple(name for name, is_so in sought.items() if is_so), given, lead, dt, is_pose)
    p = _guess(model, runs)
    if not np.isfinite(simulate(model, segments, p[None], segments.start[None])).all():
        p[_COUPLING] = 0.0  # without it nothing grows
    try:
        found, lost = solve_robustly(model, segments, p, calm=calm, natural=model.natural)
    except np.linalg.LinAlgError:
        raise unexplained(0.0) from None
    square, explained = _explained(segments, found, calm)
    for k in (3, 5):
        if not (lost[k] or _GAINS[0] < found.p[k] < _GAINS[1]):
            raise InvalidArgument(
                f"log leads to {THETA[k][0]}, {THETA[k][2].partition(':')[0]}, of {found.p[k]:.3g}, expected "
                "about 1: are commands in m/s and rad/s, positions in metres and psi in radians?"
            )
    covariance, good = np.zeros((len(p), len(p))), found.good
    covariance[np.ix_(~lost, ~lost)] = jackknife(found.near._replace(J=found.near.J[..., ~lost]))
    listed = ", ".join(one.name for one, is_so in zip(model.quantities, lost, strict=True) if is_so)
    rank, white = int((~lost).sum()), Whiteness.of(found.near.residual * good[..., None], good)
    return Identification(
        model=model,
        phi=found.p,
        covariance_of_phi=covariance,
        freedom=len(good) - 1,
        rank=rank,
        unseen=f"the motion tells nothing of {listed}: rank {rank} of {len(p)}" if listed else "",
        hidden=lost.astype(float),
        unknown=np.zeros((len(p), 0)),
        delay=float(model.others(found.p[None])["delay"][0]),
        delay_error=float(np.sqrt(covariance[6, 6])) if delay is None else np.nan,
        dt=dt,
        seconds=_SECONDS,
        outliers=int((segments.good & ~good).sum()),
        dropped=sum(one.dropped for one in logs),
        samples=int(good.sum()),
        segments=len(good),
        noise=np.sqrt(square),
        residual=np.sqrt(square),
        whiteness=white,
        is_noise=bool(np.abs(white.correlation).max() <= _TOGETHER),
        explained=explained,
    )


def _explained(segments: Segments, found: Fit, calm: NDArray[np.bool_]) -> tuple[Array, float]:
    """Return the residual's mean squares, and the explained share of the worse of speed and yaw rate."""
    y, square = segments.y, (found.near.residual[found.good] ** 2).mean(axis=0)
    left, is_pose = square, y.shape[-1] == 3
    if is_pose:  # starts are free: residuals of straight lines in time
        t = np.linspace(-1.0, 1.0, y.shape[1])[:, None]
        y = y - y.mean(axis=1, keepdims=True)
        y = y - t * ((t * y).sum(axis=1, keepdims=True) / (t * t).sum())
    spent = y[found.good & calm].var(axis=0)
    if is_pose:  # a robot may go along one axis
        left, spent = (np.array([each[:2].sum(), each[2]]) for each in (left, spent))
    commanded = np.ptp(segments.inputs[segments.at], axis=(0, 1)) > _STILL
    share = float(1 - (left / np.maximum(spent, 1e-300))[commanded].max(initial=0.0))
    if not share >= _LEAST:
        raise unexplained(share)
    return square, share


def _cut(
    logs: list[Log], seconds: float, least: int, is_pose: bool | None = None
) -> tuple[Segments, NDArray[np.bool_], list[Samples]]:
    """Return segments of a length [s], where they are calm, and the logs checked."""
    for one in logs:
        if one.u.shape[1] != 2:
            raise InvalidArgument(
                f"log has {one.u.shape[1]} inputs, expected two, commands of speed and yaw rate: is it of "
                "a robot that takes forces? Then identify"
            )
        check_units(one, "log", {"speed": "m/s", "yaw rate": "rad/s"})
    runs = [one.samples() for one in logs]
    is_pose = runs[0].twist is None if is_pose is None else is_pose
    if any((run.twist is None) != is_pose for run in runs):
        raise InvalidArgument("log measures a twist, and another one a pose, expected the same of all")
    check_steps([run.dt for run in runs])
    dt, lead = runs[0].dt, _lead(runs) + 1
    length, parts, calms = max(3, round(bounded("seconds", seconds, least=3 * dt, unit="s") / dt)), [], []
    for run in runs:
        y, calm, nu = _read(run)
        states = np.concatenate([nu, calm] if is_pose else [nu], axis=-1)
        rows = y, run.seen, states, run.u, np.ones(y.shape[1])
        parts.append(Segments.cut(dt, rows, (lead, len(y), length, lead, 1)))
        unchanged = (calm == y).all(axis=-1)[lead : lead + len(parts[-1].y) * length]
        calms.append(unchanged.reshape(-1, length))
    found = Segments.joined(parts)
    if len(found.y) < least:
        raise InvalidArgument(
            f"log is {sum(float(run.t[-1]) for run in runs):.3g} s long, which gives {len(found.y)} segments "
            f"of {seconds:g} s, too short: expected {least}, so that intervals are valid: "
            f"{(least + 0.5) * seconds:g} s and more"
        )
    if least > 1 and not (np.ptp(found.inputs, axis=0) > _STILL).any():
        raise InvalidArgument("log has commands that never change, expected excitation, such as RandomSteps")
    return found, np.concatenate(calms), runs


def _lead(runs: Sequence[Samples]) -> int:
    """Return the largest delay of a command, in samples."""
    dt = runs[0].dt
    return max(3, min(_MOST_LATE, round(_LATEST / dt), min(len(run.t) for run in runs) // 10))


def _guess(model: VelocityModel, runs: Sequence[Samples]) -> Array:
    """Return the first numbers, shape (P,): theta and the delay by the weak form, without rates of speeds."""
    prior, dt, rows = model._sizes[0], model.dt, []
    bump, nus = Bump.of(_WINDOW, dt), [_read(run)[2] for run in runs]
    over = bump.over
    for u, w in (nu.T for nu in nus):
        zero = np.zeros(len(over(u)))
        ahead = [-over(u, 1), zero, -over(w * w), over(u), zero, zero]
        turning = [zero, -over(w, 1), zero, zero, over(u * w), over(w)]
        rows.append(np.stack([np.stack(ahead, -1), np.stack(turning, -1)], axis=1))
    Y, counts = np.concatenate(rows), [len(each) for each in rows]

    def fit(late: float) -> Any:
        y = [over(mean_inputs(run.u, np.arange(len(run.u) + 1.0) - 0.5 - late)) for run in runs]
        return fitted(Y, np.concatenate(y), counts, prior[:6], np.eye(6), 2)[0]

    late = model.given["delay"] / dt
    if "delay" in model.free:
        _, late, _ = scanned(fit, np.arange(float(model.lead)))
    theta = fit(late).phi
    theta[list(ABOVE_ZERO)] = np.maximum(theta[list(ABOVE_ZERO)], 0.02)
    rates = np.concatenate([np.abs(np.gradient(nu, dt, axis=0)) for nu in nus])
    steep = dict(zip(_LIMITS, np.quantile(rates, 0.9, axis=0) + 1e-3, strict=True))
    return np.append(theta, [{"delay": late * dt, "ahead": 0.0, **steep}[name] for name in model.free])


def _read(run: Samples) -> tuple[Array, Array, Array]:
    """Return measurements, shape (N, k), these without gross outliers of poses, and speed and yaw rate."""
    if run.twist is not None:
        return (run.twist[:, [0, 2]],) * 3
    y = np.asarray(run.q)
    calm, _, _ = without_outliers(y, run.seen, run.dt, _FINEST)
    return y, calm, twist_of(calm, run.dt)[:, [0, 2]]
