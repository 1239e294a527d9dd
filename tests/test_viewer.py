"""The viewer: what it records and shows is where the rollout says, in a real browser without a screen."""

import io
import math
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pytest
from PIL import Image, ImageColor

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE
from pinmobile.errors import ViewerError
from pinmobile.palette import colour
from pinmobile.viewer import Arrows, FixedCamera, Follow, Overlays, Recording, Viewer
from pinmobile.viewer.recording import Browser, gif as encoded_gif
from pinmobile.viewer.scene_tree import Stage, simplify
from tests.chromium import Chromium, Page

pytestmark = pytest.mark.once

BLUE = ImageColor.getrgb(colour(0))[:3]


Runs = dict[str, pm.Rollout]


@pytest.fixture(scope="module")
def runs() -> Runs:
    """Return the lecture's circle with PD and with computed torque."""
    robot, reference = pm.MobileRobot.lecture(), pm.Tangent(pm.Circle(3, 0.1, 60))
    pd = pm.simulate(robot, pm.PD((120, 120, 0.4), (120, 120, 0.4)), reference, dt=0.1)
    return {"PD": pd, "computed torque": pm.simulate(robot, pm.ComputedTorque(robot), reference, dt=0.1)}


@pytest.fixture(scope="module")
def apart() -> Runs:
    """Return a good and a bad controller, whose robots can be told apart by eye."""
    robot = pm.MobileRobot.box()
    reference = pm.Tangent(pm.CubicVia((0, 0), (2, 2), (0, 4), 10, 20))
    return {
        "good": pm.simulate(robot, pm.ComputedTorque(robot), reference, dt=0.05),
        "bad": pm.simulate(robot, pm.PD(3, 9), reference, dt=0.05),
    }


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    with Viewer(pm.MobileRobot.lecture()) as made:
        yield made


@pytest.fixture
def page(browser: Chromium) -> Iterator[Page]:
    """Return a page; whatever the test does, it must not complain nor ask anybody but this machine."""
    opened = browser.page(900, 600)
    yield opened
    assert opened.errors == []
    assert opened.console == []
    asked = [url for url in opened.requests if not url.startswith(("data:", "blob:", "file://"))]
    assert all(re.match(r"(http|ws)://127\.0\.0\.1:\d+/", url) for url in asked)
    opened.close()


def opened(page: Page, recording: Recording, folder: Path) -> Page:
    page.open(recording.save_html(folder / "scene.html").as_uri())
    page.wait_for("pinmobile.ready()")
    return page


def projected(page: Page, point: tuple[float, float, float]) -> tuple[float, float]:
    """Return the pixel at which the page's own camera sees a point."""
    x, y = page.evaluate(
        "(() => { viewer.camera.updateMatrixWorld(); viewer.camera.updateProjectionMatrix();"
        f"const p = new MeshCat.THREE.Vector3({point[0]}, {point[2]}, {-point[1]}).project(viewer.camera);"
        "return [(p.x + 1) / 2 * innerWidth, (1 - p.y) / 2 * innerHeight]; })()"
    )
    return x, y


def sees(page: Page, shade: tuple[int, int, int], near: tuple[float, float]) -> bool:
    """Tell whether pixels about there have the hue of a colour, lit or in the shade."""
    (x, y), wanted = map(round, near), np.array(shade, np.float64)
    picture = page.screenshot().crop((x - 4, y - 4, x + 5, y + 5))
    pixels = np.asarray(picture).astype(np.float64).reshape(-1, 3)
    length = np.linalg.norm(pixels, axis=1) * np.linalg.norm(wanted)
    return bool((pixels @ wanted / np.maximum(length, 1) > 0.985).mean() > 0.5)


def tracks(recording: Recording) -> dict[tuple[str, str], dict[str, Any]]:
    return {
        (animation["path"], track["name"]): track
        for animation in recording.tracks
        for track in animation["clip"]["tracks"]
    }


def pose(run: pm.Rollout, t: float) -> Array:
    return np.array([np.interp(t, run.t, column) for column in run.q.T])


def side(robot: pm.MobileRobot, at: Array) -> tuple[float, float, float]:
    """Return a point of the box's top, beside the wedge: near its left rear corner."""
    length, width, height = robot.size
    x, y = -0.35 * length, 0.3 * width
    cos, sin = math.cos(at[2]), math.sin(at[2])
    return at[0] + cos * x - sin * y, at[1] + sin * x + cos * y, height


