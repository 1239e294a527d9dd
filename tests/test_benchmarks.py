import json
import re
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pinmobile.derivatives._gradient import evaluate_losses
from tests.c_code import compilers

pytestmark = [pytest.mark.once, pytest.mark.long]

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
PEERS = ("mujoco", "roboticstoolbox", "jax", "casadi")
SHORT = 2.0  # s


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    monkeypatch.syspath_prepend(BENCHMARKS)
    ensembles = ("ensemble_contestants", "ensemble_costs", "ensemble_race", "ensembles", "fleet")
    arms = "arm_ensemble_contestants", "arm_ensembles", "arm_fleet"
    names = (
        *arms,
        "batches",
        "calls",
        "contestants",
        "identification",
        "imports",
        "loop",
        "loop_work",
        "measuring",
        "memory",
        "mpc",
        "rollout",
        "task",
        "viewing",
        *ensembles,
    )
    return SimpleNamespace(**{name: import_module(name) for name in names})


def stand_in(name: str, prepare: Any, **peer: Any) -> SimpleNamespace:
    peer = {"installed": True, "version": "1.0", "install": f"pip install {name}", **peer}
    return SimpleNamespace(name=name, peer=SimpleNamespace(**peer), prepare=prepare)


def right_but_for(bench: SimpleNamespace, runs: list[Any], **change: float) -> SimpleNamespace:
    """Make a contestant whose log is the expected one but for what is added to some quantities."""

    def prepare(task: Any) -> Any:
        log = bench.task.expected(task)
        changed = log._replace(**{name: getattr(log, name) + by for name, by in change.items()})

        def run() -> Any:
            runs.append(task)
            return changed

        return run

    return stand_in("a peer", prepare)


@pytest.mark.parametrize(
    ("control", "largest"),
    [("computed torque", [3.491279e-05, 3.491278e-05]), ("PD", [7.481303e-03, 7.481287e-03])],
)
def test_the_expected_trajectory_has_the_lectures_errors(
    bench: SimpleNamespace, control: str, largest: list[float]
) -> None:
    log = bench.task.expected(bench.task.Task(0.1, control=control))
    np.testing.assert_allclose(np.abs(log.error).max(axis=0)[:2], largest, rtol=2e-7)


@pytest.mark.parametrize("quantity", ["q", "v", "a", "tau", "error"])
def test_a_wrong_trajectory_is_reported_and_not_timed(bench: SimpleNamespace, quantity: str) -> None:
    runs: list[Any] = []
    wrong = right_but_for(bench, runs, **{quantity: 1e-6})
    rows, sound = bench.rollout.race([wrong, bench.contestants.RAW], bench.task.Task(0.1, SHORT), rounds=3)
    assert not sound
    assert rows["a peer"].word.startswith("WRONG, not timed: off by ")
    assert rows["a peer"].times == []
    assert len(runs) == 2  # the check's, with the centre of mass on the axis and off it
    assert len(rows[bench.contestants.RAW.name].times) == 3


def test_a_right_trajectory_is_timed(bench: SimpleNamespace) -> None:
    runs: list[Any] = []
    rows, sound = bench.rollout.race(
        [right_but_for(bench, runs, q=1e-12)], bench.task.Task(0.1, SHORT), rounds=3
    )
    assert sound
    assert len(rows["a peer"].times) == 3
    assert len(runs) == 2 + 3


def test_a_missing_peer_is_named_with_what_installs_it(bench: SimpleNamespace) -> None:
    absent = stand_in("absent", prepare=None, installed=False)
    rows, sound = bench.rollout.race([absent], bench.task.Task(0.1, SHORT), rounds=1)
    assert sound
    assert rows["absent"].word == "not installed: pip install absent"


def test_a_peer_that_fails_is_named_with_its_error(bench: SimpleNamespace) -> None:
    def prepare(task: Any) -> Any:
        raise RuntimeError("no such engine")

    rows, sound = bench.rollout.race([stand_in("broken", prepare)], bench.task.Task(0.1, SHORT), rounds=1)
    assert not sound
    assert rows["broken"].word == "FAILED: RuntimeError: no such engine"


