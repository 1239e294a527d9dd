"""The inner loop: one row of numbers per sample, few NumPy calls per step.

Where plant and integrator are the library's own, everything runs in the order of Pinocchio's chain, and the
records are put back into public order at the end; feedback and step of the library's own are one matrix
product each. Whatever a user brings is called in public order. All follow the same lines of `Loop.run`.
"""

from collections.abc import Callable
from math import isfinite
from typing import Any

import numpy as np

from pinmobile.arrays import LEAST_ANGLE, Array, wrap_angle
from pinmobile.controllers import (
    PD,
    ComputedTorque,
    Controller,
    PDGravity,
    gain_matrix,
    plain_difference,
    planar_difference,
)
from pinmobile.controllers.feedback import own_difference
from pinmobile.disturbances import Force
from pinmobile.errors import InvalidArgument, NotFinite, shown
from pinmobile.integrators import Integrator, RungeKuttaNystrom
from pinmobile.plant import Context, Plant
from pinmobile.robot import MobileRobot
from pinmobile.simulation.steps import (
    Clock,
    forward_of,
    pushed,
    steps,
    steps_between_configurations,
    tabled_steps,
)
from pinmobile.trajectories import Reference

__all__ = ["Loop", "takes_circle"]


class Loop:
    """Records of a closed loop, and the means to fill them.

    Parameters
    ----------
    plant, controller, integrator, substeps, forces
        As in `simulate`, checked.
    context : Context
        What the controller is told; the reference is sampled at its times.
    q0, v0 : ndarray, shape (nq,) and (nv,)
        Start.
    """

    def __init__(
        self,
        plant: Plant,
        controller: Controller,
        integrator: Integrator,
        context: Context,
        substeps: int,
        forces: tuple[Force, ...],
        q0: Array,
        v0: Array,
    ) -> None:
        t, reference = context.t, context.reference
        self.nq, self.nv, self.last = plant.nq, plant.nv, len(t) - 1
        # Another class may do it otherwise; joints that are (cos, sin) in q do not add.
        self.adds = type(plant) is MobileRobot and self.nq == self.nv
        # A table treats all coordinates alike; what a user's integrator does with their order is not known.
        chained = self.adds and isinstance(integrator, RungeKuttaNystrom)
        self.order = plant._engine.order if chained else None  # type: ignore[attr-defined]
        self.rows = np.full((len(t) + 1, self.nq + 2 * self.nv), np.nan)  # one to spare: each has a next one
        self.taus = np.empty((len(t), plant.nu))
        self.rows[0, : self.nq + self.nv] = np.concatenate([self._reordered(q0), self._reordered(v0)])
        self.desired = np.hstack([self._reordered(reference.q), self._reordered(reference.v)])
        self.forward = plant._engine.calls().forward if chained else forward_of(plant)  # type: ignore[attr-defined]
        if chained and _is_known(controller, plant):
            accelerations = self._reordered(reference.a)
            self.control = _feedback(controller, plant, self.desired, accelerations, np.asarray(self.order))
        else:
            self.control = _asked(controller, context, plant.nu, self.order)
        self.times = t.tolist()
        self.stopped: NotFinite | None = None
        self.push = pushed(forces, self.order, self.nv) if forces else None
        clock = Clock(self.times, context.dt / substeps, substeps)
        if isinstance(integrator, RungeKuttaNystrom) and self.adds:
            self.advance = tabled_steps(integrator, self.forward, self.push, clock, self.nv)
        elif self.adds:
            self.advance = steps(integrator, self.forward, self.push, clock)
        else:
            self.advance = steps_between_configurations(integrator, plant, self.push, clock)

    def run(self, begin: int, end: int) -> None:
        """Fill the samples from `begin` to before `end`, and the state at `end`."""
        nq, n, last = self.nq, self.nq + self.nv, self.last
        control, forward, advance = self.control, self.forward, self.advance
        push, times = self.push, self.times
        rows, following = self.rows[begin:end], self.rows[begin + 1 : end + 1, :n]
        # Views that come from iteration cost half of those that come from indexing.
        parts = rows, rows[:, :nq], rows[:, nq:n], rows[:, :n], rows[:, n:], following, self.taus[begin:end]
        k = begin
        try:
            for k, (row, q, v, state, acceleration, after, held) in enumerate(
                zip(*parts, strict=True), begin
            ):
                held[:] = force = control(k, state, q, v)
                applied = force if push is None else force + push(times[k], q, v)
                acceleration[:] = a = forward(q, v, applied)
                if k < last:
                    advance(k, row, q, v, force, a, after)
        except NotFinite as error:
            self.stopped = error  # the rest stays empty
        except InvalidArgument:
            # A state that is not finite is refused by whoever is asked about it; the rest stays empty.
            if np.isfinite(self.rows[k, :n]).all():
                raise

    def samples(self, begin: int, end: int) -> tuple[Array, Array, Array, Array]:
        """Return q, v, a and tau of the samples, in public order, one row each."""
        nq, n = self.nq, self.nq + self.nv
        rows = self.rows[begin:end]
        parts = rows[:, :nq], rows[:, nq:n], rows[:, n:], self.taus[begin:end]
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
        return self.adds and near and isfinite(rows[:, n:].sum() + self.taus[begin:end].sum())


