"""Integrators: one step of the plant with zero-order hold of the input.

A step is called as ``step(acceleration, t, q, v, dt) -> (q, v)`` with ``acceleration(t, q, v)``. q, v and the
acceleration have shape (..., n), t [s] and dt [s] are numbers. Any callable of this form is an integrator.
`rk4` is the classical Runge-Kutta method (order 4), `constant_acceleration` the lecture's step and
`semi_implicit_euler` symplectic Euler (order 1).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

import numpy as np

from pinmobile.arrays import Array, callable_as
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.parts import option, part

#: Acceleration, shape (..., n), as a function of time [s], configuration and velocity.
Acceleration: TypeAlias = Callable[[float, Array, Array], Array]


class Integrator(Protocol):
    """A step of time: a callable ``integrator(acceleration, t, q, v, dt) -> (q, v)``.

    See Also
    --------
    rk4 : classical Runge-Kutta method
    integrators.RungeKuttaNystrom : family of methods
    simulate : its argument `integrator`

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> def midpoint(acceleration, t, q, v, dt):
    ...     half = v + dt / 2 * acceleration(t, q, v)
    ...     a = acceleration(t + dt / 2, q + dt / 2 * v, half)
    ...     return q + dt * half, v + dt * a
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=1.0))
    >>> run = simulate(robot, PD(120, 120), path, dt=0.1,
    ...                integrator=midpoint)
    >>> print(f"{1e3 * max(run.max_error()):.1f} mm")
    4.7 mm
    """

    def __call__(
        self, acceleration: Acceleration, t: float, q: Array, v: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return configuration and velocity after a step.

        Parameters
        ----------
        acceleration : callable
            ``acceleration(t, q, v)``, shape (..., n).
        t : float
            Time at the start of the step [s].
        q, v : ndarray, shape (..., n)
            State at the start.
        dt : float
            Length of the step [s].

        Returns
        -------
        q, v : ndarray, shape (..., n)
            State at the end of the step.
        """


_EXPECTED = "an integrator, such as pinmobile.rk4"


def check_integrator(integrator: object) -> None:
    """Check that an object is an integrator.

    Parameters
    ----------
    integrator : object
        The object.

    Raises
    ------
    InvalidArgument
        If it is a controller, or not callable as ``(acceleration, t, q, v, dt)``.

    See Also
    --------
    integrators.Integrator : protocol of integrators

    Examples
    --------
    >>> from pinmobile import rk4
    >>> from pinmobile.integrators import check_integrator
    >>> check_integrator(rk4)
    >>> check_integrator(lambda t, q, v: v)
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: integrator is ...
    """
    if hasattr(integrator, "initial_state"):
        raise InvalidArgument(f"integrator is {format_value(integrator)}, a controller, expected {_EXPECTED}")
    callable_as("integrator(acceleration, t, q, v, dt)", integrator, _EXPECTED)


