"""What is wrong with a part is told at once, in every engine; and why an engine is no faster one."""

import statistics
import subprocess
import sys
import warnings
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.cli import main
from pinmobile.errors import SlowerEngine
from pinmobile.loop import Engine
from tests.looping import Body
from tests.parts import Cart, CartCircle, Eight, Follower, Nodding, Points, Spring
from tests.refusals import refused

ROBOT = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))
BODY: dict[str, Any] = {"robot": ROBOT, "controller": pm.PD(100, 120), "trajectory": Nodding(Eight())}
CART: dict[str, Any] = {"robot": Cart(), "controller": Follower(), "trajectory": CartCircle()}
OPTIONS: dict[str, Any] = {"dt": 0.02, "duration": 2.0}


def in_ensemble(parts: dict[str, Any], **options: Any) -> Any:
    given: dict[str, Any] = parts | OPTIONS | {"n": 5, "spread": {}} | options
    return pm.ensemble(**given)


def simulated(parts: dict[str, Any], **options: Any) -> Any:
    given: dict[str, Any] = parts | OPTIONS | options
    robot, controller, trajectory = (given.pop(name) for name in ("robot", "controller", "trajectory"))
    return pm.simulate(robot, controller, trajectory, **given)


def assert_refused(parts: dict[str, Any], why: str) -> None:
    """Check that parts are refused for the same reason wherever they are run."""
    for engine in (None, Engine.COMPILED, Engine.PYTHON):
        with refused(why):
            in_ensemble(parts, engine=engine)
    for engine in (None, Engine.COMPILED):
        with refused(why):
            simulated(parts, engine=engine)


# A part without what the loop needs.


class Stateless:
    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return -q, state


class NoDynamics:
    nq = nv = nu = 3


def without(name: str, kind: type = Cart) -> Any:
    return type(f"Without{name}", (kind,), {name: None})()


class Posed(Points):
    pose, pose_rate, generalized_force = Body.pose, Body.pose_rate, Body.generalized_force


LACKING: dict[str, tuple[dict[str, Any], str]] = {
    "controller without a state": (
        BODY | {"controller": Stateless()},
        r"controller is .*Stateless.*expected a controller: .* or law\(function\)",
    ),
    "plant without dynamics": (BODY | {"robot": NoDynamics()}, "expected a plant with 'forward_dynamics'"),
    "no pose to push": (
        BODY | {"robot": Points(), "forces": [Spring()]},
        r"plant is .*Points.*, and forces push its body, "
        r"expected .*pose\(q\), pose_rate\(q, v\) and generalized_force",
    ),
    "no effort to push": (
        CART | {"robot": without("generalized_force"), "forces": [Spring()]},
        r"plant is .*Withoutgeneralized_force.*, which has no generalized_force, and forces push its body",
    ),
    "no place for forces": (
        BODY | {"robot": Posed(), "forces": [Spring()]},
        r"which cannot be called as plant.forward_dynamics\(q, v, u, f\): too many positional arguments",
    ),
    "a model of another plant": (
        CART | {"controller": pm.ComputedTorque(ROBOT)},
        "robot of the controller is MobileRobot.* has 3 coordinates, expected 5, as the plant has",
    ),
    "an input of another size": (
        CART | {"controller": pm.PD(1.0, 1.0)},
        r"controller returned .*, expected .*2,?\)",
    ),
    "a reference of more coordinates": (
        BODY | {"trajectory": CartCircle()},
        r"trajectory at 101 times: q has shape \(101, 5\), expected \(101, 3\)",
    ),
}


def test_a_controllers_robot_without_its_dynamics_is_told_so() -> None:
    with refused(r"^robot is .*Cart.*, which has no inverse_dynamics, expected"):
        pm.ComputedTorque(Cart())


class Spoilt(Cart):
    """A plant one of whose methods returns something else: by default two numbers of five."""

    def __init__(self, wrong: str, change: Any = lambda x: x[..., :2]) -> None:
        super().__init__()
        method = getattr(super(), wrong)
        setattr(self, wrong, lambda *given: change(method(*given)))


# A plant whose sizes contradict each other.


