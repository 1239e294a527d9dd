"""The live window among clients that mean it ill, or are broken: connections, messages, requests."""

import base64
import os
import socket
import struct
import subprocess
import sys
import textwrap
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from io import BytesIO
from typing import Any

import pytest
from PIL import Image

from pinmobile.errors import ViewerError
from pinmobile.viewer.live import server, window
from pinmobile.viewer.live.window import LiveWindow
from tests.webclient import WebSocket, ask, eventually

_FEW = 256  # descriptors of a process, macOS's default


@contextmanager
def few_descriptors(script: str) -> Iterator["subprocess.Popen[str]"]:
    """Yield a process with few descriptors and a window `w`, which has said its port."""
    lines = f"""
        import os, resource, socket, sys, time
        resource.setrlimit(resource.RLIMIT_NOFILE, ({_FEW}, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
        from pinmobile.viewer.live.window import LiveWindow
        w = LiveWindow()
        print(w.port, flush=True)
    """
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(lines) + textwrap.dedent(script)],
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def said(process: "subprocess.Popen[str]") -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def tell(process: "subprocess.Popen[str]") -> None:
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()


def silent(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=120)


def websocket(port: int) -> WebSocket:
    return WebSocket(f"http://127.0.0.1:{port}/", reads=False)


@pytest.mark.parametrize("connect", [silent, websocket])
def test_300_connections_leave_the_process_its_own_files(
    connect: Callable[[int], AbstractContextManager[Any]],
) -> None:
    script = """
        sys.stdin.readline()
        files = [os.open(os.devnull, os.O_RDONLY) for _ in range(100)]
        print(len(files), flush=True)
        sys.stdin.readline()
    """
    with few_descriptors(script) as process, ExitStack() as stack:
        port = int(said(process))
        for _ in range(300):
            stack.enter_context(connect(port))
        tell(process)
        assert said(process) == "100"
        # A page that comes now is served all the same.
        assert ask(f"http://127.0.0.1:{port}/")[0] == 200
        tell(process)
        assert process.wait(120) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""


def test_without_descriptors_it_waits_says_so_once_and_goes_on() -> None:
    script = f"""
        files, tries, accept = [], [], socket.socket.accept
        socket.socket.accept = lambda listener: (tries.append(0), accept(listener))[1]
        try:
            while True:
                files.append(os.open(os.devnull, os.O_RDONLY))
        except OSError:
            print(len(files) < {_FEW}, flush=True)
        sys.stdin.readline()
        time.sleep(2.5)
        print(1 <= len(tries) <= 10, flush=True)
        for file in files:
            os.close(file)
        print("there are some again", flush=True)
        sys.stdin.readline()
    """
    with few_descriptors(script) as process, ExitStack() as stack:
        port = int(said(process))
        assert said(process) == "True"
        for _ in range(20):
            stack.enter_context(silent(port))
        tell(process)
        assert said(process) == "True"  # it does not try all the time
        assert said(process) == "there are some again"
        assert ask(f"http://127.0.0.1:{port}/")[0] == 200
        tell(process)
        assert process.wait(120) == 0
        assert process.stderr is not None
        assert process.stderr.read().splitlines() == [
            "the viewer cannot take connections: Too many open files; it goes on trying"
        ]


@pytest.mark.parametrize(
    "request_", [b"", b"GET / HTTP/1.1\r\nHost: x", b"GET / HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n"]
)
def test_a_request_that_never_ends_is_ended(request_: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(window, "_REQUEST", 0.3)
    with LiveWindow() as w, silent(w.port) as connection:
        connection.sendall(request_)
        assert connection.recv(1) == b""


def test_an_answer_that_nobody_reads_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_LIFE", 0.3)
    with LiveWindow() as w, WebSocket(w.url) as browser, silent(w.port) as connection:
        assert w.wait(120)
        asked = f"GET /main.min.js HTTP/1.1\r\nHost: 127.0.0.1:{w.port}\r\n\r\n".encode()
        connection.sendall(asked * 50)
        assert eventually(lambda: len(w._server._http.streams) == 1)
        assert not browser.closed.is_set()  # a page stays


@pytest.mark.parametrize("lines", [b"X: y\r\n" * 20_000, b"X: " + b"y" * 100_000 + b"\r\n"])
def test_a_header_of_many_lines_or_a_long_one_is_not_read(lines: bytes) -> None:
    with LiveWindow() as w, silent(w.port) as connection:
        asked = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{w.port}\r\n".encode() + lines + b"\r\n"
        assert not exchanged(connection, asked).startswith(b"HTTP/1.1 200")


def exchanged(connection: socket.socket, data: bytes) -> bytes:
    """Return what is answered until the end; a connection may be reset while it is written to."""
    answer = b""
    with suppress(ConnectionError):
        connection.sendall(data)
        while part := connection.recv(1 << 16):
            answer += part
    return answer


def frame(size: int, opcode: int) -> bytes:
    """Return the head of a masked frame of a size; an opcode below 0x80 is one of several frames."""
    return struct.pack("!BBQ", opcode, 0xFF, size) + bytes(4)


@pytest.mark.parametrize(
    "words",
    [
        frame(1025, 0x81),
        frame(60 << 20, 0x81),
        frame(1 << 63, 0x82),
        frame(600, 0x01) + bytes(600) + frame(600, 0x00),
    ],
)
def test_an_unasked_message_of_more_than_a_kilobyte_ends_the_connection(words: bytes) -> None:
    with LiveWindow() as w, WebSocket(w.url) as browser:
        assert w.wait(120)
        browser.put(words)
        assert browser.closed.wait(120)
        assert eventually(lambda: w.browsers == 0)


def png() -> bytes:
    file = BytesIO()
    Image.new("RGBA", (2, 1), (1, 2, 3, 255)).save(file, "PNG")
    return file.getvalue()


def picture(data: bytes) -> bytes:
    return b'{"type":"img","data":"data:image/png;base64,%s"}' % base64.b64encode(data)


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack("!I", len(data)) + kind + data + struct.pack("!I", zlib.crc32(kind + data))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        png()[:40],
        png()[:33] + chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(80 << 20))) + png()[33:],
        png()[:33] + chunk(b"IHDR", b"") + png()[33:],
        png()[:8] + chunk(b"IHDR", struct.pack("!IIBBBBB", 1 << 16, 1 << 16, 8, 6, 0, 0, 0)) + png()[33:],
    ],
)
def test_a_damaged_picture_is_the_librarys_error(data: bytes) -> None:
    with LiveWindow() as w, WebSocket(w.url) as browser:
        assert w.wait(120)
        threading.Timer(0.2, browser.say, [picture(data)]).start()
        with pytest.raises(ViewerError, match="the browser has sent no picture: "):
            w.get_image()


@pytest.mark.parametrize(
    "nonsense",
    [b"[" * 200_000, b'{"data":' * 200_000, b"[]," * 1_000_000, b'"data":"data:image/png;base64,!' * 50_000],
)
def test_nonsense_beside_a_picture_is_passed_over(nonsense: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    with LiveWindow() as w, WebSocket(w.url) as browser:
        assert w.wait(120)
        taken: list[Any] = []
        asking = threading.Thread(target=lambda: taken.append(w.get_image()))
        asking.start()
        assert eventually(lambda: len(browser.commands) == 1)
        browser.say(nonsense)
        browser.say(picture(png()))
        asking.join(30)
        assert [image.size for image in taken] == [(2, 1)]
        # From now on nothing large is taken.
        with suppress(ConnectionError):
            browser.say(nonsense)
        assert browser.closed.wait(120)
    assert capfd.readouterr().err == ""
