"""The windows in a real headless Chromium: what is drawn where, and what the page says and asks for."""

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from pinmobile import Circle, ComputedTorque, MobileRobot, Tangent, simulate
from pinmobile.viewer import Viewer
from pinmobile.viewer.pages import Visualizer
from pinmobile.viewer.server import LiveWindow
from tests.chromium import Chromium, Page
from tests.webclient import eventually

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from meshcat import geometry

WIDTH, HEIGHT = 480, 360
RED = (255, 0, 0)
HERE, THERE = (0.5, -0.8, 0.2), (-0.3, 0.9, 0.4)


@pytest.fixture
def page(browser: Chromium) -> Iterator[Page]:
    opened = browser.page(WIDTH, HEIGHT)
    yield opened
    opened.close()
    assert opened.errors == []
    for url in opened.requests:
        parts = urlsplit(url)
        assert parts.scheme in ("data", "file", "blob") or parts.hostname in ("127.0.0.1", "127.0.0.2")


def draw_box(window: LiveWindow, at: tuple[float, float, float]) -> None:
    box = Visualizer(window=window)["box"]
    box.set_object(geometry.Box([0.3, 0.3, 0.3]), geometry.MeshBasicMaterial(color=0xFF0000))
    move_box(window, at)


def move_box(window: LiveWindow, at: tuple[float, float, float]) -> None:
    pose = np.eye(4)
    pose[:3, 3] = at
    Visualizer(window=window)["box"].set_transform(pose)


def colour_at(page: Page, point: tuple[float, float, float]) -> tuple[int, ...]:
    """Return the colour where a point of the scene projects."""
    script = f"""(() => {{
        const p = viewer.scene.localToWorld(new MeshCat.THREE.Vector3({point[0]}, {point[1]}, {point[2]}));
        p.project(viewer.camera);
        return [p.x, p.y];
    }})()"""
    x, y = page.evaluate(script)
    colour = page.screenshot().getpixel(((x + 1) / 2 * WIDTH, (1 - y) / 2 * HEIGHT))
    assert isinstance(colour, tuple)
    return colour


def test_fault_the_browser_is_reloaded_and_closed_and_another_comes(page: Page, browser: Chromium) -> None:
    with LiveWindow() as window:
        page.open(window.url)
        assert window.wait(10)
        draw_box(window, HERE)
        assert eventually(lambda: colour_at(page, HERE) == RED)
        page.open(window.url)
        assert eventually(lambda: colour_at(page, HERE) == RED)
        page.open("about:blank")
        assert eventually(lambda: window.browsers == 0)
        move_box(window, THERE)
        other = browser.page(WIDTH, HEIGHT)
        other.open(window.url)
        assert eventually(lambda: colour_at(other, THERE) == RED)
        assert window.browsers == 1
        other.close()


def test_a_page_with_a_token_draws_and_each_request_carries_it(page: Page) -> None:
    with pytest.warns(UserWarning, match="the viewer listens on"):
        window = LiveWindow("127.0.0.2")
    with window:
        draw_box(window, HERE)
        page.open(window.url)
        assert eventually(lambda: colour_at(page, HERE) == RED)
        own = [url for url in page.requests if not url.startswith("data:")]
        assert len(own) == 3
        assert all(url.endswith(window.url.partition("/?")[2]) for url in own)


def assert_sealed(page: Page) -> None:
    """Check that a page that draws runs no script but its own, and asks nobody for anything."""
    assert page.errors == []
    policy = page.evaluate("document.querySelector('meta[http-equiv=Content-Security-Policy]').content")
    rules = {words[0]: words[1:] for words in map(str.split, policy.split(";"))}
    assert rules["default-src"] == ["'none'"]
    assert all(re.fullmatch(r"'sha256-[A-Za-z0-9+/]{43}='", word) for word in rules["script-src"])
    assert rules["img-src"] == ["data:", "blob:"]
    assert "connect-src" not in rules
    page.evaluate(
        "const script = document.createElement('script'); script.textContent = 'window.came = 1';"
        "document.body.append(script); script.remove()"
    )
    assert page.evaluate("window.came === undefined")
    for url in ("data:text/plain,x", page.evaluate("location.href")):
        assert page.evaluate(f"fetch({url!r}).then(() => 'went', () => 'refused')") == "refused"
    refused = [text for text in page.errors if "Content Security Policy" in text]
    assert len(refused) == len(page.errors) >= 2
    page.errors.clear()


