"""Numbers over one parameter that was swept."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pinmobile.arrays import Array, ArrayLike, finite, real, text
from pinmobile.errors import InvalidArgument, shown
from pinmobile.palette import INK, colour
from pinmobile.plots.beyond import strip_above
from pinmobile.plots.style import ShownFigure, dress, headed, legend

__all__ = ["curves"]

_LOGARITHMIC = 20.0  # from which ratio of the largest to the smallest on, the axis is logarithmic
_MARKERS = "osD^vP"  # with the colours: lines that coincide are told apart

_Axis = tuple[str, str, Sequence[Any] | Array]


def curves(values: Mapping[str, ArrayLike], *, x: _Axis, label: str, title: str | None = None) -> Figure:
    """Draw numbers over a parameter, a curve for each name.

    Where a number is infinite, nothing bounds it: a cross in a strip at the top says so. The axis is
    logarithmic where the numbers differ by a factor of more than 20.

    Parameters
    ----------
    values : mapping of str to array_like, shape (len(x values),)
        Numbers or infinity, by name; of a single curve, the name may be "".
    x : tuple of str, str and sequence
        Name, unit ("" for none) and values of the parameter: numbers.
    label : str
        What the numbers are, with their unit, such as ``"99 % stay within [mm]"``.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If there are no curves, one has another shape, or holds NaN.
    """
    places, label = _places(x), text("label", label)
    if not isinstance(values, Mapping) or not values:
        raise InvalidArgument(f"values is {shown(values)}, expected a mapping of names to numbers")
    rows = {name: _row(name, row, len(places)) for name, row in values.items()}
    figure = ShownFigure(figsize=(8, 5), dpi=100)
    figure.set_layout_engine("constrained")
    figure.suptitle(headed(title, f"{label} over {x[0]}"), fontsize=14, color=INK)
    axes = figure.subplots()
    dress(axes)
    order = np.argsort(places, kind="stable")
    top = _scale(axes, np.concatenate(list(rows.values())))
    for k, row in enumerate(rows.values()):
        _curve(axes, places[order], row[order], top, k, len(rows))
    axes.set_xlabel(f"{x[0]} [{x[1]}]" if x[1] else x[0], fontsize=11)
    axes.set_ylabel(label, fontsize=11)
    keys = _keys(rows)
    if keys:
        legend(figure, keys)
    return figure


def _places(x: Any) -> Array:
    if not isinstance(x, Sequence) or isinstance(x, str) or len(x) != 3:
        raise InvalidArgument(f"x is {shown(x)}, expected (name, unit, values)")
    text("x[0]", x[0])
    text("x[1]", x[1])
    places = finite("x[2]", x[2])
    if places.ndim != 1 or not len(places):
        raise InvalidArgument(f"x[2] has shape {places.shape}, expected (n,) with n >= 1")
    return places


def _row(name: str, values: ArrayLike, count: int) -> Array:
    text("values", name)
    row = real(f"values[{name!r}]", values)
    if row.shape != (count,):
        raise InvalidArgument(f"values[{name!r}] is {shown(values)}, expected {count} real numbers")
    if np.isnan(row).any() or (row == -np.inf).any():
        raise InvalidArgument(f"values[{name!r}] is {shown(values)}, expected numbers or infinity")
    return row


def _scale(axes: Axes, numbers: Array) -> float:
    """Choose the axis, and return where what is unbounded is marked."""
    known = numbers[np.isfinite(numbers)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    if 0 < _LOGARITHMIC * low < high:
        axes.set_yscale("log")
        room = (high / low) ** 0.05
        axes.set_ylim(low / room, high * room)
    else:
        least = min(low, 0.0)
        axes.set_ylim(least, high + 0.05 * ((high - least) or 1.0))
    if len(known) == len(numbers):
        return high
    return strip_above(axes, "diverges", numbers=bool(len(known)))


def _curve(axes: Axes, x: Array, row: Array, top: float, index: int, count: int) -> None:
    known = np.isfinite(row)
    # Below the others wide and large, so that a curve shows where the next one covers it.
    extra = 3.0 * (count - 1 - index) / max(count - 1, 1)
    axes.plot(x, np.where(known, row, np.nan), zorder=3, linewidth=1.8 + extra / 2,
              markersize=6 + extra, **_look(index))  # fmt: skip
    axes.plot(x[~known], np.full(np.count_nonzero(~known), top), linestyle="", marker="x",
              markersize=8 + 2 * extra, markeredgewidth=2, color=colour(index), zorder=4)  # fmt: skip


def _look(index: int) -> dict[str, Any]:
    return {"color": colour(index), "marker": _MARKERS[index % len(_MARKERS)]}


def _keys(rows: Mapping[str, Array]) -> list[Artist]:
    found: list[Artist] = [Line2D([], [], label=name, **_look(k)) for k, name in enumerate(rows) if name]
    if any(np.isinf(row).any() for row in rows.values()):
        found.append(Line2D([], [], color=INK, marker="x", linestyle="", label="diverges"))
    return found
