"""Wrenches between arm, base and ground: arm reactions, contact loads, stability and friction margins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import (
    Array,
    ArrayLike,
    bisect,
    broadcast,
    check_integer,
    finite,
    frozen,
    instance,
    positive,
    required,
    scalar,
    shaped,
    vector,
)
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.parts import Desired, Following, Grounded, require
from pinmobile.plant import ContactLoads, SlipMargins, refuse_path, robot_at, stated
from pinmobile.robot import WEIGHTLESS, check_footprint, margin_inside, zero_moment_point_of
from pinmobile.trajectories import Reference

_MAX_FACTOR = 1e6  # largest factor of the speed: beyond, the speed counts as unlimited
_MAX_ANGLE = np.pi / 2 - 1e-9  # [rad]


class MotionLike(Protocol):
    """A Rollout or a MotionStates.

    Any object with a plant and arrays q, v and a also satisfies this protocol.

    See Also
    --------
    balance.MotionStates : states given as arrays
    Rollout : result of a simulation

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> from pinmobile import MobileRobot, balance
    >>> motion = SimpleNamespace(
    ...     plant=MobileRobot.box(), q=[0, 0, 0], v=[0, 0, 0], a=[1, 0, 0]
    ... )
    >>> balance.required_friction(motion)  # |a| / g
    array(0.102)
    """

    @property
    def plant(self) -> Any:
        """`MobileRobot`, or another plant with ``ground_wrench(q, v, a) -> (..., 6)``."""

    @property
    def q(self) -> ArrayLike:
        """Configuration, shape (..., nq) [m, m, rad, ...]."""

    @property
    def v(self) -> ArrayLike:
        """Velocity, shape (..., nv) [m/s, m/s, rad/s, ...]."""

    @property
    def a(self) -> ArrayLike:
        """Acceleration, shape (..., nv) [m/s^2, m/s^2, rad/s^2, ...]."""


@dataclass(frozen=True, eq=False)
class MotionStates:
    """States and accelerations of a robot without a simulation: one state, or many along leading axes.

    Leading axes broadcast.

    Parameters
    ----------
    plant : MobileRobot or plant
        Robot. It has the method ``ground_wrench(q, v, a)``, the wrench (fx, fy, fz, mx, my, mz) of the ground
        on the body in the body frame, shape (..., 6) [N, N m]. It may have ``footprint``, the corners of the
        support polygon, shape (k, 2) [m].
    q : array_like, shape (..., nq)
        Configuration [m, m, rad, ...].
    v, a : array_like, shape (..., nv)
        Velocity and acceleration [m/s, m/s, rad/s, ...; per s].
    u : array_like, shape (..., nu), optional
        Input [N, N m or V], required for wheel forces.

    Raises
    ------
    InvalidArgument
        If `plant` has no ``ground_wrench``, or an array has another shape or is not finite.

    See Also
    --------
    balance.zero_moment_point : point of the ground reaction
    balance.tip_over_margin : distance to the edge of the support polygon
    Rollout : states of a simulation, with the same attributes

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.balance import MotionStates, tip_over_margin
    >>> tall = MobileRobot.box(mass=30.0, size=(0.6, 0.4, 1.0))
    >>> braking = MotionStates(tall, [0, 0, 0], [1, 0, 0], [-4, 0, 0])
    >>> tip_over_margin(braking)  # [m]
    array(0.0961)
    """

    plant: Any
    q: ArrayLike
    v: ArrayLike
    a: ArrayLike
    u: ArrayLike | None = None

    def __post_init__(self) -> None:
        robot = require("plant", self.plant, Grounded)
        for name, size in (("q", robot.nq), ("v", robot.nv), ("a", robot.nv)):
            object.__setattr__(self, name, frozen(vector(name, getattr(self, name), size)))
        if self.u is not None:
            object.__setattr__(self, "u", frozen(vector("u", self.u, robot.nu)))
        arrays = {name: getattr(self, name) for name in "qvau" if getattr(self, name) is not None}
        broadcast(**arrays)


def _robot_of(motion: Any) -> Any:
    require("motion", motion, MotionLike)
    return require("motion.plant", robot_at(motion.plant, stated(motion, "t")), Grounded)


def reaction_wrench(motion: MotionLike, mount: str | None = None) -> Array:
    """Return the force and moment of an arm and its loads on the base, at the mount.

    This is the arm's weight minus its rate of momentum, by Newton and Euler (Luh, Walker and Paul, 1980),
    computed by Pinocchio's RNEA.

    Parameters
    ----------
    motion : Rollout or MotionStates
        Robot, q, v and a.
    mount : str, optional
        Name of one of ``robot.mounts``; by default, the first one.

    Returns
    -------
    ndarray, shape (..., 6)
        (fx, fy, fz, mx, my, mz) [N, N, N, N m, N m, N m] along the axes of the body frame B (x forward, y
        left, z up), for any yaw of the mount. The moment is about the mount point. An arm at rest exerts its
        weight, (0, 0, -m g), and the moment (-m g y, m g x, 0), with its centre of mass at x and y from the
        mount point.

    Raises
    ------
    InvalidArgument
        If the plant of the motion is not a `MobileRobot` with an arm.
    UnknownName
        If no arm has this name.

    See Also
    --------
    MobileRobot.mount_wrench : the same wrench for given states
    balance.zero_moment_point : point of the ground reaction

    Examples
    --------
    >>> from pinmobile import MobileRobot, balance
    >>> robot = MobileRobot.box(mass=60.0).mount("ur5")
    >>> still = [0.0] * robot.nv
    >>> states = balance.MotionStates(robot, robot.rest, still, still)
    >>> print(balance.reaction_wrench(states)[2])  # arm's weight [N]
    -205.95
    """
    method = _method("motion.plant", _robot_of(motion), "mount_wrench", "the wrench of an arm")
    return method(motion.q, motion.v, motion.a, mount)  # type: ignore[no-any-return]


def zero_moment_point(motion: MotionLike) -> Array:
    """Return the zero-moment point: the ground reaction has no horizontal moment there, shape (..., 2) [m].

    Let f be the ground's force and m its moment about the origin of the body frame B, which lies on the
    ground. The point is (-m_y / f_z, m_x / f_z) from this origin, along the axes of B (Vukobratovic and
    Borovac, "Zero-moment point - thirty five years of its life", 2004). For a robot at rest, the point lies
    below the centre of mass. For a body with the centre of mass at height h and acceleration a, it lies h a /
    g behind.

    Parameters
    ----------
    motion : Rollout or MotionStates
        Robot, q, v and a. The ground reaction includes external forces, such as a push.

    Returns
    -------
    ndarray, shape (..., 2)
        x and y in the inertial frame [m]; NaN if the ground does not carry the robot.

    Raises
    ------
    InvalidArgument
        If the plant has no ``ground_wrench``, the motion does not fit the plant, or the robot's height above
        the ground is not known because its URDF does not contain this height.

    See Also
    --------
    balance.body_zero_moment_point : the same point in the body frame
    balance.tip_over_margin : distance of this point to the edge of the footprint

    Examples
    --------
    >>> from pinmobile import MobileRobot, balance
    >>> tall = MobileRobot.box(mass=30.0, size=(0.6, 0.4, 1.0))
    >>> push = balance.MotionStates(tall, [0, 0, 0], [0, 0, 0], [4, 0, 0])
    >>> x, y = balance.zero_moment_point(push)  # [m]
    >>> print(x, -0.5 * 4 / 9.81)
    -0.204 -0.204
    """
    point = body_zero_moment_point(motion)
    pose = _robot_of(motion).pose(motion.q)
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, y = point[..., 0], point[..., 1]
    return np.stack([pose[..., 0] + cos * x - sin * y, pose[..., 1] + sin * x + cos * y], axis=-1)


def body_zero_moment_point(motion: MotionLike) -> Array:
    """Return the zero-moment point in the body frame, x forward and y left, shape (..., 2) [m].

    Parameters
    ----------
    motion : Rollout or MotionStates
        As in `zero_moment_point`.

    Returns
    -------
    ndarray, shape (..., 2)
        x and y in the body frame [m]; NaN if the ground does not carry the robot.

    Raises
    ------
    InvalidArgument
        As in `zero_moment_point`.

    See Also
    --------
    balance.zero_moment_point : the same point in the inertial frame
    balance.tip_over_margin : distance of this point to the edge of the footprint

    Examples
    --------
    >>> from math import pi
    >>> from pinmobile import MobileRobot, balance
    >>> tall = MobileRobot.box(mass=30.0, size=(0.6, 0.4, 1.0))
    >>> left = balance.MotionStates(
    ...     tall, [5, 0, pi / 2], [0, 0, 0], [0, 4, 0]
    ... )
    >>> print(balance.body_zero_moment_point(left)[0])  # forward [m]
    -0.204
    """
    if not getattr(_robot_of(motion), "grounded", True):
        raise InvalidArgument(
            "motion.plant has an unknown height above the ground, expected a known one: "
            "MobileRobot.from_urdf(path, ground=...), with the ground's z in the root link's frame [m]"
        )
    point: Array = zero_moment_point_of(*_ground(motion))
    return point


def tip_over_margin(motion: MotionLike, footprint: ArrayLike | None = None) -> Array:
    """Return the distance of the zero-moment point inside the edge of the footprint, shape (...) [m].

    If the margin is negative, the base tips over: only a pulling force at the far edge could prevent this.

    Parameters
    ----------
    motion : Rollout or MotionStates
        As in `zero_moment_point`.
    footprint : array_like, shape (k, 2), optional
        Corners of the convex support polygon in the body frame [m]; by default, the robot's footprint.

    Returns
    -------
    ndarray, shape (...)
        Distance from the edge [m], negative outside; -inf if the ground does not carry the robot.

    Raises
    ------
    InvalidArgument
        If `footprint` is not a convex polygon with an area; if the argument is missing and the robot's
        footprint is not known; or as in `zero_moment_point`.

    See Also
    --------
    balance.zero_moment_point : point of the ground reaction
    balance.max_slope : steepest slope on which a robot stands
    balance.contact_loads : load of each wheel

    Examples
    --------
    >>> from pinmobile import MobileRobot, balance
    >>> tall = MobileRobot.box(mass=30.0, size=(0.6, 0.4, 1.0))
    >>> a = [[2, 0, 0], [4, 0, 0], [6, 0, 0]]  # [m/s^2]
    >>> states = balance.MotionStates(tall, [0, 0, 0], [0, 0, 0], a)
    >>> balance.tip_over_margin(states).round(3)  # [m]
    array([ 0.198,  0.096, -0.006])
    """
    corners = footprint_of(_robot_of(motion), footprint)
    margin = margin_inside(corners, body_zero_moment_point(motion))
    return np.where(np.isnan(margin), -np.inf, margin)


def contact_loads(motion: MotionLike) -> ContactLoads:
    """Return the load of each wheel and support, and whether the robot begins to tip over.

    The loads balance the wrench of the ground, including the dynamics of arms and wheels. This balance
    determines three loads. More contacts share the load like equal springs. A contact that would pull has
    lifted off.

    Parameters
    ----------
    motion : Rollout or MotionStates
        Robot, q, v and a. The ground reaction includes external forces.

    Returns
    -------
    plant.ContactLoads
        Names of the contacts, loads [N] and whether the robot tips over.

    Raises
    ------
    InvalidArgument
        If the plant has no ``contact_loads``, or its contacts or height are not known.

    See Also
    --------
    balance.slip_margins : friction left at each wheel
    balance.tip_over_margin : distance to the edge of the footprint

    Examples
    --------
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable, balance
    >>> wheels = WheelTable.differential(
    ...     0.4, 0.1, supports=[(0.2, 0), (-0.2, 0)]
    ... )
    >>> car = WheeledRobot(MobileRobot.box(mass=30.0), wheels)
    >>> rest = balance.MotionStates(
    ...     car, [0] * car.nq, [0] * car.nv, [0] * car.nv
    ... )
    >>> balance.contact_loads(rest).values  # [N]
    array([73.575, 73.575, 73.575, 73.575])
    """
    method = _method("motion.plant", _robot_of(motion), "contact_loads", "the loads of wheels")
    return method(motion.q, motion.v, motion.a)  # type: ignore[no-any-return]


def slip_margins(motion: MotionLike) -> SlipMargins:
    """Return the friction left at each wheel before slip, ``mu N - hypot(along, across)`` [N].

    If rolling does not determine the lateral force of each wheel on an axle, the margin belongs to the axle
    and has the names of its wheels. It then assumes the best distribution of the lateral force.

    Parameters
    ----------
    motion : Rollout or MotionStates
        Robot, q, v, a and u. For wheels that may slip, the forces are signals of a `Rollout`.

    Returns
    -------
    plant.SlipMargins
        Names, margins [N] and forces along and across [N].

    Raises
    ------
    InvalidArgument
        If the plant has no ``slip_margins``, its contacts or height are not known, or the motion lacks the
        wheel forces.

    See Also
    --------
    balance.contact_loads : load of each wheel
    balance.required_friction : friction coefficient that a motion needs

    Examples
    --------
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable, balance
    >>> wheels = WheelTable.differential(
    ...     0.4, 0.1, supports=[(0.2, 0), (-0.2, 0)]
    ... )
    >>> car = WheeledRobot(MobileRobot.box(mass=30.0), wheels)
    >>> still = [0] * car.nv
    >>> rest = balance.MotionStates(
    ...     car, [0] * car.nq, still, still, u=[0, 0]
    ... )
    >>> margins = balance.slip_margins(rest)
    >>> margins.names, margins.values  # [N]
    (('left + right',), array([58.86]))
    """
    words = "slip margins of wheels"
    return _method("motion.plant", _robot_of(motion), "slip_margins", words)(motion)  # type: ignore[no-any-return]


def _method(argument: str, plant: Any, name: str, words: str) -> Any:
    method = getattr(plant, name, None)
    if isinstance(plant, type) or not callable(method):
        expected = f"a WheeledRobot, or a plant with {name}"
        if hasattr(plant, "wheeled"):
            expected = f"torques as inputs: simulate {argument}.wheeled, without TorqueToVoltage"
        raise InvalidArgument(
            f"{argument} is {format_value(plant)}, which does not compute {words}, expected {expected}"
        )
    return method


class MotionLimit(NamedTuple):
    """Limit of a motion, and the event that occurs beyond this limit.

    Attributes
    ----------
    value : float
        Largest speed along the path [m/s], or largest angle of the slope [rad]; infinite if there is no
        limit.
    event : str
        Event beyond the limit, such as ``"left + right slip"`` or ``"support 1 lifts"``; empty if there is
        none.
    time : float
        Time of the event in the original trajectory [s]; 0 for slopes.
    factor : float
        Largest speed as a multiple of the original speed; 1 for slopes.

    See Also
    --------
    balance.max_path_speed : largest speed along a trajectory
    balance.max_slope : steepest slope on which a robot stands

    Examples
    --------
    >>> from math import degrees
    >>> from pinmobile.balance import MotionLimit
    >>> limit = MotionLimit(0.38, "left + right slip")
    >>> print(f"{degrees(limit.value):.0f} degrees: {limit.event}")
    22 degrees: left + right slip
    """

    value: float
    event: str
    time: float = 0.0
    factor: float = 1.0


def max_path_speed(plant: Any, trajectory: Any, samples: int = 400) -> MotionLimit:
    """Return the largest speed on a trajectory before wheels slip, lift off or lack torque.

    The function scales time uniformly: velocities grow with the factor and accelerations with its square.
    Wheels roll, driven by minimum-norm torques. An electric motor has less torque at higher speed.

    Parameters
    ----------
    plant : WheeledRobot or plant
        Robot with the method ``follows(t, reference)``.
    trajectory : Trajectory
        Trajectory to follow, such as ``Tangent(path)``.
    samples : int
        Number of samples, evenly spaced over the trajectory.

    Returns
    -------
    MotionLimit
        Largest speed [m/s], the event beyond this speed, and its time [s].

    Raises
    ------
    InvalidArgument
        If an argument has another type, the wheels cannot follow the trajectory, or a wheel slips or lifts
        off at rest.

    See Also
    --------
    balance.max_slope : steepest slope on which a robot stands
    balance.slip_margins : friction left at each wheel

    Examples
    --------
    >>> from pinmobile import (
    ...     Circle, MobileRobot, Tangent, WheeledRobot, WheelTable,
    ... )
    >>> from pinmobile.balance import max_path_speed
    >>> wheels = WheelTable.differential(
    ...     0.4, 0.1, supports=[(0.2, 0), (-0.2, 0)]
    ... )
    >>> car = WheeledRobot(MobileRobot.box(), wheels)
    >>> limit = max_path_speed(
    ...     car, Tangent(Circle(1.0, 0.5, 4.0)), samples=20
    ... )
    >>> limit.value, limit.event  # [m/s]
    (1.98, 'left + right slip')
    """
    follows = _method("plant", plant, "follows", "the loads along a trajectory")
    require("trajectory", trajectory, Following)
    duration = positive("trajectory.duration", trajectory.duration, "s")
    t = np.linspace(0.0, duration, check_integer("samples", samples, least=4))
    refuse_path("trajectory", trajectory)
    reference = require("what trajectory(t) returned", trajectory(t), Desired)
    motion = follows(t, reference)
    speed = float(np.hypot(*np.moveaxis(reference.v[..., :2], -1, 0)).max())
    if _smallest_margin(motion, 0.0)[0] < 0:
        raise InvalidArgument(
            f"plant does not stand at rest: {_smallest_margin(motion, 0.0)[1]}, expected one that does"
        )
    low, high = 0.0, 1.0
    while _smallest_margin(motion, high)[0] >= 0:
        low, high = high, 2.0 * high
        if high > _MAX_FACTOR:
            return MotionLimit(np.inf, "", 0.0, np.inf)
    low, high = bisect(low, high, lambda factor: _smallest_margin(motion, factor)[0] >= 0)
    _, event, sample = _smallest_margin(motion, high)
    return MotionLimit(low * speed, event, float(t[sample]), low)


def max_slope(plant: Any, direction: float = 0.0) -> MotionLimit:
    """Return the steepest slope on which a robot with driven wheels neither slips, tips nor rolls away.

    Parameters
    ----------
    plant : WheeledRobot or plant
        Robot with the methods ``on_ramp(angle, direction)`` and ``follows(t, reference)``.
    direction : float
        Direction uphill, as an angle from the body's x axis [rad].

    Returns
    -------
    MotionLimit
        Largest angle of the slope [rad] and the event beyond this angle.

    Raises
    ------
    InvalidArgument
        If an argument has another type, or nothing holds the wheels on a slope of any angle.

    See Also
    --------
    wheels.Ramp : sloped ground for a simulation
    balance.max_path_speed : largest speed along a trajectory

    Examples
    --------
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> from pinmobile.balance import max_slope
    >>> wheels = WheelTable.differential(
    ...     0.4, 0.1, supports=[(0.2, 0), (-0.2, 0)]
    ... )
    >>> limit = max_slope(WheeledRobot(MobileRobot.box(), wheels))
    >>> limit.value, limit.event  # [rad]
    (0.3805, 'left + right slip')
    """
    on_ramp = _method("plant", plant, "on_ramp", "its loads on a slope")
    direction = scalar("direction", direction)
    reference = Reference(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)))

    def worst(angle: float) -> tuple[float, str, int]:
        return _smallest_margin(on_ramp(angle, direction).follows(np.zeros(1), reference), 0.0)

    margin, event, _ = worst(0.0)
    if margin < 0:
        raise InvalidArgument(f"plant does not stand on level ground: {event}, expected one that does")
    low, high = bisect(0.0, _MAX_ANGLE, lambda angle: worst(angle)[0] >= 0)
    return MotionLimit(low, worst(high)[1])


def _smallest_margin(motion: Any, factor: float) -> tuple[float, str, int]:
    """Return the smallest margin or load of a motion, the event that it predicts, and its sample."""
    words = "ContactLoads, SlipMargins and TorqueMargins"
    loads, margins, torques = instance("what the plant follows", motion.at(factor), tuple, words)
    candidates = []
    for values, names, verb in (
        (loads.springs, loads.names, "lifts"),
        (margins.values, margins.names, "slips"),
        (torques.values, torques.names, "lacks torque"),
    ):
        sample, k = np.unravel_index(int(np.argmin(values)), values.shape)
        plural = verb.removesuffix("s") if " + " in names[k] else verb
        candidates.append((float(values[sample, k]), f"{names[k]} {plural}", int(sample)))
    return min(candidates)


def footprint_of(robot: Any, footprint: ArrayLike | None = None) -> Array:
    """Return the corners of a robot's support polygon, counter-clockwise, shape (k, 2) [m].

    Parameters
    ----------
    robot : MobileRobot or plant
        Robot.
    footprint : array_like, shape (k, 2), optional
        Corners in the body frame [m]; by default, those of the robot.

    Returns
    -------
    ndarray, shape (k, 2)
        Corners in the body frame [m].

    Raises
    ------
    InvalidArgument
        If `footprint` is not a convex polygon with an area, or the argument is missing and the robot's
        footprint is not known.

    See Also
    --------
    balance.tip_over_margin : distance of the zero-moment point to the edge
    MobileRobot.footprint : support polygon of a robot

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.balance import footprint_of
    >>> corners = footprint_of(MobileRobot.box(size=(0.6, 0.4, 0.2)))
    >>> corners.max(axis=0) - corners.min(axis=0)  # [m]
    array([0.6, 0.4])
    """
    if footprint is not None:
        return check_footprint(footprint)
    corners: Array | None = getattr(require("robot", robot, Grounded), "footprint", None)
    expected = "the corners of the support polygon, shape (k, 2) [m]; robot.source says what the file lacks"
    return check_footprint(required("footprint is not given, and that of the robot", corners, expected))


def required_friction(motion: MotionLike) -> Array:
    """Return the required friction coefficient, the ratio of horizontal and vertical force, shape (...).

    The condition is necessary. It is sufficient only if each contact has friction in all directions and the
    moment about the vertical axis, which also needs friction, is small. A robot on wheels needs more, because
    casters and free wheels neither drive nor brake: `slip_margins` has the friction left at each wheel.

    Parameters
    ----------
    motion : Rollout or MotionStates
        As in `zero_moment_point`.

    Returns
    -------
    ndarray, shape (...)
        Friction coefficient, at least zero. If the ground does not carry the robot, it is inf, or NaN if the
        force is zero.

    Raises
    ------
    InvalidArgument
        As in `zero_moment_point`.

    See Also
    --------
    balance.slip_margins : friction left at each wheel
    balance.zero_moment_point : point of the ground reaction

    Examples
    --------
    >>> from pinmobile import MobileRobot, balance
    >>> states = balance.MotionStates(
    ...     MobileRobot.box(), [0, 0, 0], [0, 0, 0], [3, 4, 0]
    ... )
    >>> balance.required_friction(states), 5 / 9.81
    (array(0.5097), 0.5097)
    """
    wrench, is_loaded = _ground(motion)
    horizontal = np.hypot(wrench[..., 0], wrench[..., 1])
    is_weightless = np.linalg.norm(wrench[..., :3], axis=-1) <= _negligible(motion)
    default = np.where(is_weightless, np.nan, np.inf)
    return np.where(is_loaded, horizontal / np.where(is_loaded, wrench[..., 2], 1.0), default)


def _ground(motion: MotionLike) -> tuple[Array, NDArray[np.bool_]]:
    """Return the ground's wrench, shape (..., 6), and whether the ground carries the robot, shape (...)."""
    robot = _robot_of(motion)
    wrench = finite("ground_wrench of motion.plant", robot.ground_wrench(motion.q, motion.v, motion.a))
    expected = (*np.broadcast_shapes(*(np.shape(x)[:-1] for x in (motion.q, motion.v, motion.a))), 6)
    words = " for all samples at once: write it with [..., i] and axis=-1"
    shaped("ground_wrench of motion.plant", wrench, expected, words=words)
    return wrench, wrench[..., 2] > _negligible(motion)


def _negligible(motion: MotionLike) -> float:
    plant, q = robot_at(motion.plant, 0.0), np.asarray(motion.q, np.float64)
    if not q.size:
        return 0.0
    zeros = np.zeros(plant.nv)
    weight = plant.ground_wrench(q.reshape(-1, q.shape[-1])[0], zeros, zeros)[..., :3]
    return WEIGHTLESS * float(np.linalg.norm(weight))
