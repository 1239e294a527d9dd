"""Forces that no controller asked for: disturbances, friction, rolling resistance."""

from pinmobile.forces.force import (
    ConstantForce,
    Force,
    JointFriction,
    NoiseForce,
    Payload,
    RollingResistance,
    SinusoidalForce,
    ViscousFriction,
    noise_frequencies,
)
from pinmobile.parts import Carried, OnCoordinates as CoordinateForce

__all__ = [
    "Carried",
    "ConstantForce",
    "CoordinateForce",
    "Force",
    "JointFriction",
    "NoiseForce",
    "Payload",
    "RollingResistance",
    "SinusoidalForce",
    "ViscousFriction",
    "noise_frequencies",
]
