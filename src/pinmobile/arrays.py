"""Array type, angles on the circle, and checks of arguments."""

from __future__ import annotations

import inspect
import re
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import wraps
from math import isfinite
from os import PathLike
from pathlib import Path
from types import CodeType, FunctionType, MethodType
from typing import Any, TypeAlias, TypeVar, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike as ArrayLike, NDArray

from pinmobile.errors import InvalidArgument, NotFinite, UnknownName, format_value, unexpected_value

Array: TypeAlias = NDArray[np.float64]
_Function = TypeVar("_Function")
_Kind = TypeVar("_Kind")
_Shaped = TypeVar("_Shaped")

MEMORY = 16e9
"""Largest memory that one call may allocate for arrays [bytes]; the value is 16e9."""

_VDOT_SIZE = 1000  # largest array whose product is faster than a check of each entry; BLAS uses threads above
_FLOAT = np.dtype(np.float64)
_LARGEST = float(np.finfo(np.float64).max)


def finite(name: str, value: ArrayLike) -> Array:
    """Return finite real numbers as a float64 array.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, any shape
        Value of the argument.

    Returns
    -------
    ndarray, same shape
        Value as float64.

    Raises
    ------
    InvalidArgument
        If the value is not numeric, is ragged, complex or masked, or contains NaN or infinity.

    See Also
    --------
    arrays.real : numbers that may be NaN or infinite.
    arrays.vector : numbers whose last axis has a given length.

    Examples
    --------
    >>> from pinmobile.arrays import finite
    >>> finite("kp", [120, 120, 8])
    array([120., 120.,   8.])
    """
    if (
        type(value) is np.ndarray
        and value.dtype == np.float64
        and value.ndim == 1
        and value.size <= _VDOT_SIZE
        and isfinite(np.vdot(value, value))
    ):
        return value  # fast check for loops; if the product overflows, the checks below decide
    if type(value) is float and isfinite(value):
        return np.asarray(value)  # frequent in loops, too
    if getattr(type(value), "is_symbolic", False):
        return value  # type: ignore[return-value]  # symbols of `compiled` have no numbers
    array = real(name, value)
    if not np.isfinite(array).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        place = f"[{', '.join(map(str, index))}]" if index else ""
        raise InvalidArgument(f"{name}{place} is {array[index]}, expected a finite number", name)
    return array


def finite_answer(answer: Array, /, **arguments: ArrayLike) -> Array:
    """Return a result that must be finite because its arguments are finite.

    Parameters
    ----------
    answer : ndarray, any shape
        Result of a computation.
    **arguments : array_like, any shape
        Arguments of the computation by name, for the message.

    Returns
    -------
    ndarray, same shape
        The same array.

    Raises
    ------
    NotFinite
        If the result contains NaN or infinity.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import finite_answer
    >>> finite_answer(np.array([1.0, 2.0]), mass=30.0)
    array([1., 2.])
    """
    # One product is faster than a check of each entry; `vdot` does not warn, `dot` does.
    is_small = answer.size <= _VDOT_SIZE
    if (is_small and isfinite(np.vdot(answer, answer))) or np.isfinite(answer).all():
        return answer
    x = answer[~np.isfinite(answer)][0]
    sizes = ", ".join(f"|{name}| up to {np.abs(value).max():.3g}" for name, value in arguments.items())
    raise NotFinite(f"the result is {x} for {sizes}: a number exceeds 1.8e308, expected smaller arguments")


def finite_result(function: _Function) -> _Function:
    """Decorate a function of numbers: if its result is not finite, the function raises `NotFinite`.

    The message contains the size of each argument. The decorated function returns an array or a tuple; some
    entries of the tuple may be arrays.

    Parameters
    ----------
    function : callable
        Function of numbers.

    Returns
    -------
    callable
        Decorated function.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import finite_result
    >>> inverse = finite_result(lambda x: 1 / np.asarray(x))
    >>> inverse([2.0, 4.0])
    array([0.5 , 0.25])
    """

    @wraps(function)  # type: ignore[arg-type]
    def run(*arguments: Any, **keywords: Any) -> Any:
        with np.errstate(all="ignore"):
            try:
                answer = function(*arguments, **keywords)  # type: ignore[operator]
            except (np.linalg.LinAlgError, ZeroDivisionError):
                answer = np.array(np.nan)
        for part in answer if isinstance(answer, tuple) else (answer,):
            if type(part) is np.ndarray and part.dtype == _FLOAT and not np.isfinite(part).all():
                # Inside the function: other objects in the closure of a law would prevent its caching.
                bound = inspect.signature(function).bind(*arguments, **keywords).arguments  # type: ignore[arg-type]
                finite_answer(part, **{name: x for name, x in bound.items() if name != "self" and np.size(x)})
        return answer

    return run  # type: ignore[return-value]


