"""Wrappers of controllers: limits, delay, noise and allocation; observers of disturbances.

Each wraps a controller and is one. They nest in any order; the outer one sees the measurement first, and
the force last.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Any, final

import attrs
import numpy as np

from pinmobile.arrays import Array, ArrayLike, frozen, shaped
from pinmobile.controllers.controller import Controller, Seen, State, Wrapper, answer_of, check_wheels, told
from pinmobile.controllers.feedback import check_wheelless, coordinates_of
from pinmobile.controllers.kinematic_laws import has_axle, reference_of, speeds_along
from pinmobile.controllers.lqr import check_held
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import Allocating, Integrating, Observable, child, each, integer, option, part, structure
from pinmobile.plant import Context, inputs_of, reference_sizes_of


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

    controller: Any = child(Controller, doc="wrapped controller")
    robot: Any = child(
        Observable,
        default=attrs.Factory(lambda self: getattr(self.controller, "robot", None), takes_self=True),
        doc="model by which the momentum is found",
    )
    gain: Any = each(default=10.0, above=0.0, unit="1/s", doc="rate of the estimate", size=coordinates_of)

    def check(self) -> None:
        """Raise `InvalidArgument` where no controller is wrapped, or the robot has wheels."""
        super().check()
        check_wheelless(self)

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
    check_wheelless(controller)
    return np.diagonal(controller.robot.mass_matrix(controller.robot.rest))


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
        check_wheelless(self)

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


def _seed(name: str, value: Any) -> Any:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (isinstance(value, np.random.SeedSequence) or (whole and value >= 0)):
        raise InvalidArgument(f"{name} is {shown(value)}, expected a whole number >= 0 or a SeedSequence")
    return value


@final
@part
class InputSaturation(Wrapper):
    """A controller whose force is limited, as a motor's is.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    limits : array_like, shape () or (n,)
        Largest |tau| of each coordinate [N, N, N m], above zero; infinite where there is no limit, as in
        `MobileRobot.effort_limit`.

    Raises
    ------
    InvalidArgument
        If `controller` is none, or `limits` has another shape, is not finite, or not above zero.
    """

    controller: Any = child(Controller, doc="wrapped controller")
    limits: Any = each(above=0.0, endless=True, unit="N, N, N m", doc="largest force of each coordinate")

    def initial_state(self, context: Context) -> Any:
        """Return the state that the wrapped controller starts with."""
        return self.controller.initial_state(context)

    def applied(self, u: Array, state: Any) -> Any:
        """Return the wrapped controller's state, told of the input that is applied, shape (..., n)."""
        return told(self.controller, u, state)

    def signals(self, state: Any) -> Any:
        """Return what the wrapped controller tells beside its input: name to (unit, value)."""
        return super().signals((state,))

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: Any) -> tuple[Array, Any]:
        """Return the limited force, shape (..., n), and the wrapped controller's next state."""
        tau, state = answer_of(self.controller, t, q, v, reference, state)
        limits = _fitting("limits", self.limits, np.shape(tau)[-1:])
        return np.minimum(np.maximum(tau, -limits), limits), state


@final
@part
class MeasurementDelay(Wrapper):
    """A controller that is told of the state some samples late; of the reference it is told in time.

    Until there are that many, it is told of the first one.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    samples : int
        How many samples late, >= 0.

    Raises
    ------
    InvalidArgument
        If `controller` is none, or `samples` no such number.
    """

    controller: Any = child(Controller, doc="wrapped controller")
    samples: int = integer(doc="samples by which the measured state is late")

    def initial_state(self, context: Context) -> tuple[Any, Any]:
        """Return the state that the wrapped controller starts with, and a line without measurements."""
        late: Any = Seen(context, measurement_delay=context.measurement_delay + self.samples)
        return self.controller.initial_state(late), context.delay(self.samples)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any]
    ) -> tuple[Array, tuple[Any, Any]]:
        """Return the force, shape (..., n), and the next state: the wrapped one, past measurements."""
        inner, line = state
        (old_q, old_v), line = line.push((q, v))
        tau, inner = answer_of(self.controller, t, old_q, old_v, reference, inner)
        return tau, (inner, line)


