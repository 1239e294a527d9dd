"""How a robot stands: the ground below its wheels, its footprint and its top, against numbers by hand."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile.balance import MotionStates, required_friction, tip_over_margin, zero_moment_point
from tests import wheeled
from tests.refusals import refused
from tests.wheeled import HALF_PI, inertial, joint, link, robot as urdf, shape

G = 9.81
ROLLING = shape("cylinder", 'radius="0.1" length="0.04"', rpy=f"{HALF_PI} 0 0")


def read(folder: Path, text: str, **options: Any) -> pm.MobileRobot:
    return pm.MobileRobot.from_urdf(wheeled.written(folder, text), **options)


def braking(robot: pm.MobileRobot, a: float) -> float:
    """Return the margin of a robot on a straight line, accelerated by a forward."""
    return float(tip_over_margin(MotionStates(robot, (1.0, 2.0, 0.0), np.zeros(3), (a, 0.0, 0.0))))


def by_hand(*bodies: tuple[float, tuple[float, float, float]]) -> tuple[float, ...]:
    """Return mass and centre of mass of points."""
    mass = sum(m for m, _ in bodies)
    return mass, *(sum(m * at[k] for m, at in bodies) / mass for k in range(3))


def box(x: float, y: float) -> list[list[float]]:
    return [[-x, -y], [x, -y], [x, y], [-x, y]]


def stands_on(robot: pm.MobileRobot, corners: Any, atol: float = 1e-15) -> None:
    assert robot.footprint is not None
    np.testing.assert_allclose(robot.footprint, corners, rtol=0, atol=atol)


# Clearpath's three: the origin of base_link is above the ground


def test_husky_stands_on_its_wheels(tmp_path: Path) -> None:
    robot = read(tmp_path, wheeled.husky())
    high = 0.1651 - 0.03282  # of base_link above the ground
    mass, x, y, z = by_hand((46.034, (-0.00065, -0.085, 0.062 + high)), (4 * 2.637, (0, 0, 0.1651)))
    assert robot.mass == pytest.approx(mass, rel=1e-14)
    np.testing.assert_allclose(robot.com, (x, y, z), atol=1e-15)
    assert robot.com[2] == pytest.approx(0.18884, abs=5e-6)
    stands_on(robot, box(0.256, 0.2854), 1e-15)
    # The upper of its two boxes ends at 3/4 h - 0.01 + (h/2 - 0.02)/2 = h - 0.02.
    assert robot.top == pytest.approx(0.2475 - 0.02 + high, abs=1e-15)
    assert braking(robot, -3.0) == pytest.approx(0.256 - (x + z * 3 / G), abs=1e-14)
    assert braking(robot, -3.0) == pytest.approx(0.1988, abs=5e-5)
    assert braking(robot, 0.0) == pytest.approx(0.2854 + y, abs=1e-14)
    assert "ground below its wheels by their radii, at z = -0.1323 m" in robot.source


def stl(path: Path, points: Any) -> None:
    """Write a mesh of one triangle."""
    corners = "".join("vertex {} {} {}\n".format(*point) for point in points)
    path.write_text(f"solid m\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid m\n")


def test_ridgeback_stands_on_rocker_and_wheels_and_its_top_is_that_of_its_mesh(tmp_path: Path) -> None:
    robot = read(tmp_path, wheeled.ridgeback())
    high = 0.0759 - 0.05
    parts = ((165.304, (0.012, 0.002, 0.067 + high)), (2 * 10.267 + 4 * 2.3, (0, 0, 0.0759)))
    mass, x, y, z = by_hand(*parts)
    np.testing.assert_allclose([robot.mass, *robot.com], [mass, x, y, z], atol=1e-13)
    stands_on(robot, box(0.319, 0.2755), 1e-15)
    assert braking(robot, 2.0) == pytest.approx(0.2755 - y, abs=1e-14)  # the side is nearer than the rear
    assert braking(robot, 9.0) == pytest.approx(0.319 - (z * 9 / G - x), abs=1e-14)
    # Its largest box is a riser plate of 55 mm: neither a footprint nor a top.
    assert robot.size == (0.493, 0.493, 0.055)
    assert robot.top is None
    assert "top not known: cannot be read: body-collision.stl" in robot.source
    with refused("at is not given for 'ur5', and the top of the robot is not"):
        robot.mount("ur5")
    stl(tmp_path / "body-collision.stl", [(-0.4, 0, 0.1), (0.4, 0.3, 0.2), (0.4, -0.3, 0.31)])
    assert read(tmp_path, wheeled.ridgeback()).top == pytest.approx(0.31 + high, abs=1e-7)  # float32


# A differential drive stands on its casters too


def test_pmb2_is_read_and_the_link_that_no_body_is_is_named(tmp_path: Path) -> None:
    text, folder = wheeled.pmb2()
    with pytest.warns(UserWarning, match="link 'base_antenna_(left|right)_link'") as caught:
        robot = read(tmp_path, text, package_dirs=folder)
    assert len(caught) == 2
    assert {Path(warning.filename).name for warning in caught} == {"test_support_geometry.py"}
    masses = [float(mass.get("value", "")) for mass in ElementTree.fromstring(text).iter("mass")]
    assert robot.mass == pytest.approx(sum(masses))
    assert robot.grounded
    # Trailing casters: 16 mm behind swivels at 0.1695 and -0.1735.
    expected = [(-0.1895, -0.102), (0, -0.2022), (0.1535, -0.102), (0.1535, 0.102), (0, 0.2022)]
    stands_on(robot, [*expected, (-0.1895, 0.102)], 1e-12)
    assert robot.top == pytest.approx(0.0985 + 0.195 + 0.17)  # the tip of its antennas


def test_an_impossible_link_that_matters_is_refused(tmp_path: Path) -> None:
    def with_moment(least: float) -> str:
        parts = link("a", inertial(5)), link("b", inertial(0.01, moments=f"{least} 0 0 1e-3 0 1e-3"))
        return urdf(*parts, joint("j", "fixed", "a", "b"))

    with pytest.warns(UserWarning, match=r"link 'b': inertia has principal moments \(-0.0009, 0.001, 0.001"):
        assert read(tmp_path, with_moment(-0.9e-3)).mass == 5.01
    with refused(r"link 'b': inertia has principal moments \(-0.0011, "):
        read(tmp_path, with_moment(-1.1e-3))


@pytest.mark.parametrize("limit", ["", '<limit lower="-1e4" upper="1e4"/>'])
def test_revolute_wheels_without_limits_are_wheels(tmp_path: Path, limit: str) -> None:
    sides = [("left", 0.2), ("right", -0.2)]
    wheels = [
        link(side, inertial(1), ROLLING) + joint(f"{side}_joint", "revolute", "base", side, f"0 {y} 0.03")
        for side, y in sides
    ]
    text = urdf(link("base", inertial(9)), *wheels).replace("</joint>", f"{limit}</joint>")
    robot = read(tmp_path, text)
    assert robot.mass == 11
    assert robot.com[2] == pytest.approx((9 * 0.07 + 2 * 0.1) / 11)
    assert robot.visual_model.ngeoms == 3  # the file is read again to be drawn


def test_a_joint_of_few_turns_is_no_wheel(tmp_path: Path) -> None:
    limit = '<limit lower="-6000" upper="6000" effort="1" velocity="1"/>'
    axle = joint("j", "revolute", "base", "w", limit=limit)
    with refused(r"joint 'j' .* is neither a wheel"):
        read(tmp_path, urdf(link("base", inertial(9)), link("w", inertial(1)), axle))


# What a file does not tell


def test_where_radii_are_in_meshes_alone_the_ground_is_asked_for(tmp_path: Path) -> None:
    robot = read(tmp_path, wheeled.fetch())
    assert not robot.grounded
    assert (robot.footprint, robot.top) == (None, None)
    assert "height of the ground unknown" in robot.source
    still = MotionStates(robot, np.zeros(3), np.zeros(3), (1.0, 0, 0))
    for ask in (zero_moment_point, lambda motion: tip_over_margin(motion, box(0.1, 0.1))):
        with refused(r"a known one: MobileRobot.from_urdf\(path, ground"):
            ask(still)
    assert required_friction(still) == pytest.approx(1 / G)  # no height is in it
    with refused("the top of the robot is not known, expected x, y, z and yaw"):
        robot.mount("ur5")
    # The driver's wheels have a radius of 60 mm or so.
    known = read(tmp_path, wheeled.fetch(), ground=0.055325 - 0.0604)
    assert known.grounded
    assert known.com[2] == pytest.approx(robot.com[2] + 0.0604 - 0.055325, abs=1e-15)
    with refused("footprint is not given, and that of the robot is None"):
        tip_over_margin(MotionStates(known, np.zeros(3), np.zeros(3), np.zeros(3)))


def test_the_ground_may_be_given_in_place_of_the_files(tmp_path: Path) -> None:
    robot = read(tmp_path, wheeled.husky(), ground=-0.2)
    assert robot.com[2] == pytest.approx(0.18884 + 0.2 - 0.13228, abs=5e-6)
    assert robot.footprint is None  # no wheel is near it
    assert "ground as given, at z = -0.2 m" in robot.source


def test_ground_above_the_centre_of_mass_is_refused(tmp_path: Path) -> None:
    """The likely slip: the height of Husky's base_link above the ground, in place of the ground's z."""
    with refused(r"ground is 0\.132 m, 0\.07544 m above the robot's centre of mass.* negative"):
        read(tmp_path, wheeled.husky(), ground=0.132)
    assert read(tmp_path, urdf(link("base", inertial(9))), ground=0).com[2] == 0


def test_a_wheel_without_a_radius_leaves_the_footprint_unknown_unless_it_is_inside(tmp_path: Path) -> None:
    """A rear wheel known by its mesh alone was left out in silence: a triangle for a base on four wheels."""

    def on_wheels(*places: tuple[float, float]) -> pm.MobileRobot:
        shapes = [ROLLING] * (len(places) - 1) + [shape("mesh", 'filename="rear.stl"')]
        parts = [
            link(f"w{k}", inertial(1), shapes[k])
            + joint(f"j{k}", "continuous", "base", f"w{k}", f"{x} {y} 0.1")
            for k, (x, y) in enumerate(places)
        ]
        return read(tmp_path, urdf(link("base", inertial(9, "0 0 0.2")), *parts))

    robot = on_wheels((0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2))
    assert robot.footprint is None
    assert "j0, j1, j2, but the file does not contain the radius of j3" in robot.source
    with refused("that of the robot is None"):
        braking(robot, -1.0)
    six = on_wheels((0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2), (0, 0.2), (0, -0.2))
    stands_on(six, box(0.3, 0.2))


def bicycle(low: float, rear: str = ROLLING) -> str:
    front, axle = link("front", inertial(1), ROLLING), joint("f", "continuous", "base", "front", "0.5 0 0.1")
    back = link("back", inertial(1), rear), joint("b", "continuous", "base", "back", f"-0.5 0 {low}")
    return urdf(link("base", inertial(9)), front, axle, *back)


def test_wheels_that_stand_on_no_plane_are_refused_by_name(tmp_path: Path) -> None:
    assert read(tmp_path, bicycle(0.104)).com[2] == pytest.approx(0.204 / 11 - 0.002)
    with refused(r"plane, with lowest points b at z = 0\.006, f at z = 0 m"):
        read(tmp_path, bicycle(0.106))
    # Given the ground, only what touches it carries.
    assert (
        "what is within 5 mm of the ground, f, has no area"
        in read(tmp_path, bicycle(0.106), ground=0.0).source
    )


@pytest.mark.parametrize(
    "other",
    [
        shape("cylinder", 'radius="0.3" length="0.04"'),  # along the vertical
        shape("sphere", 'radius="0.3"', "0 0 0.1"),  # beside the axle
    ],
)
def test_the_radius_is_that_of_what_is_round_about_the_axle(tmp_path: Path, other: str) -> None:
    robot = read(tmp_path, bicycle(0.1, other + ROLLING))
    assert "at z = 0 m" in robot.source
    assert "what is within 5 mm of the ground, b, f, has no area" in robot.source


def test_a_wheel_hangs_on_its_swivel_and_its_rollers_are_no_wheels(tmp_path: Path) -> None:
    swivel = link("fork", inertial(0.1)), joint("s", "continuous", "base", "fork", "0.3 0 0.1", axis="0 0 1")
    wheel = link("w", inertial(1), ROLLING), joint("axle", "continuous", "fork", "w", "-0.016 0 0")
    small = shape("sphere", 'radius="0.01"')
    roller = link("r", inertial(0.01), small), joint("rr", "continuous", "w", "r", "0.09 0 0", axis="1 0 0")
    path = wheeled.written(tmp_path, urdf(link("base", inertial(9)), *swivel, *wheel, *roller))
    (found,) = pm.MobileRobot.from_urdf(path).undercarriage.wheels
    assert (found.name, found.radius, found.axis) == ("axle", 0.1, (0, 1, 0))
    np.testing.assert_allclose(found.centre, (0.284, 0, 0.1), atol=1e-15)
    # A roller on the ground is a part of the wheel.
    text = path.read_text().replace('xyz="0.09 0 0"', 'xyz="0 0 -0.09"')
    assert "what is within 5 mm of the ground, axle, has no area" in read(tmp_path, text).source


def test_a_link_base_footprint_tells_where_the_ground_is(tmp_path: Path) -> None:
    parts = link("base", inertial(9)), link("ns/base_footprint")
    robot = read(tmp_path, urdf(*parts, joint("j", "fixed", "base", "ns/base_footprint", "0 0 -0.3")))
    assert robot.com == (0, 0, 0.3)
    assert "ground at its link ns/base_footprint, at z = -0.3 m" in robot.source
    model = pin.buildModelFromXML(wheeled.mp400())
    assert pm.MobileRobot.from_model(model).grounded
    assert pm.MobileRobot.from_model(model, ground=-0.0025).com[2] == pytest.approx(0.0145135, abs=1e-7)


# Robots made from numbers, and what is kept


def test_a_robot_made_from_numbers_is_its_size() -> None:
    robot = pm.MobileRobot(30, 1.3, size=(0.8, 0.6, 0.3))
    stands_on(robot, box(0.4, 0.3), 0)
    assert (robot.top, robot.grounded, robot.locked_joints) == (0.3, True, ())
    assert robot.mount("ur5").mounts[0].at == (0, 0, 0.3, 0)
    assert "wheels" not in repr(robot)


def test_locked_wheels_are_told(tmp_path: Path) -> None:
    robot = read(tmp_path, wheeled.jackal())
    said = "wheels locked: they do not roll, and it can be pushed sideways"
    assert said in robot.source
    assert repr(robot).endswith(f" with {said}")
    assert repr(robot.mount("ur5")).endswith(f" with {said}")


TEXTS: dict[str, Callable[[], str]] = {"husky": wheeled.husky, "fetch": wheeled.fetch}


@pytest.mark.parametrize("name", TEXTS)
def test_how_it_stands_survives_all_that_keeps_a_robot(tmp_path: Path, name: str) -> None:
    robot = read(tmp_path, TEXTS[name]())
    assert read(tmp_path, robot.to_urdf()) == robot
    assert read(tmp_path, robot.to_urdf()).stance == robot.stance
    arm = robot.mount("ur5", (0, 0, 0.5, 0)).attach(pm.PayloadBody(1.0))
    for same in (pickle.loads(pickle.dumps(arm)), arm.with_locked_arms(), arm.base):
        assert same.stance == robot.stance
        assert same.locked_joints == robot.locked_joints
    run = pm.simulate(robot, pm.ComputedTorque(robot), pm.Tangent(pm.Circle(1, 0.5, 1)), dt=0.1)
    run.save(tmp_path / "run.npz")
    kept = pm.Rollout.load(tmp_path / "run.npz").plant
    assert kept == robot
    assert repr(kept) == repr(robot)


@pytest.mark.parametrize("words", ['top="a"', 'footprint="0 0 1 0"'])
def test_a_damaged_note_of_our_own_is_refused(tmp_path: Path, words: str) -> None:
    text = pm.MobileRobot.box().to_urdf().replace("</robot>", f'<pinmobile ground="0" {words}/></robot>')
    with refused(r"pinmobile|footprint"):
        read(tmp_path, text)


# What is drawn stands on the grid
