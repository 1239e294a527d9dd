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
from pinmobile.forces.payload import Carried, Payload

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
