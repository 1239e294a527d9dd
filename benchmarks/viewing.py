"""The viewer: 50 Hz held live, recordings' size and time.

python benchmarks/viewing.py [--quick] [--rounds N]

Live, a headless Chromium shows the page, drawn in software on the same processors. Without a Chromium this
part is left out.
"""

import json
import statistics
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import numpy as np
from measuring import about, console, last_line, options, say, table
from rich.console import Console
from task import GAIN, PD_GAINS, RADIUS, RATE

from memory import resident
from pinmobile import PD, Circle, ComputedTorque, MobileRobot, Tangent, simulate
from pinmobile.errors import ViewerError
from pinmobile.viewer import Viewer, play
from pinmobile.viewer.recording import Browser, find_chromium

NO_CHROMIUM = "not installed: apt-get install chromium"
PERIOD = 0.02  # [s] between two poses
DURATION = 60.0  # of the recorded rollouts [s]
LIMITS = {10_000: ("3", "8")}  # frames: [s] for record and save_html, [MB]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = options(__doc__.splitlines()[0])
    parser.add_argument("--record", type=int, help="record this many frames in this process, and print JSON")
    chosen = parser.parse_args(arguments)
    if chosen.record is not None:
        print("\n" + json.dumps(recorded(chosen.record)))
        return 0
    rounds = chosen.rounds or (1 if chosen.quick else 5)
    out = console()
    out.print(about())
    sound = True
    try:
        find_chromium()
    except ViewerError:
        say(out, [f"live: {NO_CHROMIUM}"])
    else:
        sound &= attempt(out, "live", lambda: show_live(out, 2.0 if chosen.quick else 10.0))
        sound &= attempt(out, "play", lambda: show_play(out, 3 if chosen.quick else 10))
    sizes = (600,) if chosen.quick else (600, 10_000)
    sound &= attempt(out, "recording", lambda: show_recordings(out, sizes, rounds))
    return 0 if sound else 1


def attempt(out: Console, what: str, part: Callable[[], None]) -> bool:
    """Return whether a part of the benchmark went through; say why it did not."""
    try:
        part()
    except Exception as error:  # the parts fail in meshcat's, zmq's and the browser's own ways
        say(out, [f"{what}: FAILED: {type(error).__name__}: {error}"])
        return False
    return True


@dataclass
class Pace:
    """What a number of steps at a fixed rate were."""

    took: float = 0.0  # [s]
    late: int = 0  # steps not done when the next was due
    lag: float = 0.0  # the longest by which one was not [s]
    times: list[float] = field(default_factory=list)  # of the calls [s]


def paced(display: Callable[[Any], None], poses: np.ndarray) -> Pace:
    """Return how `display` kept up with a pose each 20 ms."""
    pace = Pace()
    begin = perf_counter()
    for step, pose in enumerate(poses, start=1):
        start = perf_counter()
        display(pose)
        end = perf_counter()
        pace.times.append(end - start)
        left = begin + step * PERIOD - end
        pace.late += left < 0
        pace.lag = max(pace.lag, -left)
        sleep(max(left, 0.0))
    pace.took = perf_counter() - begin
    return pace


def circle(count: int) -> np.ndarray:
    """Return poses (x, y, psi) along the circle."""
    angle = RATE * PERIOD * np.arange(count)
    return np.column_stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), angle + np.pi / 2])


def look_at(browser: Browser, url: str) -> None:
    """Open a live page in a browser, and return when it is connected and has drawn."""
    browser.open(url)
    browser.wait_for("viewer.connection && viewer.connection.readyState === 1")
    count = "viewer.connection.addEventListener('message', () => { window.messages += 1; })"
    browser.evaluate(f"window.messages = 0; {count}")
    frame = "new Promise((done) => requestAnimationFrame(() => done(1)))"
    for _ in range(5):
        browser.evaluate(frame)


def messages(browser: Browser) -> int:
    """Return how many messages the page has got since it was opened.

    Raises
    ------
    RuntimeError
        If there are none: then nobody was looking.
    """
    got = int(browser.evaluate("window.messages"))
    if not got:
        raise RuntimeError("nothing has come to the browser")
    return got


def quiet_browser() -> Browser:
    """Return a browser that does not report what comes over the network, which would load it."""
    browser = Browser(timeout=30.0)
    browser.call("Network.disable")
    return browser


