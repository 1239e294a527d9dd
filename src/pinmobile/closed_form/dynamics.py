"""Inverse and forward dynamics, each with a look at the arguments and without."""

from pinmobile.arrays import Array, ArrayLike, broadcast, finite_answer, vector
from pinmobile.closed_form.body import checked_body, named, quietly, stacked, turned

__all__ = [
    "forward_dynamics",
    "inverse_dynamics",
    "unchecked_forward_dynamics",
    "unchecked_inverse_dynamics",
]


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
    body = checked_body(q, mass, yaw_inertia, com, v=v, a=a)
    return finite_answer(unchecked_inverse_dynamics(q, v, a, *body), v=v, a=a, **named(body))


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
    body = checked_body(q, mass, yaw_inertia, com, v=v, tau=tau)
    return finite_answer(unchecked_forward_dynamics(q, v, tau, *body), v=v, tau=tau, **named(body))


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
    dx, dy = turned(q, com_x, com_y)
    rate2, spin = v[..., 2] ** 2, a[..., 2]
    fx = mass * (a[..., 0] - dy * spin - dx * rate2)
    fy = mass * (a[..., 1] + dx * spin - dy * rate2)
    moment = yaw_inertia * spin + mass * (dx * (a[..., 1] + dx * spin) - dy * (a[..., 0] - dy * spin))
    return stacked(fx, fy, moment)


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
    dx, dy = turned(q, com_x, com_y)
    rate2, fx, fy = v[..., 2] ** 2, tau[..., 0], tau[..., 1]
    spin = (tau[..., 2] - (dx * fy - dy * fx)) / yaw_inertia
    return stacked(fx / mass + dy * spin + dx * rate2, fy / mass - dx * spin + dy * rate2, spin)
