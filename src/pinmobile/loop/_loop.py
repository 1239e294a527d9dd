"""`Loop`, a closed loop of parts, and `step`, the one function that computes a sample of it.

`step` runs on numbers and on symbols alike: the compiled loop is this function, traced once; the loop in
Python calls it at each sample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from math import isfinite
from typing import Any, NamedTuple, final

import attrs
import numpy as np

from pinmobile.arrays import Array, are_real
from pinmobile.compiled import entries, has_symbols
from pinmobile.errors import InvalidArgument, shown
from pinmobile.metrics import evaluate_metrics_of
from pinmobile.parts import (
    Carried,
    Constrained,
    Informed,
    Measuring,
    OnCoordinates,
    Signalling,
    Stepping,
    able,
    array,
    child,
    children,
    integer,
    part,
)
from pinmobile.plant import Context, coordinates_of, stated
from pinmobile.signals import Claim, claimed, number as signal_number, signals_of
from pinmobile.trajectories import Reference


def _zeros(loop: Any) -> Array:
    return np.zeros(loop.plant.nv)


def _coordinates(loop: Any) -> list[str]:
    return [one.name for one in coordinates_of(loop.plant)]


def _rates(loop: Any) -> list[str]:
    return [one.rate or f"{one.name}_rate" for one in coordinates_of(loop.plant)]


def _units(loop: Any) -> str:
    return ", ".join(one.unit for one in coordinates_of(loop.plant))


def _rate_units(loop: Any) -> str:
    return ", ".join(f"{one.unit or '1'}/s" for one in coordinates_of(loop.plant))


_OF_START = attrs.Factory(_zeros, takes_self=True)


@final
@part
class Loop:
    """A closed loop: a plant, a controller, a trajectory, forces, an integrator and a recorder.

    What a part can do is looked up once, before the first sample. Paths such as ``"plant.mass"`` and
    ``"forces.0.force.x"`` start here.
    """

    plant: Any = child(object, doc="simulated system", expected="a plant")
    controller: Any = child(object, doc="controller, with its wrappers", expected="a controller")
    trajectory: Any = child(object, default=None, optional=True, doc="what the reference is sampled from")
    forces: Any = children(object, default=(), doc="external forces")
    integrator: Any = child(
        object, default=None, optional=True, doc="None for a plant with a step of its own"
    )
    substeps: int = integer(default=1, least=1, doc="steps of the plant in a sample")
    recorder: Any = child(object, default=None, optional=True, doc="part that records samples")
    start: Any = array(default=_OF_START, labels=_coordinates, unit=_units, doc="displacement of the start")
    start_rate: Any = array(
        default=_OF_START, labels=_rates, unit=_rate_units, doc="velocity added at the start"
    )

    @cached_property
    def law(self) -> Any:
        """The dynamics as a loop calls them, unchecked where the plant offers that."""
        own = stated(self.plant, "law")
        return self.plant if own is None else own

    @cached_property
    def integrate(self) -> Callable[[Any, Any], Any]:
        """Function of a configuration and a displacement."""
        own = stated(self.law, "integrate")
        return np.add if own is None else own

    @cached_property
    def steps(self) -> bool:
        """Whether the plant has a step of its own."""
        return able(self.law, Stepping) is not None

    @cached_property
    def is_constrained(self) -> bool:
        """Whether velocities are projected before each substep; a plant's own step does so itself."""
        return not self.steps and able(self.law, Constrained) is not None

    @cached_property
    def displaced(self) -> Callable[..., tuple[Any, Any]]:
        """The integrator as a function of displacements, given the acceleration at the start."""
        own = stated(self.integrator, "displaced")
        return partial(displaced, self.integrator) if own is None else own

    @cached_property
    def limits(self) -> tuple[Array, Array] | None:
        """Least and largest input, shape (nu,); None where nothing has a limit."""
        inputs = getattr(self.plant, "inputs", ())
        low, high = (
            np.array([sign * np.inf if (x := stated(each, side)) is None else x for each in inputs])
            for side, sign in (("lower", -1.0), ("upper", 1.0))
        )
        return (low, high) if np.isfinite([low, high]).any() else None

    @cached_property
    def named_forces(self) -> dict[str, Any]:
        """The forces, by what messages call them."""
        return named_forces(self.forces)

    @cached_property
    def all_forces(self) -> tuple[Any, ...]:
        """The forces, without their names."""
        return tuple(self.named_forces.values())

    @cached_property
    def wrenches(self) -> list[tuple[str, Any]]:
        """The forces that push the body, each with its name."""
        return [item for item in self.named_forces.items() if not able(item[1], OnCoordinates)]

    @cached_property
    def efforts(self) -> list[tuple[str, Any]]:
        """The forces on the coordinates, each with its name."""
        return [item for item in self.named_forces.items() if able(item[1], OnCoordinates)]

    @cached_property
    def carries(self) -> bool:
        """Whether a force adds to the inertia of the body."""
        return any(able(force, Carried) for force in self.all_forces)

    @cached_property
    def is_informed(self) -> bool:
        """Whether the controller takes the applied input."""
        return able(self.controller, Informed) is not None

    @cached_property
    def records_errors(self) -> bool:
        """Whether the recorder looks at errors."""
        return self.recorder is not None and getattr(self.recorder, "errors", True)

    @cached_property
    def is_measured(self) -> bool:
        """Whether the recorder looks at the plant's metrics."""
        return bool(getattr(self.recorder, "metrics", ())) and able(self.plant, Measuring) is not None

    @cached_property
    def signals(self) -> bool:
        """Whether the recorder keeps signals, and a part has some."""
        parts = self.law, self.controller, *self.all_forces
        wanted = stated(self.recorder, "signals")
        return wanted and any(able(each, Signalling) for each in parts)


