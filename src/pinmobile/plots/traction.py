"""Ground and robot over time: torques, friction, slip and loads of wheels, odometry, and balance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike
from pinmobile.balance import body_zero_moment_point, footprint_of, required_friction, tip_over_margin
from pinmobile.errors import InvalidArgument
from pinmobile.loop import Rollout
from pinmobile.palette import INK, QUIET, SLIDES
from pinmobile.parts import Touching
from pinmobile.plant import Contacts, coordinates_of
from pinmobile.plots.figure_layout import Layout, Sheet, Spot, letters
from pinmobile.plots.series import GROUNDED
from pinmobile.plots.style import (
    Rollouts,
    Style,
    called,
    colour,
    curve,
    desired,
    dress,
    dress_time,
    keys_of,
    labelled,
    line,
    line_style,
    shade,
    with_plants,
)

_WHEELED = Touching, "a WheeledRobot, or a plant with contacts(q, v, a, u, signals)"
_WIDTH, _HEIGHT = 5.0, 2.2  # of axes [in]
_LIMIT: Style = {"color": INK, "linestyle": (0, (4, 3)), "linewidth": 1.2, "zorder": 2}
_SLIDES: Style = {"facecolor": SLIDES, "alpha": 0.15, "zorder": 1}
_ROUNDING = 1e-9  # what is smaller is drawn as the zero that it is


def wheel_torques(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw the inputs of a robot on wheels over time, those of its wheels and of what steers them.

    Arms' joints are in `forces`.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    **layout
        `title`, `ax` and `width`, as in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, or not of robots on wheels.
    """
    runs = with_plants(rollouts, *_WHEELED)
    units = {one.unit for run in runs.values() for one in _driven(run)}
    name = f"torque [{units.pop()}]" if len(units) == 1 else "input"
    sheet, grid = _axes(runs, [name], layout)
    for run, axes in zip(runs.values(), grid[0], strict=True):
        inputs = _driven(run)
        u = run.u[:, run.u.shape[1] - len(inputs) :]
        _lines(sheet, axes, run.t, u, [one.name for one in inputs], drawstyle="steps-post")
    return sheet.finish("Inputs of the wheels")


