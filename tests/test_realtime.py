"""Control in real time: the bits of `simulate`, memory, records, deadlines, and how a run ends."""

import gc
import os
import re
import signal
import threading
import time
import tracemalloc
from itertools import chain
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import InvalidArgument, Reference
from pinmobile.errors import NotFinite, UnknownName
from pinmobile.realtime import RealtimeReport, Stepper, _realtime, run_realtime
from tests.frozen import BODY, CIRCLE, WRONG, branching, by_lapack, loops
from tests.refusals import refused

# Loops with the controllers of others.
AGAIN = (
    *("via", "line", "spline", "semi-implicit", "constant", "sine", "viscous", "resistance", "payload"),
    *("PD, matrix", "skid-steer", "differential Coulomb", "ur5, base alone"),
)
LOOPS = {name: (parts, options) for name, parts, options in chain(loops(), by_lapack()) if name not in AGAIN}
PD = pm.PD((120, 110, 5), (120, 110, 5))
STILL = Reference(*np.zeros((3, 3)))


def answers(stepper: Stepper, run: Any, begin: int = 0, end: int | None = None) -> Any:
    """Return the inputs that a stepper computes for the states of a run."""
    rows = slice(begin, end)
    states = zip(run.t[rows].tolist(), run.q[rows], run.v[rows], strict=True)
    return np.array([stepper.step(*state) for state in states])


@pytest.mark.filterwarnings("ignore::pinmobile.errors.LimitWarning")
@pytest.mark.parametrize("name", LOOPS)
def test_the_inputs_have_the_bits_of_simulate(name: str) -> None:
    (plant, controller, trajectory), options = LOOPS[name]
    if name in ("noisy", "all"):
        with pytest.raises(InvalidArgument, match="controller draws measurement noise, which a robot has"):
            Stepper(controller, plant, dt=0.02, trajectory=trajectory)
        return
    run = pm.simulate(plant, controller, trajectory, dt=0.02, engine=pm.Engine.COMPILED, **options)
    stepper = Stepper(controller, plant, dt=0.02, trajectory=trajectory)
    assert stepper.fallback_reason == ""
    assert np.array_equal(answers(stepper, run), run.u)
    found = stepper.rollout()
    for part in ("t", "q", "v", "u", "error"):
        assert np.array_equal(getattr(found, part), getattr(run, part)), part
    assert all(np.array_equal(x, y) for x, y in zip(found.reference, run.reference, strict=True))
    for key, (unit, values) in found.signals.items():
        assert unit == run.signals[key].unit
        assert np.array_equal(values, run.signals[key].values), key
    assert str(found)  # limits and events work


