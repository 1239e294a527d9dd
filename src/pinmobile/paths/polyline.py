"""Polylines with rounded corners that a rigid body can follow, and paths one after another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import accumulate, pairwise
from math import comb
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, frozen, positive, sequence, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.parts import array, children, number, part
from pinmobile.paths.path import (
    Curve,
    MovedPiece,
    Path,
    Piece,
    Polynomial,
    axes_of,
    format_point,
    jumps,
    pieces_of,
)

_JOINT_TOLERANCE = 1e-9  # [m, m/s], and relative to their size: tolerance for rounding errors


@final
@part
class CompositePath(Curve):
    """Paths one after another: each starts at the end of the one before, with its velocity.

    The acceleration may jump, as at the via point of a `CubicVia`: where a line meets a circle, so does the
    yaw rate of `Tangent`. The method ``moved`` of a path places it at the end of another.

    Parameters
    ----------
    paths : sequence of Path
        Paths with equal numbers of coordinates.

    Raises
    ------
    InvalidArgument
        If there are no paths, sizes differ, or position or velocity jumps between two paths.

    See Also
    --------
    paths.TransformedPath : path at another place
    Polyline : lines with rounded corners

    Examples
    --------
    >>> from pinmobile import Circle, CompositePath, Line
    >>> line = Line([0, 0], [1, 0], duration=2.0)
    >>> turn = Circle(radius=1.0, rate=0.5, duration=3.0)
    >>> path = CompositePath([line, turn.moved(x=1.0)])
    >>> path.duration, path(2.0)  # [s], [m]
    (5.0, array([1., 0.]))
    """

    paths: Any = children(Path, doc="paths with equal numbers of coordinates")

    def check(self) -> None:
        """Raise `InvalidArgument` if position or velocity jumps between two paths."""
        shapes = [np.shape(path(0.0)) for path in sequence("paths", self.paths, "one path or more", 1)]
        for k, shape in enumerate(shapes):
            if len(shape) != 1 or shape != shapes[0]:
                expected = shapes[0] if len(shapes[0]) == 1 else "(n,)"
                raise InvalidArgument(f"paths[{k}] has points of shape {shape}, expected {expected}")
        for k, (before, next_path) in enumerate(pairwise(self.paths)):
            _check_joint(k, before, next_path, self._starts[k + 1])

    @cached_property
    def _starts(self) -> Array:
        """Start times of the paths, and the end [s]."""
        lengths = (positive(f"paths[{k}].duration", p.duration, "s") for k, p in enumerate(self.paths))
        return frozen([0.0, *accumulate(lengths)])

    @property
    def duration(self) -> float:
        """Sum of the durations of the paths [s]."""
        return float(self._starts[-1])

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Pieces of all paths, in order."""
        pairs = zip(self._starts.tolist(), self.paths, strict=False)
        return tuple(_later(start, piece) for start, path in pairs for piece in pieces_of(path))

    def _at(self, t: Array, order: int) -> Array:
        indices = np.searchsorted(self._starts[1:-1], t, side="right")
        values = np.empty((*t.shape, np.size(self.paths[0](0.0))))
        for k in np.unique(indices):
            mask, path = indices == k, self.paths[k]
            times = np.minimum(t[mask] - self._starts[k], path.duration)
            values[mask] = path.derivative(times, order)
        return values


def _later(offset: float, piece: Piece) -> Piece:
    """Return a piece of a path that starts later [s]."""

    def derivative(t: ArrayLike, order: int) -> Array:
        times = np.asarray(t, np.float64) - offset
        return piece.derivative(np.clip(times, piece.start, piece.end), order)

    return MovedPiece(offset + float(piece.start), offset + float(piece.end), derivative)


def _check_joint(k: int, path: Path, next_path: Path, t: float) -> None:
    """Check that a path starts where path number `k` ends at `t` [s], with its velocity."""
    last, first = pieces_of(path)[-1], pieces_of(next_path)[0]
    ends = [(last.derivative(last.end, order), first.derivative(first.start, order)) for order in (0, 1)]
    (end, start), (left, right) = ends
    if jumps(end, start, _JOINT_TOLERANCE):
        raise InvalidArgument(
            f"paths[{k + 1}] starts at {format_point(start)} m, {_format_size(start - end)} m from "
            f"{format_point(end)} m, where paths[{k}] ends at t = {t:g} s, expected one point; use "
            f"paths[{k + 1}].moved(x, y, angle)"
        )
    if jumps(left, right, _JOINT_TOLERANCE):
        raise InvalidArgument(
            f"paths[{k + 1}] starts with the velocity {format_point(right)} m/s, "
            f"{_format_size(right - left)} m/s from {format_point(left)} m/s, with which paths[{k}] ends at "
            f"t = {t:g} s, expected one velocity: round the corner with a Polyline, or use paths that rest "
            "there"
        )


