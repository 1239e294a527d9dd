"""Objects of a scene: robots, ground, paths, trails, frames, arrows, captions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np

import pinmobile.viewer.contact_markers as markers
import pinmobile.viewer.motion as motion
import pinmobile.viewer.scene_tree as shapes
from pinmobile.arrays import Array
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHTable
from pinmobile.errors import InvalidArgument
from pinmobile.loop import EndEffector, Rollout
from pinmobile.palette import AXES, INK, QUIET, colour
from pinmobile.parts import TimeVarying, able
from pinmobile.plant import first_times, full_configurations
from pinmobile.viewer.motion import Channel, Drawn, frame_channels, interpolate, pose_channels, samples_before
from pinmobile.viewer.scene_tree import Arrows, Extent, Follow, Overlays, Stage, View, overview

_POSE = ("x", "y", "psi")


def _captions(
    runs: Mapping[str, Rollout], times: Array, effectors: Mapping[str, EndEffector | None]
) -> list[str]:
    """Return a caption with time and errors for each frame; it changes at most ten times per second.

    The caption contains the position error with the largest error of a revolute joint if there is one, and in
    separate lines the errors of an end effector with a target, and the kinds of events so far.

    Parameters
    ----------
    runs : mapping of str to Rollout
        Rollouts by label.
    times : ndarray, shape (n,)
        Times of the frames [s].
    effectors : mapping of str to EndEffector or None
        End effectors by label.
    """
    ticks = np.floor(10 * (times - times[0]) + 1e-6)
    first = np.searchsorted(ticks, ticks)  # the frame in which the tick began
    tick = times[first]
    heads = {label: f"{label}  " if label else "" for label in runs}

    def rows(columns: Mapping[str, list[Array]]) -> dict[str, Array]:
        present = {label: each for label, each in columns.items() if each}
        return {heads[x]: interpolate(tick, runs[x].t, np.column_stack(each)) for x, each in present.items()}

    path_errors = rows({label: _error_columns(run) for label, run in runs.items()})
    pose_errors = rows({label: markers.effector_errors(effectors.get(label)) for label in runs})
    events = {label: first_times(run.events) for label, run in runs.items()}
    texts: dict[int, str] = {}
    for k in np.unique(first):
        lines = [f"t = {times[k]:.1f} s", "position error", *_format_errors(path_errors, int(k), ", joint ")]
        lines += [f"end effector {words}" for words in _format_errors(pose_errors, int(k), ", ")]
        for label, kinds in events.items():
            names = ", ".join(kind for kind, t in kinds.items() if t <= times[k])
            lines += [f"{heads[label]}{names}"] if names else []
        texts[int(k)] = "\n".join(lines)
    return [texts[int(k)] for k in first]


def _format_errors(rows: Mapping[str, Array], k: int, comma: str) -> list[str]:
    """Return the errors of each run at a frame, as text."""
    return [
        label + comma.join(_format_si(*pair) for pair in zip(values[k].tolist(), ("m", "rad"), strict=False))
        for label, values in rows.items()
    ]


def _error_columns(run: Rollout) -> list[Array]:
    """Return the position error [m] and, if there is a revolute joint, the largest joint error [rad]."""
    revolute = [k for k, one in enumerate(run.coordinates) if one.name not in _POSE and one.unit == "rad"]
    return [run.distance, *([np.abs(run.error[:, revolute]).max(axis=1)] if revolute else [])]


def _format_si(value: float, unit: str) -> str:
    for scale, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
        if value >= 0.9995 * scale or prefix == "n":
            break
    digits = 2 if value < 9.995 * scale else 1 if value < 99.95 * scale else 0
    return f"{value / scale:.{digits}f} {prefix}{unit}"


_GRID, _PATH, _WORDS = 1, 8, 9

# Where the name of frame k stands, in lengths of the robot: frames 2 and 3 have one origin.
_LABEL_OFFSETS = np.array([[-0.45, -0.35, 0.0], [-0.45, -0.35, 0.0], [-1.1, -0.6, 0.0], [1.2, 0.5, 0.0]])
_AXIS_ROTATIONS = (
    np.eye(3),
    np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
)


def _draw_grid(stage: Stage, extent: Extent) -> None:
    """Draw the grid, and write x and y at its edges."""
    xs, ys, size = extent.lines(0), extent.lines(1), extent.font
    # WebGL's lines are a pixel wide, and a software one drops those that cross the camera's plane.
    lines = [np.array([[x, y0], [x, y1]]) for x in xs for y0, y1 in pairwise(ys)]
    lines += [np.array([[x0, y], [x1, y]]) for y in ys for x0, x1 in pairwise(xs)]
    stage.put("meshcat/grid", shapes.flat(shapes.bands(lines, 0.04 * size), "#c9cdd1", order=_GRID))
    words = [("x [m]", (xs[-1] + 1.6 * size, ys[0])), ("y [m]", (xs[0] + 1.4 * size, ys[-1] + 0.7 * size))]
    longest = max(len(f"{x:g}") for x in xs)
    spacing = int(np.ceil(0.7 * size * longest / extent.step))  # lines from one word to the next
    words += [(f"{x:g}", (x, ys[0] - 0.75 * size)) for x in xs if round(x / extent.step) % spacing == 0]
    words += [(f"{y:g}", (xs[0] - (0.4 + 0.25 * len(f"{y:g}")) * size, y)) for y in ys]
    for k, (text, (x, y)) in enumerate(words):
        stage.put(f"meshcat/scale/{k}", shapes.word(text, QUIET, size, lying=True, order=_WORDS))
        stage.set(f"meshcat/scale/{k}", "position", [float(x), float(y), 0.0])


def draw_path(stage: Stage, points: Array, extent: Extent) -> None:
    """Draw a reference path, shape (n, 2) [m], dashed."""
    points = points[:: max(len(points) // 4000, 1)]
    bands = shapes.dashes(points, extent.dash, lambda part: shapes.ribbon(part, 0.025 * extent.unit))
    if bands is not None:
        stage.put("meshcat/path", shapes.flat(bands, INK, order=_PATH))


def _draw_axes(stage: Stage, path: str, length: float, thickness: float) -> None:
    """Draw arrows of a length [m] along the axes of a node."""
    vertices, faces = shapes.arrow(thickness)
    for axis, rotation in enumerate(_AXIS_ROTATIONS):
        arrow = length * vertices @ rotation.T, faces
        stage.put(f"{path}/{'xyz'[axis]}", shapes.overlay(arrow, AXES[axis], order=markers.ABOVE + axis))


_Attachment = Callable[[Array], list[Channel]]
Placements = Callable[[Array], Array]  # from poses (n, 3) to placements (n, 4, 4)


_BASE_FORCES = ("Fx", "Fy", "Mz")
_FORCE_TOLERANCE = 1e-9  # [N or N m]; less is rounding
_NAMES = {LECTURE_TABLE: "lecture", SLIDE_TABLE: "slide"}


@dataclass
class Scene:
    """Scene of rollouts, or of a robot alone.

    Parameters
    ----------
    stage : Stage
        Stage of the scene.
    robot : MobileRobot or Drawing
        Robot for rollouts without a plant.
    overlays : Overlays
        Objects beside the robot.

    Attributes
    ----------
    channels : list of Channel
        Moving properties, with a value for each frame.
    attachments : list of callable
        Functions from poses of the robot to channels of objects that move with it.
    """

    stage: Stage
    robot: Drawn
    overlays: Overlays
    channels: list[Channel] = field(default_factory=list)
    attachments: list[_Attachment] = field(default_factory=list)
    legend: list[list[object]] = field(default_factory=list)

    def draw_robot(self, pose: Array, margin: float = 0.0) -> None:
        """Draw the robot alone at a configuration, shape (nq,), with some ground around it [m]."""
        poses = pose[None]
        reach, height = motion.envelope(self.robot, poses)
        radius = max(0.8 * max(self.robot.size), 0.75 * reach if self.robot.mounts else 0.0, margin)
        extent = Extent(pose[:2] - radius, pose[:2] + radius, (*self.robot.size[:2], height))
        self._set_up(extent, poses)
        self.stage.robot("meshcat/robot0", self.robot, colour(0))
        self._attach(partial(robot_channels, "meshcat/robot0", self.robot), poses)
        self._draw_tables(poses, extent)

    def move(self, pose: Array) -> None:
        """Move the robot and all attached objects to a configuration, shape (nq,)."""
        for attachment in self.attachments:
            self.stage.show(attachment(pose[None]), 0)

    def show(self, frame: int) -> None:
        """Show all objects at a frame."""
        self.stage.show(self.channels, frame)

    def _attach(self, attachment: _Attachment, poses: Array) -> None:
        self.attachments.append(attachment)
        self.channels += attachment(poses)

    def play(self, runs: Mapping[str, Rollout], times: Array) -> None:
        """Draw the rollouts: the first robot solid, the others translucent.

        Parameters
        ----------
        runs : mapping of str to Rollout
            Rollouts by label.
        times : ndarray, shape (n,)
            Times of the frames [s].
        """
        points = np.concatenate([q[:, :2] for run in runs.values() for q in (run.poses, run.reference_poses)])
        main = next(iter(runs.values()))
        robots = [self.robot if run.plant is None else motion.figure(run.plant) for run in runs.values()]
        poses = [
            motion.configurations(robot, run.t, run.q if _is_full(robot, run.plant) else run.poses, times)
            for robot, run in zip(robots, runs.values(), strict=True)
        ]
        reach, height = motion.envelope(robots[0], poses[0])
        room = reach - self.robot.size[0]
        extent = Extent(points.min(axis=0) - room, points.max(axis=0) + room, (*self.robot.size[:2], height))
        self._set_up(extent, poses[0])
        if self.overlays.path:
            draw_path(self.stage, main.reference_poses[:, :2], extent)
            self.legend.append(["desired", INK, "6 4", 0.0])
        tips = {label: markers.effector_of(run) for label, run in runs.items() if self.overlays.end_effector}
        for index, (label, run) in enumerate(runs.items()):
            path = f"meshcat/robot{index}"
            self.stage.robot(path, robots[index], colour(index), ghost=index > 0)
            self.channels += time_channels(path, run.plant, times)
            if index == 0:
                self._attach(partial(robot_channels, path, robots[0]), poses[0])
            else:
                self.channels += robot_channels(path, robots[index], poses[index])
            if self.overlays.trail:
                width = 0.05 * extent.unit * (1 + 0.9 * (len(runs) - 1 - index))
                self.channels += markers.draw_trail(
                    self.stage, f"meshcat/trail{index}", (run.t, run.poses[:, :2]), times,
                    partial(shapes.ribbon, width=width), color=colour(index), order=markers.TRAIL + index,
                )  # fmt: skip
            tip, flags = tips.get(label), self.overlays
            if tip is not None:
                self.channels += markers.draw_end_effector(
                    self.stage, index, tip, times, extent, path=flags.path and not index, trail=flags.trail
                )
                if index == 0:
                    _draw_axes(self.stage, "meshcat/tool", 0.3 * extent.unit, 0.08)
                    self.channels += frame_channels("meshcat/tool", tip.pose[samples_before(tip.t, times)])
            self.legend.append([label or "travelled", colour(index), "", 0.0 if index == 0 else 0.55])
        if self.overlays.desired:
            ghost = robots[0]
            self.stage.robot("meshcat/desired", ghost, QUIET, ghost=True)
            self.channels += time_channels("meshcat/desired", main.plant, times)
            is_full = _is_full(ghost, main.plant) and main.reference.q.shape == main.q.shape
            reference = main.reference.q if is_full else main.reference_poses
            if isinstance(ghost, motion.Drawing):  # coordinates without a reference keep their actual values
                reference = full_configurations(main.q, main.reference.q)
            desired = motion.configurations(ghost, main.t, reference, times)
            self.channels += robot_channels("meshcat/desired", ghost, desired)
            self.legend.append(["desired pose", QUIET, "", 0.5])
        if self.overlays.arrows is not None:
            self._draw_arrows(main, times, poses[0], extent, self.overlays.arrows)
        if self.overlays.contacts or self.overlays.centre:
            contacts = markers.contacts_at(main, times, poses[0])
            markings = [markers.draw_contacts(self.stage, contacts, extent)] if self.overlays.contacts else []
            if self.overlays.centre:
                markings.append(markers.draw_centre(self.stage, contacts.centre, poses[0], extent))
            for channels, entries in markings:
                self.channels += channels
                self.legend += entries
        self._draw_tables(poses[0], extent)
        if self.overlays.caption:
            self.channels.append(Channel("meshcat/stage", "caption", _captions(runs, times, tips)))
        self.stage.publish("legend", self.legend)

    def _set_up(self, extent: Extent, poses: Array) -> None:
        camera, ramp = self.overlays.camera, markers.ramp_of(self.robot)
        view = overview(extent, extent.size[2], low=bool(self.robot.mounts))
        if ramp is not None:
            view = markers.draw_ramp(self.stage, ramp, extent, view)
        if isinstance(camera, Follow):
            direction = (view.eye - view.target) / np.linalg.norm(view.eye - view.target)
            view = View(camera.distance * direction, np.zeros(3))
        else:
            pairs = zip((camera.eye, camera.target), view, strict=True)
            view = View(*(default if value is None else np.asarray(value) for value, default in pairs))
        self.stage.set_up(extent, view)
        if isinstance(camera, Follow):
            self._attach(_focus_channels, poses)
        if self.overlays.grid:
            _draw_grid(self.stage, extent)

    def _draw_tables(self, poses: Array, extent: Extent) -> None:
        others: list[Array] = []
        for number, table in enumerate(self.overlays.frames):
            for k in range(len(table) + 1):
                placements = _frame(table, k, poses)
                if any(np.allclose(placements, other) for other in others):
                    continue  # two tables share some of their frames
                others.append(placements)
                is_shared = all(np.allclose(_frame(t, k, poses), placements) for t in self.overlays.frames)
                name = "" if is_shared else f" {_NAMES.get(table, f'table {number + 1}')}"
                T_of = partial(_frame, table, k)
                self._triad(f"meshcat/table{number}/{k}", f"{{{k}}}{name}", extent, (number, k), T_of, poses)
        if self.overlays.body_frame:
            self._triad("meshcat/body", "B", extent, (0, 0), partial(_frame, LECTURE_TABLE, 3), poses)

    def _triad(
        self, path: str, label: str, extent: Extent, numbers: tuple[int, int], T_of: Placements, poses: Array
    ) -> None:
        """Draw the axes of a frame, and its name next to them; `numbers` are those of table and frame."""
        number, k = numbers
        _draw_axes(self.stage, path, (0.9 + 0.3 * number) * extent.unit, 0.07 - 0.02 * min(number, 2))
        name = shapes.word(label, INK, 0.42 * extent.unit, lying=False, order=markers.ABOVE + 5)
        self.stage.put(f"{path}name", name)
        shift = extent.unit * (_LABEL_OFFSETS[min(k, 3)] + np.array([0, -0.5 * number, 0]))
        self._attach(lambda poses: frame_channels(path, T_of(poses)), poses)
        self._attach(lambda poses: [Channel(f"{path}name", "position", T_of(poses)[:, :3, 3] + shift)], poses)

    def _draw_arrows(self, run: Rollout, times: Array, poses: Array, extent: Extent, arrows: Arrows) -> None:
        fx, fy, moment = run.u[samples_before(run.t, times)][:, _force_indices(run)].T
        heading = np.column_stack([poses[:, :2], np.unwrap(np.arctan2(fy, fx))])
        flat = poses[:, :3] * (1, 1, 0)
        unit = extent.unit
        for name, symbol, shape, color, size, unit_size, placement in (
            ("force", "N", shapes.arrow(0.06), colour(3), np.hypot(fx, fy), arrows.force, heading),
            ("moment", "N m", shapes.arc_arrow(), colour(4), moment, arrows.moment, flat),
        ):
            largest = float(np.abs(size).max())
            if not largest > _FORCE_TOLERANCE:
                continue
            scale = unit_size or (1.6 if name == "force" else 0.8) * unit / largest
            path = f"meshcat/{name}"
            self.stage.put(path, shapes.overlay(shape, color, order=markers.ABOVE - 5))
            lengths = np.maximum(scale * np.abs(size), 1e-4)[:, None] * np.ones(3)
            lengths[:, 1] *= np.where(size < 0, -1, 1)  # in a mirror the arc turns the other way
            self.channels += pose_channels(path, placement, 1.6 * (self.robot.top or self.robot.size[2]))
            self.channels.append(Channel(path, "scale", lengths))
            self.legend.append([f"{name}, 1 m = {1 / scale:.2g} {symbol}", color, "", 0.0])


def _force_indices(run: Rollout) -> list[int]:
    """Return the indices of the inputs that are the force and the moment on the base.

    Raises
    ------
    InvalidArgument
        If the plant has no such inputs.
    """
    names = [one.name for one in run.inputs]
    missing = [name for name in _BASE_FORCES if name not in names]
    if missing:
        raise InvalidArgument(
            f"overlays has arrows, which need the inputs {', '.join(_BASE_FORCES)}, but the plant has the "
            f"inputs {', '.join(names)}: use arrows=None"
        )
    return [names.index(name) for name in _BASE_FORCES]


def _focus_channels(poses: Array) -> list[Channel]:
    position = np.column_stack([poses[:, :2], np.zeros(len(poses))])
    return [Channel("meshcat/focus", "position", position)]


def _frame(table: DHTable, k: int, poses: Array) -> Array:
    """Return the placements of frame k of a table, shape (n, 4, 4)."""
    if k == 0:
        return np.broadcast_to(np.eye(4), (len(poses), 4, 4))
    order = [_POSE.index(name) for name in table.variables]
    return table.placements(poses[:, order])[:, k - 1]


def _is_full(robot: Drawn, plant: object) -> bool:
    """Return whether the representation follows all coordinates, not only the body."""
    return robot is plant or isinstance(robot, motion.Drawing)


def robot_channels(path: str, robot: Drawn, configurations: Array) -> list[Channel]:
    """Return the channels of the body and the links of a robot."""
    return [*pose_channels(path, configurations), *motion.links(path, robot, configurations)]


def time_channels(path: str, plant: object, times: Array) -> list[Channel]:
    """Return the channels of the objects of a robot that exist at some times only."""
    visible = timed.shown(times) if (timed := able(plant, TimeVarying)) else {}
    return [Channel(f"{path}/visuals/{name}", "visible", x[:, None]) for name, x in visible.items()]
