"""Sliding mode: with a boundary layer, and of second order (super-twisting)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.controllers.controller import State
from pinmobile.controllers.feedback import gain_parameters
from pinmobile.controllers.held import check_held, diagonal, double_integrators
from pinmobile.controllers.tracking_errors import (
    Dynamics,
    check_model,
    combined,
    each_coordinate,
    passive_torque,
)
from pinmobile.plant import Context, Difference, Parameter

_NEEDS = ("inverse_dynamics", "nonlinear_effects", "gravity")


@final
@dataclass(frozen=True, eq=False)
class SlidingMode:
    """Sliding mode with a boundary layer (Slotine and Li, Applied Nonlinear Control, 1991, chapter 7).

        tau = M (a_r + damping s + reach sat(s / layer)) + C v_r + g,   s = e' + slope e

    Outside the layer a disturbance that accelerates the robot by less than `reach` does not keep s from
    coming to it; inside, the law is feedback with a gain higher by ``reach / layer``. A layer thinner than
    ``2 reach dt`` chatters.

    Parameters
    ----------
    robot : MobileRobot
        The model that the controller believes in; it need not be the one that is simulated.
    slope : array_like, shape () or (n,)
        Rate at which errors vanish on the surface, > 0 [1/s].
    damping : array_like, shape () or (n,)
        Gain of s, >= 0 [1/s].
    reach : array_like, shape () or (n,)
        Largest acceleration by the switched part, >= 0 [m/s^2, rad/s^2].
    layer : array_like, shape () or (n,)
        Half the width of the boundary layer, > 0 [m/s, rad/s].
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own.

    Raises
    ------
    InvalidArgument
        If an argument is something else; at the start of a run, if the loop is unstable at its dt.
    """

    robot: Dynamics
    slope: ArrayLike = 4.0
    damping: ArrayLike = 4.0
    reach: ArrayLike = 3.0
    layer: ArrayLike = 0.1
    difference: Difference | None = None

    parameters: ClassVar[tuple[Parameter, ...]] = (
        *gain_parameters("slope", "1/s"),
        *gain_parameters("damping", "1/s"),
        *gain_parameters("reach", "m/s^2, rad/s^2"),
        *gain_parameters("layer", "m/s, rad/s"),
    )

    def __post_init__(self) -> None:
        n = check_model(self.robot, self.difference, *_NEEDS)
        for name in ("slope", "layer"):
            object.__setattr__(self, name, each_coordinate(name, getattr(self, name), n, above=True))
        for name in ("damping", "reach"):
            object.__setattr__(self, name, each_coordinate(name, getattr(self, name), n))

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""
        names = ("slope", "damping", "reach", "layer")

        def loop(dt: float) -> Array:
            slope, damping, reach, layer = (np.asarray(getattr(self, name)) for name in names)
            gain = damping + reach / layer
            kp, kd = diagonal(slope * gain), diagonal(slope + gain)
            return double_integrators(dt, kp, kd, 0 * kp)

        check_held(lambda: {name: np.asarray(getattr(self, name)) for name in names}, loop, context.dt)

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        robot: Any = self.robot
        s, velocity, acceleration = combined(
            self.difference or robot.difference, np.asarray(self.slope), q, v, reference
        )
        switched = np.asarray(self.reach) * np.minimum(np.maximum(s / np.asarray(self.layer), -1.0), 1.0)
        push = np.asarray(self.damping) * s + switched
        return passive_torque(robot, q, v, velocity, acceleration + push), None


@final
@dataclass(frozen=True, eq=False)
class SuperTwisting:
    """Sliding mode of second order (Levant, 1993): what switches is an integral, so that the force does not.

        tau = M (a_r + k1 sqrt|s| sign(s) + z) + C v_r + g,   z' = k2 sign(s),   s = e' + slope e

    A disturbance per mass whose rate of change is below k2 is rejected, with k1 >= 1.5 sqrt(k2). Sampled, it
    goes on in a cycle whose size is some ``k1 k2 dt``: the price is chatter. What z gains in a sample is
    taken back where the force that is applied is another.

    Parameters
    ----------
    robot : MobileRobot
        The model that the controller believes in; it need not be the one that is simulated.
    slope : array_like, shape () or (n,)
        Rate at which errors vanish on the surface, > 0 [1/s].
    k1, k2 : array_like, shape () or (n,)
        Gains, >= 0 [sqrt(m/s^3), sqrt(rad/s^3)] and [m/s^3, rad/s^3].
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own.

    Raises
    ------
    InvalidArgument
        If an argument is something else.
    """

    robot: Dynamics
    slope: ArrayLike = 4.0
    k1: ArrayLike = 3.0
    k2: ArrayLike = 3.0
    difference: Difference | None = None

    parameters: ClassVar[tuple[Parameter, ...]] = (
        *gain_parameters("slope", "1/s"),
        *gain_parameters("k1"),
        *gain_parameters("k2", "m/s^3, rad/s^3"),
    )

    def __post_init__(self) -> None:
        n = check_model(self.robot, self.difference, *_NEEDS)
        object.__setattr__(self, "slope", each_coordinate("slope", self.slope, n, above=True))
        for name in ("k1", "k2"):
            object.__setattr__(self, name, each_coordinate(name, getattr(self, name), n))

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, float]:
        """Return the integral z, what it gained last, the last force, and the time between samples."""
        none = np.zeros(self.robot.nv)
        return none, none, none, float(context.dt)

    def applied(self, u: Array, state: tuple[Any, Any, Any, float]) -> tuple[Any, Any, Any, float]:
        """Return the state, z without what it gained where the force that is applied is another."""
        z, gain, asked, dt = state
        return z - np.where(u != asked, gain, 0.0), gain, asked, dt

    def signals(self, state: tuple[Any, Any, Any, float]) -> dict[str, Any]:
        """Return the integral: the acceleration that the model lacks."""
        return {"unmodelled": ("m/s^2, rad/s^2", state[0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, float]
    ) -> tuple[Array, tuple[Any, Any, Any, float]]:
        """Return the generalised force, shape (..., n), and the next state."""
        z, _, _, dt = state
        robot: Any = self.robot
        s, velocity, acceleration = combined(
            self.difference or robot.difference, np.asarray(self.slope), q, v, reference
        )
        side = np.sign(s)
        push = np.asarray(self.k1) * np.sqrt(np.abs(s)) * side + z
        tau = passive_torque(robot, q, v, velocity, acceleration + push)
        gain = dt * (np.asarray(self.k2) * side)
        return tau, (z + gain, gain, tau, dt)
