"""What laws of one surface share: the combined error, and the torque that keeps a robot passive."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen
from pinmobile.controllers.controller import State
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Difference, check_difference, leading_of


class Dynamics(Protocol):
    """What such a law needs of a robot."""

    @property
    def nv(self) -> int:
        """Size of v."""

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Return M(q) a + n(q, v)."""

    def nonlinear_effects(self, q: Array, v: Array) -> Array:
        """Return n(q, v)."""

    def gravity(self, q: Array) -> Array:
        """Return g(q)."""

    def difference(self, q0: Array, q1: Array, /) -> Array:
        """Return the displacement from q0 to q1."""


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


def combined(difference: Difference, slope: Array, q: Array, v: Array, reference: State) -> Combined:
    """Return the combined error; `slope` is of all coordinates, (...), or of each, (..., n) [1/s].

    Raises
    ------
    InvalidArgument
        If state and reference do not fit together.
    """
    for name, actual, desired in (("q", q, reference.q), ("v", v, reference.v)):
        if actual.shape[-1:] != desired.shape[-1:]:
            raise InvalidArgument(f"{name} has shape {actual.shape}, the reference's has {desired.shape}")
    error, rate = difference(q, reference.q), np.subtract(reference.v, v)
    return Combined(rate + slope * error, reference.v + slope * error, reference.a + slope * rate)


def passive_torque(robot: Any, q: Array, v: Array, velocity: Array, acceleration: Array) -> Array:
    """Return M a_r + C(q, v) v_r + g, shape (..., n), with C of Christoffel's symbols.

    n - g is quadratic in v, and C(q, v) v_r its symmetric bilinear form: at half the sum of both less at half
    their difference.
    """
    forward = robot.inverse_dynamics(q, 0.5 * (v + velocity), acceleration)
    return np.asarray(forward - robot.nonlinear_effects(q, 0.5 * (v - velocity)) + robot.gravity(q))


def check_model(robot: object, difference: object, *needs: str) -> int:
    """Check the robot of a controller of pushed bodies and arms, and return its number of coordinates.

    Raises
    ------
    InvalidArgument
        If it is none, has wheels, or cannot compare configurations where `difference` is None.
    """
    lacking = [name for name in needs if not hasattr(robot, name)]
    if isinstance(robot, type) or not isinstance(getattr(robot, "nv", None), int) or lacking:
        what = f", which has no {lacking[0]}" if lacking and hasattr(robot, "nv") else ""
        raise InvalidArgument(f"robot is {shown(robot)}{what}, expected a MobileRobot")
    nv: int = robot.nv  # type: ignore[attr-defined]
    if max(leading_of(robot)) < nv:
        raise InvalidArgument(
            f"robot is {shown(robot)}, which has wheels, expected the body on them, robot.robot, and the "
            "controller in Allocated(..., robot)"
        )
    if difference is not None:
        check_difference(difference)
    elif not hasattr(robot, "difference"):
        raise InvalidArgument(
            f"robot is {shown(robot)}, which has no difference(q0, q1), expected one, or to be told how "
            "configurations are compared: difference=planar_difference"
        )
    return nv


def each_coordinate(name: str, value: ArrayLike, n: int, *, above: bool = False) -> Array:
    """Check a gain of all coordinates, shape (), or of each, (n,), and return that of each, frozen.

    Parameters
    ----------
    name : str
        Of the argument.
    value : array_like
        The gain, >= 0.
    n : int
        Number of coordinates.
    above : bool
        Whether it must be above 0.

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    gain = finite(name, value)
    if gain.shape not in ((), (n,)):
        raise InvalidArgument(f"{name} has shape {gain.shape}, expected () or ({n},)")
    if not ((gain > 0) if above else (gain >= 0)).all():
        raise InvalidArgument(f"{name} is {gain.min():g}, expected {'>' if above else '>='} 0")
    return frozen(np.broadcast_to(gain, n))
