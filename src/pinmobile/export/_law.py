"""Law of one sample, taken from the tape of a closed loop: a controller's, or a plant's."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace as replaced
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import COUNT, Identity, LoopTape, Ring, ancestors, evaluate
from pinmobile.errors import InvalidArgument
from pinmobile.loop import (
    Loop,
    Record,
    Sample,
    Trace,
    arrays_of,
    initial_memory,
    scheduled_rows,
    start_of,
    traced_numbers,
)
from pinmobile.parts import COORDINATES, NumberRef, find, named, option, part, replace
from pinmobile.plant import Context, coordinates_of, inputs_of
from pinmobile.signals import signals_of
from pinmobile.trajectories import Reference


def noise_error(name: str) -> InvalidArgument:
    """Return the error of a controller of a real robot that draws noise of a simulation."""
    return InvalidArgument(
        f"controller draws {name.partition(' ')[0]} noise, which a robot has by itself, expected a "
        "controller without noise, such as the one inside MeasurementNoise",
        "controller",
    )


_INERTIAL = dict.fromkeys(("x", "y", "vx", "vy", "Fx", "Fy"), ", in the inertial frame")
_NOTES = {**_INERTIAL, "psi": ", unwrapped: without a jump at pi"}  # for plants that begin with x, y, psi
_CHANGE = 1e-3  # relative change of a number that shows what it changes


@final
@part
class InputRecorder:
    """Recorder of the applied input and of the signals.

    Parameters
    ----------
    as_measured : bool
        Whether the controller gets velocities without projection onto the constraints of the plant.
    errors : bool
        Whether the record contains the errors of the reference's coordinates and of their rates.
    """

    as_measured: bool = option(default=True)
    errors: bool = option(default=False)
    signals = True

    @property
    def projects_after(self) -> bool:
        """Whether the velocities after a sample fulfil the constraints: those of a plant in C."""
        return not self.as_measured

    def initial_state(self, n: int, nu: int) -> None:
        """Return None: the recorder has no memory."""

    def __call__(self, sample: Sample, state: None) -> Record:
        """Return the applied input and the signals as a record."""
        values = {f"signal {name}": signal.value for name, signal in sample.signals.items()}
        units = {name: signal.unit for name, signal in sample.signals.items()}
        errors = {"error": np.concatenate([sample.error, sample.error_rate])} if self.errors else {}
        return Record(None, (), {"u": sample.u, **errors, **values}, units)


@final
@part
class InputSchedule:
    """Controller whose output is the input that the caller gives, a row of a schedule."""

    def initial_state(self, context: Context) -> Any:
        """Return the schedule of the input."""
        return context.schedule(np.zeros((len(context.t), len(context.inputs))))

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        """Return the input of this sample."""
        return state.next()


class Member:
    """Array of the interface of exported code.

    Attributes
    ----------
    name : str
        Name in C.
    entries : sequence of (str, str) or (str, str, str)
        Name and unit of each entry, and a text behind them.
    values : ndarray
        Initial or nominal values.
    """

    def __init__(self, name: str, entries: Sequence[tuple[str, ...]], values: Any = None) -> None:
        self.name = name
        self.entries = [(text.replace("*/", "* /"), *rest) for text, *rest in entries]  # texts of comments
        self.values = np.zeros(len(self.entries)) if values is None else np.ravel(np.asarray(values, float))

    def __len__(self) -> int:
        return len(self.entries)

    def comment_lines(self, prefix: str, suffix: str = "") -> list[str]:
        """Return a line with name and unit of each entry, or one line if they are alike."""
        texts = ["".join([f"{x} [{unit}]" if unit else x, *note]) for x, unit, *note in self.entries]
        if len(set(texts)) == 1:
            return [f"{prefix}{self.name}: {texts[0]}{suffix}"]
        return [f"{prefix}{self.name}[{i}]: {text}{suffix}" for i, text in enumerate(texts)]


class Law:
    """Law of one sample on a tape, with the places of its inputs and outputs in C.

    Parameters
    ----------
    loop : Loop
        Closed loop with an `InputRecorder`; for the law of the plant, with the controller `InputSchedule`.
    context : Context
        Context of the controller.
    start : (ndarray, ndarray), shape (nq,), (nv,)
        Initial state of the plant.
    reference : Reference
        Reference of the first sample.
    tunable : sequence of str
        Numbers that stay parameters.

    Attributes
    ----------
    u : Member
        Input of the plant.
    states, reference, memory, parameters, signals : list of Member
        State of the plant, reference, memory, parameters, and signals.
    outputs : list of (str, int)
        C expression and node of each result.
    rings : list of Ring
        Delays in use.
    rows : ndarray, shape (N + 1, m)
        Rows of the schedules; the last one remains.
    """

    def __init__(
        self,
        loop: Loop,
        context: Context,
        start: tuple[Array, Array],
        reference: Reference,
        tunable: Sequence[str] = (),
    ) -> None:
        self.loop, self.context, self.start = loop, context, start
        self.is_plant = not loop.recorder.as_measured
        refs = {ref.path: ref for ref in map(self._tunable, tunable)}
        self.tunables = [*refs.values()]
        spread = {ref.path: np.ones(np.shape(ref.leaf.value), bool) for ref in self.tunables}
        self.initial = memory = initial_memory(loop, context)
        identity = Identity.of(loop, memory[2:], spread, ())
        self.loop_tape = Trace(loop, context, start, reference, identity, spread).result()
        self.tape = self.loop_tape.tape
        self.constants: dict[Any, float] = {("uniform", 0): context.dt / loop.substeps}
        self.places: dict[Any, str] = {}
        self.outputs: list[tuple[str, int]] = []
        self._parameters()
        self._interface(reference)
        self.values = arrays_of(memory)
        self._memory(self.values)
        self._results()
        self._finish()

    def _tunable(self, name: str) -> NumberRef:
        root = "plant." if self.is_plant else "controller."
        refs = {path: ref for path, ref in named(self.loop).items() if path.startswith(root)}
        number = find(self.loop, name, refs, "tunable")
        if number.label:
            raise InvalidArgument(
                f"tunable has {name!r}, an entry of {number.leaf.path}, expected the whole field: "
                f"{number.leaf.path!r}"
            )
        declared: Any = number.leaf.declared
        value = np.asarray(number.leaf.value, float)
        steps, _ = declared.difference_steps(value, _CHANGE)
        varied = replace(self.loop, {number.path: value + steps})
        loops = self.loop, varied
        memories = (arrays_of(initial_memory(x, self.context)) for x in loops)
        schedules = (scheduled_rows(x, self.context) for x in loops)
        if not (all(map(np.array_equal, *memories)) and all(map(np.array_equal, *schedules))):
            raise InvalidArgument(
                f"tunable has {name!r}, from which the law computes its memory before the first sample, "
                "expected a number that the law reads at each sample: export again with another value"
            )
        has_start = self.is_plant and self.loop.trajectory is not None
        starts = (start_of(x.plant, self.context.reference, None, None) for x in loops if has_start)
        if len({np.concatenate(start).tobytes() for start in starts}) > 1:
            raise InvalidArgument(
                f"tunable has {name!r}, from which the start on the trajectory follows, expected another "
                "number, or no trajectory: then the plant starts at rest"
            )
        return number

    def _parameters(self) -> None:
        """Place the parameters: numbers that stay variable, and constants."""
        values, self.parameters = traced_numbers(self.loop), list[Member]()
        tunable = {ref.path: ref for ref in self.tunables}
        unused = [path for path in tunable if path in self.loop_tape.unused]
        if unused:
            raise InvalidArgument(
                f"tunable has {unused[0]!r}, which no operation of the law uses, expected a number that it "
                "reads at each sample"
            )
        for path, leaf in self.loop_tape.parameters.items():
            if path not in tunable:
                keys = [(leaf.kind, leaf.first + i) for i in range(values[path].size)]
                self.constants |= dict(zip(keys, map(float, values[path].flat), strict=True))
        for path, ref in tunable.items():
            leaf, size = self.loop_tape.parameters[path], values[path].size
            name = re.sub(r"\W", "_", path.partition(".")[2])
            units = (ref.unit.split(", ") * size)[:size]
            self.parameters.append(Member(name, [(ref.meaning, unit) for unit in units], values[path]))
            places = {(leaf.kind, leaf.first + i): f"parameters->{name}[{i}]" for i in range(size)}
            self.places |= places

    def _interface(self, reference: Reference) -> None:
        """Place time, state, input and reference."""
        plant, (nq, nv, _, length, n) = self.loop.plant, self.loop_tape.sizes
        coordinates, inputs = coordinates_of(plant), inputs_of(plant)
        is_planar = tuple(one.name for one in coordinates[:3]) == COORDINATES
        notes = _NOTES if is_planar else {}
        names = [(one.name, one.unit, notes.get(one.name, "")) for one in coordinates]
        pairs = [(one.rate or f"{one.name}_rate", f"{one.unit or '1'}/s") for one in coordinates]
        rates = [(name, unit, notes.get(name, "")) for name, unit in pairs]
        accelerations = [
            (f"acceleration of {name}", f"{unit or '1'}/s^2", _INERTIAL.get(name, "") * is_planar)
            for name, unit, _ in names
        ]
        if nq != nv:
            names = [(f"configuration {i}", "", "") for i in range(nq)]
        q, v = Member("q", names, self.start[0]), Member("v", rates, self.start[1])
        limits = [", without limits"] * len(inputs)
        if self.loop.limits is not None:
            limits = [f", from {low:g} to {high:g}" for low, high in np.transpose(self.loop.limits)]
        frames = [notes.get(one.name, "") for one in inputs]
        texts = map("".join, zip(frames, limits, strict=True))
        self.u = Member("u", [(one.name, one.unit, x) for one, x in zip(inputs, texts, strict=True)])
        self.states, prefix = [q, v], "memory->" if self.is_plant else ""
        for first, member in ((0, q), (nq, v)):
            self.places |= {("state", first + i): f"{prefix}{member.name}[{i}]" for i in range(len(member))}
        members = Member("q", names[:length]), Member("v", rates[:n]), Member("a", accelerations[:n])
        self.reference, column = list(members), 1
        self.places["sample", 0] = "t"
        for member in members:
            for i in range(len(member)):
                self.places["sample", column + i] = f"reference->{member.name}[{i}]"
            column += len(member)
        rows = [np.reshape(x, (len(x), -1)) for x in scheduled_rows(self.loop, self.context)]
        self.rows = np.concatenate(rows, axis=1) if rows else np.zeros((0, 0))
        if self.is_plant:
            self.places |= {("sample", column + i): f"u[{i}]" for i in range(self.rows.shape[1])}
            self.rows = np.zeros((0, 0))
        else:
            self.places |= {("sample", column + i): f"row[{i}]" for i in range(self.rows.shape[1])}

    def _memory(self, values: Sequence[Any]) -> None:
        """Place the memory of the law; arrays that never change are constants."""
        self.memory: list[Member] = []
        owner, loop = "plant" if self.is_plant else "controller", self.loop_tape
        for leaf, value in zip(loop.leaves, values, strict=True):
            flat = np.ravel(np.broadcast_to(np.asarray(value, float), leaf.shape))
            keys = [(leaf.kind, leaf.first + i) for i in range(len(flat))]
            if leaf.kind != "state":
                self.constants |= dict(zip(keys, map(float, flat), strict=True))
            elif leaf.owner == owner and len(flat):
                name = f"state_{len(self.memory)}"
                self.memory.append(Member(name, [(leaf.path, "")] * len(flat), flat))
                self.places |= {key: f"memory->{name}[{i}]" for i, key in enumerate(keys)}
                nodes = [loop.states[leaf.first + i][1] for i in range(len(flat))]
                self.outputs += [(f"memory->{name}[{i}]", node) for i, node in enumerate(nodes)]

    def _results(self) -> None:
        """Place the results of a step: the input, or the next state; and the controller's signals."""
        loop, (nq, nv, *_) = self.loop_tape, self.loop_tape.sizes
        self.signals: list[Member] = []
        if self.is_plant:
            for i, (_, next_node) in enumerate(loop.states[: nq + nv]):
                self.outputs.append((self.places["state", i], next_node))
            return
        self.outputs += [(f"u[{i}]", node) for i, node in enumerate(loop.kept["u"][1])]
        signals = signals_of(self.loop.controller, self.initial.controller)
        for key, (_, nodes) in loop.kept.items():
            name = key.removeprefix("signal ")
            if name in signals:
                member = re.sub(r"\W", "_", name)
                self.signals.append(Member(member, [(name, loop.units[name])] * len(nodes)))
                self.outputs += [(f"memory->signals.{member}[{i}]", node) for i, node in enumerate(nodes)]

    def controller_tape(self) -> LoopTape:
        """Return the tape of the controller alone: the state of the plant does not change.

        It keeps the applied input, the errors if the recorder has them, and the signals of the controller.
        """
        loop = self.loop_tape
        is_memory_row = [False] * len(loop.states)
        for leaf in loop.leaves:
            if leaf.kind == "state" and leaf.owner == "controller":
                size = int(np.prod(leaf.shape))
                is_memory_row[leaf.first : leaf.first + size] = [True] * size
        pairs = zip(loop.states, is_memory_row, strict=True)
        states = [(node, next_node if is_memory else node) for (node, next_node), is_memory in pairs]
        names = {f"signal {name}" for name in signals_of(self.loop.controller, self.initial.controller)}
        kept = {name: entry for name, entry in loop.kept.items() if name in {"u", "error"} | names}
        return replaced(loop, states=states, kept=kept, counted=[], tables=False)

    def _finish(self) -> None:
        """Find the delays in use, and refuse noise."""
        live = ancestors(self.tape, [node for _, node in self.outputs])
        self.rings: list[Ring] = [ring for ring in self.loop_tape.rings if ring.node in live]
        for i in live:
            operation = self.tape.operations[i]
            if operation[0] == "key":
                raise noise_error(self.loop_tape.keys[operation[1]])

    def samples(self, count: int) -> Iterator[tuple[dict[str, Array], dict[str, Array]]]:
        """Yield arguments and results of consecutive samples near the start, computed by NumPy."""
        nodes = [node for _, node in self.outputs]
        sources = [ring.source for ring in self.rings]
        memory = {
            f"memory->{member.name}[{i}]": x
            for member in (*self.memory, *(self.states if self.is_plant else ()))
            for i, x in enumerate(member.values)
        }
        fixed = {f"parameters->{p.name}[{i}]": x for p in self.parameters for i, x in enumerate(p.values)}
        past: dict[int, list[Any]] = {ring.node: [] for ring in self.rings}
        for k in range(count):
            arguments = self._arguments(k)
            values = {"t": float(arguments["t"][0]), **memory, **fixed}
            for name, array in arguments.items():
                values |= {f"{name}[{i}]": x for i, x in enumerate(array)}
            if len(self.rows):
                values |= {f"row[{i}]": x for i, x in enumerate(self.rows[min(k, len(self.rows) - 1)])}
            inputs: dict[Any, Any] = {COUNT: np.uint64(k), **self.constants}
            inputs |= {op: values[place] for op, place in self.places.items() if place in values}
            for ring in self.rings:
                if past[ring.node]:
                    history = past[ring.node]
                    inputs[self.tape.operations[ring.node]] = history[max(0, k - ring.samples)]
            outputs = evaluate(self.tape, [*nodes, *sources], inputs, first=k == 0)
            for ring, x in zip(self.rings, outputs[len(nodes) :], strict=True):
                past[ring.node].append(x)
            results = {place: float(x) for (place, _), x in zip(self.outputs, outputs, strict=False)}
            memory |= {place: x for place, x in results.items() if place in memory}
            names = ("q", "v") if self.is_plant else ("u",)
            yield arguments, {name: self._result(name, results) for name in names}

    def _result(self, name: str, results: dict[str, float]) -> Array:
        place = f"memory->{name}" if self.is_plant else name
        size = len(self.u) if name == "u" else len(self.states["qv".index(name)])
        return np.array([results[f"{place}[{i}]"] for i in range(size)])

    def _arguments(self, k: int) -> dict[str, Array]:
        """Return smooth arguments of a sample near the start."""
        t = k * self.context.dt

        def wave(size: int, shift: float, scale: float) -> Array:
            return np.asarray(scale * np.sin(0.7 + shift + 1.3 * np.arange(size) + 0.31 * k))

        arguments = {"t": np.array([t])}
        if self.is_plant:
            return {**arguments, "u": wave(len(self.u), 0.2, 1.0)}
        (q, v), n = self.start, len(self.reference[1])
        q_sample = np.asarray(self.loop.integrate(q, wave(len(v), 0.0, 0.05)), float)
        q_reference = np.asarray(self.loop.integrate(q, wave(len(v), 0.4, 0.03)), float)
        arguments |= {"q": q_sample, "v": v + wave(len(v), 0.9, 0.1)}
        rates = ("reference->v", v[:n] + wave(n, 0.5, 0.1)), ("reference->a", wave(n, 0.1, 0.2))
        return {**arguments, "reference->q": q_reference[: len(self.reference[0])], **dict(rates)}
