"""`Linkage`: a tree of joints with one coordinate each, and rigid bodies on its joints, over scalars."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, frozen
from pinmobile.compiled import Node, maximum, root, sincos, symbols, unwrap
from pinmobile.errors import NotTraceable

BODY_JOINT = 3
"""Number of the joint of the chain that carries the body; the joints before it carry no mass."""

_SINGLE = re.compile("R[XYZ]|P[XYZ]|(Revolute|Prismatic)Unaligned")
FREE_FLYER = "FreeFlyer"  # kind of a joint that moves freely in space
_CONTINUOUS = re.compile("RUB[XYZ]|RevoluteUnboundedUnaligned")
_WHEEL_JOINTS = 3  # suspension, steering, wheel
_TURNS = 1e3 * 2 * np.pi  # [rad]: larger limits in both directions count as no limit
_UNSET = 1e300  # [rad]: larger values are unset limits of a model made joint by joint
_FINGER = 4  # largest number of joints in series of a finger; a longer branch is an arm
_TOOLS = ("tcp", "tool0", "end_effector", "ee_link")  # common names of the tip


@dataclass(frozen=True)
class Joint:
    """Joint of a model, with the properties that follow from its type.

    Attributes
    ----------
    name, kind : str
        Name of the joint, and name of its type in Pinocchio, such as ``RZ``.
    q, v : slice
        Slices of the joint in a configuration and in a velocity, in the model's order.
    """

    name: str
    kind: str
    q: slice
    v: slice

    @classmethod
    def of(cls, model: pin.Model, number: int) -> Joint:
        """Return the joint of a model with a given number."""
        q, v = int(model.idx_qs[number]), int(model.idx_vs[number])
        kind = str(model.joints[number].shortname()).removeprefix("JointModel")
        parts = slice(q, q + int(model.nqs[number])), slice(v, v + int(model.nvs[number]))
        return cls(str(model.names[number]), kind, *parts)

    def __str__(self) -> str:
        return f"{self.name!r} is a JointModel{self.kind}"

    @property
    def nq(self) -> int:
        """Number of entries of the joint in q."""
        return int(self.q.stop - self.q.start)

    @property
    def nv(self) -> int:
        """Number of entries of the joint in v."""
        return int(self.v.stop - self.v.start)

    @property
    def slides(self) -> bool:
        """Whether the joint is prismatic."""
        return self.nv == 1 and self.kind.startswith("P")

    @property
    def continuous(self) -> bool:
        """Whether the joint is a continuous revolute joint, with (cos, sin) of its angle in Pinocchio's q."""
        return _CONTINUOUS.fullmatch(self.kind) is not None

    @property
    def floats(self) -> bool:
        """Whether the joint moves freely in space, or in a plane."""
        return self.kind.startswith((FREE_FLYER, "Planar"))


def joints_of(model: pin.Model, first: int = 1) -> list[Joint]:
    """Return the joints of a model, beginning with a given number."""
    return [Joint.of(model, number) for number in range(first, model.njoints)]


def axis_of(model: pin.Model, number: int) -> Array:
    """Return the axis of a joint with a single axis, in the joint's frame."""
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
    """Return the model with unlimited revolute joints (with one angle) in place of continuous joints."""
    joints = joints_of(model)
    if not any(joint.continuous for joint in joints):
        return model
    new, endless = pin.Model(), np.array([np.inf])
    new.name, new.gravity = model.name, model.gravity
    for number, joint in enumerate(joints, 1):
        kind, rates = model.joints[number], (model.effortLimit[joint.v], model.velocityLimit[joint.v])
        limits = model.lowerPositionLimit[joint.q], model.upperPositionLimit[joint.q]
        if joint.continuous:
            kind, limits = pin.JointModelRevoluteUnaligned(axis_of(model, number)), (-endless, endless)
            if joint.kind[-1] in "XYZ":
                kind = getattr(pin, f"JointModelR{joint.kind[-1]}")()
        new.addJoint(model.parents[number], kind, model.jointPlacements[number], joint.name, *rates, *limits)
    for number, inertia in enumerate(model.inertias):
        new.inertias[number] = inertia
    for number, frame in enumerate(list(model.frames)[1:], 1):
        # Numbers make names unique for a while: Pinocchio rejects equal names of frames.
        pieces = frame.parentJoint, frame.parentFrame, frame.placement, frame.type, frame.inertia
        new.addFrame(pin.Frame(str(number), *pieces), False)
        new.frames[number].name = frame.name
    for name in _JOINT_ARRAYS:
        setattr(new, name, getattr(model, name))
    return new


