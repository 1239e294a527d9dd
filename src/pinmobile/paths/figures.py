"""Figures driven at given rates: Lissajous figures and circles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, positive, representable, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.paths.path import Curve, Whole, of_point, turned
from pinmobile.plant import Parameter


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
@dataclass(frozen=True, eq=False, repr=False)
class Lissajous(_Figure):
    """The Lissajous figure that starts at the origin: x = rx sin(wx t), y = ry - ry cos(wy t).

    Lecture, section 5.3. A circle for rx = ry and wx = wy (see `Circle`), an ellipse for wx = wy alone.

    Parameters
    ----------
    rx, ry : float
        Amplitudes [m]; a negative one mirrors the figure.
    wx, wy : float
        Rates [rad/s].
    duration : float
        Time from start to end [s], > 0.

    Raises
    ------
    InvalidArgument
        If a number is not finite, or `duration` not above zero.
    """

    rx: float
    ry: float
    wx: float
    wy: float
    duration: float

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("lissajous_rx", "m", "amplitude of the figure along x", attribute="rx"),
        Parameter("lissajous_ry", "m", "amplitude of the figure along y", attribute="ry"),
        Parameter("lissajous_wx", "rad/s", "rate of the figure along x", attribute="wx"),
        Parameter("lissajous_wy", "rad/s", "rate of the figure along y", attribute="wy"),
    )

    def __post_init__(self) -> None:
        for name in ("rx", "ry", "wx", "wy"):
            object.__setattr__(self, name, scalar(name, getattr(self, name)))
        object.__setattr__(self, "duration", positive("duration", self.duration, "s"))

    @property
    def _axes(self) -> tuple[float, float, float, float]:
        return self.rx, self.ry, self.wx, self.wy

    def _place(self, curve: Array, order: int) -> Array:
        if not order:
            curve[..., 1] += self.ry
        return curve


def _of_circle(*, centre: bool = True, phase: bool = True, heading: bool = True) -> tuple[Parameter, ...]:
    return (
        Parameter("circle_radius", "m", "radius of the circle", 0.0, may_vanish=False, attribute="radius"),
        Parameter("circle_rate", "rad/s", "turn rate on the circle", attribute="rate"),
        *(of_point("circle_centre", "centre", "middle of the circle") if centre else ()),
        *((Parameter("circle_phase", "rad", "angle of the start on the circle", attribute="phase"),) * phase),
        *((Parameter("circle_heading", "rad", "direction at the start", attribute="heading"),) * heading),
    )


@final
@dataclass(frozen=True, eq=False, repr=False)
class Circle(_Figure):
    """A circle; without more words that which starts at the origin along the x axis.

        x = x_c + r cos(w t + phase),   y = y_c + r sin(w t + phase)

    with the phase -pi/2 and the centre (0, r) where nothing is said: x = r sin(w t), y = r - r cos(w t).

    Parameters
    ----------
    radius : float
        Radius r [m], > 0.
    rate : float
        Turn rate w of its tangent [rad/s], positive to the left; a negative one starts backwards.
    duration : float
        Time from start to end [s], > 0.
    centre : array_like, shape (2,), optional
        Its middle [m]; without one the circle starts at the origin.
    phase : float, optional
        Angle from the x axis at which the start is seen from the centre [rad].
    heading : float, optional
        In place of the phase, the direction in which the start is driven [rad].

    Raises
    ------
    InvalidArgument
        If a number is not finite, `centre` has another shape, `radius` or `duration` is not above zero, or
        `phase` and `heading` are both given.
    """

    radius: float
    rate: float
    duration: float
    centre: ArrayLike | None = None
    phase: float | None = None
    heading: float | None = None

    parameters: ClassVar[tuple[Parameter, ...]] = _of_circle()

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", positive("radius", self.radius, "m"))
        object.__setattr__(self, "rate", scalar("rate", self.rate))
        object.__setattr__(self, "duration", positive("duration", self.duration, "s"))
        if self.centre is not None:
            centre = finite("centre", self.centre)
            if centre.shape != (2,):
                raise InvalidArgument(f"centre has shape {centre.shape}, expected (2,)")
            object.__setattr__(self, "centre", frozen(centre))
        for name in ("phase", "heading"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, scalar(name, getattr(self, name)))
        if self.phase is not None and self.heading is not None:
            raise InvalidArgument(
                f"heading is {self.heading} rad beside phase = {self.phase} rad, expected one of them: "
                "each tells the other"
            )
        said = {name: getattr(self, name) is not None for name in ("centre", "phase", "heading")}
        object.__setattr__(self, "parameters", _of_circle(**said))

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
