"""Files of exported code: header, source, test program, CMakeLists.txt and README."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import COUNT
from pinmobile.export._code import Code
from pinmobile.export._law import Law, Member

_SAMPLES = 64  # of the test program
_TOLERANCE = 1e-4  # of single precision, relative to the largest result


class Project:
    """Texts of the files of a law.

    Parameters
    ----------
    law : Law
        Exported law.
    name : str
        Prefix of all names.
    single : bool
        Whether numbers have single precision.
    table : ndarray, shape (N + 1, columns), optional
        Reference (q, v, a) at the samples of a trajectory.
    title : str
        One line that names the parts.
    version : str
        Version of the library.
    """

    def __init__(
        self, law: Law, name: str, *, single: bool, table: Array | None, title: str, version: str
    ) -> None:
        self.law, self.name, self.single, self.table = law, name, single, table
        self.title, self.version = title, version
        self.code = self._code()
        self.body = self._body()
        kept = "\n".join([title, version, *self._types(), self.body])
        self.digest = hashlib.sha256(kept.encode()).hexdigest()[:16]

    def files(self) -> dict[str, str]:
        """Return the texts by file name."""
        name = self.name
        return {
            f"{name}.h": self._header(),
            f"{name}.c": self._source(),
            f"{name}_test.c": self._test(),
            "CMakeLists.txt": self._cmake(),
            "README.md": self._readme(),
        }

    def _code(self) -> Code:
        law, tape = self.law, self.law.tape
        places: dict[Any, str] = dict(law.places)
        places[COUNT] = "(uint64_t)memory->k"
        code = Code(tape, places, law.constants, prefix=self.name, single=self.single)
        code.write([*(node for _, node in law.outputs), *(ring.pushed for ring in law.rings)])
        return code

    def _number(self, x: float) -> str:
        return self.code.literal("f", x)

    # The interface

    def _struct(self, what: str, members: Sequence[Member], comment: str) -> list[str]:
        """Return the lines of a struct, with names and units of its entries."""
        if not members:
            return []
        lines = [f"/* {comment} */", "typedef struct {"]
        for one in members:
            lines += [f"    {line}" for line in _entries(one)]
            lines.append(f"    {self.name}_real {one.name}[{len(one)}];")
        return [*lines, f"}} {self.name}_{what};", ""]

    def _types(self) -> list[str]:
        law, name = self.law, self.name
        real = "float" if self.single else "double"
        lines = [f"typedef {real} {name}_real;", ""]
        if not law.is_plant:
            lines += self._struct("reference", law.reference, "Reference of a sample.")
        lines += self._struct("parameters", law.parameters, "Numbers that may change between two samples.")
        lines += self._struct("signals", law.signals, "Signals of the last sample.")
        lines += [
            "/* Memory from sample to sample: one for each robot. */",
            "typedef struct {",
            f"    {name}_real t; /* time of the last sample [s] */",
            "    uint32_t k; /* number of samples, at most UINT32_MAX */",
        ]
        for one in law.states if law.is_plant else ():
            lines += [f"    {line}" for line in _entries(one)]
            lines.append(f"    {name}_real {one.name}[{len(one)}];")
        for one in law.memory:
            lines.append(f"    {name}_real {one.name}[{len(one)}]; /* {one.entries[0][0]} */")
        for ring in law.rings:
            lines.append(f"    {name}_real delay_{ring.node}[{ring.samples}];")
        lines += [f"    uint32_t at_{n};" for n in self._delays()]
        lines += [f"    {name}_parameters parameters;"] if law.parameters else []
        lines += [f"    {name}_signals signals;"] if law.signals else []
        return [*lines, f"}} {name}_memory;"]

    def _delays(self) -> list[int]:
        return sorted({ring.samples for ring in self.law.rings})

    def _step(self) -> str:
        name, law = self.name, self.law
        if law.is_plant:
            given = f"const {name}_real u[{len(law.u)}]"
        else:
            arrays = ", ".join(f"const {name}_real {one.name}[{len(one)}]" for one in law.states)
            given = f"{arrays}, const {name}_reference *reference"
        last = "" if law.is_plant else f", {name}_real u[{len(law.u)}]"
        return f"{name}_status {name}_step({name}_real t, {given}, {name}_memory *memory{last})"

    def _header(self) -> str:
        name, law = self.name, self.law
        guard, upper = f"{name.upper()}_H", name.upper()
        dt = law.context.dt
        lines = [
            f"/* {self.title}: one sample in C99.",
            f"   Made by pinmobile {self.version}; hash of the content: {self.digest}. */",
            f"#ifndef {guard}",
            f"#define {guard}",
            "",
            "#include <stdint.h>",
            "",
            "#ifdef __cplusplus",
            'extern "C" {',
            "#endif",
            "",
            f'#define {upper}_HASH "{self.digest}"',
            f"#define {upper}_DT {self._number(dt)} /* time step [s]: call the step every {dt:g} s */",
            "",
            *self._types(),
            "",
            "/* Result of a step. If it is not OK, memory and output are as before the call. */",
            "typedef enum {",
            f"    {upper}_OK = 0,",
            f"    {upper}_NOT_FINITE = 1, /* an argument or a result is NaN or infinite */",
            f"    {upper}_STALE = 2 /* t is not later than the time of the sample before */",
            f"}} {name}_status;",
            "",
            "/* Begin: the memory before the first sample. */",
            f"void {name}_init({name}_memory *memory);",
            "",
        ]
        if law.is_plant:
            lines += [
                "/* Advance the plant by one time step. Arguments:",
                "   t: time [s]",
                *_argument(law.u),
                "   memory->q, memory->v: state before and after the step */",
            ]
        else:
            lines += [
                "/* Compute the input of one sample. Arguments:",
                "   t: time of the measurement [s]",
                *(line for one in law.states for line in _argument(one)),
                *_argument(law.u),
                "   The input is within the limits of the plant. */",
            ]
        lines += [f"{self._step()};", ""]
        if law.parameters:
            kinds = "default", "lower", "upper"
            lines += ["/* Default, smallest and largest values of the parameters; infinite without a bound. */"]
            lines += [f"extern const {name}_parameters {name}_{kind};" for kind in kinds]
            lines += [
                "",
                "/* Return 1 if all parameters are within their bounds, else 0. */",
                f"int {name}_are_valid(const {name}_parameters *parameters);",
                "",
            ]
        if self.table is not None:
            lines += [
                "/* Compute the reference at a time, by interpolation of order 5 between samples of the trajectory:",
                "   position, velocity and acceleration are continuous. After the end, the reference rests. */",
                f"void {name}_reference_at({name}_real t, {name}_reference *reference);",
                "",
            ]
        lines += ["#ifdef __cplusplus", "}", "#endif", "", f"#endif /* {guard} */", ""]
        return "\n".join(lines)

    # The source

    def _source(self) -> str:
        head = [
            f"/* {self.title}: one sample in C99, see {self.name}.h.",
            f"   Made by pinmobile {self.version}; hash of the content: {self.digest}. */",
            f'#include "{self.name}.h"',
            "",
            "#include <float.h>",
            "#include <math.h>",
            "",
            "#if !defined(FLT_EVAL_METHOD) || FLT_EVAL_METHOD != 0",
            "#error each operation must round to its own type: on x86, compile for SSE2",
            "#endif",
            "#ifdef __FAST_MATH__",
            "#error compile without -ffast-math, which changes the order of operations",
            "#endif",
            "/* GCC has no such pragma: compile with -ffp-contract=off. */",
            "#if !defined(__GNUC__) || defined(__clang__)",
            "#pragma STDC FP_CONTRACT OFF",
            "#endif",
            "",
        ]
        return "\n".join(head) + self.body

    def _body(self) -> str:
        name, law, code = self.name, self.law, self.code
        real = f"{name}_real"
        blocks = [*self._helpers(), *self._elementary()]
        if law.parameters:
            blocks += self._bounds()
        if len(law.rows):
            blocks.append(self._array("rows", law.rows))
        if self.table is not None:
            blocks += [self._array("table", self.table), self._interpolation()]
        starts = [*law.memory, *(law.states if law.is_plant else ())]
        lines = [f"void {name}_init({name}_memory *memory)", "{"]
        lines += ["    memory->t = 0;", "    memory->k = 0;"]
        for one in starts:
            lines += [f"    memory->{one.name}[{i}] = {self._number(x)};" for i, x in enumerate(one.values)]
        for ring in law.rings:
            lines += [f"    memory->delay_{ring.node}[{i}] = 0;" for i in range(ring.samples)]
        lines += [f"    memory->at_{n} = 0;" for n in self._delays()]
        lines += [f"    memory->parameters = {name}_default;"] if law.parameters else []
        for one in law.signals:
            lines += [f"    memory->signals.{one.name}[{i}] = 0;" for i in range(len(one))]
        blocks.append("\n".join([*lines, "}"]))
        given = [("&t", 1)]
        if law.is_plant:
            given += [("u", len(law.u)), ("memory->q", len(law.states[0])), ("memory->v", len(law.states[1]))]
        else:
            given += [(one.name, len(one)) for one in law.states]
            given += [(f"reference->{one.name}", len(one)) for one in law.reference]
        checks = " || ".join(f"!{name}_is_finite({place}, {n})" for place, n in given)
        results = [(place, code.name(node)) for place, node in law.outputs]
        firm = [value for place, value in results if not place.startswith("memory->signals")]
        lines = [self._step(), "{"]
        if law.parameters:
            lines.append(f"    const {name}_parameters *const parameters = &memory->parameters;")
        if len(law.rows):
            last = len(law.rows) - 1
            lines.append(f"    const {real} *const row = {name}_rows[memory->k < {last}u ? memory->k : {last}u];")
        lines += [
            f"    if ({checks}) {{",
            f"        return {name.upper()}_NOT_FINITE;",
            "    }",
            "    if (memory->k > 0 && !(t > memory->t)) {",
            f"        return {name.upper()}_STALE;",
            "    }",
            "    {",
            *code.lines,
            f"    const {real} results[{len(firm)}] = {{",
            *(f"        {value}," for value in firm),
            "    };",
            f"    if (!{name}_is_finite(results, {len(firm)})) {{",
            f"        return {name.upper()}_NOT_FINITE;",
            "    }",
        ]
        for ring in law.rings:
            value, place = code.name(ring.pushed), f"memory->delay_{ring.node}"
            lines += [
                f"    for (uint32_t i = 0; memory->k == 0 && i < {ring.samples}u; ++i) {{",
                f"        {place}[i] = {value};",
                "    }",
                f"    {place}[memory->at_{ring.samples}] = {value};",
            ]
        lines += [
            f"    memory->at_{n} = memory->at_{n} + 1u < {n}u ? memory->at_{n} + 1u : 0u;" for n in self._delays()
        ]
        kept = [place for place, _ in results if not place.startswith("memory->signals")]
        lines += [f"    {place} = results[{i}];" for i, place in enumerate(kept)]
        lines += [f"    {place} = {x};" for place, x in results if place.startswith("memory->signals")]
        lines += [
            "    }",
            "    memory->t = t;",
            "    memory->k += memory->k < UINT32_MAX;",
            f"    return {name.upper()}_OK;",
            "}",
            "",
        ]
        return "\n\n".join([*blocks, "\n".join(lines)])

    def _helpers(self) -> list[str]:
        name = self.name
        found = [
            f"static int {name}_is_finite(const {name}_real *x, int n)\n{{\n"
            "    for (int i = 0; i < n; ++i) {\n        if (!(x[i] - x[i] == 0)) {\n            return 0;\n"
            "        }\n    }\n    return 1;\n}"
        ]
        text = "\n".join(self.code.lines)
        union = "union { double real; uint64_t bits; } word;"
        if f"{name}_bits(" in text:
            found.append(
                f"static uint64_t {name}_bits(double x)\n{{\n    {union}\n    word.real = x;\n"
                "    return word.bits;\n}"
            )
        if f"{name}_from_bits(" in text:
            found.append(
                f"static double {name}_from_bits(uint64_t x)\n{{\n    {union}\n    word.bits = x;\n"
                "    return word.real;\n}"
            )
        return found

    def _elementary(self) -> list[str]:
        known, wanted = _sections(), set(self.code.functions)
        todo = list(wanted)
        while todo:
            for other in known[todo.pop()][0]:
                if other not in wanted:
                    wanted.add(other)
                    todo.append(other)
        return [text.replace("NAME", self.name) for key, (_, text) in known.items() if key in wanted]

    def _array(self, what: str, numbers: Array) -> str:
        rows = [f"    {{{', '.join(map(self._number, row))}}}," for row in numbers]
        first = f"static const {self.name}_real {self.name}_{what}[{len(rows)}][{numbers.shape[1]}] = {{"
        return "\n".join([first, *rows, "};"])

    def _bounds(self) -> list[str]:
        name, law = self.name, self.law
        found: dict[str, list[str]] = {"default": [], "lower": [], "upper": []}
        tests = []
        for one, member in zip(law.found, self._by_path(), strict=True):
            declared: Any = one.leaf.declared
            low = declared.lower if declared.above is None else declared.above
            high = declared.upper
            n = len(member)
            found["default"] += [f"{{{', '.join(map(self._number, member.values))}}}"]
            found["lower"] += [f"{{{', '.join([self._number(-np.inf if low is None else low)] * n)}}}"]
            found["upper"] += [f"{{{', '.join([self._number(np.inf if high is None else high)] * n)}}}"]
            above = "<=" if declared.above is not None else "<"
            place = f"parameters->{member.name}"
            tests.append(
                f"    for (int i = 0; i < {n}; ++i) {{\n"
                f"        if (!{name}_is_finite(&{place}[i], 1) || {place}[i] {above} {name}_lower.{member.name}[i]\n"
                f"            || {place}[i] > {name}_upper.{member.name}[i]) {{\n            return 0;\n        }}\n    }}"
            )
        bounds = [
            f"const {name}_parameters {name}_{kind} = {{{', '.join(rows)}}};" for kind, rows in found.items()
        ]
        check = f"int {name}_are_valid(const {name}_parameters *parameters)\n{{\n"
        return ["\n".join(bounds), check + "\n".join(tests) + "\n    return 1;\n}"]

    def _by_path(self) -> list[Member]:
        """Return the parameters in the order of `law.found`."""
        known = {one.name: one for one in self.law.parameters}
        return [known[re.sub(r"\W", "_", one.path.partition(".")[2])] for one in self.law.found]

    def _interpolation(self) -> str:
        name, n = self.name, len(self.law.reference[1])
        assert self.table is not None
        last = len(self.table) - 1
        number = self._number
        return f"""void {name}_reference_at({name}_real t, {name}_reference *reference)
{{
    const {name}_real h = {number(self.law.context.dt)}, place = t / h;
    const int rests = place > {number(last + 1e-6)};
    const uint32_t nearest = rests ? {last}u : (uint32_t)(place > 0 ? place + {number(0.5)} : 0);
    const {name}_real off = place - ({name}_real)nearest;
    if (rests || nearest == {last}u || !(place > 0) || (off < {number(1e-5)} && off > -{number(1e-5)})) {{
        for (int i = 0; i < {n}; ++i) {{
            reference->q[i] = {name}_table[nearest][i];
            reference->v[i] = rests ? 0 : {name}_table[nearest][{n} + i];
            reference->a[i] = rests ? 0 : {name}_table[nearest][{2 * n} + i];
        }}
        return;
    }}
    const uint32_t k = off < 0 ? nearest - 1u : nearest;
    const {name}_real s = place - ({name}_real)k;
    for (int i = 0; i < {n}; ++i) {{
        const {name}_real *const from = {name}_table[k], *const to = {name}_table[k + 1u];
        const {name}_real d = to[i] - from[i], v0 = h * from[{n} + i], v1 = h * to[{n} + i];
        const {name}_real a0 = h * h * from[{2 * n} + i], a1 = h * h * to[{2 * n} + i];
        const {name}_real c3 = 10 * d - 6 * v0 - 4 * v1 - ({number(1.5)} * a0 - {number(0.5)} * a1);
        const {name}_real c4 = -15 * d + 8 * v0 + 7 * v1 + ({number(1.5)} * a0 - a1);
        const {name}_real c5 = 6 * d - 3 * (v0 + v1) - {number(0.5)} * (a0 - a1);
        reference->q[i] = from[i] + s * (v0 + s * ({number(0.5)} * a0 + s * (c3 + s * (c4 + s * c5))));
        reference->v[i] = (v0 + s * (a0 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / h;
        reference->a[i] = (a0 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))) / (h * h);
    }}
}}"""

    # The other files

    def _test(self) -> str:
        name, law = self.name, self.law
        samples = list(law.samples(_SAMPLES))
        given = {key: np.array([one[key] for one, _ in samples]) for key in samples[0][0]}
        results = {key: np.array([found[key] for _, found in samples]) for key in samples[0][1]}
        blocks = []
        for key, rows in given.items():
            blocks.append(self._array(f"given_{key.replace('->', '_')}", rows))
        for key, rows in results.items():
            blocks.append(self._array(f"result_{key}", rows))
        largest = max(float(np.abs(rows).max()) for rows in results.values())
        limit = f"{_TOLERANCE * max(largest, 1e-3):g}" if self.single else "0"
        fills, arguments = [], ["t"]
        if law.is_plant:
            arguments += [f"{name}_given_u[k]", "&memory"]
        else:
            arguments += [f"{name}_given_q[k]", f"{name}_given_v[k]", "&reference", "&memory", "u"]
            for one in law.reference:
                fills.append(
                    f"        for (int i = 0; i < {len(one)}; ++i) {{\n"
                    f"            reference.{one.name}[i] = {name}_given_reference_{one.name}[k][i];\n        }}"
                )
        compared = "\n".join(
            f"        for (int i = 0; i < {rows.shape[1]}; ++i) {{\n"
            f"            off = larger(off, {'memory.' if law.is_plant else ''}{key}[i] - {name}_result_{key}[k][i]);\n"
            "        }"
            for key, rows in results.items()
        )
        own = [f"    {name}_memory memory;", "    double off = 0;"]
        if not law.is_plant:
            own += [f"    {name}_reference reference;", f"    {name}_real u[{len(law.u)}];"]
        head = [
            f"/* Test of {name}.c with recorded arguments and results: it prints the largest difference. */",
            f'#include "{name}.h"',
            "",
            "#include <math.h>",
            "#include <stdio.h>",
            "",
        ]
        main = [
            "static double larger(double a, double b)",
            "{",
            "    const double size = fabs(b);",
            "    return size <= a ? a : size; /* NaN counts as a difference */",
            "}",
            "",
            "int main(void)",
            "{",
            *own,
            f"    {name}_init(&memory);",
            f"    for (int k = 0; k < {_SAMPLES}; ++k) {{",
            f"        const {name}_real t = {name}_given_t[k][0];",
            *fills,
            f"        if ({name}_step({', '.join(arguments)}) != {name.upper()}_OK) {{",
            '            printf("sample %d failed\\n", k);',
            "            return 1;",
            "        }",
            compared,
            "    }",
            f'    printf("largest difference of {_SAMPLES} samples: %g, allowed: {limit}\\n", off);',
            f"    return off <= {limit} ? 0 : 1;",
            "}",
            "",
        ]
        return "\n".join(head) + "\n" + "\n\n".join(blocks) + "\n\n" + "\n".join(main)

    def _cmake(self) -> str:
        name = self.name
        return f"""cmake_minimum_required(VERSION 3.10)