@pytest.mark.parametrize(
    "controller",
    [pm.law(branching), pm.MPC(BODY, horizon=4, step=0.02), pm.MeasurementDelay(PD, 2)],
    ids=["branching", "MPC", "delay"],
)
def test_what_cannot_be_compiled_runs_as_in_python(controller: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    run = pm.simulate(BODY, controller, CIRCLE, dt=0.02, engine=pm.Engine.PYTHON)
    if type(controller).__name__ == "MeasurementDelay":  # which can be compiled
        error = pm.errors.NotTraceable("a reason", "some advice")
        monkeypatch.setattr("pinmobile.realtime._stepper.Law", lambda *_: (_ for _ in ()).throw(error))
    stepper = Stepper(controller, BODY, dt=0.02, trajectory=CIRCLE)
    assert stepper.engine == "PYTHON"
    assert stepper.fallback_reason.startswith("not COMPILED: ")
    assert np.array_equal(answers(stepper, run, 0, 20), run.u[:20])
    memory = stepper.memory
    after = answers(stepper, run, 20)
    stepper.memory = memory
    assert np.array_equal(answers(stepper, run, 20), after)
    assert np.array_equal(after, run.u[20:])
    found = stepper.rollout()
    assert found.fallback_reason == stepper.fallback_reason
    assert found.signals.keys() == run.signals.keys()


@pytest.mark.parametrize("name", ["PID", "delayed", "leaky"])
def test_a_memory_that_is_saved_and_set_continues_bit_for_bit(name: str) -> None:
    (plant, controller, trajectory), _ = LOOPS[name]
    run = pm.simulate(plant, controller, trajectory, dt=0.02, engine=pm.Engine.COMPILED)
    steppers = [Stepper(controller, plant, dt=0.02, trajectory=trajectory) for _ in range(2)]
    begin = steppers[0].memory
    answers(steppers[0], run, 0, 40)
    saved = steppers[0].memory
    answers(steppers[0], run, 40, 60)  # the saved memory is a copy
    for stepper in steppers:
        stepper.memory = saved
        assert stepper.k == 40
        assert np.array_equal(answers(stepper, run, 40), run.u[40:])
    steppers[0].memory = begin
    assert np.array_equal(answers(steppers[0], run), run.u)
    assert len(steppers[0]) == len(run)  # the record began anew


def test_the_reference_is_the_nearest_sample_and_rests_after_the_end() -> None:
    stepper = Stepper(PD, BODY, dt=0.02, trajectory=CIRCLE)
    t = np.arange(301) * 0.02
    desired = CIRCLE(t)
    for time_, k in ((0.0, 0), (0.009, 0), (0.011, 1), (2.0, 100), (6.0, 300), (6.009, 300)):
        stepper.step(time_, np.zeros(3), np.zeros(3))
        for found, expected in zip(stepper.rollout().reference, desired, strict=True):
            assert np.array_equal(found[-1], expected[k]), time_
    stepper.step(6.02, np.zeros(3), np.zeros(3))
    rest = stepper.rollout().reference
    assert np.array_equal(rest.q[-1], desired.q[300])
    assert not rest.v[-1].any()
    assert not rest.a[-1].any()


def test_without_a_trajectory_each_call_has_a_reference() -> None:
    stepper = Stepper(PD, BODY, dt=0.02)
    given = Reference(np.array([1.0, 0, 0]), np.zeros(3), np.zeros(3))
    np.testing.assert_array_equal(stepper.step(0.0, [0, 0, 0], [0, 0, 0], given), [120, 0, 0])
    with pytest.raises(InvalidArgument, match="reference is None, expected a Reference"):
        stepper.step(0.1, [0, 0, 0], [0, 0, 0])
    with pytest.raises(InvalidArgument, match="trajectory is None, but the controller reads"):
        Stepper(pm.MPC(BODY), BODY, dt=0.02)
    with pytest.raises(InvalidArgument, match=r"stepper\.trajectory is None"):
        run_realtime(stepper, lambda: None, print, stop=print)


def test_limits_of_the_inputs_are_applied() -> None:
    base = pm.WheelTable.differential(0.5, 0.1, motor=pm.Motor(torque_limit=2.0), spin_inertia=0.01)
    robot = pm.WheeledRobot(BODY, base)
    stepper = Stepper(pm.law(lambda t, q, v, reference: np.array([5.0, -5.0])), robot, dt=0.02)
    assert stepper.step(0.0, robot.rest, 0 * robot.rest, STILL).tolist() == [2.0, -2.0]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((0.5, [0, 0, 0], [0, 0, 0]), r"^t is 0.5 s, expected a time >= 0, after the last sample at 0.5 s"),
        ((np.nan, [0, 0, 0], [0, 0, 0]), r"^t "),
        ((1.0, [0, np.nan, 0], [0, 0, 0]), r"^q.* is nan"),
        ((1.0, [0, 0, 0], [0, np.inf, 0]), r"^v.1. is inf, expected a finite number"),
        ((1.0, [0, 0], [0, 0, 0]), r"^q has shape \(2,\), expected \(3,\)"),
        (
            (1.0, [0, 0, 0], [0, 0, 0], Reference(np.full(3, np.nan), *np.zeros((2, 3)))),
            r"^reference.q.0. is nan",
        ),
    ],
)
def test_an_invalid_measurement_changes_nothing(given: Any, message: str) -> None:
    stepper = Stepper(pm.controllers.PID(WRONG), BODY, dt=0.02, trajectory=CIRCLE)
    stepper.step(0.5, [0.1, 0, 0], [0, 0, 0])
    k, memory = stepper.memory
    with pytest.raises(InvalidArgument, match=message):
        stepper.step(*given)
    assert stepper.memory[0] == k
    assert np.array_equal(stepper.memory[1], memory)
    assert len(stepper) == 1


