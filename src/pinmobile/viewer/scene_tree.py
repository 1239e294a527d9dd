"""The stage: what is asked to be on it, nodes of meshcat's scene by path, light, ground and a camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from pinocchio.visualize import MeshcatVisualizer

from pinmobile.arrays import Array, sequence
from pinmobile.dh import DHTable
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import array, by_value, child, number, option, part
from pinmobile.robot import BODY
from pinmobile.viewer.motion import Channel, Drawn
from pinmobile.viewer.pages import Content, Visualizer
from pinmobile.viewer.shapes import Shape, coarse, shadows

_STAGE = "meshcat/stage"
_TOP, _BOTTOM = (0.90, 0.92, 0.93), (0.975, 0.975, 0.965)
_FOV, _ASPECT = np.deg2rad(35.0), 1.5
_AZIMUTH, _ELEVATION = np.deg2rad(-86.0), np.deg2rad(50.0)
_LOW = np.deg2rad(32.0)  # from where one sees what an arm does
_ABOVE, _BELOW = 0.92, 0.82  # of half the window's height; the player is below
_GHOST_SCALE = (1.07, 1.10, 1.08)  # a little larger, to be seen around a robot that it coincides with
_MOST, _MOST_OF_GHOST = 60_000, 30_000  # triangles of a robot; more are not to be seen at this distance
_GHOST_LINK = 1.06  # about its own origin: about the body's an arm would stand beside its place


class View(NamedTuple):
    """From where one looks, at what, both shape (3,) [m]."""

    eye: Array
    target: Array


@by_value
@part
class FixedCamera:
    """A camera that stays; by default where it sees all of the paths."""

    eye: Any = array(default=None, shapes=((3,),), unit="m", doc="from where one looks")
    target: Any = array(default=None, shapes=((3,),), unit="m", doc="at what one looks")


@by_value
@part
class Follow:
    """A camera that moves along with the robot, without turning."""

    distance: float = number(default=4.0, above=0.0, unit="m", doc="distance from the robot")


@by_value
@part
class Arrows:
    """Force on the base as an arrow and moment as an arc, to scale; those of arms are not drawn.

    They are the inputs Fx, Fy and Mz of the plant: one that has others is refused. By default the largest
    arrow is 1.6 times as long as the robot, and the radius of the largest arc 0.8 times.
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
            raise InvalidArgument(f"{name} has {shown(table)}, expected tables with variables y, x, psi")
    return tuple(value)


@by_value
@part
class Overlays:
    """What is shown beside the robot.

    `contacts` are drawn to one scale, in vermilion where the plant slides; they are refused of a plant that
    does not tell its ``contacts``. The end effector is that whose target the run has, or the tip of the first
    arm.
    """

    grid: bool = option(default=True, doc="floor grid with a scale")
    path: bool = option(default=True, doc="reference path, dashed")
    trail: bool = option(default=True, doc="path travelled so far")
    caption: bool = option(default=True, doc="time and position error")
    desired: bool = option(default=False, doc="desired pose, as a ghost")
    body_frame: bool = option(default=False, doc="axes x_B, y_B and z_B")
    frames: Sequence[DHTable] = option(
        default=(), check=_tables, doc="tables whose frames are drawn as triads"
    )
    arrows: Arrows | None = child(Arrows, default=None, optional=True, expected="Arrows", doc="arrows")
    contacts: bool = option(default=False, doc="forces of the ground, with their friction discs")
    centre: bool = option(default=False, doc="instantaneous centre of rotation, and the way there")
    end_effector: bool = option(default=True, doc="path, trail and caption of an arm's end effector too")
    camera: FixedCamera | Follow = child(
        (FixedCamera, Follow),
        default=FixedCamera(),
        expected="a FixedCamera or Follow",
        doc="from where one looks",
    )


class Extent(NamedTuple):
    """The part of the plane that matters, and the size of what moves in it."""

    low: Array  # (2,) [m]
    high: Array  # (2,) [m]
    size: tuple[float, float, float]  # of the robot [m]

    @property
    def centre(self) -> Array:
        """Shape (2,) [m]."""
        return (self.low + self.high) / 2

    @property
    def radius(self) -> float:
        """Of the circle around it [m]."""
        return float(np.hypot(*(self.high - self.low)) / 2)

    @property
    def unit(self) -> float:
        """Length of the robot, or more where it is a speck in the scene [m]; overlays scale with it."""
        return max(self.size[0], 0.06 * self.radius)

    @property
    def dash(self) -> float:
        """Length of the dashes of a path [m]."""
        return max(0.028 * self.radius, 0.05 * self.unit)

    @property
    def step(self) -> float:
        """Of the grid [m]: 1, 2 or 5 times a power of ten, some ten to the extent."""
        span = float((self.high - self.low).max()) + 2 * self.unit
        power = 10.0 ** np.floor(np.log10(span / 10))
        return float(next(power * factor for factor in (1, 2, 5, 10) if power * factor >= span / 14))

    @property
    def tall(self) -> float:
        """Height of the words on the ground [m]."""
        return 0.05 * float((self.high - self.low).max() + 3 * self.unit)

    def lines(self, axis: int) -> Array:
        """Return where the lines of the grid cross an axis, shape (n,) [m]."""
        room = 0.8 * self.unit
        first = np.floor((self.low[axis] - room) / self.step)
        last = np.ceil((self.high[axis] + room) / self.step)
        return np.asarray(self.step * np.arange(first, last + 1))


