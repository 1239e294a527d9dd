"""`Freedom`: what a body on wheels is free to do where these roll, in independent velocities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.plant import Input
from pinmobile.robot import (
    ZERO,
    Matrix,
    Vector,
    applied,
    cross,
    dot,
    exact,
    number,
    scalars,
    slopes,
    solved,
    transposed,
    vector_of as stacked,
)
from pinmobile.wheels._kinematics import Row, Solution, solved as rolled

_BASE = 3
_LEAST_NORM = 1e-6  # relative weight of torques beside what they are for, where limits hold them
_OFF = 1e-6  # of the largest rate, beyond which wheels would slide sideways; of the largest force


class State(NamedTuple):
    """A state, seen from the body.

    Attributes
    ----------
    c, s : scalar
        Of the heading.
    arms, steering : list of scalars
        Configuration of the arms, and steering angles.
    twist, arm_rates, rates : list of scalars
        Body twist; rates of the arms; of steering coordinates and wheels.
    """

    c: Any
    s: Any
    arms: Vector
    steering: Vector
    twist: Vector
    arm_rates: Vector
    rates: Vector

    def along(self, x: Vector) -> Vector:
        """Return numbers along the inertial axes along those of the body."""
        return [self.c * x[0] + self.s * x[1], self.c * x[1] - self.s * x[0], *x[2:]]

    def outward(self, x: Vector) -> Vector:
        """Return numbers along the body's axes along the inertial ones."""
        return [self.c * x[0] - self.s * x[1], self.s * x[0] + self.c * x[1], *x[2:]]

    @property
    def velocities(self) -> Vector:
        """All velocities, along the body's axes."""
        return [*self.twist, *self.arm_rates, *self.rates]

    def moving(self, v: Vector) -> State:
        """Return the state with other velocities."""
        end = _BASE + len(self.arms)
        return self._replace(twist=v[:_BASE], arm_rates=v[_BASE:end], rates=v[end:])