def test_a_recorded_page_plays_and_runs_nothing_but_itself(page: Page, tmp_path: Path) -> None:
    robot = MobileRobot.box()
    run = simulate(robot, ComputedTorque(robot), Tangent(Circle(3, 0.5, 6)), dt=0.1)
    with Viewer(robot) as viewer:
        file = viewer.record(run, title="<script>one</script>").save_html(tmp_path / "run.html")
    page.open(file.as_uri())
    page.wait_for("pinmobile.ready()")
    page.wait_for_changes("Number(document.getElementById('slider').value)", 1)
    assert_sealed(page)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    robot = MobileRobot.box()
    runs = {
        gain: simulate(robot, ComputedTorque(robot, kp=gain, kd=gain), Tangent(Circle(3, 0.5, 6)), dt=0.1)
        for gain in (4, 9)
    }
    with Viewer(robot) as viewer:
        named = {f"kp = {gain}": run for gain, run in runs.items()}
        return viewer.record(named, title="Two gains").save_html(
            tmp_path_factory.mktemp("page") / "runs.html"
        )


BOX = "document.getElementById('%s').getBoundingClientRect()"
SEEN = """(() => {
    const robot = viewer.scene_tree.find(["meshcat", "robot0"]).object;
    const at = robot.getWorldPosition(new MeshCat.THREE.Vector3()).project(viewer.camera);
    const pane = document.querySelector("canvas").getBoundingClientRect();
    const x = pane.left + (at.x + 1) / 2 * pane.width, y = pane.top + (1 - at.y) / 2 * pane.height;
    return document.elementFromPoint(x, y).tagName;
})()"""


@pytest.mark.parametrize("size", [(400, 700), (400, 240)], ids=str)
def test_nothing_covers_the_picture_in_a_narrow_window(
    page: Page, recorded: Path, size: tuple[int, int]
) -> None:
    page.resize(*size)
    page.open(recorded.as_uri())
    page.wait_for("pinmobile.ready()")
    for time in (0, 2, 4, 6):
        page.evaluate(f"pinmobile.seek({time})")
        assert page.evaluate(SEEN) == "CANVAS"
    assert page.evaluate(f"{BOX % 'told'}.bottom") <= page.evaluate(f"{BOX % 'meshcat-pane'}.top") + 1
    assert page.evaluate(f"{BOX % 'player'}.top") >= page.evaluate(f"{BOX % 'meshcat-pane'}.bottom") - 1
    assert page.evaluate("document.querySelector('canvas').clientHeight") > 0.6 * size[1]
    assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
    page.resize(1200, 700)
    page.wait_for("document.querySelector('canvas').clientHeight == 700")


def test_the_player_has_names_and_a_visible_focus_and_follows_the_keyboard(
    page: Page, recorded: Path
) -> None:
    page.open(recorded.as_uri())
    page.wait_for("pinmobile.ready()")
    page.evaluate("pinmobile.seek(1)")
    names: list[str] = []
    outlines: set[str] = set()
    for _ in range(3):
        press(page, "Tab", 9)
        names.append(page.evaluate("document.activeElement.ariaLabel"))
        outlines.add(page.evaluate("getComputedStyle(document.activeElement).outline"))
    assert names == ["play", "time", "playback speed"]
    assert outlines == {"rgb(194, 78, 0) solid 3px"}
    assert page.evaluate("document.getElementById('meshcat-pane').ariaLabel") == "Two gains"
    page.evaluate("document.getElementById('toggle').focus()")
    press(page, " ", 32)
    assert page.evaluate("document.activeElement.ariaLabel") == "pause"
    page.wait_for_changes("Number(document.getElementById('slider').value)", 1)


def press(page: Page, key: str, code: int) -> None:
    for kind in ("keyDown", "keyUp"):
        text = {"text": key} if key == " " and kind == "keyDown" else {}
        page.call("Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, **text)
