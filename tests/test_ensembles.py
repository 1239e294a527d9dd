"""Ensembles: the compiled and the numpy engine against `simulate`, and against each other."""

import pickle
import subprocess
import sys
from inspect import signature
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.controllers import plain_difference, planar_difference
from pinmobile.forces import NoiseForce, SinusoidalForce
from pinmobile.integrators import RungeKuttaNystrom
from pinmobile.loop import Engine, part_of, run_scenario
from tests.memory import PEAK

ROBOT = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.02))
CIRCLE = pm.Tangent(pm.Circle(3.0, 0.1, 60.0))
SPREAD: dict[str, Any] = {
    "mass": pm.Uniform(20, 40),
    "yaw_inertia": pm.Uniform(1, 2),
    "com.x": pm.Normal(0.05, 0.03),
    "com.y": pm.Normal(0.0, 0.03),
    "start.x": pm.Normal(0, 0.1),
    "start.y": pm.Normal(0, 0.1),
    "start.psi": pm.Normal(0, 0.3),
    "start_rate.vx": pm.Normal(0, 0.1),
    "start_rate.yaw_rate": pm.Normal(0, 0.1),
}
NOISY = pm.MeasurementNoise(pm.ComputedTorque(ROBOT), 1e-3, (1e-3, 2e-3, 1e-3), seed=3)
FORCES: tuple[Any, ...] = (
    SinusoidalForce((2.0, 1.0, 0.1), 0.3, 0.5),
    NoiseForce((1.0, 2.0, 0.1), 2.0, seed=5),
    pm.RollingResistance((2.0, 3.0, 0.2), 0.05),
    pm.ViscousFriction((5.0, 9.0, 0.4)),
)
RECORDS = ("max_error", "rms_error", "max_distance", "max_input", "diverged_at")


def made(**changes: Any) -> pm.Scenario:
    """Return a scenario of the circle, unless something else is asked for."""
    chosen: dict[str, Any] = {"robot": ROBOT, "controller": pm.ComputedTorque(ROBOT), "trajectory": CIRCLE}
    return pm.Scenario(**chosen | {"n": 70, "spread": SPREAD, "dt": 0.1} | changes)


def assert_close(one: pm.Ensemble, other: pm.Ensemble) -> None:
    """Compare records to 1e-12 of the size of what they are differences of."""
    size = 1 + np.abs(np.hstack(one.scenario.reference)).max()
    force = 1 + one.max_input.max()
    for name in RECORDS:
        here, there = getattr(one, name), getattr(other, name)
        within = 1e-12 * (force if name == "max_input" else size)
        np.testing.assert_allclose(here, there, rtol=0, atol=within, err_msg=name)
    np.testing.assert_array_equal(one.counts, other.counts)


def assert_same(one: Any, other: Any, rows: slice = slice(None)) -> None:
    for name in RECORDS:
        np.testing.assert_array_equal(getattr(one, name)[rows], getattr(other, name), err_msg=name)


