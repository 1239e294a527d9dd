"""What the coordinates of a model are called, and their units."""

import pinocchio as pin

from pinmobile.robot.tree import joint_kind

__all__ = ["configuration_names", "units", "velocity_names"]

_BASE = ("x", "y", "psi")
_PARTS = {2: ("cos", "sin"), 4: ("qx", "qy", "qz", "qw")}  # of joints with more numbers in q than in v
_PLANAR = ("x", "y", "cos", "sin")


def velocity_names(model: pin.Model) -> tuple[str, ...]:
    """Return the name of each number in v: x, y, psi, then those of the joints.

    Parameters
    ----------
    model : pin.Model
        The chain, and what it carries.
    """
    return _BASE + tuple(
        name
        for joint in range(len(_BASE) + 1, model.njoints)
        for name in _numbered(str(model.names[joint]), int(model.nvs[joint]))
    )


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


def units(model: pin.Model) -> tuple[str, ...]:
    """Return the unit of each number in a displacement: ``m`` of a way, ``rad`` of an angle.

    Parameters
    ----------
    model : pin.Model
        The chain, and what it carries.
    """
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
