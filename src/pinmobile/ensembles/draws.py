"""The draws of what is spread: the same for every division of the robots into stretches."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from zlib import crc32

import numpy as np

from pinmobile.arrays import Array
from pinmobile.ensembles.distributions import Same, drawn
from pinmobile.errors import InvalidArgument

__all__ = ["draw", "held", "in_blocks", "stream"]

_BLOCK = 4096  # robots that are drawn from one stream of random numbers


def stream(seed: int, what: str, *where: int) -> np.random.SeedSequence:
    """Return the seed of a stream of its own for `what`, and for a robot or block of robots."""
    return np.random.SeedSequence(seed, spawn_key=(crc32(what.encode()), *where))


def draw(
    spread: Mapping[str, Any], seed: int, start: int, stop: int, nominal: Mapping[str, float]
) -> dict[str, Array]:
    """Return the values of the robots from `start` to before `stop`, shape (stop - start,) each.

    Parameters
    ----------
    spread : mapping
        As `checked_spread` returns it.
    seed : int
        The seed of the ensemble.
    start, stop : int
        Which robots.
    nominal : mapping of str to float
        The values of what is not spread, for `Same`.

    Raises
    ------
    InvalidArgument
        If a distribution gives what is no number.
    """
    values: dict[str, Array] = {}

    def of(name: str) -> Array:
        if name not in values:
            if name not in spread:
                if name not in nominal:
                    raise InvalidArgument(
                        f"spread refers to {name!r}, which has several numbers, expected one that has one"
                    )
                return np.full(stop - start, nominal[name])
            source = spread[name]
            if isinstance(source, Same):
                values[name] = of(source.name) * _values(f"{name} factor", source.factor, seed, start, stop)
            else:
                values[name] = _values(name, source, seed, start, stop)
        return values[name]

    for name in spread:
        of(name)
    return {name: values[name] for name in spread}


@dataclass(frozen=True)
class _Held:
    """What an explicit array has for the robots from `start` on."""

    start: int
    values: Array


def held(spread: Mapping[str, Any], start: int, stop: int) -> dict[str, Any]:
    """Return a spread that knows, of explicit arrays, the robots from `start` to before `stop` alone.

    Parameters
    ----------
    spread : mapping
        As `checked_spread` returns it.
    start, stop : int
        Which robots.
    """

    def part(source: Any) -> Any:
        if isinstance(source, Same):
            return Same(source.name, part(source.factor))
        if isinstance(source, np.ndarray) and source.ndim:
            return _Held(start, source[start:stop])
        return source

    return {name: part(source) for name, source in spread.items()}


def _values(name: str, source: Any, seed: int, start: int, stop: int) -> Array:
    if isinstance(source, _Held):
        return source.values[start - source.start : stop - source.start].copy()
    if isinstance(source, np.ndarray):
        return np.array(source[start:stop] if source.ndim else np.full(stop - start, source))

    def own(generator: np.random.Generator, size: int) -> Array:
        return drawn(name, source, generator, size)

    return in_blocks(name, own, seed, start, stop, whole=not getattr(source, "in_order", False))


def in_blocks(
    what: str,
    draws: Callable[[np.random.Generator, int], Array],
    seed: int,
    start: int,
    stop: int,
    whole: bool = True,
) -> Array:
    """Return draws for the robots from `start` to before `stop`, whatever else is drawn.

    Parameters
    ----------
    what : str
        Name of the stream of random numbers.
    draws : callable
        ``draws(generator, size)`` returns an array of shape (size, ...).
    seed : int
        The seed of the ensemble.
    start, stop : int
        Which robots.
    whole : bool
        Whether blocks are drawn to their end; no need to, where fewer draws are the beginning of more.
    """
    first = start // _BLOCK
    blocks = [
        draws(
            np.random.default_rng(stream(seed, what, block)),
            _BLOCK if whole else min(_BLOCK, stop - block * _BLOCK),
        )
        for block in range(first, -(-stop // _BLOCK))
    ]
    found = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
    return found[start - first * _BLOCK : stop - first * _BLOCK]
