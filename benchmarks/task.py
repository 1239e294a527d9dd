"""The work that every contestant does, its numbers, and the check that a contestant has done it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from math import remainder, tau
from typing import Any, NamedTuple

import numpy as np

RADIUS = 3.0  # of the circle [m]
RATE = 0.1  # along the circle [rad/s]
GAIN = 4.0  # kp = kd of computed torque
PD_GAINS = np.array([120.0, 120.0, 0.4])  # kp = kd of PD
TOLERANCE = 1e-9  # of every logged quantity, on the scale of its largest value or 1


@dataclass(frozen=True)
class Body:
    """The moving body: mass [kg], yaw inertia about the centre of mass [kg m^2], its place [m]."""

    mass: float = 30.0
    yaw_inertia: float = 0.1
    com: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Task:
    """One closed-loop rollout along the circle, started on it.

    Attributes
    ----------
    dt, duration : float
        Step and length [s].
    control : str
        ``"computed torque"``, ``"PD"``, or ``"own law"``: the same PD, written by the user.
    step : str
        ``"lecture"`` (constant acceleration) or ``"rk4"``, the force held over dt in both.
    """

    dt: float
    duration: float = 60.0
    control: str = "computed torque"
    step: str = "lecture"
    body: Body = Body()

    @property
    def samples(self) -> int:
        """Number of samples, the last included."""
        return round(self.duration / self.dt) + 1

    def offset(self) -> "Task":
        """Return the task with the centre of mass off the axis: here M and n vary, so wrong ones show.

        PD knows nothing of the offset, and further out is unstable at the lecture's step.
        """
        com = (0.1, 0.05) if self.control == "computed torque" else (0.02, 0.01)
        return replace(self, body=replace(self.body, com=com))


class Log(NamedTuple):
    """What a contestant records, (samples, 3) each; those that time or weigh themselves say the result."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    error: np.ndarray
    seconds: float | None = None
    peak: float | None = None  # resident memory [MiB]


Run = Callable[[], Log]


def empty(task: Task) -> Log:
    """Return arrays to log into."""
    return Log(*np.empty((5, task.samples, 3)))


def chunks(task: Task, size: int = 512) -> Iterator[slice]:
    """Return the samples in parts, so that what is kept in floats stays small."""
    return (slice(begin, min(begin + size, task.samples)) for begin in range(0, task.samples, size))


def split(block: np.ndarray) -> Log:
    """Return the log of rows of fifteen numbers."""
    return Log(*block.reshape(-1, 5, 3).transpose(1, 0, 2).copy())


def references(task: Task) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return q, v and a of the reference at every sample: the circle, heading along its tangent."""
    t = np.arange(task.samples) * task.dt
    angle = RATE * t
    c, s = np.cos(angle), np.sin(angle)
    zero = np.zeros_like(t)
    q = np.column_stack([RADIUS * s, RADIUS - RADIUS * c, angle])
    v = np.column_stack([RADIUS * RATE * c, RADIUS * RATE * s, np.full_like(t, RATE)])
    a = np.column_stack([-RADIUS * RATE**2 * s, RADIUS * RATE**2 * c, zero])
    return q, v, a


def mass_matrix(body: Body, q: np.ndarray) -> np.ndarray:
    """Return M(q) as derived by hand."""
    (bx, by), m = body.com, body.mass
    c, s = np.cos(q[2]), np.sin(q[2])
    mx, my = -m * (by * c + bx * s), m * (bx * c - by * s)
    return np.array([[m, 0.0, mx], [0.0, m, my], [mx, my, m * (bx * bx + by * by) + body.yaw_inertia]])


def nonlinear_effects(body: Body, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return n(q, v) as derived by hand."""
    (bx, by), m = body.com, body.mass
    c, s = np.cos(q[2]), np.sin(q[2])
    return -m * v[2] ** 2 * np.array([bx * c - by * s, by * c + bx * s, 0.0])


def forward_dynamics(body: Body, q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return M(q)^-1 (tau - n(q, v))."""
    return np.linalg.solve(mass_matrix(body, q), force - nonlinear_effects(body, q, v))


@lru_cache(maxsize=8)
def expected(task: Task) -> Log:
    """Return what must come out: the recurrence in closed form, one sample after the other."""
    body, dt, log = task.body, task.dt, empty(task)
    desired = references(task)
    q, v = desired[0][0], desired[1][0]

    def accelerated(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return forward_dynamics(body, q, v, force)

    for k, (qd, vd, ad) in enumerate(zip(*desired, strict=True)):
        e, ed = qd - q, vd - v
        e[2] = remainder(e[2], tau)
        if task.control == "computed torque":
            command = ad + GAIN * ed + GAIN * e
            force = mass_matrix(body, q) @ command + nonlinear_effects(body, q, v)
        else:
            force = PD_GAINS * e + PD_GAINS * ed
        a = accelerated(q, v)
        log.q[k], log.v[k], log.a[k], log.tau[k], log.error[k] = q, v, a, force, e
        q, v = stepped(accelerated, q, v, dt, task.step)
    return log


def stepped(accelerated: Callable[..., np.ndarray], q: Any, v: Any, h: float, step: str) -> tuple[Any, Any]:
    """Return the state after a step of h: ``"lecture"``, ``"euler"`` (semi-implicit) or ``"rk4"``."""
    a = accelerated(q, v)
    if step == "lecture":
        return q + h * v + h * h / 2 * a, v + h * a
    if step == "euler":
        return q + h * (v + h * a), v + h * a
    b = accelerated(q + h / 2 * v, v + h / 2 * a)
    c = accelerated(q + h / 2 * (v + h / 2 * a), v + h / 2 * b)
    d = accelerated(q + h * (v + h / 2 * b), v + h * c)
    return q + h * v + h * h / 6 * (a + b + c), v + h / 6 * (a + 2 * b + 2 * c + d)


def difference(log: Log, right: Log) -> float:
    """Return the largest difference, each quantity on its scale; infinite for other shapes and NaN."""
    pairs = list(zip(log[:5], right[:5], strict=True))
    if any(np.shape(one) != other.shape for one, other in pairs):
        return np.inf
    if not all(np.isfinite(one).all() for one, _ in pairs):
        return np.inf
    return float(max(np.max(np.abs(one - other)) / max(1.0, np.max(np.abs(other))) for one, other in pairs))
