"""Recursions over scalars: against Pinocchio, for every robot that can be mounted and for random trees."""

import pickle

import numpy as np
import pinocchio as pin
import pytest

from pinmobile import MobileRobot, PayloadBody, verify
from pinmobile.arrays import Array
from pinmobile.errors import NotTraceable
from pinmobile.parts import replace
from pinmobile.robot.articulated import ArticulatedDynamics
from pinmobile.robot.linkage import Linkage

AT = (0.1, -0.05, 0.5, 0.4)
CLOSE = 1e-10  # of the largest number; forward dynamics lose the digits of M's condition
JOINTS = (
    *(pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelPX, pin.JointModelPY),
    *(pin.JointModelPZ, pin.JointModelRUBX, pin.JointModelRUBZ),
    lambda: pin.JointModelRevoluteUnaligned(1.0, -2.0, 0.5),
    lambda: pin.JointModelPrismaticUnaligned(0.0, 0.6, 0.8),
    lambda: pin.JointModelRevoluteUnboundedUnaligned(),
)


def turn(rng: np.random.Generator) -> Array:
    """Return a random rotation."""
    return np.array(pin.Quaternion(*rng.normal(size=4)).normalized().matrix())


def arm_of(seed: int, joints: int) -> pin.Model:
    """Return a random tree, with rotors, of bodies that exist."""
    rng, model = np.random.default_rng(seed), pin.Model()
    model.name = f"tree{seed}"
    for k in range(joints):
        turned = turn(rng) if k % 3 else np.eye(3)
        # Pinocchio wants branches one after the other: on the last joint, or on one that it hangs on.
        above, kind = k, JOINTS[rng.integers(len(JOINTS))]
        while above and rng.uniform() < 0.3:
            above = int(model.parents[above])
        joint = model.addJoint(above, kind(), pin.SE3(turned, rng.normal(size=3)), f"j{k}")
        R = turn(rng)
        inertia = R @ np.diag(rng.uniform(0.1, 0.15, 3)) @ R.T
        body = pin.Inertia(rng.uniform(0.5, 3), rng.normal(size=3) * 0.2, inertia)
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        model.addJointFrame(joint)
        model.addBodyFrame(f"link{k}", joint, pin.SE3(np.eye(3), rng.normal(size=3)), -1)
    model.armature = rng.uniform(0, 0.2, model.nv)
    return model


def body_of(robot: MobileRobot) -> ArticulatedDynamics:
    found = robot.array_dynamics
    assert isinstance(found, ArticulatedDynamics)
    return found


def assert_agrees(robot: MobileRobot, states: int = 2) -> None:
    """Compare all that is computed twice, for several states at once."""
    body, rng = body_of(robot), np.random.default_rng(5)
    q = robot.random_configuration(rng, (states,))
    v, a, d = rng.normal(size=(3, states, robot.nv))
    tau, frame, mount = robot.inverse_dynamics(q, v, a), robot.end_effector, robot.mounts[-1].name
    for name, found, expected in (
        ("M", body.mass_matrix(q), robot.mass_matrix(q)),
        ("n", body.nonlinear_effects(q, v), robot.nonlinear_effects(q, v)),
        ("g", body.gravity(q), robot.gravity(q)),
        ("tau", body.inverse_dynamics(q, v, a), tau),
        ("a", body.forward_dynamics(q, v, tau), a),
        ("ground", body.ground_wrench(q, v, a), robot.ground_wrench(q, v, a)),
        ("mount", body.mount_wrench(q, v, a, mount), robot.mount_wrench(q, v, a, mount)),
        ("T", body.kinetic_energy(q, v), robot.kinetic_energy(q, v)),
        ("V", body.potential_energy(q), robot.potential_energy(q)),
        ("Y", body.regressor(q, v, a), robot.regressor(q, v, a)),
        ("drift", body.frame_bias_acceleration(q, v, frame), robot.frame_bias_acceleration(q, v, frame)),
        ("pose", body.frame_pose(q, frame), robot.frame_pose(q, frame)),
        ("J", body.frame_jacobian(q, frame), robot.frame_jacobian(q, frame)),
        ("q", body.integrate(q, d), robot.integrate(q, d)),
        ("d", body.difference(q, robot.integrate(q, d)), robot.difference(q, robot.integrate(q, d))),
    ):
        assert found.shape == expected.shape, name
        assert np.abs(found - expected).max() < CLOSE * (1 + np.abs(expected).max()), name


