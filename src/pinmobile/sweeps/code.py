"""Users' modules that lie beside a file: loaded from there, and from the same text on workers elsewhere."""

from __future__ import annotations

import builtins
import linecache
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from importlib.util import decode_source, find_spec
from pathlib import Path
from pickle import loads
from threading import RLock
from traceback import walk_tb
from types import FunctionType, ModuleType
from typing import Any, NamedTuple
from uuid import uuid4

from pinmobile.arrays import Array
from pinmobile.ensembles import Part, Scenario, part_of
from pinmobile.errors import InvalidArgument, PinmobileError, UnknownName
from pinmobile.files import cannot
from pinmobile.sweeps.grids import imported

_LOADING = RLock()


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
    the same name elsewhere is not hidden from anybody else. Each finds the modules beside it. To load one is
    to run it: ask the user first.

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
        self, name: str, globals: Any = None, locals: Any = None, fromlist: Sequence[str] = (), level: int = 0
    ) -> Any:
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

    def own(value: Any) -> bool:
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
