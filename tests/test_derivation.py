"""The symbolic derivation against the lecture, hand formulas, time derivatives, Lagrange and Pinocchio."""

import re
from collections.abc import Callable, Sequence
from functools import cache
from math import pi
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import sympy
from hypothesis import Phase, given, settings, strategies as st
from sympy import Expr, ImmutableMatrix, Matrix, cos, sin, symbols, zeros

from pinmobile.arrays import Array
from pinmobile.derivation import Derivation, Link, derive, difference, lagrange, lecture
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHRow, DHTable, JointType
from pinmobile.errors import InvalidArgument, UnknownName
from tests.refusals import begun, refusals

pytestmark = pytest.mark.once

Numbers = tuple[float, float, float, float, JointType]

R, P = JointType.REVOLUTE, JointType.PRISMATIC

m, xbc, ybc, Icz = symbols("m xbc ybc Icz")
x, y, psi = symbols("x y psi")
xd, yd, psid = symbols("xdot ydot psidot")
xdd, ydd, psidd = symbols("xddot yddot psiddot")
c, s = cos(psi), sin(psi)

LECTURE_M = Matrix(
    [
        [m, 0, -m * (ybc * c + xbc * s)],
        [0, m, m * (xbc * c - ybc * s)],
        [-m * (ybc * c + xbc * s), m * (xbc * c - ybc * s), m * (xbc**2 + ybc**2) + Icz],
    ]
)
LECTURE_N = Matrix([-m * psid**2 * (xbc * c - ybc * s), -m * psid**2 * (ybc * c + xbc * s), 0])

TWISTED = DHTable(
    (
        DHRow(0, 0, 0, 0.3, R, "q1"),
        DHRow(pi / 2, 0.4, pi / 6, 0.1, R, "q2"),
        DHRow(-pi / 3, 0.2, 0, 0.5, P, "q3"),
    )
)
"""Two revolute joints with twisted axes and a sliding one on top."""


@cache
def rr() -> Derivation:
    """Return a planar arm of two revolute joints in a vertical plane.

    y
    |      /o  link 2, lc2 to its centre of mass
    |  q2 /
    |  __o     link 1, length 0.7 m
    | /  q1
    o--------- x
    """
    table = DHTable((DHRow(0, 0, 0, 0, R, "q1"), DHRow(0, 0.7, 0, 0, R, "q2")))
    m1, m2, lc1, lc2, I1, I2, g = symbols("m1 m2 lc1 lc2 I1 I2 g")
    links = [Link(m1, (lc1, 0, 0), sympy.diag(0, 0, I1)), Link(m2, (lc2, 0, 0), sympy.diag(0, 0, I2))]
    return derive(table, links, gravity=(0, -g, 0))


def is_zero(expression: Expr | ImmutableMatrix) -> bool:
    simplified = sympy.simplify(expression)
    return bool(simplified == 0 * simplified)


def in_time(derivation: Derivation, expression: ImmutableMatrix) -> ImmutableMatrix:
    """Return the derivative with respect to time."""
    chain = derivation.chain
    rates = [(q, v) for q, v in zip(chain.q + chain.v, chain.v + chain.a, strict=True)]
    return sum((expression.diff(symbol) * rate for symbol, rate in rates), zeros(*expression.shape))


def random_body(rng: np.random.Generator) -> Any:
    return pin.Inertia(rng.uniform(0.5, 3), rng.uniform(-0.3, 0.3, 3), random_inertia(rng))


def random_inertia(rng: np.random.Generator) -> Array:
    # A cloud of points has the inertia of a body.
    points = rng.normal(size=(8, 3)) * 0.2
    return np.asarray(np.einsum("ij,ij,kl->kl", points, points, np.eye(3)) - points.T @ points, np.float64)


def pinocchio_model(table: DHTable, bodies: Sequence[Any | None], gravity: Sequence[float]) -> Any:
    model = pin.Model()
    model.gravity.linear = np.array(gravity, dtype=float)
    parent = 0
    for row, T, body in zip(table, table.transforms(np.zeros(len(table))), bodies, strict=True):
        joint = pin.JointModelRZ() if row.joint is R else pin.JointModelPZ()
        parent = model.addJoint(parent, joint, pin.SE3(T), row.variable)
        if body is not None:
            model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    return model


