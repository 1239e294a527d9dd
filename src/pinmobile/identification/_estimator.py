"""Output error: least squares of the residuals between a log and simulations of its segments, for any model.

A QR factorisation projects the initial states of the segments out of the Jacobian, so the search is over the
numbers of the model only. One call simulates all trial values of numbers and initial states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification._simulation import Model, Segments, linearize, simulate

NORMAL = 1.4826  # standard deviation of a normal distribution per median absolute one
White = Callable[[Array], Array]
_PASSES = 2  # passes that find initial states
_SHARES = np.array([1.0, 0.5, 0.2, 0.05, 0.0])  # tried shares of the step of an initial state
_CONVERGED = 1e-7  # relative change of the cost
_EVALUATIONS = 40  # largest number of evaluations of the cost
_ROUNDS = 4  # updates of weights and outliers
_OUTLIER = 6.0  # standard deviations
_CLUSTER = 2  # samples: an outlier has at most one other outlier within this distance
_UNSEEN = 1e-10  # smaller eigenvalues of the scaled normal matrix count as zero


class Linear(NamedTuple):
    """Linearised white residuals: e - J times a step of the numbers, without the initial states.

    Attributes
    ----------
    J, e : ndarray, shape (S, n, P), (S, n)
        Slopes and residuals after the projection that removes initial states.
    Q, R : ndarray
        QR factors of the slopes with respect to the initial states.
    raw, slopes : ndarray, shape (S, n), (S, n, P)
        Residuals and slopes before the projection.
    residual : ndarray, shape (S, L, m)
        Measured minus simulated values.
    """

    J: Array
    e: Array
    Q: Array
    R: Array
    raw: Array
    slopes: Array
    residual: Array

    @classmethod
    def of(cls, model: Model, segments: Segments, p: Array, starts: Array, white: White) -> Linear:
        """Return the linear problem at numbers and initial states.

        Raises
        ------
        InvalidArgument
            If the simulation diverges.
        """
        out, slopes = linearize(model, segments, p, starts)
        residual = segments.y - out
        if not np.isfinite(residual).all():
            raise unexplained(0.0)
        rows = white(segments.weighed(np.concatenate([residual[None], slopes])))
        columns = np.moveaxis(rows.reshape(*rows.shape[:2], -1), 0, -1)
        raw, slopes, by_start = np.split(columns, [1, 1 + len(p)], axis=-1)
        Q, R = np.linalg.qr(by_start)
        size = np.abs(np.diagonal(R, axis1=1, axis2=2))
        # The measurements do not depend on states without a diagonal entry: their columns of Q are arbitrary.
        Q = Q * (size > _UNSEEN * size.max(axis=1, keepdims=True))[:, None]
        J, e = (each - Q @ (np.swapaxes(Q, 1, 2) @ each) for each in (slopes, raw))
        return cls(J, e[..., 0], Q, R, raw[..., 0], slopes, residual)

    def starts(self, step: Array) -> Array:
        """Return the change of the initial states, shape (S, n), for a step of the numbers."""
        rest = np.swapaxes(self.Q, 1, 2) @ (self.raw - self.slopes @ step)[..., None]
        return np.asarray((np.linalg.pinv(self.R, rcond=_UNSEEN) @ rest)[..., 0])


class Fit(NamedTuple):
    """Numbers, shape (P,), initial states, shape (S, n), the linear problem there, and a mask of samples."""

    p: Array
    starts: Array
    near: Linear
    good: NDArray[np.bool_]


def unexplained(share: float) -> InvalidArgument:
    """Return the error for a log with inputs that explain too small a share of the motion."""
    return InvalidArgument(
        f"log has inputs that explain {max(share, 0.0):.0%} of the motion, expected most of it: are the "
        "inputs from another robot, in another frame, with another sign, or in other units?"
    )


def solve(
    model: Model,
    segments: Segments,
    p: Array,
    *,
    moves: Any = True,
    white: White = lambda residuals: residuals,
    starts: Array | None = None,
    shift: Array | float = 0.0,
) -> Fit:
    """Return the least squares of white residuals over numbers and initial states.

    Parameters
    ----------
    model, segments : Model, Segments
        Model of the robot, and segments of its logs.
    p : ndarray, shape (P,)
        Initial numbers.
    moves : bool or ndarray of bool, shape (P,)
        Mask of the unknown numbers; the others remain.
    white : callable
        Function that whitens residuals divided by the noise, shape (V, S, L, m), to variance 1.
    starts : ndarray, shape (S, n), optional
        Initial states, if known.
    shift : ndarray, shape (S, n)
        Offset of the white residuals.

    Raises
    ------
    InvalidArgument
        If the simulation diverges.
    """
    from scipy.optimize import least_squares  # slow to load

    free = np.broadcast_to(np.asarray(moves), p.shape)
    at, z = p, segments.start if starts is None else starts
    near, last = Linear.of(model, segments, at, z, white), (at, z)

    def rows(x: Array) -> Array:
        nonlocal last
        tried = at.copy()
        tried[free] = x
        if not model.is_possible(tried):
            return np.full(near.raw.size, np.inf)
        ways = z + _SHARES[:, None, None] * near.starts(tried - at)
        with np.errstate(all="ignore"):
            out = simulate(model, segments, np.tile(tried, (len(ways), 1)), ways)
            found = white(segments.weighed(segments.y - out)).reshape(*out.shape[:2], -1) + shift
            costs = np.nan_to_num((found**2).sum(axis=-1), nan=np.inf)
        best = costs.argmin(axis=0), np.arange(len(z))
        last = tried, ways[best]
        return np.asarray(found[best].ravel())

    def jacobian(x: Array) -> Array:
        nonlocal at, z, near
        if last[0] is not at and np.array_equal(last[0][free], x):
            at, z = last
            near = Linear.of(model, segments, at, z, white)
        return -near.J.reshape(near.raw.size, len(p))[:, free]

    for _ in range(_PASSES if starts is None else 0):
        rows(at[free])
        jacobian(at[free])
    if free.any():
        limits = {"ftol": _CONVERGED, "xtol": _CONVERGED, "gtol": None, "max_nfev": _EVALUATIONS}
        jacobian(least_squares(rows, at[free], jacobian, x_scale=model.sizes(at)[free], **limits).x)
    return Fit(at, z, near, segments.good)


def solve_robustly(
    model: Model, segments: Segments, p: Array, *, calm: NDArray[np.bool_], natural: Any = None
) -> tuple[Fit, NDArray[np.bool_]]:
    """Return the least squares with iterative weights and without outliers, and a mask of hidden numbers.

    Parameters
    ----------
    model, segments, p
        See `solve`.
    calm : ndarray of bool, shape (S, L)
        Mask of the samples of the first round.
    natural : callable, optional
        Function of p that returns typical sizes, shape (P,), and prior values. Numbers that are not
        identifiable keep their prior value. None: all numbers remain.

    Raises
    ------
    InvalidArgument
        If the simulation diverges.
    """
    good, starts, moves = segments.good & calm, None, np.full(len(p), natural is not None)
    covariance = np.diag(np.maximum(np.var(segments.y[calm], axis=0), 1e-12))
    for _ in range(_ROUNDS):
        white = _by(covariance)
        found = solve(model, segments._replace(good=good), p, moves=moves, white=white, starts=starts)
        p, starts, left, counted = found.p, found.starts, found.near.residual, good
        deviation = NORMAL * np.median(np.abs(left[good]), axis=0) + 1e-300
        far = np.asarray((np.abs(left) > _OUTLIER * deviation).any(axis=-1))
        good = segments.good & ~_alone(far, segments.good)
        if good.sum() <= left.shape[-1]:
            raise unexplained(0.0)
        before, covariance = covariance, _covariance(left[good & counted])
        lost = ~moves
        if natural is not None:
            near = Linear.of(model, segments._replace(good=good), p, starts, _by(covariance))
            sizes, guess = natural(p)
            lost = hidden(near.J, sizes)
        if (good == counted).all() and np.allclose(covariance, before, rtol=0.02, atol=0):
            break
        if natural is not None:
            moves, p = ~lost, np.where(lost, guess, p)
    return found, lost | ~moves


def _alone(far: NDArray[np.bool_], seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the samples that are far off without others nearby: a cluster is an error of the model."""
    from scipy.ndimage import uniform_filter1d  # slow to load

    near = uniform_filter1d((far & seen).astype(float), 2 * _CLUSTER + 1, axis=1, mode="constant")
    return np.asarray(far & (near * (2 * _CLUSTER + 1) < _CLUSTER + 0.5))


