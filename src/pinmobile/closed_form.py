"""The hand-derived equations of motion of the lecture; everything broadcasts over leading axes.

The parameters are arrays too: one robot with many states, many robots with one state, or each its own.
With c = cos psi and s = sin psi, ``d = (xbc c - ybc s, xbc s + ybc c)`` is the centre of mass seen from the
body's origin, along the inertial axes. In these terms (lecture, section 3 of its mathematics)::

    M(q) = [   m       0      -m d_y          ]        n(q, v) = -m psi_dot^2 [ d_x ]
           [   0       m       m d_x          ]                               [ d_y ]
           [ -m d_y   m d_x    m |d|^2 + Icz  ]                               [  0  ]
"""

import numpy as np

from pinmobile.arrays import Array, ArrayLike, broadcast, finite, vector
from pinmobile.errors import InvalidArgument

__all__ = [
    "coriolis_matrix",
    "forward_dynamics",
    "inverse_dynamics",
    "mass_matrix",
    "nonlinear_effects",
    "unchecked_forward_dynamics",
    "unchecked_inverse_dynamics",
]


def mass_matrix(q: ArrayLike, *, mass: ArrayLike, yaw_inertia: ArrayLike, com: ArrayLike = (0, 0)) -> Array:
    """Return the mass matrix M(q).

    Parameters
    ----------
    q : array_like, shape (..., 3)
        Configuration (x, y, psi) [m, m, rad].
    mass, yaw_inertia : array_like, shape (...)
        Mass [kg]; inertia about the vertical through the centre of mass [kg m^2].
    com : array_like, shape (..., 2)
        Centre of mass (xbc, ybc) in the body frame [m].

    Returns
    -------
    M : ndarray, shape (..., 3, 3)
        [kg, kg m, kg m^2].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass or inertia is not positive.
    """
    q = vector("q", q, 3)
    m, inertia, dx, dy = _body(q, mass, yaw_inertia, com)
    M = np.zeros((*dx.shape, 3, 3))
    M[..., 0, 0] = M[..., 1, 1] = m
    M[..., 0, 2] = M[..., 2, 0] = -m * dy
    M[..., 1, 2] = M[..., 2, 1] = m * dx
    M[..., 2, 2] = m * (dx * dx + dy * dy) + inertia
    return M


def coriolis_matrix(q: ArrayLike, v: ArrayLike, *, mass: ArrayLike, com: ArrayLike = (0, 0)) -> Array:
    """Return the matrix C(q, v) of Christoffel symbols: C v = n and dM/dt - 2 C is skew-symmetric.

    Parameters
    ----------
    q, v : array_like, shape (..., 3)
        Configuration [m, m, rad] and velocity [m/s, m/s, rad/s].
    mass : array_like, shape (...)
        Mass [kg].
    com : array_like, shape (..., 2)
        Centre of mass (xbc, ybc) in the body frame [m].

    Returns
    -------
    C : ndarray, shape (..., 3, 3)
        Only its last column is not zero.

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass is not positive.
    """
    q, v = vector("q", q, 3), vector("v", v, 3)
    broadcast(q=q, v=v)
    m, _, dx, dy = _body(q, mass, 1.0, com)
    rate = v[..., 2]
    C = np.zeros((*np.broadcast_shapes(dx.shape, rate.shape), 3, 3))
    C[..., 0, 2] = -m * dx * rate
    C[..., 1, 2] = -m * dy * rate
    return C


def nonlinear_effects(q: ArrayLike, v: ArrayLike, *, mass: ArrayLike, com: ArrayLike = (0, 0)) -> Array:
    """Return the nonlinear effects n(q, v): the centrifugal force, since the ground is level.

    Parameters
    ----------
    q, v : array_like, shape (..., 3)
        Configuration [m, m, rad] and velocity [m/s, m/s, rad/s].
    mass : array_like, shape (...)
        Mass [kg].
    com : array_like, shape (..., 2)
        Centre of mass (xbc, ybc) in the body frame [m].

    Returns
    -------
    n : ndarray, shape (..., 3)
        [N, N, N m].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass is not positive.
    """
    q, v = vector("q", q, 3), vector("v", v, 3)
    broadcast(q=q, v=v)
    m, _, dx, dy = _body(q, mass, 1.0, com)
    pull = -m * v[..., 2] ** 2
    return _stack(pull * dx, pull * dy, 0.0)


def inverse_dynamics(
    q: ArrayLike,
    v: ArrayLike,
    a: ArrayLike,
    *,
    mass: ArrayLike,
    yaw_inertia: ArrayLike,
    com: ArrayLike = (0, 0),
) -> Array:
    """Return the generalised force tau = M(q) a + n(q, v).

    Parameters
    ----------
    q, v, a : array_like, shape (..., 3)
        Configuration [m, m, rad], velocity [m/s, m/s, rad/s], acceleration [m/s^2, m/s^2, rad/s^2].
    mass, yaw_inertia : array_like, shape (...)
        Mass [kg]; inertia about the vertical through the centre of mass [kg m^2].
    com : array_like, shape (..., 2)
        Centre of mass (xbc, ybc) in the body frame [m].

    Returns
    -------
    tau : ndarray, shape (..., 3)
        (Fx, Fy, Mz) [N, N, N m].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass or inertia is not positive.
    """
    q, v, a = vector("q", q, 3), vector("v", v, 3), vector("a", a, 3)
    broadcast(q=q, v=v, a=a)
    return _inverse(v, a, *_body(q, mass, yaw_inertia, com))


