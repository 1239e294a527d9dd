"""Forces that no controller asked for: disturbances, friction, rolling resistance."""

from pinmobile.forces.force import (
    Carried,
    ConstantForce,
    CoordinateForce,
    Force,
    JointFriction,
    NoiseForce,
    Payload,
    RollingResistance,
    SinusoidalForce,
    ViscousFriction,
    noise_frequencies,
)

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
