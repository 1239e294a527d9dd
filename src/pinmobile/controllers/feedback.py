"""Feedback of the errors in configuration and velocity: PD, computed torque, sliding mode and others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, endless_or_finite, finite, frozen, real, shaped
from pinmobile.controllers.controller import State, combined, completed, passive_torque
from pinmobile.controllers.lqr import check_held, diagonal, double_integrators
from pinmobile.errors import InvalidArgument, shown
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
from pinmobile.plant import Context, Difference, check_difference, reference_sizes_of

SLOPE = "rate at which errors vanish where s does"
"""What a slope is."""

_BASE = 3  # coordinates of the base: x, y, psi
_PLACE, _RATE = "N/m, N/m, N m/rad", "N s/m, N s/m, N m s/rad"


def coordinates_of(controller: Any) -> int:
    """Return how many coordinates the model of a controller has."""
    return int(controller.robot.nv)


def tracked_coordinates_of(controller: Any) -> int:
    """Return how many coordinates the model of a controller tracks: all, or all but those of wheels."""
    return max(reference_sizes_of(controller.robot))


def comparison() -> Any:
    """Declare how configurations are compared: by default, as the plant or the controller's model does."""

    def checked(name: str, value: Any) -> Any:
        check_difference(value)
        return value

    return option(default=None, doc="difference(q0, q1), the displacement from q0 to q1", check=checked)


def bound(sign: float, doc: str, default: Any = None) -> Any:
    """Declare bounds of numbers, which may be endless on their own side: below with sign -1, else above."""

    def checked(name: str, value: Any) -> Any:
        return frozen(sign * endless_or_finite(name, sign * real(name, value)))

    return option(default=default, doc=doc, check=checked)


def check_bounds(names: Sequence[str], lower: Array, own: Array, upper: Array) -> None:
    """Refuse bounds of estimates that exclude those of the robot.

    Raises
    ------
    InvalidArgument
        If they do; the message names the first.
    """
    outside = ~((lower <= own) & (own <= upper))
    if outside.any():
        k = int(outside.argmax())
        raise InvalidArgument(
            f"lower and upper of {names[k]} are {lower[k]:g} and {upper[k]:g}, which exclude that of the "
            f"robot, {own[k]:g}"
        )


def check_compares(controller: Any) -> None:
    """Refuse a model without `difference` where its controller has none either.

    Raises
    ------
    InvalidArgument
        If it is such.
    """
    if controller.difference is None and not able(controller.robot, Comparing):
        raise InvalidArgument(
            f"robot is {shown(controller.robot)}, which has no difference(q0, q1), expected one, or to be "
            "told how configurations are compared: difference=planar_difference"
        )


def check_wheelless(controller: Any) -> None:
    """Refuse the model of a controller of base and arms that has wheels.

    Raises
    ------
    InvalidArgument
        If it is such; the message says what to write instead.
    """
    robot = controller.robot
    if max(reference_sizes_of(robot)) < robot.nv:
        raise InvalidArgument(
            f"robot is {shown(robot)}, which has wheels, expected the body on them: "
            f"ControlAllocation({type(controller).__name__}(robot.robot, ...), robot)"
        )


class OfBody:
    """What has a model of base and arms, and compares configurations as it says or as the model does."""

    robot: Any
    difference: Any

    def check(self) -> None:
        """Raise `InvalidArgument` where the robot has wheels or compares nothing."""
        check_compares(self)
        check_wheelless(self)


@final
@part
class PD:
    """Proportional-derivative control (lecture, section 4): tau = Kp e + Kd e_dot, e = difference(q, q_d).

    Parameters
    ----------
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains: a scalar, one per coordinate, or a matrix. For a force in N and an error in m, [N/m] and
        [N s/m].
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; the error is that from q to q_d. By default
        the plant's, which the state keeps; the lecture's is `plain_difference`.
    """

    kp: Any = gain(unit=_PLACE, doc="proportional gain")
    kd: Any = gain(unit=_RATE, doc="derivative gain")
    difference: Any = comparison()

    def initial_state(self, context: Context) -> Difference:
        """Return the difference of configurations, by default the plant's."""
        return self.difference or context.difference

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Difference
    ) -> tuple[Array, Difference]:
        """Return the generalised force, shape (..., n), and the state as it is."""
        if not callable(state):
            raise InvalidArgument(
                f"state is {shown(state)}, expected what initial_state(context) returns; called by hand, "
                "that is of Context.of(robot, dt=...)"
            )
        return feedback(self, q, v, reference, state), state


