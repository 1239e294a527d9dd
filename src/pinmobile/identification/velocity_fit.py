"""Output error of the theta model, by segments simulated side by side, and its prediction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification.log import Samples
from pinmobile.identification.statistics import NORMAL
from pinmobile.identification.velocity_robot import ABOVE_ZERO, VelocityDynamics

_WINDOW = 0.8  # [s] of the weak form that gives a start
_LEAST_WINDOW = 8  # samples of it
_AROUND, _ENDS = 7, 9  # samples of a running median, and of each end by which it goes on
_FAST = 0.9  # share of the steps of poses that are shorter than what may be off that
_SMOOTH = 0.25  # [s] of the cubic by which poses give speeds, for the start alone
_GUESS = np.array([0.3, 0.3, 0.0, 1.0, 0.0, 1.0])  # where a log tells nothing
_COUPLING = 2, 4  # theta_3 and theta_5
_RIDGE = 1e-6  # relative: what keeps the guess there
_FINE = 0.3  # of the shortest time constant: longest step of Runge and Kutta
_BENDS = 4  # times as many where a limit of acceleration ends within one
_MOST_STEPS = 40  # of it per sample, on the way through values that nobody means
_SLOPE = 1e-4  # of the size of a number, by which differences are taken
_CONVERGED, _NEAR = 1e-7, 1e-2  # relative change of the cost, and where weights are yet to be found
_ROUNDING = 1e-12  # likewise: that of sums
_ITERATIONS = 30
_TRIES = 20  # of a step, each with more damping
_ROUNDS = 4  # of weights and outliers
_OUTLIER = 6.0  # deviations
_UNSEEN = 1e-10  # eigenvalues of the scaled normal matrix below it are none


class Segments(NamedTuple):
    """Logs, cut.

    Attributes
    ----------
    dt : float
        Time between two samples [s].
    t : ndarray, shape (S, L)
        Times since the first sample of the log [s].
    y : ndarray, shape (S, L, k)
        What was measured: speed and yaw rate, or x, y, psi.
    calm : ndarray, shape (S, L, k)
        The same, gross outliers bridged: where a fit begins.
    good : ndarray of bool, shape (S, L)
        Which samples count.
    u : ndarray, shape (S, L + lead + 2, 2)
        Commands, from `lead` + 1 samples before each segment to one after it.
    lead : int
        Largest delay, in samples.
    """

    dt: float
    t: Array
    y: Array
    calm: Array
    good: NDArray[np.bool_]
    u: Array
    lead: int

    @property
    def is_pose(self) -> bool:
        """Whether poses were measured."""
        return bool(self.y.shape[-1] == 3)


def cut(runs: Sequence[Samples], seconds: float, lead: int) -> Segments:
    """Return logs of one step, cut into segments of so many seconds, whose commands are known."""
    length, parts = max(3, round(seconds / runs[0].dt)), []
    for run in runs:
        first = np.arange(lead + 1, len(run.t) - length + 1, length)[:, None]
        at, around = first + np.arange(length), first + np.arange(-lead - 1, length + 1)
        inputs = run.u[np.minimum(around, len(run.u) - 1)]
        parts.append((run.t[at], _measured(run)[at], calmed(run)[at], run.seen[at], inputs))
    t, y, calm, good, u = (np.concatenate(each) for each in zip(*parts, strict=True))
    return Segments(runs[0].dt, t, y, calm, good, u, lead)


@dataclass(frozen=True, eq=False)
class Model:
    """What is identified: theta, and what else varies.

    Parameters
    ----------
    free : tuple of str
        Of ``"delay"``, ``"ahead"``, ``"acceleration"`` and ``"yaw_acceleration"``, in this order.
    delay : float
        Where it does not vary, in samples.
    ahead : float
        Likewise [m].
    accelerations : ndarray, shape (2,)
        Likewise [m/s^2, rad/s^2].
    """

    free: tuple[str, ...]
    delay: float
    ahead: float
    accelerations: Array

    def values(self, p: Array) -> tuple[Array, Array, Array, Array]:
        """Return theta (K, 6), delay (K,), ahead (K,) and accelerations (K, 2) of numbers p, shape (K, P)."""
        named = {name: p[:, 6 + k] for k, name in enumerate(self.free)}
        still = np.zeros(len(p))
        most = [named.get(name, still + self.accelerations[k]) for k, name in enumerate(_LIMITS)]
        delay, ahead = named.get("delay", still + self.delay), named.get("ahead", still + self.ahead)
        return p[:, :6], delay, ahead, np.stack(most, axis=-1)

    def _with(self, of_theta: Sequence[float], column: int) -> Array:
        return np.append(of_theta, [_FREE[name][column] for name in self.free])

    @property
    def guess(self) -> Array:
        """Numbers, shape (P,), of a robot of which nothing is known."""
        return self._with(_GUESS.tolist(), 0)

    def natural(self, p: Array) -> Array:
        """Return how large numbers like p, shape (P,), are: what is known less well is unseen."""
        found = self._with([1.0 if k in _COUPLING else np.nan for k in range(6)], 1)
        return np.where(np.isnan(found), np.abs(p), found)

    def sizes(self, p: Array) -> Array:
        """Return how large the numbers p, shape (P,), are, by which differences are taken."""
        return np.maximum(np.abs(p), self._with([0.1 if k in _COUPLING else 1e-6 for k in range(6)], 2))

    def is_possible(self, p: Array, lead: int) -> bool:
        """Return whether there is a robot of such numbers, shape (P,)."""
        _, delay, _, most = self.values(p[None])
        inside = -1 < delay[0] < lead
        return bool(np.isfinite(p).all() and (p[list(ABOVE_ZERO)] > 0).all() and inside and (most > 0).all())

    @np.errstate(all="ignore")  # on the way through values that nobody means
    def simulate(self, cuts: Segments, p: Array, start: Array) -> Array:
        """Return what would be measured, shape (K, S, L, k).

        Parameters
        ----------
        cuts : Segments
            Whose commands are taken.
        p : ndarray, shape (K, P)
            Numbers.
        start : ndarray, shape (K, S, n)
            Speed and yaw rate at the first sample of each segment, and behind them x, y and psi of poses.
        """
        theta, delay, ahead, most = self.values(p)
        body = VelocityDynamics(theta[:, None], ahead[:, None], most[:, None], ())
        whole = np.floor(delay).astype(int)
        share = (delay - whole)[:, None, None]
        fastest = (theta[:, [3, 5]] / theta[:, [0, 1]]).max()
        bends = _BENDS if np.isfinite(most).any() else 1
        steps = bends * int(np.clip(np.ceil(cuts.dt * fastest / _FINE), 1, _MOST_STEPS))
        late = bool(share.any())
        z, kept = start, np.empty((cuts.y.shape[1], *start.shape))
        at = cuts.lead + 1 - whole  # the column of u that is applied from the first sample on
        commands = np.moveaxis(cuts.u, 0, 1)
        kept[0] = z
        for j in range(len(kept) - 1):
            if late:
                z = _advanced(body, z, commands[at + j - 1], share * cuts.dt, steps)
            z = _advanced(body, z, commands[at + j], (1 - share) * cuts.dt if late else cuts.dt, steps)
            kept[j + 1] = z
        return np.moveaxis(kept, 0, 2)[..., 2:] if cuts.is_pose else np.moveaxis(kept, 0, 2)


_LIMITS = "acceleration", "yaw_acceleration"
_FREE = {  # guess, natural size where it is not that of the number, least size
    "delay": (0.0, 3.0, 1.0),
    "ahead": (0.0, 1.0, 0.1),
    "acceleration": (1.0, np.nan, 1e-3),
    "yaw_acceleration": (3.0, np.nan, 1e-3),
}


def _advanced(body: VelocityDynamics, z: Array, u: Array, span: Array | float, steps: int) -> Array:
    """Return the states a span later, shape (K, S, n), by Runge's and Kutta's fourth order."""
    h = span / steps
    pose = z.shape[-1] > 2

    def slope(z: Array) -> Array:
        nu = z[..., :2]
        rates = body.rates(nu, u)
        return np.concatenate([rates, body.rolling(z[..., 2:], nu)], axis=-1) if pose else rates

    for _ in range(steps):
        a = slope(z)
        b = slope(z + (h / 2) * a)
        c = slope(z + (h / 2) * b)
        z = z + (h / 6) * (a + 2 * b + 2 * c + slope(z + h * c))
    return z


class Fit(NamedTuple):
    """Where Gauss and Newton have come to.

    Attributes
    ----------
    p : ndarray, shape (P,)
        Numbers.
    start : ndarray, shape (S, n)
        States at the beginning of the segments.
    J, e : ndarray, shape (S, L k, P), (S, L k)
        Weighted slopes and residuals, what the starts could explain taken off.
    residual : ndarray, shape (S, L, k)
        What was measured less what is simulated.
    good : ndarray of bool, shape (S, L)
        Which samples counted.
    unseen : ndarray of bool, shape (P,)
        Numbers of which the motion tells nothing.
    """

    p: Array
    start: Array
    J: Array
    e: Array
    residual: Array
    good: NDArray[np.bool_]
    unseen: NDArray[np.bool_]


def fit(model: Model, cuts: Segments, p: Array, *, moving: bool = True) -> Fit:
    """Return the least squares of the output error, weighted by what it leaves, without outliers.

    Parameters
    ----------
    model, cuts : Model, Segments
        What is identified of what.
    p : ndarray, shape (P,)
        Where to begin.
    moving : bool
        Whether p is identified; else the starts of the segments alone are.

    Raises
    ------
    InvalidArgument
        If what is simulated runs away from what was measured.
    """
    try:
        return _fit(model, cuts, p, moving)
    except np.linalg.LinAlgError:
        raise unexplained(0.0) from None


def unexplained(share: float) -> InvalidArgument:
    """Return the error about a log whose commands explain but a share of its motion."""
    return InvalidArgument(
        f"log has motion of which the commands explain {max(share, 0):.0%}, expected most: are they of "
        "another robot, in another frame, or of another sign, or no commands of speed [m/s] and yaw rate "
        "[rad/s]?"
    )


@np.errstate(all="ignore")  # what runs away is refused
def _fit(model: Model, cuts: Segments, p: Array, moving: bool) -> Fit:
    start, moves = starts(cuts), np.full(len(p), moving)
    if moving and not np.isfinite(model.simulate(cuts, p[None], start[None])).all():
        p = np.where(np.isin(np.arange(len(p)), _COUPLING), 0.0, p)  # without it nothing grows
    good = cuts.good & (cuts.calm == cuts.y).all(axis=-1)
    covariance = np.diag(np.maximum(np.var(cuts.calm, axis=(0, 1)), 1e-12))
    for k in range(_ROUNDS):
        near = cuts._replace(good=good)
        found = _gauss_newton(model, near, p, start, covariance, moves, _CONVERGED if k else _NEAR)
        p, start = found.p, found.start
        r = found.residual[found.good]
        deviation = NORMAL * np.median(np.abs(r), axis=0) + 1e-300
        wild = (np.abs(found.residual) > _OUTLIER * deviation).any(axis=-1)
        new, before = cuts.good & ~wild, covariance
        inside = (np.abs(r) <= _OUTLIER * deviation).all(axis=1)
        if inside.sum() <= r.shape[1]:  # of what is no number none is
            raise unexplained(0.0)
        covariance = np.cov(r[inside].T)
        covariance = covariance + np.diag(1e-24 + 1e-12 * np.diag(covariance))
        settled = (new == good).all() and np.allclose(covariance, before, rtol=0.02, atol=0)
        good = new
        if settled:
            break
        if moving:  # what is unseen stays where it is
            weight = np.linalg.inv(np.linalg.cholesky(covariance))
            slopes, _ = _slopes(model, cuts._replace(good=good), p, start, weight).projected
            moves = ~_hidden(np.einsum("smp,smq->pq", slopes, slopes), model.natural(p))
            p = np.where(moves, p, model.guess)
    return found


def starts(cuts: Segments) -> Array:
    """Return a guess of the states at the beginning of the segments, shape (S, n)."""
    first = cuts.calm[:, 0]
    if not cuts.is_pose:
        return first.copy()
    return np.concatenate([_speeds(cuts.calm, cuts.dt)[:, 0], first], axis=-1)


class _Slopes(NamedTuple):
    """A model near some numbers, weighted: residuals e of J dp + Q R dstart."""

    J: Array
    Q: Array
    R: Array
    e: Array
    residual: Array

    @property
    def projected(self) -> tuple[Array, Array]:
        """Slopes and residuals that no starts of segments explain, shape (S, m, P), (S, m)."""
        J = self.J - np.einsum("smn,snp->smp", self.Q, np.einsum("smn,smp->snp", self.Q, self.J))
        return J, self.e - np.einsum("smn,sn->sm", self.Q, np.einsum("smn,sm->sn", self.Q, self.e))

    def start(self, step: Array) -> Array:
        """Return how starts change where the numbers change by a step, shape (S, n)."""
        rest = np.einsum("smn,sm->sn", self.Q, self.e - self.J @ step)
        return np.stack([np.linalg.lstsq(*pair, rcond=_UNSEEN)[0] for pair in zip(self.R, rest, strict=True)])


def _slopes(model: Model, cuts: Segments, p: Array, start: Array, weight: Array) -> _Slopes:
    """Return the model's slopes by central differences, and its residuals."""
    P, n = len(p), start.shape[-1]
    dp, ds = _SLOPE * model.sizes(p), _SLOPE * np.maximum(np.abs(start).mean(axis=0), 0.1)
    count = 1 + 2 * (P + n)
    numbers, begins = np.tile(p, (count, 1)), np.tile(start, (count, 1, 1))
    both = np.array([[1.0], [-1.0]])
    numbers[1 : 1 + 2 * P] += np.kron(np.diag(dp), both)
    begins[1 + 2 * P :] += np.kron(np.diag(ds), both)[:, None]
    found = model.simulate(cuts, numbers, begins)
    with np.errstate(all="ignore"):  # where a robot that is thought of runs away
        ends = np.nan_to_num(found[1::2] - found[2::2]) / (2 * np.append(dp, ds)[:, None, None, None])
    columns = _weighted(np.moveaxis(ends, 0, -1), weight, cuts.good)
    residual = cuts.y - found[0]
    Q, R = np.linalg.qr(columns[..., P:])
    return _Slopes(
        columns[..., :P], Q, R, _weighted(residual[..., None], weight, cuts.good)[..., 0], residual
    )


