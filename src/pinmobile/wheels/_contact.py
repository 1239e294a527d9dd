"""Impulses of dry friction between wheels and ground: a convex problem, solved wheel by wheel.

All functions take scalars: numbers, arrays with leading axes, or symbols. The impulses p minimise p' G p / 2
+ p' s within their bounds, where s is the slip without them and G = A M^-1 A' + D / h. At the minimum,
sticking wheels do not slip, and the force on a sliding wheel opposes its slip (Moreau and Jean; Acary and
Brogliato, Numerical methods for nonsmooth dynamical systems, Springer 2008).

Block Gauss-Seidel updates the velocities with the impulses. A block contains the impulses of a wheel along
and across it, and the one that holds its rate; the others stay constant. A block is solved exactly, except
for the multiplier of a friction disc, for which Newton's method takes one step per iteration. If this
converges slowly, for instance where wheels share a force of which only the sum is determined and some of them
slide, `newton_impulses` continues.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

from pinmobile.compiled import choose, repeat, scalar_max, square_root
from pinmobile.robot import ONE, ZERO, Matrix, Vector, dot, factor, number

_SOON = 24  # Gauss-Seidel iterations before Newton's method
_FIRST_SMOOTHING = 0.1  # initial smoothing of friction, relative to the slip per impulse of the wheel
_SMOOTHING_RATIO = 0.3  # factor of the smoothing after each convergence
_MIN_SMOOTHING = 1e-8  # smallest smoothing
_FINE = 1e-2  # smoothing of the final solution; below it, rounding errors affect the impulses
_LEVEL = 0.3  # largest slope at the end of a line search, relative to its start
_SHORTEST = 1e-9  # smallest fraction of a Newton step
_VELOCITY_WEIGHT = 0.1  # tolerance of velocities, relative to the error of impulses
_ROUNDING = 1e-13  # relative rounding error of the velocities
_NEWTON_FACTOR = 100.0  # tolerance of Newton's method, in tolerances of Gauss-Seidel


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
    spin_column : list of scalars
        Velocity per angular impulse on this rate.
    is_disc : bool
        Whether friction is isotropic; otherwise each direction has its own bound.
    give : scalar
        Slip velocity per impulse before the wheel slides [1/kg].
    is_held : bool
        Whether dry friction holds the wheel's rate.
    """

    rows: Sequence[Vector]
    columns: Sequence[Vector]
    spin: int
    spin_column: Vector
    is_disc: bool
    give: Any
    is_held: bool

    @cached_property
    def delassus(self) -> Pair:
        """Slip per impulse (Delassus matrix), without `give`."""
        (first, second), (x, y) = self.rows, self.columns
        return Pair(number(dot(first, x)), number(dot(first, y)), number(dot(second, y)))

    @cached_property
    def by_spin(self) -> Vector:
        """Slip per angular impulse."""
        return [number(dot(row, self.spin_column)) for row in self.rows]

    @cached_property
    def delassus_locked(self) -> Pair:
        """Slip per impulse for a fixed rate of the wheel."""
        (a, b, c), (x, y) = self.delassus, self.by_spin
        share = 1.0 / self.spin_column[self.spin]
        return Pair(a - x * x * share, b - x * y * share, c - y * y * share)

    @cached_property
    def free(self) -> _Block:
        """Solver of the block for a turning wheel."""
        return self._block(self.delassus)

    @cached_property
    def locked(self) -> _Block:
        """Solver of the block for a wheel with a fixed rate."""
        return self._block(self.delassus_locked)

    def _block(self, delassus: Pair) -> _Block:
        stiff = Pair(delassus.a + self.give, delassus.b, delassus.c + self.give)
        return _Disc.of(stiff) if self.is_disc else _Rectangle.of(stiff)

    def solve(
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
        if not self.is_held:
            impulse, shift = self.free.solve(self._right_side(self.delassus, p, slip), bounds, shift)
            return self._velocities(v, p, impulse, ZERO), impulse, spin, shift
        share = 1.0 / self.spin_column[self.spin]
        stop = v[self.spin] * share
        y = [s - x * stop for s, x in zip(slip, self.by_spin, strict=True)]
        locked, shift_0 = self.locked.solve(self._right_side(self.delassus_locked, p, y), bounds, shift)
        step = dot(self.by_spin, [a - b for a, b in zip(locked, p, strict=True)]) * share
        hold = spin - stop - step
        holds = abs(hold) <= bounds.spin
        limit = choose(hold > 0.0, bounds.spin, -bounds.spin)
        y = [s + x * (limit - spin) for s, x in zip(slip, self.by_spin, strict=True)]
        turning, shift_1 = self.free.solve(self._right_side(self.delassus, p, y), bounds, shift)
        impulse = [choose(holds, a, b) for a, b in zip(locked, turning, strict=True)]
        new = choose(holds, hold, limit)
        return self._velocities(v, p, impulse, new - spin), impulse, new, choose(holds, shift_0, shift_1)

    def place(self, bounds: Bounds) -> FrictionConstraint:
        """Return the constraint of its slip."""
        bounds_xy = [bounds.along, bounds.across]
        return FrictionConstraint(self.rows, self.columns, bounds_xy, self.is_disc, bounds.began, self.give)

    def holds(self, bounds: Bounds) -> FrictionConstraint:
        """Return the constraint of its rate."""
        row = [ONE if k == self.spin else ZERO for k in range(len(self.spin_column))]
        return FrictionConstraint([row], [self.spin_column], [bounds.spin], False, [0.0], 0.0)

    def _right_side(self, delassus: Pair, p: Vector, slip: Vector) -> Vector:
        """Return own p - slip: the product of the Delassus matrix and the impulses that stop the slip."""
        return [a - s for a, s in zip(delassus.times(p), slip, strict=True)]

    def _velocities(self, v: Vector, p: Vector, new: Vector, spin: Any) -> Vector:
        """Return the velocities after a change of the impulses."""
        changes = [*(a - b for a, b in zip(new, p, strict=True)), spin]
        columns = zip(*self.columns, self.spin_column, strict=True)
        return [number(x + dot(row, changes)) for x, row in zip(v, columns, strict=True)]


class _Disc(NamedTuple):
    """Block with impulses in a disc: eigenvalues of its matrix, and cosine and sine of its axes."""

    c: Any
    s: Any
    first: Any
    second: Any

    @classmethod
    def of(cls, block: Pair) -> _Disc:
        """Return the block of a matrix, by Jacobi's rotation."""
        half = 0.5 * (block.a - block.c)
        long = square_root(half * half + block.b * block.b)
        bottom = choose(half < 0.0, half - long, half + long)
        t = choose(long > 0.0, block.b / choose(long > 0.0, bottom, 1.0), 0.0)
        c = 1.0 / square_root(1.0 + t * t)
        return cls(c, t * c, block.a + t * block.b, block.c - t * block.b)

    def solve(self, y: Vector, bounds: Bounds, shift: Any) -> tuple[Vector, Any]:
        """Return the impulse p with (B + mu) p = y, and mu: 0 inside the disc, an improved value on its edge.

        It takes a Newton step for the norm of p, in the form 1 / norm = 1 / radius (More and Sorensen, SIAM
        J. Sci. Stat. Comput. 4, 1983).
        """
        c, s, radius = self.c, self.s, bounds.along
        y1, y2 = c * y[0] + s * y[1], c * y[1] - s * y[0]
        a1, a2 = y1 * (1.0 / self.first), y2 * (1.0 / self.second)
        sticks = a1 * a1 + a2 * a2 <= radius * radius
        l1, l2 = self.first + shift, self.second + shift
        share = 1.0 / (l1 * l2)
        p1, p2 = y1 * (l2 * share), y2 * (l1 * share)
        q1, q2 = p1 * p1, p2 * p2
        square = q1 + q2
        slope = (q1 * l2 + q2 * l1) * share
        size = square_root(square)
        bottom = size * slope * radius
        given = bottom > 0.0
        inverse = 1.0 / choose(given, bottom, 1.0)
        scale = choose(given, radius * radius * slope * inverse, 0.0)
        better = scalar_max(shift + square * (size - radius) * size * inverse, 0.0)
        p1, p2 = choose(sticks, a1, p1 * scale), choose(sticks, a2, p2 * scale)
        return [c * p1 - s * p2, s * p1 + c * p2], choose(sticks, 0.0, choose(given, better, 0.0))


class _Rectangle(NamedTuple):
    """Block with separate bounds along and across: its matrix, and inverses of its entries."""

    delassus: Pair
    first: Any
    second: Any
    direct: Any

    @classmethod
    def of(cls, block: Pair) -> _Rectangle:
        """Return the block of a matrix."""
        second = 1.0 / block.c
        return cls(block, 1.0 / block.a, second, 1.0 / (block.a - block.b * block.b * second))

    def solve(self, y: Vector, bounds: Bounds, shift: Any) -> tuple[Vector, Any]:
        """Return the impulses, and the unchanged multiplier."""
        block = self.delassus
        free = within((y[0] - block.b * self.second * y[1]) * self.direct, bounds.along)
        free_2 = (y[1] - block.b * free) * self.second
        across = within(free_2, bounds.across)
        along = within((y[0] - block.b * across) * self.first, bounds.along)
        sticks = abs(free_2) <= bounds.across
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
    touches: list[WheelContact], bounds: list[Bounds], free: Vector, M: Matrix, guess: Impulses, ground: Any
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
    guess : Impulses
        Initial guess.
    ground : Coulomb
        Ground with `sweeps` and `tolerance`.
    """
    holder = {touch.spin: touch for touch in touches if touch.is_held}
    spins = list(holder)
    most_of = [x for bound in bounds for x in (bound.along, bound.across)]
    for spin in spins:
        most_of.append(next(b.spin for t, b in zip(touches, bounds, strict=True) if t.spin == spin))
    p_0 = list(map(within, guess.impulses, most_of))  # the earlier impulses, clipped to the present bounds
    velocity, m = list(free), 2 * len(touches)
    for k, touch in enumerate(touches):
        velocity = touch._velocities(velocity, [ZERO, ZERO], p_0[2 * k : 2 * k + 2], ZERO)
    velocity = moved_by(velocity, [holder[spin].spin_column for spin in spins], p_0[m:])
    tolerance = ground.tolerance * reduce(scalar_max, [bound.along for bound in bounds])

    sweeps = min(ground.sweeps, _SOON)

    def sweep(v: Vector, p: Vector, holding: Vector, shifts: Vector, _: Any) -> tuple[Any, Any]:
        old_p, p, holding, shifts = p, list(p), list(holding), list(shifts)
        for k, (touch, bound) in enumerate(zip(touches, bounds, strict=True)):
            index = spins.index(touch.spin) if touch.is_held else 0
            old = p[2 * k : 2 * k + 2]
            spin_p = holding[index] if holding else 0.0
            v, p[2 * k : 2 * k + 2], new_spin, shifts[k] = touch.solve(v, old, spin_p, shifts[k], bound)
            if touch.is_held:
                holding[index] = new_spin
        change: Any = 0.0
        for x, y in zip(p, old_p, strict=True):
            change = scalar_max(abs(x - y), change)
        is_done = change <= tolerance
        return (v, p, holding, shifts, choose(is_done, 0.0, 1.0)), is_done

    first = velocity, p_0[:m], p_0[m:], list(guess.multipliers), 1.0
    velocity, p, holding, *rest = iterate(sweep, first, sweeps)
    start = Impulses(velocity, [*p, *holding], *rest)
    if ground.sweeps > sweeps:
        places = [touch.place(bound) for touch, bound in zip(touches, bounds, strict=True)]
        places += [holder[spin].holds(bounds[touches.index(holder[spin])]) for spin in spins]
        return newton_impulses(places, M, free, start, ground.sweeps - sweeps, tolerance)
    return start


def iterate(
    function: Callable[..., tuple[Sequence[Any], Any]], first: Sequence[Any], count: int, is_done: Any = False
) -> tuple[Any, ...]:
    """Return scalars and lists of scalars after iterations of a function, see `repeat`.

    Parameters
    ----------
    function : callable
        ``one(*parts)`` returns the parts after an iteration, and whether they have converged.
    first : sequence of scalars and lists of scalars
        Initial parts.
    count, is_done
        As in `repeat`.
    """

    def flat(parts: Sequence[Any]) -> Vector:
        return [number(x) for part in parts for x in (part if isinstance(part, list) else (part,))]

    def unflatten(numbers: Vector) -> tuple[Any, ...]:
        rest = iter(numbers)
        return tuple([next(rest) for _ in x] if isinstance(x, list) else next(rest) for x in first)

    def law(numbers: Vector) -> tuple[Vector, Any]:
        values, stops = function(*unflatten(numbers))
        return flat(values), stops

    return unflatten(repeat(law, flat(first), count, is_done))


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
        diagonal = [number(dot(row, column)) for row, column in zip(self.rows, self.columns, strict=True)]
        return sum(diagonal[1:], diagonal[0]) * (1.0 / len(diagonal))

    def response(self, v: Vector, old_p: Vector, smoothing: Any) -> _Response:
        """Return the impulse at given velocities, and its derivative.

        Parameters
        ----------
        v, old_p : lists of scalars
            Velocities, and the impulse before.
        smoothing : scalar
            Smoothing of friction: slip per impulse.
        """
        slip = [began + dot(row, v) for row, began in zip(self.rows, self.began, strict=True)]
        share = 1.0 / (smoothing + self.give)
        z = [(smoothing * p - s) * share for p, s in zip(old_p, slip, strict=True)]
        if not self.is_disc:
            impulse = list(map(within, z, self.bounds))
            slopes = [choose(abs(x) <= bound, share, 0.0) for x, bound in zip(z, self.bounds, strict=True)]
            return _Response(impulse, slopes, None, 0.0)
        radius = self.bounds[0]
        square = z[0] * z[0] + z[1] * z[1]
        sticks = square <= radius * radius
        inverse = 1.0 / choose(sticks, 1.0, square)
        scale = choose(sticks, 1.0, radius * square_root(inverse))
        impulse = [scale * x for x in z]
        factor = choose(sticks, 0.0, scale * share)
        slides = choose(radius > 0.0, dot(slip, impulse) / choose(radius > 0.0, radius * radius, 1.0), 0.0)
        multiplier = choose(sticks, 0.0, scalar_max(-slides - self.give, 0.0))
        return _Response(impulse, [scale * share] * 2, [*z, factor * inverse], multiplier)


class _Response(NamedTuple):
    """Impulse, and its derivative by the slip, -(diag(bent) - c (x, y) (x, y)')."""

    impulse: Vector
    slopes: Vector
    outer: Vector | None
    multiplier: Any

    def add(self, place: FrictionConstraint, H: Matrix, g: Vector) -> None:
        """Add the contribution of the constraint to Hessian and gradient."""
        terms = list(zip(place.rows, self.slopes, strict=True))
        if self.outer is not None:
            x, y, c = self.outer
            terms.append(([x * a + y * b for a, b in zip(*place.rows, strict=True)], -c))
        for p, row in zip(self.impulse, place.rows, strict=True):
            for i, x in enumerate(row):
                g[i] = g[i] - x * p
        for row, weight in terms:
            heavy = [x * weight for x in row]
            for i, x in enumerate(row):
                for j in range(i + 1):
                    H[i][j] = H[j][i] = H[i][j] + x * heavy[j]


def newton_impulses(
    places: list[FrictionConstraint], M: Matrix, free: Vector, start: Impulses, count: int, tolerance: Any
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
    count : int
        Largest number of iterations.
    tolerance : scalar
        Tolerance of impulses [N s].
    """
    n, sizes = len(free), [place.size for place in places]
    ends = [sum(len(place.rows) for place in places[:k]) for k in range(len(places) + 1)]
    discs = [k for k, place in enumerate(places) if place.is_disc]
    moving = number(dot(free, [number(dot(row, free)) for row in M]))
    precision = _NEWTON_FACTOR * tolerance
    target = reduce(scalar_max, sizes) * precision * precision + _ROUNDING * _ROUNDING * moving

    def newton_step(v: Vector, way: Vector, p: Vector, search: Vector, *_: Any) -> tuple[Any, Any]:
        slope, share, low, high, smoothing, is_certain = search
        trial = [x + share * y for x, y in zip(v, way, strict=True)]
        H = [list(row) for row in M]
        change = [x - y for x, y in zip(trial, free, strict=True)]
        g = [number(dot(row, change)) for row in M]
        new_p: Vector = []
        multipliers, error = [], ZERO
        for place, size, first, last in zip(places, sizes, ends, ends[1:], strict=False):
            local = place.response(trial, p[first:last], smoothing * size)
            local.add(place, H, g)
            new_p += local.impulse
            if place.is_disc:
                multipliers.append(local.multiplier)
            for x, y in zip(local.impulse, p[first:last], strict=True):
                error = error + size * ((x - y) * (x - y))
        error = number(error) * smoothing
        curve = number(dot(way, [number(dot(row, way)) for row in H]))
        next_way = [-number(x) for x in factor(H)[0](g)]
        fall, uphill = number(dot(g, next_way)), number(dot(g, way))
        rises = uphill > 0.0
        level = abs(uphill) <= -_LEVEL * slope
        goes = level | ((share >= 1.0) & (uphill <= 0.0)) | (share < _SHORTEST)
        little = target * choose(smoothing >= _FINE, smoothing * smoothing, 1.0)
        moves = goes & ((-fall <= _VELOCITY_WEIGHT * _VELOCITY_WEIGHT * error) | (-fall <= little))
        converges = moves & (error * smoothing <= target) & (-fall <= little)
        is_done = converges & (smoothing >= _FINE) & (is_certain > 0.0)
        low, high = choose(rises, low, share), choose(rises, share, high)
        level_at = share - uphill / choose(curve > 0.0, curve, 1.0)
        middle = choose((level_at > low) & (level_at < high), level_at, 0.5 * (low + high))
        impulses = [choose(moves, x, y) for x, y in zip(new_p, p, strict=True)]
        velocity = moved_by(free, (column for place in places for column in place.columns), impulses)
        smaller = choose(converges, _FINE, scalar_max(_SMOOTHING_RATIO * smoothing, _MIN_SMOOTHING))
        search = [
            choose(moves, 0.0, choose(goes, fall, slope)),
            choose(moves, 0.0, choose(goes, 1.0, middle)),
            choose(goes, 0.0, low),
            choose(goes, 1.0, high),
            choose(moves, smaller, smoothing),
            choose(moves, choose(converges, 1.0, 0.0), is_certain),
        ]
        way = [choose(moves, 0.0, choose(goes, x, y)) for x, y in zip(next_way, way, strict=True)]
        v = [choose(goes, x, y) for x, y in zip(trial, v, strict=True)]
        return (v, way, impulses, search, velocity, multipliers, choose(is_done, 0.0, 1.0)), is_done

    search, shifts = [0.0] * 4 + [_FIRST_SMOOTHING, 0.0], [start.multipliers[k] for k in discs]
    first = start.velocity, [0.0] * n, start.impulses, search, start.velocity, shifts, start.missed
    _, _, values, _, velocity, shifts, missed = iterate(newton_step, first, count, start.missed < 0.5)
    multipliers = list(start.multipliers)
    for k, x in zip(discs, shifts, strict=True):
        multipliers[k] = x
    return Impulses(velocity, values, multipliers, missed)
