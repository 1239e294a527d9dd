"""Ground contacts of a robot: footprint, wheels and their swivels; and the metrics of its arms."""

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
from pinmobile.errors import InvalidArgument, argument_errors
from pinmobile.metrics import Metric
from pinmobile.parts import by_value, number, option, part
from pinmobile.plant import limit_slack
from pinmobile.robot.linkage import Joint, turns_freely

WEIGHTLESS = 1e-9  # share of the weight below which a force of the ground counts as rounding

_STRAIGHT = 1e-9  # distance from an edge that is rounding, as a share of the footprint or of the edge
_FLAT = 1e-12  # area of a straight corner by rounding, as a share of a square about the footprint


def check_footprint(footprint: ArrayLike) -> Array:
    """Return the corners of a convex polygon, counter-clockwise, shape (k, 2) [m].

    Parameters
    ----------
    footprint : array_like, shape (k, 2)
        Corners in the body frame [m].

    Raises
    ------
    InvalidArgument
        If the polygon has fewer than three corners, is not finite, has no area, or is not convex.
    """
    given = shaped("footprint", finite("footprint", footprint), ("k>=3", 2))
    corners = hull(given)
    if corners is None:
        raise InvalidArgument(f"footprint is {given.tolist()}, expected a polygon with an area > 0")
    margins = margin_inside(corners, given)
    if margins.max() > _STRAIGHT * np.ptp(given):
        k = int(margins.argmax())
        raise InvalidArgument(
            f"footprint is not convex at the corner {given[k].tolist()}, expected a convex polygon"
        )
    return corners


def hull(points: ArrayLike) -> Array | None:
    """Return the corners of the convex hull of points, counter-clockwise from the point with the smallest x.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        Points in any order.

    Returns
    -------
    corners : ndarray, shape (k, 2), or None
        Corners without points on straight edges, by Andrew's monotone chain; None for a hull without area.
    """
    given = np.reshape(np.asarray(points, np.float64), (-1, 2))
    if len(given) < 3:
        return None
    flat = _FLAT * float(np.ptp(given, axis=0).max()) ** 2
    x, y = given.round(9).T  # rounding must not determine the order
    points_x = given[np.lexsort((y, x))]
    halves: list[Array] = []
    for way in (points_x, points_x[::-1]):
        chain: list[Array] = []
        for point in way:
            while len(chain) > 1 and _cross(chain[-1] - chain[-2], point - chain[-1]) <= flat:
                chain.pop()
            chain.append(point)
        halves += chain[:-1]
    return np.array(halves) if len(halves) > 2 else None


def margin_inside(corners: Array, points: Array) -> Array:
    """Return the signed distance of points from the edge of a polygon, positive inside, shape (...) [m].

    Parameters
    ----------
    corners : ndarray, shape (k, 2)
        Corners from `checked_footprint` [m].
    points : ndarray, shape (..., 2)
        Points in the same frame [m].
    """
    edges = np.roll(corners, -1, axis=0) - corners  # (k, 2)
    shares = edges / np.square(edges).sum(axis=-1, keepdims=True)
    from_corner = points[..., None, :] - corners  # (..., k, 2)
    share = np.clip((from_corner * shares).sum(axis=-1), 0.0, 1.0)
    square = np.square(from_corner - share[..., None] * edges).sum(axis=-1)
    distance: Array = np.sqrt(np.min(square, axis=-1))
    on_edge = -_STRAIGHT * np.square(edges).sum(axis=-1)  # a point may lie outside by rounding
    is_inside = np.all(_cross(edges, from_corner) >= on_edge, axis=-1)
    return np.where(is_inside, distance, -distance)


def zero_moment_point_of(wrench: Array, has_load: NDArray[np.bool_]) -> Array:
    """Return the zero-moment point, where the ground's wrench has no horizontal moment, shape (..., 2) [m].

    Parameters
    ----------
    wrench : ndarray, shape (..., 6)
        Wrench of the ground on the body, along and about the axes of the body frame [N, N m].
    has_load : ndarray of bool, shape (...)
        Whether the ground carries the body; otherwise, the point is NaN.
    """
    vertical = np.where(has_load, wrench[..., 2], np.nan)
    return np.stack([-wrench[..., 4] / vertical, wrench[..., 3] / vertical], axis=-1)


