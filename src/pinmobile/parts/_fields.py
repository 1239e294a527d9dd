"""Declarations: a part is a frozen class that declares each of its fields once."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Self, TypedDict, TypeVar, Unpack, dataclass_transform, overload

import attrs
import numpy as np

from pinmobile.arrays import (
    broadcast,
    check_integer as checked_whole,
    endless_or_finite,
    finite,
    finite_result,
    frozen,
    sequence,
    shaped,
    vector,
)
from pinmobile.errors import InvalidArgument, NotTraceable, format_value
from pinmobile.parts._capabilities import advice, format_missing, meaning, offers

_T = TypeVar("_T")
_Method = TypeVar("_Method", bound=Callable[..., Any])
_Shape = tuple[int | str, ...]
TRACING = threading.local()  # `depth` > 0 in a thread that traces laws


def is_symbolic(value: object) -> bool:
    """Return whether a value is a symbol of a law that is being compiled."""
    return getattr(type(value), "is_symbolic", False)


def holds_symbols(value: object) -> bool:
    """Return whether a value is a symbol, a part with symbols, or a collection that contains one."""
    if isinstance(value, tuple | list):
        return any(map(holds_symbols, value))
    if isinstance(value, Mapping):
        return any(map(holds_symbols, value.values()))
    return is_symbolic(value) or "nominal" in getattr(value, "__dict__", ())


def dispatch_symbols(method: _Method) -> _Method:
    """Decorate a method of a part: it calls `array_dynamics` if an argument or a field is a symbol."""
    name = method.__name__

    @functools.wraps(method)
    def run(self: Any, *given: Any, **keywords: Any) -> Any:
        if not ("nominal" in vars(self) or any(map(is_symbolic, (*given, *keywords.values())))):
            return method(self, *given, **keywords)
        law = self.array_dynamics
        if not hasattr(law, name):
            raise NotTraceable(
                f"{name} of a {type(self).__name__}, which accepts numbers only",
                f"write the law with the methods of {type(law).__name__}",
            )
        return getattr(law, name)(*given, **keywords)

    return run  # type: ignore[return-value]


def takes(**sizes: int | str) -> Callable[[_Method], _Method]:
    """Decorate a method of a part: it accepts checked numbers, whose leading axes broadcast, or symbols.

    The method checks that its result is finite. An argument that equals its default is not checked.

    Parameters
    ----------
    **sizes : int or str
        Length of the last axis of each argument, or the name of the attribute of the part with this length.
    """

    def decorate(method: _Method) -> _Method:
        parameters = list(inspect.signature(method).parameters.values())[1:]
        names, numeric_method = [parameter.name for parameter in parameters], finite_result(method)
        defaults = {parameter.name: parameter.default for parameter in parameters}

        @dispatch_symbols
        @functools.wraps(method)
        def run(self: Any, *given: Any, **keywords: Any) -> Any:
            if len(given) > len(names):
                return method(self, *given, **keywords)
            args, arrays = {**dict(zip(names, given, strict=False)), **keywords}, {}
            for name in filter(args.__contains__, sizes):
                if isinstance(args[name], float | int | np.ndarray) and _equal(args[name], defaults[name]):
                    args[name] = defaults[name]
                else:
                    size = sizes[name]
                    n = getattr(self, size) if isinstance(size, str) else size
                    arrays[name] = vector(name, args[name], n)
            if any(array.ndim > 1 for array in arrays.values()):
                lead = broadcast(**arrays)
                arrays = {name: np.broadcast_to(x, (*lead, x.shape[-1])) for name, x in arrays.items()}
            return numeric_method(self, **args | arrays)

        return run  # type: ignore[return-value]

    return decorate


def _equal(value: Any, default: Any) -> bool:
    """Return whether a number, or an array without axes, equals the default of an argument."""
    return isinstance(default, float | int) and not np.ndim(value) and bool(value == default)


def is_tracing() -> bool:
    """Return whether this thread traces laws with symbols."""
    return bool(getattr(TRACING, "depth", 0))


@contextlib.contextmanager
def numeric_context() -> Iterator[None]:
    """Run code with numbers in a thread that traces laws."""
    depth, TRACING.depth = getattr(TRACING, "depth", 0), 0
    try:
        yield
    finally:
        TRACING.depth = depth


class numeric(functools.cached_property[_T]):
    """Cached property whose code computes with numbers, also while laws are traced."""

    @overload
    def __get__(self, part: None, owner: Any = None) -> Self: ...

    @overload
    def __get__(self, part: object, owner: Any = None) -> _T: ...

    def __get__(self, part: Any, owner: Any = None) -> Any:
        if part is None or self.attrname in vars(part):
            return super().__get__(part, owner)
        with numeric_context():
            return super().__get__(part, owner)


class structure(numeric[_T]):
    """Cached property that depends on numbers only: a part with symbols has the value of its nominal part."""

    @overload
    def __get__(self, part: None, owner: Any = None) -> Self: ...

    @overload
    def __get__(self, part: object, owner: Any = None) -> _T: ...

    def __get__(self, part: Any, owner: Any = None) -> Any:
        if part is None or self.attrname in vars(part) or "nominal" not in vars(part):
            return super().__get__(part, owner)
        return getattr(vars(part)["nominal"], self.attrname or "")


@attrs.frozen
class Field:
    """Declaration of a field that is neither a number nor a part, such as a name, a function or a table.

    Attributes
    ----------
    doc : str
        Meaning of the field as a noun phrase.
    """

    doc: str = ""

    def convert(self, name: str, value: Any) -> Any:
        """Return the value in the form that the part stores.

        Raises
        ------
        InvalidArgument
            If the value does not match the declaration.
        """
        return value


@attrs.frozen
class Number(Field):
    """Declaration of a number, or an array of numbers, which are finite and within bounds.

    Attributes
    ----------
    unit : str, or function of the part
        Unit of the numbers, "" for none; for mixed units, one unit per entry: ``"N, N, N m"``.
    above, lower, upper : float, optional
        Bounds; `above` is excluded, the others are included. They apply to the diagonal of a gain's matrix.
    shapes : tuple of shapes
        Allowed shapes; a letter stands for any length, the same everywhere in a shape.
    labels : tuple of str, or function of the part
        Names of the entries of the last axis; other entries have their index as a name.
    fixed : bool
        Whether all robots of an ensemble have the same number; the compiled loop treats it as a constant.
    endless : bool
        Whether infinity is allowed.
    optional : bool
        Whether None is allowed in place of a number.
    size : function of the part, optional
        Number of entries. Another number of entries is rejected; one number becomes an array of this size,
        unless a matrix is allowed.
    neutral : float
        Value that has no effect in the law; the compiled loop treats it as a constant if all robots have it.
    """

    unit: str | Callable[[Any], str] = ""
    above: float | None = None
    lower: float | None = None
    upper: float | None = None
    shapes: tuple[_Shape, ...] = ((),)
    labels: tuple[str, ...] | Callable[[Any], Sequence[str]] = ()
    fixed: bool = False
    endless: bool = False
    optional: bool = False
    size: Callable[[Any], int] | None = None
    neutral: float = 0.0

    @property
    def is_gain(self) -> bool:
        """Whether the field may be one number, one number per coordinate, or a matrix."""
        return ("n", "n") in self.shapes

    @property
    def bound(self) -> str:
        """Bounds as text, such as ``> 0``."""
        bounds = (">", self.above), (">=", self.lower), ("<=", self.upper)
        return " and ".join(f"{sign} {x:g}" for sign, x in bounds if x is not None)

    def convert(self, name: str, value: Any) -> Any:
        """Return a float or an immutable array; symbols are returned unchanged."""
        if is_symbolic(value) or (value is None and self.optional):
            return value
        array = (endless_or_finite if self.endless else finite)(name, value)
        shaped(name, array, *self.shapes)
        self.check_bounds(name, array)
        return frozen(array) if array.ndim else float(array)

    def fill(self, name: str, value: Any, n: int) -> Any:
        """Return a checked value with n entries."""
        shape = np.shape(value)
        if is_symbolic(value) or value is None:
            return value
        shaped(name, value, *(tuple(n if x == "n" else x for x in sizes) for sizes in self.shapes))
        return value if shape or any(len(x) > 1 for x in self.shapes) else frozen(np.full(n, value))

    def limits(self, shape: tuple[int, ...]) -> tuple[Any, Any]:
        """Return lowest and highest numbers of an array of a shape, infinite where it has no bounds."""
        ends = (self.lower if self.above is None else self.above, -np.inf), (self.upper, np.inf)
        bounded = np.eye(shape[0], dtype=bool) if self.is_gain and len(shape) == 2 else np.ones(shape, bool)
        lowest, highest = (np.where(bounded, free if end is None else end, free) for end, free in ends)
        return lowest, highest

    def outside_bounds(self, values: Any) -> Any:
        """Return which values are out of bounds, as an array of booleans."""
        lowest, highest = self.limits(np.shape(values))
        is_low = np.less(values, lowest) if self.above is None else np.less_equal(values, lowest)
        return is_low | np.greater(values, highest)

    def difference_steps(self, values: Any, share: float) -> tuple[Any, Any]:
        """Return steps for differences that stay within the bounds, and whether they may go to both sides.

        A step is a share of a number with the bound 0, otherwise of at least 1.
        """
        lowest, highest = self.limits(np.shape(values))
        scales = np.where((lowest == 0) & (values > 0), values, np.maximum(1.0, np.abs(values)))
        down, up = values - lowest, highest - values
        steps = np.minimum(share * scales, 0.5 * np.maximum(down, up))
        is_central = np.minimum(down, up) > steps
        return np.where(is_central | (up >= down), steps, -steps), is_central

    def check_bounds(self, name: str, array: Any) -> None:
        """Raise `InvalidArgument` if a value is out of bounds."""
        is_outside = self.outside_bounds(array)
        if is_outside.any():
            index = tuple(int(i) for i in np.argwhere(is_outside)[0])
            units = "" if callable(self.unit) else self.unit
            unit = unit_of(units, index[-1]) if index else "" if ", " in units else units
            raise InvalidArgument(f"{name} is {array[index]}{unit and ' ' + unit}, expected {self.bound}")


def unit_of(unit: str, entry: int | None) -> str:
    """Return the unit of an entry of the last axis, or of the whole array if the entry is None."""
    units = unit.split(", ")
    if entry is None or len(units) == 1:
        return unit
    return units[entry] if entry < len(units) else units[-1]


@attrs.frozen
class Whole(Field):
    """Declaration of a whole number, which is the same for all robots."""

    least: int = 0
    most: int = 2**53

    def convert(self, name: str, value: Any) -> int:
        """Return an int."""
        return checked_whole(name, value, least=self.least, most=self.most)


@attrs.frozen
class Child(Field):
    """Declaration of a part inside the part, or of several parts in a tuple or mapping."""

    kind: Any = object
    many: bool = False
    optional: bool = False
    expected: str = ""

    def convert(self, name: str, value: Any) -> Any:
        """Return the part, a tuple of parts, or a mapping of parts by name."""
        if not self.many:
            return value if value is None and self.optional else self._check_one(name, value)
        if isinstance(value, Mapping):
            return {key: self._check_one(f"{name}.{key}", part) for key, part in value.items()}
        parts = sequence(name, value, "a sequence of parts")
        return tuple(self._check_one(f"{name}[{i}]", part) for i, part in enumerate(parts))

    def _check_one(self, name: str, value: Any) -> Any:
        kind = self.kind
        if value is None or isinstance(value, type) or not _matches(value, kind):
            expected = self.expected or (meaning(kind, value) if not isinstance(kind, tuple) else "a part")
            reason, hint = (format_missing(value, kind), advice(value)) if is_protocol(kind) else ("", "")
            raise InvalidArgument(f"{name} is {format_value(value)}{reason}, expected {expected}{hint}")
        return value


def _matches(value: Any, kind: Any) -> bool:
    """Return whether a value matches a class, a protocol, or one of several kinds."""
    if isinstance(kind, tuple):
        return any(_matches(value, option) for option in kind)
    return offers(value, kind) if is_protocol(kind) else isinstance(value, kind)


def is_protocol(kind: Any) -> bool:
    """Return whether a kind is a protocol, which objects of any class can implement."""
    return isinstance(kind, type) and bool(vars(kind).get("_is_protocol", False))


@attrs.frozen
class Values(Field):
    """Declaration of values by path, such as the distributions of a spread: numbers or parts."""


def _convert_value(value: Any, owner: Any, field: attrs.Attribute[Any]) -> Any:
    """Return the value in the form that the part stores; None stands for a default from other fields."""
    declaration: Field = field.metadata["declared"]
    if value is None and isinstance(field.default, attrs.Factory):  # type: ignore[arg-type]
        value = field.default.factory(owner)  # type: ignore[union-attr]
    if value is None and field.default is None:
        return None
    converted = declaration.convert(field.name, value)
    if isinstance(declaration, Number) and declaration.size is not None:
        return declaration.fill(field.name, converted, declaration.size(owner))
    return converted


_convert = attrs.Converter(_convert_value, takes_self=True, takes_field=True)


def declare(declaration: Field, default: Any = attrs.NOTHING, **options: Any) -> Any:
    """Return a field with a declaration; `options` are those of ``attrs.field``."""
    return attrs.field(
        default=default, converter=_convert, metadata={"declared": declaration}, **{"repr": True, **options}
    )


class _Bounds(TypedDict, total=False):
    """Arguments of the functions below beside `default`; they are the attributes of `Number`."""

    doc: str
    unit: str | Callable[[Any], str]
    above: float | None
    lower: float | None
    upper: float | None
    endless: bool
    size: Callable[[Any], int] | None


class _Numbers(_Bounds, total=False):
    labels: tuple[str, ...] | Callable[[Any], Sequence[str]]
    fixed: bool
    optional: bool
    neutral: float


def number(*, default: Any = attrs.NOTHING, **options: Unpack[_Numbers]) -> Any:
    """Declare a field that is a number.

    Parameters
    ----------
    default : float or None, optional
        Default of the field; without it, the field is required.
    **options
        Attributes of the declaration: ``doc`` (meaning), ``unit``, bounds ``above`` (excluded), ``lower`` and
        ``upper`` (included), ``endless`` (infinity is allowed, as by a default of infinity), ``optional``
        (None is allowed, as by a default of None), ``fixed`` (the same for all robots of an ensemble),
        ``neutral`` (value without effect).

    Returns
    -------
    field
        Declaration for the body of a class with `part`.

    See Also
    --------
    parts.part : make a class a part.
    parts.array : array of numbers.
    parts.gain : gain of a controller.

    Examples
    --------
    >>> from pinmobile.parts import number, part
    >>> @part
    ... class Spring:
    ...     stiffness: float = number(above=0, unit="N/m")
    >>> Spring(-2.0)
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: stiffness is -2.0 N/m, expected > 0
    """
    default = None if options.get("optional") and default is attrs.NOTHING else default
    return array(default=default, shapes=((),), **options)


def array(
    *, default: Any = attrs.NOTHING, shapes: tuple[_Shape, ...] = (("n",),), **options: Unpack[_Numbers]
) -> Any:
    """Declare a field that is an array of numbers.

    Parameters
    ----------
    default : array_like, optional
        Default of the field; without it, the field is required.
    shapes : tuple of tuple
        Allowed shapes; a letter stands for any length, the same everywhere in a shape.
    **options
        Attributes of the declaration, see `number`; also ``labels`` (names of the entries of the last axis)
        and ``size`` (function of the part that returns the number of entries).

    Returns
    -------
    field
        Declaration for the body of a class with `part`.

    See Also
    --------
    parts.number : single number.
    parts.each : numbers of coordinates.

    Examples
    --------
    >>> from pinmobile.parts import array, part
    >>> @part
    ... class Wind:
    ...     force: object = array(shapes=((2,),), unit="N")
    >>> Wind([3, 4]).force
    array([3., 4.])
    """
    options.setdefault("optional", default is None)
    options.setdefault("endless", isinstance(default, float) and default == np.inf)
    return declare(Number(shapes=shapes, **options), default)


COORDINATES = ("x", "y", "psi")
"""Labels of the first coordinates of a plant; those of arms and wheels have their index as a label."""


def gain(*, default: Any = attrs.NOTHING, **options: Unpack[_Bounds]) -> Any:
    """Declare a field that is a gain: one number for all coordinates, one per coordinate, or a matrix.

    Parameters
    ----------
    default : array_like, optional
        Default of the field; without it, the field is required.
    **options
        Attributes of the declaration, see `number`.

    Returns
    -------
    field
        Declaration for the body of a class with `part`.

    See Also
    --------
    parts.each : numbers of coordinates, without a matrix.
    PD : controller with two gains.

    Examples
    --------
    >>> from pinmobile.parts import gain, part
    >>> @part
    ... class Damping:
    ...     kd: object = gain(unit="N s/m", doc="derivative gain")
    ...     def initial_state(self, context):
    ...         return None
    ...     def __call__(self, t, q, v, reference, state):
    ...         return self.kd * (reference.v - v), state
    >>> Damping(kd=[20, 20, 2]).kd
    array([20., 20.,  2.])
    """
    return array(default=default, shapes=((), ("n",), ("n", "n")), labels=COORDINATES, **options)


def each(*, default: Any = attrs.NOTHING, **options: Unpack[_Bounds]) -> Any:
    """Declare a field with numbers of coordinates: one number for all coordinates, or one per coordinate.

    Parameters
    ----------
    default : array_like, optional
        Default of the field; without it, the field is required.
    **options
        Attributes of the declaration, see `number`.

    Returns
    -------
    field
        Declaration for the body of a class with `part`.

    See Also
    --------
    parts.gain : the same, or a matrix.
    parts.array : array of numbers.

    Examples
    --------
    >>> from pinmobile.parts import each, part
    >>> @part
    ... class Limits:
    ...     speed: object = each(above=0, unit="m/s, m/s, rad/s")
    >>> Limits([1.0, 0.5, 2.0]).speed
    array([1. , 0.5, 2. ])
    """
    return array(default=default, shapes=((), ("n",)), labels=COORDINATES, **options)


def integer(*, default: Any = attrs.NOTHING, doc: str = "", least: int = 0, most: int = 2**53) -> Any:
    """Declare a field that is a whole number, the same for all robots.

    Parameters
    ----------
    default : int, optional
        Default of the field; without it, the field is required.
    doc : str
        Meaning of the field as a noun phrase.
    least, most : int
        Bounds, both included.

    Returns
    -------
    field
        Declaration for the body of a class with `part`.

    See Also
    --------
    parts.number : number that may differ from robot to robot.

    Examples
    --------
    >>> from pinmobile.parts import integer, part
    >>> @part
    ... class Delay:
    ...     samples: int = integer(default=1, doc="delay in samples")
    >>> Delay(3).samples
    3
    """
    return declare(Whole(doc, least, most), default)


def child(
    kind: Any, *, default: Any = attrs.NOTHING, doc: str = "", optional: bool = False, expected: str = ""
) -> Any:
    """Declare a field that is a part: an object of a class, or an object with the members of a protocol.

    Parameters
    ----------
    kind : type, protocol or tuple of these
        Class or protocol of the part.
    default : part, optional
        Default of the field; without it, the field is required.
    doc : str
        Meaning of the field as a noun phrase.
    optional : bool
        Whether None is allowed, as by a default of None; None is then the default.
    expected : str
        Expected value, for the message; default: the first line of the protocol's docstring.

    Returns
    -------
    field
        Declaration for the body of a class with `part`.

    See Also
    --------
    parts.children : several parts.

    Examples
    --------
    >>> from pinmobile import PD
    >>> from pinmobile.parts import child, part, replace
    >>> @part
    ... class Half:
    ...     controller: object = child(object, doc="inner law")
    >>> half = replace(Half(PD(8, 4)), {"controller.kp": 2.0})
    >>> half.controller.kp  # [N/m]
    2.0
    """
    default = None if optional and default is attrs.NOTHING else default
    return declare(Child(doc, kind, False, optional or default is None, expected), default)


def children(
    kind: Any, *, default: Any = attrs.NOTHING, doc: str = "", expected: str = "", **options: Any
) -> Any:
    """Declare a field with several parts, in a sequence or in a mapping by name.

    Parameters
    ----------
    kind : type, protocol or tuple of these
        Class or protocol of each part.
    default : tuple or mapping, optional
        Default of the field; without it, the field is required.
    doc : str
        Meaning of the field as a noun phrase.
    expected : str
        Expected value, for the message; default: the first line of the protocol's docstring.
    **options
        Options of ``attrs.field``.

    Returns
    -------
    field
        Declaration for the body of a class with `part`.

    See Also
    --------
    parts.child : one part.

    Examples
    --------
    >>> from pinmobile import ConstantForce
    >>> from pinmobile.parts import children, part, replace
    >>> @part
    ... class Storm:
    ...     forces: object = children(object, default=())
    >>> calm = Storm({"wind": ConstantForce([5, 0, 0])})
    >>> storm = replace(calm, {"forces.wind.force": [0, 9, 0]})
    >>> storm.forces["wind"].force  # [N, N, N m]
    array([0., 9., 0.])
    """
    return declare(Child(doc, kind, True, False, expected), default, **options)


def option(*, default: Any = attrs.NOTHING, doc: str = "", check: Any = None, **options: Any) -> Any:
    """Declare a field that is neither a number nor a part.

    Parameters
    ----------
    default : object, optional
        Default of the field; without it, the field is required.
    doc : str
        Meaning of the field as a noun phrase.
    check : callable, optional
        Function ``check(name, value)`` that returns the value to store, or raises `InvalidArgument`.
    **options
        Options of ``attrs.field``.

    Returns
    -------
    field
        Declaration for the body of a class with `part`.

    See Also
    --------
    parts.integer : whole number.

    Examples
    --------
    >>> from pinmobile.arrays import text
    >>> from pinmobile.parts import option, part
    >>> @part
    ... class Label:
    ...     name: str = option(default="", check=text, doc="name")
    >>> Label("left").name
    'left'
    """
    return declare(_Option(doc, check), default, **options)


@attrs.frozen
class _Option(Field):
    check: Any = None

    def convert(self, name: str, value: Any) -> Any:
        """Return the result of the check."""
        return value if self.check is None else self.check(name, value)


def _rebuilt(cls: type[_T], values: Mapping[str, Any]) -> _T:
    return cls(**values)


@dataclass_transform(
    frozen_default=True,
    eq_default=False,
    field_specifiers=(number, array, gain, each, integer, child, children, option, attrs.field),
)
def part(cls: type[_T]) -> type[_T]:
    """Make a class a part: a frozen attrs class whose fields are checked as declared.

    If the class has a method ``check(self)``, the check of the fields calls it last. Two different objects
    are unequal, unless the class defines ``__eq__``. A pickle contains the fields.

    Parameters
    ----------
    cls : type
        Class whose fields are declared by `number`, `array`, `gain`, `each`, `integer`, `child`, `children`
        and `option`.

    Returns
    -------
    type
        The same class as a part.

    See Also
    --------
    parts.number : declare a number.
    parts.replace : the same part with other numbers.
    parts.table : numbers of a part as text.

    Examples
    --------
    >>> from pinmobile.parts import number, part
    >>> @part
    ... class Drag:
    ...     coefficient: float = number(lower=0, unit="N s/m")
    ...     def __call__(self, t, pose, rate):
    ...         return -self.coefficient * rate
    >>> Drag(4.0)
    Drag(coefficient=4.0)
    """
    attributes = vars(cls)
    checks: Any = getattr(cls, "check", None)
    if checks is not None and len(inspect.signature(checks).parameters) == 1:

        def check(self: Any) -> None:
            if not any(map(holds_symbols, vars(self).values())):
                self.check()

        cls.__attrs_post_init__ = check  # type: ignore[attr-defined]
    if "__reduce__" not in attributes:
        cls.__reduce__ = lambda self: (_rebuilt, (type(self), _arguments(self)))  # type: ignore[method-assign]
    if "__copy__" not in attributes:
        cls.__copy__ = _copy  # type: ignore[attr-defined]
    return attrs.define(cls, slots=False, eq=False, frozen=True, repr=cls.__repr__ is object.__repr__)


def _copy(part: _T) -> _T:
    """Return a copy with the same attributes, unchecked."""
    new = object.__new__(type(part))
    vars(new).update(vars(part))
    return new


def by_value(cls: type[_T]) -> type[_T]:
    """Make parts of a class equal if their fields are equal, except for fields with ``eq=False``."""

    def key(self: Any) -> tuple[Any, ...]:
        return tuple(_comparable(getattr(self, f.name)) for f in attrs.fields(type(self)) if f.eq)

    def is_equal(self: Any, value: object) -> bool:
        return type(value) is type(self) and key(self) == key(value)

    cls.__eq__ = is_equal  # type: ignore[method-assign]
    cls.__hash__ = lambda self: hash((type(self), key(self)))  # type: ignore[method-assign]
    return cls


def _comparable(value: Any) -> Any:
    return (value.shape, *value.ravel().tolist()) if isinstance(value, np.ndarray) else value


def _arguments(part: Any) -> dict[str, Any]:
    """Return the arguments that make a part again, by name."""
    return {f.alias: getattr(part, f.name) for f in attrs.fields(type(part)) if f.init}


def is_part(value: object) -> bool:
    """Return whether a value is a part: an object of a frozen class with known fields."""
    if isinstance(value, type):
        return False
    params = getattr(type(value), "__dataclass_params__", None)
    return "__attrs_attrs__" in vars(type(value)) or bool(params and params.frozen)


@functools.cache
def declarations(kind: type) -> tuple[tuple[str, Field | None], ...]:
    """Return name and declaration of each field of a class; the declaration may be None."""
    if attrs.has(kind):
        return tuple((f.name, f.metadata.get("declared")) for f in attrs.fields(kind) if f.init)
    if not dataclasses.is_dataclass(kind):
        raise InvalidArgument(
            f"part is of type {kind.__name__}, expected a class with @part, or a frozen dataclass"
        )
    plain = Field()  # a field that is not a number
    return tuple(
        (f.name, plain if f.type in (int, "int", bool, "bool") else None)
        for f in dataclasses.fields(kind)
        if f.init
    )


def fields_of(part: Any) -> list[tuple[str, Field, Any]]:
    """Return name, declaration and value of each field of a part.

    The fields of a user's plain frozen dataclass have the kind of their values: floats and arrays are
    numbers.
    """
    values = ((name, field, getattr(part, name)) for name, field in declarations(type(part)))  # type: ignore[arg-type]
    return [(name, field or _infer_field(value), value) for name, field, value in values]


def _infer_field(value: Any) -> Field:
    """Return the declaration of a field from its value."""
    if _is_number(value) or (isinstance(value, np.ndarray) and value.dtype.kind in "fi"):
        return Number(shapes=(tuple("abcdef"[: np.ndim(value)]),))
    if isinstance(value, tuple) and value:
        if all(map(_is_number, value)):
            return Number(shapes=(("n",),))
        if all(map(is_part, value)):
            return Child(many=True)
    return Child() if is_part(value) else Field()


def _is_number(value: object) -> bool:
    number = isinstance(value, float | int | np.floating) and not isinstance(value, bool)
    return number or is_symbolic(value)


def evolved(part: _T, changes: Mapping[str, Any] = MappingProxyType({}), /, **more: Any) -> _T:
    """Return a part with other values of some fields, which are checked as in a new part."""
    changes = {**changes, **more}
    if not attrs.has(type(part)):
        fields = dataclasses.fields(part)  # type: ignore[arg-type]
        try:
            return dataclasses.replace(part, **changes)  # type: ignore[type-var]
        except Exception:
            if not (any(map(holds_symbols, changes.values())) and all(f.init for f in fields)):
                raise
        copy = object.__new__(type(part))  # checks of a user accept numbers only
        for f in fields:
            object.__setattr__(copy, f.name, changes.get(f.name, getattr(part, f.name)))
        return copy
    part_fields = attrs.fields(type(part))  # type: ignore[arg-type]
    unknown = changes.keys() - {f.name for f in part_fields}
    if unknown:
        raise TypeError(f"{type(part).__name__} has no field {sorted(unknown)[0]!r}")
    if not all(f.init and "declared" in f.metadata for f in part_fields):
        return attrs.evolve(part, **{f.alias: changes[f.name] for f in part_fields if f.name in changes})  # type: ignore[misc]
    new = object.__new__(type(part))  # unchanged fields are not checked again
    vars(new).update({f.name: getattr(part, f.name) for f in part_fields})
    for f in part_fields:
        if f.name in changes:
            vars(new)[f.name] = _convert_value(changes[f.name], new, f)
    post = getattr(new, "__attrs_post_init__", None)
    if post is not None:
        post()
    return new
