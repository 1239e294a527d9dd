"""What plants state beside errors: end effectors, efforts, margins; in ensembles, files and figures."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import plots
from pinmobile.balance import MotionStates, tip_over_margin
from pinmobile.errors import LimitWarning, UnknownName
from pinmobile.loop import run_scenario
from pinmobile.metrics import Metric
from pinmobile.reaching.poses import error_sizes, pose_error
from pinmobile.urdf import Body
from tests.looping import Body as Pushed
from tests.parts import Waving
from tests.refusals import refusals, refused, unknown

CLOSE = 1e-10
# The base's products of inertia, which the ground alone feels, and its height.
INERTIA = np.array([[0.6, 0.05, 0.08], [0.05, 1.2, -0.06], [0.08, -0.06, 1.4]])
UR5 = pm.MobileRobot.from_body(Body(30.0, np.array([0.02, 0.01, 0.1]), INERTIA)).mount(
    "ur5", (0.1, -0.05, 0.2, 0.4)
)
UR5 = UR5.attach(pm.PayloadBody(1.0, (0, 0.01, 0.05), size=(0.1, 0.1, 0.1)))
NAMES = ["end effector", "end effector angle", "effort", "tip-over margin"]
LIMITS = ["exceed a position limit", "exceed a speed limit"]
ELBOW = "ur5/elbow_joint"
SPREAD: dict[str, Any] = {
    "yaw_inertia": pm.Uniform(1.3, 1.5),
    "com.x": pm.Uniform(-0.02, 0.02),
    "loads.0.mass": pm.Uniform(0.5, 5),
    "at.x": pm.Uniform(0.0, 0.1),
    "kp": pm.Uniform(90, 110),
}


def scenario(**options: Any) -> pm.Scenario:
    given = {"n": 3, "dt": 0.02, "seed": 3, "after": 0.1, "spread": SPREAD, **options}
    return pm.Scenario(
        robot=UR5, controller=pm.ComputedTorque(UR5, 100, 20), trajectory=Waving(UR5, 0.6), **given
    )


@pytest.fixture(scope="module")
def runs() -> pm.Ensemble:
    return run_scenario(scenario(n=40))


def test_metrics_of_an_arm_are_those_of_its_own_kinematics_limits_and_balance() -> None:
    numbers = np.random.default_rng(4)
    q, desired = (UR5.random_configuration(numbers, (20,)) for _ in range(2))
    v, a, u = (size * numbers.normal(size=(20, UR5.nv)) for size in (1, 1, 20))
    q[::3, 5] += np.copysign(np.pi, q[::3, 5])  # beyond the range of the elbow
    v[::4, 6] *= 10
    assert [one.name for one in UR5.metrics] == [*NAMES, *LIMITS]
    found = UR5.evaluate_metrics(0.0, q, v, a, u, pm.Reference(desired, v, a))
    apart = error_sizes(pose_error(UR5.frame_pose(desired), UR5.frame_pose(q)))
    np.testing.assert_allclose(found[:, :2], apart, atol=CLOSE)
    np.testing.assert_allclose(found[:, 2], (np.abs(u) / UR5.effort_limit).max(axis=1), rtol=CLOSE)
    np.testing.assert_allclose(
        found[:, 3], tip_over_margin(MotionStates(UR5, q, v, a)), rtol=CLOSE, atol=CLOSE
    )
    beyond = (q[:, 3:] < UR5.lower[3:]) | (q[:, 3:] > UR5.upper[3:])
    assert 0 < beyond.any(axis=1).sum() < len(q)
    np.testing.assert_array_equal(found[:, 4], beyond.any(axis=1))
    too_fast = (np.abs(v) > UR5.velocity_limit).any(axis=1)
    assert 0 < too_fast.sum() < len(v)
    np.testing.assert_array_equal(found[:, 5], too_fast)
    symbolic = UR5.array_dynamics.evaluate_metrics(0.0, q, v, a, u, pm.Reference(desired, v, a))  # type: ignore[union-attr]
    np.testing.assert_allclose(symbolic, found, rtol=CLOSE, atol=CLOSE)


def test_each_arm_has_an_end_effector_and_a_bare_robot_no_measure() -> None:
    two = pm.MobileRobot.box().mount("double_pendulum").mount("double_pendulum", (0.2, 0, 0.2, 0))
    names = [one.name for one in two.metrics]
    assert names[:2] == NAMES[:2]
    assert names[2:4] == [f"{name} of {two.mounts[1].name}" for name in NAMES[:2]]
    assert NAMES[-1] in names
    bare = pm.MobileRobot.box()
    assert bare.metrics == ()
    at = pm.Reference(*np.zeros((3, 3)))
    assert bare.evaluate_metrics(0.0, *np.zeros((4, 3)), at).shape == (0,)  # type: ignore[call-arg]
    unknown = pm.MobileRobot.from_model(pm.MobileRobot.box().model).mount("double_pendulum", (0, 0, 0.2, 0))
    assert NAMES[-1] not in [one.name for one in unknown.metrics]  # whose footprint is not known


def test_a_member_is_judged_as_its_rollout_is(runs: pm.Ensemble) -> None:
    member = runs.arguments(7)
    alone: Any = pm.simulate(*member[:3], **member.options)
    robot, begin = alone.plant, runs.scenario.begin
    apart = error_sizes(pose_error(robot.frame_pose(alone.reference.q), robot.frame_pose(alone.q)))
    effort = (np.abs(alone.u) / robot.effort_limit).max(axis=1)
    expected = np.column_stack([apart, effort, tip_over_margin(alone)])[begin:]
    worst = [*expected[:, :3].max(axis=0), expected[:, 3].min()]
    np.testing.assert_allclose(runs.worst_metric[7], [*worst, 0.0, 0.0], rtol=CLOSE, atol=CLOSE)
    rms = np.sqrt(np.square(expected).mean(axis=0))
    np.testing.assert_allclose(runs.rms_metric[7], [*rms, 0.0, 0.0], rtol=CLOSE, atol=CLOSE)
    told = alone.metrics()
    assert [(name, signal.unit) for name, signal in told.items()] == list(
        zip([*NAMES, *LIMITS], ("m", "rad", "", "m", "", ""), strict=True)
    )
    np.testing.assert_allclose(told[NAMES[3]].values[begin:], expected[:, 3], rtol=CLOSE)


def test_robots_are_compared_by_measures_and_joints(runs: pm.Ensemble) -> None:
    joints = [one.name for one in runs.scenario.coordinates[3:]]
    assert list(runs.error_quantile().sizes) == ["distance", "heading", *joints, *NAMES, *LIMITS]
    assert list(runs.bands().quantiles) == list(runs.error_quantile().sizes)
    margin = runs.largest("tip-over margin")
    np.testing.assert_array_equal(margin, runs.worst_metric[:, 3])
    assert runs.worst(1, by="tip-over margin") == margin.argmin()
    np.testing.assert_array_equal(runs.largest(ELBOW), runs.max_error[:, 5])
    assert runs.worst(1, by=ELBOW) == runs.max_error[:, 5].argmax()
    within = runs.error_quantile(0.75)
    assert within["tip-over margin"] == np.sort(margin)[10]  # 30 of 40 have at least that
    assert within["effort"] == np.sort(runs.largest("effort"))[29]
    bands = runs.bands([0.25, 1.0])
    assert (bands["tip-over margin"][0] > bands["tip-over margin"][1]).all()
    begun = bands.t >= 0.1
    for name in ("end effector", "effort", ELBOW):
        assert bands[name][1][begun].max() == pytest.approx(runs.error_quantile(1.0)[name], rel=2**-5)
    assert bands["tip-over margin"][1][begun].min() == pytest.approx(margin.min(), rel=2**-5)
    words = str(runs)
    assert f"largest end effector [m] {'':21} least {runs.largest('end effector').min():.4g}" in words
    assert "\nsmallest tip-over margin [m]" in words
    for ask in (runs.largest, lambda by: runs.worst(1, by), runs.error_quantile(), runs.bands()):
        get = ask if callable(ask) else ask.__getitem__
        with pytest.raises(UnknownName, match=r"'tip-over margn'.*'tip-over margin'"):
            get("tip-over margn")


def test_a_choice_judges_that_alone(runs: pm.Ensemble) -> None:
    some = run_scenario(scenario(metrics=["tip-over margin", "end effector"]))
    np.testing.assert_array_equal(some.worst_metric, runs.worst_metric[:3, [0, 3]])
    assert [one.name for one in some.scenario.recorded_metrics] == ["end effector", "tip-over margin"]
    none = run_scenario(scenario(metrics=()))
    assert none.worst_metric.shape == (3, 0)
    np.testing.assert_array_equal(none.max_error, some.max_error)


def test_files_and_tables_keep_measures(runs: pm.Ensemble, tmp_path: Path) -> None:
    runs.save(tmp_path / "runs.npz")
    for known in (None, runs.scenario):
        loaded = pm.Ensemble.load(tmp_path / "runs.npz", known)
        np.testing.assert_array_equal(loaded.worst_metric, runs.worst_metric)
        np.testing.assert_array_equal(loaded.rms_metric, runs.rms_metric)
        assert loaded.scenario.recorded_metrics == runs.scenario.recorded_metrics
    other = replace(runs.scenario, metrics=["effort"])
    with pytest.raises(pm.InvalidArgument, match=r"^scenario does not match .*: metrics is end effector, "):
        pm.Ensemble.load(tmp_path / "runs.npz", other)
    runs.to_csv(tmp_path / "runs.csv")
    header, first = (tmp_path / "runs.csv").read_text().splitlines()[:2]
    columns = dict(zip(header.split(","), first.split(","), strict=True))
    assert float(columns["worst_metric_tip-over margin [m]"]) == runs.worst_metric[0, 3]
    assert float(columns["rms_metric_effort"]) == runs.rms_metric[0, 2]


def test_figures_show_measures(runs: pm.Ensemble) -> None:
    figure = plots.bands({"UR5": runs})
    assert [axes.get_ylabel().partition(" [")[0] for axes in figure.axes][2:] == NAMES
    least = math.floor(1e3 * runs.error_quantile()["tip-over margin"])  # a margin is never rounded up
    stays = f"99 % have at least {least} mm from 0.1 s on"
    assert figure.axes[-1].get_title(loc="left") == stays
    (joint,) = plots.bands(runs, by=[ELBOW]).axes
    assert joint.get_ylabel().startswith(f"error of\n{ELBOW} [")
    with pytest.raises(UnknownName, match=r"unknown band 'effort!'"):
        plots.bands(runs, by=["effort!"])
    drivers = plots.drivers(runs, share=0.2, by="tip-over margin")
    assert drivers.get_suptitle() == "loads.0.mass drives the worst 20 % by tip-over margin most"
    assert drivers.axes[-1].get_ylabel() == "smallest tip-over margin [mm]"


def test_a_robot_that_diverges_has_no_margin() -> None:
    wild = replace(scenario(), limit=2e-4)
    runs = run_scenario(wild)
    assert runs.diverged.all()
    assert runs.error_quantile()["tip-over margin"] == -np.inf
    assert runs.error_quantile()["effort"] == np.inf
    bands = runs.bands([0.5])
    assert bands["tip-over margin"][0, -1] == -np.inf
    assert bands["effort"][0, -1] == np.inf


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_bands_have_numbers_of_any_size(engine: pm.Engine) -> None:
    """A force of kilonewtons, a load that falls, and a length below a nanometre, which all robots share."""
    given = {
        "force": Metric("force", "N", "of nothing", function=lambda sample: 2e4 * sample.t),
        "load": Metric("load", "N", "of nothing", "smallest", lambda sample: 3e3 - 5e3 * sample.t),
        "gap": Metric("gap", "m", "of nothing", function=lambda sample: 1e-12 * (1.0 + sample.t)),
    }
    bands = run_scenario(replace(scenario(), metrics=list(given.values())), engine=engine).bands([0.5])
    exact = {"force": 2e4 * bands.t, "load": 3e3 - 5e3 * bands.t, "gap": 1e-12 * (1.0 + bands.t)}
    for name, values in exact.items():
        np.testing.assert_allclose(bands[name][0], values, rtol=2**-5, atol=1e-4 * np.abs(values).max())


class Fenced(Pushed):
    """A body between two walls, which states how far it is from them and how fast it is, in plain NumPy."""

    metrics = (Metric("clearance", "m", "from the walls", "smallest"), Metric("speed", "m/s", "of the body"))
    wall = 0.33

    def evaluate_metrics(self, t: Any, q: Any, v: Any, a: Any, u: Any, reference: Any) -> Any:
        speed = np.sqrt(v[..., 0] ** 2 + v[..., 1] ** 2)
        return np.stack([self.wall - np.abs(q[..., 0]), speed], axis=-1)


def fenced(plant: Any, **options: Any) -> pm.Scenario:
    given = {"n": 6, "dt": 0.01, "spread": {"mass": pm.Uniform(20, 60)}, **options}
    path = pm.FixedHeading(pm.RestToRest((0, 0), (0.29, 0.1), 1.0), psi=0.3)
    return pm.Scenario(robot=plant, controller=pm.PD(2000, 100), trajectory=path, **given)


def test_a_plant_of_ones_own_states_measures_in_plain_numpy() -> None:
    made = [run_scenario(fenced(Fenced(), after=0.6), engine=each) for each in pm.Engine]
    np.testing.assert_allclose(made[1].worst_metric, made[0].worst_metric, rtol=CLOSE, atol=CLOSE)
    np.testing.assert_allclose(made[1].rms_metric, made[0].rms_metric, rtol=CLOSE, atol=CLOSE)
    clearance = made[0].largest("clearance")
    assert clearance.min() < 0 < clearance.max()  # some overshoot into the wall
    trace = made[0].member(2)
    begin = made[0].scenario.begin
    assert clearance[2] == pytest.approx((0.33 - np.abs(trace.q[begin:, 0])).min(), abs=CLOSE)
    assert made[0].error_quantile(1.0)["clearance"] == clearance.min()


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_a_measure_that_becomes_nan_is_refused(engine: pm.Engine) -> None:
    class Late(Pushed):
        metrics = (Metric("clearance", "m", "from the walls", "smallest"),)

        def evaluate_metrics(self, t: Any, q: Any, v: Any, a: Any, u: Any, reference: Any) -> Any:
            return np.sqrt(0.1 - q[..., :1])

    with np.errstate(invalid="ignore"), refused(r"^robot \d: plant is a Late, .* NaN as"):
        run_scenario(fenced(Late()), engine=engine)


CART = pm.MobileRobot(mass=30.0, yaw_inertia=1.3)
ROUND = pm.Tangent(pm.Circle(1.0, 0.5, 2.0))
WALL = Metric("gap", "m", "distance from the wall", "smallest", lambda sample: 1.02 - sample.q[0])


def carts(engine: pm.Engine | None = None, **options: Any) -> pm.Ensemble:
    given: dict[str, Any] = {"n": 9, "spread": {"plant.mass": pm.Uniform(20, 40)}, "dt": 0.02}
    given |= options
    law = pm.DisturbanceObserver(pm.PD(120, 120), CART)
    push = pm.ConstantForce((3.0, 0.0, 0.0))
    return pm.ensemble(CART, law, ROUND, forces=[push], engine=engine, **given)


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_a_function_of_a_sample_is_a_metric(engine: pm.Engine) -> None:
    def speed(sample: Any) -> Any:
        return np.sqrt(sample.v[0] ** 2 + sample.v[1] ** 2)

    found = carts(engine, metrics=[WALL, Metric("speed", "m/s", "speed", function=speed)], traces=range(9))
    traces = [found.traces[i] for i in range(9)]
    gaps = np.array([1.02 - run.q[:, 0] for run in traces])
    speeds = np.array([np.hypot(*run.v[:, :2].T) for run in traces])
    np.testing.assert_allclose(found.largest("gap"), gaps.min(axis=1), rtol=1e-9)
    np.testing.assert_allclose(found.largest("speed"), speeds.max(axis=1), rtol=1e-9)
    np.testing.assert_allclose(found.rms("speed"), np.sqrt((speeds**2).mean(axis=1)), rtol=1e-9)
    assert found.rms("heading") is not None
    assert found.error_quantile(1.0)["gap"] == found.largest("gap").min()
    assert found.worst(1, "gap")[0] == gaps.min(axis=1).argmin()
    fastest = speeds[:, :: found.scenario.stride].max(axis=0)
    np.testing.assert_allclose(found.bands([1.0])["speed"][0], fastest, rtol=1 / 32)
    assert "smallest gap [m]" in str(found)
    plots.bands(found, by=["gap", "speed"])
    plots.drivers(found, by="gap", share=0.3)


def test_a_mapping_adds_functions_to_the_metrics_of_the_robot() -> None:
    def lift(sample: Any) -> Any:
        return np.abs(sample.error[3]) > 0.01  # whether, as a number

    found = scenario(n=2, metrics={"lift": lift})
    named = [one.name for one in found.recorded_metrics]
    assert named == [*(one.name for one in UR5.metrics), "lift"]
    assert set(run_scenario(found).largest("lift")) <= {0.0, 1.0}


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_signals_are_kept_for_all_robots(engine: pm.Engine, tmp_path: Path) -> None:
    guess = {"guess": lambda sample: sample.signals["disturbance"].value[0]}
    found = carts(engine, keep=["disturbance"], traces=[4], metrics=guess)
    unit, values = found.kept["disturbance"]
    assert unit == "N, N m"
    assert values.shape == (9, len(found.scenario.grid), 3)
    alone = found.traces[4].signals["disturbance"].values
    np.testing.assert_allclose(values[4], alone[:: found.scenario.stride], rtol=1e-9, atol=1e-9)
    assert found.largest("guess")[4] == pytest.approx(np.abs(alone[:, 0]).max(), rel=1e-9)
    found.save(tmp_path / "runs.npz")
    again = pm.Ensemble.load(tmp_path / "runs.npz")
    np.testing.assert_array_equal(again.kept["disturbance"].values, values)
    assert found.to_xarray().kept_disturbance.attrs["units"] == unit
    with pytest.raises(ValueError, match="read-only"):
        values[0, 0, 0] = 1


def test_kept_signals_end_where_a_robot_diverges() -> None:
    found = carts(spread={"plant.mass": [30.0] * 8 + [0.01]}, keep=["disturbance"], every=1)
    values = found.kept["disturbance"].values
    assert found.diverged.tolist() == [False] * 8 + [True]
    lived = round(found.diverged_at[8] / 0.02)
    assert np.isfinite(values[:8]).all()
    assert np.isfinite(values[8, :lived]).all()
    assert np.isnan(values[8, lived:]).all()
    assert lived > 1


def judged(function: Any) -> pm.Ensemble:
    return carts(metrics={"gap": function})


test_what_is_no_metric_is_refused = refusals(
    (lambda: scenario(metrics="effort"), r"^metrics is 'effort', expected a sequence of names.*function"),
    (lambda: carts(metrics={"distance": abs}), "metrics has 'distance' twice, expected different names"),
    (lambda: judged(lambda sample: sample.q), r"^metrics has 'gap', whose function returned .* a number$"),
    (lambda: judged(lambda sample: np.nan * sample.q[0]), "^robot 0: .*NaN as 'gap'"),
    (lambda: judged(lambda sample: float(sample.q[0])), "metrics has 'gap': float.*or give engine=Engine.P"),
)
LEAST = Metric("gap", "m", "gap", "least", abs)
test_names_that_there_are_not_are_refused = refusals(
    (lambda: scenario(metrics=["efort"]), "unknown metric 'efort'.*'effort'"),
    (lambda: carts(metrics=[LEAST]), "worst of the metric 'gap'.*largest, smallest, ever"),
    (lambda: carts(keep=["disturbanc"]), "unknown signal 'disturbanc'.*'disturbance'"),
    by=unknown,
)


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
@pytest.mark.parametrize("robot", [UR5, pm.WheeledRobot(UR5, pm.WheelTable.mecanum(0.5, 0.4, 0.1))])
def test_robots_whose_joints_exceed_limits_are_counted(robot: Any, engine: pm.Engine) -> None:
    joint = "start_rate.ur5/elbow_joint_rate"
    rest = pm.WholeBody(UR5, pm.FixedHeading(pm.Hold((0, 0), 0.1), 0.0), None)
    spread = {joint: pm.Uniform(-6.0, 6.0)}
    parts = robot, pm.ComputedTorque(robot, 9, 6), rest
    with pytest.warns(LimitWarning, match=r"robots exceed a speed limit: a joint is faster than its limit$"):
        runs = pm.ensemble(*parts, n=6, spread=spread, dt=0.01, engine=engine, seed=2)
    fast = np.abs(runs.draws[joint]) > 3.15
    assert 0 < fast.sum() < 6
    np.testing.assert_array_equal(runs.faults["exceed a speed limit"], fast)
    with pytest.warns(LimitWarning, match=r"^ur5/elbow_joint moves at "):
        member = runs.member(int(fast.argmax()))
    assert [event.kind for event in member.events] == ["speed limit"]


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_an_unknown_signal_in_a_metric_is_named_and_another_missing_key_is_the_users(
    engine: pm.Engine,
) -> None:
    loop: Any = {"n": 2, "spread": {}, "dt": 0.1, "engine": engine}
    parts = pm.MobileRobot.box(), pm.PD(1, 1), pm.Tangent(pm.Circle(1, 1, 0.2))
    with pytest.raises(Exception, match="unknown signal 'mas'"):
        pm.ensemble(*parts, metrics={"m": lambda sample: sample.signals["mas"].value}, **loop)
    with pytest.raises(Exception, match="mine") as caught:
        pm.ensemble(*parts, metrics={"m": lambda sample: dict[str, Any]()["mine"]}, **loop)
    assert "unknown signal" not in str(caught.value)
