"""Forces beside the controller's: definitions and work, closed forms of runs, friction of joints."""

import pickle
from typing import Any

import numpy as np
import pytest
from attrs import evolve

import pinmobile as pm
from pinmobile import (
    ConstantForce,
    JointFriction,
    MobileRobot,
    RollingResistance,
    ViscousFriction,
    law,
    simulate,
)
from pinmobile.arrays import Array
from pinmobile.forces import NoiseForce, SinusoidalForce, noise_frequencies
from pinmobile.integrators import constant_acceleration, semi_implicit_euler
from pinmobile.parts import named
from pinmobile.plant import Context
from tests.refusals import begun, refusals, told

ROBOT, BALANCED = pm.MobileRobot(10, 1.2, com=(0.15, 0.05)), pm.MobileRobot(10, 1.2)
CIRCLE = pm.FixedHeading(pm.Circle(1.0, 0.5, 4.0), 0.3)
START: dict[str, Any] = {"q0": (0.2, -0.1, 0.9), "v0": (0.1, 0.0, -0.4)}
NOTHING = pm.law(lambda t, q, v, reference: np.zeros(3))
FORCES: list[Any] = [
    pm.ConstantForce((1, 2, 0.3)),
    SinusoidalForce((3, 1, 0.4), 1.3, 0.2),
    NoiseForce((2, 2, 0.2), 3.0, 1),
    pm.ViscousFriction((2, 8, 0.5)),
    pm.RollingResistance((3, 9, 0.2), 0.1),
]


def test_every_sample_is_that_of_the_loop_written_by_hand() -> None:
    """The force of the controller is held, the others are asked at every stage."""
    controller, dt = pm.PD(40, 20), 0.1
    rollout = pm.simulate(ROBOT, controller, CIRCLE, dt=dt, integrator=pm.rk4, forces=FORCES, **START)
    q, v = np.array(START["q0"]), np.array(START["v0"])
    state = controller.initial_state(Context.of(ROBOT, dt=dt))
    for k in range(40):
        tau, state = controller(k * dt, q, v, CIRCLE(k * dt), state)

        def acceleration(t: float, q: Array, v: Array, tau: Array = tau) -> Array:
            push = tau + sum(force(t, q, v) for force in FORCES) - ROBOT.nonlinear_effects(q, v)
            return np.asarray(np.linalg.solve(ROBOT.mass_matrix(q), push))

        np.testing.assert_allclose(rollout.q[k], q, rtol=0, atol=1e-11)
        np.testing.assert_allclose(rollout.u[k], tau, rtol=0, atol=1e-10)
        np.testing.assert_allclose(rollout.a[k], acceleration(k * dt, q, v), rtol=0, atol=1e-10)
        k1 = acceleration(k * dt, q, v)
        k2 = acceleration((k + 0.5) * dt, q + dt / 2 * v, v + dt / 2 * k1)
        k3 = acceleration((k + 0.5) * dt, q + dt / 2 * (v + dt / 2 * k1), v + dt / 2 * k2)
        k4 = acceleration((k + 1) * dt, q + dt * (v + dt / 2 * k2), v + dt * k3)
        q = q + dt * v + dt**2 / 6 * (k1 + k2 + k3)
        v = v + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def run(force: Any, integrator: Any, dt: float, robot: pm.MobileRobot = BALANCED) -> Any:
    return pm.simulate(robot, NOTHING, CIRCLE, dt=dt, integrator=integrator, forces=[force], **START)


@pytest.mark.parametrize(
    ("integrator", "order"), [(constant_acceleration, 1), (semi_implicit_euler, 1), (pm.rk4, 4)]
)
def test_a_sinusoidal_force_is_followed_to_the_order_of_the_method(integrator: Any, order: int) -> None:
    """v(T) is the integral of a sinusoid: exact only to the order at which stages see their own time."""
    w, exact = 2 * np.pi * 0.3, np.empty(3)
    exact[:] = (
        START["v0"] + np.array([5, -3, 0.6]) / [10, 10, 1.2] * (np.cos(0.4) - np.cos(w * 4.0 + 0.4)) / w
    )
    steps = np.array([0.1, 0.05, 0.025])
    force = SinusoidalForce((5, -3, 0.6), 0.3, 0.4)
    off = [float(np.abs(run(force, integrator, float(dt)).v[-1] - exact).max()) for dt in steps]
    assert np.polyfit(np.log(steps), np.log(off), 1)[0] == pytest.approx(order, abs=0.05)


