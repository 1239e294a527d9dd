"""Parts as trees of plain values, and parts from such trees, for files, commands and grids."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import FunctionType, SimpleNamespace
from typing import Any

import attrs
import numpy as np

from pinmobile.errors import InvalidArgument, PinmobileError, format_value, unexpected_value
from pinmobile.parts._fields import Child, Field, Number, Values, Whole, evolved, fields_of, is_part
from pinmobile.parts._registry import (
    Parameter,
    fits,
    flatten,
    is_code,
    is_part_class,
    make_tree,
    makes_part,
    name_of,
    names_of,
    parameters,
    read_call,
    requirement,
    resolve,
    suggest_name,
    syntax_problem,
)
from pinmobile.parts._walk import Leaf, entries_of

_INVALID = object()  # stands for a part that cannot be made
_FAILURES = TypeError, ValueError, LookupError, OSError, AttributeError, ArithmeticError, PinmobileError
_NONE: Mapping[str, Any] = {}


class InvalidEntries(InvalidArgument):
    """Error of a file or a command, with all wrong entries.

    Attributes
    ----------
    problems : dict of str to str
        Messages by path.
    """

    def __init__(self, problems: Mapping[str, str]) -> None:
        super().__init__("\n".join(problems.values()), "")
        self.problems = dict(problems)


class Reader:
    """Reader that makes parts from trees and collects their errors.

    Parameters
    ----------
    folder : Path, optional
        Folder of users' modules; None: they must not run.

    Attributes
    ----------
    problems : dict of str to str
        Messages by path.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self.problems: dict[str, str] = {}
        self._sources: dict[int, tuple[Any, dict[str, Any]]] = {}  # trees of parts, by id
        self._defaults: dict[str, Any] = {}

    def root(self, kind: type, tree: Mapping[str, Any]) -> Any:
        """Return the part of a whole file; its robot is the default of all robots in it.

        Raises
        ------
        InvalidEntries
            If entries are wrong; the message has a line for each.
        """
        constructor: Any = kind
        arguments, self._defaults = parameters(constructor), {}
        values: dict[str, Any] = {}
        self._check_keys(tree, arguments, kind, "")
        for name, argument in arguments.items():
            values[name] = _default(argument, SimpleNamespace(**values))
            if tree.get(name) is not None:
                values[name] = self._read(argument, tree[name], name, values[name])
            if name == "robot":
                self._defaults = {"robot": values[name]}
                if is_part(values[name]):
                    self._defaults |= {f: value for f, _, value in fields_of(values[name]) if f != name}
        self._raise()
        part = self._make(kind, values, "")
        self._raise()
        return part

    def change(self, root: Any, changes: Mapping[str, Any]) -> Any:
        """Return a part with other values at paths; models of controllers keep the original robot.

        Raises
        ------
        InvalidEntries
            If a value is invalid.
        """
        part = self._change(root, make_tree(changes), "")
        self._raise()
        return part

    def _model(self, argument: Parameter) -> Any:
        """Return the default of a model: the file's robot, or the part of the robot that fits."""
        robot = self._defaults.get("robot")
        if argument.name != "robot" or not isinstance(argument.declared, Child) or not is_part(robot):
            return self._defaults.get(argument.name)
        inner = [value for _, field, value in fields_of(robot) if isinstance(field, Child)]
        return next((part for part in (robot, *inner) if fits(argument.declared.kind, part)), robot)

    def _raise(self) -> None:
        if self.problems:
            raise InvalidEntries(self.problems)

    def _fail(self, path: str, message: str) -> Any:
        self.problems.setdefault(path, message)
        return _INVALID

    def _check_keys(self, tree: Any, names: Mapping[str, Any], kind: Any, path: str) -> None:
        for key in tree:
            if key not in names:
                place, takes = _join(path, str(key)), ", ".join(names) or "no fields"
                owner = f"{kind.__name__} has" if path else "available:"
                advice = suggest_name(str(key), names)
                advice = f"; {advice}" * (bool(path) or not advice.startswith("available"))
                self._fail(place, f"{place} is unknown, {owner} {takes}{advice}")

    def part(self, field: Child, tree: Any, path: str, base: Any = None) -> Any:
        """Return the part of a tree; `base` is the part that a table without a type changes."""
        tree = read_call(tree) if isinstance(tree, str) else tree
        if not isinstance(tree, Mapping):
            form = requirement(field, one=True)
            return self._fail(path, f"{path} is {format_value(tree)}, expected {form}: its name, or a table")
        tree = dict(tree)
        name = tree.pop("type", None)
        if name is None and (base is _INVALID or (base is None and self._defaults.get("robot") is _INVALID)):
            return _INVALID
        if name is None and base is not None:
            return self._change(base, tree, path)
        make = self._resolve(field, name, path)
        if make is _INVALID:
            return make
        is_function = isinstance(make, FunctionType) and not makes_part(make)
        if not callable(make) or is_part(make) or (is_function and not tree):
            return self._change(make, tree, path) if tree else make
        return self._construct(make, str(name), tree, path)

    def _resolve(self, field: Child, name: Any, path: str) -> Any:
        """Return the object of a type, if it is allowed here."""
        kind, words = field.kind, requirement(field, one=True)
        if not isinstance(name, str):
            message = f"{path} has the type {format_value(name)}, expected text in quotes"
            return self._fail(path, f"{path} has no type, expected {words}" if name is None else message)
        try:
            make = resolve(name, self.folder)
        except InvalidArgument as error:
            return self._fail(_join(path, "type"), f"{path} {error}")
        names = names_of(kind)
        if make is None or not (is_code(name) or is_part_class(make) or is_part(make) or callable(make)):
            reason = syntax_problem(name) or f"expected {words}, {suggest_name(name, names)}"
            return self._fail(_join(path, "type"), f"{path} is {format_value(name)}, {reason}")
        # Members that a class takes from another part exist only in its objects.
        is_free = is_code(name) or "__getattr__" in dir(make) or (makes_part(make) and not is_part(make))
        if not is_free and not fits(kind, make):
            message = f"{path} is {name!r}, expected {words}, available: {', '.join(names)}"
            return self._fail(_join(path, "type"), message)
        return make

    def _construct(self, make: Any, name: str, tree: dict[str, Any], path: str) -> Any:
        """Return the object of a class or constructor with a table; the table may also change fields."""
        args = parameters(make)
        is_class = is_part_class(make)
        tree = {_argument_name(args, key): value for key, value in tree.items()}
        owner = resolve(name.rpartition(".")[0]) if not is_class and not is_code(name) else None
        fields = parameters(owner) if is_part_class(owner) else {}
        changes = {
            key: tree.pop(key) for key in [*tree] if not is_class and _is_change(args, fields, key, tree[key])
        }
        if "**" not in args:
            self._check_keys(tree, args, make, path)
        values: dict[str, Any] = {}
        for key, arg in args.items():
            place = _join(path, key)
            if tree.get(key) is not None:
                base = _default(arg, SimpleNamespace(**values))
                values[key] = self._read(arg, tree[key], place, base)
            elif arg.is_shared and key in self._defaults:
                values[key] = self._model(arg)
            elif arg.is_required:
                text = f"{place} is missing, expected {requirement(arg.declared)}{arg.doc and ': ' + arg.doc}"
                values[key] = self._fail(place, text)
        if "**" in args:
            values |= {key: self._generic(tree[key], _join(path, key)) for key in tree if key not in args}
        part = self._make(make, dict(values), path)
        if changes and part is not _INVALID:
            part = self._change(part, changes, path)
        if is_part(part) and (not is_class or is_code(name)):
            self._sources[id(part)] = part, {"type": name, **values, **changes}
        return part

    def _make(self, make: Any, values: dict[str, Any], path: str) -> Any:
        if any(value is _INVALID for value in values.values()):
            return _INVALID
        positional: list[Any] = []
        names = [] if isinstance(make, partial) else [*parameters(make)]
        for k, key in enumerate(names):
            if parameters(make)[key].is_variadic and key in values:
                rest = values.pop(key)
                rest = rest if isinstance(rest, list | tuple) else [rest]
                positional = [*(values.pop(name) for name in names[:k]), *rest]
        try:
            with np.errstate(all="ignore"):  # the part itself rejects overflow
                return make(*positional, **values)
        except InvalidArgument as error:
            return self._fail(_join(path, error.argument.partition("[")[0]), f"{path or 'file'}: {error}")
        except _FAILURES as error:
            known = ", ".join(name for name in names if name != "**")
            words = f"; expected {known}" if "unexpected keyword" in str(error) else ""
            return self._fail(path, f"{path or 'file'} cannot be made: {error}{words}")

    def _change(self, base: Any, tree: Mapping[str, Any], path: str) -> Any:
        """Return a part with other values of its fields."""
        if not is_part(base):
            return self._fail(path, f"{path} is {format_value(base)}, which has no fields to change")
        kind: Any = type(base)
        arguments = parameters(kind)
        self._check_keys(tree, arguments, type(base), path)
        changes = {
            key: self._read(arguments[key], branch, _join(path, key), getattr(base, key))
            for key, branch in tree.items()
            if key in arguments
        }
        if any(value is _INVALID for value in changes.values()) or tree.keys() - arguments.keys():
            return _INVALID
        new = self._make(partial(evolved, base, changes), {}, path)
        if any(base is shared for shared in self._defaults.values()) and new is not _INVALID and path:
            self._sources[id(new)] = new, changes
        return new

    def _read(self, argument: Parameter, tree: Any, path: str, base: Any) -> Any:
        """Return the value of a tree for an argument; `base` is the value without it."""
        field = argument.declared
        if argument.is_shared and (base is None or base is attrs.NOTHING):
            base = self._model(argument)
        try:
            if isinstance(field, Child):
                value = (self._read_many if field.many else self.part)(field, tree, path, base)
                return value if value is _INVALID else field.convert(path, value)
            if isinstance(field, Number):
                return field.convert(path, self._numbers(field, tree, path, base))
            if isinstance(field, Whole):
                return field.convert(path, tree)
        except InvalidArgument as error:
            if isinstance(field, Child):
                return self._fail(path, str(error))
            message = f"{path} is {format_value(tree)}, expected {requirement(field)}"
            return self._fail(path, message)
        if isinstance(field, Values) and isinstance(tree, Mapping):
            values = {key: self._generic(item, f"{path}.{key}") for key, item in flatten(tree).items()}
            return self._check_all({**(base or {}), **values})
        if field is None or (isinstance(tree, Mapping) and "type" in tree):
            return self._generic(tree, path)
        if isinstance(tree, Mapping) and is_part(base):
            return self._change(base, tree, path)
        return self._option(field, tree, path)

    def _option(self, field: Field, tree: Any, path: str) -> Any:
        """Return the value of a field that is neither a number nor a part; a name may mean a constant."""
        value = _tuples(tree)
        name = path.rpartition(".")[2]
        try:
            return field.convert(name, value)
        except InvalidArgument as error:
            is_named = isinstance(tree, str) and (self.folder is not None or not is_code(tree))
            constant = resolve(tree, self.folder) if is_named else None
            with contextlib.suppress(InvalidArgument):
                if constant is not None:
                    return field.convert(name, constant)
            return self._fail(path, str(error.calling(path)))

    def _read_many(self, field: Child, tree: Any, path: str, base: Any) -> Any:
        if isinstance(tree, list | tuple):
            parts: Any = [self.part(field, item, f"{path}.{k}") for k, item in enumerate(tree)]
            return _INVALID if any(item is _INVALID for item in parts) else parts
        if not isinstance(tree, Mapping) or base is None or base is attrs.NOTHING:
            return self._fail(path, f"{path} is {format_value(tree)}, expected a list, {requirement(field)}")
        children = dict(entries_of(base))
        if not isinstance(base, Mapping) and tree.keys() - children.keys():
            return self._fail(path, f"{path} has {', '.join(children)}, and not {', '.join(tree)}")
        for key, branch in tree.items():
            children[key] = self.part(field, branch, f"{path}.{key}", children.get(key))
        if any(item is _INVALID for item in children.values()):
            return _INVALID
        return children if isinstance(base, Mapping) else tuple(children.values())

    def _numbers(self, declared: Number, tree: Any, path: str, base: Any) -> Any:
        """Return numbers; a table changes some entries, by label or by index."""
        if not isinstance(tree, Mapping):
            _check_plain(path, tree)
            return tree
        tree = dict(tree)
        base = tree.pop("", base)
        _check_plain(path, base)
        if base is None:
            raise InvalidArgument(f"{path} has no entries to change")
        field = declared if not callable(declared.labels) else attrs.evolve(declared, labels=())
        indices = Leaf(path, None, field, base).entries
        numbers = np.array(base, np.float64) if np.ndim(base) else np.full(len(indices), float(base))
        for key, value in tree.items():
            _check_plain(path, value)
            if key not in indices:
                raise InvalidArgument(f"{path} has no entry {key!r}")
            numbers[indices[key]] = value
        return numbers

    def _generic(self, tree: Any, path: str) -> Any:
        """Return the value of a tree without a declaration; names of parts become parts."""
        if isinstance(tree, Mapping):
            if "type" in tree:
                return self.part(Child(), tree, path)
            return self._check_all({key: self._generic(x, f"{path}.{key}") for key, x in tree.items()})
        if isinstance(tree, list | tuple):
            values = self._check_all({str(k): self._generic(x, f"{path}.{k}") for k, x in enumerate(tree)})
            return values if values is _INVALID else tuple(values.values())
        if isinstance(tree, str):
            name = str(read_call(tree)["type"])
            target = self.folder if is_code(name) else resolve(name)
            if target is not None and (not isinstance(target, type) or is_part_class(target)):
                return self.part(Child(), tree, path)
        return tree

    def _check_all(self, values: dict[str, Any]) -> Any:
        return _INVALID if any(value is _INVALID for value in values.values()) else values

    def tree(self, value: Any, path: str = "") -> Any:
        """Return a part as a tree, from which the same part can be read.

        Raises
        ------
        InvalidArgument
            If an object in the part has no text, such as a random number generator.
        """
        if id(value) in self._sources:
            source = self._sources[id(value)][1]
            return {k: v if k == "type" else self.tree(v, _join(path, k)) for k, v in source.items()}
        if name := name_of(value) if not isinstance(value, type) else "":
            return name
        if is_part(value):
            head = {"type": name_of(type(value))} if path else {}
            return head | {key: self.tree(x, _join(path, key)) for key, x in self._stated_fields(value, path)}
        if isinstance(value, Mapping):
            return {key: self.tree(x, _join(path, str(key))) for key, x in value.items()}
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        if isinstance(value, list | tuple):
            return [self.tree(x, f"{path}.{k}") for k, x in enumerate(value)]
        if isinstance(value, str | bool | int | float):
            return value
        raise InvalidArgument(f"{path} is {format_value(value)}, which a file cannot contain: use Python")

    def _stated_fields(self, part: Any, path: str) -> Iterator[tuple[str, Any]]:
        """Yield the fields that a file states with their values, without models equal to the file's robot."""
        kind: Any = type(part)
        arguments = parameters(kind)
        is_model = path and path.split(".")[0] != "robot"
        for key, field, value in fields_of(part):
            is_shared = is_model and (key == "robot" or isinstance(field, Child))
            if value is None or key[:1] == "_" or (is_shared and value is self._model(arguments[key])):
                continue
            default = arguments[key].default
            is_derived = isinstance(default, attrs.Factory) and default.takes_self  # type: ignore[arg-type]
            default_value = _default(arguments[key], part if path else SimpleNamespace())
            is_derived = is_derived and bool(path)
            is_empty = isinstance(value, tuple | dict) and not value
            is_stated = isinstance(field, Number | Whole | Child) and not (is_derived or is_empty)
            if is_stated or not _is_same(value, default_value):
                yield key, value


