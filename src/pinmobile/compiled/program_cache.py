"""Programs that are known: the same loop with other numbers is neither traced nor built again.

A program belongs to the form of its parts: their classes, what their parameters' shapes are, and the values
of all else that they hold. Whether the code still is what it was, with the globals and closures that it
refers to, is looked at each time, which takes some microseconds. What else follows from a loop of constant
parts is remembered with them for as long as the code stays.
"""

from __future__ import annotations

import contextlib
import functools
import threading
import types
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from itertools import chain
from operator import is_, itemgetter
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any, TypeVar

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled.emit import Shape
from pinmobile.compiled.file_cache import Unknown, key_of, packed, unpacked
from pinmobile.compiled.loop_tape import initial_memory
from pinmobile.compiled.memory import Line, Noise, Schedule
from pinmobile.compiled.parts import Parts, Place, attributes_of
from pinmobile.compiled.passes import traced, walk_of
from pinmobile.compiled.processor import LOOP, Cache, Target
from pinmobile.compiled.program import Program
from pinmobile.compiled.sample import Reference
from pinmobile.compiled.tracing import Walk, is_foreign, uncollected, untraced
from pinmobile.constancy import has_slots, is_constant, known
from pinmobile.errors import NotTraceable
from pinmobile.parts import structures_of

_MOST = 64  # programs
_MEMORIES = 16  # loops, each with a reference and what all robots share of it, at most some MB
_THINGS = 64  # that are remembered of one
_DEEP = 24
_T = TypeVar("_T")
_lock = threading.Lock()
_known: OrderedDict[Any, tuple[_Witness, Program]] = OrderedDict()
_memories: OrderedDict[Any, tuple[_Witness, dict[Any, Any]]] = OrderedDict()

_BY_IDENTITY = (FunctionType, BuiltinFunctionType, ModuleType, type, np.ufunc, np.dtype)
_NUMBERS = frozenset((bool, int, float, complex))
_CODE = (FunctionType, BuiltinFunctionType, ModuleType, type, property)
# Of the standard library: what cannot change, and what only remembers.
_FIXED = {
    "typing",
    "_abc",
    "re",
    "decimal",
    "fractions",
    "datetime",
    "pathlib",
    "enum",
    "dataclasses",
    "weakref",
}
_PLAIN = {"typing", "abc", "collections.abc", "enum"}  # whose classes as bases keep no numbers
_MARKS = (types.GenericAlias, types.UnionType, type(...), type(NotImplemented), range, slice)
_CONTAINERS = (dict, list, set)
_BY_VALUE = (bool, int, float, complex, str, bytes, np.generic)


class _Identity(int):
    """What is the same only in this process."""


@untraced
def program_of(
    parts: Parts,
    context: object,
    start: tuple[Array, Array],
    reference: Reference,
    *,
    dt: float,
    spread: Iterable[Place] = (),
    single: bool = False,
    own_reference: bool = False,
) -> Program:
    """Return the program of a loop: one that is known, else a new one.

    Parameters
    ----------
    parts, context, start, reference, dt, spread, own_reference
        As in `traced`.
    single : bool
        Whether it is for one robot.

    Raises
    ------
    NotTraceable
        If a law cannot be run on symbols.
    UnknownName
        If there is no such parameter.
    """
    spread = frozenset(Place(*name) for name in spread)
    own = parts.on_symbols()
    try:
        key: tuple[Hashable, ...] | None = (*_key(own, context, reference, spread, single), own_reference)
    except Unknown:
        key = None
    if key is not None:
        found = _held(_known, key)
        if found is not None:
            return found
    with uncollected():
        walk, cache, target = walk_of(own), Cache(), Target.here()
        lasting = None if key is None or cache.folder is None else _lasting(walk, key, target)
        program = None if lasting is None else _read(cache, lasting, target)
        if program is None:
            loop = traced(
                *(own, context, start, reference),
                dt=dt,
                spread=spread,
                own_reference=own_reference,
                walk=walk,
            )
            program = Program(loop, target, single=single, cache=cache)
            # A law that changes what it refers to is not the one that the key is of.
            if lasting is not None and lasting == _lasting(walk_of(own), key, target):
                beside = {"shape": [program.shape.lanes, program.shape.vectors], "key": program.key}
                cache.write(lasting, packed(program.loop, **beside), LOOP)
        if key is not None:
            _hold(_known, key, walk, program)
    return program


