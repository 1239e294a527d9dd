"""`RollingDynamics`: a robot whose wheels roll ideally, for one state, many, or symbols.

It is what a `WheeledRobot` on ideal ground is to compiled loops and to loops on arrays. It knows wheels as
terms of the energy in the plane and rolling as independent velocities; Pinocchio's tree and its constraint
forces, by which `WheeledRobot` itself computes, are another way to the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import choose
from pinmobile.measures import Measure
from pinmobile.plant import Coordinate, Input
from pinmobile.robot import (
    ZERO,
    Matrix,
    Vector,
    applied,
    dot,
    exact,
    number,
    scalars,
    sine_and_cosine,
    solved as solved_by,
    transposed,
    vector_of as stacked,
)
from pinmobile.wheels._kinematics import Choice, Kinematics
from pinmobile.wheels._loads import Group, groups_of, measured, measures_of
from pinmobile.wheels._table import Axis, WheelTable
from pinmobile.wheels._velocities import (
    Followed,
    Freedom,
    Reduced,
    State as State,
    followed,
    linearized,
    matrix,
)

_BASE = 3
_RESTING = 1e-9  # [rad/s], of an axis at its stop


@dataclass(frozen=True, eq=False)
class WheeledDynamics:
    """A body, its arms and its wheels, free to slip: mass matrix and nonlinear effects along the body's axes.

    Parameters
    ----------
    robot : PlanarBody or ArticulatedBody
        The whole, wheels locked at their table angles.
    table : WheelTable
        The structure of the drive.
    x, y, radius : ndarray, shape (wheels,)
        Of each wheel [m].
    spin_inertia : ndarray, shape (wheels,)
        About the axles [kg m^2].
    rotors : ndarray, shape (actuators,)
        What motors add to the inertia [kg m^2].
    fall : ndarray, shape (3,)
        Gravity along the axes of the plane [m/s^2].
    mu : ndarray, shape (wheels,)
        Coefficients of friction, of rollers along their axes.
    upright : ndarray, shape (3,)
        Of a robot without arms, what the ground alone feels: height of the centre of mass of the whole [m],
        and inertia xz and yz about it [kg m^2].
    footprint : ndarray, shape (k, 2), or None
        Corners of what it stands on [m].
    stands : bool
        Whether it is known where it stands: how high it is, on three places that are not on a line.
    choice : Choice
        Which rows of the wheels determine what, where they roll.
    coordinates, inputs
        As of a plant.
    """

    robot: Any
    table: WheelTable
    x: Any
    y: Any
    radius: Any
    spin_inertia: Any
    rotors: Any
    fall: Any
    mu: Any
    upright: Any
    footprint: Array | None
    stands: bool
    choice: Choice
    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]

    broadcasts: ClassVar[bool] = True
    slips: ClassVar[bool] = True

    @property
    def na(self) -> int:
        """Number of the arms' coordinates."""
        return int(self.robot.nv) - _BASE

    @property
    def joints(self) -> int:
        """Number of steering coordinates and wheels."""
        return len(self.table.axes) + len(self.table)

    @property
    def size(self) -> int:
        """Number of velocities."""
        return _BASE + self.na + self.joints

    @property
    def nq(self) -> int:
        """Size of q."""
        return self.size

    @property
    def nv(self) -> int:
        """Size of v and a."""
        return self.size

    @property
    def nu(self) -> int:
        """Size of the input."""
        return self.na + len(self.table.actuators)

    @property
    def leading(self) -> dict[int, int]:
        """How many numbers of q the first n coordinates have, for each n that a reference may have."""
        return {n: n for n in range(_BASE, _BASE + self.na + 1)}

    @cached_property
    def kinematics(self) -> Kinematics:
        """Its rows."""
        return Kinematics(self.table, scalars(self.x), scalars(self.y), scalars(self.radius))

    @cached_property
    def stops(self) -> list[tuple[int, float]]:
        """Steering axes with a limit, each with its angle [rad]."""
        return [(k, axis.limit) for k, axis in enumerate(self.table.axes) if np.isfinite(axis.limit)]

    @cached_property
    def measures(self) -> tuple[Measure, ...]:
        """What is worth judging about it: see `WheeledRobot.measures`."""
        return measures_of(self)

    def measured(self, t: Any, q: Any, v: Any, a: Any, u: Any, reference: Any) -> Any:
        """Return its measures, shape (..., m)."""
        del t
        return measured(self, q, v, a, u, reference.q)

    @property
    def freedom(self) -> Freedom:
        """Its independent velocities, where wheels roll."""
        return Freedom(self)

    @property
    def weight(self) -> Any:
        """Weight of all that it is made of, across the plane [N]."""
        own = self.robot.weight if self.na else self.robot.mass * float(np.linalg.norm(self.fall))
        return own * (1.0 - self._slack)

    def state(self, q: Any, v: Any) -> State:
        """Return a public state, seen from the body."""
        angles, rates = scalars(q), scalars(v)
        s, c = sine_and_cosine(angles[2])
        arms = _BASE + self.na
        steering = angles[arms : arms + len(self.table.axes)]
        found = State(c, s, angles[_BASE:arms], steering, rates[:_BASE], rates[_BASE:arms], rates[arms:])
        return found._replace(twist=found.along(found.twist))

    def inertia(self, state: State, q: Any) -> Matrix:
        """Return M, (size, size), of body axes."""
        M: Matrix = [[ZERO] * self.size for _ in range(self.size)]
        carried = self.robot.mass_matrix(stacked([ZERO, ZERO, ZERO, *state.arms], q))
        for i in range(_BASE + self.na):
            M[i][: _BASE + self.na] = scalars(carried[..., i, :])
        first = _BASE + self.na
        spins = scalars(self.spin_inertia)
        for row, spin in enumerate(spins):
            k = first + len(self.table.axes) + row
            M[k][k] = M[k][k] + spin
        for actuator, rotor in zip(self.table.actuators, scalars(self.rotors), strict=True):
            for i, a in enumerate(actuator.column):
                for j, b in enumerate(actuator.column):
                    M[first + i][first + j] = M[first + i][first + j] + exact(a * b) * rotor
        for row, k in self._steered:
            self._add_steered(M, row, k, state)
        return M

    @cached_property
    def _steered(self) -> list[tuple[int, int]]:
        """Wheels that steer, each with its axis."""
        return [(row, k) for k, axis in enumerate(self.table.axes) for row in axis.wheels]

    def _add_steered(self, M: Matrix, row: int, k: int, state: State) -> None:
        """Add what a wheel's steering changes: I_z (2 w + d') d' / 2, and where its mass is."""
        wheel, head = self.table.wheels[row], self.kinematics.heading(row, state.steering)
        at, turn = _BASE + self.na + k, exact(wheel.yaw_inertia) * head.first
        M[at][at] = M[at][at] + turn * head.first
        M[2][at], M[at][2] = M[2][at] + turn, M[at][2] + turn
        if not (wheel.mass and any(wheel.trail)):
            return
        m, places = exact(wheel.mass), self._centres(row, state)
        for sign, (o, p) in zip((1.0, -1.0), places, strict=True):
            J = {0: [exact(1.0), ZERO], 1: [ZERO, exact(1.0)], 2: [-p[1], p[0]]}
            if sign > 0:
                J[at] = [-(o[1] * head.first), o[0] * head.first]
            for i, a in J.items():
                for j, b in J.items():
                    M[i][j] = M[i][j] + exact(sign) * m * dot(a, b)

    def _centres(self, row: int, state: State) -> tuple[tuple[Vector, Vector], tuple[Vector, Vector]]:
        """Return a wheel's centre from its pivot and from the origin: as it is, and at angle zero."""
        still: Vector = [ZERO] * len(state.steering)
        return self.kinematics.centre(row, state.steering), self.kinematics.centre(row, still)

    def effects(self, state: State, q: Any) -> Vector:
        """Return n, (size,), along the body's axes."""
        n: Vector = [ZERO] * self.size
        at_zero = stacked([ZERO, ZERO, ZERO, *state.arms], q)
        carried = self.robot.nonlinear_effects(at_zero, stacked([*state.twist, *state.arm_rates], q))
        n[: _BASE + self.na] = scalars(carried)
        if self.na and self._slack:
            weights = scalars(self.robot.gravity(at_zero))
            n[_BASE : _BASE + self.na] = [x - self._slack * y for x, y in zip(n, weights, strict=False)][
                _BASE : _BASE + self.na
            ]
        for row, k in self._steered:
            wheel, head = self.table.wheels[row], self.kinematics.heading(row, state.steering)
            at, w = _BASE + self.na + k, state.twist[2]
            bent = head.second * state.rates[k] * state.rates[k]
            moment = exact(wheel.yaw_inertia) * bent
            n[2], n[at] = n[2] + moment, n[at] + moment * head.first
            if not (wheel.mass and any(wheel.trail)):
                continue
            m, ((o, p), (_, p0)) = exact(wheel.mass), self._centres(row, state)
            both = w + head.first * state.rates[k]
            pull = [-(w * w * (p[i] - o[i])) - both * both * o[i] for i in range(2)]
            pull = [pull[0] - bent * o[1], pull[1] + bent * o[0]]
            locked = [-(w * w * x) for x in p0]
            change = [a - b for a, b in zip(pull, locked, strict=True)]
            n[0], n[1] = n[0] + m * change[0], n[1] + m * change[1]
            n[2] = n[2] + m * (p[0] * pull[1] - p[1] * pull[0]) - m * (p0[0] * locked[1] - p0[1] * locked[0])
            n[at] = n[at] + m * head.first * (o[0] * pull[1] - o[1] * pull[0])
        return n

    @cached_property
    def _slack(self) -> float:
        """Share of gravity across the plane that a ramp takes away."""
        size = float(np.linalg.norm(self.fall))
        return 1.0 + float(self.fall[2]) / size if size and (self.fall[0] or self.fall[1]) else 0.0

    def pull(self, state: State) -> Vector:
        """Return gravity in the plane along the body's axes, which every mass feels alike [m/s^2]."""
        return state.along([exact(float(each)) for each in self.fall[:2]])

    def felt(self, state: State, a: Vector) -> Vector:
        """Return accelerations less gravity in the plane, which is as if the plane accelerated against it."""
        x, y = self.pull(state)
        return [a[0] - x, a[1] - y, *a[2:]]

    def generalised(self, state: State, u: Any, f: Any) -> Vector:
        """Return the generalised force of an input and of forces beside it, along the body's axes."""
        inputs, na = scalars(u), self.na
        found: Vector = [ZERO] * _BASE + inputs[:na] + [ZERO] * self.joints
        for actuator, torque in zip(self.table.actuators, inputs[na:], strict=True):
            for i, share in enumerate(actuator.column):
                found[_BASE + na + i] = found[_BASE + na + i] + exact(share) * torque
        if np.ndim(f) == 0 and not isinstance(f, np.ndarray) and number(exact(f)) == 0:
            return found
        return [x + y for x, y in zip(found, state.along(scalars(f)), strict=True)]

    def actuator_rates(self, rates: Vector) -> Vector:
        """Return the rate of each actuator, of those of steering coordinates and wheels."""
        return [number(dot([exact(x) for x in actuator.column], rates)) for actuator in self.table.actuators]

    def in_plane(self, state: State, a: Vector, q: Any) -> Any:
        """Return numbers along the body's axes as a public array, shape (..., size)."""
        return stacked(state.outward(a), q)

    def mass_matrix(self, q: Any) -> Any:
        """Return M(q), shape (..., nv, nv), rotors included."""
        state = self.state(q, stacked([ZERO] * self.size, q))
        half = transposed([state.outward(row) for row in self.inertia(state, q)])
        return matrix(transposed([state.outward(row) for row in half]), q)

    def nonlinear_effects(self, q: Any, v: Any) -> Any:
        """Return n(q, v), shape (..., nv)."""
        return self.left(q, v, stacked([ZERO] * self.size, q))

    def left(self, q: Any, v: Any, a: Any) -> Any:
        """Return M a + n, shape (..., nv)."""
        state = self.state(q, v)
        return self.in_plane(state, self.needed(state, self.felt(state, state.along(scalars(a))), q), q)

    def needed(self, state: State, felt: Vector, q: Any) -> Vector:
        """Return the generalised force that lets it move so, along the body's axes."""
        pairs = zip(self.inertia(state, q), self.effects(state, q), strict=True)
        return [dot(row, felt) + n for row, n in pairs]

    def constraints(self, q: Any, v: Any) -> tuple[Any, Any]:
        """Return A(q), shape (..., k, nv), and dA/dt v: A v = 0 where wheels roll."""
        state = self.state(q, v)
        rows = self.kinematics.rows(state.steering, state.twist, state.rates)
        A = [state.outward([*row.base, *[ZERO] * self.na, *row.joints]) for row in rows]
        return matrix(A, q), stacked([row.drift for row in rows], q)

    def integrate(self, q: Any, dq: Any) -> Any:
        """Return the configuration that a displacement leads to."""
        return q + dq

    def difference(self, q0: Any, q1: Any) -> Any:
        """Return the displacement from q0 to q1 as `robot` has it, shape (..., nv)."""
        n = _BASE + self.na
        own = self.robot.difference(q0[..., :n], q1[..., :n])
        return np.concatenate([own, q1[..., n:] - q0[..., n:]], axis=-1)

    def pose(self, q: Any) -> Any:
        """Return x, y, psi of the body."""
        return q[..., :_BASE]

    def rate(self, q: Any, v: Any) -> Any:
        """Return the rates of x, y, psi."""
        return v[..., :_BASE]

    def effort(self, q: Any, wrench: Any) -> Any:
        """Return the generalised force of a wrench on the body, shape (..., nv)."""
        return stacked([*scalars(wrench), *[ZERO] * (self.nv - _BASE)], q)

    def wheel_rates(self, twist: Any, steering: Any = (), turning: Any = ()) -> Any:
        """Return the rates of the wheels that roll at a body twist, see `WheeledRobot.wheel_rates`."""
        angles, turns = (scalars(x) if len(x) else [ZERO] * len(self.table.axes) for x in (steering, turning))
        return stacked(self.kinematics.wheel_rates(angles, scalars(twist), turns), twist)

    def odometry(self, rates: Any, steering: Any = (), turning: Any = ()) -> Any:
        """Return the body twist that fits rates of the wheels best, see `WheeledRobot.odometry`."""
        angles, turns = (scalars(x) if len(x) else [ZERO] * len(self.table.axes) for x in (steering, turning))
        return stacked(self.kinematics.odometry(angles, [*turns, *scalars(rates)]), rates)

    def reduced(self, q: Any, v: Any) -> Reduced:
        """Return the dynamics of the independent velocities: M nu' + n = B u, see `Reduced`."""
        return self.freedom.reduced(q, v)

    def inverse_dynamics(self, q: Any, v: Any, a: Any) -> Any:
        """Return the input of least norm with which body and arms accelerate so, shape (..., nu).

        Of drives whose body is free to move in any direction; `a` has the first 3 + arms coordinates.
        """
        return self.freedom.inverse_dynamics(q, v, a)

    def torques(self, q: Any, v: Any, rates: Any) -> Any:
        """Return the input of least norm with which the independent velocities change so, shape (..., nu)."""
        return self.freedom.torques(q, v, rates)

    def independent(self, q: Any, v: Any) -> Any:
        """Return the independent velocities nu of a state that rolls, shape (..., m)."""
        return stacked(self.freedom.velocities(self.state(q, v)), q)

    def linearize_tracked(self, q: Any, v: Any, u: Any) -> tuple[Array, Array]:
        """Return A and B of the tracked state, see `WheeledRobot.linearize_tracked`."""
        return linearized(self, q, v, u)

    def followed(self, reference: Any) -> Followed:
        """Return states, and inputs of least norm, with which it goes along a reference: see `Followed`."""
        return followed(self, reference)

    @property
    def axle(self) -> Any:
        """Coefficients of the body twist in the velocity across the fixed wheels, shape (..., 3)."""
        rows = self.kinematics.rows([ZERO] * len(self.table.axes), [ZERO] * 3, [ZERO] * self.kinematics.n)
        return stacked(rows[self.choice.body[0]].base, self.x)

    @property
    def pivots(self) -> Any:
        """Where wheels are steered, and angles at zero, shape (..., axes, 3), see `WheeledRobot.pivots`."""
        x, y = scalars(self.x), scalars(self.y)
        rows = []
        for axis in self.table.axes:
            first, at = self.table.wheels[axis.wheels[0]], axis.wheels[0]
            if axis.ackermann is None:
                rows.append([x[at], y[at], exact(first.angle)])
            else:
                rows.append([x[at], ZERO, exact(first.angle)])
        return matrix(rows, self.x)

    def allocate_scaled(self, q: Any, tau: Any) -> tuple[Any, Any]:
        """Return an input for a force on body and arms, and what of it is left, see `WheeledRobot`."""
        return self.freedom.allocated(q, tau)

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the q and v with which a reference begins, see `WheeledRobot.start`."""
        return self.begun(*self.robot.start(reference))

    def begun(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return q and v of one state, wheels steered to where they go, and rolling."""
        q, v = np.append(q, np.zeros(self.joints)), np.append(v, np.zeros(self.joints))
        n, ns = _BASE + self.na, len(self.table.axes)
        twist = [float(number(x)) for x in self.state(q, v).twist]
        q[n : n + ns] = [self.steered_to(axis, twist) for axis in self.table.axes]
        state = self.state(q, v)
        rows = self.kinematics.rows(state.steering, state.twist, state.rates)
        for joint, i in self.choice.joints:
            own = [float(number(x)) for x in rows[i].joints]
            known = float(number(dot(rows[i].base, state.twist))) + float(np.dot(own, v[n:]))
            v[n + joint] = -(known - own[joint] * v[n + joint]) / own[joint]
        return q, v

    def steered_to(self, axis: Axis, twist: Sequence[float]) -> float:
        """Return the steering angle at which a wheel goes where the body takes it; 0 at rest."""
        wheel = self.table.wheels[axis.wheels[0]]
        x, y = (wheel.x - axis.ackermann, 0.0) if axis.ackermann is not None else (wheel.x, wheel.y)
        ahead, aside = twist[0] - twist[2] * y, twist[1] + twist[2] * x
        angle = float(np.arctan2(aside, ahead)) - wheel.angle if ahead or aside else 0.0
        if wheel.motor is not None or axis.ackermann is not None:  # it may as well run backwards
            angle = (angle + np.pi / 2) % np.pi - np.pi / 2
        return angle