def forward_dynamics(
    q: ArrayLike,
    v: ArrayLike,
    tau: ArrayLike,
    *,
    mass: ArrayLike,
    yaw_inertia: ArrayLike,
    com: ArrayLike = (0, 0),
) -> Array:
    """Return the acceleration a = M(q)^-1 (tau - n(q, v)), without forming M.

    The yaw equation about the centre of mass, Icz psi_ddot = Mz - (d_x Fy - d_y Fx), decouples; the other
    two follow from it.

    Parameters
    ----------
    q, v : array_like, shape (..., 3)
        Configuration [m, m, rad] and velocity [m/s, m/s, rad/s].
    tau : array_like, shape (..., 3)
        (Fx, Fy, Mz) [N, N, N m].
    mass, yaw_inertia : array_like, shape (...)
        Mass [kg]; inertia about the vertical through the centre of mass [kg m^2].
    com : array_like, shape (..., 2)
        Centre of mass (xbc, ybc) in the body frame [m].

    Returns
    -------
    a : ndarray, shape (..., 3)
        [m/s^2, m/s^2, rad/s^2].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass or inertia is not positive.
    """
    q, v, tau = vector("q", q, 3), vector("v", v, 3), vector("tau", tau, 3)
    broadcast(q=q, v=v, tau=tau)
    return _forward(v, tau, *_body(q, mass, yaw_inertia, com))


def unchecked_inverse_dynamics(
    q: Array, v: Array, a: Array, mass: Array, yaw_inertia: Array, com_x: Array, com_y: Array
) -> Array:
    """Return `inverse_dynamics` without a look at the arguments: for loops that judge what comes.

    Parameters
    ----------
    q, v, a : ndarray, shape (..., 3)
        As in `inverse_dynamics`.
    mass, yaw_inertia, com_x, com_y : ndarray, shape (...)
        As in `inverse_dynamics`, with the leading axes of q.
    """
    return _inverse(v, a, mass, yaw_inertia, *_turned(q, com_x, com_y))


def unchecked_forward_dynamics(
    q: Array, v: Array, tau: Array, mass: Array, yaw_inertia: Array, com_x: Array, com_y: Array
) -> Array:
    """Return `forward_dynamics` without a look at the arguments: for loops that judge what comes.

    Parameters
    ----------
    q, v, tau : ndarray, shape (..., 3)
        As in `forward_dynamics`.
    mass, yaw_inertia, com_x, com_y : ndarray, shape (...)
        As in `forward_dynamics`, with the leading axes of q.
    """
    return _forward(v, tau, mass, yaw_inertia, *_turned(q, com_x, com_y))


def _inverse(v: Array, a: Array, m: Array, inertia: Array, dx: Array, dy: Array) -> Array:
    rate2, spin = v[..., 2] ** 2, a[..., 2]
    fx = m * (a[..., 0] - dy * spin - dx * rate2)
    fy = m * (a[..., 1] + dx * spin - dy * rate2)
    moment = inertia * spin + m * (dx * (a[..., 1] + dx * spin) - dy * (a[..., 0] - dy * spin))
    return _stack(fx, fy, moment)


def _forward(v: Array, tau: Array, m: Array, inertia: Array, dx: Array, dy: Array) -> Array:
    rate2, fx, fy = v[..., 2] ** 2, tau[..., 0], tau[..., 1]
    spin = (tau[..., 2] - (dx * fy - dy * fx)) / inertia
    return _stack(fx / m + dy * spin + dx * rate2, fy / m - dx * spin + dy * rate2, spin)


def _turned(q: Array, x: Array, y: Array) -> tuple[Array, Array]:
    c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
    return x * c - y * s, x * s + y * c


def _body(q: Array, mass: ArrayLike, yaw_inertia: ArrayLike, com: ArrayLike) -> tuple[Array, ...]:
    """Return mass, yaw inertia and the two components of d, all of one shape."""
    m, inertia, com = finite("mass", mass), finite("yaw_inertia", yaw_inertia), vector("com", com, 2)
    for name, value in (("mass", m), ("yaw_inertia", inertia)):
        if not (value > 0).all():
            raise InvalidArgument(f"{name} is {value.min()}, expected > 0")
    try:
        parts = np.broadcast_arrays(m, inertia, *_turned(q, com[..., 0], com[..., 1]))
    except ValueError:
        raise InvalidArgument(
            f"q, mass, yaw_inertia and com have leading shapes {q.shape[:-1]}, {m.shape}, {inertia.shape} "
            f"and {com.shape[:-1]}, expected shapes that broadcast"
        ) from None
    return tuple(parts)


def _stack(*columns: ArrayLike) -> Array:
    return np.stack(np.broadcast_arrays(*map(np.asarray, columns)), axis=-1)
