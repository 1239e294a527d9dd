"""Where chunks are computed: by the threads of this process, or by the workers of a Dask cluster."""

import asyncio
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Any, TypeAlias

import numpy as np

from pinmobile.arrays import Array
from pinmobile.ensembles import Part, part_of
from pinmobile.ensembles.stretches import processors
from pinmobile.errors import InvalidArgument, SchedulerError
from pinmobile.sweeps.extras import imported
from pinmobile.sweeps.grids import Grid
from pinmobile.sweeps.store import Job

__all__ = ["checked_client", "connected", "in_process", "on_cluster"]

_ANSWER = 10.0  # seconds that a scheduler has to answer, and to have a worker
_LOOK = 2.0  # seconds between two looks at a cluster from which nothing comes
_ALONE = 60.0  # seconds that a cluster may be without a worker: a dead one is often started again

Results: TypeAlias = Iterator[tuple[Job, dict[str, Array], Part]]


def in_process(grid: Grid, jobs: Sequence[Job]) -> Results:
    """Yield the draws and records of the jobs, in any order, by a thread for each processor."""
    workers = processors()
    with ThreadPoolExecutor(workers) as pool:

        def submit(job: Job) -> Any:
            return pool.submit(part_of, grid.scenarios[job.scenario], job.start, job.stop)

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
    seen = _Watch(client)
    seen.begin()

    def submit(job: Job) -> Any:
        seen.connected()
        scenario = grid.scenarios[job.scenario]
        return client.submit(part_of, scenario, job.start, job.stop, pure=False)

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
                raise SchedulerError(f"scheduler {seen.address} dropped a chunk; {_GO_ON}") from error

    def drop(futures: Iterable[Any]) -> None:
        if client.status == "running":  # otherwise nobody is left to be told
            client.cancel(list(futures))

    width = 2 * max(1, sum(client.nthreads().values()))
    try:
        yield from _collected(submit, jobs, width, answer, seen.look, drop)
    except distributed.comm.CommClosedError as error:
        raise SchedulerError(f"scheduler {seen.address} is gone; {_GO_ON}") from error


def checked_client(client: Any) -> Any:
    """Return a client that is one, and connected.

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
    return client


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
    distributed = imported("distributed")
    try:
        distributed.comm.resolve_address(address)
    except OSError:
        pass  # an unknown host, of which the connection tells
    except (ValueError, TypeError) as error:
        raise InvalidArgument(
            f"scheduler is {address!r}, expected an address such as tcp://127.0.0.1:8786"
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


_GO_ON = "what is done is in the store: start the same sweep again to go on"


class _Watch:
    """Whether a cluster is still there."""

    def __init__(self, client: Any) -> None:
        self.client, self.address = client, client.scheduler.address
        self.alive = monotonic()

    def connected(self) -> None:
        """Refuse to go on where the connection is lost."""
        if self.client.status != "running":
            raise SchedulerError(f"scheduler {self.address} is gone; {_GO_ON}")

    def begin(self) -> None:
        """Wait for the first worker, but not for long."""
        self.connected()
        if self.client.nthreads():
            return
        try:
            self.client.wait_for_workers(1, timeout=_ANSWER)
        except OSError as error:
            raise SchedulerError(f"scheduler {self.address} has no worker after {_ANSWER:g} s") from error

    def look(self) -> None:
        """Refuse to go on where the connection is lost, or where there has been no worker for too long."""
        self.connected()
        if self.client.nthreads():
            self.alive = monotonic()
        elif monotonic() - self.alive > _ALONE:
            raise SchedulerError(f"scheduler {self.address} has had no worker for {_ALONE:g} s; {_GO_ON}")


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


def _next(done: "SimpleQueue[Job]", look: Callable[[], None]) -> Job:
    while True:
        try:
            return done.get(timeout=_LOOK)
        except Empty:
            look()
