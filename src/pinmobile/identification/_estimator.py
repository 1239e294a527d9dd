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
from pinmobile.errors import InvalidArgument, argument_errors
from pinmobile.identification._simulation import Model, Segments, by_groups, linearize, simulate

NORMAL = 1.4826  # standard deviation of a normal distribution per median absolute one
White = Callable[[Array, NDArray[np.bool_]], Array]
_PASSES = 20  # largest number of passes that find initial states
_FIRST_PASSES = 2  # the same for first numbers, whose errors initial states should not compensate
_START_RATIO = 2.0  # ratio of the squares and their least value with the best initial states, as above
_START_TOLERANCE = 0.01  # largest decrease of the squares of a segment by a further pass [variances]
_SHARES = np.array([1.0, 0.5, 0.2, 0.05, 0.0])  # tried shares of the step of an initial state
_STEP_TOLERANCE = 0.03  # root mean square of the last step of the numbers [standard errors]
_THIN = 6  # ratio of the numbers of segments in successive searches
_EVALUATIONS = 40  # largest number of evaluations of the cost
_ROUNDS = 4  # updates of weights and outliers
_OUTLIER = 6.0  # standard deviations
_CLUSTER = 2  # samples: an outlier has at most one other outlier within this distance
_TINY = np.finfo(float).tiny
_RANK_TOL = 1e-10  # smaller eigenvalues of the scaled normal matrix count as zero


class Linear(NamedTuple):
    """Least squares of linearised white residuals, e - J times a step of the numbers, without initial states.

    Attributes
    ----------
    normal : ndarray, shape (S, blocks, 1 + P, 1 + P)
        Products of the columns e and J of each block.
    start_change : ndarray, shape (S, n, 1 + P)
        Best change of the initial states, and minus its slopes by the numbers.
    e : ndarray, shape (S, L m)
        White residuals without the part that initial states explain.
    squares : ndarray, shape (S,)
        Sums of the squares of white residuals.
    residual : ndarray, shape (S, L, m)
        Measured minus simulated values.
    """

    normal: Array
    start_change: Array
    e: Array
    squares: Array
    residual: Array

    @classmethod
    def of(
        cls, model: Model, segments: Segments, p: Array, starts: Array, white: White, moves: Any = True
    ) -> Linear:
        """Return the linear problem at numbers and initial states.

        The slopes by the other numbers than those of the mask `moves` are zero.

        Raises
        ------
        InvalidArgument
            If the simulation diverges.
        """
        P, n = len(p), starts.shape[1]
        numbers = np.flatnonzero(np.broadcast_to(moves, P))
        places = np.append(0, 1 + numbers)

        def reduce_group(part: Segments, group: slice) -> tuple[Array, ...]:
            residual, columns, Q, R = _columns(model, part, p, starts[group], white, numbers)
            normal = np.zeros((len(residual), part.blocks, 1 + P, 1 + P))
            change = np.zeros((len(residual), n, 1 + P))
            product, squares = np.swapaxes(Q, 1, 2) @ columns, (columns[..., 0] ** 2).sum(axis=1)
            change[..., places], columns = np.linalg.pinv(R, rcond=_RANK_TOL) @ product, columns - Q @ product
            rows = columns.reshape(len(columns), part.blocks, -1, columns.shape[2])
            normal[..., places[:, None], places] = np.swapaxes(rows, 2, 3) @ rows
            return normal, change, columns[..., 0].copy(), squares, residual

        return cls(*by_groups(reduce_group, segments, len(places) + n))

    @property
    def information(self) -> Array:
        """Normal matrix of the numbers, shape (P, P)."""
        return np.asarray(self.normal[..., 1:, 1:].sum(axis=(0, 1)))

    def step(self, mask: NDArray[np.bool_]) -> Array:
        """Return the step of the numbers, shape (P,), to the optimum of some segments, or blocks of them."""
        normal = self.normal[mask].reshape(-1, *self.normal.shape[2:]).sum(axis=0)
        return np.asarray(np.linalg.pinv(normal[1:, 1:], hermitian=True) @ normal[0, 1:])

    def starts(self, step: Array) -> Array:
        """Return the change of the initial states, shape (S, n), for a step of the numbers."""
        return np.asarray(self.start_change[..., 0] - self.start_change[..., 1:] @ step)


