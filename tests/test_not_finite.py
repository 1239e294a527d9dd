"""Finite arguments give a finite answer, or an error that says why there is none."""

import inspect
import itertools
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import closed_form
from pinmobile.arrays import Array
from pinmobile.controllers import WheelSpeed
from pinmobile.errors import LimitWarning, NotFinite

HUGE = (1e100, 1e160, 1e200, 1e308)
ROBOTS = {
    "lecture": pm.MobileRobot.lecture(),
    "off its axis": pm.MobileRobot(30, 1.3, (0.1, 0.05)),
    "light": pm.MobileRobot(1e-310, 1e-310),
    "ur5": pm.MobileRobot.box().mount("ur5"),
    "kinova": pm.MobileRobot.box().mount("kinova"),
}
STATE = ("q", "q0", "q1", "v", "a", "tau", "u", "dq", "wrench")


def parameters(function: Any) -> list[str]:
    return [name for name in inspect.signature(function).parameters if name in STATE]


METHODS = [
    name
    for name in dir(pm.MobileRobot)
    if not name.startswith("_") and inspect.isfunction(getattr(pm.MobileRobot, name))
    if parameters(getattr(pm.MobileRobot, name)) and name not in ("with_locked_arms", "evaluate_metrics")
]
ON_ARMS = {"arm_manipulability", "mount_wrench"}  # of a bare robot they are errors
CASES = [(kind, name) for kind in ROBOTS for name in METHODS if ROBOTS[kind].mounts or name not in ON_ARMS]
WHEELS: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.005, "yaw_inertia": 0.003}
BASE = pm.MobileRobot(30.0, 1.3, com=(0.05, 0.02, 0.1), size=(0.6, 0.4, 0.25))
MECANUM = pm.WheelTable.mecanum(0.4, 0.48, 0.09, **WHEELS)
WHEELED = {
    "differential": pm.WheeledRobot(BASE, pm.WheelTable.differential(0.46, 0.1, **WHEELS)),
    "mecanum": pm.WheeledRobot(BASE, MECANUM),
    "mecanum that slips": pm.WheeledRobot(BASE, MECANUM, pm.Coulomb(0.1)),
    "swerve": pm.WheeledRobot(BASE, pm.WheelTable.swerve([(0.2, 0.1), (-0.2, -0.1)], 0.06, **WHEELS)),
    "car": pm.WheeledRobot(BASE.mount("ur5"), pm.WheelTable.car(0.5, 0.46, 0.1, **WHEELS)),
}


def why_not(function: Any, arguments: dict[str, Any]) -> str:
    """Return nothing of a call whose answer is finite, or what its error says."""
    try:
        answer = function(**arguments)
    except NotFinite as error:
        return str(error)
    for part in answer if isinstance(answer, tuple) else (answer,):
        assert np.isfinite(part).all()
    return ""


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_every_method_answers_in_finite_numbers_or_says_that_it_cannot(kind: str, name: str) -> None:
    robot, method = ROBOTS[kind], getattr(ROBOTS[kind], name)
    given = parameters(method)
    for size, large in itertools.product(HUGE, given):
        sizes = {"wrench": 3}
        arguments = {
            p: robot.rest.copy() if p.startswith("q") else np.ones(sizes.get(p, robot.nv)) for p in given
        }
        arguments[large][slice(0, 3) if large.startswith("q") else slice(None)] = size
        many = {p: np.stack([value] * 2) for p, value in arguments.items()}
        for asked in (arguments, many):
            assert f"|{large}| up to {size:.3g}" in (why_not(method, asked) or f"|{large}| up to {size:.3g}")


@pytest.mark.parametrize("kind", [kind for kind in WHEELED if "slips" not in kind])
def test_a_start_that_is_too_large_to_be_judged_is_refused(kind: str) -> None:
    robot = WHEELED[kind]
    for size in HUGE:
        for v in (np.full(robot.nv, size), np.full((2, robot.nv), size)):
            with pytest.raises(pm.PinmobileError, match=r"start does not roll|\|v\| up to"):
                robot.check_start(robot.rest, v)


