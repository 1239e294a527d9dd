"""What can be simulated."""

from typing import Protocol

from pinmobile.arrays import Array

__all__ = ["Plant"]


class Plant(Protocol):
    """What `simulate` needs of a plant; `MobileRobot` is one.

    One with joints that turn about several axes has ``integrate_jacobian(q, dq)`` and ``neutral`` too, as
    `MobileRobot` has: without, all integrators are taken for displacements that change at the velocity.
    """

    @property
    def nq(self) -> int:
        """Size of q."""

    @property
    def nv(self) -> int:
        """Size of v and a."""

    @property
    def nu(self) -> int:
        """Size of the input u."""

    def forward_dynamics(self, q: Array, v: Array, u: Array, /) -> Array:
        """Return the acceleration, shape (nv,)."""

    def integrate(self, q: Array, dq: Array, /) -> Array:
        """Return the configuration that the displacement dq leads to, shape (nq,)."""

    def difference(self, q0: Array, q1: Array, /) -> Array:
        """Return the displacement from q0 to q1, shape (..., nv)."""
