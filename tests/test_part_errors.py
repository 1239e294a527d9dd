"""What is wrong with a part of a loop is told at once, by its own error, in every engine."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.errors import SlowerEngine
from pinmobile.loop import Engine
from tests.parts import Cart, CartCircle, Eight, Follower, Nodding, Spring
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


class Plain:
    """What no more than a loop without forces needs."""

    nq, nv, nu = 3, 3, 3

    def forward_dynamics(self, q: Any, v: Any, u: Any) -> Any:
        return u / 30.0

    def integrate(self, q: Any, dq: Any) -> Any:
        return q + dq

    def difference(self, q0: Any, q1: Any) -> Any:
        return q1 - q0


def without(name: str, kind: type = Cart) -> Any:
    return type(f"Without{name}", (kind,), {name: None})()


class Posed(Plain):
    def pose(self, q: Any) -> Any:
        return q

    def pose_rate(self, q: Any, v: Any) -> Any:
        return v

    def generalized_force(self, q: Any, wrench: Any) -> Any:
        return wrench


LACKING: dict[str, tuple[dict[str, Any], str]] = {
    "controller without a state": (
        BODY | {"controller": Stateless()},
        r"controller is .*Stateless.*expected a controller: .* or law\(function\)",
    ),
    "plant without dynamics": (BODY | {"robot": NoDynamics()}, "expected a plant with 'forward_dynamics'"),
    "no pose to push": (
        BODY | {"robot": Plain(), "forces": [Spring()]},
        r"plant is .*Plain.*, and forces push its body, "
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


@pytest.mark.parametrize("what", LACKING)
def test_a_part_without_what_the_loop_needs_is_told_so(what: str) -> None:
    assert_refused(*LACKING[what])


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


@pytest.mark.parametrize(
    ("plant", "why"),
    [
        (Named(), "plant has nv = 5 and 4 coordinates, expected equal numbers"),
        (Inputs(), "plant has nu = 2 and 1 inputs, expected equal numbers"),
        *(
            (
                Spoilt(name),
                rf"a Spoilt with nq = 5, nv = 5 and nu = 2, whose {name}\(.*\) returned .*\({size},\) of re",
            )
            for name, size in (("forward_dynamics", 5), ("pose_rate", 3))
        ),
        (Spoilt("project"), r"whose first v has shape \(2,\), expected \(5,\)|v0 has shape \(2,\)"),
    ],
)
def test_a_plant_that_contradicts_itself_is_refused(plant: Any, why: str) -> None:
    assert_refused(CART | {"robot": plant}, why)


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


@pytest.mark.parametrize("what", FORGETFUL)
def test_what_answers_otherwise_when_it_is_asked_again_is_refused(what: str) -> None:
    assert_refused(
        FORGETFUL[what],
        r"^(controller|forces\[[01]\]|integrator|plant) is .*, (asked|called) again .* the same arguments, .*"
        r"state, and\s.*random numbers",
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


def _branching(t: float, q: Any, v: Any, reference: Any) -> Any:
    error = reference.q - q
    if error[0] > 0.0:
        error[0] *= 2.0
    return 100.0 * error + 120.0 * (reference.v - v)


def _by_eigenvalues(t: float, q: Any, v: Any, reference: Any) -> Any:
    largest = np.linalg.eigvalsh(q[..., :, None] * q[..., None, :])
    return 100.0 * (reference.q - q) + 120.0 * (reference.v - v) + largest


UNTRACED: dict[str, tuple[dict[str, Any], Any, str]] = {
    "if": (
        BODY | {"controller": pm.law(_branching)},
        Engine.PYTHON,
        r"_branching, line \d+ of test_.*np\.where",
    ),
    "eigenvalues": (
        BODY | {"controller": pm.law(_by_eigenvalues)},
        Engine.PYTHON,
        r"_by_eigenvalues, line \d+ of test_.*np\.where",
    ),
}


@pytest.mark.parametrize("what", UNTRACED)
def test_a_law_that_cannot_be_traced_runs_slower_and_says_so_or_is_refused(what: str) -> None:
    parts, engine, why = UNTRACED[what]
    with refused(rf"^engine is Engine.COMPILED, which cannot run this: .*{why}"):
        in_ensemble(parts, engine=Engine.COMPILED)
    with refused(rf"^engine is Engine.COMPILED, which cannot run this: .*{why}"):
        simulated(parts, engine=Engine.COMPILED)
    with pytest.warns(SlowerEngine, match=rf"runs by {engine!r}, .*not COMPILED: .*{why}") as told:
        run = in_ensemble(parts)
    assert len(told) == 1
    assert run.engine == repr(engine)
    assert run.fallback_reason in str(told[0].message)
    alone = simulated(parts)
    assert alone.engine == "PYTHON"
    np.testing.assert_allclose(run.max_error[0], alone.max_error(), rtol=1e-12)


# Names of parameters.


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


@pytest.mark.parametrize("what", UNREAL)
def test_what_is_not_made_of_real_numbers_is_refused(what: str) -> None:
    assert_refused(*UNREAL[what])


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
