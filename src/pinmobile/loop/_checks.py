"""Checks of `simulate` before it starts, and the times and references of its samples."""

from __future__ import annotations

import contextlib
import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias
from warnings import warn

import numpy as np

from pinmobile.arrays import (
    Array,
    absent,
    affordable,
    callable_as,
    check_integer,
    check_repeat,
    check_returned_array,
    frozen,
    positive,
    sequence,
    shaped,
    vector,
)
from pinmobile.compiled import is_constant
from pinmobile.controllers import check_controller, check_memory
from pinmobile.errors import InvalidArgument, argument_errors, format_value
from pinmobile.integrators import Integrator, check_integrator, constant_acceleration
from pinmobile.loop._engines import size_error
from pinmobile.loop._loop import Loop, displace, named_forces
from pinmobile.parts import Carried, Following, OnCoordinates, Pushable, Stepping, able, require
from pinmobile.plant import (
    Context,
    Plant,
    check_plant,
    coordinates_of,
    reference_sizes_of,
    refuse_path,
    stated,
)
from pinmobile.trajectories import Reference, Trajectory, check_limits

_Law: TypeAlias = Callable[[Array, Array], object]

_STEP_ERROR = 1e-9  # relative rounding allowed in duration / dt
_COORDINATES = 3  # assumed number before the plant is checked
_MAX_SAMPLES = 1e8  # samples
_ADVICE = "give a larger dt or a shorter duration"
_MAX_STEPS = 1e11  # steps of the integrator, which take days
_RTOL = 1e-9  # tolerance of two results for the same arguments
_RECORD_SIZE = 16  # numbers per coordinate of a sample in the loop, the reference and the rollout


def check_run(
    plant: Any,
    controller: Any,
    trajectory: Any,
    *,
    forces: Any,
    integrator: Integrator | None,
    substeps: int,
    dt: float,
    duration: float | None,
) -> tuple[Loop, Array]:
    """Return a loop, and the times of its samples, shape (N + 1,) [s]; see `simulate` for the arguments.

    Raises
    ------
    InvalidArgument
        If an argument is invalid.
    """
    integrator = select_integrator(plant, integrator)
    check_controller(controller)
    refuse_path("trajectory", trajectory)
    require("trajectory", trajectory, Following)
    check_plant(plant)
    if integrator is not None:
        check_integrator(integrator)
    t, all_forces = sample_times(dt, duration, trajectory.duration), check_forces(forces, plant)
    return Loop(plant, controller, trajectory, all_forces, integrator, check_substeps(substeps, len(t))), t


def select_integrator(plant: Plant, integrator: Integrator | None) -> Integrator | None:
    """Return the given integrator or the plant's own choice; None for a plant with its own step method.

    Raises
    ------
    InvalidArgument
        If an integrator is given for a plant with its own step method.
    """
    stepper = None if isinstance(plant, type) else able(plant, Stepping)
    if stepper is None:
        default = stated(plant, "integrator") if integrator is None else integrator
        return constant_acceleration if default is None else default
    absent(f"because the plant, a {type(plant).__name__}, has its own step", integrator=integrator)
    return None


def check_substeps(substeps: int, samples: int) -> int:
    """Return the number of integrator steps per sample.

    Raises
    ------
    InvalidArgument
        If the number is not a whole number >= 1, or the run would take days.
    """
    return check_integer("substeps", substeps, most=int(_MAX_STEPS / samples))


def sample_times(dt: float, duration: float | None, longest: float) -> Array:
    """Return the times of the samples, shape (N + 1,) [s].

    Parameters
    ----------
    dt : float
        Time step > 0 [s].
    duration : float or None
        Time of the last sample [s]; None: all whole steps in `longest`. If the last of these is earlier than
        `longest`, a warning states its time.
    longest : float
        Duration of the trajectory [s].

    Raises
    ------
    InvalidArgument
        If the duration is not a whole number of steps, or exceeds `longest`.
    """
    longest = positive("trajectory.duration", longest, "s")
    total = longest if duration is None else positive("duration", duration, "s")
    if total > longest * (1 + _STEP_ERROR):
        raise InvalidArgument(f"duration is {total} s, expected at most the trajectory's {longest} s")
    if not total / _MAX_SAMPLES <= dt <= total * (1 + _STEP_ERROR):
        minimum = f"at least {total / _MAX_SAMPLES:g} s: {_MAX_SAMPLES:g} samples"
        raise InvalidArgument(f"dt is {dt} s, expected at most the duration, {total} s, and {minimum}")
    steps = round(total / dt)
    affordable(f"the records of {steps + 1:,} samples", _RECORD_SIZE * _COORDINATES * (steps + 1), _ADVICE)
    if abs(steps * dt - total) > _STEP_ERROR * total:
        steps_below = int(total / dt)
        if duration is None:
            reason = f"the trajectory's {total:.12g} s are not a whole number of steps dt = {dt:g} s"
            warn(f"the last sample is at t = {steps_below * dt:.12g} s: {reason}", stacklevel=4)
            return np.asarray(np.arange(steps_below + 1) * dt)
        expected = f"a whole number of steps dt = {dt} s, such as {steps_below * dt:.12g} s"
        raise InvalidArgument(f"duration is {total} s, expected {expected}")
    t = np.arange(steps + 1) * dt
    t[-1] = total
    return np.asarray(np.minimum(t, longest))


