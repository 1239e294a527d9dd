"""
A TurtleBot's lag, from its commands and odometry
=================================================

Whoever drives a TurtleBot sends speeds and yaw rates, and its firmware follows with a lag. Six
numbers, estimated from a log of one minute, describe it. With them, backstepping commands ahead of
the lag, and the robot stays on a figure of eight whose turns it cuts otherwise.
"""

from pinmobile import (
    Backstepping,
    FixedHeading,
    Hold,
    Lissajous,
    Log,
    Tangent,
    UnicycleTracking,
    VelocityRobot,
    identify_velocity,
    plots,
    simulate,
)
from pinmobile.controllers import RandomSteps, VelocityCommand

real = VelocityRobot((0.35, 0.3, 0.002, 1.0, 0.01, 1.05), size=(0.28, 0.31, 0.14))
still = FixedHeading(Hold((0, 0), duration=80), psi=0)
steps = RandomSteps(lowest=(-0.2, -1.3), largest=(0.5, 1.3))
log = Log.from_rollout(simulate(real, steps, still, dt=0.05), noise=0.002)
found = identify_velocity(log.between(0, 60))
low, high = found.interval(0.95)["theta_1"]
print(f"lag of the speed from {low:.3f} to {high:.3f} s, 0.35 s in truth")

# %%
# What the model predicts of the next 20 s, which the estimate has not seen, two seconds at a time:
prediction = plots.prediction(found.predict(log.between(60, 80), seconds=2.0))

# %%
# The same path with the lag ignored, and with the lag in the controller:
eight = Tangent(Lissajous(0.8, 0.8, 1.0, 0.5, duration=12.5))
controllers = {
    "lag ignored": VelocityCommand(UnicycleTracking(), found.robot()),
    "lag known": Backstepping(UnicycleTracking(), found.robot()),
}
runs = {name: simulate(real, controller, eight, dt=0.05) for name, controller in controllers.items()}
for name, run in runs.items():
    print(f"{name}: largest error {1e3 * run.max_error()[:2].max():.0f} mm")
paths = plots.path(runs, times=[0, 2, 5, 7, 10.5])
