"""`pinmobile mount`, and how rollouts and figures name the joints of arms."""

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pinmobile import (
    Circle,
    ComputedTorque,
    FixedHeading,
    Hold,
    InvalidArgument,
    MobileRobot,
    Rollout,
    WholeBody,
    mountable,
    plots,
    required_friction,
    simulate,
    tip_over_margin,
)
from pinmobile.cli.mount import _judged, demonstration, mounted
from pinmobile.robot import EXCEPTIONS
from tests.test_cli import typed

pytestmark = pytest.mark.once

QUICK = ("--dt", "0.02", "--duration", "1")
SLIDE = """<robot name="slide"><link name="foot"/><link name="slider"><inertial><mass value="2"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="prismatic"><parent link="foot"/><child link="slider"/><axis xyz="0 0 1"/>
  <limit lower="-0.04" upper="0.01" effort="30" velocity="2"/></joint></robot>"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Rollout:
    """Return a run of an arm with joints without limits, as the command keeps it."""
    from pinmobile.cli import main

    folder = tmp_path_factory.mktemp("mount")
    assert main(("mount", "kinova", *QUICK, "--out", str(folder))) == 0
    names = {path.name for path in folder.iterdir()}
    figures = {f"{name}.png" for name in ("path", "states", "errors", "forces", "balance", "reaction")}
    assert names - figures == {
        *(f"{law}.{kind}" for law in ("computed-torque", "decoupled") for kind in ("npz", "csv")),
        "index.html",
    }
    assert figures < names
    index = (folder / "index.html").read_text()
    assert "x, y, psi and each joint over time, desired and actual." in index
    assert "x, y and psi" not in index
    return Rollout.load(folder / "computed-torque.npz")


def test_mount_prints_what_the_coupling_costs(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = typed(capsys, "mount", "ur5", "--at", "0.1,0,0.2,0.4", "--dt", "0.005")
    assert (code, err) == (0, "")
    assert "ur5 on a box of 30 kg: 6 joints, 51.0 kg in all, M(q) is 9 x 9" in out
    rows = {
        found[1]: (float(found[2]), float(found[3]))
        for found in re.finditer(r"^(.+?\]) +(\S+) +(\S+)$", out, re.MULTILINE)
    }
    for quantity in ("largest error in x [m]", "largest error of a joint [rad]"):
        whole, apart = rows[quantity]
        assert 0 < whole < 0.1 * apart < 1e-3
    assert rows["smallest tip-over margin [m]"][0] > 0
    assert rows["friction that it takes [-]"][0] == pytest.approx(0.03, abs=0.01)
    assert out.endswith("see it move: add --html out/mount.html; figures and records: add --out out/mount\n")


def test_mount_writes_a_page_and_says_how_large_it_is(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    page = tmp_path / "new" / "ur5.html"
    code, out, _ = typed(capsys, "mount", "ur5", *QUICK, "--html", str(page))
    assert code == 0
    assert f"recording: {page.stat().st_size / 1e6:.1f} MB\nsee it move: open {page}\n" in out
    text = page.read_text()
    assert "<title>ur5 on the base: computed torque and decoupled</title>" in text
    assert "position error, largest of a joint" in text


def test_several_arms_stand_one_behind_the_other(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = typed(capsys, "mount", "z1", "so100", *QUICK)
    assert code == 0
    assert out.lstrip().startswith("z1 and so100 on a box of 30 kg: 13 joints")
    places = [mount.at for mount in mounted(("z1", "so100")).mounts]
    assert [place[0] for place in places] == pytest.approx([0.2, -0.2])


def test_each_of_several_arms_is_put_where_it_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    words = "mount", "z1", "so100", "--at", "0.1,0,0.2,0", "--at=-0.1,0,0.2,3"
    assert typed(capsys, *words, *QUICK)[0] == 0
    places = [mount.at for mount in mounted(("z1", "so100"), at=("0.1,0,0.2,0", "-0.1,0,0.2,3")).mounts]
    assert places == [(0.1, 0, 0.2, 0), (-0.1, 0, 0.2, 3)]


def test_what_the_list_says_to_lock_can_be_locked(capsys: pytest.CaptureFixture[str]) -> None:
    fingers = re.findall(r"bravo_finger\d_joint", EXCEPTIONS["bravo7_gripper"].reason)
    assert len(fingers) == 2
    words = (word for finger in fingers for word in ("--lock", finger))
    code, out, err = typed(capsys, "mount", "bravo7_gripper", *QUICK, *words)
    assert (code, err) == (0, "")
    assert "bravo7_gripper on a box of 30 kg: 6 joints" in out


def test_mount_says_that_there_is_nothing_to_draw(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = "mount", "simple_humanoid", "--dt", "0.02", "--duration", "0.1"
    code, out, _ = typed(capsys, *words, "--html", str(tmp_path / "page.html"))
    assert code == 0
    assert "\nthere is nothing to draw of simple_humanoid: it has no visuals\n" in out
    assert "nothing to draw" not in typed(capsys, *words)[1]


def test_an_arm_of_ones_own_is_mounted(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "slide.urdf"
    path.write_text(SLIDE)
    code, out, _ = typed(capsys, "mount", "--urdf", str(path), "--package-dir", str(tmp_path), "--dt", "0.02")
    assert code == 0
    assert "slide on a box of 30 kg: 1 joint, 32.0 kg in all" in out
    assert "largest error of a joint [m]" in out
    assert "of a joint [rad]" not in out
    # There is more room below than above.
    reference = demonstration(MobileRobot.box().mount(path), 6)
    assert reference(3.0).q[3] == pytest.approx(-0.04)


def test_meshes_that_are_not_drawn_are_named_in_a_line_each(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path, page = tmp_path / "slide.urdf", tmp_path / "page.html"
    looks = '<visual><geometry><mesh filename="{}.stl"/></geometry></visual>'
    (tmp_path / "broken.stl").write_text("no mesh")
    path.write_text(SLIDE.replace("</link>", looks.format("gone") + looks.format("broken") + "</link>"))
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        code, out, err = typed(capsys, "mount", "--urdf", str(path), *QUICK, "--html", str(page))
    assert code == 0
    gone, broken = (line for line in err.splitlines() if "not drawn" in line)
    assert gone == "pinmobile: slide.urdf: not drawn, since missing: gone.stl"
    assert broken.startswith("pinmobile: slide.urdf: not drawn, since damaged or of a format")
    assert "there is nothing to draw of slide" in out


def test_verify_takes_arms(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = typed(capsys, "verify", "--mount", "z1", "--mount", "so100", "--states", "5")
    assert (code, err) == (0, "")
    assert re.search(r"^M3 +CRBA / closed form of the lump .* agrees$", out, re.MULTILINE)
    assert out.endswith("every route agrees\n")


@pytest.mark.alike
@pytest.mark.parametrize("name", mountable().names)
def test_there_is_a_demonstration_of_every_name(name: str) -> None:
    robot = MobileRobot.box().mount(name)
    reference = demonstration(robot, 6)
    start, away, back = reference((0, 3, 6)).q
    np.testing.assert_allclose(robot.difference(start, back)[3:], 0, atol=1e-12)
    way = np.abs(robot.difference(start, away)[3:])
    assert (way <= 0.5 + 1e-12).all()
    for mount, path in zip(robot.mounts, reference.joints, strict=True):
        assert isinstance(path, Hold) == (mount.v.start == mount.v.stop)
    assert not way.size or way.max() > 0.01


def test_a_demonstration_is_no_faster_than_the_slowest_slide() -> None:
    robot = MobileRobot.box().mount("pr2")
    lift = [one.name for one in robot.coordinates].index("pr2/torso_lift_joint")
    fastest = np.abs(demonstration(robot, 6)(np.linspace(0, 6, 601)).v[:, lift]).max()
    assert fastest == pytest.approx(robot.velocity_limit[lift])


def test_the_names_are_listed_with_the_exceptions(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = typed(capsys, "mount", "--list")
    assert code == 0
    assert re.search(r"^ur5 +6 +20\.99\d$", out, re.MULTILINE)
    assert re.search(r"^simple_humanoid +29 +130\.800  its loader has no visuals", out, re.MULTILINE)
    assert re.search(r"^cassie +not: its loader reads SDF", out, re.MULTILINE)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("mount", "mount needs an arm: 'pinmobile mount ur5 --html out/ur5.html'"),
        ("mount ur55", "unknown arm 'ur55', did you mean 'ur5'"),
        ("mount romeo", "joint 'RThumb3' moves parts that have no inertia"),
        ("mount ur5 --at 1,2", "at has shape (2,), expected (4,)"),
        ("mount ur5 z1 --at 0,0,0,0", "--at is given 1 times for 2 arms, expected once for each arm"),
        ("mount ur5 z1 --lock joint1", "--lock applies to one arm, but there are 2"),
        ("mount ur5 --lock elbow", "unknown joint 'elbow', did you mean 'elbow_joint'"),
        ("mount --list --lock elbow", "--lock does not apply beside --list"),
        ("mount ur5 --urdf arm.urdf", "--urdf stands for an arm, but there is 'ur5' too"),
        ("mount ur5 --package-dir x", "--package-dir applies beside --urdf alone"),
        ("mount --urdf no-such.urdf", "no-such.urdf"),
        ("mount ur5 --html out/ur5", "--html is 'out/ur5', expected a file that ends in .html"),
        ("mount ur5 --duration -1", "--duration is -1.0 s, expected > 0"),
        ("mount ur5 --html /proc/x.html", "--html is '/proc/x.html', which cannot be written to"),
        ("verify --mount ur5 --mass 3", "--mass does not apply beside --mount"),
        ("mount --list ur5", "--list stands alone, but there is 'ur5' too"),
        ("mount --list --at 0,0,0,0", "--at does not apply beside --list"),
    ],
)
def test_a_mistake_is_one_line(words: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = typed(capsys, *words.split())
    assert (code, out.strip()) == (2, "")
    assert err.startswith("pinmobile: ")
    assert err.count("\n") == 1
    assert said in err


def test_a_margin_below_zero_is_said_to_tip_over(monkeypatch: pytest.MonkeyPatch, run: Rollout) -> None:
    for margin, said in ((0.2, "0.200"), (-2.585, "-2.585, tips over"), (-np.inf, "tips over")):
        monkeypatch.setattr(
            "pinmobile.cli.mount.tip_over_margin", lambda run, margin=margin: np.array([margin])
        )
        assert _judged(run)["smallest tip-over margin [m]"] == said


def test_of_margin_and_friction_the_worst_is_said(run: Rollout) -> None:
    said = _judged(run)
    margin, friction = tip_over_margin(run), required_friction(run)
    assert said["smallest tip-over margin [m]"] == f"{margin.min():.3f}" != f"{margin.max():.3f}"
    assert said["friction that it takes [-]"] == f"{friction.max():.3f}" != f"{friction.min():.3f}"


def test_a_controller_that_diverges_is_said_and_shown_up_to_there(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, out, _ = typed(capsys, "mount", "ur5", "--dt", "0.2", "--duration", "2")
    assert code == 1
    assert "computed torque: the loop diverged at t = " in out
    assert "the table has what came before" in out


def test_view_says_why_it_does_not_know_the_robot_of_a_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, run: Rollout
) -> None:
    urdf = tmp_path / "slide.urdf"
    urdf.write_text(SLIDE)
    base = FixedHeading(Circle(1, 0.1, 1), 0)
    for stem, arm in (("gone", urdf), ("changed", urdf), ("model", run.plant.mounts[0].arm.whole)):
        robot = MobileRobot.box().mount(arm)
        motion = WholeBody(robot, base, None)
        simulate(robot, ComputedTorque(robot), motion, dt=0.5).save(tmp_path / f"{stem}.npz")
    for stem, said in (
        (
            "changed",
            "its masses and inertias are no longer those that were kept: see .*slide.urdf; in Python",
        ),
        ("gone", "arm is '.*slide.urdf', which cannot be read"),
        ("model", "it had an arm of a pin.Model, which an archive cannot keep; "),
    ):
        urdf.write_text(SLIDE.replace('mass value="2"', 'mass value="3"'))
        if stem == "gone":
            urdf.unlink()
        code, out, err = typed(capsys, "view", "--rollout", str(tmp_path / f"{stem}.npz"))
        assert (code, out) == (2, "")
        assert re.search(rf"^pinmobile: --rollout '.*{stem}.npz' does not know its robot: {said}", err)


# -- joints by their names ---------------------------------------------------------------------------


def test_a_rollout_says_the_errors_of_joints_by_name(run: Rollout) -> None:
    lines = str(run).splitlines()
    joints = lines[5 : len(lines) - len(run.events)]
    assert [line.split()[0] for line in joints] == [one.name for one in run.plant.coordinates[3:]]
    worst = int(run.max_error()[3:].argmax())
    assert f"{run.plant.coordinates[3 + worst].name} {run.max_error()[3 + worst]:.6e} rad>" in repr(run)
    unknown = replace(run, plant=None)
    joints = str(unknown).splitlines()[5 : 5 + 6]
    assert [line.split()[0] for line in joints] == [f"[{k}]" for k in range(3, 9)]


def test_the_columns_of_a_record_are_joints(run: Rollout, tmp_path: Path) -> None:
    run.to_csv(tmp_path / "run.csv")
    header = (tmp_path / "run.csv").read_text().splitlines()[0].split(",")
    first = run.plant.coordinates[3].name
    assert header[:5] == ["t [s]", "x [m]", "y [m]", "psi [rad]", f"{first} [rad]"]
    assert f"v_{first} [rad/s]" in header
    assert len(header) == len(set(header)) == 1 + 6 * 9


def test_coordinates_have_units(run: Rollout) -> None:
    robot = MobileRobot.box().mount("panda")
    assert tuple(one.unit for one in robot.coordinates) == ("m", "m", *["rad"] * 8, "m", "m")
    assert len(run.plant.coordinates) == run.plant.nq == 9


def test_figures_name_joints_and_unwrap_their_angles(run: Rollout) -> None:
    panels = plots.states({"a": run, "b": run}).axes
    assert [axes.get_title(loc="left") for axes in panels[2:5]] == [
        r"$\psi$",
        "j2s6s200 joint 1",
        "j2s6s200 joint 2",
    ]
    assert [axes.get_ylabel() for axes in panels[:4]] == ["[m]", "[m]", "[rad]", "[rad]"]
    assert [axes.get_ylabel() for axes in plots.forces(run).axes[2:4]] == ["[N m]", "[N m]"]
    drawn = panels[3].lines[0].get_ydata()
    # The angle goes away and back, as far as the joint's speed allows.
    assert np.ptp(np.asarray(drawn)) == pytest.approx(run.plant.velocity_limit[3] * 0.5 / 1.5, abs=1e-2)
    assert len(plots.errors({"a": run, "b": run}).axes) == 18
    two = plots.states({"a": replace(run, plant=None)}).axes
    assert [axes.get_title(loc="left") for axes in two[3:5]] == ["[3]", "[4]"]


def test_mounted_refuses_nothing_at_all() -> None:
    with pytest.raises(InvalidArgument, match="mount needs an arm"):
        mounted(())


@pytest.mark.parametrize("arm", ["ur5", "panda", "kinova"])
def test_the_demonstration_lifts_the_arm_rather_than_pressing_it_into_the_base(arm: str) -> None:
    robot = mounted([arm])
    reference = demonstration(robot, 6.0)
    heights = robot.potential_energy(reference(np.array([0.0, 3.0, 6.0])).q)
    assert heights[1] > heights[0] + 1.0
    assert heights[2] == pytest.approx(heights[0])
