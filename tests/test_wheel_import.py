"""Wheel tables read from URDFs: against numbers by hand and Pinocchio's own tree, and what is refused."""

import warnings
from collections.abc import Mapping
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pinmobile import Coulomb, InvalidArgument, MobileRobot, Motor, Rolling, WheeledRobot, WheelTable
from pinmobile.errors import UnknownName
from pinmobile.wheels import AckermannSteering, DifferentialGear, GearTrain, Support, read_wheels
from tests import wheeled
from tests.wheeled import HALF_PI, inertial, joint, link, robot as urdf, shape, written

ROLLING = shape("cylinder", 'radius="0.1" length="0.04"', rpy=f"{HALF_PI} 0 0")
ROUND = "0.003 0 0 0.005 0 0.003"


DINGO = (0.0004901, 0.0003234)  # as cylinders of its size have them
CASTER = (1.541e-5, 1.075e-5)
CASTERS = [f"caster_{end}_{side}_2_joint" for end in ("front", "back") for side in ("left", "right")]


def read(folder: Path, text: str, **given: Any) -> WheeledRobot:
    return WheeledRobot.from_urdf(written(folder, text), **given)


def numbers(table: WheelTable) -> list[tuple[float, float, float]]:
    return [(wheel.x, wheel.y, wheel.radius) for wheel in table.wheels]


def near(table: WheelTable, places: list[tuple[float, float]], radius: float, to: float = 1e-12) -> None:
    np.testing.assert_allclose(numbers(table), [(x, y, radius) for x, y in places], rtol=0, atol=to)


# Real robots: the numbers of their files, whose friction is reported
pytestmark = pytest.mark.filterwarnings("ignore:base.urdf. damping and friction:UserWarning")


def box(x: float, y: float) -> list[tuple[float, float]]:
    return [(x, y), (x, -y), (-x, y), (-x, -y)]


def test_husky_has_four_tyres_and_both_its_sides_may_be_coupled(tmp_path: Path) -> None:
    robot = MobileRobot.from_urdf(written(tmp_path, wheeled.husky()))
    words = r"'wheel_3' are fixed on more than one axle: .*rollers=\{\} for tyr"
    with pytest.raises(InvalidArgument, match=words):
        WheeledRobot(robot)
    table = read_wheels(robot, rollers={})
    near(table, box(0.256, 0.2854), 0.1651)
    for wheel in table.wheels:
        assert (wheel.mass, wheel.spin_inertia, wheel.yaw_inertia) == (2.637, 0.04411, 0.02467)
        assert (wheel.angle, wheel.steering, wheel.roller, wheel.motor) == (0.0, "fixed", None, Motor())
    assert robot.mass == pytest.approx(46.034 + 4 * 2.637, rel=1e-14)  # the wheels are in the whole, once
    assert table.supports == ()
    assert (
        "wheels with a motor, assumed because driven is not given: all; no rollers as given" in table.source
    )
    assert WheeledRobot(robot, table).ground == Coulomb()
    with pytest.raises(InvalidArgument, match="fixed on more than one axle, so it turns only by skidding"):
        WheeledRobot(robot, table, Rolling())
    trains = [GearTrain(("wheel_0", "wheel_2")), GearTrain(("wheel_1", "wheel_3"))]
    coupled = read_wheels(robot, couplings=trains)
    assert [actuator.name for actuator in coupled.actuators] == ["wheel_0", "wheel_1"]
    assert coupled.couplings == tuple(trains)
    assert "driven is not given: wheel_0, wheel_1;" in coupled.source
    assert read_wheels(robot, driven=["wheel_0", "wheel_1"], couplings=trains) == coupled


def test_friction_of_a_file_that_changes_nothing_is_reported(tmp_path: Path) -> None:
    plain = wheeled.turtlebot("burger")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(tmp_path, plain)
    left = 'wheel_left_joint" type="continuous">'
    held = plain.replace(left, f'{left}<dynamics damping="5" friction="2"/>')
    slick = '<gazebo reference="wheel_left_link"><mu1>0.1</mu1></gazebo></robot>'
    with pytest.warns(UserWarning, match=r"^base\.urdf: ") as told:
        read(tmp_path, held.replace("</robot>", slick))
    (words,) = (str(one.message) for one in told)
    assert "damping and friction of ${namespace}wheel_left_joint act only where motors take volts" in words
    assert words.endswith("mu1 and mu2 of wheel_left_link are not used: use ground=Coulomb(mu)")


