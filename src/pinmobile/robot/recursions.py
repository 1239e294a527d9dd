"""Recursions over a linkage: kinematics, inverse and forward dynamics, and the mass matrix.

The algorithms follow Featherstone (2008), over scalars of any type, see `linkage`. Vectors are in the frame
of each joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pinmobile.robot.linkage import (
    ONE,
    ZERO,
    Body,
    Linkage,
    Matrix,
    Placement,
    Vector,
    add,
    applied,
    cross,
    dot,
    exact,
    factor,
    plus,
    rotate_tensor,
    scale,
    sine_and_cosine,
    symmetric,
    transpose,
)


class LinkageKinematics:
    """Linkage at a configuration.

    Parameters
    ----------
    linkage : Linkage
        Tree of joints.
    places : sequence of Placement
        Placement of each joint's frame in its parent's frame, for a zero coordinate.
    q : list of scalars
        Configuration.
    """

    def __init__(self, linkage: Linkage, places: Sequence[Placement], q: Vector) -> None:
        self.linkage, self.R = linkage, [place.R for place in places]
        self.back = [transpose(R) for R in self.R]
        self.angles: list[tuple[Any, Any] | None] = []  # sine and cosine for revolute joints
        self.p: list[Vector] = []  # origins
        for i, (R, p) in enumerate(places):
            self.angles.append(sine_and_cosine(q[i]) if linkage.turns[i] else None)
            self.p.append(p if linkage.turns[i] else plus(p, [row[2] * q[i] for row in R]))

    def to_child(self, i: int, x: Vector) -> Vector:
        """Return a vector of the parent's frame in the frame of joint i."""
        x, angle = applied(self.back[i], x), self.angles[i]
        if angle is None:
            return x
        s, c = angle
        return [c * x[0] + s * x[1], c * x[1] - s * x[0], x[2]]

    def to_parent(self, i: int, x: Vector) -> Vector:
        """Return a vector of the frame of joint i in the parent's frame."""
        angle = self.angles[i]
        if angle is not None:
            s, c = angle
            x = [c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]]
        return applied(self.R[i], x)

    def tensor_to_parent(self, i: int, J: Matrix) -> Matrix:
        """Return a symmetric matrix of the frame of joint i in the parent's frame."""
        angle = self.angles[i]
        if angle is not None:
            s, c = angle
            xy, d = J[0][1], s * (J[0][0] - J[1][1])
            two_xy = c * xy
            change = s * (d + (two_xy + two_xy))
            J = symmetric(
                [
                    J[0][0] - change,
                    J[1][1] + change,
                    J[2][2],
                    c * d + xy * (c * c - s * s),
                    c * J[0][2] - s * J[1][2],
                    s * J[0][2] + c * J[1][2],
                ]
            )
        return rotate_tensor(self.R[i], J)

    def ancestors(self, i: int) -> list[int]:
        """Return joint i and its ancestors, up to the root."""
        joints = []
        while i >= 0:
            joints.append(i)
            i = self.linkage.parents[i]
        return joints

    def placement(self, i: int, place: Placement) -> Placement:
        """Return the placement of a frame, fixed to joint i, in the world."""
        columns, p = transpose(place.R), place.p
        for j in self.ancestors(i):
            columns, p = [self.to_parent(j, x) for x in columns], plus(self.p[j], self.to_parent(j, p))
        return Placement(transpose(columns), p)

    def jacobian(self, i: int, p: Vector) -> Matrix:
        """Return the Jacobian of a point fixed to joint i: velocity and angular velocity, 6 rows of n."""
        columns, ancestors, z = [[ZERO] * 6 for _ in self.R], self.ancestors(i), [ZERO, ZERO, ONE]
        for k, j in enumerate(ancestors):
            way, turn = ([-p[1], p[0], ZERO], z) if self.linkage.turns[j] else (z, [ZERO] * 3)
            for parent in ancestors[k:]:
                way, turn = self.to_parent(parent, way), self.to_parent(parent, turn)
            columns[j] = [*way, *turn]
            p = plus(self.p[j], self.to_parent(j, p))
        return transpose(columns)

    def first_moment(self, bodies: Sequence[Body]) -> Vector:
        """Return mass times centre of mass of all bodies, in the world."""
        masses, moments = [body.mass for body in bodies], [body.first for body in bodies]
        total = [ZERO] * 3
        for i in reversed(range(len(self.R))):
            moment = plus(self.to_parent(i, moments[i]), scale(masses[i], self.p[i]))
            parent = self.linkage.parents[i]
            if parent >= 0:
                masses[parent], moments[parent] = masses[parent] + masses[i], plus(moments[parent], moment)
            else:
                total = plus(total, moment)
        return total

    def mass_matrix(self, bodies: Sequence[Body]) -> Matrix:
        """Return M, in the order of the joints, by the composite-rigid-body algorithm."""
        linkage, n = self.linkage, len(self.R)
        composite, M = list(bodies), [[ZERO] * n for _ in range(n)]
        for i in reversed(range(n)):
            m, h, J = composite[i]
            if linkage.turns[i]:
                force, moment = [-h[1], h[0], ZERO], [row[2] for row in J]
            else:
                force, moment = [ZERO, ZERO, m], [h[1], -h[0], ZERO]
            for j in self.ancestors(i):
                M[i][j] = M[j][i] = moment[2] if linkage.turns[j] else force[2]
                if linkage.parents[j] >= 0:
                    force = self.to_parent(j, force)
                    moment = plus(self.to_parent(j, moment), cross(self.p[j], force))
            parent = linkage.parents[i]
            if parent >= 0:
                body = Body(m, self.to_parent(i, h), self.tensor_to_parent(i, J))
                composite[parent] = composite[parent].merge(body.shift(self.p[i]))
        return M


