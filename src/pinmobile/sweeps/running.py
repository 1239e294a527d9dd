"""`sweep`, the verb: ensembles along named axes, into a store that outlives any interruption."""

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any
from warnings import warn

from pinmobile.arrays import callable_as, location, whole
from pinmobile.ensembles import Scenario
from pinmobile.ensembles.ways import way_of
from pinmobile.errors import InvalidArgument, SlowerEngine
from pinmobile.sweeps.cluster import check_client
from pinmobile.sweeps.extras import imported
from pinmobile.sweeps.grids import Grid, as_grid
from pinmobile.sweeps.origin import determined_by
from pinmobile.sweeps.reading import METADATA
from pinmobile.sweeps.result import Sweep
from pinmobile.sweeps.store import Job, Store
from pinmobile.sweeps.workers import in_process, on_cluster

__all__ = ["check_draws", "sweep"]

_CHUNK = 16384

Progress = Callable[[int, int], None]


def sweep(
    scenarios: Grid | Mapping[str, Scenario] | Sequence[Scenario] | Scenario,
    store: str | PathLike[str],
    *,
    client: Any = None,
    chunk: int | None = None,
    progress: Progress | None = None,
) -> Sweep:
    """Run the ensembles of a grid, and keep their records in a Zarr store that xarray reads.

    The work is divided into chunks of robots. This process alone writes the store; the numbers of a chunk are
    the same bit for bit wherever it is computed. A sweep that was interrupted, even killed, goes on where it
    was when it is started again with the same arguments, and ends with the very same store. Where files of a
    store are gone, their numbers are computed again.

    Parameters
    ----------
    scenarios : Grid, mapping of str to Scenario, sequence of Scenario, or Scenario
        What is run: a `grid`, or scenarios along one axis called ``scenario``, on which a single one is
        number 0. All have as many robots, and their bands at the same times. An axis of controllers is what
        `Sweep.answer` compares.
    store : path
        Folder of the store; made where it is missing, continued where it is that of this sweep.
    client : distributed.Client, optional
        The Dask cluster that computes; pinmobile must be installed there too. By default, this process does,
        on all cores.
    chunk : int, optional
        Robots in a chunk; by default 16384, or what the store has.
    progress : callable, optional
        Called as ``progress(done, total)`` in robots, first with what the store has, then after each chunk.

    Returns
    -------
    sweep : Sweep

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, draws are impossible, the store belongs to another sweep (the
        message says what differs), a scenario holds what cannot be recognised the next time, or a package of
        the extra is missing.
    FileError
        If the system fails, such as of a full disk; what is done is kept.
    SchedulerError
        If the cluster has no worker, or is lost; what is done is kept.

    Warns
    -----
    SlowerEngine
        If parts keep what is left to run from the fastest engine; it names them and what to write instead.
    """
    for package in ("zarr", "xarray"):
        imported(package)
    grid, path = as_grid(scenarios), location("store", store)
    size = _CHUNK if chunk is None else whole("chunk", chunk)
    if client is not None:
        check_client(client)
    if progress is not None:
        callable_as("progress(done, total)", progress)
    description = determined_by(grid)
    if not (path / METADATA).exists():
        check_draws(grid)
    with Store(path, grid, description, size) as opened:
        if chunk is not None and opened.chunk != size:
            raise InvalidArgument(f"chunk is {size}, expected {opened.chunk} as in the store, or None")
        waiting = opened.waiting()
        done, total = len(grid) * grid.n - sum(map(_robots, waiting)), len(grid) * grid.n
        _warn_if_slower(grid, waiting)
        if progress is not None:
            progress(done, total)
        for job, draws, part in _results(grid, waiting, client):
            opened.record(job, draws, part)
            done += _robots(job)
            if progress is not None:
                progress(done, total)
        opened.finish()
    return Sweep.open(path, grid)


def check_draws(grid: Grid) -> None:
    """Refuse impossible draws before any work, with the share of all robots.

    Raises
    ------
    InvalidArgument
        If there are; the message says at which place of the grid.
    """
    for k, scenario in enumerate(grid.scenarios):
        try:
            scenario.draws()
        except InvalidArgument as error:
            raise InvalidArgument(f"{error} (at {grid.place(k)})") from error


def _warn_if_slower(grid: Grid, jobs: Sequence[Job]) -> None:
    """Tell once, here and not where chunks are computed, which parts keep what is to run from the fastest."""
    reasons: dict[str, list[int]] = {}
    for k in sorted({job.scenario for job in jobs}):
        way = way_of(grid.scenarios[k])
        if way.why:
            reasons.setdefault(f"by {way.engine!r}, {way.engine.value}; {way.why}", []).append(k)
    told = []
    for reason, places in reasons.items():
        more = f" and {len(places) - 1} more" if len(places) > 1 else ""
        told.append(f"{reason} (at {grid.place(places[0])}{more})")
    if told:
        warn(f"this sweep runs {'; '.join(told)}", SlowerEngine, stacklevel=3)


def _results(grid: Grid, jobs: Sequence[Job], client: Any) -> Any:
    if not jobs:
        return ()
    return in_process(grid, jobs) if client is None else on_cluster(grid, jobs, client)


def _robots(job: Job) -> int:
    return job.stop - job.start
