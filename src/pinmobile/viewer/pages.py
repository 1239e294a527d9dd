"""A scene in memory: the commands that make it, a window onto it, and the pages that can show it."""

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
from math import isfinite
from pathlib import Path
from string import Template
from threading import Lock
from typing import Any, NamedTuple, Protocol, Self

import numpy as np

from pinmobile.arrays import finite
from pinmobile.errors import InvalidArgument, ViewerError, shown

with warnings.catch_warnings():
    # Its client imports parts of zmq that zmq warns about.
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat
    import umsgpack


Visualizer = meshcat.Visualizer
packed_array = meshcat.geometry.pack_numpy_array
packed_command = umsgpack.packb

ENGINE = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
"""Meshcat's viewer with three.js in it."""


# Meshcat's controls bring styles of their own, which have no hash that could be known.
_POLICY = (
    "default-src 'none'; script-src {0}; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; "
    "form-action 'none'"
)


def loading(commands: Iterable[bytes]) -> str:
    """Return the script that puts meshcat's commands into a scene."""
    texts = ",\n".join(f'"{base64.b64encode(command).decode()}"' for command in commands)
    return (
        f"for (const text of [\n{texts}\n]) viewer.handle_command_bytearray("
        "Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)));"
    )


def sealed(page: str) -> str:
    """Return a page that holds everything it shows with a policy: its own scripts run, and ask for nothing.

    Parameters
    ----------
    page : str
        HTML, each of its scripts in a plain ``<script>``.
    """
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    hashes = (base64.b64encode(sha256(script.encode()).digest()).decode() for script in scripts)
    policy = _POLICY.format(" ".join(f"'sha256-{each}'" for each in dict.fromkeys(hashes)))
    tag = f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
    return page.replace("<head>", f"<head>\n{tag}", 1)


def stage_page(title: str, engine: str, scene: str) -> str:
    """Return the stage's page; `engine` is the HTML that loads meshcat's viewer, `scene` fills it."""
    parts = {"css": _part("stage.css"), "stage": _part("stage.js"), "engine": engine, "scene": scene}
    return Template(_part("stage.html")).substitute(parts, title=escape(title))


@cache
def _part(name: str) -> str:
    return files("pinmobile.viewer").joinpath(name).read_text(encoding="utf-8").strip()


@cache
def engine() -> str:
    """Return meshcat's viewer as a script in a page."""
    return ENGINE.read_text(encoding="utf-8")


_KINDS = {
    "set_transform": "matrix",
    "set_object": "object",
    "set_property": "value",
    "set_animation": "animations",
    "delete": "path",
}
_FLOAT32 = 0x17  # the MessagePack extension in which meshcat has arrays of floats


class Command(Protocol):
    """A command of meshcat's."""

    def lower(self) -> dict[str, Any]:
        """Return the dict that meshcat's page reads."""
        ...


class Content(NamedTuple):
    """A command for a window, as `meshcat.commands` has them."""

    content: dict[str, Any]

    def lower(self) -> dict[str, Any]:
        """Return what meshcat's page reads."""
        return self.content


class Key(NamedTuple):
    """What a command sets: a later command with the same key replaces it."""

    kind: str
    path: str
    name: str = ""


class _Update(NamedTuple):
    """A command as it is sent."""

    key: Key
    data: bytes


def packed(command: Command) -> _Update:
    """Return a command as it is sent.

    Parameters
    ----------
    command : meshcat command
        Anything with a `lower` that returns the dict which meshcat's page reads.

    Raises
    ------
    InvalidArgument
        If it is no such command, or holds a number that is not finite.
    """
    try:
        content = command.lower()
        kind, path = content["type"], content["path"]
        payload = content[_KINDS[kind]]
        key = Key(kind, "/".join(filter(None, path.split("/"))), content.get("property", ""))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InvalidArgument(
            f"command is {shown(command)}, expected one of meshcat's ({', '.join(_KINDS)}): {error!r}"
        ) from error
    _check(f"{kind} of {key.path or '/'}: {_KINDS[kind]}", payload)
    if kind == "set_transform" and len(payload) != 16:
        raise InvalidArgument(f"the transform of {key.path} has {len(payload)} numbers, expected 16")
    try:
        return _Update(key, packed_command(content))
    except Exception as error:  # the packer's own errors have no common base
        raise InvalidArgument(f"{kind} of {key.path or '/'} cannot be sent: {error}") from error


def _check(name: str, value: object) -> None:
    """Refuse NaN and infinity, at any depth; a flat list of numbers costs one sum."""
    if isinstance(value, float):
        if not isfinite(value):
            raise InvalidArgument(f"{name} is {value}, expected a finite number")
    elif isinstance(value, list | tuple):
        try:
            if isfinite(sum(value)):
                return
        except TypeError:
            pass
        for index, item in enumerate(value):
            _check(f"{name}[{index}]", item)
    elif isinstance(value, dict):
        for word, item in value.items():
            _check(f"{name}.{word}", item)
    elif isinstance(value, umsgpack.Ext) and value.type == _FLOAT32:
        finite(name, np.frombuffer(value.data, np.float32))


# What meshcat's page has before any command. That one of these was deleted has to be remembered; of any
# other node it is enough not to remember the node.
_GIVEN = (
    "Background",
    "Grid",
    "Axes",
    "Lights",
    "Lights/SpotLight",
    "Lights/PointLightNegativeX",
    "Lights/PointLightPositiveX",
    "Lights/AmbientLight",
    "Lights/FillLight",
    "Cameras",
    "Cameras/default",
    "Cameras/default/rotated",
)
_REMEMBERED = {*_GIVEN, *(f"{path}/<object>" for path in _GIVEN)}


