"""`identify_velocity`: from a log of commands and motion to theta, with intervals that hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, affordable, frozen, instance, positive, scalar, seeded, whole
from pinmobile.errors import InvalidArgument
from pinmobile.identification.log import Log, Samples, check_steps, check_units, logs_of
from pinmobile.identification.statistics import POSE, SPEEDS, Prediction, student_deviations, student_draws
from pinmobile.identification.velocity_fit import (
    Fit,
    Model,
    Segments,
    cut,
    fit,
    guess,
    scaled,
    speeds,
    unexplained,
)
from pinmobile.identification.velocity_robot import ABOVE_ZERO, THETA, VelocityRobot, limits_of

_LEAST_SEGMENTS = 20
_LATEST = 0.6  # [s]: longest delay that is looked for
_MOST_LATE = 60  # the same in samples
_STILL = 1e-9  # [m/s, rad/s]: commands that change less do not
_TOGETHER = 0.2  # correlation of residuals of neighbouring samples that is told
_EXPLAINED = 0.8  # share of what was measured, below which something else is wrong
_LEAST = 0.5  # the same, below which it is no log of such a robot
_GAINS = 0.1, 10.0  # command per steady speed or yaw rate of any robot
_FARTHEST = 10.0  # [m]: ahead of the axle
_OTHERS = (("delay", "s"), ("ahead", "m"), ("acceleration", "m/s^2"), ("yaw_acceleration", "rad/s^2"))
_NEUTRAL = {"theta_3": 0.0, "theta_4": 1.0, "theta_5": 0.0, "theta_6": 1.0}  # of a robot that loses nothing
_UNITS = {**{name: unit for name, unit, _ in THETA}, **dict(_OTHERS)}
_MEASURED = {len(each): each for each in (SPEEDS, POSE)}


@final
@dataclass(frozen=True, eq=False, repr=False)
class VelocityIdentification:
    """The theta of a robot that takes speeds for commands, as a log tells it. `identify_velocity` makes it.

    Attributes
    ----------
    names : tuple of P str
        theta_1 to theta_6, and what else was identified.
    values : ndarray, shape (P,)
        Of these.
    covariance : ndarray, shape (P, P)
        Of these, by the jackknife over segments (CR3); infinite where the log tells nothing.
    segments, samples : int
        How many were used.
    outliers, dropped : int
        Samples left out as outliers, and rows that held no numbers.
    delay : float
        By which what is measured follows a command, beside what theta says [s].
    noise : ndarray, shape (k,)
        Deviation of what is left of speed and yaw rate, or of x, y and psi.
    correlation : ndarray, shape (k,)
        Of what is left at neighbouring samples: near 0 where it is sensors' noise.
    explained : float
        Share of what was measured that the model explains, of the worse of speed and yaw rate; of poses, of
        what is no straight line in time.
    hidden : tuple of str
        Names of what the motion tells nothing of.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    segments: int
    samples: int
    outliers: int
    dropped: int
    delay: float
    noise: Array
    correlation: Array
    explained: float
    hidden: tuple[str, ...]
    _model: Model = field(repr=False)
    _seconds: float = field(repr=False)

    @property
    def parameters(self) -> Mapping[str, float]:
        """The estimates by name."""
        return self._named(self.values)

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the parameters by name."""
        return MappingProxyType({name: _UNITS[name] for name in self.names})

    def _named(self, values: Array) -> Mapping[str, float]:
        return MappingProxyType(dict(zip(self.names, values.tolist(), strict=True)))

    @property
    def unseen(self) -> str:
        """What the motion does not tell, in words; "" where it tells all."""
        told = f"the motion tells nothing of {', '.join(self.hidden)}: rank {self.rank} of {len(self.names)}"
        return told if self.hidden else ""

    @property
    def theta(self) -> Array:
        """The six, shape (6,)."""
        return self.values[:6]

    @property
    def rank(self) -> int:
        """Of how many of the numbers the motion tells something."""
        return len(self.names) - len(self.hidden)

    @property
    def standard_errors(self) -> Mapping[str, float]:
        """Of the parameters by name; infinite of what is unseen."""
        return self._named(np.sqrt(np.diag(self.covariance)))

    def interval(self, level: float = 0.95) -> Mapping[str, tuple[float, float]]:
        """Return an interval of each parameter that holds the true one in a share of all logs, by name.

        It is Student's, with one degree of freedom less than there are segments.

        Parameters
        ----------
        level : float
            The share, in (0, 1).

        Raises
        ------
        InvalidArgument
            If the level is not between 0 and 1.
        """
        wide = student_deviations(level, self.segments - 1)
        errors = self.standard_errors
        pairs = ((name, x, wide * errors[name]) for name, x in self.parameters.items())
        return MappingProxyType({name: (x - half, x + half) for name, x, half in pairs})

    @cached_property
    def insignificant(self) -> tuple[str, ...]:
        """Of theta_3 and theta_5, and losses theta_4 - 1 and theta_6 - 1, those that may well be zero."""
        bounds = self.interval()
        return tuple(
            f"{name} - 1" if none else name
            for name, none in _NEUTRAL.items()
            if bounds[name][0] <= none <= bounds[name][1]
        )

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What else there is to know, a sentence each."""
        found = [self.unseen] if self.unseen else []
        found += [f"{name} may as well be zero" for name in self.insignificant]
        if self.explained < _EXPLAINED:
            found.append(
                f"the model explains {self.explained:.0%} of what was measured: are commands and motion of "
                "one robot, and by one clock?"
            )
        worst = float(np.abs(self.correlation).max())
        if worst > _TOGETHER:
            found.append(
                f"what is left hangs together from sample to sample (correlation {worst:.2f}): more than "
                "sensors' noise is in it, such as slip or limits of the firmware"
            )
        if not self.unseen:
            names = {name.removesuffix(" - 1") for name in self.insignificant}
            possible = [
                _NEUTRAL[n] if n in names else x for n, x in zip(self.names[:6], self.theta, strict=True)
            ]
            found += VelocityRobot(possible).problems
        return tuple(found)

    def __repr__(self) -> str:
        told = ", ".join(f"{x:.4g}" for x in self.theta)
        return f"<VelocityIdentification: theta {told}, {self.segments} segments>"

    def __str__(self) -> str:
        lines = [
            f"{self.samples} samples in {self.segments} segments of {self._seconds:g} s; {self.outliers} "
            f"outliers left out, {self.dropped} rows dropped",
            f"{'':17}{'value':>10} {'std. error':>11}  95 % interval",
        ]
        bounds, errors = self.interval(), self.standard_errors
        for name, value in self.parameters.items():
            low, high = bounds[name]
            told = f"{low:.5f} to {high:.5f} {self.units[name]}".rstrip()
            lines.append(f"{name:17}{value:10.5f} {errors[name]:11.2g}  {told}")
        if "delay" not in self.names:
            lines.append(f"delay {self.delay:g} s, given")
        left = ", ".join(
            f"{name} {noise:.2g} {unit}"
            for (name, unit), noise in zip(_MEASURED[len(self.noise)], self.noise, strict=True)
        )
        lines.append(f"left over: {left}")
        return "\n".join([*lines, *self.notes])

    def robot(self) -> VelocityRobot:
        """Return the robot, without the delay.

        Raises
        ------
        InvalidArgument
            If the motion tells nothing of some of its numbers.
        """
        self._refuse_unseen("robot")
        _, _, ahead, most = self._model.values(self.values[None])
        source = f"identified from {self.samples} samples in {self.segments} segments"
        return VelocityRobot(self.theta, float(ahead[0]), accelerations=most[0], source=source)

    def spread(self, n: int, seed: Any = 0) -> dict[str, Array]:
        """Return n joint draws of the robot's numbers by name: the spread of an `ensemble` of n robots.

        Names are those of a spread, such as ``"theta.theta_1"``. Draws are of Student's t, as the intervals;
        those that no robot can have are drawn again.

        Parameters
        ----------
        n : int
            How many.
        seed : int, SeedSequence, BitGenerator or Generator
            Of the draws.

        Raises
        ------
        InvalidArgument
            As `robot`; or if most draws are none of a robot.
        """
        self._refuse_unseen("spread")
        n, generator = whole("n", n), seeded("seed", seed)
        affordable(f"spread: {n:,} draws", 4.0 * n * len(self.names), "draw fewer at a time")
        more = 1e-18 * np.diag(np.diag(self.covariance))
        root = np.asarray(np.linalg.cholesky(self.covariance + more), np.float64)
        least = [k for k, name in enumerate(self.names) if k in ABOVE_ZERO or "acceleration" in name]
        found = student_draws(
            n, self.values, root, self.segments - 1, generator, lambda x: (x[:, least] > 0).all(axis=1)
        )
        if len(found) < n:
            raise InvalidArgument("spread: intervals reach far below zero, expected a log that tells more")
        return {_path(name): found[:, k] for k, name in enumerate(self.names) if name != "delay"}

    def _refuse_unseen(self, what: str) -> None:
        if self.unseen:
            raise InvalidArgument(
                f"{what} is asked, and the log tells nothing of {', '.join(self.hidden)}: expected one in "
                "which speed and yaw rate change independently"
            )

    def predict(self, log: Log) -> Prediction:
        """Return how well another log is predicted over segments, whose first states alone are fitted.

        Parameters
        ----------
        log : Log
            Another log of the same robot, which measures what that measured from which it was identified.

        Raises
        ------
        InvalidArgument
            If it is none, too short, measures something else, or what is predicted runs away from it.
        """
        instance("log", log, Log, "a Log")
        runs = _runs(log, least=1, seconds=self._seconds, kind=len(self.noise))
        cuts = cut(runs, self._seconds, _lead(runs))
        in_samples = np.where(np.array(self.names) == "delay", self.values / runs[0].dt, self.values)
        left = fit(self._model, cuts, in_samples, moving=False)
        rms = np.sqrt((left.residual[left.good] ** 2).mean(axis=0))
        names, units = zip(*_MEASURED[len(self.noise)], strict=True)
        return Prediction(names, units, cuts.t, cuts.y, cuts.y - left.residual, rms, self.noise)


