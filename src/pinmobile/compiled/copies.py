"""Copies of parts with other numbers: as they stand, or made again, which checks and derives what follows."""

from __future__ import annotations

import copy
import dataclasses
import functools
import inspect
from collections.abc import Iterable, Iterator, Mapping
from types import MethodType, ModuleType
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled.memory import is_leaf
from pinmobile.errors import InvalidArgument, PinmobileError

_DEEP = 8  # objects within objects that a part holds


def copied(part: Any, values: Mapping[str, Any], parts: Mapping[str, Any]) -> Any:
    """Return a copy of a part with other values of attributes, and other parts in it."""
    new = copy.copy(part)
    for each in type(part).__mro__:
        for name, attribute in vars(each).items():
            if isinstance(attribute, functools.cached_property):
                new.__dict__.pop(name, None)  # it belongs to the old values
    set_ = dict(values)
    for name, value in getattr(part, "__dict__", {}).items():
        if isinstance(value, list | tuple) and any(f"{name}[{i}]" in parts for i in range(len(value))):
            held = [parts.get(f"{name}[{i}]", each) for i, each in enumerate(value)]
            set_[name] = type(value)(*held) if hasattr(value, "_fields") else type(value)(held)
        elif isinstance(value, MethodType) and (name in parts or value.__self__ is part):
            set_[name] = getattr(parts.get(name, new), value.__name__)
        elif name in parts:
            set_[name] = parts[name]
    for name, value in set_.items():
        try:
            object.__setattr__(new, name, value)
        except AttributeError:
            raise InvalidArgument(
                f"{name} of a {type(part).__name__} is computed and cannot be set, expected an attribute"
            ) from None
    return new


def made_again(part: Any, values: Mapping[str, Any], parts: Mapping[str, Any]) -> Any:
    """Return a part that is made again with other values of attributes, and other parts in it.

    By its own ``with_parameters(**values)``; by `dataclasses.replace` of a dataclass; of another class by
    calling it, where it keeps the arguments of its constructor under their names.

    Raises
    ------
    InvalidArgument
        If it cannot be made again, though it keeps what may follow from the values.
    """
    other = copied(part, {}, parts)
    if hasattr(part, "with_parameters"):
        return other.with_parameters(**values) if values else other
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        try:
            return dataclasses.replace(other, **values)
        except PinmobileError:
            raise
        except (TypeError, ValueError) as error:  # its constructor takes other arguments than its fields
            raise InvalidArgument(
                f"a {type(part).__name__} cannot be made again by dataclasses.replace: {error}; expected "
                "fields that its constructor takes, or with_parameters(**values)"
            ) from error
    if _can_be_called(part) and values.keys() <= _arguments(part):
        return _called(other, values)
    check_made_again(type(part).__name__, part, values)
    return copied(part, values, parts)


def is_part(x: Any) -> bool:
    """Tell whether something that a part holds is a part itself."""
    return (hasattr(x, "parameters") or hasattr(x, "initial_state")) and not isinstance(x, type)


def check_made_again(name: str, part: Any, values: Iterable[str]) -> None:
    """Refuse a part that cannot be made again with other values, though it keeps what may follow from them.

    Parameters
    ----------
    name : str
        What it is called in messages.
    part : part
        What is asked.
    values : iterable of str
        Attributes that get other values.

    Raises
    ------
    InvalidArgument
        If it is such; what to write.
    """
    if hasattr(part, "with_parameters") or dataclasses.is_dataclass(part):
        return
    wanted = set(values)
    if not wanted or type(part).__init__ is object.__init__:
        return  # nothing was derived when it was made
    if wanted <= _arguments(part) and _can_be_called(part):
        return
    kept = [
        key
        for key, value in _own(part)
        if not (key in wanted or is_part(value)) and any(True for _ in _numbers(value))
    ]
    if kept:
        missing = ", ".join(sorted(wanted))
        raise InvalidArgument(
            f"{name} is a {type(part).__name__}, which cannot be made again with another {missing} and "
            f"may have made {', '.join(kept)} of that: expected an __init__ that takes {missing} and keeps "
            "each argument under its own name, a dataclass, or with_parameters(**values), which returns a "
            "new one"
        )


def derived(part: Any, other: Any, apart: Iterable[str] = ()) -> str:
    """Return which numbers of a part differ from another's, by the name of the attribute; "" where none.

    Parameters
    ----------
    part, other : parts
        Of one class.
    apart : iterable of str
        Attributes that may differ.
    """
    theirs, skipped = dict(_own(other)), set(apart)
    for name, value in _own(part):
        if name not in skipped and not _alike(value, theirs.get(name)):
            return name
    return ""


def _arguments(part: Any) -> set[str]:
    try:
        return set(inspect.signature(type(part)).parameters)
    except (TypeError, ValueError):  # as of some that are built in
        return set()


def _called(part: Any, values: Mapping[str, Any]) -> Any:
    """Return a new one of its class: each argument is a value, or what the part keeps under that name."""
    ahead, named = [], {}
    for name, argument in inspect.signature(type(part)).parameters.items():
        several = argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD)
        if several or not (name in values or hasattr(part, name)):
            continue  # by default, which may be something else: that is looked at
        value = values[name] if name in values else getattr(part, name)
        if argument.kind is argument.POSITIONAL_ONLY:
            ahead.append(value)
        else:
            named[name] = value
    return type(part)(*ahead, **named)


def _can_be_called(part: Any) -> bool:
    """Tell whether a part that is made of what it keeps is the same."""
    try:
        same = _called(part, {})
    except Exception:  # whatever a class raises of what are not its arguments
        return False
    return not derived(part, same) and not derived(same, part)


def _own(part: Any) -> Iterator[tuple[str, Any]]:
    """Yield what an object keeps, by name, without what it computed later."""
    for name, value in getattr(part, "__dict__", {}).items():
        if not isinstance(getattr(type(part), name, None), functools.cached_property):
            yield name, value


def _alike(one: Any, other: Any) -> bool:
    if one is other:
        return True
    first, second = list(_numbers(one)), list(_numbers(other))
    return len(first) == len(second) and all(
        np.array_equal(a, b, equal_nan=True) for a, b in zip(first, second, strict=True)
    )


def _numbers(x: Any, deep: int = _DEEP) -> Iterator[Array]:
    """Yield all numbers that a value holds: in lists and the like, in objects, in closures."""
    if is_leaf(x):
        yield np.asarray(x, np.float64)
        return
    if not deep or isinstance(x, type | ModuleType):
        return
    if isinstance(x, Mapping | list | tuple):
        inner = list(x.values() if isinstance(x, Mapping) else x)
    else:
        cells = (cell.cell_contents for cell in getattr(x, "__closure__", None) or ())
        inner = [*(value for _, value in _own(x)), *cells, *(getattr(x, "__defaults__", None) or ())]
    for each in inner:
        yield from _numbers(each, deep - 1)
