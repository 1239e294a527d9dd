"""Machine code from LLVM's text, for this processor or another of its family."""

import ctypes
import functools
import hashlib
import os
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pinmobile.compiled.cache import Cache
from pinmobile.compiled.emit import ENTRY

__all__ = ["Target", "function_of", "processors"]

_LOADED = 64  # functions that stay loaded though nobody holds them
_lock = threading.Lock()
_known: "OrderedDict[str, Callable[..., None]]" = OrderedDict()


@functools.cache
def _llvm() -> Any:
    """Return LLVM's binding, which is loaded when something is compiled for the first time."""
    import llvmlite.binding

    llvmlite.binding.initialize_native_target()
    llvmlite.binding.initialize_native_asmprinter()
    return llvmlite.binding


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class Target:
    """A processor.

    Parameters
    ----------
    processor, features : str
        As LLVM names them: ``"haswell"``, ``"+avx2,-avx512f"``.
    lanes : int
        Floats in its vectors.
    """

    processor: str
    features: str
    lanes: int

    @classmethod
    def here(cls) -> "Target":
        """Return this machine's."""
        llvm = _llvm()
        features = llvm.get_host_cpu_features()
        lanes = 8 if features.get("avx512f") else 4 if features.get("avx") else 2
        return cls(llvm.get_host_cpu_name(), features.flatten(), lanes)

    def key(self, text: str) -> str:
        """Return what names the object of a text: the text, the processor, and who builds."""
        import llvmlite

        made_by = llvmlite.__version__, _llvm().get_default_triple()
        words = "\0".join((text, self.processor, self.features, *made_by))
        return hashlib.sha256(words.encode()).hexdigest()

    def build(self, text: str) -> bytes:
        """Return the object of a text.

        LLVM's passes are left out: what they could find, the tape has found, and they take as long again.
        """
        module = _llvm().parse_assembly(text)
        return bytes(self._machine().emit_object(module))

    def load(self, code: bytes) -> Callable[..., None]:
        """Return the function of an object; it runs without the interpreter's lock."""
        llvm = _llvm()
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), self._machine())
        file = llvm.ObjectFileRef.from_data(code)
        engine.add_object_file(file)
        engine.finalize_object()
        pointer, whole = ctypes.c_void_p, ctypes.c_int64
        types = (pointer, whole, whole, pointer, whole, pointer, pointer, pointer, whole, whole, pointer)
        function = ctypes.CFUNCTYPE(None, *types)(engine.get_function_address(ENTRY))
        function.engine = engine, file  # type: ignore[attr-defined]  # it lives as long as the function
        return function

    def _machine(self) -> Any:
        return (
            _llvm()
            .Target.from_default_triple()
            .create_target_machine(
                cpu=self.processor, features=self.features, opt=3, jit=True, codemodel="jitdefault"
            )
        )


def function_of(key: str, text: Callable[[], str], target: Target, cache: Cache) -> Callable[..., None]:
    """Return the function of a target's key: known, read from the cache, or built of the key's text."""
    with _lock:
        found = _known.get(key)
        if found is None:
            code = cache.read(key)
            if code is None:
                code = target.build(text())
                cache.write(key, code)
            found = _known[key] = target.load(code)
        _known.move_to_end(key)
        while len(_known) > _LOADED:
            _known.popitem(last=False)
    return found
