"""What a robot stands on: its footprint, its wheels and their swivels; and the metrics of its arms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, finite, frozen, lengths, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.metrics import Metric
from pinmobile.parts import by_value, number, option, part
from pinmobile.robot.linkage import Joint, turns_freely

WEIGHTLESS = 1e-9
"""Share of the weight: a vertical force of the ground that only rounding made."""

_STRAIGHT = 1e-9  # of the footprint: how far a straight corner may be inside
_FLAT = 1e-12  # of the area of a square about the footprint: what rounding leaves of a straight corner


def rectangle(length: float, width: float) -> Array:
    """Return the corners of a rectangle about the origin, shape (4, 2) [m], counter-clockwise."""
    return 0.5 * np.array([[-length, -width], [length, -width], [length, width], [-length, width]])


def checked_footprint(footprint: ArrayLike) -> Array:
    """Return the corners of a convex polygon, counter-clockwise, shape (k, 2).

    Parameters
    ----------
    footprint : array_like, shape (k, 2)
        Its corners, in the body's frame [m].

    Raises
    ------
    InvalidArgument
        If it has fewer than three corners, is not finite, has no area, or is not convex.
    """
    given = shaped("footprint", finite("footprint", footprint), ("k>=3", 2))
    corners = hull(given)
    if corners is None:
        raise InvalidArgument(f"footprint is {given.tolist()}, expected a polygon with an area > 0")
    inside = margin_inside(corners, given)
    if inside.max() > _STRAIGHT * np.ptp(given):
        k = int(inside.argmax())
        raise InvalidArgument(
            f"footprint is not convex at the corner {given[k].tolist()}, expected a convex polygon"
        )
    return corners


def hull(points: ArrayLike) -> Array | None:
    """Return the corners of the convex hull of points, counter-clockwise from the one with the least x.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        In any order.

    Returns
    -------
    corners : ndarray, shape (k, 2), or None
        Without those on a straight edge; None where the hull has no area. By Andrew's monotone chain.
    """
    given = np.reshape(np.asarray(points, np.float64), (-1, 2))
    if len(given) < 3:
        return None
    flat = _FLAT * float(np.ptp(given, axis=0).max()) ** 2
    x, y = given.round(9).T  # what differs by rounding alone has no order
    ordered = given[np.lexsort((y, x))]
    halves: list[Array] = []
    for way in (ordered, ordered[::-1]):
        kept: list[Array] = []
        for point in way:
            while len(kept) > 1 and _cross(kept[-1] - kept[-2], point - kept[-1]) <= flat:
                kept.pop()
            kept.append(point)
        halves += kept[:-1]
    return np.array(halves) if len(halves) > 2 else None


def margin_inside(corners: Array, points: Array) -> Array:
    """Return the signed distance of points from the edge of a polygon, positive inside, shape (...) [m].

    Parameters
    ----------
    corners : ndarray, shape (k, 2)
        As `checked_footprint` returns them.
    points : ndarray, shape (..., 2)
        In the same frame [m].
    """
    edges = np.roll(corners, -1, axis=0) - corners  # (k, 2)
    shares = edges / np.square(edges).sum(axis=-1, keepdims=True)
    from_corner = points[..., None, :] - corners  # (..., k, 2)
    along = np.clip((from_corner * shares).sum(axis=-1), 0.0, 1.0)
    square = np.square(from_corner - along[..., None] * edges).sum(axis=-1)
    distance: Array = np.sqrt(np.min(square, axis=-1))
    inside = np.all(_cross(edges, from_corner) >= 0, axis=-1)
    return np.where(inside, distance, -distance)


def pressed_at(wrench: Array, carried: NDArray[np.bool_]) -> Array:
    """Return the point of the ground about which its wrench has no level moment, shape (..., 2) [m].

    Parameters
    ----------
    wrench : ndarray, shape (..., 6)
        Of the ground on the body, along and about the axes of its frame, whose origin lies on the ground.
    carried : ndarray of bool, shape (...)
        Whether the ground carries the body; NaN where it does not.
    """
    vertical = np.where(carried, wrench[..., 2], np.nan)
    return np.stack([-wrench[..., 4] / vertical, wrench[..., 3] / vertical], axis=-1)


def _kept_footprint(name: str, footprint: ArrayLike | None) -> Array | None:
    return None if footprint is None else frozen(checked_footprint(footprint))


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


@by_value
@part
class Stance:
    """How a body stands on the ground, in its frame B.

    Parameters
    ----------
    footprint : array_like, shape (k, 2), optional
        Corners of the convex polygon on which it stands [m]; None where it is not known.
    top : float, optional
        Height of its highest point above the ground [m]; None where it is not known.
    grounded : bool
        Whether B's origin is known to lie on the ground; without that, `top` is not known either.

    Raises
    ------
    InvalidArgument
        If the footprint is no convex polygon, or the top is not above the ground.
    """

    footprint: Any = option(default=None, check=_kept_footprint, doc="corners of the footprint")
    top: float | None = number(default=None, unit="m", above=0.0, optional=True, doc="height of the top")
    grounded: bool = option(default=True, doc="whether the ground is known")

    @classmethod
    def of_box(cls, size: ArrayLike) -> Stance:
        """Return that of a box that stands about B's origin.

        Parameters
        ----------
        size : array_like, shape (3,)
            Length, width and height, each above zero [m].

        Raises
        ------
        InvalidArgument
            If they are something else.
        """
        length, width, height = lengths(size).tolist()
        return cls(rectangle(length, width), height)

    def written(self) -> dict[str, str]:
        """Return it as attributes of the element <pinmobile> of a URDF, which `stance_written` reads."""
        words = {"ground": "0"} if self.grounded else {}
        if self.footprint is not None:
            words["footprint"] = " ".join(map(repr, self.footprint.ravel().tolist()))
        return words if self.top is None else {**words, "top": repr(self.top)}


def stance_written(root: Element, name: str) -> Stance | None:
    """Return what a file of our own says in its element <pinmobile>, or None where there is none.

    Raises
    ------
    InvalidArgument
        If it says what cannot be.
    """
    element = root.find("pinmobile")
    if element is None:
        return None
    corners, top = element.get("footprint", "").split(), element.get("top")
    try:
        footprint = np.reshape([*map(float, corners)], (-1, 2)) if corners else None
        return Stance(footprint, None if top is None else float(top), element.get("ground") is not None)
    except ValueError as error:
        words = f"{name}: <pinmobile> has {element.attrib}, expected x y of corners, and a top"
        raise InvalidArgument(f"{words}: {error}") from None


@dataclass(frozen=True, eq=False)
class ArmMetrics:
    """The metrics of a robot with arms, and their law, for Pinocchio's numbers as for symbols and arrays.

    Parameters
    ----------
    tips : tuple of (str, str)
        The arms' names, and the frames of their end effectors.
    effort_limit : ndarray, shape (nv,)
        Largest |u| [N, N m]; infinite where there is no limit.
    footprint : ndarray, shape (k, 2), or None
        What the robot stands on, where that and the ground's height are known [m].
    rest : ndarray, shape (nq,)
        Where the reference puts what it does not lead.
    """

    tips: tuple[tuple[str, str], ...]
    effort_limit: Array
    footprint: Array | None
    rest: Array

    @classmethod
    def of(cls, robot: Any) -> ArmMetrics:
        """Return that of a `MobileRobot`."""
        tips = tuple((mount.name, mount.tip) for mount in robot.mounts)
        stands = robot.footprint if robot.grounded else None
        return cls(tips, robot.effort_limit, stands, robot.rest)

    @property
    def _limited(self) -> list[int]:
        return np.flatnonzero(np.isfinite(self.effort_limit)).tolist()

    @cached_property
    def metrics(self) -> tuple[Metric, ...]:
        """What `evaluate_metrics` returns."""
        found = []
        for k, (arm, tip) in enumerate(self.tips):
            of = f" of {arm}" if k else ""  # the first arm's is the robot's
            where = "where the reference puts it"
            found.append(Metric(f"end effector{of}", "m", f"distance of {tip} from {where}"))
            found.append(Metric(f"end effector angle{of}", "rad", f"angle of {tip} to {where}"))
        if self._limited:
            words = "largest |force or torque| of a joint, of what its motor can do"
            found.append(Metric("effort", "", words))
        if self.footprint is not None:
            words = "distance of the zero-moment point inside the footprint's edge"
            found.append(Metric("tip-over margin", "m", words, "smallest"))
        return tuple(found)

    def apart(self, robot: Any, q: Array, desired: Array) -> Array:
        """Return each end effector's distance [m] and angle [rad] to where the reference puts it, (..., 2 k).

        Parameters
        ----------
        robot, q, desired
            As in `evaluate_metrics`.
        """
        rest = self.rest[np.shape(desired)[-1] :]
        rest = np.broadcast_to(rest, (*np.shape(desired)[:-1], len(rest)))
        desired = np.concatenate([desired, rest], axis=-1)
        poses = ((robot.frame_pose(q, tip), robot.frame_pose(desired, tip)) for _, tip in self.tips)
        found = [each for pair in poses for each in _apart(*pair)]
        return np.stack(np.broadcast_arrays(*found), axis=-1)

    def evaluate_metrics(self, robot: Any, q: Array, v: Array, a: Array, u: Array, desired: Array) -> Array:
        """Return the metrics of a robot that moves so, shape (..., m).

        Parameters
        ----------
        robot : MobileRobot or ArticulatedBody
            Whose kinematics and dynamics they are.
        q, v, a, u : ndarray, shape (..., nq), (..., nv), (..., nv), (..., nv)
            State, acceleration and input.
        desired : ndarray, shape (..., k)
            Where the reference has the first numbers of q.
        """
        found: list[Any] = []
        if self.tips:
            apart = self.apart(robot, q, desired)
            found += [apart[..., k] for k in range(2 * len(self.tips))]
        if self._limited:
            shares = np.abs(u[..., self._limited]) * (1.0 / self.effort_limit[self._limited])
            found.append(np.max(shares, axis=-1))
        if self.footprint is not None:
            wrench = robot.ground_wrench(q, v, a)
            carried = wrench[..., 2] > WEIGHTLESS * robot.weight
            margin = margin_inside(self.footprint, pressed_at(wrench, carried))
            found.append(np.where(carried, margin, -np.inf))
        return np.stack(np.broadcast_arrays(*found), axis=-1)


def _apart(one: Array, other: Array) -> tuple[Array, Array]:
    """Return the distance [m] and the angle [rad], in [0, pi], between poses, shape (..., 4, 4)."""
    way = other[..., :3, 3] - one[..., :3, 3]
    # Of the rotation from one to the other: 1 + 2 cos is its trace, and sin the length of its skew part.
    trace: Any = 0.0
    axis: list[Any] = [0.0, 0.0, 0.0]
    for k in range(3):
        x, y = one[..., :3, k], other[..., :3, k]
        trace = trace + x[..., 0] * y[..., 0] + x[..., 1] * y[..., 1] + x[..., 2] * y[..., 2]
        for i in range(3):
            j, m = (i + 1) % 3, (i + 2) % 3
            axis[i] = axis[i] + (x[..., j] * y[..., m] - x[..., m] * y[..., j])
    sine = 0.5 * np.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    return np.sqrt(np.sum(way * way, axis=-1)), np.arctan2(sine, 0.5 * (trace - 1.0))


_TRAIL = 1e-3  # [m]: a wheel nearer to its swivel than that does not trail
_ALONG = 0.995
"""Cosine beyond which two directions are the same: files have angles such as 1.57."""

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
    joint : int
        Number of that joint.
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
    joint: int
    centre: Triple
    axis: Triple
    radius: float | None
    lump: Lump = Lump(0.0, (0.0, 0.0, 0.0), ((0.0, 0.0, 0.0),) * 3)
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


def triple(values: Iterable[float]) -> Triple:
    """Return three numbers as floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def joint_axis(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Array:
    """Return the axis about which a joint turns, seen from a base; zeros where it slides."""
    # Of a model with one joint Pinocchio returns it without the second axis.
    jacobian = pin.getJointJacobian(model, data, joint, pin.WORLD).reshape(6, -1)
    return np.asarray(base.rotation.T @ jacobian[3:, model.idx_vs[joint]])


def seen_from(base: pin.SE3, joint: pin.SE3, own: Any) -> Any:
    """Return a placement or an inertia of a joint's frame in that of a base, to the last digit where same."""
    if joint == base:
        return own
    to_base = base.inverse() * joint
    return to_base.act(own)


def undercarriage_of(
    model: pin.Model,
    data: pin.Data,
    base: pin.SE3,
    root: int,
    wheels: Sequence[WheelJoint],
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
    wheels : sequence of WheelJoint
        As `wheels_of` returns them.
    supports : sequence of (float, float)
        Where what does not roll touches the ground, in B [m].
    ground : float
        z of B in the frame of the root link [m].
    """
    found = []
    for wheel in wheels:
        swivels, joint = [], int(model.parents[wheel.joint])
        while joint > root:
            if model.nvs[joint] == 1 and abs(joint_axis(model, data, base, joint)[2]) > _ALONG:
                swivels.append(_swivel(model, data, base, joint))
            joint = int(model.parents[joint])
        hub = (base.inverse() * data.oMi[wheel.joint]).translation
        along = np.array(wheel.centre) - [0, 0, ground] - hub
        v, centre = model.idx_vs[wheel.joint], triple(hub + (along @ wheel.axis) * np.array(wheel.axis))
        lump = _lump_of(model, data, base, wheel.joint)
        effort, damping, friction = (float(x[v]) for x in (model.effortLimit, model.damping, model.friction))
        placed = wheel._replace(centre=centre, lump=lump, swivels=tuple(swivels))
        most = effort if effort > 0 else np.inf
        found.append(placed._replace(effort=most, damping=damping, friction=friction))
    return Undercarriage(tuple(found), tuple(supports))


def _lump_of(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Lump:
    total = pin.Inertia.Zero()
    for each in model.subtrees[joint]:
        if model.inertias[each].mass > 0:
            total += (base.inverse() * data.oMi[each]).act(model.inertias[each])
    first, second, third = (triple(row) for row in total.inertia)
    at = total.lever if total.mass > 0 else (base.inverse() * data.oMi[joint]).translation
    return Lump(float(total.mass), triple(at), (first, second, third))


def _swivel(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Swivel:
    x, y, _ = triple((base.inverse() * data.oMi[joint]).translation)
    limit = np.inf
    if not turns_freely(model, joint):
        q = Joint.of(model, joint).q
        limit = min(abs(float(model.lowerPositionLimit[q][0])), abs(float(model.upperPositionLimit[q][0])))
    return Swivel(str(model.names[joint]), x, y, limit, _lump_of(model, data, base, joint))
