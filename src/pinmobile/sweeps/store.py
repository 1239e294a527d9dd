"""The store of a sweep on disk: made at once, filled chunk by chunk, continued after any death.

One process writes. While it does, there is the folder ``.progress`` inside the store, with a file that it has
locked, one through which all others are written, and for each chunk that is done one with its counts, which
comes once the chunk's other numbers are there. A chunk without that file is computed and written again, to
the same bytes. When all are there, the folder goes, and with it every trace of how the store came to be.
Where files of a finished store are gone, those of their scenario are computed again. Nothing else in the
folders is touched.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.compiled import BINS
from pinmobile.errors import FileError, InvalidArgument
from pinmobile.files import arrays_of, refusals, write
from pinmobile.loop import (
    LEVELS,
    NOTE,
    SUMMED,
    Ensemble,
    Part,
    coordinates,
    drawn,
    drawn_name,
    miscounted,
    over_all,
    per_robot,
    summed,
)
from pinmobile.plant import Parameter
from pinmobile.sweeps.contents import METADATA, attributes_of, coordinates_of, digest_of
from pinmobile.sweeps.fingerprint import differences, other_format
from pinmobile.sweeps.grids import Grid, axis_of_rivals, imported

GO_ON = "what is done is in the store: start the same sweep again to go on"
"""What to do when a disk is full, or a cluster lost."""

_PROGRESS, _LOCK, _WRITING = ".progress", "lock", "writing"
_MARK = b"pinmobile sweep: the process that writes this store has locked this file\n"
_MOST = 4096  # bytes of an archive's member beside its numbers


class Job(NamedTuple):
    """A chunk: some robots of one scenario.

    Attributes
    ----------
    scenario : int
        Which scenario of the grid.
    start, stop : int
        The robots from `start` to before `stop`.
    """

    scenario: int
    start: int
    stop: int


class Store:
    """The store of one sweep, for one process to write.

    Parameters
    ----------
    path : Path
        Its folder; made where it is missing.
    grid : Grid
        The scenarios.
    description : mapping
        All that determines the numbers.
    chunk : int
        Robots in a chunk of a store that is made; one that is there keeps its own.

    Raises
    ------
    InvalidArgument
        If the folder is something else, belongs to another sweep, or is being written by another process.
    """

    def __init__(self, path: Path, grid: Grid, description: Mapping[str, Any], chunk: int) -> None:
        self.path, self.grid = path, grid
        self._lock: IO[bytes] | None = None
        try:
            with refusals("written", "store", path):
                if not (path / METADATA).exists():
                    self._make(description, chunk)
                self._open(description)
        except BaseException:
            self.__exit__()
            raise

    def _make(self, description: Mapping[str, Any], chunk: int) -> None:
        """Write the store without a number; the first file makes it one, and the others can be mended."""
        files = _empty_store(self.grid, description, chunk)
        inside = [entry.name for entry in self.path.iterdir()] if self.path.exists() else []
        if inside and not (inside == [_PROGRESS] and _is_ours(self.path / _PROGRESS)):
            attributes_of(self.path)  # which tells what it is not
        is_new = not self.path.exists()
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock = _locked(self.path)
            if not (self.path / METADATA).exists():
                for place, data in files.items():
                    self._write(place, data)
        except BaseException:
            if self._lock is not None:
                self._forget()
            if is_new:
                with suppress(OSError):
                    self.path.rmdir()  # where nothing is in it
            raise

    def _open(self, description: Mapping[str, Any]) -> None:
        there = attributes_of(self.path)
        other = other_format(self.path, there["determined_by"])
        if other:
            raise InvalidArgument(other)
        found = differences(there["determined_by"], description)
        if found:
            raise InvalidArgument(f"store is {str(self.path)!r}, which belongs to another sweep: {found}")
        self.chunk: int = there["chunk"]
        zarr = imported("zarr")
        # What is written is gathered here: of arrays, no more is read than what the store says of itself.
        as_content = imported("zarr.core.buffer").default_buffer_prototype().buffer.from_bytes
        self._gathered: dict[str, Any] = {METADATA: as_content((self.path / METADATA).read_bytes())}
        # Every chunk has a file, also one of nothing but NaN, so that one which is gone is missed.
        with zarr.config.set({"array.write_empty_chunks": True}):
            group = zarr.open_group(zarr.storage.MemoryStore(self._gathered), mode="r+")
            self._arrays: dict[str, Any] = {name: group[name] for name in there["arrays"]}
        places = [*(f"{name}/{METADATA}" for name in there["nodes"]), *coordinates_of(there["nodes"])]
        if self._lock is None and not self._is_finished(places):
            self._lock = _locked(self.path)
        # Looked at once more, since another process may have written until now.
        gone = [place for place in places if not (self.path / place).exists()]
        files = _empty_store(self.grid, description, self.chunk) if gone else {}
        for place in gone:
            self._write(place, files[place])
        for name, node in there["nodes"].items():
            _check_node(self.path / name / METADATA, node)
        self._whole = {k for k in range(len(self.grid)) if self._has_all(k)}

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *error: object) -> None:
        if self._lock is not None:
            self._lock.close()

    def jobs(self) -> list[Job]:
        """Return all chunks, done or not, in the order of the scenarios."""
        n, each = self.grid.n, self.chunk
        return [
            Job(k, start, min(start + each, n)) for k in range(len(self.grid)) for start in range(0, n, each)
        ]

    def waiting(self) -> list[Job]:
        """Return the chunks that are not done."""
        return [job for job in self.jobs() if not self._is_done(job)]

    def record(self, job: Job, draws: Mapping[str, Array], part: Part) -> None:
        """Write the numbers of a chunk, and then that it is done.

        Raises
        ------
        FileError
            If the system fails, such as of a full disk; the store is as good as it was.
        """
        where = (*self.grid.index(job.scenario), slice(job.start, job.stop))
        # Of a chunk as of a whole ensemble: what diverged, and when.
        records = Ensemble.of(self.grid.scenarios[job.scenario], draws, part)
        for name in per_robot(records.scenario):
            self._arrays[name][where] = getattr(records, name)
        for name, values in draws.items():
            self._arrays[drawn_name(name)][where] = values
        self._write_gathered()
        counts = BytesIO()
        np.savez_compressed(counts, counts=part.counts)
        self._write(self._marker(job), counts.getvalue())

    def finish(self) -> None:
        """Write what is summed over all chunks of a scenario, and remove the files kept while working.

        Raises
        ------
        InvalidArgument
            If the counts of a chunk cannot be read.
        FileError
            If the system fails, such as of a full disk; the store is as good as it was.
        """
        if self._lock is None:
            return
        counts: dict[int, NDArray[np.int32]] = {}
        for job in self.jobs():
            if job.scenario not in self._whole:
                counts[job.scenario] = self._counts(job) + counts.get(job.scenario, 0)
                if job.stop == self.grid.n:
                    self._sum_up(job.scenario, counts.pop(job.scenario))
        with refusals("written", "store", self.path):
            for job in self.jobs():
                (self.path / self._marker(job)).unlink(missing_ok=True)
            self._forget()

    def _counts(self, job: Job) -> NDArray[np.int32]:
        first, robots = self.grid.scenarios[0], job.stop - job.start
        shape = len(first.grid), len(first.channels)
        return _counts_of(self.path / self._marker(job), shape, robots=robots)

    def _forget(self) -> None:
        """Remove the folder ``.progress``, unless somebody has put something into it."""
        folder = self.path / _PROGRESS
        for name in (_WRITING, _LOCK):
            (folder / name).unlink(missing_ok=True)
        with suppress(OSError):
            folder.rmdir()

    def _write(self, place: str, data: bytes) -> None:
        file = self.path / place
        try:
            with refusals("written", "a file of the store", file):
                file.parent.mkdir(parents=True, exist_ok=True)
            write(file, data, name="a file of the store", through=self.path / _PROGRESS / _WRITING)
        except FileError as error:
            raise FileError(f"{error}; {GO_ON}", errno=error.errno, filename=error.filename) from error

    def _write_gathered(self) -> None:
        for place in [place for place in self._gathered if place != METADATA]:
            self._write(place, self._gathered.pop(place).to_bytes())

    def _sum_up(self, scenario: int, counts: NDArray[np.int32]) -> None:
        where = self.grid.index(scenario)
        for name, values in summed(counts, self.grid.scenarios[scenario].channels).items():
            self._arrays[name][where] = values
        self._write_gathered()

    def _marker(self, job: Job) -> str:
        return f"{_PROGRESS}/{job.scenario}-{job.start}.npz"

    def _is_done(self, job: Job) -> bool:
        if job.scenario in self._whole:
            return True
        written = (self.path / self._marker(job)).is_file()
        return written and self._has(self._per_robot(job.scenario), *job[:2])

    def _is_finished(self, places: Iterable[str]) -> bool:
        there = all((self.path / place).exists() for place in places)
        return (
            there and not (self.path / _PROGRESS).exists() and all(map(self._has_all, range(len(self.grid))))
        )

    def _has_all(self, scenario: int) -> bool:
        """Return whether all of a scenario is on disk; what is over all its chunks was written last."""
        starts = range(0, self.grid.n, self.chunk)
        names = self._per_robot(scenario)
        return self._has(SUMMED, scenario, 0) and all(self._has(names, scenario, k) for k in starts)

    def _per_robot(self, scenario: int) -> list[str]:
        one = self.grid.scenarios[scenario]
        return [*per_robot(one), *map(drawn_name, one.spread)]

    def _has(self, names: Iterable[str], scenario: int, start: int) -> bool:
        """Return whether the chunks of some arrays that hold robot `start` of a scenario are on disk."""
        outer = self.grid.index(scenario)
        for name in names:
            inner = [0] * (self._arrays[name].ndim - len(outer))
            if name not in SUMMED:
                inner[0] = start // self.chunk
            if not self.path.joinpath(name, "c", *map(str, (*outer, *inner))).is_file():
                return False
        return True


def _is_ours(folder: Path) -> bool:
    """Return whether the only thing in a folder is the beginning of a store."""
    if not folder.is_dir() or not {entry.name for entry in folder.iterdir()} <= {_LOCK, _WRITING}:
        return False
    lock = folder / _LOCK
    return not lock.exists() or _MARK.startswith(lock.read_bytes())


def _check_node(file: Path, node: object) -> None:
    """Refuse metadata of an array that differ from the store's; other readers than ours may use them."""
    try:
        if json.loads(file.read_bytes()) == node:
            return
        why = "it is not what was written"
    except (OSError, ValueError, RecursionError) as error:
        why = str(error)
    raise InvalidArgument(
        f"a file of the store is {str(file)!r}, which is damaged: {why}; remove that file, and start the "
        "same sweep again"
    )


