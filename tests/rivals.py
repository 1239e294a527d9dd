"""Loops and controllers for a wrong model, and what an independent implementation of them comes to."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import pinmobile as pm
from pinmobile.forces import PayloadForce

NOMINAL = pm.MobileRobot(mass=30.0, yaw_inertia=1.3, com=(0.1, 0.05))
"""The robot in which all controllers believe."""
HEAVY, OFF = pm.MobileRobot(36.0, 1.56, (0.1, 0.05)), pm.MobileRobot(30.0, 1.3, (0.2, -0.05))
ARM = pm.MobileRobot.box().mount("ur5")
CIRCLE, SHORT = (pm.Tangent(pm.Circle(radius=1.5, rate=0.6, duration=seconds)) for seconds in (30.0, 2.0))
LAW = "controller.controller.controller"  # in the delay and the noise of a measurement

_FRICTION = {
    "forces.viscous": pm.ViscousFriction((10.0, 20.0, 2.0)),
    "forces.rolling": pm.RollingResistance((6.0, 9.0, 1.0), 0.01),
}
_NOISE = {"controller.controller.std_q": 1e-3, "controller.controller.std_v": 1e-2}
CASES: Mapping[str, Mapping[str, Any]] = {
    "friction": _FRICTION,
    "delay": {"robot": HEAVY, "controller.samples": 3},
    "noise": {"robot": HEAVY, **_NOISE},
    "all": {
        "robot": pm.MobileRobot(36.0, 1.3, (0.15, 0.0)),
        "controller.samples": 1,
        "forces.push": pm.ConstantForce((0.0, -40.0, 0.0), 22.0, 24.0),
        **_FRICTION,
        "forces.payload": PayloadForce(10.0, (0.25, 0.1), 15.0),
        **_NOISE,
    },
}
# Largest distance after 5 s [mm], and the chatter where there is noise [N/s].
PUBLISHED = {
    "PD": ("113 inf 148 421", 137),
    "computed torque": ("36.8 27.2 7.64 115", 282),
    "PID": ("6.42 27.9 2.08 31.7", 455),
    "adaptive": ("36.4 27.4 5.37 104", 295),
    "adaptive, friction": ("1.51 27.9 2.83 44.3", 305),
    "sliding mode": ("4.30 27.0 1.82 6.82", 1586),
    "super-twisting": (".017 27.5 1.65 22.9", 1118),
    "observer": ("2.18 27.5 2.24 23.9", 640),
    "ADRC": ("3.81 27.9 1.73 35.9", 407),
    "LQR": ("27.8 27.4 6.61 91.4", 275),
}


_TORQUE, _GAIN = pm.ComputedTorque(NOMINAL, 16.0, 8.0), (120.0, 120.0, 6.0)
RIVALS: dict[str, Any] = {
    "PD": pm.PD(120.0, 120.0),
    "computed torque": _TORQUE,
    "PID": pm.PID(NOMINAL),
    "adaptive": pm.Adaptive(NOMINAL, kd=_GAIN),
    "adaptive, friction": pm.Adaptive(NOMINAL, kd=_GAIN, friction=True),
    "sliding mode": pm.SlidingMode(NOMINAL),
    "super-twisting": pm.SuperTwisting(NOMINAL),
    "observer": pm.DisturbanceObserver(_TORQUE, NOMINAL),
    "ADRC": pm.ADRC(NOMINAL),
    "LQR": pm.LQR(NOMINAL),
}
"""Controllers that believe in `NOMINAL`, with their usual gains."""


def swept(path: Path) -> pm.Sweep:
    """Return all controllers in all cases."""
    measured = pm.MeasurementDelay(pm.MeasurementNoise(pm.PD(120.0, 120.0), 0.0, 0.0, seed=0), 0)
    parts: dict[str, Any] = {"robot": NOMINAL, "controller": measured, "trajectory": CIRCLE, "spread": {}}
    nominal = pm.Scenario(**parts, n=1, dt=0.01, after=5.0, integrator=pm.rk4)
    return pm.sweep(nominal, path, grid={LAW: RIVALS}, cases=CASES)


def traced(found: Any) -> pm.Rollout:
    """Return the first robot of an ensemble."""
    robot, controller, trajectory, options = found.arguments(0)
    return pm.simulate(robot, controller, trajectory, engine=pm.Engine.COMPILED, **options)


def chatter(run: pm.Rollout) -> float:
    """Return how much the force changes in a second after 5 s, along the axis where that is most [N/s]."""
    late = run.t >= 5.0 - 1e-9
    return float(np.abs(np.diff(run.u[late, :2], axis=0)).sum(axis=0).max() / (run.t[-1] - run.t[late][0]))


def differs(found: float, printed: str, share: float) -> bool:
    """Tell whether a number is not the published one."""
    if np.isinf(found) or printed == "inf":
        return not (np.isinf(found) and printed == "inf")
    digit = 10.0 ** -len(printed.partition(".")[2])
    return abs(found - float(printed)) > max(share * float(printed), 0.5 * digit)