# Recorded


def test_a_recordings_tracks_are_the_rollouts_poses(viewer: Viewer, runs: Runs) -> None:
    recording = viewer.record(runs, fps=10)
    for index, run in enumerate(runs.values()):
        moved = tracks(recording)[f"meshcat/robot{index}", ".position"]
        turned = tracks(recording)[f"meshcat/robot{index}", ".quaternion"]
        np.testing.assert_allclose(moved["times"], run.t, atol=1e-4)
        xyz = np.reshape(moved["values"], (-1, 3))
        np.testing.assert_allclose(xyz[:, :2], run.q[:, :2], atol=6e-6)
        assert not xyz[:, 2].any()
        x, y, z, w = np.reshape(turned["values"], (-1, 4)).T
        assert not x.any()
        assert not y.any()
        np.testing.assert_allclose(np.unwrap(2 * np.arctan2(z, w), period=4 * np.pi), run.q[:, 2], atol=3e-6)


def test_frames_are_where_the_tables_say(viewer: Viewer, runs: Runs) -> None:
    run = runs["PD"]
    found = tracks(viewer.record(run, fps=10, overlays=Overlays(frames=(LECTURE_TABLE, SLIDE_TABLE))))
    for number, table, k in (
        (0, LECTURE_TABLE, 1),
        (0, LECTURE_TABLE, 2),
        (1, SLIDE_TABLE, 2),
        (0, LECTURE_TABLE, 3),
    ):
        placements = table.placements(run.q[:, [1, 0, 2]])[:, k - 1]
        moved = np.reshape(found[f"meshcat/table{number}/{k}", ".position"]["values"], (-1, 3))
        np.testing.assert_allclose(moved, placements[:, :3, 3], atol=6e-6)
        quaternions = np.reshape(found[f"meshcat/table{number}/{k}", ".quaternion"]["values"], (-1, 4))
        for R, quaternion in zip(placements[:, :3, :3], np.resize(quaternions, (len(run), 4)), strict=True):
            np.testing.assert_allclose(R[:, 0], first_column(quaternion), atol=1e-5)
    # Of what the two tables share there is one.
    assert ("meshcat/table1/3", ".position") not in found


def test_arrows_are_to_scale(viewer: Viewer, apart: Runs) -> None:
    run = apart["bad"]
    found = tracks(viewer.record(run, fps=20, overlays=Overlays(arrows=Arrows(force=0.5, moment=0.25))))
    scale = np.reshape(found["meshcat/force", ".scale"]["values"], (-1, 3))
    np.testing.assert_allclose(scale[:, 0], np.maximum(0.5 * np.hypot(*run.u[:, :2].T), 1e-4), atol=1e-4)
    radius = np.reshape(found["meshcat/moment", ".scale"]["values"], (-1, 3))
    np.testing.assert_allclose(np.sign(radius[5:, 1]), np.sign(run.u[5:, 2]))
    np.testing.assert_allclose(radius[:, 0], np.maximum(0.25 * np.abs(run.u[:, 2]), 1e-4), atol=1e-4)


def test_captions_tell_time_and_error(viewer: Viewer, runs: Runs) -> None:
    said = tracks(viewer.record(runs, fps=10))["meshcat/stage", ".caption"]
    assert len(said["times"]) == 601
    assert said["values"][300] == "t = 30.0 s\nposition error\nPD  7.48 mm\ncomputed torque  34.9 µm"


def test_a_recorded_page_shows_the_robot(page: Page, viewer: Viewer, runs: Runs, tmp_path: Path) -> None:
    run = runs["computed torque"]
    opened(page, viewer.record(run, speed=2), tmp_path)
    page.evaluate("document.body.classList.add('bare')")
    spots = []
    for t in (12.0, 41.0):
        page.evaluate(f"pinmobile.seek({t})")
        page.frames()
        spots.append(projected(page, side(viewer.plant, pose(run, t))))
        assert sees(page, BLUE, spots[-1])
        assert f"t = {t:.1f} s" in page.evaluate("document.getElementById('caption').textContent")
    captions = page.evaluate(
        "[...Array(40).keys()].map((k) => { pinmobile.seek(k / 10);"
        " return document.getElementById('caption').textContent.slice(4, 7); })"
    )
    # Frames are 0.2 s apart; also where 32 bits round their time up.
    assert captions == [f"{k // 2 / 5:.1f}" for k in range(40)]
    page.evaluate("pinmobile.seek(41)")
    # Where it was, it is no more.
    assert math.dist(*spots) > 100
    assert not sees(page, BLUE, spots[0])


