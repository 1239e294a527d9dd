"""Runs in real time: the stepped loop beside `simulate`, the driven reference, the page in a browser."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.cli.scenario_file import LoadedFile
from pinmobile.errors import UnknownName
from pinmobile.loop import LoopStepper
from pinmobile.parts import evolved
from pinmobile.viewer import LiveRun, play, recording
from pinmobile.viewer.live_run import _Drive
from tests.chromium import Chromium, Page, chromium
from tests.quick import every_fifth
from tests.webclient import WebSocket, eventually

ROBOT = pm.MobileRobot(30.0, 1.3)
CIRCLE = pm.Tangent(pm.Circle(1.0, 0.5, 4.0))


def scenario(controller: Any = None, trajectory: Any = CIRCLE, **options: Any) -> pm.Scenario:
    own = pm.PD(120, 120) if controller is None else controller
    parts = {"robot": ROBOT, "controller": own, "trajectory": trajectory}
    return pm.Scenario(**parts | {"n": 1, "spread": {}, "dt": 0.02} | options)


def shipped(name: str, *words: str) -> pm.Scenario:
    return evolved(LoadedFile([name, *words]).content, n=1, spread={}, grid={}, cases={}).scenario()  # type: ignore[no-any-return]


NOISY = pm.MeasurementNoise(
    pm.MeasurementDelay(pm.PD((60, 60, 3), (60, 60, 3)), samples=3), std_q=1e-3, std_v=1e-3, seed=2
)


@pytest.mark.parametrize(
    "loop",
    [
        scenario(NOISY, forces={"wind": pm.ConstantForce((1, 0, 0), begin=1.0)}, seed=5, substeps=3),
        shipped("differential", "duration=3"),
        shipped("skid-steer", "duration=1"),
    ],
    ids=["noise, delay and force", "rolling", "slipping"],
)
def test_samples_in_pieces_are_those_of_simulate_bit_for_bit(loop: pm.Scenario) -> None:
    whole = pm.simulate(
        loop.robot, loop.controller, loop.trajectory, dt=loop.dt, duration=loop.duration, forces=loop.forces,
        integrator=None if loop.integrator is None else loop.integrator,
        substeps=loop.substeps, seed=loop.seed, engine=pm.Engine.COMPILED,
    )  # fmt: skip
    stepper, pieces = LoopStepper(loop), np.random.default_rng(1)
    for again in range(2):
        stepper.reset({})
        while stepper.k < len(whole):
            stepper.advance(min(int(pieces.integers(1, 9)), len(whole) - stepper.k))
        found = stepper.rollout()
        for name in ("t", "q", "v", "a", "u", "error"):
            np.testing.assert_array_equal(getattr(found, name), getattr(whole, name), f"{name}, run {again}")
        assert set(found.signals) == set(whole.signals)


def test_a_number_changes_between_two_samples_as_in_two_runs() -> None:
    place = pm.FixedHeading(pm.Hold([0.3, 0.2], 4.0), psi=0.5)
    options: dict[str, Any] = {"dt": 0.02, "engine": pm.Engine.COMPILED}
    first = pm.simulate(ROBOT, pm.PD(60, 20), place, duration=1.0, q0=np.zeros(3), **options)
    second = pm.simulate(
        ROBOT, pm.PD(240, 20), place, duration=1.0, q0=first.q[-1], v0=first.v[-1], **options
    )
    start = {"start.x": -0.3, "start.y": -0.2, "start.psi": -0.5}
    stepper = LoopStepper(scenario(pm.PD(60, 20), place, spread=start | {"controller.kp": 60.0}))
    stepper.advance(50)
    stepper.change(stepper.values | {"controller.kp": 240.0})
    stepper.advance(51)
    found = stepper.rollout()
    # The times of the second run begin anew; no law of this loop depends on them.
    np.testing.assert_allclose(found.q[:51], first.q, atol=1e-12)
    np.testing.assert_allclose(found.q[50:], second.q, atol=1e-12)
    assert set(found.signals["controller.kp"].values[[0, 49]]) == {60.0}
    assert set(found.signals["controller.kp"].values[50:]) == {240.0}
    assert found.signals["controller.kp"].unit == "N/m, N/m, N m/rad"


def test_the_reference_rests_after_its_end_and_the_run_goes_on() -> None:
    stepper = LoopStepper(scenario())
    stepper.advance(1000)
    run = stepper.rollout()
    assert run.t[-1] == pytest.approx(999 * 0.02)
    np.testing.assert_array_equal(run.reference.q[201:], np.tile(CIRCLE(4.0).q, (799, 1)))
    assert not run.reference.v[201:].any()
    assert run.max_error()[0] < 0.5
    assert np.abs(run.error[-1]).max() < 1e-6


@pytest.mark.parametrize("curves", [False, True])
def test_a_driven_reference_is_a_motion(curves: bool) -> None:
    drive, dt = _Drive(ROBOT, CIRCLE(np.linspace(0, 4, 9))), 0.01
    drive.curves = curves
    drive.begin(np.array([1.0, 2.0, 0.4]), np.zeros(3), pm.Reference(*np.zeros((3, 1, 3))))
    keys = [(1.0, 0.0, 0.0)] * 100 + [(1.0, 1.0, 0.0)] * 1400 + [(0.0, 1.0, 0.0)] * 100
    steps = [drive.ahead(np.array(each), 1, dt) for each in keys]
    q, v, a = (np.concatenate(each) for each in zip(*steps, strict=True))
    largest = float(np.abs(a).max())
    assert largest < 1.5 * 0.5 / 0.4 + 0.5  # speed and turn rate of the circle, 0.5, within 0.4 s; curve
    # Differences of samples: errors of the second order in dt, and one sample where a key changes.
    assert np.abs(np.diff(q, axis=0) / dt - (v[1:] + v[:-1]) / 2).max() < 2 * largest * dt
    assert np.abs(np.diff(v, axis=0) / dt - a[:-1]).max() < 2 * largest * dt
    np.testing.assert_allclose(np.hypot(*v[1400, :2]), 0.5)
    turning = q[250:1490, :2]
    centre = turning[:1257].mean(axis=0)  # one turn takes 2 pi / 0.5 s
    np.testing.assert_allclose(np.hypot(*(turning - centre).T), 1.0, rtol=0.02)
    np.testing.assert_allclose(v[-1], [0, 0, 0 if curves else 0.5], atol=1e-9)


def test_wrong_arguments_are_refused() -> None:
    parts = ROBOT, pm.PD(120, 120), CIRCLE
    with pytest.raises(UnknownName, match=r"unknown parameter in sliders 'controller\.kx'"):
        play(*parts, dt=0.02, sliders=["controller.kx"])
    with pytest.raises(pm.InvalidArgument, match="sliders"):
        play(*parts, dt=0.02, sliders="controller.kp")
    branching = pm.law(lambda t, q, v, reference: np.zeros(3) if q[0] > 0 else np.ones(3))
    with pytest.raises(pm.InvalidArgument, match=r"this loop cannot run in real time: .*if q\[0\]"):
        play(ROBOT, branching, CIRCLE, dt=0.02)


class Client:
    """A page without a browser, which says words and knows the newest properties of the stage."""

    def __init__(self, socket: WebSocket, name: str) -> None:
        self.socket, self.name = socket, name

    def say(self, words: str) -> None:
        self.socket.say(f"{self.name} {words}".encode())

    def last(self, name: str) -> Any:
        found = (x for x in reversed(self.socket.commands) if x.get("property") == name)
        return next((x["value"] for x in found), None)


def test_one_page_drives_and_others_watch() -> None:
    with (
        play(ROBOT, pm.ComputedTorque(ROBOT), CIRCLE, dt=0.01, sliders=["controller.kp"]) as run,
        WebSocket(run.url) as one,
        WebSocket(run.url) as two,
    ):
        first, second = Client(one, "one"), Client(two, "two")
        second.say("slider 0 9")
        assert eventually(lambda: first.last("driver") == "two")
        first.say("slider 0 5")
        first.say("pause")
        assert eventually(lambda: first.last("values")[0] == 9.0)
        second.say("slider 0 1e9")  # beyond the slider
        assert eventually(lambda: first.last("values")[0] == 12.0)
        for words in ("slider 7 1", "slider x y", "keys 1", "keys nan nan nan", "dance", "slider 0", ""):
            second.say(words)
        second.say("keys 1 0 0")
        assert eventually(lambda: np.abs(run.rollout().signals["forces.hand.force.x"].values[-1]) > 1)
        assert not first.last("paused")
        two.__exit__(None, None, None)
        assert eventually(lambda: first.last("driver") == "")
        assert eventually(lambda: run.rollout().signals["forces.hand.force.x"].values[-1] == 0)
        first.say("pause")
        assert eventually(lambda: first.last("paused") is True)
        count = len(run.rollout())
        first.say("reset")
        assert eventually(lambda: len(run.rollout()) < count and first.last("paused") is False)
        assert first.last("values")[0] == 12.0
    assert run.rollout().signals["controller.kp"].values[-1] == 12.0


@pytest.mark.parametrize("name", every_fifth(["differential", "omni"]))
def test_keys_drive_each_drive_ahead(name: str) -> None:
    with LiveRun(shipped(name)) as run, WebSocket(run.url) as page:
        client, speed = Client(page, "one"), run._drive.scale[0]
        client.say("keys 1 0 0")
        assert eventually(lambda: len(run.rollout()) > 150)
        found = run.rollout()
    psi = found.q[-1, 2]
    ahead = found.v[-1, :2] @ (np.cos(psi), np.sin(psi))
    assert ahead == pytest.approx(speed, rel=0.02)
    assert np.hypot(*found.v[-1, :2]) == pytest.approx(ahead, rel=1e-3)
    assert np.abs(found.error[-1]).max() < 0.02
    np.testing.assert_allclose(found.reference.q[0], shipped(name).reference.q[0])  # the trajectory, at first


def test_a_payload_is_seen_and_weighs_while_it_is_held() -> None:
    scenario = shipped("mobile-manipulator", "dt=0.01")
    robot, crate = scenario.robot, pm.PayloadBody(3.0, size=(0.2, 0.2, 0.2))
    plant = pm.PayloadTransfer(robot, crate, begin=3.0)
    with LiveRun(evolved(scenario, robot=plant, integrator=None)) as run, WebSocket(run.url) as page:
        client, weight = Client(page, "one"), 9.81 * robot.mass_matrix(robot.rest)[0, 0]
        assert eventually(lambda: client.last("values") == [pytest.approx(weight / 4)])  # a push

        def state() -> Any:
            moves = client.last("moves")
            held = [x for path, name, x in json.loads(moves or "[]") if name == "visible" and "load" in path]
            contacts = run._newest_contacts
            return bool(held and held[0]), 0.0 if contacts is None else float(contacts.loads.sum())

        client.say("reset")  # as a busy machine may have taken long to connect
        assert eventually(lambda: state() == (False, pytest.approx(weight, rel=0.02)))
        assert eventually(lambda: state() == (True, pytest.approx(weight + 3 * 9.81, rel=0.02)))


def test_slip_and_tipping_are_stated_when_they_happen() -> None:
    tall = shipped("differential", "robot.ground=Coulomb(0.9)", "robot.robot.com.z=0.4")
    with LiveRun(tall) as run, WebSocket(run.url) as page:
        client = Client(page, "one")
        assert eventually(lambda: client.last("events") == [])
        # A weight of 294 N, pushed as strongly, 0.4 m above the ground, with half a track of 0.23 m.
        client.say("slider 0 290")
        client.say("push")
        assert eventually(lambda: {"tip over", "right slides"} <= {*client.last("events")})
        assert eventually(lambda: client.last("events") == [])
        size, blocks = (client.last("panel")[name] for name in ("size", "blocks"))
        rows = [json.loads(client.last(f"rows{k}")) for k in range(blocks)]
        assert any(1.0 in row[size - 1 :: size] for row in rows)  # the band in the plots
    assert "tip over" in {event.kind for event in run.rollout().events}


def test_a_run_that_diverges_pauses_and_says_so() -> None:
    with (
        play(ROBOT, pm.PD(120, 120), CIRCLE, dt=0.1, sliders=["controller.kd"]) as run,
        WebSocket(run.url) as page,
    ):
        client = Client(page, "one")
        client.say("slider 0 360")  # 360 N s/m, 1.3 kg m^2, 0.1 s: unstable
        client.say("push")
        client.say("keys 0 0 1")
        assert eventually(lambda: "diverged" in (client.last("message") or ""))
        assert np.isfinite(run.rollout().q).all()
        client.say("slider 0 4")
        client.say("reset")
        assert eventually(lambda: client.last("paused") is False)


@pytest.fixture(scope="module")
def composed() -> Iterator[Chromium]:
    """Return a browser that composes pages without WebGL in software, which takes most of its time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording, "_FLAGS", (*recording._FLAGS, "--disable-gpu-compositing"))
        with chromium() as started:
            yield started


