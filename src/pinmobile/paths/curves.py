"""Curves that are polynomials: cubics by a via point, splines by many, straight ways, and points held."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import ClassVar, Self

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, positive, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.paths.path import of_point
from pinmobile.paths.polynomials import PiecewisePath, PiecewisePolynomial, hermite, stretch
from pinmobile.plant import Parameter

_REST = (0.0, 0.0)


def _parameters(size: int, *, has_velocity: bool) -> tuple[Parameter, ...]:
    return (
        *of_point("via_start", "start", "start of the path", size),
        *of_point("via", "via", "via point of the path", size),
        *of_point("via_end", "end", "end of the path", size),
        Parameter("via_time", "s", "time at the via point", 0.0, may_vanish=False, attribute="t_via"),
        *(
            of_point("via_velocity", "via_velocity", "velocity at the via point", size, unit="m/s")
            if has_velocity
            else ()
        ),
    )


@dataclass(frozen=True, init=False, eq=False, repr=False)
class CubicVia(PiecewisePath):
    """Two cubics per coordinate, from start to end through a via point (lecture, section 5.1 and 5.2).

    With a = (a_0 ... a_3) before and b after the via point,

        r(t) = sum of a_k t^k  for t < t_via,      r(t) = sum of b_k (t - t_via)^k  after it.

    With `via_velocity` given these are two independent cubics, and the acceleration jumps at the via
    point. With it free, velocity and acceleration are continuous there.

    Parameters
    ----------
    start, via, end : array_like, shape (n,)
        The three points [m]; n = 2 in the plane, any n >= 1 is accepted.
    t_via, t_end : float
        Times at the last two [s], 0 < t_via < t_end.
    via_velocity : array_like, shape (n,), optional
        Velocity at the via point [m/s]; free where left out.
    start_velocity, end_velocity : array_like, shape (n,), optional
        Velocities at the ends [m/s]; at rest where left out, for any n.

    Raises
    ------
    InvalidArgument
        If a point or velocity has another shape or is not finite, or the times are out of order.
    """

    start: Array
    via: Array
    end: Array
    t_via: float
    t_end: float
    via_velocity: Array | None
    start_velocity: Array
    end_velocity: Array

    parameters: ClassVar[tuple[Parameter, ...]] = _parameters(2, has_velocity=True)

    def __init__(
        self,
        start: ArrayLike,
        via: ArrayLike,
        end: ArrayLike,
        t_via: float,
        t_end: float,
        via_velocity: ArrayLike | None = None,
        *,
        start_velocity: ArrayLike = _REST,
        end_velocity: ArrayLike = _REST,
    ) -> None:
        first = finite("start", start)
        if first.ndim != 1 or not first.size:
            raise InvalidArgument(f"start has shape {first.shape}, expected (n,)")
        n = first.size
        keep = {
            "start": frozen(first),
            "via": _point("via", via, n),
            "end": _point("end", end, n),
            "t_via": scalar("t_via", t_via),
            "t_end": positive("t_end", t_end, "s"),
            "via_velocity": None if via_velocity is None else _point("via_velocity", via_velocity, n),
            "start_velocity": _velocity("start_velocity", start_velocity, n),
            "end_velocity": _velocity("end_velocity", end_velocity, n),
        }
        for name, value in keep.items():
            object.__setattr__(self, name, value)
        if not 0 < self.t_via < self.t_end:
            raise InvalidArgument(f"t_via is {self.t_via} s, expected 0 < t_via < t_end = {self.t_end} s")
        stretch("t_via", self.t_via)
        stretch("t_end - t_via", self.t_end - self.t_via)
        object.__setattr__(self, "_curve", self._solve())
        stated = _parameters(n, has_velocity=self.via_velocity is not None)
        object.__setattr__(self, "parameters", stated)  # in place of those in the plane

    def _solve(self) -> PiecewisePolynomial:
        velocity = self._free_velocity() if self.via_velocity is None else self.via_velocity
        before = hermite(self.t_via, self.start, self.via, self.start_velocity, velocity)
        after = hermite(self.t_end - self.t_via, self.via, self.end, velocity, self.end_velocity)
        return PiecewisePolynomial(np.array([0.0, self.t_via, self.t_end]), np.array([before, after]))

    def _free_velocity(self) -> Array:
        # The lecture's 8 x 8 system in closed form, one coordinate at a time: with the mean velocities of the
        # two cubics, their accelerations at the via are (2 v0 + 4 v - 6 mean0) / t and
        # (6 mean1 - 4 v - 2 v1) / s. A solver rounds differently from machine to machine, and what is exactly
        # zero here, as x_dot at the via of the lecture, would be so on some alone.
        t, s = self.t_via, self.t_end - self.t_via
        before = 3 * ((self.via - self.start) / t) - self.start_velocity
        after = 3 * ((self.end - self.via) / s) - self.end_velocity
        return np.asarray((before * (s / self.t_end) + after * (t / self.t_end)) / 2)


def _point(name: str, value: ArrayLike, size: int | None = None) -> Array:
    array = finite(name, value)
    if array.ndim != 1 or size not in (None, array.size):
        raise InvalidArgument(f"{name} has shape {array.shape}, expected ({'n' if size is None else size},)")
    return frozen(array)


def _velocity(name: str, value: ArrayLike | None, size: int) -> Array:
    return frozen(np.zeros(size)) if value is None or value is _REST else _point(name, value, size)


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


def _of_hold(size: int) -> tuple[Parameter, ...]:
    return of_point("hold", "point", "point that is held", size)


def _of_rests(size: int) -> tuple[Parameter, ...]:
    start = of_point("rest_start", "start", "where the way starts", size)
    return (*start, *of_point("rest_end", "end", "where the way ends", size))


class _Timed(PiecewisePath):
    """Abstract base: one polynomial that is given its duration."""

    def _values(self) -> dict[str, object]:
        return {**super()._values(), "duration": self.duration}

    def with_parameters(self, **values: ArrayLike) -> Self:
        """Return the path of the same duration with other values of its `parameters`, by attribute."""
        points = {each.name: getattr(self, each.name) for each in fields(self) if each.init}
        made: Callable[..., Self] = type(self)
        return made(**{**points, **values}, duration=self.duration)


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


def _of_line(size: int) -> tuple[Parameter, ...]:
    start = of_point("line_start", "start", "start of the path", size)
    return (*start, *of_point("line_end", "end", "end of the path", size))


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Line(_Timed):
    """The straight line from one point to another at one speed; `RestToRest` starts and ends at rest.

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

    parameters: ClassVar[tuple[Parameter, ...]] = _of_line(2)

    def __init__(self, start: ArrayLike, end: ArrayLike, duration: float) -> None:
        object.__setattr__(self, "start", _point("start", start))
        object.__setattr__(self, "end", _point("end", end, self.start.size))
        T = stretch("duration", duration)
        with np.errstate(all="ignore"):  # PiecewisePolynomial looks
            rows = np.array([[self.start, (self.end - self.start) / T]])
        object.__setattr__(self, "_curve", PiecewisePolynomial(np.array([0.0, T]), rows))
        object.__setattr__(self, "parameters", _of_line(self.start.size))  # in place of those in the plane
