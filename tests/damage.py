"""A disk that is full and files that are damaged, the same ones each time."""

import resource
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pinmobile import PinmobileError


@contextmanager
def full_disk(room: int = 0) -> Iterator[None]:
    """Let the kernel refuse to make a file of this process longer than `room` bytes, as a full disk does.

    A module that is imported meanwhile leaves no bytecode: Python would keep a file that is cut off.
    """
    writes, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = writes


@contextmanager
def little_memory(room: int = 1 << 30) -> Iterator[None]:
    """Let this process have only so many bytes of addresses more than it has."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Return content with some of its bytes changed, gone, doubled, or replaced by others."""
    data, size = bytearray(content), max(len(content), 1)
    start = int(rng.integers(size))
    stop = min(start + int(rng.integers(1, 64)), len(content))
    kind = rng.integers(6)
    if kind <= 1:  # the most likely: single bits
        for place in rng.integers(size, size=int(rng.integers(1, 4))):
            data[place : place + 1] = bytes(b ^ 1 << int(rng.integers(8)) for b in data[place : place + 1])
    elif kind == 2:
        del data[start:]
    elif kind == 3:
        data[start:stop] = rng.bytes(stop - start)
    elif kind == 4:
        del data[start:stop]
    else:
        data[start:start] = data[start:stop] or b"\0"
    return bytes(data)


def answer(call: Callable[[], Any]) -> Any:
    """Return what comes of a call: its answer, or an error of the library; any other is raised."""
    try:
        return call()
    except PinmobileError as error:
        return error
