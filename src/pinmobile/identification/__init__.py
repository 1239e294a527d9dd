"""Estimate parameters with confidence intervals from logs, and design motions that identify them."""

from pinmobile.identification._estimates import Identification, Prediction
from pinmobile.identification._excitation import Excitation, excitation
from pinmobile.identification._identify import METHODS as METHODS, identify
from pinmobile.identification._log import Log
from pinmobile.identification._velocity import Validation, identify_velocity, validate
from pinmobile.identification._velocity_robot import VELOCITY_ROBOTS, VelocityCar, VelocityRobot

__all__ = [
    "VELOCITY_ROBOTS",
    "Excitation",
    "Identification",
    "Log",
    "Prediction",
    "Validation",
    "VelocityCar",
    "VelocityRobot",
    "excitation",
    "identify",
    "identify_velocity",
    "validate",
]
