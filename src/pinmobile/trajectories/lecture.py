"""The heading law of the lecture's script, slips included, so that its figures can be reproduced."""

from dataclasses import dataclass, field

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.paths import Path, within
from pinmobile.trajectories.reference import Reference, joined, plane_path
from pinmobile.trajectories.speeds import STANDSTILL, largest

__all__ = ["LectureHeading"]

_VANISHING = 1e-290


@dataclass(frozen=True)
class LectureHeading:
    """Along a path with the lecture's desired heading; `Tangent` has it right.

        psi       = wrapTo2Pi(atan2(y', x'))                            in [0, 2 pi]
        psi_dot   = (y''/x' - y' x''/x'^2) / (y'^2/x'^2 + 1),   0 where x' = 0
        psi_ddot  = 0

    So the heading jumps by a whole turn where it passes zero, and by whatever it takes where the path
    rests, for which atan2(0, 0) = 0; the rate is lost on an exactly vertical tangent; the acceleration
    everywhere. The error on the circle that `planar_difference` takes was not the lecture's either.

    Parameters
    ----------
    path : Path
        A path of two coordinates.

    Raises
    ------
    InvalidArgument
        If `path` is no path in the plane.
    """

    path: Path
    _still: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_still", STANDSTILL * float(largest(plane_path(self.path), 1).max()))

    @property
    def duration(self) -> float:
        """The path's duration [s]."""
        return float(self.path.duration)

    def __call__(self, t: ArrayLike) -> Reference:
        """Return the reference.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reference : Reference
            Arrays of shape (..., 3).

        Raises
        ------
        InvalidArgument
            If a time is outside.
        """
        times = within("t", t, self.duration)
        position, velocity, acceleration = (self.path.derivative(times, order) for order in range(3))
        still = np.hypot(velocity[..., 0], velocity[..., 1]) < self._still
        x_dot, y_dot = np.moveaxis(np.where(still[..., None], 0.0, velocity), -1, 0)
        # As MATLAB's wrapTo2Pi: what rounds to a whole turn stays one.
        psi = np.mod(np.arctan2(y_dot, x_dot), 2 * np.pi)
        rate = _rate(x_dot, y_dot, *np.moveaxis(acceleration, -1, 0))
        return joined((position, velocity, acceleration), (psi, rate, np.zeros_like(rate)))


def _rate(x_dot: Array, y_dot: Array, x_ddot: Array, y_ddot: Array) -> Array:
    # The script's guard is seen with `ydot ~= 0` and with `ydot == 0`; both are honoured. The square,
    # because dividing by it overflows where x' itself is not quite zero.
    square = x_dot * x_dot
    moves = square > _VANISHING
    x_dot, square = np.where(moves, x_dot, 1.0), np.where(moves, square, 1.0)
    rate = (y_ddot / x_dot - y_dot * x_ddot / square) / (y_dot * y_dot / square + 1)
    return np.where(moves, rate, 0.0)
