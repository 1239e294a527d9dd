"""What tells one sweep from another: two scenarios that differ in anything never look the same."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import law
from pinmobile.arrays import Array
from pinmobile.compiled import identity
from pinmobile.sweeps import Points
from pinmobile.sweeps._points import describe, differences
from tests.sweeping import points, scenario

ROOT = Path(__file__).parents[1]
FACTOR: Any = 3.0
SHAPED = [law(lambda t, q, v, r: q + v), law(lambda t, q, v, r: q - v)]  # on one line


def account(controller: Any = None, version: str | None = None, **changed: Any) -> Any:
    one = scenario(n=3, **changed | ({} if controller is None else {"controller": controller}))
    return describe(Points({}, [one]), version)


def push(gain: Any, t: float, q: Array, v: Array, reference: Any, more: Any = None) -> Any:
    return 0.0 * q if gain is more else 0.0 * v


def read(t: float, q: Array, v: Array, reference: Any) -> Any:
    return np.stack([FACTOR * row for row in reference.q - q])


def through_a_module(t: float, q: Array, v: Array, reference: Any) -> Any:
    return FACTOR.part.gain * (reference.q - q)


def closure(gain: Any) -> Any:
    return law(lambda t, q, v, reference: push(gain, t, q, v, reference))


class Held:
    def __init__(self, gain: Any) -> None:
        self.gain = gain

    def initial_state(self, context: Any) -> None: ...

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: None) -> Any:
        return push(self.gain, t, q, v, reference), state

    def law(self, t: float, q: Array, v: Array, reference: Any) -> Any:
        return push(self.gain, t, q, v, reference)


def of_class(base: type = Held, **members: Any) -> Any:
    return type("Mine", (base,), members)(3.0)


class Caching(Held):
    @cached_property
    def twice(self) -> Any:
        return 2 * self.gain


def seed(k: float) -> Any:
    return np.random.SeedSequence(1, spawn_key=(int(k),))


DIFFERENT: dict[str, Callable[[float], Any]] = {
    "a partial's keyword": lambda k: law(partial(push, 1.0, more=k)),
    "the operations of lambdas on one line": lambda k: SHAPED[k == 3],
    "a number and a list of it": lambda k: closure(k if k == 3 else [3.0]),
    "whole numbers and others": lambda k: closure(3 if k == 3 else 3.0),
    "the sign of zero": lambda k: closure(0.0 if k == 3 else -0.0),
    "the order of a dict": lambda k: closure(dict.fromkeys("ab" if k == 3 else "ba", 1.0)),
    "a set": lambda k: closure({"a", "b", str(k)}),
    "the state of an object": Held,
    "a bound method": lambda k: law(Held(k).law),
    "a bound method of an array": lambda k: closure(np.array([k, 1.0]).dot),
    "a static method": lambda k: of_class(f=staticmethod(partial(push, k))),
    "a generator of random numbers": lambda k: closure(np.random.default_rng(int(k))),
    "the seed sequence of one": lambda k: pm.MeasurementNoise(closure(1.0), 1e-3, 1e-3, seed=seed(k)),
}


@pytest.mark.parametrize("what", DIFFERENT)
def test_two_controllers_that_differ_are_told_apart_and_one_is_known_again(what: str) -> None:
    make = DIFFERENT[what]
    assert differences(account(make(3.0)), account(make(4.0)))
    assert not differences(account(make(3.0)), account(make(3.0)))


MASSES = np.linspace(20, 40, 3)


class OwnTrajectory:
    """A trajectory of a user's own, with contents that nobody knows: its reference stands for it."""

    duration = 6.0

    def __init__(self, last: float) -> None:
        self.last, self.unknown = last, (item for item in "ab")

    def __call__(self, t: Any) -> pm.Reference:
        q, v, a = np.zeros((3, *np.shape(t), 3))
        q[..., 0] = np.where(np.asarray(t) == 6.0, self.last, 0.0)
        return pm.Reference(q, v, a)


