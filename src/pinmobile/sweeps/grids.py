"""`grid`: scenarios along named axes."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from math import prod
from numbers import Real
from typing import Any, TypeAlias, final

import numpy as np

from pinmobile import extras
from pinmobile.arrays import Array, finite, text
from pinmobile.errors import InvalidArgument, UnknownName, shown
from pinmobile.loop import Scenario, drawn_name

imported = partial(extras.imported, extra="sweeps", what="a sweep")
"""What only sweeps need is imported when it is used."""

Label: TypeAlias = float | str
_MOST = 100_000  # scenarios, each with some twenty files in a store


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

    values: Sequence[Label] | Mapping[str, Any] | Array
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

    def index(self, name: str, label: object) -> int:
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


def axis_of_rivals(axes: Mapping[str, Axis]) -> str | None:
    """Return the axis whose members are compared with each other: of more than one, each with a name.

    That is the one whose values are controllers, else the one called ``controller``, else the last one.
    """
    named = [
        name for name, axis in axes.items() if len(axis) > 1 and all(isinstance(x, str) for x in axis.values)
    ]
    controllers = [name for name in named if all(hasattr(x, "initial_state") for x in axes[name].given)]
    return [*named, *(name for name in named if name == "controller"), *controllers][-1] if named else None


def _labels(values: object) -> tuple[Label, ...]:
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


Values: TypeAlias = Axis | Sequence[Label] | Mapping[str, Any] | Array
"""What an axis of a grid may be given as."""

RESERVED = frozenset(
    {
        *("robot", "coordinate", "input", "time", "channel", "bin", "level", "counts"),
        *("max_error", "rms_error", "max_force", "max_distance", "diverged_at"),
        *("worst_measure", "rms_measure", "measure", "quantiles"),
    }
)
"""Names that the store of a sweep has for itself, beside those of what is drawn."""


@final
@dataclass(frozen=True, eq=False)
class Grid:
    """Scenarios along named axes, the last running fastest.

    Parameters
    ----------
    axes : mapping of str to Axis
        The axes, in order.
    scenarios : sequence of Scenario
        As many as the product of the axes; all of as many robots and with the bands at the same times.

    Raises
    ------
    InvalidArgument
        If that is not so, or an axis has a name that the store cannot have.
    """

    axes: Mapping[str, Axis]
    scenarios: Sequence[Scenario]

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", dict(self.axes))
        object.__setattr__(self, "scenarios", tuple(self.scenarios))
        for name in self.axes:
            own = name in RESERVED or name.startswith(drawn_name(""))
            if own or not re.fullmatch(r"[A-Za-z][\w. -]*", name):
                raise InvalidArgument(
                    f"axis is called {name!r}, expected letters, digits, '.', '_', and none of the store's "
                    "own names, such as 'robot' and 'time'"
                )
        _check_count(self.axes)
        if len(self.scenarios) != prod(self.shape):
            raise InvalidArgument(f"scenarios are {len(self.scenarios)}, expected {prod(self.shape)}")
        _check_alike(self)

    def __len__(self) -> int:
        return len(self.scenarios)

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of values along the axes."""
        return tuple(len(axis) for axis in self.axes.values())

    @property
    def n(self) -> int:
        """Robots of each scenario."""
        return self.scenarios[0].n

    def index(self, k: int) -> tuple[int, ...]:
        """Return the place of scenario k along each axis."""
        return tuple(int(i) for i in np.unravel_index(k, self.shape))

    def place(self, k: int) -> str:
        """Return where scenario k is, in words."""
        return placed(self.axes, self.index(k))


Scenarios: TypeAlias = Grid | Mapping[str, Scenario] | Sequence[Scenario] | Scenario
"""What may be swept: a grid, scenarios by name, a row of them, or one."""


