"""Paths through points and figures: cubics, splines, lines, points, circles and Lissajous figures."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import Any, final

import attrs
import numpy as np

from pinmobile.arrays import Array, absent, bounded, increasing, rotate, shaped
from pinmobile.parts import array, number, part
from pinmobile.paths.path import (
    Curve,
    PiecewisePath,
    PiecewisePolynomial,
    Whole,
    axes_of,
    check_sizes,
    hermite,
)


class _Figure(Curve):
    """Abstract base of paths with amplitudes and rates along x and y."""

    @property
    @abstractmethod
    def _axes(self) -> tuple[float, float, float, float]:
        """Amplitudes along x and y [m], and rates [rad/s]."""

    @abstractmethod
    def _move(self, curve: Array, order: int) -> Array:
        """Return derivatives of (rx sin(wx t), -ry cos(wy t)), shape (..., 2), at the figure's position."""

    @property
    def pieces(self) -> tuple[Whole]:
        """The figure as one piece, because it is analytic."""
        return (Whole(self),)

    def _at(self, t: Array, order: int) -> Array:
        # Sines and cosines instead of shifted phases, because adding pi/2 would make their zeros inexact.
        rx, ry, wx, wy = map(np.float64, self._axes)  # NumPy scalars, whose powers overflow without an error
        x = rx * wx**order * _sine(wx * t, order)
        y = -ry * wy**order * _sine(wy * t, order + 1)
        return self._move(np.stack([x, y], axis=-1), order)


@final
@part
class Lissajous(_Figure):
    """Lissajous figure that starts at the origin (lecture, section 5.3).

    ::

        x = rx sin(wx t),   y = ry - ry cos(wy t)

    It is a circle for rx = ry and wx = wy (see `Circle`), an ellipse for wx = wy alone, and a figure of eight
    for wx = 2 wy. For wy = 2 wx it is a part of a parabola, at whose ends the motion reverses. A negative
    amplitude mirrors the figure.

    Parameters
    ----------
    rx, ry : float
        Amplitudes along x and y [m].
    wx, wy : float
        Angular frequencies along x and y [rad/s].
    duration : float
        Duration of the path, > 0 [s].

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range.

    See Also
    --------
    Circle : circle with any center and start
    Tangent : trajectory along a path

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import Lissajous
    >>> eight = Lissajous(2.0, 1.0, wx=1.0, wy=0.5, duration=12.6)
    >>> eight(np.pi / 2)  # [m]
    array([2.  , 0.29])
    """

    rx: float = number(unit="m", doc="amplitude of the figure along x")
    ry: float = number(unit="m", doc="amplitude of the figure along y")
    wx: float = number(unit="rad/s", doc="angular frequency along x")
    wy: float = number(unit="rad/s", doc="angular frequency along y")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")

    @property
    def _axes(self) -> tuple[float, float, float, float]:
        return self.rx, self.ry, self.wx, self.wy

    def _move(self, curve: Array, order: int) -> Array:
        if not order:
            curve[..., 1] += self.ry
        return curve


