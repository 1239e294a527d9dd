"""A twice continuously differentiable curve through many waypoints."""

from dataclasses import dataclass

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen
from pinmobile.errors import InvalidArgument
from pinmobile.paths.piecewise import PiecewisePath
from pinmobile.paths.polynomials import PiecewisePolynomial, stretch
from pinmobile.paths.values import of_point
from pinmobile.plant import Parameter

__all__ = ["Spline"]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Spline(PiecewisePath):
    """The cubic spline through waypoints, clamped at its ends; `CubicVia` with a free via is that of three.

    Parameters
    ----------
    waypoints : array_like, shape (k, n)
        The points [m], k >= 2 of n >= 1 coordinates.
    times : array_like, shape (k,)
        Times at the points [s]: from zero, strictly increasing.
    start_velocity, end_velocity : array_like, shape (n,), optional
        Velocities at the ends [m/s]; at rest where left out.

    Raises
    ------
    InvalidArgument
        If a shape is another, a number is not finite, or the times do not increase from zero.
    """

    waypoints: Array
    times: Array
    start_velocity: Array
    end_velocity: Array

    def __init__(
        self,
        waypoints: ArrayLike,
        times: ArrayLike,
        *,
        start_velocity: ArrayLike | None = None,
        end_velocity: ArrayLike | None = None,
    ) -> None:
        points = finite("waypoints", waypoints)
        if points.ndim != 2 or points.shape[0] < 2 or not points.shape[1]:
            raise InvalidArgument(f"waypoints has shape {points.shape}, expected (k, n) with k >= 2")
        keep = {
            "waypoints": frozen(points),
            "times": _increasing(finite("times", times), points.shape[0]),
            "start_velocity": _velocity("start_velocity", start_velocity, points.shape[1]),
            "end_velocity": _velocity("end_velocity", end_velocity, points.shape[1]),
        }
        for name, value in keep.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "_curve", self._solve())

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its waypoints, from 0."""
        count, n = self.waypoints.shape
        points = (of_point(f"waypoint_{k}", "waypoints", f"waypoint {k}", n, row=k) for k in range(count))
        return tuple(each for point in points for each in point)

    def _solve(self) -> PiecewisePolynomial:
        # Here, because scipy is heavy and no other path needs it.
        from scipy.interpolate import CubicSpline

        ends = ((1, self.start_velocity), (1, self.end_velocity))
        for k, step in enumerate(np.diff(self.times), 1):
            stretch(f"times[{k}] - times[{k - 1}]", step)
        try:
            with np.errstate(all="ignore"):  # PiecewisePolynomial looks
                highest_first = CubicSpline(self.times, self.waypoints, bc_type=ends).c  # (4, k - 1, n)
        except (ValueError, np.linalg.LinAlgError):  # where a slope is no number, or steps differ too much
            highest_first = np.full((4, len(self.times) - 1, self.waypoints.shape[1]), np.nan)
        return PiecewisePolynomial(self.times, np.moveaxis(highest_first[::-1], 0, 1))


def _increasing(times: Array, size: int) -> Array:
    if times.shape != (size,):
        raise InvalidArgument(f"times has shape {times.shape}, expected ({size},), one per waypoint")
    if times[0] != 0:
        raise InvalidArgument(f"times[0] is {times[0]} s, expected 0")
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        k = int(late[0])
        raise InvalidArgument(f"times[{k + 1}] is {times[k + 1]} s, expected > times[{k}] = {times[k]} s")
    return frozen(times)


def _velocity(name: str, value: ArrayLike | None, size: int) -> Array:
    velocity = np.zeros(size) if value is None else finite(name, value)
    if velocity.shape != (size,):
        raise InvalidArgument(f"{name} has shape {velocity.shape}, expected ({size},)")
    return frozen(velocity)
