"""How an integrator's errors shrink with its step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator

from pinmobile.accuracy import Convergence, IntegratorReport
from pinmobile.palette import INK, colour
from pinmobile.plots.style import ShownFigure, dress, headed, legend, line_style, named

_PANELS = (
    (0, 0, "position", "Free body: position at the end"),
    (0, 1, "momentum", "Free body: linear momentum"),
    (1, 0, "energy", "Free body: kinetic energy"),
    (1, 1, "angular_momentum", "Free body: angular momentum"),
    (0, 2, "substeps", "Loop: force held for {:g} ms"),
    (1, 2, "sampling", "Loop: force held for h"),
)
_FLOOR = 1e-17  # where zero is drawn
_TICKS = 6  # at most, along the steps
_LONGEST = 22  # characters of a label above a panel; the legend has all
_GREY = "#dddddd"
_GUIDE: dict[str, Any] = {"color": "#999999", "linestyle": (0, (4, 3)), "linewidth": 1.0, "zorder": 2}


def integrator(
    reports: IntegratorReport | Mapping[str, IntegratorReport], *, title: str | None = None
) -> Figure:
    """Draw the errors over the step, double logarithmic, beside lines of the whole order that is nearest.

    The measured orders are written above each panel. What lies in the grey is rounding.

    Parameters
    ----------
    reports : IntegratorReport or mapping of str to IntegratorReport
        All are drawn in the same axes.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `reports` is something else.
    """
    known: dict[str, IntegratorReport] = named("reports", reports, IntegratorReport)
    figure = ShownFigure(figsize=(9.0, 5.6 + 0.3 * len(known)), dpi=100, layout="constrained")
    whose = f" of {next(iter(known.values())).integrator}" if "" in known else ""
    figure.suptitle(headed(title, f"Accuracy{whose}: error over the step"), fontsize=14, color=INK)
    grid = figure.subplots(2, 3, squeeze=False, sharex=True)
    for row, column, attribute, heading in _PANELS:
        rows = [getattr(report, attribute) for report in known.values()]
        _panel(grid[row, column], rows, list(known), lowest=row == 1)
        held = 1e3 * rows[0].steps[0]
        grid[row, column].set_title(
            heading.format(held), fontsize=9.5, color=INK, pad=4 + 12 * len(known), loc="left"
        )
    legend(figure, list(_keys(list(known))))
    return figure


def _keys(labels: Sequence[str]) -> Iterator[Artist]:
    for index, label in enumerate(labels):
        if label:
            yield Line2D([], [], label=label, **line_style(index, len(labels)))
    yield Line2D([], [], label="whole order", **_GUIDE)
    yield Patch(facecolor=_GREY, label="rounding")


def _panel(axes: Axes, rows: Sequence[Convergence], labels: Sequence[str], *, lowest: bool) -> None:
    dress(axes)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for index, (label, row) in enumerate(zip(labels, rows, strict=True)):
        errors = np.where(np.isfinite(row.errors), np.maximum(row.errors, _FLOOR), np.nan)
        axes.plot(1e3 * row.steps, errors, marker="o", markersize=5, **line_style(index, len(rows)))
        note = f"{_short(label)}: {row}" if label else str(row)
        above = 4 + 12 * (len(rows) - 1 - index)
        axes.annotate(
            note, (0, 1), (0, above), xycoords="axes fraction", textcoords="offset points", fontsize=9,
            color=colour(index),
        )  # fmt: skip
    _guides(axes, rows)
    low, high = axes.get_ylim()
    for row in rows:
        axes.fill_between(1e3 * row.steps, _FLOOR / 10, row.rounding, color=_GREY, linewidth=0, zorder=1)
    axes.set_ylim(low / 2, high * 2)
    shown = rows[0].steps[:: -(-len(rows[0].steps) // _TICKS)]
    axes.xaxis.set_major_locator(FixedLocator((1e3 * shown).tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_major_locator(LogLocator(numticks=6))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("step h [ms]" if lowest else "", fontsize=10)
    unit = rows[0].unit
    axes.set_ylabel(f"error [{unit}]" if unit else "relative drift", fontsize=10)


def _short(label: str) -> str:
    return label if len(label) <= _LONGEST else f"{label[: _LONGEST - 1]}…"


def _guides(axes: Axes, rows: Sequence[Convergence]) -> None:
    """Draw a line of each whole order there is, above the highest error of that order."""
    tops: dict[int, Convergence] = {}
    for row in rows:
        if row.converges and row.order is not None:
            p = round(row.order)
            tops[p] = max(tops.get(p, row), row, key=lambda one: float(one.errors[0]))
    for p, row in tops.items():
        finite = row.errors[np.isfinite(row.errors)]
        ends = row.steps[len(row.steps) - len(finite)], row.steps[-1]
        start = 3 * finite[0]
        line = [start, start * (ends[1] / ends[0]) ** p]
        axes.plot([1e3 * ends[0], 1e3 * ends[1]], line, **_GUIDE)
        axes.annotate(
            f"$h^{p}$" if p > 1 else "$h$", (1e3 * ends[0], start), (2, 2), textcoords="offset points",
            fontsize=10, color="#777777", annotation_clip=False,
        )  # fmt: skip
