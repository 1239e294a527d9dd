"""Machine code from LLVM's text, for this processor or another of its family, and the files that keep it."""

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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pinmobile.compiled.emit import ENTRY
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
