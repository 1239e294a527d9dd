"""`Reduced`: the dynamics of a drive in independent velocities, and the inputs that these take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.plant import Input

_LEAST_NORM = 1e-6  # relative weight of torques beside what they are for, where limits hold them


class Reduced(NamedTuple):
    """Rolling in independent velocities nu: M nu' + n = B u, v = S nu (Kane's equations).

    nu is, of a body that is free, its twist (forward, left, yaw rate); of one with one axle, the speed along
    the wheels at the axle and the yaw rate; of one with two axles, the speed at the fixed one, or, where both
    are steered, the number eta with twist = eta (a1 x a2) of the axles' rows. Rates of the arms and of
    steering axes that nothing else determines follow.

    Attributes
    ----------
    M, n, B : ndarray, shape (..., m, m), (..., m), (..., m, nu)
        Mass matrix, nonlinear effects and input matrix.
    S : ndarray, shape (..., nv, m)
        All velocities by the independent ones.
    nu : ndarray, shape (..., m)
        Those of the state.
    """

    M: Any
    n: Any
    B: Any
    S: Any
    nu: Any

    def torques(self, rates: Array) -> Array:
        """Return the input of least norm with which nu changes so, shape (..., nu) [N m].

        Parameters
        ----------
        rates : ndarray, shape (..., m)
            nu' [m/s^2, rad/s^2].
        """
        force = np.einsum("...ij,...j->...i", self.M, rates) + self.n
        return np.asarray(np.linalg.pinv(self.B) @ force[..., None])[..., 0]

    def nearest(self, force: Array, inputs: Sequence[Input]) -> Array:
        """Return the input within limits that comes nearest to a force, shape (nu,), of one state.

        Where limits allow it, it does what the force does, and has least norm; else what it misses is least
        in the metric of the inverse mass, by a quadratic program.

        Parameters
        ----------
        force : ndarray, shape (m,)
            On the independent velocities, S' tau.
        inputs : sequence of Input
            With their limits.
        """
        metric = np.linalg.inv(np.linalg.cholesky(self.M))
        B, right = metric @ self.B, metric @ force
        u = np.linalg.pinv(B) @ right
        lower, upper = (np.array([getattr(each, x) for each in inputs]) for x in ("lower", "upper"))
        if (u < lower).any() or (u > upper).any():
            from scipy.optimize import lsq_linear

            small = _LEAST_NORM * np.linalg.norm(B) * np.eye(len(u))
            wanted = np.append(right, np.zeros(len(u)))
            found = lsq_linear(np.vstack([B, small]), wanted, (lower, upper), tol=1e-14)
            u = np.clip(found.x, lower, upper)
        return np.asarray(u)


class Allocation(NamedTuple):
    """Torques for a force that is wanted on body and arms.

    Attributes
    ----------
    u : ndarray, shape (..., nu)
        The input [N m].
    residual : ndarray, shape (..., 3 + arms)
        What of the force wheels and joints do not supply: what is beyond their limits, and what no wheel
        can give, such as a force across the axle [N, N, N m, ...].
    """

    u: Array
    residual: Array
