"""Wheel kinematics for scalars, arrays or symbols: rolling constraints, mobility, independent velocities.

All quantities are along the axes of the body's frame, where nothing depends on the pose. A scalar is a
number, an array with leading axes, or a symbol.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.plant import Input
from pinmobile.robot import (
    ZERO,
    Matrix,
    Vector,
    applied,
    cross,
    dot,
    exact,
    factor,
    number,
    scalars,
    sine_and_cosine,
    single,
    slopes,
    vector_of as stacked,
)


class Row(NamedTuple):
    """Constraint of a wheel or a gear train: a row whose product with the rates is a slip velocity.

    Attributes
    ----------
    wheel : int
        Row of the table; -1: a gear train.
    kind : str
        ``"rolling"`` along the wheel, ``"lateral"`` across it, ``"roller"`` along the axes of its rollers,
        ``"across"`` these axes, or ``"train"``.
    base : list of 3 scalars
        Coefficients of the body twist (forward, left, yaw rate).
    joints : list of scalars
        Coefficients of the rates of the steering coordinates and then the wheels [m].
    drift : scalar
        Rate of the slip velocity if no coordinate accelerates [m/s^2].
    """

    wheel: int
    kind: str
    base: Vector
    joints: Vector
    drift: Any

    def slip(self, state: Any) -> Any:
        """Return the slip velocity in a state [m/s]."""
        return number(dot(self.base, state.twist) + dot(self.joints, state.rates))


class Heading(NamedTuple):
    """Rolling direction e of a wheel at a steering angle, and its derivatives by the steering coordinate.

    Attributes
    ----------
    c, s : scalar
        Cosine and sine of the angle of e.
    first, second : scalar
        First and second derivative of this angle by the steering coordinate.
    """

    c: Any
    s: Any
    first: Any
    second: Any


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Rolling constraints of a wheel table, with numbers that may differ between robots.

    Parameters
    ----------
    table : WheelTable
        Structure of the table; its numbers are replaced by the parameters below.
    x, y, radius : sequence of scalars
        Position and radius of each wheel [m].
    """

    table: Any
    x: Vector
    y: Vector
    radius: Vector

    @classmethod
    def of(cls, table: Any) -> Kinematics:
        """Return the kinematics with a table's own numbers."""
        names = "x", "y", "radius"
        return cls(table, *([single(getattr(each, name)) for each in table.wheels] for name in names))

    @property
    def n(self) -> int:
        """Number of steering coordinates and wheels."""
        return len(self.table.axes) + len(self.table)

    @cached_property
    def axis_of(self) -> list[int]:
        """Steering coordinate of each wheel; -1: none."""
        axes = [-1] * len(self.table)
        for k, axis in enumerate(self.table.axes):
            for row in axis.wheels:
                axes[row] = k
        return axes

    def heading(self, row: int, steering: Sequence[Any]) -> Heading:
        """Return the rolling direction of a wheel."""
        wheel, k = self.table.wheels[row], self.axis_of[row]
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
            Whether wheels with rollers have a row across the rollers' axes, in which they slide.
        """
        rows: list[Row] = []
        for row in range(len(self.table)):
            rows += self._rows_of(row, steering, twist, rates, across)
        ns = len(self.table.axes)
        for first, row, ratio in self.table.trains:
            joints: Vector = [ZERO] * self.n
            joints[ns + first], joints[ns + row] = self.radius[first] * exact(ratio), -self.radius[first]
            rows.append(Row(-1, "train", [ZERO] * 3, joints, ZERO))
        return rows

    def _rows_of(
        self, row: int, steering: Sequence[Any], twist: Sequence[Any], rates: Sequence[Any], across: bool
    ) -> list[Row]:
        """Return the rows of a wheel."""
        wheel, k, head = self.table.wheels[row], self.axis_of[row], self.heading(row, steering)
        o, p = self.centre(row, steering)
        turn = head.first * rates[k] if k >= 0 else ZERO  # rate of the wheel about its pivot
        vx, vy, w = twist
        # Velocity of the centre, and its acceleration if no coordinate accelerates.
        velocity = [vx - w * p[1] - turn * o[1], vy + w * p[0] + turn * o[0]]
        yaw, rate_sq = w + turn, head.second * rates[k] * rates[k] if k >= 0 else ZERO
        rest = [w * vy - yaw * turn * o[0] - rate_sq * o[1], -(w * vx) - yaw * turn * o[1] + rate_sq * o[0]]
        angle, rows = exact(0.0 if wheel.roller is None else wheel.roller), []
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
            rows.append(Row(row, kind, [*d, d[1] * p[0] - d[0] * p[1]], joints, drift))
        return rows

    def centre(self, row: int, steering: Sequence[Any]) -> tuple[Vector, Vector]:
        """Return the centre of a wheel relative to its pivot, and relative to the body's origin [m]."""
        head, (forward, left) = self.heading(row, steering), (exact(x) for x in self.table.wheels[row].trail)
        o = [forward * head.c - left * head.s, forward * head.s + left * head.c]
        return o, [self.x[row] + o[0], self.y[row] + o[1]]

    def wheel_rates(self, steering: Sequence[Any], twist: Sequence[Any], turning: Sequence[Any]) -> Vector:
        """Return the rates of rolling wheels, by the rolling rows of tyres and the rows of rollers.

        Parameters
        ----------
        steering, turning : sequence of scalars
            Steering coordinates and their rates [rad, rad/s].
        twist : sequence of 3 scalars
            Body twist [m/s, rad/s].
        """
        ns, zeros = len(self.table.axes), [ZERO] * self.n
        result: Vector = [ZERO] * len(self.table)
        for row in self.rows(steering, [ZERO] * 3, zeros):
            if row.kind in ("rolling", "roller"):
                slip = dot(row.base, twist) + dot(row.joints[:ns], turning)
                result[row.wheel] = -(slip / row.joints[ns + row.wheel])
        return result

    def odometry(self, steering: Sequence[Any], joints: Sequence[Any]) -> Vector:
        """Return the body twist by least squares of all rows.

        Parameters
        ----------
        steering : sequence of scalars
            Steering coordinates [rad].
        joints : sequence of scalars
            Rates of the steering coordinates and then the wheels [rad/s].
        """
        rows = self.rows(steering, [ZERO] * 3, [ZERO] * self.n)
        columns = [[row.base[k] for row in rows] for k in range(3)]
        right = [-dot(row.joints, joints) for row in rows]
        square = [[dot(a, b) for b in columns] for a in columns]
        return factor(square)[0]([dot(column, right) for column in columns])