def _columns(
    model: Model, segments: Segments, p: Array, starts: Array, white: White, numbers: NDArray[np.int_]
) -> tuple[Array, Array, Array, Array]:
    """Return residuals, white ones and slopes by F numbers (S, L m, 1 + F), and QR of initial states."""
    outputs, slopes = linearize(model, segments, p, starts, numbers)
    residual = segments.y - outputs
    if not np.isfinite(residual).all():
        raise unexplained_error(0.0)
    rows = white(segments.weigh(np.concatenate([residual[None], slopes])), segments.good)
    columns = np.moveaxis(rows.reshape(*rows.shape[:2], -1), 0, -1)
    columns, by_start = np.split(columns, [1 + len(numbers)], axis=-1)
    Q, R = np.linalg.qr(by_start)
    size = np.abs(np.diagonal(R, axis1=1, axis2=2))
    # The measurements do not depend on states without a diagonal entry: their columns of Q are arbitrary.
    return residual, columns, Q * (size > _RANK_TOL * size.max(axis=1, keepdims=True))[:, None], R


def _nearest(
    model: Model, segments: Segments, p: Array, starts: Array, steps: Array, white: White
) -> tuple[float, Array]:
    """Return the cost, and the initial states, (S, n), by the best share of a step for each segment."""

    def simulate_group(part: Segments, group: slice) -> tuple[Array, ...]:
        ways = starts[group] + _SHARES[:, None, None] * steps[group]
        with np.errstate(all="ignore"):
            outputs = simulate(model, part, np.tile(p, (len(ways), 1)), ways)
            costs = (white(part.weigh(part.y - outputs), part.good) ** 2).sum(axis=(2, 3))
        best = np.nan_to_num(costs, nan=np.inf, posinf=np.inf).argmin(axis=0), np.arange(ways.shape[1])
        return costs[best], ways[best]

    costs, states = by_groups(simulate_group, segments, len(_SHARES))
    return float(np.nan_to_num(costs.sum(), nan=np.inf, posinf=np.inf)), states


class Fit(NamedTuple):
    """Numbers, shape (P,), initial states, shape (S, n), the linear problem there, and a mask of samples."""

    p: Array
    starts: Array
    linear: Linear
    good: NDArray[np.bool_]


def unexplained_error(share: float) -> InvalidArgument:
    """Return the error for a log with inputs that explain too small a share of the motion."""
    return InvalidArgument(
        f"log has inputs that explain {max(share, 0.0):.0%} of the motion, expected most of it: are the "
        "inputs from another robot, in another frame, with another sign, or in other units?"
    )


def check_share(share: float, least: float) -> None:
    """Reject a log with inputs that explain too small a share of the motion."""
    if share < least:
        raise unexplained_error(share)


def _settle_starts(
    model: Model, segments: Segments, p: Array, starts: Array, white: White, moves: Any, passes: int = _PASSES
) -> tuple[Linear, Array]:
    """Return the linear problem at numbers and the best initial states near some, and these states."""
    best, starts = Linear.of(model, segments, p, starts, white, moves), starts.copy()
    improves = np.ones(len(starts), dtype=bool)
    for _ in range(passes):
        minimum = best.normal[..., 0, 0].sum(axis=1)
        least = _START_TOLERANCE * minimum.sum() / segments.good.sum()
        rows = np.flatnonzero(improves & (best.squares - minimum > least))
        if not rows.size:
            break
        part, change = segments.select(rows), best.start_change[rows, :, 0]
        _, trial = _nearest(model, part, p, starts[rows], change, white)
        improves[rows] = (trial != starts[rows]).any(axis=1)
        starts[rows], rows = trial, rows[improves[rows]]
        if rows.size:
            linear = Linear.of(model, segments.select(rows), p, starts[rows], white, moves)
            for all_of, update in zip(best, linear, strict=True):
                all_of[rows] = update
    return best, starts


class _Point(NamedTuple):
    """Scaled numbers, initial states, the linear problem there, half the squares, derivatives, Newton's step.

    The gradient is zero if the step is small compared to standard errors. The second derivatives are those of
    Gauss and Newton. The least product of a notable step and its gradient is last.
    """

    y: Array
    starts: Array
    linear: Linear
    cost: float
    gradient: Array
    hessian: Array
    step: Array
    notable: float


