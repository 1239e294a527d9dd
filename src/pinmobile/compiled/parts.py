"""The parts of a closed loop, their parameters by path and name, and one sample of the loop, written once.

`one_sample` runs on numbers as on symbols: it is what the compiled loop repeats.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import is_
from types import MethodType
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, are_real
from pinmobile.compiled.copies import copied, is_part, made_again
from pinmobile.compiled.memory import mapped
from pinmobile.compiled.recorders import Record, Sample
from pinmobile.compiled.symbolic import entries, has_symbols
from pinmobile.constancy import known
from pinmobile.errors import InvalidArgument, NotTraceable, UnknownName, shown
from pinmobile.measures import measured_of
from pinmobile.signals import claimed, number, signals_of

_NAMED = ("plant", "controller", "integrator", "recorder", "trajectory")


class Reference(NamedTuple):
    """What is to be followed: the first n coordinates; leading axes where there are several samples.

    Attributes
    ----------
    q, v, a : ndarray, shape (..., leading[n]), (..., n), (..., n)
        Configuration, velocity and acceleration.
    """

    q: Any
    v: Any
    a: Any


class Memory(NamedTuple):
    """What the parts keep between samples."""

    plant: Any
    controller: Any
    recorder: Any


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

        def visit(path: str, part: Any) -> Any:
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

        def own(path: str, part: Any, changed: Mapping[str, Any]) -> Any:
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

        def own(path: str, part: Any) -> Any:
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

        def own(path: str, part: Any, changed: Mapping[str, Any]) -> Any:
            mine = {name: left.pop(Place(path, name)) for name in attributes_of(part) if (path, name) in left}
            if not (mine or changed):
                return part
            return (made_again if remade else copied)(part, mine, changed)

        new = self._rebuilt(own)
        for parameter in left:
            available = (f"{path}.{name}" for path, name in self.parameters())
            raise UnknownName("parameter", f"{parameter[0]}.{parameter[1]}", available)
        return new


def _parameters(path: str, part: Any) -> Sequence[tuple[str, str, Array]]:
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


def _on_symbols(part: Any) -> Any:
    if hasattr(part, "traced"):
        return part.traced()

    def symbolic(child: Any) -> Any:
        try:
            return _on_symbols(child)
        except NotTraceable:
            return child  # a law that asks it says so itself

    inner = {name: (child, symbolic(child)) for name, child in children(part)}
    changed = {name: new for name, (old, new) in inner.items() if new is not old}
    return _holding("on symbols", part, changed) if changed else part


def _holding(why: str, part: Any, changed: Mapping[str, Any]) -> Any:
    """Return a copy of a part that holds others: the one of last time where these are the same."""
    own = known(part)
    before = own and own.memory.get(why)
    if before and list(before[0]) == list(changed) and all(map(is_, before[0].values(), changed.values())):
        return before[1]
    made = copied(part, {}, changed)
    if own is not None:
        own.memory[why] = changed, made
    return made


def children(part: Any) -> Sequence[tuple[str, Any]]:
    """Return the parts that a part holds: as attributes, in lists, and behind methods, by name."""
    own = known(part)
    if own is None:
        return list(_children(part))
    if "children" not in own.memory:
        own.memory["children"] = list(_children(part))
    return own.memory["children"]  # type: ignore[no-any-return]


def _children(part: Any) -> Iterator[tuple[str, Any]]:
    for name, value in getattr(part, "__dict__", {}).items():
        if isinstance(value, list | tuple):
            yield from ((f"{name}[{i}]", each) for i, each in enumerate(value) if is_part(each))
        elif isinstance(value, MethodType):
            if value.__self__ is not part and is_part(value.__self__):
                yield name, value.__self__
        elif is_part(value):
            yield name, value


def children_at(path: str, part: Any) -> Iterator[tuple[str, Any]]:
    """Return the parts that a part at a path holds and whose parameters are the loop's.

    A trajectory may know a robot, whose limits it keeps; nothing follows from that robot's parameters.
    """
    for name, child in children(part):
        if not (path.startswith("trajectory") and hasattr(child, "forward_dynamics")):
            yield name, child


def attributes_of(part: Any) -> tuple[str, ...]:
    """Return the attributes of a part that may differ from robot to robot.

    They hold its parameters, and what each robot draws, which a part lists as ``drawn``.
    """
    stated, drawn = (getattr(part, name, ()) for name in ("parameters", "drawn"))
    found = [
        each if isinstance(each, str) else each.attribute or each.name
        for each in (stated if isinstance(stated, list | tuple) else ())
    ]
    return tuple(dict.fromkeys([*found, *(drawn if isinstance(drawn, list | tuple) else ())]))


def _value(path: str, part: Any, name: str) -> Array:
    try:
        return np.asarray(getattr(part, name), np.float64)
    except AttributeError:
        raise InvalidArgument(
            f"{path}, a {type(part).__name__}, states the parameter {name!r} and has no such attribute"
        ) from None
    except (TypeError, ValueError):
        check_numbers(f"{path}.{name}", getattr(part, name))
        raise


def check_numbers(name: str, value: Any) -> None:
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


class Stepped(NamedTuple):
    """What one sample of a loop comes to.

    Attributes
    ----------
    sample : Sample
        As it was recorded.
    q, v : ndarray
        State at the next sample.
    memory : Memory
        What the parts keep.
    record : Record
        What the recorder made of it.
    """

    sample: Sample
    q: Any
    v: Any
    memory: Memory
    record: Record


def one_sample(
    parts: Parts, k: Any, t: Any, h: Any, state: tuple[Any, Any], reference: Reference, memory: Memory
) -> Stepped:
    """Return one sample of the closed loop, and the state at the next.

    Parameters
    ----------
    parts : Parts
        The loop.
    k, t, h : float
        Number and time of the sample, and length of a substep [s].
    state : tuple of ndarray, shape (nq,), (nv,)
        Configuration and velocity.
    reference : Reference
        Of this sample.
    memory : Memory
        What the parts keep.
    """
    q, v = state
    plant, controller = parts.plant, parts.controller
    # What is the loop's own is not a controller's to write into.
    own = mapped(memory.controller, _copy)
    answer = controller(t, q.copy(), v.copy(), Reference(*map(_copy, reference)), own)
    if type(answer) is not tuple or len(answer) != 2:
        raise InvalidArgument(f"controller returned {answer!r}, expected (u, state)")
    u, inner = np.asarray(answer[0]), answer[1]
    expected = (*np.shape(v)[:-1], plant.nu)
    if np.shape(u) != expected:
        raise InvalidArgument(f"controller returned an input of shape {np.shape(u)}, expected {expected}")
    _check_real("controller", u)
    u = limited(plant, u)
    if hasattr(controller, "applied"):
        inner = controller.applied(u, inner)
    error, error_rate = tracking_errors(plant, q, v, reference)
    step = _own_step if hasattr(plant, "step") else _integrated
    acceleration, q1, v1, kept = step(parts, t, h, q, v, u, memory.plant)
    for name, found in (("plant", acceleration), ("step of the plant", q1), ("step of the plant", v1)):
        _check_real(name, found)
    signals = {}
    if getattr(parts.recorder, "signals", False):
        signals = claimed(_told(parts, t, q, v, u, memory.plant, inner), _signal)
    measured: Any = ()
    if getattr(parts.recorder, "measures", ()):
        measured = measured_of(plant, t, q, v, acceleration, u, reference)
    sample = Sample(k, t, q, v, u, acceleration, error, error_rate, signals, measured)
    record = Record(None) if parts.recorder is None else parts.recorder(sample, memory.recorder)
    return Stepped(sample, q1, v1, Memory(kept, inner, record.state), record)


def _told(parts: Parts, t: Any, q: Any, v: Any, u: Any, memory: Any, inner: Any) -> Iterator[tuple[str, Any]]:
    """Yield the signals of the parts at a sample, each with what the part is called."""
    plant = parts.plant
    if hasattr(plant, "signals"):
        f = _pushed(parts, t, q, v) + np.zeros(plant.nv)
        yield "plant", plant.signals(t, q.copy(), v.copy(), u.copy(), f, memory)
    yield "controller", signals_of(parts.controller, inner)
    for i, force in enumerate(parts.forces):
        if hasattr(force, "on_coordinates"):
            yield f"forces[{i}]", signals_of(force, t, q.copy(), v.copy())
        elif hasattr(force, "signals"):
            yield f"forces[{i}]", force.signals(t, plant.pose(q), plant.rate(q, v))


def _signal(name: str, value: Any) -> Any:
    return entries(value) if has_symbols(value) else number(name, value)


def _check_real(name: str, found: Any) -> None:
    if not are_real(found):
        raise InvalidArgument(f"{name} returned {shown(found)}, expected real numbers")


def _copy(x: Any) -> Any:
    return x.copy() if hasattr(x, "copy") else x


def tracking_errors(plant: Any, q: Any, v: Any, reference: Reference) -> tuple[Any, Any]:
    """Return the error of the reference's coordinates, and its rate, shape (n,) each."""
    n, length = reference.v.shape[-1], reference.q.shape[-1]
    whole = reference.q
    if length != plant.nq:  # what has no reference is where it should be
        ahead = np.shape(q)[:-1]
        whole = np.concatenate([np.broadcast_to(whole, (*ahead, length)), q[..., length:]], axis=-1)
    return plant.difference(q, whole)[..., :n], reference.v - v[..., :n]


