"""The first-order model of the tracked state: by the complex step, and by other routes."""

from typing import Any

import numpy as np
import pytest

from pinmobile import MobileRobot, WheeledRobot, WheelTable
from pinmobile.arrays import Array
from pinmobile.wheels import Motor

BODY = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
ARM = MobileRobot.box().mount("ur5")
ELECTRIC: Any = {"resistance": 1.2, "torque_constant": 0.03, "voltage": 1e3, "gear": 20.0}
MOTOR = Motor(**ELECTRIC, efficiency=0.8, rotor_inertia=1e-5, viscous=1e-3, coulomb=0.004)
ON_WHEELS: Any = {
    "differential": WheeledRobot(BODY, WheelTable.differential(0.1, 0.4)),
    "mecanum": WheeledRobot(BODY, WheelTable.mecanum(0.5, 0.4, 0.1)),
    "differential by volts": WheeledRobot(BODY, WheelTable.differential(0.1, 0.4, motor=MOTOR)).by_voltage(),
    "differential with an arm": WheeledRobot(ARM, WheelTable.differential(0.1, 0.4)),
}


def rolling(robot: WheeledRobot, generator: np.random.Generator) -> tuple[Array, Array]:
    q = np.append(robot.robot.random_configuration(generator), np.zeros(robot.nq - robot.robot.nq))
    S = robot.reduced(q, np.zeros(robot.nv)).S
    return q, S @ generator.normal(size=S.shape[-1])


@pytest.mark.parametrize("robot", [BODY, ARM])
def test_of_a_pushed_body_it_is_pinocchios(robot: MobileRobot) -> None:
    generator = np.random.default_rng(1)
    q = robot.random_configuration(generator, (3,))
    v, u = generator.normal(size=(2, 3, robot.nv))
    own, its = robot.array_dynamics.linearize_tracked(q, v, u), robot.linearize(q, v, u)
    for mine, other, same in zip(own, its, robot.linearize_tracked(q, v, u), strict=True):
        # Both are exact; a mass matrix with a condition number of some 1e4 amplifies rounding.
        assert np.abs(mine - other).max() < 1e-11 * np.abs(other).max()
        assert np.array_equal(other, same)


@pytest.mark.parametrize("name", ON_WHEELS)
def test_on_wheels_it_is_the_difference_quotient_of_pinocchios_constrained_tree(name: str) -> None:
    robot = ON_WHEELS[name]
    generator = np.random.default_rng(2)
    q, v = rolling(robot, generator)
    u, n = generator.normal(size=robot.nu), robot.robot.nv
    u = u * [100.0 if each.unit == "V" else 1.0 for each in robot.inputs]
    nu, h = robot.independent(q, v), 1e-5

    def rates(q: Array, nu: Array, u: Array) -> Array:
        """Return the rates of the tracked state, nu' as a difference along the motion."""
        v = robot.reduced(q, np.zeros(robot.nv)).S @ nu
        by_torque = getattr(robot, "wheeled", robot)
        a = by_torque.forward_dynamics(q, v, u if by_torque is robot else robot.torques_at(v, u))
        ends = [robot.independent(robot.integrate(q, s * v), v + s * a) for s in (-h, h)]
        return np.concatenate([v[:n], (ends[1] - ends[0]) / (2 * h)])

    def moved(k: int, step: float) -> Array:
        x = np.zeros(n + len(nu) + len(u))
        x[k] = step
        dq = np.append(x[:n], np.zeros(robot.nv - n))
        return rates(robot.integrate(q, dq), nu + x[n : n + len(nu)], u + x[n + len(nu) :])

    found = np.hstack(robot.linearize_tracked(q, v, u))
    step = 1e-4
    expected = [(moved(k, step) - moved(k, -step)) / (2 * step) for k in range(found.shape[-1])]
    # Two nested differences: h^2 and step^2 of slopes of order 10, and 1e-16 / (h step) of rounding.
    assert np.abs(found - np.transpose(expected)).max() < 2e-6 * np.abs(found).max()
