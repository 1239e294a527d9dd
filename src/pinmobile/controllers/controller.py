"""Protocol of controllers, functions as controllers, checks of controllers, and tracking errors."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple, Protocol

import numpy as np

from pinmobile.arrays import (
    LEAST_ANGLE,
    Array,
    ArrayLike,
    are_real,
    broadcast,
    callable_as,
    check_repeat,
    check_returned_array,
    finite,
    shaped,
    wrap_angle,
)
from pinmobile.errors import InvalidArgument, NotTraceable, argument_errors, format_value
from pinmobile.parts import Informed, able, option, part, require
from pinmobile.plant import Context, stated
from pinmobile.signals import signals_of

_TOL = 1e-9  # tolerance of two results for the same arguments
_INPUT_TOLERANCE = 1e-5  # relative tolerance of equal inputs: above the rounding of single precision


class State(Protocol):
    """Configuration, velocity and acceleration, each of shape (..., n), such as a `Reference`.

    See Also
    --------
    Reference : the named tuple that trajectories return

    Examples
    --------
    >>> from pinmobile import Circle, Tangent
    >>> state = Tangent(Circle(1.0, 0.5, 4.0))(0.0)
    >>> state.v  # [m/s, m/s, rad/s]
    array([0.5, 0. , 0.5])
    """

    @property
    def q(self) -> Array:
        """Configuration, shape (..., n)."""

    @property
    def v(self) -> Array:
        """Velocity, shape (..., n)."""

    @property
    def a(self) -> Array:
        """Acceleration, shape (..., n)."""


class Controller(Protocol):
    """A controller: initial_state(context) and __call__(t, q, v, reference, state), or law(function).

    A class is a controller if it has both methods. The loop calls an optional method ``applied(u, state) ->
    state`` once per sample with the applied input, shape (..., nu), after all wrappers. It returns the next
    state, for instance without the windup of an integral. An optional method ``signals(state) -> {name:
    (unit, value)}`` returns additional series to record, such as an estimate; a value is a number or a row of
    numbers. Wrappers pass both calls to the wrapped controller.

    See Also
    --------
    law : controller from a plain function
    plant.Context : argument of `initial_state`
    PD : a controller of the library

    Examples
    --------
    >>> from pinmobile import Circle, MobileRobot, Tangent, simulate
    >>> class Proportional:
    ...     def initial_state(self, context):
    ...         return context.difference
    ...     def __call__(self, t, q, v, reference, difference):
    ...         error = difference(q, reference.q)
    ...         return 90 * error - 60 * v, difference
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, Proportional(), path, dt=0.02)
    >>> print(f"{run.max_error()[0]:.2f} m behind")
    0.22 m behind
    """

    def initial_state(self, context: Context, /) -> Any:
        """Return the state before the first sample.

        Parameters
        ----------
        context : Context
            Sampling, coordinates, inputs and reference of the loop.

        Returns
        -------
        state : any
            First state of the controller; None without memory.
        """

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: Any) -> tuple[Array, Any]:
        """Return the input and the next state.

        Parameters
        ----------
        t : float
            Time of the sample [s].
        q, v : ndarray, shape (..., nq), (..., nv)
            Measured configuration and velocity.
        reference : Reference
            Desired q, v and a at this time.
        state : any
            State of the controller.

        Returns
        -------
        u : ndarray, shape (..., nu)
            Input of the plant, such as a generalised force [N, N, N m].
        state : any
            The next state.
        """


def check_controller(controller: object) -> None:
    """Check that an object is a controller, and not a plain function or a class.

    Parameters
    ----------
    controller : object
        The object.

    Raises
    ------
    InvalidArgument
        If it lacks ``initial_state(context)`` or ``__call__(t, q, v, reference, state)``.

    See Also
    --------
    controllers.Controller : protocol of controllers
    law : controller from a plain function

    Examples
    --------
    >>> from pinmobile import InvalidArgument
    >>> from pinmobile.controllers import check_controller
    >>> try:
    ...     check_controller(lambda t, q, v, reference: -q)
    ... except InvalidArgument as error:
    ...     print(str(error)[:13])
    controller is
    """
    typed = require("controller", controller, Controller)
    try:
        callable_as("controller(t, q, v, reference, state)", controller)
    except InvalidArgument as error:
        hint = ""
        with suppress(InvalidArgument):
            callable_as("law(tracked, state)", controller)
            hint = ": a kinematic law goes into Backstepping, VelocityCommand or WheelSpeed"
        raise InvalidArgument(f"{error}{hint}") from None
    with argument_errors(after=": write def initial_state(self, context)"):
        callable_as("controller.initial_state(context)", typed.initial_state)
    if listener := able(controller, Informed):
        callable_as("controller.applied(u, state)", listener.applied)


def evaluate(
    controller: Controller, t: float, q: Array, v: Array, reference: State, state: object
) -> tuple[Array, Any]:
    """Return the input and the next state of a controller.

    Raises
    ------
    InvalidArgument
        If the controller does not return a pair.
    """
    answer = controller(t, q, v, reference, state)
    if type(answer) is not tuple or len(answer) != 2:
        raise InvalidArgument(f"controller returned {format_value(answer)}{stamp(t)}, expected (u, state)")
    return answer


def stamp(t: Any) -> str:
    """Return a time as text for messages; "" for a symbol."""
    return f" at t = {t:g} s" if isinstance(t, float) else ""


def check_wheels(robot: Any) -> None:
    """Check that a controller's robot has a motor for each independent velocity.

    Raises
    ------
    InvalidArgument
        If it has too few motors.
    """
    dynamics = robot.reduced(robot.rest, np.zeros(robot.nv))
    if np.linalg.matrix_rank(dynamics.B) < len(dynamics.M):
        raise InvalidArgument(
            f"robot has {len(robot.inputs)} motors and {len(dynamics.M)} independent velocities, expected a "
            "motor for each"
        )


def check_memory(controller: Controller, context: Context, q: Array, v: Array) -> None:
    """Check that a controller returns the same input when it is called again with the same arguments.

    A controller that fails this check keeps memory in itself or in a closure, or draws its own random
    numbers. Then runs are not repeatable, and the robots of an ensemble share memory. The workspace of a
    solver passes if the result does not depend on it.

    Parameters
    ----------
    controller : controller
        Controller to check; it is called three times.
    context : Context
        Context with the reference.
    q, v : ndarray, shape (nq,), (nv,)
        A state.

    Raises
    ------
    InvalidArgument
        If two inputs for the same arguments differ.
    """
    reference = type(context.reference)(*(np.array(part[0]) for part in context.reference))
    t, wave = float(context.t[0]), np.cos(np.arange(len(v)))
    # First near the reference, where an integral grows; then elsewhere; then at the first state again.
    near, far = ((context.integrate(q, offset * wave), v + offset * wave) for offset in (0.01, -0.02))
    answers = []
    with np.errstate(all="ignore"):
        for point in (near, far, near):
            copies = type(reference)(*map(np.copy, reference))
            state = controller.initial_state(context)
            answer = evaluate(controller, t, point[0].copy(), point[1].copy(), copies, state)
            answers.append(check_returned_array("controller", answer[0]))
    first, _, last = answers
    hint = "keep memory in state, and take random numbers from context.noise(name, n)"
    check_repeat("controller", controller, first, last, _TOL, hint)


class AntiWindup:
    """Base class of laws with a memory that stops where limits change the input."""

    def applied_late(self, u: Array, shift: Array, state: Any) -> Any:
        """Return the next state; a limit changes the last input as it changes the delayed one."""
        law: Any = self
        return law.applied(u + shift, state)


def notify_applied(controller: Controller, u: Array, state: object, shift: Array | None = None) -> Any:
    """Return the state of a controller after its optional call ``applied(u, state)``.

    Behind an `InputDelay`, the call is ``applied_late(u, shift, state)``, if the controller has this method.
    Laws with an integral have it, and wrappers. Observers receive the input that moves the robot.

    Parameters
    ----------
    controller : controller
        Controller.
    u : ndarray, shape (..., nu)
        Applied input.
    state : any
        State of the controller.
    shift : ndarray, shape (..., nu), optional
        Last input of the controller minus the earlier one that is applied now; None without an `InputDelay`.
    """
    listener: Any = able(controller, Informed)
    if listener is None:
        return state
    late = None if shift is None else stated(controller, "applied_late")
    return late(u, shift, state) if late else listener.applied(u, state)


def is_equal_input(u: Array, command: Array) -> Any:
    """Return whether an applied input equals the input of a law up to rounding, shape (..., nu)."""
    return np.abs(u - command) <= _INPUT_TOLERANCE * (1.0 + np.abs(command))


class Wrapper:
    """Base class of controllers that contain a controller; its state is the first entry of theirs."""

    controller: Any

    def check(self) -> None:
        """Raise `InvalidArgument` if the wrapped object is not a controller."""
        check_controller(self.controller)

    def applied(self, u: Array, state: Any, shift: Array | None = None) -> Any:
        """Return the next state, with the applied input and the shift of a delay passed on, (..., nu)."""
        return notify_applied(self.controller, u, state[0], shift), *state[1:]

    def applied_late(self, u: Array, shift: Array, state: Any) -> Any:
        """Return the next state behind a delay of the input, shape (..., nu)."""
        return self.applied(u, state, shift)

    def signals(self, state: Any) -> Any:
        """Return the signals of the wrapped controller: name to (unit, value)."""
        return signals_of(self.controller, state[0])


class ContextView:
    """Context of a controller: the context of the loop, except for the given attributes.

    Parameters
    ----------
    context : Context
        Context with everything else.
    hidden : (str, str), optional
        Reason why reference and trajectory are hidden, and what the user can do instead, for the message.
    **attributes
        Other attributes.
    """

    def __init__(self, context: Any, hidden: tuple[str, str] | None = None, **attributes: Any) -> None:
        self._context, self._hidden = context, hidden
        vars(self).update(attributes)

    def __getattr__(self, name: str) -> Any:
        if self._hidden and name in ("reference", "trajectory"):
            reason, remedy = self._hidden
            raise NotTraceable(f"the controller reads the {name} of its context, {reason}", remedy)
        return getattr(self._context, name)


def planar_difference(q0: Array, q1: Array) -> Array:
    """Return the displacement q1 - q0, with the difference of headings on the circle.

    Parameters
    ----------
    q0, q1 : array_like, shape (..., n), n >= 3
        Configurations; the third coordinate is psi [rad].

    Returns
    -------
    displacement : ndarray, shape (..., n)
        Difference of each coordinate [m, m, rad, ...]; the third lies in (-pi, pi].

    Raises
    ------
    InvalidArgument
        If a number is not finite, or the shapes do not broadcast.

    See Also
    --------
    controllers.plain_difference : subtraction without the circle, as in the lecture

    Examples
    --------
    >>> from pinmobile.controllers import planar_difference
    >>> planar_difference([0.0, 0.0, 3.0], [1.0, 2.0, -3.0]).round(3)
    array([1.   , 2.   , 0.283])
    """
    displacement = plain_difference(q0, q1)
    # For one numeric configuration, this test saves arithmetic that would not change the angle.
    numbers = type(displacement) is np.ndarray and displacement.ndim == 1
    if not (numbers and LEAST_ANGLE < displacement[2] <= np.pi):
        displacement[..., 2] = wrap_angle(displacement[..., 2])
    return displacement


def plain_difference(q0: Array, q1: Array) -> Array:
    """Return the displacement q1 - q0, with every coordinate on a line.

    The lecture compares configurations in this way: a heading that is wrong by one turn has an error of 2 pi.

    Parameters
    ----------
    q0, q1 : array_like, shape (..., n)
        Configurations [m, m, rad, ...].

    Returns
    -------
    displacement : ndarray, shape (..., n)
        Difference of each coordinate [m, m, rad, ...].

    Raises
    ------
    InvalidArgument
        If a number is not finite, or the shapes do not broadcast.

    See Also
    --------
    controllers.planar_difference : difference with the heading on the circle
    PD : controller with an argument `difference`

    Examples
    --------
    >>> from pinmobile.controllers import plain_difference
    >>> plain_difference([0.0, 0.0, 3.0], [1.0, 2.0, -3.0])
    array([ 1.,  2., -6.])
    """
    if type(q0) is not np.ndarray or type(q1) is not np.ndarray:
        q0, q1 = finite("q0", q0), finite("q1", q1)
        broadcast(q0=q0[..., None], q1=q1[..., None])
    return np.subtract(q1, q0, dtype=np.float64)


@part
class _Law:
    """Controller without memory that calls a function."""

    function: Any = option(check=lambda name, value: callable_as(f"{name}(t, q, v, reference)", value))

    def initial_state(self, context: Context) -> None:
        """Return None: the controller has no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: None) -> tuple[Array, None]:
        """Return the result of the function, and None."""
        force = self.function(t, q, v, reference)
        try:
            u = None if force is None or not are_real(force) else np.asarray(force, np.float64)
        except (TypeError, ValueError):
            u = None
        if u is None:
            words = f"function of the law returned {format_value(force)} at t = {t:g} s"
            raise InvalidArgument(f"{words}, expected an input: nu numbers")
        return u, None


