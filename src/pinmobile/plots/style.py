"""How figures look: colours, line styles, and the lines of rollouts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias, TypeVar

import numpy as np
from matplotlib import rcParams, rcParamsDefault
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from matplotlib.lines import Line2D
from numpy.typing import NDArray

import pinmobile.palette as palette
from pinmobile.arrays import Array, by_label
from pinmobile.errors import InvalidArgument, shown
from pinmobile.loop import Rollout
from pinmobile.palette import INK
from pinmobile.parts import able
from pinmobile.plots.figure_layout import Sheet, letters, wrapped

Style: TypeAlias = dict[str, Any]
"""How something is drawn: keyword arguments of matplotlib's artists."""

DASHES = ("-", (0, (6, 2)), (0, (6, 2, 1.5, 2)), (0, (2.5, 1.5)), (0, (1, 1)), (0, (4, 1, 1, 1, 1, 1)))
_ROUNDING = 1e-12  # in SI units
_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


def line_style(index: int, count: int) -> Style:
    """Return how the line of rollout `index` of `count` is drawn over the others.

    Dashes tell lines apart in grey. The first is the widest: where lines coincide, as well-controlled robots'
    do, each still shows. A user's cycle of colours, dashes and markers (``rcParams["axes.prop_cycle"]``) goes
    first.
    """
    share = (count - 1 - index) / max(count - 1, 1)
    style = {
        "color": colour(index),
        "linestyle": DASHES[index % len(DASHES)],
        "linewidth": float(rcParams["lines.linewidth"]) * (1.15 + 1.2 * share),
        "zorder": 3,
    }
    cycle = _cycle()
    own = cycle[index % len(cycle)] if cycle else {}
    return style | own | ({"markevery": 0.12} if "marker" in own else {})


def colour(index: int) -> str:
    """Return the colour of the rollout with this index, of the user's cycle if there is one."""
    cycle = _cycle()
    own = str(cycle[index % len(cycle)].get("color", "")) if cycle else ""
    return to_hex(own).upper() if own else palette.colour(index)


def _cycle() -> list[Style]:
    """Return the user's cycle of styles; empty where it is matplotlib's own."""
    cycle = rcParams["axes.prop_cycle"]
    return [] if cycle == rcParamsDefault["axes.prop_cycle"] else [dict(each) for each in cycle]


def ink() -> str:
    """Return the colour of what is desired and of words: the user's, if there is one."""
    own = rcParams["text.color"]
    return INK if own == rcParamsDefault["text.color"] else to_hex(own)


def desired() -> Style:
    """Return how the line of a reference is drawn."""
    thin = 0.8 * float(rcParams["lines.linewidth"])
    return {"color": ink(), "linestyle": (0, (5, 4)), "linewidth": thin, "zorder": 4}


def keys_of(runs: Mapping[str, object], alone: str = "") -> list[Line2D]:
    """Return what a legend says of lines in `line_style`; nothing of a single one, or that it is `alone`."""
    if len(runs) == 1 and not alone:
        return []
    return [
        Line2D([], [], label=label or alone, **line_style(index, len(runs)))
        for index, label in enumerate(runs)
    ]


def shortened(sheet: Sheet, label: str) -> str:
    """Return a label in lines that fit above one of so many panels, in the letters of `heading`."""
    return wrapped(label, letters(1.2), sheet.room(), weight="bold")


def tint(base: str, share: float) -> tuple[float, float, float]:
    """Return a colour mixed with that of the axes: `share` of it, from 0 to 1."""
    r, g, b = (
        ground - share * (ground - part)
        for ground, part in zip(to_rgb(rcParams["axes.facecolor"]), to_rgb(base), strict=True)
    )
    return r, g, b


def dress(axes: Axes) -> None:
    """Give axes a quiet frame and grid."""
    axes.grid(True, color=rcParams["grid.color"], alpha=0.35, linewidth=rcParams["grid.linewidth"])
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#888888")
    axes.tick_params(color="#888888")


def dress_time(axes: Axes) -> None:
    """Give axes over time a quiet frame, and room beside what is drawn."""
    dress(axes)
    axes.margins(x=0.01, y=0.1)


def heading(index: int) -> Style:
    """Return how the label of rollout `index` is written above its axes, by an offset in points."""
    return {
        "xycoords": "axes fraction",
        "textcoords": "offset points",
        "va": "bottom",
        "fontsize": letters(1.2),
        "fontweight": "bold",
        "color": colour(index),
    }


