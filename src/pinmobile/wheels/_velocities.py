"""Velocities of rolling wheels: independent velocities, references, linear models, and odometry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.controllers import Controller, State, check_controller, evaluate, notify_applied
from pinmobile.errors import InvalidArgument
from pinmobile.parts import child, integer, number as declared, part
from pinmobile.plant import Context, Input
from pinmobile.robot import applied, number, scalars, slopes, vector_of as stacked
from pinmobile.signals import signals_of
from pinmobile.wheels._kinematics import Kinematics
from pinmobile.wheels._table import WheelTable

_BASE = 3
_LEAST_NORM = 1e-6  # weight of the torques' norm relative to the residual, if limits are active
_SLIDING = 1e-6  # tolerance of sliding relative to the largest rate, and of forces to the largest


class Reduced(NamedTuple):
    """Dynamics of rolling in independent velocities nu: M dnu/dt + n = B u, v = S nu (Kane's equations).

    For an omnidirectional body, nu is its twist (forward, left, yaw rate). With one axle, it is the speed
    along the wheels at the axle and the yaw rate. With two axles, it is the speed at the fixed one, or, if
    both are steered, the number eta with twist = eta (a1 x a2) of the axles' rows. Rates of the arms, and of
    steering axes without a constraint, follow.

    Attributes
    ----------
    M, n, B : ndarray, shape (..., m, m), (..., m), (..., m, nu)
        Mass matrix, nonlinear effects and input matrix.
    S : ndarray, shape (..., nv, m)
        All velocities per independent velocity (null-space basis).
    nu : ndarray, shape (..., m)
        Independent velocities of the state.

    See Also
    --------
    WheeledRobot : its method `reduced`

    Examples
    --------
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> reduced = robot.reduced(robot.rest, 0 * robot.rest)
    >>> reduced.M.diagonal()  # speed [kg] and yaw rate [kg m^2]
    array([32.  ,  1.38])
    """

    M: Any
    n: Any
    B: Any
    S: Any
    nu: Any

    def torques(self, rates: Array) -> Array:
        """Return the input of least norm that produces these rates of nu, shape (..., nu) [N m].

        Parameters
        ----------
        rates : ndarray, shape (..., m)
            Rates of the independent velocities [m/s^2, rad/s^2].
        """
        force = np.einsum("...ij,...j->...i", self.M, rates) + self.n
        return np.asarray(np.linalg.pinv(self.B) @ force[..., None])[..., 0]

    def nearest(self, force: Array, inputs: Sequence[Input]) -> Array:
        """Return the input within limits with the effect nearest to that of a force, for one state, (nu,).

        If limits allow, its effect equals that of the force, with least norm. Otherwise a quadratic program
        minimises the residual in the metric of the inverse mass.

        Parameters
        ----------
        force : ndarray, shape (m,)
            Force on the independent velocities, S' tau.
        inputs : sequence of Input
            Inputs with their limits.
        """
        metric = np.linalg.inv(np.linalg.cholesky(self.M))
        B, right = metric @ self.B, metric @ force
        u = np.linalg.pinv(B) @ right
        lower, upper = (np.array([getattr(each, x) for each in inputs]) for x in ("lower", "upper"))
        if (u < lower).any() or (u > upper).any():
            from scipy.optimize import lsq_linear

            small = _LEAST_NORM * np.linalg.norm(B) * np.eye(len(u))
            target = np.append(right, np.zeros(len(u)))
            solution = lsq_linear(np.vstack([B, small]), target, (lower, upper), tol=1e-14)
            u = np.clip(solution.x, lower, upper)
        return np.asarray(u)


class Allocation(NamedTuple):
    """Torques of wheels and joints for a desired force on body and arms.

    Attributes
    ----------
    u : ndarray, shape (..., nu)
        Input [N m].
    residual : ndarray, shape (..., 3 + arms)
        Part of the force that wheels and joints do not exert, because it exceeds limits, or because no wheel
        can exert it, such as a force across the axle [N, N, N m, ...].

    See Also
    --------
    WheeledRobot : its method `allocate`
    ControlAllocation : wrapper of controllers

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> found = robot.allocate(robot.rest, [20.0, 5.0, 0.0])
    >>> found.u.round(9), found.residual.round(9) + 0.0  # [N m], [N]
    (array([1., 1.]), array([0., 5., 0.]))
    """

    u: Array
    residual: Array


class ReferenceMotion(NamedTuple):
    """Motion of rolling wheels along a reference.

    Attributes
    ----------
    q, v : ndarray, shape (N, nq), (N, nv)
        States, with wheel angles zero.
    nu, rates : ndarray, shape (N, m)
        Independent velocities, and their rates.
    u : ndarray, shape (N, nu)
        Inputs of least norm.
    """

    q: Array
    v: Array
    nu: Array
    rates: Array
    u: Array


def check_steers_not(body: Any) -> None:
    """Raise `InvalidArgument` if wheels steer, because their angles belong to the state."""
    if body.table.axes:
        raise InvalidArgument(
            f"robot steers wheels about {len(body.table.axes)} axes, expected 0, or Backstepping(law, robot)"
        )


def rolling_motion(body: Any, reference: Any, t: Array | None = None) -> ReferenceMotion:
    """Return the motion of a robot on wheels along a reference; arms without reference rest.

    Parameters
    ----------
    body : WheeledDynamics
        Dynamics of the robot.
    reference : Reference
        q, v and a, shape (N, ...).
    t : ndarray, shape (N,), optional
        Times [s], from which steering rates follow; without them no wheel may steer.

    Raises
    ------
    InvalidArgument
        If wheels steer, or wheels or motors cannot follow the reference.
    """
    if t is None:
        check_steers_not(body)
    n, ns, (*lead, count) = body.of_body, len(body.table.axes), reference.q.shape
    if count > n:
        raise InvalidArgument(
            f"reference has {count} coordinates, expected {n} at most, as of WholeBody(robot, base, *joints)"
        )
    q, v, a = (np.zeros((*lead, body.nv)) for _ in range(3))
    q[..., :count], v[..., :count], a[..., :count] = reference
    if count < n:
        q[..., count:n] = body.robot.rest[count:]
    turning = faster = np.zeros((*lead, ns))
    if t is not None and ns:
        twists = np.stack(np.broadcast_arrays(*map(number, body.state(q, v).twist)), -1).tolist()
        angles = np.array([[body.steered_to(axis, twist) for axis in body.table.axes] for twist in twists])
        q[:, n : n + ns] = angles
        if len(t) > 3:
            from scipy.interpolate import CubicSpline

            q[:, n : n + ns] = np.unwrap(angles, axis=0, period=np.pi)
            spline = CubicSpline(t, q[:, n : n + ns])
            turning, faster = spline(t, 1), spline(t, 2)
    v[..., n : n + ns] = turning
    nu = body.independent(q, v)
    rolls = _rolling(body, q, nu)
    slips = np.abs(rolls - v)[..., :n].max(axis=-1)
    if (slips > _SLIDING * (1 + np.abs(v).max())).any():
        k = int(np.argmax(slips))
        time = f"its sample {k}" if t is None else f"{t[k]:.6g} s"
        raise InvalidArgument(
            f"reference differs by {slips[k]:.3g} m/s, or rad/s, at {time} from any rolling motion, "
            "expected a motion that the wheels can follow, such as Tangent(path)"
        )
    state = body.state(q, rolls)
    size = nu.shape[-1] - body.na - len(body.choice.free)
    rates = body.offset(state, state.to_body(scalars(a)))[:size]
    rates = [*rates, *scalars(a)[_BASE:n], *(faster[..., k] for k in body.choice.free)]
    changes = stacked(rates, q)
    return ReferenceMotion(q, rolls, nu, changes, driving_inputs(body, q, rolls, changes))


def driving_inputs(body: Any, q: Array, v: Array, rates: Array) -> Array:
    """Return the inputs of least norm for given rates of nu; raise `InvalidArgument` if there are none."""
    reduced = body.reduced(q, v)
    u = reduced.torques(rates)
    needed = np.einsum("...ij,...j->...i", reduced.M, rates) + reduced.n
    error = np.abs(np.einsum("...ij,...j->...i", reduced.B, u) - needed).max()
    if error > _SLIDING * (1 + np.abs(needed).max()):
        raise InvalidArgument(
            f"reference needs a force of {error:.3g} N, or N m, that no motor exerts, expected another one"
        )
    return np.asarray(u)


def _rolling(body: Any, q: Any, nu: Any) -> Any:
    """Return v for independent velocities, shape (..., nv)."""
    state = body.state(q, np.zeros((*q.shape[:-1], body.nv)))
    return body.in_plane(state, applied(body.null_space(state).S, scalars(nu)), q)


def tracked_slopes(body: Any, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
    """Return the linear model of the tracked state, A and B, see `WheeledRobot.linearize_tracked`.

    Parameters
    ----------
    body : WheeledDynamics
        Dynamics of a robot without steered wheels.
    q, v, u : ndarray, shape (..., nq), (..., nv), (..., nu)
        Rolling state, and input.
    """
    check_steers_not(body)
    nu = body.independent(q, v)
    n, m = body.of_body, nu.shape[-1]

    def rates(step: Array, q: Array, nu: Array, u: Array) -> Any:
        count = np.broadcast_shapes(step.shape[:-1], q.shape[:-1])
        moves = np.zeros((*count, body.nv), np.complex128)
        moves[..., :n] = step[..., :n]
        new_q, velocities = body.integrate(q, moves), nu + step[..., n : n + m]
        rolls = _rolling(body, new_q, velocities)
        reduced = body.reduced(new_q, rolls)
        force = np.einsum("...ij,...j->...i", reduced.B, u + step[..., n + m :]) - reduced.n
        nu_rate = np.linalg.solve(reduced.M, force[..., None])[..., 0]
        return np.concatenate([rolls[..., :n], nu_rate], axis=-1)

    # Nothing depends on the position of the body.
    derivative = slopes(rates, np.eye(n + m + body.nu)[2:], q, nu, u)
    A = np.zeros((*derivative.shape[:-2], n + m, n + m))
    A[..., 2:] = derivative[..., : n + m - 2]
    return A, np.ascontiguousarray(derivative[..., n + m - 2 :])


@final
@part
class OdometryFeedback:
    """Wrapper that replaces the measured pose with the pose of wheel odometry.

    It starts at the true pose. Encoders measure the rotation of each wheel between samples. The displacement
    of the body is the least-squares fit of all wheels, without lateral motion of tyres, by the wheel table of
    the wrapper; it is applied along the mean heading of the sample. Velocities are displacements divided by
    the time step. Angles of arms and steering axes are measured. Wrong numbers in the table, slip and coarse
    encoders make the pose drift. The signal ``believed_pose`` records the estimate beside the true pose.

    Parameters
    ----------
    controller : controller
        Wrapped controller.
    table : WheelTable
        Assumed wheels: those of the robot by name, with numbers that may differ.
    ticks : float, optional
        Encoder ticks per turn of a wheel, > 0; default: exact angles.
    noise : float
        Standard deviation of each wheel's measured rate, >= 0 [rad/s]; white.
    seed : int
        Seed of the noise.

    Raises
    ------
    InvalidArgument
        If an argument is of another kind or out of range, or the wheels do not determine the body's motion;
        at the start of a run, if the table has other wheels than the plant.

    See Also
    --------
    MeasurementNoise : noise of the measured state
    WheeledRobot : its method `odometry`

    Examples
    --------
    >>> from pinmobile import Backstepping, Circle, MobileRobot
    >>> from pinmobile import Tangent, UnicycleTracking, WheeledRobot
    >>> from pinmobile import WheelTable, simulate
    >>> from pinmobile.wheels import OdometryFeedback
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> worn = WheelTable.differential(0.4, 0.099, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> law = Backstepping(UnicycleTracking(), robot)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> law = OdometryFeedback(law, worn)
    >>> run = simulate(robot, law, path, dt=0.1)
    >>> print(f"{1e3 * run.max_error()[0]:.0f} mm of 0.6 m")
    6 mm of 0.6 m
    """

    controller: Any = child(Controller)
    table: WheelTable = child(WheelTable, expected="a WheelTable")
    ticks: float | None = declared(
        default=None, above=0, optional=True, fixed=True, doc="encoder ticks per turn of a wheel"
    )
    noise: float = declared(default=0.0, lower=0, unit="rad/s", doc="standard deviation of wheel rates")
    seed: int = integer(default=0, doc="seed of the noise")

    def check(self) -> None:
        """Raise `InvalidArgument` if the wheels do not determine the body's motion."""
        check_controller(self.controller)
        self.table.mobility.check_odometry()

    @cached_property
    def _kinematics(self) -> Kinematics:
        """Rolling constraints of the assumed wheels."""
        return Kinematics.of(self.table)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the wrapped controller's state, the noise, the time step, and the odometry's memory."""
        names = tuple(axis.name for axis in context.coordinates)[-len(self.table) :]
        if context.coordinates and names != self.table.names:
            wheels, plants = ", ".join(self.table.names), ", ".join(names)
            raise InvalidArgument(f"table has the wheels {wheels}, expected those of the plant: {plants}")
        joints = np.zeros(len(self.table.axes) + len(self.table))
        noise = context.noise(f"odometry {self.seed}", len(self.table))
        inner = self.controller.initial_state(context)
        return inner, noise, float(context.dt), (np.zeros(3), joints, 0.0)

    def applied(self, u: Array, state: Any) -> Any:
        """Return the next state, with the applied input passed on, shape (..., nu)."""
        return notify_applied(self.controller, u, state[0]), *state[1:]

    def signals(self, state: Any) -> dict[str, Any]:
        """Return the estimated pose [m, rad] beside the signals of the wrapped controller."""
        return {**signals_of(self.controller, state[0]), "believed_pose": ("m, rad", state[3][0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Any
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the input, shape (..., nu), and the next state."""
        inner, noise, dt, (pose, angles, known) = state
        ns, nw = len(self.table.axes), len(self.table)
        n = ns + nw
        steering, wheels = q[..., -n : np.shape(q)[-1] - nw], q[..., -nw:]
        if self.ticks is not None:
            tick = 2 * np.pi / self.ticks
            wheels = tick * np.rint(wheels / tick)
        numbers, noise = noise.draw()
        joints = np.concatenate([steering, wheels], axis=-1)
        started = np.asarray(known)[..., None]
        pose, angles = pose + (1.0 - started) * q[..., :3], angles + (1.0 - started) * joints
        turns = joints - angles
        noisy = np.concatenate([0.0 * steering, self.noise * (numbers * dt)], axis=-1) + turns
        rates = started * noisy / dt + (1.0 - started) * v[..., -n:]
        motion = self._displacement((joints[..., :ns] + angles[..., :ns]) / 2, started * noisy)
        pose = pose + _outward(pose[..., 2] + motion[..., 2] / 2, motion)
        speeds = _outward(pose[..., 2], self._displacement(steering, rates))
        seen_q = np.concatenate([pose, q[..., 3:-n], joints], axis=-1)
        seen_v = np.concatenate([speeds, v[..., 3:-n], rates], axis=-1)
        u, inner = evaluate(self.controller, t, seen_q, seen_v, reference, inner)
        return u, (inner, noise, dt, (pose, joints, 1.0 + 0.0 * known))

    def _displacement(self, steering: Any, joints: Any) -> Any:
        """Return the least-squares displacement, or twist, of the body, shape (..., 3)."""
        return stacked(self._kinematics.odometry(scalars(steering), scalars(joints)), joints)


def _outward(psi: Any, twist: Any) -> Any:
    """Return a displacement or twist along the inertial axes, from the body's axes, shape (..., 3)."""
    c, s = np.cos(psi), np.sin(psi)
    x, y = c * twist[..., 0] - s * twist[..., 1], s * twist[..., 0] + c * twist[..., 1]
    return np.stack([x, y, twist[..., 2]], axis=-1)