class Named(Cart):
    coordinates = Cart.coordinates[:4]  # type: ignore[assignment]


class Inputs(Cart):
    inputs = Cart.inputs[:1]  # type: ignore[assignment]


CONTRADICTORY: dict[str, tuple[dict[str, Any], str]] = {
    "coordinates": (CART | {"robot": Named()}, "plant has nv = 5 and 4 coordinates, expected equal numbers"),
    "inputs": (CART | {"robot": Inputs()}, "plant has nu = 2 and 1 inputs, expected equal numbers"),
    **{
        f"size of {name}": (
            CART | {"robot": Spoilt(name)},
            rf"a Spoilt with nq = 5, nv = 5 and nu = 2, whose {name}\(.*\) returned .*\({size},\) of re",
        )
        for name, size in (("forward_dynamics", 5), ("pose_rate", 3))
    },
    "size of the start": (
        CART | {"robot": Spoilt("project")},
        r"whose first v has shape \(2,\), expected \(5,\)|v0 has shape \(2,\)",
    ),
}


# Memory outside the state, and random numbers of one's own.


class Counting:
    """A function that returns more each time."""

    def __init__(self, function: Any) -> None:
        self.function, self.count = function, 1.0

    def __call__(self, *given: Any) -> Any:
        self.count += 0.1
        answer = self.function(*given)
        return tuple(self.count * x for x in answer) if type(answer) is tuple else self.count * answer


class Aging(Cart):
    def __init__(self) -> None:
        super().__init__()
        self.forward_dynamics = Counting(super().forward_dynamics)  # type: ignore[assignment, method-assign]


def _step(acceleration: Any, t: float, q: Any, v: Any, h: float) -> Any:
    return q + h * v, v + h * acceleration(t, q, v)


FORGETFUL: dict[str, dict[str, Any]] = {
    "controller": BODY | {"controller": pm.law(lambda t, q, v, r: np.random.normal(size=3))},  # noqa: NPY002
    "np.random": BODY | {"forces": [lambda t, pose, rate: np.random.normal(size=3)]},  # noqa: NPY002
    "counting force": BODY | {"forces": [Spring(), Counting(lambda t, pose, rate: np.ones(3))]},
    "integrator": BODY | {"integrator": Counting(_step)},
    "plant": CART | {"robot": Aging()},
}


ASKED_AGAIN = (
    r"^(controller|forces\[[01]\]|integrator|plant) is .*, (asked|called) again .* the same arguments, .*"
    r"state, and\s.*random numbers"
)


def test_a_tape_that_is_another_each_time_though_its_numbers_are_not_is_refused_when_compiled() -> None:
    count = [0]

    def spelled(t: float, q: Any, v: Any, reference: Any) -> Any:
        count[0] += 1
        error = 100.0 * (reference.q - q) + 120.0 * (reference.v - v)
        return error + 1e-15 * (np.sin(q) if count[0] % 2 else np.tanh(q))

    parts = BODY | {"controller": pm.law(spelled)}
    with refused(r"spelled, line .*runs again.*keep memory in state"):
        in_ensemble(parts, engine=Engine.COMPILED)
    with pytest.warns(SlowerEngine, match=r"by PYTHON.*not COMPILED.*spelled, line .*keep memory in state"):
        run = in_ensemble(parts)
    assert (run.engine, "keep memory in state" in run.fallback_reason) == ("PYTHON", True)


# Laws that cannot be traced.


def branching(t: float, q: Any, v: Any, reference: Any) -> Any:
    error = reference.q - q
    if error[0] > 0.0:
        error[0] *= 2.0
    return 100.0 * error + 120.0 * (reference.v - v)


def _by_eigenvalues(t: float, q: Any, v: Any, reference: Any) -> Any:
    largest = np.linalg.eigvalsh(q[..., :, None] * q[..., None, :])
    return 100.0 * (reference.q - q) + 120.0 * (reference.v - v) + largest


