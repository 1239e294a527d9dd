"""NumPy's elementwise functions on single entries: nodes and known numbers."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from pinmobile.compiled.elementary import (
    arccos,
    arcsin,
    arctan,
    arctan2,
    cos,
    cosh,
    exp,
    expm1,
    floor,
    log,
    log1p,
    power,
    rounded,
    sin,
    sinh,
    tan,
    tanh,
)
from pinmobile.compiled.tape import Node, absolute, bits, maximum, minimum, real, root, select
from pinmobile.errors import NotTraceable


def boxed(x: Any) -> Any:
    """Return one entry as an array of shape ()."""
    box = np.empty((), object)
    box[()] = x
    return box


def is_truth(x: Any) -> bool:
    """Tell whether an entry is a truth value."""
    return x.kind == "b" if type(x) is Node else isinstance(x, bool | np.bool_)


def elementwise(function: Callable[..., Any], arity: int) -> Any:
    """Return a function of entries as one of arrays; what is known is computed as NumPy does."""

    def run(*given: Any) -> Any:
        for x in given:
            if type(x) is Node:
                return function(*given)
        with np.errstate(all="ignore"):
            found = function(*(x if is_truth(x) else np.float64(x) for x in given))
        return found.item() if hasattr(found, "item") else found

    return np.frompyfunc(run, arity, 1)


def as_float(x: Any) -> Any:
    """Return an entry as a number."""
    return (
        select(x, 1.0, 0.0) if type(x) is Node and x.kind == "b" else x if type(x) is Node else np.float64(x)
    )


choose = elementwise(select, 3)


def _known(x: Any) -> bool:
    return type(x) is not Node or x.value is not None


def larger(a: Any, b: Any) -> Any:
    """Return the larger, and what is no number where one is none, as NumPy does."""
    if _known(a):
        return maximum(a, b)
    return maximum(b, a) if _known(b) else select(a == a, maximum(a, b), a)


def smaller(a: Any, b: Any) -> Any:
    """Return the smaller, and what is no number where one is none, as NumPy does."""
    if _known(a):
        return minimum(a, b)
    return minimum(b, a) if _known(b) else select(a == a, minimum(a, b), a)


def _sign(x: Any) -> Any:
    return select(x > 0.0, 1.0, select(x < 0.0, -1.0, x))


def _truncated(x: Any) -> Any:
    size = floor(absolute(x))
    return select(x < 0.0, -size, size)


def _remainder(a: Any, b: Any) -> Any:
    return a - b * floor(a / b)


def of_truths(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of truth values: of numbers, whether they are not zero."""

    def run(*given: Any) -> Any:
        return function(*(x if is_truth(x) else x != 0.0 for x in given))

    return run


def _not(x: Any) -> Any:
    return np.invert(x) if isinstance(x, np.bool_) else ~x if type(x) is Node else not x


def _copied_sign(a: Any, b: Any) -> Any:
    return select(b < 0.0, -absolute(a), absolute(a))


