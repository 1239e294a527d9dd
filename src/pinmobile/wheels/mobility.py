"""`Mobility`: what a wheel table lets a robot do, by ranks (Campion, Bastin, d'Andrea-Novel 1996)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot import number
from pinmobile.wheels.kinematics import Choice, Kinematics, Row
from pinmobile.wheels.rows import Rows

_RANK = 1e-9  # singular values below, relative to the largest, are rounding
_COEFFICIENT = 1e-12


@final
@dataclass(frozen=True)
class Mobility:
    """What the rows of a table determine, where its steering angles are none in particular.

    Parameters
    ----------
    table : WheelTable
        The wheels.

    Raises
    ------
    InvalidArgument
        If it is no table.
    """

    table: Rows

    def __post_init__(self) -> None:
        _checked(self.table)

    @classmethod
    def of(cls, table: Rows) -> Mobility:
        """Return that of a table, which is found once.

        Raises
        ------
        InvalidArgument
            If it is no table.
        """
        return _remembered(_checked(table))

    @cached_property
    def _angles(self) -> Array:
        """Steering angles that are in no relation to each other [rad]."""
        axes = self.table.axes
        return np.array([min(0.9 * axis.limit, 0.31 + 0.23 * k) for k, axis in enumerate(axes)])

    @cached_property
    def _rows(self) -> list[Row]:
        kinematics = Kinematics.of(self.table)
        return kinematics.rows(self._angles.tolist(), [0.0] * 3, [0.0] * kinematics.n)

    @cached_property
    def matrix(self) -> Array:
        """The rows at these angles, shape (k, 3 + steering + wheels)."""
        return np.array([[float(number(x)) for x in row.entries] for row in self._rows])

    @cached_property
    def rank(self) -> int:
        """Rank of the rows."""
        return _rank(self.matrix)

    @cached_property
    def _lateral(self) -> tuple[list[int], list[int]]:
        """Rows that hold the body alone: of fixed wheels, and of steered ones."""
        steered = {row for axis in self.table.axes for row in axis.wheels}
        held = [
            i
            for i, row in enumerate(self._rows)
            if row.kind == "lateral" and np.abs(self.matrix[i, 3:]).max() < _COEFFICIENT
        ]
        return [i for i in held if self._rows[i].wheel not in steered], [
            i for i in held if self._rows[i].wheel in steered
        ]

    @cached_property
    def mobility(self) -> int:
        """Degrees of freedom of the body at given steering angles: 3 less the rank of the lateral rows."""
        return 3 - _rank(self.matrix[[*self._lateral[0], *self._lateral[1]], :3])

    @cached_property
    def steerability(self) -> int:
        """How many steering angles may be chosen: what wheels steered about their centres add to the rank."""
        return 3 - self.mobility - _rank(self.matrix[self._lateral[0], :3])

    @cached_property
    def why_not(self) -> str:
        """Why the drive cannot roll ideally, as a sentence; empty where it can."""
        fixed, steered = self._lateral
        names = self.table.names
        if _rank(self.matrix[fixed, :3]) > 1:
            told = ", ".join(repr(names[self._rows[i].wheel]) for i in fixed)
            return f"wheels {told} are fixed on more than one axle, so it turns only by skidding"
        if self.mobility < 1:
            told = ", ".join(repr(names[self._rows[i].wheel]) for i in [*fixed, *steered])
            return (
                f"wheels {told} are more than two axles, whose lines meet in one point only if the angles "
                "fit together, and no force of the ground keeps them so"
            )
        trains = [row.kind == "train" for row in self._rows]
        if any(trains) and _rank(self.matrix) > _rank(self.matrix[~np.array(trains)]):
            return (
                "wheels on one gear train would have to turn at different rates, so it turns only by skidding"
            )
        if self.mobility < 3 and self.mobility + self.steerability < 2:
            return "its wheels let it move along one curve only"
        return ""

    @property
    def is_regular(self) -> bool:
        """Whether the drive can roll without slip."""
        return not self.why_not

    @property
    def kind(self) -> str:
        """What the drive is, in words."""
        if not self.is_regular:
            return "a drive that does not roll without slip"
        return f"a drive of type ({self.mobility}, {self.steerability})"

    @cached_property
    def choice(self) -> Choice:
        """Which rows determine what, for a drive that can roll."""
        fixed, steered = self._lateral
        body: list[int] = []
        for i in [*fixed, *steered]:
            if _rank(self.matrix[[*body, i], :3]) > len(body):
                body.append(i)
        ns, joints, told = len(self.table.axes), [], set()
        for i, row in enumerate(self._rows):
            for axis in range(ns):
                if (
                    row.kind == "lateral"
                    and abs(self.matrix[i, 3 + axis]) >= _COEFFICIENT
                    and axis not in told
                ):
                    told.add(axis)
                    joints.append((axis, i))
        wheels = [
            (ns + row.wheel, i) for i, row in enumerate(self._rows) if row.kind in ("rolling", "roller")
        ]
        free = tuple(axis for axis in range(ns) if axis not in told)
        return Choice(tuple(body), bool(body) and body[0] in fixed, (*joints, *wheels), free)

    @cached_property
    def determined(self) -> tuple[bool, ...]:
        """Of each row, whether rolling determines its force; of others only sums are."""
        u, s, _ = np.linalg.svd(self.matrix)
        rank = int(np.sum(s > _RANK * s[0]))
        return tuple(bool(np.abs(row).max(initial=0.0) < 1e-9) for row in u[:, rank:])

    @cached_property
    def idle(self) -> Array | None:
        """A body twist, shape (3,), at which no wheel turns or steers, as of omni wheels all along one line.

        Its largest number is 1; None where there is none.
        """
        if _rank(self.matrix[:, :3]) == 3:
            return None
        twist = np.linalg.svd(self.matrix[:, :3])[2][-1]
        found = np.round(twist / twist[np.abs(twist).argmax()], 9) + 0.0
        return np.asarray(found)

    def __str__(self) -> str:
        if self.why_not:
            return f"of no type, as it cannot roll without slip: {self.why_not}"
        m, s = self.mobility, self.steerability
        kind = {
            (3, 0): "omnidirectional",
            (2, 0): "differential",
            (2, 1): "one steered axle",
            (1, 1): "car-like",
            (1, 2): "two steered axles",
        }.get((m, s), "")
        lines = [f"type ({m}, {s}){f', {kind}' if kind else ''}: mobility {m}, steerability {s}"]
        rows, columns = self.matrix.shape
        lines.append(
            f"{columns} coordinates, {rows} rows of rank {self.rank}, {columns - self.rank} free velocities"
        )
        if self.idle is not None:
            along = ", ".join(f"{x:.3g}" for x in self.idle)
            moves = f"moves by (forward, left, turn) = ({along}) while no wheel turns"
            lines.append(f"{moves}: no motor drives that")
        loose = [
            f"{row.kind} of {self.table.names[row.wheel]}"
            for row, known in zip(self._rows, self.determined, strict=True)
            if not known and row.wheel >= 0
        ]
        if loose:
            lines.append(f"forces that rolling does not determine, but for their sum: {', '.join(loose)}")
        else:
            lines.append("rolling determines the force of every wheel")
        return "\n".join(lines)


def _checked(table: object) -> Rows:
    if not isinstance(table, Rows):
        raise InvalidArgument(f"table is {shown(table)}, expected a WheelTable")
    return table


@lru_cache(maxsize=256)
def _remembered(table: Rows) -> Mobility:
    return Mobility(table)


def _rank(matrix: Array) -> int:
    if not matrix.size:
        return 0
    s = np.linalg.svd(matrix, compute_uv=False)
    return int(np.sum(s > _RANK * s[0]))
