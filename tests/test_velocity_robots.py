"""Robots that take speeds for commands: their law, loops and adaptive control."""

from typing import Any

import numpy as np
import pytest
import sympy

import pinmobile as pm
from pinmobile import parts
from pinmobile.arrays import Array
from pinmobile.controllers import AdaptiveVelocity, Kanayama, RandomSteps, VelocityCommand
from pinmobile.identification import VELOCITY_ROBOTS
from pinmobile.parts import evolved
from pinmobile.plant import Context
from pinmobile.viewer import Viewer
from tests.parts import Eight
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


# -- adaptive control of robots that take speeds ---------------------------------------------------


TRUE = pm.VelocityRobot([0.26, 0.25, 0.03, 1.1, 0.2, 1.2])
WRONG = pm.VelocityRobot(TRUE.theta * [1.3, 0.7, 1.3, 0.7, 0.7, 1.3])


EIGHT = pm.Tangent(Eight(1.0, 60.0, 4 * np.pi))  # 1 m sin 0.5 t, 0.5 m sin t
OFF = np.array([0.15, -0.1, 0.3])


def wanted(run: pm.Rollout, controller: AdaptiveVelocity, ahead: float) -> Array:
    """Return what the kinematic law asks for, of a robot whose body is so far ahead of its axle."""
    a, off = float(controller.ahead or 0), float(controller.ahead or 0) - ahead
    psi, psi_r, w_r = run.q[:, 2], run.reference.q[:, 2], run.reference.v[:, 2:]
    point, point_r = (
        place + off * np.stack([np.cos(x), np.sin(x)], axis=-1)
        for place, x in ((run.q[:, :2], psi), (run.reference.q[:, :2], psi_r))
    )
    rate = run.reference.v[:, :2] + off * w_r * np.stack([-np.sin(psi_r), np.cos(psi_r)], axis=-1)
    rate = rate + controller.saturation * np.tanh(controller.kp * (point_r - point) / controller.saturation)
    c, s = np.cos(psi), np.sin(psi)
    return np.stack([c * rate[:, 0] + s * rate[:, 1], (c * rate[:, 1] - s * rate[:, 0]) / a], axis=-1)


@pytest.mark.parametrize(("ahead", "path"), [(0.0, EIGHT), (0.15, pm.FixedHeading(EIGHT.path, 0.3))])
def test_velocities_of_an_exact_model_fall_to_the_law_as_the_gain_says(ahead: float, path: Any) -> None:
    """Which they do only where the rates of the law's velocities are right."""
    robot, dt, k = pm.VelocityRobot(TRUE.theta, ahead), 1e-3, np.array([3.0, 5.0])
    controller = AdaptiveVelocity(robot, k=k, gamma=0.0)
    q0 = path(0.0).q + OFF
    given: Any = {"q0": q0, "v0": robot.rolling(q0, [-0.1, 0.3]), "engine": pm.Engine.COMPILED}
    run = pm.simulate(robot, controller, path, dt=dt, duration=1.5, **given)
    found = wanted(run, controller, ahead) - robot.independent(run.q, run.v)
    expected = found[0] * np.exp(-np.outer(run.t, k))
    assert np.abs(found[0]).min() > 0.1
    # Commands are held for dt: order 1, with velocities that change by some 10 of their own a second.
    assert np.abs(found - expected).max() < 10 * dt * np.abs(found[0]).max()


def test_the_sum_of_squares_falls_in_each_step() -> None:
    dt, controller = 2e-4, AdaptiveVelocity(WRONG)
    q0 = EIGHT(0.0).q + OFF
    v0 = TRUE.rolling(q0, [0.1, -0.5])
    run = pm.simulate(TRUE, controller, EIGHT, dt=dt, duration=1.0, q0=q0, v0=v0, engine=pm.Engine.COMPILED)
    e = wanted(run, controller, 0.0) - TRUE.independent(run.q, run.v)
    # A signal is told after its sample, when the estimate has been brought on.
    off = run.signals["theta"].values[:-1] - TRUE.theta
    total = (e**2 * TRUE.theta[:2])[1:].sum(axis=-1) / 2 + (off**2 / np.asarray(controller.gamma)).sum(-1) / 2
    assert total[0] - total[-1] > 0.1 * total[0]
    assert (np.diff(total) < 0).all()


