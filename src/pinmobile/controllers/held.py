"""Whether gains are stable with a force that is held between samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument, NotTraceable

_ROUNDING = 1e-7  # by which an eigenvalue of a double root at 1 is computed too large
_SHARE = 1e-3  # of a time step, below which a bound is none


def double_integrators(dt: float, kp: Array, kd: Array, ki: Array) -> Array:
    """Return the loop of x'' = u, u = -kp x - kd x' + ki z, z' = -x, with u held, shape (..., 3 n, 3 n).

    The integral z is summed by explicit Euler after u. Gains are matrices, shape (..., n, n).
    """
    kp, kd, ki = np.broadcast_arrays(kp, kd, ki)
    one = np.eye(kp.shape[-1])
    force = np.concatenate([-kp, -kd, ki], axis=-1)
    rows = ([one, dt * one, 0 * one], [0 * one, one, 0 * one], [-dt * one, 0 * one, one])
    pushes = np.concatenate([dt * dt / 2 * one, dt * one, 0 * one])
    return np.asarray(np.block([list(row) for row in rows]) + pushes @ force)


def diagonal(gain: Array) -> Array:
    """Return gains of each coordinate, shape (..., n), as matrices."""
    return np.asarray(gain[..., None] * np.eye(gain.shape[-1]))


def check_held(gains: Callable[[], dict[str, Any]], loop: Callable[[float], Array], dt: float) -> None:
    """Refuse gains with which a loop of a rigid robot, its model exact, is unstable at this time step.

    Gains that are symbols, of robots that each have their own, are not looked at.

    Parameters
    ----------
    gains : callable
        Returns them by name, for the message.
    loop : callable
        ``loop(dt)`` returns the matrix from one sample's error to the next one's, shape (..., k, k).
    dt : float
        Time between two samples [s].

    Raises
    ------
    InvalidArgument
        If an eigenvalue lies outside the unit circle; with the longest time step at which none does.
    """

    def is_stable(step: float) -> bool:
        return bool((np.abs(np.linalg.eigvals(loop(step))) <= 1 + _ROUNDING).all())

    try:
        given = {name: np.asarray(gain, np.float64) for name, gain in gains().items()}
        if is_stable(dt):
            return
    except (NotTraceable, TypeError):
        return
    words = ", ".join(f"{name} = {np.unique(gain).tolist()}" for name, gain in given.items())
    good, bad = 0.0, dt
    for _ in range(40):
        middle = (good + bad) / 2
        good, bad = (middle, bad) if is_stable(middle) else (good, middle)
    if good < _SHARE * dt:
        raise InvalidArgument(f"gains {words} are unstable at any dt, expected others")
    raise InvalidArgument(
        f"gains {words} are unstable with an input that is held for dt = {dt:g} s, expected "
        f"dt < {good:.3g} s, or smaller gains"
    )
