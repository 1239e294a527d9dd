"""The hand-derived M and n in numpy, one sample after the other."""

from collections.abc import Callable
from functools import partial
from math import cos, pi, sin
from typing import Any

import numpy as np
from task import (
    GAIN,
    Body,
    Log,
    Run,
    Task,
    empty,
    forward_dynamics,
    mass_matrix,
    nonlinear_effects,
    references,
)


def rollout(task: Task) -> Run:
    body, dt = task.body, task.dt
    (bx, by), m = body.com, body.mass
    M = np.array([[m, 0.0, 0.0], [0.0, m, 0.0], [0.0, 0.0, m * (bx * bx + by * by) + body.yaw_inertia]])
    n = np.zeros(3)
    half = dt * dt / 2

    def run() -> Log:
        log = empty(task)
        QD, VD, AD = references(task)
        q, v = QD[0], VD[0]
        for k in range(task.samples):
            c, s = cos(q[2]), sin(q[2])
            cx, cy = m * (bx * c - by * s), m * (by * c + bx * s)
            M[0, 2] = M[2, 0] = -cy
            M[1, 2] = M[2, 1] = cx
            w = v[2] * v[2]
            n[0], n[1] = -w * cx, -w * cy
            e = QD[k] - q
            e[2] = (e[2] + pi) % (2 * pi) - pi
            ed = VD[k] - v
            force = M @ (AD[k] + GAIN * ed + GAIN * e) + n
            a = np.linalg.solve(M, force - n)
            log.q[k], log.v[k], log.a[k], log.tau[k], log.error[k] = q, v, a, force, e
            q = q + dt * v + half * a
            v = v + dt * a
        return log

    return run


def calls(body: Body) -> dict[str, Callable[..., Any]]:
    def inverse_dynamics(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return mass_matrix(body, q) @ a + nonlinear_effects(body, q, v)

    return {
        "M": partial(mass_matrix, body),
        "n": partial(nonlinear_effects, body),
        "inverse": inverse_dynamics,
        "forward": partial(forward_dynamics, body),
    }
