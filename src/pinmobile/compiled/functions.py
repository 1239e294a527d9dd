"""NumPy functions of arrays of symbols, and the context in which laws run with symbols."""

from __future__ import annotations

import contextlib
import functools
import gc
import linecache
import operator
import sys
import sysconfig
import threading
from collections.abc import Callable, Iterable, Iterator
from functools import reduce
from pathlib import Path
from types import CellType, CodeType, ModuleType, TracebackType
from typing import Any

import numpy as np

from pinmobile.compiled.elementary import ELEMENTARY, on_floats
from pinmobile.compiled.symbolic import (
    FUNCTIONS,
    REFUSALS,
    Operand,
    Symbols,
    Values,
    as_array,
    box,
    choose,
    clip,
    elementwise,
    entries,
    has_symbols,
    larger,
    on_truths,
    put,
    smaller,
    unwrap,
    wrap,
)
from pinmobile.compiled.tape import Number, absolute, maximum, minimum, root, select
from pinmobile.errors import NotTraceable
from pinmobile.parts import TRACING as _local, is_tracing


def _where(condition: Operand, *choice: Operand) -> Any:
    if not choice:
        remedy = "give three arguments: np.where(condition, a, b)"
        raise NotTraceable("np.where with one argument of symbols", remedy)
    return wrap(choose(*map(unwrap, (condition, *choice))))


def _clip(
    a: object,
    a_min: object = None,
    a_max: object = None,
    out: object = None,
    *,
    min: object = None,
    max: object = None,
) -> Any:
    low, high = a_min if min is None else min, a_max if max is None else max
    bounds = -np.inf if low is None else low, np.inf if high is None else high
    result = wrap(clip(*map(unwrap, (a, *bounds))))
    return result if out is None else put(result, out)


def _make_reduction(function: Callable[..., Any], neutral: object = None) -> Callable[..., Any]:
    """Return a reduction; `neutral` takes the place of masked entries, by default the initial value."""
    step = elementwise(function, 2)

    def run(
        a: object,
        axis: int | None = None,
        out: object = None,
        keepdims: bool = False,
        initial: object = None,
        where: Operand = True,
    ) -> Any:
        array = entries(a)
        if where is not True:
            array = choose(unwrap(where), array, initial if neutral is None else neutral)
        if axis is None:
            result = box(reduce(function, array.reshape(-1))).reshape((1,) * array.ndim if keepdims else ())
        else:
            result = as_array(step.reduce(array, axis=axis, keepdims=keepdims))
        result = wrap(result if initial is None else as_array(step(result, initial)))
        return result if out is None else put(result, out)

    return run


def _norm(x: Symbols, ord: object = None, axis: int | None = None, keepdims: bool = False) -> Any:
    is_vector = x.ndim == 1 or isinstance(axis, int)
    if ord in (None, "fro") or (ord == 2 and is_vector):
        return np.sqrt(np.sum(np.square(x), axis=axis, keepdims=keepdims))
    if is_vector:
        if ord == 1:
            return np.sum(np.abs(x), axis=axis, keepdims=keepdims)
        if ord == np.inf:
            return np.max(np.abs(x), axis=axis, keepdims=keepdims)
    raise NotTraceable(f"np.linalg.norm with ord={ord!r}", "write it by sums, products, np.abs and np.max")


def _square_matrix(matrix: object) -> Any:
    """Return the entries of a square matrix."""
    a = entries(matrix).copy()
    if a.ndim != 2 or a.shape[0] != a.shape[1]:
        raise NotTraceable(f"np.linalg of an array of shape {a.shape}", "give one square matrix")
    return a


def _solve(a: Any, b: Any) -> Any:
    """Return the solution of linear equations by elimination with row pivoting."""
    a, b = _square_matrix(a), entries(b).copy()
    n, vector = len(a), b.ndim == 1
    rows = np.concatenate([a, b.reshape(n, -1)], axis=1)
    for j in range(n):
        for i in range(j + 1, n):
            swap = absolute(rows[i, j]) > absolute(rows[j, j])
            upper, lower = rows[j, j:].copy(), rows[i, j:].copy()
            rows[j, j:], rows[i, j:] = choose(swap, lower, upper), choose(swap, upper, lower)
        inverse = 1.0 / rows[j, j]
        for i in range(j + 1, n):
            factor = rows[i, j] * inverse
            rows[i, j + 1 :] = rows[i, j + 1 :] - factor * rows[j, j + 1 :]
    for j in reversed(range(n)):
        for i in range(j + 1, n):
            rows[j, n:] = rows[j, n:] - rows[j, i] * rows[i, n:]
        rows[j, n:] = rows[j, n:] * (1.0 / rows[j, j])
    return wrap(rows[:, n] if vector else rows[:, n:])


