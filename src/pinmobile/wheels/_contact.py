"""Impulses of dry friction between wheels and ground: a convex problem, solved wheel by wheel.

All functions take scalars: numbers, arrays with leading axes, or symbols. The impulses p minimise p' G p / 2
+ p' s within their bounds, where s is the slip without them and G = A M^-1 A' + D / h. At the minimum,
sticking wheels do not slip, and the force on a sliding wheel opposes its slip (Moreau and Jean; Acary and
Brogliato, Numerical methods for nonsmooth dynamical systems, Springer 2008).

Block Gauss-Seidel updates the velocities with the impulses. A block contains the impulses of a wheel along
and across it, and the one that holds its rate; the others stay constant. A block is solved exactly, except
for the multiplier of a friction disc, for which Newton's method takes one step per iteration. If this
converges slowly, for instance where wheels share a force of which only the sum is determined and some of them
slide, `found_by_newton` continues.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

from pinmobile.compiled import choose, repeat, scalar_max, square_root
from pinmobile.robot import ONE, ZERO, Matrix, Vector, dot, factored, number

_SOON = 24  # Gauss-Seidel iterations before Newton's method
_ROUNDED = 0.1  # initial smoothing of friction, relative to the slip per impulse of the wheel
_LESS = 0.3  # factor of the smoothing after each convergence
_LEAST = 1e-8  # smallest smoothing
_FINE = 1e-2  # smoothing of the final solution; below it, rounding errors affect the impulses
_LEVEL = 0.3  # largest slope at the end of a line search, relative to its start
_SHORTEST = 1e-9  # smallest fraction of a Newton step
_NEAR = 0.1  # tolerance of velocities, relative to the error of impulses
_ROUNDING = 1e-13  # relative rounding error of the velocities
_PLAIN = 100.0  # tolerance of Newton's method, in tolerances of Gauss-Seidel


class Bounds(NamedTuple):
    """Bounds of a wheel's friction impulses, and the slip that friction opposes.

    Attributes
    ----------
    along, across : scalar
        Largest impulses [N s]; for a friction disc, both are its radius.
    spin : scalar
        Largest angular impulse that holds the wheel's coordinate [N m s].
    began : list of 2 scalars
        Slip velocity at the start of the step, along and across, if friction opposes the mean slip of the
        step, as for a wheel that slides throughout; zero if it opposes the slip at the end only [m/s].
    """

    along: Any
    across: Any
    spin: Any
    began: Vector


class Pair(NamedTuple):
    """Symmetric 2 x 2 matrix (a, b; b, c)."""

    a: Any
    b: Any
    c: Any

    def times(self, x: Vector) -> Vector:
        """Return the product with a vector."""
        return [self.a * x[0] + self.b * x[1], self.b * x[0] + self.c * x[1]]


@dataclass(frozen=True, eq=False)
class WheelContact:
    """Contact of a wheel with the ground, with directions along and across.

    Parameters
    ----------
    rows, columns : 2 lists of scalars
        Slip velocity per velocity, and velocity per impulse, of both directions.
    spin : int
        Number of the velocity that is the wheel's rate.
    spun : list of scalars
        Velocity per angular impulse on this rate.
    is_disc : bool
        Whether friction is isotropic; otherwise each direction has its own bound.
    give : scalar
        Slip velocity per impulse before the wheel slides [1/kg].
    held : bool
        Whether dry friction holds the wheel's rate.
    """

    rows: Sequence[Vector]
    columns: Sequence[Vector]
    spin: int
    spun: Vector
    is_disc: bool
    give: Any
    held: bool

    @cached_property
    def own(self) -> Pair:
        """Slip per impulse (Delassus matrix), without `give`."""
        (first, second), (x, y) = self.rows, self.columns
        return Pair(number(dot(first, x)), number(dot(first, y)), number(dot(second, y)))

    @cached_property
    def by_spin(self) -> Vector:
        """Slip per angular impulse."""
        return [number(dot(row, self.spun)) for row in self.rows]

    @cached_property
    def own_held(self) -> Pair:
        """Slip per impulse for a fixed rate of the wheel."""
        (a, b, c), (x, y) = self.own, self.by_spin
        share = 1.0 / self.spun[self.spin]
        return Pair(a - x * x * share, b - x * y * share, c - y * y * share)

    @cached_property
    def free(self) -> _Block:
        """Solver of the block for a turning wheel."""
        return self._block(self.own)

    @cached_property
    def locked(self) -> _Block:
        """Solver of the block for a wheel with a fixed rate."""
        return self._block(self.own_held)

    def _block(self, own: Pair) -> _Block:
        stiff = Pair(own.a + self.give, own.b, own.c + self.give)
        return _Disc.of(stiff) if self.is_disc else _Rectangle.of(stiff)

    def solved(
        self, v: Vector, p: Vector, spin: Any, shift: Any, bounds: Bounds
    ) -> tuple[Vector, Vector, Any, Any]:
        """Return the velocities, and impulses, angular impulse and multiplier of this wheel.

        Parameters
        ----------
        v : list of scalars
            Velocities after all impulses.
        p : list of 2 scalars
            Present impulses.
        spin, shift : scalar
            Present angular impulse, and multiplier of the disc.
        bounds : Bounds
            Bounds of the impulses.
        """
        slip = [began + dot(row, v) for row, began in zip(self.rows, bounds.began, strict=True)]
        if not self.held:
            now, shift = self.free.solved(self._wanted(self.own, p, slip), bounds, shift)
            return self._moved(v, p, now, ZERO), now, spin, shift
        share = 1.0 / self.spun[self.spin]
        still = v[self.spin] * share
        wanted = [s - x * still for s, x in zip(slip, self.by_spin, strict=True)]
        locked, shift_locked = self.locked.solved(self._wanted(self.own_held, p, wanted), bounds, shift)
        step = dot(self.by_spin, [a - b for a, b in zip(locked, p, strict=True)]) * share
        asked = spin - still - step
        holds = abs(asked) <= bounds.spin
        limit = choose(asked > 0.0, bounds.spin, -bounds.spin)
        wanted = [s + x * (limit - spin) for s, x in zip(slip, self.by_spin, strict=True)]
        turning, shift_turning = self.free.solved(self._wanted(self.own, p, wanted), bounds, shift)
        now = [choose(holds, a, b) for a, b in zip(locked, turning, strict=True)]
        held = choose(holds, asked, limit)
        return self._moved(v, p, now, held - spin), now, held, choose(holds, shift_locked, shift_turning)

    def place(self, bounds: Bounds) -> FrictionConstraint:
        """Return the constraint of its slip."""
        most = [bounds.along, bounds.across]
        return FrictionConstraint(self.rows, self.columns, most, self.is_disc, bounds.began, self.give)

    def holds(self, bounds: Bounds) -> FrictionConstraint:
        """Return the constraint of its rate."""
        row = [ONE if k == self.spin else ZERO for k in range(len(self.spun))]
        return FrictionConstraint([row], [self.spun], [bounds.spin], False, [0.0], 0.0)

    def _wanted(self, own: Pair, p: Vector, slip: Vector) -> Vector:
        """Return own p - slip: the product of the Delassus matrix and the impulses that stop the slip."""
        return [a - s for a, s in zip(own.times(p), slip, strict=True)]

    def _moved(self, v: Vector, p: Vector, now: Vector, spin: Any) -> Vector:
        """Return the velocities after a change of the impulses."""
        changes = [*(a - b for a, b in zip(now, p, strict=True)), spin]
        columns = zip(*self.columns, self.spun, strict=True)
        return [number(x + dot(by, changes)) for x, by in zip(v, columns, strict=True)]


class _Disc(NamedTuple):
    """Block with impulses in a disc: eigenvalues of its matrix, and cosine and sine of its axes."""

    c: Any
    s: Any
    first: Any
    second: Any

    @classmethod
    def of(cls, own: Pair) -> _Disc:
        """Return the block of a matrix, by Jacobi's rotation."""
        half = 0.5 * (own.a - own.c)
        long = square_root(half * half + own.b * own.b)
        bottom = choose(half < 0.0, half - long, half + long)
        t = choose(long > 0.0, own.b / choose(long > 0.0, bottom, 1.0), 0.0)
        c = 1.0 / square_root(1.0 + t * t)
        return cls(c, t * c, own.a + t * own.b, own.c - t * own.b)

    def solved(self, y: Vector, bounds: Bounds, shift: Any) -> tuple[Vector, Any]:
        """Return the impulse p with (B + mu) p = y, and mu: 0 inside the disc, an improved value on its edge.

        It takes a Newton step for the norm of p, in the form 1 / norm = 1 / radius (More and Sorensen, SIAM
        J. Sci. Stat. Comput. 4, 1983).
        """
        c, s, radius = self.c, self.s, bounds.along
        y1, y2 = c * y[0] + s * y[1], c * y[1] - s * y[0]
        a1, a2 = y1 * (1.0 / self.first), y2 * (1.0 / self.second)
        inside = a1 * a1 + a2 * a2 <= radius * radius
        l1, l2 = self.first + shift, self.second + shift
        share = 1.0 / (l1 * l2)
        p1, p2 = y1 * (l2 * share), y2 * (l1 * share)
        q1, q2 = p1 * p1, p2 * p2
        square = q1 + q2
        bent = (q1 * l2 + q2 * l1) * share
        size = square_root(square)
        bottom = size * bent * radius
        given = bottom > 0.0
        inverse = 1.0 / choose(given, bottom, 1.0)
        scale = choose(given, radius * radius * bent * inverse, 0.0)
        better = scalar_max(shift + square * (size - radius) * size * inverse, 0.0)
        p1, p2 = choose(inside, a1, p1 * scale), choose(inside, a2, p2 * scale)
        return [c * p1 - s * p2, s * p1 + c * p2], choose(inside, 0.0, choose(given, better, 0.0))


