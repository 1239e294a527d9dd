"""Files of ensembles: all comes back bit for bit, without the user's classes; what is damaged is refused."""

import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import pinmobile as pm
from pinmobile import plots
from pinmobile.loop import Engine, Outline, causes, run_scenario, worst_share
from pinmobile.loop._description import ROBOT_ARRAYS
from tests.damage import answer, damaged
from tests.refusals import refused

ROBOT = pm.MobileRobot(10, 1.3, com=(0.1, 0.05)).attach(pm.PayloadBody(2, (0.1, 0, 0.2)))
CIRCLE = pm.Tangent(pm.Circle(3, 0.1, 20))
SPREAD: dict[str, Any] = {
    "mass": pm.Uniform(2, 10),
    "controller.mass": pm.SameAs("mass", stats.norm(1.0, scale=0.1)),
    "com.x": np.linspace(0, 0.1, 60),
    "force.x": pm.Normal(0, 0.04),
    "kp": 4.0,
}


def scenario(**more: Any) -> pm.Scenario:
    loop = {"robot": ROBOT, "controller": pm.ComputedTorque(pm.MobileRobot(30, 1.3)), "trajectory": CIRCLE}
    loop["forces"] = [pm.ConstantForce((0, 0, 0))]
    return pm.Scenario(**{**loop, "n": 60, "spread": SPREAD, "dt": 0.1, "seed": 7, "after": 2.0, **more})


def run(traces: Any = (), **more: Any) -> pm.Ensemble:
    return run_scenario(scenario(**more), traces=traces, engine=Engine.COMPILED)


# A controller that believes in 30 kg where there are 4 to 12, with the load, is beyond what the step allows.
DIVERGING = "some diverge, two traced"
MADE: dict[str, dict[str, Any]] = {
    DIVERGING: {"traces": [17, 3], "spread": SPREAD | {"controller.mass": 30.0}},
    "none diverges, none traced": {},
    "nothing spread, one robot": {"spread": {}, "n": 1, "traces": [0]},
    "on a bare loop": {
        "controller": pm.PD(40, 40),
        "spread": {"mass": pm.Uniform(9, 11)},
        "forces": [pm.ConstantForce((0.1, 0, 0))],
    },
}


@cache
def made(name: str = DIVERGING) -> pm.Ensemble:
    return run(**MADE[name])


SERIES = "t", "q", "v", "a", "u", "error"


def saved(one: pm.Ensemble, tmp_path: Path) -> Path:
    one.save(tmp_path / "saved.npz")
    return tmp_path / "saved.npz"


def bits(one: pm.Ensemble) -> dict[str, Any]:
    """Return all numbers of an ensemble, so that NaN is NaN."""
    arrays = {name: getattr(one, name) for name in (*ROBOT_ARRAYS, "counts")}
    arrays |= {f"drawn {name}": values for name, values in one.draws.items()}
    for i, trace in one.traces.items():
        arrays |= {f"{name} of {i}": getattr(trace, name) for name in SERIES}
    arrays |= {"grid": one.scenario.grid, "t": one.scenario.t}
    arrays |= {f"reference.{name}": part for name, part in one.scenario.reference._asdict().items()}
    return {name: (array.shape, array.dtype.str, array.tobytes()) for name, array in arrays.items()}


@pytest.mark.parametrize("name", MADE)
def test_what_is_loaded_is_what_was_saved_bit_for_bit_and_answers_alike(tmp_path: Path, name: str) -> None:
    one = made(name)
    loaded = pm.Ensemble.load(saved(one, tmp_path))
    assert bits(loaded) == bits(one)
    assert list(bits(loaded)) == list(bits(one))
    assert list(loaded.traces) == list(one.traces)
    for i, trace in one.traces.items():
        assert loaded.traces[i].plant == trace.plant
        assert loaded.member(i) is loaded.traces[i]
    for array in (loaded.max_error, loaded.scenario.t, *loaded.scenario.reference):
        assert not array.flags.writeable
    assert not any(values.flags.writeable for values in loaded.draws.values())
    loaded.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "saved.npz").read_bytes()
    assert len(loaded) == len(one)
    assert repr(loaded) == repr(one)
    assert str(loaded) == f"{one}\n{loaded.scenario}"
    for share in (0.5, 0.99, 1.0):
        assert loaded.error_quantile(share) == one.error_quantile(share)
    mine, theirs = (each.bands((0.1, 0.9)) for each in (loaded, one))
    np.testing.assert_equal(vars(mine), vars(theirs))
    for by in ("distance", "heading"):
        np.testing.assert_array_equal(loaded.worst(9, by), one.worst(9, by))
        np.testing.assert_array_equal(loaded.largest(by), one.largest(by))
    np.testing.assert_array_equal(loaded.diverged, one.diverged)
    drawn = [plots.bands({"it": each}).axes[0].get_title(loc="left") for each in (loaded, one)]
    assert drawn[0] == drawn[1]
    if len(one) > 1:
        found = [causes(each, worst_share(each, 0.1)) for each in (loaded, one)]
        told = [[cause[:2] + cause[3:] for cause in each] for each in found]  # all but the values
        assert told[0] == told[1]
        assert plots.drivers(loaded).axes[0].get_title() == plots.drivers(one).axes[0].get_title()


