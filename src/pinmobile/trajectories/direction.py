"""Direction of motion along a path, with its limits where the path rests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import factorial, inf
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.paths import Path, Piece, pieces_of

Field: TypeAlias = Callable[[Array], tuple[Array, Array, Array]]
"""Vectors and their first two derivatives, each of shape (m, 2), at times of shape (m,)."""

_MAX_CELLS = 2**22


def halve(field: Field, cells: Array, levels: int) -> tuple[Array, Array]:
    """Halve cells until the field stays within a cone of half-angle 30 deg in each of them.

    A cell of width h around t is done if |u(t)| > h (|u'(t)| + h/2 |u''(t)|). Then the field changes by at
    most half its length, except for the effect of the third derivative, for which a factor of two remains. No
    oscillation escapes: where the samples of u' vanish, those of u'' do not.

    Parameters
    ----------
    field : callable
        The field; see `Field`.
    cells : ndarray, shape (m, 2)
        Start and end of each cell [s].
    levels : int
        Largest number of halvings of a cell.

    Returns
    -------
    done, left : ndarray, shape (..., 2)
        Finished cells and unfinished cells, each in order of time [s].

    Raises
    ------
    InvalidArgument
        If there are too many cells.
    """
    done = [cells[:0]]
    for _ in range(levels):
        if not len(cells):
            break
        is_done = _is_within_cone(field, cells)
        done.append(cells[is_done])
        cells = cells[~is_done]
        middle = cells.mean(axis=-1)
        cells = np.concatenate([[cells[:, 0], middle], [middle, cells[:, 1]]], axis=-1).T
        if len(cells) > _MAX_CELLS:
            raise InvalidArgument(f"path turns more than {_MAX_CELLS} times between t = 0 and its end")
    finished = np.concatenate(done)
    return finished[np.argsort(finished[:, 0])], cells[np.argsort(cells[:, 0])]


def _is_within_cone(field: Field, cells: Array) -> NDArray[np.bool_]:
    """Return whether the field stays within the cone in each cell."""
    width = cells[:, 1] - cells[:, 0]
    u, du, ddu = (np.linalg.norm(vectors, axis=-1) for vectors in field(cells.mean(axis=-1)))
    return np.asarray(u > width * (du + width / 2 * ddu))


STANDSTILL = 1e-12
"""Fraction of a path's largest speed below which a speed is a rounding error (lecture model, section 7)."""

_SAMPLES = 64
_EPS = float(np.finfo(np.float64).eps)


def max_lengths(path: Path, order: int) -> Array:
    """Return the largest length of a derivative on each piece of a path, by samples.

    Parameters
    ----------
    path : Path
        A path of k pieces.
    order : int
        Order of the derivative.

    Returns
    -------
    lengths : ndarray, shape (k,)
        Values close to the suprema [m/s^order], always by the same samples.

    Raises
    ------
    InvalidArgument
        If a derivative is not finite.
    """
    # Steps of the golden ratio are never synchronous with an oscillation of the path, as equal steps may be.
    fractions = (np.arange(1, _SAMPLES + 1) * (np.sqrt(5.0) - 1) / 2) % 1.0
    ends = np.array([(piece.start, piece.end) for piece in pieces_of(path)])  # (k, 2)
    times = ends[:, :1] + fractions * np.diff(ends)
    lengths = np.linalg.norm(path.derivative(times, order), axis=-1)  # (k, samples)
    if not np.isfinite(lengths).all():
        first = times[~np.isfinite(lengths)][0]
        raise InvalidArgument(f"path has no finite derivative of order {order} at t = {first} s")
    return np.asarray(lengths.max(axis=-1))


class _Scales:
    """Sizes of a path's derivatives, and tolerances of their rounding errors, for each of its k pieces.

    Parameters
    ----------
    path : Path
        The path.

    Attributes
    ----------
    max_speed : float
        Largest speed on the path [m/s].
    is_constant : ndarray of bool, shape (k,)
        Whether the path stays in one place on a piece.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._ends = np.array([piece.end for piece in pieces_of(path)])
        self._largest: dict[int, Array] = {}
        speeds = max_lengths(path, 1)
        self.max_speed = float(speeds.max())
        self.is_constant = speeds <= STANDSTILL * self.max_speed

    def tolerance(self, order: int) -> Array:
        """Return the length below which a derivative is a rounding error, shape (k,) [m/s^order]."""
        # The second term is the effect of rounding errors of the time, by the next derivative.
        drift = 8 * _EPS * self._ends * self._scale(order + 1)
        return np.asarray(STANDSTILL * self._scale(order) + drift)

    def _scale(self, order: int) -> Array:
        if order not in self._largest:
            # A speed is compared with the path's, even on a slow piece; another derivative with its own.
            speeds = np.full_like(self._ends, self.max_speed)
            self._largest[order] = speeds if order == 1 else max_lengths(self._path, order)
        return self._largest[order]


_CELLS = 8
_LEVELS = 17  # an unfinished cell is a millionth of its piece
_MAX_ORDER = 6
_STEPS = 60
_SPEED_TOLERANCE = 1e-13  # well above rounding errors, and below the limit of a standstill


def _rest_order(piece: Piece, t: float, scales: _Scales, index: int) -> int:
    """Return the order at which the speed vanishes, as |t - t_rest|^order; 0 for a speed that does not.

    Parameters
    ----------
    piece : Piece
        An analytic piece that moves.
    t : float
        Time on the piece [s].
    scales : Scales
        Scales of the path.
    index : int
        Number of the piece in the path.

    Raises
    ------
    InvalidArgument
        If so many derivatives vanish that the direction is undefined.
    """
    for order in range(_MAX_ORDER + 1):
        if np.linalg.norm(piece.derivative(t, order + 1)) > scales.tolerance(order + 1)[index]:
            return order
    raise InvalidArgument(
        f"path has no direction at t = {t} s: its first {_MAX_ORDER + 1} derivatives vanish there"
    )


def _inner_rests(path: Path, scales: _Scales) -> list[list[float]]:
    """Return the times inside each piece at which the path rests [s], in order.

    Parameters
    ----------
    path : Path
        A path of two coordinates.
    scales : Scales
        Scales of the path.
    """
    pieces = pieces_of(path)
    moving = [piece for piece, constant in zip(pieces, scales.is_constant, strict=True) if not constant]
    edges = [np.linspace(piece.start, piece.end, _CELLS + 1) for piece in moving]
    cells = np.concatenate([np.stack([e[:-1], e[1:]], axis=-1) for e in edges])
    _, unfinished = halve(lambda t: _velocity(path, t, scales.max_speed), cells, _LEVELS)
    starts = np.array([piece.start for piece in pieces])
    owners = np.searchsorted(starts, unfinished.mean(axis=-1), side="right") - 1
    rests: list[list[float]] = [[] for _ in pieces]
    for first, last, owner in _clusters(unfinished, owners):
        rest = _refine_rest(pieces[owner], first, last, scales, owner)
        if rest is not None:
            rests[owner].append(rest)
    return rests


def _velocity(path: Path, t: Array, max_speed: float) -> tuple[Array, Array, Array]:
    """Return velocity and two derivatives at times, with rounding errors of the velocity set to zero."""
    v, a, jerk = (np.asarray(path.derivative(t, order)) for order in (1, 2, 3))
    # A rounding error has a direction, and would count as motion where the speed is flat around a rest.
    is_still = np.linalg.norm(v, axis=-1, keepdims=True) < _SPEED_TOLERANCE * max_speed
    return np.where(is_still, 0.0, v), a, jerk


def _clusters(cells: Array, owners: Array) -> list[tuple[float, float, int]]:
    """Return start, end and piece of each run of adjacent cells."""
    if not len(cells):
        return []
    is_break = (cells[1:, 0] > cells[:-1, 1]) | (owners[1:] != owners[:-1])
    breaks = [0, *(np.flatnonzero(is_break) + 1).tolist(), len(cells)]
    return [(float(cells[i, 0]), float(cells[j - 1, 1]), int(owners[i])) for i, j in pairwise(breaks)]


def _refine_rest(piece: Piece, first: float, last: float, scales: _Scales, index: int) -> float | None:
    # A rest at an end of the piece is known already.
    """Return the time of a rest between two times [s]; None if there is none inside the piece."""
    for end in (piece.start, piece.end):
        if first <= end <= last and _rest_order(piece, end, scales, index):
            return None
    # At a rest of order k the speed is too flat to locate the rest; the k-th derivative is not.
    for order in range(_MAX_ORDER, 0, -1):
        t = _find_zero(piece, order, first, last)
        if t is not None and _rest_order(piece, t, scales, index) >= order:
            return t
    return None


def _find_zero(piece: Piece, order: int, first: float, last: float) -> float | None:
    # Gauss-Newton for derivative(t, order) = 0, two equations in one unknown.
    """Return a zero of a derivative between two times [s]; None without convergence."""
    t, width = (first + last) / 2, last - first
    for _ in range(_STEPS):
        value, slope = piece.derivative(t, order), piece.derivative(t, order + 1)
        square = float(slope @ slope)
        if not square:
            return None
        step = float(value @ slope) / square
        t -= step
        if not max(piece.start, first - width) < t < min(piece.end, last + width):
            return None
        if abs(step) <= np.spacing(t):
            break
    return t


_TERMS = 13
_TRUNCATION = 1e-17


@dataclass(frozen=True, eq=False)
class DirectionLimit:
    """Direction of motion at one end of a leg, and near it if the path rests there.

    Parameters
    ----------
    time : float
        Time of the end [s].
    series : ndarray, shape (m, 2)
        Taylor coefficients of u(t) in powers of t - time; u is a positive multiple of the velocity.
    window : float
        Distance up to which the series replaces u [s]; negative if the path moves, where the velocity is
        used.
    speed : float
        Speed in this limit [m/s]; 0 if the path rests.
    """

    time: float
    series: Array
    window: float
    speed: float


@dataclass(frozen=True, eq=False)
class Leg:
    """Part of a path between knots and rests."""

    start: DirectionLimit
    end: DirectionLimit


class Hodograph:
    """Direction of motion along a path, a vector u(t) that is never zero and has the velocity's direction.

    The velocity v is a hodograph except where the path rests. There v = tau^k w(tau) with w(0) not zero and
    the time tau since the rest. The Taylor series of u = w replaces the velocity (its opposite before a rest
    of odd k, where the velocity points backwards).

    Parameters
    ----------
    path : Path
        The path.
    legs : sequence of Leg, length L
        Legs of the path, in order.
    max_speed : float
        Largest speed on the path [m/s].
    """

    def __init__(self, path: Path, legs: list[Leg], max_speed: float) -> None:
        self.path = path
        self.legs = tuple(legs)
        self.max_speed = max_speed
        self._starts = np.array([leg.start.time for leg in legs])
        self._limits = [limit for leg in legs for limit in (leg.start, leg.end)]
        self._times = np.array([limit.time for limit in self._limits])
        self._windows = np.array([limit.window for limit in self._limits])
        series = np.zeros((len(self._limits), _TERMS, 2))
        for row, limit in zip(series, self._limits, strict=True):
            row[: len(limit.series)] = limit.series
        terms = np.flatnonzero(series.any(axis=(0, 2)))[-1] + 1
        self._series = series[:, :terms]

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Return u and its first two derivatives, each of shape (..., 2), at `t`, shape (...) [s]."""
        return self.from_derivatives(t, *(self.path.derivative(t, order) for order in (1, 2, 3)))

    def from_derivatives(self, t: Array, v: Array, a: Array, jerk: Array) -> tuple[Array, Array, Array]:
        """Return the same as a call, from given velocity, acceleration and jerk."""
        head = 2 * (np.searchsorted(self._starts, t, side="right") - 1)
        is_late = self._times[head + 1] - t < self._windows[head + 1]
        limit = head + is_late
        is_near = is_late | (t - self._times[head] < self._windows[head])
        if not is_near.any():
            return v, a, jerk
        u = np.stack([v, a, jerk])
        u[:, is_near] = self._evaluate_series(limit[is_near], t[is_near])
        return u[0], u[1], u[2]

    def _evaluate_series(self, limit: Array, t: Array) -> Array:
        tau = (t - self._times[limit])[..., None]
        series = self._series[limit]  # (..., terms, 2)
        u, du, half = np.zeros((3, *t.shape, 2))
        for k in range(series.shape[-2] - 1, -1, -1):
            half = half * tau + du
            du = du * tau + u
            u = u * tau + series[..., k, :]
        return np.stack([u, du, 2 * half])


def heading(u: Array, du: Array, ddu: Array) -> tuple[Array, Array, Array]:
    """Return the heading in [-pi, pi] and its first two derivatives, each of shape (...).

    psi = atan2(u_y, u_x), psi_dot = u x u' / u.u, psi_ddot = u x u'' / u.u - 2 psi_dot u.u' / u.u.

    Parameters
    ----------
    u, du, ddu : ndarray, shape (..., 2)
        Vector along the direction of motion and its first two time derivatives.
    """
    (x, dx, ddx), (y, dy, ddy) = np.moveaxis(np.stack([u, du, ddu]), -1, 0)
    square = x * x + y * y
    rate = (x * dy - y * dx) / square
    acceleration = (x * ddy - y * ddx - 2 * rate * (x * dx + y * dy)) / square
    return np.arctan2(y, x), rate, acceleration


def hodograph(path: Path) -> Hodograph:
    """Return the hodograph of a path of two coordinates.

    Raises
    ------
    InvalidArgument
        If the path never moves, or so many derivatives vanish at a rest that its direction is undefined.
    """
    scales = _Scales(path)
    if not scales.max_speed:
        raise InvalidArgument(
            "path never moves, so it has no tangent; expected a path that moves, or FixedHeading"
        )
    rests = _inner_rests(path, scales)
    legs: list[Leg | None] = []
    spans: list[tuple[float, float]] = []
    for index, piece in enumerate(pieces_of(path)):
        times = [float(piece.start), *rests[index], float(piece.end)]
        for start, end in pairwise(times):
            spans.append((start, end))
            legs.append(None if scales.is_constant[index] else _leg(piece, start, end, scales, index))
    return Hodograph(path, _fill_legs(legs, spans), scales.max_speed)


def _leg(piece: Piece, start: float, end: float, scales: _Scales, index: int) -> Leg:
    """Return a leg of a piece between two times [s]."""
    half = (end - start) / 2
    return Leg(*(_limit(piece, t, side, half, scales, index) for t, side in ((start, 1), (end, -1))))


def _limit(piece: Piece, t: float, side: int, width: float, scales: _Scales, index: int) -> DirectionLimit:
    """Return the direction at one end of a leg."""
    k = _rest_order(piece, t, scales, index)
    if not k:
        v, a, jerk = (piece.derivative(t, order) for order in (1, 2, 3))
        return DirectionLimit(t, np.array([v, a, jerk / 2]), -1.0, float(np.linalg.norm(v)))
    orders = range(k, k + _TERMS)
    series = np.array([piece.derivative(t, m + 1) / factorial(m) for m in orders]) * side**k
    series = series / np.linalg.norm(series[0])
    return DirectionLimit(t, series, min(width, _series_range(series)), 0.0)


def _series_range(series: Array) -> float:
    # The last terms estimate the truncation error; three of them, because a series may be odd or even.
    """Return the distance up to which a truncated series is accurate [s]."""
    powers = np.arange(len(series))[-3:]
    sizes = np.linalg.norm(series[-3:], axis=-1)
    ranges = (float((_TRUNCATION / size) ** (1 / k)) for size, k in zip(sizes, powers, strict=True) if size)
    return min(ranges, default=inf)


def _fill_legs(legs: list[Leg | None], spans: list[tuple[float, float]]) -> list[Leg]:
    # Where the path stays in one place, the heading is the one before, or at the start the next one.
    """Return the legs, with constant directions where the path stays in one place."""
    series = next(leg for leg in legs if leg is not None).start.series[:1]
    result: list[Leg] = []
    for leg, (start, end) in zip(legs, spans, strict=True):
        full_leg = leg or Leg(DirectionLimit(start, series, inf, 0.0), DirectionLimit(end, series, -1.0, 0.0))
        series = full_leg.end.series[:1]
        result.append(full_leg)
    return result
