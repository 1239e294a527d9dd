"""`Recurrence`: states that follow from one another by a law, of many systems at once, by machine code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled._tracing import tracing
from pinmobile.compiled.identity import Identity
from pinmobile.compiled.loop_tape import Leaf, LoopTape
from pinmobile.compiled.processor import processors
from pinmobile.compiled.program import Program
from pinmobile.compiled.symbolic import entries, symbols
from pinmobile.compiled.tape import LARGEST, Tape

_NUMBERS = "numbers"


class Recurrence:
    """States z[k + 1] = law(z[k], u[k], numbers) of N systems, all samples in one run of machine code.

    Parameters
    ----------
    law : callable
        Of the state, shape (n,), the input, (m,), and numbers, (k,), of one system, in NumPy; it returns the
        next state, shape (n,).
    sizes : (int, int, int)
        n, m and k.
    """

    def __init__(self, law: Callable[[Any, Any, Any], Any], sizes: tuple[int, int, int]) -> None:
        tape, (n, m, k) = Tape(LARGEST), sizes
        kinds = ("state", n), ("track", m), ("row", k)
        given = [symbols([tape.input(kind, i) for i in range(size)], (size,)) for kind, size in kinds]
        code = Identity().visit(law)
        with tracing(code.namespaces.values(), code.cells):
            after = law(*given)
        now = [node.index for node in entries(given[0])]
        states = list(zip(now, (node.index for node in entries(after)), strict=True))
        numbers = {_NUMBERS: Leaf("", _NUMBERS, (k,), 0, "row")}
        kept: dict[str, tuple[tuple[int, ...], list[int]]] = {"z": ((n,), now)}
        loop = LoopTape(tape, states, [], numbers, 1, k, [], [], [], kept, (n, 0, 0, m, 0), [], tracks=m)
        self._program = Program(loop)

    def __call__(self, start: Array, u: Array, numbers: Array) -> Array:
        """Return the states, shape (N, K + 1, n), from (N, n) on, for inputs (K, N, m) and numbers (N, k)."""
        count, none = len(u) + 1, np.empty((len(u) + 1, 0))
        inputs = np.concatenate([u, np.zeros((1, *u.shape[1:]))])  # the last state has none
        outcome = self._program.run(
            (start, np.empty((len(start), 0))),
            np.zeros(count),
            (np.zeros((count, u.shape[2])), none, none),
            h=0.0,
            values={_NUMBERS: numbers},
            first=(),
            tracks=(inputs, *[np.empty((count, len(start), 0))] * 2),
            threads=processors(),
        )
        return outcome.kept["z"]