@pytest.mark.parametrize("dt", [0.1, 0.01])
@pytest.mark.parametrize(
    "work", [{}, {"control": "PD"}, {"step": "rk4"}, {"control": "own law"}], ids=lambda work: str(work)
)
def test_simulate_and_the_raw_loop_do_the_same_work(
    bench: SimpleNamespace, work: dict[str, str], dt: float
) -> None:
    for one in bench.contestants.OURS:
        run, word = bench.rollout.check(one, bench.task.Task(dt, SHORT, **work))
        assert run is not None, f"{one.name}: {word}"


def test_batches_are_right_of_all_who_are_there(
    bench: SimpleNamespace, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bench.batches.main(["--quick"]) == 0
    printed = capsys.readouterr().out
    assert "WRONG" not in printed
    assert printed.count("pinmobile, batches: the first ") == 3
    assert re.search(r"pinmobile, one state after another +\S+( +[\d.]+ \(1\.0 x\)){3}", printed)


def test_intervals_are_counted_and_the_table_of_logs_is_printed(
    bench: SimpleNamespace, capsys: pytest.CaptureFixture[str]
) -> None:
    part = bench.identification
    (one,) = (one for one in part.EVERYONE if one.name.startswith("least squares"))
    off = np.array([0.0, 1.0, 2.0])[:, None] * np.ones(10)
    answers = iter(
        (part.TRUE + x, np.column_stack([part.TRUE + x - 1.5, part.TRUE + x + 1.5]), x[0] / 4) for x in off
    )
    score = part.judged(replace(one, answer=lambda log: next(answers)), part.CASES[0], [None] * 3)
    np.testing.assert_allclose(score.holds, 2 / 3)  # all but the one that is 2 off
    assert score.width == pytest.approx(1.5 / 1.96 / np.sqrt(5 / 3))
    assert score.delay == pytest.approx((np.sqrt(5 / 3) / 4, 0.5))
    assert part.main(["--quick", "--only", "least squares"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("1 logs of 60 s")
    assert re.search(r"pose noise, 100 Hz +least squares as most write it( +[\d.]+){3} +- ", printed)


@pytest.fixture
def asked(bench: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    """Return what runs `python benchmarks` with options, and who was asked for what."""
    all_of_them = SimpleNamespace(**run_path(str(BENCHMARKS / "__main__.py")))

    def run(*options: str) -> dict[str, list[str]]:
        asked: dict[str, list[str]] = {}
        with monkeypatch.context() as patched:
            for part in all_of_them.PARTS:
                patched.setattr(
                    part, "main", lambda given, name=part.__name__: asked.update({name: given}) or 0
                )
            assert all_of_them.main(options) == 0
        for name, given in asked.items():  # each knows what it was given, and only that
            with pytest.raises(SystemExit):
                import_module(name).main([*given, "--unknown"])
            assert capsys.readouterr().err.endswith("unrecognized arguments: --unknown\n"), name
        return asked

    return run


def test_predictive_control_is_timed_and_one_that_does_not_come_there_is_wrong(
    bench: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bench.mpc.main(["--quick", "--only", "limits", "crocoddyl"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"MPC, limits of the input +[\d.]+", printed)
    monkeypatch.setattr(bench.mpc, "STEPS", 10)
    monkeypatch.setattr(bench.mpc, "LATEST", 0.05)
    assert bench.mpc.main(["--rounds", "1", "--only", "limits"]) == 1
    assert "WRONG" in capsys.readouterr().out


def test_a_step_in_c_is_measured(bench: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    compilers()
    exported = import_module("exported")
    with pytest.MonkeyPatch.context() as patched:
        known = exported.laws()
        patched.setattr(exported, "laws", lambda: {"PD": known["PD"]})
        assert exported.main(["--quick"]) == 0
    assert re.search(r"PD +33 +[\d.]+ +[\d,]+ times +[\d,]+ +16 +", capsys.readouterr().out)


def test_a_gradient_of_a_peer_is_checked_before_it_is_timed(
    bench: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    derivatives = import_module("derivatives")
    known, there = derivatives.cases(), stand_in("a peer", None).peer
    away = stand_in("absent", None, installed=False).peer
    monkeypatch.setattr(derivatives, "cases", lambda: {"PD": known["PD"]})
    monkeypatch.setattr(derivatives, "PEERS", {"right": there, "wrong": there, "away": away})
    problem = known["PD"].problem()
    exact = evaluate_losses(problem, {}, "forward").slopes[0, 0]
    makers = {
        "right": lambda *given: lambda: lambda: exact,
        "wrong": lambda *given: lambda: lambda: 1.1 * exact,
    }
    monkeypatch.setattr(derivatives, "MAKERS", makers)
    assert derivatives.main(["--quick"]) == 1
    printed = capsys.readouterr().out
    assert re.search(r"PD: 2 gains +\d+ +([\d.]+ +){6}WRONG: 1e-01 +not installed", printed)


def test_every_benchmark_is_run_and_understands_what_it_is_given(asked: Any) -> None:
    every = ["rollout", "ensembles", "arm_ensembles", "loop", "calls", "batches"]
    every += ["memory", "wheels", "mpc", "identification", "derivatives"]
    every += ["viewing", "imports", "exported", "realtime"]
    assert list(asked()) == list(asked("--quick", "--rounds", "2")) == every


def test_a_name_that_nobody_has_is_refused_before_anything_is_run(
    asked: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    for options, message in (
        (["--only", "nobody"], "--only: nobody has 'nobody' in the name\n"),
        (["--only"], "argument --only: expected at least one argument\n"),
        (["--quickly"], "unrecognized arguments: --quickly\n"),
    ):
        with pytest.raises(SystemExit) as ended:
            asked(*options)
        assert ended.value.code == 2
        assert capsys.readouterr().err.endswith(message)


def test_without_the_peers_every_benchmark_starts_and_knows_who_is_missing() -> None:
    files = sorted(file.stem for file in BENCHMARKS.glob("*.py"))
    assert {"batches", "calls", "ensembles", "imports", "memory", "rollout", "viewing"} < set(files)
    code = (
        "import json, sys\nfrom importlib import import_module\n"
        f"sys.path.insert(0, {str(BENCHMARKS)!r})\n"
        f"for peer in {PEERS}: sys.modules[peer] = None\n"
        f"for name in {files}: import_module(name)\n"
        "from contestants import Peer\n"
        "lists = [vars(sys.modules[name]) for name in ('contestants', 'ensemble_contestants')]\n"
        "peers = {n: p for one in lists for n, p in one.items() if isinstance(p, Peer)}\n"
        "told = {name: [peer.installed, peer.version] for name, peer in peers.items()}\n"
        "print(json.dumps(told))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    peers = json.loads(done.stdout)
    for name in ("MUJOCO", "TOOLBOX", "JAX"):
        assert peers[name] == [False, ""], name
    for name, package in (("PINMOBILE", "pinmobile"), ("PYTHON", "pin"), ("NUMPY", "numpy")):
        assert peers[name] == [True, version(package)], name


def test_a_recording_is_measured(bench: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.viewing.main(["--record", "600"]) == 0
    record, save, size, _, _ = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert 0 < record + save < 5
    assert 0.5 < size < 1.5


def test_imports_and_first_uses_are_told_as_shares_of_pinocchios(
    bench: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    took = {"import pinmobile": 102.0, "import pinocchio": 100.0, "from pinmobile import MobileRobot": 120.0}
    monkeypatch.setattr(bench.imports, "milliseconds", lambda statement, compiled: took.get(statement, 500.0))
    assert bench.imports.main(["--quick"]) == 0
    rows = [line.rsplit(maxsplit=3) for line in capsys.readouterr().out.splitlines()]
    shares = {row[0].strip(): row[3] for row in rows if len(row) == 4}
    assert shares["import pinocchio"] == "1.00"
    assert shares["import pinmobile"] == "1.02"
    assert shares["from pinmobile import MobileRobot"] == "1.20"


def ensemble_of(bench: SimpleNamespace, prepare: Any, **differs: Any) -> Any:
    """Make an entrant that is there and that `prepare` sets up."""
    one = bench.ensemble_contestants.Entrant("a peer", bench.contestants.NUMPY, "none", **differs)
    object.__setattr__(one, "prepare", prepare)
    return one


def test_the_expected_figures_are_those_of_simulate(bench: SimpleNamespace) -> None:
    fleet = bench.fleet.Fleet(2)
    assert fleet.mass[0] != fleet.mass[1]
    assert bench.fleet.difference(bench.fleet.simulated(fleet), fleet) < 1e-12


@pytest.mark.parametrize("module", ["of_c", "of_numpy", "of_pinocchio", "of_pinmobile"])
def test_ensembles_are_right(bench: SimpleNamespace, module: str) -> None:
    people = [one for one in bench.ensemble_contestants.EVERYONE if one.module == module]
    there = [one for one in people if one.peer.installed]
    if not there:
        pytest.skip(people[0].peer.install)
    for one in there:
        fleet = one.fleet_of(70, SHORT)  # a block of 64 and a part of one
        apart = bench.fleet.difference(one.prepare(fleet)(), fleet)
        assert apart <= bench.task.TOLERANCE, one.name


@pytest.mark.parametrize(
    ("arm", "modules"),
    [("UR5", ["of_pinmobile", "of_pinocchio", "of_mujoco"]), ("panda", ["of_pinocchio", "of_mujoco"])],
)
def test_ensembles_of_arms_are_right(bench: SimpleNamespace, arm: str, modules: list[str]) -> None:
    for one in bench.arm_ensemble_contestants.ARMS[arm]:
        others = "rk4", "all metrics"  # which take as long again to compile
        if one.peer.installed and one.module in modules and not one.name.endswith(others):
            work = one.lasting(9, 0.01)  # a block of eight and a part of one
            assert one.apart(one.prepare(work)(), work) <= bench.task.TOLERANCE, one.name


@pytest.mark.parametrize("figure", ["max_error", "rms_error", "max_input", "max_distance", "histogram"])
def test_a_wrong_figure_is_reported_and_not_timed(bench: SimpleNamespace, figure: str) -> None:
    runs: list[Any] = []

    def prepare(fleet: Any) -> Any:
        right = bench.fleet.expected(fleet)
        spoiled = (
            np.roll(right.histogram, 2, axis=-1) if figure == "histogram" else getattr(right, figure) + 1e-6
        )

        def run() -> Any:
            runs.append(fleet)
            return right._replace(**{figure: spoiled})

        return run

    (line,), sound = bench.ensemble_race.race([ensemble_of(bench, prepare)], [1, 3], rounds=3, longest=9.0)
    assert not sound
    assert line.rows[1].word.startswith("WRONG, not timed: off by ")
    assert line.rate(1) is None
    assert len(runs) == 1  # the check's; it is out for the other size


def test_every_row_of_the_loop_is_timed(bench: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.loop_work, "SAMPLES", 61)
    monkeypatch.setattr(bench.loop_work, "QUICK_STEPS", bench.loop_work.SHORT)
    work = bench.loop_work.Work(quick=True, least=0.0)
    for row in (*bench.loop_work.LOOPS, *bench.loop_work.RUNS):
        found = bench.loop_work.measured(work, row)
        assert isinstance(found, float), f"{row}: {found}"
        assert found > 0
    work.of = SimpleNamespace()  # an older version
    assert bench.loop_work.measured(work, "simulate, compiled") == "it has no engine COMPILED"
    assert bench.loop_work.measured(work, "rk4").startswith("FAILED: AttributeError: ")


def test_the_loop_is_printed_beside_another_version(
    bench: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[str] = []

    def told(interpreter: list[str], folder: str, names: list[str], quick: bool) -> dict[str, Any]:
        older = interpreter[0] == "older"
        asked.append(interpreter[0])
        times = {name: (16e-9 if name == "rk4" else 4e-9) / (1 if older else 2) for name in names}
        return times | ({"simulate, compiled": "it has no engine COMPILED"} if older else {})

    with pytest.raises(SystemExit):
        bench.loop.main(["--before", "older"])
    assert "--before: older is no program" in capsys.readouterr().err
    monkeypatch.setattr(bench.loop, "told", told)
    monkeypatch.setattr(bench.loop.shutil, "which", str)
    assert bench.loop.main(["--rounds", "2", "--before", "older", "--only", "rk4", "compiled"]) == 0
    assert asked == ["older", sys.executable] * 2
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["computed", "torque", "4", "2", "1.00", "1.00", "2.00"] in rows
    assert ["rk4", "16", "8", "0.25", "0.25", "2.00"] in rows
    assert ["simulate,", "compiled", "2e-06"] in rows
    assert ["-", "simulate,", "compiled,", "before:", "it", "has", "no", "engine", "COMPILED"] in rows
    assert bench.loop.main(["--only", "rk4", "compiled"]) == 0
    assert "--before ../venv/bin/python" in " ".join(capsys.readouterr().out.split())
