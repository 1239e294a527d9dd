"""Store of a sweep: a Zarr folder that one process writes, chunk by chunk, and that xarray reads.

A chunk of robots is done if all its files exist. Each file is written completely or not at all. After an
interruption, or after a loss of files, the sweep computes the chunks that are not done.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from hashlib import sha256
from itertools import chain
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import BINS
from pinmobile.errors import FileError, InvalidArgument, format_value, import_extra
from pinmobile.files import check_form, file_errors, write
from pinmobile.loop import (
    LEVELS,
    NOTE,
    Ensemble,
    Part,
    coordinates,
    draw_name,
    draw_vars,
    robot_vars,
    sum_vars,
    sums,
)
from pinmobile.sweeps._points import FORMAT, Points, differences

# The first sweep imports this module, because it needs these packages.
xarray: Any = import_extra("xarray", "sweeps", "a sweep")
zarr: Any = import_extra("zarr", "sweeps", "a sweep")

METADATA = "zarr.json"
RESTART = "start the same sweep again"
_LOCK, _PART_FILE = ".lock", ".writing"


class Job(NamedTuple):
    """Chunk of a sweep: the robots from `start` to before `stop` of a scenario."""

    scenario: int
    start: int
    stop: int


class Store:
    """Store of a sweep, for the process that writes it.

    Parameters
    ----------
    path : Path
        Folder; it is created if it does not exist.
    points : Points
        Scenarios of the sweep.
    description : mapping
        Everything that determines the numbers, see `describe`.
    chunk : int
        Number of robots in a chunk of a new store.

    Raises
    ------
    InvalidArgument
        If the folder has other contents, belongs to another sweep, or another process writes it.
    """

    def __init__(self, path: Path, points: Points, description: Mapping[str, Any], chunk: int) -> None:
        self.path, self.points = path, points
        is_new = not path.exists()
        with file_errors("written", "store", path):
            if not is_new and any(entry.name not in (_LOCK, _PART_FILE) for entry in path.iterdir()):
                attributes_of(path)  # rejects a folder with other contents
            path.mkdir(parents=True, exist_ok=True)
            self._lock = _lock_folder(path)
        try:
            self._open(description, chunk)
        except BaseException:
            self.__exit__()
            if is_new and not (path / METADATA).exists():
                with suppress(OSError):  # a folder that is not empty stays
                    path.rmdir()
            raise

    def _open(self, description: Mapping[str, Any], chunk: int) -> None:
        (self.path / _PART_FILE).unlink(missing_ok=True)  # left by a process that died
        if not (self.path / METADATA).exists():
            self._write(METADATA, _empty_store(self.points, description, chunk)[METADATA])
        attributes = attributes_of(self.path)
        words = differences(attributes["determined_by"], description)
        if words:
            raise InvalidArgument(f"store is {str(self.path)!r}, which belongs to another sweep: {words}")
        self.chunk: int = attributes["chunk"]
        for place, data in _empty_store(self.points, description, self.chunk).items():
            file = self.path / place
            with file_errors("read", "a file of the store", file):
                is_equal = file.is_file() and file.read_bytes() == data
            if place != METADATA and not is_equal:
                self._write(place, data)
        # Arrays are written to memory first, then to disk, each file completely or not at all.
        make_buffer = zarr.core.buffer.default_buffer_prototype().buffer.from_bytes
        self._buffer: dict[str, Any] = {METADATA: make_buffer((self.path / METADATA).read_bytes())}
        with zarr.config.set({"array.write_empty_chunks": True}):
            group = zarr.open_group(zarr.storage.MemoryStore(self._buffer), mode="r+")
            self._arrays: dict[str, Any] = {name: group[name] for name in attributes["nodes"]}
        for k in range(len(self.points.scenarios)):
            self._write_quantiles(k)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *error: object) -> None:
        (self.path / _LOCK).unlink(missing_ok=True)
        self._lock.close()

    def jobs(self, scenario: int) -> list[Job]:
        """Return all chunks of a scenario."""
        n, size = self.points.n, self.chunk
        return [Job(scenario, start, min(start + size, n)) for start in range(0, n, size)]

    def open_jobs(self) -> list[Job]:
        """Return the chunks that are not done."""
        jobs = chain.from_iterable(map(self.jobs, range(len(self.points.scenarios))))
        return [job for job in jobs if not self._is_done(job)]

    def record(self, job: Job, draws: Mapping[str, Array], part: Part) -> None:
        """Write the numbers of a chunk.

        Raises
        ------
        FileError
            If the system fails, for example because the disk is full; existing files remain.
        """
        index = (*self.points.index(job.scenario), slice(job.start, job.stop))
        records = Ensemble.of(self.points.scenarios[job.scenario], draws, part)
        for name in robot_vars(records.scenario):
            self._arrays[name][index] = getattr(records, name)
        for name, values in draws.items():
            self._arrays[draw_name(name)][index] = values
        self._arrays["counts"][(*index[:-1], job.start // self.chunk)] = part.counts
        self._flush()
        self._write_quantiles(job.scenario)

    def _write_quantiles(self, scenario: int) -> None:
        """Write the quantiles of a scenario if all its chunks are done."""
        if self._has("quantiles", scenario) or not all(map(self._is_done, self.jobs(scenario))):
            return
        index = self.points.index(scenario)
        with store_errors(self.path):
            counts = np.asarray(_open_group(self.path)["counts"][index].sum(axis=0), np.int32)
        arrays = sums(counts, self.points.scenarios[scenario].channels)
        self._arrays["quantiles"][index] = arrays["quantiles"]
        self._flush()

    def _flush(self) -> None:
        for place in [place for place in self._buffer if place != METADATA]:
            self._write(place, self._buffer.pop(place).to_bytes())

    def _write(self, place: str, data: bytes) -> None:
        file = self.path / place
        try:
            with file_errors("written", "a file of the store", file):
                file.parent.mkdir(parents=True, exist_ok=True)
            write(file, data, name="a file of the store", scratch=self.path / _PART_FILE)
        except FileError as error:
            message = f"{error}; finished chunks are in the store: {RESTART} to resume"
            raise FileError(message, errno=error.errno, filename=error.filename) from error

    def _is_done(self, job: Job) -> bool:
        scenario = self.points.scenarios[job.scenario]
        names = *robot_vars(scenario), *map(draw_name, scenario.spread), "counts"
        return all(self._has(name, job.scenario, job.start // self.chunk) for name in names)

    def _has(self, name: str, scenario: int, chunk: int = 0) -> bool:
        """Return whether the file of an array for a chunk exists."""
        inner = [chunk, *[0] * (self._arrays[name].ndim - len(self.points.axes) - 1)]
        return self.path.joinpath(name, "c", *map(str, (*self.points.index(scenario), *inner))).is_file()


def _lock_folder(path: Path) -> IO[bytes]:
    """Return a file that only one process can lock; the system releases the lock if the process dies."""
    while True:
        file = (path / _LOCK).open("ab")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(file.fileno()), os.stat(path / _LOCK)):
                return file
        except FileNotFoundError:
            pass
        except BlockingIOError as error:
            file.close()
            raise InvalidArgument(f"store is {str(path)!r}, which another process is writing") from error
        file.close()  # another process has just removed it


def _empty_store(points: Points, description: Mapping[str, Any], chunk: int) -> dict[str, bytes]:
    """Return the files of a store without numbers, by place."""
    files: dict[str, Any] = {}
    with zarr.config.set({"array.write_empty_chunks": True}):  # so that a coordinate of zeros has a file
        _make_arrays(zarr.create_group(zarr.storage.MemoryStore(files)), points, chunk)
    raw = {place: content.to_bytes() for place, content in files.items()}
    metadata = json.loads(raw.pop(METADATA))
    nodes = {place.split("/")[0]: json.loads(raw[place]) for place in raw if place.endswith(METADATA)}
    begins = {scenario.after for scenario in points.scenarios}
    data = {"chunk": chunk, "determined_by": description}
    onset = {"errors_from_s": begins.pop()} if len(begins) == 1 else {}
    metadata["attributes"] = {
        "Conventions": NOTE,
        "pinmobile_sweep": json.dumps({**data, "digest": digest_of(data, nodes, onset), "arrays": [*nodes]}),
        **onset,
    }
    # Not in the specification; other readers ignore it.
    metadata["consolidated_metadata"] = {"kind": "inline", "must_understand": False, "metadata": nodes}
    return {METADATA: json.dumps(metadata, indent=2).encode(), **raw}


def _make_arrays(group: Any, points: Points, chunk: int) -> None:
    codec = zarr.codecs.ZstdCodec(level=0, checksum=True)
    first, n, chunk = points.scenarios[0], points.n, min(chunk, points.n)
    axes = [(name, list(axis.values), axis.unit, name) for name, axis in points.axes.items()]
    for name, values, unit, meaning in [*axes, *coordinates(first)]:
        data = np.array(values, dtype=object if isinstance(values[0], str) else None)
        options = {"shape": data.shape, "chunks": data.shape, "dimension_names": [name], "compressors": codec}
        kind = "string" if data.dtype == object else data.dtype
        attributes = {**({"units": unit} if unit else {}), "long_name": meaning}
        group.create_array(name, dtype=kind, attributes=attributes, **options)[:] = data
    sizes = {"robot": n, "coordinate": len(first.coordinates), "input": len(first.inputs)}
    sizes |= {"time": len(first.grid), "bin": BINS, "level": len(LEVELS), "chunk": -(-n // chunk)}
    sizes |= {"metric": len(first.recorded_metrics), "channel": len(first.channels)}
    spread = {name: x for scenario in points.scenarios for name, x in scenario.parameters.items()}
    variables = {**robot_vars(first), **draw_vars(dict(sorted(spread.items()))), **sum_vars(first.channels)}
    counts = variables["counts"]
    variables["counts"] = counts._replace(dimensions=("chunk", *counts.dimensions))
    for name, x in variables.items():
        chunks = [{"robot": chunk, "chunk": 1}.get(dimension, sizes[dimension]) for dimension in x.dimensions]
        group.create_array(
            name,
            shape=(*points.shape, *(sizes[dimension] for dimension in x.dimensions)),
            chunks=(*(1 for _ in points.axes), *chunks),
            dtype=np.int32 if name == "counts" else np.float64,
            fill_value=0 if name == "counts" else np.nan,
            dimension_names=[*points.axes, *x.dimensions],
            attributes=x.attributes,
            compressors=codec,
        )


def digest_of(record: Mapping[str, Any], nodes: Mapping[str, Any], onset: Mapping[str, Any]) -> str:
    """Return the digest of a store's own metadata; the digest ignores other entries of the file."""
    return sha256(json.dumps([record, nodes, onset], sort_keys=True).encode()).hexdigest()