def general_parameters(bodies: Sequence[Any | None]) -> dict[str, float]:
    """Return the values of the symbols of `Link.general` for the bodies."""
    params = {}
    for k, body in enumerate(bodies, 1):
        if body is not None:
            params[f"m{k}"] = body.mass
            params |= {f"{axis}c{k}": body.lever[i] for i, axis in enumerate("xyz")}
            pairs = [(i, j) for i in range(3) for j in range(i, 3)]
            params |= {f"I{'xyz'[i]}{'xyz'[j]}{k}": body.inertia[i, j] for i, j in pairs}
    return params


# The lecture


@pytest.mark.parametrize("table", [LECTURE_TABLE, SLIDE_TABLE])
def test_lecture_has_exactly_its_mass_matrix_and_nonlinear_effects(table: DHTable) -> None:
    derivation = lecture(table)
    assert is_zero(derivation.mass_matrix - LECTURE_M)
    assert is_zero(derivation.nonlinear_effects - LECTURE_N)
    assert is_zero(derivation.inputs - LECTURE_M * Matrix([xdd, ydd, psidd]) - LECTURE_N)
    assert derivation.q == (x, y, psi)
    assert derivation.v == (xd, yd, psid)
    assert derivation.a == (xdd, ydd, psidd)
    assert derivation.parameters == (m, xbc, ybc, Icz)
    assert derivation.chain.q == (y, x, psi)


@pytest.mark.long
def test_right_angles_of_four_decimals_are_right_and_reported() -> None:
    twist, quarters = -1.5708, -1
    rows = [(0.0, 0.0), (quarters * sympy.pi / 2, 0.5)]  # a number of sympy stands for the same angle
    table = DHTable(tuple(DHRow(alpha, a, 0, 0.1, R, f"q{k}") for k, (alpha, a) in enumerate(rows, 1)))
    assert table.rows[1].alpha == quarters * pi / 2
    links = [None, Link(1, (0.1, 0, 0), sympy.eye(3))]
    exact = derive(table, links)
    words = f"alpha of row 2 is {twist} rad; the derivation uses {quarters * sympy.pi / 2}"
    with pytest.warns(UserWarning, match=f"^{re.escape(words)}$"):
        found = derive(DHTable((table.rows[0], DHRow(twist, 0.5, 0, 0.1, R, "q2"))), links)
    assert found.mass_matrix == exact.mass_matrix
    assert found.nonlinear_effects == exact.nonlinear_effects


