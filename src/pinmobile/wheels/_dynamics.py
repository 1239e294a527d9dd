"""`WheeledDynamics`: dynamics of body, arms and wheels, and independent velocities, for all engines.

These are the dynamics of a `WheeledRobot`; its ground adds a subclass. Wheels contribute terms of the energy
in the plane, and rolling is described by independent velocities.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MethodType
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pinmobile.arrays import Array, ArrayLike, broadcast, finite, finite_answer, positive, shaped
from pinmobile.metrics import Metric
from pinmobile.parts import Desired, dispatch_symbols, holds_symbols, require, takes
from pinmobile.plant import Step
from pinmobile.robot import (
    ZERO,
    Matrix,
    Vector,
    applied,
    cross,
    dot,
    exact,
    factor,
    matrix_of,
    number,
    scalars,
    sine_and_cosine,
    transpose,
    vector_of as stacked,
)
from pinmobile.wheels._kinematics import (
    Kinematics,
    NullSpaceBasis,
    Reduced,
    Row,
    RowSelection,
    rolling_motion,
    solve_null_space,
    tracked_slopes,
)
from pinmobile.wheels._loads import metrics_on_wheels, values_on_wheels
from pinmobile.wheels._motors import ExternalForceFunction, column, constant_force
from pinmobile.wheels._table import Axis

_BASE = 3
_INSTANT = 1e-5  # [s]: duration of the step whose mean acceleration is returned for a state
_SIZES = "nq", "nv", "nu", "of_body", "joints", "reference_sizes", "coordinates", "inputs"
_OF_ROBOT = {*_SIZES, "table", "x", "y", "radius", "spin_inertia", "upright", "fall", "footprint"}


class State(NamedTuple):
    """State with velocities along the body's axes.

    Attributes
    ----------
    c, s : scalar
        Cosine and sine of the heading.
    arms, steering : list of scalars
        Configuration of the arms, and steering angles.
    twist, arm_rates, rates : list of scalars
        Body twist; rates of the arms; rates of steering coordinates and wheels.
    """

    c: Any
    s: Any
    arms: Vector
    steering: Vector
    twist: Vector
    arm_rates: Vector
    rates: Vector

    def to_body(self, x: Vector) -> Vector:
        """Return components along the body's axes from components along the inertial axes."""
        return [self.c * x[0] + self.s * x[1], self.c * x[1] - self.s * x[0], *x[2:]]

    def outward(self, x: Vector) -> Vector:
        """Return components along the inertial axes from components along the body's axes."""
        return [self.c * x[0] - self.s * x[1], self.s * x[0] + self.c * x[1], *x[2:]]

    @property
    def velocities(self) -> Vector:
        """All velocities, along the body's axes."""
        return [*self.twist, *self.arm_rates, *self.rates]

    def with_psi(self, psi: Any) -> State:
        """Return the state with another heading."""
        s, c = sine_and_cosine(psi)
        return self._replace(c=c, s=s)

    def moving(self, v: Vector) -> State:
        """Return the state with other velocities."""
        end = _BASE + len(self.arms)
        return self._replace(twist=v[:_BASE], arm_rates=v[_BASE:end], rates=v[end:])


def mass_columns(M: Matrix, S: Matrix) -> Matrix:
    """Return S' M for a symmetric M."""
    return [applied(M, column) for column in transpose(S)]


