"""The equations of motion derived by hand: of the lecture's body, and of drives whose wheels roll."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, finite, finite_answer, shaped, vector
from pinmobile.errors import InvalidArgument

Numbers: TypeAlias = Array | float
"""A parameter of all bodies, or one for each, shape (...)."""

_SIZES = {"q": 3, "v": 3, "a": 3, "tau": 3, "twist": 3, "nu": 2, "com": 2}
_COMPONENTS = "twist", "nu", "com"  # whose numbers the formulas take one by one
_POSITIVE = "mass", "yaw_inertia", "wheelbase", "radius"
_NOT_NEGATIVE = "track", "spin_inertia", "steered_inertia"
_ACUTE = "steering", "roller"
_quietly = np.errstate(over="ignore", invalid="ignore", divide="ignore")  # what looks at its answer itself


def _arguments(**given: ArrayLike) -> tuple[list[Array], Callable[[Array], Array]]:
    """Return arguments by what their names ask for, numbers in one shape, and the check of an answer.

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or not in its range.
    """
    checked, parts, shapes = dict[str, Array](), list[Array](), dict[str, tuple[int, ...]]()
    for name, value in given.items():
        x = vector(name, value, _SIZES[name]) if name in _SIZES else finite(name, value)
        if name in _POSITIVE:
            bounded(name, x, above=0)
        elif name in _NOT_NEGATIVE:
            bounded(name, x, least=0)
        elif name in _ACUTE:
            bounded(name, x, above=-np.pi / 2, below=np.pi / 2, unit="rad")
        checked[name] = x
        shapes[name] = x.shape[:-1] if name in _SIZES else x.shape
    lead = _broadcast(shapes)
    for name, x in checked.items():
        numbers = np.moveaxis(x, -1, 0) if name in _COMPONENTS else [x]
        states = name in _SIZES and name not in _COMPONENTS
        parts += [x] if states else [np.array(np.broadcast_to(each, lead)) for each in numbers]
    return parts, partial(finite_answer, **checked)


def _broadcast(shapes: dict[str, tuple[int, ...]]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        listed = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise InvalidArgument(f"leading shapes are {listed}, expected shapes that broadcast") from None


def _turned(q: Array, x: Numbers, y: Numbers) -> tuple[Array, Array]:
    """Return d, the centre of mass (x, y) of the body frame along the inertial axes, each of shape (...)."""
    c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
    return x * c - y * s, x * s + y * c


def _stacked(*columns: ArrayLike) -> Array:
    """Return columns of shape (...), broadcast, as one array of shape (..., columns)."""
    return np.stack(np.broadcast_arrays(*map(np.asarray, columns)), axis=-1)


@_quietly
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
    numbers, answer = _arguments(q=q, mass=mass, yaw_inertia=yaw_inertia, com=com)
    return answer(unchecked_mass_matrix(*numbers))


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


@_quietly
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
    numbers, answer = _arguments(q=q, v=v, mass=mass, com=com)
    return answer(unchecked_coriolis_matrix(*numbers))


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


@_quietly
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
    (q, v, m, x, y), answer = _arguments(q=q, v=v, mass=mass, com=com)
    dx, dy = _turned(q, x, y)
    pull = -m * v[..., 2] ** 2
    return answer(_stacked(pull * dx, pull * dy, 0.0))


@_quietly
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
    numbers, answer = _arguments(q=q, v=v, a=a, mass=mass, yaw_inertia=yaw_inertia, com=com)
    return answer(unchecked_inverse_dynamics(*numbers))


@_quietly
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
    numbers, answer = _arguments(q=q, v=v, tau=tau, mass=mass, yaw_inertia=yaw_inertia, com=com)
    return answer(unchecked_forward_dynamics(*numbers))


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


class ReducedModel(NamedTuple):
    """M nu' + n = B tau in the independent velocities nu.

    Attributes
    ----------
    M : ndarray, shape (..., m, m)
        Mass matrix.
    n : ndarray, shape (..., m)
        Nonlinear effects.
    B : ndarray, shape (..., m, inputs)
        What torques are to nu.
    """

    M: Array
    n: Array
    B: Array


@_quietly
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
    """Return the dynamics of two fixed wheels on one axle, nu = (v, w): speed of its middle, and yaw rate.

    With b half the track, r the radius, I_w the spin inertia, (dx, dy) the centre of mass from the middle of
    the axle, and the rates of the wheels (v - b w) / r on the left and (v + b w) / r on the right::

        M = [ m + 2 I_w / r^2          -m dy                              ]   n = [ -m dx w^2 ]
            [ -m dy       Icz + m (dx^2 + dy^2) + 2 I_w b^2 / r^2         ]       [ m dx v w  ]

        B tau = ( tau_R + tau_L, b (tau_R - tau_L) ) / r

    (R. Dhaouadi and A. Abu Hatab, "Dynamic modelling of differential-drive mobile robots using Lagrange and
    Newton-Euler methodologies: a unified framework", Advances in Robotics and Automation 2(2), 2013, with the
    centre of mass off the middle line too.)

    Parameters
    ----------
    nu : array_like, shape (..., 2)
        [m/s, rad/s].
    mass, yaw_inertia : array_like, shape (...)
        [kg]; about the vertical through the centre of mass [kg m^2].
    com : array_like, shape (..., 2)
        Centre of mass in the body's frame [m].
    track, radius : array_like, shape (...)
        Distance of the wheels; their radius [m].
    spin_inertia : array_like, shape (...)
        Of each wheel [kg m^2].
    axle : array_like, shape (...)
        Its place forward in the body's frame [m].

    Returns
    -------
    model : ReducedModel
        Its torques are those of the left and the right wheel [N m].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or not in its range.
    NotFinite
        If the answer is beyond the numbers that a computer has.
    """
    body = {"mass": mass, "yaw_inertia": yaw_inertia, "com": com, "track": track, "radius": radius}
    numbers, answer = _arguments(**body, spin_inertia=spin_inertia, axle=axle, nu=nu)
    m, inertia, dx, dy, track, r, spin, at, v, w = numbers
    b, dx = bounded("track", track, above=0) / 2, dx - at
    M = _matrix(
        [m + 2 * spin / r**2, -m * dy], [-m * dy, inertia + m * (dx**2 + dy**2) + 2 * spin * (b / r) ** 2]
    )
    B = _matrix([1 / r, 1 / r], [-b / r, b / r])
    return ReducedModel(*map(answer, (M, _stacked(-m * dx * w**2, m * dx * v * w), B)))


@_quietly
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
    """Return the dynamics of fixed wheels with rollers, mecanum or omni, in the body twist (vx, vy, w).

    The rate of a wheel at (x, y) that rolls along the angle delta, its roller at the ground along delta +
    gamma, is the row ( cos(delta + gamma), sin(delta + gamma), x sin(delta + gamma) - y cos(delta + gamma) )
    / (r cos gamma) of J times the twist, and::

        (M_b + J' diag(I_w) J) u' + c(u) = J' tau       [ m     0    -m yc                   ]
                                                  M_b = [ 0     m     m xc                   ]
                                                        [ -m yc m xc  Icz + m (xc^2 + yc^2)  ]

        c(u) = m w ( -vy - xc w,  vx - yc w,  xc vx + yc vy )

    (P. F. Muir and C. P. Neuman, "Kinematic modeling of wheeled mobile robots", Journal of Robotic Systems
    4(2), 1987, for J.)

    Parameters
    ----------
    twist : array_like, shape (..., 3)
        Forward, left, yaw rate [m/s, m/s, rad/s].
    mass, yaw_inertia, com
        As of `differential_drive`.
    x, y, angle : array_like, shape (..., wheels)
        Place of each wheel [m], and angle of its rolling direction from the body's x [rad].
    roller : array_like, shape (..., wheels)
        Angle of the axis of the roller at the ground from the rolling direction, less than a right one [rad].
    radius, spin_inertia : array_like, shape (..., wheels) or (...)
        Of each wheel, or a number for all [m], [kg m^2].

    Returns
    -------
    model : ReducedModel
        Its torques are those of the wheels [N m].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or not in its range.
    NotFinite
        If the answer is beyond the numbers that a computer has.
    """
    body = {"mass": mass, "yaw_inertia": yaw_inertia, "com": com, "twist": twist}
    wheels = {"x": x, "y": y, "angle": angle, "roller": roller, "radius": radius}
    (m, inertia, xc, yc, vx, vy, w), of_body = _arguments(**body)
    (px, py, delta, gamma, r, spin), of_wheels = _arguments(**wheels, spin_inertia=spin_inertia)
    shaped("x", px, ("...", "k"), words=", one number for each wheel")
    _broadcast({"twist": m.shape, "x": px.shape[:-1]})
    c, s = np.cos(delta + gamma), np.sin(delta + gamma)
    J = np.stack([c, s, px * s - py * c], axis=-1) / (r * np.cos(gamma))[..., None]
    zero = np.zeros_like(m)
    M = _matrix([m, zero, -m * yc], [zero, m, m * xc], [-m * yc, m * xc, inertia + m * (xc**2 + yc**2)])
    spun = np.einsum("...ki,...k,...kj->...ij", J, spin, J)
    n = (m * w)[..., None] * np.stack([-vy - xc * w, vx - yc * w, xc * vx + yc * vy], axis=-1)
    return ReducedModel(of_wheels(M + spun), of_body(n), of_wheels(np.swapaxes(J, -1, -2)))


@_quietly
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
    """Return the dynamics of a car, nu = (v, delta'): speed of the rear axle's middle, and steering rate.

    Two wheels on the rear axle, in whose middle the body's origin lies, and two in front at a distance L,
    that Ackermann's law turns so that all axles meet: cot delta_i = cot delta - y_i / L at y_i = -+b, half
    the track. With T = tan delta, w = v T / L, g_i = d delta_i / d delta = 1 / (sin^2 delta + (cos delta -
    y_i sin delta / L)^2), and g_i' = d g_i / d delta::

        M11 = m (1 - 2 yc T / L) + (Icz + m (xc^2 + yc^2)) T^2 / L^2
              + 2 I_w / r^2 (1 + 1 / cos^2 delta + 2 b^2 T^2 / L^2)
        M12 = I_z T / L sum g_i                        M22 = I_z sum g_i^2
        n1 = dM11 / ddelta v delta' / 2 + I_z T / L sum g_i' delta'^2
        n2 = I_z v delta' / (L cos^2 delta) sum g_i + I_z sum g_i g_i' delta'^2

        B tau = ( tau_rear / r + tau_front sum k_i / (2 r), tau_steering )
        k_i = sqrt((1 - y_i T / L)^2 + T^2)

    Without a track g_i = 1 and k_i = 1 / cos delta: the two wheels of an axle stand in one place, and it is a
    bicycle with wheels of twice the inertia. The steering torque pushes the car and driving turns the wheels
    by the same term M12. It holds at every angle below a right one, for steered wheels whose centres lie on
    their pivots: with a trail, masses and moments would depend on the angle.

    Parameters
    ----------
    nu : array_like, shape (..., 2)
        [m/s, rad/s].
    steering : array_like, shape (...)
        Angle delta of a wheel in the middle of the front axle, less than a right one [rad].
    mass, yaw_inertia, com
        As of `differential_drive`.
    wheelbase, radius, track : array_like, shape (...)
        Distance of the axles; radius of the wheels; distance of the two of an axle [m].
    spin_inertia, steered_inertia : array_like, shape (...)
        Of each wheel about its axle, and of each front one about the vertical [kg m^2].

    Returns
    -------
    model : ReducedModel
        Its torques are those on the rear axle and the front one, shared equally by their wheels (an open
        differential), and on the steering [N m].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or not in its range.
    NotFinite
        If the answer is beyond the numbers that a computer has.
    """
    body = {"mass": mass, "yaw_inertia": yaw_inertia, "com": com, "wheelbase": wheelbase, "radius": radius}
    wheels = {"track": track, "spin_inertia": spin_inertia, "steered_inertia": steered_inertia}
    numbers, answer = _arguments(**body, **wheels, steering=steering, nu=nu)
    m, inertia, xc, yc, L, r, track, spin, turned, delta, v, rate = numbers
    b, c, s = track / 2, np.cos(delta), np.sin(delta)
    T, turn = s / (c * L), 1 / (L * c * c)  # w = T v, and d T / d delta
    J = inertia + m * (xc**2 + yc**2)
    ratio, tilt, driven = np.zeros((2, *m.shape)), np.zeros((2, *m.shape)), np.zeros((2, *m.shape))
    for k, y in enumerate((b, -b)):
        aside = c - y * s / L
        ratio[k] = 1 / (s**2 + aside**2)
        tilt[k] = -2 * (s * c - aside * (s + y * c / L)) * ratio[k] ** 2
        driven[k] = np.hypot(1 - y * T, T * L)
    M11 = m * (1 - 2 * yc * T) + J * T**2 + 2 * spin / r**2 * (1 + 1 / c**2 + 2 * (b * T) ** 2)
    M12 = turned * T * ratio.sum(0)
    half = (-m * yc + J * T + 2 * spin / r**2 * (L**2 + 2 * b**2) * T) * turn  # of the derivative of M11
    n = _stacked(
        half * v * rate + turned * T * tilt.sum(0) * rate**2,
        turned * (turn * ratio.sum(0) * v * rate + (ratio * tilt).sum(0) * rate**2),
    )
    zero, one = np.zeros_like(m), np.ones_like(m)
    M = _matrix([M11, M12], [M12, turned * (ratio**2).sum(0)])
    B = _matrix([1 / r, driven.sum(0) / (2 * r), zero], [zero, zero, one])
    return ReducedModel(*map(answer, (M, n, B)))


def _matrix(*rows: list[Array]) -> Array:
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
