"""The closed loop of many robots, compiled: blocks of robots side by side, the time loop inside.

A block is 64 robots, one per lane. All that is known of them stands in one array of rows of 64 numbers, which
stays in the first-level cache for the whole run; every loop over the lanes is free of branches, so that the
compiler makes vector instructions of it. Blocks are always full (the last one is filled up with copies), so
that the numbers of a robot do not depend on which others are computed with it.

All in one file: the compiled code is kept beside it until this file changes.
"""

import math
from math import floor, sqrt
from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from pinmobile.arrays import HALF_TURN
from pinmobile.ensembles.histogram import BINS, FIRST, SHIFT

__all__ = [
    "BODY",
    "GAINS",
    "INPUTS",
    "LANES",
    "LIMIT",
    "MODEL",
    "RESULTS",
    "STAGES",
    "general",
    "lean",
]

LANES = 64

# Rows of a block.
_X, _Y, _PSI, _U, _V, _R = range(6)
BODY = 6  # mass, yaw inertia, centre of mass; once loaded, the first two are reciprocals
_MASS, _INERTIA, _CX, _CY = range(BODY, BODY + 4)
GAINS = 10  # kp of x, y, psi, then kd
MODEL = 16  # mass, inertia, centre of mass that the controller believes in
LIMIT = 20
INPUTS = 23
_ALIVE, _LIVED, _E, _SQUARE, _FORCE = 23, 24, 25, 29, 32
_DISTANCE, _HEADING = 35, 36
_MEASURED, _TAU, _OUTSIDE, _MATRICES, _STAGE = 37, 43, 46, 49, 67
_ACCELERATION = 73  # of up to 8 stages
_ROWS = 97
STAGES = 8
RESULTS = 12  # samples lived; largest |e| of x, y, psi, and squared distance; sums of e^2; largest |tau|

_TURN = 2 * math.pi
_PER_TURN = 1 / _TURN
_LEFT = HALF_TURN * _PER_TURN


def _in_parts(bits: int) -> tuple[float, float, float]:
    """Return pi as a sum of three floats, the first two so short that k times them is exact."""
    scale = 2.0**bits
    first = floor(math.pi * scale) / scale
    # pi = math.pi + 1.2246467991473532e-16, the sine of math.pi.
    rest = math.pi - first
    second = floor(rest * scale * scale) / scale / scale
    return first, second, (rest - second) + math.sin(math.pi)


_PI1, _PI2, _PI3 = _in_parts(26)
_ROUNDER = 1.5 * 2.0**52
_PER_PI = 1 / math.pi
_S = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(11))
_C = tuple((-1) ** k / math.factorial(2 * k) for k in range(11))
_S1, _S2, _S3, _S4, _S5, _S6, _S7, _S8, _S9, _S10 = _S[1:]
_C1, _C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10 = _C[1:]

_options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}, "cache": True}
_inline = numba.njit(inline="always", **_options)


