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
from pinmobile.compiled.folding import ROUND, STATE
from pinmobile.compiled.tape import (
    COUNT,
    LoopTape,
    Node,
    Ring,
    Rounds,
    Tape,
    float_bits,
    needed,
    operands,
    real,
    with_operands,
)
from pinmobile.errors import NotTraceable

LARGEST = 1_000_000
"""Largest number of nodes of a loop with derivatives."""

_LARGEST_ROUNDS = 100_000  # operations of the tangents in rounds
_INNER = 1000  # operations for which rounds within rounds count

_Multiply: TypeAlias = Callable[[Any], Any]
_Input: TypeAlias = tuple[Any, ...]
_FLAT = ("rounded", "floor", "count")


def _guarded(tape: Tape, d: Any, value: Any) -> Any:
    """Return a product with d, which is 0 where d is 0, also if the slope is infinite there."""
    return tape.apply("select", d == 0.0, 0.0, value)


def slopes(tape: Tape, node: int) -> list[tuple[int, _Multiply]]:
    """Return the operands of a node on which it depends, and functions that multiply by its slopes."""
    at, y, mark = tape.at, tape.at(node), tape.marks.get(node)
    if mark is not None:
        return _of_function(tape, y, *mark)
    name, *of = tape.operations[node]
    if name in ("add", "sub"):
        return [(of[0], lambda d: d), (of[1], (lambda d: d) if name == "add" else (lambda d: -d))]
    if name == "neg":
        return [(of[0], lambda d: -d)]
    if name == "mul":
        return [(of[0], lambda d: d * at(of[1])), (of[1], lambda d: d * at(of[0]))]
    if name == "div":
        below = at(of[1])
        return [
            (of[0], lambda d: _guarded(tape, d, d / below)),
            (of[1], lambda d: _guarded(tape, d, -(d * y) / below)),
        ]
    if name == "sqrt":
        return [(of[0], lambda d: tape.apply("select", (d == 0.0) | (y == 0.0), 0.0, d * 0.5 / y))]
    if name == "abs":
        return [(of[0], lambda d: tape.apply("select", at(of[0]) < 0.0, -d, d))]
    if name in ("max", "min", "select"):
        condition = at(of[0])
        if name != "select":
            condition = at(of[0]) > at(of[1]) if name == "max" else at(of[0]) < at(of[1])
        first, second = of[-2:]
        return [
            (first, lambda d: tape.apply("select", condition, d, 0.0)),
            (second, lambda d: tape.apply("select", condition, 0.0, d)),
        ]
    if name == "real":  # powers of two and whole numbers
        return []
    raise NotTraceable(f"the operation {name!r} has no derivative", "use NumPy's functions of numbers")


def _of_function(tape: Tape, y: Node, name: str, of: tuple[int, ...]) -> list[tuple[int, _Multiply]]:
    """Return the slopes of an elementary function."""
    if name in _FLAT:
        return []
    x = tape.at(of[0])
    if name == "arctan2":
        other = tape.at(of[1])
        square = x * x + other * other
        return [
            (of[0], lambda d: _guarded(tape, d, d * other / square)),
            (of[1], lambda d: _guarded(tape, d, -(d * x) / square)),
        ]
    if name in ("sin", "cos"):
        sine, cosine = sincos(x)
        return [(of[0], lambda d: d * (cosine if name == "sin" else -sine))]
    slope: dict[str, Callable[[], Any]] = {
        "exp": lambda: y,
        "expm1": lambda: y + 1.0,
        "log": lambda: 1.0 / x,
        "log1p": lambda: 1.0 / (1.0 + x),
        "tanh": lambda: 1.0 - y * y,
        "arctan": lambda: 1.0 / (1.0 + x * x),
    }
    return [(of[0], lambda d: _guarded(tape, d, d * slope[name]()))]


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
        given = inputs or {}
        for i in needed(self.old, self._wanted(loop)):
            operation = self.old.operations[i]
            self.new[i] = given[operation](self.tape).index if operation in given else self._copied(i)
        for i, (name, of) in self.old.marks.items():
            if i in self.new and all(x in self.new for x in of):
                self.tape.marks.setdefault(self.new[i], (name, tuple(self.new[x] for x in of)))

    def _wanted(self, loop: LoopTape) -> set[int]:
        """Return the outputs of the loop, and the operands of functions, which may be constants."""
        wanted = set(loop.outputs)
        for i in needed(self.old, wanted):
            wanted.update(self.old.marks.get(i, ("", ()))[1])
        return wanted

    def _copied(self, i: int) -> int:
        operation, depends = self.old.operations[i], self.old.depends[i]
        moved = with_operands(operation, self.new)
        if operands(operation) and operation[0] not in ("repeat", "result", "ring"):
            depends = self.tape.dependence(moved[1:])
        return self.tape.copied(self.old.types[i], depends, moved)

    def loop(self, loop: LoopTape) -> LoopTape:
        """Return the loop on the new tape."""
        new = self.new
        return replace(
            loop,
            tape=self.tape,
            states=[(new[now], new[after]) for now, after in loop.states],
            kept={name: (shape, [new[x] for x in nodes]) for name, (shape, nodes) in loop.kept.items()},
            rings=[Ring(new[one.node], new[one.pushed], one.samples) for one in loop.rings],
            counted=[],
        )


