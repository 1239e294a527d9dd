"""From the parts of a closed loop to its tape: their laws run on symbols, and compared with themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.compiled.loop_tape import (
    Leaf,
    Loop,
    Ring,
    arrays_of,
    check_schedules,
    initial_memory,
    scheduled_rows,
)
from pinmobile.compiled.memory import Noise, Schedule, leaves, mapped, matched, normals
from pinmobile.compiled.parts import Parts, Place
from pinmobile.compiled.sample import Memory, Reference, Stepped, one_sample
from pinmobile.compiled.symbolic import Symbols, Values, entries, symbols
from pinmobile.compiled.tape import COUNT, LARGEST, Known, Node, Tape, evaluated, float_bits, needed, real
from pinmobile.compiled.tracing import Walk, calling_place, place_of, tracing
from pinmobile.errors import InvalidArgument, NotTraceable, UnknownName


def traced(
    parts: Parts,
    context: object,
    start: tuple[Array, Array],
    reference: Reference,
    *,
    dt: float,
    spread: Iterable[Place] = (),
    largest: int = LARGEST,
    own_reference: bool = False,
    walk: Walk | None = None,
) -> Loop:
    """Return a closed loop as a tape.

    The laws run once on numbers, so that their own errors come as they are, and then on symbols: those that
    are not the library's own at least twice. Both tapes must be the same, and give the numbers.

    Parameters
    ----------
    parts : Parts
        The loop.
    context : object
        What the controller's `initial_state` is told.
    start : (ndarray, ndarray), shape (nq,), (nv,)
        A start.
    reference : Reference
        Its first sample.
    dt : float
        Time between two samples [s].
    spread : iterable of Place
        Those that each robot has a value of its own for; the others are numbers of the run.
    largest : int
        Most nodes of the tape.
    own_reference : bool
        Whether each robot has a reference of its own.
    walk : Walk, optional
        Through the parts as they are on symbols, and `one_sample`, where there is one.

    Raises
    ------
    NotTraceable
        If a law cannot be run on symbols; its line, and what to write instead.
    UnknownName
        If there is no such parameter.
    """
    q, v = (np.asarray(x, np.float64) for x in start)
    given = Reference(*(np.asarray(x, np.float64) for x in reference))
    parts = parts.on_symbols()
    trace = _Trace(
        parts,
        context,
        q,
        v,
        given,
        dt / parts.substeps,
        spread=frozenset(Place(*x) for x in spread),
        largest=largest,
    )
    trace.own_reference, trace.walk = own_reference, walk or walk_of(parts)
    return trace.result()


def walk_of(parts: Parts) -> Walk:
    """Return a walk through all that a loop's code refers to."""
    return Walk([one_sample, *(part for _, part in parts.by_path())])


class _Asked(NamedTuple):
    """What the laws were asked on numbers, and what they gave.

    Attributes
    ----------
    k : int
        Number of the sample.
    q, v : ndarray, shape (nq,), (nv,)
        State.
    memory : Memory
        What the parts keep, as before any sample.
    found : Stepped
        What the sample comes to.
    """

    k: int
    q: Array
    v: Array
    memory: Memory
    found: Stepped


