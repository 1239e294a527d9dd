"""Controllers: from state and reference to the input.

The loop calls a controller as ``controller(t, q, v, reference, state) -> (u, state)``. The controller
receives its own state and returns the next one; ``initial_state(context)`` returns the first one, None for a
controller without memory. q and v have shape (..., n), u has shape (..., nu), and a reference has the
attributes q, v and a. These controllers broadcast over leading axes. `InputDelay`, `InputSaturation`,
`MeasurementDelay` and `MeasurementNoise` wrap any controller, and each other.
"""

from pinmobile.controllers.actuation import RandomSteps, TorqueToVoltage, VelocityCommand, WheelSpeed
from pinmobile.controllers.adaptive import Adaptive, AdaptiveVelocity
from pinmobile.controllers.controller import (
    ContextView as ContextView,
    Controller,
    State,
    Wrapper as Wrapper,
    check_controller,
    check_memory as check_memory,
    evaluate as evaluate,
    law,
    notify_applied as notify_applied,
    plain_difference,
    planar_difference,
    stamp as stamp,
)
from pinmobile.controllers.feedback import (
    PD,
    PID,
    ComputedTorque,
    Decoupled,
    PDGravity,
    SlidingMode,
    SuperTwisting,
    gain_matrix,
)
from pinmobile.controllers.kinematic_laws import (
    Backstepping,
    DualNumber,
    DynamicFeedback,
    Kanayama,
    KinematicLaw,
    Parking,
    SwerveTracking,
    TrackingState,
    UnicycleTracking,
)
from pinmobile.controllers.lqr import LQR
from pinmobile.controllers.mpc import MPC
from pinmobile.controllers.wrappers import (
    ADRC,
    ControlAllocation,
    DisturbanceObserver,
    InputDelay,
    InputSaturation,
    MeasurementDelay,
    MeasurementNoise,
    Sampled,
)

__all__ = [
    "ADRC",
    "LQR",
    "MPC",
    "PD",
    "PID",
    "Adaptive",
    "AdaptiveVelocity",
    "Backstepping",
    "ComputedTorque",
    "ControlAllocation",
    "Controller",
    "Decoupled",
    "DisturbanceObserver",
    "DualNumber",
    "DynamicFeedback",
    "InputDelay",
    "InputSaturation",
    "Kanayama",
    "KinematicLaw",
    "MeasurementDelay",
    "MeasurementNoise",
    "PDGravity",
    "Parking",
    "RandomSteps",
    "Sampled",
    "SlidingMode",
    "State",
    "SuperTwisting",
    "SwerveTracking",
    "TorqueToVoltage",
    "TrackingState",
    "UnicycleTracking",
    "VelocityCommand",
    "WheelSpeed",
    "check_controller",
    "gain_matrix",
    "law",
    "plain_difference",
    "planar_difference",
]
