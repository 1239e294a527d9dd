"""`WheelTree`, the Pinocchio tree of a robot whose wheels are joints, and its constraint forces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, finite_answer, frozen
from pinmobile.compiled import choose, higher, repeated, square_root
from pinmobile.errors import InvalidArgument
from pinmobile.robot import BODY_JOINT, ZERO, Engine, Matrix, MobileRobot, System, Vector, dot, number
from pinmobile.urdf import Body
from pinmobile.wheels.kinematics import Kinematics, Row
from pinmobile.wheels.table import FIXED, Wheel, WheelTable

_ROUNDED = 0.1  # at first: share of a wheel's own slip per impulse, over which friction's edge is rounded
_LESS = 0.3  # of that, each time that impulses have been found
_LEAST = 1e-8
_FINE = 1e-2  # share below which impulses feel how numbers are rounded; with this they are found again
_LEVEL = 0.3  # of the slope at the start of a step that may be left at its end
_SHORTEST = 1e-9  # share of a step
_NEAR = 0.1  # of how far impulses are off, to which velocities are found for them
_ROUNDING = 1e-13  # of the velocities
_PLAIN = 100.0  # tolerances that plain rounds are from their end, at least, where they come slowly


class Place(NamedTuple):
    """Where something holds velocities: one direction, or two.

    Attributes
    ----------
    rows, columns : lists of scalars
        Slip velocity per velocity, and velocity per impulse, of each direction.
    bounds : list of scalars
        Impulse at most, in each direction [N s].
    is_disc : bool
        Whether the bound is that of both together.
    began : list of scalars
        What is added to the slip [m/s].
    give : scalar
        Slip velocity per impulse [1/kg].
    """

    rows: Sequence[Vector]
    columns: Sequence[Vector]
    bounds: Vector
    is_disc: bool
    began: Vector
    give: Any

    @property
    def size(self) -> Any:
        """Slip per impulse of its own, the mean of its directions."""
        own = [number(dot(row, column)) for row, column in zip(self.rows, self.columns, strict=True)]
        return sum(own[1:], own[0]) * (1.0 / len(own))

    def pushed(self, v: Vector, before: Vector, rounded: Any) -> _Pushed:
        """Return the impulse at velocities, near to one before, and how it changes with them.

        Parameters
        ----------
        v, before : lists of scalars
            Velocities, and the impulse.
        rounded : scalar
            Slip per impulse over which friction's edge is rounded.
        """
        slip = [began + dot(row, v) for row, began in zip(self.rows, self.began, strict=True)]
        share = 1.0 / (rounded + self.give)
        z = [(rounded * p - s) * share for p, s in zip(before, slip, strict=True)]
        if not self.is_disc:
            now = [
                choose(x > most, most, choose(x < -most, -most, x))
                for x, most in zip(z, self.bounds, strict=True)
            ]
            bent = [choose(abs(x) <= most, share, 0.0) for x, most in zip(z, self.bounds, strict=True)]
            return _Pushed(now, bent, None, 0.0)
        radius = self.bounds[0]
        square = z[0] * z[0] + z[1] * z[1]
        sticks = square <= radius * radius
        inverse = 1.0 / choose(sticks, 1.0, square)
        scale = choose(sticks, 1.0, radius * square_root(inverse))
        now = [scale * x for x in z]
        against = choose(sticks, 0.0, scale * share)
        slides = choose(radius > 0.0, dot(slip, now) / choose(radius > 0.0, radius * radius, 1.0), 0.0)
        return _Pushed(
            now,
            [scale * share] * 2,
            [z[0], z[1], against * inverse],
            choose(sticks, 0.0, higher(-slides - self.give, 0.0)),
        )


class _Pushed(NamedTuple):
    """An impulse, and how it changes with the slip: diag(bent) - c (x, y) (x, y)', less."""

    now: Vector
    bent: Vector
    turned: Vector | None
    multiplier: Any

    def add(self, place: Place, H: Matrix, g: Vector) -> None:
        """Add to the second derivatives, and to the slope."""
        terms = list(zip(place.rows, self.bent, strict=True))
        if self.turned is not None:
            x, y, c = self.turned
            terms.append(([x * a + y * b for a, b in zip(*place.rows, strict=True)], -c))
        for p, row in zip(self.now, place.rows, strict=True):
            for i, x in enumerate(row):
                g[i] = g[i] - x * p
        for row, weight in terms:
            heavy = [x * weight for x in row]
            for i, x in enumerate(row):
                for j in range(i + 1):
                    H[i][j] = H[j][i] = H[i][j] + x * heavy[j]