def test_ridgeback_is_mecanum_where_its_rollers_are_told(tmp_path: Path) -> None:
    robot = read(tmp_path, wheeled.ridgeback(), rollers=pi / 4)
    near(robot.table, box(0.319, 0.2755), 0.0759)
    own = WheelTable.mecanum(0.638, 0.551, 0.0759, mass=2.3, spin_inertia=6.6424e-3, yaw_inertia=3.3212e-3)
    assert [wheel.roller for wheel in robot.table.wheels] == [wheel.roller for wheel in own.wheels]
    assert robot.mobility.mobility == 3
    named = dict(zip(robot.table.names, (-pi / 4, pi / 4, pi / 4, -pi / 4), strict=True))
    assert read(tmp_path, wheeled.ridgeback(), rollers=named).table == robot.table
    with pytest.raises(InvalidArgument, match="rollers is not given, and wheels 'front_left_wheel', 'front"):
        read(tmp_path, wheeled.ridgeback())  # the file does not tell


def test_turtlebot_is_level_and_stands_on_its_casters(tmp_path: Path) -> None:
    robot = read(tmp_path, wheeled.turtlebot("waffle"))
    near(robot.table, [(0, 0.144), (0, -0.144)], 0.033)
    assert robot.table.wheels[0].spin_inertia == pytest.approx(2.0712558e-05, rel=1e-6)
    assert robot.table.wheels[0].yaw_inertia == pytest.approx(1.1184e-05, rel=1e-4)
    assert [wheel.angle for wheel in robot.table.wheels] == [0.0, 0.0]  # axles written as -1.57
    casters = [(-0.177, -0.064), (-0.177, 0.064)]
    np.testing.assert_allclose([(s.x, s.y) for s in robot.table.supports], casters, atol=1e-6)
    assert robot.robot.com[0] == pytest.approx(-0.0058, abs=1e-4)
    assert dict(robot.joint_signs) == dict.fromkeys(robot.table.names, 1)


def test_dingo_and_mp400_have_their_inertia_on_another_axis(tmp_path: Path) -> None:
    words = r"about its axle: moments are 0\.0003234 about it, 0\.0003234 and 0\.00049\d* across.*or iner"
    with pytest.raises(InvalidArgument, match=rf"wheel 'wheel_0' is not a solid of revolution {words}"):
        read(tmp_path, wheeled.dingo())
    robot = read(tmp_path, wheeled.dingo(), inertia=DINGO)
    y = 0.2160016 + 0.02032 / 2
    near(robot.table, [(0.0989838, y), (0.0989838, -y)], 0.049)
    assert robot.table.supports == (Support(-0.244, 0.0),)
    assert robot.robot.com[0] < 0.0989838  # behind the axle
    assert read(tmp_path, wheeled.dingo(), inertia={"wheel_0": DINGO, "wheel_1": DINGO}) == robot
    assert "inertia as given, the whole's as in the file, of all" in robot.source
    # Axles turned by 1.57: 0.0008 rad off the y axis, they would be on two lines.
    robot = read(tmp_path, wheeled.mp400(), inertia=(0.00739239692, 0.0039974))
    near(robot.table, [(0, -0.26), (0, 0.26)], 0.0765)
    assert [wheel.angle for wheel in robot.table.wheels] == [0.0, 0.0]
    assert "axes that the file rounds are exact at all" in robot.source
    assert [wheel.motor.torque_limit for wheel in robot.table.wheels if wheel.motor] == [1000.0, 1000.0]
    places = [(x, y) for x in (0.165, -0.22) for y in (0.155, -0.155)]
    assert [(s.x, s.y) for s in robot.table.supports] == places


