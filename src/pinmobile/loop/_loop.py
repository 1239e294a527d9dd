"""`Loop`, a closed loop of parts, and `step`, the function that computes one of its samples.

`step` accepts numbers and symbols. The compiled loop is this function, traced once; the loop in Python calls
it at each sample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from math import isfinite
from typing import Any, ClassVar, NamedTuple, final

import attrs
import numpy as np

from pinmobile.arrays import Array, are_real, one_of
from pinmobile.compiled import entries, has_symbols, place_of
from pinmobile.controllers import evaluate, stamp
from pinmobile.errors import InvalidArgument, NotTraceable, format_value
from pinmobile.metrics import Metric, evaluate_metrics_of, size_of
from pinmobile.parts import (
    Carried,
    Constrained,
    Informed,
    Measuring,
    OnCoordinates,
    Signalling,
    Stepping,
    able,
    advice,
    array,
    child,
    children,
    integer,
    number,
    option,
    part,
)
from pinmobile.plant import Context, coordinates_of, full_configurations, stated
from pinmobile.signals import NO_SIGNALS, SignalSample, collect_signals, number as signal_number, signals_of
from pinmobile.trajectories import Reference


def _zeros(loop: Any) -> Array:
    return np.zeros(loop.plant.nv)


def _coordinates(loop: Any) -> list[str]:
    return [coordinate.name for coordinate in coordinates_of(loop.plant)]


def _rates(loop: Any) -> list[str]:
    return [coordinate.rate or f"{coordinate.name}_rate" for coordinate in coordinates_of(loop.plant)]


def _units(loop: Any) -> str:
    return ", ".join(coordinate.unit for coordinate in coordinates_of(loop.plant))


def _rate_units(loop: Any) -> str:
    return ", ".join(f"{coordinate.unit or '1'}/s" for coordinate in coordinates_of(loop.plant))


_ZERO_START = attrs.Factory(_zeros, takes_self=True)


@final
@part
class Loop:
    """Closed loop of a plant, a controller, a trajectory, forces, an integrator and a recorder.

    The loop looks up the capabilities of its parts once, before the first sample. Paths such as
    ``"plant.mass"`` and ``"forces.0.force.x"`` begin at the loop.

    Parameters
    ----------
    plant : plant
        Simulated system.
    controller : controller
        Controller with its wrappers.
    trajectory : trajectory, optional
        Source of the reference.
    forces : sequence or mapping of forces
        External forces.
    integrator : integrator, optional
        Integrator of the plant; None for a plant with its own step method.
    substeps : int
        Integrator steps per sample.
    recorder : recorder, optional
        Part that records samples, such as `Samples`, where you call `loop.step` yourself; `simulate` and
        `ensemble` use their own.
    start : array_like, shape (nv,)
        Displacement of the initial configuration [m, m, rad, ...].
    start_rate : array_like, shape (nv,)
        Velocity that is added to the initial velocity [m/s, m/s, rad/s, ...].

    Raises
    ------
    InvalidArgument
        If a field is invalid.

    See Also
    --------
    simulate : run a loop with one robot.
    loop.step : one sample of a loop.
    parts.replace : the same loop with other numbers.

    Examples
    --------
    >>> from pinmobile import PD, Loop, MobileRobot
    >>> from pinmobile.parts import replace
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> loop = Loop(plant=robot, controller=PD(120, 120))
    >>> replace(loop, {"plant.mass": 25.0}).plant.mass  # [kg]
    25.0
    """

    plant: Any = child(object, doc="simulated system", expected="a plant")
    controller: Any = child(object, doc="controller, with its wrappers", expected="a controller")
    trajectory: Any = child(object, default=None, doc="source of the reference")
    forces: Any = children(object, default=(), doc="external forces")
    integrator: Any = child(object, default=None, doc="integrator; None for a plant with its own step")
    substeps: int = integer(default=1, least=1, doc="integrator steps per sample")
    recorder: Any = child(object, default=None, doc="part that records samples")
    start: Any = array(default=_ZERO_START, labels=_coordinates, unit=_units, doc="displacement of the start")
    start_rate: Any = array(
        default=_ZERO_START, labels=_rates, unit=_rate_units, doc="velocity added to the initial velocity"
    )

    @cached_property
    def dynamics(self) -> Any:
        """Plant as the loop calls it: its unchecked dynamics if the plant offers them."""
        dynamics = stated(self.plant, "dynamics")
        return self.plant if dynamics is None else dynamics

    @cached_property
    def integrate(self) -> Callable[[Any, Any], Any]:
        """Function that adds a displacement to a configuration."""
        function = stated(self.dynamics, "integrate")
        return np.add if function is None else function

    @cached_property
    def steps(self) -> bool:
        """Whether the plant has its own step method."""
        return able(self.dynamics, Stepping) is not None

    @cached_property
    def is_constrained(self) -> bool:
        """Whether the loop projects velocities before each substep; a plant's own step does this itself.

        A recorder with ``as_measured = True`` keeps velocities as they are, like those that sensors measure.
        """
        projects = not (self.steps or stated(self.recorder, "as_measured"))
        return projects and able(self.dynamics, Constrained) is not None

    @cached_property
    def projects_after(self) -> bool:
        """Whether a sample ends with the projection instead of beginning with it, which has the same bits."""
        return self.is_constrained and bool(stated(self.recorder, "projects_after"))

    @cached_property
    def displaced(self) -> Callable[..., tuple[Any, Any]]:
        """Integrator as a function of displacements, which receives the acceleration at the start."""
        method = stated(self.integrator, "displaced")
        return partial(displace, self.integrator) if method is None else method

    @cached_property
    def limits(self) -> tuple[Array, Array] | None:
        """Smallest and largest input, shape (nu,) each; None if no input has a limit."""
        inputs = getattr(self.plant, "inputs", ())
        low, high = (
            np.array([sign * np.inf if (x := stated(entry, side)) is None else x for entry in inputs])
            for side, sign in (("lower", -1.0), ("upper", 1.0))
        )
        return (low, high) if np.isfinite([low, high]).any() else None

    @cached_property
    def named_forces(self) -> dict[str, Any]:
        """Forces by their names in messages."""
        return named_forces(self.forces)

    @cached_property
    def all_forces(self) -> tuple[Any, ...]:
        """Forces without their names."""
        return tuple(self.named_forces.values())

    @cached_property
    def wrenches(self) -> list[tuple[str, Any]]:
        """Names and forces that act on the body."""
        return [item for item in self.named_forces.items() if not able(item[1], OnCoordinates)]

    @cached_property
    def efforts(self) -> list[tuple[str, Any]]:
        """Names and forces that act on the coordinates."""
        return [item for item in self.named_forces.items() if able(item[1], OnCoordinates)]

    @cached_property
    def carries(self) -> bool:
        """Whether a force adds inertia to the body."""
        return any(able(force, Carried) for force in self.all_forces)

    @cached_property
    def is_informed(self) -> bool:
        """Whether the controller receives the applied input."""
        return able(self.controller, Informed) is not None

    @cached_property
    def records_errors(self) -> bool:
        """Whether the recorder reads errors."""
        return self.recorder is not None and getattr(self.recorder, "errors", True)

    @cached_property
    def is_measured(self) -> bool:
        """Whether the recorder reads the plant's metrics."""
        metrics = getattr(self.recorder, "metrics", ())
        return any(isinstance(index, int) for index, _ in metrics) and able(self.plant, Measuring) is not None

    @cached_property
    def signals(self) -> bool:
        """Whether the recorder keeps signals and a part has some."""
        parts = self.dynamics, self.controller, *self.all_forces
        is_kept = stated(self.recorder, "signals")
        return is_kept and any(able(part, Signalling) for part in parts)


