"""Lissajous figures, circles and ellipses among them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, positive, representable, scalar
from pinmobile.paths.path import Whole, checked_order, within
from pinmobile.plant import Parameter


class _Figure:
    """Abstract base: a path with amplitudes and rates along x and y."""

    duration: float

    @property
    def _axes(self) -> tuple[Any, Any, Any, Any]:
        """Amplitudes along x and y [m], and rates [rad/s]."""
        raise NotImplementedError

    @property
    def pieces(self) -> tuple[Whole]:
        """The whole figure: it is analytic."""
        return (Whole(self),)

    def __call__(self, t: ArrayLike) -> Array:
        """Return the position.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        r : ndarray, shape (..., 2)
            Position [m].

        Raises
        ------
        InvalidArgument
            If a time is outside.
        """
        return self.derivative(t, 0)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        """Return a derivative.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].
        order : int
            0 for the position, 1 for the velocity, and so on.

        Returns
        -------
        dr : ndarray, shape (..., 2)
            The derivative [m/s^order].

        Raises
        ------
        InvalidArgument
            If a time is outside, or `order` is not a whole number >= 0.
        """
        t, order = within("t", t, self.duration), checked_order(order)
        # Sines and cosines rather than shifted phases: a multiple of pi/2 added would cost their zeros.
        rx, ry, wx, wy = map(np.float64, self._axes)  # whose powers overflow without an error
        with np.errstate(all="ignore"):
            x = rx * wx**order * _sine(wx * t, order)
            y = ry * wy**order * _sine(wy * t, order + 1)
            curve = np.stack([x, ry - y if order == 0 else -y], axis=-1)
        return representable("a point or derivative of the figure", curve)


@final
@dataclass(frozen=True)
class Lissajous(_Figure):
    """x = rx sin(wx t), y = ry - ry cos(wy t) (lecture, section 5.3).

    A circle for rx = ry and wx = wy (see `Circle`), an ellipse for wx = wy alone.

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
    def _axes(self) -> tuple[Any, Any, Any, Any]:
        return self.rx, self.ry, self.wx, self.wy


@final
@dataclass(frozen=True)
class Circle(_Figure):
    """The circle that starts at the origin along the x axis: x = r sin(w t), y = r - r cos(w t).

    Parameters
    ----------
    radius : float
        Radius r [m], > 0.
    rate : float
        Turn rate w of its tangent [rad/s], positive to the left; a negative one starts backwards along x.
    duration : float
        Time from start to end [s], > 0.

    Raises
    ------
    InvalidArgument
        If a number is not finite, or `radius` or `duration` not above zero.
    """

    radius: float
    rate: float
    duration: float

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("circle_radius", "m", "radius of the circle", 0.0, may_vanish=False, attribute="radius"),
        Parameter("circle_rate", "rad/s", "turn rate on the circle", attribute="rate"),
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", positive("radius", self.radius, "m"))
        object.__setattr__(self, "rate", scalar("rate", self.rate))
        object.__setattr__(self, "duration", positive("duration", self.duration, "s"))

    @property
    def _axes(self) -> tuple[Any, Any, Any, Any]:
        return self.radius, self.radius, self.rate, self.rate


def _sine(angle: Array, quarter_turns: int) -> Array:
    wave = np.cos(angle) if quarter_turns % 2 else np.sin(angle)
    return np.asarray(-wave if quarter_turns % 4 >= 2 else wave)
