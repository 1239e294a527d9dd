"""Markers in the scene: ramps, contact forces, friction discs, instantaneous centre, end effectors."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

import pinmobile.viewer.scene_tree as shapes
from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument, PinmobileError, format_value
from pinmobile.loop import EndEffector, Rollout
from pinmobile.palette import GRIPS, INK, QUIET, SLIDES, colour
from pinmobile.parts import Touching, able
from pinmobile.plant import Contacts, robot_at, stated
from pinmobile.robot import Mesh
from pinmobile.signals import Signal
from pinmobile.viewer.motion import Channel, pose_channels, samples_before
from pinmobile.viewer.scene_tree import Extent, Stage, View

_ORDER = 20  # above objects on the ground, below objects that are visible through all others
_SIDES = 6
_MAX_POINTS = 2500  # points of a trail at most
_TRAIL_WIDTH, _TARGET_WIDTH = 0.034, 0.022  # thickness, in lengths of the robot
_LENGTH_TOLERANCE = 1e-6  # [m]: a shorter motion has no path


def effector_of(run: Rollout) -> EndEffector | None:
    """Return the end effector of a run: the one with a target, or the tip of the first arm; or None."""
    if not getattr(run.plant, "mounts", ()):
        return None
    try:
        return run.end_effector()
    except PinmobileError:  # a description of a plant cannot compute poses
        return None


def draw_end_effector(
    stage: Stage, index: int, effector: EndEffector, times: Array, extent: Extent, *, path: bool, trail: bool
) -> list[Channel]:
    """Draw the target path of an end effector, dashed, and its travelled path, and return the channels.

    Parameters
    ----------
    stage : Stage
        Stage of the scene.
    index : int
        Index of the run.
    effector : EndEffector
        End effector of the run.
    times : ndarray, shape (n,)
        Times of the frames [s].
    extent : Extent
        Extent of the scene, which gives the sizes.
    path, trail : bool
        Whether to draw the target path, and the travelled path.
    """
    node = f"meshcat/hand{index}"
    if path and effector.target is not None:
        points = effector.target[:: max(len(effector.target) // _MAX_POINTS, 1), :3, 3]
        bands = shapes.dashes(points, extent.dash, lambda part: tube(part, _TARGET_WIDTH * extent.unit))
        if bands is not None:
            stage.put(f"{node}/target", shapes.flat(bands, INK, order=_ORDER + 5))
    if not trail or float(np.ptp(effector.position, axis=0).max()) < _LENGTH_TOLERANCE:
        return []
    band = partial(tube, thickness=_TRAIL_WIDTH * extent.unit)
    motion, path_of = (effector.t, effector.position), f"{node}/trail"
    return draw_trail(stage, path_of, motion, times, band, color=colour(index), order=_ORDER + index)


def draw_trail(
    stage: Stage,
    path: str,
    motion: tuple[Array, Array],
    times: Array,
    band: Callable[[Array], Mesh],
    *,
    color: str,
    order: int,
) -> list[Channel]:
    """Draw a band along the travelled path, and return the channel of its visible part.

    Parameters
    ----------
    stage : Stage
        Stage of the scene.
    path : str
        Path of the node.
    motion : tuple of ndarray, shape (N,) and (N, k)
        Times [s] and points [m].
    times : ndarray, shape (n,)
        Times of the frames [s].
    band : callable
        Function from points to the triangles of a band, with the same number between successive points.
    color : str
        Colour.
    order : int
        Order of painting.
    """
    t, points = motion
    samples = np.unique(np.append(np.arange(0, len(t), -(-len(t) // _MAX_POINTS)), len(t) - 1))
    triangles = band(points[samples])
    stage.put(path, shapes.flat(triangles, color, order=order, trail=True))
    count = 3 * len(triangles[1]) // max(len(samples) - 1, 1)
    visible = count * np.interp(times, t[samples], np.arange(len(samples)))
    return [Channel(f"{path}/<object>", "drawn", visible[:, None])]


def effector_errors(effector: EndEffector | None) -> list[Array]:
    """Return the distance [m] and, where there is one, the angle [rad] of an end effector from its target."""
    if effector is None or effector.target is None:
        return []
    return [effector.distance, effector.angle] if effector.is_oriented else [effector.distance]


def tube(points: Array, thickness: float) -> Mesh:
    """Return a round band along a curve in space, two triangles for each side of each stretch.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        The curve [m]; points may coincide.
    thickness : float
        Its diameter [m].
    """
    first, second = _normals(shapes.directions(points))
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    rings = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    vertices = (points[:, None] + thickness / 2 * rings).reshape(-1, 3)
    k, start = np.arange(_SIDES), _SIDES * np.arange(max(len(points) - 1, 0))[:, None]
    a, b = start + k, start + (k + 1) % _SIDES
    faces = np.stack([a, b, a + _SIDES, b, b + _SIDES, a + _SIDES], axis=-1).reshape(-1, 3)
    return vertices, faces.astype(np.uint32)


def _normals(tangents: Array) -> tuple[Array, Array]:
    """Return two directions across each of a curve's, shape (n, 3) each, that turn no more than it does."""
    first = np.empty_like(tangents)
    side = np.eye(3)[int(np.abs(tangents[0]).argmin())]
    for k, tangent in enumerate(tangents):
        side = side - (side @ tangent) * tangent
        size = float(np.linalg.norm(side))
        side = side / size if size > 1e-9 else np.eye(3)[int(np.abs(tangent).argmin())]
        first[k] = side
    return first, np.cross(tangents, first)


