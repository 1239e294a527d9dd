"""Damaged and hostile files of rollouts: an error that names the file, or what was saved."""

import io
import json
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import (
    PD,
    Backstepping,
    ByOdometry,
    Circle,
    Coulomb,
    InvalidArgument,
    Load,
    MobileRobot,
    Motor,
    Rolling,
    Rollout,
    Tangent,
    Tracking,
    WheeledRobot,
    WheelTable,
    plots,
    simulate,
)
from tests.damage import answer, damaged, little_memory, rewritten

ROBOT = MobileRobot(10, 1.2, com=(0.15, 0.05)).attach(Load(2, (0.1, 0, 0.2)))
RUN = simulate(ROBOT, PD((8, 8, 1), (8, 8, 1)), Tangent(Circle(3, 0.1, 6)), dt=0.5)


def saved(tmp_path: Path) -> bytes:
    RUN.save(tmp_path / "saved.npz")
    return (tmp_path / "saved.npz").read_bytes()


def members(tmp_path: Path) -> dict[str, Any]:
    saved(tmp_path)
    with np.load(tmp_path / "saved.npz") as archive:
        return dict(archive)


def same(loaded: Rollout) -> bool:
    names = ("t", "q", "v", "a", "u", "error")
    pairs = [(getattr(loaded, name), getattr(RUN, name)) for name in names]
    pairs += list(zip(loaded.reference, RUN.reference, strict=True))
    return all(np.array_equal(one, other) for one, other in pairs)


def described(tmp_path: Path, **changed: Any) -> Any:
    given = json.loads(str(members(tmp_path)["plant"]))
    return np.array(json.dumps(given | {"robot": given["robot"] | changed}))


def changed(key: str, change: Callable[[Any], Any]) -> Callable[[Path], dict[str, Any]]:
    def make(tmp_path: Path) -> dict[str, Any]:
        given = members(tmp_path)
        return {**given, key: change(given[key].copy())}

    return make


def robot(**given: Any) -> Callable[[Path], dict[str, Any]]:
    return lambda tmp_path: {**members(tmp_path), "plant": described(tmp_path, **given)}


def outline(name: str, value: Any) -> Callable[[Path], dict[str, Any]]:
    def make(tmp_path: Path) -> dict[str, Any]:
        given = json.loads(str(members(tmp_path)["plant"]))
        given["outline"][name] = value
        return {**members(tmp_path), "plant": np.array(json.dumps(given))}

    return make


def text(value: str) -> Callable[[Path], dict[str, Any]]:
    return lambda tmp_path: {**members(tmp_path), "plant": np.array(value)}


def put(place: Any, value: Any) -> Callable[[Any], Any]:
    def change(array: Any) -> Any:
        array[place] = value
        return array

    return change


def without(key: str) -> Callable[[Path], dict[str, Any]]:
    return lambda tmp_path: {name: array for name, array in members(tmp_path).items() if name != key}


