"""
A UR5 draws a square while its base drives past
===============================================

The base has two driven wheels: it cannot move sideways and does not stop. The arm holds a pen at
right angles to a wall and draws a square of 0.5 m, while the base drives 2 m along the wall. Two
tasks share one motion: the pen has priority over the base. The result is the error of the pen.
"""

import numpy as np

from pinmobile import (
    Backstepping,
    FrameTask,
    MobileRobot,
    Polyline,
    PosePath,
    UnicycleTracking,
    WheeledRobot,
    WheelTable,
    plots,
    simulate,
    solve_inverse_kinematics,
)
from pinmobile.viewer import Viewer

wheels = WheelTable.differential(0.5, 0.1, supports=[(0.3, 0), (-0.3, 0)], mass=2.0, spin_inertia=0.01)
robot = WheeledRobot(MobileRobot.box(mass=120, size=(0.8, 0.5, 0.4)), wheels).mount("ur5", (0, 0, 0.4, 0))
wall, low, high = 0.5, 0.4, 0.9
square = [(-0.25, wall, low), (-0.25, wall, high), (0.25, wall, high), (0.25, wall, low), (-0.25, wall, low)]
approach, leave = [(-1.1, 0.45, low), (-0.25, 0.45, low)], [(-0.25, 0.45, low), (0.8, 0.45, low)]
pen = Polyline([*approach, *square, *leave], corner_radius=0.01, duration=32, acceleration=0.2)
into_wall = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # z of the tool along y
base = Polyline([(-1.1, 0, 0), (0.9, 0, 0)], corner_radius=1, duration=32, acceleration=0.05)
tasks = [
    FrameTask(PosePath(pen, into_wall), axis=(0, 0, 1), position=100, orientation=100),
    FrameTask(PosePath(base, np.eye(3)), "base_link"),
]
start = [-1.1, 0, 0, 1.3, -1.3, 2.2, -0.9, 1.3, 0]
motion = solve_inverse_kinematics(robot, tasks, q0=start, dt=0.02, tolerance=1e-3)
run = simulate(robot, Backstepping(UnicycleTracking(), robot, k=40, arms=10), motion, dt=0.005)
