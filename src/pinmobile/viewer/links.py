"""What moves on the body: links of arms, over the frames of a recording, and the room that they take."""

from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot import BODY_JOINT, MobileRobot
from pinmobile.viewer.motion import Channel, poses_of, sampled

__all__ = ["configurations", "envelope", "figure", "links"]

_THICK = 0.1  # what a link has around the origin of its joint [m]


def figure(plant: Any) -> MobileRobot:
    """Return what is drawn of a plant: itself, or a box of its size where it does not say what it looks like.

    Raises
    ------
    InvalidArgument
        If it does not tell where its body is.
    """
    if isinstance(plant, type):
        raise InvalidArgument(f"plant is {shown(plant)}, expected a plant, not its class")
    if hasattr(plant, "frame_placements"):
        return plant  # type: ignore[no-any-return]
    if not callable(getattr(plant, "pose", None)):
        raise InvalidArgument(
            f"plant is {shown(plant)}, expected a MobileRobot, or a plant with pose(q), which returns x, y "
            "and psi"
        )
    size = getattr(plant, "size", None)
    return MobileRobot.box() if size is None else MobileRobot.box(size=size)


def configurations(robot: MobileRobot, t: Array, q: Array, times: Array) -> Array:
    """Return a robot's configurations at other times, psi unwrapped, straight between two samples.

    Parameters
    ----------
    robot : MobileRobot
        What is drawn. Of a motion that is not its own it follows x, y and psi alone, its arms at rest.
    t, q : ndarray, shape (N,) and (N, m)
        The motion.
    times : ndarray, shape (n,)
        Where it is wanted.

    Returns
    -------
    configurations : ndarray, shape (n, nq)
    """
    base = sampled(times, t, np.column_stack([q[:, :2], np.unwrap(q[:, 2])]))
    if robot.nq == len(base.T):
        return base
    if robot.nq != q.shape[1]:
        return np.hstack([base, np.broadcast_to(robot.rest[3:], (len(times), robot.nq - 3))])
    if robot.nq == robot.nv:
        return np.hstack([base, sampled(times, t, q[:, 3:])])
    before = np.clip(np.searchsorted(t, times, side="right") - 1, 0, max(len(t) - 2, 0))
    after = np.minimum(before + 1, len(t) - 1)
    span = np.where(after > before, t[after] - t[before], 1.0)
    share = np.clip((times - t[before]) / span, 0, 1)[:, None]
    full = robot.integrate(q[before], share * robot.difference(q[before], q[after]))
    full[:, :3] = base
    return full


def links(path: str, robot: MobileRobot, q: Array) -> list[Channel]:
    """Return the channels of a robot's links below the node of its body.

    Parameters
    ----------
    path : str
        The node, which is where the body is.
    robot : MobileRobot
        Whose `visual_model` was loaded there.
    q : ndarray, shape (n, nq)
        Its configurations.
    """
    moving = [item for item in robot.visual_model.geometryObjects if item.parentJoint > BODY_JOINT]
    if not moving:
        return []
    frames = _seen_from_body(robot, q)
    channels: list[Channel] = []
    for item in moving:
        placements = frames[:, item.parentJoint - 1] @ item.placement.homogeneous
        channels += poses_of(f"{path}/visuals/{item.name}", placements)
    return channels


def envelope(robot: MobileRobot, q: Array) -> tuple[float, float]:
    """Return how far its joints reach from the body's origin and above the ground [m], at least the body.

    Parameters
    ----------
    robot : MobileRobot
        The robot.
    q : ndarray, shape (n, nq)
        Its configurations.
    """
    length, _, height = robot.size
    height = height if robot.top is None else robot.top
    if not robot.mounts:
        return length, height
    origins = _seen_from_body(robot, q)[:, :, :3, 3]
    aside = float(np.hypot(origins[..., 0], origins[..., 1]).max())
    return max(length, aside + _THICK), max(height, float(origins[..., 2].max()) + _THICK)


def _seen_from_body(robot: MobileRobot, q: Array) -> Array:
    return robot.frame_placements(np.hstack([np.zeros((len(q), 3)), q[:, 3:]]))
