"""Running a law on symbols: NumPy replaced by name where its parts stand, and refusals that name the line."""

from __future__ import annotations

import contextlib
import functools
import gc
import inspect
import linecache
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from types import CellType, CodeType, FunctionType, MethodType, ModuleType, TracebackType
from typing import Any, TypeVar

import numpy as np

from pinmobile.compiled.functions import constructors
from pinmobile.errors import NotTraceable

_Function = TypeVar("_Function", bound=Callable[..., Any])
_lock = threading.RLock()
_local = threading.local()
_HERE = str(Path(__file__).parent)
_MADE_BY_CODE = 1 << 9  # of a class's flags: it comes of a class statement
_OURS = (_HERE, str(Path(np.__file__).parent), "<__array_function__", "<frozen")
_OPENED = (FunctionType, MethodType, type, dict, list, tuple)  # Python's own that a law's things stand in
# By Pinocchio or compiled, or of what is known of parts: what it keeps changes from call to call.
_RUNS_LAWS = {"pinmobile.constancy", "pinmobile.robot.pinocchio_calls"}
_LAWS = ("pinmobile.compiled.parts", "pinmobile.compiled.sample")
_OWN = "pinmobile.", "namedtuple_"  # the second is what Python makes for named tuples
_FOREIGN = (
    frozenset(("numpy", "scipy", "pinocchio", "llvmlite", "sympy", "matplotlib")) | sys.stdlib_module_names
)


def untraced(function: _Function) -> _Function:
    """Let a function that reads what tracing replaces wait until no other thread traces."""

    @functools.wraps(function)
    def run(*given: Any, **options: Any) -> Any:
        with _lock:
            return function(*given, **options)

    return run  # type: ignore[return-value]


def _is_on() -> bool:
    return bool(getattr(_local, "depth", 0))


def _guarded(true: Callable[..., Any], other: Callable[..., Any]) -> Callable[..., Any]:
    """Return `other` for the thread that traces, and NumPy's own for all others."""

    @functools.wraps(true)
    def run(*given: object, **options: object) -> Any:
        return (other if _is_on() else true)(*given, **options)

    return run


class _NumPy(ModuleType):
    """NumPy for the modules of a law: what makes arrays knows of symbols; the rest is NumPy's own.

    In numpy itself nothing is replaced: its compiled modules would take a symbol for an array, and the
    process would die.
    """

    def __getattr__(self, name: str) -> Any:
        if name == "random" and _is_on():
            raise NotTraceable(
                "np.random in a law",
                "take the numbers from the context: context.normal(name, n), kept in state",
            )
        return getattr(np, name)


_replaced = {name: _guarded(getattr(np, name), other) for name, other in constructors().items()}
_numpy = _NumPy("numpy")
vars(_numpy).update(_replaced)
_others = {id(getattr(np, name)): other for name, other in _replaced.items()} | {id(np): _numpy}


def _by_its_law(name: str, of: Any = None) -> Callable[..., Any]:
    """Return a method of what has `traced`: that of what this returns; of `of`, or of its first argument."""

    def asked(*given: Any, **options: Any) -> Any:
        robot, arguments = (given[0], given[1:]) if of is None else (of, given)
        depth, _local.depth = _local.depth, 0  # it is made of numbers
        try:
            own = robot.traced()
        finally:
            _local.depth = depth
        if not hasattr(own, name):
            known = [each for each in _methods(type(robot)) if hasattr(own, each)]
            raise NotTraceable(
                f"{name} of a {type(robot).__name__}, which takes numbers alone",
                f"a law that is compiled asks it for {', '.join(known)}",
            )
        return getattr(own, name)(*arguments, **options)

    return asked


def _methods(kind: type) -> tuple[str, ...]:
    """Return the names of a class's methods, but of `traced` itself."""
    found = (name for name in dir(kind) if not name.startswith("_") and name != "traced")
    return tuple(name for name in found if isinstance(inspect.getattr_static(kind, name), FunctionType))


def _replacement(value: object) -> Any:
    """Return what stands for a global or closed over value while a law is traced; None: itself."""
    if id(value) in _others:
        return _others[id(value)]
    if isinstance(value, MethodType) and hasattr(type(value.__self__), "traced"):
        return _guarded(value, _by_its_law(value.__name__, value.__self__))
    return None


