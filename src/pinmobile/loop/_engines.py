"""Runs of a loop: in Python, compiled, and in Python with compiled plant and forces; their machine code."""

from __future__ import annotations

import pickle
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import (
    LOOP,
    Cache,
    Identity,
    LoopTape,
    Outcome,
    Program,
    Target,
    aligned,
    leaves,
    map_leaves,
    pause_gc,
    robot_keys,
)
from pinmobile.errors import InvalidArgument, NotFinite
from pinmobile.loop._loop import (
    NOTHING,
    Loop,
    Record,
    RecordedStep,
    Sample,
    Samples,
    advance,
    initial_state,
    is_alive,
    part_signals,
    step,
)
from pinmobile.loop._trace import (
    Trace,
    arrays_of,
    initial_memories,
    initial_memory,
    scheduled_rows,
    traced_numbers,
)
from pinmobile.parts import array, child, evolved, part
from pinmobile.plant import Context, stated
from pinmobile.signals import SignalSample
from pinmobile.trajectories import Reference

_CACHE_SIZE = 64  # programs
_lock = threading.Lock()
_programs: OrderedDict[Any, tuple[Program, list[Any]]] = OrderedDict()


class Compiled:
    """Machine code of a loop, with the numbers of the loop as its arguments.

    Parameters
    ----------
    loop : Loop
        Closed loop.
    context : Context
        Argument of the controller's `initial_state`.
    start : (ndarray, ndarray), shape (nq,), (nv,)
        Initial configuration and velocity.
    reference : Reference
        Reference of the first sample.
    spread : mapping of str to array of bool, optional
        Paths of the numbers that differ from robot to robot, with masks of the entries that differ.
    single : bool
        Whether the code runs one robot.
    own_reference : bool
        Whether each robot has its own reference.

    Raises
    ------
    NotTraceable
        If a law does not accept symbols.
    """

    def __init__(
        self,
        loop: Loop,
        context: Context,
        start: tuple[Array, Array],
        reference: Reference,
        *,
        spread: Mapping[str, Any] | None = None,
        single: bool = False,
        own_reference: bool = False,
    ) -> None:
        self.loop, self.context, self.spread = loop, context, spread or {}
        self.memory = memory = initial_memory(loop, context)
        options = loop.substeps, loop.steps, tuple(map(np.shape, reference)), single, own_reference
        self.identity = identity = Identity.of(loop, memory[2:], self.spread, options)
        with _lock:
            entry = _programs.get(identity.key)
        if entry is None:
            trace = partial(Trace, loop, context, start, reference, identity, self.spread, own_reference)
            with pause_gc():
                entry = _program_of(identity, trace, single), identity.kept
        self.program = entry[0]
        with _lock:
            _programs[identity.key] = entry
            _programs.move_to_end(identity.key)
            while len(_programs) > _CACHE_SIZE:
                _programs.popitem(last=False)

    @property
    def tape(self) -> LoopTape:
        """Tape of the loop."""
        return self.program.tape

    def first(self, values: Mapping[str, Array], n: int) -> list[Array]:
        """Return the memory before the first sample, arrays of shape (...), or (n, ...) if robots differ."""
        rows = {path: value for path, value in values.items() if self.tape.parameters[path].kind == "row"}
        owners = {path.partition(".")[0] for path in rows}
        numbers = [np.asarray(x, np.float64) for x in arrays_of(self.memory)]
        memories = numbers
        if any(leaf.owner in owners for leaf in self.tape.leaves):
            memories = initial_memories(self.loop, self.context, rows, n, self.identity)
        arrays = []
        for leaf, value, number in zip(self.tape.leaves, memories, numbers, strict=True):
            lead = (n,) if value.ndim > number.ndim else ()
            missing = len(leaf.shape) - number.ndim
            array = value.reshape((*lead, *(1,) * missing, *number.shape))
            arrays.append(np.broadcast_to(array, (*lead, *leaf.shape)))
        return arrays

    def run(
        self,
        start: tuple[Array, Array],
        t: Array,
        reference: Reference,
        *,
        values: Mapping[str, Array] = MappingProxyType({}),
        **options: Any,
    ) -> Outcome:
        """Return the result of a run, see `Program.run` for further options.

        Parameters
        ----------
        values : mapping of str to ndarray, shape (n, ...)
            Numbers of each robot, by the paths of the spread.
        """
        options["rows"] = scheduled_rows(self.loop, self.context) if self.tape.schedule_size else []
        options["values"] = {**traced_numbers(self.loop), **values}
        options["first"] = self.first(values, len(start[0]))
        h = self.context.dt / self.loop.substeps
        return self.program.run(start, t, reference, h=h, **options)

    def recorder_memory(self, outcome: Outcome) -> dict[str, Array]:
        """Return the recorder's memory after the last sample, by name, shape (n, ...)."""
        pairs = zip(self.tape.leaves, outcome.memory, strict=True)
        return {leaf.path[7:-2]: value for leaf, value in pairs if leaf.owner == "recorder"}


