"""Loads of wheels and supports: how what the ground exerts on a robot is shared among what stands on it.

Everything is over scalars: numbers, arrays with leading axes, or symbols.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pinmobile.compiled import choose, higher, plain, repeated
from pinmobile.robot import ONE, ZERO, Vector, dot, exact, number, scalars, vector_of as stacked

_BASE = 3
_FLAT = 1e-9  # of the determinant of all contacts: those that are left stand on a line
_NOTHING = 1e-12  # of the weight: what rounding makes of a contact without load
_SOFT = 1e-7  # of the moments of all springs: how little the ground holds where contacts stand on a line
_EDGE = 1e-5  # of the size of all contacts: how far beyond their edge the weight may press and not tip


class Loads(NamedTuple):
    """What each contact carries.

    Attributes
    ----------
    values : list of scalars
        Of each contact, none below zero [N].
    tips : scalar
        1 where no loads that press balance the robot, which begins to tip over; what is told then carries
        the weight at the place, on the edge of all contacts, nearest to where it would have to press. Else 0.
    springs : list of scalars
        What equal springs at all contacts would carry that may pull too: below zero where a contact has no
        load [N].
    """

    values: Vector
    tips: Any
    springs: Vector


def shared_loads(places: Sequence[Vector], fz: Any, mx: Any, my: Any) -> Loads:
    """Return the loads that balance a wrench: those of equal springs, which press and never pull.

    The least sum of N^2 with N >= 0 and G' N = b, with the rows 1, y, -x of G and b = (fz, mx, my): contacts
    leave one by one before their load turns negative, and come back where the ground would rise through them
    (Lawson and Hanson, Solving least squares problems, 1974, chapter 23).

    Parameters
    ----------
    places : sequence of (x, y), scalars
        Of the contacts, along the body's axes from its origin on the ground [m].
    fz, mx, my : scalars
        Force of the ground along the vertical [N], and its moment about the body's origin [N m].
    """
    n, wrench = len(places), [number(x) for x in (fz, mx, my)]
    fz, nothing = wrench[0], _NOTHING * abs(wrench[0])
    springs, whole = _of_springs(places, [ONE] * n, wrench)
    size = sum((dot(place, place) for place in places), ZERO)
    press = springs[0] >= -nothing
    for x in springs[1:]:
        press = press & (x >= -nothing)

    def one(numbers: Vector) -> tuple[Vector, Any]:
        kept, old = numbers[:n], numbers[n:]
        found, _ = _of_springs(places, kept, wrench, _SOFT * size)
        share, rises, parts = 1.0 + 0.0 * fz, 0.0 * fz, []
        for k, x, y in zip(kept, old, found, strict=True):
            falls = (k > 0.0) & (y < 0.0)
            parts.append(choose(falls, x / choose(falls, x - y, 1.0), 2.0))
            share = choose(parts[-1] < share, parts[-1], share)
            rises = higher(choose(k > 0.0, 0.0, y), rises)
        leaves, joins = share < 1.0, rises > nothing
        kept = [
            choose(leaves, choose(part <= share, 0.0, k), choose(joins & (y >= rises), 1.0, k))
            for k, part, y in zip(kept, parts, found, strict=True)
        ]
        new = [choose(k > 0.0, x + share * (y - x), 0.0) for k, x, y in zip(kept, old, found, strict=True)]
        return [*kept, *new], (share >= 1.0) & (rises <= nothing)

    first = [1.0 + 0.0 * fz] * n + [higher(fz, 0.0) * (1.0 / n)] * n
    kept, soft = _halves(repeated(one, first, 4 * n, press | (fz <= 0.0)))
    sharp, area = _of_springs(places, kept, wrench, flat=_FLAT * whole)
    stands = area > _FLAT * whole
    values = [choose(k > 0.0, choose(stands, x, y), 0.0) for k, x, y in zip(kept, sharp, soft, strict=True)]
    values = [higher(choose(press, y, x), 0.0) for x, y in zip(values, springs, strict=True)]
    total = sum(values[1:], values[0])
    scale = choose(press, 1.0, higher(fz, 0.0) / choose(total > 0.0, total, 1.0))
    values = [x * scale for x in values]
    off = [dot([place[i] for place in places], values) - x for i, x in ((1, wrench[1]), (0, -wrench[2]))]
    beyond = dot(off, off) > (_EDGE * _EDGE) * size * (fz * fz)
    return Loads(values, choose(beyond | (fz <= 0.0), 1.0, 0.0), springs)


def _halves(x: Vector) -> tuple[Vector, Vector]:
    return x[: len(x) // 2], x[len(x) // 2 :]


def _of_springs(
    places: Sequence[Vector], weights: Vector, wrench: Vector, soft: Any = None, flat: Any = 0.0
) -> tuple[Vector, Any]:
    """Return the forces of springs at all places, where some of them carry, and the determinant of G K G'.

    Parameters
    ----------
    weights : list of scalars
        1 of a spring that carries, else 0.
    soft : scalar, optional
        Added to the moments of inertia: springs on a line hold the robot as well as they can.
    flat : scalar, optional
        Determinant up to which they stand on a line, and what is told is of no use.
    """
    rows = [[ONE, y, -x] for x, y in places]
    weighed = [[w * x for x in row] for w, row in zip(weights, rows, strict=True)]
    a, d, e, b, f, c = (
        sum((w[i] * row[j] for w, row in zip(weighed, rows, strict=True)), ZERO)
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    )
    if soft is not None:
        b, c = b + soft, c + soft
    minors = [
        [b * c - f * f, e * f - d * c, d * f - e * b],
        [e * f - d * c, a * c - e * e, d * e - a * f],
        [d * f - e * b, d * e - a * f, a * b - d * d],
    ]
    area = number(dot([a, d, e], minors[0]))
    share = 1.0 / choose(area > flat, area, 1.0)
    bent = [dot(row, wrench) * share for row in minors]
    return [number(dot(row, bent)) for row in rows], area


def places_of(body: Any, steering: Sequence[Any]) -> list[Vector]:
    """Return where wheels and supports touch the ground, along the body's axes [m]."""
    found = [body.kinematics.centre(row, steering)[1] for row in range(len(body.table))]
    return found + [[exact(each.x), exact(each.y)] for each in body.table.supports]


