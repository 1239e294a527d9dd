"""Some robots of an ensemble: their numbers as arrays."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, affordable
from pinmobile.controllers import PD, ComputedTorque, NoisyMeasurement, gain_matrix
from pinmobile.ensembles.draws import stream
from pinmobile.ensembles.forces import drawn_force
from pinmobile.ensembles.layers import core_of, layers_of
from pinmobile.ensembles.scenario import Scenario
from pinmobile.robot import MobileRobot

__all__ = ["BODY", "Batch", "batch_of", "noise_of", "noise_seed"]

BODY = ("mass", "yaw_inertia", "com_x", "com_y")
"""The parameters of a body, in the order of `Batch.body`."""


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
        Gains of PD, and of computed torque with a model that is known; None of any other controller.
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
    known = type(core) is PD or modelled
    gains = [_gains(name, core, draws, size) if known else None for name in ("kp", "kd")]
    return Batch(
        start=start,
        size=size,
        body=rows(*BODY),
        model=rows(*(f"model_{name}" for name in BODY)) if modelled else None,
        q=scenario.reference.q[0] + offsets[:3].T,
        v=scenario.reference.v[0] + offsets[3:].T,
        kp=gains[0],
        kd=gains[1],
        forces=tuple(
            drawn_force(force, k, draws, scenario.seed, start, size)
            for k, force in enumerate(scenario.forces)
        ),
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


def noise_of(scenario: Scenario, start: int, size: int) -> list[Array]:
    """Return the standard normal numbers of each noisy measurement, the outermost first.

    Parameters
    ----------
    scenario : Scenario
        Whose robots.
    start, size : int
        Index of the first, and how many.

    Returns
    -------
    tables : list of ndarray, shape (size, N + 1, 2, 3)
        For each robot and sample those of q and of v.
    """
    layers = [layer for layer in layers_of(scenario.controller) if type(layer) is NoisyMeasurement]
    samples = len(scenario.t), 2, 3
    affordable(
        f"the noise of {size} robots' measurements at {len(scenario.t):,} samples",
        3.0
        * len(layers)
        * size
        * 6
        * len(scenario.t),  # the numbers, those of the robots one by one, their sum
        "give a larger dt or a shorter duration",
    )
    return [
        np.array(
            [
                np.random.default_rng(noise_seed(scenario, k, i)).standard_normal(samples)
                for i in range(start, start + size)
            ]
        )
        for k in range(len(layers))
    ]


def noise_seed(scenario: Scenario, layer: int, i: int) -> np.random.SeedSequence:
    """Return the seed of robot i's numbers in a noisy measurement, the outermost being layer 0.

    It follows from the ensemble's seed and that of the measurement.
    """
    noisy: Any = [each for each in layers_of(scenario.controller) if type(each) is NoisyMeasurement][layer]
    own = noisy.seed if isinstance(noisy.seed, np.random.SeedSequence) else np.random.SeedSequence(noisy.seed)
    return stream(scenario.seed, f"measurement {layer} of {own.generate_state(4).tolist()}", i)