def named_forces(forces: Any) -> dict[str, Any]:
    """Return the forces of a sequence or mapping by their names in messages."""
    if isinstance(forces, Mapping):
        return {f"forces.{name}": force for name, force in forces.items()}
    return {f"forces[{k}]": force for k, force in enumerate(forces)}


class State(NamedTuple):
    """State of a loop between two samples.

    Attributes
    ----------
    q, v : ndarray, shape (nq,), (nv,)
        Configuration and velocity. The next sample projects the velocity on the constraints.
    plant, controller, recorder : any
        Memory of the parts.
    """

    q: Any
    v: Any
    plant: Any = None
    controller: Any = None
    recorder: Any = None


OWNERS = State._fields[2:]
"""Parts with memory, in the order of `State`."""


class Sample(NamedTuple):
    """One sample of a closed loop, the argument of a recorder.

    Attributes
    ----------
    k, t : float
        Index and time [s] of the sample.
    q, v, u, a : ndarray, shape (nq,), (nv,), (nu,), (nv,)
        Configuration, velocity, applied input and acceleration.
    error, error_rate : ndarray, shape (n,)
        Errors of the reference's coordinates and of their rates; None if the recorder has ``errors = False``.
    signals : dict of str to SignalSample
        Signals by name, if the recorder has ``signals = True``.
    measured : ndarray, shape (m,)
        Metrics of the plant, if the recorder has ``metrics``.
    reference : Reference
        Reference of this sample.

    See Also
    --------
    loop.step : function that computes a sample.
    loop.Record : result of a recorder.

    Examples
    --------
    >>> from pinmobile.loop import Record, Sample
    >>> class LargestForce:
    ...     def initial_state(self, n, nu):
    ...         return 0.0
    ...     def __call__(self, sample, state):
    ...         return Record(max(state, abs(sample.u[0])))
    >>> sample = Sample(0, 0.0, [0], [0], [-5.0], [0], [0], [0])
    >>> LargestForce()(sample, 0.0).state  # [N]
    5.0
    """

    k: Any
    t: Any
    q: Any
    v: Any
    u: Any
    a: Any
    error: Any
    error_rate: Any
    signals: Mapping[str, SignalSample] = {}
    measured: Any = ()
    reference: Any = None