class Found(NamedTuple):
    """What has been found: as of `Impulses`, and 1 where it has not."""

    velocity: Vector
    impulses: Vector
    multipliers: Vector
    rounds: Any
    missed: Any


def found_by_newton(
    places: Sequence[Place],
    inertia: Matrix,
    free: Vector,
    start: Found,
    *,
    settled: Any,
    most: int,
    tolerance: Any,
) -> Found:
    """Return the impulses, from those of a start.

    Parameters
    ----------
    places : sequence of Place
        What holds the velocities.
    inertia : list of lists of scalars
        Of the velocities, whose columns of M^-1 are those of the places.
    free : list of scalars
        Velocities without any impulse.
    start : Found
        What to begin with.
    settled : bool
        Where that is the answer.
    most : int
        Rounds at most.
    tolerance : scalar
        Change of an impulse that is of no interest [N s].
    """
    n, sizes = len(free), [place.size for place in places]
    ends = [sum(len(place.rows) for place in places[:k]) for k in range(len(places) + 1)]
    m, discs = ends[-1], [k for k, place in enumerate(places) if place.is_disc]
    largest = sizes[0]
    for size in sizes[1:]:
        largest = higher(largest, size)
    moving = number(dot(free, [number(dot(row, free)) for row in inertia]))
    enough = largest * (_PLAIN * tolerance) * (_PLAIN * tolerance) + _ROUNDING * _ROUNDING * moving
    behind = 2 * n + m + 7

    def one(numbers: Vector) -> tuple[Vector, Any]:
        v, way, p = numbers[:n], numbers[n : 2 * n], numbers[2 * n : 2 * n + m]
        slope, share, low, high, rounded, sure, count = numbers[2 * n + m : behind]
        at = [x + share * y for x, y in zip(v, way, strict=True)]
        H = [list(row) for row in inertia]
        change = [x - y for x, y in zip(at, free, strict=True)]
        g = [number(dot(row, change)) for row in inertia]
        now: Vector = []
        multipliers, off = [], ZERO
        for place, size, first, last in zip(places, sizes, ends, ends[1:], strict=False):
            pushed = place.pushed(at, p[first:last], rounded * size)
            pushed.add(place, H, g)
            now += pushed.now
            if place.is_disc:
                multipliers.append(pushed.multiplier)
            for x, y in zip(pushed.now, p[first:last], strict=True):
                off = off + size * ((x - y) * (x - y))
        off = number(off) * rounded
        curve = number(dot(way, [number(dot(row, way)) for row in H]))
        next_way = [-number(x) for x in factored(H)[0](g)]
        fall, uphill = number(dot(g, next_way)), number(dot(g, way))
        rises = uphill > 0.0
        level = abs(uphill) <= -_LEVEL * slope
        goes = level | ((share >= 1.0) & (uphill <= 0.0)) | (share < _SHORTEST)
        little = enough * choose(rounded >= _FINE, rounded * rounded, 1.0)
        moves = goes & ((-fall <= _NEAR * _NEAR * off) | (-fall <= little))
        known = moves & (off * rounded <= enough) & (-fall <= little)
        done = known & (rounded >= _FINE) & (sure > 0.0)
        low, high = choose(rises, low, share), choose(rises, share, high)
        level_at = share - uphill / choose(curve > 0.0, curve, 1.0)
        between = choose((level_at > low) & (level_at < high), level_at, 0.5 * (low + high))
        impulses = [choose(moves, x, y) for x, y in zip(now, p, strict=True)]
        velocity = list(free)
        for column, x in zip((c for place in places for c in place.columns), impulses, strict=True):
            velocity = [number(a + b * x) for a, b in zip(velocity, column, strict=True)]
        smaller = choose(known, _FINE, higher(_LESS * rounded, _LEAST))
        return [
            *(choose(goes, x, y) for x, y in zip(at, v, strict=True)),
            *(choose(moves, 0.0, choose(goes, x, y)) for x, y in zip(next_way, way, strict=True)),
            *impulses,
            choose(moves, 0.0, choose(goes, fall, slope)),
            choose(moves, 0.0, choose(goes, 1.0, between)),
            choose(goes, 0.0, low),
            choose(goes, 1.0, high),
            choose(moves, smaller, rounded),
            choose(moves, choose(known, 1.0, 0.0), sure),
            count + 1.0,
            *velocity,
            *multipliers,
            choose(done, 0.0, 1.0),
        ], done

    first = [*start.velocity, *[0.0] * n, *start.impulses, *[0.0] * 4, _ROUNDED, 0.0, start.rounds]
    first += [*start.velocity, *(start.multipliers[k] for k in discs), start.missed]
    found = repeated(one, first, most, settled)
    multipliers, told = list(start.multipliers), found[behind + n : -1]
    for k, x in zip(discs, told, strict=True):
        multipliers[k] = x
    return Found(
        found[behind : behind + n], found[2 * n : 2 * n + m], multipliers, found[behind - 1], found[-1]
    )