def _lasting(walk: Walk, key: object, target: Target) -> str | None:
    """Return what names a loop in any process; None where something has no lasting name."""
    try:
        return key_of(walk, key, functools.partial(_form, constant=True), target.key(""))
    except Unknown:
        return None


def _read(cache: Cache, key: str, target: Target) -> Program | None:
    data = cache.read(key, LOOP)
    if data is None:
        return None
    try:
        loop, beside = unpacked(data)
        shape, key = Shape(*beside["shape"]), str(beside["key"])
    except (ValueError, KeyError, TypeError, AttributeError):
        return None  # somebody wrote it by hand
    return Program(loop, target, shape, cache=cache, key=key)


@untraced
def memory_of(parts: Parts, *others: object) -> dict[Any, Any]:
    """Return where what follows from the parts of a loop is remembered; of parts that may change, nowhere.

    It is empty at first, and again after anything changed that the parts' code refers to.

    Parameters
    ----------
    parts : Parts
        The loop.
    *others
        What else it follows from, such as the trajectory.
    """
    each = (*(part for _, part in parts.by_path()), *others)
    entries = [known(part) for part in each]
    numbers = [entry.number for entry in entries if entry is not None]
    if len(numbers) < len(each):
        return {}
    key = len(parts.forces), parts.integrator is None, *numbers
    found = _held(_memories, key)
    if found is not None:
        if len(found) > _THINGS:
            found.clear()
        return found
    try:
        own = parts.on_symbols()
    except NotTraceable:
        return {}
    made: dict[Any, Any] = {}
    with uncollected():
        _hold(_memories, key, Walk((*(part for _, part in own.by_path()), *others)), made, _MEMORIES)
    return made


def once(memory: dict[Any, Any], what: Hashable, make: Callable[[], Any]) -> Any:
    """Return what a memory has of something, which is made where it has nothing."""
    found = memory.get(what)
    if found is None:
        found = memory[what] = make()
    return found


def _held(table: OrderedDict[Any, tuple[_Witness, _T]], key: Hashable) -> _T | None:
    """Return what a table has of a key; None where it has nothing, or the code is not what it was."""
    with _lock:
        found = table.get(key)
        if found is not None:
            table.move_to_end(key)
    return found[1] if found is not None and found[0].holds() else None


def _hold(
    table: OrderedDict[Any, tuple[_Witness, _T]],
    key: Hashable,
    walk: Walk,
    value: _T,
    most: int = _MOST,
) -> None:
    """Keep a value in a table, where all can be told that it hangs on."""
    try:
        witness = _Witness(walk)
    except Unknown:
        return
    with _lock:
        table[key] = witness, value
        table.move_to_end(key)
        while len(table) > most:
            table.popitem(last=False)


def _key(
    parts: Parts, context: object, reference: Reference, spread: frozenset[Place], single: bool
) -> tuple[Hashable, ...]:
    names: list[str] = []

    def noise(name: str, n: int) -> Noise:
        names.append(name)
        return Noise(0, n)

    shapes = tuple(np.shape(x) for x in reference)
    memory = initial_memory(parts, context, shapes[1][-1], normal=noise)
    form = _form(memory, parts.plant)
    forms = tuple((path, _part_form(part)) for path, part in parts.by_path())
    return forms, parts.substeps, form, tuple(names), shapes, spread, single


def _part_form(part: object) -> Any:
    own = known(part)
    if own is None:
        return _form(part)
    if "form" not in own.memory:
        own.memory["form"] = _form(part)
    return own.memory["form"]


