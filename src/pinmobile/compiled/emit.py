"""Text of a loop for LLVM: blocks of robots in vectors, with the time loop inside.

The state of a block stays in registers from sample to sample. Numbers that all robots share are computed once
for all lanes, numbers of a robot before its first sample. The code has no branches except loops. Every
operation rounds once, and none are contracted, so that the bits are those of `tape.evaluated`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

from pinmobile.compiled.folding import ROBOT, ROUND, SAMPLE, STATE
from pinmobile.compiled.tape import LoopTape, Rounds, needed, operands

ENTRY = "pinmobile_loop"

SHIFT = 47  # shift of a size's bits that leaves the exponent and 5 bits of the fraction
_OCTAVES = 44
FIRST = (1023 - 34) << (52 - SHIFT)  # bin of 2^-34
BINS = 32 * _OCTAVES + 2  # including one bin below and one above

_BINARY = {name: f"f{name}" for name in ("add", "sub", "mul", "div")}  # of floats
_BINARY |= {f"i{name}": name for name in ("add", "mul", "xor", "and", "or")}  # of words
_BINARY |= {name: name for name in ("and", "or", "xor", "shl")} | {"shr": "lshr"}
_COMPARED = {"gt": "ogt", "ge": "oge", "lt": "olt", "le": "ole", "eq": "oeq", "ne": "une"}
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
        self.late: list[str] = []
        self.rings: dict[int, tuple[str, str, str]] = {}
        self.results: dict[int, list[list[str]]] = {}
        self.named = 0
        self.constants: dict[tuple[int, bool], str] = {}
        self.shared = [not depends & (ROBOT | STATE) for depends in self.tape.depends]
        lanes = shape.lanes
        self.whole = {k: one if lanes == 1 else f"<{lanes} x {one}>" for k, one in _SCALAR.items()}

    def type(self, kind: str, scalar: bool = False) -> str:
        """Return LLVM's type of a value: a vector, unless all lanes share the value."""
        return _SCALAR[kind] if scalar else self.whole[kind]

    def constant(self, kind: str, literal: str, scalar: bool = False) -> str:
        """Return a constant, repeated for each lane."""
        lanes = self.shape.lanes
        if scalar or lanes == 1:
            return literal
        return f"<{', '.join([f'{_SCALAR[kind]} {literal}'] * lanes)}>"

    def put(self, region: str, text: str) -> str:
        """Write an instruction, and return the name of its value."""
        self.named += 1
        self.lines[region].append(f"  %t{self.named} = {text}")
        return f"%t{self.named}"

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
        where = self.region(node, region)
        if (node, where) not in self.spread:
            whole, one = self.type(kind), _SCALAR[kind]
            first = self.put(where, f"insertelement {whole} poison, {one} {value}, i32 0")
            mask = f"<{self.shape.lanes} x i32> zeroinitializer"
            self.spread[node, where] = self.put(
                where, f"shufflevector {whole} {first}, {whole} poison, {mask}"
            )
        return self.spread[node, where]

    def _literal(self, node: int, scalar: bool) -> str:
        """Return a constant of the tape."""
        if (node, scalar) not in self.constants:
            _, kind, value = self.tape.operations[node]
            literal = f"0x{value:016X}" if kind == "f" else str(value).lower()  # true, false
            self.constants[node, scalar] = self.constant(kind, literal, scalar)
        return self.constants[node, scalar]

    def emit(self, wanted: int, default: str = "sample") -> None:
        """Write a node and the nodes that it needs."""
        todo = [wanted]
        while todo:
            node = todo[-1]
            operation = self.tape.operations[node]
            given = Rounds.of(self.tape, node).outside if operation[0] == "repeat" else operands(operation)
            if self._is_known(node):
                todo.pop()
            elif missing := [i for i in given if not self._is_known(i)]:
                todo += reversed(missing)
            else:
                todo.pop()
                self.values[node] = self._written(node, self.region(node, default))

    def _is_known(self, node: int) -> bool:
        """Return whether the value of a node can be an argument."""
        return node in self.values or self.tape.operations[node][0] == "const"

    def _written(self, node: int, region: str) -> list[str]:
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
            at = (first + operation[1]) * self.shape.width
            return [self.load(base, at, u, region, kind) for u in self.vectors()]
        if name == "ring":
            return self._ring(node)
        if name == "repeat":
            return self._rounds(node)
        if name == "result":
            return self.results[operation[1]][operation[2]]
        shared = self.shared[node]
        return [self._operation(node, u, region, shared) for u in (range(1) if shared else self.vectors())]

    def _phi(self, name: str, kind: str, *ways: tuple[str, str]) -> str:
        """Write a value that depends on the previous block, and return its name."""
        listed = ", ".join(f"[ {value}, %{block} ]" for value, block in ways)
        self.lines["sample"].append(f"  {name} = phi {kind} {listed}")
        return name

    def _rounds(self, node: int) -> list[str]:
        """Write rounds, which end when no robot of the block needs another; finished robots do not change.

        The code skips all rounds if no robot needs one.
        """
        rounds, lines, vectors = Rounds.of(self.tape, node), self.lines["sample"], self.vectors()
        whole, truth = self.type("f"), self.type("b")
        first = [[self.argument(i, u, "sample") for u in vectors] for i in rounds.first]
        # Shared values are copied to all lanes before the rounds, not in each round.
        for i in rounds.outside:
            if self.shared[i] and self.tape.operations[i][0] != "const":
                self.argument(i, 0, "sample")
        before, inside, behind = f"before{node}", f"round{node}", f"behind{node}"
        nested = [i for i in rounds.body if self.tape.operations[i][0] == "repeat"]
        last = f"behind{nested[-1]}" if nested else inside  # the block in which a round ends
        lines += [f"  br label %{before}", f"{before}:"]
        none = [self.argument(rounds.settled, u, "sample") for u in vectors]
        may_skip = self.tape.known(rounds.settled) is None
        way = f"label %{inside}"
        if may_skip:
            way = f"i1 {self._some_left(none)}, {way}, label %{behind}"
        lines += [f"  br {way}", f"{inside}:"]
        names = [(f"{node}_{j}_{u}", values[u]) for j, values in enumerate(first) for u in vectors]
        for name, value in names:
            self._phi(f"%y{name}", whole, (value, before), (f"%z{name}", last))
        for u in vectors:
            self._phi(f"%e{node}_{u}", truth, (none[u], before), (f"%d{node}_{u}", last))
        self._phi(f"%r{node}", "i64", ("1", before), (f"%q{node}", last))
        self._round(node, rounds)
        lines += [f"  br i1 %m{node}, label %{inside}, label %{behind}", f"{behind}:"]
        for name, value in names if may_skip else ():
            self._phi(f"%w{name}", whole, (value, before), (f"%z{name}", last))
        letter = "w" if may_skip else "z"
        self.results[node] = [[f"%{letter}{node}_{j}_{u}" for u in vectors] for j in range(len(first))]
        return []

    def _round(self, node: int, rounds: Rounds) -> None:
        """Write one round, and the test for a further one."""
        lines, vectors = self.lines["sample"], self.vectors()
        whole, truth = self.type("f"), self.type("b")
        for i in rounds.body:
            name, *given = self.tape.operations[i]
            if name == "carry":
                self.values[i] = [f"%y{node}_{given[1]}_{u}" for u in vectors]
            elif name in ("repeat", "result"):
                self.values[i] = self._written(i, "sample")
            else:
                self.values[i] = [self._operation(i, u, "sample", False) for u in vectors]
        for j, i in enumerate(rounds.following):
            for u in vectors:
                value, name = self.argument(i, u, "sample"), f"{node}_{j}_{u}"
                chosen = f"{truth} %e{node}_{u}, {whole} %y{name}, {whole} {value}"
                lines.append(f"  %z{name} = select {chosen}")
        for u in vectors:
            value = self.argument(rounds.done, u, "sample")
            lines.append(f"  %d{node}_{u} = or {truth} %e{node}_{u}, {value}")
        more = self._some_left([f"%d{node}_{u}" for u in vectors])
        under = self.put("sample", f"icmp slt i64 %r{node}, {rounds.most}")
        lines += [f"  %m{node} = and i1 {more}, {under}", f"  %q{node} = add i64 %r{node}, 1"]

    def _some_left(self, done: Sequence[str]) -> str:
        """Write a test for unfinished robots in a block, from vectors of truth values."""
        lanes, left = self.shape.lanes, []
        for word in done:
            if lanes > 1:
                word = self.put("sample", f"bitcast {self.type('b')} {word} to i{lanes}")
            left.append(self.put("sample", f"icmp ne i{lanes} {word}, -1"))
        return reduce(lambda more, each: self.put("sample", f"or i1 {more}, {each}"), left)

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
        own, first = self.type(kind, shared), self.type(self.tape.types[operation[1]], shared)
        if name in _BINARY:
            return self.put(region, f"{_BINARY[name]} {own} {x[0]}, {x[1]}")
        if name in _COMPARED:
            return self.put(region, f"fcmp {_COMPARED[name]} {first} {x[0]}, {x[1]}")
        if name in ("max", "min"):
            truth = self.put(region, f"fcmp {'ogt' if name == 'max' else 'olt'} {own} {x[0]}, {x[1]}")
            return self.put(region, f"select {self.type('b', shared)} {truth}, {own} {x[0]}, {own} {x[1]}")
        if name == "select":
            truth = self.type("b", shared)
            if self.shared[operation[1]] and not shared:
                # One condition for all lanes needs no vector.
                truth, x[0] = "i1", self.argument(operation[1], vector, region, True)
            return self.put(region, f"select {truth} {x[0]}, {own} {x[1]}, {own} {x[2]}")
        if name in ("bits", "real"):
            return self.put(region, f"bitcast {first} {x[0]} to {own}")
        if name == "neg":
            return self.put(region, f"fneg {own} {x[0]}")
        if name == "not":
            return self.put(region, f"xor {own} {x[0]}, {self.constant('b', 'true', shared)}")
        if name == "abs":
            whole = self.type("u", shared)
            word = self.put(region, f"bitcast {own} {x[0]} to {whole}")
            word = self.put(region, f"and {whole} {word}, {self.constant('u', str(2**63 - 1), shared)}")
            return self.put(region, f"bitcast {whole} {word} to {own}")
        suffix = "f64" if shared or self.shape.lanes == 1 else f"v{self.shape.lanes}f64"
        return self.put(region, f"call {own} @llvm.sqrt.{suffix}({own} {x[0]})")

    def _ring(self, node: int) -> list[str]:
        """Write the output of a delay; its input is stored at the end of the sample."""
        _, number, samples, pushed = self.tape.operations[node]
        if samples not in self.rings:
            now = self.put("sample", f"urem i64 %k, {samples}")
            early = self.put("sample", f"icmp ult i64 %k, {samples}")
            # Early samples return the first value, which is not overwritten before.
            then = self.put("sample", f"select i1 {early}, i64 0, i64 {now}")
            self.rings[samples] = now, then, self.put("sample", "icmp eq i64 %k, 0")
        now, then, first = self.rings[samples]
        offset = sum(ring.samples for ring in self.loop.rings[:number]) * self.shape.width
        base, found = [], []
        for slot in (now, then):
            row = self.put("sample", f"mul i64 {slot}, {self.shape.width}")
            at = self.put("sample", f"add i64 {row}, {offset}")
            base.append(self.put("sample", f"getelementptr double, ptr %ring, i64 {at}"))
        for u in self.vectors():
            value, whole = self.argument(pushed, u, "sample"), self.type("f")
            old = self.load(base[1], 0, u, "sample")
            found.append(self.put("sample", f"select i1 {first}, {whole} {value}, {whole} {old}"))
            self.late.append(self.store(value, self.place(base[0], 0, u, "sample")))
        return found


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
    for j, (now, _) in enumerate(loop.states):
        code.values[now] = [f"%s{j}_{u}" for u in code.vectors()]
    for j, node in enumerate(loop.tabled, loop.columns - len(loop.tabled)):
        place = code.put("sample", f"getelementptr double, ptr %at, i64 {j}")
        code.values[node] = [code.put("sample", f"load double, ptr {place}, align 8")]
    for ring in loop.rings:
        code.emit(ring.node)
    for node in needed(code.tape, loop.outputs):
        if code.tape.operations[node][0] == "repeat" and code.tape.depends[node] < ROUND:
            code.emit(node)  # in the part that every sample runs
    # In the order of the tape: operands of the next line are then still in registers.
    for node in needed(code.tape, [after for _, after in loop.states]):
        if code.tape.depends[node] < ROUND:
            code.emit(node)
    following = [[code.argument(after, u, "sample") for u in code.vectors()] for _, after in loop.states]
    _keep(code)
    code.lines["sample"] += code.late
    _count_places(code)
    declared = ["declare double @llvm.sqrt.f64(double)"]
    if shape.lanes > 1:
        whole = code.type("f")
        declared.append(f"declare {whole} @llvm.sqrt.v{shape.lanes}f64({whole})")
    return "\n".join([*declared, *_function(code, following)])