def _format_size(vector: Array) -> str:
    """Return the length of a vector as text."""
    return f"{np.linalg.norm(vector):.3g}"


# h(s) = 10 s^3 - 15 s^4 + 6 s^5: completed fraction of a turn or speed change at the fraction s of its time.
_SMOOTH = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
_MAX_SLOPE = 15 / 8  # largest slope of h, at s = 1/2
_ANGLE_TOLERANCE = 1e-9  # [rad]: a smaller corner counts as a rounding error
_MAX_ANGLE = 3.1  # [rad]: a larger corner would cut more than eighty radii off its lines
_ROUNDING = 1e-12  # relative to a length
_MIN_LENGTH = 1e-150  # [m]: its square does not underflow
_NODES = 40  # of the quadrature: enough for rounding accuracy at the largest corner


class _Corner(NamedTuple):
    """Rounding of a corner.

    Attributes
    ----------
    angle : float
        Change of direction [rad].
    cut : float
        Distance of the turn's start and end from the waypoint [m].
    length : float
        Length of the turn [m].
    axes : ndarray, shape (2, n)
        Unit vectors along the direction before the corner, and toward its inner side.
    """

    angle: float
    cut: float
    length: float
    axes: Array


_NONE = _Corner(0.0, 0.0, 0.0, np.zeros((2, 0)))


class _PolylinePath(NamedTuple):
    """Polyline with rounded corners, independent of the speed.

    Attributes
    ----------
    points : ndarray, shape (k, n)
        Waypoints [m].
    directions, lengths : ndarray, shape (k - 1, n), (k - 1,)
        Unit vectors and lengths of the lines between waypoints; the lengths [m].
    corners : tuple of _Corner, length k
        Corner at each waypoint; the first and the last are straight.
    """

    points: Array
    directions: Array
    lengths: Array
    corners: tuple[_Corner, ...]

    @property
    def cuts(self) -> Array:
        """Length that each corner cuts off the lines on both sides, shape (k,) [m]."""
        return np.array([corner.cut for corner in self.corners])

    @property
    def length(self) -> float:
        """Length of the path with rounded corners [m]."""
        return float(self.lengths.sum() - 2 * self.cuts.sum() + sum(each.length for each in self.corners))


