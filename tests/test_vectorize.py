"""Functions of one state, evaluated over leading axes by machine code: against one state after another."""

import sys
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pinmobile import InvalidArgument, MobileRobot, PayloadBody, vectorize
from pinmobile.arrays import Array
from pinmobile.errors import NotFinite, NotTraceable
from pinmobile.urdf import Body
from tests.test_linkage import AT, arm_of

CLOSE = 1e-10  # of the largest number; forward dynamics lose the digits of M's condition
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
    with pytest.raises(NotTraceable, match="'arm/screw' is a JointModelHX"):
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
