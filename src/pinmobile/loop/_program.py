"""Programs of loops: the machine code of a loop, made once for all loops of the same identity."""

from __future__ import annotations

import pickle
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import LOOP, Cache, Identity, LoopTape, Outcome, Program, Target, pause_gc
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
