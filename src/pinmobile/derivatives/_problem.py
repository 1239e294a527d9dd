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

from pinmobile.arrays import Array
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
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.loop import (
    Loop,
    SameAs,
    Scenario,
    Trace,
    arrays_of,
    initial_memories,
    initial_memory,
    sample_reference,
    scheduled_rows,
    start_of,
    traced_numbers,
)
from pinmobile.parts import evolved, match_refs, refs_of, replace
from pinmobile.trajectories import Reference

_FEW = 8  # numbers for which forward mode is selected
_STEP = 1e-3  # relative step of differences of what Python computes before the first sample
_MOST = 32  # machines that are kept
_BEGIN = "plant", "start", "start_rate", "trajectory"  # first words of numbers that change the start
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

    def some(self, robots: slice) -> Inputs:
        """Return the inputs of some robots."""
        own = {"states": self.states, "rows": self.rows, "tracks": self.tracks}
        return self._replace(**{name: x[..., robots] for name, x in own.items()})


class Direction(NamedTuple):
    """Effect of a number on the inputs: slope 1 of a row, and slopes of others (None: none)."""

    path: str
    entry: tuple[int, ...]
    row: int
    other: Inputs | None


def _affected(directions: Sequence[Direction]) -> tuple[list[_Input], list[_Input]]:
    """Return the inputs of a run, and those of each sample, that depend on some numbers."""
    run: list[_Input] = [("row", one.row) for one in directions if one.row >= 0]
    samples: list[_Input] = []
    for other in (one.other for one in directions if one.other is not None):
        rows, series = (other.rows, other.uniforms), (other.samples.T, other.tracks.swapaxes(0, 1))
        for found, kinds, arrays in ((run, _RUN, rows), (samples, _SERIES, series)):
            for kind, x in zip(kinds, arrays, strict=True):
                found += [(kind, i) for i, each in enumerate(x) if np.any(each)]
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

    def of(self, key: Any, make: Callable[[], LoopTape], many: bool) -> tuple[LoopTape, Program]:
        """Return tape and program of a purpose, which are made once."""
        key = (key, many)
        if key not in self.programs:
            tape = make()
            self.programs[key] = tape, Program(tape, shape=Shape(Target.host().lanes if many else 1, 1))
        return self.programs[key]

    @property
    def plain(self) -> LoopTape:
        """Loop that keeps nothing but its states."""
        return replaced(self.tape, kept={}, counted=[])

    def recording(self) -> LoopTape:
        """Return the loop that keeps the states of all samples."""
        nodes = [now for now, _ in self.tape.states]
        return replaced(self.plain, kept={"state": ((len(nodes),), nodes)})

    def watching(self) -> LoopTape:
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
        known = refs_of(scenario.given)
        self.named_by = {name: match_refs(scenario.given, name, known, "by") for name in by}
        self.numbers = {one.path: one for some in self.named_by.values() for one in some}
        numbers = traced_numbers(self.loop)
        spread = dict(scenario.entries) if is_ensemble else {}
        for path in {one.leaf.path for one in self.numbers.values()} & numbers.keys():
            spread[path] = np.ones(np.shape(numbers[path]), bool)
        self.given = {path: np.asarray(x.leaf.value, float) for path, x in known.items() if not x.label}
        self.pure: dict[str, bool] = {}
        self._base: Any = None
        self.spread, self.own = spread, scenario.has_own_references
        self.machine = self._machine()

    def _machine(self) -> Machine:
        scenario, loop = self.scenario, self.loop
        begun = initial_memory(loop, scenario.context)
        others = loop.substeps, loop.steps, tuple(map(np.shape, scenario.reference)), self.own, "derivatives"
        self.identity = Identity.of(loop, begun[2:], self.spread, others)
        key = self.identity.key
        known = _machines.get(key)
        if known is None:
            first = Reference(*(x[0] for x in scenario.reference))
            begin = start_of(loop.plant, scenario.reference, *self.start)
            parts = loop, scenario.context, begin, first, self.identity, self.spread, self.own
            traced = Trace(*parts, own_schedules=True).result()
            longest = max((ring.samples for ring in traced.rings), default=0)
            known = _machines[key] = Machine(expand_delays(traced), longest, self.identity.kept)
            while len(_machines) > _MOST:
                _machines.popitem(last=False)
        return known

    def _changed(self, changes: Mapping[str, Any]) -> tuple[Scenario, Loop]:
        """Return scenario and loop with other numbers, by path."""
        loop, base = replace(self.loop, changes), self.scenario
        if loop.plant is self.loop.plant and loop.trajectory is self.loop.trajectory:
            return base, loop
        scenario = copy(base)  # without what it has derived
        reference = sample_reference(loop.trajectory, base.t, loop.plant)
        scenario.__dict__.update(_own_parts(loop), reference=reference)
        return scenario, loop

    def inputs(self, changes: Mapping[str, Any]) -> Inputs:
        """Return the inputs of the machine code for other numbers than the given ones, by path."""
        n, tape = self.n, self.machine.tape
        scenario, loop = self._changed(changes) if changes else (self.scenario, self.loop)
        values = dict(self.values)
        for path, value in changes.items():
            if path in values or path.startswith("start"):
                values[path] = values.get(path, np.zeros((n, 1))) + (np.asarray(value) - self.given[path])
        self._follow(changes, values)
        q, v, tracks = self._begun(scenario, loop, values)
        states: Array = np.zeros((len(tape.states), n))
        rows: Array = np.zeros((tape.rows, n))
        uniforms: Array = np.zeros(tape.uniforms)
        uniforms[0] = scenario.dt / loop.substeps
        states[: len(q) + len(v)] = np.concatenate([q, v])
        into: dict[str, Any] = {"state": states, "row": rows, "uniform": uniforms}
        numbers = traced_numbers(loop)

        def put(leaf: Any, value: Array) -> None:
            if leaf.kind == "uniform" or value.ndim == len(leaf.shape):
                flat: Array = np.broadcast_to(value, leaf.shape).ravel()
                into[leaf.kind][leaf.first : leaf.first + flat.size].T[...] = flat
            else:
                flat = value.reshape(n, -1).T
                into[leaf.kind][leaf.first : leaf.first + len(flat)] = flat

        for path, leaf in tape.parameters.items():
            put(leaf, np.asarray(values[path] if path in values else numbers[path], float))
        begun = arrays_of(initial_memory(loop, scenario.context))
        own = {path: x for path, x in self.values.items() if path in self.spread}
        owners = {path.partition(".")[0] for path in own}
        if any(leaf.owner in owners for leaf in tape.leaves):
            begun = initial_memories(
                loop, scenario.context, {path: values[path] for path in own}, n, self.identity
            )
        for leaf, value in zip(tape.leaves, begun, strict=True):
            put(leaf, np.asarray(value, float))
        given = scheduled_rows(loop, scenario.context) if tape.schedule_size else []
        given = [np.reshape(each, (len(scenario.t), -1)) for each in given]
        samples = np.concatenate([scenario.t[:, None], *scenario.reference, *given], axis=1)
        return Inputs(states, rows, uniforms, samples, tracks)

    def _follow(self, changes: Mapping[str, Any], values: dict[str, Array]) -> None:
        """Change the numbers of the spread that are the same as changed numbers, in proportion."""
        scenario = self.scenario
        for name, one in scenario.numbers.items() if changes else ():
            source: Any = scenario.spread[name]
            other, names = one, list[str]()
            while isinstance(source, SameAs):
                other = scenario.find(source.name)
                names = [each for each, found in scenario.numbers.items() if found.path == other.path]
                source = scenario.spread[names[0]] if names else None
            at = other.leaf.path
            if other is one or at not in changes:
                continue
            before, after = (np.asarray(x, float) for x in (self.given[at], changes[at]))
            place = other.place(before.ndim) if other.entry is not None else ...
            moved = float(np.ravel((after - before)[place])[0])
            share = self.draws[name] / (self.draws[names[0]] if names else float(other.value))
            own: Any = values[one.leaf.path].copy()
            into: Any = (slice(None), *one.place(own.ndim - 1)) if one.entry is not None else ...
            own[into] += (share * moved).reshape(-1, *(1,) * (own[into].ndim - 1))
            values[one.leaf.path] = own

    def _begun(
        self, scenario: Scenario, loop: Loop, values: Mapping[str, Array]
    ) -> tuple[Array, Array, Array]:
        """Return initial states, shape (nq, n) and (nv, n), and references of each robot."""
        moved = [x for path, x in values.items() if path.partition(".")[0] in _BEGIN]
        key = [loop.plant, loop.trajectory, *moved]
        if self._base is not None and _same(key, self._base[0]):
            return self._base[1]  # type: ignore[no-any-return]
        own, n = scenario.references(values, self.n), self.n
        if scenario.spread and all(x is None for x in self.start):
            q, v = scenario.starts(values, n, own)
        else:
            q, v = start_of(loop.plant, scenario.reference, *self.start)
            if "start" in values:
                q = np.array([loop.integrate(q, x) for x in values["start"]], float)
            v = v + values.get("start_rate", 0.0)
        q, v = (np.broadcast_to(x, (n, x.shape[-1])) for x in (q, v))
        nothing = np.zeros((len(scenario.t), 0, n))
        tracks = nothing if own is None else np.concatenate([x.swapaxes(1, 2) for x in own], axis=1)
        found = q.T, v.T, tracks
        if self._base is None:
            self._base = key, found
        return found

    def directions(self, inputs: Inputs, changes: Mapping[str, Any]) -> list[Direction]:
        """Return the effect of each entry of each number on the inputs.

        A number of the law has the slope 1. Other inputs that depend on a number in Python, such as the
        reference, are differentiated by central differences and Richardson's extrapolation.
        """
        every = list[Direction]()
        for path, one in self.numbers.items():
            at = one.leaf.path
            value = np.asarray(changes.get(at, self.given[at]), float)
            leaf = self.machine.tape.parameters.get(at)
            entries = [one.place(value.ndim)] if one.entry is not None else [*np.ndindex(value.shape)]
            rows = slice(0, 0) if leaf is None else slice(leaf.first, leaf.first + value.size)
            places = np.arange(value.size).reshape(value.shape)

            def moved(step: Any, at: str = at, value: Array = value, rows: slice = rows) -> Inputs:
                changed = value + step
                found = self.inputs({**changes, at: changed if changed.ndim else float(changed)})
                found.rows[rows] = inputs.rows[rows]  # its own effect is known
                return found

            if path not in self.pure:
                step = _STEP * np.maximum(1.0, np.abs(value))
                self.pure[path] = all(map(np.array_equal, moved(step), inputs))
            for entry in entries:
                row = -1 if leaf is None else leaf.first + int(places[entry])
                other = None
                if not self.pure[path]:
                    h = np.zeros(value.shape)
                    h[entry] = _STEP * max(1.0, abs(float(value[entry])))
                    points = zip(*(moved(h * x) for x in (0.5, -0.5, 1.0, -1.0)), strict=True)
                    other = Inputs(
                        *((8 * _less(a, b) - _less(c, d)) / (6 * h[entry]) for a, b, c, d in points)
                    )
                every.append(Direction(path, entry, row, other))
        return every

    def run(
        self,
        made: tuple[LoopTape, Program],
        inputs: Inputs,
        robots: slice,
        extra: Sequence[Array] = (),
        first: int = 0,
        copies: int = 1,
        recorded: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return the states after the last sample, shape (S, m), and the kept values in blocks.

        Parameters
        ----------
        made : (LoopTape, Program)
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
        recorded : ndarray, shape (blocks, N + 1, S, lanes), optional
            First tracks of the columns, in blocks; `Inputs.tracks` are the others.
        """
        tape, program = made
        states, rows, uniforms, samples, tracks = inputs
        m, lanes = states.shape[1], program.shape.width
        blocks = aligned((-(-m // lanes), len(tape.states) + tape.rows + len(tape.keys), lanes))
        whose, seed = range(self.n)[robots], self.scenario.seed
        keys = [np.repeat(robot_keys(seed, name, whose).view(np.float64), copies)[None] for name in tape.keys]
        program.set_rows(blocks, 0, np.concatenate([states, rows, *keys]))
        size = len(blocks), len(samples), tape.outputs_kept + tape.tracks, lanes
        kept, known = aligned(size, empty=True), 0
        if recorded is not None:
            known = recorded.shape[2]
            kept[:, :, tape.outputs_kept : tape.outputs_kept + known] = recorded
        if tape.tracks > known:
            program.set_tracks(kept, tracks, known)
        nothing = np.empty((len(samples), 0))
        columns = [samples[:, 1:], *(np.reshape(each, (len(samples), 1)) for each in extra)]
        given = program.samples_of(samples[:, 0], (nothing,) * 3, uniforms, columns, first)
        program.launch(blocks, given, uniforms, kept, m, 1, threads=processors(), first=first)
        final = blocks.swapaxes(0, 1)[: len(tape.states)].reshape(len(tape.states), -1)[:, :m]
        return final, kept

    def plain(self, inputs: Inputs) -> Array:
        """Return the states after the last sample, shape (S, n)."""
        machine = self.machine
        return self.run(machine.of("plain", lambda: machine.plain, self.n > 1), inputs, slice(None))[0]

    def mode(self, losses: int = 1) -> tuple[str, str]:
        """Return the mode with the lower cost for a number of losses, and the reason."""
        count = sum(1 if x.entry is not None else int(np.size(x.leaf.value)) for x in self.numbers.values())
        if "slides" in self.machine.tape.kept:
            return "forward", "dry friction at the wheels"
        return "forward" if count <= _FEW * losses else "reverse", f"{count} number{'s' * (count > 1)}"

    def kinks(self, inputs: Inputs) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """Return how often each robot changes the side of a kink, and between sticking and sliding, (n,)."""
        made = self.machine.of("watching", self.machine.watching, self.n > 1)
        found = np.zeros((2, self.n), int)
        for some in self._groups(made[0].outputs_kept, len(inputs.samples)):
            part = inputs.some(some)
            kept = made[1].kept_samples(self.run(made, part, some)[1], part.states.shape[1])
            for row, name in enumerate(("sides", "slides")):
                if name in kept:
                    found[row, some] = np.count_nonzero(np.diff(kept[name], axis=1), axis=(1, 2))
        return found[0], found[1]

    def _groups(self, size: int, samples: int) -> list[slice]:
        """Return groups of robots whose kept values, `size` for each sample, are affordable."""
        step = max(8, int(_RECORD / (8 * max(1, size) * samples)))
        return [slice(k, min(k + step, self.n)) for k in range(0, self.n, step)]

    def tangents(
        self, inputs: Inputs, directions: Sequence[Direction]
    ) -> tuple[Array, Array, dict[str, Array]]:
        """Return final states (S, n), their tangents (S, n, P), and kept values, shape (n P, N + 1, ...)."""
        machine, n, P = self.machine, self.n, len(directions)
        rows, tracked = _affected(directions)
        operations = [*rows, *tracked]
        key = "tangent", tuple(operations)
        made = machine.of(key, lambda: tangent(replaced(machine.tape, counted=[]), operations), n * P > 1)
        S = len(machine.tape.states)
        slopes = np.zeros((S, n, P))
        own = np.zeros((len(rows), n, P))
        tracks = np.zeros((len(inputs.samples), len(tracked), n, P))
        for p, one in enumerate(directions):
            if one.row >= 0:
                own[rows.index(("row", one.row)), :, p] = 1.0
            if one.other is not None:
                slopes[:, :, p] = one.other.states
                for j, (kind, i) in enumerate(rows):
                    own[j, :, p] += one.other[1][i] if kind == "row" else one.other[2][i]
                for j, (kind, i) in enumerate(tracked):
                    column = one.other[3][:, i, None] if kind == "sample" else one.other[4][:, i]
                    tracks[:, j, :, p] = column
        final, kept = np.empty((2 * S, n, P)), dict[str, list[Array]]()
        size = P * (made[0].outputs_kept + made[0].tracks + 1)
        for some in self._groups(size, len(inputs.samples)):
            part = inputs.some(some)

            def wide(x: Array, with_: Array) -> Array:
                both = np.concatenate([np.repeat(x[..., None], P, axis=-1), with_], axis=-3)
                return both.reshape(*both.shape[:-2], both.shape[-2] * P)

            given = part._replace(
                states=wide(part.states, slopes[:, some]),
                rows=wide(part.rows, own[:, some]),
                tracks=wide(part.tracks, tracks[:, :, some]),
            )
            states, values = self.run(made, given, some, copies=P)
            final[:, some] = states.reshape(2 * S, -1, P)
            for name, x in made[1].kept_samples(values, given.states.shape[1]).items():
                kept.setdefault(name, []).append(x)
        return final[:S, :, 0], final[S:], {name: np.concatenate(x) for name, x in kept.items()}

    def adjoints(
        self, inputs: Inputs, directions: Sequence[Direction], at: Sequence[int]
    ) -> tuple[Array, Array]:
        """Return final states (S, n), and the slopes of L of them by each direction, shape (L, n, P)."""
        machine, n, L = self.machine, self.n, len(at)
        wanted, tracked = _affected(directions)
        columns, S = inputs.samples.shape[1], len(machine.tape.states)
        record = machine.of("recording", machine.recording, n > 1)
        key = "adjoint", tuple(wanted), tuple(tracked)
        back = machine.of(key, lambda: adjoint(machine.tape, wanted, columns, tracked), n * L > 1)
        final, slopes = np.empty((S, n)), np.zeros((L, n, len(directions)))
        count = len(inputs.samples)
        for some in self._groups(S + len(tracked) * L, count):
            part = inputs.some(some)
            final[:, some], kept = self.run(record, part, some)
            m, tracks, recorded = part.states.shape[1], part.tracks[::-1], None
            if L == 1:  # the record has the layout of the tracks
                recorded = kept[:, ::-1, :S]
            else:
                states = record[1].kept_samples(kept, m)["state"]
                tracks = np.concatenate([np.moveaxis(states, 0, 2)[::-1], tracks], axis=1)
            seed = np.zeros((S + len(wanted), m, L))
            seed[at, :, range(L)] = 1.0
            given = part._replace(
                states=seed.reshape(len(seed), -1),
                rows=np.repeat(part.rows, L, axis=1),
                samples=part.samples[::-1],
                tracks=np.repeat(tracks, L, axis=2),
            )
            indices = [index_bits(count)]
            found, by_sample = self.run(back, given, some, indices, copies=L, recorded=recorded)
            adjoints = found.reshape(len(found), m, L)
            each = back[1].kept_samples(by_sample, m * L)["sample"].reshape(m, L, count, -1)[:, :, ::-1]
            rows = {one: adjoints[S + j] for j, one in enumerate(wanted)}
            for p, one in enumerate(directions):
                total = np.zeros((m, L))
                if one.row >= 0:
                    total += rows["row", one.row]
                if one.other is not None:
                    other = one.other.some(some)
                    total += np.einsum("sm,sml->ml", other.states, adjoints[:S])
                    for (kind, i), x in rows.items():
                        total += x * (other.rows[i][:, None] if kind == "row" else other.uniforms[i])
                    for j, (kind, i) in enumerate(tracked):
                        series = other.samples[:, i, None] if kind == "sample" else other.tracks[:, i]
                        total += np.einsum("mlk,km->ml", each[..., j], np.broadcast_to(series, (count, m)))
                slopes[:, some, p] = total.T
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
    own = {"robot": plant, "controller": controller, "trajectory": trajectory, "metrics": ()}
    options["spread"] = options.get("spread") or {}
    with differentiated():
        scenario = _grown(Scenario(**own, **options), by)
        return Problem(scenario, recorder(scenario), by, start)


def _grown(scenario: Scenario, by: Sequence[str]) -> Scenario:
    """Return the scenario with a number for each coordinate where `by` names one of a gain."""
    known, grown = refs_of(scenario.given), dict[str, Any]()
    for one in (each for name in by for each in match_refs(scenario.given, name, known, "by")):
        if one.entry is not None and np.ndim(one.leaf.value) < len(one.entry):
            size = 1 + max(entry[-1] for entry in one.leaf.entries.values())
            grown[one.leaf.path] = np.full(size, float(one.leaf.value))
    if not grown:
        return scenario
    return replaced(scenario, **_own_parts(replace(scenario.given, grown)))


def _own_parts(loop: Loop) -> dict[str, Any]:
    """Return the parts of a loop as arguments of a scenario."""
    names = "controller", "trajectory", "forces"
    return {"robot": loop.plant, **{name: getattr(loop, name) for name in names}}


@contextmanager
def differentiated() -> Iterator[None]:
    """Enter a context in which a loop without derivative raises `InvalidArgument`."""
    try:
        with np.errstate(all="ignore"), pause_gc():
            yield
    except NotTraceable as error:
        raise InvalidArgument(f"this loop has no derivative: {error.reason}") from error


def _less(a: Array, b: Array) -> Array:
    """Return a - b; 0 for equal infinite numbers, such as the smallest value of no sample."""
    return np.where(a == b, 0.0, a - b)


def _same(key: list[Any], known: list[Any]) -> bool:
    """Return whether keys contain the same objects or equal arrays."""
    pairs = zip(key, known, strict=False)
    return len(key) == len(known) and all(x is y or np.array_equal(x, y) for x, y in pairs)


class Evaluation(NamedTuple):
    """Losses of n robots and their derivatives.

    Attributes
    ----------
    values : ndarray, shape (L, n)
        Losses.
    slopes : ndarray, shape (L, n, P)
        Derivatives by each entry of each number.
    directions : list of Direction
        The entries.
    inputs : Inputs
        Inputs of the machine code.
    """

    values: Array
    slopes: Array
    directions: list[Direction]
    inputs: Inputs


def evaluated(problem: Problem, changes: Mapping[str, Any], mode: str | None) -> Evaluation:
    """Return the losses of the robots with other numbers, and their derivatives in a mode.

    Parameters
    ----------
    problem : Problem
        Loop whose recorder is `Losses`.
    changes : mapping of str to ndarray
        Numbers by path.
    mode : str, optional
        ``"forward"`` or ``"reverse"``; None: only the values.
    """
    losses = problem.loop.recorder.losses
    first = next(leaf.first for leaf in problem.machine.tape.leaves if leaf.owner == "recorder")
    at = [first + i for i in range(len(losses))]
    with differentiated():
        inputs = problem.inputs(changes)
        directions = problem.directions(inputs, changes) if mode else []
        if mode == "forward":
            final, tangents, _ = problem.tangents(inputs, directions)
            slopes = tangents[at]
        elif mode == "reverse":
            final, slopes = problem.adjoints(inputs, directions, at)
        else:
            final, slopes = problem.plain(inputs), np.zeros((len(at), problem.n, 0))
        pairs = [one.finished(final[i], len(inputs.samples)) for one, i in zip(losses, at, strict=True)]
        values = np.array([value for value, _ in pairs])
        slopes = slopes * np.array([slope for _, slope in pairs])[:, :, None]
    return Evaluation(values, slopes, directions, inputs)
