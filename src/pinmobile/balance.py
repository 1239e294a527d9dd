"""What the base feels: the arm's reaction, where the ground carries it, and what friction that takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import (
    Array,
    ArrayLike,
    broadcast,
    finite,
    frozen,
    instance,
    positive,
    scalar,
    shaped,
    vector,
    whole,
)
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import Desired, Following, Grounded, required
from pinmobile.plant import ContactLoads, SlipMargins, refuse_path
from pinmobile.robot import WEIGHTLESS, checked_footprint, margin_inside, pressed_at
from pinmobile.trajectories import Reference

_FASTEST = 1e6  # times as fast as the reference, beyond which nothing gives way
_HALVINGS = 40
_UPRIGHT = np.pi / 2 - 1e-9  # [rad]


class Moving(Protocol):
    """A Rollout or a MotionStates."""

    @property
    def plant(self) -> Any:
        """What moves: a `MobileRobot`, or a plant with ``ground_wrench(q, v, a) -> (..., 6)``."""

    @property
    def q(self) -> ArrayLike:
        """Configuration, shape (..., nq)."""

    @property
    def v(self) -> ArrayLike:
        """Velocity, shape (..., nv)."""

    @property
    def a(self) -> ArrayLike:
        """Acceleration, shape (..., nv)."""


@dataclass(frozen=True, eq=False)
class MotionStates:
    """States of a robot that no simulation recorded: one, or many along leading axes that broadcast.

    Parameters
    ----------
    plant : MobileRobot or plant
        What moves: it has ``ground_wrench(q, v, a)``, the wrench (fx, fy, fz, mx, my, mz) of the ground on
        the body along and about the body's frame, shape (..., 6) [N, N m], and may have ``footprint``, its
        corners, shape (k, 2) [m].
    q : array_like, shape (..., nq)
        Configuration [m, m, rad, ...].
    v, a : array_like, shape (..., nv)
        Velocity and acceleration [m/s, m/s, rad/s, ...; per s].
    u : array_like, shape (..., nu), optional
        Input, on which the forces of wheels depend.

    Raises
    ------
    InvalidArgument
        If `plant` has no ``ground_wrench``, or an array has another shape or is not finite.
    """

    plant: Any
    q: ArrayLike
    v: ArrayLike
    a: ArrayLike
    u: ArrayLike | None = None

    def __post_init__(self) -> None:
        robot = required("plant", self.plant, Grounded)
        for name, size in (("q", robot.nq), ("v", robot.nv), ("a", robot.nv)):
            object.__setattr__(self, name, frozen(vector(name, getattr(self, name), size)))
        if self.u is not None:
            object.__setattr__(self, "u", frozen(vector("u", self.u, robot.nu)))
        given = {name: getattr(self, name) for name in "qvau" if getattr(self, name) is not None}
        broadcast(**given)


def _robot_of(motion: Any) -> Any:
    required("motion", motion, Moving)
    return required("motion.plant", motion.plant, Grounded)


def reaction_wrench(motion: Moving, mount: str | None = None) -> Array:
    """Return the force and moment that an arm, with the loads on it, exerts on the base at its mount.

    Its weight less the rate of its momentum, by Newton and Euler (Luh, Walker and Paul, 1980), as Pinocchio's
    RNEA does it.

    Parameters
    ----------
    motion : Rollout or MotionStates
        Robot, q, v and a.
    mount : str, optional
        Name of one of ``robot.mounts``; by default that of the first.

    Returns
    -------
    wrench : ndarray, shape (..., 6)
        (fx, fy, fz, mx, my, mz) [N, N, N, N m, N m, N m] along the axes of the body's frame B, x forward, y
        left, z up, whatever the mount's yaw; the moment is about the point of the mount. An arm at rest
        exerts its weight, (0, 0, -m g), and about the mount the moment (-m g y, m g x, 0) of its centre of
        mass at x and y from there.

    Raises
    ------
    InvalidArgument
        If the motion is not that of a `MobileRobot` with an arm.
    UnknownName
        If nothing is mounted by that name.
    """
    answer = _method("motion.plant", _robot_of(motion), "mount_wrench", "what an arm exerts on it")
    return answer(motion.q, motion.v, motion.a, mount)  # type: ignore[no-any-return]


def zero_moment_point(motion: Moving) -> Array:
    """Return the point on the ground about which its reaction has no horizontal moment, shape (..., 2) [m].

    With the ground's force f and its moment m about the origin of the body's frame B, which lies on the
    ground, it is (-m_y / f_z, m_x / f_z) from there along B's axes (Vukobratovic and Borovac, "Zero-moment
    point - thirty five years of its life", 2004). A robot at rest has it below its centre of mass; a body
    whose centre of mass is at height h and accelerates with a has it h a / g behind.

    Parameters
    ----------
    motion : Rollout or MotionStates
        Robot, q, v and a. Forces that do not come from the ground, such as a push, count as if they did.

    Returns
    -------
    point : ndarray, shape (..., 2)
        x and y in the inertial frame [m]; NaN where the ground does not carry the robot.

    Raises
    ------
    InvalidArgument
        If the plant has no ``ground_wrench``, or the motion does not fit it; or if it is not known how high
        the robot is above the ground, since its URDF does not tell.
    """
    point = body_zero_moment_point(motion)
    pose = _robot_of(motion).pose(motion.q)
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, y = point[..., 0], point[..., 1]
    return np.stack([pose[..., 0] + cos * x - sin * y, pose[..., 1] + sin * x + cos * y], axis=-1)


def body_zero_moment_point(motion: Moving) -> Array:
    """Return the zero-moment point in the body's frame, x forward and y left, shape (..., 2) [m].

    Parameters
    ----------
    motion : Rollout or MotionStates
        As in `zero_moment_point`.

    Raises
    ------
    InvalidArgument
        As `zero_moment_point`.
    """
    if not getattr(_robot_of(motion), "grounded", True):
        raise InvalidArgument(
            "motion.plant does not tell how high it is above the ground, expected one that does: "
            "MobileRobot.from_urdf(path, ground=...), with the ground's z in the root link's frame [m]"
        )
    found: Array = pressed_at(*_ground(motion))
    return found


def tip_over_margin(motion: Moving, footprint: ArrayLike | None = None) -> Array:
    """Return how far the zero-moment point lies inside the footprint's edge, shape (...) [m].

    Where it is negative, the ground would have to pull at the far edge: a base that is not held down tips.

    Parameters
    ----------
    motion : Rollout or MotionStates
        As in `zero_moment_point`.
    footprint : array_like, shape (k, 2), optional
        Corners of the convex polygon on which the body stands, in its frame [m]; by default the robot's own.

    Returns
    -------
    margin : ndarray, shape (...)
        Distance from the edge [m], negative outside; -inf where the ground does not carry the robot.

    Raises
    ------
    InvalidArgument
        If `footprint` is no convex polygon with an area, or is not given and the robot's own is not known; or
        as `zero_moment_point`.
    """
    corners = footprint_of(_robot_of(motion), footprint)
    margin = margin_inside(corners, body_zero_moment_point(motion))
    return np.where(np.isnan(margin), -np.inf, margin)


def contact_loads(motion: Moving) -> ContactLoads:
    """Return what each wheel and support carries: names, loads, and where the robot begins to tip over.

    They balance the ground's wrench, arms and spinning wheels included. Three are found by that; more share
    as equal springs do, and what would pull has lifted off.

    Parameters
    ----------
    motion : Rollout or MotionStates
        Robot, q, v and a. Forces that do not come from the ground count as if they did.

    Raises
    ------
    InvalidArgument
        If the plant has no ``contact_loads``, or it is not known where it stands.
    """
    answer = _method("motion.plant", _robot_of(motion), "contact_loads", "what its wheels carry")
    return answer(motion.q, motion.v, motion.a)  # type: ignore[no-any-return]


def slip_margins(motion: Moving) -> SlipMargins:
    """Return the friction that is left at each wheel before it slips, ``mu N - hypot(along, across)`` [N].

    Where rolling does not determine how wheels share the force across their axle, it is the axle's margin,
    under the names of its wheels: that of the best split.

    Parameters
    ----------
    motion : Rollout or MotionStates
        Robot, q, v, a and u; wheels that may slip have their forces in the signals of a `Rollout`.

    Raises
    ------
    InvalidArgument
        If the plant has no ``slip_margins``, it is not known where it stands, or the motion does not tell the
        forces.
    """
    words = "how far its wheels are from slipping"
    return _method("motion.plant", _robot_of(motion), "slip_margins", words)(motion)  # type: ignore[no-any-return]


def _method(argument: str, plant: Any, name: str, words: str) -> Any:
    found = getattr(plant, name, None)
    if isinstance(plant, type) or not callable(found):
        raise InvalidArgument(
            f"{argument} is {shown(plant)}, which does not tell {words}, expected a WheeledRobot, or a plant "
            f"with {name}"
        )
    return found


class MotionLimit(NamedTuple):
    """Where something gives way first.

    Attributes
    ----------
    value : float
        The largest speed along the path [m/s], or the steepest angle of the ground [rad]; infinite where
        nothing gives way.
    what : str
        What gives way beyond, such as ``"left + right slip"`` or ``"support 1 lifts"``; else "".
    time : float
        When along the reference, at its own pace [s]; 0 of ramps.
    factor : float
        How many times as fast as the reference goes; 1 of ramps.
    """

    value: float
    what: str
    time: float = 0.0
    factor: float = 1.0


def max_path_speed(plant: Any, trajectory: Any, samples: int = 400) -> MotionLimit:
    """Return how fast a robot can follow a trajectory before wheels slip, lift off or lack torque.

    The whole trajectory is taken faster or slower: the same places at times that are all shortened alike,
    so that velocities grow with the factor and accelerations with its square. Wheels roll, driven by torques
    of least norm; an electric motor has less torque the faster it turns.

    Parameters
    ----------
    plant : WheeledRobot or plant
        One with ``follows(t, reference)``.
    trajectory : Trajectory
        What it follows, such as ``Tangent(path)``.
    samples : int
        At how many times, evenly over the trajectory.

    Raises
    ------
    InvalidArgument
        If an argument is something else, the wheels cannot follow, or something slips or lifts at rest.
    """
    follows = _method("plant", plant, "follows", "what it takes to follow a trajectory")
    required("trajectory", trajectory, Following)
    duration = positive("trajectory.duration", trajectory.duration, "s")
    t = np.linspace(0.0, duration, whole("samples", samples, least=4))
    refuse_path("trajectory", trajectory)
    reference = required("what trajectory(t) returned", trajectory(t), Desired)
    going = follows(t, reference)
    speed = float(np.hypot(*np.moveaxis(reference.v[..., :2], -1, 0)).max())
    if _first(going, 0.0)[0] < 0:
        raise InvalidArgument(
            f"plant does not stand where it is at rest: {_first(going, 0.0)[1]}, expected one that does"
        )
    low, high = 0.0, 1.0
    while _first(going, high)[0] >= 0:
        low, high = high, 2.0 * high
        if high > _FASTEST:
            return MotionLimit(np.inf, "", 0.0, np.inf)
    low, high = _halved(low, high, lambda factor: _first(going, factor)[0] >= 0)
    _, what, at = _first(going, high)
    return MotionLimit(low * speed, what, float(t[at]), low)


def max_slope(plant: Any, direction: float = 0.0) -> MotionLimit:
    """Return the steepest ramp on which a robot stands, held by its motors, before it slips, tips or rolls.

    Parameters
    ----------
    plant : WheeledRobot or plant
        One with ``on_ramp(angle, direction)`` and ``follows(t, reference)``.
    direction : float
        Which way is up, from the body's x axis [rad].

    Raises
    ------
    InvalidArgument
        If an argument is something else, or the robot rolls away on any ramp, since nothing holds its wheels.
    """
    on_ramp = _method("plant", plant, "on_ramp", "what a ramp changes")
    direction = scalar("direction", direction)
    still = Reference(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)))

    def worst(angle: float) -> tuple[float, str, int]:
        return _first(on_ramp(angle, direction).follows(np.zeros(1), still), 0.0)

    margin, what, _ = worst(0.0)
    if margin < 0:
        raise InvalidArgument(f"plant does not stand on level ground: {what}, expected one that does")
    low, high = _halved(0.0, _UPRIGHT, lambda angle: worst(angle)[0] >= 0)
    return MotionLimit(low, worst(high)[1])


def _halved(low: float, high: float, stands: Callable[[float], bool]) -> tuple[float, float]:
    """Return a small interval at whose lower end a robot stands, and at whose upper end it does not."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stands(middle) else (low, middle)
    return low, high