def test_a_second_rollout_is_a_ghost(page: Page, viewer: Viewer, apart: Runs, tmp_path: Path) -> None:
    opened(page, viewer.record(apart, overlays=Overlays(trail=False, path=False)), tmp_path)
    t = float(apart["bad"].t[np.abs(apart["bad"].error[:, 0]).argmax()])
    page.evaluate(f"pinmobile.seek({t})")
    page.frames()
    good, bad = (pose(run, t) for run in apart.values())
    assert np.hypot(*(good - bad)[:2]) > 0.7  # apart
    there = projected(page, side(viewer.plant, good))
    assert sees(page, BLUE, there)
    red, _, blue = np.asarray(page.screenshot())[tuple(map(round, projected(page, (*bad[:2], 0.05))[::-1]))]
    assert red > blue + 30  # the second colour, and the ground shines through
    opacity = (
        "viewer.scene_tree.find(['meshcat', 'robot1', 'visuals', 'body', '<object>']).object.material.opacity"
    )
    assert page.evaluate(opacity) == pytest.approx(0.45)
    legend = page.evaluate("document.getElementById('legend').innerText")
    assert legend.split("\n") == ["good", "bad"]


def test_a_camera_follows_or_stays(page: Page, viewer: Viewer, runs: Runs, tmp_path: Path) -> None:
    run = runs["PD"]
    opened(page, viewer.record(run, overlays=Overlays(camera=Follow(3.0))), tmp_path)
    for t in (0.0, 45.0, 5.0):
        page.evaluate(f"pinmobile.seek({t})")
        x, y, _ = pose(run, t)
        assert math.dist(projected(page, (x, y, 0.0)), (450, 300)) < 2
        distance = page.evaluate("viewer.camera.position.distanceTo(viewer.controls.target)")
        assert distance == pytest.approx(3)
    view = FixedCamera(eye=(5, -4, 6), target=(1, 1, 0))
    opened(page, viewer.record(run, overlays=Overlays(camera=view)), tmp_path)
    for t in (0.0, 20.0):
        page.evaluate(f"pinmobile.seek({t})")
        assert page.evaluate("viewer.camera.position.toArray()") == pytest.approx([5, 6, 4])
        assert math.dist(projected(page, (1, 1, 0)), (450, 300)) < 1


def test_a_robot_that_stands_can_be_recorded(viewer: Viewer, runs: Runs) -> None:
    run, still = runs["PD"], np.zeros((1, 3))
    parts = {name: getattr(run, name)[:1] for name in ("t", "v", "a", "u", "error")}
    stands = pm.Rollout(plant=run.plant, q=still, reference=type(run.reference)(still, still, still), **parts)
    overlays = Overlays(arrows=Arrows(), desired=True, body_frame=True, frames=(SLIDE_TABLE,))
    assert ("meshcat/body", ".position") in tracks(viewer.record(stands, overlays=overlays))


# Live


@pytest.fixture
def live() -> Iterator[Viewer]:
    with Viewer(pm.MobileRobot.lecture(), live=True) as made:
        yield made


def test_a_live_page_shows_the_robot_where_it_is_displayed(page: Page, live: Viewer) -> None:
    live.display((0.0, 0.0, 0.0))
    page.open(live.url)
    live.wait(20)
    page.wait_for("pinmobile.ready()")
    spots = []
    for at in ((0.4, 0.3, 0.5), (-0.8, 1.0, 2.5)):
        live.display(at)
        x = "viewer.scene_tree.find(['meshcat', 'robot0']).object.position.x"
        page.wait_for(f"Math.abs({x} - {at[0]}) < 1e-9")
        page.frames()
        spots.append(projected(page, side(live.plant, np.array(at))))
        assert sees(page, BLUE, spots[-1])
    assert not sees(page, BLUE, spots[0])


