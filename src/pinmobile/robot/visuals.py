"""Visual and collision geometry of a robot and of its loads, and the URDF that has it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from os.path import isfile
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.files import keep
from pinmobile.robot.arms import link_of
from pinmobile.robot.linkage import BODY_JOINT
from pinmobile.robot.mounts import Mount, PayloadBody, named_frames
from pinmobile.robot.urdf_checks import urdf_tree


class VisualFile(NamedTuple):
    """The URDF that says how a robot looks.

    Attributes
    ----------
    path : Path
        The file.
    package_dirs : tuple of Path
        Folders that ``package://`` refers to.
    base : tuple of 16 floats
        Pose of the body in the file's root with all joints at rest, row by row.
    """

    path: Path
    package_dirs: tuple[Path, ...] = ()
    base: tuple[float, ...] = ()

    def found(self, name: str) -> Path | None:
        """Return where a mesh lies, or None where it is not there."""
        scheme, apart, rest = name.rpartition("://")
        rest = rest.lstrip("/") if scheme == "package" else rest
        folders = (*self.package_dirs, self.path.parent) if scheme == "package" else (self.path.parent,)
        candidates = (folder / (rest if apart else name) for folder in folders)
        # Not `Path.is_file`, which raises where a name is longer than a file system allows.
        return next((path.resolve() for path in candidates if isfile(path)), None)

    def tree(self) -> ElementTree.Element:
        """Return the file's tree with meshes where they lie; those that are missing have no name.

        Raises
        ------
        InvalidArgument
            If the file cannot be read any more, or is no URDF by now.
        """
        root = urdf_tree("path", self.path)  # again, since the file may be another one by now
        for mesh in root.iterfind("link/*/geometry/mesh"):
            path = self.found(mesh.get("filename", ""))
            if path is None:
                mesh.set("missing", mesh.get("filename", ""))
            else:
                mesh.set("filename", str(path))
        return root

    def visuals(
        self, model: pin.Model, stacklevel: int
    ) -> tuple[pin.GeometryModel, ElementTree.Element, bool]:
        """Return what is drawn, each object on its own joint of the file's model, the tree, and a flag.

        Meshes that are missing or cannot be read are named in a warning, and the collision shapes of a link
        of which nothing else is drawn stand in their place. The flag is whether meshes were left out and
        nothing stands for them.

        Raises
        ------
        InvalidArgument
            If the file cannot be read any more.
        """
        root = self.tree()
        lost, standing = _without(root, lambda mesh: "missing" in mesh.attrib)
        self._warn("missing", lost, standing, stacklevel)
        try:
            seen = _geometry(root, model, pin.GeometryType.VISUAL)
        except (ValueError, RuntimeError) as error:
            # Pinocchio does not say which of the files it was.
            broken, others = _without(root, _is_broken)
            if not broken:
                raise InvalidArgument(f"path is {str(self.path)!r}, which cannot be drawn: {error}") from None
            seen = _geometry(root, model, pin.GeometryType.VISUAL)
            self._warn("damaged or of a format that is not read", broken, others, stacklevel)
            lost, standing = lost + broken, standing + others
        return seen, root, bool(lost and not standing)

    def _warn(self, why: str, files: list[str], links: list[str], stacklevel: int) -> None:
        words = f"{self.path.name}: not drawn, since {why}: {', '.join(dict.fromkeys(files))}"
        if links:
            words += f"; collision shapes are drawn in their place of {', '.join(links)}"
        if files:
            warnings.warn(words, stacklevel=stacklevel + 1)

    def shapes(self, model: pin.Model) -> pin.GeometryModel:
        """Return the collision geometry, each shape on its own joint of the file's model.

        Raises
        ------
        InvalidArgument
            If the file cannot be read any more, or a mesh is missing or cannot be read.
        """
        root = self.tree()
        meshes = root.iterfind("link/collision/geometry/mesh")
        lost = [mesh.get("missing", "") for mesh in meshes if "missing" in mesh.attrib]
        if lost:
            listed = ", ".join(dict.fromkeys(lost))
            raise InvalidArgument(
                f"{self.path.name} has collision meshes that are missing: {listed}; expected them beside the "
                "file, or package_dirs="
            )
        try:
            return _geometry(root, model, pin.GeometryType.COLLISION)
        except (ValueError, RuntimeError) as error:
            raise InvalidArgument(
                f"{self.path.name} has collision shapes that cannot be read: {error}"
            ) from None

    def model(self) -> tuple[pin.Model, list[pin.SE3]]:
        """Return the file's model, and where its joints are at rest, in the frame of the body."""
        model = pin.buildModelFromXML(ElementTree.tostring(self.tree(), encoding="unicode"))
        data = model.createData()
        pin.forwardKinematics(model, data, pin.neutral(model))
        base = pin.SE3(np.reshape(self.base, (4, 4))).inverse()
        return model, [base * placement for placement in data.oMi]