def _first(going: Any, factor: float) -> tuple[float, str, int]:
    """Return the smallest margin or load of a motion, whose it is, and at which sample."""
    words = "ContactLoads, SlipMargins and TorqueMargins"
    loads, margins, torques = instance("what the plant follows", going.at(factor), tuple, words)
    found = []
    for values, names, verb in (
        (loads.springs, loads.names, "lifts"),
        (margins.values, margins.names, "slips"),
        (torques.values, torques.names, "lacks torque"),
    ):
        at, k = np.unravel_index(int(np.argmin(values)), values.shape)
        plural = verb.removesuffix("s") if " + " in names[k] else verb
        found.append((float(values[at, k]), f"{names[k]} {plural}", int(at)))
    return min(found)


def footprint_of(robot: Any, footprint: ArrayLike | None = None) -> Array:
    """Return the corners of what a robot stands on, counter-clockwise, shape (k, 2) [m].

    Parameters
    ----------
    robot : MobileRobot or plant
        Whose footprint it is.
    footprint : array_like, shape (k, 2), optional
        In place of its own.

    Raises
    ------
    InvalidArgument
        If `footprint` is no convex polygon with an area, or there is none.
    """
    if footprint is not None:
        return checked_footprint(footprint)
    corners: Array | None = getattr(required("robot", robot, Grounded), "footprint", None)
    if corners is None:
        raise InvalidArgument(
            "footprint is not given, and that of the robot is not known, expected the corners of what it "
            "stands on, shape (k, 2); robot.source says what its file lacks"
        )
    return checked_footprint(corners)


