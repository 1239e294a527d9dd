"""Figures of numbers over parameters: one or two swept parameters, or the step of an integrator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from matplotlib import colormaps, rcParams
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator

from pinmobile.accuracy import Convergence, IntegratorReport
from pinmobile.arrays import (
    Array,
    ArrayLike,
    bounded,
    finite,
    label_items,
    mapping,
    real,
    sequence,
    shaped,
    text,
)
from pinmobile.errors import unexpected_value
from pinmobile.palette import INK
from pinmobile.plots.style import Layout, Sheet, Style, colour, dress, font_size, ink, line_style

_STRIP = 0.11  # height of the strip as a share of the axes below it
_GREY = "#f1f1f1"


def strip_above(axes: Axes, word: str, *, numbers: bool = True) -> float:
    """Add a strip above the data for marks of infinite values, and return the y of its middle.

    The existing ticks remain. The word becomes the tick label of the strip.

    Parameters
    ----------
    axes : Axes
        Axes with linear or logarithmic limits of y that contain all finite values.
    word : str
        Meaning of the marks in the strip.
    numbers : bool
        Whether there are finite values. Otherwise the strip fills the axes.
    """
    if not numbers:
        axes.set_ylim(0.0, 1.0)
        axes.axhspan(0.0, 1.0, color=_GREY, linewidth=0, zorder=0)
        axes.set_yticks([0.5], [word])
        return 0.5
    low, high = axes.get_ylim()
    scale = axes.transScale.transform  # to coordinates in which heights are linear
    inverse = axes.transScale.inverted().transform
    bottom, top = (float(scale((1.0, y))[1]) for y in (low, high))
    middle, end = (float(inverse((1.0, top + share * (top - bottom)))[1]) for share in (_STRIP / 2, _STRIP))
    axis = axes.yaxis
    tick_sets = axis.get_majorticklocs(), axis.get_minorticklocs()
    large, small = ([y for y in ticks if low <= y <= high] for ticks in tick_sets)
    labels, factor = axis.get_major_formatter().format_ticks(large), axis.get_major_formatter().get_offset()
    axes.axhspan(high, end, color=_GREY, linewidth=0, zorder=0)
    axes.set_yticks([*large, middle], [*labels, word])
    formatter: Any = axis.get_major_formatter()
    formatter.set_offset_string(factor)  # the power of ten above the axis
    axes.set_yticks(small, ["" for _ in small], minor=True)
    axes.set_ylim(low, end)
    return middle


_MAP = "cividis"  # Nunez, Anderton and Renslow 2018: similar with a deficiency of colour vision
_MAX_LINEAR_RATIO = 20.0  # ratio of the largest and the smallest number above which the scale is logarithmic
_MAX_MAP_SIZE = 11.0, 8.0  # [in], largest size of all cells
_MAX_CELL_SIZE = 0.85, 0.55  # [in], largest size of a cell
_MIN_FONT_SIZE = 5.0  # [pt], smallest readable font size

_Axis = tuple[str, str, Sequence[object] | Array]


def heatmap(
    values: ArrayLike,
    *,
    x: _Axis,
    y: _Axis,
    label: str,
    limits: tuple[float, float] | None = None,
    **layout: Unpack[Layout],
) -> Figure:
    """Draw a number for each pair of values of two parameters, as colour and as text.

    A cell with an infinite number is hatched and says "diverges". Dark colours are small numbers. The colour
    scale is logarithmic if the numbers differ by a factor of more than 20.

    Parameters
    ----------
    values : array_like, shape (len(y values), len(x values))
        Numbers, or infinity.
    x, y : tuple of str, str and sequence
        Name, unit ("" or "1" for none) and values of each parameter. The values are numbers or names. The
        first value is at the left or at the bottom.
    label : str
        Meaning and unit of the numbers, such as ``"99 % stay within [mm]"``.
    limits : tuple of 2 float, optional
        Numbers of the darkest and the brightest colour, in the unit of `values`, for comparable maps.
        Default: the smallest and the largest number.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `values` has another shape or contains NaN, or `limits` are not two increasing numbers that
        contain all values.

    See Also
    --------
    plots.curves : numbers over one parameter
    sweep : ensembles over a grid of parameters

    Examples
    --------
    >>> from pinmobile import plots
    >>> figure = plots.heatmap(
    ...     [[4.1, 2.0], [9.3, float("inf")]],
    ...     x=("kp", "1/s^2", [4, 9]), y=("mass", "kg", [30, 36]),
    ...     label="error [mm]")
    >>> [text.get_text() for text in figure.axes[0].texts]
    ['4.10', '2.00', '9.30', 'diverges']
    """
    x_label, columns = _check_axis("x", x, words=True)
    y_label, rows = _check_axis("y", y, words=True)
    label = text("label", label)
    shape, words = (len(rows), len(columns)), ": a row for each of y, a column for each of x"
    numbers = bounded("values", shaped("values", real("values", values), shape, words=words), above=-np.inf)
    size = [min(count * cell, limit) for count, cell, limit in zip(
        (len(columns), len(rows)), _MAX_CELL_SIZE, _MAX_MAP_SIZE, strict=True)]  # fmt: skip
    sheet = Sheet(max(size[0], 3.2) + 2.2, **layout)
    (axes,) = sheet.axes([(0, 0)], [max(size[1], 1.6)])
    low, high = _range(numbers)
    if limits is not None:
        low, high = shaped("limits", finite("limits", limits), (2,), words=": smallest, largest").tolist()
        bounded("values", numbers[np.isfinite(numbers)], least=low, most=high)
    norm = LogNorm(low, high) if 0 < _MAX_LINEAR_RATIO * low < high else Normalize(low, high)
    image = axes.imshow(np.ma.masked_invalid(numbers), cmap=_MAP, norm=norm, origin="lower", aspect="auto")
    axes.figure.colorbar(image, ax=axes, pad=0.02).set_label(label)
    is_long = max(map(len, columns)) > 6
    axes.set_xticks(range(len(columns)), columns, rotation=30 * is_long, ha="right" if is_long else "center")
    axes.set_yticks(range(len(rows)), rows)
    axes.tick_params(length=0)
    axes.set(xlabel=x_label, ylabel=y_label)
    axes.spines[:].set_visible(False)
    width = min(size[0], max(sheet.width - 2.2 * font_size() / 10, 0.1))
    room = min(72 * width / len(columns) / 3.6, 72 * size[1] / len(rows) / 1.6)  # [pt] for five digits
    _write_numbers(axes, numbers, norm, min(room, font_size()))
    return sheet.finish(f"{label} over {x[0]} and {y[0]}")


def _check_axis(name: str, axis: Any, *, words: bool = False) -> tuple[str, Any]:
    """Return label and values of (name, unit, values); with `words`, the values as text."""
    if len(sequence(name, axis, "(name, unit, values)")) != 3:
        raise unexpected_value(name, axis, "(name, unit, values)")
    title, unit = text(f"{name}[0]", axis[0]), text(f"{name}[1]", axis[1])
    label = title if unit in ("", "1") else f"{title} [{unit}]"
    if words:
        values = sequence(f"{name}[2]", axis[2], "a sequence of numbers or text")
        if all(isinstance(one, str) for one in values):
            return label, [text(f"{name}[2]", one) for one in values]
    numbers = shaped(f"{name}[2]", finite(f"{name}[2]", axis[2]), ("n>=1",))
    return label, [f"{one:.4g}" for one in numbers] if words else numbers


def _range(numbers: Array) -> tuple[float, float]:
    """Return the smallest and the largest finite number."""
    values = numbers[np.isfinite(numbers)]
    return (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)


def _write_numbers(axes: Axes, numbers: Array, norm: Normalize, size: float) -> None:
    """Write each number in its cell if there is room, in white on dark colours."""
    finite = numbers[np.isfinite(numbers)]
    is_whole = bool((finite == np.round(finite)).all())
    shades = colormaps[_MAP](norm(np.where(np.isfinite(numbers), numbers, 0.0)))
    for (i, k), number in np.ndenumerate(numbers):
        if np.isinf(number):
            cell = Rectangle((k - 0.5, i - 0.5), 1, 1, facecolor="white", edgecolor="#999999", hatch="////")
            cell.set_linewidth(0.0)
            axes.add_patch(cell)
        if size < _MIN_FONT_SIZE:
            continue
        is_dark = np.isfinite(number) and float(shades[i, k, :3] @ (0.299, 0.587, 0.114)) < 0.5
        # Three digits, without a power of ten if there is room.
        if np.isinf(number):
            words = "diverges"
        elif is_whole or abs(number) >= 100:
            words = f"{number:.0f}" if abs(number) < 1e5 else f"{number:.2g}"
        else:
            words = f"{number:#.3g}" if abs(number) >= 1e-3 else f"{number:.2g}"
        text = axes.text(
            k, i, words, ha="center", va="center",
            fontsize=0.8 * size if np.isinf(number) else size, color="white" if is_dark else INK,
        )  # fmt: skip
        if np.isinf(number):
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 1.0})


_MARKERS = "osD^vP"  # markers and colours distinguish lines that coincide


def curves(values: Mapping[str, ArrayLike], *, x: _Axis, label: str, **layout: Unpack[Layout]) -> Figure:
    """Draw numbers over a parameter, one curve for each name.

    A cross in a strip at the top marks an infinite number. The axis is logarithmic if the numbers differ by a
    factor of more than 20.

    Parameters
    ----------
    values : mapping of str to array_like, shape (len(x values),)
        Numbers, or infinity, by name. The name of a single curve may be "".
    x : tuple of str, str and sequence
        Name, unit ("" for none) and numbers of the parameter.
    label : str
        Meaning and unit of the numbers, such as ``"99 % stay within [mm]"``.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If there is no curve, or a curve has another shape or contains NaN.

    See Also
    --------
    plots.heatmap : numbers over two parameters
    sweep : ensembles over a grid of parameters

    Examples
    --------
    >>> from pinmobile import plots
    >>> errors = {"PD": [9.0, 4.1, 2.2], "MPC": [1.2, 1.1, 1.0]}
    >>> figure = plots.curves(errors, x=("kp", "1/s^2", [4, 9, 16]),
    ...                       label="error [mm]")
    >>> figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
    ('kp [1/s^2]', 'error [mm]')
    """
    (x_label, numbers), label = _check_axis("x", x), text("label", label)
    rows: dict[str, Array] = {}
    for name, row in mapping("values", values, "a mapping of names to numbers").items():
        entry = f"values[{text('values', name)!r}]"
        rows[name] = bounded(entry, shaped(entry, real(entry, row), (len(numbers),)), above=-np.inf)
    sheet = Sheet(8.0, **layout)
    (axes,) = sheet.axes([(0, 0)], [3.8])
    dress(axes)
    order = np.argsort(numbers, kind="stable")
    top = _set_scale(axes, np.concatenate(list(rows.values())))
    for k, row in enumerate(rows.values()):
        _draw_curve(axes, numbers[order], row[order], top, k, len(rows))
    axes.set(xlabel=x_label, ylabel=label)
    keys = [Line2D([], [], label=name, **_marker_style(k)) for k, name in enumerate(rows) if name]
    if any(np.isinf(row).any() for row in rows.values()):
        keys.append(Line2D([], [], color=ink(), marker="x", linestyle="", label="diverges"))
    return sheet.finish(f"{label} over {x[0]}", keys)


def _set_scale(axes: Axes, numbers: Array) -> float:
    """Set the scale of y, and return the y of marks of infinite numbers."""
    low, high = _range(numbers)
    if 0 < _MAX_LINEAR_RATIO * low < high:
        axes.set_yscale("log")
        room = (high / low) ** 0.05
        axes.set_ylim(low / room, high * room)
    else:
        room = 0.05 * ((high - min(low, 0.0)) or 1.0)
        axes.set_ylim(low - room if low < 0 else 0.0, high + room)
    finite = np.isfinite(numbers)
    return high if finite.all() else strip_above(axes, "diverges", numbers=bool(finite.any()))


def _draw_curve(axes: Axes, x: Array, row: Array, top: float, index: int, count: int) -> None:
    is_finite = np.isfinite(row)
    # Lower curves are wider, with larger markers, so that they show below the others.
    extra = 3.0 * (count - 1 - index) / max(count - 1, 1)
    width, size = (float(rcParams["lines.linewidth"]), float(rcParams["lines.markersize"]))
    axes.plot(x, np.where(is_finite, row, np.nan), zorder=3, linewidth=1.2 * width + extra / 2,
              markersize=size + extra, **_marker_style(index))  # fmt: skip
    axes.plot(x[~is_finite], np.full(np.count_nonzero(~is_finite), top), linestyle="", marker="x",
              markersize=8 + 2 * extra, markeredgewidth=2, color=colour(index), zorder=4)  # fmt: skip


def _marker_style(index: int) -> Style:
    return {"color": colour(index), "marker": _MARKERS[index % len(_MARKERS)]}


_PANELS = (
    ("position", "Free body: position at the end"),
    ("momentum", "Free body: linear momentum"),
    ("substeps", "Loop: force held for {:g} ms"),
    ("energy", "Free body: kinetic energy"),
    ("angular_momentum", "Free body: angular momentum"),
    ("sampling", "Loop: force held for h"),
)
_DOT_STYLE: Style = {"markersize": 5, "marker": "o"}
_FLOOR = 1e-17  # value at which zero is drawn
_TICKS = 6  # largest number of ticks of the steps
_MAX_LABEL = 22  # longest label above a panel [letters]; the legend has the whole label
_ROUNDING = "#dddddd"
_GUIDE_STYLE: Style = {"color": "#999999", "linestyle": (0, (4, 3)), "linewidth": 1.0, "zorder": 2}


def integrator(
    reports: IntegratorReport | Mapping[str, IntegratorReport], **layout: Unpack[Layout]
) -> Figure:
    """Draw the errors of integrators over the step, on logarithmic axes.

    Each panel has lines of the nearest whole order, and its title gives the measured order. The grey area
    shows rounding errors.

    Parameters
    ----------
    reports : IntegratorReport or mapping of str to IntegratorReport
        Results of `accuracy.integrator_report` by label, all in the same axes.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `reports` is not a report or a mapping of reports.

    See Also
    --------
    accuracy.integrator_report : measure an integrator

    Examples
    --------
    >>> from pinmobile import plots, rk4
    >>> from pinmobile.accuracy import integrator_report
    >>> report = integrator_report(
    ...     rk4, steps=(0.1, 0.05), duration=1.0)
    >>> figure = plots.integrator(report)
    >>> figure.axes[0].get_ylabel(), round(report.position.order)
    ('error [m]', 4)
    """
    table: dict[str, IntegratorReport] = label_items("reports", reports, IntegratorReport)
    sheet = Sheet(9.0, **layout)
    columns = sheet.columns(3, 2.6)
    panels = sheet.axes([divmod(k, columns) for k in range(6)], [1.7] * (len(_PANELS) // columns))
    for k, (axes, (attribute, heading)) in enumerate(zip(panels, _PANELS, strict=True)):
        rows = [getattr(report, attribute) for report in table.values()]
        _draw_axes(axes, rows, list(table), lowest=k + columns >= len(panels), ticks=6 if columns == 3 else 4)
        pad = 4 + 1.3 * font_size(0.9) * len(table)
        sheet.write_above(axes, heading.format(1e3 * rows[0].steps[0]), 0.95, pad=pad, loc="left")
    source = f" of {next(iter(table.values())).integrator}" if "" in table else ""
    keys = [
        *(Line2D([], [], label=label, **line_style(k, len(table))) for k, label in enumerate(table) if label),
        Line2D([], [], label="whole order", **_GUIDE_STYLE),
        Patch(facecolor=_ROUNDING, label="rounding"),
    ]
    return sheet.finish(f"Accuracy{source}: error over the step", keys)


def _draw_axes(
    axes: Axes, rows: Sequence[Convergence], labels: Sequence[str], *, lowest: bool, ticks: int
) -> None:
    dress(axes)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for index, (label, row) in enumerate(zip(labels, rows, strict=True)):
        errors = np.where(np.isfinite(row.errors), np.maximum(row.errors, _FLOOR), np.nan)
        axes.plot(1e3 * row.steps, errors, **_DOT_STYLE | line_style(index, len(rows)))
        name = label if len(label) <= _MAX_LABEL else f"{label[: _MAX_LABEL - 1]}…"
        note = f"{name}: {row}" if name else str(row)
        offset = 4 + 1.3 * font_size(0.9) * (len(rows) - 1 - index)
        axes.annotate(
            note, (0, 1), (0, offset), xycoords="axes fraction", textcoords="offset points",
            fontsize=font_size(0.9), color=colour(index),
        )  # fmt: skip
    _draw_guides(axes, rows)
    low, high = axes.get_ylim()
    for row in rows:
        axes.fill_between(1e3 * row.steps, _FLOOR / 10, row.rounding, color=_ROUNDING, linewidth=0, zorder=1)
    axes.set_ylim(low / 2, high * 2)
    tick_steps = rows[0].steps[:: -(-len(rows[0].steps) // _TICKS)]
    axes.xaxis.set_major_locator(FixedLocator((1e3 * tick_steps).tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_major_locator(LogLocator(numticks=ticks))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("step h [ms]" if lowest else "")
    unit = rows[0].unit
    axes.set_ylabel(f"error [{unit}]" if unit else "relative drift")


def _draw_guides(axes: Axes, rows: Sequence[Convergence]) -> None:
    """Draw a line for each measured whole order, above the largest error of this order."""
    tops: dict[int, Convergence] = {}
    for row in rows:
        if row.converges and row.order is not None:
            p = round(row.order)
            tops[p] = max(tops.get(p, row), row, key=lambda one: float(one.errors[0]))
    for p, row in tops.items():
        errors = row.errors[np.isfinite(row.errors)]
        ends = row.steps[len(row.steps) - len(errors)], row.steps[-1]
        start = 3 * errors[0]
        line = [start, start * (ends[1] / ends[0]) ** p]
        axes.plot([1e3 * ends[0], 1e3 * ends[1]], line, **_GUIDE_STYLE)
        axes.annotate(
            f"$h^{p}$" if p > 1 else "$h$", (1e3 * ends[0], start), (2, 2), textcoords="offset points",
            fontsize=font_size(), color="#777777", annotation_clip=False,
        )  # fmt: skip
