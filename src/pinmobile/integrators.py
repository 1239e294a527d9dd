"""One step of the plant under a held force.

A step is called as ``step(acceleration, t, q, v, dt) -> (q, v)`` with ``acceleration(t, q, v)``; q, v and
the acceleration have shape (..., n), t [s] and dt [s] are numbers. Any callable of that form will do.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from pinmobile.arrays import Array

__all__ = ["Acceleration", "Integrator", "OneStage", "constant_acceleration", "rk4", "semi_implicit_euler"]

Acceleration: TypeAlias = Callable[[float, Array, Array], Array]


class Integrator(Protocol):
    """What `simulate` needs of an integrator."""

    def __call__(
        self, acceleration: Acceleration, t: float, q: Array, v: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return configuration and velocity a time `dt` later."""


@dataclass(frozen=True)
class OneStage:
    """A step with one acceleration, at its start: v' = v + dt a and q' = q + dt v + w dt^2 a. Order 1.

    Parameters
    ----------
    name : str
        Name, for people.
    weight : float
        The w above.
    """

    name: str
    weight: float

    def __call__(
        self, acceleration: Acceleration, t: float, q: Array, v: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return configuration and velocity a time `dt` later."""
        a = acceleration(t, q, v)
        return q + dt * v + (self.weight * dt * dt) * a, v + dt * a

    def __repr__(self) -> str:
        return self.name


constant_acceleration = OneStage("constant_acceleration", 0.5)
"""The lecture's step: exact where the acceleration is constant."""

semi_implicit_euler = OneStage("semi_implicit_euler", 1.0)
"""Symplectic Euler: the new velocity moves the configuration, q' = q + dt v'."""


def rk4(acceleration: Acceleration, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
    """Return the step of the classical Runge-Kutta method of order 4 on (q, v).

    Parameters
    ----------
    acceleration : callable
        ``acceleration(t, q, v)``, shape (..., n).
    t, dt : float
        Time and step [s].
    q, v : ndarray, shape (..., n)
        Configuration and velocity.

    Returns
    -------
    q, v : ndarray, shape (..., n)
        Configuration and velocity a time `dt` later (Hairer, Norsett, Wanner, Solving Ordinary
        Differential Equations I, 1993, table II.1.2).
    """
    # Arrays of no dimension multiply small arrays twice as fast as numbers do.
    whole, half, sixth, two = np.asarray(dt), np.asarray(dt / 2), np.asarray(dt / 6), _TWO
    middle = t + dt / 2
    a1 = acceleration(t, q, v)
    v2 = v + half * a1
    a2 = acceleration(middle, q + half * v, v2)
    v3 = v + half * a2
    a3 = acceleration(middle, q + half * v2, v3)
    v4 = v + whole * a3
    a4 = acceleration(t + dt, q + whole * v3, v4)
    return q + sixth * (v + two * (v2 + v3) + v4), v + sixth * (a1 + two * (a2 + a3) + a4)


_TWO = np.asarray(2.0)
