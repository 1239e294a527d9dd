"""`Recording`: a scene and its motion as a page, or by Chromium as a GIF, a film or a picture."""

from __future__ import annotations

import base64
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from io import BytesIO
from os import PathLike
from pathlib import Path
from queue import SimpleQueue
from string import Template
from threading import Event
from time import monotonic
from types import ModuleType
from typing import Any

import numpy as np
from PIL import Image

from pinmobile.arrays import bounded, check_integer, positive, scalar, sequence, shaped
from pinmobile.compiled import processors
from pinmobile.errors import InvalidArgument, ViewerError, import_extra
from pinmobile.files import write, write_file
from pinmobile.viewer.pages import engine, loading_script, seal_page, stage_page

_NAMES = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge"),
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
)
_FLAGS = (
    *("--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-pipe"),
    *("--disable-background-networking", "--disable-dev-shm-usage", "--disable-extensions"),
    *("--no-first-run", "--hide-scrollbars", "--mute-audio", "--disable-gpu-compositing", "about:blank"),
)
_NO_SANDBOX = "--no-sandbox"
# Chromium reads commands from descriptor 3 and writes answers to descriptor 4.
_START = (
    "import fcntl, os, sys\n"
    "pair = [fcntl.fcntl(int(fd), fcntl.F_DUPFD, 10) for fd in sys.argv[1:3]]\n"
    "os.dup2(pair[0], 3); os.dup2(pair[1], 4)\n"
    "os.closerange(5, 256)\n"
    "os.execv(sys.argv[3], sys.argv[3:])\n"
)


def find_chromium() -> str:
    """Return the path of a Chromium; the environment variable ``PINMOBILE_CHROMIUM`` has precedence.

    Raises
    ------
    ViewerError
        If there is no Chromium.
    """
    selected = os.environ.get("PINMOBILE_CHROMIUM")
    for name in (selected,) if selected else _NAMES:
        path = shutil.which(name)
        if path is not None:
            return path
    raise ViewerError(
        f"PINMOBILE_CHROMIUM is {selected!r}, expected a program"
        if selected
        else "no Chromium was found, which draws pictures without a screen: install the package 'chromium' "
        "(or Chrome), or set the environment variable PINMOBILE_CHROMIUM to its program"
    )


