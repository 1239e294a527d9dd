"""Named series with units that plant and controller give beside states and inputs."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, frozen, real
from pinmobile.errors import InvalidArgument, shown

__all__ = ["Recorder", "Signal", "recorder"]


class Signal(NamedTuple):
    """A series that a part gives, one value per sample.

    Attributes
    ----------
    unit : str
        Such as ``"N"``, "" for none.
    values : ndarray, shape (N + 1,) or (N + 1, k)
        Numbers, or rows of them.
    """

    unit: str
    values: Array


class Recorder:
    """Asks at each sample for what parts tell beside states and inputs.

    Parameters
    ----------
    sources : mapping of str to callable
        By what the part is called in messages: the signals of sample k with state q, v and input u.
    times : list of float
        Of the samples [s].
    """

    def __init__(
        self,
        sources: Mapping[str, Callable[[int, Array, Array, Array], Any]],
        times: list[float],
    ) -> None:
        self._sources, self._times = sources, times
        self._units: dict[str, tuple[str, str, tuple[int, ...]]] = {}  # by name: part, unit, shape
        self._rows: dict[str, list[Array]] = {}

    def __call__(self, k: int, q: Array, v: Array, u: Array) -> None:
        """Record a sample."""
        for part, ask in self._sources.items():
            found = ask(k, q, v, u)
            if not isinstance(found, Mapping):
                raise InvalidArgument(
                    f"{part}.signals returned {shown(found)}, expected a dict of name to (unit, value)"
                )
            expected = [name for name, (owner, *_) in self._units.items() if owner == part]
            if k and list(found) != expected:
                raise InvalidArgument(
                    f"{part}.signals has {', '.join(map(str, found)) or 'none'} at t = {self._times[k]:g} s, "
                    f"expected the same as at first: {', '.join(expected) or 'none'}"
                )
            for name, pair in found.items():
                self._take(part, name, pair, k)

    def _take(self, part: str, name: Any, pair: Any, k: int) -> None:
        ok = isinstance(name, str) and name and type(pair) is tuple and len(pair) == 2
        if not ok or not isinstance(pair[0], str):
            raise InvalidArgument(
                f"{part}.signals has {shown(name)}: {shown(pair)}, expected a name and (unit, value)"
            )
        unit, value = pair[0], np.array(real(f"{part}.signals[{name!r}]", pair[1]))
        if value.ndim > 1:
            raise InvalidArgument(
                f"{part}.signals[{name!r}] has shape {value.shape}, expected a number or a row of them"
            )
        kept = self._units.setdefault(name, (part, unit, value.shape))
        if kept[0] != part:
            raise InvalidArgument(
                f"{kept[0]} and {part} both have the signal {name!r}, expected another name"
            )
        if kept != (part, unit, value.shape):
            raise InvalidArgument(
                f"{part}.signals[{name!r}] has unit {unit!r} and shape {value.shape} at "
                f"t = {self._times[k]:g} s, expected {kept[1]!r} and {kept[2]} as at first"
            )
        self._rows.setdefault(name, []).append(value)

    def signals(self, end: int) -> dict[str, Signal]:
        """Return what was recorded of the samples before `end`, by name."""
        return {
            name: Signal(self._units[name][1], frozen(np.array(rows[:end])))
            for name, rows in self._rows.items()
        }


def recorder(
    plant: Any,
    push: Callable[[float, Array, Array], Array] | None,
    memory: Callable[[], Any],
    tell: Callable[[], Mapping[str, Any]] | None,
    times: list[float],
) -> Recorder | None:
    """Return what asks plant and controller for their signals; None where neither has any.

    Parameters
    ----------
    plant : plant
        Asked for ``signals(t, q, v, u, f, memory)``.
    push : callable or None
        The generalised force beside the input.
    memory : callable
        What the plant keeps.
    tell : callable or None
        The controller's signals at the sample that it was asked about last.
    times : list of float
        Of the samples [s].
    """
    sources: dict[str, Callable[[int, Array, Array, Array], Any]] = {}
    if hasattr(plant, "signals"):

        def of_plant(k: int, q: Array, v: Array, u: Array) -> Any:
            f = np.zeros(plant.nv) if push is None else push(times[k], q, v)
            return plant.signals(times[k], q.copy(), v.copy(), u.copy(), f, memory())

        sources["plant"] = of_plant
    if tell is not None:
        sources["controller"] = lambda k, q, v, u: tell()
    return Recorder(sources, times) if sources else None
