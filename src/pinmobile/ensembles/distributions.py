"""From what the numbers of an ensemble's robots are drawn, and the draws."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar, Protocol, TypeAlias, final, runtime_checkable
from zlib import crc32

import numpy as np

from pinmobile.arrays import Array, ArrayLike, affordable, finite, non_negative, scalar, whole
from pinmobile.ensembles.parameters import Stated, resolved
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Parameter


@runtime_checkable
class Distribution(Protocol):
    """What a spread may hold; a frozen distribution of `scipy.stats` (with ``rvs``) is as good.

    One whose fewer draws are the beginning of more may say so, ``in_order = True``: then no more are drawn
    than needed.
    """

    def sample(self, generator: np.random.Generator, size: int) -> Array:
        """Return `size` independent draws, shape (size,)."""


@final
@dataclass(frozen=True)
class Uniform:
    """Equally likely anywhere between two bounds.

    Parameters
    ----------
    low, high : float
        The bounds, low <= high, in the unit of what is drawn.

    Raises
    ------
    InvalidArgument
        If a bound is not finite, or `low` is above `high`.
    """

    low: float
    high: float
    in_order: ClassVar[bool] = True  # fewer draws are the beginning of more

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            object.__setattr__(self, name, scalar(name, getattr(self, name)))
        if self.low > self.high:
            raise InvalidArgument(f"low is {self.low}, expected at most high, {self.high}")
        if not isfinite(self.high - self.low):
            raise InvalidArgument(
                f"high is {self.high} and low {self.low}, expected a width that is a number: at most 1.79e308"
            )

    def sample(self, generator: np.random.Generator, size: int) -> Array:
        """Return `size` independent draws, shape (size,)."""
        return _checked_generator(generator).uniform(self.low, self.high, checked_size(size))

    def support(self) -> tuple[float, float]:
        """Return the bounds, as a frozen distribution of `scipy.stats` does."""
        return self.low, self.high

    def cdf(self, value: float) -> float:
        """Return the probability of draws up to `value`."""
        value, width = scalar("value", value), self.high - self.low
        return min(max((value - self.low) / width, 0.0), 1.0) if width else float(value >= self.low)


@final
@dataclass(frozen=True)
class Normal:
    """The normal distribution.

    Parameters
    ----------
    mean, std : float
        Mean and standard deviation >= 0, in the unit of what is drawn.

    Raises
    ------
    InvalidArgument
        If one is not finite, or `std` is negative.
    """

    mean: float
    std: float
    in_order: ClassVar[bool] = True  # fewer draws are the beginning of more

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", scalar("mean", self.mean))
        object.__setattr__(self, "std", non_negative("std", self.std))

    def sample(self, generator: np.random.Generator, size: int) -> Array:
        """Return `size` independent draws, shape (size,)."""
        return _checked_generator(generator).normal(self.mean, self.std, checked_size(size))


@final
@dataclass(frozen=True)
class Same:
    """The same number as another one of the robot's, or a multiple of it.

    ``{"mass": Uniform(20, 40), "model_mass": Same("mass")}`` tells the controller the true mass;
    ``Same("mass", Normal(1, 0.1))`` a mass that is off by some 10 %.

    Parameters
    ----------
    name : str
        Name of the other parameter, spread or not.
    factor : float, array_like of shape (n,) or distribution
        What it is multiplied by.
    """

    name: str
    factor: Distribution | ArrayLike = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InvalidArgument(f"name is {shown(self.name)}, expected the name of a parameter")
        if isinstance(self.factor, Same):
            raise InvalidArgument(
                f"factor is {shown(self.factor)}, expected a number, numbers or a distribution: "
                "give what is the same as another one a name in the spread"
            )


class _TrueModel(Mapping[str, Same]):
    """Read only as a view of a dict, and unlike it to be sent to other processes: it comes back as itself."""

    def __init__(self, names: Iterable[str]) -> None:
        self._held = {f"model_{name}": Same(name) for name in names}

    def __getitem__(self, name: str) -> Same:
        return self._held[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._held)

    def __len__(self) -> int:
        return len(self._held)

    def __repr__(self) -> str:
        return repr(self._held)

    def __reduce__(self) -> str:
        return "TRUE_MODEL"


TRUE_MODEL: Mapping[str, Same] = _TrueModel(("mass", "yaw_inertia", "com_x", "com_y"))
"""What tells a controller the truth about its robot: ``spread={"mass": Uniform(20, 40), **TRUE_MODEL}``."""

Source: TypeAlias = Distribution | Same | ArrayLike


def _checked_generator(generator: object) -> np.random.Generator:
    """Check that this is a generator, and return it.

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    if not isinstance(generator, np.random.Generator):
        raise InvalidArgument(f"generator is {shown(generator)}, expected a numpy.random.Generator")
    return generator


