"""What a path is; paths made of polynomials end to end, and their parameters."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import perm
from typing import Protocol, runtime_checkable

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, positive, representable, whole
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Parameter

# Relative to the duration: room for the rounding of `n * dt`, and for no more.
_ROUNDING = 4 * float(np.finfo(np.float64).eps)


@runtime_checkable
class Path(Protocol):
    """A curve r(t) of n coordinates, 0 <= t <= duration; a user's own class is as good as the library's.

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
    """Return a path whose points have 2 or 3 coordinates.

    Raises
    ------
    InvalidArgument
        If it is none, or its points have another shape.
    """
    if not isinstance(path, Path):
        raise InvalidArgument(
            f"path is {shown(path)}, expected a path: path(t), path.derivative(t, order), path.duration"
        )
    shape = np.shape(path(0.0))
    if shape != (size,):
        where = "the plane" if size == 2 else "space"
        raise InvalidArgument(f"path has points of shape {shape}, expected ({size},), a path in {where}")
    return path


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
    slack = _ROUNDING * duration
    outside = (times < -slack) | (times > duration + slack)
    if outside.any():
        where = tuple(int(i) for i in np.argwhere(outside)[0])
        place = f"[{', '.join(map(str, where))}]" if where else ""
        raise InvalidArgument(f"{name}{place} is {times[where]} s, expected 0 <= {name} <= {duration} s")
    return np.asarray(np.minimum(np.maximum(times, 0.0), duration))


def of_point(
    name: str, attribute: str, meaning: str, size: int = 2, *, unit: str = "m", row: int | None = None
) -> tuple[Parameter, ...]:
    """Return the parameters of a point or velocity that a path has: x and y, or numbers of joints.

    Parameters
    ----------
    name : str
        What they begin with, such as ``"via"``: ``"via_x"``.
    attribute : str
        The path's attribute.
    meaning : str
        What it is, in words.
    size : int
        Number of coordinates.
    unit : str
        Of each in the plane; of joints, that is as the joint is.
    row : int, optional
        Which of several points that the attribute holds.
    """
    coordinates = ("x", "y") if size == 2 else tuple(map(str, range(size)))
    return tuple(
        Parameter(
            f"{name}_{each}",
            unit if size == 2 else "",
            f"{meaning}, {each if size == 2 else f'coordinate {each}'}",
            attribute=attribute,
            entry=k if row is None else (row, k),
        )
        for k, each in enumerate(coordinates)
    )


class Value:
    """Abstract base of the frozen dataclasses of this package: equality, hash and repr from their fields.

    What a dataclass generates itself compares arrays as if they were numbers, which raises.
    """

    def _values(self) -> dict[str, object]:
        named = {f.name: getattr(self, f.name) for f in fields(self) if f.init}  # type: ignore[arg-type]
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


def _plain(value: object) -> object:
    return tuple(map(_plain, value)) if isinstance(value, list) else value


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