def _cholesky(a: Any, upper: bool = False) -> Any:
    a = _square_matrix(a)
    n = len(a)
    lower = np.asarray(np.zeros((n, n))).astype(object)
    for j in range(n):
        lower[j, j] = root(a[j, j] - sum((x * x for x in lower[j, :j]), 0.0))
        for i in range(j + 1, n):
            products = (x * y for x, y in zip(lower[i, :j], lower[j, :j], strict=True))
            lower[i, j] = (a[i, j] - sum(products, 0.0)) / lower[j, j]
    return wrap(lower.T if upper else lower)


def _determinant(a: Any) -> Any:
    a = _square_matrix(a)
    if len(a) == 1:
        return wrap(box(a[0, 0]))
    minors = (
        (-1.0) ** j * (a[0, j] * unwrap(_determinant(wrap(np.delete(a[1:], j, axis=1)))).item())
        for j in range(len(a))
    )
    return wrap(box(sum(minors, 0.0)))


def _interpolate(
    x: object, xp: object, fp: object, left: object = None, right: object = None, period: object = None
) -> Any:
    if period is not None:
        raise NotTraceable("np.interp with a period", "take np.mod first")
    places, values = entries(xp), entries(fp)
    slopes = [(values[i + 1] - values[i]) / (places[i + 1] - places[i]) for i in range(len(places) - 1)]

    def interpolate(x: Number) -> Any:
        result = values[-1] if right is None else right
        result = select(x == places[-1], values[-1], result)
        for i in reversed(range(len(slopes))):
            result = select(x < places[i + 1], values[i] + slopes[i] * (x - places[i]), result)
        result = select(x < places[0], values[0] if left is None else left, result)
        return select(x == x, result, x)

    return wrap(as_array(elementwise(interpolate, 1)(unwrap(x))))


_ORDERS = elementwise(minimum, 2), elementwise(maximum, 2)


def _sort(a: object, axis: int | None = -1, kind: str | None = None, *, stable: bool | None = None) -> Any:
    """Return the entries in order, by exchanges of neighbours."""
    array = entries(a).copy()
    rows = array.reshape(-1) if axis is None else np.moveaxis(array, axis, 0)
    for end in range(len(rows) - 1, 0, -1):
        for i in range(end):
            rows[i], rows[i + 1] = [order(rows[i], rows[i + 1]) for order in _ORDERS]
    return wrap(np.moveaxis(rows, 0, axis or 0))


def _select(conditions: Iterable[Operand], choices: Iterable[Operand], default: Operand = 0) -> Any:
    pairs = zip(conditions, choices, strict=True)
    return reduce(lambda rest, pair: _where(pair[0], pair[1], rest), reversed(list(pairs)), default)


def _full_like(
    a: Operand,
    fill_value: object,
    dtype: Any = None,
    order: str = "K",
    subok: bool = True,
    shape: int | tuple[int, ...] | None = None,
) -> Any:
    size = np.shape(a) if shape is None else shape
    result = Symbols(np.array(np.broadcast_to(entries(fill_value), size), object))
    return result if dtype is None else result.astype(dtype)


def _make_constant(value: float) -> Callable[..., Any]:
    return lambda a, *given, **options: _full_like(a, value, *given, **options)


def _make_masked(function: Callable[..., Any], neutral: float) -> Callable[..., Any]:
    """Return a sum or product that skips masked entries."""

    def run(a: Operand, *given: object, where: Operand = True, **options: object) -> Any:
        masked = a if where is True else _where(where, a, neutral)
        return wrap(function(unwrap(masked), *given, **options))

    return run


def _round(a: Symbols, decimals: int = 0) -> Any:
    return np.rint(a * 10.0**decimals) / 10.0**decimals if decimals else np.rint(a)


def _replace_nan(
    x: Symbols, copy: bool = True, nan: float = 0.0, posinf: float | None = None, neginf: float | None = None
) -> Any:
    top = np.finfo(float).max
    high, low = top if posinf is None else posinf, -top if neginf is None else neginf
    result = np.where(x != x, nan, np.where(x == np.inf, high, np.where(x == -np.inf, low, x)))
    return result if copy else put(result, x)


def _variance(
    a: Symbols,
    axis: int | None = None,
    dtype: Any = None,
    out: object = None,
    ddof: float = 0,
    keepdims: bool = False,
) -> Any:
    centred = a - np.mean(a, axis=axis, keepdims=True)
    count = np.size(a) if axis is None else np.shape(a)[axis]
    result = np.sum(np.square(centred), axis=axis, keepdims=keepdims) / (count - ddof)
    return result if out is None else put(result, out)


