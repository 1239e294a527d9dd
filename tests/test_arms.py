"""Arms on the base: against another engine and physics; base and arms under way together."""

import pickle
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile.arrays import Array, ArrayLike
from pinmobile.controllers import Decoupled, planar_difference
from pinmobile.errors import LimitWarning, UnknownName
from pinmobile.robot import Mount
from tests.refusals import refusals, refused, told

AT = (0.1, -0.05, 0.2, 0.4)
BARE = pm.MobileRobot.box()
UR5, PANDA = BARE.mount("ur5", AT), BARE.mount("panda", AT)
KINOVA = BARE.mount("kinova", AT)  # four of its joints are continuous
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


# -- a base and its arms under way together --------------------------------------------------------


CIRCLE = pm.Tangent(pm.Circle(1, 0.5, 6))


# -- references ------------------------------------------------------------------------------------


@ROBOTS
def test_the_reference_is_the_bases_beside_the_paths(robot: pm.MobileRobot) -> None:
    starts = [(mount.q, robot.rest[mount.q]) for mount in robot.mounts]
    vias = [start + np.where(start + 0.03 < robot.upper[q], 0.03, -0.03) for q, start in starts]
    paths = [pm.Spline([x, via, x], (0, 2.5, 6)) for (_, x), via in zip(starts, vias, strict=True)]
    trajectory, t = pm.WholeBody(robot, CIRCLE, *paths), np.linspace(0, 6, 12).reshape(3, 4)
    assert trajectory.duration == 6.0
    got = trajectory(t)
    for k, part in enumerate(got):
        assert part.shape == (3, 4, robot.nv)
        np.testing.assert_array_equal(part[..., :3], CIRCLE(t)[k])
        for mount, path in zip(robot.mounts, paths, strict=True):
            np.testing.assert_array_equal(part[..., mount.q], path.derivative(t, k))
    for part, one in zip(got, trajectory(t[1, 2]), strict=True):
        np.testing.assert_array_equal(one, part[1, 2])


@ROBOTS
def test_an_arm_without_a_path_is_held_at_rest(robot: pm.MobileRobot) -> None:
    reference = pm.WholeBody(robot, CIRCLE, *[None] * len(robot.mounts))((0, 2.5, 6))
    np.testing.assert_allclose(reference.q[:, 3:], [robot.rest[3:]] * 3, atol=1e-15)
    assert not reference.v[:, 3:].any()
    assert pm.WholeBody(BARE, CIRCLE)(2.5).q.shape == (3,)


def test_what_ends_first_is_held_at_its_end() -> None:
    line = pm.Tangent(pm.RestToRest((0, 0), (3, 4), 2))
    trajectory = pm.WholeBody(UR5, line, pm.RestToRest(np.zeros(6), np.ones(6), 5))
    assert trajectory.duration == 5.0
    late = trajectory((2.5, 5))
    np.testing.assert_array_equal(late.q[:, :3], [line(2).q] * 2)
    assert not late.v[:, :3].any()
    assert not late.a[:, :3].any()
    # A cubic comes to rest with an acceleration, which is over when it is.
    stopped = pm.WholeBody(UR5, CIRCLE, pm.CubicVia(np.zeros(6), np.ones(6), np.zeros(6), 1, 2))((2, 2.001))
    assert stopped.a[0, 3:].all()
    assert not stopped.a[1, 3:].any()
    np.testing.assert_allclose(stopped.q[1, 3:], 0, atol=1e-14)


@dataclass(frozen=True)
class Spike:
    """A path whose first joint is elsewhere around 1.001 s, too short to be seen at few times."""

    height: float
    duration: float = 6.0

    def __call__(self, t: ArrayLike) -> Array:
        return self.derivative(t, 0)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        out = np.zeros((*np.shape(t), 6))
        out[..., 0] = self.height * (np.abs(np.asarray(t) - 1.001) < 5e-4) * (order == 0)
        return out


