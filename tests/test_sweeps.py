"""Points by path, the store and its answer, a sweep that dies, and what tells one sweep from another."""

import json
import math
import os
import re
import shutil
import signal
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
from pinmobile.errors import UnknownName
from pinmobile.loop import run_scenario
from pinmobile.loop._description import edges
from pinmobile.metrics import Metric
from pinmobile.parts import evolved
from pinmobile.sweeps import Axis, Points
from pinmobile.sweeps._points import _NAMES, change_scenario, describe, differences
from tests.refusals import refused
from tests.sweeping import CHUNK, GRID, ROBOT, contents, points, scenario, swept

ROOT = Path(__file__).parents[1]
PUSH = pm.ConstantForce((10.0, 0.0, 0.0))
INF, NAN = math.inf, math.nan


class Stop(Exception):
    pass


def stop_at(robots: int) -> Callable[[int, int], None]:
    def stop(done: int, total: int) -> None:
        if done >= robots:
            raise Stop

    return stop


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> pm.Sweep:
    return swept(tmp_path_factory.mktemp("sweep") / "store")


def test_a_spread_that_replaces_a_number_of_a_part_of_a_case_warns() -> None:
    base = replace(scenario(), spread={"robot.mass": pm.Uniform(28.0, 32.0)})
    with pytest.warns(UserWarning, match=r"grid or cases set robot\.mass"):
        change_scenario(base, {"robot": evolved(ROBOT, mass=40.0)})


@pytest.fixture
def copy(done: pm.Sweep, tmp_path: Path) -> Path:
    return Path(shutil.copytree(done.path, tmp_path / "store"))


@pytest.mark.parametrize(
    ("changes", "read", "value"),
    [
        ({"robot.mass": 20}, lambda s: s.robot.mass, 20),
        ({"plant.com.y": 0.1}, lambda s: s.robot.com[1], 0.1),
        ({"controller.robot.mass": 25}, lambda s: (s.controller.robot.mass, s.robot.mass), (25, 30)),
        ({"controller.kp.y": 9}, lambda s: s.controller.kp.tolist(), [4, 9, 4]),
        (
            {"controller.kp": 9, "controller": pm.PD(1, 2)},
            lambda s: (s.controller.kp, s.controller.kd),
            (9, 2),
        ),
        ({"trajectory.path.duration": 3.0}, lambda s: s.t[-1], 3.0),
        ({"forces.push": PUSH}, lambda s: s.forces, {"push": PUSH}),
        ({"forces": [PUSH], "forces.0.force.y": 3}, lambda s: s.forces[0].force.tolist(), [10, 3, 0]),
        ({"integrator": pm.rk4, "substeps": 2}, lambda s: (s.integrator, s.substeps), (pm.rk4, 2)),
        ({"dt": 0.05, "seed": 3}, lambda s: (s.dt, s.seed, s.grid[1]), (0.05, 3, 0.1)),
        ({"spread.mass": pm.Uniform(1, 2)}, lambda s: (*s.spread,), ("start.x", "mass")),
        ({"start.y": 0.5}, lambda s: float(s.spread["start.y"]), 0.5),
    ],
)
def test_a_path_changes_what_it_names_and_nothing_else(changes: Any, read: Any, value: Any) -> None:
    base = scenario()
    assert read(change_scenario(base, changes)) == value
    assert read(change_scenario(base, dict(reversed(changes.items())))) == value
    assert change_scenario(base, {}).spread == base.spread


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"grid": {"mass": 4}}, "mass is 4, expected different finite numbers or texts"),
        ({"grid": {"controller": [pm.PD(1, 1)]}}, "or a mapping of them"),
        ({"grid": {"mass": [4, -1]}}, r"mass is -1.* kg, expected > 0 \(at mass = -1\)"),
        ({"grid": {"time": [4]}}, "grid has 'time', which is also a name in the store"),
        ({"grid": {"n": [4, 5]}}, "n is 4 at n = 4 and 5 at n = 5, expected the same"),
        ({"grid": {"duration": [3.0, 6.0]}}, "time of the bands is every 0.1 s, 31 times at duration = 3 s"),
        (
            {"grid": {"controller.kp": [1.0, 2.0]}, "cases": {"stiff": {"controller.kp": 3.0}}},
            "grid and cases change 'controller.kp' twice, expected",
        ),
        (
            {"grid": {"mass": range(1, 1001), "kp": range(1, 1001)}},
            "number of points of grid and cases is 1000000, expected <= ",
        ),
        ({"client": "tcp://"}, "client is 'tcp://', expected a distributed.Client"),
        (
            {"grid": {"mass": [1, 2]}, "cases": {"spread": {"spread.mass": pm.Uniform(1, 2)}}},
            "grid or cases have 'plant.mass', which the spread replaces for each robot",
        ),
    ],
)
def test_wrong_arguments(tmp_path: Path, options: Any, text: str) -> None:
    with refused(text):
        pm.sweep(scenario(), tmp_path / "store", **options)
    assert not (tmp_path / "store").exists()


