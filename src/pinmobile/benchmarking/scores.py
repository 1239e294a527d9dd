"""`Score`: what a controller does in a scenario, and what it costs."""

from __future__ import annotations

from math import inf, nan
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.balance import tip_over_margin
from pinmobile.benchmarking.situation import BenchmarkScenario
from pinmobile.controllers import Controller
from pinmobile.errors import Diverged, InvalidArgument
from pinmobile.loop import Rollout
from pinmobile.plant import Context, inputs_of

_CALLS = 200  # of a controller that are timed


class Score(NamedTuple):
    """What a controller does in a scenario, and what it costs; infinite where it diverges.

    Attributes
    ----------
    largest, rms : float
        Distance from the desired position, from `BenchmarkScenario.after` on [m].
    largest_from_start, rms_from_start : float
        The same from the start on [m].
    force : float
        Root mean square of the force, or of what inputs have the unit of the first [N].
    chatter : float
        How much the input changes, of the axis where that is most: sum of its changes by time [N/s].
    recovery : float
        How long after `BenchmarkScenario.event` it is until the distance stays within the band [s].
    beyond : float
        How far it comes beyond a wall of the scenario [m].
    margin : float
        Smallest tip-over margin [m], negative where it tips over; NaN of a plant that does not tell.
    call : float
        CPU time of a call of the controller, by NumPy, at the first 200 samples of the run [s].
    """

    largest: float
    rms: float
    largest_from_start: float
    rms_from_start: float
    force: float
    chatter: float
    recovery: float
    beyond: float
    margin: float
    call: float


def scored(scenario: BenchmarkScenario, controller: Controller) -> Score:
    """Run a controller in a scenario, and judge the run."""
    try:
        run = scenario.run(controller)
    except Diverged as error:
        call = nan if error.rollout is None else _cost(scenario, controller, error.rollout)
        return Score(inf, inf, inf, inf, inf, inf, inf, inf if scenario.has_walls else 0.0, -inf, call)
    distance = np.linalg.norm(run.error[:, :2], axis=-1)
    counted = run.t >= min(scenario.after, run.t[-2]) - 1e-9
    inputs = inputs_of(scenario.robot)
    alike = [k for k, one in enumerate(inputs) if one.unit == inputs[0].unit]
    u = run.u[counted][:, alike]
    moved = np.abs(np.diff(u, axis=0)).sum(axis=0).max() / (run.t[-1] - run.t[counted][0])
    late = distance[counted]
    place = run.poses[:, :2]
    outside = np.maximum(np.asarray(scenario.lower) - place, place - np.asarray(scenario.upper))
    return Score(
        largest=float(late.max()),
        rms=_rms(late),
        largest_from_start=float(distance.max()),
        rms_from_start=_rms(distance),
        force=_rms(np.linalg.norm(u, axis=-1)),
        chatter=float(moved),
        recovery=_recovery(scenario, run.t, distance),
        beyond=max(float(outside.max()), 0.0),
        margin=_margin(run),
        call=_cost(scenario, controller, run),
    )


def _recovery(scenario: BenchmarkScenario, t: Array, distance: Array) -> float:
    outside = np.flatnonzero((distance > scenario.band) & (t >= scenario.event))
    if not len(outside):
        return 0.0
    last = outside[-1] + 1
    return inf if last == len(t) else float(t[last] - scenario.event)


def _margin(run: Rollout) -> float:
    try:
        return float(tip_over_margin(run).min())
    except InvalidArgument:
        return nan


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _cost(scenario: BenchmarkScenario, controller: Controller, run: Rollout) -> float:
    """Return the CPU time of a call [s], where a run began."""
    made: Any = scenario.around(controller)
    context = Context.of(
        run.plant, dt=scenario.dt, t=run.t, reference=run.reference, trajectory=scenario.trajectory
    )
    count = min(_CALLS, len(run.t))
    rows = [type(run.reference)(*(part[k] for part in run.reference)) for k in range(count)]
    state = made.initial_state(context)
    begin = process_time()
    for k, reference in enumerate(rows):
        _, state = made(run.t[k], run.q[k], run.v[k], reference, state)
    return (process_time() - begin) / count
