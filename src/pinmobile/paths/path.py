"""Paths: protocol, base class, polynomials in time, and transformed paths."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import perm
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, final, runtime_checkable

import attrs
import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, check_integer, finite, frozen, rotate, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.parts import by_value, child, fields_of, number, part, require

# Relative to the duration: tolerance for the rounding of `n * dt`.
_ROUNDING = 4 * float(np.finfo(np.float64).eps)


@runtime_checkable
class Path(Protocol):
    """A path: path(t), path.derivative(t, order), path.duration.

    It is a curve r(t) of n coordinates, 0 <= t <= duration. Any class with these members is a path. At a knot
    ``derivative`` returns the limit from the right, at the end of the path the limit from the left. A path
    that is not analytic everywhere lists its analytic pieces in an attribute ``pieces``, a tuple of
    `paths.Piece`; a path without it counts as one piece.

    See Also
    --------
    Circle : a path of the library
    Tangent : trajectory along a path
    paths.Piece : analytic piece of a path

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import Tangent
    >>> class Parabola:
    ...     duration = 2.0
    ...     def __call__(self, t):
    ...         return self.derivative(t, 0)
    ...     def derivative(self, t, order):
    ...         t = np.asarray(t, float)
    ...         x = [t, 0 * t + 1, 0 * t][min(order, 2)]
    ...         y = [t * t, 2 * t, 0 * t + 2, 0 * t][min(order, 3)]
    ...         return np.stack([x, y], axis=-1)
    >>> Tangent(Parabola())(0.5).q  # [m, m, rad]
    array([0.5       , 0.25      , 0.78539816])
    """

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        ...

    def __call__(self, t: ArrayLike, /) -> Array:
        """Return the position r(t).

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        r : ndarray, shape (..., n)
            Position [m].
        """
        ...

    def derivative(self, t: ArrayLike, order: int, /) -> Array:
        """Return a derivative of any order >= 0.

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
        """
        ...


class Piece(Protocol):
    """Analytic piece of a path, valid on a closed interval, so that the limits at both ends are exact.

    See Also
    --------
    paths.pieces_of : pieces of any path

    Examples
    --------
    >>> from pinmobile import Spline
    >>> path = Spline([[0, 0], [1, 0], [1, 1]], times=[0, 1, 2])
    >>> [(piece.start, piece.end) for piece in path.pieces]  # [s]
    [(0.0, 1.0), (1.0, 2.0)]
    """

    @property
    def start(self) -> float:
        """Time at the start of the piece [s]."""
        ...

    @property
    def end(self) -> float:
        """Time at the end of the piece [s]."""
        ...

    def derivative(self, t: ArrayLike, order: int, /) -> Array:
        """Return a derivative.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, start <= t <= end [s].
        order : int
            0 for the position, 1 for the velocity, and so on.

        Returns
        -------
        dr : ndarray, shape (..., n)
            The derivative [m/s^order].
        """
        ...


@dataclass(frozen=True)
class Whole:
    """The only piece of an analytic path.

    Parameters
    ----------
    path : Path
        The path.

    See Also
    --------
    paths.pieces_of : pieces of any path

    Examples
    --------
    >>> from pinmobile import Circle
    >>> from pinmobile.paths import Whole
    >>> piece = Whole(Circle(radius=2.0, rate=0.5, duration=10.0))
    >>> piece.start, piece.end  # [s]
    (0.0, 10.0)
    """

    path: Path

    @property
    def start(self) -> float:
        """Zero [s]."""
        return 0.0

    @property
    def end(self) -> float:
        """Duration of the path [s]."""
        return float(self.path.duration)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        """Return the path's derivative.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, start <= t <= end [s].
        order : int
            0 for the position, 1 for the velocity, and so on.

        Returns
        -------
        dr : ndarray, shape (..., n)
            The derivative [m/s^order].
        """
        return self.path.derivative(t, order)


class MovedPiece(NamedTuple):
    """Piece of a path that is moved in time or in space."""

    start: float
    end: float
    derivative: Callable[[ArrayLike, int], Array]


def pieces_of(path: Path) -> tuple[Piece, ...]:
    """Return the analytic pieces of a path, in order.

    Parameters
    ----------
    path : Path
        Any path.

    Returns
    -------
    pieces : tuple of Piece
        The attribute ``pieces`` of the path; without it, the whole path as one piece.

    See Also
    --------
    paths.Piece : protocol of pieces

    Examples
    --------
    >>> from pinmobile import CubicVia
    >>> from pinmobile.paths import pieces_of
    >>> path = CubicVia([0, 0], [1, 2], [3, 3], t_via=2.0, t_end=5.0)
    >>> [piece.end for piece in pieces_of(path)]  # [s]
    [2.0, 5.0]
    """
    return tuple(getattr(path, "pieces", ())) or (Whole(path),)


def check_path(path: object, size: int) -> Path:
    """Return a path after a check of its points' shape and of its pieces.

    Raises
    ------
    InvalidArgument
        If it is not a path, its points have another shape, or two pieces do not meet.
    """
    checked: Any = require("path", path, Path)
    region = "the plane" if size == 2 else "space"
    shaped("path at t = 0", checked(0.0), (size,), words=f", a path in {region}")
    for left, right in pairwise(pieces_of(checked)):
        ends = left.derivative(left.end, 0), right.derivative(right.start, 0)
        if jumps(*ends, _JUMP_TOLERANCE):
            end, start = map(format_point, ends)
            raise InvalidArgument(
                f"path jumps from {end} m to {start} m at t = {right.start:g} s, expected pieces that meet"
            )
    return checked  # type: ignore[no-any-return]


_JUMP_TOLERANCE = 1e-6  # [m], and relative to the coordinates: above the rounding error of any curve


def jumps(one: Array, other: Array, tolerance: float) -> bool:
    """Return whether two points differ by more than `tolerance` [m], relative to coordinates beyond 1 m."""
    return not bool((np.abs(other - one) <= tolerance * (1 + np.abs(one).max(initial=0.0))).all())


def format_point(point: Array) -> str:
    """Return a point as text, with rounding errors of zeros removed."""
    return f"({', '.join(f'{each:.6g}' for each in np.round(point, 9) + 0.0)})"


def within(name: str, t: ArrayLike, duration: float) -> Array:
    """Return times as float64 after a check that they lie in [0, duration].

    Times that exceed the interval by rounding errors are clipped.

    Parameters
    ----------
    name : str
        Name of the argument, for the error message.
    t : array_like, any shape
        Times [s].
    duration : float
        Latest allowed time [s].

    Returns
    -------
    times : ndarray, shape of `t`
        Times in [0, duration] [s].

    Raises
    ------
    InvalidArgument
        If a time is not finite, or outside the interval.

    See Also
    --------
    paths.Path : protocol of paths, for a path of your own

    Examples
    --------
    >>> from pinmobile.paths import within
    >>> within("t", [0.0, 1.0 + 1e-16], 1.0)
    array([0., 1.])
    """
    times = finite(name, t)
    clipped = np.minimum(np.maximum(times, 0.0), duration)
    is_close = np.abs(times - clipped) <= _ROUNDING * duration
    return bounded(name, np.where(is_close, clipped, times), least=0, most=duration, unit="s")


def axes_of(path: Any) -> tuple[str, ...]:
    """Return labels of the coordinates of a path whose first field holds points: x and y, or numbers."""
    size = np.shape(getattr(path, attrs.fields(type(path))[0].name))[-1]
    return ("x", "y") if size == 2 else tuple(map(str, range(size)))


def check_sizes(path: Any, *names: str) -> None:
    """Check that points or velocities have as many coordinates as the first field; None passes.

    Raises
    ------
    InvalidArgument
        If a size differs.
    """
    expected = (len(axes_of(path)),)
    for name in names:
        value = getattr(path, name)
        if value is not None:
            shaped(name, value, expected)


@by_value
class Value:
    """Abstract base of parts with equality, hash and repr by their fields, arrays as tuples."""

    def _values(self) -> dict[str, object]:
        values = {name: value for name, _, value in fields_of(self)}
        return {name: _tuples(v.tolist()) if isinstance(v, np.ndarray) else v for name, v in values.items()}

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={value!r}" for name, value in self._values().items())
        return f"{type(self).__name__}({fields})"


class Curve(Value, ABC):
    """Abstract base of the library's paths: a subclass defines the derivatives at checked times."""

    if TYPE_CHECKING:  # of a part it may be a field

        @property
        def duration(self) -> float:
            """Time from start to end [s]."""

    @abstractmethod
    def _at(self, t: Array, order: int) -> Array:
        """Return the derivative at times on the path."""

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
            If a time lies outside.
        """
        return self.derivative(t, 0)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        """Return a derivative; at a knot it is the limit from the right.

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
            If a time lies outside, or `order` is not a whole number >= 0.
        """
        return self._at(within("t", t, self.duration), check_integer("order", order, least=0))

    def moved(self, x: float = 0.0, y: float = 0.0, angle: float = 0.0) -> TransformedPath:
        """Return the path, rotated about the origin and then translated.

        Parameters
        ----------
        x, y : float
            Translation [m].
        angle : float
            Rotation about the origin [rad].

        Returns
        -------
        path : TransformedPath
            The new path.

        Raises
        ------
        InvalidArgument
            If a number is not finite, or the points are neither in the plane nor in space.
        """
        return TransformedPath(self, x, y, angle)


def _tuples(value: object) -> object:
    """Return nested lists as nested tuples."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


