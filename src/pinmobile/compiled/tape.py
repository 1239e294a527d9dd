"""Tape: the computation of a law as a list of operations on symbols.

A processor rounds each operation according to IEEE 754, so that a tape has the same bits everywhere:
`evaluate` runs it with NumPy, `emit` writes machine code. Equal operations appear once, and constants are
folded. A product with a constant zero is zero. A division by a constant, or by a number that is the same at
all samples, is a product with the reciprocal.
"""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.compiled.folding import (
    COMMUTE,
    DTYPES,
    NUMPY,
    ROBOT,
    ROUND,
    RULES,
    SAMPLE,
    STATE,
    UNIFORM,
    WORD_NAMES,
    kind_of,
    operand_kinds,
    result_kind,
)
from pinmobile.errors import NotTraceable

LARGEST = 30_000
"""Largest number of nodes of a tape that differ from robot to robot; each takes about 0.1 ms to build."""

_SHARED = 10  # factor for nodes that depend on time only


_Operation: TypeAlias = tuple[Any, ...]

Known: TypeAlias = "float | np.number[Any] | np.bool"
"""Number or truth value that is known."""

Number: TypeAlias = "Node | float | NDArray[Any]"
"""Operand: a node of a tape, a number, or an array of numbers."""


# Names of inputs, their dependence and their type: f is a float, u 64 bits, b a truth value.
_INPUTS = {
    "uniform": (UNIFORM, "f"),
    "row": (ROBOT, "f"),
    "key": (ROBOT, "u"),
    "sample": (SAMPLE, "f"),
    "track": (SAMPLE | ROBOT, "f"),
    "count": (SAMPLE, "u"),
    "state": (STATE, "f"),
}


COUNT: _Operation = ("count",)


def float_bits(x: float) -> int:
    """Return the 64 bits of a float."""
    return int.from_bytes(struct.pack("<d", x), "little")


def _bits_float(x: int) -> float:
    return float(struct.unpack("<d", x.to_bytes(8, "little"))[0])


# Where operations have their operands, unless behind their name.
_OPERAND_SLICES = dict.fromkeys(("const", "carry", *_INPUTS), slice(0))
_OPERAND_SLICES |= {"repeat": slice(4, None), "result": slice(1, 2), "ring": slice(3, 4)}
_AFTER_NAME = slice(1, None)


def operands(operation: _Operation) -> tuple[int, ...]:
    """Return the nodes that are operands of an operation."""
    return operation[_OPERAND_SLICES.get(operation[0], _AFTER_NAME)]


def with_operands(operation: _Operation, new: Mapping[int, int]) -> _Operation:
    """Return an operation with the new nodes of its operands."""
    operand_slice, items = _OPERAND_SLICES.get(operation[0], _AFTER_NAME), [*operation]
    items[operand_slice] = [new[x] for x in items[operand_slice]]
    return tuple(items)


class Rounds(NamedTuple):
    """Data of an operation ``("repeat", number, level, most, done, skip, *first, *results)``.

    Attributes
    ----------
    most : int
        Largest number of rounds.
    done : int
        Node that is true if a robot needs no further round.
    skip : int
        Node that is true if a robot needs no round.
    first, results : tuple of int
        Nodes of each carried number, before the first round and after each round.
    body : list of int
        Nodes of a round, in order; an inner repetition is one node.
    outer : list of int
        Nodes that a round needs and that are the same in all rounds.
    """

    most: int
    done: int
    skip: int
    first: tuple[int, ...]
    results: tuple[int, ...]
    body: list[int]
    outer: list[int]

    @classmethod
    def of(cls, tape: Tape, index: int) -> Rounds:
        """Return the rounds of a node, which are computed once."""
        if index in tape.rounds:
            return tape.rounds[index]
        _, number, level, most, done, skip, *nodes = tape.operations[index]
        half = len(nodes) // 2
        body, outer, todo = set(), {skip, *nodes[:half]}, [done, *nodes[half:]]
        while todo:
            node = todo.pop()
            operation = tape.operations[node]
            if not tape.depends[node] & level:
                outer.add(node)
            elif node not in body:
                body.add(node)
                todo += cls.of(tape, node).outer if operation[0] == "repeat" else operands(operation)
                if tape.depends[node] >= 2 * level or (operation[0] == "carry" and operation[1] != number):
                    raise NotTraceable("a symbol of other rounds was kept", "return it from each round")
        ends = (*nodes[:half],), (*nodes[half:],)
        rounds = tape.rounds[index] = cls(most, done, skip, *ends, sorted(body), sorted(outer))
        return rounds


