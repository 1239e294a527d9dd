"""
Which error does an unknown mass cause?
=======================================

An engineer knows the mass of a robot to 20 % and its centre of mass to 2 cm. Three thousand robots
with such values follow a circle under a controller that assumes 30 kg and 0.1 m. The result is the
distance within which 99 % of them stay, and which of the parameters makes the worst robots the
worst.
"""

from pinmobile import Circle, ComputedTorque, MobileRobot, Normal, Tangent, Uniform, ensemble, plots

robot = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
circle = Tangent(Circle(radius=3, rate=0.3, duration=21))
spread = {"mass": Uniform(24, 36), "com.x": Normal(0.1, 0.02), "com.y": Normal(0.05, 0.02)}
controllers = {gain: ComputedTorque(robot, kp=gain, kd=2 * gain**0.5) for gain in (4, 16)}
runs = {
    f"kp = {gain} 1/s²": ensemble(robot, controller, circle, n=3000, spread=spread, dt=0.02)
    for gain, controller in controllers.items()
}
for name, found in runs.items():
    print(f"{name}: 99 % of the robots stay within {1e3 * found.error_quantile(0.99).distance:.1f} mm")

# %%
# Bands over time: the share of the robots that stays within each curve.
bands = plots.bands(runs)

# %%
# The worst 5 % beside all others. Where the two distributions differ, the parameter matters.
drivers = plots.drivers(runs["kp = 4 1/s²"])
