"""Configurations from poses, step by step, within the limits of the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, endless_or_finite, finite, frozen, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.reaching.poses import PosePath, error_sizes, pose_error
from pinmobile.robot import MobileRobot

_ROUNDING = 1e-9  # of the largest acceleration; that of forward after inverse dynamics is less


@dataclass(frozen=True, eq=False)
class Limits:
    """What a robot's coordinates may do; those of its joints' positions are the robot's own.

    Parameters
    ----------
    robot : MobileRobot
        Whose limits of position they are.
    velocity : ndarray, shape (nv,)
        Largest |v| [m/s, m/s, rad/s, ...], >= 0; inf where there is no limit.
    acceleration : ndarray, shape (nv,)
        Largest |a| [m/s^2, m/s^2, rad/s^2, ...], > 0 and finite.
    """

    robot: MobileRobot
    velocity: Array
    acceleration: Array

    def room(self, q: Array) -> Array:
        """Return how far each coordinate is from its lower and its upper limit, shape (2, nv), >= 0."""
        return np.maximum(self.signed_room(q), 0)

    def signed_room(self, q: Array) -> Array:
        """Return the same, shape (2, nv), below zero where a coordinate is beyond its limit."""
        return np.stack([q - self.robot.lower, self.robot.upper - q])

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
    shaped(name, given, (), (size,))
    bounded(name, given, least=0 if zero else None, above=None if zero else 0)
    return frozen(np.broadcast_to(given, (size,)))


_CATCH_UP = 10.0  # [1/s], the highest rate at which an error that limits left is made good
_EXACT = 1e-10  # [m, rad]
_CORRECTIONS = 4  # Gauss-Newton per step: each brings an error of 1e-4 below rounding or is held by a limit
_SEARCH = 200  # Gauss-Newton for the start
_STRIDE = 0.2  # largest step of it [m, rad]
_TRIES = 8  # postures from which the start is sought
_AS_GOOD = 1e-6  # relative; what Gauss-Newton leaves of an error that it cannot mend differs by less


@dataclass(frozen=True, eq=False)
class Solver:
    """Damped least squares within bounds, for one target.

    Parameters
    ----------
    robot : MobileRobot
        Whose coordinates are sought.
    target : PosePath
        What is followed.
    frame : str
        What follows it.
    limits : Limits
        Bounds.
    weights : ndarray, shape (nv, nv)
        Of displacements beside the error.
    """

    robot: MobileRobot
    target: PosePath
    frame: str
    limits: Limits
    weights: Array  # (nv, nv)

    def error(self, pose: Array, q: Array) -> Array:
        """Return how far the frame is from a pose, shape (rows,)."""
        return pose_error(pose, self.robot.frame_pose(q, self.frame))[: self.target.rows]

    def correction(self, q: Array, error: Array, wish: Array, least: Array, most: Array) -> Array:
        """Return the displacement within bounds that mends the error, near the one that is wished for.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Configuration.
        error : ndarray, shape (rows,)
            How far the frame is from its pose [m, rad].
        wish, least, most : ndarray, shape (nv,)
            Displacement that is wished for, and its bounds.
        """
        J = self.robot.frame_jacobian(q, self.frame)[: self.target.rows]
        A, b = np.vstack([J, self.weights]), np.concatenate([error, self.weights @ wish])
        return bounded_least_squares(A, b, least, most)

    def start(self, q0: ArrayLike | None) -> Array:
        """Return a configuration within limits at which the frame is at the target's start, or nearest.

        Parameters
        ----------
        q0 : array_like, shape (nq,), or None
            Where the search begins; None: `rest` and, where that fails, others.

        Raises
        ------
        InvalidArgument
            If `q0` has another shape, is not finite, or is outside the limits.
        """
        robot = self.robot
        first = robot.rest if q0 is None else checked_configuration(robot, "q0", q0)
        generator, best = np.random.default_rng(0), (np.inf, first)
        for attempt in range(_TRIES if q0 is None else 1):
            aside = generator.uniform(-1, 1, robot.nv) * (attempt > 0) * (np.arange(robot.nv) >= 3)
            q = self.sought(np.clip(robot.integrate(first, aside), robot.lower, robot.upper))
            size = float(error_sizes(self.error(self.target(0.0).pose, q)).max())
            if size < best[0] * (1 - _AS_GOOD):  # of some that are stuck alike, the first on every machine
                best = size, q
            if best[0] <= _EXACT:
                break
        return best[1]

    def sought(self, q: Array) -> Array:
        """Return what Gauss-Newton finds for the target's start from a configuration, both of shape (nq,)."""
        pose, still = self.target(0.0).pose, np.zeros(self.robot.nv)
        # x and y add to the pose as they are, however far; what is locked stays where it is.
        stride = np.where(np.arange(self.robot.nv) < 2, np.inf, _STRIDE)
        stride[self.limits.velocity == 0] = 0
        for _ in range(_SEARCH):
            error = self.error(pose, q)
            if error_sizes(error).max() <= _EXACT:
                break
            below, above = self.limits.room(q)
            least, most = np.maximum(-below, -stride), np.minimum(above, stride)
            q = self.robot.integrate(q, self.correction(q, error, still, least, most))
        return q

    def steps(self, start: Array, posture: Array, gain: float, count: int) -> Array:
        """Return the displacements of the control points from the start, shape (count + 3, nv).

        The first and the last are beyond the ends of the target.

        Parameters
        ----------
        start, posture : ndarray, shape (nq,)
            Where it begins, and what the arms tend to.
        gain : float
            Rate of that [1/s].
        count : int
            Steps.
        """
        robot, dt = self.robot, self.target.duration / count
        poses = self.target(np.linspace(0, self.target.duration, count + 1)).pose
        controls, q, v = np.zeros((count + 1, robot.nv)), start, None
        left = self.error(poses[0], q)
        for k in range(count):
            wish = dt * gain * robot.difference(q, posture)
            wish[:3] = 0
            least, most = (dt * bound for bound in self.limits.velocities(q, dt, v))
            kept = self.kept(left, dt)
            step, at = np.zeros(robot.nv), q
            for attempt in range(_CORRECTIONS):
                error = self.error(poses[k + 1], at) - kept
                if attempt and error_sizes(error).max() <= _EXACT:
                    break
                wanted = wish if attempt == 0 else np.zeros(robot.nv)
                step = np.clip(
                    step + self.correction(at, error, wanted, least - step, most - step), least, most
                )
                at = robot.integrate(q, step)
            controls[k + 1], q, v = controls[k] + step, at, step / dt
            left = self.error(poses[k + 1], q)
        ends = (self.beyond(three, start, dt)[None] for three in (controls[:3], controls[:-4:-1]))
        return np.concatenate([next(ends), controls, next(ends)])

    def kept(self, left: Array, dt: float) -> Array:
        """Return what of an error that limits left may remain after a step, shape (rows,).

        Faster, it could not be braked: approached with sqrt(a e), it takes half of the acceleration a.
        """
        size = float(np.linalg.norm(left))
        a = float(self.limits.acceleration.min())
        rate = min(_CATCH_UP, np.sqrt(a / size)) if size else _CATCH_UP
        return max(1 - rate * dt, 0.0) * left

    def beyond(self, nearest: Array, start: Array, dt: float) -> Array:
        """Return the control point beyond the end, shape (nv,), from the three next to it, shape (3, nv).

        With their acceleration where it keeps to the limits; else without any: then the curve ends at the
        outermost of the three, and stays between them.
        """
        line = 2 * nearest[0] - nearest[1]
        bent = line + nearest[0] - 2 * nearest[1] + nearest[2]
        below, above = self.limits.room(start)
        fits = (bent >= -below) & (bent <= above) & (np.abs(nearest[0] - bent) <= dt * self.limits.velocity)
        return np.asarray(np.where(fits, bent, line))


def checked_configuration(robot: MobileRobot, name: str, value: ArrayLike) -> Array:
    """Return one configuration within limits, shape (nq,).

    Raises
    ------
    InvalidArgument
        If it has another shape, is not finite, or is outside.
    """
    q = shaped(name, finite(name, value), (robot.nq,))
    outside = (q < robot.lower) | (q > robot.upper)
    if outside.any():
        k = int(np.argmax(outside))
        raise InvalidArgument(
            f"{name} has q[{k}] = {q[k]:.4g}, expected {robot.lower[k]:.4g} <= q[{k}] <= {robot.upper[k]:.4g}"
        )
    return q
