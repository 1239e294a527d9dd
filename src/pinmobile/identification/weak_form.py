"""The weak form: the equations of motion integrated against a bump, so that no acceleration is needed.

Windows of 0.6 s, weighted by g = (1 - z^2)^4, are integrated by parts. Forces along the inertial axes are
second derivatives, Fx = d^2/dt^2 (m x + m x_bc c - m y_bc s) + friction, so of these only poses are needed.

Noise of the poses is in the regressor, most where dry friction changes its sign, and would bias all.
`extrapolated` fits logs that were shaken once and twice as much again, and goes back from there to no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.identification.chassis import Chassis
from pinmobile.identification.cleaning import Cleaned
from pinmobile.identification.statistics import NORMAL

WINDOW = 0.6  # [s]
_HOPS = 8  # per window
_LAG = 16  # windows over which residuals hang together: twice those that overlap
_HUBER = 1.345
_NEAR = 1e-4  # of a scale, in differences
_ROUNDS, _SAME, _FARTHEST = 10, 1e-4, 3.0  # of a scale: most steps, when it is found, and by which factor
_SHAKES = 3  # draws of noise at each level
_LEVELS = (1.0, 2.0)  # variance of noise that is added, as a multiple of what there is
_WEIGHTS = (3.0, -3.0, 1.0)  # of fits with none and these, which a parabola takes to a variance of -1
_CAP = 3.0  # deviations beyond which a row costs no more


class Rows(NamedTuple):
    """The weak form of one log.

    Attributes
    ----------
    Y : ndarray, shape (n, k, p)
        Rows of the regressor, without that of an unknown scale of the input.
    shaken : ndarray, shape (levels, draws, n, k, p)
        The same of poses with more noise.
    known : ndarray, shape (n, k)
        What of the force is that of known inertia and loads.
    run : Cleaned
        The log.
    rates : ndarray, shape (a, N)
        Along which there is friction.
    hop : int
        Samples between two windows.
    g : ndarray, shape (size,)
        The bump, of sum 1.
    """

    Y: Array
    shaken: Array
    known: Array
    run: Cleaned
    rates: Array
    hop: int
    g: Array

    def forces(self, chassis: Chassis, delay: float, scale: float = 1.0) -> Array:
        """Return the forces of the windows, of a pose that comes late by so many samples, shape (n, k)."""
        count = len(self.run.q)
        edges = np.asarray(np.arange(count + 1) - 0.5, np.float64)  # half of the input before a sample counts
        u = self.run.shifted(delay, edges)
        if chassis.B is None:
            return scale * np.asarray(_windows(u, self.g, self.hop))
        torques = np.stack(chassis.torques([*u.T], [*self.rates], scale), axis=-1)
        return np.asarray(_windows(torques @ chassis.B.T, self.g, self.hop))

    def regressors(self, chassis: Chassis) -> tuple[Array, Array]:
        """Return the regressor, with columns of offsets where there are any, and those shaken."""
        if not chassis.offset:
            return self.Y, self.shaken
        columns = np.eye(chassis.nu) if chassis.B is None else chassis.B  # of a constant: bumps have sum 1
        return _beside(self.Y, columns), _beside(self.shaken, columns)

    def equations(self, chassis: Chassis, delay: float, scale: float = 1.0) -> tuple[Array, Array, Array]:
        """Return the regressor, shape (n, k, p), those shaken, and what they should give, shape (n, k).

        Linear near a scale of the inputs.
        """
        forces, (Y, shaken) = self.forces(chassis, delay, scale), self.regressors(chassis)
        if not chassis.scaled:
            return Y, shaken, forces - self.known
        more, less = (self.forces(chassis, delay, scale * (1 + way * _NEAR)) for way in (1, -1))
        slope = (more - less) / (2 * _NEAR * scale)
        column = -slope[..., None]
        return _beside(Y, column), _beside(shaken, column), forces - slope * scale - self.known


def _beside(Y: Array, columns: Array) -> Array:
    """Return a regressor with more columns."""
    return np.concatenate([Y, np.broadcast_to(columns, (*Y.shape[:-1], columns.shape[-1]))], axis=-1)


class Fit(NamedTuple):
    """Least squares of the weak form.

    Attributes
    ----------
    phi : ndarray, shape (p,)
        What is identified.
    covariance : ndarray, shape (p, p)
        By Newey and West (1987), as windows overlap and the noise of forces and poses is correlated.
    cost : float
        Weighted mean square of what is left, robust.
    explained : float
        Share of the forces' mean square that the model explains.
    delay, delay_error : float
        By which poses come late, in samples, and its deviation: not a number where it was given.
    """

    phi: Array
    covariance: Array
    cost: float
    explained: float
    delay: float = np.nan
    delay_error: float = np.nan


def rows_of(run: Cleaned, chassis: Chassis) -> Rows:
    """Return the weak form of a log."""
    size = 2 * round(WINDOW / run.dt / 2) + 1
    hop = max(1, round((size - 1) / _HOPS))
    half = (size - 1) / 2 * run.dt
    z = np.linspace(-1, 1, size)
    g = (1 - z * z) ** 4
    total = g.sum()
    g1 = -8 * z * (1 - z * z) ** 3 / half / total
    g2 = (48 * z * z * (1 - z * z) ** 2 - 8 * (1 - z * z) ** 3) / half**2 / total
    g = g / total
    # As sums, they tell a constant to have no derivative, a ramp to have its slope, a parabola its curvature.
    g1 = -g1 / (g1 @ z) / half
    g2 = g2 - g2.sum() * g
    g2 = 2 * g2 / (g2 @ z**2) / half**2
    build = _inertial if chassis.B is None else _along_free
    bump = g, g1, g2
    Y, known = build(run, chassis, bump, hop)
    loaded = known + Y[..., :4] @ run.load
    generator = np.random.default_rng(0)
    levels = np.repeat(_LEVELS, _SHAKES)
    more = [build(run.shaken(generator, level), chassis, bump, hop)[0] for level in levels]
    shaken = np.reshape(more, (len(_LEVELS), _SHAKES, *Y.shape))
    rates = (run.twist if chassis.B is None else run.free_velocities(chassis) @ chassis.A.T).T
    return Rows(Y, shaken, loaded, run, rates, hop, g)


def _windows(column: Array, weights: Array, hop: int) -> Array:
    """Return the weighted sums over windows, of columns of shape (N,) or (N, k)."""
    view = np.lib.stride_tricks.sliding_window_view(column, len(weights), axis=0)[::hop]
    return np.asarray(view @ weights)


def _inertial(run: Cleaned, chassis: Chassis, bump: Sequence[Array], hop: int) -> tuple[Array, Array]:
    g, g1, g2 = bump
    c, s = np.cos(run.q[:, 2]), np.sin(run.q[:, 2])
    u, w, r = run.twist.T
    dry = run.twist / np.hypot(run.twist, chassis.speed)

    def over(column: Array, weights: Array = g) -> Array:
        return _windows(column, weights, hop)

    x2, y2, c2, s2 = (over(each, g2) for each in (run.q[:, 0], run.q[:, 1], c, s))
    zero = np.zeros_like(x2)
    turn = over(run.q[:, 2], g2)
    along = [over(c * u), -over(s * w), zero], [over(s * u), over(c * w), zero], [zero, zero, over(r)]
    rubs = (
        [over(c * dry[:, 0]), -over(s * dry[:, 1]), zero],
        [over(s * dry[:, 0]), over(c * dry[:, 1]), zero],
        [zero, zero, over(dry[:, 2])],
    )
    mz_x = -over(w, g1) + over(r * u)
    mz_y = over(u, g1) + over(r * w)
    inertial = [x2, c2, -s2, zero], [y2, s2, c2, zero], [zero, mz_x, mz_y, turn]
    rows = [np.stack([*a, *b, *d], axis=-1) for a, b, d in zip(inertial, along, rubs, strict=True)]
    Y = np.stack(rows, axis=1)
    return Y, np.zeros(Y.shape[:2])


def _along_free(run: Cleaned, chassis: Chassis, bump: Sequence[Array], hop: int) -> tuple[Array, Array]:
    g, g1, _ = bump
    eta = run.free_velocities(chassis)
    forward, left, r = (eta @ chassis.S.T).T

    def over(column: Array, weights: Array = g) -> Array:
        return _windows(column, weights, hop)

    # Integrals of a_u, a_w and r' against the bump.
    a_u = -over(forward, g1) - over(r * left)
    a_w = -over(left, g1) + over(r * forward)
    rates = eta @ chassis.A.T
    dry = rates / np.hypot(rates, chassis.speed)
    Y = chassis.rows(a_u, a_w, -over(r, g1), over(r * r), over(rates), over(dry))
    known = -over(eta, g1) @ chassis.inertia.T
    return Y, known


def solve(
    parts: Sequence[Rows], chassis: Chassis, delay: float, prior: Array, basis: Array, passes: int = 5
) -> Fit:
    """Return the least squares of several logs' weak forms, each row of forces weighted by what it leaves.

    Parameters
    ----------
    parts : sequence of Rows
        The logs.
    chassis : Chassis
        The robot.
    delay : float
        By which poses come late, in samples.
    prior : ndarray, shape (p,)
        What is believed.
    basis : ndarray, shape (p, d)
        Directions in which phi may be elsewhere, each of the size that is expected.
    passes : int
        How often rows are weighted anew.
    """
    Y, _, y = _stacked(parts, chassis, delay)
    return _fitted(Y, y, parts, prior, basis, passes)[0]


def extrapolated(
    parts: Sequence[Rows], chassis: Chassis, delay: float, prior: Array, basis: Array, free: bool = False
) -> Fit:
    """Return what least squares would be of poses without noise: simulation extrapolation.

    Cook and Stefanski (1994): phi is fitted to the log as it is, and with more noise of one and of two times
    the variance that there is; the parabola through these is taken to a variance of -1, where none is left.

    Parameters
    ----------
    parts, chassis, delay, prior, basis
        As of `solve`.
    free : bool
        Whether the delay is sought too, near the one given: it is one more column, and its uncertainty is in
        the covariance.
    """
    fit, scale = _extrapolated(parts, chassis, delay, prior, basis, free, 1.0), 1.0
    if not (chassis.scaled and chassis.motors):
        return fit
    for _ in range(_ROUNDS):  # in which the back-EMF is not linear
        before = scale
        scale = float(np.clip(fit.phi[-1], scale / _FARTHEST, scale * _FARTHEST))
        if abs(scale - before) <= _SAME * scale:
            break
        fit = _extrapolated(parts, chassis, delay, prior, basis, free, scale)
    return fit


def _extrapolated(
    parts: Sequence[Rows],
    chassis: Chassis,
    delay: float,
    prior: Array,
    basis: Array,
    free: bool,
    scale: float,
) -> Fit:
    """Return the same of equations that are linear near a scale of the inputs."""
    Y, shaken, y = _stacked(parts, chassis, delay, scale)
    if free:
        less, more = (
            np.concatenate([part.forces(chassis, delay + shift, scale) for part in parts])
            for shift in (-0.5, 0.5)
        )
        column = (less - more)[..., None]
        Y, shaken = _beside(Y, column), _beside(shaken, column)
        prior, basis = np.append(prior, 0.0), np.pad(basis, ((0, 1), (0, 1)))
        basis[-1, -1] = 1.0
    plain, influence = _fitted(Y, y, parts, prior, basis)
    phi, influence = _WEIGHTS[0] * plain.phi, _WEIGHTS[0] * influence
    for weight, level in zip(_WEIGHTS[1:], shaken, strict=True):
        for each in level:
            noisy, more = _fitted(each, y, parts, prior, basis)
            phi, influence = phi + weight / _SHAKES * noisy.phi, influence + weight / _SHAKES * more
    covariance = _newey_west(influence, parts, basis.shape[1])
    if not free:
        return plain._replace(phi=phi, covariance=covariance, delay=delay)
    size = phi[-2] / scale if chassis.scaled else 1.0  # of the forces, which the column is in proportion to
    late, error = delay + phi[-1] / size, np.sqrt(covariance[-1, -1]) / abs(size)
    return plain._replace(
        phi=phi[:-1], covariance=covariance[:-1, :-1], delay=float(late), delay_error=float(error)
    )


def _stacked(
    parts: Sequence[Rows], chassis: Chassis, delay: float, scale: float = 1.0
) -> tuple[Array, Array, Array]:
    Y, shaken, y = zip(*(part.equations(chassis, delay, scale) for part in parts), strict=True)
    return np.concatenate(Y), np.concatenate(shaken, axis=2), np.concatenate(y)


def _fitted(
    Y: Array, y: Array, parts: Sequence[Rows], prior: Array, basis: Array, passes: int = 5
) -> tuple[Fit, Array]:
    """Return a fit, and how each window moves it, shape (n, p)."""
    least = 1e-12 * np.sqrt((y**2).mean()) + np.finfo(float).tiny
    deviation = np.maximum((y - Y @ prior).std(axis=0), least)
    weights = np.ones(y.shape) / deviation
    for _ in range(passes):
        A = Y * weights[..., None]
        right = np.einsum("nki,nk->i", A, (y - Y @ prior) * weights)
        phi = prior + _inverse(A, basis) @ right
        left = y - Y @ phi
        deviation = np.maximum(NORMAL * np.median(np.abs(left), axis=0), least)
        size = np.abs(left) / deviation
        weights = np.sqrt(np.minimum(1, _HUBER / np.maximum(size, _HUBER))) / deviation
    scores = np.einsum("nki,nk->ni", Y * weights[..., None], left * weights)
    # Rows beyond Huber's bound push with a force that does not change: they are not in the slope.
    influence = scores @ _inverse(Y * ((size < _HUBER) / deviation)[..., None], basis)
    cost = float((np.minimum(size, _CAP) ** 2).mean() * np.prod(deviation) ** (2 / y.shape[1]))
    explained = 1 - float((left**2).sum() / max((y**2).sum(), least))
    covariance = _newey_west(influence, parts, basis.shape[1])
    return Fit(phi, covariance, cost, explained), influence


def _inverse(A: Array, basis: Array) -> Array:
    """Return the inverse of the normal matrix within the space of the basis' columns."""
    normal = basis.T @ np.einsum("nki,nkj->ij", A, A) @ basis
    return np.asarray(basis @ np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ basis.T)


def _newey_west(influence: Array, parts: Sequence[Rows], unknown: int) -> Array:
    """Return the covariance of a sum of what windows of logs contribute, those near each other correlated."""
    total = np.zeros((influence.shape[1],) * 2)
    for each in np.split(influence, np.cumsum([len(part.Y) for part in parts])[:-1]):
        total = total + each.T @ each
        for lag in range(1, min(_LAG, len(each) - 1) + 1):
            product = each[lag:].T @ each[:-lag]
            total = total + (1 - lag / (_LAG + 1)) * (product + product.T)
    windows = len(influence) / _HOPS  # that do not overlap
    return np.asarray(total * windows / max(windows - unknown, 1.0))
