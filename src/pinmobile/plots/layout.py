"""Where the axes of a figure over time stand: below each other, or many abreast."""

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from pinmobile.palette import INK
from pinmobile.plots.style import ShownFigure, dress

__all__ = ["TALL", "laid_out", "stacked", "titled"]

TALL = 6
"""So many coordinates are drawn below each other, with their symbols beside them; more are not."""

_ABREAST = 3


def stacked(names: Sequence[tuple[str, str]], columns: int, title: str) -> tuple[Figure, NDArray[Any]]:
    """Return a figure with a row of axes for each coordinate, and the axes, shape (rows, columns)."""
    size = max(9.0, 3.2 * columns), 1.2 + 1.75 * len(names)
    figure, grid = _grid((len(names), columns), size, title)
    for row, (symbol, unit) in zip(grid, names, strict=True):
        row[0].set_ylabel(f"{symbol} [{unit}]" if unit else symbol, fontsize=12)
    for axes in grid[-1]:
        axes.set_xlabel("t [s]", fontsize=11)
    figure.align_ylabels(grid[:, 0])
    return figure, grid


def laid_out(names: Sequence[tuple[str, str]], title: str) -> tuple[Figure, list[Axes]]:
    """Return a figure with one of the axes for each coordinate: below each other, or many three in a row."""
    if len(names) <= TALL:
        figure, grid = stacked(names, 1, title)
        return figure, list(grid[:, 0])
    rows = -(-len(names) // _ABREAST)
    size = 12.0, 1.2 + 1.75 * rows
    figure, grid = _grid((rows, _ABREAST), size, title)
    panels = list(grid.ravel())
    for axes, (symbol, unit) in zip(panels, names, strict=False):
        _name(axes, symbol, unit)
    for axes in panels[len(names) :]:
        axes.remove()
    for axes in panels[: len(names)][-_ABREAST:]:
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("t [s]", fontsize=11)
    return figure, panels[: len(names)]


def titled(
    names: Sequence[tuple[str, str]], columns: int, title: str, height: float
) -> tuple[Figure, NDArray[Any]]:
    """Return axes as `stacked` does, each with its name above it: names of joints are long."""
    size = max(9.0, 4.2 * columns), 1.4 + height * len(names)
    figure, grid = _grid((len(names), columns), size, title)
    for row, (symbol, unit) in zip(grid, names, strict=True):
        for axes in row:
            _name(axes, symbol, unit)
    for axes in grid[-1]:
        axes.set_xlabel("t [s]", fontsize=11)
    figure.align_ylabels(grid[:, 0])
    return figure, grid


def _name(axes: Axes, symbol: str, unit: str) -> None:
    axes.set_title(symbol, fontsize=11, loc="left", color=INK)
    axes.set_ylabel(f"[{unit}]" if unit else "", fontsize=10)


def _grid(shape: tuple[int, int], size: tuple[float, float], title: str) -> tuple[Figure, NDArray[Any]]:
    figure = ShownFigure(figsize=size, dpi=100, layout="constrained")
    figure.suptitle(title, fontsize=14, color=INK)
    grid = figure.subplots(*shape, squeeze=False, sharex="col")
    for axes in grid.ravel():
        dress(axes)
        axes.margins(x=0.01, y=0.1)
        formatter = ScalarFormatter(useMathText=True)
        formatter.set_powerlimits((-3, 4))
        axes.yaxis.set_major_formatter(formatter)
    return figure, grid
