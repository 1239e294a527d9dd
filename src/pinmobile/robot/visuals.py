"""Visual and collision geometry of a robot and its loads, from a URDF or from boxes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from os.path import isfile
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument, argument_errors
from pinmobile.files import keep
from pinmobile.robot.arms import link_of
from pinmobile.robot.linkage import BODY_JOINT
from pinmobile.robot.mounts import PayloadBody, named_frames
from pinmobile.robot.urdf_checks import urdf_tree

Mesh: TypeAlias = tuple[Array, NDArray[Any]]
"""Vertices, shape (n, 3) [m], and faces, shape (m, 3)."""


class VisualFile(NamedTuple):
    """URDF with a robot's geometry.

    Attributes
    ----------
    path : Path
        Path of the file.
    package_dirs : tuple of Path
        Folders to which ``package://`` refers.
    base : tuple of 16 floats
        Pose of the body in the file's root with all joints at rest, row by row.
    """

    path: Path
    package_dirs: tuple[Path, ...] = ()
    base: tuple[float, ...] = ()

    def find_mesh(self, name: str) -> Path | None:
        """Return the path of a mesh, or None for a missing file."""
        scheme, separator, rest = name.rpartition("://")
        rest = rest.lstrip("/") if scheme == "package" else rest
        folders = (*self.package_dirs, self.path.parent) if scheme == "package" else (self.path.parent,)
        candidates = (folder / (rest if separator else name) for folder in folders)
        # Not `Path.is_file`, which raises for names longer than a file system allows.
        return next((path.resolve() for path in candidates if isfile(path)), None)

    def tree(self) -> ElementTree.Element:
        """Return the file's tree with paths of the meshes; missing meshes have the attribute ``missing``.

        Raises
        ------
        InvalidArgument
            If the file is no longer readable, or no longer a URDF.
        """
        root = urdf_tree("path", self.path)  # again, since the file may have changed
        for mesh in root.iterfind("link/*/geometry/mesh"):
            path = self.find_mesh(mesh.get("filename", ""))
            if path is None:
                mesh.set("missing", mesh.get("filename", ""))
            else:
                mesh.set("filename", str(path))
        return root

    def visuals(
        self, model: pin.Model, stacklevel: int
    ) -> tuple[pin.GeometryModel, ElementTree.Element, bool]:
        """Return the visual geometry on the joints of the file's model, the tree, and a flag.

        A warning names meshes that are missing or unreadable. The collision shapes of a link replace its
        visual geometry if nothing of the latter is left. The flag is whether meshes are left out without a
        replacement.

        Raises
        ------
        InvalidArgument
            If the file is no longer readable.
        """
        root = self.tree()
        missing, standing = _remove_meshes(root, lambda mesh: "missing" in mesh.attrib)
        self._warn("missing", missing, standing, stacklevel)
        try:
            geometry = _geometry(root, model, pin.GeometryType.VISUAL)
        except (ValueError, RuntimeError) as error:
            # Pinocchio does not report which file it could not read.
            damaged, others = _remove_meshes(root, _is_broken)
            if not damaged:
                raise InvalidArgument(f"path is {str(self.path)!r}, which cannot be drawn: {error}") from None
            geometry = _geometry(root, model, pin.GeometryType.VISUAL)
            self._warn("damaged or of an unknown format", damaged, others, stacklevel)
            missing, standing = missing + damaged, standing + others
        return geometry, root, bool(missing and not standing)

    def _warn(self, reason: str, files: list[str], links: list[str], stacklevel: int) -> None:
        words = f"{self.path.name}: not drawn, since {reason}: {', '.join(dict.fromkeys(files))}"
        if links:
            words += f"; their collision shapes replace the visuals of {', '.join(links)}"
        if files:
            warnings.warn(words, stacklevel=stacklevel + 1)

    def shapes(self, model: pin.Model) -> pin.GeometryModel:
        """Return the collision geometry on the joints of the file's model.

        Raises
        ------
        InvalidArgument
            If the file is no longer readable, or a mesh is missing or unreadable.
        """
        root = self.tree()
        meshes = root.iterfind("link/collision/geometry/mesh")
        missing = [mesh.get("missing", "") for mesh in meshes if "missing" in mesh.attrib]
        if missing:
            names = ", ".join(dict.fromkeys(missing))
            raise InvalidArgument(
                f"{self.path.name} has collision meshes that are missing: {names}; expected them beside the "
                "file, or in folders given by package_dirs="
            )
        words = f"{self.path.name} has collision shapes that cannot be read: "
        with argument_errors(words, of=(ValueError, RuntimeError)):
            return _geometry(root, model, pin.GeometryType.COLLISION)

    def model(self) -> tuple[pin.Model, list[pin.SE3]]:
        """Return the file's model, and the placements of its joints at rest in the body frame."""
        model = pin.buildModelFromXML(ElementTree.tostring(self.tree(), encoding="unicode"))
        data = model.createData()
        pin.forwardKinematics(model, data, pin.neutral(model))
        base = pin.SE3(np.reshape(self.base, (4, 4))).inverse()
        return model, [base * placement for placement in data.oMi]


