"""Equations of motion derived by hand: for the lecture's body, and for drives with rolling wheels."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, broadcast, finite, finite_answer, shaped, vector

Numbers: TypeAlias = Array | float
"""One number for all bodies, or an array with one number per body, shape (...)."""

_SIZES = {"q": 3, "v": 3, "a": 3, "tau": 3, "twist": 3, "nu": 2, "com": 2}
_COMPONENTS = "twist", "nu", "com"  # the formulas take the numbers of these one by one
_POSITIVE = "mass", "yaw_inertia", "wheelbase", "radius"
_NON_NEGATIVE = "track", "spin_inertia", "steered_inertia"
_ACUTE_ANGLES = "steering", "roller"
_no_warnings = np.errstate(over="ignore", invalid="ignore", divide="ignore")  # functions check results


def _arguments(**given: ArrayLike) -> tuple[list[Array], Callable[[Array], Array]]:
    """Return checked arguments, with numbers in one shape, and the check of a result.

    The name of an argument determines its expected shape and range.

    Raises
    ------
    InvalidArgument
        If a shape does not fit, or a value is not finite or not in its range.
    """
    checked, parts = dict[str, Array](), list[Array]()
    for name, value in given.items():
        x = vector(name, value, _SIZES[name]) if name in _SIZES else finite(name, value)
        if name in _POSITIVE:
            bounded(name, x, above=0)
        elif name in _NON_NEGATIVE:
            bounded(name, x, least=0)
        elif name in _ACUTE_ANGLES:
            bounded(name, x, above=-np.pi / 2, below=np.pi / 2, unit="rad")
        checked[name] = x
    shape = broadcast(**{name: x if name in _SIZES else x[..., None] for name, x in checked.items()})
    for name, x in checked.items():
        numbers = np.moveaxis(x, -1, 0) if name in _COMPONENTS else [x]
        is_state = name in _SIZES and name not in _COMPONENTS
        parts += [x] if is_state else [np.array(np.broadcast_to(each, shape)) for each in numbers]
    return parts, partial(finite_answer, **checked)


def _rotate_com(q: Array, x: Numbers, y: Numbers) -> tuple[Array, Array]:
    """Return d, the vector (x, y) of the body frame along the inertial axes, each entry of shape (...)."""
    c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
    return x * c - y * s, x * s + y * c


def _stack(*columns: ArrayLike) -> Array:
    """Return columns of shape (...), broadcast, as one array of shape (..., columns)."""
    return np.stack(np.broadcast_arrays(*map(np.asarray, columns)), axis=-1)


@_no_warnings
def mass_matrix(q: ArrayLike, *, mass: ArrayLike, yaw_inertia: ArrayLike, com: ArrayLike = (0, 0)) -> Array:
    """Return the mass matrix M(q) of the lecture's body.

    Parameters
    ----------
    q : array_like, shape (..., 3)
        Configuration (x, y, psi) [m, m, rad].
    mass, yaw_inertia : array_like, shape (...)
        Mass [kg], and moment of inertia about the vertical axis through the centre of mass [kg m^2].
    com : array_like, shape (..., 2)
        Centre of mass (xbc, ybc) in the body frame [m].

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Mass matrix [kg, kg m, kg m^2].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass or inertia is not positive.
    NotFinite
        If the result overflows.

    See Also
    --------
    MobileRobot.mass_matrix : the same matrix by Pinocchio
    verify : comparison of these formulas with other methods

    Examples
    --------
    >>> from pinmobile import closed_form
    >>> body = {"mass": 20.0, "yaw_inertia": 0.5, "com": (0.1, 0.0)}
    >>> closed_form.mass_matrix([0, 0, 0], **body).diagonal()
    array([20. , 20. ,  0.7])
    """
    numbers, answer = _arguments(q=q, mass=mass, yaw_inertia=yaw_inertia, com=com)
    return answer(unchecked_mass_matrix(*numbers))


def unchecked_mass_matrix(
    q: Array, mass: Numbers, yaw_inertia: Numbers, com_x: Numbers, com_y: Numbers
) -> Array:
    """Return `mass_matrix` without checks, for laws with symbols or arrays.

    Parameters
    ----------
    q : ndarray, shape (..., 3)
        Configuration [m, m, rad].
    mass, yaw_inertia, com_x, com_y : ndarray, shape (...)
        Parameters of the body as in `mass_matrix`, with the leading axes of q [kg, kg m^2, m, m].

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Mass matrix [kg, kg m, kg m^2].

    See Also
    --------
    closed_form.mass_matrix : the same function with checks

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.closed_form import unchecked_mass_matrix
    >>> unchecked_mass_matrix(np.zeros(3), 20.0, 0.5, 0.1, 0.0)[2, 2]
    np.float64(0.7)
    """
    dx, dy = _rotate_com(q, com_x, com_y)
    M = np.zeros((*dx.shape, 3, 3))
    M[..., 0, 0] = M[..., 1, 1] = mass
    M[..., 0, 2] = M[..., 2, 0] = -mass * dy
    M[..., 1, 2] = M[..., 2, 1] = mass * dx
    M[..., 2, 2] = mass * (dx * dx + dy * dy) + yaw_inertia
    return M


@_no_warnings
def coriolis_matrix(q: ArrayLike, v: ArrayLike, *, mass: ArrayLike, com: ArrayLike = (0, 0)) -> Array:
    """Return the matrix C(q, v) of Christoffel symbols: C v = n, and dM/dt - 2 C is skew-symmetric.

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
    ndarray, shape (..., 3, 3)
        C(q, v) [kg/s, kg m/s]. Only its last column is not zero.

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass is not positive.
    NotFinite
        If the result overflows.

    See Also
    --------
    closed_form.nonlinear_effects : the product C v

    Examples
    --------
    >>> from pinmobile import closed_form
    >>> q, v = [0, 0, 0], [0, 0, 2]
    >>> C = closed_form.coriolis_matrix(q, v, mass=20.0, com=(0.1, 0.0))
    >>> (C @ v)[0]  # centrifugal force [N]
    np.float64(-8.0)
    """
    numbers, answer = _arguments(q=q, v=v, mass=mass, com=com)
    return answer(unchecked_coriolis_matrix(*numbers))


def unchecked_coriolis_matrix(q: Array, v: Array, mass: Numbers, com_x: Numbers, com_y: Numbers) -> Array:
    """Return `coriolis_matrix` without checks, for laws with symbols or arrays.

    Parameters
    ----------
    q, v : ndarray, shape (..., 3)
        Configuration [m, m, rad] and velocity [m/s, m/s, rad/s].
    mass, com_x, com_y : ndarray, shape (...)
        Parameters of the body as in `coriolis_matrix`, with the leading axes of q [kg, m, m].

    Returns
    -------
    ndarray, shape (..., 3, 3)
        C(q, v) [kg/s, kg m/s].

    See Also
    --------
    closed_form.coriolis_matrix : the same function with checks

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.closed_form import unchecked_coriolis_matrix
    >>> v = np.array([0.0, 0.0, 2.0])
    >>> unchecked_coriolis_matrix(np.zeros(3), v, 20.0, 0.1, 0.0)[0, 2]
    np.float64(-4.0)
    """
    dx, dy = _rotate_com(q, com_x, com_y)
    rate = v[..., 2]
    C = np.zeros((*np.broadcast_shapes(dx.shape, rate.shape), 3, 3))
    C[..., 0, 2] = -mass * dx * rate
    C[..., 1, 2] = -mass * dy * rate
    return C


@_no_warnings
def nonlinear_effects(q: ArrayLike, v: ArrayLike, *, mass: ArrayLike, com: ArrayLike = (0, 0)) -> Array:
    """Return the nonlinear effects n(q, v), which are the centrifugal force since the ground is level.

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
    ndarray, shape (..., 3)
        Nonlinear effects [N, N, N m].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass is not positive.
    NotFinite
        If the result overflows.

    See Also
    --------
    closed_form.coriolis_matrix : matrix C with C v = n
    MobileRobot.nonlinear_effects : the same by Pinocchio

    Examples
    --------
    >>> from pinmobile import closed_form
    >>> q, v = [0, 0, 0], [0, 0, 2]  # turn at 2 rad/s
    >>> n = closed_form.nonlinear_effects(q, v, mass=20.0, com=(0.1, 0))
    >>> n[0], -20.0 * 0.1 * 2**2  # [N]
    (np.float64(-8.0), -8.0)
    """
    (q, v, m, x, y), answer = _arguments(q=q, v=v, mass=mass, com=com)
    dx, dy = _rotate_com(q, x, y)
    factor = -m * v[..., 2] ** 2
    return answer(_stack(factor * dx, factor * dy, 0.0))


@_no_warnings
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
        Mass [kg], and moment of inertia about the vertical axis through the centre of mass [kg m^2].
    com : array_like, shape (..., 2)
        Centre of mass (xbc, ybc) in the body frame [m].

    Returns
    -------
    ndarray, shape (..., 3)
        Generalised force (Fx, Fy, Mz) [N, N, N m].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass or inertia is not positive.
    NotFinite
        If the result overflows.

    See Also
    --------
    closed_form.forward_dynamics : inverse function
    ComputedTorque : controller with inverse dynamics

    Examples
    --------
    >>> from pinmobile import closed_form
    >>> body = {"mass": 20.0, "yaw_inertia": 0.5, "com": (0.1, 0.0)}
    >>> q, v, a = [0, 0, 0], [0, 0, 2], [1, 0, 0]
    >>> closed_form.inverse_dynamics(q, v, a, **body)  # [N, N, N m]
    array([12., 0., 0.])
    """
    numbers, answer = _arguments(q=q, v=v, a=a, mass=mass, yaw_inertia=yaw_inertia, com=com)
    return answer(unchecked_inverse_dynamics(*numbers))


