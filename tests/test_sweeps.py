"""Grids, the store and what it says, and a sweep that dies in this machine's own processes."""

import json
import math
import platform
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import pinmobile
from pinmobile import (
    PD,
    Axis,
    Circle,
    ConstantForce,
    InvalidArgument,
    MobileRobot,
    NoiseForce,
    NoisyMeasurement,
    Reference,
    Same,
    Sweep,
    Tangent,
    Uniform,
    UnknownName,
    grid,
    law,
    rk4,
    sweep,
)
from pinmobile.loop import run_scenario
from pinmobile.loop._counts import edges
from pinmobile.loop._variables import PER_ROBOT
from pinmobile.sweeps import length
from pinmobile.sweeps.contents import answer, attributes_of, compared, table
from pinmobile.sweeps.fingerprint import determined_by, differences
from pinmobile.sweeps.grids import RESERVED, as_grid, axis_of_rivals, placed
from pinmobile.sweeps.store import Store
from tests.sweeping import CHUNK, contents, gains_and_errors, scenario

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Sweep:
    return sweep(gains_and_errors(), tmp_path_factory.mktemp("sweep") / "store", chunk=CHUNK)


def test_the_store_has_named_dimensions_and_units(done: Sweep) -> None:
    xarray = pytest.importorskip("xarray")
    data = xarray.open_zarr(done.path)
    assert dict(data.sizes) == {
        **{"gain": 2, "error": 2, "robot": 200, "coordinate": 3, "input": 3},
        **{"time": 61, "channel": 2, "bin": 1410, "level": 3},
    }
    assert data.max_error.dims == ("gain", "error", "robot", "coordinate")
    assert data.gain.attrs["units"] == "1/s^2"
    assert data.drawn_mass.attrs["units"] == "kg"
    assert list(data.coordinate.values) == ["x", "y", "psi"]
    assert list(data.input.values) == ["Fx", "Fy", "Mz"]
    assert data.max_force.dims == ("gain", "error", "robot", "input")
    np.testing.assert_array_equal(data.bin.values, edges()[:-1])  # of each the lower one
    named = {name for name, variable in data.variables.items() if "units" in variable.attrs}
    assert named == set(data.variables) - {"error"}, "a plain list has no unit that anybody named"
    assert all("long_name" in variable.attrs for variable in data.variables.values())
    assert all(isinstance(value, str | float) for value in data.attrs.values()), "what other formats hold"
    assert json.loads(data.attrs["pinmobile_sweep"])["chunk"] == CHUNK
    assert (data.counts.sum("bin") == 200).all()


def test_a_sweep_holds_the_ensembles_bit_for_bit(done: Sweep) -> None:
    mine, alone = done.ensemble(gain=16, error=0.2), run_scenario(scenario(16, 0.2))
    for name in ("max_error", "rms_error", "max_distance", "max_force", "diverged_at", "counts"):
        np.testing.assert_array_equal(getattr(mine, name), getattr(alone, name))
    for name, values in alone.draws.items():
        np.testing.assert_array_equal(mine.draws[name], values)
    for channel in ("distance", "heading"):
        there = done.dataset.quantiles.sel(gain=16, error=0.2, channel=channel).values
        np.testing.assert_array_equal(there, getattr(alone.bands(), channel))
    assert float(done.within(0.9).sel(gain=16, error=0.2)) == alone.within(0.9).distance


def test_a_diverged_robot_is_within_nothing(tmp_path: Path) -> None:
    wild = replace(scenario(), controller=PD(-3000, 0), limit=0.5)
    found = sweep({"tame": scenario(), "wild": wild}, tmp_path / "store")
    assert np.isinf(found.within().sel(scenario="wild"))
    assert np.isfinite(found.within().sel(scenario="tame"))
    assert found.answer().startswith("tame stays within ")
    assert found.answer().endswith("in 99 % of runs, wild diverges in all runs")
    assert found.answer(1).endswith("in 100 % of runs, wild diverges in all runs")
    alone = sweep(wild, tmp_path / "alone")
    assert alone.answer() == "the robots diverge in all runs"
    assert Sweep.open(alone.path, wild).ensemble(scenario=0).diverged.all()
    assert np.isnan(found.ensemble(scenario="tame").diverged_at).all()
    np.testing.assert_array_equal(found.ensemble(scenario="wild").diverged_at, run_scenario(wild).diverged_at)