@final
@part
class Circle(_Figure):
    """Circle; by default it starts at the origin along the x axis.

    ::

        x = x_c + r cos(w t + phase),   y = y_c + r sin(w t + phase)

    By default the phase is -pi/2 and the centre (0, r): x = r sin(w t), y = r - r cos(w t). With a negative
    rate, the default path starts backwards. `heading` can define the start in place of `phase`.

    Parameters
    ----------
    radius : float
        Radius r of the circle, > 0 [m].
    rate : float
        Turn rate w, positive to the left [rad/s].
    duration : float
        Duration of the path, > 0 [s].
    centre : array_like, shape (2,), optional
        Centre of the circle [m].
    phase : float, optional
        Angle of the start on the circle [rad].
    heading : float, optional
        Direction of motion at the start [rad].

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range, or both `phase` and `heading` are given.

    See Also
    --------
    Lissajous : ellipses and figures of eight
    Tangent : trajectory along a path

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import Circle
    >>> circle = Circle(radius=2.0, rate=0.5, duration=10.0)
    >>> np.linalg.norm(circle.derivative(3.0, 1))  # speed [m/s]
    np.float64(1.0)
    >>> np.linalg.norm(circle.derivative(3.0, 2))  # [m/s^2]
    np.float64(0.5)
    """

    radius: float = number(above=0, unit="m", doc="radius of the circle")
    rate: float = number(unit="rad/s", doc="turn rate on the circle, positive to the left")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")
    centre: Any = array(default=None, shapes=((2,),), unit="m", labels=("x", "y"), doc="centre of the circle")
    phase: float | None = number(default=None, unit="rad", doc="angle of the start on the circle")
    heading: float | None = number(default=None, unit="rad", doc="direction at the start")

    def check(self) -> None:
        """Raise `InvalidArgument` where phase and heading are both given."""
        if self.phase is not None:
            absent(f"with phase = {self.phase} rad: each follows from the other", heading=self.heading)

    def _values(self) -> dict[str, object]:
        return {name: value for name, value in super()._values().items() if value is not None}

    @property
    def _axes(self) -> tuple[float, float, float, float]:
        return self.radius, self.radius, self.rate, self.rate

    @property
    def _turn(self) -> float:
        """Angle by which the default circle is rotated about its centre [rad]."""
        if self.heading is not None:
            return self.heading if self.rate >= 0 else self.heading - np.pi
        return 0.0 if self.phase is None else self.phase + np.pi / 2

    def _move(self, curve: Array, order: int) -> Array:
        centre = np.array([0.0, self.radius])
        if self._turn:
            turn = np.cos(self._turn), np.sin(self._turn)
            curve, centre = rotate(*turn, curve), rotate(*turn, centre)
        if not order:
            curve += centre if self.centre is None else np.asarray(self.centre)
        return curve


def _sine(angle: Array, quarter_turns: int) -> Array:
    wave = np.cos(angle) if quarter_turns % 2 else np.sin(angle)
    return np.asarray(-wave if quarter_turns % 4 >= 2 else wave)


def _velocity(doc: str) -> Any:
    zeros = attrs.Factory(lambda path: np.zeros(len(axes_of(path))), takes_self=True)
    return array(default=zeros, unit="m/s", labels=axes_of, doc=doc)


