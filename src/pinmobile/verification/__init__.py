"""Every route to M, n, tau and the acceleration side by side, with the largest difference."""

import numpy as np

from pinmobile.arrays import whole
from pinmobile.errors import InvalidArgument
from pinmobile.robot import MobileRobot
from pinmobile.verification.mounted import compare_mounted
from pinmobile.verification.planar import compare_planar
from pinmobile.verification.table import Comparison, Verification

__all__ = ["Comparison", "Verification", "verify"]


def verify(robot: MobileRobot, *, states: int = 200, seed: int | np.random.Generator = 0) -> Verification:
    """Compare every route to the robot's dynamics on random states.

    The routes are the closed form (hand-derived), Pinocchio (CRBA, RNEA, ABA), the symbolic Newton-Euler
    recursion and Lagrange's equations, the last two for the robot's own DH table. Differences are relative
    to the scale of the terms: sqrt(M_ii M_jj) for M, m |v|^2 for n, |M| |a| + m |v|^2 for tau and |a| + |v|^2
    for the acceleration; |v|^2 times the distance of the centre of mass where that is above 1 m. The first
    three must be within 1e-12, the last within 8 eps cond(M).

    Parameters
    ----------
    robot : MobileRobot
        Any mass, inertia, centre of mass and table.
    states : int
        Number of states: psi over two turns to either side, v and a normal with unit deviation.
    seed : int or Generator
        Of the states.

    Returns
    -------
    verification : Verification
        Print it; ask `passed` and `largest`.

    Raises
    ------
    InvalidArgument
        If `states` is not a whole number >= 1.
    """
    if not isinstance(robot, MobileRobot):
        raise InvalidArgument(f"robot is {robot!r}, expected a MobileRobot")
    rng = np.random.default_rng(seed)
    count = whole("states", states)
    compare = compare_mounted if robot.mounts or robot.loads else compare_planar
    return Verification(robot, count, compare(robot, count, rng))
