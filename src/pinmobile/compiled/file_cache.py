"""Loops in files: what tracing gives is found again in another process, by a key that needs no tracing.

The key is of everything that a tape follows from: the form of the parts, the code that they refer to with its
globals, closures and defaults, the code of the machinery here, and the versions of what it stands on. Where
something has no such form there is no key, and the loop is traced: where a law refers to what cannot be
named or looked into, and where it could ask for what is outside Python's objects, such as a file or the time.
"""

from __future__ import annotations

import functools
import hashlib
import json
import platform
import sys
import time
from abc import ABCMeta
from collections.abc import Callable
from pathlib import Path
from types import (
    BuiltinFunctionType,
    CodeType,
    FunctionType,
    GenericAlias,
    MethodType,
    ModuleType,
)
from typing import Any, NamedTuple, Protocol

import numpy as np

from pinmobile.compiled.functions import constructors
from pinmobile.compiled.loop_tape import Leaf, Loop, Ring
from pinmobile.compiled.parts import Place
from pinmobile.compiled.tape import Tape
from pinmobile.compiled.tracing import Walk, is_foreign, names_of
from pinmobile.constancy import known

_BEGAN = time.time()
_FORMAT = 2  # of `packed`
# Of Python's modules those that only compute.
_PURE = {
    *("abc", "builtins", "cmath", "collections", "collections.abc", "dataclasses", "enum", "functools"),
    *("itertools", "math", "numbers", "operator", "typing"),
}
_MAKERS = frozenset(constructors()) | {"arange"}
# Of Python's own names those that look up others, or ask what is no object.
_ASK = {
    *("__build_class__", "__import__", "breakpoint", "compile", "delattr", "eval", "exec", "exit", "getattr"),
    *("globals", "hash", "help", "id", "input", "locals", "memoryview", "open", "print", "quit", "setattr"),
    "vars",
}
# By what this library's own code reads files.
_READS = {"open", "environ", "read_text", "read_bytes", "buildModelFromUrdf", "buildModelFromXML", "json"}
_IMPORTS = "IMPORT_NAME"
_KINDS = (type, ABCMeta, type(Protocol), type(Any))
_PLAIN = {type(None), bool, int, float, complex, str, bytes, type(...), type(NotImplemented)}
_BUILT_IN = (bool, int, float, complex, str, bytes, object)
_DESCRIBED = (staticmethod, classmethod, MethodType)


class Unknown(Exception):
    """Something of which nobody can tell whether it is the same as before, or in another process."""


class _Labels(NamedTuple):
    """What code things are called in a key: by the order in which a walk meets them."""

    functions: dict[int, int]
    kinds: dict[int, int]
    spaces: dict[int, int]
    numbers: dict[int, int]  # of functions, as forms have them
    named: dict[int, str]  # what forms refer to


_FIELDS = type(vars(_Labels)["kinds"])  # of named tuples


def key_of(walk: Walk, form: object, form_of: Callable[[Any], Any], *others: str) -> str:
    """Return what names a loop in any process.

    Parameters
    ----------
    walk : Walk
        Through the parts of the loop.
    form : nested tuples
        Of the parts, and of what else the loop hangs on.
    form_of : callable
        Returns the form of a value that code refers to.
    *others : str
        What else tells it apart.

    Raises
    ------
    Unknown
        If there is none.
    """
    spaces: dict[int, int] = {}
    for where, _ in walk.names:
        spaces.setdefault(where, len(spaces))
    functions = {id(f): i for i, f in enumerate(walk.functions)}
    numbers = {own.number: i for i, f in enumerate(walk.functions) if (own := known(f)) is not None}
    kinds = [kind for kind in walk.kinds if not is_foreign(kind.__module__)]
    labels = _Labels(functions, {id(kind): i for i, kind in enumerate(kinds)}, spaces, numbers, {})
    found = [_machinery(), *others]
    found += [_kind(kind) for kind in kinds]
    found += [_function(f, labels, form_of) for f in walk.functions]
    for (where, name), (mapping, _) in walk.names.items():
        space = str(mapping.get("__module__") or mapping.get("__name__"))
        found.append(f"{spaces[where]} {name} {_value(mapping[name], labels, form_of, space)}")
    found.append(_encoded(form, labels))
    return hashlib.sha256("\0".join(found).encode("utf-8", "surrogatepass")).hexdigest()


@functools.cache
def _machinery() -> str:
    """Return what stands for the code here, and for what it stands on."""
    digest = hashlib.sha256()
    try:
        for file in sorted(Path(__file__).parent.glob("*.py")):
            if file.stat().st_mtime > _BEGAN:
                raise Unknown  # what was loaded is another text
            digest.update(file.read_bytes())
    except OSError:
        raise Unknown from None
    versions = sys.version, platform.machine(), np.__version__, _FORMAT
    return f"{digest.hexdigest()} {versions}"


