"""Pinocchio model of the chain with its body, and the fields of a robot from a model or a URDF."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import coal
import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, bounded, instance, scalar
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHRow, DHTable, JointType, transform
from pinmobile.errors import InvalidArgument, argument_errors
from pinmobile.robot.linkage import Joint, carries_only_wheels, children, joints_of, turns_freely
from pinmobile.robot.support_geometry import (
    MIN_COSINE,
    SupportGeometry,
    WheelJoint,
    hull,
    joint_axis,
    margin_inside,
    read_stance,
    seen_from,
    triple,
    undercarriage_of,
)
from pinmobile.robot.urdf_checks import inertia_of, judge_links, urdf_model
from pinmobile.robot.visuals import VisualFile
from pinmobile.urdf import Body

_SIZES = {"box": 3, "cylinder": 2, "capsule": 2, "sphere": 1, "mesh": 3}
TOUCH = 0.005  # [m]: largest distance from the ground, or from a plane, that counts as contact

_ROUNDING = 1e-9  # [m]
_ROD = 0.03  # [m], radius of the drawn links of a DH table
_LEVEL = 0.1  # largest sine of an axle's angle from the horizontal: files have angles such as 1.57
_FOOTPRINT = "base_footprint"  # REP-120: the link on the ground, with any namespace before its name


class Shape(NamedTuple):
    """A box, a cylinder along z, a capsule along z, a sphere or a mesh, fixed to a joint.

    Attributes
    ----------
    link : str
        Link of the shape.
    joint : int
        Joint that carries the link.
    placement : pin.SE3
        Pose in the joint's frame.
    kind : str
        Tag of the element in the file.
    sizes : tuple of floats
        Sides of a box; otherwise the radius and, for a cylinder or capsule, the length; factors of a mesh
        [m].
    collides : bool
        Whether the shape is collision geometry; otherwise, it is visual geometry of a link without such.
    mesh : str
        Name of the file of a mesh.
    """

    link: str
    joint: int
    placement: pin.SE3
    kind: str
    sizes: tuple[float, ...]
    collides: bool = True
    mesh: str = ""

    def reach(self, rotation: Array) -> float:
        """Return the extent above and below the origin for a rotation, for shapes other than meshes [m]."""
        axis = np.abs(rotation[2])  # the vertical, in the shape's frame
        if self.kind == "box":
            return float(axis @ self.sizes / 2)
        radius, half = self.sizes[0], axis[2] * sum(self.sizes[1:]) / 2
        return float(half + radius * (np.hypot(axis[0], axis[1]) if self.kind == "cylinder" else 1.0))

    def radius_about(self, axis: Array) -> float | None:
        """Return the radius about an axis in the shape's frame; None for a shape that is not round [m]."""
        is_round = self.kind == "sphere" or (self.kind == "cylinder" and abs(axis[2]) > MIN_COSINE)
        return self.sizes[0] if is_round else None

    def corners_below(self, pose: pin.SE3) -> Array | None:
        """Return the corners of the lower face of a box that lies flat at a pose, shape (4, 2) [m]."""
        steep = np.abs(pose.rotation[2])
        if self.kind != "box" or steep.max() < MIN_COSINE:
            return None
        edges = pose.rotation * np.array(self.sizes) / 2  # (3, 3), a column for each
        a, b = np.delete(edges[:2], int(steep.argmax()), axis=1).T
        return np.asarray(pose.translation[:2] + np.array([-a - b, a - b, a + b, b - a]))

    def lowest(self, pose: pin.SE3) -> float:
        """Return the height of the lowest point at a pose, for shapes other than meshes [m]."""
        return float(pose.translation[2]) - self.reach(pose.rotation)

    def highest(self, pose: pin.SE3, file: VisualFile) -> float | None:
        """Return the height of the highest point at a pose; None for an unreadable mesh [m]."""
        if not self.mesh:
            return float(pose.translation[2]) + self.reach(pose.rotation)
        path = file.find_mesh(self.mesh)
        try:
            vertices = coal.MeshLoader().load(str(path), np.array(self.sizes)).vertices()
        except (ValueError, RuntimeError):
            return None
        return float((np.asarray(vertices) @ pose.rotation[2]).max() + pose.translation[2])


