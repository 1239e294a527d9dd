"""`sweep`: the ensembles of a grid, computed by this process or a Dask cluster, into a store."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from os import PathLike
from time import monotonic
from typing import TYPE_CHECKING, Any, TypeAlias
from warnings import warn

import numpy as np

from pinmobile.arrays import Array, callable_as, location, text, whole
from pinmobile.compiled import processors
from pinmobile.errors import InvalidArgument, SchedulerError, SlowerEngine, imported, shown
from pinmobile.loop import Part, Scenario, part_of, way_of
from pinmobile.sweeps._points import Changes, Points, describe
from pinmobile.sweeps._result import Sweep

if TYPE_CHECKING:
    from pinmobile.sweeps._store import Job

_CHUNK = 16384
_ANSWER = 10.0  # seconds that a scheduler has to answer, and to have a worker
_ALONE = 60.0  # seconds that a cluster may be without a worker: a dead one is often started again
_LOOK = 2.0  # seconds between two looks at a cluster from which nothing comes

Progress: TypeAlias = Callable[[int, int], None]


def sweep(
    scenario: Scenario,
    path: str | PathLike[str],
    *,
    grid: Mapping[str, Any] | None = None,
    cases: Mapping[str, Changes] | None = None,
    client: Any = None,
    chunk: int | None = None,
    progress: Progress | None = None,
    version: str | None = None,
) -> Sweep:
    """Run an ensemble at each point of grid x cases, and keep the results in a Zarr store that xarray reads.

    The work is divided into chunks of robots. Only this process writes the store; the numbers of a chunk are
    the same bit for bit wherever it is computed. After an interruption, even a kill, repeat the call: the
    sweep resumes, and ends with the very same store. Results in files that are gone are computed again.

    Parameters
    ----------
    scenario : Scenario
        The ensemble; all points have as many robots, and their bands at the same times.
    path : path
        Folder of the store; made if it is missing, continued if it is that of this sweep.
    grid : mapping of str to sequence or mapping, optional
        Values by path: of the loop, such as ``"controller.kp"``, ``"robot.mass"``, ``"forces.wind.force.x"``,
        ``"trajectory.path.radius"``, or of the scenario, such as ``"spread.mass"`` or ``"seed"``. A value is
        a number or a whole part. A mapping has labels: ``{"controller": {"PD": PD(120, 120), "computed
        torque": ComputedTorque(robot)}}``. The last axis runs fastest.
    cases : mapping of str to mapping of str to value, optional
        Values by path of each case, by name: ``{"nominal": {}, "push": {"forces.push": force}}``. They are
        the last axis, ``case``.
    client : distributed.Client, optional
        Dask cluster that computes; pinmobile must be installed there too, and modules of your own sent there
        (``client.upload_file``). By default, this process does, on all cores.
    chunk : int, optional
        Robots in a chunk; by default 16384, or what the store has.
    progress : callable, optional
        Called as ``progress(done, total)`` in robots, first with what the store has, then after each chunk.
    version : str, optional
        A word for objects whose contents a store cannot recognise, such as those of a compiled package:
        change it whenever they change. Without such objects it is not needed.

    Returns
    -------
    sweep : Sweep

    Raises
    ------
    UnknownName
        If there is no such path.
    InvalidArgument
        If an argument is not what is expected, draws are impossible, the store belongs to another sweep (the
        message says what differs), a scenario has objects that cannot be recognised and there is no
        `version`, or a package of the extra is missing.
    FileError
        If the system fails, such as of a full disk; what is done is kept.
    SchedulerError
        If the cluster has no worker, or is lost; what is done is kept.

    Warns
    -----
    SlowerEngine
        If parts keep the remaining work from the fastest engine; it names them and what to write instead.
    """
    points = Points.of(scenario, grid, cases)
    return run_points(points, path, client=client, chunk=chunk, progress=progress, version=version)


def run_points(
    points: Points,
    path: str | PathLike[str],
    *,
    client: Any = None,
    chunk: int | None = None,
    progress: Progress | None = None,
    version: str | None = None,
) -> Sweep:
    """Run the scenarios of points; the other arguments, results and errors are those of `sweep`."""
    from pinmobile.sweeps._store import Store

    folder, size = location("path", path), _CHUNK if chunk is None else whole("chunk", chunk)
    if client is not None:
        _check_client(client)
    if progress is not None:
        callable_as("progress(done, total)", progress)
    if version is not None and not text("version", version).strip():
        raise InvalidArgument(f'version is {shown(version)}, expected a word, such as "1"')
    description = describe(points, version)
    with Store(folder, points, description, size) as store:
        if chunk is not None and store.chunk != size:
            raise InvalidArgument(f"chunk is {size}, expected {store.chunk} as in the store, or None")
        waiting = store.waiting()
        total = len(points.scenarios) * points.n
        left = sum(job.stop - job.start for job in waiting)
        _warn_if_slower(points, waiting)
        if progress is not None:
            progress(total - left, total)
        for job, draws, part in _results(points, waiting, client) if waiting else ():
            store.record(job, draws, part)
            left -= job.stop - job.start
            if progress is not None:
                progress(total - left, total)
    return Sweep.of_store(folder, points)


def _warn_if_slower(points: Points, jobs: Sequence[Job]) -> None:
    """Warn once, here and not where chunks are computed, of parts that rule out the fastest engine."""
    reasons: dict[str, list[int]] = {}
    for k in sorted({job.scenario for job in jobs}):
        way = way_of(points.scenarios[k])
        if way.fallback_reason:
            reasons.setdefault(f"by {way.engine!r}, {way.engine.value}; {way.fallback_reason}", []).append(k)
    told = []
    for reason, places in reasons.items():
        more = f" and {len(places) - 1} more" if len(places) > 1 else ""
        told.append(f"{reason} (at {points.place(places[0])}{more})")
    if told:
        warn(f"this sweep runs {'; '.join(told)}", SlowerEngine, stacklevel=4)


def _check_client(client: Any) -> None:
    kind = imported("distributed", "sweeps", "a sweep").Client
    if not isinstance(client, kind) or client.status != "running" or client.asynchronous:
        raise InvalidArgument(
            f"client is {shown(client)}, expected a distributed.Client that is connected to its scheduler"
        )


def connected(address: str, timeout: float = _ANSWER) -> Any:
    """Return a `distributed.Client` of the scheduler at an address, such as ``tcp://127.0.0.1:8786``.

    Raises
    ------
    SchedulerError
        If no scheduler answers there within `timeout` seconds.
    """
    import asyncio  # here, because most sweeps have no cluster

    distributed = imported("distributed", "sweeps", "a sweep")

    async def identity() -> Any:  # a client would wait for ever for a server that is silent
        comm = await distributed.comm.connect(address, timeout=timeout)
        try:
            return await distributed.core.send_recv(comm, op="identity")
        finally:
            comm.abort()

    try:
        with ThreadPoolExecutor(1) as pool:  # a notebook's thread has a loop of its own
            pool.submit(asyncio.run, asyncio.wait_for(identity(), timeout)).result()
        return distributed.Client(address, timeout=timeout)
    except Exception as error:  # what another server says is read as a length, a header, a message
        raise SchedulerError(
            f"scheduler is {shown(address)}, where none answers within {timeout:g} s, expected an address "
            f"such as tcp://127.0.0.1:8786: {error}"
        ) from error


def _results(
    points: Points, jobs: Sequence[Job], client: Any
) -> Iterator[tuple[Job, dict[str, Array], Part]]:
    """Yield the draws and records of jobs, in any order; few wait to be written at a time."""
    workers = processors()
    executor: Any = ThreadPoolExecutor(workers)
    if client is not None:
        try:
            client.wait_for_workers(1, timeout=_ANSWER)
        except OSError as error:
            raise _lost(client, f"has no worker after {_ANSWER:g} s") from error
        executor, workers = client.get_executor(pure=False), 2 * sum(client.nthreads().values())
    left, alive = iter(jobs), monotonic()
    under_way: dict[Future[Any], Job] = {}

    def send() -> None:
        for job in left:
            scenario = points.scenarios[job.scenario]
            sent = scenario if client is None else scenario.holding(job.start, job.stop)
            under_way[executor.submit(part_of, sent, job.start, job.stop)] = job
            return

    try:
        for _ in range(workers + 1):
            send()
        while under_way:
            done, _ = wait(under_way, timeout=_LOOK, return_when=FIRST_COMPLETED)
            alive = monotonic() if done or client is None or client.nthreads() else alive
            if client is not None and (client.status != "running" or monotonic() - alive > _ALONE):
                raise _lost(client, f"is gone, or had no worker for {_ALONE:g} s")
            for future in done:
                draws, part = _answer(future, client)
                yield under_way.pop(future), draws, part
                send()
    finally:
        for future in under_way:
            future.cancel()
        if client is None:
            executor.shutdown()


def _answer(future: Future[Any], client: Any) -> tuple[dict[str, Array], Part]:
    if client is None:
        return future.result()  # type: ignore[no-any-return]
    distributed = imported("distributed", "sweeps", "a sweep")
    try:
        draws, part = future.result()
    except (CancelledError, distributed.CancelledError, distributed.KilledWorker) as error:
        raise _lost(client, f"dropped a chunk ({type(error).__name__}: {error})") from error
    return draws, Part(*map(np.array, part))  # what came over the wire may be read-only


def _lost(client: Any, why: str) -> SchedulerError:
    address = client.scheduler.address if client.scheduler else ""
    return SchedulerError(
        f"scheduler {address} {why}; what is done is in the store: start the same sweep again to resume"
    )
