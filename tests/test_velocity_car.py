"""`VelocityCar`, a car by speed and steering angle, and its identification."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.controllers import RandomSteps, VelocityCommand
from pinmobile.identification import VelocityCar, validate
from pinmobile.loop import Rollout
from tests.refusals import refused

STILL = pm.FixedHeading(pm.Hold((0, 0), duration=70), psi=0)
UNITS = ("m/s", "rad")
CAR = VelocityCar(
    wheelbase=0.3,
    speed_time_constant=0.25,
    steering_time_constant=0.12,
    steering_offset=0.03,
    understeer=0.02,
    cornering_drag=0.5,
)


def driven(car: VelocityCar, seed: int = 0, lowest: Any = (-0.5, -0.35)) -> Rollout:
    """Return a minute of random steps of speed and steering angle."""
    steps = RandomSteps(lowest=lowest, largest=(1.5, 0.35), seed=seed)
    return pm.simulate(car, steps, STILL, dt=0.05, substeps=10)


def log_of(run: Rollout, late: int = 2, is_pose: bool = False, size: float = 1.0) -> pm.Log:
    """Return the log of a run with noise of 20 mm/s and 20 mrad/s, or 3 mm and 3 mrad, times a size."""
    n, noise = len(run.t) - late, size * np.random.default_rng(1).standard_normal((len(run.t), 3))
    u = run.u[late:]
    if is_pose:
        return pm.Log(run.t[:n], (run.q[:, :3] + 3e-3 * noise)[:n], u, units=UNITS)
    speed = np.cos(run.q[:, 2]) * run.v[:, 0] + np.sin(run.q[:, 2]) * run.v[:, 1]
    twist = np.column_stack([speed, 0 * speed, run.v[:, 2]]) + 0.02 * noise
    return pm.Log(run.t[:n], None, u, twist=twist[:n], units=UNITS)


def test_the_acceleration_is_the_rate_of_rolling_velocities() -> None:
    rng, h = np.random.default_rng(0), 1e-6
    for ahead in (0.0, 0.2):
        car = VelocityCar(0.3, 0.25, 0.12, understeer=0.05, cornering_drag=0.7, ahead=ahead)
        for _ in range(5):
            q, nu, u = 0.4 * rng.standard_normal(4), rng.standard_normal(2), rng.standard_normal(2)
            v = car.rolling(q, nu)
            a = car.forward_dynamics(q, v, u)
            faster = np.cos(q[2]) * a[0] + np.sin(q[2]) * a[1] + ahead * v[2] ** 2
            rate = np.array([faster, a[3]])
            slope = (car.rolling(q + h * v, nu + h * rate) - car.rolling(q - h * v, nu - h * rate)) / (2 * h)
            np.testing.assert_allclose(a, slope, atol=1e-8)


def test_steps_of_the_commands_have_their_analytic_response() -> None:
    car = VelocityCar(0.3, 0.25, 0.12, speed_gain=0.9, steering_gain=1.1, steering_offset=0.02)
    given = np.array([1.0, 0.2])
    run = pm.simulate(car, pm.law(lambda t, q, v, r: given), STILL, dt=5e-3, duration=1.0)
    speed, phase = car.independent(run.q, run.v)[:, 0], 2 * run.t / 0.12
    np.testing.assert_allclose(speed, 0.9 * (1 - np.exp(-run.t / 0.25)), atol=1e-8)
    np.testing.assert_allclose(run.q[:, 3], 0.24 * (1 - (1 + phase) * np.exp(-phase)), atol=1e-6)


def test_a_steady_turn_has_the_radius_of_wheelbase_and_understeer() -> None:
    car = VelocityCar(0.3, 0.25, 0.12, understeer=0.02)
    turn = pm.law(lambda t, q, v, r: np.array([1.5, 0.2]))
    run = pm.simulate(car, turn, STILL, dt=0.01, duration=15)
    late = run.t > 5
    centre = run.q[late, :2] + np.column_stack([-np.sin(run.q[late, 2]), np.cos(run.q[late, 2])]) * (
        0.3 + 0.02 * 1.5**2
    ) / np.tan(0.2)
    assert np.ptp(centre, axis=0).max() < 1e-6
    slowed = pm.simulate(pm.parts.evolved(car, cornering_drag=0.5), turn, STILL, dt=0.01, duration=15)
    u = np.hypot(*slowed.v[-1, :2])
    k = np.tan(0.2) / (0.3 + 0.02 * u**2)
    np.testing.assert_allclose((1.5 - u) / 0.25, 0.5 * u * u * k * np.tan(0.2), rtol=1e-6)


def test_the_firmware_limits_acceleration_and_steering_rate() -> None:
    car = VelocityCar(0.3, 0.05, 0.02, rate_limits=(0.8, 0.5), limits=(1.0, 0.3))
    turn = pm.law(lambda t, q, v, r: np.array([2.0, 0.4]))
    run = pm.simulate(car, turn, STILL, dt=5e-3, duration=2)
    assert np.diff(np.hypot(run.v[:, 0], run.v[:, 1])).max() / 5e-3 == pytest.approx(0.8, rel=1e-3)
    assert run.v[:, 3].max() == pytest.approx(0.5, rel=1e-3)
    np.testing.assert_allclose(run.q[-1, 3], 0.3, atol=1e-6)
    np.testing.assert_array_equal(run.u[0], [1.0, 0.3])


def test_steering_beyond_what_the_model_describes_is_an_event() -> None:
    run = pm.simulate(CAR, pm.law(lambda t, q, v, r: np.array([0.1, 1.6])), STILL, dt=0.01, duration=2)
    (event,) = run.events
    assert (event.kind, event.name, event.limit) == ("position limit", "steering", 1.4)
    for name in ("speed_gain", "steering_gain"):
        with refused(f"{name} is 0, expected another number"):
            pm.parts.evolved(CAR, **{name: 0.0})


def test_a_kinematic_law_drives_a_car_along_a_path() -> None:
    path = pm.Tangent(pm.Circle(radius=2.0, rate=0.5, duration=20))
    run = pm.simulate(CAR, VelocityCommand(pm.UnicycleTracking(), CAR), path, dt=0.02)
    assert np.abs(run.error[:, :3]).max() < 0.05
    with refused("start has wheels that slide sideways at 0.3 m/s, expected rolling wheels"):
        CAR.check_start(np.zeros(4), np.array([1.0, 0.3, 0.0, 0.0]))


def check(found: pm.identification.Identification, truth: dict[str, float]) -> None:
    """Check that intervals of 99.9 % contain the true values and are narrow."""
    for name, value in truth.items():
        low, high = found.interval(0.999)[name]
        assert low <= value <= high, name
        assert high - low < 0.2 * max(abs(value), 1.0), name


def test_a_log_identifies_a_car() -> None:
    log = log_of(driven(CAR), is_pose=True)
    found = pm.identify_velocity(log)
    names = "speed_time_constant", "speed_gain", "steering_time_constant", "steering_offset", "wheelbase"
    check(found, {n: getattr(CAR, n) for n in (*names, "understeer", "cornering_drag")} | {"delay": 0.1})
    assert found.is_noise
    assert min(min(pair) for pair in found.free_run.values()) > 0.98
    car = found.robot()
    assert isinstance(car, VelocityCar)
    assert car.wheelbase == found.parameters["wheelbase"]
    assert found.predict(log).rms.max() < 0.025
    np.testing.assert_allclose(found.noise, 0.003, rtol=0.15)
    result = validate(log)
    assert (result.rms["identified"][1:, 1] < 0.8 * result.rms["lag"][1:, 1]).all()
    spread = found.spread(3)
    pm.ensemble(car, RandomSteps(), STILL, n=3, dt=0.05, duration=1.0, spread=spread, substeps=4)


def test_a_known_wheelbase_identifies_the_gain_of_the_steering() -> None:
    car = pm.parts.evolved(CAR, steering_gain=-0.8)
    log = log_of(driven(car))
    found = pm.identify_velocity(pm.Log(log.t, None, log.u, twist=log.twist), wheelbase=0.3)
    check(found, {"steering_gain": -0.8, "steering_offset": 0.03, "understeer": 0.02})
    assert found.robot().wheelbase == 0.3
    assert "the car turns to the other side than its commands: are they positive to the left?" in found.notes
    with refused("log has steering commands that turn the car to the other side"):
        pm.identify_velocity(log)
    degrees = pm.Log(log.t, None, log.u * [1.0, -57.3], twist=log.twist)
    notes = pm.identify_velocity(degrees, wheelbase=0.3).notes
    assert "steering_gain is near pi / 180: are the steering commands in degrees?" in notes


@pytest.mark.parametrize(
    ("limits", "named"),
    [
        ({"limits": (1.0, 0.25)}, {"largest_speed_command": 1.0, "largest_steering_command": 0.25}),
        ({"rate_limits": (np.inf, 0.4)}, {"steering_rate": 0.4}),
    ],
)
def test_limits_of_the_firmware_of_a_car_are_found(limits: Any, named: dict[str, float]) -> None:
    run, given = driven(pm.parts.evolved(CAR, **limits)), driven(CAR).u
    check(pm.identify_velocity(log_of(replace(run, u=given))), named)


def test_a_slow_log_does_not_identify_understeer() -> None:
    crawling = pm.simulate(CAR, RandomSteps((0.05, -0.35), (0.1, 0.35)), STILL, dt=0.05, substeps=10)
    slow = pm.identify_velocity(log_of(crawling, size=0.1))
    assert slow.is_identifiable["wheelbase"]
    assert not slow.is_identifiable["understeer"]
    assert slow.robot().understeer == 0


def test_poses_that_move_sideways_are_refused() -> None:
    log = log_of(driven(CAR), is_pose=True)
    assert log.q is not None
    turned = pm.Log(log.t, log.q + np.array([0, 0, 1.3]), log.u, units=UNITS)
    with refused("log has poses that move sideways at .* m/s and forward at .* m/s, expected psi in"):
        pm.identify_velocity(turned)
