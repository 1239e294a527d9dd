"""What determines the numbers of a scenario, in words that are the same in every process.

An object is described by its type and fields. Of a user's function or class there is the source, and what it
reads of its surroundings (defaults, closure, globals); of a trajectory the sampled reference, which is all
that the robots see of it.
"""

import inspect
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from hashlib import sha256
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from pinmobile.controllers import NoisyMeasurement
from pinmobile.disturbances import NoiseForce
from pinmobile.ensembles import Scenario
from pinmobile.ensembles.choosing import chosen_engine
from pinmobile.errors import InvalidArgument

__all__ = ["described", "flat"]

_SHOWN = 16  # numbers of an array that are told one by one
_LIBRARIES = ("pinmobile", "numpy", "scipy", "builtins", "math")
_PLAIN = (
    "n",
    "seed",
    "dt",
    "substeps",
    "limit",
    "after",
    "every",
    "robot",
    "controller",
    "spread",
    "integrator",
    "forces",
)


def described(scenario: Scenario) -> dict[str, Any]:
    """Return what determines the numbers of a scenario, as JSON can hold it, by dotted names.

    Raises
    ------
    InvalidArgument
        If there is something whose description would not be the same the next time.
    """
    found = {name: _of(name, getattr(scenario, name), ()) for name in _PLAIN}
    found["duration"] = _number(float(scenario.t[-1]))
    found["engine"] = repr(chosen_engine(scenario, None))
    found["times"] = _array(scenario.t)
    found["trajectory"] = {
        "type": type(scenario.trajectory).__qualname__,
        **_fields_of_ours(scenario.trajectory),
        "reference": _array(np.hstack(scenario.reference)),
    }
    return flat(found)


def flat(tree: Any, prefix: str = "") -> dict[str, Any]:
    """Return the leaves of a tree of mappings by their dotted names."""
    if not isinstance(tree, Mapping):
        return {prefix: tree}
    found: dict[str, Any] = {}
    for name, value in tree.items():
        found |= flat(value, f"{prefix}.{name}" if prefix else str(name))
    return found


def _fields_of_ours(value: Any) -> dict[str, Any]:
    """Return the fields of a trajectory, for the reader; its reference is what counts."""
    if not is_dataclass(value) or not _is_ours(type(value)):
        return {}
    try:
        return dict(_of("trajectory", value, ()))
    except InvalidArgument:
        return {}


def _of(where: str, value: Any, above: tuple[int, ...]) -> Any:
    """Return the description of a value."""
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int | float | np.number):
        return _number(value)
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, Enum):
        return value.name
    if id(value) in above:
        return "itself"
    within = (*above, id(value))
    if isinstance(value, tuple | list):
        items = [_of(f"{where}[{k}]", item, within) for k, item in enumerate(value)]
        nested = any(isinstance(item, Mapping) for item in items)
        return {str(k): item for k, item in enumerate(items)} if nested else items
    if isinstance(value, Mapping):
        return {str(k): _of(f"{where}[{k!r}]", value[k], within) for k in sorted(value, key=str)}
    if isinstance(value, FunctionType | MethodType | type | ModuleType | BuiltinFunctionType | np.ufunc):
        return _code(where, value, within)
    return _object(where, value, within)


def _number(value: Any) -> Any:
    number = float(value)
    if not np.isfinite(number):
        return str(number)
    return int(number) if number.is_integer() and abs(number) < 2**53 else number


def _array(values: Any) -> Any:
    array = np.ascontiguousarray(values)
    if np.ndim(values) == 0:
        return _number(values)
    if array.size <= _SHOWN and array.dtype.kind in "fiu":
        return [_number(value) for value in array.ravel()] if array.ndim == 1 else array.tolist()
    return f"{array.dtype.name} {array.shape} {sha256(array.tobytes()).hexdigest()[:32]}"


def _is_ours(kind: Any) -> bool:
    module = getattr(kind, "__module__", None)
    if module is None:  # as of a ufunc, and of a function that was typed
        return not isinstance(kind, FunctionType)
    return str(module).split(".")[0] in _LIBRARIES


def _object(where: str, value: Any, above: tuple[int, ...]) -> Any:
    kind = type(value)
    if hasattr(value, "dist") and hasattr(value, "rvs"):  # a frozen distribution of scipy
        parts = {"args": value.args, "kwds": value.kwds}
        return {"type": f"scipy.stats.{value.dist.name}", **_of(where, parts, above)}
    if is_dataclass(value):
        skipped = ("seed", "phases") if isinstance(value, NoiseForce | NoisyMeasurement) else ()
        names = [f.name for f in fields(value) if f.init and f.name not in skipped]
    elif hasattr(value, "__dict__") and not _is_ours(kind):
        names = sorted(vars(value))
    else:
        raise InvalidArgument(
            f"{where} is a {kind.__name__}, of which a store cannot tell whether it is the same the next "
            "time; expected numbers, arrays, functions, dataclasses or objects with such attributes"
        )
    found = {name: _of(f"{where}.{name}", getattr(value, name), above) for name in names}
    known = kind.__qualname__ if _is_ours(kind) else _code(where, kind, above)
    return {"type": known, **found}


def _code(where: str, value: Any, above: tuple[int, ...]) -> Any:
    """Return the description of a function, class or module: the source of a user's."""
    if isinstance(value, MethodType):
        return {"function": _code(where, value.__func__, above), "of": _of(where, value.__self__, above)}
    if isinstance(value, ModuleType) or _is_ours(value) or not isinstance(value, FunctionType | type):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', value.__name__)}".lstrip(
            "."
        )
    try:
        source = inspect.getsource(value)
    except (OSError, TypeError):
        raise InvalidArgument(
            f"{where} is {value.__qualname__}, whose source cannot be read, so that a store cannot tell "
            "whether it is the same the next time; expected a function in a file"
        ) from None
    members = (value,) if isinstance(value, FunctionType) else tuple(vars(value).values())
    # What `dataclass` wrote follows from the source.
    functions = [f for f in members if isinstance(f, FunctionType) and f.__code__.co_filename != "<string>"]
    read = {each.__name__: _reads(where, each, (*above, id(value))) for each in functions}
    return {"source": inspect.cleandoc(source), "reads": {name: what for name, what in read.items() if what}}


def _reads(where: str, function: FunctionType, above: tuple[int, ...]) -> dict[str, Any]:
    """Return what a function reads of its surroundings."""
    try:
        outside = inspect.getclosurevars(function)
    except ValueError:  # a cell that is still empty, as of a class that names itself
        return {}
    named = {**outside.globals, **outside.nonlocals}
    defaults = {"defaults": function.__defaults__, "kwdefaults": function.__kwdefaults__}
    found = {name: value for name, value in {**named, **defaults}.items() if value is not None}
    return {name: _of(f"{where} ({name})", found[name], above) for name in sorted(found)}
