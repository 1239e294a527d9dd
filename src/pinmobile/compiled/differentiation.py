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

from pinmobile.compiled.folding import ROUND
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
)
from pinmobile.errors import NotTraceable

LARGEST = 1_000_000
"""Largest number of nodes of a loop with derivatives."""

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
        twin = next(i for i, mark in tape.marks.items() if mark == ("cos" if name == "sin" else "sin", of))
        other = tape.at(twin)
        return [(of[0], lambda d: d * (other if name == "sin" else -other))]
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

    def _wanted(self, loop: LoopTape) -> list[int]:
        """Return the outputs of the loop, and the nodes that slopes of functions need."""
        wanted, twins = set(loop.outputs), {"sin": "cos", "cos": "sin"}
        while True:
            known = set(needed(self.old, wanted))
            more = set[int]()
            for i, (name, of) in self.old.marks.items():
                if i in known:
                    more.update(of)
                    pair = (twins.get(name), of)
                    more.update(j for j, mark in self.old.marks.items() if mark == pair)
            if more <= known:
                return sorted(wanted)
            wanted |= more

    def _copied(self, i: int) -> int:
        operation, depends = self.old.operations[i], self.old.depends[i]
        name = operation[0]
        if name == "repeat":
            operation = (*operation[:4], *(self.new[x] for x in operation[4:]))
        elif name == "result":
            operation = (name, self.new[operation[1]], operation[2])
        elif name == "ring":
            operation = (*operation[:3], self.new[operation[3]])
        elif operands(operation):
            operation = (name, *(self.new[x] for x in operation[1:]))
            depends = 0
            for x in operation[1:]:
                depends |= self.tape.depends[x]
        return self.tape.copied(self.old.types[i], depends, operation)

    def loop(self, loop: LoopTape, **changes: Any) -> LoopTape:
        """Return the loop on the new tape."""
        new = self.new
        whole: dict[str, Any] = {
            "tape": self.tape,
            "states": [(new[now], new[after]) for now, after in loop.states],
            "kept": {name: (shape, [new[x] for x in nodes]) for name, (shape, nodes) in loop.kept.items()},
            "rings": [Ring(new[one.node], new[one.pushed], one.samples) for one in loop.rings],
            "counted": [],
        }
        return replace(loop, **(whole | changes))


class _Tangents:
    """Tangents of the nodes of a tape, in order."""

    def __init__(self, tape: Tape, known: Mapping[int, Node]) -> None:
        self.tape, self.of, self.rings = tape, dict(known), list[Ring]()

    def run(self, end: int, rings: int) -> None:
        """Append the tangents of the first nodes of the tape."""
        tape, results = self.tape, dict[int, list[Node]]()
        for i in range(end):
            operation = tape.operations[i]
            if (
                i in self.of
                or tape.types[i] != "f"
                or (tape.depends[i] >= ROUND and operation[0] != "repeat")
            ):
                continue
            if operation[0] == "ring":
                pushed = self.of.get(operation[3])
                if pushed is not None:
                    node = tape.ring(rings + len(self.rings), operation[2], pushed)
                    self.rings.append(Ring(node.index, pushed.index, operation[2]))
                    self.of[i] = node
            elif operation[0] == "repeat":
                results[i] = self._rounds(i)
            elif operation[0] == "result":
                if operation[1] in results:
                    self.of[i] = results[operation[1]][operation[2]]
            else:
                self._one(i)

    def _one(self, i: int) -> None:
        total: Any = None
        given = self.tape.marks[i][1] if i in self.tape.marks else operands(self.tape.operations[i])
        if not any(x in self.of for x in given):
            return
        for x, multiply in slopes(self.tape, i):
            if x in self.of:
                part = multiply(self.of[x])
                total = part if total is None else total + part
        if type(total) is Node and total.value != 0:
            self.of[i] = total

    def _rounds(self, i: int) -> list[Node]:
        """Append rounds with their tangents, and return the tangents of the results."""
        tape, rounds = self.tape, Rounds.of(self.tape, i)
        zero, count = tape.const(0.0), len(rounds.first)

        def law(carried: list[Any]) -> tuple[list[Any], Any]:
            inner: dict[int, int] = {}
            own = _Tangents(tape, self.of)

            def new(x: int) -> int:
                return inner.get(x, x)

            for j in rounds.body:
                name, *of = tape.operations[j]
                if name == "repeat":
                    raise NotTraceable(
                        "contacts of dry friction are solved by rounds within rounds, which have no "
                        "derivative",
                        "use ground=Rolling()",
                    )
                if name == "carry":
                    inner[j] = carried[of[1]].index
                    own.of[inner[j]] = carried[count + of[1]]
                    continue
                inner[j] = tape.apply(name, *(tape.at(new(x)) for x in of)).index
                if j in tape.marks:
                    function, given = tape.marks[j]
                    tape.marks.setdefault(inner[j], (function, tuple(map(new, given))))
            for j in rounds.body:
                if inner[j] not in own.of and tape.types[inner[j]] == "f":
                    own._one(inner[j])
            after = [*map(new, rounds.following)]
            tangents = [own.of.get(x, zero) for x in after]
            return [*map(tape.at, after), *tangents], tape.at(new(rounds.done))

        first = [*map(tape.at, rounds.first), *(self.of.get(x, zero) for x in rounds.first)]
        return tape.repeated(law, first, rounds.most, tape.at(rounds.settled))[count:]


