"""The windows behind meshcat, without a browser: what they keep, whom they answer, and every fault."""

import asyncio
import gc
import os
import socket
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from tornado.websocket import WebSocketClosedError

from pinmobile.errors import ViewerError
from pinmobile.viewer import server
from pinmobile.viewer.pages import OfflineWindow, Visualizer
from pinmobile.viewer.server import Browser, LiveWindow
from tests.refusals import refusals, told
from tests.webclient import WebSocket, ask, eventually, listens, resident

pytestmark = pytest.mark.once


class Say(NamedTuple):
    content: dict[str, Any]

    def lower(self) -> dict[str, Any]:
        return self.content


def prop(path: str, name: str, value: Any) -> Say:
    return Say({"type": "set_property", "path": path, "property": name, "value": value})


def delete(path: str) -> Say:
    return Say({"type": "delete", "path": path})


def shape(path: str, data: Any = 0) -> Say:
    return Say({"type": "set_object", "path": path, "object": {"data": data}})


def received(window: LiveWindow, *, least: int = 0) -> list[tuple[Any, ...]]:
    """Return what a browser that comes now is sent: type, path and property."""
    with WebSocket(window.url) as browser:
        assert window.wait(20)
        assert eventually(lambda: len(browser.commands) >= least)
        assert window.flush()
        return [
            tuple(c[word] for word in ("type", "path", "property") if word in c) for c in browser.commands
        ]


@pytest.fixture(autouse=True)
def nothing_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    gc.collect()
    assert eventually(lambda: set(threading.enumerate()) <= before), threading.enumerate()


@pytest.fixture
def window() -> Iterator[OfflineWindow]:
    with OfflineWindow() as opened:  # a live window keeps its scene in the same way
        yield opened


def run(script: str, **options: Any) -> "subprocess.Popen[str]":
    """Start a script that has a window `w` and says its port first."""
    lines = "from pinmobile.viewer.server import LiveWindow\nw = LiveWindow()\nprint(w.port, flush=True)\n"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-W", "error", "-c", lines + textwrap.dedent(script)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, **options)


# What a window keeps


def test_a_command_replaces_the_one_before_and_what_is_deleted_leaves_nothing(window: OfflineWindow) -> None:
    scene = Visualizer(window=window)
    scene["box"].set_transform(np.eye(4))
    scene["box"].set_property("visible", False)
    assert scene.static_html() == window.static_html()
    size = sum(map(len, window.commands()))
    for k in range(3000):
        window.send(prop("meshcat//box/", "visible", k > 0))
        window.send(shape(f"n{k}/below"))
        window.send(delete(f"n{k}"))
    assert sum(map(len, window.commands())) == size + len("meshcat//box/") - len("/meshcat/box")
    scene["box"].delete()
    assert window.commands() == []


def test_a_late_browser_gets_the_scene_in_its_order_and_the_animation_last() -> None:
    with LiveWindow() as w:
        w.send(Say({"type": "set_animation", "path": "", "animations": []}))
        w.send(shape("a"))
        w.send(prop("a", "position", [0.0, 0.0, 0.0]))
        w.send(Say({"type": "set_transform", "path": "a", "matrix": [0.0] * 16}))
        w.send(prop("a", "position", [1.0, 0.0, 0.0]))  # after the transform, which would undo it
        assert received(w, least=4) == [
            ("set_object", "a"),
            ("set_transform", "a"),
            ("set_property", "a", "position"),
            ("set_animation", ""),
        ]


def test_a_connected_browser_is_told_of_deletions_and_replacements_in_order() -> None:
    with LiveWindow() as w, WebSocket(w.url) as browser:
        assert w.wait(20)
        w.send(shape("a", 1))
        assert w.flush()
        w.send(delete("a"))
        w.send(shape("a", 2))
        assert w.flush()
        assert eventually(lambda: len(browser.commands) == 3)
        assert [c["type"] for c in browser.commands] == ["set_object", "delete", "set_object"]


# Whom it answers


def test_the_page_and_its_script_are_served_and_nothing_else() -> None:
    with LiveWindow() as w:
        assert ask(w.url)[0] == 200
        assert ask(w.url, path="/main.min.js")[0] == 200
        for path in ("/index.html", "/../etc/passwd", "/main.min.js.LICENSE.txt", "/%2e%2e/", "/socket/"):
            assert ask(w.url, path=path)[0] == 404
        assert ask(w.url, path="/socket")[0] == 400


