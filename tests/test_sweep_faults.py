"""Stores on disks that are full, in folders with other things, of many processes, and damaged."""

import json
import pickle
import re
import shutil
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import InvalidArgument, Sweep, sweep
from pinmobile.errors import FileError
from pinmobile.sweeps import Points
from pinmobile.sweeps._points import describe
from tests.damage import answer, damaged, full_disk, little_memory
from tests.refusals import refused
from tests.sweeping import contents, scenario
from tests.test_sweeps import Stop, stop_at

pytestmark = pytest.mark.once

CHUNK = 8
GRID = {"controller.kp": [4, 16]}


def small(path: str | Path, **options: Any) -> Sweep:
    return sweep(scenario(n=20), path, grid=GRID, chunk=CHUNK, **options)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small(tmp_path_factory.mktemp("sweep") / "store").path


@pytest.fixture
def copy(done: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(done, tmp_path / "store"))


def begun(path: Path, robots: int) -> Path:
    """Return a store that is left when so many robots are done."""
    with pytest.raises(Stop):
        small(path, progress=stop_at(robots))
    return path


@pytest.mark.parametrize(("room", "before"), [(0, 16), (30, 40), (300, 0), (1000, None)])
def test_a_full_disk_leaves_the_store_good(done: Path, tmp_path: Path, room: int, before: int | None) -> None:
    store = tmp_path / "there" / "store"
    if before is not None:
        begun(store, before)
    there = contents(store)
    with full_disk(room):
        found = answer(lambda: small(store))
    if before != 40:  # otherwise all files are small enough
        assert isinstance(found, FileError)
        assert re.search(
            r"^a file of the store is '.*', which cannot be written: File too large; finished", str(found)
        )
    after = contents(store)
    assert {place: after.get(place) for place in there} == there
    assert not (store / ".writing").exists()
    small(store)
    assert contents(store) == contents(done)


def test_a_store_that_could_not_be_begun_leaves_nothing(tmp_path: Path) -> None:
    with full_disk(100), pytest.raises(FileError, match=r"zarr\.json', which cannot be written: File too la"):
        small(tmp_path / "store")
    assert not list(tmp_path.iterdir())


def test_what_others_have_inside_a_store_stays(done: Path, tmp_path: Path) -> None:
    store = begun(tmp_path / "keep.zarr", 16)
    mine = ["mine.partial", "max_error/mine.partial", "c"]
    for name in mine:
        (store / name).write_bytes(b"mine")
    small(store)
    assert {name for name in contents(store) if name not in contents(done)} == set(mine)
    assert Sweep.open(store).answer() == Sweep.open(done).answer()


def test_a_store_may_be_of_a_dead_process(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    here.chmod(0o750)
    monkeypatch.chdir(here)
    for name in (".lock", ".writing"):
        Path(name).touch()
    small("../here/.")
    assert contents(here) == contents(done)
    assert here.stat().st_mode & 0o777 == 0o750


def test_a_folder_of_other_things_is_no_place_for_a_store(tmp_path: Path) -> None:
    (tmp_path / "store" / "mine").mkdir(parents=True)
    (tmp_path / "store" / "mine" / ".lock").write_bytes(b"mine")
    with refused(r"which is not the store of a sweep: '.*zarr.json' cannot be rea"):
        small(tmp_path / "store")
    assert list(contents(tmp_path / "store")) == ["mine/.lock"]


def test_of_many_sweeps_at_once_one_writes_and_others_read(done: Path, tmp_path: Path) -> None:
    from pinmobile.sweeps._store import Store

    points = Points.of(scenario(n=20), GRID)
    description, gate, found, store = describe(points), threading.Barrier(8), list[Any](), tmp_path / "store"

    def begin() -> None:
        gate.wait()
        found.append(answer(lambda: Store(store, points, description, CHUNK)))

    threads = [threading.Thread(target=begin) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    (one,) = (each for each in found if isinstance(each, Store))
    refused = [str(each) for each in found if each is not one]
    assert refused == [f"store is {str(store)!r}, which another process is writing"] * 7
    early = Sweep.open(store)
    assert np.isnan(early.error_quantile()).all()
    assert early.table().splitlines()[1].split() == ["4", "unknown", "unknown"]
    assert early.answer() == "0 % of the robots are done, but no scenario is complete"
    one.__exit__()
    small(store)
    assert contents(store) == contents(done)


def edited(change: Callable[[dict[str, Any]], object]) -> Callable[[bytes], bytes]:
    def edit(content: bytes) -> bytes:
        tree = json.loads(content)
        change(tree)
        return json.dumps(tree).encode()

    return edit


def of_ours(**changed: Any) -> Callable[[bytes], bytes]:
    def change(tree: dict[str, Any]) -> None:
        mine = json.loads(tree["attributes"]["pinmobile_sweep"])
        kept = {name: value for name, value in {**mine, **changed}.items() if value is not None}
        tree["attributes"]["pinmobile_sweep"] = json.dumps(kept)

    return edited(change)


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (of_ours(chunk=0), "damaged.*: its digest differs"),
        (of_ours(determined_by={"format": 3}), "not the store of a sweep.* its format is 3, expected 5"),
        (edited(lambda tree: tree.pop("attributes")), "not the store of a sweep.* it lacks 'attributes'"),
        (lambda content: content[:1000], "not the store of a sweep.*: Unterminated string"),
        (lambda content: b"[" * 100_000, "not the store of a sweep.*recursion"),
    ],
)
def test_a_store_of_unknown_kind_is_named(copy: Path, damage: Callable[[bytes], bytes], why: str) -> None:
    file = copy / "zarr.json"
    content = file.read_bytes()
    file.write_bytes(damage(content))
    for call in (Sweep.open, small):
        with refused(rf"^store is '.*', which is .*'{file}' cannot be .*: ") as caught:
            call(copy)
        assert re.search(why, str(caught.value))
    file.write_bytes(content)
    assert Sweep.open(copy).answer()


