"""
A mecanum base on a wet floor
=============================

A mecanum base moves sideways by rollers that need friction. Its user asks what a wet floor does to
a fast path, and how wrong odometry becomes. On dry concrete (friction 0.8) the wheels hold; on a
wet floor (0.15) they slide.
"""

from pinmobile import (
    ComputedTorque,
    Coulomb,
    FixedHeading,
    Lissajous,
    MobileRobot,
    WheeledRobot,
    WheelTable,
    plots,
    simulate,
)
from pinmobile.viewer import Viewer
from pinmobile.wheels import OdometryFeedback, WheelFriction

path = FixedHeading(Lissajous(0.5, 0.8, 2.0, 1.0, duration=6.3), psi=0)
creep = WheelFriction(slip=1e-3)  # tyres and rollers creep a little, also on dry ground
wheels = WheelTable.mecanum(0.4, 0.5, 0.1, mass=1.0, spin_inertia=0.005, friction=creep)
rolling = WheeledRobot(MobileRobot(34, 1.3, com=(0, 0, 0.12)), wheels)  # the model of the controller
controller = OdometryFeedback(ComputedTorque(rolling, kp=16, kd=8), wheels)
runs = {}
for floor, mu in {"dry": 0.8, "wet": 0.15}.items():
    robot = WheeledRobot(rolling.robot, wheels, Coulomb(mu=mu))
    runs[floor] = simulate(robot, controller, path, dt=0.01)
    print(f"{floor}: largest error {1e3 * runs[floor].max_error()[:2].max():.0f} mm")

# %%
# Where odometry takes the robot to be, and where it is:
odometry = plots.odometry(runs)

# %%
# How much of its friction each wheel uses: at 1 it slides.
friction = plots.friction(runs)

# %%
with Viewer(robot) as viewer:
    recording = viewer.record(runs["wet"], fps=10, title="A mecanum base on a wet floor")
