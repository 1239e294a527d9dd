"""How many robots have an error of which size: integer counts in logarithmic bins, which add up exactly.

The bin of a number is read off the bits of its float64: 32 bins per octave, from 2^-34 to 2^10. What is
below is counted in the first bin, what is above, or belongs to a diverged robot, in the last.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, finite, scalar
from pinmobile.errors import InvalidArgument, shown
from pinmobile.measures import value_of

SHIFT = 47  # leaves the exponent and 5 bits of the mantissa
_OCTAVES = 44
_LEAST = 2.0**-34
FIRST = int(np.float64(_LEAST).view(np.int64)) >> SHIFT
BINS = 32 * _OCTAVES + 2  # with the one below and the one above
_ROUNDING = 4 * float(np.finfo(np.float64).eps)  # of a share such as 0.07, and of its product with a count


def edges() -> Array:
    """Return the edges of the bins, shape (BINS + 1,), from 0 to infinity."""
    inner = (np.arange(FIRST, FIRST + BINS - 1, dtype=np.int64) << SHIFT).view(np.float64)
    return np.concatenate([[0.0], inner, [np.inf]])


def bins_of(values: Array) -> NDArray[np.int64]:
    """Return the bins of numbers >= 0, infinity included, shape (...)."""
    bits = np.ascontiguousarray(values).view(np.int64) >> SHIFT
    return np.asarray(np.clip(bits - FIRST + 1, 0, BINS - 1))


def miscounted(counts: NDArray[Any], times: int, channels: int, robots: int) -> str:
    """Return why counts cannot be those of some robots at some times; nothing where they can be."""
    shape = (times, channels, BINS)
    if counts.shape != shape or counts.dtype != np.int32:
        return f"has no counts {shape}"
    if (counts < 0).any() or (counts.sum(axis=-1, dtype=np.int64) != robots).any():
        return f"does not count {robots}"
    return ""


def checked_share(value: ArrayLike) -> float:
    """Return a share as a float.

    Raises
    ------
    InvalidArgument
        If it is not one number from 0 to 1.
    """
    share = scalar("share", value)
    if not 0 <= share <= 1:
        raise InvalidArgument(f"share is {shown(value)}, expected a number from 0 to 1")
    return share


def checked_levels(value: ArrayLike) -> Array:
    """Return the levels of quantiles as an array, shape (m,).

    Raises
    ------
    InvalidArgument
        If one is not between 0 and 1.
    """
    found = np.atleast_1d(finite("levels", value))
    if found.ndim != 1 or not found.size or not ((found >= 0) & (found <= 1)).all():
        raise InvalidArgument(f"levels is {shown(value)}, expected numbers from 0 to 1")
    return found


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


def _rank(share: float, count: Any) -> Any:
    """Return the share of a count, a whole number where it is one but for rounding (0.07 of 100 is 7)."""
    rank = share * count
    return np.where(np.abs(rank - np.round(rank)) <= _ROUNDING * rank, np.round(rank), rank)


def quantiles(counts: NDArray[np.int64], wanted: Array, *, margins: bool = False) -> Array:
    """Return quantiles from counts: what shares of the robots are within.

    Within a bin the numbers are taken to lie evenly in the logarithm: a quantile is off by the width of its
    bin, 2 to 3 %, at most.

    Parameters
    ----------
    counts : ndarray of int, shape (..., BINS)
        How many are in each bin; at least one in all.
    wanted : ndarray, shape (m,)
        Levels from 0 to 1.
    margins : bool
        Whether these are sizes of margins, see `pinmobile.measures.size_of`: then a share of the robots has
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
        found[k] = np.where(bin_ == 0, _LEAST * part, np.where(bin_ == BINS - 1, np.inf, between))
    return found