def tangent(loop: LoopTape, directions: Sequence[_Input]) -> LoopTape:
    """Return a loop whose states are followed by their tangents.

    Parameters
    ----------
    loop : LoopTape
        Loop with n states.
    directions : sequence of operation
        Inputs, such as ``("uniform", 3)``. The entries of a robot's direction are further rows, in this
        order; those of inputs ``("sample", i)`` are tracks.

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
    columns = [one for one in directions if one[0] == "sample"]
    rows = [one for one in directions if one[0] != "sample"]
    for kind, first, some in (("row", loop.rows, rows), ("track", 0, columns)):
        for j, one in enumerate(some):
            if one in places:
                known[places[one]] = tape.input(kind, first + j)
    tangents = _Tangents(tape, known)
    tangents.run(end, len(loop.rings))
    zero = tape.const(0.0)

    def of(node: int) -> int:
        return tangents.of.get(copy.new[node], zero).index

    whole = copy.loop(loop)
    moved = [(tape.input("state", n + i).index, of(after)) for i, (_, after) in enumerate(loop.states)]
    kept = {f"tangent {name}": (shape, [*map(of, nodes)]) for name, (shape, nodes) in loop.kept.items()}
    return replace(
        whole,
        states=[*whole.states, *moved],
        kept={**whole.kept, **kept},
        rings=[*whole.rings, *tangents.rings],
        rows=loop.rows + len(rows),
        tracks=len(columns),
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
            states.extend(
                (one.index, after.index) for one, after in zip(now, [*values[1:], pushed], strict=True)
            )
            return values[0].index

    copy = WithStates(loop)
    whole = copy.loop(replace(loop, rings=[]))
    states.sort(key=lambda pair: int(copy.tape.operations[pair[0]][1]))
    return replace(whole, states=[*whole.states, *states])


def sample_index(tape: Tape) -> Any:
    """Return the index of the sample as a number."""
    return tape.mark("count", real(tape.input(*COUNT) | float_bits(2.0**52)) - 2.0**52)


def adjoint(loop: LoopTape, wanted: Sequence[_Input], columns: int) -> LoopTape:
    """Return the loop that runs from the last sample to the first one.

    Its references (tracks) are the states of the samples, and its sample has a further column with the bits
    of the index. Its states are the adjoints of the loop's states, and behind them the derivatives by the
    wanted inputs. The derivatives by each number of each sample are kept as ``"sample"``.

    Parameters
    ----------
    loop : LoopTape
        Loop with n states, without delays and rounds.
    wanted : sequence of operation
        Inputs, such as ``("row", 3)``.
    columns : int
        Number of columns of a sample of the loop.

    Raises
    ------
    NotTraceable
        If the loop has rounds or references of each robot.
    """
    if loop.tracks or any(operation[0] == "repeat" for operation in loop.tape.operations):
        raise NotTraceable("loops with rounds run forward only", "use forward mode")
    n = len(loop.states)

    def tracked_input(i: int) -> Callable[[Tape], Node]:
        return lambda tape: tape.input("track", i)

    inputs: dict[_Input, Callable[[Tape], Node]] = {("state", i): tracked_input(i) for i in range(n)}
    inputs[COUNT] = lambda tape: tape.apply("bits", tape.input("sample", columns))
    copy = Copy(replace(loop, kept={}, counted=[]), inputs)
    tape, end = copy.tape, len(copy.tape)
    places = {operation: i for i, operation in enumerate(tape.operations[:end])}
    tracked = {places["track", i]: i for i in range(n) if ("track", i) in places}
    asked = {places[one]: j for j, one in enumerate(wanted) if one in places}
    samples = {places["sample", i]: i for i in range(columns) if ("sample", i) in places}
    sums: dict[int, Any] = {}
    for i, (_, after) in enumerate(loop.states):
        _add(sums, copy.new[after], tape.input("state", i))
    ends = {*tracked, *asked, *samples}
    active = _active(tape, end, ends)
    found: dict[int, Any] = {}
    for i in range(end - 1, -1, -1):
        total = sums.pop(i, None) if i in active else None
        if total is None:
            continue
        found[i] = total
        if i in ends:
            continue
        for x, multiply in slopes(tape, i):
            if x in active:
                _add(sums, x, multiply(total))
    states = []

    def number(one: _Input) -> int:
        return tape.number(found.get(places.get(one, -1), 0.0))

    for i in range(n):
        states.append((tape.input("state", i).index, number(("track", i))))
    for j, one in enumerate(wanted):
        now = tape.input("state", n + j)
        part = found.get(places.get(one, -1))
        states.append((now.index, now.index if part is None else tape.number(now + part)))
    return replace(
        loop,
        tape=tape,
        states=states,
        tracks=n,
        kept={"sample": ((columns,), [number(("sample", i)) for i in range(columns)])},
        counted=[],
        rings=[],
        leaves=[],
        parameters={},
        scheduled=loop.scheduled + 1,
    )


def _add(sums: dict[int, Any], node: int, value: Any) -> None:
    sums[node] = sums[node] + value if node in sums else value


def _active(tape: Tape, end: int, first: Iterable[int]) -> set[int]:
    """Return the nodes that depend on some inputs with a slope."""
    active = set(first)
    for i in range(end):
        if i in active or tape.types[i] != "f":
            continue
        mark = tape.marks.get(i)
        given = () if mark and mark[0] in _FLAT else mark[1] if mark else operands(tape.operations[i])
        if (tape.operations[i][0] != "real" or mark) and any(x in active for x in given):
            active.add(i)
    return active


def bits_of_indices(count: int) -> Any:
    """Return the column of an adjoint's samples: the bits of their indices, the last sample first."""
    return np.arange(count - 1, -1, -1, dtype=np.uint64).view(np.float64)