class _Entry(NamedTuple):
    number: int
    data: bytes


class Backlog:
    """The scene. Commands are numbered; who has seen some asks for those since.

    A command replaces an earlier one for the same thing, so that the size is that of the scene, no matter
    how many have come. It may be used from several threads; an interrupt in any of its methods leaves it
    consistent.
    """

    def __init__(self) -> None:
        self._entries: OrderedDict[Key, _Entry] = OrderedDict()
        self._below: dict[str, set[Key]] = {}  # by path, what is there and below
        self._deletions: set[Key] = set()
        self._latest = 0
        self.lock = Lock()

    @property
    def latest(self) -> int:
        """Number of the newest command."""
        return self._latest

    @property
    def size(self) -> int:
        """Of all commands [byte]."""
        with self.lock:
            return sum(len(entry.data) for entry in self._entries.values())

    def put(self, command: Command) -> None:
        """Take a command of meshcat's.

        Raises
        ------
        InvalidArgument
            If it is none, or holds a number that is not finite.
        """
        update = packed(command)
        kind, path, _ = update.key
        with self.lock:
            if kind != "delete":
                if kind == "set_object":
                    self._drop(f"{path}/<object>")  # a new object has none of the old one's properties
                self._append(update)
            elif path:
                self._delete(update)
            else:
                # Meshcat's page cannot delete the root, but all that is below it.
                for name in [path for path in self._below if path and "/" not in path]:
                    self._delete(packed(Content({"type": "delete", "path": name})))
                self._entries.pop(Key("set_animation", ""), None)

    def since(self, number: int) -> tuple[list[bytes], int]:
        """Return the commands after a number, and the number of the newest; after 0, the whole scene.

        An animation is last: it binds to what is there when it comes.
        """
        newer: list[bytes] = []
        animation: list[bytes] = []
        with self.lock:
            for key, entry in reversed(self._entries.items()):
                if entry.number <= number:
                    break
                (animation if key.kind == "set_animation" else newer).append(entry.data)
            return newer[::-1] + animation, self._latest

    def forget_deletions(self, number: int) -> None:
        """Drop the deletions up to a number, which everyone has seen."""
        if not self._deletions:
            return
        with self.lock:
            for key in list(self._deletions):
                if key not in self._entries or self._entries[key].number <= number:
                    self._forget(key)

    # In these three, an interrupt may leave what is in the index but not in the entries, not the reverse.

    def _append(self, update: _Update) -> None:
        if update.key not in self._entries:
            for path in _up(update.key.path):
                self._below.setdefault(path, set()).add(update.key)
        # In this order: a key that is new but not yet last is only sent later.
        self._entries[update.key] = _Entry(self._latest + 1, update.data)
        self._entries.move_to_end(update.key)
        self._latest += 1

    def _delete(self, update: _Update) -> None:
        path = update.key.path
        self._drop(path)
        self._append(update)
        if path not in _REMEMBERED:
            self._deletions.add(update.key)

    def _drop(self, path: str) -> None:
        for key in list(self._below.get(path, ())):
            self._forget(key)

    def _forget(self, key: Key) -> None:
        self._entries.pop(key, None)
        self._deletions.discard(key)
        for path in _up(key.path):
            keys = self._below.get(path, set())
            keys.discard(key)
            if not keys:
                self._below.pop(path, None)


def _up(path: str) -> list[str]:
    """Return a path and those above it."""
    names = path.split("/")
    return ["/".join(names[:k]) for k in range(1, len(names) + 1)]


_SCRIPT, _CONNECTING = '<script type="text/javascript" src="main.min.js">', "viewer.connect();"


class SceneWindow:
    """A window whose scene is in memory.

    Parameters
    ----------
    backlog : Backlog
        The scene.
    """

    def __init__(self, backlog: Backlog) -> None:
        self._backlog = backlog

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def scene_size(self) -> int:
        """Of the commands that make the scene [byte]."""
        return self._backlog.size

    def commands(self) -> list[bytes]:
        """Return the commands that make the scene, as they would be sent, the animation last."""
        return self._backlog.since(0)[0]

    def get_scene(self) -> str:
        """Return meshcat's page with the scene in it: self-contained, without a request to anywhere."""
        return static_page(self.commands())

    static_html = get_scene

    def close(self) -> None:
        """End what the window has opened; the scene remains."""


class OfflineWindow(SceneWindow):
    """A scene in memory: ``meshcat.Visualizer(window=OfflineWindow())``. No process, no port, no thread."""

    def __init__(self) -> None:
        super().__init__(Backlog())

    def send(self, command: Command) -> None:
        """Take a command of meshcat's.

        Raises
        ------
        InvalidArgument
            If it is none, or holds a number that is not finite.
        """
        self._backlog.put(command)
        self._backlog.forget_deletions(self._backlog.latest)  # there is nobody to be told of them


def static_page(commands: list[bytes]) -> str:
    """Return meshcat's own page with its script and a scene in it."""
    page = ENGINE.with_name("index.html").read_text(encoding="utf-8")
    if _SCRIPT not in page or _CONNECTING not in page:
        raise ViewerError(f"the page of the installed meshcat has changed: {ENGINE.with_name('index.html')}")
    head, _, rest = page.partition(_SCRIPT)
    body = rest.replace(_CONNECTING, loading(commands))
    return sealed(f"{head}<script>\n{engine()}\n{body}")
