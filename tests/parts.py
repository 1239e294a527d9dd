"""Parts of a closed loop as users write them: frozen dataclasses in plain NumPy; one declares its fields."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pinmobile.controllers import Controller, law
from pinmobile.parts import array, number, part
from pinmobile.plant import Coordinate, Input
from pinmobile.trajectories import Reference


def steady(*u: float) -> Controller:
    """Return a controller whose input stays."""
    return law(lambda t, q, v, reference: np.array(u) + 0.0 * t)


@dataclass(frozen=True)
class PID:
    """Integral control; what the limits took away is taken out of the integral again (back-calculation)."""

    kp: float = 100.0
    ki: float = 20.0
    kd: float = 120.0
    back: float = 2.0  # [1/s]; 0: the integral winds up

    def initial_state(self, context: Any) -> Any:
        nothing = np.zeros(3)
        return {"sum": nothing, "u": nothing, "dt": context.dt, "difference": context.difference}

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        error = state["difference"](q, reference.q)
        u = self.kp * error + self.kd * (reference.v - v) + state["sum"]
        return u, state | {"sum": state["sum"] + state["dt"] * self.ki * error, "u": u}

    def applied(self, u: Any, state: Any) -> Any:
        return state | {"sum": state["sum"] + state["dt"] * self.back * (u - state["u"])}


@part
class SlidingMode:
    """Sliding mode with a boundary layer, for a body whose mass is taken to be where its frame is."""

    slope: Any = number(default=1.5, unit="1/s", doc="slope of the surface")
    gain: Any = array(default=(60.0, 60.0, 3.0), labels=("x", "y", "psi"), unit="N, N, N m", doc="gain")
    width: Any = number(default=0.5, unit="m/s", above=0.0, doc="width of the boundary layer")
    inertia: Any = array(default=(30.0, 30.0, 1.4), unit="kg, kg, kg m^2", doc="inertia of the body")

    def initial_state(self, context: Any) -> Any:
        return context.difference

    def __call__(self, t: float, q: Any, v: Any, reference: Any, difference: Any) -> Any:
        slope, rate = self.slope, reference.v - v
        surface = rate + slope * difference(q, reference.q)
        switched = self.gain * np.tanh(surface / self.width)
        return self.inertia * (reference.a + slope * rate) + switched, difference


@dataclass(frozen=True)
class Spring:
    """A spring from a place on the ground to the body, which gives way where it is long."""

    stiffness: float = 8.0  # [N/m]
    at: Any = (0.0, 1.0)  # [m]

    def __call__(self, t: float, pose: Any, rate: Any) -> Any:
        way = self.at - pose[..., :2]
        pull = self.stiffness / np.sqrt(1.0 + way[..., 0] ** 2 + way[..., 1] ** 2)
        return np.stack([pull * way[..., 0], pull * way[..., 1], 0.0 * pull], axis=-1)


@dataclass(frozen=True)
class Axle:
    """A force on coordinates: the left one of two wheels runs heavily."""

    viscous: float = 0.02  # [N m s]

    def on_coordinates(self, t: float, q: Any, v: Any) -> Any:
        return -self.viscous * v[..., 3] * np.array([0.0, 0.0, 0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Smoothed:
    """Any controller, its input led through a low pass."""

    controller: Any
    share: float = 0.7  # of the new input, from 0 to 1

    def initial_state(self, context: Any) -> Any:
        return self.controller.initial_state(context), np.zeros(len(context.inputs))

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        inner, last = state
        u, inner = self.controller(t, q, v, reference, inner)
        last = last + self.share * (u - last)
        return last, (inner, last)

    def applied(self, u: Any, state: Any) -> Any:
        inner, last = state
        tell = getattr(self.controller, "applied", None)
        return (inner if tell is None else tell(u, inner)), last


def midpoint(acceleration: Callable[..., Any], t: float, q: Any, v: Any, h: float) -> Any:
    """Return the step of the explicit midpoint rule."""
    half = v + h / 2 * acceleration(t, q, v)
    return q + h * half, v + h * acceleration(t + h / 2, q + h / 2 * v, half)


@dataclass(frozen=True)
class Eight:
    """A path: an eight, once, or for another duration."""

    size: float = 2.0  # [m]
    duration: float = 12.0  # [s]
    period: float = 0.0  # [s], where it is another

    def __call__(self, t: Any) -> Any:
        return self.derivative(t, 0)

    def derivative(self, t: Any, order: int) -> Any:
        rate, turned = 2 * np.pi / (self.period or self.duration), order * np.pi / 2
        x = rate**order * np.sin(rate * np.asarray(t) + turned)
        y = (2 * rate) ** order * np.sin(2 * rate * np.asarray(t) + turned)
        return self.size * np.stack([x, y / 2], axis=-1)


@dataclass(frozen=True)
class Nodding:
    """A heading: whatever the path does, the body looks to its left and to its right."""

    path: Any
    angle: float = 0.4  # [rad]
    rate: float = 0.8  # [rad/s]

    @property
    def duration(self) -> float:
        return float(self.path.duration)

    def __call__(self, t: Any) -> Reference:
        turned = self.rate * np.asarray(t)
        nod = np.sin(turned), self.rate * np.cos(turned), -(self.rate**2) * np.sin(turned)
        plane = [self.path.derivative(t, order) for order in range(3)]
        return Reference(
            *(np.append(xy, self.angle * psi[..., None], -1) for xy, psi in zip(plane, nod, strict=True))
        )


@dataclass(frozen=True)
class Waving:
    """A trajectory of a robot with arms: every coordinate leaves its rest and comes back, later ones more."""

    robot: Any
    duration: float = 1.0

    def __call__(self, t: Any) -> Reference:
        angle = 3.0 * np.asarray(t)[..., None]
        way = 0.2 * np.arange(1, self.robot.nv + 1) / self.robot.nv
        q = self.robot.rest + way * (1 - np.cos(angle))
        return Reference(q, way * 3 * np.sin(angle), way * 9 * np.cos(angle))


class Points:
    """What no more than a loop without forces needs: three unit masses, the same bits in every engine."""

    nq = nv = nu = 3

    def forward_dynamics(self, q: Any, v: Any, u: Any) -> Any:
        return u

    def integrate(self, q: Any, dq: Any) -> Any:
        return q + dq

    def difference(self, q0: Any, q1: Any) -> Any:
        return q1 - q0


@dataclass(frozen=True)
class Cart:
    """A plant: two driven wheels on an axle, which roll. q = (x, y, psi, left, right), u = their torques."""

    mass: float = 20.0  # [kg]
    yaw_inertia: float = 0.9  # [kg m^2]
    spin: float = 0.02  # of a wheel [kg m^2]
    radius: float = 0.1  # [m]
    track: float = 0.5  # [m]

    nq, nv, nu = 5, 5, 2
    coordinates = (
        *(Coordinate("x", "m"), Coordinate("y", "m"), Coordinate("psi", "rad")),
        *(Coordinate("left", "rad"), Coordinate("right", "rad")),
    )
    inputs = (Input("left_torque", "N m", -5.0, 5.0), Input("right_torque", "N m", -5.0, 5.0))
    reference_sizes: ClassVar[dict[int, int]] = {3: 3, 5: 5}

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        c, s, r, b = np.cos(q[..., 2]), np.sin(q[..., 2]), self.radius, self.track
        f = f + np.zeros(5)
        left, right = u[..., 0] + f[..., 3], u[..., 1] + f[..., 4]
        speed, turn = v[..., 0] * c + v[..., 1] * s, v[..., 2]
        forward = f[..., 0] * c + f[..., 1] * s + (left + right) / r
        a = forward / (self.mass + 2 * self.spin / r**2)
        w = (f[..., 2] + b / (2 * r) * (right - left)) / (self.yaw_inertia + b**2 * self.spin / (2 * r**2))
        ahead, across = a * c - speed * turn * s, a * s + speed * turn * c
        return np.stack([ahead, across, w, (a - b / 2 * w) / r, (a + b / 2 * w) / r], axis=-1)

    def project(self, q: Any, v: Any) -> Any:
        c, s, r = np.cos(q[..., 2]), np.sin(q[..., 2]), self.radius
        speed, half = v[..., 0] * c + v[..., 1] * s, self.track / 2 * v[..., 2]
        return np.stack([speed * c, speed * s, v[..., 2], (speed - half) / r, (speed + half) / r], axis=-1)

    def start(self, reference: Any) -> tuple[Any, Any]:
        q, v = (np.append(x, np.zeros(5 - len(x))) for x in (reference.q, reference.v))
        return q, self.project(q, v)

    def difference(self, q0: Any, q1: Any) -> Any:
        d = q1 - q0
        turn = np.mod(d[..., 2] + np.pi, 2 * np.pi) - np.pi
        return np.stack([d[..., 0], d[..., 1], turn, d[..., 3], d[..., 4]], axis=-1)

    def integrate(self, q: Any, dq: Any) -> Any:
        return q + dq

    def pose(self, q: Any) -> Any:
        return q[..., :3]

    def pose_rate(self, q: Any, v: Any) -> Any:
        return v[..., :3]

    def generalized_force(self, q: Any, wrench: Any) -> Any:
        return np.concatenate([wrench, 0.0 * wrench[..., :2]], axis=-1)


@dataclass(frozen=True)
class Follower:
    """The torques of two wheels from the errors along and across the path, and of the heading."""

    along: float = 8.0
    across: float = 6.0
    turn: float = 4.0

    def initial_state(self, context: Any) -> Any:
        return context.difference

    def __call__(self, t: float, q: Any, v: Any, reference: Any, difference: Any) -> Any:
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        e, wanted = reference.q[..., :3] - q[..., :3], reference.v
        ahead, aside = e[..., 0] * c + e[..., 1] * s, e[..., 1] * c - e[..., 0] * s
        speed = v[..., 0] * c + v[..., 1] * s
        force = self.along * ahead - 9.0 * (speed - np.hypot(wanted[..., 0], wanted[..., 1]))
        moment = self.across * aside + self.turn * np.sin(e[..., 2]) - 2.0 * (v[..., 2] - wanted[..., 2])
        return 0.05 * np.stack([force - 4.0 * moment, force + 4.0 * moment], axis=-1), difference


@dataclass(frozen=True)
class CartCircle:
    """A reference of all coordinates of a `Cart`: a circle, from the origin to the left."""

    radius: float = 2.0  # [m]
    rate: float = 0.5  # [rad/s]
    duration: float = 6.0  # [s]

    def __call__(self, t: Any) -> Reference:
        r, w, turned = self.radius, self.rate, self.rate * np.asarray(t)
        c, s, one = np.cos(turned), np.sin(turned), np.ones_like(turned)
        left, right = (10.0 * (r + side) for side in (-0.25, 0.25))
        return Reference(
            np.stack([r * s, r - r * c, turned, left * turned, right * turned], axis=-1),
            np.stack([r * w * c, r * w * s, w * one, left * w * one, right * w * one], axis=-1),
            np.stack([-r * w * w * s, r * w * w * c, 0 * one, 0 * one, 0 * one], axis=-1),
        )
