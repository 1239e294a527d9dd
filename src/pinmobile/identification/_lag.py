"""A first-order lag from commands to motion: first estimates, limits, sections under other control."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.compiled import Recurrence

_STILL = 1e-9  # [m/s, rad/s]: commands that change less count as constant
_SLOWEST = 10.0  # [s], largest time constant
_TAUS, _REFINED = 14, 7  # numbers of time constants in the first search and in its refinements
_ROWS = 2000  # largest number of rows that the search compares
_LIMITED = 0.03  # smallest share of the residual that a limit of commands removes
LARGEST = 0.95  # largest limit of commands per largest command
_STEEP = 0.1  # smallest share of the residual that a limit of acceleration removes
_RAMPS = np.geomspace(0.03, 0.9, 12)  # tried accelerations, as shares of the largest without a limit
_RAMPED = np.array([0.1, 0.3, 1.0])  # tried time constants, as shares of that without a limit
_DELAYS = 4  # tried delays
_LONGEST = 20_000  # rows of the search for a limit of acceleration
_SECTION = 3.0  # [s], shortest section under other control
_UNEXPLAINED = 0.7  # square of the residual per square of motion or command in such a section
_EDGE, _WIDE = 1.0, 4.0  # window [s], and residual per usual one, in which such a section goes on
_OFFSETS = 2  # rounds that estimate an offset
_MOVES = 0.2  # smallest residual in such a section, as a share of the usual motion


class Lag(NamedTuple):
    """Lag of one channel: y' = (gain * clip(u, +-limit) + offset - y) / tau, with u `late` samples late.

    `steepest` limits the absolute value of y'. `cost` is the mean absolute residual.
    """

    gain: float
    tau: float
    late: int
    limit: float
    steepest: float = np.inf
    cost: float = 0.0
    offset: float = 0.0

    def given(self, u: Array) -> Array:
        """Return the motion that commands u, shape (N,), would have without the lag."""
        late = np.concatenate([np.full(self.late, u[0]), u])[: len(u)]
        return np.asarray(self.gain * np.clip(late, -self.limit, self.limit) + self.offset)

    def response(self, u: Array, dt: float) -> Array:
        """Return the motion for commands u, shape (N,), from the steady motion of the first."""
        from scipy.signal import lfilter  # slow to load

        given, fades = self.given(u), np.exp(-dt / self.tau)
        if np.isfinite(self.steepest):
            return _ramped(given, dt, np.array([self.tau]), np.array([self.steepest]))[:, 0]
        return np.asarray(lfilter([0.0, 1 - fades], [1.0, -fades], given, zi=given[:1])[0])

    def top(self, commands: Sequence[Array]) -> float:
        """Return the largest rate of the motion without a limit."""
        return max(float(np.abs(np.diff(self.given(u))).max(initial=0.0)) for u in commands) / self.tau


@cache
def _ramp() -> Recurrence:
    """Return the recurrence of a lag with a limit of acceleration; its numbers are share and limit."""
    return Recurrence(lambda y, u, x: y + np.minimum(np.maximum(x[:1] * (u - y), -x[1:]), x[1:]), (1, 1, 2))


def _ramped(given: Array, dt: float, tau: Array, steepest: Array) -> Array:
    """Return the motions, shape (N, C), of C lags with limits of acceleration, for motions without lags."""
    u, numbers = given.reshape(len(given), -1, 1), np.stack([1 - np.exp(-dt / tau), steepest * dt], axis=-1)
    return _ramp()(u[0], u[:-1], numbers)[..., 0].T


class Channel(NamedTuple):
    """Commands and motion of one channel, of several logs with one time step; NaN where not measured.

    `name` is that of the motion. If `shifts`, the motion may have an offset.
    """

    name: str
    u: Sequence[Array]
    y: Sequence[Array]
    dt: float
    shifts: bool = False

    def lag(self, lead: int, late: int | None = None) -> Lag:
        """Return the lag with the least absolute residuals; default: of all delays below `lead` samples."""
        delays = range(lead) if late is None else [late]
        if not self.moves:
            return Lag(0.0, _SLOWEST, 0, np.inf)
        found, offset = self._lag(delays), 0.0
        for _ in range(_OFFSETS * self.shifts):
            left = [y - found.response(u, self.dt) for u, y in zip(self.u, self.y, strict=True)]
            offset += float(np.nanmedian(np.concatenate(left)))
            found = self._replace(y=[y - offset for y in self.y])._lag(delays)
        return found._replace(offset=offset)

    def _lag(self, delays: Sequence[int]) -> Lag:
        most = max(float(np.abs(u).max()) for u in self.u)
        taus = np.geomspace(0.3 * self.dt, max(_SLOWEST, self.dt), _TAUS)
        best = self._best([(tau, late, np.inf) for tau in taus for late in delays])
        shares = np.linspace(0.15, 0.95, 17)
        limited = self._best([(best.tau, best.late, share * most) for share in shares])
        if limited.cost < (1 - _LIMITED) * best.cost:
            near = np.linspace(-0.05, 0.05, 9) * most
            best = self._best([(tau, late, limited.limit) for tau in taus for late in delays])
            best = self._best([(best.tau, best.late, best.limit + more) for more in near])
            best = best if best.limit < LARGEST * most else best._replace(limit=np.inf)
        for width in (1.6, 1.15):
            around = best.tau * np.geomspace(1 / width, width, _REFINED)
            best = self._best([(tau, best.late, best.limit) for tau in around])
        return self._steepest(best, delays)

    def _steepest(self, lag: Lag, delays: Sequence[int]) -> Lag:
        """Return a lag with a limit of acceleration, where the motion shows one.

        Without the limit, a longer delay imitates it.
        """
        u, y = np.concatenate(self.u)[:_LONGEST], np.concatenate(self.y)[:_LONGEST]
        given, seen = lag.given(u), ~np.isnan(y)
        top = lag.top([u])
        tried = [late for late in delays if late <= lag.late]
        tried = sorted({tried[round(k)] for k in np.linspace(0, len(tried) - 1, _DELAYS)})
        late, tau, most = (x.ravel() for x in np.meshgrid(tried, lag.tau * _RAMPED, top * _RAMPS))
        given = np.stack([lag._replace(late=k).given(u) for k in tried], axis=-1)[
            :, np.searchsorted(tried, late)
        ]
        costs = np.abs(_ramped(given, self.dt, tau, most) - y[:, None])[seen].mean(axis=0)
        k = int(costs.argmin())
        before = np.abs(lag.response(u, self.dt) - y)[seen].mean()
        if costs[k] >= (1 - _STEEP) * before:
            return lag
        found = lag._replace(tau=float(tau[k]), steepest=float(most[k]), late=int(late[k]))
        free = found._replace(limit=np.inf)
        same = np.abs(free.response(u, self.dt) - y)[seen].mean() < costs[k] / (1 - _LIMITED)
        return free if same else found

    def _best(self, tried: Sequence[tuple[float, int, float]]) -> Lag:
        seen = [np.flatnonzero(~np.isnan(y)) for y in self.y]
        seen = [rows[:: max(1, sum(map(len, seen)) // _ROWS)] for rows in seen]
        y, found = np.concatenate([y[rows] for y, rows in zip(self.y, seen, strict=True)]), []
        for tau, late, limit in tried:
            lag = Lag(1.0, float(tau), late, float(limit))
            parts = zip(self.u, seen, strict=True)
            x = np.concatenate([lag.response(u, self.dt)[rows] for u, rows in parts])
            gain = _gain(x, y)
            found.append(lag._replace(gain=gain, cost=float(np.abs(y - gain * x).mean())))
        return min(found, key=lambda lag: lag.cost)

    @property
    def moves(self) -> bool:
        """Whether the commands change."""
        return bool(np.ptp(np.concatenate(self.u)) > _STILL)

    def share(self, lag: Lag) -> float | None:
        """Return R^2 of a lag; None for constant commands."""
        y, x = np.concatenate(self.y), np.concatenate([lag.response(u, self.dt) for u in self.u])
        seen = ~np.isnan(y)
        spent = float(((y[seen] - y[seen].mean()) ** 2).sum()) if seen.any() else 0.0
        return 1 - float(((y - x)[seen] ** 2).sum()) / spent if self.moves and spent else None

    def unexplained(self, lag: Lag) -> list[NDArray[np.bool_]]:
        """Return the rows in sections whose motion the commands do not explain, as masks."""
        motion, size, found = np.concatenate(self.y), max(3, round(_SECTION / self.dt)), []
        usual = np.quantile(np.abs(motion[~np.isnan(motion)]), 0.9)
        if not self.moves:
            return [np.zeros(len(u), bool) for u in self.u]
        for u, y in zip(self.u, self.y, strict=True):
            x = lag.response(u, self.dt)
            seen = ~np.isnan(y)
            left, moved, given = (np.where(seen, each**2, 0.0) for each in (y - x, y, x))
            count = _summed(seen.astype(float), size)
            spent, motion, command = (_summed(each, size) for each in (left, moved, given))
            wrong = (spent > _UNEXPLAINED * np.maximum(motion, command)) & (
                spent > count * (_MOVES * usual) ** 2
            )
            mask = _summed((wrong & (count > 0)).astype(float), size) > 0.5 * size
            for a, b in np.flatnonzero(np.diff(mask, prepend=False, append=False)).reshape(-1, 2):
                mask[a:b] = b - a > size // 2
            near = max(3, round(_EDGE / self.dt))  # other drivers begin and end slowly
            each = _summed(np.sqrt(left), near) / np.maximum(_summed(seen.astype(float), near), 1.0)
            wide = mask | (each > _WIDE * np.median(each))
            for a, b in np.flatnonzero(np.diff(wide, prepend=False, append=False)).reshape(-1, 2):
                wide[a:b] = mask[a:b].any()
            found.append(wide)
        return found


def _gain(x: Array, y: Array) -> float:
    """Return the factor of x with the least absolute deviation from y: a weighted median of the ratios."""
    weight = np.abs(x)
    there = weight > 1e-9 * (weight.max() + 1e-300)
    if not there.any():
        return 0.0
    ratio = y[there] / x[there]
    order = ratio.argsort()
    total = weight[there][order].cumsum()
    return float(ratio[order][np.searchsorted(total, 0.5 * total[-1])])


def _summed(x: Array, size: int) -> Array:
    """Return the sums over windows about each row."""
    from scipy.ndimage import uniform_filter1d  # slow to load

    return np.asarray(size * uniform_filter1d(x, size, mode="nearest"))