def _geometry(root: ElementTree.Element, model: pin.Model, kind: pin.GeometryType) -> pin.GeometryModel:
    return pin.buildGeomFromUrdfString(model, ElementTree.tostring(root, encoding="unicode"), kind)


def _remove_meshes(
    root: ElementTree.Element, unusable: Callable[[ElementTree.Element], bool]
) -> tuple[list[str], list[str]]:
    """Remove visuals with unusable meshes from a tree; return their files, and links with replacements."""
    files, standing = list[str](), list[str]()
    for link in root.iterfind("link"):
        count = len(files)
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and unusable(mesh):
                files.append(mesh.get("filename", ""))
                link.remove(visual)
        if len(files) == count or link.find("visual") is not None:
            continue
        for stand_in in map(deepcopy, link.findall("collision")):
            mesh = stand_in.find("geometry/mesh")
            if mesh is None or not ("missing" in mesh.attrib or _is_broken(mesh)):
                stand_in.tag = "visual"
                link.append(stand_in)
        if link.find("visual") is not None:
            standing.append(link.get("name", ""))
    return files, standing


def _is_broken(mesh: ElementTree.Element) -> bool:
    import coal

    try:
        coal.MeshLoader().load(mesh.get("filename", ""))
    except (ValueError, RuntimeError):
        return True
    return False


BODY = "body"  # name of the box, the only geometry object with a variable colour

_PLACE_TOLERANCE = 1e-9  # [m]: largest distance of equal placements
_BODY_RGBA = (0.90, 0.62, 0.0, 1.0)
_DARK_RGBA = (0.16, 0.16, 0.18, 1.0)
_LOAD_RGBA = (0.55, 0.55, 0.58, 1.0)


def _restore(path: str, package_dirs: tuple[str, ...], base: tuple[float, ...]) -> VisualFile | None:
    """Return the file that an archive names, or None if the file does not exist."""
    return VisualFile(Path(path), tuple(map(Path, package_dirs)), base) if isfile(path) else None


keep(
    VisualFile,
    lambda file: {
        "path": str(file.path),
        "package_dirs": tuple(map(str, file.package_dirs)),
        "base": file.base,
    },
    _restore,
)


def visuals_of(robot: Any, file: VisualFile | None) -> tuple[pin.GeometryModel, dict[str, tuple[str, ...]]]:
    """Return the visual geometry of a robot, with arms and loads, and the joints of its file as in `_read`.

    The body, from the file at rest or a box, is on its joint of the whole model.
    """
    visuals, joints = _read(file, robot.size) if file else (box_visuals(robot.size), {})
    for mount in robot.mounts:
        for item in mount.arm.visuals().geometryObjects:
            joint, placement = mount.joint_of(item)
            visuals.addGeometryObject(copy_visual(f"{mount.name}/{item.name}", joint, placement, item))
    for number, joint, placement, box in boxes_of(robot._model, robot.loads):
        item = pin.GeometryObject(f"load{number}", joint, placement, box)
        item.meshColor = np.array(_LOAD_RGBA)
        visuals.addGeometryObject(item)
    return visuals, joints


