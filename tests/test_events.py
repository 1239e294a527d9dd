"""Signals and events of runs and ensembles: limits, saturation, slip, tipping over; runs that end at them."""

import csv
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Annotation

import pinmobile as pm
from pinmobile import plots
from pinmobile.controllers import TorqueToVoltage, WheelSpeed
from pinmobile.errors import LimitWarning
from pinmobile.plant import Event, first_times
from pinmobile.viewer.scene import _captions
from pinmobile.wheels import Ramp
from tests.parts import PID, Axle, Cart, CartCircle, Eight, Follower, Nodding, Smoothed, Spring, Waving
from tests.refusals import refused, unknown

WHEEL: Any = {"mass": 1.0, "spin_inertia": 0.01, "supports": [(0.3, 0)]}


def on_wheels(ground: Any = None, height: float = 0.1, **motors: Any) -> pm.WheeledRobot:
    table = pm.WheelTable.differential(0.5, 0.1, **WHEEL, **motors)
    return pm.WheeledRobot(pm.MobileRobot(30, 3, com=(0.1, 0, height)), table, ground or pm.Rolling())


def turning(robot: pm.WheeledRobot, rate: float = 1.5, **options: Any) -> pm.Rollout:
    law, path = WheelSpeed(pm.UnicycleTracking(), robot, kp=0.5), pm.Tangent(pm.Circle(1.0, rate, 2.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LimitWarning)
        return pm.simulate(robot, law, path, dt=0.01, **options)


def of_kind(run: pm.Rollout, kind: str) -> Event:
    """Return the first event of a kind; only inputs and motors have several."""
    found = [event for event in run.events if event.kind == kind]
    assert len({event.name for event in found}) == len(found) > 0
    return found[0]


def test_an_input_at_its_limit_is_an_event_without_a_warning() -> None:
    robot = on_wheels(motor=pm.Motor(torque_limit=0.5))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = pm.simulate(
            robot,
            WheelSpeed(pm.UnicycleTracking(), robot, kp=5),
            pm.Tangent(pm.Circle(1.0, 1.5, 2.0)),
            dt=0.01,
        )
    event, at = of_kind(run, "saturation"), np.abs(run.u[:, 0]) == 0.5
    assert (event.name, event.t, event.samples) == ("left", run.t[at.argmax()], at.sum())
    assert abs(event.value) == abs(event.limit) == 0.5
    assert f"input left is at its limit of {event.limit:g} N m (from t = {event.t:g} s" in str(run)


def test_the_first_of_several_events_of_a_kind_gives_its_time() -> None:
    late, early = (
        Event("speed limit", name, t, t, 9.0, 1.0, "rad/s", 3, "") for name, t in (("a", 6), ("b", 3))
    )
    other = Event("slip", "c", 4, 4, 9.0, 0.0, "m/s", 3, "")
    assert list(first_times((late, other, early)).items()) == [("speed limit", 3), ("slip", 4)]


def test_a_joint_at_a_limit_of_zero_does_not_pass_it_by_rounding() -> None:
    robot = pm.MobileRobot.box(100, (1, 0.8, 0.3)).mount("tiago_no_hand", at=(0, 0, 0.3, 0))
    law, path = pm.ComputedTorque(robot, 100, 20), pm.Tangent(pm.Circle(1, 0.5, 1))
    run = pm.simulate(robot, law, pm.WholeBody(robot, path, None), dt=0.01)
    assert run.q[:, 3].min() <= 0 == robot.coordinates[3].lower
    assert not run.events
    assert not run.metrics()["exceed a position limit"].values.any()


@pytest.mark.parametrize(("x", "falls"), [(0.0, False), (-1e-4, True)])
def test_a_caster_that_carries_nothing_lets_no_robot_tip_over(x: float, falls: bool) -> None:
    robot = pm.WheeledRobot(pm.MobileRobot(30, 3, com=(x, 0.1, 0.1)), on_wheels().table)
    law, path = pm.Backstepping(pm.UnicycleTracking(), robot), pm.Tangent(pm.Circle(1, 0.5, 4))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LimitWarning)
        run = pm.simulate(robot, law, path, dt=0.01)
        many = pm.ensemble(robot, law, path, dt=0.01, n=20, spread={"mass": pm.Uniform(20, 40)})
    assert bool(run.events) == falls
    assert ("balances: its centre of mass is over the edge" in str(robot)) != falls
    assert many.faults.get("load below 0", np.zeros(20)).all() == falls


