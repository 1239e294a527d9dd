from collections.abc import Callable
from copy import copy
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

import pinmobile as pm
from pinmobile import closed_form, verification as routes
from pinmobile.arrays import Array
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHTable
from pinmobile.parts import evolved
from pinmobile.robot.recursions import PinocchioBackend
from pinmobile.verification import COMPILED
from tests.wheeled import CORNERS


@given(
    st.floats(1e-2, 1e4),
    st.floats(1e-3, 1e3),
    st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    st.sampled_from([LECTURE_TABLE, SLIDE_TABLE]),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=15)
def test_every_route_agrees_for_any_robot(
    mass: float, inertia: float, com: tuple[float, float], table: DHTable, seed: int
) -> None:
    verification = pm.verify(pm.MobileRobot(mass, inertia, com=com, dh=table), states=20, seed=seed)
    assert verification.passed, str(verification)


def test_four_quantities_are_compared_on_four_routes() -> None:
    verification = pm.verify(pm.MobileRobot(10, 1.2, com=(0.15, 0.05)))
    assert [row.quantity for row in verification.rows] == ["M"] * 4 + ["n"] * 4 + ["tau"] * 4 + ["a"] * 4
    assert set(verification.largest) == {"M", "n", "tau", "a"}
    assert verification.largest["tau"] < 1e-14
    assert {row.bound for row in verification.rows[:12]} == {1e-12}


LAWS = {"mass_matrix": "M", "nonlinear_effects": "n", "inverse_dynamics": "tau", "forward_dynamics": "a"}


@pytest.mark.parametrize(("function", "quantity"), LAWS.items())
def test_a_route_off_by_little_is_seen(monkeypatch: pytest.MonkeyPatch, function: str, quantity: str) -> None:
    right = getattr(closed_form, function)

    def off(*arguments: Array, **body: Array) -> Array:
        return np.asarray(right(*arguments, **body) * (1 + 1e-10))

    monkeypatch.setattr(closed_form, function, off)
    verification = pm.verify(pm.MobileRobot(10, 1.2, com=(0.15, 0.05)))
    wrong = {row.quantity for row in verification.rows if not row.agrees}
    assert wrong == {quantity}
    assert not verification.passed
    assert "DIFFERS" in str(verification)


def test_what_is_near_the_end_of_rounding_agrees_within_bounds_and_does_not_crash() -> None:
    assert pm.verify(pm.MobileRobot(1, 1e-3, com=(9e2, 0)), states=5).passed


ARMS = {
    "ur5": pm.MobileRobot.box().mount("ur5", (0.1, -0.05, 0.2, 0.4)),
    # Continuous joints; a joint that is locked; rotors; two arms; loads on base and arm.
    "kinova": pm.MobileRobot.box().mount("kinova", (0.1, 0, 0.2, 0.3), locked=["j2s6s200_joint_2"]),
    "talos": pm.MobileRobot.box().mount("talos_arm", (0, 0.1, 0.4, -0.2)),
    "two": pm.MobileRobot(30, 1.3, (0.1, 0.05), dh=SLIDE_TABLE)
    .mount("panda", (0.1, 0, 0.2, 0))
    .mount("z1", (-0.1, 0, 0.2, 1))
    .attach(pm.PayloadBody(2.0, (0.1, 0.2, 0.3), size=(0.1, 0.2, 0.3)), "base_link")
    .attach(pm.PayloadBody(1.5, (0, 0, 0.1)), "panda/panda_link5"),
    "loads alone": pm.MobileRobot(30, 1.3, (0.1, 0.05)).attach(pm.PayloadBody(4.0, (0.3, 0, 0.1))),
}
PARTS = "Newton-Euler of the parts"


@pytest.mark.parametrize("kind", ARMS)
def test_newton_and_euler_agree_with_what_is_assembled(kind: str) -> None:
    verification = pm.verify(ARMS[kind], states=40)
    assert verification.passed, str(verification)
    assert [row.quantity for row in verification.rows if row.against == PARTS] == ["M", "n", "tau", "f"]


@pytest.mark.parametrize(
    "robot", [pm.MobileRobot(10, 1.2, com=(0.15, 0.05)), ARMS["ur5"]], ids=["base", "ur5"]
)
def test_machine_code_off_by_little_is_seen(robot: pm.MobileRobot, monkeypatch: pytest.MonkeyPatch) -> None:
    right = routes._dynamics

    def off(*given: Any) -> Any:
        return tuple(x * (1 + 1e-9) for x in right(*given))

    for law, seen in ((right, []), (off, ["M", "n", "tau", "a"])):
        monkeypatch.setattr(routes, "_dynamics", law)
        rows = pm.verify(robot, states=20).rows
        assert [row.quantity for row in rows if not row.agrees] == seen
        assert [row.quantity for row in rows if row.method == COMPILED] == ["M", "n", "tau", "a"]


