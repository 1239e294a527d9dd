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
    CompositePath,
    FrameTask,
    MobileRobot,
    Polyline,
    PosePath,
    RestToRest,
    UnicycleTracking,
    WheeledRobot,
    WheelTable,
    plots,
    simulate,
    solve_inverse_kinematics,
)
from pinmobile.viewer import Viewer

wheels = WheelTable.differential(0.4, 0.1, supports=[(0.3, 0), (-0.3, 0)], mass=2.0, spin_inertia=0.01)
robot = WheeledRobot(MobileRobot.box(mass=120, size=(0.8, 0.4, 0.4)), wheels).mount("ur5", (0, 0, 0.4, 0))
low, high, wall, off = 0.35, 0.85, 0.5, 0.45  # [m]
square = [(-0.25, wall, low), (-0.25, wall, high), (0.25, wall, high), (0.25, wall, low), (-0.25, wall, low)]
points = [(-1.1, off, low), (-0.25, off, low), *square, (-0.25, off, low), (0.8, off, low)]
times = [5, 1, 4, 4, 4, 4, 1, 9]  # with a stop at each corner [s]
pen = CompositePath([RestToRest(a, b, t) for a, b, t in zip(points[:-1], points[1:], times, strict=True)])
base = Polyline([(-1.1, 0, 0), (0.9, 0, 0)], corner_radius=1, duration=pen.duration, acceleration=0.05)
into_wall = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # of the tool, whose z axis is along y
tasks = [
    FrameTask(PosePath(pen, into_wall), axis=(0, 0, 1), position=100, orientation=100),
    FrameTask(PosePath(base, np.eye(3)), "base_link"),
]
start = [-1.1, 0, 0, 1.3, -1.3, 2.2, -0.9, 1.3, 0]
motion = solve_inverse_kinematics(robot, tasks, q0=start, dt=0.02, clearance=0.01)
run = simulate(robot, Backstepping(UnicycleTracking(), robot, k=40, arms=10), motion, dt=0.005)
drawn = run.end_effector()
print(
    f"the base drives {np.ptp(run.q[:, 0]):.2f} m, the pen stays within {1e3 * drawn.max_error()[0]:.2f} mm"
)

# %%
# Path of the pen and its error:
tool = plots.end_effector(run)

# %%
with Viewer(robot) as viewer:
    recording = viewer.record(run, fps=10, title="A UR5 draws a square while its base drives past")
