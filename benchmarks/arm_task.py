"""A UR5 on a base that drives a circle: the work of every contestant, and the check that it has been done."""

from collections.abc import Callable
from dataclasses import dataclass
from math import remainder, tau

import numpy as np
from task import Log

KP, KD = 100.0, 20.0  # of computed torque
RADIUS, RATE = 1.0, 0.5  # of the circle [m], [rad/s]
WAY, PERIOD = 0.5, 6.0  # every joint goes so far and back [rad], [s]
MASS, SIZE = 30.0, (0.6, 0.4, 0.2)  # of the base, a homogeneous box on the ground [kg], [m]
AT = (0.1, -0.05, 0.2, 0.4)  # where the arm stands on it: x, y, z, yaw [m, m, m, rad]
SIZE_V = 9  # x, y, psi and six joints

Terms = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From q and v to M(q) and n(q, v)."""


@dataclass(frozen=True)
class ArmTask:
    """One rollout of computed torque for the whole, started on the reference, with the lecture's step."""

    dt: float = 0.001
    duration: float = PERIOD

    @property
    def samples(self) -> int:
        """Number of samples, the last included."""
        return round(self.duration / self.dt) + 1


def empty(task: ArmTask) -> Log:
    """Return arrays to log into, (samples, 9) each."""
    return Log(*np.empty((5, task.samples, SIZE_V)))


def references(task: ArmTask) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return q, v and a at every sample: the circle along its tangent, a cubic to `WAY` and one back."""
    t = np.arange(task.samples) * task.dt
    angle, half = RATE * t, PERIOD / 2
    c, s = np.cos(angle), np.sin(angle)
    base = (
        (RADIUS * s, RADIUS - RADIUS * c, angle),
        (RADIUS * RATE * c, RADIUS * RATE * s, np.full_like(t, RATE)),
        (-RADIUS * RATE**2 * s, RADIUS * RATE**2 * c, np.zeros_like(t)),
    )
    back = t >= half
    part, sign = np.where(back, PERIOD - t, t) / half, np.where(back, -1.0, 1.0)
    joint = (
        WAY * (3 - 2 * part) * part**2,
        sign * WAY * 6 * (1 - part) * part / half,
        WAY * (6 - 12 * part) / half**2,
    )
    q, v, a = (np.column_stack([*b, *[j] * (SIZE_V - 3)]) for b, j in zip(base, joint, strict=True))
    return q, v, a


def solved(task: ArmTask, terms: Terms) -> Log:
    """Return the rollout by the mass matrix and a linear solve."""
    dt, log = task.dt, empty(task)
    QD, VD, AD = references(task)
    q, v = QD[0], VD[0]
    for k in range(task.samples):
        e = QD[k] - q
        e[2] = remainder(e[2], tau)
        M, n = terms(q, v)
        force = M @ (AD[k] + KD * (VD[k] - v) + KP * e) + n
        a = np.linalg.solve(M, force - n)
        log.q[k], log.v[k], log.a[k], log.tau[k], log.error[k] = q, v, a, force, e
        q = q + dt * v + dt**2 / 2 * a
        v = v + dt * a
    return log
