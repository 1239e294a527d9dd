"""`identify_velocity`: numbers of a robot with velocity inputs from logs of commands and motion.

The search by output error begins with speeds, then takes poses, in ever longer segments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, bounded, positive, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.identification._commands import (
    BLOCK,
    CAR_COMMANDS,
    CHANNELS,
    LARGEST,
    LEAST_BLOCKS,
    MIN_SHARE,
    Lag,
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
    speeds_of,
)
from pinmobile.identification._estimates import Identification
from pinmobile.identification._estimator import (
    NORMAL,
    Fit,
    Whiteness,
    jackknife,
    r_squared,
    solve_robustly,
    unexplained_error,
)
from pinmobile.identification._log import Log, logs_of, unused
from pinmobile.identification._simulation import MANY, Segments, pieces, simulate
from pinmobile.identification._velocity_model import CarModel, VelocityModel
from pinmobile.identification._velocity_robot import VelocityRobot

_LONGER = 3  # ratio of successive lengths of segments
TRAINED = 2 / 3  # share of a log before the hold-out
_LEAST_ROUGH = 100  # smallest number of third differences that show the noise
_TOGETHER = 0.2  # largest correlation of successive residuals that counts as noise
_DIFFERENT = 4.0  # standard deviations by which results for two lengths of segments differ
_NOTABLE = 0.01  # share of the size of a number, by which they differ at least
_SURE = 2.0  # standard deviations by which a negative delay is reported
_EARLY = 0.9  # samples by which it is reported in any case: the search ends at one
_POOR = 0.5  # R^2 of a hold-out below which a note follows
_WASTE = 3.0  # largest number of samples in segments of unequal parts, per sample
_BETTER = 0.05  # smallest reduction of the logarithm of the residual by a limit
_ROUNDS = 2  # of lags and of parts that they explain
_HARD = 0.4  # first estimate of a limit of rates, as a share of the largest rate without it
_FARTHEST = 10.0  # [m]: largest distance ahead of the axle


def identify_velocity(
    log: Log | Sequence[Log],
    *,
    delay: float | None = None,
    ahead: float | None = 0.0,
    accelerations: ArrayLike | None = None,
    limits: ArrayLike | None = None,
    wheelbase: float | None = None,
) -> Identification:
    """Estimate a `VelocityRobot` or a `VelocityCar` from a log of its commands and its motion.

    The inputs of the log are commands of speed and yaw rate, and the estimates are theta. Commands of a car
    are speed and steering angle: the unit of the second input is ``"rad"``, or `wheelbase` is given. The
    estimates are then the fields of a `VelocityCar`. The measurements are the twist if the log has one, such
    as from encoders, and otherwise the pose.

    A first-order lag gives first estimates of gains, time constants, delay and limits of the commands.
    Sections that the commands do not explain, such as driving by hand, are left out and reported. Output
    error then fits simulations of segments to the measurements, as long as the noise allows. It weights
    residuals by their covariance and drops single samples beyond six standard deviations.

    The confidence intervals come from the jackknife over blocks of 2 to 5 s with Student's t. They are also
    valid if the noise is correlated. They do not cover the error of a wrong model: `free_run` of the result
    states how much of the motion the model explains, and `notes` whether results depend on the length of the
    segments.

    Both commands must change often and independently, for example by `controllers.RandomSteps`.

    Parameters
    ----------
    log : Log or sequence of Log
        Commands and motion, at least 20 blocks of 2 s: 41 s or more.
    delay : float, optional
        Delay of measurements relative to commands [s]; default: estimated. The intervals of the other
        numbers then include the uncertainty of the delay.
    ahead : float, optional
        Distance of the measured point ahead of the axle, of a car the rear one [m]; None: estimated from
        poses.
    accelerations : array_like, shape () or (2,), optional
        Largest absolute accelerations of the firmware, of speed and yaw rate [m/s^2, rad/s^2]; of a car,
        acceleration and steering rate [m/s^2, rad/s]; infinite: no limit. Default: estimated where the log
        shows a limit.
    limits : array_like, shape () or (2,), optional
        Largest absolute commands that the robot follows [m/s, rad/s or rad]; infinite: no limit. Default:
        estimated where the log shows a limit.
    wheelbase : float, optional
        Distance between the axles of a car, > 0 [m]: the gain of the steering is estimated. Default: the
        wheelbase is estimated, and the gain of the steering is 1.

    Returns
    -------
    found : Identification
        Estimates of the numbers of the robot; its method `robot` returns it.

    Raises
    ------
    InvalidArgument
        If the log is too short or from another robot, units are wrong, poses move sideways, commands do not
        change or explain less than a third of the motion, or an argument is out of range.

    See Also
    --------
    VelocityRobot : the model
    identification.VelocityCar : the model of a car
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
    is_pose, is_car = logs[0].twist is None, wheelbase is not None or logs[0].units[1:] == ("rad",)
    sensor = "q" if is_pose else "twist"
    runs = runs_of(logs, is_pose, CAR_COMMANDS if is_car else CHANNELS)
    dt, lead = runs[0].dt, lead_of(runs)
    if ahead is None and not is_pose:
        raise InvalidArgument("ahead is None, expected a number [m]: a log of twists does not identify it")
    _check_changes(runs)
    late, far = (scalar(name, 0.0 if x is None else x) for name, x in (("delay", delay), ("ahead", ahead)))
    given = {
        "delay": bounded("delay", late, least=0, most=lead * dt, unit="s"),
        "ahead": bounded("ahead", far, least=-_FARTHEST, most=_FARTHEST, unit="m"),
    }
    if wheelbase is not None:
        given["wheelbase"] = positive("wheelbase", wheelbase, "m")
    model = (CarModel if is_car else VelocityModel)((), given, lead, dt, is_pose)
    told: list[Any] = [np.inf if each is None else each for each in (limits, accelerations)]
    most = VelocityRobot(np.ones(6), 0.0, *told)
    given |= dict(zip(model.limits(), [*most.accelerations.tolist(), *most.limits.tolist()], strict=True))
    parts, fixed = parts_of(runs), None if delay is None else round(late / dt)
    for _ in range(_ROUNDS):  # what other drivers did hides the limits
        lags = [each.lag(lead, fixed) for each in channels_of(_few_of(parts))]
        parts = explained_parts(runs, lags)
    sought, bounds = {"delay": delay is None, "ahead": ahead is None}, model.limits_of(lags)
    for name, known in zip(model.limits(), (accelerations, accelerations, limits, limits), strict=True):
        sought[name] = known is None and np.isfinite(bounds[name])
    order, delays = [n for n, free in sought.items() if free], [x.delay for x in lags if x.gain] or [0]
    guess = {"delay": dt * float(np.mean(delays)), "ahead": 0.0} | bounds
    start = np.append(model.start(lags), [guess[name] for name in order])
    model = replace(model, free=tuple(order))
    left_out, parts = format_left_out(runs, parts), model.started(parts, start)
    unknown = [] if accelerations is not None else [n for n in model.limits()[:2] if n not in order]
    columns = ([run.u[:, k] for run in runs] for k in (0, 1))
    tops = [lag._replace(rate_limit=_HARD * lag.top(u)) for lag, u in zip(lags, columns, strict=True)]
    guesses = {n: model.limits_of(tops)[n] for n in unknown}
    found = searched(model, parts, start, guesses, lags, left_out)
    return replace(found, dropped=sum(one.dropped + unused(one, sensor) for one in logs))


