"""Two clocks: offset and rate of the clock of inputs, relative to the clock of measured motion."""

from __future__ import annotations

from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument

_SLOWEST, _FASTEST = 0.25, 4.0  # range of rates
_SAMPLES = 4096  # largest number of samples of a signal
_PARTS = 40.0  # of the span, in which the first search looks at the activity
_REFINEMENT = 4.0  # by which each search is finer than the one before
_INPUT_ADVANCE = 0.1  # [s], by which the inputs are taken earlier: their delay is estimated, and not negative
_CANDIDATES = 8  # candidates of a search that the next one refines
_UNIT_RATE_RATIO = 0.8  # unexplained share per that at the rate 1 above which the rate is 1
_SMALLEST_OFFSET = 0.15  # [s], smallest reported offset, and change of the offset along a log
_SMALL = 1e-3  # smallest singular value of the motion, as a share of the largest
_LEAST_R_SQUARED = 0.4  # smallest mean R^2 of inputs that move the robot


def clock_of(t_u: Array, u: Array, t: Array, x: Array, is_pose: bool) -> tuple[float, float]:
    """Return offset [s] and rate of the clock of inputs: time of the motion = offset + rate * t_u.

    The method searches the rate and the offset at which speeds and accelerations explain the inputs best:
    first their smoothed activity, then the signals themselves, finer and finer. Within some tenths of a
    second the offset cannot be distinguished from a delay, which `identify` estimates.

    Parameters
    ----------
    t_u, t : ndarray, shape (M,), (N,)
        Times of the inputs, and of the motion, each of its own clock [s].
    u : ndarray, shape (M, nu)
        Inputs.
    x : ndarray, shape (N, k)
        Poses (x, y, psi), or rates: body twists or wheel rates.
    is_pose : bool
        Whether the motion is given as poses.

    Raises
    ------
    InvalidArgument
        If the motion does not explain the inputs at any rate.
    """
    valid = ~np.isnan(u).any(axis=1)
    t_u, u, span = t_u[valid], u[valid], t[-1] - t[0]
    h = max(float(np.median(np.diff(t))), span / _SAMPLES)
    motion = _signals(t - t[0], x, np.arange(0.0, span, h), is_pose)
    stream = np.column_stack([t_u - t_u[0], u])
    first_rates = np.array([span / stream[-1, 0], 1.0])  # both logs begin and end together, or have one rate

    def best(rates: Array, width: float, smooth: float, finer: float = 1.0, envelope: bool = False) -> Any:
        spacing = 0.25 * smooth / finer / span
        log_steps = np.arange(-np.ceil(width / spacing), np.ceil(width / spacing) + 1) * spacing
        candidates = np.unique(np.append(np.outer(rates, np.exp(log_steps)), first_rates))
        candidates = candidates[(candidates >= _SLOWEST) & (candidates <= _FASTEST)]
        columns = _moving_average(_activity(motion) if envelope else motion, smooth / h)
        left, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        signals = np.ascontiguousarray(left[:, sizes > _SMALL * sizes[0]].T)
        spectra: dict[int, Array] = {}
        scores = [_match(signals, spectra, stream, rate, h, smooth, envelope) for rate in candidates]
        return np.array(sorted(scores, reverse=True)), 2 * spacing

    smooth, finer = span / _PARTS, 1.0
    matches, width = best(first_rates, np.log(_FASTEST), smooth, envelope=True)
    matches, width = best(matches[:_CANDIDATES, 1], width, smooth)
    while smooth / finer > h:
        if finer == 1.0 and smooth > 2 * _REFINEMENT * h:
            other, narrow = best(matches[:_CANDIDATES, 1], width, smooth / _REFINEMENT)
            if other[0, 0] > matches[0, 0]:  # coarser is better where accelerations are noisy
                matches, width, smooth = other, narrow, smooth / _REFINEMENT
                continue
        finer *= _REFINEMENT
        matches, width = best(matches[:_CANDIDATES, 1], width, smooth, finer)
    share, rate, offset = matches[0].tolist()
    unit_rate = matches[matches[:, 1] == 1.0][0].tolist()
    if 1 - share > _UNIT_RATE_RATIO * (1 - unit_rate[0]):
        share, rate, offset = unit_rate
    if share < _LEAST_R_SQUARED:
        raise InvalidArgument(
            f"t_u belongs to inputs of which the motion explains {max(share, 0.0):.0%} at most, at any "
            "rate and offset of their clock, expected inputs that move the robot"
        )
    return float(t[0] + offset - _INPUT_ADVANCE - rate * t_u[0]), float(rate)


