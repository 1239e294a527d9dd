"""Tracing of a closed loop: `step` runs with symbols, and the tape is compared with numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import attrs
import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.compiled import (
    COUNT,
    DelayLine,
    Identity,
    Leaf,
    LoopTape,
    Node,
    Noise,
    Ring,
    Schedule,
    Symbols,
    Tape,
    ancestors,
    entries,
    evaluate,
    has_symbols,
    is_traced,
    law_place,
    leaves,
    map_leaves,
    match_leaves,
    normals,
    sample_index,
    symbols,
    tracing,
)
from pinmobile.errors import NotTraceable
from pinmobile.loop._loop import OWNERS, Loop, Record, State, initial_state, step
from pinmobile.parts import numbers, replace
from pinmobile.plant import Context
from pinmobile.trajectories import Reference

_FINAL = "return arrays of their final shapes from initial_state"


class _NumericSample(NamedTuple):
    """Sample on numbers: arguments and results of the laws.

    Attributes
    ----------
    k : int
        Index of the sample.
    memory, next_state : State
        State at the sample and at the next one.
    record : Record
        Result of the recorder.
    """

    k: int
    memory: State
    next_state: State
    record: Record


@attrs.define
class Trace:
    """Tracing of a closed loop to its tape.

    The laws run once with numbers, which reports their own errors unchanged, and then with symbols. Laws of
    users run with symbols at least twice. Both tapes must be equal and must reproduce the numbers.

    Parameters
    ----------
    loop : Loop
        Closed loop.
    context : Context
        Argument of the controller's `initial_state`.
    start : (ndarray, ndarray), shape (nq,), (nv,)
        Initial configuration and velocity.
    reference : Reference
        Reference of the first sample.
    identity : Identity
        Identity of the loop.
    spread : mapping of str to array of bool
        Paths of the numbers that differ from robot to robot, with masks of the entries that differ. All other
        numbers are the same for all robots.
    own_reference : bool
        Whether each robot has its own reference.
    own_schedules : bool
        Whether schedules may depend on numbers of the spread.
    """

    loop: Loop
    context: Context
    start: tuple[Array, Array]
    reference: Reference
    identity: Identity
    spread: Mapping[str, Any]
    own_reference: bool = False
    own_schedules: bool = False
    values: dict[str, Array] = attrs.field(init=False)
    fixed: frozenset[tuple[str, str]] = frozenset()
    shapes: dict[tuple[str, str], tuple[int, ...]] = attrs.Factory(dict)

    def __attrs_post_init__(self) -> None:
        self.start = np.asarray(self.start[0], np.float64), np.asarray(self.start[1], np.float64)
        self.reference = Reference(*(np.asarray(x, np.float64) for x in self.reference))
        self.values = traced_numbers(self.loop)

    @property
    def h(self) -> float:
        """Length of a substep [s]."""
        return self.context.dt / self.loop.substeps

    def result(self) -> LoopTape:
        """Return the tape, after the comparison with a second tape and with numbers.

        Raises
        ------
        NotTraceable
            If a law does not accept symbols; the message contains its line and the code to write instead.
        """
        if not self.own_schedules:
            check_schedules(self.loop, self.context, self.spread)
        number = self._numeric_samples()
        tape = self._tape()
        changes = [node != next_node for node, next_node in tape.states]
        fixed = [x for x in tape.leaves if x.kind == "state" and not any(changes[x.first : x.end])]
        if fixed:
            self.fixed = frozenset((leaf.owner, leaf.path) for leaf in fixed)
            tape = self._tape()
        if not self.identity.is_ours:
            self._compare_tapes(tape, self._tape())
        self._compare_numbers(tape, number)
        return tape

    def _numeric_samples(self) -> list[_NumericSample]:
        """Return two samples on numbers, after the shapes of the memory are known."""
        for _ in range(4):
            sample = self._sample_at(0, *self.start)
            has_grown = False
            for owner in OWNERS:
                old_tree, new_tree = getattr(sample.memory, owner), getattr(sample.next_state, owner)
                for path, old, new in match_leaves(old_tree, new_tree, "state"):
                    if np.shape(old) != np.shape(new):
                        self.shapes[owner, path] = _common_shape(owner, path, np.shape(old), np.shape(new))
                        has_grown = True
            if not has_grown:
                return [sample, self._general_sample()]
        raise NotTraceable("the memory changes its shape at each sample", "keep arrays of one shape in state")

    def _sample_at(self, k: int, q: Array, v: Array) -> _NumericSample:
        """Return a sample on numbers; the laws receive copies, because they may change their arguments."""
        state = self._memory(k)._replace(q=q, v=v)
        copies = State(q.copy(), v.copy(), *(map_leaves(getattr(state, owner), np.copy) for owner in OWNERS))
        reference = Reference(*(x.copy() for x in self.reference))
        next_state, _, record = step(self.loop, float(k), 0.0, self.h, copies, reference)
        return _NumericSample(k, state, next_state, record)

    def _memory(self, k: int) -> State:
        """Return the memory before the first sample, with the noise of sample k."""
        makers = DelayLine, lambda name, n: Noise(0, n, k), lambda rows: Schedule(rows, k)
        return self.expand(initial_memory(self.loop, self.context, *makers))

    def _general_sample(self) -> _NumericSample:
        """Return a sample at the next time and at a general state, so that no law sees a special case."""
        q, v = self.start
        displacement = 0.07 * np.cos(2.0 + np.arange(len(v)))
        v = v + 0.05 * np.sin(1.0 + np.arange(len(v)))
        return self._sample_at(1, np.asarray(self.loop.integrate(q, displacement), np.float64), v)

    def expand(self, memory: State) -> State:
        """Return the memory with arrays of the final shapes."""
        trees = {}
        for owner in OWNERS:
            tree = getattr(memory, owner)
            paths = iter([path for path, _ in leaves(tree)])

            def grow(leaf: ArrayLike, owner: str = owner, paths: Iterator[str] = paths) -> ArrayLike:
                shape = self.shapes.get((owner, next(paths)))
                return leaf if shape is None else np.broadcast_to(leaf, shape).copy()

            trees[owner] = map_leaves(tree, grow)
        return memory._replace(**trees)

    def _tape(self, place: Callable[[], str] | None = None) -> LoopTape:
        return _SymbolicRun(self, Tape(locate=place)).loop_tape()

    def _compare_tapes(self, first: LoopTape, second: LoopTape) -> None:
        if first.tape.operations == second.tape.operations and first.outputs == second.outputs:
            return
        placed = self._tape(law_place)
        ends = [len(placed.tape) - 1]
        for other in (first, second):  # a law with alternating results differs from one of the tapes
            pairs = zip(other.tape.operations, placed.tape.operations, strict=False)
            ends += [i for i, (a, b) in enumerate(pairs) if a != b][:1]
        reason = "it counts, draws random numbers or keeps memory outside its state"
        message = f"the law computes something else when it runs again: {reason}"
        remedy = "keep memory in state, and take noise from context.noise(name, n)"
        raise NotTraceable(message, remedy, placed.tape.places[min(ends)])

    def _compare_numbers(self, loop: LoopTape, numbers: Sequence[_NumericSample]) -> None:
        for sample in numbers:
            inputs, state = self._inputs(loop, sample), sample.next_state
            memory = zip(loop.leaves, arrays_of(state), strict=True)
            states = [value for leaf, value in memory if leaf.kind == "state"]
            rows = [_flat_numbers([x]) for x in (state.q, state.v, *states, *sample.record.kept.values())]
            expected = [x for row in rows for x in row]
            sizes = [max(map(abs, row)) for row in rows for _ in row]  # relative to the largest entry
            results = [state for _, state in loop.states]
            results += [node for _, nodes in loop.kept.values() for node in nodes]
            with np.errstate(all="ignore"):
                got = np.array(evaluate(loop.tape, results, inputs), float)
                tolerance = 1e-9 + 1e-7 * np.nan_to_num(sizes)
                is_close = np.isclose(got, expected, rtol=1e-7, atol=tolerance, equal_nan=True)
            if not is_close.all():
                i = int(np.argmin(is_close))
                values = f"{got[i]:g} after a sample, and with numbers {expected[i]:g}"
                instead = "write a law that treats every kind of array alike, without isinstance or try"
                raise NotTraceable(f"with symbols, {_entry_name(loop, i)} is {values}", instead)

    def _inputs(self, loop: LoopTape, sample: _NumericSample) -> dict[Any, Any]:
        """Return the inputs of the tape at a sample."""
        inputs: dict[Any, Any] = {COUNT: np.uint64(sample.k), ("uniform", 0): self.h}
        samples = _flat_numbers([0.0, *self.reference])
        inputs |= {("track", i): x for i, x in enumerate(samples[1:])}
        rows = scheduled_rows(self.loop, self.context)
        samples += _flat_numbers([schedule[min(sample.k, len(schedule) - 1)] for schedule in rows])
        inputs |= {("sample", i): x for i, x in enumerate(samples)}
        inputs |= {("key", i): np.uint64(0) for i in range(len(loop.keys))}
        inputs |= {("state", i): x for i, x in enumerate(_flat_numbers(sample.memory[:2]))}
        for parameter, leaf in loop.parameters.items():
            values = self.values[parameter].ravel()
            inputs |= {(leaf.kind, leaf.first + i): x for i, x in enumerate(values)}
        for leaf, value in zip(loop.leaves, arrays_of(sample.memory), strict=True):
            inputs |= {(leaf.kind, leaf.first + i): x for i, x in enumerate(_flat_numbers([value]))}
        return inputs


class _SymbolicRun:
    """One run of the laws with symbols."""

    def __init__(self, trace: Trace, tape: Tape) -> None:
        self.trace, self.tape = trace, tape
        self.next = {"uniform": 0, "row": 0, "state": 0, "sample": 0, "track": 0}
        self.keys: list[str] = []
        self.noise_names: list[str] = []
        self.rings: list[Ring] = []
        self.leaves: list[Leaf] = []
        self.parameters: dict[str, Leaf] = {}
        self.state_nodes: list[int] = []

    def _new(self, kind: str, shape: tuple[int, ...]) -> Symbols:
        first, count = self.next[kind], int(np.prod(shape))
        self.next[kind] += count
        nodes = [self.tape.input(kind, first + i) for i in range(count)]
        if kind == "state":
            self.state_nodes += [node.index for node in nodes]
        return symbols(nodes, shape)

    def loop_tape(self) -> LoopTape:
        trace, tape = self.trace, self.tape
        h = self._new("uniform", ())
        values = self._symbol_values()
        q, v = (self._new("state", x.shape) for x in trace.start)
        t = self._new("sample", ())
        kind = "track" if trace.own_reference else "sample"
        reference = Reference(*(self._new(kind, x.shape) for x in trace.reference))  # type: ignore[arg-type]
        self.next["sample"] = columns = 1 + sum(x.size for x in trace.reference)
        k = symbols([sample_index(tape)], ())
        makers = self._delay, self._noise, self._schedule
        numbers = trace.expand(initial_memory(trace.loop, trace.context, *makers))
        state = State(q, v, *(self._symbolic_memory(owner, getattr(numbers, owner)) for owner in OWNERS))
        with tracing(trace.identity.namespaces.values(), trace.identity.cells):
            loop = replace(trace.loop, values, nominal=True)
            next_state, _, record = step(loop, k, t, h, state, reference)
            ends = self._next_nodes(state, next_state)
        kept = {name: (np.shape(x), self._nodes([x])) for name, x in record.kept.items()}
        counted = self._nodes(record.counted)
        results = *ends, *counted, *(n for _, nodes in kept.values() for n in nodes)
        live = {tape.operations[i] for i in ancestors(tape, results)}

        def is_used(leaf: Leaf) -> bool:
            return any((leaf.kind, i) in live for i in range(leaf.first, leaf.end))

        lists: Any = {name: getattr(self, name) for name in ("tape", "leaves", "parameters", "keys", "rings")}
        return LoopTape(
            **lists,
            states=list(zip(self.state_nodes, ends, strict=True)),
            uniforms=self.next["uniform"],
            rows=self.next["row"],
            counted=counted,
            kept=kept,
            units=dict(record.units),
            sizes=(*map(len, trace.start), loop.plant.nu, *map(len, trace.reference[:2])),
            tracks=self.next["track"],
            schedule_size=self.next["sample"] - columns,
            unused=[name for name, leaf in self.parameters.items() if not is_used(leaf)],
        )

    def _symbol_values(self) -> dict[str, Symbols]:
        """Return symbols of the numbers, by path; numbers that are neutral for all robots are constants."""
        values = {}
        for path, leaf in numbers(self.trace.loop).items():
            if not is_traced(path):
                continue
            value, neutral = self.trace.values[path], leaf.declared.neutral  # type: ignore[attr-defined]
            varies = self.trace.spread.get(path)
            kind = "uniform" if varies is None else "row"
            self.parameters[path] = Leaf("parameter", path, value.shape, self.next[kind], kind)
            nodes = entries(self._new(kind, value.shape)).reshape(-1)
            mask = (value == neutral) if varies is None else (value == neutral) & ~varies
            mixed = [neutral if flag else node for flag, node in zip(mask.reshape(-1), nodes, strict=True)]
            values[path] = symbols(mixed, value.shape)
        return values

    def _symbolic_memory(self, owner: str, tree: object) -> Any:
        """Return the memory with symbols as its entries."""
        paths = iter([path for path, _ in leaves(tree)])

        def replace_leaf(value: ArrayLike) -> Any:
            path, array = next(paths), np.asarray(value)
            kind = "state"
            if (owner, path) in self.trace.fixed:
                has_spread = any(path.partition(".")[0] == owner for path in self.trace.spread)
                kind = "row" if has_spread else "uniform"
            self.leaves.append(Leaf(owner, path, array.shape, self.next[kind], kind))
            symbol = self._new(kind, array.shape)
            return symbol != 0.0 if array.dtype == bool else symbol

        return map_leaves(tree, replace_leaf)

    def _nodes(self, values: Iterable[Any]) -> list[int]:
        """Return the nodes of all entries of some values."""
        return [self.tape.number(x) for value in values for x in entries(value).reshape(-1)]

    def _next_nodes(self, state: State, next_state: State) -> list[int]:
        """Return the nodes of the state at the next sample."""
        next_nodes = self._nodes([next_state.q, next_state.v])
        run_leaves = iter(self.leaves)
        for owner in OWNERS:
            for path, old, new in match_leaves(getattr(state, owner), getattr(next_state, owner)):
                leaf = next(run_leaves)
                if np.shape(new) not in ((), leaf.shape):
                    message = f"{path} has shape {leaf.shape}, and shape {np.shape(new)} a sample later"
                    raise NotTraceable(message, _FINAL)
                nodes = self._nodes([np.broadcast_to(entries(new), leaf.shape)])
                if leaf.kind == "state":
                    next_nodes += nodes
                elif nodes != self._nodes([old]):
                    message = f"{path} stays constant in one run of the law and changes in another"
                    raise NotTraceable(message, "keep memory in state")
        return next_nodes

    def _delay(self, samples: int) -> _Source:
        def delay(x: Any) -> Symbols:
            nodes = []
            for y in entries(x).reshape(-1):
                source = Node(self.tape, self.tape.number(y))
                node = self.tape.ring(len(self.rings), samples, source)
                if samples:
                    self.rings.append(Ring(node.index, source.index, samples))
                nodes.append(node if samples else source)
            return symbols(nodes, np.shape(x))

        error_words = "a delay is pushed twice in a sample", "push all values at once, as a tuple"
        return _Source(lambda values: map_leaves(values, delay), error_words)

    def _schedule(self, rows: Array) -> _Source:
        row = self._new("sample", rows.shape[1:])
        return _Source(lambda: row, ("a schedule is read twice in a sample", "read once, and keep the row"))

    def _noise(self, name: str, n: int) -> _Source:
        count = self.noise_names.count(name)
        self.noise_names.append(name)
        self.keys.append(f"{name} {count}" if count else name)
        key = self.tape.input("key", len(self.keys) - 1)
        return _Source(
            lambda: symbols(normals(key, self.tape.input(*COUNT), n), (n,)),
            ("noise is drawn twice in a sample", "draw more numbers at once: context.noise(name, n)"),
        )


class _Source:
    """Delay, schedule or noise on the tape, which may be used once per sample.

    Parameters
    ----------
    answer : callable
        Function that returns the numbers of a sample.
    words : (str, str)
        Error of a second use in a sample, and the code to write instead.
    """

    goes_on = True

    def __init__(self, answer: Callable[..., Any], words: tuple[str, str], is_used: bool = False) -> None:
        self.answer, self.words, self.is_used = answer, words, is_used

    def push(self, *values: object) -> tuple[Any, _Source]:
        """Return the numbers of this sample, and the object for the next one."""
        if self.is_used:
            raise NotTraceable(*self.words)
        return self.answer(*values), _Source(self.answer, self.words, is_used=True)

    next = draw = push


def _common_shape(owner: str, path: str, old: tuple[int, ...], new: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape to which two shapes of the memory broadcast, such as () and (3,)."""
    try:
        return np.broadcast_shapes(old, new)
    except ValueError:
        message = f"{path} of the {owner} has shape {old} and a sample later {new}"
        raise NotTraceable(message, f"{_FINAL}, and take delays from context.delay(samples)") from None


