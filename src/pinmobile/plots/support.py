"""What the base feels: balance on the ground, and the arm's reaction."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike
from pinmobile.balance import (
    body_zero_moment_point,
    footprint_of,
    reaction_wrench,
    required_friction,
    tip_over_margin,
)
from pinmobile.errors import InvalidArgument, shown
from pinmobile.palette import INK, colour
from pinmobile.plots.series import draw
from pinmobile.plots.style import (
    Rollouts,
    ShownFigure,
    dress,
    headed,
    labelled,
    legend,
    line_style,
    stacked,
    thinned,
)
from pinmobile.simulation import Rollout

_WRENCH = (
    ("$f_x$", "N"),
    ("$f_y$", "N"),
    ("$f_z$", "N"),
    ("$m_x$", "N m"),
    ("$m_y$", "N m"),
    ("$m_z$", "N m"),
)
_OUTLINE: dict[str, Any] = {
    "closed": True,
    "facecolor": "#f2f2f2",
    "edgecolor": "#777777",
    "linewidth": 1.4,
    "zorder": 1,
}
_LIMIT: dict[str, Any] = {"color": "#777777", "linestyle": (0, (4, 3)), "linewidth": 1.2, "zorder": 2}


def balance(rollouts: Rollouts, *, footprint: ArrayLike | None = None, title: str | None = None) -> Figure:
    """Draw tip-over margin and required friction over time, and the zero-moment point on the footprint.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    footprint : array_like, shape (k, 2), optional
        As in `tip_over_margin`; by default each robot's own.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, not of a `MobileRobot`, or `footprint` is no convex polygon.
    """
    runs = _of_robots(rollouts)
    figure = ShownFigure(figsize=(11.0, 5.2), dpi=100, layout="constrained")
    figure.suptitle(headed(title, "Balance on the ground"), fontsize=14, color=INK)
    (above, beside), (below, _) = grid = figure.subplots(2, 2, width_ratios=(1.25, 1))
    for axes in grid[:, 1]:
        axes.remove()
    beside = figure.add_subplot(grid[0, 0].get_gridspec()[:, 1])
    above.sharex(below)
    above.tick_params(labelbottom=False)
    for axes, name in ((above, "tip-over margin [m]"), (below, "required friction [-]")):
        dress(axes)
        axes.set_ylabel(name, fontsize=11)
    below.set_xlabel("t [s]", fontsize=11)
    for index, (label, run) in enumerate(runs.items()):
        style = line_style(index, len(runs)) | {"label": label}
        margin = tip_over_margin(run, footprint)
        _line(above, run.t, margin, **style)
        _line(below, run.t, required_friction(run), **style)
        _mark_lift_off((above, below), run.t, np.isneginf(margin), colour(index))
    span = [float(f([f(run.t) for run in runs.values()])) for f in (np.min, np.max)]
    if span[0] < span[1]:
        below.set_xlim(*span)
    if above.dataLim.y0 <= 0:
        above.axhline(0, **_LIMIT)
    below.set_ylim(bottom=min(0.0, below.get_ylim()[0]))
    _from_above(beside, runs, footprint)
    if len(runs) > 1:
        legend(figure, [line for line in above.lines if not str(line.get_label()).startswith("_")])
    return figure


def reaction(rollouts: Rollouts, *, mount: str | None = None, title: str | None = None) -> Figure:
    """Draw the force and the moment that an arm exerts on the base over time, along the body's axes.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    mount : str, optional
        As in `reaction_wrench`.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, or not of a `MobileRobot` with an arm.
    UnknownName
        If nothing is mounted by that name.
    """
    runs = _of_robots(rollouts)
    figure, grid = stacked(_WRENCH, 1, headed(title, "Force and moment of the arm on the base, at its mount"))
    for index, (label, run) in enumerate(runs.items()):
        style = line_style(index, len(runs))
        draw(grid[:, 0], run.t, reaction_wrench(run, mount), label=label, **style)
    if len(runs) > 1:
        legend(figure, grid[0, 0].lines)
    return figure


def _of_robots(rollouts: Any) -> dict[str, Rollout]:
    runs = labelled(rollouts)
    for label, run in runs.items():
        if not hasattr(run.plant, "ground_wrench"):
            name = f"rollouts[{label!r}]" if label else "rollouts"
            raise InvalidArgument(
                f"{name}.plant is {shown(run.plant)}, expected a MobileRobot, or a plant with "
                "ground_wrench(q, v, a)"
            )
    return runs


def _line(axes: Axes, t: Array, values: Array, **style: Any) -> None:
    """Draw what is finite; where the ground does not carry the robot, there is a gap."""
    finite = np.where(np.isfinite(values), values, np.nan)
    kept = thinned(np.nan_to_num(finite))
    axes.plot(t[kept], finite[kept], marker="o" if len(t) == 1 else "", **style)
    axes.margins(x=0.01, y=0.1)


def _mark_lift_off(panels: tuple[Axes, ...], t: Array, lifted: NDArray[np.bool_], ink: str) -> None:
    """Hatch the times at which the ground would have to pull, where there is nothing to draw."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lifted, [False]]).astype(int)))
    for start, stop in edges.reshape(-1, 2):
        for axes in panels:
            until = t[min(stop, len(t) - 1)]
            axes.axvspan(
                t[start], until, facecolor="none", edgecolor=ink, hatch="///", linewidth=0, alpha=0.5
            )
    if lifted.any():
        panels[0].set_title("hatched: the ground does not carry the robot", fontsize=10, color=INK)


def _from_above(axes: Axes, runs: dict[str, Rollout], footprint: ArrayLike | None) -> None:
    """Draw the footprint and the zero-moment point in the body's frame."""
    dress(axes)
    outlines = {
        corners.tobytes(): corners
        for corners in (footprint_of(run.plant, footprint) for run in runs.values())
    }
    for corners in outlines.values():
        axes.add_patch(Polygon(corners, label="footprint", **_OUTLINE))
    for index, run in enumerate(runs.values()):
        point = body_zero_moment_point(run)
        kept = thinned(*np.nan_to_num(point).T)
        style = line_style(index, len(runs))
        axes.plot(*point[kept].T, **style)
        carried = np.flatnonzero(np.isfinite(point[:, 0]))[:1]
        axes.plot(
            *point[carried].T, "o", color=colour(index), markersize=8, markeredgecolor="white", zorder=5
        )
    axes.autoscale_view()
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("forward $x_B$ [m]", fontsize=11)
    axes.set_ylabel("left $y_B$ [m]", fontsize=11)
    axes.set_title("zero-moment point in the footprint, dot: first", fontsize=10, color=INK)
