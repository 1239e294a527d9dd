"""Shapes: meshes as three.js reads them, ribbons and words on the ground, and meshes of fewer triangles."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from functools import lru_cache
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pinmobile.arrays import Array, ArrayLike
from pinmobile.viewer.pages import packed_array

Shape = dict[str, Any]
Triangles = tuple[Array, NDArray[np.uint32]]  # vertices (n, 3) [m], faces (m, 3)

_TEXT_HEIGHT = 64  # [px]
_MIN_LENGTH = 1e-6  # [m]: a shorter motion has no path
_FEW = 300  # smallest number of triangles: simplification would destroy small meshes


def flat(
    triangles: Triangles, colour: str, *, order: int, opacity: float = 1.0, trail: bool = False
) -> Shape:
    """Return an unlit mesh on the ground, painted over those of lower `order` without regard to depth.

    A `trail` shows as many vertices as its property ``drawn`` says, at first none.
    """
    material = _unlit(colour) | {"opacity": opacity, "depthWrite": False}
    return _mesh(triangles, material, {"flat": True, "trail": trail}, order)


def overlay(triangles: Triangles, colour: str, *, order: int) -> Shape:
    """Return an unlit mesh that is visible through objects in front of it."""
    return _mesh(triangles, _unlit(colour) | {"depthTest": False}, {"flat": True}, order)


def _unlit(colour: str) -> Shape:
    return {"type": "MeshBasicMaterial", "color": int(colour[1:], 16), "side": 2, "transparent": True}


def shadows(radius: float) -> Shape:
    """Return an invisible ground that shows shadows."""
    corners = radius * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    material = {"type": "ShadowMaterial", "color": 0, "opacity": 0.22}
    material |= {"transparent": True, "depthWrite": False}
    return _mesh((corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32)), material, {}, 0)


def ribbon(points: ArrayLike, width: float) -> Triangles:
    """Return a flat band along a curve, two triangles from each point to the next.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        Points of the curve [m]; points may coincide.
    width : float
        Width of the band [m].
    """
    points = np.asarray(points, np.float64)
    tangents = directions(points)
    side = width / 2 * np.stack([-tangents[:, 1], tangents[:, 0]], axis=-1)
    edges = np.stack([points + side, points - side], axis=1).reshape(-1, 2)
    vertices = np.column_stack([edges, np.zeros(len(edges))])
    first = 2 * np.arange(max(len(points) - 1, 0), dtype=np.uint32)[:, None]
    faces = np.stack([first + np.array([0, 1, 2]), first + np.array([1, 3, 2])], axis=1).reshape(-1, 3)
    return vertices, faces.astype(np.uint32)


def directions(points: Array) -> Array:
    """Return the unit directions of a curve at its points, (n, k); where points coincide, the last one."""
    tangents = np.gradient(points, axis=0) if len(points) > 1 else np.zeros_like(points)
    length = np.hypot.reduce(tangents, axis=1)
    moving = length > 1e-9 * length.max(initial=1e-300)
    latest = np.maximum.accumulate(np.where(moving, np.arange(len(points)), 0))
    return np.asarray(tangents[latest] / np.maximum(length[latest], 1e-300)[:, None])


def bands(lines: ArrayLike, width: float) -> Triangles:
    """Return a flat band along each of many straight lines, as `ribbon` has it of one.

    Parameters
    ----------
    lines : array_like, shape (n, 2, 2)
        Start and end of each line [m], which differ.
    width : float
        Of the bands [m].
    """
    lines = np.asarray(lines, np.float64)
    tangents = lines[:, 1] - lines[:, 0]
    tangents = tangents / np.hypot(*tangents.T)[:, None]
    side = width / 2 * np.stack([-tangents[:, 1], tangents[:, 0]], axis=-1)[:, None]
    edges = np.stack([lines + side, lines - side], axis=2).reshape(-1, 2)
    first = 4 * np.arange(len(lines), dtype=np.uint32)[:, None, None]
    faces = (first + np.array([[0, 1, 2], [1, 3, 2]], np.uint32)).reshape(-1, 3)
    return np.column_stack([edges, np.zeros(len(edges))]), faces


def dashes(points: Array, dash: float, band: Callable[[Array], Triangles]) -> Triangles | None:
    """Return dashes of length `dash` along a curve, with gaps of 0.8 `dash` [m]; None without motion.

    Parameters
    ----------
    points : ndarray, shape (n, k)
        The curve [m].
    dash : float
        Length [m].
    band : callable
        Gives the triangles of a band along a part of the curve, shape (m, k).
    """
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    if lengths[-1] < _MIN_LENGTH:
        return None
    parts = []
    for start in np.arange(0.0, max(lengths[-1] - dash / 3, dash / 10), 1.8 * dash):
        end = min(start + dash, lengths[-1])
        inner = lengths[(lengths > start) & (lengths < end)]
        marks = np.concatenate([[start], inner[:: max(len(inner) // 8, 1)], [end]])
        parts.append(band(np.stack([np.interp(marks, lengths, c) for c in points.T], axis=-1)))
    return merge(parts)


def merge(parts: Sequence[Triangles]) -> Triangles:
    """Return several sets of triangles as one."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [faces + offset for (_, faces), offset in zip(parts, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces).astype(np.uint32)