@contextlib.contextmanager
def _by_their_laws(kinds: Iterable[type]) -> Iterator[None]:
    """Let the methods of classes that have `traced` answer as what it returns does, in threads that trace.

    So a law reaches a robot that is no attribute of a part: a global, or what a function closes over.
    """
    put: list[tuple[type, str, Any]] = []
    try:
        for kind in kinds:
            for name in _methods(kind):
                put.append((kind, name, vars(kind).get(name)))
                setattr(kind, name, _guarded(getattr(kind, name), _by_its_law(name)))
        yield
    finally:
        for kind, name, before in reversed(put):
            if before is None:
                delattr(kind, name)
            else:
                setattr(kind, name, before)


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """Look for no garbage: where thousands of small objects are made that stay, it takes a third as long."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


@contextlib.contextmanager
def tracing(parts: Iterable[Any] | Walk) -> Iterator[None]:
    """Let the laws of these parts, or those that a walk has met, run on symbols, in this thread.

    Raises
    ------
    NotTraceable
        If a law does what cannot be done with symbols; it names the line.
    """
    with _lock:
        walk = parts if isinstance(parts, Walk) else Walk(parts)
        changed = [
            (names, name, value, other)
            for names in walk.namespaces.values()
            for name, value in names.items()
            if (other := _replacement(value)) is not None
        ]
        shut = [
            (cell, cell.cell_contents, other)
            for cell in walk.cells.values()
            if (other := _replacement(cell.cell_contents)) is not None
        ]
        for names, name, _, other in changed:
            names[name] = other
        for cell, _, other in shut:
            cell.cell_contents = other
        _local.depth = getattr(_local, "depth", 0) + 1
        try:
            with uncollected(), _by_their_laws(walk.modelled):
                yield
        except NotTraceable as error:
            if error.place:
                raise
            raise NotTraceable(error.what, error.instead, place_of(error.__traceback__)) from None
        except Exception as error:
            index = isinstance(error, IndexError)
            raise NotTraceable(
                f"on symbols it raises {type(error).__name__} ({error})",
                "where an index comes from a symbol, use np.where or np.select"
                if index
                else "write it for one state, by NumPy's operators and functions, or run it by PYTHON",
                place_of(error.__traceback__),
            ) from error
        finally:
            _local.depth -= 1
            for names, name, value, _ in changed:
                names[name] = value
            for cell, value, _ in shut:
                cell.cell_contents = value


def place_of(traceback: TracebackType | None) -> str:
    """Return the last line of a law in a traceback, a user's if there is one: function, line, file and text.

    Compiled modules have no lines to show, and those of other packages are no user's.
    """
    found, theirs = "", ""
    while traceback is not None:
        code, line = traceback.tb_frame.f_code, traceback.tb_lineno
        if not code.co_filename.startswith(_OURS):
            theirs = _told(code, line)
            if "site-packages" not in code.co_filename and linecache.getline(code.co_filename, line):
                found = theirs
        traceback = traceback.tb_next
    return found or theirs


def calling_place() -> str:
    """Return the line of the law that is running."""
    frame = sys._getframe(1)
    while frame is not None:
        name = frame.f_code.co_filename
        if not name.startswith(_OURS):
            return _told(frame.f_code, frame.f_lineno)
        frame = frame.f_back  # type: ignore[assignment]
    return ""


def _told(code: CodeType, line: int) -> str:
    text = linecache.getline(code.co_filename, line).strip()
    return f"{code.co_qualname}, line {line} of {Path(code.co_filename).name}" + (
        f" (`{text}`)" if text else ""
    )


_MAKING = frozenset(
    {
        *("__init__", "__attrs_post_init__", "__setattr__", "__delattr__", "__reduce__", "__copy__", "check"),
        *("__getstate__", "__setstate__", "__eq__", "__ne__", "__hash__"),
    }
)
"""Methods of attrs classes that make an object, or tell it from others, which no law asks for."""


class Walk:
    """Everything that the code of some parts refers to by name, found by reading the code.

    Attributes
    ----------
    namespaces : dict of int to dict
        Globals of the functions, by identity.
    cells : dict of int to cell
        What functions close over.
    closures : dict of int to (function, int)
        A function that closes over a cell, and the cell's place in its closure.
    names : dict of (int, str) to (mapping, str)
        Where the code looks up what: globals, modules and classes.
    modelled : list of type
        Classes of things that have `traced`, whose own methods are no NumPy.
    functions : list of function
        Whose code it is.
    kinds : dict of type to None
        Classes that were met, in order.
    """

    def __init__(self, parts: Iterable[Any]) -> None:
        self.seen: dict[int, Any] = {}
        self.namespaces: dict[int, dict[str, Any]] = {}
        self.cells: dict[int, CellType] = {}
        self.closures: dict[int, tuple[FunctionType, int]] = {}
        self.names: dict[tuple[int, str], tuple[Mapping[str, Any], str]] = {}
        self.modelled: list[type] = []
        self.functions: list[FunctionType] = []
        self.kinds: dict[type, None] = {}
        for part in parts:
            self.visit(part)

    @property
    def is_ours(self) -> bool:
        """Whether all that code is this library's, which asks nothing but its arguments."""
        return all((f.__module__ or "").startswith(_OWN) for f in self.functions)

    def _met(self, where: object, mapping: Mapping[str, Any], name: str) -> None:
        self.names[id(where), name] = mapping, name

    def visit(self, thing: object) -> None:
        """Go through what a thing refers to, once."""
        if id(thing) in self.seen or thing is None or isinstance(thing, str | int | float | np.ndarray):
            return
        self.seen[id(thing)] = thing  # kept, so that no other gets its id
        if isinstance(thing, FunctionType):
            self._function(thing)
        elif isinstance(thing, MethodType):
            self.visit(thing.__func__)
            self.visit(thing.__self__)
        elif isinstance(thing, functools.partial):
            self.visit((thing.func, *thing.args, *thing.keywords.values()))
        elif isinstance(thing, property):
            self.visit(thing.fget)
        elif isinstance(thing, staticmethod | classmethod):
            self.visit(thing.__func__)
        elif isinstance(thing, functools.cached_property):
            self.visit(thing.func)
        elif isinstance(thing, type):
            self._class(thing)
        elif isinstance(thing, list | tuple):
            for each in thing:
                self.visit(each)
        elif isinstance(thing, dict):
            for each in list(thing.values()):
                self.visit(each)
        elif not isinstance(thing, ModuleType):
            if hasattr(type(thing), "traced") and type(thing) not in self.modelled:
                self.modelled.append(type(thing))
            self._class(type(thing))
            own = getattr(thing, "__dict__", None)  # some answer to any name with something
            for each in list(own.values()) if isinstance(own, dict) else ():
                self.visit(each)

    def _class(self, thing: type) -> None:
        for each in thing.__mro__:
            if each in self.kinds:
                continue
            self.kinds[each] = None
            if _is_own(each.__module__, bool(each.__flags__ & _MADE_BY_CODE)):
                own = vars(each)  # another object each time
                made = _MAKING if "__attrs_attrs__" in own else ("_abc_impl",)
                for name, value in sorted(own.items(), key=itemgetter(0)):
                    if name in made:
                        continue
                    if not name.startswith("__") or name == "__call__":
                        self._met(each, own, name)
                    law = name != "__repr__" and not isinstance(value, type)
                    if law and callable(getattr(value, "__get__", None)):
                        self.visit(value)

    def _function(self, function: FunctionType) -> None:
        if hasattr(function, "__wrapped__"):
            self.visit(function.__wrapped__)
        if not _is_own(function.__module__ or "", True):
            return
        self.functions.append(function)
        self.namespaces[id(function.__globals__)] = function.__globals__
        for value in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()):
            self._named(value, function.__code__)
        for place, cell in enumerate(function.__closure__ or ()):
            with contextlib.suppress(ValueError):  # not set yet
                self.visit(cell.cell_contents)
                self.cells[id(cell)] = cell
                self.closures[id(cell)] = function, place
        for name in sorted(names_of(function.__code__)):
            if name in function.__globals__:
                self._met(function.__globals__, function.__globals__, name)
                self._named(function.__globals__[name], function.__code__)

    def _named(self, value: object, code: CodeType) -> None:
        """Visit what a name stands for; of a module, what the code can mean in it."""
        if isinstance(value, ModuleType):
            if not is_foreign(value.__name__):
                for name in sorted(names_of(code) & vars(value).keys()):
                    self._met(value, vars(value), name)
                    self.visit(vars(value)[name])
        elif isinstance(value, _OPENED) or not is_foreign(type(value).__module__):
            self.visit(value)


@functools.lru_cache(4096)
def names_of(code: CodeType) -> frozenset[str]:
    """Return the names that code and the code inside it look up: globals and attributes."""
    inner = (const for const in code.co_consts if isinstance(const, CodeType))
    return frozenset(code.co_names).union(*map(names_of, inner))


def _is_own(module: str, is_code: bool) -> bool:
    """Tell whether code of a module may be a law's; what `exec` runs without a name counts as builtins."""
    return not is_foreign(module) or (is_code and module == "builtins")


def is_foreign(module: str) -> bool:
    """Tell whether a module holds no laws: NumPy, the standard library, the machinery here."""
    own = module.startswith("pinmobile.compiled.") and module not in _LAWS
    return own or module in _RUNS_LAWS or module.partition(".")[0] in _FOREIGN
