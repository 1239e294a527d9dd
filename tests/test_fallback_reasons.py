"""What results and warnings say of the engine that ran a loop, and of why it was no faster one."""

import statistics
import subprocess
import sys
import warnings
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.cli import main
from pinmobile.errors import SlowerEngine

CIRCLE = pm.Tangent(pm.Circle(2, 0.25, 2))
NOT_ASKED = "not COMPILED: give engine=Engine.COMPILED to compile the loop"


def branching(t: float, q: Any, v: Any, reference: Any) -> Any:
    error = reference.q - q
    if error[0] > 0.0:
        error[0] *= 2.0
    return 100.0 * error + 120.0 * (reference.v - v)


def scenario(controller: Any, width: float) -> pm.Scenario:
    spread = {"start.x": pm.Uniform(-width, width)}
    return pm.Scenario(
        robot=pm.MobileRobot.box(), controller=controller, trajectory=CIRCLE, n=12, spread=spread, dt=0.2
    )


def test_a_sweep_tells_once_which_part_makes_it_slower_and_where(tmp_path: Path) -> None:
    widths = {width: pm.Uniform(-width, width) for width in (0.01, 0.02)}
    laws = {"branching": pm.law(branching), "PD": pm.PD(100, 120)}
    plan: Any = scenario(laws["PD"], 0.01), tmp_path / "store"
    grid = {"controller": laws, "spread.start.x": widths}
    with pytest.warns(SlowerEngine, match="^this sweep runs by PYTHON") as told:
        pm.sweep(*plan, grid=grid, chunk=4)
    assert len(told) == 1
    text = str(told[0].message)
    assert told[0].filename == __file__
    for words in ("not COMPILED: branching, line", "np.where", "(at controller = branching, s"):
        assert text.count(words) == 1
    assert text.endswith("spread.start.x = 0.01 and 1 more)")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pm.sweep(*plan, grid=grid, chunk=4)  # nothing is left to run


def test_the_line_is_that_of_the_law_and_not_one_of_python() -> None:
    def leaning(t: float, q: Any, v: Any, reference: Any) -> Any:
        return statistics.median(q) * (reference.q - q)

    words = r"leaning, line \d+ of test_fallback_reasons\.py \(`return statistics"
    with pytest.raises(pm.InvalidArgument, match=words):
        pm.simulate(pm.MobileRobot.box(), pm.law(leaning), CIRCLE, dt=0.1, engine=pm.Engine.COMPILED)


def test_the_command_prints_it_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "own.py").write_text(
        "class Sign:\n"
        "    def initial_state(self, context):\n"
        "        return None\n"
        "    def __call__(self, t, q, v, reference, state):\n"
        "        pull = 9.0 if q[0] > reference.q[0] else 10.0\n"
        "        return pull * (reference.q - q) - v, state\n"
    )
    (tmp_path / "plan.toml").write_text(
        'n = 6\ncontroller = "own:Sign"\ntrajectory.path.duration = 1\n'
        '[spread]\nstart.x = "Uniform(0, 0.1)"\n[grid]\nsubsteps = [1, 2]\n'
    )
    words = ["sweep", str(tmp_path / "plan.toml"), "--out", str(tmp_path / "out")]
    with warnings.catch_warnings():
        warnings.simplefilter("default")  # as outside of the tests, where warnings are no errors
        assert main([*words, "--allow-code"]) == 0
    printed = capsys.readouterr().err
    assert 'controller = "own:Sign"' in unescape((tmp_path / "out" / "index.html").read_text())
    assert printed.count("runs by PYTHON") == 1
    assert "own.py" in printed


def test_a_rollout_says_why_and_its_file_keeps_it(tmp_path: Path) -> None:
    robot = pm.MobileRobot.box()
    told: Any = {None: ("PYTHON", NOT_ASKED), pm.Engine.COMPILED: ("COMPILED", "")}
    for engine, words in (told | {pm.Engine.PYTHON: ("PYTHON", "")}).items():
        run = pm.simulate(robot, pm.PD(9, 9), CIRCLE, dt=0.2, engine=engine)
        assert (run.engine, run.fallback_reason) == words
        run.save(tmp_path / "run.npz")
        kept = pm.Rollout.load(tmp_path / "run.npz")
        assert (kept.engine, kept.fallback_reason) == (run.engine, run.fallback_reason)