MOUNT = {"name": "ur5", "at": [0, 0, 0, 0], "arm": "ur5", "package_dirs": [], "locked": [], "rest": [0.0] * 6}


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (changed("q", put((3, 1), np.nan)), r"q\[3, 1\] is nan, expected a finite number"),
        (changed("u", put((0, 0), np.inf)), r"u\[0, 0\] is inf, expected a finite number"),
        (changed("reference_a", put((0, 0), np.nan)), r"reference.a\[0, 0\] is nan"),
        (changed("t", lambda t: t[::-1]), r"t\[1\] is 5.5 s after 6.0 s, expected more"),
        (changed("t", put(3, 1.0)), r"t\[3\] is 1.0 s after 1.0 s, expected more"),
        (changed("t", lambda t: t[:0]), r"t has shape \(0,\), expected \(n,\), n >= 1"),
        (changed("t", lambda t: t[:, None]), r"t has shape \(13, 1\), expected \(n,\), n >= 1"),
        (changed("t", lambda t: t[:-1]), r"q has shape \(13, 3\), expected \(12, k\), as t has"),
        (changed("q", lambda q: q[:, :2]), r"q has shape \(13, 2\), expected \(13, 3\)"),
        (changed("v", lambda v: np.hstack([v, v])), r"v has shape \(13, 6\), expected \(13, 3\)"),
        (changed("u", lambda u: u[:, 0]), r"u has shape \(13,\), expected \(13, k\)"),
        (changed("error", lambda error: error[:, :2]), "as error has"),
        (changed("reference_q", lambda q: np.hstack([q, q])), r"reference.q has shape \(13, 6\), expected"),
        (changed("q", lambda q: q.astype(str)), "q is of type <U32, expected float64"),
        (changed("q", lambda q: q + 0j), "q is of type complex128, expected float64"),
        (changed("q", lambda q: q > 0), "q is of type bool, expected float64"),
        (changed("q", lambda q: q.astype("f4")), "q is of type float32, expected float64"),
        (changed("q", lambda q: q.astype("i8")), "q is of type int64, expected float64"),
        (changed("q", lambda q: q.view([("x", "f8")])), "expected float64"),
        (changed("q", lambda q: q.astype(object)), "q.npy has .* bytes, expected those of shape"),
        (changed("format", lambda _: np.array("pinmobile rollout 3")), "it is of another format"),
        (without("q"), "it holds 'a', .*; expected format, plant, t, q, v, a, u, error, reference_q"),
        (lambda p: {**members(p), "more": np.zeros(3)}, "it holds .* 'more'"),
        (changed("plant", lambda _: np.array(0x110000, "<u4").view("<U1")), "codec can't decode"),
        (
            changed("plant", lambda _: np.array(3)),
            r"plant is of type int64 and shape \(\), expected one text",
        ),
        (changed("format", lambda text: text[None]), r"format is of type <U19 and shape \(1,\), expected"),
        (text("[" * 100_000), "recursion"),
        (text("{}"), "'robot'"),
        (text("[]"), "list"),
        (text("3"), "int"),
        (text(""), "Expecting value"),
        (text('{"mass": 1' + "0" * 5000 + "}"), "limit"),
        (robot(mass=-1), "mass is -1"),
        (robot(mass="10"), "mass is '10', expected"),
        (robot(mass=None), "mass is None, expected"),
        (robot(mass=float("nan")), "mass is nan"),
        (robot(size=3), "int"),
        (robot(dh=[[0, 0, 0, 0, "sliding", "x"]]), "'sliding' is not a valid JointType"),
        (robot(source="\ud800"), "expected text without control characters"),
        (robot(source=3), "source is 3, expected text"),
        (robot(locked_joints=["\ud800"]), "expected text without control characters"),
        (robot(mounts=[3]), "'int' object"),
        (robot(mounts=[{**MOUNT, "arm": 3}]), "robot has a mount"),
        (robot(mounts=[{**MOUNT, "at": ["x"]}]), r"robot's at is \['x'\], expected real numbers"),
        (robot(mounts=[{"name": "ur5"}]), "robot has a mount of name, expected name, at, arm"),
        (robot(loads=[["B", -1]]), "mass is -1"),
        (outline("kind", 3), "plant's kind is 3, expected text"),
        (outline("coordinates", [3]), "int"),
        (outline("coordinates", [{"name": "x"}]), "'lower'"),
        (outline("posed", [0, 1]), "expected three numbers"),
        (outline("posed", [0, 1, 3]), "plant's posed is 3, expected"),
        (outline("leading", [[4, 3]]), "plant's leading is 4, expected"),
        (outline("size", [1, -1, 1]), "size"),
        (changed("signals", lambda x: np.zeros((13, 2))), r"signals has shape \(13, 2\), expected \(n, 0\)"),
        (robot(loads=[[3, 1, [0, 0, 0], None, None]]), "'int' object has no attribute 'encode'"),
    ],
)
def test_what_no_rollout_holds_is_refused(
    tmp_path: Path, make: Callable[[Path], dict[str, Any]], why: str
) -> None:
    np.savez(tmp_path / "run.npz", **make(tmp_path))
    with pytest.raises(InvalidArgument, match=rf"^path is '.*run.npz', which .*{why}"):
        Rollout.load(tmp_path / "run.npz")


