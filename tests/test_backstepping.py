"""Controllers of robots on wheels on the full dynamics: convergence, engines side by side, refusals."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.controllers import DynamicFeedback, Kanayama, Parking, SwerveTracking
from pinmobile.loop import Engine
from pinmobile.parts import evolved
from pinmobile.wheels import Coulomb, Motor, OdometryFeedback, Wheel, WheeledRobot, WheelTable
from tests.parts import Eight, Waving
from tests.refusals import begun, refusals, refused

OFF = np.array([-0.3, 0.3, 0.5])
BODY = pm.MobileRobot(30.0, 2.3, com=(0.05, 0.02, 0.2))
WHEEL: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
DIFFERENTIAL = WheeledRobot(BODY, WheelTable.differential(0.5, 0.1, **WHEEL))
SUPPORTED = WheelTable.differential(0.5, 0.1, supports=[(-0.2, 0.0)], **WHEEL)
CAR = WheeledRobot(BODY, WheelTable.car(0.35, 0.3, 0.1, **WHEEL))
MECANUM = WheeledRobot(BODY, WheelTable.mecanum(0.5, 0.4, 0.08, **WHEEL))
SWERVE = WheeledRobot(BODY, WheelTable.swerve([(0.3, 0.1), (-0.3, -0.1)], 0.06, **WHEEL))
EIGHT = pm.Tangent(Eight(1.0, 4 * np.pi))  # 1 m sin 0.5 t, 0.5 m sin t


def run(
    robot: WheeledRobot, controller: Any, trajectory: Any, duration: float, dt: float = 0.01, **more: Any
) -> pm.Rollout:
    q0, _ = robot.start(pm.Reference(*trajectory(0.0)))
    q0[:3] += more.pop("off", OFF)
    options: dict[str, Any] = {"integrator": pm.rk4, "engine": Engine.COMPILED} | more
    return pm.simulate(
        robot, controller, trajectory, dt=dt, duration=duration, q0=q0, v0=np.zeros(robot.nv), **options
    )


def distance(rollout: pm.Rollout) -> Any:
    return np.hypot(*(rollout.q[:, :2] - rollout.reference.q[:, :2]).T)


def test_an_eight_is_followed_on_the_full_dynamics() -> None:
    off = distance(run(DIFFERENTIAL, ON_TWO, EIGHT, 12.5, 0.001))
    assert off[0] == pytest.approx(np.hypot(0.3, 0.3))
    assert off[5000:].max() < 1e-3
    assert off[10000:].max() < 2e-5


def test_velocities_fall_to_the_law_as_the_gain_says() -> None:
    for k in (5.0, 20.0):
        run_ = run(DIFFERENTIAL, pm.Backstepping(pm.UnicycleTracking(), DIFFERENTIAL, k=k), EIGHT, 1.0, 0.001)
        c, s = np.cos(run_.q[:, 2]), np.sin(run_.q[:, 2])
        dx, dy = (run_.reference.q - run_.q[:, :3])[:, :2].T
        ahead, aside, turn = c * dx + s * dy, c * dy - s * dx, run_.reference.q[:, 2] - run_.q[:, 2]
        c_r, s_r = np.cos(run_.reference.q[:, 2]), np.sin(run_.reference.q[:, 2])
        speed, w = c_r * run_.reference.v[:, 0] + s_r * run_.reference.v[:, 1], run_.reference.v[:, 2]
        gain = 1.4 * np.sqrt(w**2 + 20 * speed**2)
        across = 20 * speed * np.sinc(turn / np.pi) * aside
        wanted = speed * np.cos(turn) + gain * ahead, w + across + gain * turn
        own = c * run_.v[:, 0] + s * run_.v[:, 1], run_.v[:, 2]
        for z, nu in zip(wanted, own, strict=True):
            left = (z - nu)[200] / (z - nu)[0]
            assert left == pytest.approx(np.exp(-0.2 * k), abs=0.01)


@pytest.mark.parametrize("law", [Kanayama(), DynamicFeedback()], ids=lambda law: type(law).__name__)
def test_other_laws_follow_too(law: Any) -> None:
    assert distance(run(DIFFERENTIAL, pm.Backstepping(law, DIFFERENTIAL), EIGHT, 12.0))[1000:].max() < 2e-3


def test_an_axle_that_is_not_at_the_origin_is_what_follows() -> None:
    table = WheelTable.differential(0.5, 0.1, x=0.2, **WHEEL)
    robot = WheeledRobot(BODY, table)

    @dataclass(frozen=True)
    class Circling:  # of the axle's middle, on a circle of 1 m
        duration: float = 10.0

        def __call__(self, t: Any) -> pm.Reference:
            psi = 0.5 * np.asarray(t)
            c, s, one = np.cos(psi), np.sin(psi), np.ones_like(psi)
            x, y = s - 0.2 * c, 1 - c - 0.2 * s
            return pm.Reference(
                np.stack([x, y, psi], -1),
                np.stack([0.5 * c + 0.1 * s, 0.5 * s - 0.1 * c, 0.5 * one], -1),
                np.stack([-0.25 * s + 0.05 * c, 0.25 * c + 0.05 * s, 0 * one], -1),
            )

    assert distance(run(robot, pm.Backstepping(pm.UnicycleTracking(), robot), Circling(), 10.0))[-1] < 1e-4
    with refused(r"reference moves sideways, at -0\.00075 m/s across the .*, at t = 0\.01 s"):
        run(robot, pm.Backstepping(pm.UnicycleTracking(), robot), EIGHT, 1.0)


def test_a_car_steers_and_follows() -> None:
    off = distance(run(CAR, OF_CAR, pm.Tangent(Eight(2.0, 8 * np.pi)), 20.0))
    assert off[1000:].max() < 2e-3
    assert off[1500:].max() < 1e-4


@dataclass(frozen=True)
class Crab:
    """A reference that goes ahead and sideways, and turns a little."""

    duration: float = 12.0

    def __call__(self, t: Any) -> pm.Reference:
        t = np.asarray(t)
        s, c, s4, c4 = np.sin(0.5 * t), np.cos(0.5 * t), np.sin(0.4 * t), np.cos(0.4 * t)
        return pm.Reference(
            np.stack([0.5 * t, 0.4 * s, 0.3 * s4], axis=-1),
            np.stack([0.5 + 0 * t, 0.2 * c, 0.12 * c4], axis=-1),
            np.stack([0 * t, -0.1 * s, -0.048 * s4], axis=-1),
        )


def test_two_modules_steer_and_drive_along_a_pose() -> None:
    found = run(SWERVE, SwerveTracking(SWERVE), Crab(), 12.0, off=OFF / 3)
    errors = np.abs(found.q[:, :3] - found.reference.q).max(axis=1)
    assert errors[1000:].max() < 3e-4
    assert errors[200] == pytest.approx(OFF[2] / 3 * np.exp(-4.0), rel=1.5)
    with refused(r"type \(2, 0\) with 2 inputs, expected two modules that steer"):
        SwerveTracking(DIFFERENTIAL)
    speeds = pm.VelocityRobot([0.3, 0.2, 0.01, 1.1, 0.02, 0.95])
    with refused("expected two modules that steer"):
        SwerveTracking(speeds)
    with refused("which has no inverse_dynamics"):
        pm.ADRC(speeds)


def test_a_robot_whose_wheels_slip_a_little_follows_by_the_model_of_one_that_rolls() -> None:
    robot = WheeledRobot(BODY, SUPPORTED, Coulomb())
    runs = []
    for model in (robot, WheeledRobot(BODY, SUPPORTED)):
        controller = pm.Backstepping(pm.UnicycleTracking(), model)
        runs.append(run(robot, controller, EIGHT, 8.0, off=OFF / 10, integrator=None))
    assert distance(runs[0])[300:].max() < 5e-3
    np.testing.assert_allclose(runs[0].u, runs[1].u, atol=1e-9)


def test_arms_follow_beside_the_body() -> None:
    robot = WheeledRobot(BODY.mount("ur5"), DIFFERENTIAL.table)
    rest = robot.robot.rest[3:]
    both = pm.WholeBody(robot.robot, EIGHT, pm.RestToRest(rest, rest + 0.3 * np.cos(np.arange(6)), 8.0))
    found = run(robot, pm.Backstepping(pm.UnicycleTracking(), robot), both, 8.0, 0.005)
    errors = np.abs(found.q[:, :9] - found.reference.q)
    assert errors[1400:].max() < 2e-4
    with refused("reference has 3 coordinates, expected 9: x, y, psi"):
        run(robot, pm.Backstepping(pm.UnicycleTracking(), robot), EIGHT, 1.0)


@pytest.mark.parametrize("pose", [(1.9, -1.3, 2.4), (-0.5, 0.9, -2.7)])
def test_parking_comes_to_rest_at_the_pose(pose: Any) -> None:
    place, law = pm.FixedHeading(pm.Hold(pose[:2], 30.0), pose[2]), pm.Backstepping(Parking(), DIFFERENTIAL)
    found = run(DIFFERENTIAL, law, place, 25.0, off=0 * OFF - pose)
    turned = (found.q[-1, 2] - pose[2] + np.pi) % (2 * np.pi) - np.pi
    assert distance(found)[-1] < 1.5e-3
    assert abs(turned) < 0.03
    assert np.abs(found.v[-1]).max() < 1e-9


def test_computed_torque_of_wheels_decays_as_its_gains_say() -> None:
    body = BODY.mount("ur5")
    robot = WheeledRobot(body, MECANUM.table)
    found = run(robot, pm.ComputedTorque(robot), Waving(body, 4.0), 4.0, 0.005)
    left = found.reference.q[-1, 0] - found.q[-1, 0]  # (1 + 2 t) e^(-2 t), and the start at rest
    v = found.reference.v[0, 0]
    assert left == pytest.approx((0.3 * (1 + 8) + v * 4) * np.exp(-8.0), abs=4e-4)


def test_a_wrench_is_allocated_and_what_wheels_cannot_give_is_told() -> None:
    controller = pm.ControlAllocation(pm.PD((60.0, 60.0, 20.0), (60.0, 60.0, 10.0)), DIFFERENTIAL)
    found = run(DIFFERENTIAL, controller, EIGHT, 10.0)
    left = found.signals["residual"].values
    along = np.cos(found.q[:, 2]) * left[:, 0] + np.sin(found.q[:, 2]) * left[:, 1]
    np.testing.assert_allclose(along, 0.0, atol=1e-12)  # the wheels give all of that
    np.testing.assert_allclose(left[:, 2], 0.0, atol=1e-12)
    assert np.abs(left[:, 1]).max() > 1.0
    assert 0.05 < distance(found)[500:].max() < 0.5  # what is missing


@pytest.mark.parametrize(
    "robot", [DIFFERENTIAL, CAR, MECANUM, SWERVE], ids=["differential", "car", "mecanum", "swerve"]
)
def test_allocated_torques_do_what_the_force_would(robot: WheeledRobot) -> None:
    rng = np.random.default_rng(3)
    q, tau = rng.normal(size=robot.nq), rng.normal(size=3)
    q[3 : 3 + len(robot.table.axes)] = rng.uniform(-0.5, 0.5, len(robot.table.axes))
    (u, left), (scaled, rest) = robot.allocate(q, tau), robot.allocate_scaled(q, tau)
    np.testing.assert_allclose(scaled, u, atol=1e-13)
    np.testing.assert_allclose(rest, left, atol=1e-12)
    v, f = np.zeros(robot.nv), np.append(tau, np.zeros(robot.nv - 3))
    by_force = robot.forward_dynamics(q, v, 0 * u, f)
    np.testing.assert_allclose(robot.forward_dynamics(q, v, u), by_force, atol=1e-12)
    traced = robot.array_dynamics.allocate_scaled(q, tau)
    np.testing.assert_allclose(traced[0], scaled, atol=1e-13)


def test_limits_hold_allocated_torques() -> None:
    motors = [evolved(wheel, motor=Motor(torque_limit=1.0)) for wheel in MECANUM.table.wheels]
    robot = WheeledRobot(BODY, WheelTable(tuple(motors)))
    q, tau = robot.rest, np.array([30.0, 40.0, 1.0])
    (u, left), (scaled, rest) = robot.allocate(q, tau), robot.allocate_scaled(q, tau)
    free = MECANUM.allocate(q, tau).u
    assert np.abs(u).max() == pytest.approx(1.0)
    np.testing.assert_allclose(scaled, free / np.abs(free).max())  # the force keeps its direction
    np.testing.assert_allclose(rest, tau * (1 - 1 / np.abs(free).max()), atol=1e-9)
    assert np.linalg.norm(left) > 0


def test_the_rate_of_independent_velocities_is_what_torques_are_for() -> None:
    rng, h = np.random.default_rng(4), 1e-6
    off_axle = WheeledRobot(BODY, WheelTable.differential(0.5, 0.1, x=0.2, **WHEEL))
    for robot in (DIFFERENTIAL, off_axle, CAR, MECANUM, SWERVE):
        q = rng.normal(size=robot.nq)
        q[3 : 3 + len(robot.table.axes)] = rng.uniform(-0.5, 0.5, len(robot.table.axes))
        v = robot.project(q, rng.normal(size=robot.nv))
        wanted = rng.normal(size=robot.independent(q, v).shape)
        u = robot.torques(q, v, wanted)
        np.testing.assert_allclose(robot.array_dynamics.torques(q, v, wanted), u, atol=1e-12)
        a = robot.forward_dynamics(q, v, u)
        ends = [robot.independent(robot.integrate(q, s * h * v), v + s * h * a) for s in (-1, 1)]
        np.testing.assert_allclose((ends[1] - ends[0]) / (2 * h), wanted, atol=1e-8)


def test_odometry_of_the_true_table_is_nearly_the_pose_and_a_smaller_wheel_drifts() -> None:
    law, still = pm.Backstepping(pm.UnicycleTracking(), DIFFERENTIAL), 0 * OFF
    table = DIFFERENTIAL.table
    smaller = evolved(table, wheels=(evolved(table.wheels[0], radius=0.099), table.wheels[1]))
    drifts = {}
    for name, controller in {
        "true": OdometryFeedback(law, table),
        "coarse": OdometryFeedback(law, table, ticks=2000),
        "noisy": OdometryFeedback(law, table, noise=0.1, seed=2),
        "smaller": OdometryFeedback(law, smaller),
    }.items():
        found = run(DIFFERENTIAL, controller, EIGHT, 10.0, off=still)
        believed = found.signals["believed_pose"].values
        np.testing.assert_allclose(believed[0], found.q[0, :3], atol=1e-12)
        drifts[name] = np.abs(believed - found.q[:, :3])[-1].max()
    assert drifts["true"] < 1e-4 < drifts["noisy"] < drifts["smaller"]
    assert drifts["coarse"] < 2e-3
    assert 0.02 < drifts["smaller"] < 0.5


ON_TWO, OF_CAR = (pm.Backstepping(pm.UnicycleTracking(), robot) for robot in (DIFFERENTIAL, CAR))


def test_a_reference_that_wheels_cannot_follow_is_refused_with_its_time() -> None:
    late = pm.FixedHeading(pm.Line((0.0, 0.0), (9.0, 3.0), 30.0), 0.0)
    for trajectory, message in (
        (pm.FixedHeading(EIGHT.path, 0.0), "reference moves sideways, at 0.5 m/s across the fixed axle"),
        (late, "reference moves sideways, at 0.1 m/s across the fixed axle, at t = 0 s"),
    ):
        for controller in (ON_TWO, pm.ControlAllocation(pm.PD(60, 60), DIFFERENTIAL)):
            with refused(message):
                run(DIFFERENTIAL, controller, trajectory, 2.0)
    aside = pm.FixedHeading(EIGHT.path, 0.0)  # no matter for a drive that moves in every direction
    assert len(run(MECANUM, pm.ControlAllocation(pm.PD(60, 60), MECANUM), aside, 0.1)) > 1
    tight = pm.Tangent(Eight(1.0, 4 * np.pi))
    with refused(r"needs a steering angle of 0\.\d+ rad at t = [\d.]+ s, expected at most 0\.698"):
        run(CAR, OF_CAR, tight, 4.0)


test_wrong_parts_are_refused_when_they_are_made = refusals(
    (lambda: pm.ComputedTorque(DIFFERENTIAL), "robot is a drive of type (2, 0), which cannot accelerate"),
    (lambda: pm.Backstepping(pm.UnicycleTracking(), MECANUM), "robot is a drive of type (3, 0)"),
    (lambda: pm.Backstepping(pm.PD(1, 1), DIFFERENTIAL), "law is PD("),
    (lambda: pm.Backstepping(pm.UnicycleTracking(), _one_motor()), "robot has 1 motors and 2"),
    by=begun,
)


def _one_motor() -> WheeledRobot:
    left = Wheel("left", 0.0, 0.25, 0.1, motor=Motor(), **WHEEL)
    return WheeledRobot(BODY, WheelTable((left, evolved(DIFFERENTIAL.table.wheels[1], motor=None))))


def test_a_controller_of_forces_on_the_body_is_told_what_turns_them_into_torques() -> None:
    robot = DIFFERENTIAL
    circle = pm.Tangent(pm.Circle(radius=2, rate=0.5, duration=1.0))
    with refused(r"torques: ControlAllocation\(controller, robot\) makes"):
        pm.simulate(robot, pm.PD(100, 120), circle, dt=0.01, integrator=pm.rk4)


def test_a_start_that_does_not_roll_may_be_one_at_rest() -> None:
    robot = DIFFERENTIAL
    with refused(r"left lateral slips at 1 m/s; .* v0 of zeros"):
        robot.check_start(robot.rest, [0.0, 1.0, 0.0, 0.0, 0.0])
