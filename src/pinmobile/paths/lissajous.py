"""Lissajous figures, circles and ellipses among them."""

from dataclasses import dataclass

import numpy as np

from pinmobile.arrays import Array, ArrayLike, positive, representable, scalar
from pinmobile.paths.protocol import Whole, checked_order, within

__all__ = ["Circle", "Lissajous"]


@dataclass(frozen=True)
class Lissajous:
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

    def __post_init__(self) -> None:
        for name in ("rx", "ry", "wx", "wy"):
            object.__setattr__(self, name, scalar(name, getattr(self, name)))
        object.__setattr__(self, "duration", positive("duration", self.duration, "s"))

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
        wx, wy = np.float64(self.wx), np.float64(self.wy)  # whose powers overflow without an error
        with np.errstate(all="ignore"):
            x = self.rx * wx**order * _sine(wx * t, order)
            y = self.ry * wy**order * _sine(wy * t, order + 1)
            curve = np.stack([x, self.ry - y if order == 0 else -y], axis=-1)
        return representable("a point or derivative of the figure", curve)


def Circle(radius: float, rate: float, duration: float) -> Lissajous:
    """Return the circle that starts at the origin along the x axis.

    Parameters
    ----------
    radius : float
        Radius [m], > 0.
    rate : float
        Turn rate of its tangent [rad/s], positive to the left; a negative one starts backwards along x.
    duration : float
        Time from start to end [s], > 0.

    Returns
    -------
    path : Lissajous
        With both amplitudes `radius` and both rates `rate`.

    Raises
    ------
    InvalidArgument
        If a number is not finite, or `radius` or `duration` not above zero.
    """
    radius = positive("radius", radius, "m")
    return Lissajous(radius, radius, rate, rate, duration)


def _sine(angle: Array, quarter_turns: int) -> Array:
    wave = np.cos(angle) if quarter_turns % 2 else np.sin(angle)
    return np.asarray(-wave if quarter_turns % 4 >= 2 else wave)