def _is_close(a: Values, b: Values, rtol: float = 1e-5, atol: float = 1e-8) -> Any:
    return np.where(np.isfinite(b), np.abs(a - b) <= atol + rtol * np.abs(b), a == b)


def _median(a: Any, axis: int | None = None, *, keepdims: bool = False) -> Any:
    ordered, half = _sort(a, axis), entries(a).size // 2 if axis is None else np.shape(a)[axis] // 2
    rows = np.moveaxis(ordered, axis or 0, 0)
    result = rows[half] if len(rows) % 2 else 0.5 * (rows[half - 1] + rows[half])
    if not keepdims:
        return result
    return np.reshape(result, (1,) * np.ndim(a)) if axis is None else np.expand_dims(result, axis)


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.clip: _clip,
    **dict.fromkeys((np.max, np.amax), _make_reduction(larger)),
    **dict.fromkeys((np.min, np.amin), _make_reduction(smaller)),
    np.ptp: lambda a, axis=None, keepdims=False: (
        np.max(a, axis, keepdims=keepdims) - np.min(a, axis, keepdims=keepdims)
    ),
    np.sum: _make_masked(np.sum, 0.0),
    np.prod: _make_masked(np.prod, 1.0),
    np.any: _make_reduction(on_truths(operator.or_), False),
    np.all: _make_reduction(on_truths(operator.and_), True),
    np.count_nonzero: lambda a, axis=None, *, keepdims=False: np.sum(
        (a != 0).astype(float), axis=axis, keepdims=keepdims
    ),
    np.select: _select,
    **dict.fromkeys((np.round, np.around), _round),
    np.nan_to_num: _replace_nan,
    np.var: _variance,
    np.std: lambda *given, **options: np.sqrt(_variance(*given, **options)),
    np.isclose: _is_close,
    np.allclose: lambda a, b, **options: np.all(_is_close(a, b, **options)),
    np.array_equal: lambda a1, a2: np.shape(a1) == np.shape(a2) and np.all(np.equal(a1, a2)),
    np.sinc: lambda x: np.where(x == 0, 1.0, np.sin(np.pi * x) / np.where(x == 0, 1.0, np.pi * x)),
    np.interp: _interpolate,
    np.sort: _sort,
    np.median: _median,
    np.unwrap: lambda p: _unwrap(p),
    **dict.fromkeys((np.zeros_like, np.empty_like), _make_constant(0.0)),
    np.ones_like: _make_constant(1.0),
    np.full_like: _full_like,
    np.copyto: lambda d, s, casting="same_kind", where=True: d.__setitem__(..., _where(where, s, d)),
    np.linalg.solve: _solve,
    np.linalg.inv: lambda a: _solve(a, np.eye(len(a))),
    np.linalg.det: _determinant,
    np.linalg.cholesky: _cholesky,
    np.linalg.norm: _norm,
    np.linalg.pinv: lambda a: _pseudo_inverse(a),
    np.shape: lambda a: a.shape if isinstance(a, Symbols) else entries(a).shape,
    np.ndim: lambda a: a.ndim if isinstance(a, Symbols) else entries(a).ndim,
    np.size: lambda a, axis=None: a.size if axis is None else a.shape[axis],
    np.iscomplexobj: lambda _: False,
    np.isrealobj: lambda _: True,
}


def _unwrap(p: Symbols) -> Any:
    if p.ndim != 1:
        raise NotTraceable(f"np.unwrap of an array of shape {p.shape}", "give one row")
    turns = np.cumsum(-2 * np.pi * np.rint(np.diff(p) / (2 * np.pi)))
    return np.concatenate([p[:1], p[1:] + turns])


def _pseudo_inverse(a: Symbols) -> Any:
    rows, columns = a.shape
    return np.linalg.inv(a.T @ a) @ a.T if rows >= columns else a.T @ np.linalg.inv(a @ a.T)


_BRANCHES = "it branches on its values: write it by np.where, or run the law with engine=Engine.PYTHON"


