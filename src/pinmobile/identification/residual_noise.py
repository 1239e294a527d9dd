"""`ResidualNoise`: what the noise of a logged force leaves in residuals of output error, and what whitens it.

Noise of the force that is logged is in the simulation, not in the robot: of a segment it leaves in the poses
what they answer to it, about its double integral. So the residual of a sensor has the covariance, between the
times of a segment::

    V = s_0 I + s_1 G G'

with G the responses to the inputs. s_0 and s_1 are those of largest likelihood of what first states cannot
explain: restricted maximum likelihood (Patterson and Thompson 1971). With V = L L', the residuals L^-1 e are
what a Kalman filter would call innovations: if they are white, V is right, and least squares of them is the
most likely estimate, its deviations about half of those that the residuals as they are lead to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pinmobile.arrays import Array

_MEMORY = 0.15  # [s] of a force that is not noise: Matern's covariance of order 3/2
_WIDEST = 1e12  # between shares of both noises in a residual that are tried, as a ratio


@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """The noise of a log's residuals.

    Attributes
    ----------
    usual : ndarray, shape (m, L, L)
        What makes residuals of a segment white that lacks no sample: the inverse of L, of each sensor.
    others : mapping of int to ndarray, shape (m, L, L)
        The same of segments that lack some, by their number.
    remembers : bool
        Whether a force that remembers is likelier behind the residuals than one that does not.
    share : ndarray, shape (m,)
        Of the squares of a segment's white residuals, what is the force's.
    """

    usual: Array
    others: Mapping[int, Array]
    remembers: bool
    share: Array

    @classmethod
    def of(cls, residuals: Array, good: Array, dt: float, responses: Array, poses: int = 3) -> ResidualNoise:
        """Return the noise that residuals tell.

        Parameters
        ----------
        residuals : ndarray, shape (S, L, m)
            Of poses, then of rates of wheels, over the noise of their sensors.
        good : ndarray, shape (S, L)
            1 where something was measured.
        dt : float
            Time between two samples [s].
        responses : ndarray, shape (r, L, m)
            To inputs that are held for the first step of a segment.
        poses : int
            How many of the m are of the pose.
        """
        filled, lacking = residuals.copy(), np.flatnonzero((good < 1).any(axis=1))
        at = np.arange(residuals.shape[1])
        for s in lacking:
            there = good[s] > 0
            for j in range(residuals.shape[2]) if there.any() else ():
                filled[s, :, j] = np.interp(at, at[there], residuals[s, there, j])
        lag = np.abs(at[:, None] - at) * dt / _MEMORY
        kernels = np.eye(len(at)), (1 + lag) * np.exp(-lag)
        costs, V, sensors = np.zeros(2), [], []
        for j in range(residuals.shape[2]):
            order, answers = 1 + (j < poses), [h for h in responses[..., j] if h.any()]
            tried = [_likeliest(filled[..., j], order, _moved(answers, kernel)) for kernel in kernels]
            costs += [each[0] for each in tried]
            V.append(tried[0][1])
            sensors.append(tried[0][2])
        usual, others = np.array(V), {}
        for s in lacking:
            there = np.outer(good[s], good[s])
            others[int(s)] = _inverse_root(usual * there + np.diag(1 - good[s]))
        root = _inverse_root(usual)
        share = len(at) - np.array(sensors) * (root**2).sum(axis=(1, 2))
        return cls(root, others, bool(costs[1] < costs[0]), share)

    def whitened(self, residuals: Array) -> Array:
        """Return residuals, shape (S, V, L, m), made white; zero where nothing was measured."""
        columns = np.moveaxis(residuals, -1, 0)  # (m, S, V, L)
        white = columns @ np.swapaxes(self.usual, 1, 2)[:, None]
        for s, root in self.others.items():
            white[:, s] = columns[:, s] @ np.swapaxes(root, 1, 2)
        return np.asarray(np.moveaxis(white, 0, -1))


def _inverse_root(V: Array) -> Array:
    return np.asarray(np.linalg.inv(np.linalg.cholesky(V)))


def _moved(responses: Sequence[Array], kernel: Array) -> Array:
    """Return the covariance of what a force of a covariance leaves, both of shape (L, L), to a factor."""
    from scipy.linalg import matmul_toeplitz  # here, because it takes long to load

    if not responses:
        return kernel
    total, none = np.zeros_like(kernel), np.zeros(len(kernel))
    for h in responses:
        total = total + matmul_toeplitz((h, none), matmul_toeplitz((h, none), kernel).T)
    return np.asarray(total / np.trace(total))


def _likeliest(residuals: Array, order: int, moved: Array) -> tuple[float, Array, float]:
    """Return cost, covariance and the sensor's variance of the likeliest shares of two noises in residuals.

    Parameters
    ----------
    residuals : ndarray, shape (S, L)
        Of one sensor.
    order : int
        How many powers of time first states explain.
    moved : ndarray, shape (L, L)
        Covariance of what noise of forces leaves, but for its size.
    """
    from scipy.linalg import null_space  # here, because these take long to load
    from scipy.optimize import minimize_scalar

    length = residuals.shape[1]
    free = null_space(np.vander(np.arange(length) / length, order).T).T  # what first states cannot explain
    sizes, vectors = np.linalg.eigh(free @ moved @ free.T)
    sizes = np.maximum(sizes / sizes.mean(), 0.0)
    power = ((residuals @ free.T @ vectors) ** 2).mean(axis=0)

    def cost(share: float) -> float:
        each = 1 + np.exp(share) * sizes
        return float(np.log(each).sum() + len(each) * np.log((power / each).mean()))

    edge = np.log(_WIDEST)
    found = minimize_scalar(cost, bounds=(-edge, edge), method="bounded", options={"xatol": 1e-2})
    ratio = float(np.exp(found.x))
    white = float((power / (1 + ratio * sizes)).mean())
    scale = np.trace(free @ moved @ free.T) / len(sizes)
    return float(found.fun), np.asarray(white * (np.eye(length) + ratio / scale * moved)), white
