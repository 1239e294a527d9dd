"""Kinematic laws, from tracking error to speed and yaw rate, and torques of robots that follow them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, final

import numpy as np

from pinmobile.arrays import Array, callable_as, frozen, wrap_angle
from pinmobile.controllers.controller import State, check_wheels
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.parts import Commanded, Rolling, able, child, number, part, structure
from pinmobile.plant import Context, check_coordinates, full_configurations

_SERIES_ANGLE = 1e-3  # [rad]; below it, sin(x) / x is computed by its series
_SPEED_TOLERANCE = 1e-6  # [m/s, rad/s]; a reference below it is at rest

LAW = "a kinematic law, such as UnicycleTracking()"
"""Words of error messages for the expected law."""


@final
class DualNumber:
    """Number, array or symbol together with its rate of change (a dual number).

    Arithmetic applies the chain rule, so a kinematic law returns commands together with their rates.

    Parameters
    ----------
    value, rate : scalar or ndarray, shape (...)
        Value in its unit, and its rate [unit/s].

    See Also
    --------
    controllers.KinematicLaw : laws that compute with these numbers
    controllers.TrackingState : the tracking error, made of these numbers

    Examples
    --------
    >>> from pinmobile.controllers import DualNumber
    >>> distance = DualNumber(3.0, 0.5)  # [m, m/s]
    >>> area = distance * distance
    >>> area  # [m^2, m^2/s]
    DualNumber(9.0, 3.0)
    """

    __array_ufunc__ = None  # operators of arrays call those of this class

    def __init__(self, value: Any, rate: Any) -> None:
        self.value, self.rate = value, rate

    def __repr__(self) -> str:
        return f"DualNumber({self.value!r}, {self.rate!r})"

    def __add__(self, other: Any) -> DualNumber:
        return DualNumber(self.value + value_of(other), self.rate + rate_of(other))

    __radd__ = __add__

    def __neg__(self) -> DualNumber:
        return DualNumber(-self.value, -self.rate)

    def __sub__(self, other: Any) -> DualNumber:
        return DualNumber(self.value - value_of(other), self.rate - rate_of(other))

    def __rsub__(self, other: Any) -> DualNumber:
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> DualNumber:
        if not isinstance(other, DualNumber):
            return DualNumber(self.value * other, self.rate * other)
        return DualNumber(self.value * other.value, self.rate * other.value + self.value * other.rate)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> DualNumber:
        if not isinstance(other, DualNumber):
            return DualNumber(self.value / other, self.rate / other)
        value = self.value / other.value
        return DualNumber(value, (self.rate - value * other.rate) / other.value)

    def __rtruediv__(self, other: Any) -> DualNumber:
        return DualNumber(other, 0.0 * self.value).__truediv__(self)


def value_of(x: Any) -> Any:
    """Return the value of a number that may have a rate."""
    return x.value if isinstance(x, DualNumber) else x


def rate_of(x: Any) -> Any:
    """Return the rate of a number; 0 for a number without one."""
    return x.rate if isinstance(x, DualNumber) else 0.0


def _chain_rule(function: Callable[[Any], Any], slope: Callable[[Any], Any], x: Any) -> Any:
    """Return a function of a number, with its rate by the chain rule."""
    if not isinstance(x, DualNumber):
        return function(x)
    return DualNumber(function(x.value), slope(x.value) * x.rate)


def sin(x: Any) -> Any:
    """Return the sine, with its rate."""
    return _chain_rule(np.sin, np.cos, x)


def cos(x: Any) -> Any:
    """Return the cosine, with its rate."""
    return _chain_rule(np.cos, lambda value: -np.sin(value), x)


def tanh(x: Any) -> Any:
    """Return the hyperbolic tangent, with its rate."""
    return _chain_rule(np.tanh, lambda value: 1.0 - np.tanh(value) * np.tanh(value), x)


def arctan(x: Any) -> Any:
    """Return the arctangent, with its rate."""
    return _chain_rule(np.arctan, lambda value: 1.0 / (1.0 + value * value), x)


def root(x: Any) -> Any:
    """Return the square root, with its rate; the rate is 0 where x is 0."""

    def slope(value: Any) -> Any:
        return np.where(value > 0.0, 0.5 / np.sqrt(np.where(value > 0.0, value, 1.0)), 0.0)

    return _chain_rule(np.sqrt, slope, x)


def angle_of(y: Any, x: Any) -> Any:
    """Return the angle of the vector (x, y), with its rate; the rate is 0 at the origin."""
    angle = np.arctan2(value_of(y), value_of(x))
    if not (isinstance(x, DualNumber) or isinstance(y, DualNumber)):
        return angle
    a, b = value_of(y), value_of(x)
    square = a * a + b * b
    turn = rate_of(y) * b - a * rate_of(x)
    return DualNumber(angle, turn / np.where(square > 0.0, square, 1.0))


def sinc(x: Any) -> Any:
    """Return sin(x) / x, with its rate."""

    def function(value: Any) -> Any:
        is_small = np.abs(value) < _SERIES_ANGLE
        return np.where(is_small, 1.0 - value * value / 6.0, np.sin(value) / np.where(is_small, 1.0, value))

    def slope(value: Any) -> Any:
        is_small = np.abs(value) < _SERIES_ANGLE
        divisor = np.where(is_small, 1.0, value)
        return np.where(is_small, -value / 3.0, (np.cos(value) - np.sin(value) / divisor) / divisor)

    return _chain_rule(function, slope, x)


def select(condition: Any, x: Any, y: Any) -> Any:
    """Return x where a condition holds, else y, with the rate."""
    value = np.where(condition, value_of(x), value_of(y))
    if not (isinstance(x, DualNumber) or isinstance(y, DualNumber)):
        return value
    return DualNumber(value, np.where(condition, rate_of(x), rate_of(y)))


class TrackingState(NamedTuple):
    """Tracking error for a kinematic law, of the point on the fixed axle, along the body's axes of motion.

    Attributes
    ----------
    ahead, aside : scalar
        Position of the reference relative to the body, forward and to the left [m].
    turn : scalar
        Heading of the reference relative to the body, in (-pi, pi] [rad].
    speed, yaw_rate : scalar
        Speed and yaw rate of the reference [m/s, rad/s].
    acceleration : scalar
        Rate of the reference's speed [m/s^2].
    own_speed : scalar
        Speed of the body [m/s].

    See Also
    --------
    controllers.KinematicLaw : law that takes it

    Examples
    --------
    >>> from pinmobile import UnicycleTracking
    >>> from pinmobile.controllers import TrackingState
    >>> error = TrackingState(ahead=0.1, aside=0.0, turn=0.0,
    ...                 speed=1.0, yaw_rate=0.0)
    >>> (v, w), _ = UnicycleTracking(zeta=0.7, b=20.0)(error, None)
    >>> print(f"{v:.2f} m/s, {w:.2f} rad/s")
    1.63 m/s, 0.00 rad/s
    """

    ahead: Any
    aside: Any
    turn: Any
    speed: Any
    yaw_rate: Any
    acceleration: Any = 0.0
    own_speed: Any = 0.0


class KinematicLaw(Protocol):
    """A kinematic law, such as UnicycleTracking(): from a tracking error to speed and yaw rate.

    See Also
    --------
    UnicycleTracking : law for moving references
    controllers.Parking : law for a goal at rest
    Backstepping : torques from a kinematic law
    controllers.VelocityCommand : commands from a kinematic law

    Examples
    --------
    >>> from pinmobile.controllers import TrackingState
    >>> class Proportional:
    ...     def initial_state(self, context):
    ...         return None
    ...     def check(self, t, speed, yaw_rate):
    ...         pass
    ...     def __call__(self, tracked, state):
    ...         x, y, turn, speed, yaw_rate = tracked[:5]
    ...         v, w = speed + 2 * x, yaw_rate + 9 * y + 4 * turn
    ...         return (v, w), state
    >>> Proportional()(TrackingState(0.1, 0.0, 0.0, 1.0, 0.2), None)[0]
    (1.2, 0.2)
    """

    def initial_state(self, context: Context, /) -> Any:
        """Return the state before the first sample; None without memory."""

    def check(self, t: Array, speed: Array, yaw_rate: Array, /) -> None:
        """Raise `InvalidArgument` for a reference that the law cannot follow.

        Parameters
        ----------
        t : ndarray, shape (N,)
            Times of the samples [s].
        speed, yaw_rate : ndarray, shape (N,)
            Speed and yaw rate of the reference [m/s, rad/s].
        """

    def __call__(self, tracked: TrackingState, state: Any, /) -> tuple[tuple[Any, Any], Any]:
        """Return the desired speed and yaw rate, and the next state.

        Parameters
        ----------
        tracked : TrackingState
            Tracking error; its entries may have a rate, see `controllers.DualNumber`.
        state : any
            State of the law.

        Returns
        -------
        command : tuple of 2 scalars
            Speed and yaw rate [m/s, rad/s].
        state : any
            The next state.
        """


def refuse_reference(wrong: Any, words: Callable[[int], str]) -> None:
    """Raise `InvalidArgument` with words about the first sample of a reference at which a condition holds."""
    if np.any(wrong):
        raise InvalidArgument(f"reference {words(int(np.argmax(wrong)))}")


@final
@part
class UnicycleTracking:
    """Tracking of a moving reference, forwards or backwards (De Luca, Oriolo and Vendittelli, 2001).

    ::

        v = v_r cos et + k ex,  w = w_r + b v_r (sin et / et) ey + k et,  k = 2 zeta sqrt(w_r^2 + b v_r^2)

    With V = b (ex^2 + ey^2) / 2 + et^2 / 2, dV/dt = -k (b ex^2 + et^2): the reference must not rest for good.
    Near the reference, errors decay as (s + 2 zeta a)(s^2 + 2 zeta a s + a^2), a^2 = w_r^2 + b v_r^2.

    Parameters
    ----------
    zeta : float
        Damping ratio, > 0.
    b : float
        Weight of the position error relative to the heading error, > 0 [1/m^2].

    Raises
    ------
    InvalidArgument
        If a parameter is not above zero; at the start of a run, if the reference never moves.

    See Also
    --------
    Backstepping : torques or commands from this law
    controllers.VelocityCommand : commands from this law
    controllers.Kanayama : law for references that move forwards
    controllers.Parking : law for a goal at rest

    Examples
    --------
    >>> from pinmobile import UnicycleTracking
    >>> from pinmobile.controllers import TrackingState
    >>> error = TrackingState(ahead=0.1, aside=0.0, turn=0.0,
    ...                 speed=1.0, yaw_rate=0.0)
    >>> (v, w), _ = UnicycleTracking(zeta=0.7, b=20.0)(error, None)
    >>> print(f"{v:.2f} m/s, {w:.2f} rad/s")
    1.63 m/s, 0.00 rad/s
    """

    zeta: float = number(default=0.7, above=0.0, doc="damping ratio of the tracking law")
    b: float = number(default=20.0, above=0.0, unit="1/m^2", doc="weight of position beside heading")

    def initial_state(self, context: Context) -> None:
        """Return None: the law has no memory."""

    def check(self, t: Array, speed: Array, yaw_rate: Array) -> None:
        """Raise `InvalidArgument` for a reference that never moves."""
        if not (np.abs(speed) > _SPEED_TOLERANCE).any() and not (np.abs(yaw_rate) > _SPEED_TOLERANCE).any():
            raise InvalidArgument("reference rests, expected a reference that moves, or the law Parking()")

    def __call__(self, tracked: TrackingState, state: None) -> tuple[tuple[Any, Any], None]:
        """Return (v, w) [m/s, rad/s], and None."""
        x, y, turn, speed, yaw_rate = tracked[:5]
        k = 2.0 * self.zeta * root(yaw_rate * yaw_rate + self.b * (speed * speed))
        v = speed * cos(turn) + k * x
        return (v, yaw_rate + self.b * (speed * sinc(turn) * y) + k * turn), None


@final
@part
class Kanayama:
    """Tracking of a reference that moves forwards (Kanayama, Kimura, Miyazaki and Noguchi, ICRA 1990).

    ::

        v = v_r cos et + k1 ex,  w = w_r + v_r (k2 ey + k3 sin et)

    With V = (ex^2 + ey^2) / 2 + (1 - cos et) / k2, dV/dt = -k1 ex^2 - (k3 / k2) v_r sin^2 et, which requires
    v_r > 0.

    Parameters
    ----------
    k1, k2, k3 : float
        Gains along the path, across it, and of the heading, > 0 [1/s, 1/m^2, 1/m].

    Raises
    ------
    InvalidArgument
        If a gain is not above zero; at the start of a run, if the reference stops or moves backwards.

    See Also
    --------
    UnicycleTracking : law for both directions
    Backstepping : torques or commands from this law

    Examples
    --------
    >>> from pinmobile.controllers import Kanayama, TrackingState
    >>> error = TrackingState(ahead=0.0, aside=0.1, turn=0.0,
    ...                 speed=1.0, yaw_rate=0.0)
    >>> (v, w), _ = Kanayama(k1=2.0, k2=10.0, k3=5.0)(error, None)
    >>> print(f"{v:.2f} m/s, {w:.2f} rad/s")
    1.00 m/s, 1.00 rad/s
    """

    k1: float = number(default=2.0, above=0.0, unit="1/s", doc="gain along the path")
    k2: float = number(default=10.0, above=0.0, unit="1/m^2", doc="gain across the path")
    k3: float = number(default=5.0, above=0.0, unit="1/m", doc="gain of the heading")

    def initial_state(self, context: Context) -> None:
        """Return None: the law has no memory."""

    def check(self, t: Array, speed: Array, yaw_rate: Array) -> None:
        """Raise `InvalidArgument` for a reference that stops or moves backwards."""
        refuse_reference(
            speed <= _SPEED_TOLERANCE,
            lambda k: (
                f"has a speed of {speed[k]:.3g} m/s at t = {t[k]:g} s, expected a reference that always "
                "moves forwards, or the law UnicycleTracking()"
            ),
        )

    def __call__(self, tracked: TrackingState, state: None) -> tuple[tuple[Any, Any], None]:
        """Return (v, w) [m/s, rad/s], and None."""
        x, y, turn, speed, yaw_rate = tracked[:5]
        v = speed * cos(turn) + self.k1 * x
        return (v, yaw_rate + speed * (self.k2 * y + self.k3 * sin(turn))), None


@final
@part
class Parking:
    """Motion to a pose at rest (Aicardi, Casalino, Bicchi and Balestrino, IEEE RAM 2(1), 1995).

    ::

        v = k1 rho cos gam,  w = k2 gam + k1 (sin gam cos gam / gam) (gam + k3 del)

    rho is the distance of the goal, gam its bearing relative to the body's heading, and del its bearing
    relative to the heading at the goal. With V = (rho^2 + gam^2 + k3 del^2) / 2, dV/dt = -k1 rho^2 cos^2 gam
    - k2 gam^2. The heading converges slowly; no smooth law of the pose alone converges faster (Brockett,
    1983). The reference must rest. The robot stops within `near` of it.

    Parameters
    ----------
    k1, k2, k3 : float
        Gains of the distance, the bearing and the approach, > 0 [1/s, 1/s, 1].
    near : float
        Distance of the goal within which the robot stops, > 0 [m].

    Raises
    ------
    InvalidArgument
        If a parameter is not above zero; at the start of a run, if the reference moves.

    See Also
    --------
    UnicycleTracking : law for moving references
    Hold : path of a goal at rest

    Examples
    --------
    >>> from pinmobile.controllers import Parking, TrackingState
    >>> error = TrackingState(ahead=1.0, aside=0.0, turn=0.0,
    ...                 speed=0.0, yaw_rate=0.0)
    >>> (v, w), _ = Parking(k1=0.5)(error, None)
    >>> print(f"{v:.2f} m/s, {w:.2f} rad/s")
    0.50 m/s, 0.00 rad/s
    """

    k1: float = number(default=1.0, above=0.0, unit="1/s", doc="gain of the distance")
    k2: float = number(default=3.0, above=0.0, unit="1/s", doc="gain of the bearing")
    k3: float = number(default=2.0, above=0.0, doc="gain of the approach")
    near: float = number(default=1e-3, above=0.0, unit="m", doc="distance at which the robot stops")

    def initial_state(self, context: Context) -> None:
        """Return None: the law has no memory."""

    def check(self, t: Array, speed: Array, yaw_rate: Array) -> None:
        """Raise `InvalidArgument` for a reference that moves."""
        refuse_reference(
            np.hypot(speed, yaw_rate) > _SPEED_TOLERANCE,
            lambda k: f"moves at t = {t[k]:g} s, expected a goal at rest, or the law UnicycleTracking()",
        )

    def __call__(self, tracked: TrackingState, state: None) -> tuple[tuple[Any, Any], None]:
        """Return (v, w) [m/s, rad/s], and None."""
        x, y = tracked.ahead, tracked.aside
        square = x * x + y * y
        is_at_goal = value_of(square) < self.near * self.near
        rho, bearing = root(square), angle_of(y, x)
        approach = _wrap(bearing - tracked.turn)
        v = self.k1 * (rho * cos(bearing))
        w = self.k2 * bearing + self.k1 * (sinc(bearing) * cos(bearing) * (bearing + self.k3 * approach))
        return (select(is_at_goal, 0.0, v), select(is_at_goal, 0.0, w)), None


def _wrap(x: Any) -> Any:
    """Return an angle wrapped to [-pi, pi], with its rate."""
    value = value_of(x)
    value = value - 2 * np.pi * np.rint(value / (2 * np.pi))
    return DualNumber(value, x.rate) if isinstance(x, DualNumber) else value


@final
@part
class DynamicFeedback:
    """Tracking by dynamic feedback linearisation, for a reference that never rests (Oriolo et al., 2002).

    The speed xi is the memory of the law. With r = p_r'' + kd (p_r' - p') + kp (p_r - p) along the body's
    axes::

        d xi/dt = r_ahead,  v = xi,  w = r_aside / xi

    Position errors decay as s^2 + kd s + kp, and the heading follows. xi starts at the reference's speed, and
    the division uses at least `least`. Therefore the reference must be faster than `least`, without rests and
    cusps.

    Parameters
    ----------
    kp, kd : float
        Gains of position and velocity, > 0 [1/s^2, 1/s].
    least : float
        Smallest speed in the division, > 0 [m/s].

    Raises
    ------
    InvalidArgument
        If a parameter is not above zero; at the start of a run, if the reference is slower than `least` or
        reverses.

    See Also
    --------
    UnicycleTracking : law without memory
    Backstepping : torques or commands from this law

    Examples
    --------
    >>> from pinmobile.controllers import DynamicFeedback, TrackingState
    >>> error = TrackingState(ahead=0.1, aside=0.0, turn=0.0, speed=1.0,
    ...                 yaw_rate=0.0, own_speed=1.0)
    >>> memory = (0.0, 0.0, 0.01)
    >>> (v, w), (v_next, *_) = DynamicFeedback(kp=2.0)(error, memory)
    >>> print(f"{v.value:.3f} m/s, then {v_next:.3f} m/s")
    1.000 m/s, then 1.002 m/s
    """

    kp: float = number(default=2.0, above=0.0, unit="1/s^2", doc="gain of the position error")
    kd: float = number(default=2.8, above=0.0, unit="1/s", doc="gain of the velocity error")
    least: float = number(default=0.05, above=0.0, unit="m/s", doc="smallest speed in the division")

    def initial_state(self, context: Context) -> tuple[float, float, float]:
        """Return the speed [m/s], 0 until it is initialised, and the time step [s]."""
        return 0.0, 0.0, float(context.dt)

    def check(self, t: Array, speed: Array, yaw_rate: Array) -> None:
        """Raise `InvalidArgument` for a reference that rests or reverses."""
        refuse_reference(
            speed * np.sign(speed[0]) < self.least,
            lambda k: (
                f"has a speed of {speed[k]:.3g} m/s at t = {t[k]:g} s, expected {self.least:g} m/s or "
                "more, always in one direction, or the law UnicycleTracking()"
            ),
        )

    def __call__(
        self, tracked: TrackingState, state: tuple[Any, Any, Any]
    ) -> tuple[tuple[Any, Any], tuple[Any, Any, Any]]:
        """Return (v, w) [m/s, rad/s], and the next state."""
        x, y, turn, speed, yaw_rate, acceleration, own_speed = tracked
        xi, has_speed, dt = state
        xi = xi + (1.0 - has_speed) * value_of(speed)
        c, s, centripetal = cos(turn), sin(turn), speed * yaw_rate
        a_x = acceleration * c - centripetal * s + self.kd * (speed * c - own_speed) + self.kp * x
        a_y = acceleration * s + centripetal * c + self.kd * (speed * s) + self.kp * y
        rate = value_of(a_x)
        is_fast = np.abs(xi) >= self.least
        divisor = np.where(is_fast, xi, np.where(xi < 0.0, -self.least, self.least))
        w = a_y / DualNumber(divisor, np.where(is_fast, rate, 0.0))
        if not isinstance(x, DualNumber):
            w = w.value
        return (DualNumber(xi, rate), w), (xi + dt * rate, 1.0 + 0.0 * has_speed, dt)


_BASE = 3
_LATERAL_TOLERANCE = 1e-6  # [m/s], and relative to the speed: tolerance of motion across the axle
_HEADING_JUMP = 0.1  # [rad]: largest difference of the heading's step and the integral of its rate
_MIN_SPEED = 1e-3  # [m/s]: smallest forward speed of a steered wheel in its direction
_NO_AXLE = 1e-9  # added to a square, which is 0 where both axles lie on one line
_KINDS = ((2, 0), (1, 1))
_ANGLE_TOLERANCE = 1e-9  # relative: a reference may stay at the limit of the steering


@final
@part
class Backstepping:
    """Torques or commands from a kinematic law (Fierro and Lewis, J. Robotic Systems 14(3), 1997).

    ::

        M dnu/dt + n = B u,   dnu/dt = dnu_c/dt + k (nu_c - nu)

    nu are the independent velocities of a robot whose wheels roll: speed and yaw rate of a differential
    drive, speed and steering rate of a car, and the velocities of arms. The law gives nu_c, and the chain
    rule its rate. The steering angle of a car tracks delta_c, at which the wheel rolls as the law commands,
    with the rate ``d(delta_c)/dt + steer (delta_c - delta)``; the second derivative of delta_c is the
    reference's, by its last two samples. Arms follow their reference with ``v_r + arms (q_r - q)``.

    The reference is the pose of the body. It must move along the wheels of the fixed axle: a path of the
    body's origin with its tangent as heading, if the origin lies on the axle. A reference that moves
    sideways, or whose heading jumps, raises an error with the time at the start of a run. References that
    differ between the robots of an ensemble are not checked.

    Parameters
    ----------
    law : kinematic law
        Law from tracking error to speed and yaw rate, such as `UnicycleTracking`, which states its conditions
        on the reference.
    robot : WheeledRobot or VelocityRobot
        Controller model; for a `VelocityRobot` the input is commands.
    k, steer, arms : float
        Gains of the velocities, the steering angle and the arms, > 0 [1/s]. The zero-order hold requires
        k dt < 0.5.

    Raises
    ------
    InvalidArgument
        If a gain is not above zero, or the drive has no fixed axle, can move in every direction, or lacks a
        motor for an independent velocity; at the start of a run, if the wheels or the law cannot follow the
        reference.

    See Also
    --------
    UnicycleTracking : a kinematic law
    controllers.WheelSpeed : the same law with a PI loop per wheel
    ComputedTorque : law for omnidirectional drives
    LQR : optimal law along a reference

    Examples
    --------
    >>> from pinmobile import Backstepping, Circle, MobileRobot
    >>> from pinmobile import Tangent, UnicycleTracking, WheeledRobot
    >>> from pinmobile import WheelTable, simulate
    >>> wheels = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), wheels)
    >>> law = Backstepping(UnicycleTracking(), robot)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=1.0))
    >>> run = simulate(robot, law, path, dt=0.05, v0=0 * robot.rest)
    >>> print(f"{1e3 * max(run.max_error()[:2]):.0f} mm from rest")
    16 mm from rest
    """

    law: Any = child(KinematicLaw, doc="kinematic law", expected=LAW)
    robot: Any = child(Rolling, doc="model of the controller")
    k: float = number(default=10.0, above=0.0, unit="1/s", doc="gain of the velocities")
    steer: float = number(default=10.0, above=0.0, unit="1/s", doc="gain of the steering angle")
    arms: float = number(default=2.0, above=0.0, unit="1/s", doc="gain of the arms")

    def check(self) -> None:
        """Raise `InvalidArgument` if the drive has no fixed axle, or too few motors."""
        callable_as("law(tracked, state)", self.law)
        mobility = self.robot.mobility
        if not has_axle(mobility):
            alternatives = {(3, 0): "ComputedTorque(robot)", (1, 2): "SwerveTracking(robot)"}
            kind = mobility.mobility, mobility.steerability
            alternative = alternatives.get(kind, "ControlAllocation(controller, robot)")
            if not mobility.is_regular:
                alternative = "WheelSpeed(law, robot, kp), where no wheel steers"
            raise InvalidArgument(
                f"robot is {mobility.kind}, expected a drive with a fixed axle: for this one, {alternative}"
            )
        check_wheels(self.robot)

    @structure
    def _n(self) -> int:
        """Number of coordinates of a reference: x, y, psi and those of the arms."""
        return int(max(self.robot.reference_sizes))

    @structure
    def _steering_limit(self) -> tuple[float, Array] | None:
        """Largest steering angle [rad], and pose of the steered wheel; None for a fixed axle alone."""
        robot = self.robot
        if not robot.mobility.steerability:
            return None
        return min(float(robot.coordinates[self._n].upper), np.pi / 2 - 1e-3), frozen(robot.pivots[0])

    @structure
    def _axle(self) -> Array:
        """Coefficients of the robot's axle, which references must follow, shape (3,)."""
        return frozen(self.robot.axle)

    def initial_state(self, context: Context) -> tuple[Any, Any]:
        """Return the law's state, and the memory of the reference's steering rate."""
        reference = reference_of(context)
        if reference is not None:
            self._check_reference(np.asarray(context.t), reference)
        steering = None if self._steering_limit is None else (0.0, 0.0, float(context.dt))
        return self.law.initial_state(context), steering

    def _check_reference(self, t: Array, reference: Any) -> None:
        """Raise `InvalidArgument` for a reference that the wheels cannot follow."""
        check_coordinates(reference.v, self._n, ": x, y, psi and those of arms")
        speed, w = reference_speeds(self._axle, t, reference)
        if self._steering_limit is not None:
            limit, pivot = self._steering_limit
            angle = np.abs(_steering_angle(self._axle, pivot, speed, w))
            refuse_reference(
                angle > limit * (1 + _ANGLE_TOLERANCE),
                lambda k: (
                    f"needs a steering angle of {angle[k]:.3g} rad at t = {t[k]:g} s, expected at most "
                    f"{limit:.3g} rad"
                ),
            )
        self.law.check(t, speed, w)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any]
    ) -> tuple[Array, tuple[Any, Any]]:
        """Return the input, shape (..., nu), and the next state."""
        inner, steering = state
        nu, n = self.robot.independent(q, v), self._n
        error_state, errors = tracking_error(self.robot, self.robot.axle, q, v, reference, nu[..., 0])
        (speed, yaw_rate), inner = self.law(error_state, inner)
        desired_nu = [speed] if self._steering_limit else [speed, yaw_rate]
        for i in range(_BASE, n):
            rate, desired = reference.v[..., i] - v[..., i], reference.v[..., i]
            desired_nu.append(
                DualNumber(desired + self.arms * errors[..., i], reference.a[..., i] + self.arms * rate)
            )
        if self._steering_limit:
            turn, steering = self._steering_rate(q, nu, error_state, (speed, yaw_rate), steering)
            desired_nu.append(turn)
        rates = [rate_of(z) + self.k * (value_of(z) - nu[..., i]) for i, z in enumerate(desired_nu)]
        nu_rates = np.stack(np.broadcast_arrays(*rates), axis=-1)
        velocity_robot = able(self.robot, Commanded)
        inverse = velocity_robot.commands if velocity_robot else self.robot.torques
        return inverse(q, v, nu_rates), (inner, steering)

    def _steering_rate(
        self,
        q: Array,
        nu: Array,
        error_state: TrackingState,
        command: tuple[Any, Any],
        memory: tuple[Any, Any, Any],
    ) -> tuple[DualNumber, tuple[Any, Any, Any]]:
        """Return the desired steering rate with its own rate, and the next memory of the reference's."""
        last_rate, has_rate, dt = memory
        limit, _ = self._steering_limit or (np.inf, None)
        angle = q[..., self._n]
        desired = self._angle(*command)
        size = value_of(desired)
        desired = select(np.abs(size) > limit, np.sign(size) * limit, desired)
        rate = rate_of(self._angle(error_state.speed, error_state.yaw_rate))
        acceleration = has_rate * (rate - last_rate) / dt
        turning = rate_of(desired)  # 0 for a command that is constant between samples
        desired_rate = turning + self.steer * (value_of(desired) - angle)
        turn = DualNumber(desired_rate, acceleration + self.steer * (turning - nu[..., -1]))
        return turn, (rate, 1.0 + 0.0 * has_rate, dt)

    def _angle(self, speed: Any, yaw_rate: Any) -> Any:
        """Return the steering angle at which the wheel rolls at a speed and yaw rate, with its rate [rad]."""
        return _steering_angle(self.robot.axle, self.robot.pivots[..., 0, :], speed, yaw_rate)


