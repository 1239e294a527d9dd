"""Compiled loop, its machine code for this processor, and its runs: robots in blocks, blocks on threads."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import mmap
import os
import sys
import tempfile
import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, affordable, shaped
from pinmobile.compiled.emit import BINS, ENTRY, Shape, text_of
from pinmobile.compiled.tape import COUNT, LoopTape, evaluate
from pinmobile.errors import NotTraceable

CODE, LOOP = ".o", ".loop"
"""Extensions of files: ``.o`` for machine code, ``.loop`` for loops."""

_MAGIC = b"pinmobile object 2\n"
_MAX_FILES = 512  # files of 5 to 200 kB


class Cache:
    """Folder of machine code and loops by key.

    No problem with the folder raises an error: the code is made again.

    Parameters
    ----------
    folder : path, optional
        Folder; default: the environment variable ``PINMOBILE_CACHE``, else ``pinmobile`` in the user's folder
        for cache files. An empty name, or a folder that cannot be written, means that there is no cache.
    """

    def __init__(self, folder: str | os.PathLike[str] | None = None) -> None:
        self.folder = _default_folder() if folder is None else Path(folder) if os.fspath(folder) else None
        if self.folder is not None and _is_open_to_others(self.folder):
            _warn_folder(self.folder)
            self.folder = None

    def read(self, key: str, kind: str = CODE) -> bytes | None:
        """Return the content of a key; None if it is missing, damaged, or belongs to another user."""
        if self.folder is None:
            return None
        try:
            with self._file(key, kind).open("rb") as file:
                if hasattr(os, "getuid") and os.fstat(file.fileno()).st_uid != os.getuid():
                    return None  # code that another user could write does not run
                content = file.read()
        except OSError:
            return None
        head, code = content[: len(_MAGIC) + 32], content[len(_MAGIC) + 32 :]
        return code if head == _head(key, code, kind) else None

    def write(self, key: str, code: bytes, kind: str = CODE) -> None:
        """Write the content of a key, completely or not at all."""
        if self.folder is None:
            return
        with contextlib.suppress(OSError):
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._thin()
            handle, name = tempfile.mkstemp(dir=self.folder, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(_head(key, code, kind) + code)
                os.replace(name, self._file(key, kind))
            except BaseException:
                with contextlib.suppress(OSError):
                    os.unlink(name)
                raise

    def _file(self, key: str, kind: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{key}{kind}"

    def _thin(self) -> None:
        """Remove the oldest files if there are too many."""
        assert self.folder is not None
        files = [entry for entry in os.scandir(self.folder) if entry.name.endswith((CODE, LOOP, ".part"))]
        if len(files) >= _MAX_FILES:
            for entry in sorted(files, key=lambda entry: entry.stat().st_mtime)[: _MAX_FILES // 4]:
                with contextlib.suppress(OSError):
                    os.unlink(entry.path)


def _head(key: str, code: bytes, kind: str) -> bytes:
    """Return the beginning of a file, which binds the content to the key, independent of the file's name."""
    return _MAGIC + hashlib.sha256(f"{key}{kind}\0".encode() + code).digest()


def _is_open_to_others(folder: Path) -> bool:
    """Return whether other users may write to a folder."""
    try:
        status = folder.stat()
    except OSError:
        return False
    return hasattr(os, "getuid") and (status.st_uid != os.getuid() or bool(status.st_mode & 0o022))


@functools.cache
def _warn_folder(folder: Path) -> None:
    message = f"the folder of machine code {str(folder)!r} is not used, because other users may write to it"
    warnings.warn(f"{message}: `chmod go-w` it or set PINMOBILE_CACHE to your own folder", stacklevel=3)


def _default_folder() -> Path | None:
    setting = os.environ.get("PINMOBILE_CACHE")
    if setting is not None:
        return Path(setting) if setting else None
    try:
        if sys.platform == "darwin":
            return Path.home() / "Library" / "Caches" / "pinmobile"
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:  # the user has no home folder
        return None
    return Path(base) / "pinmobile"


_MAX_LOADED = 64  # functions that stay loaded without a user
_lock = threading.Lock()
_functions: OrderedDict[str, Callable[..., None]] = OrderedDict()