def solve(
    model: Model,
    segments: Segments,
    p: Array,
    *,
    moves: Any = True,
    white: White = lambda residuals, _: residuals,
    starts: Array | None = None,
    pull: Array | float = 0.0,
    passes: int = _PASSES,
) -> Fit:
    """Return the least squares of white residuals over numbers and initial states.

    A trust region limits the steps of Gauss and Newton. The search begins with a few of many segments, unless
    a search with other weights gave the initial states. It ends with a step far below the standard errors,
    which the scatter of the blocks' gradients shows.

    Parameters
    ----------
    model, segments : Model, Segments
        Model of the robot, and segments of its logs.
    p : ndarray, shape (P,)
        Initial numbers.
    moves : bool or ndarray of bool, shape (P,)
        Mask of the unknown numbers; the others remain.
    white : callable
        Function that whitens residuals divided by the noise, shape (V, S, L, m), to variance 1. Its second
        argument is the mask of the samples that count.
    starts : ndarray, shape (S, n), optional
        Initial states, if known.
    pull : ndarray, shape (P,)
        J'e at the solution, see `Linear`.
    passes : int
        Largest number of passes that find initial states at each trial. If 0, the cost of a trial is that of
        the best linear change of its initial states: for measurements that start them well.

    Raises
    ------
    InvalidArgument
        If the simulation diverges.
    """
    from scipy.optimize import minimize  # slow to load

    free, few = np.broadcast_to(np.asarray(moves), p.shape), slice(None, None, min(segments.few.step, _THIN))
    z = segments.start if starts is None else starts
    is_linear, first = passes == 0, _FIRST_PASSES if few.step == 1 and free.any() else passes
    if free.any() and few.step > 1 and (starts is None or is_linear):
        part, share, given = segments.select(few), len(z[few]) / len(z), None if starts is None else z[few]
        p = solve(model, part, p, moves=free, white=white, starts=given, pull=share * pull).p
    if starts is None or not free.any():
        linear, z = _settle_starts(model, segments, p, z, white, False, first)
    if not free.any():
        return Fit(p, z, linear, segments.good)
    size = np.where(free, model.sizes(p), 0.0)

    def point(y: Array, z: Array, passes: int) -> _Point:
        best, z = _settle_starts(model, segments, p + size * y, z, white, free, passes)
        H, g = best.information * np.outer(size, size), best.normal[..., 0, 1:].reshape(-1, len(p)) * size
        g = g - pull * size / len(g)
        inverse, descent = np.linalg.pinv(H, rcond=_RANK_TOL, hermitian=True), g.sum(axis=0)
        noise = max(best.normal[..., 0, 0].sum() / best.e.size, ((g @ inverse) * g).sum())
        notable = _STEP_TOLERANCE**2 * noise
        step, left = inverse @ descent, best.normal[..., 0, 0] if is_linear else best.squares
        cost = left.sum() / 2 + pull * size @ y
        slope, regular = -descent * (descent @ step > notable), _RANK_TOL * np.diag(H).max() * np.eye(len(p))
        return _Point(y, z, best, cost, slope, H + regular, step, notable)

    last = point(np.zeros(len(p)), z, min(first, passes) * (starts is not None))

    def evaluate(y: Array) -> _Point:
        nonlocal last
        if (y == last.y).all():
            return last
        q, way, cost = p + size * y, last.linear.starts(size * (y - last.y)), np.inf
        if model.is_possible(q):
            cost, trial_starts = _nearest(model, segments, q, last.starts, way, white)
        if not np.isfinite(cost):
            return last._replace(cost=np.inf)
        is_settled = last.linear.squares.sum() < _START_RATIO * last.linear.normal[..., 0, 0].sum()
        last = point(y, trial_starts, passes * is_settled)
        return last

    def check(intermediate_result: Any) -> None:  # SciPy passes results by this name
        """Stop at a kink, such as a delay of whole samples: steps that fail are no longer notable."""
        failed = last.y - intermediate_result.x
        if 0 < failed @ last.hessian @ failed < last.notable:
            raise StopIteration

    options = {"method": "trust-exact", "jac": True, "options": {"gtol": _TINY, "maxiter": _EVALUATIONS}}
    options["callback"] = check
    minimum = minimize(lambda y: evaluate(y)[3:5], last.y, hess=lambda y: evaluate(y).hessian, **options)
    last = evaluate(minimum.x)
    p, step = p + size * minimum.x, size * last.step * (not last.gradient.any())
    step = step * model.is_possible(p + step)
    return Fit(p + step, last.starts + last.linear.starts(step), last.linear, segments.good)


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
    good, starts, moves, few = segments.good & calm, None, np.full(len(p), natural is not None), segments.few
    covariance = np.diag(np.maximum(np.var(segments.y[calm], axis=0), 1e-12))
    if few.step > 1:
        fit, weak = solve_robustly(model, segments.select(few), p, calm=calm[few], natural=natural)
        p, moves, covariance = fit.p, moves & ~weak, _covariance(fit.linear.residual[fit.good])
    for _ in range(_ROUNDS):
        white = _whitener(covariance)
        fit = solve(model, segments._replace(good=good), p, moves=moves, white=white, starts=starts)
        p, starts, left, previous_good = fit.p, fit.starts, fit.linear.residual, good
        good = find_inliers(left, good, segments.good)
        if good.sum() <= left.shape[-1]:
            raise unexplained_error(0.0)
        previous, covariance = covariance, _covariance(left[good & previous_good])
        weak = ~moves
        if natural is not None:
            linear = Linear.of(model, segments._replace(good=good), p, starts, _whitener(covariance))
            sizes, guess = natural(p)
            weak = unidentifiable_mask(linear.information, sizes)
        if (good == previous_good).all() and np.allclose(covariance, previous, rtol=0.02, atol=0):
            break
        if natural is not None:
            moves, p = ~weak, np.where(weak, guess, p)
    return fit, weak | ~moves


