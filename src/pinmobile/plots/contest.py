"""Controllers in a benchmark: how far off each comes in each scenario, and at what price of chatter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from pinmobile.arrays import Array, one_of
from pinmobile.benchmarking import Benchmark
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plots.sheet import Canvas, Sheet, Spot
from pinmobile.plots.style import Style, colour, dress
from pinmobile.plots.swept import strip_above

_MARKERS = "osD^vPX*<>h"
_SPREAD = 0.6  # of the room of a scenario, over which its controllers stand side by side
_GREY = "#f4f4f4"
_DECADES = 100.0
_LEAST = 1e-3  # [mm] that is drawn


def benchmark(
    result: Benchmark,
    *,
    at: str | None = None,
    title: str | None = None,
    ax: Canvas | None = None,
    width: float | None = None,
) -> Figure:
    """Draw how far off each controller comes in each scenario, and in one of them over its chatter.

    Distances are the largest after the start, on a logarithmic scale from a micrometre on; what diverges is
    in the strip above it. Whoever is lower in the second panel and further to the right buys it by chatter.

    Parameters
    ----------
    result : Benchmark
        What `pinmobile.benchmark` returned.
    at : str, optional
        Scenario whose chatter is drawn; by default that where controllers chatter most.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`; axes are two, of scenarios and of chatter.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If it is no benchmark, or `ax` or `width` is something else.
    UnknownName
        If there is no such scenario.
    """
    if not isinstance(result, Benchmark):
        raise InvalidArgument(f"result is {shown(result)}, expected what benchmark(...) returns")
    names, distance, chatter = list(result.scenarios), 1e3 * result.values(), result.values("chatter")
    most = names[int(np.argmax(np.median(chatter, axis=0)))]
    k = names.index(one_of("at", most if at is None else at, names))
    sheet = Sheet(ax, width, 11.0)
    beside = sheet.columns(2, 4.0) == 2
    spots: list[Spot] = [(0, 0), (0, 1)] if beside else [(0, 0), (1, 0)]
    tall, ratios = ([4.4], (1.8, 1.0)) if beside else ([3.4, 3.0], ())
    places, prices = sheet.axes(spots, tall, share="", ratios=ratios)
    _scenarios(places, names, distance)
    _prices(prices, names[k], distance[:, k], chatter[:, k])
    keys = [Line2D([], [], linestyle="", label=name, **_look(i)) for i, name in enumerate(result.scores)]
    return sheet.finish(title, "How far off controllers come, and at what price", keys)


def _look(index: int) -> Style:
    """Return how the marks of a controller look: every second round of colours is hollow."""
    size = float(rcParams["lines.markersize"])
    return {
        "marker": _MARKERS[index % len(_MARKERS)],
        "color": colour(index),
        "markersize": size,
        "markeredgewidth": 0.25 * size,
        "fillstyle": "full" if index // 6 % 2 == 0 else "none",
    }


def _scenarios(axes: Axes, names: Sequence[str], distance: Array) -> None:
    dress(axes)
    for k in range(1, len(names), 2):
        axes.axvspan(k - 0.5, k + 0.5, color=_GREY, linewidth=0, zorder=0)
    top = _scale(axes, distance)
    count = len(distance)
    for i, row in enumerate(distance):
        aside = _SPREAD * (i - (count - 1) / 2) / max(count, 2)
        y = np.where(np.isinf(row), top, np.maximum(row, _LEAST))
        axes.plot(np.arange(len(row)) + aside, y, linestyle="", zorder=3, **_look(i))
    axes.set_xticks(range(len(names)), names, rotation=90)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.grid(False, axis="x")
    axes.set_ylabel("largest distance [mm]")


def _prices(axes: Axes, name: str, distance: Array, chatter: Array) -> None:
    dress(axes)
    kept = np.isfinite(distance) & np.isfinite(chatter) & (chatter > 0)
    axes.set_xscale("log")
    _scale(axes, distance[kept])
    for i in np.flatnonzero(kept):
        look = _look(int(i))
        larger = 1.3 * look["markersize"]
        axes.plot(
            chatter[i], max(distance[i], _LEAST), linestyle="", zorder=3, **look | {"markersize": larger}
        )
    _tick(axes.xaxis)
    axes.set_xlabel(f"chatter in {name} [N/s]")
    axes.set_ylabel(f"largest distance in {name} [mm]")


def _scale(axes: Axes, distance: Array) -> float:
    """Choose a logarithmic axis that holds what is finite, and return where what diverges is marked."""
    known = np.maximum(distance[np.isfinite(distance)], _LEAST)
    low, high = (known.min() / 1.6, known.max() * 1.6) if len(known) else (0.1, 1.0)
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    _tick(axes.yaxis)
    if not np.isinf(distance).any():
        return float(high)
    return strip_above(axes, "diverges", numbers=bool(len(known)))


def _tick(axis: Axis) -> None:
    """Write plain numbers at a logarithmic axis; where it spans less than two decades, at 2 and 5 too."""
    low, high = axis.get_view_interval()
    if high < _DECADES * low:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(_plain))
    axis.set_minor_formatter(NullFormatter())


def _plain(value: float, _: object) -> str:
    return f"{value:g}" if 1e-4 < value < 1e6 else f"{value:.0e}"
