"""Forces that no controller asked for: disturbances, friction, rolling resistance."""

from pinmobile.disturbances.driven import ConstantForce, NoiseForce, SinusoidalForce, noise_frequencies
from pinmobile.disturbances.joints import JointFriction
from pinmobile.disturbances.protocol import CoordinateForce, Force
from pinmobile.disturbances.resistance import RollingResistance, ViscousFriction

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
