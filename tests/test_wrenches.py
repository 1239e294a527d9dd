"""Forces on the body against their definitions, and the work that they do."""

import pickle
from typing import Any

import numpy as np
import pytest
from attrs import evolve
from hypothesis import given, strategies as st

from pinmobile import ConstantForce, RollingResistance, ViscousFriction
from pinmobile.arrays import Array
from pinmobile.forces import NoiseForce, SinusoidalForce, noise_frequencies
from pinmobile.parts import named
from tests.refusals import refusals, told

Q, V = np.array([1.0, -2.0, 0.7]), np.array([0.5, 0.3, -0.4])
EVERY: list[Any] = [
    ConstantForce((1, 2, 3)),
    SinusoidalForce((1, 2, 3), 0.7, 0.3),
    NoiseForce((1, 2, 3), 2.0, 5),
    ViscousFriction((1, 2, 3)),
    RollingResistance((1, 2, 3), 0.2),
]


def rotation(psi: float) -> Array:
    """Return the matrix that turns a body twist into v."""
    return np.array([[np.cos(psi), -np.sin(psi), 0], [np.sin(psi), np.cos(psi), 0], [0, 0, 1]])


def test_driven_forces_are_their_formulas() -> None:
    np.testing.assert_array_equal(EVERY[0](3.0, Q, V), [1, 2, 3])
    wave = np.sin(2 * np.pi * 0.7 * 3.0 + 0.3)
    np.testing.assert_allclose(EVERY[1](3.0, Q, V), wave * np.array([1, 2, 3]), rtol=1e-15)
    phases = np.random.default_rng(5).uniform(0, 2 * np.pi, (16, 3))
    golden = 0.6180339887498949
    f = [[2.0 * (k + np.mod((k + 1) * golden + j / 3, 1)) / 16 for j in range(3)] for k in range(16)]
    expected = [
        std * np.sqrt(2 / 16) * sum(np.cos(2 * np.pi * f[k][j] * 3.0 + phases[k, j]) for k in range(16))
        for j, std in enumerate((1, 2, 3))
    ]
    # The same 16 cosines summed in another order.
    np.testing.assert_allclose(EVERY[2](3.0, Q, V), expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(noise_frequencies(2.0), f, rtol=1e-15)


def test_friction_and_rolling_resistance_are_their_formulas() -> None:
    R = rotation(Q[2])
    nu = R.T @ V
    np.testing.assert_allclose(EVERY[3](0.0, Q, V), -R @ (np.array([1, 2, 3]) * nu), rtol=1e-14)
    pushed = np.array([1, 2, 3]) * nu / np.sqrt(nu**2 + 0.2**2)
    np.testing.assert_allclose(EVERY[4](0.0, Q, V), -R @ pushed, rtol=1e-14)


def test_friction_is_said_by_the_names_of_its_axes() -> None:
    friction: Any = ViscousFriction(forward=5, yaw=0.4)
    assert np.asarray(friction.coefficients).tolist() == [5.0, 0.0, 0.4]
    assert repr(friction) == "ViscousFriction(forward=5.0, left=0.0, yaw=0.4)"
    assert repr(eval(repr(friction))) == repr(friction) == repr(evolve(friction, coefficients=(5, 0, 0.4)))
    names = list(named(friction))
    assert names == ["coefficients", *(f"coefficients.{axis}" for axis in ("forward", "left", "yaw"))]


states = st.lists(st.floats(-10, 10), min_size=3, max_size=3).map(np.array)


@given(q=states, v=states)
def test_friction_and_resistance_never_feed_energy_and_turn_with_the_body(q: Array, v: Array) -> None:
    for force in (ViscousFriction((1, 20, 3)), RollingResistance((1, 20, 3), (0.1, 0.2, 0.3))):
        tau = force(0.0, q, v)
        assert tau @ v <= 0
        R = rotation(1.1)
        turned = force(0.0, q + np.array([3, 4, 1.1]), R @ v)
        # An angle of 10 rad is rounded by 10 eps, so 10 m/s by 100 eps; times 20 N / 0.1 m/s at the steepest.
        np.testing.assert_allclose(turned, R @ tau, rtol=0, atol=1e-11)


def test_rolling_resistance_is_linear_at_rest_and_of_its_size_when_fast() -> None:
    force = RollingResistance((8, 8, 8), 0.01)
    at = np.zeros(3)
    assert force(0.0, at, at).tolist() == [0, 0, 0]
    # x / sqrt(1 + x^2) = x (1 - x^2 / 2 + ...) and 1 - 1 / (2 x^2) + ...
    np.testing.assert_allclose(force(0.0, at, at + 1e-6), -8e-4, rtol=1e-8)
    np.testing.assert_allclose(force(0.0, at, at + 100.0), -8.0, rtol=1e-8)


@pytest.mark.parametrize("force", EVERY, ids=lambda force: type(force).__name__)
def test_many_times_and_many_states_are_one_at_a_time(force: Any) -> None:
    rng = np.random.default_rng(1)
    q, v = rng.normal(size=(2, 4, 5, 3))
    t = rng.uniform(0, 9, (4, 5))
    for times in (2.0, t):
        many = force(times, q, v)
        each = [
            [force(np.broadcast_to(times, (4, 5))[i, j], q[i, j], v[i, j]) for j in range(5)]
            for i in range(4)
        ]
        np.testing.assert_allclose(many, each, rtol=1e-12, atol=1e-12)
    assert force(t, q[0, 0], v[0, 0]).shape == (4, 5, 3)


def test_the_rms_of_noise_over_the_phases_is_std_and_its_mean_is_zero() -> None:
    seeds = np.random.default_rng(3)
    values = np.array([NoiseForce((1, 2, 3), 5.0, seeds)(7.3, Q, V) for _ in range(4_000)])
    # A mean of n samples is within 4 / sqrt(n) of its expectation, a mean square within about 6 / sqrt(n).
    np.testing.assert_allclose(values.mean(axis=0) / [1, 2, 3], 0, atol=0.07)
    np.testing.assert_allclose(np.square(values).mean(axis=0) / [1, 4, 9], 1, atol=0.1)
    np.testing.assert_allclose(np.corrcoef(values.T), np.eye(3), atol=0.07)


def test_noise_has_one_line_in_each_part_of_the_band_and_nothing_beyond() -> None:
    frequencies = noise_frequencies(5.0)
    assert frequencies.shape == (16, 3)
    t = np.arange(0, 400, 0.02)
    for own, values in zip(frequencies.T, NoiseForce((1, 1, 1), 5.0, 0)(t, Q, V).T, strict=True):
        np.testing.assert_array_equal(np.floor(own / (5.0 / 16)), np.arange(16))
        spectrum = np.abs(np.fft.rfft(values * np.hanning(len(t))))
        band = np.fft.rfftfreq(len(t), 0.02)
        assert spectrum[band > 5.05].max() < 1e-3 * spectrum.max()
        peaks = band[spectrum > 0.5 * spectrum.max()]
        assert all(np.abs(peaks - f).min() < 1 / 400 for f in own)


def test_a_seed_repeats_and_a_generator_goes_on() -> None:
    one, same = NoiseForce((1, 2, 3), 2.0, 5), NoiseForce((1, 2, 3), 2.0, np.random.default_rng(5))
    np.testing.assert_array_equal(one.phases, same.phases)
    generator = np.random.default_rng(5)
    first, second = (NoiseForce((1, 2, 3), 2.0, generator).phases for _ in range(2))
    assert (first != second).all()
    given_back = NoiseForce((1, 2, 3), 2.0, None, phases=one.phases)
    for copy in (given_back, pickle.loads(pickle.dumps(one)), pickle.loads(pickle.dumps(given_back))):
        np.testing.assert_array_equal(copy(1.2, Q, V), one(1.2, Q, V))
    assert repr(one) == "NoiseForce(std=array([1., 2., 3.]), bandwidth=2.0, seed=5)"


test_parameters_that_do_not_fit_are_refused = refusals(
    (lambda: ConstantForce((1, 2)), "force has shape (2,), expected (3,)"),
    (
        lambda: NoiseForce((1, 1, 1), 1, None, phases=np.zeros((3, 16))),
        "phases has shape (3, 16), expected (16, 3)",
    ),
    (lambda: ViscousFriction(left=-1), "coefficients is -1.0 N s/m, expected >= 0"),
    (lambda: ViscousFriction((1, 1, 1), left=0), "left is 0, expected None beside coefficients"),
    by=told,
)
