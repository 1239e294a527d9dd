from typing import Any

import numpy as np
import pytest

from pinmobile import InvalidArgument, closed_form
from pinmobile.arrays import Array

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
