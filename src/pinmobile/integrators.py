"""One step of the plant under a held force.

A step is called as ``step(acceleration, t, q, v, dt) -> (q, v)`` with ``acceleration(t, q, v)``; q, v and
the acceleration have shape (..., n), t [s] and dt [s] are numbers. Any callable of that form will do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from pinmobile.arrays import Array, callable_as
from pinmobile.errors import InvalidArgument, shown

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


@dataclass(frozen=True)
class RungeKuttaNystrom:
    """An explicit Runge-Kutta-Nystrom method: a table.

    With the accelerations a_j of the stages so far, stage i asks for the acceleration at::

        t + c_i h,    q + c_i h v + h^2 sum_j A_ij a_j,    v + h sum_j B_ij a_j

    and the step ends at q + h v + h^2 sum_j r_j a_j and v + h sum_j s_j a_j (Hairer, Norsett, Wanner, Solving
    Ordinary Differential Equations I, 1993, section II.14).

    Parameters
    ----------
    name : str
        Name, for people.
    nodes : tuple of s floats
        The c above; the first is 0.
    stages_q, stages_v : tuple of s tuples of floats
        The A and B above; row i has i - 1 entries.
    weights_q, weights_v : tuple of s floats
        The r and s above.
    """

    name: str
    nodes: tuple[float, ...]
    stages_q: tuple[tuple[float, ...], ...]
    stages_v: tuple[tuple[float, ...], ...]
    weights_q: tuple[float, ...]
    weights_v: tuple[float, ...]

    def __call__(
        self, acceleration: Acceleration, t: float, q: Array, v: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return configuration and velocity, shape (..., n), a time `dt` later."""
        found = [acceleration(t, q, v)]
        for c, by_q, by_v in zip(self.nodes[1:], self.stages_q[1:], self.stages_v[1:], strict=True):
            x, w = _moved(q, v, c * dt, dt, by_q, by_v, found)
            found.append(acceleration(t + c * dt, x, w))
        return _moved(q, v, dt, dt, self.weights_q, self.weights_v, found)

    def __repr__(self) -> str:
        return self.name


def _moved(
    q: Array,
    v: Array,
    time: float,
    dt: float,
    by_q: tuple[float, ...],
    by_v: tuple[float, ...],
    accelerations: list[Array],
) -> tuple[Array, Array]:
    x, w = q + time * v, v
    for weight_q, weight_v, a in zip(by_q, by_v, accelerations, strict=True):
        if weight_q:
            x = x + (weight_q * dt * dt) * a
        if weight_v:
            w = w + (weight_v * dt) * a
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