@pytest.mark.parametrize(
    ("within", "text"),
    [
        ([1.0, np.inf, 2.0], "with gain = 9, the robots diverge in 50 % of runs"),
        ([1.0, np.nan, 2.0], "with gain = 16, the robots stay within 2 m in 90 % of runs"),
        ([1.0, np.nan, np.inf], "with gain = 16, the robots diverge in 75 % of runs"),
    ],
)
def test_the_answer_is_that_of_the_worst_that_is_known(within: list[float], text: str) -> None:
    diverged = np.array([0, 10, 15])
    assert answer({"gain": Axis([4, 9, 16])}, np.array(within), diverged, 20, 0.9) == text


INF, NAN = math.inf, math.nan


@pytest.mark.parametrize(
    ("within", "diverged", "text"),
    [
        # A rival that diverges everywhere leaves it to the other where the worst happens.
        (
            [[0.001, 0.004, 0.002], [INF, INF, INF]],
            [[0, 0, 0], [20, 20, 20]],
            "with error = 0.2, PD stays within 4 mm in 90 % of runs, wild diverges in all runs",
        ),
        # Where all diverge, it is where more robots do.
        (
            [[INF, INF, INF], [INF, INF, INF]],
            [[5, 5, 7], [20, 20, 20]],
            "with error = 0.4, PD diverges in 35 % of runs, wild diverges in all runs",
        ),
        (
            [[0.1, INF, 0.2], [INF, INF, INF]],
            [[0, 5, 0], [20, 20, 20]],
            "with error = 0.2, PD diverges in 25 % of runs, wild diverges in all runs",
        ),
        # What is not known is never the worst.
        (
            [[NAN, 0.001, 0.002], [INF, INF, NAN]],
            [[0, 0, 0], [20, 20, 0]],
            "with error = 0.2, PD stays within 1 mm in 90 % of runs, wild diverges in all runs",
        ),
        # Nor does rounding choose.
        (
            [[0.001, 0.002, 0.002 * (1 + 1e-15)], [0.001, 0.001, 0.001]],
            [[0, 0, 0], [0, 0, 0]],
            "with error = 0.2, PD stays within 2 mm in 90 % of runs, wild within 1 mm",
        ),
    ],
)
def test_the_worst_is_told_among_rivals(within: Any, diverged: Any, text: str) -> None:
    axes = {"controller": Axis(["PD", "wild"]), "error": Axis([0.1, 0.2, 0.4])}
    known, lost = np.array(within), np.array(diverged)
    assert answer(axes, known, lost, 20, 0.9, beside="controller") == text
    turned = dict(reversed(axes.items()))
    assert answer(turned, known.T, lost.T, 20, 0.9, beside="controller") == text


def test_where_all_diverge_the_worst_is_where_most_do() -> None:
    axes = {"gain": Axis([4, 9, 16])}
    found = answer(axes, np.full(3, INF), np.array([10, 19, 19]), 20, 0.9)
    assert found == "with gain = 9, the robots diverge in 95 % of runs"


def test_the_unit_of_what_has_no_dimension_is_not_printed() -> None:
    axes = {"error": Axis([0.1, 0.2], "1"), "gain": Axis([4, 9], "1/s^2")}
    within, lost = np.array([[0.1, 0.2], [0.3, 0.4]]), np.zeros((2, 2), int)
    assert answer(axes, within, lost, 20, 0.9).startswith("with error = 0.2 and gain = 9 1/s^2, the robots")
    assert table(axes, within, lost, 0.9).splitlines()[0].split()[:3] == ["error", "gain", "[1/s^2]"]
    assert placed(axes, (0, 1)) == "error = 0.1, gain = 9 1/s^2"


def test_a_share_of_whole_robots_is_that_many(tmp_path: Path) -> None:
    found = sweep(replace(scenario(), n=100), tmp_path / "store")
    sizes = np.sort(found.dataset.max_distance.values.ravel())
    assert [float(found.within(k / 100)[0]) for k in range(1, 101)] == sizes.tolist()