def attributes_of(path: Path) -> dict[str, Any]:
    """Return a store's own metadata, with those of its arrays as ``nodes``.

    Raises
    ------
    InvalidArgument
        If the folder is not the store of a sweep, or its metadata are damaged or name codecs that may run
        code.
    """
    file, is_ours = path / METADATA, False
    try:
        metadata = json.loads(file.read_bytes())
        record: dict[str, Any] = json.loads(metadata["attributes"]["pinmobile_sweep"])
        check_form(record["determined_by"]["format"], FORMAT)
        is_ours = True
        digest, arrays = record.pop("digest"), record.pop("arrays")
        consolidated = metadata["consolidated_metadata"]["metadata"]
        nodes = {name: consolidated[name] for name in arrays}
        onset = {name: x for name, x in metadata["attributes"].items() if name == "errors_from_s"}
        if digest_of(record, nodes, onset) != digest:
            raise ValueError("its digest differs")
        for name, node in consolidated.items():
            _check_plain(name, node)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else f"{error}"
        state = "is damaged" if is_ours else "is not the store of a sweep"
        raise InvalidArgument(
            f"store is {str(path)!r}, which {state}: {str(file)!r} cannot be read: {reason}"
        ) from error
    return {**record, "nodes": nodes}


def _check_plain(name: str, node: Mapping[str, Any]) -> None:
    """Reject an array with codecs that may run code."""
    if node["zarr_format"] == 3 and node["node_type"] == "group":
        return
    codecs = [codec["name"] if isinstance(codec, dict) else codec for codec in node.get("codecs", ())]
    kind = "text" if node.get("data_type") == "string" else np.dtype(node.get("data_type")).kind
    is_plain = kind in ("text", *"biuf") and node["zarr_format"] == 3 and not node.get("storage_transformers")
    if not is_plain or codecs != ["vlen-utf8" if kind == "text" else "bytes", "zstd"]:
        message = f"array {format_value(name)} has the codecs {format_value(codecs)}"
        raise ValueError(f"{message}, expected plain numbers or text")


