"""Base and arm follow tasks by the independent velocities of a drive, and by its torques."""

import warnings
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.balance import contact_loads, slip_margins
from pinmobile.errors import LimitWarning, Unreachable
from pinmobile.integrators import constant_acceleration
from pinmobile.parts import evolved
from pinmobile.plant import ContactLoads, SlipMargins
from pinmobile.reaching import InverseKinematicsTrajectory
from pinmobile.wheels import WheelFriction
from tests import wheeled
from tests.refusals import refused

BENT = np.array([0, 0, 0, 0, -1.2, 1.6, -0.4, 1.57, 0])
BOX = pm.MobileRobot.box(mass=60, size=(0.6, 0.5, 0.3))
WHEEL: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.005, "yaw_inertia": 0.005}
TABLES = {
    "differential": pm.WheelTable.differential(0.5, 0.1, supports=[(0.25, 0), (-0.25, 0)], **WHEEL),
    "axle ahead": pm.WheelTable.differential(0.5, 0.1, x=0.13, supports=[(-0.25, 0)], **WHEEL),
    "car": pm.WheelTable.car(0.5, 0.4, 0.1, **WHEEL),
    "mecanum": pm.WheelTable.mecanum(0.4, 0.5, 0.1, **WHEEL),
}
ROBOTS = {name: pm.WheeledRobot(BOX, table).mount("ur5", (0.1, 0, 0.3, 0)) for name, table in TABLES.items()}
ARMED = ROBOTS["differential"].robot
HAND = ARMED.frame_pose(BENT)
LOCKED = np.r_[0, 0, ARMED.velocity_limit[3:]]
DURATION = 6.0


def line(way: Any, duration: float = 3.0) -> pm.PosePath:
    """Return a straight way of the hand from rest to rest, with its orientation."""
    return pm.PosePath(pm.RestToRest(HAND[:3, 3], HAND[:3, 3] + way, duration), HAND[:3, :3])


def sideways() -> pm.PosePath:
    """Return a way of the hand to the side, farther than the arm reaches."""
    poses = np.tile(HAND, (3, 1, 1))
    poses[1:, :3, 3] += [(0.5, 0.3, 0.1), (1.0, 1.0, -0.1)]
    return pm.PosePath.through(poses, [0, DURATION / 2, DURATION])


@pytest.fixture(scope="module", params=["axle ahead", "car", "mecanum"])
def solved(request: pytest.FixtureRequest) -> tuple[pm.WheeledRobot, InverseKinematicsTrajectory]:
    robot = ROBOTS[request.param]
    return robot, pm.solve_inverse_kinematics(robot, sideways(), q0=BENT)


def test_the_hand_is_on_its_path_and_the_base_went_along(solved: Any) -> None:
    robot, motion = solved
    t = np.linspace(0, DURATION, 2001)
    far = robot.robot.frame_pose(motion(t).q)[:, :3, 3] - sideways()(t).pose[:, :3, 3]
    # The spline smooths control points by a dt^2 / 6, with a = 0.3 m/s^2; between them half more.
    assert np.linalg.norm(far, axis=1).max() < 1.5 * 1e-5
    assert motion.max_error()[1] < 1e-4
    assert np.hypot(*motion(DURATION).q[:2]) > 1.0
    # Quadrature of psi by another rule: the pose is the integral of its rate.
    fine = np.linspace(0, DURATION, 6001)
    v, h = motion(fine).v, fine[1]
    simpson = (h / 3) * (v[:-2:2] + 4 * v[1::2] + v[2::2]).sum(axis=0)
    np.testing.assert_allclose(motion(DURATION).q - motion(0.0).q, simpson, atol=1e-9)


def test_velocity_and_acceleration_are_derivatives(solved: Any) -> None:
    _, motion = solved
    t, h = np.linspace(0.1, 5.9, 50) + 3e-3, 1e-5  # beside the knots, where jerk jumps
    ahead, here, behind = (motion(t + k * h) for k in (1, 0, -1))
    np.testing.assert_allclose((ahead.q - behind.q) / (2 * h), here.v, atol=1e-8)
    np.testing.assert_allclose((ahead.v - behind.v) / (2 * h), here.a, atol=1e-6)