def shapes_of(root: Element, model: pin.Model) -> list[Shape]:
    """Return the collision geometry of each link of a checked file, or else its visual geometry.

    Placeholders without extent and unknown shapes are left out.
    """
    shapes: list[Shape] = []
    for link in root.iterfind("link"):
        name, collisions = link.get("name", ""), link.findall("collision")
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        for element in collisions or link.findall("visual"):
            origin, given = element.find("origin"), element.find("geometry/*")
            words = {} if origin is None else origin.attrib
            xyz, rpy = (np.array([*map(float, words.get(k, "0 0 0").split())]) for k in ("xyz", "rpy"))
            if given is None or given.tag not in _SIZES:
                continue
            read = [given.get(key, "").split() for key in ("size", "radius", "length")]
            sizes = tuple(float(word) for group in read for word in group)
            if given.tag == "mesh":
                sizes = tuple(map(float, given.get("scale", "1 1 1").split()))
            if len(sizes) == _SIZES[given.tag] and (given.tag == "mesh" or min(sizes) > 0):
                placement = frame.placement * pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
                place = name, frame.parentJoint, placement
                shapes.append(Shape(*place, given.tag, sizes, bool(collisions), given.get("filename", "")))
    return shapes


def wheels_of(
    model: pin.Model, data: pin.Data, base: pin.SE3, root: int, shapes: Sequence[Shape]
) -> list[WheelJoint]:
    """Return the wheels: on each path from the root, the first free joint with a horizontal axis.

    Joints beyond a wheel, such as the rollers of an omni wheel, are not wheels.

    Parameters
    ----------
    model, data : pin.Model, pin.Data
        Model and data with all joints at rest and computed Jacobians.
    base : pin.SE3
        Pose of the root link. The centres are in its frame.
    root : int
        Joint of the root link.
    shapes : sequence of Shape
        Shapes of the model's links. A cylinder about the axle, or a sphere on the axle, gives the radius.
    """
    child_of, wheels = children(model), []
    waiting = child_of[root][::-1]
    while waiting:
        joint = waiting.pop()
        axis = joint_axis(model, data, base, joint)
        if not turns_freely(model, joint) or abs(axis[2]) > _LEVEL:
            waiting += child_of[joint][::-1]
            continue
        axis = np.append(axis[:2] / np.hypot(axis[0], axis[1]), 0.0)
        place = base.inverse() * data.oMi[joint]
        round_about = []
        for shape in shapes:
            if shape.joint == joint:
                pose = place * shape.placement
                radius = shape.radius_about(pose.rotation.T @ axis)
                offset = np.cross(pose.translation - place.translation, axis)
                if radius is not None and np.linalg.norm(offset) <= TOUCH:
                    round_about.append((radius, pose.translation))
        radius, centre = max(round_about, key=lambda pair: pair[0], default=(None, place.translation))
        fields = str(model.names[joint]), joint, triple(centre), triple(axis), radius
        wheels.append(WheelJoint(*fields, carried=tuple(str(model.names[each]) for each in child_of[joint])))
    return wheels


def check_plane(words: str, lowest: Mapping[str, float], hint: str) -> None:
    """Check that wheels stand on one plane; `lowest` has the z of their lowest points [m]."""
    if max(lowest.values()) - min(lowest.values()) > TOUCH:
        listed = ", ".join(f"{name} at z = {_round_height(z):.4g}" for name, z in lowest.items())
        raise InvalidArgument(
            f"{words} do not stand on one plane, with lowest points {listed} m, expected differences of at "
            f"most {1e3 * TOUCH:g} mm, {hint}"
        )


