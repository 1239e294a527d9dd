"""Robots that take speeds for commands: their law, what it follows from, and loops around them."""

from typing import Any

import numpy as np
import pytest
import sympy

import pinmobile as pm
from pinmobile import parts
from pinmobile.controllers import Kanayama, RandomSteps, VelocityCommand
from pinmobile.identification import VELOCITY_ROBOTS
from pinmobile.parts import evolved
from pinmobile.viewer import Viewer
from tests.refusals import refusals

THETA = (0.26, 0.25, 0.03, 1.1, 0.2, 1.2)
MOTOR = pm.Motor(
    resistance=1.2, torque_constant=0.03, voltage=1e3, gear=20.0, rotor_inertia=1e-5, viscous=2e-5
)
KP = 0.8  # V s/rad


def on_wheels(x: float = 0.0, motor: pm.Motor = MOTOR, com: Any = (0.06, 0.0, 0.2)) -> pm.WheeledRobot:
    wheel: Any = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
    supports = [(-0.25, 0.0), (0.25, 0.0)]
    table = pm.WheelTable.differential(0.5, 0.1, x=x, motor=motor, supports=supports, **wheel)
    return pm.WheeledRobot(pm.MobileRobot(30.0, 2.3, com=com), table)


def test_the_acceleration_is_the_derivative_of_the_velocity() -> None:
    """The law, once more by sympy: d/dt of the kinematics with u' and w' in place."""
    u, w, psi, a, uc, wc, t1, t2, t3, t4, t5, t6 = names = sympy.symbols("u w psi a uc wc t1 t2 t3 t4 t5 t6")
    faster = (t3 * w**2 - t4 * u + uc) / t1
    turning = (-t5 * u * w - t6 * w + wc) / t2
    place = sympy.Matrix(
        [u * sympy.cos(psi) - a * w * sympy.sin(psi), u * sympy.sin(psi) + a * w * sympy.cos(psi), w]
    )
    rate = place.diff(u) * faster + place.diff(w) * turning + place.diff(psi) * w
    expected = sympy.lambdify(names, list(rate))
    robot, rng = pm.VelocityRobot(THETA, ahead=0.15), np.random.default_rng(1)
    for _ in range(20):
        q, nu, command = rng.normal(size=3), rng.normal(size=2), rng.normal(size=2)
        found = robot.forward_dynamics(q, robot.rolling(q, nu), command)
        np.testing.assert_allclose(found, expected(*nu, q[2], 0.15, *command, *THETA), rtol=0, atol=1e-12)


def test_commands_are_the_inverse_and_linear_in_theta() -> None:
    robot, rng = pm.VelocityRobot(THETA, ahead=0.1), np.random.default_rng(2)
    q, nu, rates = rng.normal(size=(50, 3)), rng.normal(size=(50, 2)), rng.normal(size=(50, 2))
    v = robot.rolling(q, nu)
    u = robot.commands(q, v, rates)
    np.testing.assert_allclose(robot.rates(nu, u), rates, rtol=0, atol=1e-10)
    np.testing.assert_allclose(robot.regressor(q, v, rates) @ robot.theta, u, rtol=0, atol=1e-12)
    own = robot.reduced(q, v)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", own.M, rates) + own.n, u, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", own.S, own.nu), v, rtol=0, atol=1e-12)
    np.testing.assert_allclose(robot.independent(q, v), nu, rtol=0, atol=1e-12)


def test_accelerations_and_commands_are_limited() -> None:
    robot = pm.VelocityRobot(THETA, limits=(0.5, 0.4), accelerations=(0.8, 1.5))
    steps = RandomSteps((-2.0, -2.0), (2.0, 2.0), (0.5, 1.0))
    run = pm.simulate(robot, steps, pm.FixedHeading(pm.Hold((0, 0), 10.0), 0.0), dt=0.02)
    assert np.abs(run.u).max(axis=0) == pytest.approx([0.5, 0.4])
    rates = np.diff(robot.independent(run.q, run.v), axis=0) / 0.02
    # Within a step rk4 leaves the circle on which the body turns by (w h)^5 / 120.
    assert np.abs(rates).max(axis=0) == pytest.approx([0.8, 1.5], rel=1e-7)
    found = parts.find(robot, "accelerations.yaw_acceleration")
    assert (found.path, found.unit) == ("accelerations.yaw_acceleration", "rad/s^2")


@pytest.mark.parametrize(("x", "kd", "efficiency"), [(0.0, 0.0, 1.0), (-0.1, 0.02, 0.7)])
def test_theta_of_motors_is_the_reduced_dynamics(x: float, kd: float, efficiency: float) -> None:
    """M nu' + n = B torques, by Pinocchio's tree, with the motors' and the firmware's law solved for nu'."""
    motor = evolved(MOTOR, efficiency=efficiency)
    wheeled = on_wheels(x, motor)
    robot = pm.VelocityRobot.from_motors(wheeled.by_voltage() if x else wheeled, KP, kd)
    rng, G, R = np.random.default_rng(3), motor.gear, float(motor.resistance or 0)
    K, B = G * float(motor.torque_constant or 0), efficiency * G * G * motor.viscous
    T = wheeled.wheel_rates(np.array([[1, 0, 0], [0, -x, 1]])).T
    for _ in range(5):
        q = np.append(rng.normal(size=3), [0, 0])
        v, u = wheeled.project(q, rng.normal(size=5)), rng.normal(size=2)
        own = wheeled.reduced(q, v)
        np.testing.assert_allclose(robot.independent(q[:3], v[:3]), own.nu, rtol=0, atol=1e-12)
        share = efficiency * K / R
        left = own.M + own.B @ (share * kd * T)
        volts = KP * T @ (u - own.nu) - K * T @ own.nu
        right = own.B @ (share * volts - B * T @ own.nu) - own.n
        expected = np.linalg.solve(left, right)
        np.testing.assert_allclose(robot.rates(own.nu, u), expected, rtol=0, atol=1e-10)


