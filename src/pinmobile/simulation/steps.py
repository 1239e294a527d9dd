"""Steps of the plant between two samples, under a held force and under those that act in between."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from pinmobile.arrays import Array
from pinmobile.disturbances import Force
from pinmobile.errors import InvalidArgument, shown
from pinmobile.integrators import Integrator, RungeKuttaNystrom
from pinmobile.plant import Plant
from pinmobile.robot import MobileRobot

__all__ = [
    "Clock",
    "forward_of",
    "integrate_of",
    "pushed",
    "stepped",
    "steps",
    "steps_between_configurations",
    "tabled_steps",
]

_PLANE = 3  # coordinates that a force on the body acts on
_STRAIGHT = 1e-6  # where a Jacobian is the identity it is so exactly, and of a ball joint it is off by tenths

Forward: TypeAlias = Callable[[Array, Array, Array], Array]
Push: TypeAlias = Callable[[float, Array, Array], Array]
Advance: TypeAlias = Callable[[int, Array, Array, Array, Array, Array, Array], None]


class Clock(NamedTuple):
    """When samples are taken, and how the integrator divides the time between two."""

    times: list[float]  # [s] of the samples
    h: float  # [s]
    substeps: int


def forward_of(plant: Plant) -> Forward:
    """Return forward dynamics in public order, unchecked where the plant allows."""
    if type(plant) is not MobileRobot:
        return plant.forward_dynamics
    engine = plant._engine
    forward, order, order_q = engine.calls().forward, engine.order, engine.order_q
    return lambda q, v, tau: forward(q[order_q], v[order], tau[order])[order]


def integrate_of(plant: "Plant") -> Callable[[Array, Array], Array]:
    """Return the plant's step from a configuration, unchecked where the plant allows."""
    if type(plant) is not MobileRobot:
        return plant.integrate
    engine = plant._engine
    integrate, order, order_q = engine.calls().integrate, engine.order, engine.order_q
    return lambda q, dq: integrate(q[order_q], dq[order])[order_q]


def pushed(forces: tuple[Force, ...], order: Any, nv: int) -> Push:
    """Return the sum of the forces, shape (nv,), in the order of the loop; they get copies of the state."""
    pose = np.arange(_PLANE) if order is None else order[:_PLANE]

    def push(t: float, q: Array, v: Array) -> Array:
        total = np.zeros(nv)
        plane = total[:_PLANE]
        for k, force in enumerate(forces):
            own_q, own_v = q[pose], v[pose]  # copies
            tau = force(t, own_q, own_v)
            if type(tau) is not np.ndarray or tau.shape != (3,):
                raise InvalidArgument(
                    f"forces[{k}] returned {shown(tau)} at t = {t:g} s, expected an array of shape (3,)"
                )
            plane += tau
        return total if order is None else total[order]

    return push


def tabled_steps(
    table: RungeKuttaNystrom, forward: Forward, push: Push | None, clock: Clock, n: int
) -> Advance:
    """Return the steps of a tabled method, one matrix product per stage.

    The work row is (q, v, a_1, ..., a_s); each matrix maps the part that is known to a state.
    """
    times, h, substeps = clock
    work, state = np.empty((2 + len(table.nodes)) * n), np.empty(2 * n)
    stages = [
        (c, _state_matrix(c, by_q, by_v, h, n), work[: (2 + i) * n], work[(2 + i) * n : (3 + i) * n])
        for i, (c, by_q, by_v) in enumerate(zip(table.nodes, table.stages_q, table.stages_v, strict=True))
    ][1:]
    finish = _state_matrix(1.0, table.weights_q, table.weights_v, h, n)
    stage_q, stage_v = state[:n], state[n:]
    start, first = work[: 2 * n], work[2 * n : 3 * n]

    def one_product(k: int, row: Array, q: Array, v: Array, force: Array, a: Array, after: Array) -> None:
        finish(row, after)

    def advance(k: int, row: Array, q: Array, v: Array, force: Array, a: Array, after: Array) -> None:
        work[: 3 * n] = row
        for j in range(substeps):
            if j:
                start[:] = after
                q, v = start[:n], start[n:]
                first[:] = forward(q, v, force if push is None else force + push(times[k] + j * h, q, v))
            for c, product, known, found in stages:
                product(known, state)
                applied = force if push is None else force + push(times[k] + (j + c) * h, stage_q, stage_v)
                found[:] = forward(stage_q, stage_v, applied)
            finish(work, after)

    return advance if stages or substeps > 1 else one_product


