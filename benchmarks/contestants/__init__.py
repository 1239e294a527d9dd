"""Those who take part: who they are, what they need, and how they are started.

A contestant's module has functions ``NAME(task) -> run``: what they do is set-up, such as building the
model, and is not timed; ``run() -> Log`` does the rollout, its references included, and is. A module that
takes part in ``calls.py`` has ``calls(body)`` as well. Nothing foreign is imported before it is asked for.
"""

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

from task import Body, Run, Task


@dataclass(frozen=True)
class Peer:
    """A library or program.

    Attributes
    ----------
    needs : str
        The Python module, or the program if it ends in ``()``, that must be there.
    package : str
        The distribution with its version; empty for a program.
    install : str
        The command that brings it.
    """

    needs: str
    package: str
    install: str

    @property
    def installed(self) -> bool:
        """Whether it is there."""
        if self.needs.endswith("()"):
            return shutil.which(self.needs[:-2]) is not None
        return find_spec(self.needs) is not None

    @property
    def version(self) -> str:
        """Version of what is installed."""
        if not self.installed:
            return ""
        if self.package:
            return version(self.package)
        said = subprocess.run([self.needs[:-2], "--version"], capture_output=True, text=True, check=True)
        return said.stdout.splitlines()[0].split()[-1]


@dataclass(frozen=True)
class Contestant:
    """One row of a table: its name, whose it is, and the function that sets it up."""

    name: str
    peer: Peer
    module: str
    function: str = "rollout"

    def prepare(self, task: Task) -> Run:
        """Return what does the task, set up."""
        run: Run = self._attribute(self.function)(task)
        return run

    def calls(self, body: Body) -> dict[str, Callable[..., Any]]:
        """Return the calls there are, of ``"M"``, ``"n"``, ``"inverse"`` and ``"forward"``."""
        calls: dict[str, Callable[..., Any]] = self._attribute("calls")(body)
        return calls

    def _attribute(self, name: str) -> Any:
        return getattr(import_module(f"contestants.{self.module}"), name)


PINMOBILE = Peer("pinmobile", "pinmobile", "pip install -e .")
PYTHON = Peer("pinocchio", "pin", "pip install pin")
NUMPY = Peer("numpy", "numpy", "pip install numpy")
MUJOCO = Peer("mujoco", "mujoco", "pip install mujoco")
TOOLBOX = Peer("roboticstoolbox", "roboticstoolbox-python", "pip install roboticstoolbox-python")
OCTAVE = Peer("octave-cli()", "", "apt-get install octave")

RAW = Contestant("raw Pinocchio loop (rnea, aba)", PYTHON, "raw_pinocchio")
SIMULATE = Contestant("pinmobile simulate", PINMOBILE, "of_pinmobile")

EVERYONE = (
    SIMULATE,
    RAW,
    Contestant(
        "pinmobile simulate, and Tangent(Circle) made", PINMOBILE, "of_pinmobile", "rollout_with_trajectory"
    ),
    Contestant("Pinocchio, the fastest loop found", PYTHON, "raw_pinocchio", "fastest_rollout"),
    Contestant("Pinocchio as many write it (crba, nle, solve)", PYTHON, "raw_pinocchio", "common_rollout"),
    Contestant("closed form in numpy", NUMPY, "closed_form"),
    Contestant("MuJoCo, the fastest loop found", MUJOCO, "of_mujoco"),
    Contestant("MuJoCo as most write it (fullM, solve)", MUJOCO, "of_mujoco", "common_rollout"),
    Contestant("Robotics Toolbox (rne, accel)", TOOLBOX, "of_toolbox"),
    Contestant("GNU Octave, the lecture's script", OCTAVE, "of_octave"),
)
"""All who run computed torque with the lecture's step."""

OURS = (SIMULATE, RAW)
"""Those who run PD, rk4 and a user's own law as well."""
