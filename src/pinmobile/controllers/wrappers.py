"""Wrappers of controllers: limits, delay, noise, allocation and disturbance observers.

Each wraps a controller and is a controller. They nest in any order: the outermost one receives the
measurement first and returns the input last.
"""

from __future__ import annotations

import math
from hashlib import sha256
from typing import Any, final, overload

import attrs
import numpy as np

from pinmobile.arrays import Array, ArrayLike, check_integer, frozen, shaped
from pinmobile.compiled import has_symbols, leaves, map_leaves
from pinmobile.controllers.controller import (
    ContextView,
    Controller,
    State,
    Wrapper,
    check_wheels,
    evaluate,
    notify_applied,
)
from pinmobile.controllers.feedback import check_wheelless, coordinates_of
from pinmobile.controllers.kinematic_laws import (
    LAW,
    KinematicLaw,
    has_axle,
    reference_of,
    reference_speeds,
    value_of,
)
from pinmobile.controllers.lqr import check_gains
from pinmobile.parts import (
    Allocating,
    Integrating,
    Observable,
    child,
    each,
    integer,
    option,
    part,
    require,
    structure,
)
from pinmobile.plant import Context, inputs_of, reference_sizes_of, stated
from pinmobile.signals import signals_of


def _robot_of(controller: Any) -> Any:
    """Return the model of a controller, or of the controller that it wraps."""
    robot = stated(controller, "robot")
    while robot is None and stated(controller, "controller") is not None:
        controller = controller.controller
        robot = stated(controller, "robot")
    return robot


@final
@part
class DisturbanceObserver(Wrapper):
    """Wrapper that estimates the disturbing force from the generalised momentum, and subtracts it.

    ::

        r = gain (p - p(0) - integral of (tau + C' v - g + r)),   p = M(q) v

    (De Luca and Mattone, 2003). The estimate r follows an unmodelled force with the rate `gain`, and
    converges to a constant force; tau is the applied force, after all limits. For a wrong mass it acts as
    integral action does. The loop oscillates with a gain above 0.2 / dt, or above 1 / (3 delay).

    Parameters
    ----------
    controller : controller
        Wrapped controller, such as `ComputedTorque`.
    robot : MobileRobot, optional
        Model of the momentum; default: the wrapped controller's.
    gain : array_like, shape () or (n,)
        Rate of the estimate, > 0 [1/s].

    Raises
    ------
    InvalidArgument
        If `controller` is not a controller, `gain` is not above zero, or the robot has wheels; at the start
        of a run, if the estimate is unstable at its time step.

    See Also
    --------
    PID : integral action in the law itself
    ADRC : law that estimates the disturbing acceleration
    MPC : law with the same observer

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, ConstantForce
    >>> from pinmobile import DisturbanceObserver, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law = DisturbanceObserver(ComputedTorque(robot))
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, law, path, dt=0.02,
    ...                forces=[ConstantForce([9.0, 0.0, 0.0])])
    >>> run.signals["disturbance"].values[-1].round(1)  # [N, N, N m]
    array([9., 0., 0.])
    """

    controller: Any = child(Controller, doc="wrapped controller")
    robot: Any = child(
        Observable,
        default=attrs.Factory(lambda self: _robot_of(self.controller), takes_self=True),
        doc="model of the momentum",
    )
    gain: Any = each(default=10.0, above=0.0, unit="1/s", doc="rate of the estimate", size=coordinates_of)

    def check(self) -> None:
        """Raise `InvalidArgument` if the wrapped object is not a controller, or the robot has wheels."""
        super().check()
        check_wheelless(self)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the wrapped controller's state, the observer's memory, and the time step.

        The memory of the observer is (begun, integral, last input, estimate).
        """
        check_gains(lambda: {"gain": self.gain}, lambda dt: 1.0 - dt * self.gain[..., None, None], context.dt)
        zeros = np.zeros(self.robot.nv)
        return self.controller.initial_state(context), (0.0, zeros, zeros, zeros), float(context.dt)

    def applied(self, u: Array, state: tuple[Any, ...], shift: Array | None = None) -> tuple[Any, ...]:
        """Return the next state for the applied force; the wrapped controller receives its own share."""
        inner, (is_ready, integral, law_input, estimate), dt = state
        inner = notify_applied(self.controller, u + estimate, inner, shift)
        return inner, (is_ready, integral + dt * (u - law_input), u, estimate), dt

    def signals(self, state: tuple[Any, ...]) -> dict[str, Any]:
        """Return the estimated disturbance [N, N m] beside the signals of the wrapped controller."""
        return {**super().signals(state), "disturbance": ("N, N m", state[1][3])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, ...]
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the generalised force, shape (..., n), and the next state."""
        inner, (is_ready, integral, _, _), dt = state
        estimate, integral, rate = estimate_force(self.robot, self.gain, q, v, is_ready, integral)
        tau, inner = evaluate(self.controller, t, q, v, reference, inner)
        tau = tau - estimate
        return tau, (inner, (1.0, integral + dt * (tau + rate), tau, estimate), dt)