class Tape:
    """Operations in order; an operand is the index of an earlier operation.

    Parameters
    ----------
    largest : int
        Largest number of nodes.
    locate : callable, optional
        Function that is called for each new node; `places` contains its results.

    Attributes
    ----------
    operations : list of tuple
        Name and operands: ``("mul", 3, 5)``; of an input its name and number, ``("row", 2)``; of a constant
        its type and bits; of a delay ``("ring", number, samples, node)``.
    types : list of str
        Type of each node: f, u or b.
    depends : list of int
        Dependence of each node: UNIFORM, ROBOT, SAMPLE and STATE as bits.
    rounds : dict of int to Rounds
        Known rounds, by node.
    marks : dict of int to (str, tuple of int)
        Elementary function and operands of the nodes that are values of such functions.
    """

    def __init__(self, largest: int = LARGEST, locate: Callable[[], Any] | None = None) -> None:
        self.operations: list[_Operation] = []
        self.types: list[str] = []
        self.depends: list[int] = []
        self.rounds: dict[int, Rounds] = {}
        self.marks: dict[int, tuple[str, tuple[int, ...]]] = {}
        self.places: list[Any] = []
        self._indices: dict[_Operation, int] = {}
        self._results: dict[tuple[Any, ...], int] = {}  # operations before simplification
        self._values: dict[int, Any] = {}  # values of constants
        self._largest, self._locate, self._count = largest, locate, 0
        self._repeats, self._level = 0, ROUND

    @classmethod
    def of(cls, operations: list[_Operation], types: list[str], depends: list[int]) -> Tape:
        """Return a tape with these nodes, for example from a file."""
        tape = cls()
        tape.operations, tape.types, tape.depends = operations, types, depends
        for index, operation in enumerate(operations):
            if operation[0] == "const":
                tape._keep(index, operation)
        return tape

    def __reduce__(self) -> tuple[Any, ...]:
        return Tape.of, (self.operations, self.types, self.depends)

    def _keep(self, index: int, operation: _Operation) -> None:
        """Keep the value of a constant."""
        self._values[index] = _bits_float(operation[2]) if operation[1] == "f" else operation[2]

    def __len__(self) -> int:
        return len(self.operations)

    def input(self, name: str, *number: int) -> Node:
        """Return an input, such as ``("row", 2)``."""
        depends, kind = _INPUTS[name]
        return self._node(kind, depends, (name, *number))

    def copy_node(self, kind: str, depends: int, operation: _Operation) -> int:
        """Return the index of an operation of another tape, as it stands."""
        self._repeats = max(self._repeats, operation[1] + 1 if operation[0] == "repeat" else 0)
        return self._node(kind, depends, operation).index

    def ring(self, number: int, samples: int, source: Node) -> Node:
        """Return the value of `source` from `samples` ago, or its first value before that."""
        return self._node("f", STATE, ("ring", number, samples, source.index))

    def repeat(
        self,
        law: Callable[[list[Any]], tuple[Sequence[Any], Any]],
        first: Sequence[Any],
        most: int,
        skip: Any = False,
    ) -> list[Node]:
        """Return numbers after rounds of a law, see `repeat`."""
        number, self._repeats = self._repeats, self._repeats + 1
        level, self._level = self._level, 2 * self._level
        starts = [self._convert(x, "f").index for x in first]
        carried = [self._node("f", STATE | level, ("carry", number, i)) for i in range(len(starts))]
        results, done = law(carried)
        round_ends = [self._convert(x, "f").index for x in results]
        ends = [self._convert(x, "b").index for x in (done, skip)]
        self._level = level
        outer = self.dependence((*ends, *starts, *round_ends)) & (level - ROUND)  # on the outer rounds
        depends = STATE | outer
        node = self._node("f", depends, ("repeat", number, level, most, *ends, *starts, *round_ends))
        return [self._node("f", depends, ("result", node.index, i)) for i in range(len(round_ends))]

    def const(self, value: Known, kind: str = "f") -> Node:
        """Return the node of a constant: a number, a truth value or 64 bits."""
        if kind == "f":
            return self._node("f", 0, ("const", "f", float_bits(float(value))))
        return self._node(kind, 0, ("const", kind, bool(value) if kind == "b" else int(value) & (2**64 - 1)))

    def number(self, x: Node | Known) -> int:
        """Return the index of a number or constant; a truth value becomes 1 or 0."""
        node = self._convert(x, "f") if type(x) is Node else self.const(x)
        return node.index

    def mark(self, name: str, node: Any, *given: Any) -> Any:
        """Mark a node as the value of an elementary function of its operands, and return it."""
        if type(node) is Node:
            self.marks.setdefault(node.index, (name, tuple(map(self.number, given))))
        return node

    def at(self, index: int) -> Node:
        """Return the node with this index."""
        return Node(self, index)

    def constant_of(self, index: int) -> Any:
        """Return the value of a constant; None for any other node."""
        return self._values.get(index)

    def apply(self, name: str, *given: Node | Known) -> Node:
        """Return the node of an operation on nodes and plain numbers, folded if possible."""
        key: list[Any] = [name]
        for x in given:
            if type(x) is Node and x.tape is self:
                key.append(x.index)
            elif type(x) is float and x != 0:
                key.append((x,))  # distinct from the index of a node
            else:
                return self._apply_new(name, given)
        index = self._results.get(tuple(key))
        if index is None:
            node = self._apply_new(name, given)
            index = self._results[tuple(key)] = node.index
        return Node(self, index)

    def _apply_new(self, name: str, given: Sequence[Node | Known]) -> Node:
        kinds = [self.types[x.index] if type(x) is Node else kind_of(x) for x in given]
        if "u" in kinds and name in WORD_NAMES:
            name = WORD_NAMES[name]
        operand_types = operand_kinds(name, kinds)
        nodes = [self._convert(x, kind) for x, kind in zip(given, operand_types, strict=True)]
        indices = [node.index for node in nodes]
        values = [*map(self._values.get, indices)]
        if None not in values:
            return self._fold(name, operand_types, values)
        simpler: Node | None = RULES[name](self, *nodes, *values) if name in RULES else None
        if simpler is not None:
            return simpler
        if name in COMMUTE:
            indices.sort()
        return self._node(result_kind(name, operand_types), self.dependence(indices), (name, *indices))

    def dependence(self, nodes: Iterable[int]) -> int:
        """Return what some nodes depend on."""
        depends = 0
        for index in nodes:
            depends |= self.depends[index]
        return depends

    def _convert(self, x: Node | Known, kind: str) -> Node:
        if type(x) is not Node:
            return self.const(x, kind)
        if x.tape is not self:
            remedy = "keep memory in state: return it with the input"
            raise NotTraceable("a symbol of an earlier trace was kept", remedy)
        own_kind = self.types[x.index]
        if own_kind == kind or kind == "u":
            return x
        return self.apply("select", x, 1.0, 0.0) if kind == "f" else self.apply("ne", x, 0.0)

    def _fold(self, name: str, kinds: Sequence[str], values: Sequence[Any]) -> Node:
        with np.errstate(all="ignore"):
            value = NUMPY[name](*(DTYPES[k](v) for k, v in zip(kinds, values, strict=True)))
        return self.const(value, result_kind(name, kinds))

    def _node(self, kind: str, depends: int, operation: _Operation) -> Node:
        index = self._indices.get(operation)
        if index is None:
            index = len(self.operations)
            # Nodes that all robots share are computed before the loop and cost little.
            self._count += bool(depends & (ROBOT | STATE))
            if self._count >= self._largest or index >= _SHARED * self._largest:
                reason = f"the law has more than {self._largest} operations with unrolled loops"
                remedy = "use fewer iterations or substeps, or run it with engine=Engine.PYTHON"
                raise NotTraceable(reason, remedy)
            self._indices[operation] = index
            if operation[0] == "const":
                self._keep(index, operation)
            self.operations.append(operation)
            self.types.append(kind)
            self.depends.append(depends)
            if self._locate is not None:
                self.places.append(self._locate())
        return Node(self, index)


