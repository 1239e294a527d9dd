"""Wheels under a robot: wheel tables, rolling and slip, motors."""

from pinmobile.wheels._coulomb import Coulomb
from pinmobile.wheels._drive import WheeledRobot
from pinmobile.wheels._dynamics import WheeledDynamics as WheeledDynamics
from pinmobile.wheels._kinematics import Allocation, Kinematics as Kinematics, Mobility, Reduced
from pinmobile.wheels._loads import Forces
from pinmobile.wheels._motors import MOTORS, Motor, MotorLaw as MotorLaw
from pinmobile.wheels._rolling import Ground as Ground, OdometryFeedback, Ramp, Rolling
from pinmobile.wheels._table import (
    AckermannSteering,
    DifferentialGear,
    GearTrain,
    Support,
    Wheel,
    WheelFriction,
    WheelTable,
)
from pinmobile.wheels._urdf_reader import read_wheels
from pinmobile.wheels._voltage_dynamics import ByVoltage

__all__ = [
    "MOTORS",
    "AckermannSteering",
    "Allocation",
    "ByVoltage",
    "Coulomb",
    "DifferentialGear",
    "Forces",
    "GearTrain",
    "Mobility",
    "Motor",
    "OdometryFeedback",
    "Ramp",
    "Reduced",
    "Rolling",
    "Support",
    "Wheel",
    "WheelFriction",
    "WheelTable",
    "WheeledRobot",
    "read_wheels",
]