class _Rectangle(NamedTuple):
    """Block with separate bounds along and across: its matrix, and inverses of its entries."""

    own: Pair
    first: Any
    second: Any
    alone: Any

    @classmethod
    def of(cls, own: Pair) -> _Rectangle:
        """Return the block of a matrix."""
        second = 1.0 / own.c
        return cls(own, 1.0 / own.a, second, 1.0 / (own.a - own.b * own.b * second))

    def solved(self, y: Vector, bounds: Bounds, shift: Any) -> tuple[Vector, Any]:
        """Return the impulses, and the unchanged multiplier."""
        own = self.own
        free = within((y[0] - own.b * self.second * y[1]) * self.alone, bounds.along)
        asked = (y[1] - own.b * free) * self.second
        across = within(asked, bounds.across)
        along = within((y[0] - own.b * across) * self.first, bounds.along)
        sticks = abs(asked) <= bounds.across
        return [choose(sticks, free, along), across], shift


_Block = _Disc | _Rectangle


def within(x: Any, bound: Any) -> Any:
    """Return a scalar clipped to a bound on both sides."""
    return choose(x > bound, bound, choose(x < -bound, -bound, x))


class Impulses(NamedTuple):
    """Impulses of the ground in a step.

    Attributes
    ----------
    velocity : list of scalars
        Velocities after the impulses.
    impulses : list of scalars
        Along and across each wheel [N s], then the angular ones that hold wheels' coordinates [N m s].
    multipliers : list of scalars, shape (wheels,)
        Multipliers of the friction discs, zero for sticking wheels.
    missed : scalar
        1 if the iterations did not converge, else 0.
    """

    velocity: Vector
    impulses: Vector
    multipliers: Vector
    missed: Any = 0.0