def named_forces(forces: Any) -> dict[str, Any]:
    """Return forces, of a sequence or a mapping, by what messages call them."""
    if isinstance(forces, Mapping):
        return {f"forces.{name}": force for name, force in forces.items()}
    return {f"forces[{k}]": force for k, force in enumerate(forces)}


class State(NamedTuple):
    """A loop between two samples.

    Attributes
    ----------
    q, v : ndarray, shape (nq,), (nv,)
        Configuration and velocity; of v the next sample takes what constraints leave.
    plant, controller, recorder : any
        Memory of the parts.
    """

    q: Any
    v: Any
    plant: Any = None
    controller: Any = None
    recorder: Any = None


OWNERS = State._fields[2:]
"""The parts with memory, in the order of `State`."""


class Sample(NamedTuple):
    """One sample of a closed loop.

    Attributes
    ----------
    k, t : float
        Number and time [s].
    q, v, u, a : ndarray, shape (nq,), (nv,), (nu,), (nv,)
        State, input after all limits, and acceleration.
    error, error_rate : ndarray, shape (n,)
        Of the coordinates of the reference; None where the recorder has ``errors = False``.
    signals : dict of str to Claim
        By name, where the recorder has ``signals = True``.
    measured : ndarray, shape (m,)
        Metrics of the plant, where the recorder has ``metrics``.
    """

    k: Any
    t: Any
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
        Its memory; after the last sample, this is the result.
    counted : sequence of numbers
        Sizes, >= 0 or infinite, that are counted in bins.
    kept : dict of str to ndarray
        Values kept of every sample.
    units : dict of str to str
        Units of the signals among them, by name; they are kept as ``"signal <name>"``.
    """

    state: Any
    counted: Sequence[Any] = ()
    kept: Mapping[str, Any] = {}
    units: Mapping[str, str] = {}


NOTHING = Record(None)
"""The record of a recorder without memory."""


def step(
    loop: Loop, k: Any, t: Any, h: Any, state: State, reference: Reference
) -> tuple[State, Sample, Record]:
    """Return the state at the next sample, and this sample with its record.

    Parameters
    ----------
    loop : Loop
        The closed loop.
    k, t, h : float
        Number and time of the sample, and length of a substep [s].
    state : State
        The start, or the state after the sample before.
    reference : Reference
        Of this sample.
    """
    plant, controller = loop.law, loop.controller
    q, v, memory, kept, record_state = state
    if loop.is_constrained:
        # Here, not after the step: this sample's dynamics need the same mass matrix, which a tape has once.
        v = np.where(k == 0.0, v, plant.project(q, v))  # a start is as it was given
    error, error_rate = tracking_errors(plant, q, v, reference) if loop.records_errors else (None, None)
    answer = controller(t, q.copy(), v.copy(), reference, kept)
    if type(answer) is not tuple or len(answer) != 2:
        raise InvalidArgument(f"controller returned {shown(answer)}{when(t)}, expected (u, state)")
    u, kept = answer
    if type(u) is not np.ndarray or u.dtype != np.float64 or u.shape != (plant.nu,):
        u = _numbers("controller", u, t, (plant.nu,))
    if loop.limits is not None:
        u = np.clip(u, *loop.limits)
    if loop.is_informed:
        kept = controller.applied(u.copy(), kept)
    a, q1, v1, after = advance(loop, t, h, q, v, u, memory)
    signals: Mapping[str, Claim] = {}
    if loop.signals:
        own = signals_of(controller, kept)
        signals = claimed(collected_signals(loop, t, q, v, u, memory, own), _signal)
    measured: Any = ()
    if loop.is_measured:
        measured = evaluate_metrics_of(plant, t, q, v, a, u, reference)
    sample = Sample(k, t, q, v, u, a, error, error_rate, signals, measured)
    record = NOTHING if loop.recorder is None else loop.recorder(sample, record_state)
    return State(q1, v1, after, kept, record.state), sample, record


def _numbers(name: str, found: Any, t: Any, shape: tuple[int, ...]) -> Any:
    """Return what a part returned as an array, of this shape and of real numbers."""
    array = np.asarray(found)
    if np.shape(array) != shape or not are_real(array):
        of = "" if are_real(array) else " of real numbers"
        raise InvalidArgument(
            f"{name} returned {shown(found)}{when(t)}, expected an array of shape {shape}{of}"
        )
    return array


def when(t: Any) -> str:
    """Return a time in words, for messages; nothing of a symbol."""
    return f" at t = {t:g} s" if isinstance(t, float) else ""


def collected_signals(
    loop: Loop, t: Any, q: Any, v: Any, u: Any, memory: object, own: Any = None
) -> Iterator[tuple[str, Any]]:
    """Yield the signals of the parts at a sample, with `own` of the controller, each part by its path."""
    plant = loop.law
    if able(plant, Signalling):
        f = _external(loop, t, q, v, u) + np.zeros(plant.nv)
        yield "plant", plant.signals(t, q.copy(), v.copy(), u.copy(), f, memory)
    if own is not None:
        yield "controller", own
    for name, force in loop.named_forces.items():
        if able(force, OnCoordinates):
            yield name, signals_of(force, t, q.copy(), v.copy())
        elif able(force, Signalling):
            yield name, force.signals(t, plant.pose(q), plant.pose_rate(q, v))


def _signal(name: str, value: Any) -> Any:
    return entries(value) if has_symbols(value) else signal_number(name, value)


def tracking_errors(plant: Any, q: Any, v: Any, reference: Reference) -> tuple[Any, Any]:
    """Return the error of the reference's coordinates, and its rate, shape (n,) each."""
    n, length = reference.v.shape[-1], reference.q.shape[-1]
    whole = reference.q
    if length != plant.nq:  # coordinates without a reference have no error
        ahead = np.shape(q)[:-1]
        whole = np.concatenate([np.broadcast_to(whole, (*ahead, length)), q[..., length:]], axis=-1)
    return plant.difference(q, whole)[..., :n], reference.v - v[..., :n]


