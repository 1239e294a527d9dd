"""C code of nodes of a tape: a statement per operation, with the bits of the library in double precision."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from pinmobile.compiled import DTYPES, NUMPY, ROUND, Rounds, Tape, operands
from pinmobile.errors import InvalidArgument

_SIGNS = {
    **{"add": "+", "sub": "-", "mul": "*", "div": "/", "iadd": "+", "imul": "*", "shl": "<<", "shr": ">>"},
    **{"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "eq": "==", "ne": "!="},
    **{"and": "&", "or": "|", "xor": "^", "iand": "&", "ior": "|", "ixor": "^"},
}
_MARGIN = 64  # numbers on the stack beside the variables: arguments, saved registers, called functions


class Code:
    """Writer of the C statements that compute nodes of a tape.

    Parameters
    ----------
    tape : Tape
        Tape with the nodes.
    places : mapping of operation to str
        C expression of each input, such as ``("state", 0): "q[0]"``; delays by their node.
    constants : mapping of operation to float
        Inputs that are constant.
    prefix : str
        Prefix of all names of the exported code.
    single : bool
        Whether numbers have single precision. Elementary functions are then calls, not operations on bits.
    """

    def __init__(
        self,
        tape: Tape,
        places: Mapping[Any, str],
        constants: Mapping[Any, float],
        *,
        prefix: str,
        single: bool = False,
    ) -> None:
        self.tape, self.places, self.constants = tape, places, constants
        self.prefix, self.single = prefix, single
        self.marks = tape.marks if single else {}
        self.values: dict[int, Any] = {}  # values of nodes that depend on constants only
        self.live: set[int] = set()
        self.round_numbers: dict[int, list[int]] = {}  # numbers of rounds that something needs
        self.lines: list[str] = []
        self.functions: set[str] = set()
        self.operations = self.calls = self.loops = 0

    def write(self, nodes: Iterable[int]) -> list[str]:
        """Return the statements that compute some nodes, in order.

        Raises
        ------
        InvalidArgument
            If an operation has no equivalent in single precision.
        """
        nodes = list(nodes)
        self._fold(max(nodes, default=-1) + 1)
        self._mark_live(nodes)
        self._block([i for i in sorted(self.live) if self.tape.depends[i] < ROUND], "    ")
        return self.lines

    def name(self, node: int) -> str:
        """Return the C expression of a node: a constant, an input or a variable."""
        if node in self.values:
            return self.literal(self.tape.types[node], self.values[node])
        operation = self.tape.operations[node]
        if operation[0] == "result":
            return f"y{operation[1]}_{operation[2]}"
        if operation[0] == "carry":
            return f"y{self._repeat_of(operation[1])}_{operation[2]}"
        return self.places.get(node) or self.places.get(operation) or f"x{node}"

    def _fold(self, end: int) -> None:
        """Compute the nodes that depend on constants only."""
        tape, values = self.tape, self.values
        with np.errstate(all="ignore"):
            for node, operation in enumerate(tape.operations[:end]):
                if operation[0] == "const":
                    values[node] = DTYPES[tape.types[node]](tape.constant_of(node))
                elif operation in self.constants:
                    values[node] = DTYPES[tape.types[node]](self.constants[operation])
                elif operation[0] in NUMPY and all(i in values for i in operation[1:]):
                    values[node] = NUMPY[operation[0]](*(values[i] for i in operation[1:]))

    def _needs(self, node: int) -> tuple[int, ...]:
        """Return the nodes that a node needs, without those that only some numbers of its rounds need."""
        if node in self.marks:
            return self.marks[node][1]
        operation = self.tape.operations[node]
        if operation[0] == "repeat":
            return operation[4], operation[5]
        if operation[0] == "result":
            return (operation[1], *self._carry(operation[1], operation[2]))
        if operation[0] == "carry":
            return self._carry(self._repeat_of(operation[1]), operation[2])
        return operands(operation)

    def _carry(self, repeat: int, number: int) -> tuple[int, int]:
        """Return the nodes of a number of rounds before and after a round; something needs the number."""
        rounds, numbers = Rounds.of(self.tape, repeat), self.round_numbers.setdefault(repeat, [])
        if number not in numbers:
            numbers.append(number)
        return rounds.first[number], rounds.results[number]

    def _repeat_of(self, number: int) -> int:
        """Return the node of a repetition by its number."""
        operations = self.tape.operations
        return next(i for i, operation in enumerate(operations) if operation[:2] == ("repeat", number))

    def _mark_live(self, nodes: list[int]) -> None:
        """Find all nodes that some nodes need."""
        todo = list(nodes)
        while todo:
            node = todo.pop()
            if node not in self.live and node not in self.values:
                self.live.add(node)
                todo += self._needs(node)

    def _block(self, nodes: Iterable[int], indent: str) -> None:
        for node in nodes:
            operation = self.tape.operations[node]
            if operation[0] == "repeat":
                self._rounds(node, indent)
            elif operation[0] not in ("result", "carry") and self.name(node) == f"x{node}":
                kind = {"f": f"{self.prefix}_real", "u": "uint64_t", "b": "int"}[self.tape.types[node]]
                self.lines.append(f"{indent}const {kind} x{node} = {self._expression(node)};")

    def _rounds(self, node: int, indent: str) -> None:
        """Write the loop of a repetition."""
        rounds, real = Rounds.of(self.tape, node), f"{self.prefix}_real"
        numbers, inner = sorted(self.round_numbers.get(node, [])), indent + "    "
        lines = self.lines
        self.loops += 1
        lines += [f"{indent}{real} y{node}_{j} = {self.name(rounds.first[j])};" for j in numbers]
        lines += [
            f"{indent}int done{node} = {self.name(rounds.skip)};",
            f"{indent}for (int k{node} = 0; k{node} < {rounds.most} && !done{node}; ++k{node}) {{",
        ]
        self._block([i for i in rounds.body if i in self.live], inner)
        lines += [f"{inner}const {real} z{node}_{j} = {self.name(rounds.results[j])};" for j in numbers]
        lines.append(f"{inner}done{node} = {self.name(rounds.done)};")
        lines += [f"{inner}y{node}_{j} = z{node}_{j};" for j in numbers]
        lines.append(f"{indent}}}")

    def literal(self, kind: str, value: Any) -> str:
        if kind == "u":
            return f"UINT64_C({int(value)})"
        if kind == "b":
            return str(int(value))
        x = float(np.float32(value)) if self.single else float(value)
        if not np.isfinite(x):
            text = "NAN" if np.isnan(x) else "INFINITY"
            return f"(-({self.prefix}_real){text})" if x < 0 else f"(({self.prefix}_real){text})"
        text = x.hex() + ("f" if self.single else "")
        return f"({text})" if text.startswith("-") else text

    def _expression(self, node: int) -> str:
        """Return the C expression of an operation."""
        if node not in self.marks:
            self.operations += 1
        else:
            function, operands = self.marks[node]
            if function == "count":
                return f"({self.prefix}_real)memory->k"
            self.functions.add(function)
            self.calls += 1
            return f"{self.prefix}_{function}({', '.join(map(self.name, operands))})"
        name, *args = self.tape.operations[node]
        if name == "ring":
            return f"memory->k == 0 ? {self.name(args[2])} : memory->delay_{node}[memory->at_{args[1]}]"
        x = [self.name(i) for i in args]
        if self.single and "u" in (self.tape.types[node], *(self.tape.types[i] for i in args)):
            raise InvalidArgument(
                "precision is 'single', but the law computes with the bits of doubles, expected precision="
                "'double'",
                "precision",
            )
        if name in _SIGNS:
            return f"{x[0]} {_SIGNS[name]} {x[1]}"
        if name in ("max", "min"):
            return f"{x[0]} {'>' if name == 'max' else '<'} {x[1]} ? {x[0]} : {x[1]}"
        end = "f" if self.single else ""
        return {
            "select": "{0} ? {1} : {2}",
            "neg": "-{0}",
            "not": "!{0}",
            "abs": f"fabs{end}({{0}})",
            "sqrt": f"sqrt{end}({{0}})",
            "bits": f"{self.prefix}_bits({{0}})",
            "real": f"{self.prefix}_from_bits({{0}})",
        }[name].format(*x)

    @property
    def stack(self) -> int:
        """Bound of the bytes of stack: each variable has its own place, as without optimisation."""
        return 8 * (len(self.lines) + _MARGIN)