class RowSelection(NamedTuple):
    """Selection of independent rows: those that constrain the body, and those that determine a joint's rate.

    Attributes
    ----------
    body : tuple of int
        Up to two rows; the first is that of a fixed wheel if there is one.
    is_fixed : bool
        Whether the first row is that of a fixed wheel.
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
    """Null-space basis of rolling: velocities S nu, and accelerations S dnu/dt + gamma.

    Attributes
    ----------
    S : list of lists of scalars, shape (3 + arms + n, m + arms + free)
        Body twist and rates of arms, steering coordinates and wheels, per independent velocity.
    gamma : list of scalars, shape (3 + arms + n,)
        Bias accelerations, those of the origin along the body's axes.
    """

    S: Matrix
    gamma: Vector


def solve_null_space(rows: Sequence[Row], choice: RowSelection, arms: int) -> NullSpaceBasis:
    """Return the null-space basis; with two rows the body turns about the intersection of both axles.

    Parameters
    ----------
    rows, choice
        Rows of the wheels, and their selection.
    arms : int
        Number of the arms' coordinates, which are independent velocities between body and steering axes.
    """
    columns, body = _body_velocities([rows[i] for i in choice.body], choice.is_fixed)
    first, width = 3 + arms, len(columns) + arms + len(choice.free)
    S: Matrix = [[*row, *[ZERO] * (width - len(columns))] for row in zip(*columns, strict=True)]
    S += [[ZERO] * width for _ in range(arms + len(rows[0].joints))]
    gamma = [*body, *[ZERO] * (len(S) - 3)]
    for k, pivot in enumerate([*range(3, first), *(first + axis for axis in choice.free)], len(columns)):
        S[pivot][k] = exact(1.0)
    for joint, i in choice.joints:
        pivot = rows[i].joints[joint]
        joints = (ZERO if j == joint else x for j, x in enumerate(rows[i].joints))
        others = [*rows[i].base, *[ZERO] * arms, *joints]
        S[first + joint] = [-(dot(others, column) / pivot) for column in zip(*S, strict=True)]
        gamma[first + joint] = -((rows[i].drift + dot(others, gamma)) / pivot)
    return NullSpaceBasis(S, gamma)


def _body_velocities(rows: Sequence[Row], is_fixed: bool) -> tuple[Matrix, Vector]:
    """Return the body twists that the rows allow, as columns, and their bias acceleration."""
    unit = exact(1.0)
    if not rows:
        return [[unit, ZERO, ZERO], [ZERO, unit, ZERO], [ZERO, ZERO, unit]], [ZERO] * 3
    a = rows[0].base
    if len(rows) == 1:
        columns = [[a[1], -a[0], ZERO], [-(a[0] * a[2]), -(a[1] * a[2]), unit]]
        return columns, [-(a[0] * rows[0].drift), -(a[1] * rows[0].drift), ZERO]
    b = rows[1].base
    normal, aa, ab, bb = cross(a, b), dot(a, a), dot(a, b), dot(b, b)
    square = dot(normal, normal)
    first = (bb * rows[0].drift - ab * rows[1].drift) / square
    second = (aa * rows[1].drift - ab * rows[0].drift) / square
    gamma = [-(first * x + second * y) for x, y in zip(a, b, strict=True)]
    speed = a[1] * normal[0] - a[0] * normal[1] if is_fixed else unit
    return [[x / speed for x in normal]], gamma


def _ackermann(length: Any, y: Any, s: Any, c: Any) -> Heading:
    """Return the heading of a wheel in an Ackermann steering, from the angle of the middle wheel."""
    offset = y / length
    a, b = s, c - offset * s
    square = a * a + b * b
    long, change = np.sqrt(number(square)), 2.0 * (s * c - b * (s + offset * c))
    return Heading(b / long, a / long, 1.0 / square, -(change / (square * square)))


_RANK = 1e-9  # relative tolerance of singular values
_COEFFICIENT = 1e-12


@final
@dataclass(frozen=True)
class Mobility:
    """Mobility of a drive: which motions its wheels allow, for general steering angles.

    Printing it gives a description. The type (mobility, steerability) follows the classification of Campion,
    Bastin and d'Andrea-Novel (1996).

    Parameters
    ----------
    table : WheelTable
        The wheels.

    See Also
    --------
    WheelTable : its property `mobility`
    Backstepping : controller of drives with a fixed axle

    Examples
    --------
    >>> from pinmobile import WheelTable
    >>> from pinmobile.wheels import Mobility
    >>> car = Mobility(WheelTable.car(0.5, 0.4, 0.1))
    >>> car.mobility, car.steerability
    (1, 1)
    >>> skid_steer = Mobility(WheelTable.skid_steer(0.4, 0.3, 0.1))
    >>> skid_steer.is_regular
    False
    """

    table: Any

    @cached_property
    def _rows(self) -> list[Row]:
        """Rows at general steering angles [rad]."""
        kinematics = Kinematics.of(self.table)
        angles = [min(0.9 * axis.limit, 0.31 + 0.23 * k) for k, axis in enumerate(self.table.axes)]
        return kinematics.rows(angles, [0.0] * 3, [0.0] * kinematics.n)

    @cached_property
    def matrix(self) -> Array:
        """Rows at these angles as a matrix, shape (k, 3 + steering + wheels)."""
        return np.array([[float(number(x)) for x in [*row.base, *row.joints]] for row in self._rows])

    @cached_property
    def rank(self) -> int:
        """Rank of the matrix."""
        return _rank(self.matrix)

    @cached_property
    def _lateral(self) -> tuple[list[int], list[int]]:
        """Rows that constrain only the body: those of fixed wheels, and those of steered wheels."""
        steered = {row for axis in self.table.axes for row in axis.wheels}
        indices: tuple[list[int], list[int]] = [], []
        for i, row in enumerate(self._rows):
            if row.kind == "lateral" and np.abs(self.matrix[i, 3:]).max() < _COEFFICIENT:
                indices[row.wheel in steered].append(i)
        return indices

    @cached_property
    def mobility(self) -> int:
        """Degrees of freedom of the body at given steering angles: 3 minus the rank of the lateral rows."""
        return 3 - _rank(self.matrix[[*self._lateral[0], *self._lateral[1]], :3])

    @cached_property
    def steerability(self) -> int:
        """Number of independent steering angles: rank added by wheels that steer about their centres."""
        return 3 - self.mobility - _rank(self.matrix[self._lateral[0], :3])

    @cached_property
    def rolling_obstacle(self) -> str:
        """Reason why the drive cannot roll without slip, as a sentence; empty if it can."""
        fixed, steered = self._lateral
        names = self.table.names
        if _rank(self.matrix[fixed, :3]) > 1:
            wheels = ", ".join(repr(names[self._rows[i].wheel]) for i in fixed)
            return f"wheels {wheels} are fixed on more than one axle, so it turns only by skidding"
        if self.mobility < 1:
            wheels = ", ".join(repr(names[self._rows[i].wheel]) for i in [*fixed, *steered])
            return (
                f"wheels {wheels} are more than two axles, whose lines meet in one point only if the angles "
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

    def check_rolls(self, name: str, hint: str = "") -> None:
        """Raise `InvalidArgument` for a robot, or its table, that cannot roll without slip."""
        if not self.is_regular:
            raise InvalidArgument(f"{name} cannot roll without slip: {self.rolling_obstacle}{hint}")

    @property
    def kind(self) -> str:
        """Name of the drive's type."""
        if not self.is_regular:
            return "a drive that does not roll without slip"
        return f"a drive of type ({self.mobility}, {self.steerability})"

    @cached_property
    def choice(self) -> RowSelection:
        """Selected rows of a drive that can roll."""
        fixed, steered = self._lateral
        body: list[int] = []
        for i in [*fixed, *steered]:
            if _rank(self.matrix[[*body, i], :3]) > len(body):
                body.append(i)
        ns, chosen = len(self.table.axes), dict[int, int]()
        for i, row in enumerate(self._rows):
            for axis in range(ns):
                if row.kind == "lateral" and abs(self.matrix[i, 3 + axis]) >= _COEFFICIENT:
                    chosen.setdefault(axis, i)
        kinds = "rolling", "roller"
        wheels = [(ns + row.wheel, i) for i, row in enumerate(self._rows) if row.kind in kinds]
        free = tuple(axis for axis in range(ns) if axis not in chosen)
        return RowSelection(tuple(body), bool(body) and body[0] in fixed, (*chosen.items(), *wheels), free)

    @cached_property
    def determined(self) -> Any:
        """Whether rolling determines the force of each row; otherwise it determines only sums of forces."""
        u, s, _ = np.linalg.svd(self.matrix)
        rank = int(np.sum(s > _RANK * s[0]))
        return np.abs(u[:, rank:]).max(axis=1, initial=0.0) < 1e-9

    @cached_property
    def idle(self) -> Array | None:
        """Body twist, shape (3,), at which no wheel turns or steers, such as for parallel omni wheels.

        Its largest entry is 1; None if there is none.
        """
        if _rank(self.matrix[:, :3]) == 3:
            return None
        twist = np.linalg.svd(self.matrix[:, :3])[2][-1]
        twist_0 = np.round(twist / twist[np.abs(twist).argmax()], 9) + 0.0
        return np.asarray(twist_0)

    def check_odometry(self) -> None:
        """Raise `InvalidArgument` if the wheels' rates do not determine the body's motion."""
        if self.idle is not None:
            words = "the body's motion by the rates of its wheels, expected rows of rank 3"
            raise InvalidArgument(f"table does not determine {words}")

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
            twist = ", ".join(f"{x:.3g}" for x in self.idle)
            moves = f"moves by (forward, left, turn) = ({twist}) while no wheel turns"
            lines.append(f"{moves}: no motor drives that")
        rest = [row for row, is_known in zip(self._rows, self.determined, strict=True) if not is_known]
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


