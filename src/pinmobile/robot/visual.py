"""How a robot looks: what its URDF shows, or a box with a front."""

from collections.abc import Sequence
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.robot.meshes import VisualFile, readable, shown

__all__ = ["BODY", "box_visuals", "drawn", "read_visuals"]

BODY = "body"
"""Name of the box, the one geometry object that may be coloured as one likes."""

_THERE = 1e-9  # [m]: what is so near a place is at it
_BODY_RGBA = (0.90, 0.62, 0.0, 1.0)
_DARK_RGBA = (0.16, 0.16, 0.18, 1.0)


def read_visuals(file: VisualFile, size: Sequence[float], joint: int) -> pin.GeometryModel:
    """Return what the file shows, riding on `joint`, its own joints at rest.

    Mesh files that are missing or cannot be read are named in a warning; if no mesh is left, the box stands
    for them. Of a file that shows nothing but a box which stands about the origin it is our own, which has a
    front.

    Raises
    ------
    InvalidArgument
        If the file cannot be read any more.
    """
    root, left_out = readable(file, stacklevel=6)
    model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    seen, broken = shown(model, root, file, stacklevel=6)
    shapes = [shape.tag for shape in root.iterfind("./link/visual/geometry/*")]
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    base = pin.SE3(np.reshape(file.base, (4, 4))).inverse()
    placed = [(base * data.oMi[item.parentJoint] * item.placement, item) for item in seen.geometryObjects]
    ours = pin.SE3(np.eye(3), np.array([0.0, 0.0, size[2] / 2]))
    if not shapes or (shapes == ["box"] and placed[0][0].isApprox(ours, _THERE)):
        return box_visuals(size, joint)
    lost = (left_out or broken) and "mesh" not in shapes
    visuals = box_visuals(size, joint) if lost else pin.GeometryModel()
    for placement, item in placed:
        visuals.addGeometryObject(drawn(item.name, joint, placement, item))
    return visuals


def drawn(name: str, joint: int, placement: pin.SE3, item: pin.GeometryObject) -> pin.GeometryObject:
    """Return the object on another joint, its mesh as Pinocchio has read and scaled it."""
    moved = pin.GeometryObject(name, joint, placement, item.geometry)
    # Of a file with materials meshcat draws holes.
    moved.meshColor, moved.meshScale, moved.meshPath = item.meshColor, np.ones(3), ""
    return moved


def box_visuals(size: Sequence[float], joint: int) -> pin.GeometryModel:
    """Return a box that stands on the ground, with a dark front and a wedge on top that points forward.

    Parameters
    ----------
    size : sequence of 3 floats
        Length, width and height [m].
    joint : int
        What it rides on.
    """
    import coal

    length, width, height = size
    depth, lift = 0.04 * length, 0.14 * height
    front = coal.Box(depth, 0.9 * width, 0.62 * height)
    #  y_B          seen from above; the wedge is `lift` high
    #   |  ______________
    #   | |    |\        ||
    #   | |    |  \      ||
    #   | |    |  /      ||---- x_B
    #   | |____|/________||
    corners = np.array([[-0.1, -0.36], [0.42, 0.0], [-0.1, 0.36]]) * (length, width)
    low, high = (np.column_stack([corners, np.full(3, z)]) for z in (0.0, lift))
    visuals = pin.GeometryModel()
    for name, shape, at, colour in (
        (BODY, coal.Box(length, width, height), (0, 0, height / 2), _BODY_RGBA),
        ("front", front, ((length + 0.5 * depth) / 2, 0, 0.5 * height), _DARK_RGBA),
        ("wedge", _prism(np.concatenate([low, high])), (0, 0, height), _DARK_RGBA),
    ):
        item = pin.GeometryObject(name, joint, pin.SE3(np.eye(3), np.array(at, np.float64)), shape)
        item.meshColor = np.array(colour)
        visuals.addGeometryObject(item)
    return visuals


def _prism(corners: Array) -> object:
    """Return the prism with corners 0, 1, 2 below and 3, 4, 5 above, every face with corners of its own."""
    import coal

    quads = ((0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (2, 0, 3), (2, 3, 5), (0, 2, 1), (3, 4, 5))
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(quads), 3 * len(quads))
    for a, b, c in quads:
        mesh.addTriangle(corners[a], corners[b], corners[c])
    mesh.endModel()
    return mesh
