"""Impulses of dry friction that wheel by wheel come slowly: Newton's method over the velocities.

Of all velocities those are sought that make a convex function least (Hestenes' and Powell's method of
multipliers; Rockafellar, Mathematics of Operations Research 1, 1976): kinetic energy of what impulses change,
and what friction takes, its edge rounded over a little slip. That is smooth, and has one least place, so that
Newton's method finds it, steps shortened where the slope along one says so; by and by impulses that have
been found take the place of the rounding. Forces of wheels that share what only their sum determines are no
harder than others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from pinmobile.compiled import choose, higher, repeated, square_root
from pinmobile.robot import ZERO, Matrix, Vector, dot, number

_ROUNDED = 0.1  # at first: share of a wheel's own slip per impulse, over which friction's edge is rounded
_LESS = 0.3  # of that, each time that impulses have been found
_LEAST = 1e-8
_FINE = 1e-2  # share below which impulses feel how numbers are rounded; with this they are found again
_LEVEL = 0.3  # of the slope at the start of a step that may be left at its end
_SHORTEST = 1e-9  # share of a step
_NEAR = 0.1  # of how far impulses are off, to which velocities are found for them
_ROUNDING = 1e-13  # of the velocities
_PLAIN = 100.0  # tolerances that plain rounds are from their end, at least, where they come slowly


class Place(NamedTuple):
    """Where something holds velocities: one direction, or two.

    Attributes
    ----------
    rows, columns : lists of scalars
        Slip velocity per velocity, and velocity per impulse, of each direction.
    bounds : list of scalars
        Impulse at most, in each direction [N s].
    is_disc : bool
        Whether the bound is that of both together.
    began : list of scalars
        What is added to the slip [m/s].
    give : scalar
        Slip velocity per impulse [1/kg].
    """

    rows: Sequence[Vector]
    columns: Sequence[Vector]
    bounds: Vector
    is_disc: bool
    began: Vector
    give: Any

    @property
    def size(self) -> Any:
        """Slip per impulse of its own, the mean of its directions."""
        own = [number(dot(row, column)) for row, column in zip(self.rows, self.columns, strict=True)]
        return sum(own[1:], own[0]) * (1.0 / len(own))

    def pushed(self, v: Vector, before: Vector, rounded: Any) -> _Pushed:
        """Return the impulse at velocities, near to one before, and how it changes with them.

        Parameters
        ----------
        v, before : lists of scalars
            Velocities, and the impulse.
        rounded : scalar
            Slip per impulse over which friction's edge is rounded.
        """
        slip = [began + dot(row, v) for row, began in zip(self.rows, self.began, strict=True)]
        share = 1.0 / (rounded + self.give)
        z = [(rounded * p - s) * share for p, s in zip(before, slip, strict=True)]
        if not self.is_disc:
            now = [
                choose(x > most, most, choose(x < -most, -most, x))
                for x, most in zip(z, self.bounds, strict=True)
            ]
            bent = [choose(abs(x) <= most, share, 0.0) for x, most in zip(z, self.bounds, strict=True)]
            return _Pushed(now, bent, None, 0.0)
        radius = self.bounds[0]
        square = z[0] * z[0] + z[1] * z[1]
        sticks = square <= radius * radius
        inverse = 1.0 / choose(sticks, 1.0, square)
        scale = choose(sticks, 1.0, radius * square_root(inverse))
        now = [scale * x for x in z]
        against = choose(sticks, 0.0, scale * share)
        slides = choose(radius > 0.0, dot(slip, now) / choose(radius > 0.0, radius * radius, 1.0), 0.0)
        return _Pushed(
            now,
            [scale * share] * 2,
            [z[0], z[1], against * inverse],
            choose(sticks, 0.0, higher(-slides - self.give, 0.0)),
        )


class _Pushed(NamedTuple):
    """An impulse, and how it changes with the slip: diag(bent) - c (x, y) (x, y)', less."""

    now: Vector
    bent: Vector
    turned: Vector | None
    multiplier: Any

    def add(self, place: Place, H: Matrix, g: Vector) -> None:
        """Add to the second derivatives, and to the slope."""
        terms = list(zip(place.rows, self.bent, strict=True))
        if self.turned is not None:
            x, y, c = self.turned
            terms.append(([x * a + y * b for a, b in zip(*place.rows, strict=True)], -c))
        for p, row in zip(self.now, place.rows, strict=True):
            for i, x in enumerate(row):
                g[i] = g[i] - x * p
        for row, weight in terms:
            heavy = [x * weight for x in row]
            for i, x in enumerate(row):
                for j in range(i + 1):
                    H[i][j] = H[j][i] = H[i][j] + x * heavy[j]


class Found(NamedTuple):
    """What has been found: as of `Impulses`, and 1 where it has not."""

    velocity: Vector
    impulses: Vector
    multipliers: Vector
    rounds: Any
    missed: Any


