"""Declarations: a part is a frozen class that declares each of its fields once."""

from __future__ import annotations

import dataclasses
import functools
import threading
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeVar, dataclass_transform

import attrs
import numpy as np

from pinmobile.arrays import endless_or_finite, finite, frozen, whole as checked_whole
from pinmobile.errors import InvalidArgument, NotTraceable, shown
from pinmobile.parts._capabilities import meaning, offers

_T = TypeVar("_T")
_Method = TypeVar("_Method", bound=Callable[..., Any])
_Shape = tuple[int | str, ...]
_tracing = threading.local()  # `depth` > 0 in a thread that runs laws on symbols


def is_symbolic(value: object) -> bool:
    """Tell whether a value is a symbol of a law that is being compiled."""
    return getattr(type(value), "is_symbolic", False)


def holds_symbols(value: object) -> bool:
    """Tell whether a value is a symbol, or a part, or several, with a symbol somewhere within."""
    if is_symbolic(value):
        return True
    if isinstance(value, tuple | list):
        return any(map(holds_symbols, value))
    if isinstance(value, Mapping):
        return any(map(holds_symbols, value.values()))
    return is_part(value) and any(holds_symbols(each) for _, _, each in fields_of(value))


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


class structure(functools.cached_property[_T]):
    """A cached property that depends on numbers alone: a part that holds symbols has that of its numbers."""

    def __get__(self, part: Any, owner: Any = None) -> _T:  # type: ignore[override]
        if part is None or self.attrname in vars(part) or "nominal" not in vars(part):
            return super().__get__(part, owner)
        return getattr(vars(part)["nominal"], self.attrname or "")  # type: ignore[no-any-return]


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
    unit : str
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
        Whether None, for there is none, is allowed.
    neutral : float
        Value that leaves the number out of the law where all robots have it: the compiled loop takes it for a
        constant.
    """

    unit: str = ""
    above: float | None = None
    lower: float | None = None
    upper: float | None = None
    shapes: tuple[_Shape, ...] = ((),)
    labels: tuple[str, ...] | Callable[[Any], Sequence[str]] = ()
    fixed: bool = False
    endless: bool = False
    optional: bool = False
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
        if not any(_fits(array.shape, shape) for shape in self.shapes):
            raise InvalidArgument(f"{name} has shape {array.shape}, expected {self.expected_shape}")
        self.check_bounds(name, array)
        return frozen(array) if array.ndim else float(array)

    @property
    def expected_shape(self) -> str:
        """The allowed shapes in words."""
        if self.shapes == ((),):
            return "one number"
        *first, last = (str(shape).replace("'", "") for shape in self.shapes)
        return f"{', '.join(first)} or {last}" if first else last

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
            unit = self.unit_of(at[-1] if at else None)
            raise InvalidArgument(f"{name} is {array[at]}{unit and ' ' + unit}, expected {self.bound}")

    def unit_of(self, entry: int | None) -> str:
        """Return the unit of an entry of the last axis; None: of all."""
        units = self.unit.split(", ")
        if entry is None or len(units) == 1:
            return self.unit
        return units[entry] if entry < len(units) else units[-1]


def _fits(shape: tuple[int, ...], wanted: _Shape) -> bool:
    lengths: dict[int | str, int] = {}
    return len(shape) == len(wanted) and all(
        n == (w if isinstance(w, int) else lengths.setdefault(w, n))
        for n, w in zip(shape, wanted, strict=True)
    )


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
        plain = isinstance(kind, tuple) or not getattr(kind, "_is_protocol", False)
        if isinstance(value, type) or not (isinstance(value, kind) if plain else offers(value, kind)):
            expected = self.expected or (meaning(kind) if not isinstance(kind, tuple) else "a part")
            raise InvalidArgument(f"{name} is {shown(value)}, expected {expected}")
        return value


def _checked(value: Any, field: attrs.Attribute[Any]) -> Any:
    return field.metadata["declared"].checked(field.name, value)


_convert = attrs.Converter(_checked, takes_field=True)  # type: ignore[call-overload]


def declare(declared: Field, default: Any = attrs.NOTHING, **options: Any) -> Any:
    """Return a field with a declaration of any kind; `options` are those of `attrs.field`."""
    return attrs.field(
        default=default, converter=_convert, metadata={"declared": declared}, **{"repr": True, **options}
    )


def number(
    *,
    default: Any = attrs.NOTHING,
    unit: str = "",
    doc: str = "",
    above: float | None = None,
    lower: float | None = None,
    upper: float | None = None,
    fixed: bool = False,
    endless: bool = False,
    optional: bool = False,
    neutral: float = 0.0,
) -> Any:
    """Declare a number: see `Number`."""
    default = None if optional and default is attrs.NOTHING else default
    declared = Number(
        doc,
        unit,
        above,
        lower,
        upper,
        fixed=fixed,
        endless=endless,
        optional=optional,
        neutral=neutral,
    )
    return declare(declared, default)


def array(
    *,
    default: Any = attrs.NOTHING,
    shapes: tuple[_Shape, ...] = (("n",),),
    unit: str = "",
    doc: str = "",
    labels: tuple[str, ...] | Callable[[Any], Sequence[str]] = (),
    above: float | None = None,
    lower: float | None = None,
    upper: float | None = None,
    fixed: bool = False,
    endless: bool = False,
) -> Any:
    """Declare an array of numbers: see `Number`."""
    return declare(Number(doc, unit, above, lower, upper, shapes, labels, fixed, endless), default)


COORDINATES = ("x", "y", "psi")
"""Labels of the first coordinates of a plant; those of arms and wheels have their number."""


def gain(*, default: Any = attrs.NOTHING, unit: str = "", doc: str = "", lower: float | None = None) -> Any:
    """Declare a gain: a number for all coordinates, one for each, or a matrix."""
    shapes = (), ("n",), ("n", "n")
    return array(default=default, shapes=shapes, unit=unit, doc=doc, lower=lower, labels=COORDINATES)


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


def children(kind: Any, *, default: Any = attrs.NOTHING, doc: str = "", expected: str = "") -> Any:
    """Declare several parts, in a sequence or a mapping by name."""
    return declare(Child(doc, kind, True, False, expected), default)


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
    field_specifiers=(number, array, gain, integer, child, children, option, attrs.field),
)
def part(cls: type[_T]) -> type[_T]:
    """Make a class a part: frozen, its fields checked as declared, and after them by its own ``check()``.

    Two parts are the same object or differ; a class that defines ``__eq__`` compares as it says. A part is
    pickled by its fields.
    """
    own = vars(cls)
    if hasattr(cls, "check"):

        def check(self: Any) -> None:
            if not holds_symbols(self):
                self.check()

        cls.__attrs_post_init__ = check  # type: ignore[attr-defined]
    if "__reduce__" not in own:
        cls.__reduce__ = lambda self: (_rebuilt, (type(self), _initial(self)))  # type: ignore[method-assign,assignment]
    return attrs.define(cls, slots=False, eq=False, frozen=True, repr="__repr__" not in own)


def by_value(cls: type[_T]) -> type[_T]:
    """Let parts of a class be equal where their fields are, but for those declared with ``eq=False``."""

    def key(self: Any) -> tuple[Any, ...]:
        return tuple(_comparable(getattr(self, f.name)) for f in attrs.fields(type(self)) if f.eq)

    def same(self: Any, other: object) -> bool:
        return type(other) is type(self) and key(self) == key(other)

    cls.__eq__ = same  # type: ignore[method-assign]
    cls.__hash__ = lambda self: hash((type(self), key(self)))  # type: ignore[method-assign,assignment]
    return cls


def _comparable(value: Any) -> Any:
    return (value.shape, *value.ravel().tolist()) if isinstance(value, np.ndarray) else value


def _initial(part: Any) -> dict[str, Any]:
    """Return the arguments that make a part again, by name."""
    return {f.alias: getattr(part, f.name) for f in attrs.fields(type(part)) if f.init}


def is_part(value: object) -> bool:
    """Tell whether a value is a part: an object of a frozen class whose fields are known."""
    if isinstance(value, type):
        return False
    params = getattr(type(value), "__dataclass_params__", None)
    return "__attrs_attrs__" in vars(type(value)) or bool(params and params.frozen)


@functools.cache
def _declared(kind: type) -> tuple[tuple[str, Field | None], ...]:
    if attrs.has(kind):
        return tuple((f.name, f.metadata.get("declared")) for f in attrs.fields(kind) if f.init)
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
    values = ((name, declared, getattr(part, name)) for name, declared in _declared(type(part)))
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
    if attrs.has(type(part)):
        return attrs.evolve(part, **changes, **others)  # type: ignore[misc]
    return dataclasses.replace(part, **changes, **others)  # type: ignore[type-var]