@pytest.mark.long
def test_play_goes_through_the_rollout_in_its_time(page: Page, live: Viewer, apart: Runs) -> None:
    page.open(live.url)
    live.wait(20)
    seen, took = threading.Event(), list[float]()

    def repeat() -> None:  # a busy page may draw nothing of one playback but its end
        while not seen.is_set():
            began = time.perf_counter()
            live.play(apart["good"], speed=10)
            took.append(time.perf_counter() - began)

    playing = threading.Thread(target=repeat)
    playing.start()
    try:
        page.wait_for("document.getElementById('caption').textContent.includes('t = 1')")
        page.wait_for("viewer.scene_tree.find(['meshcat', 'trail0', '<object>']).object.drawn > 100")
    finally:
        seen.set()
        playing.join()
    assert 2.0 <= min(took) <= max(took) < 20  # 2.0 on a machine that does nothing else
    page.wait_for("document.getElementById('caption').textContent.includes('t = 20.0 s')")
    page.frames()
    assert sees(page, BLUE, projected(page, side(live.plant, apart["good"].q[-1])))
    live.display((1, 1, 0))  # the same scene, and the robot elsewhere
    page.wait_for("viewer.scene_tree.find(['meshcat', 'robot0']).object.position.y === 1")
    assert page.evaluate("document.getElementById('legend').innerText") == "desired\ntravelled"


def test_ctrl_c_ends_play_and_the_viewer_goes_on(live: Viewer, apart: Runs) -> None:
    timer = threading.Timer(0.4, signal.raise_signal, (signal.SIGINT,))
    timer.start()
    began = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        live.play(apart, repeat=math.inf)
    assert time.perf_counter() - began < 15  # it would otherwise play for ever
    live.display((1, 2, 3))


# Pictures and films


@pytest.mark.long
def test_a_screenshot_of_a_time_leaves_nothing_behind(runs: Runs, browser: Chromium, tmp_path: Path) -> None:
    def children() -> int:
        return len(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())

    descriptors, threads, before = len(os.listdir("/proc/self/fd")), threading.active_count(), children()
    with Viewer(pm.MobileRobot.lecture(), live=True) as viewer:
        early = viewer.record(runs["PD"]).screenshot(tmp_path / "early.png", t=3, size=(300, 200))
        late = viewer.screenshot(tmp_path / "late.png", t=50, size=(300, 200))
    with Image.open(late) as picture:
        assert picture.size == (300, 200)
    assert late.read_bytes() != early.read_bytes()
    assert children() == before
    assert threading.active_count() == threads
    assert len(os.listdir("/proc/self/fd")) <= descriptors


@pytest.mark.long
def test_gifs_and_films(viewer: Viewer, runs: Runs, browser: Chromium, tmp_path: Path) -> None:
    recording = viewer.record(runs, speed=60)
    seen: list[tuple[int, int]] = []
    path = recording.save_gif(
        tmp_path / "a.gif", fps=4, size=(240, 160), progress=lambda *step: seen.append(step)
    )
    with Image.open(path) as gif:
        assert (gif.size, getattr(gif, "n_frames", 0)) == ((240, 160), 5)
    assert seen == [(k, 5) for k in range(1, 6)]
    with pytest.raises(ZeroDivisionError):  # an interrupt leaves no browser and no file
        recording.save_gif(tmp_path / "b.gif", fps=4, size=(240, 160), progress=lambda *step: 1 // 0)
    assert not (tmp_path / "b.gif").exists()
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra mp4")
    film = recording.save_mp4(tmp_path / "a.mp4", fps=4, size=(240, 160)).read_bytes()
    assert film[4:8] == b"ftyp"


def test_a_gif_has_the_colours_of_what_comes_late() -> None:
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 64, axis=0).repeat(3, axis=2)
    frames = [Image.fromarray(ramp) for _ in range(10)]
    late = ramp.copy()
    late[:40] = 0, 160, 0
    frames += [Image.fromarray(late)] * 6
    with Image.open(io.BytesIO(encoded_gif(iter(frames), 10.0))) as gif:
        gif.seek(getattr(gif, "n_frames", 0) - 1)
        corner = np.asarray(gif.convert("RGB"), float)[:40].reshape(-1, 3)
    assert np.abs(corner - (0, 160, 0)).max() < 12


