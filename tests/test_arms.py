"""An arm on the base: against another engine, and against what physics says."""

import pickle
import warnings
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.errors import LimitWarning, UnknownName
from pinmobile.robot import Mount

AT = (0.1, -0.05, 0.2, 0.4)
UR5 = pm.MobileRobot.box().mount("ur5", AT)
PANDA = pm.MobileRobot.box().mount("panda", AT)
KINOVA = pm.MobileRobot.box().mount("kinova", AT)  # four of its joints are continuous
STILL = pm.WholeBody(UR5, pm.FixedHeading(pm.Hold((0, 0), 8.0), 0.0), None)
TWO = PANDA.mount("kinova", (-0.1, 0, 0.2, 0)).attach(pm.PayloadBody(1.5, (0, 0, 0.1)))
ROBOTS = pytest.mark.parametrize("robot", [UR5, KINOVA, TWO], ids=["ur5", "kinova", "two arms and a load"])


def states(robot: pm.MobileRobot, count: int = 12, seed: int = 4) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    v, a = rng.normal(size=(2, count, robot.nv))
    return robot.random_configuration(rng, (count,)), v, a


def pendulum(*, continuous: bool) -> pin.Model:
    """Return two hinges, each with a link; the first one is continuous, or has two turns to either side."""
    model = pin.Model()
    model.name = "pendulum"
    two_turns, root = np.array([4 * np.pi]), pin.SE3.Identity()
    limits = () if continuous else (0 * two_turns + 50, 0 * two_turns + 9, -two_turns, two_turns)
    kind = pin.JointModelRUBX() if continuous else pin.JointModelRX()
    first = model.addJoint(0, kind, root, "swing", *limits)
    hinge = model.addJoint(first, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0, 0, 0.3])), "hinge")
    for joint in (first, hinge):
        body = pin.Inertia(1.5, np.array([0.02, 0.01, 0.15]), np.diag([0.03, 0.04, 0.02]))
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        model.addJointFrame(joint)
        model.addBodyFrame(f"link{joint}", joint, pin.SE3.Identity(), -1)
    return model


def in_series(*joints: pin.JointModel) -> pin.Model:
    """Return a link on joints one after the other, all at one point and only the last with a body."""
    model, last = pin.Model(), 0
    for k, kind in enumerate(joints):
        last = model.addJoint(last, kind, pin.SE3.Identity(), f"joint{k}")
    body = pin.Inertia(1.0, np.array([0, 0.1, 0.3]), np.diag([0.02, 0.03, 0.04]))
    model.appendBodyToJoint(last, body, pin.SE3.Identity())
    return model


def numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def inertial(body: pin.Inertia) -> str:
    i = body.inertia
    full = numbers(np.array([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]))
    return f'<inertial pos="{numbers(body.lever)}" mass="{body.mass!r}" fullinertia="{full}"/>'


def placed(place: pin.SE3) -> str:
    x, y, z, w = pin.Quaternion(place.rotation).coeffs()
    return f'pos="{numbers(place.translation)}" quat="{numbers(np.array([w, x, y, z]))}"'


def mjcf(robot: pm.MobileRobot, mount: Mount, geoms: Mapping[int, str] = MappingProxyType({})) -> str:
    """Return the same bodies for MuJoCo: the base is one body with three joints x, y, psi.

    Shapes may be given by what they move with: -1 the world, 0 the body, k the arm's k-th joint.
    """
    arm = mount.model
    data = arm.createData()
    pin.computeJointJacobians(arm, data, pin.neutral(arm))

    def link(joint: int) -> str:
        below = "".join(link(k) for k in range(1, arm.njoints) if arm.parents[k] == joint)
        if not joint:
            body = arm.inertias[0]
            own = inertial(body) if body.mass else '<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>'
            return f"<body {placed(mount.placement)}>{own}{below}</body>"
        column = pin.getJointJacobian(arm, data, joint, pin.LOCAL)[:, arm.idx_vs[joint]]
        kind, axis = ("hinge", column[3:]) if np.linalg.norm(column[3:]) > 0.5 else ("slide", column[:3])
        own = f'<joint type="{kind}" axis="{numbers(axis)}"/>{inertial(arm.inertias[joint])}'
        own += geoms.get(joint, "")
        return f"<body {placed(arm.jointPlacements[joint])}>{own}{below}</body>"

    base = pin.Inertia(robot.body.mass, robot.body.com, robot.body.inertia)
    joints = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
    joints += '<joint type="hinge" axis="0 0 1"/>'
    return (
        '<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>'
        f"{geoms.get(-1, '')}<body>{joints}{inertial(base)}{geoms.get(0, '')}{link(0)}</body>"
        "</worldbody></mujoco>"
    )


