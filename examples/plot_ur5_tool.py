"""
A UR5 on a mobile base draws along a wall
=========================================

An engineer wants a tool to follow a path that is longer than the arm reaches: an ellipse 1.6 m wide
and 0.4 m high, with the tool's orientation fixed. Base and arm move together. The result is the
error of the tool, and how near the robot comes to tipping over.
"""

import numpy as np

from pinmobile import (
    ComputedTorque,
    MobileRobot,
    PosePath,
    balance,
    plots,
    simulate,
    solve_inverse_kinematics,
)
from pinmobile.viewer import Viewer

robot = MobileRobot.box(mass=165, size=(0.96, 0.79, 0.31)).mount("ur5", at=(0.25, 0, 0.31, 0))
bent = np.array([0, 0, 0, 0, -1.2, 1.6, -0.4, 1.57, 0])
angles = np.linspace(0, 2 * np.pi, 9)
poses = np.tile(robot.frame_pose(bent), (9, 1, 1))  # of the tool
poses[:, 0, 3] += 0.8 * np.sin(angles)
poses[:, 2, 3] += 0.2 * (np.cos(angles) - 1)
target = PosePath.through(poses, times=np.arange(9))
motion = solve_inverse_kinematics(robot, target, q0=bent, dt=0.04)
run = simulate(robot, ComputedTorque(robot, kp=100, kd=20), motion, dt=0.02)
metres, radians = run.end_effector().max_error()
print(f"the tool stays within {1e3 * metres:.2f} mm and {1e3 * radians:.2f} mrad of its pose")
print(f"tip-over margin at least {balance.tip_over_margin(run).min():.2f} m")

# %%
# Path of the tool and its error:
tool = plots.end_effector(run)

# %%
# Where the zero-moment point is on the footprint:
stability = plots.balance(run)

# %%
with Viewer(robot) as viewer:
    recording = viewer.record(run, fps=10, title="A UR5 draws along a wall")