def white_of(residuals: Array) -> White:
    """Return a function that whitens residuals, shape (..., m), by the covariance of some, shape (n, m)."""
    return _by(_covariance(residuals))


def _covariance(residuals: Array) -> Array:
    """Return the covariance of residuals, shape (m, m), which is not singular."""
    found = np.cov(residuals.T)
    return np.asarray(found + np.diag(1e-24 + 1e-12 * np.diag(found)))


def _by(covariance: Array) -> White:
    """Return a function that whitens residuals of a covariance, shape (..., m)."""
    weight = np.linalg.inv(np.linalg.cholesky(covariance)).T
    return lambda residuals: residuals @ weight


def scaled(H: Array) -> tuple[Array, Array]:
    """Return a normal matrix scaled to a diagonal of ones, and the scales; 0 for numbers without effect."""
    diagonal = np.diag(H)
    seen = diagonal > 1e-30 * max(float(diagonal.max(initial=0.0)), 1e-270)
    size = np.where(seen, 1 / np.sqrt(np.where(seen, diagonal, 1.0)), 0.0)
    return H * np.outer(size, size), size


def hidden(J: Array, sizes: Array) -> NDArray[np.bool_]:
    """Return a mask of numbers that are not identifiable: their standard errors exceed their sizes."""
    R, size = scaled(np.einsum("smp,smq->pq", J, J))
    values, vectors = np.linalg.eigh(R)
    seen = values > _UNSEEN
    deviations = size * np.sqrt((vectors[:, seen] ** 2 / values[seen]).sum(axis=1))
    lost = (np.abs(vectors[:, ~seen]) > 0.1).any(axis=1)
    return np.asarray(lost | (size == 0) | (deviations > sizes))


