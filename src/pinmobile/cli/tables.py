"""The tables of a scenario file: where they stand in its text, and what parts they name."""

import inspect
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, TypeGuard

from pinmobile import InvalidArgument, PinmobileError, UnknownName, controllers, forces, paths
from pinmobile.cli.choices import (
    BELIEVED,
    BODY,
    CONTROLLERS,
    INTEGRATORS,
    OF_PARTS,
    OF_SPEEDS,
    OPTIONS,
    PATHS,
    ROBOTS,
)
from pinmobile.cli.options import Options, Refused, choose, controller_of, path_of, plant_of
from pinmobile.errors import shown

Table = Mapping[str, Any]


def line(text: str, table: str, key: str | None = None) -> int:
    """Return the line of a table or of a key in it: the parser of TOML does not tell."""
    where, header = "", 1
    for number, row in enumerate(text.splitlines(), start=1):
        if found := re.match(r"\s*\[\s*([^\]]+?)\s*\]", row):
            where = found[1]
            if where.split(".")[0] == table:
                header = number
                if key is None or where == f"{table}.{key}":
                    return number
            continue
        name = row.split("=")[0].strip().replace('"', "").replace("'", "") if "=" in row else ""
        full = f"{where}.{name}" if where else name
        wanted = table if key is None else f"{table}.{key}"
        if full == wanted or full.startswith(f"{wanted}."):
            return number
    return header


def line_of_syntax(message: str, text: str) -> tuple[int, str]:
    """Return the line of a message of the parser, and the message without it."""
    found = re.search(r" \(at line (\d+), column (\d+)\)", message)
    if found is None:
        return max(1, len(text.splitlines())), message
    return int(found[1]), message[: found.start()]


def line_of(error: PinmobileError, text: str, tree: Table, swept: Table) -> int:
    """Return the line of what an error is about; 0 where it cannot be told.

    That is where its argument stands, or the name that is not known.

    Parameters
    ----------
    error : PinmobileError
        What was raised.
    text : str
        The file.
    tree : mapping
        The tables, without what is swept.
    swept : mapping
        What is swept, by dotted names.
    """
    if isinstance(error, UnknownName):
        return _line_of_name(error.name, text, tree, swept)
    told: BaseException | None = error
    if not isinstance(error, Refused) and isinstance(error.__cause__, InvalidArgument):
        told = error.__cause__  # which a grid has told of, and for which values it was
    argument = told.argument if isinstance(told, InvalidArgument) else ""
    # Of the argument spread['mass'].factor it is the key spread.mass; a user's part names itself: parts:Gust.
    place = told.place if isinstance(told, Refused) else ".".join(re.findall(r"\w+", argument))
    return _line_of_place(place, text, tree, swept) or _line_of_name(
        argument.rstrip(":"), text, tree, swept, among_keys=False
    )


def _line_of_place(place: str, text: str, tree: Table, swept: Table) -> int:
    """Return the line of a dotted name such as ``forces.wind.force``, or of what it stands in, else 0.

    The name of a key alone will do, too.
    """
    if place in swept:
        return line(text, "grid", place)
    table, *keys = place.split(".")
    for n in range(len(keys), 0, -1):
        dotted = ".".join((table, *keys[:n]))
        among = [line(text, "grid", name) for name in swept if f"{name}.".startswith(f"{dotted}.")]
        at = line(text, table, ".".join(keys[:n]))
        if among and (n == len(keys) or at == line(text, table)):
            return among[0]
        if at > line(text, table):  # a row of its own; within a table on one line, that of the table
            return at
    if table in tree:
        return line(text, table)
    for name in swept:
        if table in name.split("."):
            return line(text, "grid", name)
    return next((line(text, where, table) for where, content in tree.items() if table in content), 0)


def _line_of_name(name: object, text: str, tree: Table, swept: Table, *, among_keys: bool = True) -> int:
    """Return the line of a name that is a value somewhere, or one of the keys, else 0."""
    for where, values in swept.items():
        if _holds(values, name):
            return line(text, "grid", where)
    for table, content in tree.items():
        for key, value in leaves(content):
            if (among_keys and f".{name}." in f".{key}.") or _holds(value, name):
                return _line_of_place(f"{table}.{key}", text, tree, swept)
    for where in swept:
        if among_keys and name in where.split("."):
            return line(text, "grid", where)
    return 0


