"""The tape: what a law computes, as a list of operations on numbers that are not known yet.

Every operation is one that a processor rounds as IEEE 754 says, so a tape has the same bits wherever it runs:
`evaluated` runs it with NumPy, `emit` writes it as machine code. Equal operations are kept once, and what is
known is folded. A product with a zero that stands in the law is zero, and a division by a number that stands
in the law, or that is the same at all samples, is a product with its reciprocal.
"""

import operator
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from pinmobile.errors import NotTraceable

__all__ = [
    "COUNT",
    "LARGEST",
    "ROBOT",
    "SAMPLE",
    "STATE",
    "UNIFORM",
    "Node",
    "Operation",
    "Tape",
    "absolute",
    "bits",
    "evaluated",
    "float_bits",
    "maximum",
    "minimum",
    "needed",
    "operands",
    "real",
    "root",
    "select",
]

UNIFORM, ROBOT, SAMPLE, STATE = 1, 2, 4, 8
"""What a node depends on, as bits: a number of the whole run, of a robot, of a sample, of the state."""

LARGEST = 20_000
"""Most nodes of a tape: building takes about 0.1 ms for each."""

Operation: TypeAlias = tuple[Any, ...]

# Names of inputs, with what they depend on and their type: f is a float, u 64 bits, b a truth value.
_INPUTS = {
    "uniform": (UNIFORM, "f"),
    "row": (ROBOT, "f"),
    "key": (ROBOT, "u"),
    "sample": (SAMPLE, "f"),
    "count": (SAMPLE, "u"),
    "state": (STATE, "f"),
}
COUNT: Operation = ("count",)


# Each operation on NumPy's numbers and arrays; `max` and `min` return the second where one is not a number.
_NUMPY: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": np.divide,
    "neg": operator.neg,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "max": lambda a, b: np.where(a > b, a, b),
    "min": lambda a, b: np.where(a < b, a, b),
    "gt": operator.gt,
    "ge": operator.ge,
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
    "and": operator.and_,
    "or": operator.or_,
    "xor": operator.xor,
    "not": np.logical_not,
    "select": np.where,
    "iadd": operator.add,
    "imul": operator.mul,
    "ixor": operator.xor,
    "iand": operator.and_,
    "ior": operator.or_,
    "shl": operator.lshift,
    "shr": operator.rshift,
    "bits": lambda x: np.asarray(x, np.float64).view(np.uint64),
    "real": lambda x: np.asarray(x, np.uint64).view(np.float64),
}
_COMMUTE = frozenset(("add", "mul", "and", "or", "xor", "iadd", "imul", "ixor", "iand", "ior", "eq", "ne"))
_TRUTHS = frozenset(("gt", "ge", "lt", "le", "eq", "ne", "and", "or", "xor", "not"))
_WHOLES = frozenset(("iadd", "imul", "ixor", "iand", "ior", "shl", "shr", "bits"))
_ON_WHOLES = {"add": "iadd", "mul": "imul", "xor": "ixor", "and": "iand", "or": "ior"}
_DTYPES = {"f": np.float64, "u": np.uint64, "b": np.bool_}


def float_bits(x: float) -> int:
    """Return the 64 bits of a float."""
    return int.from_bytes(struct.pack("<d", x), "little")


def _bits_float(x: int) -> float:
    return float(struct.unpack("<d", x.to_bytes(8, "little"))[0])


def operands(operation: Operation) -> tuple[int, ...]:
    """Return the nodes that an operation is of."""
    name = operation[0]
    if name == "const" or name in _INPUTS:
        return ()
    return (operation[3],) if name == "ring" else operation[1:]


