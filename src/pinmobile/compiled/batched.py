"""A law on many states at once: a function of arrays, compiled, over their leading axes.

The machine code reads states where they stand and writes answers where they belong, some states side by side
in a vector: rows are turned into vectors, and back, in registers. Answers go past the caches, in the order of
the memory: it is the memory that limits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.compiled.emit import ENTRY, Code, Shape
from pinmobile.compiled.loop_tape import LoopTape
from pinmobile.compiled.processor import Cache, Target, function_of
from pinmobile.compiled.program import aligned, shared_out
from pinmobile.compiled.symbolic import entries, symbols
from pinmobile.compiled.tape import LARGEST, Node, Tape, needed
from pinmobile.compiled.tracing import tracing
from pinmobile.errors import InvalidArgument, NotTraceable

_SLICE = 1e8  # operations of a vector in one call, some 0.1 s: Ctrl-C is answered in between
_WORTH = 3e5  # operations of a vector, some 0.2 ms, for which a thread is worth starting


class Batched:
    """A function of one state, compiled for many.

    Parameters
    ----------
    law : callable
        Takes arrays of the shapes below, and returns an array or a tuple of arrays.
    shapes : sequence of tuples of int
        Of its arguments.
    alike : int
        How many of them, the last ones, are the same for all states: what follows from these alone is
        computed once.
    pure : bool
        Whether it is known to depend on its arguments alone; if not, it is traced twice to see.
    largest : int
        Most operations of a state.
    target, cache
        As in `Program`.

    Attributes
    ----------
    size : int
        How many numbers come back of each state.

    Raises
    ------
    NotTraceable
        If the law cannot be run on symbols, has more operations, or is another one when it is asked again.
    """

    def __init__(
        self,
        law: Callable[..., Any],
        shapes: Sequence[tuple[int, ...]],
        *,
        alike: int = 0,
        pure: bool = False,
        largest: int = LARGEST,
        target: Target | None = None,
        cache: Cache | None = None,
    ) -> None:
        self.shapes = tuple(map(tuple, shapes))
        self._own = len(self.shapes) - alike
        form = self.shapes, self._own, largest
        loop, self._is_tuple = _traced(law, *form)
        if not pure and loop.tape.operations != _traced(law, *form)[0].tape.operations:
            raise NotTraceable(
                f"{getattr(law, '__qualname__', law)} computes something else when it is asked again",
                "let it depend on its arguments alone",
            )
        target = Target.here() if target is None else target
        self._lanes, self._work = target.lanes, max(1, loop.own)
        self._answers = [shape for shape, _ in loop.kept.values()]
        self.size = loop.outputs_kept
        text = _text(loop, Shape(target.lanes, 1), [prod(shape) for shape in self.shapes[: self._own]])
        cache = Cache() if cache is None else cache
        self._function = function_of(target.key(text), lambda: text, target, cache)

    def __call__(self, *given: ArrayLike, threads: int = 1) -> Any:
        """Return what the law gives for each of the leading axes, over which the arguments broadcast.

        Parameters
        ----------
        *given : array_like, shape (..., *shape)
            The arguments; what is the same for all states has no leading axes.
        threads : int
            Most threads. The answer has the same bits for any number, and each state's own whatever others
            there are.

        Raises
        ------
        InvalidArgument
            If an argument has another shape.
        """
        arrays = [np.asarray(x, np.float64) for x in given]
        own, alike = arrays[: self._own], arrays[self._own :]
        fit = [x.shape[x.ndim - len(s) :] == s for x, s in zip(own, self.shapes, strict=False)]
        fit += [x.shape == s for x, s in zip(alike, self.shapes[self._own :], strict=False)]
        if len(arrays) != len(self.shapes) or not all(fit):
            ahead = [("...", *shape) for shape in self.shapes[: self._own]]
            expected = ", ".join(str(each).replace("'", "") for each in (*ahead, *self.shapes[self._own :]))
            raise InvalidArgument(f"arguments have shapes {[x.shape for x in arrays]}, expected {expected}")
        lead = np.broadcast_shapes(
            *(x.shape[: x.ndim - len(s)] for x, s in zip(own, self.shapes, strict=False))
        )
        found = tuple(aligned((*lead, *shape), empty=True) for shape in self._answers)
        n = prod(lead)
        if n:
            uniforms = np.concatenate([np.zeros(1), *(x.ravel() for x in alike)])
            rows = [_rows(x, lead, s) for x, s in zip(own, self.shapes, strict=False)]
            self._run(
                rows,
                uniforms,
                [x.reshape(n, prod(s)) for x, s in zip(found, self._answers, strict=True)],
                threads,
            )
        return found if self._is_tuple else found[0]

    def _run(self, rows: list[Array], uniforms: Array, found: list[Array], threads: int) -> None:
        """Write the answers, shape (n, size) each, of rows (n, size), or (1, size) where all are the same."""
        n, lanes = len(found[0]), self._lanes
        blocks, left = divmod(n, lanes)
        if left:  # what does not fill a vector is done again with some before, or with itself
            last = np.arange(n - left, n - left + lanes) % n if n < lanes else slice(n - lanes, n)
            whole = [aligned((lanes, x.shape[1]), empty=True) for x in found]
            self._run([x[last] if len(x) == n else x for x in rows], uniforms, whole, 1)
            for part, each in zip(found, whole, strict=True):
                part[n - left :] = each[:left] if n < lanes else each[lanes - left :]
        table = [(x.ctypes.data, x.shape[1] if len(x) > 1 else 0) for x in rows]
        places = np.array([*(number for pair in table for number in pair), *(x.ctypes.data for x in found)])
        workers = max(1, min(threads, int(self._work * blocks / _WORTH)))
        step = max(1, min(int(_SLICE / self._work), -(-blocks // (4 * workers))))

        def run(_: int, begin: int, end: int) -> None:
            given = places.ctypes.data, begin, end, None, 1, uniforms.ctypes.data, None, None, 1, n, None
            self._function(*given)

        shared_out(run, blocks, step, workers)


def _rows(array: Array, lead: tuple[int, ...], shape: tuple[int, ...]) -> Array:
    """Return an argument as rows, shape (n, size), or (1, size) where it is the same for all."""
    size = prod(shape)
    if array.size == size:
        return np.ascontiguousarray(array.reshape(1, size))
    return np.ascontiguousarray(np.broadcast_to(array, (*lead, *shape)).reshape(prod(lead), size))


def _traced(
    law: Callable[..., Any], shapes: Sequence[tuple[int, ...]], own: int, largest: int
) -> tuple[LoopTape, bool]:
    tape, given, counts = Tape(largest), [], {"row": 0, "uniform": 1}  # the first uniform is a loop's step
    for k, shape in enumerate(shapes):
        kind, size = "row" if k < own else "uniform", prod(shape)
        given.append(symbols([tape.input(kind, counts[kind] + i) for i in range(size)], shape))
        counts[kind] += size
    with tracing():
        found = law(*given)
    outputs = found if isinstance(found, tuple) else (found,)
    kept = {}
    for i, output in enumerate(outputs):
        nodes = [x if type(x) is Node else tape.const(x) for x in entries(output).reshape(-1)]
        numbers = [tape.apply("select", x, 1.0, 0.0) if x.kind == "b" else x for x in nodes]
        kept[str(i)] = entries(output).shape, [x.index for x in numbers]
    loop = LoopTape(
        tape=tape,
        states=[],
        leaves=[],
        parameters={},
        uniforms=counts["uniform"],
        rows=counts["row"],
        keys=[],
        rings=[],
        counted=[],
        kept=kept,
        sizes=(0, 0, 0, 0, 0),
        unused=[],
    )
    return loop, isinstance(found, tuple)


def _text(loop: LoopTape, shape: Shape, sizes: Sequence[int]) -> str:
    """Return the module that runs a law on rows.

    Its function has the signature of a loop's, takes ``(places, begin, end, -, -, uniforms, ...)`` of that,
    and runs the blocks from `begin` to before `end`, as many rows each as a vector has lanes. `places` has
    the address of each argument's first row and how far it is to the next, 0 where there is one for all, and
    then the addresses of the answers.

    Parameters
    ----------
    loop : LoopTape
        The law.
    shape : Shape
        How the rows are laid out.
    sizes : sequence of int
        Of the arguments.
    """
    code = _Rows(loop, shape)
    code.read(sizes)
    waiting = code.answers(2 * len(sizes))
    for node in needed(loop.tape, [node for each in waiting for node in each.nodes]):
        code.emit(node, "block")
        while waiting and all(map(code.is_known, waiting[-1].nodes)):
            code.write(waiting.pop())
    for each in reversed(waiting):  # of constants alone
        code.write(each)
    return "\n".join([*code.declarations(), *code.function()])


class _Group(NamedTuple):
    """Columns of an answer that are written together: rows of its own memory, the first, and nodes."""

    rows: list[str]
    first: int
    nodes: list[int]


class _Rows(Code):
    """The code of a law on rows."""

    def __init__(self, loop: LoopTape, shape: Shape) -> None:
        super().__init__(loop, shape)
        self._copies: list[tuple[str, str, int]] = []  # from, to, and how many vectors

    def declarations(self) -> list[str]:
        """Return what stands ahead of the function."""
        whole, lanes = self.type("f"), self.shape.lanes
        kind = f"v{lanes}f64"
        return [
            "declare double @llvm.sqrt.f64(double)",
            f"declare {whole} @llvm.sqrt.{kind}({whole})",
            f"declare {whole} @llvm.masked.load.{kind}.p0(ptr, i32, <{lanes} x i1>, {whole})",
            f"declare void @llvm.masked.store.{kind}.p0({whole}, ptr, i32, <{lanes} x i1>)",
            "!0 = !{i32 1}",
        ]

    def function(self) -> list[str]:
        """Return the function."""
        lanes, copies = self.shape.lanes, len(self._copies)
        return [
            f"define void @{ENTRY}(ptr noalias readonly %places, i64 %begin, i64 %end, ptr %samples, "
            "i64 %count, ptr noalias readonly %uniforms, ptr %ring, ptr %counts, i64 %every, i64 %n, "
            'ptr %kept) alignstack(64) nounwind "prefer-vector-width"="512" '
            f'"min-legal-vector-width"="{64 * lanes}" {{',
            "entry:",
            *self.lines["entry"],
            "  br label %copied0",
            "copied0:",
            f"  %b = phi i64 [ %begin, %entry ], [ %b1, %copied{copies} ]",
            f"  %first = mul i64 %b, {lanes}",
            *self.lines["block"],
            *self._copied(),
            "  %b1 = add i64 %b, 1",
            "  %more = icmp slt i64 %b1, %end",
            "  br i1 %more, label %copied0, label %done",
            "done:",
            "  fence seq_cst",  # what went past the caches is there
            "  ret void",
            "}",
        ]

    def _copied(self) -> list[str]:
        """Return the copying of what a block's answers are to where they belong, one vector after another."""
        whole, lanes, lines = self.type("f"), self.shape.lanes, []
        for k, (own, base, size) in enumerate(self._copies):
            lines += [
                f"  %to{k} = getelementptr double, ptr {base}, i64 %at{k}",
                f"  br label %copy{k}",
                f"copy{k}:",
                f"  %i{k} = phi i64 [ 0, %copied{k} ], [ %j{k}, %copy{k} ]",
                f"  %o{k} = mul i64 %i{k}, {lanes}",
                f"  %x{k} = getelementptr double, ptr {own}, i64 %o{k}",
                f"  %y{k} = getelementptr double, ptr %to{k}, i64 %o{k}",
                f"  %z{k} = load {whole}, ptr %x{k}, align {8 * lanes}",
                f"  store {whole} %z{k}, ptr %y{k}, align {8 * lanes}, !nontemporal !0",
                f"  %j{k} = add i64 %i{k}, 1",
                f"  %c{k} = icmp slt i64 %j{k}, {size}",
                f"  br i1 %c{k}, label %copy{k}, label %copied{k + 1}",
                f"copied{k + 1}:",
            ]
        return [f"  %at{k} = mul i64 %first, {each[2]}" for k, each in enumerate(self._copies)] + lines

    def is_known(self, node: int) -> bool:
        """Tell whether a node has been written."""
        return node in self.values or self.tape.operations[node][0] == "const"

    def read(self, sizes: Sequence[int]) -> None:
        """Write the reading of the arguments."""
        numbers = {op[1]: i for i, op in enumerate(self.tape.operations) if op[0] == "row"}
        first = 0
        for k, size in enumerate(sizes):
            apart = self._place_of(2 * k + 1, "i64")
            rows = self._lines(self._place_of(2 * k, "ptr"), apart)
            for start, own in self._groups(size):
                vectors = [self._loaded(row, start, min(size, self.shape.lanes)) for row in rows]
                columns = self._turned(vectors)
                for j in own:
                    self.values[numbers[first + j]] = [columns[j - start]]
            first += size

    def answers(self, place: int) -> list[_Group]:
        """Return what is written together, what is known first as the last.

        The addresses of the answers stand from a place of `places` on; they have memory of their own in a
        block.
        """
        found, lanes = [], self.shape.lanes
        for k, (_, nodes) in enumerate(self.loop.kept.values()):
            size = len(nodes)
            if not size:
                continue
            own = self.put("entry", f"alloca [{size * lanes} x double], align 64")
            self._copies.append((own, self._place_of(place + k, "ptr"), size))
            rows = [
                self.put("entry", f"getelementptr double, ptr {own}, i64 {i * size}") for i in range(lanes)
            ]
            for start, _ in self._groups(size):
                found.append(_Group(rows, start, nodes[start : start + lanes]))
        return sorted(found, key=lambda group: max(group.nodes), reverse=True)

    def write(self, group: _Group) -> None:
        """Write the writing of columns of an answer."""
        columns = [self.argument(node, 0, "block") for node in group.nodes]
        columns += ["poison"] * (self.shape.lanes - len(columns))
        for row, vector in zip(group.rows, self._turned(columns), strict=True):
            self._stored(vector, row, group.first, len(group.nodes))

    def _groups(self, size: int) -> list[tuple[int, range]]:
        """Return the first of the columns that are turned together, and which of them are new."""
        lanes, found = self.shape.lanes, []
        for start in range(0, size, lanes):
            found.append((max(0, min(start, size - lanes)), range(start, min(start + lanes, size))))
        return found

    def _place_of(self, number: int, kind: str) -> str:
        place = self.put("entry", f"getelementptr i64, ptr %places, i64 {number}")
        return self.put("entry", f"load {kind}, ptr {place}, align 8")

    def _lines(self, base: str, apart: str) -> list[str]:
        """Write the addresses of the rows of a block."""
        offset = self.put("block", f"mul i64 %first, {apart}")
        found = [self.put("block", f"getelementptr double, ptr {base}, i64 {offset}")]
        for _ in range(self.shape.lanes - 1):
            found.append(self.put("block", f"getelementptr double, ptr {found[-1]}, i64 {apart}"))
        return found

    def _loaded(self, row: str, start: int, count: int) -> str:
        place = self.put("block", f"getelementptr double, ptr {row}, i64 {start}")
        whole = self.type("f")
        if count == self.shape.lanes:
            return self.put("block", f"load {whole}, ptr {place}, align 8")
        mask = self._mask(count)
        name = f"llvm.masked.load.v{self.shape.lanes}f64.p0"
        return self.put("block", f"call {whole} @{name}(ptr {place}, i32 8, {mask}, {whole} poison)")

    def _stored(self, vector: str, row: str, start: int, count: int) -> None:
        place = self.put("block", f"getelementptr double, ptr {row}, i64 {start}")
        whole = self.type("f")
        if count == self.shape.lanes:
            self.lines["block"].append(f"  store {whole} {vector}, ptr {place}, align 8")
            return
        name, mask = f"llvm.masked.store.v{self.shape.lanes}f64.p0", self._mask(count)
        self.lines["block"].append(f"  call void @{name}({whole} {vector}, ptr {place}, i32 8, {mask})")

    def _mask(self, count: int) -> str:
        lanes = self.shape.lanes
        bits = ", ".join(f"i1 {'true' if i < count else 'false'}" for i in range(lanes))
        return f"<{lanes} x i1> <{bits}>"

    def _turned(self, vectors: Sequence[str]) -> list[str]:
        """Write the transposition of as many vectors as one has lanes."""
        found, lanes, whole = list(vectors), self.shape.lanes, self.type("f")
        apart = 1
        while apart < lanes:
            for i in range(lanes):
                if not i & apart:
                    a, b = found[i], found[i + apart]
                    low = [lanes + j - apart if j & apart else j for j in range(lanes)]
                    high = [lanes + j if j & apart else j + apart for j in range(lanes)]
                    found[i], found[i + apart] = (
                        self.put("block", f"shufflevector {whole} {a}, {whole} {b}, {self._order(order)}")
                        for order in (low, high)
                    )
            apart *= 2
        return found

    def _order(self, order: Sequence[int]) -> str:
        return f"<{self.shape.lanes} x i32> <{', '.join(f'i32 {j}' for j in order)}>"


def copied(part: object, values: Any, parts: Any = None) -> Any:
    """LEGACY."""
    import copy
    import functools

    new = copy.copy(part)
    for each in type(part).__mro__:
        for name, attribute in vars(each).items():
            if isinstance(attribute, functools.cached_property):
                new.__dict__.pop(name, None)
    for name, value in values.items():
        object.__setattr__(new, name, value)
    return new