def _weighted(x: Array, weight: Array, good: NDArray[np.bool_]) -> Array:
    """Return columns of samples (S, L, k, c) as rows (S, L k, c) of deviation one; bad ones are zero."""
    rows = np.einsum("ij,sljc->slic", weight, x) * good[..., None, None]
    return np.asarray(rows.reshape(len(x), -1, x.shape[-1]))


def scaled(H: Array) -> tuple[Array, Array]:
    """Return a normal matrix with ones on its diagonal, and what scales it; 0 of numbers without effect."""
    diagonal = np.diag(H)
    seen = diagonal > 1e-30 * max(float(diagonal.max(initial=0.0)), 1e-270)
    size = np.where(seen, 1 / np.sqrt(np.where(seen, diagonal, 1.0)), 0.0)
    return H * np.outer(size, size), size


def _hidden(H: Array, sizes: Array) -> NDArray[np.bool_]:
    """Return of which numbers a normal matrix tells nothing: their deviations are larger than they are."""
    R, size = scaled(H)
    values, vectors = np.linalg.eigh(R)
    seen = values > _UNSEEN
    deviations = size * np.sqrt((vectors[:, seen] ** 2 / values[seen]).sum(axis=1))
    lost = (np.abs(vectors[:, ~seen]) > 0.1).any(axis=1)
    return np.asarray(lost | (size == 0) | (deviations > sizes))