class Tape:
    """Operations in the order in which they were met; an operand is the index of an earlier one.

    Parameters
    ----------
    largest : int
        Most nodes it takes.
    where : callable, optional
        Asked for each new node; what it returns is kept in `places`.

    Attributes
    ----------
    operations : list of tuple
        Name and operands: ``("mul", 3, 5)``; of an input its name and number, ``("row", 2)``; of a constant
        its type and bits; of a delay ``("ring", number, samples, node)``.
    types : list of str
        Of each node: f, u or b.
    depends : list of int
        Of each node: which of UNIFORM, ROBOT, SAMPLE and STATE it depends on.
    """

    def __init__(self, largest: int = LARGEST, where: Callable[[], Any] | None = None) -> None:
        self.operations: list[Operation] = []
        self.types: list[str] = []
        self.depends: list[int] = []
        self.places: list[Any] = []
        self._known: dict[Operation, int] = {}
        self._applied: dict[tuple[Any, ...], int] = {}  # what has been asked for, before it was simplified
        self._largest, self._where = largest, where

    def __len__(self) -> int:
        return len(self.operations)

    def input(self, *operation: Any) -> "Node":
        """Return an input, such as ``("row", 2)``."""
        depends, kind = _INPUTS[operation[0]]
        return self._node(kind, depends, operation)

    def ring(self, number: int, samples: int, pushed: "Node") -> "Node":
        """Return what `pushed` was `samples` ago; until there is that much, what it was at first."""
        return self._node("f", STATE, ("ring", number, samples, pushed.index))

    def const(self, value: Any, kind: str = "f") -> "Node":
        """Return a number, a truth value or 64 bits that are known."""
        if kind == "f":
            return self._node("f", 0, ("const", "f", float_bits(float(value))))
        return self._node(kind, 0, ("const", kind, bool(value) if kind == "b" else int(value) & (2**64 - 1)))

    def known(self, index: int) -> Any:
        """Return the value of a constant, and None of any other node."""
        operation = self.operations[index]
        if operation[0] != "const":
            return None
        return _bits_float(operation[2]) if operation[1] == "f" else operation[2]

    def apply(self, name: str, *given: Any) -> "Node":
        """Return the node of an operation on nodes and plain numbers, folded where it can be."""
        key: list[Any] = [name]
        for x in given:
            if type(x) is Node and x.tape is self:
                key.append(x.index)
            elif type(x) is float and x != 0:
                key.append((x,))  # which is not the node of that number
            else:
                return self._applied_anew(name, given)
        found = self._applied.get(tuple(key))
        if found is None:
            node = self._applied_anew(name, given)
            found = self._applied[tuple(key)] = node.index
        return Node(self, found)

    def _applied_anew(self, name: str, given: Sequence[Any]) -> "Node":
        kinds = [self.types[x.index] if type(x) is Node else _kind_of(x) for x in given]
        if "u" in kinds and name in _ON_WHOLES:
            name = _ON_WHOLES[name]
        wanted = _wanted(name, kinds)
        nodes = [self._as(x, kind) for x, kind in zip(given, wanted, strict=True)]
        values = [self.known(node.index) for node in nodes]
        if None not in values:
            return self._folded(name, wanted, values)
        simpler = _simplified(self, name, nodes, values)
        if simpler is not None:
            return simpler
        indices = [node.index for node in nodes]
        if name in _COMMUTE:
            indices.sort()
        depends = 0
        for index in indices:
            depends |= self.depends[index]
        return self._node(_kind(name, wanted), depends, (name, *indices))

    def _as(self, x: Any, kind: str) -> "Node":
        if type(x) is not Node:
            return self.const(x, kind)
        if x.tape is not self:
            raise NotTraceable(
                "a symbol of an earlier trace was kept", "keep memory in state: return it, and take it back"
            )
        own = self.types[x.index]
        if own == kind or kind == "u":
            return x
        return self.apply("select", x, 1.0, 0.0) if kind == "f" else self.apply("ne", x, 0.0)

    def _folded(self, name: str, kinds: Sequence[str], values: Sequence[Any]) -> "Node":
        with np.errstate(all="ignore"):
            value = _NUMPY[name](*(_DTYPES[k](v) for k, v in zip(kinds, values, strict=True)))
        return self.const(value, _kind(name, kinds))

    def _node(self, kind: str, depends: int, operation: Operation) -> "Node":
        index = self._known.get(operation)
        if index is None:
            index = len(self.operations)
            if index >= self._largest:
                raise NotTraceable(
                    f"the law has more than {self._largest} operations, its loops unrolled",
                    "take fewer rounds, or run it with engine=ARRAYS",
                )
            self._known[operation] = index
            self.operations.append(operation)
            self.types.append(kind)
            self.depends.append(depends)
            if self._where is not None:
                self.places.append(self._where())
        return Node(self, index)


def _kind_of(x: Any) -> str:
    return "b" if isinstance(x, bool | np.bool_) else "f"


def _kind(name: str, kinds: Sequence[str]) -> str:
    if name in _TRUTHS:
        return "b"
    if name in _WHOLES:
        return "u"
    return kinds[1] if name == "select" else "f"


def _wanted(name: str, kinds: Sequence[str]) -> tuple[str, ...]:
    """Return the types of an operation's operands."""
    if name in ("and", "or", "xor", "not"):
        return ("b",) * len(kinds)
    if name == "select":
        same = kinds[1] if kinds[1] == kinds[2] else "u" if "u" in kinds[1:] else "f"
        return "b", same, same
    return (("u",) if (name in _WHOLES and name != "bits") or name == "real" else ("f",)) * len(kinds)


