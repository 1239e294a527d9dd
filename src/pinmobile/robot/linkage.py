"""`Linkage`: a tree of joints with one coordinate each, where they stand, and what is fixed to them.

Each joint's frame is turned so that its axis is z, and bodies are regrouped, so that most of what recursions
over the tree would add and multiply is zero and is left out.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, frozen
from pinmobile.errors import NotTraceable
from pinmobile.robot.scalars import (
    ENTRIES,
    ONE,
    ZERO,
    Matrix,
    Vector,
    added,
    applied,
    exact,
    plus,
    product,
    scaled,
    sine_and_cosine,
    symmetric,
    turned,
)
from pinmobile.robot.tree import joint_kind

__all__ = ["Body", "Linkage", "Place", "regrouped", "without_rounding"]

_ONE_COORDINATE = re.compile(
    "JointModel(R[XYZ]|RUB[XYZ]|P[XYZ]|(Revolute|RevoluteUnbounded|Prismatic)Unaligned)"
)
_ROUNDING = 1e-15  # of a product of rotations [m in what it turns]


class Body(NamedTuple):
    """What is rigidly fixed to a joint's frame: ten numbers.

    Attributes
    ----------
    mass : scalar
        [kg].
    first : list of 3 scalars
        Mass times centre of mass [kg m].
    inertia : list of 3 lists of 3 scalars
        About the origin of the frame [kg m^2].
    """

    mass: Any
    first: Vector
    inertia: Matrix

    @classmethod
    def none(cls) -> "Body":
        """Return a body without mass."""
        return cls(ZERO, [ZERO] * 3, [[ZERO] * 3 for _ in range(3)])

    @classmethod
    def of(cls, mass: Any, com: Vector, inertia: Sequence[Any]) -> "Body":
        """Return that of a centre of mass, and an inertia (xx, yy, zz, xy, xz, yz) about it."""
        return cls(mass, [ZERO] * 3, symmetric(inertia)).moved(com)

    def turned(self, R: Matrix) -> "Body":
        """Return it in a frame in which its own has the orientation R."""
        return Body(self.mass, applied(R, self.first), turned(R, self.inertia))

    def moved(self, p: Vector) -> "Body":
        """Return it in a frame in which the origin of its own is at p: J + (p.h + g.p) 1 - p h' - g p'."""
        m, h, J = self
        g = plus(h, scaled(m, p))
        d = [p[k] * (h[k] + g[k]) for k in range(3)]
        found = [[ZERO] * 3 for _ in range(3)]
        for r, c in ENTRIES:
            if r == c:
                found[r][r] = J[r][r] + d[(r + 1) % 3] + d[(r + 2) % 3]
            else:
                found[r][c] = found[c][r] = J[r][c] - p[r] * h[c] - g[r] * p[c]
        return Body(m, g, found)

    def joined(self, other: "Body") -> "Body":
        """Return both as one."""
        return Body(self.mass + other.mass, plus(self.first, other.first), added(self.inertia, other.inertia))


@dataclass(frozen=True, eq=False)
class Linkage:
    """A tree of joints with one coordinate each; what has mass is given to its dynamics beside it.

    Attributes
    ----------
    names : tuple of str
        Of the joints.
    parents : tuple of int
        Joint that each hangs on; -1: the world.
    turns, circles : tuple of bool
        Whether it turns, or else slides; whether q has cosine and sine of its angle.
    q, v : tuple of int
        Its first number in a public q, and its number in v.
    rotations : ndarray, shape (n, 3, 3)
        Of its frame, axis z, in that of the joint it hangs on, at zero.
    offsets : ndarray, shape (n, 3)
        Its origin in that frame [m].
    axes : ndarray, shape (n, 3, 3)
        How its frame is turned in Pinocchio's.
    gravity : ndarray, shape (3,)
        [m/s^2].
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    turns: tuple[bool, ...]
    circles: tuple[bool, ...]
    q: tuple[int, ...]
    v: tuple[int, ...]
    rotations: Array
    offsets: Array
    axes: Array
    gravity: Array

    @classmethod
    def of(cls, model: pin.Model) -> "Linkage":
        """Return that of a model; numbers of q and v are those of the model.

        Raises
        ------
        NotTraceable
            If a joint has other than one coordinate.
        """
        joints = range(1, model.njoints)
        for j in joints:
            if not _ONE_COORDINATE.fullmatch(joint_kind(model, j)):
                raise NotTraceable(
                    f"joint {model.names[j]!r} is a {joint_kind(model, j)}, which has no single axis",
                    "give joints in series with one axis each",
                )
        axes = [np.eye(3), *(_to_z(_axis(model, j)) for j in joints)]
        places = [model.jointPlacements[j] for j in joints]
        above = [axes[model.parents[j]].T for j in joints]
        rotations = [A @ M.rotation @ axes[j] for A, M, j in zip(above, places, joints, strict=True)]
        offsets = [A @ M.translation for A, M in zip(above, places, strict=True)]
        own = [model.joints[j] for j in joints]
        return cls(
            names=tuple(str(model.names[j]) for j in joints),
            parents=tuple(int(model.parents[j]) - 1 for j in joints),
            turns=tuple("JointModelP" not in joint_kind(model, j) for j in joints),
            circles=tuple(joint.nq == 2 for joint in own),
            q=tuple(int(joint.idx_q) for joint in own),
            v=tuple(int(joint.idx_v) for joint in own),
            rotations=frozen(without_rounding(np.array(rotations))),
            offsets=frozen(without_rounding(np.array(offsets))),
            axes=frozen(axes[1:]),
            gravity=frozen(model.gravity.linear),
        )

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def counted(self) -> dict[Any, bool]:
        """What is known of the operations that its dynamics take, by what is zero in them."""
        return {}