class Browser:
    """Headless browser with one page, as a context manager. It opens no port.

    Parameters
    ----------
    size : tuple of 2 int
        Width and height of the page [px].
    timeout : float
        Longest time for each call [s].

    Attributes
    ----------
    events : list of dict
        Reports of the browser: requests, console messages of the page, errors.

    Raises
    ------
    ViewerError
        If there is no browser, or the browser does not start or does not answer in time.
    """

    def __init__(self, size: tuple[int, int] = (1200, 800), *, timeout: float = 60.0) -> None:
        self.timeout, self._buffer, self._last = timeout, b"", 0
        self.events: list[dict[str, Any]] = []
        program = find_chromium()
        self._profile = tempfile.TemporaryDirectory(prefix="pinmobile-", ignore_cleanup_errors=True)
        self._log = Path(self._profile.name) / "stderr"
        (inner, self._to), (self._from, outer) = os.pipe(), os.pipe()
        argv = [sys.executable, "-I", "-S", "-c", _START, str(inner), str(outer), program, *_FLAGS]
        argv += [_NO_SANDBOX] if os.geteuid() == 0 else []  # Chromium has no sandbox for root
        argv += [f"--user-data-dir={self._profile.name}", f"--window-size={size[0]},{size[1]}"]
        null = subprocess.DEVNULL
        try:
            # A new session: Ctrl-C then reaches this process only, which ends the browser in order.
            with self._log.open("wb") as log:
                self._process = subprocess.Popen(
                    argv, pass_fds=(inner, outer), stdin=null, stdout=null, stderr=log, start_new_session=True
                )
        finally:
            os.close(inner)
            os.close(outer)
        with ExitStack() as failure:
            failure.callback(self.close)
            self._session = ""
            targets = self.call("Target.getTargets")["targetInfos"]
            page = next(target["targetId"] for target in targets if target["type"] == "page")
            self._session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
            for domain in ("Page", "Runtime", "Network", "Log"):
                self.call(f"{domain}.enable")
            width, height = size
            metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            self.call("Emulation.setDeviceMetricsOverride", **metrics)
            failure.pop_all()

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """End the browser and remove its files."""
        if self._to < 0:
            return
        os.close(self._to)  # the browser ends when its pipe closes
        self._to = -1
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            # The session of the browser includes its helper processes.
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        os.close(self._from)
        self._profile.cleanup()

    def open(self, url: str) -> None:
        """Load a page and wait until it is complete."""
        self.call("Page.navigate", url=url)
        self.wait_for("document.readyState === 'complete'")

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression or of its promise.

        Raises
        ------
        ViewerError
            If the expression fails.
        """
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            reason = details.get("exception", {}).get("description", details.get("text", ""))
            raise ViewerError(f"the page failed at {expression[:60]!r}: {reason}")
        return answer["result"].get("value")

    def wait_for(self, expression: str) -> None:
        """Wait until a JavaScript expression is true.

        Raises
        ------
        ViewerError
            If the expression stays false until the timeout.
        """
        end = monotonic() + self.timeout
        while not self.evaluate(f"Boolean({expression})"):
            if monotonic() > end:
                raise ViewerError(f"the page did not fulfil {expression!r} within {self.timeout:g} s")
            self.evaluate("new Promise((done) => setTimeout(done, 20))")

    def picture(self, *, fast: bool = False) -> bytes:
        """Return the page as a PNG; with `fast`, less compressed."""
        answer = self.call("Page.captureScreenshot", format="png", optimizeForSpeed=fast)
        return base64.b64decode(answer["data"])

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """Call a method of the DevTools protocol and return its result.

        Raises
        ------
        ViewerError
            If the browser refuses the call, has ended, or does not answer within the timeout.
        """
        if self._to < 0:
            raise ViewerError("the browser is closed")
        self._last += 1
        message: dict[str, object] = {"id": self._last, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        end = monotonic() + self.timeout
        try:
            self._write(json.dumps(message).encode() + b"\0", end)
            while True:
                answer = self._read(end)
                if answer.get("id") == self._last:
                    break
                if "method" in answer:
                    self.events.append(answer)
        except OSError as error:
            raise ViewerError(
                f"the browser has ended ({error.strerror}); its program is {find_chromium()}{self._advice()}"
            ) from None
        if "error" in answer:
            raise ViewerError(f"the browser refused {method}: {answer['error'].get('message')}")
        return dict(answer["result"])

    def _advice(self) -> str:
        """Return advice if the sandbox could not start, otherwise ""."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(1)  # the browser writes its log before it ends
        if not re.search("sandbox|namespace", self._log.read_text(encoding="utf-8", errors="replace")):
            return ""
        return (
            ", whose sandbox cannot start here: allow user namespaces, or set PINMOBILE_CHROMIUM to a "
            f'script that runs Chromium without a sandbox: exec chromium {_NO_SANDBOX} "$@"'
        )

    def _wait(self, readable: list[int], writable: list[int], end: float) -> None:
        if not any(select.select(readable, writable, [], max(end - monotonic(), 0))):
            raise ViewerError(f"the browser did not answer within {self.timeout:g} s")

    def _write(self, data: bytes, end: float) -> None:
        while data:
            self._wait([], [self._to], end)
            data = data[os.write(self._to, data[:4096]) :]

    def _read(self, end: float) -> dict[str, Any]:
        pieces = [self._buffer]
        while b"\0" not in pieces[-1]:
            self._wait([self._from], [], end)
            piece = os.read(self._from, 1 << 20)
            if not piece:
                raise BrokenPipeError(32, "its pipe is closed")
            pieces.append(piece)
        text, _, self._buffer = b"".join(pieces).partition(b"\0")
        return dict(json.loads(text))


_LOAD = """<script type="application/json" id="animation">$animation</script>
<script>
$loading
const animation = JSON.parse(document.getElementById("animation").textContent);
if (animation.tracks.length) pinmobile.play(animation.tracks, animation.speed, animation.end);
</script>"""