def impulses(
    touches: list[WheelContact], bounds: list[Bounds], free: Vector, M: Matrix, before: Impulses, ground: Any
) -> Impulses:
    """Return the impulses, starting from earlier ones.

    Parameters
    ----------
    touches, bounds : sequence of WheelContact, Bounds
        Contact and bounds of each wheel.
    free : list of scalars
        Velocities without impulses.
    M : list of lists of scalars
        Mass matrix of the velocities.
    before : Impulses
        Initial guess.
    ground : Coulomb
        Ground with `sweeps` and `tolerance`.
    """
    holder = {touch.spin: touch for touch in touches if touch.held}
    spins = list(holder)
    most_of = [x for bound in bounds for x in (bound.along, bound.across)]
    for at in spins:
        most_of.append(next(b.spin for t, b in zip(touches, bounds, strict=True) if t.spin == at))
    begun = list(map(within, before.impulses, most_of))  # the earlier impulses, clipped to the present bounds
    velocity, m = list(free), 2 * len(touches)
    for k, touch in enumerate(touches):
        velocity = touch._moved(velocity, [ZERO, ZERO], begun[2 * k : 2 * k + 2], ZERO)
    velocity = moved_by(velocity, [holder[at].spun for at in spins], begun[m:])
    enough = ground.tolerance * reduce(scalar_max, [bound.along for bound in bounds])

    plain = min(ground.sweeps, _SOON)

    def one(v: Vector, p: Vector, held: Vector, shifts: Vector, _: Any) -> tuple[Any, Any]:
        before, p, held, shifts = p, list(p), list(held), list(shifts)
        for k, (touch, bound) in enumerate(zip(touches, bounds, strict=True)):
            at = spins.index(touch.spin) if touch.held else 0
            old = p[2 * k : 2 * k + 2]
            own = held[at] if held else 0.0
            v, p[2 * k : 2 * k + 2], spun, shifts[k] = touch.solved(v, old, own, shifts[k], bound)
            if touch.held:
                held[at] = spun
        change: Any = 0.0
        for x, y in zip(p, before, strict=True):
            change = scalar_max(abs(x - y), change)
        done = change <= enough
        return (v, p, held, shifts, choose(done, 0.0, 1.0)), done

    first = velocity, begun[:m], begun[m:], list(before.multipliers), 1.0
    velocity, p, held, *rest = iterated(one, first, plain)
    start = Impulses(velocity, [*p, *held], *rest)
    if ground.sweeps > plain:
        places = [touch.place(bound) for touch, bound in zip(touches, bounds, strict=True)]
        places += [holder[at].holds(bounds[touches.index(holder[at])]) for at in spins]
        return found_by_newton(places, M, free, start, ground.sweeps - plain, enough)
    return start


