"""`simulate` against closed forms, and what it does with what it cannot do."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.controllers import plain_difference
from pinmobile.integrators import semi_implicit_euler
from tests.refusals import holding, refusals

ROBOT = pm.MobileRobot(10, 1.2, com=(0.15, 0.05))
CIRCLE = pm.FixedHeading(pm.Circle(1.0, 0.5, 12.0), 0.3)
START = {"q0": (0.2, -0.1, 0.9), "v0": (0.1, 0.0, -0.4)}


@pytest.mark.parametrize("substeps", [1, 2])
def test_an_integrator_may_write_into_what_it_is_given(substeps: int) -> None:
    def careless(acceleration: Any, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
        v += dt * acceleration(t, q, v)
        q += dt * v
        return q, v

    one, other = (
        pm.simulate(ROBOT, pm.PD(9, 9), CIRCLE, dt=0.02, integrator=step, substeps=substeps)
        for step in (semi_implicit_euler, careless)
    )
    for name in ("q", "v", "a", "u"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=0, atol=1e-10)


def test_the_record_is_consistent_and_includes_the_last_sample() -> None:
    rollout = pm.simulate(ROBOT, pm.ComputedTorque(ROBOT), CIRCLE, dt=0.1, **START)  # type: ignore[arg-type]
    assert len(rollout) == 121
    assert repr(rollout).startswith("<Rollout: 121 samples over 12 s, ")
    assert (rollout.t[0], rollout.t[-1]) == (0.0, 12.0)
    np.testing.assert_allclose(rollout.t, np.arange(121) * 0.1, rtol=1e-15)
    np.testing.assert_array_equal(rollout.q[0], START["q0"])
    np.testing.assert_allclose(rollout.a, ROBOT.forward_dynamics(rollout.q, rollout.v, rollout.u), atol=1e-13)
    np.testing.assert_array_equal(rollout.error, ROBOT.difference(rollout.q, rollout.reference.q))
    np.testing.assert_array_equal(rollout.reference.q, CIRCLE(rollout.t).q)
    assert rollout.max_error().tolist() == np.abs(rollout.error).max(axis=0).tolist()
    np.testing.assert_allclose(rollout.rms_error(), np.sqrt((rollout.error**2).mean(axis=0)))
    np.testing.assert_array_equal(rollout.max_input(), np.abs(rollout.u).max(axis=0))
    assert (rollout.max_input() > rollout.u.max(axis=0)).any()
    with pytest.raises(ValueError, match="read-only"):
        rollout.q[0, 0] = 1


@pytest.mark.parametrize(("duration", "last"), [(0.3, 0.3), (12 * (1 + 1e-10), 12.0), (None, 12.0)])
def test_the_last_sample_is_at_the_duration_to_the_last_digit(duration: Any, last: float) -> None:
    assert np.arange(4)[-1] * 0.1 != 0.3  # as the other samples are
    rollout = pm.simulate(ROBOT, pm.ComputedTorque(ROBOT), CIRCLE, dt=0.1, duration=duration)
    assert rollout.t[-1] == last


def test_error_follows_the_exact_recurrence_under_a_held_force() -> None:
    """At rest with com = 0, M is constant: one step maps (e, e_dot) by a matrix, exactly."""
    kp, kd, dt = 4.0, 3.0, 0.1
    robot = pm.MobileRobot(10, 1.2)
    hold = pm.FixedHeading(pm.Hold((0.0, 0.0), 6.0), 0.0)
    rollout = pm.simulate(robot, pm.ComputedTorque(robot, kp, kd), hold, dt=dt, **START)  # type: ignore[arg-type]
    step = np.array([[1 - kp * dt**2 / 2, dt - kd * dt**2 / 2], [-kp * dt, 1 - kd * dt]])
    e = np.stack([-rollout.q, -rollout.v], axis=1)  # (N + 1, 2, 3)
    expected = np.stack([np.linalg.matrix_power(step, k) @ e[0] for k in range(61)])
    np.testing.assert_allclose(e, expected, rtol=0, atol=1e-14)


def test_the_force_is_held_over_dt_whatever_the_substeps() -> None:
    asked: list[float] = []

    def push(t: float, q: Array, v: Array, reference: Any) -> Array:
        asked.append(t)
        return np.array([1.0, 0, 0])

    pm.simulate(ROBOT, pm.law(push), CIRCLE, dt=0.5, duration=2.0, substeps=10, integrator=pm.rk4)
    # Before the loop it is asked three times whether it answers alike.
    assert asked == [0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.5, 2.0]


def test_divergence_is_reported_with_everything_before_it() -> None:
    """Errata, PD gains: with an offset centre of mass the lecture's loop diverges."""
    robot = pm.MobileRobot(30, 0.1, com=(0.1, 0.05))
    gains = (120, 120, 0.4)
    with pytest.raises(pm.Diverged, match=r"the loop diverged at t = .* s \(sample \d+ of 120\)") as caught:
        pm.simulate(robot, pm.PD(gains, gains), CIRCLE, dt=0.1, **START)  # type: ignore[arg-type]
    error = caught.value
    assert len(error.rollout) > 3
    assert error.time == pytest.approx(error.rollout.t[-1] + 0.1)
    assert error.q.shape == error.v.shape == (3,)
    assert np.isfinite(error.rollout.q).all()
    assert np.abs(error.rollout.error).max() <= 1e3
    copy = pickle.loads(pickle.dumps(error))  # as when it comes from another process
    assert (str(copy), copy.time, len(copy.rollout)) == (str(error), error.time, len(error.rollout))


