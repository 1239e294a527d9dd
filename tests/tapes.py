"""A tape of one input as machine code, for many values of it."""

from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import Cache, LoopTape, Shape, Target
from pinmobile.compiled.program import Program, aligned
from pinmobile.compiled.tape import Tape


def compiled(tape: Tape, node: int, x: Any, target: Target, shape: Shape, *, key: bool = False) -> Array:
    """Return the value of a node for each value of the first row, or key."""
    names = ["x"] if key else []
    loop = LoopTape(tape, {"y": ((), [node])}, uniforms=1, rows=len(names) ^ 1, keys=names)
    program = Program(loop, target, shape, cache=Cache(""))
    width, n = shape.width, len(x)
    blocks = -(-n // width)
    rows = aligned((blocks, 1, width))
    rows.reshape(-1)[:n] = np.asarray(x).view(np.float64)
    kept = aligned((blocks, 1, 1, width))
    program.launch(rows, np.zeros((1, 1)), np.zeros(1), kept, n, 1, threads=1)
    return kept.reshape(-1)[:n].copy()
