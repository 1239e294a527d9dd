"""What a rollout recorded, over time: states, errors and forces."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.plots.runs import Rollouts, labelled, same_references, thinned
from pinmobile.plots.style import DESIRED, INK, ShownFigure, colour, dress, heading, legend, line_style

__all__ = ["draw", "errors", "forces", "stacked", "states"]

_POSE = (("$x$", "m"), ("$y$", "m"), (r"$\psi$", "rad"))
_FORCE = (("$F_x$", "N"), ("$F_y$", "N"), ("$M_z$", "N m"))
_ROUNDING = 1e-12  # what is smaller is drawn as the zero that it is


def states(rollouts: Rollouts, *, title: str | None = None) -> Figure:
    """Draw x, y and psi over time, desired and actual.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else.
    """
    runs = labelled(rollouts)
    names = _names(_POSE, [run.q for run in runs.values()], "q")
    figure, grid = stacked(names, 1, title or "Desired and actual pose")
    for index, (label, run) in enumerate(runs.items()):
        draw(grid[:, 0], run.t, run.q, label=label or "actual", **line_style(index, len(runs)))
    for labels in same_references(runs).values():
        run = runs[labels[0]]
        draw(grid[:, 0], run.t, run.reference.q, label="desired", **DESIRED)
    legend(figure, [Line2D([], [], label="desired", **DESIRED), *grid[0, 0].lines[: len(runs)]])
    return figure


def errors(rollouts: Rollouts, *, title: str | None = None) -> Figure:
    """Draw the errors of x, y and psi over time, desired minus actual, psi on the circle.

    Controllers differ by orders of magnitude, so each rollout has a column with its own scale; above each
    panel stands the largest |error|.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else.
    """
    runs = labelled(rollouts)
    names = _names(_POSE, [run.error for run in runs.values()], "q")
    note = "; each panel has its own scale" if len(runs) > 1 else ""
    quantities = [(f"error in {symbol}", unit) for symbol, unit in names]
    figure, grid = stacked(quantities, len(runs), title or f"Error: desired minus actual{note}")
    for index, (label, run) in enumerate(runs.items()):
        column = grid[:, index]
        draw(column, run.t, run.error, label=label, color=colour(index), linewidth=1.8, zorder=3)
        for axes, (_, unit), values in zip(column, names, run.error.T, strict=False):
            axes.set_title(f"largest {_power(float(np.abs(values).max()))} {unit}", fontsize=11, loc="right")
        column[0].annotate(label, (0, 1), (0, 26), **heading(index))
    return figure


def forces(rollouts: Rollouts, *, title: str | None = None) -> Figure:
    """Draw the generalised force over time, held from one sample to the next.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else.
    """
    runs = labelled(rollouts)
    # Only a force that belongs to v is Fx, Fy, Mz: other plants' inputs are their own.
    generalised = all(run.tau.shape == run.v.shape for run in runs.values())
    names = _names(_FORCE if generalised else (), [run.tau for run in runs.values()], "u")
    figure, grid = stacked(names, 1, title or "Force, held from one sample to the next")
    for index, (label, run) in enumerate(runs.items()):
        draw(grid[:, 0], run.t, run.tau, label=label, drawstyle="steps-post", **line_style(index, len(runs)))
    if len(runs) > 1:
        legend(figure, grid[0, 0].lines)
    return figure


def _names(known: Sequence[tuple[str, str]], arrays: Sequence[Array], letter: str) -> list[tuple[str, str]]:
    """Return symbol and unit for the columns of the widest array; other units are unknown."""
    count = max(array.shape[1] for array in arrays)
    return [*known[:count], *((f"${letter}_{{{k}}}$", "") for k in range(len(known), count))]


def stacked(names: Sequence[tuple[str, str]], columns: int, title: str) -> tuple[Figure, NDArray[Any]]:
    """Return a figure with a row of axes for each coordinate, and the axes, shape (rows, columns)."""
    size = max(9.0, 3.2 * columns), 1.2 + 1.75 * len(names)
    figure = ShownFigure(figsize=size, dpi=100, layout="constrained")
    figure.suptitle(title, fontsize=14, color=INK)
    grid = figure.subplots(len(names), columns, squeeze=False, sharex="col")
    for row, (symbol, unit) in zip(grid, names, strict=True):
        for axes in row:
            dress(axes)
            axes.margins(x=0.01, y=0.1)
            formatter = ScalarFormatter(useMathText=True)
            formatter.set_powerlimits((-3, 4))
            axes.yaxis.set_major_formatter(formatter)
        row[0].set_ylabel(f"{symbol} [{unit}]" if unit else symbol, fontsize=12)
    for axes in grid[-1]:
        axes.set_xlabel("t [s]", fontsize=11)
    figure.align_ylabels(grid[:, 0])
    return figure, grid


def draw(column: Iterable[Axes], t: Array, values: Array, **style: Any) -> None:
    """Draw each coordinate, shape (N,) of values (N, n), in its axes."""
    for axes, line in zip(column, values.T, strict=False):
        kept = thinned(line)
        axes.plot(t[kept], line[kept], marker="o" if len(line) == 1 else "", **style)
        if np.abs(axes.dataLim.intervaly).max() < _ROUNDING:
            axes.set_ylim(-_ROUNDING, _ROUNDING)


def _power(value: float) -> str:
    if value == 0 or 0.01 <= value < 1000:
        return f"{value:.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return rf"${mantissa}\cdot 10^{{{int(exponent)}}}$"
