"""Contacts of a robot on wheels with the ground, in states and runs; `TimeScaledMotion` along a reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.plant import ContactLoads, Contacts, SlipMargins, TorqueMargins
from pinmobile.robot import number
from pinmobile.wheels._loads import margin, wheel_loads
from pinmobile.wheels._velocities import Followed, driving_inputs

_STILL = 1e-9  # [rad/s], below which a body does not turn
_FORCES = "along", "across", "loads"
_SECOND = "lateral", "across"  # kinds of rows that are a wheel's second direction


class Forces(NamedTuple):
    """What the ground does at the wheels.

    Attributes
    ----------
    names : tuple of str
        Of the rows, such as ``"left rolling"``.
    values : ndarray, shape (..., k)
        Force of the ground on the robot along each row [N], of a gear train what it transmits.
    determined : ndarray of bool, shape (k,)
        Whether rolling determines it; of the others only sums are, and they are shared so that the sum of
        squares is least.
    """

    names: tuple[str, ...]
    values: Array
    determined: Array


def contact_loads(body: Any, state: Any, felt: Any, q: Array) -> ContactLoads:
    """Return the load of each contact, of arrays."""
    found = wheel_loads(body, state, felt, q)
    names = (*body.table.names, *(f"support {k + 1}" for k in range(len(body.table.supports))))
    tips = np.broadcast_to(number(found.tips), q.shape[:-1]) > 0
    return ContactLoads(names, _stacked(found.values, q), _stacked(found.springs, q), tips)


def rolling_margins(body: Any, state: Any, felt: Any, u: Array, q: Array) -> tuple[ContactLoads, SlipMargins]:
    """Return loads and slip margins of wheels that roll, of arrays."""
    if not body.groups:
        raise InvalidArgument(
            "robot has wheels on a gear train, which share what it transmits, so rolling does not tell the "
            "force of each; expected ground=Coulomb()"
        )
    loads = contact_loads(body, state, felt, q)
    found = margin(body, state, felt, u, list(np.moveaxis(loads.values, -1, 0)), q)
    names = tuple(" + ".join(body.table.names[k] for k in group.wheels) for group in body.groups)
    values = (_stacked(x, q) for x in (found.margins, found.along, found.lateral))
    return loads, SlipMargins(names, *values)


def recorded_margins(body: Any, motion: Any) -> SlipMargins:
    """Return the slip margins in a run of a robot whose wheels may slip: those of its signals."""
    signals = getattr(motion, "signals", None) or {}
    if not set(_FORCES) <= set(signals):
        raise InvalidArgument(
            "motion has no signals of the wheels' forces, without which those on Coulomb ground are not "
            "known; expected the Rollout of a simulation"
        )
    along, across, loads = (np.asarray(signals[name][1]) for name in _FORCES)
    rollers = np.array([wheel.roller is not None for wheel in body.table.wheels])
    size = np.where(rollers, np.abs(along), np.hypot(along, across))
    return SlipMargins(body.table.names, body.mu * loads[..., : len(body.table)] - size, along, across)


@final
@dataclass(frozen=True, eq=False)
class TimeScaledMotion:
    """A robot whose wheels roll along a reference, as fast as it is or faster.

    Parameters
    ----------
    body : RollingDynamics
        What rolls.
    along : Followed
        How it does.
    efforts : ndarray, shape (arms,)
        Largest torques of the arms' joints [N m].
    """

    body: Any
    along: Followed
    efforts: Array

    def at(self, factor: float) -> tuple[ContactLoads, SlipMargins, TorqueMargins]:
        """Return loads, slip and torque margins where it goes along `factor` times as fast, (N, k) each."""
        body, q, v = self.body, self.along.q, factor * self.along.v
        state, rates = body.state(q, v), factor**2 * self.along.rates
        a = body.accelerations(state, list(np.moveaxis(rates, -1, 0)))
        felt = body.felt(state, [number(x) for x in a])
        u = driving_inputs(body, q, v, rates)
        return *rolling_margins(body, state, felt, u, q), self._margins(v, u)

    def _margins(self, v: Array, u: Array) -> TorqueMargins:
        """Return what motors have left of their torques, those of arms and wheels."""
        body, na = self.body, self.body.na
        rates = v[:, 3 + na :] @ np.array([each.column for each in body.table.actuators], float).T
        found = list((self.efforts - np.abs(u[:, :na])).T)
        for actuator, torque, rate in zip(body.table.actuators, u[:, na:].T, rates.T, strict=True):
            found.append(actuator.motor.margin(torque, rate))
        return TorqueMargins(tuple(one.name for one in body.inputs), np.stack(found, axis=-1))


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
    table, body, n = wheeled.table, wheeled.array_dynamics, len(q)
    state, k = body.state(q, v), len(table)
    places, directions = np.empty((n, k, 2)), np.empty((n, k))
    for i, wheel in enumerate(table.wheels):
        x, y = state.outward(body.kinematics.centre(i, state.steering)[1])
        places[:, i, 0], places[:, i, 1] = q[:, 0] + number(x), q[:, 1] + number(y)
        head = body.kinematics.heading(i, state.steering)
        directions[:, i] = q[:, 2] + np.arctan2(number(head.s), number(head.c)) + (wheel.roller or 0.0)
    determined, forces, slips = np.ones((k, 2), bool), np.zeros((n, k, 2)), np.zeros((n, k, 2))
    loads, slides = np.full((n, k), np.nan), np.zeros((n, k), bool)
    rows = body.kinematics.rows(state.steering, state.twist, state.rates)
    if wheeled.mobility.is_regular:
        for row, known in zip(rows, wheeled.mobility.determined, strict=True):
            if row.wheel >= 0:
                determined[row.wheel, int(row.kind in _SECOND)] = known
    if body.slips:
        if not {*_FORCES, "slip_along", "slip_across", "slides"} <= set(signals):
            raise InvalidArgument(
                "signals has no forces of the wheels, expected those of a run of this robot"
            )
        along, across, loads = (signals[name].values for name in _FORCES)
        forces, loads = np.stack([along, across], axis=-1), loads[:, :k]
        slips = np.stack([signals["slip_along"].values, signals["slip_across"].values], axis=-1)
        slides = signals["slides"].values > 0.5
    else:
        for row, force in zip(
            rows, np.moveaxis(wheeled.constraint_forces(q, v, u).values, -1, 0), strict=True
        ):
            if row.wheel >= 0:
                forces[:, row.wheel, int(row.kind in _SECOND)] = force
        if body.stands:
            loads = wheeled.contact_loads(q, v, a).values[:, :k]
        for row in body.kinematics.rows(state.steering, state.twist, state.rates, across=True):
            if row.kind == "across":  # the ground passes across rollers
                slips[:, row.wheel, 1] = row.slip(state)
    own = [wheel.friction.across for wheel in table.wheels]
    across = [mu if w.roller is None else x for mu, x, w in zip(wheeled.mu, own, table.wheels, strict=True)]
    limits = loads[..., None] * np.stack([wheeled.mu, across], axis=-1)
    centre = _rotation_centre(q, v)
    return Contacts(table.names, places, directions, forces, determined, loads, limits, slips, slides, centre)


def _rotation_centre(q: Array, v: Array) -> Array:
    """Return the instantaneous centre of rotation, shape (n, 2)."""
    turns = np.abs(v[:, 2]) > _STILL
    found = q[:, :2] + np.stack([-v[:, 1], v[:, 0]], axis=-1) / np.where(turns, v[:, 2], 1.0)[:, None]
    return np.where(turns[:, None], found, np.inf)


def _stacked(values: Any, q: Array) -> Array:
    return np.stack([np.broadcast_to(number(x), q.shape[:-1]) for x in values], axis=-1)
