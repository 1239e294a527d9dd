"""Curves: cubics by a via point, splines, lines, points, circles and Lissajous figures."""

from __future__ import annotations

from functools import cached_property
from typing import Any, final

import attrs
import numpy as np

from pinmobile.arrays import Array, bounded, increasing, representable, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.parts import array, number, part
from pinmobile.paths.path import (
    Curve,
    PiecewisePath,
    PiecewisePolynomial,
    Whole,
    axes_of,
    check_sizes,
    hermite,
    stretch,
    turned,
)


class _Figure(Curve):
    """Abstract base: a path with amplitudes and rates along x and y."""

    @property
    def _axes(self) -> tuple[float, float, float, float]:
        """Amplitudes along x and y [m], and rates [rad/s]."""
        raise NotImplementedError

    def _place(self, curve: Array, order: int) -> Array:
        """Return derivatives of (rx sin(wx t), -ry cos(wy t)), shape (..., 2), where the figure lies."""
        raise NotImplementedError

    @property
    def pieces(self) -> tuple[Whole]:
        """The whole figure: it is analytic."""
        return (Whole(self),)

    def _at(self, t: Array, order: int) -> Array:
        # Sines and cosines rather than shifted phases: a multiple of pi/2 added would cost their zeros.
        rx, ry, wx, wy = map(np.float64, self._axes)  # whose powers overflow without an error
        with np.errstate(all="ignore"):
            x = rx * wx**order * _sine(wx * t, order)
            y = -ry * wy**order * _sine(wy * t, order + 1)
            curve = self._place(np.stack([x, y], axis=-1), order)
        return representable("a point or derivative of the figure", curve)


@final
@part
class Lissajous(_Figure):
    """The Lissajous figure that starts at the origin: x = rx sin(wx t), y = ry - ry cos(wy t).

    Lecture, section 5.3. A circle for rx = ry and wx = wy (see `Circle`), an ellipse for wx = wy alone.
    A negative amplitude mirrors the figure.
    """

    rx: float = number(unit="m", doc="amplitude of the figure along x")
    ry: float = number(unit="m", doc="amplitude of the figure along y")
    wx: float = number(unit="rad/s", doc="rate of the figure along x")
    wy: float = number(unit="rad/s", doc="rate of the figure along y")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")

    @property
    def _axes(self) -> tuple[float, float, float, float]:
        return self.rx, self.ry, self.wx, self.wy

    def _place(self, curve: Array, order: int) -> Array:
        if not order:
            curve[..., 1] += self.ry
        return curve


@final
@part
class Circle(_Figure):
    """A circle; without more words that which starts at the origin along the x axis.

        x = x_c + r cos(w t + phase),   y = y_c + r sin(w t + phase)

    with the phase -pi/2 and the centre (0, r) where nothing is said: x = r sin(w t), y = r - r cos(w t).
    A negative rate starts backwards. In place of the phase, `heading` tells where it starts.
    """

    radius: float = number(above=0, unit="m", doc="radius of the circle")
    rate: float = number(unit="rad/s", doc="turn rate on the circle, positive to the left")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")
    centre: Any = array(default=None, shapes=((2,),), unit="m", labels=("x", "y"), doc="middle of the circle")
    phase: float | None = number(default=None, unit="rad", doc="angle of the start on the circle")
    heading: float | None = number(default=None, unit="rad", doc="direction at the start")

    def check(self) -> None:
        """Raise `InvalidArgument` where phase and heading are both given."""
        if self.phase is not None and self.heading is not None:
            raise InvalidArgument(
                f"heading is {self.heading} rad beside phase = {self.phase} rad, expected one of them: "
                "each tells the other"
            )

    def _values(self) -> dict[str, object]:
        return {name: value for name, value in super()._values().items() if value is not None}

    @property
    def _axes(self) -> tuple[float, float, float, float]:
        return self.radius, self.radius, self.rate, self.rate

    @property
    def _turn(self) -> float:
        """What it is turned by about its centre [rad]."""
        if self.heading is not None:
            return self.heading if self.rate >= 0 else self.heading - np.pi
        return 0.0 if self.phase is None else self.phase + np.pi / 2

    def _place(self, curve: Array, order: int) -> Array:
        centre = np.array([0.0, self.radius])
        if self._turn:
            curve, centre = (turned(each, self._turn) for each in (curve, centre))
        if not order:
            curve += centre if self.centre is None else np.asarray(self.centre)
        return curve


def _sine(angle: Array, quarter_turns: int) -> Array:
    wave = np.cos(angle) if quarter_turns % 2 else np.sin(angle)
    return np.asarray(-wave if quarter_turns % 4 >= 2 else wave)


def _velocity(doc: str) -> Any:
    at_rest = attrs.Factory(lambda path: np.zeros(len(axes_of(path))), takes_self=True)
    return array(default=at_rest, unit="m/s", labels=axes_of, doc=doc)


