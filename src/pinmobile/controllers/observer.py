"""Observers of what the model lacks: of the momentum, and of an extended state."""

from __future__ import annotations

from typing import Any, final

import attrs
import numpy as np

from pinmobile.arrays import Array
from pinmobile.controllers.controller import State, Wrapper, answer_of, told
from pinmobile.controllers.feedback import check_wheelless, coordinates_of
from pinmobile.controllers.held import check_held
from pinmobile.parts import Controlling, Integrating, Observable, child, each, part
from pinmobile.plant import Context


@final
@part
class DisturbanceObserver(Wrapper):
    """A controller from whose force the disturbance is taken, as the generalised momentum shows it.

        r = gain (p - p(0) - integral of (tau + C' v - g + r)),   p = M(q) v

    (De Luca and Mattone, 2003). r follows a force that is not modelled with the rate `gain`, and is exact for
    constant ones; tau is the force that is applied, after all limits. Against a wrong mass it acts as
    integral action does. A gain above 0.2 / dt, or above a third of one over the delay, rings.

    Parameters
    ----------
    controller : controller
        What is wrapped, such as `ComputedTorque`.
    robot : MobileRobot, optional
        The model by which the momentum is found; by default the wrapped controller's.
    gain : array_like, shape () or (n,)
        Rate of the estimate, > 0 [1/s].

    Raises
    ------
    InvalidArgument
        If an argument is something else; at the start of a run, if the estimate is unstable at its dt.
    """

    controller: Any = child(Controlling, doc="wrapped controller")
    robot: Any = child(
        Observable,
        default=attrs.Factory(lambda self: getattr(self.controller, "robot", None), takes_self=True),
        doc="model by which the momentum is found",
    )
    gain: Any = each(default=10.0, above=0.0, unit="1/s", doc="rate of the estimate", size=coordinates_of)

    def check(self) -> None:
        """Raise `InvalidArgument` where no controller is wrapped, or the robot has wheels."""
        super().check()
        check_wheelless(self.robot)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the wrapped controller's state, its own (begun, integral, last force, estimate), and dt."""
        check_held(
            lambda: {"gain": self.gain},
            lambda dt: 1.0 - dt * self.gain[..., None, None],
            context.dt,
        )
        none = np.zeros(self.robot.nv)
        return self.controller.initial_state(context), (0.0, none, none, none), float(context.dt)

    def applied(self, u: Array, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the state told of the force that is applied; the wrapped controller, of its own part."""
        inner, (begun, integral, asked, estimate), dt = state
        inner = told(self.controller, u + estimate, inner)
        return inner, (begun, integral + dt * (u - asked), u, estimate), dt

    def signals(self, state: tuple[Any, ...]) -> dict[str, Any]:
        """Return the disturbance that is estimated, beside what the wrapped controller tells."""
        return {**super().signals(state), "disturbance": ("N, N m", state[1][3])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, ...]
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the generalised force, shape (..., n), and the next state."""
        inner, (begun, integral, _, _), dt = state
        estimate, integral, rate = estimated(self.robot, self.gain, q, v, begun, integral)
        tau, inner = answer_of(self.controller, t, q, v, reference, inner)
        tau = tau - estimate
        return tau, (inner, (1.0, integral + dt * (tau + rate), tau, estimate), dt)


def estimated(
    robot: Any, gain: Any, q: Array, v: Array, begun: Any, integral: Array
) -> tuple[Array, Array, Array]:
    """Return the force that the momentum shows, its integral, and the rate of that without the force applied.

    Parameters
    ----------
    robot : MobileRobot
        The model.
    gain : array_like, shape () or (n,)
        Rate of the estimate [1/s].
    q, v : ndarray, shape (..., n)
        State.
    begun, integral : ndarray
        Whether there was a sample before, and p(0) with what has been integrated since.
    """
    gravity = robot.gravity(q)
    momentum = robot.inverse_dynamics(q, np.zeros(np.shape(v)), v) - gravity
    integral = np.where(begun > 0.0, integral, momentum)
    estimate = gain * (momentum - integral)
    turning = np.sum(robot.coriolis_matrix(q, v) * v[..., :, None], axis=-2)
    return estimate, integral, turning - gravity + estimate


def _inertia_at_rest(controller: Any) -> Array:
    robot = controller.robot
    check_wheelless(robot)
    return np.diagonal(robot.mass_matrix(robot.rest))


@final
@part
class ADRC:
    """Active disturbance rejection (Han, 2009; Gao, 2003): each coordinate a double integrator, observed.

        tau = b (a_d + w_c^2 (q_d - z1) + 2 w_c (v_d - z2) - z3)

    z1, z2 and z3 are configuration, rate and all other acceleration, by a discrete observer with three poles
    at exp(-w_o dt) that is told the force that is applied. It needs no model but b, and no measured
    velocity: best where that is noisy.

    Parameters
    ----------
    robot : MobileRobot
        Whose configurations it compares and moves; at rest its mass matrix is the default of b.
    bandwidth : array_like, shape () or (n,)
        w_c, > 0 [1/s].
    observer : array_like, shape () or (n,)
        w_o, > 0, some 3 to 10 times w_c [1/s].
    inertia : array_like, shape () or (n,), optional
        b, > 0 [kg, kg m^2]; by default the diagonal of M at rest.

    Raises
    ------
    InvalidArgument
        If an argument is something else; at the start of a run, if the loop is unstable at its dt.
    """

    robot: Any = child(
        Integrating, doc="whose configurations are compared and moved", expected="a MobileRobot"
    )
    bandwidth: Any = each(default=4.0, above=0.0, unit="1/s", doc="w_c", size=coordinates_of)
    observer: Any = each(default=20.0, above=0.0, unit="1/s", doc="w_o", size=coordinates_of)
    inertia: Any = each(
        default=attrs.Factory(_inertia_at_rest, takes_self=True),
        above=0.0,
        unit="kg, kg, kg m^2",
        doc="inertia of each coordinate",
        size=coordinates_of,
    )

    def check(self) -> None:
        """Raise `InvalidArgument` where the robot has wheels."""
        check_wheelless(self.robot)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return whether it has begun, what it expects at the next sample, the last force, and dt."""
        names = ("bandwidth", "observer")
        check_held(lambda: {name: getattr(self, name) for name in names}, self._loop, context.dt)
        none = np.zeros(self.robot.nv)
        place = np.zeros(self.robot.nq)
        return 0.0, (place, none, none), none, none, float(context.dt)

    def _gains(self, dt: float) -> tuple[Any, Any, Any]:
        pole = np.exp(-dt * self.observer)
        off = 1.0 - pole
        return 1.0 - pole**3, 1.5 * off * off * (1.0 + pole) / dt, off * off * off / (dt * dt)

    def _loop(self, dt: float) -> Array:
        """Return the loop of an error x, x', and of what is expected of it, shape (..., 5, 5)."""
        w, gains = self.bandwidth, np.stack(self._gains(dt), axis=-1)
        here = np.zeros((*w.shape, 3, 5))  # z1, z2, z3 after the sample, of (x, x', z)
        here[..., 0] = gains
        here[..., 2:] = np.eye(3)
        here[..., 2] -= gains
        force = -(w * w)[..., None] * here[..., 0, :] - (2 * w)[..., None] * here[..., 1, :] - here[..., 2, :]
        ahead = np.array([[1.0, dt, dt * dt / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
        push = np.array([dt * dt / 2, dt])
        pushed = push[:, None] * force[..., None, :]
        body = ahead[:2, :2] @ np.eye(2, 5) + pushed
        expected = ahead @ here
        expected[..., :2, :] += pushed
        return np.concatenate([body, expected], axis=-2)

    def applied(self, u: Array, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the state, what is expected told of the force that is applied, shape (..., n)."""
        begun, (z1, z2, z3), asked, estimate, dt = state
        a = (u - asked) / self.inertia
        return begun, (self.robot.integrate(z1, (0.5 * dt * dt) * a), z2 + dt * a, z3), u, estimate, dt

    def signals(self, state: tuple[Any, ...]) -> dict[str, Any]:
        """Return all acceleration that the force is not seen to give."""
        return {"disturbance": ("m/s^2, rad/s^2", state[3])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, ...]
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the generalised force, shape (..., n), and the next state; `v` is not looked at."""
        begun, (z1, z2, z3), _, _, dt = state
        robot, w = self.robot, self.bandwidth
        z1 = np.where(begun > 0.0, z1, q)
        z2 = np.where(begun > 0.0, z2, reference.v)
        off, (first, second, third) = robot.difference(z1, q), self._gains(dt)
        z1, z2, z3 = robot.integrate(z1, first * off), z2 + second * off, z3 + third * off
        error, rate = robot.difference(z1, reference.q), reference.v - z2
        command = reference.a + w * w * error + 2.0 * w * rate - z3
        tau = self.inertia * command
        a = command + z3
        ahead = robot.integrate(z1, dt * z2 + (0.5 * dt * dt) * a), z2 + dt * a, z3
        return tau, (1.0, ahead, tau, z3, dt)