@pytest.mark.parametrize("host", ["127.0.0.1.evil.example", ""])
def test_fault_a_host_header_of_another_name_is_refused(host: str) -> None:
    with LiveWindow() as w:
        for path in ("/", "/main.min.js", "/socket", "/missing"):
            assert ask(w.url, {"Host": host.format(port=w.port)}, path=path)[0] in (400, 403)
        with WebSocket(w.url, {"Host": host.format(port=w.port)}) as browser:
            assert browser.status in (400, 403)
            assert w.browsers == 0


@pytest.mark.parametrize("host", ["[::1]:1", "LOCALHOST:8000"])
def test_this_machine_may_have_any_of_its_names_and_a_tunnel_any_port(host: str) -> None:
    with LiveWindow() as w:
        assert ask(w.url, {"Host": host})[0] == 200
        with WebSocket(w.url, {"Host": host, "Origin": f"http://{host}"}) as browser:
            assert browser.status == 101


@pytest.mark.parametrize("origin", ["null", "http://127.0.0.1:1"])
def test_fault_a_websocket_from_another_origin_is_refused(origin: str) -> None:
    with LiveWindow() as w:
        # A browser says both; of the second one tornado would believe anything.
        for more in ({}, {"Sec-Fetch-Site": "same-origin"}):
            with WebSocket(w.url, {"Origin": origin, **more}) as browser:
                assert browser.status == 403
                assert w.browsers == 0
        with WebSocket(w.url, {"Origin": f"http://127.0.0.1:{w.port}"}) as browser:
            assert browser.status == 101


@pytest.mark.parametrize("query", ["", "token=right&token=right"])
def test_fault_a_token_missing_or_wrong_is_refused(query: str) -> None:
    with LiveWindow(token="right") as w:
        for path in ("/", "/main.min.js", "/socket", "/missing"):
            status, text = ask(w.url, path=path, query=query)
            assert status == 403
            assert "right" not in text
        with WebSocket(w.url, query=query) as browser:
            assert browser.status == 403
            assert w.browsers == 0


def test_another_host_is_asked_for_by_name_warned_about_and_needs_a_token() -> None:
    with pytest.warns(UserWarning, match=r"listens on 127\.0\.0\.2: everybody who can reach") as warned:
        windows = LiveWindow("127.0.0.2"), LiveWindow("127.0.0.2")
    assert [Path(one.filename).name for one in warned] == [Path(__file__).name] * 2
    with windows[0] as w, windows[1] as second:
        assert w.url.startswith(f"http://127.0.0.2:{w.port}/?token=")
        assert len(w.url.partition("token=")[2]) >= 32
        assert w.url[-32:] != second.url[-32:]
        assert not listens(w.port)
        assert listens(w.port, "127.0.0.2")
        assert ask(w.url)[0] == 200
        assert ask(w.url, query="")[0] == 403
        assert ask(w.url, {"Host": "evil.example"})[0] == 403


test_arguments_are_checked = refusals(
    (lambda: LiveWindow(host=""), "host is '', expected a name or an address such as '127.0.0.1', '::1'"),
    (lambda: LiveWindow(port=65536), "port is 65536, expected at most 65,535"),
    (lambda: LiveWindow(token='a"b'), "token is empty or not made of letters, digits, '-', '.', '_' and '~'"),
    by=told,
)


# Faults


def test_fault_no_browser() -> None:
    with LiveWindow() as w:
        for k in range(100):
            w.send(prop("a", "x", k))
        assert w.flush()
        with pytest.raises(ViewerError, match=r"no browser has opened http://127\.0\.0\.1:\d+/ within 0\.2"):
            w.wait(0.2)
        with pytest.raises(ViewerError, match="no browser shows the page"):
            w.get_image()


