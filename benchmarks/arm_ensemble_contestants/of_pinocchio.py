"""Pinocchio: a tight loop over one robot, and rnea and aba in parallel, one call a step, for many."""

import os
from math import remainder, tau

import numpy as np
import pinocchio as pin
from arm_fleet import DT, KD, KP, ArmFleet, built, references
from fleet import Figures, Run, on_circle

FEW = 100  # robots, to whom a thread of their own is worth its start


def one_by_one(fleet: ArmFleet) -> Run:
    """Loop over the robots, each by rnea and aba; a sample's errors and forces are judged at the end."""
    arm, task = fleet.task.arm, fleet.task
    known = built(arm)
    plants = [built(arm, *numbers) for numbers in zip(fleet.payload, fleet.mass, strict=True)]
    memory, memories = known.createData(), [plant.createData() for plant in plants]
    rnea, aba, half = pin.rnea, pin.aba, DT * DT / 2

    def run() -> Figures:
        QD, VD, AD = references(task)
        largest, strongest = np.empty((2, fleet.n, known.nv))
        E, F = np.empty((2, task.samples, known.nv))
        for i, (plant, data, c) in enumerate(zip(plants, memories, fleet.friction, strict=True)):
            q, v = QD[0], VD[0]
            for k in range(task.samples):
                e = QD[k] - q
                e[2] = remainder(e[2], tau)
                force = rnea(known, memory, q, v, AD[k] + KD * (VD[k] - v) + KP * e)
                a = aba(plant, data, q, v, force - c * v)
                E[k], F[k] = e, force
                q = q + DT * v + half * a
                v = v + DT * a
            largest[i], strongest[i] = np.abs(E).max(axis=0), np.abs(F).max(axis=0)
        return Figures(largest, None, strongest)

    return run


def rollout(fleet: ArmFleet) -> Run:
    """Call both in parallel for all robots: the pool has one model, so all are alike but for friction."""
    task, threads = fleet.task, max(1, min(os.cpu_count() or 1, fleet.n // FEW))
    known = built(task.arm)
    plant = built(task.arm, fleet.payload[0], fleet.mass[0])
    plants, models = pin.ModelPool(plant, threads), pin.ModelPool(known, threads)
    friction = fleet.friction[:, None]

    def run() -> Figures:
        QD, VD, AD = references(task)
        q, v = np.tile(QD[0], (fleet.n, 1)), np.tile(VD[0], (fleet.n, 1))
        force, a, largest, strongest = np.zeros((4, fleet.n, known.nv))
        for k in range(task.samples):
            e = QD[k] - q
            e[:, 2] = on_circle(e[:, 2])
            wanted = AD[k] + KD * (VD[k] - v) + KP * e
            pin.rneaInParallel(threads, models, q.T, v.T, wanted.T, force.T)
            np.maximum(largest, np.abs(e), out=largest)
            np.maximum(strongest, np.abs(force), out=strongest)
            pin.abaInParallel(threads, plants, q.T, v.T, (force - friction * v).T, a.T)
            q += DT * v + DT * DT / 2 * a
            v += DT * a
        return Figures(largest, None, strongest)

    return run
