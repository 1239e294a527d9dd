"""Impulses of dry friction between wheels and ground: a convex problem, solved wheel by wheel.

Everything is over scalars: numbers, arrays with leading axes, or symbols. The impulses p make
p' G p / 2 + p' s least, each within its bounds, where s is the slip without them and G = A M^-1 A' + D / h;
then what sticks does not slip, and what slides is pushed against its slip (Moreau and Jean; Acary and
Brogliato, Numerical methods for nonsmooth dynamical systems, Springer 2008). Block Gauss-Seidel keeps the
velocities that the impulses lead to. A block is a wheel: what it exerts along and across, and what holds
its rate; the others stay meanwhile. Blocks are solved exactly but for the multiplier of a disc, on which
Newton's method takes one step in each round. Where that does not come to an end soon, as where wheels share
what only their sum determines and some of them slide, `found_by_newton` goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

from pinmobile.compiled import choose, higher, repeated, square_root
from pinmobile.robot import ONE, ZERO, Matrix, Vector, dot, factored, number

_SOON = 24  # rounds
_ROUNDED = 0.1  # at first: share of a wheel's own slip per impulse, over which friction's edge is rounded
_LESS = 0.3  # of that, each time that impulses have been found
_LEAST = 1e-8
_FINE = 1e-2  # share below which impulses feel how numbers are rounded; with this they are found again
_LEVEL = 0.3  # of the slope at the start of a step that may be left at its end
_SHORTEST = 1e-9  # share of a step
_NEAR = 0.1  # of how far impulses are off, to which velocities are found for them
_ROUNDING = 1e-13  # of the velocities
_PLAIN = 100.0  # tolerances that plain rounds are from their end, at least, where they come slowly


class Bounds(NamedTuple):
    """What a wheel's friction is at most, and which slip it is against.

    Attributes
    ----------
    along, across : scalar
        Impulse [N s]: of a disc both are its radius.
    spin : scalar
        Angular impulse that holds the wheel's coordinate [N m s].
    began : list of 2 scalars
        Slip velocity at the start of the step, along and across, where friction is against the mean of that
        and the one at its end, as that of a wheel that slides all the time; zero where it is against the
        latter alone [m/s].
    """

    along: Any
    across: Any
    spin: Any
    began: Vector


class Pair(NamedTuple):
    """A symmetric matrix of two rows: (a, b; b, c)."""

    a: Any
    b: Any
    c: Any

    def times(self, x: Vector) -> Vector:
        """Return its product."""
        return [self.a * x[0] + self.b * x[1], self.b * x[0] + self.c * x[1]]


@dataclass(frozen=True, eq=False)
class WheelContact:
    """A wheel on the ground, its directions along and across.

    Parameters
    ----------
    rows, columns : 2 lists of scalars
        Slip velocity per velocity, and velocity per impulse, of both directions.
    spin : int
        Which velocity is the wheel's rate.
    spun : list of scalars
        Velocity per angular impulse on that.
    is_disc : bool
        Whether friction is the same in all directions; else each direction has a bound of its own.
    give : scalar
        Slip velocity per impulse before it slides [1/kg].
    held : bool
        Whether something holds the wheel's rate.
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
        """Slip per impulse, but for what gives way."""
        (first, second), (x, y) = self.rows, self.columns
        return Pair(number(dot(first, x)), number(dot(first, y)), number(dot(second, y)))

    @cached_property
    def by_spin(self) -> Vector:
        """Slip per angular impulse."""
        return [number(dot(row, self.spun)) for row in self.rows]

    @cached_property
    def own_held(self) -> Pair:
        """Slip per impulse where the rate is held."""
        (a, b, c), (x, y) = self.own, self.by_spin
        share = 1.0 / self.spun[self.spin]
        return Pair(a - x * x * share, b - x * y * share, c - y * y * share)

    @cached_property
    def free(self) -> _Block:
        """What solves it where the wheel turns."""
        return self._block(self.own)

    @cached_property
    def locked(self) -> _Block:
        """What solves it where the wheel's rate is held."""
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
            Velocities that all impulses lead to.
        p : list of 2 scalars
            Impulses so far.
        spin, shift : scalar
            Angular impulse, and multiplier of the disc, so far.
        bounds : Bounds
            At most.
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
        """Return what holds its slip."""
        most = [bounds.along, bounds.across]
        return FrictionConstraint(self.rows, self.columns, most, self.is_disc, bounds.began, self.give)

    def holds(self, bounds: Bounds) -> FrictionConstraint:
        """Return what holds its rate."""
        row = [ONE if k == self.spin else ZERO for k in range(len(self.spun))]
        return FrictionConstraint([row], [self.spun], [bounds.spin], False, [0.0], 0.0)

    def _wanted(self, own: Pair, p: Vector, slip: Vector) -> Vector:
        """Return what its matrix times the new impulses has to be for it to stick."""
        return [a - s for a, s in zip(own.times(p), slip, strict=True)]

    def _moved(self, v: Vector, p: Vector, now: Vector, spin: Any) -> Vector:
        changes = [*(a - b for a, b in zip(now, p, strict=True)), spin]
        columns = zip(*self.columns, self.spun, strict=True)
        return [number(x + dot(by, changes)) for x, by in zip(v, columns, strict=True)]


