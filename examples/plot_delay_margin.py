"""
How late may a measurement be?
==============================

A camera measures the pose, and its computer takes some samples. Before any run, the poles of the
sampled loop tell with which delay the loop becomes unstable, and the margins of each input tell how
far away that is. A run with the delay beyond the margin confirms it.
"""

import numpy as np

from pinmobile import ComputedTorque, FixedHeading, Hold, MeasurementDelay, MobileRobot, plots, simulate
from pinmobile.derivatives import poles

robot = MobileRobot(mass=30, yaw_inertia=1.3)
rest = FixedHeading(Hold((0, 0), 8), 0)
law = ComputedTorque(robot, kp=100, kd=20)
print(f"without delay, force along x: {poles(robot, law, rest, dt=0.01).margins['Fx']}")
found = {}
for late in (0, 2, 4, 6):
    delayed = MeasurementDelay(law, late) if late else law
    near = found[f"{10 * late} ms"] = poles(robot, delayed, rest, dt=0.01)
    run = simulate(robot, delayed, rest, dt=0.01, q0=[0.1, 0, 0], v0=[0, 0, 0])
    last = np.abs(run.error[-100:, 0]).max()
    size = np.abs(near.values).max()
    if late in (4, 6):
        print(f"{10 * late} ms late: largest |z| {size:.4f}, error after 7 s at most {1e3 * last:.1f} mm")

# %%
plane = plots.poles(found)