# What is refused


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda v, r: v.display((1, np.nan, 0)), "q[1] is nan, expected a finite number"),
        (lambda v, r: v.record(r.q), "expected a Rollout or a mapping"),
        (lambda v, r: v.record(r, fps=1e9), "expected <= 200000"),
        (lambda v, r: v.play(r), "play needs a live viewer: Viewer(plant, live=True)"),
        (lambda v, r: v.screenshot("a.png", t=1), "call record first"),
        (lambda v, r: v.screenshot("a.png"), "call display or play first"),
        (lambda v, r: v.record(r).screenshot("a.png", t=61), "t is 61.0 s, expected 0 <= t <= 60 s"),
        (lambda v, r: v.record(r).save_gif("a.gif", fps=80), "expected 0 < fps <= 50 1/s"),
        (lambda v, r: v.record(r).save_html("a.htm"), "expected a name that ends in '.html'"),
        (lambda v, r: v.record(r).save_gif("/no/a.gif"), "which cannot be written"),
        (lambda v, r: v.record(r).save_mp4("a.mp4", size=(99, 100)), "expected even numbers"),
        (lambda v, r: Viewer("robot"), "plant is 'robot', expected a MobileRobot, or a plant with pose(q)"),
        (lambda v, r: Overlays(frames=("lecture",)), "frames has 'lecture', expected tables"),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_be_shown_is_refused(
    runs: Runs,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    call: Callable[[Any, pm.Rollout], object],
    text: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    with Viewer(pm.MobileRobot.lecture()) as fresh:
        with pytest.raises((pm.InvalidArgument, ViewerError), match=re.escape(text)):
            call(fresh, runs["PD"])
        with pytest.raises(ViewerError, match="there is nothing to draw yet"):
            fresh.static_html()  # nothing is counted as drawn
    assert list(tmp_path.iterdir()) == []


def test_a_closed_viewer_says_so(runs: Runs, tmp_path: Path) -> None:
    for is_live in (False, True):
        viewer = Viewer(pm.MobileRobot.lecture(), live=is_live)
        viewer.close()
        viewer.close()
        calls: tuple[Callable[[Viewer], object], ...] = (
            lambda v: v.display((0, 0, 0)),
            lambda v: v.play(runs),
            lambda v: v.record(runs),
            lambda v: v.wait(1),
            lambda v: v.screenshot(tmp_path / "a.png"),
            lambda v: v.static_html(),
            lambda v: v.url,
        )
        for call in calls:
            with pytest.raises(ViewerError, match="the viewer is closed"):
                call(viewer)


def test_no_chromium_is_said_before_anything_is_written(
    viewer: Viewer, runs: Runs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = viewer.record(runs)
    monkeypatch.setenv("PINMOBILE_CHROMIUM", "")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("pinmobile.viewer.recording._NAMES", ("chromium",))
    with pytest.raises(ViewerError, match=r"no Chromium was found.*PINMOBILE_CHROMIUM"):
        recording.screenshot(tmp_path / "a.png")
    monkeypatch.setenv("PINMOBILE_CHROMIUM", "nothing")
    with pytest.raises(ViewerError, match="PINMOBILE_CHROMIUM is 'nothing', expected a program"):
        recording.save_gif(tmp_path / "a.gif")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("user", "flagged"), [(0, True), (1000, False)])
def test_the_sandbox_is_given_up_as_root_alone_and_one_that_cannot_start_is_told(
    user: int, flagged: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "chromium"
    program.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/flags\necho No usable sandbox! >&2\nexit 1\n')
    program.chmod(0o755)
    monkeypatch.setenv("PINMOBILE_CHROMIUM", str(program))
    monkeypatch.setattr(os, "geteuid", lambda: user)
    with pytest.raises(ViewerError, match=r"sandbox cannot start here: allow.*exec chromium --no-sandbox"):
        Browser()
    assert ("--no-sandbox" in (tmp_path / "flags").read_text().split()) is flagged


def test_no_encoder_is_told(
    viewer: Viewer, runs: Runs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ViewerError, match=r"pip install imageio-ffmpeg, or 'pinmobile\[mp4\]'$"):
        viewer.record(runs).save_mp4(tmp_path / "a.mp4")


# How a robot looks

_WHEEL = """
<link name="wheel"><inertial><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><cylinder radius="0.1" length="0.05"/></geometry></visual></link>
<joint name="axle" type="continuous"><parent link="base"/><child link="wheel"/>
<origin xyz="0.2 0.3 0.1" rpy="1.5707963267948966 0 0"/><axis xyz="0 0 1"/></joint>"""
_BASE = """<robot name="truck"><link name="base">
<inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><origin xyz="0 0 0.25"/><geometry><mesh filename="package://truck/{0}.stl" scale="0.001 0.001 0.001"/>
</geometry><material name="green"><color rgba="0 0.6 0.4 1"/></material></visual></link>{1}</robot>"""


def truck(folder: Path, mesh: str) -> pm.MobileRobot:
    corners = 1000 * np.array([[-0.4, -0.3, 0], [0.4, -0.3, 0], [0, 0.3, 0], [0, 0, 0.5]])
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]
    facets = [struct.pack("<12f2x", 0, 0, 0, *corners[a], *corners[b], *corners[c]) for a, b, c in faces]
    (folder / "truck").mkdir(exist_ok=True)
    (folder / "truck" / "hull.stl").write_bytes(bytes(80) + struct.pack("<I", len(faces)) + b"".join(facets))
    path = folder / "truck" / "truck.urdf"
    path.write_text(_BASE.format(mesh, _WHEEL))
    return pm.MobileRobot.from_urdf(path, [folder])


def test_a_robot_with_meshes_is_drawn_whole(page: Page, tmp_path: Path) -> None:
    robot = truck(tmp_path, "hull")
    hull, wheel = robot.visual_model.geometryObjects
    assert {hull.parentJoint, wheel.parentJoint} == {3}
    np.testing.assert_allclose(hull.placement.translation, (0, 0, 0.25))
    np.testing.assert_allclose(wheel.placement.translation, (0.2, 0.3, 0.1))
    run = pm.simulate(robot, pm.ComputedTorque(robot), pm.Tangent(pm.Circle(1, 0.5, 6)), dt=0.05)
    with Viewer(robot) as viewer:
        opened(page, viewer.record(run), tmp_path)
    size = page.evaluate(
        "(() => { pinmobile.seek(0); const root = viewer.scene_tree.find(['meshcat', 'robot0']).object;"
        "const size = new MeshCat.THREE.Box3().setFromObject(root).getSize(new MeshCat.THREE.Vector3());"
        "return size.toArray(); })()"
    )
    assert size == pytest.approx([0.8, 0.75, 0.625], abs=0.01)  # y up: from the wheel's ground to the top
    page.evaluate("pinmobile.seek(4)")
    page.frames()
    at = run.q[80]
    assert sees(page, (0, 153, 102), projected(page, (at[0], at[1], 0.5)))


@pytest.mark.parametrize(
    ("mesh", "words"),
    [("gone", "missing: package://truck/gone.stl"), ("hull", "damaged .* format: .*truck/hull.stl$")],
)
def test_the_box_stands_for_a_mesh_that_is_missing_or_damaged(tmp_path: Path, mesh: str, words: str) -> None:
    robot = truck(tmp_path, mesh)
    (tmp_path / "truck" / "hull.stl").write_bytes(b"no mesh")
    with pytest.warns(UserWarning, match=rf"truck.urdf: not drawn, since {words}"):
        shown = robot.visual_model
    assert [item.name for item in shown.geometryObjects] == ["body", "front", "wedge", "wheel_0"]


def test_collision_shapes_stand_for_meshes_that_are_missing(tmp_path: Path) -> None:
    path = tmp_path / "truck" / "truck.urdf"
    truck(tmp_path, "gone")
    tree = ElementTree.parse(path)
    link = tree.find("link")
    assert link is not None
    for shape in ('<cylinder radius="0.2" length="0.5"/>', '<mesh filename="package://truck/gone too.stl"/>'):
        link.append(ElementTree.fromstring(f"<collision><geometry>{shape}</geometry></collision>"))
    tree.write(path)
    robot = pm.MobileRobot.from_urdf(path, [tmp_path])
    name = link.get("name")
    words = rf"missing: package://truck/gone.stl; their collision shapes replace the visuals of {name}$"
    with pytest.warns(UserWarning, match=words):
        shown = robot.visual_model
    hull, wheel = shown.geometryObjects
    assert type(hull.geometry).__name__ == "Cylinder"
    assert (hull.geometry.radius, 2 * hull.geometry.halfLength) == (0.2, 0.5)
    assert wheel.name == "wheel_0"


def test_the_box_stands_on_the_ground_and_shows_its_front() -> None:
    robot = pm.MobileRobot.lecture()
    body, front, wedge = robot.visual_model.geometryObjects
    assert body.placement.translation.tolist() == [0, 0, 0.1]
    assert (2 * body.geometry.halfSide).tolist() == [0.6, 0.4, 0.2]
    assert front.placement.translation[0] > 0.3
    assert wedge.placement.translation.tolist() == [0, 0, 0.2]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pm.MobileRobot.from_urdf(pm.urdf.shipped_urdf("lecture")).visual_model.ngeoms == 3


# The command


def test_the_command_serves_until_it_is_told_to_end(page: Page, runs: Runs, tmp_path: Path) -> None:
    runs["PD"].save(tmp_path / "rollout.npz")
    words = [sys.executable, "-m", "pinmobile", "view", str(tmp_path)]  # the folder of a run
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert process.stdout is not None
        url = process.stdout.readline().split()[-1]
        port = int(url.split(":")[2].strip("/"))
        assert f"ssh -L {port}:127.0.0.1:{port} " in process.stdout.readline()
        page.open(url)
        page.wait_for("document.getElementById('caption').textContent.includes('t = 1')")
        assert page.evaluate("document.getElementById('legend').innerText") == "desired\nrollout"
        process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0
        assert "ended" in process.stdout.read()
    finally:
        end(process)
    with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port), 1):
        pass


