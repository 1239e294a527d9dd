"""The heading law of the lecture's script, slips included, so that its figures can be reproduced."""

from dataclasses import dataclass, field

import numpy as np

from pinmobile.arrays import ArrayLike
from pinmobile.paths import Path, within
from pinmobile.trajectories.reference import Reference, joined, plane_path
from pinmobile.trajectories.speeds import STANDSTILL, largest

__all__ = ["LectureHeading"]


@dataclass(frozen=True)
class LectureHeading:
    """Along a path with the lecture's desired heading; `Tangent` has it right.

        psi       = wrapTo2Pi(atan2(y', x'))                            in [0, 2 pi)
        psi_dot   = (y''/x' - y' x''/x'^2) / (y'^2/x'^2 + 1)
        psi_ddot  = 0

    So the heading jumps by a whole turn where it passes zero, and by whatever it takes where the path
    rests, for which atan2(0, 0) = 0 and the rate is 0; the acceleration is lost everywhere. The error on the
    circle that `planar_difference` takes was not the lecture's either.

    Below 1e-12 of the path's largest speed a speed is rounding, which differs from machine to machine: the
    path rests there, and a y' of that size does not turn the heading of a path that runs along x from 0 to a
    whole turn. Where x' alone vanishes the rate is the formula's limit, whatever is left of x'; the lecture's
    script has that or 0 there, as the rounding of its linear solver falls.

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
        x_dot, y_dot = np.moveaxis(velocity, -1, 0)
        speed = np.hypot(x_dot, y_dot)
        still = speed < self._still
        along_x = (x_dot > self._still) & (y_dot < 0) & (y_dot > -self._still)
        psi = np.where(still | along_x, 0.0, np.mod(np.arctan2(y_dot, x_dot), 2 * np.pi))
        # By x'^2 above and below, the formula needs no x'. In two steps, because squares may underflow.
        speed = np.where(still, 1.0, speed)
        cos, sin = x_dot / speed, y_dot / speed
        rate = np.where(still, 0.0, (cos * acceleration[..., 1] - sin * acceleration[..., 0]) / speed)
        return joined((position, velocity, acceleration), (psi, rate, np.zeros_like(rate)))