def _kind(kind: type) -> str:
    if type(kind) not in _KINDS and not _is_ours(kind.__module__):
        raise Unknown  # whose classes answer as they like
    return f"{kind.__module__}.{kind.__qualname__}"


def _is_ours(module: str | None) -> bool:
    return (module or "").startswith("pinmobile.")


def _function(function: FunctionType, labels: _Labels, form_of: Callable[[Any], Any]) -> str:
    """Return the form of a function: its code, and all that it brings along."""
    module, code = function.__module__ or "", function.__code__
    if _is_ours(module):
        if names_of(code) & _READS:
            raise Unknown
    elif not module.startswith("namedtuple_"):
        _check_asks_nothing(function)
    brought = [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).items()]
    brought += [item for item in vars(function).items() if item[0] != "__wrapped__"]
    for cell in function.__closure__ or ():
        try:
            brought.append(cell.cell_contents)
        except ValueError:
            brought.append("not set yet")
    told = [_value(each, labels, form_of, module) for each in brought]
    space = labels.spaces.get(id(function.__globals__))
    return f"{module} {function.__qualname__} {space} {_code(code)} {told}"


@functools.lru_cache(4096)
def _code(code: CodeType) -> str:
    own = (
        *(code.co_code, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars),
        *(code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags),
        getattr(code, "co_exceptiontable", b""),
    )
    return f"{own} {[_constant(each) for each in code.co_consts]}"


def _constant(x: object) -> str:
    if isinstance(x, CodeType):
        return _code(x)
    if isinstance(x, frozenset):
        return f"{sorted(map(_constant, x))}"
    if isinstance(x, tuple):
        return f"({[_constant(each) for each in x]})"
    return f"{type(x).__name__} {x!r}"


def _check_asks_nothing(function: FunctionType) -> None:
    """Refuse code that could ask for what is not looked at here: files, the time, the environment."""
    names = names_of(function.__code__)
    if _imports(function.__code__) or (names - function.__globals__.keys()) & _ASK:
        raise Unknown
    for name in names & vars(np).keys():  # by whatever way it comes to NumPy
        _check_pure(name, getattr(np, name))


def _imports(code: CodeType) -> bool:
    import dis

    own = dis.opmap[_IMPORTS] in code.co_code[::2]
    return own or any(_imports(each) for each in code.co_consts if isinstance(each, CodeType))


def _check_pure(name: str, value: object) -> None:
    """Refuse what NumPy has beside sums, products and arrays."""
    if isinstance(value, type):
        fine = issubclass(value, np.generic) or value in (np.ndarray, np.dtype, np.errstate, *_BUILT_IN)
    elif isinstance(value, ModuleType):
        fine = value is np.linalg
    elif callable(value) and not isinstance(value, np.ufunc):
        dispatched = type(value).__name__ == "_ArrayFunctionDispatcher" and "save" not in name
        fine = name in _MAKERS or dispatched
    else:
        fine = True
    if not fine:
        raise Unknown


def _value(value: object, labels: _Labels, form_of: Callable[[Any], Any], space: str) -> str:
    """Return the form of what a name stands for, in a module or class of some module."""
    if isinstance(value, property):
        return f"property {_value(value.fget, labels, form_of, space)}"
    if isinstance(value, _DESCRIBED):
        own = getattr(value, "__self__", None) if isinstance(value, MethodType) else None
        told = "" if own is None else _value(own, labels, form_of, space)
        return f"{type(value).__name__} {_value(value.__func__, labels, form_of, space)} {told}"
    if isinstance(value, functools.cached_property):
        return f"cached {_value(value.func, labels, form_of, space)}"
    if isinstance(value, ModuleType):
        _check_module(value, space)
        return f"module {value.__name__}"
    if isinstance(value, _FIELDS):
        return repr(value)  # its number
    try:
        if isinstance(value, FunctionType | BuiltinFunctionType | type | np.ufunc):
            return _named(value, labels, space)
        if type(value) in _PLAIN:
            return f"{type(value).__name__} {value!r}"
        return _encoded(form_of(value), labels)
    except Unknown:
        # What the library itself keeps in its modules and classes, such as locks, is no number of a law.
        if _is_ours(space) and not isinstance(value, FunctionType | type):
            return f"a {type(value).__module__}.{type(value).__qualname__}"
        raise


def _check_module(module: ModuleType, space: str) -> None:
    """Refuse modules of others that do more than compute; of a law's own, what it uses is looked at."""
    foreign = is_foreign(module.__name__) and not _is_ours(module.__name__)
    if foreign and not (_is_ours(space) or module in (np, np.linalg) or module.__name__ in _PURE):
        raise Unknown


