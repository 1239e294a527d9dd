"""Recursions over a linkage: kinematics, inverse and forward dynamics, and the mass matrix.

They are Featherstone's (2008), over scalars of any kind: see `linkage`. Vectors are in each joint's frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from pinmobile.robot.linkage import (
    ENTRIES,
    ONE,
    ZERO,
    Body,
    Exact,
    Linkage,
    Matrix,
    Place,
    Vector,
    added,
    applied,
    cross,
    dot,
    exact,
    plus,
    product,
    scaled,
    sine_and_cosine,
    skew,
    solved,
    symmetric,
    transposed,
    turned,
)


class Posture:
    """A linkage at a configuration.

    Parameters
    ----------
    linkage : Linkage
        The tree.
    places : sequence of Place
        Of each joint's frame in that of the joint it hangs on, at zero.
    q : list of scalars
        Configuration.
    """

    def __init__(self, linkage: Linkage, places: Sequence[Place], q: Vector) -> None:
        self.linkage, self.R = linkage, [place.R for place in places]
        self.back = [transposed(R) for R in self.R]
        self.angles: list[tuple[Any, Any] | None] = []  # sine and cosine of those that turn
        self.p: list[Vector] = []  # origins
        for i, (R, p) in enumerate(places):
            self.angles.append(sine_and_cosine(q[i]) if linkage.turns[i] else None)
            self.p.append(p if linkage.turns[i] else plus(p, [row[2] * q[i] for row in R]))

    def down(self, i: int, x: Vector) -> Vector:
        """Return a vector of the parent's frame in that of joint i."""
        x, angle = applied(self.back[i], x), self.angles[i]
        if angle is None:
            return x
        s, c = angle
        return [c * x[0] + s * x[1], c * x[1] - s * x[0], x[2]]

    def up(self, i: int, x: Vector) -> Vector:
        """Return a vector of the frame of joint i in the parent's."""
        angle = self.angles[i]
        if angle is not None:
            s, c = angle
            x = [c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]]
        return applied(self.R[i], x)

    def up_symmetric(self, i: int, J: Matrix) -> Matrix:
        """Return a symmetric matrix of the frame of joint i in the parent's."""
        angle = self.angles[i]
        if angle is not None:
            s, c = angle
            xy, d = J[0][1], s * (J[0][0] - J[1][1])
            twice = c * xy
            grown = s * (d + (twice + twice))
            J = symmetric(
                [
                    J[0][0] - grown,
                    J[1][1] + grown,
                    J[2][2],
                    c * d + xy * (c * c - s * s),
                    c * J[0][2] - s * J[1][2],
                    s * J[0][2] + c * J[1][2],
                ]
            )
        return turned(self.R[i], J)

    def up_matrix(self, i: int, B: Matrix) -> Matrix:
        """Return any matrix of the frame of joint i in the parent's."""
        columns = [self.up(i, column) for column in transposed(B)]
        return [self.up(i, row) for row in transposed(columns)]

    def ancestors(self, i: int) -> list[int]:
        """Return joint i and those it hangs on, up to the root."""
        found = []
        while i >= 0:
            found.append(i)
            i = self.linkage.parents[i]
        return found

    def placed(self, i: int, place: Place) -> Place:
        """Return where a frame that is fixed to joint i stands in the world."""
        columns, p = transposed(place.R), place.p
        for j in self.ancestors(i):
            columns, p = [self.up(j, x) for x in columns], plus(self.p[j], self.up(j, p))
        return Place(transposed(columns), p)

    def jacobian(self, i: int, p: Vector) -> Matrix:
        """Return the velocity of a point that is fixed to joint i, and the angular velocity, 6 rows of n."""
        columns, ancestors, z = [[ZERO] * 6 for _ in self.R], self.ancestors(i), [ZERO, ZERO, ONE]
        for at, j in enumerate(ancestors):
            way, turn = ([-p[1], p[0], ZERO], z) if self.linkage.turns[j] else (z, [ZERO] * 3)
            for above in ancestors[at:]:
                way, turn = self.up(above, way), self.up(above, turn)
            columns[j] = [*way, *turn]
            p = plus(self.p[j], self.up(j, p))
        return transposed(columns)

    def first_moment(self, bodies: Sequence[Body]) -> Vector:
        """Return mass times centre of mass of all, in the world."""
        masses, moments = [body.mass for body in bodies], [body.first for body in bodies]
        whole = [ZERO] * 3
        for i in reversed(range(len(self.R))):
            moved = plus(self.up(i, moments[i]), scaled(masses[i], self.p[i]))
            above = self.linkage.parents[i]
            if above >= 0:
                masses[above], moments[above] = masses[above] + masses[i], plus(moments[above], moved)
            else:
                whole = plus(whole, moved)
        return whole

    def mass_matrix(self, bodies: Sequence[Body]) -> Matrix:
        """Return M, in the order of the joints, by composite rigid bodies."""
        linkage, n = self.linkage, len(self.R)
        whole, M = list(bodies), [[ZERO] * n for _ in range(n)]
        for i in reversed(range(n)):
            m, h, J = whole[i]
            if linkage.turns[i]:
                force, moment = [-h[1], h[0], ZERO], [row[2] for row in J]
            else:
                force, moment = [ZERO, ZERO, m], [h[1], -h[0], ZERO]
            for j in self.ancestors(i):
                M[i][j] = M[j][i] = moment[2] if linkage.turns[j] else force[2]
                if linkage.parents[j] >= 0:
                    force = self.up(j, force)
                    moment = plus(self.up(j, moment), cross(self.p[j], force))
            above = linkage.parents[i]
            if above >= 0:
                up = Body(m, self.up(i, h), self.up_symmetric(i, J))
                whole[above] = whole[above].joined(up.moved(self.p[i]))
        return M


