"""Where an end effector went, where it should have gone, and how far off it was."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D

from pinmobile.arrays import Array, positive
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plots.style import (
    DESIRED,
    Rollouts,
    ShownFigure,
    dress,
    headed,
    labelled,
    legend,
    line_style,
    thinned,
)
from pinmobile.simulation import EndEffector, Rollout

_Figure: TypeAlias = Figure | SubFigure
_Canvas: TypeAlias = Sequence[Axes] | _Figure

_NATURAL, _NARROW = 9.0, 5.5  # [in]: a figure's width, and that below which panels stand on one another
_WIDE, _TALL = 4.6, 7.2  # [in]: heights of either
_NO_TARGET = "there is no target"
_PLACES = (("x [m]", "y [m]"), ("", "z [m]"), ("", "distance [m]"), ("t [s]", "angle [rad]"))
"""Words beside the axes of path, height, distance and angle."""


def end_effector(
    rollouts: Rollouts,
    *,
    frame: str | None = None,
    title: str | None = None,
    ax: _Canvas | None = None,
    width: float | None = None,
) -> Figure:
    """Draw an end effector's path from above, its height, and its pose's error: distance and angle.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    frame : str, optional
        As in `Rollout.end_effector`.
    title : str, optional
        Heading of the figure.
    ax : sequence of 4 Axes, Figure or SubFigure, optional
        Where to draw path, height, distance and angle; by default in a new figure.
    width : float, optional
        Of a new figure [in]; below 5.5 its panels stand on one another.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts`, `ax` or `width` is something else, or a plant does not tell where its frames are.
    UnknownName
        If there is no such frame; it says which there are.
    """
    hands = _hands(labelled(rollouts), frame)
    parent, panels = _panels(ax, width)
    above, height, way, turn = panels
    for index, (label, hand) in enumerate(hands.items()):
        style = line_style(index, len(hands)) | {"label": label or "travelled"}
        _line(above, *hand.position[:, :2].T, **style)
        _line(height, hand.t, hand.position[:, 2], **style)
        if hand.target is not None:
            _line(way, hand.t, hand.distance, **style)
            if hand.is_oriented:
                _line(turn, hand.t, hand.angle, **style)
    for t, target in _targets(hands.values()):
        _line(above, *target[:, :2, 3].T, **DESIRED)
        _line(height, t, target[:, 2, 3], **DESIRED)
    for axes in (way, turn):
        axes.set_ylim(bottom=0.0)
        if not axes.lines:
            axes.text(0.5, 0.5, _NO_TARGET, ha="center", va="center", transform=axes.transAxes)
    if parent is None:
        if title:
            above.set_title(headed(title, ""))
        return above.figure.figure  # of a part of a figure it is the whole
    names = dict.fromkeys(hand.frame for hand in hands.values())
    parent.suptitle(headed(title, f"End effector {', '.join(names)}"))
    keys = [Line2D([], [], label="target", **DESIRED)] if way.lines else []
    travelled = [
        Line2D([], [], label=label or "travelled", **line_style(k, len(hands)))
        for k, label in enumerate(hands)
    ]
    legend(parent, [*keys, *travelled])
    return parent.figure


def _hands(runs: Mapping[str, Rollout], frame: str | None) -> dict[str, EndEffector]:
    hands = {}
    for label, run in runs.items():
        try:
            hands[label] = run.end_effector(frame)
        except InvalidArgument as error:
            name = f"rollouts[{label!r}]" if label else "rollouts"
            raise InvalidArgument(f"{name}.{error}") from None
    return hands


def _targets(hands: Iterable[EndEffector]) -> list[tuple[Array, Array]]:
    """Return the targets that differ, with their times."""
    found: dict[bytes, tuple[Array, Array]] = {}
    for hand in hands:
        if hand.target is not None:
            found.setdefault(hand.t.tobytes() + hand.target.tobytes(), (hand.t, hand.target))
    return list(found.values())


def _panels(ax: _Canvas | None, width: float | None) -> tuple[_Figure | None, list[Axes]]:
    """Return the figure that a heading and a legend belong to, if any, and the four axes.

    Raises
    ------
    InvalidArgument
        If `ax` is something else, or comes with a width.
    """
    if ax is not None and width is not None:
        raise InvalidArgument(f"width is {shown(width)}, with ax, whose figure has a width: leave one out")
    wide = _NATURAL if width is None else positive("width", width, "in")
    if ax is None:
        size = wide, _TALL if wide < _NARROW else _WIDE
        ax = ShownFigure(figsize=size, layout="constrained")
    if isinstance(ax, Figure | SubFigure):
        if isinstance(ax, Figure) and ax.get_layout_engine() is None:
            ax.set_layout_engine("constrained")
        inches = ax.bbox.width / ax.figure.dpi
        return ax, _filled(ax, stands=inches < _NARROW)
    given = list(np.ravel(np.asarray(ax, object)))
    if len(given) != len(_PLACES) or not all(isinstance(each, Axes) for each in given):
        raise InvalidArgument(
            f"ax is {shown(ax)}, expected {len(_PLACES)} Axes, for path, height, distance and angle, or a "
            "figure to be filled"
        )
    _dressed(given)
    return None, given


def _filled(figure: _Figure, *, stands: bool) -> list[Axes]:
    """Return new axes in a figure: on one another, or the path beside what goes over time."""
    if stands:
        grid = figure.add_gridspec(4, 1, height_ratios=(2.6, 1, 1, 1))
        spots = [grid[k, 0] for k in range(4)]
    else:
        grid = figure.add_gridspec(3, 2, width_ratios=(1.2, 1))
        spots = [grid[:, 0], *(grid[k, 1] for k in range(3))]
    above, height = figure.add_subplot(spots[0]), figure.add_subplot(spots[1])
    later = [figure.add_subplot(spot, sharex=height) for spot in spots[2:]]
    for axes in (height, later[0]):
        axes.tick_params(labelbottom=False)
    found = [above, height, *later]
    _dressed(found)
    return found


def _dressed(panels: Sequence[Axes]) -> None:
    for axes, (x, y) in zip(panels, _PLACES, strict=True):
        dress(axes)
        axes.set(xlabel=x, ylabel=y)
        axes.margins(x=0.01, y=0.1)
        axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
    panels[0].set_aspect("equal", adjustable="datalim")
    panels[0].margins(0.1)


def _line(axes: Axes, x: Array, y: Array, **style: Any) -> None:
    kept = thinned(x, y)
    axes.plot(x[kept], y[kept], **style)
