"""Controllers: base classes, checks of a reference and a robot, tracking errors, functions as controllers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from pinmobile.arrays import (
    LEAST_ANGLE,
    Array,
    ArrayLike,
    answered,
    are_real,
    broadcast,
    callable_as,
    finite,
    shaped,
    wrap_angle,
)
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import Informed, able, option, part, required
from pinmobile.plant import Context
from pinmobile.signals import signals_of

_SAME = 1e-9  # to which two answers to the same arguments agree


class State(Protocol):
    """A configuration, a velocity and an acceleration, each of shape (..., n)."""

    @property
    def q(self) -> Array:
        """Configuration."""

    @property
    def v(self) -> Array:
        """Velocity."""

    @property
    def a(self) -> Array:
        """Acceleration."""


class Controller(Protocol):
    """A controller: wrap a function in law(...).

    The loop calls an optional method ``applied(u, state) -> state`` once per sample with the applied input,
    shape (..., nu), after all wrappers; it returns the next state, for instance against the windup of an
    integral. An optional ``signals(state) -> {name: (unit, value)}`` returns further series to record, such
    as an estimate: numbers, or rows of them. Wrappers pass both inward.
    """

    def initial_state(self, context: Context, /) -> Any:
        """Return the state to start with, of a `Context`; None where there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: Any) -> tuple[Array, Any]:
        """Return the generalised force, shape (..., nu), and the next state."""