def _form(x: object, leaves: object = None, depth: int = 0, constant: bool = False) -> Any:
    """Return what makes a value another one, as something that can be compared and hashed.

    Of parameters of parts that is their shape, unless they are `constant`, as of a part that a law reaches as
    a global; where `leaves` is not None, it is so for all numbers.
    """
    if type(x) in _NUMBERS:  # the most
        return type(x) if leaves is not None else (type(x), x)
    if depth > _DEEP:
        raise Unknown
    if isinstance(x, FunctionType) and (own := known(x)) is not None:
        return FunctionType, own.number  # the function itself would keep what it closes over
    if x is None or isinstance(x, _BY_IDENTITY):
        return x
    if isinstance(x, _BY_VALUE):
        return type(x) if leaves is not None and not isinstance(x, str | bytes) else (type(x), x)
    if isinstance(x, np.ndarray):
        if x.dtype == object:
            raise Unknown
        return x.shape, x.dtype.str, None if leaves is not None else x.tobytes()
    if isinstance(x, list | tuple):
        return type(x), tuple(_form(each, leaves, depth + 1, constant) for each in x)
    if isinstance(x, dict):
        return type(x), tuple(
            (_form(k, None, depth + 1, constant), _form(v, leaves, depth + 1, constant)) for k, v in x.items()
        )
    if isinstance(x, set | frozenset):
        return type(x), frozenset(_form(each, None, depth + 1, constant) for each in x)
    if isinstance(x, MethodType):
        # In a memory it is the plant's `difference`, whose form is known by another way.
        return x.__func__, None if x.__self__ is leaves else _form(x.__self__, None, depth + 1, constant)
    if isinstance(x, functools.partial):
        return _form((x.func, x.args, x.keywords), None, depth + 1, constant)
    if isinstance(x, Line):
        return Line, x.samples
    if isinstance(x, Noise):
        return Noise, x.n
    if isinstance(x, Schedule):
        return Schedule, x.rows.shape[1:]
    return _object_form(x, leaves, depth, constant)


def _object_form(x: object, leaves: object, depth: int, constant: bool) -> Any:
    if is_foreign(type(x).__module__) and not type(x).__module__.startswith("pinmobile"):
        raise Unknown
    attributes = getattr(x, "__dict__", None)  # some answer to any name with something
    if not isinstance(attributes, dict) or has_slots(type(x)) or _is_made_of_another(type(x)):
        raise Unknown
    if constant and hasattr(type(x), "traced"):
        return type(x), _Identity(id(x)), *_model_form(x, attributes, depth)
    stated = () if constant else attributes_of(x)
    kept = (
        (name, np.shape(value) if name in stated else _form(value, leaves, depth + 1, constant))
        for name, value in attributes.items()
        if not isinstance(getattr(type(x), name, None), functools.cached_property)
    )
    structure = tuple(_form(value, leaves, depth + 1, constant) for value in structures_of(x).values())
    return type(x), tuple(kept), structure


def _is_made_of_another(kind: type) -> bool:
    """Tell whether a class builds on one that may keep what no attribute shows, as a deque does."""
    modules = {each.__module__ for each in kind.__mro__ if each is not object} - _PLAIN
    return any(is_foreign(name) and not name.startswith("pinmobile.") for name in modules)


def _model_form(x: Any, attributes: dict[str, Any], depth: int) -> Any:
    """Yield the numbers of a model that a law reaches as a global; what is not known of it stays as it is."""
    with contextlib.suppress(NotTraceable):  # as with arms: then its law is asked nothing
        yield _form(x.traced(), None, depth + 1, True)
    for name, value in attributes.items():
        with contextlib.suppress(Unknown):
            yield name, _form(value, None, depth + 1, True)


