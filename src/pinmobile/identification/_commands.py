"""Commands and motion: runs at equal time steps, lags between both, explained parts, and segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.compiled import Recurrence
from pinmobile.errors import InvalidArgument
from pinmobile.identification._filters import FINEST, remove_outliers, twist_of
from pinmobile.identification._log import Log, check_inputs, continuous
from pinmobile.identification._simulation import Segments

CHANNELS = {"speed": "m/s", "yaw rate": "rad/s"}  # names and units
CAR_COMMANDS = {"speed": "m/s", "steering angle": "rad"}
LEAST_BLOCKS = 20  # smallest number of blocks of the jackknife
BLOCK, _LONG_BLOCK = 2.0, 5.0  # [s], their length: the longest that a log allows
_LATEST, _MOST_LATE = 0.6, 60  # largest delay [s] and [samples]
MIN_SHARE = 0.3  # smallest explained share of the motion
_MOST_UNEXPLAINED = 0.5  # largest share of a log under other control
_USUAL, _SLOW = 0.9, 0.3  # quantile of the usual speed, and the share of it from which curvatures are known
_STEEPEST = 1.3  # [rad], steering commands beyond it have no curvature
_COMMAND_TOLERANCE = 1e-9  # [m/s, rad/s]: commands that change less count as constant
_SLOWEST = 10.0  # [s], largest time constant
_TAUS, _REFINED = 14, 7  # numbers of time constants in the first search and in its refinements
_ROWS = 2000  # largest number of rows that the search compares
_LIMIT_GAIN = 0.03  # smallest share of the residual that a limit of commands removes
LARGEST = 0.95  # largest limit of commands per largest command
_STEEP = 0.1  # smallest share of the residual that a limit of acceleration removes
_RAMPS = np.geomspace(0.03, 0.9, 12)  # tried accelerations, as shares of the largest without a limit
_TAU_SHARES = np.array([0.1, 0.3, 1.0])  # tried time constants, as shares of that without a limit
_DELAYS = 4  # tried delays
_LONGEST = 20_000  # rows of the search for a limit of acceleration
_SECTION = 3.0  # [s], shortest section under other control
_RESIDUAL_RATIO = 0.7  # square of the residual per square of motion or command in such a section
_EDGE, _WIDE = 1.0, 4.0  # window [s], and residual per usual one, in which such a section goes on
_OFFSETS = 2  # rounds that estimate an offset
_MOVES = 0.2  # smallest residual in such a section, as a share of the usual motion


class Lag(NamedTuple):
    """Lag of one channel: y' = (gain * clip(u, +-limit) + offset - y) / tau, with `delay` samples later.

    `rate_limit` limits the absolute value of y'. `cost` is the mean absolute residual.
    """

    gain: float
    tau: float
    delay: int
    limit: float
    rate_limit: float = np.inf
    cost: float = 0.0
    offset: float = 0.0

    def gain_map(self, u: Array) -> Array:
        """Return the motion that commands u, shape (N,), would have without the lag."""
        commands = np.concatenate([np.full(self.delay, u[0]), u])[: len(u)]
        return np.asarray(self.gain * np.clip(commands, -self.limit, self.limit) + self.offset)

    def response(self, u: Array, dt: float) -> Array:
        """Return the motion for commands u, shape (N,), from the steady motion of the first."""
        from scipy.signal import lfilter  # slow to load

        given, fades = self.gain_map(u), np.exp(-dt / self.tau)
        if np.isfinite(self.rate_limit):
            return _ramp_responses(given, dt, np.array([self.tau]), np.array([self.rate_limit]))[:, 0]
        return np.asarray(lfilter([0.0, 1 - fades], [1.0, -fades], given, zi=given[:1])[0])

    def top(self, commands: Sequence[Array]) -> float:
        """Return the largest rate of the motion without a limit."""
        return max(float(np.abs(np.diff(self.gain_map(u))).max(initial=0.0)) for u in commands) / self.tau


@cache
def _ramp() -> Recurrence:
    """Return the recurrence of a lag with a limit of acceleration; its numbers are share and limit."""
    return Recurrence(lambda y, u, x: y + np.minimum(np.maximum(x[:1] * (u - y), -x[1:]), x[1:]), (1, 1, 2))


def _ramp_responses(given: Array, dt: float, tau: Array, rate_limit: Array) -> Array:
    """Return the motions, shape (N, C), of C lags with limits of acceleration, for motions without lags."""
    u, numbers = given.reshape(len(given), -1, 1), np.stack([1 - np.exp(-dt / tau), rate_limit * dt], axis=-1)
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

    def lag(self, lead: int, delay: int | None = None) -> Lag:
        """Return the lag with the least absolute residuals; default: of all delays below `lead` samples."""
        delays = range(lead) if delay is None else [delay]
        if not self.moves:
            return Lag(0.0, _SLOWEST, 0, np.inf)
        fit, offset = self._lag(delays), 0.0
        for _ in range(_OFFSETS * self.shifts):
            left = [y - fit.response(u, self.dt) for u, y in zip(self.u, self.y, strict=True)]
            offset += float(np.nanmedian(np.concatenate(left)))
            fit = self._replace(y=[y - offset for y in self.y])._lag(delays)
        return fit._replace(offset=offset)

    def _lag(self, delays: Sequence[int]) -> Lag:
        largest = max(float(np.abs(u).max()) for u in self.u)
        taus = np.geomspace(0.3 * self.dt, max(_SLOWEST, self.dt), _TAUS)
        best = self._best_lag([(tau, delay, np.inf) for tau in taus for delay in delays])
        shares = np.linspace(0.15, 0.95, 17)
        with_limit = self._best_lag([(best.tau, best.delay, share * largest) for share in shares])
        if with_limit.cost < (1 - _LIMIT_GAIN) * best.cost:
            changes = np.linspace(-0.05, 0.05, 9) * largest
            best = self._best_lag([(tau, delay, with_limit.limit) for tau in taus for delay in delays])
            best = self._best_lag([(best.tau, best.delay, best.limit + change) for change in changes])
            best = best if best.limit < LARGEST * largest else best._replace(limit=np.inf)
        for width in (1.6, 1.15):
            tau_grid = best.tau * np.geomspace(1 / width, width, _REFINED)
            best = self._best_lag([(tau, best.delay, best.limit) for tau in tau_grid])
        return self._add_rate_limit(best, delays)

    def _add_rate_limit(self, lag: Lag, delays: Sequence[int]) -> Lag:
        """Return a lag with a limit of acceleration, where the motion shows one.

        Without the limit, a longer delay imitates it.
        """
        u, y = np.concatenate(self.u)[:_LONGEST], np.concatenate(self.y)[:_LONGEST]
        top, measured = lag.top([u]), ~np.isnan(y)
        choices = [delay for delay in delays if delay <= lag.delay]
        choices = sorted({choices[round(k)] for k in np.linspace(0, len(choices) - 1, _DELAYS)})
        delay, tau, limits = (x.ravel() for x in np.meshgrid(choices, lag.tau * _TAU_SHARES, top * _RAMPS))
        each = np.stack([lag._replace(delay=k).gain_map(u) for k in choices], axis=-1)
        given = each[:, np.searchsorted(choices, delay)]
        costs = np.abs(_ramp_responses(given, self.dt, tau, limits) - y[:, None])[measured].mean(axis=0)
        k = int(costs.argmin())
        old_cost = np.abs(lag.response(u, self.dt) - y)[measured].mean()
        if costs[k] >= (1 - _STEEP) * old_cost:
            return lag
        fit = lag._replace(tau=float(tau[k]), rate_limit=float(limits[k]), delay=int(delay[k]))
        free = fit._replace(limit=np.inf)
        same = np.abs(free.response(u, self.dt) - y)[measured].mean() < costs[k] / (1 - _LIMIT_GAIN)
        return free if same else fit

    def _best_lag(self, candidates: Sequence[tuple[float, int, float]]) -> Lag:
        indices = [np.flatnonzero(~np.isnan(y)) for y in self.y]
        indices = [rows[:: max(1, sum(map(len, indices)) // _ROWS)] for rows in indices]
        y, lags = np.concatenate([y[rows] for y, rows in zip(self.y, indices, strict=True)]), []
        for tau, delay, limit in candidates:
            lag = Lag(1.0, float(tau), delay, float(limit))
            parts = zip(self.u, indices, strict=True)
            x = np.concatenate([lag.response(u, self.dt)[rows] for u, rows in parts])
            gain = _gain(x, y)
            lags.append(lag._replace(gain=gain, cost=float(np.abs(y - gain * x).mean())))
        return min(lags, key=lambda lag: lag.cost)

    @property
    def moves(self) -> bool:
        """Whether the commands change."""
        return bool(np.ptp(np.concatenate(self.u)) > _COMMAND_TOLERANCE)

    def share(self, lag: Lag) -> float | None:
        """Return R^2 of a lag; None for constant commands."""
        y, x = np.concatenate(self.y), np.concatenate([lag.response(u, self.dt) for u in self.u])
        measured = ~np.isnan(y)
        power = float(((y[measured] - y[measured].mean()) ** 2).sum()) if measured.any() else 0.0
        return 1 - float(((y - x)[measured] ** 2).sum()) / power if self.moves and power else None

    def unexplained_rows(self, lag: Lag) -> list[NDArray[np.bool_]]:
        """Return the rows in sections that the commands do not explain, as masks."""
        motion, size, masks = np.concatenate(self.y), max(3, round(_SECTION / self.dt)), []
        usual = np.quantile(np.abs(motion[~np.isnan(motion)]), 0.9)
        if not self.moves:
            return [np.zeros(len(u), bool) for u in self.u]
        for u, y in zip(self.u, self.y, strict=True):
            x = lag.response(u, self.dt)
            measured = ~np.isnan(y)
            errors, motions, outputs = (np.where(measured, each**2, 0.0) for each in (y - x, y, x))
            count = _sums(measured.astype(float), size)
            error, motion, command = (_sums(each, size) for each in (errors, motions, outputs))
            level = np.maximum(_RESIDUAL_RATIO * np.maximum(motion, command), count * (_MOVES * usual) ** 2)
            mask = _sums(((error > level) & (count > 0)).astype(float), size) > 0.5 * size
            for a, b in np.flatnonzero(np.diff(mask, prepend=False, append=False)).reshape(-1, 2):
                mask[a:b] = b - a > size // 2
            width = max(3, round(_EDGE / self.dt))  # other drivers begin and end slowly
            each = _sums(np.sqrt(errors), width) / np.maximum(_sums(measured.astype(float), width), 1.0)
            wide = mask | (each > _WIDE * np.median(each))
            for a, b in np.flatnonzero(np.diff(wide, prepend=False, append=False)).reshape(-1, 2):
                wide[a:b] = mask[a:b].any()
            masks.append(wide)
        return masks


def _gain(x: Array, y: Array) -> float:
    """Return the factor of x with the least absolute deviation from y: a weighted median of the ratios."""
    weight = np.abs(x)
    nonzero = weight > 1e-9 * (weight.max() + 1e-300)
    if not nonzero.any():
        return 0.0
    ratio = y[nonzero] / x[nonzero]
    order = ratio.argsort()
    total = weight[nonzero][order].cumsum()
    return float(ratio[order][np.searchsorted(total, 0.5 * total[-1])])


def _sums(x: Array, size: int) -> Array:
    """Return the sums over windows about each row."""
    from scipy.ndimage import uniform_filter1d  # slow to load

    return np.asarray(size * uniform_filter1d(x, size, mode="nearest"))


class Run(NamedTuple):
    """A log with equal time steps.

    Attributes
    ----------
    log : int
        Index of the log.
    start : float
        Time of the first row since the start of the log [s].
    dt : float
        Time step [s].
    u : ndarray, shape (N, 2)
        Commands.
    y, calm : ndarray, shape (N, k)
        Measurements, and the same without gross outliers.
    is_valid : ndarray of bool, shape (N,)
        Rows with a measurement.
    nu : ndarray, shape (N, 2)
        Speed and yaw rate, filtered if poses are measured.
    state : ndarray, shape (N, n)
        First estimates of the states of the model, without a pose: `nu`, or for a car its speed, steering
        angle and steering rate.
    is_car : bool
        Whether the second command is a steering angle.
    phase : float
        Time after that of a row at which its commands begin [time steps]: near that of other runs.
    """

    log: int
    start: float
    dt: float
    u: Array
    y: Array
    calm: Array
    is_valid: NDArray[np.bool_]
    nu: Array
    state: Array
    is_car: bool
    phase: float = 0.0


class Part(NamedTuple):
    """Samples `start` to before `stop` of a run."""

    run: Run
    start: int
    stop: int


def runs_of(logs: list[Log], is_pose: bool, inputs: Mapping[str, str]) -> list[Run]:
    """Return the checked logs, with the units of their inputs by name, at equal time steps."""
    is_car = inputs is CAR_COMMANDS
    words = "two, commands of speed and yaw rate: for forces, torques or voltages use identify"
    if not (is_car or inputs is CHANNELS):
        words = f"{', '.join(inputs)}: of a car, give the steering angle [rad] in place of its torque"
    for log in logs:
        check_inputs(log, "log", inputs, words)
    name, runs = "q" if is_pose else "twist", list[Run]()
    pairs = [(k, part) for k, log in enumerate(logs) for part in continuous(log, "log", name)]
    dt, is_velocity = max(part.dt for _, part in pairs), inputs is CHANNELS or inputs is CAR_COMMANDS
    for k, part in pairs:
        near = runs[0].phase if runs else 0.5  # phases from 0 to 1, and those of other runs near the first
        run = part.samples(name, dt=dt, near=near if is_velocity else None)
        if run.twist is not None:
            y = calm = nu = run.twist[:, [0, 2]]
        else:
            y = np.asarray(run.q)
            calm, _, _ = remove_outliers(y, run.is_valid, run.dt, FINEST)
            nu = twist_of(calm, run.dt)
            _check_heading(nu)
            nu = nu[:, [0, 2]]
        state = np.column_stack([nu[:, 0], run.u[:, 1], 0 * nu[:, 0]]) if is_car else nu
        start = float(part.t[0] - logs[k].t[0])
        runs.append(Run(k, start, run.dt, run.u, y, calm, run.is_valid, nu, state, is_car, run.phase))
    return runs


def _check_heading(twist: Array) -> None:
    """Reject poses that move sideways more than forward, even for a point ahead of the axle."""
    forward, left, turn = twist.T
    lateral = left - (left @ turn) / max(float(turn @ turn), 1e-300) * turn
    speeds = [float(np.sqrt(np.mean(x**2))) for x in (forward, lateral)]
    if speeds[1] > speeds[0]:
        raise InvalidArgument(
            f"log has poses that move sideways at {speeds[1]:.3g} m/s and forward at {speeds[0]:.3g} m/s, "
            "expected psi in the direction of travel: is it in degrees, of a compass, or of another clock?"
        )


def lead_of(runs: Sequence[Run]) -> int:
    """Return the largest delay of a command [samples]."""
    longest = max(len(run.u) for run in runs)
    return max(3, min(_MOST_LATE, round(_LATEST / runs[0].dt), longest // 10))


def block_of(parts: Sequence[Part]) -> int:
    """Return the length of a block of the jackknife [samples]."""
    dt = parts[0].run.dt
    span = dt * _samples(parts) / (LEAST_BLOCKS + 1)
    return max(3, round(min(max(span, BLOCK), _LONG_BLOCK) / dt))


def parts_of(runs: Sequence[Run]) -> list[Part]:
    """Return each run as one part."""
    return [Part(run, 0, len(run.u)) for run in runs]


def speeds_of(parts: Sequence[Part]) -> list[Part]:
    """Return parts with speed and yaw rate as measurements."""
    return [part._replace(run=part.run._replace(y=part.run.nu, calm=part.run.nu)) for part in parts]


def channels_of(parts: Sequence[Part]) -> list[Channel]:
    """Return commands and motion of speed and yaw rate, or for a car of speed and curvature."""
    dt, names = parts[0].run.dt, [*CHANNELS]
    commands = [run.u[a:b] for run, a, b in parts]
    motions = [np.where(run.is_valid[:, None], run.nu, np.nan)[a:b] for run, a, b in parts]
    is_car = parts[0].run.is_car
    if is_car:
        names[1] = "curvature"
        slow = _SLOW * np.nanquantile(np.abs(np.concatenate(motions)[:, 0]), _USUAL)
        wheels = [np.tan(np.clip(u[:, 1], -_STEEPEST, _STEEPEST)) for u in commands]
        commands = [np.column_stack([u[:, 0], wheel]) for u, wheel in zip(commands, wheels, strict=True)]
        fast = [np.where(np.abs(nu[:, 0]) > slow, nu[:, 0], np.nan) for nu in motions]
        motions = [np.column_stack([nu[:, 0], nu[:, 1] / v]) for nu, v in zip(motions, fast, strict=True)]
    columns = (([u[:, k] for u in commands], [y[:, k] for y in motions]) for k in (0, 1))
    return [Channel(n, *each, dt, is_car and n != "speed") for n, each in zip(names, columns, strict=True)]


def explained_parts(runs: Sequence[Run], lags: Sequence[Lag], minimum: float = MIN_SHARE) -> list[Part]:
    """Return the parts of runs whose motion the commands explain, by at least a share of each channel.

    Raises
    ------
    InvalidArgument
        If the commands explain too little of the motion.
    """
    channels, parts = channels_of(parts_of(runs)), []
    masks = [channel.unexplained_rows(lag) for channel, lag in zip(channels, lags, strict=True)]
    for run, speed_mask, yaw_mask in zip(runs, *masks, strict=True):
        edges = np.flatnonzero(np.diff(~(speed_mask | yaw_mask), prepend=False, append=False)).reshape(-1, 2)
        parts += [Part(run, a, b) for a, b in edges.tolist() if (b - a) * run.dt > BLOCK]
    left_out = 1 - _samples(parts) / _samples(parts_of(runs))
    pairs = zip(channels_of(parts) if parts else channels, lags, strict=True)
    shares = {channel.name: channel.share(lag) for channel, lag in pairs}
    check_explained(shares, lags, runs[0].dt, left_out, minimum)
    return parts


def check_explained(
    shares: Mapping[str, float | None],
    lags: Sequence[Lag],
    dt: float,
    left_out: float = 0.0,
    minimum: float = MIN_SHARE,
) -> None:
    """Reject commands that explain too small shares of the motion by channel, or nothing in most of the log.

    The share of a channel with constant commands is None.
    """
    if left_out <= _MOST_UNEXPLAINED and all(share is None or share >= minimum for share in shares.values()):
        return
    channels = " and ".join(
        f"nothing of the {name}, whose command is constant"
        if share is None
        else f"{max(share, 0.0):.0%} of the {name} (delay {1e3 * lag.delay * dt:.3g} ms, gain "
        f"{lag.gain:.3g}, time constant {lag.tau:.2g} s)"
        for (name, share), lag in zip(shares.items(), lags, strict=True)
    )
    gaps = f" nothing in {left_out:.0%} of the log, and in the rest" * (left_out > _MOST_UNEXPLAINED)
    raise InvalidArgument(
        f"log has commands that explain{gaps} {channels}, expected most of it: are the commands from another "
        "robot or another driver, with another sign, or with times of another clock?"
        + " Steering angles of a car need their unit, rad, or wheelbase."
        * ("curvature" not in shares)
    )


def format_left_out(runs: Sequence[Run], parts: Sequence[Part]) -> str:
    """Return the sections of runs outside the parts as text; "" if there are none."""
    gaps, several = list[tuple[float, str]](), len({run.log for run in runs}) > 1
    for run in runs:
        edges = [0, *(edge for part in parts if part.run is run for edge in part[1:]), len(run.u)]
        prefix = f"log[{run.log}] " * several
        for a, b in np.reshape(edges, (-1, 2)).tolist():
            times = f"{prefix}{run.start + a * run.dt:.4g} to {run.start + b * run.dt:.4g} s"
            gaps += [((b - a) * run.dt, times)] * (b > a)
    if not gaps:
        return ""
    total = sum(seconds for seconds, _ in gaps)
    return (
        f"{total:.3g} s of the log are left out: there the commands do not explain the motion, as if "
        f"another driver had taken over: {', '.join(text for _, text in gaps)}"
    )


def segments_of(
    parts: Sequence[Part], lead: int, seconds: float, fill: bool = True
) -> tuple[Segments, NDArray[np.bool_]]:
    """Return segments of a length [s], and a mask of samples without gross outliers.

    If `fill`, long segments are whole blocks, and the last one of a part is filled up; otherwise it is left
    out.
    """
    dt, block = parts[0].run.dt, block_of(parts)
    length = max(3, round(seconds / dt))
    length, segments, calms = block * round(length / block) if fill and length > block else length, [], []
    for run, a, b in parts:
        N, is_pose = len(run.u), run.y.shape[1] > len(CHANNELS)
        first = max(a, lead if a == 0 else 0)
        k = first + np.arange(max(0, -(-(b - first) // length)) * length).reshape(-1, length)
        valid = (k < b) & run.is_valid[np.minimum(k, N - 1)]
        least_count = max(3.0, 0.5 * min(length, block) * run.is_valid.mean())
        dense = (valid.sum(axis=1) >= least_count) & (fill | (k[:, -1] < b))
        k, valid = np.minimum(k[dense], N - 1), valid[dense]
        states = np.concatenate([run.state, run.calm] if is_pose else [run.state], axis=-1)
        window = np.clip(k[:, :1] - lead - 2 + np.arange(lead + 2 + length + 1), 0, N - 1)
        noise, load = np.ones((len(k), run.y.shape[1])), np.zeros((len(k), 4))
        rows = np.full(len(k), dt), k * dt, run.y[k], valid, noise, states[k[:, 0]], run.u, window
        segments.append(Segments(*rows, lead + 2, load, np.full(len(k), run.phase)))
        calms.append((run.calm == run.y).all(axis=-1)[k])
    if not any(len(each.y) for each in segments):
        raise InvalidArgument(
            f"log has no part of {length * dt:.3g} s with measurements, expected a longer one"
        )
    return Segments.join(segments), np.concatenate(calms)


def _samples(parts: Sequence[Part]) -> int:
    return sum(part.stop - part.start for part in parts)
