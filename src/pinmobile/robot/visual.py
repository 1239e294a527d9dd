"""How a robot looks: what its URDF shows, or a box with a front."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument

__all__ = ["BODY", "VisualFile", "box_visuals", "drawn", "read_visuals", "readable", "shown"]

BODY = "body"
"""Name of the box, the one geometry object that may be coloured as one likes."""

_BODY_RGBA = (0.90, 0.62, 0.0, 1.0)
_DARK_RGBA = (0.16, 0.16, 0.18, 1.0)


@dataclass(frozen=True)
class VisualFile:
    """The file that says how a robot looks.

    Parameters
    ----------
    path : Path
        A URDF.
    package_dirs : tuple of Path
        Folders that ``package://`` refers to.
    base : tuple of 16 floats
        Pose of the body in the file's root with all joints at rest, row by row.
    """

    path: Path
    package_dirs: tuple[Path, ...]
    base: tuple[float, ...]


def read_visuals(file: VisualFile, size: Sequence[float], joint: int) -> pin.GeometryModel:
    """Return what the file shows, riding on `joint`, its own joints at rest.

    Mesh files that are missing or cannot be read are named in a warning; if no mesh is left, the box stands
    for them. Of a file that shows nothing but a box it is our own, which has a front.

    Raises
    ------
    InvalidArgument
        If the file cannot be read any more.
    """
    root, left_out = readable(file, stacklevel=5)
    model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    seen, broken = shown(model, root, file, stacklevel=5)
    shapes = [shape.tag for shape in root.iterfind("./link/visual/geometry/*")]
    if shapes in ([], ["box"]):
        return box_visuals(size, joint)
    lost = (left_out or broken) and "mesh" not in shapes
    visuals = box_visuals(size, joint) if lost else pin.GeometryModel()
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    base = pin.SE3(np.reshape(file.base, (4, 4))).inverse()
    for item in seen.geometryObjects:
        placement = base * data.oMi[item.parentJoint] * item.placement
        visuals.addGeometryObject(drawn(item.name, joint, placement, item))
    return visuals


def drawn(name: str, joint: int, placement: pin.SE3, item: pin.GeometryObject) -> pin.GeometryObject:
    """Return the object on another joint, its mesh as Pinocchio has read and scaled it."""
    moved = pin.GeometryObject(name, joint, placement, item.geometry)
    # Of a file with materials meshcat draws holes.
    moved.meshColor, moved.meshScale, moved.meshPath = item.meshColor, np.ones(3), ""
    return moved


def readable(file: VisualFile, stacklevel: int) -> tuple[ElementTree.Element, list[str]]:
    """Return the file's tree without the visuals whose meshes are missing, and those files' names.

    Parameters
    ----------
    file : VisualFile
        The file.
    stacklevel : int
        Of the warning that names them: how far up the user's call is.

    Raises
    ------
    InvalidArgument
        If the file cannot be read any more.
    """
    try:
        root = ElementTree.fromstring(file.path.read_text(encoding="utf-8"))
    except (OSError, ValueError, ElementTree.ParseError) as error:
        raise InvalidArgument(f"path is {str(file.path)!r}, which cannot be read: {error}") from None
    missing = _without_meshes(root, lambda mesh: _is_missing(mesh, file))
    if missing:
        listed = ", ".join(dict.fromkeys(missing))
        warnings.warn(f"{file.path.name}: not drawn, since missing: {listed}", stacklevel=stacklevel)
    return root, missing


def shown(
    model: pin.Model, root: ElementTree.Element, file: VisualFile, stacklevel: int
) -> tuple[pin.GeometryModel, list[str]]:
    """Return what a tree shows of its model, and the mesh files that cannot be read, taken out of the tree.

    Parameters
    ----------
    model : pin.Model
        The file's.
    root, file, stacklevel
        From `readable`, and as there.

    Raises
    ------
    InvalidArgument
        If the geometry cannot be read whatever the meshes.
    """
    try:
        return _geometry(model, root), []
    except (ValueError, RuntimeError) as error:
        # Pinocchio does not say which of the files it was.
        broken = _without_meshes(root, _is_broken)
        if not broken:
            raise InvalidArgument(f"path is {str(file.path)!r}, which cannot be drawn: {error}") from None
        listed = ", ".join(dict.fromkeys(broken))
        warnings.warn(
            f"{file.path.name}: not drawn, since damaged or of a format that is not read: {listed}",
            stacklevel=stacklevel,
        )
        return _geometry(model, root), broken


def _geometry(model: pin.Model, root: ElementTree.Element) -> pin.GeometryModel:
    text = ElementTree.tostring(root, encoding="unicode")
    return pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL)


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


def _without_meshes(root: ElementTree.Element, unusable: Callable[[ElementTree.Element], bool]) -> list[str]:
    """Take visuals whose meshes are unusable out of the tree and return the files' names."""
    names: list[str] = []
    for link in root.iterfind("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and unusable(mesh):
                names.append(mesh.get("filename", ""))
                link.remove(visual)
    return names


def _is_missing(mesh: ElementTree.Element, file: VisualFile) -> bool:
    """Tell whether there is no file of that name; where there is one, write into the mesh where it lies."""
    found = _found(mesh.get("filename", ""), file)
    if found is not None:
        mesh.set("filename", str(found))
    return found is None


def _is_broken(mesh: ElementTree.Element) -> bool:
    import coal

    try:
        coal.MeshLoader().load(mesh.get("filename", ""))
    except (ValueError, RuntimeError):
        return True
    return False


def _found(name: str, file: VisualFile) -> Path | None:
    scheme, apart, rest = name.rpartition("://")
    rest = rest.lstrip("/") if scheme == "package" else rest
    folders = (*file.package_dirs, file.path.parent) if scheme == "package" else (file.path.parent,)
    candidates = (folder / (rest if apart else name) for folder in folders)
    return next((path.resolve() for path in candidates if path.is_file()), None)


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
