"""Users' code: modules beside a file, loaded here and on workers elsewhere, and the text of functions."""

from __future__ import annotations

import ast
import builtins
import linecache
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.util import decode_source, find_spec
from pathlib import Path
from pickle import loads
from threading import RLock
from traceback import walk_tb
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple, TypeAlias
from uuid import uuid4

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument, PinmobileError, UnknownName
from pinmobile.files import cannot
from pinmobile.loop import Part, Scenario, part_of
from pinmobile.sweeps.grids import imported

_LOADING = RLock()
_LIBRARIES = ("pinmobile", "numpy", "scipy", "pinocchio")  # their versions are told too
_STANDARD = Path(os.__file__).parent
_HIDING = frozenset({"__import__", "compile", "eval", "exec", "globals", "input", "open", "vars"})


class Source(NamedTuple):
    """The text of a module, and the file that it is from.

    Attributes
    ----------
    file : str
        Where it was read.
    text : bytes
        All of it.
    """

    file: str
    text: bytes


class Code:
    """The modules beside a file.

    They are in `sys.modules` under names that nobody else imports, and their folder is on no path: what has
    the same name elsewhere is not hidden from anybody else. Each finds the modules beside it. Loading one
    runs it: ask the user first.

    Parameters
    ----------
    folder : Path or None
        Where they lie; None: there are those of `sources` alone.
    token : str, optional
        Tells these modules from those of the same name; by default it is a new one.
    """

    def __init__(self, folder: Path | None, token: str | None = None) -> None:
        self.folder, self.token = folder, token or uuid4().hex
        self.sources: dict[str, Source] = {}
        self.installed: dict[str, str] = {}
        self._files: set[str] = set()

    def named(self, name: str) -> Any:
        """Return what ``"module:Name"`` names.

        Raises
        ------
        UnknownName
            If the module has no such name.
        InvalidArgument
            If there is no such module, or it cannot be run; the message has its file and line.
        """
        where, _, what = name.partition(":")
        with self.errors(f"{name} cannot be loaded"):
            module = self.module(where) if self._lies_here(where) else self._elsewhere(where)
        found: Any = module
        for part in what.split("."):
            if not hasattr(found, part):
                raise UnknownName(f"name in {_file(module)}", what, _names(module))
            found = getattr(found, part)
        return found

    def module(self, name: str) -> ModuleType:
        """Return the module of that name that lies here; it is run where that has not been done."""
        full = f"{name}__{self.token}"
        with _LOADING:
            if full in sys.modules:
                return sys.modules[full]
            source = self._source(name)
            module = ModuleType(full)
            module.__file__ = source.file
            # So that it finds what lies beside it, and nothing else does.
            vars(module)["__builtins__"] = {**vars(builtins), "__import__": self._import}
            sys.modules[full], self.sources[name], _CODES[self.token] = module, source, self
            self._files.add(source.file)
            try:
                code = compile(source.text, source.file, "exec", dont_inherit=True)
                # For errors and fingerprints, wherever the file is, and whatever it says by then.
                lines = decode_source(source.text).splitlines(keepends=True)
                linecache.cache[source.file] = len(source.text), None, lines, source.file
                exec(code, vars(module))
            except BaseException:
                del sys.modules[full], self.sources[name]
                raise
            return module

    @contextmanager
    def errors(self, doing: str = "") -> Iterator[None]:
        """Tell of errors in these modules in one sentence, with file and line.

        Parameters
        ----------
        doing : str
            What fails, in words that come first; without it, an error from elsewhere is let through.

        Raises
        ------
        InvalidArgument
            If there is one.
        """
        try:
            yield
        except PinmobileError:
            raise
        except (Exception, SystemExit) as error:
            name, place = self._place(error)
            if not place and not doing:
                raise
            doing = doing or name
            said = error.msg if isinstance(error, SyntaxError) else str(error)
            raise InvalidArgument(
                f"{doing and doing + ': '}{place or 'it'} raises {type(error).__name__}{said and ': '}{said}"
            ) from error

    def hidden(self) -> dict[str, str]:
        """Return the files of installed modules that have the name of one that was loaded here."""
        found = {}
        for name, source in self.sources.items():
            with suppress(ValueError):  # of a module that does not say where it is from
                spec = None if "." in name else find_spec(name)
                if spec is not None and spec.origin != source.file:
                    found[name] = spec.origin or "a folder"
        return found

    def _lies_here(self, name: str) -> bool:
        return name in self.sources or (self.folder is not None and self._path(name).is_file())

    def _path(self, name: str) -> Path:
        assert self.folder is not None
        return self.folder.joinpath(*name.split(".")).with_suffix(".py")

    def _source(self, name: str) -> Source:
        if name in self.sources:
            return self.sources[name]
        path = self._path(name)
        try:
            return Source(str(path), path.read_bytes())
        except OSError as error:
            raise cannot("read", f"module {name}", path, error) from error

    def _elsewhere(self, name: str) -> ModuleType:
        try:
            module = import_module(name)
        except ModuleNotFoundError as error:
            top = name.split(".")[0]
            if error.name not in (name, top):
                raise
            there = sorted(path.stem for path in (self.folder or Path()).glob("*.py"))
            raise UnknownName(f"module in {str(self.folder)!r} or installed", name, there) from error
        self.installed[name] = _file(module)
        return module

    def _import(
        self,
        name: str,
        globals: Mapping[str, object] | None = None,
        locals: Mapping[str, object] | None = None,
        fromlist: Sequence[str] = (),
        level: int = 0,
    ) -> ModuleType:
        if level == 0 and (fromlist or "." not in name) and self._lies_here(name):
            return self.module(name)
        return __import__(name, globals, locals, fromlist, level)

    def _place(self, error: BaseException) -> tuple[str, str]:
        """Return where in these modules an error came from: ``module:Class``, and file and line.

        That is the last step in them that led to it; "" where there is none, or it is in no class.
        """
        files = self._files | set(self.installed.values())
        if isinstance(error, SyntaxError) and error.filename in files:
            return "", f"{Path(error.filename).name}:{error.lineno}"
        found = "", ""
        for frame, line in walk_tb(error.__traceback__):
            if frame.f_code.co_filename in files:
                file, (kind, dot, _) = Path(frame.f_code.co_filename), frame.f_code.co_qualname.partition(".")
                found = f"{file.stem}:{kind}" if dot else "", f"{file.name}:{line}"
        return found


