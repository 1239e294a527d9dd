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
from pinmobile.arrays import Array, absent, bounded, label_items, scalar, text
from pinmobile.errors import InvalidArgument, argument_errors, format_value, unexpected_value
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


_MIN_WIDTH, _MAX_WIDTH = 0.5, 100.0  # [in]
_MIN_SCALE, _MAX_SCALE = 0.62, 1.25  # smallest and largest scale of the heights of panels
_MIN_SIDE = 0.3  # [in], smallest side of readable axes
_OVERLAP_TOLERANCE = 1.0  # [pt], allowed overlap of texts: the boxes of texts have rims
_MAX_KEYS = 5  # largest number of entries in a row of a legend
_NOTES = "axes fraction"  # coordinates of notes above axes
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


def font_size(share: float = 1.0) -> float:
    """Return a font size [pt] as a multiple of ``rcParams["font.size"]``."""
    return share * float(rcParams["font.size"])


def title_offset(lines: int) -> float:
    """Return the height above axes over a title with a number of lines [pt]."""
    return float(rcParams["axes.titlepad"]) + font_size(1.4) * lines


def write_over_titles(axes: Axes, words: str, **style: Any) -> None:
    """Write a note above axes and their titles.

    Matplotlib raises titles that would overlap the power of ten above an axis.
    """
    offset = 0, font_size(0.45)
    axes.annotate(words, (0, 1), offset, **style | {"xycoords": (_NOTES, partial(_title_box, axes))})


def _title_box(axes: Axes, renderer: RendererBase) -> Bbox:
    """Return the bounding box of the titles of axes [px]."""
    return Bbox.union([title.get_window_extent(renderer) for title in _titles(axes)])


def check_title(title: str | None) -> str | None:
    """Return the checked title, which may be "" or None."""
    return title if title is None or (isinstance(title, str) and not title) else text("title", title)


def rounded_out(size: float, *, margin: bool = False) -> float:
    """Return a bound with two digits: an error is never rounded down, and a margin never up."""
    if not size or not np.isfinite(size):
        return size
    digit, way = 10.0 ** (np.floor(np.log10(abs(size))) - 1), -1.0 if margin else 1.0
    return float(way * digit * np.ceil(way * size / digit - 1e-9))


def text_width(line: str, size: float, **font: Any) -> float:
    """Return the length of a line of text of a font size [pt] in inches."""
    properties = FontProperties(family=rcParams["font.family"], size=size, **font)
    is_math = len(re.findall(r"(?<!\\)\$", line)) > 1
    try:
        width, _, _ = text_to_path.get_text_width_height_descent(line, properties, ismath=is_math)
    except ValueError:  # an invalid formula: matplotlib raises an error when it draws the formula
        return len(line) * size / 144
    return float(width) / 72


# Formulas, units in brackets, and numbers with their units stay on one line.
_WORD = re.compile(r"(?:\\\$|\$[^$]*\$|\[[^\]]{1,12}\]|(?<=\d) (?=(?:%|[mkµ]?m|m?rad|[NVAs])(?:\s|$))|\S)+")