def _add_tangents(tape: Tape, tangents: dict[int, Node], end: int, first: int) -> list[Ring]:
    """Append the tangents of the first nodes of the tape, and return their delays, numbered from `first`."""
    results, rings = dict[int, list[Node]](), list[Ring]()
    for i in range(end):
        name, *of = tape.operations[i]
        if i in tangents or tape.types[i] != "f" or tape.depends[i] >= ROUND:
            continue
        if name == "ring":
            if (pushed := tangents.get(of[2])) is not None:
                tangents[i] = tape.ring(first + len(rings), of[1], pushed)
                rings.append(Ring(tangents[i].index, pushed.index, of[1]))
        elif name == "repeat":
            results[i] = _after_rounds(tape, i, lambda x: x, [tangents])[1][0]
        elif name == "result":
            tangents[i] = results[of[0]][of[1]]
        else:
            _find(tape, tangents, i)
    return rings


def _find(tape: Tape, tangents: dict[int, Node], i: int) -> None:
    """Add the tangent of a node to those of its operands."""
    given = tape.marks[i][1] if i in tape.marks else operands(tape.operations[i])
    if i in tangents or tape.types[i] != "f" or not any(x in tangents for x in given):
        return
    total: Any = None
    for x, multiply in slopes(tape, i):
        if x in tangents:
            part = multiply(tangents[x])
            total = part if total is None else total + part
    if type(total) is Node and total.value != 0:
        tangents[i] = total