def gain_matrix(name: str, gain: ArrayLike, n: int) -> Array:
    """Return a gain as a matrix.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    gain : array_like, shape (), (n,) or (n, n)
        The gain.
    n : int
        Number of coordinates.

    Raises
    ------
    InvalidArgument
        If the gain has another shape.
    """
    array = shaped(name, finite(name, gain), (), (n,), (n, n))
    return array if array.ndim == 2 else np.diag(np.broadcast_to(array, n))


def feedback(
    controller: Any, q: Array, v: Array, reference: State, difference: Difference | None = None
) -> Array:
    """Return Kp e + Kd e_dot of a controller that has `kp` and `kd`, shape (..., n).

    Configurations are compared by `difference`, or as the controller or its robot does.

    Raises
    ------
    InvalidArgument
        If state, reference and gains do not fit together.
    """
    robot, wanted = getattr(controller, "robot", None), reference.q
    n = reference.v.shape[-1]
    if q.shape != wanted.shape or v.shape != reference.v.shape or (robot is not None and robot.nv != n):
        # Wheels have no reference.
        if robot is not None and n == max(reference_sizes_of(robot)) < v.shape[-1]:
            wanted = completed(q, wanted)
        else:
            _check_fit(robot, q, v, reference)
    compare = difference or controller.difference or controller.robot.difference
    error = compare(q, wanted)
    if error.shape[-1:] != v.shape[-1:]:
        raise InvalidArgument(
            f"difference gives shape {error.shape}, expected {v.shape}: compare configurations by the "
            "plant's own, difference=plant.difference"
        )
    rate = reference.v - v[..., :n]
    return amplified("kp", controller.kp, error[..., :n]) + amplified("kd", controller.kd, rate)


def _check_fit(robot: Any, q: Array, v: Array, reference: State) -> None:
    """Refuse a state, a reference and a model of different numbers of coordinates."""
    for name, actual, desired in (("q", q, reference.q), ("v", v, reference.v)):
        shaped(name, actual, ("...", *desired.shape[-1:]), words=", as the reference's")
    if robot is not None and robot.nv != v.shape[-1]:
        raise InvalidArgument(
            f"robot of the controller is {shown(robot)}, which has {robot.nv} coordinates, expected "
            f"{v.shape[-1]}, as the plant has"
        )


def amplified(name: str, gain: Any, error: Array) -> Array:
    """Return a gain times an error, shape (..., n)."""
    if type(gain) is float or not gain.ndim:
        return gain * error  # type: ignore[no-any-return]
    n = error.shape[-1]
    if gain.shape not in ((n,), (n, n)):
        gain_matrix(name, gain, n)
    if gain.ndim == 1:
        return gain * error  # type: ignore[no-any-return]
    # Not as a matrix product, whose rounding hangs on the processor.
    columns = [gain[:, k] * error[..., k, None] for k in range(n)]
    return np.asarray(sum(columns[1:], columns[0]))


@final
@part
class PDGravity(OfBody):
    """PD with gravity compensation, tau = Kp e + Kd e_dot + g(q) (Takegaki and Arimoto, 1981).

    It comes to rest at a reference that does: there is nothing left but g.

    Parameters
    ----------
    robot : MobileRobot
        The model whose gravity is compensated; it need not be the one that is simulated.
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains as in `PD`: [N/m] and [N s/m] for a way, [N m/rad] and [N m s/rad] for an angle.
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own.
    """

    robot: Any = child(Gravitating, doc="model of the controller")
    kp: Any = gain(unit=_PLACE, doc="proportional gain", size=coordinates_of)
    kd: Any = gain(unit=_RATE, doc="derivative gain", size=coordinates_of)
    difference: Any = comparison()

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        return feedback(self, q, v, reference) + self.robot.gravity(q), None


@final
@part
class ComputedTorque:
    """Computed torque, tau = M(q) (a_d + Kd e_dot + Kp e) + n(q, v) (lecture, section 4).

    Of a robot on wheels that moves in every direction, the torques of least norm with which body and arms
    accelerate so; its reference is of these.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        The model that the controller believes in; it need not be the one that is simulated.
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains [1/s^2] and [1/s]: a scalar, one per coordinate, or a matrix; n is 3 and one for each degree of
        freedom of the arms.
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own. The lecture's is
        `plain_difference`.

    Raises
    ------
    InvalidArgument
        If a gain has another shape or is not finite, or no torques move the robot in every direction.
    """

    robot: Any = child(Invertible, doc="model of the controller")
    kp: Any = gain(default=4.0, unit="1/s^2", doc="proportional gain", size=tracked_coordinates_of)
    kd: Any = gain(default=4.0, unit="1/s", doc="derivative gain", size=tracked_coordinates_of)
    difference: Any = comparison()

    def check(self) -> None:
        """Raise `InvalidArgument` where no torques move the robot in every direction."""
        check_compares(self)
        if robot := able(self.robot, Inverted):
            robot.check_inverse_dynamics()

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        command = reference.a + feedback(self, q, v, reference)
        return self.robot.inverse_dynamics(q, v, command), None


