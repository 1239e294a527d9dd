"""The shapes of a URDF's links: how far they reach, and what is round about an axle."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.robot.visuals import VisualFile, found
from pinmobile.robot.wellformed import numbers

_ALONG = 0.995
"""Cosine beyond which two directions are the same: files have angles such as 1.57."""
_DIMENSIONS = {"box": "size", "cylinder": "radius length", "capsule": "radius length", "sphere": "radius"}


@dataclass(frozen=True, eq=False)
class Shape:
    """A box, a cylinder along z, a capsule along z, a sphere, or a mesh, fixed to a joint.

    Parameters
    ----------
    link : str
        Whose it is.
    joint : int
        What that is fixed to.
    placement : pin.SE3
        Pose in the joint's frame.
    half : tuple of 3 floats
        Of a box, half its sides; along z, half the length of a cylinder [m].
    disc, ball : float
        Radius of a cylinder; of a sphere, or of a capsule's ends [m].
    collides : bool
        Whether it is collision geometry; else what is drawn of a link that has none.
    mesh : str
        Name of the file, of a mesh.
    scale : tuple of 3 floats
        Of the mesh.
    """

    link: str
    joint: int
    placement: pin.SE3
    half: tuple[float, ...] = (0.0, 0.0, 0.0)
    disc: float = 0.0
    ball: float = 0.0
    collides: bool = True
    mesh: str = ""
    scale: tuple[float, ...] = (1.0, 1.0, 1.0)

    def reach(self, rotation: Array) -> float:
        """Return how far it reaches above its origin, and below it, when so turned; not of a mesh [m]."""
        up = rotation[2]  # the vertical, in the shape's frame
        return float(np.abs(up) @ self.half + self.disc * np.hypot(up[0], up[1]) + self.ball)

    def radius_about(self, axis: Array) -> float | None:
        """Return its radius about an axis in its frame, or None where it is not round about it [m]."""
        if self.disc:
            return self.disc if abs(axis[2]) > _ALONG else None
        return self.ball if self.ball and not self.half[2] else None

    def corners_below(self, pose: pin.SE3) -> Array | None:
        """Return the corners of the lower face of a box that lies level at a pose, shape (4, 2) [m]."""
        steep = np.abs(pose.rotation[2])
        if not self.half[0] or steep.max() < _ALONG:
            return None
        edges = pose.rotation * self.half  # (3, 3), a column for each
        a, b = np.delete(edges[:2], int(steep.argmax()), axis=1).T
        return np.asarray(pose.translation[:2] + np.array([-a - b, a - b, a + b, b - a]))

    def highest(self, pose: pin.SE3, file: VisualFile) -> float | None:
        """Return the height of its highest point at a pose; None of a mesh that cannot be read [m]."""
        if not self.mesh:
            return float(pose.translation[2]) + self.reach(pose.rotation)
        import coal

        path = found(self.mesh, file)
        if path is None:
            return None
        try:
            vertices = coal.MeshLoader().load(str(path), np.array(self.scale)).vertices()
        except (ValueError, RuntimeError):
            return None
        return float((np.asarray(vertices) @ pose.rotation[2]).max() + pose.translation[2])


def shapes_of(root: Element, model: pin.Model, name: str) -> list[Shape]:
    """Return the collision geometry of each link, or what is drawn of a link that has none.

    Parameters
    ----------
    root : xml.etree.ElementTree.Element
        The file, checked.
    model : pin.Model
        What Pinocchio read from it.
    name : str
        The file's name, for the message.

    Raises
    ------
    InvalidArgument
        If a dimension, or a place, is not made of finite numbers.
    """
    shapes: list[Shape] = []
    for link in root.iterfind("link"):
        called = link.get("name", "")
        frame = model.frames[model.getFrameId(called, pin.FrameType.BODY)]
        elements = link.findall("collision")
        for element in elements or link.findall("visual"):
            given = element.find("geometry")
            if given is None or not len(given):
                continue
            where = f"{name}: link {called!r} has {element.tag} geometry with"
            origin = element.find("origin")
            xyz, rpy = (
                numbers("0 0 0" if origin is None else origin.get(key, "0 0 0"), 3, f"{where} {key}")
                for key in ("xyz", "rpy")
            )
            placement = frame.placement * pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))
            at = called, frame.parentJoint, placement
            shape = _shape(given[0], at, collides=bool(elements), where=where)
            if shape is not None:
                shapes.append(shape)
    return shapes


def _shape(given: Element, at: tuple[str, int, pin.SE3], *, collides: bool, where: str) -> Shape | None:
    if given.tag == "mesh":
        scale = numbers(given.get("scale", "1 1 1"), 3, f"{where} scale")
        return Shape(*at, collides=collides, mesh=given.get("filename", ""), scale=scale)
    words = _DIMENSIONS.get(given.tag, "").split()
    counts = [3 if word == "size" else 1 for word in words]
    read = [
        numbers(given.get(word, ""), count, f"{where} {word}")
        for word, count in zip(words, counts, strict=True)
    ]
    sizes = [number for group in read for number in group]
    if not sizes or min(sizes) <= 0:
        return None  # a placeholder, or a shape that URDFs do not have: it tells nothing
    if given.tag == "box":
        x, y, z = sizes
        return Shape(*at, half=(x / 2, y / 2, z / 2), collides=collides)
    half = (0.0, 0.0, sizes[1] / 2 if len(sizes) > 1 else 0.0)
    radius = "disc" if given.tag == "cylinder" else "ball"
    return Shape(*at, half=half, collides=collides, **{radius: sizes[0]})  # type: ignore[arg-type]
