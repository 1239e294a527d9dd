"""`MobileRobot`: a Pinocchio model whose root is the DH chain, and what it carries."""

from pinmobile.robot.arm_loading import EXCEPTIONS, Mountable, Mountables, kept_arm as kept_arm, mountable
from pinmobile.robot.arms import Arm
from pinmobile.robot.articulated import (
    ArticulatedDynamics as ArticulatedDynamics,
    PlanarDynamics as PlanarDynamics,
    slopes as slopes,
)
from pinmobile.robot.geometry import TOUCH as TOUCH
from pinmobile.robot.linkage import (
    BODY_JOINT,
    ONE as ONE,
    ZERO as ZERO,
    Matrix as Matrix,
    Vector as Vector,
    applied as applied,
    cross as cross,
    dot as dot,
    exact as exact,
    joints_of as joints_of,
    number as number,
    scalars as scalars,
    sine_and_cosine as sine_and_cosine,
    solved as solved,
    transposed as transposed,
    vector_of as vector_of,
)
from pinmobile.robot.mobile import MobileRobot
from pinmobile.robot.model_import import (
    LOCKED as LOCKED,
    Lump as Lump,
    Swivel as Swivel,
    Undercarriage as Undercarriage,
    WheelJoint as WheelJoint,
)
from pinmobile.robot.mounts import (
    Link,
    Mount,
    PayloadBody,
    named_frames as named_frames,
    prefixed as prefixed,
)
from pinmobile.robot.pinocchio_backend import Engine as Engine, UncheckedDynamics
from pinmobile.robot.support_geometry import (
    WEIGHTLESS as WEIGHTLESS,
    Stance,
    checked_footprint as checked_footprint,
    hull as hull,
    margin_inside as margin_inside,
    pressed_at as pressed_at,
)
from pinmobile.robot.system import Linearization, System
from pinmobile.robot.visuals import (
    BODY as BODY,
    Solid as Solid,
    Solids as Solids,
    body_box as body_box,
    box_visuals as box_visuals,
)

__all__ = [
    "BODY_JOINT",
    "EXCEPTIONS",
    "Arm",
    "Linearization",
    "Link",
    "MobileRobot",
    "Mount",
    "Mountable",
    "Mountables",
    "PayloadBody",
    "Stance",
    "System",
    "UncheckedDynamics",
    "mountable",
]
