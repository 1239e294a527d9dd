"""Forces of the ground on wheels, how far these are from slipping, and what is judged of a robot on them.

Everything is over scalars: numbers, arrays with leading axes, or symbols.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import choose, higher, square_root
from pinmobile.measures import Measure
from pinmobile.robot import (
    WEIGHTLESS,
    ZERO,
    Vector,
    cross,
    dot,
    margin_inside,
    number,
    pressed_at,
    scalars,
    sine_and_cosine,
    vector_of,
)
from pinmobile.wheels.kinematics import Row
from pinmobile.wheels.loads import places_of, pressed, shared_loads
from pinmobile.wheels.table import GearTrain

_BASE = 3


class Group(NamedTuple):
    """Wheels whose lateral forces are found: one wheel, or some of which only the sum is determined.

    Attributes
    ----------
    wheels : tuple of int
        Rows of the table.
    lateral : tuple of int
        Their lateral rows among those of the kinematics; none of wheels with rollers.
    held : int
        Which row of ``choice.body`` it is; -1: a row that a joint tells, or none.
    """

    wheels: tuple[int, ...]
    lateral: tuple[int, ...]
    held: int


class Margin(NamedTuple):
    """How far wheels are from slipping.

    Attributes
    ----------
    along : list of scalars
        Force of the ground along each wheel, or along the axis of its roller [N].
    lateral : list of scalars
        That across the wheels of each group, in the sum [N].
    margins : list of scalars
        Of each group [N].
    """

    along: Vector
    lateral: Vector
    margins: Vector


def groups_of(body: Any) -> tuple[Group, ...]:
    """Return the groups of wheels of a body that rolls, in the order of their first wheels.

    A drive with gear trains, whose wheels share what these transmit, has none.
    """
    table, choice = body.table, body.choice
    if any(isinstance(one, GearTrain) for one in table.couplings):
        return ()
    rows = _still_rows(body)
    told = {i for _, i in choice.joints}
    sharing: dict[int, list[int]] = {k: [] for k in range(len(choice.body))}
    found = []
    for i, row in enumerate(rows):
        if row.kind == "roller":
            found.append(Group((row.wheel,), (), -1))
        elif row.kind == "lateral" and i in told:
            found.append(Group((row.wheel,), (i,), -1))
        elif row.kind == "lateral":
            sharing[_axle(body, rows, row)].append(i)
    for k, own in sharing.items():
        found.append(Group(tuple(rows[i].wheel for i in own), tuple(own), k))
    return tuple(sorted(found))


def _still_rows(body: Any) -> list[Row]:
    still: Vector = [ZERO] * body.joints
    return body.kinematics.rows([ZERO] * len(body.table.axes), [ZERO] * _BASE, still)  # type: ignore[no-any-return]


def _axle(body: Any, rows: Sequence[Row], row: Row) -> int:
    """Return on which of the rows that hold the body a lateral row's wheel stands."""
    held, axes = body.choice.body, body.table.axes
    if len(held) == 1:
        return 0
    if row.wheel in (rows[i].wheel for i in held):
        return [rows[i].wheel for i in held].index(row.wheel)
    if body.choice.is_fixed:
        return int(any(row.wheel in axis.wheels for axis in axes))
    own = next(axis.wheels for axis in axes if row.wheel in axis.wheels)
    return int(rows[held[0]].wheel not in own)