class _Trace:
    """The way from parts to a tape."""

    walk: Walk

    def __init__(
        self,
        parts: Parts,
        context: object,
        q: Array,
        v: Array,
        reference: Reference,
        h: float,
        *,
        spread: frozenset[Place],
        largest: int,
    ) -> None:
        self.parts, self.context, self.h = parts, context, h
        self.q, self.v, self.reference = q, v, reference
        self.values = parts.parameters()
        for parameter in spread - set(self.values):
            names = (f"{path}.{name}" for path, name in self.values)
            raise UnknownName("parameter", f"{parameter[0]}.{parameter[1]}", names)
        self.spread, self.largest, self.own_reference = spread, largest, False
        self.fixed: frozenset[tuple[str, str]] = frozenset()
        self.shapes: dict[tuple[str, str], tuple[int, ...]] = {}

    def result(self) -> Loop:
        """Return the tape, after it has been compared with itself and with numbers."""
        check_schedules(self.parts, self.context, len(self.reference.v), self.spread)
        try:
            number = self._shaped()
        except AttributeError as error:  # which the robot itself has, that the law was asked with before
            raise NotTraceable(
                str(error), "ask a robot for what it has on symbols", place_of(error.__traceback__)
            ) from error
        loop = self._loop()
        fixed = frozenset(
            (leaf.owner, leaf.path) for leaf in loop.leaves if leaf.kind == "state" and _stays(loop, leaf)
        )
        if fixed:
            self.fixed = fixed
            loop = self._loop()
        if not self.walk.is_ours:
            self._compare_tapes(loop, self._loop())
        self._compare_numbers(loop, number)
        return loop

    def _shaped(self) -> list[_Asked]:
        """Return what the laws give on numbers at two samples, after learning the memory's shapes of them."""
        for _ in range(4):
            memory = self._memory(0)
            found = self._at(0, self.q, self.v, memory)
            grew = False
            for owner, before, after in zip(Memory._fields, memory, found.memory, strict=True):
                for path, old, new in matched(before, after, "state"):
                    if np.shape(old) != np.shape(new):
                        self.shapes[owner, path] = _wider(owner, path, np.shape(old), np.shape(new))
                        grew = True
            if not grew:
                return [_Asked(0, self.q, self.v, memory, found), self._elsewhere()]
        raise NotTraceable("the memory has another shape at each sample", "keep arrays of one shape in state")

    def _at(self, k: int, q: Array, v: Array, memory: Memory) -> Stepped:
        """Return a sample on numbers; laws may write into what they are given."""
        reference, own = Reference(*(x.copy() for x in self.reference)), mapped(memory, np.copy)
        return one_sample(self.parts, float(k), 0.0, self.h, (q.copy(), v.copy()), reference, own)

    def _memory(self, k: int) -> Memory:
        """Return the memory before any sample, but with the noise of sample k."""
        size = len(self.reference.v)
        begun = initial_memory(
            self.parts,
            self.context,
            size,
            normal=lambda name, n: Noise(0, n, k),
            schedule=lambda rows: Schedule(rows, k),
        )
        return self._grown(begun)

    def _elsewhere(self) -> _Asked:
        """Return the same a sample later at another state, which no law takes for a special one."""
        v = self.v + 0.05 * np.sin(1.0 + np.arange(len(self.v)))
        moved = 0.07 * np.cos(2.0 + np.arange(len(self.v)))
        integrate = getattr(self.parts.plant, "integrate", None) or np.add
        q = np.asarray(integrate(self.q, moved), np.float64)
        memory = self._memory(1)
        return _Asked(1, q, v, memory, self._at(1, q, v, memory))

    def _grown(self, memory: Memory) -> Memory:
        """Return the memory with arrays of the shapes that they come to have."""
        found = []
        for owner, tree in zip(Memory._fields, memory, strict=True):
            paths = iter([path for path, _ in leaves(tree)])

            def grow(leaf: ArrayLike, owner: str = owner, paths: Iterator[str] = paths) -> ArrayLike:
                shape = self.shapes.get((owner, next(paths)))
                return leaf if shape is None else np.broadcast_to(leaf, shape).copy()

            found.append(mapped(tree, grow))
        return Memory(*found)

    def _loop(self, where: Callable[[], str] | None = None) -> Loop:
        return _Pass(self, Tape(self.largest, where)).loop()

    def _compare_tapes(self, one: Loop, two: Loop) -> None:
        if one.tape.operations == two.tape.operations and one.outputs == two.outputs:
            return
        told = self._loop(calling_place)
        ends = [len(told.tape) - 1]
        for other in (one, two):  # a law that takes turns is told apart from one of them
            known = zip(other.tape.operations, told.tape.operations, strict=False)
            ends += [i for i, (a, b) in enumerate(known) if a != b][:1]
        differ = min(ends)
        raise NotTraceable(
            "the law computes something else when it is asked again, as one does that counts, draws or "
            "remembers outside its state",
            "keep memory in state, and take noise from context.normal(name, n)",
            told.tape.places[min(differ, len(told.tape.places) - 1)],
        )

    def _compare_numbers(self, loop: Loop, numbers: Sequence[_Asked]) -> None:
        for asked in numbers:
            inputs, found = self._inputs(loop, asked), asked.found
            memory = zip(loop.leaves, arrays_of(found.memory), strict=True)
            kept = [value for leaf, value in memory if leaf.kind == "state"]
            rows = [_flat_numbers([x]) for x in (found.q, found.v, *kept, *found.record.kept.values())]
            expected = [x for row in rows for x in row]
            sizes = [max(map(abs, row)) for row in rows for _ in row]  # forces of wheels share their errors
            wanted = [after for _, after in loop.states]
            wanted += [node for _, nodes in loop.kept.values() for node in nodes]
            with np.errstate(all="ignore"):
                got = evaluated(loop.tape, wanted, inputs)
                near = np.isclose(
                    np.array(got, float),
                    np.array(expected),
                    rtol=1e-7,
                    atol=1e-9 + 1e-7 * np.nan_to_num(sizes),
                    equal_nan=True,
                )
            if not near.all():
                i = int(np.argmin(near))
                raise NotTraceable(
                    f"on symbols, {_name(loop, i)} is {got[i]:g} after a sample, and on numbers "
                    f"{expected[i]:g}",
                    "let the law do the same for every kind of array, without isinstance or try",
                )

    def _inputs(self, loop: Loop, asked: _Asked) -> dict[Any, Any]:
        """Return the inputs of the tape at a sample."""
        inputs: dict[Any, Any] = {COUNT: np.uint64(asked.k), ("uniform", 0): self.h}
        samples = _flat_numbers([0.0, *self.reference])
        inputs |= {("track", i): x for i, x in enumerate(samples[1:])}
        rows = scheduled_rows(self.parts, self.context, len(self.reference.v))
        samples += _flat_numbers([each[min(asked.k, len(each) - 1)] for each in rows])
        inputs |= {("sample", i): x for i, x in enumerate(samples)}
        inputs |= {("key", i): np.uint64(0) for i in range(len(loop.keys))}
        inputs |= {("state", i): x for i, x in enumerate(_flat_numbers([asked.q, asked.v]))}
        for parameter, leaf in loop.parameters.items():
            values = self.values[parameter].ravel()
            inputs |= {(leaf.kind, leaf.first + i): x for i, x in enumerate(values)}
        for leaf, value in zip(loop.leaves, arrays_of(asked.memory), strict=True):
            inputs |= {(leaf.kind, leaf.first + i): x for i, x in enumerate(_flat_numbers([value]))}
        return inputs


