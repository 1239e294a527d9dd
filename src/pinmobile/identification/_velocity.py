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

_LEAST_SEGMENTS, _SECONDS = 20, 2.0  # smallest number, and length [s], of segments
_LATEST, _MOST_LATE = 0.6, 60  # largest delay [s] and [samples]
_STILL = 1e-9  # [m/s, rad/s]: commands that change less count as constant
_TOGETHER = 0.2  # largest correlation of successive residuals that counts as noise
_EXPLAINED, _LEAST = 0.8, 0.5  # explained share of the motion below which a note, or an error, follows
_GAINS = 0.1, 10.0  # range of the command per steady speed or yaw rate
_FARTHEST = 10.0  # [m]: largest distance ahead of the axle
_NEUTRAL = {"theta_3": 0.0, "theta_4": 1.0, "theta_5": 0.0, "theta_6": 1.0}  # without losses and offset
_WINDOW = 0.8  # [s], window of the weak form that gives first estimates
_FINEST = 1e-4  # [m, rad]: smallest noise of poses
_FINE = 0.3  # longest time step of the integrator, as a share of the shortest time constant
_BENDS = 4  # factor on the number of steps where a limit of acceleration may end within a step
_MOST_STEPS = 40  # largest number of steps per sample
_SLOPE = 1e-4  # step of differences, as a share of the size of a number
_COUPLING = [2, 4]  # theta_3 and theta_5
_LIMITS = "acceleration", "yaw_acceleration"
_OTHERS = {
    "delay": Quantity("delay", "s", False),
    "ahead": Quantity("ahead", "m", False, "ahead"),
    _LIMITS[0]: Quantity(_LIMITS[0], "m/s^2", False, f"accelerations.{_LIMITS[0]}"),
    _LIMITS[1]: Quantity(_LIMITS[1], "rad/s^2", False, f"accelerations.{_LIMITS[1]}"),
}
_SIZES = {  # prior value, typical size (NaN: that of the number), smallest size
    **dict.fromkeys(("theta_1", "theta_2"), (0.3, np.nan, 1e-6)),
    **dict.fromkeys(("theta_4", "theta_6"), (1.0, np.nan, 1e-6)),
    **dict.fromkeys(("theta_3", "theta_5"), (0.0, 1.0, 0.1)),
    **{"delay": (0.0, 0.3, 0.1), "ahead": (0.0, 1.0, 0.1)},
    **{_LIMITS[0]: (1.0, np.nan, 1e-3), _LIMITS[1]: (3.0, np.nan, 1e-3)},
}


