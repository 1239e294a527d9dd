"""`VoltageDynamics`: a robot on wheels with voltages as inputs, for one state, many, or symbols.

These are the dynamics of a `ByVoltage` for all engines.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.compiled import scalar_max
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.parts import Powered, by_value, child, part, structure, takes
from pinmobile.plant import Input, Step
from pinmobile.robot import (
    ZERO,
    Linearization,
    Matrix,
    Vector,
    dot,
    factor,
    number,
    scalars,
    single,
    transpose,
    vector_of as stacked,
)
from pinmobile.wheels._contact import iterate, moved_by, within
from pinmobile.wheels._dynamics import PlantOnWheels, WheeledDynamics, mass_columns, mean_acceleration
from pinmobile.wheels._kinematics import ReferenceMotion
from pinmobile.wheels._loads import metrics_on_wheels, values_on_wheels
from pinmobile.wheels._motors import (
    ExternalForceFunction,
    Motor,
    MotorLaw,
    Motors,
    TorqueSpeedLine,
    theta,
)
from pinmobile.wheels._rolling import stop_axis, stop_of

_BASE = 3
_PASSES = 3
_ROUNDS, _ENOUGH = 200, 1e-13  # dry friction: most iterations, and tolerance relative to the largest impulse
_OF_TORQUES = re.compile(
    "_.*|array_dynamics|dynamics|nominal|terms|(check_)?inverse_dynamics|torques|allocate(_scaled)?|constraint_forces|"
    "input_matrix|calls|slip_margins"
)


class MotorState(NamedTuple):
    """Values of motors, means over the last step, and memory for the next one.

    Attributes
    ----------
    volts, currents, torques : ndarray, shape (motors,)
        [V], [A], and at the wheels [N m].
    holding : ndarray, shape (motors,)
        Torques of dry friction at rolling wheels [N m].
    grip : ContactState or tuple
        Contact state of slipping wheels.
    """

    volts: Any
    currents: Any
    torques: Any
    holding: Any
    grip: Any


@final
@dataclass(frozen=True, eq=False)
class VoltageDynamics:
    """Dynamics of a robot on wheels with voltages as inputs, without input validation.

    Parameters
    ----------
    wheeled : WheeledDynamics
        Dynamics of the same robot with torques as inputs: it rolls, or has a step that motors drive.
    motors : MotorLaw
        Electric motors, in the order of the inputs.
    electric : tuple of int
        Numbers of their actuators.
    inputs : tuple of Input
        Inputs of the plant.
    """

    wheeled: WheeledDynamics
    motors: MotorLaw
    electric: tuple[int, ...]
    inputs: tuple[Input, ...]

    metrics = cached_property(metrics_on_wheels)
    evaluate_metrics = values_on_wheels
    forward_dynamics = mean_acceleration
    broadcasts: ClassVar[bool] = True
    groups: ClassVar[tuple[()]] = ()  # slip margins need torques

    def __getattr__(self, name: str) -> Any:
        return of_wheeled(self, name)

    def initial_state(self, context: Any = None) -> MotorState:
        """Return the memory before the first step: no current flows."""
        zeros = np.zeros(len(self.electric))
        body: Any = self.wheeled
        grip = body.initial_state(context) if body.slips else ()
        return MotorState(zeros, zeros, zeros, zeros, grip)

    def volts_for(self, v: Any, torques: Any) -> Any:
        """Return the input at which motors produce these torques as far as possible, see `ByVoltage`."""
        return self._at_rates(v, torques, self.motors.required)

    def torques_at(self, v: Any, u: Any) -> Any:
        """Return the torques of an input, see `ByVoltage`."""
        law = self.motors
        return self._at_rates(v, u, lambda k, x, rate: law.torque(k, law.volts(k, x), rate))

    def _at_rates(self, v: Any, u: Any, law: Any) -> Any:
        """Return an input with each motor's value replaced by a function of number, value and rate."""
        values, na = [number(x) for x in scalars(u)], self.wheeled.na
        rates = self.wheeled.actuator_rates(scalars(v)[_BASE + na :])
        for k, i in enumerate(self.electric):
            values[na + i] = law(k, values[na + i], rates[i])
        return stacked(values, u)

    def followed(self, reference: Any) -> ReferenceMotion:
        """Return states and voltages, even beyond limits, along a reference, see `ReferenceMotion`."""
        motion, law = self.wheeled.followed(reference), self.motors
        return motion._replace(u=self._at_rates(motion.v, motion.u, lambda *x: law.required(*x, clips=False)))

    def linearize_tracked(self, q: Any, v: Any, u: Any) -> tuple[Array, Array]:
        """Return A and B of the tracked state for volts, see `ByVoltage.linearize_tracked`."""
        law = self.motors
        torques = self._at_rates(v, u, lambda *x: law.torque(*x, clips=False))
        A, B = self.wheeled.linearize_tracked(q, v, torques)
        columns = np.moveaxis(self.wheeled.reduced(q, v).B, -1, 0)  # its power is the torque times B' nu
        na, n = self.wheeled.na, A.shape[-1] - columns.shape[-1]
        rates, volts = self.wheeled.actuator_rates(scalars(v)[_BASE + na :]), scalars(u)
        for k, i in enumerate(self.electric):
            slope, gain = law.slopes(k, number(volts[na + i]), rates[i])
            damping = B[..., n:, na + i, None] * columns[na + i][..., None, :]
            A[..., n:, n:] -= np.asarray(slope)[..., None, None] * damping
            B[..., na + i] *= np.asarray(gain)[..., None]
        return A, B

    def step(
        self, t: Any, q: Any, v: Any, u: Any, h: Any, f: ExternalForceFunction, memory: MotorState
    ) -> Step:
        """Return the state after a step, and the memory for the next.

        Parameters
        ----------
        t : float
            Time [s].
        q, v : ndarray, shape (..., nq), (..., nv)
            State.
        u : ndarray, shape (..., nu)
            Voltages, and torques of other inputs, in the step.
        h : float
            Length of the step [s].
        f : callable
            ``f(t, q, v)``: external generalised force, shape (..., nv), or 0.0.
        memory : MotorState
            Memory of the step before.
        """
        law, given = self.motors, [number(x) for x in scalars(u)][self.wheeled.na :]
        volts = [law.volts(k, given[i]) for k, i in enumerate(self.electric)]

        def motors(rates: Vector, clips: Any) -> list[TorqueSpeedLine]:
            lines = [TorqueSpeedLine(x, ZERO, ZERO) for x in given]
            for k, i in enumerate(self.electric):
                lines[i] = law.push(k, volts[k], rates[i], clips=clips)
            return lines

        def external(q: Any, v: Any) -> Any:
            return f(t + 0.5 * h, q, v)

        grip: Any = ()
        body: Any = self.wheeled
        if body.slips:
            result, torques, rates = body.driven(q, v, u, h, external, memory.grip, motors)
            holding, grip = memory.holding, result.memory
        else:
            result, torques, rates, holding = self._rolling_step(q, v, u, h, external, memory, motors)
        currents = [law.current(k, volts[k], rates[i]) for k, i in enumerate(self.electric)]
        own = [number(torques[i]) for i in self.electric]
        motor_state = MotorState(stacked(volts, q), stacked(currents, q), stacked(own, q), holding, grip)
        return Step(result.q, result.v, motor_state)

    def _rolling_step(
        self, q: Any, v: Any, u: Any, h: Any, f: Any, memory: MotorState, motors: Motors
    ) -> tuple[Step, Vector, Vector, Any]:
        """Return the state after a rolling step, torques and rates of actuators, and holding torques.

        The step is implicit in the independent velocities: M (nu+ - nu) = h (B tau - n), with the
        configuration at mid-step, and all else at nu + theta (nu+ - nu).
        """
        body, h = self.wheeled, number(single(h))
        q_middle = body.integrate(q, (0.5 * h) * v)
        start, middle = body.state(q, v), body.state(q_middle, v)
        nu = [number(x) for x in body.velocities(start)]
        M, (S, _) = body.inertia(middle, q), body.null_space(middle)
        columns, MS = transpose(S), mass_columns(M, S)
        reduced_M = [[dot(a, b) for b in MS] for a in columns]
        B = transpose(body.input_columns(middle, columns))[body.na :]
        solve, _ = factor(reduced_M)
        freedom = [number(dot(b, solve(b))) for b in B]
        start_rates = [number(dot(b, nu)) for b in B]
        psi, na = scalars(q)[2], body.na
        external = f(q_middle, v)
        rates, mean, impulses = start_rates, nu, [number(x) * h for x in scalars(memory.holding)]
        for k_pass in range(_PASSES):
            pushes = motors(rates, k_pass > 0)
            share: Any = 0.5
            for push, x in zip(pushes, freedom, strict=True):
                if push.slope is not ZERO:
                    share = scalar_max(share, theta(h * push.slope * x))
            mid = middle.moving([number(dot(row, mean)) for row in S])
            mid = mid.with_psi(psi + 0.5 * h * mid.twist[2])
            if k_pass and np.ndim(external):
                mean_v = body.in_plane(mid, mid.velocities, q)
                external = f(body.integrate(q, (0.5 * h) * mean_v), mean_v)
            bias = body.proper_acceleration(mid, body.bias_acceleration(mid, *body.null_space(mid)))
            torques = [push.torque - push.slope * x for push, x in zip(pushes, start_rates, strict=True)]
            force = body.input_force(mid, stacked([*scalars(u)[:na], *torques], q), external)
            rest = [t - n - dot(row, bias) for t, n, row in zip(force, body.effects(mid, q), M, strict=True)]
            heavy = [list(row) for row in reduced_M]
            for b, push in zip(B, pushes, strict=True):
                for i, x in enumerate(b):
                    for j, y in enumerate(b):
                        heavy[i][j] = heavy[i][j] + (h * share * push.slope) * (x * y)
            solve, _ = factor(heavy)
            change = solve([h * number(dot(column, rest)) for column in columns])
            end_nu = [number(x + y) for x, y in zip(nu, change, strict=True)]
            end_nu, impulses = self._hold_rates(end_nu, B, solve, pushes, impulses, h)
            for k, limit in body.stops:
                row = S[_BASE + na + k]
                rate = dot(row, end_nu)
                angle = start.steering[k] + h * (start.rates[k] + share * (rate - start.rates[k]))
                end_nu = stop_axis(end_nu, stop_of(angle, limit), rate, row, solve(row))
            mean = [number(x + share * (y - x)) for x, y in zip(nu, end_nu, strict=True)]
            rates = [number(dot(b, mean)) for b in B]
        mid = middle.moving([number(dot(row, mean)) for row in S])
        dq = body.in_plane(mid.with_psi(psi + 0.5 * h * mid.twist[2]), [h * x for x in mid.velocities], q)
        q_after = body.integrate(q, dq)
        end = body.state(q_after, v)
        v_after = body.in_plane(end, [dot(row, end_nu) for row in body.null_space(end).S], q)
        given = [push.torque - push.slope * x for push, x in zip(pushes, rates, strict=True)]
        for k, i in enumerate(self.electric):
            given[i] = given[i] + impulses[k] / h
        return Step(q_after, v_after), given, rates, stacked([x / h for x in impulses], q)

    def _hold_rates(
        self, nu: Vector, B: Matrix, solve: Any, pushes: Sequence[TorqueSpeedLine], impulses_0: Vector, h: Any
    ) -> tuple[Vector, Vector]:
        """Return the velocities after dry friction of motors, and its angular impulses.

        By the Gauss-Seidel method, each impulse holds its wheel, or has its largest magnitude.
        """
        rubs = [k for k, i in enumerate(self.electric) if pushes[i].hold is not ZERO]
        if not rubs:
            return nu, [0.0 for _ in impulses_0]
        rows = [B[self.electric[k]] for k in rubs]
        columns = [solve(row) for row in rows]
        inverses = [1.0 / number(dot(row, column)) for row, column in zip(rows, columns, strict=True)]
        bounds = [number(h * pushes[self.electric[k]].hold) for k in rubs]
        largest = reduce(scalar_max, bounds)
        start = [within(impulses_0[k], x) for k, x in zip(rubs, bounds, strict=True)]
        first = moved_by(nu, columns, start)

        def sweep(x: Vector, p: Vector) -> tuple[Any, Any]:
            change = 0.0 * largest
            for k, (row, column, share) in enumerate(zip(rows, columns, inverses, strict=True)):
                impulse = within(p[k] - number(dot(row, x)) * share, bounds[k])
                x = [number(a + b * (impulse - p[k])) for a, b in zip(x, column, strict=True)]
                change = scalar_max(abs(impulse - p[k]), change)
                p[k] = impulse
            return (x, p), change <= _ENOUGH * largest

        result, last = iterate(sweep, (first, start), _ROUNDS)
        impulses: Vector = [0.0 for _ in impulses_0]
        for k, x in zip(rubs, last, strict=True):
            impulses[k] = x
        return result, impulses

    def signals(
        self, t: Any, q: Any, v: Any, u: Any, f: Any, memory: MotorState
    ) -> dict[str, tuple[str, Any]]:
        """Return ``volts``, ``currents`` and ``torques`` of the motors in the step before, one per motor.

        If wheels may slip, the signals of the ground are included.
        """
        body: Any = self.wheeled
        ground = body.signals(t, q, v, u, f, memory.grip) if body.slips else {}
        volts, currents, torques, *_ = memory
        return {"volts": ("V", volts), "currents": ("A", currents), "torques": ("N m", torques), **ground}