class RecordedStep(NamedTuple):
    """`Step` of a plant with the acceleration at its start, which the run records."""

    q: Any
    v: Any
    memory: Any
    a: Any


class Record(NamedTuple):
    """Result of a recorder for one sample.

    A recorder of your own is for a loop that you run by `loop.step`: `simulate`, `ensemble` and
    `loop.run_scenario` use their own. There, a controller records by ``signals``, and a plant by metrics.

    Attributes
    ----------
    state : tree of ndarrays
        Memory of the recorder; after the last sample, it is the result.
    counted : sequence of numbers
        Sizes, >= 0 or infinite, which the engine counts in bins.
    kept : dict of str to ndarray
        Values that the engine keeps for every sample, by name.
    units : dict of str to str
        Units of the signals among them, by name; `kept` contains a signal as ``"signal <name>"``.

    See Also
    --------
    loop.Samples : recorder of all samples.
    loop.Worst : recorder of the largest errors.

    Examples
    --------
    >>> from pinmobile.loop import Record
    >>> record = Record(0.3, kept={"error": 0.1})  # [m]
    >>> record.state, record.kept["error"]
    (0.3, 0.1)
    """

    state: Any
    counted: Sequence[Any] = ()
    kept: Mapping[str, Any] = {}
    units: Mapping[str, str] = {}


NOTHING = Record(None)
"""Record of a recorder without memory."""