@_no_warnings
def forward_dynamics(
    q: ArrayLike,
    v: ArrayLike,
    tau: ArrayLike,
    *,
    mass: ArrayLike,
    yaw_inertia: ArrayLike,
    com: ArrayLike = (0, 0),
) -> Array:
    """Return the acceleration a = M(q)^-1 (tau - n(q, v)) without forming M.

    The yaw equation about the centre of mass, Icz psi_ddot = Mz - (d_x Fy - d_y Fx), is decoupled. The other
    two equations follow from it.

    Parameters
    ----------
    q, v : array_like, shape (..., 3)
        Configuration [m, m, rad] and velocity [m/s, m/s, rad/s].
    tau : array_like, shape (..., 3)
        Generalised force (Fx, Fy, Mz) [N, N, N m].
    mass, yaw_inertia : array_like, shape (...)
        Mass [kg], and moment of inertia about the vertical axis through the centre of mass [kg m^2].
    com : array_like, shape (..., 2)
        Centre of mass (xbc, ybc) in the body frame [m].

    Returns
    -------
    ndarray, shape (..., 3)
        Acceleration [m/s^2, m/s^2, rad/s^2].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a mass or inertia is not positive.
    NotFinite
        If the result overflows.

    See Also
    --------
    closed_form.inverse_dynamics : inverse function
    simulate : simulation of a robot

    Examples
    --------
    >>> from pinmobile import closed_form
    >>> body = {"mass": 20.0, "yaw_inertia": 0.5, "com": (0.1, 0.0)}
    >>> rest = [0, 0, 0]
    >>> closed_form.forward_dynamics(rest, rest, [0, 20, 0], **body)
    array([ 0. ,  1.4, -4. ])
    """
    numbers, answer = _arguments(q=q, v=v, tau=tau, mass=mass, yaw_inertia=yaw_inertia, com=com)
    return answer(unchecked_forward_dynamics(*numbers))


