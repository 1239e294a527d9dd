"""`identify` for a car with a torque and a measured steering angle."""

from functools import cache
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.wheels import DifferentialGear, WheelFriction
from tests.refusals import refused

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


def check(found: pm.identification.Identification, truth: dict[str, float], share: float = 0.1) -> None:
    """Check that intervals of 99.9 % contain the true values, or nearly."""
    for name, value in truth.items():
        low, high = found.interval(0.999)[name]
        assert low - 2e-3 * abs(value) <= value <= high + 2e-3 * abs(value), name
        assert high - low < share * 10 * abs(value), name


FRICTION = {"joint_viscous_drive": VISCOUS, "joint_coulomb_drive": COULOMB}


def test_a_rolling_car_gives_mass_and_friction() -> None:
    found = pm.identify(logged(True), car())
    check(found, {"mass": MASS, "yaw_inertia": INERTIA, **FRICTION})
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
    check(found, {"mass": MASS, "com_x": COM, "yaw_inertia": INERTIA, **FRICTION, **stiff}, 0.3)
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
