"""Wheel kinematics: rolling constraints over scalars, arrays or symbols, and the mobility they leave.

Everything here is along the axes of the body's frame, in which nothing depends on the pose. A scalar is a
number, an array with leading axes, or a symbol.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import plain
from pinmobile.errors import InvalidArgument
from pinmobile.robot import (
    ZERO,
    Matrix,
    Vector,
    cross,
    dot,
    exact,
    number,
    sine_and_cosine,
    solved as solved_by,
)


def unwrap_scalar(x: Any) -> Any:
    """Return the entry of an array without axes; an array or a number as it is."""
    x = plain(x)
    return x.item() if isinstance(x, np.ndarray) and not x.ndim else x


class Row(NamedTuple):
    """A direction in which a wheel touches the ground, or a gear train: times the rates, a velocity.

    Attributes
    ----------
    wheel : int
        Row of the table; -1: a gear train.
    kind : str
        ``"rolling"`` along the wheel, ``"lateral"`` across it, ``"roller"`` along the axes of its rollers,
        ``"across"`` these, or ``"train"``.
    base : list of 3 scalars
        Coefficients of the body twist (forward, left, yaw rate).
    joints : list of scalars
        Coefficients of the rates of the steering coordinates and then the wheels [m].
    drift : scalar
        What it changes at, where no coordinate accelerates [m/s^2].
    """

    wheel: int
    kind: str
    base: Vector
    joints: Vector
    drift: Any

    def slip(self, state: Any) -> Any:
        """Return the velocity at which it slips in a state."""
        return number(dot(self.base, state.twist) + dot(self.joints, state.rates))


class Heading(NamedTuple):
    """Where a wheel rolls to at a steering angle: e, and how it turns with the steering coordinate.

    Attributes
    ----------
    c, s : scalar
        Of the angle of e.
    first, second : scalar
        First and second derivative of that angle by the steering coordinate.
    """

    c: Any
    s: Any
    first: Any
    second: Any


@dataclass(frozen=True, eq=False)
class Kinematics:
    """The rows of a wheel table, with numbers that may differ from robot to robot.

    Parameters
    ----------
    table : WheelTable
        Its structure; its numbers are those of the attributes below.
    x, y, radius : sequence of scalars
        Of each wheel [m].
    """

    table: Any
    x: Vector
    y: Vector
    radius: Vector

    @classmethod
    def of(cls, table: Any) -> Kinematics:
        """Return that of a table's own numbers."""
        names = "x", "y", "radius"
        return cls(
            table, *([exact(unwrap_scalar(getattr(each, name))) for each in table.wheels] for name in names)
        )

    @property
    def n(self) -> int:
        """Number of steering coordinates and wheels."""
        return len(self.table.axes) + len(self.table)

    @cached_property
    def _axis_of(self) -> list[int]:
        """The steering coordinate that turns each wheel; -1: none."""
        found = [-1] * len(self.table)
        for k, axis in enumerate(self.table.axes):
            for row in axis.wheels:
                found[row] = k
        return found

    def heading(self, row: int, steering: Sequence[Any]) -> Heading:
        """Return where a wheel rolls to."""
        wheel, k = self.table.wheels[row], self._axis_of[row]
        if k < 0:
            s, c = sine_and_cosine(exact(wheel.angle))
            return Heading(c, s, ZERO, ZERO)
        axis = self.table.axes[k]
        s, c = sine_and_cosine(steering[k])
        if axis.ackermann is None:
            s0, c0 = sine_and_cosine(exact(wheel.angle))
            return Heading(c0 * c - s0 * s, s0 * c + c0 * s, exact(1.0), ZERO)
        return _ackermann(self.x[row] - axis.ackermann, self.y[row], s, c)

    def rows(
        self, steering: Sequence[Any], twist: Sequence[Any], rates: Sequence[Any], *, across: bool = False
    ) -> list[Row]:
        """Return the rows of all wheels and gear trains.

        Parameters
        ----------
        steering : sequence of scalars
            Steering coordinates [rad].
        twist : sequence of 3 scalars
            Body twist (forward, left, yaw rate) [m/s, rad/s].
        rates : sequence of scalars
            Rates of the steering coordinates and then the wheels [rad/s].
        across : bool
            Whether wheels with rollers have a row across these, in which they slide.
        """
        found: list[Row] = []
        for row in range(len(self.table)):
            found += self._rows_of(row, steering, twist, rates, across)
        ns = len(self.table.axes)
        for first, row, ratio in self.table.trains:
            joints: Vector = [ZERO] * self.n
            joints[ns + first], joints[ns + row] = self.radius[first] * exact(ratio), -self.radius[first]
            found.append(Row(-1, "train", [ZERO] * 3, joints, ZERO))
        return found

    def _rows_of(
        self, row: int, steering: Sequence[Any], twist: Sequence[Any], rates: Sequence[Any], across: bool
    ) -> list[Row]:
        wheel, k, head = self.table.wheels[row], self._axis_of[row], self.heading(row, steering)
        o, p = self.centre(row, steering)
        turn = head.first * rates[k] if k >= 0 else ZERO  # of the wheel about its pivot
        vx, vy, w = twist
        # The centre's velocity, and its acceleration where no coordinate accelerates.
        velocity = [vx - w * p[1] - turn * o[1], vy + w * p[0] + turn * o[0]]
        both, bent = w + turn, head.second * rates[k] * rates[k] if k >= 0 else ZERO
        rest = [w * vy - both * turn * o[0] - bent * o[1], -(w * vx) - both * turn * o[1] + bent * o[0]]
        angle, found = exact(0.0 if wheel.roller is None else wheel.roller), []
        s, c = sine_and_cosine(angle)
        kinds = ("rolling", "lateral") if wheel.roller is None else ("roller", "across")
        directions = [(kinds[0], c, s), (kinds[1], -s, c)]
        for kind, a, b in directions if wheel.roller is None or across else directions[:1]:
            d = [head.c * a - head.s * b, head.s * a + head.c * b]
            across_d = [-d[1], d[0]]
            joints: Vector = [ZERO] * self.n
            if k >= 0:
                joints[k] = (d[1] * o[0] - d[0] * o[1]) * head.first
            joints[len(self.table.axes) + row] = -(self.radius[row] * a)
            drift = dot(d, rest) + turn * dot(across_d, velocity)
            found.append(Row(row, kind, [*d, d[1] * p[0] - d[0] * p[1]], joints, drift))
        return found

    def centre(self, row: int, steering: Sequence[Any]) -> tuple[Vector, Vector]:
        """Return the centre of a wheel from its pivot, and from the body's origin [m]."""
        head, (along, aside) = self.heading(row, steering), (exact(x) for x in self.table.wheels[row].trail)
        o = [along * head.c - aside * head.s, along * head.s + aside * head.c]
        return o, [self.x[row] + o[0], self.y[row] + o[1]]

    def wheel_rates(self, steering: Sequence[Any], twist: Sequence[Any], turning: Sequence[Any]) -> Vector:
        """Return the rates of wheels that roll, tyres by their rolling rows, others by the rollers' rows.

        Parameters
        ----------
        steering, turning : sequence of scalars
            Steering coordinates and their rates [rad, rad/s].
        twist : sequence of 3 scalars
            Body twist [m/s, rad/s].
        """
        ns, still = len(self.table.axes), [ZERO] * self.n
        found: Vector = [ZERO] * len(self.table)
        for row in self.rows(steering, [ZERO] * 3, still):
            if row.kind in ("rolling", "roller"):
                known = dot(row.base, twist) + dot(row.joints[:ns], turning)
                found[row.wheel] = -(known / row.joints[ns + row.wheel])
        return found

    def odometry(self, steering: Sequence[Any], joints: Sequence[Any]) -> Vector:
        """Return the body twist that fits rates of joints best, by least squares of all rows.

        Parameters
        ----------
        steering : sequence of scalars
            Steering coordinates [rad].
        joints : sequence of scalars
            Rates of the steering coordinates and then the wheels [rad/s].
        """
        rows = self.rows(steering, [ZERO] * 3, [ZERO] * self.n)
        columns = [[row.base[k] for row in rows] for k in range(3)]
        known = [-dot(row.joints, joints) for row in rows]
        square = [[dot(a, b) for b in columns] for a in columns]
        return solved_by(square, [dot(column, known) for column in columns], [2, 1, 0])