def _keep(code: Code) -> None:
    nodes = [node for _, nodes in code.loop.kept.values() for node in nodes]
    for j, node in enumerate(nodes):
        code.emit(node)
        for u in code.vectors():
            place = code.place("%keep", j * code.shape.width, u, "sample")
            code.lines["sample"].append(code.store(code.argument(node, u, "sample"), place))


def _count_places(code: Code) -> None:
    """Write the computation of the bins of the sizes."""
    whole, truth = code.type("u"), code.type("b")

    def number(x: int) -> str:
        return code.constant("u", str(x))

    for j, node in enumerate(code.loop.counted):
        code.emit(node, "count")
        for u in code.vectors():
            word = code.put("count", f"bitcast {code.type('f')} {code.argument(node, u, 'count')} to {whole}")
            word = code.put("count", f"lshr {whole} {word}, {number(SHIFT)}")
            word = code.put("count", f"sub {whole} {word}, {number(FIRST - 1)}")
            for compared, bound in (("slt", 0), ("sgt", BINS - 1)):
                beyond = code.put("count", f"icmp {compared} {whole} {word}, {number(bound)}")
                word = code.put("count", f"select {truth} {beyond}, {whole} {number(bound)}, {whole} {word}")
            place = code.place("%places", j * code.shape.width, u, "count")
            code.lines["count"].append(code.store(word, place, "u"))