def factored(M: Matrix, order: Sequence[int] = ()) -> tuple[Callable[[Vector], Vector], Matrix]:
    """Return what solves M x = right, of a symmetric M, and what is left of it halfway; zeros stay.

    Parameters
    ----------
    M : list of lists of scalars
        The matrix.
    order : sequence of int, optional
        Unknowns that are eliminated first. What is left is the matrix of the others; they follow, the last
        first.
    """
    n, left = len(M), list[list[Any]]()
    others = [i for i in range(n) if i not in order]
    M, inverse, order = [list(row) for row in M], [ZERO] * n, [*order, *reversed(others)]
    for done, i in enumerate(order, 1):
        if done > n - len(others) and not left:
            left = [[M[j][k] for k in others] for j in others]
        inverse[i] = 1.0 / number(M[i][i])
        rest = order[done:]
        factors = {j: M[j][i] * inverse[i] for j in rest}
        for at, j in enumerate(rest):
            for k in rest[: at + 1]:
                M[j][k] = M[k][j] = M[j][k] - factors[j] * M[k][i]
        for j in rest:
            M[j][i] = factors[j]

    def solve(right: Vector) -> Vector:
        x = list(right)
        for done, i in enumerate(order, 1):
            for j in order[done:]:
                x[j] = x[j] - M[j][i] * x[i]
        x = [value * inverse[i] for i, value in enumerate(x)]
        for k, i in reversed(list(enumerate(order))):
            for j in order[k + 1 :]:
                x[i] = x[i] - M[j][i] * x[j]
        return x

    return solve, left


