"""Machine code of functions of one state for many states: `vectorize`, and `Recurrence` over samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import numpy as np

from pinmobile.arrays import Array, affordable, broadcast_shapes, finite, finite_answer, instance
from pinmobile.compiled.differentiation import slopes
from pinmobile.compiled.functions import tracing
from pinmobile.compiled.identity import Identity
from pinmobile.compiled.program import Cache, Program, aligned, processors
from pinmobile.compiled.symbolic import entries, symbols
from pinmobile.compiled.tape import Leaf, LoopTape, Tape, ancestors, operands
from pinmobile.errors import InvalidArgument, NotTraceable

_RTOL = 1e-7  # relative tolerance of results; the condition of M costs digits in forward dynamics
_STATES = 1 << 14  # states in memory at once
_NUMBERS = "numbers"
_CHECK_SIZE = 1e6  # numbers; smaller results need no check of the memory


def vectorize(
    function: Callable[..., Any], *, axes: int | tuple[int, ...] = 1, checked: bool = True, keep: bool = True
) -> Callable[..., Any]:
    """Return a function that evaluates a function of one state for many states with machine code.

    The function is compiled for each set of shapes in a call. This takes 0.1 to 0.5 s for an arm and up to
    some seconds for a humanoid. The code runs on all processors and needs about 0.5 microseconds per state.
    Its results agree with those of the function up to rounding. The bits of a state's result do not depend on
    other states.

    Parameters
    ----------
    function : callable
        Law in NumPy, or method of a part such as ``robot.mass_matrix``. Its arguments are arrays of one
        state, and text such as the name of a frame. It returns an array or a tuple of arrays. All other data
        keep their value of the first call.
    axes : int or tuple of int
        Number of axes of one state's argument, for all arguments or for each. The axes before them broadcast.
    checked : bool
        Whether arguments and results that are not finite raise an error.
    keep : bool
        Whether the machine code is kept in a file for other processes.

    Returns
    -------
    callable
        Function of arrays with leading axes.

    Raises
    ------
    InvalidArgument
        If `function` is not callable. A call raises it if an argument is not finite or has too few axes,
        leading axes do not broadcast, or the results do not fit into memory.
    NotTraceable
        In a call, if the function cannot be compiled, or its results with symbols differ.
    NotFinite
        In a call, if a result is not finite.

    See Also
    --------
    ensemble : compiled loops of many robots.
    Engine : engines of a loop.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot, vectorize
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> energy = vectorize(robot.kinetic_energy)
    >>> v = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])  # [m/s]
    >>> energy(np.zeros(3), v)  # [J]
    array([15., 60.])
    """
    instance("function", function, Callable, "a function of one state")
    programs: dict[Any, _Compiled] = {}

    def vectorized(*given: Any) -> Any:
        words = {k: x for k, x in enumerate(given) if x is None or isinstance(x, str)}
        names = [f"argument {k + 1}" for k in range(len(given)) if k not in words]
        arrays = [np.asarray(x, np.float64) for k, x in enumerate(given) if k not in words]
        arrays = list(map(finite, names, arrays)) if checked else arrays
        sizes = (axes,) * len(arrays) if isinstance(axes, int) else axes
        if len(sizes) != len(arrays) or any(x.ndim < n for x, n in zip(arrays, sizes, strict=True)):
            message = f"arguments have shapes {[x.shape for x in arrays]}"
            raise InvalidArgument(f"{message}, expected axes = {axes} for one state")
        leads = [x.shape[: x.ndim - n] for x, n in zip(arrays, sizes, strict=True)]
        shapes = [x.shape[x.ndim - n :] for x, n in zip(arrays, sizes, strict=True)]
        lead = broadcast_shapes(dict(zip(names, leads, strict=True)))

        varies = tuple(map(bool, leads))  # whether an argument differs from state to state
        key = *shapes, *varies, *words.items()
        program = programs.get(key)
        if program is None:
            law = _bind_words(function, words)
            state = [_first_state(x, shape) for x, shape in zip(arrays, shapes, strict=True)]
            expected = law(*(x.copy() for x in state))  # raises the function's own errors
            program = _Compiled(law, shapes, varies, Cache() if keep else Cache(""))
            program.compare(state, expected)
            programs[key] = program
        results = program(arrays, lead)
        if checked:
            for result in results:
                finite_answer(result, **dict(zip(names, arrays, strict=True)))
        return results if program.is_tuple else results[0]

    return vectorized


def _bind_words(function: Callable[..., Any], words: dict[int, Any]) -> Callable[..., Any]:
    """Return a function of the arguments that are arrays; the other arguments are fixed."""

    def law(*states: Any) -> Any:
        arguments = list(states)
        for place, word in sorted(words.items()):
            arguments.insert(place, word)
        return function(*arguments)

    return law


def _first_state(array: Array, shape: tuple[int, ...]) -> Array:
    return np.array(array.reshape(-1, *shape)[0]) if array.size else np.zeros(shape)


class _Compiled:
    """Machine code of a function, for arguments of fixed shapes."""

    def __init__(
        self,
        function: Callable[..., Any],
        shapes: Sequence[tuple[int, ...]],
        varies: Sequence[bool],
        cache: Cache,
    ) -> None:
        self.shapes, self.varies = shapes, varies
        tape, arguments = Tape(), []
        counts = {"row": 0, "uniform": 1}  # the first uniform is a loop's step
        for shape, is_row in zip(shapes, varies, strict=True):
            kind, size = "row" if is_row else "uniform", prod(shape)
            arguments.append(symbols([tape.input(kind, counts[kind] + i) for i in range(size)], shape))
            counts[kind] += size
        code = Identity().visit(function)
        with tracing(code.namespaces.values(), code.cells):
            answer = function(*arguments)
        self.is_tuple, kept = isinstance(answer, tuple), {}
        for i, output in enumerate(answer if isinstance(answer, tuple) else (answer,)):
            kept[str(i)] = entries(output).shape, [*map(tape.number, entries(output).reshape(-1))]
        loop = LoopTape(tape, kept, uniforms=counts["uniform"], rows=counts["row"])
        self.program = Program(loop, cache=cache)

    def __call__(self, arrays: Sequence[Array], lead: tuple[int, ...]) -> tuple[Array, ...]:
        """Return the results for each of the leading axes."""
        n, loop = prod(lead), self.program.tape
        outputs = [(*lead, *shape) for shape, _ in loop.kept.values()]
        if n * loop.outputs_kept > _CHECK_SIZE:
            affordable(f"results for {n:,} states", 1.0 * n * loop.outputs_kept, "give fewer at a time")
        rows, uniforms = [], [np.zeros(1)]
        for array, shape, is_row in zip(arrays, self.shapes, self.varies, strict=True):
            if is_row:
                rows.append(np.broadcast_to(array, (*lead, *shape)).reshape(n, prod(shape)))
            else:
                uniforms.append(array.reshape(-1))
        if n <= _STATES:
            results = self._evaluate(rows, uniforms, n)
        else:
            results = [np.empty((n, *shape[len(lead) :])) for shape in outputs]
            for first in range(0, n, _STATES):
                chunk = [x[first : first + _STATES] for x in rows]
                parts = self._evaluate(chunk, uniforms, min(n - first, _STATES))
                for answer, part in zip(results, parts, strict=True):
                    answer[first : first + len(part)] = part
        return tuple(x.reshape(shape) for x, shape in zip(results, outputs, strict=True))

    def _evaluate(self, rows: Sequence[Array], uniforms: Sequence[Array], n: int) -> list[Array]:
        """Return the results for n states, shape (n, ...) each."""
        program, width = self.program, self.program.shape.width
        blocks = aligned((-(-n // width), program.tape.rows, width))
        if rows:
            program.set_rows(blocks, 0, np.concatenate(rows, axis=1).T)
        kept = aligned((len(blocks), 1, program.tape.outputs_kept, width))
        program.launch(blocks, np.zeros((1, 1)), np.concatenate(uniforms), kept, n, 1, threads=processors())
        return [x[:, 0] for x in program.kept_samples(kept, n).values()]

    def compare(self, state: Sequence[Array], expected: Any) -> None:
        """Reject a function whose results with symbols and with numbers differ."""
        lead = (1,) if any(self.varies) else ()
        for one, actual in zip(expected if self.is_tuple else (expected,), self(state, lead), strict=True):
            result, scale = actual.reshape(actual.shape[len(lead) :]), np.abs(one).max(initial=1e-3)
            if np.shape(one) != result.shape or not np.allclose(one, result, rtol=0, atol=_RTOL * scale):
                reason = "with symbols, the function computes something else than with numbers"
                remedy = "write a function that treats every kind of array alike, without isinstance or try"
                raise NotTraceable(reason, remedy)


def jacobian(values: Any, inputs: Sequence[Any]) -> list[dict[int, Any]]:
    """Return the derivatives of symbols, shape (n,), that are not zero, by the indices of inputs, for each.

    Parameters
    ----------
    values : Symbols, shape (n,)
        Results of a law.
    inputs : sequence of Node
        Numbers on which the law depends. None depends on another one.

    Raises
    ------
    NotTraceable
        If an operation has no derivative, such as rounds.
    """
    tape = inputs[0].tape
    ends = [tape.number(x) for x in entries(values)]
    rows = {x.index: {j: tape.const(1.0)} for j, x in enumerate(inputs)}
    for i in ancestors(tape, ends):
        nodes = tape.marks[i][1] if i in tape.marks else operands(tape.operations[i])
        if i in rows or tape.types[i] != "f" or not any(x in rows for x in nodes):
            continue
        total: dict[int, Any] = {}
        for x, multiply in slopes(tape, i):
            for j, d in rows.get(x, {}).items():
                total[j] = total[j] + multiply(d) if j in total else multiply(d)
        rows[i] = {j: d for j, d in total.items() if d.value != 0}
    return [rows.get(i, {}) for i in ends]


class Recurrence:
    """Machine code of the recurrence z[k + 1] = law(z[k], u[k], numbers) for N systems and all samples.

    Parameters
    ----------
    law : callable
        Function in NumPy of the state, shape (n,), the input, shape (m,), and numbers, shape (k,), of one
        system. It returns the next state, shape (n,).
    sizes : (int, int, int)
        n, m and k.
    """

    def __init__(self, law: Callable[[Any, Any, Any], Any], sizes: tuple[int, int, int]) -> None:
        tape, (n, m, k) = Tape(), sizes
        kinds = ("state", n), ("track", m), ("row", k)
        arguments = [symbols([tape.input(kind, i) for i in range(size)], (size,)) for kind, size in kinds]
        code = Identity().visit(law)
        with tracing(code.namespaces.values(), code.cells):
            next_state = law(*arguments)
        state, following = ([tape.number(x) for x in entries(z)] for z in (arguments[0], next_state))
        loop = LoopTape(tape, {"z": ((n,), state)}, uniforms=1, rows=k, sizes=(n, 0, 0, m, 0), tracks=m)
        loop.states.extend(zip(state, following, strict=True))
        loop.parameters[_NUMBERS] = Leaf("", _NUMBERS, (k,), 0, "row")
        self._program = Program(loop)

    def __call__(self, start: Array, u: Array, numbers: Array) -> Array:
        """Return the states, shape (N, K + 1, n); the inputs of some samples at once are in memory.

        Parameters
        ----------
        start : ndarray, shape (N, n)
            Initial states.
        u : ndarray, shape (K, ..., m)
            Inputs of N systems.
        numbers : ndarray, shape (N, k)
            Numbers of the systems.
        """
        N, m = len(start), u.shape[-1]
        states = np.empty((N, len(u) + 1, start.shape[1]))
        states[:, 0], step = start, max(1, _STATES // N)
        for first in range(0, len(u), step):
            inputs = u[first : first + step].reshape(-1, N, m)
            inputs = np.concatenate([inputs, inputs[:1]])  # the last state needs no input
            count, empty = len(inputs), np.empty((len(inputs), 0))
            outcome = self._program.run(
                (states[:, first], np.empty((N, 0))),
                np.zeros(count),
                (np.zeros((count, m)), empty, empty),
                h=0.0,
                values={_NUMBERS: numbers},
                first=(),
                tracks=(inputs, *[np.empty((count, N, 0))] * 2),
            )
            states[:, first : first + count] = outcome.kept["z"]
        return states