def iterated(
    one: Callable[..., tuple[Sequence[Any], Any]], first: Sequence[Any], most: int, settled: Any = False
) -> tuple[Any, ...]:
    """Return scalars and lists of scalars after iterations of a function, see `repeat`.

    Parameters
    ----------
    one : callable
        ``one(*parts)`` returns the parts after an iteration, and whether they have converged.
    first : sequence of scalars and lists of scalars
        Initial parts.
    most, settled
        As in `repeat`.
    """

    def flat(parts: Sequence[Any]) -> Vector:
        return [number(x) for part in parts for x in (part if isinstance(part, list) else (part,))]

    def shaped(numbers: Vector) -> tuple[Any, ...]:
        rest = iter(numbers)
        return tuple([next(rest) for _ in x] if isinstance(x, list) else next(rest) for x in first)

    def law(numbers: Vector) -> tuple[Vector, Any]:
        found, done = one(*shaped(numbers))
        return flat(found), done

    return shaped(repeat(law, flat(first), most, settled))


def moved_by(velocity: Vector, columns: Iterable[Vector], impulses: Iterable[Any]) -> Vector:
    """Return the velocities after impulses, from velocities per impulse."""
    for column, x in zip(columns, impulses, strict=True):
        velocity = [number(a + b * x) for a, b in zip(velocity, column, strict=True)]
    return velocity


