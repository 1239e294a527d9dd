"""Joints of a `pin.Model`: what each kind is, what hangs on what, and what their coordinates are called.

What Pinocchio calls the types of joints is read here alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.plant import Coordinate, Input

BODY_JOINT = 3
"""The joint of the chain that carries the body; those before it carry nothing."""

_SINGLE = re.compile("R[XYZ]|RUB[XYZ]|P[XYZ]|(Revolute|RevoluteUnbounded|Prismatic)Unaligned")
_SLIDES = {"Planar": 2, "Translation": 3, "FreeFlyer": 3}
_PARTS = {2: ("cos", "sin"), 4: ("qx", "qy", "qz", "qw")}  # of joints with more numbers in q than in v
_FAR = 1e8  # beyond, a limit is none
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
    def adds(self) -> bool:
        """Whether its displacements add to its part of q, number by number: then it may have limits."""
        return self.nq == self.nv

    @property
    def single(self) -> bool:
        """Whether it has one coordinate, about or along one axis."""
        return _SINGLE.fullmatch(self.kind) is not None

    @property
    def slides(self) -> int:
        """How many of its velocities, the first ones, are along an axis; the others are about one."""
        return _SLIDES.get(self.kind, int(self.kind.startswith("P")))

    @property
    def circular(self) -> bool:
        """Whether it is without limits, and its angle is (cos, sin) in q."""
        return (self.nq, self.nv) == (2, 1)

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

    @property
    def unit(self) -> slice:
        """Its part of q that has length one: (cos, sin) or a quaternion, which come last, or nothing."""
        turns = self.circular or "Planar" in self.kind
        width = 2 if turns else 4 if (self.nq, self.nv) in ((4, 3), (7, 6)) else 0
        return slice(self.q.stop - width, self.q.stop)

    @property
    def configuration_names(self) -> list[str]:
        """Name of each of its numbers in q, such as ``elbow:cos`` where it has two."""
        parts = ("x", "y", "cos", "sin") if "Planar" in self.kind else _PARTS.get(self.nq)
        if parts is None or ("Planar" not in self.kind and self.adds):
            return _numbered(self.name, self.nq)
        return [f"{self.name}:{part}" for part in parts]

    @property
    def coordinate_names(self) -> list[str]:
        """Name of each of its numbers in v."""
        return _numbered(self.name, self.nv)


def _numbered(name: str, count: int) -> list[str]:
    return [name] if count == 1 else [f"{name}:{k}" for k in range(count)]


def joints_of(model: pin.Model, first: int = 1) -> list[Joint]:
    """Return the joints of a model, from a number on."""
    return [Joint.of(model, number) for number in range(first, model.njoints)]


def axis_of(model: pin.Model, number: int) -> Array:
    """Return the axis, in its frame, of a joint that has a single one."""
    axes = _axes(model, number, pin.neutral(model)).ravel()
    return axes[3:] if axes[3:].any() else axes[:3]


def _axes(model: pin.Model, number: int, q: Array) -> Array:
    """Return the twists of a joint's rates, seen from what it carries."""
    kind = model.joints[number]
    data = kind.createData()
    kind.calc(data, q, np.zeros(model.nv))
    return np.array(data.S)


def moves_its_axes(model: pin.Model, joint: int) -> bool:
    """Tell whether the axes of the joint's rates move with its own angles, as seen from what it carries."""
    still = pin.neutral(model)
    before, after = (_axes(model, joint, q) for q in (still, pin.integrate(model, still, np.ones(model.nv))))
    return not np.allclose(before, after, rtol=0, atol=1e-9)


def children(model: pin.Model) -> list[list[int]]:
    """Return the joints that hang on each joint, the universe's first."""
    below: list[list[int]] = [[] for _ in range(model.njoints)]
    for joint in range(1, model.njoints):
        below[model.parents[joint]].append(joint)
    return below