def _locked(path: Path) -> IO[bytes]:
    """Return a file that only one process can hold; the system lets go of it when that process dies."""
    folder = path / _PROGRESS
    while True:
        folder.mkdir(exist_ok=True)
        with ExitStack() as opened:
            try:
                file = opened.enter_context((folder / _LOCK).open("ab", buffering=0))
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                held, there = os.fstat(file.fileno()), os.stat(folder / _LOCK)
            except FileNotFoundError:
                continue  # another process has just removed it
            except OSError as error:
                if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
                    raise
                raise InvalidArgument(f"store is {str(path)!r}, which another process is writing") from error
            if os.path.samestat(held, there):
                if not held.st_size:
                    _mark(file, folder)
                opened.pop_all()
                return file


def _mark(lock: IO[bytes], folder: Path) -> None:
    try:
        lock.write(_MARK)
    except OSError:
        (folder / _LOCK).unlink()
        folder.rmdir()
        raise


def _counts_of(marker: Path, shape: tuple[int, int], *, robots: int) -> NDArray[np.int32]:
    """Return the counts in the file that says that a chunk is done, shape (times, channels, BINS).

    Parameters
    ----------
    marker : Path
        The file.
    shape : (int, int)
        How many times of the bands, and channels.
    robots : int
        In the chunk: at each time, so many are counted.

    Raises
    ------
    InvalidArgument
        If it cannot be read, or holds something else.
    FileError
        If the system fails.
    """
    most = 4 * shape[0] * shape[1] * BINS + _MOST
    try:
        counts = arrays_of(
            marker, ["counts"], kind="record of a chunk", name="a file of the store", most=most
        )
        found: NDArray[np.int32] = counts["counts"]
        why = miscounted(found, *shape, robots)
        if why:
            raise InvalidArgument(f"a file of the store is {str(marker)!r}, which {why}")
    except InvalidArgument as error:
        raise InvalidArgument(f"{error}; remove that file, and start the same sweep again") from error
    return found