def _check_changes(runs: Sequence[Run]) -> None:
    """Reject logs that are too short, and logs with constant commands."""
    spans = np.array([(len(run.u) - 1) * run.dt for run in runs])
    blocks = int(np.floor(spans / BLOCK).sum())
    if blocks < LEAST_BLOCKS:
        raise InvalidArgument(
            f"log is {spans.sum():.3g} s long, too short: it gives {blocks} blocks of {BLOCK:g} s, expected "
            f"at least {LEAST_BLOCKS} for intervals: a log of {(LEAST_BLOCKS + 0.5) * BLOCK:g} s or more"
        )
    if not any(channel.moves for channel in channels_of(parts_of(runs))):
        raise InvalidArgument("log has constant commands, expected changing commands, such as RandomSteps")


def searched(
    model: VelocityModel,
    parts: list[Part],
    start: Array,
    limits: Mapping[str, float],
    lags: Sequence[Lag] = (),
    left_out: str = "",
) -> Identification:
    """Return the estimates from parts of logs.

    Parameters
    ----------
    model : VelocityModel
        Model of the robot.
    parts : list of Part
        Parts of logs, with one time step.
    start : ndarray, shape (P,)
        First estimates.
    limits : mapping of str to float
        First estimates of limits of rates that are not numbers of the model, by name.
    lags : sequence of Lag, optional
        Lags of both channels, for error messages.
    left_out : str
        Sections that are left out, in words.

    Raises
    ------
    InvalidArgument
        If the inputs explain too little of the motion, or the numbers are out of range.
    """
    dt = model.dt
    model, start = _by_speeds(model, parts, start, limits)
    if lags:  # else commands of another robot lead the search to numbers without effect
        few = _few_of(parts)
        shares = zip(CHANNELS, _explained(model, start, few).tolist(), channels_of(few), strict=True)
        check_explained({name: share if channel.moves else None for name, share, channel in shares}, lags, dt)
    try:
        tried = list(_tried(model, parts, start))
    except InvalidArgument:  # such as a limit that only one block shows
        model, kept = model.without(model.limits())
        if len(kept) == len(start):
            raise
        tried = list(_tried(model, parts, start[kept]))
    best = min(tried, key=lambda each: (each.lost.sum(), each.size)) if model.is_pose else tried[-1]
    differ = _compared(model, *(tried[0], best) if best is not tried[0] else (best, tried[-1]))
    if best.is_few:
        best = _Tried.of(model, parts, best.seconds, best.fit.p)
    remarks = [left_out, differ]
    limited, late = model.limits(), len(model.first)
    tops = np.max([np.abs(part.run.u[part.start : part.stop, :2]).max(axis=0) for part in parts], axis=0)
    rows = zip(model.free, best.lost[late:], best.fit.p[late:], strict=True)
    far = dict(zip(limited[2:], LARGEST * tops, strict=False))
    useless = [n for n, lost, x in rows if n in limited and (lost or x > far.get(n, np.inf))]
    if useless:
        model, best = _without(useless, model, parts, best)
    if "delay" in model.free and best.fit.p[late] < 0:
        early, C = best.fit.p[late], best.covariance
        p = best.fit.p - C[:, late] / C[late, late] * early  # the estimate for no delay
        if early < -min(_SURE * np.sqrt(C[late, late]), _EARLY * dt):
            less = " or less" * bool(early < -_EARLY * dt)
            remarks.append(
                f"the delay is taken as zero: its estimate is {1e3 * early:.3g} ms{less}; with times of two "
                "clocks, use Log.from_streams(..., one_clock=False)"
            )
            _, other = _without(["delay"], model, parts, best)
            p, best = np.insert(other.fit.p, late, 0.0), best._replace(segments=other.segments, fit=other.fit)
        best = best._replace(fit=best.fit._replace(p=p))  # the covariance contains that of the delay
    found, lost, p = best.fit, best.lost, best.fit.p
    free_run = _free_run(model, parts, best)
    if lags:
        check_explained({name: free_run.get(name, (None,))[0] for name in CHANNELS}, lags, dt)
    elif (share := min(each for each, _ in free_run.values())) < MIN_SHARE:
        raise unexplained_error(share)
    poor = [name for name, (_, after) in free_run.items() if after < _POOR]
    if poor:
        named = " and the ".join(poor)
        remarks.append(f"the model does not predict the {named} of the hold-out: do not use it elsewhere")
    model.check(p, lost)
    listed = ", ".join(one.name for one, is_so in zip(model.quantities, lost, strict=True) if is_so)
    good, square = found.good, (found.linear.residual[found.good] ** 2).mean(axis=0)
    rank, white = int((~lost).sum()), Whiteness.of(found.linear.residual * good[..., None], good)
    return Identification(
        model=model,
        phi=p,
        covariance_of_phi=best.covariance,
        freedom=best.blocks - 1,
        rank=rank,
        unseen=f"the motion does not identify {listed}: rank {rank} of {len(p)}" if listed else "",
        hidden=lost.astype(float),
        unknown=np.zeros((len(p), 0)),
        delay=model.named(p)["delay"],
        delay_error=float(np.sqrt(best.covariance[late, late])) if "delay" in model.free else np.nan,
        dt=dt,
        seconds=min(best.seconds, max(b - a for _, a, b in parts) * dt),
        outliers=int((best.segments.good & ~good).sum()),
        samples=int(good.sum()),
        segments=len(good),
        noise=_noise_of(found.linear.residual, good),
        residual=np.sqrt(square),
        whiteness=white,
        is_noise=bool(np.abs(white.correlation).max() <= _TOGETHER) and not differ,
        explained=min((share for share, _ in free_run.values()), default=1.0),
        free_run=MappingProxyType(free_run),
        remarks=tuple(filter(None, remarks)),
    )