def arrow(thickness: float = 0.05, sides: int = 20) -> Triangles:
    """Return an arrow of length 1 along x, round, with a head: the surface of revolution of its profile."""
    profile = [(0, 0), (0, thickness / 2), (0.72, thickness / 2), (0.72, 1.6 * thickness), (1, 0)]
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rings = [np.column_stack([np.full(sides, x), r * circle]) for x, r in profile]
    k = np.arange(sides)
    second = (k + 1) % sides
    faces = []
    for ring in range(len(rings) - 1):
        a, b = ring * sides, (ring + 1) * sides
        faces += [np.stack([a + k, a + second, b + k], -1), np.stack([a + second, b + second, b + k], -1)]
    return np.concatenate(rings), np.concatenate(faces).astype(np.uint32)


def arc_arrow(thickness: float = 0.06) -> Triangles:
    """Return an arc of 252 degrees of radius 1 about z, counterclockwise, with an arrowhead."""
    angle = np.linspace(0, 1.4 * np.pi, 40)
    ring = ribbon(np.stack([np.cos(angle), np.sin(angle)], axis=-1), 2 * thickness)
    end = np.array([np.cos(angle[-1]), np.sin(angle[-1])])
    tangent = np.array([-end[1], end[0]])
    tip = np.stack([end + 3 * thickness * end, end - 3 * thickness * end, end + 7 * thickness * tangent])
    head = np.column_stack([tip, np.zeros(3)]), np.array([[0, 1, 2]], np.uint32)
    return merge([ring, head])


