"""The body's parameters, checked, and its centre of mass seen along the inertial axes."""

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, vector
from pinmobile.errors import InvalidArgument

__all__ = ["checked_body", "stacked", "turned"]


def checked_body(q: Array, mass: ArrayLike, yaw_inertia: ArrayLike, com: ArrayLike) -> tuple[Array, ...]:
    """Return mass, yaw inertia, xbc and ybc, all of one shape, that of the leading axes of q and their own.

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass or inertia is not positive.
    """
    m, inertia, com = finite("mass", mass), finite("yaw_inertia", yaw_inertia), vector("com", com, 2)
    for name, value in (("mass", m), ("yaw_inertia", inertia)):
        if not (value > 0).all():
            raise InvalidArgument(f"{name} is {value.min()}, expected > 0")
    try:
        m, inertia, x, y, _ = np.broadcast_arrays(m, inertia, com[..., 0], com[..., 1], q[..., 2])
    except ValueError:
        raise InvalidArgument(
            f"q, mass, yaw_inertia and com have leading shapes {q.shape[:-1]}, {m.shape}, {inertia.shape} "
            f"and {com.shape[:-1]}, expected shapes that broadcast"
        ) from None
    return m, inertia, x, y


def turned(q: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Return d, the centre of mass (x, y) of the body frame along the inertial axes, each of shape (...)."""
    c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
    return x * c - y * s, x * s + y * c


def stacked(*columns: ArrayLike) -> Array:
    """Return columns of shape (...), broadcast, as one array of shape (..., columns)."""
    return np.stack(np.broadcast_arrays(*map(np.asarray, columns)), axis=-1)
