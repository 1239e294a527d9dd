"""An array of symbols, which NumPy takes for an array of its own.

NumPy's operators and functions come here (`__array_ufunc__`, `__array_function__`), and what they would do
with numbers is written on the tape. What makes arrays of other things (`np.array`, `np.zeros`) does not ask
its arguments; `tracing` replaces these by the ones of `constructors`.
"""

import operator
from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from pinmobile.compiled import elementary as own
from pinmobile.compiled.tape import Node, absolute, bits, maximum, minimum, real, root, select
from pinmobile.errors import NotTraceable

__all__ = ["Symbols", "constructors", "entries", "has_symbols", "plain", "symbols", "wrapped"]

_array, _asarray, _empty = np.array, np.asarray, np.empty


class Symbols(NDArrayOperatorsMixin):
    """An array of nodes and known numbers.

    Parameters
    ----------
    array : ndarray of object
        Nodes, floats and truth values.
    """

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, array: Any) -> None:
        self.entries = array

    shape = property(lambda self: self.entries.shape)
    ndim = property(lambda self: self.entries.ndim)
    size = property(lambda self: self.entries.size)
    T = property(lambda self: Symbols(self.entries.T))
    real = property(lambda self: self)
    flat = property(lambda self: (Symbols(_boxed(x)) for x in self.entries.flat))

    @property
    def dtype(self) -> Any:
        """Truth values where all are; else float64."""
        return np.dtype(bool if self.size and all(map(_is_truth, self.entries.flat)) else float)

    def __array_ufunc__(self, ufunc: Any, method: str, *given: Any, out: Any = None, **options: Any) -> Any:
        options.pop("dtype", None)
        options.pop("casting", None)
        where = options.pop("where", True)
        given = tuple(map(plain, given))
        if where is not True and method == "reduce":
            if ufunc.identity is None:
                raise NotTraceable(f"np.{ufunc.__name__} over a part that is masked", "use np.where first")
            given, where = (_select(plain(where), given[0], ufunc.identity), *given[1:]), True
        found = wrapped(_computed(ufunc, method, list(given), options))
        if where is not True:
            kept = out[0] if out is not None else 0.0
            found = wrapped(_select(plain(where), plain(found), plain(kept)))
        return found if out is None else _put(found, out[0])

    def __array_function__(self, function: Any, types: Any, given: Any, options: Any) -> Any:
        out = options.pop("out", None) if function not in (np.clip,) else None
        if function in _FUNCTIONS:
            found = _FUNCTIONS[function](*given, **options)
        elif function in _REFUSED:
            raise NotTraceable(f"np.{function.__name__} of symbols", _REFUSED[function])
        else:
            try:
                found = wrapped(function(*map(plain, given), **{k: plain(v) for k, v in options.items()}))
            except (TypeError, AttributeError, ValueError) as error:
                raise NotTraceable(
                    f"np.{function.__name__} of symbols ({error})",
                    "write it by sums, products and np.where, or run the law with engine=ARRAYS",
                ) from None
        return found if out is None else _put(found, out)

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        if all(type(x) is not Node or x.value is not None for x in self.entries.flat):
            return _array([float(x) for x in self.entries.flat], dtype or float).reshape(self.shape)
        if dtype is not None and np.dtype(dtype) != object:
            float(next(x for x in self.entries.flat if type(x) is Node and x.value is None))
        return self.entries.copy()

    def __getitem__(self, index: Any) -> Any:
        return wrapped(self.entries[_index(index)])

    def __setitem__(self, index: Any, value: Any) -> None:
        if isinstance(index, Symbols):  # x[mask] = value
            self.entries[...] = _select(index.entries, plain(value), self.entries)
            return
        value = plain(value)
        self.entries[_index(index)] = (
            value.item() if isinstance(value, np.ndarray) and not value.ndim else value
        )

    def __len__(self) -> int:
        return len(self.entries)

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(len(self.entries)))

    def __contains__(self, other: Any) -> bool:
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

    def copy(self, *_: Any) -> "Symbols":
        """Return a copy."""
        return Symbols(self.entries.copy())

    __copy__ = copy

    def __deepcopy__(self, _: Any) -> "Symbols":
        return self.copy()

    def astype(self, dtype: Any, **_: Any) -> Any:
        """Return numbers of truth values, or truth values of numbers."""
        if np.dtype(dtype).kind == "b":
            return self if self.dtype == bool else self != 0.0
        if np.dtype(dtype).kind in "iu":
            return np.trunc(self)
        if np.dtype(dtype) not in (np.float64, object):
            raise NotTraceable(
                f"an array of {np.dtype(dtype)}", "use float64, which all laws are compiled with"
            )
        return wrapped(_number(self.entries))

    def fill(self, value: Any) -> None:
        """Set all entries to one value."""
        self.entries[...] = plain(value)

    def flatten(self, *_: Any) -> Any:
        """Return the entries as one row."""
        return wrapped(self.entries.reshape(-1).copy())

    def conjugate(self) -> "Symbols":
        """Return itself."""
        return self

    conj = conjugate


