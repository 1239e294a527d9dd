"""Programs of loops: the machine code of a loop, made once for all loops of the same identity."""

from __future__ import annotations

import pickle
import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.compiled import LOOP, Cache, Identity, LoopTape, Outcome, Program, Target, uncollected
from pinmobile.loop._loop import Loop
from pinmobile.loop._trace import (
    Trace,
    arrays_of,
    initial_memories,
    initial_memory,
    scheduled_rows,
    traced_numbers,
)
from pinmobile.plant import Context
from pinmobile.trajectories import Reference

_MOST = 64  # programs
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
        self.begun = begun = initial_memory(loop, context)
        others = loop.substeps, loop.steps, tuple(map(np.shape, reference)), single, own_reference
        self.identity = identity = Identity.of(loop, begun[2:], self.spread, others)
        with _lock:
            known = _programs.get(identity.key)
            if known is not None:
                _programs.move_to_end(identity.key)
        if known is not None:
            self.program = known[0]
            return
        with uncollected():
            cache, target = Cache(), Target.here()
            name = identity.digest if cache.folder is not None else None
            program = None if name is None else _read(cache, name, target)
            if program is None:
                trace = Trace(loop, context, start, reference, identity, self.spread, own_reference)
                program = Program(trace.result(), target, single=single, cache=cache)
                if name is not None:
                    cache.write(name, pickle.dumps((program.tape, program.shape, program.key)), LOOP)
        self.program = program
        with _lock:
            _programs[identity.key] = program, identity.kept
            while len(_programs) > _MOST:
                _programs.popitem(last=False)

    @property
    def tape(self) -> LoopTape:
        """Tape of the loop."""
        return self.program.tape

    def first(self, values: Mapping[str, Array], n: int) -> list[Array]:
        """Return the memory before the first sample, arrays of shape (...), or (n, ...) if robots differ."""
        own = {path: value for path, value in values.items() if self.tape.parameters[path].kind == "row"}
        owners = {path.partition(".")[0] for path in own}
        numbers = [np.asarray(x, np.float64) for x in arrays_of(self.begun)]
        each = numbers
        if any(leaf.owner in owners for leaf in self.tape.leaves):
            each = initial_memories(self.loop, self.context, own, n, self.identity)
        found = []
        for leaf, value, one in zip(self.tape.leaves, each, numbers, strict=True):
            ahead = (n,) if value.ndim > one.ndim else ()
            missing = len(leaf.shape) - one.ndim
            grown = value.reshape((*ahead, *(1,) * missing, *one.shape))
            found.append(np.broadcast_to(grown, (*ahead, *leaf.shape)))
        return found

    def run(
        self,
        start: tuple[Array, Array],
        t: Array,
        reference: Reference,
        *,
        values: Mapping[str, Array] | None = None,
        tracks: Reference | None = None,
        keys: Mapping[str, NDArray[np.uint64]] | None = None,
        every: int = 1,
        threads: int = 1,
    ) -> Outcome:
        """Return the result of a run, see `Program.run`.

        Parameters
        ----------
        values : mapping of str to ndarray, shape (n, ...)
            Numbers of each robot, by the paths of the spread.
        """
        given = dict(values or {})
        numbers = {**traced_numbers(self.loop), **given}
        rows = scheduled_rows(self.loop, self.context) if self.tape.scheduled else []
        return self.program.run(
            *(start, t, reference),
            h=self.context.dt / self.loop.substeps,
            values=numbers,
            first=self.first(given, len(start[0])),
            rows=rows,
            tracks=tracks,
            keys=keys,
            every=every,
            threads=threads,
        )

    def recorded(self, outcome: Outcome) -> dict[str, Array]:
        """Return the recorder's memory after the last sample, by name, shape (n, ...)."""
        pairs = zip(self.tape.leaves, outcome.memory, strict=True)
        return {leaf.path[7:-2]: value for leaf, value in pairs if leaf.owner == "recorder"}


def _read(cache: Cache, name: str, target: Target) -> Program | None:
    """Return the program that another process has traced, or None."""
    try:  # the file is as trustworthy as the machine code in the same folder of the user
        tape, shape, key = pickle.loads(cache.read(name, LOOP) or b"")
    except Exception:  # the file is missing or damaged
        return None
    return Program(tape, target, shape, cache=cache, key=key)
