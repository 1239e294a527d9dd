"""Trajectories of base and arm that follow an end effector's pose, within the limits of joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, final, runtime_checkable
from warnings import warn

import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    bounded,
    endless_or_finite,
    finite,
    frozen,
    instance,
    non_negative,
    positive,
    positive_or_endless,
    shaped,
)
from pinmobile.errors import InvalidArgument, LimitWarning, PinmobileError, Unreachable
from pinmobile.integrators import Integrator, check_integrator, constant_acceleration
from pinmobile.parts import Constrained, able
from pinmobile.paths import within
from pinmobile.plant import Context, limits_exceeded
from pinmobile.proximity import Clearance, clearance as clearance_of
from pinmobile.reaching.poses import PosePath, error_sizes, pose_error
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Reference

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
_STEPS = 4  # Gauss-Newton per step: each brings an error of 1e-4 below rounding or is held by a limit
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
            for attempt in range(_STEPS):
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


_DEGREE = 3


@dataclass(frozen=True, eq=False, repr=False)
class InverseKinematicsTrajectory:
    """A trajectory of all coordinates, a uniform cubic B-spline of them; made by `solve_inverse_kinematics`.

    q is twice continuously differentiable, and v and a are its derivatives. q, v and a are averages of the
    control points, their first and their second differences (de Boor, "A practical guide to splines", 1978):
    bounds that those hold hold at all times, not at samples alone.

    Attributes
    ----------
    robot : MobileRobot
        Whose coordinates they are.
    target : PosePath
        What was to be followed.
    frame : str
        The frame that follows it.
    start : ndarray, shape (nq,)
        Configuration at the first control point.
    controls : ndarray, shape (N + 3, nv)
        Displacements of the control points from `start`, evenly over time, one beyond either end.
    """

    robot: MobileRobot
    target: PosePath
    frame: str
    start: Array
    controls: Array
    _curve: Callable[..., Array] = field(init=False)

    def __post_init__(self) -> None:
        # Here, because scipy is heavy and `EndEffectorTracking` does without it.
        from scipy.interpolate import BSpline

        for name in ("start", "controls"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        steps = np.arange(len(self.controls) + _DEGREE + 1.0) - _DEGREE
        knots = self.duration / (len(self.controls) - _DEGREE) * steps
        object.__setattr__(self, "_curve", BSpline(knots, self.controls, _DEGREE))

    def __repr__(self) -> str:
        metres, radians = self.max_error()
        turn = f", {radians:.3e} rad" if self.target.rows == 6 else ""
        try:
            near = f", smallest clearance {self.clearance.told}"
        except PinmobileError:  # without collision shapes it is not known
            near = ""
        over = f"{self.frame} over {self.duration:g} s"
        return f"<InverseKinematicsTrajectory: {over}, largest error {metres:.3e} m{turn}{near}>"

    @property
    def duration(self) -> float:
        """That of the target [s]."""
        return self.target.duration

    @property
    def t(self) -> Array:
        """Times of the control points between the ends, shape (N + 1,) [s]."""
        return np.linspace(0, self.duration, len(self.controls) - 2)

    def __call__(self, t: ArrayLike) -> Reference:
        """Return the reference.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reference : Reference
            q, shape (..., nq), v and a, shape (..., nv).

        Raises
        ------
        InvalidArgument
            If a time is outside.
        """
        times = within("t", t, self.duration)
        displacement, v, a = (self._curve(times, order) for order in range(3))
        # What rounding carries beyond a limit is cut off.
        q = np.clip(self.robot.integrate(self.start, displacement), self.robot.lower, self.robot.upper)
        return Reference(q, v, a)

    def signals_at(self, t: Array) -> dict[str, tuple[str, Array]]:
        """Return the target of its frame at the samples of a run, see `PosePath.told`."""
        return self.target.told(self.frame, t)

    @cached_property
    def error(self) -> Array:
        """From the pose to its target at the times `t`, shape (N + 1, 6) [m, rad], along the inertial axes.

        The last three are the rotation vector; NaN where the position alone is followed.
        """
        error = pose_error(self.target(self.t).pose, self.robot.frame_pose(self(self.t).q, self.frame))
        error[:, self.target.rows :] = np.nan
        return frozen(error)

    @cached_property
    def clearance(self) -> Clearance:
        """How far the robot's links are from one another and from the ground at the times `t`.

        Raises
        ------
        InvalidArgument
            If the robot has no collision shapes.
        """
        return clearance_of(self.robot, self(self.t).q)

    def max_error(self) -> tuple[float, float]:
        """Return the largest distance [m] and the largest angle [rad] from the target, as of `error`."""
        way, turn = error_sizes(self.error).max(axis=0)
        return float(way), float(turn)


_MOST_STEPS = 1_000_000  # hours


def solve_inverse_kinematics(
    robot: MobileRobot,
    target: PosePath,
    *,
    frame: str | None = None,
    q0: ArrayLike | None = None,
    posture: ArrayLike | None = None,
    dt: float = 0.01,
    posture_gain: float = 1.0,
    cost: ArrayLike = 1.0,
    velocity_limit: ArrayLike | None = None,
    acceleration_limit: ArrayLike = 10.0,
    damping: float = 1e-2,
    tolerance: float = 1e-2,
    clearance: float | None = None,
) -> InverseKinematicsTrajectory:
    """Return a trajectory of base and arm together on which a frame follows a path of poses.

    Step by step, damped least squares within bounds (Nakamura and Hanafusa, 1986): of the displacements that
    limits allow, that with the least error of the next pose, and of those nearly as good, that which is
    nearest to the way to the posture; corrected until the pose is met. At a singular posture and at a limit
    the error grows instead. The base goes in any direction. Track it by `ComputedTorque`.

    Parameters
    ----------
    robot : MobileRobot
        With or without arms; its joints have one velocity each.
    target : PosePath
        Pose, or position alone.
    frame : str, optional
        What follows it, one of ``robot.frame_names``; by default ``robot.end_effector``.
    q0 : array_like, shape (nq,), optional
        Where the search for the start begins; by default ``robot.rest`` and, where that fails, others.
    posture : array_like, shape (nq - 3,), optional
        To which the arms tend where the target leaves them free; by default as at the start.
    dt : float
        Time between control points [s]; their number is rounded up. The error is about a dt^2 / 6, with the
        acceleration a of the frame.
    posture_gain : float
        Rate of that [1/s], >= 0.
    cost : array_like, shape () or (nv,)
        Relative cost of each coordinate's motion, > 0: a high one keeps it still.
    velocity_limit : array_like, shape () or (nv,), optional
        Largest |v| [m/s, m/s, rad/s, ...]; by default the robot's; inf where there is none, zero locks.
    acceleration_limit : array_like, shape () or (nv,)
        Largest |a| [m/s^2, m/s^2, rad/s^2, ...] > 0, also when a joint brakes at its limit; it gives way to
        the limits of position and velocity.
    damping : float
        Weight of a displacement beside the error [m/rad], > 0.
    tolerance : float
        Largest distance and largest angle that are accepted, as of `InverseKinematicsTrajectory.max_error`
        [m, rad]; infinite: any, see `InverseKinematicsTrajectory.error`.
    clearance : float, optional
        Smallest distance between links, and from them to the ground, that is accepted, >= 0 [m],
        see `clearance`; by default any, even through the robot's own body, see
        `InverseKinematicsTrajectory.clearance`.

    Returns
    -------
    trajectory : InverseKinematicsTrajectory
        To be followed from its beginning. There, the frame's velocity is that of the target but for an error
        in proportion to dt^2.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, or a joint has more than one velocity.
    UnknownName
        If there is no such frame.
    Unreachable
        If an error is beyond the tolerance, or links come nearer than `clearance`; it carries the trajectory.

    Warns
    -----
    LimitWarning
        Once, if the trajectory takes more torque than the robot's ``effort_limit``.
    """
    instance("robot", robot, MobileRobot, "a MobileRobot")
    instance("target", target, PosePath, "a PosePath")
    room = None if clearance is None else non_negative("clearance", clearance, "m")
    if room is not None:
        _ = robot.solids  # refused before the work, not after it
    name = robot.frame_name(frame)
    speed = robot.velocity_limit if velocity_limit is None else velocity_limit
    limits = Limits(
        robot,
        per_coordinate("velocity_limit", speed, robot.nv, zero=True),
        per_coordinate("acceleration_limit", acceleration_limit, robot.nv),
    )
    weights = positive("damping", damping) * np.diag(per_coordinate("cost", cost, robot.nv))
    tolerance = positive_or_endless("tolerance", tolerance)  # infinite: whatever the error
    solver = Solver(robot, target, name, limits, weights)
    start = solver.start(q0)
    tending = start if posture is None else _checked_posture(robot, posture)
    gain = bounded("posture_gain", non_negative("posture_gain", posture_gain, "1/s"), most=1e6, unit="1/s")
    wanted = target.duration / positive("dt", dt, "s")
    if not wanted <= _MOST_STEPS:
        raise InvalidArgument(
            f"dt is {dt} s, which makes {wanted:.3g} steps, expected at most {_MOST_STEPS:,}"
        )
    count = max(int(np.ceil(wanted - 1e-9)), 2)
    resolved = InverseKinematicsTrajectory(
        robot, target, name, start, solver.steps(start, tending, gain, count)
    )
    _judge(resolved, tolerance, room)
    way = resolved(resolved.t)
    exceeded = limits_exceeded(robot, resolved.t, way.q, way.v, robot.inverse_dynamics(*way))
    if exceeded:
        warn("; ".join(exceeded), LimitWarning, stacklevel=2)
    return resolved


def _checked_posture(robot: MobileRobot, posture: ArrayLike) -> Array:
    """Return a configuration whose arms are in a posture, shape (nq,).

    Raises
    ------
    InvalidArgument
        If it has another shape or is not finite.
    """
    arms = shaped("posture", finite("posture", posture), (robot.nq - 3,), words=", the arms' part of q")
    return checked_configuration(robot, "posture", np.concatenate([np.zeros(3), arms]))


def _judge(resolved: InverseKinematicsTrajectory, tolerance: float, room: float | None) -> None:
    """Refuse a trajectory that misses its target or brings links too near to one another."""
    t, sizes = resolved.t, error_sizes(resolved.error[:, : resolved.target.rows])
    beyond, words = sizes.max(axis=-1) > tolerance, ""
    if beyond.any():
        way, turn = sizes[np.argmax(beyond)]
        most = sizes.max(axis=0)
        words = (
            f"target is missed by {way:.3g} m and {turn:.3g} rad at t = {t[np.argmax(beyond)]:g} s, expected "
            f"at most {tolerance:g}; the largest errors are {most[0]:.3g} m and {most[1]:.3g} rad"
        )
    elif room is not None and resolved.clearance.smallest < room:
        found = resolved.clearance
        beyond = found.distance < room
        k = int(np.argmax(beyond))
        a, b = found.pairs[int(found.distances[k].argmin())]
        words = (
            f"clearance is {found.distance[k]:.3g} m between {a} and {b} at t = {t[k]:g} s, "
            f"expected at least {room:g} m; the smallest is {found.told}"
        )
    if words:
        raise Unreachable(words, time=float(t[np.argmax(beyond)]), resolved=resolved)


_GAINS = ("kp", "kd", "posture_kp", "posture_kd")
# A force is held, not the acceleration, which changes within dt by some 1e-2 of itself: that much is left of
# what was beyond a limit by each.
_CORRECTIONS = 5


@runtime_checkable
class Wheeled(Protocol):
    """What `EndEffectorTracking` needs of a robot on wheels; one that rolls has ``project(q, v)`` too."""

    @property
    def robot(self) -> MobileRobot:
        """Body and arms, whose coordinates come first."""

    @property
    def nv(self) -> int:
        """Size of v."""

    def integrate(self, q: Array, dq: Array, /) -> Array:
        """Return the configuration that a displacement leads to, shape (nq,)."""

    def forward_dynamics(self, q: Array, v: Array, u: Array, /) -> Array:
        """Return the acceleration, shape (nv,)."""

    def inverse_dynamics(self, q: Array, v: Array, a: Array, /) -> Array:
        """Return the input with which body and arms accelerate so, shape (nu,)."""

    def check_inverse_dynamics(self) -> None:
        """Refuse a robot for which there is none."""


@final
@dataclass(frozen=True, eq=False)
class EndEffectorTracking:
    """Computed torque for a pose: tau = M(q) a + n(q, v), with the a that the pose asks for.

    a is what limits allow with the least |J a + dJ/dt v - (x_a + Kd e_dot + Kp e)|, and beside it the least
    damping |a - (a_r + kd_r (v_r - v) + kp_r (q_r - q))|: the reference that `simulate` passes on is the
    posture in what the pose leaves free (Nakamura and Hanafusa, 1986, at the level of accelerations; Khatib,
    1987). Positions and velocities within their limits stay there at every sample, as far as the model, `dt`
    and `integrator` are those of the plant: where the force that is held over `dt` would lead beyond a limit,
    another is chosen, whose acceleration may be beyond that limit by as much.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        The model that the controller believes in; its joints have one velocity each. On wheels it is one that
        moves in every direction, and tau the torques of least norm with which body and arms accelerate so.
    target : PosePath
        Pose, or position alone; to be simulated no longer than it lasts.
    frame : str, optional
        What follows it, one of ``robot.frame_names``; by default ``robot.end_effector``.
    kp, kd : float
        Gains of the pose's error [1/s^2] and of its rate [1/s], >= 0.
    posture_kp, posture_kd : float
        Gains of the posture [1/s^2] and [1/s], >= 0.
    damping : float
        Weight of an acceleration beside that of the frame [m/rad], > 0.
    velocity_limit : array_like, shape () or (nv,), optional
        As in `solve_inverse_kinematics`.
    acceleration_limit : array_like, shape () or (nv,)
        As in `solve_inverse_kinematics`.
    dt : float
        Time over which a force is held, that of `simulate` [s], > 0: with another, limits are overrun.
    integrator : callable
        How the plant moves under it, that of `simulate`, likewise; `rk4` for all that moves on without steps.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, a joint has more than one velocity, or no torques move the
        robot in every direction.
    UnknownName
        If there is no such frame.
    """

    robot: MobileRobot | Wheeled
    target: PosePath
    frame: str | None = None
    kp: float = 100.0
    kd: float = 20.0
    posture_kp: float = 25.0
    posture_kd: float = 10.0
    damping: float = 1e-2
    velocity_limit: ArrayLike | None = None
    acceleration_limit: ArrayLike = 20.0
    dt: float = 0.01
    integrator: Integrator = constant_acceleration
    _body: MobileRobot = field(init=False, repr=False)
    _limits: Limits = field(init=False, repr=False)
    _corrections: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # What follows is body and arms, whatever stands under them.
        body = self.robot.robot if isinstance(self.robot, Wheeled) else self.robot
        instance("robot", body, MobileRobot, "a MobileRobot")
        instance("target", self.target, PosePath, "a PosePath")
        if isinstance(self.robot, Wheeled):
            self.robot.check_inverse_dynamics()
        own = {name: non_negative(name, getattr(self, name)) for name in _GAINS}
        own |= {name: positive(name, getattr(self, name)) for name in ("damping", "dt")}
        check_integrator(self.integrator)
        nv = body.nv
        speed = body.velocity_limit if self.velocity_limit is None else self.velocity_limit
        speed = per_coordinate("velocity_limit", speed, nv, zero=True)
        most = per_coordinate("acceleration_limit", self.acceleration_limit, nv)
        fixed = {"frame": body.frame_name(self.frame), "velocity_limit": speed, "_body": body}
        limits = Limits(body, speed, most)
        # Where the acceleration at the start of a step holds through it, the bounds of `ramps` are exact.
        held = [getattr(self.integrator, name, ()) for name in ("weights_q", "weights_v")] == [(0.5,), (1.0,)]
        exact = held and not able(self.robot, Constrained)
        object.__setattr__(self, "_corrections", 0 if exact else _CORRECTIONS)
        for name, value in {**own, **fixed, "acceleration_limit": most, "_limits": limits}.items():
            object.__setattr__(self, name, value)

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def signals_at(self, t: Array) -> dict[str, tuple[str, Array]]:
        """Return the target of its frame at the samples of a run, see `PosePath.told`."""
        return self.target.told(str(self.frame), t)

    def __call__(self, t: float, q: Array, v: Array, reference: Reference, state: None) -> tuple[Array, None]:
        """Return the input, shape (nu,), and None."""
        return self._command(t, q, v, reference)[1], None

    def acceleration(self, t: float, q: Array, v: Array, reference: Reference) -> Array:
        """Return the acceleration of body and arms that is asked for, shape (3 + arms,).

        Parameters
        ----------
        t : float
            Time [s].
        q, v : ndarray, shape (nq,) and (nv,)
            State.
        reference : Reference
            The posture: q, v and a.
        """
        return self._command(t, q, v, reference)[0]

    def _command(self, t: float, q: Array, v: Array, reference: Reference) -> tuple[Array, Array]:
        """Return the acceleration that is asked for, shape (3 + arms,), and the input for it, (nu,)."""
        body, rows = self._body, self.target.rows
        count = np.shape(reference.v)[-1]
        if count != body.nv:
            raise InvalidArgument(
                f"reference has {count} coordinates, expected the {body.nv} of base and arms, such "
                "as a trajectory by solve_inverse_kinematics(robot, target) or WholeBody(robot, "
                "base, *joints)"
            )
        own_q, own_v = q[: body.nq], v[: body.nv]
        target = self.target(t)
        J = body.frame_jacobian(own_q, self.frame)
        error = pose_error(target.pose, body.frame_pose(own_q, self.frame))
        wanted = target.rate + self.kd * (target.twist - J @ own_v) + self.kp * error
        wanted -= body.frame_drift(own_q, own_v, self.frame)
        posture = reference.a + self.posture_kd * (reference.v - own_v)
        posture = posture + self.posture_kp * body.difference(own_q, reference.q)
        A = np.vstack([J[:rows], self.damping * np.eye(body.nv)])
        b = np.concatenate([wanted[:rows], self.damping * posture])
        least, most = self._limits.ramps(own_q, own_v, self.dt)
        a = bounded_least_squares(A, b, least, most)
        u = self.robot.inverse_dynamics(q, v, a)
        for _ in range(self._corrections):
            low, high = self._limits.excess(*self._after(q, v, u), self.dt)
            if not (low.any() or high.any()):
                break
            # A bound that is moved past the other, as of what is locked, takes it along.
            up, down = np.where(low > 0, a + low, -np.inf), np.where(high > 0, a - high, np.inf)
            least, most = np.clip(least, up, down), np.clip(most, up, down)
            a = bounded_least_squares(A, b, least, most)
            u = self.robot.inverse_dynamics(q, v, a)
        return a, u

    def _after(self, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
        """Return the state of body and arms to which a held input leads, by the model and the integrator."""
        robot, body = self.robot, self._body

        def acceleration(t: float, displacement: Array, w: Array) -> Array:
            return robot.forward_dynamics(robot.integrate(q, displacement), w, u)

        displacement, w = self.integrator(acceleration, 0.0, np.zeros(robot.nv), v, self.dt)
        after = robot.integrate(q, displacement)
        rolls = able(robot, Constrained)
        if rolls:
            w = rolls.project(after, w)
        return after[: body.nq], w[: body.nv]
