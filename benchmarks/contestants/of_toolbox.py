"""Robotics Toolbox for Python: a Denavit-Hartenberg chain, and `rne` and `accel` on it."""

from collections.abc import Callable
from math import pi, remainder, tau
from typing import Any

import numpy as np
from roboticstoolbox import DHRobot, PrismaticDH, RevoluteDH
from spatialmath import SE3
from task import GAIN, Body, Log, Run, Task, empty, references

ORDER = [1, 0, 2]  # the chain is (y, x, psi)


def build(body: Body) -> DHRobot:
    """Return the chain in standard DH.

    The lecture's own table is modified DH. Of it, the toolbox's compiled `rne` (1.5.0) counts nothing
    for the acceleration along a first prismatic joint; its `rne_python` and standard DH are right.
    """
    inertia = np.diag([1.0, 1.0, body.yaw_inertia])
    links = [
        PrismaticDH(theta=0.0, alpha=-pi / 2),
        PrismaticDH(theta=-pi / 2, alpha=-pi / 2),
        RevoluteDH(offset=-pi / 2, m=body.mass, r=[*body.com, 0.0], I=inertia),
    ]
    y_up = SE3.Rt(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]))
    return DHRobot(links, gravity=[0.0, 0.0, 0.0], base=y_up)


def rollout(task: Task) -> Run:
    robot = build(task.body)
    dt, half = task.dt, task.dt**2 / 2

    def run() -> Log:
        QD, VD, AD = (reference[:, ORDER] for reference in references(task))
        Q, V, A, F, E = empty(task)[:5]
        q, v = QD[0], VD[0]
        for k in range(task.samples):
            e = QD[k] - q
            e[2] = remainder(e[2], tau)
            force = robot.rne(q, v, AD[k] + GAIN * (VD[k] - v + e))
            a = robot.accel(q, v, force)
            Q[k], V[k], A[k], F[k], E[k] = q, v, a, force, e
            q = q + dt * v + half * a
            v = v + dt * a
        return Log(*(logged[:, ORDER] for logged in (Q, V, A, F, E)))

    return run


def calls(body: Body) -> dict[str, Callable[..., Any]]:
    robot, zero = build(body), np.zeros(3)
    grid = np.ix_(ORDER, ORDER)
    return {
        "M": lambda q: robot.inertia(q[ORDER])[grid],
        "n": lambda q, v: robot.rne(q[ORDER], v[ORDER], zero)[ORDER],
        "inverse": lambda q, v, a: robot.rne(q[ORDER], v[ORDER], a[ORDER])[ORDER],
        "forward": lambda q, v, force: robot.accel(q[ORDER], v[ORDER], force[ORDER])[ORDER],
    }
