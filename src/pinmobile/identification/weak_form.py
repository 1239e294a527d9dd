"""The weak form: the equations of motion integrated against a bump, so that no acceleration is needed.

Windows of 0.6 s, weighted by g = (1 - z^2)^4, are integrated by parts. Forces along the inertial axes are
second derivatives, Fx = d^2/dt^2 (m x + m x_bc c - m y_bc s) + friction, so of these only poses are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.identification.chassis import Chassis
from pinmobile.identification.cleaning import Cleaned

WINDOW = 0.6  # [s]
_HOPS = 8  # per window
_LAG = 16  # windows over which residuals hang together: twice those that overlap
_HUBER = 1.345
_NORMAL = 1.4826
_SHAKES = 3  # draws of noise that tell how much of the regressor noise is
_CAP = 3.0  # deviations beyond which a row costs no more


class Rows(NamedTuple):
    """The weak form of one log.

    Attributes
    ----------
    Y : ndarray, shape (n, k, p)
        Rows of the regressor, without that of an unknown scale of the input.
    shaken : ndarray, shape (draws, n, k, p)
        What more noise of the sensors, as much as there is, would add to it.
    known : ndarray, shape (n, k)
        What of the force is that of known inertia, damping and loads.
    run : Cleaned
        The log.
    hop : int
        Samples between two windows.
    g : ndarray, shape (size,)
        The bump, of sum 1.
    """

    Y: Array
    shaken: Array
    known: Array
    run: Cleaned
    hop: int
    g: Array

    def forces(self, chassis: Chassis, delay: float) -> Array:
        """Return the forces of the windows, of a pose that comes late by so many samples, shape (n, k)."""
        count = len(self.run.q)
        edges = np.asarray(np.arange(count + 1) - 0.5, np.float64)  # half of the input before a sample counts
        u = self.run.shifted(delay, edges)
        return np.asarray(_windows(u if chassis.B is None else u @ chassis.B.T, self.g, self.hop))

    def equations(self, chassis: Chassis, delay: float) -> tuple[Array, Array]:
        """Return the regressor, shape (n, k, p), and what it should give, shape (n, k)."""
        forces = self.forces(chassis, delay)
        if not chassis.scaled:
            return self.Y, forces - self.known
        return np.concatenate([self.Y, -forces[..., None]], axis=-1), -self.known


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
    """

    phi: Array
    covariance: Array
    cost: float
    explained: float


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
    build = _inertial if chassis.B is None else _along_free
    Y, known = build(run, chassis, (g, g1, g2), hop)
    loaded = known + Y[..., :4] @ run.load
    generator = np.random.default_rng(0)
    shaken = [build(run.shaken(generator), chassis, (g, g1, g2), hop)[0] - Y for _ in range(_SHAKES)]
    return Rows(Y, np.stack(shaken), loaded, run, hop, g)


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
    known = -over(eta, g1) @ chassis.inertia.T + over(eta) @ chassis.damping.T
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
    pairs = [part.equations(chassis, delay) for part in parts]
    Y, y = (np.concatenate(each) for each in zip(*pairs, strict=True))
    noise = np.concatenate([part.shaken for part in parts], axis=1)
    noise = np.concatenate([noise, np.zeros((*noise.shape[:3], Y.shape[2] - noise.shape[3]))], axis=-1)
    count, k, _ = Y.shape
    least = 1e-12 * np.sqrt((y**2).mean()) + np.finfo(float).tiny
    deviation = np.maximum((y - Y @ prior).std(axis=0), least)
    weights = np.ones((count, k)) / deviation
    for _ in range(passes):
        A, N = Y * weights[..., None], noise * weights[..., None]
        extra = np.einsum("dnki,dnkj->ij", N, N) / len(N)  # that noise adds to the normal matrix: a bias
        normal = np.einsum("nki,nkj->ij", A, A) - extra
        right = np.einsum("nki,nk->i", A, y * weights) - normal @ prior
        bread = np.linalg.pinv(basis.T @ normal @ basis, rcond=1e-12, hermitian=True)
        phi = prior + basis @ (bread @ (basis.T @ right))
        left = y - Y @ phi
        deviation = np.maximum(_NORMAL * np.median(np.abs(left), axis=0), least)
        size = np.abs(left) / deviation
        weights = np.sqrt(np.minimum(1, _HUBER / np.maximum(size, _HUBER))) / deviation
    scores = np.einsum("nki,nk->ni", A, left * weights) + extra @ phi / count
    cuts = np.cumsum([len(part.Y) for part in parts])[:-1]
    half = basis @ bread @ basis.T
    covariance = half @ sum(_newey_west(part) for part in np.split(scores, cuts)) @ half.T
    cost = float((np.minimum(size, _CAP) ** 2).mean() * np.prod(deviation) ** (2 / k))
    explained = 1 - float((left**2).sum() / max((y**2).sum(), least))
    return Fit(phi, np.asarray(covariance), cost, explained)


def _newey_west(scores: Array) -> Array:
    total = scores.T @ scores
    for lag in range(1, min(_LAG, len(scores) - 1) + 1):
        part = scores[lag:].T @ scores[:-lag]
        total = total + (1 - lag / (_LAG + 1)) * (part + part.T)
    return np.asarray(total)
