"""`ensemble`, the verb: the robots of a scenario in stretches, on all cores, in any order with one result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from time import perf_counter
from typing import Any
from warnings import warn

from pinmobile.arrays import Array, callable_as, whole
from pinmobile.compiled import processors
from pinmobile.ensembles.distributions import Source
from pinmobile.ensembles.part import Part, Records
from pinmobile.ensembles.processes import START, Workers, packed_way
from pinmobile.ensembles.result import Ensemble
from pinmobile.ensembles.scenario import Scenario, checked_scenario
from pinmobile.ensembles.ways import Way, way_of
from pinmobile.errors import InvalidArgument, SlowerEngine, shown
from pinmobile.integrators import Integrator
from pinmobile.simulation import Engine
from pinmobile.trajectories import Trajectory

_WORTH = 3  # starts of a worker that the rest must take: then two save a sixth of it at least

Progress = Callable[[int, int], None]


def ensemble(
    robot: Any,
    controller: Any,
    trajectory: Trajectory,
    *,
    n: int,
    spread: Mapping[str, Source],
    dt: float,
    seed: int = 0,
    duration: float | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Any] = (),
    limit: float = 1e3,
    after: float = 0.0,
    every: int | None = None,
    measures: Sequence[str] | None = None,
    traces: Iterable[int] = (),
    engine: Engine | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Ensemble:
    """Run a closed loop `n` times, each time with a robot, a start, gains or disturbances of its own.

    The same seed gives the same numbers, bit for bit, for any number of threads.

    Parameters
    ----------
    robot, controller, trajectory, n, spread, seed, dt, duration, integrator, substeps, forces, limit
        See `Scenario`.
    after : float
        Time from which on errors are kept [s].
    every : int, optional
        Samples between two entries of the bands over time.
    measures : sequence of str, optional
        What the robot states that is judged beside errors, by name; by default all, see `Scenario`.
    traces : iterable of int
        Robots of which a whole `Rollout` is kept, made by `simulate`.
    engine : Engine, optional
        `COMPILED`, `ARRAYS` or `PINOCCHIO`, one robot after another; by default the first of these that can.
    threads : int, optional
        By default one for each processor. Of laws that hold the interpreter's lock, as Pinocchio's, that many
        processes, where the work is worth starting them and all parts can be pickled.
    progress : callable, optional
        Called as ``progress(done, n)`` from time to time.

    Returns
    -------
    ensemble : Ensemble

    Raises
    ------
    InvalidArgument, UnknownName
        If an argument is not what is expected, draws are impossible, or the engine that is asked for cannot
        run the loop.

    Warns
    -----
    SlowerEngine
        If a part keeps the loop from the fastest engine; it names the part and what to write instead.
    """
    scenario = Scenario(
        robot=robot,
        controller=controller,
        trajectory=trajectory,
        n=n,
        spread=spread,
        dt=dt,
        seed=seed,
        duration=duration,
        integrator=integrator,
        substeps=substeps,
        forces=forces,
        limit=limit,
        after=after,
        every=every,
        measures=measures,
    )
    return run_scenario(scenario, traces=traces, engine=engine, threads=threads, progress=progress)


def run_scenario(
    scenario: Scenario,
    *,
    traces: Iterable[int] = (),
    engine: Engine | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Ensemble:
    """Run all robots of a scenario; the arguments are those of `ensemble`.

    Raises
    ------
    InvalidArgument
        As `ensemble`.
    """
    checked_scenario(scenario)
    workers = processors() if threads is None else whole("threads", threads)
    if progress is not None:
        callable_as("progress(done, n)", progress)
    if isinstance(traces, str | bytes) or not isinstance(traces, Iterable):
        raise InvalidArgument(f"traces is {shown(traces)}, expected indices of robots, such as [0]")
    followed = [_traced(i, scenario.n) for i in traces]
    draws = scenario.draws()
    way = way_of(scenario, engine)
    if way.why and engine is None:
        warn(
            f"this ensemble runs by {way.engine!r}, {way.engine.value}; {way.why}", SlowerEngine, stacklevel=3
        )
    with Workers(workers) as processes:
        part, how = _run(way, draws, 0, scenario.n, workers, progress, processes)
    way = replace(way, why="; ".join(filter(None, (way.why, how))))
    return Ensemble.of(scenario, draws, part, followed, way)


def part_of(
    scenario: Scenario,
    start: int,
    stop: int,
    engine: Engine | None = None,
    processes: Workers | None = None,
) -> tuple[dict[str, Array], Part]:
    """Return the draws and records of the robots from `start` to before `stop`: a chunk of a sweep.

    Parameters
    ----------
    scenario : Scenario
        Whose robots.
    start, stop : int
        Which of them, 0 <= start < stop <= n.
    engine : Engine, optional
        As in `ensemble`.
    processes : Workers, optional
        Where laws that hold the interpreter's lock may run.

    Returns
    -------
    draws : dict of str to ndarray, shape (stop - start,)
        What was drawn, by name.
    part : Part
        The records.

    Raises
    ------
    InvalidArgument
        As `ensemble`.
    """
    way, draws = way_of(scenario, engine), scenario.draws(start, stop)
    return draws, _run(way, draws, start, stop, 1, None, processes)[0]


def _run(
    way: Way,
    draws: Mapping[str, Array],
    start: int,
    stop: int,
    threads: int,
    progress: Progress | None,
    processes: Workers | None,
) -> tuple[Part, str]:
    """Return the records of the robots from `start` to before `stop`, given what is drawn for these.

    The string says how, where that is worth telling.
    """

    def drawn(first: int, last: int) -> Mapping[str, Array]:
        if (first, last) == (start, stop):
            return draws
        return {name: column[first - start : last - start] for name, column in draws.items()}

    def run(first: int, last: int) -> Part:
        return way.run(drawn(first, last), first, last, threads)

    stretches = way.divided(start, stop, threads)
    shared = way.locks and processes is not None and processes.count > 1
    if len(stretches) == 1 and not shared:
        part = run(start, stop)
        if progress is not None:
            progress(stop - start, stop - start)
        return part, ""
    records, done, how = Records(way.scenario, start, stop), 0, ""

    def put(first: int, last: int, part: Part) -> None:
        nonlocal done
        records.put(first, last, part)
        done += last - first
        if progress is not None:
            progress(done, stop - start)

    begin, workers = start, way.workers(threads)
    if shared:
        assert processes is not None
        began = perf_counter()
        if way.alone:  # the first robot tells what one costs
            begin = start + 1
            put(start, begin, run(start, begin))
            stretches = way.divided(begin, stop, threads)
        cost = perf_counter() - began if way.alone else way.cost
        if cost * (stop - begin) > _WORTH * START:
            try:
                sent = packed_way(way)
            except InvalidArgument as error:
                how = f"in one process, as {error}"
            else:
                stretches = way.shared(begin, stop, processes.count, cost)
                workers = min(processes.count, len(stretches))
                how = f"in {workers} processes"

                def run(first: int, last: int) -> Part:
                    return processes.part(sent, drawn(first, last), first, last)

    give_up = None if processes is None else processes.end
    for first, last, part in _results(run, stretches, workers, give_up):
        put(first, last, part)
    return records.part(), how


def _results(
    run: Callable[[int, int], Part],
    stretches: Sequence[tuple[int, int]],
    workers: int,
    give_up: Callable[[], None] | None,
) -> Iterator[tuple[int, int, Part]]:
    """Yield the stretches with what `run` gives for each, by some threads, in any order."""
    if workers == 1:
        for stretch in stretches:
            yield *stretch, run(*stretch)
        return
    with ThreadPoolExecutor(workers) as pool:
        waiting = {pool.submit(run, *stretch): stretch for stretch in stretches}
        try:
            for future in as_completed(waiting):
                yield *waiting.pop(future), future.result()
        except BaseException:
            if give_up is not None:
                give_up()  # nobody waits for what they are doing
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _traced(i: Any, n: int) -> int:
    index = whole("traces", i, least=0)
    if index >= n:
        raise InvalidArgument(f"traces has robot {index}, expected 0 to {n - 1}")
    return index
