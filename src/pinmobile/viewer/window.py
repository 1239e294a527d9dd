"""The live window: a scene in browsers, and the server that sends it."""

from __future__ import annotations

import asyncio
import base64
import logging
import os
import re
import secrets
import socket
import threading
import warnings
import weakref
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, cast
from urllib.parse import urlsplit

from PIL import Image, ImageOps
from tornado.httpserver import HTTPServer
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from pinmobile.arrays import non_negative, text, whole
from pinmobile.errors import InvalidArgument, ViewerError, shown
from pinmobile.viewer.pages import ENGINE, Backlog, Command, SceneWindow, packed_command, stage_page

_LOOPBACK = ("127.0.0.1", "::1", "localhost")
_EVERYWHERE = ("0.0.0.0", "::")
_TOKEN = re.compile(r"[A-Za-z0-9._~-]+")


@dataclass(frozen=True)
class Access:
    """The rule for requests.

    Parameters
    ----------
    host : str
        Address that is served.
    token : str, optional
        What each request has to carry.
    """

    host: str
    token: str | None = field(repr=False)

    @property
    def name(self) -> str:
        """The host as an address has it; where all of the machine's are served, the machine's name."""
        if self.host in _EVERYWHERE:
            return socket.gethostname()
        return f"[{self.host}]" if ":" in self.host else self.host

    def address(self, port: int) -> str:
        """Return the page's address at a port, without the token, as messages and logs may have it."""
        return f"http://{self.name}:{port}/"

    @property
    def query(self) -> str:
        """With which the token is carried; nothing where none is needed."""
        return "" if self.token is None else f"?token={self.token}"

    def refusal(self, headers: Mapping[str, str], tokens: Sequence[bytes]) -> str | None:
        """Return why a request is refused, or None.

        Parameters
        ----------
        headers : mapping
            ``Host`` has to name this server: a page elsewhere whose name was made to point here names
            itself. ``Origin``, where a browser sends it, has to be this server's own page.
        tokens : sequence of bytes
            That the request carries.
        """
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if not self._is_own(host):
            return f"this server is not {host[:80]!r}"
        if self.token is not None and not (
            len(tokens) == 1 and secrets.compare_digest(tokens[0], self.token.encode())
        ):
            return "the token is missing or wrong: use the whole address that was printed"
        if origin is not None and origin.lower() not in (f"http://{host.lower()}", f"https://{host.lower()}"):
            return f"requests from pages of {origin[:80]!r} are not answered"
        return None

    def _is_own(self, netloc: str) -> bool:
        try:
            name = urlsplit(f"//{netloc}").hostname
        except ValueError:
            return False
        if self.host in _EVERYWHERE:
            return bool(name)  # by which name it is reached cannot be known; the token is needed anyway
        return name in (*_LOOPBACK, self.host.lower())


def access_for(host: str, token: str | None) -> Access:
    """Return the rule for a host, with a new token where one is needed; warn where others can reach it.

    Parameters
    ----------
    host : str
        Address to serve at.
    token : str, optional
        What to ask for; by default a random one, and none on loopback.

    Raises
    ------
    InvalidArgument
        If the host is empty, or the token has letters that an address cannot have.
    """
    if token is not None and not (isinstance(token, str) and _TOKEN.fullmatch(token)):
        raise InvalidArgument("token is empty or not made of letters, digits, '-', '.', '_' and '~'")
    given, host = host, text("host", host).strip()
    bracketed = host.startswith("[") and host.endswith("]")
    host = host[1:-1] if bracketed else host
    if not host or set("[]/@?# ") & set(host) or (bracketed and ":" not in host):
        raise InvalidArgument(
            f"host is {shown(given)}, expected a name or an address such as '127.0.0.1', '::1'"
        )
    if host.lower() in _LOOPBACK:
        return Access(host.lower(), token)
    warnings.warn(
        f"the viewer listens on {host}: whoever can reach that address and knows the token sees the scene, "
        "and the connection is not encrypted; an SSH tunnel to the default host, 127.0.0.1, avoids both",
        UserWarning,
        stacklevel=3,
    )
    return Access(host, secrets.token_urlsafe(24) if token is None else token)