@final
@part
class TransformedPath(Curve):
    """Path rotated about the origin, then translated.

    A path in space is rotated about z and keeps its height. The method ``moved`` of a path makes one.

    Parameters
    ----------
    path : Path
        Path in the plane or in space.
    x, y : float
        Translation [m].
    angle : float
        Rotation about the origin [rad].

    Raises
    ------
    InvalidArgument
        If a number is not finite, or the points are neither in the plane nor in space.

    See Also
    --------
    CompositePath : paths one after another

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import Line
    >>> line = Line([0.0, 0.0], [1.0, 0.0], duration=2.0)
    >>> line.moved(x=3.0, angle=np.pi / 2)(2.0)  # [m]
    array([3., 1.])
    """

    path: Any = child(Path, doc="any path in the plane or in space")
    x: float = number(default=0.0, unit="m", doc="translation along x")
    y: float = number(default=0.0, unit="m", doc="translation along y")
    angle: float = number(default=0.0, unit="rad", doc="rotation of the path about the origin")

    def check(self) -> None:
        """Raise `InvalidArgument` if points are neither in the plane nor in space."""
        shaped("path at t = 0", self.path(0.0), (2,), (3,))

    @property
    def duration(self) -> float:
        """Duration of the path [s]."""
        return float(self.path.duration)

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Pieces of the path, transformed."""

        def moved(piece: Piece) -> Piece:
            def derivative(t: ArrayLike, order: int) -> Array:
                return self._transform(piece.derivative(t, order), order)

            return MovedPiece(piece.start, piece.end, derivative)

        return tuple(map(moved, pieces_of(self.path)))

    def _at(self, t: Array, order: int) -> Array:
        return self._transform(self.path.derivative(t, order), order)

    def _transform(self, vectors: Array, order: int) -> Array:
        """Return positions or derivatives after rotation and translation."""
        result = np.array(vectors, np.float64)
        if self.angle:
            result = rotate(np.cos(self.angle), np.sin(self.angle), result)
        if not order:
            result[..., :2] += self.x, self.y
        return result


@dataclass(frozen=True, eq=False)
class Polynomial:
    """Polynomial piece, r(t) = sum over k of c_k (t - start)^k.

    Parameters
    ----------
    start, end : float
        Interval of the piece [s].
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
    """Consecutive polynomials; its caller is responsible for shapes and order.

    Parameters
    ----------
    knots : ndarray, shape (k + 1,)
        Times at the ends of pieces, increasing from zero [s].
    coefficients : ndarray, shape (k, m, n)
        Coefficients of each piece, in powers of the time since its knot, the constant first [m/s^power].
    """

    knots: Array
    coefficients: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "knots", frozen(self.knots))
        object.__setattr__(self, "coefficients", frozen(self.coefficients))

    @property
    def pieces(self) -> tuple[Polynomial, ...]:
        """The pieces, in order."""
        ends = zip(self.knots.tolist(), self.knots[1:].tolist(), self.coefficients, strict=False)
        return tuple(Polynomial(start, end, rows) for start, end, rows in ends)

    def derivative(self, t: Array, order: int) -> Array:
        """Return the derivative, shape (..., n) [m/s^order], at `t`, shape (...) [s]."""
        # The inner knots decide: the end of the last piece belongs to that piece.
        index = np.searchsorted(self.knots[1:-1], t, side="right")
        return _horner(np.moveaxis(self.coefficients, 0, -1)[..., index], t - self.knots[index], order)