def jackknife(near: Linear, pull: Array | float = 0.0, blocks: int = 1) -> tuple[Array, int]:
    """Return the covariance by the jackknife, CR3 (Bell and McCaffrey 2002), shape (P, P), and its blocks.

    Parameters
    ----------
    near : Linear
        Linear problem at the estimate.
    pull : ndarray, shape (P,)
        Gradient of the cost at the estimate, which a shift of the residuals causes.
    blocks : int
        Number of blocks of each segment.

    Raises
    ------
    InvalidArgument
        If only one block identifies a number.
    """
    P = near.J.shape[-1]
    J, e = near.J.reshape(len(near.J) * blocks, -1, P), near.e.reshape(len(near.J) * blocks, -1)
    used = J.any(axis=(1, 2))
    J, e, S = J[used], e[used], int(used.sum())
    H = np.einsum("smp,smq->spq", J, J)
    _, size = scaled(H.sum(axis=0))
    g = (np.einsum("smp,sm->sp", J, e) - pull / S) * size
    try:
        d = np.linalg.solve((H.sum(axis=0) - H) * np.outer(size, size), g[..., None])[..., 0] * size
    except np.linalg.LinAlgError as error:
        raise InvalidArgument(
            f"log has {S} blocks, and only one of them identifies some parameter, expected a longer log or "
            "a more informative motion, see excitation"
        ) from error
    return np.asarray((S - 1) / S * d.T @ d), S


class Whiteness(NamedTuple):
    """Autocorrelation of residuals.

    Attributes
    ----------
    correlation : ndarray, shape (m,)
        Correlation of successive residuals of each measurement.
    bound : float
        95 % bound of white noise.
    """

    correlation: Array
    bound: float

    @property
    def is_white(self) -> bool:
        """Whether the residuals look like white noise."""
        return bool((np.abs(self.correlation) <= 1.5 * self.bound).all())

    @classmethod
    def of(cls, residuals: Array, good: NDArray[np.bool_]) -> Whiteness:
        """Return the whiteness of residuals (S, L, m), for samples that are good (S, L)."""
        rows, segment = residuals[good], np.nonzero(good)[0]
        pairs = np.flatnonzero(np.diff(segment) == 0)
        product = (rows[pairs + 1] * rows[pairs]).sum(axis=0) / max(len(pairs), 1)
        power = (rows**2).mean(axis=0)
        return cls(product / np.maximum(power, np.finfo(float).tiny), 1.96 / np.sqrt(float(len(rows))))


