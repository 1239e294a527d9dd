"""`identify_velocity`: from a log of commands and motion to theta, with intervals that hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, bounded, positive, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.identification.estimator import (
    Segments,
    differences,
    jackknife,
    runge_kutta,
    solve_robustly,
    unexplained,
)
from pinmobile.identification.log import Log, Samples, check_steps, check_units, logs_of
from pinmobile.identification.model import Quantity
from pinmobile.identification.preprocessing import mean_inputs, twist_of, without_outliers
from pinmobile.identification.result import Identification, check_seen
from pinmobile.identification.statistics import POSE, SPEEDS, whiteness
from pinmobile.identification.velocity_robot import (
    ABOVE_ZERO,
    THETA,
    VelocityRobot,
    rates_of,
    rolling_of,
)
from pinmobile.identification.weak_form import Bump, fitted, scanned

_LEAST_SEGMENTS = 20
_LATEST = 0.6  # [s]: longest delay that is looked for
_MOST_LATE = 60  # the same in samples
_STILL = 1e-9  # [m/s, rad/s]: commands that change less do not
_TOGETHER = 0.2  # correlation of residuals of neighbouring samples that is more than noise
_EXPLAINED = 0.8  # share of what was measured, below which something else is wrong
_LEAST = 0.5  # the same, below which it is no log of such a robot
_GAINS = 0.1, 10.0  # command per steady speed or yaw rate of any robot
_FARTHEST = 10.0  # [m]: ahead of the axle
_NEUTRAL = {"theta_3": 0.0, "theta_4": 1.0, "theta_5": 0.0, "theta_6": 1.0}  # of a robot that loses nothing
_WINDOW = 0.8  # [s] of the weak form that gives a start
_FINEST = 1e-4  # [m, rad]: finer noise of poses, as of a simulation, counts as this
_FINE = 0.3  # of the shortest time constant: longest step of Runge and Kutta
_BENDS = 4  # times as many where a limit of acceleration ends within one
_MOST_STEPS = 40  # of it per sample, on the way through values that nobody means
_SLOPE = 1e-4  # of the size of a number, by which differences are taken
_COUPLING = [2, 4]  # theta_3 and theta_5
_LIMITS = "acceleration", "yaw_acceleration"
_QUANTITIES = {
    **{name: Quantity(name, unit, meaning, False, f"theta.{name}") for name, unit, meaning in THETA},
    "delay": Quantity("delay", "s", "delay of measurements", False),
    "ahead": Quantity("ahead", "m", "how far the origin is ahead of the axle", False, "ahead"),
    _LIMITS[0]: Quantity(_LIMITS[0], "m/s^2", "largest |u'|", False, f"accelerations.{_LIMITS[0]}"),
    _LIMITS[1]: Quantity(_LIMITS[1], "rad/s^2", "largest |w'|", False, f"accelerations.{_LIMITS[1]}"),
}
_SIZES = {  # value where a log tells nothing, size where it is not that of the number, least size
    **dict.fromkeys(("theta_1", "theta_2"), (0.3, np.nan, 1e-6)),
    **dict.fromkeys(("theta_4", "theta_6"), (1.0, np.nan, 1e-6)),
    **dict.fromkeys(("theta_3", "theta_5"), (0.0, 1.0, 0.1)),
    **{"delay": (0.0, 0.3, 0.1), "ahead": (0.0, 1.0, 0.1)},
    **{_LIMITS[0]: (1.0, np.nan, 1e-3), _LIMITS[1]: (3.0, np.nan, 1e-3)},
}


@dataclass(frozen=True, eq=False)
class VelocityModel:
    """A robot that takes speeds for commands: theta, and what else is identified.

    Parameters
    ----------
    free : tuple of str
        Of ``"delay"``, ``"ahead"``, ``"acceleration"`` and ``"yaw_acceleration"``, in this order.
    lead : int
        Largest delay, in samples.
    delay, ahead : float
        Where they are not identified [s, m].
    accelerations : ndarray, shape (2,)
        Likewise [m/s^2, rad/s^2].
    dt : float
        Time between two samples [s].
    is_pose : bool
        Whether poses are measured, else speed and yaw rate.
    """

    free: tuple[str, ...]
    lead: int
    delay: float
    ahead: float
    accelerations: Array
    dt: float
    is_pose: bool

    told_first: ClassVar[int] = 6
    stated_constants: ClassVar[tuple[float, ...]] = ()

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What is identified."""
        return tuple(_QUANTITIES[name] for name in [*[row[0] for row in THETA], *self.free])

    @cached_property
    def _sizes(self) -> Array:
        """Rows of values where a log tells nothing, natural sizes, and least ones, shape (3, P)."""
        return np.asarray([_SIZES[one.name] for one in self.quantities]).T

    @property
    def measured(self) -> tuple[tuple[str, str], ...]:
        """Names and units of what is measured."""
        return POSE if self.is_pose else SPEEDS

    def sizes(self, p: Array) -> Array:
        """Return the sizes of numbers like p, shape (P,), by which differences are taken."""
        return np.asarray(np.maximum(np.abs(p), self._sizes[2]))

    def natural(self, p: Array) -> tuple[Array, Array]:
        """Return how large numbers like p, shape (P,), are, and what they are where nothing is known."""
        first, given, _ = self._sizes
        return np.where(np.isnan(given), np.abs(p), given), first

    def values(self, p: Array) -> tuple[Array, Array, Array, Array]:
        """Return theta (K, 6), delay (K,) [s], ahead (K,), accelerations (K, 2) of numbers p (K, P)."""
        named = {name: p[:, 6 + k] for k, name in enumerate(self.free)}
        still = np.zeros(len(p))
        most = [named.get(name, still + self.accelerations[k]) for k, name in enumerate(_LIMITS)]
        delay, ahead = named.get("delay", still + self.delay), named.get("ahead", still + self.ahead)
        return p[:, :6], delay, ahead, np.stack(most, axis=-1)

    def is_possible(self, p: Array) -> bool:
        """Return whether there is a robot of such numbers, shape (P,), that is not too late."""
        late = self.values(p[None])[1][0] / self.dt
        return bool(np.isfinite(p).all() and self.are_possible(p) and -1 < late < self.lead)

    def are_possible(self, p: Array) -> Any:
        """Return which numbers, shape (..., P), are of a robot."""
        above = [k for k, one in enumerate(self.quantities) if k in ABOVE_ZERO or one.name in _LIMITS]
        return (p[..., above] > 0).all(axis=-1)

    def linearize(self, segments: Segments, p: Array, starts: Array) -> tuple[Array, Array]:
        """Return the simulation and its slopes."""
        return differences(self, segments, p, starts, _SLOPE * self.sizes(p))

    @np.errstate(all="ignore")  # on the way through values that nobody means
    def simulate(self, segments: Segments, p: Array, starts: Array) -> Array:
        """Return what would be measured, shape (K, S, L, k), of p (K, P) and starts (K, S, n).

        A first state is speed and yaw rate, and behind them x, y and psi where poses are measured.
        """
        theta, delay, ahead, most = self.values(p)
        law = partial(_rates, theta[:, None], ahead[:, None], most[:, None])
        late = delay / self.dt
        whole = np.floor(late + 1e-9).astype(int)
        share = np.maximum(late - whole, 0.0)[:, None, None]
        max_path_speed = (theta[:, [3, 5]] / theta[:, [0, 1]]).max()
        bends = _BENDS if np.isfinite(most).any() else 1
        steps = bends * int(np.clip(np.ceil(self.dt * max_path_speed / _FINE), 1, _MOST_STEPS))
        length = segments.y.shape[1]
        first, then = segments.applied(whole + 1, length - 1), segments.applied(whole, length - 1)
        z, kept = starts, np.empty((length, *starts.shape))
        kept[0] = z
        for j in range(length - 1):
            for u, span in ((first, share), (then, 1 - share)) if share.any() else ((then, 1.0),):
                z = runge_kutta(partial(law, u[:, :, j]), z, span * self.dt / steps, steps)
            kept[j + 1] = z
        return np.moveaxis(kept[..., 2:] if self.is_pose else kept, 0, 2)

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
        check_seen("robot", found.unseen)
        theta, _, ahead, most = self.values(found.phi[None])
        source = f"identified from {found.samples} samples in {found.segments} segments"
        return VelocityRobot(theta[0], float(ahead[0]), accelerations=most[0], source=source)

    def forces(self, found: Identification) -> list[Any]:
        """Return none: losses are in theta."""
        return []

    def notes(self, found: Identification) -> tuple[str, ...]:
        """Return which numbers may be none, and what no robot has."""
        told, bounds = [], found.interval()
        neutral = [n for n, x in _NEUTRAL.items() if bounds[n][0] <= x <= bounds[n][1]]
        told += [f"{n}{' - 1' * bool(_NEUTRAL[n])} may as well be zero" for n in neutral]
        if found.explained < _EXPLAINED:
            told.append(
                f"the model explains {found.explained:.0%} of what was measured: are commands and motion of "
                "one robot, and by one clock?"
            )
        if not found.unseen:
            pairs = zip(found.names, found.theta.tolist(), strict=False)
            told += VelocityRobot([_NEUTRAL[n] if n in neutral else x for n, x in pairs]).problems
        return tuple(told)

    def predicted(
        self, found: Identification, log: Log, seconds: float | None
    ) -> tuple[Segments, Array, NDArray[np.bool_], Array]:
        """Return segments of a log, measured less simulated, which samples count, and what was left."""
        length = found.seconds if seconds is None else scalar("seconds", seconds)
        segments, calm, _ = _cut([log], length, 1, self.is_pose)
        model = replace(self, dt=float(segments.dt[0]), lead=segments.lead - 1)
        left, _ = solve_robustly(model, segments, found.phi, calm=calm)
        return segments, left.near.residual, left.good, found.noise