TRAIL, ABOVE = 2, 40
"""Orders of painting: trails above the grid; objects that are visible through all others."""
_DISCS = 12  # over trails, path and words
_HIDDEN = 1e-4  # of a scale: not to be seen
_MAX_SIZE = 0.4  # radius of the largest disc, or length of the largest arrow, in lengths of the robot
_MIN_ASPECT = 0.12  # of a disc: an ellipse that is narrower is drawn so wide
_MAX_RADII = 4.0  # radii of the scene, beyond which no centre is drawn
_FORCE_TOLERANCE = 1e-9  # [N]


def contacts_at(run: Rollout, times: Array, poses: Array) -> Contacts:
    """Return the contacts of the sample before each frame, at the places of the frame.

    Raises
    ------
    InvalidArgument
        If the plant has no contacts.
    """
    rows = samples_before(run.t, times)
    plant = able(robot_at(run.plant, run.t[rows]), Touching)
    if plant is None:
        raise InvalidArgument(
            f"overlays has contacts or centre, but the plant {format_value(run.plant)} has no contacts, "
            "expected a plant with contacts(q, v, a, u, signals), such as a WheeledRobot"
        )
    signals = {name: Signal(unit, values[rows]) for name, (unit, values) in run.signals.items()}
    points: Contacts = plant.contacts(run.q[rows], run.v[rows], run.a[rows], run.u[rows], signals)
    origins = run.poses[rows]
    turn = poses[:, 2] - origins[:, 2]
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    p = points.places - origins[:, None, :2]
    places = np.stack([c * p[..., 0] - s * p[..., 1], s * p[..., 0] + c * p[..., 1]], axis=-1)
    return points._replace(places=poses[:, None, :2] + places, directions=points.directions + turn[:, None])