def ground_below(
    model: pin.Model,
    data: pin.Data,
    base: pin.SE3,
    root: int,
    wheels: Sequence[WheelJoint],
    given: ArrayLike | None,
    name: str,
) -> tuple[float | None, str]:
    """Return the height of the ground in the root link's frame (None if unknown), and its origin as text.

    Raises
    ------
    InvalidArgument
        If `given` is not a number, or the wheels do not stand on one plane.
    """
    if given is not None:
        return scalar("ground", given), "as given"
    lowest = {wheel.name: wheel.centre[2] - wheel.radius for wheel in wheels if wheel.radius is not None}
    if lowest:
        check_plane(f"{name}: its wheels", lowest, "or ground=, its z in the root link's frame [m]")
        return _round_height(sum(lowest.values()) / len(lowest)), "below its wheels by their radii"
    for number, frame in enumerate(model.frames):
        is_link = number and frame.type == pin.FrameType.BODY and frame.parentJoint == root
        if is_link and frame.name.endswith(_FOOTPRINT):
            pose = base.inverse() * data.oMi[root] * frame.placement
            return _round_height(float(pose.translation[2])), f"at its link {frame.name}"
    return (0.0, "the plane of its chain") if root == 3 else (None, "")


def _round_height(height: float) -> float:
    return 0.0 if abs(height) < _ROUNDING else height


def stance_on(
    model: pin.Model,
    data: pin.Data,
    base: pin.SE3,
    wheels: Sequence[WheelJoint],
    shapes: Sequence[Shape],
    ground: float,
    *,
    file: VisualFile | None,
    root: int,
) -> tuple[SupportGeometry, list[str], list[tuple[float, float]]]:
    """Return the contact geometry of a robot, its origin as text, and the supports beside the wheels.

    Parameters
    ----------
    model, data, base, wheels, shapes, root
        As in `wheels_of`, with `base` the body frame B on the ground.
    ground : float
        Height of B in the frame of the wheels [m].
    file : VisualFile or None
        File that locates the meshes.
    """
    wheel_joints = {joint for wheel in wheels for joint in model.subtrees[wheel.joint]}
    body_shapes = [shape for shape in shapes if shape.joint not in wheel_joints]
    poses = [(shape, seen_from(base, data.oMi[shape.joint], shape.placement)) for shape in body_shapes]
    heights = [wheel.centre[2] - ground for wheel in wheels]
    # If a file contains no radius, wheels with axles at the same height stand on the ground.
    level = bool(heights) and min(heights) > 0 and max(heights) - min(heights) <= TOUCH
    bare = level and all(wheel.radius is None for wheel in wheels)
    points, names, supports = [], [], list[tuple[float, float]]()
    for wheel, height in zip(wheels, heights, strict=True):
        if bare if wheel.radius is None else abs(height - wheel.radius) <= TOUCH:
            points.append(np.array([wheel.centre[:2]]))
            names.append(wheel.name)
    for shape, pose in poses:
        if not shape.mesh and abs(shape.lowest(pose)) <= TOUCH:
            face = None if wheels else shape.corners_below(pose)
            # The contact point of a caster or skid of a robot on wheels is its centre.
            points.append(np.array([pose.translation[:2]]) if face is None else face)
            names.append(shape.link)
            supports += [(float(x), float(y)) for x, y in points[-1]]
    corners = hull(np.concatenate(points)) if points else None
    names_text = ", ".join(dict.fromkeys(names)) or "of all shapes none"
    words = f"what is within {1e3 * TOUCH:g} mm of the ground, {names_text}"
    # A wheel with an unknown radius may stand on the ground; inside the others, it does not matter.
    others = [] if bare else [wheel for wheel in wheels if wheel.radius is None and wheel.centre[2] > ground]
    if corners is None:
        words = f"footprint not known: {words}, has no area"
    elif any(margin_inside(corners, np.array(wheel.centre[:2])) < -TOUCH for wheel in others):
        corners, radii = None, ", ".join(wheel.name for wheel in others)
        words = f"footprint not known: {words}, but the file does not contain the radius of {radii}"
    else:
        words = f"footprint: {words}"
    top, origin = _top([(shape, pose) for shape, pose in poses if shape.joint == root], file)
    return SupportGeometry(corners, top), [words, origin], supports


