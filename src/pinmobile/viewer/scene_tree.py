"""The stage of a scene: its shapes, overlays and cameras, meshcat nodes by path, light and ground."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from functools import lru_cache
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont
from pinocchio.visualize import MeshcatVisualizer

from pinmobile.arrays import Array, ArrayLike, sequence
from pinmobile.dh import DHTable
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.parts import array, by_value, child, number, option, part
from pinmobile.robot import BODY, Mesh, merge_meshes, mesh_of, revolve
from pinmobile.viewer.motion import Channel, Drawn
from pinmobile.viewer.pages import Content, Visualizer, pack_array

Shape = dict[str, Any]

_TEXT_HEIGHT = 64  # [px]
_MIN_LENGTH = 1e-6  # [m]: a shorter motion has no path
_MIN_TRIANGLES = 300  # smallest number of triangles: simplification would destroy small meshes


def flat(triangles: Mesh, colour: str, *, order: int, opacity: float = 1.0, trail: bool = False) -> Shape:
    """Return an unlit mesh on the ground, painted over those of lower `order` without regard to depth.

    A `trail` shows as many vertices as its property ``drawn`` says, at first none.
    """
    material = _material(colour) | {"opacity": opacity, "depthWrite": False}
    return _mesh(triangles, material, {"flat": True, "trail": trail}, order)


def overlay(triangles: Mesh, colour: str, *, order: int) -> Shape:
    """Return an unlit mesh that is visible through objects in front of it."""
    return _mesh(triangles, _material(colour) | {"depthTest": False}, {"flat": True}, order)


def _material(colour: str) -> Shape:
    return {"type": "MeshBasicMaterial", "color": int(colour[1:], 16), "side": 2, "transparent": True}


def shadow_ground(radius: float) -> Shape:
    """Return an invisible ground that shows shadows."""
    corners = radius * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    material = {"type": "ShadowMaterial", "color": 0, "opacity": 0.22}
    material |= {"transparent": True, "depthWrite": False}
    return _mesh((corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32)), material, {}, 0)


def ribbon(points: ArrayLike, width: float) -> Mesh:
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
    is_moving = length > 1e-9 * length.max(initial=1e-300)
    latest = np.maximum.accumulate(np.where(is_moving, np.arange(len(points)), 0))
    return np.asarray(tangents[latest] / np.maximum(length[latest], 1e-300)[:, None])


def bands(lines: ArrayLike, width: float) -> Mesh:
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


def dashes(points: Array, dash: float, band: Callable[[Array], Mesh]) -> Mesh | None:
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
    arc_length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    if arc_length[-1] < _MIN_LENGTH:
        return None
    parts = []
    for start in np.arange(0.0, max(arc_length[-1] - dash / 3, dash / 10), 1.8 * dash):
        end = min(start + dash, arc_length[-1])
        inner = arc_length[(arc_length > start) & (arc_length < end)]
        samples = np.concatenate([[start], inner[:: max(len(inner) // 8, 1)], [end]])
        parts.append(band(np.stack([np.interp(samples, arc_length, c) for c in points.T], axis=-1)))
    return merge_meshes(parts)


def arrow(thickness: float) -> Mesh:
    """Return an arrow of length 1 along x, round, with a head: the surface of revolution of its profile."""
    profile = [(0, 0), (0, thickness / 2), (0.72, thickness / 2), (0.72, 1.6 * thickness), (1, 0)]
    vertices, faces = revolve(profile, sides=20)
    return vertices[:, [1, 2, 0]], faces


def arc_arrow(thickness: float = 0.06) -> Mesh:
    """Return an arc of 252 degrees of radius 1 about z, counterclockwise, with an arrowhead."""
    angle = np.linspace(0, 1.4 * np.pi, 40)
    ring = ribbon(np.stack([np.cos(angle), np.sin(angle)], axis=-1), 2 * thickness)
    end = np.array([np.cos(angle[-1]), np.sin(angle[-1])])
    tangent = np.array([-end[1], end[0]])
    tip = np.stack([end + 3 * thickness * end, end - 3 * thickness * end, end + 7 * thickness * tangent])
    head = np.column_stack([tip, np.zeros(3)]), np.array([[0, 1, 2]], np.uint32)
    return merge_meshes([ring, head])


def disc(inner: float = 0.0, sides: int = 48) -> Mesh:
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


def _mesh(triangles: Mesh, material: Shape, data: Shape, order: int) -> Shape:
    vertices, faces = triangles
    position = pack_array(np.ascontiguousarray(vertices, np.float32).T)
    geometry = {"attributes": {"position": position}, "index": pack_array(faces.astype(np.uint32).T)}
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


_MOST_FINER = 6  # halvings of the first guess of a cell


def simplify(shape: Any, share: float) -> Any:
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
    if share >= 1 or count <= _MIN_TRIANGLES:
        return shape
    triangles = (shape.tri_indices(k) for k in range(count))
    faces = np.array([[triangle[0], triangle[1], triangle[2]] for triangle in triangles], dtype=np.int64)
    return _coarse(np.array(shape.vertices(), dtype=float).tobytes(), faces.tobytes(), share)


@lru_cache(maxsize=32)
def _coarse(vertex_data: bytes, face_data: bytes, share: float) -> Any:
    """Return the simplified mesh of vertices and faces, see `simplify`."""
    vertices = np.frombuffer(vertex_data).reshape(-1, 3)
    faces = np.frombuffer(face_data, dtype=np.int64).reshape(-1, 3)
    count = len(faces)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area, most = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2, share * count
    # A surface crosses 1.5 cells per size^2. Where small triangles are crowded, many fit into such a cell.
    cell = max(np.sqrt(3 * area / max(most, _MIN_TRIANGLES)), 1e-9)
    coarse = _cluster(vertices, faces, cell)
    for k in range(1, 2 * _MOST_FINER + 1):
        finer = _cluster(vertices, faces, cell * 2 ** (-k / 2))
        if len(finer[1]) > most:
            break
        coarse = finer
    return mesh_of(*coarse)


def _cluster(vertices: Array, faces: NDArray[np.int64], cell: float) -> tuple[Array, NDArray[np.int64]]:
    keys = np.floor((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
    _, cluster = np.unique(keys, axis=0, return_inverse=True)
    cluster = cluster.ravel()
    number = np.bincount(cluster)
    means = np.column_stack([np.bincount(cluster, column) / number for column in vertices.T])
    merged = cluster[faces]
    a, b, c = merged.T
    merged = merged[(a != b) & (b != c) & (c != a)]
    # The same three corners in the same sense are one triangle.
    first = np.take_along_axis(merged, (merged.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    return means, np.unique(first, axis=0)


_STAGE = "meshcat/stage"
_TOP, _BOTTOM = (0.90, 0.92, 0.93), (0.975, 0.975, 0.965)
_FOV, _ASPECT = np.deg2rad(35.0), 1.5
_AZIMUTH, _ELEVATION = np.deg2rad(-86.0), np.deg2rad(50.0)
_LOW_ELEVATION = np.deg2rad(32.0)  # elevation that shows the motion of an arm
_UPPER, _LOWER = 0.92, 0.82  # used shares of half the window height; the player is below
_GHOST_SCALE = (1.07, 1.10, 1.08)  # a ghost is a little larger, so that its rim shows around a solid robot
_MAX_TRIANGLES, _MAX_GHOST_TRIANGLES = 60_000, 30_000  # largest number of triangles; more are not visible
_GHOST_LINK = 1.06  # scale of a link about its own origin: a scale about the body would displace arms


class View(NamedTuple):
    """Camera position and target point, shape (3,) each [m]."""

    eye: Array
    target: Array


@by_value
@part
class FixedCamera:
    """A fixed camera.

    Parameters
    ----------
    eye : array_like, shape (3,), optional
        Position of the camera in the inertial frame [m]; default: all paths are in view.
    target : array_like, shape (3,), optional
        Point at the centre of the picture [m]; default: all paths are in view.

    Raises
    ------
    InvalidArgument
        If a point has another shape or is not finite.

    See Also
    --------
    viewer.Follow : a camera that moves with the robot
    viewer.Overlays : its field ``camera``

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.viewer import FixedCamera, Overlays, Viewer
    >>> camera = FixedCamera(eye=(4, 0, 2), target=(0, 0, 0))
    >>> overlays = Overlays(camera=camera)
    >>> viewer = Viewer(MobileRobot.lecture(), overlays=overlays)
    >>> viewer.overlays.camera.eye  # [m]
    array([4., 0., 2.])
    """

    eye: Any = array(default=None, shapes=((3,),), unit="m", doc="position of the camera")
    target: Any = array(default=None, shapes=((3,),), unit="m", doc="point at the centre of the picture")


@by_value
@part
class Follow:
    """A camera that moves with the robot without turning.

    Parameters
    ----------
    distance : float
        Distance of the camera from the robot [m].

    Raises
    ------
    InvalidArgument
        If `distance` is not positive.

    See Also
    --------
    viewer.FixedCamera : a camera that does not move
    viewer.Overlays : its field ``camera``

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.viewer import Follow, Overlays, Viewer
    >>> overlays = Overlays(camera=Follow(distance=3.0))
    >>> viewer = Viewer(MobileRobot.lecture(), overlays=overlays)
    >>> viewer.overlays.camera
    Follow(distance=3.0)
    """

    distance: float = number(default=4.0, above=0.0, unit="m", doc="distance from the robot")


@by_value
@part
class Arrows:
    """Arrows to scale: the force on the base as an arrow, and the moment as an arc.

    The arrows show the inputs Fx, Fy and Mz of the plant. Inputs of arms have no arrows.

    Parameters
    ----------
    force : float, optional
        Length of the arrow per force [m/N]; default: the largest arrow is 1.6 times as long as the robot.
    moment : float, optional
        Radius of the arc per moment [m/(N m)]; default: the largest radius is 0.8 times the length of the
        robot.

    Raises
    ------
    InvalidArgument
        If a scale is not positive. `Viewer.record` and `Viewer.play` raise it for a plant without these
        inputs.

    See Also
    --------
    viewer.Overlays : its field ``arrows``
    plots.forces : the inputs over time as a figure

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.viewer import Arrows, Overlays, Viewer
    >>> overlays = Overlays(arrows=Arrows(force=0.02))  # 1 m: 50 N
    >>> viewer = Viewer(MobileRobot.lecture(), overlays=overlays)
    >>> viewer.overlays.arrows.force  # [m/N]
    0.02
    """

    force: float | None = number(default=None, above=0.0, unit="m/N", doc="length of the arrow")
    moment: float | None = number(default=None, above=0.0, unit="m/(N m)", doc="radius of the arc")


def _tables(name: str, value: Any) -> tuple[DHTable, ...]:
    for table in sequence(name, value, "a sequence of DHTable"):
        if not isinstance(table, DHTable) or table.variables != ("y", "x", "psi"):
            raise InvalidArgument(
                f"{name} has {format_value(table)}, expected tables with variables y, x, psi"
            )
    return tuple(value)


@by_value
@part
class Overlays:
    """Objects beside the robot in a scene.

    Parameters
    ----------
    grid : bool
        Grid on the floor with numbers in metres.
    path : bool
        Reference path, dashed.
    trail : bool
        Travelled path up to the present time.
    caption : bool
        Time and position error.
    desired : bool
        Desired pose as a translucent robot.
    body_frame : bool
        Axes x_B, y_B and z_B of the body frame.
    frames : sequence of DHTable
        DH tables with variables y, x, psi; their frames are drawn as triads.
    arrows : Arrows, optional
        Force and moment on the base.
    contacts : bool
        Contact forces with their friction discs, to one scale; orange where a contact slides. They need a
        plant with ``contacts``, such as a `WheeledRobot`.
    centre : bool
        Instantaneous centre of rotation, and the line to it. It also needs ``contacts``.
    end_effector : bool
        Path, trail and caption of an end effector: the one with a target, or the tip of the first arm.
    camera : FixedCamera or Follow
        Camera.

    Raises
    ------
    InvalidArgument
        If a field is invalid. `Viewer.record` and `Viewer.play` raise it for a plant without the quantities.

    See Also
    --------
    viewer.Viewer : its argument ``overlays``
    viewer.Arrows : force and moment on the base

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import simulate
    >>> from pinmobile.viewer import Arrows, Overlays, Viewer
    >>> robot, circle = MobileRobot(30.0, 1.3), Circle(1.0, 1.0, 1.0)
    >>> run = simulate(robot, PD(9, 6), Tangent(circle), dt=0.1)
    >>> overlays = Overlays(desired=True, arrows=Arrows())
    >>> Viewer(robot).record(run, overlays=overlays, fps=10)
    <Recording: 1 s, 10 frames per second, 1 times as fast>
    """

    grid: bool = option(default=True, doc="floor grid with a scale")
    path: bool = option(default=True, doc="reference path, dashed")
    trail: bool = option(default=True, doc="travelled path")
    caption: bool = option(default=True, doc="time and position error")
    desired: bool = option(default=False, doc="desired pose as a translucent robot")
    body_frame: bool = option(default=False, doc="axes x_B, y_B and z_B")
    frames: Sequence[DHTable] = option(
        default=(), check=_tables, doc="DH tables whose frames are drawn as triads"
    )
    arrows: Arrows | None = child(Arrows, default=None, expected="Arrows", doc="arrows")
    contacts: bool = option(default=False, doc="contact forces with their friction discs")
    centre: bool = option(default=False, doc="instantaneous centre of rotation, and the line to it")
    end_effector: bool = option(default=True, doc="path, trail and caption of an end effector")
    camera: FixedCamera | Follow = child(
        (FixedCamera, Follow), default=FixedCamera(), expected="a FixedCamera or Follow", doc="camera"
    )


class Extent(NamedTuple):
    """Rectangle of the plane that contains the motion, and the size of the robot."""

    low: Array  # (2,) [m]
    high: Array  # (2,) [m]
    size: tuple[float, float, float]  # of the robot [m]

    @property
    def centre(self) -> Array:
        """Centre of the rectangle, shape (2,) [m]."""
        return (self.low + self.high) / 2

    @property
    def radius(self) -> float:
        """Radius of the circle around the rectangle [m]."""
        return float(np.hypot(*(self.high - self.low)) / 2)

    @property
    def unit(self) -> float:
        """Length to which overlays scale [m]: the length of the robot, or more in a large scene."""
        return max(self.size[0], 0.06 * self.radius)

    @property
    def dash(self) -> float:
        """Length of the dashes of a path [m]."""
        return max(0.028 * self.radius, 0.05 * self.unit)

    @property
    def step(self) -> float:
        """Step of the grid [m]: 1, 2 or 5 times a power of ten, about a tenth of the extent."""
        span = float((self.high - self.low).max()) + 2 * self.unit
        power = 10.0 ** np.floor(np.log10(span / 10))
        return float(next(power * factor for factor in (1, 2, 5, 10) if power * factor >= span / 14))

    @property
    def font(self) -> float:
        """Height of text on the ground [m]."""
        return 0.05 * float((self.high - self.low).max() + 3 * self.unit)

    def lines(self, axis: int) -> Array:
        """Return the positions of the grid lines along an axis, shape (n,) [m]."""
        margin = 0.8 * self.unit
        first = np.floor((self.low[axis] - margin) / self.step)
        last = np.ceil((self.high[axis] + margin) / self.step)
        return np.asarray(self.step * np.arange(first, last + 1))


class Stage:
    """Nodes of a scene in a window.

    Parameters
    ----------
    window : LiveWindow or OfflineWindow
        Window of the scene.
    """

    def __init__(self, window: Any) -> None:
        self.window = window

    def put(self, path: str, shape: Shape) -> None:
        """Show a shape at a node, in place of the previous shape."""
        shape["object"]["uuid"] = path  # animations identify objects by the uuid
        self.window.send(Content({"type": "set_object", "path": path, "object": shape}))

    def set(self, path: str, name: str, value: object) -> None:
        """Set a property of a node."""
        self.window.send(Content({"type": "set_property", "path": path, "property": name, "value": value}))

    def publish(self, name: str, value: object) -> None:
        """Set a property of the stage. The page reads these properties."""
        self.set(_STAGE, name, value)

    def remove(self, path: str) -> None:
        """Remove a node and all nodes below it."""
        self.window.send(Content({"type": "delete", "path": path}))

    def show(self, channels: list[Channel], frame: int) -> None:
        """Set all channels to their values at a frame."""
        for channel in channels:
            self.set(channel.path, channel.name, channel.at(frame))

    def set_up(self, extent: Extent, view: View) -> None:
        """Set up the empty stage: background, soft light, ground, camera."""
        for name in ("Grid", "Axes", "Lights/PointLightNegativeX", "Lights/PointLightPositiveX"):
            self.set(name, "visible", False)
        self.set("Background", "top_color", list(_TOP))
        self.set("Background", "bottom_color", list(_BOTTOM))
        self.set("Lights/AmbientLight/<object>", "intensity", 0.62)
        self.set("Lights/FillLight/<object>", "intensity", 0.2)
        light_size = 2.0 * float(np.linalg.norm(extent.size))
        self.put("meshcat/ground", shadow_ground(2.0 * light_size))  # the ground moves with the light
        self.set("meshcat/focus", "position", [0.0, 0.0, 0.0])
        self.publish("lit", light_size)
        self.publish("aspect", _ASPECT)
        self.publish("caption", "")
        self.publish("legend", [])
        self.publish("eye", view.eye.tolist())
        self.publish("target", view.target.tolist())

    def robot(self, path: str, robot: Drawn, colour: str | None, *, ghost: bool = False) -> None:
        """Load the visual geometry of a robot below a node. The pose of the node is the pose of the robot.

        Parameters
        ----------
        path : str
            Path of the node.
        robot : MobileRobot or Drawing
            Robot to draw. Meshes with very many triangles are simplified.
        colour : str, optional
            Colour of the box, or of all objects of a ghost; default: the colours of the robot.
        ghost : bool
            Whether to draw a translucent and slightly larger robot.
        """
        model, items = pin.GeometryModel(), robot.visual_model.geometryObjects
        triangles = sum(getattr(item.geometry, "num_tris", 0) for item in items)
        share = (_MAX_GHOST_TRIANGLES if ghost else _MAX_TRIANGLES) / max(triangles, 1)
        for item in items:
            copy = item.copy()
            copy.geometry = simplify(item.geometry, share)
            if colour is not None and (ghost or item.name == BODY):
                copy.meshColor = np.array([*ImageColor.getrgb(colour), 255]) / 255
            if ghost:
                copy.meshColor = np.array([*copy.meshColor[:3], 0.45])
            model.addGeometryObject(copy)
        visualizer = MeshcatVisualizer(robot.model, pin.GeometryModel(), model)
        visualizer.initViewer(viewer=Visualizer(window=self.window))
        visualizer.loadViewerModel(path.removeprefix("meshcat/"))
        # The body is at the origin of the node; the pose of the node moves it.
        visualizer.display(pin.neutral(robot.model))
        self.set(path, "scale", list(_GHOST_SCALE) if ghost and not robot.mounts else [1.0, 1.0, 1.0])
        if ghost and robot.mounts:
            for item in model.geometryObjects:
                scale = _GHOST_SCALE if item.name == BODY else (_GHOST_LINK,) * 3
                self.set(f"{path}/visuals/{item.name}", "scale", list(scale))


def overview(extent: Extent, height: float, *, low: bool = False) -> View:
    """Return a view from the south and above that shows the whole extent in a window of usual shape.

    Parameters
    ----------
    extent : Extent
        Visible part of the plane.
    height : float
        Height of the robot [m].
    low : bool
        Whether to look from a lower elevation.
    """
    elevation = _LOW_ELEVATION if low else _ELEVATION
    level = np.cos(elevation)
    forward = -np.array([level * np.cos(_AZIMUTH), level * np.sin(_AZIMUTH), np.sin(elevation)])
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    (low_x, *_, high_x), (low_y, *_, high_y) = extent.lines(0), extent.lines(1)
    xs, ys = (low_x - 2.2 * extent.font, high_x + 2.6 * extent.font), (low_y - 1.4 * extent.font, high_y)
    corners = np.array([[x, y, z] for x in xs for y in ys for z in (0, height)])
    target = np.append(extent.centre, 0.0)
    tangent = np.tan(_FOV / 2)
    for _ in range(10):
        a, b, c = np.stack([right, up, forward]) @ (corners - target).T
        width = (np.abs(a) / (0.97 * _ASPECT * tangent) - c).max()
        depth = np.maximum(b / (_UPPER * tangent) - c, -b / (_LOWER * tangent) - c).max()
        distance = max(width, depth)
        rise, shift = b / (distance + c), a / (distance + c)
        target = target + up * distance * (rise.max() + rise.min() - (_UPPER - _LOWER) * tangent) / 2
        target = target + right * distance * (shift.max() + shift.min()) / 2
        target = target - forward * target[2] / forward[2]  # projected onto the ground
    return View(target - distance * forward, target)
