"""One robot, several threads: every public method gives each of them the answer that it gives alone."""

import inspect
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.compiled.symbolic import Symbols
from pinmobile.dh import LECTURE_TABLE
from pinmobile.parts import evolved, replace
from pinmobile.robot import ArticulatedDynamics, PlanarDynamics, Solids, UncheckedDynamics
from pinmobile.robot.articulated import Tree
from pinmobile.urdf import Body, shipped_urdf

THREADS = 4
STATES = 4
ROUNDS = 2  # of what answers in numbers; the rest, which makes robots or reads files, has one
ROBOTS = {"lecture": pm.MobileRobot.lecture(), "ur5": pm.MobileRobot.box().mount("ur5")}
NAMES = [name for name in dir(pm.MobileRobot) if not name.startswith("_") and name != "check"]
ON_ARMS = {"arm_manipulability", "mount_wrench"}  # of a bare robot they are errors
CASES = [(kind, name) for kind in ROBOTS for name in NAMES if kind == "ur5" or name not in ON_ARMS]

RATES = "v", "a", "tau", "dq", "f", "u"
# What to give a parameter of that name, for a robot and the number of a state.
VALUES: dict[str, Callable[[pm.MobileRobot, int], Any]] = {
    **dict.fromkeys(("q", "q0", "value"), lambda robot, k: configuration(robot, k)),
    "q1": lambda robot, k: configuration(robot, k + 1),
    **{name: partial(lambda seed, robot, k: rate(robot, seed, k), seed) for seed, name in enumerate(RATES)},
    "t": lambda robot, k: 0.1 * k,
    "wrench": lambda robot, k: rate(robot, 6, k)[:3],
    "reference": lambda robot, k: pm.Reference(*(rate(robot, seed, k)[:3] for seed in (7, 8, 9))),
    "generator": lambda robot, k: np.random.default_rng(k),
    "path": lambda robot, k: shipped_urdf("lecture"),
    "pin_model": lambda robot, k: robot.base.model,
    "source": lambda robot, k: f"a test, {k}",
    "body": lambda robot, k: Body(10 + k, np.array([0.1, 0, 0.2]), np.diag([1, 1, 1 + k / STATES])),
    "load": lambda robot, k: pm.PayloadBody(1.0 + k, (0, 0, 0.1)),
    "arm": lambda robot, k: "double_pendulum",
    "table": lambda robot, k: LECTURE_TABLE,
    "bodies": lambda robot, k: [VALUES["body"](robot, k)],
    "at": lambda robot, k: (0.1, 0.01 * k, 0.3, 0.1 * k),
}


def configuration(robot: pm.MobileRobot, k: int) -> Array:
    return robot.random_configuration(np.random.default_rng(k))


def rate(robot: pm.MobileRobot, seed: int, k: int) -> Array:
    return np.random.default_rng([seed, k]).normal(size=robot.nv)


def plain(answer: Any) -> Any:
    """Return what can be compared, to the last bit, of an answer."""
    if isinstance(answer, np.ndarray):
        return answer.shape, answer.tobytes()
    if isinstance(answer, pm.MobileRobot):
        return answer, plain(answer.mass_matrix(answer.rest))
    if isinstance(answer, tuple):
        return tuple(map(plain, answer))
    if isinstance(answer, pin.GeometryModel):
        return [
            (item.name, item.parentJoint, item.placement.homogeneous.tobytes())
            for item in answer.geometryObjects
        ]
    if isinstance(answer, ArticulatedDynamics):
        return plain(answer.forward_dynamics(answer.rest, *np.ones((2, answer.nv))))
    if isinstance(answer, UncheckedDynamics):
        q, v, u = np.random.default_rng(1).normal(size=(3, answer.nv))
        return [plain(np.array(x)) for x in (answer.mass_matrix(q), answer.forward_dynamics(q, v, u))]
    if isinstance(answer, Tree):
        return answer.arms, answer.linkage.names, plain(answer.linkage.rotations)
    if isinstance(answer, PlanarDynamics):
        return answer.mass, answer.yaw_inertia, answer.com_x, answer.com_y
    if isinstance(answer, Solids):
        shapes = [(each.link, each.part, each.placement.homogeneous.tobytes()) for each in answer.shapes]
        return shapes, answer.parents, answer.moves, answer.standing
    if isinstance(answer, Body):
        return answer.mass, plain(answer.com), plain(answer.inertia)
    return answer


def ask(robot: pm.MobileRobot, name: str, k: int) -> Any:
    """Return the answer of a property, or of a method to arguments made for its parameters."""
    member = getattr(robot, name)
    if not inspect.isroutine(member):
        return plain(member)
    parameters = inspect.signature(member).parameters.values()
    missing = [p.name for p in parameters if p.default is p.empty and p.name not in VALUES]
    assert not missing, f"{name} is new: say in VALUES what to give as {missing}"
    given = {p.name: VALUES[p.name](robot, k) for p in parameters if p.name in VALUES}
    answer = member(**given)
    return plain(answer)


