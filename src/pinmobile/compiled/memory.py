"""What a law keeps between samples: a tree of dicts, lists, tuples and dataclasses with numbers in it.

The rest that stands in such a tree (a function, a name, None) must stay as it is.
"""

from __future__ import annotations

import copy
import dataclasses
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from pinmobile.compiled.symbolic import Symbols
from pinmobile.compiled.tape import Node
from pinmobile.errors import NotTraceable

_STATE = "keep memory in state as floats and arrays, in a tree that stays as `initial_state` returns it"


def is_leaf(x: Any) -> bool:
    """Tell whether a value is a number, an array of numbers, or a symbol."""
    numeric = isinstance(x, np.ndarray) and (x.dtype.kind in "fiub" or x.dtype == object)
    return numeric or isinstance(x, Symbols | Node | bool | int | float | np.number | np.bool_)


def _children(tree: Any) -> Iterator[tuple[str, Any]] | None:
    """Return the named entries of a tree; None of what is no tree."""
    if isinstance(tree, dict):
        return ((f"[{key!r}]", value) for key, value in tree.items())
    if isinstance(tree, list | tuple):
        return ((f"[{i}]", value) for i, value in enumerate(tree))
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type) and not hasattr(tree, "parameters"):
        return ((f".{field.name}", getattr(tree, field.name)) for field in dataclasses.fields(tree))
    return None


def leaves(tree: Any, path: str = "state") -> list[tuple[str, Any]]:
    """Return the numbers and arrays of a tree, each with its path."""
    if is_leaf(tree):
        return [(path, tree)]
    return [leaf for name, value in _children(tree) or () for leaf in leaves(value, path + name)]


def mapped(tree: Any, function: Callable[[Any], Any]) -> Any:
    """Return the tree with a function of its numbers and arrays in their place."""
    if is_leaf(tree):
        return function(tree)
    if isinstance(tree, dict):
        return {key: mapped(value, function) for key, value in tree.items()}
    if isinstance(tree, tuple) and hasattr(tree, "_fields"):
        return type(tree)(*(mapped(value, function) for value in tree))
    if type(tree) in (list, tuple):
        return type(tree)(mapped(value, function) for value in tree)
    if _children(tree) is None:
        return tree
    new = copy.copy(tree)
    for field in dataclasses.fields(tree):
        object.__setattr__(new, field.name, mapped(getattr(tree, field.name), function))
    return new


def matched(before: Any, after: Any, path: str = "state") -> Iterator[tuple[str, Any, Any]]:
    """Return the numbers and arrays of two trees side by side.

    Raises
    ------
    NotTraceable
        If the trees differ in anything else.
    """
    if is_leaf(before) and is_leaf(after):
        yield path, before, after
        return
    old, new = _children(before), _children(after)
    if old is None or new is None or is_leaf(before) or is_leaf(after):
        if not _same(before, after):
            raise NotTraceable(f"{path} was {_told(before)} and is {_told(after)} a sample later", _STATE)
        return
    first, second = list(old), list(new)
    if [name for name, _ in first] != [name for name, _ in second]:
        names = (", ".join(name for name, _ in entries) or "nothing" for entries in (first, second))
        raise NotTraceable("{} has {} and a sample later {}".format(path, *names), _STATE)
    for (name, a), (_, b) in zip(first, second, strict=True):
        yield from matched(a, b, path + name)


def _same(a: Any, b: Any) -> bool:
    if a is b or (type(a) is type(b) and hasattr(a, "goes_on")):
        return True
    try:
        return type(a) is type(b) and bool(a == b)
    except (TypeError, ValueError):
        return False


def _told(x: Any) -> str:
    return f"an array of shape {np.shape(x)}" if is_leaf(x) else repr(x) if x is None else type(x).__name__


class Line:
    """A delay in a controller's memory: ``old, line = line.push(values)``.

    Parameters
    ----------
    samples : int
        How late the values come back; until there are that many, the first ones do.
    past : iterable
        Values so far, the oldest first: no more than it needs.
    """

    goes_on = True  # a new one takes its place at each sample

    def __init__(self, samples: int, past: Iterable[Any] = ()) -> None:
        self.samples = samples
        self.past = deque(past, samples + 1)

    def push(self, values: Any) -> tuple[Any, Line]:
        """Return what was pushed `samples` ago, a tree of arrays, and the line for the next sample."""
        kept = mapped(values, lambda x: np.array(x, np.float64))
        past = (*self.past, kept)
        return mapped(past[0], np.copy), Line(self.samples, past[-self.samples :] if self.samples else ())