def endless_or_finite(name: str, value: ArrayLike) -> Array:
    """Return limits as a float64 array; infinity is allowed and means that there is no limit.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, any shape
        Limits.

    Returns
    -------
    ndarray, same shape
        Limits as float64.

    Raises
    ------
    InvalidArgument
        If the value is minus infinity, NaN or not numeric.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import endless_or_finite
    >>> endless_or_finite("limit", [2.0, np.inf])
    array([ 2., inf])
    """
    array = real(name, value)
    endless = np.isposinf(array)
    return np.where(endless, np.inf, finite(name, np.where(endless, 0.0, array)))


def _array(value: object) -> np.ndarray[Any, Any]:
    """Return a value as an array; a value without numbers becomes an array of objects."""
    try:
        return np.asarray(float(value) if type(value) is int else value)  # NumPy has no integer for 10**22
    except Exception:  # the conversion of the value may raise any error
        return np.asarray(None)


def real(name: str, value: ArrayLike) -> Array:
    """Return real numbers as a float64 array; NaN and infinity are allowed.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, any shape
        Value of the argument.

    Returns
    -------
    ndarray, same shape
        Value as float64.

    Raises
    ------
    InvalidArgument
        If the value is not numeric, is ragged, complex or masked.

    See Also
    --------
    arrays.finite : finite numbers.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import real
    >>> real("gap", [1, np.nan])
    array([ 1., nan])
    """
    mask_type = getattr(sys.modules.get("numpy.ma"), "MaskedArray", ())  # not loaded: there is none
    kinds = {type(value), *map(type, value)} if isinstance(value, list | tuple) else {type(value)}
    is_masked, array = any(issubclass(kind, mask_type) for kind in kinds), _array(value)
    if is_masked or array.dtype.kind not in "fiu":
        masked = "a masked array, expected an array without a mask: fill or remove the masked entries"
        fault = masked if is_masked else f"{format_value(value)}, expected real numbers"
        raise InvalidArgument(f"{name} is {fault}")
    if array.dtype == np.float64:
        return np.asarray(array, np.float64)
    with np.errstate(over="ignore"):  # a long double beyond float64 becomes infinite
        return array.astype(np.float64)


def are_real(answer: object) -> bool:
    """Return whether an array contains real numbers; True for objects that are not arrays, such as symbols.

    Parameters
    ----------
    answer : object
        Result of a part.

    Returns
    -------
    bool
        False for an array of complex numbers, text or other objects.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import are_real
    >>> are_real(np.array([1.0])), are_real(np.array([1j]))
    (True, False)
    """
    return type(answer) is not np.ndarray or answer.dtype is _FLOAT or answer.dtype.kind in "fiub"


def check_returned_array(
    label: str, answer: object, expected: str = "real numbers", shape: tuple[int, ...] | None = None
) -> Array:
    """Return the result of a part as a float64 array.

    Parameters
    ----------
    label : str
        Name of the part, for the message.
    answer : object
        Result of the part.
    expected : str
        Expected result, for the message.
    shape : tuple of int, optional
        Expected shape; default: any.

    Returns
    -------
    ndarray
        Copy of the result.

    Raises
    ------
    InvalidArgument
        If the result does not consist of real numbers, or has another shape.

    Examples
    --------
    >>> from pinmobile.arrays import check_returned_array
    >>> check_returned_array("forces[0]", [0, 5, 0])
    array([0., 5., 0.])
    """
    array = _array(answer)
    if not are_real(array) or shape not in (None, array.shape):
        raise InvalidArgument(f"{label} returned {format_value(answer)}, expected {expected}")
    return np.array(array, np.float64)


def check_repeat(name: str, part: object, first: Array, last: Array, tolerance: float, hint: str) -> None:
    """Check that a part returned the same array again for the same arguments.

    Parameters
    ----------
    name, part : str, object
        Name and value of the part, for the message.
    first, last : ndarray
        The results.
    tolerance : float
        Absolute and relative tolerance.
    hint : str
        End of the message.

    Raises
    ------
    InvalidArgument
        If the results differ.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import check_repeat
    >>> check_repeat("forces[0]", None, np.ones(3), np.ones(3), 1e-9, "forces have no memory")
    """
    is_same = first.shape == last.shape
    if not (is_same and np.allclose(first, last, rtol=tolerance, atol=tolerance, equal_nan=True)):
        raise InvalidArgument(
            f"{name} is {format_value(part)}, which returns {first.tolist()} and, called again with the same "
            f"arguments, {last.tolist()}, expected the same: {hint}"
        )


