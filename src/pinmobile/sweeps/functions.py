"""What a function's code is and what it reads, what a library has by name, and what an object holds."""

import builtins
import dis
import os
import struct
import sys
from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

__all__ = ["digest_of", "known_name", "read_by", "state_of"]

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
