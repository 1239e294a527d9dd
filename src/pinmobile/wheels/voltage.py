"""`ByVoltage`: a robot on wheels whose inputs are the voltages of its motors."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, broadcast, finite, vector
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import also_symbols, by_value, child, holds_symbols, part, structure
from pinmobile.plant import Input, Step
from pinmobile.robot import Linearization, exact, number
from pinmobile.wheels.loads import item
from pinmobile.wheels.motors import CONSTANTS, Beside, Motor, MotorLaw, constant_force
from pinmobile.wheels.powered import Driving, VoltageDynamics, of_wheeled
from pinmobile.wheels.rows import column
from pinmobile.wheels.wheeled import WheeledRobot


@final
@part
@by_value
class ByVoltage:
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

    wheeled: WheeledRobot = child(WheeledRobot, expected="a WheeledRobot")

    broadcasts: ClassVar[bool] = True
    compiles: ClassVar[bool] = True

    def check(self) -> None:
        """Raise `InvalidArgument` where no motor takes volts, or the ground knows no such motors."""
        if not self._electric:
            raise InvalidArgument(
                "table has no motor that takes volts, expected Motor(resistance=..., torque_constant=..., "
                "voltage=...)"
            )
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
            known = [number(exact(item(x))) for x in (motor.coulomb, motor.efficiency)]
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
        columns = {name: column([getattr(motor, name) for motor in motors]) for name in CONSTANTS}
        return VoltageDynamics(body, MotorLaw(motors, **columns), self._electric, self.inputs)

    @cached_property
    def _is_symbolic(self) -> bool:
        return holds_symbols(self)

    @property
    def law(self) -> Any:
        """What a loop calls: itself, or its `array_dynamics` where it holds symbols."""
        return self.array_dynamics if self._is_symbolic else self

    @also_symbols
    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike = 0.0) -> Array:
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
        beside = finite("f", f)
        force = vector("f", beside, self.nv) if beside.ndim or beside else 0.0
        return np.asarray(self.array_dynamics.forward_dynamics(*self._state(q, v, u), force))

    def _state(self, q: ArrayLike, v: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array]:
        return vector("q", q, self.nq), vector("v", v, self.nv), vector("u", u, self.nu)

    @also_symbols
    def volts_for(self, v: ArrayLike, torques: ArrayLike) -> Array:
        """Return the input at which motors give torques at the present rates, shape (..., nu).

        Within their limits of voltage and current; what takes no volts stays.

        Parameters
        ----------
        v : array_like, shape (..., nv)
            Velocities [m/s, m/s, rad/s, ...].
        torques : array_like, shape (..., nu)
            As inputs of the robot by torques [N m].
        """
        v, torques = vector("v", v, self.nv), vector("torques", torques, self.nu)
        return np.asarray(self.array_dynamics.volts_for(v, torques))

    @also_symbols
    def torques_at(self, v: ArrayLike, u: ArrayLike) -> Array:
        """Return the torques that motors give at the present rates, shape (..., nu) [N m].

        Parameters
        ----------
        v, u : array_like, shape (..., nv), (..., nu)
            Velocities, and volts.
        """
        v, u = vector("v", v, self.nv), vector("u", u, self.nu)
        return np.asarray(self.array_dynamics.torques_at(v, u))

    @also_symbols
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
        q, v, u = self._state(q, v, u)
        broadcast(q=q, v=v, u=u)
        return Linearization(*self.array_dynamics.linearize_tracked(q, v, u))

    def initial_state(self, context: Any = None) -> Driving:
        """Return what motors and wheels keep before the first step."""
        return self.array_dynamics.initial_state(context)

    @also_symbols
    def step(
        self,
        t: float,
        q: ArrayLike,
        v: ArrayLike,
        u: ArrayLike,
        h: float,
        f: Beside | ArrayLike,
        memory: Driving,
    ) -> Step:
        """Return the state a step later, under forces ``f(t, q, v)`` of mid-step, or such as stay."""
        beside = f if callable(f) else constant_force(finite("f", f))
        return self.array_dynamics.step(t, *self._state(q, v, u), h, beside, memory)

    @also_symbols
    def signals(
        self, t: float, q: Array, v: Array, u: Array, f: ArrayLike, memory: Driving
    ) -> dict[str, tuple[str, Any]]:
        """Return what motors, and the ground where wheels slip, did in the step before."""
        return self.array_dynamics.signals(t, q, v, u, f, memory)

    def mount(self, arm: Any, at: ArrayLike | None = None, **options: Any) -> ByVoltage:
        """Return the robot with an arm on its body: see `MobileRobot.mount`."""
        return ByVoltage(self.wheeled.mount(arm, at, **options))

    def attach(self, load: Any, frame: str | None = None) -> ByVoltage:
        """Return the robot with a load fixed to one of its frames: see `MobileRobot.attach`."""
        return ByVoltage(self.wheeled.attach(load, frame))

    def on_ramp(self, angle: float, direction: float = 0.0) -> ByVoltage:
        """Return the robot on ground that rises: see `WheeledRobot.on_ramp`."""
        return ByVoltage(self.wheeled.on_ramp(angle, direction))
