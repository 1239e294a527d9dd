"""Scenes in memory: meshcat commands, windows, and pages that show them."""

from __future__ import annotations

import base64
import re
import warnings
from collections import OrderedDict
from collections.abc import Iterable
from functools import cache
from hashlib import sha256
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from threading import Lock
from typing import Any, NamedTuple, Protocol, Self

from pinmobile.errors import ViewerError, unexpected_value

with warnings.catch_warnings():
    # The client of meshcat imports deprecated parts of zmq.
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat
    import umsgpack


Visualizer = meshcat.Visualizer
pack_array = meshcat.geometry.pack_numpy_array
pack_content = umsgpack.packb

ENGINE = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
"""Meshcat's viewer, with three.js included."""


# The controls of meshcat add inline styles with unknown hashes.
_POLICY = (
    "default-src 'none'; script-src {0}; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; "
    "form-action 'none'"
)


def loading_script(commands: Iterable[bytes]) -> str:
    """Return the script that loads meshcat commands into a scene."""
    texts = ",\n".join(f'"{base64.b64encode(command).decode()}"' for command in commands)
    return (
        f"for (const text of [\n{texts}\n]) viewer.handle_command_bytearray("
        "Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)));"
    )


def seal_page(page: str) -> str:
    """Return a self-contained page with a content security policy: only its scripts run, without requests.

    Parameters
    ----------
    page : str
        HTML with each script in a plain ``<script>``.
    """
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    hashes = (base64.b64encode(sha256(script.encode()).digest()).decode() for script in scripts)
    policy = _POLICY.format(" ".join(f"'sha256-{each}'" for each in dict.fromkeys(hashes)))
    tag = f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
    return page.replace("<head>", f"<head>\n{tag}", 1)


def stage_page(title: str, engine: str, scene: str) -> str:
    """Return the page of the stage; `engine` is HTML that loads meshcat, `scene` is HTML that fills it."""
    css, stage = page_part("stage.css"), page_part("stage.js")
    page = Template(page_part("stage.html"))
    return page.substitute(title=escape(title), css=css, stage=stage, engine=engine, scene=scene)


@cache
def page_part(name: str) -> str:
    """Return the text of a file beside this module."""
    return files("pinmobile.viewer").joinpath(name).read_text(encoding="utf-8").strip()


@cache
def engine() -> str:
    """Return the script of meshcat's viewer."""
    return ENGINE.read_text(encoding="utf-8")


_KINDS = {
    "set_transform": "matrix",
    "set_object": "object",
    "set_property": "value",
    "set_animation": "animations",
    "delete": "path",
}


class Command(Protocol):
    """Protocol of meshcat commands."""

    def lower(self) -> dict[str, Any]:
        """Return the dict that the page of meshcat reads."""
        ...


class Content(NamedTuple):
    """Meshcat command for a window, made from its content."""

    content: dict[str, Any]

    def lower(self) -> dict[str, Any]:
        """Return the dict that the page of meshcat reads."""
        return self.content


class Key(NamedTuple):
    """Target of a command. A later command with the same key replaces an earlier one."""

    kind: str
    path: str
    name: str = ""


def pack_command(command: Command) -> tuple[Key, bytes]:
    """Return a command as sent to browsers.

    Parameters
    ----------
    command : Command
        Meshcat command.

    Raises
    ------
    InvalidArgument
        If `command` is not a meshcat command, or contains a number that is not finite.
    """
    try:
        content = command.lower()
        kind, path = content["type"], content["path"]
        _ = content[_KINDS[kind]]
        key = Key(kind, "/".join(filter(None, path.split("/"))), content.get("property", ""))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        expected = f"a meshcat command ({', '.join(_KINDS)}): {error!r}"
        raise unexpected_value("command", command, expected) from error
    return key, pack_content(content)


# Nodes of the page before any command. The backlog keeps deletions of these nodes. For other nodes, it only
# drops the node.
_LIGHTS = ("SpotLight", "PointLightNegativeX", "PointLightPositiveX", "AmbientLight", "FillLight")
_CAMERAS = ("Cameras", "Cameras/default", "Cameras/default/rotated")
_PAGE_NODES = ("Background", "Grid", "Axes", "Lights", *(f"Lights/{name}" for name in _LIGHTS), *_CAMERAS)
_PERMANENT_NODES = {*_PAGE_NODES, *(f"{path}/<object>" for path in _PAGE_NODES)}


