"""Estimate parameters with confidence intervals from logs, and design motions that identify them."""

from pinmobile.identification.log import Log
from pinmobile.identification.motions import Excitation, excitation
from pinmobile.identification.procedure import METHODS as METHODS, identify
from pinmobile.identification.result import Identification
from pinmobile.identification.statistics import Prediction
from pinmobile.identification.velocity_model import identify_velocity
from pinmobile.identification.velocity_robot import VELOCITY_ROBOTS, VelocityRobot

__all__ = [
    "VELOCITY_ROBOTS",
    "Excitation",
    "Identification",
    "Log",
    "Prediction",
    "VelocityRobot",
    "excitation",
    "identify",
    "identify_velocity",
]
