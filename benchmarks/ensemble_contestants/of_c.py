"""C by hand with OpenMP, the limit: compiled here, called through ctypes."""

import ctypes
import os
import subprocess
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from fleet import BINS, EVERY, GAIN, NOMINAL, Figures, Fleet, Run

SOURCE = Path(__file__).parents[1] / "ensembles.c"
FLAGS = ("-std=c11", "-O3", "-fopenmp", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math")
FINITE = ("-ffinite-math-only", "-fno-signed-zeros")  # not -ffast-math: it would undo the rounding
AVX2 = ("-march=x86-64-v3",)
AVX512 = ("-march=native", "-mprefer-vector-width=512")


def avx2(fleet: Fleet) -> Run:
    return rollout(fleet, AVX2)


def avx512(fleet: Fleet) -> Run:
    return rollout(fleet, AVX512)


def libm(fleet: Fleet) -> Run:
    return rollout(fleet, (*AVX2, "-DLIBM"))


def rollout(fleet: Fleet, flags: Sequence[str]) -> Run:
    work = compiled(tuple(flags))
    mass, com = fleet.mass, fleet.com
    shared = np.array(
        [NOMINAL.yaw_inertia, fleet.task.dt, GAIN, NOMINAL.mass, NOMINAL.com[0], NOMINAL.yaw_inertia]
    )
    threads = os.cpu_count() or 1

    def run() -> Figures:
        references = fleet.references()
        results, counts = np.empty((fleet.n, 10)), np.zeros((2, fleet.kept, BINS), np.int32)
        arrays = (shared, mass, com, references, results, counts)
        if work(fleet.n, len(references), EVERY, threads, *(array.ctypes.data for array in arrays)):
            raise MemoryError
        return Figures(results[:, :3], results[:, 3:6], results[:, 6:9], results[:, 9], counts)

    return run


@lru_cache(maxsize=4)
def compiled(flags: tuple[str, ...]) -> ctypes._CFuncPtr:
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "ensembles.so"
        command = ["cc", *FLAGS, *FINITE, *flags, "-o", str(library), str(SOURCE), "-lm"]
        subprocess.run(command, capture_output=True, text=True, check=True)
        work = ctypes.CDLL(str(library)).ensemble
    work.argtypes = [ctypes.c_long] * 3 + [ctypes.c_int] + [ctypes.c_void_p] * 6
    return work
