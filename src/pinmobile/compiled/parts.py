"""The parts of a closed loop, their parameters by path and name, and copies of them with other numbers.

A copy stands as the part does, or is made again, which checks it and derives what follows from the numbers.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import is_
from types import MethodType, ModuleType
from typing import Any, NamedTuple

import attrs
import numpy as np

from pinmobile.arrays import Array, are_real
from pinmobile.compiled.memory import is_leaf
from pinmobile.compiled.symbolic import Moment, Values
from pinmobile.constancy import known
from pinmobile.errors import InvalidArgument, NotTraceable, PinmobileError, UnknownName, shown
from pinmobile.parts import structures_of
from pinmobile.plant import parameters_of

_NAMED = ("plant", "controller", "integrator", "recorder", "trajectory")


class Place(NamedTuple):
    """A parameter of a part: where the part stands, and what the parameter is called there.

    Attributes
    ----------
    path, name : str
        Such as ``"controller.robot"`` and ``"mass"``.
    """

    path: str
    name: str


@dataclass(frozen=True)
class Parts:
    """The parts of a closed loop.

    Parameters
    ----------
    plant, controller, integrator, recorder : parts
        As in the design; a plant with the capability ``step`` needs no integrator.
    forces : sequence of forces
        A force is called ``force(t, pose, rate)`` and returns a wrench on the body, or has
        ``on_coordinates(t, q, v)``, which returns a force on the coordinates.
    substeps : int
        Steps of the plant in a sample.
    trajectory : trajectory, optional
        What the reference is sampled from; it is made again, not traced, where a parameter of it differs.
    """

    plant: Any
    controller: Any
    forces: tuple[Any, ...] = ()
    integrator: Any = None
    recorder: Any = None
    substeps: int = 1
    trajectory: Any = None

    # What the parts are able to is looked up once, before the first sample.

    @functools.cached_property
    def law(self) -> Any:
        """The plant as a loop asks it: where it offers unchecked calls, by these, in the thread that asks."""
        return self.plant if not hasattr(self.plant, "calls") else _Unchecked(self.plant)

    @functools.cached_property
    def integrate(self) -> Callable[[Any, Any], Any]:
        """How a displacement moves a configuration: as the plant says, else by addition."""
        return getattr(self.law, "integrate", None) or np.add

    @functools.cached_property
    def steps(self) -> bool:
        """Whether the plant has a step of its own."""
        return hasattr(self.plant, "step")

    @functools.cached_property
    def is_constrained(self) -> bool:
        """Whether velocities are projected before each substep; a plant's own step does so itself."""
        return hasattr(self.plant, "project") and not self.steps

    @functools.cached_property
    def displaced(self) -> Callable[..., tuple[Any, Any]]:
        """How the integrator moves on, given the acceleration at the start."""
        if hasattr(self.integrator, "displaced"):
            return self.integrator.displaced  # type: ignore[no-any-return]
        return functools.partial(displaced, self.integrator)

    @functools.cached_property
    def limits(self) -> tuple[Array, Array] | None:
        """The least and the largest input, shape (nu,); None where nothing has a limit."""
        inputs = getattr(self.plant, "inputs", ())
        low, high = (
            np.array([sign * np.inf if (x := getattr(each, side, None)) is None else x for each in inputs])
            for side, sign in (("lower", -1.0), ("upper", 1.0))
        )
        return (low, high) if np.isfinite([low, high]).any() else None

    @functools.cached_property
    def acting(self) -> tuple[list[tuple[int, Any]], list[tuple[int, Any]]]:
        """The forces that push the body, and those on the coordinates, each with its number."""
        found: tuple[list[tuple[int, Any]], ...] = [], []
        for k, force in enumerate(self.forces):
            found[hasattr(force, "on_coordinates")].append((k, force))
        return found[0], found[1]

    @functools.cached_property
    def carries(self) -> bool:
        """Whether a force adds to the inertia of the body."""
        return any(hasattr(force, "inertia") for force in self.forces)

    @functools.cached_property
    def is_informed(self) -> bool:
        """Whether the controller is told which input is applied."""
        return hasattr(self.controller, "applied")

    @functools.cached_property
    def records_errors(self) -> bool:
        """Whether the recorder looks at errors."""
        return self.recorder is not None and getattr(self.recorder, "errors", True)

    @functools.cached_property
    def is_measured(self) -> bool:
        """Whether the recorder looks at the plant's measures."""
        return bool(getattr(self.recorder, "measures", ()))

    @functools.cached_property
    def tells(self) -> bool:
        """Whether the recorder keeps signals, and a part has some."""
        asked = self.plant, self.controller, *self.forces
        return getattr(self.recorder, "signals", False) and any(hasattr(each, "signals") for each in asked)

    def by_path(self) -> Iterator[tuple[str, Any]]:
        """Return the parts, each with its path."""
        for name in _NAMED:
            if getattr(self, name) is not None:
                yield name, getattr(self, name)
        yield from ((f"forces[{i}]", force) for i, force in enumerate(self.forces))

    def on_the_way(self, path: str) -> Iterator[tuple[str, Any]]:
        """Yield the parts that stand on the way to a path, the outermost first, each with its own path."""
        first, *names = path.split(".")
        found = dict(self.by_path())[first]
        yield first, found
        for name in names:
            found, first = dict(children(found))[name], f"{first}.{name}"
            yield first, found

    def at(self, path: str) -> Any:
        """Return the part that stands at a path, such as ``"controller.robot"``."""
        *_, (_, found) = self.on_the_way(path)
        return found

    def replaced(self, function: Callable[[str, Any], Any]) -> Parts:
        """Return the parts with a function of path and part in their place."""
        new = {path: function(path, part) for path, part in self.by_path()}
        forces = tuple(new[f"forces[{i}]"] for i in range(len(self.forces)))
        named = {name: new.get(name) for name in _NAMED}
        return Parts(**named, forces=forces, substeps=self.substeps)

    def _rebuilt(self, function: Callable[[str, Any, Mapping[str, Any]], Any]) -> Parts:
        """Return the parts with a function of path, part and changed inner parts in the place of each."""

        def visit(path: str, part: object) -> Any:
            inner = {name: (child, visit(f"{path}.{name}", child)) for name, child in children_at(path, part)}
            return function(path, part, {name: new for name, (old, new) in inner.items() if new is not old})

        return self.replaced(visit)

    def varying(self, entries: Iterable[tuple[Place, Any]]) -> Parts:
        """Return the parts, told what differs from robot to robot, if they want to know.

        One with ``varying(entries)`` is called with attributes and entries of its parameters, none where it
        has nothing that differs, and returns itself for that: it may leave out what else is zero.
        """
        found: dict[str, list[tuple[str, Any]]] = {}
        for place, entry in entries:
            found.setdefault(place.path, []).append((place.name, entry))

        def own(path: str, part: object, changed: Mapping[str, Any]) -> Any:
            new = _holding("varying", part, changed) if changed else part
            return new.varying(found.get(path, ())) if hasattr(new, "varying") else new

        return self._rebuilt(own)

    def on_symbols(self) -> Parts:
        """Return the parts, and those within them, as they want to be traced.

        That is ``traced()`` of a part whose own law is not NumPy.
        """
        return self.replaced(lambda path, part: part if path == "trajectory" else _on_symbols(part))

    def on_arrays(self) -> Parts:
        """Return the parts as `on_symbols` does; those that cannot be traced, as they are."""

        def own(path: str, part: object) -> Any:
            if path == "trajectory":
                return part
            try:
                return _on_symbols(part)
            except NotTraceable:
                return part

        return self.replaced(own)

    def parameters(self) -> dict[Place, Array]:
        """Return the values of all parameters, those of parts within parts included."""
        return {
            Place(path + inner, name): value
            for path, part in self.by_path()
            for inner, name, value in _parameters(path, part)
        }

    def with_parameters(self, values: Mapping[Place, Any], *, remade: bool = False) -> Parts:
        """Return copies of the parts with other values of their parameters.

        Parameters
        ----------
        values : mapping of Place to array
            What takes their place, whatever its shape.
        remade : bool
            Whether parts are made again, and those that hold them, which check themselves and derive what
            follows from the values: by ``with_parameters(**values)`` of those that have it, by
            `dataclasses.replace` of dataclasses, by their class of others.

        Raises
        ------
        UnknownName
            If there is no such part, or it has no such parameter.
        """
        left = dict(values)

        def own(path: str, part: object, changed: Mapping[str, Any]) -> Any:
            mine = {name: left.pop(Place(path, name)) for name in attributes_of(part) if (path, name) in left}
            if not (mine or changed):
                return part
            return (made_again if remade else copied)(part, mine, changed)

        new = self._rebuilt(own)
        for parameter in left:
            available = (f"{path}.{name}" for path, name in self.parameters())
            raise UnknownName("parameter", f"{parameter[0]}.{parameter[1]}", available)
        return new


