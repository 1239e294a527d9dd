"""Motion over the frames of a recording: links of robots, properties of nodes, animation tracks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinmobile.arrays import Array, bounded, finite, instance, shaped
from pinmobile.errors import InvalidArgument, format_value, unexpected_value
from pinmobile.loop import Rollout
from pinmobile.plant import all_samples, stated
from pinmobile.reaching import align_signs
from pinmobile.robot import BODY_JOINT, MobileRobot

_KINDS = {"position": "vector3", "scale": "vector3", "quaternion": "quaternion", "visible": "bool"}
_DIGITS = {"position": 5, "scale": 5, "quaternion": 6, "drawn": 1, "visible": 1}
_MAX_FRAMES = 200_000


@dataclass(frozen=True, eq=False)
class Channel:
    """Property of a node with a value for each frame.

    Parameters
    ----------
    path : str
        Path of the node, such as ``"meshcat/robot"``.
    name : str
        Name of the property: position, quaternion or scale, ``drawn`` (a number), ``visible`` (1 or 0) or
        ``caption`` (a text).
    values : ndarray, shape (n, k), or sequence of n str
        Value for each frame.
    """

    path: str
    name: str
    values: Array | Sequence[str]

    def at(self, frame: int) -> str | float | list[float]:
        """Return the value at a frame for meshcat."""
        value = self.values[frame]
        if isinstance(value, str):
            return value
        if self.name == "visible":
            return bool(value[0])
        return float(value[0]) if self.name == "drawn" else [float(x) for x in value]


def frame_times(runs: Mapping[str, Rollout], fps: float, speed: float) -> Array:
    """Return the times of the frames, shape (n,) [s], including the last sample.

    Parameters
    ----------
    runs : mapping of str to Rollout
        Rollouts by label.
    fps : float
        Frames per second.
    speed : float
        Seconds of the rollout per second of playback.

    Raises
    ------
    InvalidArgument
        If there are too many frames.
    """
    start, end = min(run.t[0] for run in runs.values()), max(run.t[-1] for run in runs.values())
    count = float(end - start) * fps / speed
    bounded("fps * duration / speed", count, most=_MAX_FRAMES, unit="frames")
    return np.append(start + np.arange(int(np.ceil(count - 1e-6))) * speed / fps, end)


def pose_channels(path: str, poses: Array, height: float = 0.0) -> list[Channel]:
    """Return the channels of a node that follows poses (x, y, psi), shape (n, 3) [m, m, rad]."""
    zero = np.zeros(len(poses))
    position = np.column_stack([poses[:, :2], zero + height])
    half = poses[:, 2] / 2
    quaternion = np.column_stack([zero, zero, np.sin(half), np.cos(half)])
    return [Channel(path, "position", position), Channel(path, "quaternion", quaternion)]


def frame_channels(path: str, placements: Array) -> list[Channel]:
    """Return the channels of a node at placements, shape (n, 4, 4)."""
    quaternions = align_signs(_quaternions(placements[:, :3, :3]))
    return [Channel(path, "position", placements[:, :3, 3]), Channel(path, "quaternion", quaternions)]


def interpolate(times: Array, t: Array, values: Array) -> Array:
    """Return values, shape (N, k), at other times, shape (n,), by linear interpolation."""
    return np.stack([np.interp(times, t, column) for column in values.T], axis=-1)


def samples_before(t: Array, times: Array) -> NDArray[np.intp]:
    """Return the index of the sample of t, shape (N,), at or before each of the times, shape (n,)."""
    shifted = times + 1e-9 * max(abs(times[-1]), 1.0)  # a frame at a sample is not before it
    return np.asarray(np.clip(np.searchsorted(t, shifted, side="right") - 1, 0, len(t) - 1), np.intp)


def tracks(channels: Iterable[Channel], times: Array, end: float) -> list[dict[str, Any]]:
    """Return meshcat animations with few digits and without repeated keys.

    Parameters
    ----------
    channels : iterable of Channel
        Moving properties.
    times : ndarray, shape (n,)
        Times of the frames [s], from 0.
    end : float
        Time after which the animation repeats [s].
    """
    by_path: dict[str, list[dict[str, Any]]] = {}
    for channel in channels:
        by_path.setdefault(channel.path, []).append(_track(channel, times))
    clip = {"fps": 1, "name": "default", "duration": round(end, 4)}
    return [{"path": path, "clip": {**clip, "tracks": parts}} for path, parts in by_path.items()]


def _track(channel: Channel, times: Array) -> dict[str, Any]:
    if channel.name in _DIGITS:
        values = np.round(np.asarray(channel.values, np.float64), _DIGITS[channel.name]) + 0.0
        is_new = np.any(values[1:] != values[:-1], axis=1)
        is_key = np.concatenate([[True], is_new]) | np.concatenate([is_new, [False]])
        is_key[-1] |= bool(is_new.any())
        entries: list[float | str] = [int(x) if x == int(x) else x for x in values[is_key].ravel().tolist()]
        kind = _KINDS.get(channel.name, "number")
        if kind == "bool":  # three.js hides an object only if the value is false, not 0
            entries = [bool(x) for x in entries]
    else:
        entries = list(channel.values)
        is_key = np.array([True, *(a != b for a, b in pairwise(entries))])
        entries = [text for text, keep in zip(entries, is_key, strict=True) if keep]
        kind = "string"
    key_times = np.round(times[is_key], 4).tolist()
    return {"name": f".{channel.name}", "type": kind, "times": key_times, "values": entries}


def _quaternions(R: Array) -> Array:
    """Return (x, y, z, w) of rotations, shape (n, 3, 3), by the largest of the four (Shepperd, 1978)."""
    trace = np.trace(R, axis1=1, axis2=2)
    diagonal = np.diagonal(R, axis1=1, axis2=2)
    squares = np.column_stack([1 + 2 * diagonal - trace[:, None], 1 + trace])
    candidates = np.empty((len(R), 4, 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        candidates[:, i, i] = squares[:, i]
        candidates[:, i, j] = R[:, j, i] + R[:, i, j]
        candidates[:, i, k] = R[:, k, i] + R[:, i, k]
        candidates[:, i, 3] = R[:, k, j] - R[:, j, k]
        candidates[:, 3, i] = R[:, k, j] - R[:, j, k]
    candidates[:, 3, 3] = squares[:, 3]
    best = candidates[np.arange(len(R)), squares.argmax(axis=1)]
    return np.asarray(best / np.linalg.norm(best, axis=1, keepdims=True))


_MAX_POSTURES = 50  # largest number of configurations that determine the reach of a drawing
_LINK_RADIUS = 0.1  # [m], assumed radius of a link around the origin of its joint


class Drawing:
    """Visual geometry of a plant: the objects of its ``visual_model`` at the poses ``drawing(q)``.

    A scene moves the node of the body by x, y and psi, and the objects below relative to this node. The
    configurations of a drawing are therefore rows of (x, y, psi, q).

    Parameters
    ----------
    plant : plant
        Plant with ``visual_model``, ``drawing`` and ``pose``.

    Raises
    ------
    InvalidArgument
        If ``visual_model`` is not a geometry model or is empty.
    """

    top: float | None = None

    def __init__(self, plant: Any) -> None:
        self.plant, self.size = plant, getattr(plant, "size", MobileRobot.box().size)
        self.mounts = tuple(getattr(plant, "mounts", ()))
        words = "a pin.GeometryModel, since the plant has drawing(q)"
        given = instance("plant.visual_model", stated(plant, "visual_model"), pin.GeometryModel, words)
        self.model, self.visual_model = pin.Model(), pin.GeometryModel()
        for item in given.geometryObjects:
            copy = item.copy()
            copy.parentJoint, copy.placement = 0, pin.SE3.Identity()
            self.visual_model.addGeometryObject(copy)

    def drawing(self, q: Array) -> Array:
        """Return the placements of the objects in the inertial frame, shape (k, 4, 4).

        Raises
        ------
        InvalidArgument
            If the plant returns another shape.
        """
        answer, count = self.plant.drawing(q.copy()), self.visual_model.ngeoms
        try:
            placements = np.asarray([getattr(each, "homogeneous", each) for each in answer], np.float64)
        except (TypeError, ValueError):
            placements = np.empty(0)
        if placements.shape != (count, 4, 4):
            raise InvalidArgument(
                f"plant.drawing(q) returned {format_value(answer)}, expected the placements of its {count} "
                f"objects, shape ({count}, 4, 4)"
            )
        return finite("plant.drawing(q)", placements)

    def row(self, q: Array) -> Array:
        """Return the row (x, y, psi, q), shape (3 + nq,), of a configuration of the plant, shape (nq,)."""
        return np.append(np.asarray(self.plant.pose(q.copy()), np.float64), q)

    def rows(self, t: Array, q: Array, times: Array) -> Array:
        """Return rows at other times, shape (n, 3 + nq), interpolated between samples at t, shape (N,)."""
        shaped("rollout.q", q, ("N", self.plant.nq), words=", as the plant has")
        poses = all_samples(self.plant, "pose", q)
        base = interpolate(times, t, np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]))
        first = np.clip(np.searchsorted(t, times, side="right") - 1, 0, max(len(t) - 2, 0))
        second = np.minimum(first + 1, len(t) - 1)
        span = np.where(second > first, t[second] - t[first], 1.0)
        share = np.clip((times - t[first]) / span, 0, 1)[:, None]
        steps = all_samples(self.plant, "difference", q[first], q[second])
        return np.hstack([base, all_samples(self.plant, "integrate", q[first], share * steps)])

    def body_placements(self, rows: Array) -> Array:
        """Return the placements of the objects below the body's node, shape (n, k, 4, 4)."""
        body = np.zeros((len(rows), 4, 4))
        c, s = np.cos(rows[:, 2]), np.sin(rows[:, 2])
        body[:, 0, 0], body[:, 0, 1], body[:, 1, 0], body[:, 1, 1] = c, s, -s, c
        body[:, 0, 3], body[:, 1, 3] = -c * rows[:, 0] - s * rows[:, 1], s * rows[:, 0] - c * rows[:, 1]
        body[:, 2, 2] = body[:, 3, 3] = 1.0
        return np.asarray(body[:, None] @ np.stack([self.drawing(q) for q in rows[:, 3:]]))


