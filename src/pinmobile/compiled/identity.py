"""Identity of a loop without its numbers: its structure and the code that it calls, compared by value.

Two loops with the same identity run the same compiled program. A law that is edited, reloaded, or has another
number in its closure has another identity. Code of this library and of packages without laws is identified by
name.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import sys
import time
import weakref
from collections import deque
from collections.abc import Hashable, Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path, PurePath
from types import (
    BuiltinFunctionType,
    CellType,
    CodeType,
    FunctionType,
    GenericAlias,
    MemberDescriptorType,
    MethodType,
    ModuleType,
    SimpleNamespace,
)
from typing import Any, Self

import numpy as np

from pinmobile.compiled.functions import is_foreign, names_of
from pinmobile.compiled.memory import DelayLine, Noise, Schedule, is_leaf
from pinmobile.parts import Child, Field, Number, entries_of, fields_of, is_part

_START = time.time()
_MAX_DEPTH = 60
_ATOMS = (bool, int, float, complex, str, bytes, type(None), type(...), range)
_constant: weakref.WeakKeyDictionary[Any, Hashable] = weakref.WeakKeyDictionary()
_constant_values: weakref.WeakKeyDictionary[Any, Hashable] = weakref.WeakKeyDictionary()
_GENERATED = {  # methods that attrs and dataclasses generate, and that no law calls
    *("__init__", "__repr__", "__eq__", "__hash__", "__setattr__", "__delattr__", "__replace__"),
    *("__getstate__", "__setstate__", "__reduce__", "__copy__", "__attrs_post_init__"),
}
_EXEMPT_FIELDS = ("trajectory", "start", "start_rate")  # fields of a loop without effect on its samples


def is_constant(part: Any) -> bool:
    """Return whether no field and no code of a part may change."""
    try:
        if part not in _constant:
            Identity()._part(part)
        return part in _constant
    except TypeError:  # no weak references
        return False


def is_traced(path: str) -> bool:
    """Return whether a number of a loop is a symbol of its law; numbers of trajectory and start are not."""
    return path.partition(".")[0] not in _EXEMPT_FIELDS


class Identity:
    """Structure and code of a loop, by value.

    Attributes
    ----------
    key : tuple
        Key, equal for loops that run the same program.
    is_lasting : bool
        Whether the key has the same meaning in another process.
    is_ours : bool
        Whether all code belongs to the library.
    namespaces : dict of int to dict
        Globals of functions outside the library, by their id.
    cells : list of cell
        Variables in the closures of these functions.
    """

    def __init__(self) -> None:
        self.is_lasting, self.is_ours = True, True
        self.namespaces: dict[int, dict[str, Any]] = {}
        self.cells: list[CellType] = []
        self.key: tuple[Any, ...] = ()
        self._objects: dict[int, tuple[int, Any]] = {}
        self._changeable = 0  # number of values that may change
        self._by_value = False  # whether numbers of a part outside the loop are constants

    @classmethod
    def of(cls, loop: Any, memory: Sequence[Any], spread: Mapping[str, Any], options: Hashable) -> Self:
        """Return the identity of a loop.

        Parameters
        ----------
        loop : Loop
            Closed loop.
        memory : sequence of trees
            Memory of its parts before the first sample.
        spread : mapping of str to array of bool
            Paths of the numbers that differ from robot to robot, with masks of the entries that differ.
        options : hashable
            Other data that determine the program.
        """
        identity = cls()
        parts = tuple(identity._field(*row) for row in fields_of(loop) if is_traced(row[0]))
        differs = tuple((path, varies.shape, varies.tobytes()) for path, varies in spread.items())
        memories = tuple(map(identity._memory, memory))
        identity.key = parts, differs, memories, options
        return identity

    def visit(self, function: Any) -> Self:
        """Add the code of a function."""
        self.key = (*self.key, self._value(function))
        return self

    @property
    def kept(self) -> list[Any]:
        """Objects whose ids are in the key; keeping them reserves their ids."""
        return [value for _, value in self._objects.values()]

    def _field(self, name: str, field: Field, value: Any) -> Hashable:
        """Return a field of a part; for a number that may differ, its shape and its neutral entries."""
        if isinstance(field, Number) and not (field.fixed or self._by_value or value is None):
            return name, np.shape(value), (np.asarray(value) != field.neutral).tobytes()
        if isinstance(field, Child) and field.many:
            return name, tuple((key, self._part(item)) for key, item in entries_of(value))
        return name, (self._part if isinstance(field, Child) else self._value)(value)

    def _part(self, part: Any) -> Hashable:
        """Return a part; the result for an immutable part is kept."""
        if not is_part(part):
            return self._value(part)
        cache = _constant_values if self._by_value else _constant
        try:
            value: Hashable = cache.get(part)
        except TypeError:
            value = None
        if value is not None:
            return value
        state = self._changeable, self.is_lasting
        key = self._class(type(part)), tuple(self._field(*row) for row in fields_of(part))
        if state == (self._changeable, True) and self.is_lasting:
            with contextlib.suppress(TypeError):  # no weak references
                cache[part] = key
        return key

    def _part_value(self, part: Any) -> Hashable:
        """Return a part that code refers to, with its numbers."""
        by_value, self._by_value = self._by_value, True
        key = self._part(part)
        self._by_value = by_value
        return key

    def _memory(self, tree: Any) -> Hashable:
        """Return the structure of a memory."""
        if is_leaf(tree):
            return tuple(np.shape(tree))
        if isinstance(tree, dict):
            return tuple((key, self._memory(value)) for key, value in tree.items())
        if isinstance(tree, list | tuple):
            return type(tree).__qualname__, tuple(map(self._memory, tree))
        if isinstance(tree, DelayLine):
            return "line", tree.samples
        if isinstance(tree, Noise):
            return "noise", tree.n
        if isinstance(tree, Schedule):
            return "schedule", tree.rows.shape[1:]
        if isinstance(tree, MethodType) and is_part(tree.__self__):
            return self._value(tree.__func__), self._class(type(tree.__self__))  # method of a part
        if is_part(tree):
            return self._class(type(tree)), tuple(self._memory(value) for _, _, value in fields_of(tree))
        return self._value(tree)

    def _value(self, x: Any) -> Hashable:
        """Return a value as an object that is equal for equal values."""
        if isinstance(x, _ATOMS):
            return type(x).__name__, x if x == x else "nan"
        if isinstance(x, np.ndarray) and x.dtype != object:
            self._changeable += x.flags.writeable
            return "array", x.shape, x.dtype.str, x.tobytes()
        if isinstance(x, np.generic):
            return "number", x.dtype.str, x.tobytes()
        if isinstance(x, FunctionType):
            return self._function(x)
        if isinstance(x, type):
            return self._class(x)
        if isinstance(x, ModuleType):
            return "module", x.__name__
        if isinstance(x, Enum):
            return "enum", type(x).__qualname__, x.name
        if isinstance(x, np.ufunc):
            return "ufunc", x.__name__
        if isinstance(x, tuple):
            return type(x).__qualname__, tuple(map(self._value, x))
        if is_part(x):
            return self._part_value(x)
        if isinstance(x, PurePath | np.dtype | GenericAlias):
            return "text", repr(x)
        if hasattr(type(x), "geometryObjects"):  # shapes, whose text takes seconds; no law uses their points
            return "shapes", tuple(map(_shape, x.geometryObjects))
        if hasattr(type(x), "saveToString"):  # a model of Pinocchio, whose copies are equal
            return "model", x.saveToString()
        if isinstance(x, slice):
            return "slice", *map(self._value, (x.start, x.stop, x.step))
        if id(x) in self._objects:
            return "seen", self._object_index(x)
        self._objects[id(x)] = len(self._objects), x
        if isinstance(x, list | deque):
            self._changeable += 1
            return type(x).__qualname__, tuple(map(self._value, x))
        if isinstance(x, Mapping):
            self._changeable += 1
            return "mapping", tuple((self._value(key), self._value(value)) for key, value in x.items())
        if isinstance(x, set | frozenset):
            self._changeable += isinstance(x, set)
            return "set", frozenset(map(self._value, x))
        if isinstance(x, MethodType):
            return "method", self._value(x.__func__), self._value(x.__self__)
        if isinstance(x, functools.partial):
            return "partial", self._value((x.func, x.args, x.keywords))
        if isinstance(x, BuiltinFunctionType):
            obj = getattr(x, "__self__", None)  # Pinocchio's functions have none
            return "builtin", x.__name__, None if isinstance(obj, ModuleType | None) else self._value(obj)
        return self._object(x)

    def _object_index(self, x: Any) -> int:
        """Return the index of a value that occurs again in this loop."""
        self._changeable += 1
        return self._objects[id(x)][0]

    def _object(self, x: Any) -> Hashable:
        kind = type(x)
        if isinstance(x, property | functools.cached_property | staticmethod | classmethod):
            inner = getattr(x, "fget", None) or getattr(x, "func", None) or getattr(x, "__func__", None)
            return kind.__name__, self._value(inner)
        if isinstance(x, MemberDescriptorType):  # descriptor of a slot
            return "slot", x.__name__
        self._changeable += 1
        state = getattr(x, "__dict__", None)
        if isinstance(x, SimpleNamespace) or not is_foreign(kind.__module__):
            slots = {name: getattr(x, name) for name in _slots(kind) if hasattr(x, name)}  # type: ignore[arg-type]
            if slots or isinstance(state, dict):
                cached = {name for name in state or () if _is_cached(kind, name)}
                items = slots | {name: value for name, value in (state or {}).items() if name not in cached}
                return self._class(kind), tuple((name, self._value(value)) for name, value in items.items())
        self.is_lasting = False
        return "object", id(x)

    def _class(self, kind: type) -> Hashable:
        """Return a class: its name, and for a user's class its methods and values too."""
        name = kind.__module__, kind.__qualname__
        if _is_library(kind.__module__) or is_foreign(kind.__module__):
            return name
        if id(kind) in self._objects:
            return (*name, self._object_index(kind))
        self._objects[id(kind)] = len(self._objects), kind
        self.is_ours = False
        self._changeable += 1
        members = [
            (key, self._value(value))
            for key, value in vars(kind).items()
            if not key.startswith("__") or (isinstance(value, FunctionType) and key not in _GENERATED)
        ]
        return (*name, tuple(members), tuple(map(self._class, kind.__bases__)))

    def _function(self, function: FunctionType) -> Hashable:
        """Return a function: its name, and for a user's function its code too."""
        module = str(function.__globals__.get("__name__", ""))  # not of a wrapped function
        name = module, function.__code__.co_qualname
        library = _is_library(module)
        if (library or is_foreign(module)) and not function.__closure__ and function.__name__ != "<lambda>":
            return name
        if id(function) in self._objects:
            return (*name, self._object_index(function))
        self._objects[id(function)] = len(self._objects), function
        self._changeable += 1
        code = function.__code__
        items: list[Any] = [code, self._value(function.__defaults__), self._value(function.__kwdefaults__)]
        for cell in function.__closure__ or ():
            self.cells.append(cell)
            try:
                items.append(self._value(cell.cell_contents))
            except ValueError:
                items.append("not set")
        items += [(key, self._value(value)) for key, value in vars(function).items()]
        if not library and not is_foreign(module):
            self.is_ours = False
            self.namespaces[id(function.__globals__)] = function.__globals__
            items += self._names(code, function.__globals__)
        return (*name, *items)

    def _names(self, code: CodeType, space: Mapping[str, Any]) -> Iterator[Hashable]:
        """Yield the values of names of code in a namespace, and in a user's modules there."""
        for name in sorted(names_of(code) & space.keys()):
            value = space[name]
            yield name, self._value(value)
            if isinstance(value, ModuleType) and not (
                is_foreign(value.__name__) or _is_library(value.__name__) or id(value) in self._objects
            ):
                self._objects[id(value)] = len(self._objects), value
                yield from self._names(code, vars(value))

    @property
    def digest(self) -> str | None:
        """Name of the loop in any process; None if there is none."""
        source = _source() if self.is_lasting else None
        text = source and f"{source} {_text(self.key)}"
        return None if text is None else hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


