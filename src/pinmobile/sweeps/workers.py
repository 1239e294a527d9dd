"""`sweep`: chunks of ensembles, computed by this process or a Dask cluster, into a store."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from os import PathLike
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Any, TypeAlias
from warnings import warn

import numpy as np

from pinmobile.arrays import Array, callable_as, location, text, whole
from pinmobile.compiled import processors
from pinmobile.errors import InvalidArgument, SchedulerError, SlowerEngine, shown
from pinmobile.loop import Part, part_of, way_of
from pinmobile.sweeps.code import packed, part_of_packed
from pinmobile.sweeps.contents import METADATA, Sweep
from pinmobile.sweeps.fingerprint import determined_by
from pinmobile.sweeps.grids import Grid, Scenarios, as_grid, imported
from pinmobile.sweeps.store import GO_ON, Job, Store

_ANSWER = 10.0  # seconds that a scheduler has to answer, and to have a worker
_ALONE = 60.0  # seconds that a cluster may be without a worker: a dead one is often started again


def check_client(client: object) -> None:
    """Refuse anything but a client that is connected.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    kind = imported("distributed").Client
    if not isinstance(client, kind):
        raise InvalidArgument(f"client is a {type(client).__name__}, expected a distributed.Client")
    if client.status != "running" or client.asynchronous:
        state = client.status if client.status != "running" else "asynchronous"
        raise InvalidArgument(f"client is {state}, expected one that is connected to its scheduler")


def connected(address: str, timeout: float = _ANSWER) -> Any:
    """Return a `distributed.Client` of the scheduler at an address.

    Parameters
    ----------
    address : str
        Such as ``tcp://127.0.0.1:8786``.
    timeout : float
        Time that it has to answer [s].

    Raises
    ------
    SchedulerError
        If it does not, or what answers is something else.
    InvalidArgument
        If it is no address.
    """
    import asyncio  # here, because most sweeps have no cluster

    distributed = imported("distributed")
    try:
        distributed.comm.resolve_address(address)
    except OSError:
        pass  # an unknown host, of which the connection tells
    except (ValueError, TypeError) as error:
        raise InvalidArgument(
            f"scheduler is {shown(address)}, expected an address such as tcp://127.0.0.1:8786"
        ) from error
    try:
        with ThreadPoolExecutor(1) as pool:  # a notebook's thread has a loop of its own
            kind = pool.submit(asyncio.run, asyncio.wait_for(_kind(address, timeout), timeout)).result()
        if kind == "Scheduler":
            return distributed.Client(address, timeout=timeout)
    except (OSError, TimeoutError) as error:
        raise SchedulerError(f"scheduler {address} does not answer within {timeout:g} s") from error
    except Exception as error:  # what it says is read as a length, a header, a message: all of it can fail
        raise SchedulerError(f"{address} is no Dask scheduler: what it answers is not Dask's") from error
    raise SchedulerError(f"{address} is no Dask scheduler but a {kind}")


async def _kind(address: str, timeout: float) -> str:
    """Return what a server of Dask says it is; a client would wait without end for one that is silent."""
    distributed = imported("distributed")
    comm = await distributed.comm.connect(address, timeout=timeout)
    try:
        told = await distributed.core.send_recv(comm, op="identity")
    finally:
        comm.abort()
    return str(told["type"])


class Watch:
    """Whether a cluster is still there.

    Parameters
    ----------
    client : distributed.Client
        Of the cluster.
    """

    def __init__(self, client: Any) -> None:
        self.client, self.address = client, client.scheduler.address
        self.alive = monotonic()

    def connected(self) -> None:
        """Refuse to go on where the connection is lost.

        Raises
        ------
        SchedulerError
            If it is.
        """
        if self.client.status != "running":
            raise SchedulerError(f"scheduler {self.address} is gone; {GO_ON}")

    def begin(self) -> None:
        """Wait for the first worker, but not for long.

        Raises
        ------
        SchedulerError
            If none comes, or the connection is lost.
        """
        self.connected()
        if self.client.nthreads():
            return
        try:
            self.client.wait_for_workers(1, timeout=_ANSWER)
        except OSError as error:
            raise SchedulerError(f"scheduler {self.address} has no worker after {_ANSWER:g} s") from error

    def look(self) -> None:
        """Refuse to go on where the connection is lost, or where there has been no worker for too long.

        Raises
        ------
        SchedulerError
            If that is so.
        """
        self.connected()
        if self.client.nthreads():
            self.alive = monotonic()
        elif monotonic() - self.alive > _ALONE:
            raise SchedulerError(f"scheduler {self.address} has had no worker for {_ALONE:g} s; {GO_ON}")


