"""Where end effectors go: what they have travelled, where they should, and how far off they are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import pinmobile.viewer.shapes as shapes
from pinmobile.arrays import Array
from pinmobile.errors import PinmobileError
from pinmobile.loop import EndEffector, Rollout
from pinmobile.palette import INK, colour
from pinmobile.viewer.motion import Channel
from pinmobile.viewer.stage import Extent, Stage

_ORDER = 20  # over what lies on the ground, under what shows through everything
_SIDES = 6
_SPREAD = 2500  # points of a trail at most
_TRAVELLED, _TARGET = 0.034, 0.022  # thickness, in lengths of the robot
_STILL = 1e-6  # [m]: what moves less than that has no path


def hand_of(run: Rollout) -> EndEffector | None:
    """Return the end effector of a run: that whose target it has, or the tip of its first arm, if any."""
    if not getattr(run.plant, "mounts", ()):
        return None
    try:
        return run.end_effector()
    except PinmobileError:  # such as of an outline: there is nothing to be drawn
        return None


def draw_hand(
    stage: Stage, index: int, hand: EndEffector, times: Array, extent: Extent, *, path: bool, trail: bool
) -> list[Channel]:
    """Draw where an end effector should go, dashed, and what it has travelled, and return its channels.

    Parameters
    ----------
    stage : Stage
        Where.
    index : int
        Of the run.
    hand : EndEffector
        Of the run.
    times : ndarray, shape (n,)
        Of the frames [s].
    extent : Extent
        Tells how large things are.
    path, trail : bool
        Which of the two.
    """
    if path and hand.target is not None:
        points = _thinned(hand.target[:, :3, 3])
        dash = max(0.028 * extent.radius, 0.05 * extent.unit)
        bands = _dashes(points, _TARGET * extent.unit, dash)
        if bands is not None:
            stage.put(f"meshcat/hand{index}/target", shapes.flat(bands, INK, order=_ORDER + 5))
    kept = np.unique(np.append(np.arange(0, len(hand.t), -(-len(hand.t) // _SPREAD)), len(hand.t) - 1))
    points = hand.position[kept]
    if not trail or float(np.ptp(points, axis=0).max()) < _STILL:
        return []
    node = f"meshcat/hand{index}/trail/<object>"
    band = tube(points, _TRAVELLED * extent.unit)
    shape = shapes.flat(band, colour(index), order=_ORDER + index, trail=True)
    stage.put(node.removesuffix("/<object>"), shape)
    drawn = 6 * _SIDES * np.interp(times, hand.t[kept], np.arange(len(kept)))
    return [Channel(node, "drawn", drawn[:, None])]


def hand_errors(hand: EndEffector | None) -> list[Array]:
    """Return the distance [m] and, where there is one, the angle [rad] of an end effector from its target."""
    if hand is None or hand.target is None:
        return []
    return [hand.distance, hand.angle] if hand.is_oriented else [hand.distance]


def tube(points: Array, thickness: float) -> tuple[Array, NDArray[np.uint32]]:
    """Return a round band along a curve in space, two triangles for each side of each stretch.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        The curve [m]; points may coincide.
    thickness : float
        Its diameter [m].
    """
    along = np.gradient(points, axis=0) if len(points) > 1 else np.zeros_like(points)
    length = np.linalg.norm(along, axis=1)
    number = np.arange(len(points))
    moving = length > 1e-9 * length.max(initial=1e-300)
    latest = np.maximum.accumulate(np.where(moving, number, 0))  # where points coincide, as before
    along = along[latest] / np.maximum(length[latest], 1e-300)[:, None]
    first, second = _across(along)
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    rings = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    vertices = (points[:, None] + thickness / 2 * rings).reshape(-1, 3)
    k, start = np.arange(_SIDES), _SIDES * np.arange(max(len(points) - 1, 0))[:, None]
    a, b = start + k, start + (k + 1) % _SIDES
    faces = np.stack([a, b, a + _SIDES, b, b + _SIDES, a + _SIDES], axis=-1).reshape(-1, 3)
    return vertices, faces.astype(np.uint32)


def _across(along: Array) -> tuple[Array, Array]:
    """Return two directions across each of a curve's, shape (n, 3) each, that turn no more than it does."""
    first = np.empty_like(along)
    side = np.eye(3)[int(np.abs(along[0]).argmin())]
    for k, way in enumerate(along):
        side = side - (side @ way) * way
        size = float(np.linalg.norm(side))
        side = side / size if size > 1e-9 else np.eye(3)[int(np.abs(way).argmin())]
        first[k] = side
    return first, np.cross(along, first)


def _thinned(points: Array) -> Array:
    return points[:: max(len(points) // _SPREAD, 1)]


def _dashes(points: Array, thickness: float, dash: float) -> Any:
    """Return tubes along the curve, `dash` long and 0.8 of that apart [m]; None of one that stands still."""
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    if travelled[-1] < _STILL:
        return None
    parts = []
    for start in np.arange(0.0, max(travelled[-1] - dash / 3, dash / 10), 1.8 * dash):
        end = min(start + dash, travelled[-1])
        inside = travelled[(travelled > start) & (travelled < end)]
        at = np.concatenate([[start], inside[:: max(len(inside) // 8, 1)], [end]])
        parts.append(tube(np.stack([np.interp(at, travelled, c) for c in points.T], axis=-1), thickness))
    return shapes.joined(parts)