def test_a_table_says_how_many_rows_it_leaves_out() -> None:
    axes, within = {"gain": Axis([4, 9, 16], "1/s^2")}, np.array([1.0, np.inf, np.nan])
    rows = [table(axes, within, np.array([0, 5, 0]), 0.9, most).splitlines() for most in (1, 2, 3)]
    assert [lines[-1].split() for lines in rows] == [
        ["...", "and", "2", "more"],
        ["...", "and", "1", "more"],
        ["16", "unknown", "unknown"],
    ]
    assert [line.split() for line in rows[2][1:3]] == [["4", "1", "m", "0"], ["9", "unbounded", "5"]]


def test_a_sweep_says_who_stays_within_what(done: Sweep) -> None:
    rows = str(done).splitlines()
    assert rows[0].split() == ["gain", "[1/s^2]", "error", "99", "%", "within", "diverged"]
    assert len(rows) == 6
    assert rows[-1] == done.answer()
    assert rows[-1].startswith("with gain = ")
    lengths = [length(x) for x in (2.5, 0.012, 3e-5, 1e-9, math.inf)]
    assert lengths == [
        "2.5 m",
        "12 mm",
        "30 µm",
        "1 nm",
        "unbounded",
    ]
    for exact, text in ((1.0, "1 m"), (1e-3, "1 mm"), (1e-6, "1 µm")):
        assert [length(exact * (1 + off)) for off in (0, 1e-15, -1e-15, -1e-9)] == [text] * 4


@pytest.mark.parametrize("called", ["controller", "law"])
@pytest.mark.parametrize("first", [True, False])
def test_controllers_are_compared_wherever_their_axis_stands(
    tmp_path: Path, called: str, first: bool
) -> None:
    rivals: Any = {called: {"soft": PD((20, 20, 1), (20, 20, 1)), "stiff": PD((60, 60, 3), (60, 60, 3))}}
    paths: Any = {"path": {"near": Tangent(Circle(1, 0.1, 2)), "far": Tangent(Circle(3, 0.1, 2))}}

    def make(path: Any, **chosen: Any) -> Any:
        return replace(scenario(n=3), controller=chosen[called], trajectory=path)

    found = sweep(grid(make, **(rivals | paths if first else paths | rivals)), tmp_path / "store")
    assert re.fullmatch(r"with path = far, soft stays within .*, stiff within .*", found.answer())
    assert Sweep.open(tmp_path / "store").answer() == found.answer()


def test_an_axis_called_controller_or_else_the_last_of_names_is_compared() -> None:
    names, numbers = Axis(["a", "b"]), Axis([1, 2])
    assert axis_of_rivals({"controller": names, "path": names, "gain": numbers}) == "controller"
    assert axis_of_rivals({"model": names, "path": names, "gain": numbers}) == "path"
    assert axis_of_rivals({"controller": Axis(["a"]), "gain": numbers}) is None


def test_the_share_that_diverges_is_told_and_of_one_robot_no_share() -> None:
    axes, far = {"gain": Axis([1, 2])}, np.array([0.1, np.inf])
    wild = np.array([0, 19_285])
    assert answer(axes, far, wild, 20_000, 0.99) == "with gain = 2, the robots diverge in 96 % of runs"
    assert answer(axes, far, wild, 19_286, 0.99).endswith("diverge in more than 99 % of runs")
    assert answer(axes, far, wild, 19_285, 0.99).endswith("diverge in all runs")
    calm = np.zeros(2, int)
    assert answer(axes, far[:1].repeat(2), calm, 1, 0.99) == "with gain = 1, the robot stays within 100 mm"
    assert answer(axes, far, np.array([0, 1]), 1, 0.99) == "with gain = 2, the robot diverges"
    assert compared({"PD": 0.1, "wild": np.inf}, 0.99, {"PD": 0, "wild": 1}, 1) == (
        "PD stays within 100 mm, wild diverges"
    )


def test_a_chunk_is_another_division_of_the_same_numbers(done: Sweep, tmp_path: Path) -> None:
    other = sweep(gains_and_errors(), tmp_path / "store")
    for name, values in done.dataset.data_vars.items():
        np.testing.assert_array_equal(other.dataset[name].values, values.values)


