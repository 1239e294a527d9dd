"""Polylines with rounded corners that a body with inertia can follow, and paths one after another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import accumulate, pairwise
from math import comb
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, frozen, positive, representable, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.parts import array, children, number, part
from pinmobile.paths.path import Curve, Path, Piece, Polynomial, axes_of, jumps, pieces_of, stretch, told

_SLACK = 1e-9  # [m, m/s], and of their size: the rounding of numbers that were computed


@final
@part
class CompositePath(Curve):
    """One path after another, each starting where the one before it ends, at the velocity that that has.

    The acceleration may jump, as at the via point of a `CubicVia`. `path.moved` puts one where another ends.
    """

    paths: Any = children(Path, doc="paths of as many coordinates each")

    def check(self) -> None:
        """Raise `InvalidArgument` where a path does not go on where and as the one before it ends."""
        if not self.paths:
            raise InvalidArgument("paths is empty, expected at least one path")
        shapes = [np.shape(path(0.0)) for path in self.paths]
        for k, shape in enumerate(shapes):
            if len(shape) != 1 or shape != shapes[0]:
                expected = shapes[0] if len(shapes[0]) == 1 else "(n,)"
                raise InvalidArgument(f"paths[{k}] has points of shape {shape}, expected {expected}")
        for k, (before, after) in enumerate(pairwise(self.paths)):
            _check_joint(k, before, after, self._starts[k + 1])

    @cached_property
    def _starts(self) -> Array:
        """Times at which the paths start, and the end [s]."""
        lengths = (positive(f"paths[{k}].duration", p.duration, "s") for k, p in enumerate(self.paths))
        return frozen([0.0, *accumulate(lengths)])

    @property
    def duration(self) -> float:
        """The sum of the paths' durations [s]."""
        return float(self._starts[-1])

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Those of each path, one after another."""
        each = zip(self._starts.tolist(), self.paths, strict=False)
        return tuple(_Later(start, piece) for start, path in each for piece in pieces_of(path))

    def _at(self, t: Array, order: int) -> Array:
        which = np.searchsorted(self._starts[1:-1], t, side="right")
        found = np.empty((*t.shape, np.size(self.paths[0](0.0))))
        for k in np.unique(which):
            mine, path = which == k, self.paths[k]
            own = np.minimum(t[mine] - self._starts[k], path.duration)
            found[mine] = path.derivative(own, order)
        return found


class _Later(NamedTuple):
    """A piece of a path that starts later.

    Attributes
    ----------
    since : float
        When the path starts [s].
    piece : Piece
        The piece, on the path's own clock.
    """

    since: float
    piece: Piece

    @property
    def start(self) -> float:
        return self.since + float(self.piece.start)

    @property
    def end(self) -> float:
        return self.since + float(self.piece.end)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        own = np.asarray(t, np.float64) - self.since
        return self.piece.derivative(np.clip(own, self.piece.start, self.piece.end), order)


def _check_joint(k: int, before: Path, after: Path, t: float) -> None:
    """Refuse a path that does not start where and as the one before it, number `k`, ends at `t` [s]."""
    last, first = pieces_of(before)[-1], pieces_of(after)[0]
    ends = [(last.derivative(last.end, order), first.derivative(first.start, order)) for order in (0, 1)]
    (here, there), (left, right) = ends
    if jumps(here, there, _SLACK):
        raise InvalidArgument(
            f"paths[{k + 1}] starts at {told(there)} m, {_size(there - here)} m from {told(here)} m, where "
            f"paths[{k}] ends at t = {t:g} s, expected one point; paths[{k + 1}].moved(x, y, angle) puts it "
            "elsewhere"
        )
    if jumps(left, right, _SLACK):
        raise InvalidArgument(
            f"paths[{k + 1}] starts with the velocity {told(right)} m/s, {_size(right - left)} m/s from "
            f"{told(left)} m/s, with which paths[{k}] ends at t = {t:g} s, expected one velocity: round the "
            "corner by a Polyline, or let both rest there"
        )


def _size(vector: Array) -> str:
    return f"{np.linalg.norm(vector):.3g}"


# h(s) = 10 s^3 - 15 s^4 + 6 s^5: what of a turn or of a change of speed is made at the share s of its time.
_SMOOTH = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
_STEEPEST = 15 / 8  # of h, at s = 1/2
_STRAIGHT = 1e-9  # [rad]: a smaller corner is rounding
_BACK = 3.1  # [rad]: a larger corner would cut more than eighty radii off its ways
_ROUNDING = 1e-12  # of a length
_SHORTEST = 1e-150  # [m], whose square is a number
_NODES = 40  # of the quadrature, by which the largest corner is right to rounding


class _Corner(NamedTuple):
    """How a corner is rounded.

    Attributes
    ----------
    angle : float
        That the direction turns by [rad].
    cut : float
        How far from the waypoint the turn starts and ends [m].
    length : float
        Of the turn [m].
    axes : ndarray, shape (2, n)
        Directions before it, and to the side that it turns to; of length one.
    """

    angle: float
    cut: float
    length: float
    axes: Array


_NONE = _Corner(0.0, 0.0, 0.0, np.zeros((2, 0)))


class _Way(NamedTuple):
    """A polyline with rounded corners, whatever the speed.

    Attributes
    ----------
    points : ndarray, shape (k, n)
        The waypoints [m].
    directions, lengths : ndarray, shape (k - 1, n), (k - 1,)
        Of the straight ways between them; the lengths [m].
    corners : tuple of _Corner, length k
        At each waypoint; the first and the last are none.
    """

    points: Array
    directions: Array
    lengths: Array
    corners: tuple[_Corner, ...]

    @property
    def cuts(self) -> Array:
        """What corners cut off the ways on both sides, shape (k,) [m]."""
        return np.array([corner.cut for corner in self.corners])

    @property
    def length(self) -> float:
        """Of the way, corners rounded [m]."""
        return float(self.lengths.sum() - 2 * self.cuts.sum() + sum(each.length for each in self.corners))


@final
@part
class Polyline(Curve):
    """Straight ways from point to point at one speed, with rounded corners.

    In a corner the direction turns by theta h(s), with h(s) = 10 s^3 - 15 s^4 + 6 s^5 and s from 0 to 1: the
    speed stays, and direction, turn rate and angular acceleration are continuous, which on straight ways and
    circular arcs they are not. The curvature is 1 / `corner_radius` at most, in the middle of the corner,
    and the acceleration speed^2 / `corner_radius`. A corner cuts as much off both of its ways.

    With an `acceleration` it starts from rest and comes to rest with at most that; without, it moves at its
    speed from the start to the end.
    """

    waypoints: Any = array(shapes=(("k", "n"),), unit="m", labels=axes_of, doc="waypoints of the path")
    corner_radius: float = number(above=0, unit="m", doc="least radius of the corners")
    duration: float = number(above=0, unit="s", fixed=True, doc="duration of the path")
    acceleration: float | None = number(
        default=None, above=0, unit="m/s^2", doc="largest acceleration at the ends"
    )

    def check(self) -> None:
        """Raise `InvalidArgument` where there is too little room or time; the message tells how much."""
        shaped("waypoints", self.waypoints, ("k>=2", "n>=2"))
        stretch("duration", self.duration)
        self.pieces  # noqa: B018

    @cached_property
    def _way(self) -> _Way:
        return self._rounded(self.waypoints)

    @property
    def length(self) -> float:
        """Length of the path, corners rounded [m]."""
        return self._way.length

    @cached_property
    def speed(self) -> float:
        """Speed between its ends [m/s]."""
        return self._speed()

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """Straight ways, and the corners between them."""
        *others, last = self._made(self._way)
        return (*others, replace(last, end=self.duration))

    @cached_property
    def _starts(self) -> Array:
        return frozen([piece.start for piece in self.pieces])

    def _at(self, t: Array, order: int) -> Array:
        which = np.searchsorted(self._starts[1:], t, side="right")
        found = np.empty((*t.shape, self.waypoints.shape[1]))
        for k in np.unique(which):
            mine = which == k
            found[mine] = self.pieces[k].derivative(t[mine], order)
        return found

    def _rounded(self, points: Array) -> _Way:
        """Return the straight ways between points, and the corners between these."""
        ways = np.diff(points, axis=0)
        lengths = representable("the distance of two waypoints", np.linalg.norm(ways, axis=-1))
        for k in np.flatnonzero(lengths < _SHORTEST)[:1]:
            raise InvalidArgument(f"waypoints[{k + 1}] is waypoints[{k}], expected another point")
        directions = ways / lengths[:, None]
        turns = (self._corner(k, *directions[k - 1 : k + 1]) for k in range(1, len(ways)))
        way = _Way(points, directions, lengths, (_NONE, *turns, _NONE))
        self._check_room(way.cuts, lengths, "the corners take")
        return way

    def _made(self, way: _Way) -> Iterator[Polynomial | _Turn]:
        """Yield the pieces in order: straight ways, and the corners between them."""
        gain = np.zeros(len(way.points))  # on which it gains its speed, and loses it [m]
        if self.acceleration is not None:
            gain[[0, -1]] = _STEEPEST * self.speed**2 / self.acceleration / 2
        apart = way.cuts + gain
        self._check_room(apart, way.lengths, "the corners, starting and stopping take")
        t = 0.0
        for k, (direction, length) in enumerate(zip(way.directions, way.lengths, strict=True)):
            rest = length - apart[k] - apart[k + 1]
            for share, start, shares in (
                (2 * gain[k], way.points[k], _GAINED),
                (rest * (rest > _ROUNDING * length), way.points[k] + apart[k] * direction, _KEPT),
                (2 * gain[k + 1], way.points[k + 1] - gain[k + 1] * direction, _LOST),
            ):
                if share:
                    yield self._straight(t, share, start, direction, shares)
                    t += float(share / self.speed)
            if (corner := way.corners[k + 1]).length:
                T = stretch("the time of a corner", corner.length / self.speed)
                start = way.points[k + 1] - corner.cut * direction
                yield _Turn(t, t + T, start, self.speed * corner.axes, corner.angle)
                t += T

    def _speed(self) -> float:
        """Return the speed at which the way takes its duration [m/s]."""
        if self.acceleration is None:
            return self.length / self.duration
        # Starting and stopping take twice as long as at full speed: together 15/8 speed / a longer.
        least = 2 * np.sqrt(_STEEPEST * self.length / self.acceleration)
        if not self.duration >= least:
            raise InvalidArgument(
                f"duration is {self.duration:g} s, expected at least {least:.6g} s for {self.length:.6g} m "
                f"with acceleration = {self.acceleration:g} m/s^2"
            )
        # The smaller root of 15/8 speed^2 / a - duration speed + length = 0, without a difference.
        share = np.sqrt((1 - least / self.duration) * (1 + least / self.duration))
        return float(2 * self.length / self.duration / (1 + share))

    def _straight(self, t: float, way: float, start: Array, direction: Array, shares: Array) -> Polynomial:
        """Return a straight piece from `t` on, for the time in which the speed makes so much way."""
        with np.errstate(all="ignore"):
            T = stretch("the time of a piece", way / self.speed)
            powers = (shares * T ** -np.arange(len(shares)))[:, None] * self.speed * direction
        coefficients = representable("a coefficient of the path", np.array([start, *powers]))
        return Polynomial(t, t + T, coefficients)

    def _corner(self, k: int, before: Array, after: Array) -> _Corner:
        """Return how the corner at a waypoint is rounded, of the directions on both sides."""
        aside = after - (after @ before) * before
        sine = float(np.linalg.norm(aside))
        angle = float(np.arctan2(sine, after @ before))
        if angle < _STRAIGHT:
            return _NONE
        if angle > _BACK:
            raise InvalidArgument(
                f"waypoints[{k}] is where the way turns by {np.degrees(angle):.4g} degrees, expected at most "
                f"{np.degrees(_BACK):.4g}: let one path come to rest there, and another begin"
            )
        length = _STEEPEST * angle * self.corner_radius
        # Its second half is its first half in a mirror: its chord is what goes along its middle direction.
        nodes, weights = _quadrature()
        chord = length * float((weights * np.cos(angle * (_SMOOTH(nodes) - 0.5))).sum())
        axes = np.array([before, aside / sine])
        return _Corner(angle, chord / (2 * np.cos(angle / 2)), length, axes)

    def _check_room(self, apart: Array, lengths: Array, what: str) -> None:
        needed = apart[:-1] + apart[1:]
        for k in np.flatnonzero(needed > lengths * (1 + _ROUNDING))[:1]:
            raise InvalidArgument(
                f"waypoints[{k}] and waypoints[{k + 1}] are {lengths[k]:.6g} m apart, expected at least "
                f"{needed[k]:.6g} m, which {what}: a smaller corner_radius takes less than "
                f"{self.corner_radius:g} m"
            )


# The way of a straight piece, as a share of speed times time, in powers of the share of its time from the
# first on: the integral of h, of one, and of 1 - h.
_GAINED = np.array([0.0, 0.0, 0.0, 2.5, -3.0, 1.0])
_KEPT = np.array([1.0])
_LOST = np.array([1.0, 0.0, 0.0, -2.5, 3.0, -1.0])


@dataclass(frozen=True, eq=False)
class _Turn:
    """A corner: position is the integral of a velocity whose direction turns by theta h(s).

    Attributes
    ----------
    start, end : float
        When [s].
    point : ndarray, shape (n,)
        Where it starts [m].
    axes : ndarray, shape (2, n)
        The velocity at the start, and what it would be a quarter of a turn later [m/s].
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
        with np.errstate(all="ignore"):  # of an order that nobody needs
            if order:
                z = self._direction(s, order - 1) / T ** (order - 1)
            else:
                nodes, weights = _quadrature()
                z = T * s * (weights * self._direction(s[..., None] * nodes, 0)).sum(axis=-1)
            found = z.real[..., None] * self.axes[0] + z.imag[..., None] * self.axes[1]
        return representable("a derivative of the path", found) if order else self.point + found

    def _direction(self, s: Array, order: int) -> NDArray[np.complex128]:
        """Return a derivative by s of z = exp(i theta h(s)): z' = i theta h' z, by Leibniz."""
        psi = self.angle * _SMOOTH(s)
        found = [np.cos(psi) + 1j * np.sin(psi)]
        rates = [1j * self.angle * _SMOOTH.deriv(k + 1)(s) for k in range(min(order, _SMOOTH.degree()))]
        for m in range(order):
            found.append(np.zeros_like(found[0]))
            for k, rate in enumerate(rates[: m + 1]):
                found[-1] += comb(m, k) * rate * found[m - k]
        return found[order]


@cache
def _quadrature() -> tuple[Array, Array]:
    """Return nodes in [0, 1] and weights of the quadrature of Clenshaw and Curtis."""
    # Gauss's nodes would come from a library's eigenvalues, whose last bit hangs on the machine.
    j, k = np.arange(_NODES + 1), np.arange(1, _NODES // 2 + 1)
    shares = np.where(k == _NODES // 2, 1.0, 2.0) / (4.0 * k**2 - 1)
    weights = (1 - (shares * np.cos(2 * np.pi * j[:, None] * k / _NODES)).sum(axis=-1)) / _NODES
    weights[[0, -1]] /= 2
    return frozen((1 - np.cos(np.pi * j / _NODES)) / 2), frozen(weights)
