"""Points of a sweep: scenarios with other values at some paths, along named axes, and their descriptions."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from hashlib import sha256
from itertools import product
from math import isfinite, prod
from numbers import Real
from platform import machine
from typing import Any, TypeAlias, final

import numpy as np

from pinmobile.arrays import bounded, distinct, instance, one_of, text
from pinmobile.compiled import Contents, code_of_library
from pinmobile.errors import InvalidArgument, UnknownName, argument_errors, unexpected_value
from pinmobile.loop import (
    ROBOT_ARRAYS,
    SUMS,
    Loop,
    Relative,
    Scenario,
    contents,
    select_integrator,
    versions,
)
from pinmobile.parts import (
    Field,
    Leaf,
    Number,
    NumberRef,
    entries_of,
    find,
    named,
    parts_of,
    replace as replaced,
    walk,
)

Label: TypeAlias = float | str
Changes: TypeAlias = Mapping[str, Any]
"""Values by path."""

_PARTS = {"robot": "plant"} | {name: name for name in ("controller", "trajectory", "integrator", "forces")}
_FIELDS = {each.name for each in fields(Scenario) if each.init} - _PARTS.keys()
_UNITS = {"dt": "s", "duration": "s", "after": "s"}
_COORDINATES = "coordinate", "input", "metric", "channel", "time", "level", "bin"
_NAMES = {"robot", "chunk", *_COORDINATES, *ROBOT_ARRAYS, *SUMS}  # dimensions and arrays of a store
_MAX_POINTS = 100_000  # points; each has about twenty files in a store


@final
@dataclass(frozen=True)
class Axis:
    """Values along one axis of a sweep.

    Attributes
    ----------
    values : tuple of float or str
        Values or labels.
    unit : str
        Unit of the values, "" for none.
    """

    values: tuple[Label, ...]
    unit: str = ""

    def text(self, i: int) -> str:
        """Return value i as text."""
        label = self.values[i]
        return label if isinstance(label, str) else f"{label:g}"


def place_text(axes: Mapping[str, Axis], index: Sequence[int]) -> list[str]:
    """Return a place along the axes as text for each axis, such as ``controller.kp = 4 1/s^2``."""
    items = zip(axes.items(), index, strict=True)
    return [f"{name} = {axis.text(i)} {axis.unit}".rstrip() for (name, axis), i in items]


def index_of(axes: Mapping[str, Axis], labels: Mapping[str, Any]) -> tuple[int, ...]:
    """Return the index of the point with these labels; an axis with one value needs no label.

    Raises
    ------
    UnknownName
        If there is no such axis.
    InvalidArgument
        If an axis has no such value.
    """
    for name in labels:
        one_of("axis", name, axes)
    index = []
    for name, axis in axes.items():
        label = labels.get(name, axis.values[0] if len(axis.values) == 1 else None)
        if not isinstance(label, str | Real) or label not in axis.values:
            values = ", ".join(map(repr, axis.values))
            raise unexpected_value(name, label, f"one of {values}")
        index.append(axis.values.index(label))
    return tuple(index)


@final
@dataclass(frozen=True, eq=False)
class Points:
    """Scenarios along named axes; the last axis runs fastest.

    Parameters
    ----------
    axes : mapping of str to Axis
        Axes by name.
    scenarios : sequence of Scenario
        Scenario of each point; all have the same n, times of bands, coordinates, inputs and metrics.
    """

    axes: Mapping[str, Axis]
    scenarios: Sequence[Scenario]

    def __post_init__(self) -> None:
        first = _shared_fields(self.scenarios[0])
        for k, scenario in enumerate(self.scenarios):
            for name, value in _shared_fields(scenario).items():
                if value != first[name]:
                    raise InvalidArgument(
                        f"{name} is {first[name]} at {self.place(0)} and {value} at {self.place(k)}, "
                        "expected the same: run one sweep for each"
                    )

    @classmethod
    def of(cls, scenario: Scenario, grid: Mapping[str, Any] | None, cases: Any = None) -> Points:
        """Return the points of grid x cases around a scenario; see `sweep` for the arguments."""
        instance("scenario", scenario, Scenario, "a Scenario")
        if scenario.keep:
            raise InvalidArgument(
                f"keep is {list(scenario.keep)}, expected none: a store contains no signals, "
                "run an `ensemble` with them at the point that you look at"
            )
        grid, cases = _mapping("grid", grid), _mapping("cases", cases)
        cases = {name: _mapping(f"cases[{name!r}]", changes) for name, changes in cases.items()}
        paths = sorted({path for changes in cases.values() for path in changes})
        distinct("grid and cases change", [*grid, *paths])
        choices = {_axis_name(name): values for name, values in grid.items()}
        if cases or not choices:
            choices["case"] = cases or {"all": {}}
        return cls.product(choices, lambda values: change_scenario(scenario, values | values.pop("case", {})))

    @classmethod
    def product(cls, grid: Mapping[str, Any], make: Callable[[dict[str, Any]], Scenario]) -> Points:
        """Return the points at all combinations of values.

        Parameters
        ----------
        grid : mapping of str to sequence or mapping
            Values of each axis, in a sequence or by label.
        make : callable
            Function that returns the scenario at some values, by axis.
        """
        axes = {name: _labels(name, values) for name, values in grid.items()}
        count = prod(len(axis.values) for axis in axes.values())
        bounded("number of points of grid and cases", count, most=_MAX_POINTS)
        choices = [list(x.values()) if isinstance(x, Mapping) else list(x) for x in grid.values()]
        scenarios = []
        for index in product(*(range(len(axis.values)) for axis in axes.values())):
            values = {name: choice[i] for name, choice, i in zip(axes, choices, index, strict=True)}
            with argument_errors(after=f" (at {', '.join(place_text(axes, index))})"):
                scenarios.append(make(values))
                scenarios[-1].draws()  # rejects impossible draws before any work
        for name, axis in axes.items():
            if not isinstance(grid[name], Mapping) and not isinstance(axis.values[0], str):
                axes[name] = Axis(axis.values, _unit(scenarios[0], name))
        return cls(axes, scenarios)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return tuple(len(axis.values) for axis in self.axes.values())

    @property
    def n(self) -> int:
        """Number of robots of each scenario."""
        return self.scenarios[0].n

    def index(self, k: int) -> tuple[int, ...]:
        """Return the index of scenario k along each axis."""
        return tuple(int(i) for i in np.unravel_index(k, self.shape))

    def place(self, k: int) -> str:
        """Return the place of scenario k as text."""
        return ", ".join(place_text(self.axes, self.index(k)))


def _mapping(name: str, value: Any) -> Mapping[str, Any]:
    given: Mapping[str, Any] = {} if value is None else value
    for key in instance(name, given, Mapping, "a mapping with text as keys"):
        text(f"a key of {name}", key)
    return given


def _shared_fields(scenario: Scenario) -> dict[str, Any]:
    """Return the properties that all scenarios of a store must share."""
    texts = {
        name.removeprefix("recorded_"): (
            ", ".join(f"{entry.name} [{entry.unit}]" for entry in getattr(scenario, name)) or "none"
        )
        for name in ("coordinates", "inputs", "recorded_metrics")
    }
    times = f"every {scenario.dt * scenario.stride:.9g} s, {len(scenario.grid)} times"
    return {"n": scenario.n, **texts, "time of the bands": times}


def _axis_name(path: str) -> str:
    name = "plant" if path == "robot" else path.replace("/", ".")
    if name in _NAMES or name == "case":
        raise InvalidArgument(f"grid has {path!r}, which is also a name in the store, expected the full path")
    return name


def _labels(name: str, values: Any) -> Axis:
    """Return an axis without its unit."""
    items = values.tolist() if isinstance(values, np.ndarray) else values
    names = tuple(items) if isinstance(items, Sequence | Mapping) and not isinstance(items, str) else ()
    numbers = all(isinstance(x, Real) and not isinstance(x, bool) and isfinite(x) for x in names)
    if not names or not (numbers or all(isinstance(x, str) for x in names)) or len(set(names)) < len(names):
        raise unexpected_value(name, values, "different finite numbers or texts, or a mapping of them")
    return Axis(tuple(x.item() if isinstance(x, np.generic) else x for x in names))


def _named_refs(loop: Loop) -> dict[str, NumberRef]:
    """Return everything that has a path in a loop: parts, fields, and entries of numbers."""
    refs = {leaf.path: NumberRef(leaf) for leaf in walk(loop) if "._" not in leaf.path}
    refs |= {path: NumberRef(Leaf(path, loop, Field(), part)) for path, part in parts_of(loop) if path}
    return refs | named(loop)


def _unit(scenario: Scenario, path: str) -> str:
    """Return the unit of a number, given its path."""
    if path in _FIELDS:
        return _UNITS.get(path, "")
    with suppress(UnknownName):
        loop = scenario.nominal_loop
        return find(loop, path.removeprefix("spread."), _named_refs(loop)).unit
    return ""


def change_scenario(scenario: Scenario, changes: Changes) -> Scenario:
    """Return a scenario with other values at some paths, outer parts first.

    Parameters
    ----------
    scenario : Scenario
        Original scenario.
    changes : mapping of str to value
        New values by path: a field of the scenario, ``spread.NAME``, or a number or part of the loop.

    Raises
    ------
    UnknownName
        If there is no such path.
    InvalidArgument
        If a value does not match the declaration of its field.
    """
    loop, spread = scenario.nominal_loop, scenario.spread
    scenario_fields, numbers, paths = dict[str, Any](), dict[str, Any](), set[str]()
    by_path = {_PARTS.get(path, path): value for path, value in changes.items()}
    for path in sorted(by_path, key=lambda path: (path not in _PARTS.values(), path.count("."))):
        value, (first, _, rest) = by_path[path], path.partition(".")
        if path == "spread":
            spread = value
        elif path in _FIELDS:
            scenario_fields[path] = value
        elif first == "spread" or first.startswith("start"):
            spread = {**spread, rest if first == "spread" else path: value}
        elif path in _PARTS.values():
            loop = replaced(loop, {path: value})
        elif first == "forces" and rest and "." not in rest:
            loop = replaced(loop, {"forces": _add_force(loop.forces, rest, value)})
        else:
            ref = find(loop, path, _named_refs(loop), "grid or cases")
            if ref.path in paths:
                raise InvalidArgument(f"grid and cases both change {ref.path!r}, expected one of them")
            paths.add(ref.path)
            if ref.entry is not None:
                value = _set_entry(numbers.get(ref.leaf.path, ref.leaf.value), ref, value, scenario.size)
            if isinstance(ref.leaf.declared, Number):
                numbers[ref.leaf.path] = value
            else:
                loop = replaced(loop, {ref.leaf.path: value})
    loop = replaced(loop, numbers)
    default = select_integrator(scenario.robot, None) is loop.integrator
    new = replace(
        scenario,
        **scenario_fields | {"spread": spread},
        robot=loop.plant,
        integrator=None if default else loop.integrator,
        **{name: getattr(loop, name) for name in ("controller", "trajectory", "forces")},
    )
    for name, source in new.spread.items():
        if new.numbers[name].path in paths and not isinstance(source, Relative):
            raise InvalidArgument(
                f"grid or cases have {new.numbers[name].path!r}, which the spread replaces for each "
                f"robot: expected 'spread.{name}', or a Relative spread"
            )
        x = scenario.numbers.get(name)
        if x and not isinstance(source, Relative) and not np.array_equal(x.value, new.numbers[name].value):
            warnings.warn(f"grid or cases set {name}, which the spread replaces: use Relative", stacklevel=2)
    return new


def _add_force(forces: Any, key: str, force: Any) -> Any:
    items = dict(entries_of(forces))
    new_forces = items | {key: force}
    return new_forces if isinstance(forces, Mapping) or key not in items else tuple(new_forces.values())


def _set_entry(base: Any, ref: NumberRef, value: Any, size: int) -> Any:
    """Return an array with another value of one entry; one gain for all coordinates becomes an array."""
    array = np.array(0.0 if base is None else base, np.float64)
    array = array if array.ndim else np.repeat(array, size)
    array[ref.place(array.ndim)] = value
    return array


FORMAT = 5
"""Version of the store format."""

_NUMBERS = ("n", "seed", "dt", "substeps", "limit", "after", "stride")
_MAX_ARRAY = 16  # largest array whose numbers a description contains
_MAX_TEXT = 100  # longest text that a description contains
_DIGEST = re.compile(r"\b[0-9a-f]{32} of ")


def describe(points: Points, version: str | None = None) -> dict[str, Any]:
    """Return everything that determines the numbers of a sweep, in the form of JSON.

    Parameters
    ----------
    points : Points
        Scenarios of the sweep.
    version : str, optional
        Word of the user for objects whose contents cannot be recognised.

    Raises
    ------
    InvalidArgument
        If there are such objects, but no such word.
    """
    rows = [_describe_scenario(scenario, version) for scenario in points.scenarios]
    releases = versions()
    description: dict[str, Any] = {
        "format": FORMAT,
        "machine": machine(),
        "versions": releases | {"pinmobile": f"{releases['pinmobile']} ({code_of_library()})"},
        "axes": {name: {"values": axis.values, "unit": axis.unit} for name, axis in points.axes.items()},
    }
    for name in sorted(set().union(*rows)):
        values = [row.get(name) for row in rows]
        is_common = all(json.dumps(value) == json.dumps(values[0]) for value in values)
        description.setdefault("all" if is_common else "each", {})[name] = values[0] if is_common else values
    if version is not None:
        description["version"] = version
    result: dict[str, Any] = json.loads(json.dumps(description))  # in the form of a store
    return result


def _describe_scenario(scenario: Scenario, version: str | None) -> dict[str, Any]:
    """Return everything that determines the numbers of a scenario, by path.

    If the spread names no number of the trajectory, its reference replaces its contents: robots see nothing
    else.
    """
    items = {name: _json_form(getattr(scenario, name))[0] for name in _NUMBERS}
    items |= {"duration": float(scenario.t[-1]), "reference": _json_form(np.hstack(scenario.reference))[0]}
    for path, value in contents(scenario):
        items[path], unknown = _json_form(value)
        if unknown and version is None and (scenario.has_own_references or not path.startswith("trajectory")):
            raise InvalidArgument(
                f"{path} has {unknown}, whose contents a store cannot recognise, expected numbers, arrays, "
                'functions or objects with attributes, or sweep(..., version="1"): change this word '
                "whenever the object changes"
            )
    return items


def _json_form(value: Any) -> tuple[Any, str]:
    """Return a value in the form of JSON, with digests of numbers and of code, and its unknown contents."""
    if value is None or type(value) in (bool, int, str) or (type(value) is float and np.isfinite(value)):
        return value, ""
    if type(value) is np.ndarray and value.dtype.kind in "biuf" and 0 < value.size <= _MAX_ARRAY:
        return f"{value.dtype} {value.tolist()}", ""
    text, unknown = Contents.of_value(value)
    digest = sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:32]
    return text if len(text) <= _MAX_TEXT else f"{digest} of a {type(value).__name__}", unknown


def differences(theirs: Mapping[str, Any], mine: Mapping[str, Any], most: int = 3) -> str:
    """Return the differences between two descriptions as text, "" if they are equal.

    Axes come first, versions and digests last.
    """
    old, new = _flatten(theirs), _flatten(mine)
    pairs = {name: (old.get(name, "absent"), new.get(name, "absent")) for name in new | old}
    rows = [(name, *pair) for name, pair in pairs.items() if json.dumps(pair[0]) != json.dumps(pair[1])]
    rows.sort(key=_rank)
    words = [f"{name} is {_shorten(a)} there and {_shorten(b)} here" for name, a, b in rows]
    return "; ".join(words[:most]) + (f"; and {len(words) - most} more differ" if len(words) > most else "")


def _flatten(description: Mapping[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {f"axis {name}": axis["values"] for name, axis in description["axes"].items()}
    values |= {f"unit of {name}": axis["unit"] for name, axis in description["axes"].items()}
    values |= {f"version of {name}": value for name, value in description["versions"].items()}
    inner = {"axes", "versions", "all", "each"}
    values |= {name: value for name, value in description.items() if name not in inner}
    return {**values, **description.get("all", {}), **description.get("each", {})}


def _rank(difference: tuple[str, Any, Any]) -> int:
    """Return the rank of a difference in the text: differences that a reader recognises come first."""
    name, *values = difference
    if name.startswith(("version of ", "format", "machine")):
        return 3
    is_digest = any(_DIGEST.search(str(value)) for value in values)
    return 0 if name.startswith("axis ") else 1 + is_digest


def _shorten(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
