"""Which of its kernels OpenBLAS computes with: that of `OPENBLAS_CORETYPE`, where it knows the name."""

import ctypes
from pathlib import Path

import numpy as np

_ALIASES = {("zen", "haswell"), ("prescott", "katmai")}  # asked for, and what the same code is called


def in_force() -> dict[str, str]:
    """Return the kernel of each OpenBLAS in this process, numpy's and scipy's, by the name of its file."""
    import scipy.linalg  # loads its own

    np.linalg.norm(scipy.linalg.inv(np.eye(2)))
    maps = Path("/proc/self/maps")
    lines = maps.read_text().splitlines() if maps.exists() else []
    files = sorted({line.split(maxsplit=5)[5] for line in lines if "openblas" in line})
    return {Path(file).name: _kernel(ctypes.CDLL(file)) for file in files}


def _kernel(library: ctypes.CDLL) -> str:
    names = [f"{prefix}openblas_get_corename{suffix}" for prefix in ("scipy_", "") for suffix in ("64_", "")]
    function = getattr(library, next(name for name in names if hasattr(library, name)))
    function.restype = ctypes.c_char_p
    found: bytes = function()
    return found.decode()


def refusal(asked: str | None) -> str:
    """Return why the kernel that was asked for is not the one that is tested, "" where it is."""
    if not asked:
        return ""
    found = in_force()
    if not found:
        return f"OPENBLAS_CORETYPE is {asked!r}, and there is no OpenBLAS here"
    wrong = {
        file: name
        for file, name in found.items()
        if asked.lower() != name.lower() and (asked.lower(), name.lower()) not in _ALIASES
    }
    listed = ", ".join(f"{name} in {file}" for file, name in wrong.items())
    return f"OPENBLAS_CORETYPE is {asked!r}, but in force is {listed}" if wrong else ""