@pytest.mark.parametrize("robots", [0, 264, 800])
@pytest.mark.once
def test_a_killed_sweep_goes_on_and_ends_with_the_same_store(
    done: Sweep, tmp_path: Path, robots: int
) -> None:
    store = tmp_path / "store"
    words = [sys.executable, "-m", "tests.sweeping", str(store), str(robots)]
    killed = subprocess.run(words, cwd=ROOT, check=False, timeout=100)
    assert killed.returncode == -signal.SIGKILL
    assert contents(store) != contents(done.path)
    (store / ".progress" / "writing").write_bytes(b"half")  # as of a process that dies while it writes a file
    heard: list[int] = []
    sweep(gains_and_errors(), store, progress=lambda now, total: heard.append(now))
    assert heard[0] == robots
    assert heard[-1] == 800
    assert contents(store) == contents(done.path)


def test_a_sweep_on_its_way_says_how_much_is_done(tmp_path: Path) -> None:
    class Stop(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done == 400:
            raise Stop

    with pytest.raises(Stop):
        sweep([scenario(error=e) for e in (0, 0.2, 0.3)], tmp_path / "store", chunk=200, progress=stop)
    found = Sweep.open(tmp_path / "store")
    assert found.answer().startswith("66.7 % of the robots are done: with scenario = ")
    assert str(found).count("unknown") == 2


def test_a_sweep_that_is_done_is_not_done_again(done: Sweep) -> None:
    before, heard = contents(done.path), []
    sweep(gains_and_errors(), done.path, progress=lambda *now: heard.append(now))
    assert heard == [(800, 800)]
    assert contents(done.path) == before


def test_a_sweep_killed_while_it_tidies_up_is_done(done: Sweep, tmp_path: Path) -> None:
    found = sweep(gains_and_errors(), tmp_path / "store", chunk=CHUNK)
    (found.path / ".progress").mkdir()
    (found.path / ".progress" / "3-128.npz").write_bytes(b"")
    (found.path / ".progress" / "lock").write_bytes(b"")
    sweep(gains_and_errors(), found.path)
    assert contents(found.path) == contents(done.path)


@pytest.mark.parametrize(
    ("file", "robots"),
    [
        ("max_error/c/1/0/2/0", 600),
        ("diverged_at/c/0/1/0", 600),
        ("drawn_mass/c/1/1/3", 600),
        ("counts/c/0/0/0/0/0", 600),
        ("quantiles/c/1/1/0/0/0", 600),
        ("gain/c/0", 800),
    ],
)
def test_what_is_gone_from_a_store_is_computed_again(
    done: Sweep, tmp_path: Path, file: str, robots: int
) -> None:
    shutil.copytree(done.path, tmp_path / "store")
    (tmp_path / "store" / file).unlink()
    heard: list[int] = []
    sweep(gains_and_errors(), tmp_path / "store", progress=lambda now, total: heard.append(now))
    assert heard[0] == robots
    assert heard[-1] == 800
    assert contents(tmp_path / "store") == contents(done.path)


def test_a_mended_store_that_is_killed_goes_on(done: Sweep, tmp_path: Path) -> None:
    class Stop(Exception):
        pass

    def stop(now: int, total: int) -> None:
        if now > 600:
            raise Stop

    shutil.copytree(done.path, tmp_path / "store")
    (tmp_path / "store/max_force/c/1/0/2/0").unlink()
    with pytest.raises(Stop):
        sweep(gains_and_errors(), tmp_path / "store", progress=stop)
    for chunk in range(3):
        (tmp_path / f"store/max_force/c/1/0/{chunk}/0").unlink(missing_ok=True)  # one of them counts as done
    sweep(gains_and_errors(), tmp_path / "store")
    assert contents(tmp_path / "store") == contents(done.path)


@pytest.mark.parametrize(
    "damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b[:-9] + bytes([b[-9] ^ 1]) + b[-8:]]
)
@pytest.mark.parametrize("file", ["max_distance/c/1/0/2", "counts/c/1/0/0/0/0"])
def test_a_file_that_cannot_be_read_is_named(
    done: Sweep, tmp_path: Path, file: str, damage: Callable[[bytes], bytes]
) -> None:
    shutil.copytree(done.path, tmp_path / "store")
    path = tmp_path / "store" / file
    path.write_bytes(damage(path.read_bytes()))
    found = Sweep.open(tmp_path / "store", gains_and_errors())
    with pytest.raises(InvalidArgument, match=rf"of which '.*{file}' cannot be read: .*; remove that file"):
        found.ensemble(gain=16, error=0)
    path.unlink()
    sweep(gains_and_errors(), tmp_path / "store")
    assert contents(tmp_path / "store") == contents(done.path)


def test_a_coordinate_that_cannot_be_read_is_named(done: Sweep, tmp_path: Path) -> None:
    shutil.copytree(done.path, tmp_path / "store")
    (tmp_path / "store/time/c/0").write_bytes(b"")
    with pytest.raises(InvalidArgument, match=r"of which '.*time/c/0' cannot be read: "):
        Sweep.open(tmp_path / "store")


def test_a_mark_of_what_is_done_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    run = gains_and_errors()
    with Store(tmp_path / "store", run, determined_by(run), 200) as store:
        for job in store.jobs():
            (store.path / store._marker(job)).write_bytes(b"")
        with pytest.raises(
            InvalidArgument,
            match=r"store is '.*0-0\.npz', which is no record .*; remove that file, and start",
        ):
            store.finish()


def test_what_determines_the_numbers_is_told_the_same_way_in_every_process(done: Sweep) -> None:
    code = "from tests.sweeping import *; from pinmobile.sweeps.fingerprint import determined_by as d; "
    code += "import json; print(json.dumps(d(gains_and_errors())))"
    words = [sys.executable, "-c", code]
    other = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True, timeout=100).stdout
    assert json.loads(other) == json.loads(json.dumps(determined_by(gains_and_errors())))


