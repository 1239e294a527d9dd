"""One step of the plant under a held force.

A step is called as ``step(acceleration, t, q, v, dt) -> (q, v)`` with ``acceleration(t, q, v)``; q, v and
the acceleration have shape (..., n), t [s] and dt [s] are numbers. Any callable of that form will do.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

import numpy as np

from pinmobile.arrays import Array, callable_as
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import option, part

Acceleration: TypeAlias = Callable[[float, Array, Array], Array]


class Integrator(Protocol):
    """What `simulate` needs of an integrator."""

    def __call__(
        self, acceleration: Acceleration, t: float, q: Array, v: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return configuration and velocity a time `dt` later."""


def check_integrator(integrator: object) -> None:
    """Refuse what is no step.

    Raises
    ------
    InvalidArgument
        If it is a controller, no function, or one that cannot be called as ``(acceleration, t, q, v, dt)``.
    """
    if hasattr(integrator, "initial_state"):
        raise InvalidArgument(
            f"integrator is {shown(integrator)}, a controller, expected one of pinmobile.integrators"
        )
    callable_as(
        "integrator(acceleration, t, q, v, dt)",
        integrator,
        "one of pinmobile.integrators or such a step",
    )


@part
class RungeKuttaNystrom:
    """An explicit Runge-Kutta-Nystrom method: a table.

    With the accelerations a_j of the stages so far, stage i asks for the acceleration at::

        t + c_i h,    q + c_i h v + h^2 sum_j A_ij a_j,    v + h sum_j B_ij a_j

    and the step ends at q + h v + h^2 sum_j r_j a_j and v + h sum_j s_j a_j (Hairer, Norsett, Wanner, Solving
    Ordinary Differential Equations I, 1993, section II.14).
    """

    name: str = option(doc="name, for people")
    nodes: tuple[float, ...] = option(doc="the c above, of s stages; the first is 0")
    stages_q: tuple[tuple[float, ...], ...] = option(doc="the A above; row i has i - 1 entries")
    stages_v: tuple[tuple[float, ...], ...] = option(doc="the B above; row i has i - 1 entries")
    weights_q: tuple[float, ...] = option(doc="the r above")
    weights_v: tuple[float, ...] = option(doc="the s above")

    def __call__(
        self, acceleration: Acceleration, t: float, q: Array, v: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return configuration and velocity, shape (..., n), a time `dt` later."""

        def moved(t: float, x: Array, v: Array) -> Array:
            return acceleration(t, q + x, v)

        x, v = self.displaced(moved, acceleration(t, q, v), t, v, dt)
        return q + x, v

    def displaced(
        self, acceleration: Acceleration, first: Array, t: float, v: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return the displacement in a time `dt`, and the velocity after it, shape (..., n).

        Parameters
        ----------
        acceleration : callable
            Of time, displacement and velocity.
        first : ndarray, shape (..., n)
            The acceleration at the start.
        t, v, dt : float, ndarray, float
            Time [s] and velocity at the start, and the step [s].
        """
        if len(self.nodes) == 1 and type(v) is np.ndarray and v.ndim == 1:
            # Of a few numbers Python's own are twice as fast, and have the same bits.
            a, b = self.weights_q[0] * dt * dt, self.weights_v[0] * dt
            pairs = zip(v.tolist(), first.tolist(), strict=True)
            x, w = zip(*[(dt * rate + a * gain, rate + b * gain) for rate, gain in pairs], strict=True)
            return np.array(x), np.array(w)
        found = [first]
        for c, by_q, by_v in zip(self.nodes[1:], self.stages_q[1:], self.stages_v[1:], strict=True):
            found.append(acceleration(t + c * dt, *_moved(v, c * dt, dt, by_q, by_v, found)))
        return _moved(v, dt, dt, self.weights_q, self.weights_v, found)

    def __repr__(self) -> str:
        return self.name


def _moved(
    v: Array,
    time: float,
    dt: float,
    by_q: tuple[float, ...],
    by_v: tuple[float, ...],
    accelerations: list[Array],
) -> tuple[Array, Array]:
    x, w = time * v, v
    for i, a in enumerate(accelerations):
        if by_q[i]:
            x = x + (by_q[i] * dt * dt) * a
        if by_v[i]:
            w = w + (by_v[i] * dt) * a
    return x, w


constant_acceleration = RungeKuttaNystrom("constant_acceleration", (0.0,), ((),), ((),), (1 / 2,), (1.0,))
"""The lecture's step, exact where the acceleration is constant: q' = q + h v + h^2 / 2 a. Order 1."""

semi_implicit_euler = RungeKuttaNystrom("semi_implicit_euler", (0.0,), ((),), ((),), (1.0,), (1.0,))
"""Symplectic Euler: the new velocity moves the configuration, q' = q + h v'. Order 1."""

rk4 = RungeKuttaNystrom(
    "rk4",
    (0.0, 1 / 2, 1 / 2, 1.0),
    ((), (0.0,), (1 / 4, 0.0), (0.0, 1 / 2, 0.0)),
    ((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)),
    (1 / 6, 1 / 6, 1 / 6, 0.0),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
)
"""The classical Runge-Kutta method on (q, v), its products written out (the same, table II.1.2). Order 4."""
