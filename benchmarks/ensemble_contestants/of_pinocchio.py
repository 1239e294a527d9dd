"""Pinocchio's rnea and aba in parallel, one call a step; the pool has one model, so all robots are alike."""

import os

import numpy as np
import pinocchio as pin
from contestants.raw_pinocchio import build
from fleet import NOMINAL, Figures, Fleet, Run, Watch, command
from task import Body

FEW = 100  # robots, to whom a thread of their own is worth its start


def rollout(fleet: Fleet) -> Run:
    threads, dt = max(1, min(os.cpu_count() or 1, fleet.n // FEW)), fleet.task.dt
    body = Body(fleet.mass[0], NOMINAL.yaw_inertia, (fleet.com[0], 0.0))
    plants, known = (pin.ModelPool(build(one), threads) for one in (body, NOMINAL))

    def run() -> Figures:
        given, watch = fleet.references(), Watch(fleet, counting=False)
        q, v = np.tile(given[0, :3], (fleet.n, 1)), np.tile(given[0, 3:6], (fleet.n, 1))
        force, a = np.empty((2, fleet.n, 3))
        for k, at in enumerate(given):
            error, wanted = command(at, q, v)
            pin.rneaInParallel(threads, known, q.T, v.T, wanted.T, force.T)
            watch.see(k, error, force)
            pin.abaInParallel(threads, plants, q.T, v.T, force.T, a.T)
            q += dt * v + dt**2 / 2 * a
            v += dt * a
        return watch.figures()

    return run