def test_fetch_is_asked_for_its_radius_which_tells_the_ground_too(tmp_path: Path) -> None:
    words = r"radius of wheel 'l_wheel_joint' is None.*expected radius=\{'l_wheel_joint': \.\.\.\}"
    with pytest.raises(InvalidArgument, match=words):
        read(tmp_path, wheeled.fetch())
    robot = read(tmp_path, wheeled.fetch(), radius=0.0604, supports=[(-0.12, 0.1), (-0.12, -0.1)])
    near(robot.table, [(0.0012914, 0.18738), (0.0012914, -0.18738)], 0.0604)
    assert robot.robot.grounded
    # The body's centre of mass is 1.4 mm above base_link, which is 5.075 mm above the ground.
    z = (70.1294 * 0.0014 + 2 * 4.3542 * 0.055325) / (70.1294 + 2 * 4.3542) + 0.0604 - 0.055325
    assert robot.robot.com[2] == pytest.approx(z)
    motors = [Motor(8.85, rate_limit=17.4, source=f"joint {name}") for name in robot.table.names]
    assert [wheel.motor for wheel in robot.table.wheels] == motors
    assert len(robot.table.supports) == 2
    assert "radius as given of all" in robot.source
    ground = read(tmp_path, wheeled.fetch(), radius=0.0604, ground_z=0.055325 - 0.0604)
    assert ground.robot == robot.robot


def test_tiago_stands_on_swivelling_casters(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match=r"'caster_back_left_2_joint' is not a solid of revolution"):
        read(tmp_path, wheeled.pmb2_on_casters())
    robot = read(tmp_path, wheeled.pmb2_on_casters(), inertia=dict.fromkeys(CASTERS, CASTER))
    table = robot.table
    by_name = {wheel.name: wheel for wheel in table.wheels}
    for side, y in (("left", 0.2022), ("right", -0.2022)):
        w = by_name[f"wheel_{side}_joint"]
        assert (w.x, w.y, w.radius, w.steering) == (0.0, y, 0.0985, "fixed")
        assert w.motor == Motor(
            6.0, viscous=1.0, coulomb=2.0, rate_limit=10.152284263959391, source=f"joint {w.name}"
        )
    casters = [by_name[name] for name in CASTERS]
    turns = {(w.steering, w.trail, w.radius, w.motor) for w in casters}
    assert turns == {("free", (-0.016, 0.0), 0.025, None)}
    assert {(w.x, w.y) for w in casters} == {(x, y) for x in (-0.1735, 0.1695) for y in (-0.102, 0.102)}
    assert (robot.mobility.mobility, len(table.axes), table.supports) == (2, 4, ())
    assert robot.inputs[0].name == "wheel_left_joint"
    assert robot.nu == 2
    said = "damping and friction of the joint are the motor's at wheel_left_joint, wheel_right_joint"
    assert said in robot.source
    assert "turns freely behind its swivel: caster_back_left_2_joint," in robot.source


# The same as Pinocchio's tree of the file


def energy_of_file(text: str, twist: Any, joints: Mapping[str, tuple[float, float]]) -> float:
    """Return the kinetic energy of a file's own tree, `joints` with angle and rate."""
    model = pin.buildModelFromXML(text, pin.JointModelPlanar())
    q, v = pin.neutral(model), np.zeros(model.nv)
    v[:3] = twist
    for name, (angle, rate) in joints.items():
        number = model.getJointId(name)
        at, size = model.idx_qs[number], model.nqs[number]
        q[at : at + size] = (cos(angle), sin(angle)) if size == 2 else angle
        v[model.idx_vs[number]] = rate
    return float(pin.computeKineticEnergy(model, model.createData(), q, v))


def on_round_casters() -> str:
    """Return the file of PMB2 with the moments of its casters' wheels on the right axis."""
    wrong = wheeled.wheels_moments("0.00001075", "0.00001541", "0.00001075")
    right = wheeled.wheels_moments("0.00001075", "0.00001075", "0.00001541")
    return wheeled.pmb2_on_casters().replace(wrong, right)