def _top(body: Sequence[tuple[Shape, pin.SE3]], file: VisualFile | None) -> tuple[float | None, str]:
    """Return the height of the body's highest geometry, and its origin as text."""
    # Visual geometry replaces collision geometry that has only casters, primitives that touch the ground.
    solid = [(shape, pose) for shape, pose in body if shape.collides]
    shapes = solid if any(shape.mesh or shape.lowest(pose) > TOUCH for shape, pose in solid) else body
    heights = [(shape, shape.highest(pose, file) if file else None) for shape, pose in shapes]
    meshes = [shape.mesh for shape, z in heights if z is None]
    tops = [(z, shape.link) for shape, z in heights if z is not None]
    if meshes or not tops or max(tops)[0] <= 0:
        reason = f"cannot be read: {', '.join(dict.fromkeys(meshes))}" if meshes else "there is no geometry"
        return None, f"top not known: {reason}"
    top, link = max(tops)
    return top, f"top {top:.4g} m, that of {link}"


LOCKED = "wheels locked: they do not roll, and it can be pushed sideways"  # of a base
_BODY_LINK = "base_link"
_AXIS_TOLERANCE = 1e-5  # an axis written with six digits or more counts as aligned
_MASSLESS = 1e-9  # of the body's mass
_CHAIN = (("prismatic", (0, 1, 0)), ("prismatic", (1, 0, 0)), ("revolute", (0, 0, 1)))


def check_chain(name: str, table: DHTable) -> DHTable:
    """Return a table whose last frame is the planar pose (x, y, psi) for joint variables (y, x, psi).

    Raises
    ------
    InvalidArgument
        If the argument is another table, or not a table.
    """
    instance(name, table, DHTable, "a DHTable")
    probes = np.array([[0, 0, 0], [0.7, -0.3, 1.1], [-1.0, 2.0, -2.5]])
    wrong = f"has joints {', '.join(f'{row.joint.value} {row.variable}' for row in table)}"
    if [row.joint for row in table] == [row.joint for row in LECTURE_TABLE]:
        pose, expected = (dh.placements(probes)[:, -1] for dh in (table, LECTURE_TABLE))
        differs = np.abs(pose - expected).reshape(len(probes), -1).max(axis=1) >= 1e-12
        if not differs.any():
            return table
        k = int(differs.argmax())
        error = np.linalg.inv(expected[k]) @ pose[k]
        distance = round(float(np.linalg.norm(error[:3, 3])), 9)
        angle = round(float(np.degrees(np.linalg.norm(pin.log3(error[:3, :3])))), 6)
        y, x, psi = probes[k]
        wrong = (
            f"has a last frame {distance:.3g} m and {angle:.3g} deg away from the pose "
            f"x = {x:g}, y = {y:g}, psi = {psi:g} that the joints have"
        )
    raise InvalidArgument(
        f"{name} {wrong}, expected prismatic y, prismatic x and revolute psi, with the body frame as last "
        "frame; other chains can be derived, and simulated as a plant of your own"
    )


def build_model(table: DHTable, *bodies: Body, ends: Sequence[str] = (_BODY_LINK,)) -> pin.Model:
    """Return the chain with bodies on its last links, whose names are `ends`, as a Pinocchio model.

    The model equals Pinocchio's model of the text from `urdf.write`, except that rotations by multiples of pi
    / 2 are exact. Gravity therefore has no component in the plane.
    """
    model = pin.Model()
    model.name = "pinmobile"
    parent, first = 0, len(table) - len(bodies)
    for k, (row, placement) in enumerate(zip(table, table.transforms(np.zeros(len(table))), strict=True)):
        joint = pin.JointModelPZ() if row.joint is JointType.PRISMATIC else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, pin.SE3(placement), row.variable)
        model.addJointFrame(parent)
        if k >= first:
            body = bodies[k - first]
            inertia = pin.Inertia(body.mass, body.com, body.inertia)
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            model.addBodyFrame(ends[k - first], parent, pin.SE3.Identity(), -1)
    return model


