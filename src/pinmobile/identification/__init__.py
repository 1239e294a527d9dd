"""Estimate parameters with confidence intervals from logs, and design motions that identify them."""

from pinmobile.identification.estimate import Identification
from pinmobile.identification.log import INSTEAD as INSTEAD, Log
from pinmobile.identification.motions import Excitation, excitation
from pinmobile.identification.procedure import METHODS as METHODS, identify
from pinmobile.identification.published import VELOCITY_ROBOTS
from pinmobile.identification.statistics import Prediction
from pinmobile.identification.velocity_identification import VelocityIdentification, identify_velocity
from pinmobile.identification.velocity_robot import VelocityRobot

__all__ = [
    "VELOCITY_ROBOTS",
    "Excitation",
    "Identification",
    "Log",
    "Prediction",
    "VelocityIdentification",
    "VelocityRobot",
    "excitation",
    "identify",
    "identify_velocity",
]
