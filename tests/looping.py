"""Parts of a closed loop as a user would write them, and the loop in plain NumPy."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from pinmobile.compiled import Line, Memory, Noise, Parts, Reference, one_sample
from pinmobile.compiled.loop_tape import initial_memory


def triple(x: Any) -> Any:
    return np.broadcast_to(np.asarray(x, float), 3).copy()


def on_circle(angle: Any) -> Any:
    return angle - 2 * np.pi * np.rint(angle / (2 * np.pi))


class Body:
    """A body in the plane that is pushed."""

    nq, nv, nu = 3, 3, 3
    parameters = ("mass", "yaw_inertia", "com")

    def __init__(self, mass: float = 30.0, yaw_inertia: float = 1.3, com: Any = (0.1, 0.05)) -> None:
        self.mass, self.yaw_inertia, self.com = mass, yaw_inertia, np.asarray(com, float)

    def _offset(self, q: Any) -> Any:
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        x, y = self.com[..., 0], self.com[..., 1]
        return x * c - y * s, x * s + y * c

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        dx, dy = self._offset(q)
        tau, square = u + f, v[..., 2] ** 2
        spin = (tau[..., 2] - (dx * tau[..., 1] - dy * tau[..., 0])) / self.yaw_inertia
        ax = tau[..., 0] / self.mass + dy * spin + dx * square
        return np.stack([ax, tau[..., 1] / self.mass - dx * spin + dy * square, spin], axis=-1)

    def inverse_dynamics(self, q: Any, v: Any, a: Any) -> Any:
        dx, dy = self._offset(q)
        spin, square = a[..., 2], v[..., 2] ** 2
        gx, gy = a[..., 0] - dy * spin, a[..., 1] + dx * spin
        moment = self.yaw_inertia * spin + self.mass * (dx * gy - dy * gx)
        return np.stack([self.mass * (gx - dx * square), self.mass * (gy - dy * square), moment], axis=-1)

    def difference(self, q0: Any, q1: Any) -> Any:
        d = q1 - q0
        return np.stack([d[..., 0], d[..., 1], on_circle(d[..., 2])], axis=-1)

    def integrate(self, q: Any, dq: Any) -> Any:
        return q + dq

    def pose(self, q: Any) -> Any:
        return q

    def rate(self, q: Any, v: Any) -> Any:
        return v

    def effort(self, q: Any, wrench: Any) -> Any:
        return wrench


class TwoWheels:
    """Two driven wheels on an axle, which roll: q = (x, y, psi, left, right), u = their torques."""

    nq, nv, nu = 5, 5, 2
    parameters = ("mass", "yaw_inertia", "spin", "radius", "track")

    def __init__(self, mass: float = 20.0, yaw_inertia: float = 0.9, spin: float = 0.02) -> None:
        self.mass, self.yaw_inertia, self.spin = mass, yaw_inertia, spin
        self.radius, self.track = 0.1, 0.5

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        c, s = np.cos(q[2]), np.sin(q[2])
        r, b = self.radius, self.track
        f = f + np.zeros(5)
        speed, turn = v[0] * c + v[1] * s, v[2]
        forward = f[0] * c + f[1] * s + (u[0] + u[1] + f[3] + f[4]) / r
        moment = f[2] + b / (2 * r) * (u[1] + f[4] - u[0] - f[3])
        a = forward / (self.mass + 2 * self.spin / r**2)
        w = moment / (self.yaw_inertia + b**2 * self.spin / (2 * r**2))
        return np.array(
            [
                a * c - speed * turn * s,
                a * s + speed * turn * c,
                w,
                (a - b / 2 * w) / r,
                (a + b / 2 * w) / r,
            ]
        )

    def project(self, q: Any, v: Any) -> Any:
        c, s = np.cos(q[2]), np.sin(q[2])
        speed, turn = v[0] * c + v[1] * s, v[2]
        half = self.track / 2 * turn
        return np.array(
            [speed * c, speed * s, turn, (speed - half) / self.radius, (speed + half) / self.radius]
        )

    def difference(self, q0: Any, q1: Any) -> Any:
        d = q1 - q0
        d[2] = np.mod(d[2] + np.pi, 2 * np.pi) - np.pi
        return d

    def integrate(self, q: Any, dq: Any) -> Any:
        return q + dq

    def pose(self, q: Any) -> Any:
        return q[:3]

    def rate(self, q: Any, v: Any) -> Any:
        return v[:3]

    def effort(self, q: Any, wrench: Any) -> Any:
        return np.concatenate([wrench, [0.0, 0.0]])


@dataclass
class WheelFollower:
    """Speed and heading of two wheels from the error along and across the path."""

    gains: Any = (8.0, 6.0, 4.0)
    parameters: Any = ("gains",)

    def initial_state(self, context: Any) -> Any:
        return context.difference

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, difference: Any) -> Any:
        kx, ky, kp = np.asarray(self.gains, float)
        c, s = np.cos(q[2]), np.sin(q[2])
        e = reference.q - q[:3]
        along, across = e[0] * c + e[1] * s, e[1] * c - e[0] * s
        turn = np.arctan2(np.sin(e[2]), np.cos(e[2]))
        speed = v[0] * c + v[1] * s
        force = kx * along - 3.0 * (speed - np.hypot(reference.v[0], reference.v[1]))
        moment = ky * across + kp * turn - 2.0 * (v[2] - reference.v[2])
        return 0.1 / 2 * np.array([force - moment / 0.25, force + moment / 0.25]), difference


class PD:
    parameters: Any = ("kp", "kd")

    def __init__(self, kp: Any, kd: Any) -> None:
        self.kp, self.kd = triple(kp), triple(kd)

    def initial_state(self, context: Any) -> Any:
        return context.difference

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, difference: Any) -> Any:
        return self.kp * difference(q, reference.q) + self.kd * (reference.v - v), difference


class ComputedTorque:
    parameters = ("kp", "kd")

    def __init__(self, robot: Body, kp: Any, kd: Any) -> None:
        self.robot, self.kp, self.kd = robot, triple(kp), triple(kd)

    def initial_state(self, context: Any) -> None:
        return None

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        e = self.robot.difference(q, reference.q)
        a = reference.a + (self.kp * e + self.kd * (reference.v - v))
        return self.robot.inverse_dynamics(q, v, a), state


class PID:
    """Integral with anti-windup from what was really applied; a filtered derivative."""

    parameters = ("kp", "ki", "kd", "limit", "tau")

    def __init__(self, kp: Any, ki: Any, kd: Any, limit: Any, tau: float = 0.02) -> None:
        self.kp, self.ki, self.kd, self.limit = (triple(x) for x in (kp, ki, kd, limit))
        self.tau = tau

    def initial_state(self, context: Any) -> Any:
        return {"integral": 0.0, "rate": np.zeros(3), "u": np.zeros(3), "dt": context.dt}

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        dt = state["dt"]
        e = reference.q - q
        e = np.array([e[0], e[1], np.mod(e[2] + np.pi, 2 * np.pi) - np.pi])
        rate = state["rate"] + dt / (self.tau + dt) * ((reference.v - v) - state["rate"])
        u = self.kp * e + self.kd * rate + state["integral"]
        limited = np.clip(u, -self.limit, self.limit)
        integral = state["integral"] + dt * self.ki * e
        return limited, {"integral": integral, "rate": rate, "u": u, "dt": dt}

    def applied(self, u: Any, state: Any) -> Any:
        return state | {"integral": state["integral"] + state["dt"] * (u - state["u"]) / 0.1}


class Sliding:
    parameters = ("slope", "gain", "width", "mass")

    def __init__(self, slope: Any, gain: Any, width: Any, mass: Any, smooth: bool = True) -> None:
        self.slope, self.gain, self.width, self.mass = (triple(x) for x in (slope, gain, width, mass))
        self.smooth = smooth

    def initial_state(self, context: Any) -> None:
        return None

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        e = reference.q - q
        e[..., 2] = np.mod(e[..., 2] + np.pi, 2 * np.pi) - np.pi
        surface = (reference.v - v) + self.slope * e
        switch = np.tanh(surface / self.width) if self.smooth else np.clip(surface / self.width, -1, 1)
        return self.mass * (reference.a + self.slope * (reference.v - v)) + self.gain * switch, state


class Wrapper:
    controller: Any

    def initial_state(self, context: Any) -> Any:
        return self.controller.initial_state(context)


@dataclass(frozen=True)
class Saturated(Wrapper):
    controller: Any
    limits: Any
    parameters: Any = field(default=("limits",), repr=False)

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        u, state = self.controller(t, q, v, reference, state)
        return np.minimum(np.maximum(u, -np.asarray(self.limits)), self.limits), state


@dataclass(frozen=True)
class Delayed(Wrapper):
    controller: Any
    samples: int

    def initial_state(self, context: Any) -> Any:
        return self.controller.initial_state(context), context.line(self.samples)

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        inner, line = state
        (old_q, old_v), line = line.push((q, v))
        u, inner = self.controller(t, old_q, old_v, reference, inner)
        return u, (inner, line)


@dataclass(frozen=True)
class Noisy(Wrapper):
    controller: Any
    std_q: Any
    std_v: Any
    parameters: Any = field(default=("std_q", "std_v"), repr=False)

    def initial_state(self, context: Any) -> Any:
        return self.controller.initial_state(context), context.normal("measurement", 6)

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        inner, noise = state
        w, noise = noise.draw()
        u, inner = self.controller(t, q + self.std_q * w[:3], v + self.std_v * w[3:], reference, inner)
        return u, (inner, noise)


@dataclass(frozen=True)
class Constant:
    force: Any
    parameters: Any = field(default=("force",), repr=False)

    def __call__(self, t: Any, pose: Any, rate: Any) -> Any:
        return np.asarray(self.force) + 0 * pose


@dataclass(frozen=True)
class Sinusoidal:
    amplitude: Any
    frequency: float
    phase: float = 0.0
    parameters: Any = field(default=("amplitude", "frequency", "phase"), repr=False)

    def __call__(self, t: Any, pose: Any, rate: Any) -> Any:
        return np.asarray(self.amplitude) * np.sin(2 * np.pi * self.frequency * t + self.phase)


def turned(c: Any, s: Any, w: Any) -> Any:
    out = np.empty(w.shape)
    out[..., 0] = c * w[..., 0] - s * w[..., 1]
    out[..., 1] = s * w[..., 0] + c * w[..., 1]
    out[..., 2] = w[..., 2]
    return out


@dataclass(frozen=True)
class Viscous:
    coefficients: Any
    parameters: Any = field(default=("coefficients",), repr=False)

    def __call__(self, t: Any, pose: Any, rate: Any) -> Any:
        c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        return turned(c, s, -np.asarray(self.coefficients) * turned(c, -s, rate))


@dataclass(frozen=True)
class Rolling:
    force: Any
    speed: Any = 0.1
    parameters: Any = field(default=("force", "speed"), repr=False)

    def __call__(self, t: Any, pose: Any, rate: Any) -> Any:
        c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        w = turned(c, -s, rate)
        return turned(c, s, -np.asarray(self.force) * w / np.hypot(w, self.speed))


@dataclass(frozen=True)
class AxleFriction:
    """A force on the coordinates."""

    viscous: float
    parameters: Any = field(default=("viscous",), repr=False)

    def on_coordinates(self, t: Any, q: Any, v: Any) -> Any:
        f = np.zeros_like(v)
        f[-2:] = -self.viscous * v[-2:]
        return f


def constant_acceleration(acceleration: Any, t: Any, q: Any, v: Any, h: Any) -> Any:
    a = acceleration(t, q, v)
    return q + h * v + h * h / 2 * a, v + h * a


def semi_implicit(acceleration: Any, t: Any, q: Any, v: Any, h: Any) -> Any:
    v = v + h * acceleration(t, q, v)
    return q + h * v, v


def rk4(acceleration: Any, t: Any, q: Any, v: Any, h: Any) -> Any:
    a1 = acceleration(t, q, v)
    a2 = acceleration(t + h / 2, q + h / 2 * v, v + h / 2 * a1)
    a3 = acceleration(t + h / 2, q + h / 2 * v + h * h / 4 * a1, v + h / 2 * a2)
    a4 = acceleration(t + h, q + h * v + h * h / 2 * a2, v + h * a3)
    return q + h * v + h * h / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def circle(dt: float, count: int) -> tuple[Any, Reference]:
    """Return times, and a circle with the heading along it."""
    t = dt * np.arange(count)
    w, r = 0.5, 2.0
    p = w * t
    q = np.stack([r * np.sin(p), r * (1 - np.cos(p)), p], axis=-1)
    v = np.stack([r * w * np.cos(p), r * w * np.sin(p), np.full_like(p, w)], axis=-1)
    a = np.stack([-r * w * w * np.sin(p), r * w * w * np.cos(p), np.zeros_like(p)], axis=-1)
    return t, Reference(q, v, a)


def context(dt: float) -> Any:
    return SimpleNamespace(dt=dt)


def looped(
    parts: Parts, q: Any, v: Any, t: Any, reference: Reference, dt: float, key: int = 0
) -> tuple[dict[str, Any], Memory]:
    """Return the samples of one robot, and the memory at last, computed by NumPy's own functions."""
    memory = initial_memory(parts, context(dt), reference.v.shape[1], Line, lambda name, n: Noise(key, n))
    rows: dict[str, Any] = {"q": [], "v": [], "u": [], "a": []}
    for k, time in enumerate(t):
        now = Reference(*(x[k].copy() for x in reference))
        found = one_sample(parts, float(k), time, dt / parts.substeps, (q, v), now, memory)
        for name, row in rows.items():
            row.append(getattr(found.sample, name))
        q, v, memory = found.q, found.v, found.memory
    return {name: np.array(row) for name, row in rows.items()}, memory