_NOT_EXECUTABLE = """
import ctypes, sys, warnings
if ctypes.CDLL(None).prctl(65, 1, 0, 0, 0):  # PR_SET_MDWE, of Linux 6.3
    sys.exit(77)
import numpy as np
from pinmobile import *
robot = MobileRobot.box()
plan = dict(n=12, dt=0.1, spread={"mass": Uniform(20, 40)})
loop = robot, ComputedTorque(robot, 4, 4), Tangent(Circle(2, 0.25, 2))
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("default")
    for _ in range(2):
        run = ensemble(*loop, **plan)
print(run.engine, len(told), told[0].message, run.max_distance.max(), sep="|")
try:
    simulate(*loop, dt=0.1, engine=Engine.COMPILED)
except InvalidArgument as error:
    print(error)
print(len(robot.mass_matrix(np.zeros((3000, 3)))), verify(robot, states=2).missing, sep="|")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="prctl is of Linux")
@pytest.mark.long
def test_where_no_memory_may_be_written_and_executed_another_engine_runs_and_says_why() -> None:
    words = [sys.executable, "-c", _NOT_EXECUTABLE]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=100)
    if done.returncode == 77:
        pytest.skip("this kernel has no PR_SET_MDWE")
    assert done.returncode == 0, done.stderr
    first, refused, last = done.stdout.splitlines()
    engine, warned, message, distance = first.split("|")
    why = "this process may not execute memory that it wrote (mprotect: Permission denied); allow it for "
    assert (engine, warned) == ("PYTHON", "1")
    assert f"not COMPILED: {why}" in message
    assert refused.startswith(f"engine is Engine.COMPILED, which cannot run this: {why}")
    assert last.startswith(f"3000|compiled for ensembles: {why}")
    robot, spread = pm.MobileRobot.box(), {"mass": pm.Uniform(20, 40)}
    run = pm.ensemble(robot, pm.ComputedTorque(robot, 4, 4), CIRCLE, n=12, dt=0.1, spread=spread)
    assert run.engine == "COMPILED"
    assert float(distance) == pytest.approx(run.max_distance.max(), rel=1e-9)  # both are exact to rounding


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_an_engine_as_a_string_is_told_what_to_write(engine: Any) -> None:
    why = rf"^engine is '{engine!r}', expected Engine.PYTHON, Engine.COMPILED or None"
    given: Any = repr(engine)
    for run in (
        lambda: pm.simulate(pm.MobileRobot.box(), pm.PD(9, 9), CIRCLE, dt=0.2, engine=given),
        lambda: pm.ensemble(pm.MobileRobot.box(), pm.PD(9, 9), CIRCLE, n=2, spread={}, dt=0.2, engine=given),
    ):
        with pytest.raises(pm.InvalidArgument, match=why):
            run()


def _branching_torques(t: float, q: Any, v: Any, reference: Any) -> Any:
    return np.array([0.6, 0.7]) if q[0] < 1e9 else np.zeros(2)


@pytest.mark.parametrize(("ground", "substeps"), [(pm.Rolling(), 3), (pm.Coulomb(), 1)])
def test_plant_and_forces_are_compiled_where_a_controller_cannot_be(ground: Any, substeps: int) -> None:
    wheel: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
    table = pm.WheelTable.differential(0.5, 0.1, supports=[(-0.3, 0.0)], **wheel)
    robot = pm.WheeledRobot(pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05, 0.2)), table, ground)
    given: dict[str, Any] = {"forces": [pm.ViscousFriction((5.0, 9.0, 0.4))], "substeps": substeps}
    given |= {"dt": 0.02, "limit": 1e6}
    traced = pm.law(lambda t, q, v, reference: np.array([0.6, 0.7]) + 0.0 * v[:2])
    one = pm.simulate(robot, traced, CIRCLE, **given)
    other = pm.simulate(robot, pm.law(_branching_torques), CIRCLE, **given)
    assert other.fallback_reason.startswith(
        "plant and forces are compiled, the controller runs in Python; not COMPILED: _"
    )
    assert (one.engine, one.fallback_reason, other.engine) == ("COMPILED", "", "PYTHON")
    for name in ("q", "v", "u", "a"):
        here, there = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(there, here, rtol=0, atol=1e-9 * (1 + np.abs(here).max()), err_msg=name)
    assert list(one.signals) == list(other.signals)
    for name, signal in one.signals.items():
        np.testing.assert_allclose(other.signals[name].values, signal.values, rtol=0, atol=1e-8, err_msg=name)
