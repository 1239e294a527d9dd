"""What wheels do over time: torques, friction, slip, loads; and where odometry believes the robot to be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.loop import Rollout
from pinmobile.palette import INK, QUIET, SLIDES
from pinmobile.plant import Contacts
from pinmobile.plots.sheet import Canvas, Sheet, letters, wrapped
from pinmobile.plots.style import (
    Rollouts,
    Style,
    called,
    colour,
    desired,
    dress,
    labelled,
    line_style,
    thinned,
    with_method,
)

_WHEELED = "WheeledRobot", "contacts(q, v, a, u, signals)"  # of `with_method`
_WIDTH, _HEIGHT = 5.0, 2.2  # of axes [in]
_LIMIT: Style = {"color": INK, "linestyle": (0, (4, 3)), "linewidth": 1.2, "zorder": 2}
_ROUNDING = 1e-9  # what is smaller is drawn as the zero that it is


def wheel_torques(
    rollouts: Rollouts, *, title: str | None = None, ax: Canvas | None = None, width: float | None = None
) -> Figure:
    """Draw the inputs of a robot on wheels over time, those of its wheels and of what steers them.

    Arms' joints are in `forces`.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, or not of robots on wheels.
    """
    runs = with_method(rollouts, *_WHEELED)
    units = {one.unit for run in runs.values() for one in _driven(run)}
    name = f"torque [{units.pop()}]" if len(units) == 1 else "input"
    sheet, grid = _axes(runs, [name], ax, width)
    for run, axes in zip(runs.values(), grid[0], strict=True):
        inputs = _driven(run)
        u = run.u[:, run.u.shape[1] - len(inputs) :]
        _lines(sheet, len(runs), axes, run.t, u, [one.name for one in inputs], drawstyle="steps-post")
    return sheet.finish(title, "Inputs of the wheels")


def friction(
    rollouts: Rollouts, *, title: str | None = None, ax: Canvas | None = None, width: float | None = None
) -> Figure:
    """Draw over time how much of its friction each wheel uses: the force in its friction circle, mu N wide.

    At 1 it slides; of rollers it is the force along their axes. Where rolling determines but the sum of some
    forces, a wheel's is its share of that sum.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, not of robots on wheels, or the loads of one cannot be told.
    """
    runs = with_method(rollouts, *_WHEELED)
    found = {label: _contacts(run) for label, run in runs.items()}
    for label, contacts in found.items():
        if not np.isfinite(contacts.limits).any():
            raise InvalidArgument(
                f"{called(label)} is of a robot whose loads are not known, expected one that stands on "
                "three points and more: give supports=[(x, y), ...]"
            )
    sheet, grid = _axes(runs, ["force / $\\mu N$ [-]"], ax, width)
    for (label, run), axes in zip(runs.items(), grid[0], strict=True):
        contacts = found[label]
        _lines(sheet, len(runs), axes, run.t, share_of_friction(contacts), _names(contacts))
        axes.axhline(1.0, **_LIMIT)
        axes.annotate("slides", (1.0, 1.0), xycoords=("axes fraction", "data"), **_word("right"))
        _slides(axes, run.t, np.asarray(contacts.slides.any(axis=1)))
        axes.set_ylim(0.0, max(1.12, axes.get_ylim()[1]))
    return sheet.finish(title, "Share of friction used")


def slip(
    rollouts: Rollouts, *, title: str | None = None, ax: Canvas | None = None, width: float | None = None
) -> Figure:
    """Draw over time how fast each wheel slides over the ground, along it and across it.

    Of a wheel with rollers these directions are along its rollers' axes and across, in which they roll.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, or not of robots on wheels.
    """
    runs = with_method(rollouts, *_WHEELED)
    rows = ["slip along [m/s]", "slip across [m/s]"]
    sheet, grid = _axes(runs, rows, ax, width)
    for (_, run), column in zip(runs.items(), grid.T, strict=True):
        contacts = _contacts(run)
        for k, axes in enumerate(column):
            values = np.where(np.abs(contacts.slips[..., k]) < _ROUNDING, 0.0, contacts.slips[..., k])
            _lines(sheet, len(runs), axes, run.t, values, contacts.names, legend=k == 0)
            _slides(axes, run.t, np.asarray(contacts.slides.any(axis=1)))
            if not values.any():
                axes.set_ylim(-1.0, 1.0)
                axes.annotate("none", (0.5, 0.62), xycoords="axes fraction", **_word("center"))
    return sheet.finish(title, "Slip velocities")


def loads(
    rollouts: Rollouts, *, title: str | None = None, ax: Canvas | None = None, width: float | None = None
) -> Figure:
    """Draw over time what each wheel carries.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, or not of robots on wheels.
    """
    runs = with_method(rollouts, *_WHEELED)
    sheet, grid = _axes(runs, ["load [N]"], ax, width)
    for (_, run), axes in zip(runs.items(), grid[0], strict=True):
        contacts = _contacts(run)
        _lines(sheet, len(runs), axes, run.t, contacts.loads, contacts.names)
        if not np.isfinite(contacts.loads).any():
            axes.annotate("not known", (0.5, 0.5), xycoords="axes fraction", **_word("center"))
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    return sheet.finish(title, "Loads of the wheels")


def odometry(
    rollouts: Rollouts, *, title: str | None = None, ax: Canvas | None = None, width: float | None = None
) -> Figure:
    """Draw the path that odometry believes beside the true one, and how far apart they are over time.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Runs with a controller `ByOdometry`; each gets a column.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

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
                "ByOdometry(controller, table)"
            )
    names = ["y [m]", "odometry off by [m]"]
    sheet, grid = _axes(runs, names, ax, width, tall=1.7)
    for (_, run), (above, below) in zip(runs.items(), grid.T, strict=True):
        true, believed = run.poses, run.signals["believed_pose"].values
        kept = thinned(*true[:, :2].T)
        above.plot(*run.reference_poses[kept, :2].T, label="desired", **desired())
        for k, (label, way) in enumerate((("true", true), ("believed", believed))):
            above.plot(*way[kept, :2].T, label=label, **line_style(k, 2))
        above.set_aspect("equal", adjustable="datalim")
        above.set_xlabel("x [m]")
        above.legend(frameon=False, loc="best")
        off = np.hypot(*(believed - true)[:, :2].T)
        kept = thinned(off)
        below.plot(run.t[kept], off[kept], **line_style(0, 1) | {"color": colour(1)})
        below.set_ylim(bottom=0.0)
    return sheet.finish(title, "Odometry beside the truth")


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
    arms = len(getattr(getattr(run.plant, "robot", None), "coordinates", ())) - 3
    return run.inputs[max(arms, 0) :]


