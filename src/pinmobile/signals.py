"""Named series with units that parts of a loop give beside states and inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, ArrayLike, frozen, instance, real, shaped
from pinmobile.errors import InvalidArgument, shown

_DEEPEST = 100  # wrappers in one another


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


class Claim(NamedTuple):
    """What a part tells at a sample under a name.

    Attributes
    ----------
    part, unit : str
        Whose it is, such as ``"forces[1]"``, and its unit.
    value : ndarray, shape () or (k,)
        What it is.
    """

    part: str
    unit: str
    value: Any


def signals_of(part: object, *given: object) -> Any:
    """Return the signals of a part that may have some: a dict of name to (unit, value), else nothing."""
    return part.signals(*given) if hasattr(part, "signals") else {}


def number(name: str, value: ArrayLike) -> Array:
    """Return the value of a signal, shape () or (k,).

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    return shaped(name, np.array(real(name, value)), (), ("n",))


def claimed(
    told: Iterable[tuple[str, Any]], value_of: Callable[[str, Any], Any] = number
) -> dict[str, Claim]:
    """Return what parts tell at a sample, by name.

    Parameters
    ----------
    told : iterable of (str, mapping)
        Each part by what it is called in messages, and its signals.
    value_of : callable
        Checks a value, given what it is called.

    Raises
    ------
    InvalidArgument
        If signals are none, or two parts have one of a name.
    """
    found: dict[str, Claim] = {}
    for part, signals in told:
        instance(f"what {part}.signals returned", signals, Mapping, "a dict of name to (unit, value)")
        for name, pair in signals.items():
            if type(pair) is not tuple or len(pair) != 2 or not isinstance(pair[0], str):
                raise InvalidArgument(f"{part}.signals[{name!r}] is {shown(pair)}, expected (unit, value)")
            if name in found:
                raise InvalidArgument(
                    f"{found[name].part} and {part} both have the signal {name!r}, expected another name"
                )
            found[name] = Claim(part, pair[0], value_of(f"{part}.signals[{name!r}]", pair[1]))
    return found


def told_at(t: Array, controller: object, trajectory: object) -> dict[str, Signal]:
    """Return what a controller, those inside it and a trajectory tell of all samples at once, by name.

    That is what depends on the time alone, such as a target. Of one name the outermost counts.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times of the samples [s].
    controller, trajectory : controller, trajectory
        Asked for ``signals_at(t)``: a dict of name to (unit, values), values of shape (N,) or (N, k).

    Raises
    ------
    InvalidArgument
        If one returns something else.
    """
    wrapped: list[object] = []
    while controller is not None and len(wrapped) < _DEEPEST:
        wrapped.append(controller)
        controller = getattr(controller, "controller", None)
    found: dict[str, Signal] = {}
    for part in (trajectory, *reversed(wrapped)):
        if isinstance(part, type) or not hasattr(part, "signals_at"):
            continue
        named = f"{type(part).__name__}.signals_at"
        told = instance(f"what {named} returned", part.signals_at(t.copy()), Mapping, "a dict of signals")
        for name, (unit, values) in told.items():
            array = real(f"{named}[{name!r}]", values)
            shaped(f"{named}[{name!r}]", array, (len(t),), (len(t), "k"))
            found[name] = Signal(unit, frozen(array))
    return found
