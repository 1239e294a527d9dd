"""A closed loop with losses, as machine code that runs it forwards, with tangents, and backwards."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, replace as replaced
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, required, sequence
from pinmobile.compiled import (
    Identity,
    LoopTape,
    Program,
    Shape,
    Target,
    adjoint,
    aligned,
    expand_delays,
    index_bits,
    pause_gc,
    processors,
    robot_keys,
    sides,
    tangent,
)
from pinmobile.errors import NotTraceable, argument_errors
from pinmobile.loop import (
    Loop,
    SameAs,
    Scenario,
    Trace,
    arrays_of,
    draw_values,
    initial_memories,
    initial_memory,
    sample_reference,
    scheduled_rows,
    start_of,
    traced_numbers,
)
from pinmobile.parts import NumberRef, evolved, match_refs, named, replace
from pinmobile.trajectories import Reference

_FORWARD = 8  # numbers for which forward mode is selected
_STEP = 1e-3  # relative step of differences of what Python computes before the first sample
# Shares of the step, weights of the differences, and divisor.
_CENTRAL = (0.5, -0.5, 1.0, -1.0), (8, -8, -1, 1), 6
_ONE_SIDED = (0.25, 0.5, 0.75, 1.0), (48, -36, 16, -3), 3
_CACHE_SIZE = 32  # machines that are kept
_START_WORDS = "plant", "start", "start_rate", "trajectory"  # first words of numbers that change the start
_RECORD = 2e8  # bytes of the states of all samples that are kept at once


_Input: TypeAlias = tuple[str, int]
_RUN, _SERIES = ("row", "uniform"), ("sample", "track")  # kinds of inputs of a run, and of each sample


class Inputs(NamedTuple):
    """Inputs of the machine code of n robots, which Python computes before the first sample; or tangents.

    Attributes
    ----------
    states, rows : ndarray, shape (S, n), (R, n)
        Initial states, and numbers of each robot.
    uniforms : ndarray, shape (U,)
        Numbers of all robots.
    samples : ndarray, shape (N + 1, C)
        Time, reference and schedules of each sample.
    tracks : ndarray, shape (N + 1, T, n)
        Reference of each robot, or nothing.
    """

    states: Array
    rows: Array
    uniforms: Array
    samples: Array
    tracks: Array

    def subset(self, robots: slice) -> Inputs:
        """Return the inputs of some robots."""
        arrays = {"states": self.states, "rows": self.rows, "tracks": self.tracks}
        return self._replace(**{name: x[..., robots] for name, x in arrays.items()})


class Direction(NamedTuple):
    """Effect of a number on the inputs: slope 1 of a row, and slopes of others (None: none)."""

    path: str
    entry: tuple[int, ...]
    row: int
    other: Inputs | None


def _varied_inputs(directions: Sequence[Direction]) -> tuple[list[_Input], list[_Input]]:
    """Return the inputs of a run, and those of each sample, that depend on some numbers."""
    run: list[_Input] = [("row", direction.row) for direction in directions if direction.row >= 0]
    samples: list[_Input] = []
    for other in (direction.other for direction in directions if direction.other is not None):
        rows, series = (other.rows, other.uniforms), (other.samples.T, other.tracks.swapaxes(0, 1))
        for group, kinds, arrays in ((run, _RUN, rows), (samples, _SERIES, series)):
            for kind, x in zip(kinds, arrays, strict=True):
                group += [(kind, i) for i, row in enumerate(x) if np.any(row)]
    return [*dict.fromkeys(run)], [*dict.fromkeys(samples)]


@dataclass
class Machine:
    """Machine code of a loop.

    Attributes
    ----------
    tape : LoopTape
        Loop without delays.
    longest : int
        Longest delay [samples].
    programs : dict
        Tapes and programs by purpose.
    """

    tape: LoopTape
    longest: int
    kept: list[Any]
    programs: dict[Any, tuple[LoopTape, Program]] = field(default_factory=dict)

    def of(self, key: Any, make: Callable[[], LoopTape], is_vector: bool) -> tuple[LoopTape, Program]:
        """Return tape and program of a purpose, which are made once."""
        key = (key, is_vector)
        if key not in self.programs:
            tape = make()
            self.programs[key] = tape, Program(tape, shape=Shape(Target.host().lanes if is_vector else 1, 1))
        return self.programs[key]

    @property
    def plain(self) -> LoopTape:
        """Loop that keeps nothing but its states."""
        return replaced(self.tape, kept={}, counted=[])

    def state_recorder(self) -> LoopTape:
        """Return the loop that keeps the states of all samples."""
        nodes = [node for node, _ in self.tape.states]
        return replaced(self.plain, kept={"state": ((len(nodes),), nodes)})

    def kink_recorder(self) -> LoopTape:
        """Return the loop that keeps the sides of its kinks, and whether wheels slide."""
        tape = self.tape
        nodes = [tape.tape.number(tape.tape.at(i)) for i in sides(self.plain)]
        slides = {name: x for name, x in tape.kept.items() if name == "slides"}
        return replaced(self.plain, kept={"sides": ((len(nodes),), nodes), **slides})


_machines: OrderedDict[Any, Machine] = OrderedDict()


class Problem:
    """Closed loop with a recorder, and the numbers by which it is differentiated.

    Parameters
    ----------
    scenario : Scenario
        Loop, and its robots.
    recorder : recorder
        Recorder of the loop.
    by : sequence of str
        Numbers by name.
    start : (q0, v0)
        Initial state of one robot, None: the start of the reference.
    """

    def __init__(
        self, scenario: Scenario, recorder: Any, by: Sequence[str], start: Any = (None, None)
    ) -> None:
        self.scenario, self.n, self.start = scenario, scenario.n, start
        is_ensemble = self.n > 1 or bool(scenario.spread)  # else forces of noise keep their own draws
        self.draws = scenario.draws() if is_ensemble else {}
        self.values = scenario.values(self.draws, 0, self.n) if is_ensemble else {}
        self.loop = evolved(scenario.loop, {"recorder": recorder})
        refs = named(scenario.nominal_loop)
        self.refs_by_name = {name: _set_refs(scenario.nominal_loop, name, refs) for name in by}
        self.numbers = {ref.path: ref for group in self.refs_by_name.values() for ref in group}
        numbers = traced_numbers(self.loop)
        spread = dict(scenario.entries) if is_ensemble else {}
        for path in {ref.leaf.path for ref in self.numbers.values()} & numbers.keys():
            spread[path] = np.ones(np.shape(numbers[path]), bool)
        self.nominal = {path: np.asarray(x.leaf.value, float) for path, x in refs.items() if not x.label}
        self.pure: dict[str, bool] = {}
        self._base: Any = None
        self.spread, self.has_own = spread, scenario.has_own_references
        self.machine = self._machine()

    def _machine(self) -> Machine:
        scenario, loop = self.scenario, self.loop
        memory = initial_memory(loop, scenario.context)
        tag = loop.substeps, loop.steps, tuple(map(np.shape, scenario.reference)), self.has_own, "derivatives"
        self.identity = Identity.of(loop, memory[2:], self.spread, tag)
        key = self.identity.key
        machine = _machines.get(key)
        if machine is None:
            first = Reference(*(x[0] for x in scenario.reference))
            begin = start_of(loop.plant, scenario.reference, *self.start)
            parts = loop, scenario.context, begin, first, self.identity, self.spread, self.has_own
            tape = Trace(*parts, own_schedules=True).result()
            longest = max((ring.samples for ring in tape.rings), default=0)
            machine = _machines[key] = Machine(expand_delays(tape), longest, self.identity.kept)
            while len(_machines) > _CACHE_SIZE:
                _machines.popitem(last=False)
        return machine

    def entries(self, number: NumberRef) -> list[tuple[int, ...]]:
        """Return the entries of the array of a number that it means; one empty entry for a scalar."""
        shape = self.nominal[number.leaf.path].shape
        return [number.place(len(shape))] if number.entry is not None else [*np.ndindex(shape)]

    def _vary(self, changes: Mapping[str, Any]) -> tuple[Scenario, Loop]:
        """Return scenario and loop with other numbers, by path."""
        loop, base = replace(self.loop, changes), self.scenario
        if loop.plant is self.loop.plant and loop.trajectory is self.loop.trajectory:
            return base, loop
        scenario = copy(base)  # without what it has derived
        reference = sample_reference(loop.trajectory, base.t, loop.plant)
        scenario.__dict__.update(_part_arguments(loop), reference=reference)
        return scenario, loop

    def inputs(self, changes: Mapping[str, Any]) -> Inputs:
        """Return the inputs of the machine code for other numbers than the given ones, by path."""
        n, tape = self.n, self.machine.tape
        scenario, loop = self._vary({**changes, **self.copies(changes)})
        values = dict(self.values)
        for path, value in changes.items():
            if path in values or path.startswith("start"):
                values[path] = values.get(path, np.zeros((n, 1))) + (np.asarray(value) - self.nominal[path])
        self._scale_copies(changes, values)
        q, v, tracks = self._initial_states(scenario, loop, values)
        states, rows = np.zeros((len(tape.states), n)), np.zeros((tape.rows, n))
        uniforms: Array = np.zeros(tape.uniforms)
        uniforms[0] = scenario.dt / loop.substeps
        states[: len(q) + len(v)] = np.concatenate([q, v])
        targets: dict[str, Any] = {"state": states, "row": rows, "uniform": uniforms}
        numbers = traced_numbers(loop)

        def put(leaf: Any, value: Array) -> None:
            if leaf.kind == "uniform" or value.ndim == len(leaf.shape):
                flat: Array = np.broadcast_to(value, leaf.shape).ravel()
                targets[leaf.kind][leaf.first : leaf.first + flat.size].T[...] = flat
            else:
                flat = value.reshape(n, -1).T
                targets[leaf.kind][leaf.first : leaf.first + len(flat)] = flat

        for path, leaf in tape.parameters.items():
            put(leaf, np.asarray(values[path] if path in values else numbers[path], float))
        memories = arrays_of(initial_memory(loop, scenario.context))
        varied = {path: values[path] for path in self.values if path in self.spread}
        owners = {path.partition(".")[0] for path in varied}
        if any(leaf.owner in owners for leaf in tape.leaves):
            memories = initial_memories(loop, scenario.context, varied, n, self.identity)
        for leaf, value in zip(tape.leaves, memories, strict=True):
            put(leaf, np.asarray(value, float))
        schedules = scheduled_rows(loop, scenario.context) if tape.schedule_size else []
        schedules = [np.reshape(schedule, (len(scenario.t), -1)) for schedule in schedules]
        samples = np.concatenate([scenario.t[:, None], *scenario.reference, *schedules], axis=1)
        return Inputs(states, rows, uniforms, samples, tracks)

    def _find_copies(self, changes: Mapping[str, Any]) -> Iterator[tuple[NumberRef, str, Any, Array]]:
        """Yield the numbers of the spread that are the same as changed numbers.

        With each come path and place of the changed number, and the factor of each robot, shape (n,).
        """
        scenario = self.scenario
        keys = {ref.path: key for key, ref in scenario.numbers.items()}
        for name, number in scenario.numbers.items() if changes else ():
            origin, factor, key = number, np.ones(self.n), name
            while isinstance(source := scenario.spread.get(key), SameAs):
                factor *= draw_values(f"{key} factor", source.factor, scenario.seed, 0, self.n)
                origin = scenario.find(source.name)
                key = keys.get(origin.path, "")
            if origin is not number and (path := origin.leaf.path) in changes:
                yield number, path, _index_of(origin, np.ndim(changes[path])), factor

    def copies(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the numbers that are the same as changed ones, by path, with the mean factor of robots."""
        copies = dict[str, Any]()
        for number, path, place, factor in self._find_copies(changes):
            key = number.leaf.path
            new = np.array(copies.get(key, changes.get(key, self.nominal[key])), float)
            new[_index_of(number, new.ndim)] = factor.mean() * np.ravel(np.asarray(changes[path])[place])[0]
            copies[key] = new if new.ndim else float(new)
        return copies

    def _scale_copies(self, changes: Mapping[str, Any], values: dict[str, Array]) -> None:
        """Change the numbers of the spread that are the same as changed numbers, in proportion."""
        for number, path, place, factor in self._find_copies(changes):
            old, new = (np.asarray(x, float) for x in (self.nominal[path], changes[path]))
            change = float(np.ravel((new - old)[place])[0])
            column: Any = values[number.leaf.path].copy()
            index: Any = (slice(None), *number.place(column.ndim - 1)) if number.entry is not None else ...
            column[index] += (factor * change).reshape(-1, *(1,) * (column[index].ndim - 1))
            values[number.leaf.path] = column

    def _initial_states(
        self, scenario: Scenario, loop: Loop, values: Mapping[str, Array]
    ) -> tuple[Array, Array, Array]:
        """Return initial states, shape (nq, n) and (nv, n), and references of each robot."""
        varied = [x for path, x in values.items() if path.partition(".")[0] in _START_WORDS]
        key = [loop.plant, loop.trajectory, *varied]
        if self._base is not None and _equal(key, self._base[0]):
            return self._base[1]  # type: ignore[no-any-return]
        refs, n = scenario.references(values, self.n), self.n
        if scenario.spread and all(x is None for x in self.start):
            q, v = scenario.starts(values, n, refs)
        else:
            q, v = start_of(loop.plant, scenario.reference, *self.start)
            if "start" in values:
                q = np.array([loop.integrate(q, x) for x in values["start"]], float)
            v = v + values.get("start_rate", 0.0)
        q, v = (np.broadcast_to(x, (n, x.shape[-1])) for x in (q, v))
        empty = np.zeros((len(scenario.t), 0, n))
        tracks = empty if refs is None else np.concatenate([x.swapaxes(1, 2) for x in refs], axis=1)
        result = q.T, v.T, tracks
        if self._base is None:
            self._base = key, result
        return result

    def directions(self, inputs: Inputs, changes: Mapping[str, Any]) -> list[Direction]:
        """Return the effect of each entry of each number on the inputs.

        A number of the law has the slope 1. Other inputs that depend on a number in Python, such as the
        reference, are differentiated by differences of order 4, at a bound of the number by one-sided ones.
        """
        directions = list[Direction]()
        for path, number in self.numbers.items():
            key = number.leaf.path
            value = np.asarray(changes.get(key, self.nominal[key]), float)
            leaf = self.machine.tape.parameters.get(key)
            rows = slice(0, 0) if leaf is None else slice(leaf.first, leaf.first + value.size)
            indices = np.arange(value.size).reshape(value.shape)

            def inputs_at(step: Any, key: str = key, value: Array = value, rows: slice = rows) -> Inputs:
                new_value = value + step
                with argument_errors(f"{key} has no derivative here, because a nearby value fails: "):
                    result = self.inputs({**changes, key: new_value if new_value.ndim else float(new_value)})
                result.rows[rows] = inputs.rows[rows]  # its own effect is known
                return result

            declared: Any = number.leaf.declared
            steps, is_central = declared.difference_steps(value, _STEP)
            if path not in self.pure:
                self.pure[path] = all(map(np.array_equal, inputs_at(steps), inputs))
            for entry in self.entries(number):
                row = -1 if leaf is None else leaf.first + int(indices[entry])
                other = None
                if not self.pure[path]:
                    h = np.zeros(value.shape)
                    h[entry] = steps[entry]
                    shares, weights, divisor = _CENTRAL if is_central[entry] else _ONE_SIDED
                    points = zip(inputs, *(inputs_at(h * share) for share in shares), strict=True)
                    sums = (
                        sum(w * _minus(x, x0) for w, x in zip(weights, others, strict=True))
                        for x0, *others in points
                    )
                    other = Inputs(*(total / (divisor * h[entry]) for total in sums))
                directions.append(Direction(path, entry, row, other))
        return directions

    def run(
        self,
        machine: tuple[LoopTape, Program],
        inputs: Inputs,
        robots: slice,
        extra: Sequence[Array] = (),
        first: int = 0,
        copies: int = 1,
        record: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return the states after the last sample, shape (S, m), and the kept values in blocks.

        Parameters
        ----------
        machine : (LoopTape, Program)
            Tape and machine code.
        inputs : Inputs
            Inputs of m columns.
        robots : slice
            Robots of the columns, for their noise.
        extra : sequence of ndarray, shape (N + 1,)
            Further columns of the samples.
        first : int
            Index of the first sample.
        copies : int
            Number of columns of a robot.
        record : ndarray, shape (blocks, N + 1, S, lanes), optional
            First tracks of the columns, in blocks; `Inputs.tracks` are the others.
        """
        tape, program = machine
        states, rows, uniforms, samples, tracks = inputs
        m, lanes = states.shape[1], program.shape.width
        blocks = aligned((-(-m // lanes), len(tape.states) + tape.rows + len(tape.keys), lanes))
        ids, seed = range(self.n)[robots], self.scenario.seed
        keys = [np.repeat(robot_keys(seed, name, ids).view(np.float64), copies)[None] for name in tape.keys]
        program.set_rows(blocks, 0, np.concatenate([states, rows, *keys]))
        size = len(blocks), len(samples), tape.outputs_kept + tape.tracks, lanes
        kept, count = aligned(size, empty=True), 0
        if record is not None:
            count = record.shape[2]
            kept[:, :, tape.outputs_kept : tape.outputs_kept + count] = record
        if tape.tracks > count:
            program.set_tracks(kept, tracks, count)
        empty = np.empty((len(samples), 0))
        columns = [samples[:, 1:], *(np.reshape(x, (len(samples), 1)) for x in extra)]
        table = program.samples_of(samples[:, 0], (empty,) * 3, uniforms, columns, first)
        program.launch(blocks, table, uniforms, kept, m, 1, threads=processors(), first=first)
        final = blocks.swapaxes(0, 1)[: len(tape.states)].reshape(len(tape.states), -1)[:, :m]
        return final, kept

    def plain(self, inputs: Inputs) -> Array:
        """Return the states after the last sample, shape (S, n)."""
        machine = self.machine
        return self.run(machine.of("plain", lambda: machine.plain, self.n > 1), inputs, slice(None))[0]

    def mode(self, losses: int = 1) -> tuple[str, str]:
        """Return the mode with the lower cost for a number of losses, and the reason."""
        count = sum(len(self.entries(number)) for number in self.numbers.values())
        if "slides" in self.machine.tape.kept:
            return "forward", "dry friction at the wheels"
        return "forward" if count <= _FORWARD * losses else "reverse", f"{count} number{'s' * (count > 1)}"

    def kinks(self, inputs: Inputs) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """Return how often each robot changes the side of a kink, and between sticking and sliding, (n,)."""
        program = self.machine.of("watching", self.machine.kink_recorder, self.n > 1)
        counts = np.zeros((2, self.n), int)
        for robots in self._groups(program[0].outputs_kept, len(inputs.samples)):
            part = inputs.subset(robots)
            kept = program[1].kept_samples(self.run(program, part, robots)[1], part.states.shape[1])
            for row, name in enumerate(("sides", "slides")):
                if name in kept:
                    counts[row, robots] = np.count_nonzero(np.diff(kept[name], axis=1), axis=(1, 2))
        return counts[0], counts[1]

    def _groups(self, size: int, samples: int) -> list[slice]:
        """Return groups of robots whose kept values, `size` for each sample, are affordable."""
        step = max(8, int(_RECORD / (8 * max(1, size) * samples)))
        return [slice(k, min(k + step, self.n)) for k in range(0, self.n, step)]

    def tangents(
        self, inputs: Inputs, directions: Sequence[Direction]
    ) -> tuple[Array, Array, dict[str, Array]]:
        """Return final states (S, n), their tangents (S, n, P), and kept values, shape (n P, N + 1, ...)."""
        machine, n, P = self.machine, self.n, len(directions)
        rows, series = _varied_inputs(directions)
        operations = [*rows, *series]
        key = "tangent", tuple(operations)
        program = machine.of(key, lambda: tangent(replaced(machine.tape, counted=[]), operations), n * P > 1)
        S = len(machine.tape.states)
        slopes = np.zeros((S, n, P))
        row_slopes = np.zeros((len(rows), n, P))
        tracks = np.zeros((len(inputs.samples), len(series), n, P))
        for p, direction in enumerate(directions):
            if direction.row >= 0:
                row_slopes[rows.index(("row", direction.row)), :, p] = 1.0
            if direction.other is not None:
                slopes[:, :, p] = direction.other.states
                for j, (kind, i) in enumerate(rows):
                    row_slopes[j, :, p] += direction.other[1][i] if kind == "row" else direction.other[2][i]
                for j, (kind, i) in enumerate(series):
                    column = direction.other[3][:, i, None] if kind == "sample" else direction.other[4][:, i]
                    tracks[:, j, :, p] = column
        final, kept = np.empty((2 * S, n, P)), dict[str, list[Array]]()
        size = P * (program[0].outputs_kept + program[0].tracks + 1)
        for robots in self._groups(size, len(inputs.samples)):
            part = inputs.subset(robots)

            def widen(x: Array, with_: Array) -> Array:
                stacked = np.concatenate([np.repeat(x[..., None], P, axis=-1), with_], axis=-3)
                return stacked.reshape(*stacked.shape[:-2], stacked.shape[-2] * P)

            arguments = part._replace(
                states=widen(part.states, slopes[:, robots]),
                rows=widen(part.rows, row_slopes[:, robots]),
                tracks=widen(part.tracks, tracks[:, :, robots]),
            )
            states, values = self.run(program, arguments, robots, copies=P)
            final[:, robots] = states.reshape(2 * S, -1, P)
            for name, x in program[1].kept_samples(values, arguments.states.shape[1]).items():
                kept.setdefault(name, []).append(x)
        return final[:S, :, 0], final[S:], {name: np.concatenate(x) for name, x in kept.items()}

    def adjoints(
        self, inputs: Inputs, directions: Sequence[Direction], loss_states: Sequence[int]
    ) -> tuple[Array, Array]:
        """Return final states (S, n), and the slopes of L of them by each direction, shape (L, n, P)."""
        machine, n, L = self.machine, self.n, len(loss_states)
        params, series_inputs = _varied_inputs(directions)
        columns, S = inputs.samples.shape[1], len(machine.tape.states)
        record = machine.of("recording", machine.state_recorder, n > 1)
        key = "adjoint", tuple(params), tuple(series_inputs)
        code = machine.of(key, lambda: adjoint(machine.tape, params, columns, series_inputs), n * L > 1)
        final, slopes = np.empty((S, n)), np.zeros((L, n, len(directions)))
        count = len(inputs.samples)
        for robots in self._groups(S + len(series_inputs) * L, count):
            part = inputs.subset(robots)
            final[:, robots], kept = self.run(record, part, robots)
            m, tracks, track_record = part.states.shape[1], part.tracks[::-1], None
            if L == 1:  # the record has the layout of the tracks
                track_record = kept[:, ::-1, :S]
            else:
                states = record[1].kept_samples(kept, m)["state"]
                tracks = np.concatenate([np.moveaxis(states, 0, 2)[::-1], tracks], axis=1)
            seed = np.zeros((S + len(params), m, L))
            seed[loss_states, :, range(L)] = 1.0
            arguments = part._replace(
                states=seed.reshape(len(seed), -1),
                rows=np.repeat(part.rows, L, axis=1),
                samples=part.samples[::-1],
                tracks=np.repeat(tracks, L, axis=2),
            )
            indices = [index_bits(count)]
            finals, by_sample = self.run(code, arguments, robots, indices, copies=L, record=track_record)
            adjoints = finals.reshape(len(finals), m, L)
            dx = code[1].kept_samples(by_sample, m * L)["sample"].reshape(m, L, count, -1)[:, :, ::-1]
            rows = {one: adjoints[S + j] for j, one in enumerate(params)}
            for p, one in enumerate(directions):
                total = np.zeros((m, L))
                if one.row >= 0:
                    total += rows["row", one.row]
                if one.other is not None:
                    other = one.other.subset(robots)
                    total += np.einsum("sm,sml->ml", other.states, adjoints[:S])
                    for (kind, i), x in rows.items():
                        total += x * (other.rows[i][:, None] if kind == "row" else other.uniforms[i])
                    for j, (kind, i) in enumerate(series_inputs):
                        series = other.samples[:, i, None] if kind == "sample" else other.tracks[:, i]
                        total += np.einsum("mlk,km->ml", dx[..., j], np.broadcast_to(series, (count, m)))
                slopes[:, robots, p] = total.T
        return final, slopes


def problem_of(
    plant: Any,
    controller: Any,
    trajectory: Any,
    recorder: Callable[[Scenario], Any],
    by: Sequence[str],
    start: Any = (None, None),
    **options: Any,
) -> Problem:
    """Return the problem of a loop.

    Parameters
    ----------
    plant, controller, trajectory
        Parts of the loop.
    recorder : callable
        Function ``recorder(scenario)`` that returns the recorder.
    by, start
        See `Problem`.
    **options
        Other arguments of `Scenario`.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, or the loop cannot be compiled.
    """
    check_paths(by)
    arguments = {"robot": plant, "controller": controller, "trajectory": trajectory, "metrics": ()}
    options["spread"] = options.get("spread") or {}
    with loop_errors():
        scenario = _expand_gains(Scenario(**arguments, **options), by)
        return Problem(scenario, recorder(scenario), by, start)


def check_paths(by: Any) -> Sequence[str]:
    """Return the paths of some numbers.

    Raises
    ------
    InvalidArgument
        If they are no sequence, or there are none.
    """
    return sequence("by", by, "paths of numbers, such as ['controller.kp']", 1)


def _expand_gains(scenario: Scenario, by: Sequence[str]) -> Scenario:
    """Return the scenario with a number for each coordinate where `by` names one of a gain."""
    refs, gains = named(scenario.nominal_loop), dict[str, Any]()
    for ref in (match for name in by for match in match_refs(scenario.nominal_loop, name, refs, "by")):
        if ref.entry is not None and np.ndim(ref.leaf.value) < len(ref.entry):
            size = 1 + max(entry[-1] for entry in ref.leaf.entries.values())
            gains[ref.leaf.path] = np.full(size, float(ref.leaf.value))
    if not gains:
        return scenario
    return replaced(scenario, **_part_arguments(replace(scenario.nominal_loop, gains)))


def _set_refs(loop: Loop, name: str, refs: Mapping[str, NumberRef]) -> list[NumberRef]:
    """Return the numbers that a name means and that have a value."""
    matches = match_refs(loop, name, refs, "by")
    numbers = [ref for ref in matches if ref.leaf.value is not None]
    required(f"by has {name!r}, {matches[0].meaning}, which", numbers or None, "a number of the loop")
    return numbers


def _part_arguments(loop: Loop) -> dict[str, Any]:
    """Return the parts of a loop as arguments of a scenario."""
    names = "controller", "trajectory", "forces"
    return {"robot": loop.plant, **{name: getattr(loop, name) for name in names}}


@contextmanager
def loop_errors() -> Iterator[None]:
    """Enter a context in which a loop without derivative raises `InvalidArgument`."""
    unable = argument_errors("this loop has no derivative: ", of=NotTraceable)
    with unable, np.errstate(all="ignore"), pause_gc():
        yield


def _index_of(number: NumberRef, ndim: int) -> Any:
    """Return the index of a number in the array of its leaf; all entries if it is the array."""
    return number.place(ndim) if number.entry is not None else ...


def _minus(a: Array, b: Array) -> Array:
    """Return a - b; 0 for equal infinite numbers, such as the smallest value of no sample."""
    return np.where(a == b, 0.0, a - b)


def _equal(key: list[Any], other: list[Any]) -> bool:
    """Return whether keys contain the same objects or equal arrays."""
    is_same = (x is y or np.array_equal(x, y) for x, y in zip(key, other, strict=False))
    return len(key) == len(other) and all(is_same)