# Husky and Jackal turn by skidding alone: they do not roll ideally.
REAL: dict[str, tuple[Any, dict[str, Any]]] = {
    "ridgeback": (wheeled.ridgeback, {"rollers": pi / 4}),
    "burger": (lambda: wheeled.turtlebot("burger"), {}),
    "pmb2": (on_round_casters, {}),
}


ROUNDED = {"burger": 1e-5, "pmb2": 1e-6}


@pytest.mark.parametrize("name", REAL)
def test_the_kinetic_energy_is_that_of_the_files_own_tree(tmp_path: Path, name: str) -> None:
    make, given = REAL[name]
    text = make()
    robot, rng = read(tmp_path, text, **given), np.random.default_rng(3)
    swivels = {joint.name: joint.swivels for joint in robot.robot.undercarriage.wheels}
    for _ in range(5):
        q, v = rng.normal(size=robot.nq), rng.normal(size=robot.nv)  # rolling or not
        c, s = cos(q[2]), sin(q[2])
        twist = [c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]]
        n, axes, joints = 3, robot.table.axes, dict[str, tuple[float, float]]()
        for k, axis in enumerate(axes):
            (row,) = axis.wheels
            joints[swivels[robot.table.names[row]][0].name] = q[n + k], v[n + k]
        for k, wheel in enumerate(robot.table.names):
            sign, at = robot.joint_signs[wheel], n + len(axes) + k
            joints[wheel] = sign * q[at], sign * v[at]
        expected = energy_of_file(text, twist, joints)
        # TurtleBot's wheels have moments across their axles that differ by 0.15 %, PMB2's forks their
        # centre of mass 0.05 mm aside.
        assert robot.kinetic_energy(q, v) == pytest.approx(expected, rel=ROUNDED.get(name, 1e-7))


# Rolled on a circle


# What else files have


def base(*wheels: str, body: str = "") -> str:
    return urdf(link("base", inertial(9, "0 0 0.1"), body), *wheels)


def wheel(name: str, at: str, parent: str = "base", moments: str = ROUND, **more: Any) -> str:
    own = link(f"{name}_link", inertial(1, moments=moments), ROLLING)
    return own + joint(name, more.pop("kind", "continuous"), parent, f"{name}_link", at, **more)


PAIR = wheel("left", "0 0.2 0.1") + wheel("right", "0 -0.2 0.1")


def test_a_mirrored_wheel_rolls_forward_and_its_sign_is_kept(tmp_path: Path) -> None:
    mirrored = wheel("left", "0 0.2 0.1") + wheel("right", "0 -0.2 0.1", axis="0 -1 0")
    robot = read(tmp_path, base(mirrored))
    plain = read(tmp_path, base(PAIR))
    assert robot.table == plain.table
    assert dict(robot.joint_signs) == {"left": 1, "right": -1}
    assert dict(plain.joint_signs) == {"left": 1, "right": 1}
    assert "the joint turns the other way at right" in robot.source
    turned = read(tmp_path, base(wheel("left", "0 0.2 0.1") + wheel("right", "0 -0.2 0.1", rpy="0 0 3.14")))
    assert (numbers(turned.table), turned.table.wheels[1].angle) == (numbers(plain.table), 0.0)
    assert turned.joint_signs["right"] == -1


def test_omni_wheels_keep_the_sense_of_their_joints(tmp_path: Path) -> None:
    angles = [k * 2 * pi / 3 for k in range(3)]
    places = [(f"{0.3 * cos(a)} {0.3 * sin(a)} 0.1", f"0 0 {a + pi / 2}") for a in angles]
    wheels = [wheel(f"w{k}", at, rpy=rpy) for k, (at, rpy) in enumerate(places)]
    robot = read(tmp_path, base(*wheels), rollers=0.0)
    own = WheelTable.omni(0.3, 0.1)
    assert robot.mobility.mobility == 3
    assert set(robot.joint_signs.values()) == {1}
    for row, expected in zip(robot.table.wheels, own.wheels, strict=True):
        assert row.roller == 0.0
        np.testing.assert_allclose([row.x, row.y], [expected.x, expected.y], atol=1e-12)
        assert cos(row.angle - expected.angle) == pytest.approx(1)


