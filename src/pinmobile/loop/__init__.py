"""Closed loops: `simulate` runs one robot, `ensemble` many; `Rollout` and `Ensemble` are their results."""

from pinmobile.loop._checks import (
    check_forces as check_forces,
    check_substeps as check_substeps,
    sample_reference as sample_reference,
    sample_times as sample_times,
    select_integrator as select_integrator,
)
from pinmobile.loop._description import (
    LEVELS as LEVELS,
    NOTE as NOTE,
    ROBOT_ARRAYS as ROBOT_ARRAYS,
    SUMS as SUMS,
    Arguments,
    Outline,
    Part,
    check_share as check_share,
    contents as contents,
    coordinates as coordinates,
    draw_name as draw_name,
    draw_vars as draw_vars,
    edges as edges,
    format_percent as format_percent,
    robot_vars as robot_vars,
    share_quantile as share_quantile,
    sum_vars as sum_vars,
    sums as sums,
    versions as versions,
)
from pinmobile.loop._ensemble import (
    Bands,
    Cause as Cause,
    Ensemble,
    ErrorQuantile,
    causes as causes,
    is_event as is_event,
    worst_share as worst_share,
)
from pinmobile.loop._loop import (
    Loop,
    Record,
    Sample,
    Samples,
    State as State,
    Worst,
    control as control,
    reaction as reaction,
    step,
    tracking_errors as tracking_errors,
)
from pinmobile.loop._payload import PayloadTransfer
from pinmobile.loop._rollout import EndEffector, Rollout, at_samples as at_samples, error_text as error_text
from pinmobile.loop._run import (
    LoopStepper as LoopStepper,
    ensemble,
    part_of,
    plan_execution as plan_execution,
    run_scenario,
)
from pinmobile.loop._scenario import Scenario
from pinmobile.loop._simulate import Engine, errors_of as errors_of, simulate, start_of as start_of
from pinmobile.loop._spread import (
    TRUE_MODEL,
    Distribution,
    Normal,
    Relative,
    SameAs,
    Source as Source,
    Uniform,
    draw_values as draw_values,
)
from pinmobile.loop._trace import (
    Trace as Trace,
    arrays_of as arrays_of,
    initial_memories as initial_memories,
    initial_memory as initial_memory,
    scheduled_rows as scheduled_rows,
    traced_numbers as traced_numbers,
)
from pinmobile.plant import Plant
from pinmobile.signals import Signal

__all__ = [
    "TRUE_MODEL",
    "Arguments",
    "Bands",
    "Distribution",
    "EndEffector",
    "Engine",
    "Ensemble",
    "ErrorQuantile",
    "Loop",
    "Normal",
    "Outline",
    "Part",
    "PayloadTransfer",
    "Plant",
    "Record",
    "Relative",
    "Rollout",
    "SameAs",
    "Sample",
    "Samples",
    "Scenario",
    "Signal",
    "Uniform",
    "Worst",
    "ensemble",
    "part_of",
    "run_scenario",
    "simulate",
    "step",
]