def margin_of_wrench(corners: Array, wrench: Array, weight: Any) -> Array:
    """Return the margin of the zero-moment point, shape (...) [m]; -inf if the ground carries no weight.

    Parameters
    ----------
    corners, wrench
        As in `margin_inside` and `zero_moment_point_of`.
    weight : scalar or ndarray, shape (...)
        Weight of the robot [N].
    """
    has_load = wrench[..., 2] > WEIGHTLESS * weight
    return np.where(has_load, margin_inside(corners, zero_moment_point_of(wrench, has_load)), -np.inf)


def _kept_footprint(name: str, footprint: ArrayLike | None) -> Array | None:
    return None if footprint is None else frozen(check_footprint(footprint))


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


@by_value
@part
class SupportGeometry:
    """Contact geometry of a body on the ground, in its body frame B.

    Parameters
    ----------
    footprint : array_like, shape (k, 2), optional
        Corners of the convex support polygon [m]; None for an unknown polygon.
    top : float, optional
        Height of the highest point above the ground [m]; None for an unknown height.
    grounded : bool
        Whether the height of B is known: its origin then lies on the ground. Otherwise, `top` is unknown too.

    Raises
    ------
    InvalidArgument
        If the footprint is not a convex polygon, or the top is not above the ground.

    See Also
    --------
    MobileRobot.footprint : support polygon of a robot
    balance.tip_over_margin : distance to the edge of the footprint

    Examples
    --------
    >>> from pinmobile.robot import SupportGeometry
    >>> stance = SupportGeometry.of_box((0.6, 0.4, 0.2))
    >>> stance.footprint.max(axis=0), stance.top  # [m]
    (array([0.3, 0.2]), 0.2)
    """

    footprint: Any = option(default=None, check=_kept_footprint, doc="corners of the footprint")
    top: float | None = number(default=None, unit="m", above=0.0, doc="height of the top")
    grounded: bool = option(default=True, doc="whether the ground is known")

    @classmethod
    def of_box(cls, size: ArrayLike) -> SupportGeometry:
        """Return the contact geometry of a box that stands on the ground, centred at the origin of B.

        Parameters
        ----------
        size : array_like, shape (3,)
            Length, width and height, each > 0 [m].

        Returns
        -------
        SupportGeometry
            Contact geometry of the box.

        Raises
        ------
        InvalidArgument
            If the argument is not three positive lengths.
        """
        length, width, height = lengths(size).tolist()
        corners = [[-length, -width], [length, -width], [length, width], [-length, width]]
        return cls(0.5 * np.array(corners), height)

    def written(self) -> dict[str, str]:
        """Return the contact geometry as attributes of the element <pinmobile> of a URDF."""
        words = {"ground": "0"} if self.grounded else {}
        if self.footprint is not None:
            words["footprint"] = " ".join(map(repr, self.footprint.ravel().tolist()))
        return words if self.top is None else {**words, "top": repr(self.top)}


def read_stance(root: Element, name: str) -> SupportGeometry | None:
    """Return the contact geometry from the element <pinmobile> of a file, or None for a file without it.

    Raises
    ------
    InvalidArgument
        If the element has invalid values.
    """
    element = root.find("pinmobile")
    if element is None:
        return None
    corners, top = element.get("footprint", "").split(), element.get("top")
    words = f"{name}: <pinmobile> has {element.attrib}, expected x y of corners, and a top: "
    with argument_errors(words, of=(ValueError, InvalidArgument)):
        footprint = np.reshape([*map(float, corners)], (-1, 2)) if corners else None
        height = None if top is None else float(top)
        return SupportGeometry(footprint, height, element.get("ground") is not None)


