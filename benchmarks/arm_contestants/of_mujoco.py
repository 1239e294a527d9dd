"""MuJoCo: M, n and the acceleration are the engine's, the step is the lecture's."""

from math import remainder, tau

import mujoco
import numpy as np
import pinocchio as pin
from arm_task import KD, KP, ArmTask, empty, references, solved
from task import Log, Run

from arm_contestants import of_pinocchio

# Nothing touches, so no constraints.
MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81" timestep="{dt}"><flag contact="disable" constraint="disable"/></option>
  <worldbody>{body}</worldbody>
</mujoco>
"""


def build(dt: float, bodies: pin.Model | None = None) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the model of the same bodies at the same places."""
    text = MODEL.format(dt=dt, body=_body(bodies or of_pinocchio.build(), 1))
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


def _body(model: pin.Model, joint: int) -> str:
    place, joints = model.jointPlacements[joint], _joint(model, joint)
    # One body with three joints: a moving body without mass is refused.
    while not model.inertias[joint].mass:
        joint += 1
        joints += _joint(model, joint)
    below = "".join(_body(model, k) for k in range(1, model.njoints) if model.parents[k] == joint)
    x, y, z, w = pin.Quaternion(place.rotation).coeffs()
    body = model.inertias[joint]
    full = _text(body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    return (
        f'<body pos="{_text(place.translation)}" quat="{_text((w, x, y, z))}">{joints}'
        f'<inertial pos="{_text(body.lever)}" mass="{body.mass!r}" fullinertia="{full}"/>{below}</body>'
    )


def _joint(model: pin.Model, joint: int) -> str:
    motion = model.joints[joint].createData()
    model.joints[joint].calc(motion, np.zeros(1))
    axis = motion.S.ravel()
    kind, axis = ("hinge", axis[3:]) if np.any(axis[3:]) else ("slide", axis[:3])
    return f'<joint type="{kind}" axis="{_text(axis)}"/>'


def _text(values: object) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def rollout(task: ArmTask) -> Run:
    """Write the state in place, over the engine's own Euler step."""
    step1, step2, rne = mujoco.mj_step1, mujoco.mj_step2, mujoco.mj_rne
    model, data = build(task.dt)
    dt, half = task.dt, task.dt**2 / 2

    def run() -> Log:
        QD, VD, AD = references(task)
        mujoco.mj_resetData(model, data)
        place, rate, acceleration, force = data.qpos, data.qvel, data.qacc, data.qfrc_applied
        Q, V, A, F, E = empty(task)[:5]
        q, v = QD[0], VD[0]
        for k in range(task.samples):
            place[:], rate[:] = q, v
            step1(model, data)
            e = QD[k] - q
            e[2] = remainder(e[2], tau)
            acceleration[:] = AD[k] + KD * (VD[k] - v) + KP * e
            rne(model, data, 1, force)  # M qacc + n
            step2(model, data)
            a = acceleration
            Q[k], V[k], A[k], F[k], E[k] = q, v, a, force, e
            q = q + dt * v + half * a
            v = v + dt * a
        return Log(Q, V, A, F, E)

    return run


def common_rollout(task: ArmTask) -> Run:
    model, data = build(task.dt)
    M = np.zeros((model.nv, model.nv))

    def terms(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        return M, data.qfrc_bias

    return lambda: solved(task, terms)