@final
@dataclass(frozen=True, eq=False)
class Freedom:
    """The independent velocities nu of a body on wheels, v = S nu: see `Reduced`.

    Parameters
    ----------
    body : WheeledDynamics
        Whose they are.
    """

    body: Any

    def solution(self, state: State) -> Solution:
        """Return what rolls, arms between body and joints."""
        rows = self.body.kinematics.rows(state.steering, state.twist, state.rates)
        choice = self.body.choice
        S, gamma = rolled(rows, choice)
        width, na = len(S[0]), self.body.na
        own = _BASE if not choice.body else _BASE - len(choice.body)
        wide = [[*row[:own], *[ZERO] * na, *row[own:]] for row in S]
        arms: Matrix = [[ZERO] * (width + na) for _ in range(na)]
        for i in range(na):
            arms[i][own + i] = exact(1.0)
        return Solution([*wide[:_BASE], *arms, *wide[_BASE:]], [*gamma[:_BASE], *[ZERO] * na, *gamma[_BASE:]])

    def velocities(self, state: State) -> Vector:
        """Return the independent velocities nu of a state that rolls, in the order of the columns of S."""
        held = [
            self.body.kinematics.rows(state.steering, state.twist, state.rates)[i]
            for i in self.body.choice.body
        ]
        a, w = held[0].base if held else [], state.twist[2]
        if not held:
            body = state.twist
        elif len(held) == 1 or self.body.choice.is_fixed:
            speed = a[1] * state.twist[0] - a[0] * state.twist[1]
            body = [speed, w] if len(held) == 1 else [speed]
        else:
            about = cross(a, held[1].base)
            body = [dot(about, state.twist) / dot(about, about)]
        return [*body, *state.arm_rates, *(state.rates[k] for k in self.body.choice.free)]

    def unmoved(self, state: State, S: Matrix, gamma: Vector) -> Vector:
        """Return the accelerations, along the body's axes, where the independent velocities do not change."""
        offset = self.offset(state, gamma)
        return [g - dot(row, offset) for row, g in zip(S, gamma, strict=True)]

    def offset(self, state: State, gamma: Vector) -> Vector:
        """Return the rates of the independent velocities where the accelerations are gamma."""
        vx, vy, w = state.twist
        moved = [gamma[0] + w * vy, gamma[1] - w * vx, gamma[2]]  # the rate of the body twist
        rows = self.body.kinematics.rows(state.steering, state.twist, state.rates)
        held = [(rows[i].base, self._turned(rows[i], state)) for i in self.body.choice.body]
        if not held:
            body = moved
        elif len(held) == 1 or self.body.choice.is_fixed:
            a, a_dot = held[0]
            first = a[1] * moved[0] - a[0] * moved[1] + a_dot[1] * vx - a_dot[0] * vy
            body = [first, moved[2]] if len(held) == 1 else [first]
        else:
            (a, a_dot), (b, b_dot) = held
            about = cross(a, b)
            about_dot = [x + y for x, y in zip(cross(a_dot, b), cross(a, b_dot), strict=True)]
            square = dot(about, about)
            change = dot(about_dot, state.twist) + dot(about, moved)
            twice = 2.0 * dot(about, state.twist) * dot(about, about_dot) / square
            body = [(change - twice) / square]
        return [*body, *[ZERO] * (self.body.na + len(self.body.choice.free))]

    def _turned(self, row: Row, state: State) -> Vector:
        """Return the rate of a lateral row's coefficients by the steering of its wheel about its centre."""
        k = next((k for wheel, k in self.body._steered if wheel == row.wheel), None)
        if k is None:
            return [ZERO] * 3
        turn = self.body.kinematics.heading(row.wheel, state.steering).first * state.rates[k]
        x, y = self.body.kinematics.x[row.wheel], self.body.kinematics.y[row.wheel]
        a, b, _ = row.base
        return [-(turn * b), turn * a, turn * (x * a + y * b)]

    def accelerations(self, state: State, rates: Vector) -> Vector:
        """Return the accelerations, along the body's axes, where the independent velocities change so."""
        S, gamma = self.solution(state)
        return [dot(row, rates) + g for row, g in zip(S, self.unmoved(state, S, gamma), strict=True)]

    def reduced(self, q: Any, v: Any) -> Reduced:
        """Return the dynamics of the independent velocities: M nu' + n = B u, see `Reduced`."""
        state = self.body.state(q, v)
        M, (S, gamma) = self.body.inertia(state, q), self.solution(state)
        effects = self.body.effects(state, q)
        columns = transposed(S)
        pushed = [applied(M, column) for column in columns]
        still = self.body.felt(state, self.unmoved(state, S, gamma))
        rest = [n + dot(row, still) for n, row in zip(effects, M, strict=True)]
        B = self.inputs(state, columns)
        public = [self.body.in_plane(state, column, q) for column in columns]
        return Reduced(
            matrix([[dot(a, b) for b in pushed] for a in columns], q),
            stacked([dot(column, rest) for column in columns], q),
            matrix(B, q) if self.body.nu else np.zeros((*np.shape(q)[:-1], len(columns), 0)),
            np.stack(np.broadcast_arrays(*public), axis=-1),
            stacked(self.velocities(state), q),
        )

    def inverse_dynamics(self, q: Any, v: Any, a: Any) -> Any:
        """Return the input of least norm with which body and arms accelerate so, shape (..., nu).

        Of drives whose body is free to move in any direction; `a` has the first 3 + arms coordinates.
        """
        state = self.body.state(q, v)
        S, gamma = self.solution(state)
        return stacked(self._driven(state, q, S, state.along(scalars(a)), gamma), q)

    def torques(self, q: Any, v: Any, rates: Any) -> Any:
        """Return the input of least norm with which the independent velocities change so, shape (..., nu)."""
        state = self.body.state(q, v)
        S, gamma = self.solution(state)
        return stacked(self._driven(state, q, S, scalars(rates), self.unmoved(state, S, gamma)), q)

    def _driven(self, state: State, q: Any, S: Matrix, rates: Vector, rest: Vector) -> Vector:
        """Return the input of least norm with which all accelerate as S rates + rest."""
        M = self.body.inertia(state, q)
        whole = self.body.felt(state, [dot(row, rates) + g for row, g in zip(S, rest, strict=True)])
        force = [dot(row, whole) + n for row, n in zip(M, self.body.effects(state, q), strict=True)]
        return self._least(state, S, force)

    def inputs(self, state: State, columns: Matrix) -> Matrix:
        """Return S' B: what each input is to each independent velocity, of the columns of S."""
        units = [self.body.generalised(state, one, 0.0) for one in np.eye(self.body.nu)]
        return [[dot(column, unit) for unit in units] for column in columns]

    def _least(self, state: State, S: Matrix, force: Vector) -> Vector:
        """Return the input of least norm that does what a generalised force along the body's axes does."""
        columns = transposed(S)
        right = [dot(column, force) for column in columns]
        B = self.inputs(state, columns)
        square = [[dot(x, y) for y in B] for x in B]
        found = solved(square, right, list(range(len(right))))
        return [dot(column, found) for column in zip(*B, strict=True)]

    def allocated(self, q: Any, tau: Any) -> tuple[Any, Any]:
        """Return an input for a force on body and arms, and what of it is left, see `WheeledRobot`."""
        state = self.body.state(q, stacked([ZERO] * self.body.nv, q))
        S, _ = self.solution(state)
        along = state.along(scalars(tau))
        u = stacked(self._least(state, S, [*along, *[ZERO] * self.body.joints]), q)
        upper, lower = (
            np.array([getattr(each, side) for each in self.body.inputs]) for side in ("upper", "lower")
        )
        if np.isfinite([upper, lower]).any():
            high, low = u > upper, u < lower
            beyond = np.where(high, upper, np.where(low, lower, 1.0)) / np.where(high | low, u, 1.0)
            u = u * np.min(beyond, axis=-1)[..., None]
        rest = [a - b for a, b in zip(along, self.supplied(state, u), strict=True)]
        return u, stacked(state.outward(rest), q)

    def supplied(self, state: State, u: Any) -> Vector:
        """Return the force on body and arms of what an input turns, along the body's axes."""
        ns, first = len(self.body.table.axes), _BASE + self.body.na
        effort = self.body.generalised(state, u, 0.0)
        found: Vector = [ZERO] * _BASE + effort[_BASE:first]
        for row in self.body.kinematics.rows(state.steering, [ZERO] * 3, [ZERO] * self.body.joints):
            if row.kind in ("rolling", "roller"):
                at = ns + row.wheel
                force = -(effort[first + at] / row.joints[at])
                found[:_BASE] = [x + force * b for x, b in zip(found[:_BASE], row.base, strict=True)]
        return found


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


