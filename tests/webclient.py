"""A client of the live window's server by hand: any header, and a websocket that may not read."""

import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import TracebackType
from typing import Any
from urllib.parse import urlsplit

import umsgpack

__all__ = ["WebSocket", "ask", "eventually", "listens", "resident"]

_UPGRADE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    "Sec-WebSocket-Version": "13",
}


def eventually(condition: Callable[[], Any], timeout: float = 30.0) -> bool:
    """Return whether a condition comes true in time."""
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def listens(port: int, host: str = "127.0.0.1") -> bool:
    """Return whether someone listens at a port."""
    with socket.socket() as probe:
        probe.settimeout(2)
        return probe.connect_ex((host, port)) == 0


def resident(pid: int | str = "self") -> float:
    """Return the resident memory of a process [MB]."""
    with open(f"/proc/{pid}/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def ask(url: str, headers: Mapping[str, str] | None = None, **changes: str) -> tuple[int, str]:
    """Return status and text of an answer; `changes` are parts of the url."""
    with _request(url, {"Connection": "close", **(headers or {})}, changes) as connection:
        received = b""
        while part := connection.recv(1 << 16):
            received += part
    head, _, body = received.partition(b"\r\n\r\n")
    return int(head.split()[1]), body.decode("utf-8", "replace")


def _request(url: str, headers: Mapping[str, str], changes: Mapping[str, str]) -> socket.socket:
    parts = urlsplit(url)
    path = changes.get("path", parts.path) + (
        f"?{query}" if (query := changes.get("query", parts.query)) else ""
    )
    lines = {"Host": parts.netloc, **headers}
    text = f"GET {path} HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    connection = socket.create_connection((parts.hostname or "", parts.port or 80), timeout=10)
    connection.sendall(f"{text}\r\n".encode("latin-1"))
    return connection


class WebSocket:
    """A browser's websocket. It reads, and answers pings, in a thread of its own, once it is told to.

    Attributes
    ----------
    status : int
        Of the answer: 101 where the socket was accepted.
    commands : list of dict
        What has come.
    """

    def __init__(
        self, url: str, headers: Mapping[str, str] | None = None, *, reads: bool = True, **changes: str
    ) -> None:
        changes.setdefault("path", "/socket")
        self._socket = _request(url, {**_UPGRADE, **(headers or {})}, changes)
        head = b""
        while not head.endswith(b"\r\n\r\n") and (byte := self._socket.recv(1)):
            head += byte
        self.status = int(head.split()[1])
        self._socket.settimeout(None)
        self.commands: list[dict[str, Any]] = []
        self.closed = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        if reads and self.status == 101:
            self.read()

    def __enter__(self) -> "WebSocket":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        if self._thread.is_alive():
            self._thread.join(5)
        self._socket.close()

    def read(self) -> None:
        """Read from now on."""
        self._thread.start()

    def last(self, path: str, kind: str = "set_property") -> Any:
        """Return the newest command for a node, or None."""
        found = (c for c in reversed(self.commands) if c["path"].strip("/") == path and c["type"] == kind)
        return next(found, None)

    def say(self, data: bytes, opcode: int = 1) -> None:
        """Send a frame, masked with zeros."""
        size = len(data)
        length = struct.pack("!B", 0x80 | size) if size < 126 else struct.pack("!BQ", 0xFF, size)
        self._socket.sendall(bytes([0x80 | opcode]) + length + bytes(4) + data)

    def put(self, data: bytes) -> None:
        """Send bytes as they are, frames or none."""
        self._socket.sendall(data)

    def _exactly(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            part = self._socket.recv(size - len(data))
            if not part:
                raise ConnectionError
            data += part
        return bytes(data)

    def _read(self) -> None:
        with suppress(OSError):
            while True:
                first, size = self._exactly(2)
                if size == 126:
                    size = int.from_bytes(self._exactly(2), "big")
                elif size == 127:
                    size = int.from_bytes(self._exactly(8), "big")
                data = self._exactly(size)
                if first & 15 == 2:
                    self.commands.append(umsgpack.unpackb(data))
                elif first & 15 == 9:
                    self.say(data, 10)
                elif first & 15 == 8:
                    break
        self.closed.set()
