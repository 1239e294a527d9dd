"""Kinematic laws: from the error of a body on wheels to the speed and the yaw rate that it should have.

A law is called as ``law(tracked, state) -> ((v, w), state)`` with what it tracks, a `Tracked`. Its numbers
are floats, arrays or symbols, or such with their rates, `Changing`: then what comes out has its rate too, by
the chain rule, which `Backstepping` needs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.parts import number, part
from pinmobile.plant import Context

_SMALL = 1e-3  # [rad], below which sin(x) / x is its series
_STILL = 1e-6  # [m/s, rad/s], below which a reference is at rest

LAW = "a kinematic law, such as UnicycleTracking()"
"""What is expected where a law is missing."""


@final
class Changing:
    """A number, an array or a symbol, and the rate at which it changes.

    Parameters
    ----------
    value, rate : scalar or ndarray, shape (...)
        The rate is per second.
    """

    __array_ufunc__ = None  # arrays leave the operation to it

    def __init__(self, value: Any, rate: Any) -> None:
        self.value, self.rate = value, rate

    def __add__(self, other: Any) -> Changing:
        return Changing(self.value + value_of(other), self.rate + rate_of(other))

    __radd__ = __add__

    def __neg__(self) -> Changing:
        return Changing(-self.value, -self.rate)

    def __sub__(self, other: Any) -> Changing:
        return Changing(self.value - value_of(other), self.rate - rate_of(other))

    def __rsub__(self, other: Any) -> Changing:
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> Changing:
        if not isinstance(other, Changing):
            return Changing(self.value * other, self.rate * other)
        return Changing(self.value * other.value, self.rate * other.value + self.value * other.rate)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Changing:
        if not isinstance(other, Changing):
            return Changing(self.value / other, self.rate / other)
        value = self.value / other.value
        return Changing(value, (self.rate - value * other.rate) / other.value)

    def __rtruediv__(self, other: Any) -> Changing:
        return Changing(other, 0.0 * self.value).__truediv__(self)


def value_of(x: Any) -> Any:
    """Return the number itself."""
    return x.value if isinstance(x, Changing) else x


def rate_of(x: Any) -> Any:
    """Return the rate of a number; 0 of one that does not change."""
    return x.rate if isinstance(x, Changing) else 0.0


def _through(function: Callable[[Any], Any], slope: Callable[[Any], Any], x: Any) -> Any:
    if not isinstance(x, Changing):
        return function(x)
    return Changing(function(x.value), slope(x.value) * x.rate)


def sin(x: Any) -> Any:
    """Return the sine, with its rate."""
    return _through(np.sin, np.cos, x)


def cos(x: Any) -> Any:
    """Return the cosine, with its rate."""
    return _through(np.cos, lambda value: -np.sin(value), x)


def tanh(x: Any) -> Any:
    """Return the hyperbolic tangent, with its rate."""
    return _through(np.tanh, lambda value: 1.0 - np.tanh(value) * np.tanh(value), x)


def arctan(x: Any) -> Any:
    """Return the angle whose tangent is x, with its rate."""
    return _through(np.arctan, lambda value: 1.0 / (1.0 + value * value), x)


def root(x: Any) -> Any:
    """Return the square root, with its rate, which is 0 where x is."""

    def slope(value: Any) -> Any:
        return np.where(value > 0.0, 0.5 / np.sqrt(np.where(value > 0.0, value, 1.0)), 0.0)

    return _through(np.sqrt, slope, x)


def angle(y: Any, x: Any) -> Any:
    """Return the angle of (x, y), with its rate, which is 0 at the origin."""
    found = np.arctan2(value_of(y), value_of(x))
    if not (isinstance(x, Changing) or isinstance(y, Changing)):
        return found
    a, b = value_of(y), value_of(x)
    square = a * a + b * b
    turn = rate_of(y) * b - a * rate_of(x)
    return Changing(found, turn / np.where(square > 0.0, square, 1.0))


def ratio(x: Any) -> Any:
    """Return sin(x) / x, with its rate."""

    def function(value: Any) -> Any:
        near = np.abs(value) < _SMALL
        return np.where(near, 1.0 - value * value / 6.0, np.sin(value) / np.where(near, 1.0, value))

    def slope(value: Any) -> Any:
        near = np.abs(value) < _SMALL
        far = np.where(near, 1.0, value)
        return np.where(near, -value / 3.0, (np.cos(value) - np.sin(value) / far) / far)

    return _through(function, slope, x)


def chosen(condition: Any, x: Any, y: Any) -> Any:
    """Return x where a condition holds, else y, with the rate."""
    value = np.where(condition, value_of(x), value_of(y))
    if not (isinstance(x, Changing) or isinstance(y, Changing)):
        return value
    return Changing(value, np.where(condition, rate_of(x), rate_of(y)))


class Tracked(NamedTuple):
    """What a law knows: of the point where the fixed axle is, along the axes of the body's motion.

    Attributes
    ----------
    ahead, aside : scalar
        Where the reference is [m].
    turn : scalar
        Its heading less the body's, in (-pi, pi] [rad].
    speed, yaw_rate : scalar
        Of the reference [m/s, rad/s].
    acceleration : scalar
        Rate of its speed [m/s^2].
    own_speed : scalar
        Of the body [m/s].
    """

    ahead: Any
    aside: Any
    turn: Any
    speed: Any
    yaw_rate: Any
    acceleration: Any = 0.0
    own_speed: Any = 0.0


class KinematicLaw(Protocol):
    """A kinematic law, such as UnicycleTracking(): from what is tracked to speed and yaw rate."""

    def initial_state(self, context: Context, /) -> Any:
        """Return the state to start with; None where there is no memory."""

    def check(self, t: Array, speed: Array, yaw_rate: Array, /) -> None:
        """Refuse a reference of these speeds and yaw rates, shape (N,), that it cannot follow."""

    def __call__(self, tracked: Tracked, state: Any, /) -> tuple[tuple[Any, Any], Any]:
        """Return (v, w) [m/s, rad/s], and the next state."""


def _first(t: Array, wrong: Any) -> float | None:
    """Return the first time at which something is wrong, if it ever is."""
    found = np.flatnonzero(wrong)
    return float(t[found[0]]) if len(found) else None


@final
@part
class UnicycleTracking:
    """Follow a moving reference, forwards or backwards (De Luca, Oriolo, Vendittelli 2001).

        v = v_r cos et + k ex,  w = w_r + b v_r (sin et / et) ey + k et,  k = 2 zeta sqrt(w_r^2 + b v_r^2)

    With V = b (ex^2 + ey^2) / 2 + et^2 / 2, dV/dt = -k (b ex^2 + et^2): it needs a reference that does not
    rest for good. Near it, errors decay as (s + 2 zeta a)(s^2 + 2 zeta a s + a^2), a^2 = w_r^2 + b v_r^2.

    Parameters
    ----------
    zeta : float
        Damping, > 0.
    b : float
        Weight of the place beside the heading, > 0 [1/m^2].
    """

    zeta: float = number(default=0.7, above=0.0, doc="damping of a tracking law")
    b: float = number(default=20.0, above=0.0, unit="1/m^2", doc="weight of the place beside the heading")

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def check(self, t: Array, speed: Array, yaw_rate: Array) -> None:
        """Refuse a reference that never moves."""
        if not (np.abs(speed) > _STILL).any() and not (np.abs(yaw_rate) > _STILL).any():
            raise InvalidArgument("reference rests, expected one that moves, or the law Parking()")

    def __call__(self, tracked: Tracked, state: None) -> tuple[tuple[Any, Any], None]:
        """Return (v, w) [m/s, rad/s], and None."""
        x, y, turn, speed, yaw_rate = tracked[:5]
        k = 2.0 * self.zeta * root(yaw_rate * yaw_rate + self.b * (speed * speed))
        v = speed * cos(turn) + k * x
        return (v, yaw_rate + self.b * (speed * ratio(turn) * y) + k * turn), None


@final
@part
class Kanayama:
    """Follow a reference that moves forwards (Kanayama, Kimura, Miyazaki, Noguchi, ICRA 1990).

        v = v_r cos et + k1 ex,  w = w_r + v_r (k2 ey + k3 sin et)

    With V = (ex^2 + ey^2) / 2 + (1 - cos et) / k2, dV/dt = -k1 ex^2 - (k3 / k2) v_r sin^2 et: it needs v_r >
    0.

    Parameters
    ----------
    k1, k2, k3 : float
        Gains along, across, and of the heading, > 0 [1/s, 1/m^2, 1/m].
    """

    k1: float = number(default=2.0, above=0.0, unit="1/s", doc="gain along the path")
    k2: float = number(default=10.0, above=0.0, unit="1/m^2", doc="gain across the path")
    k3: float = number(default=5.0, above=0.0, unit="1/m", doc="gain of the heading")

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def check(self, t: Array, speed: Array, yaw_rate: Array) -> None:
        """Refuse a reference that stops or goes backwards."""
        when = _first(t, speed <= _STILL)
        if when is not None:
            raise InvalidArgument(
                f"reference goes at {speed[t == when][0]:.3g} m/s at t = {when:g} s, expected one that "
                "always moves "
                "forwards, or the law UnicycleTracking()"
            )

    def __call__(self, tracked: Tracked, state: None) -> tuple[tuple[Any, Any], None]:
        """Return (v, w) [m/s, rad/s], and None."""
        x, y, turn, speed, yaw_rate = tracked[:5]
        v = speed * cos(turn) + self.k1 * x
        return (v, yaw_rate + speed * (self.k2 * y + self.k3 * sin(turn))), None


@final
@part
class Parking:
    """Go to a pose and rest there (Aicardi, Casalino, Bicchi, Balestrino, IEEE RAM 2(1), 1995).

        v = k1 rho cos gam,  w = k2 gam + k1 (sin gam cos gam / gam) (gam + k3 del)

    rho is the distance of the goal, gam its bearing from the body's heading, del its bearing from the heading
    at the goal. With V = (rho^2 + gam^2 + k3 del^2) / 2, dV/dt = -k1 rho^2 cos^2 gam - k2 gam^2. The heading
    converges slowly, and no smooth law of the pose alone does better (Brockett 1983). It needs a reference
    that rests, and stops within `near` of it.

    Parameters
    ----------
    k1, k2, k3 : float
        Gains of the distance, the bearing and the approach, > 0 [1/s, 1/s, 1].
    near : float
        Distance within which it rests, > 0 [m].
    """

    k1: float = number(default=1.0, above=0.0, unit="1/s", doc="gain of the distance")
    k2: float = number(default=3.0, above=0.0, unit="1/s", doc="gain of the bearing")
    k3: float = number(default=2.0, above=0.0, doc="gain of the approach")
    near: float = number(default=1e-3, above=0.0, unit="m", doc="distance within which it rests")

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def check(self, t: Array, speed: Array, yaw_rate: Array) -> None:
        """Refuse a reference that moves."""
        when = _first(t, np.hypot(speed, yaw_rate) > _STILL)
        if when is not None:
            raise InvalidArgument(
                f"reference moves at t = {when:g} s, expected one that rests, or the law UnicycleTracking()"
            )

    def __call__(self, tracked: Tracked, state: None) -> tuple[tuple[Any, Any], None]:
        """Return (v, w) [m/s, rad/s], and None."""
        x, y = tracked.ahead, tracked.aside
        square = x * x + y * y
        there = value_of(square) < self.near * self.near
        rho, bearing = root(square), angle(y, x)
        approach = _turned(bearing - tracked.turn)
        v = self.k1 * (rho * cos(bearing))
        w = self.k2 * bearing + self.k1 * (ratio(bearing) * cos(bearing) * (bearing + self.k3 * approach))
        return (chosen(there, 0.0, v), chosen(there, 0.0, w)), None


def _turned(x: Any) -> Any:
    """Return an angle in [-pi, pi], with its rate."""
    value = value_of(x)
    value = value - 2 * np.pi * np.rint(value / (2 * np.pi))
    return Changing(value, x.rate) if isinstance(x, Changing) else value


@final
@part
class DynamicFeedback:
    """Follow a reference that never rests, by dynamic feedback linearisation (Oriolo et al. 2002).

    The speed xi is a state of the law, r = p_r'' + kd (p_r' - p') + kp (p_r - p) along the body's axes, and

        xi' = r_ahead,  v = xi,  w = r_aside / xi.

    Errors of the place decay as s^2 + kd s + kp; the heading follows. xi starts at the reference's speed, and
    the division takes |xi| >= least: it needs |v_r| above that, so no rests and no cusps.

    Parameters
    ----------
    kp, kd : float
        Gains of place and velocity, > 0 [1/s^2, 1/s].
    least : float
        Least speed that it divides by, > 0 [m/s].
    """

    kp: float = number(default=2.0, above=0.0, unit="1/s^2", doc="gain of the place")
    kd: float = number(default=2.8, above=0.0, unit="1/s", doc="gain of the velocity")
    least: float = number(default=0.05, above=0.0, unit="m/s", doc="least speed that it divides by")

    def initial_state(self, context: Context) -> tuple[float, float, float]:
        """Return the speed, how much of it is known, none as yet, and the time between samples [s]."""
        return 0.0, 0.0, float(context.dt)

    def check(self, t: Array, speed: Array, yaw_rate: Array) -> None:
        """Refuse a reference that rests or turns back."""
        when = _first(t, speed * np.sign(speed[0]) < self.least)
        if when is not None:
            raise InvalidArgument(
                f"reference goes at {speed[t == when][0]:.3g} m/s at t = {when:g} s, expected "
                f"{self.least:g} m/s or more, always in one direction, or the law UnicycleTracking()"
            )

    def __call__(
        self, tracked: Tracked, state: tuple[Any, Any, Any]
    ) -> tuple[tuple[Any, Any], tuple[Any, Any, Any]]:
        """Return (v, w) [m/s, rad/s], and the next speed."""
        x, y, turn, speed, yaw_rate, acceleration, own = tracked
        xi, known, dt = state
        xi = xi + (1.0 - known) * value_of(speed)
        c, s, across = cos(turn), sin(turn), speed * yaw_rate
        ahead = acceleration * c - across * s + self.kd * (speed * c - own) + self.kp * x
        aside = acceleration * s + across * c + self.kd * (speed * s) + self.kp * y
        rate = value_of(ahead)
        fast = np.abs(xi) >= self.least
        by = np.where(fast, xi, np.where(xi < 0.0, -self.least, self.least))
        w = aside / Changing(by, np.where(fast, rate, 0.0))
        if not isinstance(x, Changing):
            w = w.value
        return (Changing(xi, rate), w), (xi + dt * rate, 1.0 + 0.0 * known, dt)
