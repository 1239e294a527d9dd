"""What tells one sweep from another: two controllers that differ in anything never look the same."""

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property, partial, wraps
from operator import itemgetter
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from pinmobile import (
    ComputedTorque,
    ConstantForce,
    InvalidArgument,
    MobileRobot,
    NoiseForce,
    NoisyMeasurement,
    Saturated,
    Sweep,
    law,
    planar_difference,
    sweep,
)
from pinmobile.arrays import Array
from pinmobile.sweeps.contents import METADATA, digest_of
from pinmobile.sweeps.fingerprint import determined_by, differences
from pinmobile.sweeps.grids import as_grid
from tests.sweeping import contents, scenario

ROOT = Path(__file__).parents[1]
FACTOR: Any = 3.0
ONE, OTHER = [law(lambda t, q, v, r: 3 * (r.q - q)), law(lambda t, q, v, r: 4 * (r.q - q))]  # on one line
SHAPED, BENT = [law(lambda t, q, v, r: q + v), law(lambda t, q, v, r: q - v)]
INNER = [law(lambda t, q, v, r: (lambda e: 3 * e)(q)), law(lambda t, q, v, r: (lambda e: 4 * e)(q))]


def account(controller: Any, forces: Any = (), version: str | None = None) -> Any:
    """Return the description of a sweep as a store has it."""
    one = replace(scenario(n=3), controller=controller, forces=forces)
    return json.loads(json.dumps(determined_by(as_grid(one), version)))


def push(gain: Any, t: float, q: Array, v: Array, reference: Any, more: Any = None) -> Any:
    return 0.0 * q if gain is more else 0.0 * v


def read(t: float, q: Array, v: Array, reference: Any) -> Any:
    return FACTOR * (reference.q - q)


def read_inside(t: float, q: Array, v: Array, reference: Any) -> Any:
    return np.stack([FACTOR * row for row in reference.q - q])


def through_a_module(t: float, q: Array, v: Array, reference: Any) -> Any:
    return FACTOR.part.gain * (reference.q - q)


def closure(gain: Any) -> Any:
    return law(lambda t, q, v, reference: push(gain, t, q, v, reference))


def dressed(gain: float) -> Any:
    @wraps(planar_difference)
    def mine(q0: Array, q1: Array) -> Array:
        return gain * planar_difference(q0, q1)

    return ComputedTorque(MobileRobot.lecture(), difference=mine)


def with_attribute(gain: float) -> Any:
    def mine(t: float, q: Array, v: Array, reference: Any) -> Any:
        return mine.gain * (reference.q - q)  # type: ignore[attr-defined]

    mine.gain = gain  # type: ignore[attr-defined]
    return law(mine)


class Held:
    def __init__(self, gain: Any) -> None:
        self.gain = gain

    def initial_state(self, context: Any) -> None: ...

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: None) -> Any:
        return push(self.gain, t, q, v, reference), state

    def law(self, t: float, q: Array, v: Array, reference: Any) -> Any:
        return push(self.gain, t, q, v, reference)


class Slotted(Held):
    __slots__ = ("gain",)


@dataclass
class Filled:
    table: Any = field(init=False)

    def initial_state(self, context: Any) -> None: ...

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: None) -> Any:
        return self.table * q, state


def filled(table: Any) -> Any:
    made = Filled()
    made.table = table
    return made


def of_class(base: type = Held, **members: Any) -> Any:
    return type("Mine", (base,), members)(3.0)


def with_attributes(**attributes: Any) -> Any:
    made = Held(3.0)
    vars(made).update(attributes)
    return made


def dataclass_of(default: Any) -> Any:
    members = {"__annotations__": {"gain": Any}, "gain": default, "__module__": __name__}
    return dataclass(slots=True)(type("Mine", (), members))


class Renamed(float):
    pass


class Table(dict[str, Any]):
    pass


class Remembering(Held):
    @cached_property
    def twice(self) -> Any:
        return 2 * self.gain


class Typed:
    def __init__(self, gain: float) -> None:
        self.type = gain


class Level(Enum):
    LOW = 1.0
    HIGH = 2.0


class Gains(NamedTuple):
    kp: float
    kd: float


