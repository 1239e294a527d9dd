"""Array of symbols that NumPy accepts as its own, and NumPy's ufuncs on its entries.

NumPy's operators and functions call `__array_ufunc__` and `__array_function__`, which write the operations to
the tape. Functions that make arrays (`np.array`, `np.zeros`) do not call them; `tracing` replaces these
functions by those of `constructors`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import DTypeLike, NDArray

from pinmobile.arrays import Array, ArrayLike
from pinmobile.compiled.elementary import ELEMENTARY, exp, floor, log, power, rounded
from pinmobile.compiled.tape import Node, Number, absolute, bits, maximum, minimum, real, root, select
from pinmobile.errors import NotTraceable


def box(x: object) -> Any:
    """Return an entry as an array of shape ()."""
    array = np.empty((), object)
    array[()] = x
    return array


def as_array(x: object) -> Any:
    """Return an entry as an array, and an array itself."""
    return x if isinstance(x, np.ndarray) else box(x)


def is_truth(x: object) -> bool:
    """Return whether an entry is a truth value."""
    return x.kind == "b" if type(x) is Node else isinstance(x, bool | np.bool_)


def elementwise(function: Callable[..., Any], arity: int) -> Any:
    """Return a function of entries as a function of arrays; constants are computed as in NumPy."""

    def run(*given: Any) -> Any:
        for x in given:
            if type(x) is Node:
                return function(*given)
        with np.errstate(all="ignore"):
            result = function(*(x if is_truth(x) else np.float64(x) for x in given))
        return result.item() if hasattr(result, "item") else result

    return np.frompyfunc(run, arity, 1)


def as_float(x: Number) -> Any:
    """Return an entry as a number."""
    if type(x) is not Node:
        return np.float64(x)
    return select(x, 1.0, 0.0) if x.kind == "b" else x


choose = elementwise(select, 3)


def _is_known(x: object) -> bool:
    return type(x) is not Node or x.value is not None


def _propagate_nan(choice: Callable[..., Any]) -> Callable[..., Any]:
    """Return `maximum` or `minimum` with the result NaN if one number is NaN, as in NumPy."""

    def run(a: Number, b: Number) -> Any:
        if _is_known(a):
            return choice(a, b)
        return choice(b, a) if _is_known(b) else select(a == a, choice(a, b), a)

    return run


larger, smaller = _propagate_nan(maximum), _propagate_nan(minimum)


def _sign(x: Number) -> Any:
    return select(x > 0.0, 1.0, select(x < 0.0, -1.0, x))


def _truncate(x: Number) -> Any:
    size = floor(absolute(x))
    return select(x < 0.0, -size, size)


def _remainder(a: Number, b: Number) -> Any:
    return a - b * floor(a / b)


def on_truths(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of truth values; a number is true if it is not zero."""

    def run(*given: Number) -> Any:
        return function(*(x if is_truth(x) else x != 0.0 for x in given))

    return run


def _not(x: Number) -> Any:
    return np.invert(x) if isinstance(x, np.bool_) else ~x if type(x) is Node else not x


def _copy_sign(a: Number, b: Number) -> Any:
    return select(b < 0.0, -absolute(a), absolute(a))