def displaced(integrator: Any, acceleration: Any, first: Any, t: Moment, v: Values, h: Moment) -> Any:
    """Return the displacement and the velocity after a step of any integrator, which gets copies."""
    still, own = np.zeros(np.shape(v)), v.copy()

    def asked(time: Moment, moved: Values, rate: Values) -> Any:
        known = moved is still and rate is own and time is t and type(v) is np.ndarray
        if known and not still.any() and (own == v).all():  # unless it was written into
            return first
        return acceleration(time, moved, rate)

    answer = integrator(asked, t, still, own, h)
    wrong = type(answer) is not tuple or len(answer) != 2
    if wrong or any(np.shape(x) != np.shape(v) or not are_real(x) for x in answer):
        raise InvalidArgument(
            f"integrator returned {shown(answer)}{when(t)}, expected (q, v) of shapes {np.shape(v)} and "
            f"{np.shape(v)}, of real numbers"
        )
    return answer


def when(t: Moment) -> str:
    """Return a time in words, for messages; nothing of a symbol."""
    return f" at t = {t:g} s" if isinstance(t, float) else ""


class _Unchecked:
    """A plant by its unchecked calls; for the rest, itself."""

    def __init__(self, plant: Any) -> None:
        calls = plant.calls()
        accelerated = calls.forward_dynamics
        self.plant, self.nq, self.nv, self.nu = plant, plant.nq, plant.nv, plant.nu
        self.pose, self.rate, self.effort = calls.pose, calls.rate, calls.effort
        self.integrate = np.add if plant.adds else plant.integrate

        def forward_dynamics(q: Array, v: Array, u: Array, f: Array | None = None) -> Array:
            return np.array(accelerated(q, v, u if f is None else u + f))  # the next call writes into it

        self.forward_dynamics = forward_dynamics

    def __getattr__(self, name: str) -> Any:
        return getattr(self.plant, name)


