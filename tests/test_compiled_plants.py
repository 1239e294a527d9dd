"""What a plant may be, and what parts may hold: the capabilities that the compiled loop asks for."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from pinmobile.compiled import robot_keys
from pinmobile.forces import SinusoidalForce
from pinmobile.integrators import RungeKuttaNystrom, constant_acceleration, rk4, semi_implicit_euler
from pinmobile.loop import Loop, Samples
from pinmobile.loop._engines import Compiled
from pinmobile.parts import evolved
from pinmobile.trajectories import Reference
from tests.looping import CIRCLE, PD, SEED, TIMES, Body, assert_near, looped, told


def compiled(loop: Loop, q: Any, v: Any, reference: Any = CIRCLE, values: Any = None) -> dict[str, Any]:
    """Return the samples of robots that start at rows of q and v."""
    own, loop = values or {}, evolved(loop, {"recorder": Samples()})
    first = Reference(*(x[0] for x in reference))
    spread = {path: np.ones(np.shape(x)[1:], bool) for path, x in own.items()}
    made = Compiled(loop, told(loop, TIMES, reference), (q[0], v[0]), first, spread=spread)
    keys = {name: robot_keys(SEED, name, range(len(q))) for name in made.tape.keys}
    return dict(made.run((q, v), TIMES, reference, values=own, keys=keys).kept)


def assert_alike(loop: Loop, q: Any, v: Any, reference: Any = CIRCLE) -> None:
    """Compare the samples of one robot, compiled and in Python."""
    found = compiled(loop, q[None], v[None], reference)
    assert_near({name: x[0] for name, x in found.items()}, looped(loop, q, v, TIMES, reference), 1e-10)


@dataclass(frozen=True)
class Turning:
    """A body whose heading is (cos, sin) in q, so that q has one number more than v."""

    mass: float = 12.0
    yaw_inertia: float = 0.7

    nq, nv, nu = 4, 3, 3

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        return (u + f) / np.array([self.mass, self.mass, self.yaw_inertia])

    def integrate(self, q: Any, dq: Any) -> Any:
        c, s = np.cos(dq[2]), np.sin(dq[2])
        return np.array([q[0] + dq[0], q[1] + dq[1], q[2] * c - q[3] * s, q[3] * c + q[2] * s])

    def difference(self, q0: Any, q1: Any) -> Any:
        angle = np.arctan2(q0[2] * q1[3] - q0[3] * q1[2], q0[2] * q1[2] + q0[3] * q1[3])
        return np.concatenate([q1[:2] - q0[:2], [angle]])

    def pose(self, q: Any) -> Any:
        return np.array([q[0], q[1], np.arctan2(q[3], q[2])])

    def pose_rate(self, q: Any, v: Any) -> Any:
        return v

    def generalized_force(self, q: Any, wrench: Any) -> Any:
        return wrench


@pytest.mark.parametrize("integrator", [constant_acceleration, semi_implicit_euler, rk4])
def test_a_heading_of_cosine_and_sine_is_turned_by_displacements(integrator: RungeKuttaNystrom) -> None:
    psi = CIRCLE.q[:, 2]
    lifted = Reference(np.column_stack([CIRCLE.q[:, :2], np.cos(psi), np.sin(psi)]), CIRCLE.v, CIRCLE.a)
    loop = Loop(Turning(), PD(40.0, 30.0), None, (SinusoidalForce((1, 1, 1), 0.5),), integrator)
    q, v = np.array([0.1, -0.1, np.cos(0.2), np.sin(0.2)]), CIRCLE.v[0]
    assert_alike(loop, q, v, lifted)
    turned = compiled(loop, q[None], v[None], lifted)["q"][0, :, 2:]
    np.testing.assert_allclose(np.hypot(*turned.T), 1.0, rtol=1e-13)


@dataclass
class Last:
    """A memory of a user's own."""

    u: Any


def test_memory_may_be_an_object_of_fields() -> None:
    class Remembering(PD):
        def initial_state(self, context: Any) -> Last:
            return Last([np.zeros(3)])

        def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Last) -> Any:
            u = self.kp * (reference.q - q) + self.kd * (reference.v - v) + 0.1 * state.u[0]
            return u, Last([u])

    loop = Loop(Body(), Remembering(30.0, 40.0), None, (), rk4)
    assert_alike(loop, CIRCLE.q[0] + 0.2, CIRCLE.v[0])