@dataclass(frozen=True, eq=False)
class ArmMetrics:
    """Metrics of a robot with arms, for Pinocchio's numbers, symbols and arrays.

    Parameters
    ----------
    tips : tuple of (str, str)
        Name of each arm and frame of its end effector.
    effort_limit : ndarray, shape (nv,)
        Limit of the absolute inputs [N, N m]; infinite for no limit.
    positions, rates : (ndarray, ndarray)
        Least and largest q and v [m, rad; per s]; infinite for no limit.
    footprint : ndarray, shape (k, 2), or None
        Support polygon [m]; None if the polygon or the height above the ground is unknown.
    rest : ndarray, shape (nq,)
        Reference of the coordinates that a reference lacks.
    """

    tips: tuple[tuple[str, str], ...]
    effort_limit: Array
    positions: tuple[Array, Array]
    rates: tuple[Array, Array]
    footprint: Array | None
    rest: Array

    @classmethod
    def of(cls, robot: Any) -> ArmMetrics:
        """Return the metrics of a `MobileRobot`."""
        tips = tuple((mount.name, mount.tip) for mount in robot.mounts)
        stands = robot.footprint if robot.grounded else None
        speed = robot.velocity_limit
        ranges = (robot.lower, robot.upper), (-speed, speed)
        return cls(tips, robot.effort_limit, *ranges, stands, robot.rest)

    @property
    def _limit_rows(self) -> list[int]:
        return np.flatnonzero(np.isfinite(self.effort_limit)).tolist()

    @cached_property
    def metrics(self) -> tuple[Metric, ...]:
        """Metrics that `evaluate_metrics` computes."""
        metrics = []
        for k, (arm, tip) in enumerate(self.tips):
            of = f" of {arm}" if k else ""  # the metrics of the first arm have no name of an arm
            pose_name = "its reference pose"
            metrics.append(Metric(f"end effector{of}", "m", f"distance of {tip} from {pose_name}"))
            metrics.append(Metric(f"end effector angle{of}", "rad", f"angle of {tip} to {pose_name}"))
        if self._limit_rows:
            words = "largest ratio of a joint's force or torque to its effort limit"
            metrics.append(Metric("effort", "", words))
        if self.footprint is not None:
            words = "distance of the zero-moment point inside the footprint's edge"
            metrics.append(Metric("tip-over margin", "m", words, "smallest"))
        return (*metrics, *self.limit_metrics)

    @cached_property
    def limit_metrics(self) -> tuple[Metric, ...]:
        """Metrics that `exceeded_limits` computes."""
        words = {"position": "a joint leaves its range", "speed": "a joint is faster than its limit"}
        pairs = zip(words.items(), self._limits, strict=True)
        return tuple(
            Metric(f"exceed a {name} limit", "", words, "ever") for (name, words), (rows, *_) in pairs if rows
        )

    @cached_property
    def _limits(self) -> list[tuple[list[int], Array, Array]]:
        """Indices of the entries of q and v with limits, and their limits with a tolerance."""
        limits = []
        for low, high in (self.positions, self.rates):
            rows = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
            slack = limit_slack(low[rows], high[rows])
            limits.append((rows.tolist(), low[rows] - slack, high[rows] + slack))
        return limits

    def exceeded_limits(self, q: Array, v: Array) -> list[Any]:
        """Return the values of `limit_metrics`, each of shape (...), from q and v of the robot."""
        excesses = [
            np.max(np.maximum(low - x[..., rows], x[..., rows] - high), axis=-1)
            for x, (rows, low, high) in zip((q, v), self._limits, strict=True)
            if rows
        ]
        return [np.where(excess > 0.0, 1.0, 0.0) for excess in excesses]

    def pose_errors(self, robot: Any, q: Array, desired: Array) -> Array:
        """Return each end effector's distance [m] and angle [rad] to its reference pose, shape (..., 2 k).

        Parameters
        ----------
        robot, q, desired
            As in `evaluate_metrics`.
        """
        rest = self.rest[np.shape(desired)[-1] :]
        rest = np.broadcast_to(rest, (*np.shape(desired)[:-1], len(rest)))
        desired = np.concatenate([desired, rest], axis=-1)
        poses = ((robot.frame_pose(q, tip), robot.frame_pose(desired, tip)) for _, tip in self.tips)
        errors = [each for pair in poses for each in _pose_distance(*pair)]
        return np.stack(np.broadcast_arrays(*errors), axis=-1)

    def evaluate_metrics(self, robot: Any, q: Array, v: Array, a: Array, u: Array, desired: Array) -> Array:
        """Return the metrics for a given motion, shape (..., m).

        Parameters
        ----------
        robot : MobileRobot or ArticulatedDynamics
            Robot with kinematics and dynamics.
        q, v, a, u : ndarray, shape (..., nq), (..., nv), (..., nv), (..., nv)
            State, acceleration and input.
        desired : ndarray, shape (..., k)
            Reference of the first numbers of q.
        """
        values: list[Any] = []
        if self.tips:
            errors = self.pose_errors(robot, q, desired)
            values += [errors[..., k] for k in range(2 * len(self.tips))]
        if self._limit_rows:
            shares = np.abs(u[..., self._limit_rows]) * (1.0 / self.effort_limit[self._limit_rows])
            values.append(np.max(shares, axis=-1))
        if self.footprint is not None:
            wrench = robot.ground_wrench(q, v, a)
            values.append(margin_of_wrench(self.footprint, wrench, robot.weight))
        values += self.exceeded_limits(q, v)
        return np.stack(np.broadcast_arrays(*values), axis=-1)