def _operator(name: str, is_reversed: bool = False) -> Callable[[Node, Any], Any]:
    def apply(self: Node, other: Any) -> Any:
        if type(other) is not Node and not isinstance(other, int | float | np.generic):
            return NotImplemented
        return self.tape.apply(name, *((other, self) if is_reversed else (self, other)))

    return apply


def _unary(name: str) -> Callable[[Node], Node]:
    return lambda self: self.tape.apply(name, self)


@final
class Node:
    """Number on a tape, with Python's operators."""

    __slots__ = ("index", "tape")

    def __init__(self, tape: Tape, index: int) -> None:
        self.tape, self.index = tape, index

    @property
    def kind(self) -> str:
        """Type: f, u or b."""
        return self.tape.types[self.index]

    @property
    def value(self) -> Any:
        """Value of a constant, else None."""
        return self.tape.constant_of(self.index)

    def _require_value(self, reason: str, remedy: str) -> Any:
        """Return the value of a constant; raise `NotTraceable` for a symbol."""
        if (value := self.value) is None:
            raise NotTraceable(reason, remedy)
        return value

    def __bool__(self) -> bool:
        reason = "`if`, `while`, `and`, `or`, `not`, `assert`, max() or min() needs the truth of a symbol"
        remedy = "use np.where, np.logical_and, np.logical_or, np.logical_not, np.maximum and np.minimum"
        return bool(self._require_value(reason, remedy))

    def __float__(self) -> float:
        reason = "float(), a function of `math`, or an array from outside the law needs the value of a symbol"
        remedy = "make the array in the law, by np.array, np.zeros or np.zeros_like"
        return float(self._require_value(reason, f"use NumPy's function, and {remedy}"))

    def __index__(self) -> int:
        reason = "an index, int(), range() or an array of whole numbers needs the value of a symbol"
        return int(self._require_value(reason, "use np.where or np.select, and arrays of floats"))

    __int__ = __index__

    __add__, __radd__ = _operator("add"), _operator("add", is_reversed=True)
    __sub__, __rsub__ = _operator("sub"), _operator("sub", is_reversed=True)
    __mul__, __rmul__ = _operator("mul"), _operator("mul", is_reversed=True)
    __truediv__, __rtruediv__ = _operator("div"), _operator("div", is_reversed=True)
    __and__, __rand__ = _operator("and"), _operator("and", is_reversed=True)
    __or__, __ror__ = _operator("or"), _operator("or", is_reversed=True)
    __xor__, __rxor__ = _operator("xor"), _operator("xor", is_reversed=True)
    __lshift__, __rshift__ = _operator("shl"), _operator("shr")
    __gt__, __ge__, __lt__, __le__ = _operator("gt"), _operator("ge"), _operator("lt"), _operator("le")
    __eq__, __ne__ = _operator("eq"), _operator("ne")
    __neg__, __abs__, __invert__ = _unary("neg"), _unary("abs"), _unary("not")
    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"<symbol {self.index}>"

    def conjugate(self) -> Node:
        """Return the node itself, for NumPy's products of vectors."""
        return self


