"""Meshcat's commands as its page reads them, checked before they are sent."""

from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import finite
from pinmobile.errors import InvalidArgument, shown
from pinmobile.viewer.stock import packed_command

__all__ = ["Key", "Update", "packed"]

_KINDS = {
    "set_transform": "matrix",
    "set_object": "object",
    "set_property": "value",
    "set_animation": "animations",
    "delete": "path",
}
_FLOAT32 = 0x17  # the MessagePack extension in which meshcat has arrays of floats


class Key(NamedTuple):
    """What a command sets: a later command with the same key replaces it."""

    kind: str
    path: str
    name: str = ""


class Update(NamedTuple):
    """A command as it is sent."""

    key: Key
    data: bytes


def packed(command: Any) -> Update:
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
        return Update(key, packed_command(content))
    except Exception as error:  # the packer's own errors have no common base
        raise InvalidArgument(f"{kind} of {key.path or '/'} cannot be sent: {error}") from error


def _check(name: str, value: Any) -> None:
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
    elif getattr(value, "type", None) == _FLOAT32:
        finite(name, np.frombuffer(value.data, np.float32))
