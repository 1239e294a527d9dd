"""Functions of one state on many states at once: compiled, over their leading axes, on all processors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike, affordable, finite, finite_answer
from pinmobile.compiled.identity import Identity
from pinmobile.compiled.loop_tape import LoopTape
from pinmobile.compiled.processor import Cache, Target, processors
from pinmobile.compiled.program import Program, aligned
from pinmobile.compiled.symbolic import entries, symbols
from pinmobile.compiled.tape import LARGEST, Node, Tape
from pinmobile.compiled.tracing import tracing
from pinmobile.errors import InvalidArgument, NotTraceable

_CLOSE = 1e-7  # of the largest number of an answer: forward dynamics lose the digits of M's condition


class Batched:
    """A function of one state, compiled for many.

    Parameters
    ----------
    law : callable
        Takes arrays of the shapes below, and returns an array or a tuple of arrays.
    shapes : sequence of tuples of int
        Of its arguments.
    alike : int
        Number of its last arguments that are the same for all states.
    pure : bool
        Whether it is known to depend on its arguments alone; if not, it is traced twice to see.
    largest : int
        Most operations of a state.
    target, cache
        As in `Program`.

    Attributes
    ----------
    size : int
        Number of numbers of an answer.

    Raises
    ------
    NotTraceable
        If the law cannot be run on symbols, has more operations, or is another one when it is asked again.
    """

    def __init__(
        self,
        law: Callable[..., Any],
        shapes: Sequence[tuple[int, ...]],
        *,
        alike: int = 0,
        pure: bool = False,
        largest: int = LARGEST,
        target: Target | None = None,
        cache: Cache | None = None,
    ) -> None:
        self.shapes = tuple(map(tuple, shapes))
        self._own = len(self.shapes) - alike
        form = self.shapes, self._own, largest
        tape, self._is_tuple = _traced(law, *form)
        if not pure and tape.tape.operations != _traced(law, *form)[0].tape.operations:
            raise NotTraceable(
                f"{getattr(law, '__qualname__', law)} computes something else when it is asked again",
                "let it depend on its arguments alone",
            )
        self._program = Program(tape, target, cache=cache)
        self.size = tape.outputs_kept

    def __call__(self, *given: ArrayLike, threads: int = 1) -> Any:
        """Return the answers for the leading axes, over which the arguments broadcast.

        Parameters
        ----------
        *given : array_like, shape (..., *shape)
            The arguments; those that are the same for all states have no leading axes.
        threads : int
            Most threads. The answer has the same bits for any number.

        Raises
        ------
        InvalidArgument
            If an argument has another shape.
        """
        arrays = [np.asarray(x, np.float64) for x in given]
        own, alike = arrays[: self._own], arrays[self._own :]
        fit = [x.shape[x.ndim - len(s) :] == s for x, s in zip(own, self.shapes, strict=False)]
        fit += [x.shape == s for x, s in zip(alike, self.shapes[self._own :], strict=False)]
        if len(arrays) != len(self.shapes) or not all(fit):
            ahead = [("...", *shape) for shape in self.shapes[: self._own]]
            expected = ", ".join(str(each).replace("'", "") for each in (*ahead, *self.shapes[self._own :]))
            raise InvalidArgument(f"arguments have shapes {[x.shape for x in arrays]}, expected {expected}")
        pairs = list(zip(own, self.shapes, strict=False))
        lead = np.broadcast_shapes(*(x.shape[: x.ndim - len(s)] for x, s in pairs))
        program, n, first = self._program, prod(lead), 0
        answers = {name: shape for name, (shape, _) in program.tape.kept.items()}
        if not n:
            found = [np.zeros((*lead, *shape)) for shape in answers.values()]
            return tuple(found) if self._is_tuple else found[0]
        blocks = aligned((-(-n // program.shape.width), program.tape.rows, program.shape.width))
        for x, s in pairs:
            program.set_rows(blocks, first, np.broadcast_to(x, (*lead, *s)).reshape(n, prod(s)).T)
            first += prod(s)
        uniforms = np.concatenate([np.zeros(1), *(x.ravel() for x in alike)])
        kept = aligned((len(blocks), 1, program.tape.outputs_kept, program.shape.width), empty=True)
        program.called(blocks, np.zeros((1, program.tape.columns)), uniforms, kept, n, 1, threads)
        rows = program.kept_samples(kept, n)
        found = [rows[name].reshape(*lead, *shape) for name, shape in answers.items()]
        return tuple(found) if self._is_tuple else found[0]


def _traced(
    law: Callable[..., Any], shapes: Sequence[tuple[int, ...]], own: int, largest: int
) -> tuple[LoopTape, bool]:
    tape, given, counts = Tape(largest), [], {"row": 0, "uniform": 1}  # the first uniform is a loop's step
    for k, shape in enumerate(shapes):
        kind, size = "row" if k < own else "uniform", prod(shape)
        given.append(symbols([tape.input(kind, counts[kind] + i) for i in range(size)], shape))
        counts[kind] += size
    code = Identity().visit(law)
    with tracing(code.namespaces.values(), code.cells):
        found = law(*given)
    outputs = found if isinstance(found, tuple) else (found,)
    kept = {}
    for i, output in enumerate(outputs):
        nodes = [x if type(x) is Node else tape.const(x) for x in entries(output).reshape(-1)]
        numbers = [tape.apply("select", x, 1.0, 0.0) if x.kind == "b" else x for x in nodes]
        kept[str(i)] = entries(output).shape, [x.index for x in numbers]
    loop = LoopTape(
        tape=tape,
        states=[],
        leaves=[],
        parameters={},
        uniforms=counts["uniform"],
        rows=counts["row"],
        keys=[],
        rings=[],
        counted=[],
        kept=kept,
        sizes=(0, 0, 0, 0, 0),
        unused=[],
    )
    return loop, isinstance(found, tuple)


def vectorize(
    function: Callable[..., Any], *, axes: int | tuple[int, ...] = 1, keep: bool = True
) -> Callable[..., Any]:
    """Return a function that evaluates another, of one state, over leading axes.

    It is compiled for each set of shapes that it is called with, which takes 0.1 to 0.5 s for an arm and up
    to some seconds for a humanoid, and runs on all processors, in some 0.1 microseconds a state. Its answers
    are those of the function but for rounding; each state's have the same bits whatever others there are.

    Parameters
    ----------
    function : callable
        A law in NumPy, or a method of a part, such as ``robot.mass_matrix``: of arrays of one state, and of
        words such as the name of a frame, to an array or a tuple of arrays. What else it depends on stays as
        it is at the first call.
    axes : int or tuple of int
        How many axes of an argument are the function's own, for all arguments or for each; those before them
        broadcast.
    keep : bool
        Whether the machine code is kept in a file for other processes.

    Returns
    -------
    vectorized : callable
        Of arrays of shape (..., *own).

    Raises
    ------
    InvalidArgument
        If `function` is none; or, when it is called, an argument is not finite or has too few axes, leading
        axes do not broadcast, or the answers would not fit into memory.
    NotTraceable
        When it is called, if the function cannot be compiled, or is another one on symbols.
    NotFinite
        When it is called, if an answer is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot, vectorize
    >>> vectorize(MobileRobot.box().mass_matrix)(np.zeros((1000, 3))).shape
    (1000, 3, 3)
    """
    if not callable(function):
        raise InvalidArgument(f"function is {function!r}, expected a function of one state")
    programs: dict[Any, Batched] = {}

    def vectorized(*given: Any) -> Any:
        words = {k: x for k, x in enumerate(given) if x is None or isinstance(x, str)}
        places = [k for k in range(len(given)) if k not in words]
        arrays = [finite(f"argument {k + 1}", given[k]) for k in places]
        own = (axes,) * len(arrays) if isinstance(axes, int) else tuple(axes)
        if len(own) != len(arrays) or any(x.ndim < n for x, n in zip(arrays, own, strict=True)):
            raise InvalidArgument(
                f"arguments have shapes {[x.shape for x in arrays]}, of which axes = {axes} are a state's own"
            )
        shapes = tuple(x.shape[x.ndim - n :] for x, n in zip(arrays, own, strict=True))
        leads = [x.shape[: x.ndim - n] for x, n in zip(arrays, own, strict=True)]
        try:
            lead = np.broadcast_shapes(*leads)
        except ValueError:
            raise InvalidArgument(f"leading shapes are {leads}, expected shapes that broadcast") from None

        def of_one(*states: Any) -> Any:
            numbers = dict(zip(places, states, strict=True))
            return function(*(words[k] if k in words else numbers[k] for k in range(len(given))))

        key = shapes, tuple(words.items())
        if key not in programs:
            first = [_first(x, shape) for x, shape in zip(arrays, shapes, strict=True)]
            cache = Cache() if keep else Cache("")
            programs[key] = _compared(Batched(of_one, shapes, cache=cache), of_one, first)
        program = programs[key]
        affordable(f"answers for {prod(lead):,} states", 1.0 * prod(lead) * program.size, "ask for fewer")
        found = program(*arrays, threads=processors())
        for answer in found if isinstance(found, tuple) else (found,):
            finite_answer(answer, **{f"argument {k + 1}": x for k, x in zip(places, arrays, strict=True)})
        return found

    return vectorized


def _first(array: Array, shape: tuple[int, ...]) -> Array:
    rows = array.reshape(-1, *shape) if array.size else np.zeros((1, *shape))
    return np.array(rows[0])


def _compared(program: Batched, function: Callable[..., Any], state: list[Array]) -> Batched:
    """Return the program, which gives for a state what the function does."""
    expected, found = function(*(x.copy() for x in state)), program(*state)
    pairs = (expected, found) if isinstance(found, tuple) else ((expected,), (found,))
    for one, other in zip(*pairs, strict=True):
        scale = np.abs(one).max(initial=1e-3)
        if np.shape(one) != other.shape or not np.allclose(one, other, rtol=0, atol=_CLOSE * scale):
            raise NotTraceable(
                "on symbols the function computes something else than on numbers",
                "let it do the same for every kind of array, without isinstance or try",
            )
    return program