def test_the_token_is_in_the_address_alone(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    with LiveWindow(token="my-secret") as w:
        assert w.url.endswith("?token=my-secret")
        with pytest.raises(ViewerError, match=rf"has opened http://127\.0\.0\.1:{w.port}/ within") as caught:
            w.wait(0)
        monkeypatch.setattr(w._server, "page", 3)
        assert ask(w.url)[0] == 500
        said = [str(caught.value), repr(w), repr(w._server.access), caplog.text]
        assert not any("secret" in text for text in said)
        assert "the viewer failed at /\n" in caplog.text


def test_fault_a_browser_that_stops_reading() -> None:
    with LiveWindow() as w, WebSocket(w.url, reads=False) as stuck, WebSocket(w.url) as reads:
        assert eventually(lambda: w.browsers == 2)
        w.send(shape("mesh", "x" * 12_000_000))
        assert eventually(lambda: reads.last("mesh", "set_object"))
        before, text = resident(), "y" * 2_000
        for k in range(5000):
            w.send(prop(f"a{k % 50}", "x", [k, text]))
            if k % 500 == 0:
                time.sleep(0.02)
        assert not w.flush(0.2)
        assert eventually(lambda: reads.last("a49") and reads.last("a49")["value"][0] == 4999)
        assert resident() - before < 40
        # Once it reads, it has the newest state, and has not been sent what lies between.
        stuck.read()
        assert eventually(lambda: stuck.last("a49") and stuck.last("a49")["value"][0] == 4999)
        assert w.flush()
        assert len(stuck.commands) < 1000


@pytest.mark.parametrize("words", [b"[", b'{"data": "data:,!"}', b"\xff"])
def test_fault_a_browser_that_talks_nonsense(words: bytes) -> None:
    with LiveWindow() as w, WebSocket(w.url) as browser:
        assert w.wait(20)
        with suppress(OSError):  # what is not even text ends the connection
            browser.say(words)
            browser.say(b"99999999999999999999", 10)
            browser.say(words, 2)
        w.send(prop("a", "x", 1))
        assert received(w, least=1) == [("set_property", "a", "x")]


def test_fault_closed_while_it_waits() -> None:
    with LiveWindow() as w:
        threading.Timer(0.3, w.close).start()
        with pytest.raises(ViewerError, match="closed"):
            w.wait()


def test_fault_the_port_is_taken() -> None:
    with LiveWindow() as w:
        with pytest.raises(ViewerError, match=rf"cannot listen on port {w.port} of 127\.0\.0\.1: .*in use"):
            LiveWindow(port=w.port)
        port = w.port
    with LiveWindow(port=port) as again:
        assert again.port == port


def test_fault_four_threads() -> None:
    with LiveWindow() as w, WebSocket(w.url) as browser:

        def work(number: int) -> None:
            for k in range(500):
                w.send(prop(f"own{number}", "x", k))
                w.send(prop("shared", "x", [number, k]))

        threads = [threading.Thread(target=work, args=(n,)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
        assert w.flush()
        assert eventually(lambda: all(browser.last(f"own{n}")["value"] == 499 for n in range(4)))
        assert browser.last("shared")["value"][1] == 499


def test_a_window_that_nobody_holds_is_closed() -> None:
    w = LiveWindow()
    port = w.port
    del w
    gc.collect()
    assert not listens(port)


def test_a_script_that_ends_leaves_nothing_and_says_nothing() -> None:
    with run("raise SystemExit(3)", stderr=subprocess.PIPE) as process:
        out, err = process.communicate(timeout=30)
        assert err == ""
        assert process.returncode == 3
        assert not listens(int(out))


# Clients that mean it ill, or are broken


@pytest.mark.parametrize("request_", [b"", b"GET / HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n"])
def test_a_request_that_never_ends_is_ended(request_: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_TIMEOUT", 0.3)
    with LiveWindow() as w, socket.create_connection(("127.0.0.1", w.port), timeout=120) as connection:
        connection.sendall(request_)
        assert connection.recv(1) == b""


def test_a_forked_child_has_no_part_in_the_window() -> None:
    script = """
        import os
        w.wait(30)
        child = os.fork()
        if child == 0:
            try:
                w.send(None)
            except Exception as error:
                os.write(1, f"{type(error).__name__} {error}\\n".encode())
            w.close()
            os._exit(0)
        os.waitpid(child, 0)
        print(w.browsers, w.flush())
    """
    with run(script) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline())
        with WebSocket(f"http://127.0.0.1:{port}/"):
            assert process.stdout.readline() == "ViewerError the window is closed\n"
            assert process.stdout.readline() == "1 True\n"


def test_a_page_that_closes_while_it_is_sent_leaves_no_error_behind() -> None:
    told: list[Any] = []

    async def closed() -> None:
        raise WebSocketClosedError

    def write(command: bytes, binary: bool) -> Any:
        if command == b"second":
            raise WebSocketClosedError
        return asyncio.ensure_future(closed())

    async def send() -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context))
        backlog = SimpleNamespace(commands_after=lambda sent: ([b"first", b"second"], 2))
        server = SimpleNamespace(backlog=backlog, notify=lambda: None)
        browser: Any = SimpleNamespace(is_ready=True, server=server, sent=0, write_message=write)
        await Browser.feed(browser)
        assert not browser._writing
        await asyncio.sleep(0)
        gc.collect()

    asyncio.run(send())
    assert told == []
