"""An ensemble in words: what its robots stay within, and how large errors and forces are."""

from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from pinmobile.arrays import Array
from pinmobile.measures import Measure
from pinmobile.plant import Coordinate, Input

__all__ = ["judgement", "percent", "ranges"]

_NARROWEST = 28  # letters of a row's name


def judgement(n: int, duration: float, within: tuple[float, float], diverged: int, after: float) -> str:
    """Return in one line what came of n robots.

    Parameters
    ----------
    n : int
        Number of robots.
    duration : float
        Of each run [s].
    within : tuple of 2 floats
        What 99 % of them stay within [m, rad]; infinite where fewer have not diverged.
    diverged : int
        How many did.
    after : float
        Time from which on errors count [s].
    """
    sizes = f"within {within[0]:.4g} m and {within[1]:.4g} rad"
    since = f"from {after:g} s on " if after else ""
    if n == 1:
        return f"1 robot over {duration:g} s: {'diverged' if diverged else f'{since}stays {sizes}'}"
    start = f"{n:,} robots over {duration:g} s: "
    if np.isinf(within[0]):
        return f"{start}{diverged:,} diverged, {percent(diverged, n).removesuffix(' of')}"
    sizes = f"{since}99 % stay {sizes}"
    return f"{start}{sizes}, {f'{diverged:,} diverged' if diverged else 'none diverged'}"


def percent(part: int, n: int) -> str:
    """Return a part of n in words: ``96 % of``, or ``all``; what is not all is never told as 100 %."""
    if part == n:
        return "all"
    share = 100 * part / n
    return f"{share:.2g} % of" if share < 99 else "more than 99 % of"


def ranges(
    max_distance: Array,
    max_error: Array,
    max_force: Array,
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    worst_measure: Array,
    measures: Sequence[Measure],
) -> list[str]:
    """Return a row for each error, input and measure: the least, the median and the largest over the robots.

    Parameters
    ----------
    max_distance : ndarray, shape (n,)
        Largest distance from the desired position [m].
    max_error, max_force : ndarray, shape (n, c), (n, nu)
        Largest error and input.
    coordinates, inputs : sequence of Coordinate, sequence of Input
        Their names and units.
    worst_measure : ndarray, shape (n, j)
        Worst of what else is judged.
    measures : sequence of Measure
        Its names and units.
    """
    columns = {"largest distance [m]": max_distance}
    errors = [
        (_titled(f"error of {one.name}", one.unit), column)
        for one, column in zip(coordinates, max_error.T, strict=True)
    ]
    sizes = [(_titled(one.name, one.unit), column) for one, column in zip(inputs, max_force.T, strict=True)]
    for pair in zip_longest(errors, sizes):
        columns |= {title: column for title, column in filter(None, pair)}
    each = zip(measures, worst_measure.T, strict=True)
    columns |= {f"{one.worst} {one.title}": column for one, column in each}
    rows, width = [], max(_NARROWEST, *map(len, columns))
    for name, values in columns.items():
        good = values[~np.isnan(values)]
        if len(good):
            low, middle, high = good.min(), np.median(good), good.max()
            rows.append(f"{name:<{width}} least {low:.4g}, median {middle:.4g}, largest {high:.4g}")
    return rows


def _titled(name: str, unit: str) -> str:
    return f"largest {name} [{unit}]" if unit else f"largest {name}"
