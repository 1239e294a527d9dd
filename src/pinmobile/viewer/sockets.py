"""The sockets of the live window's server: the one that listens, and those of its connections."""

import asyncio
import logging
import resource
import socket
from typing import Any
from weakref import WeakKeyDictionary, ref

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream

from pinmobile.errors import ViewerError

__all__ = ["GuardedServer", "listening"]

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

    def _end(self, reference: "ref[IOStream]") -> None:
        stream = reference()
        if stream is not None and not self._streams.get(stream):
            stream.close()

    def _pause(self, error: OSError) -> None:
        if not self._told:
            self._told = True
            _LOG.warning("the viewer cannot take connections: %s; it goes on trying", error.strerror)
        self._loop.remove_reader(self._listener)
        self._accepting = self._loop.call_later(_PAUSE, self._loop.add_reader, self._listener, self._accept)
