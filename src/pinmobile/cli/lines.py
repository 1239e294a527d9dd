"""Where something stands in a TOML file: its parser does not tell."""

import re
from collections.abc import Mapping
from typing import Any

from pinmobile import PinmobileError, UnknownName

__all__ = ["line", "line_of", "line_of_syntax"]


def line(text: str, table: str, key: str | None = None) -> int:
    """Return the line of a table or of a key in it."""
    where, header = "", 1
    for number, row in enumerate(text.splitlines(), start=1):
        if found := re.match(r"\s*\[\s*([^\]]+?)\s*\]", row):
            where = found[1]
            if where.split(".")[0] == table:
                header = number
                if key is None or where == f"{table}.{key}":
                    return number
            continue
        name = row.split("=")[0].strip().replace('"', "").replace("'", "") if "=" in row else ""
        full = f"{where}.{name}" if where else name
        wanted = table if key is None else f"{table}.{key}"
        if full == wanted or full.startswith(f"{wanted}."):
            return number
    return header


def line_of_syntax(message: str, text: str) -> tuple[int, str]:
    """Return the line of a message of the parser, and the message without it."""
    found = re.search(r" \(at line (\d+), column (\d+)\)", message)
    if found is None:
        return max(1, len(text.splitlines())), message
    return int(found[1]), message[: found.start()]


def line_of(
    error: PinmobileError, message: str, text: str, tree: Mapping[str, Any], swept: Mapping[str, Any]
) -> int:
    """Return the line of what an error is about; 0 where it cannot be told.

    That is where the name stands that is not known, else the first key that the message names.

    Parameters
    ----------
    error : PinmobileError
        What was raised.
    message : str
        What is said about it.
    text : str
        The file.
    tree : mapping
        The tables, without what is swept.
    swept : mapping
        What is swept, by dotted names.
    """
    at = _line_of_dotted(message, text, tree, swept)
    if at:
        return at
    if isinstance(error, UnknownName):
        for name, values in swept.items():
            if _holds(values, error.name):
                return line(text, "grid", name)
        for table, key, value in _keys(tree):
            if key == error.name or _holds(value, error.name):
                return line(text, table, key)
        for name in swept:
            if error.name in name.split("."):
                return line(text, "grid", name)
    for reference in re.findall(r"[\w./]+:[\w.]*", message):  # module:Name, or module.py:12
        module = reference.partition(".py:")[0]
        for name, values in swept.items():
            if _holds(values, module):
                return line(text, "grid", name)
        for table, key, value in _keys(tree):
            if _holds(value, module):
                return line(text, table, key)
    said, _, place = message.partition(" (at ")
    for word in re.findall(r"\w+", f"{said} {place}"):
        for name in swept:
            if word in name.split(".")[1:]:
                return line(text, "grid", name)
        for table, key, _ in _keys(tree):
            if word == key:
                return line(text, table, key)
    return 0


def _line_of_dotted(message: str, text: str, tree: Mapping[str, Any], swept: Mapping[str, Any]) -> int:
    """Return the line of the key that a message begins with, such as ``forces.wind.force``, else 0."""
    dotted = re.match(r"\w+(\.\w+)+", message)
    if dotted is None:
        return 0
    table, *keys = dotted[0].split(".")
    while keys:
        if ".".join((table, *keys)) in swept:
            return line(text, "grid", ".".join((table, *keys)))
        found = tree.get(table)
        for key in keys:
            found = found.get(key) if isinstance(found, Mapping) else None
        at = 0 if found is None else line(text, table, ".".join(keys))
        if at > line(text, table):  # a row of its own; within a table on one line, that of the table
            return at
        keys.pop()
    return 0


def _keys(tree: Mapping[str, Any]) -> list[tuple[str, str, Any]]:
    return [(table, key, value) for table, content in tree.items() for key, value in content.items()]


def _holds(value: Any, name: str) -> bool:
    if isinstance(value, Mapping):
        return name in value or any(_holds(part, name) for part in value.values())
    if isinstance(value, list):
        return any(_holds(part, name) for part in value)
    # Of a user's part, the module and the name in it are looked for, too.
    return bool(value == name) or (isinstance(value, str) and name in value.split(":"))