@ROBOTS
def test_locked_arms_are_a_load(robot: pm.MobileRobot) -> None:
    q, v, a = states(robot)
    v[:, 3:] = a[:, 3:] = 0
    for k in range(4):
        lump = robot.with_locked_arms(q[k])
        assert (lump.nv, lump.mounts) == (3, ())
        tau = robot.inverse_dynamics(q[k], v[k], a[k])[:3]
        np.testing.assert_allclose(lump.inverse_dynamics(q[k, :3], v[k, :3], a[k, :3]), tau, atol=1e-11)
        assert robot.with_locked_arms(q[k, 3:]) == robot.with_locked_arms(
            np.concatenate([np.zeros(3), q[k, 3:]])
        )
    assert robot.with_locked_arms() == robot.with_locked_arms(robot.rest)
    assert robot.base == pm.MobileRobot.box()


def test_a_run_beyond_limits_reports_which_when_and_how_far_once() -> None:
    push = pm.law(lambda t, q, v, reference: np.where(np.arange(9) == 5, 1000.0, 0.0))
    with pytest.warns(LimitWarning) as told:
        run = pm.simulate(UR5, push, STILL, dt=0.001, duration=0.2)
    events = [*map(str, run.events)]
    assert events[-1].startswith("tip-over margin is ")  # which takes longer, without a warning
    assert str(told[0].message) == "; ".join(events[:-1])
    assert len(told) == 1
    q, most = run.q[:, 5], UR5.upper[5]
    k, first = int(np.argmax(q)), int(np.argmax(q > most))
    assert (
        f"ur5/elbow_joint reaches {q[k]:.4g} rad at t = {run.t[k]:g} s, beyond its limit of {most:.4g} rad "
        f"since t = {run.t[first]:g} s"
    ) in events
    asked = "input of ur5/elbow_joint reaches 1000 N m at t = 0 s, beyond its limit of 150 N m since t = 0 s"
    assert asked in events
    assert any(one.startswith("ur5/elbow_joint moves at") for one in events)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        at_rest = pm.simulate(UR5, pm.PDGravity(UR5, 100, 20), STILL, dt=0.001, duration=0.02)
    assert at_rest.events == ()


def test_limits_and_postures_are_the_files() -> None:
    own = PANDA.mounts[0].model
    np.testing.assert_array_equal(PANDA.lower, [-np.inf] * 3 + own.lowerPositionLimit.tolist())
    np.testing.assert_array_equal(PANDA.effort_limit, [np.inf] * 3 + own.effortLimit.tolist())
    np.testing.assert_array_equal(PANDA.velocity_limit[3:], own.velocityLimit)
    np.testing.assert_array_equal(PANDA.rest[3:10], PANDA.mounts[0].arm.posture[:7])
    assert np.isinf(KINOVA.lower[3])  # continuous
    unknown = pm.MobileRobot.box().mount("double_pendulum")  # its file writes zero for each
    for limit in (unknown.lower, unknown.upper, unknown.velocity_limit, unknown.effort_limit):
        assert np.isinf(limit).all()
    drawn = TWO.random_configuration(np.random.default_rng(0), (50,))
    assert (drawn >= TWO.lower).all()
    assert (drawn <= TWO.upper).all()
    assert PANDA.end_effector == "panda/panda_hand_tcp"
    assert UR5.end_effector == "ur5/tool0"
    with pytest.raises(UnknownName, match="unknown frame 'ur5/tol0', did you mean 'ur5/tool0'"):
        UR5.frame_pose(UR5.rest, "ur5/tol0")


def test_a_mounted_robot_is_a_value() -> None:
    again = pm.MobileRobot.box().mount("ur5", AT)
    assert again == UR5
    assert hash(again) == hash(UR5)
    assert again != pm.MobileRobot.box().mount("ur5", (*AT[:3], 0.5))
    assert again != again.attach(pm.PayloadBody(1.0))
    assert again.base == pm.MobileRobot.box()
    assert repr(UR5).endswith(".mount('ur5', at=(0.1, -0.05, 0.2, 0.4), name='ur5')")
    assert pickle.loads(pickle.dumps(TWO)) == TWO
    plain = pm.MobileRobot.lecture().mount("panda", AT).attach(pm.PayloadBody(1.5, (0, 0, 0.1)))
    assert eval(repr(plain), {**globals(), **vars(pm)}) == plain


