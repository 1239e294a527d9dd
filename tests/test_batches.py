"""Many states at once, compiled: against one state after another by Pinocchio."""

import copy
import pickle
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pinmobile import InvalidArgument, Load, MobileRobot, NotFinite, arrays
from pinmobile.arrays import Array
from pinmobile.balance import Motion, reaction_wrench, tip_over_margin, zero_moment_point
from pinmobile.compiled import batched
from pinmobile.robot import pinocchio_calls
from pinmobile.robot.mounts import LinkNumbers
from pinmobile.robot.pinocchio_calls import MANY
from pinmobile.robot.system import System
from pinmobile.urdf import Body
from tests.test_linkage import AT, arm_of

CLOSE = 1e-10  # of the largest number; forward dynamics lose the digits of M's condition
FEW = 12  # states that Pinocchio is asked for one after another
LOAD = Load(1.5, (0.1, 0, 0.2), size=(0.1, 0.2, 0.3))
# Its body has products of inertia, and its centre of mass is off the axis: the ground feels both.
FULL = Body(
    30.0, np.array([0.1, -0.05, 0.2]), np.array([[1.0, 0.1, 0.2], [0.1, 1.2, -0.1], [0.2, -0.1, 1.5]])
)
ROBOTS = {
    "bare": MobileRobot.from_body(FULL),
    "loaded": MobileRobot.from_body(FULL).attach(LOAD),
    "ur5": MobileRobot.from_body(FULL).mount("ur5", AT).attach(LOAD),
    "kinova": MobileRobot.box().mount("kinova"),  # four of its joints are continuous
    "two": MobileRobot.box().mount("panda", AT).mount("ur3", (-0.2, 0, 0.2, 0), name="left"),
    "tree": MobileRobot(30.0, 1.1, com=(0.1, -0.05, 0.2)).mount(arm_of(1, 6), AT),  # all kinds, with rotors
}
NAMES = pytest.mark.parametrize("name", ROBOTS)


def states(robot: MobileRobot, count: int = MANY + 3) -> tuple[Array, ...]:
    rng = np.random.default_rng(3)
    return robot.random_configuration(rng, (count,)), *rng.normal(size=(2, count, robot.nv))


def asked(robot: MobileRobot) -> dict[str, tuple[Any, ...]]:
    """Return what is compiled: for each method what it takes of q, v, a, and what else."""
    arms = {"mount_wrench": ("qva",), "arm_manipulability": ("q",)} if robot.mounts else {}
    return {
        "mass_matrix": ("q",),
        "nonlinear_effects": ("qv",),
        "inverse_dynamics": ("qva",),
        "forward_dynamics": ("qva",),
        "gravity": ("q",),
        "kinetic_energy": ("qv",),
        "potential_energy": ("q",),
        "regressor": ("qva",),
        "ground_wrench": ("qva",),
        "frame_pose": ("q", "base_link"),
        "frame_jacobian": ("q", robot.end_effector),
        "frame_drift": ("qv", robot.end_effector),
        "manipulability": ("q",),
        **arms,
    }


@NAMES
def test_many_states_are_as_pinocchio_has_them_one_after_another(name: str) -> None:
    robot = ROBOTS[name]
    q, v, a = states(robot)
    given = {"q": q, "v": v, "a": a, "w": q[::-1]}
    chosen = np.r_[:FEW, MANY : MANY + 3]  # the last do not fill a vector
    for method, (letters, *options) in asked(robot).items():
        arguments = [given[letter] for letter in letters]
        many = getattr(robot, method)(*arguments, *options)
        few = getattr(robot, method)(*(x[chosen] for x in arguments), *options)
        assert many.shape == (len(q), *few.shape[1:]), method
        apart = np.abs(many[chosen] - few).max()
        assert apart <= CLOSE * (1e-3 + np.abs(few).max()), method


