"""Walk over the fields of parts: replacement by path, numbers by name, tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from operator import attrgetter
from typing import Any, NamedTuple, TypeVar

import attrs
import numpy as np

from pinmobile.errors import InvalidArgument, UnknownName
from pinmobile.parts._fields import Child, Field, Number, _Option, evolved, fields_of, is_part, unit_of

_T = TypeVar("_T")
_NEAR = 0.8  # least similarity of a misspelt last word


class Leaf(NamedTuple):
    """Field that is not a part.

    Attributes
    ----------
    path : str
        Path, such as ``"controller.robot.mass"``.
    owner : part
        Part with this field.
    declared : Field
        Declaration of the field.
    value : any
        Value of the field.
    """

    path: str
    owner: Any
    declared: Field
    value: Any

    @property
    def entries(self) -> dict[str, tuple[int, ...]]:
        """Indices of the entries by label, for an array, or for a gain that may become an array."""
        labels = getattr(self.declared, "labels", ())
        names = tuple(labels(self.owner) if callable(labels) else labels)
        shape = np.shape(self.value) if self.value is not None else ()
        if not shape or self.is_gain:
            return {name: (k,) for k, name in enumerate(names)}
        columns = [*names[: shape[-1]], *map(str, range(len(names), shape[-1]))]
        rows = list(np.ndindex(shape[:-1]))
        return {".".join([*map(str, row), name]): (*row, k) for row in rows for k, name in enumerate(columns)}

    @property
    def unit(self) -> str:
        """Unit of the field, see `Number`."""
        unit = getattr(self.declared, "unit", "")
        return unit(self.owner) if callable(unit) else str(unit)

    @property
    def is_gain(self) -> bool:
        """Whether the field may be one number, one number per coordinate, or a matrix."""
        return getattr(self.declared, "is_gain", False)


def entries_of(value: Any) -> list[tuple[str, Any]]:
    """Return the parts of a field of several parts with their keys: names if they differ, else indices."""
    if isinstance(value, Mapping):
        return list(value.items())
    names = [getattr(item, "name", None) for item in value]
    has_names = all(isinstance(name, str) for name in names) and len(set(names)) == len(names)
    return list(zip(map(str, names if has_names else range(len(names))), value, strict=True))


def walk(part: Any) -> tuple[Leaf, ...]:
    """Return all fields of a part and of its inner parts that are not parts themselves.

    A declared part is immutable and keeps the result.
    """
    leaves: tuple[Leaf, ...] | None = getattr(part, "__dict__", {}).get("_leaves")
    if leaves is not None:
        return leaves
    rows: list[Leaf] = []
    for name, field, value in fields_of(part):
        for path, item in _inner_values(name, field, value):
            if _is_inner(field, item):
                rows += [Leaf(f"{path}.{inner}", *others) for inner, *others in walk(item)]
            else:
                rows.append(Leaf(path, part, field, item))
    leaves = tuple(rows)
    if attrs.has(type(part)):
        object.__setattr__(part, "_leaves", leaves)
    return leaves


def _inner_values(path: str, field: Field, value: Any) -> list[tuple[str, Any]]:
    """Return the values in a field with their paths: one value, or those of a field of several parts."""
    if isinstance(field, Child) and field.many:
        return [(f"{path}.{key}", item) for key, item in entries_of(value)]
    return [(path, value)]


def _is_inner(field: Field, value: Any) -> bool:
    """Return whether a value is an inner part; the value of an option is not."""
    return is_part(value) and not isinstance(field, _Option)


def parts_of(part: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield a part and all inner parts with their paths, the outer ones first."""
    yield path, part
    for name, field, value in fields_of(part):
        for item_path, item in _inner_values(f"{path}.{name}" if path else name, field, value):
            if _is_inner(field, item):
                yield from parts_of(item, item_path)


def numbers(part: Any) -> dict[str, Leaf]:
    """Return the numbers that may differ from robot to robot, by path."""
    return {
        leaf.path: leaf
        for leaf in walk(part)
        if isinstance(leaf.declared, Number) and not leaf.declared.fixed and leaf.value is not None
    }


