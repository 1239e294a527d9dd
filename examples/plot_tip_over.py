"""
Does my robot tip over in a curve?
==================================

A tall robot, 0.5 m by 0.4 m, shall drive curves of 1 m radius. Its builder asks which height of the
centre of mass allows which speed. The tip-over margin is the distance of the zero-moment point from
the edge of the footprint: below zero, the inner wheels lift off.
"""

import numpy as np

from pinmobile import Circle, ComputedTorque, MobileRobot, Tangent, balance, plots, simulate

speeds = np.array([0.5, 1.0, 1.5, 2.0, 2.5])  # m/s
heights = np.array([0.1, 0.2, 0.3, 0.4, 0.5])  # m
radius, margins = 1.0, np.empty((5, 5))
for i, height in enumerate(heights):
    robot = MobileRobot(mass=40, yaw_inertia=1.0, com=(0, 0, height), size=(0.5, 0.4, 2 * height))
    for j, speed in enumerate(speeds):
        moment = Tangent(Circle(radius, speed / radius, duration=3))(1.0)
        margins[i, j] = balance.tip_over_margin(balance.MotionStates(robot, *moment))
safe = [speeds[row > 0].max() for row in margins]
print(f"with the centre of mass at 0.1 m up to {safe[0]} m/s, at 0.5 m up to {safe[-1]} m/s")

# %%
# Negative: the robot tips over.
table = plots.heatmap(
    1e3 * margins,
    x=("speed", "m/s", speeds),
    y=("height of the centre of mass", "m", heights),
    label="tip-over margin [mm]",
)

# %%
# The highest robot at 1 m/s and at 2.2 m/s: the zero-moment point leaves the footprint at the outer side.
runs = {}
for speed in (1.0, 2.2):
    circle = Tangent(Circle(radius, speed / radius, duration=4))
    runs[f"{speed} m/s"] = simulate(robot, ComputedTorque(robot), circle, dt=0.02)
stability = plots.balance(runs)