_CODES: dict[str, Code] = {}  # by token, those of which this process has run a module


def _file(module: ModuleType) -> str:
    return module.__file__ or module.__name__


def _names(module: ModuleType) -> list[str]:
    """Return the names that a module defines."""

    def own(value: object) -> bool:
        if isinstance(value, FunctionType | type):
            return value.__module__ == module.__name__
        return not isinstance(value, ModuleType) and getattr(value, "__module__", "") != "typing"

    return [name for name, value in vars(module).items() if not name.startswith("_") and own(value)]


@dataclass(frozen=True)
class Packed:
    """A scenario with parts of users' modules, for a process that does not have these.

    Nothing of it is run where it only passes, as in a scheduler.

    Attributes
    ----------
    data : bytes
        The scenario.
    sources : mapping of str to mapping of str to Source
        The modules, by token and name, in the order in which they were run.
    """

    data: bytes
    sources: Mapping[str, Mapping[str, Source]]

    def unpacked(self) -> Scenario:
        """Return the scenario, after running the modules that this process has not run."""
        with _LOADING:
            for token, sources in self.sources.items():
                code = _CODES.setdefault(token, Code(None, token))
                code.sources |= {name: each for name, each in sources.items() if name not in code.sources}
                for name in sources:
                    code.module(name)
            scenario: Scenario = loads(self.data)
            return scenario


def packed(scenario: Scenario) -> Packed | None:
    """Return the scenario with the text of the users' modules that it needs; None where it needs none."""
    if not _CODES:
        return None
    data = imported("cloudpickle").dumps(scenario)
    # The names of modules have the token in them, and a pickle has these names.
    sources = {token: dict(code.sources) for token, code in _CODES.items() if token.encode() in data}
    return Packed(data, sources) if sources else None


def part_of_packed(sent: Packed, start: int, stop: int) -> tuple[dict[str, Array], Part]:
    """Return the draws and records of the robots from `start` to before `stop`, as `part_of` does."""
    return part_of(sent.unpacked(), start, stop)


def is_library(module: ModuleType) -> bool:
    """Return whether a module is of a library whose version is told, or of Python's own."""
    top = module.__name__.split(".")[0]
    if top not in sys.stdlib_module_names:
        return top in _LIBRARIES
    origin = getattr(getattr(sys.modules.get(top), "__spec__", None), "origin", None)
    # A user's file may have the name of a standard module.
    return origin in ("built-in", "frozen") or (
        origin is not None and _STANDARD in Path(origin).parents and "site-packages" not in origin
    )


