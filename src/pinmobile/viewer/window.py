"""`LiveWindow`: a scene in the browsers that look at it."""

from __future__ import annotations

import base64
import weakref
from io import BytesIO

from PIL import Image, ImageOps

from pinmobile.arrays import non_negative, whole
from pinmobile.errors import ViewerError
from pinmobile.viewer.pages import ENGINE, Command, SceneWindow, stage_page
from pinmobile.viewer.server import Server, access_for, listening

_CAPTURE = 20.0  # [s] that a browser has to draw a picture
_ENGINE = '<script src="main.min.js{query}"></script>'
_CONNECT = (
    "<script>\nviewer.connect(`ws://${{location.host}}${{location.pathname}}socket{query}`);\n</script>"
)


class LiveWindow(SceneWindow):
    """A scene in the browsers that look at it: ``meshcat.Visualizer(window=LiveWindow())``.

    The page is served by a thread of this process until the window is closed, and ends with the process
    however that ends. Browsers get the newest state, 60 times a second at most; one that comes later or
    again gets the whole scene, and one that is slow misses states in between. It may be used from several
    threads. In a forked child it is closed. At most 64 browsers show it.

    Parameters
    ----------
    host : str
        Address to serve at. Only this machine can reach the default; another one is warned about, and
        then each request needs the token in `url`.
    port : int, optional
        To serve at; by default one that is free.
    token : str, optional
        That each request has to carry; by default a random one where the host needs it.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected.
    ViewerError
        If it cannot listen there: the port is taken, or there is no such address.
    """

    def __init__(self, host: str = "127.0.0.1", port: int | None = None, token: str | None = None) -> None:
        wanted = None if port is None else whole("port", port, most=65535)
        access = access_for(host, token)
        engine, connect = _ENGINE.format(query=access.query), _CONNECT.format(query=access.query)
        html = stage_page("pinmobile", engine, connect)
        listener = listening(access.host, wanted)
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
        """Address of the page, with the token where one is needed."""
        access = self._server.access
        return access.address(self.port) + access.query

    web_url = url

    @property
    def port(self) -> int:
        """Port that is served."""
        return self._port

    @property
    def browsers(self) -> int:
        """How many show the page."""
        return len(self._server.browsers)

    def send(self, command: Command) -> None:
        """Take a command of meshcat's; it is sent soon, unless a later one replaces it.

        Raises
        ------
        InvalidArgument
            If it is none, or holds a number that is not finite.
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
            [s].

        Raises
        ------
        ViewerError
            If none has come by then, or the window is closed.
        """
        self._check_open()
        limit = non_negative("timeout", timeout, "s")
        self._server.wait(lambda: bool(self._server.browsers), limit)
        self._check_open()
        if not self._server.browsers:
            where = self._server.access.address(self.port)
            raise ViewerError(f"no browser has opened {where} within {limit:g} s")
        return True

    def flush(self, timeout: float = 5.0) -> bool:
        """Wait until every browser has received all that was sent, and return whether that is so.

        Parameters
        ----------
        timeout : float
            [s].

        Raises
        ------
        ViewerError
            If the window is closed.
        """
        self._check_open()
        server, latest = self._server, self._server.backlog.latest
        self._server.wait(
            lambda: all(browser.taken >= latest for browser in tuple(server.browsers)),
            non_negative("timeout", timeout, "s"),
        )
        self._check_open()
        return all(browser.taken >= latest for browser in tuple(server.browsers))

    def get_image(self, w: int | None = None, h: int | None = None) -> Image.Image:
        """Return a picture of the scene from the browser that came last, RGBA.

        Parameters
        ----------
        w, h : int, optional
            Size [px], to which the picture is scaled and its edges cut; by default that of the browser.

        Raises
        ------
        ViewerError
            If there is no browser, it does not answer within 20 s, or the window is closed.
        """
        self._check_open()
        sizes = [None if size is None else whole(name, size) for name, size in (("w", w), ("h", h))]
        text = self._server.capture(_CAPTURE)
        try:
            data = base64.b64decode(text.partition(",")[2], validate=True)
            picture = Image.open(BytesIO(data), formats=["PNG"]).convert("RGBA")
        except (ValueError, OSError, SyntaxError, Image.DecompressionBombError) as error:
            raise ViewerError(f"the browser has sent no picture: {error}") from error
        if sizes == [None, None]:
            return picture
        width, height = picture.size
        wide = sizes[0] or round(width * (sizes[1] or height) / height) or 1
        tall = sizes[1] or round(height * wide / width) or 1
        return ImageOps.fit(picture, (wide, tall))

    def close(self) -> None:
        """Stop serving: no thread and no port is left. A closed window takes no more commands."""
        self._finish()

    def _check_open(self) -> None:
        if self._server.closed:
            raise ViewerError("the window is closed")
