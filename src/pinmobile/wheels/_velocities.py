"""Velocities of wheels that roll: independent ones, with references and linear models, and odometry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.controllers import Controller, State, answer_of, check_controller, told
from pinmobile.errors import InvalidArgument
from pinmobile.parts import child, integer, number as declared, part
from pinmobile.plant import Context, Input
from pinmobile.robot import Matrix, applied, number, scalars, slopes, vector_of as stacked
from pinmobile.signals import signals_of
from pinmobile.wheels._kinematics import Kinematics
from pinmobile.wheels._table import WheelTable

_BASE = 3
_LEAST_NORM = 1e-6  # relative weight of torques beside what they are for, where limits hold them
_OFF = 1e-6  # of the largest rate, beyond which wheels would slide sideways; of the largest force


def matrix(rows: Matrix, q: Any) -> Any:
    """Return rows of scalars at configurations q as an array."""
    return np.stack(np.broadcast_arrays(*(stacked(row, q) for row in rows)), axis=-2)


class Reduced(NamedTuple):
    """Rolling in independent velocities nu: M nu' + n = B u, v = S nu (Kane's equations).

    nu is, of a body that is free, its twist (forward, left, yaw rate); of one with one axle, the speed along
    the wheels at the axle and the yaw rate; of one with two axles, the speed at the fixed one, or, where both
    are steered, the number eta with twist = eta (a1 x a2) of the axles' rows. Rates of the arms and of
    steering axes that nothing else determines follow.

    Attributes
    ----------
    M, n, B : ndarray, shape (..., m, m), (..., m), (..., m, nu)
        Mass matrix, nonlinear effects and input matrix.
    S : ndarray, shape (..., nv, m)
        All velocities by the independent ones.
    nu : ndarray, shape (..., m)
        Those of the state.
    """

    M: Any
    n: Any
    B: Any
    S: Any
    nu: Any

    def torques(self, rates: Array) -> Array:
        """Return the input of least norm with which nu changes so, shape (..., nu) [N m].

        Parameters
        ----------
        rates : ndarray, shape (..., m)
            nu' [m/s^2, rad/s^2].
        """
        force = np.einsum("...ij,...j->...i", self.M, rates) + self.n
        return np.asarray(np.linalg.pinv(self.B) @ force[..., None])[..., 0]

    def nearest(self, force: Array, inputs: Sequence[Input]) -> Array:
        """Return the input within limits that comes nearest to a force, shape (nu,), of one state.

        Where limits allow it, it does what the force does, and has least norm; else what it misses is least
        in the metric of the inverse mass, by a quadratic program.

        Parameters
        ----------
        force : ndarray, shape (m,)
            On the independent velocities, S' tau.
        inputs : sequence of Input
            With their limits.
        """
        metric = np.linalg.inv(np.linalg.cholesky(self.M))
        B, right = metric @ self.B, metric @ force
        u = np.linalg.pinv(B) @ right
        lower, upper = (np.array([getattr(each, x) for each in inputs]) for x in ("lower", "upper"))
        if (u < lower).any() or (u > upper).any():
            from scipy.optimize import lsq_linear

            small = _LEAST_NORM * np.linalg.norm(B) * np.eye(len(u))
            wanted = np.append(right, np.zeros(len(u)))
            found = lsq_linear(np.vstack([B, small]), wanted, (lower, upper), tol=1e-14)
            u = np.clip(found.x, lower, upper)
        return np.asarray(u)


class Allocation(NamedTuple):
    """Torques for a force that is wanted on body and arms.

    Attributes
    ----------
    u : ndarray, shape (..., nu)
        The input [N m].
    residual : ndarray, shape (..., 3 + arms)
        What of the force wheels and joints do not supply: what is beyond their limits, and what no wheel
        can give, such as a force across the axle [N, N, N m, ...].
    """

    u: Array
    residual: Array


class ReferenceMotion(NamedTuple):
    """Wheels that roll along a reference.

    Attributes
    ----------
    q, v : ndarray, shape (N, nq), (N, nv)
        States, wheel angles zero.
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
    """Refuse wheels that steer, whose angles belong to the state."""
    if body.table.axes:
        raise InvalidArgument(
            f"robot steers wheels about {len(body.table.axes)} axes, whose angles no reference leads, "
            "expected wheels that do not steer, or Backstepping(law, robot)"
        )


