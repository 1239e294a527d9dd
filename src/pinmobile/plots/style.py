"""Style and layout of figures: colours and lines of rollouts, and the sheet with the axes."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from io import BytesIO
from itertools import combinations
from typing import Any, Literal, TypeAlias, TypedDict, TypeVar

import numpy as np
from matplotlib import get_backend, rcParams, rcParamsDefault
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure, SubFigure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.textpath import text_to_path
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

import pinmobile.palette as palette
from pinmobile.arrays import Array, bounded, label_items, scalar, text
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.loop import Rollout, at_samples
from pinmobile.palette import INK
from pinmobile.parts import able

Canvas: TypeAlias = Axes | Figure | SubFigure | Sequence[Axes] | NDArray[Any]
"""Values of `ax`: axes, several axes, or a figure or subfigure to fill with axes."""

Spot: TypeAlias = tuple[int | slice, int | slice]
"""Row and column of axes in a grid."""


class Layout(TypedDict, total=False):
    """Arguments of all figures: heading ("" for none), axes or figure, width of a new figure [in]."""

    title: str | None
    ax: Canvas | None
    width: float | None


_NARROWEST, _WIDEST = 0.5, 100.0  # [in]
_NARROW, _WIDE = 0.62, 1.25  # smallest and largest scale of the heights of panels
_LEAST = 0.3  # [in], smallest side of readable axes
_ROOM = 1.0  # [pt], allowed overlap of texts: the boxes of texts have rims
_MOST_KEYS = 5  # largest number of entries in a row of a legend
_ABOVE = "axes fraction"  # coordinates of notes above axes
_NO_WINDOWS = {"agg", "cairo", "pdf", "pgf", "ps", "svg", "template"}


class ShownFigure(Figure):
    """Figure that a notebook shows once, with or without pyplot."""

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()

    def _ipython_display_(self) -> None:
        """Show the figure now and close it, because pyplot would show it again at the end of the cell."""
        pyplot = sys.modules.get("matplotlib.pyplot")
        if pyplot is None or "inline" not in get_backend() or not pyplot.fignum_exists(self.number):
            raise NotImplementedError  # IPython then uses `_repr_png_`
        display = import_module("IPython.display")
        display.display(display.Image(self._repr_png_()))
        pyplot.close(self)


def letters(share: float = 1.0) -> float:
    """Return a font size [pt] as a multiple of ``rcParams["font.size"]``."""
    return share * float(rcParams["font.size"])


def over(lines: int) -> float:
    """Return the height above axes over a title with a number of lines [pt]."""
    return float(rcParams["axes.titlepad"]) + letters(1.4) * lines


def over_titles(axes: Axes, words: str, **style: Any) -> None:
    """Write a note above axes and their titles.

    Matplotlib raises titles that would overlap the power of ten above an axis.
    """
    offset = 0, letters(0.45)
    axes.annotate(words, (0, 1), offset, **style | {"xycoords": (_ABOVE, partial(_titled, axes))})


def _titled(axes: Axes, renderer: RendererBase) -> Bbox:
    """Return the bounding box of the titles of axes [px]."""
    return Bbox.union([title.get_window_extent(renderer) for title in _titles(axes)])


def checked_title(title: str | None) -> str | None:
    """Return the checked title, which may be "" or None."""
    return title if title is None or (isinstance(title, str) and not title) else text("title", title)


def extent(line: str, size: float, **font: Any) -> float:
    """Return the length of a line of text of a font size [pt] in inches."""
    properties = FontProperties(family=rcParams["font.family"], size=size, **font)
    is_math = len(re.findall(r"(?<!\\)\$", line)) > 1
    try:
        width, _, _ = text_to_path.get_text_width_height_descent(line, properties, ismath=is_math)
    except ValueError:  # an invalid formula: matplotlib raises an error when it draws the formula
        return len(line) * size / 144
    return float(width) / 72


def wrapped(words: str, size: float, room: float, **font: Any) -> str:
    """Return text in lines no longer than `room` [in], except for longer words."""
    lines = []
    for line in words.split("\n"):
        current = ""
        for word in re.findall(r"(?:\\\$|\$[^$]*\$|\S)+", line):
            longer = f"{current} {word}".lstrip()
            if current and extent(longer, size, **font) > room:
                lines.append(current)
                longer = word
            current = longer
        lines.append(current)
    return "\n".join(lines)


class Sheet:
    """A new figure, or the figure or axes of the caller.

    ``rcParams`` gives font sizes, line widths and colours. A new figure is as high as its panels need. A
    figure of a given width, and a figure of the caller, must have room for the drawing.

    Parameters
    ----------
    natural : float
        Suitable width [in] at a font size of 10 points.
    title : str, optional
        Heading; "" for none.
    ax : Axes, sequence of Axes, Figure or SubFigure, optional
        Axes or figure to draw in; default: a new figure.
    width : float, optional
        Width of a new figure [in].
    known : bool
        Whether to register a new figure with pyplot, if pyplot has windows.

    Attributes
    ----------
    width : float
        Available width [in].
    new : bool
        Whether the figure is new.

    Raises
    ------
    InvalidArgument
        If `title` is not text, `ax` or `width` is invalid, or both `ax` and `width` are given.
    """

    def __init__(
        self,
        natural: float,
        *,
        title: str | None = None,
        ax: Canvas | None = None,
        width: float | None = None,
        known: bool = True,
    ) -> None:
        self._title = checked_title(title)
        self.new = ax is None
        self._given: list[Axes] = []
        self._asked = self.new and (width is not None or _has_size())
        self._columns = 1
        self._tall: dict[int, float] = {}
        self._left: dict[Axes, float] = {}
        self._rows: list[tuple[int, Axes]] = []
        if ax is None:
            self.width = _width(width, natural)
            self.scale = float(np.clip(self.width / (natural * letters() / 10), _NARROW, _WIDE))
            self.parent: Figure | SubFigure = _figure(self.width, known)
            return
        if width is not None:
            reason = "because its figure has a width"
            raise InvalidArgument(f"width is {format_value(width)}, expected None with ax, {reason}")
        self.scale = 1.0
        if isinstance(ax, Figure | SubFigure):
            self.parent, self.width = ax, _inches(ax, ax.bbox.width)
            if isinstance(ax, Figure) and ax.get_layout_engine() is None and not ax.axes:
                ax.set_layout_engine("constrained")
            return
        self._given = _axes_of(ax)
        self.parent = self._given[0].figure
        self.width = _inches(self.parent, self._given[0].bbox.width)

    @property
    def figure(self) -> Figure:
        """Whole figure, the result of a plot."""
        return self.parent.figure

    def columns(self, most: int, least: float) -> int:
        """Return the number of columns, each at least `least` inches wide at a font size of 10 points."""
        return most if self._given else int(np.clip(self.width / (least * letters() / 10), 1, most))

    def room(self, parts: int = 1) -> float:
        """Return the largest width of each of several texts side by side above a panel [in]."""
        if self._given:
            return self.width
        return max(0.97 * self.width / (self._columns * parts) - 5.5 * letters() / 72, 5 * letters() / 72)

    def write_above(self, axes: Axes, words: str, share: float = 1.0, **style: Any) -> None:
        """Write text above axes in lines that fit, with a relative font size."""
        size = letters(share)
        axes.set_title(wrapped(words, size, self.room()), fontsize=size, **style)

    def axes(
        self, spots: Sequence[Spot], tall: Sequence[float], *, share: str = "x", ratios: Sequence[float] = ()
    ) -> list[Axes]:
        """Return axes at spots of a grid: new axes, or the axes of the caller.

        Parameters
        ----------
        spots : sequence of tuple
            Row and column of each of the axes.
        tall : sequence of float
            Heights of the rows at the natural width [in].
        share : str
            Shared scales: "x" in each column, "xy" also in each row.
        ratios : sequence of float, optional
            Relative widths of the columns.

        Raises
        ------
        InvalidArgument
            If the caller gave another number of axes.
        """
        if self._given:
            if len(self._given) != len(spots):
                one = "one Axes" if len(self._given) == 1 else f"{len(self._given)} Axes"
                expected = f"{len(spots)}, one for each panel, or a figure to fill"
                raise InvalidArgument(f"ax is {one}, expected {expected}")
            return self._given
        self._columns = len(ratios) or 1 + max(_first(column) for _, column in spots)
        self._tall = {k: max(self.scale * each, 5.5 * letters() / 72) for k, each in enumerate(tall)}
        grid = self.parent.add_gridspec(
            len(tall), self._columns, height_ratios=list(self._tall.values()), width_ratios=ratios or None
        )
        found: list[Axes] = []
        first: dict[str, Axes] = {}
        for row, column in spots:
            kinship = {f"share{axis}": first.get(f"{axis}{place}")
                       for axis, place in (("x", column), ("y", row)) if axis in share}  # fmt: skip
            made = self.parent.add_subplot(grid[row, column], **kinship)
            first.setdefault(f"x{column}", made)
            first.setdefault(f"y{row}", made)
            if not isinstance(row, slice):
                self._rows.append((row, made))
            found.append(made)
        for made, (row, column) in zip(found, spots, strict=True):
            below = any(_first(other) > _first(row) for other, same in spots if same == column)
            made.tick_params(labelbottom="x" not in share or not below)
            made.tick_params(labelleft="y" not in share or _first(column) == 0)
        return found

    def grid(self, rows: int, columns: int, tall: Sequence[float], *, share: str = "x") -> NDArray[Any]:
        """Return a full grid of axes, shape (rows, columns); see `axes`."""
        spots = [(row, column) for row in range(rows) for column in range(columns)]
        grid = np.empty(len(spots), object)
        grid[:] = self.axes(spots, tall, share=share)
        return grid.reshape(rows, columns)

    def legend_above(self, axes: Axes) -> None:
        """Place the legend of axes between the axes and their title."""
        if self._given:
            axes.legend(frameon=False)
            return
        size, (keys, labels) = letters(0.9), axes.get_legend_handles_labels()
        wide = max(extent(label, size) for label in labels) + 4.3 * size / 72
        abreast = int(np.clip(self.room() / wide, 1, len(keys)))
        rows = -(-len(keys) // abreast)
        axes.legend(
            keys, labels, ncols=-(-len(keys) // rows), loc="lower left", bbox_to_anchor=(-0.02, 1.0),
            fontsize=size, frameon=False, borderpad=0.2, columnspacing=1.2,
        )  # fmt: skip
        high = (1.5 * rows + 1.1) * size
        axes.set_title(axes.get_title(), fontsize=letters(), pad=high)
        self._left[axes] = high / 72

    def finish(self, default: str, keys: Sequence[Artist] = (), *, height: float = 0.0) -> Figure:
        """Write the heading and the legend, and return the figure.

        Axes of the caller get a heading only for a given title, and the legend inside.

        Parameters
        ----------
        default : str
            Heading of figures without a given title.
        keys : sequence of Artist
            Entries of the legend.
        height : float
            Height of the figure [in]; 0: computed from rows and texts.

        Raises
        ------
        InvalidArgument
            If the figure is too small for the drawing.
        """
        if self._given:
            if self._title:
                self._given[0].set_title(wrapped(self._title, letters(1.2), self.width))
            if keys:
                self._given[0].legend(handles=list(keys), frameon=False)
            self.check()
            return self.figure
        size, lines = self._heading(default)
        heading = self.parent.suptitle(lines, fontsize=size) if lines else None
        if keys:
            where: Any = "lower center" if self.figure.get_layout_engine() is None else "outside lower center"
            self.parent.legend(
                handles=list(keys), loc=where, ncols=self._keys(keys)[1], frameon=False, columnspacing=1.5
            )
        if self.new:
            rows = sum(self._row(row) for row in self._tall)
            needed = rows + self.heading(default) + self.below(keys) + 4.0 * letters() / 72
            self.figure.set_size_inches(self.width, height or needed)
        if height and heading is not None:
            heading.set(y=1 - 0.5 * size / 72 / height, va="top")
        if self._asked or not self.new:
            self.check()
        return self.figure

    def heading(self, default: str) -> float:
        """Return the height of the heading [in]."""
        size, lines = self._heading(default)
        return (1.3 * lines.count("\n") + 1.8) * size / 72 if lines else letters(1.5) / 72

    def _heading(self, default: str) -> tuple[float, str]:
        size = _points("figure.titlesize")
        return size, wrapped(default if self._title is None else self._title, size, 0.96 * self.width)

    def below(self, keys: Sequence[Artist]) -> float:
        """Return the height of a legend [in]."""
        return (1.35 * self._keys(keys)[0] + 1.0) * _points("legend.fontsize") / 72 if keys else 0.0

    def _keys(self, keys: Sequence[Artist]) -> tuple[int, int]:
        """Return the numbers of rows and columns of a legend."""
        size = _points("legend.fontsize")
        wide = max(extent(str(key.get_label()), size) for key in keys) + 4.3 * size / 72
        rows = -(-len(keys) // int(np.clip(0.98 * self.width / wide, 1, min(len(keys), _MOST_KEYS))))
        return rows, -(-len(keys) // rows)

    def _row(self, number: int) -> float:
        """Return the height of a row [in]: its minimum height, or more if its texts need more."""
        words, titles, left = [self._tall[number]], [0.0], [0.0]
        for axes in (axes for row, axes in self._rows if row == number):
            label = axes.yaxis.label
            size = float(label.get_fontsize())
            label.set_text(wrapped(label.get_text(), size, self._tall[number]))
            words += [1.15 * extent(line, size) for line in label.get_text().split("\n")]
            above = [each for each in (*_titles(axes)[:1], *_above(axes)) if each.get_text()]
            lines = ((float(each.get_fontsize()), each.get_text().count("\n") + 1) for each in above)
            titles.append(sum(1.25 * size / 72 * count for size, count in lines))
            left.append(self._left.get(axes, 0.0))
        return max(words) + max(titles) + max(left)

    def check(self) -> None:
        """Reject a figure that is too small for the drawing.

        There is no check for a figure of the caller without a layout engine: the caller may arrange it later.

        Raises
        ------
        InvalidArgument
            If a text is cut off or overlaps another text, or axes have no room.
        """
        if self.figure.get_layout_engine() is None and not self.new:
            return
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings about a layout without room, reported below
            try:
                for _ in range(2):  # new sizes change the ticks, which change the sizes again
                    self.figure.draw_without_rendering()
                    why = crowded(self.figure, self._given or self.parent.axes)
                    if not why:
                        return
            except (ValueError, OverflowError) as error:
                raise InvalidArgument(f"the figure cannot be drawn: {error}") from None
        size, larger = f"width is {self.width:g} in", "wider"
        if not self.new:
            wide, high = (_inches(self.parent, side) for side in self.parent.bbox.size)
            size, larger = f"ax is of a figure of {wide:.3g} by {high:.3g} in", "larger"
        raise InvalidArgument(
            f"{size}, in which {why}: expected a {larger} figure, or smaller letters, "
            f"now rcParams['font.size'] = {rcParams['font.size']:g}"
        )


def _points(name: Literal["figure.titlesize", "legend.fontsize"]) -> float:
    """Return a font size of rcParams [pt]."""
    return float(FontProperties(size=rcParams[name]).get_size_in_points())


def _has_size() -> bool:
    """Return whether the user has changed the default figure size."""
    return tuple(rcParams["figure.figsize"]) != tuple(rcParamsDefault["figure.figsize"])


def _width(width: float | None, natural: float) -> float:
    if width is None:
        return float(rcParams["figure.figsize"][0]) if _has_size() else natural * letters() / 10
    return bounded("width", scalar("width", width), least=_NARROWEST, most=_WIDEST, unit="in")


def _figure(width: float, known: bool) -> Figure:
    """Return a new figure, registered with pyplot if pyplot has windows."""
    pyplot = sys.modules.get("matplotlib.pyplot")
    options: dict[str, Any] = {"figsize": (width, width), "layout": "constrained"}
    if not known or pyplot is None or get_backend().lower() in _NO_WINDOWS:
        return ShownFigure(**options)
    made: Figure = pyplot.figure(FigureClass=ShownFigure, **options)
    return made


def _axes_of(ax: object) -> list[Axes]:
    given = list(np.ravel(np.asarray(ax, object)))
    if not given or not all(isinstance(each, Axes) for each in given):
        raise InvalidArgument(
            f"ax is {format_value(ax)}, expected matplotlib's Axes, a sequence of them, or a Figure"
        )
    return given


def _inches(figure: Figure | SubFigure, pixels: float) -> float:
    return pixels / float(figure.figure.dpi)


def _first(place: int | slice) -> int:
    return (place.start or 0) if isinstance(place, slice) else place


def _titles(axes: Axes) -> list[Text]:
    """Return the titles of axes, the longest text first."""
    found = [each for each in axes.get_children() if isinstance(each, Text) and each not in axes.texts]
    return sorted(found, key=lambda each: -each.get_text().count("\n") - bool(each.get_text()))


def _above(axes: Axes) -> list[Text]:
    """Return the notes above axes."""
    found = ((each, getattr(each, "xycoords", None)) for each in axes.texts)
    return [each for each, where in found if where == _ABOVE or isinstance(where, tuple)]


def _words(figure: Figure) -> Iterator[tuple[str, Bbox, Axes | None, bool]]:
    """Yield text, bounding box [px], axes, and whether overlap is allowed, for all visible texts."""
    parts = [figure, *figure.findobj(SubFigure)]
    found: list[tuple[Axes | None, Text]] = []
    for part in parts:
        found += [(None, text) for text in part.texts]
        found += [(None, text) for legend in part.legends for text in legend.get_texts()]
    for axes in figure.axes:
        found += [(axes, text) for text in (*_titles(axes), *axes.texts)]
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
            labels = axis.label, axis.get_offset_text(), *(each for each in ticks if each.get_visible())
            found += [(axes, text) for text in labels]
    noted = {each for axes in figure.axes for each in axes.texts if each not in _above(axes)}
    for whose, each in found:
        if each.get_text() and each.get_visible():
            yield plain(each.get_text()), each.get_window_extent(), whose, each in noted


def crowded(figure: Figure, own: Sequence[Axes]) -> str:
    """Return why these axes of a drawn figure are not readable, or "".

    Texts of the figure and of other axes count if they overlap texts of these axes.
    """
    room = _ROOM * figure.dpi / 72
    least = _LEAST * figure.dpi
    drawn = [axes.bbox for axes in own if axes.get_label() != "<colorbar>"]
    if any(min(box.width, box.height) < least for box in drawn):
        return "its axes have no room"
    whole = figure.bbox.padded(room)
    known = list(_words(figure))
    for words, box, whose, _ in known:
        inside = whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 and box.y1 <= whole.y1
        if not inside and (whose is None or whose in own):
            return f"{format_value(words)} would be cut off"
    pairs = combinations([(one, box, whose) for one, box, whose, noted in known if not noted], 2)
    for (words, box, whose), (others, other, theirs) in pairs:
        is_own = {whose, theirs} & {None, *own}
        if is_own and box.padded(-room).overlaps(other.padded(-room)):
            return f"{format_value(words)} would overlap {format_value(others)}"
    return ""


def plain(words: str) -> str:
    r"""Return text without formula markup, such as ``3.7·10^-6`` for ``$3.7\cdot 10^{-6}$``."""
    words = words.replace(r"\cdot ", "·").replace(r"\times", "\N{MULTIPLICATION SIGN}")
    return " ".join(re.sub(r"(?<!\\)\$|\\mathdefault|[\\{}]", "", words).split())


Style: TypeAlias = dict[str, Any]
"""Style: keyword arguments of matplotlib artists."""

DASHES = ("-", (0, (6, 2)), (0, (6, 2, 1.5, 2)), (0, (2.5, 1.5)), (0, (1, 1)), (0, (4, 1, 1, 1, 1, 1)))
_ROUNDING = 1e-12  # in SI units
_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


def line_style(index: int, count: int) -> Style:
    """Return the style of the line of rollout `index` of `count`.

    Dashes distinguish lines in grey. The first line is the widest, so that all lines show where they
    coincide. A cycle of styles that the user has set in ``rcParams["axes.prop_cycle"]`` has precedence.
    """
    share = (count - 1 - index) / max(count - 1, 1)
    width = float(rcParams["lines.linewidth"]) * (1.15 + 1.2 * share)
    style: Style = {"color": colour(index), "linestyle": DASHES[index % len(DASHES)], "linewidth": width}
    cycle = _cycle()
    own = cycle[index % len(cycle)] if cycle else {}
    return {**style, "zorder": 3, **own} | ({"markevery": 0.12} if "marker" in own else {})


def colour(index: int) -> str:
    """Return the colour of a rollout by its index, from the user's cycle if there is one."""
    cycle = _cycle()
    own = str(cycle[index % len(cycle)].get("color", "")) if cycle else ""
    return to_hex(own).upper() if own else palette.colour(index)


