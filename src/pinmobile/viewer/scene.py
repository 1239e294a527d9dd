"""What stands and moves on the stage: robots, paths, trails, frames, arrows, words."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHTable
from pinmobile.plant import whole_configurations
from pinmobile.simulation import Rollout
from pinmobile.viewer import shapes
from pinmobile.viewer.captions import captions
from pinmobile.viewer.ground import ABOVE, TRAIL, draw_grid, draw_path, draw_triad
from pinmobile.viewer.links import configurations, envelope, figure, links
from pinmobile.viewer.motion import Channel, along, poses_of
from pinmobile.viewer.overlays import Arrows, Follow, Overlays, Stay, View, pushing
from pinmobile.viewer.palette import INK, QUIET, colour
from pinmobile.viewer.stage import Extent, Stage, overview

Rider = Callable[[Array], list[Channel]]
Where = Callable[[Array], Array]  # from poses (n, 3) to placements (n, 4, 4)

__all__ = ["Rider", "Scene", "Where"]

_SPREAD = 2500  # points of a trail at most
_NO_FORCE = 1e-9  # [N or N m]; less is rounding
_NAMES = {LECTURE_TABLE: "lecture", SLIDE_TABLE: "slide"}


@dataclass
class Scene:
    """Everything that is drawn of some rollouts, or of a robot alone.

    Parameters
    ----------
    stage : Stage
        Where.
    robot : MobileRobot or Drawing
        Drawn where a rollout does not know its plant.
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
    robot: Any
    overlays: Overlays
    channels: list[Channel] = field(default_factory=list)
    riders: list[Rider] = field(default_factory=list)
    legend: list[list[object]] = field(default_factory=list)

    def alone(self, pose: Array) -> None:
        """Draw the robot at a configuration, shape (nq,), around which one looks."""
        poses = pose[None]
        reach, height = envelope(self.robot, poses)
        room = max(2.5 * max(self.robot.size), 1.2 * reach)
        extent = Extent(pose[:2] - room, pose[:2] + room, (*self.robot.size[:2], height))
        self._furnish(extent, poses)
        self.stage.robot("meshcat/robot0", self.robot, colour(0))
        self._rides(partial(_ridden, "meshcat/robot0", self.robot), poses)
        self._tables(poses, extent)

    def move(self, pose: Array) -> None:
        """Put the robot, and what moves with it, at a configuration, shape (nq,)."""
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
        points = np.concatenate([q[:, :2] for run in runs.values() for q in (run.poses, run.reference_poses)])
        main = next(iter(runs.values()))
        robots = [self.robot if run.plant is None else figure(run.plant) for run in runs.values()]
        poses = [
            configurations(robot, run.t, run.q if _is_of(robot, run.plant) else run.poses, times)
            for robot, run in zip(robots, runs.values(), strict=True)
        ]
        reach, height = envelope(robots[0], poses[0])
        room = reach - self.robot.size[0]
        extent = Extent(points.min(axis=0) - room, points.max(axis=0) + room, (*self.robot.size[:2], height))
        self._furnish(extent, poses[0])
        if self.overlays.path:
            draw_path(self.stage, main, extent)
            self.legend.append(["desired", INK, "6 4", 0.0])
        for index, (label, run) in enumerate(runs.items()):
            path = f"meshcat/robot{index}"
            self.stage.robot(path, robots[index], colour(index), ghost=index > 0)
            if index == 0:
                self._rides(partial(_ridden, path, robots[0]), poses[0])
            else:
                self.channels += _ridden(path, robots[index], poses[index])
            if self.overlays.trail:
                self._trail(index, len(runs), run, times, extent)
            self.legend.append([label or "travelled", colour(index), "", 0.0 if index == 0 else 0.55])
        if self.overlays.desired:
            ghost = robots[0]
            self.stage.robot("meshcat/desired", ghost, QUIET, ghost=True)
            whole = _is_of(ghost, main.plant) and main.reference.q.shape == main.q.shape
            wanted = main.reference.q if whole else main.reference_poses
            if hasattr(ghost, "drawing"):  # what has no reference is drawn as it is
                wanted = whole_configurations(ghost.plant, main.q, main.reference.q)
            desired = configurations(ghost, main.t, wanted, times)
            self.channels += _ridden("meshcat/desired", ghost, desired)
            self.legend.append(["desired pose", QUIET, "", 0.5])
        if self.overlays.arrows is not None:
            self._arrows(main, times, poses[0], extent, self.overlays.arrows)
        self._tables(poses[0], extent)
        if self.overlays.caption:
            self.channels.append(Channel("meshcat/stage", "caption", captions(runs, times)))
        self.stage.tell("legend", self.legend)

    def _furnish(self, extent: Extent, poses: Array) -> None:
        camera = self.overlays.camera
        view = overview(extent, extent.size[2], low=bool(self.robot.mounts))
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
            draw_grid(self.stage, extent)

    def _trail(self, index: int, count: int, run: Rollout, times: Array, extent: Extent) -> None:
        kept = np.unique(np.append(np.arange(0, len(run), -(-len(run) // _SPREAD)), len(run) - 1))
        width = 0.05 * extent.unit * (1 + 0.9 * (count - 1 - index))
        band = shapes.ribbon(run.poses[kept, :2], width)
        path = f"meshcat/trail{index}/<object>"
        self.stage.put(
            path.removesuffix("/<object>"), shapes.flat(band, colour(index), order=TRAIL + index, trail=True)
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
            self._triad("meshcat/body", "B", extent, (0, 0), partial(_frame, LECTURE_TABLE, 3), poses)

    def _triad(
        self, path: str, label: str, extent: Extent, place: tuple[int, int], where: Where, poses: Array
    ) -> None:
        away = draw_triad(self.stage, path, label, extent, place)
        self._rides(lambda poses: poses_of(path, where(poses)), poses)
        self._rides(lambda poses: [Channel(f"{path}name", "position", where(poses)[:, :3, 3] + away)], poses)

    def _arrows(self, run: Rollout, times: Array, poses: Array, extent: Extent, arrows: Arrows) -> None:
        now = times + 1e-9 * max(abs(times[-1]), 1.0)  # a frame at a sample is not before it
        held = np.clip(np.searchsorted(run.t, now, side="right") - 1, 0, len(run) - 1)
        fx, fy, moment = run.u[np.ix_(held, pushing(run))].T
        heading = np.column_stack([poses[:, :2], np.unwrap(np.arctan2(fy, fx))])
        flat = poses[:, :3] * (1, 1, 0)
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
            self.stage.put(path, shapes.over(shape, paint, order=ABOVE - 5))
            lengths = np.maximum(scale * np.abs(size), 1e-4)[:, None] * np.ones(3)
            lengths[:, 1] *= np.where(size < 0, -1, 1)  # in a mirror the arc turns the other way
            self.channels += along(path, turned, 1.6 * (self.robot.top or self.robot.size[2]))
            self.channels.append(Channel(path, "scale", lengths))
            self.legend.append([f"{name}, 1 m = {1 / scale:.2g} {symbol}", paint, "", 0.0])


def _focus(poses: Array) -> list[Channel]:
    position = np.column_stack([poses[:, :2], np.zeros(len(poses))])
    return [Channel("meshcat/focus", "position", position)]


def _frame(table: DHTable, k: int, poses: Array) -> Array:
    """Return the placements of frame k of a table, shape (n, 4, 4)."""
    if k == 0:
        return np.broadcast_to(np.eye(4), (len(poses), 4, 4))
    return table.placements(poses[:, [1, 0, 2]])[:, k - 1]


def _is_of(robot: Any, plant: Any) -> bool:
    """Tell whether what is drawn takes all configurations, as of its own plant, or those of the body."""
    return robot is plant or hasattr(robot, "drawing")


def _ridden(path: str, robot: Any, configurations: Array) -> list[Channel]:
    """Return the channels of a robot, body and links."""
    return [*along(path, configurations), *links(path, robot, configurations)]
