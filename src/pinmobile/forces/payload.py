"""`Payload`: a load that a robot picks up, or puts down, in the middle of a run."""

from __future__ import annotations

from typing import Any, Protocol, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.forces.force import since, spread
from pinmobile.parts import array, number, part


class Carried(Protocol):
    """A force that is also a mass: what it does depends on how the body accelerates.

    It is called as any force is, for what it does at a constant velocity; loops add what its mass does.
    The plant must be one that an integrator brings on, its first coordinates x, y and psi of the body.
    """

    def inertia(self, t: float, q: Array, /) -> Array:
        """Return the mass matrix that it adds to the body, shape (..., 3, 3) [kg, kg m, kg m^2].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q : ndarray, shape (..., 3)
            Pose of the body [m, m, rad].
        """

    def __call__(self, t: float, q: Array, v: Array, /) -> Array:
        """Return (Fx, Fy, Mz) where the body does not accelerate, shape (..., 3) [N, N, N m]."""


@final
@part
class Payload:
    """A load on the body from a time on, which then moves with it.

    The velocity is continuous: the load comes at the velocity of the place where it is put. One that is put
    down at rest would slow the robot by a share of mass / (robot's mass + mass), a jump that no force makes.
    It changes inertia alone: what it weighs is not felt by wheels, tip-over margins and friction.

    With m, (x, y) and I below, and the body at psi, r = psi', it adds to the body's mass matrix and forces::

        [[m, 0, -m k1], [0, m, m k2], [-m k1, m k2, I + m (x^2 + y^2)]]     (m k2 r^2, m k1 r^2, 0)

    with ``k1 = y cos psi + x sin psi`` and ``k2 = x cos psi - y sin psi``, as the closed form of a body does.
    """

    mass: float = number(lower=0, unit="kg", doc="mass of the payload")
    at: Any = array(
        shapes=((2,),), unit="m", labels=("x", "y"), doc="position of the payload, forward and left"
    )
    when: float = number(unit="s", doc="time from which the payload is on the body")
    yaw_inertia: float = number(
        default=0.0, lower=0, unit="kg m^2", doc="yaw inertia of the payload about its own centre of mass"
    )

    def _lever(self, pose: Array) -> tuple[Array, Array]:
        """Return k1 and k2 of the class, shape (...) [m]."""
        x, y = self.at[..., 0], self.at[..., 1]
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        return y * cos + x * sin, x * cos - y * sin

    def inertia(self, t: ArrayLike, q: Array) -> Array:
        """Return the mass matrix that it adds to the body, shape (..., 3, 3) [kg, kg m, kg m^2].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q : ndarray, shape (..., 3)
            Pose of the body [m, m, rad].
        """
        x, y = self.at[..., 0], self.at[..., 1]
        k1, k2 = self._lever(q)
        here = since(t, self.when) + 0.0 * k1
        m = here * self.mass
        izz = here * self.yaw_inertia + m * (x * x + y * y)
        rows = [[m, 0.0 * m, -m * k1], [0.0 * m, m, m * k2], [-m * k1, m * k2, izz]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return what it does beside its mass matrix, shape (..., 3) [N, N, N m]."""
        k1, k2 = self._lever(q)
        size = since(t, self.when) * self.mass * v[..., 2] ** 2
        return spread(np.stack([size * k2, size * k1, 0.0 * size * k1], axis=-1), t, q)