_UFUNCS: dict[Any, Callable[..., Any]] = {
    np.add: lambda a, b: as_float(a) + as_float(b),
    np.subtract: lambda a, b: as_float(a) - as_float(b),
    np.multiply: lambda a, b: as_float(a) * as_float(b),
    np.divide: lambda a, b: as_float(a) / as_float(b),
    np.negative: operator.neg,
    np.positive: lambda x: x,
    np.conjugate: lambda x: x,
    np.absolute: absolute,
    np.fabs: absolute,
    np.sqrt: root,
    np.cbrt: lambda x: _copied_sign(exp(log(absolute(x)) * (1 / 3)), x),
    np.square: lambda x: x * x,
    np.reciprocal: lambda x: 1.0 / x,
    np.power: power,
    np.float_power: power,
    np.sin: sin,
    np.cos: cos,
    np.tan: tan,
    np.exp: exp,
    np.exp2: lambda x: exp(x * float(np.log(2.0))),
    np.expm1: expm1,
    np.log: log,
    np.log2: lambda x: log(x) * float(1 / np.log(2.0)),
    np.log10: lambda x: log(x) * float(1 / np.log(10.0)),
    np.log1p: log1p,
    np.sinh: sinh,
    np.cosh: cosh,
    np.tanh: tanh,
    np.arcsin: arcsin,
    np.arccos: arccos,
    np.arctan: arctan,
    np.arctan2: arctan2,
    np.hypot: lambda a, b: root(a * a + b * b),
    np.sign: _sign,
    np.maximum: larger,
    np.minimum: smaller,
    np.fmax: lambda a, b: select(b == b, maximum(a, b), a),
    np.fmin: lambda a, b: select(b == b, minimum(a, b), a),
    np.rint: rounded,
    np.floor: floor,
    np.ceil: lambda x: -floor(-x),
    np.trunc: _truncated,
    np.floor_divide: lambda a, b: floor(a / b),
    np.remainder: _remainder,
    np.fmod: lambda a, b: a - b * _truncated(a / b),
    np.copysign: _copied_sign,
    np.deg2rad: lambda x: x * (np.pi / 180),
    np.radians: lambda x: x * (np.pi / 180),
    np.rad2deg: lambda x: x * (180 / np.pi),
    np.degrees: lambda x: x * (180 / np.pi),
    np.heaviside: lambda x, h: select(x > 0.0, 1.0, select(x < 0.0, 0.0, h)),
    np.greater: operator.gt,
    np.greater_equal: operator.ge,
    np.less: operator.lt,
    np.less_equal: operator.le,
    np.equal: operator.eq,
    np.not_equal: operator.ne,
    np.logical_and: of_truths(operator.and_),
    np.logical_or: of_truths(operator.or_),
    np.logical_xor: of_truths(operator.xor),
    np.logical_not: of_truths(_not),
    np.bitwise_and: operator.and_,
    np.bitwise_or: operator.or_,
    np.bitwise_xor: operator.xor,
    np.invert: of_truths(_not),
    np.isfinite: lambda x: absolute(x) < np.inf,
    np.isinf: lambda x: absolute(x) == np.inf,
    np.isnan: lambda x: x != x,
    np.signbit: lambda x: x < 0.0,
    np.spacing: lambda x: real((bits(absolute(x)) >> 52) << 52) * 2.0**-52,
}


UFUNCS = {ufunc: elementwise(function, ufunc.nin) for ufunc, function in _UFUNCS.items()}


between = elementwise(lambda x, low, high: minimum(high, maximum(low, x)), 3)


def _objects(x: Any) -> Any:
    return np.asarray(x).astype(object)


def computed(ufunc: Any, method: str, given: list[Any], options: dict[str, Any]) -> Any:
    """Return what a ufunc gives of arrays of objects."""
    name = ufunc.__name__
    if method == "__call__":
        if name in ("matmul", "vecdot", "matvec", "vecmat"):
            if np.asarray(given[0]).ndim == 2 and np.asarray(given[1]).ndim == 1:
                return _objects(given[0]) @ _objects(given[1])
            return getattr(np, name)(*map(_objects, given))
        if name == "clip":
            return between(*given)
        if name == "divmod":
            return UFUNCS[np.floor_divide](*given), UFUNCS[np.remainder](*given)
        if name == "modf":
            whole = UFUNCS[np.trunc](*given)
            return given[0] - whole, whole
    if ufunc not in UFUNCS or method == "at":
        names = ", ".join(sorted(each.__name__ for each in _UFUNCS))
        raise NotTraceable(
            f"np.{name}{'' if method == '__call__' else '.' + method} of symbols", f"use one of {names}"
        )
    if method == "reduce" and ufunc in (np.add, np.multiply) and np.asarray(given[0]).size == 0:
        return getattr(ufunc, method)(np.asarray(given[0], float), **options)
    found = getattr(UFUNCS[ufunc], method)(*given, **options)
    return found if isinstance(found, np.ndarray) else boxed(found)


# What NumPy's own code asks of an entry, in an array of objects that was made without `constructors`.
for _ufunc, _function in _UFUNCS.items():
    if _ufunc.nin == 1 and _ufunc.__name__ not in ("conjugate", "positive", "negative", "absolute", "invert"):
        setattr(Node, _ufunc.__name__, _function)


setattr(Node, "__pow__", power)  # noqa: B010 (elementary functions are made of nodes)
