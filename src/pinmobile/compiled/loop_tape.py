"""A closed loop on a tape: what stands where."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

from pinmobile.compiled.folding import ROBOT, SAMPLE, STATE
from pinmobile.compiled.tape import Tape, needed, operands

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
class LoopTape:
    """A closed loop on a tape.

    Attributes
    ----------
    tape : Tape
        All operations of a sample.
    kept : dict of str to (tuple of int, list of int)
        Shape and nodes of what is kept of every sample.
    uniforms, rows : int
        How many numbers of the run, and of each robot, there are; the first uniform is the step [s].
    states : list of (int, int)
        Nodes of each number of the state: now, and at the next sample; q, v and the memory.
    leaves : list of Leaf
        The arrays of the memory.
    parameters : dict of str to Leaf
        Where each parameter stands.
    keys : list of str
        Names of the noises.
    rings : list of Ring
        Delayed numbers.
    counted : list of int
        Nodes whose sizes are counted.
    sizes : (int, int, int, int, int)
        nq, nv, nu, and the numbers of the reference's q and v.
    unused : list of str
        Those that no law uses: a spread of one would do nothing.
    tracks : int
        How many numbers the reference of a sample has, where each robot has its own; 0: all have the same.
    units : dict of str to str
        Of the signals among what is kept, by name.
    scheduled : int
        How many numbers of a sample come of schedules; they stand behind the reference.
    """

    tape: Tape
    kept: dict[str, tuple[tuple[int, ...], list[int]]]
    uniforms: int
    rows: int
    states: list[tuple[int, int]] = field(default_factory=list)
    leaves: list[Leaf] = field(default_factory=list)
    parameters: dict[str, Leaf] = field(default_factory=dict)
    keys: list[str] = field(default_factory=list)
    rings: list[Ring] = field(default_factory=list)
    counted: list[int] = field(default_factory=list)
    sizes: tuple[int, int, int, int, int] = (0, 0, 0, 0, 0)
    unused: list[str] = field(default_factory=list)
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
