"""`simulate` runs a controller in a loop with a plant; `Engine` lists the engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from enum import Enum
from typing import Any
from warnings import warn

import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    check_integer,
    finite,
    instance,
    one_of,
    positive,
    sequence,
    shaped,
)
from pinmobile.controllers import Controller
from pinmobile.errors import (
    Diverged,
    InvalidArgument,
    LimitWarning,
    NotTraceable,
    SlowerEngine,
    argument_errors,
)
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop._checks import ResultCache, check_answers, check_run, sample_reference
from pinmobile.loop._engines import CompiledRun, PythonRun, Run, compile_plant
from pinmobile.loop._loop import LARGEST, Loop, is_near, is_small
from pinmobile.loop._rollout import Rollout, events_of, is_fault, kinds_of
from pinmobile.parts import OnCoordinates, Starting, able
from pinmobile.plant import Context, Plant, all_samples, coordinates_of, full_configurations, stated
from pinmobile.signals import Signal, collect_time_signals
from pinmobile.trajectories import Reference, Trajectory


class Engine(Enum):
    """Engine that runs a closed loop.

    `Engine.PYTHON` runs any parts in Python, one robot at a time. A `MobileRobot` uses the dynamics of
    Pinocchio. `Engine.COMPILED` traces the laws with symbols and runs machine code; the parts must be written
    in NumPy. `simulate`, `ensemble` and `sweep` select an engine if no engine is given.

    See Also
    --------
    simulate : run one robot.
    Rollout.fallback_reason : reason why a faster engine cannot run the loop.
    vectorize : compile a function for many robots.

    Examples
    --------
    >>> from pinmobile import PD, Circle, Engine, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> parts = robot, PD(120, 120), Tangent(Circle(1.0, 0.5, 4.0))
    >>> run = simulate(*parts, dt=0.02, engine=Engine.PYTHON)
    >>> run.engine
    'PYTHON'
    """

    PYTHON = "one robot at a time, in Python, with Pinocchio's dynamics of a MobileRobot: any parts"
    COMPILED = "machine code traced from laws: parts written in NumPy"

    def __repr__(self) -> str:
        return self.name

    __str__ = __repr__


def check_engine(engine: object) -> Engine | None:
    """Return an engine or None.

    Raises
    ------
    InvalidArgument
        If the argument is anything else.
    """
    typed: Engine | None = instance("engine", engine, Engine | None, "Engine.PYTHON, Engine.COMPILED or None")
    return typed


def engine_errors(selected: Engine | None) -> AbstractContextManager[None]:
    """Return a context in which a loop that does not compile is an error if the user selects it."""
    message = "engine is Engine.COMPILED, which cannot run this: "
    return argument_errors(message, of=NotTraceable) if selected is Engine.COMPILED else nullcontext()


_CHUNK = 512  # samples between two checks for divergence
_NOT_SELECTED = "not COMPILED: give engine=Engine.COMPILED to compile the loop"


def simulate(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    dt: float,
    duration: float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Force | OnCoordinates] | Mapping[str, Force | OnCoordinates] = (),
    limit: float = 1e3,
    stop_at: Sequence[str] = (),
    engine: Engine | None = None,
    seed: int = 0,
    member: int = 0,
) -> Rollout:
    """Run a closed loop from 0 to `duration` and record every sample.

    The loop calls the controller at t = 0, dt, 2 dt, ... A zero-order hold keeps the input constant between
    samples, as in a digital controller, within the limits of the plant's `inputs`. The integrator divides
    each dt into `substeps`. The rollout contains input and acceleration of the last sample too. External
    forces act in continuous time: each stage of the integrator evaluates them at its own time and state. They
    are part of the recorded acceleration, not of the recorded input. A plant with its own step method uses
    that method instead of an integrator; its recorded acceleration is the mean over the first substep.

    Parameters
    ----------
    plant : MobileRobot or other plant
        Simulated system, see `pinmobile.plant.Plant`.
    controller : controller
        Controller, see `pinmobile.controllers`; `law` makes one from a function.
    trajectory : trajectory
        Source of the reference: ``trajectory(t)`` with `t` of shape (N + 1,) [s], and its ``duration`` [s].
        The reference contains the first n coordinates of the plant; the plant's ``reference_sizes`` lists the
        allowed n.
    dt : float
        Time step of the controller [s].
    duration : float, optional
        Duration of the run [s], a whole number of dt, at most the duration of the trajectory; default: all
        whole steps of the trajectory.
    q0, v0 : array_like, shape (nq,) and (nv,), optional
        Initial configuration and velocity; default: the start of the reference, completed by
        the plant's ``start``.
    integrator : callable, optional
        Integrator of the plant, see `pinmobile.integrators`; default: the plant's own choice, else
        `pinmobile.integrators.constant_acceleration`.
    substeps : int
        Integrator steps per dt.
    forces : sequence of callable, or mapping of str to callable
        External forces, see `pinmobile.forces`. ``force(t, pose, rate)`` receives pose and rate of the body,
        shape (3,) each, and returns the wrench (Fx, Fy, Mz) [N, N, N m]. A force with ``on_coordinates(t, q,
        v)`` returns a generalized force, shape (nv,).
    limit : float
        Largest error of a coordinate or velocity [m, rad, m/s, rad/s]. The loop has diverged if an error
        exceeds this limit, or the sum of the sizes of inputs and accelerations 1e9 times its number.
    stop_at : sequence of str
        Kinds of events at which the rollout ends, such as ``["tip over", "slip"]``, see `plant.Event`.
    engine : Engine, optional
        `Engine.PYTHON` or `Engine.COMPILED`; default: the plant's choice. A `MobileRobot` runs in Python with
        Pinocchio's dynamics. A robot on wheels runs compiled, unless its controller cannot be compiled.
        `Rollout.fallback_reason` gives the reason.
    seed : int
        Seed of the controllers' noise, as in `ensemble`.
    member : int
        Index of the robot in an ensemble; it selects the robot's noise.

    Returns
    -------
    Rollout
        All samples of the run.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, a part returns anything but real numbers of the expected shape, or
        `Engine.COMPILED` is given and cannot run the loop.
    Diverged
        If a number is not finite or an error exceeds `limit`. The error contains all samples before.

    Warns
    -----
    SlowerEngine
        If a part prevents compilation of a loop that should be compiled.
    LimitWarning
        Once, if the run exceeds limits of the robot or a robot on wheels tips over, see `Rollout.events`.

    See Also
    --------
    ensemble : run many robots with different parameters.
    Rollout : recorded samples.
    Engine : engines of a loop.

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law = ComputedTorque(robot, kp=4, kd=4)
    >>> path = Tangent(Circle(radius=1.0, rate=0.5, duration=4.0))
    >>> run = simulate(robot, law, path, dt=0.01)
    >>> run.max_error()[:2]  # [m]
    array([0.00012, 0.00015])
    """
    dt, limit = positive("dt", dt, "s"), positive("limit", limit)
    options: Any = {"forces": forces, "integrator": integrator, "substeps": substeps}
    full_loop, t = check_run(plant, controller, trajectory, **options, dt=dt, duration=duration)
    selected, event_kinds = check_engine(engine), kinds_of(plant)
    kinds = sequence("stop_at", stop_at, 'kinds of events, such as ["tip over"]')
    stops = [one_of("event", kind, event_kinds) for kind in kinds]
    compiles = selected is Engine.COMPILED or (selected is None and stated(plant, "compiles"))
    reference = sample_reference(trajectory, t, plant)
    start = start_of(plant, reference, q0, v0)
    context = Context.of(plant, dt=dt, t=t, reference=reference, trajectory=trajectory)
    context = replace(
        context, seed=check_integer("seed", seed, least=0), member=check_integer("member", member, least=0)
    )
    check_answers(full_loop, context, *start)
    loop, cause = _make_run(full_loop, context, start, selected, compiles=compiles)
    info = {"engine": "COMPILED" if isinstance(loop, CompiledRun) else "PYTHON", "fallback_reason": cause}
    if cause.startswith("not") and compiles:
        warn(f"this loop runs by PYTHON: {cause}", SlowerEngine, stacklevel=2)
    chunk = len(t) if isinstance(loop, CompiledRun) else _CHUNK

    def make_rollout(end: int) -> Rollout:
        return rollout_of(full_loop, t, loop.kept, reference, end, loop.units, **info)

    for begin in range(0, len(t), chunk):
        end = min(begin + chunk, len(t))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the check below reports it
            loop.fill(begin, end)
        if loop.is_valid(begin, end, limit):
            continue
        index, cause = _first_invalid(plant, loop, reference, begin, end, limit)
        if index is not None:
            rollout = make_rollout(index) if index else None
            if end := _end_of(rollout, stops):
                return make_rollout(end)
            q, v, _, _ = loop.samples(index, index + 1)
            message = f"the loop diverged at t = {t[index]:g} s (sample {index} of {len(t) - 1}): {cause}"
            message += _stiffness_advice(full_loop, start[0], dt)
            message += "".join(f"; {event}" for event in _faults(rollout))
            raise Diverged(message, time=float(t[index]), q=q[0], v=v[0], rollout=rollout) from loop.failure
    run = make_rollout(len(t))
    run = make_rollout(end) if (end := _end_of(run, stops)) else run
    if faults := _faults(run):
        warn("; ".join(faults), LimitWarning, stacklevel=2)
    return run


def _faults(run: Rollout | None) -> list[str]:
    """Return the events that a run does not simulate, as text."""
    return [str(event) for event in events_of(run, with_metrics=False) if is_fault(event)] if run else []


def _end_of(run: Rollout | None, kinds: Sequence[str]) -> int:
    """Return the number of samples up to the first event of some kinds; 0 if there is none."""
    times = [event.t for event in (run.events if run and kinds else ()) if event.kind in kinds]
    return int(np.searchsorted(run.t, min(times))) + 1 if run and times else 0


def _make_run(
    loop: Loop, context: Context, start: tuple[Array, Array], selected: Engine | None, *, compiles: bool
) -> tuple[Run, str]:
    """Return the run of a loop by an engine, and the reason why the engine is not `Engine.COMPILED`."""
    if not compiles:
        return PythonRun(loop, context, *start), _NOT_SELECTED if selected is None else ""
    try:
        with engine_errors(selected):
            return CompiledRun(loop, context, *start), ""
    except NotTraceable as error:
        reason = error.reason
    try:
        compiled = compile_plant(loop, context, *start)
    except NotTraceable:
        return PythonRun(loop, context, *start), f"not COMPILED: {reason}"
    reason = f"plant and forces are compiled, the controller runs in Python; not COMPILED: {reason}"
    return PythonRun(compiled, context, *start), reason


def start_of(
    plant: Plant, reference: Reference, q0: ArrayLike | None, v0: ArrayLike | None
) -> tuple[Array, Array]:
    """Return the initial state: the given state, or the start of the reference as the plant completes it."""
    first = Reference(*(part[0] for part in reference))
    key, is_default = tuple(part.tobytes() for part in first), q0 is None and v0 is None
    entry = _initial_states.get(plant, key) if is_default else None
    if entry is not None:
        return entry[0].copy(), entry[1].copy()
    starter = able(plant, Starting)
    if starter is not None:
        default_start = starter.start(first)
    elif first.v.size == plant.nv:
        default_start = first.q, first.v
    elif q0 is None or v0 is None:
        raise InvalidArgument(
            f"reference has the first {first.v.size} of {plant.nv} coordinates, and the plant, a "
            f"{type(plant).__name__}, has no start(reference), which completes them: give q0 and v0"
        )
    else:
        default_start = np.zeros(plant.nq), np.zeros(plant.nv)

    def check_size(name: str, value: Any, default: Array, size: int) -> Array:
        array = finite(f"{name} of plant.start", default) if value is None else finite(name, value)
        return shaped(name, array, (size,))

    q = check_size("q0", q0, default_start[0], plant.nq)
    v = check_size("v0", v0, default_start[1], plant.nv)
    check = stated(plant, "check_start")
    if check is not None:
        try:
            check(q.copy(), v.copy())
        except InvalidArgument as error:
            is_default = error.argument == "start" and q0 is None and v0 is None
            raise error.calling("reference at its start") if is_default else error from None
    if is_default:
        _initial_states.keep(plant, key, (q.copy(), v.copy()))
    return q, v


_initial_states = ResultCache()
"""Initial states by plant and by the bytes of the first reference."""


def errors_of(plant: Plant, q: Array, reference: Reference) -> Array:
    """Return the tracking errors of samples in the n coordinates of the reference, shape (N, n)."""
    desired = full_configurations(q, reference.q)
    return all_samples(plant, "difference", q, desired)[:, : reference.v.shape[1]]


def _first_invalid(
    plant: Plant, loop: Run, reference: Reference, begin: int, end: int, limit: float
) -> tuple[int | None, str]:
    """Return the first sample that is not acceptable and the reason, or None and ""."""
    samples = loop.samples(begin, end)
    with np.errstate(all="ignore"):
        small = is_small(*samples[2:], limit)
    is_finite = np.all([small, *(np.isfinite(part).all(axis=1) for part in samples)], axis=0)
    count = int(np.argmin(is_finite)) if not is_finite.all() else end - begin
    if count:
        q, v = (part[:count] for part in samples[:2])
        window = Reference(*(part[begin : begin + count] for part in reference))
        n = window.v.shape[1]
        errors = np.hstack([errors_of(plant, q, window), window.v - v[:, :n]])
        is_close = is_near(errors[..., None], limit)  # each error separately
        if not is_close.all():
            k, column = map(int, np.argwhere(~is_close)[0])
            name = coordinates_of(plant)[column % n].name
            message = f"the error in {'the rate of ' if column >= n else ''}{name}"
            return begin + k, f"{message} is {errors[k, column]:.4g}, beyond the limit {limit:g}"
    if count < end - begin:
        parts = ("q", "v", "a", "u")
        names = [n for n, part in zip(parts, samples, strict=True) if not np.isfinite(part[count]).all()]
        huge = f"a or u beyond {LARGEST * limit:g}, is a gain too high for this dt?"
        return begin + count, f"{', '.join(names)} not finite" if names else huge
    return None, ""


def _stiffness_advice(loop: Loop, q: Array, dt: float) -> str:
    """Return advice if friction requires a smaller step of the integrator, else "".

    With the damping matrix C of all coordinates, explicit steps are stable up to about 2 / max eig(M^-1 C).
    """
    plant, h = loop.plant, dt / loop.substeps
    if stated(plant, "mass_matrix") is None:
        return ""
    C = np.zeros((plant.nv, plant.nv))
    for force in [x for x in loop.all_forces if stated(x, "damping") is not None]:
        if able(force, OnCoordinates):
            C += np.diag(np.broadcast_to(force.damping, plant.nv))
            continue
        psi = plant.pose(q)[2]
        cos, sin = np.cos(psi), np.sin(psi)
        axes = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])  # axes of the body
        J = np.stack([plant.generalized_force(q, axis) for axis in axes])
        C += J.T @ np.diag(force.damping) @ J
    rates = np.linalg.eigvals(np.linalg.solve(plant.mass_matrix(q), C)) if C.any() else np.zeros(1)
    longest = 2 / max(float(np.abs(rates).max()), 1e-300)
    advice = f"; the friction in `forces` needs steps of the integrator of at most {longest:.2g} s"
    return "" if h <= longest else f"{advice}, and they are {h:.2g} s: give a smaller dt, or more substeps"


def rollout_of(
    loop: Loop,
    t: Array,
    arrays: Mapping[str, Array],
    reference: Reference,
    end: int,
    units: Mapping[str, str],
    **texts: str,
) -> Rollout:
    """Return the samples before `end` from arrays by name; `units` contains those of the signals."""
    desired = Reference(*(part[:end] for part in reference))
    q, v, a, u = (arrays[name][:end] for name in "qvau")
    signals = collect_time_signals(t[:end], loop.controller, loop.trajectory)
    signals |= {name: Signal(unit, arrays[f"signal {name}"][:end]) for name, unit in units.items()}
    error = errors_of(loop.plant, q, desired)
    return Rollout(loop.plant, t[:end], q, v, a, u, error, desired, signals, **texts)
