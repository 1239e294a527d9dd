"""Server of a scene and the window that it serves: access rules, answers to requests, updates of browsers."""

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

from pinmobile.arrays import check_integer, non_negative, text
from pinmobile.errors import InvalidArgument, ViewerError, unexpected_value
from pinmobile.viewer.pages import ENGINE, Backlog, Command, SceneWindow, pack_content, page_part, stage_page

_LOOPBACK = ("127.0.0.1", "::1", "localhost")
_ALL_HOSTS = ("0.0.0.0", "::")
_TOKEN = re.compile(r"[A-Za-z0-9._~-]+")


@dataclass(frozen=True)
class Access:
    """Access rule for requests.

    Parameters
    ----------
    host : str
        Address of the server.
    token : str, optional
        Token that each request needs.
    """

    host: str
    token: str | None = field(repr=False)

    @property
    def name(self) -> str:
        """Host name in the address of the page; for all addresses, the name of the machine."""
        if self.host in _ALL_HOSTS:
            return socket.gethostname()
        return f"[{self.host}]" if ":" in self.host else self.host

    def address(self, port: int) -> str:
        """Return the address of the page at a port, without the token, for messages and logs."""
        return f"http://{self.name}:{port}/"

    @property
    def query(self) -> str:
        """Query with the token; "" if requests need no token."""
        return "" if self.token is None else f"?token={self.token}"

    def refusal(self, headers: Mapping[str, str], tokens: Sequence[bytes]) -> str | None:
        """Return why the server rejects a request, or None.

        Parameters
        ----------
        headers : mapping
            Headers of the request. ``Host`` must name this server, as a protection against DNS rebinding.
            ``Origin``, if present, must be the page of this server.
        tokens : sequence of bytes
            Tokens of the request.
        """
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if not self._is_own(host):
            return f"this server is not {host[:80]!r}"
        if self.token is not None and not (
            len(tokens) == 1 and secrets.compare_digest(tokens[0], self.token.encode())
        ):
            return "the token is missing or wrong: use the whole printed address"
        if origin is not None and origin.lower() not in (f"http://{host.lower()}", f"https://{host.lower()}"):
            return f"requests from pages of {origin[:80]!r} are rejected"
        return None

    def _is_own(self, netloc: str) -> bool:
        try:
            name = urlsplit(f"//{netloc}").hostname
        except ValueError:
            return False
        if self.host in _ALL_HOSTS:
            return bool(name)  # any name may lead to the server; requests need the token anyway
        return name in (*_LOOPBACK, self.host.lower())


def access_for(host: str, token: str | None) -> Access:
    """Return the access rule for a host; warn if other machines can reach the host.

    Parameters
    ----------
    host : str
        Address to serve at.
    token : str, optional
        Required token; default: a random token, or none on loopback.

    Raises
    ------
    InvalidArgument
        If the host is invalid, or the token has characters that an address cannot have.
    """
    if token is not None and not (isinstance(token, str) and _TOKEN.fullmatch(token)):
        raise InvalidArgument("token is empty or not made of letters, digits, '-', '.', '_' and '~'")
    given, host = host, text("host", host).strip()
    is_bracketed = host.startswith("[") and host.endswith("]")
    host = host[1:-1] if is_bracketed else host
    if not host or set("[]/@?# ") & set(host) or (is_bracketed and ":" not in host):
        raise unexpected_value("host", given, "a name or an address such as '127.0.0.1', '::1'")
    if host.lower() in _LOOPBACK:
        return Access(host.lower(), token)
    warnings.warn(
        f"the viewer listens on {host}: everybody who can reach this address and knows the token sees the "
        "scene, and the connection is not encrypted; use an SSH tunnel to the default host, 127.0.0.1",
        UserWarning,
        stacklevel=3,
    )
    return Access(host, secrets.token_urlsafe(24) if token is None else token)