def _function(code: Code, following: list[list[str]]) -> list[str]:
    loop, shape = code.loop, code.shape
    width, whole, align = shape.width, code.type("f"), 8 * shape.lanes
    rows = len(loop.states) + loop.rows + len(loop.keys)
    kept = loop.outputs_kept + loop.tracks
    begun, carried, ended = [], [], []
    for j in range(len(loop.states)):
        for u in code.vectors():
            name, place = f"%i{j}_{u}", f"%p{j}_{u}"
            begun.append(f"  {place} = getelementptr double, ptr %block, i64 {j * width + u * shape.lanes}")
            begun.append(f"  {name} = load {whole}, ptr {place}, align {align}")
            carried.append(f"  %s{j}_{u} = phi {whole} [ {name}, %each ], [ {following[j][u]}, %latch ]")
            ended.append(f"  store {whole} {following[j][u]}, ptr {place}, align {align}")
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
        *begun,
        *code.lines["block"],
        "  br label %loop",
        "loop:",
        "  %j = phi i64 [ 0, %each ], [ %j1, %latch ]",
        "  %due = phi i64 [ 0, %each ], [ %due2, %latch ]",
        *carried,
        "  %k = add i64 %j, %start",
        f"  %row = mul i64 %j, {loop.columns}",
        "  %at = getelementptr double, ptr %samples, i64 %row",
        f"  %line = mul i64 %j, {kept * width}",
        "  %keep = getelementptr double, ptr %mine, i64 %line",
        *code.lines["sample"],
        *_counting(code),
        "latch:",
        "  %j1 = add i64 %j, 1",
        "  %due1 = add i64 %due, 1",
        "  %full = icmp eq i64 %due1, %every",
        "  %due2 = select i1 %full, i64 0, i64 %due1",
        "  %again = icmp slt i64 %j1, %count",
        "  br i1 %again, label %loop, label %after",
        "after:",
        *ended,
        "  %b1 = add i64 %b, 1",
        "  %more = icmp slt i64 %b1, %end",
        "  br i1 %more, label %each, label %done",
        "done:",
        "  ret void",
        "}",
    ]


def _counting(code: Code) -> list[str]:
    """Return the loop that counts sizes, one robot after the other."""
    counted, width = len(code.loop.counted), code.shape.width
    if not counted:
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
        f"  %table = mul i64 %time, {counted * BINS}",
        "  br label %robot",
        "robot:",
        "  %lane = phi i64 [ 0, %bins ], [ %lane1, %robot ]",
    ]
    for j in range(counted):
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
