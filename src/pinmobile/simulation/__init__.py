"""The closed loop, recorded: `simulate` and `Rollout`."""

from pinmobile.plant import Plant
from pinmobile.signals import Signal
from pinmobile.simulation.checks import (
    checked_forces,
    checked_loop,
    checked_substeps,
    chosen_integrator,
    sample_times,
    sampled,
)
from pinmobile.simulation.closed_loop import simulate
from pinmobile.simulation.engines import ARRAYS, COMPILED, PINOCCHIO, Engine
from pinmobile.simulation.rollout import Rollout
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
