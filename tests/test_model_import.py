"""What `MobileRobot.from_urdf` and `from_model` take and refuse, damaged files too."""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pinmobile import InvalidArgument, MobileRobot
from pinmobile.arrays import Array
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE
from tests import wheeled
from tests.wheeled import inertial, robot


def link(name: str, mass: float = 0, com: str = "0 0 0", rpy: str = "0 0 0", i: str = "1 0 0 1 0 1") -> str:
    return wheeled.link(name, *[inertial(mass, com, rpy, i)] * bool(mass))


def joint(
    name: str, kind: str, parent: str, child: str, axis: str = "0 0 1", xyz: str = "0 0 0", rpy: str = "0 0 0"
) -> str:
    limit = '<limit lower="-9" upper="9" effort="9" velocity="9"/>'
    return wheeled.joint(name, kind, parent, child, xyz, rpy, axis, limit)


saved = partial(wheeled.written, name="robot.urdf")


def chain(*joints: str, masses: tuple[float, float, float] = (0, 0, 5)) -> str:
    names = ("one", "two", "body")
    return robot(link("world"), *map(link, names, masses), *joints)


SLIDES = (
    joint("slide_left", "prismatic", "world", "one", "0 1 0"),
    joint("slide_forward", "prismatic", "one", "two", "1 0 0"),
    joint("turn", "revolute", "two", "body", "0 0 1"),
)


@pytest.mark.parametrize("table", [LECTURE_TABLE, SLIDE_TABLE])
def test_a_written_robot_is_read_back_to_the_last_digit(tmp_path: Path, table: object) -> None:
    original = MobileRobot(1 / 3, 0.1, com=(0.1, 0.2, 0.3), size=(0.7, 0.5, 0.11), dh=table)  # type: ignore[arg-type]
    read = MobileRobot.from_urdf(saved(tmp_path, original.to_urdf()))
    assert read == original
    assert read.source.startswith("robot.urdf is the chain (y, x, psi); mass 0.333333 kg")


@pytest.mark.parametrize("last", ["revolute", "continuous"])
def test_a_chain_of_other_names_and_frames_is_the_chain(tmp_path: Path, last: str) -> None:
    parts = (*SLIDES[:2], joint("turn", last, "two", "body", "0 0 1", xyz="0 0 0.3"))
    read = MobileRobot.from_urdf(saved(tmp_path, chain(*parts)))
    assert (read.mass, read.yaw_inertia, read.com) == (5, 1, (0, 0, 0.3))
    assert "is the chain (slide_left, slide_forward, turn)" in read.source
    assert read.model.nq == 3


def test_joints_turned_by_their_frames_are_judged_by_the_axes_in_the_ground_frame(tmp_path: Path) -> None:
    quarter = "0 0 1.5707963267948966"
    parts = (
        joint("slide_left", "prismatic", "world", "one", "1 0 0", rpy=quarter),
        joint("slide_forward", "prismatic", "one", "two", "0 -1 0"),
        joint("turn", "revolute", "two", "body", "0 0 1"),
    )
    text = robot(
        link("world"), link("one"), link("two"), link("body", 5, "0.2 0 0", i="1 0 0 2 0 2.5"), *parts
    )
    read = MobileRobot.from_urdf(saved(tmp_path, text))
    # At rest the file's last frame points along +y, and B along +x.
    np.testing.assert_allclose(read.com, (0, 0.2, 0), atol=1e-15)
    np.testing.assert_allclose(np.diag(read.body.inertia), (2, 1, 2.5), atol=1e-14)