class _Pass:
    """One run of the laws on symbols."""

    def __init__(self, trace: _Trace, tape: Tape) -> None:
        self.trace, self.tape = trace, tape
        self.next = {"uniform": 0, "row": 0, "state": 0, "sample": 0, "track": 0}
        self.keys: list[str] = []
        self.asked: list[str] = []
        self.rings: list[Ring] = []
        self.leaves: list[Leaf] = []
        self.parameters: dict[Place, Leaf] = {}
        self.now: list[int] = []

    def _new(self, kind: str, shape: tuple[int, ...]) -> Symbols:
        first, count = self.next[kind], int(np.prod(shape))
        self.next[kind] += count
        nodes = [self.tape.input(kind, first + i) for i in range(count)]
        if kind == "state":
            self.now += [node.index for node in nodes]
        return symbols(nodes, shape)

    def loop(self) -> Loop:
        trace, tape = self.trace, self.tape
        h = self._new("uniform", ())
        parts = self._symbolic()
        q, v = self._new("state", trace.q.shape), self._new("state", trace.v.shape)
        t = self._new("sample", ())
        reference = Reference(
            *(self._new("track" if trace.own_reference else "sample", x.shape) for x in trace.reference)
        )
        self.next["sample"] = columns = 1 + sum(x.size for x in trace.reference)
        k = symbols([real(tape.input(*COUNT) | float_bits(2.0**52)) - 2.0**52], ())
        numbers = trace._grown(
            initial_memory(
                trace.parts,
                trace.context,
                len(trace.reference.v),
                self._line,
                self._noise,
                self._schedule,
            )
        )
        memory = Memory(
            *(self._remembered(owner, tree) for owner, tree in zip(Memory._fields, numbers, strict=True))
        )
        with tracing(trace.walk):
            found = one_sample(parts, k, t, h, (q, v), reference, memory)
            after = self._after(memory, found)
        kept = {
            name: (np.shape(x), [self._node(y) for y in entries(x).reshape(-1)])
            for name, x in found.record.kept.items()
        }
        counted = [self._node(y) for x in found.record.counted for y in entries(x).reshape(-1)]
        used = _used(tape, [*after, *counted, *(n for _, nodes in kept.values() for n in nodes)])
        return Loop(
            tape=tape,
            states=list(zip(self.now, after, strict=True)),
            leaves=self.leaves,
            parameters=self.parameters,
            uniforms=self.next["uniform"],
            rows=self.next["row"],
            keys=self.keys,
            rings=self.rings,
            counted=counted,
            kept=kept,
            units=dict(found.record.units),
            sizes=(
                len(trace.q),
                len(trace.v),
                parts.plant.nu,
                len(trace.reference.q),
                len(trace.reference.v),
            ),
            tracks=self.next["track"],
            scheduled=self.next["sample"] - columns,
            unused=[
                name
                for name, leaf in self.parameters.items()
                if not any((leaf.kind, leaf.first + i) in used for i in range(int(np.prod(leaf.shape))))
            ],
        )

    def _symbolic(self) -> Parts:
        values = {}
        for parameter, value in self.trace.values.items():
            kind = "row" if parameter in self.trace.spread else "uniform"
            leaf = Leaf("parameter", ".".join(parameter), value.shape, self.next[kind], kind)
            self.parameters[parameter] = leaf
            values[parameter] = self._new(kind, value.shape)
        return self.trace.parts.with_parameters(values)

    def _remembered(self, owner: str, tree: object) -> Any:
        """Return the memory with symbols in it."""
        paths = iter([path for path, _ in leaves(tree)])

        def remember(value: ArrayLike) -> Any:
            path, array = next(paths), np.asarray(value)
            kind = "state"
            if (owner, path) in self.trace.fixed:
                drawn = any(parameter.path.partition(".")[0] == owner for parameter in self.trace.spread)
                kind = "row" if drawn else "uniform"
            self.leaves.append(Leaf(owner, path, array.shape, self.next[kind], kind))
            found = self._new(kind, array.shape)
            return found != 0.0 if array.dtype == bool else found

        return mapped(tree, remember)

    def _after(self, memory: Memory, found: Stepped) -> list[int]:
        """Return the nodes of the state at the next sample."""
        after = [self._node(x) for part in (found.q, found.v) for x in entries(part).reshape(-1)]
        places = iter(self.leaves)
        for before, tree in zip(memory, found.memory, strict=True):
            for path, old, new in matched(before, tree):
                leaf = next(places)
                if np.shape(new) not in ((), leaf.shape):
                    raise NotTraceable(
                        f"{path} had shape {leaf.shape} and has shape {np.shape(new)} a sample later",
                        "let initial_state return arrays of the shapes that they keep",
                    )
                nodes = [self._node(x) for x in np.broadcast_to(entries(new), leaf.shape).reshape(-1)]
                if leaf.kind == "state":
                    after += nodes
                elif nodes != [self._node(x) for x in entries(old).reshape(-1)]:
                    raise NotTraceable(
                        f"{path} stays as it is in one run of the law and changes in another",
                        "keep memory in state",
                    )
        return after

    def _node(self, x: Node | Known) -> int:
        if type(x) is Node and x.tape is not self.tape:
            raise NotTraceable("a symbol of an earlier trace was kept", "keep memory in state")
        node = x if type(x) is Node else self.tape.const(x)
        return self.tape.apply("select", node, 1.0, 0.0).index if node.kind == "b" else node.index

    def _line(self, samples: int) -> _SymbolicLine:
        return _SymbolicLine(self, int(samples))

    def _schedule(self, rows: Array) -> _SymbolicSchedule:
        return _SymbolicSchedule(self._new("sample", rows.shape[1:]))

    def _noise(self, name: str, n: int) -> _SymbolicNoise:
        self.asked.append(name)
        again = self.asked.count(name) - 1
        self.keys.append(f"{name} {again}" if again else name)
        return _SymbolicNoise(self.tape, self.tape.input("key", len(self.keys) - 1), n)