@pytest.fixture(scope="module")
def ur5() -> tuple[MobileRobot, tuple[Array, ...]]:
    return ROBOTS["ur5"], states(ROBOTS["ur5"])


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Tell of each program that is built whether it could be."""
    found: list[bool] = []

    def made(*given: Any) -> Any:
        program = real(*given)
        found.append(program is not None)
        return program

    real = pinocchio_calls._made
    monkeypatch.setattr(pinocchio_calls, "_known", OrderedDict())
    monkeypatch.setattr(pinocchio_calls, "_made", made)
    return found


def test_a_state_has_the_same_bits_with_any_others_and_on_any_threads(
    ur5: tuple[MobileRobot, tuple[Array, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, (q, v, a) = ur5
    many = robot.inverse_dynamics(q, v, a)
    np.testing.assert_array_equal(many[2:], robot.inverse_dynamics(q[2:], v[2:], a[2:]))
    more = [np.concatenate([x, x]) for x in (q, v, a)]
    monkeypatch.setattr(batched, "_WORTH", 1.0)  # a thread for each processor, however little there is to do
    for count in (1, 3):
        monkeypatch.setattr(pinocchio_calls, "processors", lambda count=count: count)
        np.testing.assert_array_equal(robot.inverse_dynamics(*more)[-len(q) :], many)


def test_leading_axes_broadcast(ur5: tuple[MobileRobot, tuple[Array, ...]]) -> None:
    robot, (q, v, a) = ur5
    ahead = robot.inverse_dynamics(q[:2, None], v[:MANY], a[0])
    assert ahead.shape == (2, MANY, robot.nv)
    flat = (np.repeat(q[:2], MANY, axis=0), np.tile(v[:MANY], (2, 1)), np.tile(a[:1], (2 * MANY, 1)))
    np.testing.assert_array_equal(ahead.reshape(-1, robot.nv), robot.inverse_dynamics(*flat))
    # Rows that do not lie one after the other are read where they are meant.
    np.testing.assert_array_equal(
        robot.mass_matrix(q[::-1]), robot.mass_matrix(np.ascontiguousarray(q[::-1]))
    )
    assert robot.mass_matrix(np.empty((0, MANY, robot.nq))).shape == (0, MANY, robot.nv, robot.nv)


def test_what_is_refused_of_few_is_refused_of_many(ur5: tuple[MobileRobot, tuple[Array, ...]]) -> None:
    robot, (q, v, a) = ur5
    with pytest.raises(InvalidArgument, match=r"^q has shape \(503, 8\), expected \(\.\.\., 9\)$"):
        robot.mass_matrix(q[:, :-1])
    with pytest.raises(InvalidArgument, match="expected leading axes that broadcast"):
        robot.nonlinear_effects(q, v[:-1])
    wrong = v.copy()
    wrong[7, 2] = np.nan
    with pytest.raises(InvalidArgument, match=r"^v\[7, 2\] is nan, expected a finite number$"):
        robot.nonlinear_effects(q, wrong)
    wrong[7] = 1e200
    with pytest.raises(NotFinite, match=r"\|v\| up to 1e\+200, made of numbers beyond 1\.8e308"):
        robot.nonlinear_effects(q, wrong)
    # Squares that overflow are no answers that do.
    a = np.where(np.arange(len(a))[:, None] == 5, 1e160, a)
    np.testing.assert_allclose(
        robot.inverse_dynamics(q, v, a)[5], robot.inverse_dynamics(q[5], v[5], a[5]), rtol=1e-10, atol=1e150
    )


def test_more_than_memory_holds_is_refused(
    ur5: tuple[MobileRobot, tuple[Array, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, (q, _, _) = ur5
    monkeypatch.setattr(arrays, "MEMORY", 1e5)
    with pytest.raises(
        InvalidArgument, match=r"^mass_matrix of 503 states take 0\.00033 GB, expected at most"
    ):
        robot.mass_matrix(q)


def test_angles_beyond_many_turns_keep_their_digits(ur5: tuple[MobileRobot, tuple[Array, ...]]) -> None:
    robot, (q, v, _) = ur5
    far = q.copy()
    far[4, 2:] += 3e8
    before = far.copy()
    effects = robot.nonlinear_effects(far, v)
    np.testing.assert_allclose(effects[4], robot.nonlinear_effects(far[4], v[4]), rtol=1e-10, atol=1e-9)
    np.testing.assert_array_equal(far, before)
    np.testing.assert_array_equal(effects[5:], robot.nonlinear_effects(q, v)[5:])


def test_robots_with_other_numbers_share_what_is_compiled(built: list[bool]) -> None:
    robot = ROBOTS["ur5"]
    q, v, a = states(robot, MANY)
    robot.forward_dynamics(q, v, a)
    assert built == [True]
    other = robot.with_parameters(
        **{
            "mass": 31.0,
            "com_x": 0.3,
            "mass_ur5/forearm_link": 4.0,
            "load_mass": 2.0,
            "at_x_ur5": 0.3,
            "at_yaw_ur5": 2.0,
        },
        inertias=1.1 * LinkNumbers.of(robot.mounts[0].arm.model).inertias.ravel(),
    )
    accelerations = other.forward_dynamics(q, v, a)
    np.testing.assert_allclose(accelerations[3], other.forward_dynamics(q[3], v[3], a[3]), rtol=1e-9)
    assert np.abs(accelerations - robot.forward_dynamics(q, v, a)).max() > 1
    pickle.loads(pickle.dumps(robot)).forward_dynamics(q, v, a)
    copy.deepcopy(robot).forward_dynamics(q, v, a)
    assert built == [True]
    robot.with_parameters(**{"rotor_ur5/elbow_joint": 0.1}).forward_dynamics(q, v, a)  # it was zero
    robot.attach(LOAD).forward_dynamics(q, v, a)
    assert built == [True] * 3


def test_what_cannot_be_compiled_stays_with_pinocchio(
    built: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "screw")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.ones(3), np.eye(3)), pin.SE3.Identity())
    screw = MobileRobot.box().mount(model, AT)
    q, v, _ = states(screw, MANY)
    np.testing.assert_array_equal(screw.nonlinear_effects(q, v)[7], screw.nonlinear_effects(q[7], v[7]))
    robot = ROBOTS["bare"]
    q, _, _ = states(robot, MANY)
    for frame in ("x", "y"):  # of links that move with a part of the pose
        np.testing.assert_array_equal(robot.frame_pose(q, frame)[7], robot.frame_pose(q[7], frame))
    assert built == []
    monkeypatch.setattr(pinocchio_calls, "_LARGEST", 10)
    np.testing.assert_array_equal(robot.mass_matrix(q)[7], robot.mass_matrix(q[7]))
    robot.mass_matrix(q)
    assert built == [False]  # and is not tried again


def test_threads_share_it() -> None:
    robot = ROBOTS["loaded"]
    q, v, _ = states(robot)
    expected = robot.nonlinear_effects(q, v)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: robot.nonlinear_effects(q, v), range(16)):
            np.testing.assert_array_equal(found, expected)


def test_balance_of_many_states_is_that_of_each(ur5: tuple[MobileRobot, tuple[Array, ...]]) -> None:
    robot, (q, v, a) = ur5
    many = Motion(robot, q, v, a)
    for function in (zero_moment_point, tip_over_margin, reaction_wrench):
        expected = function(Motion(robot, q[:FEW], v[:FEW], a[:FEW]))
        np.testing.assert_allclose(function(many)[:FEW], expected, rtol=1e-9, atol=1e-9)


def test_a_direction_that_is_lost_has_no_volume() -> None:
    robot = MobileRobot.box().mount("ur5")
    q = np.zeros((MANY, robot.nq))  # the wrist's two axes and the arm are in line
    q[1:] = states(robot, MANY - 1)[0]
    volumes = robot.arm_manipulability(q)
    assert 0 <= volumes[0] < 1e-12
    assert volumes[1:].max() > 0.01


def test_kinetic_energy_knows_motors_on_axes_of_their_own() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRevoluteUnaligned(1.0, -2.0, 0.5), pin.SE3.Identity(), "j")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.armature = np.array([0.3])
    robot = MobileRobot.box().mount(model)
    v = np.array([0, 0, 0, 2.0])
    assert robot.kinetic_energy(robot.rest, v) == pytest.approx(2.6, rel=1e-12)


def test_what_is_told_of_the_limits_is_what_holds() -> None:
    told, readme = System.__doc__ or "", (Path(__file__).parents[1] / "README.md").read_text()
    assert f"From {pinocchio_calls.MANY} states" in told
    assert f"more than {pinocchio_calls._LARGEST:,} operations" in told
    assert f"compiled for {pinocchio_calls.MANY} states and more" in readme
