"""Adaptive control of robots that take speeds: its theory, what it estimates, and what it refuses."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.controllers import AdaptiveVelocity
from pinmobile.plant import Context
from tests.parts import Eight
from tests.refusals import refusals

TRUE = pm.VelocityRobot([0.26, 0.25, 0.03, 1.1, 0.2, 1.2])
WRONG = pm.VelocityRobot(TRUE.theta * [1.3, 0.7, 1.3, 0.7, 0.7, 1.3])


EIGHT = pm.Tangent(Eight(1.0, 60.0, 4 * np.pi))  # 1 m sin 0.5 t, 0.5 m sin t
OFF = np.array([0.15, -0.1, 0.3])


def wanted(run: pm.Rollout, controller: AdaptiveVelocity, ahead: float) -> Array:
    """Return what the kinematic law asks for, of a robot whose body is so far ahead of its axle."""
    a, off = float(controller.ahead or 0), float(controller.ahead or 0) - ahead
    psi, psi_r, w_r = run.q[:, 2], run.reference.q[:, 2], run.reference.v[:, 2:]
    point, point_r = (
        place + off * np.stack([np.cos(x), np.sin(x)], axis=-1)
        for place, x in ((run.q[:, :2], psi), (run.reference.q[:, :2], psi_r))
    )
    rate = run.reference.v[:, :2] + off * w_r * np.stack([-np.sin(psi_r), np.cos(psi_r)], axis=-1)
    rate = rate + controller.saturation * np.tanh(controller.kp * (point_r - point) / controller.saturation)
    c, s = np.cos(psi), np.sin(psi)
    return np.stack([c * rate[:, 0] + s * rate[:, 1], (c * rate[:, 1] - s * rate[:, 0]) / a], axis=-1)


@pytest.mark.parametrize(("ahead", "path"), [(0.0, EIGHT), (0.15, pm.FixedHeading(EIGHT.path, 0.3))])
def test_velocities_of_an_exact_model_fall_to_the_law_as_the_gain_says(ahead: float, path: Any) -> None:
    """Which they do only where the rates of the law's velocities are right."""
    robot, dt, k = pm.VelocityRobot(TRUE.theta, ahead), 1e-3, np.array([3.0, 5.0])
    controller = AdaptiveVelocity(robot, k=k, gamma=0.0)
    q0 = path(0.0).q + OFF
    given: Any = {"q0": q0, "v0": robot.rolling(q0, [-0.1, 0.3]), "engine": pm.Engine.COMPILED}
    run = pm.simulate(robot, controller, path, dt=dt, duration=1.5, **given)
    found = wanted(run, controller, ahead) - robot.independent(run.q, run.v)
    expected = found[0] * np.exp(-np.outer(run.t, k))
    assert np.abs(found[0]).min() > 0.1
    # Commands are held for dt: order 1, with velocities that change by some 10 of their own a second.
    assert np.abs(found - expected).max() < 10 * dt * np.abs(found[0]).max()


def test_the_sum_of_squares_falls_in_each_step() -> None:
    dt, controller = 2e-4, AdaptiveVelocity(WRONG)
    q0 = EIGHT(0.0).q + OFF
    v0 = TRUE.rolling(q0, [0.1, -0.5])
    run = pm.simulate(TRUE, controller, EIGHT, dt=dt, duration=1.0, q0=q0, v0=v0, engine=pm.Engine.COMPILED)
    e = wanted(run, controller, 0.0) - TRUE.independent(run.q, run.v)
    # A signal is told after its sample, when the estimate has been brought on.
    off = run.signals["theta"].values[:-1] - TRUE.theta
    total = (e**2 * TRUE.theta[:2])[1:].sum(axis=-1) / 2 + (off**2 / np.asarray(controller.gamma)).sum(-1) / 2
    assert total[0] - total[-1] > 0.1 * total[0]
    assert (np.diff(total) < 0).all()