def shaped(name: str, array: _Shaped, *shapes: tuple[int | str, ...], words: str = "") -> _Shaped:
    """Return an array that has one of the given shapes.

    Parameters
    ----------
    name : str
        Name of the array, for the message.
    array : ndarray
        Array to check.
    *shapes : tuple of int and str
        Allowed shapes. A letter stands for any length, the same one everywhere in a shape; ``"n>=2"`` adds a
        lower bound. ``"..."`` at the beginning stands for any leading axes.
    words : str
        Text after the shapes in the message.

    Returns
    -------
    ndarray
        The same array.

    Raises
    ------
    InvalidArgument
        If the array has another shape.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import shaped
    >>> shaped("kp", np.ones(3), (), ("n",), ("n", "n"))
    array([1., 1., 1.])
    """
    size = np.shape(cast(Any, array))
    if size not in shapes and not any(_fits(size, shape) for shape in shapes):
        raise InvalidArgument(f"{name} has shape {size}, expected {format_shapes(shapes)}{words}")
    return array


def format_shapes(shapes: Sequence[tuple[int | str, ...]]) -> str:
    """Return shapes as text.

    Parameters
    ----------
    shapes : sequence of tuple
        Shapes in the notation of `shaped`.

    Returns
    -------
    str
        Text of the shapes.

    Examples
    --------
    >>> from pinmobile.arrays import format_shapes
    >>> format_shapes([(), (3,), (3, 3)])
    '(), (3,) or (3, 3)'
    """
    if tuple(shapes) == ((),):
        return "one number"
    words = [re.sub(r"'|>=\d+", "", str(shape)) for shape in shapes]
    *first, last = words
    bounds = [size.replace(">=", " >= ") for shape in shapes for size in map(str, shape) if ">=" in size]
    return ", ".join([f"{', '.join(first)} or {last}" if first else last, *bounds])


def _fits(shape: tuple[int, ...], pattern: tuple[int | str, ...]) -> bool:
    if pattern[:1] == ("...",):
        pattern = pattern[1:]
        shape = shape[max(len(shape) - len(pattern), 0) :]
    if len(shape) != len(pattern):
        return False
    lengths: dict[str, int] = {}
    for n, size in zip(shape, pattern, strict=True):
        letter, _, minimum = str(size).partition(">=")
        if n != (size if isinstance(size, int) else lengths.setdefault(letter, n)) or n < int(minimum or 0):
            return False
    return True


def vector(name: str, value: ArrayLike, size: int) -> Array:
    """Return finite numbers as a float64 array whose last axis has a given length.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, shape (..., size)
        Value of the argument.
    size : int
        Length of the last axis.

    Returns
    -------
    ndarray, shape (..., size)
        Value as float64.

    Raises
    ------
    InvalidArgument
        If the last axis has another length, or an entry is not finite.

    Examples
    --------
    >>> from pinmobile.arrays import vector
    >>> vector("q", [0, 0, 1.57], 3)
    array([0.  , 0.  , 1.57])
    """
    array = finite(name, value)
    return array if array.shape[-1:] == (size,) else shaped(name, array, ("...", size))


