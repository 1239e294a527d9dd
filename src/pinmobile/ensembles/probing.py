"""What a user's controller and forces make of arrays, asked before any robot moves."""

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.controllers import PD, ComputedTorque
from pinmobile.ensembles.layers import core_of
from pinmobile.ensembles.scenario import Scenario
from pinmobile.errors import InvalidArgument, PinmobileError
from pinmobile.plant import Context
from pinmobile.trajectories import Reference

__all__ = ["Ask", "check_functions", "context_of", "fresh"]

_ROWS = 4  # of three, rows could be taken for coordinates
_CLOSE = 1e-9  # of the largest force: rounding, which may depend on how many rows there are
_WISH = "in an ensemble it works on arrays, one row per robot"

Ask = Callable[[Any, float, Array, Array, Reference, Any], tuple[Array, Any]]


def fresh(controller: Any) -> Any:
    """Return a copy of a user's controller, so that what it keeps in itself is each run's own.

    The library's keep nothing. What cannot be copied is returned as it is.
    """
    if type(controller) in (PD, ComputedTorque):
        return controller
    try:
        return deepcopy(controller)
    except Exception:  # whatever it is that it holds
        return controller


def context_of(scenario: Scenario) -> Context:
    """Return what a scenario's controller is told before the first sample."""
    return Context.of(
        scenario.robot,
        dt=scenario.dt,
        t=scenario.t,
        reference=scenario.reference,
        trajectory=scenario.trajectory,
    )


def check_functions(scenario: Scenario, ask: Ask) -> None:
    """Refuse a user's controller or force that is written for one robot, or that mixes the rows of several.

    Parameters
    ----------
    scenario : Scenario
        Whose they are.
    ask : callable
        ``ask(controller, t, q, v, reference, state)`` returns its force, shape checked, and state.

    Raises
    ------
    InvalidArgument
        If one returns another shape, fails, or gives a robot beside others another force than alone.
    """
    t, at = float(scenario.t[0]), Reference(*(part[0] for part in scenario.reference))
    steps = np.arange(1.0, 1 + 3 * _ROWS).reshape(_ROWS, 3) * 1e-2  # no two rows alike
    q, v = at.q + np.sin(7 * steps) * 0.1, at.v + np.sin(11 * steps) * 0.1
    core = core_of(scenario.controller)

    def force_of_controller(q: Array, v: Array) -> Array:
        copied = fresh(core)
        return ask(copied, t, q, v, at, copied.initial_state(context_of(scenario)))[0]

    _check_rows("controller", force_of_controller, t, q, v)
    for k, force in enumerate(scenario.forces):
        _check_rows(f"forces[{k}]", _asking(force, f"forces[{k}]", t), t, q, v)


def _asking(force: Any, name: str, t: float) -> Callable[[Array, Array], Array]:
    def asked(q: Array, v: Array) -> Array:
        pushed = np.asarray(fresh(force)(t, q.copy(), v.copy()))
        if pushed.shape != q.shape:
            raise InvalidArgument(
                f"{name} returned shape {pushed.shape} for q of shape {q.shape}, expected {q.shape}: {_WISH}"
            )
        return pushed

    return asked


def _check_rows(name: str, force: Callable[[Array, Array], Array], t: float, q: Array, v: Array) -> None:
    told = f"at t = {t:g} s for q of shape"
    answers = []
    with np.errstate(all="ignore"):
        for rows in (slice(None), *(slice(i, i + 1) for i in range(len(q)))):
            try:
                answers.append(force(q[rows], v[rows]))
            except PinmobileError:
                raise
            except Exception as error:
                raise InvalidArgument(
                    f"{name} failed {told} {q[rows].shape} with {type(error).__name__}: {error}; {_WISH}"
                ) from error
    together, alone = answers[0], np.concatenate(answers[1:])
    size = np.abs(np.nan_to_num(alone)).max()
    differs = ~np.isclose(together, alone, rtol=_CLOSE, atol=_CLOSE * size, equal_nan=True).all(axis=-1)
    if differs.any():
        i = int(np.argmax(differs))
        raise InvalidArgument(
            f"{name} returned {together[i].tolist()} {told} {q.shape} in row {i}, and {alone[i].tolist()} "
            f"for that row alone, expected the same: {_WISH}"
        )
