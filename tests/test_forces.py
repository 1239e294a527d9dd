"""`simulate` with forces that act besides the controller's, against closed forms."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.forces import NoiseForce, SinusoidalForce
from pinmobile.integrators import constant_acceleration, semi_implicit_euler
from pinmobile.plant import Context

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
ORDERS = [(constant_acceleration, 1), (semi_implicit_euler, 1), (pm.rk4, 4)]
INTEGRATORS = [constant_acceleration, semi_implicit_euler, pm.rk4]


class OtherPlant:
    """A plant that is only what the protocol asks for, with `extra` coordinates that stay at rest."""

    def __init__(self, extra: int = 0) -> None:
        self.nq = self.nv = self.nu = 3 + extra
        self.asked: list[Array] = []

    def forward_dynamics(self, q: Array, v: Array, u: Array, f: Any = 0.0) -> Array:
        self.asked.append(u + f)
        return np.append(ROBOT.forward_dynamics(q[:3], v[:3], (u + f)[:3]), u[3:])

    def integrate(self, q: Array, dq: Array) -> Array:
        return q + dq

    def difference(self, q0: Array, q1: Array) -> Array:
        return q1 - q0

    def pose(self, q: Array) -> Array:
        return q[:3]

    def pose_rate(self, q: Array, v: Array) -> Array:
        return v[:3]

    def generalized_force(self, q: Array, wrench: Array) -> Array:
        return np.append(wrench, np.zeros(self.nv - 3))


def total(t: float, q: Array, v: Array) -> Array:
    return np.asarray(sum(force(t, q, v) for force in FORCES))


def asked(controller: Any) -> Any:
    return pm.law(lambda t, q, v, reference: controller(t, q, v, reference, None)[0])


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("substeps", [1, 3])
def test_every_way_through_the_loop_is_the_same(integrator: Any, substeps: int) -> None:
    def users(acceleration: Any, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
        return integrator(acceleration, t, q, v, dt)  # type: ignore[no-any-return]

    controller = pm.ComputedTorque(pm.MobileRobot(8, 1), 3, (2, 3, 4))
    options: dict[str, Any] = {"dt": 0.05, "substeps": substeps, "forces": FORCES, **START}
    own = pm.simulate(ROBOT, controller, CIRCLE, integrator=integrator, **options)
    for plant in (ROBOT, OtherPlant()):
        for step in (integrator, users):
            other = pm.simulate(plant, asked(controller), CIRCLE, integrator=step, **options)
            for name in ("q", "v", "a", "u"):
                # The same sums in another order, over 80 steps; noise asked at times that differ by rounding.
                np.testing.assert_allclose(getattr(other, name), getattr(own, name), rtol=0, atol=1e-11)


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


def test_an_integrator_that_looks_ahead_sees_the_force_that_will_be() -> None:
    def ahead(acceleration: Any, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
        return q, v + dt * acceleration(t + dt, q, v)

    ramp = [lambda t, q, v: np.array([10 * t, 0, 0])]
    rollout = pm.simulate(
        BALANCED, NOTHING, CIRCLE, dt=0.5, integrator=ahead, forces=ramp, q0=(0, 0, 0), v0=(0, 0, 0)
    )
    np.testing.assert_allclose(rollout.v[:, 0], np.cumsum([0, *(0.5 * rollout.t[1:])]), rtol=1e-14)


def test_a_force_acts_on_the_first_three_coordinates_of_a_plant_with_more() -> None:
    class Trajectory:
        duration = 4.0

        def __call__(self, t: Any) -> Any:
            padded = [np.pad(part, ((0, 0), (0, 2))) for part in CIRCLE(t)]
            return type(CIRCLE(0.0))(*padded)

    seen: list[tuple[Any, Any]] = []

    def force(t: float, q: Array, v: Array) -> Array:
        seen.append((q.shape, v.shape))
        return np.array([1.0, 2.0, 3.0])

    plant, silent = OtherPlant(extra=2), pm.law(lambda *_: np.arange(5.0))
    pm.simulate(plant, silent, Trajectory(), dt=0.1, duration=0.2, forces=[force])
    # Before the loop it is asked for the shape of its answer, without input.
    assert {tuple(u) for u in plant.asked} - {(0, 0, 0, 0, 0)} == {(1, 3, 5, 3, 4)}
    assert set(seen) == {((3,), (3,))}


def test_a_force_cannot_write_into_the_record() -> None:
    def vandal(t: float, q: Array, v: Array) -> Array:
        q[:] = v[:] = 99
        return np.zeros(3)

    plain = pm.simulate(ROBOT, pm.PD(9, 9), CIRCLE, dt=0.5, integrator=pm.rk4)
    for plant in (ROBOT, OtherPlant()):
        rollout = pm.simulate(plant, pm.PD(9, 9), CIRCLE, dt=0.5, integrator=pm.rk4, forces=[vandal])
        np.testing.assert_allclose(rollout.q, plain.q, rtol=0, atol=1e-12)


def test_a_force_that_is_not_a_number_is_divergence_with_everything_before_it() -> None:
    def fails(t: float, q: Array, v: Array) -> Array:
        return np.full(3, np.nan if t > 1.05 else 0.0)

    with pytest.raises(pm.Diverged, match=r"at t = 1\.1 s .*: a not finite") as caught:
        pm.simulate(ROBOT, pm.PD(9, 9), CIRCLE, dt=0.1, forces=[fails])
    assert len(caught.value.rollout) == 11


class Rubber:
    """A force on coordinates of another number."""

    def on_coordinates(self, t: float, q: Array, v: Array) -> Array:
        return np.zeros(2)


class Rail(OtherPlant):
    """A plant whose body cannot be pushed."""

    generalized_force = None  # type: ignore[assignment]


class Deaf(OtherPlant):
    """A plant that takes no forces beside its input."""

    def forward_dynamics(self, q: Array, v: Array, u: Array) -> Array:  # type: ignore[override]
        return u


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        (
            {"forces": abs},
            "forces is <built-in function abs>, expected a sequence of forces, such as [force]",
        ),
        ({"forces": 3}, "forces is 3, expected a sequence of forces"),
        ({"forces": [FORCES[0], (1, 2, 3)]}, "forces[1] is (1, 2, 3), expected a function of t, q and v"),
        (
            {"forces": [pm.ViscousFriction]},
            "forces[0] is <class 'pinmobile.forces.ViscousFriction'>, expected a function of t, q and v",
        ),
        (
            {"forces": [FORCES[0], lambda *_: np.zeros(2)]},
            "forces[1] returned array([0., 0.]) at t = 0 s, expected an array of shape (3,)",
        ),
        (
            {"plant": Rail(), "forces": FORCES},
            ", which has no generalized_force, and forces push its body, expected a plant whose "
            "body can be pushed: "
            "pose(q), pose_rate(q, v) and generalized_force(q, wrench)",
        ),
        (
            {"plant": Deaf(), "forces": FORCES},
            "which cannot be called as plant.forward_dynamics(q, v, u, f): too many positional arguments",
        ),
        (
            {"forces": [Rubber()]},
            "forces[0].on_coordinates returned array([0., 0.]) at t = 0 s, expected an array of shape (3,)",
        ),
    ],
)
def test_forces_that_do_not_fit_are_refused(changed: dict[str, Any], text: str) -> None:
    arguments: dict[str, Any] = {"plant": ROBOT, "controller": pm.PD(1, 1), "trajectory": CIRCLE, "dt": 0.1}
    with pytest.raises(pm.InvalidArgument) as caught:
        pm.simulate(**(arguments | changed))
    assert text in str(caught.value)
