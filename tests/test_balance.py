"""What the base feels: against mechanics that needs no RNEA, and against formulas by hand."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.balance import (
    MotionStates,
    body_zero_moment_point,
    reaction_wrench,
    required_friction,
    tip_over_margin,
    zero_moment_point,
)
from pinmobile.errors import UnknownName
from pinmobile.robot import BODY_JOINT
from pinmobile.robot.support_geometry import margin_inside
from tests.users import Follower, TwoWheels

G = 9.81
AT = (0.1, -0.05, 0.2, 0.4)
BOX = pm.MobileRobot.box()
UR5 = BOX.mount("ur5", AT).attach(pm.PayloadBody(2.0, (0.02, 0, 0.1)))
TWO = (
    BOX.mount("panda", AT).mount("kinova", (-0.1, 0.1, 0.2, -1.0)).attach(pm.PayloadBody(1.5, (0, 0.1, 0.1)))
)
HEIGHT = 0.1  # of the box's centre of mass [m]


def motion(robot: pm.MobileRobot, count: int = 6) -> MotionStates:
    rng = np.random.default_rng(11)
    v, a = rng.normal(size=(2, count, robot.nv))
    return MotionStates(robot, robot.random_configuration(rng, (count,)), v, a)


def planar(a: Any, v: Any = (0, 0, 0), psi: float = 0.7, robot: pm.MobileRobot = BOX) -> MotionStates:
    return MotionStates(robot, (1.0, 2.0, psi), v, a)


def momentum_rate(moving: Any, inertias: dict[int, pin.Inertia]) -> Array:
    """Return force and moment about the world's origin that bodies on joints need, from their poses alone.

    With p = T r of a body's points, the sums over its mass of p'' and p x p'' are in T'' J T', where J is the
    sum of r r' (4 x 4): differences of poses in time are all that is needed.
    """
    robot, h = moving.plant, 2e-3

    def poses(t: float) -> Array:
        displacement = t * moving.v + 0.5 * t * t * moving.a
        return np.asarray(robot.frame_placements(robot.integrate(moving.q, displacement)))

    stencil = ((-2, -1), (-1, 16), (0, -30), (1, 16), (2, -1))
    second = np.sum([weight * poses(k * h) for k, weight in stencil], axis=0) / (12 * h * h)
    second[..., 2, 3] += G
    T, total = poses(0.0), np.zeros((*np.shape(moving.q)[:-1], 4, 4))
    for joint, body in inertias.items():
        J = np.array(pin.PseudoInertia.FromInertia(body).toMatrix())
        total += second[..., joint - 1, :, :] @ J @ np.swapaxes(T[..., joint - 1, :, :], -1, -2)
    turned = [total[..., k, j] - total[..., j, k] for j, k in ((1, 2), (2, 0), (0, 1))]
    return np.concatenate([total[..., :3, 3], np.stack(turned, -1)], -1)


def seen_from(wrench: Array, moving: Any, point: Array) -> Array:
    """Return a wrench about the world's origin about a point of the body, along the body's axes."""
    T = moving.plant.frame_placements(moving.q)[..., BODY_JOINT - 1, :, :]
    origin = T[..., :3, :3] @ point + T[..., :3, 3]
    moment = wrench[..., 3:] - np.cross(origin, wrench[..., :3])
    return np.concatenate([part[..., None, :] @ T[..., :3, :3] for part in (wrench[..., :3], moment)], -1)[
        ..., 0, :
    ]


# Fourth-order differences with h = 2 ms: truncated to 1e-10, rounded to eps / h^2 = 6e-11, times 100 kg.
DIFFERENCES: dict[str, Any] = {"rtol": 1e-6, "atol": 1e-6}


def test_the_arms_reaction_is_its_weight_less_the_rate_of_its_momentum() -> None:
    moving, model = motion(TWO), TWO.model
    for mount in TWO.mounts:
        bodies = {joint: model.inertias[joint] for joint in range(mount.joints.start, mount.joints.stop)}
        bodies[BODY_JOINT] = mount.placement.act(mount.model.inertias[0])
        expected = -seen_from(momentum_rate(moving, bodies), moving, np.array(mount.at[:3]))
        np.testing.assert_allclose(reaction_wrench(moving, mount.name), expected, **DIFFERENCES)


@pytest.mark.parametrize("robot", [BOX, TWO], ids=["box", "two arms"])
def test_the_grounds_wrench_is_the_rate_of_all_momentum(robot: pm.MobileRobot) -> None:
    moving, model = motion(robot), robot.model
    bodies = {joint: model.inertias[joint] for joint in range(BODY_JOINT, model.njoints)}
    expected = seen_from(momentum_rate(moving, bodies), moving, np.zeros(3))
    wrench = robot.ground_wrench(moving.q, moving.v, moving.a)
    np.testing.assert_allclose(wrench, expected, **DIFFERENCES)
    # And its part in the plane is the generalised force of the base.
    tau = robot.inverse_dynamics(moving.q, moving.v, moving.a)
    cos, sin = np.cos(np.asarray(moving.q)[:, 2]), np.sin(np.asarray(moving.q)[:, 2])
    np.testing.assert_allclose(cos * wrench[:, 0] - sin * wrench[:, 1], tau[:, 0], atol=1e-10)
    np.testing.assert_allclose(wrench[:, 5], tau[:, 2], atol=1e-10)


def test_acceleration_shifts_it_back_by_h_a_over_g() -> None:
    a = np.array([[1.5, 0, 0], [0, -2.0, 0], [0, 0, 3.0]])
    np.testing.assert_allclose(zero_moment_point(planar(a)), [1, 2] - HEIGHT * a[:, :2] / G, atol=1e-15)
    np.testing.assert_allclose(required_friction(planar(a)), np.hypot(*a[:, :2].T) / G, atol=1e-15)


def test_the_margin_is_zero_where_the_body_begins_to_tip() -> None:
    # Braking so hard that gravity and inertia point at the front edge: a / g = (l / 2) / h.
    for share, sign in ((0.99, 1), (1.01, -1)):
        margin = tip_over_margin(planar((-share * G * 0.3 / HEIGHT, 0, 0), psi=0.0))
        assert np.sign(margin) == sign
        assert abs(margin) == pytest.approx(0.003, rel=1e-9)


def lifting(upwards: float) -> MotionStates:
    """Return a robot with a heavy load at the tip of its arm, which accelerates upwards."""
    robot = BOX.mount("ur5", AT).attach(pm.PayloadBody(300.0))
    q = robot.rest
    a = np.zeros(9)
    a[3:] = np.linalg.lstsq(robot.frame_jacobian(q)[:3, 3:], [0, 0, upwards], rcond=None)[0]
    return MotionStates(robot, q, np.zeros(9), a)


def test_where_the_ground_would_have_to_pull_the_answers_say_so() -> None:
    held, pulled = lifting(-5.0), lifting(-20.0)
    assert np.isfinite(zero_moment_point(held)).all()
    assert np.isnan(zero_moment_point(pulled)).all()
    assert tip_over_margin(pulled) == -np.inf
    assert required_friction(pulled) == np.inf


SQUARE = ((0, 0), (2, 0), (2, 2), (0, 2))


@pytest.mark.parametrize("corners", [SQUARE, SQUARE[::-1], (*SQUARE[:2], (2, 1), *SQUARE[2:])])
def test_the_distance_from_the_edge_is_signed_and_to_the_corner_outside(corners: Any) -> None:
    moving = MotionStates(BOX, np.zeros(3), np.zeros(3), np.zeros(3))  # its point is the origin: a corner
    assert tip_over_margin(moving, corners) == pytest.approx(0, abs=1e-15)
    points = np.array([[1, 1], [1, 0.25], [5, 6], [1, -3], [np.nan, 0]])
    margin = margin_inside(np.array(SQUARE, dtype=float), points)
    np.testing.assert_allclose(margin, [1, 0.25, -5, -3, np.nan], atol=1e-15)
    outside = margin_inside(np.array(SQUARE, dtype=float), np.array([[1, -1e-15], [1, -1e-6]]))
    assert outside[0] >= 0 > outside[1]  # rounding is no edge passed


def test_a_footprint_is_in_the_bodys_frame() -> None:
    moving = MotionStates(BOX, (5.0, 6.0, np.pi / 2), np.zeros(3), np.zeros(3))
    assert tip_over_margin(moving, [(-0.1, -1), (0.7, -1), (0.7, 1), (-0.1, 1)]) == pytest.approx(0.1)


def test_a_footprint_that_is_not_convex_is_refused() -> None:
    with pytest.raises(pm.InvalidArgument, match=r"footprint is not convex at the corner \[0.5, 0.5\]"):
        tip_over_margin(planar((0, 0, 0)), [(0, 0), (2, 0), (0.5, 0.5), (0, 2)])


class Standing(TwoWheels):
    """Two wheels and a castor that tell what the ground bears, the centre of mass 0.3 m above it."""

    footprint = np.array([(-0.3, 0.0), (0.1, -0.2), (0.1, 0.2)])

    def pose(self, q: Array) -> Array:
        return q[..., :3]

    def ground_wrench(self, q: Array, v: Array, a: Array) -> Array:
        psi = q[..., 2]
        ahead = self.mass * (np.cos(psi) * a[..., 0] + np.sin(psi) * a[..., 1])
        left = self.mass * (np.cos(psi) * a[..., 1] - np.sin(psi) * a[..., 0])
        weight = np.full_like(ahead, self.mass * G)
        turning = self.yaw_inertia * a[..., 2]
        return np.stack([ahead, left, weight, -0.3 * left, 0.3 * ahead, turning], axis=-1)


def test_a_plant_of_ones_own_that_tells_what_the_ground_bears_stands_or_tips() -> None:
    path = pm.Tangent(pm.Circle(2, 0.25, 2))
    run = pm.simulate(Standing(), Follower(), path, dt=0.02, integrator=pm.rk4)
    inward = run.a[:, 1] * np.cos(run.q[:, 2]) - run.a[:, 0] * np.sin(run.q[:, 2])
    ahead = run.a[:, 0] * np.cos(run.q[:, 2]) + run.a[:, 1] * np.sin(run.q[:, 2])
    point = np.stack([-0.3 * ahead / G, -0.3 * inward / G], axis=-1)
    np.testing.assert_allclose(body_zero_moment_point(run), point, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(tip_over_margin(run), margin_inside(Standing.footprint, point))
    np.testing.assert_allclose(required_friction(run), np.hypot(ahead, inward) / G, rtol=0, atol=1e-13)
    with pytest.raises(pm.InvalidArgument, match="does not compute the wrench of an arm"):
        reaction_wrench(run)
    plant: Any = run.plant
    plant.footprint = Standing.footprint[::-1]  # clockwise
    np.testing.assert_array_equal(tip_over_margin(run), margin_inside(Standing.footprint, point))
    plant.ground_wrench = lambda q, v, a: np.zeros(3)
    with pytest.raises(pm.InvalidArgument, match=r"(?s)ground_wrench of motion.plant.*has shape"):
        required_friction(run)


def test_what_has_no_arm_is_refused() -> None:
    with pytest.raises(UnknownName, match="unknown mount 'arm', available: ur5"):
        reaction_wrench(MotionStates(UR5, UR5.rest, np.zeros(UR5.nv), np.zeros(UR5.nv)), "arm")
    with pytest.raises(pm.InvalidArgument, match="robot carries no arm, expected a robot with one"):
        reaction_wrench(planar((0, 0, 0)))
