"""Distributions of the numbers of an ensemble, and their draws."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol, TypeAlias, final, runtime_checkable
from zlib import crc32

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, instance, required, scalar, shaped
from pinmobile.errors import InvalidArgument, unexpected_value
from pinmobile.parts import Number, NumberRef, by_value, match_refs, number, part
from pinmobile.plant import stated


@runtime_checkable
class Distribution(Protocol):
    """Distribution of a spread; a frozen distribution of ``scipy.stats`` (with ``rvs``) works too.

    See Also
    --------
    Uniform : uniform distribution.
    Normal : normal distribution.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.loop import Distribution
    >>> class Coin:
    ...     def sample(self, generator, size):
    ...         return generator.choice([20.0, 40.0], size)
    >>> isinstance(Coin(), Distribution)
    True
    """

    def sample(self, generator: np.random.Generator, size: int) -> Array:
        """Return independent draws.

        Parameters
        ----------
        generator : numpy.random.Generator
            Source of randomness.
        size : int
            Number of draws.

        Returns
        -------
        ndarray, shape (size,)
            Draws in the unit of the number.
        """


@final
@by_value
@part
class Uniform:
    """Uniform distribution between two bounds.

    Parameters
    ----------
    low, high : float
        Bounds, low <= high, in the unit of the number.

    Raises
    ------
    InvalidArgument
        If a bound is not finite, or `low` exceeds `high`.

    See Also
    --------
    Normal : normal distribution.
    Relative : factor of the nominal number.
    ensemble : run many robots with different numbers.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import Uniform
    >>> mass = Uniform(20.0, 40.0)  # [kg]
    >>> draws = mass.sample(np.random.default_rng(0), 1000)
    >>> float(draws.mean())  # [kg]
    30.3
    """

    low: float = number(doc="lower bound")
    high: float = number(doc="upper bound")

    def check(self) -> None:
        """Raise `InvalidArgument` if `low` exceeds `high`."""
        low, high = self.low, self.high
        if low > high:
            raise InvalidArgument(f"low is {low}, expected at most high, {high}")

    def sample(self, generator: np.random.Generator, size: int) -> Array:
        """Return independent draws.

        Parameters
        ----------
        generator : numpy.random.Generator
            Source of randomness.
        size : int
            Number of draws.

        Returns
        -------
        ndarray, shape (size,)
            Draws in the unit of the number.
        """
        return generator.uniform(self.low, self.high, size)

    def support(self) -> tuple[float, float]:
        """Return the bounds, as a frozen distribution of ``scipy.stats`` does."""
        return self.low, self.high

    def cdf(self, value: float) -> float:
        """Return the probability that a draw does not exceed a value.

        Parameters
        ----------
        value : float
            Value in the unit of the bounds.

        Returns
        -------
        float
            Probability from 0 to 1.
        """
        value, width = scalar("value", value), self.high - self.low
        return min(max((value - self.low) / width, 0.0), 1.0) if width else float(value >= self.low)


@final
@by_value
@part
class Normal:
    """Normal distribution.

    Parameters
    ----------
    mean, std : float
        Mean and standard deviation >= 0, in the unit of the number.

    Raises
    ------
    InvalidArgument
        If a parameter is not finite, or `std` is negative.

    See Also
    --------
    Uniform : uniform distribution.
    ensemble : run many robots with different numbers.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import Normal
    >>> mass = Normal(mean=30.0, std=2.0)  # [kg]
    >>> draws = mass.sample(np.random.default_rng(0), 1000)
    >>> float(draws.std())  # [kg]
    1.9
    """

    mean: float = number(doc="mean")
    std: float = number(lower=0.0, doc="standard deviation")

    def sample(self, generator: np.random.Generator, size: int) -> Array:
        """Return independent draws.

        Parameters
        ----------
        generator : numpy.random.Generator
            Source of randomness.
        size : int
            Number of draws.

        Returns
        -------
        ndarray, shape (size,)
            Draws in the unit of the number.
        """
        return generator.normal(self.mean, self.std, size)


@final
@dataclass(frozen=True)
class SameAs:
    """Value of another number of the same robot, times a factor.

    ``{"mass": Uniform(20, 40), "controller.mass": SameAs("mass")}`` gives the controller model the true mass.
    ``SameAs("mass", Normal(1, 0.1))`` gives the controller model a mass with a relative error of about 10 %.

    Parameters
    ----------
    name : str
        Name of the other number, which may be outside the spread.
    factor : float, array_like of shape (n,) or distribution
        Factor of the other number.

    Raises
    ------
    InvalidArgument
        If `name` is not text.

    See Also
    --------
    loop.TRUE_MODEL : spread that gives a controller model the true numbers.
    Relative : factor of the nominal number.

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, MobileRobot
    >>> from pinmobile import SameAs, Scenario, Tangent, Uniform
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law = ComputedTorque(robot, kp=4, kd=4)
    >>> spread = {"mass": Uniform(20, 40)}
    >>> spread["controller.mass"] = SameAs("mass")
    >>> path = Tangent(Circle(1.0, 0.5, 4.0))
    >>> runs = Scenario(robot=robot, controller=law, trajectory=path,
    ...                 n=100, spread=spread, dt=0.02)
    >>> draws = runs.draws()
    >>> bool((draws["mass"] == draws["controller.mass"]).all())
    True
    """

    name: str
    factor: Distribution | ArrayLike = 1.0

    def __post_init__(self) -> None:
        instance("name", self.name, str, "the name of a parameter")


@final
@dataclass(frozen=True)
class Relative:
    """Nominal number times a factor, such as ``{"kp": Relative(Uniform(0.8, 1.2))}``.

    One factor multiplies all entries of an array.

    Parameters
    ----------
    factor : float, array_like of shape (n,) or distribution
        Factor of the nominal number.

    See Also
    --------
    Uniform : distribution of the number itself.
    SameAs : value of another number.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Relative
    >>> from pinmobile import Scenario, Tangent, Uniform
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> runs = Scenario(robot=robot, controller=PD(120, 120),
    ...                 trajectory=Tangent(Circle(1.0, 0.5, 4.0)),
    ...                 spread={"mass": Relative(Uniform(0.8, 1.2))},
    ...                 n=100, dt=0.02)
    >>> float(runs.draws()["mass"].min())  # [kg], at least 24
    24.0
    """

    factor: Distribution | ArrayLike


class _TrueModel(Mapping[str, SameAs]):
    """Immutable part of a spread, for ``spread={..., **TRUE_MODEL}``; a pickle is the same object again."""

    def __init__(self, names: Iterable[str]) -> None:
        self._sources = {f"controller.{name}": SameAs(f"plant.{name}") for name in names}

    def __getitem__(self, name: str) -> SameAs:
        return self._sources[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._sources)

    def __len__(self) -> int:
        return len(self._sources)

    def __repr__(self) -> str:
        return repr(self._sources)

    def __reduce__(self) -> str:
        return "TRUE_MODEL"


TRUE_MODEL: Mapping[str, SameAs] = _TrueModel(("mass", "yaw_inertia", "com.x", "com.y"))
"""Spread that gives a controller model each robot's numbers: ``{"mass": Uniform(20, 40), **TRUE_MODEL}``.