def symbols(nodes: Sequence[Any], shape: tuple[int, ...]) -> Symbols:
    """Return nodes as an array."""
    array = _empty(len(nodes), object)
    for i, node in enumerate(nodes):
        array[i] = node
    return Symbols(array.reshape(shape))


def has_symbols(x: Any) -> bool:
    """Tell whether a value is made of symbols, in part at least."""
    if isinstance(x, list | tuple):
        return any(map(has_symbols, x))
    return isinstance(x, Symbols | Node) or (
        isinstance(x, np.ndarray) and x.dtype == object and any(type(y) is Node for y in x.flat)
    )


def plain(x: Any) -> Any:
    """Return the entries of symbols as an array of objects; of lists and tuples, those inside."""
    if isinstance(x, Symbols):
        return x.entries
    if isinstance(x, Node):
        return _boxed(x)
    if isinstance(x, list | tuple) and has_symbols(x):
        inside = [plain(y) for y in x]
        one = [y.item() if isinstance(y, np.ndarray) and not y.ndim else y for y in inside]
        return type(x)(one) if type(x) in (list, tuple) else one
    return x


def wrapped(x: Any) -> Any:
    """Return an array of objects, or a node, as symbols."""
    if isinstance(x, Symbols):
        return x
    if isinstance(x, Node):
        return Symbols(_boxed(x))
    if isinstance(x, np.ndarray) and x.dtype == object:
        return Symbols(x)
    if type(x) in (tuple, list):
        return type(x)(map(wrapped, x))
    return x


def _boxed(x: Any) -> Any:
    box = _empty((), object)
    box[()] = x
    return box


def _is_truth(x: Any) -> bool:
    return x.kind == "b" if type(x) is Node else isinstance(x, bool | np.bool_)


def _index(index: Any) -> Any:
    if has_symbols(index):
        parts = [plain(x) for x in index] if isinstance(index, tuple) else [plain(index)]
        if all(type(y) is not Node or y.value is not None for x in parts for y in _asarray(x, object).flat):
            return index
        raise NotTraceable("an index, or a mask that selects, is a symbol", "use np.where or np.select")
    return index


def _put(found: Any, out: Any) -> Any:
    if not isinstance(out, Symbols):
        raise NotTraceable(
            "an operation writes symbols into an array of numbers that was made outside the law",
            "write x = x + ..., or make the array in the law by np.zeros or np.zeros_like",
        )
    out.entries[...] = plain(found)
    return out


def _elementwise(function: Callable[..., Any], arity: int) -> Any:
    return np.frompyfunc(function, arity, 1)


def _as_float(x: Any) -> Any:
    return select(x, 1.0, 0.0) if type(x) is Node and x.kind == "b" else x if type(x) is Node else float(x)


_number = _elementwise(_as_float, 1)
_select = _elementwise(select, 3)


def _known(x: Any) -> bool:
    return type(x) is not Node or x.value is not None


def _larger(a: Any, b: Any) -> Any:
    """Return the larger, and what is no number where one is none, as NumPy does."""
    if _known(a):
        return maximum(a, b)
    return maximum(b, a) if _known(b) else select(a == a, maximum(a, b), a)