@pytest.mark.parametrize("seed", range(2))
def test_random_trees_move_as_pinocchio_says(seed: int) -> None:
    robot = MobileRobot(30.0, 1.1, com=(0.1, -0.05, 0.2)).mount(arm_of(seed, 9), AT)
    robot = robot.mount("ur5", (-0.3, 0, 0.2, -2.0)).attach(PayloadBody(2.0), "ur5/base_link")
    assert_agrees(robot.attach(PayloadBody(1.5, (0.1, 0, 0.2), size=(0.1, 0.2, 0.3))), 3)


def test_right_angles_that_a_file_rounds_are_exact_and_said_to_be() -> None:
    robot = MobileRobot.box().mount("ur5")
    assert robot.source == (
        "a homogeneous box; ur5: right angles that its file rounds are exact "
        "(shoulder_lift_joint, wrist_1_joint)"
    )
    assert robot.base.source == "a homogeneous box"
    for place in robot.model.jointPlacements:
        assert set(np.abs(place.rotation).ravel()) <= {0.0, 1.0}
    model = pin.Model()
    for k, angle in enumerate((1.57079632679, 1.5708, 0.3)):
        joint = model.addJoint(
            k, pin.JointModelRZ(), pin.SE3(pin.utils.rotate("x", angle), np.zeros(3)), f"j{k}"
        )
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.ones(3), np.eye(3)), pin.SE3.Identity())
    (mount,) = MobileRobot.box().mount(model, AT).mounts
    assert mount.arm.squared == ("j0",)  # 1.5708 is not a rounding: it is what its file says
    assert mount.model.jointPlacements[2].rotation[1, 1] == np.cos(1.5708)
    assert model.jointPlacements[1].rotation[1, 1] != 0


def test_a_joint_that_is_neither_revolute_nor_prismatic_is_refused_by_name() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "screw")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.ones(3), np.eye(3)), pin.SE3.Identity())
    with pytest.raises(NotTraceable, match="joint 'screw' is a JointModelHX, neither revolute nor prismatic"):
        Linkage.of(model)
    with pytest.raises(NotTraceable, match="screw"):
        _ = MobileRobot.box().mount(model, AT).array_dynamics


FOREARM = "mounts.ur5.links.forearm_link"


def changed() -> MobileRobot:
    robot = MobileRobot.box().mount("ur5", AT).attach(PayloadBody(1.0, size=(0.1, 0.1, 0.1)))
    link = next(link for link in robot.mounts[0].links if link.name == "forearm_link")
    changes: dict[str, object] = {
        "mass": 40.0,
        "yaw_inertia": 2.0,
        f"{FOREARM}.mass": 5.0,
        "loads.0.mass": 2.5,
    }
    changes |= {f"{FOREARM}.com": (link.com[0], 0.02, link.com[2])}
    changes |= {f"{FOREARM}.inertia": (0.05, *link.inertia[1:]), "mounts.ur5.at": (*AT[:3], 1.0)}
    return replace(robot, changes | {"mounts.ur5.rotors": (0, 0, 0.3, 0, 0, 0), "loads.0.mass": 2.5})


def test_other_numbers_make_another_robot() -> None:
    robot = changed()
    assert_agrees(robot)
    assert verify(robot, states=5).passed
    model = robot.model
    forearm = model.inertias[model.getJointId("ur5/elbow_joint")]
    assert (forearm.mass, forearm.lever[1], forearm.inertia[0, 0]) == (5.0, 0.02, 0.05)
    assert model.armature[5] == 0.3
    assert (robot.mass, robot.loads[0].mass) == (40.0, 2.5)
    assert robot.body.yaw_inertia == pytest.approx(2.0)
    np.testing.assert_allclose(robot.body.inertia, MobileRobot.box().body.inertia * 2 / 1.3)
    assert robot.mounts[0].at == (*AT[:3], 1.0)
    assert robot.mounts[0].is_changed
    assert robot != replace(robot, {f"{FOREARM}.mass": 6.0})
    again = pickle.loads(pickle.dumps(robot))
    assert again == robot
    assert again.source == robot.source


def test_what_moves_together_is_called_by_its_first_link_with_a_mass() -> None:
    (mount,) = MobileRobot.box().mount("ur5").mounts
    assert mount.links[0].name == "base_link"  # and not the world that it is fixed to
    assert mount.links[-1].name == "wrist_3_link"
    assert len(mount.links) == 7
