"""Robots on wheels as parts: their numbers by path, laws on symbols, grounds of one's own, values."""

import pickle
from typing import Any

import numpy as np
import pytest

from pinmobile import (
    Coulomb,
    InvalidArgument,
    MobileRobot,
    Motor,
    Uniform,
    VelocityRobot,
    WheeledRobot,
    WheelTable,
    ensemble,
    law,
    parts,
    wheels,
)
from pinmobile.loop import Relative, Scenario
from pinmobile.paths import Circle
from pinmobile.trajectories import Tangent
from pinmobile.wheels import Wheel, WheeledDynamics
from tests.refusals import begun, refusals
from tests.wheeled import BODY, WHEEL as OWN

MOTOR = Motor(resistance=1.2, torque_constant=0.03, voltage=24.0, gear=20.0, viscous=1e-5, coulomb=0.01)
WRONG: Any = 3
PAIR = WheelTable.differential(0.5, 0.1, supports=[(0.2, 0), (-0.2, 0)], motor=MOTOR, **OWN)
CAR = WheelTable.car(0.6, 0.4, 0.1, **OWN)
ROBOTS: dict[str, Any] = {
    "differential": WheeledRobot(BODY, PAIR),
    "mecanum": WheeledRobot(BODY, WheelTable.mecanum(0.5, 0.4, 0.1, **OWN)),
    "car": WheeledRobot(BODY, CAR),
    "slipping": WheeledRobot(BODY, PAIR, Coulomb(0.6)),
    "slipping, own friction": WheeledRobot(BODY, PAIR, Coulomb()),
    "slipping car": WheeledRobot(BODY, CAR, Coulomb()),
    "volts": WheeledRobot(BODY, PAIR).by_voltage(),
    "slipping volts": WheeledRobot(BODY, PAIR, Coulomb()).by_voltage(),
}


def test_numbers_have_paths() -> None:
    robot = ROBOTS["volts"]
    found: Any = parts.numbers(robot)
    assert found["wheeled.table.wheels.left.motor.resistance"].declared.bound == "> 0"
    assert found["wheeled.table.wheels.left.motor.gear"].value == MOTOR.gear
    assert parts.find(robot, "left.radius").path == "wheeled.table.wheels.left.radius"
    assert parts.find(ROBOTS["slipping"], "ground.mu").leaf.value == 0.6
    assert not any(path.endswith((".mass", ".angle")) for path in found if "table" in path)
    assert found["wheeled.table.wheels.left.friction.rolling"].value == 0.01


@pytest.mark.parametrize("name", ["car", "slipping volts"])
def test_robots_and_what_they_are_made_of_are_values(name: str) -> None:
    robot = ROBOTS[name]
    for _, part in parts.parts_of(robot):
        twin = pickle.loads(pickle.dumps(part))
        assert twin == part
        assert hash(twin) == hash(part)
    radius = next(path for path in parts.numbers(robot) if path.endswith("radius"))
    other = parts.replace(robot, {radius: 0.11})
    assert other != robot
    assert other.table.wheels[0] != robot.table.wheels[0]


@parts.part
class Film:
    """A ground of one's own, whose wheels slip without any force."""

    depth: float = parts.number(default=1.0, unit="mm", above=0, doc="depth")

    def dynamics(self, wheeled: Any) -> WheeledDynamics:
        """Return the dynamics of a robot on it."""
        return WheeledDynamics(wheeled, wheeled.robot.array_dynamics)


def test_a_ground_of_ones_own_has_what_its_dynamics_have() -> None:
    robot = WheeledRobot(BODY, PAIR, Film())
    assert not hasattr(robot, "project")
    assert not hasattr(robot, "step")
    with pytest.raises(InvalidArgument, match="do not support electric motors"):
        robot.by_voltage()
    with pytest.raises(TypeError, match="Film has no field 'ramp'"):
        robot.on_ramp(0.1)
    assert "ground.depth" in parts.numbers(robot)


test_what_is_declared_is_checked = refusals(
    (lambda: WheeledRobot(WRONG, PAIR), "robot is 3, expected a MobileRobot"),
    (lambda: WheeledRobot(BODY, PAIR, 3), "ground is 3, expected a ground with dynamics(wheeled)"),
    (lambda: Motor(efficiency=1.1), "efficiency is 1.1, expected > 0 and <= 1"),
    (lambda: parts.evolved(PAIR, wheels={"a": WRONG}), "wheels.a is 3, expected Wheel(...)"),
    (lambda: VelocityRobot([1, 1, 0, 1, 0, 0]), "theta[5] is 0.0, expected > 0"),
    by=begun,
)


def test_theta_has_a_name_for_each_entry() -> None:
    robot = VelocityRobot([0.26, 0.25, 0.03, 1.1, 0.2, 1.2], ahead=0.1)
    assert [*parts.named(robot)][1] == "theta.theta_1"
    assert parts.find(robot, "theta.theta_3").label == "theta_3"