@pytest.fixture
def page(composed: Chromium) -> Iterator[Page]:
    opened = composed.page(480, 360)
    yield opened
    opened.close()
    assert opened.errors == []


def pushed(run: pm.Rollout) -> float:
    """Return the largest force of a push [N]."""
    along = [run.signals[f"forces.hand.force.{axis}"].values for axis in "xy"]
    return float(np.hypot(*along).max())


def key(page: Page, code: str, kind: str = "keyDown") -> None:
    page.call("Input.dispatchKeyEvent", type=kind, code=code, key=code)


TEXT = "document.getElementById('%s').textContent"


@pytest.mark.long
def test_the_page_in_a_browser(page: Page, composed: Chromium) -> None:
    with LiveRun(shipped("skid-steer", "trajectory.path.duration=100"), ["mass"]) as run:
        page.open(run.url)
        page.wait_for("document.querySelectorAll('#plots canvas').length == 3")
        assert page.evaluate(TEXT % "sliders") == "mass [kg]30push [N]73.6"
        heads = page.evaluate("[...document.querySelectorAll('#plots h2')].map(one => one.textContent)")
        assert heads == ["error [m, rad]", "input [N m]", "wheel load [N]"]
        # Keys drive: the robot turns to the left, wheels of a skid-steer slide.
        key(page, "KeyW")
        key(page, "KeyA")
        assert eventually(lambda: run.rollout().v[-1, 2] > 0.1)
        page.wait_for("document.getElementById('events').textContent.includes('slides')")
        page.wait_for("document.getElementById('caption').textContent.includes('driven')")
        key(page, "KeyA", "keyUp")
        key(page, "KeyW", "keyUp")
        assert eventually(lambda: np.abs(run.rollout().reference.v[-1]).max() == 0)
        # The slider changes the compiled loop, the button pushes.
        page.evaluate(
            "(() => { const one = document.querySelector('#sliders input'); one.value = 60;"
            "one.dispatchEvent(new Event('input')); document.getElementById('push').click(); })()"
        )
        assert eventually(lambda: abs(run.rollout().signals["plant.robot.mass"].values[-1] - 60) < 0.1)
        assert eventually(lambda: pushed(run.rollout()) > 50)
        # A gamepad drives too.
        page.evaluate("navigator.getGamepads = () => [{axes: [0, 1, 0, 0], buttons: [{pressed: false}]}]")
        assert eventually(lambda: abs(np.hypot(*run.rollout().reference.v[-1, :2]) - 0.6) < 1e-6)
        page.evaluate("navigator.getGamepads = () => []")
        # A second page watches, and a reload loses no sample of the plots.
        other = composed.page(400, 800)
        other.open(run.url)
        other.wait_for("document.getElementById('state').textContent.includes('this one watches')")
        assert other.evaluate("document.getElementById('pause').disabled")
        assert other.evaluate("document.documentElement.scrollWidth") <= 400
        key(page, "KeyP")
        other.wait_for("document.getElementById('pause').textContent == 'continue'")
        page.wait_for("document.getElementById('pause').textContent == 'continue'")
        before = page.evaluate("pinmobile.play.rows()")
        assert len(before) > 60
        page.open(run.url)
        page.wait_for("document.getElementById('pause').textContent == 'continue'")
        assert page.evaluate("pinmobile.play.rows()") == before
        assert page.evaluate("Number(document.querySelector('#sliders input').value)") == pytest.approx(
            60, abs=0.1
        )
        other.close()
        hosts = {urlsplit(url).netloc for url in page.requests if not url.startswith("data:")}
        assert hosts == {urlsplit(run.url).netloc}


