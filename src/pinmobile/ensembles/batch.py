"""Some robots of an ensemble: their numbers as arrays, and each as the arguments of `simulate`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.controllers import ComputedTorque, NoisyMeasurement, gain_matrix
from pinmobile.disturbances import NoiseForce
from pinmobile.ensembles.scenario import FORCE_FIELDS, Scenario, core_of, layers_of
from pinmobile.ensembles.spread import in_blocks, stream
from pinmobile.robot import MobileRobot

__all__ = ["Batch", "Member", "batch_of", "member_of", "noise_of"]

_BODY = ("mass", "yaw_inertia", "com_x", "com_y")


class Batch(NamedTuple):
    """The numbers of m robots, from `start` on.

    Attributes
    ----------
    start, size : int
        Index of the first, and m.
    body : ndarray, shape (4, m)
        Mass, yaw inertia and centre of mass [kg, kg m^2, m, m].
    model : ndarray, shape (4, m), or None
        What the controller believes in; None where it has no model that is known.
    q, v : ndarray, shape (m, 3)
        Start.
    kp, kd : ndarray, shape (m, 3, 3) or (3, 3), or None
        Gains; None where the controller is a user's.
    forces : tuple of forces
        Each broadcasts over the robots.
    """

    start: int
    size: int
    body: Array
    model: Array | None
    q: Array
    v: Array
    kp: Array | None
    kd: Array | None
    forces: tuple[Any, ...]


class Member(NamedTuple):
    """One robot of an ensemble: ``simulate(*member[:3], **member.options)`` runs it alone.

    Attributes
    ----------
    robot, controller, trajectory
        As in `simulate`.
    options : dict
        The other arguments of `simulate`.
    """

    robot: MobileRobot
    controller: Any
    trajectory: Any
    options: dict[str, Any]


def batch_of(scenario: Scenario, draws: Mapping[str, Array], start: int, size: int) -> Batch:
    """Return `size` robots from `start` on.

    Parameters
    ----------
    scenario : Scenario
        Whose robots.
    draws : mapping of str to ndarray, shape (m,)
        What `Scenario.draws` gives for them.
    start, size : int
        Index of the first, and m.
    """
    core, nominal = core_of(scenario.controller), scenario.nominal

    def rows(*names: str) -> Array:
        return np.array([np.broadcast_to(draws.get(name, np.float64(nominal[name])), size) for name in names])

    offsets = rows("start_x", "start_y", "start_psi", "start_vx", "start_vy", "start_yaw_rate")
    modelled = type(core) is ComputedTorque and type(core.robot) is MobileRobot
    gains = [_gains(name, core, draws, size) if hasattr(core, name) else None for name in ("kp", "kd")]
    return Batch(
        start=start,
        size=size,
        body=rows(*_BODY),
        model=rows(*(f"model_{name}" for name in _BODY)) if modelled else None,
        q=scenario.reference.q[0] + offsets[:3].T,
        v=scenario.reference.v[0] + offsets[3:].T,
        kp=gains[0],
        kd=gains[1],
        forces=tuple(_force(scenario, k, draws, start, size) for k in range(len(scenario.forces))),
    )


def _gains(name: str, core: Any, draws: Mapping[str, Array], size: int) -> Array:
    matrix = gain_matrix(name, getattr(core, name), 3)
    mine = {key: column for key, column in draws.items() if key.startswith(name)}
    if not mine:
        return matrix
    gains = np.tile(matrix, (size, 1, 1))
    if name in mine:
        gains = mine[name][:, None, None] * np.eye(3)
    for k, coordinate in enumerate(("x", "y", "psi")):
        if f"{name}_{coordinate}" in mine:
            gains[:, k, k] = mine[f"{name}_{coordinate}"]
    return gains * mine.get(f"{name}_factor", np.ones(size))[:, None, None]


def _force(scenario: Scenario, k: int, draws: Mapping[str, Array], start: int, size: int) -> Any:
    """Return a force of the scenario with what is drawn of it."""
    force = scenario.forces[k]
    changed: dict[str, Array] = {}
    for name, (kind, field, column) in FORCE_FIELDS.items():
        if type(force) is kind and name in draws:
            if column is None:
                changed[field] = draws[name]
            else:
                changed.setdefault(field, np.tile(getattr(force, field), (size, 1)))[:, column] = draws[name]
    if type(force) is NoiseForce:

        def phases(generator: np.random.Generator, count: int) -> Array:
            return generator.uniform(0, 2 * np.pi, (count, NoiseForce.TERMS, 3))

        drawn = in_blocks(f"phases {k}", phases, scenario.seed, start, start + size)
        return NoiseForce.of_phases(changed.get("std", force.std), force.bandwidth, drawn)
    return replace(force, **changed) if changed else force


def noise_of(scenario: Scenario, start: int, size: int) -> list[Array]:
    """Return the standard normal numbers of each noisy measurement, the outermost first.

    Returns
    -------
    tables : list of ndarray, shape (size, N + 1, 2, 3)
        For each robot and sample those of q and of v.
    """
    layers = [layer for layer in layers_of(scenario.controller) if type(layer) is NoisyMeasurement]
    samples = len(scenario.t), 2, 3
    return [
        np.array(
            [
                np.random.default_rng(_noise_seed(scenario, k, i)).standard_normal(samples)
                for i in range(start, start + size)
            ]
        )
        for k in range(len(layers))
    ]


def _noise_seed(scenario: Scenario, layer: int, i: int) -> np.random.SeedSequence:
    return stream(scenario.seed, f"measurement {layer}", i)


def member_of(scenario: Scenario, i: int) -> Member:
    """Return robot i as the arguments of `simulate`.

    Parameters
    ----------
    scenario : Scenario
        Whose robot.
    i : int
        Its index, 0 <= i < n.
    """
    draws = scenario.draws(i, i + 1)
    batch = batch_of(scenario, draws, i, 1)
    robot = scenario.robot
    if any(name in draws for name in _BODY):
        robot = _robot(robot, batch.body)
    core: Any = core_of(scenario.controller)
    changes: dict[str, Any] = {}
    for name, gain in (("kp", batch.kp), ("kd", batch.kd)):
        if gain is not None and gain.ndim == 3:
            changes[name] = gain[0]
    if batch.model is not None and any(name.startswith("model_") for name in draws):
        changes["robot"] = _robot(core.robot, batch.model)
    controller = replace(core, **changes) if changes else core
    options = {
        "dt": scenario.dt,
        "duration": scenario.duration,
        "q0": batch.q[0],
        "v0": batch.v[0],
        "integrator": scenario.integrator,
        "substeps": scenario.substeps,
        "forces": tuple(_of_one(force) for force in batch.forces),
        "limit": scenario.limit,
    }
    return Member(robot, _rewrapped(scenario, controller, i), scenario.trajectory, options)


def _robot(robot: MobileRobot, body: Array) -> MobileRobot:
    mass, inertia, x, y = body[:, 0].tolist()
    return MobileRobot(mass, inertia, com=(x, y, robot.com[2]), size=robot.size, dh=robot.dh)


def _of_one(force: Any) -> Any:
    """Return a force whose fields have no axis for robots."""
    if type(force) is NoiseForce:
        std: Any = force.std
        phases = force.phases[0] if force.phases.ndim == 3 else force.phases
        return NoiseForce.of_phases(std[0] if std.ndim == 2 else std, force.bandwidth, phases)
    fields = {field for kind, field, _ in FORCE_FIELDS.values() if type(force) is kind}
    flat = {}
    for field in fields:
        value = getattr(force, field)
        if value.ndim and value.shape[0] == 1 and value.ndim == (1 if field in ("frequency", "phase") else 2):
            flat[field] = value[0]
    return replace(force, **flat) if flat else force


def _rewrapped(scenario: Scenario, controller: Any, i: int) -> Any:
    layers: Sequence[Any] = layers_of(scenario.controller)
    noisy = sum(type(layer) is NoisyMeasurement for layer in layers)
    for layer in reversed(layers):
        changes: dict[str, Any] = {"controller": controller}
        if type(layer) is NoisyMeasurement:
            noisy -= 1
            changes["seed"] = _noise_seed(scenario, noisy, i)
        controller = replace(layer, **changes)
    return controller
