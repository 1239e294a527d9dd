"""What a function's code is and what it reads, what a library has by name, and what an object holds."""

from __future__ import annotations

import builtins
import dis
import inspect
import os
import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cached_property, partial
from hashlib import sha256
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MappingProxyType, MethodType, ModuleType
from typing import Any, NoReturn

import numpy as np

from pinmobile.errors import InvalidArgument

_LIBRARIES = ("pinmobile", "numpy", "scipy", "pinocchio")  # their versions are told too
_OF_UFUNCS = ("numpy", "scipy.special")  # they do not tell
_STANDARD = Path(os.__file__).parent
_HIDING = frozenset({"__import__", "compile", "eval", "exec", "globals", "input", "open", "vars"})
_ATTRIBUTE = ("LOAD_ATTR", "LOAD_METHOD")
_POINTER = struct.calcsize("P")


def known_name(value: Any) -> str | None:
    """Return the dotted name under which a library has a module, a function or a class; None of all else.

    The name that something has is not believed, as of what `functools.wraps` dressed up: it is looked for.
    """
    if isinstance(value, ModuleType):
        return value.__name__ if _is_library(value) else None
    home: Any
    name: Any
    if isinstance(value, FunctionType):
        home, name = value.__globals__.get("__name__"), value.__code__.co_qualname
    else:
        home, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    places: tuple[Any, ...] = (home,)
    if isinstance(value, np.ufunc):
        places, name = _OF_UFUNCS, value.__name__
    if not isinstance(name, str):
        return None
    for place in places:
        module = sys.modules.get(place) if isinstance(place, str) else None
        if module is not None and _is_library(module):
            found: Any = module
            for part in name.split("."):
                found = getattr(found, part, None)
            if found is value:
                return f"{place}.{name}"
    return None


def _is_library(module: ModuleType) -> bool:
    top = module.__name__.split(".")[0]
    if top in _LIBRARIES:
        return True
    if top not in sys.stdlib_module_names:
        return False
    origin = getattr(getattr(sys.modules.get(top), "__spec__", None), "origin", None)
    if origin in ("built-in", "frozen"):
        return True
    # A user's file may have the name of a standard module.
    return origin is not None and _STANDARD in Path(origin).parents and "site-packages" not in origin


def digest_of(code: CodeType) -> str:
    """Return the digest of what a code object does: all but where it stands and what it is called."""
    told = (
        *(code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags),
        *(code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars),
        *(code.co_code, code.co_exceptiontable, _constant(code.co_consts)),
    )
    return sha256(repr(told).encode()).hexdigest()[:32]


def _constant(value: Any) -> str:
    if isinstance(value, CodeType):
        return digest_of(value)
    if isinstance(value, tuple):
        return f"({', '.join(map(_constant, value))})"
    if isinstance(value, frozenset):  # in the order of its hashes, which are others in every process
        return f"{{{', '.join(sorted(map(_constant, value)))}}}"
    return f"{type(value).__name__} {value!r}"