class Contents(Identity):
    """Value with all its numbers and its code, which are the same in every process.

    Attributes
    ----------
    unknown : str
        Object whose contents cannot be recognised; "" if there is none.
    """

    def __init__(self) -> None:
        super().__init__()
        self.unknown = ""

    @classmethod
    def of_value(cls, value: Any) -> tuple[str, str]:
        """Return a value as text, and its unknown contents."""
        contents = cls()
        return _text(contents._value(value)), contents.unknown

    def _part(self, part: Any) -> Hashable:
        return self._class(type(part)), tuple((name, self._value(x)) for name, _, x in fields_of(part))

    def _object(self, x: Any) -> Hashable:
        name = getattr(x, "__qualname__", None)
        if name and is_foreign(getattr(x, "__module__", None) or ""):
            return "compiled", x.__module__, name
        key = super()._object(x)
        if key != ("object", id(x)):
            return key
        with contextlib.suppress(TypeError):  # the object cannot be copied
            return "copied", self._value(x.__reduce_ex__(4))
        self.unknown = self.unknown or name or f"a {type(x).__name__}"
        return "unknown", type(x).__qualname__


def _shape(shape: Any) -> Hashable:
    place = np.asarray(shape.placement.homogeneous).tobytes()
    return shape.name, shape.parentJoint, place, np.asarray(shape.meshScale).tobytes(), shape.meshPath


