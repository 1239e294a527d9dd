"""`PlanarDynamics`: the dynamics of a body that is pushed in the plane, in NumPy, for one state or many.

It is what a `MobileRobot` without arms is to compiled loops and to loops on arrays, where Pinocchio, which
takes numbers and one state at a time, cannot be called.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import Array, wrap_angle
from pinmobile.closed_form import (
    Numbers,
    unchecked_coriolis_matrix,
    unchecked_forward_dynamics,
    unchecked_inverse_dynamics,
    unchecked_mass_matrix,
)
from pinmobile.plant import Coordinate, Input
from pinmobile.robot.complex_step import linearized


@final
@dataclass(frozen=True, eq=False)
class PlanarDynamics:
    """A body in the plane, by the closed forms of `pinmobile.closed_form`, unchecked.

    Parameters
    ----------
    mass, yaw_inertia, com_x, com_y : float, ndarray or symbols, shape (...)
        Mass [kg], inertia about the vertical through the centre of mass [kg m^2], and centre of mass in the
        body frame [m].
    """

    mass: Numbers
    yaw_inertia: Numbers
    com_x: Numbers = 0.0
    com_y: Numbers = 0.0

    nq: ClassVar[int] = 3
    nv: ClassVar[int] = 3
    nu: ClassVar[int] = 3
    leading: ClassVar[dict[int, int]] = {3: 3}
    coordinates: ClassVar[tuple[Coordinate, ...]] = (
        Coordinate("x", "m", rate="vx"),
        Coordinate("y", "m", rate="vy"),
        Coordinate("psi", "rad", rate="yaw_rate"),
    )
    inputs: ClassVar[tuple[Input, ...]] = (Input("Fx", "N"), Input("Fy", "N"), Input("Mz", "N m"))

    @property
    def _body(self) -> tuple[Numbers, Numbers, Numbers, Numbers]:
        return self.mass, self.yaw_inertia, self.com_x, self.com_y

    def forward_dynamics(self, q: Array, v: Array, u: Array, f: Numbers = 0.0) -> Array:
        """Return the acceleration, shape (..., 3)."""
        return unchecked_forward_dynamics(q, v, u + f, *self._body)

    def mass_matrix(self, q: Array) -> Array:
        """Return M(q), shape (..., 3, 3)."""
        return unchecked_mass_matrix(q, *self._body)

    def coriolis_matrix(self, q: Array, v: Array) -> Array:
        """Return C(q, v), shape (..., 3, 3), with C v = n."""
        return unchecked_coriolis_matrix(q, v, self.mass, self.com_x, self.com_y)

    def kinetic_energy(self, q: Array, v: Array) -> Array:
        """Return v . M(q) v / 2, shape (...)."""
        twice: Array = np.sum(v * self.inverse_dynamics(q, 0.0 * v, v), axis=-1)
        return twice / 2

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Return M(q) a + n(q, v), shape (..., 3)."""
        return unchecked_inverse_dynamics(q, v, a, *self._body)

    def nonlinear_effects(self, q: Array, v: Array) -> Array:
        """Return n(q, v), shape (..., 3)."""
        return unchecked_inverse_dynamics(q, v, np.zeros(np.shape(v)), *self._body)

    def gravity(self, q: Array) -> Array:
        """Return zeros, shape (..., 3): the ground is level."""
        return np.zeros(np.shape(q))

    def linearize_tracked(self, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
        """Return A, shape (..., 6, 6), and B, (..., 6, 3), see `MobileRobot.linearize`."""
        return linearized(self, q, v, u)

    def integrate(self, q: Array, dq: Array) -> Array:
        """Return q + dq."""
        return q + dq

    def difference(self, q0: Array, q1: Array) -> Array:
        """Return q1 - q0, shape (..., 3), with the difference of the heading wrapped."""
        d = q1 - q0
        return np.stack([d[..., 0], d[..., 1], wrap_angle(d[..., 2])], axis=-1)

    def pose(self, q: Array) -> Array:
        """Return q."""
        return q

    def rate(self, q: Array, v: Array) -> Array:
        """Return v."""
        return v

    def effort(self, q: Array, wrench: Array) -> Array:
        """Return the wrench."""
        return wrench

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the reference's configuration and velocity."""
        return reference.q, reference.v