class Followed(NamedTuple):
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


def followed(body: Any, reference: Any, t: Array | None = None) -> Followed:
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
    n, ns, (*lead, known) = _BASE + body.na, len(body.table.axes), reference.q.shape
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
    nu = stacked(body.freedom.velocities(body.state(q, v)), q)
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
    rates = body.freedom.offset(state, state.along(scalars(a)))[:own]
    rates = [*rates, *scalars(a)[_BASE:n], *(faster[..., k] for k in body.choice.free)]
    changes = stacked(rates, q)
    return Followed(q, rolls, nu, changes, driving_inputs(body, q, rolls, changes))


def driving_inputs(body: Any, q: Array, v: Array, rates: Array) -> Array:
    """Return the inputs of least norm with which independent velocities change so, and refuse if none do."""
    if not body.nu:
        raise InvalidArgument("robot has no motor, expected one that can be driven along a reference")
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
    still = np.zeros((*q.shape[:-1], body.nv))
    state = body.state(q, still)
    S, _ = body.freedom.solution(state)
    columns = np.moveaxis(nu, -1, 0)
    moved = [sum((number(x) * y for x, y in zip(row, columns, strict=True)), 0.0 * columns[0]) for row in S]
    return body.in_plane(state, moved, q)


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
    n = _BASE + body.na
    q, v, u = (np.asarray(x, np.float64) for x in (q, v, u))
    lead = np.broadcast_shapes(q.shape[:-1], v.shape[:-1], u.shape[:-1])
    q, v, u = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v, u))
    nu = stacked(body.freedom.velocities(body.state(q, v)), q)
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