def _simplified(tape: Tape, name: str, x: Sequence["Node"], known: Sequence[Any]) -> "Node | None":
    """Return what an operation comes to where that is less than the operation."""
    rule = _RULES.get(name)
    return rule(tape, *x, *known) if rule else None


def _negated(tape: Tape, x: "Node") -> "Node | None":
    operation = tape.operations[x.index]
    return Node(tape, operation[1]) if operation[0] == "neg" else None


def _sum(tape: Tape, a: "Node", b: "Node", va: Any, vb: Any) -> "Node | None":
    if va == 0:
        return b
    if vb == 0:
        return a
    minus = _negated(tape, b)
    if minus is not None:
        return tape.apply("sub", a, minus)
    minus = _negated(tape, a)
    return None if minus is None else tape.apply("sub", b, minus)


def _less(tape: Tape, a: "Node", b: "Node", va: Any, vb: Any) -> "Node | None":
    if vb == 0:
        return a
    if va == 0:
        return tape.apply("neg", b)
    minus = _negated(tape, b)
    return None if minus is None else tape.apply("add", a, minus)


def _product(tape: Tape, a: "Node", b: "Node", va: Any, vb: Any) -> "Node | None":
    for value, other in ((va, b), (vb, a)):
        if value == 0:
            return tape.const(0.0)
        if value is not None and abs(value) == 1:
            return other if value == 1 else tape.apply("neg", other)
    ma, mb = _negated(tape, a), _negated(tape, b)
    if ma is None and mb is None:
        return None
    product = tape.apply("mul", a if ma is None else ma, b if mb is None else mb)
    return product if ma is not None and mb is not None else tape.apply("neg", product)


def _quotient(tape: Tape, a: "Node", b: "Node", va: Any, vb: Any) -> "Node | None":
    if va == 0:
        return tape.const(0.0)
    if vb is not None:
        # A reciprocal that is not a normal number would lose bits.
        fits = vb != 0 and 2.0**-1021 <= abs(vb) <= 2.0**1021
        return tape.apply("mul", a, 1.0 / vb) if fits else None
    late = SAMPLE | STATE
    once = not tape.depends[b.index] & late and tape.depends[a.index] & late
    return tape.apply("mul", a, tape.apply("div", 1.0, b)) if once else None


def _both(tape: Tape, a: "Node", b: "Node", va: Any, vb: Any) -> "Node | None":
    if va is not None or vb is not None:
        value, other = (va, b) if va is not None else (vb, a)
        return other if value else tape.const(False, "b")
    return a if a.index == b.index else None


def _either(tape: Tape, a: "Node", b: "Node", va: Any, vb: Any) -> "Node | None":
    if va is not None or vb is not None:
        value, other = (va, b) if va is not None else (vb, a)
        return tape.const(True, "b") if value else other
    return a if a.index == b.index else None


def _chosen(tape: Tape, c: "Node", a: "Node", b: "Node", vc: Any, _: Any, __: Any) -> "Node | None":
    if vc is not None:
        return a if vc else b
    return a if a.index == b.index else None


def _undone(name: str) -> Callable[..., "Node | None"]:
    def rule(tape: Tape, x: "Node", _: Any) -> "Node | None":
        operation = tape.operations[x.index]
        return Node(tape, operation[1]) if operation[0] == name else None

    return rule


def _one(tape: Tape, a: "Node", b: "Node", _: Any, __: Any) -> "Node | None":
    return a if a.index == b.index else None


_RULES: dict[str, Callable[..., "Node | None"]] = {
    "add": _sum,
    "sub": _less,
    "mul": _product,
    "div": _quotient,
    "and": _both,
    "or": _either,
    "select": _chosen,
    "neg": _undone("neg"),
    "not": _undone("not"),
    "bits": _undone("real"),
    "real": _undone("bits"),
    "max": _one,
    "min": _one,
}


def _operator(name: str, turned: bool = False) -> Callable[["Node", Any], Any]:
    def apply(self: "Node", other: Any) -> Any:
        if type(other) is not Node and not isinstance(other, int | float | np.generic):
            return NotImplemented
        return self.tape.apply(name, *((other, self) if turned else (self, other)))

    return apply


def _unary(name: str) -> Callable[["Node"], "Node"]:
    return lambda self: self.tape.apply(name, self)


