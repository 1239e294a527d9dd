"""The DH chain under a body: what a table must be for it, and the Pinocchio model of both."""

import numpy as np
import pinocchio as pin

from pinmobile.dh import LECTURE_TABLE, DHTable, JointType
from pinmobile.errors import InvalidArgument
from pinmobile.urdf import Body

__all__ = ["build_model", "check_chain"]

_BODY_LINK = "base_link"


def check_chain(table: DHTable) -> None:
    """Refuse a table whose last frame is not the planar pose (x, y, psi) for joint variables (y, x, psi).

    Raises
    ------
    InvalidArgument
        If it is one, or no table at all.
    """
    if not isinstance(table, DHTable):
        raise InvalidArgument(f"dh is a {type(table).__name__}, expected a DHTable")
    kinds = [row.joint for row in table]
    planar = kinds == [row.joint for row in LECTURE_TABLE]
    probes = np.array([[0, 0, 0], [0.7, -0.3, 1.1], [-1.0, 2.0, -2.5]])
    if planar:
        pose, expected = (dh.placements(probes)[:, -1] for dh in (table, LECTURE_TABLE))
        planar = bool(np.abs(pose - expected).max() < 1e-12)
    if not planar:
        raise InvalidArgument(
            f"dh with variables {table.variables} does not put its last frame at (x, y, psi), expected "
            "a chain of prismatic y, prismatic x, revolute psi whose last frame is the body's"
        )


def build_model(table: DHTable, body: Body) -> pin.Model:
    """Return the chain with the body on its last link as a Pinocchio model.

    It is the model that Pinocchio reads from `urdf.write`, but with rotations that are exact where the
    table's angles are multiples of pi / 2, so that gravity does not leak into the plane.
    """
    model = pin.Model()
    model.name = "pinmobile"
    parent = 0
    for row, placement in zip(table, table.transforms(np.zeros(len(table))), strict=True):
        joint = pin.JointModelPZ() if row.joint is JointType.PRISMATIC else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, pin.SE3(placement), row.variable)
        model.addJointFrame(parent)
    model.appendBodyToJoint(parent, pin.Inertia(body.mass, body.com, body.inertia), pin.SE3.Identity())
    model.addBodyFrame(_BODY_LINK, parent, pin.SE3.Identity(), -1)
    return model
