"""`PreprocessedLog`: a log on equal steps without outliers, its segments, and the slip in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification.estimator import Segments
from pinmobile.identification.log import Log, check_units, held_integrals
from pinmobile.identification.statistics import NORMAL

LATER = 8  # samples by which a delay may differ from where its search begins
_WINDOW = 0.15  # [s] of the cubic whose residual tells outliers and noise
_OUTLIER = 6.0  # deviations
_BENT = 3e-3  # share of the way through a window below which nothing is an outlier
_OFTEN, _TIMES = 0.8, 4.0  # quantile of what a cubic leaves, and what is no outlier as a multiple of it
_PASSES = 40  # at most
_COARSEST, _ROWS = 0.1, 16  # [s] between samples, and of these, that filters and windows need
_CUTOFF = 8.0  # [Hz] of velocities
_FINEST, _FINEST_RATE = 1e-4, 1e-2  # [m, rad], [rad/s]: finer noise, as of a simulation, counts as this
_LONG = 3  # samples in a row that are lost; over more, a spline would swing with the noise beside them


@dataclass(frozen=True, eq=False)
class PreprocessedLog:
    """A log as methods want it.

    Attributes
    ----------
    dt : float
        Time between two samples [s].
    q : ndarray, shape (N, 3)
        Poses; those that are lost or outliers are bridged by what is measured beside them.
    good : ndarray of bool, shape (N,)
        Which are measured.
    u : ndarray, shape (N, nu)
        Input, held from each sample to the next.
    rates : ndarray, shape (N, a), or None
        Of the driven wheels [rad/s].
    noise : ndarray, shape (3,)
        Deviation of the noise of the pose [m, m, rad].
    rates_noise : ndarray, shape (a,), or None
        That of the rates [rad/s].
    outliers : int
        How many poses are outliers.
    load : ndarray, shape (4,)
        Mass, its moments and inertia about the body's origin, of a load that is known.
    """

    dt: float
    q: Array
    good: NDArray[np.bool_]
    u: Array
    rates: Array | None
    noise: Array
    rates_noise: Array | None
    outliers: int
    load: Array

    @classmethod
    def of(cls, log: Log, model: Any, load: Array, name: str = "log") -> PreprocessedLog:
        """Return a log cleaned for a model.

        Raises
        ------
        InvalidArgument
            If it has no poses, or inputs or wheels of another robot.
        """
        if log.q is None:
            raise InvalidArgument(f"{name} has no poses q, expected these: forces are told by what they move")
        if log.u.shape[1] != model.nu:
            expected = (
                "(Fx, Fy, Mz) of a body that is pushed; of wheels that roll give robot=..., of commands of "
                "speed and yaw rate take identify_velocity; joints of arms and steering are not identified"
                if model.B is None
                else f"one for each driven wheel, {', '.join(model.wheels)}; is it of another robot?"
            )
            raise InvalidArgument(f"{name} has {log.u.shape[1]} inputs, expected {model.nu}: {expected}")
        check_units(log, name, model.inputs, "A" if model.scaled and not model.motors else "")
        even = log.samples()
        if even.dt > 1.001 * _COARSEST:
            raise InvalidArgument(
                f"{name} has samples every {even.dt:.3g} s, expected {_COARSEST:g} s or less: how the robot "
                "moved between them is not known"
            )
        if len(even.t) < max(_ROWS, 4 * _WINDOW / even.dt):
            raise InvalidArgument(f"{name} is {even.t[-1]:.3g} s long, too short, expected 20 s and more")
        assert even.q is not None
        q, good, noise = without_outliers(even.q, even.seen, even.dt, _FINEST)
        rates, rates_noise = even.wheel_rates, None
        if rates is not None and model.wheels:
            if rates.shape[1] != len(model.A):
                raise InvalidArgument(
                    f"{name} has wheel_rates of {rates.shape[1]} wheels, expected {len(model.A)}: "
                    f"{', '.join(model.wheels)}"
                )
            rates, usual, rates_noise = without_outliers(rates, even.seen, even.dt, _FINEST_RATE)
            good = good & usual
        lost = int((even.seen & ~good).sum())
        rates = rates if model.wheels else None
        return cls(even.dt, q, good, even.u, rates, noise, rates_noise, lost, load)

    @cached_property
    def twist(self) -> Array:
        """Body twist of the filtered pose, shape (N, 3): forward, left, yaw rate."""
        return twist_of(self.q, self.dt)

    def free_velocities(self, model: Any) -> Array:
        """Return eta at all samples, shape (N, k): of the encoders where there are any."""
        if self.rates is not None:
            return np.asarray(_filtered(self.rates, self.dt) @ np.linalg.pinv(model.A).T)
        return np.asarray(self.twist @ np.linalg.pinv(model.S).T)

    def shaken(self, generator: np.random.Generator, level: float) -> PreprocessedLog:
        """Return it with more noise, of a variance that is a multiple of what its sensors have."""
        size = np.sqrt(level)
        q, rates = self.q + size * self.noise * generator.standard_normal(self.q.shape), self.rates
        if rates is not None and self.rates_noise is not None:
            rates = rates + size * self.rates_noise * generator.standard_normal(rates.shape)
        return replace(self, q=q, rates=rates)

    def rates_of(self, model: Any) -> Array:
        """Return the rates along which there is friction at all samples, shape (N, a)."""
        return self.twist if model.B is None else np.asarray(self.free_velocities(model) @ model.A.T)

    def segments(self, model: Any, delay: float, seconds: float, rates: bool) -> Segments:
        """Return the segments of a log whose poses come late by so many samples.

        Parameters
        ----------
        model, delay : PlanarModel, float
            The robot, and by which poses come late, in samples.
        seconds : float
            Length of a segment [s].
        rates : bool
            Whether rates of wheels are measured, of this log or another one.
        """
        lag, N, noise, y = int(np.floor(delay)), len(self.q), self.noise, self.q
        if rates:
            wheels, own = len(model.A), (self.rates, self.rates_noise)
            more, of_it = own if self.rates is not None else (np.zeros((N, wheels)), np.full(wheels, np.inf))
            y, noise = np.concatenate([y, more], axis=1), np.append(noise, of_it)  # type: ignore[arg-type]
        return Segments.cut(
            self.dt,
            y,
            self.good,
            np.concatenate([self.q, self.free_velocities(model)], axis=1),
            self.u,
            **{"length": max(8, round(seconds / self.dt)), "first": max(0, lag + 1), "stop": min(N, N + lag)},
            **{"lead": lag + LATER + 2, "more": LATER + 1 - lag, "noise": noise, "load": self.load},
            least=_HALF,
        )


def _filtered(columns: Array, dt: float) -> Array:
    """Return columns without what is faster than a cut-off, without a delay."""
    from scipy.signal import butter, sosfiltfilt  # here, because it takes long to load

    sos = butter(4, min(_CUTOFF, 0.2 / dt), fs=1 / dt, output="sos")
    return np.asarray(sosfiltfilt(sos, columns, axis=0))


def twist_of(q: Array, dt: float) -> Array:
    """Return the body twist of filtered poses, shape (N, 3): forward, left, yaw rate."""
    smooth = _filtered(q, dt)
    v, psi = np.gradient(smooth, dt, axis=0), smooth[:, 2]
    nu = np.exp(-1j * psi) * (v[:, 0] + 1j * v[:, 1])
    return np.column_stack([nu.real, nu.imag, v[:, 2]])


def mean_inputs(u: Array, edges: Array) -> Array:
    """Return the mean, between edges, of inputs that hold for a sample each and are zero beyond them."""
    return held_integrals(np.arange(len(u) + 0.0), u, np.clip(edges, 0, len(u)))


def without_outliers(
    columns: Array, seen: NDArray[np.bool_], dt: float, least: float
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return columns whose outliers are interpolated, which rows are none, and the noise of each column.

    What a local cubic leaves tells, beside what it would leave of noise there, which at the ends is less. One
    outlier is behind all that its neighbours leave, so only the worst of a window is one at a time. Unlike a
    running median, this does not take for outliers what moves fast.
    """
    from scipy.interpolate import CubicSpline  # here, because these take long to load
    from scipy.ndimage import maximum_filter1d
    from scipy.signal import savgol_coeffs, savgol_filter

    size = max(7, 2 * round(_WINDOW / dt / 2) + 1)
    follows = np.full(len(columns), savgol_coeffs(size, 3)[size // 2])  # how far the cubic goes with a sample
    follows[: size // 2] = [savgol_coeffs(size, 3, pos=k, use="dot")[k] for k in range(size // 2)]
    follows[-(size // 2) :] = follows[: size // 2][::-1]
    at, good, q = np.arange(len(columns)), seen.copy(), columns.copy()
    way = columns[size:] - columns[:-size]
    bent = _BENT * NORMAL * np.median(np.abs(way), axis=0)  # what a cubic may leave of a motion itself
    for _ in range(_PASSES):
        residual = columns - savgol_filter(q, size, 3, axis=0, mode="interp")
        residual /= np.sqrt(1 - follows)[:, None]
        deviation = NORMAL * np.median(np.abs(residual[good]), axis=0)
        deviation = np.maximum(deviation, least)
        often = np.quantile(np.abs(residual[good]), _OFTEN, axis=0)  # by which jumps of the acceleration bend
        bound = np.maximum.reduce([_OUTLIER * deviation, bent, _TIMES * often])
        size_of = (np.abs(residual) / bound).max(axis=1)
        worst = size_of >= maximum_filter1d(np.where(good, size_of, 0.0), 2 * size + 1)
        before, good = good, seen & ~((size_of > 1) & (worst | ~good))
        inside = np.clip(at[~good], at[good][0], at[good][-1])  # nothing is told beyond the last good one
        q = columns.copy()
        q[~good] = CubicSpline(at[good], columns[good])(inside)
        _bridge(q, good, size)
        if np.array_equal(before, good):
            break
    return q, good, deviation


def _bridge(q: Array, good: NDArray[np.bool_], size: int) -> None:
    """Fill long runs of lost samples by polynomials of degree 5 through so many samples on each side."""
    edges = np.flatnonzero(np.diff(good, prepend=True, append=True))
    for begin, end in edges.reshape(-1, 2):
        if end - begin > _LONG:
            k = np.arange(max(begin - size, 0), min(end + size, len(q)))
            V = np.polynomial.chebyshev.chebvander(np.linspace(-1, 1, len(k)), 5)
            near, lost = good[k], (k >= begin) & (k < end)
            q[k[lost]] = V[lost] @ np.linalg.lstsq(V[near], q[k[near]], rcond=None)[0]


_AVERAGED = 0.4  # [s] over which velocities are averaged, so that the noise of poses is 2 mm/s for each mm
_MEASURED = 0.9  # of a window
_HALF = 0.5  # of a segment's samples that count, without which its first state is not told
_CERTAIN = 5.0  # deviations of what noise alone would lead to
_TOLD, _MOST = 0.01, 0.1  # of the speed: what is told, and with what masses are of no use
_LIKE = 1.5  # ratio, or its inverse: no radius is stated as wrongly as that
_MOSTLY = 0.8  # of the mean square


class Slippage(NamedTuple):
    """How far the poses of a log are from rolling.

    Velocities of the body that poses tell, less those that encoders tell, or where there are none less the
    nearest at which wheels roll, averaged over windows of 0.4 s. Yaw rates count by the speed of the wheels'
    contacts.

    Attributes
    ----------
    speed, noise : float
        Root of the mean square of the difference, that of the noise taken off, and of the noise [m/s].
    share : float
        The first as a share of the speed of the motion.
    is_certain : bool
        Whether noise alone is no explanation.
    ratios : ndarray, shape (3,)
        Of the velocities that poses and encoders tell, forward, left and in yaw, that fit best; not numbers
        where there are no encoders, or wheels cannot move the body so.
    by_ratios : float
        Share of the mean square that these explain.
    """

    speed: float
    noise: float
    share: float
    is_certain: bool
    ratios: Array
    by_ratios: float

    @property
    def matters(self) -> bool:
        """Whether it is certain, and large enough to be told."""
        return self.is_certain and self.share > _TOLD

    def __str__(self) -> str:
        return f"poses {self._told}"

    @property
    def _told(self) -> str:
        known = np.isfinite(self.ratios)
        ratios = self.ratios[known]
        like = self.by_ratios > _MOSTLY and ((ratios < _LIKE) & (ratios > 1 / _LIKE)).all()
        axes = [name for name, is_so in zip(("forward", "left", "in yaw"), known, strict=True) if is_so]
        each = " and ".join(f"{ratio:.3g} {axis}" for ratio, axis in zip(ratios, axes, strict=True))
        why = (
            f"ratios of {each} explain it, as of wheels of another radius or place than is stated"
            if like
            else "they slip, or poses are of another point or time, or encoders of another sign or order"
        )
        return (
            f"move otherwise than wheels roll, by {self.speed:.3g} m/s, {self.share:.1%} of the speed, "
            f"where noise explains {self.noise:.2g} m/s: {why}"
        )

    @classmethod
    def of(cls, run: PreprocessedLog, model: Any, name: str = "log") -> Self | None:
        """Return that of a log; None where it cannot be told, as of a body that is pushed.

        Raises
        ------
        InvalidArgument
            If masses could not be told with as much of it; the message has the name.
        """
        if not model.wheels or (run.rates is None and model.free == 3):
            return None
        size = 2 * round(_AVERAGED / run.dt / 2) + 1
        g = (1 - np.linspace(-1, 1, size + 2)[1:-1] ** 2) ** 3
        g /= g.sum()
        moved = run.twist
        rolled = run.free_velocities(model) @ model.S.T
        columns = np.concatenate([moved, rolled, run.good[:, None]], axis=1)
        means = np.lib.stride_tricks.sliding_window_view(columns, size, axis=0)[:: size // 4 + 1] @ g
        means = means[means[:, -1] > _MEASURED]
        if len(means) < 2:
            return None
        per_rate = model.A @ np.linalg.pinv(model.S)
        metric = np.array([1.0, 1.0, np.sqrt((per_rate[:, 2] ** 2).sum() / (per_rate[:, :2] ** 2).sum())])
        moved, rolled = means[:, :3] * metric, means[:, 3:6] * metric
        off = moved - rolled
        variance = (run.noise * metric) ** 2 * (np.diff(g, prepend=0.0, append=0.0) ** 2).sum() / run.dt**2
        told = 3
        if run.rates is None:  # velocities at which wheels roll are no difference
            free = np.eye(3) - model.S @ np.linalg.pinv(model.S)
            variance, told = (free**2) @ variance, 3 - model.free
        elif run.rates_noise is not None:
            gains = model.S @ np.linalg.pinv(model.A)
            variance = variance + metric**2 * (gains**2 @ run.rates_noise**2) * (g**2).sum()
        noise, motion = float(variance.sum()), float((moved**2).sum(axis=1).mean())
        excess = float((off**2).sum(axis=1).mean()) - noise
        alone = max(len(run.q) / size * told, 1.0)  # numbers that do not hang together
        certain = excess > _CERTAIN * noise * np.sqrt(2 / alone) and excess > 0
        ratios, left = np.full(3, np.nan), off
        if run.rates is not None:
            power = (rolled**2).sum(axis=0)
            with np.errstate(all="ignore"):
                ratios = np.where(power > 1e-6 * power.sum(), (moved * rolled).sum(axis=0) / power, np.nan)
            left = moved - np.nan_to_num(ratios) * rolled
        after = max(float((left**2).sum(axis=1).mean()) - noise, 0.0)
        found = cls(
            float(np.sqrt(max(excess, 0.0))),
            float(np.sqrt(noise)),
            float(np.sqrt(max(excess, 0.0) / max(motion, 1e-300))),
            bool(certain),
            ratios,
            1 - after / excess if excess > 0 else 0.0,
        )
        if found.matters and found.share > _MOST:
            raise InvalidArgument(f"{name} has poses that {found._told}; expected wheels that roll")
        return found
