"""The closed loop, recorded: `simulate` and `Rollout`."""

from pinmobile.plant import Plant
from pinmobile.signals import Signal
from pinmobile.simulation.closed_loop import ARRAYS, COMPILED, PINOCCHIO, Engine, simulate
from pinmobile.simulation.closed_loop import checked_engine as checked_engine
from pinmobile.simulation.rollout import Rollout
from pinmobile.simulation.rollout import error_text as error_text
from pinmobile.simulation.setup import check_answers as check_answers
from pinmobile.simulation.setup import check_controllers_memory as check_controllers_memory
from pinmobile.simulation.setup import check_same as check_same
from pinmobile.simulation.setup import (
    checked_forces,
    checked_loop,
    checked_substeps,
    chosen_integrator,
    sample_times,
    sampled,
)
from pinmobile.simulation.setup import started as started
from pinmobile.simulation.steps import stepped
from pinmobile.simulation.storage import RECORDED as RECORDED
from pinmobile.simulation.storage import described_run as described_run
from pinmobile.simulation.storage import restored_run as restored_run
from pinmobile.simulation.storage import signal_columns as signal_columns
from pinmobile.simulation.storage import why_unknown as why_unknown

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