_LOG = logging.getLogger(__name__)
_MOST_BROWSERS = 64
_MOST_UNANSWERED = 4  # batches on their way to a browser; more would only be older news
_LARGEST_PICTURE = 64 << 20  # [byte]
# Not read as JSON: what came may be of any depth, and a tree of it take a hundred times its size.
_PICTURE = re.compile(r'"data" *: *"(data:image/png;base64,[A-Za-z0-9+/=]*)"')
_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src 'self' data: blob:; worker-src blob:; connect-src 'self' data: blob: ws://{0} wss://{0}"
)
_PERIOD = 1 / 60  # [s] between two batches
_GATHER = 0.003  # [s] in which the commands of one pose come together
_LOOK = 0.5  # [s] after which it looks for what is new without being told
_FAREWELL = 0.2  # [s] in which browsers can answer that they have seen the end
_PATIENCE = 10.0  # [s] for the thread to start or end, and for a request to come


class _Answer(RequestHandler):
    """A request; without a right to it, it is refused before anything else is looked at."""

    server: Server

    def initialize(self, server: Server) -> None:
        self.server = server

    def prepare(self) -> None:
        tokens = self.request.query_arguments.get("token", [])
        refusal = self.server.access.refusal(self.request.headers, tokens)
        if refusal is not None:
            self.refuse(403, refusal)

    def refuse(self, status: int, reason: str) -> None:
        self.set_status(status)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status}: {reason}\n")

    def set_default_headers(self) -> None:
        self.clear_header("Server")
        self.set_header("Cache-Control", "no-store")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Referrer-Policy", "no-referrer")  # the address may hold a token
        self.set_header("X-Content-Type-Options", "nosniff")

    def log_exception(self, *error: Any) -> None:
        # Nobody may read what is printed of a wrong request; of a fault the path is told: the whole address
        # may hold a token.
        if not isinstance(error[1], HTTPError):
            _LOG.error("the viewer failed at %s", self.request.path, exc_info=error)


class _Page(_Answer):
    def get(self) -> None:
        self.set_header("Content-Security-Policy", _POLICY.format(self.request.headers["Host"]))
        self.finish(self.server.page)

    head = get


class _Script(_Answer):
    def get(self) -> None:
        self.set_header("Content-Type", "text/javascript; charset=utf-8")
        self.finish(self.server.script)

    head = get


class _Nothing(_Answer):
    def prepare(self) -> None:
        super().prepare()
        if not self._finished:
            self.refuse(404, "there is no such page here")


class Browser(_Answer, WebSocketHandler):
    """A browser that shows the page.

    It gets one batch of commands at a time and answers each with a pong. One that is behind gets no
    more until it has answered; then the newest state. What is kept for it is at most one whole scene.

    Attributes
    ----------
    seen, taken : int
        Number of the newest command that was sent to it, and that it has received.
    """

    seen = taken = 0

    def prepare(self) -> None:
        """Refuse it where too many are connected."""
        super().prepare()
        if not self._finished and len(self.server.browsers) >= _MOST_BROWSERS:
            self.refuse(503, f"{len(self.server.browsers)} browsers are connected")

    def check_origin(self, origin: str) -> bool:
        """Return True: `prepare` has looked at it, which tornado does not do for every request."""
        return True

    def open(self, *_: str, **__: str) -> None:
        """Begin with nothing seen."""
        self._writing = False
        self._unanswered: deque[int] = deque()
        self._captures: deque[asyncio.Future[str]] = deque()
        self.set_nodelay(True)
        self.stream = cast(Any, self.ws_connection).stream
        self.server.browsers.append(self)
        self.server.news()

    def on_close(self) -> None:
        """Give up what was asked of it."""
        for capture in self._captures:
            if not capture.done():
                capture.set_exception(ViewerError("the browser was closed"))
        self.server.browsers.remove(self)
        self.server.news()

    def on_pong(self, data: bytes) -> None:
        """Take the answer to a batch; nothing else is one."""
        if self._unanswered and data == b"%d" % self._unanswered[0]:
            self.taken = self._unanswered.popleft()
            self.server.news()

    def on_message(self, message: str | bytes) -> None:
        """Take a picture that was asked for; nothing else is listened to."""
        if self._captures and isinstance(message, str) and (picture := _PICTURE.search(message)):
            capture = self._captures.popleft()
            if not capture.done():
                capture.set_result(picture[1])

    @property
    def ready(self) -> bool:
        """Whether it can take a batch."""
        return not self._writing and len(self._unanswered) < _MOST_UNANSWERED

    async def feed(self) -> None:
        """Send what it has not seen."""
        if not self.ready:
            return
        commands, latest = self.server.backlog.since(self.seen)
        self.seen = latest
        if not commands:
            # Everything since was deleted again.
            if not self._unanswered and self.taken < latest:
                self.taken = latest
                self.server.news()
            return
        self._writing = True
        try:
            writes = [self.write_message(command, binary=True) for command in commands]
            self._unanswered.append(latest)
            self.ping(b"%d" % latest)
            await asyncio.gather(*writes, return_exceptions=True)
        except WebSocketClosedError:
            pass
        finally:
            self._writing = False
            self.server.news()

    async def capture(self) -> str:
        """Return a picture of the scene as it is when this is called, as a data URL."""
        latest = self.server.backlog.latest
        while self.seen < latest or self._writing:
            await asyncio.sleep(0.01)
        picture = asyncio.get_running_loop().create_future()
        # One that is given up stays here: its answer may still come, and is not the next one's.
        self._captures.append(picture)
        await self.write_message(packed_command({"type": "capture_image"}), binary=True)
        return str(await picture)


