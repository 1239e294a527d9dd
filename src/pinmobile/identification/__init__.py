"""From a log to parameters with intervals that hold."""

from pinmobile.identification.log import Log
from pinmobile.identification.published import VELOCITY_ROBOTS
from pinmobile.identification.velocity_identification import (
    Predicted,
    VelocityIdentification,
    identify_velocity,
)
from pinmobile.identification.velocity_robot import VelocityRobot

__all__ = [
    "VELOCITY_ROBOTS",
    "Log",
    "Predicted",
    "VelocityIdentification",
    "VelocityRobot",
    "identify_velocity",
]
