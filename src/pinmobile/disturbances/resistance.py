"""Forces that oppose the body's motion along its own axes: viscous friction, rolling resistance."""

from dataclasses import dataclass
from typing import Any, ClassVar, Self, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.disturbances.protocol import not_below_zero, numbers, spread, triple
from pinmobile.errors import InvalidArgument
from pinmobile.plant import Parameter

__all__ = ["RollingResistance", "ViscousFriction"]


@final
@dataclass(frozen=True, eq=False)
class ViscousFriction:
    """Friction in proportion to the body twist (u, v, r): tau = -J(psi) (c * J(psi)^T v).

    Parameters
    ----------
    coefficients : array_like, shape (..., 3)
        The c above: forward, left, yaw [N s/m, N s/m, N m s], not below zero.

    Raises
    ------
    InvalidArgument
        If it has another shape, is not finite, or below zero.
    """

    coefficients: ArrayLike

    parameters: ClassVar[tuple[Parameter, ...]] = tuple(
        Parameter(
            f"viscous_{axis}", unit, f"viscous friction, {axis}", 0.0, attribute="coefficients", entry=k
        )
        for k, (axis, unit) in enumerate((("forward", "N s/m"), ("left", "N s/m"), ("yaw", "N m s")))
    )

    @classmethod
    def nothing(cls) -> Self:
        """Return the force that is none, which a spread gives its size."""
        return cls(np.zeros(3))

    def __post_init__(self) -> None:
        checked = not_below_zero("coefficients", triple("coefficients", self.coefficients))
        object.__setattr__(self, "coefficients", checked)

    @property
    def damping(self) -> Array:
        """What the twist is multiplied by, shape (..., 3) [N s/m, N s/m, N m s]."""
        return np.asarray(self.coefficients)

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        coefficients: Any = self.coefficients
        cos, sin = np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = _turned(cos, -sin, v)
        return spread(_turned(cos, sin, -coefficients * twist), t, q)


@final
@dataclass(frozen=True, eq=False)
class RollingResistance:
    """Rolling resistance: a force of constant size against the body twist, regularised about rest.

    Component i along the body's axes is ``-force_i nu_i / sqrt(nu_i^2 + speed_i^2)`` with the twist nu:
    linear well below `speed`, of size `force` well above it. So it is smooth, and a body on which a smaller
    force acts creeps instead of standing still. About rest it is as stiff as a damper of force / speed: an
    explicit step must be shorter than about 2 mass speed / force.

    Parameters
    ----------
    force : array_like, shape (..., 3)
        Size forward, left and in yaw [N, N, N m], not below zero.
    speed : array_like, shape (), (3,) or (..., 3)
        Where the resistance has reached 71 % of its size [m/s, m/s, rad/s], above zero.

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, a force below zero, or a speed not above it.
    """

    force: ArrayLike
    speed: ArrayLike = 0.01

    parameters: ClassVar[tuple[Parameter, ...]] = (
        *(
            Parameter(f"rolling_{axis}", unit, f"rolling resistance, {axis}", 0.0, attribute="force", entry=k)
            for k, (axis, unit) in enumerate((("forward", "N"), ("left", "N"), ("yaw", "N m")))
        ),
        Parameter(
            "rolling_speed", "m/s, rad/s", "where it has 71 % of its size", 0.0, False, attribute="speed"
        ),
    )

    @classmethod
    def nothing(cls) -> Self:
        """Return the force that is none, which a spread gives its size."""
        return cls(np.zeros(3))

    def __post_init__(self) -> None:
        force = not_below_zero("force", triple("force", self.force))
        speed = numbers("speed", self.speed)
        if speed.ndim and speed.shape[-1] != 3:
            raise InvalidArgument(f"speed has shape {speed.shape}, expected (), (3,) or (..., 3)")
        if not (speed > 0).all():
            raise InvalidArgument(f"speed is {speed.min()}, expected > 0")
        try:
            np.broadcast_shapes(force.shape, speed.shape)
        except ValueError:
            raise InvalidArgument(
                f"force and speed have shapes {force.shape} and {speed.shape}, expected shapes that broadcast"
            ) from None
        object.__setattr__(self, "force", force)
        object.__setattr__(self, "speed", speed)

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        force: Any = self.force
        cos, sin = np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = _turned(cos, -sin, v)
        return spread(_turned(cos, sin, -force * twist / np.hypot(twist, self.speed)), t, q)


def _turned(cos: Array, sin: Array, vector: Array) -> Array:
    """Return the first two components turned by the angle, the third as it is, shape (..., 3)."""
    x, y = vector[..., 0], vector[..., 1]
    along = cos * x - sin * y
    turned = np.empty((*along.shape, 3))
    turned[..., 0] = along
    turned[..., 1] = sin * x + cos * y
    turned[..., 2] = vector[..., 2]
    return turned
