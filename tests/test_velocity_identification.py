"""Theta from logs: published robots found again, delays, limits, firmware of motors, and what is refused."""

import re
from functools import cache
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import plots
from pinmobile.controllers import RandomSteps
from pinmobile.identification import VELOCITY_ROBOTS, Identification
from tests.refusals import refusals, refused

pytestmark = pytest.mark.once

DT, SECONDS = 0.1, 60.0
NOISE = np.array([0.005, 0.01])  # m/s, rad/s
ROBOT = VELOCITY_ROBOTS["pioneer_3dx_laser"]


@cache
def logged(
    robot: pm.VelocityRobot = ROBOT,
    seed: int = 1,
    *,
    pose: bool = False,
    late: int = 0,
    seconds: float = SECONDS,
    noise: float = 1.0,
) -> pm.Log:
    """Return what is logged of random steps: twists by default, commands that act late."""
    still = pm.FixedHeading(pm.Hold((0, 0), seconds), 0.0)
    substeps = int(np.ceil(DT / min(robot.time_constants) / 0.2))
    run = pm.simulate(
        robot, RandomSteps(seed=seed), still, dt=DT, substeps=substeps, engine=pm.Engine.COMPILED
    )
    rng = np.random.default_rng([seed, 7])
    commands = np.vstack([run.u[late:], np.repeat(run.u[-1:], late, axis=0)])
    if pose:
        return pm.Log(run.t, run.q + noise * 1e-3 * rng.normal(size=run.q.shape), commands)
    nu = robot.independent(run.q, run.v)
    u, w = (nu + noise * NOISE * rng.normal(size=nu.shape)).T
    return pm.Log(run.t, None, commands, twist=np.stack([u, 0 * u, w], axis=-1))


@cache
def found(robot: pm.VelocityRobot = ROBOT, **options: Any) -> Identification:
    return pm.identify_velocity(logged(robot, **options))


def test_without_noise_it_is_exact() -> None:
    """What is left is rk4's: (h / T)^5 / 120 = 1e-6 of a step of 0.1 s."""
    for pose in (False, True):
        one = pm.identify_velocity(logged(pose=pose, noise=0.0), delay=0.0)
        np.testing.assert_allclose(one.theta, ROBOT.theta, rtol=0, atol=2e-4)


def test_long_logs_give_first_estimates_by_pieces_of_enough_samples() -> None:
    """Each second piece of 3,000 samples would leave one sample at the end of 60,001."""
    one = found(seconds=6000.0)
    assert one.seconds < 400
    errors = np.array([one.standard_errors[name] for name in one.names[:6]])
    assert np.abs((one.theta - ROBOT.theta) / errors).max() < 4


def test_a_forgotten_delay_is_a_wrong_theta() -> None:
    wrong = pm.identify_velocity(logged(late=3), delay=0.0)
    assert abs(wrong.parameters["theta_1"] - ROBOT.theta[0]) > 0.1
    assert any("the residual is correlated" in note for note in wrong.notes)


def test_where_the_axle_is_and_what_firmware_allows_are_found() -> None:
    robot = pm.VelocityRobot(ROBOT.theta, ahead=0.15)
    one = pm.identify_velocity(logged(robot, pose=True), ahead=None)
    assert one.standard_errors["ahead"] < 1e-3
    assert one.robot().ahead == one.parameters["ahead"]
    robot = pm.VelocityRobot(ROBOT.theta, accelerations=(0.6, 1.5))
    one = pm.identify_velocity(logged(robot), accelerations=None)
    np.testing.assert_array_equal(one.robot().accelerations, one.values[-2:])
    assert found().names[6:] == ("delay",)  # of a log without limits, none are found
    plain = pm.identify_velocity(logged(robot), accelerations=np.inf)
    assert any("the residual is correlated" in note for note in plain.notes)


def test_outliers_and_lost_rows_are_left_out() -> None:
    log = logged()
    assert log.twist is not None
    rng, twist, u = np.random.default_rng(5), log.twist.copy(), log.u.copy()
    wild = rng.choice(np.arange(10, 590), 20, replace=False)
    twist[wild, 0] += 0.3 * rng.choice([-1, 1], 20)
    twist[rng.choice(np.setdiff1d(np.arange(10, 590, 3), wild), 12, replace=False), 2] = np.nan
    one = pm.identify_velocity(pm.Log(log.t, None, u, twist=twist))
    assert one.dropped == 12
    assert 18 <= one.outliers <= 26  # some more where a command was lost with its row
    z = (one.theta - ROBOT.theta) / [one.standard_errors[name] for name in one.names[:6]]
    assert np.abs(z).max() < 4


def test_a_table_says_it_all() -> None:
    told = str(found())
    for words in (
        "theta_6",
        "95 % ",
        "delay",
        "residual: speed",
        "the interval of theta_3 contains 0, with which it has no effect",
    ):
        assert words in told
    assert "but motors with losses have more than 1" in told  # 0.9965 +- 0.001
    assert repr(found()).startswith("<Identification: theta_1 0.26")
    assert dict(found().units)["theta_5"] == "s/m"