def leaves(tree: Table, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield what tables hold that is no table, by dotted names."""
    for key, value in tree.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, Mapping):
            yield from leaves(value, name)
        else:
            yield name, value


def _holds(value: object, name: object) -> bool:
    if isinstance(value, Mapping):
        return name in value or any(_holds(part, name) for part in value.values())
    if isinstance(value, list):
        return any(_holds(part, name) for part in value)
    # Of a user's part, the module and the name in it are looked for, too.
    return bool(value == name) or (isinstance(value, str) and name in value.split(":"))


def _parameters(make: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(make).parameters
    except (ValueError, TypeError):  # as of some that are built in
        return {"arguments": inspect.Parameter("arguments", inspect.Parameter.VAR_KEYWORD)}


def _takes(parameters: Mapping[str, inspect.Parameter], key: str) -> bool:
    if any(each.kind is each.VAR_KEYWORD for each in parameters.values()):
        return True
    return key in parameters and parameters[key].kind in (
        inspect.Parameter.POSITIONAL_OR_KEYWORD,
        inspect.Parameter.KEYWORD_ONLY,
    )


def _short(kind: type) -> str:
    """Return the short name of a class: ``"noisy-measurement"`` of NoisyMeasurement; not Force or Path."""
    name = kind.__name__.removesuffix("Force").removesuffix("Path")
    return "-".join(re.findall(r"[A-Z]+(?![a-z])|[A-Z][a-z]+", name)).lower()


def _classes(package: ModuleType, wanted: Callable[[type], bool]) -> dict[str, Callable[..., Any]]:
    """Return the classes of a package that are wanted, by short names; protocols are none."""
    kinds = [getattr(package, name) for name in package.__all__]
    real = [kind for kind in kinds if isinstance(kind, type) and not getattr(kind, "_is_protocol", False)]
    return {_short(kind): kind for kind in real if wanted(kind)}


Parts = Mapping[str, Callable[..., Any]]
WRAPPERS: Parts = _classes(
    controllers, lambda kind: "controller" in _parameters(kind) and "robot" not in _parameters(kind)
)
OF_LAWS: Parts = _classes(
    controllers,
    lambda kind: (
        {"law", "robot"} <= _parameters(kind).keys() or {"lowest", "hold"} <= _parameters(kind).keys()
    ),
)
"""Controllers of what rolls: around a kinematic law, and those that excite."""
LAWS: Parts = _classes(controllers, lambda kind: hasattr(kind, "check") and "robot" not in _parameters(kind))
FORCES: Parts = _classes(forces, lambda kind: True)
ROUTES: Parts = _classes(
    paths, lambda kind: hasattr(kind, "duration") and bool({"path", "paths"} & _parameters(kind).keys())
)
"""Paths that are made of paths."""
STEPS: Parts = {name: partial(lambda step: step, step) for name, step in INTEGRATORS.items()}
NONE: Parts = {}
_NAMED = ("type", *OF_PARTS)  # keys whose text names a part
_REFERENCE = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*")
_PLACES = {"path": "trajectory", **{name: OPTIONS[name].place for name in OF_PARTS}}


def is_code(name: object) -> TypeGuard[str]:
    """Return whether a text names what is in a user's module."""
    return isinstance(name, str) and ":" in name


def code_in(key: str, value: object) -> Iterator[str]:
    """Yield the names of users' parts in a value of a key, whatever it holds."""
    if key in _NAMED and is_code(value):
        yield value
    for inner, part in value.items() if isinstance(value, Mapping) else ():
        yield from code_in(inner, part)
    for part in value if isinstance(value, list) else ():
        yield from code_in(key, part)


def _place(kind: str) -> str:
    """Return where a kind of part stands in the file: ``"loop.integrator"`` of ``"integrator"``."""
    first, dot, rest = kind.partition(".")
    return f"{_PLACES.get(first, first)}{dot}{rest}"


@contextmanager
def _naming(kind: str, keys: Table) -> Iterator[None]:
    """Let errors about a part say where it stands; of one within others, its keys with their dotted names."""
    try:
        yield
    except Refused:
        raise
    except InvalidArgument as error:
        key = error.argument.removeprefix(f"{kind}.")
        if key not in keys:
            raise Refused(str(error), f"{_place(kind)}.type") from error
        told = f"{kind}.{key}" if "." in kind else error.argument
        raise Refused(str(error.calling(told)), f"{_place(kind)}.{key}") from error


@dataclass(frozen=True)
class _Offered:
    """What a table within a table may name of what the command offers, by the options that it takes.

    Attributes
    ----------
    kind : str
        Which part the inner table is, such as ``"controller.controller"``.
    option : str
        The option whose value is `name`: ``"controller"``, ``"robot"`` or ``"trajectory"``.
    name : str
        What is named.
    takes : sequence of str
        The options that it takes.
    make : callable
        What makes it of `Options`.
    """

    kind: str
    option: str
    name: str
    takes: tuple[str, ...]
    make: Callable[[Options], Any]

    @property
    def __signature__(self) -> inspect.Signature:
        return inspect.Signature(
            [inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=None) for key in self.takes]
        )

    def __call__(self, **given: object) -> Any:
        options = {self.option: self.name, **given}
        return self.make(
            Options(
                options,
                lambda name: f"{self.kind}.{name}" if name in self.takes else name,
                lambda name: f"{_place(self.kind)}.{name}",
            )
        )


