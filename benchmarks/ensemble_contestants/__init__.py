"""Those who take part in the ensembles: what they need, and whether their work is easier.

A contestant's module has functions ``NAME(fleet) -> run``: what they do is set-up, such as compiling or
building the models, and is not timed; ``run() -> Figures`` does the ensemble, references included, and is.
"""

import shutil
import subprocess
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from contestants import MUJOCO, NUMPY, PINMOBILE, PYTHON, Contestant, Peer
from fleet import LECTURE, Figures, Fleet, Run, difference


@dataclass(frozen=True)
class Compiler(Peer):
    """A C compiler with OpenMP, on a processor that has the vectors."""

    vectors: str = "avx2"

    @cached_property
    def installed(self) -> bool:
        """Whether it is there, and the processor says it has them."""
        told = Path("/proc/cpuinfo")
        if not shutil.which("cc") or not told.exists() or self.vectors not in told.read_text():
            return False
        command = ["cc", "-fopenmp", "-include", "omp.h", "-E", "-x", "c", "/dev/null"]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0


@dataclass(frozen=True)
class Entrant(Contestant):
    """One row of the table of ensembles.

    Attributes
    ----------
    easier : str
        What its work lacks; empty if it does all.
    fleet : tuple of str
        How its robots differ from all others': the fields of `Fleet` that are true.
    """

    easier: str = ""
    fleet: tuple[str, ...] = ()

    def fleet_of(self, n: int, duration: float = LECTURE.duration) -> Fleet:
        """Return its robots."""
        return Fleet(n, task=replace(LECTURE, duration=duration), **dict.fromkeys(self.fleet, True))

    package: ClassVar[str] = "ensemble_contestants"

    def work(self, n: int, part: float = 1.0) -> Any:
        """Return its robots, who do a part of the whole."""
        return self.fleet_of(n, part * LECTURE.duration)

    def apart(self, figures: Figures, fleet: Any) -> float:
        """Return the largest difference of its figures from what must come out."""
        return difference(figures, fleet)

    def prepare(self, fleet: Any) -> Run:
        """Return what runs the ensemble, set up."""
        run: Run = self._attribute(self.function)(fleet)
        return run

    def _attribute(self, name: str) -> Any:
        return getattr(import_module(f"{self.package}.{self.module}"), name)


NO_COMPILER = "a C compiler with OpenMP (apt-get install gcc), on a processor with {}"
AVX2 = Compiler("cc()", "", NO_COMPILER.format("AVX2"))
AVX512 = Compiler("cc()", "", NO_COMPILER.format("AVX-512"), vectors="avx512f")
JAX = Peer("jax", "jax", "pip install 'jax[cpu]'")
NO_COUNTS = "no histograms over time"

OURS = Entrant("pinmobile ensemble", PINMOBILE, "of_pinmobile")
LIMIT = Entrant("C, AVX2, polynomial sine, cosine", AVX2, "of_c", "avx2")
MUJOCO_OPEN = Entrant(
    "mujoco.rollout, open loop",
    MUJOCO,
    "of_mujoco",
    "open_loop",
    easier="the torques are given, of each robot the largest |e| alone, its own semi-implicit Euler",
    fleet=("euler",),
)
MUJOCO_CLOSED = Entrant(
    "mujoco.rollout, closed loop (nstep = 1)", MUJOCO, "of_mujoco", "closed_loop", easier=NO_COUNTS
)
EVERYONE = (
    OURS,
    LIMIT,
    Entrant("C, AVX-512, polynomial sine, cosine", AVX512, "of_c", "avx512"),
    Entrant("C, AVX2, sine, cosine of libm", AVX2, "of_c", "libm"),
    Entrant("numpy, (n, 3) and linalg.solve", NUMPY, "of_numpy"),
    Entrant("JAX on the CPU, vmap of scan", JAX, "of_jax", easier=NO_COUNTS),
    MUJOCO_OPEN,
    MUJOCO_CLOSED,
    Entrant(
        "Pinocchio, rnea and aba in parallel",
        PYTHON,
        "of_pinocchio",
        easier=f"the same model for all, {NO_COUNTS}",
        fleet=("alike",),
    ),
)
