"""A headless Chromium: found on the machine, driven through a pipe, gone when it is left."""

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
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any

from pinmobile.errors import ViewerError

_NAMES = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
)
_FLAGS = (
    "--headless=new",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-dev-shm-usage",
    "--disable-extensions",
    "--no-first-run",
    "--hide-scrollbars",
    "--mute-audio",
    "--remote-debugging-pipe",
    "about:blank",
)
_NO_SANDBOX = "--no-sandbox"
# Chromium reads commands from descriptor 3 and answers on descriptor 4.
_START = (
    "import fcntl, os, sys\n"
    "pair = [fcntl.fcntl(int(fd), fcntl.F_DUPFD, 10) for fd in sys.argv[1:3]]\n"
    "os.dup2(pair[0], 3); os.dup2(pair[1], 4)\n"
    "os.closerange(5, 256)\n"
    "os.execv(sys.argv[3], sys.argv[3:])\n"
)


def find_chromium() -> str:
    """Return the path of a Chromium, of ``PINMOBILE_CHROMIUM`` if that is set.

    Raises
    ------
    ViewerError
        If there is none.
    """
    chosen = os.environ.get("PINMOBILE_CHROMIUM")
    for name in (chosen,) if chosen else _NAMES:
        found = shutil.which(name)
        if found is not None:
            return found
    raise ViewerError(
        f"PINMOBILE_CHROMIUM is {chosen!r}, which is no program"
        if chosen
        else "no Chromium was found, which draws pictures without a screen: install the package 'chromium' "
        "(or Chrome), or name its program in the environment variable PINMOBILE_CHROMIUM"
    )


class Browser:
    """A headless browser with one page, as a context manager. No port is opened.

    Parameters
    ----------
    size : tuple of 2 int
        Width and height of the page [px].
    timeout : float
        For each call [s].

    Attributes
    ----------
    events : list of dict
        What the browser reported: requests, messages of the page's console, errors.

    Raises
    ------
    ViewerError
        If there is no browser, it does not start, or does not answer in time.
    """

    def __init__(self, size: tuple[int, int] = (1200, 800), *, timeout: float = 60.0) -> None:
        self.timeout, self._rest, self._last = timeout, b"", 0
        self.events: list[dict[str, Any]] = []
        program = find_chromium()
        self._profile = tempfile.TemporaryDirectory(prefix="pinmobile-", ignore_cleanup_errors=True)
        self._log = Path(self._profile.name) / "stderr"
        (inner, self._to), (self._from, outer) = os.pipe(), os.pipe()
        words = [sys.executable, "-I", "-S", "-c", _START, str(inner), str(outer), program, *_FLAGS]
        words += [_NO_SANDBOX] if os.geteuid() == 0 else []  # Chromium has none for root
        words += [f"--user-data-dir={self._profile.name}", f"--window-size={size[0]},{size[1]}"]
        off = subprocess.DEVNULL
        try:
            # In a session of its own, so that Ctrl-C reaches us alone and we end it in order.
            with self._log.open("wb") as log:
                self._process = subprocess.Popen(
                    words, pass_fds=(inner, outer), stdin=off, stdout=off, stderr=log, start_new_session=True
                )
        finally:
            os.close(inner)
            os.close(outer)
        try:
            self._session = ""
            targets = self.call("Target.getTargets")["targetInfos"]
            page = next(target["targetId"] for target in targets if target["type"] == "page")
            attached = self.call("Target.attachToTarget", targetId=page, flatten=True)
            self._session = attached["sessionId"]
            for domain in ("Page", "Runtime", "Network", "Log"):
                self.call(f"{domain}.enable")
            width, height = size
            metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            self.call("Emulation.setDeviceMetricsOverride", **metrics)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """End the browser and remove what it wrote."""
        if self._to < 0:
            return
        os.close(self._to)  # it ends by itself when its pipe does
        self._to = -1
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            # It is the first of a session of its own, with all its helpers.
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        os.close(self._from)
        self._profile.cleanup()

    def open(self, url: str) -> None:
        """Go to a page and wait until it has loaded."""
        self.call("Page.navigate", url=url)
        self.wait_for("document.readyState === 'complete'")

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, which may be a promise.

        Raises
        ------
        ViewerError
            If it raises.
        """
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            told = details.get("exception", {}).get("description", details.get("text", ""))
            raise ViewerError(f"the page failed at {expression[:60]!r}: {told}")
        return answer["result"].get("value")

    def wait_for(self, expression: str) -> None:
        """Wait until a JavaScript expression is true.

        Raises
        ------
        ViewerError
            If it is not within the timeout.
        """
        end = monotonic() + self.timeout
        while not self.evaluate(f"Boolean({expression})"):
            if monotonic() > end:
                raise ViewerError(f"the page did not reach {expression!r} within {self.timeout:g} s")
            self.evaluate("new Promise((done) => setTimeout(done, 20))")

    def picture(self, *, fast: bool = False) -> bytes:
        """Return the page as a PNG, a larger one if it is to be `fast`."""
        answer = self.call("Page.captureScreenshot", format="png", optimizeForSpeed=fast)
        return base64.b64decode(answer["data"])

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """Call a method of the DevTools protocol and return its result.

        Raises
        ------
        ViewerError
            If the browser refuses, has gone, or does not answer within the timeout.
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
                f"the browser has gone ({error.strerror}); it was {find_chromium()}{self._advice()}"
            ) from None
        if "error" in answer:
            raise ViewerError(f"the browser refused {method}: {answer['error'].get('message')}")
        return dict(answer["result"])

    def _advice(self) -> str:
        """Return what to do where its sandbox could not start, else nothing."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(1)  # what it says comes before its end
        if not re.search("sandbox|namespace", self._log.read_text(encoding="utf-8", errors="replace")):
            return ""
        return (
            ", whose sandbox cannot start here: allow user namespaces to it, or set PINMOBILE_CHROMIUM to a "
            f'script that runs it without: exec chromium {_NO_SANDBOX} "$@"'
        )

    def _write(self, data: bytes, end: float) -> None:
        while data:
            _, ready, _ = select.select([], [self._to], [], max(end - monotonic(), 0))
            if not ready:
                raise ViewerError(f"the browser did not take a command within {self.timeout:g} s")
            data = data[os.write(self._to, data[:4096]) :]

    def _read(self, end: float) -> dict[str, Any]:
        pieces = [self._rest]
        while b"\0" not in pieces[-1]:
            ready, _, _ = select.select([self._from], [], [], max(end - monotonic(), 0))
            if not ready:
                raise ViewerError(f"the browser did not answer within {self.timeout:g} s")
            piece = os.read(self._from, 1 << 20)
            if not piece:
                raise BrokenPipeError(32, "its pipe is closed")
            pieces.append(piece)
        text, _, self._rest = b"".join(pieces).partition(b"\0")
        return dict(json.loads(text))