_MEMORY = 0.15  # [s], correlation time of a force that is not white noise: Matern covariance of order 3/2
_WIDEST = 1e12  # largest tried ratio of the two noises in a residual
_SHAKE = 1e-2  # size of trial noise of an input, as a share of its standard deviation
_DRAWS = 3  # draws of noise


@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """Noise of the residuals: sensor noise and force noise.

    Attributes
    ----------
    usual : ndarray, shape (m, L, L)
        Inverse roots of the covariance of a complete segment, for each sensor.
    others : dict of int to ndarray, shape (m, L, L)
        Inverse roots for segments with lost samples, by index.
    remembers : bool
        Whether a correlated force is a more likely cause of the residuals than white force noise.
    share : ndarray, shape (m,)
        Part of the force noise in the squares of the white residuals of a segment.
    """

    usual: Array
    others: dict[int, Array]
    remembers: bool
    share: Array

    @classmethod
    def of(
        cls, residuals: Array, good: NDArray[np.bool_], dt: float, responses: Array, poses: int = 3
    ) -> ResidualNoise:
        """Return the most likely noise of residuals.

        Parameters
        ----------
        residuals : ndarray, shape (S, L, m)
            Residuals of poses, then of wheel rates, divided by the sensor noise.
        good : ndarray of bool, shape (S, L)
            Mask of measured samples.
        dt : float
            Time step [s].
        responses : ndarray, shape (r, L, m)
            Responses to inputs during the first time step of a segment.
        poses : int
            Number of pose measurements among the m.
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
        """Return white residuals, shape (V, S, L, m); zero without a measurement."""
        columns = np.moveaxis(residuals, -1, 0)  # (m, V, S, L)
        found = columns @ np.swapaxes(self.usual, 1, 2)[:, None]
        for s, root in self.others.items():
            found[:, :, s] = columns[:, :, s] @ np.swapaxes(root, 1, 2)
        return np.asarray(np.moveaxis(found, 0, -1))


def _inverse_root(V: Array) -> Array:
    return np.asarray(np.linalg.inv(np.linalg.cholesky(V)))


def _moved(responses: Sequence[Array], kernel: Array) -> Array:
    """Return the covariance, up to a factor, of the responses to a force with a covariance, shape (L, L)."""
    from scipy.linalg import matmul_toeplitz  # slow to load

    if not responses:
        return kernel
    total, none = np.zeros_like(kernel), np.zeros(len(kernel))
    for h in responses:
        total = total + matmul_toeplitz((h, none), matmul_toeplitz((h, none), kernel).T)
    return np.asarray(total / np.trace(total))


def _likeliest(residuals: Array, order: int, moved: Array) -> tuple[float, Array, float]:
    """Return cost, covariance and sensor variance of the most likely shares of two noises in residuals.

    Parameters
    ----------
    residuals : ndarray, shape (S, L)
        Residuals of one sensor.
    order : int
        Number of powers of time that initial states explain.
    moved : ndarray, shape (L, L)
        Covariance of the effect of force noise, up to a factor.
    """
    from scipy.linalg import null_space  # slow to load
    from scipy.optimize import minimize_scalar

    length = residuals.shape[1]
    if not residuals.any():  # there is no such sensor
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
    """Return the contribution of input noise to the gradient, shape (P,), from additional draws of noise.

    Parameters
    ----------
    model, segments : Model, Segments
        Model of the robot, and segments of its logs.
    found : Fit
        Fit at which the gradient is computed.
    noise : ResidualNoise
        Noise of the residuals.
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
    """Return the nonnegative variances of inputs that explain shares of the residuals best.

    Parameters
    ----------
    power : ndarray, shape (m, nu)
        Power of residuals per variance of each input.
    share : ndarray, shape (m,)
        Part of force noise in the residuals.
    """
    from scipy.optimize import nnls  # slow to load

    scale = np.maximum(power.max(axis=1), np.finfo(float).tiny)
    return np.asarray(nnls(power / scale[:, None], np.maximum(share, 0.0) / scale)[0])
