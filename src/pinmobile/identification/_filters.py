"""Filters of measured motion: outliers, rounding and speeds of poses."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.identification._estimator import NORMAL

LEAST_ROWS = 16  # smallest number of samples of filters and windows
FINEST = 1e-4  # [m, rad]: smallest noise of poses
WINDOW = 0.15  # [s], window of the local cubic whose residual shows outliers and noise
_OUTLIER = 6.0  # standard deviations
_LEAST_OUTLIER = 3e-3  # smallest outlier, as a share of the motion in a window
_OFTEN, _TIMES = 0.8, 4.0  # quantile of the residuals of the cubic; multiple of it that an outlier exceeds
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
    sample of a window. Unlike a running median, this method accepts fast motions.

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
        size_of = (np.abs(residual) / bound).max(axis=1)
        worst = size_of >= maximum_filter1d(np.where(good, size_of, 0.0), 2 * size + 1)
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
