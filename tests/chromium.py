"""A real headless Chromium, driven through the DevTools protocol over a pair of pipes."""

import base64
import json
import os
import select
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest
from PIL import Image

__all__ = ["Chromium", "Page", "chromium"]

_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-back-forward-cache",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--remote-debugging-pipe",
    "about:blank",
)


@contextmanager
def chromium() -> Iterator["Chromium"]:
    """Yield a browser; without one the test is skipped, or fails where the environment has CI=true."""
    program = next((found for name in _NAMES if (found := shutil.which(name))), None)
    if program is None:
        reason = f"needs a Chromium: none of {', '.join(_NAMES)} is on the PATH"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    with Chromium(program) as browser:
        yield browser


class Page:
    """A page in a window: what it logs and asks for is kept in `console` and `requests`."""

    def __init__(self, browser: "Chromium", session: str) -> None:
        self._browser, self._session = browser, session
        self.console: list[str] = []
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._loads = 0
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call("Log.clear")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        return self._browser.call(method, params, self._session)

    def open(self, url: str, timeout: float = 30.0) -> None:
        """Go to a page, and return when it is loaded."""
        self._navigate("Page.navigate", timeout, url=url)

    def reload(self, timeout: float = 30.0) -> None:
        self._navigate("Page.reload", timeout)

    def _navigate(self, method: str, timeout: float, **params: Any) -> None:
        loads = self._loads
        answer = self.call(method, **params)
        if "errorText" in answer:
            raise AssertionError(f"{method} {params}: {answer['errorText']}")
        self._browser.until(lambda: self._loads > loads, timeout, f"{method} {params} to load")

    def evaluate(self, script: str) -> Any:
        """Return the value of an expression, or what its promise resolves to."""
        answer = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise AssertionError(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait_for(self, script: str, timeout: float = 60.0) -> Any:
        """Return the value of an expression as soon as it is true."""
        end = time.monotonic() + timeout
        while not (value := self.evaluate(script)):
            assert time.monotonic() < end, f"not true within {timeout} s: {script}"
            time.sleep(0.02)
        return value

    def wait_for_changes(self, script: str, *signs: int, timeout: float = 60.0) -> None:
        """Return when a number, looked at in each frame, has grown (1) and fallen (-1), as asked for.

        Frames may be far apart on a busy machine: what an animation that repeats shows is compared with the
        frame before, never with a time that it may have passed unseen.
        """
        self.evaluate(
            "window.changes = new Set(); (last => { const look = () => { const now = " + script + ";"
            "window.changes.add(Math.sign(now - last)); last = now; requestAnimationFrame(look); };"
            "look(); })(" + script + ")"
        )
        self.wait_for(f"{json.dumps(signs)}.every(sign => window.changes.has(sign))", timeout)

    def resize(self, width: int, height: int) -> None:
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def frames(self, count: int = 2) -> None:
        """Let the page draw some frames."""
        ticks = "new Promise(done => requestAnimationFrame(done))"
        for _ in range(count):
            self.evaluate(ticks)

    def screenshot(self) -> Image.Image:
        """Return what the page shows, RGB."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        return Image.open(BytesIO(base64.b64decode(data))).convert("RGB")

    def close(self) -> None:
        self._browser.close_page(self._session)

    def on_event(self, method: str, params: dict[str, Any]) -> None:
        if method == "Page.loadEventFired":
            self._loads += 1
        elif method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.requests.append(params["url"])
        elif method == "Runtime.consoleAPICalled":
            text = " ".join(str(arg.get("value", arg.get("description"))) for arg in params["args"])
            self.console.append(f"{params['type']}: {text}")
            if params["type"] in ("error", "assert"):
                self.errors.append(text)
        elif method == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.errors.append(str(details.get("exception", {}).get("description", details["text"])))
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"] + " " + params["entry"].get("url", ""))


class Chromium:
    """A browser with a profile of its own; it and all its processes end with the block."""

    def __init__(self, program: str) -> None:
        self._profile = tempfile.mkdtemp(prefix="chromium-")
        command_in, self._out = os.pipe()
        self._in, command_out = os.pipe()
        null = os.open(os.devnull, os.O_RDWR)
        # Above 4 first: the browser reads from 3 and writes to 4, which may be ends of these pipes.
        high = [os.dup2(fd, 200 + k) for k, fd in enumerate((command_in, command_out))]
        actions = [(os.POSIX_SPAWN_DUP2, high[0], 3), (os.POSIX_SPAWN_DUP2, high[1], 4)]
        actions += [(os.POSIX_SPAWN_DUP2, null, fd) for fd in (0, 1, 2)]
        arguments = [program, f"--user-data-dir={self._profile}", *_FLAGS]
        self.pid = os.posix_spawn(program, arguments, os.environ, file_actions=actions, setpgroup=0)
        for fd in (command_in, command_out, null, *high):
            os.close(fd)
        self._buffer = bytearray()
        self._answers: dict[int, dict[str, Any]] = {}
        self._pages: dict[str, Page] = {}
        self._targets: dict[str, str] = {}
        self._idle: list[str] = []
        self._last = 0

    def __enter__(self) -> "Chromium":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()

    def page(self, width: int = 800, height: int = 600) -> Page:
        """Return an empty page of a size in pixels, in a window of its own.

        Of the tabs of one window all but the last made are hidden, and a hidden tab draws no frames: a
        picture of it waits for a frame that may never come. The window of a closed page is used again: its
        process knows the program that draws, which takes seconds to learn.
        """
        if self._idle:
            target = self._idle.pop()
        else:
            target = self.call("Target.createTarget", {"url": "about:blank", "newWindow": True})["targetId"]
        answer = self.call("Target.attachToTarget", {"targetId": target, "flatten": True})
        session = answer["sessionId"]
        self._targets[session] = target
        page = Page(self, session)
        self._pages[session] = page
        page.resize(width, height)
        return page

    def close_page(self, session: str) -> None:
        """Empty a page; with its session end its settings."""
        self._pages[session].open("about:blank")
        del self._pages[session]
        self.call("Target.detachFromTarget", {"sessionId": session})
        self._idle.append(self._targets.pop(session))

    def call(self, method: str, params: dict[str, Any], session: str | None = None) -> dict[str, Any]:
        self._last += 1
        number = self._last
        message = {"id": number, "method": method, "params": params}
        if session is not None:
            message["sessionId"] = session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._out, data) :]
        self.until(lambda: number in self._answers, 60.0, method)
        answer = self._answers.pop(number)
        if "error" in answer:
            raise AssertionError(f"{method}: {answer['error']}")
        return dict(answer["result"])

    def until(self, condition: Any, timeout: float, what: str) -> None:
        """Handle what the browser says until a condition holds."""
        end = time.monotonic() + timeout
        while not condition():
            left = end - time.monotonic()
            assert left > 0, f"waited {timeout} s for {what}"
            if not select.select([self._in], [], [], left)[0]:
                continue
            data = os.read(self._in, 1 << 20)
            assert data, f"the browser ended while it was asked for {what}"
            self._buffer += data
            while (end_of_message := self._buffer.find(b"\0")) >= 0:
                message = json.loads(self._buffer[:end_of_message])
                del self._buffer[: end_of_message + 1]
                self._handle(message)

    def _handle(self, message: dict[str, Any]) -> None:
        if "id" in message:
            self._answers[message["id"]] = message
        elif message.get("sessionId") in self._pages:
            self._pages[message["sessionId"]].on_event(message["method"], message["params"])

    def kill(self) -> None:
        """End the browser's process group, which is its own."""
        if self.pid == 0:
            return
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)
        # Its children end too, which takes a moment.
        end = time.monotonic() + 10
        while time.monotonic() < end:
            try:
                os.killpg(self.pid, 0)
            except ProcessLookupError:
                break
            time.sleep(0.01)
        self.pid = 0
        os.close(self._in)
        os.close(self._out)
        # A child that is still ending may write there once more.
        for _ in range(20):
            shutil.rmtree(self._profile, ignore_errors=True)
            if not Path(self._profile).exists():
                break
            time.sleep(0.05)
