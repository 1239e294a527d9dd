"""Text of a loop for LLVM: blocks of robots in vectors, with the time loop inside.

The state of a block stays in registers from sample to sample. Numbers that all robots share are computed once
for all lanes, numbers of a robot before its first sample. The code has no branches except loops. Every
operation rounds once, and none are contracted, so that the bits are those of `tape.evaluate`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

from pinmobile.compiled.folding import ROBOT, ROUND, SAMPLE, STATE
from pinmobile.compiled.tape import LoopTape, Rounds, ancestors, operands

ENTRY = "pinmobile_loop"

SHIFT = 47  # shift of a size's bits that leaves the exponent and 5 bits of the fraction
_OCTAVES = 84
FIRST = (1023 - 54) << (52 - SHIFT)  # bin of 2^-54
BINS = 32 * _OCTAVES + 2  # including one bin below and one above

_BINARY = {name: f"f{name}" for name in ("add", "sub", "mul", "div")}  # of floats
_BINARY |= {f"i{name}": name for name in ("add", "mul", "xor", "and", "or")}  # of words
_BINARY |= {name: name for name in ("and", "or", "xor", "shl")} | {"shr": "lshr"}
_COMPARISONS = {"gt": "ogt", "ge": "oge", "lt": "olt", "le": "ole", "eq": "oeq", "ne": "une"}
_SCALAR = {"f": "double", "u": "i64", "b": "i1"}


@dataclass(frozen=True)
class Shape:
    """Layout of robots: vectors with lanes, and vectors per block.

    Parameters
    ----------
    lanes : int
        Robots in a vector: 8 for AVX-512, 4 for AVX2, 2 for SSE2 and NEON; 1 makes scalar code.
    vectors : int
        Vectors in a block, whose instructions are interleaved.
    """

    lanes: int
    vectors: int

    @property
    def width(self) -> int:
        """Number of robots in a block."""
        return self.lanes * self.vectors


class Code:
    """Lines of a function, by their region.

    Parameters
    ----------
    loop : LoopTape
        Loop on a tape.
    shape : Shape
        Layout of the robots.
    """

    def __init__(self, loop: LoopTape, shape: Shape) -> None:
        self.loop, self.tape, self.shape = loop, loop.tape, shape
        self.vector_rows = len(loop.states)
        self.lines: dict[str, list[str]] = {name: [] for name in ("entry", "block", "sample", "count")}
        self.values: dict[int, list[str]] = {}
        self.spread: dict[tuple[int, str], str] = {}
        self.ring_stores: list[str] = []
        self.rings: dict[int, tuple[str, str, str]] = {}
        self.results: dict[int, list[list[str]]] = {}
        self.counter = 0
        self.constants: dict[tuple[int, bool], str] = {}
        self.shared = [not depends & (ROBOT | STATE) for depends in self.tape.depends]
        lanes = shape.lanes
        self.vector_types = {k: x if lanes == 1 else f"<{lanes} x {x}>" for k, x in _SCALAR.items()}

    def type(self, kind: str, scalar: bool = False) -> str:
        """Return LLVM's type of a value: a vector, unless all lanes share the value."""
        return _SCALAR[kind] if scalar else self.vector_types[kind]

    def constant(self, kind: str, literal: str, scalar: bool = False) -> str:
        """Return a constant, repeated for each lane."""
        lanes = self.shape.lanes
        if scalar or lanes == 1:
            return literal
        return f"<{', '.join([f'{_SCALAR[kind]} {literal}'] * lanes)}>"

    def put(self, region: str, text: str) -> str:
        """Write an instruction, and return the name of its value."""
        self.counter += 1
        self.lines[region].append(f"  %t{self.counter} = {text}")
        return f"%t{self.counter}"

    def region(self, node: int, default: str) -> str:
        """Return the region in which a node is computed, where it runs least often."""
        depends = self.tape.depends[node]
        if not depends & (ROBOT | SAMPLE | STATE):
            return "entry"
        return default if depends & (SAMPLE | STATE) else "block"

    def argument(self, node: int, vector: int, region: str, scalar: bool = False) -> str:
        """Return the value of a node for one vector."""
        if not self.shared[node]:
            return self.values[node][vector]
        operation, kind = self.tape.operations[node], self.tape.types[node]
        if operation[0] == "const":
            return self._literal(node, scalar)
        value = self.values[node][0]
        if scalar or self.shape.lanes == 1:
            return value
        place = self.region(node, region)
        if (node, place) not in self.spread:
            vector_type, scalar_type = self.type(kind), _SCALAR[kind]
            first = self.put(place, f"insertelement {vector_type} poison, {scalar_type} {value}, i32 0")
            mask = f"<{self.shape.lanes} x i32> zeroinitializer"
            self.spread[node, place] = self.put(
                place, f"shufflevector {vector_type} {first}, {vector_type} poison, {mask}"
            )
        return self.spread[node, place]

    def _literal(self, node: int, scalar: bool) -> str:
        """Return a constant of the tape."""
        if (node, scalar) not in self.constants:
            _, kind, value = self.tape.operations[node]
            literal = f"0x{value:016X}" if kind == "f" else str(value).lower()  # true, false
            self.constants[node, scalar] = self.constant(kind, literal, scalar)
        return self.constants[node, scalar]

    def emit(self, target: int, default: str = "sample") -> None:
        """Write a node and the nodes that it needs."""
        todo = [target]
        while todo:
            node = todo[-1]
            operation = self.tape.operations[node]
            args = Rounds.of(self.tape, node).outer if operation[0] == "repeat" else operands(operation)
            if self._is_known(node):
                todo.pop()
            elif missing := [i for i in args if not self._is_known(i)]:
                todo += reversed(missing)
            else:
                todo.pop()
                self.values[node] = self._write(node, self.region(node, default))

    def _is_known(self, node: int) -> bool:
        """Return whether the value of a node can be an argument."""
        return node in self.values or self.tape.operations[node][0] == "const"

    def _write(self, node: int, region: str) -> list[str]:
        operation, kind = self.tape.operations[node], self.tape.types[node]
        name = operation[0]
        if name == "count":
            return ["%k"]
        if name in ("uniform", "sample"):
            base = "%uniforms" if name == "uniform" else "%at"
            place = self.put(region, f"getelementptr double, ptr {base}, i64 {operation[1]}")
            return [self.put(region, f"load double, ptr {place}, align 8")]
        if name in ("track", "row", "key"):
            base, first = "%block", self.vector_rows + (self.loop.rows if name == "key" else 0)
            if name == "track":
                base, first = "%keep", self.loop.outputs_kept
            offset = (first + operation[1]) * self.shape.width
            return [self.load(base, offset, u, region, kind) for u in self.vectors()]
        if name == "ring":
            return self._ring(node)
        if name == "repeat":
            return self._rounds(node)
        if name == "result":
            return self.results[operation[1]][operation[2]]
        shared = self.shared[node]
        return [self._operation(node, u, region, shared) for u in (range(1) if shared else self.vectors())]

    def _phi(self, name: str, kind: str, *branches: tuple[str, str]) -> str:
        """Write a value that depends on the previous block, and return its name."""
        words = ", ".join(f"[ {value}, %{block} ]" for value, block in branches)
        self.lines["sample"].append(f"  {name} = phi {kind} {words}")
        return name

    def _rounds(self, node: int) -> list[str]:
        """Write rounds, which end when no robot of the block needs another; finished robots do not change.

        The code skips all rounds if no robot needs one.
        """
        rounds, lines, vectors = Rounds.of(self.tape, node), self.lines["sample"], self.vectors()
        vector_type, truth = self.type("f"), self.type("b")
        first = [[self.argument(i, u, "sample") for u in vectors] for i in rounds.first]
        # Shared values are copied to all lanes before the rounds, not in each round.
        for i in rounds.outer:
            if self.shared[i] and self.tape.operations[i][0] != "const":
                self.argument(i, 0, "sample")
        entry, body, end = f"before{node}", f"round{node}", f"behind{node}"
        inner = [i for i in rounds.body if self.tape.operations[i][0] == "repeat"]
        last = f"behind{inner[-1]}" if inner else body  # the block in which a round ends
        lines += [f"  br label %{entry}", f"{entry}:"]
        skip = [self.argument(rounds.skip, u, "sample") for u in vectors]
        may_skip = self.tape.constant_of(rounds.skip) is None
        branch = f"label %{body}"
        if may_skip:
            branch = f"i1 {self._any_active(skip)}, {branch}, label %{end}"
        lines += [f"  br {branch}", f"{body}:"]
        names = [(f"{node}_{j}_{u}", values[u]) for j, values in enumerate(first) for u in vectors]
        for name, value in names:
            self._phi(f"%y{name}", vector_type, (value, entry), (f"%z{name}", last))
        for u in vectors:
            self._phi(f"%e{node}_{u}", truth, (skip[u], entry), (f"%d{node}_{u}", last))
        self._phi(f"%r{node}", "i64", ("1", entry), (f"%q{node}", last))
        self._round(node, rounds)
        lines += [f"  br i1 %m{node}, label %{body}, label %{end}", f"{end}:"]
        for name, value in names if may_skip else ():
            self._phi(f"%w{name}", vector_type, (value, entry), (f"%z{name}", last))
        letter = "w" if may_skip else "z"
        self.results[node] = [[f"%{letter}{node}_{j}_{u}" for u in vectors] for j in range(len(first))]
        return []

    def _round(self, node: int, rounds: Rounds) -> None:
        """Write one round, and the test for a further one."""
        lines, vectors = self.lines["sample"], self.vectors()
        vector_type, truth = self.type("f"), self.type("b")
        for i in rounds.body:
            name, *args = self.tape.operations[i]
            if name == "carry":
                self.values[i] = [f"%y{node}_{args[1]}_{u}" for u in vectors]
            elif name in ("repeat", "result"):
                self.values[i] = self._write(i, "sample")
            else:
                self.values[i] = [self._operation(i, u, "sample", False) for u in vectors]
        for j, i in enumerate(rounds.results):
            for u in vectors:
                value, name = self.argument(i, u, "sample"), f"{node}_{j}_{u}"
                choice = f"{truth} %e{node}_{u}, {vector_type} %y{name}, {vector_type} {value}"
                lines.append(f"  %z{name} = select {choice}")
        for u in vectors:
            value = self.argument(rounds.done, u, "sample")
            lines.append(f"  %d{node}_{u} = or {truth} %e{node}_{u}, {value}")
        any_active = self._any_active([f"%d{node}_{u}" for u in vectors])
        below_limit = self.put("sample", f"icmp slt i64 %r{node}, {rounds.most}")
        lines += [f"  %m{node} = and i1 {any_active}, {below_limit}", f"  %q{node} = add i64 %r{node}, 1"]

    def _any_active(self, masks: Sequence[str]) -> str:
        """Write a test for unfinished robots in a block, from vectors of truth values."""
        lanes, tests = self.shape.lanes, []
        for word in masks:
            if lanes > 1:
                word = self.put("sample", f"bitcast {self.type('b')} {word} to i{lanes}")
            tests.append(self.put("sample", f"icmp ne i{lanes} {word}, -1"))
        return reduce(lambda more, each: self.put("sample", f"or i1 {more}, {each}"), tests)

    def vectors(self) -> range:
        """Return the indices of the vectors."""
        return range(self.shape.vectors)

    def load(self, base: str, offset: int, vector: int, region: str, kind: str = "f") -> str:
        """Write an instruction that loads one vector of a row."""
        place = self.place(base, offset, vector, region)
        return self.put(region, f"load {self.type(kind)}, ptr {place}, align {8 * self.shape.lanes}")

    def place(self, base: str, offset: int, vector: int, region: str) -> str:
        """Write the address of one vector of a row."""
        return self.put(region, f"getelementptr double, ptr {base}, i64 {offset + vector * self.shape.lanes}")

    def store(self, value: str, place: str, kind: str = "f") -> str:
        """Return an instruction that stores one vector."""
        return f"  store {self.type(kind)} {value}, ptr {place}, align {8 * self.shape.lanes}"

    def _operation(self, node: int, vector: int, region: str, shared: bool) -> str:
        operation, kind = self.tape.operations[node], self.tape.types[node]
        name = operation[0]
        x = [self.argument(i, vector, region, shared) for i in operation[1:]]
        out, input_type = self.type(kind, shared), self.type(self.tape.types[operation[1]], shared)
        if name in _BINARY:
            return self.put(region, f"{_BINARY[name]} {out} {x[0]}, {x[1]}")
        if name in _COMPARISONS:
            return self.put(region, f"fcmp {_COMPARISONS[name]} {input_type} {x[0]}, {x[1]}")
        if name in ("max", "min"):
            truth = self.put(region, f"fcmp {'ogt' if name == 'max' else 'olt'} {out} {x[0]}, {x[1]}")
            return self.put(region, f"select {self.type('b', shared)} {truth}, {out} {x[0]}, {out} {x[1]}")
        if name == "select":
            truth = self.type("b", shared)
            if self.shared[operation[1]] and not shared:
                # One condition for all lanes needs no vector.
                truth, x[0] = "i1", self.argument(operation[1], vector, region, True)
            return self.put(region, f"select {truth} {x[0]}, {out} {x[1]}, {out} {x[2]}")
        if name in ("bits", "real"):
            return self.put(region, f"bitcast {input_type} {x[0]} to {out}")
        if name == "neg":
            return self.put(region, f"fneg {out} {x[0]}")
        if name == "not":
            return self.put(region, f"xor {out} {x[0]}, {self.constant('b', 'true', shared)}")
        if name == "abs":
            word_type = self.type("u", shared)
            word = self.put(region, f"bitcast {out} {x[0]} to {word_type}")
            word = self.put(region, f"and {word_type} {word}, {self.constant('u', str(2**63 - 1), shared)}")
            return self.put(region, f"bitcast {word_type} {word} to {out}")
        suffix = "f64" if shared or self.shape.lanes == 1 else f"v{self.shape.lanes}f64"
        return self.put(region, f"call {out} @llvm.sqrt.{suffix}({out} {x[0]})")

    def _ring(self, node: int) -> list[str]:
        """Write the output of a delay; its input is stored at the end of the sample."""
        _, number, samples, source = self.tape.operations[node]
        if samples not in self.rings:
            slot_in = self.put("sample", f"urem i64 %k, {samples}")
            is_early = self.put("sample", f"icmp ult i64 %k, {samples}")
            # Early samples return the first value, which is not overwritten before.
            slot_out = self.put("sample", f"select i1 {is_early}, i64 0, i64 {slot_in}")
            self.rings[samples] = slot_in, slot_out, self.put("sample", "icmp eq i64 %k, 0")
        slot_in, slot_out, first = self.rings[samples]
        offset = sum(ring.samples for ring in self.loop.rings[:number]) * self.shape.width
        base, values = [], []
        for slot in (slot_in, slot_out):
            row = self.put("sample", f"mul i64 {slot}, {self.shape.width}")
            index = self.put("sample", f"add i64 {row}, {offset}")
            base.append(self.put("sample", f"getelementptr double, ptr %ring, i64 {index}"))
        for u in self.vectors():
            value, kind = self.argument(source, u, "sample"), self.type("f")
            old = self.load(base[1], 0, u, "sample")
            values.append(self.put("sample", f"select i1 {first}, {kind} {value}, {kind} {old}"))
            self.ring_stores.append(self.store(value, self.place(base[0], 0, u, "sample")))
        return values


