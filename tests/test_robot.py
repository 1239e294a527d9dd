import pickle

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from pinmobile import Coulomb, MobileRobot, Motor, PayloadBody, WheeledRobot, WheelTable
from pinmobile.arrays import Array
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHRow, DHTable, JointType
from tests.refusals import begun

robots = st.builds(
    MobileRobot,
    st.floats(0.1, 1e3),
    st.floats(1e-2, 1e2),
    com=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    dh=st.sampled_from([LECTURE_TABLE, SLIDE_TABLE]),
)


def test_a_force_along_x_accelerates_along_x() -> None:
    """The chain's first joint is y; no public vector shows it."""
    robot = MobileRobot.lecture()
    assert robot.forward_dynamics([0, 0, 0], [0, 0, 0], [30, 0, 0]).tolist() == [1, 0, 0]
    assert robot.frame_placements([5, 7, 0])[-1, :3, 3].tolist() == [5, 7, 0]
    assert robot.model.names[1] == "y"


@given(robots, st.floats(-10, 10), st.integers(0, 2**32 - 1))
def test_dynamics_hold_together(robot: MobileRobot, psi: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, v, a = np.array([1.0, -2.0, psi]), rng.normal(size=3), rng.normal(size=3)
    M, n, tau = robot.mass_matrix(q), robot.nonlinear_effects(q, v), robot.inverse_dynamics(q, v, a)
    # Each term in the sums of `tau` carries a few dozen roundings at the most.
    scale = np.abs(M) @ np.abs(a) + robot.mass * (v @ v) * (1 + np.linalg.norm(robot.com))
    assert (np.abs(M @ a + n - tau) <= 1e-14 * scale).all()
    assert np.abs(M - M.T).max() <= 1e-15 * np.abs(M).max()
    assert np.linalg.eigvalsh(M).min() > 0
    back = robot.forward_dynamics(q, v, tau)
    assert np.linalg.norm(back - a) <= 8 * np.finfo(float).eps * np.linalg.cond(M) * max(np.linalg.norm(a), 1)
    assert (np.abs(robot.coriolis_matrix(q, v) @ v - n) <= 1e-14 * scale).all()
    assert robot.kinetic_energy(q, v) == pytest.approx(v @ M @ v / 2, rel=1e-12)
    assert (np.abs(robot.regressor(q, v, a) @ robot.inertial_parameters - tau) <= 1e-14 * scale).all()


def test_jacobian_turns_the_body_twist_into_velocity() -> None:
    J = MobileRobot.lecture().jacobian([[0, 0, np.pi / 2], [0, 0, 0.3]])
    np.testing.assert_allclose(J[0] @ [1, 0, 0], [0, 1, 0], atol=1e-15)  # forward, facing +y
    np.testing.assert_allclose(J @ J.transpose(0, 2, 1), [np.eye(3)] * 2, atol=1e-15)


def test_derivatives_are_finite_differences(offset_robot: MobileRobot, states: tuple[Array, ...]) -> None:
    q, v, _, tau = states
    q, v, tau = q[:6], v[:6], tau[:6]
    h, f = 1e-6, offset_robot.forward_dynamics
    A, B = offset_robot.linearize(q, v, tau)
    derivatives = A[..., 3:, :3], A[..., 3:, 3:], B[..., 3:, :]
    for k, step in enumerate(np.eye(3) * h):
        numeric = (
            (f(q + step, v, tau) - f(q - step, v, tau)) / (2 * h),
            (f(q, v + step, tau) - f(q, v - step, tau)) / (2 * h),
            (f(q, v, tau + step) - f(q, v, tau - step)) / (2 * h),
        )
        for exact, approximate in zip(derivatives, numeric, strict=True):
            # eps / h = 2e-10 of terms up to about 10.
            np.testing.assert_allclose(exact[..., k], approximate, atol=2e-8)


def test_integrate_and_difference_are_inverse_and_psi_is_compared_on_the_circle() -> None:
    robot = MobileRobot.lecture()
    q = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(robot.difference(q, robot.integrate(q, [0.1, -0.2, 0.3])), [0.1, -0.2, 0.3])
    assert robot.difference([0, 0, 0.1], [0, 0, 2 * np.pi])[2] == pytest.approx(-0.1)
    assert robot.integrate(q, [0, 0, 10])[2] == 13  # unwrapped


def test_gravity_does_not_leak_into_the_level_plane(states: tuple[Array, ...]) -> None:
    """Rounded right angles would tilt the chain by 2e-16 rad: 1e-14 N for a robot that rests."""
    robot = MobileRobot(1000, 50, com=(0.3, -0.2, 0.5))
    assert np.abs(robot.nonlinear_effects(states[0], np.zeros(3))).max() == 0


def test_a_robot_is_a_value() -> None:
    robot = MobileRobot(10, 1.2, com=(0.15, 0.05), size=(1, 2, 3))
    assert eval(repr(robot)) == robot
    assert pickle.loads(pickle.dumps(robot)) == robot
    assert hash(MobileRobot(10, 1.2)) == hash(MobileRobot(10, 1.2, com=(0, 0, 0)))
    assert MobileRobot(10, 1.2) != MobileRobot(10, 1.3)
    assert MobileRobot(10, 1.2) != MobileRobot(10, 1.2, dh=SLIDE_TABLE)
    with pytest.raises(AttributeError):
        robot.mass = 3.0  # type: ignore[misc]


WRONG_CHAIN = DHTable(tuple(DHRow(0, 0, 0, 0, JointType.REVOLUTE, name) for name in "abc"))


def test_impossible_parameters_are_refused() -> None:
    with begun("mass is 0.0 kg, expected > 0"):
        MobileRobot(0, 1)
    with begun("dh has joints revolute a, revolute b, revolute c, expected prismatic y,"):
        MobileRobot(1, 1, dh=WRONG_CHAIN)


def test_nothing_is_lost_far_from_the_origin(offset_robot: MobileRobot) -> None:
    """A map's origin may be thousands of kilometres away, as that of UTM coordinates is."""
    rng, x = np.random.default_rng(3), 1e12
    for robot in (offset_robot, MobileRobot.box().mount("ur5")):
        here = robot.random_configuration(rng)
        here[:2] = 0.0
        far = here + np.eye(robot.nq)[0] * x - np.eye(robot.nq)[1] * x
        v, a = rng.normal(size=(2, robot.nv))
        for name in ("mass_matrix", "gravity", "frame_jacobian", "kinetic_energy", "manipulability"):
            given = (v,) if name == "kinetic_energy" else ()
            method = getattr(robot, name)
            np.testing.assert_array_equal(method(far, *given), method(here, *given), name)
        for name in ("nonlinear_effects", "coriolis_matrix", "frame_bias_acceleration"):
            np.testing.assert_array_equal(getattr(robot, name)(far, v), getattr(robot, name)(here, v), name)
        for name in ("inverse_dynamics", "forward_dynamics", "linearize", "regressor", "ground_wrench"):
            method = getattr(robot, name)
            for found, expected in zip(method(far, v, a), method(here, v, a), strict=True):
                np.testing.assert_array_equal(found, expected, name)
        assert robot.with_locked_arms(far) == robot.with_locked_arms(here)


def test_what_is_handed_out_may_be_written_into_and_nothing_changes() -> None:
    robot = MobileRobot.box().mount("ur5").attach(PayloadBody(1.0, (0, 0, 0.1)))
    again = MobileRobot.box().mount("ur5").attach(PayloadBody(1.0, (0, 0, 0.1)))
    q = robot.rest
    M, pose, drawn = robot.mass_matrix(q), robot.frame_pose(q), robot.visual_model.geometryObjects[0]
    heavy = pin.Inertia(99.0, np.ones(3), np.eye(3))
    arm = robot.mounts[0].arm
    for model in (robot.model, robot.mounts[0].model, arm.model, arm.whole):
        for joint in range(model.njoints):
            model.inertias[joint] = heavy
            model.jointPlacements[joint] = pin.SE3.Random()
        model.gravity = pin.Motion.Zero()
        model.upperPositionLimit = np.zeros(model.nq)
    robot.loads[0].body.mass = 99.0
    items = robot.visual_model.geometryObjects
    items[0].placement, items[0].meshColor = pin.SE3.Random(), np.ones(4)
    items[0].geometry.halfSide = np.ones(3)
    for same in (robot, pickle.loads(pickle.dumps(robot)), MobileRobot.box().mount(arm.whole, name="ur5")):
        carrying = same if same.loads else same.attach(PayloadBody(1.0, (0, 0, 0.1)))
        np.testing.assert_array_equal(carrying.mass_matrix(q), M)
        np.testing.assert_array_equal(carrying.frame_pose(q), pose)
        np.testing.assert_array_equal(carrying.upper, again.upper)
    assert robot == again
    assert hash(robot) == hash(again)
    shown = robot.visual_model.geometryObjects[0]
    assert (shown.placement, shown.meshColor.tolist()) == (drawn.placement, drawn.meshColor.tolist())
    np.testing.assert_array_equal(shown.geometry.halfSide, drawn.geometry.halfSide)
    for array in (robot.rest, robot.upper, robot.velocity_limit, robot.body.com, robot.body.inertia):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 7.0


def test_what_was_given_may_be_written_into_and_nothing_changes() -> None:
    model = pin.buildSampleModelManipulator()
    shown = pin.buildSampleGeometryModelManipulator(model)
    robot = MobileRobot.box().mount(model, rest=np.zeros(6), visual=shown)
    q = robot.rest
    M, colour = robot.mass_matrix(q), robot.visual_model.geometryObjects[-1].meshColor.copy()
    model.inertias[2] = pin.Inertia(99.0, np.ones(3), np.eye(3))
    shown.geometryObjects[len(shown.geometryObjects) - 1].meshColor = np.array([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(robot.mass_matrix(q), M)
    other = pickle.loads(pickle.dumps(robot))
    np.testing.assert_array_equal(other.visual_model.geometryObjects[-1].meshColor, colour)


# -- `print(robot)` --------------------------------------------------------------------------------


MOTOR = Motor(resistance=2, torque_constant=0.5, voltage=24, current=3, source="data sheet")
DRIVE = WheelTable.differential(0.5, 0.1, mass=1.0, spin_inertia=0.01, supports=[(0.3, 0)], motor=MOTOR)


def test_a_body_is_described_with_its_source_and_its_supports() -> None:
    robot = MobileRobot(30.0, 1.3, com=(0.1, 0.05, 0.2))
    text = robot.describe()
    assert str(robot) == text
    assert repr(robot) != text
    for words in ("mass            30 kg", "(0.1, 0.05, 0.2) m", "1.3 kg m^2 about", "x -0.3 to 0.3 m"):
        assert words in text
    assert "made from numbers" in text
    assert text.endswith("stands: its centre of mass is 0.15 m inside the edge of its supports")


@pytest.mark.parametrize(("x", "words"), [(0.3 - 1e-3, "stands: "), (0.31, "cannot stand: ")])
def test_a_robot_with_its_mass_outside_its_supports_cannot_stand(x: float, words: str) -> None:
    last = str(MobileRobot(30.0, 1.3, com=(x, 0, 0.2))).splitlines()[-1]
    assert last.startswith(words)
    wheeled = WheeledRobot(MobileRobot(30.0, 1.3, com=(x, 0, 0.2)), DRIVE, Coulomb(0.8))
    tips = wheeled.contact_loads(wheeled.rest, np.zeros(wheeled.nv), np.zeros(wheeled.nv)).tips
    said = str(wheeled).splitlines()[-1].startswith("cannot stand")
    assert bool(tips) == said  # the balance of loads agrees


@pytest.mark.parametrize(("angle", "words"), [(0.7, "stands: "), (0.8, "cannot stand: ")])
def test_a_ramp_moves_the_point_below_the_centre_of_mass(angle: float, words: str) -> None:
    flat = WheeledRobot(MobileRobot(30.0, 1.3, com=(0.2, 0, 0.2)), DRIVE, Coulomb(0.8))
    robot = flat.on_ramp(angle)  # upwards along x: the point moves back by 0.2 m tan(angle)
    last = str(robot).splitlines()[-1]
    assert last.startswith(words)
    assert last.endswith(" on this ramp, at psi = 0")
    still = np.zeros(robot.nv)
    assert bool(robot.contact_loads(robot.rest, still, still).tips) == (words == "cannot stand: ")


def test_arms_have_the_limits_of_their_files_and_loads_their_masses() -> None:
    robot = MobileRobot(30.0, 1.3).mount("ur5", (0.1, -0.05, 0.2, 0.4))
    robot = robot.attach(PayloadBody(1.5, (0, 0.01, 0.05), size=(0.1, 0.1, 0.1)))
    text = str(robot)
    elbow = next(line for line in text.splitlines() if "elbow" in line).split()
    k = [one.name for one in robot.coordinates].index("ur5/elbow_joint")
    assert elbow[1] == f"+-{robot.upper[k]:.4g}"
    assert elbow[3] == f"+-{robot.velocity_limit[k]:.4g}"
    assert elbow[5] == f"+-{robot.effort_limit[k]:.4g}"
    assert "load on ur5/tool0: 1.5 kg" in text
    assert f"whole robot: {robot.with_locked_arms().mass:.4g} kg" in text
    assert "numbers of arms: from their files or models\n  ur5: right angles" in text


def test_wheels_have_motors_with_stall_torque_and_top_speed() -> None:
    robot = WheeledRobot(MobileRobot(30.0, 1.3, com=(0.1, 0, 0.2)), DRIVE)
    for plant in (robot, robot.by_voltage()):
        assert str(plant) == robot.describe()
    row = next(line for line in str(robot).splitlines() if line.startswith("  left") and "data sheet" in line)
    rate = 24 / 0.5  # the voltage over the torque constant [rad/s]
    assert row.split() == f"left 1.5 N m {rate:g} rad/s, {0.1 * rate:g} m/s 24 V 3 A data sheet".split()
    assert "supports        3 corners" in str(robot)
    car = WheelTable.car(0.5, 0.4, 0.1, spin_inertia=0.01, yaw_inertia=0.01, steering_limit=0.6)
    assert "+-0.6 rad" in str(WheeledRobot(MobileRobot(30.0, 1.3), car))
