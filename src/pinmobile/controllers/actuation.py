"""Controllers at the actuators: torques to voltages, wheel speed loops, velocity commands."""

from __future__ import annotations

from functools import cached_property
from typing import Any, final

import attrs
import numpy as np

from pinmobile.arrays import Array, bounded, callable_as, frozen, vector
from pinmobile.controllers.controller import (
    AntiWindup,
    ContextView,
    Controller,
    State,
    Wrapper,
    evaluate,
    is_equal_input,
    notify_applied,
)
from pinmobile.controllers.kinematic_laws import LAW, KinematicLaw, check_law, tracking_error, value_of
from pinmobile.errors import InvalidArgument
from pinmobile.parts import (
    Child,
    Driven,
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
    """Declaration of a robot whose input is voltages, or that has a method `by_voltage`."""

    def convert(self, name: str, value: Any) -> Any:
        """Return the robot whose input is voltages."""
        motor_robot = None if able(value, Electric) or isinstance(value, type) else able(value, Powered)
        return super().convert(name, motor_robot.by_voltage() if motor_robot else value)


@final
@part
class TorqueToVoltage(Wrapper):
    """Wrapper that turns the torques of a controller into voltages, by the inverse of the motor model.

    The inverse uses the wheel rates at the sample. Voltages stay constant between samples, so the torque is
    the desired one at the sample and decreases as the motor accelerates. The wrapped controller receives the
    torques that remain after the limits of voltage and current as its applied input.

    Parameters
    ----------
    controller : controller
        Wrapped controller of torques.
    robot : WheeledRobot
        Controller model with the motors; or the result of its method ``by_voltage()``.

    Raises
    ------
    InvalidArgument
        If `controller` is not a controller, or `robot` has no electric motors.

    See Also
    --------
    Motor : model of an electric motor
    wheels.ByVoltage : robot whose input is voltages
    LQR : law that can compute voltages directly

    Examples
    --------
    >>> from pinmobile import MobileRobot, WheeledRobot
    >>> from pinmobile import WheelTable, law
    >>> from pinmobile.controllers import TorqueToVoltage
    >>> from pinmobile.plant import Context
    >>> from pinmobile.wheels import Motor
    >>> motor = Motor(resistance=2, torque_constant=0.5, voltage=24)
    >>> wheels = WheelTable.differential(0.4, 0.1, motor=motor)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), wheels)
    >>> robot = robot.by_voltage()
    >>> push = TorqueToVoltage(law(lambda t, q, v, r: [2, 2]), robot)
    >>> memory = push.initial_state(Context.of(robot, dt=0.01))
    >>> push(0.0, robot.rest, 0 * robot.rest, None, memory)[0]  # [V]
    array([8., 8.])
    """

    controller: Any = child(Controller, doc="wrapped controller")
    robot: Any = declare(_ByVoltage("model of the controller", Electric))

    def initial_state(self, context: Context) -> tuple[Any, Any]:
        """Return the first state of the wrapped controller, and zero velocities."""
        inner: Any = ContextView(context, inputs=self.robot.wheeled.inputs)
        return self.controller.initial_state(inner), np.zeros(self.robot.nv)

    def applied(self, u: Array, state: tuple[Any, Any], shift: Array | None = None) -> tuple[Any, Any]:
        """Return the next state; the wrapped controller receives the torques of the applied voltages."""
        (inner, v), tau = state, self.robot.torques_at(state[1], u)
        change = None if shift is None else self.robot.torques_at(v, u + shift) - tau
        return notify_applied(self.controller, tau, inner, change), v

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any]
    ) -> tuple[Array, tuple[Any, Any]]:
        """Return the voltages, shape (..., nu) [V], and the next state."""
        torques, inner = evaluate(self.controller, t, q, v, reference, state[0])
        return self.robot.volts_for(v, torques), (inner, v)


