"""Routes that every robot has: Pinocchio, one state at a time, and the machine code that ensembles run."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import Batched, Cache
from pinmobile.robot import MobileRobot
from pinmobile.robot.planar import PlanarBody

__all__ = ["COMPILED", "Dynamics", "by_machine_code", "by_pinocchio", "each"]

Dynamics = dict[str, Array]
"""M, n, tau for an acceleration, and a for a force, by their letters, of n states."""

COMPILED = "compiled for ensembles"


def each(function: Callable[..., Array], *states: Array) -> Array:
    """Return what a function gives for one state after the other; many at once may be machine code."""
    return np.stack([function(*state) for state in zip(*states, strict=True)])


def by_pinocchio(robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    """Return the dynamics by CRBA, RNEA and ABA."""
    return {
        "M": each(robot.mass_matrix, q),
        "n": each(robot.nonlinear_effects, q, v),
        "tau": each(robot.inverse_dynamics, q, v, a),
        "a": each(robot.forward_dynamics, q, v, tau),
    }


def by_machine_code(robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    """Return the dynamics by the laws that ensembles compile.

    Raises
    ------
    NotTraceable
        If they do not: a joint has several coordinates, or the joints are too many.
    """
    states = q, v, a, tau
    if robot.mounts:
        body, sizes = robot.varying(()).traced(), [(x.shape[1],) for x in states]
        # What has all its numbers built in serves nobody else: its file would take another's place.
        found = Batched(lambda *given: _dynamics(body, *given), sizes, cache=Cache(""))(*states)
    else:
        bare = robot.lumped() if robot.loads else robot
        numbers = np.array([bare.mass, bare.body.yaw_inertia, *bare.com[:2]])
        found = _planar()(numbers, *states)
    return dict(zip(("M", "n", "tau", "a"), found, strict=True))


@lru_cache(maxsize=1)
def _planar() -> Batched:
    """Return the dynamics of a body without arms, whose four numbers are the first argument."""
    return Batched(lambda numbers, *given: _dynamics(PlanarBody(*numbers), *given), [(4,), *[(3,)] * 4])


def _dynamics(body: Any, q: Any, v: Any, a: Any, tau: Any) -> tuple[Any, ...]:
    return (
        body.mass_matrix(q),
        body.nonlinear_effects(q, v),
        body.inverse_dynamics(q, v, a),
        body.forward_dynamics(q, v, tau),
    )