@final
@dataclass(frozen=True, eq=False)
class RollingDynamics(WheeledDynamics):
    """A robot whose wheels roll ideally, unchecked."""

    slips: ClassVar[bool] = False

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """Wheels, alone or together, as their lateral forces are determined; none on gear trains."""
        return groups_of(self)

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        """Return a = S nu' + gamma, S' M S nu' = S' (tau - n - M gamma), shape (..., nv)."""
        state = self.state(q, v)
        M, (S, gamma) = self.inertia(state, q), self.freedom.solution(state)
        force = self.generalised(state, u, f)
        effects = self.effects(state, q)
        felt = self.felt(state, gamma)
        rest = [t - n - dot(row, felt) for t, n, row in zip(force, effects, M, strict=True)]
        pushed, first = through(M, S), _BASE + self.na
        rates = _reduced(pushed, S, applied(transposed(S), rest))
        for k, limit in self.stops:
            outward = stop_of(state.steering[k], limit, state.rates[k])
            more = dot(S[first + k], rates) + gamma[first + k]
            rates = stopped(rates, outward, more, S[first + k], _reduced(pushed, S, S[first + k]))
        return self.in_plane(state, [dot(row, rates) + g for row, g in zip(S, gamma, strict=True)], q)

    def project(self, q: Any, v: Any) -> Any:
        """Return the velocity that rolls and is nearest in the mass metric, shape (..., nv).

        It is S (nu + x): nu is read off the velocity, and of what is then left over, which wheels and the
        body's motion across them alone have, S' M S x = S' M (v - S nu).
        """
        state = self.state(q, v)
        S, _ = self.freedom.solution(state)
        rates = self.freedom.velocities(state)
        off = self._off(state, S, rates)
        if not all(_is_zero(x) for x in off):  # many robots that start at rest need no mass matrix
            pushed = through(self.inertia(state, q), S)
            more = _reduced(pushed, S, applied(pushed, off))
            rates = [x + y for x, y in zip(rates, more, strict=True)]
        for k, limit in self.stops:
            row, pushed = S[_BASE + self.na + k], through(self.inertia(state, q), S)
            rates = stopped(
                rates, stop_of(state.steering[k], limit), dot(row, rates), row, _reduced(pushed, S, row)
            )
        return self.in_plane(state, [dot(row, rates) for row in S], q)

    def _off(self, state: State, S: Matrix, nu: Vector) -> Vector:
        """Return v - S nu, along the body's axes: zero for each coordinate that is one of nu itself."""
        held, first = self.choice.body, _BASE + self.na
        found: Vector = [ZERO] * self.size
        if len(held) == 1:
            rows = self.kinematics.rows(state.steering, state.twist, state.rates)
            a = rows[held[0]].base
            slip = dot(a, state.twist)
            found[:2] = [a[0] * slip, a[1] * slip]
        elif held:
            found[:_BASE] = [x - dot(row, nu) for x, row in zip(state.twist, S[:_BASE], strict=True)]
        for joint, _ in self.choice.joints:
            found[first + joint] = state.rates[joint] - dot(S[first + joint], nu)
        return found