def _parameters(path: str, part: object) -> Sequence[tuple[str, str, Array]]:
    """Return path within a part, name and value of its parameters and of those of parts within it."""
    own, stated = known(part), getattr(type(part), "parameters", None)
    name_of_memory = "parameters", path.startswith("trajectory")
    if own is not None and own.memory.get(name_of_memory, (own,))[0] is stated:
        return own.memory[name_of_memory][1]  # type: ignore[no-any-return]
    found = [("", name, _value(path, part, name)) for name in attributes_of(part)]
    for child, inner in children_at(path, part):
        found += [
            (f".{child}{below}", name, value) for below, name, value in _parameters(f"{path}.{child}", inner)
        ]
    if own is not None:
        own.memory[name_of_memory] = stated, found
    return found


def _on_symbols(part: object) -> Any:
    if hasattr(part, "traced"):
        return part.traced()

    def symbolic(child: object) -> Any:
        try:
            return _on_symbols(child)
        except NotTraceable:
            return child  # a law that asks it says so itself

    inner = {name: (child, symbolic(child)) for name, child in children(part)}
    changed = {name: new for name, (old, new) in inner.items() if new is not old}
    return _holding("on symbols", part, changed) if changed else part


def _holding(why: str, part: object, changed: Mapping[str, Any]) -> Any:
    """Return a copy of a part that holds others: the one of last time where these are the same."""
    own = known(part)
    before = own and own.memory.get(why)
    if before and list(before[0]) == list(changed) and all(map(is_, before[0].values(), changed.values())):
        return before[1]
    made = copied(part, {}, changed)
    if own is not None:
        own.memory[why] = changed, made
    return made


def children(part: object) -> Sequence[tuple[str, Any]]:
    """Return the parts that a part holds: as attributes, in lists, and behind methods, by name."""
    own = known(part)
    if own is None:
        return list(_children(part))
    if "children" not in own.memory:
        own.memory["children"] = list(_children(part))
    return own.memory["children"]  # type: ignore[no-any-return]


