"""How figures look: colours that the colour-blind tell apart, line styles, legends outside the axes."""

from collections.abc import Sequence
from io import BytesIO
from typing import Any, Literal

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from pinmobile.arrays import text
from pinmobile.palette import INK, colour

__all__ = [
    "DESIRED",
    "ShownFigure",
    "dress",
    "headed",
    "heading",
    "legend",
    "line_style",
    "percent",
    "si",
    "tint",
]

DESIRED: dict[str, Any] = {"color": INK, "linestyle": (0, (5, 4)), "linewidth": 1.2, "zorder": 4}

_DASHES = ("-", "-", (0, (8, 2)), (0, (5, 2, 1.5, 2)), (0, (1.5, 1.5)))
_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


class ShownFigure(Figure):
    """A figure that a notebook shows although pyplot was never imported."""

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def headed(title: Any, default: str) -> str:
    """Return the heading of a figure.

    Raises
    ------
    InvalidArgument
        If it is no text.
    """
    return default if title is None or (isinstance(title, str) and not title) else text("title", title)


def line_style(index: int, count: int) -> dict[str, Any]:
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


def heading(index: int) -> dict[str, Any]:
    """Return how the label of rollout `index` is written above its axes, by an offset in points."""
    return {
        "xycoords": "axes fraction",
        "textcoords": "offset points",
        "fontsize": 13,
        "fontweight": "bold",
        "color": colour(index),
    }


def legend(figure: Figure, handles: Sequence[Artist]) -> None:
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