def test_what_leaves_the_limits_is_refused_where_it_is_seen() -> None:
    steep = pm.RestToRest(np.zeros(6), [0, 0, -3.5, 0, 0, 0], 6)
    text = (
        "reference has joint 'ur5/elbow_joint' at -3.24333087 rad at t = 4.6875 s, "
        "expected -3.14159265 to 3.14159265 rad"
    )
    with refused(f"^{re.escape(text)}$"):
        pm.WholeBody(UR5, CIRCLE, steep)
    short = pm.WholeBody(UR5, CIRCLE, Spike(7.0))
    assert short(1.0).q[3] == 0
    text = (
        "reference has joint 'ur5/shoulder_pan_joint' at 7 rad at t = 1.001 s, "
        "expected -6.28318531 to 6.28318531 rad"
    )
    for call in (
        lambda: short([[1.0, 1.001]]),
        lambda: pm.simulate(UR5, pm.ComputedTorque(UR5), short, dt=1e-3),
    ):
        with refused(f"^{re.escape(text)}$"):
            call()


def test_a_start_outside_the_joint_limits_is_reported() -> None:
    reference = pm.WholeBody(UR5, CIRCLE, None)
    beyond, fast = UR5.rest.copy(), np.zeros(9)
    beyond[5], fast[4] = 7.0, -4.0
    for start, text in (
        ({"q0": beyond}, "ur5/elbow_joint reaches 7 rad at t = 0 s, beyond its limit of 3.142 rad"),
        (
            {"v0": fast},
            "ur5/shoulder_lift_joint moves at -4 rad/s at t = 0 s, beyond its limit of -3.15 rad/s",
        ),
    ):
        with pytest.warns(LimitWarning, match=re.escape(text)):
            pm.simulate(UR5, pm.ComputedTorque(UR5), reference, dt=1e-3, **start)


def test_what_is_faster_than_a_joint_can_be_is_refused() -> None:
    text = "reference moves joint 'ur5/shoulder_pan_joint' at "
    with refused(f"^{re.escape(text)}.* rad/s at t = .* s, expected at most 3.15 rad/s$"):
        pm.WholeBody(UR5, CIRCLE, pm.RestToRest(np.zeros(6), np.full(6, 3.0), 0.2))


def test_a_short_path_of_the_second_arm_is_looked_at_between_the_times_of_the_first() -> None:
    start = TWO.rest[TWO.mounts[1].v.start :]
    away = pm.CubicVia(start, start + 4 * np.eye(6)[1], start, 0.45, 0.9)
    with refused(r"joint 'kinova/j2s6s200_joint_2' at \d"):
        pm.WholeBody(TWO, pm.Tangent(pm.Circle(1, 0.1, 60)), None, away)


def test_slides_have_their_limits_in_metres_and_a_limit_itself_is_within() -> None:
    panda = BARE.mount("panda", AT)
    rest, finger = panda.rest[3:], np.eye(9)[7]
    top = rest + finger * (panda.upper[10] - rest[7])
    assert pm.WholeBody(panda, CIRCLE, pm.RestToRest(rest, top, 6))(6.0).q[10] == pytest.approx(0.04)
    with refused(r"finger_joint1' at 0\.0405523071 m at t = 4\.3125 s, expected 0 to 0\.04 m$"):
        pm.WholeBody(panda, CIRCLE, pm.Spline([rest, top + 0.01 * finger], (0, 6)))


