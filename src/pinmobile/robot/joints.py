"""Joints of a `pin.Model`: what each kind is, what hangs on what, and what their coordinates are called.

What Pinocchio calls the types of joints is read here alone.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.plant import Coordinate, Input

BODY_JOINT = 3
"""The joint of the chain that carries the body; those before it carry nothing."""

_SINGLE = re.compile("R[XYZ]|P[XYZ]|(Revolute|Prismatic)Unaligned")
_CONTINUOUS = re.compile("RUB[XYZ]|RevoluteUnboundedUnaligned")
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
    """Tell whether a joint turns without end: continuous, or revolute with limits far beyond all use."""
    own = Joint.of(model, joint)
    if own.continuous:
        return True
    if not own.kind.startswith("R"):
        return False
    least, most = (float(limit[own.q][0]) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
    endless = most == np.inf == -least
    return endless or (-_UNSET < least < -_TURNS and _TURNS < most < _UNSET)


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
    """Return the coordinates: x, y, psi, then those of the joints.

    Parameters
    ----------
    model : pin.Model
        The chain, and what it carries.
    lower, upper : ndarray, shape (nq,)
        Limits.
    """
    joints = ((joint.name, "m" if joint.slides else "rad") for joint in joints_of(model, BODY_JOINT + 1))
    named = (*_BASE, *((name, unit, f"{name}_rate") for name, unit in joints))
    limits = zip(lower.tolist(), upper.tolist(), strict=True)
    return tuple(
        Coordinate(name, unit, *limit, rate) for (name, unit, rate), limit in zip(named, limits, strict=True)
    )


def inputs(coordinates: Sequence[Coordinate]) -> tuple[Input, ...]:
    """Return the generalised forces of coordinates: Fx, Fy, Mz, then those of the joints, without limits."""
    names = [*_FORCES, *(one.name for one in coordinates[len(_FORCES) :])]
    return tuple(Input(name, _FORCE_UNITS[one.unit]) for name, one in zip(names, coordinates, strict=True))


def limits(model: pin.Model) -> tuple[Array, Array, Array, Array]:
    """Return lower and upper limits and those of velocity and effort, each of shape (nv,).

    They are infinite for the base, and where a file has none.
    """
    lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    speed, effort = upper.copy(), upper.copy()
    arms = slice(BODY_JOINT, None)
    least, most = model.lowerPositionLimit[arms], model.upperPositionLimit[arms]
    known = least < most  # files write equal limits, or zero, where they know none
    lower[arms] = np.where(known & (least > -_FAR), least, -np.inf)
    upper[arms] = np.where(known & (most < _FAR), most, np.inf)
    for target, source in ((speed, model.velocityLimit[arms]), (effort, model.effortLimit[arms])):
        target[arms] = np.where((source > 0) & (source < _FAR), source, np.inf)
    return lower, upper, speed, effort