def end(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate()


# Meshes of fewer triangles


def sphere(n: int = 80) -> coal.BVHModelOBBRSS:
    """Return a sphere of radius 1 with 2 n^2 triangles."""
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, n + 1))
    points = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()[:, None]
    faces = np.concatenate([first + np.array(corners) for corners in ((0, n + 2, n + 1), (0, 1, n + 2))])
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), points.size // 3)
    mesh.addVertices(points.reshape(-1, 3))
    mesh.addTriangles(faces.astype(np.int32))
    mesh.endModel()
    return mesh


def test_a_coarse_mesh_has_about_that_share_and_the_same_shape() -> None:
    share, fine = 0.05, sphere()
    mesh = simplify(fine, share)
    assert 0.4 < mesh.num_tris / (share * fine.num_tris) < 2.5
    distance = np.linalg.norm(mesh.vertices(), axis=1)
    cell = np.sqrt(3 * 4 * np.pi / (share * fine.num_tris))
    assert np.abs(distance - 1).max() < cell**2
    triangles = (mesh.tri_indices(k) for k in range(mesh.num_tris))
    a, b, c = np.array([mesh.vertices()[[t[0], t[1], t[2]]] for t in triangles]).transpose(1, 0, 2)
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c)
    assert (outward > -1e-12).mean() > 0.99  # seen from outside still