def turns_freely(model: pin.Model, joint: int) -> bool:
    """Tell whether a joint turns without end: continuous, or revolute with limits far beyond all use."""
    own = Joint.of(model, joint)
    if "RevoluteUnbounded" in own.kind or "RUB" in own.kind:
        return True
    if not own.kind.startswith("R") or own.nq != 1:
        return False
    least, most = (float(limit[own.q][0]) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
    return -_UNSET < least < -_TURNS and _TURNS < most < _UNSET


def carries_only_wheels(model: pin.Model, joint: int) -> bool:
    """Tell whether the joint is a wheel, or carries only wheels with at most three joints in series."""
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


_BASE = ("x", "m", "vx"), ("y", "m", "vy"), ("psi", "rad", "yaw_rate")
_FORCES = ("Fx", "Fy", "Mz")
_FORCE_UNITS = {"m": "N", "rad": "N m"}


def coordinates(model: pin.Model, lower: Array, upper: Array) -> tuple[Coordinate, ...]:
    """Return each number of a displacement: x, y, psi, then those of the joints.

    Parameters
    ----------
    model : pin.Model
        The chain, and what it carries.
    lower, upper : ndarray, shape (nq,)
        Limits; joints with more numbers in q than in v have none.
    """
    free = -np.inf, np.inf
    found = [Coordinate(name, unit, *free, rate) for name, unit, rate in _BASE]
    for joint in joints_of(model, BODY_JOINT + 1):
        pairs = zip(lower[joint.q].tolist(), upper[joint.q].tolist(), strict=True)
        limits = list(pairs) if joint.adds else [free] * joint.nv
        units = ["m"] * joint.slides + ["rad"] * (joint.nv - joint.slides)
        rows = zip(joint.coordinate_names, units, limits, strict=True)
        found += [Coordinate(name, unit, *limit, f"{name}_rate") for name, unit, limit in rows]
    return tuple(found)


def inputs(coordinates: Sequence[Coordinate]) -> tuple[Input, ...]:
    """Return the generalised forces of coordinates: Fx, Fy, Mz, then those of the joints, without limits."""
    names = [*_FORCES, *(one.name for one in coordinates[len(_FORCES) :])]
    return tuple(Input(name, _FORCE_UNITS[one.unit]) for name, one in zip(names, coordinates, strict=True))


def leading(model: pin.Model) -> dict[int, int]:
    """Return how many numbers of q the first n coordinates have, for each n at which a joint ends."""
    return {joint.v.stop: joint.q.stop for joint in joints_of(model, BODY_JOINT)}


def configuration_names(model: pin.Model) -> tuple[str, ...]:
    """Return the name of each number in q: x, y, psi, then those of the joints."""
    arms = (joint.configuration_names for joint in joints_of(model, BODY_JOINT + 1))
    return (*(name for name, *_ in _BASE), *(name for names in arms for name in names))


def limits(model: pin.Model, moving: Iterable[int]) -> tuple[Array, Array, Array, Array]:
    """Return lower and upper limits, shape (nq,), and those of velocity and effort, shape (nv,).

    Parameters
    ----------
    model : pin.Model
        The chain, and what it carries.
    moving : iterable of int
        The joints that may have limits; of others they are infinite, as where a file knows none.
    """
    lower, upper = np.full(model.nq, -np.inf), np.full(model.nq, np.inf)
    speed, effort = np.full(model.nv, np.inf), np.full(model.nv, np.inf)
    for joint in (Joint.of(model, number) for number in moving):
        q, v = joint.q, joint.v
        least, most = model.lowerPositionLimit[q], model.upperPositionLimit[q]
        # Files write equal limits, or zero, where they know none.
        if joint.adds:
            known = least < most
            lower[q] = np.where(known & (least > -_FAR), least, -np.inf)
            upper[q] = np.where(known & (most < _FAR), most, np.inf)
        for target, source in ((speed, model.velocityLimit), (effort, model.effortLimit)):
            target[v] = np.where((source[v] > 0) & (source[v] < _FAR), source[v], np.inf)
    return lower, upper, speed, effort
