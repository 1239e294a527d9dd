"""`ensemble`, the verb: the robots of a scenario in stretches, on all cores, in any order with one result."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from importlib.util import find_spec
from typing import Any

import numpy as np

from pinmobile.arrays import Array, whole
from pinmobile.controllers import NoisyMeasurement
from pinmobile.ensembles.batch import batch_of
from pinmobile.ensembles.by_arrays import ARRAYS, check_functions
from pinmobile.ensembles.by_kernel import COMPILED
from pinmobile.ensembles.distributions import Source
from pinmobile.ensembles.layers import layers_of
from pinmobile.ensembles.part import Engine, Part, empty_counts
from pinmobile.ensembles.result import Ensemble
from pinmobile.ensembles.scenario import Scenario
from pinmobile.errors import InvalidArgument
from pinmobile.integrators import Integrator, constant_acceleration
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Trajectory

__all__ = ["chosen_engine", "ensemble", "part_of", "processors", "run_scenario"]

_NOISY = 256  # robots at a time where each has noise of its own for each sample
_LANES = 64  # what the compiled code takes at a time

Progress = Callable[[int, int], None]


def ensemble(
    robot: MobileRobot,
    controller: Any,
    trajectory: Trajectory,
    *,
    n: int,
    spread: Mapping[str, Source],
    dt: float,
    seed: int = 0,
    duration: float | None = None,
    integrator: Integrator = constant_acceleration,
    substeps: int = 1,
    forces: Sequence[Any] = (),
    limit: float = 1e3,
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
    robot, controller, trajectory, n, spread, seed, dt, duration, integrator, substeps, forces, limit, every
        See `Scenario`.
    traces : iterable of int
        Robots of which a whole `Rollout` is kept, made by `simulate`.
    engine : Engine, optional
        `COMPILED` or `ARRAYS`; by default the compiled one wherever it can.
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
        If an argument is not what is expected, draws are impossible, or numba is missing.
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
    if not isinstance(scenario, Scenario):
        raise InvalidArgument(f"scenario is a {type(scenario).__name__}, expected a Scenario")
    chosen = chosen_engine(scenario, engine)
    workers = processors() if threads is None else whole("threads", threads)
    if progress is not None and not callable(progress):
        raise InvalidArgument(f"progress is {progress!r}, expected a function of done and n")
    if isinstance(traces, str) or not isinstance(traces, Iterable):
        raise InvalidArgument(f"traces is {traces!r}, expected indices of robots, such as [0]")
    followed = [_robot_index("traces", i, scenario.n) for i in traces]
    draws = scenario.draws()
    whole_part = _Whole(scenario)
    stretches = _stretches(scenario, chosen, workers)

    def run(start: int, stop: int) -> tuple[int, int, Part]:
        mine = {name: column[start:stop] for name, column in draws.items()}
        return start, stop, chosen.run(scenario, batch_of(scenario, mine, start, stop - start))

    done = 0
    for start, stop, part in _each(run, stretches, workers):
        whole_part.put(start, stop, part)
        done += stop - start
        if progress is not None:
            progress(done, scenario.n)
    return Ensemble.of(scenario, draws, whole_part.part(), followed)


def part_of(
    scenario: Scenario, start: int, stop: int, engine: Engine | None = None
) -> tuple[dict[str, Array], Part]:
    """Return the draws and records of the robots from `start` to before `stop`: a chunk of a sweep.

    Raises
    ------
    InvalidArgument
        As `ensemble`.
    """
    chosen, draws = chosen_engine(scenario, engine), scenario.draws(start, stop)
    records = _Whole(scenario, start, stop)
    for first, last in _stretches(scenario, chosen, 1, start, stop):
        mine = {name: column[first - start : last - start] for name, column in draws.items()}
        records.put(first, last, chosen.run(scenario, batch_of(scenario, mine, first, last - first)))
    return draws, records.part()


def chosen_engine(scenario: Scenario, engine: Engine | None) -> Engine:
    """Return the engine that is asked for, by default the compiled one wherever it can.

    Raises
    ------
    InvalidArgument
        If it cannot run the scenario, or numba is missing.
    """
    if engine is None and COMPILED.refusal(scenario):
        check_functions(scenario)
        return ARRAYS
    chosen = COMPILED if engine is None else engine
    if not isinstance(chosen, Engine):
        raise InvalidArgument(f"engine is {engine!r}, expected COMPILED, ARRAYS or None")
    refusal = chosen.refusal(scenario)
    if refusal:
        raise InvalidArgument(f"engine is {chosen!r}, which cannot run this: {refusal}")
    if chosen is COMPILED and find_spec("numba") is None:
        raise InvalidArgument(
            "the compiled engine needs numba: install the extra, pip install 'pinmobile[ensembles]', "
            "or choose engine=ARRAYS, which is slower"
        )
    if chosen is ARRAYS:
        check_functions(scenario)
    return chosen


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _robot_index(name: str, i: Any, n: int) -> int:
    index = whole(name, i, least=0)
    if index >= n:
        raise InvalidArgument(f"{name} has robot {index}, expected 0 to {n - 1}")
    return index


def _stretches(
    scenario: Scenario, engine: Engine, workers: int, start: int = 0, stop: int | None = None
) -> list[tuple[int, int]]:
    """Divide the robots so that every worker has something to do, and none too much at a time."""
    end = scenario.n if stop is None else stop
    noisy = any(type(layer) is NoisyMeasurement for layer in layers_of(scenario.controller))
    each = -(-(end - start) // (workers * _LANES)) * _LANES
    each = min(each, _NOISY if noisy else engine.largest)
    return [(first, min(first + each, end)) for first in range(start, end, each)]


def _each(
    run: Callable[[int, int], Any], stretches: Sequence[tuple[int, int]], workers: int
) -> Iterable[Any]:
    if workers == 1 or len(stretches) == 1:
        for stretch in stretches:
            yield run(*stretch)
        return
    with ThreadPoolExecutor(workers) as pool:
        waiting = [pool.submit(run, *stretch) for stretch in stretches]
        try:
            for future in as_completed(waiting):
                waiting.remove(future)
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


class _Whole:
    """The records of a stretch, put together from those of its parts in any order."""

    def __init__(self, scenario: Scenario, start: int = 0, stop: int | None = None) -> None:
        size = (scenario.n if stop is None else stop) - start
        self.start = start
        self.arrays = {
            "lived": np.empty(size, np.int64),
            "max_error": np.empty((size, 3)),
            "max_distance": np.empty(size),
            "rms_error": np.empty((size, 3)),
            "max_force": np.empty((size, 3)),
        }
        self.counts = empty_counts(scenario)

    def put(self, start: int, stop: int, part: Part) -> None:
        """Put the records of the robots from `start` to before `stop` in their place."""
        for name, array in self.arrays.items():
            array[start - self.start : stop - self.start] = getattr(part, name)
        self.counts += part.counts

    def part(self) -> Part:
        """Return all records."""
        return Part(counts=self.counts, **self.arrays)  # type: ignore[arg-type]