@intrinsic
def _chosen(context: Any, condition: Any, yes: Any, no: Any) -> Any:
    """Return `yes` or `no`, both of which have been computed: an instruction where ``if`` is a branch."""

    def select(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.select(*arguments)

    return types.float64(types.boolean, types.float64, types.float64), select


@_inline
def _larger(a: float, b: float) -> float:
    return _chosen(a > b, a, b)


@_inline
def _rounded(x: float) -> float:
    """Return the nearest whole number, for |x| < 2^51: what is added leaves no room for a fraction."""
    return (x + _ROUNDER) - _ROUNDER


@_inline
def _sincos(x: float) -> tuple[float, float]:
    """Return sine and cosine: reduced to |r| <= pi/2, then Taylor's series to less than 2e-17."""
    k = _rounded(x * _PER_PI)
    r = ((x - k * _PI1) - k * _PI2) - k * _PI3
    odd = k - 2.0 * _rounded(0.5 * k)
    sign = 1.0 - 2.0 * odd * odd
    z = r * r
    z2 = z * z
    z4 = z2 * z2
    # In pairs, so that the processor computes several at a time.
    s = ((_S5 + z * _S6) + z2 * (_S7 + z * _S8)) + z4 * (_S9 + z * _S10)
    c = ((_C5 + z * _C6) + z2 * (_C7 + z * _C8)) + z4 * (_C9 + z * _C10)
    s = ((_S1 + z * _S2) + z2 * (_S3 + z * _S4)) + z4 * s
    c = ((_C1 + z * _C2) + z2 * (_C3 + z * _C4)) + z4 * c
    return sign * (r + r * z * s), sign * (1.0 + z * c)


@_inline
def _on_circle(angle: float) -> float:
    wrapped = angle - _TURN * _rounded(angle * _PER_TURN - _LEFT)
    return _chosen(wrapped > math.pi, math.pi, wrapped)


@_inline
def _model_force(w: Any, i: int, s: float, c: float, r: float, ax: float, ay: float, spin: float) -> Any:
    """Return M(q) a + n(q, v) of the controller's model, as `closed_form.inverse_dynamics`."""
    m, inertia = w[MODEL * LANES + i], w[(MODEL + 1) * LANES + i]
    x, y = w[(MODEL + 2) * LANES + i], w[(MODEL + 3) * LANES + i]
    dx, dy = x * c - y * s, x * s + y * c
    gx, gy = ax - dy * spin, ay + dx * spin
    moment = inertia * spin + m * (dx * gy - dy * gx)
    return m * (gx - dx * r * r), m * (gy - dy * r * r), moment


@_inline
def _acceleration(w: Any, i: int, s: float, c: float, r: float, fx: float, fy: float, mz: float) -> Any:
    """Return M(q)^-1 (tau - n(q, v)), as `closed_form.forward_dynamics`."""
    per_mass, x, y = w[_MASS * LANES + i], w[_CX * LANES + i], w[_CY * LANES + i]
    dx, dy = x * c - y * s, x * s + y * c
    spin = (mz - (dx * fy - dy * fx)) * w[_INERTIA * LANES + i]
    rate = r * r
    return fx * per_mass + dy * spin + dx * rate, fy * per_mass - dx * spin + dy * rate, spin


@_inline
def _clipped(w: Any, i: int, fx: float, fy: float, mz: float) -> Any:
    lx, ly, lz = w[LIMIT * LANES + i], w[(LIMIT + 1) * LANES + i], w[(LIMIT + 2) * LANES + i]
    return _between(fx, lx), _between(fy, ly), _between(mz, lz)


@_inline
def _between(value: float, limit: float) -> float:
    value = _chosen(value > limit, limit, value)
    return _chosen(value < -limit, -limit, value)


@_inline
def _judge(
    w: Any,
    i: int,
    limit: float,
    errors: tuple[float, float, float, float, float, float],
    force: tuple[float, float, float],
    acceleration: tuple[float, float, float],
) -> None:
    """Take one sample of one lane into its records, unless the robot has diverged."""
    ex, ey, ep, eu, ev, er = errors
    fx, fy, mz = force
    ax, ay, spin = acceleration
    worst = _larger(_larger(_larger(abs(ex), abs(ey)), abs(ep)), _larger(_larger(abs(eu), abs(ev)), abs(er)))
    total = (fx + fy + mz) + (ax + ay + spin)
    alive = (w[_ALIVE * LANES + i] > 0.0) & (worst <= limit) & (total - total == 0.0)
    w[_ALIVE * LANES + i] = _chosen(alive, 1.0, 0.0)
    w[_LIVED * LANES + i] += _chosen(alive, 1.0, 0.0)
    ex, ey, ep = _chosen(alive, ex, 0.0), _chosen(alive, ey, 0.0), _chosen(alive, ep, 0.0)
    fx, fy, mz = _chosen(alive, fx, 0.0), _chosen(alive, fy, 0.0), _chosen(alive, mz, 0.0)
    square = ex * ex + ey * ey
    w[_E * LANES + i] = _larger(w[_E * LANES + i], abs(ex))
    w[(_E + 1) * LANES + i] = _larger(w[(_E + 1) * LANES + i], abs(ey))
    w[(_E + 2) * LANES + i] = _larger(w[(_E + 2) * LANES + i], abs(ep))
    w[(_E + 3) * LANES + i] = _larger(w[(_E + 3) * LANES + i], square)
    w[_SQUARE * LANES + i] += ex * ex
    w[(_SQUARE + 1) * LANES + i] += ey * ey
    w[(_SQUARE + 2) * LANES + i] += ep * ep
    w[_FORCE * LANES + i] = _larger(w[_FORCE * LANES + i], abs(fx))
    w[(_FORCE + 1) * LANES + i] = _larger(w[(_FORCE + 1) * LANES + i], abs(fy))
    w[(_FORCE + 2) * LANES + i] = _larger(w[(_FORCE + 2) * LANES + i], abs(mz))
    w[_DISTANCE * LANES + i] = _chosen(alive, square, math.inf)
    w[_HEADING * LANES + i] = _chosen(alive, abs(ep), math.inf)


@_inline
def _forget(w: Any) -> None:
    """Forget all errors so far, but not how long the robots have lived, nor their forces."""
    for i in range(_E * LANES, _FORCE * LANES):
        w[i] = 0.0


@_inline
def _count(w: Any, lanes: int, counts: Any) -> None:
    """Count the errors of the first `lanes` lanes in the bins of one time, shape (2, BINS)."""
    for i in range(LANES):
        w[_DISTANCE * LANES + i] = sqrt(w[_DISTANCE * LANES + i])
    bits = w.view(np.int64)
    for row in range(2):
        for i in range(lanes):
            place = (bits[(_DISTANCE + row) * LANES + i] >> SHIFT) - FIRST + 1
            counts[row, min(max(place, 0), BINS - 1)] += 1


@_inline
def _load(w: Any, inputs: Any, first: int, lanes: int) -> None:
    for row in range(INPUTS):
        for i in range(LANES):
            w[row * LANES + i] = inputs[row, first + min(i, lanes - 1)]
    for i in range(LANES):
        w[_MASS * LANES + i], w[_INERTIA * LANES + i] = 1 / w[_MASS * LANES + i], 1 / w[_INERTIA * LANES + i]
        w[_ALIVE * LANES + i] = 1.0
    for i in range(_LIVED * LANES, _MEASURED * LANES):
        w[i] = 0.0


@_inline
def _store(w: Any, results: Any, first: int, lanes: int) -> None:
    for row in range(RESULTS):
        for i in range(lanes):
            results[row, first + i] = w[(_LIVED + row) * LANES + i]


@numba.njit(**_options)
def lean(
    inputs: Any,
    results: Any,
    reference: Any,
    dt: float,
    by_q: float,
    wrap: bool,
    limit: float,
    begin: int,
    every: int,
    counts: Any,
    model: Any,
    clip: Any,
) -> None:
    """Run robots whose step has one stage, with no force but the controller's and gains without coupling.

    Parameters
    ----------
    inputs : ndarray, shape (INPUTS, n)
        What is known of each robot, in the order of the rows above.
    results : ndarray, shape (RESULTS, n)
        Written to.
    reference : ndarray, shape (N + 1, 9)
        Desired q, v and a.
    dt, by_q : float
        Length of a step [s]; weight of the acceleration for the configuration [s^2].
    wrap : bool
        Whether the controller takes the error of psi on the circle.
    limit : float
        An error beyond it is a divergence.
    begin : int
        First sample whose error is kept in the results.
    every : int
        Samples between two counts.
    counts : ndarray of int, shape (times, 2, BINS)
        Added to: errors of position and heading.
    model, clip : float or None
        Not None: the control is computed torque; forces are limited. Each has code of its own.
    """
    last = reference.shape[0] - 1
    w = np.empty(_ROWS * LANES)
    for first in range(0, inputs.shape[1], LANES):
        lanes = min(LANES, inputs.shape[1] - first)
        _load(w, inputs, first, lanes)
        for k in range(last + 1):
            at = reference[k]
            qx, qy, qp, vx, vy, vp, ax, ay, ap = at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7], at[8]
            if k == begin:
                _forget(w)
            for i in range(LANES):
                x, y, p = w[_X * LANES + i], w[_Y * LANES + i], w[_PSI * LANES + i]
                u, v, r = w[_U * LANES + i], w[_V * LANES + i], w[_R * LANES + i]
                s, c = _sincos(p)
                raw = qp - p
                ex, ey, ep = qx - x, qy - y, _on_circle(raw)
                eu, ev, er = vx - u, vy - v, vp - r
                turn = _chosen(wrap, ep, raw)
                fx = w[GAINS * LANES + i] * ex + w[(GAINS + 3) * LANES + i] * eu
                fy = w[(GAINS + 1) * LANES + i] * ey + w[(GAINS + 4) * LANES + i] * ev
                mz = w[(GAINS + 2) * LANES + i] * turn + w[(GAINS + 5) * LANES + i] * er
                if model is not None:
                    fx, fy, mz = _model_force(w, i, s, c, r, fx + ax, fy + ay, mz + ap)
                if clip is not None:
                    fx, fy, mz = _clipped(w, i, fx, fy, mz)
                bx, by, spin = _acceleration(w, i, s, c, r, fx, fy, mz)
                _judge(w, i, limit, (ex, ey, ep, eu, ev, er), (fx, fy, mz), (bx, by, spin))
                w[_X * LANES + i] = x + dt * u + by_q * bx
                w[_Y * LANES + i] = y + dt * v + by_q * by
                w[_PSI * LANES + i] = p + dt * r + by_q * spin
                w[_U * LANES + i], w[_V * LANES + i] = u + dt * bx, v + dt * by
                w[_R * LANES + i] = r + dt * spin
            if k % every == 0:
                _count(w, lanes, counts[k // every])
        _store(w, results, first, lanes)


@_inline
def _outside(w: Any, s0: int, t: float, f: Any, waves: Any, rollings: int, sines: int) -> None:
    """Set the forces of the surroundings at the state in the rows from `s0`, see `disturbances`."""
    for i in range(LANES):
        s, c = _sincos(w[(s0 + 2) * LANES + i])
        u, v, r = w[(s0 + 3) * LANES + i], w[(s0 + 4) * LANES + i], w[(s0 + 5) * LANES + i]
        forward, left = u * c + v * s, v * c - u * s
        along, across = -f[3, i] * forward, -f[4, i] * left
        moment = -f[5, i] * r
        for k in range(rollings):
            j = 6 + 6 * k
            along -= f[j, i] * forward / sqrt(forward * forward + f[j + 3, i] * f[j + 3, i])
            across -= f[j + 1, i] * left / sqrt(left * left + f[j + 4, i] * f[j + 4, i])
            moment -= f[j + 2, i] * r / sqrt(r * r + f[j + 5, i] * f[j + 5, i])
        w[_OUTSIDE * LANES + i] = f[0, i] + (along * c - across * s)
        w[(_OUTSIDE + 1) * LANES + i] = f[1, i] + (along * s + across * c)
        w[(_OUTSIDE + 2) * LANES + i] = f[2, i] + moment
    first = 6 + 6 * rollings
    for j in range(first, first + 5 * sines, 5):
        for i in range(LANES):
            s, c = _sincos(_TURN * f[j + 3, i] * t + f[j + 4, i])
            for axis in range(3):
                w[(_OUTSIDE + axis) * LANES + i] += f[j + axis, i] * s
    first += 5 * sines
    for k in range(waves.shape[0]):
        for axis in range(3):
            j = first + 6 * k + axis
            for i in range(LANES):
                w[(_OUTSIDE + axis) * LANES + i] += (
                    waves[k, axis, 0] * f[j, i] - waves[k, axis, 1] * f[j + 3, i]
                )


@_inline
def _accelerate(w: Any, s0: int, a0: int) -> None:
    """Set the acceleration in the rows from `a0`, of the state in those from `s0`."""
    for i in range(LANES):
        s, c = _sincos(w[(s0 + 2) * LANES + i])
        fx = w[_TAU * LANES + i] + w[_OUTSIDE * LANES + i]
        fy = w[(_TAU + 1) * LANES + i] + w[(_OUTSIDE + 1) * LANES + i]
        mz = w[(_TAU + 2) * LANES + i] + w[(_OUTSIDE + 2) * LANES + i]
        ax, ay, spin = _acceleration(w, i, s, c, w[(s0 + 5) * LANES + i], fx, fy, mz)
        w[a0 * LANES + i], w[(a0 + 1) * LANES + i], w[(a0 + 2) * LANES + i] = ax, ay, spin


@_inline
def _move(w: Any, time: float, by_q: Any, by_v: Any, known: int) -> None:
    """Set the stage's state: from that of the step, after `time`, with the accelerations that are known."""
    for row in range(3):
        for i in range(LANES):
            w[(_STAGE + row) * LANES + i] = w[row * LANES + i] + time * w[(3 + row) * LANES + i]
            w[(_STAGE + 3 + row) * LANES + i] = w[(3 + row) * LANES + i]
        for j in range(known):
            for i in range(LANES):
                a = w[(_ACCELERATION + 3 * j + row) * LANES + i]
                w[(_STAGE + row) * LANES + i] += by_q[j] * a
                w[(_STAGE + 3 + row) * LANES + i] += by_v[j] * a


@_inline
def _measure(w: Any, k: int, ring: Any, noise: Any, first: int, lanes: int) -> None:
    """Set what the controller sees: the state of some samples ago, and noise."""
    delay = ring.shape[0] - 1
    now, then = k % (delay + 1), max(k - delay, 0) % (delay + 1)
    for j in range(6 * LANES):
        ring[now, j] = w[j]
    for j in range(6 * LANES):
        w[_MEASURED * LANES + j] = ring[then, j]
    if noise.shape[0]:
        for row in range(6):
            for i in range(LANES):
                w[(_MEASURED + row) * LANES + i] += noise[k, row, first + min(i, lanes - 1)]


@_inline
def _control(w: Any, at: Any, wrap: bool, torque: bool) -> None:
    """Set the controller's force, with gains that are matrices."""
    for i in range(LANES):
        p, r = w[(_MEASURED + 2) * LANES + i], w[(_MEASURED + 5) * LANES + i]
        raw = at[2] - p
        ex, ey = at[0] - w[_MEASURED * LANES + i], at[1] - w[(_MEASURED + 1) * LANES + i]
        turn = _chosen(wrap, _on_circle(raw), raw)
        eu, ev = at[3] - w[(_MEASURED + 3) * LANES + i], at[4] - w[(_MEASURED + 4) * LANES + i]
        er = at[5] - r
        fx = _row(w, _MATRICES, i, ex, ey, turn) + _row(w, _MATRICES + 9, i, eu, ev, er)
        fy = _row(w, _MATRICES + 3, i, ex, ey, turn) + _row(w, _MATRICES + 12, i, eu, ev, er)
        mz = _row(w, _MATRICES + 6, i, ex, ey, turn) + _row(w, _MATRICES + 15, i, eu, ev, er)
        if torque:
            s, c = _sincos(p)
            fx, fy, mz = _model_force(w, i, s, c, r, fx + at[6], fy + at[7], mz + at[8])
        fx, fy, mz = _clipped(w, i, fx, fy, mz)
        w[_TAU * LANES + i], w[(_TAU + 1) * LANES + i], w[(_TAU + 2) * LANES + i] = fx, fy, mz


@_inline
def _row(w: Any, row: int, i: int, x: float, y: float, z: float) -> float:
    return w[row * LANES + i] * x + w[(row + 1) * LANES + i] * y + w[(row + 2) * LANES + i] * z


@_inline
def _sample(w: Any, at: Any, limit: float) -> None:
    for i in range(LANES):
        ex, ey = at[0] - w[_X * LANES + i], at[1] - w[_Y * LANES + i]
        ep = _on_circle(at[2] - w[_PSI * LANES + i])
        eu, ev, er = at[3] - w[_U * LANES + i], at[4] - w[_V * LANES + i], at[5] - w[_R * LANES + i]
        force = w[_TAU * LANES + i], w[(_TAU + 1) * LANES + i], w[(_TAU + 2) * LANES + i]
        ax, ay = w[_ACCELERATION * LANES + i], w[(_ACCELERATION + 1) * LANES + i]
        spin = w[(_ACCELERATION + 2) * LANES + i]
        _judge(w, i, limit, (ex, ey, ep, eu, ev, er), force, (ax, ay, spin))


@_inline
def _step(w: Any, t: float, h: float, f: Any, waves: Any, rollings: int, sines: int, table: Any) -> None:
    """Move the state by one step of length `h`; its first acceleration is known."""
    stages = table.shape[1] - 1
    for stage in range(1, stages):
        time = table[2, stage, 0] * h
        _move(w, time, table[0, stage], table[1, stage], stage)
        _outside(w, _STAGE, t + time, f, waves[stage], rollings, sines)
        _accelerate(w, _STAGE, _ACCELERATION + 3 * stage)
    _move(w, h, table[0, stages], table[1, stages], stages)
    for j in range(6 * LANES):
        w[j] = w[_STAGE * LANES + j]


@numba.njit(**_options)
def general(
    inputs: Any,
    results: Any,
    reference: Any,
    times: Any,
    h: float,
    wrap: bool,
    limit: float,
    begin: int,
    every: int,
    counts: Any,
    torque: bool,
    matrices: Any,
    forces: Any,
    waves: Any,
    rollings: int,
    sines: int,
    noise: Any,
    delay: int,
    table: Any,
) -> None:
    """Run robots with whatever the library has.

    Parameters
    ----------
    inputs, results, reference, wrap, limit, begin, every, counts
        As in `lean`.
    times : ndarray, shape (N + 1,)
        Of the samples [s].
    h : float
        Length of a step of the integrator [s].
    torque : bool
        Whether the control is computed torque.
    matrices : ndarray, shape (18, n)
        kp and kd, row by row.
    forces : ndarray, shape (m, n)
        Constant (3), viscous (3), each rolling resistance (3 and 3 speeds), each sinusoid (3, frequency,
        phase), each wave of noise (3 in phase and 3 in quadrature).
    waves : ndarray, shape (N substeps + 1, stages, waves, 3, 2)
        Cosine and sine of the waves of noise, of each component its own, at the times of the stages.
    rollings, sines : int
        How many there are.
    noise : ndarray, shape (N + 1, 6, n) or (0, 6, n)
        What is added to the measured configuration and velocity.
    delay : int
        Age of the measurements in samples.
    table : ndarray, shape (3, stages + 1, stages)
        Weights of the accelerations for configuration (times h^2) and velocity (times h), the last row those
        of the step; the nodes.
    """
    last = reference.shape[0] - 1
    substeps = (waves.shape[0] - 1) // last if last else 1
    w, ring = np.empty(_ROWS * LANES), np.empty((delay + 1, 6 * LANES))
    f = np.empty((forces.shape[0], LANES))
    for first in range(0, inputs.shape[1], LANES):
        lanes = min(LANES, inputs.shape[1] - first)
        _load(w, inputs, first, lanes)
        for i in range(LANES):
            for row in range(18):
                w[(_MATRICES + row) * LANES + i] = matrices[row, first + min(i, lanes - 1)]
            for row in range(forces.shape[0]):
                f[row, i] = forces[row, first + min(i, lanes - 1)]
        for k in range(last + 1):
            _measure(w, k, ring, noise, first, lanes)
            _control(w, reference[k], wrap, torque)
            for j in range(substeps):
                now, t = k * substeps + j, times[k] + j * h
                _outside(w, _X, t, f, waves[now, 0], rollings, sines)
                _accelerate(w, _X, _ACCELERATION)
                if j == 0:
                    if k == begin:
                        _forget(w)
                    _sample(w, reference[k], limit)
                    if k % every == 0:
                        _count(w, lanes, counts[k // every])
                if k == last:
                    break
                _step(w, t, h, f, waves[now], rollings, sines, table)
        _store(w, results, first, lanes)