def grid(make: Callable[..., Scenario], /, **axes: Values) -> Grid:
    """Return the scenarios for all combinations of values.

    Parameters
    ----------
    make : callable
        ``make(name=value, ...)`` returns the `Scenario` of one combination.
    **axes : Axis, sequence of numbers, sequence of str, or mapping of str to anything
        What is swept, by the names of `make`'s arguments. Of a mapping, `make` gets the values, and the
        keys are the labels: ``controller={"PD": PD(120, 120), "computed torque": ComputedTorque(robot)}``.
        `Sweep.answer` compares controllers with each other, wherever their axis stands.

    Returns
    -------
    grid : Grid

    Raises
    ------
    InvalidArgument
        If an axis is not what is expected, `make` does not take it, or a scenario is refused; the message
        says for which values. What else `make` raises has a note that does.
    """
    if not callable(make):
        raise InvalidArgument(f"make is {shown(make)}, expected a function that returns a Scenario")
    if not axes:
        raise InvalidArgument("axes are none, expected at least one, such as gain=[4, 16]")
    named = {name: _axis(name, values) for name, values in axes.items()}
    _check_count(named)
    scenarios = []
    for index in product(*(range(len(axis)) for axis in named.values())):
        chosen = {name: axis.given[i] for (name, axis), i in zip(named.items(), index, strict=True)}
        _check_call(make, chosen, placed(named, index))
        try:
            made = make(**chosen)
        except InvalidArgument as error:
            raise InvalidArgument(f"{error} (at {placed(named, index)})") from error
        except Exception as error:
            error.add_note(f"at {placed(named, index)}")
            raise
        if not isinstance(made, Scenario):
            raise InvalidArgument(f"make returned a {type(made).__name__}, expected a Scenario")
        scenarios.append(made)
    return Grid(named, scenarios)


def _check_count(axes: Mapping[str, Axis]) -> None:
    """Refuse more scenarios than a store can have, before any is made."""
    if (count := prod(map(len, axes.values()))) > _MOST:
        lengths = ", ".join(f"{len(axis):,} of {name}" for name, axis in axes.items())
        raise InvalidArgument(
            f"axes make {count:,} scenarios ({lengths}), expected at most {_MOST:,}: give fewer values, or "
            "let the robots of a scenario vary by its spread"
        )


def _check_call(make: Callable[..., Scenario], chosen: Mapping[str, Any], place: str) -> None:
    """Refuse arguments that a function does not take, or lacks."""
    try:
        signature = inspect.signature(make)
    except ValueError:  # as of some that are built in
        return
    try:
        signature.bind(**chosen)
    except TypeError as error:
        takes = ", ".join(signature.parameters) or "nothing"
        raise InvalidArgument(
            f"make cannot be called with {', '.join(chosen)}: {error}; it takes {takes} (at {place})"
        ) from error


def as_grid(scenarios: Scenarios) -> Grid:
    """Return the grid that an argument of `sweep` stands for.

    Raises
    ------
    InvalidArgument
        If it is no grid, scenario, or mapping or sequence of scenarios.
    """
    if isinstance(scenarios, Grid):
        return scenarios
    if isinstance(scenarios, Mapping):
        axis, found = Axis(scenarios), list(scenarios.values())
    else:
        found = list(scenarios) if isinstance(scenarios, Sequence | Iterator) else [scenarios]
        axis = Axis(list(range(len(found)))) if found else Axis([])
    for made in found:
        if not isinstance(made, Scenario):
            raise InvalidArgument(
                f"scenarios has a {type(made).__name__}, expected Scenarios, or a grid of them"
            )
    return Grid({"scenario": axis}, found)


def _axis(name: str, values: Values) -> Axis:
    try:
        return values if isinstance(values, Axis) else Axis(values)
    except InvalidArgument as error:
        raise InvalidArgument(f"{name}: {error}") from error


def _check_alike(grid: Grid) -> None:
    first = grid.scenarios[0]
    for k, scenario in enumerate(grid.scenarios):
        if scenario.n != first.n:
            raise InvalidArgument(
                f"n is {first.n} at {grid.place(0)} and {scenario.n} at {grid.place(k)}, expected the same"
            )
        if not np.array_equal(scenario.grid, first.grid):
            raise InvalidArgument(
                f"times of the bands differ between {grid.place(0)} (to {first.t[-1]:g} s in steps of "
                f"{first.dt * first.stride:g} s) and {grid.place(k)} (to {scenario.t[-1]:g} s in steps of "
                f"{scenario.dt * scenario.stride:g} s), expected the same duration, dt and every"
            )
        for name in ("coordinates", "inputs", "judged"):
            here, there = ([each[:2] for each in getattr(one, name)] for one in (first, scenario))
            if here != there:
                told = (
                    ", ".join(f"{each} [{unit}]" for each, unit in listed) or "none"
                    for listed in (here, there)
                )
                raise InvalidArgument(
                    f"{name} are {next(told)} at {grid.place(0)} and {next(told)} at {grid.place(k)}, "
                    "expected the same: sweep such plants each in a store of its own"
                )
