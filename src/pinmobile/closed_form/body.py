"""The body's parameters, checked, and its centre of mass seen along the inertial axes."""

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, vector
from pinmobile.errors import InvalidArgument

__all__ = ["checked_body", "named", "quietly", "stacked", "turned"]

quietly = np.errstate(over="ignore", invalid="ignore", divide="ignore")
"""Decorator of what looks at its answer itself, so that numpy need not warn."""


def checked_body(
    q: Array, mass: ArrayLike, yaw_inertia: ArrayLike, com: ArrayLike, **others: Array
) -> tuple[Array, ...]:
    """Return mass, yaw inertia, xbc and ybc, all of one shape, that of the leading axes of q and their own.

    With these, the leading axes of `others`, which are named as in q's function, have to broadcast.

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
        np.broadcast_shapes(m.shape, inertia.shape, *(x.shape[:-1] for x in (com, q, *others.values())))
    except ValueError:
        names = ", ".join(["q", *others, "mass", "yaw_inertia"])
        shapes = [*(str(x.shape[:-1]) for x in (q, *others.values())), str(m.shape), str(inertia.shape)]
        raise InvalidArgument(
            f"{names} and com have leading shapes {', '.join(shapes)} and {com.shape[:-1]}, expected shapes "
            "that broadcast"
        ) from None
    m, inertia, x, y, _ = np.broadcast_arrays(m, inertia, com[..., 0], com[..., 1], q[..., 2])
    return m, inertia, x, y


def named(body: tuple[Array, ...]) -> dict[str, ArrayLike]:
    """Return what `checked_body` returns, by name."""
    mass, yaw_inertia, x, y = body
    return {"mass": mass, "yaw_inertia": yaw_inertia, "com": (x, y)}


def turned(q: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Return d, the centre of mass (x, y) of the body frame along the inertial axes, each of shape (...)."""
    c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
    return x * c - y * s, x * s + y * c


def stacked(*columns: ArrayLike) -> Array:
    """Return columns of shape (...), broadcast, as one array of shape (..., columns)."""
    return np.stack(np.broadcast_arrays(*map(np.asarray, columns)), axis=-1)
