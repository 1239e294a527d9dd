"""Pages of the library's own headless browser, and what they log and ask for."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, Any

import pytest
from PIL import Image

from pinmobile.errors import ViewerError

if TYPE_CHECKING:
    from pinmobile.viewer.recording import Browser

__all__ = ["Chromium", "Page", "chromium"]


@contextmanager
def chromium() -> Iterator[Chromium]:
    """Yield browsers; without one the test is skipped, or fails where the environment has CI=true."""
    from pinmobile.viewer.recording import find_chromium  # here: most tests need no viewer

    try:
        find_chromium()
    except ViewerError as error:
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)(str(error))
    with ExitStack() as opened:
        yield Chromium(opened)


class Chromium:
    """Browsers of one page each, which end with the stack; that of a closed page is used again."""

    def __init__(self, opened: ExitStack) -> None:
        self._opened = opened
        self.idle: list[Browser] = []

    def page(self, width: int = 800, height: int = 600) -> Page:
        """Return an empty page of a size in pixels."""
        from pinmobile.viewer.recording import Browser

        page = Page(self, self.idle.pop() if self.idle else self._opened.enter_context(Browser()))
        page.resize(width, height)
        return page


class Page:
    """A page: what it logs and asks for is kept in `console`, `errors` and `requests`."""

    def __init__(self, owner: Chromium, browser: Browser) -> None:
        self._owner, self._browser = owner, browser
        browser.events.clear()
        self.console: list[str] = []
        self.errors: list[str] = []
        self.requests: list[str] = []

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """Call a method of the DevTools protocol."""
        return self._browser.call(method, **parameters)

    def open(self, url: str) -> None:
        """Go to a page, and return when it is loaded."""
        self._browser.open(url)
        self._take()

    def evaluate(self, script: str) -> Any:
        """Return the value of an expression, or what its promise resolves to."""
        value = self._browser.evaluate(script)
        self._take()
        return value

    def wait_for(self, script: str) -> None:
        """Return as soon as an expression is true."""
        self._browser.wait_for(script)
        self._take()

    def wait_for_changes(self, script: str, *signs: int) -> None:
        """Return when a number, looked at in each frame, has grown (1) and fallen (-1), as asked for.

        Frames may be far apart on a busy machine: what an animation that repeats shows is compared with the
        frame before, never with a time that it may have passed unseen.
        """
        self.evaluate(
            "window.changes = new Set(); (last => { const look = () => { const now = " + script + ";"
            "window.changes.add(Math.sign(now - last)); last = now; requestAnimationFrame(look); };"
            "look(); })(" + script + ")"
        )
        self.wait_for(f"{json.dumps(signs)}.every(sign => window.changes.has(sign))")

    def resize(self, width: int, height: int) -> None:
        """Give the page a size in pixels."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)

    def frames(self, count: int = 2) -> None:
        """Let the page draw some frames."""
        for _ in range(count):
            self.evaluate("new Promise(done => requestAnimationFrame(done))")

    def screenshot(self) -> Image.Image:
        """Return what the page shows, RGB."""
        return Image.open(BytesIO(self._browser.picture())).convert("RGB")

    def close(self) -> None:
        """Empty the page, and lend its browser to the next one."""
        self.open("about:blank")
        self.call("Network.setBlockedURLs", urls=[])
        self._owner.idle.append(self._browser)

    def _take(self) -> None:
        """Sort what the browser has reported."""
        events, self._browser.events = self._browser.events, []
        for method, params in ((event["method"], event["params"]) for event in events):
            if method == "Network.requestWillBeSent":
                self.requests.append(params["request"]["url"])
            elif method == "Network.webSocketCreated":
                self.requests.append(params["url"])
            elif method == "Runtime.consoleAPICalled":
                text = " ".join(str(arg.get("value", arg.get("description"))) for arg in params["args"])
                self.console.append(f"{params['type']}: {text}")
            elif method == "Runtime.exceptionThrown":
                details = params["exceptionDetails"]
                self.errors.append(str(details.get("exception", {}).get("description", details["text"])))
            elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
                self.errors.append(params["entry"]["text"] + " " + params["entry"].get("url", ""))
