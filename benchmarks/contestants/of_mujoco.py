"""MuJoCo: M, n and the acceleration are the engine's, the step is the lecture's."""

from collections.abc import Callable
from math import remainder, tau
from typing import Any

import mujoco
import numpy as np
from task import GAIN, Body, Log, Run, Task, chunks, empty, references, split

# One body with three joints: a moving body without mass is refused. Nothing touches, so no constraints.
MODEL = """
<mujoco>
  <option gravity="0 0 0" timestep="{dt}"><flag contact="disable" constraint="disable"/></option>
  <worldbody><body>
    <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>
    <inertial pos="{x} {y} 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
  </body></worldbody>
</mujoco>
"""


def build(body: Body, dt: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    x, y = body.com
    text = MODEL.format(dt=dt, x=x, y=y, mass=body.mass, inertia=body.yaw_inertia)
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


def rollout(task: Task) -> Run:
    """Keep the state in floats and write it in place, over the engine's own Euler step."""
    step1, step2, rne = mujoco.mj_step1, mujoco.mj_step2, mujoco.mj_rne
    model, data = build(task.body, task.dt)
    dt, half = task.dt, task.dt**2 / 2

    def run() -> Log:
        QD, VD, AD = references(task)
        mujoco.mj_resetData(model, data)
        place, rate, acceleration, force = data.qpos, data.qvel, data.qacc, data.qfrc_applied
        place[:], rate[:] = QD[0], VD[0]
        (x, y, psi), (u, w, r) = QD[0].tolist(), VD[0].tolist()
        given, block = np.hstack([QD, VD, AD]), np.empty((task.samples, 15))
        for part in chunks(task):
            rows = []
            for xd, yd, psid, ud, wd, rd, ax, ay, ar in given[part].tolist():
                step1(model, data)
                ex, ey, epsi = xd - x, yd - y, remainder(psid - psi, tau)
                acceleration[0] = ax + GAIN * (ud - u + ex)
                acceleration[1] = ay + GAIN * (wd - w + ey)
                acceleration[2] = ar + GAIN * (rd - r + epsi)
                rne(model, data, 1, force)  # M qacc + n
                step2(model, data)
                bx, by, br = acceleration.tolist()
                rows.append((x, y, psi, u, w, r, bx, by, br, *force.tolist(), ex, ey, epsi))
                x, y, psi = x + dt * u + half * bx, y + dt * w + half * by, psi + dt * r + half * br
                u, w, r = u + dt * bx, w + dt * by, r + dt * br
                place[0], place[1], place[2] = x, y, psi
            block[part] = rows
        return split(block)

    return run


def common_rollout(task: Task) -> Run:
    model, data = build(task.body, task.dt)
    dt, M = task.dt, np.zeros((3, 3))

    def run() -> Log:
        log = empty(task)
        QD, VD, AD = references(task)
        q, v = QD[0], VD[0]
        for k in range(task.samples):
            data.qpos[:], data.qvel[:] = q, v
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, M)
            n = data.qfrc_bias
            e = QD[k] - q
            e[2] = np.arctan2(np.sin(e[2]), np.cos(e[2]))
            force = M @ (AD[k] + GAIN * (VD[k] - v) + GAIN * e) + n
            a = np.linalg.solve(M, force - n)
            log.q[k], log.v[k], log.a[k], log.tau[k], log.error[k] = q, v, a, force, e
            q = q + dt * v + dt**2 / 2 * a
            v = v + dt * a
        return log

    return run


def calls(body: Body) -> dict[str, Callable[..., Any]]:
    model, data = build(body, 0.1)
    q_, v_, a_, force_ = data.qpos, data.qvel, data.qacc, data.qfrc_applied
    M, n = np.zeros((3, 3)), np.zeros(3)

    def mass_matrix(q: np.ndarray) -> np.ndarray:
        q_[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_fullM(model, data, M)
        return M

    def newton_euler(q: np.ndarray, v: np.ndarray, with_acceleration: int) -> np.ndarray:
        q_[:], v_[:] = q, v
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, with_acceleration, n)
        return n

    def nonlinear_effects(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return newton_euler(q, v, 0)

    def inverse_dynamics(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        a_[:] = a
        return newton_euler(q, v, 1)

    def forward_dynamics(q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        q_[:], v_[:], force_[:] = q, v, force
        mujoco.mj_forward(model, data)
        return a_

    return {
        "M": mass_matrix,
        "n": nonlinear_effects,
        "inverse": inverse_dynamics,
        "forward": forward_dynamics,
    }
