"""`vectorize`: a function of one state, evaluated over leading axes by machine code."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from math import prod
from typing import Any

import numpy as np

from pinmobile.arrays import Array, affordable, finite, finite_answer
from pinmobile.compiled.batched import Batched
from pinmobile.compiled.processor import Cache, processors
from pinmobile.errors import InvalidArgument, NotTraceable

_CLOSE = 1e-7  # of the largest number of an answer: forward dynamics lose the digits of M's condition


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

        @wraps(function)  # by which tracing finds what it is made of
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