class FrictionConstraint(NamedTuple):
    """Friction constraint of one or two directions.

    Attributes
    ----------
    rows, columns : lists of scalars
        Slip velocity per velocity, and velocity per impulse, of each direction.
    bounds : list of scalars
        Largest impulse in each direction [N s].
    is_disc : bool
        Whether the bound applies to both directions together.
    began : list of scalars
        Addition to the slip [m/s].
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
        """Slip per impulse, the mean of its directions."""
        own = [number(dot(row, column)) for row, column in zip(self.rows, self.columns, strict=True)]
        return sum(own[1:], own[0]) * (1.0 / len(own))

    def pushed(self, v: Vector, before: Vector, rounded: Any) -> _Pushed:
        """Return the impulse at given velocities, and its derivative.

        Parameters
        ----------
        v, before : lists of scalars
            Velocities, and the impulse before.
        rounded : scalar
            Smoothing of friction: slip per impulse.
        """
        slip = [began + dot(row, v) for row, began in zip(self.rows, self.began, strict=True)]
        share = 1.0 / (rounded + self.give)
        z = [(rounded * p - s) * share for p, s in zip(before, slip, strict=True)]
        if not self.is_disc:
            now = list(map(within, z, self.bounds))
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
        multiplier = choose(sticks, 0.0, scalar_max(-slides - self.give, 0.0))
        return _Pushed(now, [scale * share] * 2, [*z, against * inverse], multiplier)


class _Pushed(NamedTuple):
    """Impulse, and its derivative by the slip, -(diag(bent) - c (x, y) (x, y)')."""

    now: Vector
    bent: Vector
    turned: Vector | None
    multiplier: Any

    def add(self, place: FrictionConstraint, H: Matrix, g: Vector) -> None:
        """Add the contribution of the constraint to Hessian and gradient."""
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


def found_by_newton(
    places: list[FrictionConstraint], M: Matrix, free: Vector, start: Impulses, most: int, tolerance: Any
) -> Impulses:
    """Return the impulses by Newton's method, from an initial guess.

    Parameters
    ----------
    places : sequence of FrictionConstraint
        Constraints of the velocities.
    M : list of lists of scalars
        Mass matrix of the velocities; the columns of M^-1 are those of the constraints.
    free : list of scalars
        Velocities without impulses.
    start : Impulses
        Initial guess, returned unchanged if it has converged.
    most : int
        Largest number of iterations.
    tolerance : scalar
        Tolerance of impulses [N s].
    """
    n, sizes = len(free), [place.size for place in places]
    ends = [sum(len(place.rows) for place in places[:k]) for k in range(len(places) + 1)]
    discs = [k for k, place in enumerate(places) if place.is_disc]
    moving = number(dot(free, [number(dot(row, free)) for row in M]))
    near = _PLAIN * tolerance
    enough = reduce(scalar_max, sizes) * near * near + _ROUNDING * _ROUNDING * moving

    def one(v: Vector, way: Vector, p: Vector, search: Vector, *_: Any) -> tuple[Any, Any]:
        slope, share, low, high, rounded, sure = search
        at = [x + share * y for x, y in zip(v, way, strict=True)]
        H = [list(row) for row in M]
        change = [x - y for x, y in zip(at, free, strict=True)]
        g = [number(dot(row, change)) for row in M]
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
        velocity = moved_by(free, (column for place in places for column in place.columns), impulses)
        smaller = choose(known, _FINE, scalar_max(_LESS * rounded, _LEAST))
        search = [
            choose(moves, 0.0, choose(goes, fall, slope)),
            choose(moves, 0.0, choose(goes, 1.0, between)),
            choose(goes, 0.0, low),
            choose(goes, 1.0, high),
            choose(moves, smaller, rounded),
            choose(moves, choose(known, 1.0, 0.0), sure),
        ]
        way = [choose(moves, 0.0, choose(goes, x, y)) for x, y in zip(next_way, way, strict=True)]
        v = [choose(goes, x, y) for x, y in zip(at, v, strict=True)]
        return (v, way, impulses, search, velocity, multipliers, choose(done, 0.0, 1.0)), done

    search, own = [0.0] * 4 + [_ROUNDED, 0.0], [start.multipliers[k] for k in discs]
    first = start.velocity, [0.0] * n, start.impulses, search, start.velocity, own, start.missed
    _, _, pushed, _, velocity, own, missed = iterated(one, first, most, start.missed < 0.5)
    multipliers = list(start.multipliers)
    for k, x in zip(discs, own, strict=True):
        multipliers[k] = x
    return Impulses(velocity, pushed, multipliers, missed)