def draw_contacts(
    stage: Stage, contacts: Contacts, extent: Extent, scale: float | None = None, root: str = "meshcat"
) -> tuple[list[Channel], list[list[object]]]:
    """Draw forces and friction discs, and return their channels and legend entries.

    A given scale [m/N] is that of other samples too, in which wheels may slide that do not in these. The
    nodes are below `root`.
    """
    channels: list[Channel] = []
    legend: list[list[object]] = []
    sizes = np.linalg.norm(contacts.forces, axis=-1)
    limits = np.nan_to_num(contacts.limits)
    largest = max(float(limits.max(initial=0.0)), 0.0) or float(sizes.max(initial=0.0))
    if not largest > _FORCE_TOLERANCE:
        return channels, legend
    is_whole = scale is None
    scale = _MAX_SIZE * extent.unit / largest if scale is None else scale
    is_shared = np.logical_not(np.asarray(contacts.determined.all(axis=1)))
    paints = {GRIPS: "force of the ground", SLIDES: "sliding contact", QUIET: "force, share of a sum"}
    used = dict.fromkeys(paints, False)
    for k in range(len(contacts.names)):
        position, angle = contacts.places[:, k], contacts.directions[:, k]
        turn = np.unwrap(angle + np.arctan2(contacts.forces[:, k, 1], contacts.forces[:, k, 0]))
        reach = scale * limits[:, k]
        width = np.maximum(reach, _MIN_ASPECT * reach.max(axis=1, keepdims=True))
        slides = contacts.slides[:, k]
        color = QUIET if is_shared[k] else GRIPS
        for name, paint, active in (("grips", color, ~slides), ("slides", SLIDES, slides)):
            if is_whole and not active.any():
                continue
            used[paint] = True
            path = f"{root}/contacts/{k}/{name}"
            for part, shape in _disc(GRIPS if name == "grips" else SLIDES).items():
                stage.put(f"{path}/{part}", shape)
                channels += pose_channels(f"{path}/{part}", np.column_stack([position, angle]))
                size = np.column_stack([width, np.ones(len(width))])
                channels.append(Channel(f"{path}/{part}", "scale", np.where(active[:, None], size, _HIDDEN)))
            stage.put(f"{path}/force", shapes.overlay(shapes.arrow(0.09), paint, order=ABOVE - 6))
            channels += pose_channels(f"{path}/force", np.column_stack([position, turn]), 0.012 * extent.unit)
            length = np.where(active, np.maximum(scale * sizes[:, k], _HIDDEN), _HIDDEN)
            thick = np.where(active, np.clip(length / (0.05 * extent.unit), _HIDDEN, 1.0), _HIDDEN)
            thick *= _MAX_SIZE * extent.unit
            channels.append(Channel(f"{path}/force", "scale", np.column_stack([length, thick, thick])))
    entries = [(label, paint) for paint, label in paints.items() if used[paint]]
    for k, (label, paint) in enumerate(entries):
        legend.append([f"{label}, 1 m = {1 / scale:.2g} N" if k == 0 else label, paint, "", 0.0])
    if np.isfinite(contacts.limits).any():
        legend.append(["disc: largest friction, mu N", GRIPS, "", 0.3])
    return channels, legend


def _disc(paint: str) -> dict[str, shapes.Shape]:
    return {
        "disc": shapes.flat(shapes.disc(), paint, order=_DISCS, opacity=0.22),
        "rim": shapes.flat(shapes.disc(0.95), paint, order=_DISCS + 1, opacity=0.9),
    }


def draw_centre(
    stage: Stage, centre: Array, poses: Array, extent: Extent
) -> tuple[list[Channel], list[list[object]]]:
    """Draw the instantaneous centre of rotation, and return its channels and legend entries."""
    with np.errstate(invalid="ignore"):
        offsets = np.where(np.isfinite(centre), centre - poses[:, :2], 0.0)
        distance = np.hypot(*np.where(np.isfinite(centre), centre - extent.centre, np.inf).T)
    is_near = distance < _MAX_RADII * extent.radius
    position = np.where(is_near[:, None], np.where(np.isfinite(centre), centre, 0.0), poses[:, :2])
    path, unit = "meshcat/centre", extent.unit
    length = np.where(is_near, np.maximum(np.hypot(*offsets.T), _HIDDEN), _HIDDEN)
    angle = np.unwrap(np.arctan2(offsets[:, 1], offsets[:, 0]))
    band = shapes.ribbon(np.array([[0.0, 0.0], [1.0, 0.0]]), 0.02 * unit)
    stage.put(f"{path}/way", shapes.flat(band, INK, order=_DISCS + 2, opacity=0.6))
    channels = pose_channels(f"{path}/way", np.column_stack([poses[:, :2], angle]))
    scales = np.where(is_near[:, None], [1.0, 1.0, 1.0], _HIDDEN)
    channels.append(Channel(f"{path}/way", "scale", np.column_stack([length, scales[:, 1:]])))
    ring = shapes.disc(0.6)
    stage.put(f"{path}/point", shapes.flat((0.1 * unit * ring[0], ring[1]), INK, order=_DISCS + 3))
    stage.put(f"{path}/name", shapes.word("ICR", INK, 0.3 * unit, lying=False, order=ABOVE + 5))
    ground = np.zeros(len(position))
    for name, offset in (("point", np.zeros(3)), ("name", unit * np.array([0.25, 0.25, 0.0]))):
        channels.append(Channel(f"{path}/{name}", "position", np.column_stack([position, ground]) + offset))
        channels.append(Channel(f"{path}/{name}", "scale", scales))
    return channels, [["line to the instantaneous centre of rotation", INK, "", 0.6]]


