"""What determines the numbers of a sweep, in a form that is the same in every process and told in words.

Of numbers, arrays and parts of libraries that is what they are given; of a user's function its source text
and all that it reads; of a user's object its class and its attributes. What has no such form needs a word
from the user, `sweep`'s ``version``.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections import namedtuple
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cached_property, partial
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version as installed
from operator import attrgetter
from pathlib import Path
from platform import machine
from types import (
    BuiltinFunctionType,
    FunctionType,
    MappingProxyType,
    MethodType,
    ModuleType,
    SimpleNamespace,
)
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from pinmobile.errors import InvalidArgument
from pinmobile.loop import Scenario, named_forces, way_of
from pinmobile.parts import declared_by, fields_of, is_part, part
from pinmobile.sweeps.code import hidden_in, is_library, node_of, read_by
from pinmobile.sweeps.grids import Grid

FORMAT = 3
"""Of what a store says that determines its numbers."""

# All that a scenario is made of; of these two the sampled reference and times are described instead.
_PLAIN = tuple(
    each.name for each in fields(Scenario) if each.init and each.name not in ("trajectory", "duration")
)
_SHOWN = 16  # numbers of an array that are told one by one

_HOLD: Mapping[type, Callable[[Any], Mapping[str, Any]]] = {
    tuple: lambda x: {"tuple": list(x)},
    slice: lambda x: {"slice": [x.start, x.stop, x.step]},
    partial: lambda x: {"function": x.func, "args": x.args, "keywords": x.keywords, "attributes": vars(x)},
    MethodType: lambda x: {"function": x.__func__, "of": x.__self__},
    BuiltinFunctionType: lambda x: {"method": x.__name__, "of": x.__self__},
    MappingProxyType: lambda x: {"mapping": dict(x)},
    SimpleNamespace: lambda x: {"namespace": vars(x)},
    np.random.SeedSequence: lambda x: {"entropy": x.entropy, "spawn_key": x.spawn_key},
    staticmethod: lambda x: {"staticmethod": x.__func__},
    classmethod: lambda x: {"classmethod": x.__func__},
    property: lambda x: {"property": [x.fget, x.fset, x.fdel]},
    cached_property: lambda x: {"cached": x.func},
}
"""By type, what a value of exactly that type is made of."""

# Members of a class on which no number depends, or that others tell.
_MACHINERY = frozenset(
    {
        *("__module__", "__qualname__", "__doc__", "__dict__", "__weakref__", "__annotations__", "__repr__"),
        *("__dataclass_fields__", "__dataclass_params__", "__abstractmethods__", "_abc_impl", "__str__"),
        *("__orig_bases__", "__parameters__", "__protocol_attrs__", "__subclasshook__"),
        *("__firstlineno__", "__static_attributes__", "__slotnames__"),  # the last one appears with a copy
    }
)
_OF_NAMED_TUPLES = frozenset(vars(namedtuple("_", ()))) - {"_fields", "_field_defaults"}
_OF_ATTRS = attrs.define.__code__.co_filename.replace("_next_gen", "_make")
_SLOTS = ("member_descriptor", "getset_descriptor", "_tuplegetter")  # as names of types: they hold nothing


def determined_by(grid: Grid, version: str | None = None) -> dict[str, Any]:
    """Return all that determines the numbers of a sweep, with its fingerprint.

    Parameters
    ----------
    grid : Grid
        Its scenarios.
    version : str, optional
        The user's word for what has no form of its own.

    Raises
    ------
    InvalidArgument
        If a scenario holds what cannot be recognised the next time, and there is no such word.
    """
    each = [_described(scenario, version) for scenario in grid.scenarios]
    # What all have is told once, for whoever reads it.
    names = sorted({name for one in each for name in one})
    common = {
        name: each[0][name]
        for name in names
        if all(name in one and _text(one[name]) == _text(each[0].get(name)) for one in each)
    }
    found: dict[str, Any] = {
        "format": FORMAT,
        "machine": machine(),
        "versions": {name: _version(name) for name in ("pinmobile", "numpy", "scipy", "pin", "llvmlite")},
        "axes": {name: {"values": list(axis.values), "unit": axis.unit} for name, axis in grid.axes.items()},
        "all": common,
        "each": {name: [one.get(name) for one in each] for name in names if name not in common},
    }
    if version is not None:
        found["version"] = version
    return {**found, "fingerprint": sha256(_text(found).encode()).hexdigest()}


def _described(scenario: Scenario, version: str | None) -> dict[str, Any]:
    """Return what determines the numbers of a scenario, by dotted names.

    Of a trajectory that is the sampled reference, which is all that the robots see of it, and where a
    parameter of it is spread, all that it is made of.
    """
    given = {name: getattr(scenario, name) for name in _PLAIN}
    given |= {
        "forces": list(named_forces(given["forces"]).values()),
        "spread": dict(sorted(given["spread"].items())),
    }
    forms = _Forms(version)
    found = {name: forms.of(name, value) for name, value in given.items()}
    found["duration"] = float(scenario.t[-1])
    found["engine"] = repr(way_of(scenario).engine)
    found["times"] = forms.of("t", scenario.t)
    trajectory = scenario.trajectory
    found["trajectory"] = {"type": type(trajectory).__qualname__}
    if is_part(trajectory) and known_name(type(trajectory)):
        with suppress(InvalidArgument):  # for the reader alone
            found["trajectory"] |= _Forms(None).of("trajectory", trajectory)
    found["trajectory"]["reference"] = forms.of("reference", np.hstack(scenario.reference))
    if scenario.has_own_references:  # of others than this it gives the references, too
        found["trajectory"]["made of"] = forms.of("trajectory", trajectory)
    return _flat(found)


def _flat(tree: object, prefix: str = "") -> dict[str, Any]:
    """Return the leaves of a tree of mappings by their dotted names."""
    if not isinstance(tree, Mapping) or not tree:
        return {prefix: tree}
    found: dict[str, Any] = {}
    for name, value in tree.items():
        joint = "." if prefix and not name.startswith("[") else ""
        found |= _flat(value, f"{prefix}{joint}{name}")
    return found


def _text(value: object) -> str:
    """Return a value as JSON, which tells 1 from 1.0 and from true."""
    return json.dumps(value, sort_keys=True)


def _version(name: str) -> str:
    if name == "pinmobile":
        import pinmobile

        return pinmobile.__version__
    try:
        return installed(name)
    except PackageNotFoundError:
        return "missing"


class _Forms:
    """The forms of values, as JSON can hold them: of what was met before, its place."""

    def __init__(self, version: str | None) -> None:
        self.version = version
        self.above: list[Any] = []  # the containers and objects that are under way
        self.code: dict[int, tuple[str, Any]] = {}  # functions and classes, held so that their ids stay

    def of(self, where: str, value: object) -> Any:
        """Return the form of a value; `where` it is, errors tell.

        Raises
        ------
        InvalidArgument
            If it would not be the same the next time, or another value might have the same, and there is no
            word from the user for it.
        """
        kind = type(value)
        if value is None or kind in (bool, str, int):
            return value
        if isinstance(value, float) and kind in (float, np.float64):
            return float(value) if np.isfinite(value) else f"float {value}"
        if isinstance(value, np.ndarray):
            return self._array(where, value)
        if isinstance(value, np.generic) or kind in (complex, bytes, range, type(...)):
            return f"{kind.__name__} {value}"
        name = known_name(value)
        if name is not None:
            return name
        if isinstance(value, FunctionType | type):
            if id(value) in self.code:
                return f"as {self.code[id(value)][0]}"
            self.code[id(value)] = where, value
            if isinstance(value, FunctionType):
                return self._function(where, value)
            return self._class(where, value)
        for up, other in enumerate(reversed(self.above)):
            if value is other:
                return f"itself, {up} above"
        self.above.append(value)
        try:
            return self._holder(where, value)
        finally:
            self.above.pop()

    def _holder(self, where: str, value: object) -> Any:
        """Return the form of what holds other values."""
        kind = type(value)
        if kind in _HOLD:
            return self._each(where, _HOLD[kind](value))
        if isinstance(value, list) and kind is list:
            items = [self.of(f"{where}[{k}]", item) for k, item in enumerate(value)]
            nested = any(isinstance(item, Mapping) for item in items)
            return {f"[{k}]": item for k, item in enumerate(items)} if nested else items
        if isinstance(value, dict) and kind is dict:
            found = {"keys": self.of(f"the keys of {where}", list(value))}
            for k, (key, item) in enumerate(value.items()):
                name = f"[{key!r}]" if type(key) in (str, int, float, bool) else f"[#{k}]"
                found[name] = self.of(f"{where}{name}", item)
            return found
        held = _stated_by(value) if known_name(kind) or attrs.has(kind) else _copied(value)
        if held is None:
            return self._unknown(where, value)
        told = {"type": kind.__qualname__} if known_name(kind) else {"its class": self.of(where, kind)}
        return {**told, **self._each(where, held)}

    def _each(self, where: str, values: Mapping[str, Any]) -> dict[str, Any]:
        return {name: self.of(f"{where}.{name}", value) for name, value in values.items()}

    def _array(self, where: str, values: NDArray[np.generic]) -> str:
        """Return the form of an array: type, then its numbers, or shape and digest of many."""
        if type(values) is not np.ndarray or values.dtype.kind not in "biufcSUmM":
            return self._unknown(where, values)
        kind = values.dtype.name
        if 0 < values.size <= _SHOWN:
            return f"{kind} {values.tolist()}"
        data = np.ascontiguousarray(values).tobytes()
        return f"{kind} {values.shape} {sha256(data).hexdigest()[:32]}"

    def _function(self, where: str, function: FunctionType) -> Any:
        """Return the form of a user's function: its text, and what it reads of its surroundings."""
        node = node_of(function.__code__)
        if isinstance(node, str):
            return self._unknown(where, function, node)
        reads = {name: self.of(f"{where} ({name})", value) for name, value in read_by(function, node)}
        reads |= {reason: self._unknown(where, function, reason) for reason in hidden_in(function, node)}
        return {"source": ast.unparse(node), **({"reads": reads} if reads else {})}

    def _class(self, where: str, kind: type) -> Any:
        """Return the form of a user's class: its bases and members, of which a library makes some."""
        generated = _OF_NAMED_TUPLES if "_fields" in vars(kind) else frozenset[str]()
        told = {"its name": kind.__name__, "its bases": list(kind.__bases__), "its type": type(kind)}
        if "__dataclass_fields__" in vars(kind) and is_dataclass(kind):
            told["its fields"] = {
                one.name: [one.init, *(x for x in (one.default, one.default_factory) if x is not MISSING)]
                for one in fields(kind)
            }
        elif attrs.has(kind):
            told["its fields"] = dict(declared_by(kind))
        members = {
            name: member
            for name, member in sorted(vars(kind).items())
            if not _is_made_of_fields(name, member)
            and name not in _MACHINERY | generated
            and type(member).__name__ not in _SLOTS
        }
        return self._each(where, told | members)

    def _unknown(self, where: str, value: object, reason: str = "") -> str:
        """Return the form of what has none: what it is, where the user has a word for it."""
        named = getattr(value, "__qualname__", None)
        what = named if isinstance(named, str) else f"a {type(value).__name__}"
        if self.version is not None:
            return f"{what}, by version"
        raise InvalidArgument(
            f"{where} is {what}, of which a store cannot tell whether it is the same the next time"
            f"{reason and ': '}{reason}; expected numbers, arrays, functions with a source, dataclasses or "
            'objects with such attributes, or sweep(..., version="1"), a word that you change whenever it '
            "changes (pinmobile sweep --version-word 1)"
        )


