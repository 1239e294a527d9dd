"""Feedback laws: PD, computed torque, PID, sliding mode and super-twisting."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, endless_or_finite, finite, frozen, real, shaped
from pinmobile.controllers.controller import AntiWindup, State, combined_error, is_equal_input, passive_torque
from pinmobile.controllers.lqr import check_gains, diagonal, double_integrators
from pinmobile.errors import InvalidArgument, format_value, unexpected_value
from pinmobile.parts import (
    Comparing,
    Gravitating,
    Inverted,
    Invertible,
    Passive,
    able,
    child,
    each,
    gain,
    option,
    part,
)
from pinmobile.plant import Context, Difference, check_difference, full_configurations, reference_sizes_of

SLOPE = "decay rate of errors on the surface s = 0"
"""Meaning of the field `slope`."""

_BASE = 3  # coordinates of the base: x, y, psi
_POSITION_UNITS, _VELOCITY_UNITS = "N/m, N/m, N m/rad", "N s/m, N s/m, N m s/rad"


def coordinates_of(controller: Any) -> int:
    """Return the number of coordinates of the controller model."""
    return int(controller.robot.nv)


def tracked_coordinates_of(controller: Any) -> int:
    """Return the number of coordinates that a controller tracks: all of its model except those of wheels."""
    return max(reference_sizes_of(controller.robot))


def comparison() -> Any:
    """Declare the field `difference`; default: the difference of the plant or of the controller model."""

    def check(name: str, value: Any) -> Any:
        check_difference(value)
        return value

    return option(default=None, doc="difference(q0, q1), the displacement from q0 to q1", check=check)


def bound(sign: float, doc: str, default: Any = None) -> Any:
    """Declare bounds of numbers: lower bounds, possibly -infinity, for sign -1; upper bounds for sign 1."""

    def check(name: str, value: Any) -> Any:
        return frozen(sign * endless_or_finite(name, sign * real(name, value)))

    return option(default=default, doc=doc, check=check)


def check_comparison(controller: Any) -> None:
    """Check that a controller or its model has a `difference`.

    Raises
    ------
    InvalidArgument
        If neither has one.
    """
    if controller.difference is None and not able(controller.robot, Comparing):
        raise InvalidArgument(
            f"robot is {format_value(controller.robot)}, which has no difference(q0, q1), "
            "expected one, or the argument difference of the controller: difference=planar_difference"
        )


def check_wheelless(controller: Any) -> None:
    """Check that the model of a controller of base and arms has no wheels.

    Raises
    ------
    InvalidArgument
        If the model has wheels; the message gives the replacement.
    """
    robot = controller.robot
    if max(reference_sizes_of(robot)) < robot.nv:
        raise InvalidArgument(
            f"robot is {format_value(robot)}, which has wheels, expected the body on them: "
            f"ControlAllocation({type(controller).__name__}(robot.robot, ...), robot)"
        )


class BodyLaw:
    """Base class of controllers whose model is a base with arms, and which compare configurations."""

    robot: Any
    difference: Any

    def check(self) -> None:
        """Raise `InvalidArgument` if the robot has wheels, or if nothing compares its configurations."""
        check_comparison(self)
        check_wheelless(self)


@final
@part
class PD:
    """Proportional-derivative control (lecture, section 4): tau = Kp e + Kd de/dt, e = difference(q, q_d).

    Parameters
    ----------
    kp, kd : array_like, shape (), (n,) or (n, n)
        Proportional gain [N/m, N m/rad] and derivative gain [N s/m, N m s/rad]: a scalar, one value per
        coordinate, or a matrix.
    difference : callable, optional
        ``difference(q0, q1)``: displacement from q0 to q1; default: the plant's. The lecture uses
        `controllers.plain_difference`.

    Raises
    ------
    InvalidArgument
        If a gain is not finite or has another shape, or `difference` is not such a function.

    See Also
    --------
    PDGravity : PD with gravity compensation, for arms
    ComputedTorque : feedback of the same errors through a dynamic model
    PID : computed torque with an integral

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, PD(kp=120.0, kd=120.0), path, dt=0.01)
    >>> print(f"{1e3 * max(run.max_error()):.1f} mm")
    6.8 mm
    """

    kp: Any = gain(lower=0.0, unit=_POSITION_UNITS, doc="proportional gain")
    kd: Any = gain(lower=0.0, unit=_VELOCITY_UNITS, doc="derivative gain")
    difference: Any = comparison()

    def initial_state(self, context: Context) -> Difference:
        """Return the function that compares configurations; default: the plant's."""
        return self.difference or context.difference

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Difference
    ) -> tuple[Array, Difference]:
        """Return the generalised force, shape (..., n), and the unchanged state."""
        if not callable(state):
            by_hand = "for a call by hand, use context = Context.of(robot, dt=...)"
            raise unexpected_value("state", state, f"the result of initial_state(context); {by_hand}")
        return feedback(self, q, v, reference, state), state


