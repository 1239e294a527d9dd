"""
A wall and weak motors: predictive control
==========================================

A robot starts a metre beside its path along a wall, its motors give at most 12 N, and the wall is 5
cm beyond the path. LQR, cut off at the limits, runs into the wall. MPC (extra ``mpc``) takes limits
and wall into account and brakes in time. The result is how far each goes beyond the path.
"""

import numpy as np

from pinmobile import LQR, MPC, FixedHeading, InputSaturation, Line, MobileRobot, plots, simulate

robot, limits, wall = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05)), (12, 12, 3), 0.05
straight = FixedHeading(Line((0, 0), (4, 0), duration=8), psi=0)
controllers = {
    "LQR, cut off": InputSaturation(LQR(robot), limits),
    "MPC": MPC(robot, limits=limits, upper=(np.inf, wall), observer=0),
}
given = {"dt": 0.05, "q0": (0, -1.0, 0.4), "v0": (0.5, 0, 0)}
runs = {name: simulate(robot, controller, straight, **given) for name, controller in controllers.items()}
for name, run in runs.items():
    beyond = 1e3 * run.q[:, 1].max()
    print(f"{name}: {beyond:.0f} mm beyond the path, {'hits' if beyond > 1e3 * wall else 'clears'} the wall")

# %%
# The wall is at y = 0.05 m.
states = plots.states(runs)

# %%
# MPC brakes earlier:
forces = plots.forces(runs)
