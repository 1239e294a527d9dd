"""The chain with its body as a `pin.Model`, from a table, a model or a URDF, and the wheels of a file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, instance
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHTable, JointType
from pinmobile.errors import InvalidArgument
from pinmobile.robot.geometry import Shape, WheelReading, ground_below, shapes_of, stance_on, wheels_of
from pinmobile.robot.linkage import Joint, carries_only_wheels, children, joints_of, turns_freely
from pinmobile.robot.support_geometry import Stance, stance_written
from pinmobile.robot.urdf_checks import MOMENTS, judge_links, urdf_model
from pinmobile.robot.visuals import VisualFile
from pinmobile.urdf import Body

_TRAIL = 1e-3  # [m]: a wheel nearer to its swivel than that does not trail
_VERTICAL = 0.995  # cosine of the angle by which a swivel may lean: files have angles such as 1.57

Triple = tuple[float, float, float]


class Lump(NamedTuple):
    """Links that move together, at rest.

    Attributes
    ----------
    mass : float
        [kg]; zero of links that have none.
    com : tuple of 3 floats
        Centre of mass in the body's frame B [m].
    inertia : tuple of 3 tuples of 3 floats
        About it, along the axes of B [kg m^2].
    """

    mass: float
    com: Triple
    inertia: tuple[Triple, Triple, Triple]


class Swivel(NamedTuple):
    """A joint about the vertical that carries a wheel.

    Attributes
    ----------
    name : str
        Of the joint.
    x, y : float
        Where its axis stands in B [m].
    limit : float
        Largest angle to either side [rad]; infinite: it turns freely.
    lump : Lump
        All that turns with it, wheels included.
    """

    name: str
    x: float
    y: float
    limit: float
    lump: Lump

    def turning(self, wheel: WheelJoint, across: float) -> tuple[float, float]:
        """Return mass and yaw inertia that, at the wheel's centre, turn as all on the swivel does.

        A rigid body about a pivot acts in the plane by its first and second moment about it. A mass at the
        centre has the first one, along the trail; the rest of it is at the pivot, with the body. Where that
        is no mass, or nothing trails, the wheel's own is returned, the rest as at the pivot.

        Parameters
        ----------
        wheel : WheelJoint
            The wheel.
        across : float
            Its own inertia across its axle [kg m^2].
        """
        fork = self._about(self.lump) - self._about(wheel.lump)
        o = np.array([wheel.centre[0] - self.x, wheel.centre[1] - self.y])
        square = float(o @ o)
        if square > _TRAIL**2:
            first = self.lump.mass * float(o @ [self.lump.com[0] - self.x, self.lump.com[1] - self.y])
            mass = first / square
            yaw = fork + across + wheel.lump.mass * self._square(wheel.lump) - mass * square
            if mass > 0 and yaw > 0:
                return mass, yaw
        return wheel.lump.mass, across + max(fork, 0.0)

    def _square(self, lump: Lump) -> float:
        return (lump.com[0] - self.x) ** 2 + (lump.com[1] - self.y) ** 2

    def _about(self, lump: Lump) -> float:
        """Return the inertia of links about the axis [kg m^2]."""
        return lump.inertia[2][2] + lump.mass * self._square(lump)


class WheelJoint(NamedTuple):
    """A wheel of a model, at rest.

    Attributes
    ----------
    name : str
        Of the joint that is its axle.
    centre : tuple of 3 floats
        Of the wheel, on its axle, in B [m].
    axis : tuple of 3 floats
        Unit vector of the axle there, level, in the sense that the joint turns.
    radius : float or None
        None where the model does not tell [m].
    lump : Lump
        All that turns with it.
    swivels : tuple of Swivel
        On the way from the body to it.
    carried : tuple of str
        Joints on it, such as those of rollers.
    effort : float
        Largest torque of the joint [N m]; infinite where there is none.
    damping, friction : float
        Of the joint [N m s/rad, N m].
    """

    name: str
    centre: Triple
    axis: Triple
    radius: float | None
    lump: Lump
    swivels: tuple[Swivel, ...] = ()
    carried: tuple[str, ...] = ()
    effort: float = np.inf
    damping: float = 0.0
    friction: float = 0.0

    def moments(self) -> tuple[float, tuple[float, float], float, float]:
        """Return what tells a solid of revolution about its axle.

        Returns
        -------
        spin : float
            Moment about the axle [kg m^2].
        across : tuple of 2 floats
            Those across it, level and vertical [kg m^2].
        product : float
            The largest product of inertia in these axes [kg m^2].
        aside : float
            Distance of the centre of mass from the axle [m].
        """
        axle = np.array(self.axis)
        frame = np.stack([axle, np.cross([0.0, 0.0, 1.0], axle), [0.0, 0.0, 1.0]])
        inertia = frame @ np.array(self.lump.inertia) @ frame.T
        spin, level, vertical = inertia.diagonal().tolist()
        product = float(np.abs(inertia[np.triu_indices(3, 1)]).max())
        aside = np.linalg.norm(np.cross(np.subtract(self.lump.com, self.centre), axle))
        return spin, (level, vertical), product, float(aside)


class Undercarriage(NamedTuple):
    """What a robot stands on, as its model has it.

    Attributes
    ----------
    wheels : tuple of WheelJoint
        In the order of the model.
    supports : tuple of (float, float)
        Where what does not roll touches the ground, in B [m]: fixed casters and skids.
    """

    wheels: tuple[WheelJoint, ...] = ()
    supports: tuple[tuple[float, float], ...] = ()


def undercarriage_of(
    model: pin.Model,
    data: pin.Data,
    base: pin.SE3,
    root: int,
    wheels: Sequence[WheelReading],
    supports: Sequence[tuple[float, float]],
    ground: float,
) -> Undercarriage:
    """Return the undercarriage of a model.

    Parameters
    ----------
    model, data
        With all joints at rest, Jacobians computed.
    base : pin.SE3
        Pose of B.
    root : int
        The joint of the root link.
    wheels : sequence of WheelReading
        In the frame of the root link.
    supports : sequence of (float, float)
        Where what does not roll touches the ground, in B [m].
    ground : float
        z of B in the frame of the root link [m].
    """
    below, found = children(model), []
    for wheel in wheels:
        way, joint = [], int(model.parents[wheel.joint])
        while joint > root:
            way.append(joint)
            joint = int(model.parents[joint])
        hub = (base.inverse() * data.oMi[wheel.joint]).translation
        along = np.array(wheel.centre) - [0, 0, ground] - hub
        v = model.idx_vs[wheel.joint]
        effort = float(model.effortLimit[v])
        found.append(
            WheelJoint(
                wheel.name,
                _triple(hub + (along @ wheel.axis) * np.array(wheel.axis)),
                wheel.axis,
                wheel.radius,
                _lump_of(model, data, base, wheel.joint),
                tuple(
                    _swivel(model, data, base, each) for each in way if _is_swivel(model, data, base, each)
                ),
                tuple(str(model.names[each]) for each in below[wheel.joint]),
                effort if effort > 0 else np.inf,
                float(model.damping[v]),
                float(model.friction[v]),
            )
        )
    return Undercarriage(tuple(found), tuple(supports))


def _triple(values: Sequence[float]) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _lump_of(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Lump:
    total = pin.Inertia.Zero()
    for each in model.subtrees[joint]:
        if model.inertias[each].mass > 0:
            total += (base.inverse() * data.oMi[each]).act(model.inertias[each])
    first, second, third = (_triple(row) for row in total.inertia)
    at = total.lever if total.mass > 0 else (base.inverse() * data.oMi[joint]).translation
    return Lump(float(total.mass), _triple(at), (first, second, third))


def _is_swivel(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> bool:
    own = Joint.of(model, joint)
    if own.nv != 1 or own.slides:
        return False
    jacobian = pin.getJointJacobian(model, data, joint, pin.WORLD).reshape(6, -1)
    return bool(abs((base.rotation.T @ jacobian[3:, model.idx_vs[joint]])[2]) > _VERTICAL)


def _swivel(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Swivel:
    x, y, _ = _triple((base.inverse() * data.oMi[joint]).translation)
    limit = np.inf
    if not turns_freely(model, joint):
        q = Joint.of(model, joint).q
        limit = min(abs(float(model.lowerPositionLimit[q][0])), abs(float(model.upperPositionLimit[q][0])))
    return Swivel(str(model.names[joint]), x, y, limit, _lump_of(model, data, base, joint))


LOCKED = "wheels locked: they do not roll, and it can be pushed sideways"
"""What is said of a base with wheels."""

_BODY_LINK = "base_link"
_ALIGNED = 1e-5  # an axis written with six digits or more counts as aligned
_MASSLESS = 1e-9  # of the body's mass
_CHAIN = (("prismatic", (0, 1, 0)), ("prismatic", (1, 0, 0)), ("revolute", (0, 0, 1)))


def check_chain(table: DHTable) -> None:
    """Refuse a table whose last frame is not the planar pose (x, y, psi) for joint variables (y, x, psi).

    Raises
    ------
    InvalidArgument
        If it is one, or no table at all.
    """
    instance("dh", table, DHTable, "a DHTable")
    kinds = [row.joint for row in table]
    planar = kinds == [row.joint for row in LECTURE_TABLE]
    probes = np.array([[0, 0, 0], [0.7, -0.3, 1.1], [-1.0, 2.0, -2.5]])
    if planar:
        pose, expected = (dh.placements(probes)[:, -1] for dh in (table, LECTURE_TABLE))
        planar = bool(np.abs(pose - expected).max() < 1e-12)
    if not planar:
        raise InvalidArgument(
            f"dh with variables {table.variables} does not put its last frame at (x, y, psi), expected "
            "a chain of prismatic y, prismatic x, revolute psi whose last frame is the body's"
        )


def build_model(table: DHTable, body: Body) -> pin.Model:
    """Return the chain with the body on its last link as a Pinocchio model.

    It is the model that Pinocchio reads from `urdf.write`, but with rotations that are exact where the
    table's angles are multiples of pi / 2, so that gravity does not leak into the plane.
    """
    model = pin.Model()
    model.name = "pinmobile"
    parent = 0
    for row, placement in zip(table, table.transforms(np.zeros(len(table))), strict=True):
        joint = pin.JointModelPZ() if row.joint is JointType.PRISMATIC else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, pin.SE3(placement), row.variable)
        model.addJointFrame(parent)
    model.appendBodyToJoint(parent, pin.Inertia(body.mass, body.com, body.inertia), pin.SE3.Identity())
    model.addBodyFrame(_BODY_LINK, parent, pin.SE3.Identity(), -1)
    return model


@dataclass(frozen=True)
class Reading:
    """What was read.

    Parameters
    ----------
    table : DHTable
        The chain.
    body : Body
        Everything that rides on it, as one body.
    size : tuple of 3 floats
        Length, width and height of a box to draw [m].
    source : str
        What was taken from where, in words.
    base : tuple of 16 floats
        Pose of the body, whose origin is on the ground, in the model's root with all joints at rest, row by
        row.
    stance : Stance
        How it stands.
    locked : tuple of str
        Joints that are locked at rest.
    wheels : tuple of WheelReading
        Those among them that roll.
    undercarriage : Undercarriage
        These with all that a wheel table asks, and what else stands on the ground.
    """

    table: DHTable
    body: Body
    size: tuple[float, float, float]
    source: str
    base: tuple[float, ...]
    stance: Stance
    locked: tuple[str, ...]
    wheels: tuple[WheelReading, ...]
    undercarriage: Undercarriage


def read_urdf(path: Path, package_dirs: tuple[Path, ...] = (), ground: ArrayLike | None = None) -> Reading:
    """Read a URDF that is the chain with its body, or a bare base.

    Parameters
    ----------
    path, package_dirs, ground
        As in `MobileRobot.from_urdf`.

    Raises
    ------
    InvalidArgument
        If there is no such file, it is no URDF, or it is neither of the two.
    """
    model, root = urdf_model("path", path)
    shown = Shown(
        _largest_box(root),
        tuple(shapes_of(root, model, path.name)),
        VisualFile(path.resolve(), package_dirs, ()),
        stance_written(root, path.name),
        _only_body(root, model),
    )
    reading = read_model(model, path.name, shown, ground)
    judge_links(root, path.name, lambda _: reading.body.inertia, stacklevel=4)
    return reading


@dataclass(frozen=True)
class Shown:
    """What a file says of a robot beside its model.

    Parameters
    ----------
    size : tuple of 3 floats, optional
        Of the largest box that is drawn [m].
    shapes : tuple of Shape
        What has an outline.
    file : VisualFile, optional
        Where its meshes lie.
    stance : Stance, optional
        How it stands, where the file says so itself.
    only : (int, Body), optional
        The one body in it, with its joint, where its frame is the joint's.
    """

    size: tuple[float, float, float] | None = None
    shapes: tuple[Shape, ...] = ()
    file: VisualFile | None = None
    stance: Stance | None = None
    only: tuple[int, Body] | None = None


def read_model(
    model: pin.Model, name: str, shown: Shown = Shown(), ground: ArrayLike | None = None
) -> Reading:
    """Read a model that is the chain with its body, or a bare base (with a planar or free root, or none).

    Raises
    ------
    InvalidArgument
        If it is neither; the message names the joint that is wrong.
    """
    data = model.createData()
    q = pin.neutral(model)
    pin.computeJointJacobians(model, data, q)
    if _starts_with_slides(model):
        table = _chain_table(model, data, name)
        # Frames of neither table: B is then the frame that coincides with the ground's at rest.
        root, base = 3, data.oMi[3] if table else pin.SE3.Identity()
        how = f"is the chain ({', '.join(model.names[1:4])})"
        how += (
            "" if table else "; B is the frame that coincides with the ground's when all joints are at zero"
        )
    else:
        table = None
        root = 1 if model.njoints > 1 and _is_floating(model, 1) else 0
        base = data.oMi[root]
        how = "is a bare base, put on the chain (y, x, psi)"
    locked = _locked(model, root, name)
    wheels = wheels_of(model, data, base, root, shown.shapes)
    z, told = ground_below(model, data, base, root, wheels, ground, name)
    if z:
        base = base * pin.SE3(np.eye(3), np.array([0.0, 0.0, z]))
    body = _lump(model, data, base, [root, *locked], name)
    if shown.only is not None and data.oMi[shown.only[0]] == base:
        body = shown.only[1]  # Pinocchio divides by the mass again, and loses the last digit
    if ground is not None and body.com[2] < -_ALIGNED:
        raise InvalidArgument(
            f"ground is {z:g} m, {-body.com[2]:.4g} m above the robot's centre of mass, expected the "
            "ground's z in the root link's frame, which is below zero where that link is above the ground"
        )
    parts, supports = [f"{name} {how}"], list[tuple[float, float]]()
    if locked:
        parts += [f"locked at rest: {', '.join(model.names[j] for j in locked)}", LOCKED]
    com = ", ".join(f"{c:.4g}" for c in body.com.round(9) + 0.0)
    parts.append(
        f"mass {body.mass:.6g} kg, centre of mass ({com}) m, yaw inertia {body.yaw_inertia:.6g} kg m^2"
    )
    if shown.stance is not None:
        own = shown.stance
        stance = Stance(own.footprint, own.top and own.top - (z or 0.0), own.grounded or ground is not None)
    elif z is None:
        stance = Stance(grounded=False)
        parts.append(
            "where the ground is is not known, and is taken to be at the origin of the root link: "
            "give ground=, its z there [m]"
        )
    else:
        stance, words, supports = stance_on(
            model, data, base, wheels, shown.shapes, z, file=shown.file, root=root
        )
        parts += [f"ground {told}, at z = {z:.4g} m in the root link's frame", *words]
    size = shown.size
    if size is None:
        size = _box_of_inertia(body)
        parts.append("size of the box with the same mass and inertia")
        if stance.top is not None:  # what stands on it is then drawn on it
            size = (*size[:2], stance.top)
            parts[-1] += ", as high as the top"
    pose = tuple(base.homogeneous.ravel().tolist())
    names = tuple(str(model.names[joint]) for joint in locked)
    source = "; ".join(parts)
    below = undercarriage_of(model, data, base, root, wheels, supports, z or 0.0)
    return Reading(table or LECTURE_TABLE, body, size, source, pose, stance, names, tuple(wheels), below)


def _starts_with_slides(model: pin.Model) -> bool:
    """Return whether the model is the chain: three joints in series, two of them prismatic."""
    if model.njoints < 4 or [model.parents[j] for j in (1, 2, 3)] != [0, 1, 2]:
        return False
    return sum(joint.slides for joint in joints_of(model)[:3]) >= 2


def _is_floating(model: pin.Model, joint: int) -> bool:
    alone = sum(parent == 0 for parent in list(model.parents)[1:]) == 1
    return alone and Joint.of(model, joint).floats


def _chain_table(model: pin.Model, data: pin.Data, name: str) -> DHTable | None:
    """Check that each joint is the one expected, and return the table whose frames they have, if any."""
    for joint, (kind, axis) in enumerate(_CHAIN, start=1):
        expected = f"expected a {kind} one along {axis}: joint {joint} of y, x, psi"
        own = Joint.of(model, joint)
        if own.nv != 1:
            raise InvalidArgument(f"{name}: joint {own}, {expected}")
        column = pin.getJointJacobian(model, data, joint, pin.WORLD)[:, own.v.start]
        is_kind = "revolute" if np.linalg.norm(column[3:]) > 0.5 else "prismatic"
        got = column[3:] if is_kind == "revolute" else column[:3]
        if is_kind != kind or np.abs(got - axis).max() > _ALIGNED:
            listed = ", ".join(f"{x:.4g}" for x in got.round(9) + 0.0)
            raise InvalidArgument(
                f"{name}: joint {model.names[joint]!r} is {is_kind} along ({listed}), {expected}"
            )
        if np.abs(column[:3] - (axis if kind == "prismatic" else 0)).max() > _ALIGNED:
            raise InvalidArgument(
                f"{name}: the axis of joint {model.names[joint]!r} does not pass through the origin when all "
                "joints are at zero, expected that it does"
            )
    frames = np.stack([data.oMi[k].homogeneous for k in (1, 2, 3)])
    for table in (LECTURE_TABLE, SLIDE_TABLE):
        if np.abs(frames - table.placements(np.zeros(3))).max() <= _ALIGNED:
            return table
    return None


def _locked(model: pin.Model, root: int, name: str) -> list[int]:
    """Return the joints to lock: wheels and what only carries wheels. Refuse any other."""
    above = range(root + 1, model.njoints)
    for joint, own in zip(above, joints_of(model, root + 1), strict=True):
        if model.parents[joint] == root and not carries_only_wheels(model, joint):
            raise InvalidArgument(
                f"{name}: joint {own.name!r} (JointModel{own.kind}) is neither a wheel "
                "(continuous, or without limits) nor a suspension or swivel that carries only wheels; "
                "expected a bare base, or the chain prismatic y, prismatic x, revolute z with one body"
            )
    return list(above)


def _lump(model: pin.Model, data: pin.Data, base: pin.SE3, joints: Iterable[int], name: str) -> Body:
    """Return all that is on the joints as one body, seen from the base at rest."""
    total = pin.Inertia.Zero()
    for joint in joints:
        if data.oMi[joint] == base:  # to the last digit, then
            total += model.inertias[joint]
        else:
            total += (base.inverse() * data.oMi[joint]).act(model.inertias[joint])
    if not total.mass > 0:
        raise InvalidArgument(f"{name}: the body has mass {total.mass} kg, expected > 0")
    for joint in (1, 2):
        on_the_way = joint not in joints and model.njoints > joint
        if on_the_way and model.inertias[joint].mass > _MASSLESS * total.mass:
            raise InvalidArgument(
                f"{name}: joint {model.names[joint]!r} moves a link of {model.inertias[joint].mass:.6g} kg, "
                "expected a massless virtual link"
            )
    try:
        return Body(total.mass, total.lever, total.inertia)
    except InvalidArgument as error:
        raise InvalidArgument(f"{name}: {error}") from None


def _only_body(root: ElementTree.Element, model: pin.Model) -> tuple[int, Body] | None:
    """Return the body of a file that has only one, as it is written, and the joint whose frame it is in."""
    links = [link for link in root.iterfind("link") if link.find("inertial") is not None]
    if len(links) != 1:
        return None
    frame = model.frames[model.getFrameId(links[0].get("name", ""), pin.FrameType.BODY)]
    mass, inertia, origin = (links[0].find(f"inertial/{part}") for part in ("mass", "inertia", "origin"))
    given = {} if origin is None else origin.attrib
    turned = any(map(float, given.get("rpy", "0 0 0").split()))
    if turned or mass is None or inertia is None or frame.placement != pin.SE3.Identity():
        return None
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, "0")) for key in MOMENTS)
    com = np.array([float(word) for word in given.get("xyz", "0 0 0").split()])
    moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    try:
        return frame.parentJoint, Body(float(mass.get("value", "0")), com, moments)
    except InvalidArgument:
        return None  # what is wrong with it is said of the whole


def _largest_box(root: ElementTree.Element) -> tuple[float, float, float] | None:
    """Return the size of the largest box that the file shows, if it shows one."""
    sizes: list[tuple[float, float, float]] = []
    for box in root.iterfind("./link/visual/geometry/box"):
        try:
            x, y, z = (float(word) for word in box.get("size", "").split())
        except ValueError:
            continue
        sizes.append((x, y, z))
    return max(sizes, key=lambda size: size[0] * size[1] * size[2], default=None)


def _box_of_inertia(body: Body) -> tuple[float, float, float]:
    """Return the sides of the homogeneous box with this mass and these moments about x, y and z."""
    moments: Array = np.diag(body.inertia)
    squares = 6 / body.mass * (moments.sum() - 2 * moments)
    x, y, z = np.sqrt(np.maximum(squares, 1e-4))
    return float(x), float(y), float(z)
