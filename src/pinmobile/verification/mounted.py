"""A body that carries arms: Pinocchio against Newton and Euler, itself, machine code, and a closed form."""

import numpy as np

from pinmobile import closed_form
from pinmobile.arrays import Array
from pinmobile.errors import NotTraceable
from pinmobile.robot import MobileRobot
from pinmobile.verification.parts import Parts
from pinmobile.verification.routes import COMPILED, by_machine_code, by_pinocchio, each
from pinmobile.verification.table import Comparison

__all__ = ["compare_mounted"]

_TOLERANCE = 1e-14  # some dozen roundings, relative to the scale of the terms
_GRAVITY = 9.81  # [m/s^2]
_PARTS = "Newton-Euler of the parts"


def compare_mounted(
    robot: MobileRobot, states: int, rng: np.random.Generator
) -> tuple[tuple[Comparison, ...], str]:
    """Return the routes of a robot with arms against each other, see `verify`, and which is missing."""
    q = robot.random_configuration(rng, (states,))
    q[:, 2] = rng.uniform(-4 * np.pi, 4 * np.pi, states)
    v, a = rng.normal(size=(2, states, robot.nv))
    units = [np.broadcast_to(unit, v.shape) for unit in np.eye(robot.nv)]
    tau, g = each(robot.inverse_dynamics, q, v, a), each(robot.gravity, q)
    own = by_pinocchio(robot, q, v, a, tau)
    M, n = own["M"], own["n"]
    columns = np.stack([each(robot.inverse_dynamics, q, 0 * v, unit) - g for unit in units], axis=-1)
    parts, still = Parts(robot, q, v), Parts(robot, q, 0 * v)
    by_parts = [still.forces(unit, gravity=False) for unit in units]
    routes = {
        ("M", "CRBA", _PARTS): M - np.stack(by_parts, axis=-1),
        ("n", "RNEA", _PARTS): n - parts.forces(0 * a),
        ("tau", "RNEA", _PARTS): tau - parts.forces(a),
        ("f", "RNEA", _PARTS): each(robot.ground_wrench, q, v, a) - parts.ground_wrench(a),
        ("M", "CRBA", "RNEA's columns"): M - columns,
        ("M3", "CRBA", "closed form of the lump"): M[:, :3, :3] - _lumped(robot, q),
        ("n", "RNEA", "C(q, v) v + g(q)"): n - _times(each(robot.coriolis_matrix, q, v), v) - g,
        ("tau", "RNEA", "M a + n"): tau - _times(M, a) - n,
        ("a", "ABA", "M^-1 (tau - n)"): own["a"] - np.linalg.solve(M, (tau - n)[..., None])[..., 0],
    }
    missing = ""
    try:
        compiled = by_machine_code(robot, q, v, a, tau)
    except NotTraceable as error:
        missing = f"{COMPILED}: {error.reason}"
    else:
        against = {"M": "CRBA", "n": "RNEA", "tau": "RNEA", "a": "ABA"}
        routes |= {(x, COMPILED, against[x]): compiled[x] - own[x] for x in against}
    scales = _scales(parts, v, a, M)
    rows = (
        Comparison(*names, float((np.abs(off) / scales[names[0]]).max()), _TOLERANCE)
        for names, off in routes.items()
    )
    return tuple(rows), missing


def _scales(parts: Parts, v: Array, a: Array, M: Array) -> dict[str, Array]:
    """Return the size of the terms that each quantity is the sum of.

    A joint feels the material beyond it, of mass m and second moment J = int |r|^2 dm about its origin: by
    Cauchy and Schwarz at most sqrt(m K) times the acceleration of the material, with K = J where it turns and
    m where it slides, and what two joints exchange is at most sqrt(K_i K_j).
    """
    masses, K, reach = parts.beyond()
    reach = np.maximum(1.0, reach)
    speed = parts.nv * np.square(v).sum(-1) * reach
    push = np.sqrt(parts.nv * np.square(a).sum(-1)) * reach
    felt = np.sqrt(masses * K)
    pair = np.sqrt(K[..., :, None] * K[..., None, :])
    accelerated = (_GRAVITY + push + speed)[:, None]
    tau = felt * accelerated
    return {
        "M": pair + _GRAVITY * felt[..., None],
        "M3": pair[:, :3, :3],
        "n": felt * (_GRAVITY + speed)[:, None],
        "tau": tau,
        "f": felt[:, [0, 0, 0, 2, 2, 2]] * accelerated,  # the mass for forces, that about psi for moments
        "a": _times(np.abs(np.linalg.inv(M)), tau),
    }


def _lumped(robot: MobileRobot, q: Array) -> Array:
    """Return the closed form of the robot lumped at each configuration, shape (n, 3, 3)."""
    blocks = []
    for row in q:
        lump = robot.lumped(row)
        com, inertia = lump.com[:2], lump.yaw_inertia
        blocks.append(closed_form.mass_matrix(row[:3], mass=lump.mass, yaw_inertia=inertia, com=com))
    return np.stack(blocks)


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.einsum("...ij,...j->...i", matrices, vectors))
