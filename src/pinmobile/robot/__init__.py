"""`MobileRobot`: a Pinocchio model whose root is the DH chain."""

from pinmobile.robot.mobile import Linearization, MobileRobot

__all__ = ["Linearization", "MobileRobot"]
