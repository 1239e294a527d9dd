"""
Tuning LQR against PD
=====================

Someone who tunes a controller by hand asks what an optimal one does better with the same force. The
robot starts half a metre beside its path. For each largest force, PD with equal gains, as in the
lecture, is compared with LQR, whose gains follow from weights. The result is the time after which
the robot stays near the path: LQR finds the damping that the mass needs, PD with a small force has
too little of it, and with a large force too much.
"""

import numpy as np

from pinmobile import LQR, PD, FixedHeading, Line, MobileRobot, plots, simulate

robot, offset = MobileRobot(mass=30, yaw_inertia=1.3), 0.5
straight = FixedHeading(Line((0, 0), (5, 0), duration=10), psi=0)
start = straight(0.0).q + np.array([-0.3, offset, 0.4])
forces = np.array([20, 40, 80, 160])  # N
settled, runs = {"PD, kd = kp": [], "LQR": []}, {}
for force in forces:
    kp = force / offset * np.array([1, 1, 0.04])  # N/m, N/m, N m/rad
    weights = {"Q": np.append(kp**2, [0, 0, 0]), "R": np.ones(3)}
    for name, controller in {"PD, kd = kp": PD(kp, kp), "LQR": LQR(robot, **weights)}.items():
        run = simulate(robot, controller, straight, dt=0.05, q0=start, v0=straight(0.0).v)
        settled[name].append(run.t[np.abs(run.error[:, 1]) > 0.025].max())
        runs.setdefault(force, {})[name] = run
for name, times in settled.items():
    print(f"{name}: within 25 mm after {times[0]:.1f} s with 20 N, {times[-1]:.1f} s with 160 N")

# %%
comparison = plots.curves(settled, x=("largest force", "N", forces), label="within 25 mm after [s]")

# %%
# With 20 N:
states = plots.states(runs[20])

# %%
inputs = plots.forces(runs[20])
