"""Parts as a user writes them, for `simulate` and for arrays of robots."""

from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.plant import Context, Coordinate, Input
from tests.parts import Cart


class TwoWheels(Cart):
    """A body on two driven wheels that roll, with names of its own, for one state."""

    coordinates = (
        *(Coordinate("x", "m", rate="vx"), Coordinate("y", "m", rate="vy")),
        Coordinate("psi", "rad", rate="yaw_rate"),
        *(Coordinate("left wheel", "rad"), Coordinate("right wheel", "rad")),
    )
    inputs = (Input("left torque", "N m", -2.0, 2.0), Input("right torque", "N m", -2.0, 2.0))

    def difference(self, q0: Array, q1: Array) -> Array:
        d = q1 - q0
        d[2] = np.mod(d[2] + np.pi, 2 * np.pi) - np.pi  # of one state: it does not broadcast
        return d


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