def _pushed(loop: Loop, t: Any, q: Any, v: Any) -> Any:
    """Return the external forces on the coordinates, shape (nv,), or 0."""
    plant, total = loop.law, 0.0
    if loop.wrenches:
        pose, rate = plant.pose(q), plant.pose_rate(q, v)
        wrench: Any = 0.0
        for name, force in loop.wrenches:
            wrench = wrench + _numbers(name, force(t, pose.copy(), rate.copy()), t, np.shape(pose))
        if type(wrench) is np.ndarray and not isfinite(wrench.sum()):
            return np.full(plant.nv, np.nan)  # the run reports it, with all samples before
        total = plant.generalized_force(q, wrench)
        if total is None:
            raise InvalidArgument(
                f"plant is a {type(loop.plant).__name__}, whose body cannot be pushed, and forces push it"
            )
    for name, force in loop.efforts:
        found = force.on_coordinates(t, q.copy(), v.copy())
        total = total + _numbers(f"{name}.on_coordinates", found, t, np.shape(v))
    return total


def _external(loop: Loop, t: Any, q: Any, v: Any, u: Any) -> Any:
    """Return the external forces with the reaction of what they make the body carry, shape (nv,), or 0."""
    plant, pushed = loop.law, _pushed(loop, t, q, v)
    if not loop.carries:
        return pushed
    forces = loop.all_forces
    return pushed + reaction(plant, forces, t, q, lambda f: plant.forward_dynamics(q, v, u, pushed + f))


