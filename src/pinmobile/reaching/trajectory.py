"""Trajectories of base and arm along which an end effector follows poses, within joint limits."""

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

_ROUNDING = 1e-9  # share of the largest acceleration; forward after inverse dynamics loses less


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of a robot's velocities and accelerations; the position limits come from the robot.

    Parameters
    ----------
    robot : MobileRobot
        Robot with the position limits.
    velocity : ndarray, shape (nv,)
        Limit of the absolute velocity [m/s, m/s, rad/s, ...], >= 0; inf for no limit.
    acceleration : ndarray, shape (nv,)
        Limit of the absolute acceleration [m/s^2, m/s^2, rad/s^2, ...], > 0 and finite.
    """

    robot: MobileRobot
    velocity: Array
    acceleration: Array

    def room(self, q: Array) -> Array:
        """Return the distance of coordinates to lower and upper limits, shape (2, nv), clipped at zero."""
        return np.maximum(self.signed_room(q), 0)

    def signed_room(self, q: Array) -> Array:
        """Return the distance of coordinates to lower and upper limits, shape (2, nv), negative outside."""
        return np.stack([q - self.robot.lower, self.robot.upper - q])

    def ramps(self, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
        """Return the lower and upper bound of a constant acceleration over `dt`, each of shape (nv,).

        The bounds correspond to `velocities`, for a velocity that changes linearly to v' at the end of the
        step: (v + v') dt / 2 + v'^2 / (2 a) <= d. Outside a position limit, the coordinate brakes with its
        maximum acceleration.

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
        """Return by how much an acceleration over `dt` was too low and too high, shape (2, nv), >= 0.

        With a correction of this size, each coordinate would stay within its limits and could still stop
        there. Values below rounding are zero.

        Parameters
        ----------
        q, v : ndarray, shape (nq,) and (nv,)
            State after the step.
        dt : float
            Time step [s].
        """
        room = self.signed_room(q)
        most = np.minimum(np.sqrt(2 * self.acceleration * np.maximum(room, 0)), self.velocity)
        excess = np.maximum((np.stack([-v, v]) - most) / dt, -2 * room / dt**2)
        return np.where(excess > _ROUNDING * self.acceleration, excess, 0)

    def velocities(self, q: Array, dt: float, before: Array | None = None) -> tuple[Array, Array]:
        """Return the lower and upper bound of a velocity that is constant over `dt`, each of shape (nv,).

        After the step, a joint can still stop at its limit: v dt + v^2 / (2 a) <= d, with the distance d to
        the limit and the acceleration a (after Flacco, De Luca and Khatib, "Motion control of redundant
        robots under joint constraints", 2012). If position and acceleration limits contradict each other, as
        for a state outside its limits, the position limits have priority.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Configuration.
        dt : float
            Time step [s].
        before : ndarray, shape (nv,), optional
            Velocity before the step; by default, arbitrary.
        """
        a = self.acceleration
        brake = a * (np.sqrt(dt**2 + 2 * self.room(q) / a) - dt)
        least, most = -np.minimum(brake[0], self.velocity), np.minimum(brake[1], self.velocity)
        if before is None:
            return least, most
        return np.clip(before - a * dt, least, most), np.clip(before + a * dt, least, most)


def bounded_least_squares(A: Array, b: Array, least: Array, most: Array) -> Array:
    """Return the x that minimises the norm of A x - b with least <= x <= most, shape (n,).

    Parameters
    ----------
    A : ndarray, shape (m, n)
        Matrix of rank n.
    b : ndarray, shape (m,)
        Right-hand side.
    least, most : ndarray, shape (n,)
        Bounds, least <= most; infinite for no bound.
    """
    x: Array = np.asarray(np.linalg.lstsq(A, b)[0], dtype=np.float64)
    if ((x >= least) & (x <= most)).all():
        return x
    # Imported here: scipy loads slowly, and most steps do not need it.
    from scipy.optimize import lsq_linear

    free = least < most
    x = np.where(free, 0.0, least)
    if free.any():
        bounds = least[free], most[free]
        x[free] = lsq_linear(A[:, free], b - A[:, ~free] @ x[~free], bounds, method="bvls").x
    return np.asarray(np.clip(x, least, most), dtype=np.float64)


def per_coordinate(name: str, value: ArrayLike, size: int, *, zero: bool = False) -> Array:
    """Return one positive number per coordinate, shape (size,); a scalar applies to all coordinates.

    Parameters
    ----------
    name : str
        Name of the argument in messages.
    value : array_like, shape () or (size,)
        Value of the argument.
    size : int
        Number of coordinates.
    zero : bool
        Whether zero and infinity are valid.

    Raises
    ------
    InvalidArgument
        If the value has another shape or a number is out of range.
    """
    given = endless_or_finite(name, value) if zero else finite(name, value)
    shaped(name, given, (), (size,))
    bounded(name, given, least=0 if zero else None, above=None if zero else 0)
    return frozen(np.broadcast_to(given, (size,)))


_CATCH_UP = 10.0  # [1/s]: largest rate of reducing an error that limits caused
_EXACT = 1e-10  # [m, rad]
_STEPS = 4  # Gauss-Newton iterations per step: without limits, an error of 1e-4 falls below rounding
_SEARCH = 200  # Gauss-Newton iterations for the start
_STRIDE = 0.2  # their largest displacement [m, rad]
_TRIES = 8  # initial guesses for the start
_AS_GOOD = 1e-6  # relative: remaining errors of the same local minimum differ by less


@dataclass(frozen=True, eq=False)
class Solver:
    """Bounded, damped least-squares inverse kinematics for one target.

    Parameters
    ----------
    robot : MobileRobot
        Robot whose coordinates are the unknowns.
    target : PosePath
        Target poses.
    frame : str
        Frame that follows the target.
    limits : Limits
        Bounds.
    weights : ndarray, shape (nv, nv)
        Weights of displacements relative to the pose error.
    """

    robot: MobileRobot
    target: PosePath
    frame: str
    limits: Limits
    weights: Array  # (nv, nv)

    def error(self, pose: Array, q: Array) -> Array:
        """Return the error of the frame's pose, shape (rows,)."""
        return pose_error(pose, self.robot.frame_pose(q, self.frame))[: self.target.rows]

    def correction(self, q: Array, error: Array, wish: Array, least: Array, most: Array) -> Array:
        """Return the displacement within bounds that reduces the error, close to a preferred displacement.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Configuration.
        error : ndarray, shape (rows,)
            Error of the frame's pose [m, rad].
        wish, least, most : ndarray, shape (nv,)
            Preferred displacement, lower bound and upper bound.
        """
        J = self.robot.frame_jacobian(q, self.frame)[: self.target.rows]
        A, b = np.vstack([J, self.weights]), np.concatenate([error, self.weights @ wish])
        return bounded_least_squares(A, b, least, most)

    def start(self, q0: ArrayLike | None) -> Array:
        """Return a configuration within limits for the start of the target, or with the smallest error found.

        Parameters
        ----------
        q0 : array_like, shape (nq,), or None
            Initial guess; None tries `rest` first, then other configurations.

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
            if size < best[0] * (1 - _AS_GOOD):  # take the first of equal minima, on every machine
                best = size, q
            if best[0] <= _EXACT:
                break
        return best[1]

    def sought(self, q: Array) -> Array:
        """Return the Gauss-Newton solution for the start of the target from an initial guess, shape (nq,)."""
        pose, still = self.target(0.0).pose, np.zeros(self.robot.nv)
        # The pose is linear in x and y, so their steps need no bound; locked coordinates do not move.
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

        The first and the last control point are beyond the ends of the target.

        Parameters
        ----------
        start, posture : ndarray, shape (nq,)
            Initial configuration, and preferred configuration of the arms.
        gain : float
            Rate of convergence toward the preferred configuration [1/s].
        count : int
            Number of steps.
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
        """Return the part of a remaining error that a step may leave, shape (rows,).

        The approach has a speed of at most sqrt(a e), which requires half of the acceleration a. A faster
        approach could not brake in time.
        """
        size = float(np.linalg.norm(left))
        a = float(self.limits.acceleration.min())
        rate = min(_CATCH_UP, np.sqrt(a / size)) if size else _CATCH_UP
        return max(1 - rate * dt, 0.0) * left

    def beyond(self, nearest: Array, start: Array, dt: float) -> Array:
        """Return the control point beyond the end, shape (nv,), from the three nearest, shape (3, nv).

        The extrapolation continues their acceleration if it stays within the limits. Otherwise the
        extrapolation is linear; then the curve ends at the outermost of the three points and stays between
        them.
        """
        line = 2 * nearest[0] - nearest[1]
        bent = line + nearest[0] - 2 * nearest[1] + nearest[2]
        below, above = self.limits.room(start)
        fits = (bent >= -below) & (bent <= above) & (np.abs(nearest[0] - bent) <= dt * self.limits.velocity)
        return np.asarray(np.where(fits, bent, line))


def checked_configuration(robot: MobileRobot, name: str, value: ArrayLike) -> Array:
    """Return a checked configuration within limits, shape (nq,).

    Raises
    ------
    InvalidArgument
        If the value has another shape, is not finite, or is outside the limits.
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
    """Trajectory of all coordinates that `solve_inverse_kinematics` returns: a uniform cubic B-spline.

    q is twice continuously differentiable, with derivatives v and a. q, v and a are averages of the control
    points, of their first and of their second differences (de Boor, "A practical guide to splines", 1978).
    Bounds on the control points and differences therefore hold at all times, not only at samples.

    Attributes
    ----------
    robot : MobileRobot
        Robot whose coordinates the trajectory describes.
    target : PosePath
        Target poses.
    frame : str
        Name of the frame that follows the target.
    start : ndarray, shape (nq,)
        Configuration at the first control point [m, m, rad, ...].
    controls : ndarray, shape (N + 3, nv)
        Displacements of the control points from `start`, evenly spaced in time, with one point beyond each
        end.

    See Also
    --------
    solve_inverse_kinematics : function that returns this object
    ComputedTorque : controller for this trajectory
    WholeBody : trajectory of given base and joint motions

    Examples
    --------
    >>> from pinmobile import MobileRobot, PosePath, Line
    >>> from pinmobile import solve_inverse_kinematics
    >>> robot = MobileRobot.box(mass=60.0).mount("ur5")
    >>> tool = robot.frame_pose(robot.rest)[:3, 3]
    >>> target = PosePath(Line(tool, tool + [0.5, 0.0, 0.0], 4.0))
    >>> plan = solve_inverse_kinematics(robot, target, dt=0.1)
    >>> x = plan(4.0).q[0]  # of the base [m]
    >>> print(f"{x:.1f} m of {plan.duration:.0f} s")
    0.5 m of 4 s
    """

    robot: MobileRobot
    target: PosePath
    frame: str
    start: Array
    controls: Array
    _curve: Callable[..., Array] = field(init=False)

    def __post_init__(self) -> None:
        # Imported here: scipy loads slowly, and `EndEffectorTracking` does not need it.
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
        except PinmobileError:  # without collision geometry, the clearance is unknown
            near = ""
        over = f"{self.frame} over {self.duration:g} s"
        return f"<InverseKinematicsTrajectory: {over}, largest error {metres:.3e} m{turn}{near}>"

    @property
    def duration(self) -> float:
        """Duration of the target [s]."""
        return self.target.duration

    @property
    def t(self) -> Array:
        """Times of the control points between the ends, shape (N + 1,) [s]."""
        return np.linspace(0, self.duration, len(self.controls) - 2)

    def __call__(self, t: ArrayLike) -> Reference:
        """Return the reference at given times.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        Reference
            q, shape (..., nq), v and a, shape (..., nv).

        Raises
        ------
        InvalidArgument
            If a time is out of range.
        """
        times = within("t", t, self.duration)
        displacement, v, a = (self._curve(times, order) for order in range(3))
        # Rounding may exceed a limit.
        q = np.clip(self.robot.integrate(self.start, displacement), self.robot.lower, self.robot.upper)
        return Reference(q, v, a)

    def signals_at(self, t: Array) -> dict[str, tuple[str, Array]]:
        """Return the target of the frame at the samples of a run, see `PosePath.told`.

        Parameters
        ----------
        t : ndarray, shape (N + 1,)
            Times [s].
        """
        return self.target.told(self.frame, t)

    @cached_property
    def error(self) -> Array:
        """Pose errors at the times `t`, shape (N + 1, 6) [m, rad], along the inertial axes, see `pose_error`.

        The last three columns hold the rotation vector. They are NaN for a target without orientation.
        """
        error = pose_error(self.target(self.t).pose, self.robot.frame_pose(self(self.t).q, self.frame))
        error[:, self.target.rows :] = np.nan
        return frozen(error)

    @cached_property
    def clearance(self) -> Clearance:
        """Distances between the robot's links, and between links and ground, at the times `t`.

        Raises
        ------
        InvalidArgument
            If the robot has no collision geometry.
        """
        return clearance_of(self.robot, self(self.t).q)

    def max_error(self) -> tuple[float, float]:
        """Return the largest distance [m] and the largest angle [rad] from frame to target, see `error`."""
        way, turn = error_sizes(self.error).max(axis=0)
        return float(way), float(turn)


_MOST_STEPS = 1_000_000  # more would take hours


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
    """Return a trajectory of base and arm along which a frame follows target poses.

    The solver is damped least squares within bounds (Nakamura and Hanafusa, 1986). In each step, it minimises
    the error of the next pose over all displacements within limits. Among nearly optimal displacements, it
    prefers motion toward the posture. It then iterates until the pose is reached. At a singular configuration
    or a limit, an error remains. The base may move in any direction. Use `ComputedTorque` to track the
    trajectory.

    Parameters
    ----------
    robot : MobileRobot
        Robot with or without arms.
    target : PosePath
        Target poses, or target positions.
    frame : str, optional
        Frame that follows the target, one of ``robot.frame_names``; by default, ``robot.end_effector``.
    q0 : array_like, shape (nq,), optional
        Initial guess for the start [m, m, rad, ...]; by default, ``robot.rest`` and then other
        configurations.
    posture : array_like, shape (nq - 3,), optional
        Preferred configuration of the arms in the directions that the target leaves free [rad or m]; by
        default, the configuration at the start.
    dt : float
        Largest time between control points [s]. The error is about a dt^2 / 6 for a frame with acceleration
        a.
    posture_gain : float
        Rate of convergence toward the posture [1/s], >= 0.
    cost : array_like, shape () or (nv,)
        Relative cost of each coordinate's motion, > 0. A coordinate with a high cost moves little.
    velocity_limit : array_like, shape () or (nv,), optional
        Limit of the absolute velocities [m/s, m/s, rad/s, ...]; by default, the robot's limits. inf means no
        limit; zero locks a coordinate.
    acceleration_limit : array_like, shape () or (nv,)
        Limit of the absolute accelerations [m/s^2, m/s^2, rad/s^2, ...], > 0, including those of braking at a
        position limit. Position and velocity limits have priority.
    damping : float
        Weight of displacements relative to the pose error [m/rad], > 0.
    tolerance : float
        Largest accepted distance [m] and angle [rad], see `reaching.InverseKinematicsTrajectory`; infinite
        accepts any error.
    clearance : float, optional
        Smallest accepted distance between links, and between links and ground, >= 0 [m], see `clearance`; by
        default, distances are not checked and the arm may pass through the robot's body.

    Returns
    -------
    reaching.InverseKinematicsTrajectory
        Trajectory to follow from its start. At the start, the velocity of the frame equals that of the target
        up to an error proportional to dt^2.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, or a joint has several velocities.
    UnknownName
        If the robot has no such frame.
    Unreachable
        If an error exceeds the tolerance, or a distance is below `clearance`. The attribute ``resolved`` of
        the error holds the trajectory.

    Warns
    -----
    LimitWarning
        If the trajectory needs more force or torque than the robot's ``effort_limit``.

    See Also
    --------
    EndEffectorTracking : controller that follows a pose without a plan
    PosePath : target poses
    clearance : distances between links

    Examples
    --------
    >>> from pinmobile import MobileRobot, PosePath, Line
    >>> from pinmobile import solve_inverse_kinematics
    >>> robot = MobileRobot.box(mass=60.0).mount("ur5")
    >>> tool = robot.frame_pose(robot.rest)[:3, 3]
    >>> target = PosePath(Line(tool, tool + [0.5, 0.0, 0.0], 4.0))
    >>> plan = solve_inverse_kinematics(robot, target, dt=0.1)
    >>> distance, angle = plan.max_error()
    >>> distance < 1e-5  # [m]
    True
    """
    instance("robot", robot, MobileRobot, "a MobileRobot")
    instance("target", target, PosePath, "a PosePath")
    room = None if clearance is None else non_negative("clearance", clearance, "m")
    if room is not None:
        _ = robot.solids  # raises before the computation, not after it
    name = robot.frame_name(frame)
    speed = robot.velocity_limit if velocity_limit is None else velocity_limit
    limits = Limits(
        robot,
        per_coordinate("velocity_limit", speed, robot.nv, zero=True),
        per_coordinate("acceleration_limit", acceleration_limit, robot.nv),
    )
    weights = positive("damping", damping) * np.diag(per_coordinate("cost", cost, robot.nv))
    tolerance = positive_or_endless("tolerance", tolerance)  # infinite accepts any error
    solver = Solver(robot, target, name, limits, weights)
    start = solver.start(q0)
    tending = start if posture is None else _checked_posture(robot, posture)
    gain = bounded("posture_gain", non_negative("posture_gain", posture_gain, "1/s"), most=1e6, unit="1/s")
    wanted = target.duration / positive("dt", dt, "s")
    if not wanted <= _MOST_STEPS:
        raise InvalidArgument(
            f"dt is {dt} s, which gives {wanted:.3g} steps, expected at most {_MOST_STEPS:,}: use a larger dt"
        )
    count = max(int(np.ceil(wanted - 1e-9)), 2)
    resolved = InverseKinematicsTrajectory(
        robot, target, name, start, solver.steps(start, tending, gain, count)
    )
    _judge(resolved, tolerance, room)
    way = resolved(resolved.t)
    exceeded = limits_exceeded(robot, resolved.t, way.q, way.v, robot.inverse_dynamics(*way))
    if exceeded:
        warn("; ".join(map(str, exceeded)), LimitWarning, stacklevel=2)
    return resolved


def _checked_posture(robot: MobileRobot, posture: ArrayLike) -> Array:
    """Return a configuration with the arms in a given posture, shape (nq,).

    Raises
    ------
    InvalidArgument
        If the posture has another shape or is not finite.
    """
    arms = shaped("posture", finite("posture", posture), (robot.nq - 3,), words=", the arms' part of q")
    return checked_configuration(robot, "posture", np.concatenate([np.zeros(3), arms]))


def _judge(resolved: InverseKinematicsTrajectory, tolerance: float, room: float | None) -> None:
    """Raise `Unreachable` if a trajectory misses its target or links are too close to each other."""
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
# The force is constant over dt, so the acceleration changes by about 1e-2 of its value. Each correction
# therefore reduces an excess to about 1e-2 of its value.
_CORRECTIONS = 5


@runtime_checkable
class Wheeled(Protocol):
    """Robot on wheels for `EndEffectorTracking`; a rolling robot also has ``project(q, v)``."""

    @property
    def robot(self) -> MobileRobot:
        """Body and arms, whose coordinates come first."""

    @property
    def nv(self) -> int:
        """Number of entries of v."""

    def integrate(self, q: Array, dq: Array, /) -> Array:
        """Return the configuration after a displacement, shape (nq,)."""

    def forward_dynamics(self, q: Array, v: Array, u: Array, /) -> Array:
        """Return the acceleration, shape (nv,)."""

    def inverse_dynamics(self, q: Array, v: Array, a: Array, /) -> Array:
        """Return the input that produces an acceleration of body and arms, shape (nu,)."""

    def check_inverse_dynamics(self) -> None:
        """Raise `InvalidArgument` for a robot without inverse dynamics."""


@final
@dataclass(frozen=True, eq=False)
class EndEffectorTracking:
    """Computed-torque control of an end effector's pose: tau = M(q) a + n(q, v).

    The acceleration a minimises the norm of J a + dJ/dt v - (x_a + Kd e_dot + Kp e) within the limits, plus
    the norm of damping (a - (a_r + kd_r (v_r - v) + kp_r (q_r - q))). The reference from `simulate` is the
    preferred posture, which acts in the directions that the pose leaves free (Nakamura and Hanafusa, 1986,
    for accelerations; Khatib, 1987).

    Positions and velocities within their limits stay within their limits at every sample, if model, `dt` and
    `integrator` equal those of the plant. If a constant force over `dt` would lead beyond a limit, the
    controller chooses another force; its acceleration may exceed the acceleration limit by the required
    amount.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        Controller model; each joint has one velocity. A robot on wheels must be omnidirectional; tau then
        holds the minimum-norm torques that produce this acceleration of body and arms.
    target : PosePath
        Target poses, or target positions, for at least the duration of the simulation.
    frame : str, optional
        Frame that follows the target, one of ``robot.frame_names``; by default, ``robot.end_effector``.
    kp, kd : float
        Gains of the pose error [1/s^2] and of its rate [1/s], >= 0.
    posture_kp, posture_kd : float
        Gains of the posture error [1/s^2] and of its rate [1/s], >= 0.
    damping : float
        Weight of the coordinates' accelerations relative to the frame's acceleration [m/rad], > 0.
    velocity_limit : array_like, shape () or (nv,), optional
        As in `solve_inverse_kinematics` [m/s, m/s, rad/s, ...].
    acceleration_limit : array_like, shape () or (nv,)
        As in `solve_inverse_kinematics` [m/s^2, m/s^2, rad/s^2, ...].
    dt : float
        Time step of `simulate` [s], > 0. With another value, the limits may be exceeded.
    integrator : callable
        Integrator of `simulate`; `rk4` for plants without one. With another integrator, the limits may be
        exceeded.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, a joint has several velocities, or the wheels cannot move the
        robot in every direction.
    UnknownName
        If the robot has no such frame.

    See Also
    --------
    solve_inverse_kinematics : plan of the whole motion in advance
    ComputedTorque : the same law for coordinates
    PosePath : target poses

    Examples
    --------
    >>> from pinmobile import EndEffectorTracking, Hold, PosePath
    >>> from pinmobile import MobileRobot, Reference
    >>> robot = MobileRobot.box(mass=60.0).mount("ur5")
    >>> q, v = robot.rest, 0 * robot.rest
    >>> goal = robot.frame_pose(q)[:3, 3] + [0.01, 0, 0]  # 1 cm ahead
    >>> law = EndEffectorTracking(robot, PosePath(Hold(goal, 2.0)), kp=100)
    >>> a = law.acceleration(0.0, q, v, Reference(q, v, v))
    >>> print((robot.frame_jacobian(q) @ a)[0])  # tool: kp 1 cm [m/s^2]
    1.00
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
        # Body and arms follow the target, for any wheels under the body.
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
        # The bounds of `ramps` are exact if the integrator keeps the initial acceleration over a step.
        held = [getattr(self.integrator, name, ()) for name in ("weights_q", "weights_v")] == [(0.5,), (1.0,)]
        exact = held and not able(self.robot, Constrained)
        object.__setattr__(self, "_corrections", 0 if exact else _CORRECTIONS)
        for name, value in {**own, **fixed, "acceleration_limit": most, "_limits": limits}.items():
            object.__setattr__(self, name, value)

    def initial_state(self, context: Context) -> None:
        """Return None: the controller has no memory."""

    def signals_at(self, t: Array) -> dict[str, tuple[str, Array]]:
        """Return the target of the frame at the samples of a run, see `PosePath.told`.

        Parameters
        ----------
        t : ndarray, shape (N + 1,)
            Times [s].
        """
        return self.target.told(str(self.frame), t)

    def __call__(self, t: float, q: Array, v: Array, reference: Reference, state: None) -> tuple[Array, None]:
        """Return the input, shape (nu,), and None.

        Parameters
        ----------
        t : float
            Time [s].
        q, v : ndarray, shape (nq,) and (nv,)
            State.
        reference : Reference
            Preferred posture: q, v and a.
        state : None
            Unused memory.
        """
        return self._command(t, q, v, reference)[1], None

    def acceleration(self, t: float, q: Array, v: Array, reference: Reference) -> Array:
        """Return the desired acceleration of body and arms, shape (3 + arms,) [m/s^2, m/s^2, rad/s^2, ...].

        Parameters
        ----------
        t : float
            Time [s].
        q, v : ndarray, shape (nq,) and (nv,)
            State.
        reference : Reference
            Preferred posture: q, v and a.
        """
        return self._command(t, q, v, reference)[0]

    def _command(self, t: float, q: Array, v: Array, reference: Reference) -> tuple[Array, Array]:
        """Return the desired acceleration, shape (3 + arms,), and the required input, shape (nu,)."""
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
            # A bound that moves past the other one (as for a locked coordinate) moves both.
            up, down = np.where(low > 0, a + low, -np.inf), np.where(high > 0, a - high, np.inf)
            least, most = np.clip(least, up, down), np.clip(most, up, down)
            a = bounded_least_squares(A, b, least, most)
            u = self.robot.inverse_dynamics(q, v, a)
        return a, u

    def _after(self, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
        """Return the state of body and arms after a step with a constant input, by model and integrator."""
        robot, body = self.robot, self._body

        def acceleration(t: float, displacement: Array, w: Array) -> Array:
            return robot.forward_dynamics(robot.integrate(q, displacement), w, u)

        displacement, w = self.integrator(acceleration, 0.0, np.zeros(robot.nv), v, self.dt)
        after = robot.integrate(q, displacement)
        rolls = able(robot, Constrained)
        if rolls:
            w = rolls.project(after, w)
        return after[: body.nq], w[: body.nv]
