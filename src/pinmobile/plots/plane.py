"""The lecture's figure: where the robot should go, where it went, and how it stood there."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pinmobile.arrays import Array, ArrayLike, finite
from pinmobile.errors import InvalidArgument
from pinmobile.palette import INK, colour
from pinmobile.plots.body import ARROW, Body, diagonal
from pinmobile.plots.runs import Rollouts, planar, same_references, thinned
from pinmobile.plots.style import DESIRED, ShownFigure, dress, headed, heading, legend, si
from pinmobile.simulation import Rollout

__all__ = ["TRAVELLED", "Window", "panels", "path", "poses"]

_BOXES = 8
TRAVELLED: dict[str, Any] = {"linewidth": 3.6, "zorder": 3}


class Window(NamedTuple):
    """The part of the plane that all panels show."""

    low: Array  # (2,) [m]
    high: Array  # (2,) [m]

    @property
    def extent(self) -> float:
        """Length of the longer side [m]."""
        return float((self.high - self.low).max())


def path(rollouts: Rollouts, *, times: ArrayLike | None = None, title: str | None = None) -> Figure:
    """Draw the desired and the travelled path, and the robot at several instants at its actual pose.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a panel; all panels show the same part of the plane.
    times : array_like, shape (n,), optional
        When the robot is drawn [s]; by default at up to 8 instants spread along the path.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, has no pose, or a time is outside one of them.
    """
    runs = planar(rollouts)
    instants = (
        _instants(runs) if times is None else {label: _checked(times, run) for label, run in runs.items()}
    )
    figure, window, axes = panels(runs, headed(title, "Desired and travelled path"))
    for index, (label, run) in enumerate(runs.items()):
        xy = run.poses
        xy = xy[thinned(xy[:, 0], xy[:, 1])]
        axes[index].plot(xy[:, 0], xy[:, 1], color=colour(index), label="travelled", **TRAVELLED)
        for t, pose in zip(instants[label], poses(run, instants[label]), strict=True):
            Body(axes[index], run.plant, colour(index), ARROW * window.extent, zorder=5).move(pose)
            _write_time(axes[index], t, pose, 0.5 * diagonal(run.plant, ARROW * window.extent))
    return figure


def panels(runs: Mapping[str, Rollout], title: str) -> tuple[Figure, Window, list[Axes]]:
    """Return a figure with a panel for each rollout, its desired path drawn, and a legend below."""
    window = _window(runs)
    columns = min(len(runs), 3)
    figure, grid = _sheet(-(-len(runs) // columns), columns, window)
    figure.suptitle(title, fontsize=14, color=INK, y=1 - 0.12 / figure.get_figheight(), va="top")
    for index, (axes, (label, run)) in enumerate(zip(grid, runs.items(), strict=False)):
        _furnish(axes, window, left=index % columns == 0, lowest=index + columns >= len(runs))
        off = si(float(np.hypot(run.error[:, 0], run.error[:, 1]).max()), "m")
        axes.set_title(f"position error at most {off}", fontsize=10, color=INK)
        axes.annotate(label, (0.5, 1), (0, 21), ha="center", **heading(index))
        xy = run.reference_poses
        xy = xy[thinned(xy[:, 0], xy[:, 1])]
        axes.plot(xy[:, 0], xy[:, 1], label="desired", **DESIRED)
    for axes in grid[len(runs) :]:
        axes.remove()
    legend(figure, list(_keys(len(runs))))
    return figure, window, grid[: len(runs)]


def _sheet(rows: int, columns: int, window: Window) -> tuple[Figure, list[Axes]]:
    """Return a figure whose axes have the shape of the window: layout engines let titles collide there."""
    shape = (window.high - window.low) / window.extent
    largest = (8.6 / columns - 0.4, 4.8) if columns > 1 else (7.0, 5.6)  # [in]
    wide, tall = shape * min(largest[0] / shape[0], largest[1] / shape[1])
    left, right, below, above, apart = 0.65, 0.2, 0.95, 0.95 if columns > 1 else 0.75, (0.3, 0.85)
    width = left + columns * wide + (columns - 1) * apart[0] + right
    height = below + rows * tall + (rows - 1) * apart[1] + above
    figure = ShownFigure(figsize=(width, height), dpi=100)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    figure.subplots_adjust(
        left=left / width,
        right=1 - right / width,
        bottom=below / height,
        top=1 - above / height,
        wspace=apart[0] / wide,
        hspace=apart[1] / tall,
    )
    return figure, list(grid.ravel())


def poses(run: Rollout, times: Array) -> Array:
    """Return the actual poses at `times`, shape (n, 3) [m, m, rad], straight between two samples."""
    poses = run.poses
    columns = poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2])
    return np.stack([np.interp(times, run.t, column) for column in columns], axis=-1)


def _keys(count: int) -> Iterator[Patch | Line2D]:
    shade = colour(0) if count == 1 else "#777777"
    yield Line2D([], [], label="desired", **DESIRED)
    yield Line2D([], [], label="travelled", color=shade, **TRAVELLED)
    yield Patch(facecolor=(*(0.6,) * 3, 0.4), edgecolor=shade, label="robot")


def _window(runs: Mapping[str, Rollout]) -> Window:
    points = np.concatenate(
        [part[:, :2] for run in runs.values() for part in (run.poses, run.reference_poses)]
    )
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float((high - low).max())
    robot = max(diagonal(run.plant, ARROW * extent) for run in runs.values())
    margin = 0.5 * robot + 0.12 * max(extent, robot) or 1.0
    room = np.maximum(0.25 * extent - 0.5 * (high - low), 0.0)  # a straight line gets a panel, not a slit
    return Window(low - margin - room, high + margin + room)


def _furnish(axes: Axes, window: Window, *, left: bool, lowest: bool) -> None:
    dress(axes)
    axes.set_aspect("equal")
    axes.set_xlim(window.low[0], window.high[0])
    axes.set_ylim(window.low[1], window.high[1])
    axes.tick_params(labelleft=left, labelbottom=lowest)
    axes.set_xlabel("x [m]" if lowest else "", fontsize=11)
    axes.set_ylabel("y [m]" if left else "", fontsize=11)


def _write_time(axes: Axes, t: float, pose: Array, beside: float) -> None:
    """Write the time to the right of the robot."""
    right = float(np.sin(pose[2])), float(-np.cos(pose[2]))
    spot = pose[0] + beside * right[0], pose[1] + beside * right[1]
    offset = 18 * right[0], 9 * right[1]  # [pt]; text is wider than high
    text: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 9, "color": INK, "zorder": 6}
    axes.annotate(f"{t:.3g} s", spot, offset, textcoords="offset points", **text)


def _instants(runs: Mapping[str, Rollout]) -> dict[str, Array]:
    """Return times at which the robot is drawn; rollouts of one reference share theirs, to be compared."""
    chosen: dict[str, Array] = {}
    for labels in same_references(runs).values():
        times = _spread(runs[labels[0]])
        chosen |= dict.fromkeys(labels, times)
    return chosen


def _spread(run: Rollout) -> Array:
    """Return times between which the robot has moved on by so much that its drawings do not overlap."""
    xy = run.poses[:, :2]
    robot = diagonal(run.plant, ARROW * float(np.ptp(xy, axis=0).max()))
    travelled = np.append(0.0, np.cumsum(np.hypot(*np.diff(xy, axis=0).T)))
    count = int(min(_BOXES - 1, travelled[-1] / (1.5 * robot))) if robot else 0
    between = np.searchsorted(travelled, np.linspace(0.0, travelled[-1], count + 1)[1:-1])
    kept: list[int] = []
    for k in (0, len(xy) - 1, *between):
        if all(np.hypot(*(xy[k] - xy[other])) > robot for other in kept):
            kept.append(int(k))
    return np.asarray(run.t[sorted(kept)])


def _checked(times: ArrayLike, run: Rollout) -> Array:
    checked = np.atleast_1d(finite("times", times))
    if checked.ndim > 1:
        raise InvalidArgument(f"times has shape {checked.shape}, expected (n,)")
    for k, t in enumerate(checked):
        if not run.t[0] <= t <= run.t[-1]:
            raise InvalidArgument(f"times[{k}] is {t} s, expected {run.t[0]:g} <= t <= {run.t[-1]:g} s")
    return checked