def has_axle(mobility: Any) -> bool:
    """Return whether a drive has exactly one fixed axle, which restricts its motion."""
    return (mobility.mobility, mobility.steerability) in _KINDS


def reference_of(context: Context) -> Any:
    """Return the reference at all samples; None if each robot has its own, or the context has none."""
    try:
        return context.reference
    except NotTraceable:
        return None


def check_law(law: KinematicLaw, axle: Array, context: Context) -> None:
    """Raise `InvalidArgument` for a reference that an axle or a law cannot follow."""
    reference, t = reference_of(context), np.asarray(context.t)
    if reference is not None:
        law.check(t, *reference_speeds(axle, t, reference))


def check_heading(t: Array, reference: Any) -> tuple[Array, Array]:
    """Return headings and yaw rates of a reference, shape (N,), after a check for jumps.

    Raises
    ------
    InvalidArgument
        If the heading jumps.
    """
    psi, w = reference.q[:, 2], reference.v[:, 2]
    jumps = np.abs(wrap_angle(np.diff(psi) - np.diff(t) * (w[1:] + w[:-1]) / 2))
    refuse_reference(
        jumps > _HEADING_JUMP,
        lambda k: (
            f"has a jump of its heading by {jumps[k]:.3g} rad at t = {t[k + 1]:g} s, expected one that "
            "the wheels can follow, such as Tangent(path, turn_time=...)"
        ),
    )
    return psi, w