class Moving(Posture):
    """A linkage at a configuration and a velocity."""

    def __init__(self, linkage: Linkage, places: Sequence[Place], q: Vector, v: Vector) -> None:
        super().__init__(linkage, places, q)
        self.v = v
        self.w: list[Vector] = []  # angular velocities
        for i, above in enumerate(linkage.parents):
            w = self.down(i, self.w[above]) if above >= 0 else [ZERO] * 3
            self.w.append([w[0], w[1], w[2] + self.v[i]] if linkage.turns[i] else w)

    def efforts(self, bodies: Sequence[Body], a: Vector, falling: bool = True) -> Vector:
        """Return forces and torques of the joints, of accelerations in their order, by Newton and Euler.

        Where nothing falls, gravity is left out.
        """
        wrenches = zip(*self.wrenches(bodies, a, falling), self.linkage.turns, strict=True)
        return [moment[2] if turns else force[2] for force, moment, turns in wrenches]

    def wrenches(
        self, bodies: Sequence[Body], a: Vector, falling: bool = True
    ) -> tuple[list[Vector], list[Vector]]:
        """Return what each joint exerts on all that hangs on it: force, and moment about its origin."""
        forces, moments = self._inertial(bodies, a, falling)
        for i in reversed(range(len(self.R))):
            above = self.linkage.parents[i]
            if above >= 0:
                force = self.up(i, forces[i])
                moment = plus(self.up(i, moments[i]), cross(self.p[i], force))
                forces[above], moments[above] = plus(forces[above], force), plus(moments[above], moment)
        return forces, moments

    def _inertial(
        self, bodies: Sequence[Body], a: Vector, falling: bool
    ) -> tuple[list[Vector], list[Vector]]:
        """Return what moves each body alone: force, and moment about the origin of its frame."""
        forces, moments = [], []
        for (m, h, J), w, (line, spin, field) in zip(bodies, self.w, self._driven(a, falling), strict=True):
            forces.append(plus(scaled(m, line), applied(field, h)))
            turning = plus(applied(J, spin), cross(w, applied(J, w)))
            moments.append(plus(turning, cross(h, line)))
        return forces, moments

    def _driven(self, a: Vector, falling: bool) -> list[tuple[Vector, Vector, Matrix]]:
        """Return each joint's accelerations: of its origin, less gravity, angular, and the field.

        The field is the acceleration of a point fixed to it, less that of its origin, over its place.
        """
        linkage = self.linkage
        found: list[tuple[Vector, Vector, Matrix]] = []
        for i, above in enumerate(linkage.parents):
            if above < 0:
                spin = [ZERO] * 3
                line = [exact(-g) for g in linkage.gravity.tolist()] if falling else [ZERO] * 3
            else:
                line, spin, field = found[above]
                line = plus(line, applied(field, self.p[i]))
            spin, line = self.down(i, spin), self.down(i, line)
            w, rate = self.w[i], self.v[i]
            if linkage.turns[i]:
                spin = [spin[0] + w[1] * rate, spin[1] - w[0] * rate, spin[2] + a[i]]
            else:
                twice = rate + rate
                line = [line[0] + w[1] * twice, line[1] - w[0] * twice, line[2] + a[i]]
            found.append((line, spin, _field(w, spin)))
        return found

    def drift(self, i: int, p: Vector) -> tuple[Vector, Vector]:
        """Return the accelerations of a point fixed to joint i, and its frame, that velocities alone make."""
        line, spin, field = self._driven([ZERO] * len(self.R), False)[i]
        line = plus(line, applied(field, p))
        for j in self.ancestors(i):
            line, spin = self.up(j, line), self.up(j, spin)
        return line, spin

    def regressor(self, axes: Sequence[Matrix], first: int, a: Vector) -> list[Vector]:
        """Return what efforts are over the ten numbers of each body, from that of joint `first` on.

        Those are m, m c, and xx, xy, yy, xz, yz, zz of the inertia about the origin of the joint's frame,
        along axes in which that frame has the orientations `axes`.
        """
        linkage, n = self.linkage, len(self.R)
        found = [[ZERO] * (10 * (n - first)) for _ in range(n)]
        driven = self._driven(a, True)
        ways: list[dict[int, tuple[Vector, Vector]]] = []  # how joint j moves the frame of joint i
        for i, above in enumerate(linkage.parents):
            moved = {
                i: ([ZERO] * 3, [ZERO, ZERO, ONE]) if linkage.turns[i] else ([ZERO, ZERO, ONE], [ZERO] * 3)
            }
            for j, (line, turn) in (ways[above] if above >= 0 else {}).items():
                moved[j] = self.down(i, plus(line, cross(turn, self.p[i]))), self.down(i, turn)
            ways.append(moved)
            if i >= first:
                w, line, spin = (applied(axes[i], x) for x in (self.w[i], *driven[i][:2]))
                field = transposed(_field(w, spin))
                for j, way in moved.items():
                    by, turn = (applied(axes[i], x) for x in way)
                    numbers = [dot(by, line), *plus(applied(field, by), cross(line, turn))]
                    felt = zip((turn, cross(turn, w)), (spin, w), strict=True)
                    squares = [[[x * y for y in right] for x in left] for left, right in felt]
                    Q = added(*squares)
                    numbers += [Q[0][0], Q[0][1] + Q[1][0], Q[1][1]]
                    numbers += [Q[0][2] + Q[2][0], Q[1][2] + Q[2][1], Q[2][2]]
                    found[j][10 * (i - first) : 10 * (i - first) + 10] = numbers
        return found

    def accelerations(self, bodies: Sequence[Body], rotors: Vector, efforts: Vector) -> Vector:
        """Return the accelerations of the joints, all in their order, by articulated bodies.

        Accelerations are those of points of the bodies, not spatial ones, which saves products.
        """
        linkage, n = self.linkage, len(self.R)
        pieces = [_Articulated.of(body, w) for body, w in zip(bodies, self.w, strict=True)]
        drifts = [self._drift(i) for i in range(n)]
        ways: list[_Way] = []
        for i in reversed(range(n)):
            way = pieces[i].along(linkage.turns[i], rotors[i], efforts[i])
            ways.append(way)
            above = linkage.parents[i]
            if above >= 0:
                free = (5 if linkage.turns[i] else 2) if rotors[i] is ZERO else None
                rest = pieces[i].without(way, *drifts[i], free)
                pieces[above] = pieces[above].joined(rest.up(self, i))
        ways.reverse()
        found: Vector = []
        lines: list[Vector] = []
        spins: list[Vector] = []
        for i, above in enumerate(linkage.parents):
            if above < 0:
                line, spin = [exact(-g) for g in linkage.gravity.tolist()], [ZERO] * 3
            else:
                spin = spins[above]
                line = plus(lines[above], cross(spin, self.p[i]))
            line, spin = (
                plus(self.down(i, x), extra) for x, extra in zip((line, spin), drifts[i], strict=True)
            )
            force, moment, inverse, left = ways[i]
            a = (left - dot(force, line) - dot(moment, spin)) * inverse
            found.append(a)
            if linkage.turns[i]:
                spin = [spin[0], spin[1], spin[2] + a]
            else:
                line = [line[0], line[1], line[2] + a]
            lines.append(line)
            spins.append(spin)
        return found

    def _drift(self, i: int) -> tuple[Vector, Vector]:
        """Return the accelerations that a joint has from velocities: of its origin, and angular."""
        above, w, rate = self.linkage.parents[i], self.w[i], self.v[i]
        line = [ZERO] * 3
        if above >= 0:
            line = self.down(i, cross(self.w[above], cross(self.w[above], self.p[i])))
        if self.linkage.turns[i]:
            return line, [w[1] * rate, -(w[0] * rate), ZERO]
        twice = rate + rate
        return [line[0] + w[1] * twice, line[1] - w[0] * twice, line[2]], [ZERO] * 3