def _state_matrix(
    c: float, by_q: tuple[float, ...], by_v: tuple[float, ...], h: float, n: int
) -> Callable[[Array, Array], Array]:
    """Return the product with the matrix that maps (q, v, a_1, ...) to a state (q, v)."""
    rows = [[1.0, c * h, *(weight * h * h for weight in by_q)], [0.0, 1.0, *(weight * h for weight in by_v)]]
    return np.kron(rows, np.eye(n)).dot


def stepped(
    integrator: Integrator, acceleration: Any, t: float, q: Array, v: Array, dt: float
) -> tuple[Array, Array]:
    """Return what a step of any integrator leads to, shapes of q and v.

    Raises
    ------
    InvalidArgument
        If the integrator returns something else.
    """
    after: Any = integrator(acceleration, t, q, v, dt)
    if (
        type(after) is not tuple
        or len(after) != 2
        or [np.shape(part) for part in after] != [q.shape, v.shape]
    ):
        raise InvalidArgument(
            f"integrator returned {shown(after)} at t = {t:g} s, "
            f"expected (q, v) of shapes {q.shape} and {v.shape}"
        )
    return after


def steps(integrator: Integrator, forward: Forward, push: Push | None, clock: Clock) -> Advance:
    """Return the steps of any integrator, for configurations that simply add."""
    times, h, substeps = clock

    def advance(k: int, row: Array, q: Array, v: Array, force: Array, a: Array, after: Array) -> None:
        now, x, w = times[k], q.copy(), v.copy()  # the record is nobody's to write into
        start = x, w

        def acceleration(time: float, x: Array, w: Array) -> Array:
            known = x is start[0] and w is start[1] and (push is None or time == now)
            if known and (x == q).all() and (w == v).all():  # unless it was written into
                return a
            return forward(x, w, force if push is None else force + push(time, x, w))

        for j in range(substeps):
            x, w = stepped(integrator, acceleration, now + j * h, x, w, h)
        after[: len(q)] = x
        after[len(q) :] = w

    return advance


def _turns(plant: Any) -> bool:
    """Tell whether a displacement's rate differs from the velocity, by one that is like any other."""
    if not hasattr(plant, "integrate_jacobian"):
        return False
    J = plant.integrate_jacobian(plant.neutral, np.linspace(0.3, 0.7, plant.nv))
    return bool(np.abs(J - np.eye(plant.nv)).max() > _STRAIGHT)


def steps_between_configurations(
    integrator: Integrator, plant: Plant, push: Push | None, clock: Clock
) -> Advance:
    """Return the steps of any integrator, which sees the displacement from the start of its step.

    Where that does not change at the velocity, as of a ball joint, a table is told at which rate it does.
    """
    (times, h, substeps), rest = clock, np.zeros(plant.nv)
    forward, integrate = forward_of(plant), integrate_of(plant)
    turning: Any = plant if isinstance(integrator, RungeKuttaNystrom) and _turns(plant) else None

    def advance(k: int, row: Array, q: Array, v: Array, force: Array, a: Array, after: Array) -> None:
        def acceleration(time: float, displacement: Array, w: Array) -> Array:
            x = integrate(base, displacement)
            return forward(x, w, force if push is None else force + push(time, x, w))

        def rate(displacement: Array, w: Array) -> Array:
            J: Any = turning.integrate_jacobian(base, displacement)
            return np.asarray(np.linalg.solve(J, w))

        step: Any = partial(integrator, rate=rate) if turning is not None else integrator  # type: ignore[call-arg]
        base, w = q, v.copy()  # the record is nobody's to write into
        for j in range(substeps):
            displacement, w = stepped(step, acceleration, times[k] + j * h, rest.copy(), w, h)
            base = integrate(base, displacement)
        after[: len(q)] = base
        after[len(q) :] = w

    return advance