def read_by(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield name and value of what a function, with the functions inside it, reads of its surroundings.

    Raises
    ------
    LookupError
        If that cannot be told, with the reason.
    """
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            yield name, cell.cell_contents
        except ValueError:
            yield name, "a cell that is empty"
    found = function.__globals__
    for name, *attributes in sorted(set(_paths(function.__code__))):
        if name in found:
            yield _followed(name, found[name], attributes)
        elif name in _HIDING and hasattr(builtins, name):
            raise LookupError(f"it calls {name}")
    state = {"defaults": function.__defaults__, "kwdefaults": function.__kwdefaults__}
    yield from ((name, value) for name, value in {**state, "attributes": vars(function)}.items() if value)


def _followed(name: str, value: Any, attributes: Sequence[str]) -> tuple[str, Any]:
    """Return what is read of a module, which is not described as a whole."""
    left = list(attributes)
    while isinstance(value, ModuleType) and not _is_library(value):
        if not left or not hasattr(value, left[0]):
            raise LookupError(f"it passes on {name}, a module")
        value, name = getattr(value, left[0]), f"{name}.{left.pop(0)}"
    return name, value


def _paths(code: CodeType) -> Iterator[tuple[str, ...]]:
    """Yield the global names that code reads, each with the attributes that it asks of it."""
    steps = list(dis.get_instructions(code))
    for k, step in enumerate(steps):
        if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            end = k + 1
            while end < len(steps) and steps[end].opname in _ATTRIBUTE:
                end += 1
            yield tuple(each.argval for each in (step, *steps[k + 1 : end]))
        elif step.opname == "IMPORT_NAME":
            top = sys.modules.get(step.argval.split(".")[0])
            if steps[k - 2].argval != 0 or top is None or not _is_library(top):
                raise LookupError(f"it imports {step.argval or 'a module'} when it is called")
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _paths(inner)


def state_of(value: Any) -> dict[str, Any] | None:
    """Return what an object holds, by name; None where it holds something out of Python's sight."""
    kind = type(value)
    slots = [
        (name, vars(base)[name])
        for base in kind.__mro__
        for name in vars(base)
        if "__slots__" in vars(base) and type(vars(base)[name]).__name__ == "member_descriptor"
    ]
    pointers = len(slots) + (kind.__dictoffset__ > 0) + (kind.__weakrefoffset__ > 0)
    if kind.__itemsize__ or kind.__basicsize__ > object.__basicsize__ + pointers * _POINTER:
        return None
    found = dict(getattr(value, "__dict__", {}))
    for name, slot in slots:
        try:
            found[name] = slot.__get__(value)
        except AttributeError:
            found[name] = "a slot that is empty"
    return dict(sorted(found.items()))


_SHOWN = 16  # numbers of an array that are told one by one
_MACHINERY = frozenset(
    {
        *("__module__", "__qualname__", "__doc__", "__dict__", "__weakref__", "__annotations__", "__repr__"),
        *("__dataclass_fields__", "__dataclass_params__", "__abstractmethods__", "_abc_impl", "__str__"),
        *("__orig_bases__", "__parameters__", "__protocol_attrs__"),
        *("__firstlineno__", "__static_attributes__", "__slotnames__"),  # the last one appears with a copy
    }
)
"""Members of a class on which no number depends, or that others tell."""

_SLOTS = ("member_descriptor", "getset_descriptor", "_tuplegetter")  # as names of types: they hold nothing


class Described:
    """The descriptions of values: of what was met before, its place."""

    def __init__(self) -> None:
        self.above: list[Any] = []  # the containers and objects that are under way
        self.code: dict[
            int, tuple[str, Any]
        ] = {}  # functions and classes, held so that no other has their id

    def of(self, where: str, value: Any) -> Any:
        """Return the description of a value, as JSON can hold it; `where` it is, errors tell.

        Raises
        ------
        InvalidArgument
            If it would not be the same the next time, or another value might have the same.
        """
        if value is None or type(value) in (bool, str, int):
            return value
        if type(value) in (float, np.float64):
            return _number(value)
        if isinstance(value, np.ndarray):
            return array_of(where, value)
        if isinstance(value, np.generic) or type(value) in (complex, bytes, range, type(...)):
            return f"{type(value).__name__} {value}"
        name = known_name(value)
        if name is not None:
            return name
        if isinstance(value, FunctionType | type):
            return self._once(where, value)
        for up, other in enumerate(reversed(self.above)):
            if value is other:
                return f"itself, {up} above"
        self.above.append(value)
        try:
            return self._holder(where, value)
        finally:
            self.above.pop()

    def _holder(self, where: str, value: Any) -> Any:
        """Return the description of what holds other values."""
        if type(value) in (list, tuple):
            items = self._items(where, value)
            return items if type(value) is list else {"tuple": items}
        if type(value) in (dict, MappingProxyType):
            keys = self._items(f"the keys of {where}", list(value))
            return {"keys": keys, **{f"[{key!r}]": self.of(f"{where}[{key!r}]", value[key]) for key in value}}
        if type(value) is slice:
            return {"slice": self._items(where, (value.start, value.stop, value.step))}
        if type(value) is partial:
            held = {"function": value.func, "args": value.args, "keywords": value.keywords}
            held |= {"attributes": vars(value)} if vars(value) else {}
            return {"type": "partial", **self._each(where, held)}
        if isinstance(value, MethodType):
            return self._each(where, {"function": value.__func__, "of": value.__self__})
        if isinstance(value, BuiltinFunctionType) and not isinstance(value.__self__, ModuleType | None):
            return {"method": value.__name__, "of": self.of(where, value.__self__)}
        return self._object(where, value)

    def _items(self, where: str, values: Sequence[Any]) -> Any:
        items = [self.of(f"{where}[{k}]", value) for k, value in enumerate(values)]
        nested = any(isinstance(item, Mapping) for item in items)
        return {f"[{k}]": item for k, item in enumerate(items)} if nested else items

    def _each(self, where: str, values: Mapping[str, Any]) -> dict[str, Any]:
        return {name: self.of(f"{where}.{name}", value) for name, value in values.items()}

    def _object(self, where: str, value: Any) -> Any:
        kind = type(value)
        if known_name(kind):
            return {"type": kind.__qualname__, **self._each(where, _held_by_ours(where, value))}
        if isinstance(value, tuple) and hasattr(kind, "_fields") and not hasattr(value, "__dict__"):
            held: Any = dict(zip(kind._fields, value, strict=True))
        else:
            held = state_of(value)
        if held is None:
            _refuse(where, value)
        cached = {name for base in kind.__mro__ for name, member in vars(base).items() if _is_cached(member)}
        held = {name: item for name, item in held.items() if name not in cached}
        return {"class": self._once(where, kind), **self._each(where, held)}

    def _once(self, where: str, value: Any) -> Any:
        """Return the description of a user's function or class, or where it has been described."""
        if id(value) in self.code:
            return f"as {self.code[id(value)][0]}"
        self.code[id(value)] = where, value
        return self._function(where, value) if isinstance(value, FunctionType) else self._class(where, value)

    def _function(self, where: str, function: FunctionType) -> Any:
        found: dict[str, Any] = {"code": f"({sys.implementation.cache_tag}) {digest_of(function.__code__)}"}
        # Of one that was typed or made, as a tuple's __new__ is, the code tells all; Python may take for its
        # source what else came from "<string>", such as the words of ``python -c``.
        if not function.__code__.co_filename.startswith("<"):
            with suppress(OSError, TypeError):
                found["source"] = inspect.cleandoc(inspect.getsource(function))
        try:
            reads = dict(read_by(function))
        except LookupError as error:
            _refuse(where, function, str(error))
        if reads:
            found["reads"] = {name: self.of(f"{where} ({name})", value) for name, value in reads.items()}
        return found

    def _class(self, where: str, kind: type) -> Any:
        members = {
            name: _unwrapped(member)
            for name, member in sorted(vars(kind).items())
            if name not in _MACHINERY and type(member).__name__ not in _SLOTS
        }
        bases = [base for base in kind.__bases__ if base is not object]
        more: dict[str, Any] = {"bases": bases} if bases else {}
        more |= {"metaclass": type(kind)} if type(kind) is not type else {}
        return {"class": {"name": kind.__name__, **self._each(where, more)}, **self._each(where, members)}


def _unwrapped(member: Any) -> Any:
    """Return what a class makes a method or a property of."""
    if isinstance(member, staticmethod | classmethod):
        return [type(member).__name__, member.__func__]
    if isinstance(member, property):
        return ["property", member.fget, member.fset, member.fdel]
    return ["cached", member.func] if _is_cached(member) else member


def _is_cached(member: Any) -> bool:
    return type(member) is cached_property


def _held_by_ours(where: str, value: Any) -> dict[str, Any]:
    """Return what determines an object whose class is a library's."""
    kind: Any = type(value)
    if kind is np.random.SeedSequence:
        return {"entropy": value.entropy, "spawn_key": value.spawn_key}
    if kind.__module__.startswith("scipy.stats.") and hasattr(value, "dist"):  # a frozen distribution
        name = str(value.dist.name)
        if type(getattr(sys.modules["scipy.stats"], name, None)) is type(value.dist):
            return {"of": name, "args": value.args, "kwds": value.kwds}
    if isinstance(value, Enum):
        return {"name": value._name_}
    if hasattr(kind, "_fields"):
        return dict(zip(kind._fields, value, strict=True))
    if is_dataclass(value):
        names = getattr(kind, "determined_by", None) or [each.name for each in fields(value) if each.init]
        return {name: getattr(value, name) for name in names}
    state = state_of(value) if kind.__module__.split(".")[0] in sys.stdlib_module_names else None
    if state is None:
        _refuse(where, value)
    return state


def _number(value: Any) -> Any:
    return float(value) if np.isfinite(value) else f"float {value}"


def array_of(where: str, values: Any) -> str:
    """Return the description of an array: type, then its numbers, or shape and digest of many.

    Raises
    ------
    InvalidArgument
        If it is of a subclass, or holds objects.
    """
    if type(values) is not np.ndarray or values.dtype.kind not in "biufcSUmM":
        _refuse(where, values)
    kind = values.dtype.name
    if 0 < values.size <= _SHOWN:
        return f"{kind} {values.tolist()}"
    data = np.ascontiguousarray(values).tobytes()
    return f"{kind} {values.shape} {sha256(data).hexdigest()[:32]}"


def _refuse(where: str, value: Any, reason: str = "") -> NoReturn:
    named = getattr(value, "__qualname__", None)
    what = named if isinstance(named, str) else f"a {type(value).__name__}"
    raise InvalidArgument(
        f"{where} is {what}, of which a store cannot tell whether it is the same the next time"
        f"{reason and ': '}{reason}; expected numbers, arrays, functions, dataclasses or objects with such "
        "attributes"
    ) from None