def step(
    loop: Loop, k: Any, t: Any, h: Any, state: State, reference: Reference
) -> tuple[State, Sample, Record]:
    """Return the state at the next sample, and this sample with its record.

    Parameters
    ----------
    loop : Loop
        Closed loop.
    k, t, h : float
        Index and time [s] of the sample, and length of a substep [s].
    state : State
        Initial state, or the state after the previous sample.
    reference : Reference
        Reference of this sample.

    Returns
    -------
    state : State
        State at the next sample.
    sample : Sample
        This sample.
    record : Record
        Result of the recorder.

    Raises
    ------
    InvalidArgument
        If a part returns anything but real numbers of the expected shape.

    See Also
    --------
    simulate : run all samples.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import PD, Loop, MobileRobot, Reference, rk4
    >>> from pinmobile.loop import State, step
    >>> from pinmobile.plant import Context
    >>> robot, zero = MobileRobot(30.0, 1.3), np.zeros(3)
    >>> loop = Loop(robot, PD(60, 60), integrator=rk4)
    >>> memory = loop.controller.initial_state(Context.of(robot, dt=0.1))
    >>> begin = State(zero, zero, None, memory)
    >>> desired = Reference(np.array([1.0, 0.0, 0.0]), zero, zero)
    >>> after, *_ = step(loop, 0.0, 0.0, 0.1, begin, desired)
    >>> float(after.v[0])  # 60 N / 30 kg * 0.1 s [m/s]
    0.2
    """
    plant = loop.dynamics
    q, v, memory, law_memory, record_state = state
    if loop.is_constrained and not loop.projects_after:
        # Here, not after the step: this sample's dynamics need the same mass matrix, which a tape has once.
        v = np.where(k == 0.0, v, plant.project(q, v))  # the initial velocity stays as given
    error, error_rate = tracking_errors(plant, q, v, reference) if loop.records_errors else (None, None)
    u, law_memory = control(loop, t, q, v, reference, law_memory)
    a, q1, v1, next_memory = advance(loop, t, h, q, v, u, memory)
    v1 = plant.project(q1, v1) if loop.projects_after else v1
    signals: Mapping[str, SignalSample] = NO_SIGNALS
    if loop.signals:
        law_signals = signals_of(loop.controller, law_memory)
        signals = collect_signals(part_signals(loop, t, q, v, u, memory, law_signals), _signal)
    measured: Any = ()
    if loop.is_measured:
        measured = evaluate_metrics_of(plant, t, q, v, a, u, reference)
    sample = Sample(k, t, q, v, u, a, error, error_rate, signals, measured, reference)
    record = NOTHING if loop.recorder is None else loop.recorder(sample, record_state)
    return State(q1, v1, next_memory, law_memory, record.state), sample, record


def control(loop: Loop, t: Any, q: Any, v: Any, reference: Reference, memory: Any) -> tuple[Any, Any]:
    """Return the applied input of a sample and the memory of the controller after it."""
    u, memory = evaluate(loop.controller, t, q.copy(), v.copy(), reference, memory)
    if type(u) is not np.ndarray or u.dtype != np.float64 or u.shape != (loop.dynamics.nu,):
        u = _check_numbers("controller", u, t, (loop.dynamics.nu,), advice(loop.plant))
    if loop.limits is not None:
        u = np.clip(u, *loop.limits)
    if loop.is_informed:
        memory = loop.controller.applied(u.copy(), memory)
    return u, memory


def _check_numbers(name: str, value: Any, t: Any, shape: tuple[int, ...], hint: str = "") -> Any:
    """Return the result of a part as an array of real numbers of this shape."""
    array = np.asarray(value)
    if np.shape(array) != shape or not are_real(array):
        expected = f"an array of shape {shape}{'' if are_real(array) else ' of real numbers'}"
        raise InvalidArgument(f"{name} returned {format_value(value)}{stamp(t)}, expected {expected}{hint}")
    return array


def part_signals(
    loop: Loop, t: Any, q: Any, v: Any, u: Any, memory: object, law_signals: Any = None
) -> Iterator[tuple[str, Any]]:
    """Yield the path and the signals of each part at a sample; `law_signals` are those of the controller."""
    plant = loop.dynamics
    if able(plant, Signalling):
        f = _total_force(loop, t, q, v, u) + np.zeros(plant.nv)
        yield "plant", plant.signals(t, q.copy(), v.copy(), u.copy(), f, memory)
    if law_signals is not None:
        yield "controller", law_signals
    for name, force in loop.named_forces.items():
        if able(force, OnCoordinates):
            yield name, signals_of(force, t, q.copy(), v.copy())
        elif able(force, Signalling):
            yield name, force.signals(t, plant.pose(q), plant.pose_rate(q, v))


def _signal(name: str, value: Any) -> Any:
    return entries(value) if has_symbols(value) else signal_number(name, value)


def tracking_errors(plant: Any, q: Any, v: Any, reference: Reference) -> tuple[Any, Any]:
    """Return the errors of the reference's coordinates and of their rates, shape (n,) each."""
    n = reference.v.shape[-1]
    desired = full_configurations(q, reference.q)  # coordinates without a reference have no error
    return plant.difference(q, desired)[..., :n], reference.v - v[..., :n]