WRONG = {
    "x before y": (
        chain(
            joint("px", "prismatic", "world", "one", "1 0 0"),
            joint("py", "prismatic", "one", "two", "0 1 0"),
            joint("rz", "revolute", "two", "body", "0 0 1"),
        ),
        "joint 'px' is prismatic along (1, 0, 0), expected a prismatic joint along (0, 1, 0)",
    ),
    "turn to the right": (
        chain(*SLIDES[:2], joint("turn", "revolute", "two", "body", "0 0 -1")),
        "joint 'turn' is revolute along (0, 0, -1), expected a revolute joint along (0, 0, 1)",
    ),
    "turn away from the origin": (
        chain(*SLIDES[:2], joint("turn", "revolute", "two", "body", "0 0 1", xyz="0.1 0 0")),
        "the axis of joint 'turn' does not pass through the origin",
    ),
    "mass on a virtual link": (
        chain(*SLIDES, masses=(0, 2, 5)),
        "joint 'slide_forward' moves a link of 2 kg, expected a massless virtual link",
    ),
    "an arm": (
        robot(
            link("base", 5),
            link("upper", 1),
            link("lower", 1),
            joint("shoulder", "revolute", "base", "upper"),
            joint("elbow", "revolute", "upper", "lower"),
        ),
        "joint 'shoulder' (JointModelRZ) is neither a wheel",
    ),
    "an impossible body": (
        robot(link("base", 5, i="1 0 0 1 0 3")),
        "inertia has principal moments (1, 1, 3) kg m^2, which no rigid body has",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_neither_chain_nor_base_is_refused_by_its_joint(tmp_path: Path, case: str) -> None:
    urdf, text = WRONG[case]
    with pytest.raises(InvalidArgument) as caught:
        MobileRobot.from_urdf(saved(tmp_path, urdf))
    assert str(caught.value).startswith("robot.urdf: ")
    assert text in str(caught.value)


def base(wheel: str = "continuous") -> str:
    """Return a base like a Ridgeback: rotated inertial frame, fixed links, a rocker, wheels."""
    turned = "1.5707963267948966 0 1.5707963267948966"
    return robot(
        link("base_link"),
        link("chassis", 160, "0.012 0.002 0.067", turned, "4.47 0.03 0.004 7.16 0.12 4.61"),
        link("imu", 0.5, i="1e-3 0 0 1e-3 0 1e-3"),
        link("rocker", 10, i="0.4 0 0 0.03 0 0.4"),
        *(link(f"wheel_{k}", 2.3, i="0.003 0 0 0.006 0 0.003") for k in range(4)),
        joint("base_joint", "fixed", "base_link", "chassis"),
        joint("imu_joint", "fixed", "chassis", "imu", xyz="0.2 -0.3 0.17"),
        joint("rocker_joint", "revolute", "chassis", "rocker", "1 0 0", xyz="0.32 0 0.05"),
        *(
            joint(f"wheel_{k}_joint", wheel, "rocker", f"wheel_{k}", "0 1 0", xyz=f"0 {side} 0")
            for k, side in enumerate((0.27, -0.27))
        ),
        *(
            joint(f"wheel_{k}_joint", wheel, "chassis", f"wheel_{k}", "0 1 0", xyz=f"-0.32 {side} 0.05")
            for k, side in ((2, 0.27), (3, -0.27))
        ),
    )


def by_hand() -> tuple[float, Array, Array]:
    """Return mass, centre of mass and inertia of `base`, body by body with Steiner's theorem."""
    R = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # RotZ(90) RotX(90)
    chassis = np.array([[4.47, 0.03, 0.004], [0.03, 7.16, 0.12], [0.004, 0.12, 4.61]])
    wheel = np.diag([0.003, 0.006, 0.003])
    parts: list[tuple[float, tuple[float, ...], Array]] = [
        (160, (0.012, 0.002, 0.067), R @ chassis @ R.T),
        (0.5, (0.2, -0.3, 0.17), np.eye(3) * 1e-3),
        (10, (0.32, 0, 0.05), np.diag([0.4, 0.03, 0.4])),
        *((2.3, (x, y, 0.05), wheel) for x in (0.32, -0.32) for y in (0.27, -0.27)),
    ]
    mass = sum(m for m, _, _ in parts)
    com = np.sum([m * np.array(c) for m, c, _ in parts], axis=0) / mass
    inertia = np.zeros((3, 3))
    for m, c, about in parts:
        d = np.array(c) - com
        inertia += about + m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, com, inertia


def test_a_bare_base_is_put_on_the_chain_with_its_wheels_locked(tmp_path: Path) -> None:
    read = MobileRobot.from_urdf(saved(tmp_path, base()))
    mass, com, inertia = by_hand()
    assert read.mass == pytest.approx(mass, rel=1e-14)
    np.testing.assert_allclose(read.com, com, atol=1e-14)
    np.testing.assert_allclose(read.body.inertia, inertia, atol=1e-12)
    # The chassis's yaw inertia is the file's iyy: its inertial frame is turned.
    assert read.yaw_inertia > 7.16
    assert "is a bare base, put on the chain" in read.source
    assert "locked at rest: rocker_joint, wheel_0_joint, wheel_1_joint" in read.source
    assert read.nv == 3


def test_a_wheel_may_hang_on_suspension_and_steering() -> None:
    parts = (
        joint("spring", "prismatic", "base", "one", "0 0 1"),
        joint("steer", "revolute", "one", "two", "0 0 1"),
        joint("roll", "continuous", "two", "wheel", "0 1 0"),
    )
    links = (link("base", 5), link("one", 1), link("two", 1), link("wheel", 1))
    read = MobileRobot.from_model(pin.buildModelFromXML(robot(*links, *parts)))
    assert read.mass == 8
    assert "locked at rest: spring, steer, roll" in read.source


def changed(old: str, new: str) -> str:
    """Return a robot of two links, with another text in the second one."""
    return robot(link("a", 5), link("b", 1).replace(old, new), joint("j", "fixed", "a", "b"))


def test_the_users_model_is_left_alone() -> None:
    model = pin.buildModelFromXML(chain(*SLIDES))
    copy = model.copy()
    assert MobileRobot.from_model(model).model is not model
    assert model == copy


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (None, "which cannot be read"),
        ("<robot", "is not well-formed XML"),
        ("<gazebo/>", "is not a URDF: expected a <robot> with links, got <gazebo>"),
        (robot(link("a"), link("a")), "has the link 'a' twice"),
        (robot(link("a"), joint("j", "hinge", "a", "a")), "joint 'j' has type 'hinge', expected one"),
        (robot(link("a"), joint("j", "fixed", "a", "b")), "joint 'j' has child link 'b', which is not in"),
        (changed('value="1"', 'value="${m}"'), "link 'b' has <mass> with value '${m}', expected a finite"),
        (changed("<mass", "<ms"), "link 'b' has an <inertial> without <mass>, expected both"),
    ],
)
def test_a_missing_or_malformed_file_is_refused(tmp_path: Path, content: str | None, text: str) -> None:
    path = tmp_path / "missing.urdf" if content is None else saved(tmp_path, content)
    with pytest.raises(InvalidArgument) as caught:
        MobileRobot.from_urdf(path)
    assert text in str(caught.value)
    assert path.name in str(caught.value)