def test_a_force_cannot_write_into_the_record() -> None:
    def vandal(t: float, q: Array, v: Array) -> Array:
        q[:] = v[:] = 99
        return np.zeros(3)

    plain = pm.simulate(ROBOT, pm.PD(9, 9), CIRCLE, dt=0.5, integrator=pm.rk4)
    rollout = pm.simulate(ROBOT, pm.PD(9, 9), CIRCLE, dt=0.5, integrator=pm.rk4, forces=[vandal])
    np.testing.assert_allclose(rollout.q, plain.q, rtol=0, atol=1e-12)


def test_what_is_no_sequence_of_forces_is_refused() -> None:
    with begun("forces is <built-in function abs>, expected a sequence of forces, such as [force]"):
        pm.simulate(ROBOT, pm.PD(1, 1), CIRCLE, dt=0.1, forces=abs)  # type: ignore[arg-type]


# -- forces on the body against their definitions, and the work that they do -----------------------


Q, V = np.array([1.0, -2.0, 0.7]), np.array([0.5, 0.3, -0.4])
EVERY: list[Any] = [
    ConstantForce((1, 2, 3)),
    SinusoidalForce((1, 2, 3), 0.7, 0.3),
    NoiseForce((1, 2, 3), 2.0, 5),
    ViscousFriction((1, 2, 3)),
    RollingResistance((1, 2, 3), 0.2),
]


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
    c, s = np.cos(Q[2]), np.sin(Q[2])
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])  # from a body twist to v
    nu = R.T @ V
    np.testing.assert_allclose(EVERY[3](0.0, Q, V), -R @ (np.array([1, 2, 3]) * nu), rtol=1e-14)
    for speed in (0.2, np.array([0.1, 0.2, 0.3])):
        pushed = np.array([1, 2, 3]) * nu / np.sqrt(nu**2 + speed**2)
        found = RollingResistance((1, 2, 3), speed)(0.0, Q, V)
        np.testing.assert_allclose(found, -R @ pushed, rtol=1e-14)


def test_friction_is_said_by_the_names_of_its_axes() -> None:
    friction: Any = ViscousFriction(forward=5, yaw=0.4)
    assert np.asarray(friction.coefficients).tolist() == [5.0, 0.0, 0.4]
    assert repr(friction) == "ViscousFriction(forward=5.0, left=0.0, yaw=0.4)"
    assert repr(eval(repr(friction))) == repr(friction) == repr(evolve(friction, coefficients=(5, 0, 0.4)))
    names = list(named(friction))
    assert names == ["coefficients", *(f"coefficients.{axis}" for axis in ("forward", "left", "yaw"))]


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
    (lambda: ViscousFriction((1, 1, 1), left=0), "left is 0, expected None with coefficients"),
    by=told,
)


# -- `JointFriction` -------------------------------------------------------------------------------


PANDA = MobileRobot.box().mount("panda")
RESTING = pm.FixedHeading(pm.Hold((0, 0), 1.0), 0.0)


def test_each_coordinate_feels_its_own() -> None:
    friction = JointFriction((0, 2, 0, 1), (0, 0, 3, 4), 0.5)
    v = np.array([5.0, -2.0, 0.5, -3.0])
    expected = [0, 4, -3 / np.sqrt(2), 3 + 4 * 3 / np.hypot(3, 0.5)]
    np.testing.assert_allclose(friction.on_coordinates(0.0, v, v), expected, rtol=1e-15)
    many = np.stack([v, -v, 0 * v])
    np.testing.assert_array_equal(friction.on_coordinates(0.0, many, many)[1], np.negative(expected) + 0.0)
    np.testing.assert_array_equal(friction.on_coordinates(0.0, many, many)[2], np.zeros(4))
    assert (JointFriction(1, 2).on_coordinates(0.0, many, many) * many <= 0).all()


def test_by_default_it_is_that_of_the_files() -> None:
    friction = JointFriction.of(PANDA)
    np.testing.assert_array_equal(friction.viscous, PANDA.joint_damping)
    np.testing.assert_array_equal(friction.coulomb, PANDA.joint_friction)
    assert np.asarray(friction.viscous).max() > 0
    assert (np.asarray(friction.viscous)[:3] == 0).all()


test_what_is_no_friction_is_refused = refusals(
    (lambda: JointFriction((1, -1)), "viscous is -1.0 N s/m or N m s/rad, expected >= 0"),
    (
        lambda: simulate(
            PANDA, law(lambda *_: np.zeros(12)), RESTING, dt=0.1, forces=[JointFriction((1, 2))]
        ),
        r"viscous has shape \(2,\), expected \(\) or \(..., 12\), as v has",
    ),
)