class LinkageDynamics(LinkageKinematics):
    """A linkage at a configuration and a velocity."""

    def __init__(self, linkage: Linkage, places: Sequence[Placement], q: Vector, v: Vector) -> None:
        super().__init__(linkage, places, q)
        self.v = v
        self.w: list[Vector] = []  # angular velocities
        for i, parent in enumerate(linkage.parents):
            w = self.to_child(i, self.w[parent]) if parent >= 0 else [ZERO] * 3
            self.w.append([w[0], w[1], w[2] + self.v[i]] if linkage.turns[i] else w)

    def efforts(self, bodies: Sequence[Body], a: Vector, falling: bool = True) -> Vector:
        """Return forces and torques of the joints for given accelerations, by the Newton-Euler recursion.

        `falling` is whether gravity acts.
        """
        wrenches = zip(*self.wrenches(bodies, a, falling), self.linkage.turns, strict=True)
        return [moment[2] if turns else force[2] for force, moment, turns in wrenches]

    def wrenches(
        self, bodies: Sequence[Body], a: Vector, falling: bool = True
    ) -> tuple[list[Vector], list[Vector]]:
        """Return each joint's wrench on all bodies beyond: force, and moment about the joint's origin."""
        forces, moments = self._inertial(bodies, a, falling)
        for i in reversed(range(len(self.R))):
            parent = self.linkage.parents[i]
            if parent >= 0:
                force = self.to_parent(i, forces[i])
                moment = plus(self.to_parent(i, moments[i]), cross(self.p[i], force))
                forces[parent], moments[parent] = plus(forces[parent], force), plus(moments[parent], moment)
        return forces, moments

    def _inertial(
        self, bodies: Sequence[Body], a: Vector, falling: bool
    ) -> tuple[list[Vector], list[Vector]]:
        """Return the force that accelerates each body alone, and the moment about the origin of its frame."""
        forces, moments = [], []
        for (m, h, J), w, (line, spin, field) in zip(bodies, self.w, self._fields(a, falling), strict=True):
            forces.append(plus(scale(m, line), applied(field, h)))
            turning = plus(applied(J, spin), cross(w, applied(J, w)))
            moments.append(plus(turning, cross(h, line)))
        return forces, moments

    def _fields(self, a: Vector, falling: bool) -> list[tuple[Vector, Vector, Matrix]]:
        """Return each joint's proper acceleration of its origin, its angular acceleration, and its field.

        The field is the matrix that maps the position of a point on the joint to its acceleration relative to
        the origin.
        """
        linkage = self.linkage
        fields: list[tuple[Vector, Vector, Matrix]] = []
        for i, parent in enumerate(linkage.parents):
            if parent < 0:
                spin = [ZERO] * 3
                line = [exact(-g) for g in linkage.gravity.tolist()] if falling else [ZERO] * 3
            else:
                line, spin, field = fields[parent]
                line = plus(line, applied(field, self.p[i]))
            spin, line = self.to_child(i, spin), self.to_child(i, line)
            w, rate = self.w[i], self.v[i]
            if linkage.turns[i]:
                spin = [spin[0] + w[1] * rate, spin[1] - w[0] * rate, spin[2] + a[i]]
            else:
                double = rate + rate
                line = [line[0] + w[1] * double, line[1] - w[0] * double, line[2] + a[i]]
            fields.append((line, spin, _field(w, spin)))
        return fields

    def drift(self, i: int, p: Vector) -> tuple[Vector, Vector]:
        """Return the bias acceleration of a point fixed to joint i, and of its frame."""
        line, spin, field = self._fields([ZERO] * len(self.R), False)[i]
        line = plus(line, applied(field, p))
        for j in self.ancestors(i):
            line, spin = self.to_parent(j, line), self.to_parent(j, spin)
        return line, spin

    def accelerations(self, bodies: Sequence[Body], rotors: Vector, efforts: Vector) -> Vector:
        """Return the accelerations of the joints by the mass matrix, factored from the leaves of the tree."""
        n = len(efforts)
        bias, M = self.efforts(bodies, [ZERO] * n), self.mass_matrix(bodies)
        for i, rotor in enumerate(rotors):
            M[i][i] = M[i][i] + rotor
        right = [effort - bias_k for effort, bias_k in zip(efforts, bias, strict=True)]
        return factor(M)[0](right)

    def regressor(self, axes: Sequence[Matrix], first: int, a: Vector) -> list[Vector]:
        """Return the regressor for the ten parameters of each body, beginning with joint `first`.

        The parameters are m, m c, and xx, xy, yy, xz, yz, zz of the inertia about the origin of the joint's
        frame. They are along axes in which this frame has the orientation from `axes`.
        """
        linkage, n = self.linkage, len(self.R)
        rows = [[ZERO] * (10 * (n - first)) for _ in range(n)]
        fields = self._fields(a, True)
        ways: list[dict[int, tuple[Vector, Vector]]] = []  # motion of the frame of joint i by joint j
        for i, parent in enumerate(linkage.parents):
            zeros, z = [ZERO] * 3, [ZERO, ZERO, ONE]
            motions = {i: (zeros, z) if linkage.turns[i] else (z, zeros)}
            for j, (line, turn) in (ways[parent] if parent >= 0 else {}).items():
                motions[j] = self.to_child(i, plus(line, cross(turn, self.p[i]))), self.to_child(i, turn)
            ways.append(motions)
            if i >= first:
                w, line, spin = (applied(axes[i], x) for x in (self.w[i], *fields[i][:2]))
                field = transpose(_field(w, spin))
                for j, way in motions.items():
                    axis, turn = (applied(axes[i], x) for x in way)
                    numbers = [dot(axis, line), *plus(applied(field, axis), cross(line, turn))]
                    pairs = zip((turn, cross(turn, w)), (spin, w), strict=True)
                    squares = [[[x * y for y in right] for x in left] for left, right in pairs]
                    Q = add(*squares)
                    numbers += [Q[0][0], Q[0][1] + Q[1][0], Q[1][1]]
                    numbers += [Q[0][2] + Q[2][0], Q[1][2] + Q[2][1], Q[2][2]]
                    rows[j][10 * (i - first) : 10 * (i - first) + 10] = numbers
        return rows


def _field(w: Vector, spin: Vector) -> Matrix:
    """Return [spin x] + [w x]^2."""
    xx, yy, zz = (x * x for x in w)
    xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
    return [
        [-(yy + zz), xy - spin[2], xz + spin[1]],
        [xy + spin[2], -(xx + zz), yz - spin[0]],
        [xz - spin[1], yz + spin[0], -(xx + yy)],
    ]
