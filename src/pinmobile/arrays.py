"""The array type, angles on the circle, and the one place where arguments are checked."""

from __future__ import annotations

import inspect
import os
import re
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import wraps
from math import isfinite
from os import PathLike
from pathlib import Path
from types import CodeType, FunctionType, MethodType
from typing import Any, TypeAlias, TypeVar, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike as ArrayLike, NDArray

from pinmobile.errors import InvalidArgument, NotFinite, UnknownName, shown

Array: TypeAlias = NDArray[np.float64]
_Function = TypeVar("_Function")
_Kind = TypeVar("_Kind")
_Shaped = TypeVar("_Shaped")

MEMORY = 16e9
"""What one call may ask for in arrays of its own [bytes]: more is refused, with the number, before it is."""

_FEW = 1000  # numbers whose product takes less than a look at each; of many, BLAS would start threads
_FLOAT = np.dtype(np.float64)
_LARGEST = float(np.finfo(np.float64).max)
_MOST_AXES = 24  # room for some more within the 32 that NumPy broadcasts


def finite(name: str, value: ArrayLike) -> Array:
    """Check that `value` is made of finite real numbers, and return it as float64.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, any shape
        The argument.

    Raises
    ------
    InvalidArgument
        If `value` is not numeric, is ragged, complex or masked, or holds NaN or infinity.
    """
    if (
        type(value) is np.ndarray
        and value.dtype == np.float64
        and value.ndim == 1
        and value.size <= _FEW
        and isfinite(np.vdot(value, value))
    ):
        return value  # what comes in a loop: one call instead of five; where it overflows, look closely
    if type(value) is float and isfinite(value):
        return np.asarray(value)  # the other thing that comes often
    if getattr(type(value), "is_symbolic", False):
        return value  # type: ignore[return-value]  # symbols of `compiled`, which have no numbers yet
    array = real(name, value)
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        place = f"[{', '.join(map(str, where))}]" if where else ""
        raise InvalidArgument(f"{name}{place} is {array[where]}, expected a finite number", name)
    return array


def finite_answer(answer: Array, /, **arguments: ArrayLike) -> Array:
    """Check that an answer is finite where its arguments are, and return it.

    Parameters
    ----------
    answer : ndarray, any shape
        What was computed.
    **arguments : array_like, any shape
        From what, by name, for the message.

    Raises
    ------
    NotFinite
        If it holds NaN or infinity.
    """
    # One product, which unlike that of `dot` does not warn, instead of a look at each number.
    few = answer.size <= _FEW
    if (few and isfinite(np.vdot(answer, answer))) or np.isfinite(answer).all():
        return answer
    bad = answer[~np.isfinite(answer)][0]
    sizes = ", ".join(f"|{name}| up to {np.abs(value).max():.3g}" for name, value in arguments.items())
    raise NotFinite(f"the answer is {bad} for {sizes}, made of numbers beyond 1.8e308: expected smaller ones")


def in_numbers(function: _Function) -> _Function:
    """Let a function answer in finite numbers, or raise `NotFinite` with how large its arguments are.

    It is for functions of numbers that answer with an array, or with a tuple of which some are arrays.
    """

    @wraps(function)  # type: ignore[arg-type]
    def asked(*arguments: Any, **named: Any) -> Any:
        with np.errstate(all="ignore"):
            try:
                answer = function(*arguments, **named)  # type: ignore[operator]
            except (np.linalg.LinAlgError, ZeroDivisionError):
                answer = np.array(np.nan)
        for part in answer if isinstance(answer, tuple) else (answer,):
            if type(part) is np.ndarray and part.dtype == _FLOAT and not np.isfinite(part).all():
                # Here, as what a law's code holds beside functions would keep a loop from being remembered.
                given = inspect.signature(function).bind(*arguments, **named).arguments  # type: ignore[arg-type]
                finite_answer(part, **{name: x for name, x in given.items() if name != "self" and np.size(x)})
        return answer

    return asked  # type: ignore[return-value]


def endless_or_finite(name: str, value: ArrayLike) -> Array:
    """Return `value` as float64, of limits: as `finite`, but infinity, for there is none, is taken too.

    Raises
    ------
    InvalidArgument
        As `finite`, of minus infinity as well.
    """
    array = real(name, value)
    endless = np.isposinf(array)
    return np.where(endless, np.inf, finite(name, np.where(endless, 0.0, array)))