def text_of(loop: LoopTape, shape: Shape) -> str:
    """Return the LLVM module that runs a loop.

    Its function ``pinmobile_loop(blocks, begin, end, samples, count, uniforms, ring, counts, every, n,
    kept, start)`` runs the blocks from `begin` to before `end` of an array (blocks, rows, width): states,
    rows and keys of the robots. A row of `samples` contains t, the reference and the tables; `start` is the
    index of the first. The sizes of the n robots are counted every `every` samples in `counts`, (times,
    sizes, BINS). The values of each sample are in `kept`, (blocks, samples, numbers, width), followed by the
    robots' references if each has its own.
    """
    code = Code(loop, shape)
    for j, (state, _) in enumerate(loop.states):
        code.values[state] = [f"%s{j}_{u}" for u in code.vectors()]
    for j, node in enumerate(loop.table_nodes, loop.columns - len(loop.table_nodes)):
        place = code.put("sample", f"getelementptr double, ptr %at, i64 {j}")
        code.values[node] = [code.put("sample", f"load double, ptr {place}, align 8")]
    for ring in loop.rings:
        code.emit(ring.node)
    for node in ancestors(code.tape, loop.outputs):
        if code.tape.operations[node][0] == "repeat" and code.tape.depends[node] < ROUND:
            code.emit(node)  # in the part that every sample runs
    # In the order of the tape: operands of the next line are then still in registers.
    for node in ancestors(code.tape, [last for _, last in loop.states]):
        if code.tape.depends[node] < ROUND:
            code.emit(node)
    ends = [[code.argument(last, u, "sample") for u in code.vectors()] for _, last in loop.states]
    _store_records(code)
    code.lines["sample"] += code.ring_stores
    _write_bins(code)
    declarations = ["declare double @llvm.sqrt.f64(double)"]
    if shape.lanes > 1:
        vector_type = code.type("f")
        declarations.append(f"declare {vector_type} @llvm.sqrt.v{shape.lanes}f64({vector_type})")
    return "\n".join([*declarations, *_function(code, ends)])


