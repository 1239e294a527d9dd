"""The array type, angles on the circle, and the one place where arguments are checked."""

from math import isfinite
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinmobile.errors import InvalidArgument, NotFinite

__all__ = [
    "HALF_TURN",
    "LEAST_ANGLE",
    "Array",
    "ArrayLike",
    "broadcast",
    "finite",
    "finite_answer",
    "frozen",
    "location",
    "non_negative",
    "positive",
    "scalar",
    "seeded",
    "vector",
    "whole",
    "wrap_angle",
]

Array: TypeAlias = NDArray[np.float64]


def finite(name: str, value: ArrayLike) -> Array:
    """Return `value` as float64, after refusing what is not made of finite real numbers.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, any shape
        The argument.

    Raises
    ------
    InvalidArgument
        If `value` is not numeric, is ragged or complex, or holds NaN or infinity.
    """
    if (
        type(value) is np.ndarray
        and value.dtype == np.float64
        and value.ndim == 1
        and isfinite(np.vdot(value, value))
    ):
        return (
            value  # what comes in a loop: one product instead of five calls; where it overflows, look closely
        )
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        array = np.asarray(None)
    if array.dtype.kind not in "fiu":
        raise InvalidArgument(f"{name} is {value!r}, expected real numbers")
    array = array.astype(np.float64, copy=False)
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        place = f"[{', '.join(map(str, where))}]" if where else ""
        raise InvalidArgument(f"{name}{place} is {array[where]}, expected a finite number")
    return array


def finite_answer(answer: Array, /, **arguments: Array) -> Array:
    """Return an answer as it is, after refusing one that is not finite though its arguments are.

    Parameters
    ----------
    answer : ndarray, any shape
        What was computed.
    **arguments : ndarray, any shape
        From what, by name, for the message.

    Raises
    ------
    NotFinite
        If it holds NaN or infinity.
    """
    # One product, which unlike that of `dot` does not warn, instead of a look at each number.
    if isfinite(np.vdot(answer, answer)) or np.isfinite(answer).all():
        return answer
    bad = answer[~np.isfinite(answer)][0]
    sizes = ", ".join(f"|{name}| up to {np.abs(value).max():.3g}" for name, value in arguments.items())
    raise NotFinite(f"the answer is {bad} for {sizes}, made of numbers beyond 1.8e308: expected smaller ones")


def vector(name: str, value: ArrayLike, size: int) -> Array:
    """Return `value` as float64 of shape (..., size).

    Raises
    ------
    InvalidArgument
        If the last axis has another length, or an entry is not finite.
    """
    array = finite(name, value)
    if array.ndim == 0 or array.shape[-1] != size:
        raise InvalidArgument(f"{name} has shape {array.shape}, expected (..., {size})")
    return array


def scalar(name: str, value: ArrayLike) -> float:
    """Return `value` as a finite float.

    Raises
    ------
    InvalidArgument
        If it is not one finite real number.
    """
    array = finite(name, value)
    if array.ndim:
        raise InvalidArgument(f"{name} has shape {array.shape}, expected one number")
    return float(array)


def positive(name: str, value: ArrayLike, unit: str = "") -> float:
    """Return `value` as a finite float above zero.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    number = scalar(name, value)
    if not number > 0:
        raise InvalidArgument(f"{name} is {number}{unit and ' ' + unit}, expected > 0")
    return number


def non_negative(name: str, value: ArrayLike, unit: str = "") -> float:
    """Return `value` as a finite float of at least zero.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    number = scalar(name, value)
    if number < 0:
        raise InvalidArgument(f"{name} is {number}{unit and ' ' + unit}, expected >= 0")
    return number


def whole(name: str, value: Any, *, least: int = 1) -> int:
    """Return `value` as an int of at least `least`.

    Raises
    ------
    InvalidArgument
        If it is not a whole number, or less.
    """
    if type(value) is int and value >= least:
        return value
    try:
        number = scalar(name, value)
    except InvalidArgument:
        number = least - 1.0  # whatever it is, it is not such a number
    if number != int(number) or number < least:
        raise InvalidArgument(f"{name} is {value!r}, expected a whole number >= {least}")
    return int(number)


def seeded(name: str, seed: Any) -> "np.random.Generator":
    """Return the generator of a seed; one that is a generator comes back as it is.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    seed : int, SeedSequence, BitGenerator or Generator
        The argument.

    Raises
    ------
    InvalidArgument
        If it is none of these: without a seed, nothing could be repeated.
    """
    # The annotation is text, since numpy loads its random module only when it is named.
    try:
        if seed is None or isinstance(seed, bool):
            raise TypeError
        return np.random.default_rng(seed)
    except (TypeError, ValueError):
        raise InvalidArgument(f"{name} is {seed!r}, expected a whole number >= 0 or a Generator") from None


def location(name: str, value: Any) -> Path:
    """Return `value` as a path.

    Raises
    ------
    InvalidArgument
        If it is neither text nor a path.
    """
    if not isinstance(value, str | PathLike):
        raise InvalidArgument(f"{name} is {value!r}, expected the path of a file")
    return Path(value)


def broadcast(**arrays: Array) -> tuple[int, ...]:
    """Return the shape that the leading axes of arrays of shape (..., n) broadcast to.

    Raises
    ------
    InvalidArgument
        If they do not; the message names the arrays.
    """
    try:
        return np.broadcast_shapes(*(array.shape[:-1] for array in arrays.values()))
    except ValueError:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise InvalidArgument(f"shapes are {shapes}, expected leading axes that broadcast") from None


def frozen(array: ArrayLike) -> Array:
    """Return a read-only float64 copy; an array that is one, and owns its memory, comes back as it is."""
    if type(array) is np.ndarray and array.base is None and not array.flags.writeable:
        return array.astype(np.float64, copy=False)
    copy = np.array(array, dtype=np.float64)
    copy.setflags(write=False)
    return copy


HALF_TURN = 1e-9
"""An angle that is half a turn but for this [rad] is one to the left; rounding does not choose the side."""

LEAST_ANGLE = HALF_TURN - np.pi
"""Angles on the circle are above it [rad]."""


def wrap_angle(angle: Array) -> Array:
    """Return the angle on the circle, in (-pi, pi]; one that is already there comes back as it is.

    Half a turn is pi, also where rounding has made it -pi and a little.

    Parameters
    ----------
    angle : ndarray, any shape
        Angle [rad].
    """
    top = np.pi + HALF_TURN
    wrapped = np.minimum(top - np.mod(top - angle, 2 * np.pi), np.pi)
    return np.where((angle > LEAST_ANGLE) & (angle <= np.pi), angle, wrapped)
