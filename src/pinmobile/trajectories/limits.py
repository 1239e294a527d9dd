"""References that leave a robot's joint limits are refused."""

from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument

__all__ = ["check_limits"]

_SLACK = 1e-9  # [m, rad]: a path that ends at a limit comes there but for rounding


def check_limits(robot: Any, q: Array, t: Array) -> None:
    """Refuse configurations outside the joint limits of a robot.

    Parameters
    ----------
    robot : MobileRobot
        Whose `lower` and `upper` are meant.
    q : ndarray, shape (..., nq)
        Configurations.
    t : ndarray, shape (...)
        Their times, for the message [s].

    Raises
    ------
    InvalidArgument
        If one is outside; the message names the joint, its value and limits, and the time.
    """
    lower, upper = robot.lower, robot.upper
    outside = (q < lower - _SLACK) | (q > upper + _SLACK)
    if not outside.any():
        return
    *row, column = (int(i) for i in np.argwhere(outside)[0])
    model, where = robot.model, tuple(row)
    joint = next(j for j in range(1, model.njoints) if 0 <= column - model.idx_qs[j] < model.nqs[j])
    unit = "m" if model.joints[joint].shortname().startswith("JointModelP") else "rad"
    raise InvalidArgument(
        f"reference has joint {model.names[joint]!r} at {q[where][column]:.9g} {unit} at t = {t[where]:g} s, "
        f"expected {lower[column]:.9g} to {upper[column]:.9g} {unit}"
    )