def assert_is_simulated(run: pm.Ensemble, i: int) -> None:
    """Compare robot i with what `simulate` makes of it."""
    rollout = run.member(i)
    size = 1 + np.abs(np.hstack(run.scenario.reference)).max()
    force = 1 + run.max_input[i].max()
    np.testing.assert_allclose(rollout.max_error(), run.max_error[i], rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(rollout.rms_error(), run.rms_error[i], rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(rollout.max_input(), run.max_input[i], rtol=0, atol=1e-12 * force)
    distance = np.hypot(*rollout.error[:, :2].T).max()
    assert distance == pytest.approx(run.max_distance[i], abs=1e-12 * size)


class Own:
    """A model of a user's own, of a robot that is heavier than it is."""

    nv = 3
    difference = staticmethod(planar_difference)

    def inverse_dynamics(self, q: Any, v: Any, a: Any) -> Any:
        return pm.MobileRobot(40.0, 1.5).inverse_dynamics(q, v, a)


def twofold(q0: Any, q1: Any) -> Any:
    return 2 * planar_difference(q0, q1)


OWN: dict[str, Any] = {
    "a difference of one's own": {"controller": pm.PD((40, 50, 4), (60, 50, 4), difference=twofold)},
    "a model of one's own": {"controller": pm.ComputedTorque(Own())},
    "a table of one's own": {"integrator": RungeKuttaNystrom("own", (0.0,), ((),), ((),), (0.5,), (0.9,))},
}


@pytest.mark.parametrize("what", OWN)
def test_what_is_ones_own_is_as_simulated(what: str) -> None:
    scenario = made(n=3, duration=10.0, **OWN[what])
    run = run_scenario(scenario)
    assert (run.engine, run.fallback_reason) == ("COMPILED", "")
    assert_close(run, run_scenario(scenario, engine=Engine.PYTHON))
    assert_is_simulated(run, 2)


def test_a_noisy_robot_is_run_alone_by_any_engine() -> None:
    member = run_scenario(made(controller=NOISY, n=3, duration=3.0)).arguments(2)
    alone = [pm.simulate(*member[:3], **member.options, engine=engine) for engine in Engine]
    np.testing.assert_allclose(alone[1].q, alone[0].q, rtol=0, atol=1e-12)
    other = pm.simulate(*member[:3], **{**member.options, "member": 1})
    assert np.abs(other.u - alone[0].u).max() > 1e-3


@pytest.mark.parametrize("difference", [planar_difference, plain_difference])
def test_a_start_a_turn_ahead_is_seen_as_simulate_and_its_controller_see_it(difference: Any) -> None:
    controller: Any = pm.PD((40, 50, 4), (60, 50, 4), difference=difference)
    spread = {"start.psi": 2 * np.pi + np.array([0.1, -0.2])}
    scenario = made(controller=controller, spread=spread, n=2, duration=10.0)
    compiled = run_scenario(scenario, engine=Engine.COMPILED)
    assert_close(compiled, run_scenario(scenario, engine=Engine.PYTHON))
    assert_is_simulated(compiled, 1)
    # The lecture's subtraction turns it back by a whole turn: half of one is the farthest.
    farthest = [np.pi, np.pi] if difference is plain_difference else [0.1, 0.2]
    np.testing.assert_allclose(compiled.max_error[:, 2], farthest, atol=0.2)


@pytest.mark.long
@pytest.mark.once
def test_diverging_robots_are_flagged_as_by_simulate_and_the_others_untouched() -> None:
    gains = np.full(130, 4.0)
    gains[[3, 64, 100]] = 900.0, 2000.0, 500.0  # beyond what dt = 0.1 s bears
    spread = {"mass": pm.Uniform(20, 40), "kp": gains}
    run = run_scenario(made(n=130, spread=spread, duration=15.0), engine=Engine.COMPILED)
    assert np.flatnonzero(run.diverged).tolist() == [3, 64, 100]
    for i in (3, 64, 100):
        member = run.arguments(i)
        with pytest.raises(pm.Diverged) as caught:
            pm.simulate(*member[:3], **member.options)
        assert caught.value.time == run.diverged_at[i]
        # What came before: rounding grows as the error does.
        np.testing.assert_allclose(run.member(i).max_error(), run.max_error[i], rtol=1e-9, atol=1e-9)
    tame = run_scenario(made(n=130, spread=spread | {"kp": 4.0}, duration=15.0), engine=Engine.COMPILED)
    for name in RECORDS[:-1]:
        here, there = (np.delete(getattr(each, name), [3, 64, 100], axis=0) for each in (run, tame))
        np.testing.assert_array_equal(here, there)
    assert run.worst(3).tolist() == np.argsort(run.diverged_at, kind="stable")[:3].tolist()
    after = np.argsort(-tame.max_error[:, 2], kind="stable")
    expected = [*run.worst(3).tolist(), *after[~np.isin(after, [3, 64, 100])][:4].tolist()]
    assert run.worst(7, "heading").tolist() == expected != run.worst(7).tolist()
    assert run.error_quantile(0.97).distance < 0.01
    assert run.error_quantile(0.99).distance == np.inf
    few = spread | {"kp": gains[[0, 3, 64, 100]]}
    slow = run_scenario(made(n=4, spread=few, duration=15.0), engine=Engine.PYTHON)
    assert np.flatnonzero(slow.diverged).tolist() == [1, 2, 3]
    np.testing.assert_allclose(slow.max_error[0], run.max_error[0], rtol=1e-9)


@pytest.mark.parametrize("engine", [Engine.COMPILED, Engine.PYTHON])
def test_half_a_turn_off_all_robots_turn_left_in_every_engine(engine: Any) -> None:
    # Half a turn, and what rounding may make of it: to the right, it would be the other way round.
    off = np.pi + np.array([0.0, 1e-15, -1e-15, 1e-12, -1e-12])
    spread = {"start.psi": np.concatenate([off, -off])}
    held = pm.FixedHeading(pm.Circle(1, 0.1, 2), 0.0)
    wide = pm.ensemble(ROBOT, pm.ComputedTorque(ROBOT), held, n=10, dt=0.1, spread=spread, engine=engine)
    for i in range(10):
        alone = wide.member(i)
        assert (alone.error[:, 2] > 0).all()
        assert alone.q[-1, 2] > alone.q[0, 2]
        np.testing.assert_allclose(wide.max_error[i], alone.max_error(), rtol=0, atol=1e-8)
        np.testing.assert_allclose(wide.max_input[i], alone.max_input(), rtol=0, atol=1e-7)


@pytest.mark.parametrize("engine", [Engine.COMPILED, Engine.PYTHON])
def test_errors_are_kept_from_a_time_on_and_all_else_from_the_start(engine: Any) -> None:
    n = 70 if engine is Engine.COMPILED else 2
    scenario = made(after=10.0, forces=FORCES, n=n, duration=20.0)
    run = run_scenario(scenario, engine=engine)
    assert scenario.t[scenario.begin] == 10.0
    for i in (0, n - 1):
        error = run.member(i).error[100:]
        expected = {"max_error": np.abs(error).max(axis=0), "rms_error": np.sqrt((error**2).mean(axis=0))}
        expected |= {"max_distance": np.hypot(error[:, 0], error[:, 1]).max()}
        for name, value in expected.items():
            np.testing.assert_allclose(getattr(run, name)[i], value, rtol=0, atol=1e-12 * 4)
    throughout = run_scenario(made(forces=FORCES, n=n, duration=20.0), engine=engine)
    assert n < 9 or np.median(run.max_distance / throughout.max_distance) < 0.6
    np.testing.assert_array_equal(run.max_input, throughout.max_input)
    np.testing.assert_array_equal(run.counts, throughout.counts)
    assert f"{n} robots over 20 s: from 10 s on 99 % stay within" in repr(run)


def test_who_diverges_before_errors_count_has_none_and_is_beyond_everything() -> None:
    spread = {"kd": np.array([4.0, 400.0]), "start.x": 0.1}
    run = run_scenario(made(n=2, spread=spread, after=50.0))
    assert run.diverged.tolist() == [False, True]
    assert np.isnan(run.max_distance).tolist() == [False, True]
    assert np.isfinite(run.max_input).all()
    assert run.error_quantile(0.5).distance < 1e-3
    assert run.error_quantile(1.0).distance == np.inf


@pytest.mark.parametrize("engine", [Engine.COMPILED, Engine.PYTHON])
def test_an_acceleration_that_is_none_is_a_divergence_though_its_force_is_finite(engine: Any) -> None:
    scenario = made(controller=pm.PD(1e200, 0), n=2, spread={"mass": 1e-200, "start.x": 1.0}, limit=1e300)
    run = run_scenario(scenario, engine=engine)
    assert run.diverged_at.tolist() == [0, 0]
    with pytest.raises(pm.Diverged, match="a not finite") as caught:
        run.member(0)
    assert caught.value.time == 0


def test_a_robot_that_is_beyond_the_limit_from_the_start_has_no_records() -> None:
    run = run_scenario(made(n=2, spread={"start.x": np.array([0.0, 2e3])}))
    assert run.diverged_at.tolist()[1] == 0.0
    assert np.isnan(run.max_error[1]).all()
    assert run.error_quantile(0.5).distance < 1
    with pytest.raises(pm.Diverged, match="the error in x is -2000"):
        run.member(1)


@pytest.mark.parametrize("engine", [Engine.COMPILED, Engine.PYTHON])
def test_the_same_seed_gives_the_same_bits_however_the_work_is_divided(engine: Any) -> None:
    n = 700 if engine is Engine.COMPILED else 6
    scenario = made(n=n, controller=NOISY, duration=1.0, forces=(NoiseForce((1, 1, 0.1), 1.0, seed=0),))
    whole = run_scenario(scenario, engine=engine, threads=1)
    divided = run_scenario(scenario, engine=engine, threads=5)
    assert_same(whole, divided)
    np.testing.assert_array_equal(whole.counts, divided.counts)
    counts = np.zeros_like(whole.counts)
    for start, stop in ((0, 1), (1, n // 2), (n // 2, n)):
        draws, part = part_of(scenario, start, stop, engine)
        np.testing.assert_array_equal(part.max_error, whole.max_error[start:stop])
        np.testing.assert_array_equal(part.max_input, whole.max_input[start:stop])
        for name, column in draws.items():
            np.testing.assert_array_equal(column, whole.draws[name][start:stop])
        counts += part.counts
    np.testing.assert_array_equal(counts, whole.counts)


def test_what_goes_to_another_process_holds_its_own_robots_of_an_array_alone() -> None:
    spread: dict[str, Any] = {
        "mass": np.linspace(20, 40, 50_000),
        "controller.mass": pm.SameAs("mass", np.linspace(0.9, 1.1, 50_000)),
        "com.x": pm.Normal(0.1, 0.01),
        "start.x": 0.01,
    }
    scenario = made(n=50_000, spread=spread, duration=1.0)
    sent = pickle.dumps(scenario.subset(30_000, 30_100))
    assert len(sent) < len(pickle.dumps(scenario)) / 50
    draws, part = part_of(scenario, 30_000, 30_100)
    held, other = part_of(pickle.loads(sent), 30_000, 30_100)
    assert list(draws) == list(held) == list(spread)
    for one, same in zip((*draws.values(), *part), (*held.values(), *other), strict=True):
        np.testing.assert_array_equal(one, same)


@pytest.mark.parametrize("seed", [2**70, np.random.SeedSequence(3, spawn_key=(1,))])
def test_the_seed_of_a_noise_enters_that_of_every_robot(seed: Any) -> None:
    def run(noise: Any, force: Any) -> pm.Ensemble:
        controller = pm.MeasurementNoise(pm.ComputedTorque(ROBOT), 1e-3, 1e-3, seed=noise)
        forces = (NoiseForce((1.0, 2.0, 0.1), 2.0, seed=force),)
        return run_scenario(made(controller=controller, forces=forces, n=2, duration=1.0))

    one = run(1, 1)
    assert_same(one, run(1, 1))
    for other in (run(seed, 1), run(1, seed)):
        assert not np.isin(one.rms_error, other.rms_error).any()
        assert_is_simulated(other, 1)


def test_ensemble_takes_what_a_scenario_takes_with_the_same_defaults() -> None:
    taken, fields = (signature(what).parameters for what in (pm.ensemble, pm.Scenario))
    own = {"traces", "engine", "threads", "progress"}
    assert set(taken) == {*fields, *own}
    assert {name: taken[name].default for name in fields} == {n: p.default for n, p in fields.items()}


def test_progress_counts_robots() -> None:
    seen: list[tuple[int, int]] = []
    run_scenario(made(n=200, duration=1.0), threads=2, progress=lambda done, n: seen.append((done, n)))
    assert seen[-1] == (200, 200)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


@pytest.mark.long
@pytest.mark.once
def test_a_million_robots_fit_in_a_gigabyte() -> None:
    # Their states alone, at all samples, would take one and a half.
    code = (
        f"{PEAK}\n"
        "import pinmobile as p; r = p.MobileRobot(30, 1.3); "
        "t = p.Tangent(p.Circle(3, 0.1, 6)); "
        "e = p.ensemble(r, p.ComputedTorque(r), t, n=1_000_000, dt=0.2, "
        "spread={'mass': p.Uniform(20, 40), 'com.x': p.Normal(0, 0.02)}); "
        "assert len(e.max_error) == 1_000_000 and len(e.scenario.t) == 31; "
        "print(peak())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 1e6


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_an_impossible_robot_among_possible_ones_is_refused_by_its_number(engine: pm.Engine) -> None:
    wheels: Any = {"mass": 1.0, "spin_inertia": 0.005, "yaw_inertia": 0.003}
    car = pm.WheeledRobot(
        pm.MobileRobot(30, 1.3, com=(0.2, 0, 0.1)), pm.WheelTable.car(0.5, 0.4, 0.1, **wheels)
    )
    law, path = pm.Backstepping(pm.UnicycleTracking(), car), pm.Tangent(pm.Circle(2, 0.4, 0.1))
    loop: Any = {"n": 4, "dt": 0.01, "engine": engine}
    impossible = {"plant.robot.mass": (2.0, "wheels 4 kg"), "rear_left.x": (0.1, "cannot roll without slip")}
    for name, (value, words) in impossible.items():
        usual = 30.0 if name.endswith("mass") else 0.0
        with pytest.raises(pm.InvalidArgument, match=rf"^robot 2: .*{words}"):
            pm.ensemble(car, law, path, spread={name: np.array([usual, usual, value, usual])}, **loop)


def test_a_number_of_an_ordinary_class_is_constant_and_that_of_a_part_is_unknown() -> None:
    class Pull:
        def __init__(self) -> None:
            self.k = 1.0

        def initial_state(self, context: Any) -> None:
            pass

        def __call__(self, t: float, q: Any, v: Any, reference: Any, state: None) -> Any:
            return self.k * (reference.q - q), state

    loop: Any = {"n": 2, "dt": 0.1}
    parts = pm.MobileRobot.box(), Pull(), pm.Tangent(pm.Circle(1, 1, 0.2))
    with pytest.raises(pm.InvalidArgument, match=r"spread has 'controller\.k', an attribute of a class"):
        pm.ensemble(*parts, spread={"controller.k": pm.Uniform(1, 2)}, **loop)
    with pytest.raises(pm.errors.UnknownName, match=r"unknown parameter in spread 'plant\.nv'"):
        pm.ensemble(*parts, spread={"plant.nv": pm.Uniform(1, 2)}, **loop)