def test_mesh_folders_that_are_not_there_are_refused(tmp_path: Path) -> None:
    path = saved(tmp_path, base())
    with pytest.raises(InvalidArgument, match="package_dirs has 'nowhere', expected a folder"):
        MobileRobot.from_urdf(path, package_dirs=["nowhere"])


# -- uRDFs that are no tree, or whose numbers are none ---------------------------------------------


BOX = MobileRobot.box()


def series(count: int, kind: str = "fixed") -> str:
    """Return links one on the other."""
    names = [f"l{k}" for k in range(count + 1)]
    joints = (joint(f"j{k}", kind, names[k], names[k + 1]) for k in range(count))
    return robot(*(link(name, 1) for name in names), *joints)


def looped(*pairs: str) -> str:
    """Return links a, b, c, d, each pair of them joined, the second to the first."""
    joints = (joint(f"j{k}", "fixed", *pair) for k, pair in enumerate(pairs))
    return robot(*map(link, "abcd", (1, 1, 1, 1)), *joints)


REFUSED = {
    "itself": (looped("ab", "ac", "dd"), "link 'd' is its own ancestor, by way of 'd', expected a tree"),
    "loop": (looped("ab", "cd", "dc"), "link 'c' is its own ancestor, by way of 'd', expected a tree"),
    "all in a loop": (looped("ab", "bc", "cd", "da"), "link 'a' is its own ancestor, by way of 'd'"),
    "two parents": (
        looped("ab", "cb", "cd"),
        "joint 'j1' has child link 'b', which is already a child of 'a'",
    ),
    "roots": (
        robot(*(link(f"l{k}", 1) for k in range(1000))),
        "has root links ['l0', 'l1', 'l2', 'l3', 'l4'] and 995 more, expected one",
    ),
}


