"""`identify_velocity`: theta from a log of commands and motion, with confidence intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, bounded, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.identification._commands import (
    BLOCK,
    CHANNELS,
    LEAST_BLOCKS,
    Part,
    Run,
    block_of,
    channels_of,
    check_explained,
    explained_parts,
    format_left_out,
    lead_of,
    parts_of,
    runs_of,
    segments_of,
)
from pinmobile.identification._estimates import Identification
from pinmobile.identification._estimator import Fit, Whiteness, jackknife, solve, solve_robustly, white_of
from pinmobile.identification._lag import Lag
from pinmobile.identification._log import Log, logs_of, unused
from pinmobile.identification._simulation import MANY, Segments, pieces, simulate
from pinmobile.identification._velocity_model import MOST, STEEPEST, VelocityModel
from pinmobile.identification._velocity_robot import THETA, VelocityRobot

_LONGER = 3  # ratio of successive lengths of segments
TRAINED = 2 / 3  # share of a log before the hold-out
_TOGETHER = 0.2  # largest correlation of successive residuals that counts as noise
_DIFFERENT = 4.0  # standard deviations by which results for two lengths of segments differ
_SURE = 2.0  # standard deviations by which a negative delay is reported
_EARLY = 0.9  # samples by which it is reported in any case: the search ends at one
_ROUNDS = 2  # of lags and of parts that they explain
_POOR = 0.5  # R^2 of a hold-out below which a note follows
_WASTE = 3.0  # largest number of samples in segments of unequal parts, per sample
_GAINS = 0.1, 10.0  # range of the command per steady speed or yaw rate
_FARTHEST = 10.0  # [m]: largest distance ahead of the axle


def identify_velocity(
    log: Log | Sequence[Log],
    *,
    delay: float | None = None,
    ahead: float | None = 0.0,
    accelerations: ArrayLike | None = None,
    limits: ArrayLike | None = None,
) -> Identification:
    """Estimate theta of a `VelocityRobot` from a log of its commands and its motion.

    The inputs of the log are commands of speed and yaw rate. The measurements are the twist if the log has
    one, such as from encoders, and otherwise the pose. A first-order lag gives first estimates of gains, time
    constants, delay and limits of the commands. Sections that the commands do not explain, such as driving by
    hand, are left out and reported. Output error then fits simulations of segments to the measurements, as
    long as the noise allows. It weights residuals by their covariance and drops single samples beyond six
    standard deviations.

    The confidence intervals come from the jackknife over blocks of 2 to 5 s with Student's t. They are also
    valid if the noise is correlated. They do not cover the error of a wrong model: `free_run` of the result
    states how much of the motion the model explains, and `notes` whether results depend on the length of the
    segments.

    Speed and yaw rate must change often and independently, for example by `controllers.RandomSteps`.

    Parameters
    ----------
    log : Log or sequence of Log
        Commands and motion, at least 20 blocks of 2 s: 41 s or more.
    delay : float, optional
        Delay of measurements relative to commands [s]; default: estimated. The intervals of the other
        numbers then include the uncertainty of the delay.
    ahead : float, optional
        Distance of the measured point ahead of the axle [m]; None: estimated from poses.
    accelerations : array_like, shape () or (2,), optional
        Largest absolute accelerations of the firmware, of speed and yaw rate [m/s^2, rad/s^2]; infinite: no
        limit. Default: estimated where the log shows a limit.
    limits : array_like, shape () or (2,), optional
        Largest absolute commands that the robot follows [m/s, rad/s]; infinite: no limit. Default: estimated
        where the log shows a limit.

    Returns
    -------
    found : Identification
        Estimates of theta and of the further numbers.

    Raises
    ------
    InvalidArgument
        If the log is too short or from another robot, units are wrong, commands do not change or explain
        less than a third of the motion, or an argument is out of range.

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
    is_pose = logs[0].twist is None
    sensor = "q" if is_pose else "twist"
    runs = runs_of(logs, is_pose)
    dt, lead = runs[0].dt, lead_of(runs)
    if ahead is None and not is_pose:
        raise InvalidArgument("ahead is None, expected a number [m]: a log of twists does not identify it")
    _check_changes(runs)
    most = VelocityRobot(
        np.ones(6),
        limits=np.inf if limits is None else limits,
        accelerations=np.inf if accelerations is None else accelerations,
    )
    late, far = (scalar(name, 0.0 if x is None else x) for name, x in (("delay", delay), ("ahead", ahead)))
    given = {
        "delay": bounded("delay", late, least=0, most=lead * dt, unit="s"),
        "ahead": bounded("ahead", far, least=-_FARTHEST, most=_FARTHEST, unit="m"),
        **dict(zip(STEEPEST + MOST, [*most.accelerations.tolist(), *most.limits.tolist()], strict=True)),
    }
    parts = parts_of(runs)
    for _ in range(_ROUNDS):  # what other drivers did hides the limits
        known = None if delay is None else round(late / dt)
        lags = [each.lag(lead, known) for each in channels_of(_few(parts))]
        parts = explained_parts(runs, lags)
    sought = {"delay": delay is None, "ahead": ahead is None}
    for steepest, largest, lag in zip(STEEPEST, MOST, lags, strict=True):
        sought[steepest] = accelerations is None and np.isfinite(lag.steepest)
        sought[largest] = limits is None and np.isfinite(lag.limit)
    order = [name for name in ("delay", "ahead", *STEEPEST, *MOST) if sought[name]]
    model = VelocityModel(tuple(order), given, lead, dt, is_pose)
    tried = list(_tried(model, parts, _start(model, lags)))
    best = min(tried, key=lambda each: (each.lost.sum(), each.size)) if is_pose else tried[-1]
    differ = _compared(model, *(tried[0], best) if best is not tried[0] else (best, tried[-1]))
    if best.is_few:
        best = _Tried.of(model, parts, best.seconds, best.fit.p)
    remarks = [format_left_out(runs, parts), differ]
    useless = [n for n, lost in zip(model.free, best.lost[6:], strict=True) if lost and n in STEEPEST + MOST]
    if useless:
        model, best = _without(useless, model, parts, best)
    if "delay" in model.free and best.fit.p[6] < 0:
        early, C = best.fit.p[6], best.covariance
        p = best.fit.p - C[:, 6] / C[6, 6] * early  # the estimate for no delay
        if early < -min(_SURE * np.sqrt(C[6, 6]), _EARLY * dt):
            less = " or less" * bool(early < -_EARLY * dt)
            remarks.append(
                f"the delay is taken as zero: its estimate is {1e3 * early:.3g} ms{less}; with times of two "
                "clocks, use Log.from_streams(..., one_clock=False)"
            )
            _, other = _without(["delay"], model, parts, best)
            p, best = np.insert(other.fit.p, 6, 0.0), best._replace(segments=other.segments, fit=other.fit)
        best = best._replace(fit=best.fit._replace(p=p))  # the covariance contains that of the delay
    found, lost, p = best.fit, best.lost, best.fit.p
    free_run = _free_run(model, parts, best)
    check_explained([free_run.get(name, (None,))[0] for name in CHANNELS], lags, dt)
    poor = [name for name, (_, after) in free_run.items() if after < _POOR]
    if poor:
        named = " and the ".join(poor)
        remarks.append(f"the model does not predict the {named} of the hold-out: do not use it elsewhere")
    for k in (3, 5):
        if not (lost[k] or _GAINS[0] < p[k] < _GAINS[1]):
            raise InvalidArgument(
                f"log leads to {THETA[k][0]} = {p[k]:.3g} ({THETA[k][2].partition(':')[0]}), expected "
                "about 1: are commands in m/s and rad/s, positions in metres and psi in radians?"
            )
    listed = ", ".join(one.name for one, is_so in zip(model.quantities, lost, strict=True) if is_so)
    good, square = found.good, (found.near.residual[found.good] ** 2).mean(axis=0)
    rank, white = int((~lost).sum()), Whiteness.of(found.near.residual * good[..., None], good)
    return Identification(
        model=model,
        phi=p,
        covariance_of_phi=best.covariance,
        freedom=best.blocks - 1,
        rank=rank,
        unseen=f"the motion does not identify {listed}: rank {rank} of {len(p)}" if listed else "",
        hidden=lost.astype(float),
        unknown=np.zeros((len(p), 0)),
        delay=float(model.others(p[None])["delay"][0]),
        delay_error=float(np.sqrt(best.covariance[6, 6])) if "delay" in model.free else np.nan,
        dt=dt,
        seconds=min(best.seconds, max(b - a for _, a, b in parts) * dt),
        outliers=int((best.segments.good & ~good).sum()),
        dropped=sum(one.dropped + unused(one, sensor) for one in logs),
        samples=int(good.sum()),
        segments=len(good),
        noise=np.sqrt(square),
        residual=np.sqrt(square),
        whiteness=white,
        is_noise=bool(np.abs(white.correlation).max() <= _TOGETHER) and not differ,
        explained=min((share for share, _ in free_run.values()), default=1.0),
        free_run=MappingProxyType(free_run),
        remarks=tuple(filter(None, remarks)),
    )