@dataclass(frozen=True, eq=False)
class WheeledDynamics:
    """Dynamics of a body, its arms and its wheels without constraints, along the body's axes.

    Parameters
    ----------
    wheeled : WheeledRobot
        Robot whose sizes, table, positions, radii, inertias, support polygon, coordinates and inputs are
        used.
    robot : PlanarDynamics, ArticulatedDynamics or MobileRobot
        Whole robot with wheels locked at their table angles.
    """

    wheeled: Any
    robot: Any

    metrics = cached_property(metrics_on_wheels)
    evaluate_metrics = values_on_wheels
    broadcasts: ClassVar[bool] = True
    slips: ClassVar[bool] = True

    def __getattr__(self, name: str) -> Any:
        if name not in _OF_ROBOT:
            raise AttributeError(f"{type(self).__name__} has no {name}")
        value = vars(self)[name] = getattr(self.wheeled, name)
        return value

    @cached_property
    def rotors(self) -> Any:
        """Inertia of the motors' rotors at the wheels, shape (actuators,) [kg m^2]."""
        return column([actuator.motor.reflected_inertia for actuator in self.table.actuators])

    @cached_property
    def mu(self) -> Any:
        """Coefficients of friction, of rollers along their axes, shape (wheels,)."""
        return column([wheel.friction.mu for wheel in self.table.wheels])

    @cached_property
    def stands(self) -> bool:
        """Whether its height is known, and it has three contacts that are not on a line."""
        return self.wheeled.grounded and self.footprint is not None

    @cached_property
    def choice(self) -> RowSelection:
        """Selected rows of the wheels for rolling."""
        return self.table.mobility.choice  # type: ignore[no-any-return]

    @property
    def na(self) -> int:
        """Number of the arms' coordinates."""
        return int(self.robot.nv) - _BASE

    @cached_property
    def kinematics(self) -> Kinematics:
        """Rolling constraints of the wheels."""
        return Kinematics(self.table, scalars(self.x), scalars(self.y), scalars(self.radius))

    @cached_property
    def stops(self) -> list[tuple[int, float]]:
        """Steering axes with a limit, each with its limit [rad]."""
        return [(k, axis.limit) for k, axis in enumerate(self.table.axes) if np.isfinite(axis.limit)]

    @property
    def weight(self) -> Any:
        """Component of the weight across the plane [N]."""
        weight = self.robot.weight if self.na else self.robot.mass * float(np.linalg.norm(self.fall))
        return weight * (1.0 - self.gravity_reduction)

    def state(self, q: Any, v: Any) -> State:
        """Return a public state as velocities along the body's axes."""
        angles, rates = scalars(q), scalars(v)
        s, c = sine_and_cosine(angles[2])
        arms = self.of_body
        steering = angles[arms : arms + len(self.table.axes)]
        state = State(c, s, angles[_BASE:arms], steering, rates[:_BASE], rates[_BASE:arms], rates[arms:])
        return state._replace(twist=state.to_body(state.twist))

    def inertia(self, state: State, q: Any) -> Matrix:
        """Return M, (nv, nv), along the body's axes."""
        M: Matrix = [[ZERO] * self.nv for _ in range(self.nv)]
        arms_M = self.robot.mass_matrix(stacked([ZERO, ZERO, ZERO, *state.arms], q))
        first = self.of_body
        for i in range(first):
            M[i][:first] = scalars(arms_M[..., i, :])
        for k, spin in enumerate(scalars(self.spin_inertia), first + len(self.table.axes)):
            M[k][k] = M[k][k] + spin
        for actuator, rotor in zip(self.table.actuators, scalars(self.rotors), strict=True):
            for i, a in enumerate(actuator.column):
                for j, b in enumerate(actuator.column):
                    M[first + i][first + j] = M[first + i][first + j] + exact(a * b) * rotor
        for row, k in self._steering_pairs:
            self._add_steering(M, row, k, state)
        return M

    @cached_property
    def _steering_pairs(self) -> list[tuple[int, int]]:
        """Wheels that steer, each with its axis."""
        return [(row, k) for k, axis in enumerate(self.table.axes) for row in axis.wheels]

    def _add_steering(self, M: Matrix, row: int, k: int, state: State) -> None:
        """Add the effect of a wheel's steering to M: I_z (2 w + d') d' / 2, and the motion of its mass."""
        wheel, head = self.table.wheels[row], self.kinematics.heading(row, state.steering)
        at, turn = self.of_body + k, exact(wheel.yaw_inertia) * head.first
        M[at][at] = M[at][at] + turn * head.first
        M[2][at], M[at][2] = M[2][at] + turn, M[at][2] + turn
        if not (wheel.mass and any(wheel.trail)):
            return
        m, places = exact(wheel.mass), self.centres(row, state)
        for sign, (o, p) in zip((1.0, -1.0), places, strict=True):
            J = {0: [exact(1.0), ZERO], 1: [ZERO, exact(1.0)], 2: [-p[1], p[0]]}
            if sign > 0:
                J[at] = [-(o[1] * head.first), o[0] * head.first]
            for i, a in J.items():
                for j, b in J.items():
                    M[i][j] = M[i][j] + exact(sign) * m * dot(a, b)

    def centres(self, row: int, state: State) -> tuple[tuple[Vector, Vector], tuple[Vector, Vector]]:
        """Return a wheel's centre from its pivot and from the origin: at present, and at angle zero."""
        zeros: Vector = [ZERO] * len(state.steering)
        return self.kinematics.centre(row, state.steering), self.kinematics.centre(row, zeros)

    def effects(self, state: State, q: Any) -> Vector:
        """Return n, (nv,), along the body's axes."""
        n: Vector = [ZERO] * self.nv
        at_zero = stacked([ZERO, ZERO, ZERO, *state.arms], q)
        arms_n = self.robot.nonlinear_effects(at_zero, stacked([*state.twist, *state.arm_rates], q))
        n[: self.of_body] = scalars(arms_n)
        if self.na and self.gravity_reduction:
            weights = scalars(self.robot.gravity(at_zero))
            for i in range(_BASE, self.of_body):
                n[i] = n[i] - self.gravity_reduction * weights[i]
        for row, k in self._steering_pairs:
            wheel, head = self.table.wheels[row], self.kinematics.heading(row, state.steering)
            i_axis, w = self.of_body + k, state.twist[2]
            rate_sq = head.second * state.rates[k] * state.rates[k]
            moment = exact(wheel.yaw_inertia) * rate_sq
            n[2], n[i_axis] = n[2] + moment, n[i_axis] + moment * head.first
            if not (wheel.mass and any(wheel.trail)):
                continue
            m, ((o, p), (_, p0)) = exact(wheel.mass), self.centres(row, state)
            yaw = w + head.first * state.rates[k]
            pull = [-(w * w * (p[i] - o[i])) - yaw * yaw * o[i] for i in range(2)]
            pull = [pull[0] - rate_sq * o[1], pull[1] + rate_sq * o[0]]
            pull_0 = [-(w * w * x) for x in p0]
            change = [a - b for a, b in zip(pull, pull_0, strict=True)]
            n[0], n[1] = n[0] + m * change[0], n[1] + m * change[1]
            n[2] = n[2] + m * (p[0] * pull[1] - p[1] * pull[0]) - m * (p0[0] * pull_0[1] - p0[1] * pull_0[0])
            n[i_axis] = n[i_axis] + m * head.first * (o[0] * pull[1] - o[1] * pull[0])
        return n

    @cached_property
    def gravity_reduction(self) -> float:
        """Fraction by which a ramp reduces gravity across the plane."""
        size = float(np.linalg.norm(self.fall))
        return 1.0 + float(self.fall[2]) / size if size and (self.fall[0] or self.fall[1]) else 0.0

    def pull(self, state: State) -> Vector:
        """Return gravity in the plane along the body's axes [m/s^2]."""
        return state.to_body([exact(float(each)) for each in self.fall[:2]])

    def proper_acceleration(self, state: State, a: Vector) -> Vector:
        """Return accelerations minus gravity in the plane."""
        x, y = self.pull(state)
        return [a[0] - x, a[1] - y, *a[2:]]

    def input_force(self, state: State, u: Any, f: Any) -> Vector:
        """Return the generalised force of an input and an external force, along the body's axes."""
        inputs, na = scalars(u), self.na
        force: Vector = [ZERO] * _BASE + inputs[:na] + [ZERO] * self.joints
        for actuator, torque in zip(self.table.actuators, inputs[na:], strict=True):
            for i, share in enumerate(actuator.column):
                force[_BASE + na + i] = force[_BASE + na + i] + exact(share) * torque
        if np.ndim(f) == 0 and not isinstance(f, np.ndarray) and number(exact(f)) == 0:
            return force
        return [x + y for x, y in zip(force, state.to_body(scalars(f)), strict=True)]

    def rows(self, state: State, *, across: bool = False) -> list[Row]:
        """Return the rows of wheels and gear trains in a state, see `Kinematics.rows`."""
        return self.kinematics.rows(state.steering, state.twist, state.rates, across=across)

    def actuator_rates(self, rates: Vector) -> Vector:
        """Return the rate of each actuator from those of steering coordinates and wheels."""
        return [number(dot([exact(x) for x in actuator.column], rates)) for actuator in self.table.actuators]

    def in_plane(self, state: State, a: Vector, q: Any) -> Any:
        """Return components along the body's axes as a public array, shape (..., nv)."""
        return stacked(state.outward(a), q)

    def mass_matrix(self, q: Any) -> Any:
        """Return M(q), shape (..., nv, nv), rotors included."""
        state = self.state(q, stacked([ZERO] * self.nv, q))
        half = transpose([state.outward(row) for row in self.inertia(state, q)])
        return matrix_of(transpose([state.outward(row) for row in half]), q)

    def nonlinear_effects(self, q: Any, v: Any) -> Any:
        """Return n(q, v), shape (..., nv)."""
        return self.left(q, v, stacked([ZERO] * self.nv, q))

    def left(self, q: Any, v: Any, a: Any) -> Any:
        """Return M a + n, shape (..., nv)."""
        state = self.state(q, v)
        proper_a = self.proper_acceleration(state, state.to_body(scalars(a)))
        return self.in_plane(state, self.required(state, proper_a, q), q)

    def required(self, state: State, proper_a: Vector, q: Any) -> Vector:
        """Return the generalised force of a motion, along the body's axes."""
        pairs = zip(self.inertia(state, q), self.effects(state, q), strict=True)
        return [dot(row, proper_a) + n for row, n in pairs]

    def constraints(self, q: Any, v: Any) -> tuple[Any, Any]:
        """Return A(q), shape (..., k, nv), and dA/dt v: A v = 0 for rolling wheels."""
        state = self.state(q, v)
        rows = self.rows(state)
        A = [state.outward([*row.base, *[ZERO] * self.na, *row.joints]) for row in rows]
        return matrix_of(A, q), stacked([row.drift for row in rows], q)

    def integrate(self, q: Any, dq: Any) -> Any:
        """Return the configuration after a displacement."""
        return q + dq

    def difference(self, q0: Any, q1: Any) -> Any:
        """Return the displacement from q0 to q1, as `robot` computes it, shape (..., nv)."""
        n = self.of_body
        first = self.robot.difference(q0[..., :n], q1[..., :n])
        return np.concatenate([first, q1[..., n:] - q0[..., n:]], axis=-1)

    def pose(self, q: Any) -> Any:
        """Return x, y, psi of the body."""
        return q[..., :_BASE]

    def pose_rate(self, q: Any, v: Any) -> Any:
        """Return the rates of x, y, psi."""
        return v[..., :_BASE]

    def generalized_force(self, q: Any, wrench: Any) -> Any:
        """Return the generalised force of a wrench on the body, shape (..., nv)."""
        return stacked([*scalars(wrench), *[ZERO] * (self.nv - _BASE)], q)

    def wheel_rates(self, twist: Any, steering: Any = (), turning: Any = ()) -> Any:
        """Return the rates of rolling wheels for a body twist, see `WheeledRobot.wheel_rates`."""
        angles, turns = (scalars(x) if len(x) else [ZERO] * len(self.table.axes) for x in (steering, turning))
        return stacked(self.kinematics.wheel_rates(angles, scalars(twist), turns), twist)

    def odometry(self, rates: Any, steering: Any = (), turning: Any = ()) -> Any:
        """Return the body twist from wheel rates, see `WheeledRobot.odometry`."""
        angles, turns = (scalars(x) if len(x) else [ZERO] * len(self.table.axes) for x in (steering, turning))
        return stacked(self.kinematics.odometry(angles, [*turns, *scalars(rates)]), rates)

    def independent(self, q: Any, v: Any) -> Any:
        """Return the independent velocities nu of a rolling state, shape (..., m)."""
        return stacked(self.velocities(self.state(q, v)), q)

    followed = rolling_motion
    linearize_tracked = tracked_slopes

    # Rolling: independent velocities nu, v = S nu, see `Reduced`

    def null_space(self, state: State) -> NullSpaceBasis:
        """Return the null-space basis of rolling, with arms between body and joints."""
        return solve_null_space(self.rows(state), self.choice, self.na)

    def velocities(self, state: State) -> Vector:
        """Return the independent velocities nu of a rolling state, in the order of the columns of S."""
        rows = [self.rows(state)[i] for i in self.choice.body]
        a, w = rows[0].base if rows else [], state.twist[2]
        if not rows:
            body = state.twist
        elif len(rows) == 1 or self.choice.is_fixed:
            speed = a[1] * state.twist[0] - a[0] * state.twist[1]
            body = [speed, w] if len(rows) == 1 else [speed]
        else:
            normal = cross(a, rows[1].base)
            body = [dot(normal, state.twist) / dot(normal, normal)]
        return [*body, *state.arm_rates, *(state.rates[k] for k in self.choice.free)]

    def bias_acceleration(self, state: State, S: Matrix, gamma: Vector) -> Vector:
        """Return the accelerations, along the body's axes, for constant independent velocities."""
        offset = self.offset(state, gamma)
        return [g - dot(row, offset) for row, g in zip(S, gamma, strict=True)]

    def offset(self, state: State, gamma: Vector) -> Vector:
        """Return the rates of the independent velocities for the accelerations gamma."""
        vx, vy, w = state.twist
        twist_rate = [gamma[0] + w * vy, gamma[1] - w * vx, gamma[2]]  # the rate of the body twist
        rows = self.rows(state)
        pairs = [(rows[i].base, self._row_rate(rows[i], state)) for i in self.choice.body]
        if not pairs:
            body = twist_rate
        elif len(pairs) == 1 or self.choice.is_fixed:
            a, a_dot = pairs[0]
            first = a[1] * twist_rate[0] - a[0] * twist_rate[1] + a_dot[1] * vx - a_dot[0] * vy
            body = [first, twist_rate[2]] if len(pairs) == 1 else [first]
        else:
            (a, a_dot), (b, b_dot) = pairs
            normal = cross(a, b)
            normal_dot = [x + y for x, y in zip(cross(a_dot, b), cross(a, b_dot), strict=True)]
            square = dot(normal, normal)
            change = dot(normal_dot, state.twist) + dot(normal, twist_rate)
            correction = 2.0 * dot(normal, state.twist) * dot(normal, normal_dot) / square
            body = [(change - correction) / square]
        return [*body, *[ZERO] * (self.na + len(self.choice.free))]

    def _row_rate(self, row: Row, state: State) -> Vector:
        """Return the rate of a lateral row's coefficients due to the steering of its wheel."""
        k = self.kinematics.axis_of[row.wheel]
        if k < 0:
            return [ZERO] * 3
        turn = self.kinematics.heading(row.wheel, state.steering).first * state.rates[k]
        x, y = self.kinematics.x[row.wheel], self.kinematics.y[row.wheel]
        a, b, _ = row.base
        return [-(turn * b), turn * a, turn * (x * a + y * b)]

    def accelerations(self, state: State, rates: Vector) -> Vector:
        """Return the accelerations, along the body's axes, for rates of the independent velocities."""
        S, gamma = self.null_space(state)
        rest = self.bias_acceleration(state, S, gamma)
        return [dot(row, rates) + g for row, g in zip(S, rest, strict=True)]

    def reduced(self, q: Any, v: Any) -> Reduced:
        """Return the dynamics of the independent velocities: M dnu/dt + n = B u, see `Reduced`."""
        state = self.state(q, v)
        M, (S, gamma) = self.inertia(state, q), self.null_space(state)
        columns, MS = transpose(S), mass_columns(M, S)
        bias = self.proper_acceleration(state, self.bias_acceleration(state, S, gamma))
        rest = [n + dot(row, bias) for n, row in zip(self.effects(state, q), M, strict=True)]
        B = self.input_columns(state, columns)
        public = [self.in_plane(state, column, q) for column in columns]
        return Reduced(
            matrix_of([[dot(a, b) for b in MS] for a in columns], q),
            stacked([dot(column, rest) for column in columns], q),
            matrix_of(B, q) if self.nu else np.zeros((*np.shape(q)[:-1], len(columns), 0)),
            np.stack(np.broadcast_arrays(*public), axis=-1),
            stacked(self.velocities(state), q),
        )

    def inverse_dynamics(self, q: Any, v: Any, a: Any) -> Any:
        """Return the input of least norm for an acceleration of body and arms, shape (..., nu).

        The drive must be omnidirectional; `a` contains the first 3 + arms coordinates.
        """
        state = self.state(q, v)
        S, gamma = self.null_space(state)
        return stacked(self._inverse(state, q, S, state.to_body(scalars(a)), gamma), q)

    def torques(self, q: Any, v: Any, rates: Any) -> Any:
        """Return the input of least norm for rates of the independent velocities, shape (..., nu)."""
        state = self.state(q, v)
        S, gamma = self.null_space(state)
        return stacked(self._inverse(state, q, S, scalars(rates), self.bias_acceleration(state, S, gamma)), q)

    def _inverse(self, state: State, q: Any, S: Matrix, rates: Vector, rest: Vector) -> Vector:
        """Return the input of least norm for the accelerations S rates + rest."""
        a = [dot(row, rates) + g for row, g in zip(S, rest, strict=True)]
        return self._least_norm(state, S, self.required(state, self.proper_acceleration(state, a), q))

    def input_columns(self, state: State, columns: Matrix) -> Matrix:
        """Return S' B for the columns of S: force on each independent velocity per input."""
        units = [self.input_force(state, one, 0.0) for one in np.eye(self.nu)]
        return [[dot(column, unit) for unit in units] for column in columns]

    def _least_norm(self, state: State, S: Matrix, force: Vector) -> Vector:
        """Return the input of least norm with the effect of a generalised force along the body's axes."""
        columns = transpose(S)
        right = [dot(column, force) for column in columns]
        B = self.input_columns(state, columns)
        square = [[dot(x, y) for y in B] for x in B]
        solution = factor(square, range(len(right)))[0](right)
        return [dot(column, solution) for column in zip(*B, strict=True)]

    def allocate_scaled(self, q: Any, tau: Any) -> tuple[Any, Any]:
        """Return an input for a force on body and arms, and the residual, see `WheeledRobot`."""
        state = self.state(q, stacked([ZERO] * self.nv, q))
        S, _ = self.null_space(state)
        force = state.to_body(scalars(tau))
        u = stacked(self._least_norm(state, S, [*force, *[ZERO] * self.joints]), q)
        upper, lower = np.array([(each.upper, each.lower) for each in self.inputs]).reshape(-1, 2).T
        if np.isfinite([upper, lower]).any():
            high, low = u > upper, u < lower
            ratio = np.where(high, upper, np.where(low, lower, 1.0)) / np.where(high | low, u, 1.0)
            u = u * np.min(ratio, axis=-1)[..., None]
        rest = [a - b for a, b in zip(force, self.applied_force(state, u), strict=True)]
        return u, stacked(state.outward(rest), q)

    def applied_force(self, state: State, u: Any) -> Vector:
        """Return the force of an input on body and arms, along the body's axes."""
        ns, first = len(self.table.axes), self.of_body
        effort = self.input_force(state, u, 0.0)
        total: Vector = [ZERO] * _BASE + effort[_BASE:first]
        for row in self.kinematics.rows(state.steering, [ZERO] * 3, [ZERO] * self.joints):
            if row.kind in ("rolling", "roller"):
                joint = ns + row.wheel
                force = -(effort[first + joint] / row.joints[joint])
                total[:_BASE] = [x + force * b for x, b in zip(total[:_BASE], row.base, strict=True)]
        return total

    @property
    def axle(self) -> Any:
        """Coefficients of the body twist in the lateral velocity at the fixed wheels, shape (..., 3)."""
        rows = self.kinematics.rows([ZERO] * len(self.table.axes), [ZERO] * 3, [ZERO] * self.kinematics.n)
        return stacked(rows[self.choice.body[0]].base, self.x)

    @property
    def pivots(self) -> Any:
        """Positions and angles of steering axes, shape (..., axes, 3), see `WheeledRobot.pivots`."""
        x, y, rows = scalars(self.x), scalars(self.y), list[Vector]()
        for axis in self.table.axes:
            i = axis.wheels[0]
            rows.append([x[i], y[i] if axis.ackermann is None else ZERO, exact(self.table.wheels[i].angle)])
        return matrix_of(rows, self.x)

    def start(self, reference: Any) -> tuple[Any, Any]:
        """Return the state at the start of a reference, see `WheeledRobot.start`."""
        n, ns = self.of_body, len(self.table.axes)
        body, rates = self.robot.start(reference)
        q, v = [*scalars(body), *[ZERO] * self.joints], [*scalars(rates), *[ZERO] * self.joints]
        twist = [number(x) for x in self.state(stacked(q, body), stacked(v, body)).twist]
        q[n : n + ns] = [self.steered_to(axis, twist) for axis in self.table.axes]
        rows = self.rows(self.state(stacked(q, body), stacked(v, body)))
        for joint, i in self.choice.joints:
            row = [number(x) for x in rows[i].joints]
            slip = number(dot(rows[i].base, twist)) + number(dot(row, v[n:]))
            v[n + joint] = -(slip - row[joint] * v[n + joint]) / row[joint]
        return stacked(q, body), stacked(v, body)

    def steered_to(self, axis: Axis, twist: Sequence[Any]) -> Any:
        """Return the steering angle at which a wheel points in its direction of motion; 0 at rest."""
        i = axis.wheels[0]
        wheel, x, y = self.table.wheels[i], number(scalars(self.x)[i]), number(scalars(self.y)[i])
        if axis.ackermann is not None:
            x, y = x - axis.ackermann, 0.0
        velocity = stacked([twist[0] - twist[2] * y, twist[1] + twist[2] * x], np.zeros(1))
        forward, left = velocity[..., 0], velocity[..., 1]
        angle = np.where((forward == 0.0) & (left == 0.0), 0.0, np.arctan2(left, forward) - wheel.angle)
        if wheel.motor is not None or axis.ackermann is not None:  # it can also run backwards
            angle = (angle + np.pi / 2) % np.pi - np.pi / 2
        return number(scalars(angle[..., None])[0])