@pytest.mark.once
@pytest.mark.parametrize("mounted", [False, True])
@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_tree_is_refused_before_pinocchio_reads_it(
    case: str, mounted: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def crashed(_: str) -> None:
        raise AssertionError("Pinocchio was given it")

    monkeypatch.setattr(pin, "buildModelFromXML", crashed)
    text, message = REFUSED[case]
    path = saved(tmp_path, text)
    with pytest.raises(InvalidArgument) as caught:
        BOX.mount(path) if mounted else MobileRobot.from_urdf(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith("robot.urdf")
    assert len(str(caught.value)) < 10_000


NUMBERS = """<robot name="r">
<link name="a">
<inertial><origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/><mass value="2.5"/>
<inertia ixx="1.5" ixy="0.1" ixz="0.2" iyy="1.25" iyz="0.3" izz="1.75"/></inertial>
<visual><origin xyz="0 0.5 1" rpy="0.1 0 0"/><geometry><box size="1 2 1.5"/></geometry>
<material name="m"><color rgba="0.5 1 0.25 1"/></material></visual>
<visual><geometry><cylinder radius="0.5" length="2.5"/></geometry></visual>
<collision><origin xyz="0 0.5 1" rpy="0.1 0 0"/><geometry><sphere radius="0.5"/></geometry></collision>
</link>
<link name="b"><inertial><mass value="1.5"/>
<inertia ixx="1.5" ixy="0.1" ixz="0.2" iyy="1.25" iyz="0.3" izz="1.75"/></inertial></link>
<joint name="j" type="revolute"><origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/><axis xyz="0 0.5 1"/>
<parent link="a"/><child link="b"/><limit lower="-1.5" upper="1.5" effort="10.5" velocity="2.5"/>
<dynamics damping="0.5" friction="0.25"/></joint>
</robot>"""
SPELLED = list(re.finditer(r'(\w+)="([-\d. ]+)"', NUMBERS))


def respelled(number: "re.Match[str]", text: str) -> str:
    return NUMBERS[: number.start(2)] + text + NUMBERS[number.end(2) :]


def all_of(path: Path) -> list[tuple[float, ...]]:
    """Return whatever a robot with an arm has from the arm's file, what is drawn included."""
    made = BOX.mount(path, at=(0, 0, 0.3, 0))
    q = np.array([0, 0, 0, 0.3])
    kept: list[Array] = [made.mass_matrix(q), made.frame_pose(q), made.lower, made.upper, made.effort_limit]
    kept += [made.velocity_limit, made.joint_damping, made.joint_friction]
    for item in made.visual_model.geometryObjects:
        kept += [item.placement.homogeneous, item.meshColor]
    return [tuple(map(float, array.flat)) for array in kept]


@pytest.mark.filterwarnings("ignore:robot.urdf. damping and friction")
@pytest.mark.parametrize("number", SPELLED, ids=[f"{k}-{m[1]}" for k, m in enumerate(SPELLED)])
def test_a_number_is_read_however_it_stands_or_named_and_no_part_is_dropped(
    number: "re.Match[str]", tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    right = all_of(saved(tmp_path, NUMBERS))
    words = number[2].split()
    for same in (f" {number[2]} ", "&#9;".join(["", *words, "&#10;"]), "  ".join(f"{w}e0" for w in words)):
        assert all_of(saved(tmp_path, respelled(number, same))) == right
    for wrong in ("1_0", "\u0663", "0x10", "nan", "inf", "1e400", "x", ""):  # Python's float takes some
        path = saved(tmp_path, respelled(number, " ".join([*words[:-1], wrong])))
        for read in (MobileRobot.from_urdf, BOX.mount):
            with pytest.raises(InvalidArgument, match=r"^robot\.urdf: (link '[ab]'|joint 'j') has .* finite"):
                read(path)
    for wrong in (",".join([*words, "0"]), f"{number[2]} 0"):
        with pytest.raises(InvalidArgument, match=r"expected (a finite number|[34] finite numbers)$"):
            BOX.mount(saved(tmp_path, respelled(number, wrong)))
    assert capfd.readouterr().err == ""  # nor does another library say anything


def test_what_pinocchio_is_given_is_what_was_checked(tmp_path: Path) -> None:
    # Two parsers that differ in what a comment or a section of text is would read two robots.
    text = series(2).replace("</robot>", "<!-- > --><![CDATA[</robot><link name='x'/>]]></robot>")
    assert MobileRobot.from_urdf(saved(tmp_path, text)) == MobileRobot.from_urdf(saved(tmp_path, series(2)))