class _Tried(NamedTuple):
    """Estimates from segments of one length.

    Attributes
    ----------
    seconds : float
        Length of the segments [s].
    segments : Segments
        The segments.
    fit : Fit
        Output error.
    lost : ndarray of bool, shape (P,)
        Mask of the numbers that are not identifiable.
    covariance : ndarray, shape (P, P)
        Covariance by the jackknife over blocks.
    blocks : int
        Number of blocks.
    is_few : bool
        Whether a few of many segments gave the estimates.
    """

    seconds: float
    segments: Segments
    fit: Fit
    lost: NDArray[np.bool_]
    covariance: Array
    blocks: int
    is_few: bool

    @property
    def size(self) -> float:
        """Logarithm of the volume of the confidence region."""
        kept = ~self.lost
        return float(np.linalg.slogdet(self.covariance[np.ix_(kept, kept)])[1])

    @classmethod
    def of(
        cls, model: VelocityModel, parts: list[Part], seconds: float, p: Array, few: bool = False
    ) -> _Tried:
        """Return the estimates from segments of a length [s], a multiple of a block, or a few of them."""
        segments, calm = segments_of(parts, model.lead, seconds)
        kept = segments.few if few else slice(None, None, 1)
        segments = segments.some(kept)._replace(blocks=segments.y.shape[1] // block_of(parts))
        fit, lost = solve_robustly(model, segments, p, calm=calm[kept], natural=model.natural)
        covariance, blocks = jackknife(fit.near, kept=~lost)
        return cls(segments.y.shape[1] * model.dt, segments, fit, lost, covariance, blocks, kept.step > 1)


def _tried(model: VelocityModel, parts: list[Part], p: Array) -> Iterator[_Tried]:
    """Yield the estimates from segments of 6 s, and from longer ones.

    Speeds of a stable model do not drift, so that the longest segment is a whole part. Poses drift: segments
    grow until the confidence region does. A few of many segments choose the length.
    """
    longest, block = max(b - a for _, a, b in parts) * model.dt, model.dt * block_of(parts)
    total = sum(b - a for _, a, b in parts) * model.dt
    longest = min(longest, MANY * model.dt, max(_WASTE * total / len(parts), _LONGER * block))
    seconds = _LONGER * block
    before = np.inf
    while True:
        one = _Tried.of(model, parts, seconds, p, model.is_pose or seconds <= longest)
        yield one
        if seconds >= longest or one.size > before:
            return
        before, p = (one.size if model.is_pose else np.inf), one.fit.p
        seconds = min(seconds * _LONGER, longest + block) if model.is_pose else longest + block


def _few(parts: Sequence[Part]) -> list[Part]:
    """Return pieces of parts with samples enough for first estimates."""
    total = sum(b - a for _, a, b in parts)
    return [Part(run, one.start, one.stop) for run, a, b in parts for one in pieces(a, b, total)]


def _first(parts: Sequence[Part], count: int) -> list[Part]:
    """Return the first parts with at most so many samples."""
    found = list[Part]()
    for part in parts:
        found += [part._replace(stop=min(part.stop, part.start + count))] * (count > 0)
        count -= part.stop - part.start
    return found


def _without(
    names: Sequence[str], model: VelocityModel, parts: list[Part], best: _Tried
) -> tuple[VelocityModel, _Tried]:
    """Return the model without some free numbers, and its estimates."""
    kept = [*range(6), *(6 + k for k, name in enumerate(model.free) if name not in names)]
    less = replace(model, free=tuple(name for name in model.free if name not in names))
    return less, _Tried.of(less, parts, best.seconds, best.fit.p[kept])


def _compared(model: VelocityModel, short: _Tried, long: _Tried) -> str:
    """Return a note on numbers that depend on the length of the segments; "" if there are none."""
    wide, narrow = np.diag(short.covariance), np.diag(long.covariance)
    deviation = np.sqrt(np.maximum(wide - narrow, 0.3 * wide))
    off = np.abs(short.fit.p - long.fit.p) > _DIFFERENT * deviation
    rows = zip(model.quantities, short.fit.p, long.fit.p, off & ~(short.lost | long.lost), strict=True)
    listed = ", ".join(f"{one.name} {a:.3g} and {b:.3g}" for one, a, b, differs in rows if differs)
    note = (
        f"estimates from segments of {short.seconds:.3g} s and of {long.seconds:.3g} s differ: {listed}: the "
        "structure of the model is wrong, and the intervals are not valid"
    )
    return note if listed else ""


def _check_changes(runs: Sequence[Run]) -> None:
    """Reject logs that are too short, and logs with constant commands."""
    spans = np.array([(len(run.u) - 1) * run.dt for run in runs])
    blocks = int(np.floor(spans / BLOCK).sum())
    if blocks < LEAST_BLOCKS:
        raise InvalidArgument(
            f"log is {spans.sum():.3g} s long, too short: it gives {blocks} blocks of {BLOCK:g} "
            f"s, expected at least {LEAST_BLOCKS} for valid intervals: a log of "
            f"{(LEAST_BLOCKS + 0.5) * BLOCK:g} s or more"
        )
    if not any(channel.moves for channel in channels_of(parts_of(runs))):
        raise InvalidArgument("log has constant commands, expected changing commands, such as RandomSteps")


def _start(model: VelocityModel, lags: Sequence[Lag]) -> Array:
    """Return first estimates, shape (P,), from the lags of speed and yaw rate."""
    theta = np.array([0.3, 0.3, 0.0, 1.0, 0.0, 1.0])
    for a, b, lag in zip((0, 1), (3, 5), lags, strict=True):
        if lag.gain > 0:
            theta[[a, b]] = lag.tau / lag.gain, 1 / lag.gain
    late = [lag.late for lag in lags if lag.gain > 0] or [0]
    known = {"delay": model.dt * np.mean(late), "ahead": 0.0}
    for names, lag in zip(zip(STEEPEST, MOST, strict=True), lags, strict=True):
        known |= dict(zip(names, (lag.steepest, lag.limit), strict=True))
    return np.append(theta, [known[name] for name in model.free])


def _free_run(model: VelocityModel, parts: Sequence[Part], best: _Tried) -> dict[str, tuple[float, float]]:
    """Return R^2 of free runs by channel: of the log, and of its last third for a fit to the rest."""
    train = _first(parts, round(TRAINED * sum(b - a for _, a, b in parts)))
    rest = [part._replace(start=train[-1].stop) for part in parts[len(train) - 1 : len(train)]]
    test = [part for part in (*rest, *parts[len(train) :]) if part.stop > part.start]
    before = _explained(model, best.fit.p, parts)
    try:
        segments, calm = segments_of(train, model.lead, best.seconds)
        left = best.fit.near.residual[best.fit.good]
        segments = segments._replace(good=segments.good & calm)
        fit = solve(
            model,
            segments.some(segments.few),
            best.fit.p,
            moves=~best.lost,
            white=white_of(left),
        )
        after = _explained(model, fit.p, test)
    except ValueError:  # too short, or the fit has no solution
        after = np.full(2, np.nan)
    rows = zip(CHANNELS, before.tolist(), after.tolist(), channels_of(parts), strict=True)
    return {name: (one, other) for name, one, other, channel in rows if channel.moves}


def _explained(model: VelocityModel, p: Array, parts: Sequence[Part]) -> Array:
    """Return R^2 of the speed and of the yaw rate in free runs over parts."""
    free, left, y = replace(model, is_pose=False), [], []
    for run, a, b in parts:
        plain = run._replace(y=run.nu, calm=run.nu)
        segments, _ = segments_of([Part(plain, a, b)], free.lead, min(b - a, MANY) * run.dt)
        if len(segments.y):
            out = simulate(free, segments, p[None], segments.start[None])[0]
            left.append((segments.y - out)[segments.good])
            y.append(segments.y[segments.good])
    if not y:
        return np.full(2, np.nan)
    rest, motion = np.concatenate(left), np.concatenate(y)
    return np.asarray(
        1 - (rest**2).sum(axis=0) / np.maximum(((motion - motion.mean(axis=0)) ** 2).sum(axis=0), 1e-300)
    )