Drawn: TypeAlias = MobileRobot | Drawing
"""Visual representation of a plant in a scene, the result of `figure`."""


def figure(plant: Any) -> Drawn:
    """Return the visual representation of a plant: the plant itself, its `Drawing`, or a box of its size.

    Raises
    ------
    InvalidArgument
        If the plant has no pose.
    """
    if not isinstance(plant, type) and stated(plant, "frame_placements") is not None:
        robot: MobileRobot = plant
        return robot
    if isinstance(plant, type) or not callable(stated(plant, "pose")):
        expected = "a MobileRobot, or a plant with pose(q), which returns x, y and psi"
        raise unexpected_value("plant", plant, expected)
    if stated(plant, "drawing") is not None:
        return Drawing(plant)
    size = stated(plant, "size")
    return MobileRobot.box() if size is None else MobileRobot.box(size=size)


def row_of(robot: Drawn, plant: Any, q: Array) -> Array:
    """Return a configuration of a plant, shape (nq,), as a configuration of its visual representation."""
    if isinstance(robot, Drawing):
        return robot.row(q)
    return q if robot is plant else np.asarray(plant.pose(q))


def configurations(robot: Drawn, t: Array, q: Array, times: Array) -> Array:
    """Return a robot's configurations at other times by interpolation, with psi unwrapped.

    Parameters
    ----------
    robot : MobileRobot or Drawing
        Visual representation. For a motion of another robot, it follows x, y and psi, with its arms at rest.
    t, q : ndarray, shape (N,) and (N, m)
        Times [s] and configurations of the motion.
    times : ndarray, shape (n,)
        Other times [s].

    Returns
    -------
    configurations : ndarray, shape (n, nq)
    """
    if isinstance(robot, Drawing):
        return robot.rows(t, q, times)
    base = interpolate(times, t, np.column_stack([q[:, :2], np.unwrap(q[:, 2])]))
    if robot.nq == len(base.T):
        return base
    if robot.nq != q.shape[1]:
        return np.hstack([base, np.broadcast_to(robot.rest[3:], (len(times), robot.nq - 3))])
    return np.hstack([base, interpolate(times, t, q[:, 3:])])


