"""The closed loop, recorded: `simulate` and `Rollout`."""

from pinmobile.plant import Plant
from pinmobile.signals import Signal
from pinmobile.simulation.closed_loop import ARRAYS, COMPILED, PINOCCHIO, Engine, simulate
from pinmobile.simulation.rollout import Rollout
from pinmobile.simulation.setup import (
    checked_forces,
    checked_loop,
    checked_substeps,
    chosen_integrator,
    sample_times,
    sampled,
)
from pinmobile.simulation.steps import stepped

__all__ = [
    "ARRAYS",
    "COMPILED",
    "PINOCCHIO",
    "Engine",
    "Plant",
    "Rollout",
    "Signal",
    "checked_forces",
    "checked_loop",
    "checked_substeps",
    "chosen_integrator",
    "sample_times",
    "sampled",
    "simulate",
    "stepped",
]