def identify_velocity(
    log: Log | Sequence[Log],
    *,
    delay: float | None = None,
    ahead: float | None = 0.0,
    accelerations: ArrayLike | None = np.inf,
    seconds: float = 2.0,
) -> VelocityIdentification:
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
    seconds = positive("seconds", seconds, "s")
    runs = _runs(log, least=_LEAST_SEGMENTS, seconds=seconds)
    dt, lead = runs[0].dt, _lead(runs)
    given = None if delay is None else scalar("delay", delay) / dt
    if given is not None and not 0 <= given <= lead:
        raise InvalidArgument(f"delay is {delay} s, expected 0 to {lead * dt:.3g} s, or None")
    known = 0.0 if ahead is None else scalar("ahead", ahead)
    if abs(known) > _FARTHEST:
        raise InvalidArgument(f"ahead is {known:g} m, expected at most {_FARTHEST:g} m to either side")
    if ahead is None and runs[0].twist is not None:
        raise InvalidArgument("ahead is None, and the log measures a twist, which does not tell it: give it")
    free = [name for name, of in (("delay", delay), ("ahead", ahead)) if of is None]
    free += [name for name, _ in _OTHERS[2:]] if accelerations is None else []
    most = np.full(2, np.inf)
    if accelerations is not None:
        most[:] = limits_of("accelerations", accelerations)
    theta, late = guess(runs, lead, given)
    others = {"delay": late, "ahead": 0.0, **_steepest(runs)}
    start = np.append(theta, [others[name] for name in free])
    fixed = 0.0 if given is None else given
    model = Model(tuple(free), fixed, known, frozen(most))
    cuts = cut(runs, seconds, lead)
    first = fit(model, cuts, start)
    dropped = sum(one.dropped for one in logs_of(log))
    return _told(model, cuts, first, runs[0].dt, seconds, dropped)