@part
class RungeKuttaNystrom:
    """Explicit Runge-Kutta-Nystrom method, defined by a table of coefficients.

    With the accelerations a_j of the earlier stages, stage i evaluates the acceleration at::

        t + c_i h,    q + c_i h v + h^2 sum_j A_ij a_j,    v + h sum_j B_ij a_j

    and the step ends at q + h v + h^2 sum_j r_j a_j and v + h sum_j s_j a_j.

    Parameters
    ----------
    name : str
        Name of the method.
    nodes : tuple of float
        c, for s stages; the first is 0.
    stages_q, stages_v : tuple of tuples of float
        A and B; row i has i - 1 entries.
    weights_q, weights_v : tuple of float
        r and s.

    See Also
    --------
    rk4 : classical Runge-Kutta method, of order 4
    integrators.constant_acceleration : the lecture's step
    integrators.semi_implicit_euler : symplectic Euler

    References
    ----------
    Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 1993, section II.14.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import rk4
    >>> from pinmobile.integrators import semi_implicit_euler
    >>> def spring(t, q, v):
    ...     return -q
    >>> for step in semi_implicit_euler, rk4:  # cos(0.5) = 0.87758
    ...     q, v = step(spring, 0.0, np.ones(1), np.zeros(1), 0.5)
    ...     print(f"{step}: {q[0]:.5f}")
    semi_implicit_euler: 0.75000
    rk4: 0.87760
    """

    name: str = option(doc="name of the method")
    nodes: tuple[float, ...] = option(doc="c, for s stages; the first is 0")
    stages_q: tuple[tuple[float, ...], ...] = option(doc="A; row i has i - 1 entries")
    stages_v: tuple[tuple[float, ...], ...] = option(doc="B; row i has i - 1 entries")
    weights_q: tuple[float, ...] = option(doc="r")
    weights_v: tuple[float, ...] = option(doc="s")

    def __call__(
        self, acceleration: Acceleration, t: float, q: Array, v: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return configuration and velocity after a step, shape (..., n).

        Parameters
        ----------
        acceleration : callable
            ``acceleration(t, q, v)``, shape (..., n).
        t : float
            Time at the start of the step [s].
        q, v : ndarray, shape (..., n)
            State at the start.
        dt : float
            Length of the step [s].
        """

        def acceleration_at(t: float, x: Array, v: Array) -> Array:
            return acceleration(t, q + x, v)

        x, v = self.displaced(acceleration_at, acceleration(t, q, v), t, v, dt)
        return q + x, v

    def displaced(
        self, acceleration: Acceleration, first: Array, t: float, v: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return the displacement in a step, and the velocity after it, shape (..., n).

        Parameters
        ----------
        acceleration : callable
            Acceleration as a function of time, displacement and velocity.
        first : ndarray, shape (..., n)
            Acceleration at the start.
        t, v, dt : float, ndarray, float
            Time [s] and velocity at the start, and length of the step [s].
        """
        if len(self.nodes) == 1 and type(v) is np.ndarray and v.ndim == 1:
            # For a few numbers, Python floats are twice as fast, with the same bits.
            a, b = self.weights_q[0] * dt * dt, self.weights_v[0] * dt
            pairs = zip(v.tolist(), first.tolist(), strict=True)
            x, w = zip(*[(dt * rate + a * gain, rate + b * gain) for rate, gain in pairs], strict=True)
            return np.array(x), np.array(w)
        stages = [first]
        for c, by_q, by_v in zip(self.nodes[1:], self.stages_q[1:], self.stages_v[1:], strict=True):
            stages.append(acceleration(t + c * dt, *_advance(v, c * dt, dt, by_q, by_v, stages)))
        return _advance(v, dt, dt, self.weights_q, self.weights_v, stages)

    def __repr__(self) -> str:
        return self.name


def _advance(
    v: Array,
    time: float,
    dt: float,
    by_q: tuple[float, ...],
    by_v: tuple[float, ...],
    accelerations: list[Array],
) -> tuple[Array, Array]:
    """Return displacement and velocity from weighted accelerations."""
    x, w = time * v, v
    for i, a in enumerate(accelerations):
        if by_q[i]:
            x = x + (by_q[i] * dt * dt) * a
        if by_v[i]:
            w = w + (by_v[i] * dt) * a
    return x, w


constant_acceleration = RungeKuttaNystrom("constant_acceleration", (0.0,), ((),), ((),), (1 / 2,), (1.0,))
"""The lecture's step, exact for constant acceleration: q+ = q + h v + h^2 / 2 a, v+ = v + h a. Order 1."""

semi_implicit_euler = RungeKuttaNystrom("semi_implicit_euler", (0.0,), ((),), ((),), (1.0,), (1.0,))
"""Symplectic Euler: the new velocity moves the configuration, q+ = q + h v+. Order 1."""

rk4 = RungeKuttaNystrom(
    "rk4",
    (0.0, 1 / 2, 1 / 2, 1.0),
    ((), (0.0,), (1 / 4, 0.0), (0.0, 1 / 2, 0.0)),
    ((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)),
    (1 / 6, 1 / 6, 1 / 6, 0.0),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
)
"""The classical Runge-Kutta method for (q, v) (Hairer, Norsett and Wanner, table II.1.2). Order 4."""
