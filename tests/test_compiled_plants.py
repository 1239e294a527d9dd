"""What a plant may be, and what parts may hold: the capabilities that the compiled loop asks for."""

import threading
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest

from pinmobile import errors, plain_difference, planar_difference
from pinmobile.compiled import Cache, Noise, Parts, Place, Program, Reference, Trace, robot_keys, traced
from pinmobile.compiled.loop_tape import initial_memory
from pinmobile.compiled.sample import one_sample
from pinmobile.integrators import RungeKuttaNystrom, constant_acceleration, rk4, semi_implicit_euler
from tests.looping import PD, Body, Constant, Noisy, Sinusoidal, circle, context, looped

DT, COUNT = 0.01, 120
TIMES, CIRCLE = circle(DT, COUNT)
FIRST = Reference(*(x[0] for x in CIRCLE))


def both(parts: Parts, q: Any, v: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the samples of one robot, compiled and by NumPy."""
    loop = traced(parts, context(DT), (q, v), FIRST, dt=DT)
    program = Program(loop, single=True, cache=Cache(""))
    found = program.run(parts, context(DT), (q[None], v[None]), TIMES, CIRCLE, dt=DT)
    expected, _ = looped(parts, q, v, TIMES, CIRCLE, DT)
    return {name: x[0] for name, x in found.kept.items()}, expected


def close(found: dict[str, Any], expected: dict[str, Any]) -> None:
    for name, rows in expected.items():
        np.testing.assert_allclose(found[name], rows, rtol=1e-10, atol=1e-11 * (1 + np.abs(rows).max()))


class Turning:
    """A body whose heading is (cos, sin) in q, so that q has one number more than v."""

    nq, nv, nu = 4, 3, 3
    parameters = ("mass", "yaw_inertia")

    def __init__(self) -> None:
        self.mass, self.yaw_inertia = 12.0, 0.7

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

    def rate(self, q: Any, v: Any) -> Any:
        return v

    def effort(self, q: Any, wrench: Any) -> Any:
        return wrench


@pytest.mark.parametrize("integrator", [constant_acceleration, semi_implicit_euler, rk4])
def test_a_heading_of_cosine_and_sine_is_turned_by_displacements(integrator: RungeKuttaNystrom) -> None:
    psi = CIRCLE.q[:, 2]
    lifted = Reference(np.column_stack([CIRCLE.q[:, :2], np.cos(psi), np.sin(psi)]), CIRCLE.v, CIRCLE.a)
    parts = Parts(Turning(), PD(40.0, 30.0), (Sinusoidal(np.ones(3), 0.5),), integrator, Trace())
    q, v = np.array([0.1, -0.1, np.cos(0.2), np.sin(0.2)]), CIRCLE.v[0]
    loop = traced(parts, context(DT), (q, v), Reference(*(x[0] for x in lifted)), dt=DT)
    program = Program(loop, cache=Cache(""))
    found = program.run(parts, context(DT), (q[None], v[None]), TIMES, lifted, dt=DT)
    expected, _ = looped(parts, q, v, TIMES, lifted, DT)
    close({name: x[0] for name, x in found.kept.items()}, expected)
    np.testing.assert_allclose(np.hypot(*found.kept["q"][0, :, 2:].T), 1.0, rtol=1e-13)


@pytest.mark.parametrize("difference", [planar_difference, plain_difference])
def test_the_librarys_differences_are_traced(difference: Any) -> None:
    """Whole turns apart, and half a turn, where rounding does not choose the side."""
    plant = Body()
    plant.difference = difference  # type: ignore[method-assign]
    for psi in (0.2, 40.0, np.pi, -np.pi, 1e-12 - np.pi):
        q = np.array([0.1, -0.1, psi])
        close(*both(Parts(plant, PD(4.0, 3.0), (), constant_acceleration, Trace()), q, np.zeros(3)))


class Step(NamedTuple):
    q: Any
    v: Any
    memory: Any


class Motored(Body):
    """A body with a step of its own: its force follows the input with a lag that it remembers."""

    def initial_state(self, context: Any) -> Any:
        return {"force": np.zeros(3)}

    def step(self, t: Any, q: Any, v: Any, u: Any, h: Any, f: Any, memory: Any) -> Step:
        force = memory["force"] + h / 0.05 * (u - memory["force"])
        v1 = v + h * self.forward_dynamics(q, v, force, f(t, q, v))
        return Step(q + h * v1, v1, {"force": force})


def test_a_plant_with_a_step_and_a_memory_of_its_own_needs_no_integrator() -> None:
    parts = Parts(Motored(), PD(20.0, 30.0), (Constant(np.ones(3)),), None, Trace(), substeps=2)
    close(*both(parts, CIRCLE.q[0] + 0.1, CIRCLE.v[0]))


class Opaque:
    """A plant that computes by means of its own, and says what it is in NumPy."""

    nq, nv, nu = 3, 3, 3

    def __init__(self, mass: float) -> None:
        self.mass = mass

    def traced(self) -> Body:
        return Body(self.mass)

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        raise AssertionError


def test_a_plant_that_is_not_numpy_says_what_it_is_in_numpy() -> None:
    parts = Parts(Opaque(22.0), PD(20.0, 30.0), (), constant_acceleration, Trace())
    mass = Place("plant", "mass")
    q, v = CIRCLE.q[:1] + 0.1, CIRCLE.v[:1]
    loop = traced(parts, context(DT), (q[0], v[0]), FIRST, dt=DT, spread=[mass])
    found = Program(loop, cache=Cache("")).run(
        parts, context(DT), (q, v), TIMES, CIRCLE, dt=DT, values={mass: np.array([17.0])}
    )
    plain = Parts(Body(17.0), PD(20.0, 30.0), (), constant_acceleration, Trace())
    expected, _ = looped(plain, q[0], v[0], TIMES, CIRCLE, DT)
    close({name: x[0] for name, x in found.kept.items()}, expected)


def test_forces_on_a_body_that_cannot_be_pushed_are_refused() -> None:
    class Fixed(Body):
        def effort(self, q: Any, wrench: Any) -> None:
            return None

    parts = Parts(Fixed(), PD(1.0, 1.0), (Constant(np.ones(3)),), constant_acceleration)
    with pytest.raises(errors.InvalidArgument, match="cannot be pushed"):
        traced(parts, context(DT), (CIRCLE.q[0], CIRCLE.v[0]), FIRST, dt=DT)


def test_noises_of_one_name_have_numbers_of_their_own() -> None:
    inner = Noisy(PD(20.0, 30.0), np.full(3, 0.01), np.full(3, 0.01))
    parts = Parts(
        Body(), Noisy(inner, np.full(3, 0.01), np.full(3, 0.01)), (), constant_acceleration, Trace()
    )
    q, v = CIRCLE.q[0], CIRCLE.v[0]
    loop = traced(parts, context(DT), (q, v), FIRST, dt=DT)
    # The inner one asks the context first.
    assert loop.keys == ["measurement", "measurement 1"]
    keys = {name: robot_keys(1, name, range(1)) for name in loop.keys}
    found = Program(loop, cache=Cache("")).run(
        parts, context(DT), (q[None], v[None]), TIMES, CIRCLE, dt=DT, keys=keys
    )
    asked = iter(keys.values())
    memory = initial_memory(parts, context(DT), 3, normal=lambda name, n: Noise(next(asked)[0], n))
    for k in range(3):
        now = Reference(*(x[k] for x in CIRCLE))
        step = one_sample(parts, float(k), TIMES[k], DT, (q, v), now, memory)
        np.testing.assert_allclose(found.kept["u"][0, k], step.sample.u, rtol=1e-11)
        q, v, memory = step.q, step.v, step.memory


@dataclass
class Memory:
    """A tree of a user's own."""

    past: Any
    on: bool
    inner: tuple[Any, ...]


def test_memory_is_any_tree_with_truths_and_numbers() -> None:
    class Switching(PD):
        def initial_state(self, context: Any) -> Memory:
            return Memory({"e": [np.zeros((2, 3)), 0]}, False, (None, "name", np.float64(1.0)))

        def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Memory) -> Any:
            e = reference.q - q
            rows, count = state.past["e"]
            rows = np.vstack([e, rows[:1]])
            on = state.on | (np.abs(e[0]) < 0.05)
            u = np.where(on, self.kp * e, 5.0 * rows.mean(axis=0)) + self.kd * (reference.v - v)
            return u, Memory({"e": [rows, count + 1]}, on, (None, "name", state.inner[2] * 0.9))

    parts = Parts(Body(), Switching(30.0, 40.0), (), rk4, Trace())
    found, expected = both(parts, CIRCLE.q[0] + 0.2, CIRCLE.v[0])
    close(found, expected)