def _named(value: object, labels: _Labels, space: str = "") -> str:
    """Return what a function or class is called, which a name of some module stands for."""
    name = str(getattr(value, "__name__", value))
    for known_ones in (labels.functions, labels.kinds):
        if id(value) in known_ones:
            return f"{type(value).__name__} {known_ones[id(value)]}"
    if isinstance(value, np.ufunc):
        if getattr(np, name, None) is not value:
            raise Unknown
        return f"ufunc {name}"
    of = getattr(value, "__self__", None) if isinstance(value, BuiltinFunctionType) else None
    module = "builtins" if of is tuple else getattr(value, "__module__", None) or ""
    if not isinstance(of, ModuleType | type(None)) and of is not tuple:
        raise Unknown  # a method of an object; named tuples have that of a tuple among their names
    fine = module in _PURE and not (module == "builtins" and name in _ASK)
    if module.partition(".")[0] == "numpy" and getattr(np, name, None) is value:
        _check_pure(name, value)
        fine = True
    # The library's own code asks for no files; what it uses of Python's changes with the version alone.
    if not (fine or _is_ours(module) or (_is_ours(space) and is_foreign(module))):
        raise Unknown
    return f"{module}.{getattr(value, '__qualname__', value)}"


def _encoded(form: Any, labels: _Labels) -> str:
    """Return a form as text, the same in all processes."""
    kind = type(form)
    if kind in _PLAIN:
        return f"{kind.__name__} {form!r}"
    if kind is tuple or kind is list or issubclass(kind, Place):
        if len(form) == 2 and form[0] is FunctionType and type(form[1]) is int:
            if form[1] not in labels.numbers:
                raise Unknown
            return f"function {labels.numbers[form[1]]}"
        return f"({','.join([_encoded(each, labels) for each in form])})"
    if isinstance(form, frozenset):
        return f"{{{','.join(sorted(_encoded(each, labels) for each in form))}}}"
    if isinstance(form, np.generic | np.dtype):
        return f"{form.dtype.str} {form.tobytes()!r}" if isinstance(form, np.generic) else str(form)
    if isinstance(form, GenericAlias):
        return repr(form)
    if isinstance(form, FunctionType | BuiltinFunctionType | type | np.ufunc):
        if id(form) not in labels.named:
            labels.named[id(form)] = _named(form, labels)
        return labels.named[id(form)]
    raise Unknown


def packed(loop: Loop, **others: object) -> bytes:
    """Return a loop, and what is to be kept beside it, as data alone."""
    tape = loop.tape
    leaves = list(loop.parameters.values())
    found = {
        "operations": tape.operations,
        "types": "".join(tape.types),
        "depends": tape.depends,
        "states": loop.states,
        "leaves": [vars(leaf) for leaf in loop.leaves],
        "parameters": [[*place, vars(leaf)] for place, leaf in zip(loop.parameters, leaves, strict=True)],
        "rings": [vars(ring) for ring in loop.rings],
        "kept": [[name, *each] for name, each in loop.kept.items()],
        "unused": loop.unused,
        "own": loop.own,
        "tabled": loop.tabled,
    }
    for name in ("uniforms", "rows", "keys", "counted", "scheduled", "sizes", "tracks", "units"):
        found[name] = getattr(loop, name)
    return json.dumps({"loop": found, **others}, separators=(",", ":")).encode()


def unpacked(data: bytes) -> tuple[Loop, dict[str, Any]]:
    """Return the loop of `packed`, and what was kept beside it."""
    others = json.loads(data)
    found = others.pop("loop")
    operations = [*map(tuple, found["operations"])]
    loop = Loop(
        tape=Tape.of(operations, [*found["types"]], found["depends"]),
        states=[(now, after) for now, after in found["states"]],
        leaves=[_leaf(each) for each in found["leaves"]],
        parameters={Place(path, name): _leaf(each) for path, name, each in found["parameters"]},
        uniforms=found["uniforms"],
        rows=found["rows"],
        keys=found["keys"],
        rings=[Ring(**each) for each in found["rings"]],
        counted=found["counted"],
        kept={name: (tuple(shape), nodes) for name, shape, nodes in found["kept"]},
        sizes=tuple(found["sizes"]),
        unused=[Place(*each) for each in found["unused"]],
        tracks=found["tracks"],
        units=found["units"],
        scheduled=found["scheduled"],
    )
    vars(loop).update(own=found["own"], tabled=found["tabled"])
    return loop, others


def _leaf(found: dict[str, Any]) -> Leaf:
    return Leaf(**{**found, "shape": tuple(found["shape"])})
