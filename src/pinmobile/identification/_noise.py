"""Noise of forces in the residuals of segments: its covariance, and how far it pulls estimates.

Noise of a logged force is in the simulation, and so in its slopes too: it would pull parameters to where it
does less, such as to a larger inertia. A second draw of it shows by how much, and that is taken off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.identification._estimator import Fit, Linear
from pinmobile.identification._simulation import Model, Segments, simulate

_MEMORY = 0.15  # [s] of a force that is not noise: Matern's covariance of order 3/2
_WIDEST = 1e12  # between shares of both noises in a residual that are tried, as a ratio
_SHAKE = 1e-2  # of an input's deviation, to see what noise of it does
_DRAWS = 3  # of noise, by which estimates have a sixth more of what is due to products of noise


@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """Noise of the residuals: of sensors, and of forces.

    Attributes
    ----------
    usual : ndarray, shape (m, L, L)
        Inverse roots of the covariance of a segment that lacks no sample, of each sensor.
    others : dict of int to ndarray, shape (m, L, L)
        The same of segments that lack some, by their number.
    remembers : bool
        Whether a force that remembers is likelier behind the residuals than one that does not.
    share : ndarray, shape (m,)
        Of the squares of a segment's white residuals, the part of the force.
    """

    usual: Array
    others: dict[int, Array]
    remembers: bool
    share: Array

    @classmethod
    def of(
        cls, residuals: Array, good: NDArray[np.bool_], dt: float, responses: Array, poses: int = 3
    ) -> ResidualNoise:
        """Return the likeliest noise of residuals.

        Parameters
        ----------
        residuals : ndarray, shape (S, L, m)
            Of poses, then of rates of wheels, over the noise of their sensors.
        good : ndarray of bool, shape (S, L)
            Samples that were measured.
        dt : float
            Time between two samples [s].
        responses : ndarray, shape (r, L, m)
            To inputs that are held for the first step of a segment.
        poses : int
            How many of the m are of the pose.
        """
        filled, lacking = residuals.copy(), np.flatnonzero(~good.all(axis=1) & good.any(axis=1))
        at = np.arange(residuals.shape[1])
        for s in lacking:
            for column in filled[s].T:
                column[:] = np.interp(at, at[good[s]], column[good[s]])
        lag = np.abs(at[:, None] - at) * dt / _MEMORY
        kernels = np.eye(len(at)), (1 + lag) * np.exp(-lag)
        costs, found = np.zeros(2), []
        for j in range(residuals.shape[2]):
            answers = [h for h in responses[..., j] if h.any()]
            tried = [_likeliest(filled[..., j], 1 + (j < poses), _moved(answers, each)) for each in kernels]
            costs += [each[0] for each in tried]
            found.append(tried[0][1:])
        V, root = np.array([each[0] for each in found]), _inverse_root(np.array([each[0] for each in found]))
        others = {
            int(s): _inverse_root(V * np.outer(good[s], good[s]) + np.diag(1.0 - good[s])) for s in lacking
        }
        share = len(at) - np.array([each[1] for each in found]) * (root**2).sum(axis=(1, 2))
        return cls(root, others, bool(costs[1] < costs[0]), share)

    def white(self, residuals: Array) -> Array:
        """Return residuals, shape (V, S, L, m), made white; zero where nothing was measured."""
        columns = np.moveaxis(residuals, -1, 0)  # (m, V, S, L)
        found = columns @ np.swapaxes(self.usual, 1, 2)[:, None]
        for s, root in self.others.items():
            found[:, :, s] = columns[:, :, s] @ np.swapaxes(root, 1, 2)
        return np.asarray(np.moveaxis(found, 0, -1))


def _inverse_root(V: Array) -> Array:
    return np.asarray(np.linalg.inv(np.linalg.cholesky(V)))


def _moved(responses: Sequence[Array], kernel: Array) -> Array:
    """Return the covariance of the response to a force of a covariance, both of shape (L, L), to a factor."""
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
    if not residuals.any():  # of a sensor that there is not
        return 0.0, np.eye(length), 1.0
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


def input_noise_gradient(model: Model, segments: Segments, found: Fit, noise: ResidualNoise) -> Array:
    """Return what noise of the inputs adds to the gradient, shape (P,): from other draws of it.

    Parameters
    ----------
    model, segments, found
        The problem, and where it is looked at.
    noise : ResidualNoise
        Of the residuals.
    """
    generator, unit = np.random.default_rng(0), _SHAKE * segments.sizes

    def shaken(size: Array) -> Segments:
        more = generator.standard_normal(segments.inputs.shape) * size
        return segments._replace(inputs=segments.inputs + more)

    def left(part: Segments) -> Array:
        out = simulate(model, part, found.p[None], found.starts[None])
        return np.asarray(noise.white(part.weighed(part.y - out))[0])

    before = left(segments)
    power = [((left(shaken(row)) - before) ** 2).mean(axis=0).sum(axis=0) for row in np.diag(unit)]
    sizes = unit * np.sqrt(_variances(np.array(power).T, noise.share))
    near, total = Linear.of(model, segments, found.p, found.starts, noise.white), np.zeros(len(found.p))
    for _ in range(_DRAWS):
        there = Linear.of(model, shaken(sizes), found.p, found.starts, noise.white)
        way, slopes = (there.raw - near.raw)[..., None], there.slopes - near.slopes
        way = way - near.Q @ (np.swapaxes(near.Q, 1, 2) @ way)
        total = total + np.einsum("sni,sn->i", slopes, way[..., 0]) / _DRAWS
    return total


def _variances(power: Array, share: Array) -> Array:
    """Return the variances of inputs, none below zero, that explain shares of residuals best.

    Parameters
    ----------
    power : ndarray, shape (m, nu)
        Of residuals, per variance.
    share : ndarray, shape (m,)
        Of residuals.
    """
    from scipy.optimize import nnls  # here, because it takes long to load

    scale = np.maximum(power.max(axis=1), np.finfo(float).tiny)
    return np.asarray(nnls(power / scale[:, None], np.maximum(share, 0.0) / scale)[0])