@pytest.mark.parametrize(
    ("scenarios", "text"),
    [
        (
            lambda: grid(scenario, gain=Axis([4, 25], "1/s^2"), error=[0, 0.2]),
            r"axis gain is \[4, 16\] there and \[4, 25\] here",
        ),
        (lambda: _grid(n=100), "n is 200 there and 100 here"),
        (lambda: _grid(seed=2), "seed is 1 there and 2 here"),
        (lambda: _grid(dt=0.05, every=2), "dt is 0.1 there and 0.05 here"),
        (
            lambda: _grid(trajectory=Tangent(Circle(2, 0.1, 6.0))),
            r"sweep: trajectory\.path\.radius is 3\.0 there and 2\.0 here$",
        ),
    ],
)
def test_a_store_of_another_sweep_is_refused(done: Sweep, scenarios: Callable[[], Any], text: str) -> None:
    with pytest.raises(InvalidArgument, match=f"which belongs to .*{text}"):
        sweep(scenarios(), done.path)
    with pytest.raises(InvalidArgument, match="scenarios are not those of"):
        Sweep.open(done.path, scenarios())


def _grid(**changed: Any) -> Any:
    def make(gain: float, error: float) -> Any:
        return replace(scenario(gain, error), **changed)

    return grid(make, gain=Axis([4, 16], "1/s^2"), error=[0, 0.2])


MASSES = np.linspace(20, 40, 200)


class OwnTrajectory:
    """A trajectory of a user's own: its reference is all that is known of it."""

    duration = 6.0

    def __init__(self, last: float) -> None:
        self.last = last

    def __call__(self, t: Any) -> Reference:
        q, v, a = np.zeros((3, *np.shape(t), 3))
        q[..., 0] = np.where(np.asarray(t) == 6.0, self.last, 0.0)
        return Reference(q, v, a)


def _closed_over(factor: float) -> Any:
    return law(lambda t, q, v, reference: factor * (reference.q - q))


def _by_default(factor: float) -> Any:
    def push(t: float, q: Any, v: Any, reference: Any, factor: float = factor) -> Any:
        return np.asarray(factor * (reference.q - q))

    return law(push)