def _program_of(identity: Identity, trace: Callable[[], Trace], single: bool) -> Program:
    """Return the program of a loop, which this or another process traces."""
    cache, target = Cache(), Target.host()
    name = identity.digest if cache.folder is not None else None
    if name is not None:
        with suppress(Exception):  # the file is missing or damaged
            # The file is as trustworthy as the machine code in the same folder of the user.
            tape, shape, key = pickle.loads(cache.read(name, LOOP) or b"")
            return Program(tape, target, shape, cache=cache, key=key)
    program = Program(trace().result(), target, single=single, cache=cache)
    if name is not None:
        cache.write(name, pickle.dumps((program.tape, program.shape, program.key)), LOOP)
    return program


_U = "controller.u"


@part
class _FixedInput:
    """Controller whose input is a number of each robot."""

    u: Any = array()

    def initial_state(self, context: object) -> None:
        """Return None: the controller has no memory."""

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: None) -> Any:
        """Return the input."""
        return self.u, None


@part
class _PlantStep:
    """Plant with its forces as a plant with its own step, which contains all substeps and the projection."""

    inner: Any = child(Loop)

    def __getattr__(self, name: str) -> Any:
        if name in ("nq", "nv", "nu", "integrate", "difference", "coordinates"):
            return getattr(self.inner.dynamics, name)
        raise AttributeError(name)

    def initial_state(self, context: object) -> Any:
        """Return the memory of the plant before the first sample."""
        begin = stated(self.inner.dynamics, "initial_state")
        return None if begin is None else begin(context)

    def step(self, t: Any, q: Any, v: Any, u: Any, h: Any, f: Any, memory: Any) -> RecordedStep:
        """Return the state one sample later."""
        loop = self.inner
        a, q, v, memory = advance(loop, t, h / loop.substeps, q, v, u, memory)
        return RecordedStep(q, loop.dynamics.project(q, v) if loop.is_constrained else v, memory, a)

    def signals(self, t: Any, q: Any, v: Any, u: Any, f: Any, memory: Any) -> dict[str, Any]:
        """Return the signals of plant and forces."""
        signals = part_signals(self.inner, t, q, v, u, memory)
        return {name: pair for _, pairs in signals for name, pair in pairs.items()}


