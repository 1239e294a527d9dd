"""Derivatives of a loop on a tape: tangents (forward mode) and adjoints (reverse mode), as further loops.

The tangent of a loop has a direction for each robot. The adjoint of a loop runs backwards; its references
are the states of the samples, which the loop has recorded. Slopes are those of the marked elementary
functions. Rounding and comparisons have slope 0. At a kink, the slope is that of one side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from pinmobile.compiled.elementary import sincos
from pinmobile.compiled.folding import ROBOT, ROUND, STATE
from pinmobile.compiled.tape import (
    COUNT,
    LoopTape,
    Node,
    Ring,
    Rounds,
    Tape,
    ancestors,
    float_bits,
    operands,
    real,
    with_operands,
)
from pinmobile.errors import NotTraceable

LARGEST = 1_000_000
"""Largest number of nodes of a loop with derivatives."""

_MAX_ROUNDS = 100_000  # operations of the tangents in rounds
_INNER = 1000  # operations for which rounds within rounds count

_Multiply: TypeAlias = Callable[[Any], Any]
_Input: TypeAlias = tuple[Any, ...]
_ZERO_SLOPES = ("rounded", "floor", "count")


def _zero_guard(tape: Tape, d: Any, value: Any) -> Any:
    """Return a product with d, which is 0 where d is 0, also if the slope is infinite there."""
    return tape.apply("select", d == 0.0, 0.0, value)


def slopes(tape: Tape, node: int) -> list[tuple[int, _Multiply]]:
    """Return the operands of a node on which it depends, and functions that multiply by its slopes."""
    at, y, mark = tape.at, tape.at(node), tape.marks.get(node)
    if mark is not None:
        return _function_slopes(tape, y, *mark)
    name, *args = tape.operations[node]
    if name in ("add", "sub"):
        return [(args[0], lambda d: d), (args[1], (lambda d: d) if name == "add" else (lambda d: -d))]
    if name == "neg":
        return [(args[0], lambda d: -d)]
    if name == "mul":
        return [(args[0], lambda d: d * at(args[1])), (args[1], lambda d: d * at(args[0]))]
    if name == "div":
        divisor = at(args[1])
        return [
            (args[0], lambda d: _zero_guard(tape, d, d / divisor)),
            (args[1], lambda d: _zero_guard(tape, d, -(d * y) / divisor)),
        ]
    if name == "sqrt":
        return [(args[0], lambda d: tape.apply("select", (d == 0.0) | (y == 0.0), 0.0, d * 0.5 / y))]
    if name == "abs":
        return [(args[0], lambda d: tape.apply("select", at(args[0]) < 0.0, -d, d))]
    if name in ("max", "min", "select"):
        condition = at(args[0])
        if name != "select":
            condition = at(args[0]) > at(args[1]) if name == "max" else at(args[0]) < at(args[1])
        first, second = args[-2:]
        return [
            (first, lambda d: tape.apply("select", condition, d, 0.0)),
            (second, lambda d: tape.apply("select", condition, 0.0, d)),
        ]
    if name == "real":  # powers of two and whole numbers
        return []
    raise NotTraceable(f"the operation {name!r} has no derivative", "use NumPy's functions of numbers")


def _function_slopes(tape: Tape, y: Node, name: str, args: tuple[int, ...]) -> list[tuple[int, _Multiply]]:
    """Return the slopes of an elementary function."""
    if name in _ZERO_SLOPES:
        return []
    x = tape.at(args[0])
    if name == "arctan2":
        other = tape.at(args[1])
        square = x * x + other * other
        return [
            (args[0], lambda d: _zero_guard(tape, d, d * other / square)),
            (args[1], lambda d: _zero_guard(tape, d, -(d * x) / square)),
        ]
    if name in ("sin", "cos"):
        sine, cosine = sincos(x)
        return [(args[0], lambda d: d * (cosine if name == "sin" else -sine))]
    slope: dict[str, Callable[[], Any]] = {
        "exp": lambda: y,
        "expm1": lambda: y + 1.0,
        "log": lambda: 1.0 / x,
        "log1p": lambda: 1.0 / (1.0 + x),
        "tanh": lambda: 1.0 - y * y,
        "arctan": lambda: 1.0 / (1.0 + x * x),
    }
    return [(args[0], lambda d: _zero_guard(tape, d, d * slope[name]()))]


class Copy:
    """Copy of a loop's tape in which inputs may be other nodes.

    Parameters
    ----------
    loop : LoopTape
        Loop on a tape.
    inputs : mapping of operation to function, optional
        Functions of the new tape that return the node of an input.

    Attributes
    ----------
    tape : Tape
        New tape.
    new : dict of int to int
        New index of each node.
    """

    def __init__(self, loop: LoopTape, inputs: Mapping[_Input, Callable[[Tape], Node]] | None = None) -> None:
        self.old, self.tape, self.new = loop.tape, Tape(LARGEST), dict[int, int]()
        swaps = inputs or {}
        for i in ancestors(self.old, self._needed_nodes(loop)):
            operation = self.old.operations[i]
            self.new[i] = swaps[operation](self.tape).index if operation in swaps else self._copy_node(i)
        for i, (name, args) in self.old.marks.items():
            if i in self.new and all(x in self.new for x in args):
                self.tape.marks.setdefault(self.new[i], (name, tuple(self.new[x] for x in args)))

    def _needed_nodes(self, loop: LoopTape) -> set[int]:
        """Return the outputs of the loop, and the operands of functions, which may be constants."""
        nodes = set(loop.outputs)
        for i in ancestors(self.old, nodes):
            nodes.update(self.old.marks.get(i, ("", ()))[1])
        return nodes

    def _copy_node(self, i: int) -> int:
        operation, depends = self.old.operations[i], self.old.depends[i]
        new_operation = with_operands(operation, self.new)
        if operands(operation) and operation[0] not in ("repeat", "result", "ring"):
            depends = self.tape.dependence(new_operation[1:])
        return self.tape.copy_node(self.old.types[i], depends, new_operation)

    def loop(self, loop: LoopTape) -> LoopTape:
        """Return the loop on the new tape."""
        new = self.new
        return replace(
            loop,
            tape=self.tape,
            states=[(new[node], new[next_node]) for node, next_node in loop.states],
            kept={name: (shape, [new[x] for x in nodes]) for name, (shape, nodes) in loop.kept.items()},
            rings=[Ring(new[ring.node], new[ring.source], ring.samples) for ring in loop.rings],
            counted=[],
        )


def _add_tangents(tape: Tape, tangents: dict[int, Node], end: int, first: int) -> list[Ring]:
    """Append the tangents of the first nodes of the tape, and return their delays, numbered from `first`."""
    results, rings = dict[int, list[Node]](), list[Ring]()
    for i in range(end):
        name, *args = tape.operations[i]
        if i in tangents or tape.types[i] != "f" or tape.depends[i] >= ROUND:
            continue
        if name == "ring":
            if (source := tangents.get(args[2])) is not None:
                tangents[i] = tape.ring(first + len(rings), args[1], source)
                rings.append(Ring(tangents[i].index, source.index, args[1]))
        elif name == "repeat":
            results[i] = _append_rounds(tape, i, lambda x: x, [tangents])[1][0]
        elif name == "result":
            tangents[i] = results[args[0]][args[1]]
        else:
            _add_tangent(tape, tangents, i)
    return rings


def _add_tangent(tape: Tape, tangents: dict[int, Node], i: int) -> None:
    """Add the tangent of a node to those of its operands."""
    args = tape.marks[i][1] if i in tape.marks else operands(tape.operations[i])
    if i in tangents or tape.types[i] != "f" or not any(x in tangents for x in args):
        return
    total: Any = None
    for x, multiply in slopes(tape, i):
        if x in tangents:
            part = multiply(tangents[x])
            total = part if total is None else total + part
    if type(total) is Node and total.value != 0:
        tangents[i] = total


def _append_rounds(
    tape: Tape, i: int, new: Callable[[int], int], directions: Sequence[Mapping[int, Node]]
) -> tuple[list[Node], list[list[Node]]]:
    """Append rounds with tangents, and return the results and their tangents along each direction.

    The tangents pass through the iterations of a solver, with which they converge.

    Parameters
    ----------
    tape : Tape
        Tape with the rounds.
    i : int
        Node of the rounds.
    new : callable
        New node of a node outside the rounds.
    directions : sequence of mapping of int to Node
        Tangents of the new nodes along each direction.
    """
    rounds, zero = Rounds.of(tape, i), tape.const(0.0)
    count = len(rounds.first)

    def law(carried: list[Any]) -> tuple[list[Any], Any]:
        inner: dict[int, int] = {}
        inner_rounds: dict[int, tuple[list[Node], list[list[Node]]]] = {}
        tangent_maps = [dict(direction) for direction in directions]

        def node_of(x: int) -> int:
            return inner[x] if x in inner else new(x)

        for j in rounds.body:
            name, *args = tape.operations[j]
            if name == "repeat":
                inner_rounds[j] = _append_rounds(tape, j, node_of, tangent_maps)
                continue
            if name in ("carry", "result"):
                values, slopes_of = inner_rounds[args[0]] if name == "result" else (carried[:count], [])
                inner[j] = values[args[1]].index
                for d, tangents in enumerate(tangent_maps):
                    first = (1 + d) * count
                    tangents[inner[j]] = (slopes_of[d] if slopes_of else carried[first:])[args[1]]
                continue
            inner[j] = tape.apply(name, *(tape.at(node_of(x)) for x in args)).index
            if j in tape.marks:
                function, nodes = tape.marks[j]
                tape.marks.setdefault(inner[j], (function, tuple(map(node_of, nodes))))
            for tangents in tangent_maps:
                _add_tangent(tape, tangents, inner[j])
        ends = [*map(node_of, rounds.results)]
        end_tangents = [tangents.get(x, zero) for tangents in tangent_maps for x in ends]
        return [*map(tape.at, ends), *end_tangents], tape.at(node_of(rounds.done))

    starts = [*map(new, rounds.first)]
    first = [*map(tape.at, starts), *(tangents.get(x, zero) for tangents in directions for x in starts)]
    results = tape.repeat(law, first, rounds.most, tape.at(new(rounds.skip)))
    parts = [results[k : k + count] for k in range(0, len(results), count)]
    return parts[0], parts[1:]


def sides(loop: LoopTape) -> list[int]:
    """Return the nodes of the conditions that choose the side of a kink, outside rounds and functions.

    Conditions of clocks and noises, which no number and no motion changes, are not among them.
    """
    tape, conditions, visited = loop.tape, dict[int, None](), set[int]()
    changes = _changeable_nodes(loop)
    todo = [next_node for _, next_node in loop.states] + [ring.source for ring in loop.rings]
    while todo:
        i = todo.pop()
        if i in visited:
            continue
        visited.add(i)
        name, *args = tape.operations[i]
        if i in tape.marks:
            todo += tape.marks[i][1]
            continue
        condition = None
        if name in ("abs", "max", "min") and any(changes[x] for x in args):
            condition = tape.at(args[0]) < (0.0 if name == "abs" else tape.at(args[1]))
        elif name == "select":
            place = args.pop(0)
            condition = tape.at(place) if changes[place] else None
        if condition is not None and tape.depends[condition.index] & (STATE | ROBOT):
            conditions[condition.index] = None
        if name not in ("real", "repeat", "result"):
            todo += (x for x in (args if operands(tape.operations[i]) else ()) if tape.types[x] == "f")
    return [*conditions]


def _changeable_nodes(loop: LoopTape) -> bytearray:
    """Return which nodes numbers and the motion of the plant may change, as a mask of the tape."""
    tape, memory = loop.tape, loop.states[sum(loop.sizes[:2]) :]
    constant = {node for node, _ in memory}
    while True:
        mask = bytearray(len(tape))
        for i, operation in enumerate(tape.operations):
            inner = operands(operation) if operation[0] != "ring" else ()
            if inner:
                mask[i] = any(mask[x] for x in inner)
            else:
                mask[i] = operation[0] not in ("key", "count", "const") and i not in constant
        remaining = {node for node, next_node in memory if node in constant and not mask[next_node]}
        if remaining == constant:
            return mask
        constant = remaining


def tangent(loop: LoopTape, directions: Sequence[_Input]) -> LoopTape:
    """Return a loop whose states are followed by their tangents.

    Parameters
    ----------
    loop : LoopTape
        Loop with n states.
    directions : sequence of operation
        Inputs, such as ``("uniform", 3)``. The entries of a robot's direction are further rows, in this
        order; those of inputs ``("sample", i)`` and ``("track", i)`` are further tracks.

    Returns
    -------
    LoopTape
        Loop with 2 n states. Kept values are followed by their tangents, ``"tangent <name>"``.
    """
    copy = Copy(loop)
    tape, n, end = copy.tape, len(loop.states), len(copy.tape)
    tangents = {
        copy.new[x]: tape.input("state", n + i) for i, (x, _) in enumerate(loop.states) if x in copy.new
    }
    indices = {operation: i for i, operation in enumerate(tape.operations[:end])}
    columns = [column for column in directions if column[0] in ("sample", "track")]
    rows = [column for column in directions if column not in columns]
    for kind, first, group in (("row", loop.rows, rows), ("track", loop.tracks, columns)):
        for j, column in enumerate(group):
            if column in indices:
                tangents[indices[column]] = tape.input(kind, first + j)
    rings, zero = _add_tangents(tape, tangents, end, len(loop.rings)), tape.const(0.0)

    def d(node: int) -> int:
        return tangents.get(copy.new[node], zero).index

    copied_loop = copy.loop(loop)
    new_states = [
        (tape.input("state", n + i).index, d(end_node)) for i, (_, end_node) in enumerate(loop.states)
    ]
    kept = {f"tangent {name}": (shape, [*map(d, nodes)]) for name, (shape, nodes) in loop.kept.items()}
    return replace(
        copied_loop,
        states=[*copied_loop.states, *new_states],
        kept={**copied_loop.kept, **kept},
        rings=[*copied_loop.rings, *rings],
        rows=loop.rows + len(rows),
        tracks=loop.tracks + len(columns),
        leaves=[],
        parameters={},
    )


def linearization(loop: LoopTape, directions: Sequence[_Input]) -> LoopTape:
    """Return a loop that keeps the tangents after each sample alone, ``"tangent state"``, from given states.

    Its first references (tracks) are the n states of the samples. Its states are the tangents before each of
    them, and do not change. Kept values have tangents as in `tangent`, which has the directions.

    Parameters
    ----------
    loop : LoopTape
        Loop with n states, without delays.
    directions : sequence of operation
        Inputs, such as ``("row", 3)``.
    """
    n = len(loop.states)
    ends = {"state": ((n,), [next_node for _, next_node in loop.states])}
    pair = tangent(replace(loop, counted=[], kept={**loop.kept, **ends}), directions)
    inputs = _inputs("state", n, "track", 0) | _inputs("state", n, "state", 0, first=n)
    copy = Copy(pair, inputs | _inputs("track", loop.tracks, "track", n))
    seeds = [copy.tape.input("state", i).index for i in range(n)]
    kept = {name: x for name, x in copy.loop(pair).kept.items() if name.startswith("tangent ")}
    states = [(seed, seed) for seed in seeds]
    return replace(pair, tape=copy.tape, states=states, kept=kept, tracks=n + pair.tracks)


def _inputs(
    kind: str, count: int, new: str, shift: int, first: int = 0
) -> dict[_Input, Callable[[Tape], Node]]:
    """Return functions that make inputs of another kind in place of some, as `Copy` takes them."""

    def make(i: int) -> Callable[[Tape], Node]:
        return lambda tape: tape.input(new, shift + i)

    return {(kind, first + i): make(i) for i in range(count)}


def expand_delays(loop: LoopTape) -> LoopTape:
    """Return the loop with delays as further states, the oldest number of each delay first."""
    if not loop.rings:
        return loop
    first, first_states = len(loop.states), dict[int, int]()
    for ring in loop.rings:
        first_states[ring.node] = first
        first += ring.samples
    states: list[tuple[int, int]] = []

    class WithStates(Copy):
        def _copy_node(self, i: int) -> int:
            operation, tape = self.old.operations[i], self.tape
            if i not in first_states:
                return super()._copy_node(i)
            source, begins = tape.at(self.new[operation[3]]), sample_index(tape) == 0.0
            indices = range(first_states[i], first_states[i] + operation[2])
            inputs = [tape.input("state", place) for place in indices]
            values = [tape.apply("select", begins, source, x) for x in inputs]
            ends = [node.index for node in (*values[1:], source)]
            states.extend(zip([node.index for node in inputs], ends, strict=True))
            return values[0].index

    copy = WithStates(loop)
    copied_loop = copy.loop(replace(loop, rings=[]))
    states.sort(key=lambda pair: int(copy.tape.operations[pair[0]][1]))
    return replace(copied_loop, states=[*copied_loop.states, *states])


def sample_index(tape: Tape) -> Any:
    """Return the index of the sample as a number."""
    return tape.mark("count", real(tape.input(*COUNT) | float_bits(2.0**52)) - 2.0**52)


def adjoint(loop: LoopTape, params: Sequence[_Input], columns: int, samples: Sequence[_Input]) -> LoopTape:
    """Return the loop that runs from the last sample to the first one.

    Its references (tracks) are the states of the samples, followed by those of the loop, and its sample has a
    further column with the bits of the index. Its states are the adjoints of the loop's states, and behind
    them the derivatives by the wanted inputs. The derivatives by numbers of each sample are kept as
    ``"sample"``.

    Parameters
    ----------
    loop : LoopTape
        Loop with n states, without delays.
    params, samples : sequence of operation
        Inputs, such as ``("row", 3)``, and those of each sample, such as ``("sample", 2)``.
    columns : int
        Number of columns of a sample of the loop.

    Raises
    ------
    NotTraceable
        If rounds have too many operations.
    """
    n = len(loop.states)
    inputs: Any = _inputs("state", n, "track", 0) | _inputs("track", loop.tracks, "track", n)
    inputs[COUNT] = lambda tape: tape.apply("bits", tape.input("sample", columns))
    copy = Copy(replace(loop, kept={}, counted=[]), inputs)
    tape, end = copy.tape, len(copy.tape)
    indices = {operation: i for i, operation in enumerate(tape.operations[:end])}

    def place(operation: _Input) -> int:
        """Return the node of an input of the loop, or -1."""
        shift = n if operation[0] == "track" else 0
        return indices.get((operation[0], operation[1] + shift), -1)

    state_nodes = [indices.get(("track", i), -1) for i in range(n)]
    ends = {*state_nodes, *map(place, (*params, *samples))} - {-1}
    sums: dict[int, Any] = {}
    for i, (_, next_node) in enumerate(loop.states):
        _add(sums, copy.new[next_node], tape.input("state", i))
    active = _active_nodes(tape, end, ends)
    totals: dict[int, Any] = {}
    results: dict[int, dict[int, Any]] = {}
    for i in range(end - 1, -1, -1):
        operation = tape.operations[i]
        total = sums.pop(i, None) if i in active else None
        if i in results:
            for x, part in _round_slopes(tape, i, results[i], active):
                _add(sums, x, part)
        elif total is not None and operation[0] == "result":
            results.setdefault(operation[1], {})[operation[2]] = total
        elif total is not None:
            totals[i] = total
            for x, multiply in slopes(tape, i) if i not in ends else ():
                if x in active:
                    _add(sums, x, multiply(total))
    states = []
    for i, node in enumerate(state_nodes):
        states.append((tape.input("state", i).index, tape.number(totals.get(node, 0.0))))
    for j, node in enumerate(map(place, params)):
        x_sum = tape.input("state", n + j)
        states.append((x_sum.index, x_sum.index if node not in totals else tape.number(x_sum + totals[node])))
    return replace(
        loop,
        tape=tape,
        states=states,
        tracks=n + loop.tracks,
        kept={"sample": ((len(samples),), [tape.number(totals.get(place(one), 0.0)) for one in samples])},
        counted=[],
        rings=[],
        leaves=[],
        parameters={},
        schedule_size=loop.schedule_size + 1,
    )


def _round_slopes(tape: Tape, i: int, totals: Mapping[int, Any], active: set[int]) -> list[tuple[int, Any]]:
    """Return the numbers on which rounds depend, and the derivatives by them, from a tangent for each."""
    rounds = Rounds.of(tape, i)
    inputs = [x for x in sorted({*rounds.first, *rounds.outer}) if x in active]
    inner = sum(tape.operations[j][0] == "repeat" for j in rounds.body)
    if len(inputs) * (len(rounds.body) + inner * _INNER) > _MAX_ROUNDS:
        raise NotTraceable("the contacts of dry friction run forward only", 'use mode="forward"')
    _, tangents = _append_rounds(tape, i, lambda x: x, [{x: tape.const(1.0)} for x in inputs])
    return [
        (x, sum(total * tangent[k] for k, total in totals.items()))
        for x, tangent in zip(inputs, tangents, strict=True)
    ]


def _add(sums: dict[int, Any], node: int, value: Any) -> None:
    sums[node] = sums[node] + value if node in sums else value


def _active_nodes(tape: Tape, end: int, first: Iterable[int]) -> set[int]:
    """Return the nodes that depend on some inputs with a slope."""
    active = set(first)
    for i in range(end):
        if i in active or tape.types[i] != "f":
            continue
        mark = tape.marks.get(i)
        args: Iterable[int] = mark[1] if mark else operands(tape.operations[i])
        if tape.operations[i][0] == "repeat":
            args = Rounds.of(tape, i).outer
        elif mark and mark[0] in _ZERO_SLOPES:
            continue
        if (tape.operations[i][0] != "real" or mark) and any(x in active for x in args):
            active.add(i)
    return active


def index_bits(count: int) -> Any:
    """Return the column of an adjoint's samples: the bits of their indices, the last sample first."""
    return np.arange(count - 1, -1, -1, dtype=np.uint64).view(np.float64)
