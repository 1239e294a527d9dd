"""The hand-derived equations of motion of the lecture; everything broadcasts over leading axes.

The parameters are arrays too: one robot with many states, many robots with one state, or each its own.
With c = cos psi and s = sin psi, ``d = (xbc c - ybc s, xbc s + ybc c)`` is the centre of mass seen from the
body's origin, along the inertial axes. In these terms (lecture, section 3 of its mathematics)::

    M(q) = [   m       0      -m d_y          ]        n(q, v) = -m psi_dot^2 [ d_x ]
           [   0       m       m d_x          ]                               [ d_y ]
           [ -m d_y   m d_x    m |d|^2 + Icz  ]                               [  0  ]
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, broadcast, finite, finite_answer, vector
from pinmobile.errors import InvalidArgument

Numbers: TypeAlias = Array | float
"""A parameter of all bodies, or one for each, shape (...)."""

quietly = np.errstate(over="ignore", invalid="ignore", divide="ignore")
"""Decorator of what looks at its answer itself, so that numpy need not warn."""


def _checked_body(
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
        bounded(name, value, above=0)
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


def _named(body: tuple[Array, ...]) -> dict[str, ArrayLike]:
    """Return what `checked_body` returns, by name."""
    mass, yaw_inertia, x, y = body
    return {"mass": mass, "yaw_inertia": yaw_inertia, "com": (x, y)}


def _turned(q: Array, x: Numbers, y: Numbers) -> tuple[Array, Array]:
    """Return d, the centre of mass (x, y) of the body frame along the inertial axes, each of shape (...)."""
    c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
    return x * c - y * s, x * s + y * c


def _stacked(*columns: ArrayLike) -> Array:
    """Return columns of shape (...), broadcast, as one array of shape (..., columns)."""
    return np.stack(np.broadcast_arrays(*map(np.asarray, columns)), axis=-1)


@quietly
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
    NotFinite
        If the answer is beyond the numbers that a computer has.
    """
    q = vector("q", q, 3)
    body = _checked_body(q, mass, yaw_inertia, com)
    return finite_answer(unchecked_mass_matrix(q, *body), **_named(body))


def unchecked_mass_matrix(
    q: Array, mass: Numbers, yaw_inertia: Numbers, com_x: Numbers, com_y: Numbers
) -> Array:
    """Return `mass_matrix` without a look at the arguments: for laws that run on symbols or arrays.

    Parameters
    ----------
    q : ndarray, shape (..., 3)
        As in `mass_matrix`.
    mass, yaw_inertia, com_x, com_y : ndarray, shape (...)
        As in `mass_matrix`, with the leading axes of q.
    """
    dx, dy = _turned(q, com_x, com_y)
    M = np.zeros((*dx.shape, 3, 3))
    M[..., 0, 0] = M[..., 1, 1] = mass
    M[..., 0, 2] = M[..., 2, 0] = -mass * dy
    M[..., 1, 2] = M[..., 2, 1] = mass * dx
    M[..., 2, 2] = mass * (dx * dx + dy * dy) + yaw_inertia
    return M


@quietly
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
    NotFinite
        If the answer is beyond the numbers that a computer has.
    """
    q, v = vector("q", q, 3), vector("v", v, 3)
    broadcast(q=q, v=v)
    m, _, x, y = body = _checked_body(q, mass, 1.0, com, v=v)
    return finite_answer(unchecked_coriolis_matrix(q, v, m, x, y), v=v, **_named(body))


def unchecked_coriolis_matrix(q: Array, v: Array, mass: Numbers, com_x: Numbers, com_y: Numbers) -> Array:
    """Return `coriolis_matrix` without a look at the arguments: for laws that run on symbols or arrays.

    Parameters
    ----------
    q, v : ndarray, shape (..., 3)
        As in `coriolis_matrix`.
    mass, com_x, com_y : ndarray, shape (...)
        As in `coriolis_matrix`, with the leading axes of q.
    """
    dx, dy = _turned(q, com_x, com_y)
    rate = v[..., 2]
    C = np.zeros((*np.broadcast_shapes(dx.shape, rate.shape), 3, 3))
    C[..., 0, 2] = -mass * dx * rate
    C[..., 1, 2] = -mass * dy * rate
    return C


@quietly
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
    NotFinite
        If the answer is beyond the numbers that a computer has.
    """
    q, v = vector("q", q, 3), vector("v", v, 3)
    broadcast(q=q, v=v)
    m, _, x, y = body = _checked_body(q, mass, 1.0, com, v=v)
    dx, dy = _turned(q, x, y)
    pull = -m * v[..., 2] ** 2
    return finite_answer(_stacked(pull * dx, pull * dy, 0.0), v=v, **_named(body))


@quietly
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
    NotFinite
        If the answer is beyond the numbers that a computer has.
    """
    q, v, a = vector("q", q, 3), vector("v", v, 3), vector("a", a, 3)
    broadcast(q=q, v=v, a=a)
    body = _checked_body(q, mass, yaw_inertia, com, v=v, a=a)
    return finite_answer(unchecked_inverse_dynamics(q, v, a, *body), v=v, a=a, **_named(body))


@quietly
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
    NotFinite
        If the answer is beyond the numbers that a computer has.
    """
    q, v, tau = vector("q", q, 3), vector("v", v, 3), vector("tau", tau, 3)
    broadcast(q=q, v=v, tau=tau)
    body = _checked_body(q, mass, yaw_inertia, com, v=v, tau=tau)
    return finite_answer(unchecked_forward_dynamics(q, v, tau, *body), v=v, tau=tau, **_named(body))


def unchecked_inverse_dynamics(
    q: Array, v: Array, a: Array, mass: Numbers, yaw_inertia: Numbers, com_x: Numbers, com_y: Numbers
) -> Array:
    """Return `inverse_dynamics` without a look at the arguments: for loops that judge what comes.

    Parameters
    ----------
    q, v, a : ndarray, shape (..., 3)
        As in `inverse_dynamics`.
    mass, yaw_inertia, com_x, com_y : ndarray, shape (...)
        As in `inverse_dynamics`, with the leading axes of q.
    """
    dx, dy = _turned(q, com_x, com_y)
    rate2, spin = v[..., 2] ** 2, a[..., 2]
    fx = mass * (a[..., 0] - dy * spin - dx * rate2)
    fy = mass * (a[..., 1] + dx * spin - dy * rate2)
    moment = yaw_inertia * spin + mass * (dx * (a[..., 1] + dx * spin) - dy * (a[..., 0] - dy * spin))
    return _stacked(fx, fy, moment)


def unchecked_forward_dynamics(
    q: Array, v: Array, tau: Array, mass: Numbers, yaw_inertia: Numbers, com_x: Numbers, com_y: Numbers
) -> Array:
    """Return `forward_dynamics` without a look at the arguments: for loops that judge what comes.

    Parameters
    ----------
    q, v, tau : ndarray, shape (..., 3)
        As in `forward_dynamics`.
    mass, yaw_inertia, com_x, com_y : ndarray, shape (...)
        As in `forward_dynamics`, with the leading axes of q.
    """
    dx, dy = _turned(q, com_x, com_y)
    rate2, fx, fy = v[..., 2] ** 2, tau[..., 0], tau[..., 1]
    spin = (tau[..., 2] - (dx * fy - dy * fx)) / yaw_inertia
    return _stacked(fx / mass + dy * spin + dx * rate2, fy / mass - dx * spin + dy * rate2, spin)