def test_where_there_is_no_machine_code_the_table_says_why() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "screw")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.ones(3) / 10, np.eye(3)), pin.SE3.Identity())
    verification = pm.verify(pm.MobileRobot.box().mount(model), states=5)
    assert verification.passed
    assert COMPILED not in {row.method for row in verification.rows}
    assert str(verification).splitlines()[-1].startswith(f"left out, {COMPILED}: joint ")
    assert "JointModelHX, neither revolute nor prismatic" in verification.missing


def differing(model: pin.Model, wrong: pm.MobileRobot) -> dict[str, float]:
    """Return what Newton and Euler see, of each quantity, of a robot whose assembled model is another one."""
    object.__setattr__(wrong, "_engine", PinocchioBackend(model))
    verification = pm.verify(wrong, states=20)
    assert not verification.passed
    return {row.quantity: row.difference for row in verification.rows if row.against == PARTS}


def moved(body: pin.Inertia, way: tuple[float, float, float]) -> pin.Inertia:
    return pin.Inertia(body.mass, body.lever + np.array(way), body.inertia)


def test_a_bases_centre_of_mass_at_a_wrong_height_is_seen() -> None:
    """No generalised force depends on it, but what tips over does."""
    for kind in ("ur5", "two", "loads alone"):
        robot = copy(ARMS[kind])
        model = robot.model
        model.inertias[3] = moved(model.inertias[3], (0, 0, 1e-6))
        found = differing(model, robot)
        assert found.pop("f") > 1e-10
        assert max(found.values()) < 1e-14


def heavier(model: pin.Model) -> None:
    body = model.inertias[6]
    model.inertias[6] = pin.Inertia(1.001 * body.mass, body.lever, body.inertia)


def turned(model: pin.Model) -> None:
    model.jointPlacements[4] = model.jointPlacements[4] * pin.SE3(pin.utils.rotate("z", 1e-6), np.zeros(3))


def shifted(model: pin.Model) -> None:
    model.jointPlacements[5] = model.jointPlacements[5] * pin.SE3(np.eye(3), np.array([0, 1e-6, 0]))


def geared(model: pin.Model) -> None:
    model.armature = np.array(model.armature) + 1e-6


def tilted(model: pin.Model) -> None:
    model.gravity = pin.Motion(np.array([9.81 * np.sin(0.02), 0, -9.81 * np.cos(0.02)]), np.zeros(3))


@pytest.mark.parametrize("wrong", [heavier, turned, shifted, geared, tilted])
def test_whatever_is_assembled_wrongly_is_seen(wrong: Callable[[pin.Model], None]) -> None:
    robot = copy(ARMS["ur5"])
    model = robot.model
    wrong(model)
    assert max(differing(model, robot).values()) > 1e-10


WHEEL: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
BODY = pm.MobileRobot(30.0, 2.3, com=(0.15, 0.02, 0.2))
OFF = 1e-8  # relative, of what is wrong on one side


def _heavier(given: Any) -> dict[str, Any]:
    """Return a body with another centre of mass."""
    return {"robot": pm.MobileRobot(30.0, 2.3, com=(0.15 * (1 + OFF), 0.02, 0.2)).array_dynamics}


def _column(name: str) -> Any:
    return lambda given: {name: getattr(given, name) * (1 + OFF)}


def _turned(given: Any) -> dict[str, Any]:
    """Return what turns the last wheel a little."""
    *others, last = given.table.wheels
    last = evolved(last, angle=last.angle + OFF)
    return {"table": evolved(given.table, wheels=(*others, last), couplings=())}


WRONG = {
    **{name: _column(name) for name in ("radius", "y", "spin_inertia")},
    "com": _heavier,
    "angle": _turned,
}
WHEELED = {
    "mecanum": pm.WheeledRobot(BODY, pm.WheelTable.mecanum(0.5, 0.4, 0.08, **WHEEL)),
    "two modules": pm.WheeledRobot(BODY, pm.WheelTable.swerve([(0.3, 0.1), (-0.3, -0.1)], 0.06, **WHEEL)),
    "four modules": pm.WheeledRobot(BODY, pm.WheelTable.swerve(CORNERS, 0.06, **WHEEL)),
}


@pytest.mark.parametrize(
    ("drive", "ingredient"),
    [*(("mecanum", each) for each in WRONG), ("two modules", "radius"), ("four modules", "angle")],
)
def test_wheels_off_by_little_are_seen(monkeypatch: pytest.MonkeyPatch, drive: str, ingredient: str) -> None:
    of = WHEELED[drive]
    kind: Any = type(of.ground)
    right = kind.dynamics

    def off(ground: Any, wheeled: Any) -> Any:
        found = right(ground, wheeled)
        vars(found).update(WRONG[ingredient](found))
        return found

    monkeypatch.setattr(kind, "dynamics", off)
    found = pm.verify(pm.WheeledRobot(of.robot, of.table, of.ground), states=4)
    assert not found.passed, str(found)