def test_the_wheels_roll_and_the_velocities_are_the_drives_own(solved: Any) -> None:
    """`start` turns wheels and axles by the rows of the table, which the solver does not use."""
    robot, motion = solved
    rates = np.diff(motion.controls, axis=0) / 0.01
    for k in (100, 250, 400):
        reference = motion(motion.t[k])
        q, v = robot.start(reference)
        assert np.abs(robot.constraint_matrix(q) @ v)[:].max() < 1e-9
        own = robot.independent(q, v)
        expected = (rates[k] + rates[k + 1]) / 2  # of a uniform cubic spline at a knot
        count = len(own) - (robot.mobility.steerability > 0)  # `start` knows no steering rate
        np.testing.assert_allclose(own[:count], expected[:count], atol=1e-10)
    if robot.mobility.steerability:
        held = robot.start(motion(3.0))[0][9]
        assert held == pytest.approx(motion._curve(3.0)[-1], abs=1e-9)
        assert abs(held) > 0.05


@pytest.mark.parametrize("name", ["car", "mecanum"])
def test_the_controllers_of_the_drives_follow_it(name: str) -> None:
    robot = ROBOTS[name]
    motion = pm.solve_inverse_kinematics(robot, sideways(), q0=BENT, dt=0.02)
    if name == "mecanum":
        law: Any = pm.ComputedTorque(robot, 100, 20)
    else:
        law = pm.Backstepping(pm.UnicycleTracking(), robot, k=40, steer=20, arms=10)
    run = pm.simulate(robot, law, motion, dt=0.005)
    metres, radians = run.end_effector().max_error()
    assert max(metres, radians) < 2e-4


def test_a_car_keeps_the_limit_of_its_steering_where_the_hand_wants_more() -> None:
    """Beside the car at the limit, the radius of the path is wheelbase / tan(limit)."""
    limit = 0.3
    table = pm.WheelTable.car(0.5, 0.4, 0.1, steering_limit=limit, **WHEEL)
    robot = pm.WheeledRobot(BOX, table).mount("ur5", (0.1, 0, 0.3, 0))
    motion = pm.solve_inverse_kinematics(robot, line((0.9, 0.9, 0), 4.0), q0=BENT, tolerance=np.inf)
    v = motion(np.linspace(0.5, 3.5, 301)).v
    bent = v[:, 2] / np.hypot(v[:, 0], v[:, 1])
    assert np.abs(bent).max() == pytest.approx(np.tan(limit) / 0.5, rel=1e-6)
    pm.simulate(robot, pm.Backstepping(pm.UnicycleTracking(), robot), motion, dt=0.01, duration=0.1)


def test_limits_of_the_drive_hold_at_all_times_and_the_error_says_which_when_and_where() -> None:
    robot, most = ROBOTS["differential"], np.r_[0.4, 0.3, ARMED.velocity_limit[3:]]
    words = (
        r"^target is missed by 0\.01\d+ m and .* rad at t = 0\.\d+ s, expected at most 0\.01; .*; the "
        r"target is at \(0\.\d+, 0\.1092, 0\.5379\) m, where base reaches its speed limit, 0\.4 m/s, at t = 0"
    )
    with pytest.raises(Unreachable, match=words) as caught:
        pm.solve_inverse_kinematics(robot, line((1, 0, 0), 1.0), q0=BENT, velocity_limit=most)
    kept = caught.value.resolved
    t = np.linspace(0, 1, 2001)
    v = kept(t).v
    assert (np.hypot(v[:, 0], v[:, 1]) <= 0.4 + 1e-9).all()
    assert (np.abs(v[:, 2:]) <= most[1:] + 1e-9).all()
    assert np.abs(np.diff(kept.controls, 2, axis=0)).max() <= 10 * 0.01**2 * (1 + 1e-9)
    assert (kept(t).q[:, 3:] <= ARMED.upper[3:]).all()


def test_each_limit_is_named() -> None:
    robot = ROBOTS["differential"]
    with pytest.raises(Unreachable, match=r"m, where base reaches its acceleration limit, 10 m/s\^2"):
        pm.solve_inverse_kinematics(robot, line((1, 0, 0), 0.5), q0=BENT)
    with pytest.raises(Unreachable, match="m, where ur5/elbow_joint reaches its speed"):
        pm.solve_inverse_kinematics(robot, line((1, 0, 0)), q0=BENT, velocity_limit=LOCKED)