_UFUNCS: dict[Any, Callable[..., Any]] = {
    **{getattr(np, function.__name__): function for function in ELEMENTARY},
    np.add: lambda a, b: as_float(a) + as_float(b),
    np.subtract: lambda a, b: as_float(a) - as_float(b),
    np.multiply: lambda a, b: as_float(a) * as_float(b),
    np.divide: lambda a, b: as_float(a) / as_float(b),
    np.negative: operator.neg,
    **dict.fromkeys((np.positive, np.conjugate), lambda x: x),
    **dict.fromkeys((np.absolute, np.fabs), absolute),
    np.sqrt: root,
    np.cbrt: lambda x: _copy_sign(exp(log(absolute(x)) * (1 / 3)), x),
    np.square: lambda x: x * x,
    np.reciprocal: lambda x: 1.0 / x,
    **dict.fromkeys((np.power, np.float_power), power),
    np.exp2: lambda x: exp(x * float(np.log(2.0))),
    np.log2: lambda x: log(x) * float(1 / np.log(2.0)),
    np.log10: lambda x: log(x) * float(1 / np.log(10.0)),
    np.hypot: lambda a, b: root(a * a + b * b),
    np.sign: _sign,
    np.maximum: larger,
    np.minimum: smaller,
    np.fmax: lambda a, b: select(b == b, maximum(a, b), a),
    np.fmin: lambda a, b: select(b == b, minimum(a, b), a),
    np.rint: rounded,
    np.floor: floor,
    np.ceil: lambda x: -floor(-x),
    np.trunc: _truncate,
    np.floor_divide: lambda a, b: floor(a / b),
    np.remainder: _remainder,
    np.fmod: lambda a, b: a - b * _truncate(a / b),
    np.copysign: _copy_sign,
    **dict.fromkeys((np.deg2rad, np.radians), lambda x: x * (np.pi / 180)),
    **dict.fromkeys((np.rad2deg, np.degrees), lambda x: x * (180 / np.pi)),
    np.heaviside: lambda x, h: select(x > 0.0, 1.0, select(x < 0.0, 0.0, h)),
    np.greater: operator.gt,
    np.greater_equal: operator.ge,
    np.less: operator.lt,
    np.less_equal: operator.le,
    np.equal: operator.eq,
    np.not_equal: operator.ne,
    np.logical_and: on_truths(operator.and_),
    np.logical_or: on_truths(operator.or_),
    np.logical_xor: on_truths(operator.xor),
    **dict.fromkeys((np.logical_not, np.invert), on_truths(_not)),
    np.bitwise_and: operator.and_,
    np.bitwise_or: operator.or_,
    np.bitwise_xor: operator.xor,
    np.isfinite: lambda x: absolute(x) < np.inf,
    np.isinf: lambda x: absolute(x) == np.inf,
    np.isnan: lambda x: x != x,
    np.signbit: lambda x: x < 0.0,
    np.spacing: lambda x: real((bits(absolute(x)) >> 52) << 52) * 2.0**-52,
}


UFUNCS = {ufunc: elementwise(function, ufunc.nin) for ufunc, function in _UFUNCS.items()}


clip = elementwise(lambda x, low, high: minimum(high, maximum(low, x)), 3)


def _objects(x: object) -> Any:
    return np.asarray(x).astype(object)


def compute(ufunc: np.ufunc, method: str, given: list[Any], options: dict[str, Any]) -> Any:
    """Return the result of a ufunc for arrays of objects."""
    name = ufunc.__name__
    if method == "__call__":
        if name in ("matmul", "vecdot", "matvec", "vecmat"):
            if np.asarray(given[0]).ndim == 2 and np.asarray(given[1]).ndim == 1:
                return _objects(given[0]) @ _objects(given[1])
            return getattr(np, name)(*map(_objects, given))
        if name == "clip":
            return clip(*given)
        if name == "divmod":
            return UFUNCS[np.floor_divide](*given), UFUNCS[np.remainder](*given)
        if name == "modf":
            integer = UFUNCS[np.trunc](*given)
            return given[0] - integer, integer
    if ufunc not in UFUNCS or method == "at":
        names = ", ".join(sorted(function.__name__ for function in _UFUNCS))
        message = f"np.{name}{'' if method == '__call__' else '.' + method} of symbols"
        raise NotTraceable(message, f"use one of {names}")
    if method == "reduce" and ufunc in (np.add, np.multiply) and np.asarray(given[0]).size == 0:
        return getattr(ufunc, method)(np.asarray(given[0], float), **options)
    return as_array(getattr(UFUNCS[ufunc], method)(*given, **options))


# Methods that NumPy calls on entries of an array of objects that was made without `constructors`.
for _ufunc, _function in _UFUNCS.items():
    if _ufunc.nin == 1 and _ufunc.__name__ not in ("conjugate", "positive", "negative", "absolute", "invert"):
        setattr(Node, _ufunc.__name__, _function)


setattr(Node, "__pow__", power)  # noqa: B010 (elementary functions need nodes first)


FUNCTIONS: dict[Any, Callable[..., Any]] = {}
"""NumPy functions with their own code for symbols; `functions` fills the mapping."""

REFUSALS: dict[Any, str] = {}
"""NumPy functions that cannot be compiled, and the code to write instead."""


_array, _asarray, _empty = np.array, np.asarray, np.empty