def listening(host: str, port: int | None) -> socket.socket:
    """Return a socket that listens at an address.

    Raises
    ------
    ViewerError
        If that is not possible: the port is taken, or there is no such address.
    """
    try:
        # A browser that is told "localhost" tries both of its addresses.
        name = "127.0.0.1" if host == "localhost" else host
        family, *_, address = socket.getaddrinfo(name, port or 0, type=socket.SOCK_STREAM)[0]
        server = socket.create_server(address[:2], family=family, backlog=128)
    except (OSError, UnicodeError) as error:
        where = "a free port" if port is None else f"port {port}"
        raise ViewerError(f"cannot listen on {where} of {host}: {error}") from error
    server.setblocking(False)
    return server


class Server:
    """Serves a scene, in a thread of its own, until it is stopped.

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
        self._stopped, self._process = False, os.getpid()
        self._changed, self._started = threading.Condition(), threading.Event()
        self._told = False  # that there is something to send, and the loop has not looked yet
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve(listener)), name="pinmobile-viewer", daemon=True
        )
        self._thread.start()
        if not self._started.wait(_PATIENCE):
            raise ViewerError("the viewer's server did not start")

    @property
    def closed(self) -> bool:
        """Whether it was stopped, or this is a forked child, which has no part in it."""
        return self._stopped or os.getpid() != self._process

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

    def stop(self) -> None:
        """Close everything, and return when the thread has ended; for any thread, more than once."""
        if os.getpid() != self._process:
            return
        self._stopped = True
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._end.set)
        with self._changed:
            self._changed.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join(_PATIENCE)

    async def _serve(self, listener: socket.socket) -> None:
        self._loop = asyncio.get_running_loop()
        self._work, self._end = asyncio.Event(), asyncio.Event()
        own = {"server": self}
        application = Application(
            [(r"/", _Page, own), (r"/main\.min\.js", _Script, own), (r"/socket", Browser, own)],
            default_handler_class=_Nothing,
            default_handler_args=own,
            log_function=lambda _: None,
            websocket_max_message_size=_LARGEST_PICTURE,
        )
        http = HTTPServer(application, idle_connection_timeout=_PATIENCE, body_timeout=_PATIENCE)
        http.add_socket(listener)
        self._started.set()
        pump = asyncio.create_task(self._pump())
        await self._end.wait()
        pump.cancel()
        http.stop()
        for browser in self.browsers:
            browser.close(1001, "the viewer was closed")
        with suppress(TimeoutError):
            async with asyncio.timeout(_FAREWELL):
                while self.browsers:
                    await asyncio.sleep(0.01)
        for browser in self.browsers:  # that do not read
            browser.stream.close()
        with suppress(TimeoutError):
            await asyncio.wait_for(http.close_all_connections(), _FAREWELL)

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
            seen = (browser.seen for browser in self.browsers)
            self.backlog.forget_deletions(min(seen, default=self.backlog.latest))
            await asyncio.sleep(_PERIOD - _GATHER)


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
