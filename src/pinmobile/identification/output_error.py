"""Output error: parameters and first states by simulation of a log, and tests of the residual.

The residual of a segment is (measured - simulated) / noise. Gauss-Newton steps, damped where the cost would
rise; the first states are projected out of each segment's Jacobian by QR, so that the normal matrix has the
size of the parameters. Perturbed parameters and states of all segments are simulated side by side.

Noise of a logged force is in the simulation, and so in its slopes too: it would pull parameters to where it
does less, such as to a larger inertia. By how much a second draw of it tells, which is taken off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification.chassis import Chassis
from pinmobile.identification.cleaning import Cleaned

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


_SHIFT = 1e-5  # of a parameter's scale, or of a start's, in differences
_CONVERGED = 1e-3  # of a variance: the last step is of less than a thirtieth of a deviation
_ROUNDING = 1e-9  # of the cost
_LATER = (-1, 1)  # samples: the difference of these simulations is the slope by the delay
_FIRST_PASSES = 2
_STEPS = 30  # of Gauss and Newton at most
_MEASURED = 0.5  # share of a segment's samples that count, without which its first state is not told
_SHAKE = 1e-2  # of an input's deviation, to see what noise of it does
_LEAST_SIZE = 1e-3  # of an input, or of a response to one, as a share of the largest
_RESPONSES = 3  # of a sensor, as the heading turns them
_DRAWS = 3  # of noise, by which estimates have a sixth more of what is due to products of noise
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
    delay : float
        By which poses come late, in samples.
    start : ndarray, shape (S, 3 + k)
        Guess of the first states.
    noise : ndarray, shape (m,)
        Of what is measured.
    """

    run: Cleaned
    at: NDArray[np.int_]
    measured: Array
    good: Array
    delay: float
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
        k = k[run.good[k].mean(axis=1) >= _MEASURED]
        noise, measured = run.noise, run.q[k]
        if run.rates is not None and run.rates_noise is not None:
            noise = np.concatenate([noise, run.rates_noise])
            measured = np.concatenate([measured, run.rates[k]], axis=-1)
        start = np.concatenate([run.q[k[:, 0]], run.free_velocities(chassis)[k[:, 0]]], axis=-1)
        return cls(run, k, measured / noise, run.good[k].astype(float), delay, start, noise)

    @property
    def part(self) -> float:
        """Share of the time to the next sample in which the input is the one before."""
        return self.delay - float(np.floor(self.delay))

    def with_more(self, inputs: Array) -> Segments:
        """Return the segments of a log with more inputs, shape (N, nu)."""
        return self._replace(run=replace(self.run, u=self.run.u + inputs))

    @property
    def sizes(self) -> Array:
        """Which size the inputs have, shape (nu,)."""
        sizes = self.run.u.std(axis=0)
        return np.asarray(np.maximum(sizes, _LEAST_SIZE * sizes.max() + np.finfo(float).tiny))

    def responses(self, chassis: Chassis, starts: Array, phi: Array) -> Array:
        """Return what sensors answer to inputs that are held for the first step, shape (r, L, m).

        Of a robot at rest without dry friction; of all headings and inputs, the few that have most of it.
        """
        resting, smooth = starts.copy(), phi.copy()
        resting[:, 3:], smooth[chassis.dry], smooth[chassis.offsets] = 0.0, 0.0, 0.0
        first = np.clip(self.at[:, 0] - int(np.floor(self.delay)), 0, len(self.run.u) - 1)
        none, found = np.zeros_like(self.run.u), []
        for unit in np.diag(self.sizes):
            held = none.copy()
            held[first] = unit
            there = self._replace(run=replace(self.run, u=held))
            found.append(there.simulated(chassis, resting[:, None], smooth[None])[:, 0])
            found[-1] = found[-1] - found[-1][:, :1]
        _, sizes, rows = np.linalg.svd(np.moveaxis(np.concatenate(found), -1, 0), full_matrices=False)
        sizes = np.where(sizes > _LEAST_SIZE * sizes[:, :1], sizes, 0.0)
        return np.asarray(np.moveaxis((sizes[..., None] * rows)[:, :_RESPONSES], 0, -1))

    def simulated(self, chassis: Chassis, z: Array, phi: Array, later: Sequence[int] = (0,)) -> Array:
        """Return what sensors would measure over their noise, shape (S, V, L, m).

        Parameters
        ----------
        chassis : Chassis
            The robot.
        z : ndarray, shape (S, V, 3 + k)
            First states, V of each segment.
        phi : ndarray, shape (V, p) or (S, V, p)
            Parameters, without loads.
        later : sequence of int, of length 1 or V
            By how many samples more the pose comes late.
        """
        loaded = np.array(np.broadcast_to(phi, (*z.shape[:2], phi.shape[-1])))
        loaded[..., :4] += self.run.load
        length = self.measured.shape[1]
        states = np.empty((length, *z.shape))
        states[0] = z
        inputs = [_inputs(self.run, self.at, self.delay + shift)[:2] for shift in later]
        first, then = (np.stack(each, axis=2) for each in zip(*inputs, strict=True))
        shares = np.array([self.part, 1 - self.part]) * self.run.dt
        counts = np.ceil(shares / chassis.longest_step - 1e-9).astype(int)
        spans, step = shares / np.maximum(counts, 1), chassis.stepped((int(counts[0]), int(counts[1])))
        for k in range(length - 1):
            states[k + 1] = step(states[k], first[:, k], then[:, k], loaded, spans)
        out = states[..., :3]
        if self.measured.shape[-1] > 3:
            out = np.concatenate([out, states[..., 3:] @ chassis.A.T], axis=-1)
        return np.asarray(np.moveaxis(out / self.noise, 0, 2))

    def left(self, chassis: Chassis, z: Array, phi: Array) -> Array:
        """Return measured less simulated of states z, shape (S, 3 + k), over the noise, shape (S, L, m)."""
        out = self.simulated(chassis, z[:, None], phi[None])[:, 0]
        return np.asarray((self.measured - out) * self.good[..., None])