def _pose_distance(first: Array, second: Array) -> tuple[Array, Array]:
    """Return the distance [m] and the angle [rad], in [0, pi], between poses, shape (..., 4, 4)."""
    way = second[..., :3, 3] - first[..., :3, 3]
    # For the relative rotation, the trace is 1 + 2 cos, and the skew part has the length sin.
    trace: Any = 0.0
    axis: list[Any] = [0.0, 0.0, 0.0]
    for k in range(3):
        x, y = first[..., :3, k], second[..., :3, k]
        trace = trace + x[..., 0] * y[..., 0] + x[..., 1] * y[..., 1] + x[..., 2] * y[..., 2]
        for i in range(3):
            j, m = (i + 1) % 3, (i + 2) % 3
            axis[i] = axis[i] + (x[..., j] * y[..., m] - x[..., m] * y[..., j])
    sine = 0.5 * np.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    return np.sqrt(np.sum(way * way, axis=-1)), np.arctan2(sine, 0.5 * (trace - 1.0))


_TRAIL = 1e-3  # [m]: smallest trail of a wheel
MIN_COSINE = 0.995  # smallest cosine of equal directions: files have angles such as 1.57

Triple = tuple[float, float, float]


class Lump(NamedTuple):
    """Rigidly connected links at rest, as one body.

    Attributes
    ----------
    mass : float
        Mass [kg]; zero for links without mass.
    com : tuple of 3 floats
        Centre of mass in the body frame B [m].
    inertia : tuple of 3 tuples of 3 floats
        Inertia about the centre of mass, along the axes of B [kg m^2].
    """

    mass: float
    com: Triple
    inertia: tuple[Triple, Triple, Triple]


class Swivel(NamedTuple):
    """Vertical joint that carries a wheel.

    Attributes
    ----------
    name : str
        Name of the joint.
    x, y : float
        Position of its axis in B [m].
    limit : float
        Largest angle to either side [rad]; infinite for a free joint.
    lump : Lump
        All links that turn with the joint, including wheels.
    """

    name: str
    x: float
    y: float
    limit: float
    lump: Lump

    def turning(self, wheel: WheelJoint, lateral: float) -> tuple[float, float]:
        """Return the mass and yaw inertia at the wheel's centre that represent all links on the swivel.

        In the plane, a rigid body on a pivot acts through its first and second moments about the pivot. A
        mass at the wheel's centre has the first moment along the trail. The remaining mass is at the pivot,
        as part of the body. If this mass is not positive, or there is no trail, the function returns the
        wheel's mass, with the rest at the pivot.

        Parameters
        ----------
        wheel : WheelJoint
            Wheel on the swivel.
        lateral : float
            Moment of inertia of the wheel across its axle [kg m^2].
        """
        fork = self._axial_inertia(self.lump) - self._axial_inertia(wheel.lump)
        o = np.array([wheel.centre[0] - self.x, wheel.centre[1] - self.y])
        square = float(o @ o)
        if square > _TRAIL**2:
            first = self.lump.mass * float(o @ [self.lump.com[0] - self.x, self.lump.com[1] - self.y])
            mass = first / square
            yaw = fork + lateral + wheel.lump.mass * self._square(wheel.lump) - mass * square
            if mass > 0 and yaw > 0:
                return mass, yaw
        return wheel.lump.mass, lateral + max(fork, 0.0)

    def _square(self, lump: Lump) -> float:
        return (lump.com[0] - self.x) ** 2 + (lump.com[1] - self.y) ** 2

    def _axial_inertia(self, lump: Lump) -> float:
        """Return the moment of inertia of links about the swivel's axis [kg m^2]."""
        return lump.inertia[2][2] + lump.mass * self._square(lump)