class RowSelection(NamedTuple):
    """Which rows hold the body, and which tell the rate of a joint; the others follow from these.

    Attributes
    ----------
    body : tuple of int
        Up to two rows, of which the first is of a fixed wheel if one is.
    is_fixed : bool
        Whether the first is of a fixed wheel.
    joints : tuple of (int, int)
        Joint and row, steering coordinates before the wheels.
    free : tuple of int
        Steering coordinates that no row determines.
    """

    body: tuple[int, ...]
    is_fixed: bool
    joints: tuple[tuple[int, int], ...]
    free: tuple[int, ...]


class NullSpaceBasis(NamedTuple):
    """All velocities that roll, S nu, and accelerations, S nu' + gamma.

    Attributes
    ----------
    S : list of lists of scalars, shape (3 + arms + n, m + arms + free)
        Of the body twist, arms, steering coordinates and wheels, by the independent velocities.
    gamma : list of scalars, shape (3 + arms + n,)
        Accelerations, those of the origin along the body's axes.
    """

    S: Matrix
    gamma: Vector


def solve_null_space(rows: Sequence[Row], choice: RowSelection, arms: int) -> NullSpaceBasis:
    """Return what rolls: by one row the body turns about its axle, by two about where these meet.

    Parameters
    ----------
    rows, choice
        Of the wheels.
    arms : int
        Number of the arms' coordinates, which are independent velocities between body and steering axes.
    """
    columns, body = _body_velocities([rows[i] for i in choice.body], choice.is_fixed)
    first, width = 3 + arms, len(columns) + arms + len(choice.free)
    S: Matrix = [[*row, *[ZERO] * (width - len(columns))] for row in zip(*columns, strict=True)]
    S += [[ZERO] * width for _ in range(arms + len(rows[0].joints))]
    gamma = [*body, *[ZERO] * (len(S) - 3)]
    for k, own in enumerate([*range(3, first), *(first + axis for axis in choice.free)], len(columns)):
        S[own][k] = exact(1.0)
    for joint, i in choice.joints:
        own = rows[i].joints[joint]
        joints = (ZERO if j == joint else x for j, x in enumerate(rows[i].joints))
        others = [*rows[i].base, *[ZERO] * arms, *joints]
        S[first + joint] = [-(dot(others, column) / own) for column in zip(*S, strict=True)]
        gamma[first + joint] = -((rows[i].drift + dot(others, gamma)) / own)
    return NullSpaceBasis(S, gamma)