DIFFERENT: dict[str, Callable[[float], Any]] = {
    "a partial's argument": lambda k: law(partial(push, k)),
    "a partial's keyword": lambda k: law(partial(push, 1.0, more=k)),
    "a partial in a partial": lambda k: law(partial(partial(push, np.array([k, 1, 1])))),
    "a robot in a partial": lambda k: law(partial(push, MobileRobot(k, 1.0))),
    "the constants of lambdas on one line": lambda k: ONE if k == 3 else OTHER,
    "the operations of lambdas on one line": lambda k: SHAPED if k == 3 else BENT,
    "a lambda in a lambda": lambda k: INNER[k == 3],
    "a number and a list of it": lambda k: closure(k if k == 3 else [3.0]),
    "a list and a tuple": lambda k: closure([3.0] if k == 3 else (3.0,)),
    "a list and an array": lambda k: closure([3.0] if k == 3 else np.array([3.0])),
    "whole numbers and others": lambda k: closure(3 if k == 3 else 3.0),
    "great whole numbers": lambda k: closure(2**60 + int(k)),
    "the sign of zero": lambda k: closure(0.0 if k == 3 else -0.0),
    "a precision": lambda k: closure(np.float32(0.5) if k == 3 else 0.5),
    "keys of a dict": lambda k: closure({1: 3.0, "1": k}),
    "dots in keys": lambda k: closure({"a.b": 1.0} if k == 3 else {"a": {"b": 1.0}}),
    "the order of a dict": lambda k: closure(dict.fromkeys("ab" if k == 3 else "ba", 1.0)),
    "an empty dict": lambda k: closure({} if k == 3 else ()),
    "an array of another type": lambda k: closure(np.array([3]) if k == 3 else np.array([3.0])),
    "what wraps a function of the library": dressed,
    "an attribute of a function": with_attribute,
    "the state of an object": Held,
    "an object with slots": Slotted,
    "an object that is called": lambda k: law(partial(push, Held(k))),
    "a bound method": lambda k: law(Held(k).law),
    "a bound method of an array": lambda k: closure(np.array([k, 1.0]).dot),
    "a number of one's own type": lambda k: closure(Renamed(k)),
    "a dict of one's own type": lambda k: closure(Table(a=k)),
    "a namespace": lambda k: closure(SimpleNamespace(gain=k)),
    "a field that is filled later": filled,
    "a missing attribute": lambda k: with_attributes(**({} if k == 3 else {"more": "absent"})),
    "a default of a class with slots": lambda k: closure(dataclass_of(k)),
    "what a field is filled by": lambda k: closure(dataclass_of(field(default_factory=partial(push, k)))),
    "an inherited method": lambda k: of_class(Held if k == 3 else type("Held", (Held,), {"law": push})),
    "a member of a class": lambda k: of_class(gain_of=k),
    "a static method": lambda k: of_class(f=staticmethod(partial(push, k))),
    "a class method": lambda k: of_class(f=classmethod(partial(push, k))),
    "an attribute called type": lambda k: closure(Typed(k)),
    "a property": lambda k: of_class(f=property(partial(push, k))),
    "an enumeration": lambda k: closure(Level.LOW if k == 3 else Level.HIGH),
    "a named tuple": lambda k: closure(Gains(k, 1.0)),
    "a slice": lambda k: closure(slice(0, int(k))),
    "the seed of a noisy measurement": lambda k: NoisyMeasurement(closure(1.0), 1e-3, 1e-3, seed=int(k)),
    "the seed sequence of one": lambda k: NoisyMeasurement(
        closure(1.0), 1e-3, 1e-3, seed=np.random.SeedSequence(1, spawn_key=(int(k),))
    ),
    "a controller in a wrapper": lambda k: Saturated(closure(k), 9.0),
}


@pytest.mark.alike
@pytest.mark.parametrize("what", DIFFERENT)
def test_two_controllers_that_differ_are_told_apart_and_one_is_known_again(what: str) -> None:
    make = DIFFERENT[what]
    assert differences(account(make(3.0)), account(make(4.0)))
    assert not differences(account(make(3.0)), account(make(3.0)))


def test_what_an_object_only_remembers_is_no_difference() -> None:
    fresh, used = Remembering(3.0), Remembering(3.0)
    assert used.twice == 6.0
    assert not differences(account(law(partial(push, fresh))), account(law(partial(push, used))))


@pytest.mark.parametrize("function", [read, read_inside])
def test_globals_are_told_even_where_only_a_function_inside_reads_them(
    monkeypatch: pytest.MonkeyPatch, function: Any
) -> None:
    before = account(law(function))
    monkeypatch.setitem(globals(), "FACTOR", 4.0)
    assert "reads.FACTOR is 3.0 there and 4.0 here" in differences(before, account(law(function)))


def _passes_on(t: float, q: Array, v: Array, reference: Any) -> Array:
    return np.asarray(len(vars(FACTOR)) * q)


def test_of_a_module_is_told_what_a_function_reads_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    package: Any = ModuleType("mypackage")
    package.part, package.other = ModuleType("mypackage.part"), object()
    package.part.gain = 3.0
    monkeypatch.setitem(globals(), "FACTOR", package)
    before = account(law(through_a_module))
    package.part.gain = 4.0
    assert "reads.FACTOR.part.gain is 3.0 there and 4.0" in differences(
        before, account(law(through_a_module))
    )
    with pytest.raises(InvalidArgument, match=r"function \(FACTOR\) is a module, of which"):
        account(law(_passes_on))


