"""Compiled loops beside the same parts run by NumPy, sample after sample."""

from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pinmobile import errors
from pinmobile.compiled import (
    BINS,
    FIRST,
    SHIFT,
    Cache,
    Outcome,
    Parts,
    Place,
    Program,
    Reference,
    Shape,
    Summary,
    Target,
    Trace,
    robot_keys,
    traced,
)
from pinmobile.compiled.processor import CODE
from tests.looping import (
    PD,
    PID,
    AxleFriction,
    Body,
    ComputedTorque,
    Constant,
    Delayed,
    Noisy,
    Rolling,
    Saturated,
    Sinusoidal,
    Sliding,
    TwoWheels,
    Viscous,
    WheelFollower,
    circle,
    constant_acceleration,
    context,
    looped,
    rk4,
    semi_implicit,
)

DT, COUNT = 0.01, 301
TIMES, CIRCLE = circle(DT, COUNT)
NONE = Cache("")


def model() -> Body:
    return Body(31.0, 1.2, (0.12, 0.04))


def torque() -> ComputedTorque:
    return ComputedTorque(model(), 4.0, [4.0, 4.0, 5.0])


def noisy(controller: Any) -> Noisy:
    return Noisy(controller, np.full(3, 0.001), np.full(3, 0.005))


def smooth() -> tuple[Any, ...]:
    return Viscous(np.array([5.0, 8.0, 2.0])), Sinusoidal(np.array([3.0, 2.0, 1.0]), 0.5)


def rough() -> tuple[Any, ...]:
    return Constant(np.array([2.0, 1.0, 0.1])), Rolling(np.array([3.0, 5.0, 1.0]), np.full(3, 0.1))


LIMITS = np.array([60.0, 60.0, 5.0])
MASS = np.array([30.0, 30.0, 1.3])
COMPOSITIONS: dict[str, Callable[[], Parts]] = {
    "computed torque": lambda: Parts(Body(), torque(), (), constant_acceleration),
    "pd, smooth forces": lambda: Parts(Body(), PD(120.0, 120.0), smooth(), constant_acceleration),
    "rough forces": lambda: Parts(Body(), torque(), rough(), semi_implicit),
    "saturated": lambda: Parts(Body(), Saturated(torque(), LIMITS), smooth(), rk4),
    "delayed": lambda: Parts(Body(), Delayed(torque(), 5), (), constant_acceleration),
    "delayed by one, twice": lambda: Parts(Body(), Delayed(Delayed(PD(20.0, 25.0), 1), 2), (), rk4),
    "not delayed": lambda: Parts(Body(), Delayed(torque(), 0), rough(), rk4),
    "noisy": lambda: Parts(Body(), noisy(torque()), (), constant_acceleration),
    "pid": lambda: Parts(Body(), PID(120.0, 20.0, 120.0, 200.0), rough(), constant_acceleration),
    "pid, saturated": lambda: Parts(Body(), Saturated(PID(90.0, 20.0, 90.0, 50.0), LIMITS), smooth(), rk4),
    "sliding, tanh": lambda: Parts(Body(), Sliding(1.5, [40, 40, 3], 0.5, MASS), smooth(), rk4),
    "sliding, clip": lambda: Parts(Body(), Sliding(1.5, [40, 40, 3], 0.5, MASS, False), rough(), rk4),
    "substeps": lambda: Parts(Body(), torque(), smooth(), rk4, substeps=3),
    "all": lambda: Parts(
        Body(), Saturated(Delayed(noisy(torque()), 5), LIMITS), (*smooth(), *rough()), rk4, substeps=2
    ),
    "wheels": lambda: Parts(TwoWheels(), WheelFollower(), (), constant_acceleration),
    "wheels, forces": lambda: Parts(TwoWheels(), WheelFollower(), (*smooth(), AxleFriction(0.01)), rk4),
    "wheels, delayed": lambda: Parts(TwoWheels(), Delayed(WheelFollower(), 3), rough(), semi_implicit),
}
MASSES = Place("plant", "mass")