@final
@part
class PID(OfBody):
    """Computed torque with an integral, tau = M(q) (a_d + kd e' + kp e + ki z) + n(q, v), z' = e.

    The integral takes away the error that a constant force, or a wrong mass on a steady path, leaves. While
    any force that is applied is another than the law's, as where a limit holds, nothing is integrated.

    Parameters
    ----------
    robot : MobileRobot
        The model that the controller believes in; it need not be the one that is simulated.
    kp, ki, kd : array_like, shape (), (n,) or (n, n)
        Gains [1/s^2], [1/s^3] and [1/s]; by default three poles at -4 1/s. Stable where ki < kp kd.
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own.

    Raises
    ------
    InvalidArgument
        If an argument is something else; at the start of a run, if the loop is unstable at its dt.
    """

    robot: Any = child(Invertible, doc="model of the controller")
    kp: Any = gain(default=48.0, unit="1/s^2", doc="proportional gain", size=coordinates_of)
    ki: Any = gain(default=64.0, unit="1/s^3", doc="integral gain", size=coordinates_of)
    kd: Any = gain(default=12.0, unit="1/s", doc="derivative gain", size=coordinates_of)
    difference: Any = comparison()

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, float]:
        """Return the integral, what it gained last, the last force, and the time between samples."""
        n = self.robot.nv

        def gains() -> dict[str, Any]:
            return {"kp": self.kp, "kd": self.kd, "ki": self.ki}

        def loop(dt: float) -> Array:
            return double_integrators(dt, **{name: gain_matrix(name, x, n) for name, x in gains().items()})

        check_held(gains, loop, context.dt)
        none = np.zeros(n)
        return none, none, none, float(context.dt)

    def applied(self, u: Array, state: tuple[Any, Any, Any, float]) -> tuple[Any, Any, Any, float]:
        """Return the state, the integral as it was where another force is applied."""
        integral, gain, asked, dt = state
        differs = np.max(np.abs(u - asked), axis=-1, keepdims=True) > 0
        return integral - np.where(differs, gain, 0.0), gain, asked, dt

    def signals(self, state: tuple[Any, Any, Any, float]) -> dict[str, Any]:
        """Return the integral of the error."""
        return {"integral": ("m s, rad s", state[0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, float]
    ) -> tuple[Array, tuple[Any, Any, Any, float]]:
        """Return the generalised force, shape (..., n), and the next state."""
        integral, _, _, dt = state
        difference = self.difference or self.robot.difference
        command = reference.a + feedback(self, q, v, reference, difference)
        command = command + amplified("ki", self.ki, integral)
        tau = self.robot.inverse_dynamics(q, v, command)
        gain = dt * difference(q, reference.q)
        return tau, (integral + gain, gain, tau, dt)


@final
@part
class Decoupled(OfBody):
    """Computed torque of the base and of the arms, each ignoring that the other moves.

    The base sees the arms as a load that is locked where they are, as `MobileRobot.lumped` has it; the arms
    see themselves on a base at rest, gravity included. With c = a_d + Kd e_dot + Kp e, parted into base and
    arms,

        tau_base = M_bb(q) c_b + n_b(q, (v_b, 0)),      tau_arm = M_aa(q) c_a + n_a(q, (0, v_a)).

    What `ComputedTorque` has beyond that is the coupling: M_ba, M_ab, and the products of v_b and v_a.

    Parameters
    ----------
    robot : MobileRobot
        The model that the controller believes in; it need not be the one that is simulated.
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains [1/s^2] and [1/s]: a scalar, one per coordinate, or a matrix.
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own.
    """

    robot: Any = child(Invertible, doc="model of the controller")
    kp: Any = gain(default=4.0, unit="1/s^2", doc="proportional gain", size=coordinates_of)
    kd: Any = gain(default=4.0, unit="1/s", doc="derivative gain", size=coordinates_of)
    difference: Any = comparison()

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        command = reference.a + feedback(self, q, v, reference)
        base = self.robot.inverse_dynamics(q, *map(_of_base, (v, command)))
        arms = self.robot.inverse_dynamics(q, *map(_of_arms, (v, command)))
        return np.concatenate([base[..., :_BASE], arms[..., _BASE:]], axis=-1), None


def _of_base(rate: Array) -> Array:
    part = np.zeros(rate.shape)
    part[..., :_BASE] = rate[..., :_BASE]
    return part


def _of_arms(rate: Array) -> Array:
    part = np.zeros(rate.shape)
    part[..., _BASE:] = rate[..., _BASE:]
    return part


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
