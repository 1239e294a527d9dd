"""The server of a scene: who may ask, what is answered, and the thread that tells the browsers."""

from __future__ import annotations

import asyncio
import logging
import os
import re
import secrets
import socket
import threading
import warnings
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, cast
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from pinmobile.arrays import text
from pinmobile.errors import InvalidArgument, ViewerError, shown
from pinmobile.viewer.pages import Backlog, packed_command

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