@part
class CubicVia(PiecewisePath):
    """Two cubics per coordinate, from start to end through a via point (lecture, sections 5.1 and 5.2).

    With coefficients a = (a_0 ... a_3) before the via point and b after it::

        r(t) = sum of a_k t^k  for t < t_via,      r(t) = sum of b_k (t - t_via)^k  after it.

    With `via_velocity`, these are two independent cubics, and the acceleration jumps at the via point.
    Without it, velocity and acceleration are continuous there. Points have n >= 1 coordinates, 2 in the
    plane. By default the path starts and ends at rest.

    Parameters
    ----------
    start, via, end : array_like, shape (n,)
        Start, via point and end [m].
    t_via, t_end : float
        Times at the via point and at the end, 0 < t_via < t_end [s].
    via_velocity : array_like, shape (n,), optional
        Velocity at the via point [m/s].
    start_velocity, end_velocity : array_like, shape (n,), optional
        Velocities at the start and at the end [m/s]; default: zero.

    Raises
    ------
    InvalidArgument
        If shapes differ, a number is not finite, or the times are out of order.

    See Also
    --------
    Spline : cubic spline through any number of waypoints
    RestToRest : quintic without a via point

    Examples
    --------
    >>> from pinmobile import CubicVia
    >>> path = CubicVia([0, 0], [1, 2], [3, 3], t_via=2.0, t_end=5.0)
    >>> path(2.0)  # [m]
    array([1., 2.])
    >>> path.derivative(5.0, 1).round(9) + 0.0  # at rest [m/s]
    array([0., 0.])
    """

    start: Any = array(unit="m", labels=axes_of, doc="start of the path")
    via: Any = array(unit="m", labels=axes_of, doc="via point of the path")
    end: Any = array(unit="m", labels=axes_of, doc="end of the path")
    t_via: float = number(above=0, unit="s", doc="time at the via point")
    t_end: float = number(above=0, unit="s", fixed=True, doc="time at the end")
    via_velocity: Any = array(
        default=None, unit="m/s", labels=axes_of, doc="velocity at the via point; default: free"
    )
    start_velocity: Any = _velocity("velocity at the start")
    end_velocity: Any = _velocity("velocity at the end")

    def check(self) -> None:
        """Raise `InvalidArgument` if shapes differ or the times are out of order."""
        shaped("start", self.start, ("n>=1",))
        check_sizes(self, "via", "end", "via_velocity", "start_velocity", "end_velocity")
        bounded("t_via", self.t_via, above=0, below=self.t_end, unit="s")

    @property
    def duration(self) -> float:
        """Time at the end [s]."""
        return self.t_end

    @cached_property
    def _curve(self) -> PiecewisePolynomial:
        velocity = self._free_velocity() if self.via_velocity is None else self.via_velocity
        first = hermite(self.t_via, self.start, self.via, self.start_velocity, velocity)
        second = hermite(self.t_end - self.t_via, self.via, self.end, velocity, self.end_velocity)
        return PiecewisePolynomial(np.array([0.0, self.t_via, self.t_end]), np.array([first, second]))

    def _free_velocity(self) -> Array:
        # This is the lecture's 8 x 8 system in closed form, for each coordinate. With the mean velocities of
        # the two cubics, their accelerations at the via point are (2 v0 + 4 v - 6 mean0) / t and
        # (6 mean1 - 4 v - 2 v1) / s. The rounding of a linear solver depends on the machine: the velocity at
        # the lecture's via point, exactly zero here, would not be zero everywhere.
        """Return the velocity at the via point for a continuous acceleration, shape (n,) [m/s]."""
        t, s = self.t_via, self.t_end - self.t_via
        first = 3 * ((self.via - self.start) / t) - self.start_velocity
        second = 3 * ((self.end - self.via) / s) - self.end_velocity
        return np.asarray((first * (s / self.t_end) + second * (t / self.t_end)) / 2)


@part
class Spline(PiecewisePath):
    """Cubic spline through waypoints, with given velocities at its ends.

    `CubicVia` without ``via_velocity`` is the spline through three waypoints. By default the path starts and
    ends at rest.

    Parameters
    ----------
    waypoints : array_like, shape (k, n)
        Waypoints, k >= 2 [m].
    times : array_like, shape (k,)
        Times at the waypoints, increasing from zero [s].
    start_velocity, end_velocity : array_like, shape (n,), optional
        Velocities at the start and at the end [m/s]; default: zero.

    Raises
    ------
    InvalidArgument
        If shapes differ, a number is not finite, or the times do not increase from zero.

    See Also
    --------
    CubicVia : spline of two cubics
    Polyline : straight lines with rounded corners

    Examples
    --------
    >>> from pinmobile import Spline
    >>> path = Spline([[0, 0], [1, 0], [1, 1]], times=[0, 1, 2])
    >>> path(1.5)  # [m]
    array([1.09375, 0.59375])
    """

    waypoints: Any = array(shapes=(("k", "n"),), unit="m", labels=axes_of, doc="waypoints of the path")
    times: Any = array(unit="s", fixed=True, doc="times at the waypoints, from zero and increasing")
    start_velocity: Any = _velocity("velocity at the start")
    end_velocity: Any = _velocity("velocity at the end")

    def check(self) -> None:
        """Raise `InvalidArgument` if shapes differ or the times do not increase from zero."""
        shaped("waypoints", self.waypoints, ("k>=2", "n>=1"))
        times = shaped("times", self.times, (len(self.waypoints),), words=", one per waypoint")
        check_sizes(self, "start_velocity", "end_velocity")
        bounded("times[0]", times[0], least=0, most=0, unit="s")
        increasing("times", times)

    @property
    def duration(self) -> float:
        """Time at the last waypoint [s]."""
        return float(self.times[-1])

    @cached_property
    def _curve(self) -> PiecewisePolynomial:
        # The import is here because scipy is heavy and no other path needs it.
        from scipy.interpolate import CubicSpline

        ends = ((1, self.start_velocity), (1, self.end_velocity))
        coefficients = CubicSpline(self.times, self.waypoints, bc_type=ends).c  # (4, k - 1, n)
        return PiecewisePolynomial(self.times, np.moveaxis(coefficients[::-1], 0, 1))


