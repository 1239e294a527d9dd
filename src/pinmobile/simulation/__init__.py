"""The closed loop, recorded: `simulate` and `Rollout`."""

from pinmobile.plant import Plant
from pinmobile.signals import Signal
from pinmobile.simulation.closed_loop import (
    COMPILED,
    PYTHON,
    Engine,
    checked_engine as checked_engine,
    simulate,
)
from pinmobile.simulation.end_effector import EndEffector
from pinmobile.simulation.rollout import Rollout, error_text as error_text
from pinmobile.simulation.setup import (
    check_answers as check_answers,
    check_controllers_memory as check_controllers_memory,
    checked_forces,
    checked_loop,
    checked_substeps,
    chosen_integrator,
    sample_times,
    sampled,
    started as started,
)
from pinmobile.simulation.storage import (
    RECORDED as RECORDED,
    described_run as described_run,
    restored_run as restored_run,
    signal_columns as signal_columns,
    why_unknown as why_unknown,
)

__all__ = [
    "COMPILED",
    "PYTHON",
    "EndEffector",
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
]
