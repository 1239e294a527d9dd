"""A strip at the top of axes for what has no size: no number stands in it, a word does."""

from typing import Any

from matplotlib.axes import Axes

__all__ = ["strip_above"]

_SHARE = 0.11  # of the height of the axes below it
_GREY = "#f1f1f1"


def strip_above(axes: Axes, word: str, *, numbers: bool = True) -> float:
    """Add a strip above all that the axes show, and return the height of its middle, where marks go.

    The ticks stay where they are, as they are; the word stands beside the strip as one more.

    Parameters
    ----------
    axes : Axes
        Whose limits of y hold all that has a size, linear or logarithmic.
    word : str
        What marks in the strip mean.
    numbers : bool
        Whether anything has a size: otherwise the strip is all there is.
    """
    if not numbers:
        axes.set_ylim(0.0, 1.0)
        axes.axhspan(0.0, 1.0, color=_GREY, linewidth=0, zorder=0)
        axes.set_yticks([0.5], [word])
        return 0.5
    low, high = axes.get_ylim()
    up = axes.transScale.transform  # to where heights are even
    down = axes.transScale.inverted().transform
    bottom, top = (float(up((1.0, y))[1]) for y in (low, high))
    middle, end = (float(down((1.0, top + share * (top - bottom)))[1]) for share in (_SHARE / 2, _SHARE))
    axis = axes.yaxis
    large, small = (
        [y for y in ticks if low <= y <= high]
        for ticks in (axis.get_majorticklocs(), axis.get_minorticklocs())
    )
    labels, factor = axis.get_major_formatter().format_ticks(large), axis.get_major_formatter().get_offset()
    axes.axhspan(high, end, color=_GREY, linewidth=0, zorder=0)
    axes.set_yticks([*large, middle], [*labels, word])
    fixed: Any = axis.get_major_formatter()
    fixed.set_offset_string(factor)  # the power of ten above the axis
    axes.set_yticks(small, ["" for _ in small], minor=True)
    axes.set_ylim(low, end)
    return middle
