"""A scene in memory: what meshcat's commands have made of it, as few commands."""

from typing import Any

from pinmobile.viewer.stock import packed_command

__all__ = ["Reel"]


class Reel:
    """A window that keeps the scene and shows it to nobody.

    What is replaced or removed is forgotten, so that it does not grow with the number of commands.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[str, str], dict[str, Any]] = {}

    def send(self, command: Any) -> None:
        """Take a command, an object whose ``lower()`` is the dict that meshcat's page reads."""
        content = command.lower()
        kind, path = content["type"], _clean(content["path"])
        if kind == "delete":
            self._kept = {
                key: value
                for key, value in self._kept.items()
                if key[0] != path and not key[0].startswith(path + "/")
            }
            return
        key = path, content["property"] if kind == "set_property" else kind
        if kind == "set_object":
            self._kept.pop(key, None)  # what is set of the object comes after it
        self._kept[key] = content

    def commands(self) -> list[bytes]:
        """Return the commands that make the scene, packed as meshcat sends them."""
        return [packed_command(content) for content in list(self._kept.values())]


def _clean(path: str) -> str:
    return "/".join(part for part in path.split("/") if part)
