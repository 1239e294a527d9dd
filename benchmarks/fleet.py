"""The work of every ensemble, its numbers, and the check that a contestant has done it."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from math import tau
from typing import Any, NamedTuple

import numpy as np
from task import GAIN, RADIUS, RATE, Body, Task, references

from pinmobile import Circle, ComputedTorque, MobileRobot, Tangent, closed_form, simulate

NOMINAL = Body(mass=30.0, yaw_inertia=1.3, com=(0.1, 0.0))  # the robot that the controller believes in
LECTURE = Task(0.1, body=NOMINAL)  # 601 samples
EVERY = 10  # samples from one histogram to the next
OCTAVES = (-54, 30)  # of the histograms' bins, powers of two
PER_OCTAVE = 5  # leading bits of the mantissa that tell bins apart: 32 bins
BINS = ((OCTAVES[1] - OCTAVES[0]) << PER_OCTAVE) + 2  # with the one below and the one above
CHECKED = 300  # robots whose figures are checked, at most: four blocks of 64 and a part of one
MOVED = 1e-3  # share of the counts that may be in a neighbour's bin: those which rounding takes over an edge


@dataclass(frozen=True)
class Fleet:
    """Robots on the lecture's circle under computed torque that takes each for the nominal one.

    Attributes
    ----------
    n : int
        Number of robots; the first ones are the same for every n.
    alike : bool
        Whether all are the first one: easier work, for those that take a single model.
    euler : bool
        Whether the step is semi-implicit Euler, for those that have no other.
    """

    n: int
    alike: bool = False
    euler: bool = False
    task: Task = field(default=LECTURE)

    @cached_property
    def mass(self) -> np.ndarray:
        """Mass [kg], shape (n,)."""
        drawn = np.random.default_rng([0, 0]).uniform(20.0, 40.0, 1 if self.alike else self.n)
        return np.broadcast_to(drawn, (self.n,)).copy()

    @cached_property
    def com(self) -> np.ndarray:
        """Place of the centre of mass along the body [m], shape (n,); across it is 0."""
        drawn = np.random.default_rng([0, 1]).normal(0.1, 0.02, 1 if self.alike else self.n)
        return np.broadcast_to(drawn, (self.n,)).copy()

    @property
    def steps(self) -> int:
        """Number of robot-steps."""
        return self.n * (self.task.samples - 1)

    @property
    def kept(self) -> int:
        """Number of samples that have a histogram."""
        return 1 + (self.task.samples - 1) // EVERY

    def references(self) -> np.ndarray:
        """Return q, v and a of the reference side by side, shape (samples, 9)."""
        return np.hstack(references(self.task))


class Figures(NamedTuple):
    """What a contestant returns; those who do less leave None.

    Of each robot the largest |e|, the root of the mean of e^2 and the largest |tau|, (n, 3) each, and the
    largest distance from the reference, (n,); over time the histograms of distance and |e_psi|,
    (2, kept, BINS).
    """

    max_error: np.ndarray
    rms_error: np.ndarray | None = None
    max_input: np.ndarray | None = None
    max_distance: np.ndarray | None = None
    histogram: np.ndarray | None = None


Run = Callable[[], Figures]


class Watch:
    """The figures of robots that step together, for those who step in numpy."""

    def __init__(self, fleet: Fleet, counting: bool = True) -> None:
        self._samples = fleet.task.samples
        self._max_error, self._squares, self._max_force = np.zeros((3, fleet.n, 3))
        self._farthest = np.zeros(fleet.n)
        self._counts = np.zeros((2, fleet.kept, BINS), np.int32) if counting else None

    def see(self, k: int, error: np.ndarray, force: np.ndarray) -> None:
        """Take in sample k: error and force, (n, 3) each."""
        np.maximum(self._max_error, np.abs(error), out=self._max_error)
        np.maximum(self._max_force, np.abs(force), out=self._max_force)
        squares = error * error
        self._squares += squares
        far = squares[:, 0] + squares[:, 1]
        np.maximum(self._farthest, far, out=self._farthest)
        if self._counts is not None and k % EVERY == 0:
            self._counts[0, k // EVERY] = counted(np.sqrt(far))
            self._counts[1, k // EVERY] = counted(np.abs(error[:, 2]))

    def figures(self) -> Figures:
        """Return what was seen."""
        rms = np.sqrt(self._squares / self._samples)
        return Figures(self._max_error, rms, self._max_force, np.sqrt(self._farthest), self._counts)


def counted(values: np.ndarray) -> np.ndarray:
    """Return how many of the values are in each bin, by their leading bits."""
    shift = np.int64(52 - PER_OCTAVE)
    bins = (values.view(np.int64) >> shift) - (np.float64(2.0 ** OCTAVES[0]).view(np.int64) >> shift)
    return np.bincount(np.clip(bins + 1, 0, BINS - 1), minlength=BINS)


def on_circle(angle: Any, library: Any = np) -> Any:
    """Return the angle less whole turns."""
    return angle - tau * library.rint(angle / tau)


def command(at: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return error and commanded acceleration, (..., 3) each, of one sample's references."""
    error = at[:3] - q
    error[..., 2] = on_circle(error[..., 2])
    return error, at[6:] + GAIN * (at[3:6] - v + error)