def estimate_force(
    robot: Any, gain: Any, q: Array, v: Array, is_ready: Any, integral: Array
) -> tuple[Array, Array, Array]:
    """Return the estimated force, its integral, and the integral's rate without the applied force.

    Parameters
    ----------
    robot : MobileRobot
        The model.
    gain : array_like, shape () or (n,)
        Rate of the estimate [1/s].
    q, v : ndarray, shape (..., n)
        State.
    is_ready, integral : ndarray
        1 after the first sample, else 0; and p(0) plus the integral so far.
    """
    gravity = robot.gravity(q)
    momentum = robot.inverse_dynamics(q, np.zeros(np.shape(v)), v) - gravity
    integral = np.where(is_ready > 0.0, integral, momentum)
    estimate = gain * (momentum - integral)
    coriolis = np.sum(robot.coriolis_matrix(q, v) * v[..., :, None], axis=-2)
    return estimate, integral, coriolis - gravity + estimate


def _inertia_at_rest(controller: Any) -> Array:
    """Return the diagonal of the mass matrix in the reference configuration, shape (n,)."""
    check_wheelless(controller)
    robot = controller.robot
    if stated(robot, "mass_matrix") is None:
        require("robot", robot, Observable)
    return np.diagonal(robot.mass_matrix(robot.rest))