project({name} C)

set(CMAKE_C_STANDARD 99)
set(CMAKE_C_STANDARD_REQUIRED ON)

add_library({name} STATIC {name}.c)
target_include_directories({name} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
target_compile_options({name} PRIVATE -ffp-contract=off)
target_link_libraries({name} PUBLIC m)

enable_testing()
add_executable({name}_test {name}_test.c)
target_link_libraries({name}_test PRIVATE {name})
add_test(NAME {name} COMMAND {name}_test)
"""

    def _readme(self) -> str:
        name, law, upper = self.name, self.law, self.name.upper()
        size = 4 if self.single else 8
        numbers = 1 + sum(map(len, (*law.memory, *law.parameters, *law.signals)))
        numbers += sum(ring.samples for ring in law.rings)
        numbers += sum(map(len, law.states)) if law.is_plant else 0
        constants = law.rows.size + (0 if self.table is None else self.table.size)
        rows = [
            ("precision", "single" if self.single else "double, with the bits of the library"),
            ("time step", f"{law.context.dt:g} s"),
            ("operations of a step", f"{self.code.operations:,}"),
            ("memory", f"some {size * numbers + 4 * (1 + len(self._delays())):,} bytes for each robot"),
            ("constant tables", f"{size * constants:,} bytes"),
            ("largest stack", f"below {self.stack:,} bytes, without optimisation"),
            ("hash", f"`{self.digest}`, also `{upper}_HASH`"),
        ]
        listed = "\n".join(f"| {key} | {value} |" for key, value in rows)
        call = f"{name}_step(t, u, &memory)" if law.is_plant else f"{name}_step(t, q, v, &reference, &memory, u)"
        refer = (
            ""
            if law.is_plant
            else f"    {name}_reference_at(t, &reference);\n"
            if self.table is not None
            else "    /* fill `reference` for this time */\n"
        )
        tune = (
            f"- Parameters are in `memory.parameters`: change them between two steps, and check them by "
            f"`{name}_are_valid`.\n"
            if law.parameters
            else ""
        )
        table = (
            f"- `{name}_reference_at` interpolates the {len(self.table):,} samples of the trajectory by "
            "polynomials of order 5; at the samples, it returns them exactly. After the end, the reference rests.\n"
            if self.table is not None
            else ""
        )
        declared = f"{name}_memory memory;\n" + ("" if law.is_plant else f"{name}_reference reference;\n")
        return f"""# {name}: {self.title}

Made by pinmobile {self.version}. Two files are enough on the robot: `{name}.h` and `{name}.c`, in C99. They use no heap, no
global state, and of the C library only `sqrt` and `fabs`. Names and units of all entries are in the header.

|  |  |
|---|---|
{listed}

```c
#include "{name}.h"

{declared}{name}_init(&memory);
for (;;) {{ /* every {law.context.dt:g} s */
{refer}    if ({call} != {upper}_OK) {{
        /* stop the robot */
    }}
}}
```

- NaN or infinity in an argument or a result: the step returns `{upper}_NOT_FINITE`. Memory and output do not change.
- A stale measurement, whose time `t` is not later than the one before: the step returns `{upper}_STALE`. Memory and
  output do not change. A step after a gap computes as usual: stop the robot by a watchdog.
- The law assumes steps of {law.context.dt:g} s.
{tune}{table}- Compile without `-ffast-math` and with `-ffp-contract=off`, so that results do not depend on the compiler.

Test, with recorded arguments and results:

    cc -std=c99 -O2 -ffp-contract=off {name}.c {name}_test.c -lm -o {name}_test && ./{name}_test

or `cmake -B build && cmake --build build && ctest --test-dir build`.
"""

    @property
    def stack(self) -> int:
        """Bound of the bytes of stack of a step."""
        return self.code.stack + 8 * len(self.law.outputs)


def _entries(one: Member) -> Iterator[str]:
    for i, (name, unit) in enumerate(one.entries):
        yield f"/* {one.name}[{i}]: {name}{f' [{unit}]' if unit else ''} */"


def _argument(one: Member) -> Iterator[str]:
    for i, (name, unit) in enumerate(one.entries):
        yield f"   {one.name}[{i}]: {name}{f' [{unit}]' if unit else ''}"


@cache
def _sections() -> dict[str, tuple[list[str], str]]:
    """Return the functions of single precision by name: the functions that each needs, and its text."""
    text = files("pinmobile.export").joinpath("single.c").read_text()
    found = re.findall(r"/\* = ([\w ]+) \*/\n(.*?)(?=\n/\* = |\Z)", text, re.S)
    return {words.split()[0]: (words.split()[1:], body.strip()) for words, body in found}