def law(function: Callable[[float, Array, Array, Any], ArrayLike]) -> Controller:
    """Return a controller without memory that calls a plain function.

    Parameters
    ----------
    function : callable
        ``function(t, q, v, reference) -> u``: time [s], state and `Reference` to input, shape (..., nu).

    Returns
    -------
    controller : controller
        The controller, for `simulate` and every wrapper.

    Raises
    ------
    InvalidArgument
        If the function does not take these arguments; in a run, if it does not return numbers.

    See Also
    --------
    controllers.Controller : protocol of controllers with memory

    Examples
    --------
    >>> from pinmobile import Circle, MobileRobot, Tangent
    >>> from pinmobile import law, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> push = law(lambda t, q, v, reference: 30 * reference.a)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(robot, push, path, dt=0.02)
    >>> print(f"{1e3 * run.max_error()[0]:.2f} mm without feedback")
    0.06 mm without feedback
    """
    return _Law(function)


class CombinedError(NamedTuple):
    """Combined error of configuration and velocity (Slotine and Li, 1987), each of shape (..., n).

    Attributes
    ----------
    s : ndarray
        de/dt + slope e, the distance from the surface on which errors decay.
    velocity, acceleration : ndarray
        v_r = v_d + slope e and a_r = a_d + slope de/dt.
    """

    s: Array
    velocity: Array
    acceleration: Array


def combined_error(law: Any, q: Array, v: Array, reference: State) -> CombinedError:
    """Return the combined error of a law with `robot`, `slope` and `difference`.

    Raises
    ------
    InvalidArgument
        If the sizes of state and reference disagree.
    """
    for name, actual, desired in (("q", q, reference.q), ("v", v, reference.v)):
        shaped(name, actual, ("...", *desired.shape[-1:]), words=", as in the reference")
    slope, difference = law.slope, law.difference or law.robot.difference
    error, rate = difference(q, reference.q), np.subtract(reference.v, v)
    return CombinedError(rate + slope * error, reference.v + slope * error, reference.a + slope * rate)


def passive_torque(robot: Any, q: Array, v: Array, velocity: Array, acceleration: Array) -> Array:
    """Return M a_r + C(q, v) v_r + g, shape (..., n), with C by the Christoffel symbols.

    n - g is quadratic in v, and C(q, v) v_r is its symmetric bilinear form: its value at half the sum of v
    and v_r minus its value at half their difference.
    """
    forward = robot.inverse_dynamics(q, 0.5 * (v + velocity), acceleration)
    return np.asarray(forward - robot.nonlinear_effects(q, 0.5 * (v - velocity)) + robot.gravity(q))