def wrap_text(words: str, size: float, room: float, **font: Any) -> str:
    """Return text in lines no longer than `room` [in], except for longer words."""
    lines = []
    for line in words.split("\n"):
        current = ""
        for word in _WORD.findall(line):
            longer = f"{current} {word}".lstrip()
            if current and text_width(longer, size, **font) > room:
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
    register : bool
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
        register: bool = True,
    ) -> None:
        self._title = check_title(title)
        self.is_new = ax is None
        self._user_axes: list[Axes] = []
        self._has_fixed_size = self.is_new and (width is not None or _has_size())
        self._columns = 1
        self._heights: dict[int, float] = {}
        self._legend_heights: dict[Axes, float] = {}
        self._row_axes: list[tuple[int, Axes]] = []
        if ax is None:
            self.width = _check_width(width, natural)
            self.scale = float(np.clip(self.width / (natural * font_size() / 10), _MIN_SCALE, _MAX_SCALE))
            self.parent: Figure | SubFigure = _new_figure(self.width, register)
            return
        absent("with ax, because its figure has a width", width=width)
        self.scale = 1.0
        if isinstance(ax, Figure | SubFigure):
            self.parent, self.width = ax, _inches(ax, ax.bbox.width)
            if isinstance(ax, Figure) and ax.get_layout_engine() is None and not ax.axes:
                ax.set_layout_engine("constrained")
            return
        self._user_axes = _check_axes(ax)
        self.parent = self._user_axes[0].figure
        self.width = _inches(self.parent, self._user_axes[0].bbox.width)

    @property
    def figure(self) -> Figure:
        """Whole figure, the result of a plot."""
        return self.parent.figure

    def columns(self, limit: int, width: float) -> int:
        """Return the number of columns, each at least `width` inches wide at a font size of 10 points."""
        return limit if self._user_axes else int(np.clip(self.width / (width * font_size() / 10), 1, limit))

    def room(self, parts: int = 1) -> float:
        """Return the largest width of each of several texts side by side above a panel [in]."""
        if self._user_axes:
            return self.width
        return max(0.97 * self.width / (self._columns * parts) - 5.5 * font_size() / 72, 5 * font_size() / 72)

    def write_above(self, axes: Axes, words: str, share: float = 1.0, **style: Any) -> None:
        """Write text above axes in lines that fit, with a relative font size."""
        size = font_size(share)
        axes.set_title(wrap_text(words, size, self.room()), fontsize=size, **style)

    def axes(
        self, spots: Sequence[Spot], sizes: Sequence[float], *, share: str = "x", ratios: Sequence[float] = ()
    ) -> list[Axes]:
        """Return axes at spots of a grid: new axes, or the axes of the caller.

        Parameters
        ----------
        spots : sequence of tuple
            Row and column of each of the axes.
        sizes : sequence of float
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
        if self._user_axes:
            if len(self._user_axes) != len(spots):
                count = "one Axes" if len(self._user_axes) == 1 else f"{len(self._user_axes)} Axes"
                expected = f"{len(spots)}, one for each panel, or a figure to fill"
                raise InvalidArgument(f"ax is {count}, expected {expected}")
            return self._user_axes
        self._columns = len(ratios) or 1 + max(_start(column) for _, column in spots)
        self._heights = {k: max(self.scale * each, 5.5 * font_size() / 72) for k, each in enumerate(sizes)}
        grid = self.parent.add_gridspec(
            len(sizes), self._columns, height_ratios=list(self._heights.values()), width_ratios=ratios or None
        )
        panels: list[Axes] = []
        first: dict[str, Axes] = {}
        for row, column in spots:
            sharing = {f"share{axis}": first.get(f"{axis}{place}")
                       for axis, place in (("x", column), ("y", row)) if axis in share}  # fmt: skip
            panel = self.parent.add_subplot(grid[row, column], **sharing)
            first.setdefault(f"x{column}", panel)
            first.setdefault(f"y{row}", panel)
            if not isinstance(row, slice):
                self._row_axes.append((row, panel))
            panels.append(panel)
        for panel, (row, column) in zip(panels, spots, strict=True):
            inner = any(_start(other) > _start(row) for other, same in spots if same == column)
            panel.tick_params(labelbottom="x" not in share or not inner)
            panel.tick_params(labelleft="y" not in share or _start(column) == 0)
        return panels

    def grid(self, rows: int, columns: int, sizes: Sequence[float], *, share: str = "x") -> NDArray[Any]:
        """Return a full grid of axes, shape (rows, columns); see `axes`."""
        spots = [(row, column) for row in range(rows) for column in range(columns)]
        grid = np.empty(len(spots), object)
        grid[:] = self.axes(spots, sizes, share=share)
        return grid.reshape(rows, columns)

    def place_legend(self, axes: Axes) -> None:
        """Place the legend of axes between the axes and their title."""
        if self._user_axes:
            axes.legend(frameon=False)
            return
        size, (keys, labels) = font_size(0.9), axes.get_legend_handles_labels()
        key_width = max(text_width(label, size) for label in labels) + 4.3 * size / 72
        columns = int(np.clip(self.room() / key_width, 1, len(keys)))
        rows = -(-len(keys) // columns)
        axes.legend(
            keys, labels, ncols=-(-len(keys) // rows), loc="lower left", bbox_to_anchor=(-0.02, 1.0),
            fontsize=size, frameon=False, borderpad=0.2, columnspacing=1.2,
        )  # fmt: skip
        height = (1.5 * rows + 1.1) * size
        axes.set_title(axes.get_title(), fontsize=font_size(), pad=height)
        self._legend_heights[axes] = height / 72

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
        if self._user_axes:
            if self._title:
                self._user_axes[0].set_title(wrap_text(self._title, font_size(1.2), self.width))
            if keys:
                self._user_axes[0].legend(handles=list(keys), frameon=False)
            self.check()
            return self.figure
        size, lines = self._wrap_heading(default)
        heading = self.parent.suptitle(lines, fontsize=size) if lines else None
        if keys:
            place: Any = "lower center" if self.figure.get_layout_engine() is None else "outside lower center"
            self.parent.legend(
                handles=list(keys), loc=place, ncols=self._key_grid(keys)[1], frameon=False, columnspacing=1.5
            )
        if self.is_new:
            rows = sum(self._row_height(row) for row in self._heights)
            total = rows + self.heading_height(default) + self.legend_height(keys) + 4.0 * font_size() / 72
            self.figure.set_size_inches(self.width, height or total)
        if height and heading is not None:
            heading.set(y=1 - 0.5 * size / 72 / height, va="top")
        if self._has_fixed_size or not self.is_new:
            self.check()
        return self.figure

    def heading_height(self, default: str) -> float:
        """Return the height of the heading [in]."""
        size, lines = self._wrap_heading(default)
        return (1.3 * lines.count("\n") + 1.8) * size / 72 if lines else font_size(1.5) / 72

    def _wrap_heading(self, default: str) -> tuple[float, str]:
        size = _points("figure.titlesize")
        return size, wrap_text(default if self._title is None else self._title, size, 0.96 * self.width)

    def legend_height(self, keys: Sequence[Artist]) -> float:
        """Return the height of a legend [in]."""
        return (1.35 * self._key_grid(keys)[0] + 1.0) * _points("legend.fontsize") / 72 if keys else 0.0

    def _key_grid(self, keys: Sequence[Artist]) -> tuple[int, int]:
        """Return the numbers of rows and columns of a legend."""
        size = _points("legend.fontsize")
        key_width = max(text_width(str(key.get_label()), size) for key in keys) + 4.3 * size / 72
        rows = -(-len(keys) // int(np.clip(0.98 * self.width / key_width, 1, min(len(keys), _MAX_KEYS))))
        return rows, -(-len(keys) // rows)

    def _row_height(self, number: int) -> float:
        """Return the height of a row [in]: its minimum height, or more if its texts need more."""
        words, titles, legends = [self._heights[number]], [0.0], [0.0]
        for axes in (axes for row, axes in self._row_axes if row == number):
            label = axes.yaxis.label
            size = float(label.get_fontsize())
            label.set_text(wrap_text(label.get_text(), size, self._heights[number]))
            words += [1.15 * text_width(line, size) for line in label.get_text().split("\n")]
            texts = [each for each in (*_titles(axes)[:1], *_notes_above(axes)) if each.get_text()]
            lines = ((float(each.get_fontsize()), each.get_text().count("\n") + 1) for each in texts)
            titles.append(sum(1.25 * size / 72 * count for size, count in lines))
            legends.append(self._legend_heights.get(axes, 0.0))
        return max(words) + max(titles) + max(legends)

    def check(self) -> None:
        """Reject a figure that is too small for the drawing.

        There is no check for a figure of the caller without a layout engine: the caller may arrange it later.

        Raises
        ------
        InvalidArgument
            If a text is cut off or overlaps another text, or axes have no room.
        """
        if self.figure.get_layout_engine() is None and not self.is_new:
            return
        unable = argument_errors("the figure cannot be drawn: ", of=(ValueError, OverflowError))
        with warnings.catch_warnings(), unable:
            warnings.simplefilter("ignore")  # warnings about a layout without room, reported below
            for _ in range(2):  # new sizes change the ticks, which change the sizes again
                self.figure.draw_without_rendering()
                problem = layout_problem(self.figure, self._user_axes or self.parent.axes)
                if not problem:
                    return
        size, larger = f"width is {self.width:g} in", "wider"
        if not self.is_new:
            width, height = (_inches(self.parent, side) for side in self.parent.bbox.size)
            size, larger = f"ax is of a figure of {width:.3g} by {height:.3g} in", "larger"
        raise InvalidArgument(
            f"{size}, in which {problem}: expected a {larger} figure, or smaller letters, "
            f"now rcParams['font.size'] = {rcParams['font.size']:g}"
        )


def _points(name: Literal["figure.titlesize", "legend.fontsize"]) -> float:
    """Return a font size of rcParams [pt]."""
    return float(FontProperties(size=rcParams[name]).get_size_in_points())


def _has_size() -> bool:
    """Return whether the user has changed the default figure size."""
    return tuple(rcParams["figure.figsize"]) != tuple(rcParamsDefault["figure.figsize"])


def _check_width(width: float | None, natural: float) -> float:
    if width is None:
        return float(rcParams["figure.figsize"][0]) if _has_size() else natural * font_size() / 10
    return bounded("width", scalar("width", width), least=_MIN_WIDTH, most=_MAX_WIDTH, unit="in")


def _new_figure(width: float, register: bool) -> Figure:
    """Return a new figure, registered with pyplot if pyplot has windows."""
    pyplot = sys.modules.get("matplotlib.pyplot")
    options: dict[str, Any] = {"figsize": (width, width), "layout": "constrained"}
    if not register or pyplot is None or get_backend().lower() in _NO_WINDOWS:
        return ShownFigure(**options)
    figure: Figure = pyplot.figure(FigureClass=ShownFigure, **options)
    return figure


def _check_axes(ax: object) -> list[Axes]:
    given = list(np.ravel(np.asarray(ax, object)))
    if not given or not all(isinstance(each, Axes) for each in given):
        raise unexpected_value("ax", ax, "matplotlib's Axes, a sequence of them, or a Figure")
    return given


def _inches(figure: Figure | SubFigure, pixels: float) -> float:
    return pixels / float(figure.figure.dpi)


def _start(place: int | slice) -> int:
    return (place.start or 0) if isinstance(place, slice) else place


def _titles(axes: Axes) -> list[Text]:
    """Return the titles of axes, the longest text first."""
    texts = [each for each in axes.get_children() if isinstance(each, Text) and each not in axes.texts]
    return sorted(texts, key=lambda each: -each.get_text().count("\n") - bool(each.get_text()))


def _notes_above(axes: Axes) -> list[Text]:
    """Return the notes above axes."""
    pairs = ((each, getattr(each, "xycoords", None)) for each in axes.texts)
    return [each for each, system in pairs if system == _NOTES or isinstance(system, tuple)]


def _visible_texts(figure: Figure) -> Iterator[tuple[str, Bbox, Axes | None, bool]]:
    """Yield text, bounding box [px], axes, and whether overlap is allowed, for all visible texts."""
    parts = [figure, *figure.findobj(SubFigure)]
    texts: list[tuple[Axes | None, Text]] = []
    for part in parts:
        texts += [(None, text) for text in part.texts]
        texts += [(None, text) for legend in part.legends for text in legend.get_texts()]
    for axes in figure.axes:
        texts += [(axes, text) for text in (*_titles(axes), *axes.texts)]
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
            labels = axis.label, axis.get_offset_text(), *(each for each in ticks if each.get_visible())
            texts += [(axes, text) for text in labels]
    notes = {each for axes in figure.axes for each in axes.texts if each not in _notes_above(axes)}
    for owner, each in texts:
        if each.get_text() and each.get_visible():
            yield strip_markup(each.get_text()), each.get_window_extent(), owner, each in notes


def layout_problem(figure: Figure, panels: Sequence[Axes]) -> str:
    """Return why these axes of a drawn figure are not readable, or "".

    Texts of the figure and of other axes count if they overlap texts of these axes.
    """
    tolerance = _OVERLAP_TOLERANCE * figure.dpi / 72
    min_side = _MIN_SIDE * figure.dpi
    boxes = [axes.bbox for axes in panels if axes.get_label() != "<colorbar>"]
    if any(min(box.width, box.height) < min_side for box in boxes):
        return "its axes have no room"
    frame = figure.bbox.padded(tolerance)
    texts = list(_visible_texts(figure))
    for words, box, owner, _ in texts:
        is_inside = frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1
        if not is_inside and (owner is None or owner in panels):
            return f"{format_value(words)} would be cut off"
    pairs = combinations([(one, box, owner) for one, box, owner, is_note in texts if not is_note], 2)
    for (words, box, owner), (other_words, other, other_owner) in pairs:
        is_own = {owner, other_owner} & {None, *panels}
        if is_own and box.padded(-tolerance).overlaps(other.padded(-tolerance)):
            return f"{format_value(words)} would overlap {format_value(other_words)}"
    return ""


def strip_markup(words: str) -> str:
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
    custom = cycle[index % len(cycle)] if cycle else {}
    return {**style, "zorder": 3, **custom} | ({"markevery": 0.12} if "marker" in custom else {})


def colour(index: int) -> str:
    """Return the colour of a rollout by its index, from the user's cycle if there is one."""
    cycle = _cycle()
    custom = str(cycle[index % len(cycle)].get("color", "")) if cycle else ""
    return to_hex(custom).upper() if custom else palette.colour(index)


