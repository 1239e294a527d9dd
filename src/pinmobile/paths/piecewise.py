"""What paths made of polynomials end to end have in common."""

from dataclasses import dataclass, field

from pinmobile.arrays import Array, ArrayLike
from pinmobile.paths.polynomials import PiecewisePolynomial, Polynomial
from pinmobile.paths.protocol import checked_order, within
from pinmobile.paths.values import Value

__all__ = ["PiecewisePath"]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PiecewisePath(Value):
    """Abstract base: a path whose maker has set `_curve`."""

    _curve: PiecewisePolynomial = field(init=False)

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        return float(self._curve.knots[-1])

    @property
    def pieces(self) -> tuple[Polynomial, ...]:
        """The polynomials, in order."""
        return self._curve.pieces

    def __call__(self, t: ArrayLike) -> Array:
        """Return the position.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        r : ndarray, shape (..., n)
            Position [m].

        Raises
        ------
        InvalidArgument
            If a time is outside.
        """
        return self.derivative(t, 0)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        """Return a derivative; at a knot the one from the right.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].
        order : int
            0 for the position, 1 for the velocity, and so on.

        Returns
        -------
        dr : ndarray, shape (..., n)
            The derivative [m/s^order].

        Raises
        ------
        InvalidArgument
            If a time is outside, or `order` is not a whole number >= 0.
        """
        return self._curve.derivative(within("t", t, self.duration), checked_order(order))
