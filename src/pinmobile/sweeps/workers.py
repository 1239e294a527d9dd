"""Where chunks are computed: by the threads of this process, or by the workers of a Dask cluster."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import Empty, SimpleQueue
from typing import Any, TypeAlias

import numpy as np

from pinmobile.arrays import Array
from pinmobile.ensembles import Part, part_of
from pinmobile.ensembles.processes import Workers
from pinmobile.ensembles.ways import processors
from pinmobile.errors import SchedulerError
from pinmobile.sweeps.cluster import GO_ON, Watch
from pinmobile.sweeps.code import packed, part_of_packed
from pinmobile.sweeps.extras import imported
from pinmobile.sweeps.grids import Grid
from pinmobile.sweeps.store import Job

__all__ = ["in_process", "on_cluster"]

_LOOK = 2.0  # seconds between two looks at a cluster from which nothing comes

Results: TypeAlias = Iterator[tuple[Job, dict[str, Array], Part]]


def in_process(grid: Grid, jobs: Sequence[Job]) -> Results:
    """Yield the draws and records of the jobs, in any order, by a thread for each processor.

    Laws that hold the interpreter's lock run in as many processes, which all jobs share.
    """
    workers = processors()
    with Workers(workers) as processes, ThreadPoolExecutor(workers) as pool:

        def submit(job: Job) -> Any:
            scenario = grid.scenarios[job.scenario]
            return pool.submit(part_of, scenario, job.start, job.stop, processes=processes)

        def drop(futures: Iterable[Any]) -> None:
            for future in futures:
                future.cancel()
            processes.end()

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


def _next(done: "SimpleQueue[Job]", look: Callable[[], None]) -> Job:
    while True:
        try:
            return done.get(timeout=_LOOK)
        except Empty:
            look()