def test_an_input_that_is_not_finite_is_not_returned() -> None:
    stepper = Stepper(pm.law(lambda t, q, v, reference: np.sqrt(1.0 - q)), BODY, dt=0.02)
    with pytest.raises(NotFinite, match=r"^controller returned u = \[nan nan nan\] at t = 0 s"):
        stepper.step(0.0, [2, 2, 2], [0, 0, 0], STILL)
    assert len(stepper) == 0


def test_the_record_keeps_the_last_samples() -> None:
    stepper = Stepper(PD, BODY, dt=0.02, trajectory=CIRCLE, capacity=50)
    assert stepper
    assert len(stepper) == 0
    with pytest.raises(InvalidArgument, match="the stepper has no sample yet"):
        stepper.rollout()
    run = pm.simulate(BODY, PD, CIRCLE, dt=0.02, engine=pm.Engine.COMPILED)
    answers(stepper, run)
    found = stepper.rollout()
    assert np.array_equal(found.t, run.t[-50:])
    assert np.array_equal(found.u, run.u[-50:])
    assert str(found).startswith("50 samples over 0.98 s at dt = 0.02 s")
    np.testing.assert_allclose(found.a[:-1], run.a[-50:-1], atol=1e-9)
    assert np.array_equal(found.a[-1], found.a[-2])


def test_calls_leave_no_objects_and_no_memory() -> None:
    stepper = Stepper(LOOPS["observer"][0][1], BODY, dt=0.02, trajectory=CIRCLE, capacity=100)
    q, v = np.zeros(3), np.zeros(3)

    def call(begin: int, count: int) -> None:
        for k in range(begin, begin + count):
            stepper.step(0.001 * k, q, v)

    call(0, 200)
    gc.collect()
    before = len(gc.get_objects())
    tracemalloc.start()
    try:
        call(200, 1000)
        first = tracemalloc.get_traced_memory()[0]
        call(1200, 10_000)
        second = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert len(gc.get_objects()) <= before + 10  # those of this test
    assert second - first < 2000  # bytes


# Runs in real time, on a clock of the test