def unchecked_inverse_dynamics(
    q: Array, v: Array, a: Array, mass: Numbers, yaw_inertia: Numbers, com_x: Numbers, com_y: Numbers
) -> Array:
    """Return `inverse_dynamics` without checks, for loops that check their arguments.

    Parameters
    ----------
    q, v, a : ndarray, shape (..., 3)
        Configuration [m, m, rad], velocity [m/s, m/s, rad/s], acceleration [m/s^2, m/s^2, rad/s^2].
    mass, yaw_inertia, com_x, com_y : ndarray, shape (...)
        Parameters of the body as in `inverse_dynamics`, with the leading axes of q [kg, kg m^2, m, m].

    Returns
    -------
    ndarray, shape (..., 3)
        Generalised force (Fx, Fy, Mz) [N, N, N m].

    See Also
    --------
    closed_form.inverse_dynamics : the same function with checks

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.closed_form import unchecked_inverse_dynamics
    >>> rest, a = np.zeros(3), np.array([1.0, 0.0, 0.0])
    >>> unchecked_inverse_dynamics(rest, rest, a, 20.0, 0.5, 0.1, 0.0)
    array([20., 0., 0.])
    """
    dx, dy = _rotate_com(q, com_x, com_y)
    rate2, spin = v[..., 2] ** 2, a[..., 2]
    fx = mass * (a[..., 0] - dy * spin - dx * rate2)
    fy = mass * (a[..., 1] + dx * spin - dy * rate2)
    moment = yaw_inertia * spin + mass * (dx * (a[..., 1] + dx * spin) - dy * (a[..., 0] - dy * spin))
    return _stack(fx, fy, moment)