class _SymbolicLine:
    """A delay whose numbers are on the tape."""

    goes_on = True

    def __init__(self, owner: _Pass, samples: int, pushed: bool = False) -> None:
        self.owner, self.samples, self.pushed = owner, samples, pushed

    def push(self, values: object) -> tuple[Any, _SymbolicLine]:
        if self.pushed:
            raise NotTraceable("a delay is pushed twice in a sample", "push all values at once, as a tuple")
        owner = self.owner

        def delayed(x: Values) -> Symbols:
            found = []
            for y in entries(x).reshape(-1):
                pushed = Node(owner.tape, owner._node(y))
                node = owner.tape.ring(len(owner.rings), self.samples, pushed)
                if self.samples:
                    owner.rings.append(Ring(node.index, pushed.index, self.samples))
                found.append(node if self.samples else pushed)
            return symbols(found, np.shape(x))

        return mapped(values, delayed), _SymbolicLine(owner, self.samples, pushed=True)


class _SymbolicSchedule:
    """Known numbers of each sample that are on the tape."""

    goes_on = True

    def __init__(self, row: Symbols, taken: bool = False) -> None:
        self.row, self.taken = row, taken

    def next(self) -> tuple[Symbols, _SymbolicSchedule]:
        if self.taken:
            raise NotTraceable("a schedule is asked twice in a sample", "ask once, and keep the row")
        return self.row, _SymbolicSchedule(self.row, taken=True)


