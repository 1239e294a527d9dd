"""A scene as the commands that make it: the newest of each kind, in the order in which they came."""

from collections import OrderedDict
from threading import Lock
from typing import Any, NamedTuple

from pinmobile.viewer.wire import Key, Update, packed

__all__ = ["Backlog"]

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

    @property
    def deletions(self) -> int:
        """How many deletions are still kept for those who have not seen them."""
        return len(self._deletions)

    def put(self, command: Any) -> None:
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
                    self._delete(packed(_Delete(name)))
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

    def _append(self, update: Update) -> None:
        if update.key not in self._entries:
            for path in _up(update.key.path):
                self._below.setdefault(path, set()).add(update.key)
        # In this order: a key that is new but not yet last is only sent later.
        self._entries[update.key] = _Entry(self._latest + 1, update.data)
        self._entries.move_to_end(update.key)
        self._latest += 1

    def _delete(self, update: Update) -> None:
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


class _Delete(NamedTuple):
    path: str

    def lower(self) -> dict[str, str]:
        return {"type": "delete", "path": self.path}