def of_wheeled(part: Any, name: str) -> Any:
    """Return an attribute of the robot with torques as inputs, if it also applies to voltages."""
    if _OF_TORQUES.fullmatch(name) or "wheeled" not in part.__dict__:
        raise AttributeError(f"a {type(part).__name__} has no {name}")
    return getattr(part.wheeled, name)


@final
@part
@by_value
class ByVoltage(PlantOnWheels):
    """Robot on wheels with voltages as inputs of its motors, made by `WheeledRobot.by_voltage`.

    It is the same robot with the same q and v, and has the other attributes of that robot. Joints of arms,
    and wheels and steering axes without an electric motor, keep torques as inputs. Its own step is implicit
    in the wheel rates, so back-EMF does not limit the step size, and dry friction holds a wheel exactly at
    rest. Current limits and the power direction of gears follow from the same implicit rate. Without
    sticking, the error decreases with the square of the step. The signals ``volts``, ``currents`` and
    ``torques``, one value per electric motor, are means over the last step.

    Parameters
    ----------
    wheeled : WheeledRobot
        Robot with motors that have a resistance, a torque constant and a voltage.

    Raises
    ------
    InvalidArgument
        If no motor takes volts, or a motor with dry friction or gear losses turns wheels that slip
        independently.

    See Also
    --------
    Motor : model of an electric motor
    controllers.TorqueToVoltage : controller of such a robot
    LQR : law that computes voltages directly

    Examples
    --------
    >>> from pinmobile import MobileRobot, Motor, WheeledRobot
    >>> from pinmobile import WheelTable
    >>> motor = Motor(resistance=2, torque_constant=0.5, voltage=24)
    >>> table = WheelTable.differential(
    ...     0.4, 0.1, motor=motor, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> robot = robot.by_voltage()
    >>> [f"{one.name} [{one.unit}]" for one in robot.inputs]
    ['left [V]', 'right [V]']
    >>> robot.torques_at(0 * robot.rest, [8.0, 8.0])  # at rest [N m]
    array([2., 2.])
    """

    wheeled: Any = child(Powered, expected="a WheeledRobot")

    def check(self) -> None:
        """Raise `InvalidArgument` if no motor takes volts, or the ground does not support such motors."""
        if not self._electric:
            words = "Motor(resistance=..., torque_constant=..., voltage=...)"
            raise InvalidArgument(f"table has no electric motor, which takes volts, expected {words}")
        body = self.wheeled.array_dynamics
        if body.slips and not hasattr(body, "driven"):
            raise InvalidArgument(
                f"ground is {format_value(self.wheeled.ground)}, whose dynamics do not support electric "
                "motors, expected Rolling() or Coulomb()"
            )
        for k in self._rubbing if body.slips else ():
            if len(body.turned_by(k)) > 1:
                raise InvalidArgument(
                    f"motor of {self.table.actuators[k].name!r} has dry friction or losses, and its wheels "
                    "slip independently, expected coulomb=0 and efficiency=1, or ground=Rolling()"
                )

    def __getattr__(self, name: str) -> Any:
        return of_wheeled(self, name)

    def __repr__(self) -> str:
        return f"{self.wheeled!r}.by_voltage()"

    @property
    def motor_paths(self) -> tuple[str, ...]:
        """Paths of the electric motors, in the order of the inputs, see ``pinmobile.parts.replace``."""
        return tuple(f"wheeled.table.{self.table.actuators[k].path}" for k in self._electric)

    @structure
    def _electric(self) -> tuple[int, ...]:
        """Numbers of actuators that take volts."""
        return tuple(k for k, each in enumerate(self.table.actuators) if each.motor.is_electric)

    @cached_property
    def _rubbing(self) -> tuple[int, ...]:
        """Numbers of actuators with dry friction or gear losses, which can hold a wheel."""

        def rubs(motor: Motor) -> bool:
            values = [number(single(x)) for x in (motor.coulomb, motor.efficiency)]
            return not (all(isinstance(x, float) for x in values) and values == [0.0, 1.0])

        return tuple(k for k in self._electric if rubs(self.table.actuators[k].motor))

    @structure
    def inputs(self) -> tuple[Input, ...]:
        """Inputs of u: voltages of electric motors, torques of all others."""
        inputs, first = list(self.wheeled.inputs), self.nu - len(self.table.actuators)
        for k in self._electric:
            limit = self.table.actuators[k].motor.voltage
            inputs[first + k] = Input(inputs[first + k].name, "V", -limit, limit)
        return tuple(inputs)

    @cached_property
    def array_dynamics(self) -> VoltageDynamics:
        """Dynamics for one state, many, or symbols, without input validation."""
        body, motors = self.wheeled.array_dynamics, [self.table.actuators[k].motor for k in self._electric]
        if body.slips:
            body = replace(body, rubbing=self._rubbing)
        return VoltageDynamics(body, MotorLaw.of(motors), self._electric, self.inputs)

    @takes(q="nq", v="nv", u="nu", f="nv")
    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike = 0.0) -> Any:
        """Return the acceleration, shape (..., nv) [m/s^2, ...]: the mean over a short step from the state.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State; on ground without slip, wheels roll.
        u : array_like, shape (..., nu)
            Voltages [V], and torques of other inputs [N m], see `inputs`.
        f : array_like, shape (..., nv), optional
            External generalised force.
        """
        return self.array_dynamics.forward_dynamics(q, v, u, f)

    @takes(v="nv", torques="nu")
    def volts_for(self, v: ArrayLike, torques: ArrayLike) -> Any:
        """Return the input at which motors produce torques at the present rates, shape (..., nu).

        The voltages respect the limits of voltage and current. Torques of other inputs remain unchanged.

        Parameters
        ----------
        v : array_like, shape (..., nv)
            Velocities [m/s, m/s, rad/s, ...].
        torques : array_like, shape (..., nu)
            Inputs of the robot driven by torques [N m].
        """
        return self.array_dynamics.volts_for(v, torques)

    @takes(v="nv", u="nu")
    def torques_at(self, v: ArrayLike, u: ArrayLike) -> Any:
        """Return the torques of motors at the present rates, shape (..., nu) [N m].

        Parameters
        ----------
        v : array_like, shape (..., nv)
            Velocities [m/s, m/s, rad/s, ...].
        u : array_like, shape (..., nu)
            Voltages [V], and torques of other inputs [N m], see `inputs`.
        """
        return self.array_dynamics.torques_at(v, u)

    @takes(q="nq", v="nv", u="nu")
    def linearize_tracked(self, q: ArrayLike, v: ArrayLike, u: ArrayLike) -> Linearization:
        """Return the linear model of the tracked state, see `WheeledRobot.linearize_tracked`.

        Its inputs are voltages; it includes back-EMF and viscous friction of the motors. Limits of voltage
        and current are ignored, and dry friction is that of a wheel that keeps turning.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State; wheels roll.
        u : array_like, shape (..., nu)
            Voltages [V], and torques of other inputs [N m], see `inputs`.

        Returns
        -------
        model : Linearization
            A and B.

        Raises
        ------
        InvalidArgument
            If wheels steer, or an argument has another shape.
        """
        return Linearization(*self.array_dynamics.linearize_tracked(q, v, u))

    def mount(self, arm: Any, at: ArrayLike | None = None, **options: Any) -> ByVoltage:
        """Return the robot with an arm on its body, see `MobileRobot.mount`.

        Parameters
        ----------
        arm, at, **options
            As in `MobileRobot.mount`.
        """
        return ByVoltage(self.wheeled.mount(arm, at, **options))

    def attach(self, load: Any, frame: str | None = None) -> ByVoltage:
        """Return the robot with a payload on one of its frames, see `MobileRobot.attach`.

        Parameters
        ----------
        load : PayloadBody
            The payload.
        frame : str, optional
            Name of the frame.
        """
        return ByVoltage(self.wheeled.attach(load, frame))

    def on_ramp(self, angle: float, direction: float = 0.0) -> ByVoltage:
        """Return the robot on inclined ground, see `WheeledRobot.on_ramp`.

        Parameters
        ----------
        angle, direction : float
            Inclination, and direction of steepest ascent from the inertial x axis [rad].
        """
        return ByVoltage(self.wheeled.on_ramp(angle, direction))