@lru_cache(maxsize=16)
def trajectories(fleet: Fleet) -> tuple[np.ndarray, np.ndarray]:
    """Return error and force of every sample, (samples, n, 3) each: the closed form, step by step."""
    com = np.column_stack([fleet.com, np.zeros(fleet.n)])
    plant = {"mass": fleet.mass, "yaw_inertia": NOMINAL.yaw_inertia, "com": com}
    known = {"mass": NOMINAL.mass, "yaw_inertia": NOMINAL.yaw_inertia, "com": NOMINAL.com}
    dt, given = fleet.task.dt, fleet.references()
    errors, forces = np.empty((2, fleet.task.samples, fleet.n, 3))
    q, v = np.tile(given[0, :3], (fleet.n, 1)), np.tile(given[0, 3:6], (fleet.n, 1))
    for k, at in enumerate(given):
        errors[k], wanted = command(at, q, v)
        forces[k] = closed_form.inverse_dynamics(q, v, wanted, **known)
        a = closed_form.forward_dynamics(q, v, forces[k], **plant)
        q = q + dt * v + (dt**2 if fleet.euler else dt**2 / 2) * a
        v = v + dt * a
    return errors, forces


@lru_cache(maxsize=16)
def expected(fleet: Fleet) -> Figures:
    """Return what must come out."""
    watch = Watch(fleet)
    for k, (error, force) in enumerate(zip(*trajectories(fleet), strict=True)):
        watch.see(k, error, force)
    return watch.figures()


def simulated(fleet: Fleet) -> Figures:
    """Return what `simulate` says, one robot after the other."""
    known = MobileRobot(NOMINAL.mass, NOMINAL.yaw_inertia, com=NOMINAL.com)
    controller = ComputedTorque(known, GAIN, GAIN)
    trajectory = Tangent(Circle(RADIUS, RATE, fleet.task.duration))
    plants = [
        MobileRobot(mass, NOMINAL.yaw_inertia, com=(com, 0.0))
        for mass, com in zip(fleet.mass, fleet.com, strict=True)
    ]
    runs = [simulate(plant, controller, trajectory, dt=fleet.task.dt) for plant in plants]
    errors = np.array([run.error for run in runs])
    figures = ([run.max_error() for run in runs], [run.rms_error() for run in runs])
    forces = np.array([run.max_input() for run in runs])
    return Figures(*map(np.array, figures), forces, np.linalg.norm(errors[..., :2], axis=-1).max(axis=1))


def difference(found: Figures, fleet: Fleet) -> float:
    """Return the largest difference of the first robots' figures, each on its scale or 1.

    A histogram counts all robots: it is compared where all are checked, and elsewhere only its sums.
    """
    checked = min(fleet.n, CHECKED)
    right = expected(replace(fleet, n=checked))
    apart = [0.0]
    for one, other in zip(found[:4], right[:4], strict=True):
        if one is None:
            continue
        if len(one) != fleet.n or one.shape[1:] != other.shape[1:] or not np.isfinite(one).all():
            return np.inf
        apart.append(np.max(np.abs(one[:checked] - other)) / max(1.0, np.max(other)))
    if found.histogram is not None and not right_counts(found.histogram, fleet, right.histogram):
        return np.inf
    return float(max(apart))


def right_counts(counts: np.ndarray, fleet: Fleet, right: np.ndarray) -> bool:
    """Return whether every robot is counted and, where all are checked, in the right bin."""
    if counts.shape != right.shape or np.any(counts.sum(axis=-1) != fleet.n):
        return False
    if fleet.n > CHECKED:
        return True
    apart = np.abs(np.cumsum(counts.astype(np.int64) - right, axis=-1)).sum()
    return bool(apart <= max(2.0, MOVED * right.sum()))