def replace(part: _T, values: Mapping[str, Any], *, nominal: bool = False) -> _T:
    """Return a part with other values at some paths; each changed part is checked like a new one.

    Parameters
    ----------
    part : part
        Original part.
    values : mapping of str to value
        New values by path, such as ``{"plant.mass": 12.0}``.
    nominal : bool
        Whether the new parts keep their originals, which parts with symbols need.

    Returns
    -------
    part
        New part; the original does not change.

    Raises
    ------
    UnknownName
        If there is no such path.
    InvalidArgument
        If a value does not match the declaration of its field.

    See Also
    --------
    parts.table : paths and numbers of a part.

    Examples
    --------
    >>> from pinmobile import ComputedTorque, MobileRobot
    >>> from pinmobile.parts import replace
    >>> law = ComputedTorque(MobileRobot(30.0, 1.3), kp=4, kd=4)
    >>> lighter = replace(law, {"robot.mass": 25.0, "kp": 9})
    >>> lighter.robot.mass  # [kg]
    25.0
    """
    used_paths: set[str] = set()
    new: _T = _replace(part, "", values, nominal, used_paths)
    for path in values.keys() - used_paths:
        raise UnknownName("parameter", path, numbers(part))
    return new


def _replace(part: Any, path: str, values: Mapping[str, Any], nominal: bool, used_paths: set[str]) -> Any:
    changes: dict[str, Any] = {}
    for name, field, value in fields_of(part):
        field_path = f"{path}.{name}" if path else name
        if field_path in values:
            changes[name] = values[field_path]
            used_paths.add(field_path)
        elif not isinstance(field, _Option) and any(key.startswith(f"{field_path}.") for key in values):
            items = {
                item_path: _replace(item, item_path, values, nominal, used_paths) if is_part(item) else item
                for item_path, item in _inner_values(field_path, field, value)
            }
            if not (isinstance(field, Child) and field.many):
                changes[name] = items[field_path]
            elif isinstance(value, Mapping):
                changes[name] = dict(zip(value, items.values(), strict=True))
            else:
                changes[name] = tuple(items.values())
    if not changes:
        return part
    new = evolved(part, changes)
    if nominal:
        object.__setattr__(new, "nominal", part)
    return new


class NumberRef(NamedTuple):
    """Number, array or entry of an array that a name means.

    Attributes
    ----------
    leaf : Leaf
        Field.
    label : str
        Name of the entry, "" for all entries.
    entry : tuple of int, optional
        Index of the entry.
    """

    leaf: Leaf
    label: str = ""
    entry: tuple[int, ...] | None = None

    @property
    def path(self) -> str:
        """Full path of the field or the entry."""
        return f"{self.leaf.path}.{self.label}" if self.label else self.leaf.path

    @property
    def is_array(self) -> bool:
        """Whether the name means several different numbers."""
        value = np.ravel(0.0 if self.leaf.value is None else self.leaf.value)
        return self.entry is None and bool((value != value[:1]).any())

    @property
    def value(self) -> Any:
        """Number; the first one of several."""
        value = np.asarray(0.0 if self.leaf.value is None else self.leaf.value, np.float64)
        return value.flat[0] if self.entry is None or not value.ndim else value[self.place(value.ndim)]

    def place(self, axes: int) -> tuple[int, ...]:
        """Return the index of the entry in an array with this number of axes, diagonal in a gain matrix."""
        entry = self.entry or ()
        return entry if len(entry) == axes else entry[-1:] * axes

    @property
    def unit(self) -> str:
        """Unit of the number."""
        return unit_of(self.leaf.unit, self.entry[-1] if self.entry else None)

    @property
    def meaning(self) -> str:
        """Meaning of the number as a noun phrase."""
        doc = self.leaf.declared.doc or self.leaf.path.rpartition(".")[2]
        return f"{doc}, {self.label}" if self.label else doc


def named(part: Any) -> dict[str, NumberRef]:
    """Return all numbers that may differ, and their entries, by full path."""
    numbers: dict[str, NumberRef] = {}
    for leaf in walk(part):
        if isinstance(leaf.declared, Number) and not leaf.declared.fixed and not _is_derived(leaf):
            refs = [NumberRef(leaf), *(NumberRef(leaf, label, i) for label, i in leaf.entries.items())]
            numbers |= {ref.path: ref for ref in refs}
    return numbers