class CompiledPlant:
    """Plant with its forces for one loop; one call of machine code computes a step.

    Parameters
    ----------
    loop : Loop
        Closed loop.
    context : Context
        Argument of the controller's `initial_state`.
    q, v : ndarray, shape (nq,), (nv,)
        Initial configuration and velocity.

    Raises
    ------
    NotTraceable
        If plant, forces or integrator cannot be compiled.
    """

    def __init__(self, loop: Loop, context: Context, q: Array, v: Array) -> None:
        self.plant = plant = loop.plant
        self.nq, self.nv, self.nu = plant.nq, plant.nv, plant.nu
        self.integrate, self.difference = plant.integrate, plant.difference
        for name in ("inputs", "coordinates", "metrics", "evaluate_metrics"):
            if hasattr(plant, name):
                setattr(self, name, getattr(plant, name))
        law = _FixedInput(np.zeros(self.nu))
        inner = evolved(loop, {"controller": law, "recorder": None, "trajectory": None})
        outer = Loop(_PlantStep(inner), law, recorder=Samples())
        reference = Reference(*context.reference)
        first = Reference(*(part[0] for part in reference))
        spread = {_U: np.ones(self.nu, bool)}
        compiled = Compiled(outer, context, (q, v), first, spread=spread, single=True)
        program, self._tape = compiled.program, compiled.tape
        values, memory = traced_numbers(outer), compiled.memory
        arrays = [np.asarray(value, np.float64) for value in arrays_of(memory)]
        uniforms = program.uniforms_of(context.dt, values, arrays)
        self._block = program.blocks_of((q[None], v[None]), 1, values, arrays, {})
        self._row = self._block[0, :, 0]
        self._samples = program.samples_of(context.t, reference, uniforms, [])
        self._kept = aligned((1, 1, self._tape.outputs_kept, 1))
        self._dt, self._plant_memory = context.dt, memory.plant
        self._uniforms, self._counts, self._rings = uniforms, np.zeros(1, np.int32), aligned((1, 1))
        buffers = (self._samples, uniforms, self._rings, self._counts, self._kept)
        sample, uniform, rings, counts, kept = (array.ctypes.data for array in buffers)
        self._first, self._stride = sample, self._samples.strides[0]
        self._call = partial(program.code(len(context.t)), self._block.ctypes.data, 0, 1)
        self._tail = uniform, rings, counts, 1, 1, kept, 0
        self._u = len(self._tape.states) + self._tape.parameters[_U].first
        self._leaves = [leaf for leaf in self._tape.leaves if leaf.owner == "plant"]
        self._signals: dict[str, Any] = {}

    def initial_state(self, context: object) -> Any:
        """Return the memory of the plant before the first sample."""
        return self._plant_memory

    def step(self, t: float, q: Array, v: Array, u: Array, h: float, f: Any, memory: Any) -> RecordedStep:
        """Return the state one sample later; the machine code contains the forces."""
        row, nq, n = self._row, self.nq, self.nq + self.nv
        row[:nq], row[nq:n], row[self._u : self._u + self.nu] = q, v, u
        for leaf, (_, value) in zip(self._leaves, leaves(memory), strict=True):
            if leaf.kind == "state":
                row[leaf.first : leaf.end] = np.ravel(value)
        self._call(self._first + round(t / self._dt) * self._stride, 1, *self._tail)
        numbers, first, values = self._kept[0, 0, :, 0], 0, {}
        for name, (shape, nodes) in self._tape.kept.items():
            values[name] = numbers[first : first + len(nodes)].reshape(shape).copy()
            first += len(nodes)
        units = self._tape.units
        self._signals = {name: (unit, values[f"signal {name}"]) for name, unit in units.items()}
        plant_leaves = iter(self._leaves)

        def next_value(value: Any) -> Any:
            leaf = next(plant_leaves)
            is_fixed = leaf.kind != "state"
            return value if is_fixed else row[leaf.first : leaf.end].reshape(leaf.shape).copy()

        return RecordedStep(row[:nq].copy(), row[nq:n].copy(), map_leaves(memory, next_value), values["a"])

    def signals(self, *arguments: Any) -> dict[str, Any]:
        """Return the signals of plant and forces at the last sample."""
        return self._signals


def compile_plant(loop: Loop, context: Context, q: Array, v: Array) -> Loop:
    """Return the loop with compiled plant and forces; raise `NotTraceable` if they cannot be compiled."""
    plant = CompiledPlant(loop, context, q, v)
    return evolved(loop, {"plant": plant, "forces": (), "integrator": None, "substeps": 1})


def python_samples(loop: Loop, context: Context, q0: Array, v0: Array) -> Iterator[tuple[Sample, Record]]:
    """Yield the samples of a loop in Python until a number is not finite.

    Parameters
    ----------
    loop : Loop
        Checked closed loop.
    context : Context
        Argument of the controller's `initial_state`. The loop uses the reference at its times.
    q0, v0 : ndarray, shape (nq,) and (nv,)
        Initial configuration and velocity.
    """
    h, state, k = context.dt / loop.substeps, initial_state(loop, context, q0, v0), 0.0
    # Copies of the rows: a controller may write into its arguments.
    rows = zip(*(part.copy() for part in context.reference), strict=True)
    for t, row in zip(context.t.tolist(), rows, strict=True):
        try:
            next_state, sample, record = step(loop, k, t, h, state, Reference(*row))
        except InvalidArgument as error:
            if not np.isfinite(np.concatenate(state[:2])).all():
                return  # the part rejects a state that is not finite
            raise error if k else size_error(context, error) from error.__cause__
        yield sample, record
        state, k = next_state, k + 1.0


def size_error(context: Context, error: InvalidArgument) -> InvalidArgument:
    """Return an error of a controller; if the reference has fewer coordinates, its message says so."""
    n, count = context.reference.v.shape[1], len(context.coordinates)
    if n == count or " has shape " not in str(error):
        return error
    if n == max(context.reference_sizes, default=count):  # a reference contains no wheels
        return InvalidArgument(
            f"{error}; expected a controller of wheel torques: ControlAllocation(controller, robot) makes "
            "one from a controller of forces on the body"
        )
    return InvalidArgument(
        f"{error}; the reference has the first {n} of {count} coordinates, expected a controller of these "
        "coordinates, or a reference of all: WholeBody(robot, base, *joints) combines base and arms"
    )