@final
@part
class ADRC:
    """Active disturbance rejection control: each coordinate is a double integrator with an observer.

    ::

        tau = b (a_d + w_c^2 (q_d - z1) + 2 w_c (v_d - z2) - z3)

    A discrete observer with three poles at exp(-w_o dt) estimates configuration z1, velocity z2 and the
    remaining acceleration z3 from q and the applied force. It needs no model except b, and no measured
    velocity: this helps if the measured velocity is noisy (Han, 2009; Gao, 2003).

    Parameters
    ----------
    robot : MobileRobot
        Robot that compares and integrates configurations; its mass matrix at rest is the default of b.
    bandwidth : array_like, shape () or (n,)
        w_c, > 0 [1/s].
    observer : array_like, shape () or (n,)
        w_o, > 0, usually 3 to 10 times w_c [1/s].
    inertia : array_like, shape () or (n,), optional
        b, > 0 [kg, kg m^2]; default: the diagonal of M at rest.

    Raises
    ------
    InvalidArgument
        If a parameter is not above zero or has another shape, or the robot has wheels; at the start of a run,
        if the sampled loop is unstable.

    See Also
    --------
    DisturbanceObserver : observer for any controller with a model
    PID : integral action

    Examples
    --------
    >>> from pinmobile import ADRC, Circle, ConstantForce
    >>> from pinmobile import MobileRobot, Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, ADRC(robot), path, dt=0.02,
    ...                forces=[ConstantForce([9.0, 0.0, 0.0])])
    >>> estimate = run.signals["disturbance"].values[-1]
    >>> print(f"{estimate[0]:.2f} m/s^2 for 9 N on 30 kg")
    0.30 m/s^2 for 9 N on 30 kg
    """

    robot: Any = child(
        Integrating, doc="robot that compares and integrates configurations", expected="a MobileRobot"
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
        """Raise `InvalidArgument` if the robot has wheels."""
        check_wheelless(self)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return (begun, prediction, last input, estimate, time step)."""
        names = ("bandwidth", "observer")
        check_gains(lambda: {name: getattr(self, name) for name in names}, self._loop, context.dt)
        zeros = np.zeros(self.robot.nv)
        q = np.zeros(self.robot.nq)
        return 0.0, (q, zeros, zeros), zeros, zeros, float(context.dt)

    def _gains(self, dt: float) -> tuple[Any, Any, Any]:
        """Return the three gains of the observer for a time step [s]."""
        pole = np.exp(-dt * self.observer)
        decay = 1.0 - pole
        return 1.0 - pole**3, 1.5 * decay * decay * (1.0 + pole) / dt, decay * decay * decay / (dt * dt)

    def _loop(self, dt: float) -> Array:
        """Return the matrix of an error x, dx/dt and of the prediction, shape (..., 5, 5)."""
        w, gains = self.bandwidth, np.stack(self._gains(dt), axis=-1)
        z = np.zeros((*w.shape, 3, 5))  # z1, z2, z3 after the sample, by (x, x', z)
        z[..., 0] = gains
        z[..., 2:] = np.eye(3)
        z[..., 2] -= gains
        force = -(w * w)[..., None] * z[..., 0, :] - (2 * w)[..., None] * z[..., 1, :] - z[..., 2, :]
        transition = np.array([[1.0, dt, dt * dt / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
        input_gain = np.array([dt * dt / 2, dt])
        input_effect = input_gain[:, None] * force[..., None, :]
        body = transition[:2, :2] @ np.eye(2, 5) + input_effect
        prediction = transition @ z
        prediction[..., :2, :] += input_effect
        return np.concatenate([body, prediction], axis=-2)

    def applied(self, u: Array, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the state with the prediction for the applied input, shape (..., n)."""
        is_ready, (z1, z2, z3), law_input, estimate, dt = state
        a = (u - law_input) / self.inertia
        return is_ready, (self.robot.integrate(z1, (0.5 * dt * dt) * a), z2 + dt * a, z3), u, estimate, dt

    def signals(self, state: tuple[Any, ...]) -> dict[str, Any]:
        """Return the estimated acceleration that the input does not cause [m/s^2, rad/s^2]."""
        return {"disturbance": ("m/s^2, rad/s^2", state[3])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, ...]
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the generalised force, shape (..., n), and the next state; `v` is not used."""
        is_ready, (z1, z2, z3), _, _, dt = state
        robot, w = self.robot, self.bandwidth
        z1 = np.where(is_ready > 0.0, z1, q)
        z2 = np.where(is_ready > 0.0, z2, reference.v)
        innovation, (l1, l2, l3) = robot.difference(z1, q), self._gains(dt)
        z1, z2, z3 = robot.integrate(z1, l1 * innovation), z2 + l2 * innovation, z3 + l3 * innovation
        error, rate = robot.difference(z1, reference.q), reference.v - z2
        command = reference.a + w * w * error + 2.0 * w * rate - z3
        tau = self.inertia * command
        a = command + z3
        prediction = robot.integrate(z1, dt * z2 + (0.5 * dt * dt) * a), z2 + dt * a, z3
        return tau, (1.0, prediction, tau, z3, dt)


def _seed(name: str, value: Any) -> Any:
    """Return a seed after a check that it is a whole number >= 0 or a SeedSequence."""
    if isinstance(value, np.random.SeedSequence):
        return value
    return check_integer(name, value, least=0, most=math.inf)


@final
@part
class InputSaturation(Wrapper):
    """Wrapper that limits the input, as motors do.

    Parameters
    ----------
    controller : controller
        Wrapped controller.
    limits : array_like, shape () or (n,)
        Largest magnitude of each input [N, N, N m], above zero; infinite where there is no limit, as in
        `MobileRobot.effort_limit`.

    Raises
    ------
    InvalidArgument
        If `controller` is not a controller, or `limits` has another shape or an entry that is not above zero.

    See Also
    --------
    MPC : law that plans within limits
    Motor : limits of real motors

    Examples
    --------
    >>> from pinmobile import PD, Circle, InputSaturation
    >>> from pinmobile import MobileRobot, Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law = InputSaturation(PD(500.0, 100.0), limits=[20, 20, 5])
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, law, path, dt=0.02, v0=[0, 0, 0])
    >>> print(f"at most {run.max_input()[0]:.0f} N")
    at most 20 N
    """

    controller: Any = child(Controller, doc="wrapped controller")
    limits: Any = each(above=0.0, endless=True, unit="N, N, N m", doc="largest force of each coordinate")

    def initial_state(self, context: Context) -> Any:
        """Return the first state of the wrapped controller."""
        return self.controller.initial_state(context)

    def applied(self, u: Array, state: Any, shift: Array | None = None) -> Any:
        """Return the wrapped controller's next state for the applied input, shape (..., n)."""
        return notify_applied(self.controller, u, state, shift)

    def signals(self, state: Any) -> Any:
        """Return the signals of the wrapped controller: name to (unit, value)."""
        return super().signals((state,))

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: Any) -> tuple[Array, Any]:
        """Return the limited input, shape (..., n), and the wrapped controller's next state."""
        tau, state = evaluate(self.controller, t, q, v, reference, state)
        limits = _check_size("limits", self.limits, np.shape(tau)[-1:])
        return np.minimum(np.maximum(tau, -limits), limits), state


