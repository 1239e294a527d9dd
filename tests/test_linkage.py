"""Robots over scalars, many states and symbols: against Pinocchio, for robots that mount and random trees."""

import pickle
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pinmobile import InvalidArgument, MobileRobot, PayloadBody, vectorize, verify
from pinmobile.arrays import Array
from pinmobile.compiled.functions import tracing
from pinmobile.compiled.symbolic import Symbols, entries, symbols
from pinmobile.compiled.tape import Node, Tape, evaluate
from pinmobile.errors import NotFinite, NotTraceable
from pinmobile.parts import numbers, replace
from pinmobile.urdf import Body

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


def assert_agrees(robot: MobileRobot, states: int = 2) -> None:
    """Compare all that is computed twice, for several states at once."""
    body: Any = robot.array_dynamics
    rng = np.random.default_rng(5)
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


# -- functions of one state, evaluated over leading axes by machine code ---------------------------


COUNT = 103  # states; the last do not fill a vector
FEW = 6  # states that Pinocchio is asked for
LOAD = PayloadBody(1.5, (0.1, 0, 0.2), size=(0.1, 0.2, 0.3))
# Its body has products of inertia, and its centre of mass is off the axis: the ground feels both.
FULL = Body(
    30.0, np.array([0.1, -0.05, 0.2]), np.array([[1.0, 0.1, 0.2], [0.1, 1.2, -0.1], [0.2, -0.1, 1.5]])
)
ROBOTS = {
    "bare": MobileRobot.from_body(FULL),
    "ur5": MobileRobot.from_body(FULL).mount("ur5", AT).attach(LOAD),
    "tree": MobileRobot(30.0, 1.1, com=(0.1, -0.05, 0.2)).mount(arm_of(1, 6), AT),  # all kinds, with rotors
}
RNG = np.random.default_rng(8)


def states(robot: MobileRobot, count: int = COUNT) -> tuple[Array, ...]:
    rng = np.random.default_rng(3)
    return robot.random_configuration(rng, (count,)), *rng.normal(size=(2, count, robot.nv))


def asked(robot: MobileRobot) -> dict[str, tuple[Any, ...]]:
    """Return what each method takes of q, v, a, and what else."""
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
        "frame_bias_acceleration": ("qv", robot.end_effector),
        "manipulability": ("q",),
        **arms,
    }


@pytest.mark.long
@pytest.mark.once
@pytest.mark.parametrize("name", ["bare", "tree"])
def test_many_states_are_as_pinocchio_has_them_one_after_another(name: str) -> None:
    robot = ROBOTS[name]
    q, v, a = states(robot)
    given = {"q": q, "v": v, "a": a}
    chosen = np.r_[:FEW, COUNT - 2 : COUNT]
    for method, (letters, *options) in asked(robot).items():
        own, arguments = getattr(robot, method), [given[letter] for letter in letters]
        many = vectorize(own, keep=False)(*arguments, *options)
        few = own(*(x[chosen] for x in arguments), *options)
        assert many.shape == (len(q), *few.shape[1:]), method
        assert np.abs(many[chosen] - few).max() <= CLOSE * (1e-3 + np.abs(few).max()), method