def known_name(value: object) -> str | None:
    """Return the dotted name under which a library has a module, a function or a class; None of all else.

    The name that something has is not believed, as of what `functools.wraps` dressed up: it is looked for.
    """
    if isinstance(value, ModuleType):
        return value.__name__ if is_library(value) else None
    places: tuple[object, ...] = (getattr(value, "__module__", None),)
    name: object = getattr(value, "__qualname__", None)
    if isinstance(value, FunctionType):
        places, name = (value.__globals__.get("__name__"),), value.__code__.co_qualname
    elif isinstance(value, np.ufunc):
        places, name = ("numpy", "scipy.special"), value.__name__
    for place in places:
        module = sys.modules.get(place) if isinstance(place, str) and isinstance(name, str) else None
        with suppress(AttributeError):
            if module is not None and is_library(module) and attrgetter(f"{name}")(module) is value:
                return f"{place}.{name}"
    return None


def _stated_by(value: Any) -> dict[str, Any] | None:
    """Return what an object of a library's class is given; None where that is not all."""
    kind = type(value)
    if kind.__module__.startswith("scipy.stats.") and hasattr(value, "dist"):  # a frozen distribution
        name = str(value.dist.name)
        if type(getattr(sys.modules["scipy.stats"], name, None)) is type(value.dist):
            return {"of": name, "args": value.args, "kwds": value.kwds}
    if isinstance(value, Enum):
        return {"name": value._name_}
    if hasattr(kind, "_fields"):
        return dict(zip(kind._fields, value, strict=True))
    if not (is_part(value) or is_dataclass(value)):
        return None
    names = getattr(kind, "determined_by", None) or [name for name, _, _ in fields_of(value)]
    return {name: getattr(value, name) for name in names}


