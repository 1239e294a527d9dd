"""Least-squares inverse kinematics of base and arm within limits, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike, between, bounded, endless_or_finite, finite, frozen, shaped
from pinmobile.reaching.drive import Drive
from pinmobile.reaching.poses import FrameTask
from pinmobile.robot import MobileRobot, frames_of

_SIDES = np.array([[-1.0], [1.0]])
_ROUNDING = 1e-9  # share of the largest acceleration; forward after inverse dynamics loses less


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of coordinates, or of the integrals of independent velocities.

    Parameters
    ----------
    lower, upper : ndarray, shape (nv,)
        Position limits [m, m, rad, ...]; infinite for no limit.
    velocity : ndarray, shape (nv,)
        Limit of the absolute velocity [m/s, m/s, rad/s, ...], >= 0; inf for no limit.
    acceleration : ndarray, shape (nv,)
        Limit of the absolute acceleration [m/s^2, m/s^2, rad/s^2, ...], > 0 and finite.
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array

    def room(self, q: Array) -> Array:
        """Return the distance of coordinates to lower and upper limits, shape (2, nv), clipped at zero."""
        return np.maximum(self.signed_room(q), 0)

    def signed_room(self, q: Array) -> Array:
        """Return the distance of coordinates to lower and upper limits, shape (2, nv), negative outside."""
        return np.array([q - self.lower, self.upper - q])

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
        upper = np.clip((np.minimum(stop[1], self.velocity) - v) / dt, -a, a)
        lower = np.clip((-np.minimum(stop[0], self.velocity) - v) / dt, -a, a)
        return np.minimum(lower, upper), upper

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
        speed = np.minimum(np.sqrt(2 * self.acceleration * np.maximum(room, 0)), self.velocity)
        excess = np.maximum((np.stack([-v, v]) - speed) / dt, -2 * room / dt**2)
        return np.where(excess > _ROUNDING * self.acceleration, excess, 0)

    def velocities(self, q: Array, dt: float, previous: Array | None = None) -> Array:
        """Return the lower and upper bound of a velocity that is constant over `dt`, shape (2, nv).

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
        previous : ndarray, shape (nv,), optional
            Velocity before the step; by default, arbitrary.
        """
        a, change = self.acceleration, self.acceleration * dt
        speed = np.minimum(np.sqrt(change**2 + 2 * a * self.room(q)) - change, self.velocity)
        if previous is None:
            return np.array([-speed[0], speed[1]])
        return np.asarray(np.minimum(np.maximum(previous + change * _SIDES, -speed[0]), speed[1]))


def bounded_least_squares(A: Array, b: Array, lower: Array, upper: Array) -> Array:
    """Return the x that minimises the norm of A x - b with least <= x <= most, shape (n,).

    Parameters
    ----------
    A : ndarray, shape (m, n)
        Matrix of rank n.
    b : ndarray, shape (m,)
        Right-hand side.
    lower, upper : ndarray, shape (n,)
        Bounds, least <= most; infinite for no bound.
    """
    x: Array = np.asarray(np.linalg.lstsq(A, b)[0], dtype=np.float64)
    if ((x >= lower) & (x <= upper)).all():
        return x
    # Imported here: scipy loads slowly, and most steps do not need it.
    from scipy.optimize import lsq_linear

    free = lower < upper
    x = np.where(free, 0.0, lower)
    if free.any():
        bounds = lower[free], upper[free]
        x[free] = lsq_linear(A[:, free], b - A[:, ~free] @ x[~free], bounds, method="bvls").x
    return np.asarray(np.clip(x, lower, upper), dtype=np.float64)


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


_BASE = 3
_CATCH_UP = 10.0  # [1/s]: largest rate of reducing an error that limits caused
_START_TOLERANCE, _STEP_TOLERANCE = 1e-10, 1e-9  # [m, rad]: at the start, and in each step
_STEPS = 4  # Newton iterations per step: without limits, an error of 1e-4 falls below rounding
_RENEWAL_RATIO = 0.02  # reduction of the error by an iteration above which the next one renews the Jacobian
_SEARCH = 200  # Gauss-Newton iterations for the start
_STRIDE = 0.2  # their largest displacement [m, rad]
_DAMPING_SHARE = 0.01  # largest share of the error that damping leaves in a regular configuration
_MIN_WEIGHT = 1e-10  # smaller weights of displacements have no effect beside rounding
_TRIES = 8  # initial guesses for the start
_EQUAL_TOLERANCE = 1e-6  # relative: remaining errors of the same local minimum differ by less


@dataclass(frozen=True, eq=False)
class Solver:
    """Bounded, damped least-squares inverse kinematics for tasks.

    Parameters
    ----------
    robot : MobileRobot
        Body and arms.
    tasks : sequence of FrameTask
        Tasks; the first decides which start is the best.
    limits : Limits
        Bounds of the coordinates, or, with a drive, of the integrals of its independent velocities.
    weights : ndarray, shape (nv,)
        Weights of displacements relative to the errors, > 0.
    drive : Drive or None
        Wheels under the body; None: the base moves in every direction.
    """

    robot: MobileRobot
    tasks: Sequence[FrameTask]
    limits: Limits
    weights: Array
    drive: Drive | None

    @cached_property
    def _frames(self) -> Any:
        return frames_of(self.robot, [str(task.frame) for task in self.tasks])

    @cached_property
    def _lapack(self) -> Any:
        # Imported here: scipy loads slowly, and `EndEffectorTracking` does not need it.
        from scipy.linalg import lapack

        return lapack

    @cached_property
    def _importance(self) -> Array:
        """Weights of the rows of all tasks, shape (rows,)."""
        return np.concatenate([task.weights for task in self.tasks])

    @cached_property
    def _reach(self) -> Array:
        """Displacement per weighted one, shape (nv,); zero for locked coordinates."""
        return np.where(self.limits.velocity == 0, 0.0, 1 / np.maximum(self.weights, _MIN_WEIGHT))

    @cached_property
    def _rows(self) -> list[slice]:
        """Rows of each task."""
        ends = np.cumsum([len(task.weights) for task in self.tasks]).tolist()
        return [slice(end - len(task.weights), end) for task, end in zip(self.tasks, ends, strict=True)]

    @cached_property
    def _min_acceleration(self) -> float:
        return float(self.limits.acceleration.min())

    def errors(self, goals: Sequence[Any], poses: Sequence[Any]) -> Array:
        """Return the errors of all tasks, one after the other, shape (rows,) [m, rad]."""
        if len(poses) == 1:
            return self.tasks[0].error_of(goals[0], poses[0])
        triples = zip(self.tasks, goals, poses, strict=True)
        return np.concatenate([task.error_of(goal, pose) for task, goal, pose in triples])

    def system(self, J: Array, reach: Array) -> tuple[Array, ...]:
        """Return the weighted Jacobian, that by weighted displacements, its square's factor, and `reach`.

        Parameters
        ----------
        J : ndarray, shape (rows, nv)
            Jacobian of the errors.
        reach : ndarray, shape (nv,)
            Reciprocal weights of displacements, zero for locked coordinates.
        """
        A = self._importance[:, None] * J
        B = A * reach
        square = B @ B.T
        square.flat[:: len(square) + 1] += 1.0
        return A, B, self._lapack.dpotrf(square)[0], reach

    def correction(
        self, system: tuple[Array, ...], error: Array, preferred: Array, lower: Array, upper: Array
    ) -> Array:
        """Return the displacement within bounds that reduces the error, close to a preferred displacement.

        It minimises |A x - b|^2 + |(x - preferred) / reach|^2 with as many equations as there are rows.

        Parameters
        ----------
        system : tuple
            Result of `system`.
        error : ndarray, shape (rows,)
            Error [m, rad].
        preferred, lower, upper : ndarray, shape (nv,)
            Preferred displacement, lower bound and upper bound.
        """
        A, B, factor, reach = system
        b = self._importance * error
        residual = b - A @ preferred
        y = self._lapack.dpotrs(factor, residual)[0]
        # y is also the error that damping leaves. In a regular configuration, the solver reduces y again.
        if y @ y <= _DAMPING_SHARE**2 * (residual @ residual):
            y += self._lapack.dpotrs(factor, y)[0]
        x: Array = preferred + reach * (y @ B)
        if (np.minimum(np.maximum(x, lower), upper) == x).all():
            return x
        free = reach > 0
        inverse, bounds = 1 / reach[free], (lower[free], upper[free])
        b = np.append(b - A[:, ~free] @ preferred[~free], inverse * preferred[free])
        x = preferred.copy()
        x[free] = bounded_least_squares(np.vstack([A[:, free], np.diag(inverse)]), b, *bounds)
        return np.clip(x, lower, upper)

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
        robot, goals = self.robot, [goal[0] for goal in self.goals(np.zeros(1))]
        first = robot.rest if q0 is None else check_configuration(robot, "q0", q0)
        generator, best = np.random.default_rng(0), (np.inf, first)
        for attempt in range(_TRIES if q0 is None else 1):
            offset = generator.uniform(-1, 1, robot.nv) * (attempt > 0) * (np.arange(robot.nv) >= _BASE)
            q = self.find_start(goals, np.clip(robot.integrate(first, offset), robot.lower, robot.upper))
            size = float(np.linalg.norm(self.errors(goals, self._frames[0](q))[: len(self.tasks[0].weights)]))
            if size < best[0] * (1 - _EQUAL_TOLERANCE):  # take the first of equal minima, on every machine
                best = size, q
            if best[0] <= _START_TOLERANCE:
                break
        return best[1]

    def find_start(self, goals: Sequence[Any], q: Array) -> Array:
        """Return the Gauss-Newton solution for the start of the tasks from an initial guess, shape (nq,)."""
        # The pose is linear in x and y, so their steps need no bound; locked coordinates do not move.
        robot, nv = self.robot, self.robot.nv
        stride = np.where(np.arange(nv) < 2, np.inf, _STRIDE)
        reach, zero = self._reach, np.zeros(nv)
        if self.drive is not None:  # the start may be anywhere in the plane
            base = np.full(_BASE, reach[: self.drive.arms.start].max())
            reach = np.concatenate([base, reach[self.drive.arms]])
        stride[reach == 0] = 0
        for _ in range(_SEARCH):
            poses = self._frames[0](q)
            error = self.errors(goals, poses)
            if error @ error <= _START_TOLERANCE**2:
                break
            bounds = np.maximum(robot.lower - q, -stride), np.minimum(robot.upper - q, stride)
            step = self.correction(self.system(self.jacobian(poses), reach), error, zero, *bounds)
            q = np.clip(q + step, robot.lower, robot.upper)
            if step @ step <= _START_TOLERANCE**2:
                break
        return q

    def goals(self, t: Array) -> list[Any]:
        """Return positions and orientations at times, one pair for each task and time."""
        poses = (task.target(t).pose for task in self.tasks)
        return [list(zip(T[:, :3, 3], T[:, :3, :3], strict=True)) for T in poses]

    def jacobian(self, poses: Sequence[Any]) -> Array:
        """Return the Jacobian of all tasks, shape (rows, nv), for the last poses of the frames."""
        triples = zip(self.tasks, poses, self._frames[1](), strict=True)
        blocks = [task.rows_of(pose, J) for task, pose, J in triples]
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks)

    def steps(self, start: Array, posture: Array, gain: float, count: int) -> Array:
        """Return the displacements of the control points from the start, shape (count + 3, nv).

        The first and the last control point are beyond the ends of the target. With a drive, they are those
        of the integrals of its independent velocities; each step begins where the curve leads, so that no
        error of integration adds up.

        Parameters
        ----------
        start, posture : ndarray, shape (nq,)
            Initial configuration, and preferred configuration of the arms.
        gain : float
            Rate of convergence toward the preferred configuration [1/s].
        count : int
            Number of steps.
        """
        drive, dt = self.drive, self.tasks[0].target.duration / count
        goals = list(zip(*self.goals(np.linspace(0, self.tasks[0].target.duration, count + 1)), strict=True))
        q, v, arms = start, None, slice(_BASE, None) if drive is None else drive.arms
        origin = y = start if drive is None else drive.origin(start)
        controls, preferred, zero = np.zeros((count + 1, len(y))), np.zeros(len(y)), np.zeros(len(y))
        rates = dt * gain * (self._reach[arms] > 0)
        pose, poses = start[:_BASE], self._frames[0](start)
        residual = self.errors(goals[0], poses)
        for k in range(count):
            if drive is not None and k >= 2:
                first = self.extrapolate(controls[:3], origin, dt) if k == 2 else controls[k - 3]
                points = np.vstack([first, controls[k - 2 : k + 1]])
                pose = drive.first_pose(start, points[:3]) if k == 2 else pose
                pose, q = drive.advance(pose, points, origin, y, dt)
                poses = self._frames[0](q)
            preferred[arms] = rates * self.robot.difference(q, posture)[_BASE:]
            lower, upper = dt * self.limits.velocities(y, dt, v)
            allowed = self.allowed_error(residual, dt)
            step, reach, curvature = np.zeros(len(y)), self._reach, None
            error = self.errors(goals[k + 1], poses) - allowed
            if drive is not None and drive.is_car:
                turn, reach = self._steering_step(q, y, poses, error, preferred, dt), reach.copy()
                step[-1] = lower[-1] = upper[-1] = np.clip(turn, lower[-1], upper[-1])
                reach[-1], curvature = 0.0, drive.curvature(y[-1] + step[-1] / 2)[0]
            slope = None if drive is None else drive.displace(q, y, step)[1]
            size = np.inf
            for i in range(_STEPS):
                previous, size = size, sqrt(error @ error)
                if i and size <= _STEP_TOLERANCE:
                    break
                if i == 0 or size > _RENEWAL_RATIO * previous:
                    J = self.jacobian(poses)
                    J = J if drive is None or slope is None else drive.jacobian(J, slope, curvature)
                    system = self.system(J, reach)
                dx = self.correction(system, error, zero if i else preferred, lower - step, upper - step)
                step = step + dx
                trial, slope = (q + step, None) if drive is None else drive.displace(q, y, step)
                poses = self._frames[0](trial)
                error = self.errors(goals[k + 1], poses) - allowed
            controls[k + 1], q, y, v = controls[k] + step, trial, y + step, step / dt
            residual = error + allowed
        ends = (self.extrapolate(nearest, origin, dt)[None] for nearest in (controls[:3], controls[:-4:-1]))
        return np.concatenate([next(ends), controls, next(ends)])

    def _steering_step(
        self, q: Array, y: Array, poses: Sequence[Any], error: Array, preferred: Array, dt: float
    ) -> float:
        """Return by how much a car steers [rad]: toward the yaw rate that it would have without an axle."""
        drive: Any = self.drive
        J = drive.jacobian(self.jacobian(poses), drive.displace(q, y, 0 * y)[1], None)
        infinite = np.full(len(y), np.inf)
        step = self.correction(self.system(J, self._reach), error, preferred, -infinite, infinite)
        return float(drive.steering(step, dt, y[-1]) - y[-1])

    def allowed_error(self, residual: Array, dt: float) -> Array:
        """Return the part of remaining errors that a step may leave, shape (rows,), task by task.

        The approach has a speed of at most sqrt(a e), which requires half of the acceleration a. A faster
        approach could not brake in time.
        """
        parts = []
        for rows in self._rows:
            size = sqrt(residual[rows] @ residual[rows])
            rate = min(_CATCH_UP, sqrt(self._min_acceleration / size)) if size else _CATCH_UP
            parts.append(max(1 - rate * dt, 0.0) * residual[rows])
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def extrapolate(self, points: Array, origin: Array, dt: float) -> Array:
        """Return the control point beyond the end, shape (nv,), from the three nearest, shape (3, nv).

        The extrapolation continues their acceleration if it stays within the limits. Otherwise the
        extrapolation is linear; then the curve ends at the outermost of the three points and stays between
        them.
        """
        line = 2 * points[0] - points[1]
        curve = line + points[0] - 2 * points[1] + points[2]
        lower, upper = self.limits.room(origin)
        fits = (curve >= -lower) & (curve <= upper) & (np.abs(points[0] - curve) <= dt * self.limits.velocity)
        return np.asarray(np.where(fits, curve, line))


def check_configuration(robot: MobileRobot, name: str, value: ArrayLike) -> Array:
    """Return a checked configuration within limits, shape (nq,).

    Raises
    ------
    InvalidArgument
        If the value has another shape, is not finite, or is outside the limits.
    """
    q = shaped(name, finite(name, value), (robot.nq,))
    between(f"{name} has", [f"q[{k}]" for k in range(robot.nq)], q, robot.lower, robot.upper)
    return q