def _axis(model: pin.Model, joint: int) -> Array:
    kind = model.joints[joint]
    data = kind.createData()
    kind.calc(data, pin.neutral(model), np.zeros(model.nv))
    S = np.asarray(data.S).ravel()
    return S[3:] if S[3:].any() else S[:3]


def _to_z(axis: Array) -> Array:
    """Return a rotation whose third column is an axis; a signed permutation where it is along one."""
    largest = int(np.argmax(np.abs(axis)))
    if np.count_nonzero(axis) == 1:
        z, x = np.sign(axis), np.eye(3)[(largest + 1) % 3]
    else:
        z = axis / np.linalg.norm(axis)
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(axis)))], z)
        x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def without_rounding(array: Array) -> Array:
    """Return entries of rotations and places, 0, 1 and -1 where a product of exact ones leaves a rounding."""
    whole = np.rint(array)
    return np.where((np.abs(array - whole) < _ROUNDING) & (np.abs(whole) <= 1), whole, array) + 0.0


class Place(NamedTuple):
    """Where a frame stands in another: how it is turned, and its origin [m], as scalars."""

    R: Matrix
    p: Vector

    @classmethod
    def of(cls, R: Array, p: Array) -> "Place":
        """Return that of numbers."""
        return cls([[exact(x) for x in row] for row in R.tolist()], [exact(x) for x in p.tolist()])

    @classmethod
    def about_z(cls, angle: Any, p: Vector) -> "Place":
        """Return that of a frame which is turned about z."""
        s, c = sine_and_cosine(angle)
        return cls([[c, -s, ZERO], [s, c, ZERO], [ZERO, ZERO, ONE]], p)

    def within(self, other: "Place") -> "Place":
        """Return it in the frame in which its own is at another place."""
        return Place(product(other.R, self.R), plus(other.p, applied(other.R, self.p)))


def regrouped(
    linkage: Linkage, places: Sequence[Place], bodies: Sequence[Body], least: int = 0
) -> list[Body]:
    """Return bodies that move as these do, with fewer numbers that are not zero (Khalil and Dombre, 2002).

    What of a body its own joint does not move goes to what it hangs on: of one that turns its mass, first
    moment along the axis and inertia yy; of one that slides its inertia. Joint torques are the same, and so
    is what a body feels of all that hangs on it, if nothing of its own went on; other forces between the
    links are not. `least` is the first joint whose body takes what comes: those before it get nothing.
    """
    found = list(bodies)
    for i in reversed(range(len(linkage))):
        above = linkage.parents[i]
        if above < least:
            continue
        m, h, J = found[i]
        if linkage.turns[i]:
            loose = Body(m, [ZERO, ZERO, h[2]], symmetric([J[1][1], J[1][1], *[ZERO] * 4]))
            kept = [J[0][0] - J[1][1], ZERO, J[2][2], J[0][1], J[0][2], J[1][2]]
            found[i] = Body(ZERO, [h[0], h[1], ZERO], symmetric(kept))
        else:
            loose, found[i] = Body(ZERO, [ZERO] * 3, J), Body(m, h, Body.none().inertia)
        found[above] = found[above].joined(loose.turned(places[i].R).moved(places[i].p))
    return found