def _store_records(code: Code) -> None:
    nodes = [node for _, nodes in code.loop.kept.values() for node in nodes]
    for j, node in enumerate(nodes):
        code.emit(node)
        for u in code.vectors():
            place = code.place("%keep", j * code.shape.width, u, "sample")
            code.lines["sample"].append(code.store(code.argument(node, u, "sample"), place))


def _write_bins(code: Code) -> None:
    """Write the computation of the bins of the sizes."""
    vtype, truth = code.type("u"), code.type("b")

    def number(x: int) -> str:
        return code.constant("u", str(x))

    for j, node in enumerate(code.loop.counted):
        code.emit(node, "count")
        for u in code.vectors():
            word = code.put("count", f"bitcast {code.type('f')} {code.argument(node, u, 'count')} to {vtype}")
            word = code.put("count", f"lshr {vtype} {word}, {number(SHIFT)}")
            word = code.put("count", f"sub {vtype} {word}, {number(FIRST - 1)}")
            for comparison, bound in (("slt", 0), ("sgt", BINS - 1)):
                over = code.put("count", f"icmp {comparison} {vtype} {word}, {number(bound)}")
                word = code.put("count", f"select {truth} {over}, {vtype} {number(bound)}, {vtype} {word}")
            place = code.place("%places", j * code.shape.width, u, "count")
            code.lines["count"].append(code.store(word, place, "u"))


