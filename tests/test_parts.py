"""Parts that are a user's own run wherever the library's do, with the same numbers and their own names."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.errors import SlowerEngine, UnknownName
from pinmobile.loop import Engine, Loop, run_scenario
from pinmobile.loop._description import ROBOT_ARRAYS
from pinmobile.parts import find, replace
from tests.parts import PID, Cart, CartCircle, Eight, Follower, Nodding, SlidingMode, Smoothed
from tests.refusals import refused

ROBOT = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))


def assert_close(one: pm.Ensemble, other: pm.Ensemble) -> None:
    """Compare all records to 1e-12 of the largest number of each."""
    for name in ROBOT_ARRAYS:
        here, there = getattr(one, name), getattr(other, name)
        size = np.abs(np.nan_to_num(there)).max(initial=0.0)
        np.testing.assert_allclose(here, there, rtol=0, atol=1e-12 * size, err_msg=name)


def test_a_number_of_a_users_part_is_spread_by_name_and_by_path() -> None:
    controller, values = pm.InputSaturation(Smoothed(PID()), (120.0, 110.0, 6.0)), [0.0, 1.0, 2.0, 3.0]
    given: dict[str, Any] = {"n": 4, "dt": 0.02, "duration": 6.0}
    paths, starts = (
        ("back", "controller.controller.controller.back"),
        {"start.x": np.array([0.1, -0.1, 0.3, 0.0])},
    )
    by_name, by_path = (
        pm.ensemble(ROBOT, controller, Nodding(Eight()), spread={**starts, each: np.array(values)}, **given)
        for each in paths
    )
    for name in (*ROBOT_ARRAYS, "counts"):
        np.testing.assert_array_equal(getattr(by_name, name), getattr(by_path, name), err_msg=name)
    assert len(np.unique(by_name.rms_error, axis=0)) == 4, "each robot has a value of its own"
    assert by_name.draws[paths[0]].tolist() == by_path.draws[paths[1]].tolist() == values


def test_a_parameter_that_a_user_bounds_is_refused_beyond() -> None:
    with refused(r"spread\['width'\] gives 0 m/s as the width .*expected > 0"):
        law: Any = SlidingMode()
        width = {"width": np.array([0.5, 0.0])}
        pm.ensemble(ROBOT, law, Nodding(Eight()), n=2, spread=width, dt=0.02)


def test_an_ensemble_of_a_users_plant_is_told_by_its_names_and_units() -> None:
    law: Any = Follower()
    run = pm.ensemble(Cart(), law, CartCircle(), n=2, spread={"start.y": np.array([0.2, -0.2])}, dt=0.01)
    rows = str(run).split("\n", 3)[3].splitlines()
    assert rows[2].startswith("largest left_torque [N m]")
    assert rows[6].startswith("largest error of left [rad]")
    data = run.to_xarray()
    assert data.coordinate.values.tolist() == ["x", "y", "psi", "left", "right"]
    assert data.input.values.tolist() == ["left_torque", "right_torque"]
    assert data.max_input.attrs["units"] == "N m, N m"


@dataclass(frozen=True)
class Derived:
    """A controller that makes a number of its own when it is made, and keeps one in its state alone."""

    gain: float = 20.0
    push: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "twice", 2 * self.gain)

    def initial_state(self, context: Any) -> Any:
        return self.push * np.ones(3)

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        u = self.twice * (reference.q - q) + self.gain * (reference.v - v)  # type: ignore[attr-defined]
        return u + state, state


@pytest.mark.parametrize("name", ["gain", "push"])
def test_what_a_part_derives_of_its_numbers_follows_them(name: str) -> None:
    motion, values = pm.Tangent(pm.Circle(2.0, 0.5, 1.0)), np.array([10.0, 30.0])
    run = pm.ensemble(ROBOT, Derived(), motion, n=2, spread={name: values}, dt=0.02)
    assert run.engine == "COMPILED"
    for i, value in enumerate(values):
        alone = pm.simulate(ROBOT, Derived(**{name: value}), motion, dt=0.02)
        np.testing.assert_allclose(run.max_error[i], alone.max_error(), rtol=0, atol=1e-12)


# A law that reaches a robot which is no attribute of a part.

MASSES = {"mass": np.array([27.0, 33.0])}
HELD = {"model": ROBOT}
BOUND = ROBOT.nonlinear_effects


def _by_global(t: float, q: Any, v: Any, reference: Any) -> Any:
    command = reference.a + 4.0 * (reference.q - q) + 4.0 * (reference.v - v)
    return ROBOT.mass_matrix(q) @ command + BOUND(q, v)


def _by_dict(t: float, q: Any, v: Any, reference: Any) -> Any:
    command = reference.a + 4.0 * (reference.q - q) + 4.0 * (reference.v - v)
    return HELD["model"].mass_matrix(q) @ command + HELD["model"].coriolis_matrix(q, v) @ v


def _closed_over(robot: Any) -> Any:
    def function(t: float, q: Any, v: Any, reference: Any) -> Any:
        return robot.inverse_dynamics(q, v, reference.a + 4.0 * (reference.q - q) + 4.0 * (reference.v - v))

    return function


@pytest.mark.parametrize("function", [_by_global, _by_dict, _closed_over(ROBOT)])
def test_a_law_that_reaches_a_robot_by_a_name_is_compiled(function: Any) -> None:
    motion = pm.Tangent(pm.Circle(2.0, 0.5, 1.0))
    given: dict[str, Any] = {"n": 2, "spread": MASSES | {"start.x": 0.1}, "dt": 0.02}
    run = pm.ensemble(ROBOT, pm.law(function), motion, **given)
    assert run.engine == "COMPILED"
    assert_close(run, pm.ensemble(ROBOT, pm.law(function), motion, **given, engine=Engine.PYTHON))
    assert_close(run, pm.ensemble(ROBOT, pm.ComputedTorque(ROBOT), motion, **given))
    other = _closed_over(pm.MobileRobot(50.0, 1.3))  # the same code, another robot
    runs = [
        pm.ensemble(ROBOT, pm.law(other), motion, **given, engine=engine)
        for engine in (Engine.COMPILED, Engine.PYTHON)
    ]
    assert_close(*runs)


def test_what_a_robot_does_by_pinocchio_alone_is_refused_with_the_line() -> None:
    controller = pm.law(lambda t, q, v, reference: ROBOT.jacobian(q).T[:, :3] @ (reference.q - q))
    with refused(r"line \d+ of test_parts\.py .*: jacobian of a MobileRobot, which accepts only numbers"):
        pm.simulate(ROBOT, controller, OWN["circle"][0], dt=0.1, engine=Engine.COMPILED)


# Parameters of paths and headings: each robot has a reference of its own.

STEADY = pm.PD((100, 100, 5), (100, 100, 5))
VIA = pm.CubicVia((0, 0), (2, 2), (0, 4), 3.0, 6.0, via_velocity=(0, 0))
OWN: dict[str, tuple[Any, dict[str, Any]]] = {
    "circle": (pm.Tangent(pm.Circle(2.0, 0.5, 6.0)), {"radius": (1.0, 3.0), "rate": (0.3, 0.6)}),
    "turns": (pm.Tangent(VIA, 1.0), {"via.x": (1.0, 3.0), "t_via": (2.5, 4.0), "turn_time": (1.5, 1.0)}),
    "way": (pm.FixedHeading(pm.RestToRest([0, 0], [1, 1], 6.0), 0.0), {"end.y": (0.5, 1.5)}),
    "user's": (Nodding(Eight(2.0, 6.0)), {"size": (1.0, 2.0), "angle": (0.1, 0.3)}),
}


def owned(what: str, **changes: Any) -> pm.Scenario:
    motion, spread = OWN[what]
    spread = {name: np.array(values, float) for name, values in spread.items()}
    given: dict[str, Any] = {"robot": ROBOT, "controller": STEADY, "trajectory": motion, "n": 2, "dt": 0.03}
    return pm.Scenario(**(given | {"duration": 6.0, "spread": spread | {"start.y": 0.1}} | changes))


@pytest.mark.parametrize("what", OWN)
def test_each_robot_follows_a_reference_of_its_own_by_all_engines(what: str) -> None:
    scenario = owned(what)
    runs = [run_scenario(scenario, engine=engine) for engine in (Engine.COMPILED, Engine.PYTHON)]
    assert_close(*runs)
    assert run_scenario(scenario).engine == "COMPILED"
    motion, spread = OWN[what]
    for i in range(2):
        own = motion
        for name, values in spread.items():
            found = scenario.find(name)
            number = np.array(found.leaf.value, float)
            number[found.entry or ()] = values[i]
            path = found.leaf.path.removeprefix("trajectory.")
            own = replace(own, {path: number if number.ndim else float(number)})
        begun = own(0.0)
        alone = pm.simulate(
            *(ROBOT, STEADY, own),
            **{"dt": 0.03, "duration": 6.0, "q0": begun.q + np.array([0, 0.1, 0]), "v0": begun.v},
        )
        size = alone.max_error().max()
        np.testing.assert_allclose(runs[0].max_error[i], alone.max_error(), rtol=0, atol=1e-12 * size)
        member = runs[0].arguments(i)
        reference = pm.simulate(*member[:3], **member.options).reference
        np.testing.assert_array_equal(reference.q, alone.reference.q)


def test_a_trajectory_that_cannot_be_made_is_told_with_the_robots_number() -> None:
    with refused(r"^robot 1: t_via is 7.0 s, expected 0 < t_via < "):
        run_scenario(owned("turns", spread={"t_via": np.array([3.0, 7.0])}))
    with refused(r"^robot 0: its trajectory lasts 6.25 s, expected at least 7 s"):
        run_scenario(owned("turns", duration=7.0, dt=0.1, spread={"turn_time": np.array([0.25, 1.0])}))
    with refused(r"reaches -1 m as the radius of the circle, .* expected > 0"):
        owned("circle", spread={"radius": pm.Uniform(-1, 1)})


@dataclass(frozen=True)
class Ahead:
    """A controller that looks where the reference ends."""

    def initial_state(self, context: Any) -> Any:
        return context.reference.q[-1]

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return 9.0 * (state - q) - 30.0 * v, state


def test_a_controller_that_looks_ahead_sees_its_own_robots_reference() -> None:
    with pytest.warns(SlowerEngine, match="reads the reference of its context, which differs from robot to"):
        run = pm.ensemble(
            *(ROBOT, Ahead(), OWN["way"][0]), n=2, spread={"end.y": np.array([0.5, 1.5])}, dt=0.05
        )
    assert run.engine == "PYTHON"
    for i, y in enumerate((0.5, 1.5)):
        motion = pm.FixedHeading(pm.RestToRest([0, 0], [1, y], 6.0), 0.0)
        alone = pm.simulate(ROBOT, Ahead(), motion, dt=0.05).max_error()
        np.testing.assert_allclose(run.max_error[i], alone, rtol=0, atol=1e-12)


def test_the_models_that_a_trajectory_knows_are_no_numbers_of_it() -> None:
    motion = pm.WholeBody(ROBOT, pm.Tangent(pm.Circle(2.0, 0.5, 1.0)))
    given: dict[str, Any] = {"controller": pm.ComputedTorque(ROBOT), "trajectory": motion, "n": 2, "dt": 0.05}
    spread = {"controller.mass": np.array([25.0, 30.0]), "radius": np.array([1.0, 2.0])}
    scenario = pm.Scenario(robot=ROBOT, **given, spread=spread)
    assert scenario.find("controller.mass").path == "controller.robot.mass"
    assert scenario.find("radius").path == "trajectory.base.path.radius"
    runs = [run_scenario(scenario, engine=engine) for engine in (Engine.COMPILED, Engine.PYTHON)]
    assert_close(*runs)
    assert runs[0].arguments(1).trajectory == pm.WholeBody(ROBOT, pm.Tangent(pm.Circle(2.0, 0.5, 1.0)))


def test_a_path_with_a_typo_is_answered_with_the_nearest_path() -> None:
    loop = Loop(ROBOT, Derived(), None, {"wind": pm.ConstantForce((1.0, 0.0, 0.0))})
    with pytest.raises(UnknownName, match=r"'forces\.wind\.forse', did you mean 'forces\.wind\.force'"):
        find(loop, "forces.wind.forse")
