"""One robot of an ensemble, as the arguments of `simulate`."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.controllers import NoisyMeasurement
from pinmobile.ensembles.batch import BODY, batch_of, noise_seed
from pinmobile.ensembles.forces import force_of_one
from pinmobile.ensembles.layers import core_of, layers_of
from pinmobile.ensembles.probing import fresh
from pinmobile.ensembles.scenario import Scenario
from pinmobile.robot import MobileRobot
from pinmobile.urdf import Body

__all__ = ["Member", "member_of"]


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
    if any(name in draws for name in BODY):
        robot = _robot(robot, batch.body)
    core: Any = core_of(scenario.controller)
    changes: dict[str, Any] = {}
    for name, gain in (("kp", batch.kp), ("kd", batch.kd)):
        if gain is not None and gain.ndim == 3:
            changes[name] = gain[0]
    if batch.model is not None and any(name.startswith("model_") for name in draws):
        changes["robot"] = _robot(core.robot, batch.model)
    controller = replace(core, **changes) if changes else fresh(core)
    options = {
        "dt": scenario.dt,
        "duration": scenario.duration,
        "q0": batch.q[0],
        "v0": batch.v[0],
        "integrator": scenario.integrator,
        "substeps": scenario.substeps,
        "forces": tuple(force_of_one(force) for force in batch.forces),
        "limit": scenario.limit,
    }
    return Member(robot, _rewrapped(scenario, controller, i), scenario.trajectory, options)


def _robot(robot: MobileRobot, body: Array) -> MobileRobot:
    mass, inertia, x, y = body[:, 0].tolist()
    com = np.array([x, y, robot.com[2]])
    return robot.with_body(Body(mass, com, np.diag([inertia] * 3)), "drawn for an ensemble")


def _rewrapped(scenario: Scenario, controller: Any, i: int) -> Any:
    layers: Sequence[Any] = layers_of(scenario.controller)
    noisy = sum(type(layer) is NoisyMeasurement for layer in layers)
    for layer in reversed(layers):
        changes: dict[str, Any] = {"controller": controller}
        if type(layer) is NoisyMeasurement:
            noisy -= 1
            changes["seed"] = noise_seed(scenario, noisy, i)
        controller = replace(layer, **changes)
    return controller
