"""Stores on disks that are full, in folders with other things, of many processes, and damaged."""

import json
import pickle
import re
import shutil
import threading
import tracemalloc
from collections.abc import Callable
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import FileError, InvalidArgument, Sweep, grid, sweep
from pinmobile.sweeps import Grid
from pinmobile.sweeps.contents import digest_of
from pinmobile.sweeps.fingerprint import determined_by
from pinmobile.sweeps.store import Store
from tests.damage import answer, damaged, full_disk, little_memory
from tests.sweeping import contents, scenario

pytestmark = pytest.mark.once

CHUNK, ROBOTS = 8, 20


def small() -> Grid:
    return grid(lambda gain: scenario(gain, n=ROBOTS), gain=[4, 16])


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return sweep(small(), tmp_path_factory.mktemp("sweep") / "store", chunk=CHUNK).path


@pytest.fixture
def copy(done: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(done, tmp_path / "store"))


# Bytes that the disk has left, and how many robots are done when it is full (None: no store is there).
ROOM = 0, 30, 300, 600, 1000, 4000, 9000
BEFORE: tuple[tuple[int | None, ...], ...] = (None, 16), (0, 40)


class Stop(Exception):
    pass


def begun(path: Path, robots: int) -> Path:
    """Return a store that is left when so many robots are done."""

    def stop(now: int, total: int) -> None:
        if now >= robots:
            raise Stop

    with pytest.raises(Stop):
        sweep(small(), path, chunk=CHUNK, progress=stop)
    return path


@pytest.mark.alike
@pytest.mark.parametrize(
    ("room", "before"),
    [(room, before) for room, two in zip(ROOM, cycle(BEFORE), strict=False) for before in two],
)
def test_a_full_disk_leaves_the_store_as_good_as_it_was(
    done: Path, tmp_path: Path, room: int, before: int | None
) -> None:
    store = tmp_path / "there" / "store"
    if before is not None:
        begun(store, before)
    there = contents(store)
    with full_disk(room):
        found = answer(lambda: sweep(small(), store, chunk=CHUNK))
    if isinstance(found, FileError):
        assert re.search(
            r"^a file of the store is '.*', which cannot be written: File too large; what is done is in the "
            "store: start the same sweep again to go on$|^store is '.*store', which cannot be written: File",
            str(found),
        )
        after = contents(store)
        assert {place: after.get(place) for place in there} == there
    else:
        assert isinstance(found, Sweep), found  # all files are small enough
    assert not list(tmp_path.rglob("*.partial"))
    sweep(small(), store, chunk=CHUNK)
    assert contents(store) == contents(done)


def test_a_store_that_could_not_be_begun_leaves_nothing(tmp_path: Path) -> None:
    with full_disk(), pytest.raises(FileError, match="store', which cannot be written: File too large"):
        sweep(small(), tmp_path / "store")
    with full_disk(100), pytest.raises(FileError, match=r"zarr\.json', which cannot be written: File too la"):
        sweep(small(), tmp_path / "store")
    assert not list(tmp_path.iterdir())


def test_what_is_computed_again_on_a_full_disk_takes_nothing_away(done: Path, copy: Path) -> None:
    (copy / "max_error/c/1/2/0").unlink()
    there = contents(copy)
    with full_disk(30), pytest.raises(FileError, match="which cannot be written: File too large"):
        sweep(small(), copy)
    after = contents(copy)
    assert {place: after[place] for place in there} == there
    sweep(small(), copy)
    assert contents(copy) == contents(done)


def test_what_others_have_beside_and_inside_a_store_stays(done: Path, tmp_path: Path) -> None:
    beside = tmp_path / ".keep.zarr.new"
    beside.mkdir()
    (beside / "mine").write_bytes(b"mine")
    store = begun(tmp_path / "keep.zarr", 16)
    mine = ["mine.partial", "max_error/mine.partial", ".progress/mine.new", ".progress/mine.npz", "c"]
    for name in mine:
        (store / name).write_bytes(b"mine")
    sweep(small(), store, chunk=CHUNK)
    (store / ".progress-done").mkdir()  # whatever it may be, it is none of ours
    (store / ".progress-done" / "mine").write_bytes(b"mine")
    sweep(small(), store)
    assert (beside / "mine").read_bytes() == b"mine"
    found = contents(store)
    left = {name for name in found if name not in contents(done)}
    assert left == {*mine, ".progress-done/mine"}
    assert all((store / name).read_bytes() == b"mine" for name in left)
    assert {entry.name for entry in tmp_path.iterdir()} == {"keep.zarr", ".keep.zarr.new"}
    assert answer(Sweep.open(store).answer) == answer(Sweep.open(done).answer)