@pytest.mark.parametrize(
    ("one", "other", "told"),
    [
        ({}, {"limit": 7.0}, "limit is 1000.0 there and 7.0 here"),
        ({}, {"substeps": 2}, "substeps is 1 there and 2 here"),
        ({}, {"integrator": rk4}, "integrator"),
        ({}, {"every": 3}, "every is 1 there and 3 here"),
        ({}, {"after": 2.0}, "after is 0.0 there and 2.0 here"),
        ({}, {"duration": 3.0}, "duration is 6.0 there and 3.0 here"),
        ({}, {"robot": MobileRobot(30, 0.1, com=(0.1, 0))}, "robot.com"),
        ({}, {"forces": (ConstantForce((1, 0, 0)),)}, "forces"),
        ({}, {"spread": {"mass": Uniform(20, 30)}}, "spread['mass'].high is 33.0 there and 30.0 here"),
        ({"spread": {"mass": MASSES}}, {"spread": {"mass": [*MASSES[:-1], 41]}}, "spread['mass'] is float64"),
        (
            {"trajectory": OwnTrajectory(0)},
            {"trajectory": OwnTrajectory(1)},
            "trajectory.reference is float64",
        ),
        ({"controller": _closed_over(1)}, {"controller": _closed_over(2)}, ".factor is 1 there and 2 here"),
        (
            {"controller": _by_default(1)},
            {"controller": _by_default(2)},
            "defaults.tuple is [1] there and [2] here",
        ),
    ],
)
def test_whatever_changes_the_numbers_is_told(one: Any, other: Any, told: str) -> None:
    there, again, here = (determined_by(as_grid(replace(scenario(), **c))) for c in (one, one, other))
    assert there == again
    assert told in differences(there, here, most=30)
    assert there["fingerprint"] != here["fingerprint"]


@pytest.mark.parametrize(
    ("noise", "told"),
    [
        (
            lambda seed: {"controller": NoisyMeasurement(PD(4, 4), 1e-3, 0.0, seed=seed)},
            "controller.seed is 0",
        ),
        (
            lambda seed: {"forces": (NoiseForce((1, 1, 1), 1.0, seed=seed),)},
            "forces[0].phases is float64 (16, 3)",
        ),
    ],
)
def test_the_seed_of_a_noise_is_told(noise: Any, told: str) -> None:
    """Each robot's noise follows from the scenario's seed and its own."""
    one, other = (determined_by(as_grid(replace(scenario(), **noise(seed)))) for seed in (0, 1))
    assert differences(one, other).startswith(told)


def test_no_axis_can_have_the_name_of_anything_in_a_store(done: Sweep) -> None:
    """An array of the store is an axis, is drawn, or has a name that is kept from axes."""
    mine = {str(name) for name in (*done.dataset.variables, *done.dataset.dims)}
    assert {name for name in mine - set(done.axes) if not name.startswith("drawn_")} <= RESERVED
    assert set(PER_ROBOT) <= RESERVED


def test_the_versions_and_the_machine_that_made_the_numbers_are_told(done: Sweep) -> None:
    there = attributes_of(done.path)["determined_by"]
    names = ("pinmobile", "numpy", "scipy", "llvmlite", "pin")
    assert there["versions"] == {name: version(name) for name in names}
    assert there["machine"] == platform.machine()