def test_a_state_has_the_same_bits_with_any_others(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = ROBOTS["ur5"]
    q, v, a = states(robot)
    law = vectorize(robot.inverse_dynamics, keep=False)
    many = law(q, v, a)
    np.testing.assert_array_equal(many[2:], law(q[2:], v[2:], a[2:]))
    np.testing.assert_array_equal(many[0], law(q[0], v[0], a[0]))
    monkeypatch.setattr(sys.modules[vectorize.__module__], "_STATES", 40)
    np.testing.assert_array_equal(many, law(q, v, a))


def test_leading_axes_broadcast() -> None:
    robot = ROBOTS["ur5"]
    q, v, a = states(robot)
    law = vectorize(robot.inverse_dynamics, keep=False)
    ahead = law(q[:2, None], v, a[0])
    assert ahead.shape == (2, COUNT, robot.nv)
    flat = (np.repeat(q[:2], COUNT, axis=0), np.tile(v, (2, 1)), np.tile(a[:1], (2 * COUNT, 1)))
    np.testing.assert_array_equal(ahead.reshape(-1, robot.nv), law(*flat))
    M = vectorize(robot.mass_matrix, keep=False)
    # Rows that do not lie one after the other are read where they are meant.
    np.testing.assert_array_equal(M(q[::-1]), M(np.ascontiguousarray(q[::-1])))
    assert M(np.empty((0, 7, robot.nq))).shape == (0, 7, robot.nv, robot.nv)


def test_several_arrays_of_any_axes_come_back() -> None:
    def law(a: Any, x: Any) -> Any:
        return a @ x, x > 0, np.linalg.norm(x), np.zeros(0), 3.0

    a, x = RNG.normal(size=(4, 1, 2, 3)), RNG.normal(size=(5, 3))
    product, positive, norm, nothing, three = vectorize(law, axes=(2, 1), keep=False)(a, x)
    np.testing.assert_allclose(product, (a @ x[..., None])[..., 0], rtol=1e-13, atol=1e-14)
    np.testing.assert_array_equal(positive, np.broadcast_to(x > 0, (4, 5, 3)))
    np.testing.assert_allclose(norm, np.broadcast_to(np.linalg.norm(x, axis=-1), (4, 5)))
    assert nothing.shape == (4, 5, 0)
    np.testing.assert_array_equal(three, np.full((4, 5), 3.0))
    times = vectorize(lambda t, x: np.sin(t) * x, axes=(0, 1), keep=False)(np.arange(5.0), x)
    np.testing.assert_allclose(times, np.sin(np.arange(5.0))[:, None] * x, rtol=1e-12, atol=1e-14)


def test_what_is_refused() -> None:
    robot = ROBOTS["ur5"]
    q, v, _ = states(robot)
    with pytest.raises(InvalidArgument, match="function is 3, expected a function of one state"):
        vectorize(3)  # type: ignore[arg-type]
    law = vectorize(robot.nonlinear_effects, keep=False)
    with pytest.raises(
        InvalidArgument, match=r"leading shapes are argument 1 \(103,\), argument 2 \(102,\), expected"
    ):
        law(q, v[:-1])
    wrong = v.copy()
    wrong[7, 2] = np.nan
    with pytest.raises(InvalidArgument, match=r"^argument 2\[7, 2\] is nan, expected a finite number$"):
        law(q, wrong)
    wrong[7] = 1e200
    with pytest.raises(NotFinite, match=r"\|argument 2\| up to 1e\+200: a number exceeds 1\.8e308"):
        law(q, wrong)
    with pytest.raises(InvalidArgument, match=r"arguments have shapes \[\(\)\], expected axes = 1"):
        law(3.0)
    with pytest.raises(InvalidArgument, match=r"q has shape \(8,\), expected \(\.\.\., 9\)"):
        law(q[:, :-1], v)


def test_what_cannot_be_compiled_says_why() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "screw")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.ones(3), np.eye(3)), pin.SE3.Identity())
    screw = MobileRobot.box().mount(model, AT)
    words = "joint 'arm/screw' is a JointModelHX, neither revolute nor prismatic"
    with pytest.raises(NotTraceable, match=words):
        _ = screw.array_dynamics
    with pytest.raises(NotTraceable, match=words):
        vectorize(screw.mass_matrix)(np.zeros((5, 4)))
    with pytest.raises(NotTraceable, match="frame 'x', which is on a virtual link of the chain"):
        vectorize(ROBOTS["bare"].frame_pose)(np.zeros((5, 3)), "x")
    with pytest.raises(NotTraceable, match="linearize of a MobileRobot"):
        vectorize(ROBOTS["bare"].linearize)(*np.zeros((3, 5, 3)))


