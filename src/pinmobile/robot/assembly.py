"""The one model of a body, its arms and its loads; its frames by name, and its limits."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.robot.mounts import Load, Mount, free_name
from pinmobile.robot.tree import parts_of

__all__ = ["assemble", "limits", "named_frames", "prefixed", "resistances"]

_FAR = 1e8  # beyond, a limit is none


def assemble(base: pin.Model, mounts: Sequence[Mount], loads: Sequence[tuple[str, Load]]) -> pin.Model:
    """Return the model of a body that carries arms, and loads at frames of either.

    Parameters
    ----------
    base : pin.Model
        The chain with the body; the body's frame is its last.
    mounts : sequence of Mount
        One after the other.
    loads : sequence of (str, Load)
        Each with the frame it is fixed to.
    """
    model, body = base.copy(), base.nframes - 1
    for mount in mounts:
        model = pin.appendModel(model, prefixed(mount._model, mount.name), body, mount.placement)
    for mount in mounts:
        # Pinocchio forgets it when it appends; each arm keeps its own, joint by joint.
        model.armature[mount.v] = mount._model.armature
    model.name = base.name
    for frame, load in loads:
        fixed = model.frames[named_frames(model)[frame]]
        model.appendBodyToJoint(fixed.parentJoint, load.body, fixed.placement)
    return model


def named_frames(model: pin.Model) -> dict[str, int]:
    """Return the frames by name, links before joints of the same name."""
    ids: dict[str, int] = {}
    for number in range(1, model.nframes):
        frame = model.frames[number]
        if frame.name not in ids or frame.type == pin.FrameType.BODY:
            ids[frame.name] = number
    return ids


def prefixed(model: pin.Model, name: str) -> pin.Model:
    """Return a copy with all names ``name/...``; a frame is numbered where a link has its name."""
    copy = model.copy()
    for joint in range(1, copy.njoints):
        copy.names[joint] = f"{name}/{copy.names[joint]}"
    taken = {frame.name for frame in copy.frames if frame.type == pin.FrameType.BODY}
    for frame in copy.frames:
        own = str(frame.name)
        if frame.type != pin.FrameType.BODY:
            # Pinocchio finds a link by its name alone.
            own = free_name(own, taken)
            taken.add(own)
        frame.name = f"{name}/{own}"
    return copy


def limits(model: pin.Model, mounts: Sequence[Mount]) -> tuple[Array, Array, Array, Array]:
    """Return lower and upper limits, shape (nq,), and those of velocity and effort, shape (nv,).

    Infinite where there is none, as of the whole base: the order of its coordinates does not matter.
    """
    lower, upper = np.full(model.nq, -np.inf), np.full(model.nq, np.inf)
    speed, effort = np.full(model.nv, np.inf), np.full(model.nv, np.inf)
    for mount in mounts:
        for joint in range(mount.joints.start, mount.joints.stop):
            q, v = parts_of(model, joint)
            least, most = model.lowerPositionLimit[q], model.upperPositionLimit[q]
            # Files write equal limits, or zero, where they know none.
            if model.nqs[joint] == model.nvs[joint]:
                known = least < most
                lower[q] = np.where(known & (least > -_FAR), least, -np.inf)
                upper[q] = np.where(known & (most < _FAR), most, np.inf)
            for target, source in ((speed, model.velocityLimit), (effort, model.effortLimit)):
                target[v] = np.where((source[v] > 0) & (source[v] < _FAR), source[v], np.inf)
    return lower, upper, speed, effort


def resistances(nv: int, mounts: Sequence[Mount]) -> tuple[Array, Array]:
    """Return damping and friction of the joints, each of shape (nv,); the base has none."""
    damping, friction = np.zeros((2, nv))
    for mount in mounts:
        damping[mount.v], friction[mount.v] = mount._model.damping, mount._model.friction
    return damping, friction