def _flat_numbers(values: Iterable[Any]) -> list[float]:
    return [float(x) for value in values for x in np.asarray(value, np.float64).reshape(-1)]


def _entry_name(loop: LoopTape, i: int) -> str:
    """Return the name of entry i of the state, or after the state of the kept values."""
    end = len(loop.states)
    for name, (_, nodes) in loop.kept.items():
        end += len(nodes)
        if len(loop.states) <= i < end:
            return name
    nq, nv = loop.sizes[:2]
    if i < nq + nv:
        return f"q[{i}]" if i < nq else f"v[{i - nq}]"
    for leaf in loop.leaves:
        if leaf.kind == "state" and leaf.first <= i < leaf.end:
            return f"{leaf.path} of the {leaf.owner}"
    raise IndexError(i)


# Memory before the first sample


class _MemoryContext:
    """Context with given makers of delays, noise and schedules, such as those of a tape."""

    def __init__(self, given: Context, delay: Any, noise: Any, schedule: Any) -> None:
        self._given, self.delay, self._schedule = given, delay, schedule
        self.noise = noise or (lambda name, n: Noise(0, n))

    def schedule(self, rows: ArrayLike) -> Any:
        """Return the memory of rows that are known for each sample."""
        return self._schedule(self._given.schedule(rows).rows)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._given, name)


