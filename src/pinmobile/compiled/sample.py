"""One sample of a closed loop, written once, and what is kept of it.

`one_sample` runs on numbers as on symbols: it is what the compiled loop repeats. A recorder is a part like
any other: its law is NumPy for one state. It is called as ``recorder(sample, state) -> Record``, once per
sample, after the controller and before the step. It keeps a few numbers of each robot and counts of their
errors, or all samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pinmobile.arrays import Array, are_real
from pinmobile.compiled.parts import Parts, when
from pinmobile.compiled.symbolic import Moment, Values, entries, has_symbols
from pinmobile.divergence import is_alive
from pinmobile.errors import InvalidArgument, shown
from pinmobile.measures import measured_of, size_of
from pinmobile.signals import Claim, claimed, number, signals_of


class Reference(NamedTuple):
    """What is to be followed: the first n coordinates; leading axes where there are several samples.

    Attributes
    ----------
    q, v, a : ndarray, shape (..., leading[n]), (..., n), (..., n)
        Configuration, velocity and acceleration.
    """

    q: Any
    v: Any
    a: Any


class Memory(NamedTuple):
    """What the parts keep between samples."""

    plant: Any
    controller: Any
    recorder: Any


class Sample(NamedTuple):
    """One sample of a closed loop.

    Attributes
    ----------
    k, t : float
        Number and time [s].
    q, v, u, a : ndarray, shape (nq,), (nv,), (nu,), (nv,)
        State, input after all limits, and acceleration.
    error, error_rate : ndarray, shape (n,)
        Of the coordinates that the reference has; None where the recorder has ``errors = False``.
    signals : dict of str to Claim
        What parts tell, by name, where the recorder has ``signals = True``; nothing otherwise.
    measured : ndarray, shape (m,)
        What the plant's ``measured`` gives, where the recorder has ``measures``; nothing otherwise.
    """

    k: Moment
    t: Moment
    q: Any
    v: Any
    u: Any
    a: Any
    error: Any
    error_rate: Any
    signals: Mapping[str, Claim] = {}
    measured: Any = ()


class Record(NamedTuple):
    """What a recorder makes of a sample.

    Attributes
    ----------
    state : tree of ndarrays
        What it keeps; as it is after the last sample, it is the result.
    counted : sequence of numbers
        Sizes, >= 0 or infinite, that are counted in bins.
    kept : dict of str to ndarray
        What is kept of every sample.
    units : dict of str to str
        Of what of it are signals, by name; they are kept as ``"signal <name>"``.
    """

    state: Any
    counted: Sequence[Values] = ()
    kept: Mapping[str, Values] = {}
    units: Mapping[str, str] = {}


@dataclass(frozen=True)
class Summary:
    """The largest and mean square error, and the largest input, of each robot, while it is alive.

    Once it is not `is_alive`, it has diverged: from then on nothing is taken of it.

    Parameters
    ----------
    limit : float
        Largest error.
    begin : float or None
        Number of the first sample of which the error is kept; None: all are, which is faster than 0.
    distances : tuple of tuples of int
        Coordinates whose errors make a distance together; of each distance the largest is kept, and its sizes
        are counted.
    measures : tuple of (int, bool)
        Which of the plant's measures are kept and counted, and whether it is a margin, of which the smallest
        is the worst: see `pinmobile.measures`.
    """

    limit: float = np.inf
    begin: float | None = None
    distances: tuple[tuple[int, ...], ...] = ((0, 1), (2,))
    measures: tuple[tuple[int, bool], ...] = ()

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its numbers."""
        return ("limit",) if self.begin is None else ("limit", "begin")

    def initial_state(self, n: int, nu: int) -> dict[str, Array]:
        """Return the record of no sample, for n errors and nu inputs."""
        farthest = sum(len(group) > 1 for group in self.distances)
        return {
            "alive": np.ones(()),
            "lived": np.zeros(()),
            "largest": np.zeros(n),
            "farthest": np.zeros(farthest),  # squared
            "squares": np.zeros(n),
            "inputs": np.zeros(nu),
            **self._unmeasured(),
        }

    def _unmeasured(self) -> dict[str, Array]:
        if not self.measures:
            return {}
        worst = np.array([-np.inf if is_margin else 0.0 for _, is_margin in self.measures])
        return {"worst": worst, "measure_squares": np.zeros(len(worst))}  # margins: the largest -m

    def __call__(self, sample: Sample, state: Mapping[str, Values]) -> Record:
        """Return the record with one more sample."""
        errors = np.concatenate([sample.error, sample.error_rate], axis=-1)
        alive = (state["alive"] > 0.5) & is_alive(errors, self.limit, sample.u, sample.a)
        one = np.where(alive, 1.0, 0.0)
        error = np.where(alive[..., None], np.abs(sample.error), 0.0)
        keep = 1.0 if self.begin is None else np.where(sample.k == self.begin, 0.0, 1.0)
        squares = error * error
        groups = [sum(squares[..., i] for i in group) for group in self.distances]
        far = [square for square, group in zip(groups, self.distances, strict=True) if len(group) > 1]
        new = {
            "alive": one,
            "lived": state["lived"] + one,
            "largest": _larger(error, state["largest"] * keep),
            "farthest": _larger(np.stack(far, axis=-1), state["farthest"] * keep)
            if far
            else state["farthest"],
            "squares": state["squares"] * keep + squares,
            "inputs": _larger(np.where(alive[..., None], np.abs(sample.u), 0.0), state["inputs"]),
        }
        sizes = [
            np.sqrt(np.where(alive, square, np.inf))
            if len(group) > 1
            else np.where(alive, error[..., group[0]], np.inf)
            for square, group in zip(groups, self.distances, strict=True)
        ]
        if not self.measures:
            return Record(new, sizes)
        kept, found = self._measured(sample, state, alive)
        return Record(new | kept, sizes + found)

    def _measured(
        self, sample: Sample, state: Mapping[str, Values], alive: Values
    ) -> tuple[dict[str, Any], list[Any]]:
        """Return what is kept of the plant's measures, and their sizes."""
        columns = [(sample.measured[..., i], is_margin) for i, is_margin in self.measures]
        bad = [-x if is_margin else np.abs(x) for x, is_margin in columns]
        before = {name: state[name] for name in ("worst", "measure_squares")}
        if self.begin is not None:  # what was infinite before is forgotten, too
            first = self._unmeasured()
            before = {name: np.where(sample.k == self.begin, first[name], x) for name, x in before.items()}
        lives = alive[..., None]
        worst = np.where(lives, np.stack(bad, axis=-1), self._unmeasured()["worst"])
        squares = np.where(lives, np.stack([x * x for x, _ in columns], axis=-1), 0.0)
        kept = {
            "worst": _larger(worst, before["worst"]),
            "measure_squares": before["measure_squares"] + squares,
        }
        sizes = [
            np.where(alive, size_of(x) if is_margin else y, 0.0 if is_margin else np.inf)
            for (x, is_margin), y in zip(columns, bad, strict=True)
        ]
        return kept, sizes