def checked_size(size: int) -> int:
    """Return how many draws are asked for.

    Raises
    ------
    InvalidArgument
        If it is no whole number, or they would not fit into memory.
    """
    count = whole("size", size, least=0)
    affordable(f"{count} draws", count, "draw fewer at a time")
    return count


def drawn(name: str, source: Any, generator: np.random.Generator, size: int) -> Array:
    """Return draws from a distribution, shape (size,).

    Parameters
    ----------
    name : str
        Name of what is drawn, for the message.
    source : Distribution or frozen distribution of scipy.stats
        What is drawn from.
    generator : numpy.random.Generator
        The randomness.
    size : int
        How many.

    Raises
    ------
    InvalidArgument
        If what comes is not `size` finite numbers.
    """
    if hasattr(source, "sample"):
        values = source.sample(generator, size)
    else:
        values = source.rvs(size=size, random_state=generator)
    draws = finite(f"what spread[{name!r}] draws", values)
    if draws.shape != (size,):
        raise InvalidArgument(f"spread[{name!r}] draws shape {draws.shape}, expected ({size},)")
    return draws


def checked_spread(spread: Mapping[str, Source], n: int, known: Mapping[str, list[Stated]]) -> dict[str, Any]:
    """Return a spread whose names and sources are what is expected; arrays are checked and copied.

    Parameters
    ----------
    spread : mapping
        As a user gives it.
    n : int
        Number of robots.
    known : mapping
        The parameters that there are, by name.

    Raises
    ------
    UnknownName
        If there is no such parameter.
    InvalidArgument
        If a source is no distribution, number, array of shape (n,) or `Same`, or refers in a circle.
    """
    check_mapping(spread)
    found = {}
    for name, source in spread.items():
        resolved(name, known)
        found[name] = _checked(f"spread[{name!r}]", source, n)
        if isinstance(source, Same):
            _follow(name, source, spread, known)
    return found


def check_mapping(spread: object) -> None:
    """Refuse a spread that is no mapping.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    if not isinstance(spread, Mapping):
        raise InvalidArgument(f"spread is {shown(spread)}, expected a mapping of parameters to distributions")


def check_supports(spread: Mapping[str, Any], parameters: Mapping[str, Parameter]) -> None:
    """Refuse distributions that reach below what is possible, whatever happens to be drawn.

    Raises
    ------
    InvalidArgument
        If one does; the message tells the share of its draws.
    """
    for name, source in spread.items():
        parameter = parameters[name]
        told = isinstance(source, Uniform) or (hasattr(source, "rvs") and not hasattr(source, "sample"))
        low = float(source.support()[0]) if told else np.nan
        if np.isfinite(low) and low < parameter.least:
            raise InvalidArgument(
                f"spread[{name!r}] reaches {low:.6g} {parameter.unit} as the {parameter.meaning}, and "
                f"{float(source.cdf(parameter.least)):.2%} of its draws are impossible; "
                f"expected {parameter.bound}"
            )


def _checked(what: str, source: Any, n: int) -> Any:
    if isinstance(source, Same):
        return Same(source.name, _checked(f"{what}.factor", source.factor, n))
    if isinstance(source, type):
        raise InvalidArgument(
            f"{what} is the class {source.__name__}, expected one of it, such as Uniform(1, 2)"
        )
    numbers = hasattr(source, "__array__")  # as of a column of pandas, which has a `sample` too
    if not numbers and (hasattr(source, "sample") or hasattr(source, "rvs")):
        return source
    values = finite(what, source)
    if values.shape not in ((), (n,)):
        raise InvalidArgument(f"{what} has shape {values.shape}, expected () or ({n},)")
    return values.copy()


def _follow(name: str, source: Same, spread: Mapping[str, Any], known: Mapping[str, list[Stated]]) -> None:
    seen = [name]
    while isinstance(source, Same):
        resolved(source.name, known, f"spread[{seen[-1]!r}]")
        seen.append(source.name)
        if len(set(seen)) < len(seen):
            raise InvalidArgument(f"spread goes in a circle: {' is the same as '.join(seen)}")
        source = spread.get(source.name)  # type: ignore[assignment]


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

    def part(source: object) -> Any:
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
