"""`Sampled`: a law at a slower rate, compared with loops written by hand."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import MobileRobot, Tangent, UnicycleTracking, WheeledRobot, WheelTable, simulate
from pinmobile.controllers import Sampled, WheelSpeed
from pinmobile.plant import Context

ROBOT = MobileRobot(mass=30.0, yaw_inertia=1.3, com=(0.1, 0.05))
PATH = Tangent(pm.Circle(1.0, 0.5, 2.0))


class Integral:
    """Law with an integral, which knows its own time step and the applied input."""

    def initial_state(self, context: Any) -> Any:
        return np.zeros(3), np.zeros(3), float(context.dt)

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        total, before, dt = state
        total = total + dt * (reference.q - q) - 1e-4 * before
        return 60 * (reference.q - q) + 20 * (reference.v - v) + 9 * total, (total, before, dt)

    def applied(self, u: Any, state: Any) -> Any:
        return state[0], u, state[2]


LAWS: dict[str, Any] = {
    "memory": Integral(),
    "informed": pm.DisturbanceObserver(pm.ComputedTorque(ROBOT)),
    "observer": pm.ADRC(ROBOT, bandwidth=2.0, observer=8.0),
    "schedule": pm.LQR(ROBOT),
    "delay": pm.MeasurementDelay(pm.PD(40, 40), 2),
    "noise": pm.MeasurementNoise(pm.PD(60, 60), 1e-3, 1e-3, seed=3),
    "twice": Sampled(pm.PD(60, 60), 2),
}
DT, EVERY, COUNT = 0.001, 5, 600


class Points:
    """Three unit masses, whose arithmetic is the same in every engine."""

    nq = nv = nu = 3

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        return u + f

    def integrate(self, q: Any, dq: Any) -> Any:
        return q + dq

    def difference(self, q0: Any, q1: Any) -> Any:
        return q1 - q0


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
        simulate(ROBOT, law, PATH, dt=DT, q0=(0.05, 0, 0), v0=(0, 0, 0), engine=engine)
        for engine in (pm.Engine.COMPILED, pm.Engine.PYTHON)
    )
    np.testing.assert_allclose(one.q, other.q, atol=1e-11)
    held = one.u[: len(one) // EVERY * EVERY].reshape(-1, EVERY, 3)
    np.testing.assert_array_equal(held, held[:, :1] + 0 * held)


def test_a_slow_kinematic_law_runs_inside_a_fast_one() -> None:
    table = WheelTable.differential(0.5, 0.1, mass=1.0, spin_inertia=0.005)
    robot = WheeledRobot(ROBOT, table)
    start: Any = {"dt": DT, "duration": 0.3, "q0": (0.05, 0.02, 0, 0, 0)}
    errors = []
    for law in (UnicycleTracking(), Sampled(UnicycleTracking(), 10)):
        one, other = (
            simulate(robot, WheelSpeed(law, robot, kp=5), PATH, **start, engine=engine)
            for engine in (pm.Engine.COMPILED, pm.Engine.PYTHON)
        )
        np.testing.assert_allclose(one.q, other.q, atol=1e-11)
        errors.append(one.error[-1, :2])
    assert 0 < np.abs(errors[0] - errors[1]).max() < 5e-3  # at most 0.01 s late, at 0.5 m/s


def test_a_held_kinematic_law_steers_a_car() -> None:
    wheels: Any = {"mass": 1.0, "spin_inertia": 0.005, "yaw_inertia": 0.003}
    car = WheeledRobot(MobileRobot(30.0, 1.3, com=(0.2, 0)), WheelTable.car(0.5, 0.4, 0.1, **wheels))
    law = pm.Backstepping(Sampled(UnicycleTracking(), 5), car)
    aside = simulate(car, law, PATH, dt=0.01, duration=0.01).q[0] + np.array([0.02, 0.01, 0, 0, 0, 0, 0, 0])
    one, other = (
        simulate(car, law, PATH, dt=0.01, q0=aside, engine=engine)
        for engine in (pm.Engine.COMPILED, pm.Engine.PYTHON)
    )
    np.testing.assert_allclose(one.q, other.q, atol=1e-11)
    assert np.abs(one.error[-1, :2]).max() < 0.3 * 0.02


def test_a_law_in_python_runs_only_when_its_sample_is_due() -> None:
    calls = []

    def slow(t: float, q: Any, v: Any, reference: Any) -> Any:
        calls.append(float(t))
        return 60 * (reference.q - q) + 60 * (reference.v - v)

    simulate(ROBOT, Sampled(pm.law(slow), 10), PATH, dt=DT, duration=0.1, engine=pm.Engine.PYTHON)
    np.testing.assert_allclose(calls[-11:], np.arange(0, 0.101, 0.01))
