"""The regulator along a reference: its theory, wheels, arms, and all engines."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.controllers.lqr import riccati, tracked_model
from pinmobile.parts import evolved
from pinmobile.plant import Context
from tests.parts import Waving
from tests.refusals import refusals
from tests.rivals import CIRCLE, HEAVY, NOMINAL

ARM = pm.MobileRobot.box().mount("ur5")
SHORT = pm.Tangent(pm.Circle(radius=1.5, rate=0.6, duration=2))
DIFFERENTIAL = pm.WheelTable.differential(0.1, 0.4)
WHEELED = pm.WheeledRobot(NOMINAL, DIFFERENTIAL)


def rows(controller: pm.LQR, robot: Any, trajectory: Any, dt: float = 0.01) -> tuple[Array, ...]:
    """Return the inputs, velocities and gains of all samples."""
    t = np.arange(round(trajectory.duration / dt) + 1) * dt
    context = Context.of(robot, dt=dt, t=t, reference=trajectory(t))
    return tuple(each.rows for each in controller.initial_state(context))


@pytest.mark.parametrize("robot", [NOMINAL, WHEELED])
def test_the_cost_of_a_motion_is_the_cost_to_go_and_no_other_input_costs_less(robot: Any) -> None:
    t = np.arange(201) * 0.01
    A, B = tracked_model(robot, SHORT(t)).discrete(0.01)
    controller = pm.LQR(robot)
    Q, R = np.asarray(controller.Q), np.asarray(controller.R)
    K, P = riccati(A, B, Q, R)
    assert np.array_equal(K, rows(controller, robot, SHORT)[2])
    start = np.random.default_rng(1).normal(size=len(Q)) * 0.1

    def cost(other: float) -> float:
        x, total = start, 0.0
        for k in range(len(A)):
            u = -K[k] @ x + other * np.sin(k + np.arange(len(R)))
            total += float(x @ Q @ x + u @ R @ u)
            x = A[k] @ x + B[k] @ u
        return total + float(x @ P[-1] @ x)

    least = float(start @ P[0] @ start)
    # 200 sums of products of numbers that P and Q make up to 1e4 apart.
    assert cost(0.0) == pytest.approx(least, rel=1e-10)
    assert min(cost(1.0), cost(-1.0)) > 1.001 * least


def test_the_matrix_exponential_is_the_motion_with_the_input_held() -> None:
    t = np.array([0.0, 0.7])
    model = tracked_model(NOMINAL, SHORT(t))
    A, B = model.discrete(0.05)
    dx, du = np.array([0.1, -0.2, 0.3, 0.1, 0.2, -0.1]), np.array([3.0, -2.0, 1.0])
    x, h = dx.copy(), 0.05 / 200
    for _ in range(200):

        def rate(x: Array) -> Array:
            return np.asarray(model.A[1] @ x + model.B[1] @ du)

        k1 = rate(x)
        k2 = rate(x + h / 2 * k1)
        k3 = rate(x + h / 2 * k2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))
    # Order 4 of a step of 2.5e-4 s.
    assert np.abs(x - A[1] @ dx - B[1] @ du).max() < 1e-12


def test_on_wheels_it_comes_back_to_the_reference_and_without_errors_stays() -> None:
    heavy = pm.WheeledRobot(HEAVY, DIFFERENTIAL)
    given: Any = {"dt": 0.01, "engine": pm.Engine.COMPILED, "duration": 15.0}
    on = pm.simulate(WHEELED, pm.LQR(WHEELED), CIRCLE, **given)
    # The reference's input is held for dt, along which it turns by 6e-3 rad.
    assert np.abs((on.q[:, :3] - on.reference.q)[:, :2]).max() < 1e-3
    q, v = WHEELED.start(pm.Reference(*(x[0] for x in on.reference)))
    q = q + np.array([0.2, -0.2, 0.3, 0.0, 0.0])
    v = heavy.reduced(q, 0 * v).S @ heavy.independent(heavy.rest, 0 * v)
    run = pm.simulate(heavy, pm.LQR(WHEELED), CIRCLE, q0=q, v0=v, **given)
    off = np.linalg.norm((run.q[:, :3] - run.reference.q)[:, :2], axis=-1)
    assert off[0] > 0.28
    assert off[1000:].max() < 0.02


def test_arms_follow_too() -> None:
    start = Waving(ARM)(0.0).q + 0.05
    given: Any = {"integrator": pm.rk4, "engine": pm.Engine.COMPILED, "q0": start, "v0": np.zeros(ARM.nv)}
    run = pm.simulate(ARM, pm.LQR(ARM), Waving(ARM), dt=0.01, **given)
    assert np.abs(run.q - run.reference.q)[-1].max() < 0.02


def test_the_weight_of_the_input_is_spread_one_robot_after_another() -> None:
    kind = pm.LQR
    given: Any = {"dt": 0.01, "seed": 1, "duration": 0.2, "engine": pm.Engine.PYTHON}
    found = pm.ensemble(
        HEAVY, kind(NOMINAL), SHORT, n=2, spread={"input_weight": pm.Uniform(1, 100)}, **given
    )
    for weight, error in zip(found.draws["input_weight"], found.rms_error, strict=True):
        own = kind(NOMINAL, R=weight * np.array([1e-3, 1e-3, 2e-2]))
        alone = pm.ensemble(HEAVY, own, SHORT, n=1, spread={}, **given)
        assert np.abs(alone.rms_error[0] - error).max() < 1e-12


def test_a_model_that_differs_from_robot_to_robot_is_run_one_after_another() -> None:
    spread = {"controller.mass": pm.Uniform(20, 40)}
    given: Any = {"dt": 0.01, "integrator": pm.rk4, "n": 2, "seed": 1, "spread": spread}
    with pytest.warns(UserWarning, match=r"depends on controller.robot.mass, which differs"):
        found = pm.ensemble(HEAVY, pm.LQR(NOMINAL), SHORT, **given)
    assert found.engine == repr(pm.Engine.PYTHON)
    masses = found.draws["controller.mass"]
    for mass, error in zip(masses, found.rms_error, strict=True):
        model = evolved(NOMINAL, mass=mass)
        alone = pm.ensemble(
            HEAVY, pm.LQR(model), SHORT, **{**given, "n": 1, "spread": {}}, engine=pm.Engine.COMPILED
        )
        assert np.abs(alone.rms_error[0] - error).max() < 1e-12


test_bad_arguments_are_refused = refusals(
    (lambda: pm.LQR(NOMINAL, R=[1, 2, 0]), r"R has the eigenvalue 0, expected a positive definite"),
    (lambda: pm.LQR(NOMINAL, Q=np.triu(np.ones((6, 6)))), "Q is not symmetric"),
    (
        lambda: pm.LQR(pm.WheeledRobot(NOMINAL, pm.WheelTable.car(0.6, 0.4, 0.1, yaw_inertia=0.006))),
        "steers wheels about 1 axes",
    ),
    (
        lambda: pm.simulate(WHEELED, pm.LQR(WHEELED), pm.Tangent(pm.RestToRest([0, 0], [1, 0], 2)), dt=0.01),
        "reference ends at rest, at t = 2 s, where a WheeledRobot that cannot move sideways",
    ),
    (
        lambda: pm.simulate(ARM, pm.LQR(ARM), SHORT, dt=0.01),
        "reference has 3 coordinates, expected 9 of the robot",
    ),
)


def test_a_drive_that_moves_in_every_direction_may_end_at_rest() -> None:
    mecanum = pm.WheeledRobot(NOMINAL, pm.WheelTable.mecanum(0.5, 0.4, 0.1))
    straight = pm.FixedHeading(pm.RestToRest([0, 0], [1, 0], 2), 0.0)
    run = pm.simulate(mecanum, pm.LQR(mecanum), straight, dt=0.01, engine=pm.Engine.COMPILED)
    assert np.abs(run.q[-1, :2] - [1, 0]).max() < 1e-3
