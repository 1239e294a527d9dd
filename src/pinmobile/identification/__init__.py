"""From a log to parameters with intervals that hold."""

from pinmobile.identification.log import Log, Samples
from pinmobile.identification.velocity_robot import VelocityRobot

__all__ = ["Log", "Samples", "VelocityRobot"]