def _larger(a: Values, b: Values) -> Any:
    """Return the larger of numbers that are known to be some."""
    return np.where(a > b, a, b)


@dataclass(frozen=True)
class Trace:
    """All samples: configuration, velocity, input and acceleration, and what parts tell."""

    parameters: ClassVar[tuple[str, ...]] = ()
    signals: ClassVar[bool] = True
    errors: ClassVar[bool] = False

    def initial_state(self, n: int, nu: int) -> None:
        """Return None: nothing is kept from one sample to the next."""

    def __call__(self, sample: Sample, state: object) -> Record:
        """Return the sample."""
        kept = {"q": sample.q, "v": sample.v, "u": sample.u, "a": sample.a}
        kept |= {f"signal {name}": claim.value for name, claim in sample.signals.items()}
        return Record(state, (), kept, {name: claim.unit for name, claim in sample.signals.items()})


NOTHING = Record(None)
"""The record of one who keeps nothing."""


class Stepped(NamedTuple):
    """What one sample of a loop comes to.

    Attributes
    ----------
    sample : Sample
        As it was recorded.
    q, v : ndarray
        State that the last substep leads to; of v the next sample takes what constraints leave.
    memory : Memory
        What the parts keep.
    record : Record
        What the recorder made of it.
    """

    sample: Sample
    q: Any
    v: Any
    memory: Memory
    record: Record