def test_the_error_says_what_was_large() -> None:
    with pytest.raises(NotFinite) as caught:
        ROBOTS["off its axis"].forward_dynamics([0, 0, 0.5], np.array([0, 0, 1e200]), [0, 0, 7])
    expected = "the result is nan for |q| up to 0.5, |v| up to 1e+200, |tau| up to 7: a number exceeds"
    assert str(caught.value) == f"{expected} 1.8e308, expected smaller arguments"
    assert isinstance(caught.value, pm.PinmobileError)
    assert isinstance(caught.value, ArithmeticError)


@pytest.mark.parametrize("angle", [0.0, 0.4, 2.0])
def test_of_a_body_that_is_accepted_six_digits_of_the_yaw_acceleration_are_left(angle: float) -> None:
    inertia = 2e-9 * 1e4
    robot = pm.MobileRobot(1, inertia, (100 * np.cos(angle), 100 * np.sin(angle)))
    tau = np.array([0.3, -0.2, 1.1])
    q, v = [0, 0, 0.3], [0, 0, 0.2]
    right = closed_form.forward_dynamics(q, v, tau, mass=1, yaw_inertia=inertia, com=robot.com[:2])
    # eps m |com|^2 / Icz = 1e-7 for each of a few roundings.
    np.testing.assert_allclose(robot.forward_dynamics(q, v, tau), right, rtol=1e-6)


def test_a_loop_that_overflows_has_diverged_whoever_notices() -> None:
    """Between two looks for divergence a state may become so large that a robot that is asked refuses."""
    robot, motion = ROBOTS["off its axis"], pm.Tangent(pm.Circle(radius=1, rate=0.5, duration=5))

    def away(t: float, q: Array, v: Array, reference: Any) -> Array:
        return robot.inverse_dynamics(q, v, 1e4 * (v - reference.v) + 1e4 * (q - reference.q))

    start = {"dt": 0.01, "q0": np.array([1.0, 1.0, 0.0])}
    with pytest.raises(pm.Diverged) as caught:
        pm.simulate(robot, pm.law(away), motion, **start)  # type: ignore[arg-type]
    assert caught.value.rollout is not None
    assert np.abs(caught.value.rollout.error).max() <= 1e3
    with pytest.raises(pm.Diverged, match="not finite") as caught:
        pm.simulate(robot, pm.law(away), motion, **start, limit=1e300)  # type: ignore[arg-type]
    assert isinstance(caught.value.__cause__, NotFinite)


@pytest.mark.parametrize("engine", [pm.Engine.COMPILED, pm.Engine.PYTHON])
def test_wheels_that_explode_have_diverged_although_the_body_stays_near(engine: pm.Engine) -> None:
    """The reference has no wheel speeds: only inputs and accelerations tell of them."""
    table = pm.WheelTable.skid_steer(0.4, 0.5, 0.1, mass=1.0, spin_inertia=0.005)
    robot = pm.WheeledRobot(pm.MobileRobot(30, 1.3, (0.05, 0, 0.2)), table, pm.Coulomb(mu=0.6))
    law = WheelSpeed(pm.UnicycleTracking(), robot, kp=50.0)
    motion = pm.Tangent(pm.Circle(radius=1, rate=0.5, duration=4))
    with pytest.raises(pm.Diverged, match=r"a or u beyond 1e\+12") as caught:
        pm.simulate(robot, law, motion, dt=0.01, engine=engine)
    with pytest.warns(LimitWarning, match="tip over"):
        found = pm.ensemble(robot, law, motion, dt=0.01, n=2, spread={}, engine=engine)
    assert found.diverged.all()
    np.testing.assert_array_equal(found.diverged_at, caught.value.time)
