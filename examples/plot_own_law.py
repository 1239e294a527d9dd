"""
A control law of one's own: sliding mode
========================================

A researcher has a law in five lines of NumPy and wants it beside computed torque on robots whose
mass is unknown. `law` makes a controller of the function; the ensemble compiles it without change.
The result is how far 99 % of a thousand robots stay from the path.
"""

import numpy as np

from pinmobile import Circle, ComputedTorque, MobileRobot, Normal, Tangent, Uniform, ensemble, law, plots, rk4

robot = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))


@law
def sliding(t, q, v, reference):
    """Sliding mode with a boundary layer of 0.05 (Slotine and Li, 1991, section 7.2)."""
    error, rate = reference.q - q, reference.v - v
    s = rate + 4 * error
    inputs = np.clip(s / 0.05, -1, 1) * np.array([30.0, 30.0, 4.0])
    return robot.inverse_dynamics(q, v, reference.a + 4 * rate) + inputs


circle = Tangent(Circle(radius=1.5, rate=0.6, duration=10))
spread = {"mass": Uniform(24, 36), "com.x": Normal(0.1, 0.02)}
given = {"n": 1000, "spread": spread, "dt": 0.01, "integrator": rk4}
controllers = {"computed torque": ComputedTorque(robot, kp=16, kd=8), "own sliding mode": sliding}
runs = {name: ensemble(robot, controller, circle, **given) for name, controller in controllers.items()}
for name, found in runs.items():
    within = 1e3 * found.error_quantile(0.99).distance
    print(f"{name}: 99 % within {within:.2f} mm, run by {found.engine}")

# %%
bands = plots.bands(runs)