def _names(contacts: Contacts) -> list[str]:
    """Return names of the wheels, with a word for those whose force is a share."""
    known = np.asarray(contacts.determined.all(axis=1))
    return [name if sure else f"{name} (share)" for name, sure in zip(contacts.names, known, strict=True)]


def _axes(
    runs: dict[str, Rollout],
    rows: Sequence[str],
    ax: Canvas | None,
    width: float | None,
    *,
    tall: float = 1.0,
) -> tuple[Sheet, NDArray[Any]]:
    """Return a sheet with a column for each run, and its axes, shape (rows, runs)."""
    sheet = Sheet(ax, width, _WIDTH * len(runs))
    heights = [_HEIGHT * tall, *(_HEIGHT for _ in rows[1:])]
    grid = sheet.grid(len(rows), len(runs), heights, share="")
    for row, name in zip(grid, rows, strict=True):
        row[0].set_ylabel(name)
    for axes in grid.ravel():
        dress(axes)
        axes.margins(x=0.01, y=0.1)
    for (label, run), column in zip(runs.items(), grid.T, strict=True):
        column[0].set_title(wrapped(label, letters(), sheet.room(len(runs))), fontsize=letters())
        column[-1].set_xlabel("t [s]")
        if len(run) > 1:
            for axes in column if tall == 1.0 else column[1:]:
                axes.set_xlim(run.t[0], run.t[-1])
    return sheet, grid


def _lines(
    sheet: Sheet,
    columns: int,
    axes: Axes,
    t: Array,
    values: Array,
    names: Sequence[str],
    *,
    legend: bool = True,
    **given: Any,
) -> None:
    """Draw a line for each wheel, the first the widest, so that those that coincide are seen."""
    count = values.shape[1]
    for k, (name, line) in enumerate(zip(names, values.T, strict=True)):
        kept = thinned(np.nan_to_num(line))
        style = line_style(k, count) | given
        axes.plot(
            t[kept],
            line[kept],
            label=name.replace("_", " "),
            **{**_dot(t), **style},
        )
    if float(np.nanmax(np.abs(values), initial=0.0)) < _ROUNDING:
        axes.set_ylim(-1.0, 1.0)
    if legend:
        sheet.legend_above(axes, columns)


def _dot(t: Array) -> Style:
    return {"marker": "o" if len(t) == 1 else ""}


def _slides(axes: Axes, t: Array, slides: NDArray[np.bool_]) -> None:
    """Shade the times at which a wheel slides."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slides, [False]]).astype(int)))
    for start, stop in edges.reshape(-1, 2):
        until = t[min(stop, len(t) - 1)]
        axes.axvspan(t[start], until, facecolor=SLIDES, alpha=0.15, linewidth=0, zorder=1)


def _word(where: str) -> Style:
    return {
        "xytext": (0, 3),
        "textcoords": "offset points",
        "ha": where,
        "fontsize": letters(0.9),
        "color": QUIET,
    }
