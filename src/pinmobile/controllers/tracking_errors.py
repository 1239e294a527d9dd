"""What laws of one surface share: the combined error, and the torque that keeps a robot passive."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.controllers.controller import State
from pinmobile.errors import InvalidArgument


class Combined(NamedTuple):
    """The error of a state from its reference, combined (Slotine and Li, 1987), each of shape (..., n).

    Attributes
    ----------
    s : ndarray
        e' + slope e, the distance from the surface on which errors vanish by themselves.
    velocity, acceleration : ndarray
        v_r = v_d + slope e and a_r = a_d + slope e'.
    """

    s: Array
    velocity: Array
    acceleration: Array


def combined(law: Any, q: Array, v: Array, reference: State) -> Combined:
    """Return the combined error of a law with `robot`, `slope` and `difference`.

    Raises
    ------
    InvalidArgument
        If state and reference do not fit together.
    """
    for name, actual, desired in (("q", q, reference.q), ("v", v, reference.v)):
        if actual.shape[-1:] != desired.shape[-1:]:
            raise InvalidArgument(f"{name} has shape {actual.shape}, the reference's has {desired.shape}")
    slope, difference = law.slope, law.difference or law.robot.difference
    error, rate = difference(q, reference.q), np.subtract(reference.v, v)
    return Combined(rate + slope * error, reference.v + slope * error, reference.a + slope * rate)


def passive_torque(robot: Any, q: Array, v: Array, velocity: Array, acceleration: Array) -> Array:
    """Return M a_r + C(q, v) v_r + g, shape (..., n), with C of Christoffel's symbols.

    n - g is quadratic in v, and C(q, v) v_r its symmetric bilinear form: at half the sum of both less at half
    their difference.
    """
    forward = robot.inverse_dynamics(q, 0.5 * (v + velocity), acceleration)
    return np.asarray(forward - robot.nonlinear_effects(q, 0.5 * (v - velocity)) + robot.gravity(q))