def _primitive(name: str) -> Callable[..., Any]:
    """Return an operation on nodes, numbers and NumPy arrays."""
    run = NUMPY[name]

    def apply(*given: Any) -> Any:
        for x in given:
            if type(x) is Node:
                return x.tape.apply(name, *given)
        return run(*given)

    return apply


select, root, absolute = map(_primitive, ("select", "sqrt", "abs"))
bits, real, maximum, minimum = map(_primitive, ("bits", "real", "max", "min"))


def evaluate(
    tape: Tape, nodes: Iterable[int], inputs: Mapping[_Operation, Any], first: bool = True
) -> list[Any]:
    """Return the values of nodes, computed with NumPy; the bits are those of compiled code.

    Parameters
    ----------
    tape : Tape
        Tape with the nodes.
    nodes : iterable of int
        Indices of the nodes.
    inputs : mapping of operation to ndarray
        Value of each input, such as ``("row", 2)``; all values broadcast. If `first` is False, also the
        values of the delays.
    first : bool
        Whether this is the first sample, at which a delay returns its argument.
    """
    nodes = list(nodes)
    values: dict[int, Any] = {}
    order = (index for index in ancestors(tape, nodes) if tape.depends[index] < ROUND)  # not in rounds

    def input_value(operation: _Operation) -> Any:
        if operation[0] == "ring":
            return values[operation[3]] if first else inputs[operation]
        # A NumPy scalar for one number: faster than an array without axes.
        kind = _INPUTS[operation[0]][1]
        return np.asarray(inputs[operation], DTYPES[kind])[()]

    with np.errstate(all="ignore"):
        _compute(tape, order, values, input_value)
    return [values[index] for index in nodes]