_Function: TypeAlias = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


def node_of(code: CodeType) -> _Function | str:
    """Return what the source of a function has where it is; in words why not, where there is no such."""
    linecache.checkcache(code.co_filename)
    text = "".join(linecache.getlines(code.co_filename))
    nodes, codes = _parsed(code.co_filename, text)
    if code not in codes:  # typed or made, or of a file that has changed since
        return "it has no source" if not text else "its source is not what runs here"
    places = [((at[0], at[2]), (at[1], at[3])) for at in code.co_positions() if None not in at]
    spans = [place for place in places if place[0] < place[1]]  # Python 3.12 has none of a constant
    found = [node for node in nodes if _is_at(node, code, spans)]
    if not found or (len(found) > 1 and not spans):
        return "its place is not told"
    return max(
        found, key=lambda node: (node.lineno, node.col_offset)
    )  # of lambdas in each other the innermost


def _is_at(node: _Function, code: CodeType, spans: Sequence[tuple[Any, Any]]) -> bool:
    """Return whether a function's code may be that of a node, given from where to where its steps stand."""
    if not isinstance(node, ast.Lambda):
        first = min(each.lineno for each in (node, *node.decorator_list))
        return (first, node.name) == (code.co_firstlineno, code.co_name)
    if not spans:
        return node.lineno == code.co_firstlineno
    body = node.body
    begin, end = (body.lineno, body.col_offset), (body.end_lineno, body.end_col_offset)
    return all(begin <= span[0] and span[1] <= end for span in spans)


@lru_cache(64)
def _parsed(file: str, text: str) -> tuple[list[_Function], frozenset[CodeType]]:
    """Return the functions in the text of a module, and the code of all of them."""
    try:
        tree = ast.parse(text, file)
        code = compile(text, file, "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT, dont_inherit=True)
    except (SyntaxError, ValueError):
        return [], frozenset()
    return [node for node in ast.walk(tree) if isinstance(node, _Function)], frozenset(_codes(code))


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Yield a code object, and those of all functions and classes inside it."""
    yield code
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _codes(inner)


def read_by(function: FunctionType, node: ast.AST) -> Iterator[tuple[str, Any]]:
    """Yield name and value of what a function, with the functions inside it, reads of its surroundings."""
    names = {name for code in _codes(function.__code__) for name in code.co_names}
    space = {name: value for name, value in function.__globals__.items() if name in names}
    cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
    for name, cell in cells.items():
        try:
            space[name] = cell.cell_contents
        except ValueError:
            space[name] = "a cell that is empty"
    # What no text has by its name: the class of super(), and what is private to a class.
    hidden = {(name,) for name in space if name in cells or re.match("_[^_].*__", name)}
    hidden -= {(name,) for name in space if isinstance(space[name], ModuleType)}
    for name, *attributes in sorted(hidden | {chain for chain in _chains(node) if chain[0] in space}):
        value = space[name]
        for attribute in attributes:  # a user's module is not told as a whole
            if not isinstance(value, ModuleType) or is_library(value) or not hasattr(value, attribute):
                break
            value, name = getattr(value, attribute), f"{name}.{attribute}"
        yield name, value
    state = {"defaults": function.__defaults__, "kwdefaults": function.__kwdefaults__}
    yield from ((name, value) for name, value in {**state, "attributes": vars(function)}.items() if value)


def hidden_in(function: FunctionType, node: ast.AST) -> Iterator[str]:
    """Yield in words what in the text of a function may read what is not told."""
    called = {chain[0] for chain in _chains(node)} & (_HIDING - function.__globals__.keys())
    yield from (f"it calls {name}" for name in sorted(called))
    for step in ast.walk(node):
        imported = [each.name for each in step.names] if isinstance(step, ast.Import) else []
        if isinstance(step, ast.ImportFrom):
            imported = ["." * step.level + (step.module or "")]
        for name in imported:
            top = sys.modules.get(name.split(".")[0])  # there is none where it is beside the user's module
            if top is None or not is_library(top):
                yield f"it imports {name} when it is called"


def _chains(node: ast.AST) -> Iterator[tuple[str, ...]]:
    """Yield the names in a text, each with the attributes that are asked of it."""
    attributes: list[str] = []
    while isinstance(node, ast.Attribute):
        attributes.insert(0, node.attr)
        node = node.value
    if isinstance(node, ast.Name):
        yield node.id, *attributes
    for child in ast.iter_child_nodes(node):
        yield from _chains(child)