def initial_memory(
    loop: Loop,
    context: Context,
    delay: Callable[..., Any] = DelayLine,
    noise: Callable[..., Any] | None = None,
    schedule: Callable[..., Any] = Schedule,
) -> State:
    """Return the memory before the first sample, by default with noise of the key 0.

    Parameters
    ----------
    loop : Loop
        Closed loop.
    context : Context
        Argument of the controller's `initial_state`.
    delay, noise, schedule : callable
        Makers of a delay, a noise and a schedule, in place of those of the context.
    """
    return initial_state(loop, _MemoryContext(context, delay, noise, schedule))  # type: ignore[arg-type]


def scheduled_rows(loop: Loop, context: Context) -> list[Array]:
    """Return the rows of all schedules of the parts, each of shape (N + 1, ...)."""
    schedules: list[Array] = []

    def schedule(rows: Array) -> Schedule:
        schedules.append(rows)
        return Schedule(rows)

    initial_memory(loop, context, schedule=schedule)
    return schedules


def check_schedules(loop: Loop, context: Context, spread: Iterable[str]) -> None:
    """Reject a spread of numbers that determine schedules, which are the same for all robots.

    Raises
    ------
    NotTraceable
        If the spread contains such a number.
    """
    paths = [path for path in spread if path.startswith("controller.")]
    rows = scheduled_rows(loop, context) if paths else []
    values = traced_numbers(loop) if rows else {}
    for path in paths if rows else ():
        changed = replace(loop, {path: values[path] * 1.001 + 1e-6})
        changed_rows = scheduled_rows(changed, context)
        if not all(map(np.array_equal, rows, changed_rows)):
            message = f"the context of the controller depends on {path}, which differs from robot to robot"
            raise NotTraceable(message, "spread parameters of the plant, or run with engine=Engine.PYTHON")