def _body_velocities(held: Sequence[Row], is_fixed: bool) -> tuple[Matrix, Vector]:
    """Return the body twists that no row forbids, as columns, and an acceleration that fits the drifts."""
    one = exact(1.0)
    if not held:
        return [[one, ZERO, ZERO], [ZERO, one, ZERO], [ZERO, ZERO, one]], [ZERO] * 3
    a = held[0].base
    if len(held) == 1:
        columns = [[a[1], -a[0], ZERO], [-(a[0] * a[2]), -(a[1] * a[2]), one]]
        return columns, [-(a[0] * held[0].drift), -(a[1] * held[0].drift), ZERO]
    b = held[1].base
    about, aa, ab, bb = cross(a, b), dot(a, a), dot(a, b), dot(b, b)
    square = dot(about, about)
    first = (bb * held[0].drift - ab * held[1].drift) / square
    second = (aa * held[1].drift - ab * held[0].drift) / square
    gamma = [-(first * x + second * y) for x, y in zip(a, b, strict=True)]
    speed = a[1] * about[0] - a[0] * about[1] if is_fixed else one
    return [[x / speed for x in about]], gamma


def _ackermann(length: Any, y: Any, s: Any, c: Any) -> Heading:
    """Return the heading of a wheel whose axle meets the others, the middle one turned by an angle."""
    offset = y / length
    a, b = s, c - offset * s
    square = a * a + b * b
    long, change = np.sqrt(number(square)), 2.0 * (s * c - b * (s + offset * c))
    return Heading(b / long, a / long, 1.0 / square, -(change / (square * square)))


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

    """

    table: Any

    @cached_property
    def _rows(self) -> list[Row]:
        """The rows at steering angles [rad] that are in no relation to each other."""
        kinematics = Kinematics.of(self.table)
        angles = [min(0.9 * axis.limit, 0.31 + 0.23 * k) for k, axis in enumerate(self.table.axes)]
        return kinematics.rows(angles, [0.0] * 3, [0.0] * kinematics.n)

    @cached_property
    def matrix(self) -> Array:
        """The rows at these angles, shape (k, 3 + steering + wheels)."""
        return np.array([[float(number(x)) for x in [*row.base, *row.joints]] for row in self._rows])

    @cached_property
    def rank(self) -> int:
        """Rank of the rows."""
        return _rank(self.matrix)

    @cached_property
    def _lateral(self) -> tuple[list[int], list[int]]:
        """Rows that hold the body alone: of fixed wheels, and of steered ones."""
        steered = {row for axis in self.table.axes for row in axis.wheels}
        found: tuple[list[int], list[int]] = [], []
        for i, row in enumerate(self._rows):
            if row.kind == "lateral" and np.abs(self.matrix[i, 3:]).max() < _COEFFICIENT:
                found[row.wheel in steered].append(i)
        return found

    @cached_property
    def mobility(self) -> int:
        """Degrees of freedom of the body at given steering angles: 3 less the rank of the lateral rows."""
        return 3 - _rank(self.matrix[[*self._lateral[0], *self._lateral[1]], :3])

    @cached_property
    def steerability(self) -> int:
        """How many steering angles may be chosen: what wheels steered about their centres add to the rank."""
        return 3 - self.mobility - _rank(self.matrix[self._lateral[0], :3])

    @cached_property
    def rolling_obstacle(self) -> str:
        """Why the drive cannot roll ideally, as a sentence; empty where it can."""
        fixed, steered = self._lateral
        names = self.table.names
        if _rank(self.matrix[fixed, :3]) > 1:
            listed = ", ".join(repr(names[self._rows[i].wheel]) for i in fixed)
            return f"wheels {listed} are fixed on more than one axle, so it turns only by skidding"
        if self.mobility < 1:
            listed = ", ".join(repr(names[self._rows[i].wheel]) for i in [*fixed, *steered])
            return (
                f"wheels {listed} are more than two axles, whose lines meet in one point only if the angles "
                "fit together, and no force of the ground keeps them so"
            )
        trains = [row.kind == "train" for row in self._rows]
        if any(trains) and _rank(self.matrix) > _rank(self.matrix[~np.array(trains)]):
            return "wheels on one gear train have to turn at different rates, so it turns only by skidding"
        if self.mobility < 3 and self.mobility + self.steerability < 2:
            return "its wheels let it move along one curve only"
        return ""

    @property
    def is_regular(self) -> bool:
        """Whether the drive can roll without slip."""
        return not self.rolling_obstacle

    @property
    def kind(self) -> str:
        """What the drive is, in words."""
        if not self.is_regular:
            return "a drive that does not roll without slip"
        return f"a drive of type ({self.mobility}, {self.steerability})"

    @cached_property
    def choice(self) -> RowSelection:
        """Which rows determine what, for a drive that can roll."""
        fixed, steered = self._lateral
        body: list[int] = []
        for i in [*fixed, *steered]:
            if _rank(self.matrix[[*body, i], :3]) > len(body):
                body.append(i)
        ns, found = len(self.table.axes), dict[int, int]()
        for i, row in enumerate(self._rows):
            for axis in range(ns):
                if row.kind == "lateral" and abs(self.matrix[i, 3 + axis]) >= _COEFFICIENT:
                    found.setdefault(axis, i)
        own = "rolling", "roller"
        wheels = [(ns + row.wheel, i) for i, row in enumerate(self._rows) if row.kind in own]
        free = tuple(axis for axis in range(ns) if axis not in found)
        return RowSelection(tuple(body), bool(body) and body[0] in fixed, (*found.items(), *wheels), free)

    @cached_property
    def determined(self) -> Any:
        """Of each row, whether rolling determines its force; of others only sums are."""
        u, s, _ = np.linalg.svd(self.matrix)
        rank = int(np.sum(s > _RANK * s[0]))
        return np.abs(u[:, rank:]).max(axis=1, initial=0.0) < 1e-9

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

    def check_odometry(self) -> None:
        """Raise `InvalidArgument` where rates of the wheels do not tell how the body moves."""
        if self.idle is not None:
            words = "by its wheels' rates how the body moves, expected rows of rank 3"
            raise InvalidArgument(f"table does not tell {words}")

    def __str__(self) -> str:
        if self.rolling_obstacle:
            return f"of no type, as it cannot roll without slip: {self.rolling_obstacle}"
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
        free = columns - self.rank
        lines.append(f"{columns} coordinates, {rows} rows of rank {self.rank}, {free} free velocities")
        if self.idle is not None:
            along = ", ".join(f"{x:.3g}" for x in self.idle)
            moves = f"moves by (forward, left, turn) = ({along}) while no wheel turns"
            lines.append(f"{moves}: no motor drives that")
        rest = [row for row, known in zip(self._rows, self.determined, strict=True) if not known]
        loose = [f"{row.kind} of {self.table.names[row.wheel]}" for row in rest if row.wheel >= 0]
        if loose:
            lines.append(f"forces that rolling does not determine, but for their sum: {', '.join(loose)}")
        else:
            lines.append("rolling determines the force of every wheel")
        return "\n".join(lines)


def _rank(matrix: Array) -> int:
    if not matrix.size:
        return 0
    s = np.linalg.svd(matrix, compute_uv=False)
    return int(np.sum(s > _RANK * s[0]))