def percent(share: float) -> str:
    """Return a share as text, such as ``99.9 %``."""
    return f"{100 * share:.6g} %"


def si(value: float, unit: str) -> str:
    """Return a size of two digits with the prefix that suits it, such as ``7.5 mm``."""
    if value < 1e-10:
        return (
            f"{value:.1e} {unit}" if value > _ROUNDING else f"0 {unit}{', within rounding' if value else ''}"
        )
    rounded = float(f"{value:.1e}")
    scale, prefix = next((pair for pair in _PREFIXES if rounded >= pair[0]), _PREFIXES[-1])
    return f"{rounded / scale:.{1 if rounded < 9.95 * scale else 0}f} {prefix}{unit}"


Rollouts: TypeAlias = Rollout | Mapping[str, Rollout]

_Kind = TypeVar("_Kind")

_MOST = 4000  # samples drawn as they are
_BINS = 1000  # of a longer rollout; more than a figure has columns of pixels


def labelled(rollouts: object) -> dict[str, Rollout]:
    """Return the rollouts by label; a single one has the label "".

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        What a caller wants drawn.

    Raises
    ------
    InvalidArgument
        If it is something else, or holds nothing.
    """
    return by_label("rollouts", rollouts, Rollout)


def called(label: str) -> str:
    """Return what a message calls one of `labelled` rollouts."""
    return f"rollouts[{label!r}]" if label else "rollouts"


def of_each(runs: Mapping[str, Rollout], ask: Callable[[Rollout], _Kind]) -> dict[str, _Kind]:
    """Return what is asked of each of `labelled` rollouts.

    Raises
    ------
    InvalidArgument
        As `ask` does; the message names the rollout.
    """
    found = {}
    for label, run in runs.items():
        try:
            found[label] = ask(run)
        except InvalidArgument as error:
            raise InvalidArgument(f"{called(label)}.{error}") from None
    return found


def with_plants(rollouts: object, kind: type, expected: str) -> dict[str, Rollout]:
    """Return `labelled` rollouts of plants that are of a kind, in words what is expected."""
    runs = labelled(rollouts)
    for label, run in runs.items():
        if able(run.plant, kind) is None:
            raise InvalidArgument(f"{called(label)}.plant is {shown(run.plant)}, expected {expected}")
    return runs


def same_references(runs: Mapping[str, Rollout]) -> dict[bytes, list[str]]:
    """Return the labels of the rollouts in groups, each with one reference over the same times."""
    groups: dict[bytes, list[str]] = {}
    for label, run in runs.items():
        groups.setdefault(run.t.tobytes() + run.reference.q.tobytes(), []).append(label)
    return groups


def thinned(*columns: Array) -> NDArray[np.intp]:
    """Return the indices of the samples that a line needs, in order, its extremes among them.

    All samples of a short rollout; of a long one the first and last, and in each of 1000 stretches those
    where a column is smallest and largest. So no peak is lost, however short.

    Parameters
    ----------
    *columns : ndarray, shape (N,)
        What is drawn; for a curve in the plane, both its coordinates.
    """
    count = len(columns[0])
    if count <= _MOST:
        return np.arange(count)
    width = -(-count // _BINS)
    stretches = -(-count // width)
    starts = width * np.arange(stretches)
    kept = [np.array([0, count - 1])]
    for column in columns:
        padded = np.pad(column, (0, width * stretches - count), mode="edge").reshape(stretches, width)
        kept += [starts + padded.argmin(axis=1), starts + padded.argmax(axis=1)]
    return np.unique(np.minimum(np.concatenate(kept), count - 1))


def curve(axes: Axes, x: Array, y: Array, **style: Any) -> None:
    """Draw a curve in the plane."""
    kept = thinned(np.nan_to_num(x), np.nan_to_num(y))
    axes.plot(x[kept], y[kept], **style)


def line(axes: Axes, t: Array, values: Array, **style: Any) -> None:
    """Draw a line over time, with a gap where a value is not finite; a single sample is a dot."""
    finite = np.where(np.isfinite(values), values, np.nan)
    kept = thinned(np.nan_to_num(finite))
    axes.plot(t[kept], finite[kept], **{"marker": "o" if len(t) == 1 else ""} | style)


def shade(panels: Iterable[Axes], t: Array, chosen: NDArray[np.bool_], **style: Any) -> None:
    """Shade the times of the chosen samples, each up to the next sample."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    for start, stop in edges.reshape(-1, 2):
        for axes in panels:
            axes.axvspan(t[start], t[min(stop, len(t) - 1)], linewidth=0, **style)
