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
    endless_or_finite,
    finite,
    frozen,
    in_numbers,
    shaped,
    shapes_in_words,
    vector,
    whole as checked_whole,
)
from pinmobile.errors import InvalidArgument, NotTraceable, shown
from pinmobile.parts._capabilities import lacks, meaning, offers

_T = TypeVar("_T")
_Method = TypeVar("_Method", bound=Callable[..., Any])
_Shape = tuple[int | str, ...]
TRACING = threading.local()  # `depth` > 0 in a thread that runs laws on symbols


def is_symbolic(value: object) -> bool:
    """Return whether a value is a symbol of a law that is being compiled."""
    return getattr(type(value), "is_symbolic", False)


def holds_symbols(value: object) -> bool:
    """Return whether a value is a symbol, a part that holds symbols, or several of which one is."""
    if isinstance(value, tuple | list):
        return any(map(holds_symbols, value))
    if isinstance(value, Mapping):
        return any(map(holds_symbols, value.values()))
    return is_symbolic(value) or "nominal" in getattr(value, "__dict__", ())


def also_symbols(method: _Method) -> _Method:
    """Let a method of a part answer by its `array_dynamics` where an argument or a field is a symbol."""
    name = method.__name__

    @functools.wraps(method)
    def run(self: Any, *given: Any, **named: Any) -> Any:
        if not ("nominal" in vars(self) or any(map(is_symbolic, (*given, *named.values())))):
            return method(self, *given, **named)
        law = self.array_dynamics
        if not hasattr(law, name):
            raise NotTraceable(
                f"{name} of a {type(self).__name__}, which takes numbers alone",
                f"write the law by the methods of {type(law).__name__}",
            )
        return getattr(law, name)(*given, **named)

    return run  # type: ignore[return-value]


def takes(**sizes: int | str) -> Callable[[_Method], _Method]:
    """Let a method of a part take numbers, checked as declared, and answer in finite ones; or symbols.

    Each size is a length of the last axis, or the name of the attribute of the part that has it. An argument
    that is its own default is not checked. Leading axes broadcast.
    """

    def decorate(method: _Method) -> _Method:
        parameters = list(inspect.signature(method).parameters.values())[1:]
        names, checked = [each.name for each in parameters], in_numbers(method)
        defaults = {each.name: each.default for each in parameters}

        @also_symbols
        @functools.wraps(method)
        def run(self: Any, *given: Any, **named: Any) -> Any:
            if len(given) > len(names):
                return method(self, *given, **named)
            asked, arrays = {**dict(zip(names, given, strict=False)), **named}, {}
            for name in filter(asked.__contains__, sizes):
                if isinstance(asked[name], float | int | np.ndarray) and _same(asked[name], defaults[name]):
                    asked[name] = defaults[name]
                else:
                    size = sizes[name]
                    n = getattr(self, size) if isinstance(size, str) else size
                    arrays[name] = vector(name, asked[name], n)
            if any(each.ndim > 1 for each in arrays.values()):
                lead = broadcast(**arrays)
                arrays = {name: np.broadcast_to(x, (*lead, x.shape[-1])) for name, x in arrays.items()}
            return checked(self, **asked | arrays)

        return run  # type: ignore[return-value]

    return decorate


def _same(value: Any, default: Any) -> bool:
    """Return whether a number, or an array without axes, is the default of an argument."""
    return isinstance(default, float | int) and not np.ndim(value) and bool(value == default)


def is_tracing() -> bool:
    """Return whether laws run on symbols in this thread."""
    return bool(getattr(TRACING, "depth", 0))


@contextlib.contextmanager
def on_numbers() -> Iterator[None]:
    """Let code run on numbers in a thread that runs laws on symbols."""
    depth, TRACING.depth = getattr(TRACING, "depth", 0), 0
    try:
        yield
    finally:
        TRACING.depth = depth


class numeric(functools.cached_property[_T]):
    """A cached property whose code makes arrays of numbers, also while laws run on symbols."""

    @overload
    def __get__(self, part: None, owner: Any = None) -> Self: ...

    @overload
    def __get__(self, part: object, owner: Any = None) -> _T: ...

    def __get__(self, part: Any, owner: Any = None) -> Any:
        if part is None or self.attrname in vars(part):
            return super().__get__(part, owner)
        with on_numbers():
            return super().__get__(part, owner)


class structure(numeric[_T]):
    """A cached property that depends on numbers alone: a part that holds symbols has that of its numbers."""

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
    """Declaration of a field beside its name: anything, such as a name, a function or a table."""

    doc: str = ""

    def checked(self, name: str, value: Any) -> Any:
        """Return the value as the part keeps it.

        Raises
        ------
        InvalidArgument
            If it is not what is declared.
        """
        return value


