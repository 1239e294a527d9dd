"""`LiveWindow`: a scene in the browsers that look at it, served by a thread of this process."""

from __future__ import annotations

import asyncio
import base64
import os
import socket
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import CancelledError
from contextlib import suppress
from functools import cache
from io import BytesIO

from PIL import Image, ImageOps

from pinmobile.arrays import non_negative, whole
from pinmobile.errors import InvalidArgument, ViewerError
from pinmobile.viewer.live.server import Access, Browser, GuardedServer, access_for, application, listening
from pinmobile.viewer.pages import ENGINE, Backlog, Command, stage_page, static_page

_CAPTURE = 20.0  # [s] that a browser has to draw a picture
_SCRIPT, _CONNECT = 'src="main.min.js"', "viewer.connect()"
_NO_ICON = '<link rel="icon" href="data:,">'
_SOCKET = "viewer.connect(`ws://${{location.host}}${{location.pathname}}socket{query}`)"


class LiveWindow:
    """A scene in the browsers that look at it: ``meshcat.Visualizer(window=LiveWindow())``.

    The page is served by a thread of this process until the window is closed, and ends with the process
    however that ends. Browsers get the newest state, 60 times a second at most; one that comes later or
    again gets the whole scene, and one that is slow misses states in between. It may be used from several
    threads. A forked child has no part in it: there the window is closed. It has 128 connections at most,
    half of them browsers, and never more than a quarter of the files that the process may open.

    Parameters
    ----------
    host : str
        Address to serve at. Only this machine can reach the default; another one is warned about, and
        then each request needs the token in `url`.
    port : int, optional
        To serve at; by default one that is free.
    token : str, optional
        That each request has to carry; by default a random one where the host needs it.
    page : str, optional
        HTML that asks for ``src="main.min.js"`` and calls ``viewer.connect()``, as meshcat's own does;
        by default the package's.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected.
    ViewerError
        If it cannot listen there: the port is taken, or there is no such address.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int | None = None,
        token: str | None = None,
        *,
        page: str | None = None,
    ) -> None:
        wanted = None if port is None else whole("port", port, most=65535)
        access = access_for(host, token)
        html = _served(_live_page() if page is None else page, access.query)
        listener = listening(access.host, wanted)
        self._port = int(listener.getsockname()[1])
        self._server = Server(listener, access, html.encode(), ENGINE.read_bytes())
        # Also at the interpreter's exit, and when nobody holds the window any more.
        self._finish = weakref.finalize(self, self._server.stop)

    def __enter__(self) -> LiveWindow:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

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

    @property
    def scene_size(self) -> int:
        """Of the commands that make the scene [byte]."""
        return self._server.backlog.size

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
        self._server.backlog.put(command)
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

    def commands(self) -> list[bytes]:
        """Return the commands that make the scene, as they would be sent, the animation last."""
        return self._server.backlog.since(0)[0]

    def get_scene(self) -> str:
        """Return meshcat's page with the scene in it: self-contained, without a request to anywhere."""
        return static_page(self.commands())

    static_html = get_scene

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


def _live_page() -> str:
    """Return the page that connects to the server it came from; it asks that for ``main.min.js``."""
    return stage_page("pinmobile", f"<script {_SCRIPT}></script>", f"<script>\n{_CONNECT};\n</script>")


def _served(page: str, query: str) -> str:
    """Return the page as it is served: what it asks for carries the token, and it asks for no icon."""
    for needed in (_SCRIPT, _CONNECT):
        if needed not in page:
            raise InvalidArgument(f"page has no {needed}")
    page = page.replace(_SCRIPT, f'{_SCRIPT[:-1]}{query}"')
    page = page.replace(_CONNECT, _SOCKET.format(query=query))
    return page if 'rel="icon"' in page else page.replace("<head>", f"<head>{_NO_ICON}", 1)


_PERIOD = 1 / 60  # [s] between two batches
_GATHER = 0.003  # [s] in which the commands of one pose come together
_LOOK = 0.5  # [s] after which it looks for what is new without being told
_FAREWELL = 0.2  # [s] in which browsers can answer that they have seen the end
_PATIENCE = 10.0  # [s] for the thread to start or end
_REQUEST = 10.0  # [s] that a request may take to come
_LARGEST_HEADER = 1 << 14  # [byte]
_LARGEST_BODY = 1 << 10  # [byte]; none is expected
_MOST_DELETIONS = 10_000  # that are kept for a browser which has stopped reading


