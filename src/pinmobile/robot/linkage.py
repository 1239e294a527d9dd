"""`Linkage`: a tree of joints with one coordinate each, and the bodies on it, over scalars."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, frozen
from pinmobile.compiled import Node, maximum, plain, root, sincos, symbols
from pinmobile.errors import NotTraceable

BODY_JOINT = 3
"""The joint of the chain that carries the body; those before it carry nothing."""

_SINGLE = re.compile("R[XYZ]|P[XYZ]|(Revolute|Prismatic)Unaligned")
_CONTINUOUS = re.compile("RUB[XYZ]|RevoluteUnboundedUnaligned")
_WHEEL_JOINTS = 3  # suspension, steering, wheel
_TURNS = 1e3 * 2 * np.pi  # [rad]: limits beyond this, both ways, count as none
_UNSET = 1e300  # [rad]: beyond, a model made joint by joint has not set them
_FINGER = 4  # joints in series at most, beyond which a branch is an arm
_TOOLS = ("tcp", "tool0", "end_effector", "ee_link")  # names of the link that a file means as the tip


@dataclass(frozen=True)
class Joint:
    """A joint of a model, and what its kind makes of its numbers.

    Attributes
    ----------
    name, kind : str
        Its own, and Pinocchio's of its type, such as ``RZ``.
    q, v : slice
        Its part of a configuration and of a velocity, in the model's order.
    """

    name: str
    kind: str
    q: slice
    v: slice

    @classmethod
    def of(cls, model: pin.Model, number: int) -> Joint:
        """Return the joint of a model that has a number."""
        q, v = int(model.idx_qs[number]), int(model.idx_vs[number])
        kind = str(model.joints[number].shortname()).removeprefix("JointModel")
        parts = slice(q, q + int(model.nqs[number])), slice(v, v + int(model.nvs[number]))
        return cls(str(model.names[number]), kind, *parts)

    def __str__(self) -> str:
        return f"{self.name!r} is a JointModel{self.kind}"

    @property
    def nq(self) -> int:
        """How many numbers it has in q."""
        return int(self.q.stop - self.q.start)

    @property
    def nv(self) -> int:
        """How many numbers it has in v."""
        return int(self.v.stop - self.v.start)

    @property
    def single(self) -> bool:
        """Whether it is an ordinary revolute or prismatic joint."""
        return _SINGLE.fullmatch(self.kind) is not None

    @property
    def slides(self) -> bool:
        """Whether it is a prismatic joint."""
        return self.nv == 1 and self.kind.startswith("P")

    @property
    def continuous(self) -> bool:
        """Whether it is a continuous revolute joint, whose angle is (cos, sin) in Pinocchio's q."""
        return _CONTINUOUS.fullmatch(self.kind) is not None

    @property
    def mimics(self) -> bool:
        """Whether it repeats the motion of another."""
        return "Mimic" in self.kind

    @property
    def floats(self) -> bool:
        """Whether it moves freely in space, or in a plane."""
        return self.in_space or self.kind.startswith("Planar")

    @property
    def in_space(self) -> bool:
        """Whether it moves freely in space."""
        return "FreeFlyer" in self.kind


def joints_of(model: pin.Model, first: int = 1) -> list[Joint]:
    """Return the joints of a model, from a number on."""
    return [Joint.of(model, number) for number in range(first, model.njoints)]


def axis_of(model: pin.Model, number: int) -> Array:
    """Return the axis, in its frame, of a joint that has a single one."""
    kind = model.joints[number]
    data = kind.createData()
    kind.calc(data, pin.neutral(model), np.zeros(model.nv))
    twist = np.ravel(data.S)
    return twist[3:] if twist[3:].any() else twist[:3]


_JOINT_ARRAYS = (
    *("armature", "rotorInertia", "rotorGearRatio", "damping"),
    *("lowerVelocityLimit", "lowerEffortLimit", "lowerDryFrictionLimit"),
    *("upperVelocityLimit", "upperEffortLimit", "upperDryFrictionLimit"),
)


