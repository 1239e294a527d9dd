"""The shapes of a URDF's links, the wheels among them, and how the robot stands on the ground by them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, finite
from pinmobile.errors import InvalidArgument
from pinmobile.robot.linkage import children, turns_freely
from pinmobile.robot.support_geometry import Stance, hull, margin_inside
from pinmobile.robot.urdf_checks import numbers
from pinmobile.robot.visuals import VisualFile, found

_ALONG = 0.995
"""Cosine beyond which two directions are the same: files have angles such as 1.57."""
_DIMENSIONS = {"box": "size", "cylinder": "radius length", "capsule": "radius length", "sphere": "radius"}
TOUCH = 0.005
"""What is so near the ground, or one plane, stands on it [m]."""

_ROUNDING = 1e-9  # [m]
_LEVEL = 0.1  # sine of the angle by which an axle may be off level: files have angles such as 1.57
_FOOTPRINT = "base_footprint"  # REP-120: the link that is on the ground, whatever namespace is before it


@dataclass(frozen=True, eq=False)
class Shape:
    """A box, a cylinder along z, a capsule along z, a sphere, or a mesh, fixed to a joint.

    Parameters
    ----------
    link : str
        Whose it is.
    joint : int
        What that is fixed to.
    placement : pin.SE3
        Pose in the joint's frame.
    half : tuple of 3 floats
        Of a box, half its sides; along z, half the length of a cylinder [m].
    disc, ball : float
        Radius of a cylinder; of a sphere, or of a capsule's ends [m].
    collides : bool
        Whether it is collision geometry; else what is drawn of a link that has none.
    mesh : str
        Name of the file, of a mesh.
    scale : tuple of 3 floats
        Of the mesh.
    """

    link: str
    joint: int
    placement: pin.SE3
    half: tuple[float, ...] = (0.0, 0.0, 0.0)
    disc: float = 0.0
    ball: float = 0.0
    collides: bool = True
    mesh: str = ""
    scale: tuple[float, ...] = (1.0, 1.0, 1.0)

    def reach(self, rotation: Array) -> float:
        """Return how far it reaches above its origin, and below it, when so turned; not of a mesh [m]."""
        up = rotation[2]  # the vertical, in the shape's frame
        return float(np.abs(up) @ self.half + self.disc * np.hypot(up[0], up[1]) + self.ball)

    def radius_about(self, axis: Array) -> float | None:
        """Return its radius about an axis in its frame, or None where it is not round about it [m]."""
        if self.disc:
            return self.disc if abs(axis[2]) > _ALONG else None
        return self.ball if self.ball and not self.half[2] else None

    def corners_below(self, pose: pin.SE3) -> Array | None:
        """Return the corners of the lower face of a box that lies level at a pose, shape (4, 2) [m]."""
        steep = np.abs(pose.rotation[2])
        if not self.half[0] or steep.max() < _ALONG:
            return None
        edges = pose.rotation * self.half  # (3, 3), a column for each
        a, b = np.delete(edges[:2], int(steep.argmax()), axis=1).T
        return np.asarray(pose.translation[:2] + np.array([-a - b, a - b, a + b, b - a]))

    def highest(self, pose: pin.SE3, file: VisualFile) -> float | None:
        """Return the height of its highest point at a pose; None of a mesh that cannot be read [m]."""
        if not self.mesh:
            return float(pose.translation[2]) + self.reach(pose.rotation)
        import coal

        path = found(self.mesh, file)
        if path is None:
            return None
        try:
            vertices = coal.MeshLoader().load(str(path), np.array(self.scale)).vertices()
        except (ValueError, RuntimeError):
            return None
        return float((np.asarray(vertices) @ pose.rotation[2]).max() + pose.translation[2])


def shapes_of(root: Element, model: pin.Model, name: str) -> list[Shape]:
    """Return the collision geometry of each link, or what is drawn of a link that has none.

    Parameters
    ----------
    root : xml.etree.ElementTree.Element
        The file, checked.
    model : pin.Model
        What Pinocchio read from it.
    name : str
        The file's name, for the message.

    Raises
    ------
    InvalidArgument
        If a dimension, or a place, is not made of finite numbers.
    """
    shapes: list[Shape] = []
    for link in root.iterfind("link"):
        called = link.get("name", "")
        frame = model.frames[model.getFrameId(called, pin.FrameType.BODY)]
        elements = link.findall("collision")
        for element in elements or link.findall("visual"):
            given = element.find("geometry")
            if given is None or not len(given):
                continue
            where = f"{name}: link {called!r} has {element.tag} geometry with"
            origin = element.find("origin")
            xyz, rpy = (
                numbers("0 0 0" if origin is None else origin.get(key, "0 0 0"), 3, f"{where} {key}")
                for key in ("xyz", "rpy")
            )
            placement = frame.placement * pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))
            at = called, frame.parentJoint, placement
            shape = _shape(given[0], at, collides=bool(elements), where=where)
            if shape is not None:
                shapes.append(shape)
    return shapes


def _shape(given: Element, at: tuple[str, int, pin.SE3], *, collides: bool, where: str) -> Shape | None:
    if given.tag == "mesh":
        scale = numbers(given.get("scale", "1 1 1"), 3, f"{where} scale")
        return Shape(*at, collides=collides, mesh=given.get("filename", ""), scale=scale)
    words = _DIMENSIONS.get(given.tag, "").split()
    counts = [3 if word == "size" else 1 for word in words]
    read = [
        numbers(given.get(word, ""), count, f"{where} {word}")
        for word, count in zip(words, counts, strict=True)
    ]
    sizes = [number for group in read for number in group]
    if not sizes or min(sizes) <= 0:
        return None  # a placeholder, or a shape that URDFs do not have: it tells nothing
    if given.tag == "box":
        x, y, z = sizes
        return Shape(*at, half=(x / 2, y / 2, z / 2), collides=collides)
    half = (0.0, 0.0, sizes[1] / 2 if len(sizes) > 1 else 0.0)
    radius = "disc" if given.tag == "cylinder" else "ball"
    return Shape(*at, half=half, collides=collides, **{radius: sizes[0]})  # type: ignore[arg-type]


@dataclass(frozen=True)
class WheelReading:
    """A wheel, as a model has it at rest.

    Parameters
    ----------
    name : str
        Of the joint that is its axle.
    joint : int
        Number of that joint.
    centre : tuple of 3 floats
        Of the wheel, in the frame of the root link [m].
    axis : tuple of 3 floats
        Unit vector of the axle there, level, in the sense that the joint turns.
    radius : float or None
        None where the model does not tell [m].
    """

    name: str
    joint: int
    centre: tuple[float, float, float]
    axis: tuple[float, float, float]
    radius: float | None


def wheels_of(
    model: pin.Model, data: pin.Data, base: pin.SE3, root: int, shapes: Sequence[Shape]
) -> list[WheelReading]:
    """Return the wheels: on each way from the root, the first joint that turns freely about a level axis.

    Of what is beyond, such as the rollers of an omni wheel, nothing is a wheel of its own.

    Parameters
    ----------
    model, data
        With all joints at rest, Jacobians computed.
    base : pin.SE3
        Pose of the root link.
    root : int
        Its joint.
    shapes : sequence of Shape
        Of the model's links; a cylinder about the axle, or a sphere on it, tells the radius.
    """
    below, wheels = children(model), []
    waiting = below[root][::-1]
    while waiting:
        joint = waiting.pop()
        axis = _axle(model, data, base, joint)
        if axis is None:
            waiting += below[joint][::-1]
            continue
        place = base.inverse() * data.oMi[joint]
        round_about = []
        for shape in shapes:
            if shape.joint == joint:
                at = place * shape.placement
                radius = shape.radius_about(at.rotation.T @ axis)
                aside = np.cross(at.translation - place.translation, axis)
                if radius is not None and np.linalg.norm(aside) <= TOUCH:
                    round_about.append((radius, at.translation))
        radius, centre = max(round_about, key=lambda pair: pair[0], default=(None, place.translation))
        x, y, z = (float(number) for number in centre)
        across, left, _ = (float(number) for number in axis)
        wheels.append(WheelReading(str(model.names[joint]), joint, (x, y, z), (across, left, 0.0), radius))
    return wheels


def _axle(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Array | None:
    """Return the axis of a joint that turns freely about a level one, snapped to level."""
    if not turns_freely(model, joint):
        return None
    # Of a model with one joint Pinocchio returns it without the second axis.
    jacobian = pin.getJointJacobian(model, data, joint, pin.WORLD).reshape(6, -1)
    axis = np.asarray(base.rotation.T @ jacobian[3:, model.idx_vs[joint]])
    if abs(axis[2]) > _LEVEL:
        return None
    return np.append(axis[:2] / np.hypot(axis[0], axis[1]), 0.0)


def ground_below(
    model: pin.Model,
    data: pin.Data,
    base: pin.SE3,
    root: int,
    wheels: Sequence[WheelReading],
    given: ArrayLike | None,
    name: str,
) -> tuple[float | None, str]:
    """Return the height of the ground in the frame of the root link, None where nothing tells, and what does.

    Raises
    ------
    InvalidArgument
        If what is given is no number, or the wheels do not stand on one plane.
    """
    if given is not None:
        ground = finite("ground", given)
        if ground.ndim:
            raise InvalidArgument(f"ground has shape {ground.shape}, expected one number: z of the ground")
        return float(ground), "as given"
    lowest = {wheel.name: wheel.centre[2] - wheel.radius for wheel in wheels if wheel.radius is not None}
    if lowest:
        heights = list(lowest.values())
        if max(heights) - min(heights) > TOUCH:
            listed = ", ".join(f"{wheel} at z = {_rounded(z):.4g}" for wheel, z in lowest.items())
            raise InvalidArgument(
                f"{name}: its wheels do not stand on one plane, their lowest points being {listed} m, "
                f"expected them within {1e3 * TOUCH:g} mm, or ground=, the z of the ground in the root "
                "link's frame [m]"
            )
        return _rounded(sum(heights) / len(heights)), "below its wheels by their radii"
    for number, frame in enumerate(model.frames):
        is_link = number and frame.type == pin.FrameType.BODY and frame.parentJoint == root
        if is_link and frame.name.endswith(_FOOTPRINT):
            at = base.inverse() * data.oMi[root] * frame.placement
            return _rounded(float(at.translation[2])), f"at its link {frame.name}"
    return (0.0, "the plane of its chain") if root == 3 else (None, "")


def _rounded(height: float) -> float:
    return 0.0 if abs(height) < _ROUNDING else height


def stance_on(
    model: pin.Model,
    data: pin.Data,
    base: pin.SE3,
    wheels: Sequence[WheelReading],
    shapes: Sequence[Shape],
    ground: float,
    *,
    file: VisualFile | None,
    root: int,
) -> tuple[Stance, list[str], list[tuple[float, float]]]:
    """Return how a robot stands on the ground, where that is from, in words, and what stands beside wheels.

    Parameters
    ----------
    model, data, base, wheels, shapes, root
        As in `wheels_of`; `base` is B, on the ground.
    ground : float
        Its height in the frame in which the wheels are [m].
    file : VisualFile or None
        Tells where meshes lie.
    """
    apart = {joint for wheel in wheels for joint in model.subtrees[wheel.joint]}
    placed = [(shape, _place(data, base, shape)) for shape in shapes if shape.joint not in apart]
    heights = [wheel.centre[2] - ground for wheel in wheels]
    # Where a file tells no radius at all, wheels with axles of one height stand on the ground.
    level = bool(heights) and min(heights) > 0 and max(heights) - min(heights) <= TOUCH
    untold = level and all(wheel.radius is None for wheel in wheels)
    points, names, supports = [], [], list[tuple[float, float]]()
    for wheel, height in zip(wheels, heights, strict=True):
        if untold if wheel.radius is None else abs(height - wheel.radius) <= TOUCH:
            points.append(np.array([wheel.centre[:2]]))
            names.append(wheel.name)
    for shape, pose in placed:
        if not shape.mesh and abs(pose.translation[2] - shape.reach(pose.rotation)) <= TOUCH:
            face = None if wheels else shape.corners_below(pose)
            # A caster or a skid of a robot on wheels carries at its middle.
            points.append(np.array([pose.translation[:2]]) if face is None else face)
            names.append(shape.link)
            supports += [(float(x), float(y)) for x, y in points[-1]]
    corners = hull(np.concatenate(points)) if points else None
    listed = ", ".join(dict.fromkeys(names)) or "of all shapes none"
    words = f"what is within {1e3 * TOUCH:g} mm of the ground, {listed}"
    # A wheel of which nothing is told may stand on the ground too: that changes nothing inside the others.
    lost = [] if untold else [wheel for wheel in wheels if wheel.radius is None and wheel.centre[2] > ground]
    if corners is None:
        words = f"footprint not known: {words}, has no area"
    elif any(margin_inside(corners, np.array(wheel.centre[:2])) < -TOUCH for wheel in lost):
        corners, radii = None, ", ".join(wheel.name for wheel in lost)
        words = f"footprint not known: {words}, but the file does not tell the radius of {radii}"
    else:
        words = f"footprint: {words}"
    top, why = _top([(shape, pose) for shape, pose in placed if shape.joint == root], file)
    return Stance(corners, top), [words, why], supports


def _place(data: pin.Data, base: pin.SE3, shape: Shape) -> pin.SE3:
    if data.oMi[shape.joint] == base:  # to the last digit, then
        return shape.placement
    return base.inverse() * data.oMi[shape.joint] * shape.placement


def _top(body: Sequence[tuple[Shape, pin.SE3]], file: VisualFile | None) -> tuple[float | None, str]:
    """Return the height of the highest geometry of the body, and where that is from."""
    # What is drawn stands for collision geometry where there is none but that of casters.
    solid = [pair for pair in body if pair[0].collides]
    chosen = solid if any(_is_above(*pair) for pair in solid) else body
    heights = [(shape, shape.highest(pose, file) if file else None) for shape, pose in chosen]
    lost = [shape.mesh for shape, z in heights if z is None]
    known = [(z, shape.link) for shape, z in heights if z is not None]
    if lost or not known or max(known)[0] <= 0:
        reason = f"cannot be read: {', '.join(dict.fromkeys(lost))}" if lost else "there is no geometry"
        return None, f"top not known: {reason}"
    top, link = max(known)
    return top, f"top {top:.4g} m, that of {link}"


def _is_above(shape: Shape, pose: pin.SE3) -> bool:
    """Return whether a shape is more than what a caster is: not a primitive that touches the ground."""
    return bool(shape.mesh) or pose.translation[2] - shape.reach(pose.rotation) > TOUCH
