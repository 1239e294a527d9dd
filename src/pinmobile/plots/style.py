"""How figures look and where their axes stand: colours, line styles, legends, and the lines of rollouts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from pinmobile.arrays import Array, text
from pinmobile.errors import InvalidArgument, shown
from pinmobile.palette import INK, colour
from pinmobile.simulation import Rollout

Style: TypeAlias = dict[str, Any]
"""How something is drawn: keyword arguments of matplotlib's artists."""

DESIRED: Style = {"color": INK, "linestyle": (0, (5, 4)), "linewidth": 1.2, "zorder": 4}

_DASHES = ("-", "-", (0, (8, 2)), (0, (5, 2, 1.5, 2)), (0, (1.5, 1.5)))
_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


class ShownFigure(Figure):
    """A figure that a notebook shows although pyplot was never imported."""

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def headed(title: object, default: str) -> str:
    """Return the heading of a figure.

    Raises
    ------
    InvalidArgument
        If it is no text.
    """
    return default if title is None or (isinstance(title, str) and not title) else text("title", title)


def line_style(index: int, count: int) -> Style:
    """Return how the line of rollout `index` of `count` is drawn over the others.

    The first is the widest: where lines coincide, as well-controlled robots' do, each still shows.
    """
    return {
        "color": colour(index),
        "linestyle": _DASHES[index % len(_DASHES)],
        "linewidth": 2.0 + 2.6 * (count - 1 - index) / max(count - 1, 1),
        "zorder": 3,
    }


def tint(base: str, share: float) -> tuple[float, float, float]:
    """Return a colour mixed with white: `share` of it, from 0 to 1."""
    r, g, b = (1 - share * (1 - part) for part in to_rgb(base))
    return r, g, b


def dress(axes: Axes) -> None:
    """Give axes a quiet frame and grid."""
    axes.grid(True, color="#e4e4e4", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#888888")
    axes.tick_params(color="#888888", labelsize=10)


def heading(index: int) -> Style:
    """Return how the label of rollout `index` is written above its axes, by an offset in points."""
    return {
        "xycoords": "axes fraction",
        "textcoords": "offset points",
        "fontsize": 13,
        "fontweight": "bold",
        "color": colour(index),
    }


def legend(figure: Figure | SubFigure, handles: Sequence[Artist]) -> None:
    """Put a legend below all axes, where it hides nothing."""
    rows = -(-len(handles) // 5)
    columns = -(-len(handles) // rows)
    where: Literal["lower center", "outside lower center"]
    where = "lower center" if figure.get_layout_engine() is None else "outside lower center"
    figure.legend(handles=handles, loc=where, ncols=columns, frameon=False, fontsize=11, columnspacing=1.5)


def percent(share: float) -> str:
    """Return a share as text, such as ``99.9 %``."""
    return f"{100 * share:.6g} %"


def si(value: float, unit: str) -> str:
    """Return a size of two digits with the prefix that suits it, such as ``7.5 mm``."""
    if value < 1e-10:
        return f"{value:.1e} {unit}" if value else f"0 {unit}"
    rounded = float(f"{value:.1e}")
    scale, prefix = next((pair for pair in _PREFIXES if rounded >= pair[0]), _PREFIXES[-1])
    return f"{rounded / scale:.{1 if rounded < 9.95 * scale else 0}f} {prefix}{unit}"


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
    return named("rollouts", rollouts, Rollout)


def named(argument: str, values: object, kind: type[_Kind]) -> dict[str, _Kind]:
    """Return what is drawn by label; a single one has the label "".

    Parameters
    ----------
    argument : str
        Name of the argument, for the message.
    values : object or mapping of str to object
        What a caller wants drawn.
    kind : type
        What each must be.

    Raises
    ------
    InvalidArgument
        If it is something else, or holds nothing.
    """
    what = kind.__name__
    one = f"{'an' if what[0] in 'AEIOU' else 'a'} {what}"
    if isinstance(values, kind):
        return {"": values}
    if not isinstance(values, Mapping):
        raise InvalidArgument(
            f"{argument} is a {type(values).__name__}, expected {one} or a mapping of labels to {what}s"
        )
    if not values:
        raise InvalidArgument(f"{argument} is empty, expected at least one {what}")
    for label, value in values.items():
        if not isinstance(label, str) or not label:
            raise InvalidArgument(f"{argument} has the label {shown(label)}, expected a name")
        if not isinstance(value, kind):
            raise InvalidArgument(f"{argument}[{label!r}] is a {type(value).__name__}, expected {one}")
    return dict(values)


def planar(rollouts: object) -> dict[str, Rollout]:
    """Return `labelled` rollouts, each of which has a pose (x, y, psi) to be drawn.

    Raises
    ------
    InvalidArgument
        If the plant of one does not tell where its body is, or as `labelled` does.
    """
    runs = labelled(rollouts)
    for label, run in runs.items():
        try:
            _ = run.poses
        except InvalidArgument as error:
            name = f"rollouts[{label!r}]" if label else "rollouts"
            raise InvalidArgument(f"{name}.{error}") from None
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