class Robot:
    """Robot at a point, with a clock that only sleeping, reading and writing advance."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, silent: tuple[float, float] = (9.0, 9.0)) -> None:
        self.now, self.silent, self.takes = 100.0, silent, 0.0
        self.stops: list[float] = []
        self.written: list[Any] = []
        self.given = [0.0, 0.0, 0.0], [0.5, 0.0, 0.5]
        monkeypatch.setattr(_realtime, "time", self)
        monkeypatch.setattr(_realtime, "_sleep_until", self.sleep)

    def monotonic(self) -> float:
        return self.now

    def sleep(self, due: float) -> None:
        self.now = max(self.now, due)

    def read(self) -> Any:
        begin, end = self.silent
        return None if begin <= self.now - 100.0 < end else (self.now, *self.given)

    def write(self, u: Any) -> None:
        self.written.append(u)
        self.now += self.takes

    def stop(self) -> None:
        self.stops.append(self.now - 100.0)

    def run(self, stepper: Stepper, **options: Any) -> RealtimeReport:
        return run_realtime(
            stepper, self.read, self.write, **{"stop": self.stop, "priority": None, **options}
        )


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    return Robot(monkeypatch)


def stepper_of(dt: float = 0.001, controller: Any = PD) -> Stepper:
    return Stepper(controller, BODY, dt=dt, trajectory=pm.Tangent(pm.Circle(2.0, 0.25, 2.0)))


def test_a_run_has_a_sample_in_each_period_and_stops_at_its_end(robot: Robot) -> None:
    stepper = stepper_of()
    report = robot.run(stepper, rate=1000)
    assert report.reason == "duration"
    assert (report.deadlines, report.overruns, report.missed_share) == (2000, 0, 0.0)
    assert len(robot.written) == 2000
    assert robot.stops == [pytest.approx(1.999)]
    assert report.rollout is not None
    assert np.array_equal(report.rollout.t, np.arange(2000) * 0.001)
    assert np.array_equal(report.rollout.u, robot.written)
    assert report.quantiles()["largest"] < 1e-9
    with pytest.raises(UnknownName, match=r"unknown time 'latency', .*lateness, .*measurement age"):
        report.quantiles("latency")
    assert repr(report).startswith("<RealtimeReport: 2000 periods at 1000 Hz, 0 deadlines missed (0 %)")
    assert "response time: median " in str(report)
    report = robot.run(stepper, duration=0.1)  # again, with the record of this run only
    assert report.rollout is not None
    assert len(report.rollout) == 100


def test_an_interruption_of_200_ms_stops_the_robot_within_the_stated_deadline(robot: Robot) -> None:
    robot.silent = 0.5, 0.7
    report = robot.run(stepper_of(), stale=0.05)
    assert report.reason == "stale measurement"
    assert re.fullmatch(r"the last measurement is 0.05\d* s old, expected at most 0.05 s", report.details)
    (stopped,) = robot.stops
    last = 0.499  # time of the last measurement
    assert last + 0.05 < stopped <= last + 0.05 + 0.001 + 1e-9
    assert len(robot.written) == pytest.approx(550, abs=1)


def test_time_begins_with_the_first_measurement(robot: Robot) -> None:
    robot.silent = 0.0, 0.04
    report = robot.run(stepper_of(), stale=0.05, duration=0.1)
    assert report.reason == "duration"
    assert report.rollout is not None
    assert len(report.rollout) == 100
    robot.silent = robot.now - 99.5, robot.now - 99.47  # a short gap repeats the measurement
    report = robot.run(stepper_of(), stale=0.05)
    assert report.reason == "duration"
    assert report.quantiles("measurement age")["largest"] == pytest.approx(0.03, abs=2e-3)
    robot.silent = 0.0, 99.0
    report = robot.run(stepper_of(), stale=0.05)
    assert (report.reason, report.details) == ("stale measurement", "no measurement arrived within 0.05 s")
    assert len(robot.stops) == 3


def test_a_measurement_with_the_time_of_another_clock_is_named(robot: Robot) -> None:
    robot.read = lambda: (robot.now - 80000.0, *robot.given)  # type: ignore[method-assign]
    report = robot.run(stepper_of())
    expected = "the last measurement is 80000 s old, expected at most 0.1 s: use times of time.monotonic()"
    assert report.details == expected


def test_overruns_are_counted_and_their_periods_left_out(robot: Robot) -> None:
    robot.takes = 0.0025
    report = robot.run(stepper_of(), duration=1.0)
    assert report.reason == "duration"
    assert len(robot.written) == pytest.approx(400, abs=2)
    assert report.overruns == report.deadlines == 1000  # no period after the end counts
    assert "1000 deadlines missed (100 %)" in str(report)
    assert report.rollout is not None
    assert (np.diff(report.rollout.t) > 0.0015).all()


def test_a_large_error_stops_the_robot_before_its_input_is_written(robot: Robot) -> None:
    robot.given = [0.0, 0.3, 0.0], [0.5, 0.0, 0.5]
    report = robot.run(stepper_of(), limit=0.2)
    assert report.reason == "limit"
    assert report.details == "error of y is -0.3 m, expected at most 0.2"
    assert str(report).splitlines()[0].endswith(f"end: limit, {report.details}")
    assert robot.written == []
    assert len(robot.stops) == 1
    assert report.rollout is None


def test_an_error_of_the_user_is_raised_after_the_stop(robot: Robot) -> None:
    stepper = stepper_of()

    def fail(u: Any) -> None:
        robot.written.append(u)
        if len(robot.written) == 5:
            raise OSError("network is unreachable")

    collects = gc.isenabled()
    with pytest.raises(OSError, match="network is unreachable") as caught:
        run_realtime(stepper, robot.read, fail, stop=robot.stop, priority=None)
    assert len(robot.stops) == 1
    assert len(stepper.rollout()) == 5
    assert "stepper.rollout()" in caught.value.__notes__[0]
    assert gc.isenabled() == collects


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ((0.0, [0, np.nan, 0], [0, 0, 0]), "^q.1. is nan"),
        ((5.0, [0, 0, 0], [0, 0, 0]), "ahead of the clock, expected times of time.monotonic"),
        ([0, 0, 0], r"^read returned \[0, 0, 0\], expected \(t, q, v\) or None"),
    ],
)
def test_an_invalid_measurement_stops_the_robot(robot: Robot, found: Any, message: str) -> None:
    given = (robot.now + found[0], *found[1:]) if isinstance(found, tuple) else found
    robot.read = lambda: given  # type: ignore[method-assign]
    with pytest.raises(InvalidArgument, match=message):
        robot.run(stepper_of())
    assert len(robot.stops) == 1


def test_an_invalid_argument_is_refused_before_the_run(robot: Robot) -> None:
    with refused("^rate is 500 Hz, expected 1 / dt of the stepper, 1000 Hz"):
        robot.run(stepper_of(), rate=500)
    with refused("^stop is 3"):
        robot.run(stepper_of(), stop=3)
    assert robot.stops == []
    with pytest.raises(InvalidArgument, match=r"^stepper is 3, expected a Stepper$"):
        robot.run(3)  # type: ignore[arg-type]


# Runs on the clock of the machine


def measured() -> Any:
    """Return a measurement of now."""
    return time.monotonic(), [0, 0, 0], [0.5, 0, 0.5]


def test_ctrl_c_ends_a_run_and_calls_stop() -> None:
    stops: list[str] = []
    stepper = stepper_of(0.01)
    before = signal.getsignal(signal.SIGINT)

    def write(u: Any) -> None:
        if len(stepper) == 3:
            os.kill(os.getpid(), signal.SIGINT)

    options: Any = {"stop": lambda: stops.append("stop"), "stale": 60.0, "duration": np.inf}
    found = run_realtime(stepper, measured, write, **options)
    assert found.reason == "interrupt"
    assert stops == ["stop"]
    assert found.rollout is not None
    assert len(found.rollout) == 3
    assert signal.getsignal(signal.SIGINT) is before


def test_the_scheduler_is_restored_and_refusals_are_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    during: list[int] = []

    def read() -> Any:
        during.append(os.sched_getscheduler(0))
        return measured()

    options: Any = {"stop": lambda: None, "stale": 60.0, "duration": 0.02}
    report = run_realtime(stepper_of(0.01), read, lambda u: None, **options)
    allowed = report.scheduling[0] == "scheduling: SCHED_FIFO, priority 50"
    assert (during[0] == os.SCHED_FIFO) == allowed
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before

    def forbid(pid: int, policy: int, parameters: Any) -> None:
        if policy != before[0]:
            raise PermissionError(1, "Operation not permitted")

    with monkeypatch.context() as patched:
        patched.setattr(os, "sched_setscheduler", forbid)
        report = run_realtime(stepper_of(0.01), read, lambda u: None, **options)
    assert report.scheduling[0].startswith(
        "scheduling: as before, SCHED_FIFO failed (Operation not permitted)"
    )
    report = run_realtime(stepper_of(0.01), read, lambda u: None, priority=None, **options)
    assert report.scheduling == ("scheduling: as before",)


def test_a_run_in_another_thread_works() -> None:
    found: list[RealtimeReport] = []

    def run() -> None:
        options: Any = {"stop": lambda: None, "stale": 60.0, "duration": 0.05}
        found.append(run_realtime(stepper_of(0.01), measured, lambda u: None, **options))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found[0].reason == "duration"