@pytest.mark.parametrize("ground", [Rolling(), Coulomb(0.5)], ids=["rolls", "slips"])
def test_a_run_on_wheels_comes_back_with_its_signals_and_the_names_of_its_wheels(
    tmp_path: Path, ground: Rolling | Coulomb
) -> None:
    """The robot is told by names, units and limits; what asks its wheels needs the robot itself."""
    table = WheelTable.differential(
        0.46, 0.1, supports=[(0.2, 0), (-0.2, 0)], mass=1.0, spin_inertia=0.005, motor=Motor(5.0)
    )
    plant = WheeledRobot(MobileRobot(30, 1.3, com=(0, 0, 0.1), size=(0.6, 0.4, 0.25)), table, ground)
    law = ByOdometry(Backstepping(Tracking(), plant), table)
    run = simulate(plant, law, Tangent(Circle(1, 0.5, 0.1)), dt=0.02)
    run.save(tmp_path / "run.npz")
    loaded = Rollout.load(tmp_path / "run.npz")
    names = ("t", "q", "v", "a", "u", "error")
    assert all(np.array_equal(getattr(loaded, name), getattr(run, name)) for name in names)
    assert list(loaded.signals) == list(run.signals)
    for name, kept in run.signals.items():
        assert loaded.signals[name].unit == kept.unit
        assert np.array_equal(loaded.signals[name].values, kept.values)
    for name in ("coordinates", "inputs", "leading", "nq", "nv", "nu", "size"):
        assert getattr(loaded.plant, name) == getattr(plant, name)
    loaded.save(tmp_path / "again.npz")
    assert Rollout.load(tmp_path / "again.npz").plant == loaded.plant
    assert pickle.loads(pickle.dumps(plant)) == plant
    again = simulate(pickle.loads(pickle.dumps(plant)), law, Tangent(Circle(1, 0.5, 0.1)), dt=0.02)
    assert np.array_equal(again.q, run.q)
    with pytest.raises(InvalidArgument, match="WheeledRobot"):
        plots.slip(loaded)


def header(shape: str, kind: str = "<f8") -> bytes:
    made = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00v\x00" + made


@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        ("(1000000000000000,)", "<f8"),
        ("(13,)", "|V1000000000000"),
        ("(-1, -13)", "<f8"),
        ("(0, 10000000000000000000000)", "<f8"),
        ("(" * 50 + "13,", "<f8"),
        ("((13,),)", "<f8"),
        ("(13.5,)", "<f8"),
        ("(13,)", "|O"),
        ("(13,)", "<f8, <f8"),
        ("__import__('os').abort()", "<f8"),
    ],
)
def test_a_header_that_lies_is_refused_before_anything_is_made_of_it(
    tmp_path: Path, shape: str, kind: str
) -> None:
    def lie(name: str, data: bytes) -> bytes:
        return header(shape, kind) + data[128:] if name == "t.npy" else data

    (tmp_path / "run.npz").write_bytes(rewritten(saved(tmp_path), lie))
    with (
        little_memory(),
        pytest.raises(InvalidArgument, match=r"run.npz', which is no 'pinmobile rollout 2' archive: "),
    ):
        Rollout.load(tmp_path / "run.npz")


@pytest.mark.parametrize("name", ["zero", "null", "pipe"])
def test_what_may_never_end_is_refused_before_it_is_opened(name: str, tmp_path: Path) -> None:
    if name == "pipe":
        os.mkfifo(tmp_path / name)  # nobody writes to it: who opens it waits
    else:
        (tmp_path / name).symlink_to(f"/dev/{name}")
    with little_memory(1 << 26), pytest.raises(InvalidArgument, match="it is a device or a pipe, which may"):
        Rollout.load(tmp_path / name)


def test_what_unpacks_to_more_than_it_is_is_refused(tmp_path: Path) -> None:
    def swell(name: str, data: bytes) -> bytes:
        return header("(25000000,)") + bytes(200_000_000) if name == "t.npy" else data

    options = {"compression": zipfile.ZIP_DEFLATED, "compresslevel": 1}
    (tmp_path / "run.npz").write_bytes(rewritten(saved(tmp_path), swell, **options))
    with little_memory(1 << 26), pytest.raises(InvalidArgument, match=r"unpacks to 2000\d+ bytes, expected"):
        Rollout.load(tmp_path / "run.npz")


def test_a_member_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    content = saved(tmp_path)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        twice = archive.read("t.npy")
    with (
        zipfile.ZipFile(tmp_path / "saved.npz", "a") as archive,
        pytest.warns(UserWarning, match="Duplicate"),
    ):
        archive.writestr("t.npy", twice)
    with pytest.raises(InvalidArgument, match=r"'t', 't', 'u', 'v'; expected format, .*, each once"):
        Rollout.load(tmp_path / "saved.npz")