class Node:
    """One number on a tape, for Python's operators."""

    __slots__ = ("index", "tape")

    def __init__(self, tape: Tape, index: int) -> None:
        self.tape, self.index = tape, index

    @property
    def kind(self) -> str:
        """Its type: f, u or b."""
        return self.tape.types[self.index]

    @property
    def value(self) -> Any:
        """Its value where it is known, else None."""
        return self.tape.known(self.index)

    def __bool__(self) -> bool:
        value = self.value
        if value is None:
            raise NotTraceable(
                "`if`, `while`, `and`, `or`, `not`, `assert`, max() or min() asks whether a symbol is true",
                "use np.where, np.logical_and, np.logical_or, np.logical_not, np.maximum and np.minimum",
            )
        return bool(value)

    def __float__(self) -> float:
        value = self.value
        if value is None:
            raise NotTraceable(
                "float(), a function of `math`, or an array that was made outside the law asks for a number",
                "use NumPy's function, and make the array in the law, by np.array, np.zeros or np.zeros_like",
            )
        return float(value)

    def __index__(self) -> int:
        value = self.value
        if value is None:
            raise NotTraceable(
                "an index, int(), range() or an array of whole numbers asks for a whole number",
                "use np.where or np.select, and arrays of floats",
            )
        return int(value)

    __int__ = __index__

    __add__, __radd__ = _operator("add"), _operator("add", turned=True)
    __sub__, __rsub__ = _operator("sub"), _operator("sub", turned=True)
    __mul__, __rmul__ = _operator("mul"), _operator("mul", turned=True)
    __truediv__, __rtruediv__ = _operator("div"), _operator("div", turned=True)
    __and__, __rand__ = _operator("and"), _operator("and", turned=True)
    __or__, __ror__ = _operator("or"), _operator("or", turned=True)
    __xor__, __rxor__ = _operator("xor"), _operator("xor", turned=True)
    __lshift__, __rshift__ = _operator("shl"), _operator("shr")
    __gt__, __ge__, __lt__, __le__ = _operator("gt"), _operator("ge"), _operator("lt"), _operator("le")
    __eq__, __ne__ = _operator("eq"), _operator("ne")
    __neg__, __abs__, __invert__ = _unary("neg"), _unary("abs"), _unary("not")
    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"<symbol {self.index}>"

    def conjugate(self) -> "Node":
        """Return itself; NumPy asks for it in products of vectors."""
        return self


def _primitive(name: str) -> Callable[..., Any]:
    """Return an operation that takes nodes, numbers and NumPy's arrays alike."""
    run = _NUMPY[name]

    def apply(*given: Any) -> Any:
        for x in given:
            if type(x) is Node:
                return x.tape.apply(name, *given)
        return run(*given)

    return apply


select = _primitive("select")
bits, real = _primitive("bits"), _primitive("real")
root, absolute = _primitive("sqrt"), _primitive("abs")
maximum, minimum = _primitive("max"), _primitive("min")


def evaluated(
    tape: Tape, wanted: Iterable[int], inputs: Mapping[Operation, Any], first: bool = True
) -> list[Any]:
    """Return the values of some nodes, computed with NumPy: the bits that the compiled code gives.

    Parameters
    ----------
    tape : Tape
        What is computed.
    wanted : iterable of int
        Indices of the nodes.
    inputs : mapping of operation to ndarray
        Value of each input, such as that of ``("row", 2)``; all broadcast. Where `first` is False, the values
        of the delays too.
    first : bool
        Whether this is the first sample, at which a delay returns what it is given.
    """
    wanted = list(wanted)
    values: dict[int, Any] = {}
    with np.errstate(all="ignore"):
        for index in needed(tape, wanted):
            operation = tape.operations[index]
            name = operation[0]
            if name == "const":
                values[index] = _DTYPES[operation[1]](tape.known(index))
            elif name == "ring":
                values[index] = values[operation[3]] if first else inputs[operation]
            elif name in _INPUTS:
                values[index] = np.asarray(inputs[operation], _DTYPES[tape.types[index]])
            else:
                values[index] = _NUMPY[name](*(values[i] for i in operation[1:]))
    return [values[index] for index in wanted]


def needed(tape: Tape, wanted: Iterable[int]) -> list[int]:
    """Return the nodes that some nodes need, themselves included, in the order of the tape."""
    found: set[int] = set()
    todo = list(wanted)
    while todo:
        index = todo.pop()
        if index not in found:
            found.add(index)
            todo += operands(tape.operations[index])
    return sorted(found)