class Stage:
    """Nodes in a window.

    Parameters
    ----------
    window : LiveWindow or OfflineWindow
        Where they are.
    """

    def __init__(self, window: Any) -> None:
        self.window = window

    def put(self, path: str, shape: Shape) -> None:
        """Show a shape at a node; what was there is replaced."""
        shape["object"]["uuid"] = path  # animations tell objects apart by it
        self.window.send(Content({"type": "set_object", "path": path, "object": shape}))

    def set(self, path: str, name: str, value: object) -> None:
        """Set a property of a node."""
        self.window.send(Content({"type": "set_property", "path": path, "property": name, "value": value}))

    def tell(self, name: str, value: object) -> None:
        """Set a property of the stage itself, which its page reads."""
        self.set(_STAGE, name, value)

    def remove(self, path: str) -> None:
        """Remove a node and all below it."""
        self.window.send(Content({"type": "delete", "path": path}))

    def show(self, channels: list[Channel], frame: int) -> None:
        """Put everything that moves where it is at a frame."""
        for channel in channels:
            self.set(channel.path, channel.name, channel.at(frame))

    def furnish(self, extent: Extent, view: View) -> None:
        """Make the empty stage: background, soft light, ground, camera."""
        for name in ("Grid", "Axes", "Lights/PointLightNegativeX", "Lights/PointLightPositiveX"):
            self.set(name, "visible", False)
        self.set("Background", "top_color", list(_TOP))
        self.set("Background", "bottom_color", list(_BOTTOM))
        self.set("Lights/AmbientLight/<object>", "intensity", 0.62)
        self.set("Lights/FillLight/<object>", "intensity", 0.2)
        lit = 2.0 * float(np.linalg.norm(extent.size))
        self.put("meshcat/ground", shadows(2.0 * lit))  # it goes along with the light
        self.set("meshcat/focus", "position", [0.0, 0.0, 0.0])
        self.tell("lit", lit)
        self.tell("aspect", _ASPECT)
        self.tell("caption", "")
        self.tell("legend", [])
        self.tell("eye", view.eye.tolist())
        self.tell("target", view.target.tolist())

    def robot(self, path: str, robot: Drawn, colour: str | None, *, ghost: bool = False) -> None:
        """Load a robot's geometry below a node, whose pose is then the robot's.

        Parameters
        ----------
        path : str
            The node.
        robot : MobileRobot or Drawing
            Whose ``visual_model`` is drawn, its meshes coarser where they have very many triangles.
        colour : str, optional
            Of its box, or of all of a ghost; by default its own.
        ghost : bool
            Translucent, and a little larger.
        """
        shown, items = pin.GeometryModel(), robot.visual_model.geometryObjects
        triangles = sum(getattr(item.geometry, "num_tris", 0) for item in items)
        share = (_MOST_OF_GHOST if ghost else _MOST) / max(triangles, 1)
        for item in items:
            copy = item.copy()
            copy.geometry = coarse(item.geometry, share)
            if colour is not None and (ghost or item.name == BODY):
                copy.meshColor = np.array([*_rgb(colour), 1.0])
            if ghost:
                copy.meshColor = np.array([*copy.meshColor[:3], 0.45])
            shown.addGeometryObject(copy)
        visualizer = MeshcatVisualizer(robot.model, pin.GeometryModel(), shown)
        visualizer.initViewer(viewer=Visualizer(window=self.window))
        visualizer.loadViewerModel(path.removeprefix("meshcat/"))
        # The body is then at the origin: the node's pose does the rest.
        visualizer.display(pin.neutral(robot.model))
        self.set(path, "scale", list(_GHOST_SCALE) if ghost and not robot.mounts else [1.0, 1.0, 1.0])
        if ghost and robot.mounts:
            for item in shown.geometryObjects:
                larger = _GHOST_SCALE if item.name == BODY else (_GHOST_LINK,) * 3
                self.set(f"{path}/visuals/{item.name}", "scale", list(larger))


def overview(extent: Extent, height: float, *, low: bool = False) -> View:
    """Return a view from the south and above in which all of the extent fits a window of usual shape.

    Parameters
    ----------
    extent : Extent
        What is seen.
    height : float
        Of what stands there [m].
    low : bool
        From not so far above.
    """
    elevation = _LOW if low else _ELEVATION
    forward = -np.array(
        [np.cos(elevation) * np.cos(_AZIMUTH), np.cos(elevation) * np.sin(_AZIMUTH), np.sin(elevation)]
    )
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    (low_x, *_, high_x), (low_y, *_, high_y) = extent.lines(0), extent.lines(1)
    xs, ys = (low_x - 2.2 * extent.tall, high_x + 2.6 * extent.tall), (low_y - 1.4 * extent.tall, high_y)
    corners = np.array([[x, y, z] for x in xs for y in ys for z in (0, height)])
    target = np.append(extent.centre, 0.0)
    tangent = np.tan(_FOV / 2)
    for _ in range(10):
        a, b, c = np.stack([right, up, forward]) @ (corners - target).T
        wide = (np.abs(a) / (0.97 * _ASPECT * tangent) - c).max()
        tall = np.maximum(b / (_ABOVE * tangent) - c, -b / (_BELOW * tangent) - c).max()
        distance = max(wide, tall)
        rise, aside = b / (distance + c), a / (distance + c)
        target = target + up * distance * (rise.max() + rise.min() - (_ABOVE - _BELOW) * tangent) / 2
        target = target + right * distance * (aside.max() + aside.min()) / 2
        target = target - forward * target[2] / forward[2]  # back onto the ground
    return View(target - distance * forward, target)


def _rgb(colour: str) -> tuple[float, ...]:
    return tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
