"""Theta of a robot with velocity inputs: its law, and its numbers from motors and gains."""

from __future__ import annotations

from typing import Any

import numpy as np

from pinmobile.arrays import instance, non_negative, positive
from pinmobile.errors import InvalidArgument
from pinmobile.wheels import ByVoltage, WheeledRobot

THETA: tuple[tuple[str, str, str], ...] = (
    ("theta_1", "s", "inertia of the speed, over the gain of its loop"),
    ("theta_2", "s", "inertia of the yaw rate, over the gain of its loop"),
    ("theta_3", "s m/rad^2", "what a centre of mass ahead of the axle does to the speed"),
    ("theta_4", "", "command per steady speed: 1, and losses over the gain"),
    ("theta_5", "s/m", "what a centre of mass ahead of the axle does to the yaw rate"),
    ("theta_6", "", "command per steady yaw rate: 1, and losses over the gain"),
)
# Name, unit and meaning of each of the six parameters.

ABOVE_ZERO = 0, 1, 3, 5  # without inertia there is no law, and without losses speeds grow by themselves


def rates_of(theta: Any, most: Any, nu: Any, u: Any) -> Any:
    """Return the rates of speed and yaw rate nu for commands u, within largest ones, shape (..., 2)."""
    speed, w = nu[..., 0], nu[..., 1]
    one, two, three, four, five, six = (theta[..., k] for k in range(len(THETA)))
    faster = (three * (w * w) - four * speed + u[..., 0]) / one
    turning = (u[..., 1] - five * (speed * w) - six * w) / two
    return np.minimum(np.maximum(stacked(faster, turning), -most), most)


def rolling_of(ahead: Any, q: Any, nu: Any) -> Any:
    """Return the rates of x, y and psi, of a point ahead of the axle, shape (..., 3)."""
    c, s, u, w = np.cos(q[..., 2]), np.sin(q[..., 2]), nu[..., 0], nu[..., 1]
    return stacked(u * c - ahead * w * s, u * s + ahead * w * c, w)


def stacked(*columns: Any) -> Any:
    """Return broadcast columns along a new last axis."""
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


_SAME = 1e-9  # relative, of two wheels that are alike


def theta_of_motors(
    wheeled: WheeledRobot | ByVoltage, kp: float, kd: float
) -> tuple[list[float], dict[str, Any]]:
    """Return theta, and further fields of a robot; see `VelocityRobot.from_motors`."""
    robot: Any = wheeled.wheeled if isinstance(wheeled, ByVoltage) else wheeled
    instance("wheeled", robot, WheeledRobot, "a WheeledRobot")
    kp, kd = positive("kp", kp, "V s/rad"), non_negative("kd", kd, "V s^2/rad")
    wheel, motor = _pair_of(robot)
    base, r, d = robot.robot, wheel.radius, 2 * abs(wheel.y)
    m, b = base.mass, float(base.com[0]) - wheel.x
    J, E = wheel.spin_inertia + motor.reflected_inertia, motor.gear * motor.torque_constant
    by = motor.resistance / (motor.efficiency * E)
    losses = E + by * motor.efficiency * motor.gear**2 * motor.viscous  # (R/K) (K E / R + B)
    T, R, dT, dR = kp / r, kp * d / (2 * r), kd / r, kd * d / (2 * r)
    turning = J * d * d + 2 * r * r * (base.yaw_inertia + m * b * b)
    theta = [
        (by * (m * r * r + 2 * J) + 2 * r * dT) / (2 * r * T),
        (by * turning + 2 * r * d * dR) / (2 * r * d * R),
        by * m * b * r / (2 * T),
        losses / (r * T) + 1,
        by * m * b * r / (d * R),
        losses * d / (2 * r * R) + 1,
    ]
    source = f"motors of a WheeledRobot, gains kp = {kp:g}, kd = {kd:g}"
    return theta, {"ahead": -wheel.x, "size": base.size, "source": source}


def _pair_of(robot: WheeledRobot) -> tuple[Any, Any]:
    """Return a wheel and a motor of a robot on two driven wheels that are alike."""
    table, is_pair = robot.table, False
    if not (robot.robot.nv > 3 or table.axes or table.couplings) and len(table) == len(table.actuators) == 2:
        one, other = table.wheels
        a, b = ((each.x, each.radius, each.spin_inertia, abs(each.y)) for each in (one, other))
        plain = not (one.angle or other.angle or one.roller or other.roller) and one.y * other.y < 0
        is_pair = plain and np.allclose(a, b, _SAME, _SAME) and one.motor == other.motor
    if not (is_pair and one.motor and one.motor.is_electric):
        raise InvalidArgument(
            "wheeled has arms, or other wheels or motors, expected two fixed wheels on one axle, alike, each "
            "with the same Motor(resistance=..., torque_constant=..., voltage=...), and casters: "
            "WheelTable.differential"
        )
    return one, one.motor