def started(plant: Any, n: int) -> tuple[Any, Any]:
    """Return starts off the circle, on the constraints of a plant that has some."""
    rng = np.random.default_rng(5)
    q, v = np.zeros((n, plant.nq)), np.zeros((n, plant.nv))
    q[:, :3] = CIRCLE.q[0] + rng.normal(0, 0.1, (n, 3))
    v[:, :3] = CIRCLE.v[0]
    if hasattr(plant, "project"):
        v = np.array([plant.project(*pair) for pair in zip(q, v, strict=True)])
    return q, v


def built(parts: Parts, spread: Any = (MASSES,), **options: Any) -> Program:
    start = started(parts.plant, 1)
    first = Reference(*(x[0] for x in CIRCLE))
    loop = traced(parts, context(DT), (start[0][0], start[1][0]), first, dt=DT, spread=spread)
    return Program(loop, **{"cache": NONE} | options)


def ran(program: Program, parts: Parts, n: int, **options: Any) -> Outcome:
    values = {MASSES: np.linspace(0.8, 1.2, n) * parts.plant.mass} if program.loop.rows else {}
    keys = {name: robot_keys(7, name, range(n)) for name in program.loop.keys}
    given: dict[str, Any] = {"values": values, "keys": keys} | options
    return program.run(parts, context(DT), started(parts.plant, n), TIMES, CIRCLE, dt=DT, **given)


@pytest.mark.alike
@pytest.mark.parametrize("name", COMPOSITIONS)
def test_a_compiled_loop_is_the_loop_in_numpy(name: str) -> None:
    parts = COMPOSITIONS[name]()
    recorded = Parts(parts.plant, parts.controller, parts.forces, parts.integrator, Trace(), parts.substeps)
    program, n = built(recorded), 19
    found = ran(program, recorded, n)
    q, v = started(parts.plant, n)
    masses = np.linspace(0.8, 1.2, n) * parts.plant.mass
    keys = robot_keys(7, "measurement", range(n))
    for i in (0, 8, 18):
        mine = recorded.with_parameters({MASSES: masses[i]})
        expected, memory = looped(mine, q[i], v[i], TIMES, CIRCLE, DT, int(keys[i]))
        for each, rows in expected.items():
            largest = np.abs(rows).max(axis=0)
            # What contracts keeps the last bits of sine and tanh, which are NumPy's own there, small.
            assert (np.abs(found.kept[each][i] - rows) <= 1e-11 * np.maximum(largest, 1e-3)).all(), each
        if isinstance(memory.controller, dict):
            np.testing.assert_allclose(
                found.memory.controller["integral"][i], memory.controller["integral"], rtol=1e-10
            )


def test_the_summary_is_that_of_the_samples() -> None:
    parts = COMPOSITIONS["saturated"]()
    n, every = 21, 7
    counted = Parts(
        parts.plant, parts.controller, parts.forces, parts.integrator, Summary(limit=1e3, begin=50.0)
    )
    recorded = Parts(parts.plant, parts.controller, parts.forces, parts.integrator, Trace())
    summary = ran(built(counted), counted, n, every=every)
    kept = ran(built(recorded), recorded, n).kept
    error = np.array(
        [
            [parts.plant.difference(q, d) for q, d in zip(kept["q"][i], CIRCLE.q, strict=True)]
            for i in range(n)
        ]
    )
    record = summary.memory.recorder
    assert (record["lived"] == COUNT).all()
    np.testing.assert_array_equal(record["largest"], np.abs(error[:, 50:]).max(axis=1))
    far = np.square(error[..., :2]).sum(axis=2)
    np.testing.assert_array_equal(record["farthest"][:, 0], far[:, 50:].max(axis=1))
    np.testing.assert_allclose(record["squares"], np.square(error[:, 50:]).sum(axis=1), rtol=1e-13)
    np.testing.assert_array_equal(record["inputs"], np.abs(kept["u"]).max(axis=1))
    for j, sizes in enumerate((np.sqrt(far), np.abs(error[..., 2]))):
        for row, k in enumerate(range(0, COUNT, every)):
            bins = (np.ascontiguousarray(sizes[:, k]).view(np.int64) >> SHIFT) - FIRST + 1
            expected = np.bincount(np.clip(bins, 0, BINS - 1), minlength=BINS)
            np.testing.assert_array_equal(summary.counts[row, j], expected)


