"""Limits of joints as bounds of the next velocity, and least squares within bounds."""

from dataclasses import dataclass, field

import numpy as np

from pinmobile.arrays import Array, ArrayLike, endless_or_finite, finite, frozen
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot import BODY_JOINT, MobileRobot

__all__ = ["Limits", "bounded_least_squares", "per_coordinate"]


_ROUNDING = 1e-9  # of the largest acceleration; that of forward after inverse dynamics is less


@dataclass(frozen=True, eq=False)
class Limits:
    """What a robot's coordinates may do; those of its joints' positions are the robot's own.

    Parameters
    ----------
    robot : MobileRobot
        Its joints have one velocity each.
    velocity : ndarray, shape (nv,)
        Largest |v| [m/s, m/s, rad/s, ...], >= 0; inf where there is no limit.
    acceleration : ndarray, shape (nv,)
        Largest |a| [m/s^2, m/s^2, rad/s^2, ...], > 0 and finite.

    Raises
    ------
    InvalidArgument
        If a joint has more than one velocity.
    """

    robot: MobileRobot
    velocity: Array
    acceleration: Array
    _columns: tuple[Array, Array] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        model = self.robot.model
        joints = range(BODY_JOINT + 1, model.njoints)
        for joint in joints:
            if model.nvs[joint] != 1:
                raise InvalidArgument(
                    f"robot has the joint {model.names[joint]!r} of {model.nvs[joint]} velocities, "
                    "expected joints of one"
                )
        # An angle that is (cos, sin) in q has no limit.
        plain = [joint for joint in joints if model.nqs[joint] == 1]
        columns = ([ids[joint] for joint in plain] for ids in (model.idx_qs, model.idx_vs))
        object.__setattr__(self, "_columns", tuple(np.array(ids, dtype=np.intp) for ids in columns))

    def room(self, q: Array) -> Array:
        """Return how far each coordinate is from its lower and its upper limit, shape (2, nv), >= 0."""
        return np.maximum(self.signed_room(q), 0)

    def signed_room(self, q: Array) -> Array:
        """Return the same, shape (2, nv), below zero where a coordinate is beyond its limit."""
        in_q, in_v = self._columns
        room = np.full((2, self.robot.nv), np.inf)
        room[0, in_v] = q[in_q] - self.robot.lower[in_q]
        room[1, in_v] = self.robot.upper[in_q] - q[in_q]
        return room

    def ramps(self, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
        """Return the least and the largest acceleration to hold over the next `dt`, each of shape (nv,).

        As `velocities`, for one that changes evenly, to v' at its end: (v + v') dt / 2 + v'^2 / (2 a) <= d.
        Beyond a limit a coordinate brakes as hard as its acceleration allows.

        Parameters
        ----------
        q, v : ndarray, shape (nq,) and (nv,)
            State.
        dt : float
            Time step [s].
        """
        a = self.acceleration
        root = (a * dt) ** 2 + 8 * a * self.room(q) - 4 * a * dt * np.stack([-v, v])
        stop = np.where(root >= 0, (np.sqrt(np.maximum(root, 0)) - a * dt) / 2, -np.inf)
        most = np.clip((np.minimum(stop[1], self.velocity) - v) / dt, -a, a)
        least = np.clip((-np.minimum(stop[0], self.velocity) - v) / dt, -a, a)
        return np.minimum(least, most), most

    def excess(self, q: Array, v: Array, dt: float) -> Array:
        """Return by how much an acceleration held over `dt` was too low and too high, shape (2, nv), >= 0.

        So much less of it, and each coordinate would be within its limits afterwards and could stop there.
        What is rounding counts as nothing.

        Parameters
        ----------
        q, v : ndarray, shape (nq,) and (nv,)
            State that it led to.
        dt : float
            How long it was held [s].
        """
        room = self.signed_room(q)
        most = np.minimum(np.sqrt(2 * self.acceleration * np.maximum(room, 0)), self.velocity)
        excess = np.maximum((np.stack([-v, v]) - most) / dt, -2 * room / dt**2)
        return np.where(excess > _ROUNDING * self.acceleration, excess, 0)

    def velocities(self, q: Array, dt: float, before: Array | None = None) -> tuple[Array, Array]:
        """Return the least and the largest velocity over the next `dt`, each of shape (nv,).

        After it, a joint can still stop at its limit: with the room d and the acceleration a,
        v dt + v^2 / (2 a) <= d (after Flacco, De Luca and Khatib, "Motion control of redundant robots under
        joint constraints", 2012). Where the limits of position and of acceleration exclude one another, as
        for a state that is already outside, that of position goes first.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Configuration.
        dt : float
            Time step [s].
        before : ndarray, shape (nv,), optional
            Velocity before it; by default any.
        """
        a = self.acceleration
        brake = a * (np.sqrt(dt**2 + 2 * self.room(q) / a) - dt)
        least, most = -np.minimum(brake[0], self.velocity), np.minimum(brake[1], self.velocity)
        if before is None:
            return least, most
        return np.clip(before - a * dt, least, most), np.clip(before + a * dt, least, most)


def bounded_least_squares(A: Array, b: Array, least: Array, most: Array) -> Array:
    """Return the x of least |A x - b| with least <= x <= most, shape (n,).

    Parameters
    ----------
    A : ndarray, shape (m, n)
        Of rank n.
    b : ndarray, shape (m,)
        Right-hand side.
    least, most : ndarray, shape (n,)
        Bounds, least <= most; infinite where there is none.
    """
    x: Array = np.asarray(np.linalg.lstsq(A, b)[0], dtype=np.float64)
    if ((x >= least) & (x <= most)).all():
        return x
    # Here, because scipy is heavy and most steps do not need it.
    from scipy.optimize import lsq_linear

    free = least < most
    x = np.where(free, 0.0, least)
    if free.any():
        bounds = least[free], most[free]
        x[free] = lsq_linear(A[:, free], b - A[:, ~free] @ x[~free], bounds, method="bvls").x
    return np.asarray(np.clip(x, least, most), dtype=np.float64)


def per_coordinate(name: str, value: ArrayLike, size: int, *, zero: bool = False) -> Array:
    """Return one number above zero for each coordinate, shape (size,); from a scalar, the same for all.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, shape () or (size,)
        The argument.
    size : int
        Number of coordinates.
    zero : bool
        Whether it may be zero or infinite too.

    Raises
    ------
    InvalidArgument
        If it has another shape or a number is out of range.
    """
    given = endless_or_finite(name, value) if zero else finite(name, value)
    if given.shape not in ((), (size,)):
        raise InvalidArgument(f"{name} has shape {given.shape}, expected () or ({size},)")
    if not (given >= 0 if zero else given > 0).all():
        raise InvalidArgument(f"{name} is {shown(value)}, expected numbers {'>=' if zero else '>'} 0")
    return frozen(np.broadcast_to(given, (size,)))