def traced_numbers(loop: Loop) -> dict[str, Array]:
    """Return the numbers of a loop that are symbols of its law, by path."""
    traced = {path: leaf.value for path, leaf in numbers(loop).items() if is_traced(path)}
    return {path: np.asarray(value, np.float64) for path, value in traced.items()}


def initial_memories(
    loop: Loop, context: Context, spread: Mapping[str, Array], n: int, identity: Identity
) -> list[Array]:
    """Return the memory of n robots before the first sample, arrays of shape (...) or (n, ...).

    If `initial_state` does not accept symbols, it runs for each robot.
    """
    try:
        with tracing(identity.namespaces.values(), identity.cells):
            return _evaluate_symbols(lambda x: arrays_of(initial_memory(x, context)), loop, spread, n)
    except NotTraceable:
        rows = []
        for i in range(n):
            varied = replace(loop, {path: x[i] for path, x in _rows(spread, n).items()})
            rows.append([np.asarray(x, np.float64) for x in arrays_of(initial_memory(varied, context))])
        return [np.array(column) for column in zip(*rows, strict=True)]


def initial_states(loop: Loop, spread: Mapping[str, Array], first: Reference) -> tuple[Array, Array]:
    """Return the states of n robots at the start of their references, shape (n, nq) and (n, nv).

    Parameters
    ----------
    loop : Loop
        Nominal loop; its plant has ``start``.
    spread : mapping of str to ndarray, shape (n, ...)
        Numbers of the robots, by path.
    first : Reference
        First samples of the references, shape (n, ...).
    """
    q, v = _evaluate_robots(lambda plant, *row: plant.start(Reference(*row)), loop, spread, *first)
    return q, v