def _gauss_newton(
    model: Model,
    cuts: Segments,
    p: Array,
    start: Array,
    covariance: Array,
    moves: NDArray[np.bool_],
    tolerance: float,
) -> Fit:
    """Return the least squares for weights, by steps of Levenberg and Marquardt, starts projected out."""
    weight = np.linalg.inv(np.linalg.cholesky(covariance))
    damping = 1e-4
    for _ in range(_ITERATIONS):
        near = _slopes(model, cuts, p, start, weight)
        J, left = near.projected
        J = J * moves
        H, size = scaled(np.einsum("smp,smq->pq", J, J))
        slope, now = size * np.einsum("smp,sm->p", J, left), float(near.e.ravel() @ near.e.ravel())
        for _ in range(_TRIES):
            step = size * np.linalg.solve(H + damping * np.eye(len(p)), slope)
            then, begin = p + step, start + near.start(step)
            cost = np.inf
            if model.is_possible(then, cuts.lead):
                off = cuts.y - model.simulate(cuts, then[None], begin[None])[0]
                rows = _weighted(off[..., None], weight, cuts.good)
                cost = float(rows.ravel() @ rows.ravel())
            if cost <= now * (1 + _ROUNDING):
                break
            damping = max(10 * damping, 1e-6)
        else:
            break  # as low as it gets
        p, start, damping = then, begin, damping / 10
        if now - cost <= tolerance * now:
            break
    near = _slopes(model, cuts, p, start, weight)
    J, left = near.projected
    hidden = ~moves | _hidden(np.einsum("smp,smq->pq", J, J), model.natural(p))
    return Fit(p, start, J, left, near.residual, cuts.good, hidden)