def _is_derived(leaf: Leaf) -> bool:
    """Return whether an array of fixed length follows from other numbers, so that no entry differs alone."""
    shapes = getattr(leaf.declared, "shapes", ())
    return leaf.value is None and any(isinstance(n, int) for shape in shapes for n in shape)


def short_names(numbers: Mapping[str, NumberRef]) -> list[str]:
    """Return the shortest end of each path by which `find` finds it."""
    names, used_ends = [], set[str]()
    ends = {path: [path.split(".", k)[-1] for k in range(path.count(".") + 1)] for path in numbers}
    equally_near = Counter((_nearness(path), end) for path in numbers for end in ends[path])
    for path in sorted(numbers, key=_nearness):
        fit = ends[path] if not numbers[path].label else ends[path][:-1]
        free = (
            end
            for end in reversed(fit)
            if not (end[0].isdigit() or end in used_ends or end.startswith("robot."))
            if equally_near[_nearness(path), end] == 1
        )
        name = next(free, path)
        used_ends.update(ends[path])
        if not path.rpartition(".")[2].isdigit():
            names.append(name)
    return names


def shorten(paths: Iterable[str]) -> list[str]:
    """Return the shortest end of two words or more of each path that no other of them has.

    The index or letter of an entry does not count as a word.
    """
    splits, names = [path.split(".") for path in paths], []
    for words in splits:
        count = min(len(words), 2 + (len(words[-1]) == 1))
        ends = (words[-k:] for k in range(count, len(words)) if not words[-k].isdigit())
        unique = (end for end in ends if sum(split[-len(end) :] == end for split in splits) == 1)
        names.append(".".join(next(unique, words)))
    return names


def _nearness(path: str) -> tuple[bool, int]:
    return not path.startswith("plant."), path.count(".")


def _loop_name(name: Any, refs: Mapping[str, NumberRef]) -> str:
    """Return a name in which the first word robot of a loop is plant, "" for anything but text."""
    words = name.partition(".") if isinstance(name, str) else ("", "", "")
    is_plant = words[0] == "robot" and words[2] and any(path.startswith("plant.") for path in refs)
    return f"plant.{words[2]}" if is_plant else "".join(words)


def find(part: Any, name: str, refs: Mapping[str, NumberRef] | None = None, place: str = "") -> NumberRef:
    """Return the number that a name means.

    A name is a full path, the end of a path, or a word of a path and its end. Of several
    paths with this end, the plant's own comes first, then the one nearest to the loop: ``"mass"`` is the
    plant's, ``"controller.mass"`` the nearest in the controller. In a loop, the first word robot means the
    plant, as in files and commands.

    Raises
    ------
    UnknownName
        If no path has this end.
    InvalidArgument
        If several paths are equally near.
    """
    refs = named(part) if refs is None else refs
    user_name, name = name, _loop_name(name, refs)
    if name in refs:
        return refs[name]
    first, _, rest = name.partition(".")
    ends = sorted(
        (*_nearness(path), path)
        for path, number in refs.items()
        if not number.label or rest  # an entry has no name of one word
        if path.endswith(f".{name}") or (rest and f".{first}." in f".{path}" and path.endswith(f".{rest}"))
    )
    if not ends:
        from difflib import get_close_matches  # here, because only this error needs the module

        path, _, last = name.rpartition(".")
        with suppress(AttributeError):
            owner = attrgetter(path)(part)
            if not is_part(owner) and isinstance(getattr(owner, last), int | float):
                raise InvalidArgument(
                    f"{place or 'name'} has {user_name!r}, an attribute of a class that is neither a frozen "
                    "dataclass nor a `part`, so that it is constant; expected a field of one of these"
                )
        matches, names = get_close_matches(name, refs, cutoff=0.85) if rest else [], short_names(refs)
        for word in get_close_matches(last, {x.rpartition(".")[2] for x in names}, 1, _NEAR) * (not matches):
            matches = [x for x in names if x.endswith(f".{word}") or x == word]
        names = [*matches, *(x for x in names if x not in matches)]
        if user_name != name:  # the user calls the plant robot
            names = [f"robot.{x.removeprefix('plant.')}" if x.startswith("plant.") else x for x in names]
        raise UnknownName(f"parameter{place and ' in ' + place}", user_name, names)
    best = [path for *rank, path in ends if rank == list(ends[0][:2])]
    if len(best) > 1:
        options = [*best, f"{best[0].partition('.')[0]}.*.{name}"] if place in ("spread", "by") else best
        raise InvalidArgument(
            f"{place or 'name'} has {user_name!r}, which {' and '.join(best)} have, expected one of them: "
            f"{' or '.join(map(repr, options))}{', which means all' * (options is not best)}"
        )
    return refs[best[0]]


