"""Loads of wheels and supports: how what the ground exerts on a robot is shared among what stands on it.

Everything is over scalars: numbers, arrays with leading axes, or symbols.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from pinmobile.compiled import choose, higher
from pinmobile.robot import ONE, ZERO, Vector, dot, number

_FLAT = 1e-9  # of the determinant of all contacts: those that are left stand on a line
_NOTHING = 1e-12  # of the weight: what rounding makes of a contact without load
_DROPS = 3  # times that contacts are dropped, at most


class Loads(NamedTuple):
    """What each contact carries.

    Attributes
    ----------
    values : list of scalars
        Of each contact, none below zero [N].
    tips : scalar
        1 where no loads of three contacts, or more, balance the robot, which begins to tip over; what is
        told then carries the weight alone. Else 0.
    springs : list of scalars
        What equal springs at all contacts would carry that may pull too: below zero where a contact has no
        load [N].
    """

    values: Vector
    tips: Any
    springs: Vector


def shared_loads(places: Sequence[Vector], fz: Any, mx: Any, my: Any, drops: int | None = None) -> Loads:
    """Return the loads that balance a wrench: those of equal springs, which press and never pull.

    N = K G' (G K G')^-1 b with the rows 1, y, -x of G and b = (fz, mx, my); a contact with N < 0 is dropped,
    and the others are found again.

    Parameters
    ----------
    places : sequence of (x, y), scalars
        Of the contacts, along the body's axes from its origin on the ground [m].
    fz, mx, my : scalars
        Force of the ground along the vertical [N], and its moment about the body's origin [N m].
    drops : int, optional
        How often contacts are dropped; by default as often as may be of use, three times at most.
    """
    count = min(max(len(places) - 3, 0), _DROPS) if drops is None else drops
    fz, mx, my = number(fz), number(mx), number(my)
    kept: Vector = [ONE] * len(places)
    values, whole = _of_springs(places, kept, [fz, mx, my])
    springs = values
    least, tips = -_NOTHING * abs(fz), choose(fz <= 0.0, 1.0, 0.0)
    for _ in range(count):
        kept = [choose(x < least, 0.0, number(weight)) for x, weight in zip(values, kept, strict=True)]
        found, area = _of_springs(places, kept, [fz, mx, my], _FLAT * whole)
        stands = area > _FLAT * whole
        values = [choose(stands, x, y) for x, y in zip(found, values, strict=True)]
        tips = choose(stands, tips, 1.0)
    for x in values:
        tips = choose(x < least, 1.0, tips)
    pressed = [higher(x, 0.0) for x in values]
    total = sum(pressed[1:], pressed[0])
    # Where one is below zero that cannot be dropped, the others carry the weight, and moments are left.
    scale = choose(tips > 0.0, higher(fz, 0.0) / choose(total > 0.0, total, 1.0), 1.0)
    return Loads([x * scale for x in pressed], tips, springs)


def _of_springs(
    places: Sequence[Vector], weights: Vector, wrench: Vector, flat: Any = None
) -> tuple[Vector, Any]:
    """Return the forces of springs, anything where they stand on a line, and the determinant of G K G'."""
    rows = [[ONE, y, -x] for x, y in places]
    weighed = [[w * x for x in row] for w, row in zip(weights, rows, strict=True)]
    a, d, e, b, f, c = (
        sum((w[i] * row[j] for w, row in zip(weighed, rows, strict=True)), ZERO)
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    )
    minors = [
        [b * c - f * f, e * f - d * c, d * f - e * b],
        [e * f - d * c, a * c - e * e, d * e - a * f],
        [d * f - e * b, d * e - a * f, a * b - d * d],
    ]
    area = number(dot([a, d, e], minors[0]))
    share = 1.0 / (area if flat is None else choose(area > flat, area, 1.0))
    bent = [dot(row, wrench) * share for row in minors]
    return [number(dot(row, bent)) for row in weighed], area