def margin(body: Any, state: Any, felt: Vector, u: Any, carried: Vector, q: Any) -> Margin:
    """Return the forces of wheels that roll, and their margins before they slip.

    The force along a wheel is what its spin leaves of its torque; that across one axle what body and arms
    need beyond; across two axles both are. Wheels of one axle share: its margin is that of the best split,
    ``sum sqrt((mu N)^2 - along^2) - |Y|``, and no more than ``mu N - |along|`` of each. Two wheels that steer
    by Ackermann count as an axle through the wheel in their middle.

    Parameters
    ----------
    body : RollingDynamics
        What rolls.
    state, felt, q
        As in `pressed`.
    u : ndarray, shape (..., nu)
        Torques.
    carried : list of scalars
        Loads of wheels, and of supports behind them [N].
    """
    groups, ns, first = body.groups, len(body.table.axes), _BASE + body.na
    M, n, tau = body.inertia(state, q), body.effects(state, q), body.generalised(state, u, 0.0)
    rows = body.kinematics.rows(state.steering, state.twist, state.rates)
    of_wheels = {row.wheel: i for i, row in enumerate(rows) if row.kind in ("rolling", "roller")}

    def left(k: int) -> Any:
        return n[k] + dot(M[k], felt) - tau[k]

    forces: dict[int, Any] = {}
    for joint, i in sorted(body.choice.joints, reverse=True):  # wheels, and then what they steer
        others = [rows[j].joints[joint] * x for j, x in forces.items()] if joint < ns else []
        rest = left(first + joint)
        for x in others:
            rest = rest - x
        forces[i] = rest / rows[i].joints[joint]
    base = [left(k) for k in range(_BASE)]
    for i, x in forces.items():
        base = [b - x * c for b, c in zip(base, rows[i].base, strict=True)]
    held = _axles(body, state, rows)
    if len(held) == 1:
        across = [held[0][0] * base[0] + held[0][1] * base[1]]
    elif held:
        about = cross(held[0], held[1])
        share = 1.0 / number(dot(about, about))
        across = [dot(cross(base, held[1]), about) * share, dot(cross(held[0], base), about) * share]
    along = [number(forces[of_wheels[row]]) for row in range(len(body.table))]
    most = [mu * load for mu, load in zip(scalars(body.mu), carried, strict=False)]
    lateral, margins = [], []
    for group in groups:
        side = forces[group.lateral[0]] if group.held < 0 and group.lateral else ZERO
        side = number(across[group.held] if group.held >= 0 else side)
        lateral.append(side)
        margins.append(_margin([(along[k], most[k]) for k in group.wheels], side, bool(group.lateral)))
    return Margin(along, lateral, margins)


def _axles(body: Any, state: Any, rows: Sequence[Row]) -> list[Vector]:
    """Return the base of what each axle's lateral force acts along."""
    found = []
    for i in body.choice.body:
        axis = next((k for k, axis in enumerate(body.table.axes) if rows[i].wheel in axis.wheels), None)
        if axis is None or body.table.axes[axis].ackermann is None:
            found.append(rows[i].base)
            continue
        s, c = sine_and_cosine(state.steering[axis])
        found.append([-s, c, c * body.kinematics.x[rows[i].wheel]])
    return found


def _margin(wheels: Sequence[tuple[Any, Any]], side: Any, is_tyre: bool) -> Any:
    """Return the margin of wheels, each with its force along and its largest friction."""
    if not is_tyre:
        return wheels[0][1] - abs(wheels[0][0])
    if len(wheels) == 1:
        force, most = wheels[0]
        return most - square_root(force * force + side * side)
    least, total = None, ZERO
    for force, most in wheels:
        own, rest = most - abs(force), most * most - force * force
        total = total + square_root(higher(number(rest), 0.0))
        least = own if least is None else choose(own < least, own, least)
    rest = total - abs(side)
    return choose(rest < least, rest, least)


def lowest(values: Sequence[Any]) -> Any:
    """Return the least of scalars."""
    found = values[0]
    for x in values[1:]:
        found = choose(x < found, x, found)
    return found


def arms_of(body: Any) -> Any:
    """Return the judgement of the arms that a body carries; None: it carries none."""
    return getattr(body.robot, "judgement", None) if body.na else None


def footprint_of(body: Any) -> Array | None:
    """Return the corners of what a body with arms stands on, shape (k, 2) [m], if that is judged."""
    return body.footprint if body.stands and arms_of(body) is not None else None


def limits_of(body: Any) -> list[tuple[int, float]]:
    """Return which inputs have limits, each with the largest size."""
    found = [(k, max(abs(one.lower), abs(one.upper))) for k, one in enumerate(body.inputs)]
    return [(k, limit) for k, limit in found if np.isfinite(limit)]


