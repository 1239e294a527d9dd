"""
Which masses do an arm's links have?
====================================

The data sheet of an arm rounds its masses and says little about centres of mass. Four seconds of
joint positions and torques contain them: ``identify`` follows the exact derivatives of simulated
segments of the log by 28 numbers. The motion determines only combinations of them; those that it
determines predict the torques of another motion.
"""

import numpy as np

from pinmobile import (
    Circle,
    ComputedTorque,
    Engine,
    Log,
    MobileRobot,
    Spline,
    Tangent,
    WholeBody,
    identify,
    plots,
    simulate,
)
from pinmobile.parts import named, replace

sheet = MobileRobot.box(mass=60, size=(0.8, 0.6, 0.3)).mount("ur5", at=(0.2, 0, 0.3, 0))
rng = np.random.default_rng(3)
masses = [path for path in named(sheet) if path.endswith("_link.mass")]
real = replace(sheet, {path: named(sheet)[path].value * rng.uniform(0.8, 1.2) for path in masses})


def moving(seed):
    way = Spline(0.4 * np.random.default_rng(seed).standard_normal((6, 6)), np.linspace(0, 4, 6))
    motion = WholeBody(sheet, Tangent(Circle(radius=1, rate=0.5, duration=4)), way)
    law = ComputedTorque(sheet, kp=100, kd=20)
    return simulate(real, law, motion, dt=0.002, engine=Engine.COMPILED)


run, other = moving(3), moving(4)
found = identify(Log.from_rollout(run, noise=1e-4, joint_noise=1e-4), sheet, by=["*_link.mass", "*_link.com"])
print(f"rank {found.rank} of {len(found.units)}; forearm {found.parameters['forearm_link.mass']:.2f} kg")
torques = {}
for name, model in {"data sheet": sheet, "identified": found.robot()}.items():
    torques[name] = other.u - model.inverse_dynamics(other.q, other.v, other.a)
    error = np.sqrt((torques[name][:, 3:] ** 2).mean())
    print(f"{name}: torques of the joints off by {error:.3f} N m in another motion")

# %%
shares = {name: np.sqrt((x[:, 3:] ** 2).mean(axis=0)) for name, x in torques.items()}
chart = plots.curves(shares, x=("joint", "", np.arange(1, 7)), label="torque error [N m]")