def _array(value: object) -> np.ndarray[Any, Any]:
    """Return a value as an array; of what has no numbers, one of objects."""
    try:
        return np.asarray(float(value) if type(value) is int else value)  # 10**22 is no integer of NumPy's
    except Exception:  # whatever the value itself raises when it is asked for its numbers
        return np.asarray(None)


def _hides(value: object) -> bool:
    """Return whether a value is a masked array, or a list in which there is one."""
    # Where it is not loaded, or another thread is about to, there is none.
    masked = getattr(sys.modules.get("numpy.ma"), "MaskedArray", None)
    if masked is None:
        return False
    waiting, seen = [value], set()
    while waiting:
        part = waiting.pop()
        if isinstance(part, masked):
            return True
        if isinstance(part, list | tuple) and id(part) not in seen and not set(map(type, part)) <= _PLAIN:
            seen.add(id(part))  # a list may hold itself
            waiting.extend(part)
    return False


_PLAIN = {float, int, np.float64}


def real(name: str, value: ArrayLike) -> Array:
    """Check that `value` is made of real numbers, NaN and infinity allowed, and return it as float64.

    Raises
    ------
    InvalidArgument
        If `value` is not numeric, is ragged, complex or masked.
    """
    if _hides(value):
        raise InvalidArgument(
            f"{name} is a masked array, expected one without a mask: fill it, or leave out what is masked"
        )
    array = _array(value)
    if array.dtype.kind not in "fiu":
        raise InvalidArgument(f"{name} is {shown(value)}, expected real numbers")
    if array.ndim > _MOST_AXES:
        raise InvalidArgument(f"{name} has {array.ndim} axes, expected at most {_MOST_AXES}")
    if array.dtype == np.float64:
        return np.asarray(array, np.float64)
    with np.errstate(over="ignore"):  # a long double that float64 does not hold becomes infinite
        return array.astype(np.float64)


def are_real(answer: object) -> bool:
    """Return whether what a part returned holds real numbers: no complex ones, no text, no other objects.

    Of what is no array, such as a symbol, nothing is asked.
    """
    return type(answer) is not np.ndarray or answer.dtype is _FLOAT or answer.dtype.kind in "fiub"


def answered(what: str, answer: object, expected: str = "real numbers") -> Array:
    """Return what a part returned as float64; `expected` is said where it is something else.

    Raises
    ------
    InvalidArgument
        If it is not made of real numbers.
    """
    found = _array(answer)
    if not are_real(found):
        raise InvalidArgument(f"{what} returned {shown(answer)}, expected {expected}")
    return np.array(found, np.float64)


def shaped(name: str, array: _Shaped, *shapes: tuple[int | str, ...], words: str = "") -> _Shaped:
    """Return an array that has one of some shapes.

    Parameters
    ----------
    name : str
        What it is called.
    array : ndarray
        The array.
    *shapes : tuples of int and str
        A letter is any length, the same wherever it stands in a shape; ``"n>=2"`` sets its bound, ``"..."``
        at first any leading axes.
    words : str
        What follows the shapes in the message.

    Raises
    ------
    InvalidArgument
        If it has another shape.
    """
    found = np.shape(cast(Any, array))
    if found not in shapes and not any(_fits(found, shape) for shape in shapes):
        raise InvalidArgument(f"{name} has shape {found}, expected {shapes_in_words(shapes)}{words}")
    return array


def shapes_in_words(shapes: Sequence[tuple[int | str, ...]]) -> str:
    """Return shapes as `shaped` takes them in words, such as ``(), (3,) or (3, 3)``."""
    if tuple(shapes) == ((),):
        return "one number"
    told = [re.sub(r"'|>=\d+", "", str(shape)) for shape in shapes]
    *first, last = told
    bounds = [each.replace(">=", " >= ") for shape in shapes for each in map(str, shape) if ">=" in each]
    return ", ".join([f"{', '.join(first)} or {last}" if first else last, *bounds])