def recording_page(title: str, commands: Iterable[bytes], animation: dict[str, object]) -> str:
    """Return a self-contained page.

    Parameters
    ----------
    title : str
        Title of the page.
    commands : iterable of bytes
        Packed meshcat commands.
    animation : dict
        Meshcat animations ``tracks``, initial ``speed``, and last time ``end`` [s].
    """
    packed = json.dumps(animation, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    scene = Template(_LOAD).substitute(animation=packed, loading=loading_script(commands))
    return seal_page(stage_page(title, f"<script>\n{engine()}\n</script>", scene))


_BATCH = 8  # frames that a browser draws at a time
_BROWSERS = 4  # largest number of browsers; each draws by software on one processor
_LAST_DURATION = 1.0  # [s], duration of the last frame
_COLOURS = 128
_PALETTE_FRAMES = 8  # frames that determine the palette of a GIF


def gif(frames: Iterator[Image.Image], rate: float) -> bytes:
    """Return a GIF with one palette, from eight frames between its beginning and its end.

    Parameters
    ----------
    frames : iterator of Image
        Frames of one size.
    rate : float
        Frames per second.
    """
    pictures = list(frames)  # not decoded yet: about ten kilobytes each
    samples = [pictures[k] for k in np.unique(np.linspace(0, len(pictures) - 1, _PALETTE_FRAMES).astype(int))]
    width, height = pictures[0].size
    mosaic = Image.new("RGB", (width, height * len(samples)))
    for k, picture in enumerate(samples):
        mosaic.paste(picture.convert("RGB"), (0, height * k))
    palette = mosaic.quantize(_COLOURS, dither=Image.Dither.NONE)
    images = [p.convert("RGB").quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
    ticks = np.round(100 * np.arange(len(images) + 1) / rate).astype(int)
    durations = [int(10 * tick) for tick in np.diff(ticks)]
    durations[-1] = round(1000 * _LAST_DURATION)
    buffer = BytesIO()
    images[0].save(buffer, "GIF", save_all=True, append_images=images[1:], duration=durations, loop=0)
    return buffer.getvalue()


def film_encoder() -> ModuleType:
    """Return the module imageio-ffmpeg of the extra ``pinmobile[mp4]``.

    Raises
    ------
    ViewerError
        If imageio-ffmpeg is not installed.
    """
    return import_extra("imageio_ffmpeg", "mp4", "a film", ViewerError)  # type: ignore[no-any-return]


def check_films() -> None:
    """Check that this machine can make films.

    Raises
    ------
    ViewerError
        If Chromium or imageio-ffmpeg is missing.
    """
    find_chromium()
    film_encoder()


def film(encoder: ModuleType, frames: Iterator[Image.Image], rate: float, size: tuple[int, int]) -> bytes:
    """Return a film (MP4).

    Parameters
    ----------
    encoder : module
        Module of `film_encoder`.
    frames : iterator of Image
        Frames of the given size.
    rate : float
        Frames per second.
    size : tuple of 2 int
        Width and height [px], even numbers.
    """
    with tempfile.TemporaryDirectory(prefix="pinmobile-") as folder:
        file = Path(folder) / "film.mp4"
        writer = encoder.write_frames(str(file), size, fps=rate, macro_block_size=2, ffmpeg_log_level="error")
        writer.send(None)
        try:
            for frame in frames:
                writer.send(frame.convert("RGB").tobytes())
        finally:
            writer.close()
        return file.read_bytes()


Progress = Callable[[int, int], object]


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return checked width and height [px].

    Raises
    ------
    InvalidArgument
        If they are not two whole numbers of at least 16.
    """
    width, height = shaped("size", sequence("size", size, "width and height"), (2,))
    return check_integer("size[0]", width, least=16), check_integer("size[1]", height, least=16)


def take_picture(html: str, size: tuple[int, int], time: float) -> bytes:
    """Return a picture of a page at a time as a PNG.

    Parameters
    ----------
    html : str
        Page of `recording_page`.
    size : tuple of 2 int
        Width and height [px].
    time : float
        Time since the start of the rollout [s].

    Raises
    ------
    InvalidArgument
        If `size` is invalid.
    ViewerError
        If Chromium is missing or fails.
    """
    with _open_page(html, size) as browser:
        return _picture(browser, time)


def _take_pictures(
    html: str, size: tuple[int, int], times: Sequence[float], progress: Progress | None
) -> Iterator[Image.Image]:
    """Yield pictures of a page at several times; errors are those of `take_picture`.

    Parameters
    ----------
    html : str
        Page of `recording_page`.
    size : tuple of 2 int
        Width and height [px].
    times : sequence of float
        Times since the start of the rollout [s].
    progress : callable or None
        Function ``progress(done, total)`` that is called after each picture.
    """
    batches = [times[k : k + _BATCH] for k in range(0, len(times), _BATCH)]
    count = max(1, min(_BROWSERS, processors(), len(batches) // 2))
    idle: SimpleQueue[Browser] = SimpleQueue()
    stop = Event()

    def take(batch: Sequence[float]) -> list[bytes]:
        browser = idle.get()
        try:
            return [_picture(browser, time, fast=True) for time in batch if not stop.is_set()]
        finally:
            idle.put(browser)

    with ExitStack() as stack, ThreadPoolExecutor(count) as pool:
        try:
            for browser in pool.map(lambda _: stack.enter_context(_open_page(html, size)), range(count)):
                idle.put(browser)
            frames = (data for batch in pool.map(take, batches) for data in batch)
            for done, data in enumerate(frames, 1):
                yield Image.open(BytesIO(data))
                if progress is not None:
                    progress(done, len(times))
        finally:
            stop.set()


def _picture(browser: Browser, time: float, *, fast: bool = False) -> bytes:
    browser.evaluate(f"pinmobile.seek({float(time)!r})")
    return browser.picture(fast=fast)


@contextmanager
def _open_page(html: str, size: tuple[int, int]) -> Iterator[Browser]:
    with tempfile.TemporaryDirectory(prefix="pinmobile-") as folder:
        page = Path(folder) / "page.html"
        write(page, html.encode("utf-8"), name="page")
        with Browser(check_size(size)) as browser:
            browser.open(page.as_uri())
            browser.wait_for("pinmobile.ready()")
            browser.evaluate("document.body.classList.add('bare')")
            yield browser


_MAX_RATE = 50.0  # [1/s]; browsers slow down GIFs that are faster


class Recording:
    """Recorded scene and motion: the result of `Viewer.record`.

    Parameters
    ----------
    commands : list of bytes
        Packed meshcat commands of the scene.
    tracks : list of dict
        Meshcat animations, in seconds of the rollout.
    duration : float
        Duration of the rollout [s].
    fps : float
        Frames per second.
    speed : float
        Seconds of the rollout per second of playback.
    title : str
        Title of the page.

    See Also
    --------
    viewer.Viewer : its method ``record`` makes a recording
    plots.animate : GIF from above, without Chromium

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import simulate
    >>> from pinmobile.viewer import Viewer
    >>> robot, circle = MobileRobot(30.0, 1.3), Circle(1.0, 1.0, 1.0)
    >>> run = simulate(robot, PD(9, 6), Tangent(circle), dt=0.1)
    >>> recording = Viewer(robot).record(run, fps=10, title="Circle")
    >>> recording.duration  # [s]
    1.0
    >>> "<title>Circle</title>" in recording.html()
    True
    """

    def __init__(
        self,
        commands: list[bytes],
        tracks: list[dict[str, Any]],
        *,
        duration: float,
        fps: float,
        speed: float,
        title: str,
    ) -> None:
        self.tracks, self.duration, self.fps, self.speed, self.title = tracks, duration, fps, speed, title
        self._commands = commands

    def __repr__(self) -> str:
        rates = f"{self.fps:g} frames per second, {self.speed:g} times as fast"
        return f"<Recording: {self.duration:g} s, {rates}>"

    def html(self) -> str:
        """Return a self-contained page that plays the recording, as HTML. The page makes no request."""
        animation = {"tracks": self.tracks, "speed": self.speed, "end": self.duration}
        return recording_page(self.title, self._commands, animation)

    def save_html(self, path: str | PathLike[str]) -> Path:
        """Write a self-contained page that plays the recording. It opens from the file system.

        Parameters
        ----------
        path : str or path-like
            File to write, with the suffix ``.html``. It replaces an existing file.

        Returns
        -------
        path : pathlib.Path
            The file.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, for example because the disk is full. An existing file remains unchanged.
        """
        return write_file(path, ".html", lambda: self.html().encode("utf-8"))

    def save_gif(
        self,
        path: str | PathLike[str],
        *,
        fps: float | None = None,
        size: tuple[int, int] = (720, 480),
        progress: Progress | None = None,
    ) -> Path:
        """Write a GIF. A headless Chromium draws its frames.

        Parameters
        ----------
        path : str or path-like
            File to write, with the suffix ``.gif``.
        fps : float, optional
            Frames per second, at most 50; default: those of the recording, at most 25.
        size : tuple of 2 int
            Width and height [px].
        progress : callable, optional
            Function ``progress(done, total)`` that is called after each frame.

        Returns
        -------
        path : pathlib.Path
            The file.

        Raises
        ------
        InvalidArgument
            If the file cannot be written, or an argument is invalid.
        FileError
            If the system fails, for example because the disk is full. An existing file remains unchanged.
        ViewerError
            If Chromium is missing or fails.
        """
        rate = scalar("fps", min(self.fps, 25.0) if fps is None else fps)
        bounded("fps", rate, above=0, most=_MAX_RATE, unit="1/s")
        return write_file(path, ".gif", lambda: gif(self._frames(rate, size, progress), rate))

    def save_mp4(
        self,
        path: str | PathLike[str],
        *,
        fps: float | None = None,
        size: tuple[int, int] = (1280, 720),
        progress: Progress | None = None,
    ) -> Path:
        """Write a film by a headless Chromium and imageio-ffmpeg (extra ``pinmobile[mp4]``).

        Parameters
        ----------
        path : str or path-like
            File to write, with the suffix ``.mp4``.
        fps : float, optional
            Frames per second; default: those of the recording.
        size : tuple of 2 int
            Width and height [px], even numbers.
        progress : callable, optional
            Function ``progress(done, total)`` that is called after each frame.

        Returns
        -------
        path : pathlib.Path
            The file.

        Raises
        ------
        InvalidArgument
            If the file cannot be written, or an argument is invalid.
        FileError
            If the system fails, for example because the disk is full. An existing file remains unchanged.
        ViewerError
            If Chromium or imageio-ffmpeg is missing or fails.
        """
        encoder = film_encoder()
        rate, even = positive("fps", self.fps if fps is None else fps, "1/s"), check_size(size)
        if even[0] % 2 or even[1] % 2:
            raise InvalidArgument(f"size is {size}, expected even numbers")
        return write_file(path, ".mp4", lambda: film(encoder, self._frames(rate, size, progress), rate, even))

    def screenshot(
        self, path: str | PathLike[str], *, t: float = 0.0, size: tuple[int, int] = (1200, 800)
    ) -> Path:
        """Write a picture of the scene at a time (PNG). A headless Chromium draws it.

        Parameters
        ----------
        path : str or path-like
            File to write, with the suffix ``.png``.
        t : float
            Time since the start of the rollout [s].
        size : tuple of 2 int
            Width and height [px].

        Returns
        -------
        path : pathlib.Path
            The file.

        Raises
        ------
        InvalidArgument
            If the file cannot be written, or `t` is outside the recording.
        FileError
            If the system fails, for example because the disk is full. An existing file remains unchanged.
        ViewerError
            If Chromium is missing or fails.
        """
        time = bounded("t", scalar("t", t), least=0, most=self.duration, unit="s")
        return write_file(path, ".png", lambda: take_picture(self.html(), size, time))

    def _frames(self, rate: float, size: tuple[int, int], progress: Progress | None) -> Iterator[Image.Image]:
        times = np.append(np.arange(0.0, self.duration, self.speed / rate), self.duration)
        return _take_pictures(self.html(), size, times.tolist(), progress)