_LOG = logging.getLogger(__name__)
_MAX_BROWSERS = 64
_MAX_UNANSWERED = 4  # batches on their way to a browser; more would only add delay
_MAX_PICTURE = 64 << 20  # [byte]
# No JSON parser: a message may be nested deeply, and its tree may take a hundred times its size.
_PICTURE = re.compile(r'"data" *: *"(data:image/png;base64,[A-Za-z0-9+/=]*)"')
_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src 'self' data: blob:; worker-src blob:; connect-src 'self' data: blob: ws://{0} wss://{0}"
)
_PERIOD = 1 / 75  # [s] between two batches: none of a source with 60 Hz is skipped
_MAX_TEXT = 200  # letters of a message that is not a picture
_COLLECT_TIME = 0.003  # [s], time to collect the commands of one pose
_CHECK_PERIOD = 0.5  # [s], period of checks without a notification
_CLOSE_TIMEOUT = 0.2  # [s], time for browsers to acknowledge the end
_TIMEOUT = 10.0  # [s], time for the thread to start or end, and for a request


class _Handler(RequestHandler):
    """Request handler that first checks the access rule."""

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
        # Log faults of the viewer only, with the path: the whole address may contain a token.
        if not isinstance(error[1], HTTPError):
            _LOG.error("the viewer failed at %s", self.request.path, exc_info=error)


class _Page(_Handler):
    def get(self) -> None:
        self.set_header("Content-Security-Policy", _POLICY.format(self.request.headers["Host"]))
        self.finish(self.server.page)

    head = get


class _Script(_Handler):
    def get(self) -> None:
        self.set_header("Content-Type", "text/javascript; charset=utf-8")
        self.finish(self.server.script)

    head = get


class _NotFound(_Handler):
    def prepare(self) -> None:
        super().prepare()
        if not self._finished:
            self.refuse(404, "there is no such page here")


class Browser(_Handler, WebSocketHandler):
    """Browser that shows the page.

    The server sends batches of commands, and the browser answers each batch with a pong. A slow browser gets
    no more batches until it answers, and then the newest state. The server keeps at most one whole scene for
    a browser.

    Attributes
    ----------
    sent, received : int
        Numbers of the newest command sent to the browser, and of the newest command it received.
    """

    sent = received = 0

    def prepare(self) -> None:
        """Reject the browser if too many browsers are connected."""
        super().prepare()
        if not self._finished and len(self.server.browsers) >= _MAX_BROWSERS:
            self.refuse(503, f"{len(self.server.browsers)} browsers are connected")

    def check_origin(self, origin: str) -> bool:
        """Return True: `prepare` has checked the origin, for every request."""
        return True

    def open(self, *_: str, **__: str) -> None:
        """Register a new browser, which has received no command."""
        self._writing = False
        self._unanswered: deque[int] = deque()
        self._captures: deque[asyncio.Future[str]] = deque()
        self.set_nodelay(True)
        self.stream = cast(Any, self.ws_connection).stream
        self.server.browsers.append(self)
        self.server.notify()

    def on_close(self) -> None:
        """Cancel pending pictures and remove the browser."""
        for capture in self._captures:
            if not capture.done():
                capture.set_exception(ViewerError("the browser was closed"))
        self.server.browsers.remove(self)
        self.server.on_text(self, "")
        self.server.notify()

    def on_pong(self, data: bytes) -> None:
        """Accept the answer to a batch; ignore other pongs."""
        if self._unanswered and data == b"%d" % self._unanswered[0]:
            self.received = self._unanswered.popleft()
            self.server.notify()

    def on_message(self, message: str | bytes) -> None:
        """Accept a requested picture, and pass on short texts; ignore other messages."""
        if isinstance(message, str) and len(message) <= _MAX_TEXT:
            self.server.on_text(self, message)
        if self._captures and isinstance(message, str) and (picture := _PICTURE.search(message)):
            capture = self._captures.popleft()
            if not capture.done():
                capture.set_result(picture[1])

    @property
    def is_ready(self) -> bool:
        """Whether the browser can take a batch."""
        return not self._writing and len(self._unanswered) < _MAX_UNANSWERED

    async def feed(self) -> None:
        """Send all commands that the browser has not received."""
        if not self.is_ready:
            return
        commands, latest = self.server.backlog.commands_after(self.sent)
        self.sent = latest
        if not commands:
            # All later commands have been deleted.
            if not self._unanswered and self.received < latest:
                self.received = latest
                self.server.notify()
            return
        self._writing, writes = True, list[Any]()
        try:
            for command in commands:
                writes.append(self.write_message(command, binary=True))
            self._unanswered.append(latest)
            self.ping(b"%d" % latest)
        except WebSocketClosedError:
            pass
        finally:
            await asyncio.gather(*writes, return_exceptions=True)  # a page may close while it is sent
            self._writing = False
            self.server.notify()

    async def capture(self) -> str:
        """Return a picture of the present scene as a data URL."""
        latest = self.server.backlog.latest
        while self.sent < latest or self._writing:
            await asyncio.sleep(0.01)
        picture = asyncio.get_running_loop().create_future()
        # A cancelled request stays in the queue: its answer may still come before the next one.
        self._captures.append(picture)
        await self.write_message(pack_content({"type": "capture_image"}), binary=True)
        return str(await picture)


