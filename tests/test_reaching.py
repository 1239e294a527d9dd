"""Base and arm together follow a pose: how near, within which limits, and what happens where they cannot."""

import pickle
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.errors import LimitWarning, Unreachable
from pinmobile.reaching import InverseKinematicsTrajectory, pose_error

BOX = pm.MobileRobot.box()
UR5 = BOX.mount("ur5", (0.1, -0.05, 0.2, 0.4))
PANDA = BOX.mount("panda", (0.1, 0.0, 0.2, 0.0))
KINOVA = BOX.mount("kinova", (0.1, 0.0, 0.2, 0.0))  # four of its joints are continuous
BENT = np.array([0, 0, 0, 0, -1.2, 1.6, -0.4, 1.57, 0])
START = UR5.frame_pose(BENT)
TURN = pin.utils.rotate("z", 0.8) @ pin.utils.rotate("x", 0.5)
LOCKED = np.where(np.arange(9) < 3, 0.0, UR5.velocity_limit)


@dataclass(frozen=True)
class Ring:
    """A circle in a plane that is tilted in space, from a point on."""

    begin: Any
    radius: float = 0.5
    rate: float = 1.0
    duration: float = 2 * np.pi

    def __call__(self, t: Any) -> Array:
        return self.derivative(t, 0)

    def derivative(self, t: Any, order: int) -> Array:
        angle = self.rate * np.asarray(t) + order * np.pi / 2
        wave = self.radius * self.rate**order * np.stack([np.sin(angle), np.cos(angle)], -1)
        plane = np.array([[1, 0, 0.2], [0, -1, 0]])  # directions of the two waves
        ahead = np.add(self.begin, (0, self.radius, 0)) if order == 0 else 0
        return np.asarray(wave @ plane + ahead)


RING = pm.PosePath(Ring(START[:3, 3]), START[:3, :3], START[:3, :3] @ TURN)
ACCELERATION = 0.5 * np.hypot(1, 0.2)  # its largest [m/s^2]


def line(begin: Any, way: Any, duration: float = 3.0) -> pm.Spline:
    """Return a line in space from rest to rest."""
    return pm.Spline([begin, np.add(begin, way)], [0, duration])


def misses(robot: pm.MobileRobot, target: pm.PosePath, t: Array, q: Array) -> tuple[float, float]:
    way, turn = np.split(pose_error(target(t).pose, robot.frame_pose(q)), 2, axis=1)
    return float(np.linalg.norm(way, axis=1).max()), float(np.linalg.norm(turn, axis=1).max())


def dense(resolved: InverseKinematicsTrajectory) -> tuple[Array, pm.Reference]:
    t = np.linspace(0, resolved.duration, 5001)
    return t, resolved(t)


def check_limits(resolved: InverseKinematicsTrajectory, velocity: Array, acceleration: float = 10.0) -> None:
    robot, (_, reference) = resolved.robot, dense(resolved)
    assert (reference.q >= robot.lower).all()
    assert (reference.q <= robot.upper).all()
    assert (np.abs(reference.v) <= velocity * (1 + 1e-9) + 1e-12).all()
    assert np.abs(reference.a).max() <= acceleration * (1 + 1e-6)


@pytest.fixture(scope="module")
def ring() -> InverseKinematicsTrajectory:
    return pm.solve_inverse_kinematics(UR5, RING, q0=BENT)


def test_base_and_arm_together_stay_on_a_ring_in_space(ring: InverseKinematicsTrajectory) -> None:
    t, reference = dense(ring)
    way, turn = misses(UR5, RING, t, reference.q)
    # The spline smooths the control points by a dt^2 / 6: 8.5e-6 m; between them half as much again.
    assert way < 1.5 * ACCELERATION * 0.01**2 / 6
    assert turn < 1e-5
    travelled = np.ptp(reference.q, axis=0)
    assert (travelled[:2] > 0.3).all()
    assert (travelled[3:] > 0.05).sum() >= 4
    check_limits(ring, UR5.velocity_limit)
    # It does no more than it must: coordinates accelerate as the ring does, without jerks.
    assert np.abs(reference.a).max() < 2


