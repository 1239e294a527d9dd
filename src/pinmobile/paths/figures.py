"""Figures driven at given rates: Lissajous figures and circles."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, representable
from pinmobile.errors import InvalidArgument
from pinmobile.parts import array, number, part
from pinmobile.paths.path import Curve, Whole, turned


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