test_what_is_no_robot_is_refused = refusals(
    (
        lambda: pm.VelocityRobot.from_motors(on_wheels(motor=pm.Motor(torque_limit=3.0)), 1.0),
        "other wheels or motors",
    ),
    (lambda: pm.LQR(pm.VelocityRobot(THETA)), "use Backstepping, VelocityCommand or"),
    (lambda: pm.MPC(pm.VelocityRobot(THETA)), "use Backstepping, VelocityCommand or"),
    (lambda: pm.ComputedTorque(pm.VelocityRobot(THETA)), "use Backstepping, VelocityCommand or"),
    (lambda: pm.VelocityRobot.from_motors(on_wheels().mount("ur5"), 1.0), "wheeled has arms"),
    (lambda: VelocityCommand(pm.UnicycleTracking(), pm.MobileRobot.box()), "expected a VelocityRobot"),
)


def test_no_force_pushes_it_and_it_starts_rolling() -> None:
    robot = pm.VelocityRobot(THETA)
    command, circle = VelocityCommand(pm.UnicycleTracking(), robot), pm.Tangent(pm.Circle(1.0, 0.5, 1.0))
    with pytest.raises(pm.InvalidArgument, match=r"VelocityRobot\(.*\), which has no generalized_force"):
        pm.simulate(robot, command, circle, dt=0.1, forces=[pm.ConstantForce((1.0, 0.0, 0.0))])
    with pytest.raises(pm.InvalidArgument, match="theta does not describe how firmware responds to a force"):
        robot.forward_dynamics(np.zeros(3), np.zeros(3), np.zeros(2), [1.0, 0.0, 0.0])
    with pytest.raises(pm.InvalidArgument, match=r"wheels that slide sideways at 0\.3 m/s"):
        pm.simulate(robot, command, circle, dt=0.1, q0=np.zeros(3), v0=[0.5, 0.3, 0.0])


def test_backstepping_knows_how_late_the_firmware_is() -> None:
    law = Kanayama()
    robot, circle = VELOCITY_ROBOTS["robulab_10"], pm.Tangent(pm.Circle(1.0, 0.5, 10.0))
    plain, knowing = (
        pm.simulate(robot, controller, circle, dt=0.02, engine=pm.Engine.COMPILED).max_error()[:2].max()
        for controller in (VelocityCommand(law, robot), pm.Backstepping(law, robot))
    )
    assert plain > 0.1
    assert knowing < 1e-6


def test_random_steps_are_independent_and_within_their_bounds() -> None:
    robot, still = pm.VelocityRobot(THETA), pm.FixedHeading(pm.Hold((0, 0), 200.0), 0.0)
    run, again, other = (
        pm.simulate(robot, RandomSteps(seed=seed), still, dt=0.1, engine=pm.Engine.COMPILED)
        for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(run.u, again.u)
    assert np.abs(run.u - other.u).max() > 0.5
    assert (run.u >= [-0.2, -1.3]).all()
    assert (run.u <= [0.8, 1.3]).all()
    for column in run.u.T:
        jumps = np.flatnonzero(np.diff(column)) + 1
        held = np.diff(jumps) * 0.1
        assert held.min() > 0.35
        assert held.max() < 2.55
        # 200 s of holds of 1.45 s in the mean with a deviation of 0.61 s: 138 of them, give or take 5.
        assert 110 < len(jumps) < 170


def test_published_robots_say_where_they_come_from_and_what_they_break() -> None:
    assert len(VELOCITY_ROBOTS) == 10
    for name, robot in VELOCITY_ROBOTS.items():
        assert "Martins" in robot.source or "LIMO" in robot.source
        assert all(each in robot.source for each in robot.problems)
        _, _, three, four, five, six = robot.theta
        assert bool(robot.problems) == (four < 1 or six < 1 or three * five < 0) == (name != "robulab_10")


def test_the_viewer_draws_it_on_its_axle() -> None:
    robot = pm.VelocityRobot(THETA, ahead=0.12)
    names = [item.name for item in robot.visual_model.geometryObjects]
    assert {"left/tyre", "right/tyre"} <= set(names)
    placed = robot.drawing([1.0, 2.0, np.pi / 2])
    tyre = placed[names.index("left/tyre"), :3, 3]
    np.testing.assert_allclose(tyre[:2], [1.0 - 0.5 * 0.38, 2.0 - 0.12], rtol=0, atol=1e-12)
    run = pm.simulate(robot, RandomSteps(), pm.FixedHeading(pm.Hold((0, 0), 2.0), 0.0), dt=0.1)
    with Viewer(robot) as viewer:
        viewer.display(run.q[-1])
        assert viewer.record(run).tracks
