"""Figures of ensembles and of linearized loops: quantile bands, parameters of the worst robots, and poles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Unpack

import numpy as np
from matplotlib import rcParams
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, finite, instance, label_items, one_of, sequence, shaped
from pinmobile.derivatives import Poles, Sensitivities
from pinmobile.loop import Bands, Cause, Ensemble, causes, is_event, worst_share
from pinmobile.metrics import Metric
from pinmobile.palette import INK, QUIET
from pinmobile.plots.parameter_curves import strip_above
from pinmobile.plots.series import errors
from pinmobile.plots.style import (
    Layout,
    Sheet,
    Spot,
    Style,
    colour,
    dress,
    font_size,
    format_percent,
    format_si,
    ink,
    label_style,
    rounded_out,
    tint,
    title_offset,
    wrap_label,
    wrap_text,
)

_DEFAULT_METRICS = "distance", "heading"
_MAX_BAND_RATIO = 40.0  # largest ratio of the largest value and the smallest median on a linear axis
_ROUNDING = 1e-9  # smallest value on a logarithmic axis, as a share of the largest
_DRAWN_AS_ZERO = 2.0**-34  # [m, rad]
_GREY = "#777777"
_PLAIN_STYLE: Style = {"color": INK, "fontweight": "normal"}


class _Scale(NamedTuple):
    """Scale of the axes of one row, in a suitable unit."""

    unit: str
    per_si: float
    low: float
    high: float
    logarithmic: bool


def bands(
    ensembles: Ensemble | Mapping[str, Ensemble],
    *,
    levels: ArrayLike = (0.5, 0.9, 0.99),
    by: str | Sequence[str] | None = None,
    **layout: Unpack[Layout],
) -> Figure:
    """Draw error quantiles of ensembles over time: position distance, heading error, and metrics.

    Each quantity has a row. A band shows the bound within which a share of the robots stays. For a margin,
    such as the tip-over margin, a share of the robots has at least the drawn value. All ensembles have the
    same axes. The axes are logarithmic if the errors of one ensemble are far larger than those of another. A
    band leaves the axes at the top if too many robots diverged. The title of each panel gives the bound for
    the largest share over the whole time.

    Parameters
    ----------
    ensembles : Ensemble or mapping of str to Ensemble
        Ensembles by label, one column each.
    levels : array_like, shape (L,)
        Shares of the robots, from 0 to 1.
    by : str or sequence of str, optional
        Names of quantities in ``Scenario.channels``, such as ``["end effector", "ur5/elbow_joint"]``.
        Default: distance, heading, and all metrics that the ensembles have in common.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `ensembles` is invalid, or a level is outside [0, 1].
    UnknownName
        If an ensemble has no quantity of a name.

    See Also
    --------
    plots.drivers : parameters that the worst robots share
    Ensemble.error_quantile : bounds as numbers

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, MobileRobot
    >>> from pinmobile import Relative, Tangent, Uniform
    >>> from pinmobile import ensemble, plots
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> runs = ensemble(robot, ComputedTorque(robot),
    ...                 Tangent(Circle(1, 1, 2)), n=200, dt=0.05,
    ...                 spread={"mass": Relative(Uniform(0.8, 1.2))})
    >>> figure = plots.bands(runs)
    >>> figure.axes[0].get_title(loc="left")
    '99 % stay within 41 mm throughout'
    """
    runs: dict[str, Ensemble] = label_items("ensembles", ensembles, Ensemble)
    shares = shaped("levels", np.unique(finite("levels", levels)), ("n>=1",))
    rows = _row_metrics(list(runs.values()), by)
    limits = [_band_quantiles(one, shares, [row.name for row in rows]) for one in runs.values()]
    sheet = Sheet(max(7.5, 3.6 * len(runs)), **layout)
    grid = sheet.grid(len(rows), len(runs), [max(2.0, 4.4 / len(rows))] * len(rows), share="xy")
    for row, channel in zip(grid, rows, strict=True):
        quantiles = [one[channel.name] for one in limits]
        scale = _scale(quantiles, channel)
        words = f"{_axis_label(channel)} [{scale.unit}]" if scale.unit else _axis_label(channel)
        row[0].set_ylabel(f"{words}\nlogarithmic" if scale.logarithmic else words)
        for index, (axes, values) in enumerate(zip(row, quantiles, strict=True)):
            _draw_band(axes, limits[index].t, values, scale, index, is_margin=channel.is_margin)
    for index, (label, one) in enumerate(runs.items()):
        height = _bounds(sheet, grid[:, index], rows, one, float(shares[-1]))
        count = int(one.diverged.sum())
        count_text = f"{count:,} of {len(one):,} diverged" if count else f"none of {len(one):,} diverged"
        count_text = wrap_text(count_text, font_size(), sheet.room())
        first, style = grid[0, index], label_style(index)
        first.annotate(count_text, (0, 1), (0, height), **style | _PLAIN_STYLE | {"fontsize": font_size()})
        height += font_size(1.4) * (count_text.count("\n") + 1)
        first.annotate(wrap_label(sheet, label), (0, 1), (0, height), **style)
        grid[-1, index].set_xlabel("t [s]")
    if sheet.is_new:
        sheet.figure.align_ylabels(grid[:, 0])
    return sheet.finish("How far the robots stray", list(_patches(limits[0], list(runs.values()))))


def _row_metrics(ensembles: Sequence[Ensemble], by: str | Sequence[str] | None) -> list[Metric]:
    """Return the quantities of the rows.

    Raises
    ------
    InvalidArgument, UnknownName
        If `by` is not a sequence or is empty, or an ensemble has no quantity of a name.
    """
    metrics = [{each.name: each for each in one.scenario.channels} for one in ensembles]
    if by is None:
        recorded = ensembles[0].scenario.recorded_metrics
        metric_names = [each.name for each in recorded if each.worst != "ever"]
        names = [*_DEFAULT_METRICS, *(name for name in metric_names if all(name in each for each in metrics))]
    else:
        one = [by] if isinstance(by, str) else by
        names = list(sequence("by", one, "a sequence of one name or more, such as ['distance']", 1))
    for each in metrics:
        for name in names:
            one_of("band", name, each)
    return [metrics[0][name] for name in names]


def _axis_label(channel: Metric) -> str:
    """Return the label of the axes of a row."""
    if channel.name == "distance":
        return "distance from\ndesired position"
    if channel.name == "heading" or channel.meaning == f"error of {channel.name}":
        return f"error of\n{channel.name}"
    return channel.name.replace(" of ", "\nof ")


def _band_quantiles(ensemble: Ensemble, levels: Array, names: Sequence[str]) -> Bands:
    """Return the drawn quantiles, limited by the exact bound of `Ensemble.error_quantile`.

    The limit applies from `Scenario.after` on. The quantiles come from counts in bins, so their resolution is
    the width of a bin. Errors that are rounding are drawn as zero.
    """
    bands = ensemble.bands(levels)
    bounds = [ensemble.error_quantile(level) for level in levels]
    is_recorded = bands.t >= ensemble.scenario.t[ensemble.scenario.begin]
    quantiles = {}
    for name in names:
        one, bound = bands[name], np.array([each[name] for each in bounds])[:, None]
        is_margin = any(each.is_margin for each in ensemble.scenario.channels if each.name == name)
        limited = np.where(is_recorded, (np.maximum if is_margin else np.minimum)(one, bound), one)
        quantiles[name] = limited if is_margin else np.where(one < _DRAWN_AS_ZERO, 0.0, limited)
    return Bands(bands.t, bands.levels, quantiles)


def _scale(quantiles: Sequence[Array], channel: Metric) -> _Scale:
    """Return a scale for all finite quantiles, shape (L, G) each; for a margin, linear and with zero."""
    values = np.concatenate([one[np.isfinite(one)] for one in quantiles])
    lowest, highest = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    logarithmic = False
    if channel.is_margin:
        room = 0.08 * ((highest - lowest) or 1e-3)
        low, high = lowest - (room if lowest < 0 else 0.0), highest + room
        top = max(highest, -lowest) or 1e-3
    else:
        top = highest or 1e-3
        medians = [float(np.max(one[0], initial=0.0, where=np.isfinite(one[0]))) for one in quantiles]
        logarithmic = top > _MAX_BAND_RATIO * min((value for value in medians if value > 0), default=top)
        least = max(float(values[values > 0].min(initial=top)), _ROUNDING * top)
        low, high = (least / 2, 2 * top) if logarithmic else (0.0, 1.08 * top)
    prefix, per_si = ("", 1.0) if not channel.unit or top >= 1 else ("m", 1e3) if top >= 1e-3 else ("µ", 1e6)
    return _Scale(f"{prefix}{channel.unit}", per_si, low * per_si, high * per_si, logarithmic)


def _draw_band(axes: Axes, t: Array, quantiles: Array, scale: _Scale, index: int, *, is_margin: bool) -> None:
    """Draw quantiles, shape (L, G), with the strongest colour for the narrowest band."""
    dress(axes)
    axes.margins(x=0.0)
    if scale.logarithmic:
        axes.set_yscale("log")
    axes.set_ylim(scale.low, scale.high)
    size = scale.high - scale.low
    outside = scale.low - 10 * size if is_margin else 10 * scale.high  # infinite: outside the axes
    lines = np.where(np.isfinite(quantiles), quantiles * scale.per_si, outside)
    edge = np.full(len(t), scale.high if is_margin else scale.low)
    for shade, line in zip(_shades(colour(index), len(lines)), lines, strict=True):
        end = np.clip(line, scale.low, None)
        axes.fill_between(t, edge, end, color=shade, linewidth=0, zorder=2)
        edge = end
    if is_margin:
        axes.axhline(0.0, color=_GREY, linewidth=1.0, linestyle=":", zorder=1)
    width = float(rcParams["lines.linewidth"])
    for k, line in enumerate(lines):
        axes.plot(t, line, color=colour(index), linewidth=width * (1.2 if k == 0 else 0.6), zorder=3)


def _shades(base: str, count: int) -> list[tuple[float, float, float]]:
    """Return the colours of bands, from the strongest for the narrowest band to a pale one."""
    return [tint(base, share) for share in np.linspace(0.75, 0.15, count)]


def _bounds(sheet: Sheet, column: NDArray[Any], rows: Sequence[Metric], one: Ensemble, level: float) -> float:
    """Write the bound of a share above each axes of a column; return the height of the first title [pt]."""
    begin, bounds = one.scenario.after, one.error_quantile(level)
    period = f"from {begin:g} s on" if begin else "throughout"
    for axes, channel in zip(column, rows, strict=True):
        size = bounds[channel.name]
        verb = "have at least" if channel.is_margin else "stay within"
        size = rounded_out(size, margin=channel.is_margin)
        bound = f"{_format_size(size, channel.unit)} {period}" if np.isfinite(size) else "no bound"
        sheet.write_above(axes, f"{format_percent(level)} {verb} {bound}", loc="left")
        if begin:
            axes.axvline(begin, color=_GREY, linewidth=1.0, linestyle=":", zorder=1)
    return title_offset(column[0].get_title(loc="left").count("\n") + 1)


def _format_size(value: float, unit: str) -> str:
    """Return a number with two digits and its sign as text."""
    if not unit:
        return f"{value:.2g}"
    return f"-{format_si(-value, unit)}" if value < 0 else format_si(value, unit)


def _patches(bands: Bands, ensembles: Sequence[Ensemble]) -> Iterator[Artist]:
    sizes = {len(one) for one in ensembles}
    population = f"of {sizes.pop():,} robots" if len(sizes) == 1 else "of the robots"
    style: Style = {"edgecolor": _GREY, "linewidth": 0.8}
    labels = [format_percent(level) for level in bands.levels]
    labels[-1] = f"{labels[-1]} {population}"
    for shade, label in zip(_shades(_GREY, len(labels)), labels, strict=True):
        yield Patch(facecolor=shade, label=label, **style)


_MAX_PARAMETERS = 6  # largest number of drawn parameters
_MAX_DOTS = 4000  # largest number of drawn robots, for the worst and for the others
_BINS = 40
_MAX_ERROR_RATIO = 50.0  # largest ratio of the largest error and the median on a linear axis
_ERRORS = {"distance": "distance from the desired position", "heading": "error of the heading"}
_OTHERS_STYLE: Style = {"color": "#9a9a9a", "alpha": 0.55}


def _outline() -> Style:
    return {"color": colour(1), "linewidth": 1.3 * float(rcParams["lines.linewidth"])}


def _range_style() -> Style:
    return {"color": colour(1), "alpha": 0.12, "linewidth": 0}


def drivers(
    ensemble: Ensemble, *, share: float = 0.05, by: str = "distance", **layout: Unpack[Layout]
) -> Figure:
    """Draw the parameters that the worst robots of an ensemble share.

    Each panel compares the distribution of a parameter among the worst robots and among the others. The worst
    robots are those of `Ensemble.worst`: first the diverged ones, then those with the largest error.

    The panels are in descending order of Kuiper's statistic, the sum of the two one-sided statistics of
    Kolmogorov and Smirnov. The statistic is the largest difference of the shares of both groups in an
    interval, or outside an interval. This interval is shaded, and the title of the panel gives it. A
    parameter "plays no part" if chance explains the difference (at 1 %). If a parameter is `SameAs` another
    times a factor, the figure shows the factor. It shows at most six parameters. The last panel shows the
    error of each robot over the first parameter.

    Parameters
    ----------
    ensemble : Ensemble
        Ensemble of robots.
    share : float
        Share of the worst robots, above 0 and below 1. Of an event, all robots that have it count; and all
        that diverged, if they are more than this share.
    by : str
        Error that ranks the robots, see `Ensemble.largest`: "distance" from the desired position, "heading",
        the name of a coordinate, or a metric. For a margin, such as "tip-over margin", the smallest is the
        worst. An event, such as "exceed an effort limit", compares the robots that have it with the others.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`. The last axes show the errors of the robots.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `ensemble` is not an `Ensemble`, `share` is outside (0, 1) or leaves no robot on one side, or all
        robots have the same parameters.
    UnknownName
        If there is no error of the name `by`.

    See Also
    --------
    plots.bands : error quantiles over time
    Ensemble.worst : indices of the worst robots

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, MobileRobot
    >>> from pinmobile import Relative, Tangent, Uniform
    >>> from pinmobile import ensemble, plots
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> runs = ensemble(robot, ComputedTorque(robot),
    ...                 Tangent(Circle(1, 1, 2)), n=200, dt=0.05,
    ...                 spread={"mass": Relative(Uniform(0.8, 1.2))})
    >>> figure = plots.drivers(runs)
    >>> figure.get_suptitle()
    'mass drives the worst 5 % most'
    """
    instance("ensemble", ensemble, Ensemble, "an Ensemble")
    worst = worst_share(ensemble, share, by)
    ranking = causes(ensemble, worst)
    drawn_causes = ranking[:_MAX_PARAMETERS]
    sheet = Sheet(7.6 if len(drawn_causes) <= 3 else 9.0, **layout)
    columns = sheet.columns(2 if len(drawn_causes) <= 3 else 3, 2.9)
    *panels, scatter = _make_axes(sheet, len(drawn_causes), columns)
    word, criterion = "the worst", {"distance": "", "heading": " of headings"}.get(by, f" by {by}")
    group = f"{word} {format_percent(share)}"
    if is_event(ensemble, by) or worst.sum() > round(share * len(ensemble)):
        word, criterion = "those", ""
        group = f"{word} that {by if is_event(ensemble, by) else 'diverged'}"
    for axes, one in zip(panels, drawn_causes, strict=True):
        _draw_distribution(sheet, axes, one, worst, word)
    _draw_scatter(sheet, scatter, ensemble, ranking[0], worst, by)
    keys: list[Artist] = [
        Line2D([], [], label=f"{group}: {worst.sum():,} robots", **_outline()),
        Patch(label="the others", **_OTHERS_STYLE),
        Patch(label=f"where {word} are", **_range_style()),
    ]
    if _lost_robots(ensemble, by).any():
        keys.append(Line2D([], [], color=ink(), marker="x", linestyle="", label=_lost_label(ensemble, by)))
    return sheet.finish(_format_causes(ranking, group + criterion), keys)


def _make_axes(sheet: Sheet, count: int, columns: int) -> list[Axes]:
    """Return axes for each parameter, and axes of the scatter plot in a separate column or row."""
    panels = max(columns - 1, 1)
    rows = -(-count // panels)
    spots: list[Spot] = [divmod(k, panels) for k in range(count)]
    if columns == 1:
        return sheet.axes([*spots, (rows, 0)], [*[1.6] * rows, 3.2], share="")
    heights = [max(1.7, 3.4 / rows)] * rows
    return sheet.axes([*spots, (slice(0, rows), panels)], heights, share="", ratios=[1.0] * panels + [1.2])


def _format_causes(ranking: Sequence[Cause], group: str) -> str:
    """Return the most important parameters of a group of robots in words."""
    names = [one.name for one in ranking if one.visible]
    if not names:
        return f"Nothing that was spread drives {group}"
    return ", then ".join([f"{names[0]} drives {group} most", *names[1:3]])


def _draw_distribution(sheet: Sheet, axes: Axes, one: Cause, worst: NDArray[np.bool_], word: str) -> None:
    """Draw the distribution of a parameter among the worst robots and among the others."""
    dress(axes)
    bins = np.linspace(one.values.min(), one.values.max(), _BINS + 1).tolist()
    bad, good = one.values[worst], one.values[~worst]
    axes.hist(good, bins, weights=np.full(len(good), 100 / len(good)), zorder=2, **_OTHERS_STYLE)
    axes.hist(bad, bins, weights=np.full(len(bad), 100 / len(bad)), histtype="step", zorder=3, **_outline())
    text, shade = "plays no part", "#777777"
    if one.visible:
        spans = [(bins[0], one.low), (one.high, bins[-1])] if one.outside else [(one.low, one.high)]
        for low, high in spans:
            axes.axvspan(max(low, bins[0]), min(high, bins[-1]), zorder=1, **_range_style())
        share, rest = (format_percent(round(float(one.holds(values).mean()), 2)) for values in (bad, good))
        text, shade = f"{one.place}:\n{share} of {word}, {rest} of the others", ink()
    sheet.write_above(axes, text, 0.95, color=shade, loc="left")
    axes.margins(x=0)
    axes.set_ylim(0, None)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel(_wrap_path(sheet, one.label))
    axes.set_ylabel("per bar [%]")


def _wrap_path(sheet: Sheet, label: str) -> str:
    """Return a label in lines that fit below a panel; a path may end a line after a dot."""
    return wrap_text(label.replace(".", ". "), font_size(), sheet.room()).replace(". ", ".")


def _draw_scatter(
    sheet: Sheet, axes: Axes, ensemble: Ensemble, one: Cause, worst: NDArray[np.bool_], by: str
) -> None:
    """Draw the largest error of each robot over the first parameter; diverged robots in a separate strip."""
    dress(axes)
    metric, errors = _ranking_metric(ensemble, by), ensemble.largest(by)
    is_lost = _lost_robots(ensemble, by)
    # Different markers distinguish the groups in grey.
    groups = (~worst, _OTHERS_STYLE["color"], "."), (worst, colour(1), "^")
    finite = errors[~is_lost]
    largest, median = (float(np.abs(finite).max()), float(np.median(finite))) if len(finite) else (0.0, 0.0)
    is_small = metric.unit == "m" and 0 < largest < 1
    scale, unit = (1e3, "mm") if is_small else (1.0, metric.unit)
    if 0 < _MAX_ERROR_RATIO * median < largest and not metric.is_margin:
        axes.set_yscale("log")
    for group, color, marker in groups:
        indices = _thin_indices(group & ~is_lost)
        axes.plot(one.values[indices], errors[indices] * scale, marker, markersize=4, zorder=3, color=color)
    if is_lost.any():
        height = strip_above(axes, _lost_label(ensemble, by), numbers=bool(len(finite)))
        for group, color, _ in groups:
            x = one.values[_thin_indices(group & is_lost)]
            axes.plot(x, np.full(len(x), height), "x", markersize=4, zorder=3, color=color)
    titles = {"distance": "How far each robot strays", "heading": "How far each robot turns away"}
    default = f"Which robots {by}" if metric.worst == "ever" else f"The {metric.worst} {by} of each robot"
    sheet.write_above(axes, titles.get(by, default), loc="left")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel(_wrap_path(sheet, one.label))
    words = _ERRORS.get(by, by)
    axes.set_ylabel(f"{metric.worst} {words} [{unit}]" if unit else f"{metric.worst} {words}")


def _lost_robots(ensemble: Ensemble, by: str) -> NDArray[np.bool_]:
    """Return which robots have no finite error, shape (n,)."""
    return ensemble.diverged | ~np.isfinite(ensemble.largest(by))


def _lost_label(ensemble: Ensemble, by: str) -> str:
    """Return the label of robots without a finite error: a lifted robot has an infinite margin."""
    return "diverged" if ensemble.diverged[_lost_robots(ensemble, by)].all() else "no bound"


def _ranking_metric(ensemble: Ensemble, by: str) -> Metric:
    """Return the metric of a name of `Ensemble.largest`."""
    metrics = {one.name: Metric(one.name, one.unit, "") for one in ensemble.scenario.coordinates}
    metrics |= {one.name: one for one in ensemble.scenario.channels}
    return metrics[by]


def _thin_indices(mask: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the indices of the drawn robots among the chosen ones."""
    indices = np.flatnonzero(mask)
    return indices[:: max(1, -(-len(indices) // _MAX_DOTS))]


_MARKS = "x+1234"
_DAMPING_RATIOS = 0.2, 0.4, 0.6, 0.8  # damping ratios with a curve
_LABEL = 70  # point of a curve at which its ratio is written
_MAX_NAMES = 3  # largest number of names in a title
_DEVIATIONS = 2.0  # standard deviations


def poles(found: Poles | Mapping[str, Poles], **layout: Unpack[Layout]) -> Figure:
    """Draw poles in the plane of z, with the unit circle and curves of constant damping ratio.

    Deviations decay if all poles are inside the circle. Poles near 1 are slow.

    Parameters
    ----------
    found : Poles or mapping of str to Poles
        Poles by label, all in the same axes.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `found` are not poles.

    See Also
    --------
    derivatives.poles : poles of a loop

    Examples
    --------
    >>> from pinmobile import PD, FixedHeading, Hold, MobileRobot
    >>> from pinmobile import plots
    >>> from pinmobile.derivatives import poles
    >>> rest = FixedHeading(Hold((0, 0), 1.0), 0.0)
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> figure = plots.poles(poles(robot, PD(120, 120), rest, dt=0.05))
    >>> figure.axes[0].get_xlabel()
    'real part of z'
    """
    table: dict[str, Poles] = label_items("found", found, Poles)
    sheet = Sheet(6.0, **layout)
    (axes,) = sheet.axes([(0, 0)], [5.2], share="")
    circle = np.exp(1j * np.linspace(0.0, 2 * np.pi, 361))
    axes.plot(circle.real, circle.imag, color=QUIET, linewidth=1.2)
    angle = np.linspace(0.0, np.pi, 181)
    for ratio in _DAMPING_RATIOS:
        z = np.exp((-ratio / np.sqrt(1 - ratio**2) + 1j) * angle)
        for side in (1, -1):
            axes.plot(z.real, side * z.imag, color=QUIET, linewidth=0.6, linestyle=":")
        axes.annotate(
            f"{ratio:g}", (z[_LABEL].real, z[_LABEL].imag), color=QUIET, fontsize=font_size(0.8), ha="center"
        )
    keys = []
    for k, (label, one) in enumerate(table.items()):
        mark: Style = {"marker": _MARKS[k % len(_MARKS)], "color": colour(k), "linestyle": ""}
        mark |= {"markeredgewidth": 1.8}
        axes.plot(one.values.real, one.values.imag, markersize=font_size(0.8), **mark)
        keys.append(Line2D([], [], label=label or "poles", **mark))
    size = max(1.15, *(1.05 * float(np.abs(one.values).max()) for one in table.values()))
    axes.set(xlim=(-size, size), ylim=(-size, size), aspect="equal")
    axes.set(xlabel="real part of z", ylabel="imaginary part of z")
    keys.append(Line2D([], [], color=QUIET, linewidth=1.2, label="stability limit"))
    keys.append(Line2D([], [], color=QUIET, linewidth=0.6, linestyle=":", label="damping ratio"))
    one = next(iter(table.values()))
    return sheet.finish(f"Poles near t = {one.t:g} s, dt = {1e3 * one.dt:g} ms", keys)


def sensitivities(
    found: Sensitivities, deviations: Mapping[str, ArrayLike], **layout: Unpack[Layout]
) -> Figure:
    """Draw the error of a run with a band of two standard deviations for uncertain numbers, to first order.

    Parameters
    ----------
    found : Sensitivities
        Derivatives of a run.
    deviations : mapping of str to array_like
        Standard deviations of the numbers, see `Sensitivities.deviation`.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `found` or `deviations` is invalid.

    See Also
    --------
    derivatives.sensitivities : derivatives of a run
    plots.bands : bands of an ensemble, for finite changes

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import plots
    >>> from pinmobile.derivatives import sensitivities
    >>> circle = Tangent(Circle(1.0, 0.5, 4.0))
    >>> parts = MobileRobot(30.0, 1.3), PD(120, 120), circle
    >>> found = sensitivities(*parts, by=["mass"], dt=0.02)
    >>> figure = plots.sensitivities(found, {"mass": 3.0})
    >>> len(figure.axes)
    3
    """
    instance("found", found, Sensitivities, "derivatives.Sensitivities")
    run = found.rollout
    band = _DEVIATIONS * found.deviation(deviations)[:, : run.error.shape[1]]
    names = ", ".join(deviations) if len(deviations) <= _MAX_NAMES else f"{len(deviations)} numbers"
    words = f"Error, and a band of two standard deviations of {names}"
    figure = errors(run, **({"title": words} | layout))
    given = layout.get("ax")
    panels = figure.axes if given is None or isinstance(given, Figure | SubFigure) else np.ravel(given)  # type: ignore[arg-type]
    for axes, error, size in zip(panels, run.error.T, band.T, strict=False):
        axes.fill_between(run.t, error - size, error + size, color=tint(colour(0), 0.3), linewidth=0)
    return figure
