"""Forces that no controller asked for: disturbances, friction, rolling resistance."""

from pinmobile.forces.force import (
    ConstantForce,
    CoordinateForce,
    Force,
    NoiseForce,
    SinusoidalForce,
    noise_frequencies,
)
from pinmobile.forces.friction import JointFriction, RollingResistance, ViscousFriction

__all__ = [
    "ConstantForce",
    "CoordinateForce",
    "Force",
    "JointFriction",
    "NoiseForce",
    "RollingResistance",
    "SinusoidalForce",
    "ViscousFriction",
    "noise_frequencies",
]
