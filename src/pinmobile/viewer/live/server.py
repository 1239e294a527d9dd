"""The live window's server: a thread of this process with an event loop in it, and its sockets."""

from __future__ import annotations

import asyncio
import logging
import os
import resource
import socket
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError
from contextlib import suppress
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary, WeakSet, ref

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream

from pinmobile.errors import ViewerError
from pinmobile.viewer.live.handlers import Access, Browser, application
from pinmobile.viewer.offline import Backlog

_LOG = logging.getLogger(__name__)
_MOST_CONNECTIONS = 128
_AT_ONCE = 128  # that are taken before something else gets its turn
_LIFE = 120.0  # [s] of a connection that is no page's
_PAUSE = 1.0  # [s]


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


class _GuardedServer(HTTPServer):
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
        http = self._http = _GuardedServer(
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


_SERVERS: WeakSet[Server] = WeakSet()


def _in_child() -> None:
    for server in list(_SERVERS):
        server.abandon()


@cache
def _mind_forks() -> None:
    os.register_at_fork(after_in_child=_in_child)