def _told(
    model: Model, cuts: Segments, found: Fit, dt: float, seconds: float, dropped: int
) -> VelocityIdentification:
    names = (*(name for name, _, _ in THETA), *model.free)
    unit = np.where(np.array(names) == "delay", dt, 1.0)
    residual, good = found.residual, found.good
    pairs = good[:, 1:] & good[:, :-1]
    square = (residual[good] ** 2).mean(axis=0)
    along = (residual[:, 1:] * residual[:, :-1])[pairs].mean(axis=0) / np.maximum(square, 1e-300)
    explained = _explained(cuts, square, good)
    if not explained >= _LEAST:
        raise unexplained(explained)
    _check_units(found)
    delay = model.values(found.p[None])[1][0] * dt
    return VelocityIdentification(
        names,
        frozen(found.p * unit),
        frozen(_covariance(found) * np.outer(unit, unit)),
        len(cuts.y),
        int(good.sum()),
        int((cuts.good & ~good).sum()),
        dropped,
        float(delay),
        frozen(np.sqrt(square)),
        frozen(along),
        explained,
        tuple(name for name, hidden in zip(names, found.unseen, strict=True) if hidden),
        model,
        seconds,
    )


def _check_units(found: Fit) -> None:
    for k in (3, 5):
        gain, (name, _, meaning) = float(found.p[k]), THETA[k]
        if not (found.unseen[k] or _GAINS[0] < gain < _GAINS[1]):
            raise InvalidArgument(
                f"log leads to {name}, {meaning.partition(':')[0]}, of {gain:.3g}, expected about 1: are "
                "commands in m/s and rad/s, positions in metres and psi in radians?"
            )