def reaction(plant: Any, forces: Iterable[Any], t: Any, q: Any, accelerate: Callable[[Any], Any]) -> Any:
    """Return the force on the coordinates by which carried inertia holds the body back.

    With the mass matrix M that forces add to the body, the wrench w = -M a acts on it, a that of the body. As
    a is linear in w, ``a = a_0 + W w``, it follows from ``(1 + M W) w = -M a_0``.

    Parameters
    ----------
    plant : plant
        Its first coordinates are x, y and psi of the body.
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
    carried = [force for force in forces if able(force, Carried)]
    if not carried:
        return 0.0
    M = sum(force.inertia(t, plant.pose(q)) for force in carried)
    axes = [plant.generalized_force(q, axis + 0.0 * q[..., :3]) for axis in np.eye(3)]
    free = accelerate(0.0)[..., :3]
    W = np.stack([accelerate(axis)[..., :3] - free for axis in axes], axis=-1)
    w = -np.linalg.solve(np.eye(3) + M @ W, M @ free[..., None])[..., 0]
    return sum(w[..., k : k + 1] * axis for k, axis in enumerate(axes))


def advance(loop: Loop, t: Any, h: Any, q: Any, v: Any, u: Any, memory: object) -> Any:
    """Return the acceleration, the state after the substeps of a sample, and the plant's memory."""
    return (_own_steps if loop.steps else _integrated)(loop, t, h, q, v, u, memory)


def _integrated(loop: Loop, t: Any, h: Any, q: Any, v: Any, u: Any, memory: object) -> Any:
    """Return the acceleration, and the state after the substeps, by the integrator on displacements."""
    plant, integrate, first = loop.law, loop.integrate, None
    for j in range(loop.substeps):
        time = t + j * h if j else t
        if j and loop.is_constrained:
            v = plant.project(q, v)
        a, begin = _accelerated(loop, time, q, v, u), q
        first = a if first is None else first

        def acceleration(time: Any, moved: Any, rate: Any) -> Any:
            return _accelerated(loop, time, integrate(begin, moved), rate, u)  # noqa: B023

        moved, v = loop.displaced(acceleration, a, time, v, h)
        q = integrate(begin, moved)
    return first, q, v, memory


def _accelerated(loop: Loop, t: Any, q: Any, v: Any, u: Any) -> Any:
    """Return the acceleration of the plant, shape (nv,)."""
    plant = loop.law
    if loop.forces:
        found = plant.forward_dynamics(q, v, u, _external(loop, t, q, v, u))
    else:
        found = plant.forward_dynamics(q, v, u)
    if type(found) is np.ndarray and found.shape == v.shape and found.dtype == np.float64:
        return found
    return _numbers("plant.forward_dynamics", found, t, np.shape(v))


def _own_steps(loop: Loop, t: Any, h: Any, q: Any, v: Any, u: Any, memory: object) -> Any:
    """Return the mean acceleration of the first substep, and the state after all, by the plant's own step."""
    acceleration = None
    for j in range(loop.substeps):
        time = t + j * h if j else t
        found = loop.law.step(time, q, v, u, h, partial(_pushed, loop), memory)
        if not all(hasattr(found, name) for name in ("q", "v", "memory")):
            raise InvalidArgument(
                f"plant.step returned {shown(found)}{when(t)}, expected a Step(q, v, memory)"
            )
        q1, v1 = (
            _numbers(f"{name} of plant.step", getattr(found, name), t, np.shape(x))
            for name, x in (("q", q), ("v", v))
        )
        if acceleration is None:
            own = stated(found, "a")
            acceleration = (v1 - v) / h if own is None else own
        q, v, memory = q1, v1, found.memory
    return acceleration, q, v, memory


def displaced(integrator: Any, acceleration: Any, first: Any, t: Any, v: Any, h: Any) -> Any:
    """Return the displacement and the velocity after a step of any integrator, which gets copies."""
    still, own = np.zeros(np.shape(v)), v.copy()

    def asked(time: Any, moved: Any, rate: Any) -> Any:
        known = moved is still and rate is own and time is t and type(v) is np.ndarray
        if known and not still.any() and (own == v).all():  # unless it was written into
            return first
        return acceleration(time, moved, rate)

    answer = integrator(asked, t, still, own, h)
    wrong = type(answer) is not tuple or len(answer) != 2
    if wrong or any(np.shape(x) != np.shape(v) or not are_real(x) for x in answer):
        raise InvalidArgument(
            f"integrator returned {shown(answer)}{when(t)}, expected (q, v) of shapes {np.shape(v)} and "
            f"{np.shape(v)}, of real numbers"
        )
    return answer


def initial(loop: Loop, context: Context, q: Any = None, v: Any = None) -> State:
    """Return the state before the first sample, with the memory of the parts."""
    begin = stated(loop.law, "initial_state")
    return State(
        q,
        v,
        None if begin is None else begin(context),
        loop.controller.initial_state(context),
        None if loop.recorder is None else loop.recorder.initial_state(context.size, loop.plant.nu),
    )
