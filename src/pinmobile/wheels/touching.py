"""What the ground does at the wheels over a run, on ground of either kind, as `pinmobile.plant.Contacts`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.plant import Contacts
from pinmobile.robot import number
from pinmobile.wheels.kinematics import Kinematics

_STILL = 1e-9  # [rad/s], below which a body does not turn
_TOLD = ("along", "across", "slip_along", "slip_across", "loads", "slides")
_ACROSS = {"rolling": 0, "roller": 0, "lateral": 1, "across": 1}


def contacts_of(wheeled: Any, q: Array, v: Array, a: Array, u: Array, signals: Mapping[str, Any]) -> Contacts:
    """Return the contacts of a robot on wheels at the samples of a run.

    On `Coulomb` ground they are the signals of the run, means over the step before. On `Rolling` ground they
    are the constraint forces of state and input, forces on the body beside it left out; their limits are what
    the wheels' own friction would give at the loads of the recorded acceleration.

    Parameters
    ----------
    wheeled : WheeledRobot
        The robot.
    q, v, a, u : ndarray, shape (n, ...)
        Of the samples.
    signals : mapping of str to Signal
        Of the run.
    """
    table, n = wheeled.table, len(q)
    k = len(table)
    steering = list(np.moveaxis(q[:, wheeled.robot.nq : wheeled.robot.nq + len(table.axes)], -1, 0))
    places, directions = _placed(Kinematics.of(table), q, steering)
    mu = wheeled.mu
    if not wheeled._rolls_ideally:
        _check_signals(signals, n)
        forces = np.stack([signals["along"].values, signals["across"].values], axis=-1)
        slips = np.stack([signals["slip_along"].values, signals["slip_across"].values], axis=-1)
        loads, slides = signals["loads"].values[:, :k], signals["slides"].values > 0.5
        regular = wheeled.mobility.is_regular
        determined = _known(wheeled) if regular else np.ones((k, 2), bool)
    else:
        forces, determined = _constrained(wheeled, q, v, u), _known(wheeled)
        loads, slips, slides = _carried(wheeled, q, v, a), np.zeros((n, k, 2)), np.zeros((n, k), bool)
        slips[..., 1] = _rolls_over(wheeled, q, v)
    across = [mu[i] if w.roller is None else w.friction.across for i, w in enumerate(table.wheels)]
    limits = loads[..., None] * np.stack([mu, across], axis=-1)
    return Contacts(
        table.names,
        places,
        directions,
        forces,
        determined,
        loads,
        limits,
        slips,
        np.asarray(slides, bool),
        _centre(wheeled.pose(q), wheeled.rate(q, v)),
    )


def _check_signals(signals: object, n: int) -> None:
    """Refuse signals that are not those of a run on ground where wheels slip."""
    for name in _TOLD:
        values = getattr(signals.get(name), "values", None) if isinstance(signals, Mapping) else None
        if not isinstance(values, np.ndarray) or values.ndim != 2 or len(values) != n:
            raise InvalidArgument(
                f"signals has no {name!r} of {n} samples, expected the signals of a run of this robot"
            )


def _placed(kinematics: Kinematics, q: Array, steering: list[Array]) -> tuple[Array, Array]:
    """Return where wheels touch the ground, shape (n, k, 2), and angles of their first direction, (n, k)."""
    c, s, n = np.cos(q[:, 2]), np.sin(q[:, 2]), len(q)
    places, directions = np.empty((n, len(kinematics.table), 2)), np.empty((n, len(kinematics.table)))
    for row, wheel in enumerate(kinematics.table.wheels):
        _, centre = kinematics.centre(row, steering)
        x, y = (number(p) for p in centre)
        places[:, row, 0], places[:, row, 1] = q[:, 0] + c * x - s * y, q[:, 1] + s * x + c * y
        head = kinematics.heading(row, steering)
        angle = np.arctan2(number(head.s), number(head.c)) + (wheel.roller or 0.0)
        directions[:, row] = q[:, 2] + angle
    return places, directions


def _rows_of(wheeled: Any) -> dict[int, tuple[int, int]]:
    """Return wheel and direction of each row of the constraints that is a wheel's."""
    own, found = wheeled.table.names, {}
    for j, name in enumerate(wheeled.constraint_names):
        wheel, _, kind = name.rpartition(" ")
        if wheel in own:
            found[j] = own.index(wheel), _ACROSS[kind]
    return found


def _known(wheeled: Any) -> NDArray[np.bool_]:
    """Return whether the force in each direction is determined where no wheel slides, shape (k, 2)."""
    found = np.ones((len(wheeled.table), 2), bool)
    for j, at in _rows_of(wheeled).items():
        found[at] = wheeled.mobility.determined[j]
    return found


def _constrained(wheeled: Any, q: Array, v: Array, u: Array) -> Array:
    """Return what holds the wheels where they roll, shape (n, k, 2)."""
    values = wheeled.constraint_forces(q, v, u).values
    forces = np.zeros((len(q), len(wheeled.table), 2))
    for j, (row, side) in _rows_of(wheeled).items():
        forces[:, row, side] = values[:, j]
    return forces


def _rolls_over(wheeled: Any, q: Array, v: Array) -> Array:
    """Return how fast the ground passes across rollers, shape (n, k) [m/s]; 0 of tyres."""
    found, rolling = np.zeros((len(q), len(wheeled.table))), wheeled.array_dynamics
    state = rolling.state(q, v)
    for row in rolling.kinematics.rows(state.steering, state.twist, state.rates, across=True):
        if row.kind == "across":
            entries = [*state.twist, *state.rates]
            terms = [number(x) * number(y) for x, y in zip(row.entries, entries, strict=True)]
            found[:, row.wheel] = sum(terms)
    return found


def _carried(wheeled: Any, q: Array, v: Array, a: Array) -> Array:
    """Return the loads of the wheels, shape (n, k) [N]; not a number where they cannot be told."""
    k = len(wheeled.table)
    if not wheeled.array_dynamics.stands:
        return np.full((len(q), k), np.nan)
    return np.asarray(wheeled.contact_loads(q, v, a).values[:, :k])


def _centre(pose: Array, rate: Array) -> Array:
    """Return the instantaneous centre of rotation, shape (n, 2)."""
    w = rate[:, 2]
    turns = np.abs(w) > _STILL
    safe = np.where(turns, w, 1.0)
    found = pose[:, :2] + np.stack([-rate[:, 1], rate[:, 0]], axis=-1) / safe[:, None]
    return np.where(turns[:, None], found, np.inf)