@pytest.fixture(autouse=True)
def restless() -> Iterator[None]:
    """Let threads take turns as often as they can."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


def together(task: Callable[[int], Any]) -> list[Any]:
    """Return what threads that start at once have found."""
    start = threading.Barrier(THREADS)

    def begin(number: int) -> Any:
        start.wait()
        return task(number)

    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(begin, range(THREADS)))


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_every_answer_is_that_of_one_thread_bit_for_bit(kind: str, name: str) -> None:
    robot = ROBOTS[kind]
    # What is no method has one answer, of a copy that has nothing cached; what makes robots takes long.
    states = STATES if inspect.isroutine(getattr(robot, name)) else 1
    alone = [ask(robot, name, k) for k in range(states)]
    rounds = 1 if states == 1 or isinstance(alone[0][0], pm.MobileRobot) else ROUNDS
    shared = robot if rounds > 1 else fresh(robot)

    def task(number: int) -> int:
        order = [(number + k) % states for k in range(states)] * rounds
        return sum(ask(shared, name, k) != alone[k] for k in order)

    assert together(task) == [0] * THREADS


WHEELS: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.005, "yaw_inertia": 0.003}
BASE = pm.MobileRobot(30.0, 1.3, com=(0.05, 0.02, 0.1), size=(0.6, 0.4, 0.25))
ON_WHEELS = pm.WheeledRobot(BASE.mount("ur5"), pm.WheelTable.car(0.5, 0.46, 0.1, **WHEELS))
ASKED = {
    *("mass_matrix", "nonlinear_effects", "forward_dynamics", "project", "reduced", "constraint_matrix"),
    *("allocate_scaled", "constraint_forces", "integrate", "difference", "drawing", "kinetic_energy"),
}


def of_wheels(robot: pm.WheeledRobot, k: int) -> list[Any]:
    """Return what a robot on wheels answers to numbers, and what it is when made again, of a state."""
    given = {name: rate_of(k, seed, robot.nv) for seed, name in enumerate(("v", "a", "dq"))}
    given |= {"u": rate_of(k, 4, robot.nu), "tau": rate_of(k, 5, robot.robot.nv)}
    for seed, name in enumerate(("q", "q0", "q1")):
        own = robot.robot.random_configuration(np.random.default_rng([k, seed]))
        given[name] = np.append(own, 0.3 * rate_of(k, 6, robot.nq - len(own)))
    found: list[Any] = []
    for name in sorted(ASKED):
        try:
            method = getattr(robot, name)
            parameters = [p for p in inspect.signature(method).parameters if p in given]
            found.append(plain(method(**{p: given[p] for p in parameters})))
        except (AttributeError, pm.InvalidArgument) as error:  # of wheels that slip
            found.append(str(error))
    other = replace(robot, {f"table.wheels.{robot.table.names[0]}.radius": 0.09 + 0.001 * (k + 1)})
    return [*found, other.table, plain(other.mass_matrix(given["q"]))]


def rate_of(k: int, seed: int, size: int) -> Array:
    return np.random.default_rng([k, seed]).normal(size=size)


def test_a_robot_on_wheels_answers_several_threads_as_it_does_one() -> None:
    alone = [of_wheels(ON_WHEELS, k) for k in range(2)]
    assert sum(isinstance(answer, tuple) for answer in alone[0]) > 6
    shared = fresh(ON_WHEELS)

    def task(number: int) -> int:
        order = [number % 2, (number + 1) % 2]
        return sum(of_wheels(shared, k) != alone[k] for k in order)

    assert together(task) == [0] * THREADS


def test_ensembles_whose_laws_ask_one_robot_run_side_by_side() -> None:
    robot = pm.MobileRobot(30, 1.3, com=(0.1, 0.05))
    motion, spread = pm.Tangent(pm.Circle(radius=3, rate=0.1, duration=2)), {"mass": pm.Uniform(20, 40)}
    traced = threading.Event()

    def run(number: int, pause: float = 0.0) -> Any:
        def force(t: float, q: Array, v: Array, reference: Any) -> Any:
            if isinstance(q, Symbols) and pause:  # while this is traced, another thread begins
                traced.set()
                time.sleep(pause)
            error = (number + 1) * (reference.q - q) + 2 * (reference.v - v)
            return robot.nonlinear_effects(q, v) + robot.mass_matrix(q) @ error

        runs = pm.ensemble(robot, pm.law(force), motion, n=8, spread=spread, dt=0.1)
        return runs.engine, plain((runs.max_error, runs.rms_error, runs.max_input))

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(run, 0, 0.3)
        assert traced.wait(60)
        found = [run(1), first.result()]
    assert found == [run(1), run(0)]
    assert {engine for engine, _ in found} == {"COMPILED"}


def fresh(robot: Any) -> Any:
    """Return a robot with nothing cached."""
    return evolved(robot)