def show_live(out: Console, duration: float) -> None:
    count = round(duration / PERIOD)
    poses = circle(count)
    with (
        out.status("showing live"),
        quiet_browser() as browser,
        Viewer(MobileRobot.lecture(), live=True) as viewer,
    ):
        viewer.display(poses[0])
        look_at(browser, viewer.url)
        viewer.wait(10.0)
        pace = paced(viewer.display, poses)
        got = messages(browser)
    shown = table("\nLive, a browser attached", f"{count:,} poses at {1 / PERIOD:.0f} Hz", "unit", "value")
    shown.add_row("duration", "s", f"{pace.took:.3f}")
    shown.add_row("planned", "s", f"{duration:.3f}")
    shown.add_row("late steps", "", f"{pace.late}")
    shown.add_row("latest by", "ms", f"{1e3 * pace.lag:.1f}")
    shown.add_row("display, mean", "ms", f"{1e3 * statistics.mean(pace.times):.2f}")
    shown.add_row("display, largest", "ms", f"{1e3 * max(pace.times):.2f}")
    shown.add_row("messages to the browser", "1/s", f"{got / pace.took:.0f}")
    out.print(shown)


def show_play(out: Console, seconds: int) -> None:
    """Show the frames of a run in real time beside those of an empty page."""
    robot = MobileRobot.lecture()
    circle = Tangent(Circle(3.0, 0.1, 60.0))
    frames = "new Promise((done) => { let n = 0; const end = performance.now() + 1000;"
    frames += "(function f(now) { now < end ? (n += 1, requestAnimationFrame(f)) : done(n); })(0); })"
    with out.status("playing"), quiet_browser() as browser:
        browser.open("about:blank")
        empty = [browser.evaluate(frames) for _ in range(seconds)]
        with play(robot, ComputedTorque(robot, 10, 6), circle, dt=0.01) as run:
            browser.open(run.url)
            browser.wait_for("window.pinmobile?.play?.fps > 0")
            drawn = [
                browser.evaluate(f"{frames}.then(() => [pinmobile.play.fps, pinmobile.play.scene])")
                for _ in range(seconds)
            ]
    page, scene = np.median(drawn, axis=0)
    shown = table("\nplay, frames in the browser", f"median of {seconds} s", "1/s")
    shown.add_row("empty page", f"{np.median(empty):.0f}")
    shown.add_row("page of a run", f"{page:.0f}")
    shown.add_row("changes of the scene", f"{scene:.0f}")
    out.print(shown)


def show_recordings(out: Console, sizes: Sequence[int], rounds: int) -> None:
    columns = ("frames", "", "record, s", "save_html, s", "both, s", "limit", "MB", "limit", "peak, MiB")
    title = "\nRecording of the lecture's circle: path, trails, PD as a ghost beside computed torque"
    shown = table(title, *columns)
    for frames in sizes:
        with out.status(f"recording {frames:,} frames"):
            runs = np.array([in_fresh_process(frames) for _ in range(rounds)])
        record, save, size, before, peak = np.median(runs, axis=0)
        time_limit, size_limit = LIMITS.get(frames, ("", ""))
        both = np.median(runs[:, 0] + runs[:, 1])
        times = (f"{record:.2f}", f"{save:.2f}", f"{both:.2f}", time_limit)
        shown.add_row(
            f"{frames:,}", "", *times, f"{size:.2f}", size_limit, f"{peak:.0f} ({before:.0f} before)"
        )
    out.print(shown)
    say(out, [f"medians of {rounds} fresh processes; the memory is the whole process's"])


def in_fresh_process(frames: int) -> list[float]:
    said = last_line([sys.executable, "-W", "ignore", __file__, "--record", str(frames)])
    if said.startswith("FAILED"):
        raise RuntimeError(said)
    return list(json.loads(said))


def recorded(frames: int) -> list[float]:
    """Return the time to record and to write [s], the page's size [MB], memory before and at peak [MiB]."""
    robot, reference = MobileRobot.lecture(), Tangent(Circle(RADIUS, RATE, DURATION))
    controllers = {"computed torque": ComputedTorque(robot, GAIN, GAIN), "PD": PD(PD_GAINS, PD_GAINS)}
    dt = DURATION / (frames - 1)
    runs = {name: simulate(robot, one, reference, dt=dt) for name, one in controllers.items()}
    before = resident("VmRSS")
    with tempfile.TemporaryDirectory(prefix="pinmobile-") as folder, Viewer(robot) as viewer:
        start = perf_counter()
        recording = viewer.record(runs, fps=1 / dt)
        made = perf_counter()
        size = recording.save_html(Path(folder) / "circle.html").stat().st_size
        written = perf_counter()
    return [made - start, written - made, size / 1e6, before, resident("VmHWM")]


if __name__ == "__main__":
    sys.exit(main())