def _by_speeds(
    model: VelocityModel, parts: list[Part], p: Array, limits: Mapping[str, float]
) -> tuple[VelocityModel, Array]:
    """Return the model and first estimates by speeds, which do not drift, beginning with numbers p.

    The model has more limits of rates, with first estimates by name, where correlated residuals show them.
    """
    free = replace(model, is_pose=False)
    given = speeds_of(_few_of(parts))
    segments, calm = segments_of(given, model.lead, model.dt * _LONGER * block_of(given))

    def fit(model: VelocityModel, p: Array) -> tuple[VelocityModel, Array, float, bool]:
        found, lost = solve_robustly(model, segments, p, calm=calm, natural=model.natural)
        free = zip(model.free, lost[len(model.first) :], strict=True)
        less, kept = model.without([name for name, is_lost in free if is_lost and name in model.limits()])
        left, whiteness = found.linear.residual, Whiteness.of(found.linear.residual, found.good)
        cost = float(np.log(left[found.good].var(axis=0)).sum())
        return less, np.where(lost, p, found.p)[kept], cost, whiteness.is_white

    found, p, cost, white = fit(free, p)
    for name, guess in limits.items() if not white else ():
        more, q, less, _ = fit(replace(found, free=(*found.free, name)), np.append(p, guess))
        if less < cost - _BETTER and name in more.free:
            found, p, cost = more, q, less
    return replace(model, free=found.free), p


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
        segments = segments.select(kept)._replace(blocks=max(1, segments.y.shape[1] // block_of(parts)))
        fit, lost = solve_robustly(model, segments, p, calm=calm[kept], natural=model.natural)
        covariance, blocks = jackknife(fit.linear, active=~lost)
        return cls(segments.y.shape[1] * model.dt, segments, fit, lost, covariance, blocks, kept.step > 1)


def _tried(model: VelocityModel, parts: list[Part], p: Array) -> Iterator[_Tried]:
    """Yield the estimates from segments of 6 s, and from longer ones.

    Speeds of a stable model do not drift, so that the longest segment is a whole part. Poses drift: segments
    grow until the confidence region does. A few of many segments choose the length.
    """
    longest, block = max(b - a for _, a, b in parts) * model.dt, model.dt * block_of(parts)
    total = sum(b - a for _, a, b in parts) * model.dt
    longest = min(longest, MANY * model.dt, max(_WASTE * total / len(parts), _LONGER * block))
    longest = min(longest, model.longest)
    seconds = min(_LONGER * block, longest)
    before = np.inf
    while True:
        one = _Tried.of(model, parts, seconds, p, model.is_pose or seconds <= longest)
        yield one
        if seconds >= longest or one.size > before:
            return
        before, p = (one.size if model.is_pose else np.inf), one.fit.p
        seconds = min(seconds * _LONGER, longest + block) if model.is_pose else longest + block


def _noise_of(residual: Array, good: NDArray[np.bool_]) -> Array:
    """Return the standard deviation of white noise in residuals, shape (m,), by their third differences."""
    known = good[:, :-3] & good[:, 1:-2] & good[:, 2:-1] & good[:, 3:]
    rough = np.abs(np.diff(residual, 3, axis=1))[known]
    square = (residual[good] ** 2).mean(axis=0)
    if len(rough) < _LEAST_ROUGH:
        return np.asarray(np.sqrt(square))
    return np.asarray(np.minimum(NORMAL * np.median(rough, axis=0) / np.sqrt(20), np.sqrt(square)))


def _few_of(parts: Sequence[Part]) -> list[Part]:
    """Return pieces of parts with samples enough for first estimates."""
    total = sum(b - a for _, a, b in parts)
    return [Part(run, one.start, one.stop) for run, a, b in parts for one in pieces(a, b, total)]


def _without_first(parts: Sequence[Part], count: int) -> list[Part]:
    """Return parts without so many samples at the start."""
    found = list[Part]()
    for part in parts:
        found += [part._replace(start=part.start + max(count, 0))] * (part.start + count < part.stop)
        count -= part.stop - part.start
    return found


def _without(
    names: Sequence[str], model: VelocityModel, parts: list[Part], best: _Tried
) -> tuple[VelocityModel, _Tried]:
    """Return the model without some free numbers, and its estimates."""
    less, kept = model.without(names)
    return less, _Tried.of(less, parts, best.seconds, best.fit.p[kept])


def _compared(model: VelocityModel, short: _Tried, long: _Tried) -> str:
    """Return a note on numbers that depend on the length of the segments; "" if there are none."""
    wide, narrow = np.diag(short.covariance), np.diag(long.covariance)
    deviation = np.sqrt(np.maximum(wide - narrow, 0.3 * wide))
    least = _NOTABLE * model.sizes(long.fit.p)
    off = np.abs(short.fit.p - long.fit.p) > np.maximum(_DIFFERENT * deviation, least)
    rows = zip(model.quantities, short.fit.p, long.fit.p, off & ~(short.lost | long.lost), strict=True)
    listed = ", ".join(f"{one.name} {a:.3g} and {b:.3g}" for one, a, b, differs in rows if differs)
    note = (
        f"estimates from segments of {short.seconds:.3g} s and of {long.seconds:.3g} s differ: {listed}: the "
        "structure of the model is wrong, and the intervals are not valid"
    )
    return note if listed else ""


def _free_run(model: VelocityModel, parts: Sequence[Part], best: _Tried) -> dict[str, tuple[float, float]]:
    """Return R^2 of free runs by channel: of the log, and of its last third for a fit to the rest."""
    test = _without_first(parts, round(TRAINED * sum(b - a for _, a, b in parts)))
    blocks = best.fit.linear.normal.shape[:2]
    early = np.arange(np.prod(blocks)).reshape(blocks) < TRAINED * np.prod(blocks)
    p, step = best.fit.p, best.fit.linear.step(early)
    step = np.insert(step, [len(model.first)] * (len(p) - len(step)), 0.0)  # of a delay that is taken as zero
    before, after = _explained(model, p, parts), _explained(model, p + step, test)
    rows = zip(CHANNELS, before.tolist(), after.tolist(), channels_of(parts), strict=True)
    return {name: (one, other) for name, one, other, channel in rows if channel.moves}


def _explained(model: VelocityModel, p: Array, parts: Sequence[Part]) -> Array:
    """Return R^2 of the speed and of the yaw rate in free runs over parts."""
    free, left, y = replace(model, is_pose=False), [np.zeros((0, 2))], [np.zeros((0, 2))]
    for part in speeds_of(parts):
        segments, _ = segments_of([part], free.lead, min(part.stop - part.start, MANY) * free.dt)
        if len(segments.y):
            out = simulate(free, segments, p[None], segments.start[None])[0]
            left.append((segments.y - out)[segments.good])
            y.append(segments.y[segments.good])
    return r_squared(np.concatenate(y), np.concatenate(left))