def guess(runs: Sequence[Samples], lead: int, delay: float | None) -> tuple[Array, float]:
    """Return theta and the delay [samples] by the weak form, in which no rates of speeds are needed.

    Equations are integrated against a bump g: the integral of g u' is that of -g' u. The delay is the one for
    which the determinant of the residuals' covariance is least, within `lead` samples.
    """
    rows = [_weak(run, lead) for run in runs]
    regressors = [np.concatenate([row[k] for row in rows]) for k in (0, 1)]
    lates = list(range(lead)) if delay is None else [delay]
    costs, thetas = [], []
    for late in lates:
        commands = np.concatenate([row[2](late) for row in rows])
        theta, left = _GUESS.copy(), np.empty_like(commands)
        for k, entries in enumerate(([0, 2, 3], [1, 4, 5])):
            Y, prior = regressors[k], _GUESS[entries]
            size = np.linalg.norm(Y, axis=0) + 1e-300
            ridge = _RIDGE * np.eye(3)
            A, b = np.vstack([Y / size, ridge]), np.append(commands[:, k] - Y @ prior, np.zeros(3))
            theta[entries] = prior + np.linalg.lstsq(A, b, rcond=None)[0] / size
            left[:, k] = commands[:, k] - Y @ theta[entries]
        S = left.T @ left / len(left)
        costs.append(float(np.linalg.slogdet(S + 1e-12 * np.eye(2))[1]))
        thetas.append(theta)
    best = int(np.argmin(costs))
    found, late = thetas[best], float(lates[best])
    if 0 < best < len(costs) - 1:
        before, here, after = costs[best - 1 : best + 2]
        late += 0.5 * (before - after) / max(before - 2 * here + after, 1e-12)
    least = list(ABOVE_ZERO)
    found[least] = np.maximum(found[least], 0.02)
    return found, late