@pytest.mark.parametrize("place", [".", "inner/..", "inner/../../here", "inner/deeper/store"])
def test_a_store_may_be_any_folder_that_is_empty_or_not_there(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    here.chmod(0o750)
    monkeypatch.chdir(here)
    if place == "inner/../../here":
        (tmp_path / "inner").mkdir()
        monkeypatch.chdir(tmp_path / "inner")
        place = "../here"
    elif place == "inner/..":
        place = "../here/../here/."
    found = sweep(small(), place, chunk=CHUNK)
    assert contents(Path(place)) == contents(done)
    assert found.answer() == Sweep.open(done).answer()
    assert {entry.name for entry in tmp_path.iterdir()} <= {"here", "inner"}
    assert not list(tmp_path.rglob("*.new"))
    assert here.stat().st_mode & 0o777 == 0o750


@pytest.mark.parametrize("name", ["mine", ".progress/mine", ".progress/lock", ".progress"])
def test_a_folder_of_other_things_is_no_place_for_a_store(tmp_path: Path, name: str) -> None:
    (tmp_path / "store" / name).parent.mkdir(parents=True)
    (tmp_path / "store" / name).write_bytes(b"mine")
    with pytest.raises(
        InvalidArgument, match=r"which is not the store of a sweep: '.*zarr.json' cannot be rea"
    ):
        sweep(small(), tmp_path / "store")
    assert list(contents(tmp_path / "store")) == [name]
    assert (tmp_path / "store" / name).read_bytes() == b"mine"


@pytest.mark.parametrize("left", [[], ["lock"], ["lock", "writing"]])
def test_a_store_of_a_process_that_died_at_once_is_begun_again(
    done: Path, tmp_path: Path, left: list[str]
) -> None:
    (tmp_path / "store" / ".progress").mkdir(parents=True)
    for name in left:
        (tmp_path / "store" / ".progress" / name).touch()
    sweep(small(), tmp_path / "store", chunk=CHUNK)
    assert contents(tmp_path / "store") == contents(done)


def test_of_many_that_begin_a_store_at_once_one_writes(done: Path, tmp_path: Path) -> None:
    run, store = small(), tmp_path / "store"
    description, gate, found = determined_by(run), threading.Barrier(8), []

    def begin() -> None:
        gate.wait()
        found.append(answer(lambda: Store(store, run, description, CHUNK)))

    for _ in range(5):
        found.clear()
        threads = [threading.Thread(target=begin) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        (one,) = (each for each in found if isinstance(each, Store))
        refused = [str(each) for each in found if each is not one]
        assert refused == [f"store is {str(store)!r}, which another process is writing"] * 7
        one.__exit__()
    sweep(run, store)
    assert contents(store) == contents(done)


def test_of_two_sweeps_at_once_none_spoils_what_the_other_does(done: Path, tmp_path: Path) -> None:
    found: list[Any] = []
    for round_ in range(3):
        store = tmp_path / f"store{round_}"
        threads = [
            threading.Thread(
                target=lambda s=store: found.append(answer(lambda: sweep(small(), s, chunk=CHUNK)))
            )
            for _ in range(2)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert contents(store) == contents(done)
    assert sum(isinstance(each, Sweep) for each in found) >= 3
    refused = [str(each) for each in found if not isinstance(each, Sweep)]
    assert all(each.endswith("which another process is writing") for each in refused)


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


def nodes(tree: dict[str, Any]) -> dict[str, Any]:
    return dict(tree["consolidated_metadata"]["metadata"])


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (of_ours(chunk=0), "damaged: it is not what was written"),
        (of_ours(chunk="64"), "damaged: it is not what was written"),
        (of_ours(digest=None), "damaged: 'digest'"),
        (of_ours(digest=3), "damaged: it is not"),
        (of_ours(arrays=["gone"]), "damaged: 'gone'"),
        (of_ours(arrays=3), "damaged: 'int' object is not iterable"),
        (of_ours(determined_by={}), "damaged: it is not"),
        (of_ours(rivals="gain"), "damaged: it is not"),
        (edited(lambda tree: tree.pop("consolidated_metadata")), "damaged: 'consolidated_metadata'"),
        (edited(lambda tree: tree.pop("attributes")), "not the store of a sweep.* it lacks 'attributes'"),
        (edited(lambda tree: tree.update(attributes=[])), "not the store of a sweep"),
        (edited(lambda tree: tree["attributes"].update(errors_from_s=1.0)), "damaged: it is not"),
        (edited(lambda tree: nodes(tree)["max_error"].update(shape=[2, 21, 3])), "damaged: it is not"),
        (edited(lambda tree: nodes(tree)["max_error"].update(data_type="float32")), "damaged: it is not"),
        (
            edited(lambda tree: nodes(tree)["max_error"].update(codecs=[{"name": "unheard"}])),
            "damaged: it is not",
        ),
        (edited(lambda tree: nodes(tree)["time"].pop("codecs")), "damaged: it is not"),
        (lambda content: content[:1000], "not the store of a sweep.*: Unterminated string"),
        (lambda content: b"", "not the store of a sweep.*: Expecting value"),
        (lambda content: b"[" * 100_000, "not the store of a sweep.*recursion"),
        (lambda content: b"\xff" + content, "not the store of a sweep.*can't decode"),
    ],
)
def test_a_store_that_does_not_say_what_it_is_is_named(
    copy: Path, damage: Callable[[bytes], bytes], why: str
) -> None:
    file = copy / "zarr.json"
    content = file.read_bytes()
    file.write_bytes(damage(content))
    for call in (lambda: Sweep.open(copy), lambda: sweep(small(), copy)):
        found = answer(call)
        assert isinstance(found, InvalidArgument)
        assert re.search(rf"^store is '.*', (of )?which .*'{file}' .*", str(found))
        assert re.search(why, str(found))
    file.write_bytes(content)
    assert Sweep.open(copy).answer()


def resigned(name: str, **changed: Any) -> Callable[[bytes], bytes]:
    """Change what a store says of an array as somebody who knows how to make the digest."""

    def change(tree: dict[str, Any]) -> None:
        own, attributes = tree["consolidated_metadata"]["metadata"], tree["attributes"]
        own[name] = {**own.get(name, {}), **changed}
        mine = json.loads(attributes["pinmobile_sweep"])
        since = {"errors_from_s": attributes["errors_from_s"]}
        mine["digest"] = digest_of(
            {k: v for k, v in mine.items() if k != "digest"}, {k: own[k] for k in mine["arrays"]}, since
        )
        attributes["pinmobile_sweep"] = json.dumps(mine)

    return edited(change)


class Attack:
    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("attacked"),)


