"""From what the numbers of an ensemble's robots are drawn."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar, Protocol, TypeAlias, final, runtime_checkable

import numpy as np

from pinmobile.arrays import Array, ArrayLike, affordable, finite, non_negative, scalar, whole
from pinmobile.errors import InvalidArgument, shown

__all__ = [
    "TRUE_MODEL",
    "Distribution",
    "Normal",
    "Same",
    "Source",
    "Uniform",
    "checked_generator",
    "checked_size",
    "drawn",
]


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
        return checked_generator(generator).uniform(self.low, self.high, checked_size(size))

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
        return checked_generator(generator).normal(self.mean, self.std, checked_size(size))


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
    factor: Any = 1.0

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


def checked_generator(generator: Any) -> np.random.Generator:
    """Return a generator, after refusing what is none.

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    if not isinstance(generator, np.random.Generator):
        raise InvalidArgument(f"generator is {shown(generator)}, expected a numpy.random.Generator")
    return generator


def checked_size(size: Any) -> int:
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