def _speeds(poses: Array, dt: float) -> Array:
    """Return speed and yaw rate of poses, shape (..., N, 2), by a cubic's slope."""
    from scipy.signal import savgol_filter

    size = min(max(5, 2 * round(_SMOOTH / dt / 2) + 1), poses.shape[-2] - 1 + poses.shape[-2] % 2)
    degree = min(3, size - 1)
    smooth, rate = (
        savgol_filter(poses, size, degree, deriv=k, delta=dt, axis=-2, mode="interp") for k in (0, 1)
    )
    c, s = np.cos(smooth[..., 2]), np.sin(smooth[..., 2])
    return np.stack([c * rate[..., 0] + s * rate[..., 1], rate[..., 2]], axis=-1)


def speeds(run: Samples) -> Array:
    """Return speed and yaw rate of a log, shape (N, 2): of the twist, or of poses, smoothed."""
    return _speeds(calmed(run), run.dt) if run.twist is None else calmed(run)


def calmed(run: Samples) -> Array:
    """Return what a log measured, shape (N, k), gross outliers of poses bridged: far off a running median.

    Differences of poses make more of an outlier than it is; a twist has none taken, and steps of its own.
    """
    x, at = _measured(run), np.arange(len(run.t))
    if run.twist is not None:
        return x
    found = x.copy()
    for k, column in enumerate(x.T):
        steps = np.diff(column)
        ends = [_beyond(column[:_ENDS][::-1])[::-1], _beyond(column[-_ENDS:])]
        around = np.lib.stride_tricks.sliding_window_view(np.concatenate([ends[0], column, ends[1]]), _AROUND)
        off = np.abs(column - np.median(around, axis=1))
        near = off <= _OUTLIER * NORMAL * np.median(off) + np.quantile(np.abs(steps), _FAST)
        found[:, k] = np.interp(at, at[near], column[near])
    return found