def _field(w: Vector, spin: Vector) -> Matrix:
    """Return [spin x] + [w x]^2."""
    xx, yy, zz = (x * x for x in w)
    xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
    return [
        [-(yy + zz), xy - spin[2], xz + spin[1]],
        [xy + spin[2], -(xx + zz), yz - spin[0]],
        [xz - spin[1], yz + spin[0], -(xx + yy)],
    ]


class _Way(NamedTuple):
    """What a joint's own coordinate feels: force and moment of a unit, 1 / inertia, and effort left."""

    force: Vector
    moment: Vector
    inverse: Any
    left: Any


class _Articulated(NamedTuple):
    """An articulated body: force = A line + B spin + f, moment = B' line + C spin + m."""

    A: Matrix
    B: Matrix
    C: Matrix
    force: Vector
    moment: Vector

    @classmethod
    def of(cls, body: Body, w: Vector) -> _Articulated:
        m, h, J = body
        A = [[m if r == c else ZERO for c in range(3)] for r in range(3)]
        return cls(A, skew([-x for x in h]), J, cross(w, cross(w, h)), cross(w, applied(J, w)))

    def along(self, turns: bool, rotor: Any, effort: Any) -> _Way:
        if turns:
            force, moment = [row[2] for row in self.B], [row[2] for row in self.C]
            return _Way(force, moment, 1.0 / (moment[2] + rotor), effort - self.moment[2])
        force, moment = [row[2] for row in self.A], list(self.B[2])
        return _Way(force, moment, 1.0 / (force[2] + rotor), effort - self.force[2])

    def without(self, way: _Way, line: Vector, spin: Vector, free: int | None) -> _Articulated:
        """Return what is left where the joint gives way; `line` and `spin` are what velocities make.

        Of the six directions, nothing is left along `free`, that of a joint without rotor.
        """
        unit = [*way.force, *way.moment]
        share = scaled(way.inverse, unit)

        def left(r: int, c: int, value: Any) -> Any:
            return ZERO if free in (r, c) else value - unit[r] * share[c]

        A, B, C = ([[ZERO] * 3 for _ in range(3)] for _ in range(3))
        for r, c in ENTRIES:
            A[r][c] = A[c][r] = left(r, c, self.A[r][c])
            C[r][c] = C[c][r] = left(3 + r, 3 + c, self.C[r][c])
        for r in range(3):
            B[r] = [left(r, 3 + c, self.B[r][c]) for c in range(3)]
        pushed = scaled(way.left, share)
        force = plus(plus(self.force, plus(applied(A, line), applied(B, spin))), pushed[:3])
        moment = plus(plus(self.moment, plus(applied(transposed(B), line), applied(C, spin))), pushed[3:])
        return _Articulated(A, B, C, force, moment)

    def joined(self, other: _Articulated) -> _Articulated:
        A, B, C = (added(a, b) for a, b in zip(self[:3], other[:3], strict=True))
        return _Articulated(A, B, C, plus(self.force, other.force), plus(self.moment, other.moment))

    def up(self, moving: Posture, i: int) -> _Articulated:
        """Return it at the origin of the parent's frame."""
        A, C, B = moving.up_symmetric(i, self.A), moving.up_symmetric(i, self.C), moving.up_matrix(i, self.B)
        P = skew(moving.p[i])
        pairs = zip(B, product(A, P), strict=True)
        moved = [[b - x for b, x in zip(*rows, strict=True)] for rows in pairs]
        right, left = product(P, moved), product(P, B)
        for r, c in ENTRIES:
            C[r][c] = C[c][r] = C[r][c] + right[r][c] + left[c][r]
        force = moving.up(i, self.force)
        moment = plus(moving.up(i, self.moment), cross(moving.p[i], force))
        return _Articulated(A, moved, C, force, moment)