def test_forces_are_told_apart_by_their_code() -> None:
    one, other = [lambda t, q, v: 1.0 * q, lambda t, q, v: 2.0 * q]
    assert "forces[0].source" in differences(account(ONE, [one]), account(ONE, [other]))
    assert "forces[0].force" in differences(
        account(ONE, [ConstantForce((1, 0, 0))]), account(ONE, [ConstantForce((2, 0, 0))])
    )
    assert "forces[0].phases" in differences(
        account(ONE, [NoiseForce((1, 0, 0), 1.0, seed=1)]), account(ONE, [NoiseForce((1, 0, 0), 1.0, seed=2)])
    )


def _typed(text: str) -> Any:
    found: dict[str, Any] = {}
    exec(f"def f(t, q, v, reference): return {text}", found)
    return law(found["f"])


def test_a_function_without_a_source_needs_a_word_of_its_users() -> None:
    with pytest.raises(
        InvalidArgument, match=r"function is f, .*: it has no source; .*version=\"1\"\), a word"
    ):
        account(_typed("3 * q"))
    one, again, other = (account(_typed("3 * q"), version=word) for word in ("1", "1", "2"))
    assert not differences(one, again)
    assert differences(one, other) == "version is 1 there and 2 here"
    assert one["all"]["controller.function"] == "f, by version"
    assert one["fingerprint"] != other["fingerprint"]