@pytest.mark.parametrize(
    ("one", "other", "told"),
    [
        ({}, {"limit": 7.0}, "limit is 1000.0 there and 7.0 here"),
        ({}, {"integrator": pm.rk4}, "integrator"),
        ({}, {"duration": 3.0}, "duration is 6.0 there and 3.0 here"),
        ({}, {"robot": pm.MobileRobot(30, 0.1, com=(0.1, 0))}, "plant.com"),
        ({}, {"forces": (pm.ConstantForce((1, 0, 0)),)}, "forces.0.force is absent there and float64"),
        ({}, {"spread": {"mass": pm.Uniform(20, 30)}}, "spread.mass.high is absent there and 30.0 here"),
        (
            {"spread": {"mass": MASSES}},
            {"spread": {"mass": [*MASSES[:-1], 41]}},
            "spread.mass is float64 [20",
        ),
        ({"trajectory": OwnTrajectory(0)}, {"trajectory": OwnTrajectory(1)}, "reference is "),
    ],
)
def test_whatever_changes_the_numbers_is_told(one: Any, other: Any, told: str) -> None:
    there, again, here = (account(**each) for each in (one, one, other))
    assert there == again
    assert told in differences(there, here, most=30)


def test_versions_and_machine_are_told() -> None:
    there = account()
    names = ("numpy", "scipy", "llvmlite", "pin")
    assert {name: there["versions"][name] for name in names} == {name: version(name) for name in names}
    assert re.fullmatch(rf"{re.escape(pm.__version__)} \([0-9a-f]{{12}}\)", there["versions"]["pinmobile"])
    other = {**there, "machine": "abacus", "versions": {**there["versions"], "numpy": "0"}}
    assert "version of numpy is" in differences(there, other)
    assert "machine is" in differences(there, other)


def test_an_edited_library_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity, "__file__", str(tmp_path / "pinmobile/compiled/identity.py"))
    told = []
    for text in ("force = 1\n", "force = 2\n"):
        (tmp_path / "pinmobile").mkdir(exist_ok=True)
        (tmp_path / "pinmobile/forces.py").write_text(text)
        identity.code_of_library.cache_clear()
        told.append(account())
    identity.code_of_library.cache_clear()
    assert differences(*told).startswith("version of pinmobile is 0.")


def test_globals_and_modules_are_told_and_caches_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    before = account(law(read))
    monkeypatch.setitem(globals(), "FACTOR", 4.0)
    assert differences(before, account(law(read)))
    package: Any = ModuleType("mypackage")
    package.part, package.other = ModuleType("mypackage.part"), object()
    package.part.gain = 3.0
    monkeypatch.setitem(globals(), "FACTOR", package)
    before = account(law(through_a_module))
    package.part.gain = 4.0
    assert differences(before, account(law(through_a_module)))
    fresh, used = Caching(3.0), Caching(3.0)
    assert used.twice == 6.0
    assert not differences(account(law(partial(push, fresh))), account(law(partial(push, used))))


def test_what_cannot_be_recognised_needs_a_word_of_its_user(tmp_path: Path) -> None:
    first = replace(scenario(n=3), controller=closure(item for item in "ab"), duration=0.5)
    path = tmp_path / "store"
    with pytest.raises(pm.InvalidArgument, match=r"controller\.function has .*<genexpr>,"):
        pm.sweep(first, path)
    pm.sweep(first, path, version="stiff")
    assert len(pm.sweep(first, path, version="stiff").ensemble().max_distance) == 3
    assert len(pm.Sweep.open(path, first).ensemble().max_distance) == 3
    with pytest.raises(pm.InvalidArgument, match="version is stiff there and soft here"):
        pm.sweep(first, path, version="soft")


@pytest.mark.long
def test_every_process_tells_the_same_of_all_of_them() -> None:
    code = "from tests.test_sweeps_origin import *; print(json.dumps(accounts()))"
    own = "1" if os.environ.get("PYTHONHASHSEED") != "1" else "2"
    environment = {"PYTHONHASHSEED": own, "PYTHONPATH": ":".join(sys.path)}
    words = [sys.executable, "-c", code]
    told = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True, env=environment).stdout
    accounts()  # what was looked at before changes nothing
    assert json.loads(told) == accounts()


def accounts() -> list[Any]:
    return [describe(points()), *(account(make(3.0)) for make in DIFFERENT.values())]