def gain_matrix(name: str, gain: ArrayLike, n: int) -> Array:
    """Return a gain as a matrix.

    Parameters
    ----------
    name : str
        Name of the argument, for the error message.
    gain : array_like, shape (), (n,) or (n, n)
        The gain: a scalar, one value per coordinate, or a matrix.
    n : int
        Number of coordinates.

    Returns
    -------
    matrix : ndarray, shape (n, n)
        The gain, in its own unit.

    Raises
    ------
    InvalidArgument
        If the gain is not finite or has another shape.

    See Also
    --------
    PD : controller whose gains may have each of these shapes

    Examples
    --------
    >>> from pinmobile.controllers import gain_matrix
    >>> gain_matrix("kp", [4.0, 9.0], 2)
    array([[4., 0.],
           [0., 9.]])
    """
    array = shaped(name, finite(name, gain), (), (n,), (n, n))
    return array if array.ndim == 2 else np.diag(np.broadcast_to(array, n))


def feedback(
    controller: Any, q: Array, v: Array, reference: State, difference: Difference | None = None
) -> Array:
    """Return Kp e + Kd de/dt of a controller with `kp` and `kd`, shape (..., n).

    Parameters
    ----------
    controller : controller
        Part with the gains `kp` and `kd`.
    q, v : ndarray, shape (..., nq), (..., nv)
        State.
    reference : Reference
        Reference of n coordinates.
    difference : callable, optional
        Displacement between two configurations; default: the controller's, or else its model's.

    Raises
    ------
    InvalidArgument
        If the sizes of state, reference and gains disagree.
    """
    robot, desired = getattr(controller, "robot", None), reference.q
    n = reference.v.shape[-1]
    if q.shape != desired.shape or v.shape != reference.v.shape or (robot is not None and robot.nv != n):
        # Wheels have no reference.
        if robot is not None and n == max(reference_sizes_of(robot)) < v.shape[-1]:
            desired = full_configurations(q, desired)
        else:
            _check_fit(robot, q, v, reference)
    compare = difference or controller.difference or controller.robot.difference
    error = compare(q, desired)
    if error.shape[-1:] != v.shape[-1:]:
        raise InvalidArgument(
            f"difference returns shape {error.shape}, expected {v.shape}: use the difference of the plant, "
            "difference=plant.difference"
        )
    rate = reference.v - v[..., :n]
    return apply_gain("kp", controller.kp, error[..., :n]) + apply_gain("kd", controller.kd, rate)


def _check_fit(robot: Any, q: Array, v: Array, reference: State) -> None:
    """Check that a state, a reference and a model have the same number of coordinates."""
    for name, actual, desired in (("q", q, reference.q), ("v", v, reference.v)):
        shaped(name, actual, ("...", *desired.shape[-1:]), words=", as in the reference")
    if robot is not None and robot.nv != v.shape[-1]:
        raise InvalidArgument(
            f"robot of the controller is {format_value(robot)}, which has {robot.nv} coordinates, expected "
            f"{v.shape[-1]}, as the plant has"
        )


def apply_gain(name: str, gain: Any, error: Array) -> Array:
    """Return the product of a gain and an error, shape (..., n)."""
    if type(gain) is float or not gain.ndim:
        return gain * error  # type: ignore[no-any-return]
    n = error.shape[-1]
    if gain.shape not in ((n,), (n, n)):
        gain_matrix(name, gain, n)
    if gain.ndim == 1:
        return gain * error  # type: ignore[no-any-return]
    # The rounding of a matrix product depends on the processor; this sum does not.
    columns = [gain[:, k] * error[..., k, None] for k in range(n)]
    return np.asarray(sum(columns[1:], columns[0]))


