"""Steps of the plant between two samples, under a held input and under forces that act in between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any, NamedTuple, NoReturn, TypeAlias

import numpy as np

from pinmobile.arrays import Array, are_real
from pinmobile.compiled import reaction
from pinmobile.errors import InvalidArgument, shown
from pinmobile.forces import CoordinateForce, Force
from pinmobile.integrators import Acceleration, Integrator, RungeKuttaNystrom
from pinmobile.plant import Plant, Step

_WRENCH = (3,)

_Push: TypeAlias = Callable[[float, Array, Array], Array]
Acting: TypeAlias = Callable[[float, Array, Array, Array], Array]
"""The force on the coordinates beside the input, of t, q, v and u, shape (nv,)."""
_Advance: TypeAlias = Callable[[int, Array, Array, Array, Array, Array, Array], None]
_OwnStep: TypeAlias = Callable[[int, Array, Array, Array, Array, Array], None]


class Clock(NamedTuple):
    """When samples are taken, and how the integrator divides the time between two."""

    times: list[float]  # [s] of the samples
    h: float  # [s]
    substeps: int


class Dynamics(NamedTuple):
    """The acceleration of a plant under its input, unchecked where the plant offers it.

    Attributes
    ----------
    free : callable
        Of q, v and u, where no other forces are given.
    forced : callable or None
        Of t, q, v and u, under the other forces; None where there are none.
    """

    free: Callable[[Array, Array, Array], Array]
    forced: Callable[[float, Array, Array, Array], Array] | None = None


def dynamics_of(plant: Plant, act: Acting | None, *, kept: bool) -> Dynamics:
    """Return a plant's acceleration, under forces beside its input where there are such.

    Where `kept`, an answer outlives the next one, as whoever brings an integrator expects.
    """
    calls = getattr(plant, "calls", None)
    if calls is not None:
        raw = calls().forward_dynamics
        free = (lambda q, v, u: np.array(raw(q, v, u))) if kept else raw
        return Dynamics(free, None if act is None else lambda t, q, v, u: free(q, v, u + act(t, q, v, u)))

    def forward(q: Array, v: Array, u: Array, *f: Array) -> Array:
        found: Array = plant.forward_dynamics(q.copy(), v.copy(), u.copy(), *f)  # its own to write into
        if not are_real(found):
            raise InvalidArgument(
                f"plant.forward_dynamics returned {shown(found)}, expected an array of real numbers"
            )
        return found

    def forced(t: float, q: Array, v: Array, u: Array) -> Array:
        return forward(q, v, u, act(t, q, v, u))  # type: ignore[misc]

    return Dynamics(forward, None if act is None else forced)


def acting(forces: Sequence[Force | CoordinateForce], plant: Plant, push: _Push | None) -> Acting | None:
    """Return all forces on the coordinates beside the input, as functions of t, q, v and u; None: none act.

    That is what `pushed` returns, and what the body is held back by where forces make it carry something.
    """
    if push is None:
        return None
    if not any(hasattr(force, "inertia") for force in forces):
        return lambda t, q, v, u: push(t, q, v)
    own = plant.calls().forward_dynamics if hasattr(plant, "calls") else None

    def under(q: Array, v: Array, u: Array, f: Array) -> Array:
        if own is not None:
            return np.array(own(q, v, u + f))
        return np.asarray(plant.forward_dynamics(q.copy(), v.copy(), u.copy(), f))  # type: ignore[call-arg]

    def act(t: float, q: Array, v: Array, u: Array) -> Array:
        f = push(t, q, v)
        return np.asarray(f + reaction(plant, forces, t, q.copy(), lambda more: under(q, v, u, f + more)))

    return act


def pushed(forces: Sequence[Force | CoordinateForce], plant: Plant) -> _Push | None:
    """Return the generalised force of all forces, shape (nv,), None where none act; they get copies."""
    if not forces:
        return None
    wrenches = [(k, one) for k, one in enumerate(forces) if not hasattr(one, "on_coordinates")]
    others = [(k, one.on_coordinates) for k, one in enumerate(forces) if hasattr(one, "on_coordinates")]
    size, zeros = (plant.nv,), np.zeros(plant.nv)
    unchecked = hasattr(plant, "calls")
    calls = plant.calls() if hasattr(plant, "calls") else plant
    pose_of, rate_of, effort = (getattr(calls, name, None) for name in ("pose", "rate", "effort"))

    def push(t: float, q: Array, v: Array) -> Array:
        total = zeros
        if wrenches:
            wrench = np.zeros(_WRENCH)
            pose, rate = pose_of(q), rate_of(q, v)  # type: ignore[misc]
            for k, force in wrenches:
                found = force(t, pose.copy(), rate.copy())
                if type(found) is not np.ndarray or found.shape != _WRENCH or not are_real(found):
                    _refuse(f"forces[{k}]", found, t, _WRENCH)
                wrench += found
            # What is no number is for the loop to tell, with all that was before.
            sound = unchecked or isfinite(wrench.sum())
            total = effort(q, wrench) if sound else zeros + np.nan  # type: ignore[misc]
        for k, on_coordinates in others:
            found = on_coordinates(t, q.copy(), v.copy())
            total = total + _answer(f"forces[{k}].on_coordinates", found, t, size)
        return np.asarray(total)

    return push


def _answer(name: str, value: object, t: float, shape: tuple[int, ...]) -> Array:
    if type(value) is not np.ndarray or value.shape != shape or not are_real(value):
        _refuse(name, value, t, shape)
    return value


def _refuse(name: str, value: object, t: float, shape: tuple[int, ...]) -> NoReturn:
    raise InvalidArgument(
        f"{name} returned {shown(value)} at t = {t:g} s, expected an array of shape {shape}"
        f"{'' if are_real(value) else ' of real numbers'}"
    )


def tabled_steps(table: RungeKuttaNystrom, dynamics: Dynamics, clock: Clock, n: int) -> _Advance:
    """Return the steps of a tabled method, one matrix product per stage.

    The work row is (q, v, a_1, ..., a_s); each matrix maps the part that is known to a state.
    """
    (times, h, substeps), (free, forced) = clock, dynamics
    work, state = np.empty((2 + len(table.nodes)) * n), np.empty(2 * n)
    stages = [
        (c, _state_matrix(c, by_q, by_v, h, n), work[: (2 + i) * n], work[(2 + i) * n : (3 + i) * n])
        for i, (c, by_q, by_v) in enumerate(zip(table.nodes, table.stages_q, table.stages_v, strict=True))
    ][1:]
    finish = _state_matrix(1.0, table.weights_q, table.weights_v, h, n)
    stage_q, stage_v = state[:n], state[n:]
    start, first = work[: 2 * n], work[2 * n : 3 * n]

    def one_product(k: int, row: Array, q: Array, v: Array, u: Array, a: Array, after: Array) -> None:
        finish(row, after)

    def advance(k: int, row: Array, q: Array, v: Array, u: Array, a: Array, after: Array) -> None:
        work[: 3 * n] = row
        for j in range(substeps):
            if j:
                start[:] = after
                q, v = start[:n], start[n:]
                first[:] = free(q, v, u) if forced is None else forced(times[k] + j * h, q, v, u)
            for c, product, known, found in stages:
                product(known, state)
                if forced is None:
                    found[:] = free(stage_q, stage_v, u)
                else:
                    found[:] = forced(times[k] + (j + c) * h, stage_q, stage_v, u)
            finish(work, after)

    return advance if stages or substeps > 1 else one_product


def _state_matrix(
    c: float, by_q: tuple[float, ...], by_v: tuple[float, ...], h: float, n: int
) -> Callable[[Array, Array], Array]:
    """Return the product with the matrix that maps (q, v, a_1, ...) to a state (q, v)."""
    rows = [[1.0, c * h, *(weight * h * h for weight in by_q)], [0.0, 1.0, *(weight * h for weight in by_v)]]
    return np.kron(rows, np.eye(n)).dot


def stepped(
    integrator: Integrator, acceleration: Acceleration, t: float, q: Array, v: Array, dt: float
) -> tuple[Array, Array]:
    """Return what a step of any integrator leads to, shapes of q and v.

    Raises
    ------
    InvalidArgument
        If the integrator returns something else.
    """
    after = integrator(acceleration, t, q, v, dt)
    if (
        type(after) is not tuple
        or len(after) != 2
        or [np.shape(part) for part in after] != [q.shape, v.shape]
        or not all(map(are_real, after))
    ):
        raise InvalidArgument(
            f"integrator returned {shown(after)} at t = {t:g} s, "
            f"expected (q, v) of shapes {q.shape} and {v.shape}, of real numbers"
        )
    return after


def steps(integrator: Integrator, dynamics: Dynamics, clock: Clock) -> _Advance:
    """Return the steps of any integrator, for configurations that simply add."""
    (times, h, substeps), (free, forced) = clock, dynamics

    def advance(k: int, row: Array, q: Array, v: Array, u: Array, a: Array, after: Array) -> None:
        now, x, w = times[k], q.copy(), v.copy()  # the record is nobody's to write into
        start = x, w

        def acceleration(time: float, x: Array, w: Array) -> Array:
            known = x is start[0] and w is start[1] and (forced is None or time == now)
            if known and (x == q).all() and (w == v).all():  # unless it was written into
                return a
            return free(x, w, u) if forced is None else forced(time, x, w, u)

        for j in range(substeps):
            x, w = stepped(integrator, acceleration, now + j * h, x, w, h)
        after[: len(q)] = x
        after[len(q) :] = w

    return advance


def steps_between_configurations(
    integrator: Integrator, plant: Plant, dynamics: Dynamics, clock: Clock
) -> _Advance:
    """Return the steps of any integrator, which sees the displacement from the start of its step.

    What constraints leave of the velocity is what is left after each step.
    """
    (times, h, substeps), (free, forced), rest = clock, dynamics, np.zeros(plant.nv)
    integrate, project = plant.integrate, getattr(plant, "project", None)

    def advance(k: int, row: Array, q: Array, v: Array, u: Array, a: Array, after: Array) -> None:
        now, base, w = times[k], q.copy(), v.copy()  # the record is nobody's to write into
        displacement = rest.copy()
        start = displacement, w

        def acceleration(time: float, displacement: Array, w: Array) -> Array:
            known = displacement is start[0] and w is start[1] and (forced is None or time == now)
            if known and not displacement.any() and (w == v).all():  # unless it was written into
                return a
            x = np.asarray(integrate(base.copy(), displacement))
            return free(x, w, u) if forced is None else forced(time, x, w, u)

        for j in range(substeps):
            displacement, w = stepped(integrator, acceleration, now + j * h, displacement, w, h)
            base = np.array(integrate(base, displacement))
            if project is not None:
                w = _answer("plant.project", project(base.copy(), w), now, rest.shape)
            displacement = rest.copy()
        after[: len(q)] = base
        after[len(q) :] = w

    return advance


def own_steps(
    step: Callable[..., Step], push: _Push | None, clock: Clock, memory: object
) -> tuple[_OwnStep, Callable[[], Any]]:
    """Return the steps of a plant that has its own ``step``, and what tells the memory that it has.

    The acceleration is the mean of the first substep's.
    """
    times, h, substeps = clock
    f = push or _nothing

    def advance(k: int, q: Array, v: Array, u: Array, a: Array, after: Array) -> None:
        nonlocal memory
        x, w = q, v
        for j in range(substeps):
            time = times[k] + j * h
            found = step(time, x.copy(), w.copy(), u.copy(), h, f, memory)
            x, w = _state(found, time, q.shape, v.shape)
            memory = found.memory
            if j == 0:
                a[:] = (w - v) / h
        after[: len(q)] = x
        after[len(q) :] = w

    return advance, lambda: memory


def _nothing(t: float, q: Array, v: Array) -> float:
    """Return the force where none acts."""
    return 0.0


def _state(found: object, t: float, *shapes: tuple[int, ...]) -> tuple[Array, Array]:
    if not (hasattr(found, "q") and hasattr(found, "v") and hasattr(found, "memory")):
        raise InvalidArgument(
            f"plant.step returned {shown(found)} at t = {t:g} s, expected a Step(q, v, memory)"
        )
    q, v = (
        _answer(f"{name} of plant.step", part, t, shape)
        for name, part, shape in zip(("q", "v"), (found.q, found.v), shapes, strict=True)
    )
    return q, v
