"""URDFs that are no tree, or whose numbers are none: refused before Pinocchio reads them."""

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pinmobile import InvalidArgument, MobileRobot
from pinmobile.arrays import Array
from tests.test_model_import import joint, link, robot, saved

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