class _SymbolicNoise:
    """Noise whose numbers are on the tape."""

    goes_on = True

    def __init__(self, tape: Tape, key: Node, n: int, drawn: bool = False) -> None:
        self.tape, self.key, self.n, self.drawn = tape, key, n, drawn

    def draw(self) -> tuple[Symbols, _SymbolicNoise]:
        if self.drawn:
            raise NotTraceable("noise is drawn twice in a sample", "ask the context for more numbers at once")
        numbers = normals(self.key, self.tape.input(*COUNT), self.n)
        return symbols(numbers, (self.n,)), _SymbolicNoise(self.tape, self.key, self.n, drawn=True)


def _wider(owner: str, path: str, old: tuple[int, ...], new: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape that numbers of two shapes broadcast to, as a number and the row that it becomes."""
    try:
        return np.broadcast_shapes(old, new)
    except ValueError:
        raise NotTraceable(
            f"{path} of the {owner} has shape {old} and a sample later {new}",
            "let initial_state return arrays of the shapes that they keep, and take delays from "
            "context.line(samples)",
        ) from None


def _flat_numbers(values: Iterable[Any]) -> list[float]:
    return [float(x) for value in values for x in np.asarray(value, np.float64).reshape(-1)]


def _stays(loop: Loop, leaf: Leaf) -> bool:
    pairs = loop.states[leaf.first : leaf.first + int(np.prod(leaf.shape))]
    return all(now == after for now, after in pairs)


def _name(loop: Loop, i: int) -> str:
    """Return what the numbers of the state, and after these what is kept, are called."""
    end = len(loop.states)
    for name, (_, nodes) in loop.kept.items():
        end += len(nodes)
        if len(loop.states) <= i < end:
            return name
    nq, nv = loop.sizes[:2]
    if i < nq + nv:
        return f"q[{i}]" if i < nq else f"v[{i - nq}]"
    for leaf in loop.leaves:
        if leaf.kind == "state" and leaf.first <= i < leaf.first + int(np.prod(leaf.shape)):
            return f"{leaf.path} of the {leaf.owner}"
    raise InvalidArgument(f"there is no state {i}")


def _used(tape: Tape, wanted: Iterable[int]) -> set[Any]:
    return {tape.operations[i] for i in needed(tape, wanted)}
