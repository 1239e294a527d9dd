"""`SlippingDynamics`: wheels that stick and slide with dry friction, for one state, many, or symbols.

These are the dynamics of a `WheeledRobot` on `Coulomb` ground. A step is implicit in the velocities along the
body's axes, where nothing depends on the pose; configurations, velocities and loads are those of mid-step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

from pinmobile.compiled import choose
from pinmobile.errors import InvalidArgument
from pinmobile.parts import by_value, child, integer, number as declared, part
from pinmobile.plant import Step
from pinmobile.robot import (
    ONE,
    ZERO,
    Matrix,
    Vector,
    dot,
    exact,
    factor,
    number,
    scalar_of,
    scalars,
    single,
    transpose,
    vector_of as stacked,
)
from pinmobile.wheels._contact import Bounds, Impulses, WheelContact, impulses, iterate
from pinmobile.wheels._dynamics import State, WheeledDynamics, mean_acceleration
from pinmobile.wheels._loads import ground_reaction, places_of, shared_loads
from pinmobile.wheels._motors import ExternalForceFunction, Motors, TorqueSpeedLine, column, theta
from pinmobile.wheels._rolling import Ramp, check_inertias, stop_axis, stop_of
from pinmobile.wheels._table import WheelTable

_BASE = 3
_SLIP_RATIO = 0.5  # smallest ratio of final and initial slip of a wheel that slides throughout a step
_SLIDES = 1 - 1e-9  # fraction of the largest friction from which a wheel slides
_PASSES = 40  # largest number of passes
_COARSER = 1e2  # tolerance of a pass, relative to weight and free fall, in tolerances of forces
_LEVEL = 1e2  # larger tolerance of passes that no longer improve, in tolerances of a pass


class ContactState(NamedTuple):
    """Contact state of a robot with dry friction, means over the last step.

    Attributes
    ----------
    forces : ndarray, shape (2 wheels,)
        Forces of the ground on each wheel, along and across [N].
    holding : ndarray
        Torques of rolling resistance, one per group of wheels that turn together [N m].
    multipliers : ndarray, shape (wheels,)
        Multipliers of the friction discs.
    acceleration : ndarray, shape (nv,)
        Rate of the velocities along the body's axes.
    loads : ndarray, shape (wheels + supports,)
        Loads [N].
    tips : float
        1 if no loads balance the robot.
    missed : float
        1 if the passes, or the iterations of the last one, did not converge.
    """

    forces: Any
    holding: Any
    multipliers: Any
    acceleration: Any
    loads: Any
    tips: Any
    missed: Any


class _Pass(NamedTuple):
    """Result of a pass of a step, as lists of scalars.

    Attributes
    ----------
    velocities : list of scalars
        Velocities at the end of the step.
    impulses, multipliers
        As in `Impulses`.
    guess, missing, way : list of 6 scalars
        Assumption of the pass: twist at the end of the step divided by the speed gained in a step of free
        fall, and fz, mx and my of the ground divided by the weight; residual of the pass before; and last
        change of the assumption.
    inverse : list of 36 scalars
        Inverse of the derivative of `missing`, by rows.
    slides : list of scalars, shape (wheels,)
        Whether each wheel may slide throughout the step.
    rates, torques : list of scalars, shape (actuators,)
        Rates and torques of driving motors.
    loads : list of scalars
        Loads of wheels and supports.
    tips, missed, passes : scalar
        As in `ContactState`, and number of passes.
    """

    velocities: Vector
    impulses: Vector
    multipliers: Vector
    guess: Vector
    missing: Vector
    way: Vector
    inverse: Vector
    slides: Vector
    rates: Vector
    torques: Vector
    loads: Vector
    tips: Any
    missed: Any
    passes: Any

    def next_guess(self, result: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """Return `guess`, `missing`, `way` and `inverse` of the next pass.

        The update is Broyden's method (Mathematics of Computation 19, 1965).

        Parameters
        ----------
        result : list of 6 scalars
            Result of this pass for the assumption.
        """
        n = len(result)
        missing = [y - x for x, y in zip(self.guess, result, strict=True)]
        change = [y - x for x, y in zip(self.missing, missing, strict=True)]
        rows = [self.inverse[n * k : n * (k + 1)] for k in range(n)]
        residual = [x - dot(row, change) for x, row in zip(self.way, rows, strict=True)]
        left = [dot(self.way, column) for column in zip(*rows, strict=True)]
        bottom = number(dot(left, change))
        given = (self.passes > 0.0) & (bottom != 0.0)
        share = choose(given, 1.0 / choose(given, bottom, 1.0), 0.0)
        rows = [
            [x + y * (share * z) for x, z in zip(row, left, strict=True)]
            for row, y in zip(rows, residual, strict=True)
        ]
        way = [number(-dot(row, missing)) for row in rows]
        guess = [x + y for x, y in zip(self.guess, way, strict=True)]
        return guess, missing, way, [x for row in rows for x in row]


class _Rub(NamedTuple):
    """Dry friction of a motor: actuator, number of the held velocity, its rate per that, and bound."""

    actuator: int
    at: int
    rate: float
    limit: Any


class _Shape(NamedTuple):
    """Robot at its mid-step configuration, in the velocities that gear trains leave free.

    Attributes
    ----------
    solve : callable
        Function from a generalised force to the acceleration.
    touches : list of WheelContact
        Contacts of the wheels, in the velocities that `friction_rows` numbers.
    friction_rows, rest : list of int
        Velocities that occur in rows of wheels, and the others.
    inertia : list of lists of scalars
        Reduced mass matrix of the former.
    columns : list of lists of scalars
        All velocities per impulse: along and across each wheel, and then of each held rate.
    """

    solve: Any
    touches: list[WheelContact]
    friction_rows: list[int]
    rest: list[int]
    inertia: Matrix
    columns: Matrix


@final
@dataclass(frozen=True, eq=False)
class SlippingDynamics(WheeledDynamics):
    """Dynamics of a robot whose wheels stick and slide with dry friction, without input validation.

    Parameters
    ----------
    ground : Coulomb
        The ground.
    rubbing : tuple of int
        Actuators with dry friction, each of wheels that turn together.
    """

    ground: Coulomb
    rubbing: tuple[int, ...] = ()

    forward_dynamics = mean_acceleration

    @cached_property
    def mu(self) -> Any:
        """Coefficients of friction, of rollers along their axes, shape (wheels,)."""
        values = [wheel.friction.mu for wheel in self.table.wheels]
        return column(values if self.ground.mu is None else [self.ground.mu] * len(values))

    # Gear trains

    @cached_property
    def _leaders(self) -> list[tuple[int, Any]]:
        """Leading velocity and rate ratio of each velocity: wheels of a train follow the first one."""
        first = self.of_body + len(self.table.axes)
        leaders: list[tuple[int, Any]] = [(i, ONE) for i in range(self.nv)]
        for row, (leader, ratio) in enumerate(gear_ratios(self.table)):
            leaders[first + row] = first + leader, exact(ratio)
        return leaders

    @cached_property
    def _leading(self) -> list[int]:
        """Velocities that follow no other."""
        return [i for i, (leader, _) in enumerate(self._leaders) if leader == i]

    def _to_free(self, full: Vector) -> Vector:
        """Return the force on the kept velocities for a force on all velocities."""
        forces: dict[int, Any] = dict.fromkeys(self._leading, ZERO)
        for x, (leader, ratio) in zip(full, self._leaders, strict=True):
            forces[leader] = forces[leader] + ratio * x
        return list(forces.values())

    def _from_leaders(self, leading: Vector) -> Vector:
        """Return all velocities from the kept ones."""
        of = dict(zip(self._leading, leading, strict=True))
        return [number(ratio * of[leader]) for leader, ratio in self._leaders]

    # The ground

    def _friction(self, name: str) -> Vector:
        """Return a number of the friction of each wheel."""
        return [exact(x) for x in scalars(column([getattr(one.friction, name) for one in self.table.wheels]))]

    @cached_property
    def _spins(self) -> list[int]:
        """Kept velocity of each wheel."""
        first = self.of_body + len(self.table.axes)
        return [self._leading.index(self._leaders[first + row][0]) for row in range(len(self.table))]

    @cached_property
    def _has_hold(self) -> list[bool]:
        """Whether rolling resistance or friction of motors holds each group of wheels that turn as one."""
        first = self.of_body + len(self.table.axes)
        rolling = [row for row, share in enumerate(self._friction("rolling")) if share is not ZERO]
        leaders = {self._leaders[first + row][0] for row in rolling}
        leaders |= {self.turned_by(k)[0][0] for k in self.rubbing}
        return [self._leading[spin] in leaders for spin in dict.fromkeys(self._spins)]

    def turned_by(self, actuator: int) -> list[tuple[int, Any]]:
        """Return the kept velocities that an actuator turns, with its rate per each of them."""
        shares: dict[int, Any] = {}
        for i, share in enumerate(self.table.actuators[actuator].column, self.of_body):
            leader, ratio = self._leaders[i]
            shares[leader] = shares.get(leader, ZERO) + exact(share) * ratio
        return [(i, x) for i, x in shares.items() if x is not ZERO]

    def _shape(self, state: State, q: Any, h: Any, lag: Sequence[Any] = ()) -> _Shape:
        """Return the robot at a configuration for a step; `lag` adds rotor inertia for stiff motors."""
        M = self.inertia(state, q)
        for actuator, rotor in zip(self.table.actuators, lag, strict=False):
            for i, a in enumerate(actuator.column, self.of_body):
                for j, b in enumerate(actuator.column, self.of_body):
                    M[i][j] = M[i][j] + exact(a * b) * rotor
        half = transpose([self._to_free(row) for row in M])
        inertias = transpose([self._to_free(column) for column in half])
        rows = self.kinematics.rows(state.steering, [ZERO] * _BASE, [ZERO] * self.joints, across=True)
        pairs: list[list[Vector]] = [[] for _ in self.table.wheels]
        for row in rows:
            if row.wheel >= 0:
                pairs[row.wheel].append(self._to_free([*row.base, *[ZERO] * self.na, *row.joints]))
        n, spins = len(self._leading), self._spins
        holds = [
            spin for spin, has_hold in zip(dict.fromkeys(spins), self._has_hold, strict=True) if has_hold
        ]
        contact_rows = [
            k for k in range(n) if k in spins or any(row[k] is not ZERO for pair in pairs for row in pair)
        ]
        rest = [k for k in range(n) if k not in contact_rows]
        solve, inertia = factor(inertias, rest)
        columns = [solve(row) for pair in pairs for row in pair]
        units = {spin: solve([ONE if k == spin else ZERO for k in range(n)]) for spin in dict.fromkeys(spins)}

        def select(x: Vector) -> Vector:
            return [x[k] for k in contact_rows]

        contacts, slip = [], self._friction("slip")
        for k, (pair, wheel, spin) in enumerate(zip(pairs, self.table.wheels, spins, strict=True)):
            turn = contact_rows.index(spin), select(units[spin])
            slips = [*map(select, pair)], [*map(select, columns[2 * k : 2 * k + 2])]
            contacts.append(WheelContact(*slips, *turn, wheel.roller is None, slip[k] / h, spin in holds))
        return _Shape(solve, contacts, contact_rows, rest, inertia, [*columns, *(units[k] for k in holds)])

    def _rolling_view(self, state: State, rate: Vector) -> tuple[State, Vector]:
        """Return a state, and proper accelerations in the plane along the body's axes."""
        vx, vy, w = state.twist
        return state, self.proper_acceleration(state, [rate[0] - w * vy, rate[1] + w * vx, *rate[2:]])

    def _bounds(
        self, shape: _Shape, loads: Vector, slips: list[Vector], h: Any, rubs: Sequence[_Rub]
    ) -> list[Bounds]:
        """Return the bounds of each wheel's friction."""
        first, bounds = self.of_body + len(self.table.axes), []
        holds: dict[int, Any] = {}
        for k, (share, r) in enumerate(zip(self._friction("rolling"), scalars(self.radius), strict=True)):
            spin, ratio = shape.touches[k].spin, abs(float(self._leaders[first + k][1]))
            holds[spin] = holds.get(spin, ZERO) + h * (exact(ratio) * share * r) * loads[k]
        for rub in rubs:
            holds[rub.at] = holds[rub.at] + rub.limit
        for k, (wheel, share) in enumerate(zip(self.table.wheels, self._friction("across"), strict=True)):
            along = number(h * scalars(self.mu)[k] * loads[k])
            across = along if wheel.roller is None else number(h * share * loads[k])
            bounds.append(Bounds(along, across, number(holds[shape.touches[k].spin]), slips[k]))
        return bounds

    def _rubs(self, shape: _Shape, pushes: Sequence[TorqueSpeedLine], h: Any) -> list[_Rub]:
        """Return the dry friction of motors."""
        rubs = []
        for k in self.rubbing if pushes else ():
            ((leader, share),) = self.turned_by(k)
            row, rate = shape.friction_rows.index(self._leading.index(leader)), float(share)
            rubs.append(_Rub(k, row, rate, h * exact(abs(rate)) * pushes[k].hold))
        return rubs

    def _began(
        self, shape: _Shape, first: Vector, last: Vector, slides: Vector
    ) -> tuple[list[Vector], Vector]:
        """Return the slip of each wheel at the start of a step, zero for wheels that do not slide throughout.

        Also return which wheels slide throughout; later passes never set this again, so that iterations end.
        Friction against the mean slip is of second order and dissipates the right energy, but does not stick.
        Therefore a wheel that loses half its slip in the step is treated by its slip at the end, as is one
        whose force is proportional to its slip.
        """
        slips, goes_on = [], []
        rows = zip(shape.touches, self.table.wheels, self._friction("slip"), slides, strict=True)
        for touch, wheel, slip, on in rows:
            if slip is not ZERO:
                slips.append([0.0, 0.0])
                goes_on.append(on)
                continue
            old, new = (
                [number(dot(row, [x[self._leading[k]] for k in shape.friction_rows])) for row in touch.rows]
                for x in (first, last)
            )
            left = [x * (y - _SLIP_RATIO * x) for x, y in zip(old, new, strict=True)]
            if wheel.roller is None:
                left = [left[0] + left[1]] * 2
            slips.append([choose((x > 0.0) & (on > 0.0), y, 0.0) for x, y in zip(left, old, strict=True)])
            goes_on.append(choose((left[0] > 0.0) | (left[1] > 0.0), on, 0.0))
        return slips, goes_on

    # The step

    def initial_state(self, context: Any = None) -> ContactState:
        """Return the contact state before the first step: no slip, and loads at rest."""
        del context
        k, zeros_v = len(self.table), [ZERO] * self.nv
        q = np.concatenate([np.zeros(_BASE), self.robot.rest[_BASE:], np.zeros(self.joints)])
        state = self.state(q, np.zeros(self.nv))
        reaction = ground_reaction(self, *self._rolling_view(state, zeros_v), q)
        loads = shared_loads(places_of(self, state.steering), *reaction)
        zeros = np.zeros(2 * k), np.zeros(len(self._has_hold)), np.zeros(k), np.zeros(self.nv)
        return ContactState(*zeros, stacked(loads.values, q), 0.0, 0.0)

    def step(
        self, t: Any, q: Any, v: Any, u: Any, h: Any, f: ExternalForceFunction, memory: ContactState
    ) -> Step:
        """Return the state after a step, and the memory for the next.

        Parameters
        ----------
        t : float
            Time [s].
        q, v : ndarray, shape (..., nq), (..., nv)
            State.
        u : ndarray, shape (..., nu)
            Torques in the step.
        h : float
            Length of the step [s].
        f : callable
            ``f(t, q, v)``: external generalised force, shape (..., nv), or 0.0.
        memory : ContactState
            Memory of the step before.
        """
        return self.driven(q, v, u, h, lambda q, v: f(t + 0.5 * h, q, v), memory)[0]

    def driven(
        self, q: Any, v: Any, u: Any, h: Any, f: Any, memory: ContactState, motors: Motors | None = None
    ) -> tuple[Step, Vector, Vector]:
        """Return the state after a step, and torques and rates of actuators that motors drive.

        Parameters
        ----------
        f : callable
            ``f(q, v)``: external force at the state of mid-step.
        motors : callable, optional
            ``motors(rates, clips)``: `TorqueSpeedLine` of each actuator at its rate; `clips` is False for a
            first guess. Without it, `u` contains the torques.
        """
        h = number(single(h))
        state = self.state(q, v)
        start_v = state.velocities
        middle = state  # its configuration is that of mid-step, by the present velocity
        if self.na or self.table.axes:
            predicted = self.state(self.integrate(q, (0.5 * h) * v), v)
            middle = state._replace(arms=predicted.arms, steering=predicted.steering)
        psi, start_rates = scalars(q)[2], self.actuator_rates(state.rates)
        external = f(self.integrate(q, (0.5 * h) * v), v)
        has_external = not (np.ndim(external) == 0 and not isinstance(external, np.ndarray) and external == 0)
        turning = has_external or bool(self.fall[0] or self.fall[1])
        fixed = self._shape(middle, q, h) if motors is None else None
        places = places_of(self, middle.steering)
        size, little = sum((dot(x, x) for x in places), ZERO), _COARSER * self.ground.tolerance

        def at_mean(end: Vector) -> tuple[State, Vector]:
            mean = [0.5 * (x + y) for x, y in zip(start_v, end, strict=True)]
            state_m = middle.moving(mean)
            return (state_m.with_psi(psi + 0.5 * h * mean[2]) if turning else state_m), mean

        gain = h * abs(float(self.fall[2])) if self.fall[2] else 1.0
        scales = [gain] * _BASE + [number(single(self.weight)) if self.fall[2] else 1.0] * 3

        def outcome(end: Vector) -> Vector:
            rate = [(y - x) / h for x, y in zip(start_v, end, strict=True)]
            reaction = ground_reaction(self, *self._rolling_view(at_mean(end)[0], rate), q)
            return [x / scale for x, scale in zip([*end[:_BASE], *reaction], scales, strict=True)]

        def iteration(*parts: Any) -> tuple[_Pass, Any]:
            x = _Pass(*parts)
            values = [y * scale for y, scale in zip(x.guess, scales, strict=True)]
            end = [*values[:_BASE], *x.velocities[_BASE:]]
            state_m, mean = at_mean(end)
            force = external
            if has_external:
                mean_v = self.in_plane(state_m, mean, q)
                force = f(self.integrate(q, (0.5 * h) * mean_v), mean_v)
            loads = shared_loads(places, *values[_BASE:])
            pushes, shares, lag, torques = list[TorqueSpeedLine](), list[Any](), list[Any](), u
            if motors is not None:
                pushes = motors(x.rates, x.passes > 0.0)
                shares = [
                    theta(h * push.slope * y) if push.slope is not ZERO else ZERO
                    for push, y in zip(pushes, self._freedom(middle, q), strict=True)
                ]
                lag = [h * y * push.slope for push, y in zip(pushes, shares, strict=True)]
                given = [push.torque - push.slope * y for push, y in zip(pushes, start_rates, strict=True)]
                torques = stacked([*scalars(u)[: self.na], *given], q)
            body = self._shape(middle, q, h, lag) if fixed is None else fixed
            free = self._free(body, state_m, start_v, torques, h, force, q)
            began, slides = self._began(body, start_v, end, x.slides)
            rubs = self._rubs(body, pushes, h)
            bounds = self._bounds(body, loads.values, began, h, rubs)
            start, free_v = Impulses([], *x[1:3]), [number(free[k]) for k in body.friction_rows]
            grip = impulses(body.touches, bounds, free_v, body.inertia, start, self.ground)
            end_v = self._end_velocities(body, free, grip)
            for k, limit in self.stops:
                unit = [ONE if i == self.of_body + k else ZERO for i in range(self.nv)]
                response = self._from_leaders(body.solve(self._to_free(unit)))
                rate = end_v[self.of_body + k]
                angle = state.steering[k] + (0.5 * h) * (state.rates[k] + rate)
                end_v = stop_axis(end_v, stop_of(angle, limit), rate, unit, response)
            given, rates = [], []
            if motors is not None:
                ends = self.actuator_rates(end_v[self.of_body :])
                rates = [number(y + z * (e - y)) for y, e, z in zip(start_rates, ends, shares, strict=True)]
                given = [push.torque - push.slope * y for push, y in zip(pushes, rates, strict=True)]
                pairs = zip(body.touches, bounds, strict=True)
                holds = {touch.spin: bound.spin for touch, bound in pairs if touch.is_held}
                for rub in rubs:  # its share of the torque that holds a wheel
                    total = holds[rub.at]
                    part = rub.limit / choose(total > 0.0, total, 1.0)
                    impulse = grip.impulses[2 * len(self.table) + list(holds).index(rub.at)]
                    given[rub.actuator] = given[rub.actuator] + impulse * part / (h * rub.rate)
            better = x.next_guess(outcome(end_v))
            error, old_error = (
                dot(each[:_BASE], each[:_BASE]) + each[_BASE] * each[_BASE] + dot(each[4:], each[4:]) / size
                for each in (better[1], x.missing)
            )
            stays = (x.passes > 0.0) & (error <= (_LEVEL * little) ** 2) & (error >= old_error)
            is_done = (error <= little * little) | stays
            last = loads.tips, choose(is_done, grip.missed, 1.0), x.passes + 1.0
            result = _Pass(end_v, *grip[1:3], *better, slides, rates, given, loads.values, *last)
            return result, is_done

        guess = [x + h * y for x, y in zip(start_v, scalars(memory.acceleration), strict=True)]
        torques = zip(scalars(memory.holding), self._has_hold, strict=True)
        forces = [*scalars(memory.forces), *(x for x, has_hold in torques if has_hold)]
        turns = [] if motors is None else start_rates
        first = [guess, [number(x) * h for x in forces], list(map(number, scalars(memory.multipliers)))]
        first += [outcome(guess), [0.0] * 6, [0.0] * 6]
        first += [[-1.0 if i == j else 0.0 for i in range(6) for j in range(6)], [1.0] * len(self.table)]
        start = _Pass(*first, *[turns, turns, [0.0] * len(places), 0.0, 1.0, 0.0])
        solution, m = _Pass(*iterate(iteration, start, _PASSES)), 2 * len(self.table)
        end_v, mean = solution.velocities, at_mean(solution.velocities)[1]
        on_the_way = self.in_plane(state.with_psi(psi + 0.5 * h * mean[2]), [h * x for x in mean], q)
        new_q = self.integrate(q, on_the_way)
        holding = iter(solution.impulses[m:])
        contact = ContactState(
            stacked([x / h for x in solution.impulses[:m]], q),
            stacked([next(holding) / h if has_hold else 0.0 for has_hold in self._has_hold], q),
            stacked(solution.multipliers, q),
            stacked([(y - x) / h for x, y in zip(start_v, end_v, strict=True)], q),
            stacked(solution.loads, q),
            *(scalar_of(x, q) for x in (solution.tips, solution.missed)),
        )
        step = Step(new_q, self.in_plane(state.with_psi(psi + h * mean[2]), end_v, q), contact)
        return step, solution.torques, solution.rates

    def _freedom(self, state: State, q: Any) -> Vector:
        """Return the rate of each actuator per angular impulse, with other velocities unchanged."""
        M, rates = self.inertia(state, q), []
        weights = [self._to_free(list(row)) for row in M]
        inertias = {i: self._to_free([row[k] for row in weights])[k] for k, i in enumerate(self._leading)}
        for k in range(len(self.table.actuators)):
            shares = self.turned_by(k)
            rates.append(number(dot([x * x for _, x in shares], [1.0 / inertias[i] for i, _ in shares])))
        return rates

    def _free(self, shape: _Shape, middle: State, start_v: Vector, u: Any, h: Any, f: Any, q: Any) -> Vector:
        """Return the kept velocities after a step without friction."""
        force, effects, pull = self.input_force(middle, u, f), self.effects(middle, q), self.pull(middle)
        a = shape.solve(self._to_free([x - y for x, y in zip(force, effects, strict=True)]))
        vx, vy, w = middle.twist
        a[0], a[1] = a[0] + pull[0] + w * vy, a[1] + pull[1] - w * vx
        return [start_v[i] + h * x for i, x in zip(self._leading, a, strict=True)]

    def _end_velocities(self, shape: _Shape, free: Vector, grip: Impulses) -> Vector:
        """Return all velocities at the end of a step."""
        velocities = list(free)
        for k, x in zip(shape.friction_rows, grip.velocity, strict=True):
            velocities[k] = x
        for k in shape.rest:
            velocities[k] = free[k] + dot([column[k] for column in shape.columns], grip.impulses)
        return self._from_leaders(velocities)

    def signals(
        self, t: Any, q: Any, v: Any, u: Any, f: Any, memory: ContactState
    ) -> dict[str, tuple[str, Any]]:
        """Return the ground's signals of the step before, a row of wheels for each.

        ``along``, ``across`` and ``loads`` [N], with supports last; present ``slip_along`` and
        ``slip_across`` [m/s]; ``slides``, 1 if friction has its largest value; ``tips``, 1 if no loads
        balance the robot; ``missed``, 1 if loads and forces did not converge to the tolerance of the ground.
        """
        del t, u, f
        state = self.state(q, v)
        rows = self.rows(state, across=True)
        slips = [row.slip(state) for row in rows if row.wheel >= 0]
        forces, k = memory.forces, len(self.table)
        along, across = forces[..., 0::2], forces[..., 1::2]
        rollers = np.array([wheel.roller is not None for wheel in self.table.wheels])
        size = np.where(rollers, np.abs(along), np.sqrt(along * along + across * across))
        bound = self.mu * memory.loads[..., :k]
        return {
            "along": ("N", along),
            "across": ("N", across),
            "loads": ("N", memory.loads),
            "slip_along": ("m/s", stacked(slips[0::2], q)),
            "slip_across": ("m/s", stacked(slips[1::2], q)),
            "slides": ("", np.where((bound > 0.0) & (size >= _SLIDES * bound), 1.0, 0.0)),
            "tips": ("", memory.tips),
            "missed": ("", memory.missed),
        }


