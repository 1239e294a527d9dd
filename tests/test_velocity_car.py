"""`VelocityCar` and `TorqueCar`, by speed or torque and steering angle, and their identification."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.controllers import RandomSteps, VelocityCommand
from pinmobile.identification import VelocityCar, validate
from pinmobile.loop import Rollout
from pinmobile.wheels import DifferentialGear, WheelFriction
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


def check(
    found: pm.identification.Identification, truth: dict[str, float], share: float = 0.2, least: float = 1.0
) -> None:
    """Check that intervals of 99.9 % contain the true values, nearly where `least` is 0, and are narrow."""
    for name, value in truth.items():
        low, high = found.interval(0.999)[name]
        slack = 0.0 if least else 2e-3 * abs(value)
        assert low - slack <= value <= high + slack, name
        assert high - low < share * max(abs(value), least), name


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


def test_steps_of_the_acceleration_are_no_outliers_of_precise_poses() -> None:
    run = driven(CAR)
    q = run.q[:, :3] + 2e-4 * np.random.default_rng(0).standard_normal((len(run.t), 3))
    found = pm.identify_velocity(pm.Log(run.t, q, run.u, units=UNITS))
    assert found.outliers <= 2
    assert min(min(pair) for pair in found.free_run.values()) > 0.999


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
    with refused("log has steering commands up to .* rad, expected below pi / 2: are they in degrees"):
        pm.identify_velocity(replace(degrees, units=("m/s", "rad")))
    with refused("input steering angle in rad/s, expected rad: leave out wheelbase"):
        pm.identify_velocity(replace(degrees, units=("m/s", "rad/s")), wheelbase=0.3)


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


# -- `identify` for a car with a torque and a measured steering angle ------------------------------


MASS, INERTIA, COM, FRONT = 3.0, 0.05, 0.13, 0.3
VISCOUS, COULOMB, STIFF = 8e-3, 0.02, (60.0, 90.0)  # of the drive; front and rear [N s/m]
RADIUS, SPIN = 0.05, 1.2e-4
DT = 0.02


def table(slip: float = 0.0, driven: tuple[str, ...] = ("rear",), **how: Any) -> pm.WheelTable:
    """Return the wheels of a car with driven axles, each on a differential gear."""
    friction = WheelFriction(slip=slip, rolling=0.0)
    own: dict[str, Any] = {"mass": 0.1, "spin_inertia": SPIN, "yaw_inertia": 6e-5, "friction": friction}
    made = pm.WheelTable.car(FRONT, 0.2, RADIUS, **own, **how)
    gears = [DifferentialGear((f"{axle}_left", f"{axle}_right"), name=axle) for axle in driven]
    return made if driven == ("rear",) else pm.WheelTable(made.wheels, (), (*gears, made.couplings[1]))


def car(slip: float = 0.0, mass: float = 2.0, inertia: float = 0.08, com: float = COM) -> pm.WheeledRobot:
    """Return a prior car; slip of each wheel [m/(N s)]."""
    body = pm.MobileRobot(mass, inertia, com=(com, 0, 0.05), size=(0.4, 0.2, 0.1))
    return pm.WheeledRobot(body, table(slip), pm.Coulomb() if slip else pm.Rolling())


def steering(t: Any) -> Any:
    """Return the steering angle and its rate."""
    return 0.25 * np.sin(0.9 * t) + 0.1 * np.sin(2.3 * t), 0.225 * np.cos(0.9 * t) + 0.23 * np.cos(2.3 * t)


def torque(t: Any) -> Any:
    """Return the torque of the drive [N m]."""
    return 0.05 + 0.03 * np.sin(0.37 * t) + 0.05 * np.sign(np.sin(1.7 * t))


def rates(t: float, z: Array, tau: float, rolls: bool) -> Array:
    """Return the rates of x, y, psi, u, v and r of a bicycle, by the equations of its momentum."""
    psi, (u, v, r) = z[2], z[3:]
    (angle, turning), T = steering(t), np.tan(steering(t)[0])
    rate = u / RADIUS
    drive = (tau - VISCOUS * rate - COULOMB * rate / np.hypot(rate, 0.1)) / RADIUS
    rear, front = 2 * SPIN / RADIUS**2, 2 * SPIN / RADIUS**2
    c, s = np.cos(angle), np.sin(angle)
    if rolls:  # model of the lecture on wheels, section 2.3
        J = INERTIA + MASS * COM**2
        M = MASS + J * T**2 / FRONT**2 + rear * (1 + (0.1 * T / FRONT) ** 2) + front * (1 + T**2)
        slope = (2 * J / FRONT**2 + 2 * rear * (0.1 / FRONT) ** 2 + 2 * front) * T * (1 + T**2)
        du = (drive - 0.5 * slope * u * turning) / M
        r = u * T / FRONT
        return np.array([u * np.cos(psi), u * np.sin(psi), r, du, 0.0, 0.0])
    across = np.array([-s, c, FRONT * c])
    forces = -STIFF[0] * (across @ z[3:]) * across - STIFF[1] * v * np.array([0.0, 1.0, 0.0])
    along = np.array([c, s, FRONT * s])
    M3 = np.array([[MASS, 0, 0], [0, MASS, MASS * COM], [0, MASS * COM, INERTIA + MASS * COM**2]])
    M3 = M3 + np.diag([rear, 0, rear * 0.1**2]) + front * np.outer(along, along)
    c3 = MASS * np.array([-r * v - COM * r * r, r * u, COM * r * u])
    d = np.linalg.solve(M3, np.array([drive, 0, 0]) + forces - c3)
    return np.array([u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi), r, *d])


@cache
def logged(rolls: bool, kind: str = "poses", seconds: float = 60.0, seed: int = 0) -> pm.Log:
    """Return a log with noise of 1 mm and 1 mrad, or 5 mm/s and 5 mrad/s."""
    t, rng, substeps = np.arange(0, seconds, DT), np.random.default_rng(seed), 2
    z, found, h = np.zeros(6), [], DT / substeps
    for now in t:
        found.append(z)
        tau = torque(now)
        for k in range(substeps):
            at = now + k * h
            a = rates(at, z, tau, rolls)
            b = rates(at + h / 2, z + h / 2 * a, tau, rolls)
            c = rates(at + h / 2, z + h / 2 * b, tau, rolls)
            z = z + h / 6 * (a + 2 * (b + c) + rates(at + h, z + h * c, tau, rolls))
    states, noise = np.array(found), rng.standard_normal((len(t), 3))
    u = np.column_stack([torque(t), steering(t)[0] + 2e-4 * rng.standard_normal(len(t))])
    if kind == "poses":
        return pm.Log(t, states[:, :3] + 1e-3 * noise, u, units=("N m", "rad"))
    turn = states[:, 3] * np.tan(steering(t)[0]) / FRONT if rolls else states[:, 5]
    twist = np.column_stack([states[:, 3], 0 * turn, turn]) + 5e-3 * noise
    return pm.Log(t, None, u, twist=twist, units=("N m", "rad"))


FRICTION = {"joint_viscous_drive": VISCOUS, "joint_coulomb_drive": COULOMB}


def test_a_rolling_car_gives_mass_and_friction() -> None:
    found = pm.identify(logged(True), car())
    check(found, {"mass": MASS, "yaw_inertia": INERTIA, **FRICTION}, 1.0, 0.0)
    assert min(min(pair) for pair in found.free_run.values()) > 0.95
    robot = found.robot()
    assert robot.robot.mass == found.parameters["mass"]
    assert set(found.spread(3)) == {"mass", "yaw_inertia"}
    drag = found.forces()[0]
    np.testing.assert_allclose(drag.viscous[4:6], found.parameters["joint_viscous_drive"] / 2)


@pytest.mark.long
def test_a_slipping_car_gives_cornering_stiffness() -> None:
    found = pm.identify(logged(False), car(0.02, com=0.15))
    stiff = {"cornering_front": STIFF[0], "cornering_rear": STIFF[1]}
    check(found, {"mass": MASS, "com_x": COM, "yaw_inertia": INERTIA, **FRICTION, **stiff}, 3.0, 0.0)
    slips = [wheel.friction.slip for wheel in found.robot().table.wheels]
    assert slips[0] == pytest.approx(2 / found.parameters["cornering_rear"])


def test_front_and_all_wheels_may_be_driven() -> None:
    """The library simulates cars with other driven wheels, whose steering is a torque there."""
    driven = "rear", "front"
    body = pm.MobileRobot(MASS, INERTIA, com=(COM, 0, 0.05), size=(0.4, 0.2, 0.1))
    real = pm.WheeledRobot(body, table(driven=driven))
    share = 1.0 / len(driven)

    def drive(t: Any, q: Any, v: Any, reference: Any) -> Any:
        push = share * (0.05 * len(driven) + 0.03 * np.sin(0.37 * t) + 0.05 * np.sin(1.7 * t))
        return [*[push] * len(driven), 0.02 * (steering(t)[0] - q[3]) - 3e-3 * v[3]]

    still = pm.FixedHeading(pm.Hold((0, 0), duration=60), psi=0)
    names = [one.name for one in real.coordinates]
    rubs = np.array([name.startswith(driven) and "_" in name for name in names])
    drag = pm.JointFriction(4e-3 * rubs, 0.01 * rubs, 0.1, names)  # share of a drive: half of each wheel's
    run = pm.simulate(real, pm.law(drive), still, dt=DT, forces=[drag])
    u = np.column_stack([run.u[:, :-1], run.q[:, 3]])
    noise = 1e-3 * np.random.default_rng(0).standard_normal((len(run.t), 3))
    prior = pm.WheeledRobot(car().robot, table(driven=driven))
    found = pm.identify(pm.Log(run.t, run.q[:, :3] + noise, u), prior)
    np.testing.assert_allclose(found.parameters["mass"], MASS, rtol=0.02)
    # Equal torques do not separate the friction of two axles.
    viscous = sum(found.parameters[f"joint_viscous_{axle}"] for axle in driven)
    np.testing.assert_allclose(viscous, VISCOUS * len(driven), rtol=0.05)


def test_wheels_alone_need_no_prior_body() -> None:
    found = pm.identify(logged(True, "twists"), table())
    np.testing.assert_allclose(found.parameters["mass"], MASS, rtol=0.01)
    J = found.parameters["yaw_inertia"]  # about the rear axle: the centre of mass is not known
    assert pytest.approx(INERTIA + MASS * COM**2, rel=0.15) == J


def test_voltages_of_a_motor_give_the_same() -> None:
    motor = pm.Motor(resistance=2.0, torque_constant=0.02, voltage=24.0, gear=8.0)
    log, body = logged(True, "twists"), car().robot
    rolling = pm.WheeledRobot(body, table(motor=motor)).by_voltage()
    assert log.twist is not None
    back = log.twist[:, 0] / RADIUS  # rate of the motor at the wheel
    volts = (log.u[:, 0] / (8 * 0.02) + 8 * 0.02 / 2.0 * back) * 2.0
    found = pm.identify(pm.Log(log.t, None, np.column_stack([volts, log.u[:, 1]]), twist=log.twist), rolling)
    np.testing.assert_allclose(found.parameters["mass"], MASS, rtol=0.03)
    assert isinstance(found.robot(), type(rolling))


def test_wrong_cars_and_logs_are_refused() -> None:
    log = logged(True, "twists", 30.0)
    with refused("log has 3 inputs, expected drive, steering: of a car, give the steering angle"):
        pm.identify(pm.Log(log.t, None, np.column_stack([log.u, log.u[:, 0]]), twist=log.twist), car())
    with refused("log has input steering in N m, expected rad"):
        pm.identify(pm.Log(log.t, None, log.u, twist=log.twist, units=("N m", "N m")), car())
    swerve = pm.WheelTable.swerve([(0.3, 0), (-0.3, 0)], 0.1, spin_inertia=0.01, yaw_inertia=0.01)
    with refused("robot has wheels that steer, and is no car"):
        pm.identify(log, pm.WheeledRobot(pm.MobileRobot(30.0, 1.3), swerve))
    with refused("log has inputs in N m, rad, expected N m, N m: the robot takes other inputs"):
        log.rollout(car())