def _fits(shape: tuple[int, ...], wanted: tuple[int | str, ...]) -> bool:
    if wanted[:1] == ("...",):
        wanted = wanted[1:]
        shape = shape[max(len(shape) - len(wanted), 0) :]
    if len(shape) != len(wanted):
        return False
    lengths: dict[str, int] = {}
    for n, each in zip(shape, wanted, strict=True):
        letter, _, least = str(each).partition(">=")
        if n != (each if isinstance(each, int) else lengths.setdefault(letter, n)) or n < int(least or 0):
            return False
    return True


def vector(name: str, value: ArrayLike, size: int) -> Array:
    """Return `value` as float64 of shape (..., size).

    Raises
    ------
    InvalidArgument
        If the last axis has another length, or an entry is not finite.
    """
    array = finite(name, value)
    return array if array.shape[-1:] == (size,) else shaped(name, array, ("...", size))


def scalar(name: str, value: ArrayLike) -> float:
    """Return `value` as a finite float.

    Raises
    ------
    InvalidArgument
        If it is not one finite real number.
    """
    array = finite(name, value)
    return float(shaped(name, array, ()) if array.ndim else array)


def bounded(
    name: str,
    value: _Shaped,
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    unit: str = "",
) -> _Shaped:
    """Return numbers that are all within bounds, `least` and `most` included, `above` and `below` not.

    Raises
    ------
    InvalidArgument
        If one is not; the message names the first.
    """
    numbers = np.asarray(value)
    bounds = {">": above, ">=": least, "<": below, "<=": most}
    given = [(sign, bound) for sign, bound in bounds.items() if bound is not None]
    wrong = ~np.all([_COMPARED[sign](numbers, bound) for sign, bound in given], axis=0)
    if wrong.any():
        at = tuple(int(i) for i in np.argwhere(wrong)[0])
        place, unit = f"[{', '.join(map(str, at))}]" if at else "", unit and f" {unit}"
        if len(given) == 2:
            (first, low), (second, high) = given
            words = f"{low:.9g} {first.replace('>', '<')} {name} {second} {high:.9g}{unit}"
        else:
            words = " ".join(f"{sign} {bound:.9g}" for sign, bound in given)
        raise InvalidArgument(f"{name}{place} is {numbers[at]}{unit}, expected {words}")
    return value


_COMPARED = {">": np.greater, ">=": np.greater_equal, "<": np.less, "<=": np.less_equal}


def positive(name: str, value: ArrayLike, unit: str = "") -> float:
    """Return `value` as a finite float above zero.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    return bounded(name, scalar(name, value), above=0, unit=unit)


def non_negative(name: str, value: ArrayLike, unit: str = "") -> float:
    """Return `value` as a finite float of at least zero.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    return bounded(name, scalar(name, value), least=0, unit=unit)


