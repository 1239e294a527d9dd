"""What is remembered of constant parts: what changes is seen all the same, and nothing is kept alive."""

import gc
import weakref
from collections import deque
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pinmobile import (
    PD,
    Allocated,
    Circle,
    ComputedTorque,
    Coulomb,
    Delayed,
    FixedHeading,
    Hold,
    InvalidArgument,
    JointFriction,
    LectureHeading,
    MobileRobot,
    NoiseForce,
    NoisyMeasurement,
    Normal,
    RollingResistance,
    Saturated,
    Scenario,
    Spline,
    Tangent,
    Uniform,
    ViscousFriction,
    WheeledRobot,
    WheelTable,
    WholeBody,
    constant_acceleration,
    ensemble,
    law,
    rk4,
    simulate,
)
from pinmobile.arrays import callable_as, frozen
from pinmobile.compiled import Shape, program_cache as compiled
from pinmobile.compiled.file_cache import Unknown as Undecided
from pinmobile.compiled.parts import Parts, Place
from pinmobile.compiled.passes import traced
from pinmobile.compiled.program import Program
from pinmobile.compiled.program_cache import _memories
from pinmobile.compiled.tracing import Walk
from pinmobile.constancy import is_constant, known
from pinmobile.loop import COMPILED, scenario
from pinmobile.loop._run import way_of
from pinmobile.loop._run import run_scenario
from pinmobile.loop._checks import check_answers
from pinmobile.trajectories import Reference

ROBOT = MobileRobot(30.0, 1.3, com=(0.1, 0.05))
CIRCLE = Tangent(Circle(2.0, 0.2, 4.0))
GAIN = 1.0
STEP = 0.0
CALLS = 0.0


@dataclass(frozen=True)
class Global:
    """A controller whose law reads a global, and counts in another one when it is told to."""

    kp: Any = 40.0
    table: Any = ()
    parameters = ("kp",)

    def initial_state(self, context: Any) -> None:
        return None

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        global CALLS
        if STEP:
            CALLS = CALLS + STEP
        bias = self.table[0] if len(self.table) else 0.0
        return GAIN * self.kp * (reference.q - q) - 50.0 * v + CALLS + bias, state


@dataclass(frozen=True)
class Swaying:
    """A trajectory that reads a global."""

    duration: float = 4.0

    def __call__(self, t: Any) -> Reference:
        q = np.zeros((*np.shape(t), 3))
        q[..., 0] = 0.1 * GAIN * np.asarray(t)
        v = np.zeros_like(q)
        v[..., 0] = 0.1 * GAIN
        return Reference(q, v, np.zeros_like(q))


def errors(controller: Any, trajectory: Any = CIRCLE, **options: Any) -> Any:
    found = ensemble(ROBOT, controller, trajectory, n=3, spread={}, dt=0.02, engine=COMPILED, **options)
    run = simulate(ROBOT, controller, trajectory, dt=0.02, engine=COMPILED, **options)
    np.testing.assert_allclose(found.max_error[0], run.max_error(), rtol=1e-9)
    by_pinocchio = simulate(ROBOT, controller, trajectory, dt=0.02, **options)
    np.testing.assert_allclose(run.q, by_pinocchio.q, rtol=1e-9, atol=1e-9)
    return run.max_error()


# What may change is not taken for constant.


def test_functions_of_pinocchio_are_constant() -> None:
    assert is_constant((pin.rnea, "inverse_dynamics"))


CONSTANT: dict[str, Any] = {
    "robot": ROBOT,
    "computed torque": ComputedTorque(ROBOT, 4, 5),
    "PD with a robot's difference": PD(100, np.eye(3), difference=ROBOT.difference),
    "wrappers": NoisyMeasurement(Delayed(Saturated(PD(100, 20), [1, 2, 3]), 2), 0.1, 0.1, 3),
    "a plain function": law(lambda t, q, v, reference: -q),
    "friction": ViscousFriction([1, 2, 3]),
    "noise": NoiseForce([1, 2, 3], 2.0, 5),
    "rolling": RollingResistance([1, 2, 3]),
    "rk4": rk4,
    "step": constant_acceleration,
    "tangent": CIRCLE,
    "spline": Tangent(Spline([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]], [0, 1, 2])),
    "lecture": LectureHeading(Circle(2, 0.2, 10)),
    "fixed": FixedHeading(Circle(2, 0.2, 10), 0.0),
    "frozen dataclass": Global(),
    "partial": partial(np.add, 1.0),
    "frozen array": frozen([1.0, 2.0]),
}


