"""
From a log to mass and friction
===============================

An engineer logs poses and forces of a robot and asks for its mass, centre of mass and friction.
Here a simulation with noise stands in for the log; ``Log.from_csv`` reads one. The estimates of the
first 22 s come with 95 % intervals, and the rest of the log shows whether the model predicts what
it has not seen.
"""

from pinmobile import (
    ComputedTorque,
    Engine,
    Log,
    MobileRobot,
    RollingResistance,
    ViscousFriction,
    excitation,
    identify,
    plots,
    rk4,
    simulate,
)

design = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
real = MobileRobot(mass=32, yaw_inertia=1.6, com=(0.12, -0.04))
friction = [ViscousFriction((6, 14, 1.2)), RollingResistance((4, 7, 0.6))]
# A motion, designed so that the log determines all parameters:
motion = excitation(design, duration=28, period=12, harmonics=3)
given = {"dt": 0.05, "substeps": 10, "integrator": rk4, "forces": friction, "engine": Engine.COMPILED}
run = simulate(real, ComputedTorque(design, kp=16, kd=8), motion, **given)
log = Log.from_rollout(run, noise=1e-3, input_noise=(0.3, 0.3, 0.03))
found = identify(log.between(0, 22))
for name in ("mass", "com_x", "viscous_left"):
    low, high = found.interval(0.95)[name]
    print(f"{name} from {low:.3g} to {high:.3g} {found.units[name]}")

# %%
# What the model predicts of the rest of the log, 2 s at a time:
prediction = plots.prediction(found.predict(log.between(22, 28), seconds=2.0))
