"""A robot and how it moves, and what its arm then exerts on its base."""

from dataclasses import dataclass
from typing import Any, Protocol

from pinmobile.arrays import Array, ArrayLike, broadcast, frozen, vector
from pinmobile.errors import InvalidArgument, shown

__all__ = ["Motion", "Moving", "checked_robot", "reaction_wrench", "robot_of"]


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
        robot = checked_robot("plant", self.plant)
        for name, size in (("q", robot.nq), ("v", robot.nv), ("a", robot.nv)):
            object.__setattr__(self, name, frozen(vector(name, getattr(self, name), size)))
        broadcast(q=self.q, v=self.v, a=self.a)  # type: ignore[arg-type]


def robot_of(motion: Any) -> Any:
    """Return the plant of a motion.

    Raises
    ------
    InvalidArgument
        If it is no motion, or its plant does not tell the ground's wrench.
    """
    if not all(hasattr(motion, name) for name in ("plant", "q", "v", "a")):
        raise InvalidArgument(f"motion is {shown(motion)}, expected a Rollout or a Motion")
    return checked_robot("motion.plant", motion.plant)


def checked_robot(name: str, robot: Any) -> Any:
    """Return the plant, after refusing one that does not tell the ground's wrench.

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
    plant = robot_of(motion)
    if not hasattr(plant, "mount_wrench"):
        raise InvalidArgument(
            f"motion.plant is {shown(plant)}, which has no arm, expected a MobileRobot with one"
        )
    return plant.mount_wrench(motion.q, motion.v, motion.a, mount)  # type: ignore[no-any-return]
