"""`ensemble`, the verb: the robots of a scenario in stretches, on all cores, in any order with one result."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any
from warnings import warn

from pinmobile.arrays import Array, callable_as, whole
from pinmobile.ensembles.distributions import Source
from pinmobile.ensembles.part import Part, Records
from pinmobile.ensembles.result import Ensemble
from pinmobile.ensembles.scenario import Scenario, checked_scenario
from pinmobile.ensembles.ways import Way, processors, way_of
from pinmobile.errors import InvalidArgument, SlowerEngine, shown
from pinmobile.integrators import Integrator
from pinmobile.simulation.engines import Engine
from pinmobile.trajectories import Trajectory

__all__ = ["ensemble", "part_of", "run_scenario"]

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
    traces : iterable of int
        Robots of which a whole `Rollout` is kept, made by `simulate`.
    engine : Engine, optional
        `COMPILED`, `ARRAYS` or `PINOCCHIO`, one robot after another; by default the first of these that can.
    threads : int, optional
        By default one for each processor.
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
    part = _run(way, draws, 0, scenario.n, workers, progress)
    return Ensemble.of(scenario, draws, part, followed, way)


def part_of(
    scenario: Scenario, start: int, stop: int, engine: Engine | None = None
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
    return draws, _run(way, draws, start, stop, 1, None)


def _run(
    way: Way, draws: Mapping[str, Array], start: int, stop: int, threads: int, progress: Progress | None
) -> Part:
    """Return the records of the robots from `start` to before `stop`, given what is drawn for these."""
    stretches = way.divided(start, stop, threads)

    def run(first: int, last: int) -> Part:
        whole = (first, last) == (start, stop)
        mine = draws if whole else {name: x[first - start : last - start] for name, x in draws.items()}
        return way.run(mine, first, last, threads)

    if len(stretches) == 1:
        part = run(start, stop)
        if progress is not None:
            progress(stop - start, stop - start)
        return part
    records, done = Records(way.scenario, start, stop), 0
    for first, last, part in _results(run, stretches, way.workers(threads)):
        records.put(first, last, part)
        done += last - first
        if progress is not None:
            progress(done, stop - start)
    return records.part()


def _results(
    run: Callable[[int, int], Part], stretches: Sequence[tuple[int, int]], workers: int
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
        finally:
            pool.shutdown(cancel_futures=True)


def _traced(i: Any, n: int) -> int:
    index = whole("traces", i, least=0)
    if index >= n:
        raise InvalidArgument(f"traces has robot {index}, expected 0 to {n - 1}")
    return index