def one_sample(
    parts: Parts,
    k: Moment,
    t: Moment,
    h: Moment,
    state: tuple[Values, Values],
    reference: Reference,
    memory: Memory,
) -> Stepped:
    """Return one sample of the closed loop, and the state at the next.

    Parameters
    ----------
    parts : Parts
        The loop.
    k, t, h : float
        Number and time of the sample, and length of a substep [s].
    state : tuple of ndarray, shape (nq,), (nv,)
        Configuration and velocity: the start, or what the sample before came to.
    reference : Reference
        Of this sample.
    memory : Memory
        What the parts keep.
    """
    plant, controller = parts.law, parts.controller
    q, v = state
    if parts.is_constrained:
        # Here, not after the step: this sample's dynamics need the same mass matrix, which a tape has once.
        v = np.where(k == 0.0, v, plant.project(q, v))  # a start is as it was given
    error, error_rate = tracking_errors(plant, q, v, reference) if parts.records_errors else (None, None)
    answer = controller(t, q.copy(), v.copy(), reference, memory.controller)
    if type(answer) is not tuple or len(answer) != 2:
        raise InvalidArgument(f"controller returned {shown(answer)}{when(t)}, expected (u, state)")
    u, inner = answer
    if type(u) is not np.ndarray or u.dtype != np.float64 or u.shape != (plant.nu,):
        u = _numbers("controller", u, t, (plant.nu,))
    if parts.limits is not None:
        u = np.clip(u, *parts.limits)
    if parts.is_informed:
        inner = controller.applied(u.copy(), inner)
    acceleration, q1, v1, kept = moved_on(parts, t, h, q, v, u, memory.plant)
    signals: Mapping[str, Claim] = {}
    if parts.tells:
        own = signals_of(controller, inner)
        signals = claimed(told_by(parts, t, q, v, u, memory.plant, own), _signal)
    measured: Any = ()
    if parts.is_measured:
        measured = measured_of(plant, t, q, v, acceleration, u, reference)
    sample = Sample(k, t, q, v, u, acceleration, error, error_rate, signals, measured)
    record = NOTHING if parts.recorder is None else parts.recorder(sample, memory.recorder)
    if kept is not memory.plant or inner is not memory.controller or record is not NOTHING:
        memory = Memory(kept, inner, record.state)
    return Stepped(sample, q1, v1, memory, record)


def _numbers(name: str, found: Any, t: Moment, shape: tuple[int, ...]) -> Any:
    """Return what a part returned as an array, of this shape and of real numbers."""
    array = np.asarray(found)
    if np.shape(array) != shape or not are_real(array):
        of = "" if are_real(array) else " of real numbers"
        raise InvalidArgument(
            f"{name} returned {shown(found)}{when(t)}, expected an array of shape {shape}{of}"
        )
    return array


def told_by(
    parts: Parts, t: Moment, q: Values, v: Values, u: Values, memory: object, own: Any = None
) -> Iterator[tuple[str, Any]]:
    """Yield the signals of the parts at a sample, with `own` of the controller, each by what it is called."""
    plant = parts.law
    if hasattr(plant, "signals"):
        f = _acting(parts, t, q, v, u) + np.zeros(plant.nv)
        yield "plant", plant.signals(t, q.copy(), v.copy(), u.copy(), f, memory)
    if own is not None:
        yield "controller", own
    for i, force in enumerate(parts.forces):
        if hasattr(force, "on_coordinates"):
            yield f"forces[{i}]", signals_of(force, t, q.copy(), v.copy())
        elif hasattr(force, "signals"):
            yield f"forces[{i}]", force.signals(t, plant.pose(q), plant.rate(q, v))


def _signal(name: str, value: Any) -> Array:
    return entries(value) if has_symbols(value) else number(name, value)


def tracking_errors(plant: Any, q: Values, v: Values, reference: Reference) -> tuple[Any, Any]:
    """Return the error of the reference's coordinates, and its rate, shape (n,) each."""
    n, length = reference.v.shape[-1], reference.q.shape[-1]
    whole = reference.q
    if length != plant.nq:  # what has no reference is where it should be
        ahead = np.shape(q)[:-1]
        whole = np.concatenate([np.broadcast_to(whole, (*ahead, length)), q[..., length:]], axis=-1)
    return plant.difference(q, whole)[..., :n], reference.v - v[..., :n]


def _pushed(parts: Parts, t: Moment, q: Values, v: Values) -> Any:
    """Return the forces on the coordinates beside the input, shape (nv,), or 0."""
    plant, total = parts.law, 0.0
    wrenches, others = parts.acting
    if wrenches:
        pose, rate = plant.pose(q), plant.rate(q, v)
        wrench: Any = 0.0
        for k, force in wrenches:
            wrench = wrench + _numbers(f"forces[{k}]", force(t, pose.copy(), rate.copy()), t, np.shape(pose))
        if type(wrench) is np.ndarray and not isfinite(wrench.sum()):
            return np.full(plant.nv, np.nan)  # for the run to tell, with all that was before
        total = plant.effort(q, wrench)
        if total is None:
            raise InvalidArgument(
                f"plant is a {type(plant).__name__}, whose body cannot be pushed, and forces push it"
            )
    for k, force in others:
        found = force.on_coordinates(t, q.copy(), v.copy())
        total = total + _numbers(f"forces[{k}].on_coordinates", found, t, np.shape(v))
    return total