@pytest.mark.parametrize("name", CONSTANT)
def test_the_librarys_parts_are_constant_and_have_one_number(name: str) -> None:
    thing = CONSTANT[name]
    assert is_constant(thing)
    entry = known(thing)
    assert entry is not None
    assert known(thing) is entry


def attributed(function: Any, **attributes: Any) -> Any:
    vars(function).update(attributes)
    return function


class Counting(SimpleNamespace):
    def count(self, *given: Any) -> Any:
        return given


@dataclass(frozen=True)
class Undecorated(Global):
    pass


class Child(Undecorated):
    """No dataclass of its own: other attributes may be set."""


class Melting(Global):
    __setattr__ = object.__setattr__


@dataclass
class Melted:
    kp: float = 1.0


@dataclass(frozen=True)
class Holder:
    held: Any
    made: Any = field(default=None, init=False)


MAY_CHANGE: dict[str, Any] = {
    "list": [1.0],
    "dict": {"a": 1.0},
    "array": np.ones(3),
    "dataclass": Melted(),
    "child of a frozen one": Child(),
    "function with attributes": attributed(lambda t: t, kp=1.0),
    "method": Counting().count,
    "built-in method": [].append,
    "generator's method": np.random.default_rng(1).normal,
    "partial": partial(np.add, np.ones(3)),
    "objects": np.array([None, None], dtype=object),
}


@pytest.mark.parametrize("name", MAY_CHANGE)
def test_what_may_change_is_not_constant_wherever_it_is_held(name: str) -> None:
    for thing in (MAY_CHANGE[name], (1.0, MAY_CHANGE[name]), Holder(MAY_CHANGE[name])):
        assert not is_constant(thing)
        assert known(thing) is None


def test_an_array_that_is_locked_by_hand_is_not_constant() -> None:
    mine = np.ones(3)
    mine.setflags(write=False)
    assert not is_constant(mine)  # its owner unlocks it
    assert not is_constant(mine[:2])


def test_a_number_is_never_given_again() -> None:
    numbers = set()
    for k in range(50):
        entry = known(Holder(float(k)))  # each at the place of the one before
        assert entry is not None
        numbers.add(entry.number)
    assert len(numbers) == 50


# What changed is seen.


def test_a_law_and_a_trajectory_whose_global_changed_are_run_as_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    controller = Global()
    before = errors(controller), errors(PD(100, 120), Swaying())
    assert np.array_equal(errors(controller), before[0])
    monkeypatch.setitem(globals(), "GAIN", 3.0)
    assert errors(controller)[0] < 0.5 * before[0][0]
    assert errors(PD(100, 120), Swaying())[0] > 1.5 * before[1][0]
    monkeypatch.setitem(globals(), "GAIN", 1.0)
    assert np.array_equal(errors(controller), before[0])


