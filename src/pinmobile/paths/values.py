"""Nouns that hold arrays, compared, hashed and printed by value."""

from dataclasses import fields
from typing import Any

import numpy as np

__all__ = ["Value"]


class Value:
    """Abstract base of the frozen dataclasses of this package: equality, hash and repr from their fields.

    What a dataclass generates itself compares arrays as if they were numbers, which raises.
    """

    def _values(self) -> dict[str, Any]:
        named = {f.name: getattr(self, f.name) for f in fields(self) if f.init}  # type: ignore[arg-type]
        return {name: _plain(v.tolist()) if isinstance(v, np.ndarray) else v for name, v in named.items()}

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self._values() == other._values()

    def __hash__(self) -> int:
        return hash((type(self), *self._values().values()))

    def __repr__(self) -> str:
        inside = ", ".join(f"{name}={value!r}" for name, value in self._values().items())
        return f"{type(self).__name__}({inside})"


def _plain(value: Any) -> Any:
    return tuple(map(_plain, value)) if isinstance(value, list) else value