def unchecked_forward_dynamics(
    q: Array, v: Array, tau: Array, mass: Numbers, yaw_inertia: Numbers, com_x: Numbers, com_y: Numbers
) -> Array:
    """Return `forward_dynamics` without checks, for loops that check their arguments.

    Parameters
    ----------
    q, v, tau : ndarray, shape (..., 3)
        Configuration [m, m, rad], velocity [m/s, m/s, rad/s], generalised force [N, N, N m].
    mass, yaw_inertia, com_x, com_y : ndarray, shape (...)
        Parameters of the body as in `forward_dynamics`, with the leading axes of q [kg, kg m^2, m, m].

    Returns
    -------
    ndarray, shape (..., 3)
        Acceleration [m/s^2, m/s^2, rad/s^2].

    See Also
    --------
    closed_form.forward_dynamics : the same function with checks

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.closed_form import unchecked_forward_dynamics
    >>> rest, tau = np.zeros(3), np.array([20.0, 0.0, 0.0])
    >>> unchecked_forward_dynamics(rest, rest, tau, 20.0, 0.5, 0.1, 0.0)
    array([1., 0., 0.])
    """
    dx, dy = _rotate_com(q, com_x, com_y)
    rate2, fx, fy = v[..., 2] ** 2, tau[..., 0], tau[..., 1]
    spin = (tau[..., 2] - (dx * fy - dy * fx)) / yaw_inertia
    return _stack(fx / mass + dy * spin + dx * rate2, fy / mass - dx * spin + dy * rate2, spin)


class ReducedModel(NamedTuple):
    """Dynamics M nu' + n = B tau in the independent velocities nu.

    Attributes
    ----------
    M : ndarray, shape (..., m, m)
        Mass matrix [kg, kg m, kg m^2].
    n : ndarray, shape (..., m)
        Nonlinear effects [N, N m].
    B : ndarray, shape (..., m, inputs)
        Input matrix, from motor torques to generalised forces along nu [1/m, 1].

    See Also
    --------
    closed_form.differential_drive : model with two driven wheels
    closed_form.roller_drive : model with mecanum or omni wheels
    closed_form.car : model with steered wheels

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.closed_form import ReducedModel
    >>> M, n, B = ReducedModel(np.eye(2) * 30, np.zeros(2), np.eye(2) * 10)
    >>> np.linalg.solve(M, B @ [3, 0] - n)  # nu' [m/s^2]
    array([1., 0.])
    """

    M: Array
    n: Array
    B: Array


