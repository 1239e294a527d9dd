"""`ByVoltage`: a robot on wheels whose inputs are the voltages of its motors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, broadcast, finite, frozen, scalar, vector
from pinmobile.constancy import constant
from pinmobile.errors import InvalidArgument, UnknownName, shown
from pinmobile.plant import Input, Parameter, Step
from pinmobile.robot import Linearization
from pinmobile.wheels.motors import Beside, constant_force
from pinmobile.wheels.powered import Driving, VoltageBody, of_wheeled
from pinmobile.wheels.slipping import SlippingBody
from pinmobile.wheels.table import Differential, WheelTable

_CONSTANTS = (
    ("resistance", "ohm", "resistance of the armature", False),
    ("torque_constant", "N m/A", "torque constant", False),
    ("viscous", "N m s/rad", "friction per rate", True),
    ("coulomb", "N m", "dry friction", True),
    ("efficiency", "", "efficiency of the gear", False),
)


@final
@constant
@dataclass(frozen=True, eq=False, repr=False)
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

    wheeled: Any

    broadcasts: ClassVar[bool] = True
    compiles: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not isinstance(getattr(self.wheeled, "table", None), WheelTable):
            raise InvalidArgument(f"wheeled is {shown(self.wheeled)}, expected a WheeledRobot")
        if not self._electric:
            raise InvalidArgument(
                "table has no motor that takes volts, expected Motor(resistance=..., torque_constant=..., "
                "voltage=...)"
            )
        if self.wheeled.ground.slips:
            body = self.wheeled.traced()
            for k in self._rubbing:
                if len(body.turned_by(k)) > 1:
                    raise InvalidArgument(
                        f"motor of {self.table.actuators[k].name!r} has dry friction, or losses in its gear, "
                        "and turns wheels that slip independently of each other, expected coulomb=0 and "
                        "efficiency=1, or ground=Rolling()"
                    )

    def __getattr__(self, name: str) -> Any:
        return of_wheeled(self, name)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ByVoltage) and self.wheeled == other.wheeled

    def __hash__(self) -> int:
        return hash(("volts", self.wheeled))

    def __repr__(self) -> str:
        return f"{self.wheeled!r}.by_voltage()"

    @property
    def table(self) -> WheelTable:
        """Its wheels."""
        table: WheelTable = self.wheeled.table
        return table

    @property
    def nq(self) -> int:
        """Size of q."""
        return int(self.wheeled.nq)

    @property
    def nv(self) -> int:
        """Size of v and a."""
        return int(self.wheeled.nv)

    @property
    def nu(self) -> int:
        """Size of the input."""
        return int(self.wheeled.nu)

    @cached_property
    def _electric(self) -> tuple[int, ...]:
        """Actuators that take volts."""
        return tuple(k for k, each in enumerate(self.table.actuators) if each.motor.is_electric)

    @cached_property
    def _rubbing(self) -> tuple[int, ...]:
        """Actuators with dry friction, and those whose gear has losses, which hold too."""
        motors = [each.motor for each in self.table.actuators]
        return tuple(k for k in self._electric if motors[k].coulomb or motors[k].efficiency < 1)

    @cached_property
    def inputs(self) -> tuple[Input, ...]:
        """Each of the nu numbers of an input: volts of electric motors, torques of all else."""
        own, first = list(self.wheeled.inputs), self.nu - len(self.table.actuators)
        for k in self._electric:
            most = self.table.actuators[k].motor.voltage
            own[first + k] = Input(own[first + k].name, "V", -most, most)  # type: ignore[operator,arg-type]
        return tuple(own)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What an ensemble may spread of its motors; that of wheels and body are those of the robot."""
        found = []
        for attribute, unit, meaning, may_vanish in _CONSTANTS:
            for at, k in enumerate(self._electric):
                each = self.table.actuators[k]
                if may_vanish and not getattr(each.motor, attribute):
                    continue  # what is not there stays away
                if attribute == "efficiency" and each.motor.efficiency == 1:
                    continue
                found.append(
                    Parameter(
                        f"{attribute}_{each.name}",
                        unit,
                        f"{meaning} of motor {each.name}",
                        0.0,
                        may_vanish=may_vanish,
                        attribute=attribute,
                        entry=at,
                    )
                )
        return tuple(found)

    @cached_property
    def _constants(self) -> dict[str, Array]:
        motors = [self.table.actuators[k].motor for k in self._electric]
        return {name: frozen([getattr(motor, name) for motor in motors]) for name, *_ in _CONSTANTS}

    def with_parameters(self, **values: ArrayLike) -> ByVoltage:
        """Return the robot with other values of its `parameters`.

        Parameters
        ----------
        **values : float or array_like
            By the name of a parameter, or of an attribute such as ``resistance`` with all its numbers.

        Raises
        ------
        InvalidArgument
            If there can be no such motor, or an array has another shape.
        UnknownName
            If there is no such parameter.
        """
        constants = {name: np.array(x) for name, x in self._constants.items()}
        named = {each.name: each for each in self.parameters}
        for name, value in values.items():
            if name in named:
                constants[named[name].attribute][named[name].entry] = scalar(name, value)
            elif name in constants:
                given = vector(name, value, len(self._electric))
                if given.ndim > 1:
                    raise InvalidArgument(
                        f"{name} has shape {given.shape}, expected ({len(self._electric)},)"
                    )
                constants[name] = given
            else:
                raise UnknownName("parameter of a robot", name, named)
        motors = {}
        for at, k in enumerate(self._electric):
            own = self.table.actuators[k]
            new: dict[str, Any] = {name: float(x[at]) for name, x in constants.items()}
            motors[own.name] = replace(own.motor, **new)
        wheels = [
            replace(wheel, motor=motors[wheel.name]) if wheel.name in motors else wheel
            for wheel in self.table.wheels
        ]
        couplings = [
            replace(each, motor=motors[each.name])
            if isinstance(each, Differential) and each.name in motors
            else each
            for each in self.table.couplings
        ]
        table = WheelTable(wheels, self.table.supports, couplings)  # type: ignore[arg-type]
        return ByVoltage(replace(self.wheeled, table=table))

    @property
    def resistance(self) -> Array:
        """Of the motors' armatures, shape (motors,) [ohm]."""
        return self._constants["resistance"]

    @property
    def torque_constant(self) -> Array:
        """Of the motors, shape (motors,) [N m/A]."""
        return self._constants["torque_constant"]

    @property
    def viscous(self) -> Array:
        """Friction of the motors per rate, shape (motors,) [N m s/rad]."""
        return self._constants["viscous"]

    @property
    def coulomb(self) -> Array:
        """Dry friction of the motors, shape (motors,) [N m]."""
        return self._constants["coulomb"]

    @property
    def efficiency(self) -> Array:
        """Of the gears, shape (motors,)."""
        return self._constants["efficiency"]

    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Return the configuration that the displacement `dq` leads to from `q`, shape (..., nq)."""
        return np.asarray(self.wheeled.integrate(q, dq))

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Return the displacement from `q0` to `q1`, shape (..., nv); as of `wheeled`."""
        return np.asarray(self.wheeled.difference(q0, q1))

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
        return np.asarray(self.traced().forward_dynamics(*self._state(q, v, u), force))

    def _state(self, q: ArrayLike, v: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array]:
        return vector("q", q, self.nq), vector("v", v, self.nv), vector("u", u, self.nu)

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
        return np.asarray(self.traced().volts_for(v, torques))

    def torques_at(self, v: ArrayLike, u: ArrayLike) -> Array:
        """Return the torques that motors give at the present rates, shape (..., nu) [N m].

        Parameters
        ----------
        v, u : array_like, shape (..., nv), (..., nu)
            Velocities, and volts.
        """
        v, u = vector("v", v, self.nv), vector("u", u, self.nu)
        return np.asarray(self.traced().torques_at(v, u))

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
        return Linearization(*self.traced().linearize_tracked(q, v, u))

    def initial_state(self, context: Any = None) -> Driving:
        """Return what motors and wheels keep before the first step."""
        return self.traced().initial_state(context)

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
        return self.traced().step(t, *self._state(q, v, u), h, beside, memory)

    def signals(
        self, t: float, q: Array, v: Array, u: Array, f: ArrayLike, memory: Driving
    ) -> dict[str, tuple[str, Any]]:
        """Return what motors, and the ground where wheels slip, did in the step before."""
        return self.traced().signals(t, q, v, u, f, memory)

    def mount(self, arm: Any, at: ArrayLike | None = None, **options: Any) -> ByVoltage:
        """Return the robot with an arm on its body: see `MobileRobot.mount`."""
        return ByVoltage(self.wheeled.mount(arm, at, **options))

    def attach(self, load: Any, frame: str | None = None) -> ByVoltage:
        """Return the robot with a load fixed to one of its frames: see `MobileRobot.attach`."""
        return ByVoltage(self.wheeled.attach(load, frame))

    def on_ramp(self, angle: float, direction: float = 0.0) -> ByVoltage:
        """Return the robot on ground that rises: see `WheeledRobot.on_ramp`."""
        return ByVoltage(self.wheeled.on_ramp(angle, direction))

    def traced(self) -> VoltageBody:
        """Return its dynamics over symbols or arrays."""
        return self._traced

    @cached_property
    def _traced(self) -> VoltageBody:
        body = self.wheeled.traced()
        if isinstance(body, SlippingBody):
            body = replace(body, rubbing=self._rubbing)
        motors = tuple(self.table.actuators[k].motor for k in self._electric)
        return VoltageBody(
            body, motors, self._electric, **self._constants, inputs=self.inputs, parameters=self.parameters
        )
