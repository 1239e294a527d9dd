"""
The lecture's circle: PD against computed torque
================================================

A student of the lecture has two controllers for a robot of 30 kg whose centre of mass is not at its
origin, and asks what the model in computed torque is worth. Both drive a circle of 3 m radius. PD
stays 7 mm off the path, computed torque some micrometres, with forces of the same size.
"""

from pinmobile import PD, Circle, ComputedTorque, MobileRobot, Tangent, plots, simulate
from pinmobile.viewer import Viewer

robot = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
circle = Tangent(Circle(radius=3, rate=0.1, duration=60))
controllers = {"PD": PD(kp=120, kd=120), "computed torque": ComputedTorque(robot, kp=4, kd=4)}
runs = {name: simulate(robot, controller, circle, dt=0.02) for name, controller in controllers.items()}
for name, run in runs.items():
    print(f"{name}: largest error {1e3 * run.max_error()[:2].max():.3f} mm")

# %%
# Each column has its own scale: above each panel stands the largest error.
errors = plots.errors(runs)

# %%
# The forces differ little.
forces = plots.forces(runs)

# %%
# The recorded page plays in a browser, without a network: ``recording.save_html("circle.html")`` writes it.
with Viewer(robot) as viewer:
    recording = viewer.record(runs, speed=4, fps=10, title="PD and computed torque on a circle")