def resigned(name: str, **changed: Any) -> Callable[[bytes], bytes]:
    """Change what a store says of an array as somebody who knows how to make the digest."""
    from pinmobile.sweeps._store import digest_of

    def change(tree: dict[str, Any]) -> None:
        own, attributes = tree["consolidated_metadata"]["metadata"], tree["attributes"]
        own[name] = {**own.get(name, {}), **changed}
        mine = json.loads(attributes["pinmobile_sweep"])
        told = {k: v for k, v in mine.items() if k not in ("digest", "arrays")}
        since = {"errors_from_s": attributes["errors_from_s"]}
        mine["digest"] = digest_of(told, {k: own[k] for k in mine["arrays"]}, since)
        attributes["pinmobile_sweep"] = json.dumps(mine)

    return edited(change)


class Attack:
    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("attacked"),)


def test_a_store_runs_no_code(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = "coordinate"
    pickles = pytest.importorskip("numcodecs.pickles")
    # Older versions have no such switch and always unpickle.
    monkeypatch.setattr(pickles, "ALLOW_UNSAFE_PICKLE_DECODE", True, raising=False)
    monkeypatch.chdir(copy)
    second: dict[str, Any] = {
        **{"zarr_format": 2, "shape": [3], "chunks": [3], "dtype": "|O", "order": "C", "fill_value": ""},
        **{"compressor": None, "filters": [{"id": "vlen-utf8"}, {"id": "pickle"}]},
        **{"attributes": {"_ARRAY_DIMENSIONS": [name]}, "dimension_names": [name]},
    }
    file = copy / "zarr.json"
    file.write_bytes(resigned(name, **second)(file.read_bytes()))
    (copy / name).mkdir(exist_ok=True)
    (copy / name / "0").write_bytes(pickle.dumps(Attack()))
    for call in (Sweep.open, small):
        with refused(f"array '{name}' has the codecs .* expected plain numbers"):
            call(copy)
    assert not (copy / "attacked").exists()


def numbers(path: Path) -> dict[str, Any]:
    """Return all that can be read of a store."""
    found = Sweep.open(path, scenario(n=20), grid=GRID)
    read: dict[str, Any] = {"table": str(found)}
    for gain in (4, 16):
        one = found.ensemble(**{"controller.kp": gain})
        for name in ("max_error", "rms_error", "max_input", "counts"):
            read[f"{name} {gain}"] = np.asarray(getattr(one, name))
        read |= {f"{name} {gain}": values for name, values in one.draws.items()}
    data = found.dataset[["controller.kp", "time", "quantiles"]].load()
    return read | {str(name): data[name].values for name in data}


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return all(np.array_equal(one[name], value) for name, value in other.items())


def replaced_by_a_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


def damage_file(file: Path, seed: int) -> None:
    file.write_bytes(damaged(file.read_bytes(), np.random.default_rng(seed)))


DAMAGES: list[Callable[[Path], object]] = [
    Path.unlink,
    lambda file: file.write_bytes(b""),
    replaced_by_a_folder,
    *(partial(damage_file, seed=seed) for seed in range(6)),
]


def test_a_damaged_store_names_the_file_and_the_rest_is_kept(done: Path, tmp_path: Path) -> None:
    """It is mended by removing the files that errors name; what it says of itself is put back."""
    good, store = numbers(done), contents(done)
    names = sorted(name for name in store if "/c/" in name or name.startswith(("zarr", "time")))[::12]
    told = 0
    for number, name in enumerate(names):
        path = Path(shutil.copytree(done, tmp_path / str(number)))
        file = path / name
        DAMAGES[number % len(DAMAGES)](file)
        gone = not file.is_file()
        with little_memory(2 << 30):
            found = answer(partial(numbers, path))
        told += isinstance(found, InvalidArgument)
        assert isinstance(found, InvalidArgument) or gone or same(found, good)
        assert (
            isinstance(found, dict)
            or str(path) in str(found)
            or (gone and "robots are missing" in str(found))
        )
        if number % 4 == 0:  # the most of the time
            if file.is_dir():
                file.rmdir()
            elif name == "zarr.json":
                file.write_bytes((done / name).read_bytes())
            elif not isinstance(found, dict):
                file.unlink(missing_ok=True)
            assert same(numbers(small(path).path), good)
            assert contents(path) == store
        shutil.rmtree(path)
    assert told > len(names) / 3
