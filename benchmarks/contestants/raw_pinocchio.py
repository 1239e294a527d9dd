"""Pinocchio without pinmobile: a loop as tight as a good user writes it, the fastest found, a common one."""

from collections.abc import Callable
from math import remainder, tau
from typing import Any

import numpy as np
import pinocchio as pin
from task import GAIN, PD_GAINS, Body, Log, Run, Task, chunks, empty, references, split


def build(body: Body) -> pin.Model:
    """Return the planar chain x, y, psi with plain angles, and the body at its end."""
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    joint = 0
    for kind, name in ((pin.JointModelPX(), "x"), (pin.JointModelPY(), "y"), (pin.JointModelRZ(), "psi")):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    about_com = np.diag([1.0, 1.0, body.yaw_inertia])
    inertia = pin.Inertia(body.mass, np.array([*body.com, 0.0]), about_com)
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return model


def rollout(task: Task) -> Run:
    loop = _rk4 if task.step == "rk4" else _computed_torque if task.control == "computed torque" else _pd
    model = build(task.body)
    data = model.createData()
    return lambda: loop(task, model, data)


def _computed_torque(task: Task, model: pin.Model, data: pin.Data) -> Log:
    rnea, aba = pin.rnea, pin.aba
    dt, half = task.dt, task.dt**2 / 2
    QD, VD, AD = references(task)
    Q, V, A, F, E = empty(task)[:5]
    q, v = QD[0], VD[0]
    for k in range(task.samples):
        e = QD[k] - q
        e[2] = remainder(e[2], tau)
        force = rnea(model, data, q, v, AD[k] + GAIN * (VD[k] - v + e))
        a = aba(model, data, q, v, force)
        Q[k], V[k], A[k], F[k], E[k] = q, v, a, force, e
        q = q + dt * v + half * a
        v = v + dt * a
    return Log(Q, V, A, F, E)


def _pd(task: Task, model: pin.Model, data: pin.Data) -> Log:
    aba = pin.aba
    dt, half, gains = task.dt, task.dt**2 / 2, PD_GAINS
    QD, VD, _ = references(task)
    Q, V, A, F, E = empty(task)[:5]
    q, v = QD[0], VD[0]
    for k in range(task.samples):
        e = QD[k] - q
        e[2] = remainder(e[2], tau)
        force = gains * (VD[k] - v + e)
        a = aba(model, data, q, v, force)
        Q[k], V[k], A[k], F[k], E[k] = q, v, a, force, e
        q = q + dt * v + half * a
        v = v + dt * a
    return Log(Q, V, A, F, E)


def _rk4(task: Task, model: pin.Model, data: pin.Data) -> Log:
    rnea, aba = pin.rnea, pin.aba
    dt, half, sixth = task.dt, task.dt / 2, task.dt / 6
    QD, VD, AD = references(task)
    Q, V, A, F, E = empty(task)[:5]
    q, v = QD[0], VD[0]
    for k in range(task.samples):
        e = QD[k] - q
        e[2] = remainder(e[2], tau)
        force = rnea(model, data, q, v, AD[k] + GAIN * (VD[k] - v + e))
        a = aba(model, data, q, v, force)
        Q[k], V[k], A[k], F[k], E[k] = q, v, a, force, e
        v2 = v + half * a
        a2 = aba(model, data, q + half * v, v2, force)
        v3 = v + half * a2
        a3 = aba(model, data, q + half * v2, v3, force)
        v4 = v + dt * a3
        a4 = aba(model, data, q + dt * v3, v4, force)
        q = q + sixth * (v + 2 * (v2 + v3) + v4)
        v = v + sixth * (a + 2 * (a2 + a3) + a4)
    return Log(Q, V, A, F, E)


def fastest_rollout(task: Task) -> Run:
    """Keep the state in floats, and write it into the arrays that Pinocchio takes."""
    rnea, aba = pin.rnea, pin.aba
    model = build(task.body)
    data = model.createData()
    dt, half = task.dt, task.dt**2 / 2
    place, rate, command = np.empty(3), np.empty(3), np.empty(3)

    def run() -> Log:
        QD, VD, AD = references(task)
        (x, y, psi), (u, w, r) = QD[0].tolist(), VD[0].tolist()
        given, block = np.hstack([QD, VD, AD]), np.empty((task.samples, 15))
        for part in chunks(task):
            rows = []
            for xd, yd, psid, ud, wd, rd, ax, ay, ar in given[part].tolist():
                place[0], place[1], place[2] = x, y, psi
                rate[0], rate[1], rate[2] = u, w, r
                ex, ey, epsi = xd - x, yd - y, remainder(psid - psi, tau)
                command[0] = ax + GAIN * (ud - u + ex)
                command[1] = ay + GAIN * (wd - w + ey)
                command[2] = ar + GAIN * (rd - r + epsi)
                force = rnea(model, data, place, rate, command)
                bx, by, br = aba(model, data, place, rate, force).tolist()
                rows.append((x, y, psi, u, w, r, bx, by, br, *force.tolist(), ex, ey, epsi))
                x, y, psi = x + dt * u + half * bx, y + dt * w + half * by, psi + dt * r + half * br
                u, w, r = u + dt * bx, w + dt * by, r + dt * br
            block[part] = rows
        return split(block)

    return run


def common_rollout(task: Task) -> Run:
    model = build(task.body)
    data = model.createData()
    dt, Kp, Kd = task.dt, GAIN * np.eye(3), GAIN * np.eye(3)

    def run() -> Log:
        log = empty(task)
        QD, VD, AD = references(task)
        q, v = QD[0].copy(), VD[0].copy()
        for k in range(task.samples):
            e = QD[k] - q
            e[2] = np.arctan2(np.sin(e[2]), np.cos(e[2]))
            M = pin.crba(model, data, q)
            n = pin.nle(model, data, q, v)
            force = M @ (AD[k] + Kd @ (VD[k] - v) + Kp @ e) + n
            a = np.linalg.solve(M, force - n)
            log.q[k], log.v[k], log.a[k], log.tau[k], log.error[k] = q, v, a, force, e
            q = q + v * dt + 0.5 * a * dt**2
            v = v + a * dt
        return log

    return run


def calls(body: Body) -> dict[str, Callable[..., Any]]:
    model = build(body)
    data = model.createData()
    return {
        "M": lambda q: pin.crba(model, data, q),
        "n": lambda q, v: pin.nle(model, data, q, v),
        "inverse": lambda q, v, a: pin.rnea(model, data, q, v, a),
        "forward": lambda q, v, force: pin.aba(model, data, q, v, force),
    }