@final
@part
class WheelSpeed(AntiWindup):
    """Wheel speed control: a kinematic law sets wheel rates, and a PI loop per motor tracks them.

    Firmware of many robots works in this way::

        u = kp (W_c - W) + ki z,   dz/dt = W_c - W

    W_c are the rates at which the wheels roll as the law commands. Where the input is limited and the
    integral would grow further, its last increment is removed (anti-windup).

    The reference is the pose of the body, as for `Backstepping`. A robot without one rolling axle, such as a
    skid-steer base, is treated as a robot with an axle through its origin.

    Parameters
    ----------
    law : kinematic law
        Law from tracking error to speed and yaw rate, such as `UnicycleTracking`.
    robot : WheeledRobot
        Controller model of the wheels; for a robot driven by voltages, the gains are per volt.
    kp, ki : float
        Gains, > 0 and >= 0 [N m s/rad, N m/rad, or V s/rad, V/rad]. For voltages, kp = V / (10 W_0) and
        ki = kp / dt are a start, with the largest voltage V and the no-load rate W_0 of the wheel.

    Raises
    ------
    InvalidArgument
        If an argument is of another kind or out of range, or the robot has arms or wheels that steer; at the
        start of a run, if the law cannot follow the reference.

    See Also
    --------
    Backstepping : torques with a dynamic model
    controllers.VelocityCommand : commands without a wheel loop

    Examples
    --------
    >>> from pinmobile import Circle, MobileRobot, Tangent
    >>> from pinmobile import UnicycleTracking, WheeledRobot
    >>> from pinmobile import WheelTable, simulate
    >>> from pinmobile.controllers import WheelSpeed
    >>> wheels = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), wheels)
    >>> law = WheelSpeed(UnicycleTracking(), robot, kp=3.0, ki=9.0)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=1.0))
    >>> run = simulate(robot, law, path, dt=0.05, v0=0 * robot.rest)
    >>> print(f"{1e3 * max(run.max_error()[:2]):.0f} mm from rest")
    7 mm from rest
    """

    law: Any = child(KinematicLaw, doc="kinematic law", expected=LAW)
    robot: Any = child(Tabled, doc="model of the controller")
    kp: float = number(above=0.0, unit="N m s/rad, V s/rad", doc="gain of the rate error")
    ki: float = number(default=0.0, lower=0.0, unit="N m/rad, V/rad", doc="gain of the integral")

    def check(self) -> None:
        """Raise `InvalidArgument` if the robot has arms, or wheels that steer."""
        callable_as("law(tracked, state)", self.law)
        table = self.robot.table
        if table.axes or self.robot.nu > len(table.actuators):
            raise InvalidArgument(
                "robot has arms, or wheels that steer, expected a robot whose inputs are all motors of "
                "fixed wheels"
            )

    @structure
    def _axle(self) -> Array:
        """Coefficients of the body twist in the velocity across the axle, shape (3,)."""
        axle = self.robot.axle if self.robot.mobility.is_regular else np.array([0.0, 1.0, 0.0])
        return frozen(axle / np.hypot(axle[0], axle[1]))

    @structure
    def _columns(self) -> Array:
        """Rate of each motor per rate of each wheel, shape (nu, wheels)."""
        return np.array([actuator.column for actuator in self.robot.table.actuators])

    @cached_property
    def _rate_matrix(self) -> Array:
        """Rate of each motor per speed and per yaw rate, shape (2, nu)."""
        a, b, arm = self._axle
        twists = np.array([[b, -a, 0.0], [-arm * a, -arm * b, 1.0]])
        return np.asarray(self.robot.wheel_rates(twists) @ self._columns.T)

    @structure
    def _rate_entries(self) -> tuple[tuple[tuple[int, float], ...], ...]:
        """Entries of v in the rate of each motor, and their coefficients."""
        offset = self.robot.nv - self._columns.shape[1]
        return tuple(tuple((offset + i, float(x)) for i, x in enumerate(row) if x) for row in self._columns)

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, Any, Any]:
        """Return the law's state, integrals, increments, last input, and time step."""
        check_law(self.law, self._axle, context)
        zeros = np.zeros(len(self._rate_entries))
        return self.law.initial_state(context), zeros, zeros, zeros, float(context.dt)

    def applied(self, u: Array, state: tuple[Any, Any, Any, Any, Any]) -> tuple[Any, Any, Any, Any, Any]:
        """Return the state without the increments that a limit makes useless, shape (..., nu)."""
        law, integral, gain, law_input, dt = state
        is_useless = ((law_input - u) * gain > 0.0) & ~is_equal_input(u, law_input)
        return law, integral - np.where(is_useless, gain, 0.0), gain, law_input, dt

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, Any, Any]
    ) -> tuple[Array, tuple[Any, Any, Any, Any, Any]]:
        """Return the input, shape (..., nu), and the next state."""
        law, integral, _, _, dt = state
        a, b, _ = self._axle
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        body_speed = (b * c + a * s) * v[..., 0] + (b * s - a * c) * v[..., 1]
        error_state, _ = tracking_error(self.robot, self._axle, q, v, reference, body_speed)
        (speed, yaw_rate), law = self.law(error_state, law)
        v_c, w_c = value_of(speed), value_of(yaw_rate)
        errors = []
        for k, column in enumerate(self._rate_entries):
            rate = self._rate_matrix[0, k] * v_c + self._rate_matrix[1, k] * w_c
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
    """Controller that passes a kinematic law's speed and yaw rate to a robot that takes commands.

    The law assumes that the robot follows commands without delay. `Backstepping` with the same robot
    compensates the delay.

    Parameters
    ----------
    law : kinematic law
        Law from tracking error to speed and yaw rate, such as `UnicycleTracking`, which states its conditions
        on the reference.
    robot : VelocityRobot or VelocityCar
        Controller model, which defines the position of the axle, and the steering angles of a car.

    Raises
    ------
    InvalidArgument
        If an argument is of another kind; at the start of a run, if the law cannot follow the reference.

    See Also
    --------
    VelocityRobot : plant whose input is speed and yaw rate
    identification.VelocityCar : plant whose input is speed and steering angle
    UnicycleTracking : a kinematic law
    Backstepping : law that compensates the robot's dynamics
    controllers.AdaptiveVelocity : law that estimates the robot's parameters

    Examples
    --------
    >>> from pinmobile import Circle, Tangent, UnicycleTracking
    >>> from pinmobile import VelocityRobot, simulate
    >>> from pinmobile.controllers import VelocityCommand
    >>> robot = VelocityRobot(theta=[0.3, 0.2, 0, 1, 0, 1])
    >>> law = VelocityCommand(UnicycleTracking(), robot)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=1.0))
    >>> run = simulate(robot, law, path, dt=0.05, v0=0 * robot.rest)
    >>> print(f"{1e3 * max(run.max_error()[:2]):.0f} mm from rest")
    58 mm from rest
    """

    law: Any = child(KinematicLaw, doc="kinematic law", expected=LAW)
    robot: Any = child(Driven, doc="model of the controller")

    def check(self) -> None:
        """Raise `InvalidArgument` if the law is not callable as a kinematic law."""
        callable_as("law(tracked, state)", self.law)

    @structure
    def _axle(self) -> Array:
        """Coefficients of the robot's axle, which references must follow, shape (3,)."""
        return vector("axle of robot", self.robot.axle, _BASE)

    def initial_state(self, context: Context) -> Any:
        """Return the first state of the law."""
        check_law(self.law, self._axle, context)
        return self.law.initial_state(context)

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: Any) -> tuple[Array, Any]:
        """Return the commands, shape (..., 2) [m/s, rad/s or rad], and the law's next state."""
        body_speed = self.robot.independent(q, v)[..., 0]
        error_state, _ = tracking_error(self.robot, self.robot.axle, q, v, reference, body_speed)
        (speed, yaw_rate), state = self.law(error_state, state)
        return self.robot.command_for(value_of(speed), value_of(yaw_rate)), state


