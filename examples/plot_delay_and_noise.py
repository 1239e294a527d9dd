"""
Which controller survives delay and noise?
==========================================

Cameras measure poses with noise and some samples late, and the robot is 20 % heavier than its
model. A researcher compares four controllers on the same circle, over the delay. The result is the
largest error of each once the start is over, and the delay with which its loop diverges.
"""

import numpy as np

from pinmobile import (
    PID,
    Circle,
    ComputedTorque,
    DisturbanceObserver,
    Diverged,
    MeasurementDelay,
    MeasurementNoise,
    MobileRobot,
    SuperTwisting,
    Tangent,
    plots,
    simulate,
)

model, robot = MobileRobot(30, 1.3, com=(0.1, 0.05)), MobileRobot(36, 1.56, com=(0.1, 0.05))
circle = Tangent(Circle(radius=1.5, rate=0.6, duration=12))
controllers = {
    "PID": PID(model),
    "computed torque": ComputedTorque(model, kp=16, kd=8),
    "observer": DisturbanceObserver(ComputedTorque(model, kp=16, kd=8), model),
    "super-twisting": SuperTwisting(model),
}
delays, largest = np.array([0, 40, 80, 120, 160]), {name: [] for name in controllers}
for name, controller in controllers.items():
    noisy = MeasurementNoise(controller, (2e-3, 2e-3, 2e-3), (1e-2, 1e-2, 1e-2), seed=0)
    for delay in delays:
        try:
            run = simulate(robot, MeasurementDelay(noisy, int(delay) // 20), circle, dt=0.02)
            largest[name].append(1e3 * np.hypot(*run.error[run.t > 6, :2].T).max())
        except Diverged:
            largest[name].append(np.inf)
for k in (0, 2):
    errors = ", ".join(f"{name} {row[k]:.1f} mm" for name, row in largest.items())
    print(f"{delays[k]} ms late: {errors}")

# %%
# A cross at the top stands for a loop that diverges.
chart = plots.curves(largest, x=("delay", "ms", delays), label="largest error after 6 s [mm]")
