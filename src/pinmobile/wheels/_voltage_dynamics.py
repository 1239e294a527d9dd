"""`VoltageDynamics`: a robot on wheels whose motors take volts, for one state, many, or symbols.

It is what a `ByVoltage` is to loops of any engine.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.compiled import higher
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import Powered, by_value, child, part, structure, takes
from pinmobile.plant import Input, Step
from pinmobile.robot import (
    ZERO,
    Linearization,
    Matrix,
    Vector,
    dot,
    exact,
    factored,
    number,
    scalars,
    transposed,
    vector_of as stacked,
)
from pinmobile.wheels._contact import iterated, moved_by, within
from pinmobile.wheels._dynamics import PlantOnWheels, WheeledDynamics, through
from pinmobile.wheels._kinematics import unwrap_scalar
from pinmobile.wheels._motors import (
    CONSTANTS,
    ExternalForceFunction,
    Motor,
    MotorLaw,
    Motors,
    TorqueSpeedLine,
    theta,
)
from pinmobile.wheels._rolling import stop_of, stopped
from pinmobile.wheels._table import column as column_of
from pinmobile.wheels._velocities import ReferenceMotion

_BASE = 3
_INSTANT = 1e-5  # [s], over which an acceleration at a state is the mean
_PASSES = 3
_ROUNDS, _ENOUGH = 200, 1e-13  # of dry friction: at most, and of the largest what may still change
_OF_TORQUES = re.compile(
    "_.*|array_dynamics|law|nominal|terms|(check_)?inverse_dynamics|torques|allocate(_scaled)?|constraint_forces|"
    "input_matrix|calls|slip_margins|metrics|evaluate_metrics"
)


class MotorState(NamedTuple):
    """What motors did, means over the last step, and what is kept for the next.

    Attributes
    ----------
    volts, currents, torques : ndarray, shape (motors,)
        [V], [A], and at the wheels [N m].
    holding : ndarray, shape (motors,)
        Torques of dry friction at the wheels, where they roll [N m].
    grip : ContactState or tuple
        What wheels that may slip keep.
    """

    volts: Any
    currents: Any
    torques: Any
    holding: Any
    grip: Any


@final
@dataclass(frozen=True, eq=False)
class VoltageDynamics:
    """A robot on wheels with motors that take volts, for one state, many, or symbols, unchecked.

    Parameters
    ----------
    wheeled : WheeledDynamics
        Of the same robot, whose inputs are torques: one that rolls, or has a step that motors drive.
    motors : MotorLaw
        Of the electric motors, in the order of the inputs.
    electric : tuple of int
        Which actuators they are.
    inputs : tuple of Input
        As of a plant.
    """

    wheeled: WheeledDynamics
    motors: MotorLaw
    electric: tuple[int, ...]
    inputs: tuple[Input, ...]

    broadcasts: ClassVar[bool] = True

    def __getattr__(self, name: str) -> Any:
        return of_wheeled(self, name)

    def initial_state(self, context: Any = None) -> MotorState:
        """Return what it keeps at first: no current flows."""
        none = np.zeros(len(self.electric))
        body: Any = self.wheeled
        grip = body.initial_state(context) if body.slips else ()
        return MotorState(none, none, none, none, grip)

    def volts_for(self, v: Any, torques: Any) -> Any:
        """Return the input at which motors give these torques, as far as they can: see `ByVoltage`."""
        return self._at_rates(v, torques, self.motors.needed)

    def torques_at(self, v: Any, u: Any) -> Any:
        """Return the torques of an input: see `ByVoltage`."""
        law = self.motors
        return self._at_rates(v, u, lambda k, x, rate: law.torque(k, law.volts(k, x), rate))

    def _at_rates(self, v: Any, u: Any, law: Any) -> Any:
        """Return an input in which a law of number, value and rate of each motor takes the value's place."""
        found, na = [number(x) for x in scalars(u)], self.wheeled.na
        rates = self.wheeled.actuator_rates(scalars(v)[_BASE + na :])
        for k, i in enumerate(self.electric):
            found[na + i] = law(k, found[na + i], rates[i])
        return stacked(found, u)

    def followed(self, reference: Any) -> ReferenceMotion:
        """Return states and volts, beyond limits too, along a reference: see `ReferenceMotion`."""
        along, law = self.wheeled.followed(reference), self.motors
        return along._replace(u=self._at_rates(along.v, along.u, lambda *x: law.needed(*x, clips=False)))

    def linearize_tracked(self, q: Any, v: Any, u: Any) -> tuple[Array, Array]:
        """Return A and B of the tracked state for volts, see `ByVoltage.linearize_tracked`."""
        law = self.motors
        torques = self._at_rates(v, u, lambda *x: law.torque(*x, clips=False))
        A, B = self.wheeled.linearize_tracked(q, v, torques)
        own = np.moveaxis(self.wheeled.reduced(q, v).B, -1, 0)  # a torque's power is torque times B' nu
        na, n = self.wheeled.na, A.shape[-1] - own.shape[-1]
        rates, volts = self.wheeled.actuator_rates(scalars(v)[_BASE + na :]), scalars(u)
        for k, i in enumerate(self.electric):
            slope, gain = law.slopes(k, number(volts[na + i]), rates[i])
            felt = B[..., n:, na + i, None] * own[na + i][..., None, :]
            A[..., n:, n:] -= np.asarray(slope)[..., None, None] * felt
            B[..., na + i] *= np.asarray(gain)[..., None]
        return A, B

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        """Return the acceleration, shape (..., nv): the mean over a short step from the state."""
        return (self.step(0.0, q, v, u, _INSTANT, lambda t, q, v: f, self.initial_state()).v - v) / _INSTANT

    def step(
        self, t: Any, q: Any, v: Any, u: Any, h: Any, f: ExternalForceFunction, memory: MotorState
    ) -> Step:
        """Return the state after a step, and what is kept for the next.

        Parameters
        ----------
        t : float
            Time [s].
        q, v : ndarray, shape (..., nq), (..., nv)
            State.
        u : ndarray, shape (..., nu)
            Volts and what else `inputs` names, in the step.
        f : callable
            ``f(t, q, v)``: generalised forces beside them, shape (..., nv), or 0.0.
        h : float
            Length of the step [s].
        memory : MotorState
            From the step before.
        """
        law, given = self.motors, [number(x) for x in scalars(u)][self.wheeled.na :]
        volts = [law.volts(k, given[i]) for k, i in enumerate(self.electric)]

        def motors(rates: Vector, clips: Any) -> list[TorqueSpeedLine]:
            found = [TorqueSpeedLine(x, ZERO, ZERO) for x in given]
            for k, i in enumerate(self.electric):
                found[i] = law.push(k, volts[k], rates[i], clips=clips)
            return found

        def beside(q: Any, v: Any) -> Any:
            return f(t + 0.5 * h, q, v)

        grip: Any = ()
        body: Any = self.wheeled
        if body.slips:
            after, torques, rates = body.driven(q, v, u, h, beside, memory.grip, motors)
            holding, grip = memory.holding, after.memory
        else:
            after, torques, rates, holding = self._rolled(q, v, u, h, beside, memory, motors)
        currents = [law.current(k, volts[k], rates[i]) for k, i in enumerate(self.electric)]
        own = [number(torques[i]) for i in self.electric]
        kept = MotorState(stacked(volts, q), stacked(currents, q), stacked(own, q), holding, grip)
        return Step(after.q, after.v, kept)

    def _rolled(
        self, q: Any, v: Any, u: Any, h: Any, f: Any, memory: MotorState, motors: Motors
    ) -> tuple[Step, Vector, Vector, Any]:
        """Return the state after a step of wheels that roll, actuators' torques and rates, and what holds.

        Implicit in the independent velocities: M (nu+ - nu) = h (B tau - n), with the shape of mid-step, and
        the rest at nu + theta (nu+ - nu).
        """
        body, h = self.wheeled, unwrap_scalar(h)
        q_middle = body.integrate(q, (0.5 * h) * v)
        start, middle = body.state(q, v), body.state(q_middle, v)
        nu = [number(x) for x in body.velocities(start)]
        M, (S, _) = body.inertia(middle, q), body.null_space(middle)
        columns, pushed = transposed(S), through(M, S)
        reduced = [[dot(a, b) for b in pushed] for a in columns]
        B = transposed(body.input_columns(middle, columns))[body.na :]
        solve, _ = factored(reduced)
        freedom = [number(dot(b, solve(b))) for b in B]
        begun = [number(dot(b, nu)) for b in B]
        psi, na = scalars(q)[2], body.na
        beside = f(q_middle, v)
        rates, mean, impulses = begun, nu, [number(x) * h for x in scalars(memory.holding)]
        for again in range(_PASSES):
            pushes = motors(rates, again > 0)
            share: Any = 0.5
            for push, x in zip(pushes, freedom, strict=True):
                if push.slope is not ZERO:
                    share = higher(share, theta(h * push.slope * x))
            at = middle.moving([number(dot(row, mean)) for row in S])
            at = at.turned(psi + 0.5 * h * at.twist[2])
            if again and np.ndim(beside):
                there = body.in_plane(at, at.velocities, q)
                beside = f(body.integrate(q, (0.5 * h) * there), there)
            still = body.proper_acceleration(at, body.bias_acceleration(at, *body.null_space(at)))
            torques = [push.torque - push.slope * x for push, x in zip(pushes, begun, strict=True)]
            whole = body.generalised(at, stacked([*scalars(u)[:na], *torques], q), beside)
            rest = [t - n - dot(row, still) for t, n, row in zip(whole, body.effects(at, q), M, strict=True)]
            heavy = [list(row) for row in reduced]
            for b, push in zip(B, pushes, strict=True):
                for i, x in enumerate(b):
                    for j, y in enumerate(b):
                        heavy[i][j] = heavy[i][j] + (h * share * push.slope) * (x * y)
            solve, _ = factored(heavy)
            change = solve([h * number(dot(column, rest)) for column in columns])
            after = [number(x + y) for x, y in zip(nu, change, strict=True)]
            after, impulses = self._held(after, B, solve, pushes, impulses, h)
            for k, limit in body.stops:
                row = S[_BASE + na + k]
                rate = dot(row, after)
                reached = start.steering[k] + h * (start.rates[k] + share * (rate - start.rates[k]))
                after = stopped(after, stop_of(reached, limit), rate, row, solve(row))
            mean = [number(x + share * (y - x)) for x, y in zip(nu, after, strict=True)]
            rates = [number(dot(b, mean)) for b in B]
        at = middle.moving([number(dot(row, mean)) for row in S])
        moved = body.in_plane(at.turned(psi + 0.5 * h * at.twist[2]), [h * x for x in at.velocities], q)
        q_after = body.integrate(q, moved)
        end = body.state(q_after, v)
        v_after = body.in_plane(end, [dot(row, after) for row in body.null_space(end).S], q)
        given = [push.torque - push.slope * x for push, x in zip(pushes, rates, strict=True)]
        for k, i in enumerate(self.electric):
            given[i] = given[i] + impulses[k] / h
        return Step(q_after, v_after), given, rates, stacked([x / h for x in impulses], q)

    def _held(
        self, nu: Vector, B: Matrix, solve: Any, pushes: Sequence[TorqueSpeedLine], before: Vector, h: Any
    ) -> tuple[Vector, Vector]:
        """Return the velocities that dry friction leaves, and its angular impulses.

        Each holds its wheel, or is as large as it can be against it, by Gauss-Seidel.
        """
        rubs = [k for k, i in enumerate(self.electric) if pushes[i].hold is not ZERO]
        if not rubs:
            return nu, [0.0 for _ in before]
        rows = [B[self.electric[k]] for k in rubs]
        columns = [solve(row) for row in rows]
        own = [1.0 / number(dot(row, column)) for row, column in zip(rows, columns, strict=True)]
        most = [number(h * pushes[self.electric[k]].hold) for k in rubs]
        largest = reduce(higher, most)
        held = [within(before[k], x) for k, x in zip(rubs, most, strict=True)]
        first = moved_by(nu, columns, held)

        def one(x: Vector, p: Vector) -> tuple[Any, Any]:
            change = 0.0 * largest
            for k, (row, column, share) in enumerate(zip(rows, columns, own, strict=True)):
                now = within(p[k] - number(dot(row, x)) * share, most[k])
                x = [number(a + b * (now - p[k])) for a, b in zip(x, column, strict=True)]
                change = higher(abs(now - p[k]), change)
                p[k] = now
            return (x, p), change <= _ENOUGH * largest

        found, last = iterated(one, (first, held), _ROUNDS)
        impulses: Vector = [0.0 for _ in before]
        for k, x in zip(rubs, last, strict=True):
            impulses[k] = x
        return found, impulses

    def signals(
        self, t: Any, q: Any, v: Any, u: Any, f: Any, memory: MotorState
    ) -> dict[str, tuple[str, Any]]:
        """Return what motors did in the step before, a number of each: ``volts``, ``currents``, ``torques``.

        With what the ground did where wheels may slip.
        """
        body: Any = self.wheeled
        ground = body.signals(t, q, v, u, f, memory.grip) if body.slips else {}
        volts, currents, torques, *_ = memory
        return {"volts": ("V", volts), "currents": ("A", currents), "torques": ("N m", torques), **ground}


