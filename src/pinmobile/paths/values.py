"""What nouns that hold points have in common: compared, hashed and printed by value; their parameters."""

from dataclasses import fields
from typing import Any

import numpy as np

from pinmobile.plant import Parameter

__all__ = ["Value", "of_point"]


def of_point(
    name: str, attribute: str, meaning: str, size: int = 2, *, unit: str = "m", row: int | None = None
) -> tuple[Parameter, ...]:
    """Return the parameters of a point or velocity that a path has: x and y, or numbers of joints.

    Parameters
    ----------
    name : str
        What they begin with, such as ``"via"``: ``"via_x"``.
    attribute : str
        The path's attribute.
    meaning : str
        What it is, in words.
    size : int
        Number of coordinates.
    unit : str
        Of each in the plane; of joints, that is as the joint is.
    row : int, optional
        Which of several points that the attribute holds.
    """
    coordinates = ("x", "y") if size == 2 else tuple(map(str, range(size)))
    return tuple(
        Parameter(
            f"{name}_{each}",
            unit if size == 2 else "",
            f"{meaning}, {each if size == 2 else f'coordinate {each}'}",
            attribute=attribute,
            entry=k if row is None else (row, k),
        )
        for k, each in enumerate(coordinates)
    )


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
