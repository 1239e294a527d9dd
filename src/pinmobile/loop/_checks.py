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
    affordable,
    callable_as,
    check_integer,
    check_returned_array,
    frozen,
    positive,
    sequence,
    vector,
)
from pinmobile.compiled import is_constant
from pinmobile.controllers import check_controller, check_memory
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.integrators import Integrator, check_integrator, constant_acceleration
from pinmobile.loop._loop import Loop, displaced, named_forces
from pinmobile.loop._python import error_of_sizes
from pinmobile.parts import Carried, Following, OnCoordinates, Pushable, Stepping, able, required
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

_Ask: TypeAlias = Callable[[Array, Array], object]

_WHOLE = 1e-9  # relative rounding allowed in duration / dt
_COORDINATES = 3  # assumed number before the plant is checked
_MOST = 1e8  # samples
_SHORTER = "give a larger dt or a shorter duration"
_MOST_STEPS = 1e11  # steps of the integrator, which take days
_SAME = 1e-9  # tolerance of two results for the same arguments
_RECORDED = 16  # numbers per coordinate of a sample in the loop, the reference and the rollout


def checked_run(
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
    integrator = chosen_integrator(plant, integrator)
    check_controller(controller)
    refuse_path("trajectory", trajectory)
    required("trajectory", trajectory, Following)
    check_plant(plant)
    if integrator is not None:
        check_integrator(integrator)
    t, kept = sample_times(dt, duration, trajectory.duration), checked_forces(forces, plant)
    return Loop(plant, controller, trajectory, kept, integrator, checked_substeps(substeps, len(t))), t


def chosen_integrator(plant: Plant, integrator: Integrator | None) -> Integrator | None:
    """Return the given integrator or the plant's own choice; None for a plant with its own step method.

    Raises
    ------
    InvalidArgument
        If an integrator is given for a plant with its own step method.
    """
    own = None if isinstance(plant, type) else able(plant, Stepping)
    if own is None:
        chosen = stated(plant, "integrator") if integrator is None else integrator
        return constant_acceleration if chosen is None else chosen
    if integrator is not None:
        whose = f"but the plant, a {type(plant).__name__}, has its own step"
        raise InvalidArgument(f"integrator is {format_value(integrator)}, {whose}: leave integrator out")
    return None


def checked_substeps(substeps: int, samples: int) -> int:
    """Return the number of integrator steps per sample.

    Raises
    ------
    InvalidArgument
        If the number is not a whole number >= 1, or the run would take days.
    """
    return check_integer("substeps", substeps, most=int(_MOST_STEPS / samples))


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
    if total > longest * (1 + _WHOLE):
        raise InvalidArgument(f"duration is {total} s, expected at most the trajectory's {longest} s")
    if not total / _MOST <= dt <= total * (1 + _WHOLE):
        least = f"at least {total / _MOST:g} s: {_MOST:g} samples"
        raise InvalidArgument(f"dt is {dt} s, expected at most the duration, {total} s, and {least}")
    steps = round(total / dt)
    affordable(f"the records of {steps + 1:,} samples", _RECORDED * _COORDINATES * (steps + 1), _SHORTER)
    if abs(steps * dt - total) > _WHOLE * total:
        below = int(total / dt)
        if duration is None:
            why = f"the trajectory's {total:.12g} s are not a whole number of steps dt = {dt:g} s"
            warn(f"the last sample is at t = {below * dt:.12g} s: {why}", stacklevel=4)
            return np.asarray(np.arange(below + 1) * dt)
        expected = f"a whole number of steps dt = {dt} s, such as {below * dt:.12g} s"
        raise InvalidArgument(f"duration is {total} s, expected {expected}")
    t = np.arange(steps + 1) * dt
    t[-1] = total
    return np.asarray(np.minimum(t, longest))


def sampled(trajectory: Trajectory, t: Array, plant: Plant) -> Reference:
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
    what = f"the records of {len(t):,} samples of {plant.nv} coordinates"
    affordable(what, _RECORDED * len(t) * plant.nv, _SHORTER)
    asked = id(plant), t.tobytes()
    before: tuple[Reference, Callable[[], Plant | None]] | None = _sampled.get(trajectory, asked)
    if before is not None and before[1]() is plant:  # and no other with its id
        return before[0]
    try:
        reference = trajectory(t)
    except InvalidArgument:
        raise  # the message already names the cause, such as a joint limit
    except (TypeError, ValueError) as error:
        raise InvalidArgument(f"trajectory does not accept an array of {len(t)} times: {error}") from error
    reference_sizes = reference_sizes_of(plant)
    count = np.asarray(stated(reference, "v")).shape[-1:]
    n = count[0] if count and count[0] in reference_sizes else max(reference_sizes)
    sizes = {"q": reference_sizes[n], "v": n, "a": n}
    for name, size in sizes.items():
        value = np.asarray(stated(reference, name))
        if value.shape != (len(t), size):
            shorter = [k for k in reference_sizes if k != n]
            how = f", or the first of its coordinates: {', '.join(map(str, shorter))}" if shorter else ""
            what = f"trajectory gives {name} of shape {value.shape} for {len(t)} times"
            raise InvalidArgument(f"{what}, expected ({len(t)}, {size}){how}")
    checked = Reference(*(vector(f"trajectory's {x}", getattr(reference, x), k) for x, k in sizes.items()))
    if stated(plant, "velocity_limit") is not None:
        check_limits(plant, checked.q, checked.v, t)
    if len(t) * n > _KEPT or not is_constant(trajectory):
        return checked
    checked = Reference(*map(frozen, checked))
    with contextlib.suppress(TypeError):  # a plant without weak references
        _sampled.keep(trajectory, asked, (checked, weakref.ref(plant)))
    return checked


def checked_forces(forces: Any, plant: Plant) -> Any:
    """Return the forces, which the plant must accept.

    Raises
    ------
    InvalidArgument
        If a force is not a function, or the plant lacks a capability that the forces need.
    """
    is_named, kept = isinstance(forces, Mapping), forces
    kept = dict(kept) if is_named else sequence("forces", kept, "a sequence of forces, such as [force]")
    listed, wrenches = named_forces(kept), False
    for name, force in listed.items():
        if able(force, OnCoordinates):
            callable_as(f"{name}.on_coordinates(t, q, v)", force.on_coordinates)
        else:
            callable_as(f"{name}(t, q, v)", force)
            wrenches = True
    if wrenches:
        required("plant", plant, Pushable, "forces push its body")
    _check_carried(listed, plant)
    if listed and not able(plant, Stepping):
        try:
            callable_as("plant.forward_dynamics(q, v, u, f)", plant.forward_dynamics)
        except InvalidArgument:
            what = f"plant is a {type(plant).__name__}, whose forward_dynamics takes no external forces f"
            raise InvalidArgument(f"{what}, expected forward_dynamics(q, v, u, f)") from None
    return kept


def _check_carried(forces: Mapping[str, Any], plant: Plant) -> None:
    """Reject forces that add inertia if the plant does not provide the acceleration of its body."""
    name = next((name for name, force in forces.items() if able(force, Carried)), None)
    if name is None:
        return
    first = tuple(one.name for one in coordinates_of(plant)[:3])
    if able(plant, Stepping) or first != ("x", "y", "psi"):
        why = "has its own step" if able(plant, Stepping) else f"begins with the coordinates {first}"
        force, kind = format_value(forces[name]), type(plant).__name__
        what = f"{name} is {force}, which adds inertia to the plant, a {kind}"
        expected = "a plant with an integrator and the first coordinates x, y and psi"
        raise InvalidArgument(f"{what}, which {why}; expected {expected}")


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
    plant, asked = loop.plant, (loop.integrator, context.dt / loop.substeps)
    constant = not loop.all_forces and is_constant(loop.integrator or plant)
    if not (constant and _answered.get(plant, asked)):
        with np.errstate(all="ignore"):
            _check_parts(loop, q, v, asked[1])
        if constant:
            _answered.keep(plant, asked, True)
    sizes = q.shape, v.shape, *map(np.shape, context.reference)
    if not _answered.get(loop.controller, sizes):
        try:
            check_memory(loop.controller, context, q, v)
        except InvalidArgument as error:
            raise error_of_sizes(context, error) from error.__cause__
        _answered.keep(loop.controller, sizes, True)


def _check_parts(loop: Loop, q: Array, v: Array, h: float) -> None:
    """Check a plant, forces and an integrator; `h` is the step [s]."""
    plant, integrator, u = loop.plant, loop.integrator, np.zeros(loop.plant.nu)
    _check_sizes(plant, q, v)
    states = [(x.copy(), w.copy()) for x, w in ((q, v), (plant.integrate(q, 0.01 + 0 * v), v + 0.01))]
    pose, rate = stated(plant, "pose"), stated(plant, "pose_rate")
    for name, force in loop.named_forces.items():
        ask: _Ask
        if able(force, OnCoordinates):
            ask, size = partial(force.on_coordinates, 0.0), plant.nv
        elif callable(pose) and callable(rate):
            ask, size = (lambda x, w: force(0.0, pose(x), rate(x, w))), 3  # noqa: B023
        else:
            continue
        _check_repeated(name, force, ask, states, f"an array of shape ({size},) of real numbers")
    if integrator is not None:
        _check_repeated("plant", plant, lambda x, w: plant.forward_dynamics(x, w, u.copy()), states)

        def moved(x: Array, w: Array) -> object:
            return displaced(integrator, lambda t, x, w: -x - w, -w, 0.0, w, h)

        _check_repeated("integrator", integrator, moved, [(np.zeros(plant.nv), w) for _, w in states])


class Last:
    """Last result of each immutable part, with its arguments."""

    def __init__(self) -> None:
        self._known: weakref.WeakKeyDictionary[Any, tuple[Any, Any]] = weakref.WeakKeyDictionary()

    def get(self, part: Any, asked: tuple[Any, ...]) -> Any:
        """Return the last result of a part; None if the arguments differ or the part may change."""
        known = self._known.get(part) if is_constant(part) else None
        return known[1] if known is not None and known[0] == asked else None

    def keep(self, part: Any, asked: Any, found: Any) -> None:
        """Keep the result of an immutable part."""
        if is_constant(part):
            self._known[part] = asked, found


_KEPT = 1e5  # largest size of a reference that is kept for the next run
_sampled = Last()
"""References of trajectories, by plant and times."""

_answered = Last()
"""Whether results are repeated: for plants by integrator and step, for controllers by shapes."""


def _check_sizes(plant: Plant, q: Array, v: Array) -> None:
    nq, nv, u, wrench = plant.nq, plant.nv, np.zeros(plant.nu), np.zeros(3)
    sizes = f"plant is a {type(plant).__name__} with nq = {nq}, nv = {nv} and nu = {plant.nu}"
    for name, value, size in (("q", q, nq), ("v", v, nv)):
        if (shape := np.shape(value)) != (size,):
            raise InvalidArgument(f"{sizes}, which starts with {name} of shape {shape}, expected ({size},)")
    asked: dict[str, tuple[str, int, tuple[Array, ...]]] = {
        "integrate": ("q, dq", nq, (q, np.zeros(nv))),
        "difference": ("q0, q1", nv, (q, q)),
        "project": ("q, v", nv, (q, v)),
        "pose": ("q", 3, (q,)),
        "pose_rate": ("q, v", 3, (q, v)),
        "generalized_force": ("q, wrench", nv, (q, wrench)),
    }
    if not able(plant, Stepping):
        asked["forward_dynamics"] = ("q, v, u", nv, (q, v, u))
    for name, (arguments, size, values) in asked.items():
        method = stated(plant, name)
        if not callable(method):
            continue
        answer, whose = method(*(value.copy() for value in values)), f"{sizes}, whose {name}({arguments})"
        if answer is None:
            continue
        if np.shape(answer) != (size,):
            raise InvalidArgument(
                f"{whose} returned {format_value(answer)}, expected an array of shape ({size},)"
            )
        check_returned_array(whose, answer)


def _check_repeated(
    path: str, part: object, ask: _Ask, states: Sequence[tuple[Array, Array]], expected: str = "real numbers"
) -> None:
    """Check that a part returns the same result again after a call with other arguments."""
    first, _, again = (ask(x.copy(), w.copy()) for x, w in (*states, states[0]))
    one, other = (check_returned_array(path, answer, expected) for answer in (first, again))
    same = np.shape(one) == np.shape(other)
    if not (same and np.allclose(one, other, rtol=_SAME, atol=_SAME, equal_nan=True)):
        raise InvalidArgument(
            f"{path} is {format_value(part)}, which returns {format_value(first)} and, asked again for the "
            f"same arguments, {format_value(again)}, expected the same: only controllers have memory, in "
            "their state, and random numbers come from their context.noise(name, n), or from a NoiseForce"
        )