def _geometry(root: ElementTree.Element, model: pin.Model, kind: pin.GeometryType) -> pin.GeometryModel:
    return pin.buildGeomFromUrdfString(model, ElementTree.tostring(root, encoding="unicode"), kind)


def _without(
    root: ElementTree.Element, unusable: Callable[[ElementTree.Element], bool]
) -> tuple[list[str], list[str]]:
    """Take visuals whose meshes are unusable out of a tree; return their files, and links with stand-ins."""
    lost, standing = list[str](), list[str]()
    for link in root.iterfind("link"):
        before = len(lost)
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and unusable(mesh):
                lost.append(mesh.get("filename", ""))
                link.remove(visual)
        if len(lost) == before or link.find("visual") is not None:
            continue
        for stand_in in map(deepcopy, link.findall("collision")):
            mesh = stand_in.find("geometry/mesh")
            if mesh is None or not ("missing" in mesh.attrib or _is_broken(mesh)):
                stand_in.tag = "visual"
                link.append(stand_in)
        if link.find("visual") is not None:
            standing.append(link.get("name", ""))
    return lost, standing


def _is_broken(mesh: ElementTree.Element) -> bool:
    import coal

    try:
        coal.MeshLoader().load(mesh.get("filename", ""))
    except (ValueError, RuntimeError):
        return True
    return False


BODY = "body"
"""Name of the box, the one geometry object that may be coloured as one likes."""

_THERE = 1e-9  # [m]: what is so near a place is at it
_BODY_RGBA = (0.90, 0.62, 0.0, 1.0)
_DARK_RGBA = (0.16, 0.16, 0.18, 1.0)


def _restored(path: str, package_dirs: tuple[str, ...], base: tuple[float, ...]) -> VisualFile | None:
    """Return the file that an archive names; None where it is no longer there."""
    return VisualFile(Path(path), tuple(map(Path, package_dirs)), base) if isfile(path) else None


keep(
    VisualFile,
    lambda file: {
        "path": str(file.path),
        "package_dirs": tuple(map(str, file.package_dirs)),
        "base": file.base,
    },
    _restored,
)


def read_visuals(
    file: VisualFile, size: Sequence[float], joint: int
) -> tuple[pin.GeometryModel, dict[str, tuple[str, ...]]]:
    """Return what the file shows, riding on `joint`, its own joints at rest, and the joints of each object.

    Those of an object are the joints of the file that move it, by name, the nearest first.

    Mesh files that are missing or cannot be read are named in a warning. Collision shapes stand for them, or
    if there are none and no mesh is left, the box. Of a file that shows nothing but a box which stands about
    the origin it is our own, which has a front.

    Raises
    ------
    InvalidArgument
        If the file cannot be read any more.
    """
    model, joints = file.model()
    seen, root, is_lost = file.visuals(model, stacklevel=6)
    shapes = [shape.tag for shape in root.iterfind("./link/visual/geometry/*")]
    placed = [(joints[item.parentJoint] * item.placement, item) for item in seen.geometryObjects]
    ours = pin.SE3(np.eye(3), np.array([0.0, 0.0, size[2] / 2]))
    if not shapes or (shapes == ["box"] and placed[0][0].isApprox(ours, _THERE)):
        return box_visuals(size, joint), {}
    lost = is_lost and "mesh" not in shapes
    visuals = box_visuals(size, joint) if lost else pin.GeometryModel()
    for placement, item in placed:
        visuals.addGeometryObject(drawn(item.name, joint, placement, item))
    return visuals, {item.name: joints_above(model, item.parentJoint) for _, item in placed}


