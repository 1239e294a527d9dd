"""`MobileRobot`: a Pinocchio model whose root is the DH chain, and what it carries."""

from pinmobile.robot.arm_loading import EXCEPTIONS, Mountable, Mountables, mountable
from pinmobile.robot.arms import Arm, Entries as Entries, Link
from pinmobile.robot.articulated import (
    ArticulatedDynamics as ArticulatedDynamics,
    PlanarDynamics as PlanarDynamics,
    slopes as slopes,
)
from pinmobile.robot.description import describe as describe
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
    factor as factor,
    joints_of as joints_of,
    matrix_of as matrix_of,
    number as number,
    scalar_of as scalar_of,
    scalars as scalars,
    sine_and_cosine as sine_and_cosine,
    single as single,
    symmetric as symmetric,
    transpose as transpose,
    vector_of as vector_of,
)
from pinmobile.robot.mobile import MobileRobot
from pinmobile.robot.model_import import LOCKED as LOCKED, TOUCH as TOUCH, check_plane as check_plane
from pinmobile.robot.mounts import Mount, PayloadBody, add_scope as add_scope, named_frames as named_frames
from pinmobile.robot.recursions import (
    PinocchioBackend as PinocchioBackend,
    UncheckedDynamics,
    frames_of as frames_of,
)
from pinmobile.robot.support_geometry import (
    WEIGHTLESS as WEIGHTLESS,
    SupportGeometry,
    Swivel as Swivel,
    WheelJoint as WheelJoint,
    check_footprint as check_footprint,
    hull as hull,
    margin_inside as margin_inside,
    margin_of_wrench as margin_of_wrench,
    zero_moment_point_of as zero_moment_point_of,
)
from pinmobile.robot.system import Linearization, MultibodySystem
from pinmobile.robot.visuals import (
    BODY as BODY,
    Mesh as Mesh,
    Solid as Solid,
    Solids as Solids,
    body_box as body_box,
    box_visuals as box_visuals,
    merge_meshes as merge_meshes,
    mesh_of as mesh_of,
    revolve as revolve,
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
    "MultibodySystem",
    "PayloadBody",
    "SupportGeometry",
    "UncheckedDynamics",
    "mountable",
]