test_what_does_not_fit_together_is_refused = refusals(
    (
        lambda: pm.WholeBody(UR5, pm.Circle(1, 1, 6), None),
        "base is Circle(radius=1.0, rate=1.0, duration=6.0), a path, which has no heading, expected a "
        "trajectory: wrap the path in Tangent or FixedHeading, such as Tangent(path)",
    ),
    (lambda: pm.WholeBody(UR5, CIRCLE), "joints has 0 paths, expected 1, one per arm of the robot"),
    (
        lambda: pm.WholeBody(TWO, CIRCLE, None, pm.Hold(np.zeros(5), 6)),
        "joints[1](0) has shape (5,), expected (6,), one coordinate per joint of 'kinova'",
    ),
    (
        lambda: pm.WholeBody(UR5, CIRCLE, pm.Hold(np.zeros(6), 7)),
        "base ends after 6 s of 7 s while it moves at 0.5, expected an end at rest, or the same duration",
    ),
    (lambda: pm.PDGravity(UR5, (1, 2, 3), 1), "kp has shape (3,), expected (), (9,) or (9, 9)"),
    (
        lambda: pm.simulate(UR5, Decoupled(UR5), CIRCLE, dt=0.01),
        "q has shape (9,), expected (..., 3), as in the reference; the reference has the first 3 of 9 "
        "coordinates, expected a controller of these coordinates, or a reference of all: "
        "WholeBody(robot, base, *joints) combines base and arms",
    ),
    by=told,
)


# -- controllers -----------------------------------------------------------------------------------


def drawn(robot: pm.MobileRobot) -> tuple[Array, Array, pm.Reference]:
    """Return states and references, 12 each."""
    rng = np.random.default_rng(11)
    q, q_d = robot.random_configuration(rng, (2, 12))
    v, v_d, a_d = rng.normal(size=(3, 12, robot.nv))
    return q, v, pm.Reference(q_d, v_d, a_d)


@ROBOTS
def test_whole_body_computed_torque_makes_the_error_linear(robot: pm.MobileRobot) -> None:
    q, v, reference = drawn(robot)
    tau, _ = pm.ComputedTorque(robot, 3, 2)(0.0, q, v, reference, None)
    expected = reference.a + 3 * robot.difference(q, reference.q) + 2 * (reference.v - v)
    # Rounding, amplified by a condition number of 1e4.
    np.testing.assert_allclose(robot.forward_dynamics(q, v, tau), expected, atol=1e-9)
    if robot is UR5:
        np.testing.assert_array_equal(robot.difference(q, reference.q), planar_difference(q, reference.q))


@ROBOTS
def test_pd_with_gravity_is_pd_and_gravity(robot: pm.MobileRobot) -> None:
    q, v, reference = drawn(robot)
    kp, kd = np.linspace(1, 2, robot.nv), np.linspace(3, 4, robot.nv)
    tau, state = pm.PDGravity(robot, kp, kd)(0.0, q, v, reference, None)
    expected = robot.gravity(q) + kp * robot.difference(q, reference.q) + kd * (reference.v - v)
    np.testing.assert_allclose(tau, expected, rtol=1e-13)
    assert state is None


@ROBOTS
def test_decoupled_is_the_locked_load_and_the_arm_on_a_fixed_base(robot: pm.MobileRobot) -> None:
    q, v, reference = drawn(robot)
    tau, state = Decoupled(robot, 3, 2)(0.0, q, v, reference, None)
    command = reference.a + 3 * robot.difference(q, reference.q) + 2 * (reference.v - v)
    for k in range(12):
        base = robot.with_locked_arms(q[k]).inverse_dynamics(q[k, :3], v[k, :3], command[k, :3])
        np.testing.assert_allclose(tau[k, :3], base, atol=1e-11)  # roundings of some 1e2 N m
        for mount in robot.mounts[: 2 - len(robot.loads)]:  # the load is on the first arm, which comes first
            own = mount.model.copy()
            if robot.loads:
                frame = own.frames[own.getFrameId(mount.arm.tip)]
                own.appendBodyToJoint(frame.parentJoint, robot.loads[0].body, frame.placement)
            arm = pin.rnea(own, own.createData(), q[k, mount.q], v[k, mount.v], command[k, mount.v])
            np.testing.assert_allclose(tau[k, mount.v], arm, atol=1e-11)
    assert state is None
    single = Decoupled(robot, 3, 2)(0.0, q[4], v[4], pm.Reference(*(part[4] for part in reference)), None)[0]
    np.testing.assert_array_equal(single, tau[4])
