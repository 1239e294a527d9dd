"""The inner loop: one row of numbers per sample, few NumPy calls per step.

Where plant, controller and integrator are the library's own, everything runs in the order of Pinocchio's
chain, feedback and step are one matrix product each, and the records are put back into public order at the
end. Anything else is called as it is, in public order. Both follow the same lines of `Loop.run`.
"""

from collections.abc import Callable
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from pinmobile.arrays import Array, wrap_angle
from pinmobile.controllers import PD, ComputedTorque, Controller, gain_matrix, planar_difference
from pinmobile.errors import InvalidArgument
from pinmobile.integrators import Integrator, OneStage, rk4
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Reference

if TYPE_CHECKING:
    from pinmobile.simulation.closed_loop import Plant

__all__ = ["Loop"]


class Loop:
    """Records of a closed loop, and the means to fill them.

    Parameters
    ----------
    plant, controller, integrator, reference, t, dt, substeps
        As in `simulate`, checked; the reference is sampled at the times `t`, shape (N + 1,).
    q0, v0 : ndarray, shape (nq,) and (nv,)
        Start.
    """

    def __init__(
        self,
        plant: "Plant",
        controller: Controller,
        integrator: Integrator,
        reference: Reference,
        t: Array,
        dt: float,
        substeps: int,
        q0: Array,
        v0: Array,
    ) -> None:
        self.nq, self.nv, self.last = plant.nq, plant.nv, len(t) - 1
        self.adds = isinstance(plant, MobileRobot)
        native = _is_native(plant, controller, integrator)
        self.order = plant._engine.order if native else None  # type: ignore[attr-defined]
        self.rows = np.empty((len(t), self.nq + 2 * self.nv))
        self.forces = np.empty((len(t), plant.nu))
        self.rows[0, : self.nq + self.nv] = np.concatenate([self._reordered(q0), self._reordered(v0)])
        self.desired = np.hstack([self._reordered(reference.q), self._reordered(reference.v)])
        self.forward = plant._engine.forward if native else _forward(plant)  # type: ignore[attr-defined]
        self.control = (
            _feedback(controller, self.desired, self._reordered(reference.a), np.asarray(self.order))
            if native
            else _asked(controller, reference, t, plant.nu)
        )
        if isinstance(integrator, OneStage) and substeps == 1 and self.adds:
            self.advance = _matrix_step(integrator, self.rows, dt)
        else:
            add = None if self.adds else plant.integrate
            self.advance = _integrated(integrator, self.rows, self.forward, t, dt, substeps, add)

    def run(self, begin: int, end: int) -> None:
        """Fill the samples from `begin` to before `end`, and the state at `end`."""
        nq, n, last = self.nq, self.nq + self.nv, self.last
        control, forward, advance = self.control, self.forward, self.advance
        rows, forces = self.rows[begin:end], self.forces[begin:end]
        # Views that come from iteration cost half of those that come from indexing.
        parts = rows, rows[:, :nq], rows[:, nq:n], rows[:, :n], rows[:, n:], forces
        for k, (row, q, v, state, acceleration, held) in enumerate(zip(*parts, strict=True), begin):
            held[:] = force = control(k, state, q, v)
            acceleration[:] = a = forward(q, v, force)
            if k < last:
                advance(k, row, q, v, force, a)

    def samples(self, begin: int, end: int) -> tuple[Array, Array, Array, Array]:
        """Return q, v, a and tau of the samples, in public order, one row each."""
        nq, n = self.nq, self.nq + self.nv
        rows = self.rows[begin:end]
        parts = rows[:, :nq], rows[:, nq:n], rows[:, n:], self.forces[begin:end]
        q, v, a, tau = (self._reordered(part) for part in parts)
        return q, v, a, tau

    def _reordered(self, part: Array) -> Array:
        """Return a copy of an array (..., n) in the order of the loop, or back in public order."""
        return part.copy() if self.order is None else np.take(part, self.order, axis=-1)

    def is_fine(self, begin: int, end: int, limit: float) -> bool:
        """Tell whether the samples are finite and near the reference; if in doubt, False."""
        rows = self.rows[begin:end]
        n = self.nq + self.nv
        near = bool(np.abs(self.desired[begin:end] - rows[:, :n]).max() <= limit)  # on the circle it is less
        return self.adds and near and isfinite(rows[:, n:].sum() + self.forces[begin:end].sum())


