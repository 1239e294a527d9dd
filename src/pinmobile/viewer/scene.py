"""What stands and moves on the stage: robots, paths, trails, frames, arrows, words."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np

from pinmobile.arrays import Array
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHTable
from pinmobile.robot import MobileRobot
from pinmobile.simulation import Rollout
from pinmobile.viewer import shapes
from pinmobile.viewer.motion import Channel, along, poses_of
from pinmobile.viewer.overlays import Arrows, Follow, Overlays, Stay, View
from pinmobile.viewer.palette import AXES, INK, QUIET, colour
from pinmobile.viewer.stage import Extent, Stage, overview

Rider = Callable[[Array], list[Channel]]

__all__ = ["Rider", "Scene", "extent_of", "sampled"]

_SPREAD = 2500  # points of a trail at most
_GRID, _PATH, _TRAIL, _WORDS, _ABOVE = 1, 8, 2, 9, 40  # what is painted over what
_NO_FORCE = 1e-9  # [N or N m]; less is rounding
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
                self._trail(index, len(runs), run, times, extent)
            self.legend.append([label or "travelled", colour(index), "", 0.0 if index == 0 else 0.55])
        if self.overlays.desired:
            self.stage.robot("meshcat/desired", self.robot, QUIET, ghost=True)
            self.channels += along("meshcat/desired", _poses(main.t, main.reference.q, times))
            self.legend.append(["desired pose", QUIET, "", 0.5])
        if self.overlays.arrows is not None:
            self._arrows(main, times, poses[0], extent, self.overlays.arrows)
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
        xs, ys, tall = extent.lines(0), extent.lines(1), extent.tall
        thin = 0.04 * tall
        lines = [np.array([[x, y0], [x, y1]]) for x in xs for y0, y1 in pairwise(ys)]
        lines += [np.array([[x0, y], [x1, y]]) for y in ys for x0, x1 in pairwise(xs)]
        bands = shapes.joined([shapes.ribbon(line, thin) for line in lines])
        self.stage.put("meshcat/grid", shapes.flat(bands, "#c9cdd1", order=_GRID))
        for k, x in enumerate(xs):
            unit = " m" if k == len(xs) - 1 else ""
            self._write(f"meshcat/scale/x{k}", f"{x:g}{unit}", (x, ys[0] - 0.75 * tall), tall)
        for k, y in enumerate(ys):
            unit = " m" if k == len(ys) - 1 else ""
            self._write(f"meshcat/scale/y{k}", f"{y:g}{unit}", (xs[0] - 0.9 * tall, y), tall)
        self._write("meshcat/scale/x", "x", (xs[-1] + 0.7 * tall, ys[0]), tall)
        self._write("meshcat/scale/y", "y", (xs[0], ys[-1] + 0.6 * tall), tall)

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

    def _trail(self, index: int, count: int, run: Rollout, times: Array, extent: Extent) -> None:
        kept = np.unique(np.append(np.arange(0, len(run), -(-len(run) // _SPREAD)), len(run) - 1))
        width = 0.05 * extent.unit * (1 + 0.9 * (count - 1 - index))
        band = shapes.ribbon(run.q[kept, :2], width)
        path = f"meshcat/trail{index}/<object>"
        self.stage.put(
            path.removesuffix("/<object>"), shapes.flat(band, colour(index), order=_TRAIL + index, trail=True)
        )
        drawn = 6 * np.interp(times, run.t[kept], np.arange(len(kept)))
        self.channels.append(Channel(path, "drawn", drawn[:, None]))

    def _tables(self, poses: Array, extent: Extent) -> None:
        drawn: list[Array] = []
        for number, table in enumerate(self.overlays.frames):
            for k in range(len(table) + 1):
                placements = _frame(table, k, poses)
                if any(np.allclose(placements, other) for other in drawn):
                    continue  # two tables share some of their frames
                drawn.append(placements)
                shared = all(np.allclose(_frame(t, k, poses), placements) for t in self.overlays.frames)
                name = "" if shared else f" {_NAMES.get(table, f'table {number + 1}')}"
                where = partial(_frame, table, k)
                self._triad(f"meshcat/table{number}/{k}", f"{{{k}}}{name}", extent, (number, k), where, poses)
        if self.overlays.body_frame:
            self._triad("meshcat/body", "B", extent, (0, 3), partial(_frame, LECTURE_TABLE, 3), poses)

    def _triad(
        self,
        path: str,
        label: str,
        extent: Extent,
        place: tuple[int, int],
        where: Callable[[Array], Array],
        poses: Array,
    ) -> None:
        number, k = place
        length = (0.9 + 0.3 * number) * extent.unit
        shaft = shapes.arrow(0.07 - 0.02 * min(number, 2))
        for axis, turned in enumerate(_TO_AXIS):
            arrow = length * shaft[0] @ turned.T, shaft[1]
            self.stage.put(f"{path}/{'xyz'[axis]}", shapes.over(arrow, AXES[axis], order=_ABOVE + axis))
        name = shapes.word(label, INK, 0.42 * extent.unit, lying=False, order=_ABOVE + 5)
        self.stage.put(f"{path}name", name)
        away = extent.unit * (_AWAY[min(k, 3)] + np.array([0, -0.5 * number, 0]))
        self._rides(lambda poses: poses_of(path, where(poses)), poses)
        self._rides(lambda poses: [Channel(f"{path}name", "position", where(poses)[:, :3, 3] + away)], poses)

    def _arrows(self, run: Rollout, times: Array, poses: Array, extent: Extent, arrows: Arrows) -> None:
        now = times + 1e-9 * max(abs(times[-1]), 1.0)  # a frame at a sample is not before it
        held = np.clip(np.searchsorted(run.t, now, side="right") - 1, 0, len(run) - 1)
        fx, fy, moment = run.tau[held].T
        heading = np.column_stack([poses[:, :2], np.unwrap(np.arctan2(fy, fx))])
        flat = poses * (1, 1, 0)
        unit = extent.unit
        for name, symbol, shape, paint, size, per, turned in (
            ("force", "N", shapes.arrow(0.06), colour(3), np.hypot(fx, fy), arrows.force, heading),
            ("moment", "N m", shapes.arc_arrow(), colour(4), moment, arrows.moment, flat),
        ):
            largest = float(np.abs(size).max())
            if not largest > _NO_FORCE:
                continue
            scale = per or (1.6 if name == "force" else 0.8) * unit / largest
            path = f"meshcat/{name}"
            self.stage.put(path, shapes.over(shape, paint, order=_ABOVE - 5))
            lengths = np.maximum(scale * np.abs(size), 1e-4)[:, None] * np.ones(3)
            lengths[:, 1] *= np.where(size < 0, -1, 1)  # in a mirror the arc turns the other way
            self.channels += along(path, turned, 1.6 * self.robot.size[2])
            self.channels.append(Channel(path, "scale", lengths))
            self.legend.append([f"{name}, 1 m = {1 / scale:.2g} {symbol}", paint, "", 0.0])


_AWAY = np.array([[-0.45, -0.35, 0.0], [-0.45, -0.35, 0.0], [-1.1, -0.6, 0.0], [1.2, 0.5, 0.0]])
_TO_AXIS = (
    np.eye(3),
    np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
)


def _focus(poses: Array) -> list[Channel]:
    position = np.column_stack([poses[:, :2], np.zeros(len(poses))])
    return [Channel("meshcat/focus", "position", position)]


def _frame(table: DHTable, k: int, poses: Array) -> Array:
    """Return the placements of frame k of a table, shape (n, 4, 4)."""
    if k == 0:
        return np.broadcast_to(np.eye(4), (len(poses), 4, 4))
    return table.placements(poses[:, [1, 0, 2]])[:, k - 1]


def _poses(t: Array, q: Array, times: Array) -> Array:
    return sampled(times, t, np.column_stack([q[:, :2], np.unwrap(q[:, 2])]))


def _captions(runs: Mapping[str, Rollout], times: Array) -> list[str]:
    """Return time and position errors for each frame, changing ten times a second at most."""
    ticks = np.floor(10 * (times - times[0]) + 1e-6)
    first = np.searchsorted(ticks, ticks)  # the frame in which the tick began
    at = times[first]
    rows = {
        f"{label}  " if label else "": sampled(at, run.t, np.hypot(run.error[:, :1], run.error[:, 1:2]))[:, 0]
        for label, run in runs.items()
    }
    written: dict[int, str] = {}
    for k in np.unique(first):
        errors = [f"{label}{_length(values[k])}" for label, values in rows.items()]
        written[int(k)] = "\n".join([f"t = {times[k]:.1f} s", "position error", *errors])
    return [written[int(k)] for k in first]


def _length(value: float) -> str:
    for scale, unit in ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm")):
        if value >= 0.9995 * scale or unit == "nm":
            break
    return f"{value / scale:.{2 if value < 9.995 * scale else 1 if value < 99.95 * scale else 0}f} {unit}"
