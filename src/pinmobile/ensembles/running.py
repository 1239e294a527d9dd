"""`ensemble`, the verb: the robots of a scenario in stretches, on all cores, in any order with one result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from warnings import warn

from pinmobile.arrays import Array, callable_as, whole
from pinmobile.compiled import processors
from pinmobile.controllers import Controller
from pinmobile.ensembles.distributions import Source
from pinmobile.ensembles.engines import Way, way_of
from pinmobile.ensembles.records import Part, Records
from pinmobile.ensembles.result import Ensemble
from pinmobile.ensembles.scenario import Scenario, checked_scenario
from pinmobile.errors import InvalidArgument, SlowerEngine, shown
from pinmobile.forces import CoordinateForce, Force
from pinmobile.integrators import Integrator
from pinmobile.simulation import Engine, Plant
from pinmobile.trajectories import Trajectory

_START = 1.5  # seconds of a processor until a worker runs its first robot: Python and Pinocchio start
_WORTH = 3  # starts of a worker that the rest must take: then two save a sixth of it at least

Progress = Callable[[int, int], None]


def ensemble(
    robot: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    n: int,
    spread: Mapping[str, Source],
    dt: float,
    seed: int = 0,
    duration: float | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Force | CoordinateForce] = (),
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
        `COMPILED`, the default where all parts can be compiled, or `PYTHON`, one robot after another.
    threads : int, optional
        Of compiled loops; by default one for each processor.
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
    part = _run(way, draws, 0, scenario.n, workers, progress)
    return Ensemble.of(scenario, draws, part, followed, engine=repr(way.engine), why=way.why)


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
    records = Records(start, stop)
    for first, last in way.divided(start, stop):
        drawn = {name: column[first - start : last - start] for name, column in draws.items()}
        records.put(first, last, way.run(drawn, first, last, threads))
        if progress is not None:
            progress(last - start, stop - start)
    return records.part()


def _traced(i: int, n: int) -> int:
    index = whole("traces", i, least=0)
    if index >= n:
        raise InvalidArgument(f"traces has robot {index}, expected 0 to {n - 1}")
    return index