def _is_zero(x: Any) -> bool:
    """Return whether a scalar is known to be zero, in all robots."""
    return x is ZERO or (isinstance(x, float | np.ndarray) and not np.any(x))


def through(M: Matrix, S: Matrix) -> Matrix:
    """Return S' M of a symmetric M."""
    return [applied(M, column) for column in transposed(S)]


def stop_of(angle: Any, limit: float, rate: Any = 0.0) -> Any:
    """Return 1 or -1, which way out is, at a steering stop that the angle has reached, and does not leave."""
    angle, rate = number(angle), number(rate)
    side = choose(angle >= limit, 1.0, choose(angle <= -limit, -1.0, 0.0))
    return choose(side * rate >= -_RESTING, side, 0.0)


def stopped(values: Vector, outward: Any, more: Any, row: Vector, response: Vector) -> Vector:
    """Return velocities or accelerations less what a stop takes from an axis that goes on outward.

    Parameters
    ----------
    values : list of scalars
        Of independent velocities, or of all.
    outward : scalar
        As of `stop_of`.
    more : scalar
        What the axis has.
    row, response : list of scalars
        The axis's rate per value, and values per impulse on the axis.
    """
    size = choose(outward * number(more) > 0.0, number(more) / number(dot(row, response)), 0.0)
    return [number(x - y * size) for x, y in zip(values, response, strict=True)]


def _reduced(through: Matrix, S: Matrix, right: Vector) -> Vector:
    """Return the solution of S' M S x = right, given S' M."""
    reduced = [applied(through, column) for column in transposed(S)]
    return solved_by(reduced, right, list(reversed(range(len(right)))))