def limited(plant: Any, u: Any) -> Any:
    """Return the input within the plant's limits."""
    inputs = getattr(plant, "inputs", ())
    lower, upper = (
        np.array([getattr(each, side, None) for each in inputs], float) for side in ("lower", "upper")
    )
    low, high = np.where(np.isnan(lower), -np.inf, lower), np.where(np.isnan(upper), np.inf, upper)
    if not (np.isfinite(low).any() or np.isfinite(high).any()):
        return u
    return np.clip(u, low, high)


def _pushed(parts: Parts, t: Any, q: Any, v: Any) -> Any:
    """Return the forces on the coordinates beside the input, shape (nv,), or 0."""
    plant, total = parts.plant, 0.0
    wrenches = [force for force in parts.forces if not hasattr(force, "on_coordinates")]
    if wrenches:
        pose, rate = plant.pose(q), plant.rate(q, v)
        wrench = sum((_answer(parts, force, force(t, pose, rate), np.shape(pose)) for force in wrenches), 0.0)
        total = plant.effort(q, wrench)
        if total is None:
            raise InvalidArgument(
                f"plant is a {type(plant).__name__}, whose body cannot be pushed, and forces push it"
            )
    others = [force for force in parts.forces if hasattr(force, "on_coordinates")]
    return sum((_answer(parts, force, force.on_coordinates(t, q, v), np.shape(v)) for force in others), total)


