"""References and starts that leave a robot's joint limits are refused."""

from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument

__all__ = ["check_limits"]

_SLACK = 1e-9  # [m, rad], of velocities relative: a path that ends at a limit comes there but for rounding


def check_limits(robot: Any, q: Array, v: Array, t: Array | None = None) -> None:
    """Refuse configurations and velocities outside the joint limits of a robot.

    Parameters
    ----------
    robot : MobileRobot
        Whose `lower`, `upper` and `velocity_limit` are meant.
    q : ndarray, shape (..., n), n <= nq
        Configurations, or their first numbers.
    v : ndarray, shape (..., m), m <= nv
        Velocities, or their first numbers.
    t : ndarray, shape (...), optional
        Their times where they are a reference, for the message [s]; without, they are a start (q0, v0).

    Raises
    ------
    InvalidArgument
        If one is outside; the message names the joint, its value and limits, and the time.
    """
    n, m = q.shape[-1], v.shape[-1]
    lower, upper, most = robot.lower[:n], robot.upper[:n], robot.velocity_limit[:m]
    outside = (q < lower - _SLACK) | (q > upper + _SLACK)
    if outside.any():
        where, column = _first(outside)
        name, unit = _joint(robot, column, of_q=True)
        raise InvalidArgument(
            f"{'q0' if t is None else 'reference'} has joint {name!r} at {q[where][column]:.9g} {unit}"
            f"{_when(t, where)}, expected {lower[column]:.9g} to {upper[column]:.9g} {unit}"
        )
    fast = np.abs(v) > most * (1 + _SLACK)
    if fast.any():
        where, column = _first(fast)
        name, unit = _joint(robot, column)
        raise InvalidArgument(
            f"{'v0' if t is None else 'reference'} moves joint {name!r} at {v[where][column]:.9g} {unit}/s"
            f"{_when(t, where)}, expected at most {most[column]:.9g} {unit}/s"
        )


def _when(t: Array | None, where: tuple[int, ...]) -> str:
    return "" if t is None else f" at t = {t[where]:g} s"


def _first(found: Any) -> tuple[tuple[int, ...], int]:
    *row, column = (int(i) for i in np.argwhere(found)[0])
    return tuple(row), column


def _joint(robot: Any, column: int, *, of_q: bool = False) -> tuple[str, str]:
    """Return the name of the joint that a number of q or v belongs to, and its unit."""
    model = robot.model
    starts, sizes = (model.idx_qs, model.nqs) if of_q else (model.idx_vs, model.nvs)
    joint = next(j for j in range(1, model.njoints) if 0 <= column - starts[j] < sizes[j])
    # Joints with limits of q have as many numbers in v.
    return str(model.names[joint]), robot.coordinates[model.idx_vs[joint] + column - starts[joint]].unit
