"""`identify_velocity`: numbers of a robot with velocity inputs from logs of commands and motion.

The search by output error begins with speeds, then takes poses, in ever longer segments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, bounded, positive, required, scalar
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
    check_share,
    jackknife,
    r_squared,
    solve_robustly,
)
from pinmobile.identification._log import Log, logs_of, unused_rows
from pinmobile.identification._simulation import LANES, START_SAMPLES, Segments, pieces, simulate
from pinmobile.identification._velocity_model import CarModel, VelocityModel
from pinmobile.identification._velocity_robot import VelocityRobot

_LONGER = 3  # ratio of successive lengths of segments
TRAINING = 2 / 3  # share of a log before the hold-out
_LEAST_ROUGH = 100  # smallest number of third differences that show the noise
_NOISE_CORRELATION = 0.2  # largest correlation of successive residuals that counts as noise
_DIFFERENT = 4.0  # standard deviations by which results for two lengths of segments differ
_NOTABLE = 0.01  # share of the size of a number, by which they differ at least
_DELAY_ERRORS = 2.0  # standard deviations by which a negative delay is reported
_DELAY_ROWS = 0.9  # samples by which it is reported in any case: the search ends at one
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
    error then fits simulations of segments to the measurements, as long as the noise allows; of logs with
    more than 30,000 samples, up to 3,750 samples. It weights residuals by their covariance and drops single
    samples beyond six standard deviations.

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
    estimates : Identification
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
    if is_car and wheelbase is None:  # else the unit of the commands is identified
        steepest = max(float(np.abs(run.u[:, 1]).max()) for run in runs)
        if steepest >= np.pi / 2:
            words = f"log has steering commands up to {steepest:.3g} rad, expected below pi / 2"
            raise InvalidArgument(f"{words}: are they in degrees?")
    dt, lead = runs[0].dt, lead_of(runs)
    if not is_pose:
        required("ahead", ahead, "a number [m]: a log of twists does not identify it")
    _check_changes(runs)
    lag_s, x_0 = (scalar(name, 0.0 if x is None else x) for name, x in (("delay", delay), ("ahead", ahead)))
    given = {
        "delay": bounded("delay", lag_s, least=0, most=lead * dt, unit="s"),
        "ahead": bounded("ahead", x_0, least=-_FARTHEST, most=_FARTHEST, unit="m"),
    }
    if wheelbase is not None:
        given["wheelbase"] = positive("wheelbase", wheelbase, "m")
    model = (CarModel if is_car else VelocityModel)((), given, lead, dt, is_pose, phase=runs[0].phase)
    limit_u: list[Any] = [np.inf if each is None else each for each in (limits, accelerations)]
    robot = VelocityRobot(np.ones(6), 0.0, *limit_u)
    given |= dict(zip(model.limits(), [*robot.accelerations.tolist(), *robot.limits.tolist()], strict=True))
    parts, fixed = parts_of(runs), None if delay is None else round(lag_s / dt + model.phase)
    for _ in range(_ROUNDS):  # what other drivers did hides the limits
        lags = [each.lag(lead, fixed) for each in channels_of(_few_of(parts))]
        parts = explained_parts(runs, lags)
    unknowns, bounds = {"delay": delay is None, "ahead": ahead is None}, model.limits_of(lags)
    for name, bound in zip(model.limits(), (accelerations, accelerations, limits, limits), strict=True):
        unknowns[name] = bound is None and np.isfinite(bounds[name])
    order = [n for n, free in unknowns.items() if free]
    guess = {"delay": model.delay_of([x for x in lags if x.gain] or lags), "ahead": 0.0} | bounds
    start = np.append(model.start(lags), [guess[name] for name in order])
    model = replace(model, free=tuple(order))
    left_out, parts = format_left_out(runs, parts), model.complete_states(parts, start)
    names = [] if accelerations is not None else [n for n in model.limits()[:2] if n not in order]
    columns = ([run.u[:, k] for run in runs] for k in (0, 1))
    tops = [lag._replace(rate_limit=_HARD * lag.top(u)) for lag, u in zip(lags, columns, strict=True)]
    guesses = {n: model.limits_of(tops)[n] for n in names}
    estimates = search(model, parts, start, guesses, lags, left_out)
    return replace(estimates, dropped=sum(one.dropped + unused_rows(one, sensor) for one in logs))


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


def search(
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
        shares = zip(CHANNELS, _scores(model, start, few).tolist(), channels_of(few), strict=True)
        check_explained({name: share if channel.moves else None for name, share, channel in shares}, lags, dt)
    try:
        trials = list(_trials(model, parts, start))
    except InvalidArgument:  # such as a limit that only one block shows
        model, rows_p = model.drop(model.limits())
        if len(rows_p) == len(start):
            raise
        trials = list(_trials(model, parts, start[rows_p]))
    best = min(trials, key=lambda each: (each.weak.sum(), each.size)) if model.is_pose else trials[-1]
    differ = _compare(model, *(trials[0], best) if best is not trials[0] else (best, trials[-1]))
    model, best = _drop_useless(model, parts, best)
    if best.is_few:
        model, best = _drop_useless(model, parts, _Trial.of(model, parts, best.seconds, best.fit.p))
    remarks, k = [left_out, differ], len(model.first)
    if "delay" in model.free and best.fit.p[k] < 0:
        delay, C = best.fit.p[k], best.covariance
        p = best.fit.p - C[:, k] / C[k, k] * delay  # the estimate for no delay
        if delay < -min(_DELAY_ERRORS * np.sqrt(C[k, k]), _DELAY_ROWS * dt):
            suffix = " or less" * bool(delay < -_DELAY_ROWS * dt)
            remarks.append(
                f"the delay is taken as zero: its estimate is {1e3 * delay:.3g} ms{suffix}; with times of "
                "two clocks, use Log.from_streams(..., one_clock=False)"
            )
            _, other = _drop(["delay"], model, parts, best)
            p, best = np.insert(other.fit.p, k, 0.0), best._replace(segments=other.segments, fit=other.fit)
        best = best._replace(fit=best.fit._replace(p=p))  # the covariance contains that of the delay
    fit, weak, p = best.fit, best.weak, best.fit.p
    free_run = _free_run(model, parts, best)
    if lags:
        check_explained({name: free_run.get(name, (None,))[0] for name in CHANNELS}, lags, dt)
    else:
        check_share(min(each for each, _ in free_run.values()), MIN_SHARE)
    poor = [name for name, (_, score) in free_run.items() if score < _POOR]
    if poor:
        channels = " and the ".join(poor)
        remarks.append(f"the model does not predict the {channels} of the hold-out: do not use it elsewhere")
    model.check(p, weak)
    names = ", ".join(item.name for item, is_so in zip(model.quantities, weak, strict=True) if is_so)
    good, square = fit.good, (fit.linear.residual[fit.good] ** 2).mean(axis=0)
    rank, white = int((~weak).sum()), Whiteness.of(fit.linear.residual * good[..., None], good)
    return Identification(
        model=model,
        phi=p,
        covariance_of_phi=best.covariance,
        freedom=best.blocks - 1,
        rank=rank,
        unseen=f"the motion does not identify {names}: rank {rank} of {len(p)}" if names else "",
        hidden=weak.astype(float),
        unknown=np.zeros((len(p), 0)),
        delay=model.other_values(p)["delay"],
        delay_error=float(np.sqrt(best.covariance[k, k])) if "delay" in model.free else np.nan,
        dt=dt,
        seconds=min(best.seconds, max(b - a for _, a, b in parts) * dt),
        outliers=int((best.segments.good & ~good).sum()),
        samples=int(good.sum()),
        segments=len(good),
        noise=_noise_of(fit.linear.residual, good),
        residual=np.sqrt(square),
        whiteness=white,
        is_noise=bool(np.abs(white.correlation).max() <= _NOISE_CORRELATION) and not differ,
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
        solution, weak = solve_robustly(model, segments, p, calm=calm, natural=model.natural)
        free = zip(model.free, weak[len(model.first) :], strict=True)
        smaller, rows = model.drop([name for name, is_weak in free if is_weak and name in model.limits()])
        left, whiteness = solution.linear.residual, Whiteness.of(solution.linear.residual, solution.good)
        cost = float(np.log(left[solution.good].var(axis=0)).sum())
        return smaller, np.where(weak, p, solution.p)[rows], cost, whiteness.is_white

    base, p, cost, white = fit(free, p)
    for name, guess in limits.items() if not white else ():
        trial, q, trial_cost, _ = fit(replace(base, free=(*base.free, name)), np.append(p, guess))
        if trial_cost < cost - _BETTER and name in trial.free:
            base, p, cost = trial, q, trial_cost
    return replace(model, free=base.free), p


class _Trial(NamedTuple):
    """Estimates from segments of one length.

    Attributes
    ----------
    seconds : float
        Length of the segments [s].
    segments : Segments
        The segments.
    fit : Fit
        Output error.
    weak : ndarray of bool, shape (P,)
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
    weak: NDArray[np.bool_]
    covariance: Array
    blocks: int
    is_few: bool

    @property
    def size(self) -> float:
        """Logarithm of the volume of the confidence region."""
        strong = ~self.weak
        return float(np.linalg.slogdet(self.covariance[np.ix_(strong, strong)])[1])

    @classmethod
    def of(
        cls, model: VelocityModel, parts: list[Part], seconds: float, p: Array, few: bool = False
    ) -> _Trial:
        """Return the estimates from segments of a length [s], a multiple of a block, or a few of them."""
        segments, calm = segments_of(parts, model.lead, seconds)
        rows = segments.few if few else slice(None, None, 1)
        segments = segments.select(rows)._replace(blocks=max(1, segments.y.shape[1] // block_of(parts)))
        fit, weak = solve_robustly(model, segments, p, calm=calm[rows], natural=model.natural)
        covariance, blocks = jackknife(fit.linear, active=~weak)
        return cls(segments.y.shape[1] * model.dt, segments, fit, weak, covariance, blocks, rows.step > 1)


def _trials(model: VelocityModel, parts: list[Part], p: Array) -> Iterator[_Trial]:
    """Yield the estimates from segments of 6 s, and from longer ones.

    Speeds of a stable model do not drift, so that the longest segment is a whole part. Poses drift: segments
    grow until the confidence region does. A few of many segments choose the length.
    """
    longest, block = max(b - a for _, a, b in parts) * model.dt, model.dt * block_of(parts)
    total = sum(b - a for _, a, b in parts) * model.dt
    most = START_SAMPLES * model.dt
    most = most / LANES if total > most else most  # segments of long logs fill the lanes
    longest = min(longest, most, max(_WASTE * total / len(parts), _LONGER * block), model.longest)
    seconds = min(_LONGER * block, longest)
    size = np.inf
    while True:
        trial = _Trial.of(model, parts, seconds, p, model.is_pose or seconds <= longest)
        yield trial
        if seconds >= longest or trial.size > size:
            return
        size, p = (trial.size if model.is_pose else np.inf), trial.fit.p
        seconds = min(seconds * _LONGER, longest + block) if model.is_pose else longest + block


def _noise_of(residual: Array, good: NDArray[np.bool_]) -> Array:
    """Return the standard deviation of white noise in residuals, shape (m,), by their third differences."""
    valid = good[:, :-3] & good[:, 1:-2] & good[:, 2:-1] & good[:, 3:]
    rough = np.abs(np.diff(residual, 3, axis=1))[valid]
    square = (residual[good] ** 2).mean(axis=0)
    if len(rough) < _LEAST_ROUGH:
        return np.asarray(np.sqrt(square))
    return np.asarray(np.minimum(NORMAL * np.median(rough, axis=0) / np.sqrt(20), np.sqrt(square)))


def _few_of(parts: Sequence[Part]) -> list[Part]:
    """Return pieces of parts with samples enough for first estimates."""
    total = sum(b - a for _, a, b in parts)
    return [Part(run, piece.start, piece.stop) for run, a, b in parts for piece in pieces(a, b, total)]


def _drop_start(parts: Sequence[Part], count: int) -> list[Part]:
    """Return parts without so many samples at the start."""
    rest = list[Part]()
    for part in parts:
        rest += [part._replace(start=part.start + max(count, 0))] * (part.start + count < part.stop)
        count -= part.stop - part.start
    return rest


def _drop(
    names: Sequence[str], model: VelocityModel, parts: list[Part], best: _Trial
) -> tuple[VelocityModel, _Trial]:
    """Return the model without some free numbers, and its estimates."""
    smaller, rows = model.drop(names)
    return smaller, _Trial.of(smaller, parts, best.seconds, best.fit.p[rows], best.is_few)


def _drop_useless(model: VelocityModel, parts: list[Part], best: _Trial) -> tuple[VelocityModel, _Trial]:
    """Return the model without limits that the parts do not identify or do not reach, and its estimates."""
    limit_names, k = model.limits(), len(model.first)
    tops = np.max([np.abs(part.run.u[part.start : part.stop, :2]).max(axis=0) for part in parts], axis=0)
    rows = zip(model.free, best.weak[k:], best.fit.p[k:], strict=True)
    bounds = dict(zip(limit_names[2:], LARGEST * tops, strict=False))
    useless = [n for n, weak, x in rows if n in limit_names and (weak or x > bounds.get(n, np.inf))]
    return _drop(useless, model, parts, best) if useless else (model, best)


def _compare(model: VelocityModel, short: _Trial, long: _Trial) -> str:
    """Return a note on numbers that depend on the length of the segments; "" if there are none."""
    wide, narrow = np.diag(short.covariance), np.diag(long.covariance)
    deviation = np.sqrt(np.maximum(wide - narrow, 0.3 * wide))
    tolerance = _NOTABLE * model.sizes(long.fit.p)
    unequal = np.abs(short.fit.p - long.fit.p) > np.maximum(_DIFFERENT * deviation, tolerance)
    rows = zip(model.quantities, short.fit.p, long.fit.p, unequal & ~(short.weak | long.weak), strict=True)
    names = ", ".join(f"{item.name} {a:.3g} and {b:.3g}" for item, a, b, differs in rows if differs)
    note = (
        f"estimates from segments of {short.seconds:.3g} s and of {long.seconds:.3g} s differ: {names}: the "
        "structure of the model is wrong, and the intervals are not valid"
    )
    return note if names else ""


def _free_run(model: VelocityModel, parts: Sequence[Part], best: _Trial) -> dict[str, tuple[float, float]]:
    """Return R^2 of free runs by channel: of the log, and of its last third for a fit to the rest."""
    test = _drop_start(parts, round(TRAINING * sum(b - a for _, a, b in parts)))
    blocks = best.fit.linear.normal.shape[:2]
    train = np.arange(np.prod(blocks)).reshape(blocks) < TRAINING * np.prod(blocks)
    p, step = best.fit.p, best.fit.linear.step(train)
    step = np.insert(step, [len(model.first)] * (len(p) - len(step)), 0.0)  # of a delay that is taken as zero
    scores, scores_1 = _scores(model, p, parts), _scores(model, p + step, test)
    rows = zip(CHANNELS, scores.tolist(), scores_1.tolist(), channels_of(parts), strict=True)
    return {name: (r2, r2_test) for name, r2, r2_test, channel in rows if channel.moves}


def _scores(model: VelocityModel, p: Array, parts: Sequence[Part]) -> Array:
    """Return R^2 of the speed and of the yaw rate in free runs over parts."""
    free, left, y = replace(model, is_pose=False), [np.zeros((0, 2))], [np.zeros((0, 2))]
    for part in speeds_of(parts):
        segments, _ = segments_of([part], free.lead, min(part.stop - part.start, START_SAMPLES) * free.dt)
        if len(segments.y):
            outputs = simulate(free, segments, p[None], segments.start[None])[0]
            left.append((segments.y - outputs)[segments.good])
            y.append(segments.y[segments.good])
    return r_squared(np.concatenate(y), np.concatenate(left))


_HORIZONS = 0.1, 2.0, 5.0  # [s]
_STARTS = 10  # predictions that start within the longest horizon
_AT_ONCE = 0.05  # time constant of a robot without lag, as a share of the time step


@final
@dataclass(frozen=True, eq=False)
class Validation:
    """Errors of predictions of a hold-out, by model: the result of `identification.validate`.

    Attributes
    ----------
    horizons : ndarray, shape (H,)
        Times after the start of a prediction [s].
    names, units : tuple of k str
        Names and units of the columns: speed and yaw rate, and for poses distance and heading.
    rms : mapping of str to ndarray, shape (H, k)
        Root mean square errors of ``"kinematics"``, ``"lag"`` and ``"identified"``.
    identification : Identification
        Estimates from the first two thirds of the log.

    See Also
    --------
    identification.validate : compute these errors

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold, Log, VelocityRobot
    >>> from pinmobile import simulate
    >>> from pinmobile.controllers import RandomSteps
    >>> from pinmobile.identification import validate
    >>> robot = VelocityRobot([0.4, 0.3, 0.0, 1.0, 0.0, 1.0])
    >>> still = FixedHeading(Hold((0, 0), duration=90), psi=0)
    >>> run = simulate(robot, RandomSteps(), still, dt=0.1)
    >>> result = validate(Log.from_rollout(run, noise=1e-4))
    >>> for name in ("kinematics", "identified"):
    ...     print(name, result.rms[name][1, 2].round(2))  # after 2 s [m]
    kinematics 0.2
    identified 0.0
    """

    horizons: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    rms: Mapping[str, Array]
    identification: Identification

    def __str__(self) -> str:
        heads = [f"{name} [{unit}]" for name, unit in zip(self.names, self.units, strict=True)]
        lines = [f"{'rms error after':>15}  {'model':<10}  {'  '.join(heads)}"]
        for k, horizon in enumerate(self.horizons):
            for name, rms in self.rms.items():
                cells = "  ".join(f"{x:>{len(head)}.3g}" for x, head in zip(rms[k], heads, strict=True))
                lines.append(f"{horizon:13.3g} s  {name:<10}  {cells}")
        errors = self.rms["identified"]
        for name in ("kinematics", "lag"):
            worse = [n for k, n in enumerate(self.names) if (errors > self.rms[name])[1:, k].any()]
            lines += [f"no better than {name}: {', '.join(worse)}"] * bool(worse)
        return "\n".join(lines)


def validate(log: Log | Sequence[Log], **options: Any) -> Validation:
    """Return errors of predictions on the last third of each log, from what the first two thirds identify.

    Each prediction starts from the measured motion and runs free. Beside the identified robot stand
    a robot that follows its commands at once (kinematics), and a first-order lag of each channel with its
    gain, delay and limits. Sections that the commands do not explain do not count.

    Parameters
    ----------
    log : Log or sequence of Log
        Commands and poses or twists, see `identify_velocity`: 62 s or more.
    **options
        Of `identify_velocity`.

    Returns
    -------
    result : Validation
        Errors after 0.1, 2 and 5 s.

    Raises
    ------
    InvalidArgument
        If `identify_velocity` rejects the first two thirds, or the commands do not explain the last third.

    See Also
    --------
    identify_velocity : estimates from the whole log
    identification.Validation : the result

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold, Log, VelocityRobot
    >>> from pinmobile import simulate
    >>> from pinmobile.controllers import RandomSteps
    >>> from pinmobile.identification import validate
    >>> robot = VelocityRobot([0.4, 0.3, 0.0, 1.0, 0.0, 1.0])
    >>> still = FixedHeading(Hold((0, 0), duration=90), psi=0)
    >>> run = simulate(robot, RandomSteps(), still, dt=0.1)
    >>> print(str(validate(Log.from_rollout(run, noise=1e-4)))[:60])
    rms error after  model       speed [m/s]  yaw rate [rad/s]
    """
    logs = logs_of(log)
    spans = [float(one.t[-1] - one.t[0]) for one in logs]
    first = [one.between(0.0, TRAINING * span) for one, span in zip(logs, spans, strict=True)]
    last = [one.between(TRAINING * span, span + one.dt) for one, span in zip(logs, spans, strict=True)]
    estimates = identify_velocity(first, **options)
    train, test = (estimates.model.runs(part) for part in (first, last))
    model = replace(estimates.model, phase=test[0].phase)
    lags = [each.lag(model.lead) for each in channels_of(explained_parts(train, model.lags(estimates.phi)))]
    parts = explained_parts(test, model.lags(estimates.phi), minimum=-np.inf)  # also of a poor model
    dt = test[0].dt
    unit_lag = Lag(1.0, _AT_ONCE * dt, 0, np.inf)
    models = {"kinematics": model.of_lags([unit_lag, unit_lag]), "lag": estimates.model.of_lags(lags)}
    models["identified"] = model, estimates.phi
    every = round(1 / float(test[0].is_valid.mean()))
    horizons = np.maximum(every, np.rint(np.array(_HORIZONS) / dt)).astype(int)
    shifts = np.unique(np.linspace(0, horizons[-1], _STARTS, endpoint=False).astype(int)).tolist()
    pieces = [part._replace(start=part.start + shift) for part in parts for shift in shifts]
    columns = CHANNELS | ({"distance": "m", "heading": "rad"} if model.is_pose else {})
    rms = {}
    for name, (each, p) in models.items():
        rms[name] = _errors(each, p, pieces, horizons, every, name == "kinematics")
    return Validation(horizons * dt, tuple(columns), tuple(columns.values()), rms, estimates)


def _errors(
    model: VelocityModel, p: Array, parts: list[Part], horizons: Array, every: int, at_once: bool
) -> Array:
    """Return the rms errors, shape (H, k), of predictions that start from the measured motion."""
    squares = [_squares(replace(model, is_pose=False), p, speeds_of(parts), horizons, every, at_once)]
    if model.is_pose:
        x, y, psi = np.moveaxis(_squares(model, p, parts, horizons, every, at_once), -1, 0)
        squares.append(np.stack([x + y, psi], axis=-1))
    return np.asarray(np.sqrt(np.nanmean(np.concatenate(squares, axis=-1), axis=0)))


def _squares(
    model: VelocityModel, p: Array, parts: list[Part], horizons: Array, every: int, at_once: bool
) -> Array:
    """Return the squared errors of segments at the last measurement before each horizon, shape (S, H, m)."""
    parts = model.complete_states(parts, p)
    segments, _ = segments_of(parts, model.lead, (int(horizons[-1]) + 1) * model.dt, fill=False)
    starts = segments.start.copy()
    if at_once:
        starts[:, :2] = segments.applied(0, 1)[0, :, 0]
    outputs = simulate(model, segments, p[None], starts[None])[0]
    left = np.where(segments.good[..., None], segments.y - outputs, 0.0)
    rows = horizons[:, None] - np.arange(every)
    counts = segments.good[:, rows].sum(axis=2)[..., None]
    return np.where(counts > 0, (left[:, rows] ** 2).sum(axis=2) / np.maximum(counts, 1), np.nan)
