"""`MobileRobot`: a Pinocchio model whose root is the DH chain, and what it carries."""

from pinmobile.robot.arms import Arm
from pinmobile.robot.engine import BODY_JOINT, Calls
from pinmobile.robot.mobile import MobileRobot
from pinmobile.robot.mounts import Load, Mount
from pinmobile.robot.sources import EXCEPTIONS, Mountable, Mountables, mountable
from pinmobile.robot.stance import Stance
from pinmobile.robot.system import Linearization, System

__all__ = [
    "BODY_JOINT",
    "EXCEPTIONS",
    "Arm",
    "Calls",
    "Linearization",
    "Load",
    "MobileRobot",
    "Mount",
    "Mountable",
    "Mountables",
    "Stance",
    "System",
    "mountable",
]