def test_the_position_limit_of_a_joint_is_named() -> None:
    low = pm.MobileRobot.box().mount("panda", (0.1, 0, 0.2, 0))
    start = low.rest
    axis, locked = low.frame_pose(start)[:3, :3], np.where(np.arange(low.nv) == 9, np.inf, 0.0)
    turning = pm.PosePath(pm.Hold(low.frame_pose(start)[:3, 3], 20.0), axis, turn=(0, 0, 6.0))
    with pytest.raises(Unreachable, match=r"where panda/panda_joint7 reaches its position limit, 2\.8"):
        pm.solve_inverse_kinematics(low, turning, q0=start, dt=0.1, velocity_limit=locked)


def hold(at: Any, rotation: Any = None) -> pm.PosePath:
    return pm.PosePath(pm.Hold(at, 3.0), rotation)


def test_of_two_tasks_the_one_with_the_weight_has_priority() -> None:
    """The elbow cannot stay while the hand goes: it gives way by the square of the ratio of weights."""
    robot, elbow, missed = ROBOTS["differential"], "ur5/forearm_link", []
    at = ARMED.frame_pose(BENT, elbow)[:3, 3]
    for weight in (10, 100):
        hand = pm.FrameTask(line((0.4, 0, 0)), position=weight, orientation=weight)
        motion = pm.solve_inverse_kinematics(
            robot, [hand, pm.FrameTask(hold(at), elbow)], q0=BENT, tolerance=1
        )
        missed.append(motion.max_error()[0])
        assert np.nanmax(np.linalg.norm(motion.error_of(1)[:, :3], axis=1)) < 0.4
    assert missed[1] < 1e-4
    # The spline's own error, 6e-6 m, does not depend on weights.
    alone = pm.solve_inverse_kinematics(robot, line((0.4, 0, 0)), q0=BENT)
    elbow_alone = ARMED.frame_pose(alone(alone.t).q, elbow)[:, :3, 3] - at
    elbow_held = np.linalg.norm(motion.error_of(1)[:, :3], axis=1).max()
    assert elbow_held < np.linalg.norm(elbow_alone, axis=1).max()
    assert (missed[0] - alone.max_error()[0]) / max(missed[1] - alone.max_error()[0], 1e-7) > 20


def test_an_axis_leaves_the_turn_about_it_free_and_a_heading_is_an_axis_of_the_body() -> None:
    robot = ROBOTS["mecanum"]
    spin = pm.PosePath(pm.Hold(HAND[:3, 3], 3.0), HAND[:3, :3], turn=(0, 0, 2.0))
    whole = pm.solve_inverse_kinematics(robot, spin, q0=BENT)
    ahead = pm.PosePath(pm.Hold((0, 0, 0), 3.0), np.eye(3), turn=(0, 0, 0.5))
    tasks = [pm.FrameTask(spin, axis=(0, 0, 2)), pm.FrameTask(ahead, "base_link", (1, 0, 0), position=0)]
    motion = pm.solve_inverse_kinematics(robot, tasks, q0=BENT)
    assert max(motion.max_error()) < 1e-5
    assert np.abs(motion.error_of(1)[:, 5]).max() < 1e-4
    assert np.isnan(motion.error_of(1)[:, :3]).all()
    t = motion.t
    np.testing.assert_allclose(motion(t).q[:, 2], ahead(t).twist[:, 5].cumsum() * 0.01, atol=5e-3)

    def tool(found: InverseKinematicsTrajectory) -> Array:
        return robot.robot.frame_pose(found(t).q)[:, :3, :3]

    np.testing.assert_allclose(tool(motion)[:, :, 2], tool(whole)[:, :, 2], atol=1e-4)
    turned = np.arccos(np.clip((tool(motion)[-1, :, 0] * tool(whole)[-1, :, 0]).sum(), -1, 1))
    assert turned > 1.0  # the tool does not take the turn along
    assert "target orientation of ur5/tool0" not in motion.signals_at(t)


