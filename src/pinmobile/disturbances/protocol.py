"""What a force is, and what the library's own ask of their parameters."""

from typing import Protocol

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, vector
from pinmobile.errors import InvalidArgument

__all__ = ["CoordinateForce", "Force", "not_below_zero", "numbers", "spread", "triple"]


class Force(Protocol):
    """A generalised force on the body, as a function of time and state.

    Any callable of this form will do in `simulate`, which asks it at every stage of the integrator. One with
    ``signals(t, q, v) -> {name: (unit, value)}`` tells once per sample what is worth recording.
    """

    def __call__(self, t: float, q: Array, v: Array, /) -> Array:
        """Return (Fx, Fy, Mz) along the inertial axes, shape (..., 3) [N, N, N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., 3)
            Pose [m, m, rad] and its rate [m/s, m/s, rad/s].
        """


class CoordinateForce(Protocol):
    """A generalised force on all coordinates of a plant, such as friction in its joints."""

    def on_coordinates(self, t: float, q: Array, v: Array, /) -> Array:
        """Return the force, shape (..., nv), in the units of the plant's coordinates.

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., nq) and (..., nv)
            Configuration and velocity.
        """


def triple(name: str, value: ArrayLike) -> Array:
    """Return `value` as a read-only array, shape (..., 3).

    Raises
    ------
    InvalidArgument
        If it has another shape or is not finite.
    """
    return frozen(vector(name, value, 3))


def numbers(name: str, value: ArrayLike) -> Array:
    """Return `value` as a read-only array, shape (...).

    Raises
    ------
    InvalidArgument
        If it is not finite.
    """
    return frozen(finite(name, value))


def not_below_zero(name: str, value: Array) -> Array:
    """Return `value`, shape (...), after refusing an entry below zero.

    Raises
    ------
    InvalidArgument
        If there is one.
    """
    if (value < 0).any():
        raise InvalidArgument(f"{name} is {value[value < 0][0]}, expected >= 0")
    return value


def spread(tau: Array, t: ArrayLike, q: Array) -> Array:
    """Return `tau`, shape (..., 3), as one for each of the times and poses."""
    shape = np.shape(q)
    if tau.shape == shape and not np.ndim(t):
        return tau
    return np.broadcast_to(tau, np.broadcast_shapes(tau.shape, shape, (*np.shape(t), 1)))
