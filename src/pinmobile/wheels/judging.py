"""What is judged of a robot on wheels beside errors: loads, slip, torques, and the arms that it carries.

Everything is over scalars: numbers, arrays with leading axes, or symbols.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import higher, square_root
from pinmobile.measures import Measure
from pinmobile.robot import (
    WEIGHTLESS,
    ZERO,
    Vector,
    dot,
    margin_inside,
    number,
    pressed_at,
    scalars,
    vector_of,
)
from pinmobile.wheels.loads import places_of, pressed, shared_loads
from pinmobile.wheels.standing import lowest, margin


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
    found.append(lowest(shared.springs))
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
