"""How something stands as a function of time: held, turned about one axis, or smoothly by way of others."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, frozen
from pinmobile.errors import InvalidArgument

_HALF_TURN = 1e-6  # [rad]; nearer to it, which way round is rounding's choice
_SMALL = 1e-2  # [rad]: of smaller angles a series is better than what cancels
_ROUNDS, _SETTLED = 200, 1e-13  # of the rates between poses: at most, and relative
_WIDE = 5  # block rows of three: bands beside the diagonal


class Standing(NamedTuple):
    """How something stands at times, and how it turns, along the inertial axes.

    Attributes
    ----------
    R : ndarray, shape (..., 3, 3)
        Orientation.
    rate, change : ndarray, shape (..., 3)
        Angular velocity [rad/s], and its derivative [rad/s^2].
    """

    R: Array
    rate: Array
    change: Array


class Orientation(Protocol):
    """An orientation as a function of time."""

    def __call__(self, t: Array, /) -> Standing:
        """Return how it stands at the times `t`, shape (...) [s]."""
        ...


@dataclass(frozen=True, eq=False)
class Turn:
    """A turn about one axis, at rest at both ends: quintic in time.

    Parameters
    ----------
    start : ndarray, shape (3, 3)
        Orientation at time zero.
    turn : ndarray, shape (3,)
        Rotation vector along the axes of `start`, of any length [rad].
    duration : float
        [s].
    """

    start: Array
    turn: Array
    duration: float

    def __call__(self, t: Array) -> Standing:
        """Return how it stands at times within 0 and the duration."""
        s, ds, dds = _quintic(t / self.duration)
        axis = self.start @ self.turn  # the axis does not move: along it, rates are those of the angle
        rate, change = ds[..., None] / self.duration * axis, dds[..., None] / self.duration**2 * axis
        return Standing(self.start @ rotations_of(s[..., None] * self.turn), rate, change)


@dataclass(frozen=True, eq=False)
class Through:
    """The smooth way through orientations, at rest at both ends: its angular acceleration is continuous.

    Between two of them the rotation vector from the first is a cubic of time, as in
    ``scipy.spatial.transform.RotationSpline``, whose ends are not at rest.

    Parameters
    ----------
    rotations : ndarray, shape (n, 3, 3)
        Each less than half a turn from the one before; n >= 2.
    times : ndarray, shape (n,)
        From zero, increasing [s].

    Raises
    ------
    InvalidArgument
        If two that follow each other are half a turn apart, or they turn too unevenly for such a way.
    """

    rotations: Array
    times: Array
    _cubics: Array = field(init=False, repr=False)  # (n - 1, 4, 3), in powers of the time since the knot

    def __post_init__(self) -> None:
        R, steps = self.rotations, np.diff(self.times)
        turns = np.array([pin.log3(a.T @ b) for a, b in pairwise(R)])
        angles = np.linalg.norm(turns, axis=1)
        k = int(np.argmax(angles))
        if half_turn_apart(angles[k]):
            raise InvalidArgument(
                f"rotation[{k + 1}] is half a turn from rotation[{k}], expected less: which way round is "
                "open; give one between them"
            )
        rates = _rates(turns, steps)
        after = np.einsum("nij,nj->ni", _right_jacobians_inverse(turns), rates[1:])
        h = steps[:, None]
        quadratic = (3 * turns / h - 2 * rates[:-1] - after) / h
        cubic = (rates[:-1] + after - 2 * turns / h) / h**2
        rows = np.stack([np.zeros_like(turns), rates[:-1], quadratic, cubic], axis=1)
        object.__setattr__(self, "_cubics", frozen(rows))

    def __call__(self, t: Array) -> Standing:
        """Return how it stands at times within the first and the last."""
        k = np.searchsorted(self.times[1:-1], t, side="right")
        s, c = (t - self.times[k])[..., None], np.moveaxis(self._cubics[k], -2, 0)
        phi = s * (c[1] + s * (c[2] + s * c[3]))
        rate = c[1] + s * (2 * c[2] + s * 3 * c[3])
        change = 2 * c[2] + 6 * s * c[3]
        start = self.rotations[k]
        turned = start @ rotations_of(phi)
        own = (_body_rate(phi, rate), _body_rate(phi, change) + _body_drift(phi, rate))
        seen = (np.einsum("...ij,...j->...i", turned, each) for each in own)
        return Standing(turned, *seen)


def rotations_of(turns: Array) -> Array:
    """Return the rotations by rotation vectors, shape (..., 3, 3) (Rodrigues, 1840).

    Parameters
    ----------
    turns : ndarray, shape (..., 3)
        [rad].
    """
    K, (a, b, _, _) = _skew(turns), _coefficients(turns)
    sine = (1 - b[..., None, None] * np.einsum("...i,...i->...", turns, turns)[..., None, None]) * K
    return np.asarray(np.eye(3) + sine + a[..., None, None] * (K @ K))


def half_turn_apart(angle: float) -> bool:
    """Tell whether an angle [rad] of a rotation vector is half a turn but for rounding."""
    return angle > np.pi - _HALF_TURN


def _rates(turns: Array, steps: Array) -> Array:
    """Return the body's angular velocities at the knots, zero at the ends, shape (n, 3) [rad/s].

    The angular accelerations on either side of a knot agree: linear in the rates but for what the turning of
    the axes adds, which is put in again until nothing changes.
    """
    from scipy.linalg import solve_banded

    inner = len(turns) - 1
    rates = np.zeros((len(turns) + 1, 3))
    if not inner:
        return rates
    J, inverse = _right_jacobians(turns), _right_jacobians_inverse(turns)
    h = steps[:, None]
    pushes = 6 * (turns[:-1] / h[:-1] ** 2 + turns[1:] / h[1:] ** 2)
    banded = np.zeros((2 * _WIDE + 1, 3 * inner))
    for k in range(inner):
        blocks = {k: 4 * (1 / steps[k] + 1 / steps[k + 1]) * np.eye(3)}
        if k:
            blocks[k - 1] = 2 / steps[k] * J[k]
        if k + 1 < inner:
            blocks[k + 1] = 2 / steps[k + 1] * inverse[k + 1]
        for column, block in blocks.items():
            for i, j in np.ndindex(3, 3):
                row, col = 3 * k + i, 3 * column + j
                banded[_WIDE + row - col, col] = block[i, j]
    for _ in range(_ROUNDS):
        ends = np.einsum("nij,nj->ni", inverse[:-1], rates[1:-1])
        found = solve_banded((_WIDE, _WIDE), banded, (pushes - _body_drift(turns[:-1], ends)).ravel())
        before, rates[1:-1] = rates[1:-1].copy(), found.reshape(-1, 3)
        if np.abs(rates[1:-1] - before).max() <= _SETTLED * np.abs(rates).max():
            return rates
    raise InvalidArgument(
        "rotation turns too far from one to the next for a smooth way, expected more of them between"
    )


def _coefficients(phi: Array) -> tuple[Array, Array, Array, Array]:
    """Return (1 - cos x) / x^2, (x - sin x) / x^3 and the derivative of each by x over x, x = |phi|."""
    x = np.linalg.norm(phi, axis=-1)
    small = x < _SMALL
    y = np.where(small, 1.0, x)
    s, c, z = np.sin(y), np.cos(y), x * x
    a = np.where(small, 1 / 2 - z / 24 + z * z / 720, 2 * np.sin(y / 2) ** 2 / y**2)
    b = np.where(small, 1 / 6 - z / 120 + z * z / 5040, (y - s) / y**3)
    da = np.where(small, -1 / 12 + z / 180 - z * z / 6720, (y * s - 2 * (1 - c)) / y**4)
    db = np.where(small, -1 / 60 + z / 1260 - z * z / 60480, (y * (1 - c) - 3 * (y - s)) / y**5)
    return a, b, da, db


def _body_rate(phi: Array, rate: Array) -> Array:
    """Return J(phi) phi', the angular velocity along the turned axes, shape (..., 3)."""
    a, b, _, _ = (each[..., None] for each in _coefficients(phi))
    across = np.cross(phi, rate)
    return np.asarray(rate - a * across + b * np.cross(phi, across))