def by_matrix(moving: Moving, bodies: Sequence[Body], rotors: Vector, efforts: Vector) -> Vector:
    """Return what `Moving.accelerations` does by the mass matrix, factored from the leaves of the tree."""
    n = len(efforts)
    still, M = moving.efforts(bodies, [ZERO] * n), moving.mass_matrix(bodies)
    for i, rotor in enumerate(rotors):
        M[i][i] = M[i][i] + rotor
    right = [effort - own for effort, own in zip(efforts, still, strict=True)]
    return solved(M, right, range(n - 1, -1, -1))


def operations(
    linkage: Linkage, places: Sequence[Place], bodies: Sequence[Body], rotors: Vector
) -> tuple[int, int]:
    """Return how many operations accelerations take: by articulated bodies, and by the mass matrix.

    What does not change with the state is not counted, as it is computed once. Equal operations are counted
    each time, of which both ways have few, so that no tape is needed.
    """
    count, by_mass_matrix = (
        _count(way, linkage, places, bodies, rotors) for way in (Moving.accelerations, by_matrix)
    )
    return count, by_mass_matrix


class _Counted:
    """A scalar that only counts what is done with it, where it is `late`, that is changes with the state."""

    __slots__ = ("late", "tally")

    def __init__(self, tally: list[int], late: bool) -> None:
        self.tally, self.late = tally, late

    def _with(self, other: Any) -> Any:
        if isinstance(other, Exact):
            return NotImplemented  # it knows better
        late = other if getattr(other, "late", False) else self
        self.tally[0] += late.late
        return late

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _with

    def __neg__(self) -> _Counted:
        return self

    def sine_and_cosine(self) -> tuple[_Counted, _Counted]:
        """Return it twice: both ways take as many sines."""
        return self, self


def _count(
    way: Callable[..., Vector],
    linkage: Linkage,
    places: Sequence[Place],
    bodies: Sequence[Body],
    rotors: Vector,
) -> int:
    tally, n = [0], len(linkage)
    early, late = _Counted(tally, False), _Counted(tally, True)

    def known(x: Any) -> Any:
        if isinstance(x, list | tuple):
            return [known(each) for each in x]
        return x if isinstance(x, Exact) else early

    at = [Place(*known(place)) for place in places]
    moving = Moving(linkage, at, [late] * n, [late] * n)
    way(moving, [Body(*known(body)) for body in bodies], known(rotors), [late] * n)
    return tally[0]
