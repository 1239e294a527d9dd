"""Paths: their protocol, their base class, polynomials in time, and a path elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import perm
from typing import TYPE_CHECKING, Any, Protocol, final, runtime_checkable

import attrs
import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, finite, frozen, positive, representable, shaped, whole
from pinmobile.errors import InvalidArgument
from pinmobile.parts import child, fields_of, number, part, required

# Relative to the duration: room for the rounding of `n * dt`, and for no more.
_ROUNDING = 4 * float(np.finfo(np.float64).eps)


@runtime_checkable
class Path(Protocol):
    """A path: path(t), path.derivative(t, order), path.duration.

    A curve r(t) of n coordinates, 0 <= t <= duration; a user's own class is as good as the library's.
    At a knot `derivative` is the limit from the right, at the end of the path that from the left. A path
    that is not analytic all along says where by an attribute ``pieces``, a tuple of `Piece`; without it
    the whole path counts as one.
    """

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        ...

    def __call__(self, t: ArrayLike, /) -> Array:
        """Return r(t), shape (..., n) [m], for `t` of shape (...) [s]."""
        ...

    def derivative(self, t: ArrayLike, order: int, /) -> Array:
        """Return the derivative of any order >= 0, shape (..., n) [m/s^order], at `t`, shape (...) [s]."""
        ...


class Piece(Protocol):
    """One analytic stretch of a path; valid on the closed interval, so that both its limits are exact."""

    @property
    def start(self) -> float:
        """Time at which it starts [s]."""
        ...

    @property
    def end(self) -> float:
        """Time at which it ends [s]."""
        ...

    def derivative(self, t: ArrayLike, order: int, /) -> Array:
        """Return the derivative, shape (..., n) [m/s^order], at start <= t <= end, shape (...) [s]."""
        ...


@dataclass(frozen=True)
class Whole:
    """A path that is analytic all along, as its only piece.

    Parameters
    ----------
    path : Path
        The path.
    """

    path: Path

    @property
    def start(self) -> float:
        """Zero [s]."""
        return 0.0

    @property
    def end(self) -> float:
        """The path's duration [s]."""
        return float(self.path.duration)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        """Return the path's derivative, shape (..., n) [m/s^order], at `t`, shape (...) [s]."""
        return self.path.derivative(t, order)


def pieces_of(path: Path) -> tuple[Piece, ...]:
    """Return the analytic pieces of a path, in order; a path that names none is one piece."""
    return tuple(getattr(path, "pieces", ())) or (Whole(path),)


def checked_path(path: object, size: int) -> Path:
    """Return a path whose points have 2 or 3 coordinates, and whose pieces meet.

    Raises
    ------
    InvalidArgument
        If it is none, its points have another shape, or it jumps.
    """
    found: Any = required("path", path, Path)
    shape = np.shape(found(0.0))
    if shape != (size,):
        where = "the plane" if size == 2 else "space"
        raise InvalidArgument(f"path has points of shape {shape}, expected ({size},), a path in {where}")
    for before, after in pairwise(pieces_of(found)):
        ends = before.derivative(before.end, 0), after.derivative(after.start, 0)
        if jumps(*ends, _JUMP):
            here, there = map(told, ends)
            raise InvalidArgument(
                f"path jumps from {here} m to {there} m at t = {after.start:g} s, expected pieces that meet"
            )
    return found  # type: ignore[no-any-return]


_JUMP = 1e-6  # [m], and of the coordinates: more than the rounding of any curve


def jumps(one: Array, other: Array, slack: float) -> bool:
    """Return whether points differ by more than `slack` [m], relative to those beyond 1 m."""
    return not bool((np.abs(other - one) <= slack * (1 + np.abs(one).max(initial=0.0))).all())


def told(point: Array) -> str:
    """Return a point in words, without the rounding of what is zero."""
    return f"({', '.join(f'{each:.6g}' for each in np.round(point, 9) + 0.0)})"


def checked_order(order: ArrayLike) -> int:
    """Return the order of a derivative, at least 0.

    Raises
    ------
    InvalidArgument
        If it is no such whole number, or one that nobody needs.
    """
    return whole("order", order, least=0, most=_HIGHEST)


_HIGHEST = 1000  # order of a derivative: beyond, a figure's rates and their powers are no numbers


def within(name: str, t: ArrayLike, duration: float) -> Array:
    """Check that times are within [0, duration], and return them as float64.

    A few units of rounding beyond either end are allowed and cut off.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    t : array_like, any shape
        Times [s].
    duration : float
        The latest time allowed [s].

    Raises
    ------
    InvalidArgument
        If a time is not a finite number, or outside.
    """
    times = finite(name, t)
    inside = np.minimum(np.maximum(times, 0.0), duration)
    close = np.abs(times - inside) <= _ROUNDING * duration
    return bounded(name, np.where(close, inside, times), least=0, most=duration, unit="s")