def test_a_spinning_heading_is_divergence_though_its_error_stays_on_the_circle() -> None:
    robot = pm.MobileRobot(30, 0.1)
    with pytest.raises(pm.Diverged, match="the rate of psi"):
        pm.simulate(robot, pm.PD((120, 120, 400), (120, 120, 400)), CIRCLE, dt=0.1, **START)  # type: ignore[arg-type]


def test_a_start_beyond_the_limit_diverges_at_once_with_nothing_recorded() -> None:
    with pytest.raises(pm.Diverged, match=r"at t = 0 s .*the error in x is -2001") as caught:
        pm.simulate(ROBOT, pm.PD(1, 1), CIRCLE, dt=0.1, q0=(2001, 0, 0))
    assert caught.value.rollout is None


def fails(t: float, q: Array, v: Array, reference: Any = None) -> Array:
    return np.full(3, np.nan if t > 1.05 else 0.0)


@pytest.mark.parametrize(
    ("controller", "forces", "name"), [(pm.law(fails), (), "a, u"), (pm.PD(9, 9), [fails], "a")]
)
def test_what_is_not_a_number_is_divergence_at_that_sample(controller: Any, forces: Any, name: str) -> None:
    with pytest.raises(pm.Diverged, match=rf"at t = 1\.1 s .*: {name} not finite") as caught:
        pm.simulate(ROBOT, controller, CIRCLE, dt=0.1, forces=forces)
    assert len(caught.value.rollout) == 11


class TauAlone:
    """A controller that forgets to return its state."""

    def initial_state(self, context: Any) -> None:
        return None

    def __call__(self, *_: Any) -> Array:
        return np.zeros(3)


def test_without_a_duration_a_run_takes_the_whole_steps_of_the_trajectory_s_and_reports_it() -> None:
    circle = pm.Tangent(pm.Circle(1, 0.5, 10))
    with pytest.warns(
        UserWarning, match=r"^the last sample is at t = 9\.99 s: the trajectory's 10 s are not"
    ) as told:
        run = pm.simulate(pm.MobileRobot.lecture(), pm.PD(4, 4), circle, dt=0.03)
    assert len(told) == 1
    assert (len(run), run.t[-1]) == (334, pytest.approx(9.99, abs=1e-12))
    given = pm.simulate(pm.MobileRobot.lecture(), pm.PD(4, 4), circle, dt=0.03, duration=9.99)
    np.testing.assert_allclose(run.q, given.q, rtol=0, atol=1e-12)


class ScalarOnly:
    """A trajectory that takes one time only."""

    duration = 12.0

    def __call__(self, t: Any) -> pm.Reference:
        return pm.Reference(*np.array([[float(t), 0, 0]] * 3))


WEAK = pm.PD(1, 1)


def asked(controller: Any = WEAK, trajectory: Any = CIRCLE, **options: Any) -> pm.Rollout:
    return pm.simulate(ROBOT, controller, trajectory, **{"dt": 0.1} | options)


test_arguments_that_do_not_fit_are_refused = refusals(
    (lambda: asked(dt=0), "dt is 0.0 s, expected > 0"),
    (
        lambda: asked(dt=0.7, duration=12),
        "duration is 12.0 s, expected a whole number of steps dt = 0.7 s, such as 11.9 s",
    ),
    (lambda: asked(duration=13), "duration is 13.0 s, expected at most the trajectory's 12.0 s"),
    (lambda: asked(q0=(1, 2)), "q0 has shape (2,), expected (3,)"),
    (lambda: asked(dt=1e-9), "dt is 1e-09 s, expected at most the duration, 12.0 s, and at least 1.2e-07 s"),
    (lambda: asked(pm.ComputedTorque), "expected an object: ComputedTorque(...)"),
    (lambda: asked(TauAlone()), "controller returned array([0., 0., 0.]) at t = 0 s, expected (u,"),
    (lambda: asked(pm.PD(1, 1, difference=plain_difference), ScalarOnly()), "array of 121 times"),
    by=holding,
)


def test_csv_has_a_header_and_every_digit(tmp_path: Path) -> None:
    rollout = pm.simulate(ROBOT, pm.PD(1, 1), CIRCLE, dt=0.1, **START)  # type: ignore[arg-type]
    with pytest.raises(pm.InvalidArgument, match=r"nowhere.*which cannot be written"):
        rollout.to_csv(tmp_path / "nowhere" / "run.csv")
    rollout.to_csv(tmp_path / "run.csv")
    header = (tmp_path / "run.csv").read_text().splitlines()[0].split(",")
    assert header[:5] == ["t [s]", "x [m]", "y [m]", "psi [rad]", "v_x [m/s]"]
    table = np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1)
    assert table.shape == (121, len(header))
    np.testing.assert_array_equal(table[:, header.index("u_Mz [N m]")], rollout.u[:, 2])
    np.testing.assert_array_equal(table[:, header.index("desired_x [m]")], rollout.reference.q[:, 0])