def replace_continuous_joints(model: pin.Model) -> pin.Model:
    """Return the model with revolute joints without limits, which have one angle, for continuous ones."""
    joints = joints_of(model)
    if not any(joint.continuous for joint in joints):
        return model
    new, endless = pin.Model(), np.array([np.inf])
    new.name, new.gravity = model.name, model.gravity
    for number, joint in enumerate(joints, 1):
        kind, most = model.joints[number], (model.effortLimit[joint.v], model.velocityLimit[joint.v])
        limits = model.lowerPositionLimit[joint.q], model.upperPositionLimit[joint.q]
        if joint.continuous:
            kind, limits = pin.JointModelRevoluteUnaligned(axis_of(model, number)), (-endless, endless)
            if joint.kind[-1] in "XYZ":
                kind = getattr(pin, f"JointModelR{joint.kind[-1]}")()
        new.addJoint(model.parents[number], kind, model.jointPlacements[number], joint.name, *most, *limits)
    for number, inertia in enumerate(model.inertias):
        new.inertias[number] = inertia
    for number, frame in enumerate(list(model.frames)[1:], 1):
        # Pinocchio refuses a second frame of the same name, so they are numbered meanwhile.
        pieces = frame.parentJoint, frame.parentFrame, frame.placement, frame.type, frame.inertia
        new.addFrame(pin.Frame(str(number), *pieces), False)
        new.frames[number].name = frame.name
    for name in _JOINT_ARRAYS:
        setattr(new, name, getattr(model, name))
    return new


def convert_configuration(model: pin.Model, q: Array) -> Array:
    """Return a configuration of a model as one of `replace_continuous_joints(model)`."""
    parts = (
        [np.arctan2(*q[joint.q][::-1])] if joint.continuous else q[joint.q] for joint in joints_of(model)
    )
    return np.concatenate([np.zeros(0), *parts])


def circular_coordinates(model: pin.Model) -> tuple[int, ...]:
    """Return the coordinates whose errors are taken on the circle: psi and the continuous joints."""
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    joints = (joint for joint in joints_of(model, BODY_JOINT + 1) if not joint.slides)
    found = (joint.v.start for joint in joints if upper[joint.q][0] == np.inf == -lower[joint.q][0])
    return (BODY_JOINT - 1, *found)


def children(model: pin.Model) -> list[list[int]]:
    """Return the joints that hang on each joint, the universe's first."""
    below: list[list[int]] = [[] for _ in range(model.njoints)]
    for joint in range(1, model.njoints):
        below[model.parents[joint]].append(joint)
    return below