def _cycle() -> list[Style]:
    """Return the user's cycle of styles; empty for the default cycle of matplotlib."""
    cycle = rcParams["axes.prop_cycle"]
    return [] if cycle == rcParamsDefault["axes.prop_cycle"] else [dict(each) for each in cycle]


def ink() -> str:
    """Return the colour of text and references, from the user's settings if changed."""
    custom = rcParams["text.color"]
    return INK if custom == rcParamsDefault["text.color"] else to_hex(custom)


def reference_style() -> Style:
    """Return the style of the line of a reference."""
    width = 0.8 * float(rcParams["lines.linewidth"])
    return {"color": ink(), "linestyle": (0, (5, 4)), "linewidth": width, "zorder": 4}


def legend_entries(runs: Mapping[str, object], single: str = "") -> list[Line2D]:
    """Return legend entries for lines in `line_style`; a single line has the label `single` or no entry."""
    if len(runs) == 1 and not single:
        return []
    styles = (line_style(index, len(runs)) for index in range(len(runs)))
    return [Line2D([], [], label=label or single, **style) for label, style in zip(runs, styles, strict=True)]


def wrap_label(sheet: Sheet, label: str) -> str:
    """Return a label in lines that fit above a panel, in the font of `label_style`."""
    return wrap_text(label, font_size(1.2), sheet.room(), weight="bold")


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