def test_a_motor_at_its_current_is_an_event() -> None:
    robot = on_wheels(motor=pm.Motor(resistance=2, torque_constant=0.5, voltage=24, current=1.0))
    by_voltage = robot.by_voltage()
    law = TorqueToVoltage(WheelSpeed(pm.UnicycleTracking(), robot, kp=5), by_voltage)
    run = pm.simulate(by_voltage, law, pm.Tangent(pm.Circle(1.0, 1.5, 2.0)), dt=0.01)
    event = of_kind(run, "current limit")
    at = np.abs(run.signals["currents"].values[:, 0]) >= 1.0 - 1e-6
    assert (event.name, event.limit, event.samples) == ("left", 1.0, at.sum())


def test_an_ensemble_counts_robots_whose_joints_exceed_their_effort() -> None:
    robot = pm.MobileRobot.box(60.0).mount("ur5", at=(0.2, 0, 0.3, 0))
    still = pm.WholeBody(robot, pm.FixedHeading(pm.Hold([0, 0], 0.1), 0), pm.Hold([0, -0.8, 1, 0, 0, 0], 0.1))
    law = pm.ComputedTorque(robot, 100, 20)
    runs = pm.ensemble(
        robot, law, still, n=2, spread={"start.ur5/elbow_joint": np.array([0.0, 2.0])}, dt=0.01
    )
    counted = [words for words in runs.events if "effort limit" in words]
    assert "1 of 2 robots exceed the effort limit of ur5/elbow_joint, 150 N m" in counted
    exceeding = {event.name for event in runs.member(1).events if event.kind == "effort limit"}
    assert len(counted) == len(exceeding)


def test_a_wheel_faster_than_its_file_allows_is_an_event() -> None:
    event = of_kind(turning(on_wheels(motor=pm.Motor(rate_limit=5.0)), rate=2.0), "speed limit")
    assert (event.name, event.limit) == ("left", 5.0)
    assert str(event).startswith("wheel of left turns at ")
    assert "top speed" in on_wheels(motor=pm.Motor(rate_limit=5.0)).describe()


