"""White Gaussian noise as a function of a robot's key and the sample's number: no table, no generator.

Two streams of 64 bits are SplitMix64 (Steele, Lea and Flood, Fast splittable pseudorandom number generators,
2014) of the key and a counter; two normal numbers come of them by Box and Muller's transform (1958), from
basic operations. So the same robot gets the same bits at the same sample in every engine, however many run
beside it.
"""

import functools
import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.compiled.elementary import log_of_normal, sincos_of_half_turns
from pinmobile.compiled.tape import float_bits, real, root

__all__ = ["Noise", "normals", "robot_keys"]

_GOLDEN = 0x9E3779B97F4A7C15
_ONE = float_bits(1.0)
_BLOCK = 256  # samples


def _mixed(x: Any) -> Any:
    """Return SplitMix64's function of 64 bits."""
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9
    x = (x ^ (x >> 27)) * 0x94D049BB133111EB
    return x ^ (x >> 31)


def _unit(x: Any) -> Any:
    """Return a number in [1, 2) whose fraction is the 52 upper ones of 64 bits."""
    return real((x >> 12) | _ONE)


def normals(key: Any, k: Any, n: int) -> list[Any]:
    """Return n standard normal numbers of a robot at sample k.

    Parameters
    ----------
    key, k : node or ndarray of uint64
        The robot's key, and the number of the sample.
    n : int
        How many.

    Returns
    -------
    numbers : list of n nodes or ndarrays
        In pairs from the same two streams.
    """
    found = []
    even = n + n % 2
    first = k * even
    for j in range(0, even, 2):
        a, b = (_mixed(key + (first + (j + i)) * _GOLDEN) for i in (1, 2))
        radius = root(-2.0 * log_of_normal(2.0 - _unit(a)))  # of a number in (0, 1]
        s, c = sincos_of_half_turns(2.0 * _unit(b) - 3.0)
        found += [radius * c, radius * s]
    return found[:n]


def robot_keys(seed: Any, name: str, robots: NDArray[np.int64] | range) -> NDArray[np.uint64]:
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
    key : node or ndarray of uint64
        The robot's, shape ().
    n : int
        Numbers a sample.
    k : node or int
        Number of the sample.
    """

    goes_on = True  # a new one takes its place at each sample

    def __init__(self, key: Any, n: int, k: Any = 0) -> None:
        self.key, self.n, self.k = key, n, k

    def draw(self) -> tuple[Array, "Noise"]:
        """Return n numbers, shape (..., n) for keys of shape (...), and the noise for the next sample."""
        after = Noise(self.key, self.n, self.k + 1)
        if not np.ndim(self.key):
            block, row = divmod(int(self.k), _BLOCK)
            return _block(int(self.key), self.n, block)[row].copy(), after
        return _numbers(np.asarray(self.key, np.uint64), np.uint64(self.k), self.n), after


def _numbers(key: Any, k: Any, n: int) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        keys, samples = np.broadcast_arrays(key, k)
        return np.stack(normals(keys, samples, n), axis=-1)


@functools.lru_cache(64)
def _block(key: int, n: int, block: int) -> Array:
    """Return the numbers of `_BLOCK` samples, for which it takes hardly longer than for one."""
    k = np.arange(block * _BLOCK, (block + 1) * _BLOCK, dtype=np.uint64)
    return _numbers(np.uint64(key), k, n)