@pytest.mark.parametrize("law", [branching, _by_eigenvalues])
def test_a_law_that_cannot_be_traced_runs_slower_and_says_so_or_is_refused(law: Any) -> None:
    parts, why = BODY | {"controller": pm.law(law)}, rf"{law.__name__}, line \d+ of test_.*np\.where"
    with refused(rf"^engine is Engine.COMPILED, which cannot run this: .*{why}"):
        in_ensemble(parts, engine=Engine.COMPILED)
    with refused(rf"^engine is Engine.COMPILED, which cannot run this: .*{why}"):
        simulated(parts, engine=Engine.COMPILED)
    with pytest.warns(SlowerEngine, match=rf"runs by PYTHON, .*not COMPILED: .*{why}") as told:
        run = in_ensemble(parts)
    assert len(told) == 1
    assert run.engine == "PYTHON"
    assert run.fallback_reason in str(told[0].message)
    alone = simulated(parts)
    assert alone.engine == "PYTHON"
    np.testing.assert_allclose(run.max_error[0], alone.max_error(), rtol=1e-12)


# What is no row of real numbers, or not two of them.


class Complex:
    """A controller that is none of the library's `law`."""

    def initial_state(self, context: Any) -> None:
        return None

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return np.sqrt(reference.q - q + 0j), state


class Pushing:
    def on_coordinates(self, t: float, q: Any, v: Any) -> Any:
        return 1j * v


UNREAL: dict[str, tuple[dict[str, Any], str]] = {
    "complex input": (
        BODY | {"controller": Complex()},
        r"(?s)^controller returned .*j.*, expected real numbers$",
    ),
    "complex law": (
        BODY | {"controller": pm.law(lambda t, q, v, r: 1j * q)},
        r"(?s)^function of the law returned .*j.*, expected an input: nu numbers$",
    ),
    "complex force on coordinates": (
        BODY | {"forces": [Pushing()]},
        r"(?s)^forces\[0\] returned .*j.*, expected an array of shape \(3,\) of real num",
    ),
    "complex integrator": (
        BODY | {"integrator": lambda a, t, q, v, h: (q + h * v, v + h * a(t, q, v) + 0j)},
        r"(?s)^integrator returned .*j.* at t = 0 s, expected \(q, v\) of shapes .*, of real numbers$",
    ),
    **{
        f"complex {name}": (
            CART | {"robot": Spoilt(name, lambda x: x * (1 + 0j))},
            rf"(?s)^plant is a Spoilt .*, whose {name}\(.*\) returned .*j.*, .* real numbers$",
        )
        for name in ("integrate", "generalized_force")
    },
}


WRONG = LACKING | CONTRADICTORY | UNREAL
WRONG |= {f"another answer of {name}": (parts, ASKED_AGAIN) for name, parts in FORGETFUL.items()}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_part_is_refused_for_one_reason_in_every_engine(what: str) -> None:
    assert_refused(*WRONG[what])


class Growing:
    """A controller that keeps all that it has seen, which is possible in Python alone."""

    def initial_state(self, context: Any) -> Any:
        return {"seen": np.zeros((1, 3))}

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        u = 100 * (reference.q - q) + 120 * (reference.v - v) + 1e-3 * state["seen"].mean(axis=0)
        return u, {"seen": np.concatenate([state["seen"], q[None]])}


def test_a_state_that_changes_its_shape_is_named_and_runs_in_python() -> None:
    parts = BODY | {"controller": Growing()}
    why = r"state\['seen'\] of the controller has shape \(2, 3\) and a sample later \(3, 3\); return"
    for run in (simulated, in_ensemble):
        with refused(rf"^engine is Engine.COMPILED, which cannot run this: {why}"):
            run(parts, engine=Engine.COMPILED)
    with pytest.warns(SlowerEngine, match=rf"runs by PYTHON, .*not COMPILED: {why}"):
        runs = in_ensemble(parts, n=2)
    np.testing.assert_allclose(runs.max_error[0], simulated(parts).max_error(), rtol=1e-12)


# -- what results and warnings say of the engine that ran a loop, and of why it was no faster one --


CIRCLE = pm.Tangent(pm.Circle(2, 0.25, 2))
NOT_ASKED = "not COMPILED: give engine=Engine.COMPILED to compile the loop"


