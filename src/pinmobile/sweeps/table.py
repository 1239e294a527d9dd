"""The answer of a sweep in words: who stays within what."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.sweeps.axes import Axis, Label, told

__all__ = ["answer", "length", "table"]

_MOST = 40  # rows of a table


def length(metres: float) -> str:
    """Return a length in words, in a unit that suits it."""
    if not np.isfinite(metres):
        return "unknown" if np.isnan(metres) else "unbounded"
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("um", 1e-6)):
        if metres >= size:
            return f"{metres / size:.3g} {unit}"
    return f"{metres * 1e9:.3g} nm"


def answer(axes: Mapping[str, Axis], within: Array, share: float) -> str:
    """Return the answer in one line, for the values at which the worst happens.

    Parameters
    ----------
    axes : mapping of str to Axis
        What was swept.
    within : ndarray, of the shape of the axes
        Distance that the share of the robots stays within [m]; NaN where nothing is known.
    share : float
        The share.
    """
    beside = _beside(axes)
    known = np.nan_to_num(within, nan=-1.0, posinf=np.inf)
    worst = np.unravel_index(int(np.argmax(known)), within.shape)
    places = zip(axes.items(), worst, strict=True)
    where = [told(name, axis, int(i)) for (name, axis), i in places if name != beside]
    prefix = f"with {' and '.join(where)}, " if where else ""
    said = f"in {share * 100:g} % of runs"
    if beside is None:
        return f"{prefix}the robots stay within {length(float(within[worst]))} {said}"
    place = list(axes).index(beside)
    words = []
    for k, label in enumerate(axes[beside].values):
        distance = length(float(within[(*worst[:place], k, *worst[place + 1 :])]))
        words.append(f"{label} stays within {distance} {said}" if k == 0 else f"{label} within {distance}")
    return prefix + ", ".join(words)


def table(
    axes: Mapping[str, Axis], within: Array, diverged: NDArray[np.int64], share: float, most: int = _MOST
) -> str:
    """Return one row for each scenario, the first `most` of them.

    Parameters
    ----------
    axes, within, share
        As of `answer`.
    diverged : ndarray of int, of the shape of the axes
        How many robots did.
    most : int
        Rows, at most.
    """
    heads = [f"{name} [{axis.unit}]" if axis.unit else name for name, axis in axes.items()]
    rows = [[*heads, f"{share * 100:g} % within", "diverged"]]
    for index in list(np.ndindex(within.shape))[:most]:
        labels = [_text(list(axis.values)[i]) for axis, i in zip(axes.values(), index, strict=True)]
        rows.append([*labels, length(float(within[index])), f"{diverged[index]:,}"])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    rest = within.size - most
    return "\n".join([*lines, *([f"... and {rest} more"] if rest > 0 else [])])


def _beside(axes: Mapping[str, Axis]) -> str | None:
    """Return the last axis whose values are text: its members are compared with each other."""
    named = [name for name, axis in axes.items() if all(isinstance(value, str) for value in axis.values)]
    return named[-1] if named else None


def _text(label: Label) -> str:
    return label if isinstance(label, str) else f"{label:g}"