def _compute(
    tape: Tape, order: Iterable[int], values: dict[int, Any], input_value: Callable[[_Operation], Any]
) -> None:
    """Compute nodes in order; `input_value` returns the values of inputs."""
    for index in order:
        operation = tape.operations[index]
        name = operation[0]
        if name in NUMPY:
            values[index] = NUMPY[name](*[values[i] for i in operation[1:]])
        elif name == "const":
            values[index] = DTYPES[operation[1]](tape.constant_of(index))
        elif name == "repeat":
            values[index] = _evaluate_rounds(tape, Rounds.of(tape, index), values)
        elif name == "result":
            values[index] = values[operation[1]][operation[2]]
        else:
            values[index] = input_value(operation)


def _evaluate_rounds(tape: Tape, rounds: Rounds, values: dict[int, Any]) -> list[Any]:
    """Return the carried numbers after the last round; those of a finished robot do not change.

    `values` contains the known nodes, and then the nodes of the last round.
    """
    carried, done = [values[i] for i in rounds.first], values[rounds.skip]
    for _ in range(rounds.most):
        if np.all(done):
            break
        current = carried
        _compute(tape, rounds.body, values, lambda operation: current[operation[2]])  # noqa: B023 (called here)
        carried = [np.where(done, old, values[i])[()] for old, i in zip(carried, rounds.results, strict=True)]
        done = done | values[rounds.done]
    return carried


def ancestors(tape: Tape, nodes: Iterable[int]) -> list[int]:
    """Return the nodes that some nodes need, including themselves, in the order of the tape."""
    last = max(nodes := list(nodes), default=-1)
    is_ancestor = bytearray(last + 1)
    for index in nodes:
        is_ancestor[index] = 1
    for index in range(last, -1, -1):  # an operand precedes its operation
        if is_ancestor[index]:
            for operand in operands(tape.operations[index]):
                is_ancestor[operand] = 1
    return [index for index, is_needed in enumerate(is_ancestor) if is_needed]


def choose(condition: Any, a: Any, b: Any) -> Any:
    """Return a if a condition holds, else b; faster than NumPy for plain numbers."""
    if isinstance(condition, bool | np.bool_):
        return a if condition else b
    return select(condition, a, b)


def scalar_max(a: Any, b: Any) -> Any:
    """Return the larger of two scalars."""
    return choose(a > b, a, b)


def square_root(x: Any) -> Any:
    """Return the square root of a scalar >= 0."""
    return math.sqrt(x) if isinstance(x, float) else root(x)


def repeat(
    law: Callable[[list[Any]], tuple[Sequence[Any], Any]],
    first: Sequence[Any],
    most: int,
    skip: Any = False,
) -> list[Any]:
    """Return numbers after rounds of a law.

    Compiled code runs a block of robots until all are finished. The numbers of a finished robot do not
    change, so that no robot depends on the other robots of its block.

    Parameters
    ----------
    law : callable
        Function ``law(numbers)`` that returns the numbers after a round, and whether no further round is
        needed.
    first : sequence of scalars
        Numbers before the first round: numbers, arrays, or symbols.
    most : int
        Largest number of rounds, >= 1.
    skip : bool or ndarray of bool or symbol
        Whether no round is needed.
    """
    for x in (*first, skip):
        if type(x) is Node:
            return list(x.tape.repeat(law, first, most, skip))
    carried, done = list(first), np.bool_(False) | skip
    for _ in range(most):
        if np.all(done):
            break
        results, is_done = law(list(carried))
        if np.any(done):
            results = [np.where(done, old, new) for old, new in zip(carried, results, strict=True)]
        carried, done = list(results), done | is_done
    return carried


_TABLE_WORK = 32  # operations of a sample that justify a table


@dataclass(frozen=True)
class Leaf:
    """Array in the memory: its owner, its place, and its entries on the tape.

    Attributes
    ----------
    owner, path : str
        Owner and place, such as ``"controller"`` and ``"state['integral']"``.
    shape : tuple of int
        Shape of the array.
    first : int
        Index of its first entry among the states, uniforms or rows.
    kind : str
        ``"state"``; or ``"uniform"`` or ``"row"`` for an array that keeps its initial value.
    """

    owner: str
    path: str
    shape: tuple[int, ...]
    first: int
    kind: str

    @property
    def end(self) -> int:
        """Index behind its last entry."""
        return self.first + math.prod(self.shape)