def test_axles_that_are_nearly_on_one_line_are_on_it(tmp_path: Path) -> None:
    robot = read(tmp_path, base(wheel("left", "0.0004 0.2 0.1"), wheel("right", "-0.0004 -0.2 0.1")))
    near(robot.table, [(0, 0.2), (0, -0.2)], 0.1)
    assert "axles put on one line, by 0.4 mm at most" in robot.source
    with pytest.raises(InvalidArgument, match="'left', 'right' are fixed on more than one axle"):
        read(tmp_path, base(wheel("left", "0.002 0.2 0.1"), wheel("right", "-0.002 -0.2 0.1")))


def on_swivel(at: str, wheel_at: str, name: str = "caster", **more: Any) -> str:
    own = inertial(0.5, more.pop("fork_at", "0 0 0"), moments="0.001 0 0 0.001 0 0.001")
    kind, fork = more.pop("kind", "continuous"), f"{name}_fork"
    axis = joint(f"{name}_swivel", kind, "base", fork, at, axis="0 0 1", **more)
    return link(fork, own) + axis + wheel(name, wheel_at, fork)


def test_a_swivel_with_limits_is_driven(tmp_path: Path) -> None:
    limit = '<limit lower="-0.6" upper="0.5" effort="3" velocity="1"/>'
    robot = read(tmp_path, base(PAIR, on_swivel("0.5 0 0.1", "0 0 0", kind="revolute", limit=limit)))
    (axis,) = robot.table.axes
    assert (axis.driven, axis.limit) == (True, 0.5)
    assert [actuator.name for actuator in robot.table.actuators] == ["caster_steering", "left", "right"]
    trailing = on_swivel("0.5 0 0.1", "-0.03 0 0", kind="revolute", limit=limit)
    free = read(tmp_path, base(PAIR, trailing), steering={"caster": "free"})
    assert not free.table.axes[0].driven


def test_a_car_is_steered_by_ackermann_and_driven_through_its_differential(tmp_path: Path) -> None:
    limit = '<limit lower="-0.6" upper="0.6" effort="3" velocity="1"/>'
    front = [
        on_swivel(f"0.5 {y} 0.1", "0 0 0", name=f"front_{side}", kind="revolute", limit=limit)
        for side, y in (("left", 0.2), ("right", -0.2))
    ]
    rear = wheel("rear_left", "0 0.2 0.1") + wheel("rear_right", "0 -0.2 0.1")
    gear, steering = DifferentialGear(("rear_left", "rear_right")), ("front_left", "front_right")
    couplings = [gear, AckermannSteering(steering)]
    car = read(tmp_path, base(*front, rear), couplings=couplings)
    assert (car.mobility.mobility, car.mobility.steerability) == (1, 1)
    assert [each.name for each in car.inputs] == ["steering", "differential"]
    assert car.table.axes[0].limit == 0.6


def test_a_wheel_right_below_its_swivel_is_asked_about(tmp_path: Path) -> None:
    places = [(0.3, 0.0), (-0.3, 0.0)]
    text = base(*(on_swivel(f"{x} {y} 0.1", "0 0 0", name=f"m{k}") for k, (x, y) in enumerate(places)))
    words = r"'m0' is right below its swivel 'm0_swivel'.*steering=\{'m0': 'driven'\}"
    with pytest.raises(InvalidArgument, match=words):
        read(tmp_path, text)
    swerve = read(tmp_path, text, steering={"m0": "driven", "m1": "driven"})
    assert [each.name for each in swerve.table.actuators] == ["m0", "m0_steering", "m1", "m1_steering"]
    assert (swerve.mobility.mobility, swerve.mobility.steerability) == (1, 2)
    assert swerve.table.wheels[0].yaw_inertia == pytest.approx(0.003 + 0.001)


def test_a_robot_read_before_has_the_same_wheels_and_keeps_them(tmp_path: Path) -> None:
    path = written(tmp_path, wheeled.turtlebot("burger"))
    before = MobileRobot.from_urdf(path)
    robot = WheeledRobot.from_urdf(path)
    assert WheeledRobot(before) == robot
    arm = WheeledRobot(before.mount("ur5", (0, 0, 0.2, 0)))
    assert arm == robot.mount("ur5", (0, 0, 0.2, 0))
    assert "wheels locked" not in robot.source
    assert "radius by the collision geometry of all" in robot.source
    own = WheelTable.differential(0.16, 0.033)
    assert WheeledRobot.from_urdf(path, table=own).table == own