def turns_freely(model: pin.Model, joint: int) -> bool:
    """Return whether a joint turns without end: continuous, or revolute with limits far beyond all use."""
    own = Joint.of(model, joint)
    if own.continuous:
        return True
    if not own.kind.startswith("R"):
        return False
    least, most = (float(limit[own.q][0]) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
    endless = most == np.inf == -least
    return endless or (-_UNSET < least < -_TURNS and _TURNS < most < _UNSET)


def carries_only_wheels(model: pin.Model, joint: int) -> bool:
    """Return whether the joint is a wheel, or carries only wheels with at most three joints in series."""
    below = children(model)

    def rolls(joint: int, joints_left: int) -> bool:
        if not below[joint]:
            return turns_freely(model, joint)
        beyond = (rolls(child, joints_left - 1) for child in below[joint])
        return bool(joints_left > 1 and model.nvs[joint] == 1 and all(beyond))

    return rolls(joint, _WHEEL_JOINTS)


def root_of(model: pin.Model) -> list[int]:
    """Return the joints that put the robot into the world: free-flyer, planar, or two slides and a turn."""
    below = children(model)
    if len(below[0]) != 1:
        return []
    if Joint.of(model, 1).floats:
        return [1]
    chain = model.njoints > 3 and list(model.parents[1:4]) == [0, 1, 2]
    if not chain or any(len(below[joint]) != 1 for joint in (1, 2)):
        return []
    kinds = [Joint.of(model, joint).kind for joint in (1, 2, 3)]
    massless = all(model.inertias[joint].mass == 0 for joint in (1, 2))
    planar = sorted(kinds[:2]) == ["PX", "PY"] and kinds[2] in ("RZ", "RUBZ")
    return [1, 2, 3] if planar and massless else []


def tip_of(model: pin.Model) -> str:
    """Return the last link on the longest chain of joints; what carries fingers is the tip of theirs."""
    below = children(model)
    depth = [0] * model.njoints
    for joint in range(1, model.njoints):
        depth[joint] = depth[model.parents[joint]] + 1
    leaf = tip = int(np.argmax(depth))
    above = model.parents[leaf]
    while above and depth[leaf] - depth[above] <= _FINGER:
        if len(below[above]) > 1:
            tip = above
        above = model.parents[above]
    frames = [frame for frame in model.frames if frame.parentJoint == tip]
    links = [str(frame.name) for frame in frames if frame.type == pin.FrameType.BODY]
    tools = [link for tool in _TOOLS for link in links if link.endswith(tool)]
    return (tools or links or [str(frame.name) for frame in frames])[0 if tools else -1]


Vector: TypeAlias = list[Any]
Matrix: TypeAlias = list[list[Any]]

_LEAST = 1e-300  # a square that is zero

ENTRIES = (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)
"""The entries of a symmetric matrix that differ."""


class Exact:
    """0, 1 or -1 that stands in a formula: products with it cost nothing."""

    __array_ufunc__ = None  # arrays leave the operation to it

    def __init__(self, value: float) -> None:
        self.value = value

    def __mul__(self, other: Any) -> Any:
        return other if self.value == 1 else -other if self.value else self

    __rmul__ = __mul__

    def __add__(self, other: Any) -> Any:
        if not self.value:
            return other
        return exact(self.value + other.value) if isinstance(other, Exact) else self.value + other

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return other + -self

    def __neg__(self) -> Exact:
        return _EXACT[-self.value]

    def __truediv__(self, other: Any) -> Any:
        return self.value / other if self.value else self

    def __rtruediv__(self, other: Any) -> Any:
        return other * exact(1 / self.value)

    def __float__(self) -> float:
        return self.value


_EXACT = {value: Exact(value) for value in (0.0, 1.0, -1.0)}
ZERO, ONE = _EXACT[0.0], _EXACT[1.0]


def exact(x: Any) -> Any:
    """Return a scalar; where it is known to be 0, 1 or -1, as what costs nothing."""
    known = x.value if type(x) is Node else x
    return _EXACT.get(float(known), x) if isinstance(known, int | float) else x


def number(x: Any) -> Any:
    """Return a scalar, as a float where it is one of those that cost nothing."""
    return x.value if isinstance(x, Exact) else x


def sine_and_cosine(x: Any) -> tuple[Any, Any]:
    """Return sine and cosine of a scalar."""
    if isinstance(x, Exact | float | int):
        if not math.isfinite(x):
            return math.nan, math.nan
        return exact(math.sin(x)), exact(math.cos(x))
    if hasattr(x, "sine_and_cosine"):
        return x.sine_and_cosine()  # type: ignore[no-any-return]
    return sincos(x) if type(x) is Node else (np.sin(x), np.cos(x))


def plus(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return [y if x is ZERO else x if y is ZERO else x + y for x, y in zip(a, b, strict=True)]


def scaled(k: Any, a: Vector) -> Vector:
    """Return k a."""
    return [k * x for x in a]


def dot(a: Iterable[Any], b: Iterable[Any]) -> Any:
    """Return a . b."""
    found: Any = ZERO
    for x, y in zip(a, b, strict=True):
        if x is not ZERO and y is not ZERO:
            found = x * y if found is ZERO else found + x * y
    return found


def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def applied(A: Matrix, x: Vector) -> Vector:
    """Return A x."""
    return [dot(row, x) for row in A]


def transposed(A: Matrix) -> Matrix:
    """Return A'."""
    return [list(column) for column in zip(*A, strict=True)]


def product(A: Matrix, B: Matrix) -> Matrix:
    """Return A B."""
    return [[dot(row, column) for column in zip(*B, strict=True)] for row in A]


def added(A: Matrix, B: Matrix) -> Matrix:
    """Return A + B."""
    return [plus(a, b) for a, b in zip(A, B, strict=True)]


def symmetric(J: Sequence[Any]) -> Matrix:
    """Return the matrix of (xx, yy, zz, xy, xz, yz)."""
    return [[J[0], J[3], J[4]], [J[3], J[1], J[5]], [J[4], J[5], J[2]]]


def turned(R: Matrix, J: Matrix) -> Matrix:
    """Return R J R' of a symmetric J."""
    A, found = product(R, J), [[ZERO] * 3 for _ in range(3)]
    for r, c in ENTRIES:
        found[r][c] = found[c][r] = dot(A[r], R[c])
    return found


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


def solved(M: Matrix, right: Vector, order: Sequence[int]) -> Vector:
    """Return the solution of M x = right by L D L', the unknowns eliminated in this order; zeros stay."""
    return factored(M, order)[0](right)


def volume(rows: Matrix) -> Any:
    """Return the volume that some vectors span, at least zero, by orthogonalising one after another."""
    rest, found = [list(row) for row in rows], ONE
    if len(rest) > len(rest[0]):
        return ZERO
    while rest:
        first, *rest = rest
        square = dot(first, first)
        found = found * root(number(square))
        # What is zero spans nothing, whatever comes after it.
        inverse = 1.0 / maximum(number(square), _LEAST)
        rest = [plus(row, scaled(-dot(first, row) * inverse, first)) for row in rest]
    return found


def single(x: Any) -> Any:
    """Return a number as a scalar that costs nothing where it can: see `exact`."""
    return exact(x.item() if isinstance(x, np.ndarray) and not x.ndim else x)


def scalars(x: Array) -> Vector:
    """Return the entries of the last axis; of one row Python's numbers, which are quicker than NumPy's."""
    if type(x) is np.ndarray and x.ndim == 1 and x.dtype == np.float64:
        return [_EXACT.get(y, y) for y in x.tolist()]
    return [single(y) for y in np.moveaxis(plain(x), -1, 0)]


def vector_of(values: Vector, q: Array) -> Array:
    """Return scalars at configurations q as the last axis of an array, or of symbols."""
    numbers = [number(x) for x in values]
    if any(type(x) is Node for x in numbers):
        return symbols(numbers, (len(numbers),))  # type: ignore[return-value]  # they stand for an array
    return np.stack(np.broadcast_arrays(q[..., 0], *numbers)[1:], axis=-1)


def scalar_of(value: Any, q: Array) -> Array:
    """Return a scalar at configurations q as an array, or a symbol."""
    return vector_of([value], q)[..., 0]


def matrix_of(given: Sequence[Array]) -> Array:
    """Return arrays as the rows of matrices."""
    return np.stack(np.broadcast_arrays(*given), axis=-2)


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
    def none(cls) -> Body:
        """Return a body without mass."""
        return cls(ZERO, [ZERO] * 3, [[ZERO] * 3 for _ in range(3)])

    @classmethod
    def of(cls, mass: Any, com: Vector, inertia: Sequence[Any]) -> Body:
        """Return that of a centre of mass, and an inertia (xx, yy, zz, xy, xz, yz) about it."""
        return cls(mass, [ZERO] * 3, symmetric(inertia)).moved(com)

    def turned(self, R: Matrix) -> Body:
        """Return it in a frame in which its own has the orientation R."""
        return Body(self.mass, applied(R, self.first), turned(R, self.inertia))

    def moved(self, p: Vector) -> Body:
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

    def joined(self, other: Body) -> Body:
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
    turns : tuple of bool
        Whether it turns, or else slides.
    circular : tuple of int
        Joints whose errors are taken on the circle.
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
    circular: tuple[int, ...]
    rotations: Array
    offsets: Array
    axes: Array
    gravity: Array

    @classmethod
    def of(cls, model: pin.Model) -> Linkage:
        """Return that of a model; joint k has the number k in q and in v.

        Raises
        ------
        NotTraceable
            If a joint is neither revolute nor prismatic.
        """
        joints = joints_of(model)
        for joint in joints:
            if not joint.single:
                raise NotTraceable(
                    f"joint {joint}, neither revolute nor prismatic",
                    "give revolute and prismatic joints",
                )
        axes = [np.eye(3), *(_to_z(axis_of(model, j)) for j in range(1, model.njoints))]
        places, parents = list(model.jointPlacements)[1:], list(model.parents)[1:]
        above = [axes[parent].T for parent in parents]
        rotations = [A @ M.rotation @ axis for A, M, axis in zip(above, places, axes[1:], strict=True)]
        offsets = [A @ M.translation for A, M in zip(above, places, strict=True)]
        return cls(
            names=tuple(joint.name for joint in joints),
            parents=tuple(int(parent) - 1 for parent in parents),
            turns=tuple(not joint.slides for joint in joints),
            circular=circular_coordinates(model),
            rotations=frozen(without_rounding(np.array(rotations))),
            offsets=frozen(without_rounding(np.array(offsets))),
            axes=frozen(axes[1:]),
            gravity=frozen(model.gravity.linear),
        )

    def __len__(self) -> int:
        return len(self.names)


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


class Placement(NamedTuple):
    """Where a frame stands in another: how it is turned, and its origin [m], as scalars."""

    R: Matrix
    p: Vector

    @classmethod
    def of(cls, R: Array, p: Array) -> Placement:
        """Return that of numbers."""
        return cls([[exact(x) for x in row] for row in R.tolist()], [exact(x) for x in p.tolist()])

    @classmethod
    def about_z(cls, angle: Any, p: Vector) -> Placement:
        """Return that of a frame which is turned about z."""
        s, c = sine_and_cosine(angle)
        return cls([[c, -s, ZERO], [s, c, ZERO], [ZERO, ZERO, ONE]], p)

    def within(self, other: Placement) -> Placement:
        """Return it in the frame in which its own is at another place."""
        return Placement(product(other.R, self.R), plus(other.p, applied(other.R, self.p)))


def regrouped(
    linkage: Linkage, places: Sequence[Placement], bodies: Sequence[Body], least: int = 0
) -> list[Body]:
    """Return bodies that move as these do, with fewer numbers that are not zero (Khalil and Dombre, 2002).

    What its own joint does not move of a body goes to the body above: of one that turns its mass, first
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
