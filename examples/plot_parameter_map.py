"""
Which gain for which payload? A map of two parameters
=====================================================

An engineer knows that a robot of 30 kg will carry between 0 and 60 kg, and that its poses come 60
ms late. One ensemble runs a robot for each pair of gain and payload. The map shows the error of
each, and where the loop diverges.
"""

import numpy as np

from pinmobile import PD, Circle, FixedHeading, MeasurementDelay, MobileRobot, ensemble, plots

gains, payloads = np.array([100, 200, 400, 600, 800, 1000]), np.array([0, 15, 30, 45, 60])
kp, payload = (grid.ravel().astype(float) for grid in np.meshgrid(gains, payloads))
robot = MobileRobot(mass=30, yaw_inertia=1.3)
circle = FixedHeading(Circle(radius=1.5, rate=0.6, duration=30), psi=0)
late = MeasurementDelay(PD(kp=(100.0, 100.0, 4.0), kd=(100.0, 100.0, 4.0)), samples=6)
spread = {"kp.x": kp, "kp.y": kp, "kd.x": kp, "kd.y": kp, "mass": robot.mass + payload}
found = ensemble(robot, late, circle, n=len(kp), spread=spread, dt=0.01, after=10)
error = np.where(found.diverged, np.inf, 1e3 * found.max_distance).reshape(len(payloads), len(gains))
best = gains[error.max(axis=0).argmin()]
print(f"{found.diverged.sum()} of {len(kp)} loops diverge; the best gain for all payloads is {best} N/m")

# %%
chart = plots.heatmap(
    error, x=("gain", "N/m", gains), y=("payload", "kg", payloads), label="largest error after 10 s [mm]"
)
