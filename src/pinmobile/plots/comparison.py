"""Figures that compare poses with desired or predicted ones."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pinmobile.arrays import Array, instance
from pinmobile.identification import Prediction
from pinmobile.plots.figure_layout import Canvas, Sheet, Spot
from pinmobile.plots.style import (
    Rollouts,
    Style,
    colour,
    curve,
    desired,
    dress,
    ink,
    keys_of,
    labelled,
    line_style,
    of_each,
    tint,
)

_WIDE, _TALL = (1.4, 1.4, 1.4), (2.8, 1.2, 1.2, 1.2)  # [in]: heights of rows
_NO_TARGET, _NO_ORIENTATION = "there is no target", "the target has no orientation"
_PLACES = (("x [m]", "y [m]"), ("", "z [m]"), ("", "distance [m]"), ("t [s]", "angle [rad]"))
"""Words beside the axes of path, height, distance and angle."""
_LETTERS = {"psi": "$\\psi$"}
_MEASURED: Style = {"color": "#9a9a9a", "linewidth": 3.2, "solid_capstyle": "round"}
_DEVIATIONS = 2.0  # of the noise, within which 95 of 100 differences lie
_POINTS = 4000  # points of a line


def end_effector(
    rollouts: Rollouts,
    *,
    frame: str | None = None,
    title: str | None = None,
    ax: Canvas | None = None,
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
    ax, width
        As in `states`; axes are those of path, height, distance and angle.

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
    hands = of_each(labelled(rollouts), lambda run: run.end_effector(frame))
    sheet = Sheet(ax, width, 9.0)
    above, height, way, turn = _panels(sheet)
    for index, (label, hand) in enumerate(hands.items()):
        style = line_style(index, len(hands)) | {"label": label or "travelled"}
        curve(above, *hand.position[:, :2].T, **style)
        curve(height, hand.t, hand.position[:, 2], **style)
        if hand.target is not None:
            curve(way, hand.t, hand.distance, **style)
            if hand.is_oriented:
                curve(turn, hand.t, hand.angle, **style)
    aimed = [(hand.t, hand.target) for hand in hands.values() if hand.target is not None]
    for t, target in {t.tobytes() + target.tobytes(): (t, target) for t, target in aimed}.values():
        curve(above, *target[:, :2, 3].T, **desired())
        curve(height, t, target[:, 2, 3], **desired())
    for axes, none in ((way, _NO_TARGET), (turn, _NO_ORIENTATION if way.lines else _NO_TARGET)):
        axes.set_ylim(bottom=0.0)
        if not axes.lines:
            axes.text(0.5, 0.5, none, ha="center", va="center", transform=axes.transAxes)
    names = ", ".join(dict.fromkeys(hand.frame for hand in hands.values()))
    keys = [Line2D([], [], label="target", **desired())] if way.lines else []
    return sheet.finish(title, f"End effector {names}", [*keys, *keys_of(hands, "travelled")])


def _panels(sheet: Sheet) -> list[Axes]:
    """Return axes on one another, or the path beside what goes over time."""
    if sheet.columns(2, 3.2) == 1:
        spots: list[Spot] = [(k, 0) for k in range(4)]
        above, *later = sheet.axes(spots, _TALL, share="")
    else:
        spots = [(slice(None), 0), (0, 1), (1, 1), (2, 1)]
        above, *later = sheet.axes(spots, _WIDE, ratios=(1.2, 1))
    panels = [above, *later]
    for axes, (x, y) in zip(panels, _PLACES, strict=True):
        dress(axes)
        axes.set(xlabel=x, ylabel=y)
        axes.margins(x=0.01, y=0.1)
        axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
    above.set_aspect("equal", adjustable="datalim")
    above.margins(0.1)
    return panels


def prediction(
    foretold: Prediction, *, title: str | None = None, ax: Canvas | None = None, width: float | None = None
) -> Figure:
    """Draw what was measured and what was foretold, and their difference beside the sensor's noise.

    Each segment of the prediction starts anew; the band is what 95 of 100 differences would lie within if the
    sensor's noise were all that is left.

    Parameters
    ----------
    foretold : Prediction
        What `Identification.predict` returned.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`; axes are, of x, y and psi or of speed and yaw rate each, that of the values, then that
        of the differences.

    Returns
    -------
    figure : matplotlib.figure.Figure
        The new one, or that of the first axes.

    Raises
    ------
    InvalidArgument
        If it is no prediction, or `ax` or `width` is something else.
    """
    instance("foretold", foretold, Prediction, "what predict() of an identification returns")
    sheet = Sheet(ax, width, 10.0)
    rows = len(foretold.names)
    grid = sheet.grid(rows, 2, (1.7,) * rows)
    t = _broken(foretold.t)
    kept = np.arange(0, t.size, max(1, t.size // _POINTS))
    for axes in grid.ravel():
        dress(axes)
    for k, (name, unit) in enumerate(zip(foretold.names, foretold.units, strict=True)):
        (values, differences), small = grid[k], f"m{unit}"
        measured, predicted = foretold.measured[..., k], foretold.predicted[..., k]
        values.plot(t[kept], _broken(measured)[kept], **_MEASURED)
        values.plot(t[kept], _broken(predicted)[kept], color=colour(0), linewidth=1.4)
        values.set_ylabel(f"{_LETTERS.get(name, name)} [{unit}]")
        noise = 1e3 * foretold.noise[k]
        band = _DEVIATIONS * noise
        differences.axhspan(-band, band, color=tint(ink(), 0.12), linewidth=0)
        left = 1e3 * _broken(measured - predicted)
        differences.plot(t[kept], left[kept], color=colour(0), linewidth=0.7)
        differences.set_ylabel(f"difference [{small}]")
        told = f"rms {1e3 * foretold.rms[k]:.2g} {small}, noise {noise:.2g} {small}"
        sheet.write_above(differences, told, 0.95, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel("t [s]")
    keys = [
        Line2D([], [], label="measured", **_MEASURED),
        Line2D([], [], label="foretold", color=colour(0), linewidth=1.4),
        Patch(color=tint(ink(), 0.12), label="noise of the sensor, 95 %"),
    ]
    span = float(foretold.t[0, -1] - foretold.t[0, 0])
    return sheet.finish(title, f"Measured and foretold, {span:.3g} s ahead", keys)


def _broken(segments: Array) -> Array:
    """Return segments as one line that is broken between them, shape (S (L + 1),)."""
    gap = np.full((len(segments), 1), np.nan)
    return np.asarray(np.concatenate([segments, gap], axis=1).ravel())