class _Disc(NamedTuple):
    """A block whose impulse lies in a disc: eigenvalues of its matrix, and cosine and sine of its axes."""

    c: Any
    s: Any
    first: Any
    second: Any

    @classmethod
    def of(cls, own: Pair) -> _Disc:
        """Return that of a matrix, by Jacobi's rotation."""
        half = 0.5 * (own.a - own.c)
        long = square_root(half * half + own.b * own.b)
        bottom = choose(half < 0.0, half - long, half + long)
        t = choose(long > 0.0, own.b / choose(long > 0.0, bottom, 1.0), 0.0)
        c = 1.0 / square_root(1.0 + t * t)
        return cls(c, t * c, own.a + t * own.b, own.c - t * own.b)

    def solved(self, y: Vector, bounds: Bounds, shift: Any) -> tuple[Vector, Any]:
        """Return the impulse p of (B + mu) p = y, and mu: 0 within the disc, on its edge a better one.

        Newton's step is that of 1 / |p| = 1 / radius (More and Sorensen, SIAM J. Sci. Stat. Comput. 4, 1983).
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
        better = higher(shift + square * (size - radius) * size * inverse, 0.0)
        p1, p2 = choose(inside, a1, p1 * scale), choose(inside, a2, p2 * scale)
        return [c * p1 - s * p2, s * p1 + c * p2], choose(inside, 0.0, choose(given, better, 0.0))


class _Rectangle(NamedTuple):
    """A block whose impulses along and across have bounds of their own: its matrix, and shares of it."""

    own: Pair
    first: Any
    second: Any
    alone: Any

    @classmethod
    def of(cls, own: Pair) -> _Rectangle:
        """Return that of a matrix."""
        second = 1.0 / own.c
        return cls(own, 1.0 / own.a, second, 1.0 / (own.a - own.b * own.b * second))

    def solved(self, y: Vector, bounds: Bounds, shift: Any) -> tuple[Vector, Any]:
        """Return the impulses, and no multiplier."""
        own = self.own
        free = within((y[0] - own.b * self.second * y[1]) * self.alone, bounds.along)
        asked = (y[1] - own.b * free) * self.second
        across = within(asked, bounds.across)
        along = within((y[0] - own.b * across) * self.first, bounds.along)
        sticks = abs(asked) <= bounds.across
        return [choose(sticks, free, along), across], shift


_Block = _Disc | _Rectangle


def within(x: Any, bound: Any) -> Any:
    """Return what of a scalar lies within a bound to either side."""
    return choose(x > bound, bound, choose(x < -bound, -bound, x))


class Impulses(NamedTuple):
    """What the ground does in a step.

    Attributes
    ----------
    velocity : list of scalars
        Where it leads.
    impulses : list of scalars
        Along and across each wheel [N s], and then the angular ones that hold coordinates of wheels [N m s].
    multipliers : list of scalars, shape (wheels,)
        Of the discs, zero where a wheel sticks.
    rounds : scalar
        How many rounds were taken.
    missed : scalar
        1 where these ended before impulses were found to the tolerance, else 0.
    """

    velocity: Vector
    impulses: Vector
    multipliers: Vector
    rounds: Any = 0.0
    missed: Any = 0.0


def impulses(
    touches: list[WheelContact], bounds: list[Bounds], free: Vector, M: Matrix, before: Impulses, ground: Any
) -> Impulses:
    """Return the impulses, from those of before.

    Parameters
    ----------
    touches, bounds : sequence of WheelContact, Bounds
        Of each wheel.
    free : list of scalars
        Velocities without any impulse.
    M : list of lists of scalars
        Of the velocities.
    before : Impulses
        What to start from.
    ground : Coulomb
        With its sweeps and tolerance.
    """
    holder = {touch.spin: touch for touch in touches if touch.held}
    spins = list(holder)
    most_of = [x for bound in bounds for x in (bound.along, bound.across)]
    for at in spins:
        most_of.append(next(b.spin for t, b in zip(touches, bounds, strict=True) if t.spin == at))
    begun = list(map(within, before.impulses, most_of))  # what the loads of now allow, of what was before
    velocity, m = list(free), 2 * len(touches)
    for k, touch in enumerate(touches):
        velocity = touch._moved(velocity, [ZERO, ZERO], begun[2 * k : 2 * k + 2], ZERO)
    velocity = moved_by(velocity, [holder[at].spun for at in spins], begun[m:])
    enough = ground.tolerance * reduce(higher, [bound.along for bound in bounds])

    plain = min(ground.sweeps, _SOON)

    def one(v: Vector, p: Vector, held: Vector, shifts: Vector, rounds: Any, _: Any) -> tuple[Any, Any]:
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
            change = higher(abs(x - y), change)
        done = change <= enough
        return (v, p, held, shifts, rounds + 1.0, choose(done, 0.0, 1.0)), done

    first = velocity, begun[:m], begun[m:], list(before.multipliers), 0.0, 1.0
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
    """Return scalars and lists of scalars after rounds of a law: see `repeated`.

    Parameters
    ----------
    one : callable
        ``one(*parts)`` returns the parts after a round, and whether no further one is needed.
    first : sequence of scalars and lists of scalars
        The parts before the first round.
    most, settled
        As of `repeated`.
    """

    def flat(parts: Sequence[Any]) -> Vector:
        return [number(x) for part in parts for x in (part if isinstance(part, list) else (part,))]

    def shaped(numbers: Vector) -> tuple[Any, ...]:
        rest = iter(numbers)
        return tuple([next(rest) for _ in x] if isinstance(x, list) else next(rest) for x in first)

    def law(numbers: Vector) -> tuple[Vector, Any]:
        found, done = one(*shaped(numbers))
        return flat(found), done

    return shaped(repeated(law, flat(first), most, settled))


def moved_by(velocity: Vector, columns: Iterable[Vector], impulses: Iterable[Any]) -> Vector:
    """Return the velocities that impulses lead to, of velocities per impulse."""
    for column, x in zip(columns, impulses, strict=True):
        velocity = [number(a + b * x) for a, b in zip(velocity, column, strict=True)]
    return velocity


class FrictionConstraint(NamedTuple):
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
        multiplier = choose(sticks, 0.0, higher(-slides - self.give, 0.0))
        return _Pushed(now, [scale * share] * 2, [*z, against * inverse], multiplier)


class _Pushed(NamedTuple):
    """An impulse, and how it changes with the slip: diag(bent) - c (x, y) (x, y)', less."""

    now: Vector
    bent: Vector
    turned: Vector | None
    multiplier: Any

    def add(self, place: FrictionConstraint, H: Matrix, g: Vector) -> None:
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


