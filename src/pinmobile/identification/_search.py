"""Search for the numbers of a model by output error: first speeds, then poses, in ever longer segments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification._commands import (
    CHANNELS,
    LEAST,
    Part,
    block_of,
    channels_of,
    check_explained,
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
    unexplained,
)
from pinmobile.identification._lag import LARGEST, Lag
from pinmobile.identification._simulation import MANY, Segments, pieces, simulate
from pinmobile.identification._velocity_model import VelocityModel

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
        few = few_of(parts)
        shares = zip(CHANNELS, _explained(model, start, few).tolist(), channels_of(few), strict=True)
        check_explained({name: share if channel.moves else None for name, share, channel in shares}, lags, dt)
    try:
        tried = list(_tried(model, parts, start))
    except InvalidArgument:  # such as a limit that only one block shows
        kept = [k for k, name in enumerate(model.free) if name not in model.limits()]
        if len(kept) == len(model.free):
            raise
        start = start[[*range(len(model.first)), *(len(model.first) + k for k in kept)]]
        model = replace(model, free=tuple(model.free[k] for k in kept))
        tried = list(_tried(model, parts, start))
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
    elif (share := min(each for each, _ in free_run.values())) < LEAST:
        raise unexplained(share)
    poor = [name for name, (_, after) in free_run.items() if after < _POOR]
    if poor:
        named = " and the ".join(poor)
        remarks.append(f"the model does not predict the {named} of the hold-out: do not use it elsewhere")
    model.check(p, lost)
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
        delay_error=float(np.sqrt(best.covariance[late, late])) if "delay" in model.free else np.nan,
        dt=dt,
        seconds=min(best.seconds, max(b - a for _, a, b in parts) * dt),
        outliers=int((best.segments.good & ~good).sum()),
        dropped=0,
        samples=int(good.sum()),
        segments=len(good),
        noise=_noise_of(found.near.residual, good),
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
    given = speeds_of(few_of(parts))
    segments, calm = segments_of(given, model.lead, model.dt * _LONGER * block_of(given))

    def fit(model: VelocityModel, p: Array) -> tuple[VelocityModel, Array, float, bool]:
        found, lost = solve_robustly(model, segments, p, calm=calm, natural=model.natural)
        useless = [name for name, is_lost in zip(model.free, lost[count:], strict=True) if is_lost]
        useless = [name for name in useless if name in model.limits()]
        p, kept = np.where(lost, p, found.p), [k for k, name in enumerate(model.free) if name not in useless]
        left, whiteness = found.near.residual, Whiteness.of(found.near.residual, found.good)
        less = replace(model, free=tuple(model.free[k] for k in kept))
        rows = [*range(count), *(count + k for k in kept)]
        return less, p[rows], float(np.log(left[found.good].var(axis=0)).sum()), whiteness.is_white

    count = len(model.first)
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
        segments = segments.some(kept)._replace(blocks=max(1, segments.y.shape[1] // block_of(parts)))
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


def few_of(parts: Sequence[Part]) -> list[Part]:
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
    count = len(model.first)
    kept = [*range(count), *(count + k for k, name in enumerate(model.free) if name not in names)]
    less = replace(model, free=tuple(name for name in model.free if name not in names))
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
    blocks = best.fit.near.normal.shape[:2]
    early = np.arange(np.prod(blocks)).reshape(blocks) < TRAINED * np.prod(blocks)
    p, step = best.fit.p, best.fit.near.step(early)
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
