"""Compiled loops: summaries, bits, plants and memories of one's own; what cannot be compiled."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import errors
from pinmobile.compiled import BINS, FIRST, SHIFT, Cache, Program, Shape, Target
from pinmobile.compiled.program import _functions as functions
from pinmobile.forces import SinusoidalForce
from pinmobile.integrators import RungeKuttaNystrom, constant_acceleration, rk4, semi_implicit_euler
from pinmobile.loop import Loop, Samples, Worst
from pinmobile.loop._engines import Compiled
from pinmobile.parts import evolved, replace
from pinmobile.plant import Input
from pinmobile.trajectories import Reference
from tests import looping
from tests.looping import CIRCLE, PD, TIMES, Body, assert_near, looped, told
from tests.parts import PID


def plain(controller: Any, plant: Any = None, integrator: Any = constant_acceleration) -> Loop:
    return Loop(looping.Body() if plant is None else plant, controller, None, (), integrator)


def test_the_summary_is_that_of_the_samples() -> None:
    loop, n, every = looping.COMPOSITIONS["pid"](), 21, 7
    counted = looping.built(loop, recorder=Worst(limit=1e3, begin=50.0))
    summary, kept = looping.ran(counted, n, every=every), looping.ran(looping.built(loop), n).kept
    error = np.array([[loop.plant.difference(*pair) for pair in zip(q, looping.CIRCLE.q)] for q in kept["q"]])  # noqa: B905
    record = counted.recorder_memory(summary)
    assert (record["lived"] == looping.COUNT).all()
    np.testing.assert_array_equal(record["largest"], np.abs(error[:, 50:]).max(axis=1))
    far = np.square(error[..., :2]).sum(axis=2)
    np.testing.assert_array_equal(record["farthest"][:, 0], far[:, 50:].max(axis=1))
    np.testing.assert_allclose(record["squares"], np.square(error[:, 50:]).sum(axis=1), rtol=1e-13)
    np.testing.assert_array_equal(record["inputs"], np.abs(kept["u"]).max(axis=1))
    for j, sizes in enumerate((np.sqrt(far), np.abs(error[..., 2]))):
        for row, k in enumerate(range(0, looping.COUNT, every)):
            bins = (np.ascontiguousarray(sizes[:, k]).view(np.int64) >> SHIFT) - FIRST + 1
            expected = np.bincount(np.clip(bins, 0, BINS - 1), minlength=BINS)
            np.testing.assert_array_equal(summary.counts[row, j], expected)


def test_what_diverges_is_counted_so_far_and_in_the_last_bin() -> None:
    compiled = looping.built(plain(looping.PD(-400.0, -400.0), integrator=rk4), recorder=Worst(limit=5.0))
    found = looping.ran(compiled, 5, every=looping.COUNT - 1)
    record = compiled.recorder_memory(found)
    assert (record["alive"] == 0).all()
    assert (record["lived"] < looping.COUNT).all()
    assert (record["largest"] <= 5).all()
    np.testing.assert_array_equal(found.counts[1, :, -1], [5, 5])


def test_a_law_may_write_into_what_it_is_given() -> None:
    class Writing(looping.PD):
        def initial_state(self, context: Any) -> Any:
            return {"sum": np.zeros(3)}

        def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
            reference.q[:] -= q
            q[:] = 0.0
            state["sum"] += 0.01 * reference.q
            return self.kp * reference.q + self.kd * (reference.v - v) + state["sum"], state

    loop = plain(Writing(), integrator=rk4)
    q, v = looping.started(loop.plant, 2)
    expected = looping.looped(loop, q[1], v[1])
    looping.assert_near(
        {name: x[1] for name, x in looping.ran(looping.built(loop, {}), 2).kept.items()}, expected
    )
    summary = looping.built(loop, {}, Worst())
    error = [loop.plant.difference(a, b) for a, b in zip(expected["q"], looping.CIRCLE.q, strict=True)]
    largest = summary.recorder_memory(looping.ran(summary, 2))["largest"]
    np.testing.assert_allclose(largest[1], np.abs(error).max(axis=0), rtol=1e-11)


def test_limits_of_the_plant_are_kept_and_told_to_the_controller() -> None:
    class Weak(looping.Body):
        inputs = tuple(Input(f"u{x}", "N", -x, x) for x in (15.0, 1e9, 2.0))

    loop = plain(PID(120.0, 20.0, 120.0), Weak())
    found = looping.ran(looping.built(loop), 4).kept
    assert np.abs(found["u"]).max(axis=(0, 1))[0] == 15.0
    assert np.abs(found["u"]).max(axis=(0, 1))[1] > 15.0
    q, v = looping.started(loop.plant, 4)
    expected = looping.looped(replace(loop, {"plant.mass": 0.8 * 30.0}), q[0], v[0])
    looping.assert_near({name: x[0] for name, x in found.items()}, expected)


# Bits.

TARGETS = {
    "AVX-512": (Target("skylake-avx512", "", 8), Shape(8, 2)),
    "AVX-512, one vector": (Target("skylake-avx512", "", 8), Shape(8, 1)),
    "AVX2": (Target("haswell", "", 4), Shape(4, 2)),
    "AVX2 of eight": (Target("haswell", "", 4), Shape(8, 1)),
    "SSE2": (Target("x86-64", "", 2), Shape(2, 2)),
    "SSE2 of eight": (Target("x86-64", "", 2), Shape(8, 1)),
    "scalar": (Target("x86-64", "", 1), Shape(1, 1)),
}


def targets() -> dict[str, tuple[Target, Shape]]:
    """Return those that this machine runs; on another family, its own in all shapes."""
    here = Target.host()
    if "avx" not in here.features:
        return {str(shape): (here, shape) for _, shape in TARGETS.values()}
    has = {8: "+avx512f" in here.features, 4: "+avx2" in here.features}
    return {name: each for name, each in TARGETS.items() if has.get(each[0].lanes, True)}


@pytest.mark.parametrize("name", ["all", "wheels, delayed"])
def test_the_bits_are_those_of_every_processor(name: str) -> None:
    found = {}
    for label, (target, shape) in targets().items():
        compiled = looping.built(
            looping.COMPOSITIONS[name](), recorder=Worst(limit=1e3), target=target, shape=shape
        )
        for optimised in (False, True):
            if optimised:
                compiled.program.code()
            out = looping.ran(compiled, 37, every=20)
            found[f"{label}, optimised: {optimised}"] = (*compiled.recorder_memory(out).values(), out.counts)
    first = next(iter(found.values()))
    for label, arrays in found.items():
        for one, other in zip(first, arrays, strict=True):
            np.testing.assert_array_equal(one, other, err_msg=label)


def test_a_program_that_has_run_for_long_is_optimised(tmp_path: Path) -> None:
    def files() -> list[str]:
        return ["quick" if "quick" in file.name else "optimised" for file in tmp_path.iterdir()]

    functions.clear()  # as in a new process
    program = looping.built(looping.COMPOSITIONS["pid"](), cache=Cache(tmp_path)).program
    assert files() == []  # before it is known how long it runs
    quick = program.code(60_000)
    assert files() == ["quick"]
    optimised = program.code(60_000)
    assert optimised is not quick
    assert sorted(files()) == ["optimised", "quick"]
    assert program.code(1) is optimised
    assert Program(program.tape, cache=Cache(tmp_path)).code(1) is optimised  # which is known


# What cannot be compiled, and bad input.


class Law:
    def __init__(self, function: Callable[..., Any], state: Any = None) -> None:
        self.function, self.state = function, state

    def initial_state(self, context: Any) -> Any:
        return self.state

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return self.function(t, q, v, reference, state)


KEPT: list[Any] = []


def keeping(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
    KEPT.append(q)
    return reference.q - KEPT[-2 if len(KEPT) > 1 else -1], state


def renaming(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
    return reference.q - q, {**(state or {}), "new": q}


def deceived(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
    return (reference.q - q) * (1.0 if isinstance(q, np.ndarray) else 2.0), state


# The law, its first state, and what is said of it: what, and what to write instead.
REFUSED: dict[str, tuple[Any, Any, str, str]] = {
    "a symbol that is kept": (keeping, None, "", "memory in state"),
    "other names in memory": (renaming, {"old": 0.0}, "'new'", "initial_state"),
    "another thing on symbols": (deceived, None, "with numbers", "isinstance"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_law_that_cannot_be_compiled_is_refused_with_what_to_write(name: str) -> None:
    function, state, what, instead = REFUSED[name]
    with pytest.raises(errors.NotTraceable) as caught:
        looping.built(plain(Law(function, state)), {})
    assert what in caught.value.obstacle
    assert instead in caught.value.remedy


def test_a_delay_that_is_pushed_twice_is_refused() -> None:
    class Twice(looping.PD):
        def initial_state(self, context: Any) -> Any:
            return context.delay(2)

        def __call__(self, t: Any, q: Any, v: Any, reference: Any, line: Any) -> Any:
            _, line = line.push(q)
            old, line = line.push(v)
            return reference.v - old, line

    with pytest.raises(errors.NotTraceable, match="pushed twice"):
        looping.built(plain(Twice()), {})


def test_a_laws_own_error_comes_as_it_is() -> None:
    def broken(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        looping.built(plain(Law(broken)), {})
    with pytest.raises(errors.InvalidArgument, match=r"expected an array of shape \(3,\)"):
        looping.built(plain(Law(lambda t, q, v, reference, state: (q[:2], state))), {})


# -- what a plant may be, and what parts may hold --------------------------------------------------


def compiled(loop: Loop, q: Any, v: Any, reference: Any = CIRCLE) -> dict[str, Any]:
    """Return the samples of robots that start at rows of q and v."""
    loop = evolved(loop, {"recorder": Samples()})
    first = Reference(*(x[0] for x in reference))
    made = Compiled(loop, told(loop, TIMES, reference), (q[0], v[0]), first, spread={})
    return dict(made.run((q, v), TIMES, reference, values={}, keys={}).kept)


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