def test_a_page_that_draws_slowly_reduces_its_resolution(page: Page) -> None:
    with play(ROBOT, pm.ComputedTorque(ROBOT), pm.Tangent(pm.Circle(3.0, 0.1, 60.0)), dt=0.01) as run:
        page.open(run.url)
        page.wait_for("window.pinmobile?.play?.rows().length > 0")
        full = page.evaluate("viewer.renderer.getPixelRatio()")
        # Each frame takes at least 50 ms, on every machine.
        page.evaluate(
            "(function slow() { const end = performance.now() + 50; while (performance.now() < end); "
            "requestAnimationFrame(slow); })()"
        )
        page.wait_for(f"viewer.renderer.getPixelRatio() <= {full / 2}")
        assert page.evaluate("pinmobile.play.fps") < 20.5
        assert page.evaluate("pinmobile.play.scene > 0 && pinmobile.play.scene <= pinmobile.play.fps")


def test_the_command_saves_the_run_at_ctrl_c(tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    words = [sys.executable, "-m", "pinmobile", "play", "--slider", "controller.kp", "--out", str(file)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    assert process.stdout.readline().startswith("open http://127.0.0.1:")
    time.sleep(1)
    process.send_signal(signal.SIGINT)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 0, told
    assert f"wrote {file}\nsee it move: pinmobile view {file}\n" in told
    run = pm.Rollout.load(file)
    assert run.t[-1] > 0.5
    assert "controller.kp" in run.signals
