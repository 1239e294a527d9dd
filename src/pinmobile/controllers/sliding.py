"""Sliding mode: with a boundary layer, and of second order (super-twisting)."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.controllers.controller import State, combined, passive_torque
from pinmobile.controllers.feedback import SLOPE, OfBody, comparison, coordinates_of
from pinmobile.controllers.lqr import check_held, diagonal, double_integrators
from pinmobile.parts import Passive, child, each, part
from pinmobile.plant import Context

_REACH = "largest acceleration by the switched part"
_LAYER = "half the width of the boundary layer"


@final
@part
class SlidingMode(OfBody):
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

    robot: Any = child(Passive, doc="model of the controller")
    slope: Any = each(default=4.0, above=0.0, unit="1/s", doc=SLOPE, size=coordinates_of)
    damping: Any = each(default=4.0, lower=0.0, unit="1/s", doc="gain of s", size=coordinates_of)
    reach: Any = each(default=3.0, lower=0.0, unit="m/s^2, m/s^2, rad/s^2", doc=_REACH, size=coordinates_of)
    layer: Any = each(default=0.1, above=0.0, unit="m/s, m/s, rad/s", doc=_LAYER, size=coordinates_of)
    difference: Any = comparison()

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""
        names = ("slope", "damping", "reach", "layer")

        def loop(dt: float) -> Array:
            gain = self.damping + self.reach / self.layer
            kp, kd = diagonal(self.slope * gain), diagonal(self.slope + gain)
            return double_integrators(dt, kp, kd, 0 * kp)

        check_held(lambda: {name: getattr(self, name) for name in names}, loop, context.dt)

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        s, velocity, acceleration = combined(self, q, v, reference)
        switched = self.reach * np.minimum(np.maximum(s / self.layer, -1.0), 1.0)
        push = self.damping * s + switched
        return passive_torque(self.robot, q, v, velocity, acceleration + push), None


@final
@part
class SuperTwisting(OfBody):
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
    """

    robot: Any = child(Passive, doc="model of the controller")
    slope: Any = each(default=4.0, above=0.0, unit="1/s", doc=SLOPE, size=coordinates_of)
    k1: Any = each(
        default=3.0,
        lower=0.0,
        unit="sqrt(m/s^3), sqrt(m/s^3), sqrt(rad/s^3)",
        doc="gain of the root",
        size=coordinates_of,
    )
    k2: Any = each(
        default=3.0, lower=0.0, unit="m/s^3, m/s^3, rad/s^3", doc="gain of the integral", size=coordinates_of
    )
    difference: Any = comparison()

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
        s, velocity, acceleration = combined(self, q, v, reference)
        side = np.sign(s)
        push = self.k1 * np.sqrt(np.abs(s)) * side + z
        tau = passive_torque(self.robot, q, v, velocity, acceleration + push)
        gain = dt * (self.k2 * side)
        return tau, (z + gain, gain, tau, dt)
