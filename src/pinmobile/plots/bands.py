"""How far the robots of ensembles stray, and what else is judged, over time: quantiles side by side."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib import rcParams
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pinmobile.arrays import Array, ArrayLike, finite, one_of, sequence
from pinmobile.errors import InvalidArgument
from pinmobile.loop import Bands, Ensemble, edges
from pinmobile.measures import Measure
from pinmobile.palette import INK
from pinmobile.plots.sheet import Canvas, Sheet, letters, over, wrapped
from pinmobile.plots.style import Style, colour, dress, heading, named, percent, shortened, si, tint

_ALWAYS = "distance", "heading"
_LINEAR = 40.0  # by how much the largest of all may exceed the smallest median on a linear axis
_ROUNDING = 1e-9  # of the largest of all: less is next to nothing on a logarithmic axis
_GREY = "#777777"
_PLAIN: Style = {"color": INK, "fontweight": "normal"}


class _Scale(NamedTuple):
    """What the axes of one row show, in the unit that suits it."""

    unit: str
    per_si: float
    low: float
    high: float
    logarithmic: bool
    is_margin: bool = False


def bands(
    ensembles: Ensemble | Mapping[str, Ensemble],
    *,
    levels: ArrayLike = (0.5, 0.9, 0.99),
    by: Sequence[str] | None = None,
    title: str | None = None,
    ax: Canvas | None = None,
    width: float | None = None,
) -> Figure:
    """Draw what shares of the robots stay within, over time: distance from the desired position, and heading.

    And so on of what else is judged, a row for each. All ensembles have the same axes; where one's errors are
    far larger than another's, they are logarithmic, and say so. Where so many robots have diverged that a
    band has no end, it leaves the axes at the top. Above each panel stands what the largest share stays
    within all the time. Of a margin the shares have at least what is drawn; the axes are linear.

    Parameters
    ----------
    ensembles : Ensemble or mapping of str to Ensemble
        Each gets a column.
    levels : array_like, shape (L,)
        Shares of the robots, from 0 to 1.
    by : sequence of str, optional
        What is drawn of `Scenario.channels`, such as ``["end effector", "ur5/elbow_joint"]``; by default the
        distance, the heading, and what all ensembles judge beside errors.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument, UnknownName
        If `ensembles` is something else, a level is not a share, or an ensemble counts nothing of a name.
    """
    known: dict[str, Ensemble] = named("ensembles", ensembles, Ensemble)
    shares = np.unique(finite("levels", levels))
    if not shares.size:
        raise InvalidArgument("levels is empty, expected at least one share of the robots")
    rows = _rows(list(known.values()), by)
    drawn = [_drawn(one, shares, [row.name for row in rows]) for one in known.values()]
    sheet = Sheet(ax, width, max(7.5, 3.6 * len(known)))
    grid = sheet.grid(len(rows), len(known), [max(2.0, 4.4 / len(rows))] * len(rows), share="xy")
    for row, channel in zip(grid, rows, strict=True):
        quantiles = [one[channel.name] for one in drawn]
        scale = _margins(quantiles, channel.unit) if channel.is_margin else _scale(quantiles, channel.unit)
        words = f"{_words(channel)} [{scale.unit}]" if scale.unit else _words(channel)
        row[0].set_ylabel(f"{words}\nlogarithmic" if scale.logarithmic else words)
        for index, (axes, values) in enumerate(zip(row, quantiles, strict=True)):
            _panel(axes, drawn[index].t, values, scale, index)
    for index, (label, one) in enumerate(known.items()):
        _headings(
            sheet, grid[:, index], rows, label, one, float(drawn[index].levels[-1]), (index, len(known))
        )
        grid[-1, index].set_xlabel("t [s]")
    if sheet.new:
        sheet.figure.align_ylabels(grid[:, 0])
    return sheet.finish(title, "How far the robots stray", list(_keys(drawn[0], list(known.values()))))


def _rows(ensembles: Sequence[Ensemble], by: Sequence[str] | None) -> list[Measure]:
    """Return what has a row.

    Raises
    ------
    InvalidArgument, UnknownName
        If that is no sequence, or an ensemble counts nothing of a name.
    """
    known = [{each.name: each for each in one.scenario.channels} for one in ensembles]
    if by is None:
        judged = [each.name for each in ensembles[0].scenario.judged]
        names = [*_ALWAYS, *(name for name in judged if all(name in each for each in known))]
    else:
        names = list(sequence("by", by, "a sequence of names, such as ['distance']"))
    if not names:
        raise InvalidArgument("by is empty, expected at least one name, such as 'distance'")
    for each in known:
        for name in names:
            one_of("band", name, each)
    return [known[0][name] for name in names]


def _words(channel: Measure) -> str:
    """Return what is told beside the axes of a row."""
    words = {"distance": "distance from\ndesired position", "heading": "error of\nheading"}
    if channel.meaning == f"error of {channel.name}":
        return f"error of\n{channel.name}"
    return words.get(channel.name, channel.name.replace(" of ", "\nof "))


def _drawn(ensemble: Ensemble, levels: Array, names: Sequence[str]) -> Bands:
    """Return the quantiles that are drawn, none above what its share of the robots stays within.

    That holds from `Scenario.after` on. The counts know an error to the width of a bin alone,
    `Ensemble.within` exactly. What they cannot tell from zero is zero.
    """
    found = ensemble.bands(levels)
    most = [ensemble.within(level) for level in levels]
    begun = found.t >= ensemble.scenario.t[ensemble.scenario.begin]
    drawn = {}
    for name in names:
        one, bound = found[name], np.array([each[name] for each in most])[:, None]
        if any(each.is_margin for each in ensemble.scenario.channels if each.name == name):
            drawn[name] = np.where(begun, np.maximum(one, bound), one)
        else:
            held = np.where(begun, np.minimum(one, bound), one)
            drawn[name] = np.where(one < edges()[1], 0.0, held)
    return Bands(found.t, found.levels, drawn)


def _scale(quantiles: Sequence[Array], unit: str) -> _Scale:
    """Return axes that hold all that is finite, each of shape (L, G)."""
    finite = [np.where(np.isfinite(one), one, np.nan) for one in quantiles]
    highest = [float(np.nanmax(one, initial=0.0)) for one in finite]
    smallest = [float(np.nanmax(one[0], initial=0.0)) for one in finite]
    top = max(highest) or 1e-3
    prefix, per_si = _prefix(top, unit)
    logarithmic = top > _LINEAR * min((value for value in smallest if value > 0), default=top)
    least = min(float(one[one > 0].min(initial=top)) for one in finite)
    low, high = (max(least, _ROUNDING * top) / 2, 2 * top) if logarithmic else (0.0, 1.08 * top)
    return _Scale(f"{prefix}{unit}", per_si, low * per_si, high * per_si, logarithmic)


def _margins(quantiles: Sequence[Array], unit: str) -> _Scale:
    """Return linear axes that hold all that is finite, and zero, each of shape (L, G)."""
    known = np.concatenate([one[np.isfinite(one)] for one in quantiles])
    lowest, highest = float(known.min(initial=0.0)), float(known.max(initial=0.0))
    prefix, per_si = _prefix(max(highest, -lowest) or 1e-3, unit)
    room = 0.08 * ((highest - lowest) or 1e-3)
    low, high = lowest - (room if lowest < 0 else 0.0), highest + room
    return _Scale(f"{prefix}{unit}", per_si, low * per_si, high * per_si, False, True)


def _prefix(top: float, unit: str) -> tuple[str, float]:
    """Return the prefix of a unit that suits numbers up to `top`, and how many of it are one."""
    if not unit or top >= 1:
        return "", 1.0
    return ("m", 1e3) if top >= 1e-3 else ("µ", 1e6)


def _panel(axes: Axes, t: Array, quantiles: Array, scale: _Scale, index: int) -> None:
    """Draw quantiles, shape (L, G), the narrowest in the fullest colour."""
    dress(axes)
    axes.margins(x=0.0)
    if scale.logarithmic:
        axes.set_yscale("log")
    axes.set_ylim(scale.low, scale.high)
    size = scale.high - scale.low
    beyond = scale.low - 10 * size if scale.is_margin else 10 * scale.high  # infinity is out of the axes
    lines = np.where(np.isfinite(quantiles), quantiles * scale.per_si, beyond)
    edge = np.full(len(t), scale.high if scale.is_margin else scale.low)
    for shade, line in zip(_shades(colour(index), len(lines)), lines, strict=True):
        end = np.clip(line, scale.low, None)
        axes.fill_between(t, edge, end, color=shade, linewidth=0, zorder=2)
        edge = end
    if scale.is_margin:
        axes.axhline(0.0, color=_GREY, linewidth=1.0, linestyle=":", zorder=1)
    thick = float(rcParams["lines.linewidth"])
    for k, line in enumerate(lines):
        axes.plot(t, line, color=colour(index), linewidth=thick * (1.2 if k == 0 else 0.6), zorder=3)


def _shades(base: str, count: int) -> list[tuple[float, float, float]]:
    """Return the colours of bands, the narrowest first, which is the fullest; none is white."""
    return [tint(base, share) for share in np.linspace(0.75, 0.15, count)]


def _headings(
    sheet: Sheet,
    column: Iterable[Axes],
    rows: Sequence[Measure],
    label: str,
    one: Ensemble,
    level: float,
    place: tuple[int, int],
) -> None:
    """Write above a column, whose number among so many is its place."""
    index, columns = place
    count = int(one.diverged.sum())
    fate = f"{count:,} of {len(one):,} diverged" if count else f"none of {len(one):,} diverged"
    first, *_ = column
    after = one.scenario.after
    when = f"from {after:g} s on" if after else "throughout"
    within = one.within(level)
    lines: list[int] = []
    for axes, channel in zip(column, rows, strict=True):
        size = within[channel.name]
        stay = "have at least" if channel.is_margin else "stay within"
        bound = f"{_size(size, channel.unit)} {when}" if np.isfinite(size) else "no bound"
        words = wrapped(f"{percent(level)} {stay} {bound}", letters(), sheet.room(columns))
        axes.set_title(words, fontsize=letters(), loc="left")
        lines.append(words.count("\n") + 1)
        if after:
            axes.axvline(after, color=_GREY, linewidth=1.0, linestyle=":", zorder=1)
    fate = wrapped(fate, letters(), sheet.room(columns))
    above = over(lines[0])
    first.annotate(fate, (0, 1), (0, above), **heading(index) | _PLAIN | {"fontsize": letters()})
    above += letters(1.4) * (fate.count("\n") + 1)
    first.annotate(shortened(sheet, label, columns), (0, 1), (0, above), **heading(index))


def _size(value: float, unit: str) -> str:
    """Return a size of two digits, with its sign."""
    if not unit:
        return f"{value:.2g}"
    return f"-{si(-value, unit)}" if value < 0 else si(value, unit)


def _keys(drawn: Bands, ensembles: Sequence[Ensemble]) -> Iterator[Artist]:
    sizes = {len(one) for one in ensembles}
    whose = f"of {sizes.pop():,} robots" if len(sizes) == 1 else "of the robots"
    style: Style = {"edgecolor": _GREY, "linewidth": 0.8}
    labels = [percent(level) for level in drawn.levels]
    labels[-1] = f"{labels[-1]} {whose}"
    for shade, label in zip(_shades(_GREY, len(labels)), labels, strict=True):
        yield Patch(facecolor=shade, label=label, **style)