class _Witness:
    """What code refers to, as it was when a loop was traced. It keeps no part of the loop alive."""

    def __init__(self, walk: Walk) -> None:
        names = [(mapping, name, mapping[name]) for mapping, name in walk.names.values()]
        kept = [own for f in walk.functions for own in (vars(f), f.__kwdefaults__ or {})]
        names += [(own, name, own[name]) for own in kept for name in own if name != "__wrapped__"]
        values = [value for _, _, value in names] + [cell.cell_contents for cell in walk.cells.values()]
        values += [value for f in walk.functions for value in f.__defaults__ or ()]
        self._gone: list[Any] = []  # what has died cannot be what a name stands for
        code = [each for each in names if isinstance(each[2], _CODE)]
        self._code = [
            (mapping, itemgetter(*chosen, *chosen[:1]), [*map(mapping.__getitem__, chosen)])
            for mapping, chosen in _by_mapping(code)
        ]
        others = [each for each in names if not isinstance(each[2], _CODE)]
        self._names = [(mapping, name, self._referred(value)) for mapping, name, value in others]
        # By its function, since a cell itself would keep what is in it.
        self._cells = [
            (self._referred(function), place, self._referred(walk.cells[cell].cell_contents))
            for cell, (function, place) in walk.closures.items()
        ]
        # A function may get another code, as by IPython's %autoreload, and stay the same object.
        self._functions = [
            (self._referred(f), f.__code__, f.__defaults__, f.__kwdefaults__) for f in walk.functions
        ]
        changing = [value for value in values if _can_change(value)]
        self._plain = [
            (self._referred(value), [*map(self._weakly, _held_by(value))])
            for value in changing
            if _is_plain(value)
        ]
        left = (value for value in changing if not _is_plain(value))
        self._forms = [(self._referred(value), _form(value, constant=True)) for value in left]

    def _weakly(self, value: object) -> Any:
        """Return a weak reference to a value; itself, where it has none."""
        try:
            return weakref.ref(value, self._gone.append)
        except TypeError:
            return value

    def _referred(self, value: object) -> Callable[[], Any]:
        """Return what returns a value, without keeping it alive where that can be helped."""
        found = self._weakly(value)
        return (lambda: value) if found is value else found

    def holds(self) -> bool:
        """Tell whether all that is as it was."""
        try:
            return not self._gone and (
                all(all(map(is_, found(mapping), values)) for mapping, found, values in self._code)
                and all([mapping[name] is value() for mapping, name, value in self._names])
                and all([f().__closure__[i].cell_contents is value() for f, i, value in self._cells])
                and all([_has(f(), *own) for f, *own in self._functions])
                and all([_are(_held_by(value()), each) for value, each in self._plain])
                and all([_form(value(), constant=True) == form for value, form in self._forms])
            )
        except (Unknown, AttributeError, KeyError, ValueError):
            return False


def _has(function: FunctionType, code: object, defaults: object, named: object) -> bool:
    return (
        function.__code__ is code and function.__defaults__ is defaults and function.__kwdefaults__ is named
    )


def _by_mapping(names: Iterable[tuple[Any, str, Any]]) -> list[tuple[Any, list[str]]]:
    """Return the names of each mapping."""
    found: dict[int, tuple[Any, list[str]]] = {}
    for mapping, name, _ in names:
        found.setdefault(id(mapping), (mapping, []))[1].append(name)
    return list(found.values())


def _is_plain(x: object) -> bool:
    """Tell whether a value is a container of what cannot change: then it is what it was while that stays."""
    return type(x) in _CONTAINERS and all(type(y) in _CONTAINERS or is_constant(y) for y in _held_by(x))


def _held_by(x: Any, depth: int = 0) -> list[Any]:
    """Return what a container holds, keys included, and what those in it hold."""
    if depth > _DEEP:
        raise Unknown
    held = [*x, *x.values()] if isinstance(x, dict) else [*x]
    inner = [_held_by(each, depth + 1) for each in held if type(each) in _CONTAINERS]
    return [*held, *chain.from_iterable(inner)]


def _are(things: list[Any], values: list[Any]) -> bool:
    """Tell whether things are the values, of which some are known by weak references."""
    return len(things) == len(values) and all(
        [x is y or (isinstance(y, weakref.ref) and y() is x) for x, y in zip(things, values, strict=True)]
    )


def _can_change(x: object) -> bool:
    """Tell whether a value may become another without being replaced; what nobody can look into may."""
    if isinstance(x, MethodType):
        return _can_change(x.__self__)
    if isinstance(x, functools.partial):  # a descriptor from Python 3.13 on
        return not is_constant(x)
    fixed = (*_BY_IDENTITY, *_BY_VALUE, property, staticmethod, classmethod, functools.cached_property)
    if x is None or isinstance(x, fixed) or hasattr(type(x), "__get__") or is_constant(x):
        return False
    module = type(x).__module__
    machinery = module.startswith("pinmobile.") and is_foreign(module)
    return not (machinery or module.partition(".")[0] in _FIXED or isinstance(x, _MARKS))