def sample_reference(trajectory: Trajectory, t: Array, plant: Plant) -> Reference:
    """Return the reference at the times `t`, shape (N + 1,) [s].

    Parameters
    ----------
    trajectory : trajectory
        Source of the reference.
    t : ndarray, shape (N + 1,)
        Times [s].
    plant : plant
        Plant that the reference must fit.

    Raises
    ------
    InvalidArgument
        If the reference does not fit the plant, or violates joint limits of the plant.
    """
    message = f"the records of {len(t):,} samples of {plant.nv} coordinates"
    affordable(message, _RECORD_SIZE * len(t) * plant.nv, _ADVICE)
    key = id(plant), t.tobytes()
    entry: tuple[Reference, Callable[[], Plant | None]] | None = _references.get(trajectory, key)
    if entry is not None and entry[1]() is plant:  # and no other with its id
        return entry[0]
    words = f"trajectory does not accept an array of {len(t)} times: "
    with argument_errors(words, of=(TypeError, ValueError)):
        reference = trajectory(t)
    reference_sizes = reference_sizes_of(plant)
    count = np.asarray(stated(reference, "v")).shape[-1:]
    n = count[0] if count and count[0] in reference_sizes else max(reference_sizes)
    sizes = {"q": reference_sizes[n], "v": n, "a": n}
    for name, size in sizes.items():
        value = np.asarray(stated(reference, name))
        smaller = ", ".join(str(k) for k in reference_sizes if k != n)
        advice = smaller and f", or the first of its coordinates: {smaller}"
        shaped(f"trajectory at {len(t)} times: {name}", value, (len(t), size), words=advice)
    samples = Reference(*(vector(f"trajectory's {x}", getattr(reference, x), k) for x, k in sizes.items()))
    if stated(plant, "velocity_limit") is not None:
        check_limits(plant, samples.q, samples.v, t)
    if len(t) * n > _CACHED_SIZE or not is_constant(trajectory):
        return samples
    samples = Reference(*map(frozen, samples))
    with contextlib.suppress(TypeError):  # a plant without weak references
        _references.keep(trajectory, key, (samples, weakref.ref(plant)))
    return samples


def check_forces(forces: Any, plant: Plant) -> Any:
    """Return the forces, which the plant must accept.

    Raises
    ------
    InvalidArgument
        If a force is not a function, or the plant lacks a capability that the forces need.
    """
    is_named, result = isinstance(forces, Mapping), forces
    result = dict(result) if is_named else sequence("forces", result, "a sequence of forces, such as [force]")
    by_name, has_wrench = named_forces(result), False
    for name, force in by_name.items():
        if able(force, OnCoordinates):
            callable_as(f"{name}.on_coordinates(t, q, v)", force.on_coordinates)
        else:
            callable_as(f"{name}(t, q, v)", force)
            has_wrench = True
    if has_wrench:
        require("plant", plant, Pushable, "forces push its body")
    _check_inertia(by_name, plant)
    if by_name and not able(plant, Stepping):
        callable_as("plant.forward_dynamics(q, v, u, f)", plant.forward_dynamics)
    return result


def _check_inertia(forces: Mapping[str, Any], plant: Plant) -> None:
    """Reject forces that add inertia if the plant does not provide the acceleration of its body."""
    name = next((name for name, force in forces.items() if able(force, Carried)), None)
    if name is None:
        return
    names = tuple(coordinate.name for coordinate in coordinates_of(plant)[:3])
    if able(plant, Stepping) or names != ("x", "y", "psi"):
        reason = "has its own step" if able(plant, Stepping) else f"begins with the coordinates {names}"
        force, kind = format_value(forces[name]), type(plant).__name__
        message = f"{name} is {force}, which adds inertia to the plant, a {kind}"
        expected = "a plant with an integrator and the first coordinates x, y and psi"
        raise InvalidArgument(f"{message}, which {reason}; expected {expected}")