class Server:
    """Serves a scene until it is stopped.

    Parameters
    ----------
    listener : socket
        That listens; it is the server's from now on.
    access : Access
        Who may ask.
    page, script : bytes
        What is served.

    Attributes
    ----------
    backlog : Backlog
        The scene.
    browsers : list of Browser
        That show it, the last one to come last. Only the server's thread changes it.
    """

    def __init__(self, listener: socket.socket, access: Access, page: bytes, script: bytes) -> None:
        self.access, self.page, self.script = access, page, script
        self.backlog = Backlog()
        self.browsers: list[Browser] = []
        self.closed = False
        self._listener = listener
        self._changed = threading.Condition()
        self._started = threading.Event()
        self._told = False  # that there is something to send, and the loop has not looked yet
        self._process = os.getpid()
        self._thread = threading.Thread(target=self._run, name="pinmobile-viewer", daemon=True)
        try:
            self._thread.start()
            if not self._started.wait(_PATIENCE):
                raise ViewerError("the viewer's server did not start")
        except BaseException:
            self.closed = True
            listener.close()
            raise
        _mind_forks()
        _SERVERS.add(self)

    def news(self) -> None:
        """Look for what there is to send, and wake who waits; for the server's thread."""
        self._work.set()
        with self._changed:
            self._changed.notify_all()

    def tell(self) -> None:
        """Say from any thread that there is something to send."""
        latest = self.backlog.latest  # before looking whether there is a browser: one that comes now sees it
        if not self.browsers:
            self.backlog.forget_deletions(latest)
        elif not self._told:
            self._told = True
            with suppress(RuntimeError):  # the loop has just ended
                self._loop.call_soon_threadsafe(self._work.set)

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Return whether a condition comes true in time, or the server ends before."""
        with self._changed:
            return self._changed.wait_for(lambda: self.closed or condition(), timeout)

    def capture(self, timeout: float) -> str:
        """Return a picture from the browser that came last, as a data URL."""
        if not self.browsers:
            raise ViewerError("no browser shows the page, and none can draw it")
        browser = self.browsers[-1]
        waiting = asyncio.run_coroutine_threadsafe(asyncio.wait_for(browser.capture(), timeout), self._loop)
        try:
            # The loop may end meanwhile, and the future then never would.
            return waiting.result(timeout + 1)
        except TimeoutError:
            waiting.cancel()
            raise ViewerError(f"the browser has sent no picture within {timeout:g} s") from None
        except CancelledError:
            raise ViewerError("the window is closed") from None

    @property
    def full(self) -> bool:
        """Whether as many browsers are connected as it can take."""
        return len(self.browsers) >= self._http.most_kept

    def join(self, browser: Browser) -> None:
        """Take a browser that has come."""
        self._http.keep(browser.stream)
        self.browsers.append(browser)
        self.news()

    def leave(self, browser: Browser) -> None:
        """Forget a browser that has gone."""
        if browser in self.browsers:
            self.browsers.remove(browser)
        self.news()

    def stop(self) -> None:
        """Close everything, and return when the thread has ended; for any thread, more than once."""
        if os.getpid() != self._process:
            return
        self.closed = True
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._end.set)
        with self._changed:
            self._changed.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join(_PATIENCE)

    def abandon(self) -> None:
        """Let go of the sockets in a forked child, where there is no thread, without touching the loop."""
        self.closed = True
        self._changed, self.backlog.lock = threading.Condition(), threading.Lock()
        for each in [self._listener, *(stream.socket for stream in self._http.streams)]:
            if each is not None:
                each.close()
        self.browsers = []

    def _run(self) -> None:
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._work, self._end = asyncio.Event(), asyncio.Event()
        http = self._http = GuardedServer(
            application(self),
            max_header_size=_LARGEST_HEADER,
            max_body_size=_LARGEST_BODY,
            idle_connection_timeout=_REQUEST,
            body_timeout=_REQUEST,
        )
        http.accept_from(self._listener)
        self._started.set()
        pump = asyncio.create_task(self._pump())
        await self._end.wait()
        pump.cancel()
        http.stop()
        for browser in list(self.browsers):
            browser.close(1001, "the viewer was closed")
        with suppress(TimeoutError):
            async with asyncio.timeout(_FAREWELL):
                while self.browsers:
                    await asyncio.sleep(0.01)
        for stream in http.streams:
            stream.close()

    async def _pump(self) -> None:
        """Send what is new to each browser, 60 times a second at most."""
        feeding: set[asyncio.Task[None]] = set()
        while True:
            # It also looks by itself: an interrupt in `tell` may have come before the loop was told.
            with suppress(TimeoutError):
                async with asyncio.timeout(_LOOK if self.browsers else None):
                    await self._work.wait()
            await asyncio.sleep(_GATHER)
            self._work.clear()
            self._told = False  # before looking: what comes from now on says so again
            for browser in self.browsers:
                if browser.ready:
                    task = asyncio.create_task(browser.feed())
                    feeding.add(task)
                    task.add_done_callback(feeding.discard)
            self._tidy()
            await asyncio.sleep(_PERIOD - _GATHER)

    def _tidy(self) -> None:
        backlog = self.backlog
        if backlog.deletions > _MOST_DELETIONS:
            for browser in [browser for browser in self.browsers if browser.stalled]:
                browser.abort()
        backlog.forget_deletions(min((browser.seen for browser in self.browsers), default=backlog.latest))


_SERVERS: weakref.WeakSet[Server] = weakref.WeakSet()


def _in_child() -> None:
    for server in list(_SERVERS):
        server.abandon()


@cache
def _mind_forks() -> None:
    os.register_at_fork(after_in_child=_in_child)
