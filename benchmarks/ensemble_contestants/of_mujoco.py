"""mujoco.rollout with a model for each robot, on all processors.

In open loop its threads take every step on their own, under torques found beforehand and by the engine's
semi-implicit Euler. In closed loop each call takes one step: numpy finds the torques, and makes the lecture's
step of the engine's velocities.
"""

import copy
import os

import mujoco
import numpy as np
from contestants.of_mujoco import build
from fleet import NOMINAL, Figures, Fleet, Run, Watch, command, on_circle, trajectories
from mujoco.rollout import Rollout

from .of_numpy import dynamics

FORCE = mujoco.mjtState.mjSTATE_QFRC_APPLIED.value
Q, V = slice(1, 4), slice(4, 7)  # of a state; time is first
CHUNK = 1000  # robots of one call in open loop: the states of all are too many to keep


class Engines:
    """A model for each robot, with threads, and the state in which all start."""

    def __init__(self, fleet: Fleet) -> None:
        model, data = build(NOMINAL, fleet.task.dt)
        self.models = []
        for mass, com in zip(fleet.mass, fleet.com, strict=True):
            one = copy.copy(model)
            one.body_mass[1], one.body_ipos[1, 0] = mass, com
            mujoco.mj_setConst(one, data)
            self.models.append(one)
        threads = os.cpu_count() or 1
        self.datas = [mujoco.MjData(model) for _ in range(threads)]
        self.threads = Rollout(nthread=threads)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        self.start = np.zeros((fleet.n, size))
        mujoco.mj_getState(model, data, self.start[0], mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        self.start[:] = self.start[0]
        at = fleet.references()[0]
        self.start[:, Q], self.start[:, V] = at[:3], at[3:6]

    def roll(self, part: slice, start: np.ndarray, forces: np.ndarray, states: np.ndarray) -> None:
        """Take the robots of this part from their states through all their forces, (n, steps, 3)."""
        models = self.models[part]
        self.threads.rollout(models, self.datas, start, forces, control_spec=FORCE, state=states)


def open_loop(fleet: Fleet) -> Run:
    engines, steps = Engines(fleet), fleet.task.samples - 1
    forces = np.ascontiguousarray(trajectories(fleet)[1][:-1].transpose(1, 0, 2))

    def run() -> Figures:
        given, largest = fleet.references()[1:, :3], np.empty((fleet.n, 3))
        states = np.empty((min(CHUNK, fleet.n), steps, engines.start.shape[1]))
        for begin in range(0, fleet.n, CHUNK):
            part = slice(begin, min(begin + CHUNK, fleet.n))
            states = states[: part.stop - begin]
            engines.roll(part, engines.start[part], forces[part], states)
            error = given - states[..., Q]
            error[..., 2] = on_circle(error[..., 2])
            np.max(np.abs(error, out=error), axis=1, out=largest[part])
        return Figures(largest)

    return run


def closed_loop(fleet: Fleet) -> Run:
    engines, dt = Engines(fleet), fleet.task.dt
    known_mass, known_com = np.full(fleet.n, NOMINAL.mass), np.full(fleet.n, NOMINAL.com[0])

    def run() -> Figures:
        watch, before, after = (
            Watch(fleet, counting=False),
            engines.start.copy(),
            engines.start[:, None].copy(),
        )
        q, v = before[:, Q], before[:, V]
        for k, at in enumerate(fleet.references()):
            error, wanted = command(at, q, v)
            M, bias = dynamics(known_mass, known_com, q, v)
            force = (M @ wanted[..., None])[..., 0] + bias
            watch.see(k, error, force)
            engines.roll(slice(None), before, force[:, None], after)
            v_next = after[:, 0, V]
            q += dt / 2 * (v + v_next)
            v[:] = v_next
        return watch.figures()

    return run