def joints_above(model: pin.Model, joint: int) -> tuple[str, ...]:
    """Return the names of a joint and of those that move it, the nearest first."""
    found = []
    while joint:
        found.append(str(model.names[joint]))
        joint = model.parents[joint]
    return tuple(found)


def drawn(name: str, joint: int, placement: pin.SE3, item: pin.GeometryObject) -> pin.GeometryObject:
    """Return the object on another joint, its mesh as Pinocchio has read and scaled it."""
    moved = pin.GeometryObject(name, joint, placement, item.geometry)
    # Of a file with materials meshcat draws holes.
    moved.meshColor, moved.meshScale, moved.meshPath = item.meshColor, np.ones(3), ""
    return moved


def box_visuals(size: Sequence[float], joint: int, clearance: float = 0.0) -> pin.GeometryModel:
    """Return a box that stands on the ground, with a dark front and a wedge on top that points forward.

    Parameters
    ----------
    size : sequence of 3 floats
        Length, width and height of its top [m].
    joint : int
        What it rides on.
    clearance : float
        Height of its bottom, where wheels carry it [m].
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
    for name, shape, at, colour in (
        (BODY, coal.Box(length, width, tall), (0, 0, middle), _BODY_RGBA),
        ("front", front, ((length + 0.5 * depth) / 2, 0, middle), _DARK_RGBA),
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


_LOAD_RGBA = (0.55, 0.55, 0.58, 1.0)


def add_carried(
    visuals: pin.GeometryModel, model: pin.Model, mounts: Sequence[Mount], loads: Sequence[PayloadBody]
) -> None:
    """Add what is drawn of arms and loads, on the joints of the whole model."""
    for mount in mounts:
        for item in mount.arm.visuals().geometryObjects:
            joint, placement = mount.joint_of(item)
            visuals.addGeometryObject(drawn(f"{mount.name}/{item.name}", joint, placement, item))
    for number, joint, placement, box in boxes_of(model, loads):
        item = pin.GeometryObject(f"load{number}", joint, placement, box)
        item.meshColor = np.array(_LOAD_RGBA)
        visuals.addGeometryObject(item)


def boxes_of(model: pin.Model, loads: Sequence[PayloadBody]) -> Iterator[tuple[int, int, pin.SE3, Any]]:
    """Yield number, joint of the whole model, placement and box of each load that has a size."""
    import coal

    frames = named_frames(model)
    for number, load in enumerate(loads, start=1):
        if load.size is not None:
            frame = model.frames[frames[load.frame]]
            placement = frame.placement * pin.SE3(np.eye(3), np.array(load.com))
            yield number, frame.parentJoint, placement, coal.Box(*load.size)


BODY_LINK = "base_link"
"""Link of the body that is a box."""


class Solid(NamedTuple):
    """A shape of a link.

    Attributes
    ----------
    link : str
        Whose it is.
    part : int
        What it moves with: 0 the body, k the arms' k-th joint in the model.
    placement : pin.SE3
        In the frame of that joint, or of the body.
    geometry : coal.CollisionGeometry
        Convex: of a mesh its hull.
    mesh : coal.BVHModelBase or None
        The mesh itself.
    joints : tuple of str
        Joints of the base's file that would move it, the nearest first; locked here.
    """

    link: str
    part: int
    placement: pin.SE3
    geometry: Any
    mesh: Any = None
    joints: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Solids:
    """The shapes of a robot, and how its parts hang together.

    Parameters
    ----------
    shapes : tuple of Solid
        One or more of each link.
    parents : tuple of int
        Of each part the one that carries it; -1 of the body.
    moves : tuple of slice
        Of each part, the coordinates of its joint in v; none of the body.
    standing : frozenset of str
        Links that are on the ground by definition, such as wheels.
    """

    shapes: tuple[Solid, ...]
    parents: tuple[int, ...]
    moves: tuple[slice, ...]
    standing: frozenset[str] = frozenset()

    @classmethod
    def on(cls, model: pin.Model, shapes: Iterable[Solid]) -> Solids:
        """Return those on the joints of a robot's model."""
        joints = range(BODY_JOINT + 1, model.njoints)
        parents = (-1, *(model.parents[joint] - BODY_JOINT for joint in joints))
        starts = ((model.idx_vs[joint], model.nvs[joint]) for joint in joints)
        return cls(tuple(shapes), parents, (slice(0, 0), *(slice(k, k + n) for k, n in starts)))