def _spread_of(grid: Grid) -> dict[str, Parameter]:
    found = {name: one for scenario in grid.scenarios for name, one in scenario.parameters.items()}
    return dict(sorted(found.items()))


def _empty_store(grid: Grid, description: Mapping[str, Any], chunk: int) -> dict[str, bytes]:
    """Return the files that a store has before any number is known, by their places in it.

    Parameters
    ----------
    grid : Grid
        Its scenarios.
    description : mapping
        All that determines the numbers.
    chunk : int
        Robots in a chunk of the arrays.
    """
    zarr = imported("zarr")
    files: dict[str, Any] = {}
    with zarr.config.set({"array.write_empty_chunks": True}):  # so that a coordinate of zeros has a file too
        _make_arrays(zarr.create_group(zarr.storage.MemoryStore(files)), grid, chunk)
    made = {place: content.to_bytes() for place, content in files.items()}
    begins = {scenario.after for scenario in grid.scenarios}
    since = {"errors_from_s": begins.pop()} if len(begins) == 1 else {}
    metadata = json.loads(made.pop(METADATA))
    nodes = {place.split("/")[0]: json.loads(made[place]) for place in made if place.endswith(METADATA)}
    mine: dict[str, Any] = {"chunk": chunk, "rivals": axis_of_rivals(grid.axes), "determined_by": description}
    mine |= {"arrays": list(nodes)}
    metadata["attributes"] = {
        "Conventions": NOTE,
        "pinmobile_sweep": json.dumps({**mine, "digest": digest_of(mine, nodes, since)}),
        **since,
    }
    # It is in no specification yet, but every reader that does not know it passes over it.
    consolidated = {"kind": "inline", "must_understand": False, "metadata": nodes}
    metadata["consolidated_metadata"] = consolidated
    return {METADATA: json.dumps(metadata, indent=2).encode(), **made}


