"""The terms of the equations of motion: M(q), C(q, v) and n(q, v)."""

import numpy as np

from pinmobile.arrays import Array, ArrayLike, broadcast, finite_answer, vector
from pinmobile.closed_form.body import checked_body, named, quietly, stacked, turned

__all__ = [
    "coriolis_matrix",
    "mass_matrix",
    "nonlinear_effects",
    "unchecked_coriolis_matrix",
    "unchecked_mass_matrix",
]


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
    body = checked_body(q, mass, yaw_inertia, com)
    return finite_answer(unchecked_mass_matrix(q, *body), **named(body))


def unchecked_mass_matrix(q: Array, mass: Array, yaw_inertia: Array, com_x: Array, com_y: Array) -> Array:
    """Return `mass_matrix` without a look at the arguments: for laws that run on symbols or arrays.

    Parameters
    ----------
    q : ndarray, shape (..., 3)
        As in `mass_matrix`.
    mass, yaw_inertia, com_x, com_y : ndarray, shape (...)
        As in `mass_matrix`, with the leading axes of q.
    """
    dx, dy = turned(q, com_x, com_y)
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
    m, _, x, y = body = checked_body(q, mass, 1.0, com, v=v)
    return finite_answer(unchecked_coriolis_matrix(q, v, m, x, y), v=v, **named(body))


def unchecked_coriolis_matrix(q: Array, v: Array, mass: Array, com_x: Array, com_y: Array) -> Array:
    """Return `coriolis_matrix` without a look at the arguments: for laws that run on symbols or arrays.

    Parameters
    ----------
    q, v : ndarray, shape (..., 3)
        As in `coriolis_matrix`.
    mass, com_x, com_y : ndarray, shape (...)
        As in `coriolis_matrix`, with the leading axes of q.
    """
    dx, dy = turned(q, com_x, com_y)
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
    m, _, x, y = body = checked_body(q, mass, 1.0, com, v=v)
    dx, dy = turned(q, x, y)
    pull = -m * v[..., 2] ** 2
    return finite_answer(stacked(pull * dx, pull * dy, 0.0), v=v, **named(body))