def label_style(index: int) -> Style:
    """Return the style of the label of rollout `index` above its axes, for an offset in points."""
    position: Style = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "bottom"}
    return position | {"fontsize": font_size(1.2), "fontweight": "bold", "color": colour(index)}


def format_percent(share: float) -> str:
    """Return a share as text, such as ``99.9 %``."""
    return f"{100 * share:.6g} %"


def format_si(value: float, unit: str) -> str:
    """Return a number with two digits and a suitable prefix of the unit, such as ``7.5 mm``."""
    if value < 1e-10:
        zero = f"0 {unit}{', within rounding' if value else ''}"
        return f"{value:.1e} {unit}" if value > _ROUNDING else zero
    rounded = float(f"{value:.1e}")
    scale, prefix = next((pair for pair in _PREFIXES if rounded >= pair[0]), _PREFIXES[-1])
    return f"{rounded / scale:.{1 if rounded < 9.95 * scale else 0}f} {prefix}{unit}"


Rollouts: TypeAlias = Rollout | Mapping[str, Rollout]

_Kind = TypeVar("_Kind")

_MAX_SAMPLES = 4000  # largest number of samples without thinning
_STRETCHES = 1000  # stretches of a longer rollout


def label_rollouts(rollouts: object) -> dict[str, Rollout]:
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


