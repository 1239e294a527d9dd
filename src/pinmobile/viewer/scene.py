"""What stands and moves on the stage: robots, paths, trails, frames, arrows, words."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from pinmobile.arrays import Array
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHTable
from pinmobile.robot import MobileRobot
from pinmobile.simulation import Rollout
from pinmobile.viewer import shapes
from pinmobile.viewer.motion import Channel, along, poses_of
from pinmobile.viewer.overlays import Follow, Overlays, Stay, View
from pinmobile.viewer.palette import AXES, INK, QUIET, colour
from pinmobile.viewer.stage import Extent, Stage, overview

Rider = Callable[[Array], list[Channel]]

__all__ = ["Rider", "Scene", "extent_of", "sampled"]

_SPREAD = 2500  # points of a trail at most
_GRID, _PATH, _TRAIL, _WORDS, _ABOVE = 1, 8, 2, 9, 40  # what is painted over what
_NAMES = {LECTURE_TABLE: "lecture", SLIDE_TABLE: "slide"}


def extent_of(robot: MobileRobot, points: Array) -> Extent:
    """Return the part of the plane that holds the points, shape (n, 2) [m]."""
    return Extent(points.min(axis=0), points.max(axis=0), robot.size)


def sampled(times: Array, t: Array, values: Array) -> Array:
    """Return values, shape (N, k), at other times, shape (n,); straight between two samples."""
    return np.stack([np.interp(times, t, column) for column in values.T], axis=-1)


@dataclass
class Scene:
    """Everything that is drawn of some rollouts, or of a robot alone.

    Parameters
    ----------
    stage : Stage
        Where.
    robot : MobileRobot
        Drawn where a rollout's plant is none.
    overlays : Overlays
        What is shown beside it.

    Attributes
    ----------
    channels : list of Channel
        What moves, with a value for each frame.
    riders : list of callable
        What moves with the robot: each makes channels of its poses.
    """

    stage: Stage
    robot: MobileRobot
    overlays: Overlays
    channels: list[Channel] = field(default_factory=list)
    riders: list[Rider] = field(default_factory=list)
    legend: list[list[object]] = field(default_factory=list)

    def alone(self, pose: Array) -> None:
        """Draw the robot at a pose (x, y, psi), around which one looks."""
        poses = pose[None]
        room = 2.5 * max(self.robot.size)
        extent = Extent(pose[:2] - room, pose[:2] + room, self.robot.size)
        self._furnish(extent, poses)
        self.stage.robot("meshcat/robot0", self.robot, colour(0))
        self._rides(lambda poses: along("meshcat/robot0", poses), poses)
        self._tables(poses, extent)

    def move(self, pose: Array) -> None:
        """Put the robot, and what moves with it, at a pose (x, y, psi), shape (3,)."""
        for rider in self.riders:
            self.stage.show(rider(pose[None]), 0)

    def show(self, frame: int) -> None:
        """Put everything where it is at a frame."""
        self.stage.show(self.channels, frame)

    def _rides(self, rider: Rider, poses: Array) -> None:
        self.riders.append(rider)
        self.channels += rider(poses)

    def play(self, runs: Mapping[str, Rollout], times: Array) -> None:
        """Draw the rollouts: the first solid, the others as ghosts.

        Parameters
        ----------
        runs : mapping of str to Rollout
            By label.
        times : ndarray, shape (n,)
            Of the frames [s].
        """
        everything = [part[:, :2] for run in runs.values() for part in (run.q, run.reference.q)]
        extent = extent_of(self.robot, np.concatenate(everything))
        main = next(iter(runs.values()))
        poses = [_poses(run.t, run.q, times) for run in runs.values()]
        self._furnish(extent, poses[0])
        if self.overlays.path:
            self._path(main, extent)
        for index, (label, run) in enumerate(runs.items()):
            robot = run.robot if isinstance(run.robot, MobileRobot) else self.robot
            path = f"meshcat/robot{index}"
            self.stage.robot(path, robot, colour(index), ghost=index > 0)
            if index == 0:
                self._rides(lambda poses: along("meshcat/robot0", poses), poses[0])
            else:
                self.channels += along(path, poses[index])
            if self.overlays.trail:
                self._trail(index, len(runs), poses[index], extent)
            self.legend.append([label or "travelled", colour(index), "", 0.0 if index == 0 else 0.55])
        if self.overlays.desired:
            self.stage.robot("meshcat/desired", self.robot, QUIET, ghost=True)
            self.channels += along("meshcat/desired", _poses(main.t, main.reference.q, times))
            self.legend.append(["desired pose", QUIET, "", 0.5])
        if self.overlays.arrows is not None:
            self._arrows(main, times, poses[0], extent)
        self._tables(poses[0], extent)
        if self.overlays.caption:
            self.channels.append(Channel("meshcat/stage", "caption", _captions(runs, times)))
        self.stage.tell("legend", self.legend)

    def _furnish(self, extent: Extent, poses: Array) -> None:
        camera = self.overlays.camera
        height = self.robot.size[2]
        view = overview(extent, height)
        if isinstance(camera, Follow):
            toward = (view.eye - view.target) / np.linalg.norm(view.eye - view.target)
            view = View(camera.distance * toward, np.zeros(3))
        elif isinstance(camera, Stay):
            eye, target = (
                default if value is None else np.asarray(value)
                for value, default in ((camera.eye, view.eye), (camera.target, view.target))
            )
            view = View(eye, target)
        self.stage.furnish(extent, view)
        if isinstance(camera, Follow):
            self._rides(_focus, poses)
        if self.overlays.grid:
            self._grid(extent)

    def _grid(self, extent: Extent) -> None:
        room = 0.25 * extent.radius + 1.2 * extent.unit
        step = _step(2 * (extent.radius + room))
        low, high = (np.floor((extent.low - room) / step), np.ceil((extent.high + room) / step))
        thin = 0.0022 * (extent.radius + room)
        xs, ys = (step * np.arange(low[k], high[k] + 1) for k in (0, 1))
        lines = [np.array([[x, y0], [x, y1]]) for x in xs for y0, y1 in zip(ys, ys[1:], strict=False)]
        lines += [np.array([[x0, y], [x1, y]]) for y in ys for x0, x1 in zip(xs, xs[1:], strict=False)]
        bands = shapes.joined([shapes.ribbon(line, thin) for line in lines])
        self.stage.put("meshcat/grid", shapes.flat(bands, "#c9cdd1", order=_GRID))
        tall = 0.055 * (extent.radius + room)
        for k, x in enumerate(xs):
            name = f"{x:g}" if k < len(xs) - 1 else f"x = {x:g} m"
            self._write(f"meshcat/scale/x{k}", name, (x, ys[0] - 0.8 * tall), tall)
        for k, y in enumerate(ys):
            name = f"{y:g}" if k < len(ys) - 1 else f"y = {y:g} m"
            self._write(f"meshcat/scale/y{k}", name, (xs[0] - (0.3 + 0.28 * len(name)) * tall, y), tall)

    def _write(self, path: str, text: str, at: tuple[float, float], tall: float) -> None:
        self.stage.put(path, shapes.word(text, QUIET, tall, lying=True, order=_WORDS))
        self.stage.set(path, "position", [float(at[0]), float(at[1]), 0.0])

    def _path(self, run: Rollout, extent: Extent) -> None:
        points = run.reference.q[:: max(len(run) // 4000, 1), :2]
        dash = max(0.028 * extent.radius, 0.05 * extent.unit)
        bands = shapes.dashes(points, 0.025 * extent.unit, dash, 0.8 * dash)
        if len(bands[0]):
            self.stage.put("meshcat/path", shapes.flat(bands, INK, order=_PATH))
        self.legend.append(["desired", INK, "6 4", 0.0])

    def _trail(self, index: int, count: int, poses: Array, extent: Extent) -> None:
        step = -(-len(poses) // _SPREAD)
        kept = np.unique(np.append(np.arange(0, len(poses), step), len(poses) - 1))
        width = 0.05 * extent.unit * (1 + 0.9 * (count - 1 - index))
        band = shapes.ribbon(poses[kept, :2], width)
        path = f"meshcat/trail{index}/<object>"
        self.stage.put(
            path.removesuffix("/<object>"), shapes.flat(band, colour(index), order=_TRAIL + index, trail=True)
        )
        drawn = 6 * np.interp(np.arange(len(poses)), kept, np.arange(len(kept)))
        self.channels.append(Channel(path, "drawn", drawn[:, None]))

    def _tables(self, poses: Array, extent: Extent) -> None:
        several = len(self.overlays.frames) > 1
        for number, table in enumerate(self.overlays.frames):
            name = _NAMES.get(table, f"table {number + 1}")
            self._triad(f"meshcat/frames{number}/0", "{0}", extent, number, 0)
            for k in range(1, len(table) + 1):
                path = f"meshcat/frames{number}/{k}"
                label = f"{{{k}}} {name}" if several and k < len(table) else f"{{{k}}}"
                self._triad(path, label, extent, number, k)
                self._rides(partial(_frame, path, table, k), poses)
        if self.overlays.body_frame:
            self._triad("meshcat/body_frame", "B", extent, 0, 0)
            self._rides(lambda poses: along("meshcat/body_frame", poses), poses)

    def _triad(self, path: str, label: str, extent: Extent, number: int, k: int) -> None:
        length = (0.9 + 0.35 * number) * extent.unit
        shaft = shapes.arrow(0.07 - 0.02 * min(number, 2))
        for axis, turned in enumerate(_TO_AXIS):
            vertices = length * shaft[0] @ turned.T
            self.stage.put(
                f"{path}/{'xyz'[axis]}", shapes.over((vertices, shaft[1]), AXES[axis], order=_ABOVE + axis)
            )
        tall = 0.34 * extent.unit
        self.stage.put(f"{path}/name", shapes.word(label, INK, tall, lying=False, order=_ABOVE + 5))
        away = (0.25 + 0.3 * k + 0.15 * number) * extent.unit
        self.stage.set(f"{path}/name", "position", [away, away, 0.6 * away])

    def _arrows(self, run: Rollout, times: Array, poses: Array, extent: Extent) -> None:
        arrows = self.overlays.arrows
        assert arrows is not None  # noqa: S101
        held = np.clip(np.searchsorted(run.t, times, side="right") - 1, 0, len(run) - 1)
        tau = run.tau[held]
        size, moment = np.hypot(tau[:, 0], tau[:, 1]), tau[:, 2]
        per_newton = arrows.force or 2 * extent.unit / max(float(size.max()), 1e-12)
        per_moment = arrows.moment or extent.unit / max(float(np.abs(moment).max()), 1e-12)
        height = 1.6 * self.robot.size[2]
        heading = np.column_stack([poses[:, :2], np.unwrap(np.arctan2(tau[:, 1], tau[:, 0]))])
        for path, shape, paint in (
            ("meshcat/force", shapes.arrow(0.06), colour(3)),
            ("meshcat/moment", shapes.arc_arrow(), colour(4)),
        ):
            self.stage.put(path, shapes.over(shape, paint, order=_ABOVE - 5))
        scale = np.maximum(per_newton * size, 1e-4)[:, None] * np.ones(3)
        self.channels += along("meshcat/force", heading, height)
        self.channels.append(Channel("meshcat/force", "scale", scale))
        radius = np.maximum(per_moment * np.abs(moment), 1e-4)[:, None] * np.ones(3)
        radius[:, 1] *= np.where(moment < 0, -1, 1)  # in a mirror it turns the other way
        self.channels += along("meshcat/moment", poses * (1, 1, 0), height)
        self.channels.append(Channel("meshcat/moment", "scale", radius))
        self.legend.append([f"force, 1 m = {1 / per_newton:.2g} N", colour(3), "", 0.0])
        self.legend.append([f"moment, 1 m = {1 / per_moment:.2g} N m", colour(4), "", 0.0])


_TO_AXIS = (
    np.eye(3),
    np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
)


def _focus(poses: Array) -> list[Channel]:
    position = np.column_stack([poses[:, :2], np.zeros(len(poses))])
    return [Channel("meshcat/focus", "position", position)]


def _frame(path: str, table: DHTable, k: int, poses: Array) -> list[Channel]:
    return poses_of(path, table.placements(poses[:, [1, 0, 2]])[:, k - 1])


def _poses(t: Array, q: Array, times: Array) -> Array:
    return sampled(times, t, np.column_stack([q[:, :2], np.unwrap(q[:, 2])]))


def _step(span: float) -> float:
    """Return 1, 2 or 5 times a power of ten, about a tenth of the span."""
    power = 10.0 ** np.floor(np.log10(span / 10))
    return float(next(power * factor for factor in (1, 2, 5, 10) if power * factor >= span / 14))


def _captions(runs: Mapping[str, Rollout], times: Array) -> list[str]:
    """Return time and position errors for each frame, changing ten times a second at most."""
    ticks = np.floor(10 * (times - times[0]) + 1e-6)
    first = np.searchsorted(ticks, ticks)  # the frame in which the tick began
    at = times[first]
    rows = {
        f"{label}: " if label else "": sampled(at, run.t, np.hypot(run.error[:, :1], run.error[:, 1:2]))[:, 0]
        for label, run in runs.items()
    }
    written: dict[int, str] = {}
    for k in np.unique(first):
        errors = [f"{label}position error {_length(values[k])}" for label, values in rows.items()]
        written[int(k)] = "\n".join([f"t = {times[k]:.1f} s", *errors])
    return [written[int(k)] for k in first]


def _length(value: float) -> str:
    for scale, unit in ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm")):
        if value >= 0.9995 * scale or unit == "nm":
            break
    return f"{value / scale:.{2 if value < 9.995 * scale else 1 if value < 99.95 * scale else 0}f} {unit}"
