from math import pi
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import ImmutableMatrix, Symbol, symbols

from pinmobile import InvalidArgument, MobileRobot, Motor, WheeledRobot, WheelTable, closed_form
from pinmobile.arrays import Array
from pinmobile.derivation import ReducedDerivation, RollerWheel, car, differential_drive, roller_drive
from tests.test_derivation import is_zero

BODY: dict[str, Any] = {"mass": 10.0, "yaw_inertia": 1.2, "com": (0.15, 0.05)}
MASS: dict[str, Any] = {"mass": 10.0, "com": (0.15, 0.05)}


def test_numbers_of_mujoco_and_drake() -> None:
    M = closed_form.mass_matrix([3.0, -1.0, 0.7], **BODY)
    n = closed_form.nonlinear_effects([3.0, -1.0, 0.7], [0, 0, 0.5], **MASS)
    # MuJoCo 4.0 and Drake 1.51, printed with eight digits after the point; the former is asked again below.
    np.testing.assert_allclose([M[0, 2], M[1, 2], M[2, 2]], [-1.34874762, 0.82515444, 1.45], atol=5e-9)
    np.testing.assert_allclose(n, [-0.20628861, -0.33718691, 0], atol=5e-9)
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is of the extra test")
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option gravity="0 0 0"/><worldbody><body>
        <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>
        <inertial pos="0.15 0.05 0" mass="10" diaginertia="1.2 1.2 1.2"/></body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = [3.0, -1.0, 0.7], [0, 0, 0.5]
    mujoco.mj_forward(model, data)
    column = np.zeros(3)
    mujoco.mj_mulM(model, data, column, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(column, M[:, 2], rtol=0, atol=1e-14)
    np.testing.assert_allclose(data.qfrc_bias, n, rtol=0, atol=1e-14)


def test_mass_matrix_rate_minus_twice_coriolis_is_skew(states: tuple[Array, ...]) -> None:
    q, v, _, _ = states
    h = 1e-5
    rate = (closed_form.mass_matrix(q + h * v, **BODY) - closed_form.mass_matrix(q - h * v, **BODY)) / (2 * h)
    C, n = closed_form.coriolis_matrix(q, v, **MASS), closed_form.nonlinear_effects(q, v, **MASS)
    np.testing.assert_allclose(np.einsum("kij,kj->ki", C, v), n, rtol=1e-13, atol=1e-15)
    N = rate - 2 * C
    # Central difference: h^2 / 6 of the third derivative, a few units, plus eps / h of rounding.
    assert np.abs(N + N.transpose(0, 2, 1)).max() < 1e-8


def test_slide_equation_one_has_rates_where_accelerations_belong(states: tuple[Array, ...]) -> None:
    """Errata, row 1: the slide's Fx, with psi_dot^2 for psi_ddot, is not the row of M a + n."""
    q, v, a, _ = states
    (x, y), m = BODY["com"], BODY["mass"]
    c, s = np.cos(q[:, 2]), np.sin(q[:, 2])
    centrifugal = m * v[:, 2] ** 2 * (x * c - y * s)
    slide = m * a[:, 0] - m * v[:, 2] ** 2 * (y * c + x * s) - centrifugal
    right = m * a[:, 0] - m * a[:, 2] * (y * c + x * s) - centrifugal
    tau = closed_form.inverse_dynamics(q, v, a, **BODY)
    np.testing.assert_allclose(tau[:, 0], right, rtol=1e-12, atol=1e-13)
    assert np.abs(tau[:, 0] - slide).max() > 0.1


def test_many_robots_and_many_states_broadcast() -> None:
    q = np.random.default_rng(0).normal(size=(4, 1, 3))
    mass, com = np.array([1.0, 2.0, 3.0]), np.array([[0, 0], [0.1, 0], [0, 0.2]])
    tau = closed_form.inverse_dynamics(q, q, q, mass=mass, yaw_inertia=0.5, com=com)
    assert tau.shape == (4, 3, 3)
    alone = closed_form.inverse_dynamics(q[2, 0], q[2, 0], q[2, 0], mass=2.0, yaw_inertia=0.5, com=(0.1, 0))
    np.testing.assert_allclose(tau[2, 1], alone, rtol=1e-15)


def test_states_that_do_not_broadcast_are_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"shapes are q \(4,\), v \(5,\), mass \(\)"):
        closed_form.nonlinear_effects(np.zeros((4, 3)), np.zeros((5, 3)), **MASS)


