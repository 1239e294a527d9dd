"""What stands between controllers and motors: torques as volts, rates that firmware holds, commands."""

from __future__ import annotations

from functools import cached_property
from typing import Any, final

import attrs
import numpy as np

from pinmobile.arrays import Array, bounded, callable_as, frozen, vector
from pinmobile.controllers.controller import Controller, Seen, State, Wrapper, answer_of, told
from pinmobile.controllers.kinematic_laws import (
    LAW,
    KinematicLaw,
    check_law,
    tracked,
    value_of,
)
from pinmobile.errors import InvalidArgument
from pinmobile.parts import (
    Child,
    Commanded,
    Electric,
    Powered,
    Tabled,
    able,
    array,
    child,
    declare,
    integer,
    number,
    part,
    structure,
)
from pinmobile.plant import Context

_COMMANDS = ("speed", "yaw_rate")
_BASE = 3
_TURN = 1 / (2 * np.pi)
_HALF_SAMPLE = 0.5


@attrs.frozen
class _ByVoltage(Child):
    """Declaration of a robot that takes volts, or can."""

    def checked(self, name: str, value: Any) -> Any:
        """Return the robot that takes volts."""
        powered = None if able(value, Electric) or isinstance(value, type) else able(value, Powered)
        return super().checked(name, powered.by_voltage() if powered else value)


@final
@part
class TorqueToVoltage(Wrapper):
    """A controller of torques whose robot takes volts: by the inverse of its motors at the present rates.

    Volts are held between samples while rates change, so that torques are those asked for at a sample and
    less as a motor gets faster. What limits of voltages and currents leave of the torques is what the wrapped
    controller is told to have been applied.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    robot : WheeledRobot
        With the motors in which the controller believes; or what its ``by_voltage()`` returns.

    Raises
    ------
    InvalidArgument
        If `controller` is none, or `robot` has no motors that take volts.
    """

    controller: Any = child(Controller, doc="wrapped controller")
    robot: Any = declare(_ByVoltage("model of the controller", Electric))

    def initial_state(self, context: Context) -> tuple[Any, Any]:
        """Return the state that the wrapped controller starts with, and velocities."""
        inner: Any = Seen(context, inputs=self.robot.wheeled.inputs)
        return self.controller.initial_state(inner), np.zeros(self.robot.nv)

    def applied(self, u: Array, state: tuple[Any, Any]) -> tuple[Any, Any]:
        """Return the state, with the wrapped controller told of the torques of an input, shape (..., nu)."""
        inner, v = state
        return told(self.controller, self.robot.torques_at(v, u), inner), v

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any]
    ) -> tuple[Array, tuple[Any, Any]]:
        """Return the input, shape (..., nu), and the next state."""
        torques, inner = answer_of(self.controller, t, q, v, reference, state[0])
        return self.robot.volts_for(v, torques), (inner, v)


