"""Paths made of polynomials end to end."""

from __future__ import annotations

from dataclasses import dataclass
from math import perm

import numpy as np

from pinmobile.arrays import Array, ArrayLike, frozen, positive, representable
from pinmobile.errors import InvalidArgument
from pinmobile.paths.path import Curve


@dataclass(frozen=True, eq=False)
class Polynomial:
    """One polynomial piece, r(t) = sum over k of c_k (t - start)^k.

    Parameters
    ----------
    start, end : float
        Where it holds [s].
    coefficients : ndarray, shape (m, n)
        c_k, the constant first [m/s^k].
    """

    start: float
    end: float
    coefficients: Array

    def derivative(self, t: ArrayLike, order: int) -> Array:
        """Return the derivative, shape (..., n) [m/s^order], at `t`, shape (...) [s]."""
        return _horner(self.coefficients, np.asarray(t) - self.start, order)


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial:
    """Polynomials end to end; its maker answers for shapes and order.

    Parameters
    ----------
    knots : ndarray, shape (k + 1,)
        Where pieces start and end, from zero and increasing [s].
    coefficients : ndarray, shape (k, m, n)
        Of each piece, in powers of the time since its knot, the constant first [m/s^power].
    """

    knots: Array
    coefficients: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "knots", frozen(self.knots))
        object.__setattr__(
            self, "coefficients", representable("a coefficient of the path", frozen(self.coefficients))
        )

    @property
    def pieces(self) -> tuple[Polynomial, ...]:
        """The pieces, in order."""
        ends = zip(self.knots.tolist(), self.knots[1:].tolist(), self.coefficients, strict=False)
        return tuple(Polynomial(start, end, rows) for start, end, rows in ends)

    def derivative(self, t: Array, order: int) -> Array:
        """Return the derivative, shape (..., n) [m/s^order], at `t`, shape (...) [s]."""
        # Only the knots inside decide: the end of the last piece belongs to that piece.
        index = np.searchsorted(self.knots[1:-1], t, side="right")
        return _horner(np.moveaxis(self.coefficients, 0, -1)[..., index], t - self.knots[index], order)


def hermite(step: float, left: Array, right: Array, left_velocity: Array, right_velocity: Array) -> Array:
    """Return the cubic between two positions with the velocities there.

    Parameters
    ----------
    step : float
        Time from left to right [s].
    left, right : ndarray, shape (n,)
        Positions [m].
    left_velocity, right_velocity : ndarray, shape (n,)
        Velocities [m/s].

    Returns
    -------
    coefficients : ndarray, shape (4, n)
        In powers of the time since `left`, the constant first [m/s^power].
    """
    with np.errstate(all="ignore"):  # PiecewisePolynomial looks
        slope = (right - left) / step
        quadratic = (3 * slope - 2 * left_velocity - right_velocity) / step
        cubic = (left_velocity + right_velocity - 2 * slope) / step**2
        return np.array([left, left_velocity, quadratic, cubic])


def stretch(name: str, value: ArrayLike) -> float:
    """Return a time between two points [s], above zero, whose fifth power is a number.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    time = positive(name, value, "s")
    if not _SHORTEST <= time <= _FARTHEST:
        raise InvalidArgument(f"{name} is {time} s, expected {_SHORTEST:g} to {_FARTHEST:g} s")
    return time


_SHORTEST, _FARTHEST = 1e-50, 1e50  # [s]


def _horner(coefficients: Array, s: Array, order: int) -> Array:
    terms, n = coefficients.shape[:2]
    out = np.zeros((*s.shape, n))
    # One coordinate at a time: numpy is slow along a last axis of two.
    for j in range(n if order < terms else 0):
        # The k-th power leaves k (k - 1) ... (k - order + 1) behind: perm(k, order).
        value = perm(terms - 1, order) * coefficients[-1, j]
        for k in range(terms - 2, order - 1, -1):
            value = value * s + perm(k, order) * coefficients[k, j]
        out[..., j] = value
    return out


class PiecewisePath(Curve):
    """Abstract base: a path of polynomials."""

    @property
    def _curve(self) -> PiecewisePolynomial:
        raise NotImplementedError

    def check(self) -> None:
        """Raise `InvalidArgument` where a coefficient is beyond the largest number."""
        self._curve  # noqa: B018

    @property
    def pieces(self) -> tuple[Polynomial, ...]:
        """The polynomials, in order."""
        return self._curve.pieces

    def _at(self, t: Array, order: int) -> Array:
        return self._curve.derivative(t, order)