_BASE = 3
_LEAST_NORM = 1e-6  # weight of the torques' norm relative to the residual, if limits are active
_SLIDING = 1e-6  # tolerance of sliding relative to the largest rate, and of forces to the largest


class Reduced(NamedTuple):
    """Dynamics of rolling in independent velocities nu: M dnu/dt + n = B u, v = S nu (Kane's equations).

    For an omnidirectional body, nu is its twist (forward, left, yaw rate). With one axle, it is the speed
    along the wheels at the axle and the yaw rate. With two axles, it is the speed at the fixed one, or, if
    both are steered, the number eta with twist = eta (a1 x a2) of the axles' rows. Rates of the arms, and of
    steering axes without a constraint, follow.

    Attributes
    ----------
    M, n, B : ndarray, shape (..., m, m), (..., m), (..., m, nu)
        Mass matrix, nonlinear effects and input matrix.
    S : ndarray, shape (..., nv, m)
        All velocities per independent velocity (null-space basis).
    nu : ndarray, shape (..., m)
        Independent velocities of the state.

    See Also
    --------
    WheeledRobot : its method `reduced`

    Examples
    --------
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> reduced = robot.reduced(robot.rest, 0 * robot.rest)
    >>> reduced.M.diagonal()  # speed [kg] and yaw rate [kg m^2]
    array([32.  ,  1.38])
    """

    M: Any
    n: Any
    B: Any
    S: Any
    nu: Any

    def torques(self, rates: Array) -> Array:
        """Return the input of least norm that produces these rates of nu, shape (..., nu) [N m].

        Parameters
        ----------
        rates : ndarray, shape (..., m)
            Rates of the independent velocities [m/s^2, rad/s^2].
        """
        force = np.einsum("...ij,...j->...i", self.M, rates) + self.n
        return np.asarray(np.linalg.pinv(self.B) @ force[..., None])[..., 0]

    def nearest(self, force: Array, inputs: Sequence[Input]) -> Array:
        """Return the input within limits with the effect nearest to that of a force, for one state, (nu,).

        If limits allow, its effect equals that of the force, with least norm. Otherwise a quadratic program
        minimises the residual in the metric of the inverse mass.

        Parameters
        ----------
        force : ndarray, shape (m,)
            Force on the independent velocities, S' tau.
        inputs : sequence of Input
            Inputs with their limits.
        """
        metric = np.linalg.inv(np.linalg.cholesky(self.M))
        B, right = metric @ self.B, metric @ force
        u = np.linalg.pinv(B) @ right
        lower, upper = (np.array([getattr(each, x) for each in inputs]) for x in ("lower", "upper"))
        if (u < lower).any() or (u > upper).any():
            from scipy.optimize import lsq_linear

            small = _LEAST_NORM * np.linalg.norm(B) * np.eye(len(u))
            target = np.append(right, np.zeros(len(u)))
            solution = lsq_linear(np.vstack([B, small]), target, (lower, upper), tol=1e-14)
            u = np.clip(solution.x, lower, upper)
        return np.asarray(u)


