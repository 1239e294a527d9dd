"""
Which motors take a delivery robot up a ramp?
=============================================

An engineer builds a differential drive of 34 kg on wheels of 10 cm radius, and chooses the gears of
its motors. For each slope the robot drives 3 m from rest to rest in 10 s. The result is the torque
that the motors have left at the speed at which they turn, from the numbers of their data sheet:
below zero, they are too weak.
"""

import numpy as np

from pinmobile import (
    Backstepping,
    Coulomb,
    FixedHeading,
    MobileRobot,
    Motor,
    RestToRest,
    UnicycleTracking,
    WheeledRobot,
    WheelTable,
    balance,
    plots,
    simulate,
)

# V; N m and A at stall; rad/s and A without load. Twice the gear: twice the torque at half the speed.
motors = {
    "gear 50:1": Motor.from_sheet(12.0, 2.06, 5.5, 20.9, 0.2, gear=50),
    "gear 100:1": Motor.from_sheet(12.0, 4.12, 5.5, 10.45, 0.2, gear=100),
}
wheels = WheelTable.differential(0.5, 0.1, supports=[(0.3, 0), (-0.3, 0)], mass=1.0, spin_inertia=0.005)
level = WheeledRobot(MobileRobot(34, 1.3, com=(0.05, 0, 0.15)), wheels, Coulomb())  # with rolling resistance
path = FixedHeading(RestToRest((0, 0), (3, 0), duration=10), psi=0)
slopes = np.arange(0, 13, 2)
left = {name: [] for name in motors}
for slope in slopes:
    robot = level.on_ramp(np.radians(slope))
    run = simulate(robot, Backstepping(UnicycleTracking(), robot), path, dt=0.05)
    for name, motor in motors.items():
        left[name].append(motor.margin(run.u, run.v[:, -2:]).min())
for name, margin in left.items():
    print(f"{name}: strong enough up to {slopes[np.array(margin) > 0].max(initial=0)}°")
margins = plots.curves(left, x=("slope", "°", slopes), label="torque left at each wheel [N m]")

# %%
# How steep a ramp can be before the standing robot slips or tips over, whatever its motors:
limit = balance.max_slope(level)
print(f"it stands on ramps of up to {np.degrees(limit.value):.0f}°, then: {limit.event}")

# %%
# Torques on the steepest ramp:
torques = plots.wheel_torques(run)
