"""Output error: the parameters, and the first states of segments, with which a simulation meets the log.

The residual of a segment is (measured - simulated) / noise. Gauss-Newton steps, damped where the cost would
rise; the first states are projected out of each segment's Jacobian by QR, so that the normal matrix has the
size of the parameters. Perturbed parameters and states of all segments are simulated side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.identification.chassis import Chassis
from pinmobile.identification.cleaning import Cleaned

_SHIFT = 1e-5  # of a parameter's scale, or of a start's, in differences
_CONVERGED = 1e-4  # of a variance: steps of less than a hundredth of a deviation
_ROUNDING = 1e-12  # of the cost
_STEP = 0.005  # [s], longest of the integration: dry friction changes its sign within some
_FIRST_PASSES = 2
_SHARES = np.array([1.0, 0.5, 0.2, 0.05, 0.0])  # of the way of a first state that are tried
_FIRST_DAMPING, _LARGEST_DAMPING = 1e-9, 1e9


class Segments(NamedTuple):
    """The segments of a log.

    Attributes
    ----------
    run : Cleaned
        The log.
    at : ndarray of int, shape (S, L)
        Which samples.
    measured : ndarray, shape (S, L, m)
        Pose, and rates of wheels where there are any, over their noise.
    good : ndarray, shape (S, L)
        1 where the sample is measured, 0 elsewhere.
    first, then : ndarray, shape (S, L, nu)
        Input of the first and of the second part of the time to the next sample.
    part : float
        How long the first part is, as a share.
    start : ndarray, shape (S, 3 + k)
        Guess of the first states.
    noise : ndarray, shape (m,)
        Of what is measured.
    """

    run: Cleaned
    at: NDArray[np.int_]
    measured: Array
    good: Array
    first: Array
    then: Array
    part: float
    start: Array
    noise: Array

    @property
    def number(self) -> int:
        """How many there are."""
        return len(self.start)

    @classmethod
    def of(cls, run: Cleaned, chassis: Chassis, delay: float, seconds: float) -> Segments:
        """Return the segments of a log whose poses come late by so many samples."""
        length = max(8, round(seconds / run.dt))
        whole = int(np.floor(delay))
        begin = max(0, whole + 1)
        count = (min(len(run.q), len(run.q) + whole) - begin) // length
        k = begin + np.arange(count * length).reshape(count, length)
        noise, measured = run.noise, run.q[k]
        if run.rates is not None and run.rates_noise is not None:
            noise = np.concatenate([noise, run.rates_noise])
            measured = np.concatenate([measured, run.rates[k]], axis=-1)
        start = np.concatenate([run.q[k[:, 0]], run.free_velocities(chassis)[k[:, 0]]], axis=-1)
        good, inputs = run.good[k].astype(float), _inputs(run, k, delay)
        return cls(run, k, measured / noise, good, *inputs, start, noise)

    def late(self, delay: float) -> Segments:
        """Return the same segments of poses that come late by another delay, in samples."""
        first, then, part = _inputs(self.run, self.at, delay)
        return self._replace(first=first, then=then, part=part)

    def simulated(self, chassis: Chassis, z: Array, phi: Array) -> Array:
        """Return what sensors would measure over their noise, shape (S, V, L, m).

        Parameters
        ----------
        chassis : Chassis
            The robot.
        z : ndarray, shape (S, V, 3 + k)
            First states, V of each segment.
        phi : ndarray, shape (V, p) or (S, V, p)
            Parameters, without loads.
        """
        loaded = np.array(np.broadcast_to(phi, (*z.shape[:2], phi.shape[-1])))
        loaded[..., :4] += self.run.load
        length = self.measured.shape[1]
        states = np.empty((length, *z.shape))
        states[0] = z
        parts = [(self.first, self.part), (self.then, 1 - self.part)]
        for k in range(length - 1):
            now = states[k]
            for u, share in parts:
                steps = int(np.ceil(share * self.run.dt / _STEP - 1e-9))
                for _ in range(steps):
                    span = np.array([share * self.run.dt / steps])
                    now = chassis.stepped(now, u[:, k, None], loaded, span)
            states[k + 1] = now
        out = states[..., :3]
        if self.measured.shape[-1] > 3:
            out = np.concatenate([out, states[..., 3:] @ chassis.A.T], axis=-1)
        return np.asarray(np.moveaxis(out / self.noise, 0, 2))


def _inputs(run: Cleaned, at: NDArray[np.int_], delay: float) -> tuple[Array, Array, float]:
    """Return the inputs of both parts of the time to the next sample, and the share of the first."""
    whole, last = int(np.floor(delay)), len(run.u) - 1
    before, now = (run.u[np.clip(at - whole - back, 0, last)] for back in (1, 0))
    return before, now, delay - whole


class Estimate(NamedTuple):
    """What output error found.

    Attributes
    ----------
    phi : ndarray, shape (p,)
        The parameters.
    starts : list of ndarray, shape (S, 3 + k)
        First states of each log's segments.
    covariance : ndarray, shape (p, p)
        Of them by CR3, the jackknife over segments (Bell and McCaffrey 2002).
    model_based : ndarray, shape (p, p)
        As it would be if residuals were white.
    residuals : list of ndarray, shape (S, L, m)
        Of each log, in the units of what is measured; zero where nothing was.
    good : list of ndarray, shape (S, L)
        Where something was.
    chi2 : float
        Mean square of the residuals over the noise, per degree of freedom.
    segments : int
        How many there are.
    steps : int
        How many Gauss-Newton steps were taken.
    """

    phi: Array
    starts: list[Array]
    covariance: Array
    model_based: Array
    residuals: list[Array]
    good: list[Array]
    chi2: float
    segments: int
    steps: int


class _Linear(NamedTuple):
    """The segments of a log, linearised: J with the starts projected out, and what leads back to them."""

    J: Array  # (S, n, p)
    e: Array  # (S, n), projected
    Q: Array  # (S, n, s)
    R: Array  # (S, s, s)
    raw: Array  # (S, n), as they are
    slopes: Array  # (S, n, p)


class OutputError:
    """The problem: segments of logs, and a robot.

    Parameters
    ----------
    logs : sequence of Segments
        The segments.
    chassis : Chassis
        The robot.

    Attributes
    ----------
    STEPS : int
        Gauss-Newton steps at most.
    """

    STEPS: ClassVar[int] = 30

    def __init__(self, logs: Sequence[Segments], chassis: Chassis) -> None:
        self.logs, self.chassis = logs, chassis
        self.numbers = sum(int(log.good.sum()) * log.measured.shape[-1] for log in logs)

    def _residuals(self, phi: Array, starts: Sequence[Array]) -> list[Array]:
        found = []
        with np.errstate(all="ignore"):
            for log, z in zip(self.logs, starts, strict=True):
                out = log.simulated(self.chassis, z[:, None], phi[None])[:, 0]
                found.append((log.measured - out) * log.good[..., None])
        return found

    def _moved(
        self, phi: Array, starts: Sequence[Array], parts: Sequence[_Linear], step: Array
    ) -> tuple[list[Array], float]:
        """Return the first states that a step leads to, each as far as its segment gains, and the cost."""
        if not self.chassis.is_possible(phi):
            return list(starts), np.inf
        found, total = [], 0.0
        for log, z, part in zip(self.logs, starts, parts, strict=True):
            way = _start_step(part, step)
            tried = z[:, None] + _SHARES[:, None] * way[:, None]
            with np.errstate(all="ignore"):
                out = log.simulated(self.chassis, tried, phi[None])
                costs = (((log.measured[:, None] - out) * log.good[:, None, :, None]) ** 2).sum(axis=(2, 3))
            costs = np.where(np.isfinite(costs), costs, np.inf)
            best = costs.argmin(axis=1)
            found.append(tried[np.arange(len(z)), best])
            total += float(costs.min(axis=1).sum())
        return found, total

    def _linear(self, phi: Array, starts: Sequence[Array], basis: Array) -> list[_Linear]:
        return [self._linear_of(log, z, phi, basis) for log, z in zip(self.logs, starts, strict=True)]

    def _linear_of(self, log: Segments, z: Array, phi: Array, basis: Array) -> _Linear:
        p, s = basis.shape[1], z.shape[1]
        off_phi, off_z = _SHIFT * basis.T, _SHIFT * np.eye(s)
        lanes = 1 + p + s
        phis, states = np.tile(phi, (lanes, 1)), np.tile(z[:, None], (1, lanes, 1))
        phis[1 : p + 1] += off_phi
        states[:, p + 1 :] += off_z
        with np.errstate(all="ignore"):
            out = log.simulated(self.chassis, states, phis) * log.good[:, None, :, None]
        out = out.reshape(*out.shape[:2], -1)
        measured = (log.measured * log.good[..., None]).reshape(log.number, -1)
        raw = measured - out[:, 0]
        by_phi, by_z = (out[:, 1:] - out[:, :1])[:, :p] / _SHIFT, (out[:, p + 1 :] - out[:, :1]) / _SHIFT
        slopes = np.swapaxes(by_phi, 1, 2)
        Q, R = np.linalg.qr(np.swapaxes(by_z, 1, 2))
        J = slopes - Q @ (np.swapaxes(Q, 1, 2) @ slopes)
        e = raw - (Q @ (np.swapaxes(Q, 1, 2) @ raw[..., None]))[..., 0]
        return _Linear(J, e, Q, R, raw, slopes)

    def solve(self, phi: Array, basis: Array, most: int = 30) -> Estimate:
        """Return the estimate, from a guess on, within the space of the basis' columns.

        Parameters
        ----------
        phi : ndarray, shape (p,)
            The guess.
        basis : ndarray, shape (p, d)
            Directions in which it may go, each of the size that is expected.
        most : int
            Most steps; none: the guess is judged as it is.
        """
        starts, cost, parts = self.started(phi, basis)
        damping, taken = _FIRST_DAMPING, 0
        while taken < most:
            taken += 1
            H = np.asarray(sum(np.einsum("sni,snj->ij", part.J, part.J) for part in parts))
            g = np.asarray(sum(np.einsum("sni,sn->i", part.J, part.e) for part in parts))
            while True:
                step = np.linalg.lstsq(H + damping * np.diag(np.diag(H)), g, rcond=None)[0]
                tried = phi + basis @ step
                moved, new = self._moved(tried, starts, parts, step)
                if new <= cost * (1 + 1e-12) or damping > _LARGEST_DAMPING:
                    break
                damping = max(10 * damping, 1e-4)
            if new > cost:
                break
            phi, starts, near = tried, moved, float(step @ H @ step) <= _CONVERGED * new / self.numbers
            near, cost = near or cost - new <= _ROUNDING * cost, new
            damping = max(damping / 10, _FIRST_DAMPING)
            parts = self._linear(phi, starts, basis)
            if near:
                break
        return self._estimate(phi, starts, basis, parts, taken)

    def started(self, phi: Array, basis: Array) -> tuple[list[Array], float, list[_Linear]]:
        """Return the first states that fit parameters best, the cost, and the problem linearised there."""
        starts, cost, nowhere = [log.start for log in self.logs], np.inf, np.zeros(basis.shape[1])
        for _ in range(_FIRST_PASSES):
            parts = self._linear(phi, starts, basis)
            starts, cost = self._moved(phi, starts, parts, nowhere)
        return starts, cost, self._linear(phi, starts, basis)

    def lateness(self, delay: float, estimate: Estimate, basis: Array) -> tuple[float, float, Array]:
        """Return by how many samples poses come later than was taken, its deviation, and what segments say.

        A Gauss-Newton step of the delay, parameters and first states free.

        Parameters
        ----------
        delay : float
            The delay that was taken, in samples.
        estimate : Estimate
            What was found.
        basis : ndarray, shape (p, d)
            As of `solve`.

        Returns
        -------
        later, deviation : float
            In samples.
        said : ndarray, shape (S, 2)
            Gradient and curvature of half the cost of each segment.
        """
        said, mixed = [], []
        parts = self._linear(estimate.phi, estimate.starts, basis)
        for log, z, part in zip(self.logs, estimate.starts, parts, strict=True):
            less, more = (
                log.late(delay + shift).simulated(self.chassis, z[:, None], estimate.phi[None])[:, 0]
                for shift in (-0.5, 0.5)
            )
            slope = ((more - less) * log.good[..., None]).reshape(len(z), -1)
            slope = slope - (part.Q @ (np.swapaxes(part.Q, 1, 2) @ slope[..., None]))[..., 0]
            said.append(np.column_stack([(slope * part.e).sum(axis=1), (slope**2).sum(axis=1)]))
            mixed.append(np.einsum("sni,sn->si", part.J, slope))
        told, crossed = np.concatenate(said), np.concatenate(mixed)
        H = np.asarray(sum(np.einsum("sni,snj->ij", part.J, part.J) for part in parts))
        g_i = np.concatenate([np.einsum("sni,sn->si", part.J, part.e) for part in parts])
        way = np.linalg.lstsq(H, crossed.sum(axis=0), rcond=None)[0]
        own = told[:, 0] - g_i @ way  # gradients with the parameters free
        curvature = max(float(told[:, 1].sum() - crossed.sum(axis=0) @ way), 1e-300)
        return float(own.sum()) / curvature, float(np.sqrt((own**2).sum())) / curvature, told

    def _estimate(
        self, phi: Array, starts: Sequence[Array], basis: Array, parts: Sequence[_Linear], steps: int
    ) -> Estimate:
        H_i = np.concatenate([np.einsum("sni,snj->sij", part.J, part.J) for part in parts])
        g_i = np.concatenate([np.einsum("sni,sn->si", part.J, part.e) for part in parts])
        H, S = H_i.sum(axis=0), len(H_i)
        d = np.linalg.solve(H - H_i, g_i[..., None])[..., 0]
        jackknife = (S - 1) / S * d.T @ d
        residuals = self._residuals(phi, starts)
        freedom = max(1, self.numbers - basis.shape[1] - starts[0].shape[1] * S)
        chi2 = sum(float((e**2).sum()) for e in residuals) / freedom
        return Estimate(
            phi,
            list(starts),
            basis @ jackknife @ basis.T,
            basis @ (chi2 * np.linalg.inv(H)) @ basis.T,
            [e * log.noise for e, log in zip(residuals, self.logs, strict=True)],
            [log.good for log in self.logs],
            chi2,
            S,
            steps,
        )


def _start_step(part: _Linear, step: Array) -> Array:
    """Return how far the first states go with a step of the parameters, shape (S, s)."""
    rest = part.raw - part.slopes @ step
    return np.asarray(np.linalg.solve(part.R, (np.swapaxes(part.Q, 1, 2) @ rest[..., None]))[..., 0])
