"""Filters of measured motion: outliers, rounding and speeds; and a log replayed by a simulated robot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, bounded, scalar
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.identification._estimator import NORMAL
from pinmobile.integrators import rk4
from pinmobile.loop import Rollout
from pinmobile.plant import coordinates_of, inputs_of
from pinmobile.trajectories import Reference

LEAST_ROWS = 16  # smallest number of samples of filters and windows
FINEST = 1e-4  # [m, rad]: smallest noise of poses
WINDOW = 0.15  # [s], window of the local cubic whose residual shows outliers and noise
_OUTLIER = 6.0  # standard deviations
_LEAST_OUTLIER = 3e-3  # smallest outlier, as a share of the motion in a window
_OFTEN, _TIMES = 0.8, 4.0  # quantile of the residuals of the cubic; multiple of it that an outlier exceeds
_LEAST_ISOLATION = 3.3  # error of an outlier relative to its neighbours; 2.5 at a step of the acceleration
_SAME_ROWS = 0.9  # least share of the measurements in each n-th row of a sensor that is slower than the rows
_PASSES = 40  # largest number of passes
_PADDING = 15  # samples that a filter mirrors at the ends
_CUTOFF = 8.0  # [Hz], cutoff frequency of velocities
_COARSE = 0.1  # largest share of different values of a quantised sensor
_SPLINE_SAMPLES = 30  # samples on each side of a gap that shape its spline; those beyond matter by 1e-17
_LONG = 3  # longest gap that a spline fills [samples]; a longer gap would amplify noise


def low_pass(columns: Array, dt: float) -> Array:
    """Return columns after a low-pass filter without delay."""
    from scipy.signal import butter, sosfiltfilt  # slow to load

    sos = butter(4, min(_CUTOFF, 0.2 / dt), fs=1 / dt, output="sos")
    return np.asarray(sosfiltfilt(sos, columns, axis=0, padlen=min(_PADDING, len(columns) - 1)))


def twist_of(q: Array, dt: float) -> Array:
    """Return the body twist of filtered poses, shape (N, 3): forward, left, yaw rate."""
    smooth = low_pass(q, dt)
    v, psi = np.gradient(smooth, dt, axis=0), smooth[:, 2]
    nu = np.exp(-1j * psi) * (v[:, 0] + 1j * v[:, 1])
    return np.column_stack([nu.real, nu.imag, v[:, 2]])


def quantisation(columns: Array) -> Array:
    """Return the standard deviation of the rounding of each column, shape (k,); 0 if values do not repeat."""
    deviations = []
    for column in columns.T:
        size = float(np.abs(column).max(initial=0.0)) or 1.0
        values = size * np.unique(np.round(column / size, 9))
        steps = np.diff(values)
        is_coarse = 1 < len(values) < _COARSE * len(column)
        deviations.append(float(np.median(steps)) / np.sqrt(12) if is_coarse else 0.0)
    return np.array(deviations)


def remove_outliers(
    columns: Array, measured: NDArray[np.bool_], dt: float, finest: Any, grain: Any = 0.0
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return columns with interpolated outliers, a mask of good rows, and the noise of each column.

    Outliers have large residuals of a local cubic, relative to the residual of noise at this position in the
    window. An outlier also increases the residuals of its neighbours, so each pass removes only the worst
    sample of a window. Unlike a running median, this method accepts fast motions. Steps of the acceleration,
    such as after a step of a command, also have large residuals. An outlier is isolated. If only each n-th
    row is measured, as by a sensor slower than the inputs, outliers are sought in these rows.

    Parameters
    ----------
    columns : ndarray, shape (N, m)
        Measurements.
    measured : ndarray of bool, shape (N,)
        Mask of measured rows.
    dt : float
        Time step [s].
    finest, grain : array_like, shape () or (m,)
        Smallest noise of a column, and that of its quantisation.
    """
    from scipy.interpolate import CubicSpline  # slow to load
    from scipy.ndimage import maximum_filter1d
    from scipy.signal import savgol_coeffs, savgol_filter

    count = max(int(measured.sum()), 1)
    every = round(len(measured) / count) if count >= LEAST_ROWS else 1
    if every > 1 and measured[::every].sum() > _SAME_ROWS * count:  # inputs are faster
        q, usual, noise = remove_outliers(columns[::every], measured[::every], every * dt, finest, grain)
        good, rows = np.zeros(len(columns), bool), np.arange(len(columns))
        good[::every] = usual
        return CubicSpline(rows[::every], q)(rows), good, noise
    size = max(7, 2 * round(WINDOW / dt / 2) + 1)
    follows = np.full(len(columns), savgol_coeffs(size, 3)[size // 2])  # weight of a sample in its own fit
    follows[: size // 2] = [savgol_coeffs(size, 3, pos=k, use="dot")[k] for k in range(size // 2)]
    follows[-(size // 2) :] = follows[: size // 2][::-1]
    rows, good, q = np.arange(len(columns)), measured.copy(), columns.copy()
    way = columns[size:] - columns[:-size]
    floor = _LEAST_OUTLIER * NORMAL * np.median(np.abs(way), axis=0)  # residual of a cubic for the motion
    for _ in range(_PASSES):
        residual = columns - savgol_filter(q, size, 3, axis=0, mode="interp")
        residual /= np.sqrt(1 - follows)[:, None]
        deviation = NORMAL * np.median(np.abs(residual[good]), axis=0)
        deviation = np.maximum(deviation, np.maximum(finest, grain))
        often = np.quantile(np.abs(residual[good]), _OFTEN, axis=0)  # by which jumps of the acceleration bend
        bound = np.maximum.reduce([_OUTLIER * deviation, floor, _TIMES * often])
        sizes = np.abs(residual) / bound
        size_of = sizes.max(axis=1)
        worst = size_of >= maximum_filter1d(np.where(good, size_of, 0.0), 2 * size + 1)
        found = np.flatnonzero((size_of > 1) & worst & good)
        inner = found[(found >= size) & (found < len(q) - size)]
        worst[inner] &= _are_isolated(q, inner, sizes[inner].argmax(axis=1), size)
        usual = ~((size_of > 1) & (worst | ~good))
        for side in (usual[: size // 2], usual[::-1][: size // 2]):  # an outlier hides those behind it
            side &= np.logical_and.accumulate(side[::-1])[::-1]
        previous, good = good, measured & usual
        support = good & (maximum_filter1d((~good).view(np.int8), 2 * _SPLINE_SAMPLES + 1) > 0)
        q = columns.copy()
        if support.any():
            q[~good] = CubicSpline(rows[support], columns[support])(rows[~good])
        _bridge(q, good, size)
        if np.array_equal(previous, good):
            break
    # Errors of quantisation are not normal: their median absolute value overestimates them by up to 28 %.
    rms = np.maximum(np.sqrt((residual[good] ** 2).mean(axis=0)), grain)
    return q, good, np.where(np.asarray(grain) > finest, np.minimum(deviation, rms), deviation)


def _are_isolated(
    q: Array, rows: NDArray[np.intp], columns: NDArray[np.intp], size: int
) -> NDArray[np.bool_]:
    """Return whether rows are far from a cubic through their neighbours, compared with these, in a column.

    Another outlier among the neighbours, or one on each side, does not count.
    """
    windows = q[rows[:, None] + np.arange(-size, size + 1), columns[:, None]]
    V = np.polynomial.chebyshev.chebvander(np.linspace(-1, 1, 2 * size + 1), 3)
    isolated = np.zeros(len(rows), bool)
    for group in (*((0, k) for k in range(-size, size + 1)), (-1, 0, 1), (-2, -1, 0), (0, 1, 2)):
        keep = np.ones(2 * size + 1, bool)
        keep[[size + k for k in group]] = False
        errors = np.abs(windows - windows[:, keep] @ (V @ np.linalg.pinv(V[keep])).T)
        isolated |= errors[:, size] > _LEAST_ISOLATION * np.partition(errors[:, keep], -2)[:, -2]
    return isolated


def _bridge(q: Array, good: NDArray[np.bool_], size: int) -> None:
    """Fill long gaps by polynomials of degree 5, ends by cubics, fitted to `size` samples on each side."""
    edges = np.flatnonzero(np.diff(good, prepend=True, append=True))
    for begin, end in edges.reshape(-1, 2):
        is_outer = begin == 0 or end == len(q)
        if is_outer or end - begin > _LONG:
            k = np.arange(max(begin - size, 0), min(end + size, len(q)))
            V = np.polynomial.chebyshev.chebvander(np.linspace(-1, 1, len(k)), 3 if is_outer else 5)
            support, gap = good[k], (k >= begin) & (k < end)
            q[k[gap]] = V[gap] @ np.linalg.lstsq(V[support], q[k[support]], rcond=None)[0]


_LATEST = 10.0  # [s], largest delay


class MeasuredMotion:
    """Trajectory through the measured poses of a log.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times from 0 [s].
    q : ndarray, shape (N, 3)
        Poses.
    is_noisy : bool
        Whether velocities need a filter.
    """

    def __init__(self, t: Array, q: Array, is_noisy: bool) -> None:
        from scipy.interpolate import CubicSpline  # slow to load

        smooth = low_pass(q, float(t[1] - t[0])) if is_noisy else q
        self.duration, self._q, self._smooth = float(t[-1]), CubicSpline(t, q), CubicSpline(t, smooth)

    def __call__(self, t: Any) -> Reference:
        """Return the poses at times t, and their velocities and accelerations, filtered if noisy."""
        return Reference(self._q(t), self._smooth(t, 1), self._smooth(t, 2))


def rollout_of(log: Any, robot: Any, delay: float = 0.0, **options: Any) -> Rollout:
    """Return the log as a rollout, whose reference is the replay; see `Log.rollout`."""
    from pinmobile.controllers import law  # which imports this package
    from pinmobile.loop import simulate

    inputs, names = inputs_of(robot), [item.name for item in coordinates_of(robot)[:3]]
    if log.u.shape[1] != len(inputs) or names != ["x", "y", "psi"]:
        raise InvalidArgument(
            f"robot is {format_value(robot)}, with {len(inputs)} inputs, expected a robot in the plane with "
            f"{log.u.shape[1]}, as the log has"
        )
    for unit, item in zip(log.units, inputs, strict=False):
        if unit not in ("", item.unit):
            raise InvalidArgument(
                f"log has inputs in {', '.join(log.units)}, expected {', '.join(x.unit for x in inputs)}: "
                "the robot takes other inputs, such as a torque in place of a steering angle"
            )
    if log.q is None and log.twist is None:
        raise InvalidArgument("log has no poses and no twist, expected one of them: nothing else is drawn")
    if len(log.split()) > 1 or len(log) < LEAST_ROWS:
        raise InvalidArgument(f"log has gaps, or fewer than {LEAST_ROWS} rows, expected a part of split()")
    run = log.samples("q" if log.q is not None else "twist")
    lag = bounded("delay", scalar("delay", delay), least=0, most=_LATEST, unit="s")
    if run.q is None:
        measured, noise = odometry(np.asarray(run.twist), run.dt), np.zeros(3)
    else:
        measured, _, noise = remove_outliers(run.q, run.is_valid, run.dt, FINEST)
    u = run.u[np.clip(np.arange(len(run.t)) - round(lag / run.dt), 0, None)]
    motion = MeasuredMotion(run.t, measured, bool((noise > 2 * FINEST).any()))
    command = law(lambda t, q, v, reference: u[min(round(t / run.dt), len(u) - 1)])
    rollout = simulate(robot, command, motion, **{"dt": run.dt, "integrator": rk4, **options})
    q, v, a = (np.array(each) for each in (rollout.q, rollout.v, rollout.a))
    replay_x, n = rollout.reference, 3
    q[:, :n], v[:, :n], a[:, :n] = replay_x
    replay = Reference(rollout.q[:, :n], rollout.v[:, :n], rollout.a[:, :n])
    return replace(rollout, q=q, v=v, a=a, error=-rollout.error, reference=replay, signals={})


def odometry(twist: Array, dt: float) -> Array:
    """Return the poses from body twists, shape (N, 3), beginning at zero."""
    forward, left, turn = twist.T
    psi = np.append(0.0, np.cumsum(turn[:-1]) * dt)
    way = np.exp(1j * (psi + 0.5 * dt * turn)) * (forward + 1j * left)
    position = np.append(0.0, np.cumsum(way[:-1]) * dt)
    return np.column_stack([position.real, position.imag, psi])