_LOOK = 2.0  # seconds between two looks at a cluster from which nothing comes

Results: TypeAlias = Iterator[tuple[Job, dict[str, Array], Part]]


def in_process(grid: Grid, jobs: Sequence[Job]) -> Results:
    """Yield the draws and records of the jobs, in any order, by a thread for each processor."""
    workers = processors()
    with ThreadPoolExecutor(workers) as pool:

        def submit(job: Job) -> Any:
            scenario = grid.scenarios[job.scenario]
            return pool.submit(part_of, scenario, job.start, job.stop)

        def drop(futures: Iterable[Any]) -> None:
            for future in futures:
                future.cancel()

        yield from _collected(submit, jobs, workers + 1, lambda future: future.result(), lambda: None, drop)


def on_cluster(grid: Grid, jobs: Sequence[Job], client: Any) -> Results:
    """Yield the draws and records of the jobs, in any order, by the workers of a cluster.

    Raises
    ------
    SchedulerError
        If the scheduler or all workers are gone, or workers die of a job.
    """
    distributed = imported("distributed")
    seen = Watch(client)
    seen.begin()

    def submit(job: Job) -> Any:
        seen.connected()
        scenario = grid.scenarios[job.scenario].holding(job.start, job.stop)
        with_code = packed(scenario)
        if with_code is None:
            return client.submit(part_of, scenario, job.start, job.stop, pure=False)
        return client.submit(part_of_packed, with_code, job.start, job.stop, pure=False)

    def answer(future: Any) -> Any:
        while True:
            try:
                draws, part = future.result(timeout=_LOOK)
                return draws, Part(*map(np.array, part))  # what came over the wire may be read-only
            except distributed.TimeoutError:
                seen.look()  # it is fetched from the worker, or computed again where that one is gone
            except distributed.KilledWorker as error:
                raise SchedulerError(
                    f"workers of {seen.address} died of a chunk again and again: {error}"
                ) from error
            except distributed.CancelledError as error:
                raise SchedulerError(f"scheduler {seen.address} dropped a chunk; {GO_ON}") from error

    def drop(futures: Iterable[Any]) -> None:
        if client.status == "running":  # otherwise nobody is left to be told
            client.cancel(list(futures))

    width = 2 * max(1, sum(client.nthreads().values()))
    try:
        yield from _collected(submit, jobs, width, answer, seen.look, drop)
    except distributed.comm.CommClosedError as error:
        raise SchedulerError(f"scheduler {seen.address} is gone; {GO_ON}") from error


def _collected(
    submit: Callable[[Job], Any],
    jobs: Sequence[Job],
    width: int,
    answer: Callable[[Any], Any],
    look: Callable[[], None],
    drop: Callable[[Iterable[Any]], None],
) -> Results:
    """Keep `width` jobs under way, so that no more results wait to be written than that."""
    done: SimpleQueue[Job] = SimpleQueue()
    left, under_way = iter(jobs), {}

    def send(job: Job) -> None:
        under_way[job] = submit(job)
        under_way[job].add_done_callback(lambda _: done.put(job))

    try:
        for job in left:
            send(job)
            if len(under_way) == width:
                break
        while under_way:
            job = _next(done, look)
            result = answer(under_way[job])
            del under_way[job]
            for following in left:
                send(following)
                break
            yield job, *result
    finally:
        drop(under_way.values())


def _next(done: SimpleQueue[Job], look: Callable[[], None]) -> Job:
    while True:
        try:
            return done.get(timeout=_LOOK)
        except Empty:
            look()


_CHUNK = 16384

Progress = Callable[[int, int], None]


def sweep(
    scenarios: Scenarios,
    store: str | PathLike[str],
    *,
    client: Any = None,
    chunk: int | None = None,
    progress: Progress | None = None,
    version: str | None = None,
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
    version : str, optional
        A word for what a store cannot recognise, such as a function without a source or an object of a
        compiled package: change it whenever that changes. Without such things it is not needed.

    Returns
    -------
    sweep : Sweep

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, draws are impossible, the store belongs to another sweep (the
        message says what differs), a scenario holds what cannot be recognised the next time and there is no
        `version`, or a package of the extra is missing.
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
    if version is not None and not text("version", version).strip():
        raise InvalidArgument(f'version is {shown(version)}, expected a word, such as "1"')
    description = determined_by(grid, version)
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
    """Warn once, here and not where chunks are computed, of parts that rule out the fastest engine."""
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
