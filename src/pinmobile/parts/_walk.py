"""Walk over the fields of parts: replacement by path, numbers by name, tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple, TypeVar

import attrs
import numpy as np

from pinmobile.errors import InvalidArgument, UnknownName
from pinmobile.parts._fields import Child, Field, Number, _Option, evolved, fields_of, is_part, unit_of

_T = TypeVar("_T")


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
        return ("n", "n") in getattr(self.declared, "shapes", ())


def entries_of(value: Any) -> list[tuple[str, Any]]:
    """Return the parts of a field of several parts with their keys: names if they differ, else indices."""
    if isinstance(value, Mapping):
        return list(value.items())
    names = [getattr(each, "name", None) for each in value]
    named = all(isinstance(name, str) for name in names) and len(set(names)) == len(names)
    return [
        (str(name) if named else str(i), each)
        for i, (name, each) in enumerate(zip(names, value, strict=True))
    ]


def walk(part: Any) -> tuple[Leaf, ...]:
    """Return all fields of a part and of its inner parts that are not parts themselves.

    A declared part is immutable and keeps the result.
    """
    kept: tuple[Leaf, ...] | None = getattr(part, "__dict__", {}).get("_leaves")
    if kept is not None:
        return kept
    found: list[Leaf] = []
    for name, declared, value in fields_of(part):
        for path, each in _inner(name, declared, value):
            if _is_within(declared, each):
                found += [Leaf(f"{path}.{inner}", *others) for inner, *others in walk(each)]
            else:
                found.append(Leaf(path, part, declared, each))
    kept = tuple(found)
    if attrs.has(type(part)):
        object.__setattr__(part, "_leaves", kept)
    return kept


def _inner(path: str, declared: Field, value: Any) -> list[tuple[str, Any]]:
    """Return the values in a field with their paths: one value, or those of a field of several parts."""
    if isinstance(declared, Child) and declared.many:
        return [(f"{path}.{key}", each) for key, each in entries_of(value)]
    return [(path, value)]


def _is_within(declared: Field, value: Any) -> bool:
    """Return whether a value is an inner part; the value of an option is not."""
    return is_part(value) and not isinstance(declared, _Option)


def parts_of(part: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield a part and all inner parts with their paths, the outer ones first."""
    yield path, part
    for name, declared, value in fields_of(part):
        for below, each in _inner(f"{path}.{name}" if path else name, declared, value):
            if _is_within(declared, each):
                yield from parts_of(each, below)


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
    used: set[str] = set()
    new: _T = _replaced(part, "", values, nominal, used)
    for path in values.keys() - used:
        raise UnknownName("parameter", path, numbers(part))
    return new


def _replaced(part: Any, path: str, values: Mapping[str, Any], nominal: bool, used: set[str]) -> Any:
    changes: dict[str, Any] = {}
    for name, declared, value in fields_of(part):
        at = f"{path}.{name}" if path else name
        if at in values:
            changes[name] = values[at]
            used.add(at)
        elif not isinstance(declared, _Option) and any(key.startswith(f"{at}.") for key in values):
            changed = {
                below: _replaced(each, below, values, nominal, used) if is_part(each) else each
                for below, each in _inner(at, declared, value)
            }
            if not (isinstance(declared, Child) and declared.many):
                changes[name] = changed[at]
            elif isinstance(value, Mapping):
                changes[name] = dict(zip(value, changed.values(), strict=True))
            else:
                changes[name] = tuple(changed.values())
    if not changes:
        return part
    new = evolved(part, changes)
    if nominal:
        object.__setattr__(new, "nominal", part)
    return new


class Found(NamedTuple):
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
        value = self.leaf.value
        return self.entry is None and value is not None and np.ptp(np.asarray(value, np.float64)) != 0

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


def named(part: Any) -> dict[str, Found]:
    """Return all numbers that may differ, and their entries, by full path."""
    found: dict[str, Found] = {}
    for leaf in walk(part):
        if isinstance(leaf.declared, Number) and not leaf.declared.fixed and not _is_derived(leaf):
            own = [Found(leaf), *(Found(leaf, label, entry) for label, entry in leaf.entries.items())]
            found |= {one.path: one for one in own}
    return found


def _is_derived(leaf: Leaf) -> bool:
    """Return whether an array of fixed length follows from other numbers, so that no entry differs alone."""
    shapes = getattr(leaf.declared, "shapes", ())
    return leaf.value is None and any(isinstance(n, int) for shape in shapes for n in shape)