def followed(body: Any, reference: Any, t: Array | None = None) -> ReferenceMotion:
    """Return how a body on wheels goes along a reference; arms that this leaves out rest.

    Parameters
    ----------
    body : WheeledDynamics
        What rolls.
    reference : Reference
        q, v and a, shape (N, ...).
    t : ndarray, shape (N,), optional
        Times [s], from which steering rates follow; without them no wheel may steer.

    Raises
    ------
    InvalidArgument
        If wheels steer or cannot roll so, or no input does it.
    """
    if t is None:
        check_steers_not(body)
    n, ns, (*lead, known) = body.of_body, len(body.table.axes), reference.q.shape
    if known > n:
        raise InvalidArgument(
            f"reference has {known} coordinates, expected those of body and arms, {n}: a motion of both is "
            "WholeBody(robot, base, *joints)"
        )
    q, v, a = (np.zeros((*lead, body.nv)) for _ in range(3))
    q[..., :known], v[..., :known], a[..., :known] = reference
    if known < n:
        q[..., known:n] = body.robot.rest[known:]
    turning = faster = np.zeros((*lead, ns))
    if t is not None and ns:
        twists = np.stack(np.broadcast_arrays(*map(number, body.state(q, v).twist)), -1).tolist()
        steered = np.array([[body.steered_to(axis, twist) for axis in body.table.axes] for twist in twists])
        q[:, n : n + ns] = steered
        if len(t) > 3:
            from scipy.interpolate import CubicSpline

            q[:, n : n + ns] = np.unwrap(steered, axis=0, period=np.pi)
            spline = CubicSpline(t, q[:, n : n + ns])
            turning, faster = spline(t, 1), spline(t, 2)
    v[..., n : n + ns] = turning
    nu = stacked(body.velocities(body.state(q, v)), q)
    rolls = _rolling(body, q, nu)
    off = np.abs(rolls - v)[..., :n].max(axis=-1)
    if (off > _OFF * (1 + np.abs(v).max())).any():
        k = int(np.argmax(off))
        when = f"its sample {k}" if t is None else f"{t[k]:.6g} s"
        raise InvalidArgument(
            f"reference moves the body by {off[k]:.3g} m/s, or rad/s, at {when} as its wheels cannot roll, "
            "expected one that they can follow, such as Tangent(path)"
        )
    state = body.state(q, rolls)
    own = nu.shape[-1] - body.na - len(body.choice.free)
    rates = body.offset(state, state.along(scalars(a)))[:own]
    rates = [*rates, *scalars(a)[_BASE:n], *(faster[..., k] for k in body.choice.free)]
    changes = stacked(rates, q)
    return ReferenceMotion(q, rolls, nu, changes, driving_inputs(body, q, rolls, changes))


def driving_inputs(body: Any, q: Array, v: Array, rates: Array) -> Array:
    """Return the inputs of least norm with which independent velocities change so, and refuse if none do."""
    own = body.reduced(q, v)
    u = own.torques(rates)
    needed = np.einsum("...ij,...j->...i", own.M, rates) + own.n
    missed = np.abs(np.einsum("...ij,...j->...i", own.B, u) - needed).max()
    if missed > _OFF * (1 + np.abs(needed).max()):
        raise InvalidArgument(
            f"reference needs a force of {missed:.3g} N, or N m, that no motor of the robot exerts, expected "
            "a drive with a motor for each degree of freedom, or a reference that needs none"
        )
    return np.asarray(u)


def _rolling(body: Any, q: Any, nu: Any) -> Any:
    """Return v of independent velocities, shape (..., nv)."""
    state = body.state(q, np.zeros((*q.shape[:-1], body.nv)))
    return body.in_plane(state, applied(body.null_space(state).S, scalars(nu)), q)


def linearized(body: Any, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
    """Return the first-order model of the tracked state, A and B, see `WheeledRobot.linearize_tracked`.

    Parameters
    ----------
    body : WheeledDynamics
        Whose wheels do not steer.
    q, v, u : ndarray, shape (..., nq), (..., nv), (..., nu)
        State, which rolls, and input.
    """
    check_steers_not(body)
    n = body.of_body
    q, v, u = (np.asarray(x, np.float64) for x in (q, v, u))
    lead = np.broadcast_shapes(q.shape[:-1], v.shape[:-1], u.shape[:-1])
    q, v, u = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v, u))
    nu = stacked(body.velocities(body.state(q, v)), q)
    m = nu.shape[-1]

    def rates(step: Array, q: Array, nu: Array, u: Array) -> Any:
        count = np.broadcast_shapes(step.shape[:-1], q.shape[:-1])
        moves = np.zeros((*count, body.nv), np.complex128)
        moves[..., :n] = step[..., :n]
        moved, velocities = body.integrate(q, moves), nu + step[..., n : n + m]
        rolls = _rolling(body, moved, velocities)
        own = body.reduced(moved, rolls)
        pushed = np.einsum("...ij,...j->...i", own.B, u + step[..., n + m :]) - own.n
        gained = np.linalg.solve(own.M, pushed[..., None])[..., 0]
        return np.concatenate([rolls[..., :n], gained], axis=-1)

    # Nothing follows from where the body is.
    found = slopes(rates, np.eye(n + m + u.shape[-1])[2:], q, nu, u)
    A = np.zeros((*lead, n + m, n + m))
    A[..., 2:] = found[..., : n + m - 2]
    return A, np.ascontiguousarray(found[..., n + m - 2 :])