class Team(PD):
    """The sum of several controllers, one of which it knows by its method alone."""

    def __init__(self, controllers: Any, robot: Body) -> None:
        super().__init__(1.0, 2.0)
        self.controllers, self.model, self.own = controllers, robot.inverse_dynamics, self.spring

    def spring(self, e: Any) -> Any:
        return self.kp * e

    def initial_state(self, context: Any) -> Any:
        return [each.initial_state(context) for each in self.controllers]

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        answers = [each(t, q, v, reference, s) for each, s in zip(self.controllers, state, strict=True)]
        total = sum(answer[0] for answer in answers)
        return total + self.own(reference.q - q) + self.model(q, v, 0.1 * reference.a), state


@pytest.mark.parametrize("kind", [list, tuple])
def test_parameters_of_parts_in_lists_and_behind_methods_are_found(kind: type) -> None:
    parts = Parts(Body(), Team(kind([PD(20.0, 30.0), PD(5.0, 1.0)]), Body(14.0)), (), rk4, Trace())
    own = {
        Place("controller.controllers[1]", "kp"): np.array([[9.0, 8.0, 7.0], [1.0, 2.0, 3.0]]),
        Place("controller.model", "mass"): np.array([3.0, 50.0]),
        Place("controller", "kp"): np.array([[5.0, 8.0, 7.0], [1.0, 7.0, 3.0]]),
    }
    q, v = np.tile(CIRCLE.q[0] + 0.1, (2, 1)), np.tile(CIRCLE.v[0], (2, 1))
    loop = traced(parts, context(DT), (q[0], v[0]), FIRST, dt=DT, spread=own)
    assert not set(own) & set(loop.unused)
    found = Program(loop, cache=Cache("")).run(parts, context(DT), (q, v), TIMES, CIRCLE, dt=DT, values=own)
    for i in (0, 1):
        mine = parts.with_parameters({name: x[i] for name, x in own.items()})
        assert type(mine.controller.controllers) is kind
        expected, _ = looped(mine, q[i], v[i], TIMES, CIRCLE, DT)
        close({name: x[i] for name, x in found.kept.items()}, expected)
    assert parts.controller.controllers[1].kp[0] == 5.0


def test_many_threads_trace_and_use_numpy_at_once() -> None:
    wrong: list[Any] = []
    stop = threading.Event()

    def use_numpy() -> None:
        while not stop.is_set():
            made = np.zeros(3), np.array([1.0, 2.0]), np.asarray([1.0]), np.eye(2), np.sin(np.ones(2))
            wrong.extend(x for x in made if type(x) is not np.ndarray)
            np.random.default_rng(0).normal(size=2)

    def trace() -> None:
        try:
            parts = Parts(Body(), PD(20.0, 30.0), (Sinusoidal(np.ones(3), 0.5),), rk4, Trace())
            for _ in range(2):
                traced(parts, context(DT), (CIRCLE.q[0], CIRCLE.v[0]), FIRST, dt=DT)
        except Exception as error:
            wrong.append(error)

    user = threading.Thread(target=use_numpy)
    tracers = [threading.Thread(target=trace) for _ in range(3)]
    for thread in (user, *tracers):
        thread.start()
    for thread in tracers:
        thread.join()
    stop.set()
    user.join()
    assert wrong == []
