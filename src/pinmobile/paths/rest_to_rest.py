"""A rest, and the smooth way from one to another."""

from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, positive
from pinmobile.errors import InvalidArgument
from pinmobile.paths.piecewise import PiecewisePath
from pinmobile.paths.polynomials import PiecewisePolynomial, stretch
from pinmobile.paths.values import of_point
from pinmobile.plant import Parameter

__all__ = ["Hold", "RestToRest"]


def _of_hold(size: int) -> tuple[Parameter, ...]:
    return of_point("hold", "point", "point that is held", size)


def _of_rests(size: int) -> tuple[Parameter, ...]:
    start = of_point("rest_start", "start", "where the way starts", size)
    return (*start, *of_point("rest_end", "end", "where the way ends", size))


class _Timed(PiecewisePath):
    """Abstract base: one polynomial that is given its duration."""

    def _values(self) -> dict[str, Any]:
        return {**super()._values(), "duration": self.duration}

    def with_parameters(self, **values: ArrayLike) -> Self:
        """Return the path of the same duration with other values of its `parameters`, by attribute."""
        points = {each.name: getattr(self, each.name) for each in fields(self) if each.init}
        kind: Any = type(self)
        made: Self = kind(**{**points, **values}, duration=self.duration)
        return made


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Hold(_Timed):
    """A point that is held.

    Parameters
    ----------
    point : array_like, shape (n,)
        Where [m; rad of joints that turn]; of no coordinates too, for an arm that has no joints left.
    duration : float
        How long [s], > 0.

    Raises
    ------
    InvalidArgument
        If the point has another shape or is not finite, or the duration is not above zero.
    """

    point: Array

    parameters: ClassVar[tuple[Parameter, ...]] = _of_hold(2)

    def __init__(self, point: ArrayLike, duration: float) -> None:
        object.__setattr__(self, "point", _point("point", point))
        knots = np.array([0.0, positive("duration", duration, "s")])
        object.__setattr__(self, "_curve", PiecewisePolynomial(knots, self.point[None, None]))
        object.__setattr__(self, "parameters", _of_hold(self.point.size))  # in place of those in the plane


@dataclass(frozen=True, init=False, eq=False, repr=False)
class RestToRest(_Timed):
    """The straight way from one point to another, with velocity and acceleration zero at both.

    r(t) = start + (end - start) (10 s^3 - 15 s^4 + 6 s^5) with s = t / duration, the quintic; the speed is at
    most 15/8 of the mean one.

    Parameters
    ----------
    start, end : array_like, shape (n,)
        The two points [m; rad of joints that turn].
    duration : float
        Time between them [s], > 0.

    Raises
    ------
    InvalidArgument
        If a point has another shape or is not finite, or the duration is not above zero.
    """

    start: Array
    end: Array

    parameters: ClassVar[tuple[Parameter, ...]] = _of_rests(2)

    def __init__(self, start: ArrayLike, end: ArrayLike, duration: float) -> None:
        object.__setattr__(self, "start", _point("start", start))
        object.__setattr__(self, "end", _point("end", end))
        if self.end.shape != self.start.shape:
            raise InvalidArgument(f"end has shape {self.end.shape}, expected {self.start.shape}")
        object.__setattr__(self, "_curve", self._solve(stretch("duration", duration)))
        object.__setattr__(self, "parameters", _of_rests(self.start.size))  # in place of those in the plane

    def _solve(self, T: float) -> PiecewisePolynomial:
        with np.errstate(all="ignore"):  # PiecewisePolynomial looks
            way = self.end - self.start
            still = np.zeros_like(way)
            rows = [self.start, still, still, 10 * way / T**3, -15 * way / T**4, 6 * way / T**5]
        return PiecewisePolynomial(np.array([0.0, T]), np.array([rows]))


def _point(name: str, value: ArrayLike) -> Array:
    array = finite(name, value)
    if array.ndim != 1:
        raise InvalidArgument(f"{name} has shape {array.shape}, expected (n,)")
    return frozen(array)