def disc(inner: float = 0.0, sides: int = 48) -> Triangles:
    """Return a flat ring of radius 1 about z, or a disc for inner radius 0."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    points = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return ribbon((1 + inner) / 2 * points, 1 - inner)


def word(text: str, colour: str, height: float, *, lying: bool, order: int) -> Shape:
    """Return text that lies on the ground along x, or that faces the camera in front of all objects.

    Parameters
    ----------
    text : str
        One line.
    colour : str
        ``#rrggbb``.
    height : float
        Height of the text [m].
    lying : bool
        Whether the text lies on the ground.
    order : int
        Order of painting: objects of higher order cover those of lower order.
    """
    url, aspect = _picture(text, colour)
    shape: Shape = {"uuid": "object", "renderOrder": order, "userData": {"flat": True}}
    shape |= {"matrix": np.diag([height * aspect, height, 1.0, 1.0]).ravel().tolist()}
    material: Shape = {"uuid": "material", "map": "texture", "transparent": True, "depthWrite": False}
    result: Shape = {"metadata": {"version": 4.5, "type": "Object"}}
    result |= {"images": [{"uuid": "image", "url": url}]}
    result |= {"textures": [{"uuid": "texture", "image": "image", "minFilter": 1008, "anisotropy": 8}]}
    if lying:
        result["geometries"] = [{"uuid": "geometry", "type": "PlaneGeometry", "width": 1, "height": 1}]
        result["materials"] = [{**material, "type": "MeshBasicMaterial", "side": 2}]
        result["object"] = {**shape, "type": "Mesh", "geometry": "geometry", "material": "material"}
    else:
        result["materials"] = [{**material, "type": "SpriteMaterial", "depthTest": False}]
        result["object"] = {**shape, "type": "Sprite", "material": "material"}
    return result


def _mesh(triangles: Triangles, material: Shape, data: Shape, order: int) -> Shape:
    vertices, faces = triangles
    position = packed_array(np.ascontiguousarray(vertices, np.float32).T)
    geometry = {"attributes": {"position": position}, "index": packed_array(faces.astype(np.uint32).T)}
    shape = {"uuid": "object", "type": "Mesh", "geometry": "geometry", "material": "material"}
    return {
        "metadata": {"version": 4.5, "type": "Object"},
        "geometries": [{"uuid": "geometry", "type": "BufferGeometry", "data": geometry}],
        "materials": [{"uuid": "material", **material}],
        "object": {**shape, "renderOrder": order, "userData": data},
    }


@lru_cache(maxsize=256)
def _picture(text: str, colour: str) -> tuple[str, float]:
    """Return text with a light rim as the URL of a PNG, and the ratio of its width and height."""
    font = ImageFont.load_default(0.62 * _TEXT_HEIGHT)
    rim = _TEXT_HEIGHT // 16
    width = int(font.getlength(text)) + 6 * rim
    image = Image.new("RGBA", (width, _TEXT_HEIGHT), (255, 255, 255, 0))
    middle = (width / 2, _TEXT_HEIGHT / 2)
    light: Shape = {"stroke_width": rim, "stroke_fill": "#f6f6f4"}
    ImageDraw.Draw(image).text(middle, text, colour, font, anchor="mm", **light)
    buffer = BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode(), width / _TEXT_HEIGHT


def coarse(shape: Any, share: float) -> Any:
    """Return a mesh with about a share of its triangles; other shapes and small meshes remain unchanged.

    Vertices in one cell of a grid become one, their mean (Rossignac and Borrel, "Multi-resolution 3D
    approximations for rendering complex scenes", 1993): no triangle moves by more than a cell.

    Parameters
    ----------
    shape : coal.CollisionGeometry
        Shape to draw.
    share : float
        Share of the triangles, from 0 to 1.
    """
    count = getattr(shape, "num_tris", 0)
    if share >= 1 or count <= _FEW:
        return shape
    vertices = np.array(shape.vertices())
    triangles = (shape.tri_indices(k) for k in range(count))
    faces = np.array([[triangle[0], triangle[1], triangle[2]] for triangle in triangles])
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    size = np.sqrt(3 * area / max(share * count, _FEW))  # a surface crosses 1.5 cells per size^2
    return _standing(*_cluster(vertices, faces, max(float(size), 1e-9)))


def _cluster(vertices: Array, faces: NDArray[np.int64], cell: float) -> tuple[Array, NDArray[np.int64]]:
    keys = np.floor((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
    _, cluster = np.unique(keys, axis=0, return_inverse=True)
    cluster = cluster.ravel()
    number = np.bincount(cluster)
    means = np.column_stack([np.bincount(cluster, column) / number for column in vertices.T])
    triangles = cluster[faces]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    # The same three corners in the same sense are one triangle.
    first = np.take_along_axis(triangles, (triangles.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    return means, np.unique(first, axis=0)


def _standing(vertices: Array, faces: NDArray[np.int64]) -> Any:
    import coal

    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(vertices))
    mesh.addVertices(vertices)
    mesh.addTriangles(faces.astype(np.int32))
    mesh.endModel()
    return mesh