def _cycle() -> list[Style]:
    """Return the user's cycle of styles; empty for the default cycle of matplotlib."""
    cycle = rcParams["axes.prop_cycle"]
    return [] if cycle == rcParamsDefault["axes.prop_cycle"] else [dict(each) for each in cycle]


def ink() -> str:
    """Return the colour of text and references, from the user's settings if changed."""
    own = rcParams["text.color"]
    return INK if own == rcParamsDefault["text.color"] else to_hex(own)


def desired() -> Style:
    """Return the style of the line of a reference."""
    thin = 0.8 * float(rcParams["lines.linewidth"])
    return {"color": ink(), "linestyle": (0, (5, 4)), "linewidth": thin, "zorder": 4}


def keys_of(runs: Mapping[str, object], alone: str = "") -> list[Line2D]:
    """Return legend entries for lines in `line_style`; a single line has the label `alone`, or no entry."""
    if len(runs) == 1 and not alone:
        return []
    styles = (line_style(index, len(runs)) for index in range(len(runs)))
    return [Line2D([], [], label=label or alone, **style) for label, style in zip(runs, styles, strict=True)]


def shortened(sheet: Sheet, label: str) -> str:
    """Return a label in lines that fit above a panel, in the font of `heading`."""
    return wrapped(label, letters(1.2), sheet.room(), weight="bold")


