"""Which loops are the same program: what changes is traced anew, other numbers are not; and files of both."""

import gc
import importlib
import os
import subprocess
import sys
import weakref
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.compiled import Cache, identity, program as compiled_program
from pinmobile.compiled.program import LOOP
from pinmobile.loop import _engines
from pinmobile.loop._trace import Trace

ROBOT = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))
CIRCLE = pm.Tangent(pm.Circle(2.0, 0.2, 1.0))


class Process:
    """What stands for a process that begins: it knows nothing but its files."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.traced = folder, 0
        monkeypatch.setenv("PINMOBILE_CACHE", str(folder))
        monkeypatch.setattr(_engines, "Trace", self._trace)
        self.begin()

    def _trace(self, *given: Any) -> Trace:
        self.traced += 1
        return Trace(*given)

    def begin(self) -> None:
        _engines._programs.clear()
        compiled_program._functions.clear()
        self.traced = 0

    @property
    def loops(self) -> list[str]:
        return sorted(file.name for file in self.folder.glob("*.loop"))


@pytest.fixture
def process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Process:
    return Process(tmp_path / "cache", monkeypatch)


def run(controller: Any, **options: Any) -> Any:
    given: dict[str, Any] = {"n": 3, "spread": {"mass": pm.Uniform(20, 40)}, "dt": 0.1} | options
    return pm.ensemble(ROBOT, controller, CIRCLE, engine=pm.Engine.COMPILED, **given)


def wrapped(controller: Any) -> Any:
    return pm.MeasurementNoise(pm.MeasurementDelay(controller, 2), 0.1, 0.1, 3)


# Other numbers are no other program.


def wheeled(mass: float, ground: Any) -> pm.WheeledRobot:
    table = pm.WheelTable.differential(0.5, 0.1, supports=[(0.2, 0.0)], mass=1, spin_inertia=0.01)
    return pm.WheeledRobot(pm.MobileRobot(mass, 2.3, com=(0.0, 0.0, 0.1)), table, ground)


def rolling(mass: float, ground: Any = None) -> Any:
    plant = wheeled(mass, ground)
    return pm.simulate(
        plant, pm.ControlAllocation(pm.PD(mass, 20.0), plant), CIRCLE, dt=0.1, engine=pm.Engine.COMPILED
    )


def armed(mass: float) -> Any:
    robot = pm.MobileRobot(mass, 1.0).mount("double_pendulum", (0.1, 0.0, 0.2, 0.0))
    motion = pm.WholeBody(robot, CIRCLE, pm.Hold(robot.rest[3:], 1.0))
    given: dict[str, Any] = {"dt": 0.001, "duration": 0.02, "engine": pm.Engine.COMPILED}
    return pm.simulate(
        robot, pm.ComputedTorque(robot, mass, 6), motion, forces=[pm.JointFriction(0.001 * mass)], **given
    )


ALIKE: dict[str, Callable[[float], Any]] = {
    "gains and a model": lambda x: run(pm.ComputedTorque(pm.MobileRobot(x, 1.3, com=(0.1, 0.1)), x, 5)),
    "wrappers": lambda x: run(pm.InputSaturation(wrapped(pm.PD(x, 9)), x)),
    "wheels on a ground": lambda x: rolling(x, pm.Coulomb(0.02 * x)),
    "an arm": armed,
}


@pytest.mark.parametrize("what", ALIKE)
def test_the_same_loop_with_other_numbers_is_not_traced_again(what: str, process: Process) -> None:
    ALIKE[what](15.0)
    assert process.traced == 1
    ALIKE[what](30.0)
    assert process.traced == 1


def test_another_class_integrator_or_structure_is_another_program(process: Process) -> None:
    loops: tuple[Callable[[], Any], ...] = (
        lambda: run(pm.PD(9, 9)),
        lambda: run(pm.PD(9, 9), integrator=pm.rk4),
        lambda: run(pm.PD(9, 9), substeps=2),
        lambda: run(pm.PD((9, 8, 7), 9)),
        lambda: run(pm.PD(9, 9), spread={}),
        lambda: run(pm.PD(9, 9), spread={"kp": pm.Uniform(8, 9)}),
        lambda: run(pm.MeasurementDelay(pm.PD(9, 9), 1)),
        lambda: run(pm.MeasurementDelay(pm.PD(9, 9), 2)),
        lambda: run(pm.PD(9, 9), n=1),
    )
    for _ in range(2):
        for one in loops:
            one()
        assert process.traced == len(loops)


# What a law reaches in any way is seen when it changes.

SCALE, TABLE, GAINS = 2.0, np.array([2.0, 2.0, 2.0]), [2.0]
BOX, SETTINGS = SimpleNamespace(w=2.0), {"inner": {"w": [2.0]}}


class Queue(deque[float]):
    pass


OWN_QUEUE = Queue([2.0])


class Plan:
    k = 2.0

    def gain(self) -> float:
        return self.k


PLAN = Plan()
BOUND = PLAN.gain


def halved(settings: Any) -> Any:
    return settings["inner"]["w"][0]


PARTIAL = partial(halved, SETTINGS)


def by(gain: str) -> Any:
    """Return a law whose gain is an expression of globals."""
    found: dict[str, Any] = {}
    exec(f"def by(t, q, v, reference): return {gain} * (reference.q - q) - v", globals(), found)
    return found["by"]


def by_keyword(t: float, q: Any, v: Any, reference: Any, *, gains: Any = GAINS) -> Any:
    return gains[0] * (reference.q - q) - v


def _closed() -> tuple[Any, Any]:
    gain = 2.0

    def change(x: float) -> None:
        nonlocal gain
        gain = x

    return lambda t, q, v, reference: gain * (reference.q - q) - v, change


CLOSED, CHANGE = _closed()
CHANGES: dict[str, tuple[Any, Callable[[float], Any]]] = {
    "global": (by("SCALE"), lambda x: globals().update(SCALE=x)),
    "array": (by("TABLE"), lambda x: TABLE.fill(x)),
    "closure": (CLOSED, CHANGE),
    "namespace": (by("BOX.w"), lambda x: setattr(BOX, "w", x)),
    "mapping of mappings": (
        by('SETTINGS["inner"]["w"][0]'),
        lambda x: SETTINGS["inner"]["w"].__setitem__(0, x),
    ),
    "subclass of a deque": (by("OWN_QUEUE[0]"), lambda x: OWN_QUEUE.__setitem__(0, x)),
    "default by keyword": (by_keyword, lambda x: setattr(by_keyword, "__kwdefaults__", {"gains": [x]})),
    "bound method": (by("BOUND()"), lambda x: setattr(Plan, "k", x)),
    "partial": (by("PARTIAL()"), lambda x: SETTINGS["inner"]["w"].__setitem__(0, x)),
}


def assert_as_python(controller: Any) -> float:
    one = run(controller, n=1, spread={})
    alone = pm.simulate(ROBOT, controller, CIRCLE, dt=0.1)
    np.testing.assert_allclose(one.max_error[0], alone.max_error(), rtol=1e-12, atol=1e-12)
    return float(one.max_error[0, 0])


@pytest.mark.parametrize("what", CHANGES)
def test_what_a_law_reaches_in_any_way_is_seen_when_it_changes(what: str, process: Process) -> None:
    """In the same process and in the next one, which has the files of this."""
    function, change = CHANGES[what]
    try:
        for k, value in enumerate((2.0, 20.0, 2.0)):
            change(value)
            if k == 2:
                process.begin()
            assert_as_python(pm.law(function))
    finally:
        change(2.0)


class Scaled:
    """A user's ordinary class: its numbers are constants of the compiled loop."""

    bias = 0.0

    def __init__(self, kp: float) -> None:
        self.kp, self.more = kp, {"kd": [1.0]}

    def initial_state(self, context: Any) -> None: ...

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: None) -> Any:
        return self.kp * (reference.q - q) - self.more["kd"][0] * v + self.bias, None


