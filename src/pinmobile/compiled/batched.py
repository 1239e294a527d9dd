"""A law on many states at once: a function of arrays, compiled, over their leading axes."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled.cache import Cache
from pinmobile.compiled.loop_tape import Loop
from pinmobile.compiled.machine import Target
from pinmobile.compiled.program import Program, aligned
from pinmobile.compiled.symbols import entries, symbols
from pinmobile.compiled.tape import Node, Tape
from pinmobile.compiled.tracing import tracing
from pinmobile.errors import InvalidArgument, NotTraceable

__all__ = ["Batched"]


class Batched:
    """A function of one state, compiled for many.

    Parameters
    ----------
    law : callable
        Takes arrays of the shapes below, and returns an array or a tuple of arrays.
    shapes : sequence of tuples of int
        Of its arguments.
    target, cache
        As in `Program`.

    Raises
    ------
    NotTraceable
        If the law cannot be run on symbols, or is another one when it is asked again.
    """

    def __init__(
        self,
        law: Callable[..., Any],
        shapes: Sequence[tuple[int, ...]],
        *,
        target: Target | None = None,
        cache: Cache | None = None,
    ) -> None:
        self.shapes = tuple(map(tuple, shapes))
        self._sizes = [int(np.prod(shape)) for shape in self.shapes]
        loop, self._is_tuple = _traced(law, self.shapes)
        if loop.tape.operations != _traced(law, self.shapes)[0].tape.operations:
            raise NotTraceable(
                f"{getattr(law, '__qualname__', law)} computes something else when it is asked again",
                "let it depend on its arguments alone",
            )
        self._program = Program(loop, target, cache=cache)

    def __call__(self, *given: Any, threads: int = 1) -> Any:
        """Return what the law gives for each of the leading axes, over which the arguments broadcast.

        Parameters
        ----------
        *given : array_like, shape (..., *shape)
            The arguments.
        threads : int
            Most threads.

        Raises
        ------
        InvalidArgument
            If an argument has another shape.
        """
        arrays = [np.asarray(x, np.float64) for x in given]
        fit = [x.shape[x.ndim - len(s) :] == s for x, s in zip(arrays, self.shapes, strict=False)]
        if len(arrays) != len(self.shapes) or not all(fit):
            expected = ", ".join(str(("...", *shape)).replace("'", "") for shape in self.shapes)
            raise InvalidArgument(f"arguments have shapes {[x.shape for x in arrays]}, expected {expected}")
        leading = [x.shape[: x.ndim - len(s)] for x, s in zip(arrays, self.shapes, strict=True)]
        ahead = np.broadcast_shapes(*leading)
        n = int(np.prod(ahead))
        kept = self._run(arrays, ahead, n, threads) if n else {}
        found = tuple(
            np.reshape(kept[name], (*ahead, *shape)) if n else np.empty((*ahead, *shape))
            for name, (shape, _) in self._program.loop.kept.items()
        )
        return found if self._is_tuple else found[0]

    def _run(self, arrays: list[Array], ahead: tuple[int, ...], n: int, threads: int) -> dict[str, Array]:
        program = self._program
        width, loop = program.shape.width, program.loop
        blocks = aligned((-(-n // width), loop.rows, width))
        first = 0
        for array, shape, size in zip(arrays, self.shapes, self._sizes, strict=True):
            columns = np.broadcast_to(array, (*ahead, *shape)).reshape(n, size).T
            program.set_rows(blocks, first, columns)
            first += size
        outputs = sum(len(nodes) for _, nodes in loop.kept.values())
        kept = aligned((len(blocks), 1, outputs, width))
        program.called(blocks, np.zeros((1, 1)), np.zeros(1), kept, n, 1, threads)
        return program.kept_samples(kept, n)


def _traced(law: Callable[..., Any], shapes: Sequence[tuple[int, ...]]) -> tuple[Loop, bool]:
    tape, given, rows = Tape(), [], 0
    for shape in shapes:
        size = int(np.prod(shape))
        given.append(symbols([tape.input("row", rows + i) for i in range(size)], shape))
        rows += size
    with tracing([law]):
        found = law(*given)
    outputs = found if isinstance(found, tuple) else (found,)
    kept = {}
    for i, output in enumerate(outputs):
        nodes = [x if type(x) is Node else tape.const(x) for x in entries(output).reshape(-1)]
        numbers = [tape.apply("select", x, 1.0, 0.0) if x.kind == "b" else x for x in nodes]
        kept[str(i)] = entries(output).shape, [x.index for x in numbers]
    loop = Loop(
        tape=tape,
        states=[],
        leaves=[],
        parameters={},
        uniforms=0,
        rows=rows,
        keys=[],
        rings=[],
        counted=[],
        kept=kept,
        sizes=(0, 0, 0, 0, 0),
        unused=[],
    )
    return loop, isinstance(found, tuple)