def tint(base: str, share: float) -> tuple[float, float, float]:
    """Return a mixture of a colour (`share`, from 0 to 1) and the background of axes."""
    pairs = zip(to_rgb(rcParams["axes.facecolor"]), to_rgb(base), strict=True)
    r, g, b = (ground - share * (ground - part) for ground, part in pairs)
    return r, g, b


def dress(axes: Axes) -> None:
    """Set a subtle frame and grid of axes."""
    axes.grid(True, color=rcParams["grid.color"], alpha=0.35, linewidth=rcParams["grid.linewidth"])
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#888888")
    axes.tick_params(color="#888888")


def dress_time(axes: Axes) -> None:
    """Set a subtle frame, a grid and margins of axes over time."""
    dress(axes)
    axes.margins(x=0.01, y=0.1)


def heading(index: int) -> Style:
    """Return the style of the label of rollout `index` above its axes, for an offset in points."""
    place: Style = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "bottom"}
    return place | {"fontsize": letters(1.2), "fontweight": "bold", "color": colour(index)}


def percent(share: float) -> str:
    """Return a share as text, such as ``99.9 %``."""
    return f"{100 * share:.6g} %"


def si(value: float, unit: str) -> str:
    """Return a number with two digits and a suitable prefix of the unit, such as ``7.5 mm``."""
    if value < 1e-10:
        zero = f"0 {unit}{', within rounding' if value else ''}"
        return f"{value:.1e} {unit}" if value > _ROUNDING else zero
    rounded = float(f"{value:.1e}")
    scale, prefix = next((pair for pair in _PREFIXES if rounded >= pair[0]), _PREFIXES[-1])
    return f"{rounded / scale:.{1 if rounded < 9.95 * scale else 0}f} {prefix}{unit}"