@final
@part
class PDGravity(BodyLaw):
    """PD with gravity compensation, tau = Kp e + Kd de/dt + g(q) (Takegaki and Arimoto, 1981).

    At a constant reference the steady-state error is zero, because only g(q) remains.

    Parameters
    ----------
    robot : MobileRobot
        Controller model, whose gravity term is compensated; it may differ from the plant.
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains as in `PD` [N/m, N m/rad] and [N s/m, N m s/rad].
    difference : callable, optional
        ``difference(q0, q1)``: displacement from q0 to q1; default: the robot's.

    Raises
    ------
    InvalidArgument
        If a gain is not finite or has another shape, or the robot has wheels.

    See Also
    --------
    PD : the same law without gravity
    ComputedTorque : law that compensates inertia too

    Examples
    --------
    >>> from pinmobile import MobileRobot, PDGravity, Reference
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law, rest = PDGravity(robot, kp=120.0, kd=60.0), robot.rest
    >>> goal = Reference(rest + [0.1, 0.0, 0.0], 0 * rest, 0 * rest)
    >>> tau, _ = law(0.0, rest, 0 * rest, goal, None)
    >>> tau  # [N, N, N m]
    array([12.,  0.,  0.])
    """

    robot: Any = child(Gravitating, doc="model of the controller")
    kp: Any = gain(lower=0.0, unit=_POSITION_UNITS, doc="proportional gain", size=coordinates_of)
    kd: Any = gain(lower=0.0, unit=_VELOCITY_UNITS, doc="derivative gain", size=coordinates_of)
    difference: Any = comparison()

    def initial_state(self, context: Context) -> None:
        """Return None: the controller has no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        return feedback(self, q, v, reference) + self.robot.gravity(q), None


@final
@part
class ComputedTorque:
    """Computed torque, tau = M(q) (a_d + Kd de/dt + Kp e) + n(q, v) (lecture, section 4).

    Any plant with ``inverse_dynamics(q, v, a)``, ``difference(q0, q1)`` and ``nv`` serves as `robot`, such as
    one made of `derivation.Derivation.numeric`.

    For an omnidirectional robot on wheels, it returns the minimum-norm torques that produce this acceleration
    of body and arms. Its reference contains the coordinates of body and arms.

    Parameters
    ----------
    robot : MobileRobot, WheeledRobot or other plant
        Controller model; it may differ from the plant.
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains [1/s^2] and [1/s]: a scalar, one value per coordinate, or a matrix; n is 3 plus the degrees of
        freedom of the arms.
    difference : callable, optional
        ``difference(q0, q1)``: displacement from q0 to q1; default: the robot's. The lecture uses
        `controllers.plain_difference`.

    Raises
    ------
    InvalidArgument
        If a gain is not finite or has another shape, or the motors cannot accelerate the robot in every
        direction.

    See Also
    --------
    PD : feedback without a model
    PID : computed torque with an integral
    SlidingMode : robust law for bounded disturbances
    Adaptive : law that estimates the model

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> law = ComputedTorque(robot, kp=4.0, kd=4.0)
    >>> run = simulate(robot, law, path, dt=0.01)
    >>> print(f"{1e3 * max(run.max_error()):.4f} mm")
    0.0034 mm
    """

    robot: Any = child(Invertible, doc="model of the controller")
    kp: Any = gain(default=4.0, lower=0.0, unit="1/s^2", doc="proportional gain", size=tracked_coordinates_of)
    kd: Any = gain(default=4.0, lower=0.0, unit="1/s", doc="derivative gain", size=tracked_coordinates_of)
    difference: Any = comparison()

    def check(self) -> None:
        """Raise `InvalidArgument` if no torques accelerate the robot in every direction."""
        check_comparison(self)
        if robot := able(self.robot, Inverted):
            robot.check_inverse_dynamics()

    def initial_state(self, context: Context) -> None:
        """Return None: the controller has no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        command = reference.a + feedback(self, q, v, reference)
        return self.robot.inverse_dynamics(q, v, command), None


