"""Those who run ensembles of arms: as in `ensemble_contestants`, but that a `fleet` is an `ArmFleet`."""

from arm_fleet import ArmEntrant
from contestants import MUJOCO, PINMOBILE, PYTHON

NO_STATISTICS = "the largest |e| and |force| alone"


def everyone(arm: str) -> tuple[ArmEntrant, ...]:
    """Return those who run ensembles of an arm, ours first."""
    return (
        ArmEntrant(f"{arm}: pinmobile ensemble", PINMOBILE, "of_pinmobile"),
        ArmEntrant(f"{arm}: pinmobile ensemble, rk4", PINMOBILE, "of_pinmobile"),
        ArmEntrant(f"{arm}: pinmobile ensemble, all measures", PINMOBILE, "of_pinmobile", "judged"),
        ArmEntrant(f"{arm}: pinmobile ensemble, code for AVX2", PINMOBILE, "of_pinmobile", "for_avx2"),
        ArmEntrant(
            f"{arm}: Pinocchio, loop in Python",
            PYTHON,
            "of_pinocchio",
            "one_by_one",
            easier=NO_STATISTICS,
        ),
        ArmEntrant(
            f"{arm}: Pinocchio, rnea and aba in parallel",
            PYTHON,
            "of_pinocchio",
            easier=f"one payload and one base for all, {NO_STATISTICS}",
            fleet=("alike",),
        ),
        ArmEntrant(
            f"{arm}: mujoco.rollout, open loop",
            MUJOCO,
            "of_mujoco",
            easier="the nominal robot's forces are given; its own Euler step; the largest |e| alone",
            fleet=("given",),
        ),
    )


ARMS = {arm: everyone(arm) for arm in ("UR5", "panda")}
EVERYONE = tuple(one for people in ARMS.values() for one in people)
