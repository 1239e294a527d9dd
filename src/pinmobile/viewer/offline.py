"""`OfflineWindow`: a scene in memory, for recordings, notebooks and tests."""

from typing import Any, NoReturn

from pinmobile.errors import ViewerError
from pinmobile.viewer.backlog import Backlog
from pinmobile.viewer.page import loading, sealed
from pinmobile.viewer.stock import ENGINE

__all__ = ["OfflineWindow", "static_page"]

_SCRIPT, _CONNECT = '<script type="text/javascript" src="main.min.js">', "viewer.connect();"


class OfflineWindow:
    """A scene in memory: ``meshcat.Visualizer(window=OfflineWindow())``. No process, no port, no thread."""

    def __init__(self) -> None:
        self._backlog, self._closed = Backlog(), False

    def __enter__(self) -> "OfflineWindow":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<OfflineWindow: {self.scene_size} bytes>"

    @property
    def scene_size(self) -> int:
        """Of the commands that make the scene [byte]."""
        return self._backlog.size

    @property
    def web_url(self) -> str:
        """An offline window has none: raises ViewerError."""
        self._refuse("has no address")

    def send(self, command: Any) -> None:
        """Take a command of meshcat's.

        Raises
        ------
        InvalidArgument
            If it is none, or holds a number that is not finite.
        ViewerError
            If the window is closed.
        """
        if self._closed:
            raise ViewerError("the window is closed")
        self._backlog.put(command)
        self._backlog.forget_deletions(self._backlog.latest)  # there is nobody to be told of them

    def commands(self) -> list[bytes]:
        """Return the commands that make the scene, as they would be sent, the animation last."""
        return self._backlog.since(0)[0]

    def get_scene(self) -> str:
        """Return meshcat's page with the scene in it: self-contained, without a request to anywhere."""
        return static_page(self.commands())

    static_html = get_scene

    def get_image(self, w: int | None = None, h: int | None = None) -> NoReturn:
        """Raise ViewerError: nothing draws an offline window."""
        self._refuse("draws nothing")

    def wait(self, timeout: float = 0.0) -> NoReturn:
        """Raise ViewerError at once: no browser can come."""
        self._refuse("has no browser to wait for")

    def close(self) -> None:
        """Take no more commands; the scene remains."""
        self._closed = True

    def _refuse(self, what: str) -> NoReturn:
        raise ViewerError(f"an offline window {what}: use a live one, or open its static_html() in a browser")


def static_page(commands: list[bytes]) -> str:
    """Return meshcat's own page with its script and a scene in it."""
    page = ENGINE.with_name("index.html").read_text(encoding="utf-8")
    if _SCRIPT not in page or _CONNECT not in page:
        raise ViewerError(f"the page of the installed meshcat has changed: {ENGINE.with_name('index.html')}")
    head, _, rest = page.partition(_SCRIPT)
    body = rest.replace(_CONNECT, loading(commands))
    return sealed(f"{head}<script>\n{ENGINE.read_text(encoding='utf-8')}\n{body}")
