"""The tree of joints of a `pin.Model`: what hangs on what, and what rolls."""

import re

import pinocchio as pin

__all__ = ["carries_only_wheels", "children", "joint_kind"]

_WHEEL_JOINTS = 3  # suspension, steering, wheel


def joint_kind(model: pin.Model, joint: int) -> str:
    """Return Pinocchio's name of the joint's type, such as ``JointModelRZ``."""
    return str(model.joints[joint].shortname())


def children(model: pin.Model) -> list[list[int]]:
    """Return the joints that hang on each joint, the universe's first."""
    below: list[list[int]] = [[] for _ in range(model.njoints)]
    for joint in range(1, model.njoints):
        below[model.parents[joint]].append(joint)
    return below


def carries_only_wheels(model: pin.Model, joint: int) -> bool:
    """Tell whether the joint is a wheel, or carries only wheels with at most three joints in series."""
    below = children(model)

    def rolls(joint: int, joints_left: int) -> bool:
        if not below[joint]:
            return re.search("RevoluteUnbounded|RUB", joint_kind(model, joint)) is not None
        beyond = (rolls(child, joints_left - 1) for child in below[joint])
        return bool(joints_left > 1 and model.nvs[joint] == 1 and all(beyond))

    return rolls(joint, _WHEEL_JOINTS)