@attrs.frozen
class Number(Field):
    """Declaration of a number, or an array of numbers, which are finite and within bounds.

    Attributes
    ----------
    unit : str, or function of the part
        Unit of the numbers, "" for none; of an array with mixed units, one for each entry: ``"N, N, N m"``.
    above, lower, upper : float, optional
        Bounds; `above` itself is excluded.
    shapes : tuple of shapes
        Shapes that are allowed; a letter stands for any length, the same everywhere in a shape.
    labels : tuple of str, or function of the part
        Names of the entries of the last axis; entries without one have their number.
    fixed : bool
        Whether all robots of an ensemble have the same, which the compiled loop takes for a constant.
    endless : bool
        Whether infinity is allowed.
    optional : bool
        Whether None is allowed, in place of a number.
    size : function of the part, optional
        Returns how many entries there are: what has another number is refused, and one number becomes an
        array of them, unless a matrix may take its place.
    neutral : float
        Value that leaves the number out of the law where all robots have it: the compiled loop takes it for a
        constant.
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
    def bound(self) -> str:
        """The expected values in words, such as ``> 0``."""
        bounds = (">", self.above), (">=", self.lower), ("<=", self.upper)
        return " and ".join(f"{sign} {x:g}" for sign, x in bounds if x is not None)

    def checked(self, name: str, value: Any) -> Any:
        """Return a float, or a read-only array; symbols as they are."""
        if is_symbolic(value) or (value is None and self.optional):
            return value
        array = (endless_or_finite if self.endless else finite)(name, value)
        shaped(name, array, *self.shapes)
        self.check_bounds(name, array)
        return frozen(array) if array.ndim else float(array)

    def sized(self, name: str, value: Any, n: int) -> Any:
        """Return a checked value, of n entries."""
        shape = np.shape(value)
        if is_symbolic(value) or value is None:
            return value
        if any(length != n for length in shape):
            words = shapes_in_words(self.shapes).replace("n", str(n))
            raise InvalidArgument(f"{name} has shape {shape}, expected {words}")
        return value if shape or any(len(each) > 1 for each in self.shapes) else frozen(np.full(n, value))

    def beyond(self, values: Any) -> Any:
        """Return which of some values are out of bounds, as an array of booleans."""
        limits = (self.above, np.less_equal), (self.lower, np.less), (self.upper, np.greater)
        wrong = np.zeros(np.shape(values), bool)
        for limit, compare in limits:
            if limit is not None:
                wrong |= compare(values, limit)
        return wrong

    def check_bounds(self, name: str, array: Any) -> None:
        """Raise `InvalidArgument` where a value is out of bounds."""
        wrong = self.beyond(array)
        if wrong.any():
            at = tuple(int(i) for i in np.argwhere(wrong)[0])
            own = "" if callable(self.unit) else self.unit
            unit = unit_of(own, at[-1]) if at else "" if ", " in own else own
            raise InvalidArgument(f"{name} is {array[at]}{unit and ' ' + unit}, expected {self.bound}")


def unit_of(unit: str, entry: int | None) -> str:
    """Return the unit of an entry of the last axis; None: of all."""
    units = unit.split(", ")
    if entry is None or len(units) == 1:
        return unit
    return units[entry] if entry < len(units) else units[-1]


@attrs.frozen
class Whole(Field):
    """Declaration of a whole number, the same for all robots."""

    least: int = 0
    most: int = 2**53

    def checked(self, name: str, value: Any) -> int:
        """Return an int."""
        return checked_whole(name, value, least=self.least, most=self.most)


@attrs.frozen
class Child(Field):
    """Declaration of a part within the part, or of several in a tuple or a mapping by name."""

    kind: Any = object
    many: bool = False
    optional: bool = False
    expected: str = ""

    def checked(self, name: str, value: Any) -> Any:
        """Return the part, or a tuple of parts, or a mapping of parts by name."""
        if not self.many:
            return value if value is None and self.optional else self._one(name, value)
        if isinstance(value, Mapping):
            return {key: self._one(f"{name}.{key}", each) for key, each in value.items()}
        if isinstance(value, str) or not isinstance(value, list | tuple):
            raise InvalidArgument(f"{name} is {shown(value)}, expected a sequence of parts")
        return tuple(self._one(f"{name}[{i}]", each) for i, each in enumerate(value))

    def _one(self, name: str, value: Any) -> Any:
        kind = self.kind
        if value is None or isinstance(value, type) or not _is_of(value, kind):
            expected = self.expected or (meaning(kind) if not isinstance(kind, tuple) else "a part")
            told = lacks(value, kind) if is_protocol(kind) else ""
            raise InvalidArgument(f"{name} is {shown(value)}{told}, expected {expected}")
        return value


def _is_of(value: Any, kind: Any) -> bool:
    """Return whether a value is of a class, has what a protocol asks for, or is of one of several kinds."""
    if isinstance(kind, tuple):
        return any(_is_of(value, each) for each in kind)
    return offers(value, kind) if is_protocol(kind) else isinstance(value, kind)


def is_protocol(kind: Any) -> bool:
    """Return whether a kind is a protocol, which objects of any class may have."""
    return isinstance(kind, type) and bool(vars(kind).get("_is_protocol", False))


@attrs.frozen
class Values(Field):
    """Declaration of values by path, such as the distributions of a spread: numbers or parts."""


def _checked(value: Any, owner: Any, field: attrs.Attribute[Any]) -> Any:
    """Return the value as the part keeps it; None stands for a default that follows from other fields."""
    declared: Field = field.metadata["declared"]
    if value is None and isinstance(field.default, attrs.Factory):  # type: ignore[arg-type]
        value = field.default.factory(owner)  # type: ignore[union-attr]
    if value is None and field.default is None:
        return None
    found = declared.checked(field.name, value)
    if isinstance(declared, Number) and declared.size is not None:
        return declared.sized(field.name, found, declared.size(owner))
    return found


_convert = attrs.Converter(_checked, takes_self=True, takes_field=True)


def declare(declared: Field, default: Any = attrs.NOTHING, **options: Any) -> Any:
    """Return a field with a declaration of any kind; `options` are those of `attrs.field`."""
    return attrs.field(
        default=default, converter=_convert, metadata={"declared": declared}, **{"repr": True, **options}
    )


class _Bounds(TypedDict, total=False):
    """What the functions below take beside `default`; their meaning is that of the attributes of `Number`."""

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


def number(*, default: Any = attrs.NOTHING, **declared: Unpack[_Numbers]) -> Any:
    """Declare a number: see `Number`."""
    optional = declared.get("optional", False)
    return declare(Number(**declared), None if optional and default is attrs.NOTHING else default)


def array(
    *, default: Any = attrs.NOTHING, shapes: tuple[_Shape, ...] = (("n",),), **declared: Unpack[_Numbers]
) -> Any:
    """Declare an array of numbers: see `Number`."""
    return declare(Number(shapes=shapes, **declared), default)


COORDINATES = ("x", "y", "psi")
"""Labels of the first coordinates of a plant; those of arms and wheels have their number."""


def gain(*, default: Any = attrs.NOTHING, **declared: Unpack[_Bounds]) -> Any:
    """Declare a gain: a number for all coordinates, one for each, or a matrix."""
    return array(default=default, shapes=((), ("n",), ("n", "n")), labels=COORDINATES, **declared)


def each(*, default: Any = attrs.NOTHING, **declared: Unpack[_Bounds]) -> Any:
    """Declare numbers of coordinates: one for all, or one for each."""
    return array(default=default, shapes=((), ("n",)), labels=COORDINATES, **declared)


def integer(*, default: Any = attrs.NOTHING, doc: str = "", least: int = 0, most: int = 2**53) -> Any:
    """Declare a whole number, which is the same for all robots."""
    return declare(Whole(doc, least, most), default)


def child(
    kind: Any, *, default: Any = attrs.NOTHING, doc: str = "", optional: bool = False, expected: str = ""
) -> Any:
    """Declare a part within the part: an object of a class, or one with the methods of a protocol.

    `expected` are the words of the error; by default those of the protocol's docstring.
    """
    default = None if optional and default is attrs.NOTHING else default
    return declare(Child(doc, kind, False, optional, expected), default)


def children(
    kind: Any, *, default: Any = attrs.NOTHING, doc: str = "", expected: str = "", **options: Any
) -> Any:
    """Declare several parts, in a sequence or a mapping by name; `options` are those of `attrs.field`."""
    return declare(Child(doc, kind, True, False, expected), default, **options)


def option(*, default: Any = attrs.NOTHING, doc: str = "", check: Any = None, **options: Any) -> Any:
    """Declare anything else; ``check(value)`` may return another form of it, or raise `InvalidArgument`."""
    return declare(_Option(doc, check), default, **options)


@attrs.frozen
class _Option(Field):
    check: Any = None

    def checked(self, name: str, value: Any) -> Any:
        """Return what the check returns."""
        return value if self.check is None else self.check(name, value)


def _rebuilt(cls: type[_T], values: Mapping[str, Any]) -> _T:
    return cls(**values)


@dataclass_transform(
    frozen_default=True,
    eq_default=False,
    field_specifiers=(number, array, gain, each, integer, child, children, option, attrs.field),
)
def part(cls: type[_T]) -> type[_T]:
    """Make a class a part: frozen, its fields checked as declared, and after them by its own ``check()``.

    A `check` that takes arguments is another thing.

    Two parts are the same object or differ; a class that defines ``__eq__`` compares as it says. A part is
    pickled by its fields.
    """
    own = vars(cls)
    checks: Any = getattr(cls, "check", None)
    if checks is not None and len(inspect.signature(checks).parameters) == 1:

        def check(self: Any) -> None:
            if not any(map(holds_symbols, vars(self).values())):
                self.check()

        cls.__attrs_post_init__ = check  # type: ignore[attr-defined]
    if "__reduce__" not in own:
        cls.__reduce__ = lambda self: (_rebuilt, (type(self), _initial(self)))  # type: ignore[method-assign]
    if "__copy__" not in own:
        cls.__copy__ = _shallow  # type: ignore[attr-defined]
    return attrs.define(cls, slots=False, eq=False, frozen=True, repr=cls.__repr__ is object.__repr__)


def _shallow(part: _T) -> _T:
    """Return a copy that is not made again: what it keeps, by name, unchecked."""
    new = object.__new__(type(part))
    vars(new).update(vars(part))
    return new


def by_value(cls: type[_T]) -> type[_T]:
    """Let parts of a class be equal where their fields are, but for those declared with ``eq=False``."""

    def key(self: Any) -> tuple[Any, ...]:
        return tuple(_comparable(getattr(self, f.name)) for f in attrs.fields(type(self)) if f.eq)

    def same(self: Any, other: object) -> bool:
        return type(other) is type(self) and key(self) == key(other)

    cls.__eq__ = same  # type: ignore[method-assign]
    cls.__hash__ = lambda self: hash((type(self), key(self)))  # type: ignore[method-assign]
    return cls


def _comparable(value: Any) -> Any:
    return (value.shape, *value.ravel().tolist()) if isinstance(value, np.ndarray) else value


def _initial(part: Any) -> dict[str, Any]:
    """Return the arguments that make a part again, by name."""
    return {f.alias: getattr(part, f.name) for f in attrs.fields(type(part)) if f.init}


def is_part(value: object) -> bool:
    """Return whether a value is a part: an object of a frozen class whose fields are known."""
    if isinstance(value, type):
        return False
    params = getattr(type(value), "__dataclass_params__", None)
    return "__attrs_attrs__" in vars(type(value)) or bool(params and params.frozen)


@functools.cache
def declared_by(kind: type) -> tuple[tuple[str, Field | None], ...]:
    """Return name and declaration of each field of a class; None of one that is not declared."""
    if attrs.has(kind):
        return tuple((f.name, f.metadata.get("declared")) for f in attrs.fields(kind) if f.init)
    if not dataclasses.is_dataclass(kind):
        raise InvalidArgument(
            f"part is of type {kind.__name__}, expected a class with @part, or a frozen dataclass"
        )
    whole = Field()  # not to be taken for a number
    return tuple(
        (f.name, whole if f.type in (int, "int", bool, "bool") else None)
        for f in dataclasses.fields(kind)
        if f.init
    )


def fields_of(part: Any) -> list[tuple[str, Field, Any]]:
    """Return name, declaration and value of each field of a part.

    The fields of a user's plain frozen dataclass are what their values are: floats and arrays are numbers.
    """
    values = ((name, declared, getattr(part, name)) for name, declared in declared_by(type(part)))  # type: ignore[arg-type]
    return [(name, declared or _seen(value), value) for name, declared, value in values]


def _seen(value: Any) -> Field:
    """Return what a field without declaration is by its value."""
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


def evolved(part: _T, changes: Mapping[str, Any] = MappingProxyType({}), /, **others: Any) -> _T:
    """Return a part with other values of some fields, checked as those of a new one."""
    changes = {**changes, **others}
    if not attrs.has(type(part)):
        given = dataclasses.fields(part)  # type: ignore[arg-type]
        try:
            return dataclasses.replace(part, **changes)  # type: ignore[type-var]
        except Exception:
            if not (any(map(holds_symbols, changes.values())) and all(f.init for f in given)):
                raise
        copied = object.__new__(type(part))  # a user's own checks take numbers
        for f in given:
            object.__setattr__(copied, f.name, changes.get(f.name, getattr(part, f.name)))
        return copied
    own = attrs.fields(type(part))  # type: ignore[arg-type]
    unknown = changes.keys() - {f.name for f in own}
    if unknown:
        raise TypeError(f"{type(part).__name__} has no field {sorted(unknown)[0]!r}")
    if not all(f.init and "declared" in f.metadata for f in own):
        return attrs.evolve(part, **{f.alias: changes[f.name] for f in own if f.name in changes})  # type: ignore[misc]
    new = object.__new__(type(part))  # fields that stay are not checked again
    vars(new).update({f.name: getattr(part, f.name) for f in own})
    for f in own:
        if f.name in changes:
            vars(new)[f.name] = _checked(changes[f.name], new, f)
    post = getattr(new, "__attrs_post_init__", None)
    if post is not None:
        post()
    return new
