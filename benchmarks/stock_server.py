"""Meshcat's own server, beside which the live window is measured: on loopback alone, and ended for certain.

As published it listens at all addresses and outlives the script that started it. Here it is a child process
in which the web port is bound to 127.0.0.1; it ends when its standard input does, and it is killed.
"""

import functools
import io
import json
import os
import select
import subprocess
import sys
import threading
from contextlib import redirect_stdout
from types import TracebackType
from typing import Any

__all__ = ["LOOPBACK", "StockServer"]

LOOPBACK = "127.0.0.1"
PATIENCE = 20.0  # [s] for its start and for each answer


class StockServer:
    """Meshcat's server in a process of its own, as a context manager.

    Attributes
    ----------
    url : str
        Address of the page.
    window : meshcat window
        For ``meshcat.Visualizer(window=...)``; what is not answered within 20 s raises `zmq.Again`.
    """

    def __enter__(self) -> "StockServer":
        self._process = subprocess.Popen(
            [sys.executable, "-W", "ignore", __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        try:
            ready, _, _ = select.select([self._process.stdout], [], [], PATIENCE)
            line = self._process.stdout.readline() if ready else b""
            if not line:
                raise RuntimeError(f"meshcat's server did not start within {PATIENCE:g} s")
            zmq_url, self.url = json.loads(line)
            self.window = client(zmq_url)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.window.zmq_socket.close(0)
        self.close()

    def close(self) -> None:
        """Kill it."""
        self._process.kill()
        self._process.wait()
        self._process.stdin.close()
        self._process.stdout.close()


def client(zmq_url: str) -> Any:
    """Return meshcat's own window on a server, which waits for an answer, but not for ever."""
    import pinmobile.viewer.pages  # noqa: F401, I001 - first, for it keeps zmq's warnings quiet
    import zmq
    from meshcat.visualizer import ViewerWindow

    class Window(ViewerWindow):
        def connect_zmq(self) -> None:
            if hasattr(self, "zmq_socket"):
                self.zmq_socket.close(0)  # it connects twice and forgets the first
            super().connect_zmq()
            self.zmq_socket.setsockopt(zmq.LINGER, 0)
            for option in (zmq.RCVTIMEO, zmq.SNDTIMEO):
                self.zmq_socket.setsockopt(option, round(1e3 * PATIENCE))

    with redirect_stdout(io.StringIO()):
        return Window(zmq_url, start_server=False, server_args=[])


def serve() -> None:
    """Run the server in this process until its standard input ends."""
    import tornado.web
    from meshcat.servers.zmqserver import ZMQWebSocketBridge

    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(0)), daemon=True).start()
    everywhere = tornado.web.Application.listen
    tornado.web.Application.listen = functools.partialmethod(everywhere, address=LOOPBACK)
    bridge = ZMQWebSocketBridge(host=LOOPBACK)
    print(json.dumps([bridge.zmq_url, bridge.web_url]), flush=True)
    bridge.run()


if __name__ == "__main__":
    serve()