def _function(code: Code, next_values: list[list[str]]) -> list[str]:
    loop, shape = code.loop, code.shape
    width, vector_type, align = shape.width, code.type("f"), 8 * shape.lanes
    rows = len(loop.states) + loop.rows + len(loop.keys)
    kept = loop.outputs_kept + loop.tracks
    loads, phis, stores = [], [], []
    for j in range(len(loop.states)):
        for u in code.vectors():
            name, place = f"%i{j}_{u}", f"%p{j}_{u}"
            loads.append(f"  {place} = getelementptr double, ptr %block, i64 {j * width + u * shape.lanes}")
            loads.append(f"  {name} = load {vector_type}, ptr {place}, align {align}")
            phis.append(f"  %s{j}_{u} = phi {vector_type} [ {name}, %each ], [ {next_values[j][u]}, %latch ]")
            stores.append(f"  store {vector_type} {next_values[j][u]}, ptr {place}, align {align}")
    return [
        # Otherwise the stack may not be aligned for vectors, which makes the code up to 20 % slower.
        f"define void @{ENTRY}(ptr noalias %blocks, i64 %begin, i64 %end, "
        "ptr noalias readonly %samples, i64 %count, ptr noalias readonly %uniforms, "
        "ptr noalias %ring, ptr noalias %counts, i64 %every, i64 %n, "
        f'ptr noalias %kept, i64 %start) alignstack(64) nounwind "prefer-vector-width"="512" '
        f'"min-legal-vector-width"="{64 * shape.lanes}" {{',
        "entry:",
        f"  %places = alloca [{max(1, len(loop.counted)) * width} x i64], align 64",
        *code.lines["entry"],
        "  br label %each",
        "each:",
        "  %b = phi i64 [ %begin, %entry ], [ %b1, %after ]",
        f"  %offset = mul i64 %b, {rows * width}",
        "  %block = getelementptr double, ptr %blocks, i64 %offset",
        f"  %size = mul i64 %count, {kept * width}",
        "  %before = mul i64 %b, %size",
        "  %mine = getelementptr double, ptr %kept, i64 %before",
        *loads,
        *code.lines["block"],
        "  br label %loop",
        "loop:",
        "  %j = phi i64 [ 0, %each ], [ %j1, %latch ]",
        "  %due = phi i64 [ 0, %each ], [ %due2, %latch ]",
        *phis,
        "  %k = add i64 %j, %start",
        f"  %row = mul i64 %j, {loop.columns}",
        "  %at = getelementptr double, ptr %samples, i64 %row",
        f"  %line = mul i64 %j, {kept * width}",
        "  %keep = getelementptr double, ptr %mine, i64 %line",
        *code.lines["sample"],
        *_count_loop(code),
        "latch:",
        "  %j1 = add i64 %j, 1",
        "  %due1 = add i64 %due, 1",
        "  %full = icmp eq i64 %due1, %every",
        "  %due2 = select i1 %full, i64 0, i64 %due1",
        "  %again = icmp slt i64 %j1, %count",
        "  br i1 %again, label %loop, label %after",
        "after:",
        *stores,
        "  %b1 = add i64 %b, 1",
        "  %more = icmp slt i64 %b1, %end",
        "  br i1 %more, label %each, label %done",
        "done:",
        "  ret void",
        "}",
    ]


