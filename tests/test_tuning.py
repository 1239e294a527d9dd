"""Ensembles, metrics, bands, margins and tuning by derivatives, each beside an independent way."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import pinmobile as pm
from pinmobile import controllers, plots
from pinmobile.derivatives import Constraint, Margins, Tuning, gradient, poles, sensitivities, tune
from pinmobile.errors import UnknownName
from pinmobile.loop import Relative
from pinmobile.metrics import Metric
from pinmobile.parts import array, part, replace
from pinmobile.wheels import Motor
from tests.frozen import BODY, CIRCLE, WRONG, loops
from tests.test_derivatives import loss

PATH = pm.Tangent(pm.Circle(2.0, 0.5, 6.0))
LAW = pm.ComputedTorque(WRONG, 4.0, 4.0)
REST = pm.FixedHeading(pm.Hold((0.0, 0.0), 2.0), 0.0)
Options = dict[str, Any]


def slope(value: Callable[[float], Any], at: float, step: float = 1e-4) -> Any:
    """Return a derivative by central differences of order four."""
    near, far = (np.asarray(value(at + k * step)) - value(at - k * step) for k in (1, 2))
    return (8 * near - far) / (12 * step)


@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_each_robot_of_an_ensemble_has_the_gradient_of_its_own_run(mode: str) -> None:
    spread: Options = {"mass": Relative(pm.Uniform(0.8, 1.2)), "start.x": pm.Uniform(-0.1, 0.1)}
    spread |= {"radius": pm.Uniform(1.9, 2.1), "com.x": pm.Uniform(0.0, 0.1)}
    options: Options = {"dt": 0.02, "duration": 1.0, "by": ["mass", "kp", "radius", "plant.com", "start.x"]}
    found = gradient(loss, BODY, LAW, PATH, n=11, spread=spread, seed=3, mode=mode, **options)
    runs = pm.ensemble(BODY, LAW, PATH, n=11, spread=spread, seed=3, dt=0.02, duration=1.0)
    assert found.value.shape == (11,)
    assert {path: x.shape for path, x in found.by.items()} == {
        "plant.mass": (11,),
        "controller.kp": (11,),
        "trajectory.path.radius": (11,),
        "plant.com": (11, 3),
        "start.x": (11,),
    }
    for i in (0, 10):
        robot, law, path, own = runs.arguments(i)
        q0, v0 = own["q0"], own["v0"]
        one = gradient(loss, robot, law, path, q0=q0, v0=v0, **{**options, "by": ["mass", "kp", "plant.com"]})
        assert found.value[i] == pytest.approx(one.value, rel=1e-12)
        for by, x in one.by.items():
            np.testing.assert_allclose(found.by[by][i], x, rtol=1e-9, atol=1e-12)


def test_metrics_and_reductions_are_those_of_runs_and_ensembles() -> None:
    options: Options = {"dt": 0.01, "duration": 1.0}

    def reduced(mass: float = 30.0) -> dict[str, float]:
        body = pm.MobileRobot(mass, 1.3, com=(0.1, 0.05))
        run = pm.simulate(body, LAW, PATH, engine=pm.Engine.COMPILED, **options)
        far = np.hypot(*run.error[:, :2].T)
        found = {"largest": far.max(), "smallest": far.min(), "last": far[-1], "sum": far.sum()}
        return found | {"mean": far.mean(), "rms": np.sqrt((far**2).mean())}

    for name, value in reduced().items():
        found = gradient("distance", BODY, LAW, PATH, by=["plant.mass"], reduction=name, **options)
        assert found.value == pytest.approx(value, rel=1e-9)
        expected = slope(lambda mass: reduced(mass)[name], 30.0, 1e-3)  # noqa: B023 (called here)
        assert found.by["plant.mass"] == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_margins_of_a_plant_and_user_defined_metrics_are_losses() -> None:
    carried = pm.MobileRobot.box(mass=60.0).mount("ur5")
    still = pm.WholeBody(carried, REST, pm.Hold(carried.rest[3:], 2.0))
    parts = carried, pm.ComputedTorque(carried, 100.0, 20.0), still
    by = ["plant.mounts.ur5.links.forearm_link.com", "trajectory.base.psi"]
    options: Options = {"by": by, "dt": 0.01, "duration": 0.05}
    found = gradient("tip-over margin", *parts, **options)
    back = gradient("tip-over margin", *parts, mode="reverse", **options)
    for path, x in found.by.items():
        np.testing.assert_allclose(back.by[path], x, rtol=1e-9, atol=1e-12)
    runs = pm.ensemble(*parts, n=1, spread={}, dt=0.01, duration=0.05)
    assert found.value == pytest.approx(runs.largest("tip-over margin")[0], rel=1e-9)
    assert found.by["plant.mounts.ur5.links.forearm_link.com"].shape == (3,)
    assert str(found).startswith("smallest tip-over margin ")
    own = Metric("own", "m", "a metric", "largest", lambda sample: sample.q[0])
    assert gradient(own, BODY, LAW, PATH, by=["kp"], dt=0.02).value == pytest.approx(
        pm.simulate(BODY, LAW, PATH, dt=0.02).q[:, 0].max(), rel=1e-9
    )
    with pytest.raises(UnknownName, match=r"unknown loss 'speed'.* available: .*distance"):
        gradient("speed", BODY, LAW, PATH, by=["kp"], dt=0.02)


def test_bands_are_those_of_small_changes() -> None:
    by = ["plant.mass", "plant.com", "controller.kp", "trajectory.path.radius"]
    found = sensitivities(BODY, LAW, PATH, by=by, dt=0.02)

    def of_mass(mass: float) -> Any:
        robot = pm.MobileRobot(mass, 1.3, com=(0.1, 0.05))
        return pm.simulate(robot, LAW, PATH, dt=0.02, engine=pm.Engine.COMPILED)

    for name in ("q", "v", "u", "a"):
        expected = slope(lambda mass: getattr(of_mass(mass), name), 30.0, 1e-3)  # noqa: B023 (called here)
        got = getattr(found, name)["plant.mass"]
        assert np.abs(got - expected).max() <= 1e-7 * np.abs(expected).max()
    assert found.q["plant.com"].shape == (301, 3, 3)
    both = found.deviation({"mass": 2.0, "com": [0.01, 0.0, 0.0]})
    expected = np.hypot(2.0 * found.q["plant.mass"], 0.01 * found.q["plant.com"][..., 0])
    np.testing.assert_allclose(both, expected, rtol=1e-12)
    assert found.units["plant.mass"] == "kg"
    figure = plots.sensitivities(found, {"mass": 2.0})
    assert [axes.get_ylabel()[:8] for axes in figure.axes] == ["error in"] * 3
    assert all(len(axes.collections) == 1 for axes in figure.axes)
    with pytest.raises(pm.PinmobileError, match="unknown deviations 'weight', available: "):
        found.deviation({"weight": 1.0})


def test_a_fit_over_a_range_agrees_where_the_loss_is_smooth() -> None:
    by = ["kp", "plant.com", "trajectory.path.radius", "start.x"]
    options: Options = {"by": by, "dt": 0.02}
    exact = gradient(loss, BODY, LAW, PATH, **options)
    fit = gradient(loss, BODY, LAW, PATH, smooth=1e-3, **options)
    assert fit.errors is not None
    for path, x in exact.by.items():
        # The quadratic part of the loss is what a line leaves: some of its standard errors.
        assert (np.abs(fit.by[path] - x) <= 4 * fit.errors[path] + 1e-3 * np.abs(x)).all()
    assert "fit to 112 runs within 0.1 % of each number" in str(fit)
    assert " +- " in str(fit)
    with pytest.raises(pm.InvalidArgument, match="smooth is for one robot, expected n=1"):
        gradient(loss, BODY, LAW, PATH, smooth=1e-3, n=3, spread={"mass": pm.Uniform(20, 40)}, **options)


def test_kinks_and_wheels_that_begin_to_slide_are_counted() -> None:
    def pushed(t: Any, q: Any, v: Any, reference: Any) -> Any:
        return np.abs(np.sin(4 * np.pi * (reference.q[0] - q[0] + 0.03))) * np.array([1.0, 1.0, 0.0])

    smooth = gradient(loss, BODY, pm.PD(60, 60), PATH, by=["kp"], dt=0.02)
    assert (smooth.kinks, smooth.slides) == (0, 0)
    found = gradient(loss, BODY, pm.law(pushed), PATH, by=["mass"], dt=0.02)
    run = pm.simulate(BODY, pm.law(pushed), PATH, dt=0.02)
    sides = np.sin(4 * np.pi * (run.error[:, 0] + 0.03)) < 0
    assert found.kinks == np.count_nonzero(np.diff(sides)) > 0
    assert f"the side of a kink changes {found.kinks} times" in str(found)


@pytest.mark.parametrize(
    "law",
    [controllers.Sampled(pm.PD(60, 20), 4), pm.MeasurementNoise(pm.PD(60, 20), 1e-3, 1e-3, seed=1)],
    ids=["clock", "noise"],
)
def test_what_no_number_changes_is_no_kink(law: Any) -> None:
    assert gradient(loss, BODY, law, PATH, by=["kp"], dt=0.01).kinks == 0


@pytest.mark.parametrize("weight", [1e-4, 0.03])
def test_a_number_near_its_bound_has_an_exact_derivative(weight: float) -> None:
    """What Python computes before the first sample is differentiated by steps relative to the number."""

    def value(weight: float) -> float:
        return float(gradient(loss, BODY, pm.LQR(BODY, input_weight=weight), PATH, **options).value)

    options: dict[str, Any] = {"by": ["input_weight"], "dt": 0.02, "q0": [0.1, 0.1, 0.1]}
    found = gradient(loss, BODY, pm.LQR(BODY, input_weight=weight), PATH, **options)
    expected = slope(value, weight, 1e-3 * weight)
    assert float(found.by["controller.input_weight"]) == pytest.approx(expected, rel=1e-7)


def test_at_a_bound_differences_go_to_one_side() -> None:
    """A motor without losses (efficiency = 1) starts a wheel with the slope of one with small losses."""
    options: dict[str, Any] = {"by": ["plant.*.motor.efficiency", "plant.*.motor.resistance"], "dt": 0.02}

    def slopes(efficiency: float) -> Any:
        motor = Motor(resistance=0.5, torque_constant=0.05, voltage=24, gear=30, efficiency=efficiency)
        drive = pm.WheeledRobot(BODY, pm.WheelTable.differential(0.4, 0.1, motor=motor))
        law = controllers.TorqueToVoltage(pm.Backstepping(pm.UnicycleTracking(), drive), drive.by_voltage())
        found = gradient(loss, drive.by_voltage(), law, PATH, **options)
        return np.array([float(x) for x in found.by.values()])

    np.testing.assert_allclose(slopes(1.0), slopes(1 - 1e-7), rtol=1e-4, atol=1e-9)
    drive = pm.WheeledRobot(BODY, pm.WheelTable.differential(0.4, 0.1))
    with pytest.raises(pm.InvalidArgument, match=r"left.x has no derivative here, .* more than one axle"):
        gradient(loss, drive, pm.Backstepping(pm.UnicycleTracking(), drive), PATH, by=["plant.*.x"], dt=0.02)


def test_a_time_between_samples_is_a_kink_without_a_slope() -> None:
    push = pm.ConstantForce((50.0, 0.0, 0.0), 0.305, 0.6)
    found = gradient(loss, BODY, pm.PD(120, 120), PATH, by=["begin"], dt=0.02, forces=[push])
    assert float(found.by["forces.0.begin"]) == 0.0
    assert "the side of a kink changes 1 time; the slope" in str(found)
    assert "kink" not in str(gradient(loss, BODY, pm.PD(120, 120), PATH, by=["kp"], dt=0.02, forces=[push]))


# A double integrator with a held force, whose loop is broken at the force: L(z) = K (z I - A)^-1 B.
def transfer(kp: float, kd: float, h: float, late: int) -> Callable[[Any], Any]:
    def loop(w: Any) -> Any:
        z = np.exp(1j * np.asarray(w) * h)
        return (kp * h * h / 2 * (z + 1) / (z - 1) ** 2 + kd * h / (z - 1)) / z**late

    return loop


@pytest.mark.parametrize("late", [0, 2])
def test_margins_are_those_of_the_closed_form(late: int) -> None:
    h, kp, kd = 0.01, 100.0, 20.0
    law: Any = pm.ComputedTorque(BODY, kp, kd)
    found = poles(BODY, pm.MeasurementDelay(law, late) if late else law, REST, dt=h, at=1.0)
    loop = transfer(kp, kd, h, late)
    w = np.linspace(1.0, np.pi / h, 2_000_001)[:-1]
    values = loop(w)
    unit = w[:-1][np.diff(np.sign(np.abs(values) - 1)) != 0]
    lag = np.angle(-loop(unit[0])) % (2 * np.pi)
    real = [float(x.real) for x in values[:-1][np.diff(np.sign(values.imag)) != 0]] + [float(values[-1].real)]
    high = min(-1 / x for x in real if -1 < x < 0)
    disk = 1 / np.abs(1 / (1 + values) - 0.5).max()
    for name in ("Fx", "Fy", "Mz"):
        one = found.margins[name]
        assert one.gain[0] == 0.0
        # The grid of two million frequencies is the error of the closed form's margins.
        assert one.gain[1] == pytest.approx(high, rel=1e-4)
        assert one.phase == pytest.approx(lag, rel=1e-4)
        assert one.delay == pytest.approx(lag / unit[0], rel=1e-4)
        assert one.disk == pytest.approx(disk, rel=1e-6)
    # A gain at the margin puts a pole on the unit circle.
    limit = found.margins["Fx"].gain[1]
    stronger: Any = pm.ComputedTorque(BODY, kp * limit, kd * limit)
    beyond = poles(BODY, pm.MeasurementDelay(stronger, late) if late else stronger, REST, dt=h, at=1.0)
    assert np.abs(beyond.values).max() == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("every", [1, 3])
def test_poles_at_many_times_are_those_at_each(every: int) -> None:
    circle = pm.Tangent(pm.Circle(2.0, 0.4, 6.0))
    law, times = controllers.Sampled(pm.MeasurementDelay(pm.PD(20, 20), 2), every), [4.0, 0.5, 0.53, 5.9]
    many = poles(BODY, law, circle, dt=0.01, at=times)
    assert [one.t for one in many] == pytest.approx(times, abs=0.011)  # the start of a period
    for time, one in zip(times, many, strict=True):
        alone = poles(BODY, law, circle, dt=0.01, at=time)
        np.testing.assert_array_equal(one.matrix, alone.matrix)
        np.testing.assert_array_equal(one.values, alone.values)
    assert np.abs(many[0].matrix - many[1].matrix).max() > 1e-4
    cases: list[tuple[Any, str]] = [([], "shape"), ([1.0, 7.0], r"\[1\]"), ([[1.0]], "shape")]
    for wrong, words in cases:
        with pytest.raises(pm.InvalidArgument, match=f"^at.*{words}"):
            poles(BODY, law, circle, dt=0.01, at=wrong)
    unstable = controllers.Sampled(pm.MeasurementDelay(pm.PD(60, 60), 2), 3)
    with pytest.raises(pm.InvalidArgument, match=r"^at is behind t = .* s, where the run diverges"):
        poles(BODY, unstable, circle, dt=0.01, at=5.9)


def test_a_loop_with_a_slower_law_is_linearized_over_its_period() -> None:
    law = pm.PD(60, 60)
    one = poles(BODY, law, REST, dt=0.04)
    slow = poles(BODY, controllers.Sampled(law, 4), REST, dt=0.01, at=0.53)
    assert (slow.dt, len(slow.values)) == (0.04, 10)  # with held force and count
    np.testing.assert_allclose(slow.values[:6], one.values, atol=1e-9)
    np.testing.assert_allclose(slow.values[6:], 0.0, atol=1e-9)
    for name, margins in one.margins.items():
        assert slow.margins[name].gain == pytest.approx(margins.gain, rel=1e-6)
        assert slow.margins[name][1:] == pytest.approx(margins[1:], rel=1e-6)
    observed = pm.DisturbanceObserver(controllers.Sampled(law, 4), BODY, gain=1.0)
    with pytest.raises(pm.InvalidArgument, match=r"^the inputs change within the period .* no margins$"):
        poles(BODY, observed, REST, dt=0.01).margins  # noqa: B018


def test_a_metric_with_an_unknown_rule_is_no_loss() -> None:
    rule = Metric("gap", "m", "distance", "min", lambda sample: 1 - sample.q[0])
    with pytest.raises(UnknownName, match=r"unknown worst of the metric 'gap': 'min', available: largest"):
        gradient(rule, BODY, pm.PD(120, 20), PATH, by=["mass"], dt=0.02)


def test_an_unstable_loop_has_no_margins_and_all_poles_are_drawn() -> None:
    unstable = poles(BODY, pm.PD(120, 120), REST, dt=0.05)
    assert not unstable.is_stable
    assert "small deviations grow near this sample" in str(unstable)
    assert unstable.damping.min() < 0
    with pytest.raises(pm.InvalidArgument, match="the loop is unstable near this sample"):
        unstable.margins  # noqa: B018 (the property is what is tested)
    stable = poles(BODY, pm.PD(60, 60), REST, dt=0.01)
    figure = plots.poles({"20 ms": stable, "50 ms": unstable})
    assert isinstance(figure, Figure)
    drawn = [line for line in figure.axes[0].lines if line.get_linestyle() == "None"]
    assert [len(line.get_xdata()) for line in drawn] == [6, 6]  # type: ignore[arg-type]
    assert (
        str(Margins((0.5, np.inf), 0.5, 0.1, 1.0)) == "gain 0.5 to inf, phase 28.6 deg, delay 0.1 s, disk 1"
    )


def test_tuning_finds_the_minimum_of_a_grid() -> None:
    options: Options = {"dt": 0.02, "q0": [0.1, 0.1, 0.2]}
    found = tune(loss, BODY, LAW, PATH, by={"kp": (1, 60), "kd": (1, 20)}, **options)
    values = {}
    for kp in np.linspace(1, 60, 13):
        for kd in np.linspace(1, 20, 13):
            run = pm.simulate(
                BODY, pm.ComputedTorque(WRONG, kp, kd), PATH, engine=pm.Engine.COMPILED, **options
            )
            values[kp, kd] = float((run.error**2).sum() + 1e-6 * (run.u**2).sum())
    assert found.best.loss <= min(values.values())
    assert found.controller.kp == pytest.approx(found.best.numbers[0])
    run = pm.simulate(BODY, found.controller, PATH, **options)
    assert (run.error**2).sum() + 1e-6 * (run.u**2).sum() == pytest.approx(found.best.loss, rel=1e-9)
    assert found.trials[0].numbers.tolist() == [4.0, 4.0]
    text = str(found)
    assert text.startswith(f"loss {found.trials[0].loss:.6g} to {found.best.loss:.6g} by 2 numbers, ")
    reached = [line.split()[0] for line in text.splitlines() if line.endswith(" (its bound)")]
    near = np.abs(found.best.numbers[:, None] / found.bounds - 1).min(axis=1) < 1e-6
    assert reached == [name for name, is_near in zip(found.names, near, strict=True) if is_near]
    assert reached == ["controller.kp"]


def force(sample: Any) -> Any:
    return np.sqrt((sample.u[:2] ** 2).sum())


SPREAD: Options = {"mass": Relative(pm.Uniform(0.8, 1.2)), "com.x": pm.Uniform(0.0, 0.2)}


def tuned(objective: str, **changes: Any) -> Tuning:
    given: Options = {"by": {"kp": (1, 40), "kd": (1, 15)}, "dt": 0.02, "n": 24, "spread": SPREAD} | changes
    return tune("distance", BODY, LAW, PATH, objective=objective, **given)


def test_constraints_are_kept_by_all_robots() -> None:
    found = tuned("mean", constraints=[Constraint(force, upper=30.0)], q0=None)
    runs = pm.ensemble(BODY, found.controller, PATH, n=24, spread=SPREAD, dt=0.02, metrics={"force": force})
    assert runs.largest("force").max() <= 30.0 * (1 + 1e-6)
    assert found.best.loss == pytest.approx(runs.largest("distance").mean(), rel=1e-9)
    free = tuned("mean")
    assert free.best.loss <= found.best.loss
    assert "force <= 30: kept" in str(found)
    others = pm.ensemble(BODY, found.controller, PATH, n=24, spread=SPREAD, dt=0.02, seed=1)
    np.testing.assert_allclose(found.others[1], others.largest("distance"), rtol=1e-9)
    assert "loss of 24 other robots: mean " in str(found)


def test_the_worst_robot_is_better_with_its_own_objective() -> None:
    results = {
        name: tuned(name, by={"kp": (1, 10), "kd": (1, 5)}) for name in ("mean", "soft maximum", "worst")
    }
    largest = {}
    for name, found in results.items():
        runs = pm.ensemble(BODY, found.controller, PATH, n=24, spread=SPREAD, dt=0.02)
        largest[name] = runs.largest("distance").max()
        if name != "mean":
            assert found.best.loss == pytest.approx(largest[name], rel=1e-9)
    assert largest["worst"] <= largest["mean"] * (1 + 1e-6)
    assert largest["worst"] <= largest["soft maximum"] * (1 + 1e-3)


def test_a_gear_a_radius_and_a_path_are_tuned() -> None:
    plant, law, _ = next(parts for name, parts, _ in loops() if name == "volts")
    parts = plant, law, PATH

    def effort(sample: Any) -> Any:
        return (sample.u**2).sum() + 1e3 * (sample.error**2).sum()

    wheel = "plant.wheeled.table.wheels.left"
    with pytest.raises(UnknownName, match=r"unknown parameter in by '\*.gears'"):
        gradient(effort, *parts, by=["*.gears"], dt=0.02)
    by = [f"{wheel}.motor.gear", f"{wheel}.radius", f"{wheel}.y", "trajectory.path.radius"]
    found = tune(effort, *parts, by=by, dt=0.02, duration=1.0, iterations=5)
    assert found.best.loss < found.trials[0].loss
    numbers = dict(zip(found.names, found.best.numbers, strict=True))
    best = replace(pm.Loop(*parts), numbers)
    run = pm.simulate(best.plant, best.controller, best.trajectory, dt=0.02, duration=1.0)
    expected = (run.u**2).sum() + 1e3 * (run.error**2).sum()
    assert found.best.loss == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"by": {"kp": (-9, 9)}}, r"^by\['controller.kp'\] is \(-9, 9\), expected narrower bounds .* >= 0$"),
        ({"by": {"kp": (40, 1)}}, r"by\['controller.kp'\] is \(40, 1\), expected .* lower < upper"),
        ({"by": {"kp": (1.0,)}}, r"^by\['(controller\.)?kp'\]"),
        ({"by": {}}, r"by is \[\], expected paths of numbers"),
        ({"by": ["kp", "controller.kp"]}, "by has kp, controller.kp, of which two mean the same number"),
        ({"by": ["mass"]}, "by has 'plant.mass', which is in the spread, expected other numbers"),
        ({"constraints": [Constraint(force)]}, "Constraint has bounds -inf and inf, expected lower < upper"),
        ({"constraints": [Constraint(force, upper="a")]}, "bounds"),  # type: ignore[arg-type]
        ({"controller": pm.PD(1e9, 1e9)}, "the loop diverges with the given numbers"),
    ],
)
def test_wrong_arguments_of_a_tuning_are_answered(change: Options, message: str) -> None:
    given: Options = {"by": ["kp"], "dt": 0.02, "n": 2, "spread": SPREAD, "controller": LAW} | change
    with pytest.raises(pm.PinmobileError, match=message):
        tune("distance", BODY, given.pop("controller"), PATH, **given)


def test_a_search_that_is_stopped_returns_the_best_trial_so_far() -> None:
    seen: list[Any] = []

    def stop(trial: Any) -> None:
        seen.append(trial)
        if len(seen) == 3:
            raise KeyboardInterrupt

    found = tune(loss, BODY, LAW, PATH, by=["kp", "kd"], dt=0.02, progress=stop)
    assert len(found.trials) == 3
    assert found.best.loss == min(one.loss for one in seen)
    assert "stopped" in found.method


def test_a_number_of_a_coordinate_changes_it_alone_and_a_fit_sees_each_entry() -> None:
    one, each = pm.ComputedTorque(WRONG, 4.0, 4.0), pm.ComputedTorque(WRONG, (4.0, 4.0, 4.0), 4.0)
    options: Options = {"dt": 0.02, "duration": 2.0, "q0": [0.1, -0.1, 0.2]}
    whole = gradient(loss, BODY, each, PATH, by=["controller.kp"], **options)
    parts = gradient(loss, BODY, one, PATH, by=["kp.x", "kp.y", "kp.psi"], **options)
    np.testing.assert_allclose([*parts.by.values()], whole.by["controller.kp"], rtol=1e-9)
    found = tune(loss, BODY, one, PATH, by={"kp.x": (1, 100)}, **options)
    assert found.controller.kp[0] > 4.0
    assert found.controller.kp[1:].tolist() == [4.0, 4.0]


def test_numbers_that_are_the_same_as_another_follow_it() -> None:
    options: Options = {"dt": 0.02, "duration": 2.0, "q0": [0.1, -0.1, 0.2]}
    alone = gradient(loss, BODY, LAW, PATH, by=["plant.mass", "controller.robot.mass"], **options)
    spreads: tuple[Options, ...] = (
        {"controller.robot.mass": pm.SameAs("plant.mass", 25 / 30)},
        {"plant.mass": 30.0, "controller.robot.mass": pm.SameAs("plant.mass", 25 / 30)},
    )
    for spread in spreads:
        tied = gradient(loss, BODY, LAW, PATH, by=["plant.mass"], spread=spread, **options)
        expected = alone.by["plant.mass"] + 25 / 30 * alone.by["controller.robot.mass"]
        assert tied.by["plant.mass"] == pytest.approx(float(expected), rel=1e-9)


def test_an_impossible_constraint_and_numbers_without_effect_are_stated() -> None:
    found = tuned("mean", constraints=Constraint(force, upper=10.0))
    assert "no trial keeps all constraints: these numbers exceed them least" in str(found)
    assert "force <= 10: exceeded by up to " in str(found)
    assert "of them exceed a constraint, by up to " in str(found)
    still = tune("distance", BODY, LAW, PATH, by=["kp"], dt=0.02, q0=[5.0, 0.0, 0.0], duration=0.04)
    assert "no number changes the loss, such as the largest error at the start" in still.method


@part
class Policy:
    """Policy of one hidden layer, beside PD."""

    first: Any = array(shapes=(("h", "m"),), doc="weights")
    second: Any = array(shapes=((3, "h"),), doc="weights")

    def initial_state(self, context: Any) -> Any:
        return None

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        error, rate = reference.q - q, reference.v - v
        hidden = np.tanh(self.first @ np.concatenate([error, rate, np.ones(1)]))
        return 60.0 * error + 40.0 * rate + 20.0 * (self.second @ hidden), state


def test_many_weights_of_a_policy_are_tuned_in_reverse_mode() -> None:
    draws = np.random.default_rng(0)
    policy = Policy(0.3 * draws.standard_normal((8, 7)), 0.3 * draws.standard_normal((3, 8)))
    by = ["controller.first", "controller.second"]
    options: Options = {"dt": 0.02, "q0": [0.1, -0.1, 0.2]}
    found = tune(loss, BODY, policy, CIRCLE, by=by, iterations=30, **options)
    assert "reverse mode" in found.method
    assert found.best.loss < 0.3 * found.trials[0].loss
    assert isinstance(found.controller, Policy)
    assert len(found.names) == 80
    assert found.names[9] == "controller.first.1.2"
    assert "and 68 numbers that changed less" in str(found)


@pytest.mark.parametrize("ground", [pm.Rolling(), pm.Coulomb()])
def test_numbers_that_follow_another_are_those_of_the_tuned_parts(ground: Any) -> None:
    def plant(radius: float) -> pm.WheeledRobot:
        casters = [(0.3, 0.0), (-0.3, 0.0)]
        table = pm.WheelTable.differential(0.5, radius, supports=casters, mass=1.0, spin_inertia=0.005)
        return pm.WheeledRobot(pm.MobileRobot(30.0, 2.3, (0.1, 0.05, 0.2)), table, ground)

    law, path = pm.Backstepping(pm.UnicycleTracking(), plant(0.1)), pm.Tangent(pm.Circle(1.0, 0.5, 1.0))

    def value(parts: tuple[Any, Any]) -> float:
        run = pm.simulate(*parts, path, dt=0.01, engine=pm.Engine.COMPILED)
        return 1e4 * float((run.error[:, :2] ** 2).sum())

    def own_loss(sample: Any) -> Any:
        return 1e4 * (sample.error[:2] ** 2).sum()

    options: Any = {"spread": {"right.radius": pm.SameAs("left.radius")}, "dt": 0.01}
    found = gradient(own_loss, plant(0.09), law, path, by=["left.radius"], **options)
    (derivative,) = found.by.values()
    expected = slope(lambda radius: value((plant(radius), law)), 0.09)
    assert float(derivative) == pytest.approx(expected, rel=1e-6)
    best = tune(own_loss, plant(0.09), law, path, by={"left.radius": (0.085, 0.105)}, **options)
    assert best.plant.table.wheels[0].radius == best.plant.table.wheels[1].radius
    assert value((best.plant, best.controller)) == pytest.approx(best.best.loss, rel=1e-9, abs=1e-12)


def test_a_number_that_follows_one_that_is_zero_has_derivatives() -> None:
    robot, model, circle = (
        pm.MobileRobot(30.0, 1.3),
        pm.MobileRobot(25.0, 1.3),
        pm.Tangent(pm.Circle(2, 0.5, 3)),
    )
    options: Any = {"spread": {"controller.robot.com.x": pm.SameAs("plant.com.x", 0.5)}, "dt": 0.01}
    found = gradient(loss, robot, pm.ComputedTorque(model), circle, by=["plant.com.x"], **options)

    def value(x: float) -> float:
        plant, law = (replace(one, {"com": (k * x, 0.0)}) for one, k in ((robot, 1.0), (model, 0.5)))
        return float(gradient(loss, plant, pm.ComputedTorque(law), circle, by=["kp"], dt=0.01).value)

    (derivative,) = found.by.values()
    assert float(derivative) == pytest.approx(slope(value, 0.0), rel=1e-6)
