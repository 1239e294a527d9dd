"""The engine of plain numpy, which takes whatever works on arrays: the reference for the other."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinmobile import closed_form
from pinmobile.arrays import Array
from pinmobile.controllers import NoisyMeasurement, planar_difference
from pinmobile.controllers.feedback import own_difference
from pinmobile.controllers.protocol import answer_of, told
from pinmobile.ensembles.batch import Batch, noise_of
from pinmobile.ensembles.histogram import BINS, bins_of
from pinmobile.ensembles.layers import core_of, layers_of
from pinmobile.ensembles.part import Engine, Part, empty_counts
from pinmobile.ensembles.probing import context_of, fresh
from pinmobile.ensembles.scenario import Scenario
from pinmobile.errors import InvalidArgument
from pinmobile.plant import Context
from pinmobile.simulation import stepped
from pinmobile.trajectories import Reference

__all__ = ["ARRAYS", "asked"]


class _Records:
    """What is kept, sample by sample, of the robots that have not diverged."""

    def __init__(self, scenario: Scenario, size: int) -> None:
        self.every, self.limit, self.begin = scenario.stride, scenario.limit, scenario.begin
        self.alive = np.ones(size, bool)
        self.lived = np.zeros(size, np.int64)
        self.largest, self.squares, self.forces = (
            np.zeros((size, 4)),
            np.zeros((size, 3)),
            np.zeros((size, 3)),
        )
        self.counts = empty_counts(scenario)

    def judge(self, error: Array, rate: Array) -> None:
        """Look at the errors of configuration and velocity, each of shape (m, 3)."""
        worst = np.abs(np.hstack([error, rate])).max(axis=1)
        self.alive &= worst <= self.limit  # not so where it is no number

    def take(self, k: int, error: Array, tau: Array, a: Array) -> None:
        """Take sample k: the error, the controller's force and the acceleration, each of shape (m, 3)."""
        self.alive &= np.isfinite(np.hstack([tau, a])).all(axis=1)
        self.lived += self.alive
        held, force = np.where(self.alive[:, None], error, 0.0), np.where(self.alive[:, None], tau, 0.0)
        distance = np.sqrt(held[:, 0] * held[:, 0] + held[:, 1] * held[:, 1])
        sizes = np.column_stack([np.abs(held), distance])
        if k == self.begin:
            self.largest[:], self.squares[:] = 0.0, 0.0
        self.largest = np.maximum(self.largest, sizes)
        self.squares += held * held
        self.forces = np.maximum(self.forces, np.abs(force))
        if k % self.every == 0:
            for row, size in zip(self.counts[k // self.every], (distance, sizes[:, 2]), strict=True):
                bins = bins_of(np.where(self.alive, size, np.inf))
                row += np.bincount(bins, minlength=BINS).astype(np.int32)

    def part(self) -> Part:
        """Return what was kept."""
        kept = np.maximum(self.lived - self.begin, 1)[:, None]
        rms = np.sqrt(self.squares / kept)
        return Part(self.lived, self.largest[:, :3], self.largest[:, 3], rms, self.forces, self.counts)


def _run(scenario: Scenario, batch: Batch) -> Part:
    controller = _controller(scenario, batch)
    context = context_of(scenario)
    state, records = controller.initial_state(context), _Records(scenario, batch.size)
    q, v = batch.q, batch.v
    last = len(scenario.t) - 1
    with np.errstate(all="ignore"):  # what overflows is judged
        for k, time in enumerate(scenario.t.tolist()):
            at = Reference(*(part[k] for part in scenario.reference))
            error, rate = planar_difference(q, at.q), at.v - v
            records.judge(error, rate)
            # A robot that has diverged stays on the trajectory, so that no controller sees what is no number.
            stays = ~records.alive[:, None]
            q, v = np.where(stays, at.q, q), np.where(stays, at.v, v)
            tau, state = asked(controller, time, q, v, at, state)
            state = told(controller, tau, state)
            a = _accelerations(batch, time, q, v, tau)
            records.take(k, error, tau, a)
            if k < last:
                q, v = _advanced(scenario, batch, time, q, v, tau)
    return records.part()


def asked(controller: Any, t: float, q: Array, v: Array, at: Reference, state: Any) -> tuple[Array, Any]:
    """Return the force of a controller, shape (m, 3), and its next state.

    Raises
    ------
    InvalidArgument
        If it returns another shape, or something else than two.
    """
    tau, state = answer_of(controller, t, q.copy(), v.copy(), at, state)
    if np.shape(tau) != q.shape:
        raise InvalidArgument(
            f"controller returned shape {np.shape(tau)} at t = {t:g} s for q of shape {q.shape}, expected "
            f"{q.shape}: in an ensemble it works on arrays, one row per robot"
        )
    return np.asarray(tau, np.float64), state


def _accelerations(batch: Batch, t: float, q: Array, v: Array, tau: Array) -> Array:
    return closed_form.unchecked_forward_dynamics(q, v, _pushed(batch.forces, t, q, v, tau), *batch.body)


def _pushed(forces: Sequence[Any], t: float, q: Array, v: Array, tau: Array) -> Array:
    for k, force in enumerate(forces):
        pushed = force(t, q, v)
        if np.shape(pushed) != q.shape:
            raise InvalidArgument(
                f"forces[{k}] returned shape {np.shape(pushed)} for q of shape {q.shape}, expected "
                f"{q.shape}: in an ensemble it works on arrays, one row per robot"
            )
        tau = tau + pushed
    return tau


def _advanced(
    scenario: Scenario, batch: Batch, t: float, q: Array, v: Array, tau: Array
) -> tuple[Array, Array]:
    h = scenario.dt / scenario.substeps

    def acceleration(time: float, x: Array, w: Array) -> Array:
        return _accelerations(batch, time, x, w, tau)

    for j in range(scenario.substeps):
        q, v = stepped(scenario.integrator, acceleration, t + j * h, q, v, h)
    return q, v


@dataclass(frozen=True)
class _Feedback:
    """PD or computed torque, with gains and a model for each robot."""

    core: Any
    plant: Any
    batch: Batch

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: None) -> tuple[Array, None]:
        """Return the force, shape (m, 3), and None."""
        batch, rate = self.batch, reference.v - v
        tau = _times(batch.kp, own_difference(self.core, self.plant)(q, reference.q)) + _times(batch.kd, rate)
        if batch.model is not None:
            tau = closed_form.unchecked_inverse_dynamics(q, v, reference.a + tau, *batch.model)
        return tau, None


def _times(gain: Any, error: Array) -> Array:
    # Not as a matrix product, whose rounding depends on how many robots there are.
    columns = (gain[..., k] * error[:, k, None] for k in range(3))
    return np.asarray(sum(columns))


@dataclass(frozen=True)
class _Noisy:
    """A noisy measurement with numbers of its own for each robot, shape (m, N + 1, 2, 3)."""

    controller: Any
    layer: NoisyMeasurement
    numbers: NDArray[np.float64]

    def initial_state(self, context: Context) -> tuple[Any, int]:
        """Return the wrapped controller's state, and no samples so far."""
        return self.controller.initial_state(context), 0

    def applied(self, u: Array, state: Any) -> Any:
        """Return the state, with the wrapped controller told of the force that is applied."""
        return told(self.controller, u, state[0]), state[1]

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: Any) -> tuple[Array, Any]:
        """Return the force, shape (m, 3), and the next state."""
        inner, k = state
        noisy_q = q + np.asarray(self.layer.std_q) * self.numbers[:, k, 0]
        noisy_v = v + np.asarray(self.layer.std_v) * self.numbers[:, k, 1]
        tau, inner = self.controller(t, noisy_q, noisy_v, reference, inner)
        return tau, (inner, k + 1)


def _controller(scenario: Scenario, batch: Batch) -> Any:
    core = core_of(scenario.controller)
    controller = fresh(core) if batch.kp is None else _Feedback(core, scenario.robot, batch)
    noise = noise_of(scenario, batch.start, batch.size)
    for layer in reversed(layers_of(scenario.controller)):
        if type(layer) is NoisyMeasurement:
            controller = _Noisy(controller, layer, noise.pop())
        else:
            controller = replace(layer, controller=controller)
    return controller


ARRAYS = Engine("ARRAYS", _run, lambda scenario: "", largest=4096)
"""By numpy: any controller, force and integrator that works on arrays."""