@final
@part
class RandomSteps:
    """Speed and yaw rate with random steps, independent of each other, to excite a robot.

    Levels and hold times are uniform between their bounds. They follow from the seed and, in an ensemble,
    from the robot. The controller does not use state and reference.

    Parameters
    ----------
    lowest, largest : array_like, shape (2,)
        Bounds of speed and yaw rate [m/s, rad/s].
    hold : array_like, shape (2,)
        Shortest and longest hold time of a level [s].
    seed : int
        Seed of levels and times.

    Raises
    ------
    InvalidArgument
        If an array has another shape or is not finite, an upper bound is below its lower bound, a time is not
        above zero, or `seed` is not a whole number.

    See Also
    --------
    excitation : designed motion for the identification of a robot driven by forces
    identify_velocity : estimates the parameters of such a robot

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold, VelocityRobot
    >>> from pinmobile import simulate
    >>> from pinmobile.controllers import RandomSteps
    >>> robot = VelocityRobot(theta=[0.3, 0.2, 0, 1, 0, 1])
    >>> unused = FixedHeading(Hold([0.0, 0.0], 1.0), psi=0.0)
    >>> run = simulate(robot, RandomSteps(seed=3), unused, dt=0.1)
    >>> run.u[0].round(2)  # [m/s, rad/s]
    array([0.11, 0.47])
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
        doc="hold time of a level",
    )
    seed: int = integer(default=0, doc="seed of levels and times")

    def check(self) -> None:
        """Raise `InvalidArgument` if an upper bound is below its lower bound."""
        for k, (low, high) in enumerate(zip(self.lowest.tolist(), self.largest.tolist(), strict=True)):
            bounded(f"largest[{k}]", high, least=low)
        bounded("hold[1]", self.hold[1], least=float(self.hold[0]), unit="s")

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, float]:
        """Return the remaining hold times, the levels, the noise, and the time step."""
        return np.zeros(2), np.zeros(2), context.noise(f"random steps {self.seed}", 8), float(context.dt)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, float]
    ) -> tuple[Array, tuple[Any, Any, Any, float]]:
        """Return the levels, shape (..., 2) [m/s, rad/s], and the next state."""
        remaining, level, noise, dt = state
        numbers, noise = noise.draw()
        # The direction of a vector of two normal numbers is uniform.
        x, y = numbers[..., :4], numbers[..., 4:]
        share = 0.5 + _TURN * np.arctan2(y, x)
        is_over = remaining < _HALF_SAMPLE * dt
        level = np.where(is_over, self.lowest + (self.largest - self.lowest) * share[..., :2], level)
        new_hold = self.hold[..., :1] + (self.hold[..., 1:] - self.hold[..., :1]) * share[..., 2:]
        remaining = np.where(is_over, new_hold, remaining) - dt
        return level, (remaining, level, noise, dt)