def test_an_arm_that_is_gone_is_no_damage(tmp_path: Path) -> None:
    """As documented: what is told of the robot is its names and units, and nothing else is missing."""
    np.savez(tmp_path / "run.npz", **robot(mounts=[{**MOUNT, "arm": "gone.urdf"}])(tmp_path))
    assert Rollout.load(tmp_path / "run.npz").plant.coordinates == ROBOT.coordinates
    assert same(Rollout.load(tmp_path / "run.npz"))


@pytest.mark.parametrize("order", ["<f8", ">f8"])
@pytest.mark.parametrize("layout", ["C", "F"])
def test_any_byte_order_and_layout_is_read(tmp_path: Path, order: str, layout: Any) -> None:
    made: dict[str, Any] = {
        name: np.asarray(array, order, order=layout) if array.dtype == np.float64 else array
        for name, array in members(tmp_path).items()
    }
    np.savez(tmp_path / "run.npz", **made)
    assert same(Rollout.load(tmp_path / "run.npz"))
    assert Rollout.load(tmp_path / "run.npz").q.dtype == np.dtype("=f8")


def loaded_or_refused(path: Path) -> bool:
    """Tell whether a damaged file is read; what is read must be what was saved."""
    loaded = answer(lambda: Rollout.load(path))
    if isinstance(loaded, InvalidArgument):
        assert str(loaded).startswith(f"path is {str(path)!r}, which ")
        return False
    assert same(loaded)
    assert loaded.plant == ROBOT
    return True


def test_damaged_bytes_are_refused_or_do_no_harm(tmp_path: Path) -> None:
    content, path = saved(tmp_path), tmp_path / "run.npz"
    read = 0
    for seed in range(400):
        path.write_bytes(damaged(content, np.random.default_rng(seed)))
        with little_memory():
            read += loaded_or_refused(path)
    assert 0 < read < 270  # dates and the like may be anything, but not much is


def test_damaged_members_with_right_checksums_are_refused_or_a_rollout(tmp_path: Path) -> None:
    """Whoever damages what is inside the archive cannot be told from its writer, but for what none writes."""
    content, path = saved(tmp_path), tmp_path / "run.npz"
    names = zipfile.ZipFile(io.BytesIO(content)).namelist()
    outcomes = {True: 0, False: 0}
    for seed in range(400):
        rng = np.random.default_rng(seed)
        chosen = rng.choice(names)
        swap = rng.integers(8) == 0

        def change(name: str, data: bytes, rng: Any = rng, one: str = chosen, swap: Any = swap) -> bytes:
            if name != one:
                return data
            head = damaged(data[:128], rng)  # where the header is, and most of what can go wrong
            return data[::-1] if swap else head + data[128:] if rng.integers(2) else damaged(data, rng)

        path.write_bytes(rewritten(content, change))
        with little_memory():
            made = answer(lambda: Rollout.load(path))
        outcomes[isinstance(made, Rollout)] += 1
        if isinstance(made, InvalidArgument):
            assert str(made).startswith(f"path is {str(path)!r}, which ")
        else:
            assert np.isfinite(np.hstack([made.q, made.v, made.a, made.u, made.error])).all()
            assert (np.diff(made.t) > 0).all()
            made.to_csv(tmp_path / "run.csv")
    assert min(outcomes.values()) > 30


def test_swapped_members_are_a_rollout_of_other_numbers_or_refused(tmp_path: Path) -> None:
    given = members(tmp_path)
    rng = np.random.default_rng(0)
    for _ in range(200):
        names = list(given)
        order = rng.permutation(len(names)) if rng.integers(2) else np.arange(len(names))
        i, j = rng.integers(len(names), size=2)
        order[[i, j]] = order[[j, i]]
        np.savez(tmp_path / "run.npz", **{names[k]: given[names[m]] for k, m in enumerate(order)})
        made = answer(lambda: Rollout.load(tmp_path / "run.npz"))
        if isinstance(made, InvalidArgument):
            assert "run.npz" in str(made)
        else:
            np.testing.assert_array_equal(made.t, RUN.t)