@final
@part
class Polyline(Curve):
    """Straight lines between waypoints at constant speed, with rounded corners.

    In a corner the direction turns by theta h(s), with h(s) = 10 s^3 - 15 s^4 + 6 s^5 and s from 0 to 1. The
    speed stays constant, and direction, turn rate and angular acceleration are continuous, in contrast to
    lines joined by circular arcs. The curvature is at most 1 / `corner_radius`, in the middle of the corner,
    and the acceleration at most speed^2 / `corner_radius`. A corner cuts equal lengths off both of its lines.

    With an `acceleration`, the path starts and ends at rest and accelerates by at most this value. Without
    it, the speed is constant from start to end.

    Parameters
    ----------
    waypoints : array_like, shape (k, n)
        Waypoints, k >= 2, n >= 2 [m].
    corner_radius : float
        Smallest radius of curvature in the corners, > 0 [m].
    duration : float
        Duration of the path, > 0 [s].
    acceleration : float, optional
        Largest acceleration at the ends, > 0 [m/s^2].

    Raises
    ------
    InvalidArgument
        If two waypoints coincide, a corner turns back, or corners and ends need more length or time; the
        message states how much.

    See Also
    --------
    Spline : smooth path through waypoints
    CompositePath : paths one after another

    Examples
    --------
    >>> from pinmobile import Polyline
    >>> path = Polyline([[0, 0], [4, 0], [4, 3]], corner_radius=0.5,
    ...                 duration=10.0)
    >>> print(f"{path.length:.2f} m at {path.speed:.3f} m/s")
    6.74 m at 0.674 m/s
    """

    waypoints: Any = array(shapes=(("k", "n"),), unit="m", labels=axes_of, doc="waypoints of the path")
    corner_radius: float = number(above=0, unit="m", doc="smallest radius of curvature in the corners")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")
    acceleration: float | None = number(
        default=None, above=0, unit="m/s^2", doc="largest acceleration at the ends"
    )

    def check(self) -> None:
        """Raise `InvalidArgument` if length or time is too short; the message states how much is needed."""
        shaped("waypoints", self.waypoints, ("k>=2", "n>=2"))
        self.pieces  # noqa: B018

    @cached_property
    def _line_path(self) -> _PolylinePath:
        return self._round_corners(self.waypoints)

    @property
    def length(self) -> float:
        """Length of the path with rounded corners [m]."""
        return self._line_path.length

    @cached_property
    def speed(self) -> float:
        """Speed between the ends [m/s]."""
        return self._speed()

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """Lines, and the corners between them."""
        *others, last = self._make_pieces(self._line_path)
        return (*others, replace(last, end=self.duration))

    @cached_property
    def _starts(self) -> Array:
        return frozen([piece.start for piece in self.pieces])

    def _at(self, t: Array, order: int) -> Array:
        indices = np.searchsorted(self._starts[1:], t, side="right")
        values = np.empty((*t.shape, self.waypoints.shape[1]))
        for k in np.unique(indices):
            mask = indices == k
            values[mask] = self.pieces[k].derivative(t[mask], order)
        return values

    def _round_corners(self, points: Array) -> _PolylinePath:
        """Return the lines between points, and the corners between them."""
        lines = np.diff(points, axis=0)
        lengths = np.linalg.norm(lines, axis=-1)
        for k in np.flatnonzero(lengths < _MIN_LENGTH)[:1]:
            raise InvalidArgument(f"waypoints[{k + 1}] is equal to waypoints[{k}], expected another point")
        directions = lines / lengths[:, None]
        turns = (self._make_corner(k, *directions[k - 1 : k + 1]) for k in range(1, len(lines)))
        path = _PolylinePath(points, directions, lengths, (_NONE, *turns, _NONE))
        self._check_lengths(path.cuts, lengths, "the corners take")
        return path

    def _make_pieces(self, path: _PolylinePath) -> Iterator[Polynomial | _Turn]:
        """Yield the pieces in order: lines, and the corners between them."""
        distances = np.zeros(len(path.points))  # distance of speeding up, and of slowing down [m]
        if self.acceleration is not None:
            distances[[0, -1]] = _MAX_SLOPE * self.speed**2 / self.acceleration / 2
        margins = path.cuts + distances
        self._check_lengths(margins, path.lengths, "the corners, starting and stopping take")
        t = 0.0
        for k, (direction, length) in enumerate(zip(path.directions, path.lengths, strict=True)):
            middle = length - margins[k] - margins[k + 1]
            for share, start, shares in (
                (2 * distances[k], path.points[k], _SPEEDING_UP),
                (middle * (middle > _ROUNDING * length), path.points[k] + margins[k] * direction, _CRUISING),
                (2 * distances[k + 1], path.points[k + 1] - distances[k + 1] * direction, _SLOWING_DOWN),
            ):
                if share:
                    yield self._make_line(t, share, start, direction, shares)
                    t += float(share / self.speed)
            if (corner := path.corners[k + 1]).length:
                T = corner.length / self.speed
                start = path.points[k + 1] - corner.cut * direction
                yield _Turn(t, t + T, start, self.speed * corner.axes, corner.angle)
                t += T

    def _speed(self) -> float:
        """Return the speed at which the path takes its duration [m/s]."""
        if self.acceleration is None:
            return self.length / self.duration
        # Speeding up and slowing down take twice as long as at full speed, together 15/8 speed / a more.
        shortest = 2 * np.sqrt(_MAX_SLOPE * self.length / self.acceleration)
        if not self.duration >= shortest:
            raise InvalidArgument(
                f"duration is {self.duration:g} s, expected at least {shortest:.6g} s for {self.length:.6g} "
                f"m with acceleration = {self.acceleration:g} m/s^2"
            )
        # This is the smaller root of 15/8 speed^2 / a - duration speed + length = 0, without cancellation.
        share = np.sqrt((1 - shortest / self.duration) * (1 + shortest / self.duration))
        return float(2 * self.length / self.duration / (1 + share))

    def _make_line(self, t: float, length: float, start: Array, direction: Array, terms: Array) -> Polynomial:
        """Return a straight piece from time `t` on, of the duration that its length takes at the speed."""
        T = float(length / self.speed)
        powers = (terms * T ** -np.arange(len(terms)))[:, None] * self.speed * direction
        return Polynomial(t, t + T, np.array([start, *powers]))

    def _make_corner(self, k: int, first: Array, second: Array) -> _Corner:
        """Return the rounding of the corner at a waypoint, from the directions on both sides."""
        normal = second - (second @ first) * first
        sine = float(np.linalg.norm(normal))
        angle = float(np.arctan2(sine, second @ first))
        if angle < _ANGLE_TOLERANCE:
            return _NONE
        if angle > _MAX_ANGLE:
            raise InvalidArgument(
                f"waypoints[{k}] has a turn of {np.degrees(angle):.4g} degrees, expected at most "
                f"{np.degrees(_MAX_ANGLE):.4g}: use two paths, and a rest between them"
            )
        length = _MAX_SLOPE * angle * self.corner_radius
        # Both halves of the turn are mirror images: its chord is parallel to its middle direction.
        nodes, weights = _quadrature()
        chord = length * float((weights * np.cos(angle * (_SMOOTH(nodes) - 0.5))).sum())
        axes = np.array([first, normal / sine])
        return _Corner(angle, chord / (2 * np.cos(angle / 2)), length, axes)

    def _check_lengths(self, margins: Array, lengths: Array, words: str) -> None:
        """Check that the lines are longer than the lengths that corners and ends need."""
        needed = margins[:-1] + margins[1:]
        for k in np.flatnonzero(needed > lengths * (1 + _ROUNDING))[:1]:
            raise InvalidArgument(
                f"waypoints[{k}] and waypoints[{k + 1}] are {lengths[k]:.6g} m apart, expected at least "
                f"{needed[k]:.6g} m, which {words}: use a corner_radius smaller than "
                f"{self.corner_radius:g} m"
            )


