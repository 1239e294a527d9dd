"""Controllers for a model that is wrong: against their theory, and all engines."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.controllers.controller import passive_torque
from pinmobile.parts import find, replace
from pinmobile.plant import Context
from tests import rivals
from tests.parts import Waving
from tests.refusals import refusals
from tests.rivals import ARM, CIRCLE, HEAVY, NOMINAL, RIVALS, SHORT

FAST: Any = {"integrator": pm.rk4, "engine": pm.Engine.COMPILED}
LIMITS = (22.0, 22.0, 3.0)
NAMES = "PID", "sliding mode", "super-twisting", "adaptive", "adaptive, friction", "observer", "ADRC"
EACH: Mapping[str, Any] = {name: RIVALS[name] for name in NAMES}
# Where draws of the noise decide, or where bounds of estimates and the speed of friction had not been stated.
OTHERS = {("adaptive, friction", "friction"): 0.42, ("super-twisting", "noise"): 0.4, ("ADRC", "noise"): 0.25}


@pytest.mark.long
@pytest.mark.once
def test_errors_and_chatter_are_those_of_an_independent_implementation(tmp_path: Path) -> None:
    """A sweep of controllers in cases: latency costs all the same, switching buys accuracy by chatter."""
    found = rivals.swept(tmp_path / "store")
    within = 1e3 * found.error_quantile()
    for name in RIVALS:
        printed, chatter = rivals.PUBLISHED[name]
        for case, wanted in zip(rivals.CASES, printed.split(), strict=True):
            share = OTHERS.get((name, case), 0.15 if case in ("noise", "all") else 0.02)
            largest = float(within.sel({rivals.LAW: name, "case": case}))
            assert not rivals.differs(largest, wanted, share), (name, case, largest)
        if name in ("computed torque", "sliding mode", "observer"):
            run = rivals.traced(found.ensemble(**{rivals.LAW: name, "case": "noise"}))
            assert rivals.chatter(run) == pytest.approx(chatter, rel=0.15), name
    assert found.answer().startswith(
        "from t = 5 s on, with case = delay, PD diverges, computed torque stays within 27.2 mm"
    )


def test_torque_keeps_the_robot_passive_and_is_what_the_regressor_says() -> None:
    generator = np.random.default_rng(3)
    for robot in (NOMINAL, ARM):
        q = robot.random_configuration(generator, (4,))
        v, velocity, acceleration = generator.normal(size=(3, 4, robot.nv))
        wanted = (
            np.einsum("kij,kj->ki", robot.mass_matrix(q), acceleration)
            + np.einsum("kij,kj->ki", robot.coriolis_matrix(q, v), velocity)
            + robot.gravity(q)
        )
        found = passive_torque(robot, q, v, velocity, acceleration)
        scale = np.abs(wanted).max()
        assert np.abs(found - wanted).max() < 1e-13 * scale
        adaptive = pm.Adaptive(robot)
        Y = adaptive._regressor(q, v, velocity, acceleration)
        assert np.abs(Y @ adaptive._nominal - wanted).max() < 1e-13 * scale


class Rich:
    """All coordinates to and fro, with frequencies of their own."""

    duration = 40.0

    def __call__(self, t: Any) -> pm.Reference:
        t = np.asarray(t)
        size, rate, phase = np.array([1.2, 0.8, 0.8]), np.array([0.9, 1.3, 0.7]), np.array([0, 0.4, 0])
        angle = rate * t[..., None] + phase
        return pm.Reference(
            size * np.sin(angle), size * rate * np.cos(angle), -size * rate**2 * np.sin(angle)
        )


def test_estimates_become_right_where_the_motion_is_rich_and_not_on_a_circle() -> None:
    true = np.array([36.0, 3.6, 1.8, 1.56 + 36 * (0.1**2 + 0.05**2)])

    def last(trajectory: Any) -> Array:
        told = pm.simulate(HEAVY, EACH["adaptive"], trajectory, dt=0.01, duration=30.0, **FAST).signals
        parts = [told[name].values[-1] for name in ("mass", "first_moment", "inertia")]
        return np.hstack(parts)

    rich, circle = last(Rich()), last(CIRCLE)
    assert abs(rich[0] - 36) < 0.2
    assert np.abs(rich[1:3] - true[1:3]).max() < 0.15
    # Four numbers of which a circle at constant speed shows two: the mass stays far from what it is.
    assert abs(circle[0] - 36) > 5 * abs(rich[0] - 36)


def test_the_sum_of_squares_of_adaptive_control_falls_in_each_step() -> None:
    start: Any = {"q0": Rich()(0.0).q + np.array([0.1, -0.05, 0.1]), "v0": Rich()(0.0).v}
    law = pm.Adaptive(NOMINAL, kd=(120.0, 120.0, 6.0))
    run = pm.simulate(HEAVY, law, Rich(), dt=2e-4, duration=1.0, **start, **FAST)
    told = run.signals
    phi = np.column_stack([told["mass"].values, told["first_moment"].values, told["inertia"].values])
    true = np.array([36.0, 3.6, 1.8, 1.56 + 36 * (0.1**2 + 0.05**2)])
    gamma = np.array([2 / 3, 1 / 15, 1 / 15, 1 / 50]) * 30
    s = run.reference.v - run.v + 4 * (run.reference.q - run.q)
    kinetic = np.einsum("ki,kij,kj->k", s, HEAVY.mass_matrix(run.q), s) / 2
    # A signal is told after its sample, when the estimate has been brought on.
    total = kinetic[1:] + ((phi - true) ** 2 / gamma).sum(axis=-1)[:-1] / 2
    assert total[0] > 1
    assert (np.diff(total) < 0).all()


def test_leakage_takes_estimates_back_to_the_first_at_its_rate() -> None:
    controller, reference = pm.Adaptive(NOMINAL, gamma=0.0, leakage=0.5), SHORT(0.0)
    change, *others = controller.initial_state(Context.of(NOMINAL, dt=0.01, t=np.array([0.0, 0.01])))
    off = np.asarray(change) + np.array([6.0, 0.6, 0.3, 0.26])
    _, (after, *_) = controller(0.0, reference.q, reference.v, reference, (off, *others))
    np.testing.assert_allclose(after, (1 - 0.01 * 0.5) * off, rtol=1e-12)


def test_the_observer_is_exact_for_constant_forces_and_as_fast_as_its_gain() -> None:
    force = np.array([12.0, -7.0, 1.5])
    controller = pm.DisturbanceObserver(pm.ComputedTorque(NOMINAL, 16, 8))
    still = pm.FixedHeading(pm.Circle(radius=1.5, rate=0.6, duration=4), 0.3)
    run = pm.simulate(NOMINAL, controller, still, dt=1e-3, forces=[pm.ConstantForce(force)], **FAST)
    found = run.signals["disturbance"].values
    # Explicit Euler of the integral: order 1 in dt.
    assert np.abs(found[-1] - force).max() < 1e-3 * np.abs(force).max()
    at = found[round(0.1 / 1e-3)] / force
    assert np.abs(at - (1 - np.exp(-1))).max() < 0.01


@pytest.mark.parametrize("name", ["PID", "super-twisting", "adaptive", "ADRC"])
def test_nothing_winds_up_where_the_force_is_limited(name: str) -> None:
    given: Any = {"dt": 0.01, "substeps": 4, "duration": 10.0, **FAST}
    start = CIRCLE(0.0).q + np.array([0.5, -0.3, 0.4])  # beside the circle
    run = pm.simulate(NOMINAL, pm.InputSaturation(EACH[name], LIMITS), CIRCLE, q0=start, **given)
    off = np.linalg.norm(run.error[:, :2], axis=-1)
    assert (np.abs(run.u).max(axis=0) >= LIMITS).any()
    assert off.max() < 1.0
    assert off[run.t > 6].max() < 0.02


@pytest.mark.long
def test_arms_are_adapted_too() -> None:
    heavier = replace(ARM, {find(ARM, "forearm_link.mass").path: 4.0})
    fixed = pm.simulate(heavier, pm.Adaptive(ARM, gamma=0.0), Waving(ARM), dt=0.01, **FAST)
    adapted = pm.simulate(heavier, pm.Adaptive(ARM), Waving(ARM), dt=0.01, **FAST)
    worst = [np.abs(run.q - run.reference.q)[50:].max() for run in (fixed, adapted)]
    assert worst[1] < 0.8 * worst[0]


UNSTABLE: Any = [
    (pm.PID(NOMINAL, kp=3000, ki=64, kd=250), "gains kp = "),
    (pm.PID(NOMINAL, kp=4, ki=64, kd=4), "unstable at any dt"),
    (pm.SlidingMode(NOMINAL, reach=30), "gains slope = "),
    (pm.Adaptive(NOMINAL, kd=(9000, 9000, 500)), "gains slope = "),
    (
        pm.DisturbanceObserver(pm.PD(1, 1), NOMINAL, gain=250),
        r"gain = \[250.0\] are unstable .* dt < 0.008 s",
    ),
    (pm.ADRC(NOMINAL, bandwidth=300, observer=20), "gains bandwidth = "),
]


@pytest.mark.parametrize(("controller", "words"), UNSTABLE)
def test_gains_that_are_unstable_at_this_dt_are_refused_with_the_bound(controller: Any, words: str) -> None:
    with pytest.raises(pm.InvalidArgument, match=words):
        pm.simulate(NOMINAL, controller, SHORT, dt=0.01)


test_bad_arguments_are_refused = refusals(
    (lambda: pm.Adaptive(NOMINAL, lower=[31, -9, -9, 0]), "exclude the robot's value, parameter 0 = 30"),
    (lambda: pm.DisturbanceObserver(pm.PD(1, 1)), "robot is None, expected a MobileRobot"),
    (lambda: pm.ADRC(pm.WheeledRobot(NOMINAL, pm.WheelTable.differential(0.1, 0.4))), "which has wheels"),
)