@_no_warnings
def differential_drive(
    nu: ArrayLike,
    *,
    mass: ArrayLike,
    yaw_inertia: ArrayLike,
    com: ArrayLike = (0, 0),
    track: ArrayLike,
    radius: ArrayLike,
    spin_inertia: ArrayLike = 0.0,
    axle: ArrayLike = 0.0,
) -> ReducedModel:
    """Return the dynamics of two wheels on one axle, in nu = (v, w): speed of its midpoint, and yaw rate.

    Let b be half the track, r the wheel radius, I_w the spin inertia and (dx, dy) the centre of mass relative
    to the midpoint of the axle. The wheels rotate at (v - b w) / r on the left and (v + b w) / r on the
    right. Then::

        M = [ m + 2 I_w / r^2          -m dy                              ]   n = [ -m dx w^2 ]
            [ -m dy       Icz + m (dx^2 + dy^2) + 2 I_w b^2 / r^2         ]       [ m dx v w  ]

        B tau = ( tau_R + tau_L, b (tau_R - tau_L) ) / r

    The equations follow R. Dhaouadi and A. Abu Hatab, "Dynamic modelling of differential-drive mobile robots
    using Lagrange and Newton-Euler methodologies: a unified framework", Advances in Robotics and Automation
    2(2), 2013. The centre of mass may also lie off the centre line.

    Parameters
    ----------
    nu : array_like, shape (..., 2)
        Speed and yaw rate [m/s, rad/s].
    mass, yaw_inertia : array_like, shape (...)
        Mass [kg], and moment of inertia about the vertical axis through the centre of mass [kg m^2].
    com : array_like, shape (..., 2)
        Centre of mass in the body frame [m].
    track, radius : array_like, shape (...)
        Distance between the wheels, and wheel radius [m].
    spin_inertia : array_like, shape (...)
        Moment of inertia of each wheel about its axle [kg m^2].
    axle : array_like, shape (...)
        Position x of the axle in the body frame [m].

    Returns
    -------
    ReducedModel
        Model with the torques of the left and the right wheel as inputs [N m].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, or a value is not finite or not in its range.
    NotFinite
        If the result overflows.

    See Also
    --------
    WheelTable.differential : wheels of this drive
    derivation.differential_drive : symbolic derivation of this model

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import closed_form
    >>> M, n, B = closed_form.differential_drive(
    ...     [1, 0], mass=30, yaw_inertia=1.3, track=0.4, radius=0.1
    ... )
    >>> np.linalg.solve(M, B @ [1.5, 1.5] - n)  # [m/s^2, rad/s^2]
    array([1., 0.])
    """
    body = {"mass": mass, "yaw_inertia": yaw_inertia, "com": com, "track": track, "radius": radius}
    numbers, answer = _arguments(**body, spin_inertia=spin_inertia, axle=axle, nu=nu)
    m, inertia, dx, dy, track, r, spin, position, v, w = numbers
    b, dx = bounded("track", track, above=0) / 2, dx - position
    M = _matrix(
        [m + 2 * spin / r**2, -m * dy], [-m * dy, inertia + m * (dx**2 + dy**2) + 2 * spin * (b / r) ** 2]
    )
    B = _matrix([1 / r, 1 / r], [-b / r, b / r])
    return ReducedModel(*map(answer, (M, _stack(-m * dx * w**2, m * dx * v * w), B)))


