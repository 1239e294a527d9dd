"""Memory of a law between samples: a tree of dicts, lists, tuples and dataclasses with numbers.

Other entries of such a tree (a function, a name, None) must not change. A context gives a controller three
kinds of memory: `DelayLine` for delays, `Noise` for white Gaussian noise, and `Schedule` for numbers known at
each sample.

Noise is a function of a robot's key and the index of the sample, without a table or a generator. SplitMix64
(Steele, Lea and Flood, Fast splittable pseudorandom number generators, 2014) computes 64 bits from the key
and a counter. The transform of Box and Muller (1958), with basic operations, computes two normal numbers from
each 64 bits. A robot thus has the same bits at the same sample in every engine, for any number of robots.
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
    """Return the named entries of a tree; None for any other object."""
    if isinstance(tree, dict):
        return ((f"[{key!r}]", value) for key, value in tree.items())
    if isinstance(tree, list | tuple):
        return ((f"[{i}]", value) for i, value in enumerate(tree))
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type) and not hasattr(tree, "parameters"):
        return ((f".{field.name}", getattr(tree, field.name)) for field in dataclasses.fields(tree))
    return None


def leaves(tree: object, path: str = "state") -> list[tuple[str, Any]]:
    """Return the numbers and arrays of a tree with their paths."""
    if is_leaf(tree):
        return [(path, tree)]
    return [leaf for name, value in _children(tree) or () for leaf in leaves(value, path + name)]


def map_leaves(tree: Any, function: Callable[[Any], Any]) -> Any:
    """Return the tree after applying a function to its numbers and arrays."""
    if is_leaf(tree):
        return function(tree)
    if isinstance(tree, dict):
        return {key: map_leaves(value, function) for key, value in tree.items()}
    if isinstance(tree, tuple) and hasattr(tree, "_fields"):
        return type(tree)(*(map_leaves(value, function) for value in tree))
    if type(tree) in (list, tuple):
        return type(tree)(map_leaves(value, function) for value in tree)
    if _children(tree) is None:
        return tree
    new = copy.copy(tree)
    for field in dataclasses.fields(tree):
        object.__setattr__(new, field.name, map_leaves(getattr(tree, field.name), function))
    return new


def match_leaves(tree_a: object, tree_b: object, path: str = "state") -> Iterator[tuple[str, Any, Any]]:
    """Yield the numbers and arrays of two trees side by side.

    Raises
    ------
    NotTraceable
        If the trees differ in anything else.
    """
    if is_leaf(tree_a) and is_leaf(tree_b):
        yield path, tree_a, tree_b
        return
    old, new = _children(tree_a), _children(tree_b)
    if old is None or new is None or is_leaf(tree_a) or is_leaf(tree_b):
        if not _equal(tree_a, tree_b):
            raise NotTraceable(f"{path} was {_words(tree_a)} and is {_words(tree_b)} a sample later", _STATE)
        return
    first, second = list(old), list(new)
    if [name for name, _ in first] != [name for name, _ in second]:
        names = (", ".join(name for name, _ in entries) or "nothing" for entries in (first, second))
        raise NotTraceable("{} has {} and a sample later {}".format(path, *names), _STATE)
    for (name, a), (_, b) in zip(first, second, strict=True):
        yield from match_leaves(a, b, path + name)


def _equal(a: object, b: object) -> bool:
    if a is b or (type(a) is type(b) and hasattr(a, "goes_on")):
        return True
    try:
        return type(a) is type(b) and bool(a == b)
    except (TypeError, ValueError):
        return False


def _words(x: Any) -> str:
    return f"an array of shape {np.shape(x)}" if is_leaf(x) else repr(x) if x is None else type(x).__name__


class DelayLine:
    """Delay in the memory of a controller: ``old, line = line.push(values)``.

    Parameters
    ----------
    samples : int
        Delay in samples. Until then, the first values are returned.
    past : iterable
        Previous values, the oldest first.
    """

    goes_on = True  # a new object replaces it at each sample

    def __init__(self, samples: int, past: Iterable[object] = ()) -> None:
        self.samples = samples
        self.past = deque(past, samples + 1)

    def push(self, values: object) -> tuple[Any, DelayLine]:
        """Return the values of `samples` samples ago, a tree of arrays, and the delay for the next sample."""
        copies = map_leaves(values, lambda x: np.array(x, np.float64))
        past = (*self.past, copies)
        return map_leaves(past[0], np.copy), DelayLine(
            self.samples, past[-self.samples :] if self.samples else ()
        )


class Schedule:
    """Numbers known at each sample in the memory of a controller: ``row, schedule = schedule.next()``.

    All robots of an ensemble have the same numbers. A compiled loop reads them like the reference.

    Parameters
    ----------
    rows : ndarray, shape (N + 1, ...)
        Numbers of the samples; the last row remains afterwards.
    k : int
        Index of the sample.
    """

    goes_on = True  # a new object replaces it at each sample

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
_FRACTION = 2**52 - 1  # bits of the fraction of a float
_MASK_40, _MASK_22 = _FRACTION - (2**12 - 1), 2**23 - 2  # masks of bits of a word
_ODD = float_bits(2.0**52) + 1
_ROOT = float_bits(math.sqrt(0.5))
_ROOT_OFFSET = 2**64 + (64 << 52) - _ROOT  # exponent of u / sqrt(1/2), plus 64, which makes it positive

# Series of -4 artanh(s), and of sine and cosine for an eighth of a turn, as short as the accuracy allows.
_PER_OCTAVE = -1.3862943611198906  # -2 log 2
_ARTANH = [-4 / (2 * k + 1) for k in range(6)]
_SINE = [(-1) ** k / math.factorial(2 * k + 1) for k in range(5)]
_COSINE = [(-1) ** k / math.factorial(2 * k) for k in range(6)]


Word: TypeAlias = Node | np.uint64 | NDArray[np.uint64]
"""64 bits, known or not."""


def _mix(x: Word) -> Any:
    """Return the SplitMix64 function of 64 bits."""
    first = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9
    second = (first ^ (first >> 27)) * 0x94D049BB133111EB
    return second ^ (second >> 31)


def normals(key: Word, k: Word, n: int) -> list[Any]:
    """Return n standard normal numbers of a robot at sample k.

    A pair has 64 bits: 40 bits determine the size, at most 7.4, and 24 bits the direction. Both are accurate
    to 2e-9; two neighbouring directions are 4e-7 apart.

    Parameters
    ----------
    key, k : node or ndarray of uint64
        Key of the robot, and index of the sample.
    n : int
        Number of numbers.

    Returns
    -------
    numbers : list of n nodes or ndarrays
        Numbers, in pairs from 64 bits each.
    """
    numbers = []
    pairs = (n + 1) // 2
    first = k * pairs
    for j in range(1, pairs + 1):
        word = _mix(key + (first + j) * _GOLDEN)
        part = real(((word >> 11) & _MASK_40) | _ONE)  # in [1, 2)
        radius = root(_minus_two_log(2.0 - part))
        signed = real(bits(radius) | (word & _SIGN))  # half a turn
        s, c = _sincos_eighth(real((word & _MASK_22) | _ODD) - (2.0**52 + 2.0**22))
        is_mirrored = real((word & 1) | _ONE) > 1.0  # reflection at the line between both axes
        numbers += [signed * select(is_mirrored, s, c), signed * select(is_mirrored, c, s)]
    return numbers[:n]


def _minus_two_log(u: Number) -> Any:
    """Return -2 log u of a number in [2^-40, 1], with an error below 5e-11."""
    word = bits(u) + _ROOT_OFFSET
    exponent = real((word >> 52) | float_bits(2.0**52)) - (2.0**52 + 64.0)
    fraction = real((word & _FRACTION) + _ROOT)  # in [sqrt(1/2), sqrt(2))
    s = (fraction - 1.0) / (fraction + 1.0)
    return exponent * _PER_OCTAVE + s * polynomial(_ARTANH, s * s)


def _sincos_eighth(i: Number) -> tuple[Any, Any]:
    """Return sine and cosine of i pi / 2^24 for -2^22 < i < 2^22, an eighth of a turn to each side."""
    r = i * (math.pi / 2**24)
    z = r * r
    return r * polynomial(_SINE, z), polynomial(_COSINE, z)


def robot_keys(
    seed: int | np.random.SeedSequence, name: str, robots: NDArray[np.int64] | range
) -> NDArray[np.uint64]:
    """Return the key of each robot for the noise of a name.

    Parameters
    ----------
    seed : int or SeedSequence
        Seed of the run.
    name : str
        Name of the noise, such as ``"measurement"``; each name has its own numbers.
    robots : ndarray of int, or range
        Indices of the robots; the key of a robot depends on its own index only.
    """
    sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    words = sequence.generate_state(2, np.uint64).tobytes() + name.encode()
    start = np.frombuffer(hashlib.sha256(words).digest()[:8], "<u8")
    with np.errstate(over="ignore"):
        return np.asarray(_mix(start + np.asarray(robots, np.uint64) * np.uint64(_GOLDEN)), np.uint64)


class Noise:
    """Standard normal numbers in the memory of a controller: ``numbers, noise = noise.draw()``.

    Parameters
    ----------
    key : int or ndarray of uint64
        Key of the robot, shape ().
    n : int
        Numbers per sample.
    k : int
        Index of the sample.
    """

    goes_on = True  # a new object replaces it at each sample

    def __init__(self, key: int | np.uint64 | NDArray[np.uint64], n: int, k: int = 0) -> None:
        self.key, self.n, self.k = key, n, k

    def draw(self) -> tuple[Array, Noise]:
        """Return n numbers, shape (..., n) for keys of shape (...), and the noise for the next sample."""
        next_noise = Noise(self.key, self.n, self.k + 1)
        if not np.ndim(self.key):
            block, row = divmod(int(self.k), _BLOCK)
            return _block(int(self.key), self.n, block)[row].copy(), next_noise
        return _numbers(np.asarray(self.key, np.uint64), np.uint64(self.k), self.n), next_noise


def _numbers(key: np.uint64 | NDArray[np.uint64], k: np.uint64 | NDArray[np.uint64], n: int) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        keys, samples = np.broadcast_arrays(key, k)
        return np.stack(normals(keys, samples, n), axis=-1)


@functools.lru_cache(64)
def _block(key: int, n: int, block: int) -> Array:
    """Return the numbers of `_BLOCK` samples, which take hardly longer than one sample."""
    k = np.arange(block * _BLOCK, (block + 1) * _BLOCK, dtype=np.uint64)
    return _numbers(np.uint64(key), k, n)