def convert_configuration(model: pin.Model, q: Array) -> Array:
    """Return a configuration of a model as a configuration of `replace_continuous_joints(model)`."""
    parts = ((q[joint.q], joint.continuous) for joint in joints_of(model))
    angles = ([np.arctan2(*q_j[::-1])] if continuous else q_j for q_j, continuous in parts)
    return np.concatenate([np.zeros(0), *angles])


def circular_coordinates(model: pin.Model) -> tuple[int, ...]:
    """Return the coordinates with errors on the circle: psi and the continuous joints."""
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    joints = (joint for joint in joints_of(model, BODY_JOINT + 1) if not joint.slides)
    joints_v = (joint.v.start for joint in joints if upper[joint.q][0] == np.inf == -lower[joint.q][0])
    return (BODY_JOINT - 1, *joints_v)


def children(model: pin.Model) -> list[list[int]]:
    """Return the child joints of each joint, beginning with the universe."""
    lists: list[list[int]] = [[] for _ in range(model.njoints)]
    for joint in range(1, model.njoints):
        lists[model.parents[joint]].append(joint)
    return lists


def turns_freely(model: pin.Model, joint: int) -> bool:
    """Return whether a joint turns endlessly: continuous, or revolute with very large limits."""
    data = Joint.of(model, joint)
    if data.continuous:
        return True
    if not data.kind.startswith("R"):
        return False
    low, high = (float(limit[data.q][0]) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
    endless = high == np.inf == -low
    return endless or (-_UNSET < low < -_TURNS and _TURNS < high < _UNSET)


def carries_only_wheels(model: pin.Model, joint: int) -> bool:
    """Return whether the joint is a wheel, or carries only wheels with at most three joints in series."""
    child_of = children(model)

    def rolls(joint: int, joints_left: int) -> bool:
        if not child_of[joint]:
            return turns_freely(model, joint)
        results = (rolls(child, joints_left - 1) for child in child_of[joint])
        return bool(joints_left > 1 and model.nvs[joint] == 1 and all(results))

    return rolls(joint, _WHEEL_JOINTS)


def root_of(model: pin.Model) -> list[int]:
    """Return the root joints of a robot: free-flyer, planar, or two prismatic joints and a revolute joint."""
    child_of = children(model)
    if len(child_of[0]) != 1:
        return []
    if Joint.of(model, 1).floats:
        return [1]
    chain = model.njoints > 3 and list(model.parents[1:4]) == [0, 1, 2]
    if not chain or any(len(child_of[joint]) != 1 for joint in (1, 2)):
        return []
    kinds = [Joint.of(model, joint).kind for joint in (1, 2, 3)]
    massless = all(model.inertias[joint].mass == 0 for joint in (1, 2))
    planar = sorted(kinds[:2]) == ["PX", "PY"] and kinds[2] in ("RZ", "RUBZ")
    return [1, 2, 3] if planar and massless else []


def tip_of(model: pin.Model) -> str:
    """Return the last link on the longest chain of joints; for a hand, the link before the fingers."""
    child_of = children(model)
    depth = [0] * model.njoints
    for joint in range(1, model.njoints):
        depth[joint] = depth[model.parents[joint]] + 1
    leaf = tip = int(np.argmax(depth))
    parent = model.parents[leaf]
    while parent and depth[leaf] - depth[parent] <= _FINGER:
        if len(child_of[parent]) > 1:
            tip = parent
        parent = model.parents[parent]
    frames = [frame for frame in model.frames if frame.parentJoint == tip]
    links = [str(frame.name) for frame in frames if frame.type == pin.FrameType.BODY]
    tools = [link for tool in _TOOLS for link in links if link.endswith(tool)]
    return (tools or links or [str(frame.name) for frame in frames])[0 if tools else -1]


Vector: TypeAlias = list[Any]
Matrix: TypeAlias = list[list[Any]]

_MIN_SQUARE = 1e-300  # smaller squares count as zero

ENTRIES = (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)  # independent ones of a symmetric matrix


class Exact:
    """Exact 0, 1 or -1 in a formula; its products need no arithmetic."""

    __array_ufunc__ = None  # arrays delegate operations to this class

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
    """Return a scalar; a known 0, 1 or -1 becomes an `Exact`."""
    value = x.value if type(x) is Node else x
    return _EXACT.get(float(value), x) if isinstance(value, int | float) else x


def number(x: Any) -> Any:
    """Return a scalar, with an `Exact` converted to a float."""
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


def scale(k: Any, a: Vector) -> Vector:
    """Return k a."""
    return [k * x for x in a]


def dot(a: Iterable[Any], b: Iterable[Any]) -> Any:
    """Return a . b."""
    total: Any = ZERO
    for x, y in zip(a, b, strict=True):
        if x is not ZERO and y is not ZERO:
            total = x * y if total is ZERO else total + x * y
    return total


def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def applied(A: Matrix, x: Vector) -> Vector:
    """Return A x."""
    return [dot(row, x) for row in A]


def transpose(A: Matrix) -> Matrix:
    """Return A'."""
    return [list(column) for column in zip(*A, strict=True)]


def product(A: Matrix, B: Matrix) -> Matrix:
    """Return A B."""
    return [[dot(row, column) for column in zip(*B, strict=True)] for row in A]


def add(A: Matrix, B: Matrix) -> Matrix:
    """Return A + B."""
    return [plus(a, b) for a, b in zip(A, B, strict=True)]


def symmetric(J: Sequence[Any]) -> Matrix:
    """Return the matrix of (xx, yy, zz, xy, xz, yz)."""
    return [[J[0], J[3], J[4]], [J[3], J[1], J[5]], [J[4], J[5], J[2]]]


def rotate_tensor(R: Matrix, J: Matrix) -> Matrix:
    """Return R J R' of a symmetric J."""
    A, result = product(R, J), [[ZERO] * 3 for _ in range(3)]
    for r, c in ENTRIES:
        result[r][c] = result[c][r] = dot(A[r], R[c])
    return result


def factor(M: Matrix, order: Sequence[int] = ()) -> tuple[Callable[[Vector], Vector], Matrix]:
    """Return the solver of M x = right for a symmetric M, by L D L', and the partly eliminated matrix.

    Zeros stay.

    Parameters
    ----------
    M : list of lists of scalars
        Symmetric matrix.
    order : sequence of int, optional
        Unknowns to eliminate first. The returned matrix belongs to the other unknowns, which the solver
        eliminates in reverse order.
    """
    n, left = len(M), list[list[Any]]()
    others = [i for i in range(n) if i not in order]
    M, inverse, order = [list(row) for row in M], [ZERO] * n, [*order, *reversed(others)]
    for count, i in enumerate(order, 1):
        if count > n - len(others) and not left:
            left = [[M[j][k] for k in others] for j in others]
        inverse[i] = 1.0 / number(M[i][i])
        rest = order[count:]
        factors = {j: M[j][i] * inverse[i] for j in rest}
        for column, j in enumerate(rest):
            for k in rest[: column + 1]:
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


def volume(rows: Matrix) -> Any:
    """Return the volume that vectors span, at least zero, by successive orthogonalisation."""
    rest, size = [list(row) for row in rows], ONE
    if len(rest) > len(rest[0]):
        return ZERO
    while rest:
        first, *rest = rest
        square = dot(first, first)
        size = size * root(number(square))
        # A zero vector gives a zero volume, for any later vectors.
        inverse = 1.0 / maximum(number(square), _MIN_SQUARE)
        rest = [plus(row, scale(-dot(first, row) * inverse, first)) for row in rest]
    return size


def single(x: Any) -> Any:
    """Return a number or a symbol as a scalar, see `exact`."""
    x = unwrap(x)
    return exact(x.item() if isinstance(x, np.ndarray) and not x.ndim else x)


def scalars(x: Array) -> Vector:
    """Return the entries of the last axis; for one row, as Python floats, which are faster than NumPy's."""
    if type(x) is np.ndarray and x.ndim == 1 and x.dtype == np.float64:
        return [_EXACT.get(y, y) for y in x.tolist()]
    return [single(y) for y in np.moveaxis(unwrap(x), -1, 0)]


def vector_of(values: Vector, q: Array) -> Array:
    """Return scalars at configurations q as the last axis of an array, or as symbols."""
    numbers = [number(x) for x in values]
    if any(type(x) is Node for x in numbers):
        return symbols(numbers, (len(numbers),))  # type: ignore[return-value]  # symbols represent an array
    return np.stack(np.broadcast_arrays(q[..., 0], *numbers)[1:], axis=-1)


def scalar_of(value: Any, q: Array) -> Array:
    """Return a scalar at configurations q as an array, or as a symbol."""
    return vector_of([value], q)[..., 0]


def matrix_of(rows: Matrix, q: Array) -> Array:
    """Return rows of scalars at configurations q as matrices."""
    return np.stack(np.broadcast_arrays(*(vector_of(row, q) for row in rows)), axis=-2)


_ROUNDING = 1e-15  # rounding of a product of rotations [m, for rotated positions]


class Body(NamedTuple):
    """Rigid body fixed to a joint's frame, as ten numbers.

    Attributes
    ----------
    mass : scalar
        Mass [kg].
    first : list of 3 scalars
        Mass times centre of mass [kg m].
    inertia : list of 3 lists of 3 scalars
        Inertia about the origin of the frame [kg m^2].
    """

    mass: Any
    first: Vector
    inertia: Matrix

    @classmethod
    def zero(cls) -> Body:
        """Return a body without mass."""
        return cls(ZERO, [ZERO] * 3, [[ZERO] * 3 for _ in range(3)])

    @classmethod
    def of(cls, mass: Any, com: Vector, inertia: Sequence[Any]) -> Body:
        """Return the body with a centre of mass and an inertia (xx, yy, zz, xy, xz, yz) about this centre."""
        return cls(mass, [ZERO] * 3, symmetric(inertia)).shift(com)

    def rotate(self, R: Matrix) -> Body:
        """Return the body in a frame in which its present frame has the orientation R."""
        return Body(self.mass, applied(R, self.first), rotate_tensor(R, self.inertia))

    def shift(self, p: Vector) -> Body:
        """Return the body in a frame in which its present origin is at p: J + (p.h + g.p) 1 - p h' - g p'."""
        m, h, J = self
        g = plus(h, scale(m, p))
        d = [p[k] * (h[k] + g[k]) for k in range(3)]
        inertia = [[ZERO] * 3 for _ in range(3)]
        for r, c in ENTRIES:
            if r == c:
                inertia[r][r] = J[r][r] + d[(r + 1) % 3] + d[(r + 2) % 3]
            else:
                inertia[r][c] = inertia[c][r] = J[r][c] - p[r] * h[c] - g[r] * p[c]
        return Body(m, g, inertia)

    def merge(self, other: Body) -> Body:
        """Return both bodies as one."""
        return Body(self.mass + other.mass, plus(self.first, other.first), add(self.inertia, other.inertia))


@dataclass(frozen=True, eq=False)
class Linkage:
    """Tree of joints with one coordinate each; the dynamics take the bodies as a separate argument.

    Attributes
    ----------
    names : tuple of str
        Names of the joints.
    parents : tuple of int
        Index of each joint's parent; -1 for the world.
    turns : tuple of bool
        Whether each joint is revolute; otherwise, it is prismatic.
    circular : tuple of int
        Joints with errors on the circle.
    rotations : ndarray, shape (n, 3, 3)
        Orientation of each joint's frame (with axis z) in its parent's frame, for a zero coordinate.
    offsets : ndarray, shape (n, 3)
        Origin of each joint's frame in its parent's frame [m].
    axes : ndarray, shape (n, 3, 3)
        Orientation of each joint's frame in Pinocchio's frame of the joint.
    gravity : ndarray, shape (3,)
        Acceleration of gravity [m/s^2].
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
        """Return the linkage of a model; joint k has the coordinate k in q and v.

        Raises
        ------
        NotTraceable
            If a joint is neither revolute nor prismatic.
        """
        joints = joints_of(model)
        for joint in joints:
            if not _SINGLE.fullmatch(joint.kind):
                raise NotTraceable(
                    f"joint {joint}, neither revolute nor prismatic", "use revolute and prismatic joints"
                )
        axes = [np.eye(3), *(_to_z(axis_of(model, j)) for j in range(1, model.njoints))]
        places, parents = list(model.jointPlacements)[1:], list(model.parents)[1:]
        frames = [axes[parent].T for parent in parents]
        rotations = [A @ M.rotation @ axis for A, M, axis in zip(frames, places, axes[1:], strict=True)]
        offsets = [A @ M.translation for A, M in zip(frames, places, strict=True)]
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
    """Return a rotation with an axis as its third column; a signed permutation for a coordinate axis."""
    largest = int(np.argmax(np.abs(axis)))
    if np.count_nonzero(axis) == 1:
        z, x = np.sign(axis), np.eye(3)[(largest + 1) % 3]
    else:
        z = axis / np.linalg.norm(axis)
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(axis)))], z)
        x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def without_rounding(array: Array) -> Array:
    """Return entries of rotations and positions, with rounded 0, 1 and -1 made exact."""
    nearest = np.rint(array)
    return np.where((np.abs(array - nearest) < _ROUNDING) & (np.abs(nearest) <= 1), nearest, array) + 0.0


class Placement(NamedTuple):
    """Rotation and origin [m] of a frame in another frame, as scalars."""

    R: Matrix
    p: Vector

    @classmethod
    def of(cls, R: Array, p: Array) -> Placement:
        """Return the placement with numeric entries."""
        return cls([[exact(x) for x in row] for row in R.tolist()], [exact(x) for x in p.tolist()])

    @classmethod
    def about_z(cls, angle: Any, p: Vector) -> Placement:
        """Return the placement of a frame that is rotated about z."""
        s, c = sine_and_cosine(angle)
        return cls([[c, -s, ZERO], [s, c, ZERO], [ZERO, ZERO, ONE]], p)

    def within(self, other: Placement) -> Placement:
        """Return the placement in a frame in which its present reference frame has another placement."""
        return Placement(product(other.R, self.R), plus(other.p, applied(other.R, self.p)))


def regroup(
    linkage: Linkage, places: Sequence[Placement], bodies: Sequence[Body], first: int = 0
) -> list[Body]:
    """Return equivalent bodies with fewer nonzero numbers (Khalil and Dombre, 2002).

    The parameters of a body that its own joint does not move go to the parent's body: for a revolute joint,
    its mass, its first moment along the axis and its inertia yy; for a prismatic joint, its inertia. Joint
    torques stay the same. The total wrench on a body from its children also stays the same if this body
    passes nothing on. Other forces between links change. `first` is the first joint whose body accepts
    parameters.
    """
    result = list(bodies)
    for i in reversed(range(len(linkage))):
        parent = linkage.parents[i]
        if parent < first:
            continue
        m, h, J = result[i]
        if linkage.turns[i]:
            loose = Body(m, [ZERO, ZERO, h[2]], symmetric([J[1][1], J[1][1], *[ZERO] * 4]))
            entries = [J[0][0] - J[1][1], ZERO, J[2][2], J[0][1], J[0][2], J[1][2]]
            result[i] = Body(ZERO, [h[0], h[1], ZERO], symmetric(entries))
        else:
            loose, result[i] = Body(ZERO, [ZERO] * 3, J), Body(m, h, Body.zero().inertia)
        result[parent] = result[parent].merge(loose.rotate(places[i].R).shift(places[i].p))
    return result