def _inputs(run: Cleaned, at: NDArray[np.int_], delay: float) -> tuple[Array, Array]:
    """Return the inputs of both parts of the time to the next sample."""
    whole, last = int(np.floor(delay)), len(run.u) - 1
    return run.u[np.clip(at - whole - 1, 0, last)], run.u[np.clip(at - whole, 0, last)]


class Estimate(NamedTuple):
    """What output error found.

    Attributes
    ----------
    phi : ndarray, shape (p,)
        The parameters.
    delay, delay_error : float
        By which poses come late, in samples, and its deviation: not a number where it was given.
    starts : list of ndarray, shape (S, 3 + k)
        First states of each log's segments.
    covariance : ndarray, shape (p, p)
        Of the parameters, by CR3, the jackknife over segments (Bell and McCaffrey 2002); the delay's
        uncertainty is in it where that was free.
    residuals : list of ndarray, shape (S, L, m)
        Of each log, in the units of what is measured; zero where nothing was.
    good : list of ndarray, shape (S, L)
        Where something was.
    chi2 : float
        Mean square of the residuals over the noise, per degree of freedom.
    segments : int
        How many there are.
    pulled : float
        How far noise of the inputs pulls parameters without what is taken off, in deviations of the
        residuals' noise.
    said : ndarray, shape (S, 2)
        Gradient and curvature of half the cost of each segment by the delay; zero where that was given.
    """

    phi: Array
    delay: float
    delay_error: float
    starts: list[Array]
    covariance: Array
    residuals: list[Array]
    good: list[Array]
    chi2: float
    segments: int
    pulled: float
    said: Array


class _Point(NamedTuple):
    """Where a search is."""

    phi: Array
    delay: float
    starts: list[Array]