def _argument_name(arguments: Mapping[str, Parameter], key: str) -> str:
    """Return the name of an argument that the text gives by position."""
    word, _, number = key.partition(" ")
    index = int(number) - 1 if word == "argument" and number.isdigit() else len(arguments)
    return [*arguments, key][min(index, len(arguments))]


def _is_change(arguments: Mapping[str, Parameter], fields: Collection[str], key: str, tree: Any) -> bool:
    """Return whether an entry of a constructor's table changes a field of the constructed part."""
    argument = arguments.get(key)
    is_table = isinstance(tree, Mapping) and "type" not in tree
    is_free = argument is None or argument.declared is None
    return ("**" not in arguments and argument is None) or (is_table and is_free and key in fields)


def _is_same(value: Any, default: Any) -> bool:
    with contextlib.suppress(Exception):
        return value is default or bool(np.array_equal(value, default))
    return False


def _default(argument: Parameter, owner: Any) -> Any:
    default = argument.default
    if isinstance(default, attrs.Factory):  # type: ignore[arg-type]
        factory: Callable[..., Any] = default.factory
        with contextlib.suppress(Exception):  # another field may be wrong
            return factory(owner) if default.takes_self else factory()
        return None
    return None if default is attrs.NOTHING else default


def _check_plain(path: str, value: Any) -> None:
    """Reject text and truth values among numbers."""
    for item in value if isinstance(value, list | tuple) else (value,):
        if isinstance(item, list | tuple):
            _check_plain(path, item)
        elif isinstance(item, str | bool | Mapping):
            raise unexpected_value(path, value, "numbers")


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path and key else path or key