# Distance of a straight piece, as a fraction of speed times time, in powers of the fraction of its time, the
# first power first: the integral of h, of one, and of 1 - h.
_SPEEDING_UP = np.array([0.0, 0.0, 0.0, 2.5, -3.0, 1.0])
_CRUISING = np.array([1.0])
_SLOWING_DOWN = np.array([1.0, 0.0, 0.0, -2.5, 3.0, -1.0])


@dataclass(frozen=True, eq=False)
class _Turn:
    """Corner: its position is the integral of a velocity whose direction turns by theta h(s).

    Attributes
    ----------
    start, end : float
        Times of start and end [s].
    point : ndarray, shape (n,)
        Start [m].
    axes : ndarray, shape (2, n)
        Velocity at the start, and this velocity rotated by a quarter turn to the inner side [m/s].
    angle : float
        theta [rad].
    """

    start: float
    end: float
    point: Array
    axes: Array
    angle: float

    def __post_init__(self) -> None:
        for name in ("point", "axes"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def derivative(self, t: ArrayLike, order: int) -> Array:
        """Return the derivative, shape (..., n) [m/s^order], at `t`, shape (...) [s]."""
        T = np.float64(self.end - self.start)
        s = (np.asarray(t, np.float64) - self.start) / T
        if order:
            z = self._direction(s, order - 1) / T ** (order - 1)
        else:
            nodes, weights = _quadrature()
            z = T * s * (weights * self._direction(s[..., None] * nodes, 0)).sum(axis=-1)
        offset = z.real[..., None] * self.axes[0] + z.imag[..., None] * self.axes[1]
        return np.asarray(offset if order else self.point + offset)

    def _direction(self, s: Array, order: int) -> NDArray[np.complex128]:
        """Return a derivative by s of z = exp(i theta h(s)), with Leibniz' rule for z' = i theta h' z."""
        psi = self.angle * _SMOOTH(s)
        terms = [np.cos(psi) + 1j * np.sin(psi)]
        rates = [1j * self.angle * _SMOOTH.deriv(k + 1)(s) for k in range(min(order, _SMOOTH.degree()))]
        for m in range(order):
            terms.append(np.zeros_like(terms[0]))
            for k, rate in enumerate(rates[: m + 1]):
                terms[-1] += comb(m, k) * rate * terms[m - k]
        return terms[order]


@cache
def _quadrature() -> tuple[Array, Array]:
    """Return nodes in [0, 1] and weights of the Clenshaw-Curtis quadrature."""
    # Gauss nodes come from eigenvalues of a library, whose last bit depends on the machine.
    j, k = np.arange(_NODES + 1), np.arange(1, _NODES // 2 + 1)
    shares = np.where(k == _NODES // 2, 1.0, 2.0) / (4.0 * k**2 - 1)
    weights = (1 - (shares * np.cos(2 * np.pi * j[:, None] * k / _NODES)).sum(axis=-1)) / _NODES
    weights[[0, -1]] /= 2
    return frozen((1 - np.cos(np.pi * j / _NODES)) / 2), frozen(weights)
