"""Logs with the difficulties of real robots, of which the true values are known."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import plots
from pinmobile.arrays import Array
from pinmobile.identification import Identification, validate
from tests import test_identification as wheels
from tests.refusals import refused

pytestmark = pytest.mark.once

THETA = (0.57, 0.9, 0.0, 1.1, 0.0, 1.05)
ROBOT = pm.VelocityRobot(THETA)
NOISE = np.array([0.02, 0.03])  # m/s, rad/s


def steps(seed: int, seconds: float, *, dt: float = 0.05, most: Any = (4.0, 5.0)) -> tuple[Array, Array]:
    """Return times and commands that change every 5 to 8 s."""
    rng, t = np.random.default_rng(seed), dt * np.arange(round(seconds / dt) + 1.0)
    edges = np.cumsum(rng.uniform(5.0, 8.0, int(seconds / 5) + 2))
    levels = rng.uniform([0.0, -1.0], 1.0, (len(edges) + 1, 2)) * most
    return t, levels[np.searchsorted(edges, t, side="right")]


def driven(t: Array, u: Array, *, limits: Any = np.inf, theta: Any = THETA, late: int = 0) -> Array:
    """Return speed and yaw rate of the true robot, by the midpoint rule with steps of 5 ms."""
    (u_, w), found, h = (0.0, 0.0), [np.zeros(2)], 5e-3
    commands = np.clip(np.vstack([np.repeat(u[:1], late, axis=0), u]), -np.asarray(limits), limits).tolist()
    th = pm.VelocityRobot(theta).theta.tolist()

    def rates(u: float, w: float, command: Any) -> tuple[float, float]:
        return (th[2] * w * w - th[3] * u + command[0]) / th[0], (command[1] - (th[4] * u + th[5]) * w) / th[
            1
        ]

    for command in commands[: len(t) - 1]:
        for _ in range(round((t[1] - t[0]) / h)):
            a, b = rates(u_, w, command)
            a, b = rates(u_ + h / 2 * a, w + h / 2 * b, command)
            u_, w = u_ + h * a, w + h * b
        found.append(np.array([u_, w]))
    return np.array(found)


def logged(t: Array, u: Array, nu: Array, *, seed: int = 0, every: int = 4, grain: float = 0.0) -> pm.Log:
    """Return the log of encoders that measure every few rows, as a log of two streams."""
    noisy = nu + NOISE * np.random.default_rng([seed, 1]).normal(size=nu.shape)
    noisy = grain * np.rint(noisy / grain) if grain else noisy
    twist = np.column_stack([noisy[:, 0], 0 * t, noisy[:, 1]])
    return pm.Log.from_streams(t[::every], None, t, u, twist=twist[::every])


def true(found: Identification, theta: Any = THETA, **others: float) -> Array:
    """Return the deviations of estimates from true values, in standard errors."""
    values = {f"theta_{k}": x for k, x in enumerate(theta, 1)} | others
    return np.array([(found.parameters[n] - x) / found.standard_errors[n] for n, x in values.items()])


@cache
def saturated() -> pm.Log:
    t, u = steps(1, 300.0)
    return logged(t, u, driven(t, u, limits=(np.inf, 3.7)))


def test_steps_of_commands_are_no_outliers_and_a_limit_of_the_robot_is_found() -> None:
    found = pm.identify_velocity(saturated())
    assert found.outliers <= 2
    assert np.abs(true(found, largest_yaw_rate_command=3.7)).max() < 4
    assert found.robot().limits[1] == found.parameters["largest_yaw_rate_command"]
    assert found.standard_errors["theta_1"] < 0.02
    assert min(share for both in found.free_run.values() for share in both) > 0.98
    assert "R^2 of a free run: speed 1 (hold-out 1); yaw rate 1 (hold-out 1)" in str(found)
    wrong = pm.identify_velocity(saturated(), limits=np.inf)
    assert wrong.free_run["yaw rate"][0] < found.free_run["yaw rate"][0] - 5e-3


def test_sections_under_other_control_are_left_out_and_told() -> None:
    t, u = steps(2, 240.0)
    given = u.copy()
    by_hand = [(60.0, 70.0), (150.0, 158.0)]
    for start, stop in by_hand:  # the driver's commands are not in the log
        u[(t >= start) & (t < stop)] = 0.0
        given[(t >= start) & (t < stop)] = -1.5, 2.0
    found = pm.identify_velocity(logged(t, u, driven(t, given)))
    assert np.abs(true(found)).max() < 4
    (told,) = (note for note in found.notes if "left out" in note)
    assert "as if another driver had taken over: " in told
    for start, _ in by_hand:
        assert any(
            abs(float(x) - start) < 2
            for x in told.split(": ")[-1].replace(" s", "").replace(" to", "").replace(",", "").split()
            if x[0].isdigit()
        )
    with refused("log has commands that explain nothing in [0-9]+% of the log, and in the rest"):
        pm.identify_velocity(logged(t, np.where(t[:, None] < 150, 0.0, u) + 1e-3 * u, driven(t, given)))


def test_commands_between_measurements_act_from_their_own_times() -> None:
    """Their means over a step would find limits of accelerations 2 % low, and a delay of 10 ms."""
    real = pm.VelocityRobot([0.4, 0.3, 0, 1, 0, 1], accelerations=(0.7, 1.5))
    still = pm.FixedHeading(pm.Hold((0, 0), 60.0), 0.0)
    run = pm.simulate(real, pm.controllers.RandomSteps(), still, dt=0.04)
    held = pm.law(lambda t, q, v, reference: run.u[np.minimum(np.int64(t / 0.04 + 1e-6), len(run.u) - 1)])
    fine = pm.simulate(real, held, still, dt=0.01)
    q = fine.q + np.random.default_rng(0).normal(scale=2e-3, size=fine.q.shape)
    late, values = fine.t[3::4], {"acceleration": 0.7, "yaw_acceleration": 1.5, "delay": 0.02}
    log = pm.Log.from_streams(late, q[1::4][: len(late)], run.t, run.u)
    again = pm.Log.from_streams(fine.t[2::4], q[::4][: len(fine.t[2::4])], run.t, run.u)
    for given in (
        log,
        [log.between(0, 25), log.between(27, 60)],
        [log.between(0, 30), again.between(30, 60)],
    ):
        found = pm.identify_velocity(given)
        assert np.abs(true(found, real.theta, **values)).max() < 4
        assert found.standard_errors["delay"] < 3e-4
        assert found.whiteness.is_white
    slow = pm.identify_velocity(pm.Log.from_streams(fine.t[::20], q[::20], fine.t, fine.u))  # 100 Hz and 5 Hz
    assert np.abs(true(slow, real.theta, **values | {"delay": 0.0})[:-1]).max() < 4
    assert not any("left out" in note for note in slow.notes)
    other = replace(log, u=-log.u)
    with refused("log has commands that explain"):  # and not those of the streams
        pm.identify_velocity(other)


def test_a_delay_is_not_negative_and_an_early_motion_is_told() -> None:
    t, u = steps(3, 100.0)
    early = np.vstack([driven(t, u)[6:], np.repeat(driven(t, u)[-1:], 6, axis=0)])
    found = pm.identify_velocity(logged(t, u, early, every=1))
    assert found.delay == 0.0
    assert any(note.startswith("the delay is taken as zero: its estimate is -") for note in found.notes)


def test_a_wrong_structure_gives_results_that_depend_on_the_segments() -> None:
    t, u = steps(4, 240.0)
    nu = driven(t, u)
    nu[:, 0] *= 1 - 0.12 * np.abs(nu[:, 1]) / 3  # as wheels that slip in curves
    found = pm.identify_velocity(logged(t, u, nu))
    assert not found.is_noise
    assert any(
        "estimates from segments of" in note or "more than noise explains" in note for note in found.notes
    )


@pytest.mark.parametrize("kind", ["jitter", "gaps", "two rates"])
def test_times_and_sensors_of_real_logs_are_taken_as_they_are(kind: str) -> None:
    t, u = steps(5, 240.0)
    nu, rng = driven(t, u), np.random.default_rng(9)
    if kind == "jitter":
        at = np.sort(t + 5e-4 * rng.normal(size=t.shape))  # 1 % of a step
        rows = np.column_stack([np.interp(at, t, column) for column in nu.T])
        log = pm.Log(at, None, u, twist=rows + NOISE * rng.normal(size=nu.shape))
    elif kind == "gaps":
        kept = np.delete(np.arange(len(t)), [*range(1000, 1004), *range(3000, 3200)])
        log = pm.Log(t[kept], None, u[kept], twist=(nu + NOISE * rng.normal(size=nu.shape))[kept])
    else:  # a table that repeats what a slow sensor measured last
        log = pm.Log(
            t, None, u, twist=np.repeat((nu + NOISE * rng.normal(size=nu.shape))[::4], 4, axis=0)[: len(t)]
        )
    found = pm.identify_velocity(log)
    assert np.abs(true(found)).max() < 4
    assert found.is_noise


def test_encoders_alone_identify_body_friction_and_delay() -> None:
    log = wheels.rolled(False)
    plant = wheels.on_wheels(wheels.BODY)
    blind = pm.Log(log.t, None, log.u, wheel_rates=log.wheel_rates)
    found, both = pm.identify(blind, plant), pm.identify(log, plant)
    assert found.is_noise
    for name, value in (("mass", 30.0), ("com_x", 0.06), ("com_y", 0.02), ("yaw_inertia", 1.3)):
        low, high = found.interval(0.999)[name]
        assert low < value < high
        assert found.standard_errors[name] < 6 * both.standard_errors[name]
    assert found.standard_errors["mass"] < 0.3
    assert "residual: left " in str(found)
    again = found.predict(blind)
    assert again.names == ("left", "right")
    np.testing.assert_allclose(again.rms, 0.02, rtol=0.1)
    S = plant.wheeled.reduced(plant.rest, np.zeros(plant.nv)).S
    twist = log.wheel_rates @ np.linalg.pinv(S[3:]).T @ S[:3].T
    by_twist = pm.identify(pm.Log(log.t, None, log.u, twist=twist), plant)
    np.testing.assert_allclose(by_twist.values, found.values, rtol=1e-6, atol=1e-6)
    with refused("log has no q, expected a measurement of the motion"):
        pm.identify(pm.Log(log.t, None, np.ones((len(log), 3)), twist=twist))


def test_currents_without_a_sign_are_refused() -> None:
    log, plant = wheels.rolled(False), wheels.on_wheels(wheels.BODY)
    with refused("log has input left from .*, but its wheel turns both ways, expected an input with a"):
        pm.identify(pm.Log(log.t, log.q, np.abs(log.u), wheel_rates=log.wheel_rates), plant)


def test_a_prediction_beside_simpler_models() -> None:
    result = validate(saturated())
    assert list(result.rms) == ["kinematics", "lag", "identified"]
    np.testing.assert_allclose(result.horizons, [0.2, 2.0, 5.0])
    for simple in ("kinematics", "lag"):
        assert (result.rms["identified"][1:] < 1.02 * result.rms[simple][1:]).all()
    assert (result.rms["identified"][2] < 1.3 * NOISE).all()
    assert (result.rms["kinematics"][1] > 5 * NOISE).all()
    lines = str(result).splitlines()
    assert lines[0].split("  ")[-1] == "yaw rate [rad/s]"
    assert [line.split()[2] for line in lines[1:]] == ["kinematics", "lag", "identified"] * 3


def test_a_log_is_shown_beside_its_model() -> None:
    t, u = steps(6, 60.0, most=(0.8, 1.0))
    nu = driven(t, u)
    psi = np.append(0, np.cumsum(0.05 * (nu[1:, 1] + nu[:-1, 1]) / 2))
    mid = 0.5 * (psi[1:] + psi[:-1])
    way = 0.025 * (nu[1:, :1] + nu[:-1, :1]) * np.column_stack([np.cos(mid), np.sin(mid)])
    q = np.column_stack([np.vstack([np.zeros(2), np.cumsum(way, axis=0)]), psi])
    log = pm.Log(t, q, u)
    run = log.rollout(ROBOT, substeps=2)
    np.testing.assert_allclose(run.q, q, atol=1e-12)
    np.testing.assert_array_equal(run.u, u)
    np.testing.assert_allclose(run.reference.q, q, atol=0.02)
    np.testing.assert_allclose(run.error, run.reference.q - run.q, atol=1e-9)
    other = log.rollout(pm.VelocityRobot([2.0, *THETA[1:]]), substeps=2)
    assert np.abs(other.error).max() > 0.3
    assert plots.path(run).axes
    by_odometry = pm.Log(t, None, u, twist=nu).rollout(ROBOT, substeps=2)
    np.testing.assert_allclose(by_odometry.q, q, atol=0.05)
    with refused("robot is .*, with 3 inputs, expected a robot in the plane with 2, as the log has"):
        log.rollout(pm.MobileRobot(10.0, 1.0))
