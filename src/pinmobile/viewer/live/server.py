"""The live window's web server: whom it answers, what, and how many connections it holds."""

from __future__ import annotations

import asyncio
import logging
import re
import resource
import secrets
import socket
import warnings
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from types import TracebackType
from typing import Any, Protocol, cast
from urllib.parse import urlsplit
from weakref import WeakKeyDictionary, ref

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream
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
            return f"this server is not {_printable(host)}"
        if self.token is not None and not (
            len(tokens) == 1 and secrets.compare_digest(tokens[0], self.token.encode())
        ):
            return "the token is missing or wrong: use the whole address that was printed"
        if origin is not None and origin.lower() not in (f"http://{host.lower()}", f"https://{host.lower()}"):
            return f"requests from pages of {_printable(origin)} are not answered"
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
    if not isinstance(host, str) or not host.strip():
        raise InvalidArgument(f"host is {shown(host)}, expected a name or an address such as '127.0.0.1'")
    if token is not None and not (isinstance(token, str) and _TOKEN.fullmatch(token)):
        raise InvalidArgument("token is empty or not made of letters, digits, '-', '.', '_' and '~'")
    host = host.strip()
    bracketed = host.startswith("[") and host.endswith("]")
    host = host[1:-1] if bracketed else host
    if set("[]/@?# ") & set(host) or (bracketed and ":" not in host) or text("host", host) != host:
        raise InvalidArgument(
            f"host is {shown(host)}, expected a name or an address such as '127.0.0.1' or '::1'"
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


def _printable(text: str) -> str:
    return repr(text[:80])


_LOG = logging.getLogger(__name__)
_MOST_CONNECTIONS = 128
_AT_ONCE = 128  # that are taken before something else gets its turn
_LIFE = 120.0  # [s] of a connection that is no page's
_PAUSE = 1.0  # [s]
_MOST_UNANSWERED = 4  # batches on their way to a browser; more would only be older news
_PATIENCE = 2.0  # [s] in which a browser should answer
_MOST_CAPTURES = 4
_LARGEST_PICTURE = 64 << 20  # [byte]
_LARGEST_MESSAGE = 1 << 10  # [byte], where no picture was asked for
# Not read as JSON: what came may be of any depth, and a tree of it take a hundred times its size.
_PICTURE = re.compile(r'"data" *: *"(data:image/png;base64,[A-Za-z0-9+/=]*)"')
_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src 'self' data: blob:; worker-src blob:; connect-src 'self' data: blob: ws://{0} wss://{0}"
)


class _Serving(Protocol):
    """A server, as far as its answers ask it."""

    access: Access
    page: bytes
    script: bytes
    backlog: Backlog
    browsers: list[Browser]

    @property
    def full(self) -> bool:
        """Whether there are as many browsers as there may be."""
        ...

    def join(self, browser: Browser) -> None:
        """Take in a browser."""

    def leave(self, browser: Browser) -> None:
        """Forget a browser."""

    def news(self) -> None:
        """Send what has changed."""