def of_wheeled(part: Any, name: str) -> Any:
    """Return what a robot whose inputs are volts has of the one whose inputs are torques."""
    if _OF_TORQUES.fullmatch(name) or "wheeled" not in part.__dict__:
        raise AttributeError(f"a {type(part).__name__} has no {name}")
    return getattr(part.wheeled, name)


@final
@part
@by_value
class ByVoltage(PlantOnWheels):
    """A robot on wheels whose inputs are the voltages of its motors: what `WheeledRobot.by_voltage` returns.

    It is the same robot, q and v included, and what it does not say itself it has of that. Joints of arms,
    and wheels and steering axes whose motor is no electric one, keep torques. It has a step of its own,
    implicit in what a motor feels of its wheel's rate: back-EMF does not limit the step, limits of currents
    and the sign of a gear's power are those of the rate that it is implicit in, and dry friction holds a
    wheel at rest exactly. The error falls with the square of the step where nothing sticks. The signals
    ``volts``, ``currents`` and ``torques``, a number per electric motor, are means over the last step.

    Parameters
    ----------
    wheeled : WheeledRobot
        With motors that have a resistance, a torque constant and a voltage.

    Raises
    ------
    InvalidArgument
        If no motor takes volts, or one with dry friction or losses in its gear turns wheels that slip
        independently of each other.
    """

    wheeled: Any = child(Powered, expected="a WheeledRobot")

    def check(self) -> None:
        """Raise `InvalidArgument` where no motor takes volts, or the ground knows no such motors."""
        if not self._electric:
            words = "Motor(resistance=..., torque_constant=..., voltage=...)"
            raise InvalidArgument(f"table has no motor that takes volts, expected {words}")
        body = self.wheeled.array_dynamics
        if body.slips and not hasattr(body, "driven"):
            raise InvalidArgument(
                f"ground is {shown(self.wheeled.ground)}, whose law has no step that motors drive, expected "
                "Rolling() or Coulomb()"
            )
        for k in self._rubbing if body.slips else ():
            if len(body.turned_by(k)) > 1:
                raise InvalidArgument(
                    f"motor of {self.table.actuators[k].name!r} has dry friction, or losses in its gear, "
                    "and turns wheels that slip independently of each other, expected coulomb=0 and "
                    "efficiency=1, or ground=Rolling()"
                )

    def __getattr__(self, name: str) -> Any:
        return of_wheeled(self, name)

    def __repr__(self) -> str:
        return f"{self.wheeled!r}.by_voltage()"

    @property
    def motor_paths(self) -> tuple[str, ...]:
        """Where its electric motors stand, in the order of the inputs: see `pinmobile.parts.replace`."""
        return tuple(f"wheeled.table.{self.table.actuators[k].path}" for k in self._electric)

    @structure
    def _electric(self) -> tuple[int, ...]:
        """Actuators that take volts."""
        return tuple(k for k, each in enumerate(self.table.actuators) if each.motor.is_electric)

    @cached_property
    def _rubbing(self) -> tuple[int, ...]:
        """Actuators with dry friction, and those whose gear has losses, which hold too."""

        def rubs(motor: Motor) -> bool:
            known = [number(exact(unwrap_scalar(x))) for x in (motor.coulomb, motor.efficiency)]
            return not (all(isinstance(x, float) for x in known) and known == [0.0, 1.0])

        return tuple(k for k in self._electric if rubs(self.table.actuators[k].motor))

    @structure
    def inputs(self) -> tuple[Input, ...]:
        """Each of the nu numbers of an input: volts of electric motors, torques of all else."""
        own, first = list(self.wheeled.inputs), self.nu - len(self.table.actuators)
        for k in self._electric:
            most = self.table.actuators[k].motor.voltage
            own[first + k] = Input(own[first + k].name, "V", -most, most)
        return tuple(own)

    @cached_property
    def array_dynamics(self) -> VoltageDynamics:
        """Its dynamics for one state, many, or symbols, unchecked."""
        body, motors = self.wheeled.array_dynamics, [self.table.actuators[k].motor for k in self._electric]
        if body.slips:
            body = replace(body, rubbing=self._rubbing)
        columns = {name: column_of([getattr(motor, name) for motor in motors]) for name in CONSTANTS}
        return VoltageDynamics(body, MotorLaw(motors, **columns), self._electric, self.inputs)

    @takes(q="nq", v="nv", u="nu", f="nv")
    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike = 0.0) -> Any:
        """Return the acceleration, shape (..., nv) [m/s^2, ...]: the mean over a short step from the state.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls where wheels do not slip.
        u : array_like, shape (..., nu)
            Volts, and torques where there are none, see `inputs`.
        f : array_like, shape (..., nv), optional
            Generalised forces beside them.
        """
        return self.array_dynamics.forward_dynamics(q, v, u, f)

    @takes(v="nv", torques="nu")
    def volts_for(self, v: ArrayLike, torques: ArrayLike) -> Any:
        """Return the input at which motors give torques at the present rates, shape (..., nu).

        Within their limits of voltage and current; what takes no volts stays.

        Parameters
        ----------
        v : array_like, shape (..., nv)
            Velocities [m/s, m/s, rad/s, ...].
        torques : array_like, shape (..., nu)
            As inputs of the robot by torques [N m].
        """
        return self.array_dynamics.volts_for(v, torques)

    @takes(v="nv", u="nu")
    def torques_at(self, v: ArrayLike, u: ArrayLike) -> Any:
        """Return the torques that motors give at the present rates, shape (..., nu) [N m].

        Parameters
        ----------
        v, u : array_like, shape (..., nv), (..., nu)
            Velocities, and volts.
        """
        return self.array_dynamics.torques_at(v, u)

    @takes(q="nq", v="nv", u="nu")
    def linearize_tracked(self, q: ArrayLike, v: ArrayLike, u: ArrayLike) -> Linearization:
        """Return the first-order model of the tracked state, see `WheeledRobot.linearize_tracked`.

        Of volts, back-EMF and viscous friction of the motors included; limits of volts and currents are not
        looked at, and dry friction is that of a wheel that keeps turning.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        u : array_like, shape (..., nu)
            Volts, and torques where there are none, see `inputs`.

        Raises
        ------
        InvalidArgument
            If wheels steer, or an argument has another shape.
        """
        return Linearization(*self.array_dynamics.linearize_tracked(q, v, u))

    def mount(self, arm: Any, at: ArrayLike | None = None, **options: Any) -> ByVoltage:
        """Return the robot with an arm on its body: see `MobileRobot.mount`."""
        return ByVoltage(self.wheeled.mount(arm, at, **options))

    def attach(self, load: Any, frame: str | None = None) -> ByVoltage:
        """Return the robot with a load fixed to one of its frames: see `MobileRobot.attach`."""
        return ByVoltage(self.wheeled.attach(load, frame))

    def on_ramp(self, angle: float, direction: float = 0.0) -> ByVoltage:
        """Return the robot on ground that rises: see `WheeledRobot.on_ramp`."""
        return ByVoltage(self.wheeled.on_ramp(angle, direction))