def _children(part: object) -> Iterator[tuple[str, Any]]:
    for name, value in getattr(part, "__dict__", {}).items():
        if isinstance(value, list | tuple):
            yield from ((f"{name}[{i}]", each) for i, each in enumerate(value) if is_part(each))
        elif isinstance(value, MethodType):
            if value.__self__ is not part and is_part(value.__self__):
                yield name, value.__self__
        elif is_part(value):
            yield name, value


def children_at(path: str, part: object) -> Iterator[tuple[str, Any]]:
    """Return the parts that a part at a path holds and whose parameters are the loop's.

    A trajectory may know a robot, whose limits it keeps; nothing follows from that robot's parameters.
    """
    for name, child in children(part):
        if not (path.startswith("trajectory") and hasattr(child, "forward_dynamics")):
            yield name, child


def attributes_of(part: object) -> tuple[str, ...]:
    """Return the attributes of a part that may differ from robot to robot.

    They hold its parameters, and what each robot draws, which a part lists as ``drawn``.
    """
    drawn = getattr(part, "drawn", ())
    found = [each.attribute for each in parameters_of(part)]
    return tuple(dict.fromkeys([*found, *(drawn if isinstance(drawn, list | tuple) else ())]))


def _value(path: str, part: object, name: str) -> Array:
    try:
        return np.asarray(getattr(part, name), np.float64)
    except AttributeError:
        raise InvalidArgument(
            f"{path}, a {type(part).__name__}, states the parameter {name!r} and has no such attribute"
        ) from None
    except (TypeError, ValueError):
        check_numbers(f"{path}.{name}", getattr(part, name))
        raise


def check_numbers(name: str, value: object) -> None:
    """Refuse the value of a parameter that is no number and no array of numbers.

    Raises
    ------
    InvalidArgument
        If it is such.
    """
    try:
        np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise InvalidArgument(f"{name} is {shown(value)}, expected a number or an array") from None


_DEEP = 8  # objects within objects that a part holds


def copied(part: object, values: Mapping[str, Any], parts: Mapping[str, Any]) -> Any:
    """Return a copy of a part with other values of attributes, and other parts in it."""
    new = copy.copy(part)
    for each in type(part).__mro__:
        for name, attribute in vars(each).items():
            if isinstance(attribute, functools.cached_property):
                new.__dict__.pop(name, None)  # it belongs to the old values
    if found := structures_of(part):
        new.__dict__.update(found)
    set_ = dict(values)
    for name, value in getattr(part, "__dict__", {}).items():
        if isinstance(value, list | tuple) and any(f"{name}[{i}]" in parts for i in range(len(value))):
            held = [parts.get(f"{name}[{i}]", each) for i, each in enumerate(value)]
            set_[name] = type(value)(*held) if hasattr(value, "_fields") else type(value)(held)
        elif isinstance(value, MethodType) and (name in parts or value.__self__ is part):
            set_[name] = getattr(parts.get(name, new), value.__name__)
        elif name in parts:
            set_[name] = parts[name]
    for name, value in set_.items():
        try:
            object.__setattr__(new, name, value)
        except AttributeError:
            raise InvalidArgument(
                f"{name} of a {type(part).__name__} is computed and cannot be set, expected an attribute"
            ) from None
    return new


def made_again(part: object, values: Mapping[str, Any], parts: Mapping[str, Any]) -> Any:
    """Return a part that is made again with other values of attributes, and other parts in it.

    By its own ``with_parameters(**values)``; by `dataclasses.replace` of a dataclass; of another class by
    calling it, where it keeps the arguments of its constructor under their names.

    Raises
    ------
    InvalidArgument
        If it cannot be made again, though it keeps what may follow from the values.
    """
    other = copied(part, {}, parts)
    if hasattr(part, "with_parameters"):
        return other.with_parameters(**values) if values else other
    if attrs.has(type(part)):
        return attrs.evolve(other, **values)
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        try:
            return dataclasses.replace(other, **values)
        except PinmobileError:
            raise
        except (TypeError, ValueError) as error:  # its constructor takes other arguments than its fields
            raise InvalidArgument(
                f"a {type(part).__name__} cannot be made again by dataclasses.replace: {error}; expected "
                "fields that its constructor takes, or with_parameters(**values)"
            ) from error
    if _can_be_called(part) and values.keys() <= _arguments(part):
        return _called(other, values)
    check_made_again(type(part).__name__, part, values)
    return copied(part, values, parts)