def _read(file: VisualFile, size: Sequence[float]) -> tuple[pin.GeometryModel, dict[str, tuple[str, ...]]]:
    """Return the file's visual geometry at rest, on the body's joint, and the file's joints of each object.

    The joints of an object are the names of the file's joints that move the object, nearest first.

    A warning names meshes that are missing or unreadable. Collision shapes replace them. If there are none
    and no mesh is left, the box replaces them. For a file with only a box that stands at the origin, the
    result is the library's box, which has a marked front.

    Raises
    ------
    InvalidArgument
        If the file is no longer readable.
    """
    model, joints = file.model()
    geometry, root, no_visuals = file.visuals(model, stacklevel=7)
    shapes = [shape.tag for shape in root.iterfind("./link/visual/geometry/*")]
    items = [(joints[item.parentJoint] * item.placement, item) for item in geometry.geometryObjects]
    ours = pin.SE3(np.eye(3), np.array([0.0, 0.0, size[2] / 2]))
    if not shapes or (shapes == ["box"] and items[0][0].isApprox(ours, _PLACE_TOLERANCE)):
        return box_visuals(size), {}
    use_box = no_visuals and "mesh" not in shapes
    visuals = box_visuals(size) if use_box else pin.GeometryModel()
    for placement, item in items:
        visuals.addGeometryObject(copy_visual(item.name, BODY_JOINT, placement, item))
    return visuals, {item.name: joints_above(model, item.parentJoint) for _, item in items}


def joints_above(model: pin.Model, joint: int) -> tuple[str, ...]:
    """Return the names of a joint and its ancestors, nearest first."""
    names = []
    while joint:
        names.append(str(model.names[joint]))
        joint = model.parents[joint]
    return tuple(names)


def copy_visual(name: str, joint: int, placement: pin.SE3, item: pin.GeometryObject) -> pin.GeometryObject:
    """Return the object on another joint, with its mesh as Pinocchio has read and scaled it."""
    copy = pin.GeometryObject(name, joint, placement, item.geometry)
    # meshcat draws holes for a file with materials.
    copy.meshColor, copy.meshScale, copy.meshPath = item.meshColor, np.ones(3), ""
    return copy


def box_visuals(size: Sequence[float], clearance: float = 0.0) -> pin.GeometryModel:
    """Return a box that stands on the ground, with a dark front and a wedge on top that points forward.

    Parameters
    ----------
    size : sequence of 3 floats
        Length, width, and height of the top [m].
    clearance : float
        Height of the bottom above the ground, for a box on wheels [m].
    """
    import coal

    length, width, height = size
    tall, middle = height - clearance, (height + clearance) / 2
    depth, lift = 0.04 * length, 0.14 * tall
    front = coal.Box(depth, 0.9 * width, 0.62 * tall)
    #  y_B          seen from above; the wedge is `lift` high
    #   |  ______________
    #   | |    |\        ||
    #   | |    |  \      ||
    #   | |    |  /      ||---- x_B
    #   | |____|/________||
    corners = np.array([[-0.1, -0.36], [0.42, 0.0], [-0.1, 0.36]]) * (length, width)
    low, high = (np.column_stack([corners, np.full(3, z)]) for z in (0.0, lift))
    visuals = pin.GeometryModel()
    for name, shape, point, colour in (
        (BODY, coal.Box(length, width, tall), (0, 0, middle), _BODY_RGBA),
        ("front", front, ((length + 0.5 * depth) / 2, 0, middle), _DARK_RGBA),
        ("wedge", _prism(np.concatenate([low, high])), (0, 0, height), _DARK_RGBA),
    ):
        item = pin.GeometryObject(name, BODY_JOINT, pin.SE3(np.eye(3), np.array(point, np.float64)), shape)
        item.meshColor = np.array(colour)
        visuals.addGeometryObject(item)
    return visuals