@_no_warnings
def roller_drive(
    twist: ArrayLike,
    *,
    mass: ArrayLike,
    yaw_inertia: ArrayLike,
    com: ArrayLike = (0, 0),
    x: ArrayLike,
    y: ArrayLike,
    angle: ArrayLike,
    roller: ArrayLike,
    radius: ArrayLike,
    spin_inertia: ArrayLike = 0.0,
) -> ReducedModel:
    """Return the dynamics of fixed wheels with rollers (mecanum or omni), in the body twist (vx, vy, w).

    Consider a wheel at (x, y) that rolls in the direction delta, with its roller at the ground along
    delta + gamma. Its rate is the product of the twist and the row ( cos(delta + gamma), sin(delta + gamma),
    x sin(delta + gamma) - y cos(delta + gamma) ) / (r cos gamma) of J. Then::

        (M_b + J' diag(I_w) J) u' + c(u) = J' tau       [ m     0    -m yc                   ]
                                                  M_b = [ 0     m     m xc                   ]
                                                        [ -m yc m xc  Icz + m (xc^2 + yc^2)  ]

        c(u) = m w ( -vy - xc w,  vx - yc w,  xc vx + yc vy )

    J follows P. F. Muir and C. P. Neuman, "Kinematic modeling of wheeled mobile robots", Journal of Robotic
    Systems 4(2), 1987.

    Parameters
    ----------
    twist : array_like, shape (..., 3)
        Forward velocity, left velocity, yaw rate [m/s, m/s, rad/s].
    mass, yaw_inertia : array_like, shape (...)
        Mass [kg], and moment of inertia about the vertical axis through the centre of mass [kg m^2].
    com : array_like, shape (..., 2)
        Centre of mass in the body frame [m].
    x, y, angle : array_like, shape (..., wheels)
        Position of each wheel [m, m], and angle of its rolling direction from the body's x axis [rad].
    roller : array_like, shape (..., wheels)
        Angle of the roller's axis at the ground from the rolling direction, within (-pi/2, pi/2) [rad].
    radius, spin_inertia : array_like, shape (..., wheels) or (...)
        Radius [m] and moment of inertia about the axle [kg m^2], for each wheel or for all.

    Returns
    -------
    ReducedModel
        Model with the torques of the wheels as inputs [N m].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, or a value is not finite or not in its range.
    NotFinite
        If the result overflows.

    See Also
    --------
    WheelTable.mecanum : wheels of such a drive
    derivation.roller_drive : symbolic derivation of this model

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import closed_form
    >>> x, y = [0.2, 0.2, -0.2, -0.2], [0.2, -0.2, 0.2, -0.2]
    >>> roller = np.array([-1, 1, 1, -1]) * np.pi / 4  # mecanum
    >>> M, n, B = closed_form.roller_drive([0, 0, 0], mass=40,
    ...     yaw_inertia=1, x=x, y=y, angle=0, roller=roller, radius=0.1)
    >>> np.linalg.solve(M, B @ [-1, 1, 1, -1])[1]  # left [m/s^2]
    np.float64(1.0)
    """
    body = {"mass": mass, "yaw_inertia": yaw_inertia, "com": com, "twist": twist}
    wheels = {"x": x, "y": y, "angle": angle, "roller": roller, "radius": radius}
    (m, inertia, xc, yc, vx, vy, w), check_body = _arguments(**body)
    (px, py, delta, gamma, r, spin), check_wheels = _arguments(**wheels, spin_inertia=spin_inertia)
    shaped("x", px, ("...", "k"), words=", one number for each wheel")
    broadcast(twist=m[..., None], x=px)
    c, s = np.cos(delta + gamma), np.sin(delta + gamma)
    J = np.stack([c, s, px * s - py * c], axis=-1) / (r * np.cos(gamma))[..., None]
    zero = np.zeros_like(m)
    M = _matrix([m, zero, -m * yc], [zero, m, m * xc], [-m * yc, m * xc, inertia + m * (xc**2 + yc**2)])
    spin_matrix = np.einsum("...ki,...k,...kj->...ij", J, spin, J)
    n = (m * w)[..., None] * np.stack([-vy - xc * w, vx - yc * w, xc * vx + yc * vy], axis=-1)
    return ReducedModel(check_wheels(M + spin_matrix), check_body(n), check_wheels(np.swapaxes(J, -1, -2)))


