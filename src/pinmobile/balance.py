"""What the base feels: the arm's reaction, where the ground carries it, and what friction that takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, broadcast, finite, frozen, vector
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot import WEIGHTLESS, checked_footprint, margin_inside, pressed_at


class Moving(Protocol):
    """What is asked how it feels: a `Rollout`, a `Motion`, or anything with these."""

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
class Motion:
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

    Raises
    ------
    InvalidArgument
        If `plant` has no ``ground_wrench``, or an array has another shape or is not finite.
    """

    plant: Any
    q: ArrayLike
    v: ArrayLike
    a: ArrayLike

    def __post_init__(self) -> None:
        robot = _checked_robot("plant", self.plant)
        for name, size in (("q", robot.nq), ("v", robot.nv), ("a", robot.nv)):
            object.__setattr__(self, name, frozen(vector(name, getattr(self, name), size)))
        broadcast(q=self.q, v=self.v, a=self.a)  # type: ignore[arg-type]


def _robot_of(motion: Any) -> Any:
    """Return the plant of a motion.

    Raises
    ------
    InvalidArgument
        If it is no motion, or its plant does not tell the ground's wrench.
    """
    if not all(hasattr(motion, name) for name in ("plant", "q", "v", "a")):
        raise InvalidArgument(f"motion is {shown(motion)}, expected a Rollout or a Motion")
    return _checked_robot("motion.plant", motion.plant)


def _checked_robot(name: str, robot: Any) -> Any:
    """Check that a plant tells the wrench of the ground, and return it.

    Raises
    ------
    InvalidArgument
        The message names the argument.
    """
    known = callable(getattr(robot, "ground_wrench", None)) and isinstance(getattr(robot, "nv", None), int)
    if isinstance(robot, type) or not known:
        raise InvalidArgument(
            f"{name} is {shown(robot)}, which does not tell the ground's wrench, expected a MobileRobot, or "
            "a plant with ground_wrench(q, v, a)"
        )
    return robot


def reaction_wrench(motion: Moving, mount: str | None = None) -> Array:
    """Return the force and moment that an arm, with the loads on it, exerts on the base at its mount.

    Its weight less the rate of its momentum, by Newton and Euler (Luh, Walker and Paul, 1980), as Pinocchio's
    RNEA does it.

    Parameters
    ----------
    motion : Rollout or Motion
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
    plant = _robot_of(motion)
    if not hasattr(plant, "mount_wrench"):
        raise InvalidArgument(
            f"motion.plant is {shown(plant)}, which has no arm, expected a MobileRobot with one"
        )
    return plant.mount_wrench(motion.q, motion.v, motion.a, mount)  # type: ignore[no-any-return]


def zero_moment_point(motion: Moving) -> Array:
    """Return the point on the ground about which its reaction has no horizontal moment, shape (..., 2) [m].

    With the ground's force f and its moment m about the origin of the body's frame B, which lies on the
    ground, it is (-m_y / f_z, m_x / f_z) from there along B's axes (Vukobratovic and Borovac, "Zero-moment
    point - thirty five years of its life", 2004). A robot at rest has it below its centre of mass; a body
    whose centre of mass is at height h and accelerates with a has it h a / g behind.

    Parameters
    ----------
    motion : Rollout or Motion
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
    motion : Rollout or Motion
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
    motion : Rollout or Motion
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
    corners: Array | None = getattr(_checked_robot("robot", robot), "footprint", None)
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
    motion : Rollout or Motion
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
    if wrench.shape != expected:
        raise InvalidArgument(
            f"ground_wrench of motion.plant has shape {wrench.shape} for all samples at once, expected "
            f"{expected}: write it with [..., i] and axis=-1"
        )
    return wrench, wrench[..., 2] > _negligible(motion)


def _negligible(motion: Moving) -> float:
    plant, q = motion.plant, np.asarray(motion.q, np.float64)
    if not q.size:
        return 0.0
    still = np.zeros(plant.nv)
    weight = plant.ground_wrench(q.reshape(-1, q.shape[-1])[0], still, still)[..., :3]
    return WEIGHTLESS * float(np.linalg.norm(weight))