def found_by_newton(
    places: list[FrictionConstraint], M: Matrix, free: Vector, start: Impulses, most: int, tolerance: Any
) -> Impulses:
    """Return the impulses, from those of a start.

    Parameters
    ----------
    places : sequence of FrictionConstraint
        What holds the velocities.
    M : list of lists of scalars
        Of the velocities, whose columns of M^-1 are those of the places.
    free : list of scalars
        Velocities without any impulse.
    start : Impulses
        What to begin with, and the answer where it has not missed.
    most : int
        Rounds at most.
    tolerance : scalar
        Change of an impulse that is of no interest [N s].
    """
    n, sizes = len(free), [place.size for place in places]
    ends = [sum(len(place.rows) for place in places[:k]) for k in range(len(places) + 1)]
    discs = [k for k, place in enumerate(places) if place.is_disc]
    moving = number(dot(free, [number(dot(row, free)) for row in M]))
    enough = (
        reduce(higher, sizes) * (_PLAIN * tolerance) * (_PLAIN * tolerance) + _ROUNDING * _ROUNDING * moving
    )

    def one(v: Vector, way: Vector, p: Vector, search: Vector, *_: Any) -> tuple[Any, Any]:
        slope, share, low, high, rounded, sure, count = search
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
        smaller = choose(known, _FINE, higher(_LESS * rounded, _LEAST))
        search = [
            choose(moves, 0.0, choose(goes, fall, slope)),
            choose(moves, 0.0, choose(goes, 1.0, between)),
            choose(goes, 0.0, low),
            choose(goes, 1.0, high),
            choose(moves, smaller, rounded),
            choose(moves, choose(known, 1.0, 0.0), sure),
            count + 1.0,
        ]
        way = [choose(moves, 0.0, choose(goes, x, y)) for x, y in zip(next_way, way, strict=True)]
        v = [choose(goes, x, y) for x, y in zip(at, v, strict=True)]
        return (v, way, impulses, search, velocity, multipliers, choose(done, 0.0, 1.0)), done

    search, own = [0.0] * 4 + [_ROUNDED, 0.0, start.rounds], [start.multipliers[k] for k in discs]
    first = start.velocity, [0.0] * n, start.impulses, search, start.velocity, own, start.missed
    _, _, pushed, search, velocity, own, missed = iterated(one, first, most, start.missed < 0.5)
    multipliers = list(start.multipliers)
    for k, x in zip(discs, own, strict=True):
        multipliers[k] = x
    return Impulses(velocity, pushed, multipliers, search[-1], missed)