Rollouts: TypeAlias = Rollout | Mapping[str, Rollout]

_Kind = TypeVar("_Kind")

_MOST = 4000  # largest number of samples without thinning
_BINS = 1000  # stretches of a longer rollout


def labelled(rollouts: object) -> dict[str, Rollout]:
    """Return the rollouts by label; a single rollout has the label "".

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts to draw.

    Raises
    ------
    InvalidArgument
        If the argument is not a rollout or a mapping, or is empty.
    """
    return label_items("rollouts", rollouts, Rollout)


def called(label: str) -> str:
    """Return the name of one of `labelled` rollouts in messages."""
    return f"rollouts[{label!r}]" if label else "rollouts"


def of_each(runs: Mapping[str, Rollout], ask: Callable[[Rollout], _Kind]) -> dict[str, _Kind]:
    """Return the results of a function `ask` for `labelled` rollouts, by label.

    Raises
    ------
    InvalidArgument
        If `ask` raises it; the message names the rollout.
    """
    found = {}
    for label, run in runs.items():
        try:
            found[label] = ask(run)
        except InvalidArgument as error:
            raise InvalidArgument(f"{called(label)}.{error}") from None
    return found


def with_plants(rollouts: object, kind: type, expected: str) -> dict[str, Rollout]:
    """Return `labelled` rollouts after a check of their plants; `expected` describes the capability."""
    runs = {label: at_samples(run) for label, run in labelled(rollouts).items()}
    for label, run in runs.items():
        if able(run.plant, kind) is None:
            raise InvalidArgument(f"{called(label)}.plant is {format_value(run.plant)}, expected {expected}")
    return runs