def test_what_diverges_is_counted_so_far_and_in_the_last_bin() -> None:
    parts = Parts(Body(), PD(-400.0, -400.0), (), rk4, Summary(limit=5.0))
    found = ran(built(parts), parts, 5, every=COUNT - 1)
    record = found.memory.recorder
    assert (record["alive"] == 0).all()
    assert (record["lived"] < COUNT).all()
    assert (record["largest"] <= 5).all()
    np.testing.assert_array_equal(found.counts[1, :, -1], [5, 5])


def test_one_that_is_no_number_is_not_alive_though_no_input_says_so() -> None:
    class Lost(Body):
        def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
            return np.where(v > 0.3, np.sqrt(-1.0 - v * v), 0.1 + 0 * v)

    class Still(PD):
        def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
            return np.zeros(3), state

    parts = Parts(Lost(), Still(1.0, 1.0), (), constant_acceleration, Summary())
    with np.errstate(invalid="ignore"):
        found = ran(built(parts, ()), parts, 3)
    assert (found.memory.recorder["alive"] == 0).all()
    assert np.isfinite(found.memory.recorder["largest"]).all()


def test_one_object_serves_all_numbers_that_are_not_spread() -> None:
    class Counting(Cache):
        written = 0

        def write(self, key: str, code: bytes, kind: str = CODE) -> None:
            Counting.written += 1

    for gain, step, mass, limit in ((4.0, 0.01, 31.0, 50.0), (9.0, 0.005, 17.0, 3.0)):
        controller = Saturated(ComputedTorque(Body(mass), gain, gain), np.full(3, limit))
        parts = Parts(Body(), controller, rough(), rk4, Trace())
        start = started(parts.plant, 1)
        first = Reference(*(x[0] for x in CIRCLE))
        loop = traced(parts, context(step), (start[0][0], start[1][0]), first, dt=step)
        program = Program(loop, cache=Counting(""))
        found = program.run(parts, context(step), start, TIMES, CIRCLE, dt=step)
        expected, _ = looped(parts, start[0][0], start[1][0], TIMES, CIRCLE, step)
        np.testing.assert_allclose(found.kept["q"][0], expected["q"], rtol=1e-11, atol=1e-13)
    assert Counting.written <= 1


def test_numbers_that_stay_in_memory_are_numbers_of_the_run() -> None:
    parts = Parts(Body(), PID(120.0, 20.0, 120.0, 200.0), (), constant_acceleration, Trace())
    loop = built(parts).loop
    kinds = {leaf.path: leaf.kind for leaf in loop.leaves}
    assert kinds["state['dt']"] == "uniform"
    assert kinds["state['integral']"] == "state"


def test_a_law_may_write_into_what_it_is_given() -> None:
    class Writing(PD):
        def initial_state(self, context: Any) -> Any:
            return {"sum": np.zeros(3)}

        def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
            reference.q[:] -= q
            q[:] = 0.0
            state["sum"] += 0.01 * reference.q
            return self.kp * reference.q + self.kd * (reference.v - v) + state["sum"], state

    parts = Parts(Body(), Writing(20.0, 25.0), (), rk4, Trace())
    found = ran(built(parts, ()), parts, 2)
    q, v = started(parts.plant, 2)
    expected, _ = looped(parts, q[1], v[1], TIMES, CIRCLE, DT)
    np.testing.assert_allclose(found.kept["q"][1], expected["q"], rtol=1e-12, atol=1e-13)
    errors_of = [parts.plant.difference(a, b) for a, b in zip(expected["q"], CIRCLE.q, strict=True)]
    counted = Parts(parts.plant, parts.controller, (), rk4, Summary())
    record = ran(built(counted, ()), counted, 2).memory.recorder
    np.testing.assert_allclose(record["largest"][1], np.abs(errors_of).max(axis=0), rtol=1e-12)


def test_what_no_law_uses_is_named() -> None:
    class Deaf(PD):
        parameters: Any = ("kp", "kd", "color")
        color = 3.0

    parts = Parts(Body(), Deaf(1.0, 1.0), (), constant_acceleration)
    assert built(parts).loop.unused == [Place("controller", "color")]