class Run:
    """All samples of a loop, with a check that they are finite and near the reference.

    Parameters
    ----------
    loop : Loop
        Closed loop.
    context : Context
        Argument of the controller's `initial_state`. The loop uses the reference at its times.
    """

    failure: NotFinite | None = None

    def __init__(self, loop: Loop, context: Context) -> None:
        reference = context.reference
        self.desired = np.hstack([reference.q, reference.v])
        self.is_vector_space = stated(loop.plant, "is_vector_space") and reference.v.shape[1] == loop.plant.nv
        self.kept: dict[str, Array] = {}
        self.units: Mapping[str, str] = {}

    def fill(self, begin: int, end: int) -> None:
        """Compute the samples from `begin` to before `end`."""

    def samples(self, begin: int, end: int) -> tuple[Array, Array, Array, Array]:
        """Return q, v, a and u of the samples, one row per sample."""
        q, v, a, u = (self.kept[name][begin:end] for name in ("q", "v", "a", "u"))
        return q, v, a, u

    @np.errstate(over="ignore", invalid="ignore")  # an overflow gives False
    def is_valid(self, begin: int, end: int, limit: float) -> bool:
        """Return whether the samples are finite and near the reference; False if in doubt."""
        if not self.is_vector_space:
            return False
        q, v, a, u = self.samples(begin, end)
        errors = self.desired[begin:end] - np.hstack([q, v])  # errors on the circle are smaller
        return bool(is_alive(errors, limit, u, a).all())


class _Signals:
    """Recorder of signals only."""

    signals, errors = True, False

    def initial_state(self, n: int, nu: int) -> None:
        """Return None: the recorder has no memory."""

    def __call__(self, sample: Sample, state: None) -> Record:
        """Return an empty record; the sample contains the signals."""
        return NOTHING


class PythonRun(Run):
    """Run in Python, sample by sample, see `python_samples`."""

    def __init__(self, loop: Loop, context: Context, q0: Array, v0: Array) -> None:
        super().__init__(loop, context)
        self._times = context.t.tolist()
        self._samples = python_samples(evolved(loop, {"recorder": _Signals()}), context, q0, v0)
        sizes = {"q": loop.plant.nq, "v": loop.plant.nv, "a": loop.plant.nv, "u": loop.plant.nu}
        self.kept = {name: np.full((len(context.t), size), np.nan) for name, size in sizes.items()}
        self._first: Mapping[str, SignalSample] = {}

    def fill(self, begin: int, end: int) -> None:
        """Compute the samples from `begin` to before `end`; they end at a number that is not finite."""
        q, v, a, u = self.samples(0, len(self._times))
        try:
            for k, (sample, _) in zip(range(begin, end), self._samples, strict=False):
                q[k], v[k], a[k], u[k] = sample.q, sample.v, sample.a, sample.u
                if sample.signals or self._first:
                    self._keep(k, sample.signals)
        except NotFinite as error:
            self.failure = error  # the rest stays empty

    def _keep(self, k: int, signals: Mapping[str, SignalSample]) -> None:
        """Keep the signals of sample k, which must have the names, units and shapes of the first sample."""
        if not k:
            self._first, rows = signals, len(self._times)
            self.units = {name: signal.unit for name, signal in signals.items()}
            for name, signal in signals.items():
                self.kept[f"signal {name}"] = np.full((rows, *signal.value.shape), np.nan)
        for name in {**self._first, **signals}:
            form, expected = (_format_form(group.get(name)) for group in (signals, self._first))
            if form != expected:
                part = (signals.get(name) or self._first[name]).part
                message = f"{part}.signals[{name!r}] is {form} at t = {self._times[k]:g} s"
                raise InvalidArgument(f"{message}, expected {expected} as in the first sample")
            self.kept[f"signal {name}"][k] = signals[name].value


def _format_form(signal: SignalSample | None) -> str:
    return "missing" if signal is None else f"of unit {signal.unit!r} and shape {signal.value.shape}"


class CompiledRun(Run):
    """Compiled run, which computes all samples when it is made.

    Raises
    ------
    NotTraceable
        If a law cannot be compiled; the message contains its line and the code to write instead.
    """

    def __init__(self, loop: Loop, context: Context, q0: Array, v0: Array) -> None:
        super().__init__(loop, context)
        reference = Reference(*context.reference)
        first = Reference(*(part[0] for part in reference))
        compiled = Compiled(evolved(loop, {"recorder": Samples()}), context, (q0, v0), first, single=True)
        member = range(context.member, context.member + 1)
        keys = {name: robot_keys(context.seed, name, member) for name in compiled.tape.keys}
        run = compiled.run((q0[None], v0[None]), context.t, reference, keys=keys)
        self.kept, self.units = {name: x[0] for name, x in run.kept.items()}, compiled.tape.units