def _answer(parts: Parts, force: Any, found: Any, shape: tuple[int, ...]) -> Any:
    """Check that a force returned an array of its shape, and return that."""
    if not hasattr(found, "shape") or np.shape(found) != shape:
        k = next(i for i, each in enumerate(parts.forces) if each is force)
        raise InvalidArgument(f"forces[{k}] returned {shown(found)}, expected an array of shape {shape}")
    if not are_real(found):
        k = next(i for i, each in enumerate(parts.forces) if each is force)
        _check_real(f"forces[{k}]", found)
    return found


def integrate_of(plant: Any) -> Any:
    """Return how a displacement moves a plant's configuration: as it says, else by addition."""
    return getattr(plant, "integrate", None) or np.add


def _integrated(parts: Parts, t: Any, h: Any, q: Any, v: Any, u: Any, memory: Any) -> Any:
    """Return the acceleration, and the state after the substeps, by the integrator on displacements."""
    plant = parts.plant
    integrate = integrate_of(plant)

    def advanced(t: Any, q: Any, v: Any) -> tuple[Any, Any]:
        def acceleration(time: Any, moved: Any, rate: Any) -> Any:
            there = integrate(q, moved)
            return plant.forward_dynamics(there, rate, u, _pushed(parts, time, there, rate))

        answer = parts.integrator(acceleration, t, np.zeros(plant.nv), v, h)
        if type(answer) is not tuple or len(answer) != 2:
            raise InvalidArgument(
                f"integrator returned {shown(answer)} at t = {t:g} s, expected (q, v) of shapes "
                f"({plant.nv},) and ({plant.nv},)"
            )
        moved, v = answer
        q = integrate(q, moved)
        return q, plant.project(q, v) if hasattr(plant, "project") else v

    first = plant.forward_dynamics(q, v, u, _pushed(parts, t, q, v))
    for j in range(parts.substeps):
        q, v = advanced(t + j * h if j else t, q, v)
    return first, q, v, memory


def _own_step(parts: Parts, t: Any, h: Any, q: Any, v: Any, u: Any, memory: Any) -> Any:
    """Return the mean acceleration of the first substep, and the state after all, by the plant's own step."""
    acceleration = None
    for j in range(parts.substeps):
        time = t + j * h if j else t
        found = parts.plant.step(time, q, v, u, h, _pushed(parts, time, q, v), memory)
        acceleration = (found.v - v) / h if acceleration is None else acceleration
        q, v, memory = found.q, found.v, found.memory
    return acceleration, q, v, memory