@functools.cache
def _llvm() -> Any:
    """Return LLVM's binding, which the first compilation loads."""
    import llvmlite.binding

    llvmlite.binding.initialize_native_target()
    llvmlite.binding.initialize_native_asmprinter()
    return llvmlite.binding


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _check_executable() -> None:
    """Raise `NotTraceable` if written memory may not be executed, which LLVM does not check."""
    if sys.platform != "linux":
        return
    page = mmap.mmap(-1, mmap.PAGESIZE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    page[0] = 0
    first, libc = ctypes.c_char.from_buffer(page), ctypes.CDLL(None, use_errno=True)
    arguments = ctypes.c_size_t(mmap.PAGESIZE), mmap.PROT_READ | mmap.PROT_EXEC
    if libc.mprotect(ctypes.c_void_p(ctypes.addressof(first)), *arguments):
        reason = os.strerror(ctypes.get_errno())
        message = f"this process may not execute memory that it wrote (mprotect: {reason})"
        example = "for example by MemoryDenyWriteExecute=no in its systemd unit"
        raise NotTraceable(message, f"allow it for the fastest engine, {example}")


@dataclass(frozen=True)
class Target:
    """Processor.

    Parameters
    ----------
    processor, features : str
        Name and features in LLVM's notation: ``"haswell"``, ``"+avx2,-avx512f"``.
    lanes : int
        Number of floats in its vectors.
    """

    processor: str
    features: str
    lanes: int

    @classmethod
    def host(cls) -> Target:
        """Return the processor of this machine.

        Raises
        ------
        NotTraceable
            If this process may not execute memory that it wrote.
        """
        _check_executable()
        llvm = _llvm()
        features = llvm.get_host_cpu_features()
        lanes = 8 if features.get("avx512f") else 4 if features.get("avx") else 2
        return cls(llvm.get_host_cpu_name(), features.flatten(), lanes)

    def key(self, text: str) -> str:
        """Return the key of the machine code of a text, which depends on text, processor and compiler."""
        import llvmlite

        compiler = llvmlite.__version__, _llvm().get_default_triple()
        words = "\0".join((text, self.processor, self.features, *compiler))
        return hashlib.sha256(words.encode()).hexdigest()

    def build(self, text: str, is_quick: bool = False) -> bytes:
        """Return the machine code of a text; if `is_quick`, LLVM makes it in a fifth of the time, but slower.

        LLVM's optimisation passes are omitted: the tape has already done their work, and they double the
        time.
        """
        module = _llvm().parse_assembly(text)
        return bytes(self._machine(0 if is_quick else 3).emit_object(module))

    def load(self, code: bytes) -> Callable[..., None]:
        """Return the function of machine code, which runs without the interpreter's lock."""
        llvm = _llvm()
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), self._machine())
        file = llvm.ObjectFileRef.from_data(code)
        engine.add_object_file(file)
        engine.finalize_object()
        pointer, word = ctypes.c_void_p, ctypes.c_int64
        tail = word, pointer, pointer, pointer, word, word
        types = (pointer, word, word, pointer, *tail, pointer, word)
        function = ctypes.CFUNCTYPE(None, *types)(engine.get_function_address(ENTRY))
        function.engine = engine, file  # type: ignore[attr-defined]  # lives as long as the function
        return function

    def _machine(self, level: int = 3) -> Any:
        options = {"cpu": self.processor, "features": self.features, "opt": level, "jit": True}
        family = _llvm().Target.from_default_triple()
        return family.create_target_machine(**options, codemodel="jitdefault")


def function_of(
    key: str, text: Callable[[], str], target: Target, cache: Cache, is_quick: bool = False
) -> Callable[..., None]:
    """Return the function of a target's key: known, read from the cache, or built from the key's text.

    If `is_quick`, what is built is not optimised.
    """
    names = [key, f"{key}-quick"] if is_quick else [key]
    with _lock:
        name = next((name for name in names if name in _functions), "")
        if not name:
            stored = ((name, code) for name in names if (code := cache.read(name)) is not None)
            name, code = next(stored, (names[-1], b""))
            if not code:
                code = target.build(text(), is_quick)
                cache.write(name, code)
            _functions[name] = target.load(code)
        _functions.move_to_end(name)
        while len(_functions) > _MAX_LOADED:
            _functions.popitem(last=False)
        return _functions[name]


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
        n = len(start[0])
        blocks = self.blocks_of(start, n, values, first, keys or {})
        uniforms = self.uniforms_of(h, values, first)
        samples = self.samples_of(t, reference, uniforms, rows)
        loop = self.tape
        kept = aligned((len(blocks), len(t), loop.outputs_kept + loop.tracks, self.shape.width))
        if tracks is not None:
            self.set_tracks(kept, np.concatenate(tracks, axis=-1).swapaxes(1, 2))
        counts = self.launch(blocks, samples, uniforms, kept, n, every, threads=threads)
        return Outcome(self._final_memory(blocks, first, n), counts, self.kept_samples(kept, n))

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
                remedy = "; name numbers that differ from robot to robot before the loop is traced"
                shaped(parameter, value, leaf.shape, words=remedy)
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
