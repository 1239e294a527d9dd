"""Where an end effector shall be and how it shall stand, as a function of time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, finite, frozen
from pinmobile.errors import InvalidArgument
from pinmobile.paths import Path, checked_path, within

_ORTHOGONAL = 1e-6  # how far R' R may be from the identity
_HALF_TURN = 1e-6  # [rad]; nearer to it, which way round is rounding's choice
_SMALL = 0.05  # of the length of a rotation vector


class PoseTarget(NamedTuple):
    """Where a frame shall be and how it shall move, at one time or at many.

    Attributes
    ----------
    pose : ndarray, shape (..., 4, 4)
        T_0_f; its rotation means nothing where only the position is followed.
    twist : ndarray, shape (..., 6)
        Velocity of the origin and angular velocity along the inertial axes [m/s, rad/s].
    rate : ndarray, shape (..., 6)
        The twist's derivative [m/s^2, rad/s^2].
    """

    pose: Array
    twist: Array
    rate: Array


@dataclass(frozen=True, eq=False)
class PosePath:
    """A path in space with an orientation: one that is held, a turn from one to another, or none.

    The turn is about one axis, the shortest way, at rest at both ends (quintic in time).

    Parameters
    ----------
    path : Path
        A path of three coordinates x, y, z in the inertial frame [m].
    rotation : array_like, shape (3, 3), optional
        R_0_f, the orientation of the end effector's frame; by default only the position is followed.
    final_rotation : array_like, shape (3, 3), optional
        The orientation at the end; by default `rotation`.

    Raises
    ------
    InvalidArgument
        If `path` is no path in space, a rotation is none, `final_rotation` comes alone, or the two are half a
        turn apart.
    """

    path: Path
    rotation: ArrayLike | None = None
    final_rotation: ArrayLike | None = None
    _turn: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        checked_path(self.path, 3)
        for name in ("rotation", "final_rotation"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _checked_rotation(name, getattr(self, name)))
        if self.rotation is None and self.final_rotation is not None:
            raise InvalidArgument("final_rotation is given without rotation, expected both")
        turn = np.zeros(3)
        if self.final_rotation is not None:
            turn = pin.log3(np.asarray(self.rotation).T @ self.final_rotation)
            if np.linalg.norm(turn) > np.pi - _HALF_TURN:
                raise InvalidArgument(
                    "final_rotation is half a turn from rotation, expected less: which way round is open"
                )
        object.__setattr__(self, "_turn", frozen(turn))

    @property
    def duration(self) -> float:
        """The path's duration [s]."""
        return float(self.path.duration)

    @property
    def rows(self) -> int:
        """How many coordinates of a twist are followed: 6, or 3 where the position alone is."""
        return 3 if self.rotation is None else 6

    def __call__(self, t: ArrayLike) -> PoseTarget:
        """Return the target.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        target : PoseTarget

        Raises
        ------
        InvalidArgument
            If a time is outside.
        """
        times = within("t", t, self.duration)
        pose = np.zeros((*times.shape, 4, 4))
        twist, rate = np.zeros((2, *times.shape, 6))
        pose[..., 3, 3] = 1
        pose[..., :3, 3] = self.path(times)
        twist[..., :3], rate[..., :3] = (self.path.derivative(times, order) for order in (1, 2))
        start = np.eye(3) if self.rotation is None else np.asarray(self.rotation)
        s, ds, dds = _quintic(times / self.duration)
        pose[..., :3, :3] = start @ _turned(self._turn, s)
        axis = start @ self._turn  # the axis does not move: along it, rates are those of the angle
        twist[..., 3:] = ds[..., None] / self.duration * axis
        rate[..., 3:] = dds[..., None] / self.duration**2 * axis
        return PoseTarget(pose, twist, rate)


def pose_error(target: Array, actual: Array) -> Array:
    """Return how far a pose is from its target, shape (..., 6) [m, rad], along the inertial axes.

    The way of the origin, then the rotation vector (axis times angle, in [0, pi]) that turns the actual into
    the target orientation.

    Parameters
    ----------
    target, actual : ndarray, shape (..., 4, 4)
        Poses; leading axes broadcast.
    """
    way = target[..., :3, 3] - actual[..., :3, 3]
    turn = target[..., :3, :3] @ np.swapaxes(actual[..., :3, :3], -1, -2)
    turns = np.array([_log(R) for R in turn.reshape(-1, 3, 3)]).reshape((*turn.shape[:-2], 3))
    return np.concatenate([way, turns], axis=-1)


def _log(R: Array) -> Array:
    """Return the rotation vector of a rotation, shape (3,), of half a turn that whose sense is no rounding's.

    Its first component that is not small is above zero: axes that people choose have none of about the size
    where small begins.
    """
    turn = pin.log3(R)
    angle = float(np.linalg.norm(turn))
    if angle > np.pi - _HALF_TURN:
        leading = turn[np.argmax(np.abs(turn) > _SMALL * angle)]
        if leading < 0:
            turn = turn * (1 - 2 * np.pi / angle)  # the same rotation, the other way round
    return np.asarray(turn)


def error_sizes(error: Array) -> Array:
    """Return the distance [m] and the angle [rad] of pose errors, shape (..., 2), the same in any direction.

    Parameters
    ----------
    error : ndarray, shape (..., 6) or (..., 3)
        As from `pose_error`; where the position alone is followed, the angle is zero.
    """
    return np.stack([np.linalg.norm(part, axis=-1) for part in (error[..., :3], error[..., 3:])], axis=-1)


def _quintic(x: Array) -> tuple[Array, Array, Array]:
    """Return the quintic from 0 to 1, at rest at both ends, and its first two derivatives."""
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * (x * (1 - x)) ** 2, 60 * x * (1 - x) * (1 - 2 * x)


def _turned(turn: Array, share: Array) -> Array:
    """Return the rotations by shares of a rotation vector, shape (..., 3, 3) (Rodrigues, 1840)."""
    angle = float(np.linalg.norm(turn))
    K = pin.skew(turn / angle) if angle else np.zeros((3, 3))
    angles = (angle * share)[..., None, None]
    return np.asarray(np.eye(3) + np.sin(angles) * K + (1 - np.cos(angles)) * (K @ K))


def _checked_rotation(name: str, value: ArrayLike) -> Array:
    R = finite(name, value)
    if R.shape != (3, 3):
        raise InvalidArgument(f"{name} has shape {R.shape}, expected (3, 3)")
    off = float(np.abs(R.T @ R - np.eye(3)).max())
    if off > _ORTHOGONAL or np.linalg.det(R) < 0:
        raise InvalidArgument(
            f"{name} has R' R off by {round(off, 9):.3g} and det R = {np.linalg.det(R):.3g}, "
            "expected a rotation matrix"
        )
    return frozen(R)