class _Answer(RequestHandler):
    """A request; without a right to it, it is refused before anything else is looked at."""

    server: _Serving

    def initialize(self, server: _Serving) -> None:
        self.server = server

    def prepare(self) -> None:
        refusal = self.server.access.refusal(
            self.request.headers, self.request.query_arguments.get("token", [])
        )
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

    def write_error(self, status_code: int, **_: object) -> None:
        self.refuse(status_code, self._reason)

    def log_exception(
        self,
        typ: type[BaseException] | None,
        value: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        # What a request asks for wrongly is its own affair: nobody may read what would be printed. Of others
        # the path alone is told: the whole address may hold a token.
        if typ is not None and value is not None and not isinstance(value, HTTPError):
            _LOG.error("the viewer failed at %s", self.request.path, exc_info=(typ, value, tb))


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
    stream : IOStream
        Its connection.
    """

    seen = taken = 0

    def prepare(self) -> None:
        """Refuse it where too many are connected."""
        super().prepare()
        if not self._finished and self.server.full:
            self.refuse(503, f"{len(self.server.browsers)} browsers are connected")

    def check_origin(self, origin: str) -> bool:
        """Return True: `prepare` has looked at it, which tornado does not do for every request."""
        return True

    def open(self, *_: str, **__: str) -> None:
        """Begin with nothing seen."""
        self._writing, self._fed = False, monotonic()
        self._unanswered: deque[int] = deque()
        self._captures: deque[asyncio.Future[str]] = deque()
        self.set_nodelay(True)
        self._connection = cast(Any, self.ws_connection)
        self._bound()
        self.stream: IOStream = self._connection.stream
        self.server.join(self)

    def on_close(self) -> None:
        """Give up what was asked of it."""
        for capture in self._captures:
            if not capture.done():
                capture.set_exception(ViewerError("the browser was closed"))
        self.server.leave(self)

    def on_pong(self, data: bytes) -> None:
        """Take the answer to a batch; nothing else is one."""
        if self._unanswered and data == b"%d" % self._unanswered[0]:
            self.taken = self._unanswered.popleft()
            self.server.news()

    def on_message(self, message: str | bytes) -> None:
        """Take a picture that was asked for; nothing else is listened to."""
        if self._captures and isinstance(message, str) and (picture := _PICTURE.search(message)):
            capture = self._captures.popleft()
            self._bound()
            if not capture.done():
                capture.set_result(picture[1])

    @property
    def ready(self) -> bool:
        """Whether it can take a batch."""
        return not self._writing and len(self._unanswered) < _MOST_UNANSWERED

    @property
    def stalled(self) -> bool:
        """Whether it has not been ready for a while."""
        return not self.ready and monotonic() - self._fed > _PATIENCE

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
        self._writing, self._fed = True, monotonic()
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
        if len(self._captures) >= _MOST_CAPTURES:
            raise ViewerError("the browser does not answer")
        picture = asyncio.get_running_loop().create_future()
        # One that is given up stays here: its answer may still come, and is not the next one's.
        self._captures.append(picture)
        self._bound()
        await self.write_message(packed_command({"type": "capture_image"}), binary=True)
        return str(await picture)

    def _bound(self) -> None:
        """Let a message be as large as a picture where one was asked for."""
        largest = _LARGEST_PICTURE if self._captures else _LARGEST_MESSAGE
        self._connection.params.max_message_size = largest

    def abort(self) -> None:
        """End the connection without waiting for the browser."""
        if self.ws_connection is not None and self.ws_connection.stream is not None:
            self.ws_connection.stream.close()


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


class GuardedServer(HTTPServer):
    """A server that knows its connections, and holds no more of them than it can afford.

    Half of them are for pages: the websockets that are kept. Where all others are taken, a new one takes the
    place of the oldest; a request, its answer included, has two minutes. Where the process has no descriptors
    left, it says so once and looks again a second later.
    """

    def initialize(self, *args: Any, **settings: Any) -> None:
        """Begin without connections."""
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        # The descriptors are the user's, whose own files have to open.
        most = _MOST_CONNECTIONS if soft == resource.RLIM_INFINITY else min(_MOST_CONNECTIONS, soft // 4)
        self.most_kept = most // 2
        self._streams: WeakKeyDictionary[IOStream, bool] = WeakKeyDictionary()  # whether it is kept
        self._told = False
        super().initialize(*args, **settings)

    @property
    def streams(self) -> list[IOStream]:
        """The connections that are open, the oldest first."""
        return [stream for stream in list(self._streams) if not stream.closed()]

    def accept_from(self, listener: socket.socket) -> None:
        """Accept connections from now on; for the loop's thread."""
        self._listener, self._loop = listener, asyncio.get_running_loop()
        self._accepting: asyncio.TimerHandle | None = None
        self._loop.add_reader(listener, self._accept)

    def keep(self, stream: IOStream) -> None:
        """Let a connection stay for as long as it likes."""
        self._streams[stream] = True

    def stop(self) -> None:
        """Accept no more."""
        if self._accepting is not None:
            self._accepting.cancel()
        self._loop.remove_reader(self._listener)
        self._listener.close()

    def _accept(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                connection, address = self._listener.accept()
            except (BlockingIOError, ConnectionAbortedError):
                return
            except OSError as error:
                self._pause(error)
                return
            plain = [stream for stream in self.streams if not self._streams[stream]]
            if len(plain) >= self.most_kept:
                plain[0].close()
            stream = IOStream(connection)
            self._streams[stream] = False
            self._loop.call_later(_LIFE, self._end, ref(stream))
            self.handle_stream(stream, address)

    def _end(self, reference: ref[IOStream]) -> None:
        stream = reference()
        if stream is not None and not self._streams.get(stream):
            stream.close()

    def _pause(self, error: OSError) -> None:
        if not self._told:
            self._told = True
            _LOG.warning("the viewer cannot take connections: %s; it goes on trying", error.strerror)
        self._loop.remove_reader(self._listener)
        self._accepting = self._loop.call_later(_PAUSE, self._loop.add_reader, self._listener, self._accept)


def application(server: _Serving) -> Application:
    """Return what answers a server's requests."""
    own = {"server": server}
    return Application(
        [(r"/", _Page, own), (r"/main\.min\.js", _Script, own), (r"/socket", Browser, own)],
        default_handler_class=_Nothing,
        default_handler_args=own,
        log_function=lambda _: None,
    )
