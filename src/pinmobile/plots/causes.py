"""What drives the worst cases of an ensemble."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.stats import ks_2samp

from pinmobile.arrays import Array, scalar
from pinmobile.ensembles import PARAMETERS, Ensemble, Same
from pinmobile.errors import InvalidArgument
from pinmobile.plots.style import INK, ShownFigure, colour, dress, legend, percent

__all__ = ["drivers"]

_MOST = 6  # parameters that are drawn
_DOTS = 4000  # robots that are drawn, of the worst and of the others
_BINS = 40
_GREY = "#9a9a9a"
_WORST = colour(1)
_CRITICAL = 2.001  # of Kuiper's test at 1 %: Stephens, J. R. Stat. Soc. B 32 (1970)


class _Driver(NamedTuple):
    """A parameter, and where the worst robots have it."""

    name: str
    unit: str
    values: Array  # (n,)
    difference: float  # Kuiper's statistic, 0 to 1
    visible: bool  # more than chance would do
    low: float  # the worst have it between these two,
    high: float
    outside: bool  # or outside

    def where(self, values: Array) -> NDArray[np.bool_]:
        """Tell which values are where the worst robots are."""
        between = (values > self.low) & (values <= self.high)
        return ~between if self.outside else between

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if self.outside:
            return f"below {self.low:.3g} or above {self.high:.3g}{unit}"
        if np.isinf(self.low):
            return f"below {self.high:.3g}{unit}"
        if np.isinf(self.high):
            return f"above {self.low:.3g}{unit}"
        return f"from {self.low:.3g} to {self.high:.3g}{unit}"


def drivers(ensemble: Ensemble, *, share: float = 0.05, title: str | None = None) -> Figure:
    """Draw what the worst robots have in common: each parameter's distribution among them and the others.

    The worst are those of `Ensemble.worst`: the diverged ones, then those that strayed farthest. The
    parameters are in the order of Kuiper's statistic, the sum of both one-sided ones of Kolmogorov and
    Smirnov: by how much more of the worst than of the others lie in the interval, or outside the interval,
    that tells them apart best. That interval is shaded, and stands above each panel. What differs no more
    than chance allows (at 1 %) is said to play no part. Where a parameter is `Same` as another but for a
    factor that differs, their ratio takes its place.

    Parameters
    ----------
    ensemble : Ensemble
        Whose robots.
    share : float
        Share of the robots that are called the worst, above 0 and below 1.
    title : str, optional
        Heading of the figure, which by default names what drives them.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `ensemble` is something else, `share` is no such share or leaves no robot on one side, or
        nothing is spread.
    """
    if not isinstance(ensemble, Ensemble):
        raise InvalidArgument(f"ensemble is a {type(ensemble).__name__}, expected an Ensemble")
    worst = _worst(ensemble, share)
    found = sorted(_drivers(ensemble, worst), key=lambda one: -one.difference)
    if not found:
        raise InvalidArgument(
            "ensemble has a spread in which nothing differs, expected some parameter that does"
        )
    shown = found[:_MOST]
    columns = 1 if len(shown) <= 3 else 2
    rows = -(-len(shown) // columns)
    figure, grid = _sheet(rows, columns)
    figure.suptitle(title or _answer(found, share), fontsize=14, color=INK)
    for k, one in enumerate(shown):
        _distribution(figure.add_subplot(grid[k // columns, k % columns]), one, worst)
    _scatter(figure.add_subplot(grid[:, columns]), ensemble, found[0], worst)
    legend(figure, _keys(share, int(worst.sum()), bool(ensemble.diverged.any())))
    return figure


def _sheet(rows: int, columns: int) -> tuple[Figure, GridSpec]:
    """Return a figure and its grid: the last column is that of the scatter.

    Headings are as wide as their panels, which a layout engine would shrink for them.
    """
    width, height = 1.0 + 3.5 * columns + 4.0, 1.4 + max(2.1 * rows, 3.6)
    figure = ShownFigure(figsize=(width, height), dpi=100)
    return figure, figure.add_gridspec(
        rows, columns + 1, width_ratios=[1.0] * columns + [1.2], left=0.65 / width, right=1 - 0.15 / width,
        top=1 - 0.95 / height, bottom=1.0 / height, wspace=0.25, hspace=0.95,
    )  # fmt: skip


def _worst(ensemble: Ensemble, share: float) -> NDArray[np.bool_]:
    part = scalar("share", share)
    count = round(part * len(ensemble))
    if not (0 < part < 1 and 0 < count < len(ensemble)):
        raise InvalidArgument(
            f"share is {part} of {len(ensemble):,} robots, expected between 0 and 1, with robots on both sides"
        )
    worst = np.zeros(len(ensemble), bool)
    worst[ensemble.worst(count)] = True
    return worst


def _drivers(ensemble: Ensemble, worst: NDArray[np.bool_]) -> list[_Driver]:
    return [
        _driver(name, unit, values, worst)
        for name, unit, values in _parameters(ensemble)
        if np.ptp(values) > 1e-12 * np.abs(values).max()
    ]


def _parameters(ensemble: Ensemble) -> list[tuple[str, str, Array]]:
    """Return name, unit and values of what is drawn by itself; of a `Same`, the factor."""
    found = []
    for name, values in ensemble.draws.items():
        source = ensemble.scenario.spread[name]
        if not isinstance(source, Same):
            found.append((name, PARAMETERS[name].unit, values))
        elif (base := ensemble.draws.get(source.name)) is not None:
            known = base != 0
            ratio = np.divide(values, base, out=np.ones_like(values), where=known)
            found.append((f"{name} / {source.name}", "", ratio))
        else:
            found.append((name, PARAMETERS[name].unit, values))
    return found


def _driver(name: str, unit: str, values: Array, worst: NDArray[np.bool_]) -> _Driver:
    """Return how the values of the worst differ from those of the others."""
    bad, good = values[worst], values[~worst]
    # Of the worst, more lie below `more`, and fewer below `fewer`.
    above = ks_2samp(bad, good, alternative="greater", method="asymp")
    below = ks_2samp(bad, good, alternative="less", method="asymp")
    more, fewer = float(above.statistic_location), float(below.statistic_location)
    difference = float(above.statistic + below.statistic)
    size = np.sqrt(len(bad) * len(good) / len(values))
    visible = difference * (size + 0.155 + 0.24 / size) > _CRITICAL
    low, high, outside = fewer, more, False
    if above.statistic < 0.1 * difference:
        high = np.inf
    elif below.statistic < 0.1 * difference:
        low = -np.inf
    elif more < fewer:
        low, high, outside = more, fewer, True
    return _Driver(name, unit, values, difference, bool(visible), low, high, outside)


def _answer(found: Sequence[_Driver], share: float) -> str:
    """Return in words what matters most."""
    names = [one.name for one in found if one.visible]
    if not names:
        return f"Nothing that was spread drives the worst {percent(share)}"
    return ", then ".join([f"{names[0]} drives the worst {percent(share)} most", *names[1:3]])


def _distribution(axes: Axes, one: _Driver, worst: NDArray[np.bool_]) -> None:
    """Draw how the parameter is distributed among the worst and among the others."""
    dress(axes)
    bins = np.linspace(one.values.min(), one.values.max(), _BINS + 1)
    good, bad = one.values[~worst], one.values[worst]
    for values, style in (
        (good, {"histtype": "stepfilled", "color": _GREY, "alpha": 0.55}),
        (bad, {"histtype": "step", "color": _WORST, "linewidth": 2.0}),
    ):
        weights = np.full(len(values), 100 / len(values))
        axes.hist(values, bins, weights=weights, zorder=2, **style)
    if one.visible:
        for low, high in _spans(one, bins[0], bins[-1]):
            axes.axvspan(low, high, color=_WORST, alpha=0.12, linewidth=0, zorder=1)
        shares = [percent(round(float(one.where(values).mean()), 2)) for values in (bad, good)]
        text, shade = f"{one}:\n{shares[0]} of the worst, {shares[1]} of the others", INK
    else:
        text, shade = "plays no part", "#777777"
    axes.set_title(text, fontsize=9.5, color=shade, loc="left")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_ylim(0, None)
    axes.margins(x=0)
    axes.set_xlabel(_label(one), fontsize=10)
    axes.set_ylabel("robots per bar [%]", fontsize=10)


def _spans(one: _Driver, low: float, high: float) -> list[tuple[float, float]]:
    if one.outside:
        return [(low, one.low), (one.high, high)]
    return [(max(low, one.low), min(high, one.high))]


def _label(one: _Driver) -> str:
    return f"{one.name} [{one.unit}]" if one.unit else one.name


def _scatter(axes: Axes, ensemble: Ensemble, one: _Driver, worst: NDArray[np.bool_]) -> None:
    """Draw how far each robot strayed, over what matters most; the diverged ones at the top."""
    dress(axes)
    far, lost = ensemble.max_distance, ensemble.diverged
    kept = far[~lost & np.isfinite(far)]
    logarithmic = len(kept) > 0 and 0 < 50 * np.median(kept) < kept.max()
    top = float(kept.max()) * (2 if logarithmic else 1.12) if len(kept) and kept.max() > 0 else 1.0
    height = np.where(lost, top, far)
    milli = top < 1
    for chosen, shade in ((~worst & ~lost, _GREY), (~worst & lost, _GREY), (worst & ~lost, _WORST),
                          (worst & lost, _WORST)):  # fmt: skip
        style = {"color": shade, "marker": "x" if (chosen & lost).any() else ".", "markersize": 4}
        indices = np.flatnonzero(chosen)
        indices = indices[:: max(1, -(-len(indices) // _DOTS))]
        scaled = height[indices] * (1e3 if milli else 1.0)
        axes.plot(one.values[indices], scaled, linestyle="", zorder=3, clip_on=False, **style)
    if logarithmic:
        axes.set_yscale("log")
    axes.set_title("How far each robot strays", fontsize=10.5, color=INK, loc="left")
    axes.set_xlabel(_label(one), fontsize=10)
    axes.set_ylabel(f"largest distance [{'mm' if milli else 'm'}]", fontsize=10)


def _keys(share: float, count: int, diverged: bool) -> list[Any]:
    keys: list[Any] = [
        Line2D([], [], color=_WORST, linewidth=2.0, label=f"the worst {percent(share)}: {count:,} robots"),
        Patch(facecolor=_GREY, alpha=0.55, label="the others"),
        Patch(facecolor=_WORST, alpha=0.12, label="where the worst are"),
    ]
    if diverged:
        keys.append(Line2D([], [], color=INK, marker="x", linestyle="", label="diverged"))
    return keys
