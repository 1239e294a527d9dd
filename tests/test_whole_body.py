"""A base and its arms under way together: references, and what three controllers make of them."""

import re
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile.arrays import Array, ArrayLike
from pinmobile.controllers import Decoupled, planar_difference
from pinmobile.errors import LimitWarning
from tests.refusals import refusals, refused, told

AT = (0.1, -0.05, 0.2, 0.4)
BARE = pm.MobileRobot.box()
UR5 = BARE.mount("ur5", AT)
KINOVA = BARE.mount("kinova", AT)  # four of its joints are continuous
TWO = BARE.mount("panda", AT).mount("kinova", (-0.1, 0, 0.2, 0)).attach(pm.PayloadBody(1.5, (0, 0, 0.1)))
ROBOTS = pytest.mark.parametrize("robot", [UR5, KINOVA, TWO], ids=["ur5", "kinova", "two arms and a load"])
CIRCLE = pm.Tangent(pm.Circle(1, 0.5, 6))


def rest_of(robot: pm.MobileRobot) -> Array:
    """Return the coordinates of the joints at rest."""
    return robot.rest[3:]


def inward(robot: pm.MobileRobot, way: float) -> list[tuple[Array, Array]]:
    """Return for each arm the coordinates at rest, and those that far from them, away from limits."""
    ends = []
    for mount in robot.mounts:
        start = robot.rest[mount.q]
        room = robot.upper[mount.q] - start
        ends.append((start, start + np.where(way < room, way, -way)))
    return ends


# -- references ------------------------------------------------------------------------------------


@ROBOTS
def test_the_reference_is_the_bases_beside_the_paths(robot: pm.MobileRobot) -> None:
    paths = [pm.Spline([start, via, start], (0, 2.5, 6)) for start, via in inward(robot, 0.03)]
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
    start = rest_of(TWO)[TWO.mounts[1].v.start - 3 :]
    away = pm.CubicVia(start, start + 4 * np.eye(6)[1], start, 0.45, 0.9)
    with refused(r"joint 'kinova/j2s6s200_joint_2' at \d"):
        pm.WholeBody(TWO, pm.Tangent(pm.Circle(1, 0.1, 60)), None, away)


def test_slides_have_their_limits_in_metres_and_a_limit_itself_is_within() -> None:
    panda = BARE.mount("panda", AT)
    rest, finger = rest_of(panda), np.eye(9)[7]
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
