"""What of a robot may touch something: convex shapes of its links, on what moves together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.errors import InvalidArgument
from pinmobile.robot.arms import link_of
from pinmobile.robot.joints import BODY_JOINT
from pinmobile.robot.mounts import Load, Mount, named_frames
from pinmobile.robot.visuals import FileShapes, VisualFile, joints_above

BODY_LINK = "base_link"
"""Link of the body that is a box."""


class Solid(NamedTuple):
    """A shape of a link.

    Attributes
    ----------
    link : str
        Whose it is.
    part : int
        What it moves with: 0 the body, k the arms' k-th joint in the model.
    placement : pin.SE3
        In the frame of that joint, or of the body.
    geometry : coal.CollisionGeometry
        Convex: of a mesh its hull.
    mesh : coal.BVHModelBase or None
        The mesh itself.
    joints : tuple of str
        Joints of the base's file that would move it, the nearest first; locked here.
    """

    link: str
    part: int
    placement: pin.SE3
    geometry: Any
    mesh: Any = None
    joints: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Solids:
    """The shapes of a robot, and how its parts hang together.

    Parameters
    ----------
    shapes : tuple of Solid
        One or more of each link.
    parents : tuple of int
        Of each part the one that carries it; -1 of the body.
    moves : tuple of slice
        Of each part, the coordinates of its joint in v; none of the body.
    standing : frozenset of str
        Links that are on the ground by definition, such as wheels.
    """

    shapes: tuple[Solid, ...]
    parents: tuple[int, ...]
    moves: tuple[slice, ...]
    standing: frozenset[str] = frozenset()

    @classmethod
    def on(cls, model: pin.Model, shapes: Iterable[Solid]) -> Solids:
        """Return those on the joints of a robot's model."""
        joints = range(BODY_JOINT + 1, model.njoints)
        parents = (-1, *(model.parents[joint] - BODY_JOINT for joint in joints))
        starts = ((model.idx_vs[joint], model.nvs[joint]) for joint in joints)
        return cls(tuple(shapes), parents, (slice(0, 0), *(slice(k, k + n) for k, n in starts)))


def body_shapes(looks: VisualFile | None, source: str) -> Iterator[Solid]:
    """Return the shapes of the body of a robot from a file, and of what is locked to it.

    Parameters
    ----------
    looks : VisualFile or None
        The file that it was read from.
    source : str
        Where its numbers come from, for the message.

    Raises
    ------
    InvalidArgument
        If it has none, or its file or a mesh cannot be read.
    """
    if looks is None:
        raise InvalidArgument(
            f"robot has a body without collision shapes ({source}), expected one made from numbers, or from "
            "a URDF whose links have <collision>"
        )
    model, shapes = FileShapes(looks.path, looks.package_dirs).at_rest()
    if not shapes.ngeoms:
        raise InvalidArgument(
            f"robot has a body without collision shapes: {looks.path.name} has no link with <collision>"
        )
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    base = pin.SE3(np.reshape(looks.base, (4, 4))).inverse()
    for item in shapes.geometryObjects:
        placement = base * data.oMi[item.parentJoint] * item.placement
        yield from _solid(link_of(item, model), 0, placement, item, joints_above(model, item.parentJoint))


def body_box(size: Sequence[float], bottom: float = 0.0) -> Solid:
    """Return the box that a body made from numbers is, its top at its height.

    Parameters
    ----------
    size : sequence of 3 floats
        Length, width and height of its top [m].
    bottom : float
        Height of its lower face, where wheels carry it [m].
    """
    import coal

    length, width, height = size
    middle = np.array([0.0, 0.0, (height + bottom) / 2])
    return Solid(BODY_LINK, 0, pin.SE3(np.eye(3), middle), coal.Box(length, width, height - bottom))


def carried_shapes(model: pin.Model, mounts: Sequence[Mount], loads: Sequence[Load]) -> Iterator[Solid]:
    """Return the shapes of arms, and the boxes of loads that have a size, on the parts of the whole model.

    Raises
    ------
    InvalidArgument
        If an arm has none, or its file or a mesh cannot be read.
    """
    import coal

    for mount in mounts:
        shapes, links = mount.arm.solids()
        if not shapes.ngeoms:
            raise InvalidArgument(
                f"robot has an arm {mount.name!r} without collision shapes, expected one whose URDF has "
                "links with <collision>, or mount(model, collision=geometry)"
            )
        for item, link in zip(shapes.geometryObjects, links, strict=True):
            own = item.parentJoint
            part = mount.joints.start + own - 1 - BODY_JOINT if own else 0
            placement = item.placement if own else mount.placement * item.placement
            yield from _solid(f"{mount.name}/{link}", part, placement, item)
    frames = named_frames(model)
    for k, load in enumerate(loads, start=1):
        if load.size is not None:
            frame = model.frames[frames[load.frame]]
            placement = frame.placement * pin.SE3(np.eye(3), np.array(load.com))
            yield Solid(f"load {k}", frame.parentJoint - BODY_JOINT, placement, coal.Box(*load.size))


def _solid(
    link: str, part: int, placement: pin.SE3, item: pin.GeometryObject, joints: tuple[str, ...] = ()
) -> Iterator[Solid]:
    """Return a shape made convex; nothing of a placeholder without extent."""
    geometry = item.geometry
    mesh = geometry if hasattr(geometry, "num_tris") else None
    if mesh is not None:
        geometry = _hull(mesh, link)
    geometry.computeLocalAABB()
    if geometry.aabb_radius > 0:
        yield Solid(link, part, placement, geometry, mesh, joints)


def _hull(mesh: Any, link: str) -> Any:
    """Return the convex hull of a mesh."""
    copy = mesh.clone()
    try:
        copy.buildConvexHull(True, "Qt")
    except (ValueError, RuntimeError) as error:
        raise InvalidArgument(
            f"link {link!r} has a collision mesh without convex hull, expected points that are not all in "
            f"one plane: {str(error).splitlines()[0] if str(error) else 'qhull fails'}"
        ) from None
    return copy.convex