def is_part(x: object) -> bool:
    """Tell whether something that a part holds is a part itself."""
    known = hasattr(x, "parameters") or hasattr(x, "initial_state") or attrs.has(type(x))
    return known and not isinstance(x, type)


def check_made_again(name: str, part: object, values: Iterable[str]) -> None:
    """Refuse a part that cannot be made again with other values, though it keeps what may follow from them.

    Parameters
    ----------
    name : str
        What it is called in messages.
    part : part
        What is asked.
    values : iterable of str
        Attributes that get other values.

    Raises
    ------
    InvalidArgument
        If it is such; what to write.
    """
    if hasattr(part, "with_parameters") or dataclasses.is_dataclass(part) or attrs.has(type(part)):
        return
    wanted = set(values)
    if not wanted or type(part).__init__ is object.__init__:
        return  # nothing was derived when it was made
    if wanted <= _arguments(part) and _can_be_called(part):
        return
    kept = [
        key
        for key, value in _own(part)
        if not (key in wanted or is_part(value)) and any(True for _ in _numbers(value))
    ]
    if kept:
        missing = ", ".join(sorted(wanted))
        raise InvalidArgument(
            f"{name} is a {type(part).__name__}, which cannot be made again with another {missing} and "
            f"may have made {', '.join(kept)} of that: expected an __init__ that takes {missing} and keeps "
            "each argument under its own name, a dataclass, or with_parameters(**values), which returns a "
            "new one"
        )


def derived(part: object, other: object, apart: Iterable[str] = ()) -> str:
    """Return which numbers of a part differ from another's, by the name of the attribute; "" where none.

    Parameters
    ----------
    part, other : parts
        Of one class.
    apart : iterable of str
        Attributes that may differ.
    """
    theirs, skipped = dict(_own(other)), set(apart)
    for name, value in _own(part):
        if name not in skipped and not _alike(value, theirs.get(name)):
            return name
    return ""


def _arguments(part: object) -> set[str]:
    try:
        return set(inspect.signature(type(part)).parameters)
    except (TypeError, ValueError):  # as of some that are built in
        return set()


def _called(part: object, values: Mapping[str, Any]) -> Any:
    """Return a new one of its class: each argument is a value, or what the part keeps under that name."""
    ahead, named = [], {}
    for name, argument in inspect.signature(type(part)).parameters.items():
        several = argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD)
        if several or not (name in values or hasattr(part, name)):
            continue  # by default, which may be something else: that is looked at
        value = values[name] if name in values else getattr(part, name)
        if argument.kind is argument.POSITIONAL_ONLY:
            ahead.append(value)
        else:
            named[name] = value
    return type(part)(*ahead, **named)


def _can_be_called(part: object) -> bool:
    """Tell whether a part that is made of what it keeps is the same."""
    try:
        same = _called(part, {})
    except Exception:  # whatever a class raises of what are not its arguments
        return False
    return not derived(part, same) and not derived(same, part)


def _own(part: object) -> Iterator[tuple[str, Any]]:
    """Yield what an object keeps, by name, without what it computed later."""
    for name, value in getattr(part, "__dict__", {}).items():
        if not isinstance(getattr(type(part), name, None), functools.cached_property):
            yield name, value
    yield from structures_of(part).items()


def _alike(one: object, other: object) -> bool:
    if one is other:
        return True
    first, second = list(_numbers(one)), list(_numbers(other))
    return len(first) == len(second) and all(
        np.array_equal(a, b, equal_nan=True) for a, b in zip(first, second, strict=True)
    )


def _numbers(x: object, deep: int = _DEEP) -> Iterator[Array]:
    """Yield all numbers that a value holds: in lists and the like, in objects, in closures."""
    if is_leaf(x):
        yield np.asarray(x, np.float64)
        return
    if not deep or isinstance(x, type | ModuleType):
        return
    if isinstance(x, Mapping | list | tuple):
        inner = list(x.values() if isinstance(x, Mapping) else x)
    else:
        cells = (cell.cell_contents for cell in getattr(x, "__closure__", None) or ())
        inner = [*(value for _, value in _own(x)), *cells, *(getattr(x, "__defaults__", None) or ())]
    for each in inner:
        yield from _numbers(each, deep - 1)