def test_an_opposite_axis_has_an_error_of_half_a_turn() -> None:
    task = pm.FrameTask(hold((0, 0, 0), np.eye(3)), axis=(0, 0, 1), position=0)
    import pinocchio as pin

    error = task.error_of((np.zeros(3), np.eye(3)), pin.SE3(np.diag([1.0, -1, -1]), np.zeros(3)))
    assert np.linalg.norm(error) == pytest.approx(np.pi)
    assert error[2] == 0


def test_other_weights_and_axes_are_refused() -> None:
    with pytest.raises(pm.InvalidArgument, match="position and orientation have weight 0, expected one"):
        pm.FrameTask(line((1, 0, 0)), position=0, orientation=0)
    with pytest.raises(pm.InvalidArgument, match=r"^axis is .*, expected a target with an orientation"):
        pm.FrameTask(hold((0, 0, 0)), axis=(0, 0, 1))


def test_drives_that_steer_each_wheel_are_refused() -> None:
    table = pm.WheelTable.swerve([(0.2, 0), (-0.2, 0)], 0.1, supports=[(0, 0.2), (0, -0.2)], **WHEEL)
    swerve = pm.WheeledRobot(BOX, table).mount("ur5")
    with refused(r"^robot is a drive of type \(1, 2\), expected an omnidirectional drive"):
        pm.solve_inverse_kinematics(swerve, line((1, 0, 0)))


# -- a UR5 on a Ridgeback follows an end effector's path by the torques of its wheels and joints ---


LASTING = 5.0
DT = 0.01
# Nothing but what is Coulomb's: rollers that turn freely, wheels without resistance.
ROLLERS = WheelFriction(mu=0.4, across=0.0, rolling=0.0)


@dataclass(frozen=True)
class Wall:
    """What draws a wave of 2 m on a wall, sideways."""

    robot: pm.WheeledRobot
    target: pm.PosePath
    motion: InverseKinematicsTrajectory
    run: pm.Rollout

    def missed(self, run: pm.Rollout) -> Array:
        """Return how far the hand is from the wave, shape (samples,) [m]."""
        hand = self.robot.robot.frame_pose(run.q[:, : self.robot.robot.nq])
        return np.asarray(np.linalg.norm((hand - self.target(run.t).pose)[:, :3, 3], axis=1))


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Wall:
    path = wheeled.written(tmp_path_factory.mktemp("ridgeback"), wheeled.ridgeback())
    base = pm.WheeledRobot.from_urdf(path, rollers=pi / 4)
    wheels = tuple(evolved(wheel, friction=ROLLERS) for wheel in base.table.wheels)
    table = evolved(base.table, wheels=wheels)
    robot = pm.WheeledRobot(base.robot, table).mount("ur5", at=(0.2, 0, 0.31, 0))
    hand, t = robot.robot.frame_pose(BENT), np.linspace(0, LASTING, 41)
    s = t / LASTING
    s = s**3 * (10 - 15 * s + 6 * s**2)
    wave = hand[:3, 3] + np.stack([0 * s, 2 * s, 0.15 * np.sin(4 * pi * s)], axis=-1)
    target = pm.PosePath(pm.Spline(wave, t), hand[:3, :3])
    motion = pm.solve_inverse_kinematics(robot.robot, target, q0=BENT, dt=0.02)
    law = pm.EndEffectorTracking(robot, target, dt=DT)
    run = pm.simulate(robot, law, motion, dt=DT, integrator=constant_acceleration)
    return Wall(robot, target, motion, run)


@pytest.mark.long
def test_the_hand_is_where_the_same_robot_without_wheels_has_it(wall: Wall) -> None:
    """A force held over dt errs by about jerk dt / (2 kp), torques at wheels that turn by little more.

    Both errors are in proportion to dt, so that without it both robots move alike.
    """
    body, far, missed = wall.robot.robot, [], []
    for dt in (2 * DT, DT):
        run = wall.run
        if dt != DT:
            follower = pm.EndEffectorTracking(wall.robot, wall.target, dt=dt)
            run = pm.simulate(wall.robot, follower, wall.motion, dt=dt, integrator=constant_acceleration)
        law = pm.EndEffectorTracking(body, wall.target, dt=dt)
        pushed = pm.simulate(body, law, wall.motion, dt=dt)
        far.append(np.abs(run.q[:, : body.nq] - pushed.q).max())
        missed.append(wall.missed(run).max())
        assert np.abs(wall.missed(run) - wall.missed(pushed)).max() < 1e-4 * missed[-1]
    assert far[1] < 5e-6
    assert far[0] / far[1] == pytest.approx(2, rel=0.1)
    assert missed[1] < 1e-3
    assert missed[0] / missed[1] == pytest.approx(2, rel=0.1)
    assert wall.run.q[-1, 1] > 1.8  # the base goes along