def _untyped(value: Any) -> Any:
    return value


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda p: sweep([], p), "values is empty, expected at least one"),
        (lambda p: sweep([_untyped(3)], p), "scenarios has a int, expected Scenarios"),
        (
            lambda p: sweep([scenario(), scenario(n=5)], p),
            "n is 200 at scenario = 0 and 5 at scenario = 1, expected",
        ),
        (
            lambda p: sweep([scenario(), replace(scenario(), duration=3.0)], p),
            "times of the bands differ between",
        ),
        (lambda p: sweep([scenario()], p, chunk=0), "chunk is 0, expected a whole number >= 1"),
        (lambda p: sweep([scenario()], p, client="tcp://"), "client is a str, expected a distributed.Client"),
        (lambda p: sweep([scenario()], p, progress=_untyped(3)), "progress is 3, expected a function"),
        (
            lambda p: sweep(
                [replace(scenario(), spread={"start.x": Uniform(-1, 1), "mass": Same("start.x")})], p
            ),
            r"draws \(\d.*%\) are impossible; .* \(at scenario = 0\)",
        ),
        (lambda p: grid(scenario), "axes are none, expected at least one"),
        (lambda p: grid(_untyped(3), gain=[4]), "make is 3, expected a function that returns a Scenario"),
        (lambda p: grid(lambda gain: gain, gain=[4]), "make returned a int, expected a Scenario"),
        (
            lambda p: grid(lambda gain: scenario(gain), q=[1]),
            r"make cannot be called with q: missing a required argument: 'gain'; it takes gain \(at q = 1\)",
        ),
        (
            lambda p: grid(lambda: scenario(), q=[1]),
            r"make cannot be called with q: got an unexpected .* 'q'; it takes nothing \(at q = 1\)",
        ),
        (lambda p: grid(scenario, gain=cast(Any, 4)), "gain: values is 4, expected a sequence"),
        (lambda p: grid(scenario, gain=[4, 4]), r"gain: values is \[4, 4\], expected each one once"),
        (lambda p: grid(scenario, gain=[4, "x"]), "expected all numbers or all text"),
        (lambda p: grid(scenario, gain=[math.nan]), r"gain: values\[0\] is nan, expected a finite number"),
        (lambda p: grid(lambda robot: scenario(), robot=[4]), "axis is called 'robot', expected letters"),
        (lambda p: grid(scenario, n=[4, 0]), r"n is 0, expected a whole number >= 1 \(at n = 0\)"),
        (
            lambda p: grid(pytest.fail, gain=range(1000), error=range(1000)),  # before any is made
            r"axes make 1,000,000 scenarios \(1,000 of gain, 1,000 of error\), expected at most 100,000",
        ),
        (
            lambda p: sweep([scenario()] * 100_001, p),
            "axes make 100,001 scenarios .*, expected at most",
        ),
        (lambda p: Sweep.open(p), "which is not the store of a sweep"),
    ],
)
def test_wrong_arguments(tmp_path: Path, call: Callable[[Path], Any], text: str) -> None:
    with pytest.raises(InvalidArgument, match=text):
        call(tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_what_a_function_of_a_grid_raises_names_the_place() -> None:
    def make(gain: float) -> Any:
        return scenario(1 / gain)

    with pytest.raises(ZeroDivisionError) as caught:
        grid(make, gain=Axis([1, 0], "1/s^2"))
    assert caught.value.__notes__ == ["at gain = 0 1/s^2"]


def test_wrong_stores_and_labels(done: Sweep, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "mine").write_text("")
    with pytest.raises(InvalidArgument, match=r"which cannot be written: there is no folder '.*file'"):
        sweep(gains_and_errors(), tmp_path / "file" / "store")
    with pytest.raises(InvalidArgument, match="which is not the store of a sweep"):
        sweep(gains_and_errors(), tmp_path / "folder")
    with pytest.raises(InvalidArgument, match="chunk is 100, expected 64 as in the store, or None"):
        sweep(gains_and_errors(), done.path, chunk=100)
    with pytest.raises(
        UnknownName, match=r"unknown axis 'gains', did you mean 'gain'[?] available: gain, error"
    ):
        done.ensemble(gains=4)
    with pytest.raises(InvalidArgument, match=r"error is missing, expected one of 0, 0\.2"):
        done.ensemble(gain=4)
    with pytest.raises(InvalidArgument, match="gain is 5, expected one of 4, 16"):
        done.ensemble(gain=5, error=0)
    with pytest.raises(InvalidArgument, match=r"the scenarios are not known, expected Sweep\.open"):
        Sweep.open(done.path).ensemble(gain=4, error=0)
    with pytest.raises(InvalidArgument, match="share is 2, expected a number from 0 to 1"):
        done.within(2)


def test_a_store_is_written_by_one_process_at_a_time_and_read_meanwhile(tmp_path: Path) -> None:
    run = gains_and_errors()
    with Store(tmp_path / "store", run, determined_by(run), CHUNK):
        with pytest.raises(InvalidArgument, match="which another process is writing"):
            sweep(run, tmp_path / "store")
        early = Sweep.open(tmp_path / "store", run)
        assert np.isnan(early.within()).all()
        assert early.table().splitlines()[1].split() == ["4", "0", "unknown", "unknown"]
        assert early.answer() == "0 % of the robots are done, and of no scenario all"
        with pytest.raises(InvalidArgument, match="has no records yet: start the same sweep again"):
            early.ensemble(gain=4, error=0)


@pytest.mark.parametrize("name", ["zarr", "xarray"])
def test_a_missing_package_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InvalidArgument, match=rf"needs {name}, which is not installed: pip install dask"):
        pinmobile.sweep([scenario()], tmp_path / "store")


@pytest.mark.parametrize("name", ["zarr", "xarray"])
def test_a_store_is_not_opened_without_the_packages_of_the_extra(
    done: Sweep, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InvalidArgument, match=rf"needs {name}, which is not installed: pip install dask"):
        Sweep.open(done.path)