def measures_of(body: Any) -> tuple[Measure, ...]:
    """Return what `measured` gives.

    Parameters
    ----------
    body : WheeledDynamics
        Whose they are.
    """
    arms, found = arms_of(body), []
    if arms is not None:
        found += [one for one in arms.measures if one.name.startswith("end effector")]
    if limits_of(body):
        found.append(Measure("effort", "", "largest |torque| of a joint or wheel, of what its motor can do"))
    if footprint_of(body) is not None:
        words = "distance of the zero-moment point inside the edge of what it stands on"
        found.append(Measure("tip-over margin", "m", words, "smallest"))
    if body.stands:
        words = "smallest load of a wheel or support, as springs that pull too would share them"
        found.append(Measure("load", "N", words, "smallest"))
        words = "no loads of wheels and supports balance them; tipping over is not simulated"
        found.append(Measure("tip over", "", words, "ever"))
    if body.slips:
        found.append(Measure("slip", "m/s", "largest velocity at which a wheel slides on the ground"))
    elif body.stands and body.groups:
        words = "smallest friction that a wheel, or an axle, has left before it slips"
        found.append(Measure("slip margin", "N", words, "smallest"))
    return tuple(found)


def measured(body: Any, q: Any, v: Any, a: Any, u: Any, desired: Any) -> Any:
    """Return the measures of a robot that moves so, shape (..., m).

    Parameters
    ----------
    body : WheeledDynamics
        Whose they are.
    q, v, a, u : ndarray, shape (..., nq), (..., nv), (..., nv), (..., nu)
        State, acceleration and input.
    desired : ndarray, shape (..., k)
        Where the reference has the first numbers of q.
    """
    state, found, arms = body.state(q, v), [], arms_of(body)
    if arms is not None and arms.tips:
        found += scalars(arms.apart(body.robot, q[..., : int(body.robot.nq)], desired))
    limits = limits_of(body)
    if limits:
        inputs, most = scalars(u), 0.0
        for k, limit in limits:
            most = higher(abs(number(inputs[k])) * (1.0 / limit), most)
        found.append(most)
    if body.stands:
        found += _of_ground(body, state, a, u, q)
    if body.slips:
        found.append(_slip(body, state))
    return vector_of([number(x) for x in found], q)


def _of_ground(body: Any, state: Any, a: Any, u: Any, q: Any) -> Vector:
    rates = scalars(a)
    along = [state.c * rates[0] + state.s * rates[1], state.c * rates[1] - state.s * rates[0], *rates[2:]]
    felt, found = body.felt(state, along), []
    fz, mx, my = pressed(body, state, felt, q)
    corners = footprint_of(body)
    if corners is not None:
        wrench = vector_of([ZERO, ZERO, fz, mx, my, ZERO], q)
        carried = wrench[..., 2] > WEIGHTLESS * body.weight
        inside = margin_inside(corners, pressed_at(wrench, carried))
        found += scalars(np.where(carried, inside, -np.inf)[..., None])
    places = places_of(body, state.steering)
    shared = shared_loads(places, fz, mx, my)
    found += [lowest(shared.springs), shared.tips]
    if not body.slips and body.groups:
        found.append(lowest(margin(body, state, felt, u, shared.values, q).margins))
    return found


def _slip(body: Any, state: Any) -> Any:
    """Return the largest velocity at which a wheel slides; one with rollers slides along their axes."""
    slips: dict[int, Vector] = {}
    for row in body.kinematics.rows(state.steering, state.twist, state.rates):
        if row.wheel >= 0:
            slip = dot(row.base, state.twist) + dot(row.joints, state.rates)
            slips.setdefault(row.wheel, []).append(number(slip))
    most: Any = 0.0
    for slip in slips.values():
        most = higher(sum((x * x for x in slip[1:]), slip[0] * slip[0]), most)
    return square_root(most)
