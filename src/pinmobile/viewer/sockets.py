"""The sockets of the live window's server: the one that listens, and those of its connections."""

import socket
from typing import Any
from weakref import WeakSet

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream

from pinmobile.errors import ViewerError

__all__ = ["TrackedServer", "listening"]


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


class TrackedServer(HTTPServer):
    """A server that knows its connections, those to websockets too: `streams`."""

    def initialize(self, *args: Any, **settings: Any) -> None:
        """Begin without connections."""
        self.streams: WeakSet[IOStream] = WeakSet()
        super().initialize(*args, **settings)

    def handle_stream(self, stream: IOStream, address: Any) -> None:
        """Take a connection."""
        self.streams.add(stream)
        super().handle_stream(stream, address)