@final
@part
class MeasurementDelay(Wrapper):
    """Wrapper that delays the measured state by some samples; the reference is not delayed.

    Before the first delayed measurement, the wrapped controller receives the first one.

    Parameters
    ----------
    controller : controller
        Wrapped controller.
    samples : int
        Delay in samples, >= 0.

    Raises
    ------
    InvalidArgument
        If `controller` is not a controller, or `samples` is not a whole number >= 0.

    See Also
    --------
    MeasurementNoise : noise of the measured state
    plant.Context : its method `delay` serves a controller of your own

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque
    >>> from pinmobile import MeasurementDelay, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law = MeasurementDelay(ComputedTorque(robot), samples=5)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, law, path, dt=0.02)
    >>> print(f"{1e3 * max(run.max_error()):.0f} mm")
    27 mm
    """

    controller: Any = child(Controller, doc="wrapped controller")
    samples: int = integer(doc="delay of the measured state in samples")

    def initial_state(self, context: Context) -> tuple[Any, Any]:
        """Return the first state of the wrapped controller, and an empty delay line."""
        view: Any = ContextView(context, measurement_delay=context.measurement_delay + self.samples)
        return self.controller.initial_state(view), context.delay(self.samples)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any]
    ) -> tuple[Array, tuple[Any, Any]]:
        """Return the input, shape (..., nu), and the next state: the wrapped one and the delay line."""
        inner, line = state
        (old_q, old_v), line = line.push((q, v))
        tau, inner = evaluate(self.controller, t, old_q, old_v, reference, inner)
        return tau, (inner, line)


@final
@part
class InputDelay(Wrapper):
    """Wrapper that delays the input by some samples, as a network or firmware delays commands.

    Until the first delayed input, the robot receives the first one. Observers in the wrapped controller
    receive the input that is applied, not the one that they have just computed. An integral or an estimate
    stops only where a limit changes the delayed input.

    Parameters
    ----------
    controller : controller
        Wrapped controller.
    samples : int
        Delay in samples, >= 0.

    Raises
    ------
    InvalidArgument
        If `controller` is not a controller, or `samples` is not a whole number >= 0.

    See Also
    --------
    MeasurementDelay : delay of the measured state
    identify_velocity : estimates the delay from commands to poses

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque
    >>> from pinmobile import MobileRobot, Tangent, simulate
    >>> from pinmobile.controllers import InputDelay
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law = InputDelay(ComputedTorque(robot), samples=5)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, law, path, dt=0.02, q0=[0, 0.1, 0])
    >>> bool((run.u[:6] == run.u[0]).all())  # the first input
    True
    """

    controller: Any = child(Controller, doc="wrapped controller")
    samples: int = integer(doc="delay of the input in samples")

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the first state of the wrapped controller, an empty delay line, and no shift."""
        shift = np.zeros(len(context.inputs))
        return self.controller.initial_state(context), context.delay(self.samples), shift

    def applied(self, u: Array, state: tuple[Any, ...], shift: Array | None = None) -> tuple[Any, ...]:
        """Return the next state; the shift that is passed on covers this delay and those outside."""
        inner, line, own = state
        total = own if shift is None else own + shift
        return notify_applied(self.controller, u, inner, total), line, own

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, ...]
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the input, shape (..., nu), and the next state: the wrapped one, delay line and shift."""
        tau, inner = evaluate(self.controller, t, q, v, reference, state[0])
        (old,), line = state[1].push((tau,))
        return old, (inner, line, tau - old)