def test_a_theta_that_is_wrong_by_30_percent_ends_with_less_error_than_without_adaptation() -> None:
    spread = {
        f"controller.theta.theta_{j + 1}": pm.Uniform(*sorted((0.7 * x, 1.3 * x)))
        for j, x in enumerate(TRUE.theta)
    }
    given: Any = {"n": 50, "spread": spread, "dt": 0.02, "seed": 3, "after": 40.0}
    with_, without = (
        pm.ensemble(TRUE, controller, EIGHT, **given)
        for controller in (AdaptiveVelocity(TRUE), AdaptiveVelocity(TRUE, gamma=0.0))
    )
    assert with_.engine == pm.Engine.COMPILED.name
    # A model that is nearly right needs no adaptation, and dt leaves some millimetres.
    assert np.median(with_.max_distance) < 0.1 * np.median(without.max_distance)
    assert with_.max_distance.max() < 0.05 < without.max_distance.max()


def test_what_limits_keep_commands_from_is_no_reason_to_estimate_more() -> None:
    class Deaf:
        """One that is not told of limits."""

        def initial_state(self, context: Any) -> Any:
            return controller.initial_state(context)

        def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
            return controller(t, q, v, reference, state)

        def signals(self, state: Any) -> Any:
            return controller.signals(state)

    controller = AdaptiveVelocity(TRUE)
    robot = pm.VelocityRobot(TRUE.theta, limits=(0.3, 2.0))
    straight = pm.Tangent(pm.Line((0, 0), (24, 0), 40))
    given: Any = {"dt": 0.02, "engine": pm.Engine.COMPILED, "duration": 20.0}
    within, beyond = (
        pm.simulate(robot, each, straight, **given).signals["theta"].values[-1]
        for each in (controller, Deaf())
    )
    assert abs(beyond[3] - 1.1) > 1.0
    assert np.abs(within - TRUE.theta).max() < 0.02


def test_leakage_takes_estimates_back_to_the_first() -> None:
    controller = AdaptiveVelocity(WRONG, gamma=0.0, leakage=0.5)
    t: Any = np.arange(2) * 0.1
    state = controller.initial_state(Context.of(TRUE, dt=0.1, t=t, reference=EIGHT(t)))
    moved = (np.asarray(WRONG.theta) + 0.1, *state[1:])
    _, state = controller(0.0, EIGHT(0.0).q, EIGHT(0.0).v, EIGHT(0.0), moved)
    np.testing.assert_allclose(state[0] - WRONG.theta, 0.1 * (1 - 0.5 * 0.1), rtol=1e-12)


def test_estimates_stay_within_their_bounds() -> None:
    lower, upper = 0.95 * WRONG.theta, 1.05 * WRONG.theta
    controller = AdaptiveVelocity(WRONG, lower=lower, upper=upper)
    theta = pm.simulate(TRUE, controller, EIGHT, dt=0.02, engine=pm.Engine.COMPILED).signals["theta"].values
    assert (theta.min(axis=0) >= lower).all()
    assert (theta.max(axis=0) <= upper).all()
    assert (theta == lower).any()
    assert (theta == upper).any()


test_bad_arguments_are_refused = refusals(
    (lambda: AdaptiveVelocity(pm.MobileRobot.box()), "robot is .*, expected a VelocityRobot"),
    (
        lambda: AdaptiveVelocity(TRUE, upper=[1, 1, 1, 1, 1, 2]),
        "lower and upper exclude the robot's value, theta_4 = 1.1",
    ),
    (lambda: pm.simulate(TRUE, AdaptiveVelocity(TRUE, k=30), EIGHT, dt=0.1), r"k = \[30.0\].*expected dt <"),
    (
        lambda: pm.simulate(TRUE, AdaptiveVelocity(TRUE), pm.FixedHeading(EIGHT.path, 0.3), dt=0.02),
        "reference moves sideways",
    ),
)