@final
@part
class SwerveTracking:
    """Tracking of a pose with two modules that steer and drive, by torques of both.

    The desired body twist is the reference's twist with feedback of the pose, u = R' v_r + kp e. Each module
    turns to the direction of its desired velocity, or to the opposite direction if that is nearer, as
    `Backstepping` steers a car. The drives produce the part of u that the present steering angles allow. The
    reference must keep each module moving, and the two axles must not lie on one line. A module slower than
    `least` keeps its angle.

    Parameters
    ----------
    robot : WheeledRobot
        Controller model: two modules, without arms.
    kp, k, steer : float
        Gains of the pose, the velocities and the steering angles, > 0 [1/s].
    least : float
        Speed of a module below which it keeps its angle, > 0 [m/s].

    Raises
    ------
    InvalidArgument
        If a parameter is not above zero, or the robot has another drive; at the start of a run, if the
        heading of the reference jumps.

    See Also
    --------
    Backstepping : law for drives with a fixed axle
    WheelTable : its constructor `swerve` makes such a drive

    Examples
    --------
    >>> from pinmobile import Circle, Engine, FixedHeading
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> from pinmobile import simulate
    >>> from pinmobile.controllers import SwerveTracking
    >>> wheels = WheelTable.swerve([(0.3, 0), (-0.3, 0)], radius=0.1,
    ...     spin_inertia=0.01, yaw_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), wheels)
    >>> circle = Circle(radius=3.0, rate=0.1, duration=0.5)
    >>> path = FixedHeading(circle, psi=0.3)
    >>> run = simulate(robot, SwerveTracking(robot), path, dt=0.05,
    ...                engine=Engine.PYTHON)
    >>> print(f"{1e3 * max(run.max_error()[:2]):.2f} mm")
    0.10 mm
    """

    robot: Any = child(Rolling, doc="model of the controller")
    kp: float = number(default=2.0, above=0.0, unit="1/s", doc="gain of the pose")
    k: float = number(default=10.0, above=0.0, unit="1/s", doc="gain of the velocities")
    steer: float = number(default=10.0, above=0.0, unit="1/s", doc="gain of the steering angles")
    least: float = number(
        default=0.05, above=0.0, unit="m/s", doc="speed of a module below which it keeps its angle"
    )

    def check(self) -> None:
        """Raise `InvalidArgument` if the robot has another drive."""
        robot = self.robot
        kind = robot.mobility.mobility, robot.mobility.steerability
        if kind != (1, 2) or max(robot.reference_sizes) > _BASE or len(robot.inputs) != 4:
            raise InvalidArgument(
                f"robot is of type {kind} with {len(robot.inputs)} inputs, expected two modules that steer "
                "and drive, without arms"
            )
        check_wheels(robot)

    def initial_state(self, context: Context) -> tuple[Any, float, float]:
        """Return the last steering rates of the reference, 0 until they are known, and the time step."""
        reference = reference_of(context)
        if reference is not None:
            check_heading(np.asarray(context.t), reference)
        return np.zeros(2), 0.0, float(context.dt)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any]
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the input, shape (..., 4), and the next state."""
        last_rates, has_rates, dt = state
        nu = self.robot.independent(q, v)
        twist = self._desired_twist(q, v, reference)
        twist_r = self._reference_twist(reference)
        rates, reference_rates, axles = [], [], []
        for i in range(2):
            x, y, zero = (self.robot.pivots[..., i, j] for j in range(3))
            angle, steering_rate = q[..., _BASE + i], nu[..., 1 + i]
            forward, left = twist[0] - twist[2] * y, twist[1] + twist[2] * x
            target = angle_of(left, forward) - zero
            nearest = DualNumber(target.value + np.pi * np.rint((angle - target.value) / np.pi), target.rate)
            is_slow = value_of(forward * forward + left * left) < self.least * self.least
            goal = select(is_slow, DualNumber(angle, 0.0 * angle), nearest)
            reference_rate = angle_of(twist_r[1] + twist_r[2] * x, twist_r[0] - twist_r[2] * y).rate
            reference_rates.append(reference_rate)
            extra = np.where(is_slow, 0.0, np.asarray(has_rates) * (reference_rate - last_rates[..., i]) / dt)
            z = goal.rate + self.steer * (goal.value - angle)
            rates.append(extra + self.steer * (goal.rate - steering_rate) + self.k * (z - steering_rate))
            head = DualNumber(angle + zero, steering_rate)
            axles.append([-sin(head), cos(head), x * cos(head) + y * sin(head)])
        (a, b, m), (d, e, f) = axles
        axis = [b * f - m * e, m * d - a * f, a * e - b * d]
        square = axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2] + _NO_AXLE
        share = (axis[0] * twist[0] + axis[1] * twist[1] + axis[2] * twist[2]) / square
        body_rate = share.rate + self.k * (share.value - nu[..., 0])
        u = self.robot.torques(q, v, np.stack(np.broadcast_arrays(body_rate, *rates), axis=-1))
        reference_rate = np.stack(np.broadcast_arrays(*reference_rates), axis=-1)
        return u, (reference_rate, 1.0 + 0.0 * has_rates, dt)

    def _desired_twist(self, q: Array, v: Array, reference: State) -> list[DualNumber]:
        """Return the desired body twist, with its rate."""
        errors, w = self.robot.difference(q, full_configurations(q, reference.q)), v[..., 2]
        e_x, e_y = _body_components(q, errors)
        (vx, vy), (rx, ry), (ax, ay) = (_body_components(q, x) for x in (v, reference.v, reference.a))
        w_r = reference.v[..., 2]
        return [
            DualNumber(rx, ax + w * ry) + self.kp * DualNumber(e_x, rx - vx + w * e_y),
            DualNumber(ry, ay - w * rx) + self.kp * DualNumber(e_y, ry - vy - w * e_x),
            DualNumber(w_r, reference.a[..., 2]) + self.kp * DualNumber(errors[..., 2], w_r - w),
        ]

    def _reference_twist(self, reference: State) -> list[DualNumber]:
        """Return the body twist of the reference, with its rate."""
        (rx, ry), (ax, ay) = (_body_components(reference.q, x) for x in (reference.v, reference.a))
        w = reference.v[..., 2]
        return [DualNumber(rx, ax + w * ry), DualNumber(ry, ay - w * rx), DualNumber(w, reference.a[..., 2])]


def _body_components(q: Array, x: Array) -> tuple[Any, Any]:
    """Return the components of a vector in the plane along the body's axes, forward and left."""
    c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
    return c * x[..., 0] + s * x[..., 1], c * x[..., 1] - s * x[..., 0]


