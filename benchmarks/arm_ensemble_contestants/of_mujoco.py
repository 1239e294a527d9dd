"""mujoco.rollout with a model for each robot, on all processors, under given forces."""

import copy
import os

import mujoco
import numpy as np
import pinocchio as pin
from arm_fleet import DT, LEVER, MIDDLE, TIPS, ArmFleet, built, nominal_forces, references
from fleet import Figures, Run, on_circle
from mujoco.rollout import Rollout

FORCE = mujoco.mjtState.mjSTATE_QFRC_APPLIED.value
WHOLE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
CHUNK = 1000  # robots of one call: the states of all are too many to keep
BASE = 3  # joint that carries the base, the first of the bodies


# Nothing touches, so no constraints.
MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81" timestep="{dt}"><flag contact="disable" constraint="disable"/></option>
  <worldbody>{body}</worldbody>
</mujoco>
"""


def build(dt: float, bodies: pin.Model) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the model of the same bodies at the same places."""
    text = MODEL.format(dt=dt, body=_body(bodies, 1))
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


def rollout(fleet: ArmFleet) -> Run:
    """Make a model for each robot first."""
    task, threads = fleet.task, os.cpu_count() or 1
    models, datas, start = engines(fleet, threads)
    nq, steps = datas[0].qpos.size, task.samples - 1
    given = nominal_forces(task)[:-1]
    pool = Rollout(nthread=threads)

    def run() -> Figures:
        wanted, largest = references(task)[0], np.empty((fleet.n, nq))
        states = np.empty((min(CHUNK, fleet.n), steps, start.size))
        for begin in range(0, fleet.n, CHUNK):
            part = slice(begin, min(begin + CHUNK, fleet.n))
            some = part.stop - begin
            forces = np.repeat(given[None], some, axis=0)
            pool.rollout(
                models[part],
                datas,
                np.repeat(start[None], some, axis=0),
                forces,
                control_spec=FORCE,
                state=states[:some],
            )
            error = wanted[1:] - states[:some, :, 1 : 1 + nq]
            error[..., 2] = on_circle(error[..., 2])
            np.max(np.abs(error, out=error), axis=1, out=largest[part])
        return Figures(largest)

    return run


def engines(fleet: ArmFleet, threads: int) -> tuple[list[mujoco.MjModel], list[mujoco.MjData], np.ndarray]:
    """Return a model for each robot, memory for each thread, and the state in which all start."""
    arm = fleet.task.arm
    bodies = built(arm, 0.0, 0.0)  # their inertias, which do not change with the masses, are in it
    model, data = build(DT, bodies)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP  # the step would be implicit
    tip, models = bodies.frames[bodies.getFrameId(TIPS[arm])], []
    for load, mass, friction in zip(fleet.payload, fleet.mass, fleet.friction, strict=True):
        one = copy.copy(model)
        one.dof_damping[:] = friction
        for joint, place, more, lever in (
            (BASE, pin.SE3.Identity(), mass, MIDDLE),
            (tip.parentJoint, tip.placement, load, LEVER),
        ):
            point = pin.Inertia(more, np.array(lever), np.zeros((3, 3)))
            put(one, joint - BASE + 1, bodies.inertias[joint] + place.act(point))
        mujoco.mj_setConst(one, data)
        models.append(one)
    q, v, _ = references(fleet.task)
    start = np.zeros(mujoco.mj_stateSize(model, WHOLE))
    start[1 : 1 + model.nq], start[1 + model.nq : 1 + model.nq + model.nv] = q[0], v[0]
    return models, [mujoco.MjData(model) for _ in range(threads)], start


def put(model: mujoco.MjModel, body: int, whole: pin.Inertia) -> None:
    """Give a body mass and inertia."""
    moments, axes = np.linalg.eigh(whole.inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    x, y, z, w = pin.Quaternion(axes).coeffs()
    model.body_mass[body], model.body_ipos[body] = whole.mass, whole.lever
    model.body_inertia[body], model.body_iquat[body] = moments, (w, x, y, z)
