"""`LiveWindow`: a meshcat scene in browsers."""

from __future__ import annotations

import base64
import weakref
from collections.abc import Callable
from io import BytesIO

from PIL import Image, ImageOps

from pinmobile.arrays import check_integer, non_negative
from pinmobile.errors import ViewerError
from pinmobile.viewer.pages import ENGINE, Command, SceneWindow, part_of_page, stage_page
from pinmobile.viewer.server import Server, access_for, listening

_CAPTURE = 20.0  # [s], longest time for a browser to draw a picture
_ENGINE = '<script src="main.min.js{query}"></script>'
_CONNECT = (
    "<script>\nviewer.connect(`ws://${{location.host}}${{location.pathname}}socket{query}`);\n</script>"
)


class LiveWindow(SceneWindow):
    """A meshcat scene in browsers: ``meshcat.Visualizer(window=LiveWindow())``.

    A thread of this process serves the page until the window is closed or the process ends. Browsers receive
    the newest state at most 75 times per second. A new browser receives the whole scene. A slow browser
    misses states in between. Several threads may use a window at once. A window is closed in a forked
    child. At most 64 browsers can show it.

    Parameters
    ----------
    host : str
        Address to serve at. Only this machine can reach the default. Another address causes a warning, and
        each request then needs the token in `url`.
    port : int, optional
        Port to serve at; default: a free port.
    token : str, optional
        Token that each request needs; default: a random token if other machines can reach the host.

    Raises
    ------
    InvalidArgument
        If an argument is invalid.
    ViewerError
        If the window cannot listen: the port is in use, or the address does not exist.

    See Also
    --------
    viewer.Viewer : scene of a robot, with ``live=True`` in browsers
    viewer.OfflineWindow : the same without a server

    Examples
    --------
    >>> from pinmobile.viewer import LiveWindow
    >>> with LiveWindow() as window:
    ...     window.url, window.browsers
    ('http://127.0.0.1:.../', 0)
    """

    def __init__(self, host: str = "127.0.0.1", port: int | None = None, token: str | None = None) -> None:
        number = None if port is None else check_integer("port", port, most=65535)
        access = access_for(host, token)
        engine, connect = _ENGINE.format(query=access.query), _CONNECT.format(query=access.query)
        html = stage_page("pinmobile", engine, connect + part_of_page("play.html"))
        listener = listening(access.host, number)
        self._port = int(listener.getsockname()[1])
        self._server = Server(listener, access, html.encode(), ENGINE.read_bytes())
        super().__init__(self._server.backlog)
        # Also at the interpreter's exit, and when nobody holds the window any more.
        self._finish = weakref.finalize(self, self._server.stop)

    def __repr__(self) -> str:
        state = "closed" if self._server.closed else f"{self.browsers} browsers"
        return f"<LiveWindow: {self._server.access.address(self.port)}, {state}>"

    @property
    def url(self) -> str:
        """Address of the page, with the token if requests need one."""
        access = self._server.access
        return access.address(self.port) + access.query

    web_url = url

    @property
    def port(self) -> int:
        """Port of the page."""
        return self._port

    @property
    def browsers(self) -> int:
        """Number of browsers that show the page."""
        return len(self._server.browsers)

    def send(self, command: Command) -> None:
        """Send a meshcat command to the browsers, unless a later command replaces it before.

        Parameters
        ----------
        command : object
            Meshcat command: an object with a method ``lower()``.

        Raises
        ------
        InvalidArgument
            If `command` is not a meshcat command, or contains a number that is not finite.
        ViewerError
            If the window is closed.
        """
        self._check_open()
        self._backlog.put(command)
        self._server.tell()

    def wait(self, timeout: float = 60.0) -> bool:
        """Wait until a browser shows the page, and return True.

        Parameters
        ----------
        timeout : float
            Longest time to wait [s].

        Raises
        ------
        ViewerError
            If no browser opens the page in time, or the window is closed.
        """
        self._check_open()
        limit = non_negative("timeout", timeout, "s")
        self._server.wait(lambda: bool(self._server.browsers), limit)
        self._check_open()
        if not self._server.browsers:
            address = self._server.access.address(self.port)
            raise ViewerError(f"no browser has opened {address} within {limit:g} s")
        return True

    def flush(self, timeout: float = 5.0) -> bool:
        """Wait until every browser has received all commands, and return whether this happened in time.

        Parameters
        ----------
        timeout : float
            Longest time to wait [s].

        Raises
        ------
        ViewerError
            If the window is closed.
        """
        self._check_open()
        server, latest = self._server, self._server.backlog.latest

        def all_have() -> bool:
            return all(browser.received >= latest for browser in tuple(server.browsers))

        server.wait(all_have, non_negative("timeout", timeout, "s"))
        self._check_open()
        return all_have()

    def get_image(self, w: int | None = None, h: int | None = None) -> Image.Image:
        """Return an RGBA picture of the scene from the browser that connected last.

        Parameters
        ----------
        w, h : int, optional
            Width and height [px]; the picture is scaled and cropped. Default: the size of the browser.

        Raises
        ------
        ViewerError
            If no browser is connected, the browser does not answer within 20 s, or the window is closed.
        """
        self._check_open()
        sizes = [None if size is None else check_integer(name, size) for name, size in (("w", w), ("h", h))]
        text = self._server.capture(_CAPTURE)
        try:
            data = base64.b64decode(text.partition(",")[2], validate=True)
            picture = Image.open(BytesIO(data), formats=["PNG"]).convert("RGBA")
        except (ValueError, OSError, SyntaxError, Image.DecompressionBombError) as error:
            raise ViewerError(f"the browser sent no valid picture: {error}") from error
        if sizes == [None, None]:
            return picture
        width, height = picture.size
        wide = sizes[0] or round(width * (sizes[1] or height) / height) or 1
        tall = sizes[1] or round(height * wide / width) or 1
        return ImageOps.fit(picture, (wide, tall))

    def listen(self, heard: Callable[[object, str], object]) -> None:
        """Call ``heard(browser, text)`` for each short text of a browser; the text is "" when it leaves."""
        self._server.heard = heard

    def close(self) -> None:
        """Stop serving, and free the thread and the port. A closed window accepts no commands."""
        self._finish()

    def _check_open(self) -> None:
        if self._server.closed:
            raise ViewerError("the window is closed")
