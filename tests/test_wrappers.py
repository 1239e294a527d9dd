"""Limits, delay and measurement noise around a controller, and laws at a slower rate."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import MobileRobot, Tangent, UnicycleTracking, WheeledRobot, WheelTable, simulate
from pinmobile.arrays import Array
from pinmobile.controllers import ControlAllocation, InputDelay, Sampled, TorqueToVoltage, WheelSpeed
from pinmobile.plant import Context
from tests.parts import PID, Points
from tests.refusals import refusals
from tests.test_simulation import TauAlone

ROBOT = pm.MobileRobot(10, 1.2, com=(0.15, 0.05))
CIRCLE = pm.FixedHeading(pm.Circle(1.0, 0.5, 12.0), 0.3)
START: dict[str, Any] = {"q0": (0.2, -0.1, 0.9), "v0": (0.1, 0.0, -0.4)}
REST = pm.Reference(*np.zeros((3, 3)))
CONTEXT = Context.of(ROBOT, dt=0.1)
TOLD = pm.law(lambda t, q, v, reference: q)  # its force is the configuration that it is told of


class Counter:
    """A controller with memory: its force is the number of times it was asked before."""

    def initial_state(self, context: Any) -> int:
        return 0

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: int) -> tuple[Array, int]:
        return np.full(3, float(state)), state + 1


def asked(controller: Any, qs: Array, vs: Array | None = None) -> Array:
    """Return the force at each sample, as a loop of the user's own would get it."""
    state, forces = controller.initial_state(CONTEXT), []
    for k, q in enumerate(qs):
        tau, state = controller(0.1 * k, q, np.zeros(3) if vs is None else vs[k], REST, state)
        forces.append(tau)
    return np.array(forces)


QS, VS = np.random.default_rng(0).normal(size=(2, 600, 3))


def test_a_force_beyond_its_limit_is_the_limit() -> None:
    forces = asked(pm.InputSaturation(TOLD, (0.5, 1, np.inf)), QS)
    np.testing.assert_array_equal(forces, np.clip(QS, [-0.5, -1, -np.inf], [0.5, 1, np.inf]))
    np.testing.assert_array_equal(asked(pm.InputSaturation(TOLD, 0.5), QS), np.clip(QS, -0.5, 0.5))
    assert np.isnan(asked(pm.InputSaturation(TOLD, 1), np.full((1, 3), np.nan))).all()


def test_delays_of_state_and_input_are_that_many_samples() -> None:
    for samples in (0, 1, 3):
        expected = QS[np.maximum(np.arange(600) - samples, 0)]
        for delayed in (InputDelay, pm.MeasurementDelay):
            np.testing.assert_array_equal(asked(delayed(TOLD, samples), QS), expected)
    both = asked(pm.MeasurementDelay(pm.law(lambda t, q, v, reference: v), 2), QS, VS)
    np.testing.assert_array_equal(both, VS[np.maximum(np.arange(600) - 2, 0)])
    inner = pm.ComputedTorque(ROBOT, 4, 4)
    late = pm.simulate(ROBOT, InputDelay(inner, 3), CIRCLE, dt=0.1, **START)
    for k in (0, 2, 3, 50):
        j = max(k - 3, 0)
        reference = pm.Reference(*(part[j] for part in late.reference))
        expected, _ = inner(0.0, late.q[j], late.v[j], reference, None)
        np.testing.assert_allclose(late.u[k], expected, rtol=0, atol=1e-13)