def _is_cached(kind: type, name: str) -> bool:
    """Return whether an attribute is the value of a cached property of the class."""
    return isinstance(getattr(kind, name, None), functools.cached_property)


def _is_library(module: str) -> bool:
    return module.startswith("pinmobile.") or module == "pinmobile"


@functools.cache
def _slots(kind: Any) -> tuple[str, ...]:
    """Return the names of attributes that objects of a class keep in slots."""
    slots = (vars(x).get("__slots__", ()) for x in kind.__mro__)
    names = {name for x in slots for name in ((x,) if isinstance(x, str) else x)}
    return tuple(sorted(names - {"__dict__", "__weakref__"}))


@functools.cache
def code_of_library() -> str:
    """Return a digest of the library's files, which differ between two commits of one version."""
    folder, digest = Path(__file__).parents[1], hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        digest.update(file.relative_to(folder).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:12]


@functools.cache
def _source() -> str | None:
    """Return a text for the code of library, Python and NumPy; None if a file has just changed."""
    files = [(file, file.stat()) for file in sorted(Path(__file__).parents[1].rglob("*.py"))]
    if any(stat.st_mtime > _START for _, stat in files):
        return None  # the file may differ from the loaded module
    stats = [(str(file), stat.st_size, stat.st_mtime_ns) for file, stat in files]
    return repr((stats, sys.version, np.__version__))


def _text(x: Any) -> str:
    """Return a key as text, the same in all processes."""
    if isinstance(x, CodeType):
        code = x.co_code, x.co_names, x.co_varnames, x.co_freevars, x.co_cellvars, x.co_flags, x.co_argcount
        return f"{code} {_text(x.co_consts)}"
    if isinstance(x, tuple):
        return f"({','.join(map(_text, x))})"
    return f"{{{sorted(map(_text, x))}}}" if isinstance(x, frozenset) else repr(x)
