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

from pinmobile.errors import InvalidArgument, PinmobileError, format_value
from pinmobile.parts._fields import Child, Field, Number, Values, Whole, evolved, fields_of, is_part
from pinmobile.parts._registry import (
    Parameter,
    called,
    expected,
    fits,
    flat,
    is_code,
    is_part_class,
    makes_part,
    name_of,
    names_of,
    nearest,
    nested,
    parameters,
    resolve,
    unreadable,
)
from pinmobile.parts._walk import Leaf, entries_of

_WRONG = object()  # stands for a part that cannot be made
_DEEPEST = 50
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
        self._kept: dict[int, tuple[Any, dict[str, Any]]] = {}  # trees of parts, by id
        self._shared: dict[str, Any] = {}

    def root(self, kind: type, tree: Mapping[str, Any]) -> Any:
        """Return the part of a whole file; its robot is the default of all robots in it.

        Raises
        ------
        InvalidEntries
            If entries are wrong; the message has a line for each.
        """
        given: Any = kind
        known, self._shared = parameters(given), {}
        values: dict[str, Any] = {}
        self._unknown(tree, known, kind, "")
        for name, each in known.items():
            values[name] = _default(each, SimpleNamespace(**values))
            if tree.get(name) is not None:
                values[name] = self._read(each, tree[name], name, values[name])
            if name == "robot":
                self._shared = {"robot": values[name]}
                if is_part(values[name]):
                    self._shared |= {own: value for own, _, value in fields_of(values[name]) if own != name}
        self._raise()
        made = self._made(kind, values, "")
        self._raise()
        return made

    def changed(self, root: Any, changes: Mapping[str, Any], path: str = "") -> Any:
        """Return a part with other values at paths; models of controllers keep the original robot.

        Raises
        ------
        InvalidEntries
            If a value is invalid.
        """
        made = self._changed(root, nested(changes), path)
        self._raise()
        return made

    def _model(self, each: Parameter) -> Any:
        """Return the default of a model: the file's robot, or the part of the robot that fits."""
        robot = self._shared.get("robot")
        if each.name != "robot" or not isinstance(each.declared, Child) or not is_part(robot):
            return self._shared.get(each.name)
        inner = [value for _, declared, value in fields_of(robot) if isinstance(declared, Child)]
        return next((one for one in (robot, *inner) if fits(each.declared.kind, one)), robot)

    def _raise(self) -> None:
        if self.problems:
            raise InvalidEntries(self.problems)

    def _fail(self, path: str, message: str) -> Any:
        self.problems.setdefault(path, message)
        return _WRONG

    def _unknown(self, tree: Any, known: Mapping[str, Any], kind: Any, path: str) -> None:
        for key in tree:
            if key not in known:
                at, takes = _join(path, str(key)), ", ".join(known) or "no fields"
                name = kind.__name__ if path else "a scenario"
                self._fail(at, f"{at} is unknown, {name} has {takes}; {nearest(str(key), known)}")

    def part(self, declared: Child, tree: Any, path: str, base: Any = None) -> Any:
        """Return the part of a tree; `base` is the part that a table without a type changes."""
        if path.count(".") > _DEEPEST:
            return self._fail(path, f"{path} is nested too deep, expected at most {_DEEPEST} levels")
        tree = called(tree) if isinstance(tree, str) else tree
        if not isinstance(tree, Mapping):
            form = expected(declared, one=True)
            return self._fail(path, f"{path} is {format_value(tree)}, expected {form}: its name, or a table")
        tree = dict(tree)
        name = tree.pop("type", None)
        if name is None and (base is _WRONG or (base is None and self._shared.get("robot") is _WRONG)):
            return _WRONG
        if name is None and base is not None:
            return self._changed(base, tree, path)
        make = self._named(declared, name, path)
        if make is _WRONG:
            return make
        is_function = isinstance(make, FunctionType) and not makes_part(make)
        if not callable(make) or is_part(make) or (is_function and not tree):
            return self._changed(make, tree, path) if tree else make
        return self._called(make, str(name), tree, path)

    def _named(self, declared: Child, name: Any, path: str) -> Any:
        """Return the object of a type, if it is allowed here."""
        kind, wanted = declared.kind, expected(declared, one=True)
        if not isinstance(name, str):
            told = f"{path} has the type {format_value(name)}, expected text in quotes"
            return self._fail(path, f"{path} has no type, expected {wanted}" if name is None else told)
        try:
            make = resolve(name, self.folder)
        except InvalidArgument as error:
            return self._fail(_join(path, "type"), f"{path} {error}")
        known = names_of(kind)
        if make is None or not (is_code(name) or is_part_class(make) or is_part(make) or callable(make)):
            why = unreadable(name) or f"expected {wanted}, {nearest(name, known)}"
            return self._fail(_join(path, "type"), f"{path} is {format_value(name)}, {why}")
        # Members that a class takes from another part exist only in its objects.
        is_free = is_code(name) or "__getattr__" in dir(make) or (makes_part(make) and not is_part(make))
        if not is_free and not fits(kind, make):
            told = f"{path} is {name!r}, expected {wanted}, available: {', '.join(known)}"
            return self._fail(_join(path, "type"), told)
        return make

    def _called(self, make: Any, name: str, tree: dict[str, Any], path: str) -> Any:
        """Return the object of a class or constructor with a table; the table may also change fields."""
        known = parameters(make)
        is_class = is_part_class(make)
        tree = {_given(known, key): value for key, value in tree.items()}
        owner = resolve(name.rpartition(".")[0]) if not is_class and not is_code(name) else None
        fields = parameters(owner) if is_part_class(owner) else {}
        others = {
            key: tree.pop(key)
            for key in [*tree]
            if not is_class and _is_change(known, fields, key, tree[key])
        }
        if "**" not in known:
            self._unknown(tree, known, make, path)
        values: dict[str, Any] = {}
        for key, each in known.items():
            at = _join(path, key)
            if tree.get(key) is not None:
                base = _default(each, SimpleNamespace(**values))
                values[key] = self._read(each, tree[key], at, base)
            elif each.is_shared and key in self._shared:
                values[key] = self._model(each)
            elif each.is_required:
                told = f"{at} is missing, expected {expected(each.declared)}{each.doc and ': ' + each.doc}"
                values[key] = self._fail(at, told)
        if "**" in known:
            values |= {key: self._generic(tree[key], _join(path, key)) for key in tree if key not in known}
        made = self._made(make, dict(values), path)
        if others and made is not _WRONG:
            made = self._changed(made, others, path)
        if is_part(made) and (not is_class or is_code(name)):
            self._kept[id(made)] = made, {"type": name, **values, **others}
        return made

    def _made(self, make: Any, values: dict[str, Any], path: str) -> Any:
        if any(value is _WRONG for value in values.values()):
            return _WRONG
        first: list[Any] = []
        names = [] if isinstance(make, partial) else [*parameters(make)]
        for k, key in enumerate(names):
            if parameters(make)[key].is_variadic and key in values:
                more = values.pop(key)
                more = more if isinstance(more, list | tuple) else [more]
                first = [*(values.pop(name) for name in names[:k]), *more]
        try:
            with np.errstate(all="ignore"):  # the part itself rejects overflow
                return make(*first, **values)
        except InvalidArgument as error:
            return self._fail(_join(path, error.argument.partition("[")[0]), f"{path or 'file'}: {error}")
        except (
            TypeError,
            ValueError,
            KeyError,
            OSError,
            AttributeError,
            IndexError,
            ArithmeticError,
        ) as error:
            return self._fail(path, f"{path or 'file'} cannot be made: {error}")

    def _changed(self, base: Any, tree: Mapping[str, Any], path: str) -> Any:
        """Return a part with other values of its fields."""
        if not is_part(base):
            return self._fail(path, f"{path} is {format_value(base)}, which has no fields to change")
        own: Any = type(base)
        known = parameters(own)
        self._unknown(tree, known, type(base), path)
        changes = {
            key: self._read(known[key], sub, _join(path, key), getattr(base, key))
            for key, sub in tree.items()
            if key in known
        }
        if any(value is _WRONG for value in changes.values()) or tree.keys() - known.keys():
            return _WRONG
        new = self._made(partial(evolved, base, changes), {}, path)
        if any(base is one for one in self._shared.values()) and new is not _WRONG and path:
            self._kept[id(new)] = new, changes
        return new

    def _read(self, each: Parameter, tree: Any, path: str, base: Any) -> Any:
        """Return the value of a tree for an argument; `base` is the value without it."""
        declared = each.declared
        if each.is_shared and (base is None or base is attrs.NOTHING):
            base = self._model(each)
        try:
            if isinstance(declared, Child):
                made = (self._many if declared.many else self.part)(declared, tree, path, base)
                return made if made is _WRONG else declared.checked(path, made)
            if isinstance(declared, Number):
                return declared.checked(path, self._numbers(declared, tree, path, base))
            if isinstance(declared, Whole):
                return declared.checked(path, tree)
        except InvalidArgument as error:
            if isinstance(declared, Child):
                return self._fail(path, str(error))
            told = f"{path} is {format_value(tree)}, expected {expected(declared)}"
            return self._fail(path, told)
        if isinstance(declared, Values) and isinstance(tree, Mapping):
            read = {key: self._generic(one, f"{path}.{key}") for key, one in flat(tree).items()}
            return self._all({**(base or {}), **read})
        if declared is None or (isinstance(tree, Mapping) and "type" in tree):
            return self._generic(tree, path)
        if isinstance(tree, Mapping) and is_part(base):
            return self._changed(base, tree, path)
        return self._option(declared, tree, path)

    def _option(self, declared: Field, tree: Any, path: str) -> Any:
        """Return the value of a field that is neither a number nor a part; a name may mean a constant."""
        made = _tuples(tree)
        name = path.rpartition(".")[2]
        try:
            return declared.checked(name, made)
        except InvalidArgument as error:
            is_named = isinstance(tree, str) and (self.folder is not None or not is_code(tree))
            other = resolve(tree, self.folder) if is_named else None
            with contextlib.suppress(InvalidArgument):
                if other is not None:
                    return declared.checked(name, other)
            return self._fail(path, str(error.calling(path)))

    def _many(self, declared: Child, tree: Any, path: str, base: Any) -> Any:
        if isinstance(tree, list | tuple):
            made: Any = [self.part(declared, each, f"{path}.{k}") for k, each in enumerate(tree)]
            return _WRONG if any(each is _WRONG for each in made) else made
        if not isinstance(tree, Mapping) or base is None or base is attrs.NOTHING:
            return self._fail(path, f"{path} is {format_value(tree)}, expected a list, {expected(declared)}")
        known = dict(entries_of(base))
        if not isinstance(base, Mapping) and tree.keys() - known.keys():
            return self._fail(path, f"{path} has {', '.join(known)}, and not {', '.join(tree)}")
        for key, sub in tree.items():
            known[key] = self.part(declared, sub, f"{path}.{key}", known.get(key))
        if any(each is _WRONG for each in known.values()):
            return _WRONG
        return known if isinstance(base, Mapping) else tuple(known.values())

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
        own = declared if not callable(declared.labels) else attrs.evolve(declared, labels=())
        places = Leaf(path, None, own, base).entries
        made = np.array(base, np.float64) if np.ndim(base) else np.full(len(places), float(base))
        for key, value in tree.items():
            _check_plain(path, value)
            if key not in places:
                raise InvalidArgument(f"{path} has no entry {key!r}")
            made[places[key]] = value
        return made

    def _generic(self, tree: Any, path: str) -> Any:
        """Return the value of a tree without a declaration; names of parts become parts."""
        if isinstance(tree, Mapping):
            if "type" in tree:
                return self.part(Child(), tree, path)
            return self._all({key: self._generic(each, f"{path}.{key}") for key, each in tree.items()})
        if isinstance(tree, list | tuple):
            made = self._all({str(k): self._generic(each, f"{path}.{k}") for k, each in enumerate(tree)})
            return made if made is _WRONG else tuple(made.values())
        if isinstance(tree, str):
            name = str(called(tree)["type"])
            found = self.folder if is_code(name) else resolve(name)
            if found is not None and (not isinstance(found, type) or is_part_class(found)):
                return self.part(Child(), tree, path)
        return tree

    def _all(self, made: dict[str, Any]) -> Any:
        return _WRONG if any(each is _WRONG for each in made.values()) else made

    def tree(self, value: Any, path: str = "") -> Any:
        """Return a part as a tree, from which the same part can be read.

        Raises
        ------
        InvalidArgument
            If an object in the part has no text, such as a random number generator.
        """
        if id(value) in self._kept:
            kept = self._kept[id(value)][1]
            return {k: v if k == "type" else self.tree(v, _join(path, k)) for k, v in kept.items()}
        if name := name_of(value) if not isinstance(value, type) else "":
            return name
        if is_part(value):
            own = {"type": name_of(type(value))} if path else {}
            return own | {key: self.tree(each, _join(path, key)) for key, each in self._written(value, path)}
        if isinstance(value, Mapping):
            return {key: self.tree(each, _join(path, str(key))) for key, each in value.items()}
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        if isinstance(value, list | tuple):
            return [self.tree(each, f"{path}.{k}") for k, each in enumerate(value)]
        if isinstance(value, str | bool | int | float):
            return value
        raise InvalidArgument(f"{path} is {format_value(value)}, which a file cannot contain: use Python")

    def _written(self, part: Any, path: str) -> Iterator[tuple[str, Any]]:
        """Yield the fields that a file states with their values, without models equal to the file's robot."""
        own: Any = type(part)
        known = parameters(own)
        is_model = path and path.split(".")[0] != "robot"
        for key, declared, value in fields_of(part):
            is_shared = is_model and (key == "robot" or isinstance(declared, Child))
            if value is None or key[:1] == "_" or (is_shared and value is self._model(known[key])):
                continue
            default = known[key].default
            is_derived = isinstance(default, attrs.Factory) and default.takes_self  # type: ignore[arg-type]
            usual = _default(known[key], part if path else SimpleNamespace())
            is_derived = is_derived and bool(path)
            is_empty = isinstance(value, tuple | dict) and not value
            is_stated = isinstance(declared, Number | Whole | Child) and not (is_derived or is_empty)
            if is_stated or not _is_same(value, usual):
                yield key, value


