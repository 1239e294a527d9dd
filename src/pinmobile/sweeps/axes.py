"""`Axis`: what is swept, by values or by labels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, TypeAlias, final

import numpy as np

from pinmobile.arrays import finite, text
from pinmobile.errors import InvalidArgument, UnknownName, shown

__all__ = ["Axis", "Label", "place_of", "placed", "told"]

Label: TypeAlias = float | str


@final
@dataclass(frozen=True)
class Axis:
    """What is swept along one axis of a grid.

    Parameters
    ----------
    values : sequence of numbers, sequence of str, or mapping of str to anything
        The values, no two the same; of a mapping, the keys are the labels.
    unit : str
        Unit of the values, "" for none; "1", what has no dimension, is kept but not printed.

    Attributes
    ----------
    given : tuple
        What is passed on for each value: the value itself, or what the mapping holds.

    Raises
    ------
    InvalidArgument
        If there are no values, two are the same, or they are neither all finite numbers nor all text.
    """

    values: Sequence[Label] | Mapping[str, Any]
    unit: str = ""
    given: tuple[Any, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        labels = _labels(self.values)
        for label in labels:
            if isinstance(label, str):
                text("values", label)
        text("unit", self.unit)
        given = tuple(self.values.values()) if isinstance(self.values, Mapping) else labels
        object.__setattr__(self, "values", labels)
        object.__setattr__(self, "given", given)

    @property
    def printed_unit(self) -> str:
        """The unit in words and heads: "" where there is none, or it is "1"."""
        return "" if self.unit == "1" else self.unit

    def __len__(self) -> int:
        return len(self.values)

    def index(self, name: str, label: Any) -> int:
        """Return the place of a value.

        Raises
        ------
        InvalidArgument
            If it is not one of them; the message names the axis, and lists what there is.
        """
        for k, value in enumerate(self.values):
            if isinstance(label, str | Real) and value == label:
                return k
        raise InvalidArgument(
            f"{name} is {shown(label)}, expected one of {', '.join(map(repr, self.values))}"
        )


def told(name: str, axis: Axis, i: int) -> str:
    """Return value i of an axis in words, such as ``gain = 4 1/s^2``."""
    label = axis.values[i]  # type: ignore[index]
    text = label if isinstance(label, str) else f"{label:g}"
    return f"{name} = {text} {axis.printed_unit}".rstrip()


def placed(axes: Mapping[str, Axis], index: Sequence[int]) -> str:
    """Return a place along the axes in words, such as ``gain = 4 1/s^2, model = true``."""
    return ", ".join(told(name, axis, i) for (name, axis), i in zip(axes.items(), index, strict=True))


def place_of(axes: Mapping[str, Axis], labels: Mapping[str, Any]) -> tuple[int, ...]:
    """Return the place that labels name; an axis of one value need not be named.

    Raises
    ------
    UnknownName
        If there is no such axis.
    InvalidArgument
        If an axis is missing, or a label is not one of its values.
    """
    for name in labels:
        if name not in axes:
            raise UnknownName("axis", name, axes)
    found = []
    for name, axis in axes.items():
        if name not in labels and len(axis) > 1:
            raise InvalidArgument(f"{name} is missing, expected one of {', '.join(map(repr, axis.values))}")
        found.append(axis.index(name, labels[name]) if name in labels else 0)
    return tuple(found)


def _labels(values: Any) -> tuple[Label, ...]:
    scalar = isinstance(values, np.ndarray) and not values.ndim
    if scalar or isinstance(values, str | bytes) or not isinstance(values, Sequence | Mapping | np.ndarray):
        raise InvalidArgument(f"values is {shown(values)}, expected a sequence, or a mapping of labels")
    found: list[Any] = values.tolist() if isinstance(values, np.ndarray) else list(values)
    if not found:
        raise InvalidArgument("values is empty, expected at least one")
    texts = [isinstance(value, str) for value in found]
    if not all(texts):
        if any(texts) or isinstance(values, Mapping):
            raise InvalidArgument(f"values is {shown(found)}, expected all numbers or all text")
        if finite("values", values).ndim != 1 or any(isinstance(value, bool) for value in found):
            raise InvalidArgument(
                f"values is {shown(found)}, expected numbers, text, or a mapping with labels"
            )
        found = [value.item() if isinstance(value, np.generic) else value for value in found]
    if len(set(found)) < len(found):
        raise InvalidArgument(f"values is {shown(found)}, expected each one once")
    return tuple(found)
