"""What a law keeps between samples: a tree of dicts, lists, tuples and dataclasses with numbers in it.

The rest that stands in such a tree (a function, a name, None) must stay as it is. `Line`, `Noise` and
`Schedule` are what a context gives a controller to keep: delays, white Gaussian noise, and what is known of
each sample.

Noise is a function of a robot's key and the sample's number, without a table or a generator. A stream of 64
bits is SplitMix64 (Steele, Lea and Flood, Fast splittable pseudorandom number generators, 2014) of the key
and a counter; of each 64 come two normal numbers by Box and Muller's transform (1958), from basic operations.
So the same robot gets the same bits at the same sample in every engine, however many run beside it.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import hashlib
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.compiled.elementary import polynomial
from pinmobile.compiled.symbolic import Symbols
from pinmobile.compiled.tape import Node, Number, bits, float_bits, real, root, select
from pinmobile.errors import NotTraceable

_STATE = "keep memory in state as floats and arrays, in a tree that stays as `initial_state` returns it"


def is_leaf(x: object) -> bool:
    """Return whether a value is a number, an array of numbers, or a symbol."""
    numeric = isinstance(x, np.ndarray) and (x.dtype.kind in "fiub" or x.dtype == object)
    return numeric or isinstance(x, Symbols | Node | bool | int | float | np.number | np.bool_)


def _children(tree: object) -> Iterator[tuple[str, Any]] | None:
    """Return the named entries of a tree; None of what is no tree."""
    if isinstance(tree, dict):
        return ((f"[{key!r}]", value) for key, value in tree.items())
    if isinstance(tree, list | tuple):
        return ((f"[{i}]", value) for i, value in enumerate(tree))
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type) and not hasattr(tree, "parameters"):
        return ((f".{field.name}", getattr(tree, field.name)) for field in dataclasses.fields(tree))
    return None


def leaves(tree: object, path: str = "state") -> list[tuple[str, Any]]:
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


def matched(before: object, after: object, path: str = "state") -> Iterator[tuple[str, Any, Any]]:
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


def _same(a: object, b: object) -> bool:
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

    def __init__(self, samples: int, past: Iterable[object] = ()) -> None:
        self.samples = samples
        self.past = deque(past, samples + 1)

    def push(self, values: object) -> tuple[Any, Line]:
        """Return what was pushed `samples` ago, a tree of arrays, and the line for the next sample."""
        kept = mapped(values, lambda x: np.array(x, np.float64))
        past = (*self.past, kept)
        return mapped(past[0], np.copy), Line(self.samples, past[-self.samples :] if self.samples else ())


class Schedule:
    """Numbers that are known for each sample, in a controller's memory: ``row, schedule = schedule.next()``.

    All robots of an ensemble have the same; a compiled loop reads them beside the reference.

    Parameters
    ----------
    rows : ndarray, shape (N + 1, ...)
        Of the samples; after the last, that stays.
    k : int
        Number of the sample.
    """

    goes_on = True  # a new one takes its place at each sample

    def __init__(self, rows: Array, k: int = 0) -> None:
        self.rows, self.k = rows, k

    def next(self) -> tuple[Any, Schedule]:
        """Return the row of this sample, shape (...), and the schedule for the next one."""
        row = self.rows[min(self.k, len(self.rows) - 1)]
        return np.array(row, np.float64), Schedule(self.rows, self.k + 1)


_GOLDEN = 0x9E3779B97F4A7C15
_BLOCK = 256  # samples
_ONE = float_bits(1.0)
_SIGN = 1 << 63
_FRACTION = 2**52 - 1  # all bits of a float's fraction
_FORTY, _TWENTY_TWO = _FRACTION - (2**12 - 1), 2**23 - 2  # of a word's bits
_ODD = float_bits(2.0**52) + 1
_ROOT = float_bits(math.sqrt(0.5))
_ABOVE_ROOT = 2**64 + (64 << 52) - _ROOT  # the exponent of u / sqrt(1/2), and 64, so that it is above 0

# The series of -4 artanh(s) and, for an eighth of a turn, of sine and cosine, no longer than is needed.
_PER_OCTAVE = -1.3862943611198906  # -2 log 2
_ARTANH = [-4 / (2 * k + 1) for k in range(6)]
_SINE = [(-1) ** k / math.factorial(2 * k + 1) for k in range(5)]
_COSINE = [(-1) ** k / math.factorial(2 * k) for k in range(6)]


Word: TypeAlias = Node | np.uint64 | NDArray[np.uint64]
"""64 bits, known or not."""


def _mixed(x: Word) -> Any:
    """Return SplitMix64's function of 64 bits."""
    once = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9
    twice = (once ^ (once >> 27)) * 0x94D049BB133111EB
    return twice ^ (twice >> 31)


