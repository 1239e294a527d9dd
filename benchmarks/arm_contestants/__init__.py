"""Those who move an arm on its base: as in ``contestants``, but that a `task` is an `ArmTask`."""

from importlib import import_module
from typing import Any

from contestants import MUJOCO, PINMOBILE, PYTHON, Contestant


class Carrier(Contestant):
    """One row of the table of the arm."""

    def _attribute(self, name: str) -> Any:
        return getattr(import_module(f"arm_contestants.{self.module}"), name)


RAW = Carrier("raw Pinocchio loop (rnea, aba)", PYTHON, "of_pinocchio")
SIMULATE = Carrier("pinmobile simulate", PINMOBILE, "of_pinmobile")

EVERYONE = (
    SIMULATE,
    RAW,
    Carrier("Pinocchio as many write it (crba, nle, solve)", PYTHON, "of_pinocchio", "common_rollout"),
    Carrier("MuJoCo, a tight loop (mj_step1, mj_rne, mj_step2)", MUJOCO, "of_mujoco"),
    Carrier("MuJoCo as most write it (fullM, solve)", MUJOCO, "of_mujoco", "common_rollout"),
)