@final
@part
class MeasurementNoise(Wrapper):
    """A controller that is told of the state with white Gaussian noise added.

    The noise of sample k depends on the seed and k alone, so that a second run gets the same; it is
    `Context.noise`, the same in every engine. Where q and v have leading axes, all of them get the same
    noise, and in an ensemble each robot its own. That of q is a displacement, by which the plant's
    `integrate` moves q.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    std_q, std_v : array_like, shape () or (n,)
        Standard deviation of each coordinate [m, m, rad, ...] and its rate [m/s, m/s, rad/s, ...], >= 0;
        n is the robot's nv: 3 and one for each degree of freedom of its arms.
    seed : int or SeedSequence
        Of the noise. In an ensemble, each robot has numbers of its own, which follow from this seed and the
        ensemble's.

    Raises
    ------
    InvalidArgument
        If `controller` is none, a standard deviation has another shape, is not finite or below zero, or
        `seed` is something else, such as a Generator, which would not repeat.
    """

    controller: Any = child(Controller, doc="wrapped controller")
    std_q: Any = each(lower=0.0, unit="m, m, rad", doc="standard deviation of the measured q")
    std_v: Any = each(lower=0.0, unit="m/s, m/s, rad/s", doc="standard deviation of the measured v")
    seed: Any = option(doc="seed of the noise", check=_seed)

    @property
    def _name(self) -> str:
        """Name of its noise: another for each seed, and for each of several, one in the other."""
        within, inner = 0, self.controller
        while inner is not None:
            within += isinstance(inner, MeasurementNoise)
            inner = getattr(inner, "controller", None)
        sequence = (
            self.seed if isinstance(self.seed, np.random.SeedSequence) else np.random.SeedSequence(self.seed)
        )
        return f"measurement {within} {sha256(sequence.generate_state(4).tobytes()).hexdigest()[:16]}"

    def initial_state(self, context: Context) -> tuple[Any, Any, Any]:
        """Return the state that the wrapped controller starts with, the noise, and how q moves."""
        noise = context.noise(self._name, 2 * context.nv)
        return self.controller.initial_state(context), noise, context.integrate

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any]
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the force, shape (..., n), and the next state: the wrapped one, the noise."""
        inner, noise, integrate = state
        n = np.shape(v)[-1]
        std_q, std_v = _fitting("std_q", self.std_q, (n,)), _fitting("std_v", self.std_v, (n,))
        numbers, noise = noise.draw()
        noisy = integrate(q, std_q * numbers[..., :n]), v + std_v * numbers[..., n:]
        tau, inner = answer_of(self.controller, t, *noisy, reference, inner)
        return tau, (inner, noise, integrate)


def _fitting(name: str, value: ArrayLike, size: tuple[int, ...]) -> Array:
    """Check that a parameter is of this number of coordinates, and return it."""
    return shaped(name, np.asarray(value), (), ("...", *size))


@final
@part
class ControlAllocation(Wrapper):
    """A controller of body and arms, such as `PD`, whose force the wheels are to give.

    It sees what a robot without wheels would be: the pose, the arms and their rates. What it returns, a force
    on x, y, psi and on the arms, becomes the torques of least norm that move the robot as that force would,
    all scaled by one factor where one is beyond its limit, see `WheeledRobot.allocate_scaled`. What of the
    force the wheels do not give, such as one across the axle, is recorded as the signal ``residual``, along
    x, y, psi and the arms.

    Where the drive has one fixed axle the reference moves along its wheels, as that of `Backstepping` does:
    one that moves sideways or whose heading jumps is refused, with its time, when a loop begins.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    robot : WheeledRobot
        The model by which torques are found.

    Raises
    ------
    InvalidArgument
        If `controller` is none, `robot` is none with wheels, or has not a motor for each independent
        velocity.
    """

    controller: Any = child(Controller, doc="wrapped controller")
    robot: Any = child(Allocating, doc="model by which torques are found")

    def check(self) -> None:
        """Raise `InvalidArgument` where no controller is wrapped, or the robot has too few motors."""
        super().check()
        check_wheels(self.robot)

    @structure
    def _axle(self) -> Array | None:
        """The axle of a drive that moves along one alone, which references follow."""
        return frozen(self.robot.axle) if has_axle(self.robot.mobility) else None

    def initial_state(self, context: Context) -> tuple[Any, Any, Any]:
        """Return the state that the wrapped controller starts with, and forces: left, and supplied."""
        reference = reference_of(context)
        if self._axle is not None and reference is not None:
            speeds_along(self._axle, np.asarray(context.t), reference)
        body = self.robot.robot
        own: Any = Seen(
            context,
            difference=body.difference,
            integrate=body.integrate,
            nv=body.nv,
            reference_sizes=reference_sizes_of(body),
            coordinates=context.coordinates[: body.nv],
            inputs=inputs_of(body),
        )
        none = np.zeros(body.nv)
        return self.controller.initial_state(own), none, none

    def applied(self, u: Array, state: Any) -> Any:
        """Return the state, with the wrapped controller told of the force that wheels give, (..., n)."""
        return told(self.controller, state[2], state[0]), *state[1:]

    def signals(self, state: Any) -> dict[str, Any]:
        """Return the force that the wheels do not give, beside what the wrapped controller tells."""
        return {**super().signals(state), "residual": ("N, N m", state[1])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Any
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the torques, shape (..., nu), and the next state."""
        body = self.robot.robot
        own = q[..., : body.nq], v[..., : body.nv]
        tau, inner = answer_of(self.controller, t, *own, reference, state[0])
        u, left = self.robot.allocate_scaled(q, tau)
        return u, (inner, left, tau - left)