class Allocation(NamedTuple):
    """Torques of wheels and joints for a desired force on body and arms.

    Attributes
    ----------
    u : ndarray, shape (..., nu)
        Input [N m].
    residual : ndarray, shape (..., 3 + arms)
        Part of the force that wheels and joints do not exert, because it exceeds limits, or because no wheel
        can exert it, such as a force across the axle [N, N, N m, ...].

    See Also
    --------
    WheeledRobot : its method `allocate`
    ControlAllocation : wrapper of controllers

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> found = robot.allocate(robot.rest, [20.0, 5.0, 0.0])
    >>> found.u.round(9), found.residual.round(9) + 0.0  # [N m], [N]
    (array([1., 1.]), array([0., 5., 0.]))
    """

    u: Array
    residual: Array


class ReferenceMotion(NamedTuple):
    """Motion of rolling wheels along a reference.

    Attributes
    ----------
    q, v : ndarray, shape (N, nq), (N, nv)
        States, with wheel angles zero.
    nu, rates : ndarray, shape (N, m)
        Independent velocities, and their rates.
    u : ndarray, shape (N, nu)
        Inputs of least norm.
    """

    q: Array
    v: Array
    nu: Array
    rates: Array
    u: Array


def check_steers_not(body: Any) -> None:
    """Raise `InvalidArgument` if wheels steer, because their angles belong to the state."""
    if body.table.axes:
        raise InvalidArgument(
            f"robot steers wheels about {len(body.table.axes)} axes, expected 0, or Backstepping(law, robot)"
        )


