"""
Which number must be measured first?
====================================

An engineer knows mass, yaw inertia and centre of mass of a robot to some per cent only, and wants to
know which of them to measure better. One run with its tangents gives the derivatives of all samples;
multiplied by what is unknown of each number, they are a band around the run. An ensemble of robots
confirms it, at the price of its runs.
"""

import numpy as np

from pinmobile import Circle, ComputedTorque, MobileRobot, Normal, Tangent, ensemble, plots
from pinmobile.derivatives import sensitivities

robot = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0))
circle = Tangent(Circle(radius=2, rate=0.5, duration=6))
law = ComputedTorque(robot, kp=4, kd=4)
unknown = {"mass": 1.5, "yaw_inertia": 0.2, "com.x": 0.02, "com.y": 0.02}  # kg, kg m^2, m, m
found = sensitivities(robot, law, circle, by=[f"plant.{name}" for name in unknown], dt=0.02)
wide = {name: found.deviation({f"plant.{name}": size})[:, :2].max() for name, size in unknown.items()}
print("largest effect: " + ", ".join(f"{name} {1e3 * size:.1f} mm" for name, size in wide.items()))

# %%
band = plots.sensitivities(found, {f"plant.{name}": size for name, size in unknown.items()})

# %%
# Beside 2,000 robots with numbers from these distributions:
nominal = {"mass": 30.0, "yaw_inertia": 1.3, "com.x": 0.1, "com.y": 0.0}
spread = {name: Normal(nominal[name], size) for name, size in unknown.items()}
runs = ensemble(robot, law, circle, n=2000, spread=spread, dt=0.02)
first_order = found.deviation({f"plant.{name}": size for name, size in unknown.items()})
print(f"root mean square of the error in x: {1e3 * np.sqrt((runs.rms('x') ** 2).mean()):.2f} mm,", end=" ")
print(f"to first order {1e3 * np.sqrt((first_order[:, 0] ** 2).mean()):.2f} mm")