def rods_of(model: pin.Model, centres: Sequence[Array]) -> pin.GeometryModel:
    """Return visual rods from each joint of a serial model to the next, the last one through its centre."""
    ends = [model.jointPlacements[k + 1].translation for k in range(1, model.njoints - 1)]
    visuals = pin.GeometryModel()
    for k, end in enumerate([*ends, 2.0 * np.asarray(centres[-1])], start=1):
        length, upright = float(np.linalg.norm(end)), np.array([0.0, 0.0, 1.0])
        way = pin.Quaternion.FromTwoVectors(upright, np.asarray(end) if length else upright)
        place = pin.SE3(way.toRotationMatrix(), np.asarray(end) / 2)
        rod = pin.GeometryObject(f"{model.names[k]}_rod", k, place, coal.Capsule(_ROD, length))
        rod.meshColor = np.array([0.45, 0.5, 0.55, 1.0])
        visuals.addGeometryObject(rod)
    return visuals


def rows_of(model: pin.Model) -> list[DHRow] | None:
    """Return the rows of a serial model; None if its joint frames are not those of a modified-DH table."""
    kinds, rows = {"JointModelRZ": JointType.REVOLUTE, "JointModelPZ": JointType.PRISMATIC}, []
    for k in range(1, model.njoints):
        R, p = model.jointPlacements[k].rotation, model.jointPlacements[k].translation
        alpha, theta = np.arctan2(-R[1, 2], R[2, 2]), np.arctan2(-R[0, 1], R[0, 0])
        d = -p[1] * np.sin(alpha) + p[2] * np.cos(alpha)
        error = np.abs(transform(alpha, p[0], theta, d) - model.jointPlacements[k].homogeneous).max()
        kind = kinds.get(model.joints[k].shortname())
        if kind is None or model.parents[k] != k - 1 or error > _ROUNDING:
            return None
        rows.append(DHRow(float(alpha), float(p[0]), float(theta), float(d), kind, model.names[k]))
    return rows


def read_urdf(
    path: Path, package_dirs: tuple[Path, ...] = (), ground: ArrayLike | None = None
) -> dict[str, Any]:
    """Return the fields of the `MobileRobot` for a URDF with the chain and its body, or with a base.

    Parameters
    ----------
    path, package_dirs, ground
        As in `MobileRobot.from_urdf`.

    Raises
    ------
    InvalidArgument
        If the file does not exist, is not a URDF, or is neither of the two.
    """
    model, root = urdf_model("path", path)
    fields = read_model(model, path.name, ground, root, VisualFile(path.resolve(), package_dirs))
    judge_links(root, path.name, lambda _: fields["reference_inertia"], stacklevel=4)
    return fields