@final
class WheelTree(System):
    """The tree of a robot on wheels, and its dynamics in the coordinates of a `WheeledRobot`.

    In the tree each steered wheel has an angle of its own, right before the wheel; wheels that are steered
    together share one coordinate: v_tree = G v.

    Parameters
    ----------
    robot : MobileRobot
        The whole, wheels locked at their table angles.
    table : WheelTable
        Its wheels.
    fall : ndarray, shape (3,)
        Gravity along the axes of the plane [m/s^2].
    """

    def __init__(self, robot: MobileRobot, table: WheelTable, fall: Array) -> None:
        self._engine = Engine(_with_wheels(robot, table, fall))
        self.mounts, self.loads, self._robot, self._table = robot.mounts, robot.loads, robot, table
        self._kinematics, self._size = Kinematics.of(table), robot.nv + len(table.axes) + len(table)

    @property
    def _for_many(self) -> None:
        return None

    @cached_property
    def _reflected(self) -> Array:
        """What motors' rotors add to M, shape (nv, nv)."""
        M, first = np.zeros((self._size, self._size)), self._robot.nv
        for actuator in self._table.actuators:
            column = np.array(actuator.column)
            M[first:, first:] += actuator.motor.reflected_inertia * np.outer(column, column)
        return frozen(M)

    def state_of(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        """Return a public state as the tree's, its velocity's G, v_tree = G v, and dG/dt v."""
        lead = np.broadcast_shapes(q.shape[:-1], v.shape[:-1])
        q, v = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v))
        nv, axes = self._robot.nv, self._table.axes
        steering, rates = list(np.moveaxis(q[..., nv : nv + len(axes)], -1, 0)), v[..., nv : nv + len(axes)]
        steered = {row: k for k, axis in enumerate(axes) for row in axis.wheels}
        size = nv + len(steered) + len(self._table)
        G, bent = np.zeros((*lead, size, self._size)), np.zeros((*lead, size))
        G[..., np.arange(nv), np.arange(nv)] = 1
        angles, at = [], nv
        for row, wheel in enumerate(self._table.wheels):
            if row in steered:
                k, head = steered[row], self._kinematics.heading(row, steering)
                c, s, first, second = (number(x) for x in head)
                own = wheel.angle
                away = np.arctan2(s * np.cos(own) - c * np.sin(own), c * np.cos(own) + s * np.sin(own))
                angles.append(np.broadcast_to(away, lead))
                G[..., at, nv + k], bent[..., at] = first, second * rates[..., k] ** 2
                at += 1
            angles.append(q[..., nv + len(axes) + row])
            G[..., at, nv + len(axes) + row] = 1
            at += 1
        whole = np.concatenate([q[..., :nv], np.stack(angles, axis=-1)], axis=-1)
        return whole, np.einsum("...ij,...j->...i", G, v), G, bent

    def inertia(self, q: Array) -> Array:
        """Return M(q), shape (..., nv, nv), rotors included, unchecked."""
        if q.ndim == 1 and not self._table.axes:
            return np.array(pin.crba(self._engine.public, self._engine.data, q)) + self._reflected
        whole, _, G, _ = self.state_of(q, np.zeros(self._size))
        return np.asarray(np.swapaxes(G, -1, -2) @ self.mass_matrix(whole) @ G + self._reflected)

    def effects(self, q: Array, v: Array) -> Array:
        """Return n(q, v), shape (..., nv), unchecked."""
        whole, rates, G, bent = self.state_of(q, v)
        finite_answer(bent, q=q, v=v)
        return np.asarray(np.einsum("...ki,...k->...i", G, self.inverse_dynamics(whole, rates, bent)))

    def inertia_and_effects(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return M(q) and n(q, v), unchecked; of one state without detours."""
        if q.ndim > 1 or v.ndim > 1:
            return self.inertia(q), self.effects(q, v)
        if not self._table.axes:
            M, n = self._of_one(q, v, self._no_acceleration)
            return M + self._reflected, n
        whole, rates, G, bent = self.state_of(q, v)
        M, n = self._of_one(whole, rates, bent)
        return G.T @ M @ G + self._reflected, G.T @ n

    def _of_one(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Return the mass matrix and the inverse dynamics of one state of the tree."""
        engine = self._engine
        M = np.array(pin.crba(engine.public, engine.data, q))
        return M, np.array(pin.rnea(engine.public, engine.data, q, v, a))

    @cached_property
    def _no_acceleration(self) -> Array:
        return frozen(np.zeros(self._size))


def _steers(wheel: Wheel) -> bool:
    return wheel.steering != FIXED


def _with_wheels(robot: MobileRobot, table: WheelTable, fall: Array) -> pin.Model:
    """Return the tree of a robot whose wheels are joints, each after the steering axis that it hangs on.

    Pinocchio's CRBA takes what hangs on a joint to come right after it.
    """
    model, wheels = robot.model, sum(wheel.mass for wheel in table.wheels)
    model.gravity.linear = fall
    body = pin.Inertia(model.inertias[BODY_JOINT])
    if body.mass <= wheels:
        raise InvalidArgument(
            f"robot has a mass of {body.mass:.6g} kg, and its wheels {wheels:.6g} kg, which are part of it; "
            "expected the mass of the whole"
        )
    for wheel in table.wheels:
        body -= _placed(wheel).act(_inertia(wheel))
    model.inertias[BODY_JOINT] = _checked(body)
    for wheel in table.wheels:
        parent, place = BODY_JOINT, _placed(wheel)
        if _steers(wheel):
            pivot = pin.SE3(pin.utils.rotate("z", wheel.angle), np.array([wheel.x, wheel.y, wheel.radius]))
            parent = model.addJoint(BODY_JOINT, pin.JointModelRZ(), pivot, f"{wheel.name}_steering")
            place = pin.SE3(np.eye(3), np.array([*wheel.trail, 0.0]))
        joint = model.addJoint(parent, pin.JointModelRY(), place, wheel.name)
        model.appendBodyToJoint(joint, _inertia(wheel), pin.SE3.Identity())
    return model


def _placed(wheel: Wheel) -> pin.SE3:
    """Return the pose of a wheel's centre in the body's frame, its y along the axle, at angle zero."""
    return pin.SE3(pin.utils.rotate("z", wheel.angle), np.array([*wheel.centre, wheel.radius]))


def _inertia(wheel: Wheel) -> pin.Inertia:
    across = wheel.yaw_inertia
    return pin.Inertia(wheel.mass, np.zeros(3), np.diag([across, wheel.spin_inertia, across]))


def _checked(body: pin.Inertia) -> pin.Inertia:
    try:
        Body(body.mass, np.array(body.lever), np.array(body.inertia))
    except InvalidArgument as error:
        raise InvalidArgument(
            f"robot without its wheels is no body: {error}; expected a robot whose mass and inertia hold "
            "those of its wheels"
        ) from None
    return body


_REDUNDANT = 1e-10  # relative, of eigenvalues: rows that follow from others


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


@final
@dataclass(frozen=True, eq=False)
class Constraints:
    """The rows A(q) v = 0 of a wheel table, along the coordinates of the robot that it carries.

    Parameters
    ----------
    table : WheelTable
        The wheels.
    nv : int
        Number of coordinates that the wheels carry: body and arms.
    rows : tuple of int, optional
        Which rows; by default all.
    """

    table: WheelTable
    nv: int
    rows: tuple[int, ...] | None = None

    @cached_property
    def kinematics(self) -> Kinematics:
        """Of the table."""
        return Kinematics.of(self.table)

    @property
    def joints(self) -> int:
        """Number of steering coordinates and wheels."""
        return len(self.table.axes) + len(self.table)

    @cached_property
    def _at_zero(self) -> list[Row]:
        """The rows where steering angles and rates are zero."""
        zeros = [0.0] * self.joints
        found = self.kinematics.rows(zeros, [0.0] * BODY_JOINT, zeros)
        return found if self.rows is None else [found[i] for i in self.rows]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of each row its wheel and direction, such as ``"left rolling"``."""
        return tuple(
            f"{self.table.names[row.wheel]} {row.kind}" if row.wheel >= 0 else row.kind
            for row in self._at_zero
        )

    @cached_property
    def _still(self) -> Array:
        """The rows along the body's axes, shape (k, nv), steering angles at zero."""
        rows = self._at_zero
        A = np.zeros((len(rows), self.nv + self.joints))
        A[:, :BODY_JOINT] = [[number(x) for x in row.base] for row in rows]
        A[:, self.nv :] = [[number(x) for x in row.joints] for row in rows]
        return frozen(A)

    def base_of(self, row: int) -> Array:
        """Return the coefficients of the body twist in a row, steering angles at zero, shape (3,)."""
        return self._still[row, :BODY_JOINT]

    @cached_property
    def _steered(self) -> tuple[int, ...]:
        """Rows that change with a steering angle."""
        steered = {row for axis in self.table.axes for row in axis.wheels}
        return tuple(i for i, row in enumerate(self._at_zero) if row.wheel in steered)

    def at(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return A, shape (..., k, nv), and what A v changes at where nothing accelerates, (..., k)."""
        c, s, w = np.cos(q[..., 2]), np.sin(q[..., 2]), v[..., 2]
        ahead, aside = c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0]
        lead = q.shape[:-1] if v.ndim == 1 else np.broadcast_shapes(q.shape[:-1], v.shape[:-1])
        x, y = self._ahead_and_aside
        if not lead and not self._steered:  # of one state without detours
            A = self._still.copy()
            A[:, 0], A[:, 1] = c * x - s * y, s * x + c * y
            return A, (w * aside) * x - (w * ahead) * y
        A, drift = np.empty((*lead, *self._still.shape)), np.empty((*lead, len(self._still)))
        A[...] = self._still
        drift[...] = (w * aside)[..., None] * x - (w * ahead)[..., None] * y
        if self._steered:
            nv, axes = self.nv, len(self.table.axes)
            steering = [q[..., nv + k] for k in range(axes)]
            rates = [v[..., nv + k] for k in range(self.joints)]
            rows = self.kinematics.rows(steering, [ahead, aside, w], rates)
            for i in self._steered:
                row = rows[i if self.rows is None else self.rows[i]]
                for k, entry in enumerate(row.base):
                    A[..., i, k] = number(entry)
                for k in range(axes):
                    A[..., i, nv + k] = number(row.joints[k])
                drift[..., i] = number(row.drift)
        x, y = A[..., 0].copy(), A[..., 1]
        c, s = c[..., None], s[..., None]
        A[..., 0], A[..., 1] = c * x - s * y, s * x + c * y
        return A, drift

    @cached_property
    def _ahead_and_aside(self) -> tuple[Array, Array]:
        """Coefficients of the body's velocities forward and to the left, shape (k,) each."""
        return frozen(self._still[:, 0]), frozen(self._still[:, 1])


@final
@dataclass(frozen=True, eq=False)
class ConstrainedTree:
    """A tree that constraints hold: M a + n = force + A' lambda and A a = -dA/dt v, solved together.

    M may have no inverse, as that of wheels without inertia has none, if what rolls has mass.

    Parameters
    ----------
    tree : WheelTree
        Free of constraints.
    constraints, independent : Constraints
        All rows, and some from which the others follow.
    """

    tree: WheelTree
    constraints: Constraints
    independent: Constraints

    def accelerations(self, q: Array, v: Array, force: Array) -> Array:
        """Return a, shape (..., nv), under a generalised force."""
        M, n = self.tree.inertia_and_effects(q, v)
        return _solved(M, *self.independent.at(q, v), force - n)

    def forces(self, q: Array, v: Array, force: Array) -> tuple[Array, Array]:
        """Return a, and lambda of all rows, shape (..., k), the shortest that there is."""
        M, n = self.tree.inertia_and_effects(q, v)
        force = force - n
        a = _solved(M, *self.independent.at(q, v), force)
        rest = (M @ a[..., None])[..., 0] - force
        A_T = np.swapaxes(self.constraints.at(q, v)[0], -1, -2)
        return a, np.asarray(np.linalg.pinv(A_T, rcond=_REDUNDANT) @ rest[..., None])[..., 0]

    def project(self, q: Array, v: Array) -> Array:
        """Return the velocity with A v = 0 that is nearest in the mass metric, shape (..., nv)."""
        A, _ = self.independent.at(q, v)
        slips = A @ v if v.ndim == 1 == A.ndim - 1 else (A @ v[..., None])[..., 0]
        return v + _solved(self.tree.inertia(q), A, slips, np.zeros(v.shape[-1]))


def _solved(M: Array, A: Array, drift: Array, force: Array) -> Array:
    """Return x of M x = force + A' lambda and A x = -drift, of rows that do not follow from each other."""
    k, n = A.shape[-2:]
    lead: tuple[int, ...] = ()
    if M.ndim > 2 or A.ndim > 2 or force.ndim > 1:
        lead = np.broadcast_shapes(M.shape[:-2], A.shape[:-2], force.shape[:-1])
    K, right = np.zeros((*lead, n + k, n + k)), np.empty((*lead, n + k, 1))
    K[..., :n, :n], K[..., n:, :n], K[..., :n, n:] = M, A, A.swapaxes(-1, -2)
    right[..., :n, 0], right[..., n:, 0] = force, -drift
    return np.asarray(np.linalg.solve(K, right)[..., :n, 0])