def _body_drift(phi: Array, rate: Array) -> Array:
    """Return dJ/dt phi', what the angular acceleration is where phi'' is zero, shape (..., 3)."""
    _, b, da, db = (each[..., None] for each in _coefficients(phi))
    across, along = np.cross(phi, rate), np.einsum("...i,...i->...", phi, rate)[..., None]
    turned = np.cross(phi, across)
    return np.asarray(along * (db * turned - da * across) + b * np.cross(rate, across))


def _right_jacobians(phi: Array) -> Array:
    """Return J of the exponential map along the turned axes, shape (..., 3, 3)."""
    a, b, _, _ = (each[..., None, None] for each in _coefficients(phi))
    K = _skew(phi)
    return np.asarray(np.eye(3) - a * K + b * (K @ K))


def _right_jacobians_inverse(phi: Array) -> Array:
    return np.asarray(np.linalg.inv(_right_jacobians(phi)), np.float64)


def _skew(v: Array) -> Array:
    K = np.zeros((*v.shape, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return np.asarray(K - np.swapaxes(K, -1, -2))


def _quintic(x: Array) -> tuple[Array, Array, Array]:
    """Return the quintic from 0 to 1, at rest at both ends, and its first two derivatives."""
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * (x * (1 - x)) ** 2, 60 * x * (1 - x) * (1 - 2 * x)