def scenario(controller: Any, width: float) -> pm.Scenario:
    spread = {"start.x": pm.Uniform(-width, width)}
    return pm.Scenario(
        robot=pm.MobileRobot.box(), controller=controller, trajectory=CIRCLE, n=12, spread=spread, dt=0.2
    )


def test_a_sweep_tells_once_which_part_makes_it_slower_and_where(tmp_path: Path) -> None:
    widths = {width: pm.Uniform(-width, width) for width in (0.01, 0.02)}
    laws = {"branching": pm.law(branching), "PD": pm.PD(100, 120)}
    plan: Any = scenario(laws["PD"], 0.01), tmp_path / "store"
    grid = {"controller": laws, "spread.start.x": widths}
    with pytest.warns(SlowerEngine, match="^this sweep runs by PYTHON") as told:
        pm.sweep(*plan, grid=grid, chunk=4)
    assert len(told) == 1
    text = str(told[0].message)
    assert told[0].filename == __file__
    for words in ("not COMPILED: branching, line", "np.where", "(at controller = branching, s"):
        assert text.count(words) == 1
    assert text.endswith("spread.start.x = 0.01 and 1 more)")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pm.sweep(*plan, grid=grid, chunk=4)  # nothing is left to run


def test_the_line_is_that_of_the_law_and_not_one_of_python() -> None:
    def leaning(t: float, q: Any, v: Any, reference: Any) -> Any:
        return statistics.median(q) * (reference.q - q)

    words = r"leaning, line \d+ of test_part_errors\.py \(`return statistics"
    with pytest.raises(pm.InvalidArgument, match=words):
        pm.simulate(pm.MobileRobot.box(), pm.law(leaning), CIRCLE, dt=0.1, engine=pm.Engine.COMPILED)


def test_the_command_prints_it_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "own.py").write_text(
        "class Sign:\n"
        "    def initial_state(self, context):\n"
        "        return None\n"
        "    def __call__(self, t, q, v, reference, state):\n"
        "        pull = 9.0 if q[0] > reference.q[0] else 10.0\n"
        "        return pull * (reference.q - q) - v, state\n"
    )
    (tmp_path / "plan.toml").write_text(
        'n = 6\ncontroller = "own:Sign"\ntrajectory.path.duration = 1\n'
        '[spread]\nstart.x = "Uniform(0, 0.1)"\n[grid]\nsubsteps = [1, 2]\n'
    )
    words = ["sweep", str(tmp_path / "plan.toml"), "--out", str(tmp_path / "out")]
    with warnings.catch_warnings():
        warnings.simplefilter("default")  # as outside of the tests, where warnings are no errors
        assert main([*words, "--allow-code"]) == 0
    printed = capsys.readouterr().err
    assert 'controller = "own:Sign"' in unescape((tmp_path / "out" / "index.html").read_text())
    assert printed.count("runs by PYTHON") == 1
    assert "own.py" in printed


def test_a_rollout_says_why_and_its_file_keeps_it(tmp_path: Path) -> None:
    robot = pm.MobileRobot.box()
    told: Any = {None: ("PYTHON", NOT_ASKED), pm.Engine.COMPILED: ("COMPILED", "")}
    for engine, words in (told | {pm.Engine.PYTHON: ("PYTHON", "")}).items():
        run = pm.simulate(robot, pm.PD(9, 9), CIRCLE, dt=0.2, engine=engine)
        assert (run.engine, run.fallback_reason) == words
        run.save(tmp_path / "run.npz")
        kept = pm.Rollout.load(tmp_path / "run.npz")
        assert (kept.engine, kept.fallback_reason) == (run.engine, run.fallback_reason)