def test_wrong_scenarios_paths_and_stores(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    untyped: Any = 3
    with refused("scenario is 3, expected a Scenario"):
        pm.sweep(untyped, tmp_path / "store")
    with pytest.raises(UnknownName, match="unknown parameter in grid or cases 'masss', did you mean 'mass'"):
        pm.sweep(scenario(), tmp_path / "store", grid={"masss": [1]})
    with refused(r"which cannot be written: there is no folder '.*file'"):
        pm.sweep(scenario(), tmp_path / "file" / "store")
    with refused("which is not the store of a sweep"):
        pm.Sweep.open(tmp_path / "store")


def test_the_store_has_named_dimensions_and_units(done: pm.Sweep) -> None:
    xarray = pytest.importorskip("xarray")
    data = xarray.open_zarr(done.path)
    assert dict(data.sizes) == {
        **{"controller.kp": 2, "spread.mass": 2, "robot": 200, "coordinate": 3, "input": 3, "chunk": 4},
        **{"time": 61, "channel": 2, "bin": 2690, "level": 3},
    }
    assert data.max_error.dims == ("controller.kp", "spread.mass", "robot", "coordinate")
    assert data["controller.kp"].attrs["units"] == "1/s^2"
    assert data.drawn_mass.attrs["units"] == "kg"
    assert list(data.coordinate.values) == ["x", "y", "psi"]
    assert list(data.input.values) == ["Fx", "Fy", "Mz"]
    np.testing.assert_array_equal(data.bin.values, edges()[:-1])  # of each the lower one
    named = {name for name, variable in data.variables.items() if "units" in variable.attrs}
    assert named == set(data.variables) - {"spread.mass"}, "labels have no unit"
    assert all("long_name" in variable.attrs for variable in data.variables.values())
    assert all(isinstance(value, str | float) for value in data.attrs.values()), "what other formats hold"
    assert json.loads(data.attrs["pinmobile_sweep"])["chunk"] == CHUNK
    assert (data.counts.sum(["chunk", "bin"]) == 200).all()
    mine = {str(name) for name in (*data.variables, *data.dims)} - set(done.axes)
    assert {name for name in mine if not name.startswith("drawn_")} <= _NAMES


def test_a_sweep_has_the_ensembles_bit_for_bit(done: pm.Sweep, tmp_path: Path) -> None:
    mine = done.ensemble(**{"controller.kp": 16, "spread.mass": 0.2})
    alone = run_scenario(points().scenarios[3])
    for name in ("max_error", "rms_error", "max_distance", "max_input", "diverged_at", "counts"):
        np.testing.assert_array_equal(getattr(mine, name), getattr(alone, name))
    for name, values in alone.draws.items():
        np.testing.assert_array_equal(mine.draws[name], values)
    at: Any = {"controller.kp": 16, "spread.mass": 0.2}
    for channel in ("distance", "heading"):
        there = done.dataset.quantiles.sel(at | {"channel": channel}).values
        np.testing.assert_array_equal(there, getattr(alone.bands(), channel))
    for share in (0.01, 0.07, 0.9, 1):
        assert float(done.error_quantile(share).sel(at)) == alone.error_quantile(share).distance
    other = swept(tmp_path / "store", chunk=None)
    for name, values in done.dataset.data_vars.items():
        one, two = (data.sum("chunk") if name == "counts" else data for data in (values, other.dataset[name]))
        np.testing.assert_array_equal(one.values, two.values)


def test_cases_and_parts_are_compared_by_label(tmp_path: Path) -> None:
    laws = {"PD": pm.PD((20, 20, 1), (20, 20, 1)), "wild": pm.PD(0, 30_000)}
    cases = {"nominal": {}, "push": {"forces.push": PUSH, "robot.mass": 35.0}}
    found = pm.sweep(scenario(n=3, limit=5.0), tmp_path / "store", grid={"controller": laws}, cases=cases)
    assert {name: axis.values for name, axis in found.axes.items()} == {
        "controller": ("PD", "wild"),
        "case": ("nominal", "push"),
    }
    words = r"with case = push, PD stays within .* in 99 % of runs, wild diverges in all runs"
    assert re.fullmatch(words, found.answer())
    assert pm.Sweep.open(found.path).answer() == found.answer()
    assert np.isinf(found.error_quantile().sel(controller="wild")).all()
    pushed = replace(scenario(n=3, limit=5.0), controller=laws["PD"], forces={"push": PUSH}, robot=_heavy())
    mine, alone = found.ensemble(controller="PD", case="push"), run_scenario(pushed)
    np.testing.assert_array_equal(mine.max_error, alone.max_error)
    rows = [line.split() for line in found.table(most=3).splitlines()]
    assert rows[0] == ["controller", "case", "99", "%", "within", "diverged"]
    assert rows[3:] == [["wild", "nominal", "unbounded", "3"], ["...", "and", "1", "more"]]
    alone_ = pm.sweep(scenario(n=3), tmp_path / "alone")
    assert re.fullmatch(r"the robots stay within .* in 99 % of runs", alone_.answer())
    assert len(alone_.ensemble().max_distance) == 3


def test_a_sweep_has_metrics_of_the_user_and_knows_their_code(tmp_path: Path) -> None:
    def gap(sample: Any) -> Any:
        return 3.0 - sample.q[0]

    metric = Metric("gap", "m", "distance", "smallest", gap)
    base = replace(scenario(n=3), metrics=[metric])
    found = pm.sweep(base, tmp_path / "store", grid={"kp": [60.0, 120.0]})
    alone = found.ensemble(kp=60.0)
    assert found.error_quantile(1.0, by="gap").values[0] == alone.largest("gap").min()
    np.testing.assert_array_equal(found.dataset.rms_metric.sel(metric="gap", kp=60.0), alone.rms("gap"))
    other = replace(base, metrics=[metric._replace(function=lambda sample: 4.0 - sample.q[0])])
    with refused("metrics"):
        pm.sweep(other, found.path, grid={"kp": [60.0, 120.0]})
    with refused(r"keep is \['disturbance'\], expected none"):
        pm.sweep(replace(base, keep=["disturbance"]), tmp_path / "other")


def _heavy() -> pm.MobileRobot:
    return change_scenario(scenario(), {"robot.mass": 35.0}).robot  # type: ignore[no-any-return]


def judged(axes: dict[str, Any], within: Any, diverged: Any = 0, n: int = 20) -> pm.Sweep:
    """Return a sweep in which 90 % of the robots stay within these distances."""
    xarray = pytest.importorskip("xarray")
    sizes = np.repeat(np.array(within, float)[..., None], n, axis=-1)
    lost = np.isinf(sizes) & (np.arange(n) < np.broadcast_to(diverged, sizes.shape[:-1])[..., None])
    sizes[np.isinf(sizes)] = 0.0
    data = xarray.Dataset(
        {
            "max_distance": ((*axes, "robot"), np.where(lost, NAN, sizes)),
            "diverged_at": ((*axes, "robot"), np.where(lost, 1.0, NAN)),
        }
    )
    return pm.Sweep(Path(), {name: Axis(*one) for name, one in axes.items()}, data)


RIVALS = {"controller": (("PD", "wild"),), "error": ((0.1, 0.2, 0.4),)}


@pytest.mark.parametrize(
    ("axes", "within", "diverged", "text"),
    [
        ({"kp": ((4, 9),)}, [1, INF], [0, 10], "with kp = 9, the robots diverge in 50 % of runs"),
        ({"e": ((1, 2),), "kp": ((4,), "1/s^2")}, [[1], [2]], 0, "with e = 2, the robots stay within 2 m"),
        (
            RIVALS,  # a rival that diverges everywhere leaves it to the other where the worst happens
            [[0.001, 0.004, 0.002], [INF, INF, INF]],
            [[0, 0, 0], [20, 20, 20]],
            "with error = 0.2, PD stays within 4 mm in 90 % of runs, wild diverges in all runs",
        ),
        (
            RIVALS,  # where all diverge, it is where more robots do
            [[INF, INF, INF], [INF, INF, INF]],
            [[5, 5, 7], [20, 20, 20]],
            "with error = 0.4, PD diverges in 35 % of runs, wild diverges in all runs",
        ),
        (
            RIVALS,  # rounding does not choose
            [[0.001, 0.002, 0.002 * (1 + 1e-15)], [0.001, 0.001, 0.001]],
            0,
            "with error = 0.2, PD stays within 2 mm in 90 % of runs, wild within 1 mm",
        ),
        (
            RIVALS,
            [[1, NAN, 2], [INF, INF, NAN]],
            [[0, 0, 0], [20, 20, 0]],
            "error = 0.1, PD stays within 1 m",
        ),
    ],
)
def test_the_answer_is_the_worst_case(axes: Any, within: Any, diverged: Any, text: str) -> None:
    found = judged(axes, within, diverged)
    assert text in found.answer(0.9)
    turned = judged(dict(reversed(axes.items())), np.transpose(within), np.transpose(diverged))
    assert len(axes) == 1 or text in turned.answer(0.9)


@pytest.mark.long
@pytest.mark.once
def test_a_killed_sweep_resumes_and_ends_with_the_same_store(done: pm.Sweep, tmp_path: Path) -> None:
    store = tmp_path / "store"
    words = [sys.executable, "-m", "tests.sweeping", str(store), "264"]
    assert subprocess.run(words, cwd=ROOT, check=False, timeout=100).returncode == -signal.SIGKILL
    (store / ".writing").write_bytes(b"half")  # as of a process that dies while it writes a file
    heard: list[int] = []
    swept(store, chunk=None, progress=lambda now, total: heard.append(now))
    assert (heard[0], heard[-1]) == (264, 800)
    assert contents(store) == contents(done.path)


def test_a_sweep_on_its_way_says_how_much_is_done(done: pm.Sweep, tmp_path: Path) -> None:
    with pytest.raises(Stop):
        swept(tmp_path / "store", chunk=200, progress=stop_at(400))
    found = pm.Sweep.open(tmp_path / "store", scenario(), grid=GRID)
    assert found.answer().startswith("50 % of the robots are done: with ")
    assert str(found).count("unknown") == 4
    missing = next(at for at in np.ndindex(2, 2) if np.isnan(found.error_quantile().values[at]))
    labels: Any = {name: axis.values[i] for (name, axis), i in zip(found.axes.items(), missing, strict=True)}
    with refused("where robots are missing: start the same sweep again"):
        found.ensemble(**labels)
    heard: list[Any] = []
    before = contents(done.path)
    swept(done.path, progress=lambda *now: heard.append(now))
    assert heard == [(800, 800)]
    assert contents(done.path) == before


@pytest.mark.parametrize(
    ("file", "robots"),
    [("max_error/c/1/0/2/0", 736), ("counts/c/0/0/0/0/0/0", 736), ("controller.kp/c/0", 800)],
)
def test_a_file_that_is_gone_is_computed_again(done: pm.Sweep, copy: Path, file: str, robots: int) -> None:
    (copy / file).unlink()
    if file.endswith("kp/c/0"):
        with refused(rf"in which '.*{file}' is missing; start the same sweep again"):
            pm.Sweep.open(copy)
    heard: list[int] = []
    swept(copy, progress=lambda now, total: heard.append(now))
    assert (heard[0], heard[-1]) == (robots, 800)
    assert contents(copy) == contents(done.path)


@pytest.mark.parametrize(
    ("base", "grid", "text"),
    [
        ({}, {**GRID, "controller.kp": [4, 25]}, r"axis controller\.kp is \[4, 16\] there and \[4, 25\]"),
        ({"seed": 2}, GRID, "seed is 1 there and 2 here"),
    ],
)
def test_a_store_of_another_sweep_is_refused(done: pm.Sweep, base: Any, grid: Any, text: str) -> None:
    with refused(f"which belongs to another sweep: .*{text}"):
        pm.sweep(scenario(**base), done.path, grid=grid)
    with refused(f"scenario does not match .*{text}"):
        pm.Sweep.open(done.path, scenario(**base), grid=grid)


def test_wrong_labels(done: pm.Sweep) -> None:
    at: Any = {"controller.kp": 4, "spread.mass": 0.1}
    with refused("chunk is 100, expected 64 as in the store, or None"):
        swept(done.path, chunk=100)
    with pytest.raises(UnknownName, match=r"unknown axis 'controller\.kd', did you mean 'controller\.kp'"):
        done.ensemble(**{"controller.kd": 4})
    with refused(r"spread\.mass is None, expected one of 0\.1, 0\.2"):
        done.ensemble(**{"controller.kp": 4})
    with refused(r"controller\.kp is 5, expected one of 4, 16"):
        done.ensemble(**at | {"controller.kp": 5})
    with refused(r"scenario is None, expected Sweep\.open"):
        pm.Sweep.open(done.path).ensemble(**at)
    with refused(r"share is 2\.0, expected 0 <= share <= 1"):
        done.error_quantile(2)


def test_a_missing_package_names_the_extra(done: pm.Sweep) -> None:
    code = "import sys; sys.modules['zarr'] = None; from pinmobile import Sweep; Sweep.open(sys.argv[1])"
    words = [sys.executable, "-c", code, str(done.path)]
    ended = subprocess.run(words, capture_output=True, text=True, check=False, timeout=100)
    assert "a sweep needs zarr, which is not installed: pip install dask" in ended.stderr


def test_a_robot_may_be_an_axis(tmp_path: Path) -> None:
    robots = {"light": ROBOT, "heavy": _heavy()}
    law = pm.ComputedTorque(ROBOT, 4, 4)
    spread = {"start.x": pm.Normal(0, 0.01)}
    found = pm.sweep(scenario(n=2, spread=spread, controller=law), tmp_path / "s", grid={"robot": robots})
    assert list(found.axes) == ["plant"]
    assert found.ensemble(robot="heavy").scenario.robot.mass == 35.0
    assert Points.of(scenario(n=2), {"robot": robots}).shape == (2,)


# -- what tells one sweep from another -------------------------------------------------------------


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
    "a static method": lambda k: type("Mine", (Held,), {"f": staticmethod(partial(push, k))})(3.0),
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
    code = "from tests.test_sweeps import *; print(json.dumps(accounts()))"
    own = "1" if os.environ.get("PYTHONHASHSEED") != "1" else "2"
    environment = {"PYTHONHASHSEED": own, "PYTHONPATH": ":".join(sys.path)}
    words = [sys.executable, "-c", code]
    told = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True, env=environment).stdout
    accounts()  # what was looked at before changes nothing
    assert json.loads(told) == accounts()


def accounts() -> list[Any]:
    return [describe(points()), *(account(make(3.0)) for make in DIFFERENT.values())]