def scalar(name: str, value: ArrayLike) -> float:
    """Return a finite real number as a float.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, shape ()
        Value of the argument.

    Returns
    -------
    float
        Value of the argument.

    Raises
    ------
    InvalidArgument
        If the value is not one finite real number.

    Examples
    --------
    >>> from pinmobile.arrays import scalar
    >>> scalar("dt", 1)
    1.0
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
    """Return numbers that must be within bounds.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, any shape
        Finite numbers.
    above : float, optional
        Lower bound, excluded.
    least : float, optional
        Lower bound, included.
    below : float, optional
        Upper bound, excluded.
    most : float, optional
        Upper bound, included.
    unit : str
        Unit, for the message.

    Returns
    -------
    array_like
        The same value.

    Raises
    ------
    InvalidArgument
        If a number is out of bounds; the message shows the first one.

    Examples
    --------
    >>> from pinmobile.arrays import bounded
    >>> bounded("share", 0.99, least=0, most=1)
    0.99
    """
    numbers = np.asarray(value)
    bounds = {">": above, ">=": least, "<": below, "<=": most}
    limits = [(sign, bound) for sign, bound in bounds.items() if bound is not None]
    outside = ~np.all([_COMPARISONS[sign](numbers, bound) for sign, bound in limits], axis=0)
    if outside.any():
        index = tuple(int(i) for i in np.argwhere(outside)[0])
        place, unit = f"[{', '.join(map(str, index))}]" if index else "", unit and f" {unit}"
        if len(limits) == 2:
            (first, low), (second, high) = limits
            words = f"{low:.9g} {first.replace('>', '<')} {name} {second} {high:.9g}{unit}"
        else:
            words = " ".join(f"{sign} {bound:.9g}" for sign, bound in limits)
        raise InvalidArgument(f"{name}{place} is {numbers[index]}{unit}, expected {words}")
    return value


_COMPARISONS = {">": np.greater, ">=": np.greater_equal, "<": np.less, "<=": np.less_equal}


def between(words: str, entries: Sequence[str], values: Array, lower: Array, upper: Array) -> None:
    """Check that each number is within its own bounds.

    Parameters
    ----------
    words : str
        Owner of the numbers, the beginning of the message.
    entries : sequence of str
        Names of the numbers.
    values, lower, upper : ndarray, shape (n,)
        Numbers and their bounds, which are allowed.

    Raises
    ------
    InvalidArgument
        If a number is out of bounds; the message names the first one.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import between
    >>> between("rest has", ["elbow"], np.array([0.3]), np.array([-1.0]), np.array([1.0]))
    """
    outside = ~((lower <= values) & (values <= upper))
    if outside.any():
        k = int(outside.argmax())
        bounds = f"{lower[k]:.9g} <= {entries[k]} <= {upper[k]:.9g}"
        raise InvalidArgument(f"{words} {entries[k]} = {values[k]:.9g}, expected {bounds}")


def positive(name: str, value: ArrayLike, unit: str = "") -> float:
    """Return a finite number > 0 as a float.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, shape ()
        Value of the argument.
    unit : str
        Unit, for the message.

    Returns
    -------
    float
        Value of the argument.

    Raises
    ------
    InvalidArgument
        If the value is not such a number.

    Examples
    --------
    >>> from pinmobile.arrays import positive
    >>> positive("dt", 0, "s")
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: dt is 0.0 s, expected > 0
    """
    return bounded(name, scalar(name, value), above=0, unit=unit)


def non_negative(name: str, value: ArrayLike, unit: str = "") -> float:
    """Return a finite number >= 0 as a float.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, shape ()
        Value of the argument.
    unit : str
        Unit, for the message.

    Returns
    -------
    float
        Value of the argument.

    Raises
    ------
    InvalidArgument
        If the value is not such a number.

    Examples
    --------
    >>> from pinmobile.arrays import non_negative
    >>> non_negative("friction", 0)
    0.0
    """
    return bounded(name, scalar(name, value), least=0, unit=unit)


def positive_or_endless(name: str, value: ArrayLike, unit: str = "") -> float:
    """Return a limit > 0 as a float; infinity is allowed and means that there is no limit.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, shape ()
        Limit.
    unit : str
        Unit, for the message.

    Returns
    -------
    float
        Limit.

    Raises
    ------
    InvalidArgument
        If the value is not such a number.

    Examples
    --------
    >>> from pinmobile.arrays import positive_or_endless
    >>> positive_or_endless("torque_limit", float("inf"))
    inf
    """
    limit = endless_or_finite(name, value)
    return np.inf if not limit.ndim and limit > _LARGEST else positive(name, limit, unit)


def check_integer(name: str, value: Any, *, least: int = 1, most: float = 2**53) -> int:
    """Return a whole number within bounds as an int.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : int or float
        Value of the argument.
    least : int
        Lower bound, included.
    most : float
        Upper bound, included.

    Returns
    -------
    int
        Value of the argument.

    Raises
    ------
    InvalidArgument
        If the value is not a whole number, or out of bounds.

    Examples
    --------
    >>> from pinmobile.arrays import check_integer
    >>> check_integer("substeps", 4.0)
    4
    """
    if type(value) is int and least <= value <= most:
        return value
    try:
        number = scalar(name, value)
    except InvalidArgument:
        number = least - 1.0  # a value out of bounds, which the next line rejects
    if number != int(number) or not least <= number <= most:
        expected = f"at most {most:,}" if number > most else f"a whole number >= {least}"
        raise unexpected_value(name, value, expected)
    return int(number)


def seeded(name: str, seed: Any) -> np.random.Generator:
    """Return a random number generator.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    seed : int, SeedSequence, BitGenerator or Generator
        Seed of a new generator; a Generator is returned unchanged.

    Returns
    -------
    numpy.random.Generator
        Random number generator.

    Raises
    ------
    InvalidArgument
        If the seed is anything else, None included: a run without a seed could not be repeated.

    Examples
    --------
    >>> from pinmobile.arrays import seeded
    >>> one, two = seeded("seed", 7), seeded("seed", 7)
    >>> one.random() == two.random()
    True
    """
    kinds = np.random.Generator, np.random.BitGenerator, np.random.SeedSequence
    if not isinstance(seed, kinds):
        seed = check_integer(name, seed, least=0, most=np.inf)
    return np.random.default_rng(seed)


def location(name: str, value: object) -> Path:
    """Return the path of a file.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : str or path
        Path.

    Returns
    -------
    pathlib.Path
        Path.

    Raises
    ------
    InvalidArgument
        If the value is neither text nor a path.

    Examples
    --------
    >>> from pinmobile.arrays import location
    >>> location("path", "runs/a.npz").name
    'a.npz'
    """
    return Path(instance(name, value, str | PathLike, "the path of a file"))


def text(name: str, value: object) -> str:
    """Return a value that must be text.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : str
        Text.

    Returns
    -------
    str
        The same text.

    Raises
    ------
    InvalidArgument
        If the value is not text.

    Examples
    --------
    >>> from pinmobile.arrays import text
    >>> text("label", "PD, kp = 120")
    'PD, kp = 120'
    """
    return instance(name, value, str, "text")  # type: ignore[no-any-return]


def matching(name: str, value: object, pattern: str, expected: str) -> str:
    """Return text that must match a pattern.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : str
        Text.
    pattern : str
        Regular expression of the whole text.
    expected : str
        Expected value, for the message.

    Returns
    -------
    str
        The same text.

    Raises
    ------
    InvalidArgument
        If the value is not text, or does not match.

    Examples
    --------
    >>> from pinmobile.arrays import matching
    >>> matching("name", "left arm", "[a-z ]+", "letters and spaces")
    'left arm'
    """
    if not isinstance(value, str) or not re.fullmatch(pattern, value):
        raise unexpected_value(name, value, expected)
    return value


def word(name: str, value: object, excluded: str) -> str:
    """Return text that must not be empty or contain certain letters.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : str
        Text.
    excluded : str
        Letters that the text must not contain.

    Raises
    ------
    InvalidArgument
        If the value is not such text.

    Examples
    --------
    >>> from pinmobile.arrays import word
    >>> word("name", "left arm", "/,")
    'left arm'
    """
    pattern = rf"(?=[\s\S]*\S)[^{re.escape(excluded)}]*"
    return matching(name, value, pattern, f"a word without {' '.join(excluded)}")


def check_overflow(label: str, array: Array) -> Array:
    """Return a result that must not have overflowed.

    Parameters
    ----------
    label : str
        Name of the result, for the message.
    array : ndarray, any shape
        Result of a computation from finite numbers under ``np.errstate(all="ignore")``.

    Returns
    -------
    ndarray, same shape
        The same array.

    Raises
    ------
    InvalidArgument
        If a number is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import check_overflow
    >>> check_overflow("length of the path", np.array(6.28))
    array(6.28)
    """
    if not np.isfinite(array).all():
        raise InvalidArgument(f"{label} is beyond the largest number, expected smaller arguments")
    return array


def instance(name: str, value: object, kind: Any, expected: str) -> Any:
    """Return a value that must be of a type.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : object
        Value of the argument.
    kind : type or tuple of type
        Allowed type.
    expected : str
        Expected value, for the message.

    Returns
    -------
    object
        The same value.

    Raises
    ------
    InvalidArgument
        If the value is of another type.

    Examples
    --------
    >>> from pinmobile.arrays import instance
    >>> instance("name", 5, str, "a name")
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: name is 5, expected a name
    """
    if not isinstance(value, kind):
        raise unexpected_value(name, value, expected)
    return value


def mapping(name: str, value: object, expected: str) -> Mapping[Any, Any]:
    """Return a mapping that must not be empty.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : mapping
        Value of the argument.
    expected : str
        Expected value, for the message.

    Returns
    -------
    mapping
        The same mapping.

    Raises
    ------
    InvalidArgument
        If the value is not a mapping, or is empty.

    Examples
    --------
    >>> from pinmobile.arrays import mapping
    >>> mapping("cases", {"nominal": {}}, "a mapping of cases")
    {'nominal': {}}
    """
    if not isinstance(value, Mapping) or not value:
        raise unexpected_value(name, value, expected)
    return value


def label_items(argument: str, values: object, kind: type[_Kind]) -> dict[str, _Kind]:
    """Return one or several objects of a class by label; a single object has the label "".

    Parameters
    ----------
    argument : str
        Name of the argument, for the message.
    values : object or mapping of str to object
        One object, or several objects by label.
    kind : type
        Class of the objects.

    Returns
    -------
    dict of str to object
        Objects by label.

    Raises
    ------
    InvalidArgument
        If the value is anything else, or empty.

    Examples
    --------
    >>> from pinmobile.arrays import label_items
    >>> label_items("runs", 1.5, float)
    {'': 1.5}
    """
    kind_name = kind.__name__
    words = f"{'an' if kind_name[0] in 'AEIOU' else 'a'} {kind_name}"
    if isinstance(values, kind):
        return {"": values}
    items = mapping(argument, values, f"{words} or a mapping of labels to {kind_name}s")
    for label, value in items.items():
        text(f"a label of {argument}", label)
        instance(f"{argument}[{label!r}]", value, kind, words)
    return dict(items)


def absent(reason: str, /, **given: object) -> None:
    """Check that arguments are None if they do not apply together with others.

    Parameters
    ----------
    reason : str
        Why they do not apply, the end of the message.
    **given : object
        Arguments by name.

    Raises
    ------
    InvalidArgument
        If one of them is not None.

    Examples
    --------
    >>> from pinmobile.arrays import absent
    >>> absent("with coefficients", forward=None, left=None)
    """
    for name, value in given.items():
        if value is not None:
            raise InvalidArgument(f"{name} is {format_value(value)}, expected None {reason}", name)


def required(name: str, value: Any, expected: str) -> Any:
    """Return an argument that must not be None.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : object
        Value of the argument.
    expected : str
        Expected value, for the message.

    Returns
    -------
    object
        The same value.

    Raises
    ------
    InvalidArgument
        If the value is None.

    Examples
    --------
    >>> from pinmobile.arrays import required
    >>> required("ahead", 0.2, "a number [m]")
    0.2
    """
    if value is None:
        raise InvalidArgument(f"{name} is None, expected {expected}")
    return value


def distinct(words: str, names: Iterable[str], hint: str = "") -> None:
    """Check that names are different.

    Parameters
    ----------
    words : str
        Owner of the names, the beginning of the message.
    names : iterable of str
        Names to check.
    hint : str
        End of the message.

    Raises
    ------
    InvalidArgument
        If two of them are equal.

    Examples
    --------
    >>> from pinmobile.arrays import distinct
    >>> distinct("rows have the variable", ["y", "x", "psi"])
    """
    for name, count in Counter(names).items():
        if count > 1:
            raise InvalidArgument(f"{words} {name!r} twice, expected different names{hint}")


def one_of(kind: str, value: object, available: Iterable[str]) -> str:
    """Return a name that must be one of the valid names.

    Parameters
    ----------
    kind : str
        Kind of the named thing, for the message, such as ``"frame"``.
    value : str
        Value of the argument.
    available : iterable of str
        Valid names.

    Returns
    -------
    str
        The same name.

    Raises
    ------
    UnknownName
        If the name is not valid; the message lists the valid names.

    Examples
    --------
    >>> from pinmobile.arrays import one_of
    >>> one_of("frame", "tool", ["base_link", "tool"])
    'tool'
    """
    names = available if isinstance(available, Collection) else tuple(available)
    if not isinstance(value, str) or value not in names:
        raise UnknownName(kind, value, names)
    return value


def symmetric(name: str, matrix: Array, tolerance: float) -> Array:
    """Return a matrix that must be symmetric.

    Parameters
    ----------
    name : str
        Name of the matrix, for the message.
    matrix : ndarray, shape (n, n)
        Matrix to check.
    tolerance : float
        Tolerance, as a share of the largest entry.

    Returns
    -------
    ndarray
        The same matrix.

    Raises
    ------
    InvalidArgument
        If it is not symmetric.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import symmetric
    >>> symmetric("Q", np.eye(2), 1e-9)
    array([[1., 0.],
           [0., 1.]])
    """
    if np.abs(matrix - matrix.T).max() > tolerance * np.abs(matrix).max():
        raise InvalidArgument(f"{name} is not symmetric: {matrix.tolist()}, expected a symmetric matrix")
    return matrix


def lengths(size: ArrayLike) -> Array:
    """Return the argument `size` of a box.

    Parameters
    ----------
    size : array_like, shape (3,)
        Length, width and height [m].

    Returns
    -------
    ndarray, shape (3,)
        Size as float64 [m].

    Raises
    ------
    InvalidArgument
        If the value does not consist of three lengths > 0.

    Examples
    --------
    >>> from pinmobile.arrays import lengths
    >>> lengths((0.6, 0.4, 0.2))  # [m]
    array([0.6, 0.4, 0.2])
    """
    return bounded("size", shaped("size", finite("size", size), (3,)), above=0, unit="m")


def sequence(name: str, value: object, expected: str, least: int = 0) -> tuple[Any, ...]:
    """Return the entries of a list, tuple or other sequence; text, mappings and sets are rejected.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : sequence
        Value of the argument.
    expected : str
        Expected value, for the message, such as ``"a sequence of DHRow"``.
    least : int
        Smallest number of entries.

    Returns
    -------
    tuple
        Entries of the sequence.

    Raises
    ------
    InvalidArgument
        If the value is not a sequence.

    Examples
    --------
    >>> from pinmobile.arrays import sequence
    >>> sequence("names", ["x", "y"], "a sequence of names")
    ('x', 'y')
    """
    if isinstance(value, np.ndarray) and value.ndim == 1:
        value = value.tolist()
    if isinstance(value, str | bytes) or not isinstance(value, Sequence) or len(value) < least:
        raise unexpected_value(name, value, expected)
    return tuple(value)


def callable_as(form: str, function: _Function, expected: str = "") -> _Function:
    """Return a function of a user that must accept the given arguments.

    Parameters
    ----------
    form : str
        Name of the argument and form of the call, such as ``"function(t, q, v, reference)"``.
    function : callable
        Value of the argument.
    expected : str, optional
        Expected value, for the message about a value that is not a function.

    Returns
    -------
    callable
        The same function.

    Raises
    ------
    InvalidArgument
        If the value is not a function, or its signature does not accept these arguments. The check does not
        call the function.

    Examples
    --------
    >>> from pinmobile.arrays import callable_as
    >>> callable_as("force(t, pose, rate)", lambda t, pose: 0)
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: force is <function ...
    """
    name, _, arguments_text = form.rstrip(")").partition("(")
    arguments = arguments_text.split(", ") if arguments_text else []
    if isinstance(function, type) or not callable(function):
        words = expected or f"a function of {', '.join(arguments[:-1])} and {arguments[-1]}"
        raise unexpected_value(name, function, words)
    code, *rest = _code_of(function)
    call = form, *rest
    if code is not None and call in _accepted.get(code, ()):
        return function
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # some built-in functions have no signature
        return function
    try:
        signature.bind(*arguments)
    except TypeError as error:
        raise InvalidArgument(
            f"{name} is {format_value(function)}, which cannot be called as {form}: {error}; give another"
        ) from None
    if code is not None:
        _accepted.setdefault(code, set()).add(call)
    return function


def _code_of(function: object) -> tuple[Any, ...]:
    """Return the code of a function, method or callable object, and the other data that fix its signature.

    The first entry is None if the signature depends on more than the code and the defaults.
    """
    is_method, law = not isinstance(function, FunctionType), function
    if is_method:
        law = function.__func__ if isinstance(function, MethodType) else type(function).__call__
    if not isinstance(law, FunctionType) or vars(law) or hasattr(function, "__signature__"):
        return (None,)
    return law.__code__, is_method, len(law.__defaults__ or ()), *sorted(law.__kwdefaults__ or ())


# Calls that fit a code; the complete check takes some 50 us.
_accepted: WeakKeyDictionary[CodeType, set[tuple[Any, ...]]] = WeakKeyDictionary()


def increasing(name: str, t: Array, hint: str = "") -> None:
    """Check that times are strictly increasing.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    t : ndarray, shape (N,)
        Times [s]; N >= 1.
    hint : str
        Advice at the end of the message.

    Raises
    ------
    InvalidArgument
        If `t` is empty, has another shape, or a time does not exceed the previous one.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import increasing
    >>> increasing("t", np.array([0.0, 0.1, 0.1]))
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: t[2] is ...
    """
    shaped(name, t, ("n>=1",))
    if not (t[1:] > t[:-1]).all():
        index = int(np.argmin(t[1:] > t[:-1])) + 1
        raise InvalidArgument(f"{name}[{index}] is {t[index]} s after {t[index - 1]} s, expected more{hint}")


def count_steps(name: str, total: float, step: float) -> int:
    """Return the number of time steps in a time, which must be a whole multiple of the step.

    Parameters
    ----------
    name : str
        Name of the time, for the message.
    total, step : float
        Time and time step, both positive [s].

    Returns
    -------
    int
        Number of steps, at least 1.

    Raises
    ------
    InvalidArgument
        If the time is not a whole multiple of the step, up to rounding.

    Examples
    --------
    >>> from pinmobile.arrays import count_steps
    >>> count_steps("step", 0.3, 0.1)
    3
    """
    ratio = total / step
    if not 0.5 < ratio < np.inf or abs(ratio - round(ratio)) > _STEP_TOLERANCE * ratio:
        raise InvalidArgument(f"{name} is {total} s, expected a whole multiple of the time step {step} s")
    return round(ratio)


_STEP_TOLERANCE = 1e-9  # relative rounding of a number of time steps


def bisect(low: float, high: float, holds: Callable[[float], bool]) -> tuple[float, float]:
    """Return a small interval: a condition holds at its lower end, but not at its upper end.

    Parameters
    ----------
    low, high : float
        Interval with this property.
    holds : callable
        Condition.

    Examples
    --------
    >>> from pinmobile.arrays import bisect
    >>> low, high = bisect(0.0, 2.0, lambda x: x * x < 2)
    >>> round(low, 6)
    1.414214
    """
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low, high


_HALVINGS = 40


def affordable(label: str, numbers: float, remedy: str) -> None:
    """Check that arrays fit into `MEMORY`, before a function allocates them.

    Parameters
    ----------
    label : str
        Arrays, for the message, such as ``"the records of 1e9 samples"``.
    numbers : float
        Number of float64 entries (8 bytes each).
    remedy : str
        Advice, for the message.

    Raises
    ------
    InvalidArgument
        If the arrays are too large; the message states their size in GB.

    Examples
    --------
    >>> from pinmobile.arrays import affordable
    >>> affordable("the records", 1e10, "give a larger dt")
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: the records take 80 GB...
    """
    if not 8 * numbers <= MEMORY:
        raise InvalidArgument(
            f"{label} take {8e-9 * numbers:.3g} GB, expected at most {1e-9 * MEMORY:g} GB: {remedy}"
        )


def broadcast(**arrays: Array) -> tuple[int, ...]:
    """Return the common shape of the leading axes of arrays of shape (..., n).

    Parameters
    ----------
    **arrays : ndarray, shape (..., n)
        Arrays by name, for the message.

    Returns
    -------
    tuple of int
        Shape to which the leading axes broadcast.

    Raises
    ------
    InvalidArgument
        If the leading axes do not broadcast.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import broadcast
    >>> broadcast(q=np.zeros((100, 3)), v=np.zeros(3))
    (100,)
    """
    return broadcast_shapes({name: array.shape[:-1] for name, array in arrays.items()})


def broadcast_shapes(shapes: Mapping[str, tuple[int, ...]]) -> tuple[int, ...]:
    """Return the common shape of leading shapes, by name of the argument."""
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        given = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise InvalidArgument(f"leading shapes are {given}, expected shapes that broadcast") from None


def frozen(array: ArrayLike) -> Array:
    """Return an immutable float64 copy of an array; an immutable array is returned unchanged.

    The memory of the copy belongs to a `bytes` object. A user could make another read-only array writable
    again.

    Parameters
    ----------
    array : array_like, any shape
        Numbers.

    Returns
    -------
    ndarray, same shape
        Immutable array.

    Examples
    --------
    >>> from pinmobile.arrays import frozen
    >>> frozen([1, 2]).flags.writeable
    False
    """
    if getattr(type(array), "is_symbolic", False):
        return array  # type: ignore[return-value]
    if type(array) is np.ndarray and isinstance(array.base, bytes) and array.dtype == np.float64:
        return array
    floats = np.asarray(array, dtype=np.float64)
    return np.ndarray(floats.shape, np.float64, floats.tobytes())


def rotate(cos: Array, sin: Array, vectors: Array) -> Array:
    """Return vectors with the first two entries rotated by an angle, shape (..., n).

    Parameters
    ----------
    cos, sin : ndarray, shape (...)
        Cosine and sine of the angle.
    vectors : ndarray, shape (..., n), n >= 2
        Vectors; other entries than the first two stay.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import rotate
    >>> rotate(0.0, 1.0, np.array([1.0, 0.0, 7.0]))
    array([0., 1., 7.])
    """
    x, y = vectors[..., 0], vectors[..., 1]
    x_rotated = cos * x - sin * y
    rotated = np.empty((*x_rotated.shape, np.shape(vectors)[-1]))
    rotated[..., 0] = x_rotated
    rotated[..., 1] = sin * x + cos * y
    rotated[..., 2:] = vectors[..., 2:]
    return rotated


HALF_TURN = 1e-9
"""Tolerance of half a turn [rad]; the value is 1e-9.

An angle within this tolerance of -pi counts as pi, so that rounding does not decide the sign.
"""

LEAST_ANGLE = HALF_TURN - np.pi
"""Lower bound of angles on the circle [rad], excluded; the value is 1e-9 - pi."""


def wrap_angle(angle: Array) -> Array:
    """Return an angle on the circle, in (-pi, pi].

    An angle in this interval is returned unchanged. Half a turn is pi, also if rounding changes it to
    slightly more than -pi.

    Parameters
    ----------
    angle : ndarray, any shape
        Angles [rad].

    Returns
    -------
    ndarray, same shape
        Angles on the circle [rad].

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.arrays import wrap_angle
    >>> wrap_angle(np.array([0.5, 4.0, -np.pi]))  # [rad]
    array([ 0.5 , -2.28,  3.14])
    """
    top = np.pi + HALF_TURN
    wrapped = np.minimum(top - np.mod(top - angle, 2 * np.pi), np.pi)
    return np.where((angle > LEAST_ANGLE) & (angle <= np.pi), angle, wrapped)
