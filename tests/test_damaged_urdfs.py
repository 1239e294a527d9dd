"""URDFs that are too large, no tree, or damaged: refused before they end the process."""

import re
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pinmobile import InvalidArgument, MobileRobot
from pinmobile.arrays import Array
from pinmobile.robot import wellformed
from tests.memory import PEAK
from tests.test_robot_reading import joint, link, robot, saved

BOX = MobileRobot.box()


def series(count: int, kind: str = "fixed") -> str:
    """Return links one on the other."""
    names = [f"l{k}" for k in range(count + 1)]
    joints = (joint(f"j{k}", kind, names[k], names[k + 1]) for k in range(count))
    return robot(*(link(name, 1) for name in names), *joints)


def abreast(count: int, kind: str = "fixed", mass: float = 0) -> str:
    """Return links side by side on one."""
    names = [f"l{k}" for k in range(count)]
    joints = (joint(f"j{name}", kind, "root", name) for name in names)
    return robot(link("root", 1), *(link(name, mass) for name in names), *joints)


def looped(*pairs: str) -> str:
    """Return links a, b, c, d, each pair of them joined, the second to the first."""
    joints = (joint(f"j{k}", "fixed", *pair) for k, pair in enumerate(pairs))
    return robot(*map(link, "abcd", (1, 1, 1, 1)), *joints)


def nested(count: int) -> str:
    return robot(link("a", 1), "<x>" * count, "</x>" * count)


LAUGHS = '<!DOCTYPE r [<!ENTITY a0 "ha">{}]><robot name="&a9;"><link name="a"/></robot>'.format(
    "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(9))
)

REFUSED = {
    "series": (series(4000), "has 4001 links, expected at most 2000"),
    "deep": (series(101), "link 'l101' has 101 joints in series, expected at most 100"),
    "deep and moving": (
        series(101, "continuous"),
        "link 'l101' has 101 joints in series, expected at most 100",
    ),
    "links": (abreast(2000), "has 2001 links, expected at most 2000"),
    "joints": (
        robot(link("a", 1), *(joint(f"j{k}", "fixed", "a", "b") for k in range(2001))),
        "has 2001 joints, expected at most 2000",
    ),
    "elements": (robot(link("a", 1), "<x/>" * 60_000), "has 50001 elements"),
    "freedom": (
        abreast(201, "continuous", 1),
        "has 201 degrees of freedom, expected at most 200: make joints",
    ),
    "floating": (abreast(34, "floating", 1), "has 204 degrees of freedom, expected at most 200"),
    "visuals": (
        robot(link("a", 1).replace("</link>", "<visual/>" * 1001 + "</link>")),
        "has 1001 visuals, expected at most 1000",
    ),
    "nested": (nested(10_000), "has 65 elements in one another"),
    "bytes": (robot(link("a", 1), "<!--", "x" * (8 << 20), "-->"), "has 8388609 bytes"),
    "name": (robot(link("a" * 5000, 1)), "<link>: 'name' has 5004 letters, expected at most 4096"),
    "key": (robot(f'<link {"a" * 5000}="1"/>'), "expected at most 4096"),
    "attributes": (
        robot(link("a", 1), "<x ", *(f'a{k}="1" ' for k in range(300_000)), "/>"),
        "<x> has 300000 attributes, expected at most 64",
    ),
    "laughs": (LAUGHS, "declares a document type, which no URDF needs"),
    "itself": (looped("ab", "ac", "dd"), "joint 'j2' has link 'd' as its parent and its child"),
    "loop": (looped("ab", "cd", "dc"), "link 'c' hangs on itself, by way of 'd', expected one root"),
    "all in a loop": (looped("ab", "bc", "cd", "da"), "link 'a' hangs on itself, by way of 'd'"),
    "two parents": (looped("ab", "cb", "cd"), "joint 'j1' has child link 'b', which hangs on 'a' already"),
    "roots": (
        robot(*(link(f"l{k}", 1) for k in range(1000))),
        "has root links ['l0', 'l1', 'l2', 'l3', 'l4'] and 995 more, expected one",
    ),
}


