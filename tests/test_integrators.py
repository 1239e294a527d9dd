"""Order of every integrator on the plant, and what each is exact for."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from pinmobile import (
    MobileRobot,
    Reference,
    constant_acceleration,
    law,
    rk4,
    semi_implicit_euler,
    simulate,
)
from pinmobile.arrays import Array

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


def tumbling(joint: Any) -> MobileRobot:
    """Return two bricks that ride on the box by a hinge and the joint, both off their centres of mass."""
    model = pin.Model()
    brick = pin.Inertia(2.0, np.array([0.1, -0.05, 0.2]), np.diag([0.02, 0.04, 0.05]))
    hinge = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    last = model.addJoint(hinge, joint, pin.SE3.Identity(), "joint")
    for moved in (hinge, last):
        model.appendBodyToJoint(moved, brick, pin.SE3.Identity())
    return MobileRobot.box().mount(model, name="toy")


class Still:
    """A reference that nothing follows."""

    duration = 1.0

    def __init__(self, robot: MobileRobot) -> None:
        self.robot = robot

    def __call__(self, t: Any) -> Reference:
        v, a = np.zeros((2, *np.shape(t), self.robot.nv))
        return Reference(np.broadcast_to(self.robot.neutral, (*np.shape(t), self.robot.nq)), v, a)


@pytest.mark.parametrize(
    "joint",
    [pin.JointModelSpherical(), pin.JointModelFreeFlyer(), pin.JointModelPlanar()],
    ids=["ball", "free flyer", "planar"],
)
@pytest.mark.parametrize(
    ("integrator", "order", "least"),
    [(constant_acceleration, 1, 64), (semi_implicit_euler, 1, 64), (rk4, 4, 64)],
)
def test_order_between_configurations_that_turn(joint: Any, integrator: Any, order: int, least: int) -> None:
    robot = tumbling(joint)
    v0 = np.concatenate([[0.3, -0.2, 0.5], np.linspace(2.0, -1.5, robot.nv - 3)])
    force = np.concatenate([[3.0, -2.0, 1.5], np.linspace(-0.2, 0.3, robot.nv - 3)])
    held = law(lambda t, q, v, reference: force)

    def ends(integrator: Any, substeps: int) -> tuple[Array, Array]:
        run = simulate(
            robot, held, Still(robot), dt=1.0, v0=v0, integrator=integrator, substeps=substeps, limit=1e6
        )
        return run.q[-1], run.v[-1]

    q, v = ends(rk4, 1024)
    counts = least * np.array([1, 2, 4])
    errors = []
    for n in counts:
        found, rate = ends(integrator, int(n))
        errors.append(np.linalg.norm(np.concatenate([robot.difference(q, found), rate - v])))
    slope = np.polyfit(np.log(1 / counts), np.log(errors), 1)[0]
    # As above; without the inverse of dexp, rk4 is of order 2 here.
    assert slope == pytest.approx(order, abs=0.15)


def test_a_step_of_one_stage_turns_with_the_velocity_that_it_holds() -> None:
    robot = tumbling(pin.JointModelSpherical())
    v, a = np.random.default_rng(2).normal(size=(2, robot.nv))
    held = law(lambda t, q, v, reference: robot.inverse_dynamics(q, v, a))
    run = simulate(robot, held, Still(robot), dt=0.05, v0=v, duration=0.05)
    np.testing.assert_allclose(run.v[1], v + 0.05 * a, rtol=1e-9)
    end = robot.integrate(robot.neutral, 0.05 * v + 0.05**2 / 2 * a)
    np.testing.assert_allclose(run.q[1], end, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kinova", [False, True])
def test_the_jacobian_of_integrate_is_its_slope(kinova: bool) -> None:
    robot = MobileRobot.box().mount("kinova") if kinova else tumbling(pin.JointModelFreeFlyer())
    rng, h = np.random.default_rng(4), 1e-6
    q = robot.random_configuration(rng, (3,))
    dq, r = rng.normal(size=(2, 3, robot.nv))
    ends = [robot.integrate(q, dq + s * h * r) for s in (-1, 1)]
    slope = robot.difference(*ends) / (2 * h)
    J = robot.integrate_jacobian(q, dq)
    # h^2 of a third derivative of order one, and rounding over h.
    np.testing.assert_allclose(np.einsum("nij,nj->ni", J, r), slope, rtol=0, atol=1e-8)
    off = np.abs(J - np.eye(robot.nv)).max()
    assert off == 0 if kinova else off > 0.1


@pytest.mark.parametrize("integrator", [constant_acceleration, rk4])
def test_a_constant_acceleration_is_integrated_exactly(integrator: Any) -> None:
    a = np.array([1.0, -2.0, 3.0])
    q, v = integrator(lambda t, q, v: a, 0.0, Q0, V0, 0.7)
    np.testing.assert_allclose(q, Q0 + 0.7 * V0 + 0.245 * a, rtol=1e-15)
    np.testing.assert_allclose(v, V0 + 0.7 * a, rtol=1e-15)


def test_semi_implicit_euler_moves_with_the_new_velocity() -> None:
    q, v = semi_implicit_euler(lambda t, q, v: np.ones(3), 0.0, Q0, V0, 0.1)
    np.testing.assert_allclose(q, Q0 + 0.1 * v, rtol=1e-15)


def test_rk4_asks_at_the_times_of_its_stages() -> None:
    asked: list[float] = []

    def record(t: float, q: Array, v: Array) -> Array:
        asked.append(t)
        return np.zeros(3)

    rk4(record, 1.0, Q0, V0, 0.2)
    assert asked == pytest.approx([1.0, 1.1, 1.1, 1.2])


@pytest.mark.parametrize("integrator", [constant_acceleration, semi_implicit_euler, rk4])
def test_many_states_are_stepped_at_once(integrator: Any) -> None:
    q, v = np.random.default_rng(0).normal(size=(2, 5, 3))
    many = integrator(acceleration, 0.0, q, v, 0.1)
    for k in range(5):
        one = integrator(acceleration, 0.0, q[k], v[k], 0.1)
        np.testing.assert_allclose([many[0][k], many[1][k]], one, rtol=1e-14)