def kinds_of(found: pm.Ensemble) -> list[set[str]]:
    """Return the kinds of events of each robot, one run after the other."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [{event.kind for event in found.member(i).events} for i in range(len(found))]


@pytest.mark.parametrize("takes_volts", [False, True])
@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_an_ensemble_counts_robots_whose_motors_are_faster_than_without_load(
    engine: pm.Engine, takes_volts: bool
) -> None:
    robot: Any = on_wheels(motor=pm.Motor(resistance=2, torque_constant=0.5, voltage=24))
    law, constants = WheelSpeed(pm.UnicycleTracking(), robot, kp=0.5), np.array([0.4, 0.5, 0.55])
    powered = robot.by_voltage()
    plant, controller = (powered, TorqueToVoltage(law, powered)) if takes_volts else (robot, law)
    path, spread = pm.Tangent(pm.Circle(2.0, 2.4, 0.1)), {"plant.*.torque_constant": constants}
    with pytest.warns(LimitWarning, match="exceed a speed limit"):
        found = pm.ensemble(plant, controller, path, spread=spread, n=3, dt=0.01, engine=engine)
    kinds = kinds_of(found)
    counts = found.largest("exceed a speed limit")
    assert counts.tolist() == ["speed limit" in each for each in kinds] == [False, True, True]


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_an_ensemble_counts_robots_whose_motors_lack_torque(engine: pm.Engine) -> None:
    robot: Any = on_wheels(motor=pm.Motor(resistance=2, torque_constant=0.5, voltage=24, efficiency=0.8))
    path, spread = pm.Tangent(pm.Circle(2.0, 1.0, 0.5)), {"plant.*.resistance": np.array([0.2, 2.0, 20.0])}
    law = pm.Backstepping(pm.UnicycleTracking(), robot)
    with pytest.warns(LimitWarning, match="exceed an effort limit"):
        found = pm.ensemble(robot, law, path, spread=spread, n=3, dt=0.01, engine=engine)
    kinds = kinds_of(found)
    counts = found.largest("exceed an effort limit")
    assert counts.tolist() == ["effort limit" in each for each in kinds] == [False, False, True]
    torques, ratios = np.abs(found.max_input).max(axis=1), found.largest("effort")
    stall = 0.8 * 0.5 * 24 / np.array([0.2, 2.0, 20.0])
    np.testing.assert_allclose(ratios, torques / stall, rtol=1e-9)
    assert plots.drivers(found, share=0.4, by="exceed an effort limit").get_suptitle()


def test_an_ensemble_tells_what_the_robots_that_failed_share() -> None:
    robot: Any = on_wheels(motor=pm.Motor(resistance=2, torque_constant=0.5, voltage=24))
    path, spread = pm.Tangent(pm.Circle(2.0, 1.0, 0.5)), {"plant.*.resistance": pm.Uniform(1.0, 30.0)}
    with pytest.warns(LimitWarning, match="exceed an effort limit"):
        found = pm.ensemble(
            robot, pm.Backstepping(pm.UnicycleTracking(), robot), path, spread=spread, n=200, dt=0.02
        )
    assert re.search(r"^the robots that failed have \w+\.motor\.resistance above ", str(found), re.MULTILINE)
    figure = plots.drivers(found, by="exceed an effort limit")
    assert ".resistance drives those that exceed an effort limit most" in figure.get_suptitle()
    failed = int((found.largest("exceed an effort limit") > 0).sum())
    keys = [text.get_text() for text in figure.legends[0].get_texts()]
    assert keys[0] == f"those that exceed an effort limit: {failed} robots"
    with unknown("'resistence', available: left.motor.resistance, right.motor.resistance"):
        pm.ensemble(robot, pm.PD(1, 1), path, spread={"resistence": pm.Uniform(1, 2)}, n=2, dt=0.02)


def test_a_torque_that_its_motor_lacks_at_its_rate_is_an_event() -> None:
    motors = pm.Motor(resistance=2, torque_constant=0.5, voltage=4)
    run = turning(on_wheels(motor=motors), rate=0.4, v0=np.zeros(5))
    event, motor = of_kind(run, "effort limit"), run.plant.table.actuators[0].motor
    assert (event.name, event.unit) == ("left", "N m")
    margin = motor.margin(run.u[:, 0], run.v[:, -2])
    assert event.value == pytest.approx(-margin.min())
    assert event.samples == (margin < 0).sum()


def test_a_wheel_that_slides_is_an_event_with_its_fastest_slip() -> None:
    run = turning(on_wheels(pm.Coulomb(0.05)))
    event, slides = of_kind(run, "slip"), run.signals["slides"].values > 0
    speeds = np.hypot(run.signals["slip_along"].values, run.signals["slip_across"].values) * slides
    assert event.value == speeds.max()
    assert event.unit == "m/s"
    assert event.t == run.t[speeds.max(axis=1) > 0][0]
    assert event.name == "left, right"
    assert "slip" not in {one.kind for one in turning(on_wheels(pm.Coulomb(5.0)), rate=0.1).events}


def test_rolling_that_the_ground_cannot_hold_is_slip() -> None:
    run = turning(on_wheels(), rate=4.0)
    event, margin = of_kind(run, "slip"), run.metrics()["slip margin"].values
    assert event.value == margin.min() < 0
    assert event.unit == "N"
    assert event.samples == (margin < 0).sum()


def test_an_arm_whose_base_tips_over_is_an_event() -> None:
    robot = pm.MobileRobot(3.0, 1.0, com=(0, 0, 0.1)).mount("ur5", (0.3, 0, 0.2, 0))
    run = pm.simulate(robot, pm.ComputedTorque(robot, 100, 20), Waving(robot, 0.6), dt=0.01, duration=0.2)
    assert of_kind(run, "tip over").value == run.metrics()["tip-over margin"].values.min() < 0


def test_a_base_without_arms_that_tips_over_is_an_event() -> None:
    box = pm.MobileRobot.box(mass=60, size=(0.8, 0.6, 0.9))
    motion, law = pm.Tangent(pm.Circle(1.0, 3.2, 1.0)), pm.ComputedTorque(box, 25, 10)
    run = pm.simulate(box, law, motion, dt=0.01)
    margin = pm.balance.tip_over_margin(run)
    (event,) = run.events
    assert (event.kind, event.t) == ("tip over", run.t[np.argmax(margin < 0)])
    assert event.value == pytest.approx(margin.min(), rel=1e-12)
    assert pm.simulate(box, law, motion, dt=0.01, stop_at=["tip over"]).t[-1] == event.t
    assert not pm.simulate(box, law, pm.Tangent(pm.Circle(1.0, 1.0, 1.0)), dt=0.01).events


def test_a_robot_at_rest_across_a_ramp_does_not_slip() -> None:
    table = pm.WheelTable.differential(0.5, 0.1, mass=1.0, spin_inertia=0.005, supports=[(0.3, 0), (-0.3, 0)])
    ground = pm.Coulomb(0.8, ramp=Ramp(0.2, np.pi / 2))
    robot = pm.WheeledRobot(pm.MobileRobot(30, 1.3, com=(0, 0, 0.2)), table, ground)
    rest = pm.FixedHeading(pm.Hold((0, 0), 0.2), 0)
    assert not pm.simulate(robot, pm.law(lambda t, q, v, reference: np.zeros(2)), rest, dt=0.01).events


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_a_run_ends_at_the_first_event_of_a_kind(engine: pm.Engine) -> None:
    robot = on_wheels(pm.Coulomb(0.3), height=0.5)
    whole = turning(robot, 2.5, engine=engine, duration=0.6)
    first = of_kind(whole, "tip over")
    assert 0 < first.t < whole.t[-1]
    ended = turning(robot, 2.5, engine=engine, duration=0.6, stop_at=["tip over"])
    assert ended.t[-1] == first.t
    assert of_kind(ended, "tip over").samples == 1
    for name in ("q", "v", "u", "error"):
        np.testing.assert_array_equal(getattr(ended, name), getattr(whole, name)[: len(ended)])
    np.testing.assert_array_equal(ended.signals["loads"].values, whole.signals["loads"].values[: len(ended)])
    np.testing.assert_array_equal(ended.reference.q, whole.reference.q[: len(ended)])


def test_a_run_that_diverges_after_its_end_does_not_diverge() -> None:
    robot = on_wheels(pm.Coulomb(0.3), height=0.5)
    with pytest.raises(pm.Diverged):
        turning(robot, limit=0.5)
    assert turning(robot, limit=0.5, stop_at=["slip"]).t[-1] < 1.0


def test_an_unknown_kind_of_event_is_refused() -> None:
    with unknown(r"unknown event 'slips', did you mean 'slip'\?.*position limit, .*tip over"):
        turning(on_wheels(), stop_at=["slips"])
    with refused("stop_at is 'slip', expected kinds of events"):
        turning(on_wheels(), stop_at="slip")


def test_figures_and_captions_name_events() -> None:
    run = turning(on_wheels(pm.Coulomb(0.3), height=0.5))
    for figure in (plots.errors(run), plots.states(run), plots.forces(run), plots.loads(run)):
        words = {text.get_text() for text in figure.axes[0].texts}
        assert {"slip", "tip over"} <= {kind for text in words for kind in text.split(", ")}
        assert not any("slip" in text.get_text() for axes in figure.axes[1:] for text in axes.texts)
    powered = on_wheels(motor=pm.Motor(resistance=2, torque_constant=0.5, voltage=24)).by_voltage()
    both = plots.forces({"one": run, "two": replace(run, plant=powered)}).axes
    assert [axes.get_ylabel() for axes in both] == ["left [N m or V]", "right [N m or V]"]
    heights = [text.xyann[1] for text in both[0].texts if isinstance(text, Annotation)]
    assert len({*heights}) == len(heights) > 2  # no words hide others, of any run
    times, first = np.array([0.0, 2.0]), of_kind(run, "tip over").t
    before, after = _captions({"": run}, times, {})
    assert first > 0
    assert "tip over" not in before
    assert "tip over" in after


def test_an_ensemble_states_what_was_spread_who_failed_and_what_drives_the_worst(tmp_path: Path) -> None:
    robot = on_wheels(motor=pm.Motor(torque_limit=1.0))
    law = WheelSpeed(pm.UnicycleTracking(), robot, kp=5)
    spread: Any = {"com.z": pm.Uniform(0.1, 0.9), "start.y": pm.Uniform(0.0, 0.3)}
    with pytest.warns(LimitWarning, match=r"^6 of 100 robots tip over: no loads") as told:
        runs = pm.ensemble(robot, law, pm.Tangent(pm.Circle(1.0, 1.5, 2.0)), n=100, spread=spread, dt=0.02)
    text = str(runs)
    assert len(told) == 1
    assert "spread: com.z Uniform(low=0.1, high=0.9) m, start.y Uniform(low=0.0, high=0.3) m\n" in text
    tips, lifts = (runs.largest("tip over") > 0, runs.largest("load") < 0)
    slips = runs.largest("slip margin") < 0
    failed = (tips | lifts | slips).sum()
    reasons = f"{lifts.sum()} load below 0, {tips.sum()} tip over, {slips.sum()} slip margin below 0"
    assert f"failed: {failed} of 100 robots ({reasons})\n" in text
    assert (
        f"{(runs.max_input[:, 0] >= 1.0).sum()} of 100 robots have input left at its limit of 1 N m" in text
    )
    assert "the worst 5 % by distance have start.y above 0.2" in text
    assert 0 < tips.sum() < failed < 100
    runs.save(tmp_path / "runs.npz")
    again = pm.Ensemble.load(tmp_path / "runs.npz")
    assert again.events == runs.events
    assert str(again).startswith(text.partition("\n")[0])
    index = int(tips.argmax())
    assert of_kind(runs.member(index), "tip over").kind == "tip over"
    assert "failed" not in str(
        pm.ensemble(robot, law, pm.Tangent(pm.Circle(1.0, 0.1, 2.0)), n=2, spread={}, dt=0.02)
    )


# -- signals ---------------------------------------------------------------------------------------


ROBOT = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))
BODY: Any = (Nodding(Eight()), {"dt": 0.02, "duration": 3.0})
FOLLOWER: Any = Follower()
CART: Any = (CartCircle(), {"dt": 0.02, "duration": 3.0})


class TellingPID(PID):
    def signals(self, state: Any) -> Any:
        return {"integral": ("N", state["sum"]), "applied": ("N", state["u"][0])}


class TellingSpring(Spring):
    def signals(self, t: float, pose: Any, rate: Any) -> Any:
        return {"pull": ("N", self(t, pose, rate)[:2]), "sine": ("", np.sin(t))}


class TellingAxle(Axle):
    def signals(self, t: float, q: Any, v: Any) -> Any:
        return {"axle torque": ("N m", self.on_coordinates(t, q, v)[3])}


class TellingCart(Cart):
    def signals(self, t: float, q: Any, v: Any, u: Any, f: Any, memory: Any) -> Any:
        return {"pushed": ("N", f), "power": ("W", [u[0] * v[3], u[1] * v[4]]), "wheels": ("", 2)}


class TellingSmoothed(Smoothed):
    def signals(self, state: Any) -> Any:
        return {"smooth": ("N", state[1]), **self.controller.signals(state[0])}


WRAPPED = pm.MeasurementNoise(pm.MeasurementDelay(pm.InputSaturation(TellingPID(), 40.0), 2), 1e-3, 1e-3, 5)


@pytest.mark.parametrize(
    ("plant", "controller", "where", "forces", "units"),
    [
        (ROBOT, WRAPPED, BODY, [TellingSpring()], {"integral": "N", "applied": "N", "pull": "N", "sine": ""}),
        (ROBOT, TellingSmoothed(WRAPPED), BODY, [], {"smooth": "N", "integral": "N", "applied": "N"}),
        (
            TellingCart(),
            Follower(),
            CART,
            [Spring(), TellingAxle()],
            {"pushed": "N", "power": "W", "wheels": "", "axle torque": "N m"},
        ),
    ],
)
def test_engines_agree(plant: Any, controller: Any, where: Any, forces: Any, units: dict[str, str]) -> None:
    trajectory, options = where
    runs = [
        pm.simulate(plant, controller, trajectory, forces=forces, engine=engine, **options)
        for engine in (pm.Engine.PYTHON, pm.Engine.COMPILED)
    ]
    for run in runs:
        assert {name: signal.unit for name, signal in run.signals.items()} == units
    for name in units:
        one, other = (run.signals[name].values for run in runs)
        assert one.shape == other.shape
        assert not other.flags.writeable
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(one).max())


def test_they_are_what_the_laws_say() -> None:
    run = pm.simulate(
        TellingCart(), FOLLOWER, CART[0], forces=[TellingAxle()], engine=pm.Engine.COMPILED, **CART[1]
    )
    np.testing.assert_allclose(run.signals["power"].values, run.u * run.v[:, 3:], rtol=1e-14)
    np.testing.assert_allclose(run.signals["axle torque"].values, -0.02 * run.v[:, 3], rtol=1e-14)
    np.testing.assert_array_equal(run.signals["pushed"].values[:, 3], run.signals["axle torque"].values)
    told = pm.simulate(
        ROBOT, pm.InputSaturation(TellingPID(), 15.0), BODY[0], engine=pm.Engine.COMPILED, **BODY[1]
    )
    assert np.abs(told.u).max() == 15.0
    assert np.abs(told.signals["applied"].values).max() > 15.0  # what it asked for


class Claiming(TellingSpring):
    def signals(self, t: float, pose: Any, rate: Any) -> Any:
        return {"applied": ("N", 1.0)}


class Branching(TellingPID):
    def signals(self, state: Any) -> Any:
        return {"integral": ("N", 1.0 if state["sum"][0] > 0 else 0.0)}


@pytest.mark.parametrize("engine", [pm.Engine.PYTHON, pm.Engine.COMPILED])
def test_a_name_that_two_parts_claim_is_refused(engine: Any) -> None:
    controller = pm.InputSaturation(TellingPID(), 9.0)
    with pytest.raises(pm.InvalidArgument, match=r"controller and forces\[0\] both have the signal '"):
        pm.simulate(ROBOT, controller, BODY[0], forces=[Claiming()], engine=engine, **BODY[1])


def test_signals_that_cannot_be_compiled_are_told_with_their_line() -> None:
    with pytest.raises(pm.InvalidArgument, match=r"^engine is Engine.COMPILED, .*Branching.signals, line"):
        pm.simulate(ROBOT, Branching(), BODY[0], engine=pm.Engine.COMPILED, **BODY[1])
    # An ensemble keeps no signals, and asks for none.
    assert pm.ensemble(ROBOT, Branching(), BODY[0], n=2, spread={}, **BODY[1]).engine == "COMPILED"


def test_files_and_figures_have_their_names_and_units(tmp_path: Path) -> None:
    run = pm.simulate(ROBOT, WRAPPED, BODY[0], forces=[TellingSpring()], engine=pm.Engine.COMPILED, **BODY[1])
    run.save(tmp_path / "run.npz")
    kept = pm.Rollout.load(tmp_path / "run.npz")
    for name, (unit, values) in run.signals.items():
        assert kept.signals[name].unit == unit
        np.testing.assert_array_equal(kept.signals[name].values, values)
    run.to_csv(tmp_path / "run.csv")
    with (tmp_path / "run.csv").open(newline="") as file:
        header, *rows = list(csv.reader(file))
    assert header[:5] == ["t [s]", "x [m]", "y [m]", "psi [rad]", "v_x [m/s]"]
    np.testing.assert_array_equal(np.array(rows, float)[:, 3], run.q[:, 2])
    assert header[-7:] == [
        *(f"signal_integral[{k}] [N]" for k in range(3)),
        "signal_applied [N]",
        *(f"signal_pull[{k}] [N]" for k in range(2)),
        "signal_sine",
    ]
    np.testing.assert_array_equal(np.array(rows, float)[:, -3:-1], run.signals["pull"].values)
    labels = [axes.get_ylabel() for axes in plots.signals(kept).axes]
    assert labels == ["integral [N]", "applied [N]", "pull [N]", "sine"]