def rolling_motion(body: Any, reference: Any, t: Array | None = None) -> ReferenceMotion:
    """Return the motion of a robot on wheels along a reference; arms without reference rest.

    Parameters
    ----------
    body : WheeledDynamics
        Dynamics of the robot.
    reference : Reference
        q, v and a, shape (N, ...).
    t : ndarray, shape (N,), optional
        Times [s], from which steering rates follow; without them no wheel may steer.

    Raises
    ------
    InvalidArgument
        If wheels steer, or wheels or motors cannot follow the reference.
    """
    if t is None:
        check_steers_not(body)
    n, ns, (*lead, count) = body.of_body, len(body.table.axes), reference.q.shape
    if count > n:
        raise InvalidArgument(
            f"reference has {count} coordinates, expected {n} at most, as of WholeBody(robot, base, *joints)"
        )
    q, v, a = (np.zeros((*lead, body.nv)) for _ in range(3))
    q[..., :count], v[..., :count], a[..., :count] = reference
    if count < n:
        q[..., count:n] = body.robot.rest[count:]
    turning = faster = np.zeros((*lead, ns))
    if t is not None and ns:
        twists = np.stack(np.broadcast_arrays(*map(number, body.state(q, v).twist)), -1).tolist()
        angles = np.array([[body.steered_to(axis, twist) for axis in body.table.axes] for twist in twists])
        q[:, n : n + ns] = angles
        if len(t) > 3:
            from scipy.interpolate import CubicSpline

            q[:, n : n + ns] = np.unwrap(angles, axis=0, period=np.pi)
            spline = CubicSpline(t, q[:, n : n + ns])
            turning, faster = spline(t, 1), spline(t, 2)
    v[..., n : n + ns] = turning
    nu = body.independent(q, v)
    rolls = _rolling(body, q, nu)
    slips = np.abs(rolls - v)[..., :n].max(axis=-1)
    if (slips > _SLIDING * (1 + np.abs(v).max())).any():
        k = int(np.argmax(slips))
        time = f"its sample {k}" if t is None else f"{t[k]:.6g} s"
        raise InvalidArgument(
            f"reference differs by {slips[k]:.3g} m/s, or rad/s, at {time} from any rolling motion, "
            "expected a motion that the wheels can follow, such as Tangent(path)"
        )
    state = body.state(q, rolls)
    size = nu.shape[-1] - body.na - len(body.choice.free)
    rates = body.offset(state, state.to_body(scalars(a)))[:size]
    rates = [*rates, *scalars(a)[_BASE:n], *(faster[..., k] for k in body.choice.free)]
    changes = stacked(rates, q)
    return ReferenceMotion(q, rolls, nu, changes, driving_inputs(body, q, rolls, changes))