def _applied_force(loop: Loop, t: Any, q: Any, v: Any) -> Any:
    """Return the external forces on the coordinates, shape (nv,), or 0."""
    plant, total = loop.dynamics, 0.0
    if loop.wrenches:
        pose, rate = plant.pose(q), plant.pose_rate(q, v)
        wrench: Any = 0.0
        for name, force in loop.wrenches:
            wrench = wrench + _check_numbers(name, force(t, pose.copy(), rate.copy()), t, np.shape(pose))
        if type(wrench) is np.ndarray and not isfinite(wrench.sum()):
            return np.full(plant.nv, np.nan)  # the run reports NaN, with all samples before
        total = plant.generalized_force(q, wrench)
        if total is None:
            kind = type(loop.plant).__name__
            raise InvalidArgument(f"plant is a {kind}, whose body accepts no wrench, but forces act on it")
    for name, force in loop.efforts:
        effort = force.on_coordinates(t, q.copy(), v.copy())
        total = total + _check_numbers(f"{name}.on_coordinates", effort, t, np.shape(v))
    return total


def _total_force(loop: Loop, t: Any, q: Any, v: Any, u: Any) -> Any:
    """Return the external forces, with the reaction of carried inertia, shape (nv,), or 0."""
    plant, applied = loop.dynamics, _applied_force(loop, t, q, v)
    if not loop.carries:
        return applied
    forces = loop.all_forces
    return applied + reaction(plant, forces, t, q, lambda f: plant.forward_dynamics(q, v, u, applied + f))


def reaction(plant: Any, forces: Iterable[Any], t: Any, q: Any, accelerate: Callable[[Any], Any]) -> Any:
    """Return the reaction of carried inertia as a force on the coordinates.

    Forces may add a mass matrix M to the body. The wrench w = -M a then acts on the body, where a is the
    acceleration of the body. The acceleration is linear in w, ``a = a_0 + W w``, so that ``(1 + M W) w = -M
    a_0``.

    Parameters
    ----------
    plant : plant
        Plant whose first coordinates are x, y and psi of the body.
    forces : iterable of forces
        Forces. Those with ``inertia(t, pose)`` add that mass matrix, shape (..., 3, 3).
    t : float
        Time [s].
    q : ndarray, shape (..., nq)
        Configuration.
    accelerate : callable
        Function that returns the acceleration, shape (..., nv), under an additional force on the coordinates.

    Returns
    -------
    ndarray, shape (..., nv), or float
        Reaction; 0.0 if no force adds inertia.
    """
    loads = [force for force in forces if able(force, Carried)]
    if not loads:
        return 0.0
    M = sum(force.inertia(t, plant.pose(q)) for force in loads)
    axes = [plant.generalized_force(q, axis + 0.0 * q[..., :3]) for axis in np.eye(3)]
    free = accelerate(0.0)[..., :3]
    W = np.stack([accelerate(axis)[..., :3] - free for axis in axes], axis=-1)
    w = -np.linalg.solve(np.eye(3) + M @ W, M @ free[..., None])[..., 0]
    return sum(w[..., k : k + 1] * axis for k, axis in enumerate(axes))


def advance(loop: Loop, t: Any, h: Any, q: Any, v: Any, u: Any, memory: object) -> Any:
    """Return the acceleration, the state after the substeps of a sample, and the plant's memory."""
    return (_plant_steps if loop.steps else _integrator_steps)(loop, t, h, q, v, u, memory)


def _integrator_steps(loop: Loop, t: Any, h: Any, q: Any, v: Any, u: Any, memory: object) -> Any:
    """Return the acceleration and the state after the substeps, which the integrator computes."""
    plant, integrate, first = loop.dynamics, loop.integrate, None
    for j in range(loop.substeps):
        time = t + j * h if j else t
        if j and loop.is_constrained:
            v = plant.project(q, v)
        a, begin = _acceleration(loop, time, q, v, u), q
        first = a if first is None else first

        def acceleration(time: Any, displacement: Any, rate: Any) -> Any:
            return _acceleration(loop, time, integrate(begin, displacement), rate, u)  # noqa: B023

        dq, v = loop.displaced(acceleration, a, time, v, h)
        q = integrate(begin, dq)
    return first, q, v, memory


def _acceleration(loop: Loop, t: Any, q: Any, v: Any, u: Any) -> Any:
    """Return the acceleration of the plant, shape (nv,)."""
    plant = loop.dynamics
    if loop.forces:
        a = plant.forward_dynamics(q, v, u, _total_force(loop, t, q, v, u))
    else:
        a = plant.forward_dynamics(q, v, u)
    if type(a) is np.ndarray and a.shape == v.shape and a.dtype == np.float64:
        return a
    return _check_numbers("plant.forward_dynamics", a, t, np.shape(v))