class Backlog:
    """Numbered commands of a scene. A browser asks for the commands after the last number it received.

    A command replaces an earlier command with the same key. The size of the backlog is therefore the size of
    the scene. Several threads may use a backlog at once. An interrupt in a method leaves it consistent.
    """

    def __init__(self) -> None:
        self._entries: OrderedDict[Key, tuple[int, bytes]] = OrderedDict()  # number and data
        self._index: dict[str, set[Key]] = {}  # by path: keys of the node and of nodes below
        self._deletions: set[Key] = set()
        self._latest = 0
        self.lock = Lock()

    @property
    def latest(self) -> int:
        """Number of the newest command."""
        return self._latest

    def put(self, command: Command) -> None:
        """Add a meshcat command.

        Raises
        ------
        InvalidArgument
            If `command` is not a meshcat command, or contains a number that is not finite.
        """
        key, data = pack_command(command)
        kind, path, _ = key
        with self.lock:
            if kind != "delete":
                if kind == "set_object":
                    self._drop(f"{path}/<object>")  # a new object does not have the properties of the old one
                self._append(key, data)
            elif path:
                self._delete(key, data)
            else:
                # The page of meshcat cannot delete the root, only all nodes below it.
                for name in [path for path in self._index if path and "/" not in path]:
                    self._delete(*pack_command(Content({"type": "delete", "path": name})))
                self._entries.pop(Key("set_animation", ""), None)

    def commands_after(self, number: int) -> tuple[list[bytes], int]:
        """Return the commands after a number (0: the whole scene), and the number of the newest command.

        Animations come last, because an animation binds to existing nodes.
        """
        newer: list[bytes] = []
        animation: list[bytes] = []
        with self.lock:
            for key, (command, data) in reversed(self._entries.items()):
                if command <= number:
                    break
                (animation if key.kind == "set_animation" else newer).append(data)
            return newer[::-1] + animation, self._latest

    def drop_deletions(self, number: int) -> None:
        """Drop the deletions up to a number that all browsers have received."""
        if not self._deletions:
            return
        with self.lock:
            for key in list(self._deletions):
                if key not in self._entries or self._entries[key][0] <= number:
                    self._remove(key)

    # An interrupt in these three methods may leave keys in the index without an entry, but not the reverse.

    def _append(self, key: Key, data: bytes) -> None:
        if key not in self._entries:
            for path in _parent_paths(key.path):
                self._index.setdefault(path, set()).add(key)
        # The order matters: a new key that is not yet last is only sent later.
        self._entries[key] = self._latest + 1, data
        self._entries.move_to_end(key)
        self._latest += 1

    def _delete(self, key: Key, data: bytes) -> None:
        self._drop(key.path)
        self._append(key, data)
        if key.path not in _PERMANENT_NODES:
            self._deletions.add(key)

    def _drop(self, path: str) -> None:
        for key in list(self._index.get(path, ())):
            self._remove(key)

    def _remove(self, key: Key) -> None:
        self._entries.pop(key, None)
        self._deletions.discard(key)
        for path in _parent_paths(key.path):
            keys = self._index.get(path, set())
            keys.discard(key)
            if not keys:
                self._index.pop(path, None)


def _parent_paths(path: str) -> list[str]:
    """Return a path and all its parent paths."""
    names = path.split("/")
    return ["/".join(names[:k]) for k in range(1, len(names) + 1)]


_SCRIPT, _CONNECTION = '<script type="text/javascript" src="main.min.js">', "viewer.connect();"


class SceneWindow:
    """Window with a scene in memory.

    Parameters
    ----------
    backlog : Backlog
        Commands of the scene.
    """

    def __init__(self, backlog: Backlog) -> None:
        self._backlog = backlog

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def commands(self) -> list[bytes]:
        """Return the packed commands of the scene; animations come last."""
        return self._backlog.commands_after(0)[0]

    def get_scene(self) -> str:
        """Return a self-contained page of the scene as HTML. The page makes no request."""
        return static_page(self.commands())

    static_html = get_scene

    def close(self) -> None:
        """Close the window. The scene remains in memory."""


class OfflineWindow(SceneWindow):
    """A meshcat scene in memory: ``meshcat.Visualizer(window=OfflineWindow())``.

    The window needs no process, port or thread.

    See Also
    --------
    viewer.Viewer : scene of a robot and its rollouts
    viewer.LiveWindow : the same in browsers

    Examples
    --------
    >>> import meshcat
    >>> from pinmobile.viewer import OfflineWindow
    >>> window = OfflineWindow()
    >>> scene = meshcat.Visualizer(window=window)
    >>> _ = scene["box"].set_object(meshcat.geometry.Box([1, 1, 1]))
    >>> len(window.commands())
    1
    """

    def __init__(self) -> None:
        super().__init__(Backlog())

    def send(self, command: Command) -> None:
        """Add a meshcat command to the scene.

        Parameters
        ----------
        command : object
            Meshcat command: an object with a method ``lower()``.

        Raises
        ------
        InvalidArgument
            If `command` is not a meshcat command, or contains a number that is not finite.
        """
        self._backlog.put(command)
        self._backlog.drop_deletions(self._backlog.latest)  # no browser needs them


def static_page(commands: list[bytes]) -> str:
    """Return the page of meshcat with its script and a scene.

    Raises
    ------
    ViewerError
        If the page of the installed meshcat has an unknown form.
    """
    page = ENGINE.with_name("index.html").read_text(encoding="utf-8")
    if _SCRIPT not in page or _CONNECTION not in page:
        raise ViewerError(f"the installed meshcat has another page: {ENGINE.with_name('index.html')}")
    head, _, rest = page.partition(_SCRIPT)
    body = rest.replace(_CONNECTION, loading_script(commands))
    return seal_page(f"{head}<script>\n{engine()}\n{body}")
