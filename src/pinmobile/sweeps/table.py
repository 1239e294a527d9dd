"""The answer of a sweep in words: who stays within what."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.ensembles import percent
from pinmobile.sweeps.grids import Axis, Label, told

_MOST = 40  # rows of a table
_ROUNDING = 1e-9  # relative; that of a run is less by some orders, and what people tell apart is more


def length(metres: float) -> str:
    """Return a length in words, in a unit that suits it."""
    if not np.isfinite(metres):
        return "unknown" if np.isnan(metres) else "unbounded"
    printed = float(f"{metres:.3g}")  # what is as good as a millimetre is one, and not 1e+03 um
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("um", 1e-6)):
        if printed >= size:
            return f"{printed / size:.3g} {unit}"
    return f"{printed * 1e9:.3g} nm"


def since(after: float) -> str:
    """Return in words from which time on errors count, nothing where that is the start."""
    return f"from t = {after:g} s on, " if after else ""


def compared(within: Mapping[str, float], share: float, diverged: Mapping[str, int], n: int) -> str:
    """Return in words who stays within what, the share told once, of a single robot not at all.

    Parameters
    ----------
    within : mapping of str to float
        By name in the singular, what the share of the robots stays within [m].
    share : float
        The share.
    diverged : mapping of str to int
        How many robots did, by the same names.
    n : int
        How many robots each has.
    """
    words: list[str] = []
    bounded = False
    for label, distance in within.items():
        if np.isfinite(distance):
            said = f"{label} within" if bounded else f"{label} stays within"
            words.append(f"{said} {length(distance)}{'' if bounded else _of_runs(share, n)}")
            bounded = True
        else:
            words.append(f"{label} {_unbounded(distance, diverged[label], n, 'is', 'diverges')}")
    return ", ".join(words)


def answer(
    axes: Mapping[str, Axis],
    within: Array,
    diverged: NDArray[np.int64],
    n: int,
    share: float,
    *,
    done: float = 1.0,
    beside: str | None = None,
) -> str:
    """Return the answer in one line, for the values at which the worst happens.

    Where a member of `beside` is unbounded at all of them, the others tell where that is.

    Parameters
    ----------
    axes : mapping of str to Axis
        What was swept.
    within : ndarray, of the shape of the axes
        Distance that the share of the robots stays within [m]; NaN where nothing is known.
    diverged : ndarray of int, of the shape of the axes
        How many robots did.
    n : int
        How many robots each scenario has.
    share : float
        The share.
    done : float
        Share of all robots that has been run.
    beside : str, optional
        The axis whose members are compared with each other.
    """
    worst = _worst(within, diverged, None if beside is None else list(axes).index(beside))
    places = zip(axes.items(), worst, strict=True)
    where = [told(name, axis, int(i)) for (name, axis), i in places if name != beside and len(axis) > 1]
    begun = f"{done * 100:.3g} % of the robots are done" if done < 1 else ""
    if begun and np.isnan(within).all():
        return f"{begun}, and of no scenario all"
    prefix = f"{begun}: " if begun else ""
    if where:
        prefix += f"with {' and '.join(where)}, "
    if beside is None:
        distance = float(within[worst])
        if n == 1:
            return prefix + compared({"the robot": distance}, share, {"the robot": int(diverged[worst])}, n)
        if np.isfinite(distance):
            return f"{prefix}the robots stay within {length(distance)}{_of_runs(share, n)}"
        return f"{prefix}the robots {_unbounded(distance, int(diverged[worst]), n, 'are', 'diverge')}"
    place = list(axes).index(beside)
    others = tuple(int(i) for k, i in enumerate(worst) if k != place)

    def row(values: NDArray[Any]) -> dict[str, Any]:
        mine = np.moveaxis(values, place, -1)[others]
        return dict(zip(map(str, axes[beside].values), mine.tolist(), strict=True))

    return prefix + compared(row(within), share, row(diverged), n)


def _worst(within: Array, diverged: NDArray[np.int64], beside: int | None) -> tuple[int, ...]:
    """Return the place where the worst happens; along the axis of rivals, any.

    Of two places that with the larger distance is worse, of its rivals first the worst, then the next and so
    on: one that is unbounded everywhere decides nothing. Then that of which more robots diverge. What differs
    by less than rounding may is the same, and of the same the first is taken, on every machine.
    """
    axis = within.ndim if beside is None else beside
    sizes, lost = (values[..., None] if beside is None else values for values in (within, diverged))
    moved = np.moveaxis(np.nan_to_num(sizes, nan=-1.0, posinf=np.inf), axis, -1)
    rivals = moved.shape[-1]
    left = np.arange(moved.size // rivals)
    ranked = np.sort(moved.reshape(-1, rivals), axis=-1)[:, ::-1]
    for values in (*ranked.T, lost.sum(axis=axis).ravel()):
        most = values[left].max()
        left = left[values[left] >= min(most, most * (1 - _ROUNDING))]
    place = [int(i) for i in np.unravel_index(int(left[0]), moved.shape[:-1])]
    return tuple(place if beside is None else [*place[:beside], 0, *place[beside:]])


def axis_of_rivals(axes: Mapping[str, Axis]) -> str | None:
    """Return the axis whose members are compared with each other: of more than one, each with a name.

    That is the one whose values are controllers, else the one called ``controller``, else the last one.
    """
    named = [
        name for name, axis in axes.items() if len(axis) > 1 and all(isinstance(x, str) for x in axis.values)
    ]
    controllers = [name for name in named if all(hasattr(x, "initial_state") for x in axes[name].given)]
    return [*named, *(name for name in named if name == "controller"), *controllers][-1] if named else None


def _of_runs(share: float, n: int) -> str:
    return "" if n == 1 else f" in {share * 100:g} % of runs"


def _unbounded(distance: float, diverged: int, n: int, be: str, diverge: str) -> str:
    if np.isnan(distance):
        return f"{be} unknown"
    return diverge if n == 1 else f"{diverge} in {percent(diverged, n)} runs"


def table(
    axes: Mapping[str, Axis], within: Array, diverged: NDArray[np.int64], share: float, most: int = _MOST
) -> str:
    """Return one row for each scenario, the first `most` of them; what is not known yet is "unknown".

    Parameters
    ----------
    axes, within, diverged, share
        As of `answer`.
    most : int
        Rows, at most.
    """
    heads = [f"{name} [{axis.printed_unit}]" if axis.printed_unit else name for name, axis in axes.items()]
    rows = [[*heads, f"{share * 100:g} % within", "diverged"]]
    for index in list(np.ndindex(within.shape))[:most]:
        labels = [_text(list(axis.values)[i]) for axis, i in zip(axes.values(), index, strict=True)]
        distance = float(within[index])
        rows.append([*labels, length(distance), "unknown" if np.isnan(distance) else f"{diverged[index]:,}"])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    rest = within.size - most
    return "\n".join([*lines, *([f"... and {rest} more"] if rest > 0 else [])])


def _text(label: Label) -> str:
    return label if isinstance(label, str) else f"{label:g}"