def _copied(value: object) -> dict[str, Any] | None:
    """Return what a copy of a user's object gets: all of it; None where it can have none, or says which."""
    kind = type(value)
    if kind.__reduce__ is not object.__reduce__ or kind.__getstate__ is not object.__getstate__:
        return None
    try:
        copied: Any = object.__reduce_ex__(value, 4)
        _, (_, *given), state, items, pairs = copied
        held = {"given": given, "items": list(items or ()), "pairs": dict(pairs or ())}
    except TypeError:  # of what has more than Python sees
        return None
    attributes, slots = state if isinstance(state, tuple) else (state, {})
    own = {**(attributes or {}), **slots}
    remembered = {name for name in own if type(getattr(kind, name, None)) is cached_property}
    told = {f"its {name}": each for name, each in held.items() if each}  # which no attribute is called
    return told | {name: own[name] for name in sorted(own.keys() - remembered)}


def _is_made_of_fields(name: str, member: object) -> bool:
    """Return whether a dataclass or a part makes a member."""
    code = getattr(member, "__code__", None)
    file = "" if code is None else code.co_filename
    made = file.startswith(("<string>", "<attrs generated")) or file in (part.__code__.co_filename, _OF_ATTRS)
    return name.startswith("__attrs_") or (name.startswith("__") and made)