class WheelJoint(NamedTuple):
    """Wheel of a model, at rest.

    Attributes
    ----------
    name : str
        Name of the axle's joint.
    joint : int
        Number of this joint.
    centre : tuple of 3 floats
        Centre of the wheel, on its axle, in B [m].
    axis : tuple of 3 floats
        Horizontal unit vector of the axle, in the positive sense of the joint.
    radius : float or None
        Radius [m]; None if the model does not contain it.
    lump : Lump
        All links that turn with the wheel.
    swivels : tuple of Swivel
        Swivels between the body and the wheel.
    carried : tuple of str
        Joints on the wheel, such as those of rollers.
    effort : float
        Largest torque of the joint [N m]; infinite for no limit.
    rate : float
        Largest rate of the joint [rad/s]; infinite for no limit.
    damping, friction : float
        Damping and friction of the joint [N m s/rad, N m].
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
    rate: float = np.inf
    damping: float = 0.0
    friction: float = 0.0

    def moments(self) -> tuple[float, tuple[float, float], float, float]:
        """Return the quantities that identify a solid of revolution about the axle.

        Returns
        -------
        spin : float
            Moment of inertia about the axle [kg m^2].
        across : tuple of 2 floats
            Moments of inertia across the axle, about a horizontal axis and the vertical [kg m^2].
        product : float
            Largest product of inertia in these axes [kg m^2].
        offset : float
            Distance of the centre of mass from the axle [m].
        """
        axle = np.array(self.axis)
        frame = np.stack([axle, np.cross([0.0, 0.0, 1.0], axle), [0.0, 0.0, 1.0]])
        inertia = frame @ np.array(self.lump.inertia) @ frame.T
        spin, level, vertical = inertia.diagonal().tolist()
        product = float(np.abs(inertia[np.triu_indices(3, 1)]).max())
        offset = np.linalg.norm(np.cross(np.subtract(self.lump.com, self.centre), axle))
        return spin, (level, vertical), product, float(offset)


class Undercarriage(NamedTuple):
    """Wheels and supports of a robot's model.

    Attributes
    ----------
    wheels : tuple of WheelJoint
        Wheels in the order of the model.
    supports : tuple of (float, float)
        Contact points of parts that do not roll (fixed casters and skids) in B [m].
    """

    wheels: tuple[WheelJoint, ...] = ()
    supports: tuple[tuple[float, float], ...] = ()


def triple(values: Iterable[float]) -> Triple:
    """Return three numbers as floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def joint_axis(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Array:
    """Return the axis of a revolute joint, seen from a base; zeros for a prismatic joint."""
    # For a model with one joint, Pinocchio returns a Jacobian without the second axis.
    jacobian = pin.getJointJacobian(model, data, joint, pin.WORLD).reshape(6, -1)
    return np.asarray(base.rotation.T @ jacobian[3:, model.idx_vs[joint]])


def seen_from(base: pin.SE3, joint: pin.SE3, item: Any) -> Any:
    """Return a placement or an inertia of a joint's frame in the frame of a base; exact for equal frames."""
    if joint == base:
        return item
    to_base = base.inverse() * joint
    return to_base.act(item)


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
        Model and data with all joints at rest and computed Jacobians.
    base : pin.SE3
        Pose of B.
    root : int
        Joint of the root link.
    wheels : sequence of WheelJoint
        Wheels from `wheels_of`.
    supports : sequence of (float, float)
        Contact points of parts that do not roll, in B [m].
    ground : float
        Height z of B in the frame of the root link [m].
    """
    wheels_at = []
    for wheel in wheels:
        swivels, joint = [], int(model.parents[wheel.joint])
        while joint > root:
            if model.nvs[joint] == 1 and abs(joint_axis(model, data, base, joint)[2]) > MIN_COSINE:
                swivels.append(_swivel(model, data, base, joint))
            joint = int(model.parents[joint])
        hub = (base.inverse() * data.oMi[wheel.joint]).translation
        offset = np.array(wheel.centre) - [0, 0, ground] - hub
        v, centre = model.idx_vs[wheel.joint], triple(hub + (offset @ wheel.axis) * np.array(wheel.axis))
        lump = _lump_of(model, data, base, wheel.joint)
        effort, rate = (float(x[v]) if x[v] > 0 else np.inf for x in (model.effortLimit, model.velocityLimit))
        damping, friction = float(model.damping[v]), float(model.friction[v])
        joint_c = wheel._replace(centre=centre, lump=lump, swivels=tuple(swivels))
        wheels_at.append(joint_c._replace(effort=effort, rate=rate, damping=damping, friction=friction))
    return Undercarriage(tuple(wheels_at), tuple(supports))


def _lump_of(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Lump:
    total = pin.Inertia.Zero()
    for each in model.subtrees[joint]:
        if model.inertias[each].mass > 0:
            total += (base.inverse() * data.oMi[each]).act(model.inertias[each])
    first, second, third = (triple(row) for row in total.inertia)
    point = total.lever if total.mass > 0 else (base.inverse() * data.oMi[joint]).translation
    return Lump(float(total.mass), triple(point), (first, second, third))


def _swivel(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Swivel:
    x, y, _ = triple((base.inverse() * data.oMi[joint]).translation)
    limit = np.inf
    if not turns_freely(model, joint):
        q = Joint.of(model, joint).q
        limit = min(abs(float(model.lowerPositionLimit[q][0])), abs(float(model.upperPositionLimit[q][0])))
    return Swivel(str(model.names[joint]), x, y, limit, _lump_of(model, data, base, joint))
