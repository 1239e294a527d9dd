"""C of the tape of our own loop, by gcc's vectors: what a C compiler makes of the same operations.

Blocks, threads and the rest of an ensemble are ours; what is replaced is the machine code.
"""

import copy
import ctypes
import struct
import subprocess
import tempfile
from functools import lru_cache
from math import isfinite
from pathlib import Path

from arm_fleet import ArmFleet
from fleet import Run

from pinmobile.compiled import BINS, FIRST, SHIFT, LoopTape, Program, Shape, Target
from pinmobile.compiled.folding import ROBOT, SAMPLE, STATE
from pinmobile.compiled.tape import needed

from .of_pinmobile import kernel

LANES = 8
FLAGS = ("-std=gnu11", "-O2", "-march=native", "-mprefer-vector-width=512", "-ffp-contract=fast")
MATH = ("-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared", "-w")
BINARY = {
    **{"add": "+", "sub": "-", "mul": "*", "div": "/", "iadd": "+", "imul": "*"},
    **{"ixor": "^", "iand": "&", "ior": "|", "shl": "<<", "shr": ">>", "and": "&", "or": "|", "xor": "^"},
    **{"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "eq": "==", "ne": "!="},
}
HEAD = f"""#include <math.h>
#include <stdint.h>
typedef double F __attribute__((vector_size({8 * LANES})));
typedef uint64_t U __attribute__((vector_size({8 * LANES})));
typedef int64_t B __attribute__((vector_size({8 * LANES})));
#define ALL(x) {{{", ".join(["x"] * LANES)}}}
#define PICK(type, m, x, y) (type)(((U)(m) & (U)(x)) | (~(U)(m) & (U)(y)))
void loop(double *restrict blocks, int64_t begin, int64_t end, const double *restrict samples, int64_t count,
          const double *restrict uniforms, double *restrict ring, int32_t *restrict counts, int64_t every,
          int64_t n, double *restrict kept) {{"""


def rollout(fleet: ArmFleet) -> Run:
    """Build the C first."""
    return kernel(fleet, replaced)


def replaced(tape: LoopTape) -> Program:
    """Return the program with the machine code of a C compiler."""
    program = copy.copy(Program(tape, Target.here(), Shape(LANES, 1)))
    program.function = compiled(source(tape))
    return program


@lru_cache(maxsize=4)
def compiled(text: str) -> ctypes._CFuncPtr:
    with tempfile.TemporaryDirectory() as folder:
        code, library = Path(folder) / "loop.c", Path(folder) / "loop.so"
        code.write_text(text)
        command = ["cc", *FLAGS, *MATH, "-o", str(library), str(code), "-lm"]
        subprocess.run(command, capture_output=True, text=True, check=True)
        found = ctypes.CDLL(str(library)).loop
    pointer, whole = ctypes.c_void_p, ctypes.c_int64
    first, last = (pointer, whole, whole, pointer, whole), (whole, whole, pointer)
    found.argtypes = (*first, pointer, pointer, pointer, *last)
    found.restype = None
    return found


def source(loop: LoopTape) -> str:
    """Return C for a loop without delays, noise and kept samples."""
    if loop.rings or loop.keys or loop.kept or loop.tracks:
        raise NotImplementedError("delays, noise and samples that are kept")
    tape, states, rows = loop.tape, len(loop.states), len(loop.states) + loop.rows
    after = [node for _, node in loop.states]
    stepping = set(needed(tape, after))
    regions: dict[str, list[str]] = {"entry": [], "block": [], "sample": [], "count": []}
    given = {now: f"s{j}" for j, (now, _) in enumerate(loop.states)}
    tabled = dict(zip(loop.tabled, range(loop.columns - len(loop.tabled), loop.columns), strict=True))
    for i in needed(tape, [*after, *loop.counted]):
        depends, place = tape.depends[i], "sample" if i in stepping else "count"
        if not depends & (ROBOT | SAMPLE | STATE):
            place = "entry"
        elif not depends & (SAMPLE | STATE):
            place = "block"
        kind, shared = tape.types[i].upper(), not depends & (ROBOT | STATE)
        if i in given:
            regions[place].append(f"const {kind} t{i} = {given[i]};")
            continue
        value = f"at[{tabled[i]}]" if i in tabled else expression(loop, i, shared, states)
        if shared:
            scalar = {"F": "double", "U": "uint64_t", "B": "int64_t"}[kind]
            regions[place] += [f"const {scalar} o{i} = {value};", f"const {kind} t{i} = ALL(o{i});"]
        else:
            regions[place].append(f"const {kind} t{i} = {value};")
    bins = [
        line
        for j, node in enumerate(loop.counted)
        for line in (
            f"B w{j} = (B)((U)t{node} >> {SHIFT}) - {FIRST - 1};",
            f"w{j} = PICK(B, w{j} < 0, (B)ALL(0), w{j});",
            f"w{j} = PICK(B, w{j} > {BINS - 1}, (B)ALL({BINS - 1}), w{j});",
            f"for (int64_t i = 0; i < few; i++) table[{j * BINS} + w{j}[i]]++;",
        )
    ]
    lines = [
        HEAD,
        *regions["entry"],
        "for (int64_t b = begin; b < end; b++) {",
        f"double *block = blocks + b * {rows * LANES};",
        f"int64_t due = 0, few = n - b * {LANES} < {LANES} ? n - b * {LANES} : {LANES};",
        *(f"F s{j} = *(F *)(block + {j * LANES});" for j in range(states)),
        *regions["block"],
        "for (int64_t k = 0; k < count; k++) {",
        f"const double *at = samples + k * {loop.columns};",
        *regions["sample"],
        "if (due == 0) {",
        f"int32_t *table = counts + k / every * {len(loop.counted) * BINS};",
        *regions["count"],
        *bins,
        "}",
        "due = due + 1 == every ? 0 : due + 1;",
        *(f"s{j} = t{node};" for j, node in enumerate(after)),
        "}",
        *(f"*(F *)(block + {j * LANES}) = s{j};" for j in range(states)),
        "}}",
    ]
    return "\n".join(lines)


def expression(loop: LoopTape, i: int, shared: bool, states: int) -> str:
    """Return a node's value in C: of one number where all robots share it, else of a vector."""
    operation, tape = loop.tape.operations[i], loop.tape
    name = operation[0]
    if name == "const":
        return literal(tape.types[i], operation[2])
    if name == "count":
        return "k"
    if name in ("uniform", "sample"):
        return f"{'uniforms' if name == 'uniform' else 'at'}[{operation[1]}]"
    if name == "row":
        return f"*(F *)(block + {(states + operation[1]) * LANES})"
    x = [f"{'o' if shared else 't'}{j}" for j in operation[1:]]
    if name in BINARY:
        found = f"{x[0]} {BINARY[name]} {x[1]}"
        return f"-({found})" if shared and tape.types[i] == "b" and tape.types[operation[1]] == "f" else found
    if name in ("max", "min"):
        sign = ">" if name == "max" else "<"
        return (
            f"{x[0]} {sign} {x[1]} ? {x[0]} : {x[1]}"
            if shared
            else f"PICK(F, {x[0]} {sign} {x[1]}, {x[0]}, {x[1]})"
        )
    if name == "select":
        kind = tape.types[i].upper()
        return f"{x[0]} ? {x[1]} : {x[2]}" if shared else f"PICK({kind}, {x[0]}, {x[1]}, {x[2]})"
    if name in ("bits", "real") and not shared:
        return f"({tape.types[i].upper()}){x[0]}"
    if name == "bits":
        return f"((union {{double d; uint64_t u;}}){{.d = {x[0]}}}).u"
    if name == "real":
        return f"((union {{uint64_t u; double d;}}){{.u = {x[0]}}}).d"
    if name in ("neg", "not"):
        return f"{'-' if name == 'neg' else '~'}{x[0]}"
    if name == "abs":
        return f"fabs({x[0]})" if shared else f"(F)((U){x[0]} & (INT64_MAX - (U)ALL(0)))"
    if shared:
        return f"sqrt({x[0]})"
    return "{" + ", ".join(f"sqrt({x[0]}[{lane}])" for lane in range(LANES)) + "}"


def literal(kind: str, bits: int) -> str:
    """Return a constant in C."""
    if kind == "f":
        value = struct.unpack("<d", struct.pack("<Q", bits))[0]
        return (
            value.hex()
            if isfinite(value)
            else {"inf": "INFINITY", "-inf": "-INFINITY"}.get(str(value), "NAN")
        )
    return f"{bits}ULL" if kind == "u" else str(-int(bits))