def test_kinetic_energy_knows_motors_on_axes_of_their_own() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRevoluteUnaligned(1.0, -2.0, 0.5), pin.SE3.Identity(), "j")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.armature = np.array([0.3])
    robot = MobileRobot.box().mount(model)
    v = np.array([0, 0, 0, 2.0])
    assert robot.kinetic_energy(robot.rest, v) == pytest.approx(2.6, rel=1e-12)
    assert vectorize(robot.kinetic_energy)(robot.rest[None], v)[0] == pytest.approx(2.6, rel=1e-12)


# -- robots whose numbers are symbols --------------------------------------------------------------


SYMBOLIC = {
    "bare": MobileRobot(30.0, 1.1, com=(0.1, -0.05, 0.2)),
    "loaded": MobileRobot(30.0, 1.1, com=(0.1, -0.05, 0.2)).attach(LOAD).attach(PayloadBody(2.0)),
    "ur5": MobileRobot.box().mount("ur5", AT).attach(LOAD).attach(PayloadBody(2.0), "base_link"),
    "two": MobileRobot.box().mount("kinova", AT).mount("ur3", (-0.2, 0, 0.2, 0), name="left"),
}


class Traced:
    """A robot whose numbers are symbols of a tape, and numbers to put in their place."""

    def __init__(self, robot: MobileRobot, *, growth: float = 0.02, zeros: bool = False) -> None:
        self.tape, self.inputs = Tape(10**6), dict[Any, float]()
        changes: dict[str, Any] = {}
        given: dict[str, Any] = {}
        for path, leaf in numbers(robot).items():
            value = np.asarray(leaf.value, np.float64)
            new = value * (1 + growth)
            given[path] = new
            changes[path] = self._symbols(new, zeros)
        self.robot = replace(robot, changes, nominal=True)
        self.other = replace(robot, given)

    def _symbols(self, value: Array, zeros: bool = True) -> Symbols:
        nodes: list[Any] = []
        for x in value.ravel():
            if not x and not zeros:
                nodes.append(0.0)
            else:
                nodes.append(self.tape.input("state", len(self.inputs)))
                self.inputs["state", len(self.inputs)] = float(x)
        return symbols(nodes, value.shape)

    def state(self, *arrays: Array) -> list[Any]:
        return [self._symbols(x) for x in arrays]

    def answer(self, function: Callable[..., Any], *given: Any) -> Array:
        """Return what a function of symbols gives for the numbers."""

        def law() -> Any:
            return function(*given)

        with tracing():
            found = law()
        table = np.asarray(entries(found), object)
        nodes = [x if type(x) is Node else self.tape.const(float(x)) for x in table.ravel()]
        values = evaluate(self.tape, [x.index for x in nodes], self.inputs)
        return np.array(values, float).reshape(table.shape)


@pytest.mark.parametrize(("name", "zeros"), [("loaded", True), ("ur5", True), ("two", False)])
def test_dynamics_on_symbols_are_those_of_the_robot_with_such_numbers(name: str, zeros: bool) -> None:
    traced = Traced(SYMBOLIC[name], zeros=zeros)
    rng, other = np.random.default_rng(5), traced.other
    v, a = rng.normal(size=(2, other.nv))
    given = {"q": other.random_configuration(rng), "v": v, "a": a}
    on_tape = dict(zip(given, traced.state(*given.values()), strict=True))
    methods = asked(traced.other) | {"coriolis_matrix": ("qv",), "integrate": ("qv",), "difference": ("qv",)}
    for method, (letters, *options) in (methods | {"pose": ("q",), "pose_rate": ("qv",)}).items():
        expected = getattr(traced.other, method)(*(given[x] for x in letters), *options)
        found = traced.answer(getattr(traced.robot, method), *(on_tape[x] for x in letters), *options)
        assert found.shape == np.shape(expected), method
        assert np.abs(found - expected).max() < 1e-9 * (1e-2 + np.abs(expected).max()), method