def _loaded(path: Path, text: str) -> Any:
    path.write_text(text)
    spec = importlib.util.spec_from_file_location("mylaws", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_text_that_counts_is_the_one_that_runs(tmp_path: Path) -> None:
    """A file may change after it was loaded: what it says then made no number."""
    text = "def mine(t, q, v, reference):\n    return 3.0 * (reference.q - q)\n"
    module = _loaded(tmp_path / "mylaws.py", text)
    before = account(law(module.mine))
    (tmp_path / "mylaws.py").write_text(text.replace("3.0", "4.0"))
    with pytest.raises(InvalidArgument, match=r"is mine, .*: its source is not what runs here"):
        account(law(module.mine))
    again = _loaded(tmp_path / "mylaws.py", f"# A word.\n\n{text.replace(' * ', '*')}")
    assert not differences(before, account(law(again.mine)))
    (tmp_path / "mylaws.py").unlink()
    with pytest.raises(InvalidArgument, match=r"is mine, .*: it has no source"):
        account(law(again.mine))


def test_what_is_private_to_a_class_is_told_by_its_whole_name(tmp_path: Path) -> None:
    text = "class Mine:\n    def law(self, t, q, v, reference):\n        return __gain * q\n"
    module = _loaded(tmp_path / "mylaws.py", f"_Mine__gain = 3.0\n{text}")
    before = account(law(module.Mine().law))
    module._Mine__gain = 4.0
    assert "reads._Mine__gain is 3.0 there and 4.0 here" in differences(
        before, account(law(module.Mine().law))
    )


def test_the_text_of_a_lambda_is_its_own() -> None:
    def made(k: int) -> Any:
        two = [lambda t, q, v, r: (lambda e: 3 * e)(q), lambda t, q, v, r: (lambda e: 3 * (e))(v)]
        return account(law(two[k]))["all"]["controller.function.source"]

    assert [made(k) for k in (0, 1)] == [
        "lambda t, q, v, r: (lambda e: 3 * e)(q)",
        "lambda t, q, v, r: (lambda e: 3 * e)(v)",
    ]
    inner = (lambda k: lambda t, q, v, r: k * q)(3.0)
    told = account(law(inner))["all"]
    assert told["controller.function.source"] == "lambda t, q, v, r: k * q"
    assert told["controller.function.reads.k"] == 3.0


def test_of_long_texts_is_told_where_they_differ() -> None:
    one, other = [lambda t, q, v: 1.0 * q + np.zeros(3) * np.linalg.norm(v - q) * 2.0 for _ in "a"], []
    other = [lambda t, q, v: 1.0 * q + np.zeros(3) * np.linalg.norm(v - q) * 3.0]
    assert differences(account(ONE, one), account(ONE, other)) == (
        "forces[0].source is ...inalg.norm(v - q) * 2.0 there and ...inalg.norm(v - q) * 3.0 here"
    )


def _imports(t: float, q: Array, v: Array, reference: Any) -> Any:
    from tests import sweeping

    return 0 * q * sweeping.CHUNK


def _evaluates(t: float, q: Array, v: Array, reference: Any) -> Any:
    return eval("FACTOR") * q


class Copied(Held):
    def __getstate__(self) -> dict[str, Any]:
        return {}


class Sent(Held):
    def __reduce__(self) -> tuple[Any, ...]:
        return Held, ()


@pytest.mark.parametrize(
    ("controller", "text"),
    [
        (closure(itemgetter(1)), r"controller\.function \(gain\) is a itemgetter, of which a store cannot"),
        (closure(np.frompyfunc(abs, 1, 1)), "is a ufunc, of which a store cannot tell"),
        (closure(np.ma.array([1.0])), "is a MaskedArray, of which a store cannot tell"),
        (closure(np.array([object()])), "is a ndarray, of which a store cannot tell"),
        (closure(np.random.default_rng(1)), "is a Generator, of which a store cannot tell"),
        (closure({3.0}), "is a set, of which a store cannot tell"),
        (closure(type("Several", (set,), {})([3.0])), "is a Several, of which a store cannot tell"),
        (closure(Copied(3.0)), "is a Copied, of which a store cannot tell"),
        (closure(Sent(3.0)), "is a Sent, of which a store cannot tell"),
        (closure(type("Numbers", (np.random.Generator,), {})(np.random.PCG64(1))), "is a Numbers, of which"),
        (
            law(partial(push, ModuleType("mine"))),
            r"args\.tuple\[0\] is a module, of which a store cannot tell",
        ),
        (closure(item for item in "ab"), "is <genexpr>, of which a store cannot tell"),
        (law(_imports), r"is _imports, .*: it imports tests when it is called"),
        (law(_evaluates), r"is _evaluates, .*: it calls eval"),
    ],
)
def test_what_cannot_be_told_is_refused(controller: Any, text: str) -> None:
    with pytest.raises(InvalidArgument, match=text):
        account(controller)
    assert not differences(account(controller, version="1"), account(controller, version="1"))


def test_a_store_does_not_take_the_other_of_two_lambdas_on_a_line(tmp_path: Path) -> None:
    first = replace(scenario(n=3), controller=ONE, duration=0.5)
    sweep(first, tmp_path / "store")
    sweep(first, tmp_path / "store")
    with pytest.raises(InvalidArgument, match=r"another sweep: .*\.source is lambda .*: 3 \* "):
        sweep(replace(first, controller=OTHER), tmp_path / "store")


def test_a_store_keeps_the_word_for_what_it_cannot_recognise(tmp_path: Path) -> None:
    first = replace(scenario(n=3), controller=_typed("3 * (reference.q - q)"), duration=0.5)
    path = tmp_path / "store"
    with pytest.raises(InvalidArgument, match="is f, of which a store cannot tell"):
        sweep(first, path)
    sweep(first, path, version="stiff")
    assert len(sweep(first, path, version="stiff").ensemble().max_distance) == 3
    assert len(Sweep.open(path, first).ensemble().max_distance) == 3
    for version, told in (
        ("soft", "stiff there and soft"),
        (" ", "expected a word"),
        ("a\n", "expected text"),
    ):
        with pytest.raises(InvalidArgument, match=f"version is .*{told}"):
            sweep(first, path, version=version)
    known = replace(first, controller=ONE)
    with pytest.raises(InvalidArgument, match="version is stiff there and absent here"):
        sweep(known, path)


@pytest.mark.parametrize("number", [1, 2, 4])
def test_a_store_of_another_format_is_not_misread(tmp_path: Path, number: int) -> None:
    run, path = replace(scenario(n=3), duration=0.5), tmp_path / "store"
    answer = sweep(run, path).answer()
    there = json.loads((path / METADATA).read_bytes())
    mine = json.loads(there["attributes"]["pinmobile_sweep"])
    mine["determined_by"]["format"] = number
    del mine["digest"]
    since = {"errors_from_s": there["attributes"]["errors_from_s"]}
    mine["digest"] = digest_of(mine, there["consolidated_metadata"]["metadata"], since)
    there["attributes"]["pinmobile_sweep"] = json.dumps(mine)
    (path / METADATA).write_text(json.dumps(there))
    files = contents(path)
    told = rf"store is '.*', which was made by pinmobile .* in format {number}; .*: start in a new folder"
    calls: list[Callable[[], Any]] = [lambda: sweep(run, path), lambda: Sweep.open(path, run)]
    for call in calls:
        with pytest.raises(InvalidArgument, match=told):
            call()
    if number == 2:  # the numbers are where they are today
        assert Sweep.open(path).answer() == answer
    else:
        with pytest.raises(InvalidArgument, match=told):
            Sweep.open(path)
    assert contents(path) == files


def test_every_process_tells_the_same_of_all_of_them() -> None:
    code = "from tests.test_sweeps_origin import *; "
    code += "print(json.dumps([account(make(3.0)) for make in DIFFERENT.values()]))"
    told = [
        subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT,
            check=True,
            capture_output=True,
            text=True,
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": ":".join(sys.path)},
        ).stdout
        for seed in ("1", "2")
    ]
    assert told[0] == told[1]
    assert json.loads(told[0]) == [account(make(3.0)) for make in DIFFERENT.values()]
