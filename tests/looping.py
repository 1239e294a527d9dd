"""Closed loops of a user's parts and the library's, as compiled code and as Python run them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import pinmobile as pm
from pinmobile.compiled import Cache, Outcome, Program, robot_keys
from pinmobile.forces import SinusoidalForce
from pinmobile.integrators import constant_acceleration, semi_implicit_euler
from pinmobile.loop import Loop, Samples
from pinmobile.loop._engines import Compiled, python_samples
from pinmobile.parts import evolved
from pinmobile.plant import Context
from pinmobile.trajectories import Reference
from tests.parts import PID, Cart, Follower

DT, COUNT = 0.01, 201
SEED = 7
MASS = {"plant.mass": np.ones((), bool)}
NONE = Cache("")


def circle(dt: float = DT, count: int = COUNT) -> tuple[Any, Reference]:
    """Return times, and a circle with the heading along it."""
    t = dt * np.arange(count)
    w, r = 0.5, 2.0
    p = w * t
    q = np.stack([r * np.sin(p), r * (1 - np.cos(p)), p], axis=-1)
    v = np.stack([r * w * np.cos(p), r * w * np.sin(p), np.full_like(p, w)], axis=-1)
    a = np.stack([-r * w * w * np.sin(p), r * w * w * np.cos(p), np.zeros_like(p)], axis=-1)
    return t, Reference(q, v, a)


TIMES, CIRCLE = circle()


@dataclass(frozen=True)
class Body:
    """A body in the plane that is pushed, its centre of mass aside."""

    mass: float = 30.0
    yaw_inertia: float = 1.3
    com: Any = (0.1, 0.05)

    nq = nv = nu = 3

    def _offset(self, q: Any) -> Any:
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        x, y = self.com
        return x * c - y * s, x * s + y * c

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        dx, dy = self._offset(q)
        tau, square = u + f, v[..., 2] ** 2
        spin = (tau[..., 2] - (dx * tau[..., 1] - dy * tau[..., 0])) / self.yaw_inertia
        ax = tau[..., 0] / self.mass + dy * spin + dx * square
        return np.stack([ax, tau[..., 1] / self.mass - dx * spin + dy * square, spin], axis=-1)

    def difference(self, q0: Any, q1: Any) -> Any:
        d = q1 - q0
        turn = d[..., 2] - 2 * np.pi * np.rint(d[..., 2] / (2 * np.pi))
        return np.stack([d[..., 0], d[..., 1], turn], axis=-1)

    def integrate(self, q: Any, dq: Any) -> Any:
        return q + dq

    def pose(self, q: Any) -> Any:
        return q

    def pose_rate(self, q: Any, v: Any) -> Any:
        return v

    def generalized_force(self, q: Any, wrench: Any) -> Any:
        return wrench


@dataclass(frozen=True)
class PD:
    """A controller of errors, which its context tells how to take."""

    kp: Any = 20.0
    kd: Any = 25.0

    def initial_state(self, context: Any) -> Any:
        return context.difference

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, difference: Any) -> Any:
        return self.kp * difference(q, reference.q) + self.kd * (reference.v - v), difference


ROBOT = pm.MobileRobot(31.0, 1.2, com=(0.12, 0.04))
SMOOTH = pm.ViscousFriction((5.0, 8.0, 2.0)), SinusoidalForce((3.0, 2.0, 1.0), 0.5)
ROUGH = pm.ConstantForce((2.0, 1.0, 0.1)), pm.RollingResistance((3.0, 5.0, 1.0), 0.1)
LIMITS = (60.0, 60.0, 5.0)


def _all() -> Any:
    torque = pm.ComputedTorque(ROBOT, 4.0, (4.0, 4.0, 5.0))
    return pm.InputSaturation(pm.MeasurementDelay(pm.MeasurementNoise(torque, 0.001, 0.005, 3), 5), LIMITS)


COMPOSITIONS: dict[str, Callable[[], Loop]] = {
    "all": lambda: Loop(Body(), _all(), None, (*SMOOTH, *ROUGH), pm.rk4, 2),
    "pid": lambda: Loop(
        Body(), pm.InputSaturation(PID(90.0, 20.0, 90.0), LIMITS), None, ROUGH, constant_acceleration
    ),
    "wheels, delayed": lambda: Loop(
        Cart(), pm.MeasurementDelay(Follower(), 3), None, ROUGH, semi_implicit_euler
    ),
}


def told(loop: Loop, t: Any = TIMES, reference: Reference = CIRCLE, member: int = 0) -> Context:
    """Return what the controller of a loop is told."""
    context = Context.of(loop.plant, dt=t[1] - t[0], t=t, reference=reference, trajectory=None)
    return replace(context, seed=SEED, member=member)


def started(plant: Any, n: int) -> tuple[Any, Any]:
    """Return starts off the circle, on the constraints of a plant that has some."""
    rng = np.random.default_rng(5)
    q, v = np.zeros((n, plant.nq)), np.zeros((n, plant.nv))
    q[:, :3] = CIRCLE.q[0] + rng.normal(0, 0.1, (n, 3))
    v[:, :3] = CIRCLE.v[0]
    if hasattr(plant, "project"):
        v = np.array([plant.project(*pair) for pair in zip(q, v, strict=True)])
    return q, v


def built(loop: Loop, spread: Mapping[str, Any] = MASS, recorder: Any = None, **options: Any) -> Compiled:
    """Return a loop compiled, with a program of its own where there are options of one."""
    loop = evolved(loop, {"recorder": recorder or Samples()})
    q, v = started(loop.plant, 1)
    first = Reference(*(x[0] for x in CIRCLE))
    compiled = Compiled(loop, told(loop), (q[0], v[0]), first, spread=spread)
    if options:
        compiled.program = Program(compiled.tape, **{"cache": NONE} | options)
    return compiled


def ran(compiled: Compiled, n: int, first: int = 0, **options: Any) -> Outcome:
    """Return what robots do, which have masses, starts and noise of their own."""
    plant, end = compiled.loop.plant, 400
    q, v = (x[first : first + n] for x in started(plant, end))
    names = [path for path in compiled.spread if path == "plant.mass"]
    values = {path: np.linspace(0.8, 1.2, end)[first : first + n] * plant.mass for path in names}
    keys = {name: robot_keys(SEED, name, range(first, first + n)) for name in compiled.tape.keys}
    given: dict[str, Any] = {"values": values, "keys": keys} | options
    return compiled.run((q, v), TIMES, CIRCLE, **given)


def looped(loop: Loop, q: Any, v: Any, t: Any = TIMES, reference: Any = CIRCLE, member: int = 0) -> Any:
    """Return the samples of one robot in Python, by name."""
    samples = [one for one, _ in python_samples(loop, told(loop, t, reference, member), q, v)]
    return {name: np.array([getattr(one, name) for one in samples]) for name in ("q", "v", "u", "a")}


def assert_near(found: Mapping[str, Any], expected: Mapping[str, Any], within: float = 1e-11) -> None:
    """Compare samples, as shares of the largest number of each column."""
    for name, rows in expected.items():
        largest = np.maximum(np.abs(rows).max(axis=0), 1e-3)
        assert (np.abs(found[name] - rows) <= within * largest).all(), name