def reference_speeds(axle: Array, t: Array, reference: Any) -> tuple[Array, Array]:
    """Return speed and yaw rate of a reference, shape (N,), for a drive with this fixed axle.

    Raises
    ------
    InvalidArgument
        If the reference moves sideways, or its heading jumps.
    """
    psi, w = check_heading(t, reference)
    a, b, arm = axle
    c, s = np.cos(psi), np.sin(psi)
    lateral = (a * c - b * s) * reference.v[:, 0] + (a * s + b * c) * reference.v[:, 1] + arm * w
    speed = (b * c + a * s) * reference.v[:, 0] + (b * s - a * c) * reference.v[:, 1]
    refuse_reference(
        np.abs(lateral) > _LATERAL_TOLERANCE * (1.0 + np.abs(speed)),
        lambda k: (
            f"moves sideways, at {lateral[k]:.3g} m/s across the fixed axle, at t = {t[k]:g} s, expected "
            "one that the wheels can follow, such as Tangent(path)"
        ),
    )
    return speed, w


def tracking_error(
    robot: Any, axle: Any, q: Array, v: Array, reference: State, own_speed: Any
) -> tuple[TrackingState, Array]:
    """Return the tracking error of a law, with its rates, and the errors of all coordinates."""
    a, b, arm = axle[..., 0], axle[..., 1], axle[..., 2]
    errors = robot.difference(q, full_configurations(q, reference.q))
    c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
    c_r, s_r = np.cos(reference.q[..., 2]), np.sin(reference.q[..., 2])
    # Directions of motion of body and reference, and positions of both axles.
    x, y, x_r, y_r = b * c + a * s, b * s - a * c, b * c_r + a * s_r, b * s_r - a * c_r
    dx = reference.q[..., 0] - q[..., 0] + arm * (x_r - x)
    dy = reference.q[..., 1] - q[..., 1] + arm * (y_r - y)
    vx, vy, w_r, w = reference.v[..., 0], reference.v[..., 1], reference.v[..., 2], v[..., 2]
    speed, turn = x_r * vx + y_r * vy, errors[..., 2]
    acceleration = x_r * reference.a[..., 0] + y_r * reference.a[..., 1] + w_r * (x_r * vy - y_r * vx)
    e_x, e_y = x * dx + y * dy, x * dy - y * dx
    error_state = TrackingState(
        DualNumber(e_x, w * e_y - own_speed + speed * np.cos(turn)),
        DualNumber(e_y, speed * np.sin(turn) - w * e_x),
        DualNumber(turn, w_r - w),
        DualNumber(speed, acceleration),
        DualNumber(w_r, reference.a[..., 2]),
        DualNumber(acceleration, 0.0 * acceleration),
        DualNumber(own_speed, 0.0 * own_speed),
    )
    return error_state, errors


def _steering_angle(axle: Any, pivot: Any, speed: Any, yaw_rate: Any) -> Any:
    """Return the angle at which a steered wheel rolls at a speed and yaw rate, with its rate [rad]."""
    a, b, arm = axle[..., 0], axle[..., 1], axle[..., 2]
    x, y = pivot[..., 0] - arm * b, pivot[..., 1] + arm * a  # from the axle
    c, s = np.cos(pivot[..., 2]), np.sin(pivot[..., 2])
    forward = (b * c - a * s) * speed + (x * s - y * c) * yaw_rate
    left = -(b * s + a * c) * speed + (x * c + y * s) * yaw_rate
    lowest = np.where(value_of(forward) < 0.0, -_MIN_SPEED, _MIN_SPEED)
    return arctan(left / select(np.abs(value_of(forward)) < _MIN_SPEED, lowest, forward))