def check_controller(controller: object) -> None:
    """Check that this is a controller, and not a plain function or a class.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    found = required("controller", controller, Controller)
    callable_as("controller(t, q, v, reference, state)", controller)
    try:
        callable_as("controller.initial_state(context)", found.initial_state)
    except InvalidArgument as error:
        raise InvalidArgument(f"{error}: write def initial_state(self, context)") from None
    if informed := able(controller, Informed):
        callable_as("controller.applied(u, state)", informed.applied)


def answer_of(
    controller: Controller, t: float, q: Array, v: Array, reference: State, state: object
) -> tuple[Array, Any]:
    """Return the force and the next state of a controller.

    Raises
    ------
    InvalidArgument
        If it returns something else than two.
    """
    answer = controller(t, q, v, reference, state)
    if type(answer) is not tuple or len(answer) != 2:
        raise InvalidArgument(f"controller returned {shown(answer)} at t = {t:g} s, expected (u, state)")
    return answer


def check_wheels(robot: Any) -> None:
    """Refuse a controller's robot that has not a motor for each independent velocity.

    Raises
    ------
    InvalidArgument
        If it is such.
    """
    still = robot.reduced(robot.rest, np.zeros(robot.nv))
    if np.linalg.matrix_rank(still.B) < len(still.M):
        raise InvalidArgument(
            f"robot has {len(robot.inputs)} motors and {len(still.M)} independent velocities, expected a "
            "motor for each"
        )


def check_memory(controller: Controller, context: Context, q: Array, v: Array) -> None:
    """Check that a controller gives the same answer when it is asked again with the same arguments.

    One that does not keeps something in itself or in a closure, or draws random numbers of its own: then no
    two runs are alike, and robots of an ensemble share what is kept. A solver's workspace is allowed where
    the answer does not depend on it.

    Parameters
    ----------
    controller : controller
        What is asked, three times.
    context : Context
        With the reference.
    q, v : ndarray, shape (nq,), (nv,)
        A state.

    Raises
    ------
    InvalidArgument
        If it does not.
    """
    at = type(context.reference)(*(np.array(part[0]) for part in context.reference))
    t, wave = float(context.t[0]), np.cos(np.arange(len(v)))
    # Beside the reference, where an integral grows; then elsewhere, then there again.
    here, there = ((context.integrate(q, off * wave), v + off * wave) for off in (0.01, -0.02))
    answers = []
    with np.errstate(all="ignore"):
        for place in (here, there, here):
            copies = type(at)(*map(np.copy, at))
            state = controller.initial_state(context)
            answer = answer_of(controller, t, place[0].copy(), place[1].copy(), copies, state)
            answers.append(answered("controller", answer[0]))
    first, _, again = answers
    if first.shape != again.shape or not np.allclose(first, again, rtol=_SAME, atol=_SAME, equal_nan=True):
        raise InvalidArgument(
            f"controller is {shown(controller)}, which returns {first.tolist()} and, asked again for the "
            f"same arguments, {again.tolist()}, expected the same: keep memory in state, and take random "
            "numbers from context.noise(name, n)"
        )


def told(controller: Controller, u: Array, state: object) -> Any:
    """Return the state of a controller after it has been told which input is applied, if it wants to know."""
    informed = able(controller, Informed)
    return informed.applied(u, state) if informed else state


class Wrapper:
    """What has a controller within it, whose memory is the first of its own."""

    controller: Any

    def check(self) -> None:
        """Raise `InvalidArgument` where what is wrapped cannot be called as a controller."""
        check_controller(self.controller)

    def applied(self, u: Array, state: Any) -> Any:
        """Return the state, with the wrapped controller told of the input that is applied, shape (..., n)."""
        return told(self.controller, u, state[0]), *state[1:]

    def signals(self, state: Any) -> Any:
        """Return what the wrapped controller tells beside its input: name to (unit, value)."""
        return signals_of(self.controller, state[0])


class Seen:
    """The context of a wrapped controller: that of the loop, but for what is given here."""

    def __init__(self, context: Any, **others: Any) -> None:
        self._context = context
        vars(self).update(others)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)


def completed(q: Array, desired: Array) -> Array:
    """Return configurations where a reference has its first numbers, and the others are those of q."""
    lead, length = np.shape(q)[:-1], np.shape(desired)[-1]
    return np.concatenate([np.broadcast_to(desired, (*lead, length)), q[..., length:]], axis=-1)


def planar_difference(q0: Array, q1: Array) -> Array:
    """Return q1 - q0, the displacement from q0 to q1, with that of the heading on the circle.

    Parameters
    ----------
    q0, q1 : array_like, shape (..., n), n >= 3
        Configurations; the third coordinate is psi [rad].

    Returns
    -------
    displacement : ndarray, shape (..., n)
        Its third coordinate lies in (-pi, pi]. The lecture's own subtraction is `plain_difference`.

    Raises
    ------
    InvalidArgument
        If there is no third coordinate.
    """
    displacement = plain_difference(q0, q1)
    if not displacement.ndim or displacement.shape[-1] < 3:
        raise InvalidArgument(
            f"configurations have shape {displacement.shape}, expected (..., n) with n >= 3; "
            "without a heading, compare them with difference=plain_difference"
        )
    # Of one configuration of numbers, a look saves the arithmetic, which would leave the angle as it is.
    numbers = type(displacement) is np.ndarray and displacement.ndim == 1
    if not (numbers and LEAST_ANGLE < displacement[2] <= np.pi):
        displacement[..., 2] = wrap_angle(displacement[..., 2])
    return displacement


def plain_difference(q0: Array, q1: Array) -> Array:
    """Return q1 - q0, the displacement from q0 to q1 where no coordinate lies on the circle.

    The lecture compares configurations so: a heading that is off by a turn is an error of 2 pi.

    Parameters
    ----------
    q0, q1 : array_like, shape (..., n)
        Configurations.

    Returns
    -------
    displacement : ndarray, shape (..., n)
    """
    if type(q0) is not np.ndarray or type(q1) is not np.ndarray:
        q0, q1 = finite("q0", q0), finite("q1", q1)
        broadcast(q0=q0[..., None], q1=q1[..., None])
    return np.subtract(q1, q0, dtype=np.float64)


@part
class _Law:
    function: Any = option(check=lambda name, value: callable_as(f"{name}(t, q, v, reference)", value))

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: None) -> tuple[Array, None]:
        """Return what the function returns, and None."""
        force = self.function(t, q, v, reference)
        try:
            if not are_real(force):
                raise TypeError
            return np.asarray(force if force is not None else "nothing", np.float64), None
        except (TypeError, ValueError):
            raise InvalidArgument(
                f"function of the law returned {shown(force)} at t = {t:g} s, expected a force: nu numbers"
            ) from None


def law(function: Callable[[float, Array, Array, Any], ArrayLike]) -> Controller:
    """Return a controller without memory made of a plain function.

    Parameters
    ----------
    function : callable
        ``function(t, q, v, reference) -> tau``, with `reference` a `Reference`.

    Raises
    ------
    InvalidArgument
        If it cannot be called so.
    """
    return _Law(function)


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
        shaped(name, actual, ("...", *desired.shape[-1:]), words=", as the reference's")
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