BASE = pm.MobileRobot(30, 1.3, com=(0, 0, 0.1))
WHEEL: Any = {"motor": pm.Motor(resistance=1.0, torque_constant=0.05, voltage=24, gear=50), "mass": 1.0}
MECANUM = pm.WheeledRobot(BASE, pm.WheelTable.mecanum(0.4, 0.35, 0.08, spin_inertia=0.003, **WHEEL))
INTEGRALS: dict[str, tuple[Any, Any]] = {
    "late": (ROBOT, InputDelay(pm.PID(ROBOT), 3)),
    "late and limited": (ROBOT, InputDelay(pm.InputSaturation(pm.PID(ROBOT), 20), 3)),
    "late twice": (ROBOT, InputDelay(InputDelay(pm.PID(ROBOT), 1), 2)),
    "observed and late": (ROBOT, InputDelay(pm.DisturbanceObserver(pm.PID(ROBOT)), 1)),
    "late and sampled": (ROBOT, InputDelay(Sampled(pm.PID(ROBOT), 2), 2)),
    "sampled and late": (ROBOT, Sampled(InputDelay(pm.PID(ROBOT), 1), 2)),
    "observed": (ROBOT, pm.DisturbanceObserver(pm.InputSaturation(pm.PID(ROBOT), 30))),
    "by wheels": (MECANUM, ControlAllocation(pm.PID(BASE), MECANUM)),
    "by volts": (MECANUM.by_voltage(), TorqueToVoltage(ControlAllocation(pm.PID(BASE), MECANUM), MECANUM)),
}


@pytest.mark.parametrize("name", INTEGRALS)
def test_an_integral_removes_the_error_of_a_force_inside_each_wrapper(name: str) -> None:
    """Without the integral, 9 N leave 6 to 19 mm: 9 N / (30 or 10 kg) / 48."""
    plant, controller = INTEGRALS[name]
    still, push = pm.FixedHeading(pm.Hold([0, 0], 12.0), 0.0), [pm.ConstantForce([9, -6, 0.4])]
    loop: Any = {"dt": 0.01, "forces": push}
    run = pm.simulate(plant, controller, still, engine=pm.Engine.COMPILED, **loop)
    assert np.abs(run.error[-1]).max() < 1e-5  # e^-4t, slower by volts
    begin = pm.simulate(plant, controller, still, engine=pm.Engine.PYTHON, duration=2.0, **loop)
    np.testing.assert_allclose(begin.q, run.q[:201], rtol=0, atol=1e-12)


def test_an_integral_and_an_estimate_behind_a_delay_stop_at_limits_alone() -> None:
    still, push = pm.FixedHeading(pm.Hold([0, 0], 4.0), 0.0), [pm.ConstantForce([30, 0, 0])]
    limited = pm.InputSaturation(InputDelay(pm.PID(ROBOT), 3), 20)
    run = pm.simulate(ROBOT, limited, still, dt=0.01, forces=push)
    at_limit = np.abs(run.u[:, 0]) == 20
    assert at_limit[200:].all()
    steps = np.diff(run.signals["integral"].values, axis=0)[at_limit[1:]]
    np.testing.assert_allclose(steps, 0.0, atol=1e-16)  # the last increment is added and taken back
    law, path = pm.Adaptive(pm.MobileRobot(20, 1.3)), pm.Tangent(pm.Circle(0.4, 2.0, 20.0))
    late = pm.simulate(BASE, InputDelay(law, 1), path, dt=0.01, engine=pm.Engine.COMPILED)
    at_once = pm.simulate(BASE, law, path, dt=0.01, engine=pm.Engine.COMPILED)
    masses = [each.signals["mass"].values[-1] for each in (late, at_once)]
    assert masses[0] == pytest.approx(masses[1], rel=0.02)
    assert masses[0] > 25


def test_the_reference_is_not_delayed() -> None:
    seen = pm.law(lambda t, q, v, reference: reference.q)
    rollout = pm.simulate(ROBOT, pm.MeasurementDelay(seen, 4), CIRCLE, dt=0.1, duration=1.0)
    np.testing.assert_array_equal(rollout.u, rollout.reference.q)


def drawn(controller: Any, samples: int) -> Array:
    """Return the noise of a controller at each sample, shape (samples, 2 nv)."""
    noise, rows = controller.initial_state(CONTEXT)[1], []
    for _ in range(samples):
        row, noise = noise.draw()
        rows.append(row)
    return np.array(rows)


