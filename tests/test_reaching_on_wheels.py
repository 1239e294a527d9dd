"""A UR5 on a Ridgeback follows an end effector's path by the torques of its wheels and joints."""

import warnings
from dataclasses import dataclass
from math import pi

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
DURATION = 5.0
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
    path = tmp_path_factory.mktemp("ridgeback") / "ridgeback.urdf"
    path.write_text(wheeled.ridgeback())
    base = pm.WheeledRobot.from_urdf(path, rollers=pi / 4)
    wheels = tuple(evolved(wheel, friction=ROLLERS) for wheel in base.table.wheels)
    table = evolved(base.table, wheels=wheels)
    robot = pm.WheeledRobot(base.robot, table).mount("ur5", at=(0.2, 0, 0.31, 0))
    hand, t = robot.robot.frame_pose(BENT), np.linspace(0, DURATION, 41)
    s = t / DURATION
    s = s**3 * (10 - 15 * s + 6 * s**2)
    wave = hand[:3, 3] + np.stack([0 * s, 2 * s, 0.15 * np.sin(4 * pi * s)], axis=-1)
    target = pm.PosePath(pm.Spline(wave, t), hand[:3, :3])
    motion = pm.solve_inverse_kinematics(robot.robot, target, q0=BENT, dt=0.02)
    run = pm.simulate(robot, tracking(robot, target), motion, dt=DT, integrator=constant_acceleration)
    return Wall(robot, target, motion, run)


def tracking(
    robot: pm.WheeledRobot | pm.MobileRobot, target: pm.PosePath, dt: float = DT
) -> pm.EndEffectorTracking:
    return pm.EndEffectorTracking(robot, target, dt=dt)


@pytest.mark.long
def test_the_hand_is_where_the_same_robot_without_wheels_has_it(wall: Wall) -> None:
    """A force held over dt errs by about jerk dt / (2 kp), torques at wheels that turn by little more.

    Both errors are in proportion to dt, so that without it both robots move alike.
    """
    body, far, missed = wall.robot.robot, [], []
    for dt in (2 * DT, DT):
        run = wall.run
        if dt != DT:
            follower = tracking(wall.robot, wall.target, dt)
            run = pm.simulate(wall.robot, follower, wall.motion, dt=dt, integrator=constant_acceleration)
        pushed = pm.simulate(body, tracking(body, wall.target, dt), wall.motion, dt=dt)
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
