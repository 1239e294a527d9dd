"""The engine that is compiled by numba: the library's own controllers, forces and integrators."""

from typing import Any

import numpy as np

from pinmobile.arrays import Array, affordable
from pinmobile.controllers import PD, ComputedTorque, Delayed, NoisyMeasurement, Saturated
from pinmobile.disturbances import (
    ConstantForce,
    NoiseForce,
    RollingResistance,
    SinusoidalForce,
    ViscousFriction,
    noise_frequencies,
)
from pinmobile.ensembles.batch import Batch, noise_of
from pinmobile.ensembles.layers import core_of, layers_of
from pinmobile.ensembles.part import Engine, Part, empty_counts
from pinmobile.ensembles.scenario import Scenario
from pinmobile.integrators import RungeKuttaNystrom
from pinmobile.robot import MobileRobot
from pinmobile.simulation.loop import takes_circle

__all__ = ["COMPILED"]

_FORCES = (ConstantForce, ViscousFriction, RollingResistance, SinusoidalForce, NoiseForce)
_MOST_STAGES = 8


def _refusal(scenario: Scenario) -> str:
    core: Any = core_of(scenario.controller)
    if type(core) not in (PD, ComputedTorque):
        return f"the controller is {type(core).__name__}, neither PD nor ComputedTorque"
    if type(core) is ComputedTorque and type(core.robot) is not MobileRobot:
        return f"the controller's robot is a {type(core.robot).__name__}, no MobileRobot"
    if takes_circle(core, scenario.robot) is None:
        return "the controller's difference is its own"
    if type(scenario.integrator) is not RungeKuttaNystrom or len(scenario.integrator.nodes) > _MOST_STAGES:
        return f"the integrator, {scenario.integrator!r}, is no table of up to {_MOST_STAGES} stages"
    own = [type(force).__name__ for force in scenario.forces if type(force) not in _FORCES]
    return f"the forces have a {own[0]} of their own" if own else ""


def _run(scenario: Scenario, batch: Batch) -> Part:
    from pinmobile.ensembles import kernel

    inputs = _inputs(scenario, batch, kernel)
    results, counts = np.empty((kernel.RESULTS, batch.size)), empty_counts(scenario)
    reference = np.ascontiguousarray(np.hstack(scenario.reference))
    core: Any = core_of(scenario.controller)
    wrap, torque = bool(takes_circle(core, scenario.robot)), batch.model is not None
    table = _table(scenario)
    judged = wrap, scenario.limit, scenario.begin, scenario.stride, counts
    if _is_lean(scenario, batch):
        clip = 1.0 if any(type(layer) is Saturated for layer in layers_of(scenario.controller)) else None
        step = scenario.dt, float(table[0, 1, 0])
        model = 1.0 if torque else None
        _called(kernel.lean, inputs, results, reference, *step, *judged, model, clip)
    else:
        forces, waves, rollings, sines = _forces(scenario, batch)
        noise, delay = _measurement(scenario, batch)
        times, h = np.ascontiguousarray(scenario.t), scenario.dt / scenario.substeps
        pushed = forces, waves, rollings, sines
        matrices = _matrices(batch)
        loop = inputs, results, reference, times, h
        _called(kernel.general, *loop, *judged, torque, matrices, *pushed, noise, delay, table)
    kept = np.maximum(results[0] - scenario.begin, 1.0)
    return Part(
        lived=results[0].astype(np.int64),
        max_error=results[1:4].T,
        max_distance=np.sqrt(results[4]),
        rms_error=np.sqrt(results[5:8] / kept).T,
        max_force=results[8:11].T,
        counts=counts,
    )


def _called(function: Any, *arguments: Any) -> None:
    try:
        function(*arguments)
    except OSError:
        # What numba has just compiled it could not keep in its file, as on a full disk; it is there all
        # the same.
        function(*arguments)


def _is_lean(scenario: Scenario, batch: Batch) -> bool:
    """Tell whether nothing is asked for that only the general code can."""
    diagonal = all(
        not np.any(gain[..., ~np.eye(3, dtype=bool)]) for gain in (batch.kp, batch.kd) if gain is not None
    )
    table: Any = scenario.integrator
    plain = len(table.nodes) == 1 and scenario.substeps == 1 and not batch.forces
    # In the lean code the force is limited once, after all else.
    direct = all(type(layer) is Saturated for layer in layers_of(scenario.controller))
    return diagonal and plain and direct and table.weights_v == (1.0,)


def _inputs(scenario: Scenario, batch: Batch, rows: Any) -> Array:
    """Return what the kernel, which names its `rows`, is told of each robot."""
    inputs = np.zeros((rows.INPUTS, batch.size))
    inputs[0:3], inputs[3:6], inputs[rows.BODY : rows.BODY + 4] = batch.q.T, batch.v.T, batch.body
    gains: Any = batch.kp, batch.kd
    for first, gain in zip((rows.GAINS, rows.GAINS + 3), gains, strict=True):
        inputs[first : first + 3] = np.diagonal(gain, axis1=-2, axis2=-1).reshape(-1, 3).T
    if batch.model is not None:
        inputs[rows.MODEL : rows.MODEL + 4] = batch.model
    limits = np.full(3, np.inf)
    for layer in layers_of(scenario.controller):
        if type(layer) is Saturated:
            limits = np.minimum(limits, layer.limits)
    inputs[rows.LIMIT : rows.LIMIT + 3] = limits[:, None]
    return inputs