@pytest.mark.once
@pytest.mark.alike
@pytest.mark.parametrize("mounted", [False, True])
@pytest.mark.parametrize("case", REFUSED)
def test_what_is_too_large_or_no_tree_is_refused_before_pinocchio_reads_it(
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


@pytest.mark.alike
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


def test_a_file_that_has_grown_deep_since_is_not_drawn(tmp_path: Path) -> None:
    path = saved(tmp_path, series(3))
    base, arm = MobileRobot.from_urdf(path), BOX.mount(saved(tmp_path, series(3, "revolute")))
    path.write_text(series(101))
    for made in (base, arm):
        with pytest.raises(InvalidArgument, match="101 joints in series"):
            _ = made.visual_model


def test_what_pinocchio_is_given_is_what_was_checked(tmp_path: Path) -> None:
    # Two parsers that differ in what a comment or a section of text is would read two robots.
    text = series(2).replace("</robot>", "<!-- > --><![CDATA[</robot><link name='x'/>]]></robot>")
    assert MobileRobot.from_urdf(saved(tmp_path, text)) == MobileRobot.from_urdf(saved(tmp_path, series(2)))


def test_a_mounted_mass_whose_moments_are_beyond_all_numbers_is_refused(tmp_path: Path) -> None:
    path = saved(
        tmp_path, robot(link("a", 1e308, com="9 0 0"), link("b", 1), joint("j", "revolute", "a", "b"))
    )
    with pytest.raises(InvalidArgument, match=r"mass matrix is beyond 1.8e308"):
        BOX.mount(path)


def test_the_bounds_that_are_stated_are_those_that_hold() -> None:
    stated = " ".join((MobileRobot.from_urdf.__doc__ or "").split())
    assert (
        f"more than {wellformed._MOST_BYTES >> 20} MiB, {wellformed._MOST_ELEMENTS:,} elements, "
        f"{wellformed._MOST_LINKS} links, {wellformed._MOST_SHAPES} visuals, "
        f"{wellformed._MOST_FREEDOM} degrees of freedom, or "
        f"{wellformed._MOST_IN_SERIES} joints in series"
    ) in stated
    assert f"more than {wellformed._MOST_FREEDOM} degrees" in (MobileRobot.from_model.__doc__ or "")


def test_models_have_no_more_freedom_than_files() -> None:
    model = pin.Model()
    for k in range(201):
        model.appendBodyToJoint(
            model.addJoint(0, pin.JointModelRUBZ(), pin.SE3.Identity(), f"j{k}"),
            pin.Inertia.Random(),
            pin.SE3.Identity(),
        )
    for call in (MobileRobot.from_model, BOX.mount):
        with pytest.raises(InvalidArgument, match="has 201 degrees of freedom, expected at most 200"):
            call(model)


def test_as_many_as_are_allowed_are_read_in_a_thread_with_a_small_stack(tmp_path: Path) -> None:
    # A quarter of a megabyte, where threads have half of one or more; Pinocchio's parser recurses.
    for name, text in {"series": series(100, "continuous"), "abreast": abreast(1999, mass=1)}.items():
        (tmp_path / f"{name}.urdf").write_text(text)
    script = """
        import sys, threading
        from pinmobile import MobileRobot
        def read():
            read = MobileRobot.from_urdf("abreast.urdf")
            read.visual_model
            print(read.mass)
            arm = MobileRobot.box().mount("series.urdf")
            arm.visual_model
            print(arm.mass_matrix(arm.rest).shape)
        threading.stack_size(256 << 10)
        thread = threading.Thread(target=read)
        thread.start()
        thread.join()
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "2000.0\n(103, 103)\n", "")


TRIANGLE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="f" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common>
<accessor source="#f" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>"""


@pytest.mark.alike
@pytest.mark.parametrize(
    ("indices", "drawn"),
    [
        ("0 1 2", True),
        (" 0\n+1\t2 ", True),
        ("0 x 2", False),
        ("0 1 2<!-- --> ", False),
        ("<![CDATA[0 x 2]]>", False),
        ("&#x78;", False),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_mesh_that_would_be_read_for_ever_is_named_and_not_drawn(
    indices: str, drawn: bool, encoding: str, tmp_path: Path
) -> None:
    (tmp_path / "a.dae").write_text(
        TRIANGLE.replace("0 1 2", indices).replace('"1.0"', f'"1.0" encoding="{encoding}"', 1),
        encoding=encoding,
    )
    mesh = '<visual><geometry><mesh filename="a.dae"/></geometry></visual></link>'
    saved(tmp_path, robot(link("a", 1).replace("</link>", mesh)))
    script = f"""
        import resource, warnings
        from pinmobile import MobileRobot
        resource.setrlimit(resource.RLIMIT_AS, ({4 << 30}, {4 << 30}))
        read = MobileRobot.from_urdf("robot.urdf")
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            shown = read.visual_model.geometryObjects
        print([item.name for item in shown], *(warning.message for warning in told))
        print(peak() < {1 << 20})
    """
    done = subprocess.run(
        [sys.executable, "-c", PEAK + textwrap.dedent(script)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.endswith("\nTrue\n")
    assert done.stdout.startswith(
        "['a_0']" if drawn and encoding == "utf-8" else "['body', 'front', 'wedge']"
    )
    assert ("not drawn, since damaged" in done.stdout) is not (drawn and encoding == "utf-8")


@pytest.mark.parametrize("first", range(0, 300, 150))
def test_a_damaged_file_is_refused_or_a_robot_of_finite_numbers(first: int) -> None:
    command = [sys.executable, "-m", "tests.damaged_urdfs", str(first), str(first + 150)]
    # The limit is there for what never ends.
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    said = done.stdout.partition(f"seed {first + 149}\n")
    assert done.returncode == 0, f"exit {done.returncode} at the last of these:\n{done.stdout[-3000:]}"
    assert said[1]
    assert said[2] == ""