def _plant_steps(loop: Loop, t: Any, h: Any, q: Any, v: Any, u: Any, memory: object) -> Any:
    """Return the mean acceleration of the first substep, and the state after all of the plant's own steps."""
    acceleration = None
    for j in range(loop.substeps):
        time = t + j * h if j else t
        end = loop.dynamics.step(time, q, v, u, h, partial(_applied_force, loop), memory)
        if not all(hasattr(end, name) for name in ("q", "v", "memory")):
            message = f"plant.step returned {format_value(end)}{stamp(t)}"
            raise InvalidArgument(f"{message}, expected a Step(q, v, memory)")
        q1 = _check_numbers("q of plant.step", end.q, t, np.shape(q))
        v1 = _check_numbers("v of plant.step", end.v, t, np.shape(v))
        if acceleration is None:
            a = stated(end, "a")
            acceleration = (v1 - v) / h if a is None else a
        q, v, memory = q1, v1, end.memory
    return acceleration, q, v, memory


def displace(integrator: Any, acceleration: Any, first: Any, t: Any, v: Any, h: Any) -> Any:
    """Return the displacement and the velocity after a step of any integrator, which receives copies."""
    zero, v_copy = np.zeros(np.shape(v)), v.copy()

    def call(time: Any, displacement: Any, rate: Any) -> Any:
        is_start = displacement is zero and rate is v_copy and time is t and type(v) is np.ndarray
        if is_start and not zero.any() and (v_copy == v).all():  # unless the integrator changed them
            return first
        return acceleration(time, displacement, rate)

    answer = integrator(call, t, zero, v_copy, h)
    is_wrong = type(answer) is not tuple or len(answer) != 2
    if is_wrong or any(np.shape(x) != np.shape(v) or not are_real(x) for x in answer):
        expected = f"(q, v) of shapes {np.shape(v)} and {np.shape(v)}, of real numbers"
        raise InvalidArgument(f"integrator returned {format_value(answer)}{stamp(t)}, expected {expected}")
    return answer


def initial_state(loop: Loop, context: Context, q: Any = None, v: Any = None) -> State:
    """Return the state before the first sample, with the memory of the parts."""
    begin, recorder = stated(loop.dynamics, "initial_state"), loop.recorder
    plant = None if begin is None else begin(context)
    controller = loop.controller.initial_state(context)
    record = None if recorder is None else recorder.initial_state(context.size, loop.plant.nu)
    return State(q, v, plant, controller, record)


LARGEST = 1e9
"""Largest sum of the sizes of inputs and accelerations, per limit, of a loop that has not diverged."""


def is_near(errors: Any, limit: Any) -> Any:
    """Return whether no error exceeds the limit, shape (...); NaN exceeds it.

    Parameters
    ----------
    errors : ndarray, shape (..., n)
        Errors of coordinates and of their rates [m, rad, m/s, rad/s].
    limit : float
        Largest size.
    """
    return np.all(np.abs(errors) <= limit, axis=-1)


def is_alive(errors: Any, limit: Any, u: Any, a: Any) -> Any:
    """Return whether samples have not diverged, shape (...): the rule of all engines.

    A loop has diverged if an error or its rate exceeds the limit, or if the sum of the sizes of inputs and
    accelerations exceeds `LARGEST` limits or is not a number.

    Parameters
    ----------
    errors, limit
        See `is_near`.
    u, a : ndarray, shape (..., nu), (..., nv)
        Input and acceleration.
    """
    return is_near(errors, limit) & is_small(u, a, limit)


def is_small(u: Any, a: Any, limit: Any) -> Any:
    """Return whether inputs and accelerations are those of a loop that has not diverged, shape (...)."""
    return np.sum(np.abs(u), axis=-1) + np.sum(np.abs(a), axis=-1) < LARGEST * limit


class UntraceableMetric(NotTraceable):
    """Error of a metric whose function does not accept symbols.

    Parameters
    ----------
    name : str
        Name of the metric.
    error : Exception
        Error of its function.
    """

    def __init__(self, name: str, error: Exception) -> None:
        reason, remedy = f"it raises {type(error).__name__} ({error})", "write it in NumPy for one sample"
        if isinstance(error, NotTraceable):
            reason, remedy = error.obstacle, error.remedy
        super().__init__(f"metrics has {name!r}: {reason}", remedy, place_of(error.__traceback__))


