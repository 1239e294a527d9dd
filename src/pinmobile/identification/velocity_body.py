"""`VelocityDynamics`: the law of a robot that takes speeds for commands, for one state, many, or symbols.

It is what a `VelocityRobot` is to loops of any engine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import wrap_angle
from pinmobile.plant import Coordinate, Input

THETA: tuple[tuple[str, str, str], ...] = (
    ("theta_1", "s", "inertia of the speed, over the gain of its loop"),
    ("theta_2", "s", "inertia of the yaw rate, over the gain of its loop"),
    ("theta_3", "s m/rad^2", "what a centre of mass ahead of the axle does to the speed"),
    ("theta_4", "", "command per steady speed: 1, and losses over the gain"),
    ("theta_5", "s/m", "what a centre of mass ahead of the axle does to the yaw rate"),
    ("theta_6", "", "command per steady yaw rate: 1, and losses over the gain"),
)
"""Name, unit and meaning of each of the six parameters."""

ABOVE_ZERO = 0, 1, 3, 5  # without inertia there is no law, and without losses speeds grow by themselves


@final
@dataclass(frozen=True, eq=False)
class VelocityDynamics:
    """A robot that takes speeds for commands, for one state, many, or symbols, unchecked.

    Parameters
    ----------
    theta : ndarray, shape (..., 6)
        As of `VelocityRobot`.
    ahead : scalar or ndarray, shape (...)
        How far the body's origin is ahead of the axle [m].
    accelerations : ndarray, shape (..., 2)
        Largest |u'| and |w'| [m/s^2, rad/s^2].
    inputs : tuple of Input
        As of a plant.
    """

    theta: Any
    ahead: Any
    accelerations: Any
    inputs: tuple[Input, ...]

    nq: ClassVar[int] = 3
    nv: ClassVar[int] = 3
    nu: ClassVar[int] = 2
    broadcasts: ClassVar[bool] = True
    coordinates: ClassVar[tuple[Coordinate, ...]] = (
        Coordinate("x", "m", rate="vx"),
        Coordinate("y", "m", rate="vy"),
        Coordinate("psi", "rad", rate="yaw_rate"),
    )

    @property
    def axle(self) -> Any:
        """Coefficients of the body twist in the velocity across the wheels, shape (..., 3)."""
        ahead = np.asarray(self.ahead)
        return np.stack([0.0 * ahead, 0.0 * ahead + 1.0, -ahead], axis=-1)

    def integrate(self, q: Any, dq: Any) -> Any:
        """Return the configuration that a displacement leads to, shape (..., 3)."""
        return q + dq

    def difference(self, q0: Any, q1: Any) -> Any:
        """Return the displacement from q0 to q1, shape (..., 3)."""
        d = q1 - q0
        return np.stack([d[..., 0], d[..., 1], wrap_angle(d[..., 2])], axis=-1)

    def pose(self, q: Any) -> Any:
        """Return x, y, psi, shape (..., 3)."""
        return q

    def rate(self, q: Any, v: Any) -> Any:
        """Return the rates of x, y, psi, shape (..., 3)."""
        return v

    def independent(self, q: Any, v: Any) -> Any:
        """Return speed along the wheels and yaw rate, shape (..., 2)."""
        speed = np.cos(q[..., 2]) * v[..., 0] + np.sin(q[..., 2]) * v[..., 1]
        return _stacked(speed, v[..., 2])

    def rolling(self, q: Any, nu: Any) -> Any:
        """Return v of a speed and a yaw rate, shape (..., 3)."""
        c, s, u, w = np.cos(q[..., 2]), np.sin(q[..., 2]), nu[..., 0], nu[..., 1]
        aside = self.ahead * w
        return _stacked(u * c - aside * s, u * s + aside * c, w)

    def project(self, q: Any, v: Any) -> Any:
        """Return the velocity that rolling leaves, shape (..., 3)."""
        return self.rolling(q, self.independent(q, v))

    def rates(self, nu: Any, u: Any) -> Any:
        """Return the rates of speed and yaw rate, shape (..., 2)."""
        speed, w = nu[..., 0], nu[..., 1]
        one, two, three, four, five, six = (self.theta[..., k] for k in range(len(THETA)))
        faster = (three * (w * w) - four * speed + u[..., 0]) / one
        turning = (u[..., 1] - five * (speed * w) - six * w) / two
        most = self.accelerations
        return np.minimum(np.maximum(_stacked(faster, turning), -most), most)

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        """Return the acceleration, shape (..., 3); f is none."""
        nu = self.independent(q, v)
        rates, c, s, w = self.rates(nu, u), np.cos(q[..., 2]), np.sin(q[..., 2]), nu[..., 1]
        along = rates[..., 0] - self.ahead * (w * w)
        aside = nu[..., 0] * w + self.ahead * rates[..., 1]
        return _stacked(along * c - aside * s, along * s + aside * c, rates[..., 1])

    def commands(self, q: Any, v: Any, rates: Any) -> Any:
        """Return the input at which speed and yaw rate change as wanted, shape (..., 2)."""
        nu, theta = self.independent(q, v), self.theta
        u, w = nu[..., 0], nu[..., 1]
        ahead = theta[..., 0] * rates[..., 0] - theta[..., 2] * (w * w) + theta[..., 3] * u
        turning = theta[..., 1] * rates[..., 1] + theta[..., 4] * (u * w) + theta[..., 5] * w
        return _stacked(ahead, turning)


def _stacked(*columns: Any) -> Any:
    return np.stack(np.broadcast_arrays(*columns), axis=-1)
