"""The stage: overlays and cameras, nodes of the meshcat scene by path, light and ground."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from pinocchio.visualize import MeshcatVisualizer

from pinmobile.arrays import Array, sequence
from pinmobile.dh import DHTable
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.parts import array, by_value, child, number, option, part
from pinmobile.robot import BODY
from pinmobile.viewer.motion import Channel, Drawn
from pinmobile.viewer.pages import Content, Visualizer
from pinmobile.viewer.shapes import Shape, coarse, shadows

_STAGE = "meshcat/stage"
_TOP, _BOTTOM = (0.90, 0.92, 0.93), (0.975, 0.975, 0.965)
_FOV, _ASPECT = np.deg2rad(35.0), 1.5
_AZIMUTH, _ELEVATION = np.deg2rad(-86.0), np.deg2rad(50.0)
_LOW = np.deg2rad(32.0)  # elevation that shows the motion of an arm
_ABOVE, _BELOW = 0.92, 0.82  # used shares of half the window height; the player is below
_GHOST_SCALE = (1.07, 1.10, 1.08)  # a ghost is a little larger, so that its rim shows around a solid robot
_MOST, _MOST_OF_GHOST = 60_000, 30_000  # largest number of triangles; more are not visible
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

    force: float | None = number(
        default=None, optional=True, above=0.0, unit="m/N", doc="length of the arrow"
    )
    moment: float | None = number(
        default=None, optional=True, above=0.0, unit="m/(N m)", doc="radius of the arc"
    )


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
    arrows: Arrows | None = child(Arrows, default=None, optional=True, expected="Arrows", doc="arrows")
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
    def tall(self) -> float:
        """Height of text on the ground [m]."""
        return 0.05 * float((self.high - self.low).max() + 3 * self.unit)

    def lines(self, axis: int) -> Array:
        """Return the positions of the grid lines along an axis, shape (n,) [m]."""
        room = 0.8 * self.unit
        first = np.floor((self.low[axis] - room) / self.step)
        last = np.ceil((self.high[axis] + room) / self.step)
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

    def tell(self, name: str, value: object) -> None:
        """Set a property of the stage. The page reads these properties."""
        self.set(_STAGE, name, value)

    def remove(self, path: str) -> None:
        """Remove a node and all nodes below it."""
        self.window.send(Content({"type": "delete", "path": path}))

    def show(self, channels: list[Channel], frame: int) -> None:
        """Set all channels to their values at a frame."""
        for channel in channels:
            self.set(channel.path, channel.name, channel.at(frame))

    def furnish(self, extent: Extent, view: View) -> None:
        """Set up the empty stage: background, soft light, ground, camera."""
        for name in ("Grid", "Axes", "Lights/PointLightNegativeX", "Lights/PointLightPositiveX"):
            self.set(name, "visible", False)
        self.set("Background", "top_color", list(_TOP))
        self.set("Background", "bottom_color", list(_BOTTOM))
        self.set("Lights/AmbientLight/<object>", "intensity", 0.62)
        self.set("Lights/FillLight/<object>", "intensity", 0.2)
        lit = 2.0 * float(np.linalg.norm(extent.size))
        self.put("meshcat/ground", shadows(2.0 * lit))  # the ground moves with the light
        self.set("meshcat/focus", "position", [0.0, 0.0, 0.0])
        self.tell("lit", lit)
        self.tell("aspect", _ASPECT)
        self.tell("caption", "")
        self.tell("legend", [])
        self.tell("eye", view.eye.tolist())
        self.tell("target", view.target.tolist())

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
        geometry, items = pin.GeometryModel(), robot.visual_model.geometryObjects
        triangles = sum(getattr(item.geometry, "num_tris", 0) for item in items)
        share = (_MOST_OF_GHOST if ghost else _MOST) / max(triangles, 1)
        for item in items:
            copy = item.copy()
            copy.geometry = coarse(item.geometry, share)
            if colour is not None and (ghost or item.name == BODY):
                copy.meshColor = np.array([*_rgb(colour), 1.0])
            if ghost:
                copy.meshColor = np.array([*copy.meshColor[:3], 0.45])
            geometry.addGeometryObject(copy)
        visualizer = MeshcatVisualizer(robot.model, pin.GeometryModel(), geometry)
        visualizer.initViewer(viewer=Visualizer(window=self.window))
        visualizer.loadViewerModel(path.removeprefix("meshcat/"))
        # The body is at the origin of the node; the pose of the node moves it.
        visualizer.display(pin.neutral(robot.model))
        self.set(path, "scale", list(_GHOST_SCALE) if ghost and not robot.mounts else [1.0, 1.0, 1.0])
        if ghost and robot.mounts:
            for item in geometry.geometryObjects:
                larger = _GHOST_SCALE if item.name == BODY else (_GHOST_LINK,) * 3
                self.set(f"{path}/visuals/{item.name}", "scale", list(larger))


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
    elevation = _LOW if low else _ELEVATION
    level = np.cos(elevation)
    forward = -np.array([level * np.cos(_AZIMUTH), level * np.sin(_AZIMUTH), np.sin(elevation)])
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    vertical = np.cross(right, forward)
    (low_x, *_, high_x), (low_y, *_, high_y) = extent.lines(0), extent.lines(1)
    xs, ys = (low_x - 2.2 * extent.tall, high_x + 2.6 * extent.tall), (low_y - 1.4 * extent.tall, high_y)
    corners = np.array([[x, y, z] for x in xs for y in ys for z in (0, height)])
    target = np.append(extent.centre, 0.0)
    tangent = np.tan(_FOV / 2)
    for _ in range(10):
        a, b, c = np.stack([right, vertical, forward]) @ (corners - target).T
        wide = (np.abs(a) / (0.97 * _ASPECT * tangent) - c).max()
        tall = np.maximum(b / (_ABOVE * tangent) - c, -b / (_BELOW * tangent) - c).max()
        distance = max(wide, tall)
        rise, lateral = b / (distance + c), a / (distance + c)
        target = target + vertical * distance * (rise.max() + rise.min() - (_ABOVE - _BELOW) * tangent) / 2
        target = target + right * distance * (lateral.max() + lateral.min()) / 2
        target = target - forward * target[2] / forward[2]  # projected onto the ground
    return View(target - distance * forward, target)


def _rgb(colour: str) -> tuple[float, ...]:
    return tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