def _is_known(controller: Any, plant: Plant) -> bool:
    """Tell whether the controller is the library's own in every part, for configurations of that plant."""
    robot = getattr(controller, "robot", None)
    return (
        type(controller) in (PD, PDGravity, ComputedTorque)
        # Both act on the third coordinate alone or on none, which is psi in either order.
        and takes_circle(controller, plant) is not None
        and (robot is None or (type(robot) is MobileRobot and robot.nq == robot.nv == plant.nq))
    )


def takes_circle(controller: Any, plant: Plant) -> bool | None:
    """Tell whether PD or a like takes the difference of the third coordinate on the circle.

    None where its difference of configurations of that plant may be any other.
    """
    difference = own_difference(controller, plant)
    robot: Any = getattr(difference, "__self__", None)
    subtracts = type(robot) is MobileRobot and robot.nq == robot.nv == plant.nv
    if difference is planar_difference or (subtracts and difference == robot.difference):
        return True
    return False if difference is plain_difference else None


def _asked(
    controller: Controller, context: Context, nu: int, order: Any
) -> Callable[[int, Array, Array, Array], Array]:
    """Return the force of any controller, which gets copies that are its own, in public order."""
    times, state = context.t.tolist(), controller.initial_state(context)
    tell = getattr(controller, "applied", None)
    references = map(Reference, *context.reference)  # `control` is called once per sample, in order
    shape = (nu,)

    def control(k: int, row: Array, q: Array, v: Array) -> Array:
        nonlocal state
        own_q, own_v = (q.copy(), v.copy()) if order is None else (q[order], v[order])
        answer = controller(times[k], own_q, own_v, next(references), state)
        if type(answer) is not tuple or len(answer) != 2:
            raise InvalidArgument(
                f"controller returned {shown(answer)} at t = {times[k]:g} s, expected (tau, state)"
            )
        force, state = answer
        if type(force) is not np.ndarray or force.shape != shape:
            raise InvalidArgument(
                f"controller returned {shown(force)} at t = {times[k]:g} s, "
                f"expected an array of shape {shape}"
            )
        if tell is not None:
            state = tell(force.copy(), state)
        return force if order is None else force[order]

    return control


def _feedback(
    controller: Any, plant: Plant, desired: Array, accelerations: Array, order: Array
) -> Callable[[int, Array, Array, Array], Array]:
    """Return the force of PD, with gravity or without, or computed torque in the order of the chain."""
    n = len(order)
    kp, kd = (gain_matrix(name, getattr(controller, name), n) for name in ("kp", "kd"))
    gains = np.hstack([matrix[np.ix_(order, order)] for matrix in (kp, kd)])
    wrapped = takes_circle(controller, plant)
    error, command = np.empty(2 * n), np.empty(n)
    subtract, add, times_gains, pi = np.subtract, np.add, gains.dot, np.pi
    robot: Any = getattr(controller, "robot", None)  # PD has none
    calls = None if robot is None else robot._engine.calls()
    gravity = calls.gravity if calls is not None and type(controller) is PDGravity else None
    inverse = None if calls is None else calls.inverse

    def control(k: int, state: Array, q: Array, v: Array) -> Array:
        subtract(desired[k], state, error)
        if wrapped and not LEAST_ANGLE < error[2] <= pi:
            error[2] = wrap_angle(error[2])
        times_gains(error, command)
        if inverse is None:
            return command
        if gravity is not None:
            add(command, gravity(q), command)
            return command
        add(command, accelerations[k], command)
        return inverse(q, v, command)  # type: ignore[no-any-return]

    return control