def normals(key: Word, k: Word, n: int) -> list[Any]:
    """Return n standard normal numbers of a robot at sample k.

    Of the 64 bits for a pair, 40 say how large it is, at most 7.4, and 24 in which direction it points. Both
    are within 2e-9, where two neighbouring directions are 4e-7 apart.

    Parameters
    ----------
    key, k : node or ndarray of uint64
        The robot's key, and the number of the sample.
    n : int
        How many.

    Returns
    -------
    numbers : list of n nodes or ndarrays
        In pairs, of 64 bits each.
    """
    found = []
    pairs = (n + 1) // 2
    first = k * pairs
    for j in range(1, pairs + 1):
        word = _mixed(key + (first + j) * _GOLDEN)
        part = real(((word >> 11) & _FORTY) | _ONE)  # in [1, 2)
        radius = root(_minus_two_log(2.0 - part))
        turned = real(bits(radius) | (word & _SIGN))  # by half a turn
        s, c = _sincos_of_an_eighth(real((word & _TWENTY_TWO) | _ODD) - (2.0**52 + 2.0**22))
        mirrored = real((word & 1) | _ONE) > 1.0  # in the line between both axes
        found += [turned * select(mirrored, s, c), turned * select(mirrored, c, s)]
    return found[:n]


def _minus_two_log(u: Number) -> Any:
    """Return -2 log u of a number in [2^-40, 1], within 5e-11 of it."""
    word = bits(u) + _ABOVE_ROOT
    exponent = real((word >> 52) | float_bits(2.0**52)) - (2.0**52 + 64.0)
    fraction = real((word & _FRACTION) + _ROOT)  # in [sqrt(1/2), sqrt(2))
    s = (fraction - 1.0) / (fraction + 1.0)
    return exponent * _PER_OCTAVE + s * polynomial(_ARTANH, s * s)


def _sincos_of_an_eighth(i: Number) -> tuple[Any, Any]:
    """Return sine and cosine of i pi / 2^24, for |i| < 2^22: an eighth of a turn to either side."""
    r = i * (math.pi / 2**24)
    z = r * r
    return r * polynomial(_SINE, z), polynomial(_COSINE, z)


def robot_keys(
    seed: int | np.random.SeedSequence, name: str, robots: NDArray[np.int64] | range
) -> NDArray[np.uint64]:
    """Return the key of each robot for the noise of one name.

    Parameters
    ----------
    seed : int or SeedSequence
        Of the run.
    name : str
        What is drawn, such as ``"measurement"``; each name has numbers of its own.
    robots : ndarray of int, or range
        Indices of the robots; a robot's key depends on its own alone.
    """
    sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    words = sequence.generate_state(2, np.uint64).tobytes() + name.encode()
    start = np.frombuffer(hashlib.sha256(words).digest()[:8], "<u8")
    with np.errstate(over="ignore"):
        return np.asarray(_mixed(start + np.asarray(robots, np.uint64) * np.uint64(_GOLDEN)), np.uint64)


class Noise:
    """Standard normal numbers in a controller's memory: ``numbers, noise = noise.draw()``.

    Parameters
    ----------
    key : int or ndarray of uint64
        The robot's, shape ().
    n : int
        Numbers a sample.
    k : int
        Number of the sample.
    """

    goes_on = True  # a new one takes its place at each sample

    def __init__(self, key: int | np.uint64 | NDArray[np.uint64], n: int, k: int = 0) -> None:
        self.key, self.n, self.k = key, n, k

    def draw(self) -> tuple[Array, Noise]:
        """Return n numbers, shape (..., n) for keys of shape (...), and the noise for the next sample."""
        after = Noise(self.key, self.n, self.k + 1)
        if not np.ndim(self.key):
            block, row = divmod(int(self.k), _BLOCK)
            return _block(int(self.key), self.n, block)[row].copy(), after
        return _numbers(np.asarray(self.key, np.uint64), np.uint64(self.k), self.n), after


def _numbers(key: np.uint64 | NDArray[np.uint64], k: np.uint64 | NDArray[np.uint64], n: int) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        keys, samples = np.broadcast_arrays(key, k)
        return np.stack(normals(keys, samples, n), axis=-1)


@functools.lru_cache(64)
def _block(key: int, n: int, block: int) -> Array:
    """Return the numbers of `_BLOCK` samples, for which it takes hardly longer than for one."""
    k = np.arange(block * _BLOCK, (block + 1) * _BLOCK, dtype=np.uint64)
    return _numbers(np.uint64(key), k, n)