The mapping contains mass, yaw inertia, com.x and com.y.
"""

Source: TypeAlias = Distribution | SameAs | Relative | ArrayLike


def draw_source(name: str, source: Any, generator: np.random.Generator, size: int) -> Array:
    """Return draws from a distribution, shape (size,).

    Parameters
    ----------
    name : str
        Name of the number, for the message.
    source : Distribution or frozen distribution of scipy.stats
        Distribution of the number.
    generator : numpy.random.Generator
        Source of randomness.
    size : int
        Number of draws.

    Raises
    ------
    InvalidArgument
        If the distribution returns anything but `size` finite numbers.
    """
    has_sample, label = stated(source, "sample") is not None, f"spread[{name!r}].sample"
    values = source.sample(generator, size) if has_sample else source.rvs(size=size, random_state=generator)
    return shaped(label, finite(label, values), (size,))


Find: TypeAlias = Callable[..., NumberRef]
"""``find(name, where)`` returns the number with this name, or raises."""


def expand_patterns(
    spread: Mapping[str, Source], given: Any, numbers: Mapping[str, NumberRef]
) -> dict[str, Source]:
    """Return a spread in which each pattern, such as ``"*.mu"``, is replaced by the paths that it means."""
    expanded = dict[str, Source]()
    for name, source in spread.items():
        if "*" in str(name):
            refs = match_refs(given, name, numbers, "spread")
            if isinstance(source, Relative):  # a factor leaves zeros as they are
                refs = [ref for ref in refs if ref.is_array or ref.value] or refs
            expanded |= dict.fromkeys([ref.path for ref in refs], source)
        else:
            expanded[name] = source
    return expanded


def check_spread(spread: Mapping[str, Source], n: int, find: Find) -> dict[str, Any]:
    """Return a spread with checked names and sources, and copies of its arrays.

    Parameters
    ----------
    spread : mapping
        Spread of a user.
    n : int
        Number of robots.
    find : callable
        See `Find`.

    Raises
    ------
    UnknownName
        If there is no such number.
    InvalidArgument
        If a source is not a distribution, number, array of shape (n,), `Relative` or `SameAs`, if a `SameAs`
        is circular, or if two names mean the same number.
    """
    sources, names = {}, dict[str, str]()
    for name, source in spread.items():
        number = find(name)
        path, entries = number.path, number.leaf.entries
        if number.is_array and entries and not (number.leaf.is_gain or isinstance(source, Relative | SameAs)):
            options = ", ".join(repr(f"{name}.{entry}") for entry in entries)
            message = f"spread has {name!r}, an array of {len(entries)} different numbers"
            raise InvalidArgument(f"{message}, expected {options}, or a Relative distribution")
        if names.setdefault(path, name) != name:
            message = f"spread has {names[path]!r} and {name!r}, which both mean {path}"
            raise InvalidArgument(f"{message}, expected one of them")
        sources[name] = _check_source(f"spread[{name!r}]", source, n)
        if isinstance(source, Relative):
            _check_set(name, number)
            if not (number.is_array or number.value):
                raise InvalidArgument(
                    f"spread[{name!r}] is a factor of {number.path}, which is 0, expected a distribution of "
                    "the number itself, such as Uniform(-1, 1)"
                )
        if isinstance(source, SameAs):
            _check_chain(name, source, spread, find)
    return sources


def _check_set(name: str, number: NumberRef) -> None:
    """Raise `InvalidArgument` if a number has no value that a factor could multiply."""
    words = f"spread[{name!r}] is a factor of {number.path}, {number.meaning}, which"
    required(words, number.leaf.value, "a number there, or a distribution of the number itself")


def check_supports(spread: Mapping[str, Any], numbers: Mapping[str, NumberRef]) -> None:
    """Check that distributions stay within the bounds of their numbers.

    Raises
    ------
    InvalidArgument
        If one exceeds a bound; the message gives the share of impossible draws.
    """
    for name, source in spread.items():
        field, number = numbers[name].leaf.declared, numbers[name]
        frozen = stated(source, "sample") is None and stated(source, "rvs") is not None  # of scipy.stats
        has_support = frozen or isinstance(source, Uniform)
        above, lower = (stated(field, name) for name in ("above", "lower"))
        bound = lower if above is None else above
        if bound is not None and has_support and -np.inf < (low := float(source.support()[0])) < bound:
            count = f"{float(source.cdf(bound)):.2%} of its draws"
            raise _support_error(f"spread[{name!r}] reaches {low:.6g}", number, count)


def _support_error(message: str, number: NumberRef, count: str) -> InvalidArgument:
    words = f"{message} {number.unit} as the {number.meaning}, and {count} are impossible"
    return InvalidArgument(f"{words}; expected {number.leaf.declared.bound}")  # type: ignore[attr-defined]


def check_draws(draws: Mapping[str, Array], numbers: Mapping[str, NumberRef]) -> None:
    """Check that draws stay within the bounds of their numbers.

    Raises
    ------
    InvalidArgument
        If some exceed a bound; the message gives their share.
    """
    for name, column in draws.items():
        number, field = numbers[name], numbers[name].leaf.declared
        is_wrong = field.outside_bounds(column) if isinstance(field, Number) else np.zeros(len(column), bool)
        if is_wrong.any():
            count = f"{np.count_nonzero(is_wrong)} of {len(column)} draws ({is_wrong.mean():.2%})"
            raise _support_error(f"spread[{name!r}] gives {column[is_wrong].min():.6g}", number, count)


def _check_source(label: str, source: Any, n: int) -> Any:
    if isinstance(source, SameAs | Relative):
        return replace(source, factor=_check_draws_of(f"{label}.factor", source.factor, n))
    return _check_draws_of(label, source, n)


def _check_draws_of(label: str, source: Any, n: int) -> Any:
    if isinstance(source, type | str):
        expected = "numbers or a distribution, such as Uniform(1, 2)"
        raise unexpected_value(label, source, expected)
    numbers = stated(source, "__array__") is not None  # a column of pandas has `sample` too
    if not numbers and any(stated(source, name) is not None for name in ("sample", "rvs")):
        return source
    words = ", one number per robot, or a distribution, such as Uniform(1, 2)"
    return shaped(label, finite(label, source), (), (n,), words=words).copy()


def _check_chain(name: str, source: SameAs, spread: Mapping[str, Any], find: Find) -> None:
    paths, visited = {find(other).path: other for other in spread}, [find(name).path]
    while isinstance(source, SameAs):
        number = find(source.name, f"spread[{paths[visited[-1]]!r}]")
        path = number.path
        if path in visited:
            circle = ", ".join(paths[link] for link in (*visited, path))
            raise InvalidArgument(f"spread is circular ({circle}): give one its own distribution")
        visited.append(path)
        whole = paths.get(number.leaf.path)
        if whole is not None and np.ndim(number.leaf.value) and isinstance(spread[whole], Relative):
            entry = f"{whole}.{next(iter(number.leaf.entries))}"
            raise InvalidArgument(
                f"spread[{name!r}] is the same as {source.name!r}, but {whole!r} changes the whole array: "
                f"expected a Relative of each entry, such as {entry!r}"
            )
        if path not in paths:
            _check_set(name, number)
        source = spread.get(paths.get(path, ""))  # type: ignore[assignment]


_BLOCK = 4096  # robots with draws from one stream of random numbers


def stream(seed: int, label: str, *index: int) -> np.random.SeedSequence:
    """Return the seed of a stream of random numbers, for a robot or a block of robots.

    Parameters
    ----------
    seed : int
        Seed of the ensemble.
    label : str
        Name of the stream.
    *index : int
        Index of the robot or block.
    """
    return np.random.SeedSequence(seed, spawn_key=(crc32(label.replace(".", "_").encode()), *index))


def draw(spread: Mapping[str, Any], seed: int, start: int, stop: int, find: Find) -> dict[str, Array]:
    """Return the values of the robots from `start` to before `stop`, shape (stop - start,) each.

    For a `Relative` of an array, the values are the factors.

    Parameters
    ----------
    spread : mapping
        Result of `check_spread`.
    seed : int
        Seed of the ensemble.
    start, stop : int
        Range of robots.
    find : callable
        See `Find`.

    Raises
    ------
    InvalidArgument
        If a distribution returns anything but numbers.
    """
    names, values = {find(name).path: name for name in spread}, dict[str, Array]()

    def value_of(path: str, number: NumberRef) -> Array:
        if path not in values:
            name = names.get(path)
            source = None if name is None else spread[name]
            if isinstance(source, SameAs | Relative):
                if isinstance(source, SameAs):
                    other = find(source.name)
                    base: Any = value_of(other.path, other)
                else:
                    base = 1.0 if number.is_array else number.value
                values[path] = base * draw_values(f"{name} factor", source.factor, seed, start, stop)
            elif name is not None:
                values[path] = draw_values(name, source, seed, start, stop)
            elif number.is_array:
                message = f"spread refers to {path!r}, an array of different numbers"
                raise InvalidArgument(f"{message}, expected a single number")
            else:
                return np.full(stop - start, number.value)
        return values[path]

    return {name: value_of(find(name).path, find(name)) for name in spread}


@dataclass(frozen=True)
class _SpreadSlice:
    """Part of an array of the spread, for the robots from index `start` on."""

    start: int
    values: Array


def slice_spread(spread: Mapping[str, Any], start: int, stop: int) -> dict[str, Any]:
    """Return a spread whose arrays contain only the robots from `start` to before `stop`.

    Parameters
    ----------
    spread : mapping
        Result of `check_spread`.
    start, stop : int
        Range of robots.
    """

    def part(source: object) -> Any:
        if isinstance(source, SameAs | Relative):
            return replace(source, factor=part(source.factor))
        if isinstance(source, np.ndarray) and source.ndim:
            return _SpreadSlice(start, source[start:stop])
        return source

    return {name: part(source) for name, source in spread.items()}


def draw_values(name: str, source: Any, seed: int, start: int, stop: int) -> Array:
    """Return the values of a source for the robots from `start` to before `stop`, shape (stop - start,)."""
    if isinstance(source, _SpreadSlice):
        return source.values[start - source.start : stop - source.start].copy()
    if isinstance(source, np.ndarray):
        return np.array(source[start:stop] if source.ndim else np.full(stop - start, source))

    return draw_blocks(name, partial(draw_source, name, source), seed, start, stop)


def draw_blocks(
    label: str,
    draws: Callable[[np.random.Generator, int], Array],
    seed: int,
    start: int,
    stop: int,
    last: dict[int, Array] | None = None,
) -> Array:
    """Return the draws of the robots from `start` to before `stop`, independent of all other draws.

    Parameters
    ----------
    label : str
        Name of the stream of random numbers.
    draws : callable
        Function ``draws(generator, size)`` that returns an array of shape (size, ...).
    seed : int
        Seed of the ensemble.
    start, stop : int
        Range of robots.
    last : dict of int to ndarray, optional
        Draws of the last block by its index. The function stores the block of its last robot here, so that a
        call for the next robots is fast.
    """
    cache, first = dict(last or {}), start // _BLOCK
    blocks = range(first, -(-stop // _BLOCK))
    for block in blocks:
        if block not in cache:
            cache[block] = draws(np.random.default_rng(stream(seed, label, block)), _BLOCK)
    parts = [cache[block] for block in blocks]
    if last is not None:
        last.clear()
        last[blocks[-1]] = parts[-1]
    return np.concatenate(parts)[start - first * _BLOCK : stop - first * _BLOCK]
