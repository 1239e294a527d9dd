"""`MobileRobot`: a Pinocchio model whose root is the DH chain, and what it carries."""

from pinmobile.robot.arms import Arm
from pinmobile.robot.dynamics import ChainDynamics, Linearization
from pinmobile.robot.engine import BODY_JOINT, Calls
from pinmobile.robot.library import EXCEPTIONS, Mountable, Mountables, mountable
from pinmobile.robot.mobile import MobileRobot
from pinmobile.robot.mounts import Load, Mount
from pinmobile.robot.stance import Stance

__all__ = [
    "BODY_JOINT",
    "EXCEPTIONS",
    "Arm",
    "Calls",
    "ChainDynamics",
    "Linearization",
    "Load",
    "MobileRobot",
    "Mount",
    "Mountable",
    "Mountables",
    "Stance",
    "mountable",
]