def wheel_loads(body: Any, state: Any, felt: Vector, q: Any) -> Loads:
    """Return what wheels and supports carry: see `pressed`."""
    return shared_loads(places_of(body, state.steering), *pressed(body, state, felt, q))


def pressed(body: Any, state: Any, felt: Vector, q: Any) -> Vector:
    """Return fz, mx and my of the ground on a robot, wheels spinning [N, N m, N m].

    What the ground exerts is the rate of momentum of all bodies, less gravity: of a robot without arms by
    Newton's and Euler's equations, of others by their recursion; the spin of the wheels is added.

    Parameters
    ----------
    body : WheeledDynamics
        The robot.
    state : State
        Shape and velocities.
    felt : list of scalars
        Accelerations along the body's axes, less gravity in the plane.
    q : ndarray
        Any configuration, for its shape.
    """
    w = state.twist[2]
    fz, mx, my = _carried(body, state, felt, q)
    first = _BASE + body.na
    rates = [*state.rates]
    for row, spin in enumerate(scalars(body.spin_inertia)):
        head, k = body.kinematics.heading(row, state.steering), len(body.table.axes) + row
        steered = [axis for at, axis in body._steered if at == row]
        turn = w + head.first * rates[steered[0]] if steered else w
        faster, slower = spin * felt[first + k], spin * rates[k] * turn
        mx = mx - head.s * faster - head.c * slower
        my = my + head.c * faster - head.s * slower
        wheel = body.table.wheels[row]
        if steered and wheel.mass and any(wheel.trail):  # its weight moves, and its centre swings
            (o, p), (o0, p0) = body._centres(row, state)
            weight, axis = -wheel.mass * float(body.fall[2]), steered[0]
            mx, my = mx + weight * (p[1] - p0[1]), my - weight * (p[0] - p0[0])
            turning = felt[2] + head.first * felt[first + axis] + head.second * rates[axis] * rates[axis]
            swing = wheel.mass * scalars(body.radius)[row]
            ahead = felt[2] * o0[1] - turning * o[1] - turn * turn * o[0] + w * w * o0[0]
            aside = turning * o[0] - felt[2] * o0[0] - turn * turn * o[1] + w * w * o0[1]
            mx, my = mx - swing * aside, my + swing * ahead
    return [fz, mx, my]


def _carried(body: Any, state: Any, a: Vector, q: Any) -> Vector:
    """Return fz, mx and my of the ground, wheels at rest in the body; `a` has no part of gravity."""
    if body.na:
        n = _BASE + body.na
        at, still = stacked([ZERO, ZERO, ZERO, *state.arms], q), stacked([ZERO] * n, q)
        v = stacked([*state.twist, *state.arm_rates], q)
        found = scalars(body.robot.ground_wrench(at, v, stacked(a[:n], q)))[2:5]
        if not body._slack:
            return found
        weights = scalars(body.robot.ground_wrench(at, still, still))[2:5]
        return [x - body._slack * y for x, y in zip(found, weights, strict=True)]
    own = body.robot
    m, x, y = (exact(item(each)) for each in (own.mass, own.com_x, own.com_y))
    (height, xz, yz), w, spin, g = scalars(body.upright), state.twist[2], a[2], -float(body.fall[2])
    ax, ay = a[0] - spin * y - w * w * x, a[1] + spin * x - w * w * y
    mx = m * (y * g - height * ay) + (xz * spin - yz * (w * w))
    my = m * (height * ax - x * g) + (yz * spin + xz * (w * w))
    return [m * g, mx, my]


def item(x: Any) -> Any:
    """Return the entry of an array without axes; an array or a number as it is."""
    x = plain(x)
    return x.item() if isinstance(x, np.ndarray) and not x.ndim else x