@final
@part
class Worst:
    """Recorder of each robot's largest and mean square error and largest input until the robot diverges.

    Parameters
    ----------
    limit : float
        Largest error of a loop that has not diverged [m, rad, m/s, rad/s].
    begin : float or None
        Index of the first sample whose error is recorded; None: all samples, which is faster than 0.
    distances : tuple of tuple of int
        Groups of coordinates whose errors form a distance. The recorder keeps the largest distance and counts
        the sizes.
    metrics : tuple of (int or Metric, bool)
        Each recorded metric (of the plant: its index), and whether it is a margin, whose smallest value is
        the worst; see `pinmobile.metrics.Metric`.
    keep : tuple of str
        Names of the signals that are kept of every sample.

    See Also
    --------
    loop.Samples : recorder of all samples.
    ensemble : run many robots with this recorder.

    Examples
    --------
    >>> from pinmobile.loop import Worst
    >>> memory = Worst(limit=10.0).initial_state(n=3, nu=3)
    >>> memory["largest"]  # [m, m, rad]
    array([0., 0., 0.])
    """

    limit: float = number(default=np.inf, above=0, doc="largest error")
    begin: Any = number(default=None, doc="first sample with a recorded error")
    distances: tuple[tuple[int, ...], ...] = option(default=((0, 1), (2,)))
    metrics: tuple[tuple[int | Metric, bool], ...] = option(default=())
    keep: tuple[str, ...] = option(default=())

    @property
    def signals(self) -> bool:
        """Whether the recorder reads signals."""
        return bool(self.keep) or any(isinstance(metric, Metric) for metric, _ in self.metrics)

    def initial_state(self, n: int, nu: int) -> dict[str, Array]:
        """Return the record before the first sample.

        Parameters
        ----------
        n, nu : int
            Number of errors and of inputs.

        Returns
        -------
        dict of str to ndarray
            Record of no sample.
        """
        farthest = sum(len(group) > 1 for group in self.distances)
        return {
            "alive": np.ones(()),
            "lived": np.zeros(()),
            "largest": np.zeros(n),
            "farthest": np.zeros(farthest),  # squared
            "squares": np.zeros(n),
            "inputs": np.zeros(nu),
            **self._initial_metrics(),
        }

    def _initial_metrics(self) -> dict[str, Array]:
        if not self.metrics:
            return {}
        worst = np.array([-np.inf if is_margin else 0.0 for _, is_margin in self.metrics])
        return {"worst": worst, "metric_squares": np.zeros(len(worst))}  # margins: the largest -m

    def __call__(self, sample: Sample, state: Mapping[str, Any]) -> Record:
        """Return the record with one more sample.

        Parameters
        ----------
        sample : Sample
            Sample of the loop.
        state : dict of str to ndarray
            Record of the previous samples.

        Returns
        -------
        Record
            Record of all samples so far.
        """
        errors = np.concatenate([sample.error, sample.error_rate], axis=-1)
        alive = (state["alive"] > 0.5) & is_alive(errors, self.limit, sample.u, sample.a)
        one = np.where(alive, 1.0, 0.0)
        error = np.where(alive[..., None], np.abs(sample.error), 0.0)
        factor = 1.0 if self.begin is None else np.where(sample.k == self.begin, 0.0, 1.0)
        squares = error * error
        groups = [sum(squares[..., i] for i in group) for group in self.distances]
        distances = [square for square, group in zip(groups, self.distances, strict=True) if len(group) > 1]
        farthest = state["farthest"]
        record = {
            "alive": one,
            "lived": state["lived"] + one,
            "largest": _larger(error, state["largest"] * factor),
            "farthest": _larger(np.stack(distances, axis=-1), farthest * factor) if distances else farthest,
            "squares": state["squares"] * factor + squares,
            "inputs": _larger(np.where(alive[..., None], np.abs(sample.u), 0.0), state["inputs"]),
        }
        sizes = []
        for square, group in zip(groups, self.distances, strict=True):
            size = np.where(alive, square if len(group) > 1 else error[..., group[0]], np.inf)
            sizes.append(np.sqrt(size) if len(group) > 1 else size)
        if self.metrics:
            metrics, metric_sizes = self._metric_record(sample, state, alive)
            record, sizes = record | metrics, sizes + metric_sizes
        signals = {name: sample.signals[one_of("signal", name, sample.signals)] for name in self.keep}
        series = {f"signal {name}": signal.value for name, signal in signals.items()}
        return Record(record, sizes, series, {name: signal.unit for name, signal in signals.items()})

    def _metric_record(
        self, sample: Sample, state: Mapping[str, Any], alive: Any
    ) -> tuple[dict[str, Any], list[Any]]:
        """Return the record of the plant's metrics, and their sizes."""
        columns = [
            (_value(m, sample) if isinstance(m, Metric) else sample.measured[..., m], is_margin)
            for m, is_margin in self.metrics
        ]
        badness = [-x if is_margin else np.abs(x) for x, is_margin in columns]
        last = {name: state[name] for name in ("worst", "metric_squares")}
        if self.begin is not None:  # reset infinite values of earlier samples, too
            first = self._initial_metrics()
            last = {name: np.where(sample.k == self.begin, first[name], x) for name, x in last.items()}
        is_alive_row = alive[..., None]
        worst = np.where(is_alive_row, np.stack(badness, axis=-1), self._initial_metrics()["worst"])
        squares = np.where(is_alive_row, np.stack([x * x for x, _ in columns], axis=-1), 0.0)
        worst, squares = _larger(worst, last["worst"]), last["metric_squares"] + squares
        sizes = [
            np.where(alive, size_of(x) if is_margin else y, 0.0 if is_margin else np.inf)
            for (x, is_margin), y in zip(columns, badness, strict=True)
        ]
        return {"worst": worst, "metric_squares": squares}, sizes


