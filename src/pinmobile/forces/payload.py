"""`Payload`: a load that a robot picks up, or puts down, in the middle of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, Self, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.forces.force import since, spread
from pinmobile.plant import Parameter


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
@dataclass(frozen=True, eq=False)
class Payload:
    """A load on the body from a time on, which then moves with it.

    The velocity is continuous: the load comes at the velocity of the place where it is put. One that is put
    down at rest would slow the robot by a share of mass / (robot's mass + mass), a jump that no force makes.
    It changes inertia alone: what it weighs is not felt by wheels, tip-over margins and friction.

    With m, (x, y) and I below, and the body at psi, r = psi', it adds to the body's mass matrix and forces::

        [[m, 0, -m k1], [0, m, m k2], [-m k1, m k2, I + m (x^2 + y^2)]]     (m k2 r^2, m k1 r^2, 0)

    with ``k1 = y cos psi + x sin psi`` and ``k2 = x cos psi - y sin psi``, as the closed form of a body does.

    Parameters
    ----------
    mass : float
        [kg], not below zero.
    at : array_like, shape (2,)
        Where it is, forward and left of the body's origin [m].
    when : float
        From which time on [s].
    yaw_inertia : float
        About the vertical through its own centre of mass [kg m^2], not below zero.

    Raises
    ------
    InvalidArgument
        If a shape is wrong, a value is not finite, or a mass or inertia is below zero.
    """

    mass: float
    at: ArrayLike
    when: float
    yaw_inertia: float = 0.0

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("payload_mass", "kg", "mass of the payload", 0.0, attribute="mass"),
        Parameter("payload_x", "m", "where the payload is, forward", attribute="at", entry=0),
        Parameter("payload_y", "m", "where the payload is, left", attribute="at", entry=1),
        Parameter("payload_when", "s", "when the payload comes", attribute="when"),
        Parameter("payload_inertia", "kg m^2", "its own yaw inertia", 0.0, attribute="yaw_inertia"),
    )

    def __post_init__(self) -> None:
        at = finite("at", self.at)
        if at.shape != (2,):
            raise InvalidArgument(f"at has shape {at.shape}, expected (2,)")
        object.__setattr__(self, "at", frozen(at))
        object.__setattr__(self, "when", scalar("when", self.when))
        for name in ("mass", "yaw_inertia"):
            value = scalar(name, getattr(self, name))
            if value < 0:
                raise InvalidArgument(f"{name} is {value}, expected >= 0")
            object.__setattr__(self, name, value)

    @classmethod
    def nothing(cls) -> Self:
        """Return the payload that is none, from the start on, which a spread gives its mass."""
        return cls(0.0, (0.0, 0.0), 0.0)

    def _lever(self, pose: Array) -> tuple[Array, Array]:
        """Return k1 and k2 of the class, shape (...) [m]."""
        x, y = np.asarray(self.at)[..., 0], np.asarray(self.at)[..., 1]
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
        x, y = np.asarray(self.at)[..., 0], np.asarray(self.at)[..., 1]
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