_NOT_EXECUTABLE = """
import ctypes, sys, warnings
if ctypes.CDLL(None).prctl(65, 1, 0, 0, 0):  # PR_SET_MDWE, of Linux 6.3
    sys.exit(77)
import numpy as np
from pinmobile import *
robot = MobileRobot.box()
plan = dict(n=12, dt=0.1, spread={"mass": Uniform(20, 40)})
loop = robot, ComputedTorque(robot, 4, 4), Tangent(Circle(2, 0.25, 2))
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("default")
    for _ in range(2):
        run = ensemble(*loop, **plan)
print(run.engine, len(told), told[0].message, run.max_distance.max(), sep="|")
try:
    simulate(*loop, dt=0.1, engine=Engine.COMPILED)
except InvalidArgument as error:
    print(error)
print(len(robot.mass_matrix(np.zeros((3000, 3)))), verify(robot, states=2).missing, sep="|")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="prctl is of Linux")
@pytest.mark.long
def test_where_no_memory_may_be_written_and_executed_another_engine_runs_and_says_why() -> None:
    words = [sys.executable, "-c", _NOT_EXECUTABLE]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=100)
    if done.returncode == 77:
        pytest.skip("this kernel has no PR_SET_MDWE")
    assert done.returncode == 0, done.stderr
    first, refused, last = done.stdout.splitlines()
    engine, warned, message, distance = first.split("|")
    why = "this process may not execute memory that it wrote (mprotect: Permission denied); allow it for "
    assert (engine, warned) == ("PYTHON", "1")
    assert f"not COMPILED: {why}" in message
    assert refused.startswith(f"engine is Engine.COMPILED, which cannot run this: {why}")
    assert last.startswith(f"3000|compiled for ensembles: {why}")
    robot, spread = pm.MobileRobot.box(), {"mass": pm.Uniform(20, 40)}
    run = pm.ensemble(robot, pm.ComputedTorque(robot, 4, 4), CIRCLE, n=12, dt=0.1, spread=spread)
    assert run.engine == "COMPILED"
    assert float(distance) == pytest.approx(run.max_distance.max(), rel=1e-9)  # both are exact to rounding


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_an_engine_as_a_string_is_told_what_to_write(engine: Any) -> None:
    why = rf"^engine is '{engine!r}', expected Engine.PYTHON, Engine.COMPILED or None"
    given: Any = repr(engine)
    for run in (
        lambda: pm.simulate(pm.MobileRobot.box(), pm.PD(9, 9), CIRCLE, dt=0.2, engine=given),
        lambda: pm.ensemble(pm.MobileRobot.box(), pm.PD(9, 9), CIRCLE, n=2, spread={}, dt=0.2, engine=given),
    ):
        with pytest.raises(pm.InvalidArgument, match=why):
            run()


def _branching_torques(t: float, q: Any, v: Any, reference: Any) -> Any:
    return np.array([0.6, 0.7]) if q[0] < 1e9 else np.zeros(2)


@pytest.mark.parametrize(("ground", "substeps"), [(pm.Rolling(), 3), (pm.Coulomb(), 1)])
def test_plant_and_forces_are_compiled_where_a_controller_cannot_be(ground: Any, substeps: int) -> None:
    wheel: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
    table = pm.WheelTable.differential(0.5, 0.1, supports=[(-0.3, 0.0)], **wheel)
    robot = pm.WheeledRobot(pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05, 0.2)), table, ground)
    given: dict[str, Any] = {"forces": [pm.ViscousFriction((5.0, 9.0, 0.4))], "substeps": substeps}
    given |= {"dt": 0.02, "limit": 1e6}
    traced = pm.law(lambda t, q, v, reference: np.array([0.6, 0.7]) + 0.0 * v[:2])
    one = pm.simulate(robot, traced, CIRCLE, **given)
    other = pm.simulate(robot, pm.law(_branching_torques), CIRCLE, **given)
    assert other.fallback_reason.startswith(
        "plant and forces are compiled, the controller runs in Python; not COMPILED: _"
    )
    assert (one.engine, one.fallback_reason, other.engine) == ("COMPILED", "", "PYTHON")
    for name in ("q", "v", "u", "a"):
        here, there = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(there, here, rtol=0, atol=1e-9 * (1 + np.abs(here).max()), err_msg=name)
    assert list(one.signals) == list(other.signals)
    for name, signal in one.signals.items():
        np.testing.assert_allclose(other.signals[name].values, signal.values, rtol=0, atol=1e-8, err_msg=name)
