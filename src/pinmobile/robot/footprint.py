"""The polygon on which a body stands, the hull of what touches the ground, and how far inside a point is."""

from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite
from pinmobile.errors import InvalidArgument

__all__ = ["WEIGHTLESS", "checked_footprint", "hull", "margin_inside", "pressed_at", "rectangle"]

WEIGHTLESS = 1e-9
"""Share of the weight: a vertical force of the ground that only rounding made."""

_FLAT = 1e-12  # of the area of a square about the footprint: what rounding leaves of a straight corner


def rectangle(length: float, width: float) -> Array:
    """Return the corners of a rectangle about the origin, shape (4, 2) [m], counter-clockwise."""
    return 0.5 * np.array([[-length, -width], [length, -width], [length, width], [-length, width]])


def checked_footprint(footprint: ArrayLike) -> Array:
    """Return the corners of a convex polygon, counter-clockwise, shape (k, 2).

    Parameters
    ----------
    footprint : array_like, shape (k, 2)
        Its corners in order, either way round, in the body's frame [m]; the last is not the first again.

    Raises
    ------
    InvalidArgument
        If it has fewer than three corners, is not finite, has no area, or is not convex.
    """
    corners = finite("footprint", footprint)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise InvalidArgument(f"footprint has shape {corners.shape}, expected (k, 2) with k >= 3 corners")
    edges = np.roll(corners, -1, axis=0) - corners
    scale = float(np.ptp(corners, axis=0).max()) ** 2
    area = 0.5 * float(_cross(corners - corners[0], edges).sum())
    if abs(area) <= _FLAT * scale:
        raise InvalidArgument(f"footprint has an area of {abs(area):.3g} m^2, expected a polygon with > 0")
    if area < 0:
        corners = corners[::-1]
        edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*edges.T)
    if not lengths.all():
        k = int(np.argmin(lengths))
        raise InvalidArgument(f"footprint has the corner {corners[k].tolist()} twice in a row, expected once")
    turns = _cross(edges, np.roll(edges, -1, axis=0))
    # A star turns left at each corner too, but more than once round.
    angles = np.arctan2(turns, (edges * np.roll(edges, -1, axis=0)).sum(axis=1))
    if (turns < -_FLAT * scale).any() or angles.sum() > 3 * np.pi:
        k = (int(np.argmin(turns)) + 1) % len(corners)
        raise InvalidArgument(
            f"footprint is not convex at the corner {corners[k].tolist()}, expected a convex polygon"
        )
    return np.asarray(corners)


def hull(points: ArrayLike) -> Array | None:
    """Return the corners of the convex hull of points, counter-clockwise from the one with the least x.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        In any order.

    Returns
    -------
    corners : ndarray, shape (k, 2), or None
        Without those on a straight edge; None where the hull has no area. By Andrew's monotone chain.
    """
    given = np.reshape(np.asarray(points, np.float64), (-1, 2))
    if len(given) < 3:
        return None
    flat = _FLAT * float(np.ptp(given, axis=0).max()) ** 2
    x, y = given.round(9).T  # what differs by rounding alone has no order
    ordered = given[np.lexsort((y, x))]
    halves: list[Array] = []
    for way in (ordered, ordered[::-1]):
        kept: list[Array] = []
        for point in way:
            while len(kept) > 1 and _cross(kept[-1] - kept[-2], point - kept[-1]) <= flat:
                kept.pop()
            kept.append(point)
        halves += kept[:-1]
    return np.array(halves) if len(halves) > 2 else None


def margin_inside(corners: Array, points: Any) -> Any:
    """Return the signed distance of points from the edge of a polygon, positive inside, shape (...) [m].

    Parameters
    ----------
    corners : ndarray, shape (k, 2)
        As `checked_footprint` returns them.
    points : ndarray, shape (..., 2)
        In the same frame [m].
    """
    edges = np.roll(corners, -1, axis=0) - corners  # (k, 2)
    shares = edges / np.square(edges).sum(axis=-1, keepdims=True)
    from_corner = points[..., None, :] - corners  # (..., k, 2)
    along = np.clip((from_corner * shares).sum(axis=-1), 0.0, 1.0)
    square = np.square(from_corner - along[..., None] * edges).sum(axis=-1)
    distance = np.sqrt(np.min(square, axis=-1))
    inside = np.all(_cross(edges, from_corner) >= 0, axis=-1)
    return np.where(inside, distance, -distance)


def pressed_at(wrench: Any, carried: Any) -> Any:
    """Return the point of the ground about which its wrench has no level moment, shape (..., 2) [m].

    Parameters
    ----------
    wrench : ndarray, shape (..., 6)
        Of the ground on the body, along and about the axes of its frame, whose origin lies on the ground.
    carried : ndarray of bool, shape (...)
        Whether the ground carries the body; NaN where it does not.
    """
    vertical = np.where(carried, wrench[..., 2], np.nan)
    return np.stack([-wrench[..., 4] / vertical, wrench[..., 3] / vertical], axis=-1)


def _cross(a: Any, b: Any) -> Any:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
