"""`MobileRobot`: a Pinocchio model whose root is the DH chain, and what it carries."""

from pinmobile.robot.arms import Arm
from pinmobile.robot.articulated import ArticulatedDynamics as ArticulatedDynamics
from pinmobile.robot.complex_step import slopes as slopes
from pinmobile.robot.geometry import TOUCH as TOUCH
from pinmobile.robot.joints import BODY_JOINT, joints_of as joints_of
from pinmobile.robot.linkage import (
    ONE as ONE,
    ZERO as ZERO,
    Matrix as Matrix,
    Vector as Vector,
    applied as applied,
    cross as cross,
    dot as dot,
    exact as exact,
    number as number,
    scalars as scalars,
    sine_and_cosine as sine_and_cosine,
    solved as solved,
    transposed as transposed,
    vector_of as vector_of,
)
from pinmobile.robot.mobile import MobileRobot
from pinmobile.robot.mounts import Link, Load, Mount, named_frames as named_frames, prefixed as prefixed
from pinmobile.robot.pinocchio_calls import Engine as Engine, UncheckedDynamics
from pinmobile.robot.planar import PlanarDynamics as PlanarDynamics
from pinmobile.robot.reading import LOCKED as LOCKED
from pinmobile.robot.solids import Solid as Solid, Solids as Solids, body_box as body_box
from pinmobile.robot.sources import EXCEPTIONS, Mountable, Mountables, kept_arm as kept_arm, mountable
from pinmobile.robot.stance import (
    WEIGHTLESS as WEIGHTLESS,
    Stance,
    checked_footprint as checked_footprint,
    hull as hull,
    margin_inside as margin_inside,
    pressed_at as pressed_at,
)
from pinmobile.robot.system import Linearization, System
from pinmobile.robot.undercarriage import (
    Lump as Lump,
    Swivel as Swivel,
    Undercarriage as Undercarriage,
    WheelJoint as WheelJoint,
)
from pinmobile.robot.visuals import BODY as BODY, box_visuals as box_visuals

__all__ = [
    "BODY_JOINT",
    "EXCEPTIONS",
    "Arm",
    "Linearization",
    "Link",
    "Load",
    "MobileRobot",
    "Mount",
    "Mountable",
    "Mountables",
    "Stance",
    "System",
    "UncheckedDynamics",
    "mountable",
]
