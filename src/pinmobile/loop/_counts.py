"""What is kept of robots: the records of each, counts of their errors over time, and one robot run alone.

How many robots have an error of which size are integers in logarithmic bins, which add up exactly. The bin of
a number is read off the bits of its float64: 32 bins per octave, from 2^-34 to 2^10. What is below is counted
in the first bin, what is above, or belongs to a diverged robot, in the last.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, bounded, finite, scalar, shaped
from pinmobile.compiled import BINS, FIRST, SHIFT
from pinmobile.controllers import Controller
from pinmobile.loop._scenario import Scenario
from pinmobile.metrics import value_of
from pinmobile.parts import replace
from pinmobile.trajectories import Trajectory

_ROUNDING = 4 * float(np.finfo(np.float64).eps)  # of a share such as 0.07, and of its product with a count


class Part(NamedTuple):
    """The records of m robots.

    Attributes
    ----------
    lived : ndarray of int, shape (m,)
        Samples before the loop diverged; all of them where it did not.
    max_error : ndarray, shape (m, c)
        Largest |error| of the reference's c coordinates in those of these samples from `Scenario.after` on.
    max_distance : ndarray, shape (m,)
        Largest distance from the desired position [m].
    rms_error : ndarray, shape (m, c)
        Root of the mean squared error.
    max_input : ndarray, shape (m, nu)
        Largest |input|.
    worst_metric, rms_metric : ndarray, shape (m, j)
        Worst, and root of the mean square, of each metric, in the samples of which errors are kept.
    counts : ndarray of int, shape (G, channels, BINS)
        At each time of the grid, how many robots have a distance, and so on, of which size; see
        `Scenario.channels`.
    """

    lived: NDArray[np.int64]
    max_error: Array
    max_distance: Array
    rms_error: Array
    max_input: Array
    worst_metric: Array
    rms_metric: Array
    counts: NDArray[np.int32]

    @classmethod
    def of(cls, scenario: Scenario, record: Mapping[str, Array], counts: NDArray[np.int32]) -> Part:
        """Return what a `Summary` kept of m robots, its arrays with the robots as their first axis."""
        lived = record["lived"].astype(np.int64)
        kept = np.maximum(lived - scenario.begin, 1)[:, None]
        none = np.zeros((len(lived), 0))
        signs = np.array([-1.0 if one.is_margin else 1.0 for one in scenario.recorded_metrics])
        return cls(
            lived,
            record["largest"].copy(),  # not a view of all that the robots kept
            np.sqrt(record["farthest"][:, 0]),
            np.sqrt(record["squares"] / kept),
            record["inputs"].copy(),
            record.get("worst", none) * signs,
            np.sqrt(record.get("metric_squares", none) / kept),
            counts,
        )

    @classmethod
    def joined(cls, parts: Iterable[Part]) -> Part:
        """Return the records of all robots of some parts, in their order."""
        columns: list[list[Any]] = [[] for _ in cls._fields[:-1]]
        counts: Any = 0
        for *own, counted in parts:
            counts = counts + counted
            for column, rows in zip(columns, own, strict=True):
                column.append(rows)
        # One after the other, so that hardly anything is in memory twice.
        return cls._make([*(np.concatenate(columns.pop(0)) for _ in cls._fields[:-1]), counts])


class Member(NamedTuple):
    """One robot of an ensemble: ``simulate(*member[:3], **member.options)`` runs it alone.

    Attributes
    ----------
    robot, controller, trajectory
        As in `simulate`.
    options : dict
        The other arguments of `simulate`.
    """

    robot: Any
    controller: Controller
    trajectory: Trajectory
    options: dict[str, Any]


def member_of(scenario: Scenario, i: int, drawn: Mapping[str, Array] | None = None) -> Member:
    """Return robot i as the arguments of `simulate`.

    Parameters
    ----------
    scenario : Scenario
        Whose robot.
    i : int
        Its index, 0 <= i < n.
    drawn : mapping of str to ndarray, shape (1,), optional
        What was drawn for it.
    """
    draws = scenario.draws(i, i + 1) if drawn is None else drawn
    values = scenario.values(draws, i, i + 1).items()
    own_values = {path: value[0] for path, value in values if not path.startswith("start")}
    loop = replace(scenario.loop, own_values)
    own = scenario.references(draws, 1, i)
    q, v = scenario.starts(draws, 1, own)
    options = {
        "dt": scenario.dt,
        "duration": scenario.duration if own is None else float(scenario.t[-1]),
        "q0": q[0],
        "v0": v[0],
        "integrator": scenario.integrator,
        "substeps": scenario.substeps,
        "forces": loop.forces,
        "limit": scenario.limit,
    }
    if scenario.is_noisy:
        options |= {"seed": scenario.seed, "member": i}
    return Member(loop.plant, loop.controller, loop.trajectory, options)


def edges() -> Array:
    """Return the edges of the bins, shape (BINS + 1,), from 0 to infinity."""
    inner = (np.arange(FIRST, FIRST + BINS - 1, dtype=np.int64) << SHIFT).view(np.float64)
    return np.concatenate([[0.0], inner, [np.inf]])


def bins_of(values: Array) -> NDArray[np.int64]:
    """Return the bins of numbers >= 0, infinity included, shape (...)."""
    bits = np.ascontiguousarray(values).view(np.int64) >> SHIFT
    return np.asarray(np.clip(bits - FIRST + 1, 0, BINS - 1))


def checked_share(value: ArrayLike) -> float:
    """Return a share as a float.

    Raises
    ------
    InvalidArgument
        If it is not one number from 0 to 1.
    """
    return bounded("share", scalar("share", value), least=0, most=1)


def checked_levels(value: ArrayLike) -> Array:
    """Return the levels of quantiles as an array, shape (m,).

    Raises
    ------
    InvalidArgument
        If one is not between 0 and 1.
    """
    found = shaped("levels", np.atleast_1d(finite("levels", value)), ("n>=1",))
    return bounded("levels", found, least=0, most=1)


def share_within(values: Array, share: float, axis: int = -1) -> Array:
    """Return the least of the values that a share of them does not exceed; NaN where one is NaN.

    Parameters
    ----------
    values : ndarray
        Along `axis`, at least one.
    share : float
        From 0 to 1; of 0, the smallest value.
    axis : int
        The axis that is reduced.
    """
    place = max(int(np.ceil(_rank(share, values.shape[axis]))), 1) - 1
    found = np.take(np.partition(values, place, axis), place, axis)
    return np.where(np.isnan(values).any(axis), np.nan, found)


def _rank(share: float, count: int | NDArray[np.int64]) -> Array:
    """Return the share of a count, a whole number where it is one but for rounding (0.07 of 100 is 7)."""
    rank = np.asarray(share * count)
    return np.where(np.abs(rank - np.round(rank)) <= _ROUNDING * rank, np.round(rank), rank)


def quantiles(counts: NDArray[np.int64], wanted: Array, *, margins: bool = False) -> Array:
    """Return quantiles from counts: what shares of the robots are within.

    Within a bin the numbers are taken to lie evenly in the logarithm: a quantile is off by the width
    of its bin, 2 to 3 %, at most.

    Parameters
    ----------
    counts : ndarray of int, shape (..., BINS)
        How many are in each bin; at least one in all.
    wanted : ndarray, shape (m,)
        Levels from 0 to 1.
    margins : bool
        Whether these are sizes of margins, see `pinmobile.metrics.size_of`: then a share of the robots has
        at least what is returned, in numbers of the margin.

    Returns
    -------
    quantiles : ndarray, shape (m, ...)
        Infinite where it falls in the last bin, of margins minus infinity in the first.
    """
    bounds = edges()
    if margins:
        # From the best to the worst; of what is in the best bin only its lower edge is known.
        counts, bounds = counts[..., ::-1], np.append(bounds[-2], bounds[-2::-1])
    total = counts.cumsum(axis=-1)
    found = np.empty((len(wanted), *counts.shape[:-1]))
    for k, level in enumerate(wanted):
        rank = _rank(level, total[..., -1:])
        # The first bin whose total reaches the rank, and is not empty.
        bin_ = np.minimum((total < np.maximum(rank, 1e-9)).sum(axis=-1), BINS - 1)
        inside = np.take_along_axis(counts, bin_[..., None], -1)[..., 0]
        before = np.take_along_axis(total, bin_[..., None], -1)[..., 0] - inside
        part = (rank[..., 0] - before) / np.maximum(inside, 1)
        low, high = bounds[bin_], bounds[bin_ + 1]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            between = low * (high / low) ** part
        if margins:
            found[k] = value_of(np.where(bin_ == BINS - 1, 0.0, between))
            continue
        found[k] = np.where(bin_ == 0, bounds[1] * part, np.where(bin_ == BINS - 1, np.inf, between))
    return found