def axes_of(path: Any) -> tuple[str, ...]:
    """Return labels of the coordinates of a path whose first field holds points: x and y, else numbers."""
    size = np.shape(getattr(path, attrs.fields(type(path))[0].name))[-1]
    return ("x", "y") if size == 2 else tuple(map(str, range(size)))


def check_sizes(path: Any, *names: str) -> None:
    """Refuse points or velocities of another number of coordinates than the first field; None is allowed.

    Raises
    ------
    InvalidArgument
        If there are such.
    """
    expected = (len(axes_of(path)),)
    for name in names:
        value = getattr(path, name)
        if value is not None:
            shaped(name, value, expected)


class Value:
    """Abstract base of parts that compare, hash and show by their fields, arrays as tuples."""

    def _values(self) -> dict[str, object]:
        named = {name: value for name, _, value in fields_of(self)}
        return {name: _plain(v.tolist()) if isinstance(v, np.ndarray) else v for name, v in named.items()}

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self._values() == other._values()

    def __hash__(self) -> int:
        return hash((type(self), *self._values().values()))

    def __repr__(self) -> str:
        inside = ", ".join(f"{name}={value!r}" for name, value in self._values().items())
        return f"{type(self).__name__}({inside})"


class Curve(Value):
    """Abstract base of the library's paths: parts that say what they are at checked times.

    Equality, hash and repr are from their fields.
    """

    if TYPE_CHECKING:  # of a part it may be a field

        @property
        def duration(self) -> float:
            """Time from start to end [s]."""

    def _at(self, t: Array, order: int) -> Array:
        """Return the derivative at times on the path."""
        raise NotImplementedError

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
        return self._at(within("t", t, self.duration), checked_order(order))

    def moved(self, x: float = 0.0, y: float = 0.0, angle: float = 0.0) -> TransformedPath:
        """Return the path turned about the origin by `angle` [rad], then shifted by (`x`, `y`) [m].

        Raises
        ------
        InvalidArgument
            If a number is not finite, or its points are neither in the plane nor in space.
        """
        return TransformedPath(self, x, y, angle)


def _plain(value: object) -> object:
    return tuple(map(_plain, value)) if isinstance(value, list) else value


def turned(vectors: Array, angle: float) -> Array:
    """Return vectors turned about the z axis by an angle [rad], shape (..., n) with n >= 2."""
    found = np.array(vectors, np.float64)
    c, s, x, y = np.cos(angle), np.sin(angle), vectors[..., 0], vectors[..., 1]
    found[..., 0], found[..., 1] = c * x - s * y, s * x + c * y
    return found


@final
@part
class TransformedPath(Curve):
    """A path elsewhere: turned about the origin, then shifted. In space, about the z axis and level."""

    path: Any = child(Path, doc="any path in the plane or in space")
    x: float = number(default=0.0, unit="m", doc="shift of the path along x")
    y: float = number(default=0.0, unit="m", doc="shift of the path along y")
    angle: float = number(default=0.0, unit="rad", doc="angle that the path is turned by")

    def check(self) -> None:
        """Raise `InvalidArgument` where points are neither in the plane nor in space."""
        shape = np.shape(self.path(0.0))
        if shape not in ((2,), (3,)):
            raise InvalidArgument(f"path has points of shape {shape}, expected (2,) or (3,)")

    @property
    def duration(self) -> float:
        """The path's duration [s]."""
        return float(self.path.duration)

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Those of the path, moved."""
        return tuple(_MovedPiece(self, piece) for piece in pieces_of(self.path))

    def _at(self, t: Array, order: int) -> Array:
        return self._placed(self.path.derivative(t, order), order)

    def _placed(self, vectors: Array, order: int) -> Array:
        found = turned(vectors, self.angle) if self.angle else np.array(vectors, np.float64)
        if not order:
            found[..., :2] += self.x, self.y
        return found


@dataclass(frozen=True)
class _MovedPiece:
    """A piece of a path, moved."""

    whole: TransformedPath
    piece: Piece

    @property
    def start(self) -> float:
        return self.piece.start

    @property
    def end(self) -> float:
        return self.piece.end

    def derivative(self, t: ArrayLike, order: int) -> Array:
        return self.whole._placed(self.piece.derivative(t, order), order)


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
    return bounded(name, positive(name, value, "s"), least=_SHORTEST, most=_FARTHEST, unit="s")


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
