"""
Gains for robots that are not known
===================================

Mass and centre of mass of a series of robots differ by 20 %. An engineer wants the gains with which
the worst of them stays nearest to its path, with no larger force than an LQR whose weights follow
from Bryson's rule. The gradients of 200 robots and of their forces give such gains within a second;
4,000 other robots check them. Where the start, not the model, causes the error, LQR does as well.
"""

import numpy as np

from pinmobile import LQR, Circle, ComputedTorque, MobileRobot, Relative, Tangent, Uniform, ensemble, plots
from pinmobile.derivatives import Constraint, tune

robot = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0))
circle = Tangent(Circle(radius=1.5, rate=1.0, duration=8))
spread = {"mass": Relative(Uniform(0.8, 1.2)), "com.x": Uniform(-0.02, 0.22), "com.y": Uniform(-0.08, 0.08)}
options = {"spread": spread, "dt": 0.02}


def force(sample):
    return np.sqrt((sample.u[:2] ** 2).sum())


errors, efforts = np.array([0.05, 0.05, 0.1, 0.2, 0.2, 0.4]), np.array([100, 100, 20])
lqr = LQR(robot, Q=np.diag(errors**-2.0), R=np.diag(efforts**-2.0))
runs = {"LQR": ensemble(robot, lqr, circle, n=4000, seed=9, metrics={"force": force}, **options)}
most = 0.98 * runs["LQR"].largest("force").max()
found = tune(
    "distance", robot, ComputedTorque(robot, kp=[25] * 3, kd=[10] * 3), circle,
    by={"kp": (1, 400), "kd": (1, 32)}, constraints=[Constraint(force, upper=most)],
    n=200, objective="worst", **options,
)  # fmt: skip
runs["tuned"] = ensemble(robot, found.controller, circle, n=4000, seed=9, metrics={"force": force}, **options)
for name, one in runs.items():
    within, largest = 1e3 * one.error_quantile(0.99).distance, one.largest("force").max()
    print(f"{name}: 99 % stay within {within:.1f} mm of the path, largest force {largest:.0f} N")

# %%
chart = plots.bands(runs, by=["distance"])
