"""`PreprocessedLog`: a log with equal time steps and without outliers; its segments and its slippage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.identification._filters import (
    FINEST,
    LEAST_ROWS,
    WINDOW,
    low_pass,
    odometry,
    quantisation,
    remove_outliers,
    twist_of,
)
from pinmobile.identification._log import Log, check_inputs
from pinmobile.identification._simulation import Segments, pieces

_HALF = 0.5  # smallest measured share of a segment with an identifiable initial state
DELAY_RANGE = 8  # largest change of the delay in the search [samples]
_COARSEST = 0.1  # [s], largest time step of filters and windows
_FINEST_RATE = 1e-2  # [rad/s], smallest noise of rates


@dataclass(frozen=True, eq=False)
class PreprocessedLog:
    """Log for the weak form and for output error.

    Attributes
    ----------
    dt : float
        Time step [s].
    q : ndarray, shape (N, 3)
        Poses [m, m, rad]; lost poses and outliers are interpolated.
    good : ndarray of bool, shape (N,)
        Mask of measured poses without outliers.
    u : ndarray, shape (N, nu)
        Inputs, constant between samples.
    rates : ndarray, shape (N, a), or None
        Rates of the driven wheels [rad/s].
    noise : ndarray, shape (3,)
        Standard deviation of the pose noise [m, m, rad]; infinite if only rates are measured.
    rates_noise : ndarray, shape (a,) or (0,)
        Standard deviation of the noise of the rates [rad/s].
    outliers : int
        Number of outliers.
    load : ndarray, shape (4,)
        Mass, first moments and inertia about the body origin of the known load.
    """

    dt: float
    q: Array
    good: NDArray[np.bool_]
    u: Array
    rates: Array | None
    noise: Array
    rates_noise: Array
    outliers: int
    load: Array

    @classmethod
    def of(
        cls, log: Log, model: Any, load: Array, name: str = "log", dt: float | None = None
    ) -> PreprocessedLog:
        """Return the preprocessed log for a model, with a time step [s].

        Raises
        ------
        InvalidArgument
            If the log has inputs or wheels of another robot.
        """
        words = (
            "3: (Fx, Fy, Mz) of a body driven by forces; for wheels give robot=..., for commands of speed "
            "and yaw rate use identify_velocity; joints of arms cannot be identified"
            if model.B is None
            else f"{model.nu}: one for each of {', '.join(model.wheels)}; is the log from another robot?"
        )
        check_inputs(log, name, model.inputs, words, "A" if model.has_scale and not model.motors else "")
        even = log.samples(*model.sensors, dt=dt)
        if even.dt > 1.001 * _COARSEST:
            raise InvalidArgument(
                f"{name} has samples every {even.dt:.3g} s, expected {_COARSEST:g} s or less"
            )
        if len(even.t) < max(LEAST_ROWS, 4 * WINDOW / even.dt):
            raise InvalidArgument(f"{name} is {even.t[-1]:.3g} s long, too short, expected 20 s or more")
        rates = even.wheel_rates if model.wheels else None
        good, rates_noise = even.is_valid, np.zeros(0)
        if rates is not None:
            shaped(f"{name} has wheel_rates, which", rates, (len(rates), len(model.A)))
            grain = quantisation(rates[even.is_valid])
            rates, good, rates_noise = remove_outliers(rates, even.is_valid, even.dt, _FINEST_RATE, grain)
        if even.q is not None:
            grain = quantisation(even.q[even.is_valid])
            q, usual, noise = remove_outliers(even.q, even.is_valid, even.dt, FINEST, grain)
            good = good & usual
        else:  # the start of the odometry, and its drift, are arbitrary
            q, noise = odometry(rates @ np.linalg.pinv(model.A).T @ model.S.T, even.dt), np.full(3, np.inf)
        outliers = int((even.is_valid & ~good).sum())
        return cls(even.dt, q, good, even.u, rates, noise, rates_noise, outliers, load)

    @property
    def reported_noise(self) -> Array:
        """Noise of the poses, or of the rates if only these are measured."""
        return self.noise if np.isfinite(self.noise).all() else self.rates_noise

    @property
    def few(self) -> list[PreprocessedLog]:
        """Pieces of a long log at equal distances with samples enough for first estimates."""
        cuts = pieces(0, len(self.q), len(self.q))
        columns = [(n, getattr(self, n)) for n in ("q", "good", "u", "rates") if getattr(self, n) is not None]
        return [replace(self, **{n: x[cut] for n, x in columns}) for cut in cuts]

    @cached_property
    def twist(self) -> Array:
        """Body twist of the filtered pose, shape (N, 3): forward, left, yaw rate."""
        return twist_of(self.q, self.dt)

    def free_velocities(self, model: Any) -> Array:
        """Return the independent velocities at all samples, shape (N, k), from encoders if there are any."""
        if self.rates is not None:
            return np.asarray(low_pass(self.rates, self.dt) @ np.linalg.pinv(model.A).T)
        return np.asarray(self.twist @ np.linalg.pinv(model.S).T)

    def add_noise(self, generator: np.random.Generator, level: float) -> PreprocessedLog:
        """Return the log with additional noise; `level` is its variance per variance of the sensor noise."""
        size = np.sqrt(level)
        noise, rates = np.where(np.isfinite(self.noise), self.noise, 0.0), self.rates
        q = self.q + size * noise * generator.standard_normal(self.q.shape)
        if rates is not None:
            rates = rates + size * self.rates_noise * generator.standard_normal(rates.shape)
        return replace(self, q=q, rates=rates)

    def rates_of(self, model: Any) -> Array:
        """Return the rates with friction at all samples, shape (N, a)."""
        return self.twist if model.B is None else np.asarray(self.free_velocities(model) @ model.A.T)

    def segments(self, model: Any, delay: float, seconds: float, rates: bool) -> Segments:
        """Return the segments of a length [s] of a log with a delay of the poses [samples].

        With `rates`, the rates of wheels are measurements too; a log without them gets infinite noise.
        """
        lag, N, noise, y = int(np.floor(delay)), len(self.q), self.noise, self.q
        if rates:
            empty = np.zeros((N, len(model.A))), np.full(len(model.A), np.inf)
            wheel, sigma = empty if self.rates is None else (self.rates, self.rates_noise)
            y, noise = np.concatenate([y, wheel], axis=1), np.append(noise, sigma)
        states = np.concatenate([self.q, self.free_velocities(model)], axis=1)
        length = max(8, round(seconds / self.dt))
        span = max(0, lag + 1), min(N, N + lag), length, lag + DELAY_RANGE + 2, DELAY_RANGE + 1 - lag
        return Segments.cut(self.dt, (y, self.good, states, self.u, noise), span, load=self.load, least=_HALF)


_MEAN_TIME = 0.4  # [s], window of averaged velocities: pose noise of 1 mm gives 2 mm/s
_MEASURED = 0.9  # smallest measured share of a window
_CERTAIN = 5.0  # standard deviations of noise alone
_TOLD, _MOST = 0.01, 0.1  # smallest reported slip, and largest accepted slip, as shares of the speed


class Slippage(NamedTuple):
    """Deviation of the poses of a log from rolling.

    The deviation compares body velocities from poses with those from encoders, averaged over windows of
    0.4 s. Without encoders, it compares with the nearest velocities of rolling wheels. Yaw rates count by
    the speed of the contacts.

    Attributes
    ----------
    speed, noise : float
        Root mean square of the difference without noise, and of the noise [m/s].
    share : float
        Difference without noise as a share of the speed.
    is_certain : bool
        Whether noise alone does not explain it.
    ratios : ndarray, shape (3,)
        Ratios of velocities from poses and encoders, forward, left and in yaw; NaN without encoders, or if
        the wheels cannot move the body in this direction.
    """

    speed: float
    noise: float
    share: float
    is_certain: bool
    ratios: Array

    @property
    def matters(self) -> bool:
        """Whether the deviation is certain and large enough for a report."""
        return self.is_certain and self.share > _TOLD

    def __str__(self) -> str:
        axes = zip(self.ratios, ("forward", "left", "in yaw"), strict=True)
        each = " and ".join(f"{ratio:.3g} {axis}" for ratio, axis in axes if np.isfinite(ratio))
        suffix = f"; poses per encoders: {each}" * bool(each)
        return (
            f"poses deviate from rolling wheels by {self.speed:.3g} m/s, {self.share:.1%} of the speed, "
            f"while noise explains {self.noise:.2g} m/s{suffix}: wheels slip or have another radius or "
            "place, poses belong to another point or time, or encoders have another sign or order"
        )

    @classmethod
    def of(cls, run: PreprocessedLog, model: Any, name: str = "log") -> Self | None:
        """Return the slippage of a log; None if it is not identifiable, as for a body driven by forces.

        Raises
        ------
        InvalidArgument
            If the slippage is too large for estimates; the message has the name of the log.
        """
        if not model.wheels or np.isinf(run.noise).any() or (run.rates is None and model.free == 3):
            return None
        size = 2 * round(_MEAN_TIME / run.dt / 2) + 1
        g = (1 - np.linspace(-1, 1, size + 2)[1:-1] ** 2) ** 3
        g /= g.sum()
        columns = np.column_stack([run.twist, run.free_velocities(model) @ model.S.T, run.good])
        means = np.lib.stride_tricks.sliding_window_view(columns, size, axis=0)[:: size // 4 + 1] @ g
        means = means[means[:, -1] > _MEASURED]
        if len(means) < 2:
            return None
        per_rate = model.A @ np.linalg.pinv(model.S)
        metric = np.array([1.0, 1.0, np.sqrt((per_rate[:, 2] ** 2).sum() / (per_rate[:, :2] ** 2).sum())])
        by_pose, by_wheel = means[:, :3] * metric, means[:, 3:6] * metric
        variance = (run.noise * metric) ** 2 * (np.diff(g, prepend=0.0, append=0.0) ** 2).sum() / run.dt**2
        axes, ratios, power = 3, np.full(3, np.nan), (by_wheel**2).sum(axis=0)
        if run.rates is None:  # only velocities across the rolling directions count
            free = np.eye(3) - model.S @ np.linalg.pinv(model.S)
            variance, axes = (free**2) @ variance, 3 - model.free
        else:
            gains, moves = model.S @ np.linalg.pinv(model.A), power > 1e-6 * power.sum()
            variance = variance + metric**2 * (gains**2 @ run.rates_noise**2) * (g**2).sum()
            ratios[moves] = (by_pose * by_wheel).sum(axis=0)[moves] / power[moves]
        noise, motion = float(variance.sum()), float((by_pose**2).sum(axis=1).mean())
        excess = max(float(((by_pose - by_wheel) ** 2).sum(axis=1).mean()) - noise, 0.0)
        samples = max(len(run.q) / size * axes, 1.0)  # independent numbers
        speed, usual, share = np.sqrt([excess, noise, excess / max(motion, 1e-300)]).tolist()
        slippage = cls(speed, usual, share, excess > _CERTAIN * noise * np.sqrt(2 / samples), ratios)
        if slippage.matters and slippage.share > _MOST:
            text = str(slippage).replace("poses", "poses that", 1)
            raise InvalidArgument(f"{name} has {text}; expected wheels that roll")
        return slippage