def check_answers(loop: Loop, context: Context, q: Array, v: Array) -> None:
    """Check the sizes of a plant's results, and that parts return the same result for the same arguments.

    A part fails the second check if it keeps memory in itself or in a closure, or draws its own random
    numbers: its runs cannot be repeated. Controllers have memory, see `check_memory`.

    Parameters
    ----------
    loop : Loop
        Closed loop.
    context : Context
        Argument of the controller's `initial_state`.
    q, v : ndarray, shape (nq,), (nv,)
        Configuration and velocity.

    Raises
    ------
    InvalidArgument
        If a size differs, or a result is not repeated.
    """
    plant, key = loop.plant, (loop.integrator, context.dt / loop.substeps)
    constant = not loop.all_forces and is_constant(loop.integrator or plant)
    if not (constant and _repeatable.get(plant, key)):
        with np.errstate(all="ignore"):
            _check_parts(loop, q, v, key[1])
        if constant:
            _repeatable.keep(plant, key, True)
    sizes = q.shape, v.shape, *map(np.shape, context.reference)
    if not _repeatable.get(loop.controller, sizes):
        try:
            check_memory(loop.controller, context, q, v)
        except InvalidArgument as error:
            raise size_error(context, error) from error.__cause__
        _repeatable.keep(loop.controller, sizes, True)


def _check_parts(loop: Loop, q: Array, v: Array, h: float) -> None:
    """Check a plant, forces and an integrator; `h` is the step [s]."""
    plant, integrator, u = loop.plant, loop.integrator, np.zeros(loop.plant.nu)
    _check_sizes(plant, q, v)
    states = [(x.copy(), w.copy()) for x, w in ((q, v), (plant.integrate(q, 0.01 + 0 * v), v + 0.01))]
    pose, rate = stated(plant, "pose"), stated(plant, "pose_rate")
    for name, force in loop.named_forces.items():
        law: _Law
        if able(force, OnCoordinates):
            law, size = partial(force.on_coordinates, 0.0), plant.nv
        elif callable(pose) and callable(rate):
            law, size = (lambda x, w: force(0.0, pose(x), rate(x, w))), 3  # noqa: B023
        else:
            continue
        _check_repeats(name, force, law, states, f"an array of shape ({size},) of real numbers")
    if integrator is not None:
        _check_repeats("plant", plant, lambda x, w: plant.forward_dynamics(x, w, u.copy()), states)

        def step(x: Array, w: Array) -> object:
            return displace(integrator, lambda t, x, w: -x - w, -w, 0.0, w, h)

        _check_repeats("integrator", integrator, step, [(np.zeros(plant.nv), w) for _, w in states])


class ResultCache:
    """Last result of each immutable part, with its arguments."""

    def __init__(self) -> None:
        self._entries: weakref.WeakKeyDictionary[Any, tuple[Any, Any]] = weakref.WeakKeyDictionary()

    def get(self, part: Any, arguments: tuple[Any, ...]) -> Any:
        """Return the last result of a part; None if the arguments differ or the part may change."""
        entry = self._entries.get(part) if is_constant(part) else None
        return entry[1] if entry is not None and entry[0] == arguments else None

    def keep(self, part: Any, arguments: Any, result: Any) -> None:
        """Keep the result of an immutable part."""
        if is_constant(part):
            self._entries[part] = arguments, result


_CACHED_SIZE = 1e5  # largest size of a reference that is kept for the next run
_references = ResultCache()
"""References of trajectories, by plant and times."""

_repeatable = ResultCache()
"""Whether results are repeated: for plants by integrator and step, for controllers by shapes."""


def _check_sizes(plant: Plant, q: Array, v: Array) -> None:
    nq, nv, u, wrench = plant.nq, plant.nv, np.zeros(plant.nu), np.zeros(3)
    sizes = f"plant is a {type(plant).__name__} with nq = {nq}, nv = {nv} and nu = {plant.nu}"
    for name, value, size in (("q", q, nq), ("v", v, nv)):
        shaped(f"{sizes}, whose first {name}", value, (size,))
    methods: dict[str, tuple[str, int, tuple[Array, ...]]] = {
        "integrate": ("q, dq", nq, (q, np.zeros(nv))),
        "difference": ("q0, q1", nv, (q, q)),
        "project": ("q, v", nv, (q, v)),
        "pose": ("q", 3, (q,)),
        "pose_rate": ("q, v", 3, (q, v)),
        "generalized_force": ("q, wrench", nv, (q, wrench)),
    }
    if not able(plant, Stepping):
        methods["forward_dynamics"] = ("q, v, u", nv, (q, v, u))
    for name, (arguments, size, values) in methods.items():
        method = stated(plant, name)
        if not callable(method):
            continue
        answer, label = method(*(value.copy() for value in values)), f"{sizes}, whose {name}({arguments})"
        if answer is None:
            continue
        check_returned_array(label, answer, f"an array of shape ({size},) of real numbers", (size,))


def _check_repeats(
    path: str, part: object, law: _Law, states: Sequence[tuple[Array, Array]], expected: str = "real numbers"
) -> None:
    """Check that a part returns the same result again after a call with other arguments."""
    first, _, last = (law(x.copy(), w.copy()) for x, w in (*states, states[0]))
    value, repeat = (check_returned_array(path, answer, expected) for answer in (first, last))
    hint = (
        "only controllers have memory, in their state, and random numbers come from their "
        "context.noise(name, n), or from a NoiseForce"
    )
    check_repeat(path, part, value, repeat, _RTOL, hint)