def mean_acceleration(body: Any, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
    """Return the mean acceleration over a short step from a state, shape (..., nv)."""
    return (body.step(0.0, q, v, u, _INSTANT, lambda t, q, v: f, body.initial_state()).v - v) / _INSTANT


def of_ground(method: Callable[..., Any]) -> Any:
    """Make a method available if the dynamics of the robot's ground have it."""

    def bind(robot: Any) -> Any:
        if not hasattr(robot.array_dynamics, method.__name__):
            ground = type(robot.ground).__name__
            raise AttributeError(f"a {type(robot).__name__} on {ground} ground has no {method.__name__}")
        return MethodType(method, robot)

    return property(bind, doc=method.__doc__)


class PlantOnWheels:
    """Abstract base of plants on wheels, with the optional methods of ground and motors."""

    broadcasts: ClassVar[bool] = True
    compiles: ClassVar[bool] = True
    array_dynamics: Any
    reference_sizes: Any
    describe: Any

    def __str__(self) -> str:
        return str(self.describe())

    @cached_property
    def _is_symbolic(self) -> bool:
        return holds_symbols(self)

    @property
    def dynamics(self) -> Any:
        """Dynamics for a loop: the robot itself, or its `array_dynamics` if it contains symbols."""
        return self.array_dynamics if self._is_symbolic else self

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """Metrics beside errors, in the order of `evaluate_metrics`.

        They are the smallest load of wheels and supports; the smallest slip margin of wheels that roll by
        torques (see `WheeledRobot.slip_margins`), or the largest slip velocity of wheels that slip; the
        largest input relative to its limit; and the metrics of arms, see `MobileRobot.metrics`.
        """
        return self.array_dynamics.metrics  # type: ignore[no-any-return]

    @dispatch_symbols
    def evaluate_metrics(
        self, t: ArrayLike, q: ArrayLike, v: ArrayLike, a: ArrayLike, u: ArrayLike, reference: Any
    ) -> Array:
        """Return the values of `metrics`, shape (..., m).

        Parameters
        ----------
        t : array_like, shape (...)
            Time [s], not used.
        q, v, a, u : array_like, shape (..., nq), (..., nv), (..., nv), (..., nu)
            State, acceleration and input.
        reference : Reference
            Desired values of the first coordinates.
        """
        require("reference", reference, Desired)
        shapes = [("...", n) for n in self.reference_sizes]
        given = [*self._state(q, v, u, a), shaped("reference.q", finite("reference.q", reference.q), *shapes)]
        lead = broadcast(**{"q": given[0], "reference.q": given[-1]})
        q, v, u, a, desired = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in given)
        with np.errstate(all="ignore"):
            sample = t, q, v, a, u, reference._replace(q=desired)
            values = np.asarray(self.array_dynamics.evaluate_metrics(*sample))
        finite_answer(np.where(values == -np.inf, 0.0, values), q=q, v=v, a=a, u=u)  # a margin may be -inf
        return np.array(np.broadcast_to(values, (*lead, len(self.metrics))))

    @of_ground
    def initial_state(self, context: Any = None) -> Any:
        """Return the memory of motors, and of wheels that slip, before the first step.

        Parameters
        ----------
        context : Context, optional
            Context of the loop, not used.
        """
        return self.array_dynamics.initial_state(context)

    @of_ground
    @dispatch_symbols
    def step(
        self, t: float, q: Any, v: Any, u: Any, h: Any, f: ExternalForceFunction | ArrayLike, memory: Any
    ) -> Step:
        """Return the state after a step, for wheels that slip or motors that take volts.

        Parameters
        ----------
        t : float
            Time [s].
        q, v : array_like, shape (..., nq), (..., nv)
            State.
        u : array_like, shape (..., nu)
            Input.
        h : float
            Length of the step [s].
        f : callable or array_like, shape (..., nv)
            External generalised force: ``f(t, q, v)`` at mid-step, or a constant.
        memory : any
            Memory from `initial_state` or the step before.
        """
        q, v, u = self._state(q, v, u)
        f, h = f if callable(f) else constant_force(finite("f", f)), positive("h", h, "s")
        return self.array_dynamics.step(t, q, v, u, h, f, memory)  # type: ignore[no-any-return]

    @of_ground
    @dispatch_symbols
    def signals(self, t: Any, q: Any, v: Any, u: Any, f: Any, memory: Any) -> dict[str, tuple[str, Any]]:
        """Return the signals of motors, and of the ground if wheels slip, in the step before."""
        return self.array_dynamics.signals(t, q, v, u, f, memory)  # type: ignore[no-any-return]

    @takes(q="nq", v="nv", u="nu", a="nv")
    def _state(self, q: Any, v: Any, u: Any, a: Any = None) -> tuple[Any, ...]:
        """Return a state, an input and an acceleration after a check."""
        return (q, v, u) if a is None else (q, v, u, a)