def same_references(runs: Mapping[str, Rollout]) -> dict[bytes, list[str]]:
    """Return the labels of the rollouts in groups with the same reference and times."""
    groups: dict[bytes, list[str]] = {}
    for label, run in runs.items():
        groups.setdefault(run.t.tobytes() + run.reference.q.tobytes(), []).append(label)
    return groups


def thinned(*columns: Array) -> NDArray[np.intp]:
    """Return the indices of the samples that a line needs, in order.

    A short rollout keeps all samples. A long rollout keeps the first and the last sample and, in each of 1000
    stretches, the samples with the smallest and the largest value of each column, so that peaks remain.

    Parameters
    ----------
    *columns : ndarray, shape (N,)
        Values of the line; for a curve in the plane, both coordinates.
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
    """Draw a line over time, with gaps at values that are not finite; draw a single sample as a dot."""
    finite = np.where(np.isfinite(values), values, np.nan)
    kept = thinned(np.nan_to_num(finite))
    axes.plot(t[kept], finite[kept], **{"marker": "o" if len(t) == 1 else ""} | style)


def shade(panels: Iterable[Axes], t: Array, chosen: NDArray[np.bool_], **style: Any) -> None:
    """Shade the time steps of the chosen samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    for start, stop in edges.reshape(-1, 2):
        for axes in panels:
            axes.axvspan(t[start], t[min(stop, len(t) - 1)], linewidth=0, **style)
