"""What is kept of a stretch of an ensemble, and how an engine makes it."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.ensembles.batch import Batch
from pinmobile.ensembles.histogram import BINS
from pinmobile.ensembles.scenario import Scenario

__all__ = ["Engine", "Part", "empty_counts"]


class Part(NamedTuple):
    """The records of m robots.

    Attributes
    ----------
    lived : ndarray of int, shape (m,)
        Samples before the loop diverged; all of them where it did not.
    max_error : ndarray, shape (m, 3)
        Largest |error| of x, y, psi in those of these samples from `Scenario.after` on [m, m, rad].
    max_distance : ndarray, shape (m,)
        Largest distance from the desired position [m].
    rms_error : ndarray, shape (m, 3)
        Root of the mean squared error [m, m, rad].
    max_force : ndarray, shape (m, 3)
        Largest |tau| [N, N, N m].
    counts : ndarray of int, shape (G, 2, BINS)
        At each time of the grid, how many robots have a distance, and an error of the heading, of which size.
    """

    lived: NDArray[np.int64]
    max_error: Array
    max_distance: Array
    rms_error: Array
    max_force: Array
    counts: NDArray[np.int32]


@dataclass(frozen=True)
class Engine:
    """A way to run the robots of an ensemble.

    Attributes
    ----------
    name : str
        Its name, for people.
    run : callable
        ``run(scenario, batch) -> Part``.
    refusal : callable
        ``refusal(scenario) -> str``: why it cannot run the scenario; "" where it can.
    largest : int
        Robots that it takes at a time, at most.
    """

    name: str
    run: Callable[[Scenario, Batch], Part]
    refusal: Callable[[Scenario], str]
    largest: int

    def __repr__(self) -> str:
        return self.name

    def __reduce__(self) -> tuple[Any, ...]:
        # It comes back as itself, from another process too: there is one of each.
        return _engine_of, (self.run.__module__, self.name)


def _engine_of(module: str, name: str) -> Any:
    return getattr(import_module(module), name)


def empty_counts(scenario: Scenario) -> NDArray[np.int32]:
    """Return counts of nothing, shape (G, 2, BINS)."""
    return np.zeros((len(scenario.grid), 2, BINS), np.int32)