@final
@part
class WheelSpeed:
    """From a kinematic law to rates of wheels, each held by its own loop, as firmware of robots does.

        u = kp (W_c - W) + ki z,   z' = W_c - W

    W_c are the rates at which motors turn when wheels roll as the law says. What an integral gains in a
    sample is taken back where the input is limited and the gain would push it further.

    The reference is the pose of the body, as of `Backstepping`; a robot that rolls on no one axle, such as a
    skid-steer base, is taken as one with an axle through its origin.

    Parameters
    ----------
    law : kinematic law
        Such as `UnicycleTracking`.
    robot : WheeledRobot
        Its wheels in which the controller believes; of one by volts the gains are per volt.
    kp, ki : float
        Gains, > 0 and >= 0 [N m s/rad, N m/rad, or V s/rad, V/rad].

    Raises
    ------
    InvalidArgument
        If an argument is something else, or the robot has wheels that steer, or arms.
    """

    law: Any = child(KinematicLaw, doc="kinematic law", expected=LAW)
    robot: Any = child(Tabled, doc="model of the controller")
    kp: float = number(above=0.0, unit="N m s/rad, V s/rad", doc="gain of the rates")
    ki: float = number(default=0.0, lower=0.0, unit="N m/rad, V/rad", doc="gain of their integrals")

    def check(self) -> None:
        """Raise `InvalidArgument` where the robot has wheels that steer, or arms."""
        callable_as("law(tracked, state)", self.law)
        table = self.robot.table
        if table.axes or self.robot.nu > len(table.actuators):
            raise InvalidArgument(
                "robot has arms, or wheels that steer, expected one whose inputs are all motors of fixed "
                "wheels"
            )

    @structure
    def _axle(self) -> Array:
        """Coefficients of the body twist in the velocity across the axle, shape (3,)."""
        axle = self.robot.axle if self.robot.mobility.is_regular else np.array([0.0, 1.0, 0.0])
        return frozen(axle / np.hypot(axle[0], axle[1]))

    @structure
    def _columns(self) -> Array:
        """Rate of each motor by those of the wheels, shape (nu, wheels)."""
        return np.array([actuator.column for actuator in self.robot.table.actuators])

    @cached_property
    def _wanted(self) -> Array:
        """Rates of motors by the speed and by the yaw rate, shape (2, nu)."""
        a, b, arm = self._axle
        twists = np.array([[b, -a, 0.0], [-arm * a, -arm * b, 1.0]])
        return np.asarray(self.robot.wheel_rates(twists) @ self._columns.T)

    @structure
    def _measured(self) -> tuple[tuple[tuple[int, float], ...], ...]:
        """Entries of v that are in the rate of each motor, and their shares."""
        first = self.robot.nv - self._columns.shape[1]
        return tuple(tuple((first + i, float(x)) for i, x in enumerate(row) if x) for row in self._columns)

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, Any, Any]:
        """Return the law's state, integrals, their gains, the last input, and the time between samples."""
        check_law(self.law, self._axle, context)
        none = np.zeros(len(self._measured))
        return self.law.initial_state(context), none, none, none, float(context.dt)

    def applied(self, u: Array, state: tuple[Any, Any, Any, Any, Any]) -> tuple[Any, Any, Any, Any, Any]:
        """Return the state, integrals without what a limit of the input kept them from, shape (..., nu)."""
        law, integral, gain, asked, dt = state
        back = np.where((asked - u) * gain > 0.0, gain, 0.0)
        return law, integral - back, gain, asked, dt

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, Any, Any]
    ) -> tuple[Array, tuple[Any, Any, Any, Any, Any]]:
        """Return the input, shape (..., nu), and the next state."""
        law, integral, _, _, dt = state
        a, b, _ = self._axle
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        own = (b * c + a * s) * v[..., 0] + (b * s - a * c) * v[..., 1]
        known, _ = tracked(self.robot, self._axle, q, v, reference, own)
        (speed, yaw_rate), law = self.law(known, law)
        wanted, turning = value_of(speed), value_of(yaw_rate)
        errors = []
        for k, column in enumerate(self._measured):
            rate = self._wanted[0, k] * wanted + self._wanted[1, k] * turning
            for i, share in column:
                rate = rate - share * v[..., i]
            errors.append(rate)
        error = np.stack(np.broadcast_arrays(*errors), axis=-1)
        gain = dt * error
        integral = integral + gain
        u = self.kp * error + self.ki * integral
        return u, (law, integral, gain, u, dt)