def _value(metric: Metric, sample: Sample) -> Any:
    """Return the number that the function of a metric returns for a sample."""
    try:
        value = metric.function(sample)  # type: ignore[misc]
    except Exception as error:
        if not has_symbols(sample.q):
            place = f"for the sample at t = {sample.t:g} s"
            error.add_note(f"in the function of the metric {metric.name!r}, {place}")
            raise
        raise UntraceableMetric(metric.name, error) from error
    if np.shape(value) != () or not are_real(np.asarray(value)):
        message = f"metrics has {metric.name!r}, whose function returned {format_value(value)}"
        raise InvalidArgument(f"{message}, expected a number")
    return 1.0 * np.asarray(value) if isinstance(value, bool | np.bool_) else value


def _larger(a: Any, b: Any) -> Any:
    """Return the larger of two numbers, neither of which is NaN."""
    return np.where(a > b, a, b)


@final
@part
class Samples:
    """Recorder of all samples: configuration, velocity, input, acceleration and signals.

    Parameters
    ----------
    errors : bool
        Whether errors are recorded too.
    metrics : tuple of (int, bool)
        Metrics of the plant that are recorded too, as in `Worst`.

    See Also
    --------
    loop.Worst : recorder of the largest errors.
    Rollout : recorded samples of a simulation.

    Examples
    --------
    >>> from pinmobile.loop import Samples
    >>> Samples().signals, Samples().errors
    (True, False)
    """

    errors: bool = option(default=False)
    metrics: tuple[tuple[int, bool], ...] = option(default=())
    signals: ClassVar[bool] = True

    def initial_state(self, n: int, nu: int) -> None:
        """Return None: the recorder has no memory.

        Parameters
        ----------
        n, nu : int
            Number of errors and of inputs.
        """

    def __call__(self, sample: Sample, state: object) -> Record:
        """Return the sample as a record.

        Parameters
        ----------
        sample : Sample
            Sample of the loop.
        state : None
            Memory.

        Returns
        -------
        Record
            Values to keep.
        """
        arrays = {"q": sample.q, "v": sample.v, "u": sample.u, "a": sample.a}
        arrays |= {f"signal {name}": signal.value for name, signal in sample.signals.items()}
        arrays |= {"error": sample.error} if self.errors else {}
        arrays |= {"measured": sample.measured} if self.metrics else {}
        return Record(state, (), arrays, {name: signal.unit for name, signal in sample.signals.items()})