def test_attributes_of_an_ordinary_class_are_seen_when_they_change(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Scaled(4.0)
    found = [assert_as_python(controller)]
    controller.kp = 40.0
    found.append(assert_as_python(controller))
    controller.more["kd"][0] = 9.0
    found.append(assert_as_python(controller))
    monkeypatch.setattr(Scaled, "bias", 5.0)
    found.append(assert_as_python(controller))
    monkeypatch.setattr(
        Scaled, "__call__", lambda self, t, q, v, reference, state: (9 * (reference.q - q), None)
    )
    found.append(assert_as_python(controller))
    assert len(set(found)) == 5


def test_a_module_that_is_reloaded_is_traced_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "def control(t, q, v, reference):\n    return {} * (reference.q - q) - v\n"
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    found, file = [], tmp_path / "edited_law.py"
    file.write_text(text.format(2.0))
    module = importlib.import_module("edited_law")
    for gain in (2.0, 20.0):
        file.write_text(text.format(gain))
        found.append(assert_as_python(pm.law(importlib.reload(module).control)))
    assert found[0] > 1.01 * found[1]


def _run_and_forgotten() -> list[weakref.ref[Any]]:
    robot, large = pm.MobileRobot(31.0, 1.4), np.ones(1_000)
    torque = pm.InputSaturation(pm.ComputedTorque(robot, 4, 5), [50, 50, 50])
    force = pm.ViscousFriction([1, 2, 3])
    trajectory = pm.Tangent(pm.Circle(2.0, 0.1, 5.0))
    pm.ensemble(robot, torque, trajectory, n=2, spread={"mass": pm.Normal(31, 1)}, dt=0.1, forces=[force])
    pm.simulate(robot, torque, trajectory, dt=0.1, forces=[force], engine=pm.Engine.COMPILED)
    return [weakref.ref(x) for x in (robot, large, torque, trajectory, force)]


def test_nothing_that_was_run_is_kept_alive() -> None:
    died = _run_and_forgotten()
    gc.collect()
    assert [type(reference()) for reference in died] == [type(None)] * len(died)


# Another process.

LOOPS: dict[str, Callable[[], Any]] = {
    "wrappers": lambda: run(wrapped(pm.InputSaturation(pm.PD(100, 20), [9, 9, 3]))),
    "a law": lambda: run(pm.law(lambda t, q, v, reference: 9.0 * (reference.q - q) - np.tanh(v))),
    "spread": lambda: run(pm.PD(9, 2), spread={"start.x": pm.Normal(0, 0.1), "kp": pm.Uniform(3, 5)}),
}


@pytest.mark.parametrize("name", LOOPS)
def test_a_loop_is_traced_in_one_process_alone_and_gives_the_same_bits(name: str, process: Process) -> None:
    first = LOOPS[name]()
    assert process.traced == 1
    process.begin()
    again = LOOPS[name]()
    assert process.traced == 0
    for what in ("max_error", "max_input", "rms_error"):
        assert np.array_equal(getattr(first, what), getattr(again, what))


def test_another_process_finds_the_loop_whatever_its_seed_of_hashes(process: Process) -> None:
    LOOPS["a law"]()
    LOOPS["wrappers"]()
    before = process.loops
    code = (
        "from pinmobile.loop import _engines\n"
        "def refuse(*given, **options): raise SystemExit('traced')\n"
        "from tests.test_identity import LOOPS\n"
        "_engines.Trace = refuse\n"
        "LOOPS['a law'](); LOOPS['wrappers']()\n"
    )
    words = [sys.executable, "-c", code]
    given: Any = {"env": os.environ | {"PYTHONHASHSEED": "7"}, "cwd": Path(__file__).parents[1]}
    done = subprocess.run(words, **given, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert process.loops == before


def test_no_file_of_another_source_is_used(process: Process, monkeypatch: pytest.MonkeyPatch) -> None:
    run(pm.PD(100, 20))
    identity._source.cache_clear()
    monkeypatch.setattr(identity, "_START", 0.0)
    process.begin()
    run(pm.PD(100, 20))
    assert process.traced == 1
    identity._source.cache_clear()


@pytest.mark.parametrize(
    ("suffix", "spoil"),
    [
        (".loop", lambda file: file.write_bytes(file.read_bytes()[:-1] + b"?")),
        (".o", lambda file: file.write_bytes(file.read_bytes()[:-1] + b"?")),
        (".loop", lambda file: Cache(file.parent).write(file.stem, b"[", LOOP)),  # whole, and holds no loop
        (".o", lambda file: file.unlink()),
    ],
    ids=["damaged loop", "damaged machine code", "no loop", "no machine code"],
)
def test_what_is_wrong_with_a_file_is_made_again(suffix: str, spoil: Any, process: Process) -> None:
    before = run(pm.PD(100, 20)).max_error
    (file,) = process.folder.glob(f"*{suffix}")
    whole = file.read_bytes()
    spoil(file)
    process.begin()
    assert np.array_equal(run(pm.PD(100, 20)).max_error, before)
    assert file.read_bytes() == whole
    assert process.traced == (suffix == ".loop")


def test_a_loop_is_built_without_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    Process(tmp_path / "file" / "inside", monkeypatch)
    assert_as_python(pm.PD(9, 9))
    assert (tmp_path / "file").read_text() == ""


# The folder of files.


def test_a_file_of_another_user_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = Cache(tmp_path)
    cache.write("key", b"code")
    assert cache.read("key") == b"code"
    monkeypatch.setattr(os, "getuid", lambda: 12345678)
    assert cache.read("key") is None


def test_swapped_files_are_not_run(tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    for key, kind in (("one", ".o"), ("other", ".o"), ("one", ".loop")):
        cache.write(key, f"{key} {kind}".encode(), kind)
    contents = [(tmp_path / name).read_bytes() for name in ("one.o", "other.o", "one.loop")]
    for name, content in zip(("other.o", "one.loop", "one.o"), contents, strict=True):
        (tmp_path / name).write_bytes(content)
    assert [cache.read("one"), cache.read("other"), cache.read("one", ".loop")] == [None, None, None]
    (tmp_path / "one.o").write_bytes(contents[0])
    assert cache.read("one") == b"one .o"


def test_a_folder_that_others_may_write_to_is_not_used(tmp_path: Path) -> None:
    Cache(tmp_path).write("key", b"code")
    tmp_path.chmod(0o702)
    with pytest.warns(UserWarning, match=f"^the folder of machine code '{tmp_path}' is not used"):
        Cache(tmp_path)
    cache = Cache(tmp_path)  # of which nothing more is said
    assert cache.read("key") is None
    cache.write("other", b"code")
    assert [each.name for each in tmp_path.iterdir()] == ["key.o"]


def test_the_folder_is_thinned_and_leaves_no_halves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pinmobile.compiled.program._MAX_FILES", 8)
    cache = Cache(tmp_path)
    for i in range(40):
        cache.write(f"key{i}", b"code")
    assert len(list(tmp_path.iterdir())) <= 8
    assert cache.read("key39") == b"code"
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    cache.write("late", b"code")
    assert not list(tmp_path.glob("*.part"))