USERS = """
from dataclasses import dataclass

@dataclass
class Lazy:
    gain: float = 3.0
    def initial_state(self, context): return None
    def __call__(self, t, q, v, reference, state):
        return self.gain * (reference.q - q) + self.gain * (reference.v - v), state

"""


@pytest.mark.long
def test_a_file_is_read_without_the_users_classes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "usersown.py").write_text(USERS)
    monkeypatch.syspath_prepend(tmp_path / "there")
    import usersown  # type: ignore[import-not-found]

    one = pm.ensemble(
        ROBOT, usersown.Lazy(), CIRCLE, n=5, spread={"mass": pm.Uniform(9, 11)}, dt=0.1, traces=[2]
    )
    path = saved(one, tmp_path)
    code = f"""
import sys
from importlib.util import find_spec
from pinmobile import Ensemble, plots
assert find_spec("usersown") is None
one = Ensemble.load({str(path)!r})
plots.bands(one), plots.drivers(one, share=0.2)
one.to_csv({str(tmp_path / "robots.csv")!r})
print(repr(one))
print(one.traces[2])
print(one.scenario)
try:
    one.arguments(1)
except ValueError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert not done.stderr
    assert done.stdout.startswith(f"{one!r}\n{one.traces[2]}\n")
    assert "controller: Lazy(gain=3.0)\ntrajectory: Tangent(" in done.stdout
    assert "\nn 5, seed 0, dt 0.1, substeps 1, " in done.stdout
    assert "i is 1, a robot that cannot be made again: a file keeps the scenario as text" in done.stdout
    assert "(its controller is Lazy(gain=3.0)); expected the ensemble of Ensemble.load(path" in done.stdout


def test_with_its_scenario_a_loaded_ensemble_makes_robots_again(tmp_path: Path) -> None:
    path = saved(made(), tmp_path)
    loaded = pm.Ensemble.load(path, scenario(spread=SPREAD | {"controller.mass": 30.0}))
    assert str(loaded) == str(made())
    assert loaded.arguments(5).robot == made().arguments(5).robot
    for name in SERIES:
        np.testing.assert_array_equal(getattr(loaded.member(5), name), getattr(made().member(5), name))
    alone = pm.Ensemble.load(path)
    with refused(r"^i is 60, expected at most 59$"):
        alone.member(60)
    with refused(r"^i is 5, a robot that cannot be made again: .*ComputedTorque"):
        alone.member(5)


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"controller": pm.ComputedTorque(ROBOT)}, r"controller is .*30.0.* there and .*10.0.* here"),
        ({"robot": pm.MobileRobot(10, 1.4)}, r"robot is .*1.3.* there and .*1.4.* here"),
        ({"n": 61, "spread": SPREAD | {"com.x": 0.0}}, r"spread\['com.x'\] is 60 numbers there and 0.0 here"),
        (
            {"spread": {name: SPREAD[name] for name in SPREAD if name != "mass"}},
            r"spread\['mass'\] is Uniform\(low=2.0, high=10.0\) there and absent here",
        ),
        ({"spread": SPREAD | {"com.x": np.linspace(0, 0.2, 60)}}, "its draws of com.x differ"),
        ({"duration": 10.0, "every": 3}, "t differs"),
    ],
)
def test_another_scenario_is_refused(tmp_path: Path, changed: dict[str, Any], why: str) -> None:
    path = saved(made("none diverges, none traced"), tmp_path)
    with refused(rf"^scenario does not match '.*saved.npz': {why}$"):
        pm.Ensemble.load(path, scenario(**changed))


def test_changed_code_is_refused_and_versions_are_kept(tmp_path: Path) -> None:
    def made(gain: float, scale: float) -> pm.Scenario:
        def force(t: Any, q: Any, v: Any, reference: Any) -> Any:
            return gain * (reference.q - q) + 40.0 * (reference.v - v)

        metrics = {"size": lambda sample: scale * sample.u[0]}
        return scenario(controller=pm.law(force), spread={"mass": pm.Uniform(9, 11)}, metrics=metrics)

    found = run_scenario(made(40.0, 1.0))
    path = saved(found, tmp_path)
    read = pm.Ensemble.load(path, made(40.0, 1.0))
    np.testing.assert_array_equal(read.member(0).u, found.member(0).u)
    for other, name in ((made(60.0, 1.0), "controller"), (made(40.0, 2.0), "metrics")):
        with refused(f"saved.npz': numbers or code of {name} differ$"):
            pm.Ensemble.load(path, other)
    told = pm.Ensemble.load(path).scenario
    assert isinstance(told, Outline)
    assert told.versions["pinmobile"] == pm.__version__
    assert f"numpy {np.__version__}" in str(told)


def test_csv_has_a_row_per_robot_and_every_digit(tmp_path: Path) -> None:
    one = made()
    one.to_csv(tmp_path / "robots.csv")
    header = (tmp_path / "robots.csv").read_text().splitlines()[0].split(",")
    table = np.loadtxt(tmp_path / "robots.csv", delimiter=",", skiprows=1, ndmin=2)
    columns = dict(zip(header, table.T, strict=True))
    assert header[0] == "robot"
    assert header[-2:] == ["max_distance [m]", "diverged_at [s]"]
    wanted: dict[str, Any] = {"robot": np.arange(len(one)), "max_distance [m]": one.max_distance}
    units = {"mass": "kg", "controller.mass": "kg", "com.x": "m", "force.x": "N", "kp": "1/s^2"}
    wanted |= {f"drawn_{each} [{units[each]}]": values for each, values in one.draws.items()}
    for k, (of, unit) in enumerate((("x", "m"), ("y", "m"), ("psi", "rad"))):
        wanted |= {f"max_error_{of} [{unit}]": one.max_error[:, k]}
        wanted |= {f"rms_error_{of} [{unit}]": one.rms_error[:, k]}
        wanted |= {f"max_input_{('Fx [N]', 'Fy [N]', 'Mz [N m]')[k]}": one.max_input[:, k]}
    wanted["diverged_at [s]"] = one.diverged_at
    assert set(wanted) == set(header)
    for each, values in wanted.items():
        np.testing.assert_array_equal(columns[each], values, err_msg=each)


def test_a_dataset_is_what_a_sweep_of_the_same_has(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    whole = scenario(n=60)
    stored = pm.sweep(whole, tmp_path / "sweep.zarr")
    one = stored.ensemble()
    theirs, mine = stored.dataset.isel(dict.fromkeys(stored.axes, 0), drop=True).load(), one.to_xarray()
    counts = theirs.counts
    theirs["counts"] = counts.sum("chunk").assign_attrs(counts.attrs).astype(np.int32)
    xarray.testing.assert_equal(mine, theirs)
    for name in theirs.variables:
        assert mine[name].attrs == theirs[name].attrs
        assert mine[name].dims == theirs[name].dims
    assert {"units", "long_name"} == set(mine.drawn_mass.attrs)
    assert mine.drawn_mass.attrs["units"] == "kg"
    assert mine.attrs["errors_from_s"] == theirs.attrs["errors_from_s"] == 2.0
    loaded = pm.Ensemble.load(saved(one, tmp_path)).to_xarray()
    assert loaded.identical(mine)
    assert "controller: ComputedTorque(" in loaded.attrs["scenario"]
    loaded.max_error[:] = 0.0  # it is the reader's own
    assert one.max_error.any()


def test_another_kind_of_file_is_refused_either_way(tmp_path: Path) -> None:
    path = saved(made(), tmp_path)
    made().traces[3].save(tmp_path / "run.npz")
    with refused(r"run.npz', which is not a 'pinmobile ensemble 6' archive: its format is"):
        pm.Ensemble.load(tmp_path / "run.npz")
    with refused(r"saved.npz', which is not a 'pinmobile rollout 4' archive: its format is"):
        pm.Rollout.load(path)


def test_damaged_bytes_are_refused_or_do_no_harm(tmp_path: Path) -> None:
    content, path = saved(made(), tmp_path).read_bytes(), tmp_path / "robots.npz"
    wanted, words = bits(made()), str(pm.Ensemble.load(saved(made(), tmp_path)))
    read = 0
    for seed in range(40):
        path.write_bytes(damaged(content, np.random.default_rng(seed)))
        loaded = answer(lambda: pm.Ensemble.load(path))
        if isinstance(loaded, pm.InvalidArgument):
            assert str(loaded).startswith(f"path is {str(path)!r}, which ")
        else:
            assert bits(loaded) == wanted
            assert str(loaded) == words
            read += 1
    assert read < 30