def find_inliers(residual: Array, good: NDArray[np.bool_], measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the measured samples that are not far off alone: a cluster is an error of the model.

    The good samples show the deviation of the residual, shape (S, L, m).
    """
    from scipy.ndimage import uniform_filter1d  # slow to load

    deviation = NORMAL * np.median(np.abs(residual[good]), axis=0) + 1e-300
    outliers = (np.abs(residual) > _OUTLIER * deviation).any(axis=-1)
    density = uniform_filter1d((outliers & measured).astype(float), 2 * _CLUSTER + 1, axis=1, mode="constant")
    return np.asarray(measured & ~(outliers & (density * (2 * _CLUSTER + 1) < _CLUSTER + 0.5)))


def _covariance(residuals: Array) -> Array:
    """Return the covariance of residuals, shape (m, m), which is not singular."""
    covariance = np.cov(residuals.T)
    return np.asarray(covariance + np.diag(1e-24 + 1e-12 * np.diag(covariance)))


def _whitener(covariance: Array) -> White:
    """Return a function that whitens residuals of a covariance, shape (..., m)."""
    weight = np.linalg.inv(np.linalg.cholesky(covariance)).T
    return lambda residuals, _: residuals @ weight


def scale_normal(H: Array) -> tuple[Array, Array]:
    """Return a normal matrix scaled to a diagonal of ones, and the scales; 0 for numbers without effect."""
    diagonal = np.diag(H)
    nonzero = diagonal > 1e-30 * max(float(diagonal.max(initial=0.0)), 1e-270)
    size = np.where(nonzero, 1 / np.sqrt(np.where(nonzero, diagonal, 1.0)), 0.0)
    return H * np.outer(size, size), size


def unidentifiable_mask(H: Array, sizes: Array) -> NDArray[np.bool_]:
    """Return a mask of numbers that are not identifiable: their standard errors exceed their sizes."""
    R, size = scale_normal(H)
    values, vectors = np.linalg.eigh(R)
    regular = values > _RANK_TOL
    deviations = size * np.sqrt((vectors[:, regular] ** 2 / values[regular]).sum(axis=1))
    weak = (np.abs(vectors[:, ~regular]) > 0.1).any(axis=1)
    return np.asarray(weak | (size == 0) | (deviations > sizes))


def jackknife(linear: Linear, pull: Array | float = 0.0, active: Any = True) -> tuple[Array, int]:
    """Return the covariance by the jackknife, CR3 (Bell and McCaffrey 2002), shape (P, P), and its blocks.

    Parameters
    ----------
    linear : Linear
        Linear problem at the estimate.
    pull : ndarray, shape (P,)
        J'e at the estimate, see `solve`.
    active : bool or ndarray of bool, shape (P,)
        Mask of the estimated numbers; the covariance of the others is zero.

    Raises
    ------
    InvalidArgument
        If only one block identifies a number.
    """
    P = linear.normal.shape[-1] - 1
    covariance, rows = np.zeros((P, P)), np.flatnonzero(np.broadcast_to(active, P))
    H = linear.normal.reshape(-1, 1 + P, 1 + P)
    H, g = H[:, 1 + rows[:, None], 1 + rows], H[:, 0, 1 + rows]
    nonempty = H.any(axis=(1, 2))
    H, S = H[nonempty], int(nonempty.sum())
    _, size = scale_normal(H.sum(axis=0))
    g = (g[nonempty] - np.broadcast_to(pull, P)[rows] / S) * size
    words = f"log has one block of {S} that identifies some parameter, expected a longer or richer log: "
    with argument_errors(words, of=np.linalg.LinAlgError):
        d = np.linalg.solve((H.sum(axis=0) - H) * np.outer(size, size), g[..., None])[..., 0] * size
    covariance[np.ix_(rows, rows)] = (S - 1) / S * d.T @ d
    return covariance, S


def r_squared(measured: Array, left: Array) -> Array:
    """Return R^2 of each column of measurements and residuals, shape (n, m); NaN without rows."""
    if not len(measured):
        return np.full(measured.shape[1], np.nan)
    power = ((measured - measured.mean(axis=0)) ** 2).sum(axis=0)
    return np.asarray(1 - (left**2).sum(axis=0) / np.maximum(power, 1e-300))


LEAST_RESIDUAL = 0.1  # rms of a residual, relative to the noise, below which it shows nothing


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
    def of(cls, residuals: Array, good: NDArray[np.bool_], least: float = 0.0) -> Whiteness:
        """Return the whiteness of residuals (S, L, m), for samples that are good (S, L).

        Residuals with an rms below `least` are rounding, and have no correlation.
        """
        rows, segment = residuals[good], np.nonzero(good)[0]
        pairs = np.flatnonzero(np.diff(segment) == 0)
        product = (rows[pairs + 1] * rows[pairs]).sum(axis=0) / max(len(pairs), 1)
        power = (rows**2).mean(axis=0)
        return cls(
            product / np.maximum(power, max(least**2, np.finfo(float).tiny)), 1.96 / np.sqrt(float(len(rows)))
        )


_MEMORY = 0.15  # [s], correlation time of a force that is not white noise: Matern covariance of order 3/2
_WIDEST = 1e12  # largest tried ratio of the two noises in a residual
_SHAKE = 1e-2  # size of trial noise of an input, as a share of its standard deviation
_DRAWS = 3  # draws of noise


@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """Noise of the residuals: sensor noise and force noise.

    Attributes
    ----------
    root : ndarray, shape (m, L, L)
        Inverse roots of the covariance of a complete segment, for each sensor.
    remembers : bool
        Whether a correlated force is a more likely cause of the residuals than white force noise.
    share : ndarray, shape (m,)
        Part of the force noise in the squares of the white residuals of a segment.
    """

    root: Array
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
        data, lacking = residuals.copy(), np.flatnonzero(~good.all(axis=1) & good.any(axis=1))
        rows = np.arange(residuals.shape[1])
        for s in lacking:
            for column in data[s].T:
                column[:] = np.interp(rows, rows[good[s]], column[good[s]])
        lag = np.abs(rows[:, None] - rows) * dt / _MEMORY
        kernels = np.eye(len(rows)), (1 + lag) * np.exp(-lag)
        costs, estimates = np.zeros(2), []
        for j in range(residuals.shape[2]):
            answers = [h for h in responses[..., j] if h.any()]
            fits = [_fit_noise(data[..., j], 1 + (j < poses), _propagate(answers, x)) for x in kernels]
            costs += [each[0] for each in fits]
            estimates.append(fits[0][1:])
        root = np.linalg.inv(np.linalg.cholesky(np.array([each[0] for each in estimates])))
        share = len(rows) - np.array([each[1] for each in estimates]) * (root**2).sum(axis=(1, 2))
        return cls(root, bool(costs[1] < costs[0]), share)

    def white(self, residuals: Array, good: NDArray[np.bool_]) -> Array:
        """Return white residuals, shape (V, S, L, m), with the most likely values of lost samples."""
        white = np.moveaxis(residuals, -1, 0) @ np.swapaxes(self.root, 1, 2)[:, None]  # (m, V, S, L)
        for s in np.flatnonzero(~good.all(axis=1)):
            block, Q = white[:, :, s], np.linalg.qr(self.root[:, :, ~good[s]])[0]
            white[:, :, s] = block - block @ Q @ np.swapaxes(Q, 1, 2)
        return np.asarray(np.moveaxis(white, 0, -1))


def _propagate(responses: Sequence[Array], kernel: Array) -> Array:
    """Return the covariance, up to a factor, of the responses to a force with a covariance, shape (L, L)."""
    from scipy.linalg import matmul_toeplitz  # slow to load

    if not responses:
        return kernel
    total, zeros = np.zeros_like(kernel), np.zeros(len(kernel))
    for h in responses:
        total = total + matmul_toeplitz((h, zeros), matmul_toeplitz((h, zeros), kernel).T)
    return np.asarray(total / np.trace(total))


def _fit_noise(residuals: Array, order: int, kernel: Array) -> tuple[float, Array, float]:
    """Return cost, covariance and sensor variance of the most likely shares of two noises in residuals.

    Parameters
    ----------
    residuals : ndarray, shape (S, L)
        Residuals of one sensor.
    order : int
        Number of powers of time that initial states explain.
    kernel : ndarray, shape (L, L)
        Covariance of the effect of force noise, up to a factor.
    """
    from scipy.linalg import null_space  # slow to load
    from scipy.optimize import minimize_scalar

    length = residuals.shape[1]
    if not residuals.any():  # there is no such sensor
        return 0.0, np.eye(length), 1.0
    free = null_space(np.vander(np.arange(length) / length, order).T).T  # what first states cannot explain
    sizes, vectors = np.linalg.eigh(free @ kernel @ free.T)
    sizes = np.maximum(sizes / sizes.mean(), 0.0)
    power = ((residuals @ free.T @ vectors) ** 2).mean(axis=0)

    def cost(share: float) -> float:
        each = 1 + np.exp(share) * sizes
        return float(np.log(each).sum() + len(each) * np.log((power / each).mean()))

    edge = np.log(_WIDEST)
    minimum = minimize_scalar(cost, bounds=(-edge, edge), method="bounded", options={"xatol": 1e-2})
    ratio = float(np.exp(minimum.x))
    white = float((power / (1 + ratio * sizes)).mean())
    scale = np.trace(free @ kernel @ free.T) / len(sizes)
    return float(minimum.fun), np.asarray(white * (np.eye(length) + ratio / scale * kernel)), white


def input_noise_gradient(model: Model, segments: Segments, fit: Fit, noise: ResidualNoise) -> Array:
    """Return the contribution of input noise to the gradient, shape (P,), from additional draws of noise.

    Parameters
    ----------
    model, segments : Model, Segments
        Model of the robot, and segments of its logs.
    fit : Fit
        Fit at which the gradient is computed.
    noise : ResidualNoise
        Noise of the residuals.
    """
    from scipy.optimize import nnls  # slow to load

    generator, unit, few = np.random.default_rng(0), _SHAKE * segments.sizes, segments.few

    def perturb(size: Array) -> Segments:
        noise_draw = generator.standard_normal(segments.inputs.shape) * size
        return segments._replace(inputs=segments.inputs + noise_draw).select(few)

    def left(given: Segments) -> Array:
        def residual_group(part: Segments, group: slice) -> tuple[Array, ...]:
            outputs = simulate(model, part, fit.p[None], starts[None, group])
            return (noise.white(part.weigh(part.y - outputs), part.good)[0],)

        return by_groups(residual_group, given)[0]

    def gradients(part: Segments, rows: slice) -> tuple[Array, ...]:
        every = np.arange(len(fit.p))
        _, columns, Q, _ = _columns(model, part, fit.p, starts[rows], noise.white, every)
        total = np.zeros((len(columns), len(fit.p)))
        for draw in draws:
            slope = _columns(model, draw.select(rows), fit.p, starts[rows], noise.white, every)[1] - columns
            way = slope[..., :1] - Q @ (np.swapaxes(Q, 1, 2) @ slope[..., :1])
            total = total + (np.swapaxes(slope[..., 1:], 1, 2) @ way)[..., 0] / _DRAWS
        return (total,)

    part, starts = segments.select(few), fit.starts[few]
    baseline = left(part)
    power = [((left(perturb(row)) - baseline) ** 2).mean(axis=0).sum(axis=0) for row in np.diag(unit)]
    by_input = np.array(power).T  # (m, nu): power of residuals per variance of each input
    scale = np.maximum(by_input.max(axis=1), np.finfo(float).tiny)
    sizes = unit * np.sqrt(nnls(by_input / scale[:, None], np.maximum(noise.share, 0.0) / scale)[0])
    draws = [perturb(sizes) for _ in range(_DRAWS)]
    total = by_groups(gradients, part, len(fit.p) + starts.shape[1] + 1)[0].sum(axis=0)
    return np.asarray(total * len(segments.y) / len(part.y))