def match_refs(part: Any, name: str, refs: Mapping[str, NumberRef], where: str = "") -> list[NumberRef]:
    """Return the numbers that a name, or a pattern such as ``"*.gear"``, means, see `find`.

    Raises
    ------
    UnknownName
        If there is none.
    InvalidArgument
        If several paths are equally near.
    """
    if not isinstance(name, str) or "*" not in name:
        return [find(part, name, refs, where)]
    pattern = _loop_name(name, refs)
    matches = [ref for path, ref in refs.items() if fnmatchcase(f".{path}", f"*.{pattern}")]
    numbers = [ref for ref in matches if not ref.label] or matches
    if not numbers:
        raise UnknownName(f"parameter{where and ' in ' + where}", name, short_names(refs))
    return numbers


def spread_values(columns: Sequence[tuple[NumberRef, Any, bool]], n: int, size: int = 3) -> dict[str, Any]:
    """Return the values of n robots at each path, shape (n, ...).

    Parameters
    ----------
    columns : sequence of (Found, ndarray, bool)
        Each number, its values, shape (n,), and whether they are factors of the nominal array.
    n : int
        Number of robots.
    size : int
        Number of entries of a gain if one of its entries differs.
    """
    values: dict[str, Any] = {}
    for number, column, is_factor in sorted(columns, key=lambda each: each[0].entry is not None):
        path, base = number.leaf.path, np.asarray(0.0 if number.leaf.value is None else number.leaf.value)
        new = values.get(path)
        if new is None:
            new = np.array(np.broadcast_to(base.astype(np.float64), (n, *base.shape)))
        if number.entry is None:
            factor = np.reshape(column, (n, *(1,) * base.ndim))
            new[...] = new * factor if is_factor else factor
        else:
            if new.ndim == 1:
                new = np.repeat(new[:, None], size, axis=1)
            index: Any = slice(None), *number.place(new.ndim - 1)
            new[index] = column
        values[path] = new
    return values


def spread_entries(numbers: Sequence[NumberRef], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return masks of the entries that differ from robot to robot, by path."""
    entries: dict[str, Any] = {}
    for number in numbers:
        shape = np.shape(values[number.leaf.path])[1:]
        varies = entries.setdefault(number.leaf.path, np.zeros(shape, bool))
        varies[() if number.entry is None else number.place(len(shape))] = True
    return entries


def table(part: Any) -> str:
    """Return the numbers of a part as text: one line with path, value, unit, bound and meaning per number.

    Parameters
    ----------
    part : part
        Part or loop.

    Returns
    -------
    str
        Lines of the table.

    See Also
    --------
    parts.replace : the same part with other numbers.

    Examples
    --------
    >>> from pinmobile import PD
    >>> from pinmobile.parts import table
    >>> print(table(PD(120, 60)))
    kp  120.  N/m, N/m, N m/rad        >= 0  proportional gain
    kd  60.   N s/m, N s/m, N m s/rad  >= 0  derivative gain
    """
    rows = [
        (
            path,
            np.array2string(np.asarray(leaf.value), precision=6),
            leaf.unit,
            leaf.declared.bound,
            leaf.declared.doc,
        )
        for path, leaf in numbers(part).items()
        if isinstance(leaf.declared, Number)
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(x.ljust(w) for x, w in zip(row, widths, strict=True)).rstrip() for row in rows)
    return "\n".join(lines)