def initial_velocities(loop: Loop, spread: Mapping[str, Array], q: Array, v: Array) -> Array:
    """Return the initial velocities of n robots after projection on their constraints, shape (n, nv).

    Parameters
    ----------
    loop : Loop
        Nominal loop.
    spread : mapping of str to ndarray, shape (n, ...)
        Numbers of the robots, by path.
    q, v : ndarray, shape (n, nq), (n, nv)
        Initial configurations and velocities.
    """
    return _evaluate_robots(lambda plant, *row: [plant.project(*row)], loop, spread, q, v)[0]


def _evaluate_robots(
    compute: Callable[..., Sequence[Any]], loop: Loop, spread: Mapping[str, Array], *rows: Array
) -> list[Array]:
    """Return what a function of the plant answers for n robots, arrays of shape (n, k).

    The function runs once, with symbols. If it does not accept symbols, or its answer differs from that of
    the plant itself, it runs for each robot.
    """
    n = len(rows[0])

    def alone(i: int) -> list[Array]:
        varied = replace(loop, {path: x[i] for path, x in _rows(spread, n).items()})
        return [np.asarray(x, np.float64) for x in compute(varied.plant, *(row[i].copy() for row in rows))]

    ends = [np.array(x) for x in zip(alone(0), alone(n - 1), strict=True)]
    try:
        with tracing():
            answers = _evaluate_symbols(lambda x, *row: compute(x.dynamics, *row), loop, spread, n, *rows)
    except NotTraceable:
        answers = []
    answers = [np.broadcast_to(x, (n, *x.shape[-1:])) for x in answers]
    is_same = len(answers) == len(ends) and all(
        x.shape[1:] == end.shape[1:] and np.allclose(x[[0, -1]], end, rtol=1e-9, atol=1e-9)
        for x, end in zip(answers, ends, strict=True)
    )
    return answers if is_same else [np.array(x) for x in zip(*map(alone, range(n)), strict=True)]