@pytest.mark.parametrize("varied", [Tangent(Circle(1.0, 0.5, 1.0)), Tangent(Circle(1.1, 0.5, 1.0))])
@pytest.mark.parametrize("name", ["differential", "mecanum", "slipping", "volts", "swerve"])
def test_robots_of_an_ensemble_start_with_their_own_wheels(name: str, varied: Tangent) -> None:
    places = [(0.25, 0.2), (0.25, -0.2), (-0.25, 0.2), (-0.25, -0.2)]
    swerve = WheeledRobot(BODY, WheelTable.swerve(places, 0.1, **OWN), Coulomb())
    robot = swerve if name == "swerve" else ROBOTS[name]
    wheel, last = robot.table.names[0], robot.table.names[-1]
    spread: dict[str, Any] = {
        f"{wheel}.radius": Uniform(0.08, 0.12),
        f"{last}.y": Relative(Uniform(0.9, 1.1)),
    }
    if varied.path.radius != 1.0:  # each robot has its own reference
        spread["trajectory.path.radius"] = Uniform(1.0, 1.2)
    zero = law(lambda t, q, v, reference: np.zeros(robot.nu))
    scenario = Scenario(robot=robot, controller=zero, trajectory=varied, n=5, spread=spread, dt=0.01)
    values = scenario.values(scenario.draws(), 0, 5)
    q, v = scenario.starts(values, 5, scenario.references(values, 5))
    for i in range(5):
        loop = parts.replace(scenario.loop, {path: x[i] for path, x in values.items()})
        reference = loop.trajectory(0.0)
        alone = loop.plant.start(reference)
        # The projection on rolling, and the other order of its operations, round.
        np.testing.assert_allclose(q[i], alone[0], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(v[i], alone[1], rtol=1e-12, atol=1e-12)
    assert np.ptp(v[:, -1]) + np.ptp(v[:, -len(robot.table)]) > 0.1


def test_starts_of_many_robots_are_evaluated_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, starts = ROBOTS["slipping"], list[Any]()
    start = type(robot).start

    def counted(*given: Any) -> Any:
        starts.append(given)
        return start(*given)

    zero = law(lambda t, q, v, reference: np.zeros(robot.nu))
    spread: Any = {f"{robot.table.names[0]}.radius": Uniform(0.08, 0.12)}
    path = Tangent(Circle(1.0, 0.5, 1.0))
    scenario = Scenario(robot=robot, controller=zero, trajectory=path, n=50, spread=spread, dt=0.01)
    values = scenario.values(scenario.draws(), 0, 50)
    scenario.starts(values, 50, None)  # finds out which numbers change the start
    monkeypatch.setattr(type(robot), "start", counted)
    scenario.starts(values, 50, None)
    assert len(starts) == 2  # the first and the last robot, to compare


def test_a_plant_with_its_own_start_starts_each_robot_in_python() -> None:
    @parts.part
    class Own(WheeledRobot):  # type: ignore[misc]  # final: a user's plant would be written anew
        """Robot that starts at half the speed."""

        def start(self, reference: Any) -> Any:
            q, v = super().start(reference)
            return q, 0.5 * v

    own, path = Own(BODY, PAIR, Coulomb()), Tangent(Circle(1.0, 0.5, 1.0))
    zero = law(lambda t, q, v, reference: np.zeros(own.nu))
    spread = {"left.radius": np.array([0.0813, 0.1, 0.1177])}
    runs = ensemble(own, zero, path, n=3, dt=0.01, spread=spread)
    for i, radius in enumerate(spread["left.radius"]):
        left = parts.replace(own, {"table.wheels.left.radius": radius})
        np.testing.assert_array_equal(runs.member(i).v[0], left.start(path(0.0))[1])


def test_a_table_tells_what_no_motor_drives() -> None:
    rows = tuple(Wheel(f"wheel {k}", 0.3 - k, 0.2 - k, 0.1, roller=0.0) for k in range(3))
    told = "moves by (forward, left, turn) = (0, 1, 0) while no wheel turns: no motor drives that"
    assert told in str(WheelTable(rows))
    with pytest.raises(InvalidArgument, match="does not determine the body's motion by the rates"):
        WheeledRobot(MobileRobot.box(), WheelTable(rows)).odometry([1.0, 1.0, 1.0])
    assert "no motor" not in str(WheelTable.omni(0.2, 0.05, **OWN))


def test_a_table_prints_its_rows_and_the_type_of_the_drive() -> None:
    table = WheelTable.differential(track=0.5, radius=0.1, supports=[(-0.3, 0)], **OWN)
    assert str(table).splitlines() == [
        "wheel  x [m]  y [m]  radius [m]  rolls to  steering  rollers at  motor",
        "left   0      0.25   0.1         0 deg     fixed                 yes",
        "right  0      -0.25  0.1         0 deg     fixed                 yes",
        "supports without friction: (-0.3, 0) m",
        *str(table.mobility).splitlines(),
    ]


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (WheelTable.differential(0.5, 0.1, **OWN), "type (2, 0), differential"),
        (WheelTable.mecanum(0.5, 0.4, 0.08, **OWN), "type (3, 0), omnidirectional"),
        (WheelTable.omni(0.3, 0.05), "type (3, 0), omnidirectional"),
        (WheelTable.swerve([(0.3, 0.1), (-0.3, -0.1)], 0.06), "type (1, 2), two steered axles"),
        (
            WheelTable.car(0.6, 0.4, 0.1),
            "AckermannSteering of front_left, front_right\ntype (1, 1), car-like",
        ),
        (WheelTable.skid_steer(0.5, 0.4, 0.1), "cannot roll without slip: wheels 'front_left'"),
    ],
    ids=["differential", "mecanum", "omni", "swerve", "car", "skid steer"],
)
def test_each_drive_tells_its_type(table: WheelTable, told: str) -> None:
    assert told in str(table)
    assert eval(repr(table), {**vars(wheels), "inf": float("inf")}) == table