def read_model(
    model: pin.Model,
    name: str,
    ground: ArrayLike | None = None,
    root: Element | None = None,
    file: VisualFile | None = None,
) -> dict[str, Any]:
    """Return the fields of the `MobileRobot` for a model with the chain and its body, or with a base.

    The base has a planar root, a free-flyer root or none.

    Parameters
    ----------
    model, ground
        As in `MobileRobot.from_model`.
    name : str
        Name of the model in messages.
    root, file : xml.etree.ElementTree.Element, VisualFile, optional
        Checked tree and file of the model, with its shapes.

    Raises
    ------
    InvalidArgument
        If the model is neither of the two. The message names the wrong joint.
    """
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    shapes = [] if root is None else shapes_of(root, model)
    if _starts_with_slides(model):
        table = _chain_table(model, data, name)
        # For frames of neither table, B is the frame that coincides with the ground's frame at rest.
        first, base = 3, data.oMi[3] if table else pin.SE3.Identity()
        kind = f"is the chain ({', '.join(model.names[1:4])})"
        if table is None:
            kind += "; B is the frame that coincides with the ground's when all joints are at zero"
    else:
        table, roots = None, list(model.parents)[1:].count(0)
        first = 1 if roots == 1 and Joint.of(model, 1).floats else 0
        base = data.oMi[first]
        kind = "is a bare base, put on the chain (y, x, psi)"
    joints = _find_locked(model, first, name)
    wheels = wheels_of(model, data, base, first, shapes)
    z, origin = ground_below(model, data, base, first, wheels, ground, name)
    if z:
        base = base * pin.SE3(np.eye(3), np.array([0.0, 0.0, z]))
    body = _lump(model, data, base, [first, *joints], name)
    single = None if root is None else _only_body(root, model)
    if single is not None and data.oMi[single[0]] == base:
        body = single[1]  # Pinocchio divides by the mass, and loses the last digit
    if ground is not None and body.com[2] < -_AXIS_TOLERANCE:
        raise InvalidArgument(
            f"ground is {z:g} m, {-body.com[2]:.4g} m above the robot's centre of mass, expected the "
            "ground's z in the root link's frame, a negative value for a link above the ground"
        )
    parts, supports = [f"{name} {kind}"], list[tuple[float, float]]()
    if joints:
        parts += [f"locked at rest: {', '.join(model.names[j] for j in joints)}", LOCKED]
    com = ", ".join(f"{c:.4g}" for c in body.com.round(9) + 0.0)
    parts.append(
        f"mass {body.mass:.6g} kg, centre of mass ({com}) m, yaw inertia {body.yaw_inertia:.6g} kg m^2"
    )
    own = None if root is None else read_stance(root, name)
    if own is not None:
        stance = SupportGeometry(
            own.footprint, own.top and own.top - (z or 0.0), own.grounded or ground is not None
        )
    elif z is None:
        stance = SupportGeometry(grounded=False)
        parts.append(
            "height of the ground unknown, assumed at the origin of the root link: give ground=, its z in "
            "the root link's frame [m]"
        )
    else:
        stance, words, supports = stance_on(model, data, base, wheels, shapes, z, file=file, root=first)
        parts += [f"ground {origin}, at z = {z:.4g} m in the root link's frame", *words]
    size = None if root is None else _largest_box(root)
    if size is None:
        size = _box_of_inertia(body)
        parts.append("size of the box with the same mass and inertia")
        if stance.top is not None:  # arms are drawn on top of the box
            size = (*size[:2], stance.top)
            parts[-1] += ", as high as the top"
    pose = tuple(base.homogeneous.ravel().tolist())
    return {
        **fields_of_body(body),
        "size": size,
        "dh": table or LECTURE_TABLE,
        "stance": stance,
        "source": "; ".join(parts),
        "locked_joints": tuple(str(model.names[joint]) for joint in joints),
        "undercarriage": undercarriage_of(model, data, base, first, wheels, supports, z or 0.0),
        "looks": None if file is None else file._replace(base=pose),
    }


def fields_of_body(body: Body) -> dict[str, Any]:
    """Return the fields of a `MobileRobot` that hold the numbers of its body."""
    fields = {"mass": body.mass, "yaw_inertia": body.yaw_inertia, "com": body.com}
    return fields | {"reference_inertia": body.inertia}


def _starts_with_slides(model: pin.Model) -> bool:
    """Return whether the model is the chain: three joints in series, at least two of them prismatic."""
    if model.njoints < 4 or [model.parents[j] for j in (1, 2, 3)] != [0, 1, 2]:
        return False
    return sum(joint.slides for joint in joints_of(model)[:3]) >= 2


def _chain_table(model: pin.Model, data: pin.Data, name: str) -> DHTable | None:
    """Check that each joint is the expected one; return the table with the same frames, if there is one."""
    for joint, (kind, axis) in enumerate(_CHAIN, start=1):
        expected = f"expected a {kind} joint along {axis}: joint {joint} of y, x, psi"
        joint_data = Joint.of(model, joint)
        if joint_data.nv != 1:
            raise InvalidArgument(f"{name}: joint {joint_data}, {expected}")
        column = pin.getJointJacobian(model, data, joint, pin.WORLD)[:, joint_data.v.start]
        is_kind = "revolute" if np.linalg.norm(column[3:]) > 0.5 else "prismatic"
        direction = column[3:] if is_kind == "revolute" else column[:3]
        if is_kind != kind or np.abs(direction - axis).max() > _AXIS_TOLERANCE:
            numbers = ", ".join(f"{x:.4g}" for x in direction.round(9) + 0.0)
            raise InvalidArgument(
                f"{name}: joint {model.names[joint]!r} is {is_kind} along ({numbers}), {expected}"
            )
        if np.abs(column[:3] - (axis if kind == "prismatic" else 0)).max() > _AXIS_TOLERANCE:
            raise InvalidArgument(
                f"{name}: the axis of joint {model.names[joint]!r} does not pass through the origin when all "
                "joints are at zero, expected an axis through the origin"
            )
    frames = np.stack([data.oMi[k].homogeneous for k in (1, 2, 3)])
    for table in (LECTURE_TABLE, SLIDE_TABLE):
        if np.abs(frames - table.placements(np.zeros(3))).max() <= _AXIS_TOLERANCE:
            return table
    return None