def hermite(step: float, left: Array, right: Array, left_velocity: Array, right_velocity: Array) -> Array:
    """Return the cubic between two positions with given velocities.

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
        Coefficients in powers of the time since `left`, the constant first [m/s^power].
    """
    slope = (right - left) / step
    quadratic = (3 * slope - 2 * left_velocity - right_velocity) / step
    cubic = (left_velocity + right_velocity - 2 * slope) / step**2
    return np.array([left, left_velocity, quadratic, cubic])


def _horner(coefficients: Array, s: Array, order: int) -> Array:
    """Return a derivative of a polynomial by Horner's method, shape (..., n)."""
    terms, n = coefficients.shape[:2]
    result = np.zeros((*s.shape, n))
    # The loop runs over coordinates, because NumPy is slow along a last axis of two.
    for j in range(n if order < terms else 0):
        # The derivative of the k-th power has the factor k (k - 1) ... (k - order + 1) = perm(k, order).
        value = perm(terms - 1, order) * coefficients[-1, j]
        for k in range(terms - 2, order - 1, -1):
            value = value * s + perm(k, order) * coefficients[k, j]
        result[..., j] = value
    return result


class PiecewisePath(Curve):
    """Abstract base of paths of polynomials."""

    @property
    @abstractmethod
    def _curve(self) -> PiecewisePolynomial:
        """The polynomials as one curve."""

    @property
    def pieces(self) -> tuple[Polynomial, ...]:
        """The polynomials, in order."""
        return self._curve.pieces

    def _at(self, t: Array, order: int) -> Array:
        return self._curve.derivative(t, order)