# What is refused

BARE = PAIR.replace(ROLLING, shape("mesh", 'filename="wheel.stl"'))
AT_AN_ANGLE = wheel("left", "0 0.2 0.1", moments="0.003 4e-4 0 0.005 0 0.003") + wheel("right", "0 -0.2 0.1")
OFF_ITS_AXLE = PAIR.replace(
    '<origin xyz="0 0 0" rpy="0 0 0"/><mass value="1"/>', '<origin xyz="0.004 0 0"/><mass value="1"/>'
)
MASSLESS = PAIR.replace("inertial>", "nothing>")
CARRYING = (
    PAIR
    + link("r", inertial(0.01, moments="1e-6 0 0 1e-6 0 1e-6"))
    + joint("spin", "continuous", "left_link", "r")
)
THIRD = PAIR + wheel("third", "0.4 0 0.12")
TWIN = PAIR + on_swivel("-0.3 0 0.1", "-0.04 0.03 0") + wheel("twin", "-0.04 -0.03 0", "caster_fork")
TABLE = WheelTable.differential(0.4, 0.1)


@pytest.mark.parametrize(
    ("wheels", "given", "words"),
    [
        (THIRD, {}, "do not stand on one plane"),
        (AT_AN_ANGLE, {}, r"products up to 0\.0004 kg m\^2: its inertia would depend on"),
        (OFF_ITS_AXLE, {}, "'left' has its centre of mass 4 mm off its axle"),
        (MASSLESS, {}, "wheel 'left' has no inertia in its file, expected an inertia, or inertia="),
        (BARE, {}, r"radius of wheel 'left' is None, expected radius=\{'left': "),
        (PAIR, {"radius": 0.1}, r"radius is 0.1 m, but the file defines the radius of every wheel"),
        (PAIR, {"rollers": pi / 4}, "for 2 wheels that are not four at the corners"),
        (CARRYING, {}, r"wheel 'left' carries joints 'spin', probably rollers"),
        (TWIN, {}, "wheels 'caster', 'twin' share one swivel, 'caster_swivel', which"),
        ("", {}, r"robot has no wheels in its file, .* expected table="),
        (PAIR, {"steering": "driven"}, "steering of wheel 'left' is 'driven', but the file has no joint"),
        (PAIR, {"locked": ["left", "right"]}, r"all wheels of the robot; expected fewer"),
        (PAIR, {"table": TABLE, "radius": 0.1}, "radius is 0.1, expected None with table"),
    ],
)
def test_what_is_refused(tmp_path: Path, wheels: str, given: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidArgument, match=words):
        read(tmp_path, base(wheels), **given)


def test_what_is_told_beside_the_file_is_taken(tmp_path: Path) -> None:
    robot = read(tmp_path, base(THIRD), ground_z=0.0, locked=["third"])
    assert (robot.table.names, robot.table.supports) == (("left", "right"), ())  # it is in the air
    robot = read(tmp_path, base(AT_AN_ANGLE), inertia={"left": (0.005, 0.003)})
    assert robot.table.wheels[0].spin_inertia == 0.005
    assert read(tmp_path, base(BARE), radius=0.1).robot.com[2] == pytest.approx(0.1)
    assert len(read(tmp_path, base(TWIN), locked=["caster", "twin"]).table.supports) == 2
    assert read(tmp_path, base(PAIR)).mass_matrix(np.zeros(5))[0, 0] == pytest.approx(11)


@pytest.mark.parametrize("key", ["radius", "locked"])
def test_wheels_that_are_not_there(tmp_path: Path, key: str) -> None:
    value: Any = ["lift"] if key == "locked" else {"lift": 0.1}
    with pytest.raises(UnknownName, match=f"wheel of {key}"):
        read(tmp_path, base(PAIR), **{key: value})