@_no_warnings
def car(
    nu: ArrayLike,
    steering: ArrayLike,
    *,
    mass: ArrayLike,
    yaw_inertia: ArrayLike,
    com: ArrayLike = (0, 0),
    wheelbase: ArrayLike,
    radius: ArrayLike,
    track: ArrayLike = 0.0,
    spin_inertia: ArrayLike = 0.0,
    steered_inertia: ArrayLike = 0.0,
) -> ReducedModel:
    """Return the dynamics of a car in nu = (v, delta'): speed of the rear axle's midpoint, and steering rate.

    The origin of the body frame lies at the midpoint of the rear axle with its two wheels. The front axle
    with two steered wheels is at the distance L. Ackermann's law makes all axles intersect: cot delta_i = cot
    delta - y_i / L at y_i = -+b, half the track. With T = tan delta, w = v T / L, g_i = d delta_i / d delta =
    1 / (sin^2 delta + (cos delta - y_i sin delta / L)^2), and g_i' = d g_i / d delta::

        M11 = m (1 - 2 yc T / L) + (Icz + m (xc^2 + yc^2)) T^2 / L^2
              + 2 I_w / r^2 (1 + 1 / cos^2 delta + 2 b^2 T^2 / L^2)
        M12 = I_z T / L sum g_i                        M22 = I_z sum g_i^2
        n1 = dM11 / ddelta v delta' / 2 + I_z T / L sum g_i' delta'^2
        n2 = I_z v delta' / (L cos^2 delta) sum g_i + I_z sum g_i g_i' delta'^2

        B tau = ( tau_rear / r + tau_front sum k_i / (2 r), tau_steering )
        k_i = sqrt((1 - y_i T / L)^2 + T^2)

    For a track of zero, g_i = 1 and k_i = 1 / cos delta: the two wheels of each axle coincide, and the model
    is a bicycle with wheels of twice the inertia. The term M12 couples both motions: the steering torque
    accelerates the car, and driving turns the steered wheels. The model is valid at every angle below pi/2,
    for steered wheels with their centres on their pivots. With a trail, masses and inertias would depend on
    the angle.

    Parameters
    ----------
    nu : array_like, shape (..., 2)
        Speed and steering rate [m/s, rad/s].
    steering : array_like, shape (...)
        Angle delta of a virtual wheel at the midpoint of the front axle, within (-pi/2, pi/2) [rad].
    mass, yaw_inertia : array_like, shape (...)
        Mass [kg], and moment of inertia about the vertical axis through the centre of mass [kg m^2].
    com : array_like, shape (..., 2)
        Centre of mass in the body frame [m].
    wheelbase, radius, track : array_like, shape (...)
        Distance between the axles, wheel radius, and distance between the wheels of an axle [m].
    spin_inertia, steered_inertia : array_like, shape (...)
        Moments of inertia of each wheel about its axle, and of each front wheel about the vertical [kg m^2].

    Returns
    -------
    ReducedModel
        Model with three torques as inputs [N m]: rear axle and front axle, each split equally between its
        wheels (an open differential), and steering.

    Raises
    ------
    InvalidArgument
        If a shape does not fit, or a value is not finite or not in its range.
    NotFinite
        If the result overflows.

    See Also
    --------
    WheelTable.car : wheels of this drive
    derivation.car : symbolic derivation of this model

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import closed_form
    >>> M, n, B = closed_form.car([1, 0], 0.0, mass=1000, wheelbase=2.5,
    ...     yaw_inertia=1300, radius=0.3, steered_inertia=1)
    >>> np.linalg.solve(M, B @ [300, 0, 0] - n)  # [m/s^2, rad/s^2]
    array([1., 0.])
    """
    body = {"mass": mass, "yaw_inertia": yaw_inertia, "com": com, "wheelbase": wheelbase, "radius": radius}
    wheels = {"track": track, "spin_inertia": spin_inertia, "steered_inertia": steered_inertia}
    numbers, answer = _arguments(**body, **wheels, steering=steering, nu=nu)
    m, inertia, xc, yc, L, r, track, spin, steered, delta, v, rate = numbers
    b, c, s = track / 2, np.cos(delta), np.sin(delta)
    T, turn = s / (c * L), 1 / (L * c * c)  # w = T v, and d T / d delta
    J = inertia + m * (xc**2 + yc**2)
    ratio, slope, factors = np.zeros((2, *m.shape)), np.zeros((2, *m.shape)), np.zeros((2, *m.shape))
    for k, y in enumerate((b, -b)):
        lateral = c - y * s / L
        ratio[k] = 1 / (s**2 + lateral**2)
        slope[k] = -2 * (s * c - lateral * (s + y * c / L)) * ratio[k] ** 2
        factors[k] = np.hypot(1 - y * T, T * L)
    M11 = m * (1 - 2 * yc * T) + J * T**2 + 2 * spin / r**2 * (1 + 1 / c**2 + 2 * (b * T) ** 2)
    M12 = steered * T * ratio.sum(0)
    half = (-m * yc + J * T + 2 * spin / r**2 * (L**2 + 2 * b**2) * T) * turn  # half the derivative of M11
    n = _stack(
        half * v * rate + steered * T * slope.sum(0) * rate**2,
        steered * (turn * ratio.sum(0) * v * rate + (ratio * slope).sum(0) * rate**2),
    )
    zero, one = np.zeros_like(m), np.ones_like(m)
    M = _matrix([M11, M12], [M12, steered * (ratio**2).sum(0)])
    B = _matrix([1 / r, factors.sum(0) / (2 * r), zero], [zero, zero, one])
    return ReducedModel(*map(answer, (M, n, B)))


def _matrix(*rows: list[Array]) -> Array:
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
