"""Loops in files: another process does not trace them again, unless what they follow from has changed."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import (
    COMPILED,
    PD,
    Circle,
    ComputedTorque,
    Delayed,
    JointFriction,
    MobileRobot,
    NoiseForce,
    NoisyMeasurement,
    Normal,
    Saturated,
    Tangent,
    Uniform,
    ensemble,
    law,
    rk4,
    simulate,
)
from pinmobile.compiled import Cache, file_cache, processor, program_cache
from pinmobile.compiled.passes import traced
from pinmobile.compiled.processor import LOOP
from pinmobile.controllers import feedback
from tests.test_compiled_arms import Swing
from tests.test_remembered import CHANGES

ROBOT = MobileRobot(30.0, 1.3, com=(0.1, 0.05))
CIRCLE = Tangent(Circle(2.0, 0.2, 1.0))
FILE = ""


class Process:
    """What stands for a process that begins: it knows nothing but its files."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.traced = folder, 0
        monkeypatch.setenv("PINMOBILE_CACHE", str(folder))
        monkeypatch.setattr(program_cache, "traced", self._trace)

    def _trace(self, *given: Any, **options: Any) -> Any:
        self.traced += 1
        return traced(*given, **options)

    def begin(self) -> None:
        program_cache._known.clear()
        program_cache._memories.clear()
        processor._known.clear()
        self.traced = 0

    @property
    def loops(self) -> list[str]:
        return sorted(file.name for file in self.folder.glob("*.loop"))


@pytest.fixture
def process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Process:
    made = Process(tmp_path, monkeypatch)
    made.begin()
    return made


def run(controller: Any, **options: Any) -> Any:
    given: dict[str, Any] = {"n": 3, "spread": {"mass": Uniform(20, 40)}, "dt": 0.1, "engine": COMPILED}
    return ensemble(ROBOT, controller, CIRCLE, **given | options)


LOOPS: dict[str, Callable[[], Any]] = {
    "computed torque": lambda: run(ComputedTorque(ROBOT, 4, 5)),
    "wrappers": lambda: run(NoisyMeasurement(Delayed(Saturated(PD(100, 20), [9, 9, 3]), 2), 0.1, 0.1, 3)),
    "noise": lambda: run(PD(100, 20), forces=[NoiseForce([1, 2, 3], 2.0, 5)], integrator=rk4, substeps=2),
    "a law": lambda: run(law(lambda t, q, v, reference: 9.0 * (reference.q - q) - np.tanh(v))),
    "spread of the state": lambda: run(PD(100, 20), spread={"start_x": Normal(0, 0.1), "kp": Uniform(3, 5)}),
}


@pytest.mark.parametrize("name", LOOPS)
def test_a_loop_is_traced_in_one_process_alone_and_gives_the_same_bits(name: str, process: Process) -> None:
    first = LOOPS[name]()
    assert process.traced == 1
    process.begin()
    again = LOOPS[name]()
    assert process.traced == 0
    for what in ("max_error", "max_force", "rms_error"):
        assert np.array_equal(getattr(first, what), getattr(again, what))


def arm(name: str = "ur5", height: float = 0.2) -> Any:
    robot = MobileRobot.box().mount(name, (0.1, -0.05, height, 0.4))
    forces = [JointFriction(np.ones(robot.nv))]
    controller = Saturated(ComputedTorque(robot, 4, 5), np.full(robot.nv, 500.0))
    given: dict[str, Any] = {"dt": 0.1, "forces": forces, "duration": 0.2, "engine": COMPILED}
    return simulate(robot, controller, Swing(robot), **given)


def test_one_robot_with_an_arm_and_its_signals_are_found_again(process: Process) -> None:
    first = arm()
    process.begin()
    again = arm()
    assert process.traced == 0
    assert np.array_equal(first.q, again.q)
    assert list(first.signals) == list(again.signals)
    assert [each.unit for each in first.signals.values()] == [each.unit for each in again.signals.values()]


def test_other_kinematics_are_another_loop(process: Process) -> None:
    for height, expected in ((0.2, 1), (0.3, 1), (0.2, 0)):
        process.begin()
        arm("double_pendulum_simple", height)
        assert process.traced == expected


@pytest.mark.parametrize("what", CHANGES)
def test_what_a_law_reaches_in_any_way_is_seen_in_the_next_process(what: str, process: Process) -> None:
    function, change = CHANGES[what]
    for value in (2.0, 20.0, 2.0):
        change(value)
        process.begin()
        one = run(law(function), n=1, spread={})
        alone = simulate(ROBOT, law(function), CIRCLE, dt=0.1)
        np.testing.assert_allclose(one.max_error[0], alone.max_error(), rtol=1e-12, atol=1e-12)


def by_environment(t: float, q: Any, v: Any, reference: Any) -> Any:
    return float(os.environ["PINMOBILE_TEST_GAIN"]) * (reference.q - q) - v


def by_file(t: float, q: Any, v: Any, reference: Any) -> Any:
    with open(FILE) as file:
        return float(file.read()) * (reference.q - q) - v


def by_numpy(t: float, q: Any, v: Any, reference: Any) -> Any:
    return np.loadtxt(FILE) * (reference.q - q) - v


def by_memory_map(t: float, q: Any, v: Any, reference: Any) -> Any:
    return float(bytes(np.memmap(FILE))) * (reference.q - q) - v