@final
@part
class MeasurementNoise(Wrapper):
    """Wrapper that adds white Gaussian noise to the measured state.

    The noise of sample k depends only on the seed and on k. Therefore a repeated run has the same noise, in
    every engine (see `plant.Context`). If q and v have leading axes, all states get the same noise; in an
    ensemble each robot has its own. The noise of q is a displacement, which the plant's ``integrate`` adds to
    q.

    Parameters
    ----------
    controller : controller
        Wrapped controller.
    std_q, std_v : array_like, shape () or (n,)
        Standard deviation of each coordinate [m, m, rad, ...] and velocity [m/s, m/s, rad/s, ...], >= 0; n is
        the robot's nv: 3 plus the degrees of freedom of its arms.
    seed : int or SeedSequence
        Seed of the noise. In an ensemble, the noise of each robot follows from this seed and the ensemble's.

    Raises
    ------
    InvalidArgument
        If `controller` is not a controller; a standard deviation has another shape, is not finite or is below
        zero; or `seed` is something else, such as a Generator, which would not be repeatable.

    See Also
    --------
    MeasurementDelay : delay of the measured state
    forces.NoiseForce : disturbing force with a limited bandwidth

    Examples
    --------
    >>> from pinmobile import PD, Circle, MeasurementNoise
    >>> from pinmobile import MobileRobot, Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law = MeasurementNoise(PD(120.0, 120.0), 0.01, 0.0, seed=1)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, law, path, dt=0.02)
    >>> print(f"{1e3 * max(run.max_error()):.0f} mm")
    7 mm
    """

    controller: Any = child(Controller, doc="wrapped controller")
    std_q: Any = each(lower=0.0, unit="m, m, rad", doc="standard deviation of the measured q")
    std_v: Any = each(lower=0.0, unit="m/s, m/s, rad/s", doc="standard deviation of the measured v")
    seed: Any = option(doc="seed of the noise", check=_seed)

    @property
    def _name(self) -> str:
        """Name of the noise: it differs for each seed, and for each of several nested wrappers."""
        depth, inner = 0, self.controller
        while inner is not None:
            depth += isinstance(inner, MeasurementNoise)
            inner = getattr(inner, "controller", None)
        sequence = (
            self.seed if isinstance(self.seed, np.random.SeedSequence) else np.random.SeedSequence(self.seed)
        )
        return f"measurement {depth} {sha256(sequence.generate_state(4).tobytes()).hexdigest()[:16]}"

    def initial_state(self, context: Context) -> tuple[Any, Any, Any]:
        """Return the first state of the wrapped controller, the noise, and the plant's ``integrate``."""
        noise = context.noise(self._name, 2 * context.nv)
        return self.controller.initial_state(context), noise, context.integrate

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any]
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the input, shape (..., nu), and the next state: the wrapped one and the noise."""
        inner, noise, integrate = state
        n = np.shape(v)[-1]
        std_q, std_v = _check_size("std_q", self.std_q, (n,)), _check_size("std_v", self.std_v, (n,))
        numbers, noise = noise.draw()
        noisy = integrate(q, std_q * numbers[..., :n]), v + std_v * numbers[..., n:]
        tau, inner = evaluate(self.controller, t, *noisy, reference, inner)
        return tau, (inner, noise, integrate)


def _check_size(name: str, value: ArrayLike, size: tuple[int, ...]) -> Array:
    """Return a parameter after a check that its size is the number of coordinates."""
    return shaped(name, np.asarray(value), (), ("...", *size))


@final
@part
class ControlAllocation(Wrapper):
    """Wrapper that turns a force on body and arms, such as the output of `PD`, into torques of wheels.

    The wrapped controller receives pose, arms and their velocities, as for a robot without wheels. Its
    output, a force on x, y, psi and the arms, becomes the minimum-norm torques that move the robot as this
    force would. If a torque exceeds its limit, one factor scales all of them, see
    `WheeledRobot.allocate_scaled`. The signal ``residual`` records the part of the force that the wheels
    cannot exert, such as a force across the axle.

    For a drive with one fixed axle, the reference must move along its wheels, as for `Backstepping`. A
    reference that moves sideways, or whose heading jumps, raises an error with the time at the start of a
    run.

    Parameters
    ----------
    controller : controller
        Wrapped controller of body and arms.
    robot : WheeledRobot
        Controller model of the allocation.

    Raises
    ------
    InvalidArgument
        If `controller` is not a controller, or `robot` is not a robot on wheels with a motor for each
        independent velocity; at the start of a run, if the wheels cannot follow the reference.

    See Also
    --------
    WheeledRobot : its method `allocate_scaled`
    Backstepping : torques from a kinematic law
    ComputedTorque : direct law for an omnidirectional drive

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import PD, ControlAllocation, MobileRobot
    >>> from pinmobile import Reference, WheeledRobot, WheelTable
    >>> from pinmobile.plant import Context
    >>> wheels = WheelTable.differential(track=0.4, radius=0.1)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), wheels)
    >>> law = ControlAllocation(PD(kp=120.0, kd=60.0), robot)
    >>> goal = Reference(*np.diag([0.1, 0.0, 0.0]))  # 0.1 m ahead
    >>> memory = law.initial_state(Context.of(robot, dt=0.01))
    >>> q, v = robot.rest, 0 * robot.rest
    >>> law(0.0, q, v, goal, memory)[0]  # 12 N, two wheels [N m]
    array([0.6, 0.6])
    """

    controller: Any = child(Controller, doc="wrapped controller")
    robot: Any = child(Allocating, doc="controller model of the allocation")

    def check(self) -> None:
        """Raise `InvalidArgument` if no controller is wrapped, or the robot has too few motors."""
        super().check()
        check_wheels(self.robot)

    @structure
    def _axle(self) -> Array | None:
        """Coefficients of the axle that references must follow; None for a drive without exactly one axle."""
        return frozen(self.robot.axle) if has_axle(self.robot.mobility) else None

    def initial_state(self, context: Context) -> tuple[Any, Any, Any]:
        """Return the wrapped controller's state, the residual force, and the applied force."""
        reference = reference_of(context)
        if self._axle is not None and reference is not None:
            reference_speeds(self._axle, np.asarray(context.t), reference)
        body = self.robot.robot
        view: Any = ContextView(
            context,
            difference=body.difference,
            integrate=body.integrate,
            nv=body.nv,
            reference_sizes=reference_sizes_of(body),
            coordinates=context.coordinates[: body.nv],
            inputs=inputs_of(body),
        )
        zeros = np.zeros(body.nv)
        return self.controller.initial_state(view), zeros, zeros

    def applied(self, u: Array, state: Any, shift: Array | None = None) -> Any:
        """Return the next state; the wrapped controller receives the force of the wheels, shape (..., n)."""
        return notify_applied(self.controller, state[2], state[0]), *state[1:]

    def signals(self, state: Any) -> dict[str, Any]:
        """Return the residual force [N, N m] beside the signals of the wrapped controller."""
        return {**super().signals(state), "residual": ("N, N m", state[1])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Any
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the torques, shape (..., nu), and the next state."""
        body = self.robot.robot
        body_state = q[..., : body.nq], v[..., : body.nv]
        tau, inner = evaluate(self.controller, t, *body_state, reference, state[0])
        u, residual = self.robot.allocate_scaled(q, tau)
        return u, (inner, residual, tau - residual)


@final
@part
class Sampled:
    """Wrapper that runs a law at every n-th sample of the loop, and holds its output in between.

    It makes a slow outer law around a fast one: ``WheelSpeed(Sampled(UnicycleTracking(), 10), robot)`` tracks
    a path at a tenth of the rate of the wheels. The inner law has its own time step, n dt, in its `Context`:
    times, reference, delays and schedules of the context are those of its own samples. At each of them, it
    receives the measured state and the reference of that instant. In between, its output and memory are
    constant: a `Backstepping` around it takes their rates as zero. Noise of the context is that of the loop's
    samples.

    Parameters
    ----------
    controller : controller or kinematic law
        Law that runs at the slower rate.
    every : int
        Samples of the loop per sample of the law, n >= 1.

    Raises
    ------
    InvalidArgument
        If `every` is not a whole number >= 1.

    See Also
    --------
    MPC : law that is often too slow for each sample
    controllers.WheelSpeed : fast loop around a kinematic law

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import PD, Circle, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> from pinmobile.controllers import Sampled
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(1.0, 0.5, 4.0))
    >>> slow = Sampled(PD(120, 120), every=10)
    >>> run = simulate(robot, slow, path, dt=0.001)
    >>> steps = np.flatnonzero(np.diff(run.u[:, 0])) + 1
    >>> steps[:4]
    array([10, 20, 30, 40])
    """

    controller: Any = child(
        (Controller, KinematicLaw),
        doc="law that runs at the slower rate",
        expected="a controller or " + LAW[2:],
    )
    every: int = integer(default=10, least=1, doc="samples of the loop per sample of the law")

    @property
    def step_samples(self) -> int:
        """Samples of the loop per time step of the law, as `every`, by which other code knows slower laws."""
        return self.every

    def check(self, t: Array, speed: Array, yaw_rate: Array) -> None:
        """Raise `InvalidArgument` for a reference that a kinematic law cannot follow, shape (N,) each."""
        self.controller.check(t, speed, yaw_rate)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the law's state, the held output, the number of samples since, and whether it continues."""
        requests: list[str] = []

        def delay(samples: int) -> Any:
            requests.append("delay")
            return context.delay(samples * self.every)

        def noise(name: str, n: int) -> Any:
            requests.append("noise")
            return context.noise(name, n)

        def schedule(rows: Any) -> Any:
            requests.append("schedule")
            return context.schedule(np.repeat(rows, self.every, axis=0)[: len(context.t)])

        slow: Any = _SlowContext(
            context,
            every=self.every,
            dt=self.every * context.dt,
            t=context.t[:: self.every],
            measurement_delay=-(-context.measurement_delay // self.every),
            delay=delay,
            noise=noise,
            schedule=schedule,
        )
        inner = self.controller.initial_state(slow)
        return inner, 0.0, 0.0, "continues" if requests else ""

    def applied(self, u: Array, state: tuple[Any, ...], shift: Array | None = None) -> tuple[Any, ...]:
        """Return the next state; the law receives the applied input of its own samples, shape (..., nu)."""
        inner, *rest = state
        is_due = rest[1] == 1.0 % self.every  # the law has just run
        return _select_memory(is_due, notify_applied(self.controller, u, inner, shift), inner), *rest

    def applied_late(self, u: Array, shift: Array, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the next state behind a delay of the input, shape (..., nu)."""
        return self.applied(u, state, shift)

    def signals(self, state: tuple[Any, ...]) -> Any:
        """Return the signals of the law: name to (unit, value)."""
        return signals_of(self.controller, state[0])

    @overload
    def __call__(
        self, t: float, q: Array, v: Array, reference: Any, state: Any
    ) -> tuple[Array, tuple[Any, ...]]: ...
    @overload
    def __call__(self, tracked: Any, state: Any, /) -> tuple[tuple[Any, Any], tuple[Any, ...]]: ...
    def __call__(self, *given: Any) -> tuple[Any, tuple[Any, ...]]:  # type: ignore[misc]  # a loop gives no names
        """Return the held output, and the next state; the arguments are those of the law."""
        *arguments, (inner, last_output, count, runs_always) = given
        is_due = count == 0.0
        next_count = np.where(count >= self.every - 1.0, 0.0, count + 1.0)
        if runs_always or has_symbols(is_due) or is_due:
            if len(arguments) > 1:
                t, q, v, reference = arguments
                u, memory = evaluate(self.controller, t, q, v, reference, inner)
            else:  # a kinematic law, whose speeds may have rates: held, they have none
                pair, memory = self.controller(*arguments, inner)
                u = np.stack(np.broadcast_arrays(*map(value_of, pair)), axis=-1)
            last_output, inner = np.where(is_due, u, last_output), _select_memory(is_due, memory, inner)
        output = last_output if len(arguments) > 1 else (last_output[..., 0], last_output[..., 1])
        return output, (inner, last_output, next_count, runs_always)


class _SlowContext(ContextView):
    """Context of a law at each n-th sample."""

    every: int

    @property
    def reference(self) -> Any:
        """Reference at the samples of the law, if it is known."""
        samples = self._context.reference
        return None if samples is None else type(samples)(*(x[:: self.every] for x in samples))


def _select_memory(is_due: Any, new: Any, old: Any) -> Any:
    """Return the new memory where it is due, else the old one; delays, noise and schedules always go on."""
    old_leaves = iter([leaf for _, leaf in leaves(old)])
    return map_leaves(new, lambda leaf: np.where(is_due, leaf, next(old_leaves)))
