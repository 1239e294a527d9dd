"""Damaged files of rollouts: an error that names the file, or what was saved."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.wheels import OdometryFeedback
from tests.damage import answer, damaged

ROBOT = pm.MobileRobot(10, 1.2, com=(0.15, 0.05)).attach(pm.PayloadBody(2, (0.1, 0, 0.2)))
RUN = pm.simulate(ROBOT, pm.PD((8, 8, 1), (8, 8, 1)), pm.Tangent(pm.Circle(3, 0.1, 6)), dt=0.5)


def saved(tmp_path: Path) -> bytes:
    RUN.save(tmp_path / "saved.npz")
    return (tmp_path / "saved.npz").read_bytes()


def members(tmp_path: Path) -> dict[str, Any]:
    saved(tmp_path)
    with np.load(tmp_path / "saved.npz") as archive:
        return dict(archive)


def same(loaded: pm.Rollout) -> bool:
    names = ("t", "q", "v", "a", "u", "error")
    pairs = [(getattr(loaded, name), getattr(RUN, name)) for name in names]
    pairs += list(zip(loaded.reference, RUN.reference, strict=True))
    return all(np.array_equal(one, other) for one, other in pairs)


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"format": np.array("pinmobile rollout 9")}, "its format is 'pinmobile rollout 9'"),
        ({"q": None, "v": None}, "it has no 'q'"),
        ({"q": np.zeros((13, 2))}, r"q has shape \(13, 2\), expected \(13, 3\)"),
        ({"q": np.full((13, 3), np.nan)}, r"q\[0, 0\] is nan, expected a finite number"),
    ],
)
def test_what_no_rollout_holds_is_refused(tmp_path: Path, changed: dict[str, Any], why: str) -> None:
    made = {name: array for name, array in (members(tmp_path) | changed).items() if array is not None}
    np.savez(tmp_path / "run.npz", **made)
    with pytest.raises(pm.InvalidArgument, match=why):
        pm.Rollout.load(tmp_path / "run.npz")


@pytest.mark.parametrize("ground", [pm.Rolling(), pm.Coulomb(0.5)], ids=["rolls", "slips"])
def test_a_run_on_wheels_comes_back_with_its_signals(tmp_path: Path, ground: pm.Rolling | pm.Coulomb) -> None:
    table = pm.WheelTable.differential(
        0.46, 0.1, supports=[(0.2, 0), (-0.2, 0)], mass=1.0, spin_inertia=0.005, motor=pm.Motor(5.0)
    )
    plant = pm.WheeledRobot(pm.MobileRobot(30, 1.3, com=(0, 0, 0.1), size=(0.6, 0.4, 0.25)), table, ground)
    law = OdometryFeedback(pm.Backstepping(pm.UnicycleTracking(), plant), table)
    run = pm.simulate(plant, law, pm.Tangent(pm.Circle(1, 0.5, 0.1)), dt=0.02)
    run.save(tmp_path / "run.npz")
    loaded = pm.Rollout.load(tmp_path / "run.npz")
    names = ("t", "q", "v", "a", "u", "error")
    assert all(np.array_equal(getattr(loaded, name), getattr(run, name)) for name in names)
    assert list(loaded.signals) == list(run.signals)
    for name, kept in run.signals.items():
        assert loaded.signals[name].unit == kept.unit
        assert np.array_equal(loaded.signals[name].values, kept.values)
    assert loaded.plant == plant
    assert loaded.metrics().keys() == run.metrics().keys()


def test_what_is_no_archive_is_not_called_one_that_may_be_loaded_unsafely(tmp_path: Path) -> None:
    (tmp_path / "run.npz").write_bytes(b"\x80\x04K\x01.")
    with pytest.raises(pm.InvalidArgument, match=r"which is not a 'pinmobile rollout 4' archive: it is not"):
        pm.Rollout.load(tmp_path / "run.npz")


@pytest.mark.parametrize("name", ["os:system", "pinmobile.files:write"])
def test_what_is_no_class_of_fields_is_not_made(tmp_path: Path, name: str) -> None:
    """A plant is then unknown; what else stands in a file must be there."""
    made = members(tmp_path)
    for changed in ("MobileRobot", "Reference"):
        text = re.sub(rf"pinmobile[.\w]*:{changed}", name, str(made["description"]))
        np.savez(tmp_path / "run.npz", **made | {"description": np.array(text)})
        if changed == "MobileRobot":
            loaded = pm.Rollout.load(tmp_path / "run.npz")
            assert (loaded.plant.coordinates, same(loaded)) == (ROBOT.coordinates, True)
            assert loaded.plant.reason == f"it has a {name}, expected a class of pinmobile"
        else:
            with pytest.raises(pm.InvalidArgument, match=f"it has a {name}, expected"):
                pm.Rollout.load(tmp_path / "run.npz")


def test_damaged_bytes_are_refused_or_do_no_harm(tmp_path: Path) -> None:
    content, path = saved(tmp_path), tmp_path / "run.npz"
    read = 0
    for seed in range(40):
        path.write_bytes(damaged(content, np.random.default_rng(seed)))
        loaded = answer(lambda: pm.Rollout.load(path))
        if isinstance(loaded, pm.InvalidArgument):
            assert str(loaded).startswith(f"path is {str(path)!r}, which ")
        else:
            assert same(loaded)
            assert (loaded.plant, loaded.plant.source) == (ROBOT, ROBOT.source)
            read += 1
    assert read < 28  # dates and the like may be anything, but not much is
