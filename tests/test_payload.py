"""A load that is picked up midway: against runs that are joined, in all engines, on wheels and with arms."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.forces import PayloadForce
from pinmobile.integrators import semi_implicit_euler
from pinmobile.loop import reaction
from tests.refusals import refusals

BODY = pm.MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
CIRCLE = pm.Tangent(pm.Circle(radius=1.5, rate=0.6, duration=2))
INERTIA = (0.2, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.2)
CARRIED = PayloadForce(10, (0.25, 0.1), 1.0, 0.2)


class Later:
    """What is left of a trajectory after a time."""

    duration = 1.0

    def __call__(self, t: Any) -> Any:
        return CIRCLE(np.asarray(t) + 1.0)


@pytest.mark.parametrize(
    ("integrator", "engine"), [(semi_implicit_euler, pm.Engine.PYTHON), (pm.rk4, pm.Engine.COMPILED)]
)
def test_it_is_two_runs_that_are_joined_when_it_comes(integrator: Any, engine: Any) -> None:
    controller = pm.ComputedTorque(BODY, 16, 8)
    given: Any = {"dt": 0.01, "integrator": integrator, "engine": engine}
    whole = pm.simulate(BODY, controller, CIRCLE, forces=[CARRIED], **given)
    before = pm.simulate(BODY, controller, CIRCLE, duration=1.0, **given)
    loaded = BODY.attach(pm.PayloadBody(10, (0.25, 0.1, 0.1), INERTIA), "base_link")
    after = pm.simulate(
        loaded.with_locked_arms(), controller, Later(), q0=before.q[-1], v0=before.v[-1], **given
    )
    joined = np.vstack([before.q[:-1], after.q])
    jump = np.abs(after.a[0] - before.a[-1]).max()
    assert jump > 0.3
    # The last stage of the step before sees the load: a sixth of the jump for a step. Else rounding.
    close = 0.01 / 6 * jump if integrator is pm.rk4 else 1e-12
    assert np.abs(whole.q - joined).max() < close
    assert np.abs(whole.a[100:] - after.a).max() < 100 * close


def carrying(robot: Any, q: Any, v: Any, u: Any) -> Any:
    """Return the acceleration of a robot that carries the payload."""
    f = robot.generalized_force(q, CARRIED(2.0, robot.pose(q), robot.pose_rate(q, v)))
    f = f + reaction(robot, [CARRIED], 2.0, q, lambda more: robot.forward_dynamics(q, v, u, f + more))
    return robot.forward_dynamics(q, v, u, f)


def test_with_an_arm_and_on_wheels_too() -> None:
    load = pm.PayloadBody(10, (0.25, 0.1, 0.1), INERTIA)
    wheels = pm.WheelTable.differential(0.1, 0.4)
    generator = np.random.default_rng(5)
    arm = pm.MobileRobot.box().mount("ur5")
    for robot, loaded in (
        (arm, arm.attach(load, "base_link")),
        (pm.WheeledRobot(BODY, wheels), pm.WheeledRobot(BODY.attach(load, "base_link"), wheels)),
    ):
        q = robot.integrate(robot.rest, generator.normal(size=robot.nv))
        v, u = generator.normal(size=robot.nv), generator.normal(size=robot.nu)
        v = robot.project(q, v) if hasattr(robot, "project") else v
        found, wanted = carrying(robot, q, v, u), loaded.forward_dynamics(q, v, u)
        # Differences of accelerations by unit forces: rounding of the one by the size of the other.
        assert np.abs(found - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_a_push_acts_between_its_times() -> None:
    push = pm.ConstantForce((3, 1, 0.1), 0.5, 1.2)
    q = np.zeros((4, 3))
    found = push(np.array([0.49, 0.5, 1.19, 1.2]), q, q)
    assert np.array_equal(found, np.outer([0, 1, 1, 0], [3, 1, 0.1]))


test_bad_arguments_are_refused = refusals(
    (lambda: pm.ConstantForce((1, 0, 0), 2.0, 1.0), "end is 1.0 s, expected above begin, 2.0 s"),
    (
        lambda: pm.simulate(
            pm.WheeledRobot(BODY, pm.WheelTable.mecanum(0.5, 0.4, 0.1, spin_inertia=0.01), pm.Coulomb()),
            pm.PD(1, 1),
            CIRCLE,
            dt=0.01,
            forces=[CARRIED],
        ),
        "which has its own step",
    ),
)


def test_the_inertia_of_a_box_follows_its_mass() -> None:
    """m (l^2 + w^2) / 12 is the box's, unless an inertia is given."""
    turn = pm.law(lambda t, q, v, reference: np.array([0.0, 0.0, 1.0]))
    rest, masses = pm.FixedHeading(pm.Hold((0, 0), 1), 0), np.array([5.0, 50.0])
    for inertia, expected in ((None, masses * 2 / 12), (np.eye(3), np.ones(2))):
        load = pm.PayloadBody(5.0, (0.1, 0, 0), inertia, (1, 1, 0.2))
        robot = pm.MobileRobot(30, 1.3).attach(load)
        runs = pm.ensemble(robot, turn, rest, n=2, spread={"loads.0.mass": masses}, dt=0.1)
        for member, moment in zip((0, 1), expected, strict=True):
            m = masses[member]
            whole = 1.3 + moment + 0.1**2 * m * 30 / (m + 30)  # about the common centre of mass
            assert runs.member(member).a[0, 2] == pytest.approx(1 / whole, rel=1e-12)
