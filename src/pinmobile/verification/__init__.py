"""Every route to M, n, tau and the acceleration side by side, with the largest difference."""

import numpy as np

from pinmobile.arrays import seeded, whole
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot import MobileRobot
from pinmobile.verification.routes import Comparison, Verification, compare_mounted, compare_planar

_MOST = 1_000_000  # states

__all__ = ["Comparison", "Verification", "verify"]


def verify(robot: MobileRobot, *, states: int = 200, seed: int | np.random.Generator = 0) -> Verification:
    """Compare every route to the robot's dynamics on random states.

    Of a bare base the routes are the closed form (hand-derived), Pinocchio (CRBA, RNEA, ABA), the symbolic
    Newton-Euler recursion and Lagrange's equations, these two for the robot's own DH table, and the machine
    code that ensembles of it run. Differences are relative to the scale of the terms: sqrt(M_ii M_jj) for M,
    m |v|^2 for n, |M| |a| + m |v|^2 for tau and |a| + |v|^2 for the acceleration; |v|^2 times the distance
    of the centre of mass where that is above 1 m. M, n and tau must be within 1e-12, the last within 8 eps
    cond(M).

    Of a base with arms or loads M by CRBA, n, tau and the ground's wrench f by RNEA are compared with
    Newton's and Euler's laws, written out for what the parts themselves say: the body, each arm as it was
    read, each load. Nothing of the model that they are assembled into is taken for that. Then Pinocchio's
    algorithms against each other: M against RNEA's columns; n against C(q, v) v + g(q); tau against M a + n;
    the acceleration by ABA against M^-1 (tau - n); and M[:3, :3] against the closed form of the body that all
    of it is with its arms locked. Last the machine code that ensembles of it run, against CRBA, RNEA and ABA;
    where there is none, `missing` says why. With m the mass beyond a joint, K its second moment about the
    joint (m where it slides) and r the reach of the whole [m], at least 1, the scales are sqrt(K_i K_j) for
    M, sqrt(m K) (9.81 + nv r |v|^2) for n, sqrt(m K) (9.81 + sqrt(nv) r |a| + nv r |v|^2) for tau, those of
    x and psi also for the forces and the moments of f, and |M^-1| times that for the acceleration; gravity
    in RNEA's columns adds 9.81 sqrt(m K) to that of M. Each must be within 1e-14.

    Parameters
    ----------
    robot : MobileRobot
        Any mass, inertia, centre of mass and table, any arms and loads.
    states : int
        Number of states: psi over two turns to either side, arms within their limits, v and a normal with
        unit deviation.
    seed : int or Generator
        Of the states.

    Returns
    -------
    verification : Verification
        Print it; ask `passed` and `largest`.

    Raises
    ------
    InvalidArgument
        If `states` is not a whole number from 1 to 1,000,000, or another argument not what is expected.
    """
    if not isinstance(robot, MobileRobot):
        raise InvalidArgument(f"robot is {shown(robot)}, expected a MobileRobot")
    rng, count = seeded("seed", seed), whole("states", states, most=_MOST)
    if robot.mounts or robot.loads:
        return Verification(robot, count, *compare_mounted(robot, count, rng))
    return Verification(robot, count, compare_planar(robot, count, rng))