def _matrices(batch: Batch) -> Array:
    gains: Any = batch.kp, batch.kd
    stacked = [np.broadcast_to(gain, (batch.size, 3, 3)).reshape(batch.size, 9).T for gain in gains]
    return np.ascontiguousarray(np.concatenate(stacked))


def _table(scenario: Scenario) -> Array:
    """Return the weights of the integrator, times its step, and its nodes, shape (3, stages + 1, stages)."""
    method: Any = scenario.integrator
    h, stages = scenario.dt / scenario.substeps, len(method.nodes)
    table = np.zeros((3, stages + 1, stages))
    for i in range(stages):
        table[0, i, :i], table[1, i, :i] = method.stages_q[i][:i], method.stages_v[i][:i]
        table[2, i, 0] = method.nodes[i]
    table[0, stages], table[1, stages] = method.weights_q, method.weights_v
    table[0] *= h * h
    table[1] *= h
    return table


def _forces(scenario: Scenario, batch: Batch) -> tuple[Array, Array, int, int]:
    """Return what the general code knows of the forces: rows, waves, and how many there are of a kind."""
    rolling: list[Array] = []
    sine: list[Array] = []
    noise: list[Array] = []
    frequencies: list[Array] = []
    steady, viscous = np.zeros((3, batch.size)), np.zeros((3, batch.size))

    def rows(values: Any) -> Array:
        return np.broadcast_to(np.asarray(values), (batch.size, 3)).T

    for force in batch.forces:
        if type(force) is ConstantForce:
            steady += rows(force.force)
        elif type(force) is ViscousFriction:
            viscous += rows(force.coefficients)
        elif type(force) is RollingResistance:
            rolling += [rows(force.force), rows(force.speed)]
        elif type(force) is SinusoidalForce:
            once = (np.broadcast_to(np.asarray(x), batch.size)[None] for x in (force.frequency, force.phase))
            sine += [rows(force.amplitude), *once]
        else:
            scale = rows(force.std) * np.sqrt(2 / NoiseForce.TERMS)
            for k in range(NoiseForce.TERMS):
                phases = rows(force.phases[..., k, :])
                noise += [scale * np.cos(phases), scale * np.sin(phases)]
            frequencies.append(noise_frequencies(force.bandwidth))
    waves = _waves(scenario, np.concatenate([np.zeros((0, 3)), *frequencies]))
    stacked = np.ascontiguousarray(np.concatenate([steady, viscous, *rolling, *sine, *noise]))
    return stacked, waves, len(rolling) // 2, len(sine) // 3


def _waves(scenario: Scenario, frequencies: Array) -> Array:
    """Return cosine and sine at the times of all stages, shape (N substeps + 1, stages, waves, 3, 2)."""
    method: Any = scenario.integrator
    h = scenario.dt / scenario.substeps
    affordable(
        f"the noise forces' waves at {len(scenario.t) * scenario.substeps:,} steps",
        4.0 * len(scenario.t) * scenario.substeps * len(method.nodes) * len(frequencies),
        "give a larger dt, or engine=pinmobile.ensembles.ARRAYS",
    )
    starts = (scenario.t[:, None] + h * np.arange(scenario.substeps)).ravel()
    starts = starts[: (len(scenario.t) - 1) * scenario.substeps + 1]
    angles = np.multiply.outer(starts[:, None] + h * np.array(method.nodes), 2 * np.pi * frequencies)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def _measurement(scenario: Scenario, batch: Batch) -> tuple[Array, int]:
    """Return what is added to the measurements, shape (N + 1 or 0, 6, m), and their age in samples.

    The noise of a layer is as old as what the layers inside it make of it.
    """
    layers = layers_of(scenario.controller)
    drawn = noise_of(scenario, batch.start, batch.size)
    samples = np.arange(len(scenario.t))
    noise, age = np.zeros((0, 6, batch.size)), 0
    for layer in reversed(layers):
        if type(layer) is Delayed:
            age += layer.samples
        elif type(layer) is NoisyMeasurement:
            numbers = drawn.pop()
            std = np.array([np.broadcast_to(s, 3) for s in (layer.std_q, layer.std_v)])
            mine = (std * numbers)[:, np.maximum(samples - age, 0)]
            mine = mine.reshape(batch.size, len(samples), 6).transpose(1, 2, 0)
            noise = mine + noise if len(noise) else mine
    return np.ascontiguousarray(noise), age


COMPILED = Engine("COMPILED", _run, _refusal, largest=16384)
"""By numba: PD and computed torque in all the library's wrappers, its forces and integrators."""
