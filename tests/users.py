"""Parts as a user writes them, for `simulate` and for arrays of robots."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from pinmobile.arrays import Array
from pinmobile.plant import Context, Coordinate, Input


class TwoWheels:
    """A body on two driven wheels that roll, q = (x, y, psi, left, right), u = the torques at the wheels."""

    nq, nv, nu = 5, 5, 2
    coordinates = (
        Coordinate("x", "m", rate="vx"),
        Coordinate("y", "m", rate="vy"),
        Coordinate("psi", "rad", rate="yaw_rate"),
        Coordinate("left wheel", "rad"),
        Coordinate("right wheel", "rad"),
    )
    inputs = (Input("left torque", "N m", -2.0, 2.0), Input("right torque", "N m", -2.0, 2.0))
    reference_sizes: ClassVar[Mapping[int, int]] = {3: 3, 5: 5}
    mass, yaw_inertia, spin, radius, track = 20.0, 0.9, 0.02, 0.1, 0.5

    def rolling(self, psi: Any, speed: Any, turn: Any) -> Array:
        """Return all five rates of a body that goes ahead and turns."""
        left, right = ((speed + side * self.track / 2 * turn) / self.radius for side in (-1, 1))
        return np.array([speed * np.cos(psi), speed * np.sin(psi), turn, left, right])

    def project(self, q: Array, v: Array) -> Array:
        return self.rolling(q[2], v[0] * np.cos(q[2]) + v[1] * np.sin(q[2]), v[2])

    def forward_dynamics(self, q: Array, v: Array, u: Array, f: Any = 0.0) -> Array:
        c, s, f = np.cos(q[2]), np.sin(q[2]), f + np.zeros(5)
        left, right = u[0] + f[3], u[1] + f[4]
        push, turning = f[0] * c + f[1] * s, f[2] + self.track / (2 * self.radius) * (right - left)
        a = (push + (left + right) / self.radius) / (self.mass + 2 * self.spin / self.radius**2)
        w = turning / (self.yaw_inertia + self.track**2 * self.spin / (2 * self.radius**2))
        speed = v[0] * c + v[1] * s
        turned: Array = speed * v[2] * np.array([-s, c, 0, 0, 0])
        return self.rolling(q[2], a, w) + turned

    def difference(self, q0: Array, q1: Array) -> Array:
        d = q1 - q0
        d[2] = np.mod(d[2] + np.pi, 2 * np.pi) - np.pi  # of one state: it does not broadcast
        return d

    def integrate(self, q: Array, dq: Array) -> Array:
        return q + dq

    def pose(self, q: Array) -> Array:
        return q[:3]

    def pose_rate(self, q: Array, v: Array) -> Array:
        return v[:3]

    def generalized_force(self, q: Array, wrench: Array) -> Array:
        return np.append(wrench, [0.0, 0.0])

    def start(self, reference: Any) -> tuple[Array, Array]:
        q = np.append(reference.q, [0.0, 0.0])
        return q, self.project(q, np.append(reference.v, [0.0, 0.0]))


class Follower:
    """Wheel torques from the errors along and across the path and of the heading."""

    def initial_state(self, context: Context) -> Any:
        return {"across": 0.0}

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: Any) -> tuple[Array, Any]:
        c, s, e = np.cos(q[2]), np.sin(q[2]), reference.q - q[:3]
        along, across = e[0] * c + e[1] * s, e[1] * c - e[0] * s
        ahead, speed = np.hypot(reference.v[0], reference.v[1]), v[0] * c + v[1] * s
        force = 40 * along + 60 * (ahead - speed)
        moment = 30 * across + 20 * np.sin(e[2]) + 10 * (reference.v[2] - v[2])
        return 0.05 * np.array([force - moment / 0.25, force + moment / 0.25]), {"across": across}

    def signals(self, state: Any) -> dict[str, tuple[str, float]]:
        return {"error across": ("m", state["across"])}
