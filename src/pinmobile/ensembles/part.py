"""Some robots of an ensemble: what is kept of them, and one of them alone."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.ensembles.histogram import BINS
from pinmobile.ensembles.scenario import Scenario


class Part(NamedTuple):
    """The records of m robots.

    Attributes
    ----------
    lived : ndarray of int, shape (m,)
        Samples before the loop diverged; all of them where it did not.
    max_error : ndarray, shape (m, c)
        Largest |error| of the reference's c coordinates in those of these samples from `Scenario.after` on.
    max_distance : ndarray, shape (m,)
        Largest distance from the desired position [m].
    rms_error : ndarray, shape (m, c)
        Root of the mean squared error.
    max_force : ndarray, shape (m, nu)
        Largest |input|.
    worst_measure, rms_measure : ndarray, shape (m, j)
        Worst, and root of the mean square, of each measure, in the samples of which errors are kept.
    counts : ndarray of int, shape (G, channels, BINS)
        At each time of the grid, how many robots have a distance, and so on, of which size; see
        `Scenario.channels`.
    """

    lived: NDArray[np.int64]
    max_error: Array
    max_distance: Array
    rms_error: Array
    max_force: Array
    worst_measure: Array
    rms_measure: Array
    counts: NDArray[np.int32]

    @classmethod
    def of(cls, scenario: Scenario, record: Any, counts: Any) -> Part:
        """Return what a `Summary` kept of m robots, its arrays with the robots as their first axis."""
        lived = record["lived"].astype(np.int64)
        kept = np.maximum(lived - scenario.begin, 1)[:, None]
        none = np.zeros((len(lived), 0))
        signs = np.array([-1.0 if one.is_margin else 1.0 for one in scenario.judged])
        return cls(
            lived,
            record["largest"].copy(),  # not a view of all that the robots kept
            np.sqrt(record["farthest"][:, 0]),
            np.sqrt(record["squares"] / kept),
            record["inputs"].copy(),
            record.get("worst", none) * signs,
            np.sqrt(record.get("measure_squares", none) / kept),
            counts,
        )


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
            "max_error": np.empty((size, scenario.size)),
            "max_distance": np.empty(size),
            "rms_error": np.empty((size, scenario.size)),
            "max_force": np.empty((size, scenario.robot.nu)),
            "worst_measure": np.empty((size, len(scenario.judged))),
            "rms_measure": np.empty((size, len(scenario.judged))),
        }
        self.counts = np.zeros((len(scenario.grid), len(scenario.channels), BINS), np.int32)

    def put(self, start: int, stop: int, part: Part) -> None:
        """Put the records of the robots from `start` to before `stop` in their place."""
        for name, array in self.arrays.items():
            array[start - self.start : stop - self.start] = getattr(part, name)
        self.counts += part.counts

    def part(self) -> Part:
        """Return all records."""
        return Part(counts=self.counts, **self.arrays)


class Member(NamedTuple):
    """One robot of an ensemble: ``simulate(*member[:3], **member.options)`` runs it alone.

    Attributes
    ----------
    robot, controller, trajectory
        As in `simulate`.
    options : dict
        The other arguments of `simulate`.
    """

    robot: Any
    controller: Any
    trajectory: Any
    options: dict[str, Any]


def member_of(scenario: Scenario, i: int) -> Member:
    """Return robot i as the arguments of `simulate`.

    Parameters
    ----------
    scenario : Scenario
        Whose robot.
    i : int
        Its index, 0 <= i < n.
    """
    draws = scenario.draws(i, i + 1)
    values = {place: value[0] for place, value in scenario.values(draws, i, i + 1).items()}
    parts = scenario.parts.with_parameters(values, remade=True)
    own = scenario.references(draws, 1, i) if scenario.has_own_references else None
    q, v = scenario.starts(draws, 1, own)
    options = {
        "dt": scenario.dt,
        "duration": scenario.duration if own is None else float(scenario.t[-1]),
        "q0": q[0],
        "v0": v[0],
        "integrator": scenario.integrator,
        "substeps": scenario.substeps,
        "forces": parts.forces,
        "limit": scenario.limit,
    }
    if scenario.is_noisy:
        options |= {"seed": scenario.seed, "member": i}
    return Member(parts.plant, parts.controller, parts.trajectory, options)