def test_loads_weigh_where_they_are() -> None:
    q, _, _ = states(UR5)
    light = UR5.attach(pm.PayloadBody(2.0, (0, 0, 0.1), size=(0.1, 0.2, 0.3)))
    J = UR5.frame_jacobian(q)
    point = UR5.frame_pose(q) @ [0, 0, 0.1, 1]
    arm = point[:, :3] - UR5.frame_pose(q)[:, :3, 3]
    moving = J[:, :3] - np.cross(arm[:, :, None], J[:, 3:], axis=1)
    np.testing.assert_allclose(light.gravity(q) - UR5.gravity(q), 2 * 9.81 * moving[:, 2], atol=1e-11)
    assert light.visual_model.geometryObjects[-1].name == "load1"
    assert light.with_locked_arms().mass == pytest.approx(UR5.with_locked_arms().mass + 2)


def test_joints_with_several_axes_are_refused_unless_they_are_locked() -> None:
    base = pm.MobileRobot.box(mass=10)
    model = in_series(pin.JointModelRZ(), pin.JointModelSpherical(), pin.JointModelRX())
    model.name = "toy"
    with pytest.raises(pm.InvalidArgument) as refused:
        base.mount(model)
    assert str(refused.value) == (
        "arm 'toy': joint 'joint1' is a JointModelSpherical, which has several axes, expected one axis: "
        "model the joint as revolute and prismatic joints in series, or lock it with locked=['joint1']"
    )
    assert base.mount(model, locked=["joint1"]).nq == 5


@pytest.mark.parametrize("kind", [pin.JointModelRUBY, pin.JointModelRevoluteUnboundedUnaligned])
def test_a_continuous_joint_is_an_angle_whose_error_wraps_as_that_of_psi(kind: Any) -> None:
    model = in_series(pin.JointModelRX(), kind(), pin.JointModelRX())
    model.armature = np.array([0.1, 0.2, 0.3])
    robot = pm.MobileRobot.box(mass=10).mount(model, AT)
    assert model.nq == 4  # of Pinocchio, the angle's cosine and sine
    assert robot.model.nq == robot.nq == robot.nv == 6
    psi, angle = robot.coordinates[2], robot.coordinates[4]
    assert (psi.unit, psi.lower, psi.upper) == (angle.unit, angle.lower, angle.upper)
    q = np.array([1.0, 2.0, 3.0, 0.5, 3.0, -0.4])
    for way, left in ((0.2, 0.2), (4.0, 4 - 2 * np.pi), (-4.0, 2 * np.pi - 4), (50.0, 50 - 16 * np.pi)):
        d = robot.difference(q, robot.integrate(q, np.full(6, way)))
        np.testing.assert_allclose(d[[2, 4]], left, atol=1e-13)
        np.testing.assert_allclose(d[[0, 1, 3, 5]], way, atol=1e-13)
        body = robot.array_dynamics.difference(q, q + way)
        np.testing.assert_allclose(body, d, atol=1e-13)
    data, own = model.createData(), np.array([0.5, np.cos(3.0), np.sin(3.0), -0.4])
    M = pin.crba(model, data, own)
    np.testing.assert_allclose(robot.mass_matrix(q)[3:, 3:], M, atol=1e-14)
    assert pm.verify(robot, states=20).passed


def test_the_reference_posture_of_a_continuous_joint_is_an_angle() -> None:
    model = pendulum(continuous=True)
    wrapped = pin.RobotWrapper(model)
    wrapped.q0 = np.array([np.cos(2.5), np.sin(2.5), 0.1])
    robot = pm.MobileRobot.box().mount(wrapped, AT)
    np.testing.assert_allclose(robot.rest[3:], [2.5, 0.1], rtol=1e-15)
    turned = pm.MobileRobot.box().mount(model, AT, rest=[7.0, 0.1])
    np.testing.assert_array_equal(turned.rest[3:], [7.0, 0.1])
    with pytest.raises(pm.InvalidArgument, match=r"^rest has shape \(3,\), expected \(\.\.\., 2\)$"):
        pm.MobileRobot.box().mount(model, AT, rest=[np.cos(2.5), np.sin(2.5), 0.1])