def _explained(cuts: Segments, square: Array, good: NDArray[np.bool_]) -> float:
    """Return the share that is not left over, of the worse of speed and yaw rate that are commanded."""
    spent = (_bent(cuts.calm) if cuts.is_pose else cuts.y)[good].var(axis=0)
    if cuts.is_pose:  # a robot may go along one axis
        square, spent = (np.array([each[:2].sum(), each[2]]) for each in (square, spent))
    commanded = np.ptp(cuts.u, axis=(0, 1)) > _STILL
    return float(1 - (square / np.maximum(spent, 1e-300))[commanded].max(initial=0.0))


def _bent(poses: Array) -> Array:
    """Return what straight lines in time leave of segments of poses, shape (S, L, k): starts are free."""
    t = np.linspace(-1.0, 1.0, poses.shape[1])[:, None]
    centred = poses - poses.mean(axis=1, keepdims=True)
    return np.asarray(centred - t * ((t * centred).sum(axis=1, keepdims=True) / (t * t).sum()))


def _covariance(found: Fit) -> Array:
    """Return the covariance by the jackknife over segments, CR3 (Bell and McCaffrey 2002), shape (P, P)."""
    seen = ~found.unseen
    J, e, S = found.J[..., seen], found.e, len(found.J)
    H = np.einsum("smp,smq->spq", J, J)
    _, size = scaled(H.sum(axis=0))
    others = (H.sum(axis=0) - H) * np.outer(size, size)
    g = np.einsum("smp,sm->sp", J, e) * size
    d = (np.linalg.pinv(others, hermitian=True) @ g[..., None])[..., 0] * size
    covariance = np.diag(np.where(seen, 0.0, np.inf))
    covariance[np.ix_(seen, seen)] = (S - 1) / S * d.T @ d
    return covariance


def _runs(log: Log | Sequence[Log], *, least: int, seconds: float, kind: int = 0) -> list[Samples]:
    """Return logs on equal steps, checked."""
    logs = logs_of(log)
    for one in logs:
        if one.u.shape[1] != 2:
            raise InvalidArgument(
                f"log has {one.u.shape[1]} inputs, expected two, commands of speed and yaw rate: is it of "
                "a robot that takes forces? Then identify"
            )
        check_units(one, "log", {"speed": "m/s", "yaw rate": "rad/s"})
    runs = [one.samples() for one in logs]
    if len({run.twist is None for run in runs}) > 1 or (
        kind and {2: False, 3: True}[kind] != (runs[0].twist is None)
    ):
        raise InvalidArgument("log measures a twist, and another one a pose, expected the same of all")
    steps = [run.dt for run in runs]
    check_steps(steps)
    if seconds < 3 * steps[0]:
        raise InvalidArgument(f"seconds is {seconds:g}, expected 3 samples of {steps[0]:g} s and more")
    count = len(cut(runs, seconds, _lead(runs)).y)
    if count < least:
        last = sum(float(run.t[-1]) for run in runs)
        raise InvalidArgument(
            f"log is {last:.3g} s long, which gives {count} segments of {seconds:g} s, too short: expected "
            f"{least}, so that intervals hold: {(least + 0.5) * seconds:g} s and more"
        )
    u = np.concatenate([run.u for run in runs])
    if least > 1 and not (np.ptp(u, axis=0) > _STILL).any():
        raise InvalidArgument("log has commands that never change, expected excitation, such as RandomSteps")
    return runs


def _lead(runs: Sequence[Samples]) -> int:
    """Return how many samples late a command may act."""
    dt = runs[0].dt
    return max(3, min(_MOST_LATE, round(_LATEST / dt), min(len(run.t) for run in runs) // 10))


def _steepest(runs: Sequence[Samples]) -> dict[str, float]:
    """Return the accelerations that are hardly exceeded: where a search for limits begins."""
    rates = np.concatenate([np.abs(np.gradient(speeds(run), run.dt, axis=0)) for run in runs])
    most = np.quantile(rates, 0.9, axis=0) + 1e-3
    return {"acceleration": float(most[0]), "yaw_acceleration": float(most[1])}


def _path(name: str) -> str:
    """Return where a `VelocityRobot` has one of the numbers that are found."""
    array = "theta" if name.startswith("theta") else "accelerations" if "acceleration" in name else ""
    return f"{array}.{name}" if array else name