_EIGEN = (np.linalg.eig, np.linalg.eigh, np.linalg.eigvals, np.linalg.eigvalsh)
_SEARCHES = (np.nonzero, np.argwhere, np.flatnonzero, np.extract)
_REFUSALS: dict[Any, str] = {
    np.argmax: "use np.max, or np.where over the candidates",
    np.argmin: "use np.min, or np.where over the candidates",
    np.argsort: "use np.sort, or np.where over the candidates",
    **dict.fromkeys(_SEARCHES, "use np.where with three arguments"),
    **dict.fromkeys((np.searchsorted, np.digitize), "use np.interp, or a sum of comparisons"),
    **dict.fromkeys((*_EIGEN, np.unique, np.linalg.svd, np.linalg.qr), _BRANCHES),
    np.linalg.lstsq: "use np.linalg.solve of the normal equations, or np.linalg.pinv",
}


def _make_array(original: Callable[..., Any], copies: bool) -> Callable[..., Any]:
    def run(x: object, *given: Any, **options: Any) -> Any:
        if not has_symbols(x):
            return original(x, *given, **options)
        if isinstance(x, Symbols) and not copies:
            return x
        try:
            result = Symbols(np.array(entries(x), object, ndmin=options.get("ndmin", 0)))
        except ValueError:
            return original(x, *given, **options)  # NumPy raises an error about ragged lists
        dtype = given[0] if given else options.get("dtype")
        return result if dtype is None else result.astype(dtype)

    return run


def _make_fill(original: Callable[..., Any]) -> Callable[..., Any]:
    def run(*given: Any, **options: Any) -> Any:
        if original is np.full and has_symbols(given):
            return wrap(np.broadcast_to(entries(given[1]), given[0]).copy())
        result = original(*given, **options)
        # Symbols, so that a law can write symbols into the array.
        is_float = isinstance(result, np.ndarray) and result.dtype == float
        return Symbols(result.astype(object)) if is_float else result

    return run