def _smaller(a: Any, b: Any) -> Any:
    if _known(a):
        return minimum(a, b)
    return minimum(b, a) if _known(b) else select(a == a, minimum(a, b), a)


def _sign(x: Any) -> Any:
    return select(x > 0.0, 1.0, select(x < 0.0, -1.0, x))


def _truncated(x: Any) -> Any:
    size = own.floor(absolute(x))
    return select(x < 0.0, -size, size)


def _remainder(a: Any, b: Any) -> Any:
    return a - b * own.floor(a / b)


def _truths(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of truth values: of numbers, whether they are not zero."""

    def run(*given: Any) -> Any:
        return function(*(x if _is_truth(x) else x != 0.0 for x in given))

    return run


def _not(x: Any) -> Any:
    return np.invert(x) if isinstance(x, np.bool_) else ~x if type(x) is Node else not x


def _copied_sign(a: Any, b: Any) -> Any:
    return select(b < 0.0, -absolute(a), absolute(a))


_UFUNCS: dict[Any, Callable[..., Any]] = {
    np.add: lambda a, b: _as_float(a) + _as_float(b),
    np.subtract: lambda a, b: _as_float(a) - _as_float(b),
    np.multiply: lambda a, b: _as_float(a) * _as_float(b),
    np.divide: lambda a, b: _as_float(a) / _as_float(b),
    np.negative: operator.neg,
    np.positive: lambda x: x,
    np.conjugate: lambda x: x,
    np.absolute: absolute,
    np.fabs: absolute,
    np.sqrt: root,
    np.cbrt: lambda x: _copied_sign(own.exp(own.log(absolute(x)) * (1 / 3)), x),
    np.square: lambda x: x * x,
    np.reciprocal: lambda x: 1.0 / x,
    np.power: own.power,
    np.float_power: own.power,
    np.sin: own.sin,
    np.cos: own.cos,
    np.tan: own.tan,
    np.exp: own.exp,
    np.exp2: lambda x: own.exp(x * float(np.log(2.0))),
    np.expm1: own.expm1,
    np.log: own.log,
    np.log2: lambda x: own.log(x) * float(1 / np.log(2.0)),
    np.log10: lambda x: own.log(x) * float(1 / np.log(10.0)),
    np.log1p: own.log1p,
    np.sinh: own.sinh,
    np.cosh: own.cosh,
    np.tanh: own.tanh,
    np.arcsin: own.arcsin,
    np.arccos: own.arccos,
    np.arctan: own.arctan,
    np.arctan2: own.arctan2,
    np.hypot: lambda a, b: root(a * a + b * b),
    np.sign: _sign,
    np.maximum: _larger,
    np.minimum: _smaller,
    np.fmax: lambda a, b: select(b == b, maximum(a, b), a),
    np.fmin: lambda a, b: select(b == b, minimum(a, b), a),
    np.rint: own.rounded,
    np.floor: own.floor,
    np.ceil: lambda x: -own.floor(-x),
    np.trunc: _truncated,
    np.floor_divide: lambda a, b: own.floor(a / b),
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
    np.logical_and: _truths(operator.and_),
    np.logical_or: _truths(operator.or_),
    np.logical_xor: _truths(operator.xor),
    np.logical_not: _truths(_not),
    np.bitwise_and: operator.and_,
    np.bitwise_or: operator.or_,
    np.bitwise_xor: operator.xor,
    np.invert: _truths(_not),
    np.isfinite: lambda x: absolute(x) < np.inf,
    np.isinf: lambda x: absolute(x) == np.inf,
    np.isnan: lambda x: x != x,
    np.signbit: lambda x: x < 0.0,
    np.spacing: lambda x: real((bits(absolute(x)) >> 52) << 52) * 2.0**-52,
}
_VECTORISED = {ufunc: _elementwise(function, ufunc.nin) for ufunc, function in _UFUNCS.items()}
_between = _elementwise(lambda x, low, high: minimum(high, maximum(low, x)), 3)


def _objects(x: Any) -> Any:
    return _asarray(x).astype(object)


def _computed(ufunc: Any, method: str, given: list[Any], options: dict[str, Any]) -> Any:
    name = ufunc.__name__
    if method == "__call__":
        if name in ("matmul", "vecdot", "matvec", "vecmat"):
            if _asarray(given[0]).ndim == 2 and _asarray(given[1]).ndim == 1:
                return _objects(given[0]) @ _objects(given[1])
            return getattr(np, name)(*map(_objects, given))
        if name == "clip":
            return _between(*given)
        if name == "divmod":
            return _VECTORISED[np.floor_divide](*given), _VECTORISED[np.remainder](*given)
        if name == "modf":
            whole = _VECTORISED[np.trunc](*given)
            return given[0] - whole, whole
    if ufunc not in _VECTORISED or method == "at":
        names = ", ".join(sorted(each.__name__ for each in _UFUNCS))
        raise NotTraceable(
            f"np.{name}{'' if method == '__call__' else '.' + method} of symbols", f"use one of {names}"
        )
    if method == "reduce" and ufunc in (np.add, np.multiply) and _asarray(given[0]).size == 0:
        return getattr(ufunc, method)(_asarray(given[0], float), **options)
    found = getattr(_VECTORISED[ufunc], method)(*given, **options)
    return found if isinstance(found, np.ndarray) else _boxed(found)


def _where(condition: Any, *choice: Any) -> Any:
    if not choice:
        raise NotTraceable(
            "np.where with one argument of symbols", "give all three: np.where(condition, a, b)"
        )
    return wrapped(_select(*map(plain, (condition, *choice))))


def _clip(a: Any, a_min: Any = None, a_max: Any = None, out: Any = None, **named: Any) -> Any:
    low, high = named.get("min", a_min), named.get("max", a_max)
    bounds = -np.inf if low is None else low, np.inf if high is None else high
    found = wrapped(_between(*map(plain, (a, *bounds))))
    return found if out is None else _put(found, out)


def _reduced(function: Callable[..., Any]) -> Callable[..., Any]:
    step = _elementwise(function, 2)

    def run(a: Any, axis: Any = None, out: Any = None, keepdims: bool = False, **options: Any) -> Any:
        array = entries(a)
        if "initial" in options:
            array = np.append(array.reshape(-1), [options["initial"]])
        if axis is None:
            found = reduce(function, array.reshape(-1))
            return wrapped(_boxed(found).reshape((1,) * array.ndim if keepdims else ()))
        return wrapped(_boxed_array(step.reduce(array, axis=axis, keepdims=keepdims)))

    return run


def _boxed_array(x: Any) -> Any:
    return x if isinstance(x, np.ndarray) else _boxed(x)


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    if ord in (None, 2, "fro") and (axis is not None or x.ndim < 2 or ord != 2):
        return np.sqrt(np.sum(np.square(x), axis=axis, keepdims=keepdims))
    if x.ndim == 1 or isinstance(axis, int):
        if ord == 1:
            return np.sum(np.abs(x), axis=axis, keepdims=keepdims)
        if ord == np.inf:
            return np.max(np.abs(x), axis=axis, keepdims=keepdims)
    raise NotTraceable(f"np.linalg.norm with ord={ord!r}", "write it by sums, products, np.abs and np.max")


def _eliminated(matrix: Any, right: Any) -> Any:
    """Return the solution of linear equations by elimination, the row with the largest pivot moved up."""
    a, b = entries(matrix).copy(), entries(right).copy()
    if a.ndim != 2 or a.shape[0] != a.shape[1]:
        raise NotTraceable(f"np.linalg of an array of shape {a.shape}", "give one square matrix")
    n, vector = len(a), b.ndim == 1
    rows = np.concatenate([a, b.reshape(n, -1)], axis=1)
    for j in range(n):
        for i in range(j + 1, n):
            swap = absolute(rows[i, j]) > absolute(rows[j, j])
            upper, lower = rows[j, j:].copy(), rows[i, j:].copy()
            rows[j, j:], rows[i, j:] = _select(swap, lower, upper), _select(swap, upper, lower)
        inverse = 1.0 / rows[j, j]
        for i in range(j + 1, n):
            factor = rows[i, j] * inverse
            rows[i, j + 1 :] = _VECTORISED[np.subtract](
                rows[i, j + 1 :], _VECTORISED[np.multiply](factor, rows[j, j + 1 :])
            )
    for j in reversed(range(n)):
        for i in range(j + 1, n):
            rows[j, n:] = _VECTORISED[np.subtract](
                rows[j, n:], _VECTORISED[np.multiply](rows[j, i], rows[i, n:])
            )
        rows[j, n:] = _VECTORISED[np.multiply](rows[j, n:], 1.0 / rows[j, j])
    return wrapped(rows[:, n] if vector else rows[:, n:])


def _cholesky(matrix: Any, **_: Any) -> Any:
    a = entries(matrix)
    n = len(a)
    lower = _asarray(np.zeros((n, n))).astype(object)
    for j in range(n):
        lower[j, j] = root(a[j, j] - sum((x * x for x in lower[j, :j]), 0.0))
        for i in range(j + 1, n):
            products = (x * y for x, y in zip(lower[i, :j], lower[j, :j], strict=True))
            lower[i, j] = (a[i, j] - sum(products, 0.0)) / lower[j, j]
    return wrapped(lower)


def _determinant(matrix: Any) -> Any:
    a = entries(matrix)
    if len(a) == 1:
        return wrapped(_boxed(a[0, 0]))
    minors = (
        (-1.0) ** j * (a[0, j] * plain(_determinant(wrapped(np.delete(a[1:], j, axis=1)))).item())
        for j in range(len(a))
    )
    return wrapped(_boxed(sum(minors, 0.0)))


def _interpolated(x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None, period: Any = None) -> Any:
    if period is not None:
        raise NotTraceable("np.interp with a period", "take np.mod first")
    places, values = entries(xp), entries(fp)
    slopes = [(values[i + 1] - values[i]) / (places[i + 1] - places[i]) for i in range(len(places) - 1)]

    def one(at: Any) -> Any:
        found = values[-1] if right is None else right
        found = select(at == places[-1], values[-1], found)
        for i in reversed(range(len(slopes))):
            found = select(at < places[i + 1], values[i] + slopes[i] * (at - places[i]), found)
        found = select(at < places[0], values[0] if left is None else left, found)
        return select(at == at, found, at)

    return wrapped(_boxed_array(_elementwise(one, 1)(plain(x))))


def _sorted(a: Any, axis: int | None = -1, **_: Any) -> Any:
    """Return the entries in order, by exchanges."""
    array = entries(a).copy()
    if axis is None:
        array, axis = array.reshape(-1), 0
    rows = np.moveaxis(array, axis, 0)
    for end in range(len(rows) - 1, 0, -1):
        for i in range(end):
            low, high = rows[i].copy() if rows.ndim > 1 else rows[i], rows[i + 1]
            rows[i], rows[i + 1] = _between_two(low, high)
    return wrapped(np.moveaxis(rows, 0, axis))


def _between_two(a: Any, b: Any) -> Any:
    return _elementwise(minimum, 2)(a, b), _elementwise(maximum, 2)(a, b)


def _selected(conditions: Any, choices: Any, default: Any = 0) -> Any:
    pairs = zip(conditions, choices, strict=True)
    return reduce(lambda rest, pair: _where(pair[0], pair[1], rest), reversed(list(pairs)), default)


def _filled(value: Any) -> Callable[..., Any]:
    def run(a: Any, *_: Any, shape: Any = None, **__: Any) -> Any:
        return wrapped(np.full(np.shape(a) if shape is None else shape, value).astype(object))

    return run


def _full_like(a: Any, value: Any, *_: Any, **__: Any) -> Any:
    return wrapped(_array(np.broadcast_to(entries(value), np.shape(a)), object))


def _masked(function: Callable[..., Any], neutral: float) -> Callable[..., Any]:
    """Return a sum or product that leaves out what is masked."""

    def run(a: Any, *given: Any, where: Any = True, **options: Any) -> Any:
        masked = a if where is True else _where(where, a, neutral)
        return wrapped(function(plain(masked), *given, **options))

    return run


def _round(a: Any, decimals: int = 0, **_: Any) -> Any:
    return np.rint(a * 10.0**decimals) / 10.0**decimals if decimals else np.rint(a)


def _numbered(x: Any, nan: Any = 0.0, posinf: Any = None, neginf: Any = None, **_: Any) -> Any:
    top = np.finfo(float).max
    high, low = top if posinf is None else posinf, -top if neginf is None else neginf
    return np.where(x != x, nan, np.where(x == np.inf, high, np.where(x == -np.inf, low, x)))


def _spread(a: Any, axis: Any = None, ddof: float = 0, **_: Any) -> Any:
    centred = a - np.mean(a, axis=axis, keepdims=True)
    count = np.size(a) if axis is None else np.shape(a)[axis]
    return np.sum(np.square(centred), axis=axis) / (count - ddof)


def _near(a: Any, b: Any, rtol: float = 1e-5, atol: float = 1e-8, **_: Any) -> Any:
    return np.abs(a - b) <= atol + rtol * np.abs(b)


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.clip: _clip,
    np.max: _reduced(_larger),
    np.min: _reduced(_smaller),
    np.amax: _reduced(_larger),
    np.amin: _reduced(_smaller),
    np.ptp: lambda a, axis=None, **_: np.max(a, axis=axis) - np.min(a, axis=axis),
    np.sum: _masked(np.sum, 0.0),
    np.prod: _masked(np.prod, 1.0),
    np.any: _reduced(_truths(operator.or_)),
    np.all: _reduced(_truths(operator.and_)),
    np.count_nonzero: lambda a, axis=None, **_: np.sum((a != 0).astype(float), axis=axis),
    np.select: _selected,
    np.round: _round,
    np.around: _round,
    np.nan_to_num: _numbered,
    np.var: _spread,
    np.std: lambda a, axis=None, ddof=0, **_: np.sqrt(_spread(a, axis, ddof)),
    np.isclose: _near,
    np.allclose: lambda a, b, **options: np.all(_near(a, b, **options)),
    np.array_equal: lambda a, b, **_: np.all(a == b),
    np.sinc: lambda x: np.where(x == 0, 1.0, np.sin(np.pi * x) / np.where(x == 0, 1.0, np.pi * x)),
    np.interp: _interpolated,
    np.sort: _sorted,
    np.median: lambda a, **_: _middle(_sorted(a, axis=None)),
    np.unwrap: lambda p, **_: _unwrapped(p),
    np.zeros_like: _filled(0.0),
    np.ones_like: _filled(1.0),
    np.empty_like: _filled(0.0),
    np.full_like: _full_like,
    np.copyto: lambda d, s, casting="same_kind", where=True: d.__setitem__(..., _where(where, s, d)),
    np.linalg.solve: _eliminated,
    np.linalg.inv: lambda a: _eliminated(a, np.eye(len(a))),
    np.linalg.det: _determinant,
    np.linalg.cholesky: _cholesky,
    np.linalg.norm: _norm,
    np.linalg.pinv: lambda a, **_: _pseudo_inverse(a),
    np.shape: lambda a: a.shape if isinstance(a, Symbols) else entries(a).shape,
    np.ndim: lambda a: a.ndim if isinstance(a, Symbols) else entries(a).ndim,
    np.size: lambda a, axis=None: a.size if axis is None else a.shape[axis],
    np.iscomplexobj: lambda _: False,
    np.isrealobj: lambda _: True,
}


def _middle(ordered: Any) -> Any:
    half = ordered.size // 2
    return ordered[half] if ordered.size % 2 else 0.5 * (ordered[half - 1] + ordered[half])


def _unwrapped(p: Any) -> Any:
    steps = np.diff(p)
    turns = np.cumsum(-2 * np.pi * np.rint(steps / (2 * np.pi)))
    return np.concatenate([p[:1], p[1:] + turns])


def _pseudo_inverse(a: Any) -> Any:
    rows, columns = a.shape
    return np.linalg.inv(a.T @ a) @ a.T if rows >= columns else a.T @ np.linalg.inv(a @ a.T)


_LOOPS = "it branches on its values: write it by np.where, or run the law with engine=ARRAYS"
_REFUSED: dict[Any, str] = {
    np.argmax: "use np.max, or np.where over the candidates",
    np.argmin: "use np.min, or np.where over the candidates",
    np.argsort: "use np.sort, or np.where over the candidates",
    np.nonzero: "use np.where with three arguments",
    np.argwhere: "use np.where with three arguments",
    np.flatnonzero: "use np.where with three arguments",
    np.extract: "use np.where with three arguments",
    np.searchsorted: "use np.interp, or a sum of comparisons",
    np.digitize: "use np.interp, or a sum of comparisons",
    np.unique: _LOOPS,
    np.linalg.eig: _LOOPS,
    np.linalg.eigh: _LOOPS,
    np.linalg.eigvals: _LOOPS,
    np.linalg.eigvalsh: _LOOPS,
    np.linalg.svd: _LOOPS,
    np.linalg.qr: _LOOPS,
    np.linalg.lstsq: "use np.linalg.solve of the normal equations, or np.linalg.pinv",
}

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

# What NumPy's own code asks of an entry, in an array of objects that was made without `constructors`.
for _ufunc, _function in _UFUNCS.items():
    if _ufunc.nin == 1 and _ufunc.__name__ not in ("conjugate", "positive", "negative", "absolute", "invert"):
        setattr(Node, _ufunc.__name__, _function)
setattr(Node, "__pow__", own.power)  # noqa: B010 (elementary functions are made of nodes)


def entries(x: Any) -> Any:
    """Return lists of symbols and numbers as one array of objects."""
    if isinstance(x, list | tuple):
        return np.stack([_asarray(entries(y), object) for y in x]) if x else _asarray([], object)
    found = plain(x)
    return found.astype(object) if isinstance(found, np.ndarray) else _boxed(found)


def _making(true: Callable[..., Any], copies: bool) -> Callable[..., Any]:
    def run(x: Any, *given: Any, **options: Any) -> Any:
        if not has_symbols(x):
            return true(x, *given, **options)
        if isinstance(x, Symbols) and not copies:
            return x
        try:
            found = Symbols(_array(entries(x), object))
        except ValueError:
            return true(x, *given, **options)  # ragged: NumPy says so
        dtype = given[0] if given else options.get("dtype")
        return found if dtype is None else found.astype(dtype)

    return run


def _filling(true: Callable[..., Any]) -> Callable[..., Any]:
    def run(*given: Any, **options: Any) -> Any:
        if true is np.full and has_symbols(given):
            return wrapped(np.broadcast_to(entries(given[1]), given[0]).copy())
        found = true(*given, **options)
        # Numbers that symbols can be written into.
        is_float = isinstance(found, np.ndarray) and found.dtype == float
        return Symbols(found.astype(object)) if is_float else found

    return run


def _own(name: str) -> Callable[..., Any]:
    """Return a function of numbers that has the bits of the compiled one; of symbols, NumPy comes here."""
    true, floats = getattr(np, name), own.of_floats(getattr(own, name))

    def run(*given: Any, **options: Any) -> Any:
        if options or any(has_symbols(x) for x in given):
            return true(*given, **options)
        return floats(*given)

    return run


_MADE = ("zeros", "empty", "ones", "full", "eye", "identity", "zeros_like", "empty_like", "ones_like")


def constructors() -> dict[str, Callable[..., Any]]:
    """Return what stands for NumPy's functions of the same names while a law is traced."""
    making = {
        name: _making(getattr(np, name), name == "array")
        for name in ("array", "asarray", "asanyarray", "ascontiguousarray", "asfarray")
        if hasattr(np, name)
    }
    filling = {name: _filling(getattr(np, name)) for name in _MADE}
    hyperbolic = "sinh", "cosh", "tanh"
    angles = "arcsin", "arccos", "arctan", "arctan2"
    functions = ("sin", "cos", "tan", "exp", "expm1", "log", "log1p", *hyperbolic, *angles)
    return making | filling | {name: _own(name) for name in functions}