def test_lecture_steps_have_the_expressions_of_the_script() -> None:
    derivation = lecture()

    def at(name: str) -> Expr | ImmutableMatrix:
        return derivation[name].expression

    assert at("T_0_1") == ImmutableMatrix([[0, 1, 0, 0], [0, 0, 1, y], [1, 0, 0, 0], [0, 0, 0, 1]])
    assert at("T_1_2") == ImmutableMatrix([[0, -1, 0, 0], [0, 0, 1, x], [-1, 0, 0, 0], [0, 0, 0, 1]])
    assert at("T_2_3") == ImmutableMatrix([[-s, -c, 0, 0], [0, 0, -1, 0], [c, -s, 0, 0], [0, 0, 0, 1]])
    assert at("T_0_3") == ImmutableMatrix([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert at("p") == ImmutableMatrix([x, y, 0])
    assert at("n").row_join(at("s")).row_join(at("a")) == ImmutableMatrix([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert at("v_0_3") == ImmutableMatrix([xd, yd, 0])
    assert at("omega_0_3") == ImmutableMatrix([0, 0, psid])
    assert at("a_0_3") == ImmutableMatrix([xdd, ydd, 0])
    assert at("alpha_0_3") == ImmutableMatrix([0, 0, psidd])
    assert at("v_3") == ImmutableMatrix([xd * c + yd * s, -xd * s + yd * c, 0])
    assert at("N_3") == ImmutableMatrix([0, 0, Icz * psidd])
    assert at("tau_1") == derivation.inputs[1]
    assert at("tau_2") == derivation.inputs[0]
    assert at("tau_3") == derivation.inputs[2]


def test_shaking_force_and_moment_are_the_rates_of_the_momenta() -> None:
    derivation = lecture()
    com = Matrix([x + xbc * c - ybc * s, y + xbc * s + ybc * c, 0])
    momentum = m * in_time(derivation, com)
    angular = com.cross(momentum) + Matrix([0, 0, Icz * psid])
    assert is_zero(derivation["f_0"].expression - in_time(derivation, momentum))
    assert is_zero(derivation["n_0"].expression - in_time(derivation, angular))


# Motion: what the recursion propagates are derivatives with respect to time


CHAINS = {
    "twisted RRP": TWISTED,
    "PR with a free angle": DHTable((DHRow(0.3, 0.1, 0.2, 0, P, "d"), DHRow(-0.7, 0.2, 0.1, 0.4, R, "phi"))),
}


@pytest.mark.parametrize("name", CHAINS)
def test_velocities_and_accelerations_in_the_base_are_time_derivatives(name: str) -> None:
    table = CHAINS[name]
    derivation, last = derive(table, [None] * len(table)), len(table)

    def at(name: str) -> ImmutableMatrix:
        return derivation[name].expression

    rotation = at(f"T_0_{last}")[:3, :3]
    spin = in_time(derivation, rotation) * rotation.T
    for expected, found in (
        (in_time(derivation, at("p")), at(f"v_0_{last}")),
        (in_time(derivation, at(f"v_0_{last}")), at(f"a_0_{last}")),
        (Matrix([spin[2, 1], spin[0, 2], spin[1, 0]]), at(f"omega_0_{last}")),
        (in_time(derivation, at(f"omega_0_{last}")), at(f"alpha_0_{last}")),
    ):
        values = {
            symbol: sympy.Rational(k, 7) for k, symbol in enumerate(sorted(expected.free_symbols, key=str), 1)
        }
        residual = np.array((expected - found).subs(values).evalf(30), dtype=float)
        assert np.abs(residual).max() < 1e-20
        assert any(found)


def test_gyroscopic_term_is_turned_before_the_cross_product() -> None:
    # The lecture has R'(a2 + w2 x z psi_dot): the rate is along the z axis of the next frame, not of this.
    derivation = derive(TWISTED, [None] * 3)
    rotation = derivation["T_1_2"].expression[:3, :3]
    omega, alpha = derivation["omega_1"].expression, derivation["alpha_1"].expression
    _, v2, _ = derivation.v
    _, a2, _ = derivation.a
    z = Matrix([0, 0, 1])
    of_the_lecture = rotation.T * (alpha + omega.cross(z * v2)) + z * a2
    pose = derivation["T_0_2"].expression[:3, :3]
    right = in_time(derivation, pose * derivation["omega_2"].expression)
    assert is_zero(pose * derivation["alpha_2"].expression - right)
    assert not is_zero(pose * of_the_lecture - right)


# Equations of motion


@pytest.mark.parametrize("table", [LECTURE_TABLE, SLIDE_TABLE])
def test_lagrange_confirms_the_lecture(table: DHTable) -> None:
    derivation = lecture(table)
    confirmation = lagrange(derivation)
    assert difference(confirmation, derivation) == zeros(3, 1)
    assert confirmation.mass_matrix == derivation.mass_matrix
    assert confirmation.nonlinear_effects == derivation.nonlinear_effects
    assert "psidot**2*(Icz/2 + m*(xbc**2 + ybc**2)/2)" in str(confirmation["K"].expression)
    assert "T_0_3" in [step.name for step in confirmation.steps]
    with pytest.raises(UnknownName, match="f_0"):
        confirmation["f_0"]


@pytest.mark.long
def test_lagrange_confirms_a_general_link_under_gravity() -> None:
    arm = derive(DHTable(TWISTED.rows[:2]), [None, Link.general(2)], gravity=(0, 0.1, -symbols("g")))
    assert difference(arm, lagrange(arm)) == zeros(2, 1)
    assert difference(rr(), lagrange(rr())) == zeros(2, 1)


def test_difference_sees_a_wrong_term() -> None:
    table = LECTURE_TABLE
    links = (None, None, Link(m, (xbc, ybc, 0), sympy.diag(0, 0, 2 * Icz)))
    other = derive(table, links, order=("x", "y", "psi"))
    assert difference(other, lecture()) == Matrix([0, 0, Icz * psidd])
    assert difference(lecture(), lecture(SLIDE_TABLE)) == zeros(3, 1)
    with pytest.raises(InvalidArgument, match="coordinates are"):
        difference(derive(table, links), lecture())
    with pytest.raises(InvalidArgument, match=r"at most 3: compare numeric\(\)"):
        difference(four(), four())


FOUR = DHTable(
    (
        DHRow(0, 0, 0, 0.4, R, "q1"),
        DHRow(-pi / 2, 0.1, 0.3, 0, R, "q2"),
        DHRow(0.2, 0.5, 0, 0.1, P, "q3"),
        DHRow(pi / 2, 0.05, 1.1, 0.4, R, "q4"),
    )
)


@cache
def four() -> Derivation:
    return derive(FOUR, gravity=(0.0, 1.0, -9.81))


angles = st.one_of(
    st.integers(-12, 12).map(lambda k: k * pi / 12), st.floats(-3, 3).map(lambda a: round(a, 2))
)
lengths = st.sampled_from([0.0, 0.25, -0.3, 1.0])
rows = st.tuples(angles, lengths, angles, lengths, st.sampled_from([R, P]))


# Not shrunk: a failure would take minutes.
@settings(
    max_examples=settings().max_examples // 6,
    derandomize=True,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],
)
@given(
    st.one_of(st.lists(rows, min_size=1, max_size=2), st.lists(rows, min_size=4, max_size=4)),
    st.integers(0, 2**32 - 1),
)
@pytest.mark.long
def test_any_table_is_pinocchios(numbers: list[Numbers], seed: int) -> None:
    rng, gravity = np.random.default_rng(seed), (0.2, -0.1, -9.81)
    table = DHTable(tuple(DHRow(*row, f"q{k}") for k, row in enumerate(numbers)))
    bodies = [random_body(rng) if k % 3 != 1 else None for k in range(len(table))]
    links = [Link.general(k) if body else None for k, body in enumerate(bodies, 1)]
    model, params = pinocchio_model(table, bodies, gravity), general_parameters(bodies)
    data, numeric = model.createData(), derive(table, links, gravity=gravity).numeric()
    q, v, a = rng.normal(size=(3, 5, model.nv)) * 2
    M, n = numeric.mass_matrix(q, params), numeric.nonlinear_effects(q, v, params)
    tau = numeric.inverse_dynamics(q, v, a, params)
    for i in range(len(q)):
        expected = pin.rnea(model, data, q[i], v[i], a[i])
        scale = 1e-10 * max(np.abs(expected).max(), 1e-3)
        np.testing.assert_allclose(tau[i], expected, rtol=0, atol=scale)
        np.testing.assert_allclose(n[i], pin.nonLinearEffects(model, data, q[i], v[i]), rtol=0, atol=scale)
        upper = np.triu(pin.crba(model, data, q[i]))
        np.testing.assert_allclose(M[i], upper + np.triu(upper, 1).T, rtol=0, atol=1e-10 * upper.max())


def test_written_out_is_free_of_names() -> None:
    rows = FOUR.rows[:3]
    table = DHTable((*rows, DHRow(pi / 2, 0, 0, 0, P, "q4")))
    derivation = derive(table, [None, None, None, Link(m, (0, 0, 0), zeros(3, 3))])
    full = derivation.written_out(derivation.mass_matrix)
    assert full.free_symbols <= {*derivation.q, m}
    assert full[3, 3] == m
    named = {symbol for symbol, _ in derivation.assignments}
    assert derivation.mass_matrix.free_symbols & named
    assert {sympy.Symbol("c_1"), sympy.Symbol("omega_2x")} <= named
    short = lecture()
    assert short.written_out(short.inputs) == short.inputs


# Numbers


def test_numeric_broadcasts_states_against_parameters() -> None:
    numeric = lecture().numeric()
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 5, 1, 3))
    params: Any = {"m": rng.uniform(1, 2, 4), "xbc": 0.1, "ybc": rng.normal(size=(2, 1, 1)), "Icz": 0.3}
    M = numeric.mass_matrix(q, params)
    n = numeric.nonlinear_effects(q, v, params)
    tau = numeric.inverse_dynamics(q, v, a, params)
    assert (M.shape, n.shape, tau.shape) == ((2, 5, 4, 3, 3), (2, 5, 4, 3), (2, 5, 4, 3))
    one = {"m": params["m"][3], "xbc": 0.1, "ybc": params["ybc"][1, 0, 0], "Icz": 0.3}
    np.testing.assert_allclose(M[1, 2, 3], numeric.mass_matrix(q[2, 0], one), rtol=1e-15)
    np.testing.assert_allclose(tau, np.einsum("...ij,...j->...i", M, a) + n, atol=1e-14)


# Looking at it


def balanced(latex: str) -> bool:
    depth = 0
    for brace in re.findall(r"(?<!\\)[{}]", latex):
        depth += 1 if brace == "{" else -1
        if depth < 0:
            return False
    pairs = ((r"\left", r"\right"), (r"\begin{", r"\end{"))
    return depth == 0 and all(latex.count(opening) == latex.count(closing) for opening, closing in pairs)


@pytest.mark.parametrize(
    "make", [lecture, lambda: lagrange(lecture()), four], ids=["lecture", "lagrange", "four joints"]
)
def test_every_step_is_well_formed_latex_and_text(make: Callable[[], Derivation]) -> None:
    derivation = make()
    for step in derivation.steps:
        latex = step.latex()
        assert balanced(latex)
        assert latex.startswith(step.symbol)
        assert step._repr_latex_() == rf"$\displaystyle {latex}$"
        title, explanation, left, *_ = str(step).splitlines()
        assert (title, explanation, left) == (step.title, f"  {step.explanation}", f"{step.name} =")
        assert step.explanation.endswith(".")
        assert "$" not in title + explanation + step.symbol
    whole = derivation.latex()
    assert balanced(whole)
    assert derivation._repr_latex_() == whole
    assert whole.count(r"\text{") == len(derivation.steps) == str(derivation).count(" =\n")
    assert "steps" not in repr(derivation)


def test_latex_of_the_lecture_has_its_symbols() -> None:
    derivation = lecture()
    assert derivation["omega_3"].latex() == (
        r"{}^{3}\omega_{3} = \left[\begin{matrix}0\\0\\\dot{\psi}\end{matrix}\right]"
    )
    assert r"\dot{q}_{1}" in rr()["n_v"].latex()
    assert "I_{zz1}" in derive(ONE)["M"].latex()


# Arguments


ONE = DHTable((DHRow(0, 0, 0, 0, R, "q1"),))


test_what_cannot_be_derived_is_refused = refusals(
    (lambda: derive(ONE, [None, None]), "links is (None, None), expected 1 of Link or None"),
    (lambda: derive(ONE, order=["q7"]), "order is ('q7',), expected a permutation of ('q1',)"),
    (
        lambda: derive(ONE, [Link(symbols("q1"), (0, 0, 0), zeros(3, 3))]),
        "links and table have the name 'q1'",
    ),
    (lambda: lecture(ONE), "table is "),
    (lambda: Link("heavy", (0, 0, 0), np.eye(3)), "mass is 'heavy', expected a finite real number"),
    (lambda: Link(1, (0, 0, 0), [[1, 2, 0], [0, 1, 0], [0, 0, 1]]), "inertia is [[1, 2, 0], "),
    (lambda: lecture().numeric().mass_matrix([1, 2, 3], {"m": 1}), "params lacks xbc, ybc, Icz"),
    by=begun,
)