def required_friction(motion: Moving) -> Array:
    """Return the friction coefficient that the ground must offer, shape (...): horizontal by vertical force.

    Necessary, and sufficient where the moment about the vertical is small: that takes friction too.

    Parameters
    ----------
    motion : Rollout or MotionStates
        As in `zero_moment_point`.

    Returns
    -------
    coefficient : ndarray, shape (...)
        At least zero; inf where the ground does not carry the robot, since none would do, but NaN where there
        is no force at all.

    Raises
    ------
    InvalidArgument
        As `zero_moment_point`.
    """
    wrench, carried = _ground(motion)
    horizontal = np.hypot(wrench[..., 0], wrench[..., 1])
    nothing = np.linalg.norm(wrench[..., :3], axis=-1) <= _negligible(motion)
    lifted = np.where(nothing, np.nan, np.inf)
    return np.where(carried, horizontal / np.where(carried, wrench[..., 2], 1.0), lifted)


def _ground(motion: Moving) -> tuple[Array, NDArray[np.bool_]]:
    """Return the ground's wrench, shape (..., 6), and where it carries the robot, shape (...)."""
    robot = _robot_of(motion)
    wrench = finite("ground_wrench of motion.plant", robot.ground_wrench(motion.q, motion.v, motion.a))
    expected = (*np.broadcast_shapes(*(np.shape(x)[:-1] for x in (motion.q, motion.v, motion.a))), 6)
    words = " for all samples at once: write it with [..., i] and axis=-1"
    shaped("ground_wrench of motion.plant", wrench, expected, words=words)
    return wrench, wrench[..., 2] > _negligible(motion)


def _negligible(motion: Moving) -> float:
    plant, q = motion.plant, np.asarray(motion.q, np.float64)
    if not q.size:
        return 0.0
    still = np.zeros(plant.nv)
    weight = plant.ground_wrench(q.reshape(-1, q.shape[-1])[0], still, still)[..., :3]
    return WEIGHTLESS * float(np.linalg.norm(weight))