@pytest.mark.parametrize("name", ["coordinate", "extra"])
def test_a_store_runs_no_code(copy: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
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
    calls: tuple[Callable[[], Any], ...] = (lambda: Sweep.open(copy)), (lambda: sweep(small(), copy))
    for call in calls:
        with pytest.raises(
            InvalidArgument, match=f"array '{name}' is of .* expected numbers with the codecs"
        ):
            call()
    assert not (copy / "attacked").exists()


def test_a_store_declares_no_more_than_a_sweep_has(copy: Path) -> None:
    file, many = copy / "zarr.json", [400_000_000]
    grid_of = {"name": "regular", "configuration": {"chunk_shape": many}}
    file.write_bytes(resigned("time", shape=many, chunk_grid=grid_of)(file.read_bytes()))
    with pytest.raises(InvalidArgument, match="coordinate 'time' declares 400,000,000 numbers, above 10,0"):
        Sweep.open(copy)


@pytest.mark.parametrize("place", ["time/c/0", "coordinate/c/0", "max_distance/c/0/0"])
@pytest.mark.parametrize("first", [b"", bytes(488)])
def test_a_chunk_unpacks_to_no_more_than_it_holds(copy: Path, place: str, first: bytes) -> None:
    zstd = pytest.importorskip("numcodecs.zstd").Zstd(level=1, checksum=True)
    frames = (
        zstd.encode(first) + zstd.encode(bytes(200_000_000)) if first else zstd.encode(bytes(200_000_000))
    )
    (copy / place).write_bytes(frames)
    tracemalloc.start()
    try:
        with pytest.raises(InvalidArgument, match=f"of which '.*{place}' cannot be read: "):
            Sweep.open(copy).answer()
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()


def test_a_sweep_may_go_to_another_process(copy: Path) -> None:
    found = Sweep.open(copy)
    assert pickle.loads(pickle.dumps(found)).answer() == found.answer()


def test_what_others_write_into_the_metadata_is_no_damage(copy: Path) -> None:
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(copy, mode="r+", use_consolidated=False)
    group.update_attributes({"author": "somebody"})
    group.create_array("note", shape=(2,), dtype="f8", dimension_names=["extra"])
    with pytest.warns(UserWarning, match="Consolidated metadata"):
        zarr.consolidate_metadata(copy)
    assert Sweep.open(copy).answer() == Sweep.open(sweep(small(), copy).path).answer()


def numbers(path: Path) -> dict[str, Any]:
    """Return all that can be read of a store."""
    found = Sweep.open(path, small())
    read: dict[str, Any] = {"table": str(found)}
    for gain in (4, 16):
        one = found.ensemble(gain=gain)
        read |= {f"{name} {gain}": np.asarray(getattr(one, name)) for name in ("max_error", "rms_error")}
        read |= {f"{name} {gain}": np.asarray(getattr(one, name)) for name in ("max_force", "counts")}
        read |= {f"{name} {gain}": values for name, values in one.draws.items()}
    data = found.dataset[["gain", "time", "quantiles"]].load()
    return read | {name: data[name].values for name in ("gain", "time", "quantiles")}


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return all(np.array_equal(one[name], value) for name, value in other.items())


def removed(error: Exception, path: Path, file: Path, content: bytes) -> None:
    """Do what an error asks for: remove the file that it names, or put back what the store says of itself."""
    named = [Path(each) for each in re.findall(r"'([^']*)'", str(error))]
    inside = [each for each in named if each != path and path in each.parents]
    assert inside, error
    if inside[-1].is_dir():
        shutil.rmtree(inside[-1])
    else:
        inside[-1].unlink()
    if inside[-1] == path / "zarr.json":
        assert inside[-1] == file
        file.write_bytes(content)


def check_read(path: Path, file: Path, good: dict[str, Any]) -> bool:
    """Read a store of which a file is damaged, or gone and so not known; tell whether that is an error."""
    gone = not file.is_file()
    with little_memory(2 << 30):
        found = answer(lambda: numbers(path))
    if isinstance(found, InvalidArgument):
        assert str(path) in str(found) or (gone and "start the same sweep again to go on" in str(found))
        return True
    assert gone or same(found, good)
    return False


def check_resumed(path: Path, file: Path, good: dict[str, Any], store: dict[str, str], kept: bytes) -> None:
    """Go on with a store of which a file is damaged, doing what errors ask for."""
    found = resumed(path)
    for _ in range(2):
        if isinstance(found, InvalidArgument):
            removed(found, path, file, kept)
            found = resumed(path)
    assert same(found, good)
    assert {place: digest for place, digest in contents(path).items() if place != "zarr.json"} == {
        place: digest for place, digest in store.items() if place != "zarr.json"
    }


def files_of(store: Path) -> list[str]:
    return sorted(place for place in contents(store) if not place.endswith("lock"))


def replaced_by_a_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


def damage_file(file: Path, seed: int) -> None:
    file.write_bytes(damaged(file.read_bytes(), np.random.default_rng(seed)))


def resumed(path: Path) -> Any:
    """Return the numbers of a sweep that goes on, or the error of it."""
    return answer(lambda: numbers(sweep(small(), path, chunk=CHUNK).path))


DAMAGES: list[Callable[[Path], object]] = [
    Path.unlink,
    replaced_by_a_folder,
    lambda file: file.write_bytes(b""),
    *(partial(damage_file, seed=seed) for seed in range(6)),
]


def test_a_damaged_store_names_the_file_and_the_rest_is_kept(done: Path, tmp_path: Path, share: int) -> None:
    good, store = numbers(done), contents(done)
    # Of the metadata, which are all alike, a few: others are damaged above.
    names = [name for k, name in enumerate(files_of(done)) if not name.endswith("zarr.json") or k % 3 == 0]
    cases = [(name, DAMAGES[k % len(DAMAGES)]) for k, name in enumerate(names)]
    told = 0
    for number, (name, damage) in enumerate(cases[::share]):
        path = Path(shutil.copytree(done, tmp_path / str(number)))
        damage(path / name)
        told += check_read(path, path / name, good)
        if number % 12 == 0:  # the most of the time
            check_resumed(path, path / name, good, store, (done / name).read_bytes())
        shutil.rmtree(path)
    assert told > len(cases) / share / 3


def test_damaged_records_of_what_is_done_are_named_and_the_rest_is_kept(done: Path, tmp_path: Path) -> None:
    good, store = numbers(done), contents(done)
    half = begun(tmp_path / "half", 28)
    marks = [place for place in files_of(half) if place.startswith(".progress/")]
    assert len(marks) >= 3
    told = 0
    for number, seed in enumerate(range(16)):
        path = Path(shutil.copytree(half, tmp_path / str(number)))
        file, rng = path / marks[seed % len(marks)], np.random.default_rng(seed)
        kind = seed % 8
        content = file.read_bytes()
        with np.load(file) as archive:
            counts = archive["counts"]
        if kind < 4:
            file.write_bytes(damaged(content, rng))
        else:
            counts[(0, 0, 0)] += 1 if kind == 4 else 0
            counts = {5: counts[:-1], 6: counts.astype(float), 7: -counts}.get(kind, counts)
            np.savez_compressed(file, counts=counts)
        errors = []
        for _ in range(2):
            found = resumed(path)
            if isinstance(found, dict):
                break
            errors.append(found)
            assert re.search(
                rf"^a file of the store is '{file}', which .*; remove that file, and", str(found)
            )
            file.unlink()
        assert same(found, good)
        assert contents(path) == store
        assert errors or kind < 4
        told += bool(errors)
        shutil.rmtree(path)
    assert told >= 12
