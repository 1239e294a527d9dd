"""Pinocchio without pinmobile: a loop as tight as a good user writes it, and a common one."""

from math import remainder, tau

import numpy as np
import pinocchio as pin
from arm_task import AT, KD, KP, MASS, SIZE, ArmTask, Terms, empty, references, solved
from example_robot_data import load
from task import Log, Run


def build() -> pin.Model:
    """Return the planar chain x, y, psi with plain angles, the box at its end, and the UR5 on it."""
    model = pin.Model()
    joint = 0
    for kind, name in ((pin.JointModelPX(), "x"), (pin.JointModelPY(), "y"), (pin.JointModelRZ(), "psi")):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    middle = pin.SE3(np.eye(3), np.array([0.0, 0.0, SIZE[2] / 2]))
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(MASS, *SIZE), middle)
    frame = model.addFrame(pin.Frame("body", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    place = pin.SE3(pin.utils.rotate("z", AT[3]), np.array(AT[:3]))
    return pin.appendModel(model, load("ur5").model, frame, place)


def rollout(task: ArmTask) -> Run:
    rnea, aba, dt, half = pin.rnea, pin.aba, task.dt, task.dt**2 / 2
    model = build()
    data = model.createData()

    def run() -> Log:
        QD, VD, AD = references(task)
        Q, V, A, F, E = empty(task)[:5]
        q, v = QD[0], VD[0]
        for k in range(task.samples):
            e = QD[k] - q
            e[2] = remainder(e[2], tau)
            force = rnea(model, data, q, v, AD[k] + KD * (VD[k] - v) + KP * e)
            a = aba(model, data, q, v, force)
            Q[k], V[k], A[k], F[k], E[k] = q, v, a, force, e
            q = q + dt * v + half * a
            v = v + dt * a
        return Log(Q, V, A, F, E)

    return run


def terms() -> Terms:
    """Return what gives M(q) and n(q, v)."""
    model = build()
    data = model.createData()
    return lambda q, v: (pin.crba(model, data, q), pin.nle(model, data, q, v))


def common_rollout(task: ArmTask) -> Run:
    made = terms()
    return lambda: solved(task, made)