def driving_inputs(body: Any, q: Array, v: Array, rates: Array) -> Array:
    """Return the inputs of least norm for given rates of nu; raise `InvalidArgument` if there are none."""
    reduced = body.reduced(q, v)
    u = reduced.torques(rates)
    needed = np.einsum("...ij,...j->...i", reduced.M, rates) + reduced.n
    error = np.abs(np.einsum("...ij,...j->...i", reduced.B, u) - needed).max()
    if error > _SLIDING * (1 + np.abs(needed).max()):
        raise InvalidArgument(
            f"reference needs a force of {error:.3g} N, or N m, that no motor exerts, expected another one"
        )
    return np.asarray(u)


def _rolling(body: Any, q: Any, nu: Any) -> Any:
    """Return v for independent velocities, shape (..., nv)."""
    state = body.state(q, np.zeros((*q.shape[:-1], body.nv)))
    return body.in_plane(state, applied(body.null_space(state).S, scalars(nu)), q)


def tracked_slopes(body: Any, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
    """Return the linear model of the tracked state, A and B, see `WheeledRobot.linearize_tracked`.

    Parameters
    ----------
    body : WheeledDynamics
        Dynamics of a robot without steered wheels.
    q, v, u : ndarray, shape (..., nq), (..., nv), (..., nu)
        Rolling state, and input.
    """
    check_steers_not(body)
    nu = body.independent(q, v)
    n, m = body.of_body, nu.shape[-1]

    def rates(step: Array, q: Array, nu: Array, u: Array) -> Any:
        count = np.broadcast_shapes(step.shape[:-1], q.shape[:-1])
        moves = np.zeros((*count, body.nv), np.complex128)
        moves[..., :n] = step[..., :n]
        new_q, velocities = body.integrate(q, moves), nu + step[..., n : n + m]
        rolls = _rolling(body, new_q, velocities)
        reduced = body.reduced(new_q, rolls)
        force = np.einsum("...ij,...j->...i", reduced.B, u + step[..., n + m :]) - reduced.n
        nu_rate = np.linalg.solve(reduced.M, force[..., None])[..., 0]
        return np.concatenate([rolls[..., :n], nu_rate], axis=-1)

    # Nothing depends on the position of the body.
    derivative = slopes(rates, np.eye(n + m + body.nu)[2:], q, nu, u)
    A = np.zeros((*derivative.shape[:-2], n + m, n + m))
    A[..., 2:] = derivative[..., : n + m - 2]
    return A, np.ascontiguousarray(derivative[..., n + m - 2 :])
