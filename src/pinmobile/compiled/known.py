"""Programs that are known: the same loop with other numbers is neither traced nor built again.

A program belongs to the form of its parts: their classes, what their parameters' shapes are, and the values
of all else that they hold. Whether the code still is what it was, with the globals and closures that it
refers to, is looked at each time, which takes some microseconds.
"""

import contextlib
import functools
import threading
from collections import OrderedDict
from collections.abc import Iterable
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled.cache import Cache
from pinmobile.compiled.loop_tape import initial_memory
from pinmobile.compiled.memory import Line
from pinmobile.compiled.noise import Noise
from pinmobile.compiled.parts import Parts, Place, Reference, attributes_of
from pinmobile.compiled.passes import traced
from pinmobile.compiled.program import Program
from pinmobile.compiled.tracing import Walk, is_foreign
from pinmobile.errors import NotTraceable

__all__ = ["program_of"]

_MOST = 64
_DEEP = 24
_lock = threading.Lock()
_known: "OrderedDict[Any, tuple[_Witness, Program]]" = OrderedDict()

_BY_IDENTITY = (FunctionType, BuiltinFunctionType, ModuleType, type, np.ufunc, np.dtype)
_BY_VALUE = (bool, int, float, complex, str, bytes, np.generic)


class _Unknown(Exception):
    """Something of which nobody can tell whether it is the same as before."""


def program_of(
    parts: Parts,
    context: Any,
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
        key: Any = (*_key(own, context, reference, spread, single), own_reference)
    except _Unknown:
        key = None
    if key is not None:
        with _lock:
            found = _known.get(key)
        if found is not None and found[0].holds():
            return found[1]
    loop = traced(own, context, start, reference, dt=dt, spread=spread, own_reference=own_reference)
    program = Program(loop, single=single, cache=Cache())
    if key is not None:
        try:
            witness = _Witness(own)
        except _Unknown:
            return program
        with _lock:
            _known[key] = witness, program
            _known.move_to_end(key)
            while len(_known) > _MOST:
                _known.popitem(last=False)
    return program


def _key(parts: Parts, context: Any, reference: Reference, spread: frozenset[Place], single: bool) -> Any:
    names: list[str] = []

    def noise(name: str, n: int) -> Noise:
        names.append(name)
        return Noise(0, n)

    shapes = tuple(np.shape(x) for x in reference)
    memory = initial_memory(parts, context, shapes[1][-1], normal=noise)
    form = _form(memory, parts.plant)
    forms = tuple((path, _form(part)) for path, part in parts.by_path())
    return forms, parts.substeps, form, tuple(names), shapes, spread, single


def _form(x: Any, leaves: Any = None, depth: int = 0, constant: bool = False) -> Any:
    """Return what makes a value another one, as something that can be compared and hashed.

    Of parameters of parts that is their shape, unless they are `constant`, as of a part that a law reaches as
    a global; where `leaves` is not None, it is so for all numbers.
    """
    if depth > _DEEP:
        raise _Unknown
    if x is None or isinstance(x, _BY_IDENTITY):
        return x
    if isinstance(x, _BY_VALUE):
        return type(x) if leaves is not None and not isinstance(x, str | bytes) else (type(x), x)
    if isinstance(x, np.ndarray):
        if x.dtype == object:
            raise _Unknown
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
        return x.func, _form((x.args, x.keywords), None, depth + 1, constant)
    if isinstance(x, Line):
        return Line, x.samples
    if isinstance(x, Noise):
        return Noise, x.n
    return _object_form(x, leaves, depth, constant)


def _object_form(x: Any, leaves: Any, depth: int, constant: bool) -> Any:
    if is_foreign(type(x).__module__) and not type(x).__module__.startswith("pinmobile"):
        raise _Unknown
    attributes = getattr(x, "__dict__", None)  # some answer to any name with something
    if not isinstance(attributes, dict):
        raise _Unknown
    if constant and hasattr(type(x), "traced"):
        return type(x), id(x), *_model_form(x, attributes, depth)
    stated = () if constant else attributes_of(x)
    kept = (
        (name, np.shape(value) if name in stated else _form(value, leaves, depth + 1, constant))
        for name, value in attributes.items()
        if not isinstance(getattr(type(x), name, None), functools.cached_property)
    )
    return type(x), tuple(kept)


def _model_form(x: Any, attributes: dict[str, Any], depth: int) -> Any:
    """Yield the numbers of a model that a law reaches as a global; what is not known of it stays as it is."""
    with contextlib.suppress(NotTraceable):  # as with arms: then its law is asked nothing
        yield _form(x.traced(), None, depth + 1, True)
    for name, value in attributes.items():
        with contextlib.suppress(_Unknown):
            yield name, _form(value, None, depth + 1, True)


class _Witness:
    """What code refers to, as it was when a loop was traced."""

    def __init__(self, parts: Parts) -> None:
        walk = Walk(part for _, part in parts.by_path())
        self._kept = walk.seen  # so that no other object gets one of their places in memory
        self._names = [(mapping, name, mapping[name]) for mapping, name in walk.names.values()]
        self._cells = [(cell, cell.cell_contents) for cell in walk.cells.values()]
        values = [*(value for _, _, value in self._names), *(value for _, value in self._cells)]
        self._forms = [(value, _form(value, constant=True)) for value in values if _can_change(value)]

    def holds(self) -> bool:
        """Tell whether all that is as it was."""
        try:
            return (
                all(mapping.get(name) is value for mapping, name, value in self._names)
                and all(cell.cell_contents is value for cell, value in self._cells)
                and all(_form(value, constant=True) == form for value, form in self._forms)
            )
        except (_Unknown, ValueError):
            return False


def _can_change(x: Any) -> bool:
    fixed = (*_BY_IDENTITY, *_BY_VALUE, property, staticmethod, classmethod, functools.cached_property)
    if x is None or isinstance(x, fixed) or hasattr(type(x), "__get__"):
        return False
    # Marks of typing and the like.
    return not (is_foreign(type(x).__module__) and not isinstance(x, list | dict | set | tuple | np.ndarray))