def found_by_newton(
    places: Sequence[Place],
    inertia: Matrix,
    free: Vector,
    start: Found,
    *,
    settled: Any,
    most: int,
    tolerance: Any,
) -> Found:
    """Return the impulses, from those of a start.

    Parameters
    ----------
    places : sequence of Place
        What holds the velocities.
    inertia : list of lists of scalars
        Of the velocities, whose columns of M^-1 are those of the places.
    free : list of scalars
        Velocities without any impulse.
    start : Found
        What to begin with.
    settled : bool
        Where that is the answer.
    most : int
        Rounds at most.
    tolerance : scalar
        Change of an impulse that is of no interest [N s].
    """
    n, sizes = len(free), [place.size for place in places]
    ends = [sum(len(place.rows) for place in places[:k]) for k in range(len(places) + 1)]
    m, discs = ends[-1], [k for k, place in enumerate(places) if place.is_disc]
    largest = sizes[0]
    for size in sizes[1:]:
        largest = higher(largest, size)
    moving = number(dot(free, [number(dot(row, free)) for row in inertia]))
    enough = largest * (_PLAIN * tolerance) * (_PLAIN * tolerance) + _ROUNDING * _ROUNDING * moving
    behind = 2 * n + m + 7

    def one(numbers: Vector) -> tuple[Vector, Any]:
        v, way, p = numbers[:n], numbers[n : 2 * n], numbers[2 * n : 2 * n + m]
        slope, share, low, high, rounded, sure, count = numbers[2 * n + m : behind]
        at = [x + share * y for x, y in zip(v, way, strict=True)]
        H = [list(row) for row in inertia]
        change = [x - y for x, y in zip(at, free, strict=True)]
        g = [number(dot(row, change)) for row in inertia]
        now: Vector = []
        multipliers, off = [], ZERO
        for place, size, first, last in zip(places, sizes, ends, ends[1:], strict=False):
            pushed = place.pushed(at, p[first:last], rounded * size)
            pushed.add(place, H, g)
            now += pushed.now
            if place.is_disc:
                multipliers.append(pushed.multiplier)
            for x, y in zip(pushed.now, p[first:last], strict=True):
                off = off + size * ((x - y) * (x - y))
        off = number(off) * rounded
        curve = number(dot(way, [number(dot(row, way)) for row in H]))
        next_way = [-number(x) for x in factored(H)[0](g)]
        fall, uphill = number(dot(g, next_way)), number(dot(g, way))
        rises = uphill > 0.0
        level = abs(uphill) <= -_LEVEL * slope
        goes = level | ((share >= 1.0) & (uphill <= 0.0)) | (share < _SHORTEST)
        little = enough * choose(rounded >= _FINE, rounded * rounded, 1.0)
        moves = goes & ((-fall <= _NEAR * _NEAR * off) | (-fall <= little))
        known = moves & (off * rounded <= enough) & (-fall <= little)
        done = known & (rounded >= _FINE) & (sure > 0.0)
        low, high = choose(rises, low, share), choose(rises, share, high)
        level_at = share - uphill / choose(curve > 0.0, curve, 1.0)
        between = choose((level_at > low) & (level_at < high), level_at, 0.5 * (low + high))
        impulses = [choose(moves, x, y) for x, y in zip(now, p, strict=True)]
        velocity = list(free)
        for column, x in zip((c for place in places for c in place.columns), impulses, strict=True):
            velocity = [number(a + b * x) for a, b in zip(velocity, column, strict=True)]
        smaller = choose(known, _FINE, higher(_LESS * rounded, _LEAST))
        return [
            *(choose(goes, x, y) for x, y in zip(at, v, strict=True)),
            *(choose(moves, 0.0, choose(goes, x, y)) for x, y in zip(next_way, way, strict=True)),
            *impulses,
            choose(moves, 0.0, choose(goes, fall, slope)),
            choose(moves, 0.0, choose(goes, 1.0, between)),
            choose(goes, 0.0, low),
            choose(goes, 1.0, high),
            choose(moves, smaller, rounded),
            choose(moves, choose(known, 1.0, 0.0), sure),
            count + 1.0,
            *velocity,
            *multipliers,
            choose(done, 0.0, 1.0),
        ], done

    first = [*start.velocity, *[0.0] * n, *start.impulses, *[0.0] * 4, _ROUNDED, 0.0, start.rounds]
    first += [*start.velocity, *(start.multipliers[k] for k in discs), start.missed]
    found = repeated(one, first, most, settled)
    multipliers, told = list(start.multipliers), found[behind + n : -1]
    for k, x in zip(discs, told, strict=True):
        multipliers[k] = x
    return Found(
        found[behind : behind + n], found[2 * n : 2 * n + m], multipliers, found[behind - 1], found[-1]
    )


def factored(M: Matrix, order: Sequence[int] = ()) -> tuple[Callable[[Vector], Vector], Matrix]:
    """Return what solves M x = right, of a symmetric M, and what is left of it halfway; zeros stay.

    Parameters
    ----------
    M : list of lists of scalars
        The matrix.
    order : sequence of int, optional
        Unknowns that are eliminated first. What is left is the matrix of the others; they follow, the last
        first.
    """
    n, left = len(M), list[list[Any]]()
    others = [i for i in range(n) if i not in order]
    M, inverse, order = [list(row) for row in M], [ZERO] * n, [*order, *reversed(others)]
    for done, i in enumerate(order, 1):
        if done > n - len(others) and not left:
            left = [[M[j][k] for k in others] for j in others]
        inverse[i] = 1.0 / number(M[i][i])
        rest = order[done:]
        factors = {j: M[j][i] * inverse[i] for j in rest}
        for at, j in enumerate(rest):
            for k in rest[: at + 1]:
                M[j][k] = M[k][j] = M[j][k] - factors[j] * M[k][i]
        for j in rest:
            M[j][i] = factors[j]

    def solve(right: Vector) -> Vector:
        x = list(right)
        for done, i in enumerate(order, 1):
            for j in order[done:]:
                x[j] = x[j] - M[j][i] * x[i]
        x = [value * inverse[i] for i, value in enumerate(x)]
        for k, i in reversed(list(enumerate(order))):
            for j in order[k + 1 :]:
                x[i] = x[i] - M[j][i] * x[j]
        return x

    return solve, left