def _rows(spread: Mapping[str, Array], n: int) -> dict[str, Array]:
    return {path: np.broadcast_to(x, (n, *x.shape[1:])) for path, x in spread.items()}


def _evaluate_symbols(
    compute: Callable[..., Sequence[Any]], loop: Loop, spread: Mapping[str, Array], n: int, *rows: Array
) -> list[Array]:
    """Return arrays of n robots, shape (...) or (n, ...), from a function that runs once, with symbols."""
    tape, inputs = Tape(), dict[Any, Any]()

    def add_input(value: Array) -> Any:
        columns, first = value.reshape(n, -1).T, len(inputs)
        inputs.update({("row", first + i): column for i, column in enumerate(columns)})
        return symbols([tape.input("row", first + i) for i in range(len(columns))], value.shape[1:])

    tape_values = {path: add_input(value) for path, value in _rows(spread, n).items()}
    answers = compute(replace(loop, tape_values, nominal=True), *map(add_input, rows))
    arrays = []
    for value in answers:
        if not has_symbols(value):
            arrays.append(np.asarray(value, np.float64))
            continue
        nodes = map(tape.number, entries(value).reshape(-1))
        columns = np.array([np.broadcast_to(x, n) for x in evaluate(tape, nodes, inputs)], np.float64)
        arrays.append(columns.T.reshape(n, *np.shape(value)))
    return arrays


def arrays_of(memory: State) -> list[Any]:
    """Return the numbers and arrays of a memory, in order."""
    return [value for owner in OWNERS for _, value in leaves(getattr(memory, owner))]