@part
class CubicVia(PiecewisePath):
    """Two cubics per coordinate, from start to end through a via point (lecture, section 5.1 and 5.2).

    With a = (a_0 ... a_3) before and b after the via point,

        r(t) = sum of a_k t^k  for t < t_via,      r(t) = sum of b_k (t - t_via)^k  after it.

    With `via_velocity` given these are two independent cubics, and the acceleration jumps at the via
    point. With it free, velocity and acceleration are continuous there.
    Points are of n >= 1 coordinates, in the plane of 2. At its ends it rests where no velocity is given.
    """

    start: Any = array(unit="m", labels=axes_of, doc="start of the path")
    via: Any = array(unit="m", labels=axes_of, doc="via point of the path")
    end: Any = array(unit="m", labels=axes_of, doc="end of the path")
    t_via: float = number(above=0, unit="s", doc="time at the via point")
    t_end: float = number(above=0, unit="s", fixed=True, doc="time at the end")
    via_velocity: Any = array(
        default=None, unit="m/s", labels=axes_of, doc="velocity at the via point, free without one"
    )
    start_velocity: Any = _velocity("velocity at the start")
    end_velocity: Any = _velocity("velocity at the end")

    def check(self) -> None:
        """Raise `InvalidArgument` where shapes differ or the times are out of order."""
        shaped("start", self.start, ("n>=1",))
        check_sizes(self, "via", "end", "via_velocity", "start_velocity", "end_velocity")
        if not self.t_via < self.t_end:
            raise InvalidArgument(f"t_via is {self.t_via} s, expected 0 < t_via < t_end = {self.t_end} s")
        stretch("t_via", self.t_via)
        stretch("t_end - t_via", self.t_end - self.t_via)
        super().check()

    @property
    def duration(self) -> float:
        """The time at the end [s]."""
        return self.t_end

    @cached_property
    def _curve(self) -> PiecewisePolynomial:
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


@part
class Spline(PiecewisePath):
    """The cubic spline through waypoints, clamped at its ends; `CubicVia` with a free via is that of three.

    At its ends it rests where no velocity is given.
    """

    waypoints: Any = array(shapes=(("k", "n"),), unit="m", labels=axes_of, doc="waypoints of the path")
    times: Any = array(unit="s", fixed=True, doc="times at the waypoints, from zero and increasing")
    start_velocity: Any = _velocity("velocity at the start")
    end_velocity: Any = _velocity("velocity at the end")

    def check(self) -> None:
        """Raise `InvalidArgument` where shapes differ or the times do not increase from zero."""
        shaped("waypoints", self.waypoints, ("k>=2", "n>=1"))
        times = shaped("times", self.times, (len(self.waypoints),), words=", one per waypoint")
        check_sizes(self, "start_velocity", "end_velocity")
        bounded("times[0]", times[0], least=0, most=0, unit="s")
        increasing("times", times)
        for k, step in enumerate(np.diff(times), 1):
            stretch(f"times[{k}] - times[{k - 1}]", step)
        super().check()

    @property
    def duration(self) -> float:
        """The time at the last waypoint [s]."""
        return float(self.times[-1])

    @cached_property
    def _curve(self) -> PiecewisePolynomial:
        # Here, because scipy is heavy and no other path needs it.
        from scipy.interpolate import CubicSpline

        ends = ((1, self.start_velocity), (1, self.end_velocity))
        try:
            with np.errstate(all="ignore"):  # PiecewisePolynomial looks
                highest_first = CubicSpline(self.times, self.waypoints, bc_type=ends).c  # (4, k - 1, n)
        except (ValueError, np.linalg.LinAlgError):  # where a slope is no number, or steps differ too much
            highest_first = np.full((4, len(self.times) - 1, self.waypoints.shape[1]), np.nan)
        return PiecewisePolynomial(self.times, np.moveaxis(highest_first[::-1], 0, 1))


@part
class Hold(PiecewisePath):
    """A point that is held; of no coordinates too, for an arm that has no joints left."""

    point: Any = array(unit="m", labels=axes_of, doc="point that is held")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")

    @cached_property
    def _curve(self) -> PiecewisePolynomial:
        return PiecewisePolynomial(np.array([0.0, self.duration]), self.point[None, None])


@part
class RestToRest(PiecewisePath):
    """The straight way from one point to another, with velocity and acceleration zero at both.

    r(t) = start + (end - start) (10 s^3 - 15 s^4 + 6 s^5) with s = t / duration, the quintic; the speed is at
    most 15/8 of the mean one.
    """

    start: Any = array(unit="m", labels=axes_of, doc="start of the path")
    end: Any = array(unit="m", labels=axes_of, doc="end of the path")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")

    def check(self) -> None:
        """Raise `InvalidArgument` where shapes differ."""
        check_sizes(self, "end")
        super().check()

    @cached_property
    def _curve(self) -> PiecewisePolynomial:
        T = stretch("duration", self.duration)
        with np.errstate(all="ignore"):  # PiecewisePolynomial looks
            way = self.end - self.start
            still = np.zeros_like(way)
            rows = [self.start, still, still, 10 * way / T**3, -15 * way / T**4, 6 * way / T**5]
        return PiecewisePolynomial(np.array([0.0, T]), np.array([rows]))


@part
class Line(PiecewisePath):
    """The straight line from one point to another at one speed; `RestToRest` starts and ends at rest."""

    start: Any = array(unit="m", labels=axes_of, doc="start of the path")
    end: Any = array(unit="m", labels=axes_of, doc="end of the path")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")

    def check(self) -> None:
        """Raise `InvalidArgument` where shapes differ."""
        check_sizes(self, "end")
        super().check()

    @cached_property
    def _curve(self) -> PiecewisePolynomial:
        T = stretch("duration", self.duration)
        with np.errstate(all="ignore"):  # PiecewisePolynomial looks
            rows = np.array([[self.start, (self.end - self.start) / T]])
        return PiecewisePolynomial(np.array([0.0, T]), rows)