def test_the_friction_that_its_margins_ask_for_is_what_it_needs(wall: Wall) -> None:
    follower = pm.ComputedTorque(wall.robot, 100, 20)
    rolled = pm.simulate(wall.robot, follower, wall.motion, dt=DT, engine=pm.Engine.COMPILED)
    margins: SlipMargins = slip_margins(rolled)
    loads: ContactLoads = contact_loads(rolled)
    needed = float((np.abs(margins.along) / loads.values).max())
    for share, slides in ((1.02, False), (0.98, True)):
        floor = pm.WheeledRobot(wall.robot.robot, wall.robot.table, pm.Coulomb(share * needed))
        run = pm.simulate(floor, follower, wall.motion, dt=DT, engine=pm.Engine.COMPILED)
        slip = run.metrics()["slip"][1].max()
        assert slip > 1e-2 if slides else slip < 1e-12
        assert bool(run.signals["slides"].values.any()) == slides
        assert wall.missed(run).max() < 1e-3


def test_the_hand_that_meets_a_tyre_is_refused() -> None:
    body = pm.MobileRobot.box(mass=60, size=(0.8, 0.5, 0.3)).mount("ur5", at=(0.2, 0, 0.3, 0))
    robot = pm.WheeledRobot(body, pm.WheelTable.mecanum(0.6, 0.8, 0.15, mass=1.0, spin_inertia=0.01))
    start = np.array([0, 0, 0, 0.9, -1.0, 1.9, -0.6, 1.57, 0])
    toward_hub = pm.PosePath(pm.RestToRest(body.frame_pose(start)[:3, 3], (0.3, 0.4, 0.2), duration=4))
    with pytest.raises(Unreachable, match="ur5/wrist_3_link and front_left/tyre") as found:
        pm.solve_inverse_kinematics(
            robot, toward_hub, q0=start, dt=0.05, clearance=0.0, velocity_limit=[0] * 3 + [3] * 6
        )
    motion = found.value.resolved
    q = np.hstack([motion(motion.t).q, np.zeros((len(motion.t), 4))])
    assert motion.clearance.smallest == pm.clearance(robot, q).smallest < -0.05


def test_joints_carry_their_load_on_the_slope() -> None:
    body = pm.MobileRobot.box(mass=60, size=(0.8, 0.6, 0.3)).mount("ur5", at=(0.2, 0, 0.3, 0))
    body = body.attach(pm.PayloadBody(8, com=(0, 0, 0.35)))
    level = pm.WheeledRobot(body, pm.WheelTable.differential(0.6, 0.1, mass=2.3, spin_inertia=0.01))
    start = np.array([0, 0, 0, -0.05, 1.67, -1.39, 0.57, 1.66, 0.41])
    place = body.frame_pose(start)
    held = pm.PosePath(pm.Hold(place[:3, 3], 1.0), place[:3, :3])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pm.solve_inverse_kinematics(level, held, q0=start)
    ramp = level.on_ramp(0.5)
    torque = ramp.nonlinear_effects(np.append(start, [0, 0]), np.zeros(11))[6]
    with pytest.warns(LimitWarning, match=rf"ur5/wrist_1_joint reaches {torque:.4g} N m .*limit of -28 N m"):
        pm.solve_inverse_kinematics(ramp, held, q0=start)


def test_a_drive_that_cannot_go_everywhere_is_refused() -> None:
    table = pm.WheelTable.differential(0.5, 0.1, mass=1.0, spin_inertia=0.005)
    robot = pm.WheeledRobot(pm.MobileRobot.box(), table).mount("ur5")
    target = pm.PosePath(pm.Spline([[0.5, 0, 0.5], [0.5, 1, 0.5]], [0, 3]))
    with refused(r"^robot is a drive of type \(2, 0\), which cannot accelerate"):
        pm.EndEffectorTracking(robot, target)
