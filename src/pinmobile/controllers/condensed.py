"""`Plan` and `Program`: quadratic programs over a horizon, all but their bounds known at the start."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, frozen
from pinmobile.controllers.lqr import riccati
from pinmobile.controllers.tracked_model import TrackedModel
from pinmobile.extras import imported

_SOFT = 8  # of daqp: a bound that may be violated, at a cost
_AT_UPPER, _AT_LOWER = 1, 3  # of daqp: a bound that it begins with, as active
_TIGHT = 1e-9  # within which daqp holds bounds


class Program(NamedTuple):
    """A quadratic program of z, by which inputs differ from those of the gains, in a metric where H is 1.

    Attributes
    ----------
    H, f : ndarray, shape (N nu, N nu), (N nu,)
        Of the cost z' H z / 2 + f' z.
    A : ndarray, shape (rows, N nu)
        For each step inputs, and states that are bounded, by z.
    lower, upper : ndarray, shape (rows,)
        Bounds of A z.
    sense : ndarray of int32, shape (rows,)
        Which of them are soft.
    """

    H: Array
    f: Array
    A: Array
    lower: Array
    upper: Array
    sense: Any

    def solved(self, prices: Array) -> tuple[Array, Array, int]:
        """Return z, the price of each bound, and what daqp says: above 0 where it is solved.

        Parameters
        ----------
        prices : ndarray, shape (rows,)
            Of a program near it: bounds that have one are those that are tried first.
        """
        solve = solver()
        begun = self.sense | np.where(prices > 0, _AT_UPPER, np.where(prices < 0, _AT_LOWER, 0))
        for sense in (begun.astype(np.int32), self.sense):
            z, _, flag, told = solve(
                self.H, self.f, self.A, self.upper, self.lower, sense.copy(), primal_tol=_TIGHT
            )
            if flag > 0 and np.isfinite(z).all():
                return z, np.asarray(told["lam"]), flag
        return z, 0.0 * prices, min(flag, 0)


class Plan:
    """What is known of all N + 1 samples at the start.

    Inputs are those of the gains K, and w beside: the cost of w alone is the sum of w' S w, S = R + B' P B,
    so that with S = L L' and z = L' w it is that of z' z, and daqp has nothing to factor. What follows from z
    of one sample, however late, is known beforehand: a program's rows are copies.

    Parameters
    ----------
    model : TrackedModel
        Of the robot along the reference.
    x : ndarray, shape (N + 1, n + m)
        Tracked state of the reference.
    Q, R : ndarray
        Weights of one sample.
    dt : float
        Time between two samples [s].
    stride, horizon : int
        Samples of a prediction's step, and how many steps there are.
    kept : ndarray of bool, shape (n + m,)
        Which states are bounded.

    Attributes
    ----------
    F, K : ndarray, shape (N + 1, n + m, n + m), (N + 1, nu, n + m)
        From each sample to the next step with the gains alone, and these.
    u, x : ndarray, shape (N + 1, nu), (N + 1, n + m)
        Input and tracked state of the reference.
    moves : ndarray, shape (N + 1, nu, nu)
        Input beside that of the gains, by z.
    responses : ndarray, shape (N + 1, horizon, nu + kept, nu)
        By z of each sample: inputs so many steps later, and bounded states after them.
    slopes, pushes, pulls : ndarray, shape (N + 1, m, n + m), (N + 1, m, nu), (N + 1, nu, m)
        Of the rates of independent velocities: by the state, by the input, and the input of one.
    """

    def __init__(
        self,
        model: TrackedModel,
        x: Array,
        Q: Array,
        R: Array,
        *,
        dt: float,
        stride: int,
        horizon: int,
        kept: Array,
    ) -> None:
        A, B = model.discrete(stride * dt)
        K, P = riccati(A, B, stride * Q, stride * R, stride)
        S = stride * R + np.swapaxes(B, -1, -2) @ P[stride:] @ B
        m, last = model.nu.shape[-1], len(A) - 1
        self.stride, self.horizon, self.dt = stride, horizon, dt
        self.K, self.F, self.u, self.x = K, A - B @ K, frozen(model.u), frozen(x)
        self.moves = np.swapaxes(np.linalg.inv(np.linalg.cholesky(S)), -1, -2)
        self.slopes, self.pushes = model.A[:, -m:], model.B[:, -m:]
        self.pulls = np.linalg.pinv(self.pushes)
        nu, soft = B.shape[-1], np.flatnonzero(kept)
        self.responses = np.empty((last + 1, horizon, nu + len(soft), nu))
        at, inputs, states = np.arange(last + 1), self.moves, B @ self.moves
        for late in range(horizon):
            self.responses[:, late, :nu], self.responses[:, late, nu:] = inputs, states[:, soft]
            at = np.minimum(at + stride, last)
            inputs, states = -self.K[at] @ states, self.F[at] @ states
        self.hessian, self.free = np.eye(horizon * nu), np.zeros(horizon * nu)
        self.sense = np.tile(np.repeat(np.array([0, _SOFT], np.int32), [nu, len(soft)]), horizon)

    def at(self, k: int) -> Any:
        """Return the samples of a horizon, shape (horizon + 1,); after the end, the last one stays."""
        return np.minimum(k + self.stride * np.arange(self.horizon + 1), len(self.u) - 1)

    def ahead(self, at: Any, dx: Array) -> tuple[Array, Array]:
        """Return inputs and next states with the gains alone, shape (horizon, nu), (horizon, n + m)."""
        states = np.empty((self.horizon + 1, len(dx)))
        states[0] = dx
        for j, step in enumerate(self.F[at[:-1]]):
            np.dot(step, states[j], out=states[j + 1])
        return -(self.K[at[:-1]] @ states[:-1, :, None])[..., 0], states[1:]

    def program(self, at: Any, lower: Array, upper: Array) -> Program:
        """Return the program of a horizon.

        Parameters
        ----------
        at : ndarray of int, shape (horizon + 1,)
            Its samples.
        lower, upper : ndarray, shape (horizon, nu + kept)
            Bounds of inputs and states beside those of the gains.
        """
        N, rows, nu = self.responses.shape[1:]
        A = np.zeros((N, rows, N * nu))
        for j, i in enumerate(at[:-1]):
            A[j:, :, j * nu : (j + 1) * nu] = self.responses[i, : N - j]
        return Program(
            self.hessian, self.free, A.reshape(N * rows, N * nu), lower.ravel(), upper.ravel(), self.sense
        )


def solver() -> Any:
    """Return ``daqp.solve``.

    Raises
    ------
    InvalidArgument
        If it is not installed.
    """
    return imported("daqp", "mpc", "MPC").solve