@part
class Hold(PiecewisePath):
    """Constant position; it may have no coordinates, for an arm without movable joints.

    Parameters
    ----------
    point : array_like, shape (n,)
        Position [m].
    duration : float
        Duration of the path, > 0 [s].

    Raises
    ------
    InvalidArgument
        If a number is not finite, or the duration is not above zero.

    See Also
    --------
    FixedHeading : trajectory of a robot that stays in place
    WholeBody : trajectory in which arms may hold a posture

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold
    >>> goal = FixedHeading(Hold([1.0, 2.0], duration=5.0), psi=0.5)
    >>> goal(3.0).q  # [m, m, rad]
    array([1. , 2. , 0.5])
    """

    point: Any = array(unit="m", labels=axes_of, doc="constant position")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")

    @cached_property
    def _curve(self) -> PiecewisePolynomial:
        return PiecewisePolynomial(np.array([0.0, self.duration]), self.point[None, None])


@part
class _Straight(PiecewisePath):
    """Abstract base of straight paths between two points."""

    start: Any = array(unit="m", labels=axes_of, doc="start of the path")
    end: Any = array(unit="m", labels=axes_of, doc="end of the path")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")

    def check(self) -> None:
        """Raise `InvalidArgument` if shapes differ."""
        check_sizes(self, "end")


@part
class RestToRest(_Straight):
    """Straight line between two points, with zero velocity and acceleration at both ends.

    ::

        r(t) = start + (end - start) (10 s^3 - 15 s^4 + 6 s^5),   s = t / duration

    The largest speed is 15/8 of the mean speed.

    Parameters
    ----------
    start, end : array_like, shape (n,)
        Start and end [m].
    duration : float
        Duration of the path, > 0 [s].

    Raises
    ------
    InvalidArgument
        If shapes differ, a number is not finite, or the duration is out of range.

    See Also
    --------
    Line : straight line at constant speed
    CubicVia : path through a via point

    Examples
    --------
    >>> from pinmobile import RestToRest
    >>> path = RestToRest([0.0, 0.0], [4.0, 0.0], duration=2.0)
    >>> path.derivative([0.0, 1.0, 2.0], 1)[:, 0]  # [m/s]
    array([0.  , 3.75, 0.  ])
    """

    @cached_property
    def _curve(self) -> PiecewisePolynomial:
        T, line = self.duration, self.end - self.start
        zero = np.zeros_like(line)
        rows = [self.start, zero, zero, 10 * line / T**3, -15 * line / T**4, 6 * line / T**5]
        return PiecewisePolynomial(np.array([0.0, T]), np.array([rows]))


@part
class Line(_Straight):
    """Straight line between two points at constant speed.

    Parameters
    ----------
    start, end : array_like, shape (n,)
        Start and end [m].
    duration : float
        Duration of the path, > 0 [s].

    Raises
    ------
    InvalidArgument
        If shapes differ, a number is not finite, or the duration is out of range.

    See Also
    --------
    RestToRest : straight line that starts and ends at rest
    Polyline : several lines with rounded corners

    Examples
    --------
    >>> from pinmobile import Line
    >>> path = Line([0.0, 0.0], [3.0, 4.0], duration=10.0)
    >>> path.derivative(5.0, 1)  # [m/s]
    array([0.3, 0.4])
    """

    @cached_property
    def _curve(self) -> PiecewisePolynomial:
        rows = np.array([[self.start, (self.end - self.start) / self.duration]])
        return PiecewisePolynomial(np.array([0.0, self.duration]), rows)
