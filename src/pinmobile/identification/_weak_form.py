"""Weak form of the equations of motion: integrals with a bump function, which need no accelerations.

The integrals over windows of 0.6 s with the weight g = (1 - z^2)^4 are transformed by parts. Forces along the
inertial axes are second derivatives, Fx = d^2/dt^2 (m x + m x_bc c - m y_bc s) + friction, so they need only
poses.

The regressor contains the noise of the poses, which would bias the estimates, most where dry friction changes
its sign. `WeakForm.extrapolate` adds noise of one and two times the variance, and extrapolates to no noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification._estimator import NORMAL
from pinmobile.identification._log import held_integrals
from pinmobile.identification._planar_model import PlanarModel, torques_of
from pinmobile.identification._preprocessing import PreprocessedLog

WINDOW = 0.6  # [s]
_HOPS = 8  # per window
_LAG = 16  # windows with correlated residuals: twice the number of overlapping windows
_HUBER = 1.345
_SCALE_STEP = 1e-4  # relative step of differences of the input scale
_ROUNDS, _SAME, _FARTHEST = 10, 1e-4, 3.0  # search of the scale: steps, tolerance, largest factor
_SHAKES = 3  # draws of noise at each level
_LEVELS = (1.0, 2.0)  # variance of added noise, as a multiple of the present variance
_WEIGHTS = (3.0, -3.0, 1.0)  # weights of the fits at these levels for a parabola at the level -1
_CAP = 3.0  # standard deviations at which the cost of a row saturates
_MIN_SHARE = 0.01  # smallest share of the forces of an identifiable direction
_LEVER = 0.25  # [m], lever arm for a robot of unknown size


class Bump(NamedTuple):
    """Bump function with sum 1, its two derivatives, and the samples between two windows."""

    g: Array
    g1: Array
    g2: Array
    hop: int

    @classmethod
    def of(cls, seconds: float, dt: float) -> Bump:
        """Return the bump function over a time span [s]."""
        size = 2 * max(3, round(seconds / dt / 2)) + 1
        half, z = (size - 1) / 2 * dt, np.linspace(-1, 1, size)
        g = (1 - z * z) ** 4 / ((1 - z * z) ** 4).sum()
        g1, g2 = -8 * z * (1 - z * z) ** 3, 48 * z * z * (1 - z * z) ** 2 - 8 * (1 - z * z) ** 3
        # The sums are exact: zero derivative of a constant, slope of a ramp, curvature of a parabola.
        g2 = g2 - g2.sum() * g
        hop = max(1, round((size - 1) / _HOPS))
        return cls(g, -g1 / (g1 @ z) / half, 2 * g2 / (g2 @ z**2) / half**2, hop)

    def integrate(self, columns: Array, order: int = 0) -> Array:
        """Return the integrals of columns, shape (N,) or (N, k), with the bump function or a derivative."""
        view = np.lib.stride_tricks.sliding_window_view(columns, len(self.g), axis=0)[:: self.hop]
        return np.asarray(view @ self[order])


class WeakFit(NamedTuple):
    """Least squares of the weak form.

    Attributes
    ----------
    phi : ndarray, shape (p,)
        Parameters.
    covariance : ndarray, shape (p, p)
        Covariance by Newey and West (1987): windows overlap, and the noise is correlated.
    cost : float
        Robust weighted mean square of the residuals.
    explained : float
        Explained share of the mean square of the forces.
    delay, delay_error : float
        Delay of the poses and its standard deviation [samples]; the latter is NaN if the delay was given.
    """

    phi: Array
    covariance: Array
    cost: float
    explained: float
    delay: float = np.nan
    delay_error: float = np.nan


@dataclass(frozen=True, eq=False)
class WeakForm:
    """The weak form of logs of a robot.

    Attributes
    ----------
    logs : sequence of PreprocessedLog
        Preprocessed logs.
    model : PlanarModel
        Model of the robot.
    Y : ndarray, shape (n, k, p)
        Regressor, without columns of offsets and of an unknown input scale.
    known_forces : ndarray, shape (n, k)
        Forces of known inertia and loads.
    rates : list of ndarray, shape (a, N)
        Rates with friction, for each log.
    counts : tuple of int
        Number of windows of each log.
    """

    logs: Sequence[PreprocessedLog]
    model: PlanarModel
    Y: Array
    known_forces: Array
    rates: Sequence[Array]
    counts: tuple[int, ...]

    @classmethod
    def of(cls, logs: Sequence[PreprocessedLog], model: PlanarModel) -> WeakForm:
        """Return the weak form of logs."""
        rows = [_rows(log, model) for log in logs]
        forces = [force + Y[..., :4] @ log.load for (Y, force), log in zip(rows, logs, strict=True)]
        counts, rates = tuple(map(len, forces)), [log.rates_of(model).T for log in logs]
        return cls(logs, model, np.concatenate([Y for Y, _ in rows]), np.concatenate(forces), rates, counts)

    def noisy_rows(self, levels: Sequence[float] = _LEVELS) -> Iterator[Array]:
        """Yield regressors, shape (n, k, p), for poses with additional noise: some draws at each level."""
        pairs = [(log, np.random.default_rng(0)) for log in self.logs]
        for level in np.repeat(levels, _SHAKES):
            yield np.concatenate([_rows(log.add_noise(draw, level), self.model)[0] for log, draw in pairs])

    @property
    def _constant(self) -> Array:
        """Effect of constant inputs on the forces, shape (k, nu) or without columns."""
        B = np.eye(self.model.nu) if self.model.B is None else self.model.B
        return B[:, : self.model.nu * self.model.offset]

    def forces(self, delay: float = 0.0, scale: float = 1.0) -> Array:
        """Return the forces of the windows for a delay of the poses [samples], shape (n, k)."""
        forces, model = [], self.model
        for log, rates in zip(self.logs, self.rates, strict=True):
            samples, bump = np.arange(len(log.u) + 1.0), Bump.of(WINDOW, log.dt)
            edges = np.clip(samples - 0.5 - delay, 0, len(log.u))  # half of the input before counts
            u = held_integrals(samples[:-1], log.u, edges)
            torques = (
                [*(scale * u.T)] if model.B is None else torques_of(model.motors, [*u.T], [*rates], scale)
            )
            columns = np.stack(torques, axis=-1)
            forces.append(bump.integrate(columns if model.B is None else columns @ model.B.T))
        return np.concatenate(forces)

    def equations(self, delay: float, scale: float = 1.0) -> tuple[Array, Array]:
        """Return the last columns of the regressor, shape (n, k, ...), and the forces, shape (n, k).

        The equations are linearised about a scale of the inputs.
        """
        forces = self.forces(delay, scale)
        y, constant = forces - self.known_forces, self._constant
        columns = np.broadcast_to(constant, (*forces.shape, constant.shape[1]))
        if self.model.has_scale:
            plus, minus = (self.forces(delay, scale * (1 + way * _SCALE_STEP)) for way in (1, -1))
            slope = (plus - minus) / (2 * _SCALE_STEP * scale)
            columns, y = append_columns(columns, -slope[..., None]), y - slope * scale
        return columns, y

    def first_delay(self, delays: Array, base: Array, basis: Array) -> tuple[int, float, float]:
        """Return the index of the best of some delays, the minimum near it, and the explained share."""
        keep = len(base) - self.model.has_scale  # the scale is proportional to all other parameters
        form, base = replace(self, model=replace(self.model, has_scale=False)), base[:keep]
        basis = basis[:keep, : basis.shape[1] - self.model.has_scale]

        fits = []
        for delay in delays.tolist():
            columns, y = form.equations(delay)
            fits.append(robust_fit(append_columns(form.Y, columns), y, form.counts, base, basis, 2)[0])
        costs = np.array([each.cost for each in fits])
        k = int(costs.argmin())
        minimum = float(delays[k])
        if 0 < k < len(delays) - 1:
            low, mid, high = costs[k - 1 : k + 2]
            minimum += (delays[k + 1] - delays[k]) / 2 * (low - high) / max(low - 2 * mid + high, 1e-300)
        return k, float(minimum), fits[k].explained

    def extrapolate(self, delay: float, prior: Array, basis: Array, free: bool = False) -> WeakFit:
        """Return the least squares extrapolated to poses without noise (simulation extrapolation).

        Cook and Stefanski (1994): fit phi to the log, and to the log with additional noise of one and two
        times the present variance. The parabola through the fits at the level -1 gives the result without
        noise.

        Parameters
        ----------
        delay : float
            Delay of the poses [samples].
        prior : ndarray, shape (p,)
            Prior parameters.
        basis : ndarray, shape (p, d)
            Free directions of phi with typical sizes.
        free : bool
            Whether to estimate the delay near the given one. The delay is then one more column, and the
            covariance includes its uncertainty.
        """
        scale, nonlinear = 1.0, self.model.has_scale and bool(self.model.motors)  # by the back-EMF
        for _ in range(_ROUNDS if nonlinear else 1):
            fit, last = self._fit_scale(scale, delay, prior, basis, free), scale
            scale = float(np.clip(fit.phi[-1], scale / _FARTHEST, scale * _FARTHEST)) if nonlinear else 1.0
            if abs(scale - last) <= _SAME * scale:
                break
        return fit

    def _fit_scale(self, scale: float, delay: float, prior: Array, basis: Array, free: bool) -> WeakFit:
        """Return the extrapolated least squares of the equations, linearised about a scale of the inputs."""
        columns, y = self.equations(delay, scale)
        if free:
            before, more = (self.forces(delay + shift, scale)[..., None] for shift in (-0.5, 0.5))
            columns = append_columns(columns, before - more)
            prior, basis = np.append(prior, 0.0), np.pad(basis, ((0, 1), (0, 1)))
            basis[-1, -1] = 1.0
        fit, influence = robust_fit(append_columns(self.Y, columns), y, self.counts, prior, basis)
        phi, influence = _WEIGHTS[0] * fit.phi, _WEIGHTS[0] * influence
        for weight, each in zip(np.repeat(_WEIGHTS[1:], _SHAKES) / _SHAKES, self.noisy_rows(), strict=True):
            noisy, more = robust_fit(append_columns(each, columns), y, self.counts, prior, basis)
            phi, influence = phi + weight * noisy.phi, influence + weight * more
        covariance = _newey_west(influence, self.counts, basis.shape[1])
        if not free:
            return fit._replace(phi=phi, covariance=covariance, delay=delay)
        size = phi[-2] / scale if self.model.has_scale else 1.0  # of the forces
        shift_s, error = delay + float(phi[-1] / size), float(np.sqrt(covariance[-1, -1]) / abs(size))
        return fit._replace(phi=phi[:-1], covariance=covariance[:-1, :-1], delay=shift_s, delay_error=error)

    def directions(self, scales: Array) -> tuple[Array, Array]:
        """Return orthonormal directions that are identifiable, and those that are not, in the scales (p,).

        An identifiable direction has more than 1 % of the forces in the regressor, without the part of the
        pose noise. Additional draws of noise show the size of this part.
        """
        model, extra, size = self.model, self.model.has_scale, np.sqrt((self.forces() ** 2).mean(axis=0))
        force = max(np.hypot(*size[:2]) if model.free == 3 else size[0], 4 * size[-1])
        per_row = np.array([*[force] * (model.free - 1), max(size[-1], force * _LEVER)])

        def gram(Y: Array, constant: Array) -> Array:
            Y = append_columns(Y, constant)
            rows = (Y * scales[: Y.shape[-1]] / per_row[:, None]).reshape(-1, Y.shape[-1])
            return np.asarray(rows.T @ rows)

        noise = [gram(each - self.Y, 0 * self._constant) for each in self.noisy_rows(_LEVELS[:1])]
        total = gram(self.Y, self._constant) - 1.5 * np.mean(noise, axis=0)
        values, vectors = np.linalg.eigh(total / (self.Y.shape[0] * self.Y.shape[1]))
        regular = values > _MIN_SHARE**2
        # The scale is identifiable where all else is, as loads differ.
        basis = np.pad(vectors[:, regular], ((0, extra), (0, extra)))
        basis[-1:, -1:] = 1.0 if extra else basis[-1:, -1:]
        return basis, np.pad(vectors[:, ~regular], ((0, extra), (0, 0)))

    def scales(self) -> Array:
        """Return the size of each parameter that would explain the power of the forces alone.

        Raises
        ------
        InvalidArgument
            If the motion or the forces are too small.
        """
        logs, model = self.logs, self.model
        twist = np.concatenate([log.twist for log in logs])
        twist_rate = np.concatenate([np.gradient(log.twist, log.dt, axis=0) for log in logs])
        wrench = self.forces() @ (np.eye(3) if model.B is None else np.linalg.pinv(model.S))
        f, moment = np.sqrt((wrench[:, :2] ** 2).sum(axis=1).mean()), np.sqrt((wrench[:, 2] ** 2).mean())
        noise = np.max([np.where(np.isfinite(log.noise), log.noise, 0.0) for log in logs], axis=0)
        speed, rate = np.sqrt((twist[:, :2] ** 2).sum(axis=1).mean()), np.sqrt((twist[:, 2] ** 2).mean())
        ranges = np.ptp(np.concatenate([log.q for log in logs]), axis=0)
        if not (ranges > 20 * noise).any() or not max(f, moment) > 0:
            raise InvalidArgument(
                f"log has poses that move by {ranges[0]:.3g} m, {ranges[1]:.3g} m and {ranges[2]:.3g} rad, "
                f"and forces of {f:.3g} N and {moment:.3g} N m, expected an informative motion, see "
                "excitation"
            )
        r = twist[:, 2]
        planar = twist_rate[:, 0] - r * twist[:, 1], twist_rate[:, 1] + r * twist[:, 0]
        acceleration = np.sqrt((planar[0] ** 2 + planar[1] ** 2).mean())
        force = max(f, moment / _LEVER / 4)
        power = force * speed + moment * rate
        per_rate = np.array([speed, speed, max(rate, speed)])
        if model.wheels:
            rates = np.sqrt(((twist @ np.linalg.pinv(model.S).T @ model.A.T) ** 2).mean())
            per_rate = np.full(len(model.A), rates)
        body = force / max(acceleration, 1e-3) * np.array([1.0, _LEVER, _LEVER, _LEVER**2])
        dry, scale = power / per_rate, np.ones(int(model.has_scale))
        return np.concatenate([body, dry / per_rate, dry, dry[: len(dry) * model.offset], scale])


def append_columns(Y: Array, columns: Array) -> Array:
    """Return a regressor with more columns."""
    return np.concatenate([Y, np.broadcast_to(columns, (*Y.shape[:-1], columns.shape[-1]))], axis=-1)


def _rows(log: PreprocessedLog, model: PlanarModel) -> tuple[Array, Array]:
    """Return the regressor, shape (n, k, p), and the forces of known inertia, shape (n, k), of a log."""
    rows = _inertial if model.B is None else _free_rows
    return rows(log, model, Bump.of(WINDOW, log.dt))


def _inertial(log: PreprocessedLog, model: PlanarModel, bump: Bump) -> tuple[Array, Array]:
    mean, (x, y, psi), (u, w, r) = bump.integrate, log.q.T, log.twist.T
    c, s = np.cos(psi), np.sin(psi)
    x2, y2, c2, s2 = (mean(each, 2) for each in (x, y, c, s))
    zero = np.zeros_like(x2)

    def friction(rates: Any) -> list[list[Array]]:
        a, b, d = rates.T
        return [[mean(c * a), -mean(s * b), zero], [mean(s * a), mean(c * b), zero], [zero, zero, mean(d)]]

    mz_x, mz_y = -mean(w, 1) + mean(r * u), mean(u, 1) + mean(r * w)
    inertial = [x2, c2, -s2, zero], [y2, s2, c2, zero], [zero, mz_x, mz_y, mean(psi, 2)]
    rubs = friction(log.twist), friction(log.twist / np.hypot(log.twist, model.speed))
    Y = np.stack([np.stack([*a, *b, *d], axis=-1) for a, b, d in zip(inertial, *rubs, strict=True)], axis=1)
    return Y, np.zeros(Y.shape[:2])


def _free_rows(log: PreprocessedLog, model: PlanarModel, bump: Bump) -> tuple[Array, Array]:
    mean, eta = bump.integrate, log.free_velocities(model)
    forward, left, r = (eta @ model.S.T).T
    # Integrals of a_u, a_w and r' against the bump.
    a_u, a_w = -mean(forward, 1) - mean(r * left), -mean(left, 1) + mean(r * forward)
    w = eta @ model.A.T
    Y = model.rows(a_u, a_w, -mean(r, 1), mean(r * r), mean(w), mean(w / np.hypot(w, model.speed)))
    return Y, -mean(eta, 1) @ model.inertia.T


def robust_fit(
    Y: Array, y: Array, counts: Sequence[int], prior: Array, basis: Array, passes: int = 5
) -> tuple[WeakFit, Array]:
    """Return the least squares with iterative weights, and the influence of the windows, shape (n, p).

    Parameters
    ----------
    Y, y : ndarray, shape (n, k, p), (n, k)
        Regressor and right-hand side.
    counts : sequence of int
        Number of windows of each log.
    prior : ndarray, shape (p,)
        Prior parameters.
    basis : ndarray, shape (p, d)
        Free directions of phi with typical sizes.
    passes : int
        Number of updates of the weights.
    """
    tiny = 1e-12 * np.sqrt((y**2).mean()) + np.finfo(float).tiny
    deviation = np.maximum((y - Y @ prior).std(axis=0), tiny)
    weights = np.ones(y.shape) / deviation
    for _ in range(passes):
        right = ((y - Y @ prior) * weights**2).ravel() @ Y.reshape(-1, len(prior))
        phi = prior + _inverse(Y * weights[..., None], basis) @ right
        left = y - Y @ phi
        deviation = np.maximum(NORMAL * np.median(np.abs(left), axis=0), tiny)
        size = np.abs(left) / deviation
        weights = np.sqrt(np.minimum(1, _HUBER / np.maximum(size, _HUBER))) / deviation
    scores = np.einsum("nki,nk->ni", Y, left * weights**2)
    # Rows beyond Huber's bound have a constant score, so the slope does not contain them.
    influence = scores @ _inverse(Y * ((size < _HUBER) / deviation)[..., None], basis)
    cost = float((np.minimum(size, _CAP) ** 2).mean() * np.prod(deviation) ** (2 / y.shape[1]))
    share = 1 - float((left**2).sum() / max((y**2).sum(), tiny))
    return WeakFit(phi, _newey_west(influence, counts, basis.shape[1]), cost, share), influence


def _inverse(A: Array, basis: Array) -> Array:
    """Return the inverse of the normal matrix within the span of the basis."""
    rows = A.reshape(-1, len(basis))
    normal = basis.T @ (rows.T @ rows) @ basis
    return np.asarray(basis @ np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ basis.T)


def _newey_west(influence: Array, counts: Sequence[int], count: int) -> Array:
    """Return the covariance of a sum over windows, with correlation of nearby windows."""
    total = np.zeros((influence.shape[1],) * 2)
    for each in np.split(influence, np.cumsum(counts)[:-1]):
        total = total + each.T @ each
        for lag in range(1, min(_LAG, len(each) - 1) + 1):
            product = each[lag:].T @ each[:-lag]
            total = total + (1 - lag / (_LAG + 1)) * (product + product.T)
    windows = len(influence) / _HOPS  # that do not overlap
    return np.asarray(total * windows / max(windows - count, 1.0))