def _is_native(plant: object, controller: object, integrator: object) -> bool:
    """Tell whether all of the loop is the library's own, so that it may run in the order of the chain."""
    return (
        isinstance(plant, MobileRobot)
        and isinstance(controller, PD | ComputedTorque)
        # Both act on the third coordinate alone or on none, which is psi in either order.
        and (controller.difference is planar_difference or controller.difference is np.subtract)
        and isinstance(getattr(controller, "robot", plant), MobileRobot)
        and (isinstance(integrator, OneStage) or integrator is rk4)
    )


def _forward(plant: "Plant") -> Callable[[Array, Array, Array], Array]:
    """Return forward dynamics in public order, unchecked where the plant allows."""
    if not isinstance(plant, MobileRobot):
        return plant.forward_dynamics
    engine = plant._engine
    forward, order = engine.forward, engine.order
    return lambda q, v, tau: forward(q[order], v[order], tau[order])[order]


def _asked(
    controller: Controller, reference: Reference, t: Array, nu: int
) -> Callable[[int, Array, Array, Array], Array]:
    """Return the force of any controller, which gets copies that are its own."""
    times, state = t.tolist(), controller.initial_state()
    references = map(Reference, *reference)  # `control` is called once per sample, in order
    shape = (nu,)

    def control(k: int, row: Array, q: Array, v: Array) -> Array:
        nonlocal state
        force, state = controller(times[k], q.copy(), v.copy(), next(references), state)
        if type(force) is not np.ndarray or force.shape != shape:
            raise InvalidArgument(
                f"controller returned {force!r} at t = {times[k]:g} s, expected an array of shape {shape}"
            )
        return force

    return control


def _feedback(
    controller: Any, desired: Array, accelerations: Array, order: Array
) -> Callable[[int, Array, Array, Array], Array]:
    """Return the force of PD or computed torque in the order of the chain."""
    n = len(order)
    kp, kd = (gain_matrix(name, getattr(controller, name), n) for name in ("kp", "kd"))
    gains = np.hstack([matrix[np.ix_(order, order)] for matrix in (kp, kd)])
    wrapped = controller.difference is planar_difference
    error, command = np.empty(2 * n), np.empty(n)
    subtract, add, times_gains, pi = np.subtract, np.add, gains.dot, np.pi
    robot: Any = getattr(controller, "robot", None)  # PD has none
    inverse = None if robot is None else robot._engine.inverse

    def control(k: int, state: Array, q: Array, v: Array) -> Array:
        subtract(desired[k], state, error)
        if wrapped and not -pi < error[2] <= pi:
            error[2] = wrap_angle(error[2])
        times_gains(error, command)
        if inverse is None:
            return command
        add(command, accelerations[k], command)
        return inverse(q, v, command)  # type: ignore[no-any-return]

    return control


def _matrix_step(
    integrator: OneStage, rows: Array, dt: float
) -> Callable[[int, Array, Array, Array, Array, Array], None]:
    """Return the step of a one-stage method as a matrix that maps (q, v, a) to the next (q, v)."""
    n = rows.shape[1] // 3
    eye, zero = np.eye(n), np.zeros((n, n))
    step = np.block([[eye, dt * eye, integrator.weight * dt * dt * eye], [zero, eye, dt * eye]]).dot
    states = rows[:, : 2 * n]

    def advance(k: int, row: Array, q: Array, v: Array, force: Array, a: Array) -> None:
        step(row, states[k + 1])

    return advance


def _integrated(
    integrator: Integrator,
    rows: Array,
    forward: Callable[[Array, Array, Array], Array],
    t: Array,
    dt: float,
    substeps: int,
    add: Callable[[Array, Array], Array] | None,
) -> Callable[[int, Array, Array, Array, Array, Array], None]:
    """Return `substeps` steps of any integrator.

    Where configurations do not simply add, `add(q, dq)` does it, and the integrator sees the displacement
    from the start of its step.
    """
    times, h = t.tolist(), dt / substeps

    def advance(k: int, row: Array, q: Array, v: Array, force: Array, a: Array) -> None:
        def acceleration(time: float, x: Array, w: Array) -> Array:
            if x is start and w is v:
                return a  # known already
            return forward(x if add is None else add(base, x), w, force)

        base, w = q, v
        start = q if add is None else np.zeros(len(v))
        for j in range(substeps):
            x, w = integrator(acceleration, times[k] + j * h, start, w, h)
            base = x if add is None else add(base, x)
            start = base if add is None else np.zeros(len(v))
        rows[k + 1, : len(q)] = base
        rows[k + 1, len(q) : len(q) + len(v)] = w

    return advance