def test_limits_of_the_plant_are_kept_and_told_to_the_controller() -> None:
    class Weak(Body):
        inputs = tuple(SimpleNamespace(lower=-x, upper=x) for x in (15.0, np.inf, 2.0))

    parts = Parts(Weak(), PID(120.0, 20.0, 120.0, 200.0), (), constant_acceleration, Trace())
    found = ran(built(parts), parts, 4)
    assert np.abs(found.kept["u"]).max(axis=(0, 1))[0] == 15.0
    assert np.abs(found.kept["u"]).max(axis=(0, 1))[1] > 15.0
    q, v = started(parts.plant, 4)
    mine = parts.with_parameters({MASSES: 0.8 * parts.plant.mass})
    expected, memory = looped(mine, q[0], v[0], TIMES, CIRCLE, DT)
    np.testing.assert_allclose(found.kept["q"][0], expected["q"], rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(
        found.memory.controller["integral"][0], memory.controller["integral"], rtol=1e-10
    )


class Believing(PD):
    """Keeps a belief that begins with a parameter, and a gain that is made of parameters."""

    parameters = ("kp", "kd", "belief")

    def __init__(self, belief: float) -> None:
        super().__init__(20.0, 25.0)
        self.belief = belief

    def initial_state(self, context: Any) -> Any:
        return {"belief": 0.5 * self.belief, "gain": self.kd * np.sqrt(self.kp), "rest": 0.0}

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        u = self.kp * (reference.q - q) + state["gain"] * (reference.v - v) + state["belief"]
        return u, {**state, "belief": 0.99 * state["belief"], "rest": u}


class Numbering(Believing):
    """The same, with an initial state that needs numbers."""

    def initial_state(self, context: Any) -> Any:
        return super().initial_state(context) | {"belief": 0.5 * float(self.belief)}


@pytest.mark.parametrize("controller", [Believing(3.0), Numbering(3.0)])
def test_memory_begins_with_what_each_robot_has_of_its_own(controller: Believing) -> None:
    parts = Parts(Body(), controller, (), constant_acceleration, Trace())
    n = 11
    own = {
        Place("controller", "belief"): np.linspace(-9, 9, n),
        Place("controller", "kp"): np.linspace([10, 10, 5], [20, 30, 40], n),
    }
    program = built(parts, own)
    kinds = {leaf.path: leaf.kind for leaf in program.loop.leaves}
    assert kinds == {"state['belief']": "state", "state['gain']": "row", "state['rest']": "state"}
    found = ran(program, parts, n, values=own)
    # What depends on no parameter that is spread in one run does in another.
    alone = Place("plant", "mass")
    known = built(parts, [*own, alone])
    ran(known, parts, n, values={alone: np.full(n, 30.0)})
    again = ran(known, parts, n, values=own)
    np.testing.assert_array_equal(again.kept["u"], found.kept["u"])
    q, v = started(parts.plant, n)
    for i in (0, 5, 10):
        mine = parts.with_parameters({name: x[i] for name, x in own.items()})
        expected, memory = looped(mine, q[i], v[i], TIMES, CIRCLE, DT)
        np.testing.assert_allclose(found.kept["u"][i], expected["u"], rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(found.memory.controller["gain"][i], memory.controller["gain"], rtol=1e-15)


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
    here = Target.here()
    if "avx" not in here.features:
        return {str(shape): (here, shape) for _, shape in TARGETS.values()}
    has = {8: "+avx512f" in here.features, 4: "+avx2" in here.features}
    return {name: each for name, each in TARGETS.items() if has.get(each[0].lanes, True)}


def test_what_is_tabled_for_all_robots_does_not_make_a_loop_too_large_for_two_vectors() -> None:
    waves = tuple(Sinusoidal(np.array([3.0, 2.0, 1.0]), f) for f in np.linspace(0.1, 2.0, 60))
    program = built(Parts(Body(), torque(), waves, constant_acceleration))
    assert len(program.loop.tape) > 2500 > 2 * program.loop.own
    assert program.shape.vectors == 2


@pytest.mark.parametrize("name", ["all", "pid", "sliding, tanh", "wheels, delayed"])
def test_the_bits_are_those_of_every_processor(name: str) -> None:
    parts = COMPOSITIONS[name]()
    parts = Parts(
        parts.plant, parts.controller, parts.forces, parts.integrator, Summary(limit=1e3), parts.substeps
    )
    found = {}
    for label, (target, shape) in targets().items():
        out = ran(built(parts, target=target, shape=shape), parts, 37, every=20)
        found[label] = (*out.memory.recorder.values(), out.counts)
    first = next(iter(found.values()))
    for label, arrays in found.items():
        for one, other in zip(first, arrays, strict=True):
            np.testing.assert_array_equal(one, other, err_msg=label)


@pytest.mark.parametrize("name", ["all", "wheels, forces"])
def test_the_bits_of_a_robot_do_not_depend_on_threads_nor_on_who_runs_beside_it(name: str) -> None:
    parts = COMPOSITIONS[name]()
    parts = Parts(parts.plant, parts.controller, parts.forces, parts.integrator, Summary(), parts.substeps)
    program, n = built(parts), 333
    values = {MASSES: np.linspace(0.8, 1.2, n) * parts.plant.mass}
    keys = {name: robot_keys(7, name, range(n)) for name in program.loop.keys}
    q, v = started(parts.plant, n)

    def some(begin: int, end: int, threads: int) -> Any:
        out = program.run(
            parts,
            context(DT),
            (q[begin:end], v[begin:end]),
            TIMES,
            CIRCLE,
            dt=DT,
            values={name: x[begin:end] for name, x in values.items()},
            keys={name: x[begin:end] for name, x in keys.items()},
            every=10,
            threads=threads,
        )
        return out.memory.recorder, out.counts

    whole, counts = some(0, n, 1)
    for cut in ((0, n), (0, 1, n), (0, 100, 200, n)):
        pieces = [some(begin, end, 3) for begin, end in pairwise(cut)]
        np.testing.assert_array_equal(counts, sum(piece[1] for piece in pieces))
        for name, array in whole.items():
            np.testing.assert_array_equal(array, np.concatenate([piece[0][name] for piece in pieces]))


# What cannot be compiled, and bad input.


class Law(PD):
    def __init__(self, function: Callable[..., Any], state: Any = None) -> None:
        super().__init__(1.0, 1.0)
        self.function, self.state = function, state

    def initial_state(self, context: Any) -> Any:
        return self.state

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return self.function(t, q, v, reference, state)


def refused(function: Callable[..., Any], state: Any = None) -> errors.NotTraceable:
    with pytest.raises(errors.NotTraceable) as caught:
        built(Parts(Body(), Law(function, state), (), constant_acceleration), ())
    return caught.value


def test_a_counter_in_a_closure_is_found() -> None:
    count = [0.0]

    def counting(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        count[0] += 1.0
        return reference.q - q + count[0], state

    error = refused(counting)
    assert "asked again" in error.what
    assert "state" in error.instead
    assert "counting, line" in error.place
    assert "count[0]" in error.place


def test_a_generator_of_ones_own_is_found() -> None:
    rng = np.random.default_rng(0)

    def drawing(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return reference.q - q + rng.normal(size=3), state

    assert "context.normal" in refused(drawing).instead


def test_a_symbol_that_is_kept_is_found() -> None:
    kept: list[Any] = []

    def keeping(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        kept.append(q)
        return reference.q - kept[-2 if len(kept) > 1 else -1], state

    assert "memory in state" in refused(keeping).instead


def test_memory_that_changes_its_form_is_refused() -> None:
    def growing(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return reference.q - q, {"past": q}

    error = refused(growing)
    assert "None" in error.what
    assert "initial_state" in error.instead
    error = refused(lambda t, q, v, reference, state: (reference.q - q, {**state, "new": q}), {"old": 0.0})
    assert "'old'" in error.what
    assert "'new'" in error.what


def test_memory_that_grows_without_end_is_refused() -> None:
    def longer(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return reference.q - q, np.concatenate([state, q])

    with pytest.raises((errors.NotTraceable, ValueError)):
        built(Parts(Body(), Law(longer, np.zeros(3)), (), constant_acceleration), ())


def test_a_law_that_does_another_thing_with_symbols_is_refused() -> None:
    def deceived(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return (reference.q - q) * (1.0 if isinstance(q, np.ndarray) else 2.0), state

    error = refused(deceived)
    assert "on numbers" in error.what
    assert "isinstance" in error.instead


def test_a_law_with_too_many_operations_is_refused() -> None:
    def endless(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        x = q
        for _ in range(10_000):
            x = x - 0.1 * np.sin(x)
        return reference.q - x, state

    error = refused(endless)
    assert "30000 operations" in error.what
    assert "PYTHON" in error.instead
    assert "endless, line" in error.place


def test_a_delay_that_is_pushed_twice_is_refused() -> None:
    class Twice(Delayed):
        def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
            inner, line = state
            _, line = line.push(q)
            old, line = line.push(v)
            return reference.v - old, (inner, line)

    with pytest.raises(errors.NotTraceable, match="pushed twice"):
        built(Parts(Body(), Twice(PD(1.0, 1.0), 2), (), constant_acceleration), ())


def test_a_laws_own_error_comes_as_it_is() -> None:
    def broken(t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        built(Parts(Body(), Law(broken), (), constant_acceleration), ())


def test_names_that_there_are_not_are_answered_with_those_there_are() -> None:
    parts = COMPOSITIONS["computed torque"]()
    with pytest.raises(errors.UnknownName, match=r"'plant.masss', did you mean 'plant.mass'"):
        built(parts, [Place("plant", "masss")])
    program = built(COMPOSITIONS["noisy"]())
    with pytest.raises(errors.InvalidArgument, match=r"expected one for the noise 'measurement'"):
        ran(program, COMPOSITIONS["noisy"](), 3, keys={})


def test_one_value_for_each_robot_is_refused_where_the_loop_has_one_for_all() -> None:
    parts = COMPOSITIONS["computed torque"]()
    program = built(parts)
    with pytest.raises(errors.InvalidArgument, match=r"controller.kp has shape \(3, 3\), expected \(3,\)"):
        ran(program, parts, 3, values={Place("controller", "kp"): np.ones((3, 3))})


def test_an_input_of_another_size_is_refused() -> None:
    parts = Parts(Body(), Law(lambda t, q, v, reference, state: (q[:2], state)), (), constant_acceleration)
    with pytest.raises(errors.InvalidArgument, match=r"expected an array of shape \(3,\)"):
        built(parts, ())


def test_arrays_of_other_shapes_are_refused_and_not_read_beyond() -> None:
    parts = COMPOSITIONS["computed torque"]()
    program = built(parts)
    q, v = started(parts.plant, 3)

    def run(**changed: Any) -> Any:
        given = {"start": (q, v), "t": TIMES, "reference": CIRCLE, "every": 1, "values": {}} | changed
        start, t, reference = (given.pop(name) for name in ("start", "t", "reference"))
        return program.run(parts, context(DT), start, t, reference, dt=DT, **given)

    with pytest.raises(errors.InvalidArgument, match=r"q has shape \(3, 2\), expected \(3, 3\)"):
        run(start=(q[:, :2], v))
    with pytest.raises(errors.InvalidArgument, match=r"v has shape \(2, 3\), expected \(3, 3\)"):
        run(start=(q, v[:2]))
    with pytest.raises(errors.InvalidArgument, match=r"reference.v has shape \(5, 3\), expected \(301, 3\)"):
        run(reference=CIRCLE._replace(v=CIRCLE.v[:5]))
    with pytest.raises(errors.InvalidArgument, match="0 robots"):
        run(start=(q[:0], v[:0]))
    with pytest.raises(errors.InvalidArgument, match="counts every 0"):
        run(every=0)
    with pytest.raises(errors.InvalidArgument, match=r"plant.mass has shape \(4,\), expected \(3,\)"):
        run(values={MASSES: np.ones(4)})
    with pytest.raises(errors.UnknownName, match=r"did you mean 'plant\.mass'"):
        run(values={Place("plant", "masss"): np.ones(3)})
    other = COMPOSITIONS["saturated"]()
    with pytest.raises(errors.InvalidArgument, match=r"parts differ .* in .*controller\.limits"):
        program.run(other, context(DT), (q, v), TIMES, CIRCLE, dt=DT)


def test_one_value_of_a_parameter_that_is_spread_is_each_robots() -> None:
    parts = Parts(Body(), PD(20.0, 25.0), (), rk4, Trace())
    gains = Place("controller", "kp")
    program = built(parts, [gains])
    one = ran(program, parts, 3, values={gains: np.array([9.0, 8.0, 7.0])})
    each = ran(program, parts, 3, values={gains: np.tile([9.0, 8.0, 7.0], (3, 1))})
    np.testing.assert_array_equal(one.kept["u"], each.kept["u"])