def test_a_theta_that_is_wrong_by_30_percent_ends_with_less_error_than_without_adaptation() -> None:
    spread = {
        f"controller.theta.theta_{j + 1}": pm.Uniform(*sorted((0.7 * x, 1.3 * x)))
        for j, x in enumerate(TRUE.theta)
    }
    given: Any = {"n": 50, "spread": spread, "dt": 0.02, "seed": 3, "after": 40.0}
    with_, without = (
        pm.ensemble(TRUE, controller, EIGHT, **given)
        for controller in (AdaptiveVelocity(TRUE), AdaptiveVelocity(TRUE, gamma=0.0))
    )
    assert with_.engine == pm.Engine.COMPILED.name
    # A model that is nearly right needs no adaptation, and dt leaves some millimetres.
    assert np.median(with_.max_distance) < 0.1 * np.median(without.max_distance)
    assert with_.max_distance.max() < 0.05 < without.max_distance.max()


def test_what_limits_keep_commands_from_is_no_reason_to_estimate_more() -> None:
    controller = AdaptiveVelocity(TRUE)
    deaf = type("Deaf", (AdaptiveVelocity,), {"applied": None})(TRUE)  # which is not told of limits
    robot = pm.VelocityRobot(TRUE.theta, limits=(0.3, 2.0))
    straight = pm.Tangent(pm.Line((0, 0), (24, 0), 40))
    given: Any = {"dt": 0.02, "engine": pm.Engine.COMPILED, "duration": 20.0}
    within, beyond = (
        pm.simulate(robot, each, straight, **given).signals["theta"].values[-1] for each in (controller, deaf)
    )
    assert abs(beyond[3] - 1.1) > 1.0
    assert np.abs(within - TRUE.theta).max() < 0.02


def test_leakage_takes_estimates_back_to_the_first() -> None:
    controller = AdaptiveVelocity(WRONG, gamma=0.0, leakage=0.5)
    t: Any = np.arange(2) * 0.1
    state = controller.initial_state(Context.of(TRUE, dt=0.1, t=t, reference=EIGHT(t)))
    moved = (np.asarray(WRONG.theta) + 0.1, *state[1:])
    _, state = controller(0.0, EIGHT(0.0).q, EIGHT(0.0).v, EIGHT(0.0), moved)
    np.testing.assert_allclose(state[0] - WRONG.theta, 0.1 * (1 - 0.5 * 0.1), rtol=1e-12)


def test_estimates_stay_within_their_bounds() -> None:
    lower, upper = 0.95 * WRONG.theta, 1.05 * WRONG.theta
    controller = AdaptiveVelocity(WRONG, lower=lower, upper=upper)
    theta = pm.simulate(TRUE, controller, EIGHT, dt=0.02, engine=pm.Engine.COMPILED).signals["theta"].values
    assert (theta.min(axis=0) >= lower).all()
    assert (theta.max(axis=0) <= upper).all()
    assert (theta == lower).any()
    assert (theta == upper).any()


test_bad_arguments_are_refused = refusals(
    (lambda: AdaptiveVelocity(pm.MobileRobot.box()), "robot is .*, expected a VelocityRobot"),
    (
        lambda: AdaptiveVelocity(TRUE, upper=[1, 1, 1, 1, 1, 2]),
        "lower and upper exclude the robot's value, theta_4 = 1.1",
    ),
    (lambda: pm.simulate(TRUE, AdaptiveVelocity(TRUE, k=30), EIGHT, dt=0.1), r"k = \[30.0\].*expected dt <"),
    (
        lambda: pm.simulate(TRUE, AdaptiveVelocity(TRUE), pm.FixedHeading(EIGHT.path, 0.3), dt=0.02),
        "reference moves sideways",
    ),
)