def by_path(t: float, q: Any, v: Any, reference: Any) -> Any:
    return float(Path(FILE).read_text()) * (reference.q - q) - v


def by_import(t: float, q: Any, v: Any, reference: Any) -> Any:
    from os import environ

    return float(environ["PINMOBILE_TEST_GAIN"]) * (reference.q - q) - v


def by_lookup(t: float, q: Any, v: Any, reference: Any) -> Any:
    asked = globals()["os"].environ
    return float(asked["PINMOBILE_TEST_GAIN"]) * (reference.q - q) - v


def by_inner(t: float, q: Any, v: Any, reference: Any) -> Any:
    def gain() -> float:
        return float(os.environ["PINMOBILE_TEST_GAIN"])

    return gain() * (reference.q - q) - v


@pytest.mark.parametrize(
    "function", [by_environment, by_file, by_numpy, by_memory_map, by_path, by_import, by_lookup, by_inner]
)
def test_a_law_that_asks_outside_python_is_traced_in_each_process(
    function: Any, process: Process, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(globals(), "FILE", str(tmp_path / "gain.txt"))
    for value in (2.0, 20.0):
        Path(FILE).write_text(str(value))
        monkeypatch.setenv("PINMOBILE_TEST_GAIN", str(value))
        process.begin()
        one = run(law(function), n=1, spread={})
        alone = simulate(ROBOT, law(function), CIRCLE, dt=0.1)
        np.testing.assert_allclose(one.max_error[0], alone.max_error(), rtol=1e-12, atol=1e-12)
    assert process.loops == []


def test_a_robot_that_a_law_reaches_by_its_name_has_no_lasting_form(process: Process) -> None:
    def by_robot(t: float, q: Any, v: Any, reference: Any) -> Any:
        return ROBOT.inverse_dynamics(q, v, 9.0 * (reference.q - q) - v)

    run(law(by_robot))
    assert process.loops == []


def _twice(one: float, other: float) -> Any:
    def made(gain: float) -> Any:
        return lambda e: gain * e

    first, second = made(one), made(other)
    return law(lambda t, q, v, reference: first(reference.q - q) - second(v))


def test_closures_of_one_function_are_told_apart(process: Process) -> None:
    found = []
    for gains in ((4.0, 9.0), (9.0, 4.0), (4.0, 9.0)):
        process.begin()
        found.append((run(_twice(*gains), n=1, spread={}).max_error[0], process.traced))
    assert not np.array_equal(found[0][0], found[1][0])
    assert np.array_equal(found[0][0], found[2][0])
    assert [traces for _, traces in found] == [1, 1, 0]


def test_the_librarys_code_as_it_is_in_memory_counts(
    process: Process, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = PD(100, 20)
    before = run(controller).max_error

    def weaker(self: Any, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return 9.0 * (reference.q - q) - v, state

    monkeypatch.setattr(feedback.PD, "__call__", weaker)
    process.begin()
    assert not np.array_equal(run(controller).max_error, before)
    assert process.traced == 1


def test_no_file_is_used_where_the_source_is_not_what_was_loaded(
    process: Process, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(PD(100, 20))
    file_cache._machinery.cache_clear()
    monkeypatch.setattr(file_cache, "_BEGAN", time.time() - 1e9)
    process.begin()
    run(PD(100, 20))
    assert process.traced == 1


@pytest.mark.parametrize("damage", [lambda b: b[:-9], lambda b: b"", lambda b: b[:-1] + b"?"])
def test_a_damaged_loop_is_traced_again(damage: Any, process: Process) -> None:
    before = run(PD(100, 20)).max_error
    (name,) = process.loops
    whole = (process.folder / name).read_bytes()
    (process.folder / name).write_bytes(damage(whole))
    process.begin()
    assert np.array_equal(run(PD(100, 20)).max_error, before)
    assert process.traced == 1
    assert (process.folder / name).read_bytes() == whole


@pytest.mark.parametrize("text", [b"{}", b"[", b"[1]", b'{"loop": {}}'])
def test_a_whole_file_that_holds_no_loop_is_written_again(text: bytes, process: Process) -> None:
    before = run(PD(100, 20)).max_error
    (name,) = process.loops
    Cache(process.folder).write(name.removesuffix(".loop"), text, LOOP)
    process.begin()
    assert np.array_equal(run(PD(100, 20)).max_error, before)
    assert process.traced == 1


def test_a_loop_whose_machine_code_is_gone_is_built_and_not_traced(process: Process) -> None:
    before = run(PD(100, 20)).max_error
    for file in process.folder.glob("*.o"):
        file.unlink()
    process.begin()
    assert np.array_equal(run(PD(100, 20)).max_error, before)
    assert process.traced == 0


def test_another_process_finds_the_loop_whatever_its_seed_of_hashes(process: Process) -> None:
    LOOPS["a law"]()
    LOOPS["wrappers"]()
    before = process.loops
    code = (
        "from pinmobile.compiled import program_cache\n"
        "def refuse(*given, **options): raise SystemExit('traced')\n"
        "from tests.test_compiled_file_cache import LOOPS\n"
        "program_cache.traced = refuse\n"
        "LOOPS['a law'](); LOOPS['wrappers']()\n"
    )
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    words = [sys.executable, "-c", code]
    root = Path(__file__).parents[1]
    done = subprocess.run(words, env=environment, cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert process.loops == before