def body_shapes(looks: VisualFile | None, source: str) -> Iterator[Solid]:
    """Return the shapes of the body of a robot from a file, and of what is locked to it.

    Parameters
    ----------
    looks : VisualFile or None
        The file that it was read from.
    source : str
        Where its numbers come from, for the message.

    Raises
    ------
    InvalidArgument
        If it has none, or its file or a mesh cannot be read.
    """
    if looks is None:
        raise InvalidArgument(
            f"robot has a body without collision shapes ({source}), expected one made from numbers, or from "
            "a URDF whose links have <collision>"
        )
    model, joints = looks.model()
    shapes = looks.shapes(model)
    if not shapes.ngeoms:
        raise InvalidArgument(
            f"robot has a body without collision shapes: {looks.path.name} has no link with <collision>"
        )
    for item in shapes.geometryObjects:
        placement = joints[item.parentJoint] * item.placement
        yield from _solid(link_of(item, model), 0, placement, item, joints_above(model, item.parentJoint))


def body_box(size: Sequence[float], bottom: float = 0.0) -> Solid:
    """Return the box that a body made from numbers is, its top at its height.

    Parameters
    ----------
    size : sequence of 3 floats
        Length, width and height of its top [m].
    bottom : float
        Height of its lower face, where wheels carry it [m].
    """
    import coal

    length, width, height = size
    middle = np.array([0.0, 0.0, (height + bottom) / 2])
    return Solid(BODY_LINK, 0, pin.SE3(np.eye(3), middle), coal.Box(length, width, height - bottom))


def carried_shapes(
    model: pin.Model, mounts: Sequence[Mount], loads: Sequence[PayloadBody]
) -> Iterator[Solid]:
    """Return the shapes of arms, and the boxes of loads that have a size, on the parts of the whole model.

    Raises
    ------
    InvalidArgument
        If an arm has none, or its file or a mesh cannot be read.
    """
    for mount in mounts:
        shapes, links = mount.arm.solids()
        if not shapes.ngeoms:
            raise InvalidArgument(
                f"robot has an arm {mount.name!r} without collision shapes, expected one whose URDF has "
                "links with <collision>, or mount(model, collision=geometry)"
            )
        for item, link in zip(shapes.geometryObjects, links, strict=True):
            joint, placement = mount.joint_of(item)
            yield from _solid(f"{mount.name}/{link}", joint - BODY_JOINT, placement, item)
    for number, joint, placement, box in boxes_of(model, loads):
        yield Solid(f"load {number}", joint - BODY_JOINT, placement, box)


def _solid(
    link: str, part: int, placement: pin.SE3, item: pin.GeometryObject, joints: tuple[str, ...] = ()
) -> Iterator[Solid]:
    """Return a shape made convex; nothing of a placeholder without extent."""
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
            f"link {link!r} has a collision mesh without convex hull, expected points that are not all in "
            f"one plane: {str(error).splitlines()[0] if str(error) else 'qhull fails'}"
        ) from None
    return copy.convex
