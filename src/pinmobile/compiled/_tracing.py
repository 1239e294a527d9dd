"""Tracing of laws with symbols: replaced functions of NumPy, and errors that contain the line of code."""

from __future__ import annotations

import contextlib
import functools
import gc
import linecache
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import CellType, CodeType, ModuleType, TracebackType
from typing import Any

import numpy as np

from pinmobile.compiled.functions import constructors
from pinmobile.errors import NotTraceable
from pinmobile.parts import TRACING as _local, is_tracing

_lock = threading.RLock()
_FOLDER = str(Path(__file__).parent)
_LIBRARY = str(Path(__file__).parents[1])
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
            if error.place:
                raise
            raise NotTraceable(error.obstacle, error.remedy, place_of(error.__traceback__)) from None
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

    A line of a user's law takes precedence. Compiled modules have no lines of text, and lines of other
    packages are not a user's.
    """
    user_line, law_line = "", ""
    while traceback is not None:
        code, line = traceback.tb_frame.f_code, traceback.tb_lineno
        file = code.co_filename
        if not file.startswith(_OWN_PATHS):
            law_line = _format_line(code, line)
            is_users = "site-packages" not in file and not file.startswith(_LIBRARY)
            if is_users and linecache.getline(file, line):
                user_line = law_line
        traceback = traceback.tb_next
    return user_line or law_line


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
