"""Trajectories of base and arm along which an end effector follows poses, within joint limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, final, runtime_checkable
from warnings import warn

import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    absent,
    bounded,
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
from pinmobile.plant import Context, Event, check_coordinates, limit_events
from pinmobile.proximity import Clearance, clearance as clearance_of
from pinmobile.reaching.drive import Drive
from pinmobile.reaching.poses import FrameTask, PosePath, error_sizes, pose_error
from pinmobile.reaching.solver import (
    Limits,
    Solver,
    bounded_least_squares,
    check_configuration,
    per_coordinate,
)
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Reference

_DEGREE, _POSITION = 3, 3


@dataclass(frozen=True, eq=False, repr=False)
class InverseKinematicsTrajectory:
    """Trajectory of all coordinates that `solve_inverse_kinematics` returns: a uniform cubic B-spline.

    q is twice continuously differentiable, with derivatives v and a. q, v and a are averages of the control
    points, of their first and of their second differences (de Boor, "A practical guide to splines", 1978).
    Bounds on the control points and differences therefore hold at all times, not only at samples. For a robot
    on wheels, the spline is that of the integrals of the drive's independent velocities; x, y and psi follow
    by quadrature, so that the wheels roll at all times.

    Attributes
    ----------
    robot : MobileRobot
        Robot whose coordinates the trajectory describes: body and arms.
    tasks : tuple of FrameTask
        Tasks, the first of which gives `target`, `frame` and `error`.
    start : ndarray, shape (nq,)
        Configuration at the first control point [m, m, rad, ...].
    controls : ndarray, shape (N + 3, nv)
        Displacements of the control points from `start`, evenly spaced in time, with one point beyond each
        end.
    drive : object or None
        Independent velocities of the wheels, whose integrals `controls` then holds; None: the base moves in
        every direction.

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
    tasks: tuple[FrameTask, ...]
    start: Array
    controls: Array
    drive: Drive | None = None

    def __post_init__(self) -> None:
        for name in ("start", "controls"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @cached_property
    def _curve(self) -> Any:
        # Imported here: scipy loads slowly, and `EndEffectorTracking` does not need it.
        from scipy.interpolate import BSpline

        steps = np.arange(len(self.controls) + _DEGREE + 1.0) - _DEGREE
        return BSpline(self._dt * steps, self.controls, _DEGREE)

    def __repr__(self) -> str:
        metres, radians = self.max_error()
        turn = f", {radians:.3e} rad" if self.target.rows == 6 else ""
        try:
            clearance = f", smallest clearance {self.clearance.summary}"
        except PinmobileError:  # without collision geometry, the clearance is unknown
            clearance = ""
        motion = f"{self.frame} over {self.duration:g} s"
        return f"<InverseKinematicsTrajectory: {motion}, largest error {metres:.3e} m{turn}{clearance}>"

    @property
    def target(self) -> PosePath:
        """Target poses of the first task."""
        return self.tasks[0].target

    @property
    def frame(self) -> str:
        """Name of the frame that follows the target."""
        return str(self.tasks[0].frame)

    @property
    def duration(self) -> float:
        """Duration of the target [s]."""
        return self.target.duration

    @property
    def _dt(self) -> float:
        return self.duration / (len(self.controls) - _DEGREE)

    @cached_property
    def _poses(self) -> Array:
        """Pose x, y and psi of a robot on wheels at the knots, shape (N + 1, 3)."""
        drive: Any = self.drive
        return frozen(drive.poses(self.start, self.controls, self._dt))

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
        if self.drive is not None:
            k = np.clip(np.floor_divide(times, self._dt), 0, len(self._poses) - 2).astype(int)
            offset = times - self._dt * k
            q, v, a = self.drive.reference(self._poses[k], offset, self._curve, times, self.start)
        else:
            displacement, v, a = (self._curve(times, order) for order in range(3))
            q = self.robot.integrate(self.start, displacement)
        # Rounding may exceed a limit.
        return Reference(np.clip(q, self.robot.lower, self.robot.upper), v, a)

    def signals_at(self, t: Array) -> dict[str, tuple[str, Array]]:
        """Return the target of the frame at the samples of a run, see `PosePath.target_signals`.

        Parameters
        ----------
        t : ndarray, shape (N + 1,)
            Times [s].
        """
        return self.tasks[0].signals(t)

    @cached_property
    def error(self) -> Array:
        """Pose errors at the times `t`, shape (N + 1, 6) [m, rad], along the inertial axes, see `pose_error`.

        The last three columns hold the rotation vector, of an axis that from its direction to the target's.
        Entries that the first task leaves free are NaN.
        """
        return frozen(self.error_of(0))

    def error_of(self, task: int) -> Array:
        """Return the errors of a task at the times `t`, as in `error`, shape (N + 1, 6) [m, rad].

        Parameters
        ----------
        task : int
            Number of the task, in the order of `tasks`.
        """
        entry, rows = self.tasks[task], np.full((len(self.t), 6), np.nan)
        goal, actual = entry.target(self.t).pose, self.robot.frame_pose(self(self.t).q, entry.frame)
        rows[:, :_POSITION] = goal[:, :3, 3] - actual[:, :3, 3]
        if entry.rows.stop > _POSITION:
            pairs = zip(goal[:, :3, :3], actual[:, :3, :3], strict=True)
            rows[:, _POSITION:] = [entry.turn(a, b) for a, b in pairs]
        rows[:, : entry.rows.start] = np.nan
        return rows

    @cached_property
    def clearance(self) -> Clearance:
        """Distances between the robot's links, and between links and ground, at the times `t`.

        Raises
        ------
        InvalidArgument
            If the robot has no collision geometry.
        """
        robot, q, _ = self._states(self(self.t))
        return clearance_of(robot, q)

    def _states(self, motion: Reference) -> tuple[Any, Array, Array]:
        """Return the robot with its wheels, and q and v at the times `t`, where wheels do not spin."""
        if self.drive is None:
            return self.robot, motion.q, motion.v
        wheeled, n = self.drive.wheeled, len(self.t)
        q, v = (np.hstack([x, np.zeros((n, wheeled.nv - x.shape[1]))]) for x in (motion.q, motion.v))
        if self.drive.is_car:
            q[:, wheeled.of_body] = self._curve(self.t)[:, -1]
        return wheeled, q, v

    @property
    def _events(self) -> tuple[Event, ...]:
        """Limits of position, speed, force and torque of the arms that the trajectory exceeds."""
        motion = self(self.t)
        robot, q, v = self._states(motion)
        M, n = robot.mass_matrix(q), robot.nonlinear_effects(q, v)
        size = motion.v.shape[1]
        u = np.einsum("kij,kj->ki", M[:, :size, :size], motion.a) + n[:, :size]
        return limit_events(self.robot, self.t, motion.q, motion.v, u)

    def max_error(self) -> tuple[float, float]:
        """Return the largest distance [m] and the largest angle [rad] from frame to target, see `error`."""
        distance, angle = error_sizes(self.error).max(axis=0)
        return float(distance), float(angle)


_MAX_STEPS = 1_000_000  # more would take hours


def solve_inverse_kinematics(
    robot: MobileRobot | Wheeled,
    target: PosePath | FrameTask | Sequence[PosePath | FrameTask],
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
    """Return a trajectory of base and arm along which frames follow target poses.

    The solver is damped least squares within bounds (Nakamura and Hanafusa, 1986). In each step, it minimises
    the weighted errors of the next poses over all displacements within limits. Among nearly optimal
    displacements, it prefers motion toward the posture. It then iterates until the poses are reached. At a
    singular configuration or a limit, an error remains.

    The base of a `MobileRobot` may move in any direction; use `ComputedTorque` to track the trajectory. A
    `WheeledRobot` moves by the independent velocities of its drive: of an omnidirectional drive, forward,
    left and yaw rate; of one with a fixed axle, speed and yaw rate; of a car, speed. The rates of the arms
    follow, and of a car the steering rate. Arrays of shape (m,) have this order. A car steers toward the
    curvature that the tasks would give a drive that turns on the spot, and starts with its wheels straight.
    Use `Backstepping` to track a trajectory of a drive with a fixed axle.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        Robot with or without arms. Wheels are an omnidirectional drive without steering, one fixed axle, or
        those of a car.
    target : PosePath, FrameTask or sequence of them
        Target poses, or target positions; or several tasks of one duration, with weights. The first task is
        that of `tolerance` and of the signals of a run.
    frame : str, optional
        Frame that follows the target, one of ``robot.frame_names``; by default, ``robot.end_effector``. A
        `FrameTask` has its own.
    q0 : array_like, shape (nq,), optional
        Initial guess for the start [m, m, rad, ...]; by default, ``robot.rest`` and then other
        configurations.
    posture : array_like, shape (nq - 3,), optional
        Preferred configuration of the arms in the directions that the targets leave free [rad or m]; by
        default, the configuration at the start.
    dt : float
        Largest time between control points [s]. The error is about a dt^2 / 6 for a frame with acceleration
        a.
    posture_gain : float
        Rate of convergence toward the posture [1/s], >= 0. This motion continues where the targets rest,
        so the trajectory ends at rest only for 0.
    cost : array_like, shape () or (nv,) or (m,)
        Relative cost of each coordinate's motion, > 0. A coordinate with a high cost moves little.
    velocity_limit : array_like, shape () or (nv,) or (m,), optional
        Limit of the absolute velocities [m/s, m/s, rad/s, ...]; by default, the robot's limits. inf means no
        limit; zero locks a coordinate.
    acceleration_limit : array_like, shape () or (nv,) or (m,)
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
        If an argument is not what is expected, a joint has several velocities, or the wheels are those of
        another drive.
    UnknownName
        If the robot has no such frame.
    Unreachable
        If an error exceeds its tolerance, or a distance is below `clearance`. The message names the time, the
        target's position, and the limit that holds the robot back. The attribute ``resolved`` of the error
        holds the trajectory.

    Warns
    -----
    LimitWarning
        If the trajectory needs more force or torque than the robot's ``effort_limit``.

    See Also
    --------
    EndEffectorTracking : controller that follows a pose without a plan
    FrameTask : one of several tasks
    PosePath : target poses
    clearance : distances between links

    Examples
    --------
    >>> from pinmobile import Line, MobileRobot, PosePath
    >>> from pinmobile import (WheeledRobot, WheelTable,
    ...                        solve_inverse_kinematics)
    >>> robot = MobileRobot.box(mass=60.0).mount("ur5")
    >>> tool = robot.frame_pose(robot.rest)[:3, 3]
    >>> target = PosePath(Line(tool, tool + [0.5, 0.0, 0.0], 4.0))
    >>> plan = solve_inverse_kinematics(robot, target, dt=0.1)
    >>> plan.max_error()[0] < 1e-5  # [m]
    True

    On two wheels, the base turns to the side to which the tool goes:

    >>> axle = WheelTable.differential(0.5, 0.1, spin_inertia=0.01)
    >>> aside = PosePath(Line(tool, tool + [0.0, 1.0, 0.0], 4.0))
    >>> rolling = WheeledRobot(robot, axle)
    >>> plan = solve_inverse_kinematics(rolling, aside, dt=0.1)
    >>> print(f"{plan(4.0).q[2]:.1f} rad")
    0.9 rad
    """
    drive = None
    if isinstance(robot, MobileRobot):
        body = robot
    else:
        drive, body = Drive(instance("robot", robot, Wheeled, _ROBOT_TYPES)), robot.robot
    min_distance = None if clearance is None else non_negative("clearance", clearance, "m")
    if min_distance is not None:
        _ = body.solids  # raises before the computation, not after it
    tasks = _check_tasks(body, target, frame)
    model: Any = body if drive is None else drive
    lower, upper = (np.array([getattr(one, end) for one in model.coordinates]) for end in ("lower", "upper"))
    speed = model.velocity_limit if velocity_limit is None else velocity_limit
    speed = per_coordinate("velocity_limit", speed, len(lower), zero=True)
    limits = Limits(lower, upper, speed, per_coordinate("acceleration_limit", acceleration_limit, len(lower)))
    weights = positive("damping", damping) * per_coordinate("cost", cost, len(lower))
    tolerance = positive_or_endless("tolerance", tolerance)  # infinite accepts any error
    solver = Solver(body, tasks, limits, weights, drive)
    start = solver.start(q0)
    preferred = start if posture is None else _check_posture(body, posture)
    gain = bounded("posture_gain", non_negative("posture_gain", posture_gain, "1/s"), most=1e6, unit="1/s")
    duration = tasks[0].target.duration
    step = bounded("dt", positive("dt", dt, "s"), least=duration / _MAX_STEPS, most=duration, unit="s")
    count = max(int(np.ceil(duration / step - 1e-9)), 2)
    controls = solver.steps(start, preferred, gain, count)
    trajectory = InverseKinematicsTrajectory(body, tasks, start, controls, drive)
    _check_errors(trajectory, limits, tolerance, min_distance)
    if events := trajectory._events:
        warn("; ".join(map(str, events)), LimitWarning, stacklevel=2)
    return trajectory


_ROBOT_TYPES = "a MobileRobot or a WheeledRobot"


def _check_tasks(robot: MobileRobot, target: object, frame: str | None) -> tuple[FrameTask, ...]:
    """Return the tasks of targets, with the names of their frames.

    Raises
    ------
    InvalidArgument
        If the targets are others, or have different durations.
    UnknownName
        If the robot has no such frame.
    """
    words = "a PosePath, a FrameTask or a sequence of them"
    given = target if isinstance(target, list | tuple) and target else [target]
    tasks = []
    for k, each in enumerate(given):
        task = FrameTask(each, frame if k == 0 else None) if isinstance(each, PosePath) else each
        instance("target" if task is target else f"target[{k}]", task, FrameTask, words)
        if task is each:
            absent("with a FrameTask: write FrameTask(target, frame)", frame=frame)
        tasks.append(replace(task, frame=robot.frame_name(task.frame)))
    longest, shortest = (pick(one.target.duration for one in tasks) for pick in (max, min))
    if longest > shortest * (1 + 1e-9):
        raise InvalidArgument(f"targets last {shortest:g} to {longest:g} s, expected the same duration")
    return tuple(tasks)


def _check_posture(robot: MobileRobot, posture: ArrayLike) -> Array:
    """Return a configuration with the arms in a given posture, shape (nq,).

    Raises
    ------
    InvalidArgument
        If the posture has another shape or is not finite.
    """
    arms = shaped("posture", finite("posture", posture), (robot.nq - 3,), words=", the arms' part of q")
    return check_configuration(robot, "posture", np.concatenate([np.zeros(3), arms]))


def _check_errors(
    trajectory: InverseKinematicsTrajectory, limits: Limits, tolerance: float, min_distance: float | None
) -> None:
    """Raise `Unreachable` if a trajectory misses a target or links are too close to each other."""
    t = trajectory.t
    for number, task in enumerate(trajectory.tasks):
        allowed = task.tolerance if number else min(task.tolerance, tolerance)
        sizes = error_sizes(np.nan_to_num(trajectory.error_of(number)))
        exceeds = sizes.max(axis=-1) > allowed
        if exceeds.any():
            k, largest = int(np.argmax(exceeds)), sizes.max(axis=0)
            distance, angle = sizes[k]
            x, y, z = task.target(t[k]).pose[:3, 3]
            owner = f"target of {task.frame}" if len(trajectory.tasks) > 1 else "target"
            raise Unreachable(
                f"{owner} is missed by {distance:.3g} m and {angle:.3g} rad at t = {t[k]:g} s, expected at "
                f"most {allowed:g}; the largest errors are {largest[0]:.3g} m and {largest[1]:.3g} rad; the "
                f"target is at ({x:.4g}, {y:.4g}, {z:.4g}) m, {_limit_at(trajectory, limits, k)}",
                time=float(t[k]),
                resolved=trajectory,
            )
    if min_distance is not None and trajectory.clearance.smallest < min_distance:
        clearance = trajectory.clearance
        k = int(np.argmax(clearance.distance < min_distance))
        a, b = clearance.pairs[int(clearance.distances[k].argmin())]
        raise Unreachable(
            f"clearance is {clearance.distance[k]:.3g} m between {a} and {b} at t = {t[k]:g} s, "
            f"expected at least {min_distance:g} m; the smallest is {clearance.summary}",
            time=float(t[k]),
            resolved=trajectory,
        )


def _limit_at(trajectory: InverseKinematicsTrajectory, limits: Limits, k: int) -> str:
    """Return which limit holds a coordinate back at a sample, or at the last one before, in words."""
    drive, dt, start = trajectory.drive, trajectory._dt, trajectory.start
    names = (trajectory.robot if drive is None else drive).coordinates
    positions = (start if drive is None else drive.origin(start)) + trajectory.controls
    rates, tolerance = np.diff(trajectory.controls, axis=0) / dt, 1e-6 * limits.acceleration * dt
    for i in range(k, 0, -1):
        rate, stop = rates[i], limits.velocities(positions[i], dt)
        is_limited = np.abs(limits.velocities(positions[i], dt, rates[i - 1]) - rate).min(axis=0) <= tolerance
        for n in np.flatnonzero(is_limited & (limits.velocity > 0)):
            name, unit = names[n][:2]
            limit = f"acceleration limit, {limits.acceleration[n]:.4g} {unit}/s^2"
            if limits.velocity[n] - abs(rate[n]) <= tolerance[n]:
                limit = f"speed limit, {limits.velocity[n]:.4g} {unit}/s"
            elif np.abs(stop[:, n] - rate[n]).min() <= tolerance[n]:
                place, ends = positions[i, n], np.array([limits.lower[n], limits.upper[n]])
                limit = f"position limit, {ends[np.abs(ends - place).argmin()]:.4g} {unit}"
            event = f"where {name} reaches its {limit}, at t = {trajectory.t[i]:g} s"
            return f"{event}, or it is out of reach"
    return "and no limit is reached before: it is out of reach, or the targets contradict each other"


_GAINS = ("kp", "kd", "posture_kp", "posture_kd")
_OF_BASE_AND_ARMS = (
    ", of base and arms, such as a trajectory by solve_inverse_kinematics(robot, target) or "
    "WholeBody(robot, base, *joints)"
)
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
        values = {name: non_negative(name, getattr(self, name)) for name in _GAINS}
        values |= {name: positive(name, getattr(self, name)) for name in ("damping", "dt")}
        check_integrator(self.integrator)
        nv = body.nv
        speed = body.velocity_limit if self.velocity_limit is None else self.velocity_limit
        speed = per_coordinate("velocity_limit", speed, nv, zero=True)
        acceleration = per_coordinate("acceleration_limit", self.acceleration_limit, nv)
        fixed = {"frame": body.frame_name(self.frame), "velocity_limit": speed, "_body": body}
        limits = Limits(body.lower, body.upper, speed, acceleration)
        # The bounds of `ramps` are exact if the integrator keeps the initial acceleration over a step.
        same = [getattr(self.integrator, name, ()) for name in ("weights_q", "weights_v")] == [(0.5,), (1.0,)]
        is_exact = same and not able(self.robot, Constrained)
        object.__setattr__(self, "_corrections", 0 if is_exact else _CORRECTIONS)
        for name, value in {**values, **fixed, "acceleration_limit": acceleration, "_limits": limits}.items():
            object.__setattr__(self, name, value)

    def initial_state(self, context: Context) -> None:
        """Return None: the controller has no memory."""

    def signals_at(self, t: Array) -> dict[str, tuple[str, Array]]:
        """Return the target of the frame at the samples of a run, see `PosePath.target_signals`.

        Parameters
        ----------
        t : ndarray, shape (N + 1,)
            Times [s].
        """
        return self.target.target_signals(str(self.frame), t)

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
        check_coordinates(reference.v, body.nv, _OF_BASE_AND_ARMS)
        body_q, body_v = q[: body.nq], v[: body.nv]
        target = self.target(t)
        J = body.frame_jacobian(body_q, self.frame)
        error = pose_error(target.pose, body.frame_pose(body_q, self.frame))
        desired = target.rate + self.kd * (target.twist - J @ body_v) + self.kp * error
        desired -= body.frame_bias_acceleration(body_q, body_v, self.frame)
        posture = reference.a + self.posture_kd * (reference.v - body_v)
        posture = posture + self.posture_kp * body.difference(body_q, reference.q)
        A = np.vstack([J[:rows], self.damping * np.eye(body.nv)])
        b = np.concatenate([desired[:rows], self.damping * posture])
        lower, upper = self._limits.ramps(body_q, body_v, self.dt)
        a = bounded_least_squares(A, b, lower, upper)
        u = self.robot.inverse_dynamics(q, v, a)
        for _ in range(self._corrections):
            low, high = self._limits.excess(*self._next_state(q, v, u), self.dt)
            if not (low.any() or high.any()):
                break
            # A bound that moves past the other one (as for a locked coordinate) moves both.
            up, down = np.where(low > 0, a + low, -np.inf), np.where(high > 0, a - high, np.inf)
            lower, upper = np.clip(lower, up, down), np.clip(upper, up, down)
            a = bounded_least_squares(A, b, lower, upper)
            u = self.robot.inverse_dynamics(q, v, a)
        return a, u

    def _next_state(self, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
        """Return the state of body and arms after a step with a constant input, by model and integrator."""
        robot, body = self.robot, self._body

        def acceleration(t: float, displacement: Array, w: Array) -> Array:
            return robot.forward_dynamics(robot.integrate(q, displacement), w, u)

        displacement, w = self.integrator(acceleration, 0.0, np.zeros(robot.nv), v, self.dt)
        end = robot.integrate(q, displacement)
        if rolls := able(robot, Constrained):
            w = rolls.project(end, w)
        return end[: body.nq], w[: body.nv]