def gear_ratios(table: WheelTable) -> list[tuple[int, float]]:
    """Return the leading wheel and rate ratio of each wheel; without a gear train, the wheel itself.

    Raises
    ------
    InvalidArgument
        If trains that share wheels contradict each other.
    """
    ratios = [(row, 1.0) for row in range(len(table))]
    for first, row, times in table.trains:
        (a, of_a), (b, of_b) = ratios[first], ratios[row]
        if a == b and abs(of_b - times * of_a) > 1e-12 * abs(of_b):
            raise InvalidArgument(
                f"couplings turns wheel {table.names[row]!r} at two rates, expected consistent gear trains"
            )
        share = of_a * times / of_b  # followers of b now follow a; this is the ratio of b's rate and a's
        ratios = [(a, share * x) if leader == b != a else (leader, x) for leader, x in ratios]
    return ratios


@final
@part
@by_value
class Coulomb:
    """Ground with dry friction: wheels stick while friction can hold them, and slide beyond (Coulomb's law).

    A robot on this ground has its own step, which is implicit in the velocities. It computes the impulses of
    all wheels together: sticking wheels are exactly at rest, and no equation is stiff. Steps of 0.01 s or
    less are appropriate. The error decreases with the square of the step for fixed wheels, and linearly for
    steered ones.

    Loads depend on accelerations, accelerations on friction, and friction on loads: a step solves for all of
    them. If friction presses on the wheels that cause it, there may be several solutions. The step takes the
    solution near the accelerations of the step before. Signals describe it: ``slides``, ``loads``, ``tips``,
    1 if no loads balance the robot, and ``missed``, 1 if the step found no solution.

    Parameters
    ----------
    mu : float, optional
        Coefficient of friction of all wheels, >= 0, along the axes of rollers if there are any; None: that of
        each wheel, ``wheel.friction.mu``.
    ramp : Ramp, optional
        Inclination of the ground; None: level ground.
    sweeps : int
        Largest number of iterations over all wheels in a pass; the signal ``missed`` is 1 if there were too
        few.
    tolerance : float
        Change of a force per iteration at which it has converged, relative to the largest friction, > 0.

    Attributes
    ----------
    slips : bool
        Whether wheels may slip, here True.

    Raises
    ------
    InvalidArgument
        If a number is not in its range; in a robot, if its height or its support polygon is unknown, gear
        trains contradict each other, or a wheel has no inertia.

    See Also
    --------
    Rolling : ground without slip
    wheels.WheelFriction : friction of each wheel
    wheels.Ramp : inclination

    Examples
    --------
    >>> from pinmobile import Coulomb, MobileRobot, WheeledRobot
    >>> from pinmobile import WheelTable
    >>> table = WheelTable.skid_steer(
    ...     wheelbase=0.4, track=0.3, radius=0.1, spin_inertia=0.01)
    >>> body = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> for mu in 0.8, 0.1:  # on dry ground and on ice
    ...     robot = WheeledRobot(body, table, Coulomb(mu))
    ...     still = 0 * robot.rest
    ...     a = robot.forward_dynamics(robot.rest, still, [4.0, 4.0])
    ...     print(f"{a[0]:.2f} m/s^2")
    2.27 m/s^2
    0.98 m/s^2
    """

    mu: float | None = declared(default=None, lower=0, doc="coefficient of friction of all wheels")
    ramp: Ramp | None = child(Ramp, default=None, expected="a Ramp(angle, direction) or None")
    sweeps: int = integer(default=200, least=1, doc="largest number of iterations in a pass")
    tolerance: float = declared(default=1e-12, above=0, fixed=True, doc="relative tolerance of forces")
    slips: ClassVar[bool] = True

    def dynamics(self, wheeled: Any) -> SlippingDynamics:
        """Return the dynamics of a robot on this ground.

        Parameters
        ----------
        wheeled : WheeledRobot
            The robot.
        """
        return SlippingDynamics(wheeled, wheeled.robot.array_dynamics, self)

    def check_robot(self, wheeled: Any) -> None:
        """Check that a robot can stand on this ground.

        Parameters
        ----------
        wheeled : WheeledRobot
            The robot.

        Raises
        ------
        InvalidArgument
            If its slip cannot be computed.
        """
        wheeled.check_stands()
        gear_ratios(wheeled.table)
        check_inertias(wheeled, range(len(wheeled.joint_inertias)))