_PRISM = (0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (2, 0, 3), (2, 3, 5), (0, 2, 1), (3, 4, 5)


def _prism(corners: Array) -> object:
    """Return the prism with corners 0, 1, 2 below and 3, 4, 5 above, with separate corners for each face."""
    return mesh_of(corners[np.array(_PRISM)].reshape(-1, 3), np.arange(3 * len(_PRISM)).reshape(-1, 3))


def mesh_of(vertices: Array, faces: NDArray[np.int64]) -> Any:
    """Return triangles as a mesh of coal: corners, shape (n, 3) [m], and three of them per face, (m, 3)."""
    import coal

    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(vertices))
    mesh.addVertices(np.ascontiguousarray(vertices))
    mesh.addTriangles(np.ascontiguousarray(faces, np.int32))
    mesh.endModel()
    return mesh


def merge_meshes(parts: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [faces + start for (_, faces), start in zip(parts, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def revolve(profile: Sequence[tuple[float, float]], sides: int = 32) -> Mesh:
    """Return the surface of points (y, r) that turn about the y axis, r from it."""
    angle = 2 * np.pi * np.arange(sides) / sides
    rings = [np.column_stack([r * np.sin(angle), np.full(sides, y), r * np.cos(angle)]) for y, r in profile]
    k = np.arange(sides)
    k_next, faces = (k + 1) % sides, []
    for ring in range(len(profile) - 1):
        a, b = ring * sides, (ring + 1) * sides
        faces += [np.stack([a + k, b + k, a + k_next], -1), np.stack([a + k_next, b + k, b + k_next], -1)]
    return np.concatenate(rings), np.concatenate(faces)


def boxes_of(model: pin.Model, loads: Sequence[PayloadBody]) -> Iterator[tuple[int, int, pin.SE3, Any]]:
    """Yield number, joint of the whole model, placement and box of each load with a size."""
    import coal

    frames = named_frames(model)
    for number, load in enumerate(loads, start=1):
        if load.size is not None:
            frame = model.frames[frames[load.frame]]
            placement = frame.placement * pin.SE3(np.eye(3), np.array(load.com))
            yield number, frame.parentJoint, placement, coal.Box(*load.size)


BODY_LINK = "base_link"  # link of a box-shaped body


class Solid(NamedTuple):
    """Collision shape of a link.

    Attributes
    ----------
    link : str
        Link of the shape.
    part : int
        Moving part that carries the shape: 0 for the body, k for the k-th joint of the arms in the model.
    placement : pin.SE3
        Placement in the frame of this joint, or of the body.
    geometry : coal.CollisionGeometry
        Convex geometry; for a mesh, its convex hull.
    mesh : coal.BVHModelBase or None
        Mesh without the hull.
    joints : tuple of str
        Joints of the base's file that would move the shape, nearest first; they are locked here.
    """

    link: str
    part: int
    placement: pin.SE3
    geometry: Any
    mesh: Any = None
    joints: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Solids:
    """Collision shapes of a robot, and the structure of its moving parts.

    Parameters
    ----------
    shapes : tuple of Solid
        At least one shape per link.
    parents : tuple of int
        Parent of each part; -1 for the body.
    moves : tuple of slice
        Coordinates of each part's joint in v; empty for the body.
    standing : frozenset of str
        Links that touch the ground by definition, such as wheels.
    """

    shapes: tuple[Solid, ...]
    parents: tuple[int, ...]
    moves: tuple[slice, ...]
    standing: frozenset[str] = frozenset()

    @classmethod
    def of(cls, robot: Any, file: VisualFile | None) -> Solids:
        """Return the shapes of a `MobileRobot`, with the file of its body."""
        model, arm_shapes = robot._model, carried_shapes(robot)
        body = [body_box(robot.size)] if robot.is_box else body_shapes(file, robot.source)
        joints = range(BODY_JOINT + 1, model.njoints)
        parents = (-1, *(model.parents[joint] - BODY_JOINT for joint in joints))
        starts = ((model.idx_vs[joint], model.nvs[joint]) for joint in joints)
        return cls((*body, *arm_shapes), parents, (slice(0, 0), *(slice(k, k + n) for k, n in starts)))


def body_shapes(looks: VisualFile | None, source: str) -> Iterator[Solid]:
    """Return the collision shapes of the body of a robot from a file, including locked links.

    Parameters
    ----------
    looks : VisualFile or None
        File of the robot.
    source : str
        Origin of the robot's numbers, for the message.

    Raises
    ------
    InvalidArgument
        If there are no shapes, or the file or a mesh is unreadable.
    """
    model, joints = looks.model() if looks else (pin.Model(), [])
    shapes = looks.shapes(model) if looks else pin.GeometryModel()
    _check_shapes(shapes, "a body", "a box, or <collision> in a URDF", f" ({source})")
    for item in shapes.geometryObjects:
        placement = joints[item.parentJoint] * item.placement
        yield from _solid(link_of(item, model), 0, placement, item, joints_above(model, item.parentJoint))


def body_box(size: Sequence[float], bottom: float = 0.0) -> Solid:
    """Return the box of a body made from numbers.

    Parameters
    ----------
    size : sequence of 3 floats
        Length, width, and height of the top [m].
    bottom : float
        Height of the lower face, for a box on wheels [m].
    """
    import coal

    length, width, height = size
    middle = np.array([0.0, 0.0, (height + bottom) / 2])
    return Solid(BODY_LINK, 0, pin.SE3(np.eye(3), middle), coal.Box(length, width, height - bottom))


def _check_shapes(shapes: pin.GeometryModel, owner: str, expected: str, source: str = "") -> None:
    if not shapes.ngeoms:
        raise InvalidArgument(f"robot has {owner} without collision shapes{source}, expected {expected}")


def carried_shapes(robot: Any) -> Iterator[Solid]:
    """Return the collision shapes of arms, and the boxes of loads, on the parts of the whole model.

    Raises
    ------
    InvalidArgument
        If an arm has no shapes, or its file or a mesh is unreadable.
    """
    for mount in robot.mounts:
        shapes, links = mount.arm.solids()
        _check_shapes(shapes, f"an arm {mount.name!r}", "mount(collision=...)")
        for item, link in zip(shapes.geometryObjects, links, strict=True):
            joint, placement = mount.joint_of(item)
            yield from _solid(f"{mount.name}/{link}", joint - BODY_JOINT, placement, item)
    for number, joint, placement, box in boxes_of(robot._model, robot.loads):
        yield Solid(f"load {number}", joint - BODY_JOINT, placement, box)


def _solid(
    link: str, part: int, placement: pin.SE3, item: pin.GeometryObject, joints: tuple[str, ...] = ()
) -> Iterator[Solid]:
    """Yield a convex shape, or nothing for a placeholder without extent."""
    geometry = item.geometry
    mesh = geometry if hasattr(geometry, "num_tris") else None
    if mesh is not None:
        geometry = _hull(mesh, link)
    geometry.computeLocalAABB()
    if geometry.aabb_radius > 0:
        yield Solid(link, part, placement, geometry, mesh, joints)


def _hull(mesh: Any, link: str) -> Any:
    """Return the convex hull of a mesh."""
    copy = mesh.clone()
    try:
        copy.buildConvexHull(True, "Qt")
    except (ValueError, RuntimeError) as error:
        raise InvalidArgument(
            f"link {link!r} has a collision mesh without convex hull, expected points that do not lie in "
            f"one plane: {str(error).splitlines()[0] if str(error) else 'qhull fails'}"
        ) from None
    return copy.convex