def differences(theirs: Mapping[str, Any], mine: Mapping[str, Any], most: int = 3) -> str:
    """Return in words how two descriptions differ; "" where they do not.

    What a reader knows comes first: the axes, then the fields of scenarios, then versions. Digests are told
    where nothing else differs.

    Parameters
    ----------
    theirs, mine : mapping
        Of the store, and of what is to be run; in ``all`` and ``each`` what scenarios share and do not.
    most : int
        How many differences are told.
    """
    there, here = _comparable(theirs), _comparable(mine)
    names = [name for name in {**here, **there} if _differ(name, there, here)]
    values = {name: (there.get(name, "absent"), here.get(name, "absent")) for name in names}
    readable = [name for name in names if not any(map(_is_digest, values[name]))] or names
    words = [_told(name, *values[name]) for name in sorted(readable, key=_rank)]
    return "; ".join(words[:most]) + (f"; and {len(words) - most} more differ" if len(words) > most else "")


def _differ(name: str, there: Mapping[str, Any], here: Mapping[str, Any]) -> bool:
    if name not in there or name not in here:
        return True
    if name.startswith("axes."):  # a scenario tells what is made of a value
        return bool(there[name] != here[name])
    return _text(there[name]) != _text(here[name])


def _comparable(description: Mapping[str, Any]) -> dict[str, Any]:
    found = {name: value for name, value in description.items() if name not in ("all", "each", "fingerprint")}
    return {**_flat(found), **description.get("all", {}), **description.get("each", {})}


def _rank(name: str) -> int:
    if name.startswith("axes."):
        return 0
    return 2 if name in ("format", "machine", "engine") or name.startswith("versions.") else 1


def _is_digest(value: object) -> bool:
    if isinstance(value, list):
        return any(map(_is_digest, value))
    return isinstance(value, str) and re.search(r"\) [0-9a-f]{32}$", value) is not None


def _told(name: str, there: object, here: object) -> str:
    """Return a difference in words: an axis as its user called it, a long text from where it differs."""
    found = re.fullmatch(r"axes\.(.+)\.(values|unit)", name)
    if found:
        name = f"axis {found[1]}" if found[2] == "values" else f"unit of axis {found[1]}"
    texts = [value if isinstance(value, str) else json.dumps(value) for value in (there, here)]
    same = next((k for k, (one, other) in enumerate(zip(*texts, strict=False)) if one != other), 0)
    begin = max(0, same - 20)
    short = [text if len(text) <= 60 else _cut(text, begin, begin + 57) for text in texts]
    return f"{name} is {short[0]} there and {short[1]} here"


def _cut(text: str, begin: int, end: int) -> str:
    return f"{'...' if begin else ''}{text[begin:end]}{'...' if end < len(text) else ''}"


def other_format(path: Path, there: Mapping[str, Any]) -> str:
    """Return in words that a store is of a format that is not that of today; "" where it is.

    Parameters
    ----------
    path : Path
        Folder of the store.
    there : mapping
        What it says that determines its numbers.
    """
    if there["format"] == FORMAT:
        return ""
    return (
        f"store is {str(path)!r}, which was made by pinmobile {there['versions']['pinmobile']} in format "
        f"{there['format']}; this one has format {FORMAT}, and cannot tell whether the scenarios are the "
        "same: start in a new folder"
    )