@dataclass(frozen=True)
class Ring:
    """Delayed number: its node, the node that enters the delay, and the delay in samples."""

    node: int
    source: int
    samples: int


@dataclass(frozen=True)
class LoopTape:
    """Closed loop on a tape.

    Attributes
    ----------
    tape : Tape
        Operations of a sample.
    kept : dict of str to (tuple of int, list of int)
        Shape and nodes of the values that are kept of every sample.
    uniforms, rows : int
        Number of numbers of the run, and of each robot; the first uniform is the step [s].
    states : list of (int, int)
        Nodes of each number of the state, now and at the next sample: q, v and the memory.
    leaves : list of Leaf
        Arrays of the memory.
    parameters : dict of str to Leaf
        Place of each parameter.
    keys : list of str
        Names of the noises.
    rings : list of Ring
        Delayed numbers.
    counted : list of int
        Nodes whose sizes are counted.
    sizes : (int, int, int, int, int)
        nq, nv, nu, and the numbers of entries of the reference's q and v.
    unused : list of str
        Parameters that no law uses; a spread of these has no effect.
    tracks : int
        Number of entries of the reference of a sample if each robot has its own, else 0.
    units : dict of str to str
        Units of the signals among the kept values, by name.
    schedule_size : int
        Number of entries of a sample from schedules; they follow the reference.
    tables : bool
        Whether long computations of time and reference become tables, computed before the run.
    """

    tape: Tape
    kept: dict[str, tuple[tuple[int, ...], list[int]]]
    uniforms: int
    rows: int
    states: list[tuple[int, int]] = field(default_factory=list)
    leaves: list[Leaf] = field(default_factory=list)
    parameters: dict[str, Leaf] = field(default_factory=dict)
    keys: list[str] = field(default_factory=list)
    rings: list[Ring] = field(default_factory=list)
    counted: list[int] = field(default_factory=list)
    sizes: tuple[int, int, int, int, int] = (0, 0, 0, 0, 0)
    unused: list[str] = field(default_factory=list)
    tracks: int = 0
    units: dict[str, str] = field(default_factory=dict)
    schedule_size: int = 0
    tables: bool = True

    @property
    def outputs_kept(self) -> int:
        """Number of values that are kept of each sample."""
        return sum(len(nodes) for _, nodes in self.kept.values())

    @functools.cached_property
    def table_nodes(self) -> list[int]:
        """Nodes of time and reference only, which are computed once, as further columns of the samples.

        They are the same for all robots. Long computations, such as the waves of a noise force, are thus not
        repeated for each block of robots.
        """
        tape = self.tape
        nodes = ancestors(tape, self.outputs)
        shared = {i for i in nodes if tape.depends[i] & SAMPLE and not tape.depends[i] & (ROBOT | STATE)}
        operand_nodes = {i for j in nodes if j not in shared for i in operands(tape.operations[j])}
        ends = sorted(shared & (operand_nodes | set(self.outputs)))
        tables = [i for i in ends if tape.types[i] == "f" and operands(tape.operations[i])]
        savings = len(shared & set(ancestors(tape, tables)))
        return tables if self.tables and savings > _TABLE_WORK + 2 * len(tables) else []

    @functools.cached_property
    def robot_size(self) -> int:
        """Number of operations per robot and sample, without those in tables."""
        return sum(bool(self.tape.depends[i] & (ROBOT | STATE)) for i in ancestors(self.tape, self.outputs))

    @property
    def columns(self) -> int:
        """Number of entries of a sample: time, reference, schedules and tables."""
        return 1 + self.sizes[3] + 2 * self.sizes[4] + self.schedule_size + len(self.table_nodes)

    @property
    def outputs(self) -> list[int]:
        """Nodes that are needed at each sample."""
        kept = [node for _, nodes in self.kept.values() for node in nodes]
        ring_nodes = [node for ring in self.rings for node in (ring.node, ring.source)]
        return [node for pair in self.states for node in pair] + ring_nodes + self.counted + kept