_TOP, _SIDE, _LOWEST = "#f1f3f4", "#d3d8dc", -2  # colours, and the order of the sides: below the grid
_LENGTH = 0.8  # of the arrow, in lengths of the robot


def ramp_of(robot: Any) -> Any:
    """Return the `wheels.Ramp` on which a robot stands; None on level ground, or for other robots."""
    plant = stated(robot, "plant") or robot
    return stated(stated(plant, "ground"), "ramp")


def ramp_rotation(ramp: Any) -> Array:
    """Return the rotation matrix from the axes of the plane to those of level ground, shape (3, 3)."""
    axis = np.array([np.sin(ramp.direction), -np.cos(ramp.direction), 0.0])
    return np.asarray(pin.AngleAxis(float(ramp.angle), axis).toRotationMatrix())


def draw_ramp(stage: Stage, ramp: Any, extent: Extent, view: View) -> View:
    """Incline the scene, draw the body of the ramp and gravity, and return the view of it.

    All objects of a scene are below the node ``meshcat``, in the axes of the plane.

    Parameters
    ----------
    stage : Stage
        Stage of the scene.
    ramp : Ramp
        Inclination of the plane.
    extent : Extent
        Visible part of the plane.
    view : View
        View of level ground.
    """
    R = ramp_rotation(ramp)
    stage.set("meshcat", "quaternion", pin.Quaternion(R).coeffs().tolist())
    (x0, *_, x1), (y0, *_, y1) = extent.lines(0), extent.lines(1)
    top = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    floor = top @ R.T
    lowest, highest = floor[:, 2].min(), floor[:, 2].max()
    floor[:, 2] = lowest
    corners = np.concatenate([top, floor @ R])  # rotated back into the plane
    sides = [[k, (k + 1) % 4, 4 + k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k] for k in range(4)]
    faces = np.array(sides, np.uint32).reshape(-1, 3)
    stage.put("meshcat/ramp/sides", shapes.flat((corners, faces), _SIDE, order=_LOWEST))
    upper = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    stage.put("meshcat/ramp/top", shapes.flat((top, upper), _TOP, order=_LOWEST + 1))  # over the rear sides
    position = np.array([x1, (y0 + y1) / 2, 0.0]) + R.T @ np.array([0.0, 0.0, 1.3 * _LENGTH * extent.unit])
    rotation = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), R.T @ np.array([0.0, 0.0, -1.0]))
    vertices, triangles = shapes.arrow(0.06)
    arrow = _LENGTH * extent.unit * vertices, triangles
    stage.put("meshcat/gravity", shapes.overlay(arrow, INK, order=45))
    stage.set("meshcat/gravity", "position", position.tolist())
    stage.set("meshcat/gravity", "quaternion", rotation.coeffs().tolist())
    stage.put("meshcat/gravityname", shapes.word("g", INK, 0.42 * extent.unit, lying=False, order=46))
    stage.set("meshcat/gravityname", "position", (position + R.T @ [0, 0, 0.3 * extent.unit]).tolist())
    target = R @ view.target
    middle = np.array([target[0], target[1], (lowest + highest) / 2])
    farther = 1.0 + (highest - lowest) / max(2.0 * extent.radius, 1e-9)
    return View(middle + farther * (view.eye - view.target), middle)