class Symbols(NDArrayOperatorsMixin):
    """Array of nodes and constants.

    Parameters
    ----------
    array : ndarray of object
        Nodes, floats and truth values.
    """

    __hash__ = None  # type: ignore[assignment]
    is_symbolic = True  # `arrays.finite` does not check symbols

    def __init__(self, array: NDArray[Any]) -> None:
        self.entries = array

    shape = property(lambda self: self.entries.shape)
    ndim = property(lambda self: self.entries.ndim)
    size = property(lambda self: self.entries.size)
    T = property(lambda self: Symbols(self.entries.T))
    real = property(lambda self: self)
    flat = property(lambda self: (Symbols(box(x)) for x in self.entries.flat))

    @property
    def dtype(self) -> Any:
        """Type bool if all entries are truth values, else float64."""
        return np.dtype(bool if self.size and all(map(is_truth, self.entries.flat)) else float)

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *given: object, out: Any = None, **options: Any
    ) -> Any:
        options.pop("dtype", None)
        options.pop("casting", None)
        mask = options.pop("where", True)
        given = tuple(map(unwrap, given))
        if mask is not True and method == "reduce":
            if ufunc.identity is None:
                raise NotTraceable(f"np.{ufunc.__name__} with a mask", "use np.where first")
            given, mask = (choose(unwrap(mask), given[0], ufunc.identity), *given[1:]), True
        result = wrap(compute(ufunc, method, list(given), options))
        if mask is not True:
            old = out[0] if out is not None else 0.0
            result = wrap(choose(unwrap(mask), unwrap(result), unwrap(old)))
        return result if out is None else put(result, out[0])

    def __array_function__(
        self, function: Callable[..., Any], types: object, given: Iterable[object], options: dict[str, Any]
    ) -> Any:
        out = options.pop("out", None) if function not in (np.clip,) else None
        if function in REFUSALS:
            raise NotTraceable(f"np.{function.__name__} of symbols", REFUSALS[function])
        try:
            if function in FUNCTIONS:
                result = FUNCTIONS[function](*given, **options)
            else:
                result = wrap(function(*map(unwrap, given), **{k: unwrap(v) for k, v in options.items()}))
        except NotTraceable:
            raise
        except (TypeError, AttributeError, ValueError) as error:
            remedy = "write it by sums, products and np.where, or run the law with engine=Engine.PYTHON"
            raise NotTraceable(f"np.{function.__name__} of symbols ({error})", remedy) from None
        return result if out is None else put(result, out)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Any:
        if all(type(x) is not Node or x.value is not None for x in self.entries.flat):
            return _array([float(x) for x in self.entries.flat], dtype or float).reshape(self.shape)
        if dtype is not None and np.dtype(dtype) != object:
            float(next(x for x in self.entries.flat if type(x) is Node and x.value is None))
        return self.entries.copy()

    def __getitem__(self, index: object) -> Any:
        return wrap(self.entries[_index(index)])

    def __setitem__(self, index: object, value: object) -> None:
        if isinstance(index, Symbols):  # x[mask] = value
            self.entries[...] = choose(index.entries, unwrap(value), self.entries)
            return
        value = unwrap(value)
        self.entries[_index(index)] = (
            value.item() if isinstance(value, np.ndarray) and not value.ndim else value
        )

    def __len__(self) -> int:
        return len(self.entries)

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(len(self.entries)))

    def __contains__(self, other: object) -> bool:
        return bool(np.any(self == other))

    def __bool__(self) -> bool:
        return bool(self.entries.item())

    def __float__(self) -> float:
        return float(self.entries.item())

    def __int__(self) -> int:
        return int(self.entries.item())

    def __index__(self) -> int:
        return operator.index(self.entries.item())

    def __round__(self, digits: int = 0) -> Any:
        return np.round(self, digits)

    def __format__(self, _: str) -> str:
        return repr(self)

    def __repr__(self) -> str:
        return f"<symbols of shape {self.shape}>"

    def item(self, *index: int) -> Any:
        """Return one entry."""
        return self[index] if index else self.reshape(())  # type: ignore[attr-defined]

    def tolist(self) -> Any:
        """Return the entries as nested lists."""
        return [x.tolist() if x.ndim else x for x in self] if self.ndim else self

    def copy(self, *_: object) -> Symbols:
        """Return a copy."""
        return Symbols(self.entries.copy())

    __copy__ = __deepcopy__ = copy

    def astype(self, dtype: DTypeLike, **_: object) -> Any:
        """Return truth values as numbers, or numbers as truth values."""
        if np.dtype(dtype).kind == "b":
            return self if self.dtype == bool else self != 0.0
        if np.dtype(dtype).kind in "iu":
            return np.trunc(self)
        if np.dtype(dtype) not in (np.float64, object):
            raise NotTraceable(f"an array of {np.dtype(dtype)}", "use float64, the type of all compiled laws")
        return wrap(_number(self.entries))

    def fill(self, value: object) -> None:
        """Set all entries to one value."""
        self.entries[...] = unwrap(value)

    def flatten(self, order: Any = "C") -> Any:
        """Return the entries as one row."""
        return wrap(self.entries.flatten(order))

    def conjugate(self) -> Symbols:
        """Return the array itself."""
        return self

    conj = conjugate