@final
@part
class OdometryFeedback:
    """A controller that is told the pose that its wheels' encoders lead to, instead of the true one.

    It starts at the true pose. From sample to sample encoders tell how far each wheel has turned; the body's
    displacement is the one that fits all wheels best, tyres not moving sideways, by least squares of the
    table that it believes; along the heading half way. Velocities are displacements over the time between
    samples. Angles of arms and steering axes are known. What the table has wrong, wheels that slip and coarse
    encoders make the pose drift: the signal ``believed_pose``, beside the true one.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    table : WheelTable
        What it believes: the robot's wheels, by name, with numbers that may differ.
    ticks : float, optional
        Of an encoder per turn of its wheel, > 0; by default it is exact.
    noise : float
        Standard deviation of each wheel's measured rate, >= 0 [rad/s]; white.
    seed : int
        Of the noise.

    Raises
    ------
    InvalidArgument
        If an argument is something else, or the wheels do not tell how the body moves.
    """

    controller: Any = child(Controller)
    table: WheelTable = child(WheelTable, expected="a WheelTable")
    ticks: float | None = declared(
        default=None, above=0, optional=True, fixed=True, doc="ticks of an encoder per turn"
    )
    noise: float = declared(default=0.0, lower=0, unit="rad/s", doc="deviation of measured wheel rates")
    seed: int = integer(default=0, doc="seed of the noise")

    def check(self) -> None:
        """Raise `InvalidArgument` where rates of the wheels do not tell how the body moves."""
        check_controller(self.controller)
        self.table.mobility.check_odometry()

    @cached_property
    def _kinematics(self) -> Kinematics:
        return Kinematics.of(self.table)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the wrapped controller's state, the noise, the sampling time, and that nothing is known."""
        names = tuple(one.name for one in context.coordinates)[-len(self.table) :]
        if context.coordinates and names != self.table.names:
            own, plants = ", ".join(self.table.names), ", ".join(names)
            raise InvalidArgument(f"table has the wheels {own}, expected those of the plant: {plants}")
        joints = np.zeros(len(self.table.axes) + len(self.table))
        noise = context.noise(f"odometry {self.seed}", len(self.table))
        inner = self.controller.initial_state(context)
        return inner, noise, float(context.dt), (np.zeros(3), joints, 0.0)

    def applied(self, u: Array, state: Any) -> Any:
        """Return the state, with the wrapped controller told of the input that is applied, (..., nu)."""
        return told(self.controller, u, state[0]), *state[1:]

    def signals(self, state: Any) -> dict[str, Any]:
        """Return the pose that it believes, beside what the wrapped controller tells."""
        return {**signals_of(self.controller, state[0]), "believed_pose": ("m, rad", state[3][0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Any
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the input, shape (..., nu), and the next state."""
        inner, noise, dt, (pose, before, known) = state
        ns, nw = len(self.table.axes), len(self.table)
        n = ns + nw
        steering, wheels = q[..., -n : np.shape(q)[-1] - nw], q[..., -nw:]
        if self.ticks is not None:
            tick = 2 * np.pi / self.ticks
            wheels = tick * np.rint(wheels / tick)
        numbers, noise = noise.draw()
        now = np.concatenate([steering, wheels], axis=-1)
        begun = np.asarray(known)[..., None]
        pose, before = pose + (1.0 - begun) * q[..., :3], before + (1.0 - begun) * now
        turned = now - before
        disturbed = np.concatenate([0.0 * steering, self.noise * (numbers * dt)], axis=-1) + turned
        rates = begun * disturbed / dt + (1.0 - begun) * v[..., -n:]
        moved = self._displacement((now[..., :ns] + before[..., :ns]) / 2, begun * disturbed)
        pose = pose + _outward(pose[..., 2] + moved[..., 2] / 2, moved)
        speeds = _outward(pose[..., 2], self._displacement(steering, rates))
        seen_q = np.concatenate([pose, q[..., 3:-n], now], axis=-1)
        seen_v = np.concatenate([speeds, v[..., 3:-n], rates], axis=-1)
        u, inner = answer_of(self.controller, t, seen_q, seen_v, reference, inner)
        return u, (inner, noise, dt, (pose, now, 1.0 + 0.0 * known))

    def _displacement(self, steering: Any, joints: Any) -> Any:
        """Return the body's displacement, or twist, that fits those of its joints best, shape (..., 3)."""
        return stacked(self._kinematics.odometry(scalars(steering), scalars(joints)), joints)


def _outward(psi: Any, twist: Any) -> Any:
    """Return a displacement or twist of a body with a heading along the inertial axes, shape (..., 3)."""
    c, s = np.cos(psi), np.sin(psi)
    x, y = c * twist[..., 0] - s * twist[..., 1], s * twist[..., 0] + c * twist[..., 1]
    return np.stack([x, y, twist[..., 2]], axis=-1)