class Code:
    """The modules beside a file, imported by name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def named(self, name: str) -> Any:
        """Return the object that ``"module:Name"`` names."""
        where, _, what = name.partition(":")
        with self.errors(f"{name} cannot be loaded"):
            sys.path.insert(0, str(self.folder))
            try:
                module = import_module(where)
            finally:
                sys.path.remove(str(self.folder))
        if not hasattr(module, what):
            raise UnknownName(f"name in {module.__file__}", what, vars(module))
        return getattr(module, what)

    @contextmanager
    def errors(self, doing: str) -> Iterator[None]:
        """State an error of these modules in one sentence."""
        try:
            yield
        except PinmobileError:
            raise
        except Exception as error:
            raise InvalidArgument(f"{doing}: it raises {type(error).__name__}: {error}") from error


class Maker:
    """Makes the parts that tables name: the library's by short names, users' as ``module:Name``.

    Parameters
    ----------
    code : Code or None
        The users' modules; None where they must not be run.
    """

    def __init__(self, code: Code | None) -> None:
        self.code = code

    def part(
        self,
        kind: str,
        given: object,
        available: Parts,
        *,
        beside: Table = NONE,
        first: object = None,
        taken: set[str] | None = None,
    ) -> Any:
        """Return the part that a name, or a table with a ``type``, stands for.

        Parameters
        ----------
        kind : str
            What it is, such as ``"controller"``.
        given : str or mapping
            The name, or the table, whose other keys are the arguments of its class.
        available : mapping of str to callable
            The library's, by short names.
        beside : mapping of str to object
            What it gets besides where its class takes an argument of that name that the table does not have.
        first : object, optional
            Its first argument.
        taken : set of str, optional
            Where several types share a table: takes the keys that this one takes; others are left out.

        Raises
        ------
        UnknownName, Refused
            If there is no such part, or it takes other arguments.
        """
        keys = dict(given) if isinstance(given, Mapping) else {"type": given}
        with _naming(kind, keys):
            if "type" not in keys:
                raise InvalidArgument(f"{kind} is {shown(given)}, a table without type, expected type = NAME")
            name = keys.pop("type")
            if not isinstance(name, str):
                raise InvalidArgument(f"{kind} has the type {name!r}, expected text in quotes")
            make = self._users(name) if is_code(name) else choose(kind, name, available)
            if is_code(name) and not inspect.isclass(make):
                if taken is None and keys:
                    raise InvalidArgument(
                        f"{name} is {shown(make)}, no class, which takes no arguments, but "
                        f"{next(iter(keys))} is given"
                    )
                return make
            parameters = _parameters(make)
            if taken is not None:
                keys = {key: value for key, value in keys.items() if _takes(parameters, key)}
                taken |= set(keys)
            arguments = {key: self._value(f"{kind}.{key}", value, beside) for key, value in keys.items()}
            more = {key: value for key, value in beside.items() if key in parameters and key not in arguments}
            if first is not None and parameters:
                more = {next(iter(parameters)): first, **more}
            return self._called(name, make, parameters, {**more, **arguments})

    def _users(self, name: str) -> Any:
        if not _REFERENCE.fullmatch(name):
            raise InvalidArgument(f"{name!r} names no part, expected 'module:Name'")
        if self.code is None:
            raise InvalidArgument(f"{name} is code, which is not allowed to run")
        return self.code.named(name)

    def _called(
        self,
        name: str,
        make: Callable[..., Any],
        parameters: Mapping[str, inspect.Parameter],
        arguments: Mapping[str, object],
    ) -> Any:
        takes = ", ".join(parameters) or "nothing"
        for key in arguments:
            if not _takes(parameters, key):
                raise UnknownName(f"argument of {name}", key, parameters)
        for key, parameter in parameters.items():
            variadic = parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
            if key not in arguments and parameter.default is parameter.empty and not variadic:
                raise InvalidArgument(f"{name} lacks {key!r}, expected a key of that name; it takes {takes}")
        if self.code is None:
            return make(**arguments)
        with self.code.errors(f"{name} cannot be made"):
            return make(**arguments)

    def _value(self, kind: str, value: object, beside: Table) -> object:
        """Return an argument: a table with a type is a part, and others may hold such."""
        if isinstance(value, Mapping):
            if "type" in value:
                return self.part(kind, value, _library(kind, beside), beside=beside)
            return {key: self._value(f"{kind}.{key}", part, beside) for key, part in value.items()}
        return [self._value(kind, part, beside) for part in value] if isinstance(value, list) else value


def _library(kind: str, beside: Table) -> Parts:
    """Return all parts of the library that a table within a table may name."""
    found: dict[str, Callable[..., Any]] = {**WRAPPERS, **OF_LAWS, **LAWS, **FORCES, **STEPS, **ROUTES}
    found |= OF_SPEEDS
    for name in ROBOTS:
        found[name] = _Offered(kind, "robot", name, BODY, plant_of)
    for name, path in PATHS.items():
        found[name] = _Offered(kind, "trajectory", name, (*path.takes, "moved"), path_of)
    make = partial(controller_of, plant=beside.get("robot"))
    for name, law in CONTROLLERS.items():
        takes = (*law.takes, *(BELIEVED if law.believes else ()))
        found[name] = _Offered(kind, "controller", name, takes, make)
    return found
