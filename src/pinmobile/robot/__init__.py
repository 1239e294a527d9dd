"""`MobileRobot`: a Pinocchio model whose root is the DH chain."""

from pinmobile.robot.dynamics import ChainDynamics, Linearization
from pinmobile.robot.mobile import MobileRobot

__all__ = ["ChainDynamics", "Linearization", "MobileRobot"]
