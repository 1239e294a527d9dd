"""The robot as it is drawn: a box with a nose, at a pose."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from pinmobile.arrays import Array, finite
from pinmobile.errors import InvalidArgument

__all__ = ["ARROW", "Body", "diagonal"]

ARROW = 0.06  # of what the axes show; length of the arrowhead of a plant without size

#         ______________
#        |    |\        |
#        |    |   \     |        the nose points along x_B
#        |    |   /     |
#        |____|/________|
_NOSE = np.array([[-0.1, -0.38], [0.48, 0.0], [-0.1, 0.38]])  # of length and width
_BOX = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
_DART = np.array([[0.6, 0.0], [-0.4, 0.35], [-0.2, 0.0], [-0.4, -0.35]])


class Body:
    """The patches of a robot in axes: its outline, length along x_B, and a nose that tells where front is.

    A plant that has no size is an arrowhead.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where it is drawn.
    plant : MobileRobot or other plant, or None
        Its ``size``, if it has one, is length and width [m].
    colour : str
        Of outline and nose.
    otherwise : float
        Length of the arrowhead of a plant without size [m].
    **style
        What every patch gets, such as ``zorder``.

    Attributes
    ----------
    colour : str
        As given.
    patches : list of Polygon
        The outline comes first.
    """

    def __init__(self, axes: Axes, plant: Any, colour: str, otherwise: float, **style: Any) -> None:
        size, self.colour = _size(plant), colour
        self._shapes = [_BOX * size, _NOSE * size] if size is not None else [_DART * otherwise]
        fills = [(*_rgb(colour), 0.25), colour] if size is not None else [colour]
        self.patches = [
            Polygon(shape, closed=True, facecolor=fill, edgecolor=colour, linewidth=1.2, **style)
            for shape, fill in zip(self._shapes, fills, strict=True)
        ]
        self.patches[0].set_label("robot")
        for patch in self.patches:
            axes.add_patch(patch)

    def move(self, pose: Array) -> None:
        """Put the robot at a pose (x, y, psi), shape (3,) [m, m, rad]."""
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        for patch, shape in zip(self.patches, self._shapes, strict=True):
            patch.set_xy(pose[:2] + shape @ np.array([[cos, sin], [-sin, cos]]))


def diagonal(plant: Any, otherwise: float) -> float:
    """Return the diagonal of the plant's outline, or `otherwise` where it has no size [m]."""
    size = _size(plant)
    return otherwise if size is None else float(np.hypot(*size))


def _size(plant: Any) -> Array | None:
    """Return length and width; None for a plant that does not have them."""
    try:
        size = finite("size", plant.size)
    except (AttributeError, InvalidArgument):
        return None
    return size[:2] if size.ndim == 1 and len(size) >= 2 and (size[:2] > 0).all() else None


def _rgb(colour: str) -> tuple[float, ...]:
    return tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