def _open_group(path: Path) -> Any:
    return zarr.open_group(path, mode="r", zarr_format=3, use_consolidated=True)


def open_dataset(path: Path) -> Any:
    """Return a store as an xarray.Dataset that reads its files when they are needed."""
    for name, node in attributes_of(path)["nodes"].items():
        file = path / name / "c" / "0"
        if node["dimension_names"] == [name] and not file.is_file():
            raise InvalidArgument(f"store is {str(path)!r}, in which {str(file)!r} is missing; {RESTART}")
    with store_errors(path):
        return xarray.open_zarr(path, chunks=None, consolidated=True, zarr_format=3)


@contextmanager
def store_errors(path: Path) -> Iterator[None]:
    """Raise an error that names a damaged file of a store."""
    try:
        yield
    except Exception as error:  # codecs may raise any error
        raise InvalidArgument(
            f"store is {str(path)!r}, in which {_find_damage(path)}; remove that file, and {RESTART}"
        ) from error


def _find_damage(path: Path) -> str:
    """Return the name of the damaged file of a store, and the reason."""
    group = _open_group(path)
    for name in attributes_of(path)["nodes"]:
        for file in sorted((path / name / "c").rglob("*")):
            place = file.relative_to(path / name / "c").parts
            if file.is_file() and all(part.isdecimal() for part in place):
                try:
                    group[name].blocks[tuple(map(int, place))]
                except Exception as error:  # codecs may raise any error
                    return f"{str(file)!r} cannot be read: {error}"
    return "a file cannot be read"
