"""`VelocityCar`: a car with commands of speed and steering angle."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, final

import attrs
import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, shaped, text, vector
from pinmobile.identification._velocity_robot import (
    VelocityInputs,
    VelocityRobot,
    arrays,
    pair,
    point_acceleration,
    rolling_of,
    size_of,
    stack,
)
from pinmobile.parts import by_value, evolved, number, option, part
from pinmobile.plant import Coordinate
from pinmobile.robot import MobileRobot
from pinmobile.wheels import WheeledRobot, WheelTable

_QUICKER = 4.0  # time constant of the steering angle per time constant of its rate: critical damping
_MAX_ANGLE = 1.4  # [rad], steering angle from which the curvature stays the same


def _box(car: Any) -> Any:
    """Return the size of the box of a car [m]."""
    return 1.4 * car.wheelbase, 0.7 * car.wheelbase, 0.3 * car.wheelbase


def curvature_of(car: Any, speed: Any, steering: Any) -> Any:
    """Return the curvature of the path of a car at a speed and a steering angle [1/m]."""
    angle = np.minimum(np.maximum(steering, -_MAX_ANGLE), _MAX_ANGLE)
    return np.tan(angle) / (car.wheelbase + car.understeer * (speed * speed))


def faster_of(car: Any, state: Any, u: Any) -> tuple[Any, Any, Any]:
    """Return the rates of speed, steering angle and steering rate of a car.

    The car has the numbers of a `VelocityCar`, which may be arrays or symbols.
    """
    (speed, steering, turning), T = state, car.steering_time_constant
    k, square = curvature_of(car, speed, steering), speed * speed
    bend = k * k * (car.wheelbase + car.understeer * square)
    faster = (car.speed_gain * u[0] - speed) / car.speed_time_constant
    faster = faster - car.cornering_drag * speed * np.abs(speed) * bend
    target = (car.steering_gain * u[1] + car.steering_offset - steering) / T
    acceleration, rate = car.rate_limits[..., 0], car.rate_limits[..., 1]
    faster = np.minimum(np.maximum(faster, -acceleration), acceleration)
    target = np.minimum(np.maximum(target, -rate), rate)
    return faster, turning, _QUICKER * (target - turning) / T


@final
@part
@by_value
class VelocityCar(VelocityInputs):
    """A car with commands of speed and steering angle as inputs: a kinematic bicycle with lags.

    The firmware of the car controls speed u and steering angle delta with time constants T. The wheels roll,
    and the path has the curvature k at the middle of the rear axle::

        u' = (g_u u_c - u) / T_u - c u |u| k tan delta
        delta'' = 4 ((g_d delta_c + delta_0 - delta) / T_d - delta') / T_d
        k = tan delta / (L + K u^2),   psi' = k u
        x' = u cos psi - a psi' sin psi,  y' = u sin psi + a psi' cos psi

    Here (u_c, delta_c) are the commands, L is the wheelbase, K is the understeer, and c is the cornering
    drag. The steering is critically damped, and T_d is its delay behind a command that changes slowly.
    q = (x, y, psi, delta) is the pose of a point at distance a ahead of the rear axle and the steering angle,
    and v = dq/dt.

    The model accepts no forces. The integrator is `rk4`. It needs time steps, or substeps, shorter than T_u
    and T_d.

    Parameters
    ----------
    wheelbase : float
        Distance L between the axles, > 0 [m].
    speed_time_constant, steering_time_constant : float
        Time constants T_u and T_d, > 0 [s].
    speed_gain, steering_gain : float
        Steady speed g_u and steering angle g_d per command.
    steering_offset : float
        Steering angle delta_0 of the command 0 [rad].
    understeer : float
        Steering angle K per lateral acceleration, beyond that of rolling wheels [rad s^2/m]; negative:
        oversteer.
    cornering_drag : float
        Braking c by the lateral force of the front wheels, per lateral acceleration and tan delta. Without
        control of the speed, it is the share of the mass on the front axle.
    ahead : float
        Distance a of the body origin ahead of the rear axle [m].
    limits : array_like, shape () or (2,)
        Largest commands in both directions, > 0 [m/s, rad]; infinite: no limit.
    rate_limits : array_like, shape () or (2,)
        Largest acceleration and steering rate in the firmware, > 0 [m/s^2, rad/s]; infinite: no limit.
    size : array_like, shape (3,), optional
        Length, width and height of the drawn box [m]; default: of a car with this wheelbase.
    source : str
        Source of the numbers.

    Raises
    ------
    InvalidArgument
        If a number is not finite or out of range, or an array has another shape.

    See Also
    --------
    identify_velocity : estimate the numbers from a log
    VelocityRobot : robot with commands of speed and yaw rate
    WheelTable : its constructor `car` returns wheels of a car with masses and torques
    controllers.VelocityCommand : commands from a kinematic law

    Notes
    -----
    The understeer is that of the linear single-track model in a steady turn. The model has no sideslip at the
    rear axle.

    References
    ----------
    R. Rajamani, Vehicle Dynamics and Control, 2nd edition, chapters 2 and 3 (Springer 2012).

    Examples
    --------
    >>> from pinmobile import law, simulate
    >>> from pinmobile.identification import VelocityCar
    >>> car = VelocityCar(wheelbase=0.3, speed_time_constant=0.2,
    ...                   steering_time_constant=0.1)
    >>> float(car.curvature(speed=1.0, steering=0.2).round(3))  # [1/m]
    0.676
    """

    wheelbase: float = number(above=0, unit="m", doc="distance between the axles")
    speed_time_constant: float = number(above=0, unit="s", doc="time constant of the speed")
    steering_time_constant: float = number(above=0, unit="s", doc="time constant of the steering")
    speed_gain: float = number(default=1.0, doc="steady speed per command")
    steering_gain: float = number(default=1.0, doc="steady steering angle per command")
    steering_offset: float = number(default=0.0, unit="rad", doc="steering angle of the command 0")
    understeer: float = number(default=0.0, unit="rad s^2/m", doc="steering angle per lateral acceleration")
    cornering_drag: float = number(default=0.0, doc="braking by the lateral force of the front wheels")
    ahead: float = number(default=0.0, unit="m", doc="distance of the body origin ahead of the rear axle")
    limits: Any = pair("largest commands", "m/s, rad", ("speed", "steering"), fixed=True)
    rate_limits: Any = pair(
        "largest acceleration and steering rate", "m/s^2, rad/s", ("acceleration", "steering_rate")
    )
    size: Any = option(default=attrs.Factory(_box, takes_self=True), check=size_of)
    source: str = option(default="", check=text)

    nq: ClassVar[int] = 4
    nv: ClassVar[int] = 4
    nu: ClassVar[int] = 2
    commanded: ClassVar[Any] = ("speed command", "m/s"), ("steering command", "rad")
    unforced: ClassVar[str] = "the model does not describe how a car"
    coordinates: ClassVar[Any] = *VelocityRobot.coordinates, Coordinate("steering", "rad")
    rest: ClassVar[Array] = frozen(np.zeros(4))

    # Kinematics

    def curvature(self, speed: Any, steering: Any) -> Any:
        """Return the curvature of the path of the rear axle [1/m] at a speed [m/s] and an angle [rad]."""
        return curvature_of(self, speed, steering)

    def command_for(self, speed: Any, yaw_rate: Any) -> Any:
        """Return the commands for a steady speed and yaw rate, shape (..., 2) [m/s, rad].

        At rest the steering is straight.
        """
        at_rest = speed == 0.0
        curvature = np.where(at_rest, 0.0, yaw_rate / np.where(at_rest, 1.0, speed))
        steering = np.arctan((self.wheelbase + self.understeer * (speed * speed)) * curvature)
        return stack(speed / self.speed_gain, (steering - self.steering_offset) / self.steering_gain)

    @arrays(q=4, nu=2)
    def rolling(self, q: Any, nu: Any) -> Any:
        """Return v for independent velocities `nu`, shape (..., 4) [m/s, m/s, rad/s, rad/s]."""
        speed = nu[..., 0]
        twist = stack(speed, speed * self.curvature(speed, q[..., 3]))
        return np.concatenate([rolling_of(self.ahead, q, twist), nu[..., 1:]], axis=-1)

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return q and v at the start of a reference, shape (4,) each, with rolling and steered wheels."""
        pose = shaped("reference.q", finite("reference.q", reference.q), (3,))
        vx, vy, yaw_rate = np.asarray(reference.v, float)
        speed = np.cos(pose[2]) * vx + np.sin(pose[2]) * vy
        steering = self.command_for(speed, yaw_rate)[1] * self.steering_gain + self.steering_offset
        q = np.append(pose, steering)
        return q, self.rolling(q, np.array([speed, 0.0]))

    # Dynamics

    def _acceleration(self, q: Any, v: Any, u: Any) -> Any:
        speed, turning = (self.independent(q, v)[..., k] for k in (0, 1))
        faster, _, steering = faster_of(self, (speed, q[..., 3], turning), (u[..., 0], u[..., 1]))
        length = self.wheelbase + self.understeer * (speed * speed)
        k = self.curvature(speed, q[..., 3])
        bends = turning * (1 / length + k * k * length)  # k' by the steering angle
        bends = np.where(np.abs(q[..., 3]) < _MAX_ANGLE, bends, 0.0)
        bends = bends - 2 * self.understeer * speed * faster * k / length
        nu, rates = stack(speed, k * speed), stack(faster, bends * speed + k * faster)
        return point_acceleration(self.ahead, q, nu, rates, steering)

    # What is drawn

    @cached_property
    def _visuals(self) -> WheeledRobot:
        L, (_, width, height) = float(self.wheelbase), self.size
        wheels: dict[str, Any] = {"steering_limit": _MAX_ANGLE, "spin_inertia": 1e-3, "yaw_inertia": 1e-3}
        table = WheelTable.car(L, 0.9 * width, min(0.45 * height, 0.2 * L), **wheels)
        drive, steering = table.couplings  # with the origin in the middle, as the box
        rows = [evolved(wheel, x=wheel.x - 0.5 * L) for wheel in table.wheels]
        table = WheelTable(tuple(rows), (), (drive, evolved(steering, axle=-0.5 * L)))
        return WheeledRobot(MobileRobot(1.0, 1.0, size=self.size), table)

    def drawing(self, q: ArrayLike) -> Array:
        """Return the poses of the objects of `visual_model` in the inertial frame, shape (..., k, 4, 4)."""
        q, robot = vector("q", q, 4), self._visuals
        q_robot = np.zeros((*q.shape[:-1], robot.nq))
        middle = 0.5 * self.wheelbase - self.ahead
        q_robot[..., :2] = q[..., :2] + middle * stack(np.cos(q[..., 2]), np.sin(q[..., 2]))
        q_robot[..., 2:4] = q[..., 2:]
        return np.asarray(robot.drawing(q_robot))