# -- the reduced models derived step by step, against the hand-derived ones and a robot on wheels --


SYMBOLS = {"m": 30.0, "xbc": 0.05, "ybc": -0.02, "Icz": 2.3}
HAND: dict[str, Any] = {"mass": 30.0, "com": (0.05, -0.02), "yaw_inertia": 2.3}
ROBOT = MobileRobot(30.0, 2.3, com=(0.05, -0.02, 0.2))
lx, ly = symbols("lx ly")
MECANUM = [RollerWheel(i * lx, j * ly, 0, -i * j * pi / 4) for i in (1, -1) for j in (1, -1)]
"""Front left, front right, rear left, rear right; as in WheelTable.mecanum."""

ROUNDING = 1e-13  # of sums of at most some hundred terms
DRIVES = {
    "differential": differential_drive,
    "roller": roller_drive,
    "mecanum": lambda: roller_drive(MECANUM),
    "car": car,
}


def numbers(derivation: ReducedDerivation, values: dict[str, Any]) -> list[Array]:
    """Return M, n and B."""
    found = (derivation.mass_matrix, derivation.nonlinear_effects, derivation.input_matrix)
    given = [Symbol(name) for name in values]
    written = [derivation.written_out(matrix).tolist() for matrix in found]
    return [np.array(sympy.lambdify(given, rows, "math")(*values.values()), float) for rows in written]


def assert_same(derivation: ReducedDerivation, values: dict[str, Any], other: Any) -> None:
    M, n, B = numbers(derivation, values)
    np.testing.assert_allclose(M, other.M, rtol=0, atol=ROUNDING * np.abs(other.M).max())
    np.testing.assert_allclose(n[:, 0], other.n, rtol=0, atol=10 * ROUNDING * np.abs(other.n).max())
    np.testing.assert_allclose(B, other.B, rtol=0, atol=ROUNDING * np.abs(other.B).max())


def test_the_differential_drive_is_the_hand_derived_one() -> None:
    m, xbc, ybc, Icz, Iw, l, b, r, v, omega = symbols("m xbc ybc Icz Iw l b r v omega")  # noqa: E741
    derivation, d = differential_drive(), xbc - l
    inertia = Icz + m * (d**2 + ybc**2) + 2 * Iw * b**2 / r**2
    assert is_zero(
        derivation.mass_matrix - ImmutableMatrix([[m + 2 * Iw / r**2, -m * ybc], [-m * ybc, inertia]])
    )
    assert is_zero(derivation.nonlinear_effects - ImmutableMatrix([-m * d * omega**2, m * d * v * omega]))
    assert is_zero(derivation.input_matrix - ImmutableMatrix([[1, 1], [-b, b]]) / r)
    values = {**SYMBOLS, "l": 0.07, "b": 0.25, "r": 0.1, "Iw": 0.03, "v": 0.8, "omega": -0.6}
    own = {"axle": 0.07, "track": 0.5, "radius": 0.1, "spin_inertia": 0.03}
    assert_same(derivation, values, closed_form.differential_drive([0.8, -0.6], **HAND, **own))


def test_any_roller_wheels_are_the_hand_derived_ones() -> None:
    rng = np.random.default_rng(3)
    columns = {
        "x": rng.uniform(-0.5, 0.5, 4),
        "y": rng.uniform(-0.5, 0.5, 4),
        "delta": rng.uniform(-3, 3, 4),
        "gamma": rng.uniform(-1.2, 1.2, 4),
        "r": rng.uniform(0.05, 0.2, 4),
        "Iw": rng.uniform(0.01, 0.1, 4),
    }
    x, y, angle, roller, radius, spin = columns.values()
    wheels = {"x": x, "y": y, "angle": angle, "roller": roller, "radius": radius, "spin_inertia": spin}
    expected = closed_form.roller_drive([0.4, -0.3, 0.7], **HAND, **wheels)
    values = {f"{name}{k}": entry for name, column in columns.items() for k, entry in enumerate(column, 1)}
    twist = {"v_x": 0.4, "v_y": -0.3, "omega": 0.7}
    assert_same(roller_drive(), {**SYMBOLS, **values, **twist}, expected)