def _elementary(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of numbers with the bits of compiled code; NumPy handles symbols."""
    original, floats = getattr(np, function.__name__), on_floats(function)

    def run(*given: Any, **options: Any) -> Any:
        if options or any(has_symbols(x) for x in given):
            return original(*given, **options)
        return floats(*given)

    return run


_FILLS = ("zeros", "empty", "ones", "full", "eye", "identity", "zeros_like", "empty_like", "ones_like")


def constructors() -> dict[str, Callable[..., Any]]:
    """Return the functions that replace NumPy functions of the same names while a law is traced."""
    names = "array", "asarray", "asanyarray", "ascontiguousarray"
    arrays = {name: _make_array(getattr(np, name), name == "array") for name in names}
    fills = {name: _make_fill(getattr(np, name)) for name in _FILLS}
    return arrays | fills | {function.__name__: _elementary(function) for function in ELEMENTARY}


FUNCTIONS.update(_FUNCTIONS)
REFUSALS.update(_REFUSALS)


_lock = threading.RLock()
_FOLDER = str(Path(__file__).parent)
_LIBRARY = str(Path(__file__).parents[1])
_STANDARD = sysconfig.get_paths()["stdlib"]
_OWN_PATHS = (_FOLDER, str(Path(np.__file__).parent), "<__array_function__", "<frozen")
_MACHINERY = "pinmobile.compiled.", "pinmobile.loop._trace"
FOREIGN = (
    frozenset(("numpy", "scipy", "pinocchio", "llvmlite", "sympy", "matplotlib", "attr", "attrs"))
    | sys.stdlib_module_names
)
"""Packages that contain no laws."""


def _guard(original: Callable[..., Any], substitute: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls `substitute` in a tracing thread, and NumPy's own in other threads."""

    @functools.wraps(original)
    def run(*given: object, **options: object) -> Any:
        return (substitute if is_tracing() else original)(*given, **options)

    return run


class _NumPy(ModuleType):
    """NumPy for modules of laws: functions that make arrays accept symbols; all others are NumPy's own.

    Nothing is replaced in numpy itself. Its compiled modules would read a symbol as an array and crash the
    process.
    """

    def __getattr__(self, name: str) -> Any:
        if name == "random" and is_tracing():
            remedy = "take the numbers from the context: context.noise(name, n), kept in state"
            raise NotTraceable("np.random in a law", remedy)
        return getattr(np, name)


_replacements = {name: _guard(getattr(np, name), other) for name, other in constructors().items()}
_numpy = _NumPy("numpy")
vars(_numpy).update(_replacements)
_swaps = {id(getattr(np, name)): other for name, other in _replacements.items()} | {id(np): _numpy}
_substitutes = {id(other) for other in _swaps.values()}
_read_modules: dict[str, tuple[dict[str, Any], int, list[str]]] = {}


@contextlib.contextmanager
def pause_gc() -> Iterator[None]:
    """Disable garbage collection: making many small permanent objects then takes a third of the time."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


@contextlib.contextmanager
def tracing(namespaces: Iterable[dict[str, Any]] = (), cells: Iterable[CellType] = ()) -> Iterator[None]:
    """Run laws with symbols in this thread: the library's laws and those whose code uses these namespaces.

    Parameters
    ----------
    namespaces : iterable of dict
        Globals of functions outside the library.
    cells : iterable of cell
        Variables in the closures of these functions.

    Raises
    ------
    NotTraceable
        If a law does something that symbols do not support; the message contains the line.
    """
    with _lock:
        modules = [*sys.modules.items()]
        spaces = {name: vars(module) for name, module in modules if module is not None and _holds_laws(name)}
        pairs = [(space, name) for module, space in spaces.items() for name in _swapped_names(module, space)]
        ids = {id(space) for space in spaces.values()}
        pairs += [(space, name) for space in namespaces if id(space) not in ids for name in [*space]]
        changes = [(space, name, x) for space, name in pairs if id(x := space.get(name)) in _swaps]
        cell_swaps = [(cell, value) for cell in cells if id(value := _content(cell)) in _swaps]
        for space, name, value in changes:
            space[name] = _swaps[id(value)]
        for cell, value in cell_swaps:
            cell.cell_contents = _swaps[id(value)]
        _local.depth = getattr(_local, "depth", 0) + 1
        try:
            with pause_gc(), np.errstate(all="ignore"):  # constants of unused branches may overflow
                yield
        except NotTraceable as error:
            place = place_of(error.__traceback__)
            raise error if error.place else NotTraceable(error.obstacle, error.remedy, place) from None
        except Exception as error:
            reason = f"with symbols it raises {type(error).__name__} ({error})"
            remedy = "write it in NumPy for one state, or run it with engine=Engine.PYTHON"
            if isinstance(error, IndexError):
                remedy = "if an index comes from a symbol, use np.where or np.select"
            raise NotTraceable(reason, remedy, place_of(error.__traceback__)) from error
        finally:
            _local.depth -= 1
            for space, name, value in changes:
                space[name] = value
            for cell, value in cell_swaps:
                cell.cell_contents = value


def _swapped_names(module: str, space: dict[str, Any]) -> list[str]:
    """Return the globals of a module that are replaced; it is read again if their number changes."""
    known = _read_modules.get(module)
    if known is None or known[0] is not space or known[1] != len(space):
        names = [name for name, x in [*space.items()] if id(x) in _swaps or id(x) in _substitutes]
        known = _read_modules[module] = space, len(space), names
    return known[2]


def _content(cell: CellType) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # the variable has no value yet
        return None


def _holds_laws(name: str) -> bool:
    return name.startswith("pinmobile.") and not name.startswith(_MACHINERY)


def place_of(traceback: TracebackType | None) -> str:
    """Return the last line of a law in a traceback: function, line, file and text.

    A line of a user's law takes precedence, then one of the library. Compiled modules have no lines of text;
    lines of other packages are not a user's, and those of the standard library are no law's.
    """
    user_line, own_line, law_line = "", "", ""
    while traceback is not None:
        code, line = traceback.tb_frame.f_code, traceback.tb_lineno
        file = code.co_filename
        is_package, is_own = "-packages" in file, file.startswith(_LIBRARY)
        if not file.startswith(_OWN_PATHS) and (is_package or not file.startswith(_STANDARD)):
            law_line = _format_line(code, line)
            own_line = law_line if is_own else own_line
            if not is_package and not is_own and linecache.getline(file, line):
                user_line = law_line
        traceback = traceback.tb_next
    return user_line or own_line or law_line


def law_place() -> str:
    """Return the line of the law that is running."""
    frame = sys._getframe(1)
    while frame is not None:
        name = frame.f_code.co_filename
        if not name.startswith(_OWN_PATHS):
            return _format_line(frame.f_code, frame.f_lineno)
        frame = frame.f_back  # type: ignore[assignment]
    return ""


def _format_line(code: CodeType, line: int) -> str:
    text = linecache.getline(code.co_filename, line).strip()
    place = f"{code.co_qualname}, line {line} of {Path(code.co_filename).name}"
    return f"{place} (`{text}`)" if text else place


@functools.lru_cache(4096)
def names_of(code: CodeType) -> frozenset[str]:
    """Return the names that code and its inner code use: globals and attributes."""
    inner = (const for const in code.co_consts if isinstance(const, CodeType))
    return frozenset(code.co_names).union(*map(names_of, inner))


def is_foreign(module: str) -> bool:
    """Return whether a module contains no laws, such as NumPy and the standard library."""
    return module.partition(".")[0] in FOREIGN
