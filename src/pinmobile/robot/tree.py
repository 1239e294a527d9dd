"""The tree of joints of a `pin.Model`: what hangs on what, what rolls, what its coordinates are called."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.plant import Coordinate, Input

_WHEEL_JOINTS = 3  # suspension, steering, wheel
_TURNS = 1e3 * 2 * np.pi  # [rad]: who can turn so far both ways has no limit
_UNSET = 1e300  # [rad]: beyond, a model made joint by joint has not said
_FINGER = 4  # joints in series at most, beyond which a branch is an arm
_TOOLS = ("tcp", "tool0", "end_effector", "ee_link")  # names of the link that a file means as the tip


def joint_kind(model: pin.Model, joint: int) -> str:
    """Return Pinocchio's name of the joint's type, such as ``JointModelRZ``."""
    return str(model.joints[joint].shortname())


def parts_of(model: pin.Model, joint: int) -> tuple[slice, slice]:
    """Return a joint's part of a configuration and of a velocity."""
    q, v = model.idx_qs[joint], model.idx_vs[joint]
    return slice(q, q + model.nqs[joint]), slice(v, v + model.nvs[joint])


def moves_its_axes(model: pin.Model, joint: int) -> bool:
    """Tell whether the axes of the joint's rates move with its own angles, as seen from what it carries."""
    kind, still = model.joints[joint], np.zeros(model.nv)
    axes = []
    for q in (pin.neutral(model), pin.integrate(model, pin.neutral(model), np.ones(model.nv))):
        data = kind.createData()
        kind.calc(data, q, still)
        axes.append(np.array(data.S))
    before, after = axes
    return not np.allclose(before, after, rtol=0, atol=1e-9)


def children(model: pin.Model) -> list[list[int]]:
    """Return the joints that hang on each joint, the universe's first."""
    below: list[list[int]] = [[] for _ in range(model.njoints)]
    for joint in range(1, model.njoints):
        below[model.parents[joint]].append(joint)
    return below


def turns_freely(model: pin.Model, joint: int) -> bool:
    """Tell whether a joint turns without end: continuous, or revolute with limits far beyond all use."""
    kind = joint_kind(model, joint)
    if re.search("RevoluteUnbounded|RUB", kind):
        return True
    if not re.match("JointModelR", kind) or model.nqs[joint] != 1:
        return False
    q, _ = parts_of(model, joint)
    least, most = float(model.lowerPositionLimit[q][0]), float(model.upperPositionLimit[q][0])
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
    if re.match("JointModel(FreeFlyer|Planar)", joint_kind(model, 1)):
        return [1]
    chain = model.njoints > 3 and list(model.parents[1:4]) == [0, 1, 2]
    if not chain or any(len(below[joint]) != 1 for joint in (1, 2)):
        return []
    kinds = [joint_kind(model, joint).removeprefix("JointModel") for joint in (1, 2, 3)]
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


_BASE = ("x", "y", "psi")
_RATES = ("vx", "vy", "yaw_rate")
_FORCES = ("Fx", "Fy", "Mz")
_FORCE_UNITS = {"m": "N", "rad": "N m"}
_PARTS = {2: ("cos", "sin"), 4: ("qx", "qy", "qz", "qw")}  # of joints with more numbers in q than in v
_PLANAR = ("x", "y", "cos", "sin")


def coordinates(model: pin.Model, lower: Array, upper: Array) -> tuple[Coordinate, ...]:
    """Return each number of a displacement: x, y, psi, then those of the joints.

    Parameters
    ----------
    model : pin.Model
        The chain, and what it carries.
    lower, upper : ndarray, shape (nq,)
        Limits; joints with more numbers in q than in v have none.
    """
    names, limits = list(_BASE), [(-np.inf, np.inf)] * len(_BASE)
    for joint in range(len(_BASE) + 1, model.njoints):
        size, (q, _) = int(model.nvs[joint]), parts_of(model, joint)
        names += _numbered(str(model.names[joint]), size)
        own = model.nqs[joint] == size
        pairs = zip(lower[q].tolist(), upper[q].tolist(), strict=True)
        limits += list(pairs) if own else [(-np.inf, np.inf)] * size
    rates = [*_RATES, *(f"{name}_rate" for name in names[len(_RATES) :])]
    rows = zip(names, _units(model), limits, rates, strict=True)
    return tuple(Coordinate(name, unit, *limit, rate) for name, unit, limit, rate in rows)


def inputs(coordinates: Sequence[Coordinate]) -> tuple[Input, ...]:
    """Return the generalised forces of coordinates: Fx, Fy, Mz, then those of the joints, without limits."""
    names = [*_FORCES, *(one.name for one in coordinates[len(_FORCES) :])]
    return tuple(Input(name, _FORCE_UNITS[one.unit]) for name, one in zip(names, coordinates, strict=True))


def leading(model: pin.Model) -> dict[int, int]:
    """Return how many numbers of q the first n coordinates have, for each n at which a joint ends."""
    ends = (parts_of(model, joint) for joint in range(len(_BASE), model.njoints))
    return {v.stop: q.stop for q, v in ends}


def configuration_names(model: pin.Model) -> tuple[str, ...]:
    """Return the name of each number in q, such as ``arm/elbow:cos`` where a joint has two.

    Parameters
    ----------
    model : pin.Model
        The chain, and what it carries.
    """
    names = list(_BASE)
    for joint in range(len(_BASE) + 1, model.njoints):
        own, count = str(model.names[joint]), int(model.nqs[joint])
        planar = "Planar" in joint_kind(model, joint)
        if planar or (count != model.nvs[joint] and count in _PARTS):
            names += [f"{own}:{part}" for part in (_PLANAR if planar else _PARTS[count])]
        else:
            names += _numbered(own, count)
    return tuple(names)


def _units(model: pin.Model) -> tuple[str, ...]:
    """Return the unit of each number in a displacement: ``m`` of a way, ``rad`` of an angle."""
    found = ["m", "m", "rad"]
    for joint in range(len(_BASE) + 1, model.njoints):
        slides, size = _slides(model, joint), int(model.nvs[joint])
        found += ["m"] * slides + ["rad"] * (size - slides)
    return tuple(found)


def _slides(model: pin.Model, joint: int) -> int:
    """Return how many of a joint's velocities, the first ones, are along an axis."""
    kind = joint_kind(model, joint).removeprefix("JointModel")
    known = {"Planar": 2, "Translation": 3, "FreeFlyer": 3}
    return known.get(kind, int(kind.startswith("P")))


def _numbered(name: str, count: int) -> list[str]:
    return [name] if count == 1 else [f"{name}:{k}" for k in range(count)]