def _count_loop(code: Code) -> list[str]:
    """Return the loop that counts sizes, one robot after the other."""
    count, width = len(code.loop.counted), code.shape.width
    if not count:
        return ["  br label %latch"]
    lines = [
        "  %now = icmp eq i64 %due, 0",
        "  br i1 %now, label %bins, label %latch",
        "bins:",
        *code.lines["count"],
        f"  %first = mul i64 %b, {width}",
        "  %left = sub i64 %n, %first",
        f"  %few = icmp slt i64 %left, {width}",
        f"  %lanes = select i1 %few, i64 %left, i64 {width}",
        "  %time = udiv i64 %j, %every",
        f"  %table = mul i64 %time, {count * BINS}",
        "  br label %robot",
        "robot:",
        "  %lane = phi i64 [ 0, %bins ], [ %lane1, %robot ]",
    ]
    for j in range(count):
        lines += [
            f"  %ca{j} = add i64 %lane, {j * width}",
            f"  %cb{j} = getelementptr i64, ptr %places, i64 %ca{j}",
            f"  %cc{j} = load i64, ptr %cb{j}, align 8",
            f"  %cd{j} = add i64 %cc{j}, {j * BINS}",
            f"  %ce{j} = add i64 %cd{j}, %table",
            f"  %cf{j} = getelementptr i32, ptr %counts, i64 %ce{j}",
            f"  %cg{j} = load i32, ptr %cf{j}, align 4",
            f"  %ch{j} = add i32 %cg{j}, 1",
            f"  store i32 %ch{j}, ptr %cf{j}, align 4",
        ]
    return [
        *lines,
        "  %lane1 = add i64 %lane, 1",
        "  %others = icmp slt i64 %lane1, %lanes",
        "  br i1 %others, label %robot, label %latch",
    ]