def links(path: str, robot: Drawn, q: Array) -> list[Channel]:
    """Return the channels of a robot's links below the node of its body.

    Parameters
    ----------
    path : str
        Path of the node of the body.
    robot : MobileRobot or Drawing
        Robot with geometry below this node.
    q : ndarray, shape (n, nq)
        Configurations.
    """
    items = list(robot.visual_model.geometryObjects)
    if isinstance(robot, Drawing):
        placements = list(np.moveaxis(robot.body_placements(q), 1, 0))
    else:
        items = [item for item in items if item.parentJoint > BODY_JOINT]
        frames = _body_placements(robot, q) if items else q
        placements = [frames[:, item.parentJoint - 1] @ item.placement.homogeneous for item in items]
    pairs = zip(items, placements, strict=True)
    return [channel for item, T in pairs for channel in frame_channels(f"{path}/visuals/{item.name}", T)]


def envelope(robot: Drawn, q: Array) -> tuple[float, float]:
    """Return the horizontal reach of the robot from the body origin, and its height above the ground [m].

    Parameters
    ----------
    robot : MobileRobot or Drawing
        Visual representation.
    q : ndarray, shape (n, nq)
        Configurations.
    """
    length, _, height = robot.size
    height = height if robot.top is None else robot.top
    if not robot.mounts:
        return length, height
    if isinstance(robot, Drawing):
        origins = robot.body_placements(q[:: -(-len(q) // _MAX_POSTURES)])[:, :, :3, 3]
    else:
        origins = _body_placements(robot, q)[:, :, :3, 3]
    reach = float(np.hypot(origins[..., 0], origins[..., 1]).max())
    return max(length, reach + _LINK_RADIUS), max(height, float(origins[..., 2].max()) + _LINK_RADIUS)


def _body_placements(robot: MobileRobot, q: Array) -> Array:
    return robot.frame_placements(np.hstack([np.zeros((len(q), 3)), q[:, 3:]]))
