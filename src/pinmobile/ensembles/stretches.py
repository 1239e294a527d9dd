"""Stretches of robots: how an ensemble is divided among threads, and put together again."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

import numpy as np

from pinmobile.controllers import NoisyMeasurement
from pinmobile.ensembles.layers import layers_of
from pinmobile.ensembles.part import Engine, Part, empty_counts
from pinmobile.ensembles.scenario import Scenario

__all__ = ["Records", "divided", "processors", "results"]

_NOISY = 256  # robots at a time where each has noise of its own for each sample
_LANES = 64  # what the compiled code takes at a time


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def divided(scenario: Scenario, engine: Engine, workers: int, start: int, stop: int) -> list[tuple[int, int]]:
    """Divide the robots so that every worker has something to do, and none too much at a time.

    Parameters
    ----------
    scenario : Scenario
        Whose robots.
    engine : Engine
        What runs them.
    workers : int
        Threads.
    start, stop : int
        The robots from `start` to before `stop`.
    """
    noisy = any(type(layer) is NoisyMeasurement for layer in layers_of(scenario.controller))
    each = -(-(stop - start) // (workers * _LANES)) * _LANES
    each = min(each, _NOISY if noisy else engine.largest)
    return [(first, min(first + each, stop)) for first in range(start, stop, each)]


def results(
    run: Callable[[int, int], Part], stretches: Sequence[tuple[int, int]], workers: int
) -> Iterator[tuple[int, int, Part]]:
    """Yield the stretches with what `run` gives for each, by some threads, in any order."""
    if workers == 1 or len(stretches) == 1:
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


class Records:
    """The records of the robots from `start` to before `stop`, put together from stretches in any order.

    Parameters
    ----------
    scenario : Scenario
        Whose robots.
    start, stop : int
        Which of them.
    """

    def __init__(self, scenario: Scenario, start: int, stop: int) -> None:
        self.start, size = start, stop - start
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
