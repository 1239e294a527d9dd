"""Robots that run one after another, in worker processes where that is worth it: same bits, same errors."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import (
    PD,
    Circle,
    Ensemble,
    FixedHeading,
    InvalidArgument,
    MobileRobot,
    Scenario,
    Uniform,
    law,
    sweep,
)
from pinmobile.ensembles import PINOCCHIO, run_scenario, running
from pinmobile.ensembles.variables import PER_ROBOT
from pinmobile.errors import SchedulerError, SlowerEngine

ROBOT = MobileRobot(30.0, 1.3, com=(0.1, 0.05))
N = 7


@dataclass(frozen=True)
class Branching:
    """A controller that cannot be compiled, nor run on arrays: it decides by the state."""

    gain: float = 100.0
    forbidden: float = -1.0
    of_process: int = 0  # what it runs in without harm; 0: anywhere
    parameters = ("gain",)

    def initial_state(self, context: Any) -> Any:
        return context.normal("hand", 3)

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        if self.of_process not in (0, os.getpid()):
            os._exit(3)
        if t > 0 and self.gain == self.forbidden:
            raise ZeroDivisionError("the gain is what it must not be")
        numbers, state = state.draw()
        if v[0] > 0.9:
            return 50.0 * (reference.v - v) + 0.1 * numbers, state
        return self.gain * (reference.q - q) + 60.0 * (reference.v - v) + 0.1 * numbers, state


def scenario(controller: Any, **changes: Any) -> Scenario:
    given: dict[str, Any] = {"robot": ROBOT, "controller": controller, "n": N, "dt": 0.02}
    spread = {
        "gain": np.linspace(60.0, 66.0, N),
        "start_x": Uniform(-0.1, 0.1),
        "circle_radius": Uniform(1, 2),
    }
    motion = FixedHeading(Circle(1.5, 0.5, 1.0), 0.0)
    return Scenario(**(given | {"trajectory": motion, "spread": spread, "seed": 3} | changes))


@pytest.fixture
def always(monkeypatch: pytest.MonkeyPatch) -> list[running.Workers]:
    """Make processes worth starting whatever there is to do, and return those that were made."""
    made: list[running.Workers] = []

    class Seen(running.Workers):
        def __init__(self, count: int) -> None:
            super().__init__(count)
            made.append(self)

    monkeypatch.setattr(running, "_START", 0.0)
    monkeypatch.setattr(running, "Workers", Seen)
    return made


def assert_ended(made: list[running.Workers], started: int) -> None:
    found = [worker.process.poll() for each in made for worker in each._all]
    assert len(found) == started
    assert None not in found


def assert_same(one: Ensemble, other: Ensemble) -> None:
    for name in (*PER_ROBOT, "counts"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_the_bits_are_those_of_one_process_and_the_result_says_how(
    always: list[running.Workers], tmp_path: Path
) -> None:
    with pytest.warns(SlowerEngine):
        alone = run_scenario(scenario(Branching()), threads=1)
    assert alone.engine == "PINOCCHIO"
    assert not alone.why.endswith("processes")
    assert_ended(always, 0)
    told: list[tuple[int, int]] = []
    with pytest.warns(SlowerEngine):
        run = run_scenario(scenario(Branching()), threads=2, progress=lambda *done: told.append(done))
    assert_same(run, alone)
    assert run.why == f"{alone.why}; in 2 processes"
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert told[-1] == (N, N)
    assert_ended(always, 2)
    run.save(tmp_path / "runs.npz")
    assert Ensemble.load(tmp_path / "runs.npz").why == run.why
    with pytest.warns(SlowerEngine):
        swept = sweep(scenario(Branching()), tmp_path / "store", chunk=5)
    assert_same(swept.ensemble(), alone)


def test_little_work_starts_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running.Workers, "part", None)
    run = run_scenario(scenario(Branching(), n=2, spread={}), threads=2, engine=PINOCCHIO)
    assert run.why == ""


class OfMain(Branching):
    __module__ = "__main__"


@pytest.mark.parametrize(
    ("controller", "why"),
    [
        (OfMain(), "OfMain is of __main__, which they cannot import"),
        (law(lambda t, q, v, reference: 60.0 * (reference.q - q)), r"<lambda>"),
    ],
    ids=["class of __main__", "lambda"],
)
def test_what_cannot_be_pickled_runs_in_one_process_and_says_so(
    always: list[running.Workers], controller: Any, why: str
) -> None:
    spread = {"circle_radius": Uniform(1, 2)}
    run = run_scenario(scenario(controller, n=3, spread=spread), threads=2, engine=PINOCCHIO)
    assert run.why.startswith("in one process, as a part cannot be sent to other processes: ")
    assert why in run.why
    assert_same(run, run_scenario(scenario(controller, n=3, spread=spread), threads=1, engine=PINOCCHIO))
    assert_ended(always, 0)


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_comes_back_as_itself_with_the_robots_number(
    always: list[running.Workers], threads: int
) -> None:
    bad = scenario(Branching(forbidden=64.0))
    with pytest.raises(ZeroDivisionError, match="the gain is what it must not be") as caught:
        run_scenario(bad, threads=threads, engine=PINOCCHIO)
    assert caught.value.__notes__[0] == "robot 4 of the ensemble"
    assert_ended(always, 0 if threads == 1 else 2)


def test_a_worker_that_dies_and_an_interruption_leave_no_process(always: list[running.Workers]) -> None:
    lost = scenario(Branching(of_process=os.getpid()))
    with pytest.raises(SchedulerError, match=r"a worker process ended with code 3 while it ran robots \d"):
        run_scenario(lost, threads=2, engine=PINOCCHIO)
    assert_ended(always, 2)

    def interrupt(done: int, total: int) -> None:
        if done > 1:
            raise KeyboardInterrupt

    always.clear()
    with pytest.raises(KeyboardInterrupt):
        run_scenario(scenario(Branching()), threads=2, engine=PINOCCHIO, progress=interrupt)
    assert_ended(always, 2)


def test_an_argument_error_tells_the_robot() -> None:
    def fussy(t: float, q: Any, v: Any, reference: Any) -> Any:
        return None if q[0] > 5 else 60.0 * (reference.q - q)

    with pytest.raises(InvalidArgument, match=r"^robot 1: function of the law returned"):
        run_scenario(
            scenario(law(fussy), n=2, spread={"start_x": np.array([0.0, 9.0])}), threads=1, engine=PINOCCHIO
        )
    assert run_scenario(scenario(PD(60, 60), n=2, spread={"start_x": 0.1}), engine=PINOCCHIO).why == ""
