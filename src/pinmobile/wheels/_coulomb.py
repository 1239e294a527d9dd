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
    factored,
    number,
    scalar_of,
    scalars,
    single,
    transposed,
    vector_of as stacked,
)
from pinmobile.wheels._contact import Bounds, Impulses, WheelContact, impulses, iterated
from pinmobile.wheels._dynamics import State, WheeledDynamics, mean_acceleration
from pinmobile.wheels._loads import ground_reaction, places_of, shared_loads
from pinmobile.wheels._motors import ExternalForceFunction, Motors, TorqueSpeedLine, theta
from pinmobile.wheels._rolling import Ramp, check_inertias, stop_of, stopped
from pinmobile.wheels._table import WheelTable, column

_BASE = 3
_STILL = 0.5  # smallest ratio of final and initial slip of a wheel that slides throughout a step
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
    after : list of scalars
        Velocities at the end of the step.
    impulses, multipliers
        As in `Impulses`.
    assumed, missing, way : list of 6 scalars
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

    after: Vector
    impulses: Vector
    multipliers: Vector
    assumed: Vector
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

    def corrected(self, found: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """Return `assumed`, `missing`, `way` and `inverse` of the next pass.

        The update is Broyden's method (Mathematics of Computation 19, 1965).

        Parameters
        ----------
        found : list of 6 scalars
            Result of this pass for the assumption.
        """
        n = len(found)
        missing = [y - x for x, y in zip(self.assumed, found, strict=True)]
        change = [y - x for x, y in zip(self.missing, missing, strict=True)]
        rows = [self.inverse[n * k : n * (k + 1)] for k in range(n)]
        off = [x - dot(row, change) for x, row in zip(self.way, rows, strict=True)]
        left = [dot(self.way, column) for column in zip(*rows, strict=True)]
        bottom = number(dot(left, change))
        given = (self.passes > 0.0) & (bottom != 0.0)
        share = choose(given, 1.0 / choose(given, bottom, 1.0), 0.0)
        rows = [
            [x + y * (share * z) for x, z in zip(row, left, strict=True)]
            for row, y in zip(rows, off, strict=True)
        ]
        way = [number(-dot(row, missing)) for row in rows]
        assumed = [x + y for x, y in zip(self.assumed, way, strict=True)]
        return assumed, missing, way, [x for row in rows for x in row]


class _Rub(NamedTuple):
    """Dry friction of a motor: actuator, number of the held velocity, its rate per that, and bound."""

    actuator: int
    at: int
    rate: float
    most: Any


class _Shape(NamedTuple):
    """Robot at its mid-step configuration, in the velocities that gear trains leave free.

    Attributes
    ----------
    solve : callable
        Function from a generalised force to the acceleration.
    touches : list of WheelContact
        Contacts of the wheels, in the velocities that `touched` numbers.
    touched, rest : list of int
        Velocities that occur in rows of wheels, and the others.
    inertia : list of lists of scalars
        Reduced mass matrix of the former.
    columns : list of lists of scalars
        All velocities per impulse: along and across each wheel, and then of each held rate.
    """

    solve: Any
    touches: list[WheelContact]
    touched: list[int]
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

    @cached_property
    def mu(self) -> Any:
        """Coefficients of friction, of rollers along their axes, shape (wheels,)."""
        own = [wheel.friction.mu for wheel in self.table.wheels]
        return column(own if self.ground.mu is None else [self.ground.mu] * len(own))

    # Gear trains

    @cached_property
    def _leaders(self) -> list[tuple[int, Any]]:
        """Leading velocity and rate ratio of each velocity: wheels of a train follow the first one."""
        first = self.of_body + len(self.table.axes)
        found: list[tuple[int, Any]] = [(i, ONE) for i in range(self.nv)]
        for row, (leader, ratio) in enumerate(gear_ratios(self.table)):
            found[first + row] = first + leader, exact(ratio)
        return found

    @cached_property
    def _kept(self) -> list[int]:
        """Velocities that follow no other."""
        return [i for i, (leader, _) in enumerate(self._leaders) if leader == i]

    def _reduced(self, full: Vector) -> Vector:
        """Return the force on the kept velocities for a force on all velocities."""
        found: dict[int, Any] = dict.fromkeys(self._kept, ZERO)
        for x, (leader, ratio) in zip(full, self._leaders, strict=True):
            found[leader] = found[leader] + ratio * x
        return list(found.values())

    def _whole(self, kept: Vector) -> Vector:
        """Return all velocities from the kept ones."""
        of = dict(zip(self._kept, kept, strict=True))
        return [number(ratio * of[leader]) for leader, ratio in self._leaders]

    # The ground

    def _friction(self, name: str) -> Vector:
        """Return a number of the friction of each wheel."""
        return [exact(x) for x in scalars(column([getattr(one.friction, name) for one in self.table.wheels]))]

    @cached_property
    def _spins(self) -> list[int]:
        """Kept velocity of each wheel."""
        first = self.of_body + len(self.table.axes)
        return [self._kept.index(self._leaders[first + row][0]) for row in range(len(self.table))]

    @cached_property
    def _holds(self) -> list[bool]:
        """Whether rolling resistance or friction of motors holds each group of wheels that turn as one."""
        first = self.of_body + len(self.table.axes)
        rolling = [row for row, share in enumerate(self._friction("rolling")) if share is not ZERO]
        resisted = {self._leaders[first + row][0] for row in rolling}
        resisted |= {self.turned_by(k)[0][0] for k in self.rubbing}
        return [self._kept[at] in resisted for at in dict.fromkeys(self._spins)]

    def turned_by(self, actuator: int) -> list[tuple[int, Any]]:
        """Return the kept velocities that an actuator turns, with its rate per each of them."""
        found: dict[int, Any] = {}
        for i, share in enumerate(self.table.actuators[actuator].column, self.of_body):
            leader, ratio = self._leaders[i]
            found[leader] = found.get(leader, ZERO) + exact(share) * ratio
        return [(i, x) for i, x in found.items() if x is not ZERO]

    def _shape(self, state: State, q: Any, h: Any, lag: Sequence[Any] = ()) -> _Shape:
        """Return the robot at a configuration for a step; `lag` adds rotor inertia for stiff motors."""
        M = self.inertia(state, q)
        for actuator, more in zip(self.table.actuators, lag, strict=False):
            for i, a in enumerate(actuator.column, self.of_body):
                for j, b in enumerate(actuator.column, self.of_body):
                    M[i][j] = M[i][j] + exact(a * b) * more
        halved = transposed([self._reduced(row) for row in M])
        reduced = transposed([self._reduced(column) for column in halved])
        rows = self.kinematics.rows(state.steering, [ZERO] * _BASE, [ZERO] * self.joints, across=True)
        pairs: list[list[Vector]] = [[] for _ in self.table.wheels]
        for row in rows:
            if row.wheel >= 0:
                pairs[row.wheel].append(self._reduced([*row.base, *[ZERO] * self.na, *row.joints]))
        n, spins = len(self._kept), self._spins
        held = [at for at, holds in zip(dict.fromkeys(spins), self._holds, strict=True) if holds]
        touched = [
            k for k in range(n) if k in spins or any(row[k] is not ZERO for pair in pairs for row in pair)
        ]
        rest = [k for k in range(n) if k not in touched]
        solve, inertia = factored(reduced, rest)
        columns = [solve(row) for pair in pairs for row in pair]
        units = {at: solve([ONE if k == at else ZERO for k in range(n)]) for at in dict.fromkeys(spins)}

        def over(x: Vector) -> Vector:
            return [x[k] for k in touched]

        touches, slip = [], self._friction("slip")
        for k, (pair, wheel) in enumerate(zip(pairs, self.table.wheels, strict=True)):
            pushed, at = columns[2 * k : 2 * k + 2], spins[k]
            spin = touched.index(at), over(units[at])
            give, disc = slip[k] / h, wheel.roller is None
            own = [*map(over, pair)], [*map(over, pushed)]
            touches.append(WheelContact(*own, *spin, disc, give, at in held))
        return _Shape(solve, touches, touched, rest, inertia, [*columns, *(units[at] for at in held)])

    def _seen(self, state: State, rate: Vector) -> tuple[State, Vector]:
        """Return a state, and proper accelerations in the plane along the body's axes."""
        vx, vy, w = state.twist
        return state, self.proper_acceleration(state, [rate[0] - w * vy, rate[1] + w * vx, *rate[2:]])

    def _bounds(
        self, shape: _Shape, loads: Vector, slips: list[Vector], h: Any, rubs: Sequence[_Rub]
    ) -> list[Bounds]:
        """Return the bounds of each wheel's friction."""
        first, found = self.of_body + len(self.table.axes), []
        holds: dict[int, Any] = {}
        for k, (share, r) in enumerate(zip(self._friction("rolling"), scalars(self.radius), strict=True)):
            at, ratio = shape.touches[k].spin, abs(float(self._leaders[first + k][1]))
            holds[at] = holds.get(at, ZERO) + h * (exact(ratio) * share * r) * loads[k]
        for rub in rubs:
            holds[rub.at] = holds[rub.at] + rub.most
        for k, (wheel, share) in enumerate(zip(self.table.wheels, self._friction("across"), strict=True)):
            along = number(h * scalars(self.mu)[k] * loads[k])
            across = along if wheel.roller is None else number(h * share * loads[k])
            found.append(Bounds(along, across, number(holds[shape.touches[k].spin]), slips[k]))
        return found

    def _rubs(self, shape: _Shape, pushes: Sequence[TorqueSpeedLine], h: Any) -> list[_Rub]:
        """Return the dry friction of motors."""
        found = []
        for k in self.rubbing if pushes else ():
            ((leader, share),) = self.turned_by(k)
            at, rate = shape.touched.index(self._kept.index(leader)), float(share)
            found.append(_Rub(k, at, rate, h * exact(abs(rate)) * pushes[k].hold))
        return found

    def _began(
        self, shape: _Shape, before: Vector, after: Vector, slides: Vector
    ) -> tuple[list[Vector], Vector]:
        """Return the slip of each wheel at the start of a step, zero for wheels that do not slide throughout.

        Also return which wheels slide throughout; later passes never set this again, so that iterations end.
        Friction against the mean slip is of second order and dissipates the right energy, but does not stick.
        Therefore a wheel that loses half its slip in the step is treated by its slip at the end, as is one
        whose force is proportional to its slip.
        """
        found, goes_on = [], []
        rows = zip(shape.touches, self.table.wheels, self._friction("slip"), slides, strict=True)
        for touch, wheel, slip, on in rows:
            if slip is not ZERO:
                found.append([0.0, 0.0])
                goes_on.append(on)
                continue
            old, new = (
                [number(dot(row, [x[self._kept[k]] for k in shape.touched])) for row in touch.rows]
                for x in (before, after)
            )
            left = [x * (y - _STILL * x) for x, y in zip(old, new, strict=True)]
            if wheel.roller is None:
                left = [left[0] + left[1]] * 2
            found.append([choose((x > 0.0) & (on > 0.0), y, 0.0) for x, y in zip(left, old, strict=True)])
            goes_on.append(choose((left[0] > 0.0) | (left[1] > 0.0), on, 0.0))
        return found, goes_on

    # The step

    def initial_state(self, context: Any = None) -> ContactState:
        """Return the contact state before the first step: no slip, and loads at rest."""
        del context
        k, still = len(self.table), [ZERO] * self.nv
        q = np.concatenate([np.zeros(_BASE), self.robot.rest[_BASE:], np.zeros(self.joints)])
        state = self.state(q, np.zeros(self.nv))
        exerted = ground_reaction(self, *self._seen(state, still), q)
        found = shared_loads(places_of(self, state.steering), *exerted)
        zeros = np.zeros(2 * k), np.zeros(len(self._holds)), np.zeros(k), np.zeros(self.nv)
        return ContactState(*zeros, stacked(found.values, q), 0.0, 0.0)

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
        before = state.velocities
        middle = state  # its configuration is that of mid-step, by the present velocity
        if self.na or self.table.axes:
            there = self.state(self.integrate(q, (0.5 * h) * v), v)
            middle = state._replace(arms=there.arms, steering=there.steering)
        psi, begun = scalars(q)[2], self.actuator_rates(state.rates)
        beside = f(self.integrate(q, (0.5 * h) * v), v)
        pushed = not (np.ndim(beside) == 0 and not isinstance(beside, np.ndarray) and beside == 0)
        turning = pushed or bool(self.fall[0] or self.fall[1])
        fixed = self._shape(middle, q, h) if motors is None else None
        places = places_of(self, middle.steering)
        size, little = sum((dot(x, x) for x in places), ZERO), _COARSER * self.ground.tolerance

        def at_mean(after: Vector) -> tuple[State, Vector]:
            mean = [0.5 * (x + y) for x, y in zip(before, after, strict=True)]
            at = middle.moving(mean)
            return (at.turned(psi + 0.5 * h * mean[2]) if turning else at), mean

        gained = h * abs(float(self.fall[2])) if self.fall[2] else 1.0
        scales = [gained] * _BASE + [number(single(self.weight)) if self.fall[2] else 1.0] * 3

        def led_to(after: Vector) -> Vector:
            rate = [(y - x) / h for x, y in zip(before, after, strict=True)]
            exerted = ground_reaction(self, *self._seen(at_mean(after)[0], rate), q)
            return [x / scale for x, scale in zip([*after[:_BASE], *exerted], scales, strict=True)]

        def one(*parts: Any) -> tuple[_Pass, Any]:
            x = _Pass(*parts)
            taken = [y * scale for y, scale in zip(x.assumed, scales, strict=True)]
            end = [*taken[:_BASE], *x.after[_BASE:]]
            at, mean = at_mean(end)
            force = beside
            if pushed:
                there = self.in_plane(at, mean, q)
                force = f(self.integrate(q, (0.5 * h) * there), there)
            loads = shared_loads(places, *taken[_BASE:])
            pushes, shares, lag, torques = list[TorqueSpeedLine](), list[Any](), list[Any](), u
            if motors is not None:
                pushes = motors(x.rates, x.passes > 0.0)
                shares = [
                    theta(h * push.slope * y) if push.slope is not ZERO else ZERO
                    for push, y in zip(pushes, self._freedom(middle, q), strict=True)
                ]
                lag = [h * y * push.slope for push, y in zip(pushes, shares, strict=True)]
                given = [push.torque - push.slope * y for push, y in zip(pushes, begun, strict=True)]
                torques = stacked([*scalars(u)[: self.na], *given], q)
            now = self._shape(middle, q, h, lag) if fixed is None else fixed
            free = self._free(now, at, before, torques, h, force, q)
            began, slides = self._began(now, before, end, x.slides)
            rubs = self._rubs(now, pushes, h)
            bounds = self._bounds(now, loads.values, began, h, rubs)
            start, known = Impulses([], *x[1:3]), [number(free[k]) for k in now.touched]
            grip = impulses(now.touches, bounds, known, now.inertia, start, self.ground)
            after = self._after(now, free, grip)
            for k, limit in self.stops:
                unit = [ONE if i == self.of_body + k else ZERO for i in range(self.nv)]
                response = self._whole(now.solve(self._reduced(unit)))
                rate = after[self.of_body + k]
                reached = state.steering[k] + (0.5 * h) * (state.rates[k] + rate)
                after = stopped(after, stop_of(reached, limit), rate, unit, response)
            given, rates = [], []
            if motors is not None:
                ends = self.actuator_rates(after[self.of_body :])
                rates = [number(y + z * (e - y)) for y, e, z in zip(begun, ends, shares, strict=True)]
                given = [push.torque - push.slope * y for push, y in zip(pushes, rates, strict=True)]
                pairs = zip(now.touches, bounds, strict=True)
                holds = {touch.spin: bound.spin for touch, bound in pairs if touch.held}
                for rub in rubs:  # its share of the torque that holds a wheel
                    whole = holds[rub.at]
                    part = rub.most / choose(whole > 0.0, whole, 1.0)
                    held = grip.impulses[2 * len(self.table) + list(holds).index(rub.at)]
                    given[rub.actuator] = given[rub.actuator] + held * part / (h * rub.rate)
            better = x.corrected(led_to(after))
            off, was = (
                dot(each[:_BASE], each[:_BASE]) + each[_BASE] * each[_BASE] + dot(each[4:], each[4:]) / size
                for each in (better[1], x.missing)
            )
            stays = (x.passes > 0.0) & (off <= (_LEVEL * little) ** 2) & (off >= was)
            done = (off <= little * little) | stays
            last = loads.tips, choose(done, grip.missed, 1.0), x.passes + 1.0
            found = _Pass(after, *grip[1:3], *better, slides, rates, given, loads.values, *last)
            return found, done

        guess = [x + h * y for x, y in zip(before, scalars(memory.acceleration), strict=True)]
        torques = zip(scalars(memory.holding), self._holds, strict=True)
        forces = [*scalars(memory.forces), *(x for x, holds in torques if holds)]
        turns = [] if motors is None else begun
        first = [guess, [number(x) * h for x in forces], list(map(number, scalars(memory.multipliers)))]
        first += [led_to(guess), [0.0] * 6, [0.0] * 6]
        first += [[-1.0 if i == j else 0.0 for i in range(6) for j in range(6)], [1.0] * len(self.table)]
        start = _Pass(*first, *[turns, turns, [0.0] * len(places), 0.0, 1.0, 0.0])
        found, m = _Pass(*iterated(one, start, _PASSES)), 2 * len(self.table)
        after, mean = found.after, at_mean(found.after)[1]
        on_the_way = self.in_plane(state.turned(psi + 0.5 * h * mean[2]), [h * x for x in mean], q)
        moved = self.integrate(q, on_the_way)
        holding = iter(found.impulses[m:])
        kept = ContactState(
            stacked([x / h for x in found.impulses[:m]], q),
            stacked([next(holding) / h if holds else 0.0 for holds in self._holds], q),
            stacked(found.multipliers, q),
            stacked([(y - x) / h for x, y in zip(before, after, strict=True)], q),
            stacked(found.loads, q),
            *(scalar_of(x, q) for x in (found.tips, found.missed)),
        )
        step = Step(moved, self.in_plane(state.turned(psi + h * mean[2]), after, q), kept)
        return step, found.torques, found.rates

    def _freedom(self, state: State, q: Any) -> Vector:
        """Return the rate of each actuator per angular impulse, with other velocities unchanged."""
        M, found = self.inertia(state, q), []
        weights = [self._reduced(list(row)) for row in M]
        reduced = {i: self._reduced([row[k] for row in weights])[k] for k, i in enumerate(self._kept)}
        for k in range(len(self.table.actuators)):
            turned = self.turned_by(k)
            found.append(number(dot([x * x for _, x in turned], [1.0 / reduced[i] for i, _ in turned])))
        return found

    def _free(self, shape: _Shape, at: State, before: Vector, u: Any, h: Any, f: Any, q: Any) -> Vector:
        """Return the kept velocities after a step without friction."""
        force, effects, pull = self.generalised(at, u, f), self.effects(at, q), self.pull(at)
        a = shape.solve(self._reduced([x - y for x, y in zip(force, effects, strict=True)]))
        vx, vy, w = at.twist
        a[0], a[1] = a[0] + pull[0] + w * vy, a[1] + pull[1] - w * vx
        return [before[i] + h * x for i, x in zip(self._kept, a, strict=True)]

    def _after(self, shape: _Shape, free: Vector, grip: Impulses) -> Vector:
        """Return all velocities at the end of a step."""
        found = list(free)
        for k, x in zip(shape.touched, grip.velocity, strict=True):
            found[k] = x
        for k in shape.rest:
            found[k] = free[k] + dot([column[k] for column in shape.columns], grip.impulses)
        return self._whole(found)

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        """Return the acceleration, shape (..., nv): the mean over a short step from the state."""
        return mean_acceleration(self, q, v, u, f)

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
        most = self.mu * memory.loads[..., :k]
        return {
            "along": ("N", along),
            "across": ("N", across),
            "loads": ("N", memory.loads),
            "slip_along": ("m/s", stacked(slips[0::2], q)),
            "slip_across": ("m/s", stacked(slips[1::2], q)),
            "slides": ("", np.where((most > 0.0) & (size >= _SLIDES * most), 1.0, 0.0)),
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
    found = [(row, 1.0) for row in range(len(table))]
    for first, row, times in table.trains:
        (a, of_a), (b, of_b) = found[first], found[row]
        if a == b and abs(of_b - times * of_a) > 1e-12 * abs(of_b):
            raise InvalidArgument(
                f"couplings turns wheel {table.names[row]!r} at two rates, expected consistent gear trains"
            )
        share = of_a * times / of_b  # followers of b now follow a; this is the ratio of b's rate and a's
        found = [(a, share * x) if leader == b != a else (leader, x) for leader, x in found]
    return found


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

    mu: float | None = declared(
        default=None, optional=True, lower=0, doc="coefficient of friction of all wheels"
    )
    ramp: Ramp | None = child(Ramp, default=None, optional=True, expected="a Ramp(angle, direction) or None")
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