def clock_hint(t: Array, u: Array, x: Array, is_pose: bool) -> str:
    """Return the correction of the clock of a log's inputs as text; "" if there is none."""
    try:
        offset, rate = clock_of(t, u, t, x, is_pose)
    except InvalidArgument:
        return ""
    shift = offset + _INPUT_ADVANCE + (rate - 1) * t[0]
    if abs(shift) < _SMALLEST_OFFSET and abs(rate - 1) * (t[-1] - t[0]) < _SMALLEST_OFFSET:
        return ""
    return (
        f"The motion explains the inputs best if their times are multiplied by {rate:.6g} and moved by "
        f"{shift:.3g} s, as of another clock: Log.from_streams(..., one_clock=False) corrects this"
    )


def _match(
    motion: Array,
    spectra: dict[int, Array],
    timed_inputs: Array,
    rate: float,
    h: float,
    smooth: float,
    envelope: bool,
) -> tuple[float, float, float]:
    """Return the largest mean R^2 of inputs for the orthonormal signals of a motion, rate, and offset [s].

    `motion` has shape (k, N). `spectra` has its Fourier transforms by their length.
    """
    from scipy.fft import irfft, next_fast_len, rfft  # slow to load

    t, u = rate * timed_inputs[:, 0], timed_inputs[:, 1:]
    inputs = u[np.searchsorted(t, np.arange(0.0, t[-1], h), side="right") - 1]
    inputs = _moving_average(_activity(inputs) if envelope else inputs, smooth / h)
    count, size = motion.shape[1], next_fast_len(motion.shape[1] + len(inputs), real=True)
    if size not in spectra:
        spectra[size] = rfft(motion, size)
    each = irfft(spectra[size][:, None] * np.conj(rfft(inputs.T, size)), size)
    total = np.einsum("kmn,kmn->n", each, each) / inputs.shape[1]
    lag = int(total.argmax())
    return float(total[lag]), rate, h * (lag if lag < count else lag - size)


def _signals(t: Array, x: Array, grid: Array, is_pose: bool) -> Array:
    """Return speeds, of poses both in the body and in the inertial frame, and accelerations on a grid."""
    rows = ~np.isnan(x).any(axis=1)
    speeds = np.column_stack([np.interp(grid, t[rows], column) for column in x[rows].T])
    if is_pose:
        v = np.gradient(speeds, grid[1], axis=0)
        body_velocity = np.exp(-1j * speeds[:, 2]) * (v[:, 0] + 1j * v[:, 1])
        speeds = np.column_stack([body_velocity.real, body_velocity.imag, v])
    return np.column_stack([speeds, np.gradient(speeds, grid[1], axis=0)])


def _activity(x: Array) -> Array:
    return np.asarray(np.linalg.norm(x / (x.std(axis=0) + 1e-300), axis=1, keepdims=True))


def _moving_average(x: Array, samples: float) -> Array:
    """Return columns after a moving average, without their means, of length 1."""
    from scipy.ndimage import uniform_filter1d  # slow to load

    y = uniform_filter1d(x, max(1, round(samples)), axis=0)
    y = y - y.mean(axis=0)
    return np.asarray(y / (np.linalg.norm(y, axis=0) + 1e-300))
