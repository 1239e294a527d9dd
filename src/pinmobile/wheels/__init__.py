"""Wheels under a robot: the wheel table, rolling and slip, motors."""

from pinmobile.wheels.description import read_wheels
from pinmobile.wheels.freedom import Allocation, Reduced
from pinmobile.wheels.ground import Coulomb, Ground as Ground, Ramp, Rolling
from pinmobile.wheels.kinematics import Kinematics as Kinematics, Mobility
from pinmobile.wheels.motors import MOTORS, Motor, MotorLaw as MotorLaw
from pinmobile.wheels.odometry import ByOdometry
from pinmobile.wheels.powered import ByVoltage
from pinmobile.wheels.rolling import WheeledDynamics as WheeledDynamics
from pinmobile.wheels.table import Ackermann, Differential, Friction, GearTrain, Support, Wheel, WheelTable
from pinmobile.wheels.tree import Forces
from pinmobile.wheels.wheeled import WheeledRobot

__all__ = [
    "MOTORS",
    "Ackermann",
    "Allocation",
    "ByOdometry",
    "ByVoltage",
    "Coulomb",
    "Differential",
    "Forces",
    "Friction",
    "GearTrain",
    "Mobility",
    "Motor",
    "Ramp",
    "Reduced",
    "Rolling",
    "Support",
    "Wheel",
    "WheelTable",
    "WheeledRobot",
    "read_wheels",
]
