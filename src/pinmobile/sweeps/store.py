"""The store of a sweep on disk: made at once, filled chunk by chunk, continued after any death.

One process writes. What is done stands in the folder ``.progress`` inside the store: for each chunk a file
with its counts, put there by a rename once the chunk's other numbers are written. A chunk without that file
is computed and written again, to the same bytes. When all are there, the folder goes, and with it every trace
of how the store came to be. Where files of a finished store are gone, the folder comes back, with a file for
each scenario that is whole.
"""

import fcntl
import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.ensembles import Ensemble, Part
from pinmobile.ensembles.histogram import quantiles
from pinmobile.errors import InvalidArgument, shown
from pinmobile.sweeps.extras import imported
from pinmobile.sweeps.grids import Grid
from pinmobile.sweeps.layout import LEVELS, PER_ROBOT, make_arrays, mend_coordinates
from pinmobile.sweeps.origin import differences
from pinmobile.sweeps.reading import attributes_of, counts_of
from pinmobile.sweeps.table import axis_of_rivals

__all__ = ["Job", "Store"]

_PROGRESS, _GOING = ".progress", ".progress-done"
_SUMMED = ("counts", "distance_quantile", "heading_quantile")  # over all robots of a scenario


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
        try:
            if not (path.exists() and any(path.iterdir())):
                _make(path, grid, description, chunk)
        except OSError as error:
            raise InvalidArgument(
                f"store is {shown(str(path))}, which cannot be made: {error.strerror}"
            ) from error
        there = attributes_of(path)
        found = differences(there["determined_by"], description)
        if found:
            raise InvalidArgument(f"store is {shown(str(path))}, which belongs to another sweep: {found}")
        self.chunk: int = there["chunk"]
        zarr = imported("zarr")
        # Every chunk has a file, also one of nothing but NaN, so that one which is gone is missed.
        with zarr.config.set({"array.write_empty_chunks": True}):
            group = zarr.open_group(path, mode="r+")
            self._arrays: dict[str, Any] = {name: group[name] for name in there["arrays"]}
        self._mend()
        self._lock = _locked(path)
        self._clean()

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *error: object) -> None:
        if self._lock is not None:
            self._lock.close()

    @property
    def complete(self) -> bool:
        """Whether everything is there."""
        return not (self.path / _PROGRESS).exists()

    def jobs(self) -> list[Job]:
        """Return all chunks, done or not, in the order of the scenarios."""
        n, each = self.grid.n, self.chunk
        return [
            Job(k, start, min(start + each, n)) for k in range(len(self.grid)) for start in range(0, n, each)
        ]

    def waiting(self) -> list[Job]:
        """Return the chunks that are not done."""
        return [] if self.complete else [job for job in self.jobs() if not self._is_done(job)]

    def record(self, job: Job, draws: Mapping[str, Array], part: Part) -> None:
        """Write the numbers of a chunk, and then that it is done."""
        where = (*self.grid.index(job.scenario), slice(job.start, job.stop))
        # Of a chunk as of a whole ensemble: what diverged, and when.
        records = Ensemble.of(self.grid.scenarios[job.scenario], draws, part)
        for name in PER_ROBOT:
            self._arrays[name][where] = getattr(records, name)
        for name, values in draws.items():
            self._arrays[f"drawn_{name}"][where] = values
        marker = self._marker(job)
        unfinished = marker.with_suffix(".new")
        with unfinished.open("wb") as file:
            np.savez_compressed(file, counts=part.counts)
        unfinished.replace(marker)

    def finish(self) -> None:
        """Write what is over all chunks of a scenario, and remove the traces of the way there."""
        if self.complete:
            return
        counts: dict[int, Any] = {}
        for job in self.jobs():
            if self._whole(job.scenario).exists():
                continue
            counts[job.scenario] = counts_of(self._marker(job)) + counts.get(job.scenario, 0)
            if job.stop == self.grid.n:
                self._sum_up(job.scenario, counts.pop(job.scenario))
        (self.path / _PROGRESS).rename(self.path / _GOING)
        shutil.rmtree(self.path / _GOING)

    def _sum_up(self, scenario: int, counts: Any) -> None:
        where = self.grid.index(scenario)
        self._arrays["counts"][where] = counts
        found = quantiles(counts.astype(np.int64), np.array(LEVELS))
        self._arrays["distance_quantile"][where] = found[..., 0]
        self._arrays["heading_quantile"][where] = found[..., 1]

    def _marker(self, job: Job) -> Path:
        return self.path / _PROGRESS / f"{job.scenario}-{job.start}.npz"

    def _whole(self, scenario: int) -> Path:
        return self.path / _PROGRESS / f"{scenario}.whole"

    def _is_done(self, job: Job) -> bool:
        if self._whole(job.scenario).exists():
            return True
        return self._marker(job).exists() and self._has(self._per_robot(job.scenario), *job[:2])

    def _per_robot(self, scenario: int) -> list[str]:
        return [*PER_ROBOT, *(f"drawn_{name}" for name in self.grid.scenarios[scenario].spread)]

    def _has(self, names: Iterable[str], scenario: int, start: int) -> bool:
        """Tell whether the chunks of some arrays that hold robot `start` of a scenario are on disk."""
        outer = self.grid.index(scenario)
        for name in names:
            inner = [0] * (self._arrays[name].ndim - len(outer))
            if name not in _SUMMED:
                inner[0] = start // self.chunk
            if not self.path.joinpath(name, "c", *map(str, (*outer, *inner))).exists():
                return False
        return True

    def _mend(self) -> None:
        """Begin again with the scenarios of a finished store of which files are gone."""
        mend_coordinates(self.path, self.grid)
        if not self.complete:
            return
        broken = {k for k in range(len(self.grid)) if not self._has(_SUMMED, k, 0)}
        broken |= {job[0] for job in self.jobs() if not self._has(self._per_robot(job[0]), *job[:2])}
        if broken:
            made = self.path / f"{_PROGRESS}.new"
            shutil.rmtree(made, ignore_errors=True)
            made.mkdir()
            for k in set(range(len(self.grid))) - broken:
                (made / f"{k}.whole").touch()
            made.rename(self.path / _PROGRESS)

    def _clean(self) -> None:
        """Remove what a process left that was killed while it wrote a file."""
        for left in (*self.path.rglob("*.partial"), *self.path.glob(f"{_PROGRESS}/*.new")):
            left.unlink(missing_ok=True)
        shutil.rmtree(self.path / _GOING, ignore_errors=True)


def _make(path: Path, grid: Grid, description: Mapping[str, Any], chunk: int) -> None:
    """Make the empty store beside its place, and put it there whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    made = path.parent / f".{path.name}.new"
    shutil.rmtree(made, ignore_errors=True)
    mine = {"chunk": chunk, "rivals": axis_of_rivals(grid.axes), "determined_by": description}
    attributes = {
        "Conventions": "units and long_name of each variable; robot i of a scenario is row i",
        "pinmobile_sweep": json.dumps(mine),
    }
    make_arrays(made, grid, chunk, attributes)
    (made / _PROGRESS).mkdir()
    made.rename(path)


def _locked(path: Path) -> IO[bytes] | None:
    """Return a file that only one process can hold; the system lets go of it when that process dies."""
    folder = path / _PROGRESS
    if not folder.exists():
        return None
    file = (folder / "lock").open("wb")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        raise InvalidArgument(f"store is {shown(str(path))}, which another process is writing") from error
    return file