def _rates(theta: Array, ahead: Array, most: Array, u: Array, z: Array) -> Array:
    """Return the rates of first states z, shape (K, S, n)."""
    parts = [rates_of(theta, most, z[..., :2], u)]
    parts += [rolling_of(ahead, z[..., 2:], z[..., :2])] if z.shape[-1] > 2 else []
    return np.concatenate(parts, axis=-1)


def identify_velocity(
    log: Log | Sequence[Log],
    *,
    delay: float | None = None,
    ahead: float | None = 0.0,
    accelerations: ArrayLike | None = np.inf,
    seconds: float = 2.0,
) -> Identification:
    """Return the theta of a `VelocityRobot` that a log of its commands and its motion tells.

    The input of the log are commands, speed and yaw rate; what was measured is the twist where it has one,
    such as encoders tell, else the pose. Output error: the model is simulated over segments, from states that
    are free, and differs least from what was measured, weighted by the covariance of what is left, without
    samples beyond six deviations. Intervals are by the jackknife over segments and Student's t, and hold
    where noise is correlated too; they do not cover the error of a wrong structure. The delay is found by the
    weak form first.

    It takes motion in which speed and yaw rate change often and independently, such as that of `RandomSteps`.

    Parameters
    ----------
    log : Log, or sequence of these
        Of commands; 20 segments and more.
    delay : float, optional
        By which what is measured follows a command, beside what theta says, where it is known [s]; None: it
        is identified, and intervals of the rest take it into account.
    ahead : float, optional
        How far the point whose pose was measured is ahead of the axle [m]; None: it is identified from poses.
    accelerations : array_like, shape () or (2,), optional
        Largest |u'| and |w'| that the firmware allows [m/s^2, rad/s^2]; None: they are identified, from a log
        in which they are reached.
    seconds : float
        Length of a segment [s].

    Raises
    ------
    InvalidArgument
        If the log is too short, its input is of another robot or in other units, commands do not change or
        explain less than half of the motion, or an argument is not in its range.
    """
    logs = logs_of(log)
    segments, calm, runs = _cut(logs, positive("seconds", seconds, "s"), _LEAST_SEGMENTS)
    dt, lead, is_pose = runs[0].dt, _lead(runs), runs[0].twist is None
    known = 0.0 if ahead is None else scalar("ahead", ahead)
    bounded("ahead", known, least=-_FARTHEST, most=_FARTHEST, unit="m")
    if delay is not None:
        bounded("delay", scalar("delay", delay), least=0, most=lead * dt, unit="s")
    if ahead is None and not is_pose:
        raise InvalidArgument("ahead is None, and the log measures a twist, which does not tell it: give it")
    sought = {"delay": delay is None, "ahead": ahead is None, **dict.fromkeys(_LIMITS, accelerations is None)}
    free = tuple(name for name, is_so in sought.items() if is_so)
    most = VelocityRobot(
        np.ones(6), accelerations=np.inf if accelerations is None else accelerations
    ).accelerations
    model = VelocityModel(
        free, lead, 0.0 if delay is None else scalar("delay", delay), known, most, dt, is_pose
    )
    p = _guess(model, runs)
    if not np.isfinite(model.simulate(segments, p[None], segments.start[None])).all():
        p[_COUPLING] = 0.0  # without it nothing grows
    try:
        found, lost = solve_robustly(model, segments, p, calm=calm, natural=model.natural)
    except np.linalg.LinAlgError:
        raise unexplained(0.0) from None
    residual, good = found.near.residual, found.good
    square = (residual[good] ** 2).mean(axis=0)
    explained = _explained(segments, square, good & calm)
    if not explained >= _LEAST:
        raise unexplained(explained)
    for k in (3, 5):
        if not (lost[k] or _GAINS[0] < found.p[k] < _GAINS[1]):
            raise InvalidArgument(
                f"log leads to {THETA[k][0]}, {THETA[k][2].partition(':')[0]}, of {found.p[k]:.3g}, expected "
                "about 1: are commands in m/s and rad/s, positions in metres and psi in radians?"
            )
    covariance = np.zeros((len(p), len(p)))
    covariance[np.ix_(~lost, ~lost)] = jackknife(found.near._replace(J=found.near.J[..., ~lost]))
    names = [one.name for one in model.quantities]
    listed = ", ".join(name for name, is_so in zip(names, lost, strict=True) if is_so)
    rank, white = int((~lost).sum()), whiteness(residual * good[..., None], good)
    late, error = (float(x) for x in (model.values(found.p[None])[1][0], np.nan))
    if "delay" in free:
        error = float(np.sqrt(covariance[6, 6]))
    unseen = f"the motion tells nothing of {listed}: rank {rank} of {len(p)}" if listed else ""
    outliers, dropped = int((segments.good & ~good).sum()), sum(one.dropped for one in logs)
    is_noise = bool(np.abs(white.correlation).max() <= _TOGETHER)
    own: dict[str, Any] = {
        **{"freedom": len(good) - 1, "rank": rank, "unseen": unseen, "hidden": lost.astype(float)},
        **{"unknown": np.zeros((len(p), 0)), "delay": late, "delay_error": error, "dt": dt},
        **{"outliers": outliers, "dropped": dropped, "samples": int(good.sum()), "segments": len(good)},
        **{"noise": np.sqrt(square), "residual": np.sqrt(square), "whiteness": white, "is_noise": is_noise},
    }
    return Identification(model, found.p, covariance, explained=explained, seconds=seconds, **own)


