"""A closed loop on a tape: what stands where, and what its memory is before the first sample."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.compiled.folding import ROBOT, SAMPLE, STATE
from pinmobile.compiled.memory import Line, Noise, Schedule, leaves
from pinmobile.compiled.parts import Parts, Place
from pinmobile.compiled.sample import Memory, integrate_of
from pinmobile.compiled.symbolic import entries, has_symbols, symbols
from pinmobile.compiled.tape import Node, Tape, evaluated, needed, operands
from pinmobile.compiled.tracing import tracing
from pinmobile.errors import NotTraceable

_WORTH_A_TABLE = 32  # operations of a sample


@dataclass(frozen=True)
class Leaf:
    """An array in the memory: whose it is, where it stands, and what it is on the tape.

    Attributes
    ----------
    owner, path : str
        Such as ``"controller"`` and ``"state['integral']"``.
    shape : tuple of int
        Its shape.
    first : int
        Number of its first entry among the states, uniforms or rows.
    kind : str
        ``"state"``, or, where it stays as it is at first, ``"uniform"`` or ``"row"``.
    """

    owner: str
    path: str
    shape: tuple[int, ...]
    first: int
    kind: str


@dataclass(frozen=True)
class Ring:
    """A number that comes back later: its node, what is pushed, and how many samples it takes."""

    node: int
    pushed: int
    samples: int


@dataclass(frozen=True)
class Loop:
    """A closed loop on a tape.

    Attributes
    ----------
    tape : Tape
        All operations of a sample.
    states : list of (int, int)
        Nodes of each number of the state: now, and at the next sample; q, v and the memory.
    leaves : list of Leaf
        The arrays of the memory.
    parameters : dict of Place to Leaf
        Where each parameter stands.
    uniforms, rows : int
        How many numbers of the run, and of each robot, there are; the first uniform is the step [s].
    keys : list of str
        Names of the noises.
    rings : list of Ring
        Delayed numbers.
    counted : list of int
        Nodes whose sizes are counted.
    kept : dict of str to (tuple of int, list of int)
        Shape and nodes of what is kept of every sample.
    sizes : (int, int, int, int, int)
        nq, nv, nu, and the numbers of the reference's q and v.
    unused : list of Place
        Those that no law uses: a spread of one would do nothing.
    tracks : int
        How many numbers the reference of a sample has, where each robot has its own; 0: all have the same.
    units : dict of str to str
        Of the signals among what is kept, by name.
    scheduled : int
        How many numbers of a sample come of schedules; they stand behind the reference.
    """

    tape: Tape
    states: list[tuple[int, int]]
    leaves: list[Leaf]
    parameters: dict[Place, Leaf]
    uniforms: int
    rows: int
    keys: list[str]
    rings: list[Ring]
    counted: list[int]
    kept: dict[str, tuple[tuple[int, ...], list[int]]]
    sizes: tuple[int, int, int, int, int]
    unused: list[Place]
    tracks: int = 0
    units: dict[str, str] = field(default_factory=dict)
    scheduled: int = 0

    @property
    def outputs_kept(self) -> int:
        """How many numbers are kept of each sample."""
        return sum(len(nodes) for _, nodes in self.kept.values())

    @functools.cached_property
    def tabled(self) -> list[int]:
        """Nodes of time and reference alone that are computed once, as further columns of the samples.

        All robots have the same, so what takes many operations, such as the waves of a noise force, is not
        worth computing again for each block of them.
        """
        tape = self.tape
        wanted = needed(tape, self.outputs)
        shared = {i for i in wanted if tape.depends[i] & SAMPLE and not tape.depends[i] & (ROBOT | STATE)}
        used = {i for j in wanted if j not in shared for i in operands(tape.operations[j])}
        found = [
            i
            for i in sorted(shared & (used | set(self.outputs)))
            if tape.types[i] == "f" and operands(tape.operations[i])
        ]
        saved = len(shared & set(needed(tape, found)))
        return found if saved > _WORTH_A_TABLE + 2 * len(found) else []

    @functools.cached_property
    def own(self) -> int:
        """How many operations each robot has of its own at a sample: what is tabled is done once for all."""
        return sum(bool(self.tape.depends[i] & (ROBOT | STATE)) for i in needed(self.tape, self.outputs))

    @property
    def columns(self) -> int:
        """Numbers of a sample: its time, the reference, what is scheduled, and what is tabled."""
        return 1 + self.sizes[3] + 2 * self.sizes[4] + self.scheduled + len(self.tabled)

    @property
    def outputs(self) -> list[int]:
        """Nodes that are wanted at each sample."""
        kept = [node for _, nodes in self.kept.values() for node in nodes]
        pushed = [node for ring in self.rings for node in (ring.node, ring.pushed)]
        return [node for pair in self.states for node in pair] + pushed + self.counted + kept


class _Context:
    """The context of a controller, whose delays, noise and schedules are on the tape, or are numbers."""

    def __init__(
        self,
        given: Any,
        plant: Any,
        line: Callable[..., Any],
        normal: Callable[..., Any],
        schedule: Callable[..., Any],
    ) -> None:
        self._given, self.difference, self.integrate = given, plant.difference, integrate_of(plant)
        self.line, self.normal, self._schedule = line, normal, schedule

    def schedule(self, rows: ArrayLike) -> Any:
        """Return what a controller keeps of rows that are known for each sample, checked."""
        return self._schedule(self._given.schedule(rows).rows)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._given, name)


def initial_memory(
    parts: Parts,
    context: object,
    reference: int,
    line: Callable[..., Any] = Line,
    normal: Callable[..., Any] | None = None,
    schedule: Callable[..., Any] = Schedule,
) -> Memory:
    """Return what the parts keep before the first sample.

    Parameters
    ----------
    parts : Parts
        The loop.
    context : object
        What the controller's `initial_state` is told; it gets its delays and noise here.
    reference : int
        Number of coordinates that the reference has.
    line, normal, schedule : callable
        Make a delay, a noise and a schedule; by default, of numbers, with the key 0.
    """
    plant = parts.plant
    normal = normal or (lambda name, n: Noise(0, n))
    own = _Context(context, plant, line, normal, schedule)
    recorder = None if parts.recorder is None else parts.recorder.initial_state(reference, plant.nu)
    return Memory(
        plant.initial_state(own) if hasattr(plant, "initial_state") else None,
        parts.controller.initial_state(own),
        recorder,
    )


def scheduled_rows(parts: Parts, context: object, reference: int) -> list[Array]:
    """Return the rows of all schedules that the parts ask for, each of shape (N + 1, ...)."""
    found: list[Array] = []

    def schedule(rows: Array) -> Schedule:
        found.append(rows)
        return Schedule(rows)

    initial_memory(parts, context, reference, schedule=schedule)
    return found


def check_schedules(parts: Parts, context: object, reference: int, spread: Iterable[Place]) -> None:
    """Refuse a spread of what schedules follow from, of which all robots have the same.

    Raises
    ------
    NotTraceable
        If there is such.
    """
    places = [place for place in spread if place.path.partition(".")[0] == "controller"]
    rows = scheduled_rows(parts, context, reference) if places else []
    values = parts.parameters() if rows else {}
    for place in places if rows else ():
        moved = parts.with_parameters({place: values[place] * 1.001 + 1e-6})
        others = scheduled_rows(moved, context, reference)
        if not all(map(np.array_equal, rows, others)):
            raise NotTraceable(
                f"what the controller knows of each sample follows from {'.'.join(place)}, which each robot "
                "has of its own",
                "spread parameters of the plant, or let robots run one after another",
            )


def initial_memories(
    parts: Parts, context: object, reference: int, spread: Mapping[Place, Array], n: int
) -> list[Array]:
    """Return the arrays of the memory of n robots before the first sample, shape (...) or (n, ...).

    Where `initial_state` cannot be run on symbols, it is asked for each robot.
    """
    tape = Tape()
    on_tape: dict[Place, Any] = {}
    inputs: dict[Any, Any] = {}
    for name, value in spread.items():
        columns = np.broadcast_to(value, (n, *value.shape[1:])).reshape(n, -1)
        first = len(inputs)
        inputs |= {("row", first + i): column for i, column in enumerate(columns.T)}
        on_tape[name] = symbols(
            [tape.input("row", first + i) for i in range(columns.shape[1])], value.shape[1:]
        )
    try:
        with tracing(part for _, part in parts.by_path()):
            memory = initial_memory(parts.with_parameters(on_tape), context, reference)
    except NotTraceable:
        rows = []
        for i in range(n):
            mine = parts.with_parameters(
                {name: np.broadcast_to(x, (n, *x.shape[1:]))[i] for name, x in spread.items()}
            )
            rows.append(
                [np.asarray(x, np.float64) for x in arrays_of(initial_memory(mine, context, reference))]
            )
        return [np.array(column) for column in zip(*rows, strict=True)]
    found = []
    for value in arrays_of(memory):
        if not has_symbols(value):
            found.append(np.asarray(value, np.float64))
            continue
        nodes = [x.index if type(x) is Node else tape.const(x).index for x in entries(value).reshape(-1)]
        known = np.array([np.broadcast_to(x, n) for x in evaluated(tape, nodes, inputs)], np.float64)
        found.append(known.T.reshape(n, *np.shape(value)))
    return found


def arrays_of(memory: Memory) -> list[Any]:
    """Return the numbers and arrays of a memory, in order."""
    return [value for tree in memory for _, value in leaves(tree)]