def _beyond(end: Array) -> Array:
    """Return how a column would go on behind its end, by medians, shape (_AROUND // 2,)."""
    at = np.arange(len(end))
    slope = np.median(np.diff(end))
    return np.asarray(np.median(end - slope * at) + slope * (len(end) + np.arange(_AROUND // 2)))


def _measured(run: Samples) -> Array:
    """Return speed and yaw rate of a log that has a twist, else x, y and psi, shape (N, k)."""
    return np.asarray(run.q if run.twist is None else run.twist[:, [0, 2]])


def _weak(run: Samples, lead: int) -> tuple[Array, Array, Callable[[float], Array]]:
    """Return the weak form's regressors of speed and yaw rate, (n, 3) each, and its commands by the delay."""
    nu = speeds(run)
    size = max(_LEAST_WINDOW, round(_WINDOW / run.dt)) + 1
    z = np.linspace(-1, 1, size)
    half = (size - 1) / 2 * run.dt
    g, slope = (1 - z * z) ** 4 * run.dt, -8 * z * (1 - z * z) ** 3 / half * run.dt
    u, w = nu.T

    def over(column: Array, weights: Array) -> Array:
        return np.asarray(np.lib.stride_tricks.sliding_window_view(column, size)[lead:] @ weights)

    ahead = np.stack([-over(u, slope), -over(w * w, g), over(u, g)], axis=-1)
    turning = np.stack([-over(w, slope), over(u * w, g), over(w, g)], axis=-1)
    spent = np.vstack([np.zeros(2), np.cumsum(run.u, axis=0)])

    def commands(late: float) -> Array:
        edges = np.clip(np.arange(len(u) + 1) - 0.5 - late, 0, len(u))
        low = np.minimum(edges.astype(int), len(u) - 1)
        mean = np.diff(spent[low] + (edges - low)[:, None] * run.u[low], axis=0)
        return np.stack([over(column, g) for column in mean.T], axis=-1)

    return ahead, turning, commands