def short_names(known: Mapping[str, Found]) -> list[str]:
    """Return the shortest unique end of each path."""
    found, taken = [], set[str]()
    for path in sorted(known, key=_nearness):
        words = path.split(".")
        least = 2 if known[path].label else 1
        first = [k for k in range(len(words) - least, -1, -1) if not (k and words[k].isdigit())]
        ends = (".".join(words[k:]) for k in first)
        name = next(end for end in ends if not (end in taken or end.startswith("robot.")) or end == path)
        taken |= {".".join(words[k:]) for k in range(len(words))}
        if not words[-1].isdigit():
            found.append(name)
    return found


def shortest(paths: Iterable[str]) -> list[str]:
    """Return the shortest end of two words or more of each path that no other of them has.

    The index or letter of an entry does not count as a word.
    """
    every, found = [path.split(".") for path in paths], []
    for words in every:
        least = min(len(words), 2 + (len(words[-1]) == 1))
        ends = (words[-k:] for k in range(least, len(words)) if not words[-k].isdigit())
        unique = (end for end in ends if sum(each[-len(end) :] == end for each in every) == 1)
        found.append(".".join(next(unique, words)))
    return found


def _nearness(path: str) -> tuple[bool, int]:
    return not path.startswith("plant."), path.count(".")


def find(part: Any, name: str, known: Mapping[str, Found] | None = None, where: str = "") -> Found:
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
    known = named(part) if known is None else known
    if name in known:
        return known[name]
    first, _, rest = name.partition(".") if isinstance(name, str) else ("", "", "")
    if first == "robot" and rest and any(path.startswith("plant.") for path in known):
        return find(part, f"plant.{rest}", known, where)
    ends = sorted(
        (*_nearness(path), path)
        for path, one in known.items()
        if not one.label or rest  # an entry has no name of one word
        if path.endswith(f".{name}") or (rest and f".{first}." in f".{path}" and path.endswith(f".{rest}"))
    )
    if not ends:
        from difflib import get_close_matches  # here, because only this error needs the module

        near = get_close_matches(name, known, cutoff=0.85) if rest else []
        raise UnknownName(f"parameter{where and ' in ' + where}", name, [*near, *short_names(known)])
    best = [path for *rank, path in ends if rank == list(ends[0][:2])]
    if len(best) > 1:
        every = [*best, f"{best[0].partition('.')[0]}.*.{name}"] if where in ("spread", "by") else best
        raise InvalidArgument(
            f"{where or 'name'} has {name!r}, which {' and '.join(best)} have, expected one of them: "
            f"{' or '.join(map(repr, every))}{', which means all' * (every is not best)}"
        )
    return known[best[0]]


def matching(part: Any, name: str, known: Mapping[str, Found], where: str = "") -> list[Found]:
    """Return the numbers that a name, or a pattern such as ``"*.gear"``, means, see `find`.

    Raises
    ------
    UnknownName
        If there is none.
    InvalidArgument
        If several paths are equally near.
    """
    if not isinstance(name, str) or "*" not in name:
        return [find(part, name, known, where)]
    found = [x for path, x in known.items() if not x.label and fnmatchcase(f".{path}", f"*.{name}")]
    if not found:
        raise UnknownName(f"parameter{where and ' in ' + where}", name, short_names(known))
    return found


def spread_values(found: Sequence[tuple[Found, Any, bool]], n: int, size: int = 3) -> dict[str, Any]:
    """Return the values of n robots at each path, shape (n, ...).

    Parameters
    ----------
    found : sequence of (Found, ndarray, bool)
        Each number, its values, shape (n,), and whether they are factors of the nominal array.
    n : int
        Number of robots.
    size : int
        Number of entries of a gain if one of its entries differs.
    """
    values: dict[str, Any] = {}
    for one, column, is_factor in sorted(found, key=lambda each: each[0].entry is not None):
        path, base = one.leaf.path, np.asarray(0.0 if one.leaf.value is None else one.leaf.value)
        new = values.get(path)
        if new is None:
            new = np.array(np.broadcast_to(base.astype(np.float64), (n, *base.shape)))
        if one.entry is None:
            by = np.reshape(column, (n, *(1,) * base.ndim))
            new[...] = new * by if is_factor else by
        else:
            if new.ndim == 1:
                new = np.repeat(new[:, None], size, axis=1)
            at: Any = slice(None), *one.place(new.ndim - 1)
            new[at] = column
        values[path] = new
    return values


def spread_entries(found: Sequence[Found], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return masks of the entries that differ from robot to robot, by path."""
    entries: dict[str, Any] = {}
    for one in found:
        shape = np.shape(values[one.leaf.path])[1:]
        varies = entries.setdefault(one.leaf.path, np.zeros(shape, bool))
        varies[() if one.entry is None else one.place(len(shape))] = True
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
    kp  120.  N/m, N/m, N m/rad          proportional gain
    kd  60.   N s/m, N s/m, N m s/rad    derivative gain
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
