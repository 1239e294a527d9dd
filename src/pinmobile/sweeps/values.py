"""Values in words that are the same in every process, and others for another value.

An object is described by its type and what it holds. Of a user's function there is the code, and what it
reads of its surroundings (defaults, closure, globals); of a class its bases and members. What cannot be told
is refused: one thing must never pass for another. What a function reads from files is not looked at.
"""

import inspect
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cached_property, partial
from hashlib import sha256
from types import BuiltinFunctionType, FunctionType, MappingProxyType, MethodType, ModuleType
from typing import Any, NoReturn

import numpy as np

from pinmobile.errors import InvalidArgument
from pinmobile.sweeps.functions import digest_of, known_name, read_by, state_of

__all__ = ["Described", "array_of"]

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