def test_velocity_and_acceleration_are_derivatives(ring: InverseKinematicsTrajectory) -> None:
    t = np.linspace(0.1, 6, 50) + 1e-5  # beside the knots, where jerk jumps
    h = 1e-4
    ahead, here, behind = (ring(t + k * h) for k in (1, 0, -1))
    # Cubics: a difference of third order in h is all there is; jerks are below 5.
    np.testing.assert_allclose((ahead.q - behind.q) / (2 * h), here.v, atol=5 * h**2)
    np.testing.assert_allclose((ahead.v - behind.v) / (2 * h), here.a, atol=5 * h)


def test_the_error_is_of_second_order_in_the_step(ring: InverseKinematicsTrajectory) -> None:
    coarse = pm.solve_inverse_kinematics(UR5, RING, q0=BENT, dt=0.02)
    assert coarse.max_error()[0] / ring.max_error()[0] == pytest.approx(4, rel=0.05)


def test_the_position_alone_leaves_the_orientation_free() -> None:
    target = pm.PosePath(RING.path)
    resolved = pm.solve_inverse_kinematics(UR5, target, q0=BENT)
    assert resolved.max_error()[0] < 1e-4
    assert np.isnan(resolved.max_error()[1])
    assert misses(UR5, RING, *(part for part in (resolved.t, resolved(resolved.t).q)))[1] > 0.1


@pytest.mark.parametrize("robot", [PANDA, KINOVA, BOX], ids=["panda", "kinova", "bare"])
def test_other_robots_follow_a_line_from_rest(robot: pm.MobileRobot) -> None:
    T = robot.frame_pose(robot.rest)
    target = pm.PosePath(line(T[:3, 3], (1.5, -1, 0)), T[:3, :3])
    resolved = pm.solve_inverse_kinematics(robot, target)
    assert resolved.max_error()[0] < 1e-4
    check_limits(resolved, robot.velocity_limit)


def test_the_start_is_found_far_away_and_turned() -> None:
    R = START[:3, :3] @ pin.utils.rotate("x", 2.0)
    resolved = pm.solve_inverse_kinematics(UR5, pm.PosePath(line((300.0, -500.0, 0.6), (0.1, 0, 0)), R))
    assert max(resolved.max_error()) < 1e-4


def test_an_arm_that_is_not_the_first_follows_too() -> None:
    robot = UR5.mount("panda", (-0.1, 0, 0.2, 3)).attach(pm.PayloadBody(1.0), "ur5/tool0")
    frame = robot.mounts[1].tip
    T = robot.frame_pose(robot.rest, frame)
    resolved = pm.solve_inverse_kinematics(
        robot, pm.PosePath(line(T[:3, 3], (0.3, 0.2, 0.1)), T[:3, :3]), frame=frame
    )
    assert resolved.max_error()[0] < 1e-4
    np.testing.assert_allclose(np.ptp(resolved(resolved.t).q[:, robot.mounts[0].q], axis=0), 0, atol=1e-9)


def test_what_the_arm_cannot_reach_is_reached_because_the_base_moves() -> None:
    far = pm.PosePath(line(START[:3, 3], (2, 0, 0)), START[:3, :3])
    assert pm.solve_inverse_kinematics(UR5, far, q0=BENT).max_error()[0] < 1e-4
    with pytest.raises(Unreachable, match=r"target is missed by .* m and .* rad at t = 0\.\d+ s") as caught:
        pm.solve_inverse_kinematics(UR5, far, q0=BENT, velocity_limit=LOCKED)
    kept = caught.value.resolved
    assert np.nanmax(kept.error[kept.t < caught.value.time]) <= 1e-2
    assert kept.max_error()[0] > 1
    check_limits(kept, LOCKED)
    copy = pickle.loads(pickle.dumps(Unreachable("far", time=1.0, resolved=None)))
    assert (str(copy), copy.time) == ("far", 1.0)