def test_a_law_that_is_replaced_in_its_class_is_run_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Global()
    before = errors(controller)

    def stronger(self: Any, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return 400.0 * (reference.q - q) + 50.0 * (reference.v - v), state

    monkeypatch.setattr(Global, "__call__", stronger)
    assert errors(controller)[0] < 0.5 * before[0]


def test_a_closure_that_changed_is_run_as_it_is() -> None:
    gain = 40.0

    def change(other: float) -> None:
        nonlocal gain
        gain = other

    controller = law(lambda t, q, v, reference: gain * (reference.q - q) + 50.0 * (reference.v - v))
    before = errors(controller)
    change(400.0)
    assert errors(controller)[0] < 0.5 * before[0]


def _raise(part: Any) -> None:
    part.kp = 400.0


def _fill(part: Any) -> None:
    part.table[0] = 20.0


@pytest.mark.parametrize(
    ("make", "change"),
    [
        (lambda: Melting(40.0), _raise),
        (lambda: Global(40.0, [0.0]), _fill),
        (lambda: Global(40.0, np.zeros(1)), _fill),
    ],
    ids=["attribute", "list in a frozen dataclass", "array in a frozen dataclass"],
)
def test_a_part_that_is_changed_between_two_calls_is_run_as_it_is(
    make: Callable[[], Any], change: Callable[[Any], None]
) -> None:
    part = make()
    before = errors(part)
    change(part)
    assert np.abs(errors(part) - before).max() > 0.1 * before.max()


def test_gains_of_another_object_are_those_that_are_run() -> None:
    found = [errors(Global(kp))[0] for kp in (40.0, 400.0, 40.0)]
    assert found[0] == found[2] > 2 * found[1]


def test_a_part_that_turned_bad_is_refused_though_it_was_good_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    controller = Global(41.0)
    errors(controller)
    monkeypatch.setitem(globals(), "STEP", 0.5)
    monkeypatch.setitem(globals(), "CALLS", 0.0)
    with pytest.raises(InvalidArgument, match="asked again for the same arguments"):
        ensemble(ROBOT, controller, CIRCLE, n=3, spread={}, dt=0.02)
    with pytest.raises(InvalidArgument, match="asked again for the same arguments"):
        simulate(ROBOT, controller, CIRCLE, dt=0.02, engine=COMPILED)


def test_other_times_steps_and_spreads_are_not_taken_for_the_last() -> None:
    controller = ComputedTorque(ROBOT, 4, 5)
    lengths = [
        len(simulate(ROBOT, controller, CIRCLE, dt=dt, duration=duration, engine=COMPILED))
        for dt, duration in ((0.1, 4.0), (0.2, 4.0), (0.1, 2.0), (0.1, 4.0))
    ]
    assert lengths == [41, 21, 21, 41]
    spreads: tuple[dict[str, Any], ...] = ({"kp": Uniform(3, 5)}, {"kp.x": Uniform(3, 5)}, {"mass": 31.0})
    for spread in (*spreads, *spreads):
        made = ensemble(ROBOT, controller, CIRCLE, n=4, spread=spread, dt=0.1, engine=COMPILED)
        assert list(made.draws) == list(spread)
        np.testing.assert_allclose(made.max_error[3], made.trace(3).max_error(), rtol=1e-6, atol=1e-12)
    delayed = [errors(Delayed(controller, k))[0] for k in (1, 3, 1)]
    assert delayed[0] == delayed[2] < delayed[1]


# What is known is not asked again, and nothing is kept.


def test_constant_parts_are_checked_once_and_others_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    true = check_answers

    def counting(*given: Any) -> None:
        asked.append(given)
        true(*given)

    monkeypatch.setattr(scenario, "check_answers", counting)
    constant, other = Global(43.0), Global(43.0, [0.0])
    for controller, expected in ((constant, 1), (other, 3)):
        asked.clear()
        for seed in (1, 1, 1):
            ensemble(ROBOT, controller, CIRCLE, n=2, spread={}, dt=0.1, seed=seed)
        assert len(asked) == expected


def test_parts_of_a_robot_with_an_arm_are_checked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = MobileRobot.box().mount("double_pendulum")
    asked: list[Any] = []
    true = check_answers

    def counting(*given: Any) -> None:
        asked.append(given)
        true(*given)

    monkeypatch.setattr(scenario, "check_answers", counting)
    controller, motion = ComputedTorque(robot, 9, 6), WholeBody(robot, CIRCLE, Hold(robot.rest[3:], 4))
    for _ in range(3):
        ensemble(robot, controller, motion, n=2, spread={"mass": 30.0}, dt=0.1, duration=0.2)
        robot.mass_matrix(np.tile(robot.rest, (600, 1)))  # what is compiled for these is none of its laws
    assert len(asked) == 1


def counted(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> list[Any]:
    """Return what a function or method is given from now on."""
    calls: list[Any] = []
    true = getattr(owner, name)

    def counting(*given: Any, **named: Any) -> Any:
        calls.append(given)
        return true(*given, **named)

    monkeypatch.setattr(owner, name, counting)
    return calls


@pytest.mark.parametrize("ground", [None, Coulomb()], ids=["rolling", "Coulomb"])
def test_loops_of_robots_on_wheels_are_remembered(ground: Any) -> None:
    """No code of theirs refers to what may change unseen; without that each call would look at all of it."""
    table = WheelTable.differential(0.5, 0.1, supports=[(0.2, 0.0)], mass=1, spin_inertia=0.01)
    wheeled = WheeledRobot(MobileRobot(30.0, 2.3, com=(0.0, 0.0, 0.1)), table, ground)
    controller = Allocated(PD(50.0, 20.0), WheeledRobot(wheeled.robot, table))
    parts = Parts(wheeled, controller, (), constant_acceleration)
    assert compiled.memory_of(parts, CIRCLE) is compiled.memory_of(parts, CIRCLE)


def test_what_robots_share_of_a_sample_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = MobileRobot.box().mount("double_pendulum")
    controller, motion = ComputedTorque(robot, 9, 6), WholeBody(robot, CIRCLE, Hold(robot.rest[3:], 4))
    waves = [NoiseForce([1, 2, 3], 2.0, 5)]
    made = counted(monkeypatch, Program, "_samples")
    # Options, and how often it has been made then: other times and another step make it anew.
    runs: list[tuple[dict[str, Any], int]] = [
        ({}, 1),
        ({}, 1),
        ({"dt": 0.05}, 2),
        ({"dt": 0.05}, 2),
        ({"dt": 0.05, "substeps": 2}, 3),
        ({}, 4),
    ]
    for options, expected in runs:
        options = {"dt": 0.1, "duration": 0.4, "forces": waves, **options}
        found = ensemble(robot, controller, motion, n=2, spread={"mass": 30.0}, **options)
        assert len(made) == expected
        fresh = ensemble(robot, Changing(controller), motion, n=2, spread={"mass": 30.0}, **options)
        np.testing.assert_array_equal(found.max_error, fresh.max_error)
        np.testing.assert_array_equal(found.worst_measure, fresh.worst_measure)
        made.pop()
    made.clear()
    runs_alone = [simulate(robot, controller, motion, dt=0.1, duration=0.4, engine=COMPILED) for _ in "12"]
    assert len(made) == 1
    np.testing.assert_array_equal(runs_alone[0].q, runs_alone[1].q)


class Changing:
    """A controller of which nothing is remembered, as it may change."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def initial_state(self, context: Any) -> Any:
        return self.inner.initial_state(context)

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return self.inner(t, q, v, reference, state)


def test_copies_that_hold_the_same_are_one_object() -> None:
    robot = MobileRobot.box().mount("double_pendulum")
    parts = Parts(robot, Saturated(ComputedTorque(robot, 9, 6), [500] * 5))
    once, again = parts.varying(()), parts.varying(())
    assert once.controller is again.controller is not parts.controller
    assert once.on_symbols().controller is again.on_symbols().controller
    told = parts.varying([(Place("controller.controller.robot", "mass"), 0)])
    assert told.controller is not once.controller


def test_a_part_that_is_known_is_not_looked_at_again_in_another() -> None:
    inner = Global(44.0)
    assert known(inner) is not None
    object.__setattr__(inner, "table", [0.0])  # by force: whoever looks sees what may change
    assert not is_constant(replace(inner))
    assert is_constant((inner, 1.0))


def test_nothing_is_collected_while_code_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    collected: list[bool] = []

    class Watched(Walk):
        def __init__(self, parts: Any) -> None:
            collected.append(gc.isenabled())
            super().__init__(parts)

    monkeypatch.setattr(compiled, "Walk", Watched)
    simulate(ROBOT, Global(45.0), CIRCLE, dt=0.02, engine=COMPILED)
    assert collected == [False]
    assert gc.isenabled()


TABLE: dict[str, Any] = {
    "kp": 2.0,
    "inner": {"kd": [1.0, (3, "a")]},
    "kinds": {"a", "b"},
    "part": Global(1.0),
}


def by_table(t: float, q: Any, v: Any, reference: Any) -> Any:
    return TABLE["kp"] * (reference.q - q) - TABLE["inner"]["kd"][0] * v


TABLE_CHANGES: dict[str, Callable[[], Any]] = {
    "a value": lambda: TABLE.__setitem__("kp", 3.0),
    "a new name": lambda: TABLE.__setitem__("new", 1.0),
    "a name that is gone": lambda: TABLE.pop("part"),
    "a value further in": lambda: TABLE["inner"]["kd"].__setitem__(0, 2.0),
    "one more further in": lambda: TABLE["inner"]["kd"].append(4.0),
    "a set": lambda: TABLE["kinds"].add("c"),
    "another part": lambda: TABLE.__setitem__("part", Global(2.0)),
}


@pytest.mark.parametrize("what", TABLE_CHANGES)
def test_a_table_of_constants_is_looked_at_without_its_form(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in deepcopy(TABLE).items():
        monkeypatch.setitem(TABLE, name, value)
    witness = compiled._Witness(Walk([by_table]))
    forms = counted(monkeypatch, compiled, "_form")
    assert witness.holds()
    assert not forms
    TABLE_CHANGES[what]()
    assert not witness.holds()
    TABLE.pop("new", None)


def test_a_part_in_a_table_is_not_kept_alive() -> None:
    TABLE["gone"] = Global(3.0)
    witness, part = compiled._Witness(Walk([by_table])), weakref.ref(TABLE["gone"])
    assert witness.holds()
    del TABLE["gone"]
    gc.collect()
    assert part() is None
    assert not witness.holds()


def test_a_table_that_holds_itself_is_refused() -> None:
    own: list[Any] = []
    own.append(own)
    with pytest.raises(Undecided):
        compiled._held_by(own)


def _run_and_forgotten() -> list[weakref.ref[Any]]:
    robot, large = MobileRobot(31.0, 1.4), np.ones(1_000_000)
    controller = law(lambda t, q, v, reference: large[0] * 9.0 * (reference.q - q) - 9.0 * v)
    torque = Saturated(ComputedTorque(robot, 4, 5), [50, 50, 50])
    trajectory, force = Tangent(Circle(2.0, 0.1, 5.0)), ViscousFriction([1, 2, 3])
    spread: dict[str, Any] = {"mass": Normal(31, 1)}
    for each in (controller, torque):
        ensemble(robot, each, trajectory, n=2, spread=spread, dt=0.1, forces=[force])
        simulate(robot, each, trajectory, dt=0.1, forces=[force], engine=COMPILED)
    return [weakref.ref(x) for x in (robot, large, controller, torque, trajectory, force, *_with_an_arm())]


def _with_an_arm() -> tuple[Any, ...]:
    robot = MobileRobot.box().mount("double_pendulum")
    controller, friction = Saturated(ComputedTorque(robot, 9, 6), [500] * 5), JointFriction(0.1)
    motion = WholeBody(robot, Tangent(Circle(2.0, 0.1, 5.0)), Hold(robot.rest[3:], 5))
    ensemble(robot, controller, motion, n=2, spread={"mass": 30.0}, dt=0.1, duration=0.2, forces=[friction])
    simulate(robot, controller, motion, dt=0.1, duration=0.2, forces=[friction], engine=COMPILED)
    return robot, controller, motion, friction


def test_nothing_that_was_run_is_kept_alive() -> None:
    died = _run_and_forgotten()
    gc.collect()
    assert [type(reference()) for reference in died] == [type(None)] * len(died)


def test_memories_are_few() -> None:
    for k in range(40):
        simulate(ROBOT, PD(1.0 + 0.01 * k, 1.0), CIRCLE, dt=0.5, engine=COMPILED)
    assert len(_memories) <= 16
    controller = PD(1.0, 1.0)
    for k in range(100):
        simulate(ROBOT, controller, CIRCLE, dt=0.5, duration=0.5 * (1 + k % 8), engine=COMPILED)
        ensemble(ROBOT, controller, CIRCLE, n=1, spread={}, dt=0.5, seed=k)
    assert max(len(memory) for _, memory in _memories.values()) <= 100


# Calls that are known to fit are those of the same signature alone.


def test_a_call_is_looked_at_again_where_the_signature_is_another() -> None:
    def function(a: Any, b: Any, c: Any = 0) -> Any:
        return a

    callable_as("f(a, b)", function)
    function.__defaults__ = None
    with pytest.raises(InvalidArgument, match="missing a required argument: 'c'"):
        callable_as("f(a, b)", function)

    class Made:
        pass

    def method(self: Any, a: Any) -> Any:
        return a

    Made.method = method  # type: ignore[attr-defined]
    callable_as("f(a, b)", method)
    with pytest.raises(InvalidArgument, match="too many positional arguments"):
        callable_as("f(a, b)", Made().method)  # type: ignore[attr-defined]
    callable_as("f(a)", Made().method)  # type: ignore[attr-defined]


# Fewer draws.


class Pairs:
    """A distribution of two draws for each number, all the first before all the second."""

    def sample(self, generator: np.random.Generator, size: int) -> Any:
        return 30 + generator.uniform(0, 1, size) + generator.uniform(0, 1, size)


@pytest.mark.parametrize(
    "source", [Pairs(), Uniform(20, 40), Normal(30, 1)], ids=["pairs", "uniform", "normal"]
)
def test_the_first_robots_are_the_same_for_every_number_of_robots(source: Any) -> None:
    several = {
        n: scenario.Scenario(
            robot=ROBOT, controller=PD(100, 20), trajectory=CIRCLE, n=n, spread={"mass": source}, dt=0.5
        ).draws()["mass"]
        for n in (1, 7, 4096, 4097, 5000)
    }
    for n, values in several.items():
        assert np.array_equal(values, several[5000][:n])


def test_one_robot_alone_runs_as_scalar_code_with_the_same_bits() -> None:
    robot = MobileRobot.box().mount("double_pendulum")
    controller, motion = ComputedTorque(robot, 9, 6), WholeBody(robot, CIRCLE, Hold(robot.rest[3:], 4))
    spread: dict[str, Any] = {"mass": Uniform(25, 35)}
    told: dict[str, Any] = {"spread": spread, "dt": 0.1, "duration": 0.5, "forces": [JointFriction(0.1)]}
    one, three = (
        Scenario(robot=robot, controller=controller, trajectory=motion, n=n, **told) for n in (1, 3)
    )
    shapes = [way_of(each).program.shape for each in (one, three)]  # type: ignore[union-attr]
    assert shapes[0] == Shape(1, 1)
    assert shapes[1].width > 1
    alone, all_three = run_scenario(one), run_scenario(three)
    for name in ("max_error", "rms_error", "max_force", "worst_measure", "rms_measure"):
        np.testing.assert_array_equal(getattr(alone, name)[0], getattr(all_three, name)[0])


class Queue(deque[float]):
    pass


BOX, GAINS, QUEUE, OWN_QUEUE = SimpleNamespace(w=2.0), [100.0], deque([2.0]), Queue([2.0])


class Plan:
    k = 2.0

    def gain(self) -> float:
        return self.k


PLAN = Plan()
BOUND = PLAN.gain


def halved(settings: dict[str, float]) -> float:
    return settings["w"] / 2


SETTINGS = {"w": 2.0}
HALVED = partial(halved, SETTINGS)


@dataclass(slots=True)
class Slotted:
    k: float = 2.0


class Beside(Slotted):
    """It has slots of its base and a dictionary beside these."""

    def __call__(self, t: float, q: Any, v: Any, reference: Any) -> Any:
        return self.k * (reference.q - q) - v


BESIDE = Beside()


def by_namespace(t: float, q: Any, v: Any, reference: Any) -> Any:
    return BOX.w * (reference.q - q) - v


def by_queue(t: float, q: Any, v: Any, reference: Any) -> Any:
    return QUEUE[0] * (reference.q - q) - v


def by_own_queue(t: float, q: Any, v: Any, reference: Any) -> Any:
    return OWN_QUEUE[0] * (reference.q - q) - v


def by_default(t: float, q: Any, v: Any, reference: Any, gains: Any = GAINS) -> Any:
    return gains[0] * (reference.q - q) - v


def by_keyword(t: float, q: Any, v: Any, reference: Any, *, gains: Any = GAINS) -> Any:
    return gains[0] * (reference.q - q) - v


def by_attribute(t: float, q: Any, v: Any, reference: Any) -> Any:
    return by_attribute.gain * (reference.q - q) - v  # type: ignore[attr-defined]


def by_bound_method(t: float, q: Any, v: Any, reference: Any) -> Any:
    return BOUND() * (reference.q - q) - v


def by_partial(t: float, q: Any, v: Any, reference: Any) -> Any:
    return HALVED() * (reference.q - q) - v


def by_code(t: float, q: Any, v: Any, reference: Any) -> Any:
    return 2.0 * (reference.q - q) - v


def by_other_code(t: float, q: Any, v: Any, reference: Any) -> Any:
    return 20.0 * (reference.q - q) - v


def double(x: Any) -> Any:
    return 2.0 * x


def twenty_times(x: Any) -> Any:
    return 20.0 * x


def by_helper(t: float, q: Any, v: Any, reference: Any) -> Any:
    return double(reference.q - q) - v


OWN = {2.0: by_code.__code__, 20.0: by_other_code.__code__}
HELPERS = {2.0: double.__code__, 20.0: twenty_times.__code__}
CHANGES: dict[str, tuple[Any, Callable[[float], Any]]] = {
    "code": (by_code, lambda x: setattr(by_code, "__code__", OWN[x])),  # as %autoreload changes it
    "code of a helper": (by_helper, lambda x: setattr(double, "__code__", HELPERS[x])),
    "namespace": (by_namespace, lambda x: setattr(BOX, "w", x)),
    "deque": (by_queue, lambda x: QUEUE.__setitem__(0, x)),
    "subclass of a deque": (by_own_queue, lambda x: OWN_QUEUE.__setitem__(0, x)),
    "entry of a default": (by_default, lambda x: GAINS.__setitem__(0, x)),
    "default": (by_default, lambda x: setattr(by_default, "__defaults__", ([x],))),
    "default by keyword": (by_keyword, lambda x: setattr(by_keyword, "__kwdefaults__", {"gains": [x]})),
    "attribute of a function": (by_attribute, lambda x: setattr(by_attribute, "gain", x)),
    "bound method": (by_bound_method, lambda x: setattr(PLAN, "k", x)),
    "partial": (by_partial, lambda x: SETTINGS.__setitem__("w", x)),
    "slots and a dictionary": (BESIDE, lambda x: setattr(BESIDE, "k", x)),
}


@pytest.mark.parametrize("what", CHANGES)
def test_what_a_law_reaches_in_any_way_is_seen_when_it_changes(what: str) -> None:
    function, change = CHANGES[what]
    for value in (2.0, 20.0):
        change(value)
        one = ensemble(ROBOT, law(function), CIRCLE, n=1, spread={}, dt=0.1)
        assert one.engine == "COMPILED"
        alone = simulate(ROBOT, law(function), CIRCLE, dt=0.1)
        np.testing.assert_allclose(one.max_error[0], alone.max_error(), rtol=1e-12, atol=1e-12)


def test_what_the_library_has_is_compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Any] = []

    def counted(*args: Any, **named: Any) -> Any:
        calls.append(args)
        return traced(*args, **named)

    monkeypatch.setenv("PINMOBILE_CACHE", "")  # what another process left in files is another question
    monkeypatch.setattr(compiled, "traced", counted)
    for controller in (ComputedTorque(ROBOT), Saturated(Delayed(PD(4.0, 5.0), 1), 9.0)):
        forces = NoiseForce((1, 1, 0.1), 1.0, seed=0), RollingResistance((1, 1, 0.1), 0.05)
        for _ in range(2):
            ensemble(
                ROBOT, controller, CIRCLE, n=2, spread={"mass": 30.0}, dt=0.1, forces=forces, integrator=rk4
            )
    assert len(calls) == 2
