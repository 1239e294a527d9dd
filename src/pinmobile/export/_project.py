"""Files of exported code: header, source, test program, CMakeLists.txt and README."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np

import pinmobile
from pinmobile.arrays import Array
from pinmobile.compiled import COUNT
from pinmobile.export._code import Code
from pinmobile.export._law import Law, Member

_SAMPLES = 64  # of the test program
_TOLERANCE = 1e-4  # of single precision, relative to the largest result: high gains multiply rounding
_TIME_TOLERANCE = 1e-5  # of a time to a sample, in steps
_PLACE_TOLERANCE = 2e-7  # of single precision, relative to the number of steps: three roundings


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
    table : ndarray, shape (N + 1, 3 n), optional
        Reference (q, v, a) at the samples of a trajectory.
    title : str
        One line that names the parts.
    """

    def __init__(self, law: Law, name: str, *, single: bool, table: Array | None, title: str) -> None:
        self.law, self.name, self.single, self.table = law, name, single, table
        self.code = Code(
            law.tape, {**law.places, COUNT: "(uint64_t)memory->k"}, law.constants, prefix=name, single=single
        )
        self.code.write([*(node for _, node in law.outputs), *(ring.source for ring in law.rings)])
        self.words: dict[str, Any] = {"name": name, "UPPER": name.upper(), "title": title}
        dt = law.context.dt
        orders = (
            "of order 5 for positions, 3 for velocities and 1 for accelerations" if single else "of order 5"
        )
        self.words |= {
            "orders": orders,
            "version": pinmobile.__version__,
            "dt": f"{dt:g}",
            "dt_c": self._decimal(dt),
        }
        self.words |= {f"n{member.name}": len(member) for member in (*law.states, law.u)}
        self.words["prototype"] = self._prototype()
        types, body = self._types(), self._body()
        text = "\n".join([title, pinmobile.__version__, types, body])
        self.words |= {"types": types, "body": body, "digest": hashlib.sha256(text.encode()).hexdigest()[:16]}

    def files(self) -> dict[str, str]:
        """Return the texts by file name."""
        law, name = self.law, self.name
        calls = f"{name}_step(t, u, &memory)", f"{name}_step(t, q, v, &reference, &memory, u)"
        self.words["call"] = calls[0 if law.is_plant else 1]
        return {
            f"{name}.h": self._header(),
            f"{name}.c": self._text("source"),
            f"{name}_test.c": self._test(),
            "CMakeLists.txt": self._text("cmake"),
            "README.md": self._readme(),
        }

    def _text(self, section: str, **words: Any) -> str:
        text = Template(_sections("templates.c")[section][1]).substitute(self.words, **words)
        return text if section in ("delay", "parameter") else f"{text}\n"

    def _number(self, x: float) -> str:
        return self.code.literal("f", x)

    def _decimal(self, x: float) -> str:
        """Return a decimal constant that reads back to the same bits: the header is C++11 too."""
        return f"{np.float32(x)!s}f" if self.single else repr(x)

    def _numbers(self, values: Iterable[float]) -> str:
        return ", ".join(map(self._number, values))

    # Header

    def _struct(
        self,
        kind: str,
        comment: str,
        members: Sequence[Member],
        first: Sequence[str] = (),
        last: Sequence[str] = (),
    ) -> str:
        """Return a struct, with names and units of its entries."""
        lines = list(first)
        for member in members:
            lines += [*member.comment_lines("/* ", " */"), f"{self.name}_real {member.name}[{len(member)}];"]
        lines += last
        body = "".join(f"    {line}\n" for line in lines)
        return f"/* {comment} */\ntypedef struct {{\n{body}}} {self.name}_{kind};" if lines else ""

    def _types(self) -> str:
        law, name = self.law, self.name
        structs = [f"typedef {'float' if self.single else 'double'} {name}_real;"]
        if not law.is_plant:
            structs.append(self._struct("reference", "Reference of a sample.", law.reference))
        comment = "Numbers that may change between two samples."
        structs.append(self._struct("parameters", comment, law.parameters))
        structs.append(self._struct("signals", "Signals of the last sample.", law.signals))
        first = [f"{name}_real t; /* time of the last sample [s] */"]
        first += [f"{name}_real delay_{ring.node}[{ring.samples}];" for ring in law.rings]
        first += [f"{name}_parameters parameters;"] if law.parameters else []
        first += [f"{name}_signals signals;"] if law.signals else []
        last = ["uint32_t k; /* number of samples */"]
        last += [f"uint32_t at_{n}; /* place in delays of {n} samples */" for n in self._delays()]
        members = [*law.states, *law.memory] if law.is_plant else law.memory
        comment = "Memory from sample to sample: one for each robot."
        structs.append(self._struct("memory", comment, members, first, last))
        return "\n\n".join(filter(None, structs))

    def _delays(self) -> list[int]:
        return sorted({ring.samples for ring in self.law.rings})

    def _prototype(self) -> str:
        name, law = self.name, self.law
        arrays = [law.u] if law.is_plant else law.states
        args = [f"{name}_real t", *(f"const {name}_real {m.name}[{len(m)}]" for m in arrays)]
        args += [] if law.is_plant else [f"const {name}_reference *reference"]
        args += [f"{name}_memory *memory"] + ([] if law.is_plant else [f"{name}_real u[{len(law.u)}]"])
        return f"{name}_status {name}_step({', '.join(args)})"

    def _header(self) -> str:
        law = self.law
        plant = "Advance the plant by one time step: memory->q and memory->v.", "   t: time [s]", [law.u]
        control = (
            "Compute the input u of one sample, within the limits of the plant.",
            "   t: time of the measurement [s]",
            [*law.states, law.u],
        )
        purpose, first, members = plant if law.is_plant else control
        arguments = "\n".join([first, *(line for member in members for line in member.comment_lines("   "))])
        parts = ["declare_parameters"] * bool(law.parameters) + ["declare_table"] * (self.table is not None)
        declarations = "".join(f"\n{self._text(part)}" for part in parts)
        return self._text("header", purpose=purpose, arguments=arguments, declarations=declarations)

    # Source

    def _body(self) -> str:
        name, law, code = self.name, self.law, self.code
        starts = [
            f"memory->{m.name}[{i}] = {self._number(x)};"
            for m in (*law.memory, *(law.states if law.is_plant else ()))
            for i, x in enumerate(m.values)
        ]
        starts += [f"memory->delay_{ring.node}[{i}] = 0;" for ring in law.rings for i in range(ring.samples)]
        starts += [f"memory->at_{n} = 0;" for n in self._delays()]
        starts += [f"memory->parameters = {name}_default;"] if law.parameters else []
        starts += [f"memory->signals.{m.name}[{i}] = 0;" for m in law.signals for i in range(len(m))]
        arrays = {"u": law.u, "memory->q": law.states[0], "memory->v": law.states[1]}
        if not law.is_plant:
            arrays = {m.name: m for m in law.states}
            arrays |= {f"reference->{m.name}": m for m in law.reference}
        checks = {"&t": 1, **{place: len(m) for place, m in arrays.items()}}
        beginning, last = [], len(law.rows) - 1
        if law.parameters:
            beginning.append(f"const {name}_parameters *const parameters = &memory->parameters;")
        if len(law.rows):
            row = f"{name}_rows[memory->k < {last}u ? memory->k : {last}u]"
            beginning.append(f"const {name}_real *const row = {row};")
        results = [(place, code.name(node)) for place, node in law.outputs]
        signals = [pair for pair in results if pair[0].startswith("memory->signals")]
        required = [pair for pair in results if pair not in signals]
        # Signals first: their expressions may contain the memory before the sample.
        assignments = [f"    {place} = {value};" for place, value in signals]
        assignments += [
            self._text(
                "delay",
                samples=ring.samples,
                place=f"memory->delay_{ring.node}",
                value=code.name(ring.source),
            )
            for ring in law.rings
        ]
        assignments += [
            f"    memory->at_{n} = memory->at_{n} + 1u < {n}u ? memory->at_{n} + 1u : 0u;"
            for n in self._delays()
        ]
        assignments += [f"    {place} = results[{i}];" for i, (place, _) in enumerate(required)]
        return self._text(
            "body",
            helpers="\n".join(self._helpers()).strip(),
            starts="\n".join(f"    {line}" for line in starts),
            beginning="\n".join(f"    {line}" for line in beginning),
            not_finite=" || ".join(f"!{name}_is_finite({place}, {n})" for place, n in checks.items()),
            statements="\n".join(code.lines),
            results=",\n        ".join(value for _, value in required),
            count=len(required),
            assignments="\n".join(assignments),
        ).strip()

    def _helpers(self) -> list[str]:
        """Return the functions and tables before the step."""
        text, law = "\n".join(self.code.lines), self.law
        parts = [self._text("is_finite")]
        parts += [self._text(key) for key in ("bits", "from_bits") if f"{self.name}_{key}(" in text]
        table, names = _sections("single.c"), set(self.code.functions)
        todo = list(names)
        while todo:
            missing = [name for name in table[todo.pop()][0] if name not in names]
            names.update(missing)
            todo += missing
        parts += [f"{text.replace('NAME', self.name)}\n" for key, (_, text) in table.items() if key in names]
        parts += [self._parameters()] if law.parameters else []
        parts += [self._array("rows", law.rows)] if len(law.rows) else []
        if self.table is not None:
            words: dict[str, Any] = {"n": len(law.reference[1]), "last": len(self.table) - 1}
            near = self._number(_TIME_TOLERANCE)
            near += f" + {self._number(_PLACE_TOLERANCE)} * (place > 0 ? place : 0)" if self.single else ""
            derivatives = self._text("derivatives_single" if self.single else "derivatives", **words).rstrip()
            words |= {"half": self._number(0.5), "near": near, "derivatives": derivatives}
            parts += [self._array("table", self.table), self._text("interpolation", **words)]
        return parts

    def _array(self, kind: str, numbers: Array) -> str:
        rows = "".join(f"    {{{self._numbers(row)}}},\n" for row in numbers)
        size = f"[{len(numbers)}][{numbers.shape[1]}]"
        return f"static const {self.name}_real {self.name}_{kind}{size} = {{\n{rows}}};\n"

    def _parameters(self) -> str:
        """Return the constants and the check of the parameters' bounds."""
        bounds: dict[str, list[str]] = {"default": [], "lower": [], "upper": []}
        tests = []
        for ref, member in zip(self.law.tunables, self.law.parameters, strict=True):
            field: Any = ref.leaf.declared
            columns = member.values, *(ends.ravel() for ends in field.limits(np.shape(ref.leaf.value)))
            for key, values in zip(bounds, columns, strict=True):
                bounds[key].append(f"{{{self._numbers(values)}}}")
            comparison = "<" if field.above is None else "<="
            tests.append(self._text("parameter", count=len(member), member=member.name, below=comparison))
        words = {key: ", ".join(rows) for key, rows in bounds.items()}
        return self._text("parameters", tests="\n".join(tests), **words)

    # Other files

    def _test(self) -> str:
        name, law = self.name, self.law
        samples = list(law.samples(_SAMPLES))
        arguments = {key: np.array([inputs[key] for inputs, _ in samples]) for key in samples[0][0]}
        results = {key: np.array([outputs[key] for _, outputs in samples]) for key in samples[0][1]}
        arrays = [(f"given_{key.replace('->', '_')}", rows) for key, rows in arguments.items()]
        arrays += [(f"result_{key}", rows) for key, rows in results.items()]
        largest = max(1e-3, *(float(np.abs(rows).max()) for rows in results.values()))
        loop = "        for (int i = 0; i < {n}; ++i) {{\n            {body}\n        }}"
        fills = [f"        const {name}_real t = {name}_given_t[k][0];"]
        declarations, call, prefix = "", f"{name}_step(t, {name}_given_u[k], &memory)", "memory."
        if not law.is_plant:
            prefix = ""
            declarations = f"    {name}_reference reference;\n    {name}_real u[{len(law.u)}];"
            call = f"{name}_step(t, {name}_given_q[k], {name}_given_v[k], &reference, &memory, u)"
            for inputs in law.reference:
                body = f"reference.{inputs.name}[i] = {name}_given_reference_{inputs.name}[k][i];"
                fills.append(loop.format(n=len(inputs), body=body))
        comparisons = [
            loop.format(
                n=rows.shape[1], body=f"off = larger(off, {prefix}{key}[i] - {name}_result_{key}[k][i]);"
            )
            for key, rows in results.items()
        ]
        return self._text(
            "test",
            arrays="\n".join(self._array(*array) for array in arrays).strip(),
            own=declarations,
            samples=_SAMPLES,
            fills="\n".join(fills),
            call=call,
            compared="\n".join(comparisons),
            limit=f"{_TOLERANCE * largest:g}" if self.single else "0",
        )

    def _operations(self) -> str:
        """Return the number of operations, and what it leaves out."""
        code = self.code
        names = ", ".join(sorted(code.functions))
        calls = f", and function calls: {code.calls:,} ({names})" * bool(code.calls)
        return f"{code.operations:,}{calls}" + ", with one round of each loop" * bool(code.loops)

    def _readme(self) -> str:
        law, size = self.law, 4 if self.single else 8
        numbers = 1 + sum(map(len, (*law.memory, *law.parameters, *law.signals)))
        numbers += sum(ring.samples for ring in law.rings) + law.is_plant * sum(map(len, law.states))
        size_total = size * numbers + 4 * (1 + len(self._delays()))
        constants = law.rows.size + (0 if self.table is None else self.table.size)
        notes = {"parameters": bool(law.parameters), "table": self.table is not None, "plant": law.is_plant}
        refer = "reference_at(t, &reference);" if self.table is not None else ""
        fill = f"    {self.name}_{refer}\n" if refer else "    /* fill `reference` for this time */\n"
        fields = f"{self.name}_memory memory;" + f"\n{self.name}_reference reference;" * (not law.is_plant)
        return self._text(
            "readme",
            precision="single" if self.single else "double, with the bits of the library",
            operations=self._operations(),
            memory=f"{-(-size_total // size) * size:,}",
            constants=f"{size * constants:,}",
            stack=f"{self.code.stack + size * len(law.outputs):,}",
            declared=fields,
            refer="" if law.is_plant else fill,
            notes="".join(self._text(f"note_{key}") for key, is_included in notes.items() if is_included),
        )


@cache
def _sections(file: str) -> dict[str, tuple[list[str], str]]:
    """Return the sections of a file by name: the sections that each needs, and its text."""
    text = files("pinmobile.export").joinpath(file).read_text()
    sections = re.findall(r"/\* = ([\w ]+) \*/\n(.*?)(?=\n+/\* = |\s*\Z)", text, re.S)
    return {words.split()[0]: (words.split()[1:], body) for words, body in sections}