def _explained(segments: Segments, square: Array, good: NDArray[np.bool_]) -> float:
    """Return the share that is not left over, of the worse of speed and yaw rate that are commanded."""
    y, is_pose = segments.y, segments.y.shape[-1] == 3
    if is_pose:  # starts are free: what straight lines in time leave
        t = np.linspace(-1.0, 1.0, y.shape[1])[:, None]
        y = y - y.mean(axis=1, keepdims=True)
        y = y - t * ((t * y).sum(axis=1, keepdims=True) / (t * t).sum())
    spent = y[good].var(axis=0)
    if is_pose:  # a robot may go along one axis
        square, spent = (np.array([each[:2].sum(), each[2]]) for each in (square, spent))
    commanded = np.ptp(segments.inputs[segments.at], axis=(0, 1)) > _STILL
    return float(1 - (square / np.maximum(spent, 1e-300))[commanded].max(initial=0.0))


def _cut(
    logs: list[Log], seconds: float, least: int, is_pose: bool | None = None
) -> tuple[Segments, NDArray[np.bool_], list[Samples]]:
    """Return segments of so many seconds with known commands, where they are calm, and the logs checked."""
    for one in logs:
        if one.u.shape[1] != 2:
            raise InvalidArgument(
                f"log has {one.u.shape[1]} inputs, expected two, commands of speed and yaw rate: is it of "
                "a robot that takes forces? Then identify"
            )
        check_units(one, "log", {"speed": "m/s", "yaw rate": "rad/s"})
    runs = [one.samples() for one in logs]
    if (
        len({is_pose if is_pose is not None else runs[0].twist is None, *(run.twist is None for run in runs)})
        > 1
    ):
        raise InvalidArgument("log measures a twist, and another one a pose, expected the same of all")
    check_steps([run.dt for run in runs])
    dt, lead = runs[0].dt, _lead(runs) + 1
    bounded("seconds", seconds, least=3 * dt, unit="s")
    length, parts, calms = max(3, round(seconds / dt)), [], []
    for run in runs:
        y, calm, nu = _read(run)
        states = np.concatenate([nu, calm] if run.twist is None else [nu], axis=-1)
        how = {"length": length, "first": lead, "stop": len(y), "lead": lead, "more": 1}
        parts.append(Segments.cut(dt, y, run.seen, states, run.u, **how))
        whole = (calm == y).all(axis=-1)[lead : lead + len(parts[-1].y) * length]
        calms.append(whole.reshape(-1, length))
    found = Segments.joined(parts)
    if len(found.y) < least:
        raise InvalidArgument(
            f"log is {sum(float(run.t[-1]) for run in runs):.3g} s long, which gives {len(found.y)} segments "
            f"of {seconds:g} s, too short: expected {least}, so that intervals hold: "
            f"{(least + 0.5) * seconds:g} s and more"
        )
    if least > 1 and not (np.ptp(found.inputs, axis=0) > _STILL).any():
        raise InvalidArgument("log has commands that never change, expected excitation, such as RandomSteps")
    return found, np.concatenate(calms), runs