@final
@part
class PID(BodyLaw, AntiWindup):
    """Computed torque with an integral, tau = M(q) (a_d + kd de/dt + kp e + ki z) + n(q, v), dz/dt = e.

    The integral removes the steady-state error of a constant force, or of a wrong mass on a steady path. It
    stops while the applied input differs from the input of this law, for instance at a limit (anti-windup).

    Parameters
    ----------
    robot : MobileRobot
        Controller model; it may differ from the plant.
    kp, ki, kd : array_like, shape (), (n,) or (n, n)
        Gains [1/s^2], [1/s^3] and [1/s]; the defaults give three poles at -4 1/s. The loop is stable for
        ki < kp kd.
    difference : callable, optional
        ``difference(q0, q1)``: displacement from q0 to q1; default: the robot's.

    Raises
    ------
    InvalidArgument
        If a gain is not finite or has another shape, or the robot has wheels; at the start of a run, if the
        sampled loop is unstable.

    See Also
    --------
    ComputedTorque : the same law without integral
    DisturbanceObserver : wrapper that estimates the disturbing force
    ADRC : law that estimates the disturbing acceleration

    Examples
    --------
    >>> from pinmobile import PID, Circle, ConstantForce, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=6.0))
    >>> run = simulate(robot, PID(robot), path, dt=0.02,
    ...                forces=[ConstantForce([9.0, 0.0, 0.0])])
    >>> print(f"{1e3 * abs(run.error[-1, 0]):.2f} mm at the end")
    0.00 mm at the end
    """

    robot: Any = child(Invertible, doc="model of the controller")
    kp: Any = gain(default=48.0, lower=0.0, unit="1/s^2", doc="proportional gain", size=coordinates_of)
    ki: Any = gain(default=64.0, lower=0.0, unit="1/s^3", doc="integral gain", size=coordinates_of)
    kd: Any = gain(default=12.0, lower=0.0, unit="1/s", doc="derivative gain", size=coordinates_of)
    difference: Any = comparison()

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, float]:
        """Return the integral, its last increment, the last input, and the time step."""
        n = self.robot.nv

        def gains() -> dict[str, Any]:
            return {"kp": self.kp, "kd": self.kd, "ki": self.ki}

        def loop(dt: float) -> Array:
            return double_integrators(dt, **{name: gain_matrix(name, x, n) for name, x in gains().items()})

        check_gains(gains, loop, context.dt)
        zeros = np.zeros(n)
        return zeros, zeros, zeros, float(context.dt)

    def applied(self, u: Array, state: tuple[Any, Any, Any, float]) -> tuple[Any, Any, Any, float]:
        """Return the next state; without the last increment if the applied input differs from the law's."""
        integral, gain, law_input, dt = state
        is_equal = np.all(is_equal_input(u, law_input), axis=-1)[..., None]
        return integral - np.where(is_equal, 0.0, gain), gain, law_input, dt

    def signals(self, state: tuple[Any, Any, Any, float]) -> dict[str, Any]:
        """Return the integral of the error [m s, rad s]."""
        return {"integral": ("m s, rad s", state[0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, float]
    ) -> tuple[Array, tuple[Any, Any, Any, float]]:
        """Return the generalised force, shape (..., n), and the next state."""
        integral, _, _, dt = state
        difference = self.difference or self.robot.difference
        command = reference.a + feedback(self, q, v, reference, difference)
        command = command + apply_gain("ki", self.ki, integral)
        tau = self.robot.inverse_dynamics(q, v, command)
        gain = dt * difference(q, reference.q)
        return tau, (integral + gain, gain, tau, dt)


@final
@part
class Decoupled(BodyLaw):
    """Computed torque of base and arms separately: each neglects the motion of the other.

    The base treats the arms as a locked load, as `MobileRobot.with_locked_arms` does. The arms assume a base
    at rest, and compensate gravity. With c = a_d + Kd de/dt + Kp e, split into base (b) and arms (a)::

        tau_base = M_bb(q) c_b + n_b(q, (v_b, 0)),      tau_arm = M_aa(q) c_a + n_a(q, (0, v_a)).

    `ComputedTorque` adds the coupling: M_ba, M_ab, and the products of v_b and v_a.

    Parameters
    ----------
    robot : MobileRobot
        Controller model; it may differ from the plant.
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains [1/s^2] and [1/s]: a scalar, one value per coordinate, or a matrix.
    difference : callable, optional
        ``difference(q0, q1)``: displacement from q0 to q1; default: the robot's.

    Raises
    ------
    InvalidArgument
        If a gain is not finite or has another shape, or the robot has wheels.

    See Also
    --------
    ComputedTorque : the law with the coupling

    Examples
    --------
    >>> from pinmobile import Circle, MobileRobot, Tangent, simulate
    >>> from pinmobile.controllers import Decoupled
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, Decoupled(robot), path, dt=0.02)
    >>> print(f"{1e3 * max(run.max_error()):.3f} mm")
    0.007 mm
    """

    robot: Any = child(Invertible, doc="model of the controller")
    kp: Any = gain(default=4.0, lower=0.0, unit="1/s^2", doc="proportional gain", size=coordinates_of)
    kd: Any = gain(default=4.0, lower=0.0, unit="1/s", doc="derivative gain", size=coordinates_of)
    difference: Any = comparison()

    def initial_state(self, context: Context) -> None:
        """Return None: the controller has no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        command = reference.a + feedback(self, q, v, reference)
        is_base = np.arange(v.shape[-1]) < _BASE
        base = self.robot.inverse_dynamics(q, *(np.where(is_base, rate, 0.0) for rate in (v, command)))
        arms = self.robot.inverse_dynamics(q, *(np.where(is_base, 0.0, rate) for rate in (v, command)))
        return np.where(is_base, base, arms), None


_REACH = "largest acceleration of the switching term"
_LAYER = "half the width of the boundary layer"


@final
@part
class SlidingMode(BodyLaw):
    """Sliding mode control with a boundary layer (Slotine and Li, 1991).

    ::

        tau = M (a_r + damping s + reach sat(s / layer)) + C v_r + g,   s = de/dt + slope e

    Outside the layer, s converges in spite of any disturbance that accelerates the robot by less than
    `reach`. Inside, the law is linear feedback whose gain is higher by ``reach / layer``. A layer thinner
    than ``2 reach dt`` chatters.

    Parameters
    ----------
    robot : MobileRobot
        Controller model; it may differ from the plant.
    slope : array_like, shape () or (n,)
        Decay rate of errors on the surface s = 0, > 0 [1/s].
    damping : array_like, shape () or (n,)
        Gain of s, >= 0 [1/s].
    reach : array_like, shape () or (n,)
        Largest acceleration of the switching term, >= 0 [m/s^2, rad/s^2].
    layer : array_like, shape () or (n,)
        Half the width of the boundary layer, > 0 [m/s, rad/s].
    difference : callable, optional
        ``difference(q0, q1)``: displacement from q0 to q1; default: the robot's.

    Raises
    ------
    InvalidArgument
        If a parameter is out of its range or has another shape, or the robot has wheels; at the start of a
        run, if the sampled loop is unstable.

    See Also
    --------
    SuperTwisting : sliding mode with a continuous force
    ComputedTorque : law for an exact model

    References
    ----------
    Slotine and Li, Applied Nonlinear Control, 1991, chapter 7.

    Examples
    --------
    >>> from pinmobile import Circle, MobileRobot, SlidingMode
    >>> from pinmobile import Tangent, simulate
    >>> robot, model = MobileRobot(30.0, 1.3), MobileRobot(20.0, 1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, SlidingMode(model), path, dt=0.02)
    >>> print(f"{1e3 * max(run.max_error()):.2f} mm")
    0.11 mm
    """

    robot: Any = child(Passive, doc="model of the controller")
    slope: Any = each(default=4.0, above=0.0, unit="1/s", doc=SLOPE, size=coordinates_of)
    damping: Any = each(default=4.0, lower=0.0, unit="1/s", doc="gain of s", size=coordinates_of)
    reach: Any = each(default=3.0, lower=0.0, unit="m/s^2, m/s^2, rad/s^2", doc=_REACH, size=coordinates_of)
    layer: Any = each(default=0.1, above=0.0, unit="m/s, m/s, rad/s", doc=_LAYER, size=coordinates_of)
    difference: Any = comparison()

    def initial_state(self, context: Context) -> None:
        """Return None: the controller has no memory. Raise `InvalidArgument` for unstable gains."""
        names = ("slope", "damping", "reach", "layer")

        def loop(dt: float) -> Array:
            gain = self.damping + self.reach / self.layer
            kp, kd = diagonal(self.slope * gain), diagonal(self.slope + gain)
            return double_integrators(dt, kp, kd, 0 * kp)

        check_gains(lambda: {name: getattr(self, name) for name in names}, loop, context.dt)

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        s, velocity, acceleration = combined_error(self, q, v, reference)
        switching = self.reach * np.minimum(np.maximum(s / self.layer, -1.0), 1.0)
        correction = self.damping * s + switching
        return passive_torque(self.robot, q, v, velocity, acceleration + correction), None


@final
@part
class SuperTwisting(BodyLaw, AntiWindup):
    """Super-twisting control (Levant, 1993): sliding mode of second order with a continuous force.

    ::

        tau = M (a_r + k1 sqrt|s| sign(s) + z) + C v_r + g,   dz/dt = k2 sign(s),   s = de/dt + slope e

    With k1 >= 1.5 sqrt(k2), the law rejects a disturbing acceleration that changes more slowly than k2. In
    discrete time it chatters with an amplitude of about ``k1 k2 dt``. Where the applied input differs from
    the law's, the last increment of z is removed (anti-windup).

    Parameters
    ----------
    robot : MobileRobot
        Controller model; it may differ from the plant.
    slope : array_like, shape () or (n,)
        Decay rate of errors on the surface s = 0, > 0 [1/s].
    k1, k2 : array_like, shape () or (n,)
        Gains of the square root and of the integral, >= 0 [sqrt(m/s^3), sqrt(rad/s^3)] and [m/s^3, rad/s^3].
    difference : callable, optional
        ``difference(q0, q1)``: displacement from q0 to q1; default: the robot's.

    Raises
    ------
    InvalidArgument
        If a parameter is out of its range or has another shape, or the robot has wheels.

    See Also
    --------
    SlidingMode : sliding mode of first order, with a boundary layer

    Examples
    --------
    >>> from pinmobile import Circle, MobileRobot, SuperTwisting
    >>> from pinmobile import Tangent, simulate
    >>> robot, model = MobileRobot(30.0, 1.3), MobileRobot(20.0, 1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, SuperTwisting(model), path, dt=0.02)
    >>> print(f"{1e3 * max(run.max_error()):.1f} mm")
    0.1 mm
    """

    robot: Any = child(Passive, doc="model of the controller")
    slope: Any = each(default=4.0, above=0.0, unit="1/s", doc=SLOPE, size=coordinates_of)
    k1: Any = each(
        default=3.0,
        lower=0.0,
        unit="sqrt(m/s^3), sqrt(m/s^3), sqrt(rad/s^3)",
        doc="gain of the square root",
        size=coordinates_of,
    )
    k2: Any = each(
        default=3.0, lower=0.0, unit="m/s^3, m/s^3, rad/s^3", doc="gain of the integral", size=coordinates_of
    )
    difference: Any = comparison()

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, float]:
        """Return the integral z, its last increment, the last input, and the time step."""
        zeros = np.zeros(self.robot.nv)
        return zeros, zeros, zeros, float(context.dt)

    def applied(self, u: Array, state: tuple[Any, Any, Any, float]) -> tuple[Any, Any, Any, float]:
        """Return the next state; without the last increment of z where another input is applied."""
        z, gain, law_input, dt = state
        return z - np.where(is_equal_input(u, law_input), 0.0, gain), gain, law_input, dt

    def signals(self, state: tuple[Any, Any, Any, float]) -> dict[str, Any]:
        """Return the integral z, an estimate of the unmodelled acceleration [m/s^2, rad/s^2]."""
        return {"unmodelled": ("m/s^2, rad/s^2", state[0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, float]
    ) -> tuple[Array, tuple[Any, Any, Any, float]]:
        """Return the generalised force, shape (..., n), and the next state."""
        z, _, _, dt = state
        s, velocity, acceleration = combined_error(self, q, v, reference)
        side = np.sign(s)
        correction = self.k1 * np.sqrt(np.abs(s)) * side + z
        tau = passive_torque(self.robot, q, v, velocity, acceleration + correction)
        gain = dt * (self.k2 * side)
        return tau, (z + gain, gain, tau, dt)