def _find_locked(model: pin.Model, root: int, name: str) -> list[int]:
    """Return the joints to lock, wheels and joints that carry only wheels; reject any other joint."""
    others = range(root + 1, model.njoints)
    for joint, joint_data in zip(others, joints_of(model, root + 1), strict=True):
        if model.parents[joint] == root and not carries_only_wheels(model, joint):
            raise InvalidArgument(
                f"{name}: joint {joint_data.name!r} (JointModel{joint_data.kind}) is neither a wheel nor "
                "carries only wheels; expected a bare base or the chain prismatic y, prismatic x, revolute z "
                "with body"
            )
    return list(others)


def _lump(model: pin.Model, data: pin.Data, base: pin.SE3, joints: Iterable[int], name: str) -> Body:
    """Return the composite body of the given joints, seen from the base at rest."""
    total = pin.Inertia.Zero()
    for joint in joints:
        total += seen_from(base, data.oMi[joint], model.inertias[joint])
    bounded(f"{name}: mass of the body", float(total.mass), above=0, unit="kg")
    for joint in (1, 2):
        on_the_way = joint not in joints and model.njoints > joint
        if on_the_way and model.inertias[joint].mass > _MASSLESS * total.mass:
            raise InvalidArgument(
                f"{name}: joint {model.names[joint]!r} moves a link of {model.inertias[joint].mass:.6g} kg, "
                "expected a massless virtual link"
            )
    with argument_errors(f"{name}: "):
        return Body(total.mass, total.lever, total.inertia)


def _only_body(root: Element, model: pin.Model) -> tuple[int, Body] | None:
    """Return the body of a file with only one body, with all digits, and the joint of its frame."""
    links = [link for link in root.iterfind("link") if link.find("inertial") is not None]
    if len(links) != 1:
        return None
    frame = model.frames[model.getFrameId(links[0].get("name", ""), pin.FrameType.BODY)]
    mass, inertia, origin = (links[0].find(f"inertial/{part}") for part in ("mass", "inertia", "origin"))
    given = {} if origin is None else origin.attrib
    is_rotated = any(map(float, given.get("rpy", "0 0 0").split()))
    if is_rotated or mass is None or inertia is None or frame.placement != pin.SE3.Identity():
        return None
    com = np.array([float(word) for word in given.get("xyz", "0 0 0").split()])
    try:
        return frame.parentJoint, Body(float(mass.get("value", "0")), com, inertia_of(inertia))
    except InvalidArgument:
        return None  # the check of the composite body reports the error


def _largest_box(root: Element) -> tuple[float, float, float] | None:
    """Return the size of the largest box in the file's visual geometry, if there is one."""
    words = (box.get("size", "").split() for box in root.iterfind("./link/visual/geometry/box"))
    return max((triple(map(float, sides)) for sides in words if sides), key=prod, default=None)


def _box_of_inertia(body: Body) -> tuple[float, float, float]:
    """Return the sides of the homogeneous box with this mass and these moments about x, y and z."""
    moments: Array = np.diag(body.inertia)
    squares = 6 / body.mass * (moments.sum() - 2 * moments)
    x, y, z = np.sqrt(np.maximum(squares, 1e-4))
    return float(x), float(y), float(z)