@dataclass(frozen=True, eq=False)
class VelocityModel:
    """Model of a robot with velocity inputs: theta and further numbers.

    Parameters
    ----------
    free : tuple of str
        Further estimated numbers: ``"delay"``, ``"ahead"``, ``"acceleration"``, ``"yaw_acceleration"``.
    given : mapping of str to float
        Values of the numbers that are not estimated [s, m, m/s^2, rad/s^2].
    lead : int
        Largest delay [samples].
    dt : float
        Time step [s].
    is_pose : bool
        Whether poses are measured; otherwise speed and yaw rate are.
    """

    free: tuple[str, ...]
    given: dict[str, float]
    lead: int
    dt: float
    is_pose: bool

    told_first: ClassVar[int] = 6

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """Estimated numbers."""
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
        """Return the typical sizes of numbers near p, shape (P,)."""
        return np.asarray(np.maximum(np.abs(p), self._sizes[2]))

    def natural(self, p: Array) -> tuple[Array, Array]:
        """Return the typical sizes of numbers near p, and their prior values, shape (P,) each."""
        first, given, _ = self._sizes
        return np.where(np.isnan(given), np.abs(p), given), first

    def others(self, p: Array) -> dict[str, Array]:
        """Return delay, distance ahead of the axle and limits by name, shape (K,) each, for p (K, P)."""
        known = {name: np.full(len(p), value) for name, value in self.given.items()}
        return known | {name: p[:, 6 + k] for k, name in enumerate(self.free)}

    def is_possible(self, p: Array) -> bool:
        """Return whether the numbers p, shape (P,), are possible and the delay is within its range."""
        late = self.others(p[None])["delay"][0] / self.dt
        return bool(np.isfinite(p).all() and self.are_possible(p) and -1 < late < self.lead)

    def are_possible(self, p: Array) -> Any:
        """Return which numbers, shape (..., P), a robot can have."""
        above = [k for k, one in enumerate(self.quantities) if k in ABOVE_ZERO or one.name in _LIMITS]
        return (p[..., above] > 0).all(axis=-1)

    def increments(self, p: Array) -> Array:
        """Return the steps of central differences, shape (P,)."""
        return _SLOPE * self.sizes(p)

    def resolved(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return the numbers of the rates, delays [samples] and the longest time step [s]."""
        others, theta = self.others(p), p[:, :6]
        numbers = np.column_stack([theta, others["ahead"], *(others[name] for name in _LIMITS)])[:, None]
        bends = _BENDS if np.isfinite(numbers[..., 7:]).any() else 1
        fastest = bends * (theta[:, [3, 5]] / theta[:, [0, 1]]).max()
        longest = self.dt / float(np.clip(self.dt * fastest / _FINE, 1, _MOST_STEPS))
        return numbers, others["delay"] / self.dt, longest

    def rates(self, z: Any, u: Any, numbers: Any) -> Any:
        """Return the rates of speed and yaw rate, and of x, y and psi if poses are measured."""
        faster = rates_of(numbers[:6], numbers[7:], z[:2], u)
        return np.concatenate([faster, rolling_of(numbers[6], z[2:], z[:2])]) if self.is_pose else faster

    def observed(self, segments: Segments, states: Array) -> Array:
        """Return the measurements: poses, or speed and yaw rate."""
        return states[..., 2:] if self.is_pose else states

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
        most = [others[name] for name in _LIMITS]
        return VelocityRobot(found.theta, others["ahead"], accelerations=most, source=source)

    def forces(self, found: Identification) -> list[Any]:
        """Return no forces: theta includes the losses."""
        return []

    def notes(self, found: Identification) -> list[str]:
        """Return notes on numbers that may be neutral, and on numbers that no robot can have."""
        bounds = found.interval()
        neutral = [n for n, x in _NEUTRAL.items() if bounds[n][0] <= x <= bounds[n][1]]
        told = [f"the interval of {n}{' - 1' * bool(_NEUTRAL[n])} contains zero" for n in neutral]
        if found.explained < _EXPLAINED:
            told.append(
                f"the model explains {found.explained:.0%} of the measurements: do commands and motion come "
                "from one robot, with times of one clock?"
            )
        if not found.unseen:
            pairs = zip(found.names, found.theta.tolist(), strict=False)
            told += VelocityRobot([_NEUTRAL[n] if n in neutral else x for n, x in pairs]).problems
        return told

    def predicted(
        self, found: Identification, log: Log, seconds: float | None
    ) -> tuple[Segments, Array, NDArray[np.bool_], Array]:
        """Return segments of a log, residuals, mask of good samples, and the noise."""
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
    """Estimate theta of a `VelocityRobot` from a log of its commands and its motion.

    The inputs of the log are commands of speed and yaw rate. The measurements are the twist if the log has
    one, such as from encoders, and otherwise the pose. The weak form of the equations gives first estimates
    and a first delay. Output error then fits simulations of segments of 2 s to the measurements. It weights
    residuals by their covariance and drops samples beyond six standard deviations.

    The confidence intervals come from the jackknife over segments with Student's t. They are also valid if
    the noise is correlated. They do not cover the error of a wrong model.

    Speed and yaw rate must change often and independently, for example by `controllers.RandomSteps`.

    Parameters
    ----------
    log : Log or sequence of Log
        Commands and motion, at least 20 segments of 2 s: 41 s or more.
    delay : float, optional
        Delay of measurements relative to commands [s]; default: estimated. The intervals of the other
        numbers then include the uncertainty of the delay.
    ahead : float, optional
        Distance of the measured point ahead of the axle [m]; None: estimated from poses.
    accelerations : array_like, shape () or (2,), optional
        Largest absolute accelerations of the firmware, of speed and yaw rate [m/s^2, rad/s^2]; infinite: no
        limit. None: estimated from a log that reaches the limits.

    Returns
    -------
    found : Identification
        Estimates of theta and of the further numbers.

    Raises
    ------
    InvalidArgument
        If the log is too short or from another robot, units are wrong, commands do not change or explain
        less than half of the motion, or an argument is out of range.

    See Also
    --------
    VelocityRobot : the model
    controllers.RandomSteps : commands for an informative log
    identify : the same for a robot with forces, torques or voltages as inputs

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold, Log, VelocityRobot
    >>> from pinmobile import identify_velocity, simulate
    >>> from pinmobile.controllers import RandomSteps
    >>> robot = VelocityRobot([0.4, 0.3, 0.0, 1.0, 0.0, 1.0])
    >>> still = FixedHeading(Hold((0, 0), duration=44), psi=0)
    >>> run = simulate(robot, RandomSteps(), still, dt=0.1)
    >>> found = identify_velocity(Log.from_rollout(run, noise=1e-4))
    >>> found.theta[:2].round(2)  # robot: 0.4 and 0.3 [s]
    array([0.4, 0.3])
    """
    logs = logs_of(log)
    segments, calm, runs = _cut(logs, _SECONDS, _LEAST_SEGMENTS)
    dt, lead, is_pose = runs[0].dt, _lead(runs), runs[0].twist is None
    if ahead is None and not is_pose:
        raise InvalidArgument("ahead is None, expected a number [m]: a log of twists does not identify it")
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
                f"log leads to {THETA[k][0]} = {found.p[k]:.3g} ({THETA[k][2].partition(':')[0]}), expected "
                "about 1: are commands in m/s and rad/s, positions in metres and psi in radians?"
            )
    covariance, good = np.zeros((len(p), len(p))), found.good
    hint = "; accelerations=None also needs a log that reaches both limits" * (accelerations is None)
    covariance[np.ix_(~lost, ~lost)] = jackknife(found.near._replace(J=found.near.J[..., ~lost]), hint=hint)
    listed = ", ".join(one.name for one, is_so in zip(model.quantities, lost, strict=True) if is_so)
    rank, white = int((~lost).sum()), Whiteness.of(found.near.residual * good[..., None], good)
    return Identification(
        model=model,
        phi=found.p,
        covariance_of_phi=covariance,
        freedom=len(good) - 1,
        rank=rank,
        unseen=f"the motion does not identify {listed}: rank {rank} of {len(p)}" if listed else "",
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
    """Return the mean squares of the residuals, and the explained share of speed or yaw rate (the worse)."""
    y, square = segments.y, (found.near.residual[found.good] ** 2).mean(axis=0)
    left, is_pose = square, y.shape[-1] == 3
    if is_pose:  # initial states are free: subtract a straight line in time
        t = np.linspace(-1.0, 1.0, y.shape[1])[:, None]
        y = y - y.mean(axis=1, keepdims=True)
        y = y - t * ((t * y).sum(axis=1, keepdims=True) / (t * t).sum())
    spent = y[found.good & calm].var(axis=0)
    if is_pose:  # the robot may move along one axis only
        left, spent = (np.array([each[:2].sum(), each[2]]) for each in (left, spent))
    commanded = np.ptp(segments.inputs[segments.at], axis=(0, 1)) > _STILL
    share = float(1 - (left / np.maximum(spent, 1e-300))[commanded].max(initial=0.0))
    if not share >= _LEAST:
        raise unexplained(share)
    return square, share


def _cut(
    logs: list[Log], seconds: float, least: int, is_pose: bool | None = None
) -> tuple[Segments, NDArray[np.bool_], list[Samples]]:
    """Return segments of a length [s], a mask of samples without gross outliers, and the checked logs."""
    for one in logs:
        if one.u.shape[1] != 2:
            raise InvalidArgument(
                f"log has {one.u.shape[1]} inputs, expected two, commands of speed and yaw rate: for forces, "
                "torques or voltages use identify"
            )
        check_units(one, "log", {"speed": "m/s", "yaw rate": "rad/s"})
    runs = [one.samples() for one in logs]
    is_pose = runs[0].twist is None if is_pose is None else is_pose
    if any((run.twist is None) != is_pose for run in runs):
        raise InvalidArgument("log has a twist, and another log has none, expected a twist in all or in none")
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
            f"log is {sum(float(run.t[-1]) for run in runs):.3g} s long, too short: it gives {len(found.y)} "
            f"segments of {seconds:g} s, expected at least {least}{' for valid intervals' * (least > 1)}: "
            f"a log of {(least + 0.5) * seconds:g} s or more"
        )
    if least > 1 and not (np.ptp(found.inputs, axis=0) > _STILL).any():
        raise InvalidArgument("log has constant commands, expected changing commands, such as RandomSteps")
    return found, np.concatenate(calms), runs


def _lead(runs: Sequence[Samples]) -> int:
    """Return the largest delay of a command [samples]."""
    dt = runs[0].dt
    return max(3, min(_MOST_LATE, round(_LATEST / dt), min(len(run.t) for run in runs) // 10))


def _guess(model: VelocityModel, runs: Sequence[Samples]) -> Array:
    """Return first estimates, shape (P,): theta and the delay by the weak form, without accelerations."""
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
    """Return measurements, shape (N, k), the same without gross outliers, and speed and yaw rate."""
    if run.twist is not None:
        return (run.twist[:, [0, 2]],) * 3
    y = np.asarray(run.q)
    calm, _, _ = without_outliers(y, run.seen, run.dt, _FINEST)
    return y, calm, twist_of(calm, run.dt)[:, [0, 2]]
