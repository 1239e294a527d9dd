"""How far the robots of ensembles stray, over time: bands of quantiles, controllers side by side."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pinmobile.arrays import Array, ArrayLike, finite
from pinmobile.ensembles import Bands, Ensemble
from pinmobile.ensembles.histogram import edges
from pinmobile.errors import InvalidArgument
from pinmobile.palette import INK, colour
from pinmobile.plots.runs import named
from pinmobile.plots.style import ShownFigure, dress, headed, heading, legend, percent, si, tint

__all__ = ["bands"]

_ROWS = (("distance", "distance from\ndesired position", "m"), ("heading", "error of\nheading", "rad"))
_LINEAR = 40.0  # by how much the largest of all may exceed the smallest median on a linear axis
_ROUNDING = 1e-9  # of the largest of all: less is next to nothing on a logarithmic axis
_GREY = "#777777"


class _Scale(NamedTuple):
    """What the axes of one row show, in the unit that suits it."""

    unit: str
    per_si: float
    low: float
    high: float
    logarithmic: bool


def bands(
    ensembles: Ensemble | Mapping[str, Ensemble],
    *,
    levels: ArrayLike = (0.5, 0.9, 0.99),
    title: str | None = None,
) -> Figure:
    """Draw what shares of the robots stay within, over time: distance from the desired position, and heading.

    All ensembles have the same axes; where one's errors are far larger than another's, they are
    logarithmic. Where so many robots have diverged that a band has no end, it leaves the axes at the top.
    Above each panel stands what the largest share stays within all the time.

    Parameters
    ----------
    ensembles : Ensemble or mapping of str to Ensemble
        Each gets a column.
    levels : array_like, shape (L,)
        Shares of the robots, from 0 to 1.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `ensembles` is something else, or a level is not a share.
    """
    known: dict[str, Ensemble] = named("ensembles", ensembles, Ensemble)
    shares = np.unique(finite("levels", levels))
    if not shares.size:
        raise InvalidArgument("levels is empty, expected at least one share of the robots")
    drawn = [_drawn(one, shares) for one in known.values()]
    figure = ShownFigure(figsize=(max(7.5, 3.6 * len(known)), 6.4), dpi=100, layout="constrained")
    figure.suptitle(headed(title, "How far the robots stray"), fontsize=14, color=INK)
    grid = figure.subplots(2, len(known), squeeze=False, sharex="col", sharey="row")
    for row, (attribute, words, unit) in zip(grid, _ROWS, strict=True):
        quantiles = [getattr(one, attribute) for one in drawn]
        scale = _scale(quantiles, unit)
        row[0].set_ylabel(f"{words} [{scale.unit}]", fontsize=11)
        for index, (axes, values) in enumerate(zip(row, quantiles, strict=True)):
            _panel(axes, drawn[index].t, values, scale, index)
    for index, (label, one) in enumerate(known.items()):
        _headings(grid[:, index], label, one, float(drawn[index].levels[-1]), index)
        grid[1, index].set_xlabel("t [s]", fontsize=11)
    figure.align_ylabels(grid[:, 0])
    legend(figure, list(_keys(drawn[0], list(known.values()))))
    return figure


def _drawn(ensemble: Ensemble, levels: Array) -> Bands:
    """Return the quantiles that are drawn, none above what its share of the robots stays within.

    That holds from `Scenario.after` on. The counts know an error to the width of a bin alone,
    `Ensemble.within` exactly. What they cannot tell from zero is zero.
    """
    found = ensemble.bands(levels)
    most = np.array([ensemble.within(level) for level in levels])
    begun = found.t >= ensemble.scenario.t[ensemble.scenario.begin]
    distance, heading = (
        np.where(one < edges()[1], 0.0, np.where(begun, np.minimum(one, bound[:, None]), one))
        for one, bound in zip((found.distance, found.heading), most.T, strict=True)
    )
    return found._replace(distance=distance, heading=heading)


def _scale(quantiles: Sequence[Array], unit: str) -> _Scale:
    """Return axes that hold all that is finite, each of shape (L, G)."""
    finite = [np.where(np.isfinite(one), one, np.nan) for one in quantiles]
    highest = [float(np.nanmax(one, initial=0.0)) for one in finite]
    smallest = [float(np.nanmax(one[0], initial=0.0)) for one in finite]
    top = max(highest) or 1e-3
    prefix, per_si = ("", 1.0) if top >= 1 else ("m", 1e3) if top >= 1e-3 else ("µ", 1e6)
    logarithmic = top > _LINEAR * min((value for value in smallest if value > 0), default=top)
    least = min(float(one[one > 0].min(initial=top)) for one in finite)
    low, high = (max(least, _ROUNDING * top) / 2, 2 * top) if logarithmic else (0.0, 1.08 * top)
    return _Scale(f"{prefix}{unit}", per_si, low * per_si, high * per_si, logarithmic)


def _panel(axes: Axes, t: Array, quantiles: Array, scale: _Scale, index: int) -> None:
    """Draw quantiles, shape (L, G), the narrowest in the fullest colour."""
    dress(axes)
    axes.margins(x=0.0)
    if scale.logarithmic:
        axes.set_yscale("log")
    axes.set_ylim(scale.low, scale.high)
    beyond = 10 * scale.high  # where infinity is drawn: out of the axes
    lines = np.where(np.isfinite(quantiles), quantiles * scale.per_si, beyond)
    below = np.full(len(t), scale.low)
    for shade, line in zip(_shades(colour(index), len(lines)), lines, strict=True):
        axes.fill_between(t, below, np.maximum(line, scale.low), color=shade, linewidth=0, zorder=2)
        below = np.maximum(line, scale.low)
    for k, line in enumerate(lines):
        axes.plot(t, line, color=colour(index), linewidth=2.0 if k == 0 else 0.8, zorder=3)


def _shades(base: str, count: int) -> list[tuple[float, float, float]]:
    """Return the colours of bands, the narrowest first, which is the fullest; none is white."""
    return [tint(base, share) for share in np.linspace(0.75, 0.15, count)]


def _headings(column: Iterable[Axes], label: str, one: Ensemble, level: float, index: int) -> None:
    count = int(one.diverged.sum())
    fate = f"{count:,} of {len(one):,} diverged" if count else f"none of {len(one):,} diverged"
    first, *_ = column
    after = one.scenario.after
    when = f"from {after:g} s on" if after else "throughout"
    for axes, size, (_, _, unit) in zip(column, one.within(level), _ROWS, strict=True):
        stays = f"within {si(size, unit)} {when}" if np.isfinite(size) else "within no bound"
        axes.set_title(f"{percent(level)} stay {stays}", fontsize=10.5, color=INK, loc="left")
        if after:
            axes.axvline(after, color=_GREY, linewidth=1.0, linestyle=":", zorder=1)
    first.annotate(fate, (0, 1), (0, 21), xycoords="axes fraction", textcoords="offset points",
                       fontsize=10.5, color=INK)  # fmt: skip
    first.annotate(label, (0, 1), (0, 38), **heading(index))


def _keys(drawn: Bands, ensembles: Sequence[Ensemble]) -> Iterator[Artist]:
    sizes = {len(one) for one in ensembles}
    whose = f"of {sizes.pop():,} robots" if len(sizes) == 1 else "of the robots"
    style: dict[str, Any] = {"edgecolor": _GREY, "linewidth": 0.8}
    labels = [percent(level) for level in drawn.levels]
    labels[-1] = f"{labels[-1]} {whose}"
    for shade, label in zip(_shades(_GREY, len(labels)), labels, strict=True):
        yield Patch(facecolor=shade, label=label, **style)