@pytest.mark.parametrize("turns", [False, True])
def test_a_tolerance_is_of_distance_and_angle_whatever_the_direction(turns: bool) -> None:
    locked, ahead = np.zeros(9), 0.014 * np.array([np.cos(0.5), np.sin(0.5), 0])
    if turns:
        axis = pin.exp3(ahead)
        missed = pm.PosePath(line(START[:3, 3], (0, 0, 0)), START[:3, :3], axis @ START[:3, :3])
    else:
        missed = pm.PosePath(line(START[:3, 3], ahead))
    resolved = pm.solve_inverse_kinematics(
        UR5, missed, q0=BENT, dt=0.05, velocity_limit=locked, tolerance=0.0141
    )
    assert max(resolved.max_error()) == pytest.approx(0.014, rel=1e-9)
    with pytest.raises(Unreachable, match=r"largest errors are .*0\.014"):
        pm.solve_inverse_kinematics(UR5, missed, q0=BENT, dt=0.05, velocity_limit=locked, tolerance=0.0139)


def test_a_limit_of_velocity_is_held_and_the_error_made_good_later() -> None:
    target = pm.PosePath(
        pm.Spline([START[:3, 3], START[:3, 3] + [1, 0, 0], START[:3, 3] + [1, 0, 0]], [0, 1, 5])
    )
    slow = np.where(np.arange(9) < 3, 0.5, 0.1)
    resolved = pm.solve_inverse_kinematics(UR5, target, q0=BENT, velocity_limit=slow, tolerance=np.inf)
    check_limits(resolved, slow)
    assert resolved.max_error()[0] > 0.1
    assert np.abs(resolved.error[-1, : resolved.target.rows]).max() < 1e-4
    assert resolved.error[:, 0].min() > -1e-3  # it comes from behind and does not shoot beyond


def test_torques_beyond_limits_are_reported_when_and_how_far() -> None:
    heavy, up = UR5.attach(pm.PayloadBody(40.0), "ur5/tool0"), np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, 0.2]])
    with pytest.warns(LimitWarning, match=r"^input of ur5/shoulder_lift_joint reaches -?[\d.]+ N m") as told:
        found = pm.solve_inverse_kinematics(
            heavy, pm.PosePath(pm.Spline(START[:3, 3] + up, [0.0, 0.5, 1.0])), q0=BENT, dt=0.1
        )
    way = found(found.t)
    assert len(told) == 1
    size = np.abs(heavy.inverse_dynamics(*way)).max(axis=0) > heavy.effort_limit
    named = [one.name for one, beyond in zip(heavy.inputs, size, strict=True) if beyond]
    assert [one.split()[2] for one in str(told[0].message).split("; ")] == named


def test_where_the_search_from_rest_is_stuck_others_are_tried_unless_a_start_is_given() -> None:
    q = PANDA.random_configuration(np.random.default_rng(1))
    q[:3] = 0
    T, locked = PANDA.frame_pose(q), np.where(np.arange(12) < 3, 0.0, PANDA.velocity_limit)
    target = pm.PosePath(line(T[:3, 3], (0, 0, 0), 0.1), T[:3, :3])
    assert max(pm.solve_inverse_kinematics(PANDA, target, velocity_limit=locked).max_error()) < 1e-9
    with pytest.raises(Unreachable, match="at t = 0 s"):
        pm.solve_inverse_kinematics(PANDA, target, velocity_limit=locked, q0=PANDA.rest)


def test_a_joint_brakes_at_its_limit_and_the_error_grows() -> None:
    T = PANDA.frame_pose(PANDA.rest)
    locked = np.where(np.arange(12) < 3, 0.0, PANDA.velocity_limit)
    away = pm.PosePath(line(T[:3, 3], (-0.6, 0, -0.3)), T[:3, :3])
    resolved = pm.solve_inverse_kinematics(PANDA, away, velocity_limit=locked, tolerance=np.inf)
    check_limits(resolved, locked)
    q = resolved(resolved.t).q
    assert np.minimum(q - PANDA.lower, PANDA.upper - q)[:, 3:-2].min() < 1e-3
    assert resolved.max_error()[0] > 0.05