def _after_rounds(
    tape: Tape, i: int, new: Callable[[int], int], known: Sequence[Mapping[int, Node]]
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
    known : sequence of mapping of int to Node
        Tangents of the new nodes along each direction.
    """
    rounds, zero = Rounds.of(tape, i), tape.const(0.0)
    count = len(rounds.first)

    def law(carried: list[Any]) -> tuple[list[Any], Any]:
        inner: dict[int, int] = {}
        nested: dict[int, tuple[list[Node], list[list[Node]]]] = {}
        own = [dict(each) for each in known]

        def now(x: int) -> int:
            return inner[x] if x in inner else new(x)

        for j in rounds.body:
            name, *of = tape.operations[j]
            if name == "repeat":
                nested[j] = _after_rounds(tape, j, now, own)
                continue
            if name in ("carry", "result"):
                values, slopes_of = nested[of[0]] if name == "result" else (carried[:count], [])
                inner[j] = values[of[1]].index
                for d, tangents in enumerate(own):
                    first = (1 + d) * count
                    tangents[inner[j]] = (slopes_of[d] if slopes_of else carried[first:])[of[1]]
                continue
            inner[j] = tape.apply(name, *(tape.at(now(x)) for x in of)).index
            if j in tape.marks:
                function, given = tape.marks[j]
                tape.marks.setdefault(inner[j], (function, tuple(map(now, given))))
            for tangents in own:
                _find(tape, tangents, inner[j])
        after = [*map(now, rounds.following)]
        moved = [tangents.get(x, zero) for tangents in own for x in after]
        return [*map(tape.at, after), *moved], tape.at(now(rounds.done))

    before = [*map(new, rounds.first)]
    first = [*map(tape.at, before), *(tangents.get(x, zero) for tangents in known for x in before)]
    found = tape.repeated(law, first, rounds.most, tape.at(new(rounds.settled)))
    parts = [found[k : k + count] for k in range(0, len(found), count)]
    return parts[0], parts[1:]


def sides(loop: LoopTape) -> list[int]:
    """Return the nodes of the conditions that choose the side of a kink, outside rounds and functions."""
    tape, found, seen = loop.tape, dict[int, None](), set[int]()
    todo = [after for _, after in loop.states] + [ring.pushed for ring in loop.rings]
    while todo:
        i = todo.pop()
        if i in seen:
            continue
        seen.add(i)
        name, *of = tape.operations[i]
        if i in tape.marks:
            todo += tape.marks[i][1]
            continue
        condition = None
        if name in ("abs", "max", "min"):
            condition = tape.at(of[0]) < (0.0 if name == "abs" else tape.at(of[1]))
        elif name == "select":
            condition = tape.at(of.pop(0))
        if condition is not None and tape.depends[condition.index] & STATE:
            found[condition.index] = None
        if name not in ("real", "repeat", "result"):
            todo += (x for x in (of if operands(tape.operations[i]) else ()) if tape.types[x] == "f")
    return [*found]


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
    known = {
        copy.new[now]: tape.input("state", n + i) for i, (now, _) in enumerate(loop.states) if now in copy.new
    }
    places = {operation: i for i, operation in enumerate(tape.operations[:end])}
    columns = [one for one in directions if one[0] in ("sample", "track")]
    rows = [one for one in directions if one not in columns]
    for kind, first, some in (("row", loop.rows, rows), ("track", loop.tracks, columns)):
        for j, one in enumerate(some):
            if one in places:
                known[places[one]] = tape.input(kind, first + j)
    rings, zero = _add_tangents(tape, known, end, len(loop.rings)), tape.const(0.0)

    def of(node: int) -> int:
        return known.get(copy.new[node], zero).index

    whole = copy.loop(loop)
    moved = [(tape.input("state", n + i).index, of(after)) for i, (_, after) in enumerate(loop.states)]
    kept = {f"tangent {name}": (shape, [*map(of, nodes)]) for name, (shape, nodes) in loop.kept.items()}
    return replace(
        whole,
        states=[*whole.states, *moved],
        kept={**whole.kept, **kept},
        rings=[*whole.rings, *rings],
        rows=loop.rows + len(rows),
        tracks=loop.tracks + len(columns),
        leaves=[],
        parameters={},
    )


def without_delays(loop: LoopTape) -> LoopTape:
    """Return the loop with delays as further states, the oldest number of each delay first."""
    if not loop.rings:
        return loop
    first, moved = len(loop.states), dict[int, int]()
    for one in loop.rings:
        moved[one.node] = first
        first += one.samples
    states: list[tuple[int, int]] = []

    class WithStates(Copy):
        def _copied(self, i: int) -> int:
            operation, tape = self.old.operations[i], self.tape
            if i not in moved:
                return super()._copied(i)
            pushed, begins = tape.at(self.new[operation[3]]), sample_index(tape) == 0.0
            places = range(moved[i], moved[i] + operation[2])
            now = [tape.input("state", place) for place in places]
            values = [tape.apply("select", begins, pushed, x) for x in now]
            after = [one.index for one in (*values[1:], pushed)]
            states.extend(zip([one.index for one in now], after, strict=True))
            return values[0].index

    copy = WithStates(loop)
    whole = copy.loop(replace(loop, rings=[]))
    states.sort(key=lambda pair: int(copy.tape.operations[pair[0]][1]))
    return replace(whole, states=[*whole.states, *states])


def sample_index(tape: Tape) -> Any:
    """Return the index of the sample as a number."""
    return tape.mark("count", real(tape.input(*COUNT) | float_bits(2.0**52)) - 2.0**52)


def adjoint(loop: LoopTape, wanted: Sequence[_Input], columns: int, sampled: Sequence[_Input]) -> LoopTape:
    """Return the loop that runs from the last sample to the first one.

    Its references (tracks) are the states of the samples, followed by those of the loop, and its sample has a
    further column with the bits of the index. Its states are the adjoints of the loop's states, and behind
    them the derivatives by the wanted inputs. The derivatives by numbers of each sample are kept as
    ``"sample"``.

    Parameters
    ----------
    loop : LoopTape
        Loop with n states, without delays.
    wanted, sampled : sequence of operation
        Inputs, such as ``("row", 3)``, and those of each sample, such as ``("sample", 2)``.
    columns : int
        Number of columns of a sample of the loop.

    Raises
    ------
    NotTraceable
        If rounds have too many operations.
    """
    n = len(loop.states)

    def moved(kind: str, i: int) -> Callable[[Tape], Node]:
        return lambda tape: tape.input(kind, i)

    inputs: Any = {("state", i): moved("track", i) for i in range(n)}
    inputs |= {("track", i): moved("track", n + i) for i in range(loop.tracks)}
    inputs[COUNT] = lambda tape: tape.apply("bits", tape.input("sample", columns))
    copy = Copy(replace(loop, kept={}, counted=[]), inputs)
    tape, end = copy.tape, len(copy.tape)
    places = {operation: i for i, operation in enumerate(tape.operations[:end])}

    def place(one: _Input) -> int:
        """Return the node of an input of the loop, or -1."""
        shift = n if one[0] == "track" else 0
        return places.get((one[0], one[1] + shift), -1)

    tracked = [places.get(("track", i), -1) for i in range(n)]
    ends = {*tracked, *map(place, (*wanted, *sampled))} - {-1}
    sums: dict[int, Any] = {}
    for i, (_, after) in enumerate(loop.states):
        _add(sums, copy.new[after], tape.input("state", i))
    active = _active(tape, end, ends)
    found: dict[int, Any] = {}
    results: dict[int, dict[int, Any]] = {}
    for i in range(end - 1, -1, -1):
        operation = tape.operations[i]
        total = sums.pop(i, None) if i in active else None
        if i in results:
            for x, part in _before_rounds(tape, i, results[i], active):
                _add(sums, x, part)
        elif total is not None and operation[0] == "result":
            results.setdefault(operation[1], {})[operation[2]] = total
        elif total is not None:
            found[i] = total
            for x, multiply in slopes(tape, i) if i not in ends else ():
                if x in active:
                    _add(sums, x, multiply(total))
    states = []
    for i, at in enumerate(tracked):
        states.append((tape.input("state", i).index, tape.number(found.get(at, 0.0))))
    for j, at in enumerate(map(place, wanted)):
        now = tape.input("state", n + j)
        states.append((now.index, now.index if at not in found else tape.number(now + found[at])))
    return replace(
        loop,
        tape=tape,
        states=states,
        tracks=n + loop.tracks,
        kept={"sample": ((len(sampled),), [tape.number(found.get(place(one), 0.0)) for one in sampled])},
        counted=[],
        rings=[],
        leaves=[],
        parameters={},
        scheduled=loop.scheduled + 1,
    )


def _before_rounds(tape: Tape, i: int, totals: Mapping[int, Any], active: set[int]) -> list[tuple[int, Any]]:
    """Return the numbers on which rounds depend, and the derivatives by them, from a tangent for each."""
    rounds = Rounds.of(tape, i)
    inputs = [x for x in sorted({*rounds.first, *rounds.outside}) if x in active]
    inner = sum(tape.operations[j][0] == "repeat" for j in rounds.body)
    if len(inputs) * (len(rounds.body) + inner * _INNER) > _LARGEST_ROUNDS:
        raise NotTraceable("the contacts of dry friction run forward only", 'use mode="forward"')
    _, tangents = _after_rounds(tape, i, lambda x: x, [{x: tape.const(1.0)} for x in inputs])
    return [
        (x, sum(total * each[k] for k, total in totals.items()))
        for x, each in zip(inputs, tangents, strict=True)
    ]


def _add(sums: dict[int, Any], node: int, value: Any) -> None:
    sums[node] = sums[node] + value if node in sums else value


def _active(tape: Tape, end: int, first: Iterable[int]) -> set[int]:
    """Return the nodes that depend on some inputs with a slope."""
    active = set(first)
    for i in range(end):
        if i in active or tape.types[i] != "f":
            continue
        mark = tape.marks.get(i)
        given: Iterable[int] = mark[1] if mark else operands(tape.operations[i])
        if tape.operations[i][0] == "repeat":
            given = Rounds.of(tape, i).outside
        elif mark and mark[0] in _FLAT:
            continue
        if (tape.operations[i][0] != "real" or mark) and any(x in active for x in given):
            active.add(i)
    return active


def bits_of_indices(count: int) -> Any:
    """Return the column of an adjoint's samples: the bits of their indices, the last sample first."""
    return np.arange(count - 1, -1, -1, dtype=np.uint64).view(np.float64)