def test_noise_is_the_contexts_and_follows_from_its_seed_and_the_sample() -> None:
    controller = pm.MeasurementNoise(TOLD, (0.1, 0.2, 0.3), 0, seed=7)
    table, noisy = drawn(controller, 600), asked(controller, QS)
    np.testing.assert_array_equal(noisy, QS + table[:, :3] * [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(asked(controller, QS), noisy)  # a second run is the first
    same = pm.law(lambda t, q, v, reference: v)
    rates = pm.MeasurementNoise(same, 0, 2.0, np.random.SeedSequence(7))
    np.testing.assert_array_equal(asked(rates, QS, VS), VS + 2 * table[:, 3:])
    assert not np.isin(table, drawn(pm.MeasurementNoise(TOLD, 1, 1, seed=8), 600)).any()
    # Moments of 3600 standard normal numbers, to four of their own standard deviations.
    for power, moment, spread in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs((table**power).mean() - moment) < 4 * np.sqrt(spread / table.size)
    # No two of the six are correlated.
    assert np.abs(np.corrcoef(table.T) - np.eye(6)).max() < 4 / np.sqrt(600)


KINOVA = pm.MobileRobot.box().mount("kinova")  # four of its joints are continuous


@pytest.mark.parametrize(
    "inner",
    [pm.PD(9, 6), pm.InputSaturation(pm.MeasurementDelay(pm.ComputedTorque(KINOVA, 9, 6), 0), 1e9)],
    ids=["PD", "within others"],
)
def test_noise_moves_the_joints_of_an_arm(inner: Any) -> None:
    rng, std = np.random.default_rng(2), np.linspace(0.1, 0.9, 9)
    q, v = KINOVA.random_configuration(rng, (4,)), rng.normal(size=(4, 9))
    at = pm.Reference(*np.zeros((3, 9)))
    noisy = pm.MeasurementNoise(inner, std, 0.2, seed=7)
    tau, _ = noisy(0.0, q, v, at, noisy.initial_state(Context.of(KINOVA, dt=0.1)))
    row: Any = noisy.initial_state(Context.of(KINOVA, dt=0.1))[1].draw()[0]
    told = KINOVA.integrate(q, std * row[:9]), v + 0.2 * row[9:]
    expected, _ = inner(0.0, *told, at, inner.initial_state(Context.of(KINOVA, dt=0.1)))
    np.testing.assert_array_equal(tau, expected)


def test_they_nest_in_any_order_and_so_do_their_states() -> None:
    """A delay outside of the noise delays the state and not the noise."""
    noise = drawn(pm.MeasurementNoise(TOLD, 1, 0, 7), 600)[:, :3]
    old = np.maximum(np.arange(600) - 2, 0)
    outside = asked(pm.MeasurementDelay(pm.MeasurementNoise(TOLD, 1, 0, 7), 2), QS)
    np.testing.assert_array_equal(outside, QS[old] + noise)
    inside = asked(pm.MeasurementNoise(pm.MeasurementDelay(TOLD, 2), 1, 0, 7), QS)
    np.testing.assert_array_equal(inside, (QS + noise)[old])
    controller = pm.InputSaturation(pm.MeasurementNoise(pm.MeasurementDelay(Counter(), 1), 1, 1, 0), 3)
    assert asked(controller, QS[:6])[:, 0].tolist() == [0, 1, 2, 3, 3, 3]


def test_what_is_applied_is_told_inward_once_a_sample() -> None:
    seen: list[tuple[float, list[float]]] = []

    class Told:
        def initial_state(self, context: Context) -> int:
            return 0

        def __call__(self, t: float, q: Array, v: Array, reference: Any, state: int) -> tuple[Array, int]:
            return np.array([5.0, -5.0, 0.1]), state

        def applied(self, u: Array, state: int) -> int:
            seen.append((state, u.tolist()))
            u[:] = 99  # its own copy
            return state + 1

    nested = pm.InputSaturation(
        pm.MeasurementDelay(pm.MeasurementNoise(pm.InputSaturation(Told(), 3.0), 0, 0, 1), 2), (2.0, 9.0, 9.0)
    )
    rollout = pm.simulate(ROBOT, nested, CIRCLE, dt=0.5, duration=2.0, substeps=3, integrator=pm.rk4)
    assert seen == [(k, [2.0, -3.0, 0.1]) for k in range(5)]
    np.testing.assert_array_equal(rollout.u, [[2.0, -3.0, 0.1]] * 5)


def once(controller: Any) -> Any:
    return controller(0.5, np.zeros(3), np.zeros(3), REST, controller.initial_state(CONTEXT))


DRAWS: Any = np.random.default_rng(0)
test_what_does_not_fit_is_refused = refusals(
    (
        lambda: pm.MeasurementDelay(pm.ComputedTorque, 1),
        r"^controller is <class '.*\.ComputedTorque'>, expected an object: ComputedTorque\(\.\.\.\)",
    ),
    (
        lambda: once(pm.InputSaturation(TOLD, (1, 2))),
        r"^limits has shape \(2,\), expected \(\) or \(..., 3\)",
    ),
    (
        lambda: pm.MeasurementNoise(TOLD, 1, 1, DRAWS),
        r"^seed is Generator\(PCG64\) at 0x\w+, expected a whole number >= 0",
    ),
    (lambda: once(pm.MeasurementDelay(TauAlone(), 1)), r"^controller returned array\(\[0., 0., 0.\]\) at t"),
)


# -- `Sampled` -------------------------------------------------------------------------------------


HEAVIER = MobileRobot(mass=30.0, yaw_inertia=1.3, com=(0.1, 0.05))
PATH = Tangent(pm.Circle(1.0, 0.5, 2.0))


LAWS: dict[str, Any] = {
    "memory": PID(60.0, 9.0, 20.0),
    "informed": pm.DisturbanceObserver(pm.ComputedTorque(HEAVIER)),
    "observer": pm.ADRC(HEAVIER, bandwidth=2.0, observer=8.0),
    "schedule": pm.LQR(HEAVIER),
    "delay": pm.MeasurementDelay(pm.PD(40, 40), 2),
    "noise": pm.MeasurementNoise(pm.PD(60, 60), 1e-3, 1e-3, seed=3),
    "twice": Sampled(pm.PD(60, 60), 2),
}
DT, EVERY, COUNT = 0.001, 5, 600


def by_hand(law: Any) -> tuple[Any, Any]:
    """Return q and u of a loop of `Points`, in which the law runs at each fifth sample."""
    t = DT * np.arange(COUNT + 1)
    reference, plant = PATH(t), Points()
    own: Any = {"t": t[::EVERY], "reference": pm.Reference(*(x[::EVERY] for x in reference))}
    memory = law.initial_state(Context.of(plant, dt=EVERY * DT, trajectory=PATH, **own))
    q, v, places, inputs = np.zeros(3), np.zeros(3), [], []
    for k in range(COUNT + 1):
        if k % EVERY == 0:
            at = pm.Reference(*(x[k] for x in reference))
            u, memory = law(t[k], q, v, at, memory)
            if hasattr(law, "applied"):
                memory = law.applied(u, memory)
        places.append(q)
        inputs.append(u)
        q, v = q + (DT * v + (0.5 * DT * DT) * u), v + DT * u
    return np.array(places), np.array(inputs)


@pytest.mark.parametrize(
    ("name", "engine"),
    [
        ("memory", pm.Engine.COMPILED),
        ("delay", pm.Engine.COMPILED),
        ("twice", pm.Engine.COMPILED),
        ("twice", pm.Engine.PYTHON),
    ],
)
def test_it_is_a_loop_written_by_hand_bit_for_bit(name: str, engine: pm.Engine) -> None:
    law: Any = LAWS[name]
    places, inputs = by_hand(law)
    still: Any = {"q0": np.zeros(3), "v0": np.zeros(3)}
    run = simulate(Points(), Sampled(law, EVERY), PATH, dt=DT, duration=COUNT * DT, engine=engine, **still)
    np.testing.assert_array_equal(run.u, inputs)
    np.testing.assert_array_equal(run.q, places)
    assert len(np.unique(run.u[:, 0])) > COUNT // EVERY // 2


@pytest.mark.parametrize("name", ["informed", "observer", "schedule", "noise"])
def test_engines_agree_on_a_robot(name: str) -> None:
    law = Sampled(LAWS[name], EVERY)
    one, other = (
        simulate(HEAVIER, law, PATH, dt=DT, duration=COUNT * DT, q0=(0.05, 0, 0), v0=(0, 0, 0), engine=engine)
        for engine in (pm.Engine.COMPILED, pm.Engine.PYTHON)
    )
    np.testing.assert_allclose(one.q, other.q, atol=1e-11)
    held = one.u[: len(one) // EVERY * EVERY].reshape(-1, EVERY, 3)
    np.testing.assert_array_equal(held, held[:, :1] + 0 * held)


def test_a_slow_kinematic_law_runs_inside_a_fast_one() -> None:
    table = WheelTable.differential(0.5, 0.1, mass=1.0, spin_inertia=0.005)
    robot = WheeledRobot(HEAVIER, table)
    start: Any = {"dt": DT, "duration": 0.3, "q0": (0.05, 0.02, 0, 0, 0)}
    law, slow = UnicycleTracking(), Sampled(UnicycleTracking(), 10)
    fast, one, other = (
        simulate(robot, WheelSpeed(each, robot, kp=5), PATH, **start, engine=engine)
        for each, engine in zip((law, slow, slow), (*[pm.Engine.COMPILED] * 2, pm.Engine.PYTHON), strict=True)
    )
    np.testing.assert_allclose(one.q, other.q, atol=1e-11)
    assert 0 < np.abs(fast.error[-1, :2] - one.error[-1, :2]).max() < 5e-3  # at most 0.01 s late, at 0.5 m/s


def test_a_held_kinematic_law_steers_a_car() -> None:
    wheels: Any = {"mass": 1.0, "spin_inertia": 0.005, "yaw_inertia": 0.003}
    car = WheeledRobot(MobileRobot(30.0, 1.3, com=(0.2, 0)), WheelTable.car(0.5, 0.4, 0.1, **wheels))
    law = pm.Backstepping(Sampled(UnicycleTracking(), 5), car)
    aside = simulate(car, law, PATH, dt=0.01, duration=0.01).q[0] + np.array([0.02, 0.01, 0, 0, 0, 0, 0, 0])
    one = simulate(car, law, PATH, dt=0.01, q0=aside, engine=pm.Engine.COMPILED)
    begin = simulate(car, law, PATH, dt=0.01, q0=aside, duration=0.6, engine=pm.Engine.PYTHON)
    np.testing.assert_allclose(one.q[:61], begin.q, atol=1e-11)
    assert np.abs(one.error[-1, :2]).max() < 0.3 * 0.02


def test_a_law_in_python_runs_only_when_its_sample_is_due() -> None:
    calls = []

    def slow(t: float, q: Any, v: Any, reference: Any) -> Any:
        calls.append(float(t))
        return 60 * (reference.q - q) + 60 * (reference.v - v)

    simulate(HEAVIER, Sampled(pm.law(slow), 10), PATH, dt=DT, duration=0.1, engine=pm.Engine.PYTHON)
    np.testing.assert_allclose(calls[-11:], np.arange(0, 0.101, 0.01))