def name_of(label: str) -> str:
    """Return the name of one of labelled rollouts in messages."""
    return f"rollouts[{label!r}]" if label else "rollouts"


def evaluate_each(runs: Mapping[str, Rollout], function: Callable[[Rollout], _Kind]) -> dict[str, _Kind]:
    """Return the results of a function for labelled rollouts, by label.

    Raises
    ------
    InvalidArgument
        If `function` raises it; the message names the rollout.
    """
    results = {}
    for label, run in runs.items():
        with argument_errors(f"{name_of(label)}."):
            results[label] = function(run)
    return results


def check_plants(rollouts: object, kind: type, expected: str) -> dict[str, Rollout]:
    """Return labelled rollouts after a check of their plants; `expected` describes the capability."""
    runs = {label: at_samples(run) for label, run in label_rollouts(rollouts).items()}
    for label, run in runs.items():
        if able(run.plant, kind) is None:
            raise unexpected_value(f"{name_of(label)}.plant", run.plant, expected)
    return runs


def reference_groups(runs: Mapping[str, Rollout]) -> dict[bytes, list[str]]:
    """Return the labels of the rollouts in groups with the same reference and times."""
    groups: dict[bytes, list[str]] = {}
    for label, run in runs.items():
        groups.setdefault(run.t.tobytes() + run.reference.q.tobytes(), []).append(label)
    return groups