def positive_or_endless(name: str, value: ArrayLike, unit: str = "") -> float:
    """Return `value`, a limit, as a float above zero; infinity, for there is none, is taken too.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    limit = endless_or_finite(name, value)
    return np.inf if not limit.ndim and limit > _LARGEST else positive(name, limit, unit)


def whole(name: str, value: Any, *, least: int = 1, most: int = 2**53) -> int:
    """Return `value` as an int from `least` to `most`.

    Raises
    ------
    InvalidArgument
        If it is not a whole number, or less or more.
    """
    if type(value) is int and least <= value <= most:
        return value
    try:
        number = scalar(name, value)
    except InvalidArgument:
        number = least - 1.0  # whatever it is, it is not such a number
    if number != int(number) or number < least:
        raise InvalidArgument(f"{name} is {shown(value)}, expected a whole number >= {least}")
    if number > most:
        raise InvalidArgument(f"{name} is {shown(value)}, expected at most {most:,}")
    return int(number)


def seeded(name: str, seed: Any) -> np.random.Generator:
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
    kinds = np.random.Generator, np.random.BitGenerator, np.random.SeedSequence
    if not isinstance(seed, kinds):
        try:
            seed = seed if type(seed) is int and seed >= 0 else whole(name, seed, least=0)
        except InvalidArgument:
            raise InvalidArgument(
                f"{name} is {shown(seed)}, expected a whole number >= 0 or a Generator"
            ) from None
    return np.random.default_rng(seed)


def location(name: str, value: object) -> Path:
    """Return `value` as a path.

    Raises
    ------
    InvalidArgument
        If it is neither text nor a path, or one that no file can have.
    """
    given = instance(name, value, str | PathLike, "the path of a file")
    try:
        path = Path(given)
        named = os.fsencode(path)
    except (TypeError, UnicodeEncodeError):
        named = b"\0"
    if b"\0" in named or max(map(len, named.split(b"/"))) > _LONGEST_NAME:
        raise InvalidArgument(
            f"{name} is {shown(str(value))}, expected the path of a file: letters that a file's name can "
            f"have, at most {_LONGEST_NAME} bytes between two slashes"
        )
    return path


_LONGEST_NAME = 255  # on all file systems of Linux and macOS


def text(name: str, value: object) -> str:
    """Check that `value` is text that can be written to a file, and return it.

    Raises
    ------
    InvalidArgument
        If it is something else, or holds half of a surrogate pair, a null, or another control character.
    """
    from unicodedata import category  # here, because names and headings are rare

    if not isinstance(value, str) or any(category(letter) in _UNWRITTEN for letter in value):
        raise InvalidArgument(f"{name} is {shown(value)}, expected text without control characters")
    return value


_UNWRITTEN = {"Cs", "Cc"}  # surrogates and control characters


def representable(what: str, array: Array) -> Array:
    """Check that a result has not overflowed on its way, and return it.

    Parameters
    ----------
    what : str
        The result in words, for the message.
    array : ndarray, any shape
        It, calculated under ``np.errstate(all="ignore")`` from finite numbers.

    Raises
    ------
    InvalidArgument
        If a number is not finite.
    """
    if not np.isfinite(array).all():
        raise InvalidArgument(f"{what} is beyond the largest number, expected arguments of another size")
    return array


def instance(name: str, value: object, kind: Any, expected: str) -> Any:
    """Return a value of a type; `expected` is what the message asks for.

    Raises
    ------
    InvalidArgument
        If it is of another type.
    """
    if not isinstance(value, kind):
        raise InvalidArgument(f"{name} is {shown(value)}, expected {expected}")
    return value


def mapping(name: str, value: object, expected: str) -> Mapping[Any, Any]:
    """Return a mapping that is not empty; `expected` is what the message asks for.

    Raises
    ------
    InvalidArgument
        If it is something else, or empty.
    """
    if not isinstance(value, Mapping) or not value:
        raise InvalidArgument(f"{name} is {shown(value)}, expected {expected}")
    return value


def by_label(argument: str, values: object, kind: type[_Kind]) -> dict[str, _Kind]:
    """Return objects by label; a single one has the label "".

    Parameters
    ----------
    argument : str
        Name of the argument, for the message.
    values : object or mapping of str to object
        One object, or several by label.
    kind : type
        What each must be.

    Raises
    ------
    InvalidArgument
        If it is something else, or holds nothing.
    """
    what = kind.__name__
    one = f"{'an' if what[0] in 'AEIOU' else 'a'} {what}"
    if isinstance(values, kind):
        return {"": values}
    found = mapping(argument, values, f"{one} or a mapping of labels to {what}s")
    for label, value in found.items():
        text(f"a label of {argument}", label)
        instance(f"{argument}[{label!r}]", value, kind, one)
    return dict(found)


def one_of(kind: str, value: object, available: Iterable[str]) -> str:
    """Check that `value` is one of the names there are, and return it.

    Parameters
    ----------
    kind : str
        What is named, such as ``"frame"``.
    value : str
        The argument.
    available : iterable of str
        The names there are.

    Raises
    ------
    UnknownName
        If it is none of them.
    """
    names = available if isinstance(available, Collection) else tuple(available)
    if not isinstance(value, str) or value not in names:
        raise UnknownName(kind, value, names)
    return value


def lengths(size: ArrayLike) -> Array:
    """Return the argument `size` of a box as float64, shape (3,) [m].

    Raises
    ------
    InvalidArgument
        If it is not three lengths above zero.
    """
    return bounded("size", shaped("size", finite("size", size), (3,)), above=0, unit="m")


def sequence(name: str, value: object, expected: str) -> tuple[Any, ...]:
    """Return the entries of a list, tuple or other sequence, but not of text, a mapping or a set.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : sequence
        The argument.
    expected : str
        What is expected, for the message, such as ``"a sequence of DHRow"``.

    Raises
    ------
    InvalidArgument
        If it is no sequence.
    """
    if isinstance(value, np.ndarray) and value.ndim == 1:
        return tuple(value.tolist())
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise InvalidArgument(f"{name} is {shown(value)}, expected {expected}")
    return tuple(value)


def callable_as(form: str, function: _Function, expected: str = "") -> _Function:
    """Check that a user's function can be called in this way, and return it.

    Parameters
    ----------
    form : str
        Name of the argument and how it is called, such as ``"function(t, q, v, reference)"``.
    function : callable
        The argument.
    expected : str, optional
        What is expected where it is no function, for the message.

    Raises
    ------
    InvalidArgument
        If it is no function, or its signature has no room for these arguments. What it raises itself when it
        is called later comes through.
    """
    name, _, inside = form.rstrip(")").partition("(")
    arguments = inside.split(", ") if inside else []
    if isinstance(function, type) or not callable(function):
        wanted = expected or f"a function of {', '.join(arguments[:-1])} and {arguments[-1]}"
        raise InvalidArgument(f"{name} is {shown(function)}, expected {wanted}")
    code, *rest = _code_of(function)
    call = form, *rest
    if code is not None and call in _fitting.get(code, ()):
        return function
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # as of some that are built in
        return function
    try:
        signature.bind(*arguments)
    except TypeError as error:
        raise InvalidArgument(
            f"{name} is {shown(function)}, which cannot be called as {form}: {error}, expected one that can"
        ) from None
    if code is not None:
        _fitting.setdefault(code, set()).add(call)
    return function


def _code_of(function: object) -> tuple[Any, ...]:
    """Return the code of a function, method or callable object, and what else its signature hangs on.

    None comes first where that is more than its code and its defaults.
    """
    bound, law = not isinstance(function, FunctionType), function
    if bound:
        law = function.__func__ if isinstance(function, MethodType) else type(function).__call__
    if not isinstance(law, FunctionType) or vars(law) or hasattr(function, "__signature__"):
        return (None,)
    return law.__code__, bound, len(law.__defaults__ or ()), *sorted(law.__kwdefaults__ or ())


# Calls that are known to fit a code: to look closely takes some 50 us.
_fitting: WeakKeyDictionary[CodeType, set[tuple[Any, ...]]] = WeakKeyDictionary()


def increasing(name: str, t: Array) -> None:
    """Refuse times that are none, or do not increase.

    Raises
    ------
    InvalidArgument
        If `t` is not of shape (N,), N > 0, with each time after the one before.
    """
    shaped(name, t, ("n>=1",))
    if not (t[1:] > t[:-1]).all():
        late = int(np.argmin(t[1:] > t[:-1]))
        raise InvalidArgument(f"{name}[{late + 1}] is {t[late + 1]} s after {t[late]} s, expected more")


def affordable(what: str, numbers: float, instead: str) -> None:
    """Refuse arrays of more than `MEMORY` before the memory is asked for.

    Parameters
    ----------
    what : str
        Whose arrays, for the message, such as ``"the records of 1e9 samples"``.
    numbers : float
        How many numbers of 8 bytes.
    instead : str
        What to do instead.

    Raises
    ------
    InvalidArgument
        If they are too many; the message has the number of bytes.
    """
    if not 8 * numbers <= MEMORY:
        raise InvalidArgument(
            f"{what} take {8e-9 * numbers:.3g} GB, expected at most {1e-9 * MEMORY:g} GB: {instead}"
        )


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
    """Return a float64 copy that nobody can write into; what is one already comes back as it is.

    Its memory is that of `bytes`: a read-only array of a user's own could be made writable again.
    """
    if getattr(type(array), "is_symbolic", False):
        return array  # type: ignore[return-value]
    if type(array) is np.ndarray and isinstance(array.base, bytes) and array.dtype == np.float64:
        return array
    whole = np.asarray(array, dtype=np.float64)
    return np.ndarray(whole.shape, np.float64, whole.tobytes())


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