def test_uneven_meshes_keep_that_share_of_their_triangles_too() -> None:
    for item in pm.MobileRobot.box().mount("ur5").visual_model.geometryObjects:
        count = getattr(item.geometry, "num_tris", 0)
        if count > 1000:
            assert 0.25 < simplify(item.geometry, 0.5).num_tris / count < 0.6, item.name


@pytest.mark.long
def test_a_page_of_a_robot_with_hundreds_of_thousands_of_triangles_stays_small() -> None:
    robot = pm.MobileRobot.box().mount("g1")  # 290,000
    with Viewer(robot) as viewer:
        viewer.display(robot.rest)
        assert len(viewer.static_html()) < 6e6


def test_a_ramp_inclines_the_scene_and_gravity_points_down(monkeypatch: pytest.MonkeyPatch) -> None:
    told: dict[Any, Any] = {}
    monkeypatch.setattr(Stage, "set", lambda self, path, name, value: told.update({(path, name): value}))
    table = pm.WheelTable.differential(0.5, 0.1, mass=1.0, spin_inertia=0.01, supports=[(0.3, 0)])
    flat = pm.WheeledRobot(pm.MobileRobot(30.0, 1.3, com=(0.1, 0, 0.1)), table)
    with Viewer(flat) as viewer:
        viewer.display(flat.rest)
    assert ("meshcat", "quaternion") not in told
    robot = flat.on_ramp(0.3, direction=0.8)
    with Viewer(robot) as viewer:
        viewer.display(robot.rest)
    first = {name: first_column(told[name, "quaternion"]) for name in ("meshcat", "meshcat/gravity")}
    axis = [math.sin(0.8), -math.cos(0.8), 0.0]  # about which the plane is turned
    x = math.cos(0.3) * np.array([1.0, 0, 0]) + (1 - math.cos(0.3)) * axis[0] * np.array(axis)
    np.testing.assert_allclose(first["meshcat"], x + math.sin(0.3) * np.cross(axis, [1.0, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(first["meshcat/gravity"], robot.ground.ramp.fall(1.0), atol=1e-9)


def first_column(quaternion: Any) -> list[float]:
    """Return the first column of the rotation matrix of a quaternion."""
    x, y, z, w = quaternion
    return [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