Values: TypeAlias = Symbols | Array
"""Array in a law: symbols or numbers."""

Operand: TypeAlias = Symbols | ArrayLike
"""Array-like object that may contain symbols."""

SymbolicScalar: TypeAlias = Symbols | float
"""Time, number of a sample or length of time in a law."""


def symbols(nodes: Sequence[Any], shape: tuple[int, ...]) -> Symbols:
    """Return nodes as an array of symbols."""
    array = _empty(len(nodes), object)
    for i, node in enumerate(nodes):
        array[i] = node
    return Symbols(array.reshape(shape))


def has_symbols(x: object) -> bool:
    """Return whether a value contains symbols."""
    if isinstance(x, list | tuple):
        return any(map(has_symbols, x))
    return isinstance(x, Symbols | Node) or (
        isinstance(x, np.ndarray) and x.dtype == object and any(type(y) is Node for y in x.flat)
    )


def unwrap(x: object) -> Any:
    """Return the entries of symbols as an array of objects, also inside lists and tuples."""
    if isinstance(x, Symbols):
        return x.entries
    if isinstance(x, Node):
        return box(x)
    if isinstance(x, list | tuple) and has_symbols(x):
        items = [unwrap(y) for y in x]
        scalars = [y.item() if isinstance(y, np.ndarray) and not y.ndim else y for y in items]
        return type(x)(scalars) if type(x) in (list, tuple) else scalars
    return x


def wrap(x: Any) -> Any:
    """Return an array of objects, or a node, as symbols."""
    if isinstance(x, Symbols):
        return x
    if isinstance(x, Node):
        return Symbols(box(x))
    if isinstance(x, np.ndarray) and x.dtype == object:
        return Symbols(x)
    if type(x) in (tuple, list):
        return type(x)(map(wrap, x))
    return x


def _index(index: object) -> Any:
    if has_symbols(index):
        parts = [unwrap(x) for x in index] if isinstance(index, tuple) else [unwrap(index)]
        if all(type(y) is not Node or y.value is not None for x in parts for y in _asarray(x, object).flat):
            return index
        raise NotTraceable("an index or a mask contains a symbol", "use np.where or np.select")
    return index


def put(result: object, out: object) -> Any:
    """Write a result into the array `out` of a NumPy call."""
    if not isinstance(out, Symbols):
        remedy = "write x = x + ..., or make the array in the law by np.zeros or np.zeros_like"
        message = "an operation writes symbols into an array of numbers from outside the law"
        raise NotTraceable(message, remedy)
    out.entries[...] = unwrap(result)
    return out


_number = elementwise(as_float, 1)


_METHODS = (
    "sum mean prod cumsum cumprod dot reshape ravel transpose swapaxes squeeze clip max min any all round "
    "trace repeat diagonal take std var argmax argmin argsort nonzero ptp"
)


def _method(name: str) -> Callable[..., Any]:
    function = getattr(np, name)

    def call(self: Symbols, *given: Any, **options: Any) -> Any:
        if name in ("reshape", "transpose") and len(given) > 1:
            given = (given,)
        return function(self, *given, **options)

    return call


for _name in _METHODS.split():
    setattr(Symbols, _name, _method(_name))


def entries(x: object) -> Any:
    """Return lists of symbols and numbers as one array of objects."""
    if isinstance(x, list | tuple):
        return np.stack([_asarray(entries(y), object) for y in x]) if x else _asarray([], object)
    return as_array(unwrap(x)).astype(object)
