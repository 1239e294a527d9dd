"""Compiled loop and its runs: robots in blocks, blocks on threads."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, affordable, check_integer, shaped
from pinmobile.compiled.emit import BINS, Shape, text_of
from pinmobile.compiled.processor import Cache, Target, function_of
from pinmobile.compiled.tape import COUNT, LoopTape, evaluate
from pinmobile.errors import InvalidArgument

_CALL_WORK = 2e8  # operations of a vector in one call, some 0.1 s; Ctrl-C works between calls
_THREAD_WORK = 4e6  # operations of a vector that justify a thread
_QUICK_SAMPLES = 100_000  # samples of blocks; code that runs for more is worth its optimisation
_MAX_OPERATIONS = 2500  # operations; above, a second vector takes longer to build than it saves
_MAX_STATES = 32  # numbers of the state, as many as registers; above, a second vector costs time


class Outcome(NamedTuple):
    """Result of a run.

    Attributes
    ----------
    memory : list of ndarray, shape (n, ...)
        Arrays of the memory after the last sample.
    counts : ndarray of int32, shape (times, sizes, BINS)
        Number of robots by time, size and bin.
    kept : dict of str to ndarray, shape (n, N + 1, ...)
        Values that are kept of every sample, by name.
    """

    memory: list[Array]
    counts: NDArray[np.int32]
    kept: dict[str, Array]


class Program:
    """Loop as machine code, which several threads may run at once.

    Parameters
    ----------
    tape : LoopTape
        Loop on a tape.
    target : Target, optional
        Processor; default: this one.
    shape : Shape, optional
        Layout of the robots, which does not change the results; default: the fastest for many robots, or for
        one if `single`.
    single : bool
        Whether the code is scalar, for one robot.
    cache : Cache, optional
        Folder of machine code.
    key : str, optional
        Key of the machine code, if it is known.
    """

    def __init__(
        self,
        tape: LoopTape,
        target: Target | None = None,
        shape: Shape | None = None,
        single: bool = False,
        cache: Cache | None = None,
        key: str | None = None,
    ) -> None:
        self.tape, target = tape, target or Target.host()
        self._target, self._cache, self._samples = target, cache or Cache(), 0.0
        self._code: Callable[..., None] | None = None
        self._is_quick = True
        is_small = tape.robot_size <= _MAX_OPERATIONS and len(tape.states) <= _MAX_STATES
        many = Shape(target.lanes, 2 if is_small else 1)
        self.shape = shape or (Shape(1, 1) if single else many)
        self.key = key or target.key(self.text)

    @cached_property
    def text(self) -> str:
        """Text of the code for LLVM."""
        return text_of(self.tape, self.shape)

    def code(self, samples: float = np.inf) -> Callable[..., None]:
        """Return the machine code for a run, see `emit.text_of`; each code computes the same bits.

        Code without optimisation is made five times as fast. It serves until the program has run for long.

        Parameters
        ----------
        samples : float
            Samples of the run, of all blocks.
        """
        self._samples += samples
        is_quick = self._samples <= _QUICK_SAMPLES
        code = self._code
        if code is None or (self._is_quick and not is_quick):
            code = function_of(self.key, lambda: self.text, self._target, self._cache, is_quick)
            self._code, self._is_quick = code, is_quick
        return code

    def run(
        self,
        start: tuple[Array, Array],
        t: Array,
        reference: tuple[Array, ...],
        *,
        h: float,
        values: Mapping[str, Array],
        first: Sequence[Array],
        rows: Sequence[Array] = (),
        tracks: tuple[Array, ...] | None = None,
        keys: Mapping[str, NDArray[np.uint64]] | None = None,
        every: int = 1,
        threads: int = 1,
    ) -> Outcome:
        """Return the result of a run.

        Parameters
        ----------
        start : (ndarray, ndarray), shape (n, nq), (n, nv)
            Initial configurations and velocities of the n robots.
        t : ndarray, shape (N + 1,)
            Times of the samples [s].
        reference : Reference
            Reference of all samples, for all robots.
        h : float
            Length of a substep [s].
        values : mapping of str to ndarray, shape (...) or (n, ...)
            Numbers of the parts by path, of all robots or of each.
        first : sequence of ndarray, shape (...) or (n, ...)
            Arrays of the memory before the first sample.
        rows : sequence of ndarray, shape (N + 1, ...)
            Rows of the schedules.
        tracks : Reference, optional
            Reference of each robot, shape (N + 1, n, ...), if the loop was traced for this.
        keys : mapping of str to ndarray of uint64, shape (n,)
            Each robot's key for the noise of a name.
        every : int
            Samples between two counts.
        threads : int
            Largest number of threads.
        """
        n = self._check(start, t, reference, tracks, every)
        blocks = self.blocks_of(start, n, values, first, keys or {})
        uniforms = self.uniforms_of(h, values, first)
        samples = self.samples_of(t, reference, uniforms, rows)
        kept = self._make_records(tracks, len(blocks), len(t))
        counts = self.launch(blocks, samples, uniforms, kept, n, every, threads=threads)
        return Outcome(self._final_memory(blocks, first, n), counts, self.kept_samples(kept, n))

    def _check(self, start: tuple[Array, Array], t: Array, reference: Any, tracks: Any, every: int) -> int:
        """Check that the machine code reads inside the arrays, and return the number of robots."""
        nq, nv, _, length, size = self.tape.sizes
        n, count = len(start[0]), len(t)
        for name, number in (("number of robots", n), ("number of samples", count), ("every", every)):
            check_integer(name, number)
        sizes = length, size, size
        shaped("q", start[0], (n, nq))
        shaped("v", start[1], (n, nv))
        for part, m in zip(reference, sizes, strict=True):
            shaped("reference", part, (count, m))
        track_sizes = sizes if self.tape.tracks else ()  # sizes of the robots' own references
        for part, m in zip(tracks or (), track_sizes, strict=True):
            shaped("tracks", part, (count, n, m))
        return n

    def samples_of(
        self, t: Array, reference: tuple[Array, ...], uniforms: Array, rows: Sequence[Array], first: int = 0
    ) -> Array:
        """Return the numbers of the samples from `first` that all robots share, shape (N + 1, columns)."""
        schedules = [np.reshape(row, (len(t), -1)) for row in rows]
        columns_in = np.empty((len(t), 1 + sum(part.shape[1] for part in (*reference, *schedules))))
        np.concatenate([t[:, None], *reference, *schedules], axis=1, out=columns_in)
        table_nodes, size = self.tape.table_nodes, len(t) * self.tape.columns
        if not table_nodes:
            return columns_in
        affordable(f"the tables of {len(t):,} samples", size, "give a larger dt, or fewer waves")
        inputs: dict[Any, Any] = {COUNT: np.arange(first, first + len(t), dtype=np.uint64)}
        inputs |= {("uniform", i): x for i, x in enumerate(uniforms)}
        inputs |= {("sample", i): column for i, column in enumerate(columns_in.T)}
        columns = (np.broadcast_to(x, len(t)) for x in evaluate(self.tape.tape, table_nodes, inputs))
        return np.ascontiguousarray(np.column_stack([columns_in, *columns]))

    def _make_records(self, tracks: tuple[Array, ...] | None, blocks: int, samples: int) -> Array:
        """Return the array for the values of every sample, with the robots' own references at its end."""
        loop, first = self.tape, self.tape.outputs_kept
        kept = aligned((blocks, samples, first + loop.tracks, self.shape.width))
        if tracks is not None:
            self.set_tracks(kept, np.concatenate(tracks, axis=-1).swapaxes(1, 2))
        return kept

    def set_rows(self, blocks: Array, first: int, columns: Array) -> None:
        """Set rows of the blocks from (rows, n); the last robot is repeated to fill the last block."""
        _fill(blocks[:, first : first + len(columns)], columns)

    def set_tracks(self, kept: Array, tracks: Array, first: int = 0) -> None:
        """Set the tracks of each robot, from index `first` on, from (samples, tracks, n)."""
        _fill(kept[:, :, self.tape.outputs_kept + first :], tracks)

    def blocks_of(
        self,
        start: tuple[Array, Array],
        n: int,
        values: Mapping[str, Array],
        first: Sequence[Array],
        keys: Mapping[str, NDArray[np.uint64]],
    ) -> Array:
        """Return the states, rows and keys of n robots in blocks, in the layout of the machine code."""
        loop, width = self.tape, self.shape.width
        states = len(loop.states)
        blocks = aligned((-(-n // width), states + loop.rows + len(loop.keys), width))
        q, v = (np.asarray(x, np.float64) for x in start)
        self.set_rows(blocks, 0, np.concatenate([q.T, v.T]))
        for leaf, value in zip(loop.leaves, first, strict=True):
            row = leaf.first + (states if leaf.kind == "row" else 0)
            if leaf.kind == "uniform":
                continue
            if value.ndim > len(leaf.shape):
                self.set_rows(blocks, row, value.reshape(n, -1).T)
            else:
                blocks[:, row : row + value.size] = np.ravel(value)[:, None]
        for parameter, leaf in loop.parameters.items():
            if leaf.kind == "row":
                value = values[parameter]
                columns = np.broadcast_to(value, (n, *leaf.shape)) if value.shape == leaf.shape else value
                self.set_rows(blocks, states + leaf.first, columns.reshape(n, -1).T)
        for i, name in enumerate(loop.keys):
            if name not in keys:
                raise InvalidArgument(f"keys has {sorted(keys)}, expected one for the noise {name!r}")
            key = np.broadcast_to(np.asarray(keys[name], np.uint64), n)
            self.set_rows(blocks, states + loop.rows + i, key.view(np.float64)[None])
        return blocks

    def uniforms_of(self, h: float, values: Mapping[str, Array], first: Sequence[Array]) -> Array:
        """Return the numbers that all robots share: the step, parameters, and constant memory."""
        uniforms = np.empty(self.tape.uniforms)
        uniforms[0] = h
        for parameter, leaf in self.tape.parameters.items():
            if leaf.kind == "uniform":
                value = values[parameter]
                if value.shape != leaf.shape:
                    message = f"{parameter} has shape {value.shape}, expected {leaf.shape}"
                    remedy = "name numbers that differ from robot to robot before the loop is traced"
                    raise InvalidArgument(f"{message}; {remedy}")
                uniforms[leaf.first : leaf.first + value.size] = value.ravel()
        for leaf, value in zip(self.tape.leaves, first, strict=True):
            if leaf.kind == "uniform":
                uniforms[leaf.first : leaf.first + value.size] = np.ravel(value)
        return uniforms

    def launch(
        self,
        blocks: Array,
        samples: Array,
        uniforms: Array,
        kept: Array,
        n: int,
        every: int,
        *,
        threads: int,
        first: int = 0,
    ) -> NDArray[np.int32]:
        """Run the blocks, and return the counts; the arguments are the arrays of the machine code.

        `first` is the index of the first sample.
        """
        loop = self.tape
        work = len(samples) * max(1, loop.robot_size) * self.shape.vectors  # operations of a block
        workers = max(1, min(threads, len(blocks), int(work * len(blocks) / _THREAD_WORK)))
        step = max(1, min(int(_CALL_WORK / work), -(-len(blocks) // (4 * workers))))
        bins = len(loop.counted), BINS
        times = -(-len(samples) // every) if loop.counted else 0
        counts = np.zeros((workers, max(1, times), *bins), np.int32)
        longest = max(1, sum(ring.samples for ring in loop.rings))
        rings = [aligned((longest, self.shape.width)) for _ in counts]
        code = self.code(len(samples) * len(blocks))

        def run(worker: int, begin: int, end: int) -> None:
            arrays = blocks, samples, uniforms, rings[worker], counts[worker], kept
            call(code, *arrays, part=(begin, end), every=every, n=n, first=first)

        share_work(run, len(blocks), step, workers)
        totals = counts[:, :times]
        return np.asarray(totals[0] if workers == 1 else totals.sum(axis=0, dtype=np.int32))

    def _final_memory(self, blocks: Array, first: Sequence[Array], n: int) -> list[Array]:
        """Return the arrays of the memory after the last sample, shape (n, ...)."""
        rows, arrays = blocks.swapaxes(0, 1), []
        for leaf, value in zip(self.tape.leaves, first, strict=True):
            if leaf.kind == "uniform":
                arrays.append(np.broadcast_to(value, (n, *leaf.shape)))
                continue
            size, row = prod(leaf.shape), leaf.first + (len(self.tape.states) if leaf.kind == "row" else 0)
            flat = rows[row : row + size].reshape(size, prod(rows.shape[1:]))  # works for empty arrays, too
            arrays.append(flat[:, :n].T.reshape(n, *leaf.shape))
        return arrays

    def kept_samples(self, kept: Array, n: int) -> dict[str, Array]:
        """Return the kept values of the samples of n robots by name, from their blocks."""
        samples, first, count = {}, 0, len(kept) * kept.shape[3]
        for name, (shape, nodes) in self.tape.kept.items():
            block = kept[:, :, first : first + len(nodes)]  # (blocks, samples, numbers, width)
            robots = np.moveaxis(block, 3, 1).reshape(count, kept.shape[1], *shape)[:n]
            samples[name] = np.ascontiguousarray(robots)
            first += len(nodes)
        return samples


def call(
    code: Callable[..., None],
    *arrays: Array | NDArray[np.int32],
    part: tuple[int, int] = (0, 1),
    every: int = 1,
    n: int = 1,
    first: int = 0,
) -> None:
    """Call machine code for a part of the blocks, see `emit.text_of`.

    Parameters
    ----------
    code : callable
        Machine code of a program.
    *arrays : ndarray
        Blocks, samples, uniforms, ring, counts and kept values.
    part : (int, int)
        Range of blocks.
    every, n, first : int
        Samples between two counts, number of robots, index of the first sample.
    """
    block, sample, uniform, ring, count, keep = [x.ctypes.data for x in arrays]
    code(block, *part, sample, len(arrays[1]), uniform, ring, count, every, n, keep, first)


def _fill(blocks: Array, columns: Array) -> None:
    """Set (blocks, ..., width) from (..., n); the last robot is repeated to fill the last block."""
    width, n = blocks.shape[-1], columns.shape[-1]
    full = n // width
    if full:
        full_blocks = columns[..., : full * width].reshape(*columns.shape[:-1], full, width)
        blocks[:full] = np.moveaxis(full_blocks, -2, 0)
    if full < len(blocks):
        blocks[full, ..., : n - full * width] = columns[..., full * width :]
        blocks[full, ..., n - full * width :] = columns[..., -1:]


def share_work(run: Callable[[int, int, int], None], count: int, step: int, workers: int) -> None:
    """Run pieces of work on threads, including this thread; Ctrl-C works between two pieces.

    Parameters
    ----------
    run : callable
        Function ``run(worker, begin, end)`` that does the work from `begin` to before `end`.
    count, step : int
        Amount of work, and amount in a piece.
    workers : int
        Number of threads.
    """
    starts = iter(range(0, count, step))
    lock, stop = threading.Lock(), threading.Event()

    def work(worker: int) -> None:
        while not stop.is_set():
            with lock:
                begin = next(starts, None)
            if begin is None:
                return
            run(worker, begin, min(begin + step, count))

    helpers = [threading.Thread(target=work, args=(i,)) for i in range(1, workers)]
    for helper in helpers:
        helper.start()
    try:
        work(0)
    finally:
        stop.set()
        for helper in helpers:
            helper.join()


def aligned(shape: tuple[int, ...], empty: bool = False) -> Array:
    """Return an array of zeros, or an uninitialised one, at an address that is aligned for vectors."""
    size = prod(shape)
    raw = (np.empty if empty else np.zeros)(size + 8)
    first = (-raw.ctypes.data % 64) // 8
    return raw[first : first + size].reshape(shape)
