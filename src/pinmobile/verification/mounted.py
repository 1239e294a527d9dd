"""A body that carries arms: Pinocchio's algorithms against each other, the base against the closed form."""

import re

import numpy as np

from pinmobile import closed_form
from pinmobile.arrays import Array
from pinmobile.robot import BODY_JOINT, MobileRobot
from pinmobile.robot.tree import joint_kind
from pinmobile.verification.table import Comparison

__all__ = ["compare_mounted"]

_TOLERANCE = 1e-14  # some dozen roundings, relative to the scale of the terms
_GRAVITY = 9.81  # [m/s^2]


def compare_mounted(robot: MobileRobot, states: int, rng: np.random.Generator) -> tuple[Comparison, ...]:
    """Return the routes of a robot with arms against each other, see `verify`."""
    q = robot.random_configuration(rng, (states,))
    q[:, 2] = rng.uniform(-4 * np.pi, 4 * np.pi, states)
    v, a = rng.normal(size=(2, states, robot.nv))
    M, n, g = robot.mass_matrix(q), robot.nonlinear_effects(q, v), robot.gravity(q)
    tau = robot.inverse_dynamics(q, v, a)
    columns = np.stack([robot.inverse_dynamics(q, 0 * v, unit) - g for unit in np.eye(robot.nv)], axis=-1)
    routes = {
        ("M", "CRBA", "RNEA's columns"): M - columns,
        ("M3", "CRBA", "closed form of the lump"): M[:, :3, :3] - _lumped(robot, q),
        ("n", "RNEA", "C(q, v) v + g(q)"): n - _times(robot.coriolis_matrix(q, v), v) - g,
        ("tau", "RNEA", "M a + n"): tau - _times(M, a) - n,
        ("a", "ABA", "M^-1 (tau - n)"): robot.forward_dynamics(q, v, tau)
        - np.linalg.solve(M, (tau - n)[..., None])[..., 0],
    }
    scales = _scales(robot, q, v, a, M)
    return tuple(
        Comparison(*names, float((np.abs(off) / scales[names[0]]).max()), _TOLERANCE)
        for names, off in routes.items()
    )


def _scales(robot: MobileRobot, q: Array, v: Array, a: Array, M: Array) -> dict[str, Array]:
    """Return the size of the terms that each quantity is the sum of.

    A joint feels the material beyond it, of mass m and second moment J = int |r|^2 dm about its origin: by
    Cauchy and Schwarz at most sqrt(m K) times the acceleration of the material, with K = J where it turns and
    m where it slides, and what two joints exchange is at most sqrt(K_i K_j).
    """
    masses, K, reach = _beyond(robot, q)
    speed = robot.nv * np.square(v).sum(-1) * reach
    push = np.sqrt(robot.nv * np.square(a).sum(-1)) * reach
    felt = np.sqrt(masses * K)
    pair = np.sqrt(K[..., :, None] * K[..., None, :])
    tau = felt * (_GRAVITY + push + speed)[:, None]
    return {
        "M": pair + _GRAVITY * felt[..., None],
        "M3": pair[:, :3, :3],
        "n": felt * (_GRAVITY + speed)[:, None],
        "tau": tau,
        "a": _times(np.abs(np.linalg.inv(M)), tau),
    }


def _beyond(robot: MobileRobot, q: Array) -> tuple[Array, Array, Array]:
    """Return m and K of each coordinate, shape (nv,) and (n, nv), and the robot's reach (n,) [m]."""
    model, frames = robot.model, robot.frame_placements(q)
    bodies = list(model.inertias)[1:]
    levers = np.stack([np.append(body.lever, 1.0) for body in bodies])
    coms = np.einsum("nkij,kj->nki", frames, levers)[..., :3]
    origins = frames[..., :3, 3]
    mass = np.array([body.mass for body in bodies])
    spread = np.array([np.trace(body.inertia) / 2 for body in bodies])
    masses, K = np.zeros(robot.nv), np.zeros((len(q), robot.nv))
    for joint in range(1, model.njoints):
        own = slice(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint])
        beyond = np.array(list(model.subtrees[joint])) - 1
        distance = np.square(coms[:, beyond] - origins[:, joint - 1, None]).sum(-1)
        masses[own] = mass[beyond].sum()
        slides = re.match("JointModel(P[XYZ]|Prismatic)", joint_kind(model, joint))
        moment = distance @ mass[beyond] + spread[beyond].sum()
        K[:, own] = masses[own] if slides else moment[:, None]
    body = origins[:, BODY_JOINT - 1, None]
    reach = np.maximum(1.0, np.linalg.norm(np.concatenate([coms, origins], axis=1) - body, axis=-1).max(-1))
    return masses, K, reach


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