def _lead(runs: Sequence[Samples]) -> int:
    """Return how many samples late a command may act."""
    dt = runs[0].dt
    return max(3, min(_MOST_LATE, round(_LATEST / dt), min(len(run.t) for run in runs) // 10))


def _guess(model: VelocityModel, runs: Sequence[Samples]) -> Array:
    """Return the first numbers, shape (P,): theta and the delay by the weak form, without rates of speeds."""
    prior, dt = model._sizes[0], model.dt
    bump, nus = Bump.of(_WINDOW, dt), [_read(run)[2] for run in runs]
    rows = []
    for u, w in (nu.T for nu in nus):
        zero, over = np.zeros(len(bump.over(u))), bump.over
        ahead = [-over(u, 1), zero, -over(w * w), over(u), zero, zero]
        rows.append(
            np.stack(
                [np.stack(ahead, -1), np.stack([zero, -over(w, 1), zero, zero, over(u * w), over(w)], -1)], 1
            )
        )
    Y, counts = np.concatenate(rows), [len(each) for each in rows]

    def fit(late: float) -> Any:
        edges = [np.asarray(np.arange(len(nu) + 1.0) - 0.5 - late, np.float64) for nu in nus]
        y = [bump.over(mean_inputs(run.u, each)) for run, each in zip(runs, edges, strict=True)]
        return fitted(Y, np.concatenate(y), counts, prior[:6], np.eye(6), 2)[0]

    late = model.delay / dt
    if "delay" in model.free:
        _, late, _ = scanned(fit, np.arange(float(model.lead)))
    theta = fit(late).phi
    theta[list(ABOVE_ZERO)] = np.maximum(theta[list(ABOVE_ZERO)], 0.02)
    rates = np.concatenate([np.abs(np.gradient(nu, dt, axis=0)) for nu in nus])
    steep = dict(zip(_LIMITS, np.quantile(rates, 0.9, axis=0) + 1e-3, strict=True))
    return np.append(theta, [{"delay": late * dt, "ahead": 0.0, **steep}[name] for name in model.free])


def _read(run: Samples) -> tuple[Array, Array, Array]:
    """Return what a log measured, shape (N, k), gross outliers of poses bridged, and speed and yaw rate."""
    if run.twist is not None:
        return (run.twist[:, [0, 2]],) * 3
    y = np.asarray(run.q)
    calm, _, _ = without_outliers(y, run.seen, run.dt, _FINEST)
    return y, calm, twist_of(calm, run.dt)[:, [0, 2]]