@pytest.mark.parametrize(("track", "steering"), [(0.4, -1.2), (0.0, 0.5)])
def test_the_car_is_the_hand_derived_one(track: float, steering: float) -> None:
    values = {**SYMBOLS, "L": 0.6, "b": track / 2, "r": 0.1, "Iw": 0.03, "Iz": 0.02}
    own = {"wheelbase": 0.6, "track": track, "radius": 0.1, "spin_inertia": 0.03, "steered_inertia": 0.02}
    expected = closed_form.car([0.8, -0.6], steering, **HAND, **own)
    assert_same(car(), {**values, "delta": steering, "v": 0.8, "deltadot": -0.6}, expected)


GEARED = Motor(rotor_inertia=1e-4, gear=10)
OWN: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
TABLES = {
    "differential": (
        WheelTable.differential(0.5, 0.1, x=0.07, supports=[(-0.2, 0)], motor=GEARED, **OWN),
        {"l": 0.07, "b": 0.25, "r": 0.1, "Iw": 0.02},
    ),
    "mecanum": (
        WheelTable.mecanum(0.5, 0.4, 0.08, motor=GEARED, **OWN),
        {"lx": 0.25, "ly": 0.2, "r": 0.08, "Iw": 0.02},
    ),
    "car": (WheelTable.car(0.6, 0.4, 0.1, **OWN), {"L": 0.6, "b": 0.2, "r": 0.1, "Iw": 0.01, "Iz": 0.006}),
}


@pytest.mark.parametrize("kind", TABLES)
def test_a_robot_on_wheels_has_the_derived_model(kind: str) -> None:
    table, values = TABLES[kind]
    wheeled, derivation = WheeledRobot(ROBOT, table), DRIVES[kind]()
    rng = np.random.default_rng(5)
    q, v = rng.uniform(-1, 1, wheeled.nq), rng.uniform(-1, 1, wheeled.nv)
    found = wheeled.reduced(q, wheeled.project(q, v))
    state = dict(zip(map(str, derivation.nu), found.nu, strict=True))
    if kind == "car":
        state["delta"] = q[3]
    M, n, B = numbers(derivation, {**SYMBOLS, **values, **state})
    B = B[:, [0, 2]] if kind == "car" else B
    # the tree's inertias are those of the whole less and plus each wheel, and it solves for S
    np.testing.assert_allclose(found.M, M, rtol=0, atol=10 * ROUNDING * np.abs(M).max())
    np.testing.assert_allclose(found.n, n[:, 0], rtol=0, atol=10 * ROUNDING * np.abs(M).max())
    np.testing.assert_allclose(found.B, B, rtol=0, atol=10 * ROUNDING * np.abs(B).max())


def test_mecanum_wheels_are_the_textbooks() -> None:
    r, Iw, m = symbols("r Iw m")
    derivation = roller_drive(MECANUM)
    J = ImmutableMatrix([[1, -1, -lx - ly], [1, 1, lx + ly], [1, 1, -lx - ly], [1, -1, lx + ly]]) / r
    assert is_zero(derivation.input_matrix - J.T)
    assert is_zero(derivation.mass_matrix[0, 0] - m - 4 * Iw / r**2)


def test_steps_are_shown_as_the_lectures() -> None:
    derivation = car()
    latex, text = derivation.latex(), str(derivation)
    assert latex == derivation._repr_latex_()
    assert latex.count(r"\text{") == len(derivation.steps) == text.count(" =\n")
    assert latex.count("{") == latex.count("}")
    names = [step.name for step in derivation.steps]
    assert len(set(names)) == len(names)
    order = ["u", "A", "S", "M", "n", "B", "S_dot", "M_nu", "n_nu", "B_nu"]
    assert [name for name in names if name in order] == order
    assert all(step.explanation.endswith(".") for step in derivation.steps)
    for part in (r"\dot{\phi}_{", r"\dot{\psi}", r"\dot{S}", "I_{cz}", "I_{w", "S^T M S"):
        assert part in latex


def test_names_with_two_meanings_are_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"^wheels and motion have the name 'omega' twice"):
        roller_drive([RollerWheel(Symbol("x"), 0, Symbol("omega"), 0)])