def test_a_singular_posture_does_not_blow_up() -> None:
    straight = UR5.rest  # the arm stretched, a wrist's axis lost
    assert UR5.arm_manipulability(straight) < 1e-9
    T = UR5.frame_pose(straight)
    out = [T[:3, 3], T[:3, 3] + 0.3 * T[:3, 3] / np.linalg.norm(T[:3, 3]), T[:3, 3] - [0.2, 0.1, 0]]
    target = pm.PosePath(pm.Spline(out, [0, 2, 6]))
    resolved = pm.solve_inverse_kinematics(UR5, target, q0=straight, velocity_limit=LOCKED, tolerance=np.inf)
    check_limits(resolved, LOCKED)
    assert 0.1 < resolved.max_error()[0] < 0.5
    assert np.abs(resolved.error[-1, : resolved.target.rows]).max() < 1e-3


def test_where_the_pose_leaves_it_free_the_arm_tends_to_its_posture() -> None:
    target = pm.PosePath(line(START[:3, 3], (0, 0, 0), 8))
    posture = BENT[3:] + np.array([0.3, 0, 0, 0, 0, 0.5])  # the height stays
    resolved = pm.solve_inverse_kinematics(UR5, target, q0=BENT, posture=posture)
    np.testing.assert_allclose(resolved(8.0).q[3:], posture, atol=2e-3)  # exp(-6) of 0.5: the base moves too
    assert resolved.max_error()[0] < 1e-4
    stiff = pm.solve_inverse_kinematics(UR5, target, q0=BENT, posture=posture, posture_gain=0)
    assert np.abs(stiff(8.0).q[3:] - BENT[3:]).max() < 0.05


def test_what_is_dear_moves_less() -> None:
    target = pm.PosePath(line(START[:3, 3], (0.2, 0.1, 0.1)), START[:3, :3])
    price = np.where(np.arange(9) < 3, 100.0, 1.0)
    moved = [
        np.abs(pm.solve_inverse_kinematics(UR5, target, q0=BENT, cost=cost)(3.0).q[:3]).max()
        for cost in (1.0, price)
    ]
    assert moved[1] < 0.1 * moved[0]


# Tracking


def test_tracking_asks_for_the_references_own_acceleration(ring: InverseKinematicsTrajectory) -> None:
    t = 4.0
    on = ring(t)
    a = pm.EndEffectorTracking(UR5, RING).acceleration(t, on.q, on.v, on)
    # kp times the spline's own error, 100 / s^2 times 8.5e-6 m.
    np.testing.assert_allclose(a, on.a, atol=2e-3)
    assert np.abs(on.a[6:]).max() > 0.02


def test_an_error_at_the_start_dies_away_within_limits(ring: InverseKinematicsTrajectory) -> None:
    q0 = ring(0.0).q + np.array([0.05, -0.05, 0.1, 0.1, -0.1, 0.1, 0, 0, 0])
    run = pm.simulate(UR5, pm.EndEffectorTracking(UR5, RING), ring, dt=0.01, duration=3, q0=q0)
    late = run.t >= 2
    # Critically damped at 10 rad/s: (1 + 20) exp(-20) of 0.2 m; beyond it, what holding the force costs.
    assert max(misses(UR5, RING, run.t[late], run.q[late])) < 1e-4
    assert np.abs(run.a).max() <= 20 * (1 + 1e-9)
    assert (np.abs(run.v) <= UR5.velocity_limit).all()


def test_the_rest_follows_a_posture_that_has_another_pose() -> None:
    target = pm.PosePath(line(START[:3, 3], (1.0, 0.5, 0.1), 4), START[:3, :3])
    rest = still(UR5, BENT)  # it would stay where it is
    run = pm.simulate(UR5, pm.EndEffectorTracking(UR5, target), rest, dt=0.01, q0=BENT)
    assert max(misses(UR5, target, run.t, run.q)) < 2e-3  # posture pulls by damping^2 of its error