def test_another_log_is_predicted_to_its_noise() -> None:
    again = found().predict(logged(seed=9))
    assert again.names == ("speed", "yaw rate")
    np.testing.assert_allclose(again.rms, NOISE, rtol=0.1)  # of 580 samples: 3 %
    log = logged(seed=9)
    assert log.twist is not None
    np.testing.assert_array_equal(again.measured, log.twist[:, [0, 2]][np.rint(again.t / DT).astype(int)])
    assert re.fullmatch(
        r"rms of 1\.9 s ahead: speed \S+ mm/s .*, yaw rate \S+ mrad/s \(noise \S+\)", str(again)
    )
    figure = plots.prediction(again, width=7.0)
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == ["speed [m/s]", "yaw rate [rad/s]"]
    other = found().predict(logged(VELOCITY_ROBOTS["pioneer_3dx"], seed=9))
    assert (other.rms > 2 * NOISE).any()


def test_draws_are_as_wide_as_intervals_and_are_a_spread() -> None:
    one = found()
    draws = one.spread(4000, seed=3)
    assert list(draws) == [f"theta.theta_{k}" for k in range(1, 7)]
    for name, values in draws.items():
        low, high = one.interval()[name.removeprefix("theta.")]
        share = ((values >= low) & (values <= high)).mean()
        assert share == pytest.approx(0.95, abs=0.015)  # 4 sqrt(0.95 * 0.05 / 4000)


def changed(log: pm.Log, **new: Any) -> pm.Log:
    return pm.Log(**{**{name: getattr(log, name) for name in ("t", "q", "u", "twist")}, **new})


test_what_is_no_such_log_is_refused = refusals(
    (lambda: pm.identify_velocity(logged().between(0.0, 30.0)), r"29.9 s long, too short: it gives 14"),
    (
        lambda: pm.identify_velocity(changed(logged(), u=np.zeros((601, 3)))),
        "log has 3 inputs, expected two, commands of speed and yaw rate: for forces, torques",
    ),
    (
        lambda: pm.identify_velocity(changed(logged(), u=np.ones((601, 2)))),
        "constant commands, expected changing commands, such as RandomSteps",
    ),
    (lambda: found().predict(logged(pose=True)), "log has no twist, expected"),
)


def test_a_motion_that_tells_too_little_is_told_in_words() -> None:
    straight = RandomSteps((-0.2, 0.0), (0.8, 0.0), seed=1)
    run = pm.simulate(
        ROBOT, straight, pm.FixedHeading(pm.Hold((0, 0), 60.0), 0.0), dt=DT, engine=pm.Engine.COMPILED
    )
    speed = ROBOT.independent(run.q, run.v)[:, 0]
    twist = np.stack([speed, 0 * speed, 0 * speed], axis=-1)
    twist = twist + 0.005 * np.random.default_rng(1).normal(size=twist.shape) * [1, 0, 1]
    one = pm.identify_velocity(pm.Log(run.t, None, run.u, twist=twist))
    assert [name for name, seen in one.is_identifiable.items() if not seen] == [
        f"theta_{k}" for k in (2, 3, 5, 6)
    ]
    assert one.unseen == "the motion does not identify theta_2, theta_3, theta_5, theta_6: rank 3 of 7"
    assert one.interval()["theta_2"] == (0.0, np.inf)
    assert abs(one.parameters["theta_1"] - ROBOT.theta[0]) < 4 * one.standard_errors["theta_1"]
    for ask in (one.robot, lambda: one.spread(3)):
        with refused(r"does not identify theta_2, .*; expected a motion in which"):
            ask()


def alternate(log: pm.Log) -> Any:
    """Return poses of every second row."""
    return np.where(np.arange(len(log.t))[:, None] % 2, np.nan, np.asarray(log.q))


OTHERS = "log has commands that explain .*% of the speed .* and .*% of the yaw rate .*: are the commands from"
UNITS = "expected 0.1 to 10: are commands in m/s and rad/s"


@pytest.mark.parametrize(
    ("change", "why", "pose"),
    [
        (lambda log: changed(log, twist=log.twist * [1, 1, -1]), OTHERS, False),
        (lambda log: changed(log, u=np.random.default_rng(1).permutation(log.u)), OTHERS, True),
        (lambda log: changed(log, u=log.u * [1e3, 1]), f"theta_4 = .*command per .*, {UNITS}", False),
        (
            lambda log: changed(log, units=("rad/s", "m/s")),
            "speed in rad/s, expected m/s: are columns mixed",
            False,
        ),
        (
            lambda log: changed(
                log, u=np.where(np.arange(len(log.t))[:, None] % 2, log.u, np.nan), q=alternate(log)
            ),
            "t has 0 rows with inputs and a measurement, expected two or more: for inputs in rows",
            True,
        ),
    ],
)
def test_what_commands_do_not_explain_is_refused(change: Any, why: str, pose: bool) -> None:
    with refused(why):
        pm.identify_velocity(change(logged(VELOCITY_ROBOTS["pioneer_3dx"], pose=pose)))