def thin_samples(*columns: Array) -> NDArray[np.intp]:
    """Return the indices of the samples that a line needs, in order.

    A short rollout keeps all samples. A long rollout keeps the first and the last sample and, in each of 1000
    stretches, the samples with the smallest and the largest value of each column, so that peaks remain.

    Parameters
    ----------
    *columns : ndarray, shape (N,)
        Values of the line; for a curve in the plane, both coordinates.
    """
    count = len(columns[0])
    if count <= _MAX_SAMPLES:
        return np.arange(count)
    width = -(-count // _STRETCHES)
    stretches = -(-count // width)
    starts = width * np.arange(stretches)
    indices = [np.array([0, count - 1])]
    for column in columns:
        padded = np.pad(column, (0, width * stretches - count), mode="edge").reshape(stretches, width)
        indices += [starts + padded.argmin(axis=1), starts + padded.argmax(axis=1)]
    return np.unique(np.minimum(np.concatenate(indices), count - 1))


def draw_curve(axes: Axes, x: Array, y: Array, **style: Any) -> None:
    """Draw a curve in the plane."""
    samples = thin_samples(np.nan_to_num(x), np.nan_to_num(y))
    axes.plot(x[samples], y[samples], **style)


def draw_line(axes: Axes, t: Array, values: Array, **style: Any) -> None:
    """Draw a line over time, with gaps at values that are not finite; draw a single sample as a dot."""
    finite = np.where(np.isfinite(values), values, np.nan)
    samples = thin_samples(np.nan_to_num(finite))
    axes.plot(t[samples], finite[samples], **{"marker": "o" if len(t) == 1 else ""} | style)


def shade_steps(panels: Iterable[Axes], t: Array, mask: NDArray[np.bool_], **style: Any) -> None:
    """Shade the time steps of the chosen samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    for start, stop in edges.reshape(-1, 2):
        for axes in panels:
            axes.axvspan(t[start], t[min(stop, len(t) - 1)], linewidth=0, **style)
