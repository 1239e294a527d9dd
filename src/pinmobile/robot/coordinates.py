"""What the coordinates of a model are called, and their units."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.plant import Coordinate, Input
from pinmobile.robot.tree import joint_kind, parts_of

__all__ = ["configuration_names", "coordinates", "inputs", "leading"]

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