def friction(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw over time how much of its friction each wheel uses: the force in its friction circle, mu N wide.

    At 1 it slides; of rollers it is the force along their axes. Where rolling determines but the sum of some
    forces, a wheel's is its share of that sum.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    **layout
        `title`, `ax` and `width`, as in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, not of robots on wheels, or the loads of one cannot be told.
    """
    runs = with_plants(rollouts, *_WHEELED)
    found = {label: _contacts(run) for label, run in runs.items()}
    for label, contacts in found.items():
        if not np.isfinite(contacts.limits).any():
            raise InvalidArgument(
                f"{called(label)} is of a robot whose loads are not known, expected one that stands on "
                "three points and more: give supports=[(x, y), ...]"
            )
    sheet, grid = _axes(runs, ["force / $\\mu N$ [-]"], layout)
    for run, contacts, axes in zip(runs.values(), found.values(), grid[0], strict=True):
        known = zip(contacts.names, np.asarray(contacts.determined.all(axis=1)), strict=True)
        names = [name if sure else f"{name} (share)" for name, sure in known]
        _lines(sheet, axes, run.t, share_of_friction(contacts), names)
        axes.axhline(1.0, **_LIMIT)
        _note(axes, "slides", (1.0, 1.0), "right", ("axes fraction", "data"))
        shade([axes], run.t, np.asarray(contacts.slides.any(axis=1)), **_SLIDES)
        axes.set_ylim(0.0, max(1.12, axes.get_ylim()[1]))
    return sheet.finish("Share of friction used")


def slip(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw over time how fast each wheel slides over the ground, along it and across it.

    Of a wheel with rollers these directions are along its rollers' axes and across, in which they roll.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    **layout
        `title`, `ax` and `width`, as in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, or not of robots on wheels.
    """
    runs = with_plants(rollouts, *_WHEELED)
    rows = ["slip along [m/s]", "slip across [m/s]"]
    sheet, grid = _axes(runs, rows, layout)
    for run, column in zip(runs.values(), grid.T, strict=True):
        contacts = _contacts(run)
        for k, axes in enumerate(column):
            values = np.where(np.abs(contacts.slips[..., k]) < _ROUNDING, 0.0, contacts.slips[..., k])
            _lines(sheet if k == 0 else None, axes, run.t, values, contacts.names)
            shade([axes], run.t, np.asarray(contacts.slides.any(axis=1)), **_SLIDES)
            if not values.any():
                axes.set_ylim(-1.0, 1.0)
                _note(axes, "none", (0.5, 0.62))
    return sheet.finish("Slip velocities")


def loads(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw over time what each wheel carries.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    **layout
        `title`, `ax` and `width`, as in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, or not of robots on wheels.
    """
    runs = with_plants(rollouts, *_WHEELED)
    sheet, grid = _axes(runs, ["load [N]"], layout)
    for run, axes in zip(runs.values(), grid[0], strict=True):
        contacts = _contacts(run)
        _lines(sheet, axes, run.t, contacts.loads, contacts.names)
        if not np.isfinite(contacts.loads).any():
            _note(axes, "not known", (0.5, 0.5))
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    return sheet.finish("Loads of the wheels")


def odometry(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw the path that odometry believes beside the true one, and how far apart they are over time.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Runs with a controller `OdometryFeedback`; each gets a column.
    **layout
        `title`, `ax` and `width`, as in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, or one has not the signal ``believed_pose``.
    """
    runs = labelled(rollouts)
    for label, run in runs.items():
        if "believed_pose" not in run.signals:
            raise InvalidArgument(
                f"{called(label)} has no signal believed_pose, expected a run with "
                "OdometryFeedback(controller, table)"
            )
    names = ["y [m]", "odometry off by [m]"]
    sheet, grid = _axes(runs, names, layout, 1.7)
    for run, (above, below) in zip(runs.values(), grid.T, strict=True):
        true, believed = run.poses, run.signals["believed_pose"].values
        curve(above, *run.reference_poses[:, :2].T, label="desired", **desired())
        for k, (label, way) in enumerate((("true", true), ("believed", believed))):
            curve(above, *way[:, :2].T, label=label, **line_style(k, 2))
        above.set_aspect("equal", adjustable="datalim")
        above.set_xlabel("x [m]")
        above.legend(frameon=False, loc="best")
        off = np.hypot(*(believed - true)[:, :2].T)
        line(below, run.t, off, **line_style(0, 1) | {"color": colour(1)})
        below.set_ylim(bottom=0.0)
    return sheet.finish("Odometry beside the truth")


def share_of_friction(found: Contacts) -> Array:
    """Return force over friction of each contact, shape (n, k); not a number where it is not known.

    Of a wheel with rollers it is that along their axes: across them they roll.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = np.where(found.forces == 0, 0.0, found.forces / found.limits)
    rolls = found.limits[..., 0] != found.limits[..., 1]
    return np.asarray(np.where(rolls, np.abs(shares[..., 0]), np.hypot(shares[..., 0], shares[..., 1])))


def _contacts(run: Rollout) -> Contacts:
    plant: Any = run.plant
    found: Contacts = plant.contacts(run.q, run.v, run.a, run.u, run.signals)
    return found


def _driven(run: Rollout) -> Sequence[Any]:
    """Return the inputs behind those of the arms."""
    body: Any = getattr(run.plant, "robot", None)
    return run.inputs[max(len(coordinates_of(body)) - 3, 0) :]


def _axes(
    runs: dict[str, Rollout], rows: Sequence[str], layout: Layout, tall: float = 1.0
) -> tuple[Sheet, NDArray[Any]]:
    """Return a sheet with a column for each run, and its axes, shape (rows, runs)."""
    sheet = Sheet(_WIDTH * len(runs), **layout)
    heights = [_HEIGHT * tall, *(_HEIGHT for _ in rows[1:])]
    grid = sheet.grid(len(rows), len(runs), heights, share="")
    for row, name in zip(grid, rows, strict=True):
        row[0].set_ylabel(name)
    for axes in grid.ravel():
        dress_time(axes)
    for (label, run), column in zip(runs.items(), grid.T, strict=True):
        sheet.write_above(column[0], label)
        column[-1].set_xlabel("t [s]")
        if len(run) > 1:
            for axes in column if tall == 1.0 else column[1:]:
                axes.set_xlim(run.t[0], run.t[-1])
    return sheet, grid


def _lines(
    sheet: Sheet | None, axes: Axes, t: Array, values: Array, names: Sequence[str], **own: Any
) -> None:
    """Draw a line for each wheel and, with a sheet, a legend; the first line is the widest, so all show."""
    for k, (name, each) in enumerate(zip(names, values.T, strict=True)):
        line(axes, t, each, label=name.replace("_", " "), **line_style(k, len(names)) | own)
    if float(np.nanmax(np.abs(values), initial=0.0)) < _ROUNDING:
        axes.set_ylim(-1.0, 1.0)
    if sheet is not None:
        sheet.legend_above(axes)


def _note(
    axes: Axes, words: str, at: tuple[float, float], ha: str = "center", xycoords: Any = "axes fraction"
) -> None:
    style: Style = {"fontsize": letters(0.9), "color": QUIET}
    axes.annotate(words, at, (0, 3), xycoords=xycoords, textcoords="offset points", ha=ha, **style)


_OUTLINE: Style = {"facecolor": "#f2f2f2", "edgecolor": "#777777", "linewidth": 1.4, "zorder": 1}


def balance(rollouts: Rollouts, *, footprint: ArrayLike | None = None, **layout: Unpack[Layout]) -> Figure:
    """Draw tip-over margin and required friction over time, and the zero-moment point on the footprint.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    footprint : array_like, shape (k, 2), optional
        As in `tip_over_margin`; by default each robot's own.
    **layout
        `title`, `ax` and `width`, as in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, not of a `MobileRobot`, or `footprint` is no convex polygon.
    """
    runs = with_plants(rollouts, *GROUNDED)
    sheet = Sheet(11.0, **layout)
    spots: list[Spot] = [(0, 0), (1, 0), (slice(0, 2), 1)]
    if sheet.columns(2, 3.2) == 1:
        above, below, beside = sheet.axes([(0, 0), (1, 0), (2, slice(0, 1))], [2.2, 2.2, 4.4])
    else:
        above, below, beside = sheet.axes(spots, [2.1, 2.1], ratios=(1.25, 1))
    for axes, name in ((above, "tip-over margin [m]"), (below, "required friction [-]")):
        dress_time(axes)
        axes.set_ylabel(name)
    below.set_xlabel("t [s]")
    for index, (label, run) in enumerate(runs.items()):
        style = line_style(index, len(runs)) | {"label": label}
        margin = tip_over_margin(run, footprint)
        line(above, run.t, margin, **style)
        line(below, run.t, required_friction(run), **style)
        lifted = np.isneginf(margin)
        hatched: Style = {"facecolor": "none", "edgecolor": colour(index), "hatch": "///", "alpha": 0.5}
        shade((above, below), run.t, lifted, **hatched)
        if lifted.any():
            sheet.write_above(above, "hatched: the ground does not carry the robot", 0.95)
    span = [float(f([f(run.t) for run in runs.values()])) for f in (np.min, np.max)]
    if span[0] < span[1]:
        below.set_xlim(*span)
    if above.dataLim.y0 <= 0:
        above.axhline(0, **_LIMIT | {"color": _OUTLINE["edgecolor"]})
    below.set_ylim(bottom=min(0.0, below.get_ylim()[0]))
    _from_above(sheet, beside, runs, footprint)
    return sheet.finish("Balance on the ground", keys_of(runs))


def _from_above(sheet: Sheet, axes: Axes, runs: dict[str, Rollout], footprint: ArrayLike | None) -> None:
    """Draw the footprint and the zero-moment point in the body's frame."""
    dress(axes)
    outlines = [footprint_of(run.plant, footprint) for run in runs.values()]
    for corners in {corners.tobytes(): corners for corners in outlines}.values():
        axes.add_patch(Polygon(corners, closed=True, label="footprint", **_OUTLINE))
    for index, run in enumerate(runs.values()):
        point = body_zero_moment_point(run)
        curve(axes, *point.T, **line_style(index, len(runs)))
        carried = np.flatnonzero(np.isfinite(point[:, 0]))[:1]
        axes.plot(
            *point[carried].T, "o", color=colour(index), markersize=8, markeredgecolor="white", zorder=5
        )
    axes.autoscale_view()
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="forward $x_B$ [m]", ylabel="left $y_B$ [m]")
    sheet.write_above(axes, "zero-moment point in the footprint, dot: first", 0.95)
