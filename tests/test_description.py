"""`print(robot)`: numbers of a robot as text."""

import numpy as np
import pytest

from pinmobile import Coulomb, MobileRobot, Motor, PayloadBody, WheeledRobot, WheelTable

MOTOR = Motor(resistance=2, torque_constant=0.5, voltage=24, current=3, source="data sheet")
DRIVE = WheelTable.differential(0.5, 0.1, mass=1.0, spin_inertia=0.01, supports=[(0.3, 0)], motor=MOTOR)


def test_a_body_is_described_with_its_source_and_its_supports() -> None:
    robot = MobileRobot(30.0, 1.3, com=(0.1, 0.05, 0.2))
    text = robot.describe()
    assert str(robot) == text
    assert repr(robot) != text
    for words in ("mass            30 kg", "(0.1, 0.05, 0.2) m", "1.3 kg m^2 about", "x -0.3 to 0.3 m"):
        assert words in text
    assert "made from numbers" in text
    assert text.endswith("stands: its centre of mass is 0.15 m inside the edge of its supports")


@pytest.mark.parametrize(("x", "words"), [(0.3 - 1e-3, "stands: "), (0.31, "cannot stand: ")])
def test_a_robot_with_its_mass_outside_its_supports_cannot_stand(x: float, words: str) -> None:
    last = str(MobileRobot(30.0, 1.3, com=(x, 0, 0.2))).splitlines()[-1]
    assert last.startswith(words)
    wheeled = WheeledRobot(MobileRobot(30.0, 1.3, com=(x, 0, 0.2)), DRIVE, Coulomb(0.8))
    tips = wheeled.contact_loads(wheeled.rest, np.zeros(wheeled.nv), np.zeros(wheeled.nv)).tips
    said = str(wheeled).splitlines()[-1].startswith("cannot stand")
    assert bool(tips) == said  # the balance of loads agrees


@pytest.mark.parametrize(("angle", "words"), [(0.7, "stands: "), (0.8, "cannot stand: ")])
def test_a_ramp_moves_the_point_below_the_centre_of_mass(angle: float, words: str) -> None:
    flat = WheeledRobot(MobileRobot(30.0, 1.3, com=(0.2, 0, 0.2)), DRIVE, Coulomb(0.8))
    robot = flat.on_ramp(angle)  # upwards along x: the point moves back by 0.2 m tan(angle)
    last = str(robot).splitlines()[-1]
    assert last.startswith(words)
    assert last.endswith(" on this ramp, at psi = 0")
    still = np.zeros(robot.nv)
    assert bool(robot.contact_loads(robot.rest, still, still).tips) == (words == "cannot stand: ")


def test_arms_have_the_limits_of_their_files_and_loads_their_masses() -> None:
    robot = MobileRobot(30.0, 1.3).mount("ur5", (0.1, -0.05, 0.2, 0.4))
    robot = robot.attach(PayloadBody(1.5, (0, 0.01, 0.05), size=(0.1, 0.1, 0.1)))
    text = str(robot)
    elbow = next(line for line in text.splitlines() if "elbow" in line).split()
    k = [one.name for one in robot.coordinates].index("ur5/elbow_joint")
    assert elbow[1] == f"+-{robot.upper[k]:.4g}"
    assert elbow[3] == f"+-{robot.velocity_limit[k]:.4g}"
    assert elbow[5] == f"+-{robot.effort_limit[k]:.4g}"
    assert "load on ur5/tool0: 1.5 kg" in text
    assert f"whole robot: {robot.with_locked_arms().mass:.4g} kg" in text
    assert "numbers of arms: from their files or models\n  ur5: right angles" in text


def test_wheels_have_motors_with_stall_torque_and_top_speed() -> None:
    robot = WheeledRobot(MobileRobot(30.0, 1.3, com=(0.1, 0, 0.2)), DRIVE)
    for plant in (robot, robot.by_voltage()):
        assert str(plant) == robot.describe()
    row = next(line for line in str(robot).splitlines() if line.startswith("  left") and "data sheet" in line)
    rate = 24 / 0.5  # the voltage over the torque constant [rad/s]
    assert row.split() == f"left 1.5 N m {rate:g} rad/s, {0.1 * rate:g} m/s 24 V 3 A data sheet".split()
    assert "supports        3 corners" in str(robot)
    car = WheelTable.car(0.5, 0.4, 0.1, spin_inertia=0.01, yaw_inertia=0.01, steering_limit=0.6)
    assert "+-0.6 rad" in str(WheeledRobot(MobileRobot(30.0, 1.3), car))
