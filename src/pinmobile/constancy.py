"""What is constant, known by its identity, and what is remembered of it as long as it lives."""

from __future__ import annotations

import itertools
import weakref
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property, partial
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any, TypeVar

import numpy as np

_DEEP = 24
_NUMBERS = bool, int, float, complex, str, bytes, np.generic
_ATOMS = (*_NUMBERS, np.dtype, np.ufunc, type, ModuleType, type(None), Enum)
_MARK = "__pinmobile_constant__"

_Kind = TypeVar("_Kind", bound=type)


@dataclass(eq=False)
class Known:
    """What is known of a constant object.

    Attributes
    ----------
    number : int
        Its own: no other object ever has it, whatever its place in memory.
    memory : dict
        What follows from the object, by name. Nothing in it may hold the object, which would live for ever.
    """

    number: int
    memory: dict[Any, Any] = field(default_factory=dict)


_numbers = itertools.count()
_known: dict[int, tuple[weakref.ref[Any], Known]] = {}


def constant(kind: _Kind) -> _Kind:
    """Mark a class whose objects do not change once they are made, though nothing holds them to it."""
    setattr(kind, _MARK, kind)
    return kind


def known(thing: object) -> Known | None:
    """Return what is known of an object; None of one that may change, or that has no weak references."""
    found = _found(thing)
    if found is not None:
        return found
    if not is_constant(thing):
        return None
    place = id(thing)

    def gone(reference: object, table: dict[int, Any] = _known) -> None:  # when Python ends, globals are gone
        if table.get(place, (None,))[0] is reference:
            del table[place]

    try:
        entry = weakref.ref(thing, gone), Known(next(_numbers))
    except TypeError:
        return None
    _known[place] = entry
    return entry[1]


def _found(thing: object) -> Known | None:
    """Return what is known of an object that was asked for before."""
    found = _known.get(id(thing))
    return found[1] if found is not None and found[0]() is thing else None


def is_constant(thing: object, depth: int = 0) -> bool:
    """Tell whether neither an object nor what it holds can change, short of force.

    So are numbers, text, functions, arrays that `pinmobile.arrays.frozen` made, tuples and frozen dataclasses
    of these, and what is marked. What the code of functions refers to is another question.
    """
    if depth > _DEEP:
        return False
    if isinstance(thing, _ATOMS):
        return True
    kind = type(thing)
    if getattr(kind, _MARK, None) is kind:
        return True
    if isinstance(thing, np.ndarray):
        return not thing.flags.writeable and thing.dtype != object and isinstance(thing.base, bytes)
    if isinstance(thing, MethodType | BuiltinFunctionType):
        # Pinocchio's functions say that they are built in, and belong to nothing.
        return is_constant(getattr(thing, "__self__", None), depth + 1)
    attributes = getattr(thing, "__dict__", None)
    if isinstance(thing, partial):
        held = thing.func, thing.args, *thing.keywords.values()
        return not attributes and all(is_constant(each, depth + 1) for each in held)
    if isinstance(thing, FunctionType):
        return not attributes
    if isinstance(thing, tuple | frozenset):
        return not attributes and all(is_constant(each, depth + 1) for each in thing)
    frozen = getattr(vars(kind).get("__dataclass_params__"), "frozen", False) or "__attrs_attrs__" in vars(
        kind
    )
    if not (frozen and isinstance(attributes, dict)) or has_slots(kind):
        return False
    if _found(thing) is not None:
        return True
    own = (x for name, x in attributes.items() if not isinstance(getattr(kind, name, None), cached_property))
    return all(is_constant(value, depth + 1) for value in own)


def has_slots(kind: type) -> bool:
    """Tell whether objects of a class keep values in slots, beside what they have by name in a dictionary."""
    slots = (vars(each).get("__slots__", ()) for each in kind.__mro__)
    names = ({each} if isinstance(each, str) else set(each) for each in slots)
    return any(each - {"__dict__", "__weakref__"} for each in names)