def test_limits_hold_however_the_plant_moves_under_the_held_force() -> None:
    T = PANDA.frame_pose(PANDA.rest)  # one finger at its limit, the base locked
    locked = np.where(np.arange(12) < 3, 0.0, PANDA.velocity_limit)
    away = pm.PosePath(line(T[:3, 3], (-0.6, 0, -0.3), 2), T[:3, :3])
    law = pm.EndEffectorTracking(PANDA, away, velocity_limit=locked, integrator=pm.rk4)
    how: Any = {"dt": 0.01, "duration": 2.0, "integrator": pm.rk4, "substeps": 5}
    run = pm.simulate(PANDA, law, still(PANDA, PANDA.rest), **how)
    # What five corrections leave of a coordinate's overrun, 1e-2 each; steps a fifth as long differ from
    # one by some 1e-4 of rk4's own error per step.
    assert (run.q > PANDA.lower - 1e-10).all()
    assert (run.q < PANDA.upper + 1e-10).all()
    assert (np.abs(run.v) <= locked + 1e-7).all()
    assert np.minimum(run.q - PANDA.lower, PANDA.upper - run.q)[:, 3:-2].min() < 1e-3
    assert misses(PANDA, away, run.t, run.q)[0] > 0.05


def still(robot: pm.MobileRobot, q: Array) -> pm.WholeBody:
    """Return a reference at rest at a configuration."""
    return pm.WholeBody(robot, pm.FixedHeading(pm.Hold(q[:2], 4.0), q[2]), pm.Hold(q[3:], 4.0))


def test_a_pose_paths_twist_and_rate_are_its_slopes() -> None:
    h, t = 1e-4, np.linspace(0.5, 5.5, 7)
    ahead, here, behind = (RING(t + k * h) for k in (1, 0, -1))
    twist = pose_error(ahead.pose, behind.pose) / (2 * h)
    np.testing.assert_allclose(twist, here.twist, atol=1e-8)  # h^2 times derivatives of order one
    np.testing.assert_allclose((ahead.twist - behind.twist) / (2 * h), here.rate, atol=1e-8)
    ends = RING([0, RING.duration])
    np.testing.assert_allclose(ends.pose[:, :3, :3], [START[:3, :3], START[:3, :3] @ TURN], atol=1e-12)
    np.testing.assert_allclose(ends.twist[:, 3:], 0, atol=1e-15)


def test_half_a_turn_of_a_pose_has_one_sense_whatever_rounding_leaves() -> None:
    rng, unit = np.random.default_rng(7), np.array([-1, 1, 1]) / np.sqrt(3)
    for off in (0, 1e-15, -1e-15, 1e-9, -1e-9):
        target = START.copy()
        target[:3, :3] = pin.exp3((np.pi + off) * unit) @ START[:3, :3] + rng.uniform(-1e-15, 1e-15, (3, 3))
        # log3 is good to the root of rounding here; the leading entry of the axis is taken as positive.
        np.testing.assert_allclose(pose_error(target, START)[3:], -np.pi * unit, rtol=0, atol=1e-6)


def test_manipulability_is_yoshikawas() -> None:
    q = UR5.random_configuration(np.random.default_rng(5), (4, 2))
    J = UR5.frame_jacobian(q)
    whole, arm = UR5.manipulability(q), UR5.arm_manipulability(q)
    np.testing.assert_allclose(whole, np.sqrt(np.linalg.det(J @ np.swapaxes(J, -1, -2))), rtol=1e-9)
    np.testing.assert_allclose(arm, np.abs(np.linalg.det(J[..., 3:])), rtol=1e-9, atol=1e-12)
    assert (whole > arm).all()
    moved = q + np.where(np.arange(9) < 3, [1.0, -2.0, 0.7, 0, 0, 0, 0, 0, 0], 0)
    np.testing.assert_allclose(UR5.manipulability(moved), whole, rtol=1e-9)
    assert BOX.manipulability(np.zeros((2, 3))).tolist() == [0, 0]
    with pytest.raises(pm.InvalidArgument, match="frame is 'base_link', expected a frame of an arm"):
        UR5.arm_manipulability(q, "base_link")