def open_socket(host: str, port: int | None) -> socket.socket:
    """Return a socket that listens at an address.

    Raises
    ------
    ViewerError
        If the port is in use, or the address does not exist.
    """
    try:
        # A browser tries both addresses of "localhost".
        name = "127.0.0.1" if host == "localhost" else host
        family, *_, address = socket.getaddrinfo(name, port or 0, type=socket.SOCK_STREAM)[0]
        server = socket.create_server(address[:2], family=family, backlog=128)
    except (OSError, UnicodeError) as error:
        place = "a free port" if port is None else f"port {port}"
        raise ViewerError(f"cannot listen on {place} of {host}: {error}") from error
    server.setblocking(False)
    return server


class Server:
    """Server of a scene in a separate thread.

    Parameters
    ----------
    listener : socket
        Listening socket, which the server then owns.
    access : Access
        Access rule.
    page, script : bytes
        Content to serve.

    Attributes
    ----------
    backlog : Backlog
        Commands of the scene.
    browsers : list of Browser
        Browsers in the order of their connection. Only the thread of the server changes the list.
    on_text : callable
        Function of a browser and its text, "" when it leaves; the thread of the server calls it.
    """

    def __init__(self, listener: socket.socket, access: Access, page: bytes, script: bytes) -> None:
        self.access, self.page, self.script = access, page, script
        self.backlog = Backlog()
        self.browsers: list[Browser] = []
        self.on_text: Callable[[object, str], object] = lambda browser, text: None
        self._stopped, self._process = False, os.getpid()
        self._changed, self._started = threading.Condition(), threading.Event()
        self._is_notified = False  # whether new commands wait for the loop
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve(listener)), name="pinmobile-viewer", daemon=True
        )
        self._thread.start()
        if not self._started.wait(_TIMEOUT):
            raise ViewerError("the viewer's server did not start")

    @property
    def closed(self) -> bool:
        """Whether the server was stopped, or this process is a forked child without the thread."""
        return self._stopped or os.getpid() != self._process

    def notify(self) -> None:
        """Check for commands to send, and wake waiting threads; call it in the thread of the server."""
        self._work.set()
        with self._changed:
            self._changed.notify_all()

    def wake(self) -> None:
        """Notify the server of new commands, from any thread."""
        latest = self.backlog.latest  # before the check for browsers: a browser that comes now gets it
        if not self.browsers:
            self.backlog.drop_deletions(latest)
        elif not self._is_notified:
            self._is_notified = True
            with suppress(RuntimeError):  # the loop has just ended
                self._loop.call_soon_threadsafe(self._work.set)

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait for a condition or the end of the server, and return whether either came in time."""
        with self._changed:
            return self._changed.wait_for(lambda: self.closed or condition(), timeout)

    def capture(self, timeout: float) -> str:
        """Return a picture from the browser that connected last, as a data URL."""
        if not self.browsers:
            raise ViewerError("no browser shows the page: open its address to draw a picture")
        browser = self.browsers[-1]
        future = asyncio.run_coroutine_threadsafe(asyncio.wait_for(browser.capture(), timeout), self._loop)
        try:
            # The loop may end meanwhile, and the future then never would.
            return future.result(timeout + 1)
        except TimeoutError:
            future.cancel()
            raise ViewerError(f"the browser has sent no picture within {timeout:g} s") from None
        except CancelledError:
            raise ViewerError("the window is closed") from None

    def stop(self) -> None:
        """Close everything, and return when the thread has ended. Any thread may call it repeatedly."""
        if os.getpid() != self._process:
            return
        self._stopped = True
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._end.set)
        with self._changed:
            self._changed.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join(_TIMEOUT)

    async def _serve(self, listener: socket.socket) -> None:
        self._loop = asyncio.get_running_loop()
        self._work, self._end = asyncio.Event(), asyncio.Event()
        options = {"server": self}
        application = Application(
            [(r"/", _Page, options), (r"/main\.min\.js", _Script, options), (r"/socket", Browser, options)],
            default_handler_class=_NotFound,
            default_handler_args=options,
            log_function=lambda _: None,
            websocket_max_message_size=_MAX_PICTURE,
        )
        http = HTTPServer(application, idle_connection_timeout=_TIMEOUT, body_timeout=_TIMEOUT)
        http.add_socket(listener)
        self._started.set()
        pump = asyncio.create_task(self._pump())
        await self._end.wait()
        pump.cancel()
        http.stop()
        for browser in self.browsers:
            browser.close(1001, "the viewer was closed")
        with suppress(TimeoutError):
            async with asyncio.timeout(_CLOSE_TIMEOUT):
                while self.browsers:
                    await asyncio.sleep(0.01)
        for browser in self.browsers:  # that do not read
            browser.stream.close()
        with suppress(TimeoutError):
            await asyncio.wait_for(http.close_all_connections(), _CLOSE_TIMEOUT)

    async def _pump(self) -> None:
        """Send new commands to each browser, at most 75 times per second."""
        tasks: set[asyncio.Task[None]] = set()
        while True:
            # Also check without a notification: an interrupt in `wake` may have prevented it.
            with suppress(TimeoutError):
                async with asyncio.timeout(_CHECK_PERIOD if self.browsers else None):
                    await self._work.wait()
            await asyncio.sleep(_COLLECT_TIME)
            self._work.clear()
            self._is_notified = False  # before the check: later commands notify again
            for browser in self.browsers:
                if browser.is_ready:
                    task = asyncio.create_task(browser.feed())
                    tasks.add(task)
                    task.add_done_callback(tasks.discard)
            numbers = (browser.sent for browser in self.browsers)
            self.backlog.drop_deletions(min(numbers, default=self.backlog.latest))
            await asyncio.sleep(_PERIOD - _COLLECT_TIME)


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
        html = stage_page("pinmobile", engine, connect + page_part("play.html"))
        listener = open_socket(access.host, number)
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
        self._server.wake()

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

        def is_flushed() -> bool:
            return all(browser.received >= latest for browser in tuple(server.browsers))

        server.wait(is_flushed, non_negative("timeout", timeout, "s"))
        self._check_open()
        return is_flushed()

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
        new_width = sizes[0] or round(width * (sizes[1] or height) / height) or 1
        new_height = sizes[1] or round(height * new_width / width) or 1
        return ImageOps.fit(picture, (new_width, new_height))

    def listen(self, function: Callable[[object, str], object]) -> None:
        """Call ``function(browser, text)`` for each short text of a browser, and "" when it leaves."""
        self._server.on_text = function

    def close(self) -> None:
        """Stop serving, and free the thread and the port. A closed window accepts no commands."""
        self._finish()

    def _check_open(self) -> None:
        if self._server.closed:
            raise ViewerError("the window is closed")
