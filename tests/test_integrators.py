"""Order of every integrator on the plant, and what each is exact for."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pinmobile import MobileRobot, rk4
from pinmobile.arrays import Array
from pinmobile.integrators import constant_acceleration, semi_implicit_euler

ROBOT = MobileRobot(10, 1.2, com=(0.15, 0.05))
TAU = np.array([3.0, -2.0, 1.5])
Q0, V0, END = np.array([0.2, -0.1, 0.4]), np.array([0.5, 0.3, 1.0]), 2.0


def acceleration(t: float, q: Array, v: Array) -> Array:
    return ROBOT.forward_dynamics(q, v, TAU)


def travelled(integrator: Any, steps: int) -> Array:
    q, v = Q0, V0
    for k in range(steps):
        q, v = integrator(acceleration, k * END / steps, q, v, END / steps)
    return np.concatenate([q, v])


@pytest.fixture(scope="module")
def exact() -> Array:
    """Return the state at the end under one held force, by an 8th-order method of scipy's."""
    solution = solve_ivp(
        lambda t, x: np.concatenate([x[3:], acceleration(t, x[:3], x[3:])]),
        (0, END),
        np.concatenate([Q0, V0]),
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
    )
    return np.asarray(solution.y[:, -1])


@pytest.mark.parametrize(
    ("integrator", "order", "steps"),
    [(constant_acceleration, 1, 400), (semi_implicit_euler, 1, 400), (rk4, 4, 25)],
)
def test_order_under_a_held_force(integrator: Any, order: int, steps: int, exact: Array) -> None:
    counts = np.array([steps, 2 * steps, 4 * steps])
    errors = [np.linalg.norm(travelled(integrator, int(n)) - exact) for n in counts]
    slope = np.polyfit(np.log(1 / counts), np.log(errors), 1)[0]
    # The next term of the error is one order higher: at these steps a few per cent of the first.
    assert slope == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("integrator", [constant_acceleration, rk4])
def test_a_constant_acceleration_is_integrated_exactly(integrator: Any) -> None:
    a = np.array([1.0, -2.0, 3.0])
    q, v = integrator(lambda t, q, v: a, 0.0, Q0, V0, 0.7)
    np.testing.assert_allclose(q, Q0 + 0.7 * V0 + 0.245 * a, rtol=1e-15)
    np.testing.assert_allclose(v, V0 + 0.7 * a, rtol=1e-15)


def test_semi_implicit_euler_moves_with_the_new_velocity() -> None:
    q, v = semi_implicit_euler(lambda t, q, v: np.ones(3), 0.0, Q0, V0, 0.1)
    np.testing.assert_allclose(q, Q0 + 0.1 * v, rtol=1e-15)