def _acting(parts: Parts, t: Moment, q: Values, v: Values, u: Values) -> Any:
    """Return all forces on the coordinates beside the input, shape (nv,), or 0."""
    plant, pushed = parts.law, _pushed(parts, t, q, v)
    if not parts.carries:
        return pushed
    return pushed + reaction(plant, parts.forces, t, q, lambda f: plant.forward_dynamics(q, v, u, pushed + f))


def reaction(
    plant: Any, forces: Iterable[Any], t: Moment, q: Values, accelerate: Callable[[Any], Values]
) -> Any:
    """Return by what force on the coordinates the body is held back by what forces make it carry.

    With the mass matrix M that these add to the body, the wrench w = -M a acts on it, a that of the body. As
    a is linear in w, ``a = a_0 + W w``, it follows from ``(1 + M W) w = -M a_0``.

    Parameters
    ----------
    plant : plant
        Whose first coordinates are x, y and psi of the body.
    forces : iterable of forces
        Those with ``inertia(t, pose)`` add that mass matrix, shape (..., 3, 3).
    t : float
        Time [s].
    q : ndarray, shape (..., nq)
        Configuration.
    accelerate : callable
        Returns the acceleration, shape (..., nv), under a further force on the coordinates.

    Returns
    -------
    ndarray, shape (..., nv), or float
        0.0 where none is added.
    """
    carried = [force for force in forces if hasattr(force, "inertia")]
    if not carried:
        return 0.0
    M = sum(force.inertia(t, plant.pose(q)) for force in carried)
    axes = [plant.effort(q, axis + 0.0 * q[..., :3]) for axis in np.eye(3)]
    free = accelerate(0.0)[..., :3]
    W = np.stack([accelerate(axis)[..., :3] - free for axis in axes], axis=-1)
    w = -np.linalg.solve(np.eye(3) + M @ W, M @ free[..., None])[..., 0]
    return sum(w[..., k : k + 1] * axis for k, axis in enumerate(axes))


def integrate_of(plant: object) -> Any:
    """Return how a displacement moves a plant's configuration: as it says, else by addition."""
    return getattr(plant, "integrate", None) or np.add


def integrated(parts: Parts, t: Moment, h: Moment, q: Values, v: Values, u: Values, memory: object) -> Any:
    """Return the acceleration, and the state after the substeps, by the integrator on displacements."""
    plant, integrate, first = parts.law, parts.integrate, None
    for j in range(parts.substeps):
        time = t + j * h if j else t
        if j and parts.is_constrained:
            v = plant.project(q, v)
        a, begin = _accelerated(parts, time, q, v, u), q
        first = a if first is None else first

        def acceleration(time: Moment, moved: Values, rate: Values) -> Any:
            return _accelerated(parts, time, integrate(begin, moved), rate, u)  # noqa: B023

        moved, v = parts.displaced(acceleration, a, time, v, h)
        q = integrate(begin, moved)
    return first, q, v, memory


def _accelerated(parts: Parts, t: Moment, q: Values, v: Values, u: Values) -> Any:
    """Return the acceleration of the plant, shape (nv,)."""
    plant = parts.law
    if parts.forces:
        found = plant.forward_dynamics(q, v, u, _acting(parts, t, q, v, u))
    else:
        found = plant.forward_dynamics(q, v, u)
    if type(found) is np.ndarray and found.shape == v.shape and found.dtype == np.float64:
        return found
    return _numbers("plant.forward_dynamics", found, t, np.shape(v))


def moved_on(parts: Parts, t: Moment, h: Moment, q: Values, v: Values, u: Values, memory: object) -> Any:
    """Return the acceleration, the state after the substeps of a sample, and what the plant keeps."""
    return (_stepped if parts.steps else integrated)(parts, t, h, q, v, u, memory)


def _stepped(parts: Parts, t: Moment, h: Moment, q: Values, v: Values, u: Values, memory: object) -> Any:
    """Return the mean acceleration of the first substep, and the state after all, by the plant's own step."""
    acceleration = None
    for j in range(parts.substeps):
        time = t + j * h if j else t
        found = parts.law.step(time, q, v, u, h, partial(_pushed, parts), memory)
        if not all(hasattr(found, name) for name in ("q", "v", "memory")):
            raise InvalidArgument(
                f"plant.step returned {shown(found)}{when(t)}, expected a Step(q, v, memory)"
            )
        q1, v1 = (
            _numbers(f"{name} of plant.step", getattr(found, name), t, np.shape(x))
            for name, x in (("q", q), ("v", v))
        )
        if acceleration is None:
            own = getattr(found, "a", None)
            acceleration = (v1 - v) / h if own is None else own
        q, v, memory = q1, v1, found.memory
    return acceleration, q, v, memory
