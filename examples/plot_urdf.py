"""
A URDF on its wheels
====================

A robot comes as a URDF, ``courier.urdf`` beside this script, with two driven wheels and a caster
ball. Its user wants it to roll, and the torques and wheel loads along a path. ``source`` says what
was read from the file and what was guessed.
"""

import sys
from pathlib import Path

import numpy as np

from pinmobile import Backstepping, Spline, Tangent, UnicycleTracking, WheeledRobot, balance, plots, simulate
from pinmobile.viewer import Viewer

robot = WheeledRobot.from_urdf(Path(sys.argv[0]).with_name("courier.urdf"))
path = Tangent(Spline([(0, 0), (1.0, 0.0), (1.6, 0.8), (2.6, 0.8)], times=[0, 2, 4, 6]))
run = simulate(robot, Backstepping(UnicycleTracking(), robot), path, dt=0.02)
limit = balance.max_path_speed(robot, path)
print(f"{robot.robot.mass:.1f} kg; torques up to {np.abs(run.u).max():.2f} N m")
print(f"along this path at most {limit.value:.1f} m/s, then: {limit.event}")

# %%
plane = plots.path(run)

# %%
# The torques of both wheels. They step at the knots, where the third derivative of a cubic spline jumps.
torques = plots.wheel_torques(run)

# %%
# The load of each wheel; the caster carries the rest.
loads = plots.loads(run)

# %%
with Viewer(robot) as viewer:
    recording = viewer.record(run, fps=10, title="courier.urdf on its wheels")