@final
@part
class VelocityCommand:
    """A kinematic law's speed and yaw rate, as they are, for the input of a robot that takes these.

    As most robots are driven: the law takes it that the firmware follows at once. `Backstepping` with the
    same robot takes into account how late it is.

    Parameters
    ----------
    law : kinematic law
        Such as `UnicycleTracking`; what it needs of a reference is said there.
    robot : VelocityRobot
        Of which the controller knows where the axle is.

    Raises
    ------
    InvalidArgument
        If an argument is something else.
    """

    law: Any = child(KinematicLaw, doc="kinematic law", expected=LAW)
    robot: Any = child(Commanded, doc="model of the controller")

    def check(self) -> None:
        """Raise `InvalidArgument` where the law cannot be called as one."""
        callable_as("law(tracked, state)", self.law)

    @structure
    def _axle(self) -> Array:
        """The axle of the robot as it is given, which references follow."""
        return vector("axle of robot", self.robot.axle, _BASE)

    def initial_state(self, context: Context) -> Any:
        """Return the law's state."""
        check_law(self.law, self._axle, context)
        return self.law.initial_state(context)

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: Any) -> tuple[Array, Any]:
        """Return the commands, shape (..., 2) [m/s, rad/s], and the law's next state."""
        own = self.robot.independent(q, v)[..., 0]
        known, _ = tracked(self.robot, self.robot.axle, q, v, reference, own)
        (speed, yaw_rate), state = self.law(known, state)
        wanted = value_of(speed), value_of(yaw_rate)
        return np.stack(np.broadcast_arrays(*wanted), axis=-1), state


@final
@part
class RandomSteps:
    """Speed and yaw rate that jump, independently of each other, to levels that are held for a while.

    Levels and times are equally likely anywhere between their bounds; they follow from the seed and, in an
    ensemble, the robot. State and reference are not looked at.

    Parameters
    ----------
    lowest, largest : array_like, shape (2,)
        Bounds of the levels, in the units of the inputs [m/s, rad/s].
    hold : array_like, shape (2,)
        Shortest and longest time for which a level is held [s].
    seed : int
        Of both.

    Raises
    ------
    InvalidArgument
        If an array has another shape or is not finite, upper bounds are below lower ones, a time is not above
        zero, or `seed` is no whole number.
    """

    lowest: Any = array(
        default=(-0.2, -1.3),
        shapes=((2,),),
        unit="m/s, rad/s",
        labels=_COMMANDS,
        doc="lower bounds of levels",
    )
    largest: Any = array(
        default=(0.8, 1.3), shapes=((2,),), unit="m/s, rad/s", labels=_COMMANDS, doc="upper bounds of levels"
    )
    hold: Any = array(
        default=(0.4, 2.5),
        shapes=((2,),),
        above=0.0,
        unit="s",
        labels=("shortest", "longest"),
        doc="time that a level is held",
    )
    seed: int = integer(default=0, doc="seed of levels and times")

    def check(self) -> None:
        """Raise `InvalidArgument` where upper bounds are below lower ones."""
        for k, (low, high) in enumerate(zip(self.lowest.tolist(), self.largest.tolist(), strict=True)):
            bounded(f"largest[{k}]", high, least=low)
        bounded("hold[1]", self.hold[1], least=float(self.hold[0]), unit="s")

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, float]:
        """Return how long levels still hold, levels, the noise that draws them, and the sampling time."""
        return np.zeros(2), np.zeros(2), context.noise(f"random steps {self.seed}", 8), float(context.dt)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, float]
    ) -> tuple[Array, tuple[Any, Any, Any, float]]:
        """Return the levels, shape (..., 2), and the next state."""
        left, level, noise, dt = state
        numbers, noise = noise.draw()
        # The direction of two normal numbers is equally likely anywhere.
        x, y = numbers[..., :4], numbers[..., 4:]
        share = 0.5 + _TURN * np.arctan2(y, x)
        ends = left < _HALF_SAMPLE * dt
        level = np.where(ends, self.lowest + (self.largest - self.lowest) * share[..., :2], level)
        longer = self.hold[..., :1] + (self.hold[..., 1:] - self.hold[..., :1]) * share[..., 2:]
        left = np.where(ends, longer, left) - dt
        return level, (left, level, noise, dt)
