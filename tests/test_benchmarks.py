import json
import re
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import Any

import pytest

pytestmark = [pytest.mark.once, pytest.mark.long]

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
PEERS = ("mujoco", "roboticstoolbox", "jax", "casadi")
SHORT = 2.0  # s


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    monkeypatch.syspath_prepend(BENCHMARKS)
    names = "batches", "contestants", "ensemble_contestants", "fleet", "rollout", "task"
    return SimpleNamespace(**{name: import_module(name) for name in (*names, "arm_ensemble_contestants")})


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


@pytest.mark.parametrize("quantity", ["a", "error"])
def test_a_wrong_trajectory_is_reported_and_not_timed(bench: SimpleNamespace, quantity: str) -> None:
    runs: list[Any] = []
    wrong = right_but_for(bench, runs, **{quantity: 1e-6})
    rows, sound = bench.rollout.race([wrong, bench.contestants.RAW], bench.task.Task(0.1, SHORT), rounds=3)
    assert not sound
    assert rows["a peer"].word.startswith("WRONG, not timed: off by ")
    assert rows["a peer"].times == []
    assert len(runs) == 2  # the check's, with the centre of mass on the axis and off it
    assert len(rows[bench.contestants.RAW.name].times) == 3


@pytest.mark.parametrize(
    "work", [{}, {"control": "PD"}, {"step": "rk4"}, {"control": "own law"}], ids=lambda work: str(work)
)
def test_simulate_and_the_raw_loop_do_the_same_work(bench: SimpleNamespace, work: dict[str, str]) -> None:
    for one in bench.contestants.OURS:
        run, word = bench.rollout.check(one, bench.task.Task(0.1, SHORT, **work))
        assert run is not None, f"{one.name}: {word}"


def test_batches_of_all_are_right(bench: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.batches.main(["--quick"]) == 0
    printed = capsys.readouterr().out
    assert "WRONG" not in printed
    assert printed.count("pinmobile, batches: the first ") == 3
    assert re.search(r"pinmobile, one state after another +\S+( +[\d.]+ \(1\.0 x\)){3}", printed)


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


def test_every_benchmark_is_run_and_understands_what_it_is_given(asked: Any) -> None:
    every = ["rollout", "ensembles", "arm_ensembles", "loop", "calls", "batches"]
    every += ["memory", "wheels", "mpc", "identification", "derivatives"]
    every += ["viewing", "imports", "exported", "realtime"]
    assert list(asked()) == list(asked("--quick", "--rounds", "2")) == every


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