class _Linear(NamedTuple):
    """The segments of a log, linearised: J with the starts projected out, and what leads back to them."""

    J: Array  # (S, n, d)
    e: Array  # (S, n), projected
    Q: Array  # (S, n, s)
    R: Array  # (S, s, s)
    raw: Array  # (S, n), as they are
    slopes: Array  # (S, n, d)


@dataclass(frozen=True, eq=False)
class OutputError:
    """The problem: segments of logs, and a robot.

    Parameters
    ----------
    logs : sequence of Segments
        The segments.
    chassis : Chassis
        The robot.
    delay : float
        By which poses come late, in samples.
    free : bool
        Whether the delay is sought too: then it follows the parameters, as the last of them.
    noise : sequence of ResidualNoise
        Of each log; none: residuals are those of the sensors alone, white.
    """

    logs: Sequence[Segments]
    chassis: Chassis
    delay: float = 0.0
    free: bool = False
    noise: Sequence[ResidualNoise] = ()

    def _whitened(self, k: int, residuals: Array) -> Array:
        """Return residuals of a log, shape (S, V, L, m), as white ones of variance 1."""
        return self.noise[k].whitened(residuals) if self.noise else residuals

    def _moved(
        self, point: _Point, parts: Sequence[_Linear], step: Array, basis: Array
    ) -> tuple[_Point, float]:
        """Return where a step leads to, first states as far as their segment gains, and the cost."""
        phi = point.phi + basis @ step[: basis.shape[1]]
        delay = point.delay + (float(step[-1]) if self.free else 0.0)
        if not self.chassis.is_possible(phi):
            return point, np.inf
        found, total = [], 0.0
        for k, (log, z, part) in enumerate(zip(self._late(delay), point.starts, parts, strict=True)):
            way = _start_step(part, step)
            tried = z[:, None] + _SHARES[:, None] * way[:, None]
            with np.errstate(all="ignore"):
                out = log.simulated(self.chassis, tried, phi[None])
                left = self._whitened(k, (log.measured[:, None] - out) * log.good[:, None, :, None])
                costs = (left**2).sum(axis=(2, 3))
            costs = np.where(np.isfinite(costs), costs, np.inf)
            best = costs.argmin(axis=1)
            found.append(tried[np.arange(len(z)), best])
            total += float(costs.min(axis=1).sum())
        return _Point(phi, delay, found), total

    def _late(self, delay: float) -> Sequence[Segments]:
        return [log._replace(delay=delay) for log in self.logs] if self.free else self.logs

    def _linear(self, point: _Point, basis: Array) -> list[_Linear]:
        return [self._linear_of(k, point, basis) for k in range(len(self.logs))]

    def _linear_of(self, k: int, point: _Point, basis: Array) -> _Linear:
        log, z, phi = self._late(point.delay)[k], point.starts[k], point.phi
        p, s = basis.shape[1], z.shape[1]
        off_phi, off_z = _SHIFT * basis.T, _SHIFT * np.eye(s)
        lanes, shifts = 1 + p + s, _LATER if self.free else ()
        phis, states = np.tile(phi, (lanes, 1)), np.tile(z[:, None], (1, lanes, 1))
        phis[1 : p + 1] += off_phi
        states[:, p + 1 :] += off_z
        seen, later = log.good[:, None, :, None], [*[0] * lanes, *shifts]
        phis = np.vstack([phis, np.tile(phi, (len(shifts), 1))])
        states = np.concatenate([states, np.tile(z[:, None], (1, len(shifts), 1))], axis=1)
        with np.errstate(all="ignore"):
            out = log.simulated(self.chassis, states, phis, later if shifts else (0,))
            raw, moved = log.measured[:, None] - out[:, :1], (out[:, 1:lanes] - out[:, :1]) / _SHIFT
            by_delay = np.diff(out[:, lanes:], axis=1) / np.ptp(_LATER)
            parts = self._whitened(k, np.concatenate([raw, moved, by_delay], axis=1) * seen)
        if not np.isfinite(parts).all():
            raise InvalidArgument(
                "log has inputs by which the robot that fits best runs away from the poses, expected poses "
                "that follow: are inputs of another robot, in another frame, or of another sign?"
            )
        columns = np.swapaxes(parts.reshape(*parts.shape[:2], -1), 1, 2)
        raw, by_z = columns[..., 0], columns[..., p + 1 : p + 1 + s]
        slopes = np.concatenate([columns[..., 1 : p + 1], columns[..., p + 1 + s :]], axis=-1)
        Q, R = np.linalg.qr(by_z)
        J = slopes - Q @ (np.swapaxes(Q, 1, 2) @ slopes)
        e = raw - (Q @ (np.swapaxes(Q, 1, 2) @ raw[..., None]))[..., 0]
        return _Linear(J, e, Q, R, raw, slopes)

    def solve(self, phi: Array, basis: Array, most: int = _STEPS, starts: Sequence[Array] = ()) -> Estimate:
        """Return the estimate, from a guess on, within the space of the basis' columns.

        Parameters
        ----------
        phi : ndarray, shape (p,)
            The guess.
        basis : ndarray, shape (p, d)
            Directions in which it may go, each of the size that is expected.
        most : int
            Most steps; none: the guess is judged as it is.
        starts : sequence of ndarray, shape (S, 3 + k)
            First states to begin with, where they are known.
        """
        point, cost, parts = self.started(phi, basis, starts)
        pull = self.pull(point, parts, basis)
        damping, taken, gone = _FIRST_DAMPING, 0, np.zeros(len(pull))
        while taken < most:
            taken += 1
            H_i, g_i = _normal(parts, pull)
            H, g = H_i.sum(axis=0), g_i.sum(axis=0)
            while True:
                step = np.linalg.lstsq(H + damping * np.diag(np.diag(H)), g, rcond=None)[0]
                moved, new = self._moved(point, parts, step, basis)
                new += 2 * float(pull @ (gone + step))
                if new <= cost * (1 + 1e-12) or damping > _LARGEST_DAMPING:
                    break
                damping = max(10 * damping, 1e-4)
            if new > cost:
                break
            said = float(g @ np.linalg.lstsq(g_i.T @ g_i, g, rcond=None)[0])  # beside what segments differ by
            near = said <= _CONVERGED or cost - new <= _ROUNDING * cost
            point, cost, gone = moved, new, gone + step
            damping = max(damping / 10, _FIRST_DAMPING)
            parts = self._linear(point, basis)
            if near:
                break
        return self._estimate(point, basis, parts, pull)

    def pull(self, point: _Point, parts: Sequence[_Linear], basis: Array) -> Array:
        """Return what noise of the inputs adds to the right side, shape (d,): from other draws of it."""
        pull, generator = np.zeros(basis.shape[1] + self.free), np.random.default_rng(0)
        for k, (noise, part) in enumerate(zip(self.noise, parts, strict=False)):
            log, start = self._late(point.delay)[k], point._replace(starts=[point.starts[k]])
            shape, unit = log.run.u.shape, _SHAKE * log.sizes
            before, power = self._simulated(k, log, point), []
            for row in np.diag(unit):
                drawn = log.with_more(generator.standard_normal(shape) * row)
                power.append(((self._simulated(k, drawn, point) - before) ** 2).mean(axis=0).sum(axis=0))
            sizes = unit * np.sqrt(_shares(np.array(power).T, noise.share))
            for _ in range(_DRAWS):
                shaken = log.with_more(generator.standard_normal(shape) * sizes)
                problem = OutputError([shaken], self.chassis, point.delay, self.free, [noise])
                there = problem._linear_of(0, start, basis)
                way, slopes = there.raw - part.raw, there.slopes - part.slopes
                way = way - (part.Q @ (np.swapaxes(part.Q, 1, 2) @ way[..., None]))[..., 0]
                pull = pull + np.einsum("sni,sn->i", slopes, way) / _DRAWS
        return pull

    def innovations(self, found: Estimate) -> list[Array]:
        """Return the white residuals of each log, first states that fit best taken off, shape (S, L, m)."""
        point = _Point(found.phi, found.delay, found.starts)
        parts = self._linear(point, np.eye(len(found.phi))[:, :1])
        return [part.e.reshape(log.measured.shape) for part, log in zip(parts, self.logs, strict=True)]

    def _simulated(self, k: int, log: Segments, point: _Point) -> Array:
        """Return the white residuals of a log's segments, shape (S, L, m)."""
        left = log.left(self.chassis, point.starts[k], point.phi)
        return self._whitened(k, left[:, None])[:, 0]

    def started(
        self, phi: Array, basis: Array, starts: Sequence[Array] = ()
    ) -> tuple[_Point, float, list[_Linear]]:
        """Return parameters with the first states that fit best, the cost, and the problem linearised."""
        point = _Point(phi, self.delay, list(starts) or [log.start for log in self.logs])
        nowhere = np.zeros(basis.shape[1] + self.free)
        parts, cost = self._linear(point, basis), np.inf
        if starts:
            return point, sum(float((part.raw**2).sum()) for part in parts), parts
        for _ in range(_FIRST_PASSES):
            point, cost = self._moved(point, parts, nowhere, basis)
            parts = self._linear(point, basis)
        return point, cost, parts

    def _estimate(self, point: _Point, basis: Array, parts: Sequence[_Linear], pull: Array) -> Estimate:
        H_i, g_i = _normal(parts, pull)
        H, S, p = H_i.sum(axis=0), len(H_i), basis.shape[1]
        try:
            d = np.linalg.solve(H - H_i, g_i[..., None])[..., 0]
        except np.linalg.LinAlgError as error:
            raise InvalidArgument(
                f"log has {S} segments, without one of which a parameter is not told: expected a longer log, "
                "or one that excites more, see excitation"
            ) from error
        jackknife = (S - 1) / S * d.T @ d
        late, numbers = self._late(point.delay), sum(log.good.sum() * log.noise.size for log in self.logs)
        residuals = [log.left(self.chassis, z, point.phi) for log, z in zip(late, point.starts, strict=True)]
        freedom = max(1, int(numbers) - p - point.starts[0].shape[1] * S)
        return Estimate(
            point.phi,
            point.delay,
            float(np.sqrt(jackknife[-1, -1])) if self.free else np.nan,
            point.starts,
            basis @ jackknife[:p, :p] @ basis.T,
            [e * log.noise for e, log in zip(residuals, self.logs, strict=True)],
            [log.good for log in self.logs],
            sum(float((e**2).sum()) for e in residuals) / freedom,
            S,
            float(np.sqrt(max(pull @ np.linalg.lstsq(H, pull, rcond=None)[0], 0.0))),
            np.column_stack([g_i[:, -1], H_i[:, -1, -1]]) if self.free else np.zeros((S, 2)),
        )


def _normal(parts: Sequence[_Linear], pull: Array) -> tuple[Array, Array]:
    """Return what each segment adds to the normal matrix, shape (S, d, d), and to the right side, (S, d).

    Each of the segments takes its part of the pull off.
    """
    H_i = np.concatenate([np.einsum("sni,snj->sij", part.J, part.J) for part in parts])
    g_i = np.concatenate([np.einsum("sni,sn->si", part.J, part.e) for part in parts])
    return H_i, g_i - pull / len(g_i)


def _shares(power: Array, share: Array) -> Array:
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


def _start_step(part: _Linear, step: Array) -> Array:
    """Return how far the first states go with a step of the parameters, shape (S, s)."""
    rest = part.raw - part.slopes @ step
    return np.asarray(np.linalg.solve(part.R, (np.swapaxes(part.Q, 1, 2) @ rest[..., None]))[..., 0])