def _make_arrays(group: Any, grid: Grid, chunk: int) -> None:
    codec = imported("zarr").codecs.ZstdCodec(level=0, checksum=True)  # what is damaged is noticed
    create = partial(group.create_array, compressors=codec)
    swept = [(name, list(axis.values), axis.unit, name) for name, axis in grid.axes.items()]
    first, n = grid.scenarios[0], grid.n
    for name, values, unit, meaning in [*swept, *coordinates(first)]:
        data = np.array(values, dtype=object if isinstance(values[0], str) else None)
        made = create(
            name,
            shape=data.shape,
            chunks=data.shape,
            dtype="string" if data.dtype == object else data.dtype,
            dimension_names=[name],
            attributes={**({"units": unit} if unit else {}), "long_name": meaning},
        )
        made[:] = data
    sizes = {"robot": n, "coordinate": len(first.coordinates), "input": len(first.inputs)}
    sizes |= {"time": len(first.grid), "bin": BINS, "level": len(LEVELS)}
    sizes |= {"measure": len(first.judged), "channel": len(first.channels)}
    variables = {**per_robot(first), **drawn(_spread_of(grid)), **over_all(first.channels)}
    for name, one in variables.items():
        chunks = [min(chunk, n) if each == "robot" else sizes[each] for each in one.dimensions]
        create(
            name,
            shape=(*grid.shape, *(sizes[each] for each in one.dimensions)),
            chunks=(*(1 for _ in grid.axes), *chunks),
            dtype=np.int32 if name == "counts" else np.float64,
            fill_value=np.int32(0) if name == "counts" else np.nan,
            dimension_names=[*grid.axes, *one.dimensions],
            attributes=one.attributes,
        )