def _given(known: Mapping[str, Parameter], key: str) -> str:
    """Return the name of an argument that the text gives by position."""
    word, _, number = key.partition(" ")
    at = int(number) - 1 if word == "argument" and number.isdigit() else len(known)
    return [*known, key][min(at, len(known))]


def _is_change(known: Mapping[str, Parameter], fields: Collection[str], key: str, tree: Any) -> bool:
    """Return whether an entry of a constructor's table changes a field of the constructed part."""
    each = known.get(key)
    is_table = isinstance(tree, Mapping) and "type" not in tree
    is_free = each is None or each.declared is None
    return ("**" not in known and each is None) or (is_table and is_free and key in fields)


def _is_same(value: Any, default: Any) -> bool:
    with contextlib.suppress(Exception):
        return value is default or bool(np.array_equal(value, default))
    return False


def _default(each: Parameter, owner: Any) -> Any:
    default = each.default
    if isinstance(default, attrs.Factory):  # type: ignore[arg-type]
        factory: Callable[..., Any] = default.factory
        with contextlib.suppress(Exception):  # another field may be wrong
            return factory(owner) if default.takes_self else factory()
        return None
    return None if default is attrs.NOTHING else default


def _check_plain(path: str, value: Any) -> None:
    """Reject text and truth values among numbers."""
    for each in value if isinstance(value, list | tuple) else (value,):
        if isinstance(each, list | tuple):
            _check_plain(path, each)
        elif isinstance(each, str | bool | Mapping):
            raise InvalidArgument(f"{path} is {format_value(value)}, expected numbers")


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path and key else path or key
