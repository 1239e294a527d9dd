"""`simulate` with forces that act besides the controller's, against closed forms."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.forces import NoiseForce, SinusoidalForce
from pinmobile.integrators import constant_acceleration, semi_implicit_euler
from pinmobile.plant import Context
from tests.refusals import begun

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


def total(t: float, q: Array, v: Array) -> Array:
    return np.asarray(sum(force(t, q, v) for force in FORCES))


def test_every_sample_is_that_of_the_loop_written_by_hand() -> None:
    """The force of the controller is held, the others are asked at every stage."""
    controller, dt = pm.PD(40, 20), 0.1
    rollout = pm.simulate(ROBOT, controller, CIRCLE, dt=dt, integrator=pm.rk4, forces=FORCES, **START)
    q, v = np.array(START["q0"]), np.array(START["v0"])
    state = controller.initial_state(Context.of(ROBOT, dt=dt))
    for k in range(40):
        tau, state = controller(k * dt, q, v, CIRCLE(k * dt), state)

        def acceleration(t: float, q: Array, v: Array, tau: Array = tau) -> Array:
            push = tau + total(t, q, v) - ROBOT.nonlinear_effects(q, v)
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


def test_a_constant_force_makes_a_parabola() -> None:
    rollout = run(pm.ConstantForce((5, -3, 0.6)), constant_acceleration, 0.5)
    a, t = np.array([0.5, -0.3, 0.5]), rollout.t[:, None]
    np.testing.assert_allclose(rollout.q, START["q0"] + START["v0"] * t + a / 2 * t**2, rtol=0, atol=1e-14)
    assert rollout.max_input().tolist() == [0, 0, 0]


def fitted(off: list[float], steps: Array) -> float:
    return float(np.polyfit(np.log(steps), np.log(off), 1)[0])


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
    assert fitted(off, steps) == pytest.approx(order, abs=0.05)


@pytest.mark.parametrize(
    ("integrator", "order"), [(constant_acceleration, 1), (semi_implicit_euler, 1), (pm.rk4, 4)]
)
def test_viscous_friction_lets_the_speed_decay(integrator: Any, order: int) -> None:
    """With equal coefficients over equal inertia, v = v0 exp(-c t / m) whatever the heading."""
    steps = np.array([0.1, 0.05, 0.025])
    friction = pm.ViscousFriction((10, 10, 1.2))
    off = [
        float(np.abs(run(friction, integrator, float(dt)).v[-1] - np.array(START["v0"]) * np.exp(-4.0)).max())
        for dt in steps
    ]
    assert fitted(off, steps) == pytest.approx(order, abs=0.2)


def test_rolling_resistance_stops_the_robot_where_it_must() -> None:
    """With dv/dt = -g v / sqrt(v^2 + s^2), the distance to rest is the integral of sqrt(v^2 + s^2) / g dv."""
    force, options = pm.RollingResistance((20, 0, 0), 0.05), {"q0": (0, 0, 0), "v0": (1, 0, 0)}
    rollout = pm.simulate(BALANCED, NOTHING, CIRCLE, dt=0.01, integrator=pm.rk4, forces=[force], **options)  # type: ignore[arg-type]
    distance = (np.hypot(1, 0.05) + 0.05**2 * np.arcsinh(1 / 0.05)) / (2 * 2)
    # After 4 s exp(-(4 - 0.5) 2 / 0.05) of the speed is left; h g / s = 0.4 at the end, to the fourth power.
    assert rollout.q[-1, 0] == pytest.approx(distance, abs=1e-6)
    assert abs(rollout.v[-1, 0]) < 1e-12


def test_friction_takes_exactly_the_energy_that_is_lost() -> None:
    rollout = run(pm.ViscousFriction((2, 8, 0.5)), pm.rk4, 0.01, ROBOT)
    power = np.sum(FORCES[3](rollout.t, rollout.q, rollout.v) * rollout.v, axis=1)
    energy = ROBOT.kinetic_energy(rollout.q, rollout.v)
    work = np.sum((power[:-1] + power[1:]) / 2) * 0.01
    # The trapezoidal rule: (T / 12) h^2 |power''|, with power'' of order 1 W/s^2.
    assert energy[-1] - energy[0] == pytest.approx(work, abs=1e-4)
    assert (np.diff(energy) < 0).all()


def test_a_force_cannot_write_into_the_record() -> None:
    def vandal(t: float, q: Array, v: Array) -> Array:
        q[:] = v[:] = 99
        return np.zeros(3)

    plain = pm.simulate(ROBOT, pm.PD(9, 9), CIRCLE, dt=0.5, integrator=pm.rk4)
    rollout = pm.simulate(ROBOT, pm.PD(9, 9), CIRCLE, dt=0.5, integrator=pm.rk4, forces=[vandal])
    np.testing.assert_allclose(rollout.q, plain.q, rtol=0, atol=1e-12)


def test_a_force_that_is_not_a_number_is_divergence_with_everything_before_it() -> None:
    def fails(t: float, q: Array, v: Array) -> Array:
        return np.full(3, np.nan if t > 1.05 else 0.0)

    with pytest.raises(pm.Diverged, match=r"at t = 1\.1 s .*: a not finite") as caught:
        pm.simulate(ROBOT, pm.PD(9, 9), CIRCLE, dt=0.1, forces=[fails])
    assert len(caught.value.rollout) == 11


def test_what_is_no_sequence_of_forces_is_refused() -> None:
    with begun("forces is <built-in function abs>, expected a sequence of forces, such as [force]"):
        pm.simulate(ROBOT, pm.PD(1, 1), CIRCLE, dt=0.1, forces=abs)  # type: ignore[arg-type]
