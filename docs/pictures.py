"""Take the pictures of README: ``python docs/pictures.py``. Needs a Chromium."""

from __future__ import annotations

from pathlib import Path

from pinmobile import (
    PD,
    Circle,
    ComputedTorque,
    MobileRobot,
    Spline,
    Tangent,
    WholeBody,
    rk4,
    simulate,
)
from pinmobile.controllers import Decoupled
from pinmobile.viewer import Viewer

HERE = Path(__file__).parent


def circle() -> None:
    """Show the first loop of README."""
    robot = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
    way = Tangent(Circle(radius=3, rate=0.1, duration=60))
    laws = {"PD": PD(kp=120, kd=120), "computed torque": ComputedTorque(robot, kp=4, kd=4)}
    runs = {name: simulate(robot, law, way, dt=0.01) for name, law in laws.items()}
    with Viewer(robot) as viewer:
        viewer.record(runs).screenshot(HERE / "circle.png", t=12, size=(1200, 800))


def ur5() -> None:
    """Show the arm on a base of README."""
    robot = MobileRobot.box(mass=60, size=(0.8, 0.6, 0.3)).mount("ur5", at=(0.2, 0, 0.3, 0))
    bend = Spline([[0.0] * 6, [-0.5] * 6, [0.0] * 6], [0, 3, 6])
    motion = WholeBody(robot, Tangent(Circle(radius=1, rate=0.5, duration=6)), bend)
    laws = {"computed torque": ComputedTorque(robot, 100, 20), "decoupled": Decoupled(robot, 100, 20)}
    runs = {name: simulate(robot, law, motion, dt=0.001, integrator=rk4) for name, law in laws.items()}
    with Viewer(robot) as viewer:
        viewer.record(runs).screenshot(HERE / "ur5.png", t=3, size=(1200, 800))


if __name__ == "__main__":
    circle()
    ur5()
