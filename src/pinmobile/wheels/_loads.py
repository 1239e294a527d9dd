"""Loads of wheels and supports, forces and slip margins of rolling wheels, and metrics.

All functions take scalars: numbers, arrays with leading axes, or symbols.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import choose, scalar_max, square_root
from pinmobile.errors import InvalidArgument
from pinmobile.metrics import Metric
from pinmobile.plant import LIMIT_TOLERANCE, ContactLoads, Contacts, SlipMargins, TorqueMargins
from pinmobile.robot import (
    ONE,
    WEIGHTLESS,
    ZERO,
    Matrix,
    Vector,
    cross,
    dot,
    exact,
    margin_of_wrench,
    number,
    scalars,
    sine_and_cosine,
    single,
    symmetric,
    vector_of as stacked,
)
from pinmobile.wheels._contact import iterate
from pinmobile.wheels._kinematics import ReferenceMotion, driving_inputs

_BASE = 3
_FAST, _WEAK = "exceed a speed limit", "exceed an effort limit"
_MIN_YAW_RATE = 1e-9  # [rad/s]: a body with a lower yaw rate does not turn
_FORCES = "along", "across", "loads"
_SECOND = "lateral", "across"  # kinds of rows that are a wheel's second direction
_FLAT = 1e-9  # relative tolerance of the determinant of contacts on a line
_NOTHING = 1e-12  # relative to the weight: tolerance of a load of zero
_SOFT = 1e-7  # relative to the moments of all springs: additional stiffness for contacts on a line
_EDGE = 1e-5  # relative to the size of the polygon: tolerance of its edge before the robot tips


class Loads(NamedTuple):
    """Load of each contact.

    Attributes
    ----------
    values : list of scalars
        Loads, not below zero [N].
    tips : scalar
        1 if no loads balance the robot, which begins to tip over; then the loads carry the weight at the
        point of the support polygon that is nearest to the zero-moment point. Otherwise 0.
    springs : list of scalars
        Loads of equal springs that may also pull: below zero for a contact without load [N].
    """

    values: Vector
    tips: Any
    springs: Vector


def shared_loads(places: Sequence[Vector], fz: Any, mx: Any, my: Any) -> Loads:
    """Return the loads that balance a wrench: those of equal springs that press and never pull.

    They minimise the sum of N^2 subject to N >= 0 and G' N = b, with the rows 1, y, -x of G and b = (fz, mx,
    my). Contacts leave one by one before their load becomes negative, and return if the ground would
    penetrate them (Lawson and Hanson, Solving least squares problems, 1974, chapter 23).

    Parameters
    ----------
    places : sequence of (x, y), scalars
        Positions of the contacts, along the body's axes from its origin on the ground [m].
    fz, mx, my : scalars
        Vertical force of the ground [N], and its moment about the body's origin [N m].
    """
    n, wrench = len(places), [number(x) for x in (fz, mx, my)]
    fz, nothing = wrench[0], _NOTHING * abs(wrench[0])
    springs, area_0 = _of_springs(places, [ONE] * n, wrench)
    size = sum((dot(place, place) for place in places), ZERO)
    press = springs[0] >= -nothing
    for x in springs[1:]:
        press = press & (x >= -nothing)

    def iteration(active: Vector, old: Vector) -> tuple[Any, Any]:
        loads, _ = _of_springs(places, active, wrench, _SOFT * size)
        share, rises, parts = 1.0 + 0.0 * fz, 0.0 * fz, []
        for k, x, y in zip(active, old, loads, strict=True):
            falls = (k > 0.0) & (y < 0.0)
            parts.append(choose(falls, x / choose(falls, x - y, 1.0), 2.0))
            share = choose(parts[-1] < share, parts[-1], share)
            rises = scalar_max(choose(k > 0.0, 0.0, y), rises)
        leaves, joins = share < 1.0, rises > nothing
        active = [
            choose(leaves, choose(part <= share, 0.0, k), choose(joins & (y >= rises), 1.0, k))
            for k, part, y in zip(active, parts, loads, strict=True)
        ]
        new = [choose(k > 0.0, x + share * (y - x), 0.0) for k, x, y in zip(active, old, loads, strict=True)]
        return (active, new), (share >= 1.0) & (rises <= nothing)

    first = [1.0 + 0.0 * fz] * n, [scalar_max(fz, 0.0) * (1.0 / n)] * n
    active, soft = iterate(iteration, first, 4 * n, press | (fz <= 0.0))
    sharp, area = _of_springs(places, active, wrench, flat=_FLAT * area_0)
    stands = area > _FLAT * area_0
    values = [choose(k > 0.0, choose(stands, x, y), 0.0) for k, x, y in zip(active, sharp, soft, strict=True)]
    values = [scalar_max(choose(press, y, x), 0.0) for x, y in zip(values, springs, strict=True)]
    total = sum(values[1:], values[0])
    scale = choose(press, 1.0, scalar_max(fz, 0.0) / choose(total > 0.0, total, 1.0))
    values = [x * scale for x in values]
    errors = [dot([place[i] for place in places], values) - x for i, x in ((1, wrench[1]), (0, -wrench[2]))]
    tips = dot(errors, errors) > (_EDGE * _EDGE) * size * (fz * fz)
    return Loads(values, choose(tips | (fz <= 0.0), 1.0, 0.0), springs)


def _of_springs(
    places: Sequence[Vector], weights: Vector, wrench: Vector, soft: Any = None, flat: Any = 0.0
) -> tuple[Vector, Any]:
    """Return the forces of springs at all positions if some of them carry, and the determinant of G K G'.

    Parameters
    ----------
    weights : list of scalars
        1 for a spring that carries, else 0.
    soft : scalar, optional
        Addition to the moments of inertia, for springs on a line.
    flat : scalar, optional
        Determinant up to which springs are on a line, and the forces are invalid.
    """
    rows = [[ONE, y, -x] for x, y in places]
    GK = [[w * x for x in row] for w, row in zip(weights, rows, strict=True)]
    a, d, e, b, f, c = (
        sum((w[i] * row[j] for w, row in zip(GK, rows, strict=True)), ZERO)
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    )
    if soft is not None:
        b, c = b + soft, c + soft
    diagonal = b * c - f * f, a * c - e * e, a * b - d * d
    minors = symmetric([*diagonal, e * f - d * c, d * f - e * b, d * e - a * f])
    area = number(dot([a, d, e], minors[0]))
    share = 1.0 / choose(area > flat, area, 1.0)
    motion = [dot(row, wrench) * share for row in minors]
    return [number(dot(row, motion)) for row in rows], area


def places_of(body: Any, steering: Sequence[Any]) -> list[Vector]:
    """Return the contact points of wheels and supports, along the body's axes [m]."""
    places = [body.kinematics.centre(row, steering)[1] for row in range(len(body.table))]
    return places + [[exact(each.x), exact(each.y)] for each in body.table.supports]


def ground_reaction(body: Any, state: Any, a: Vector, q: Any) -> Vector:
    """Return fz, mx and my of the ground on a robot with spinning wheels [N, N m, N m].

    They equal the rate of momentum of all bodies minus gravity: by the Newton-Euler equations for a robot
    without arms, by their recursion for others. The spin of the wheels is added.

    Parameters
    ----------
    body : WheeledDynamics
        The robot.
    state : State
        Configuration and velocities.
    a : list of scalars
        Proper accelerations in the plane, along the body's axes.
    q : ndarray
        Any configuration, for its shape.
    """
    w = state.twist[2]
    fz, mx, my = _body_reaction(body, state, a, q)
    first = body.of_body
    rates, axis_of = state.rates, body.kinematics.axis_of
    for row, spin in enumerate(scalars(body.spin_inertia)):
        head, k, axis = body.kinematics.heading(row, state.steering), len(body.table.axes) + row, axis_of[row]
        turn = w + head.first * rates[axis] if axis >= 0 else w
        faster, slower = spin * a[first + k], spin * rates[k] * turn
        mx = mx - head.s * faster - head.c * slower
        my = my + head.c * faster - head.s * slower
        wheel = body.table.wheels[row]
        if axis >= 0 and wheel.mass and any(wheel.trail):  # its centre moves about the pivot
            (o, p), (o0, p0) = body.centres(row, state)
            weight = -wheel.mass * float(body.fall[2])
            mx, my = mx + weight * (p[1] - p0[1]), my - weight * (p[0] - p0[0])
            turning = a[2] + head.first * a[first + axis] + head.second * rates[axis] * rates[axis]
            swing = wheel.mass * scalars(body.radius)[row]
            forward = a[2] * o0[1] - turning * o[1] - turn * turn * o[0] + w * w * o0[0]
            left = turning * o[0] - a[2] * o0[0] - turn * turn * o[1] + w * w * o0[1]
            mx, my = mx - swing * left, my + swing * forward
    return [fz, mx, my]


def _body_reaction(body: Any, state: Any, a: Vector, q: Any) -> Vector:
    """Return fz, mx and my of the ground for wheels that do not spin; `a` excludes gravity."""
    if body.na:
        n = body.of_body
        q_arms, zeros = stacked([ZERO, ZERO, ZERO, *state.arms], q), stacked([ZERO] * n, q)
        v = stacked([*state.twist, *state.arm_rates], q)
        reaction = scalars(body.robot.ground_wrench(q_arms, v, stacked(a[:n], q)))[2:5]
        if not body.gravity_reduction:
            return reaction
        weights = scalars(body.robot.ground_wrench(q_arms, zeros, zeros))[2:5]
        return [x - body.gravity_reduction * y for x, y in zip(reaction, weights, strict=True)]
    robot = body.robot
    m, x, y = (single(each) for each in (robot.mass, robot.com_x, robot.com_y))
    (height, xz, yz), w, spin, g = scalars(body.upright), state.twist[2], a[2], -float(body.fall[2])
    ax, ay = a[0] - spin * y - w * w * x, a[1] + spin * x - w * w * y
    mx = m * (y * g - height * ay) + (xz * spin - yz * (w * w))
    my = m * (height * ax - x * g) + (yz * spin + xz * (w * w))
    return [m * g, mx, my]


class AxleGroup(NamedTuple):
    """Wheels whose lateral force is computed: one wheel, or several if only their sum is determined.

    Attributes
    ----------
    wheels : tuple of int
        Rows of the table.
    lateral : tuple of int
        Their lateral rows among those of the kinematics; none for wheels with rollers.
    body_row : int
        Number of the row in ``choice.body``; -1: a row that determines a joint, or none.
    """

    wheels: tuple[int, ...]
    lateral: tuple[int, ...]
    body_row: int


def groups_of(body: Any) -> tuple[AxleGroup, ...]:
    """Return the groups of wheels of a rolling body, in the order of their first wheels.

    A drive with gear trains has none, because its wheels share the transmitted force.
    """
    table, choice = body.table, body.choice
    if table.trains:
        return ()
    rows = body.kinematics.rows([ZERO] * len(table.axes), [ZERO] * _BASE, [ZERO] * body.joints)
    constrained = {i for _, i in choice.joints}
    sharing: dict[int, list[int]] = {k: [] for k in range(len(choice.body))}
    groups = []
    for i, row in enumerate(rows):
        if row.kind == "roller":
            groups.append(AxleGroup((row.wheel,), (), -1))
        elif row.kind == "lateral" and i in constrained:
            groups.append(AxleGroup((row.wheel,), (i,), -1))
        elif row.kind == "lateral":
            sharing[_axle(body, rows, row)].append(i)
    for k, indices in sharing.items():
        groups.append(AxleGroup(tuple(rows[i].wheel for i in indices), tuple(indices), k))
    return tuple(sorted(groups))


def _axle(body: Any, rows: Sequence[Any], row: Any) -> int:
    """Return the number of the body's row on whose axle the wheel of a lateral row is."""
    wheels, axis_of = [rows[i].wheel for i in body.choice.body], body.kinematics.axis_of
    if len(wheels) == 1:
        return 0
    if row.wheel in wheels:
        return wheels.index(row.wheel)
    if body.choice.is_fixed:
        return int(axis_of[row.wheel] >= 0)
    return int(axis_of[row.wheel] != axis_of[wheels[0]])


def margin(body: Any, state: Any, proper_a: Vector, u: Any, loads: Vector, q: Any) -> Matrix:
    """Return forces along rolling wheels, lateral forces of each of `groups_of`, and their margins.

    The force along a wheel follows from its torque minus its spin-up. The lateral force of one axle follows
    from the rest that body and arms need, and those of two axles likewise. Wheels of one axle share: its
    margin is that of the best distribution, ``sum sqrt((mu N)^2 - along^2) - abs(Y)``, and at most ``mu N -
    abs(along)`` of each. Two wheels with Ackermann steering count as an axle through the virtual wheel in
    their middle.

    Parameters
    ----------
    body : RollingDynamics
        Rolling dynamics.
    state, proper_a, q
        As in `ground_reaction`.
    u : ndarray, shape (..., nu)
        Torques.
    loads : list of scalars
        Loads of wheels, then of supports [N].
    """
    groups, ns, first = body.groups, len(body.table.axes), body.of_body
    M, n, tau = body.inertia(state, q), body.effects(state, q), body.input_force(state, u, 0.0)
    rows = body.rows(state)
    of_wheels = {row.wheel: i for i, row in enumerate(rows) if row.kind in ("rolling", "roller")}

    def left(k: int) -> Any:
        return n[k] + dot(M[k], proper_a) - tau[k]

    forces: dict[int, Any] = {}
    for joint, i in sorted(body.choice.joints, reverse=True):  # wheels first, then steering coordinates
        rest = left(first + joint)
        for j, x in forces.items() if joint < ns else ():
            rest = rest - rows[j].joints[joint] * x
        forces[i] = rest / rows[i].joints[joint]
    base = [left(k) for k in range(_BASE)]
    for i, x in forces.items():
        base = [b - x * c for b, c in zip(base, rows[i].base, strict=True)]
    axles = _axles(body, state, rows)
    if len(axles) == 1:
        sides = [axles[0][0] * base[0] + axles[0][1] * base[1]]
    elif axles:
        normal = cross(axles[0], axles[1])
        share = 1.0 / number(dot(normal, normal))
        sides = [dot(cross(base, axles[1]), normal) * share, dot(cross(axles[0], base), normal) * share]
    along = [number(forces[of_wheels[row]]) for row in range(len(body.table))]
    limits = [mu * load for mu, load in zip(scalars(body.mu), loads, strict=False)]
    lateral, margins = [], []
    for group in groups:
        side = forces[group.lateral[0]] if group.body_row < 0 and group.lateral else ZERO
        side = number(sides[group.body_row] if group.body_row >= 0 else side)
        lateral.append(side)
        margins.append(_margin([(along[k], limits[k]) for k in group.wheels], side, bool(group.lateral)))
    return [along, lateral, margins]


def _axles(body: Any, state: Any, rows: Sequence[Any]) -> list[Vector]:
    """Return the direction of each axle's lateral force as coefficients of the body twist."""
    axles = []
    for i in body.choice.body:
        axis = body.kinematics.axis_of[rows[i].wheel]
        if axis < 0 or body.table.axes[axis].ackermann is None:
            axles.append(rows[i].base)
            continue
        s, c = sine_and_cosine(state.steering[axis])
        axles.append([-s, c, c * body.kinematics.x[rows[i].wheel]])
    return axles


def _margin(wheels: Sequence[tuple[Any, Any]], side: Any, is_tyre: bool) -> Any:
    """Return the margin of wheels, each with its force along and its largest friction."""
    if not is_tyre:
        return wheels[0][1] - abs(wheels[0][0])
    if len(wheels) == 1:
        force, limit = wheels[0]
        return limit - square_root(force * force + side * side)
    rests = (limit * limit - force * force for force, limit in wheels)
    total = sum((square_root(scalar_max(number(rest), 0.0)) for rest in rests), ZERO)
    return reduce(lower, [*(limit - abs(force) for force, limit in wheels), total - abs(side)])


def lower(x: Any, y: Any) -> Any:
    """Return the lower of two scalars."""
    return choose(y < x, y, x)


def arms_of(body: Any) -> Any:
    """Return the metrics of the arms of a body; None without arms."""
    return body.robot.tree.arm_metrics if body.na else None


def footprint_of(body: Any) -> Array | None:
    """Return the support polygon of a body with arms, shape (k, 2) [m]; None if it has no tip-over margin."""
    return body.footprint if body.stands and arms_of(body) is not None else None


def limits_of(body: Any) -> list[tuple[int, float]]:
    """Return the numbers of inputs with limits, each with its largest magnitude."""
    limits = [(k, max(abs(x.lower), abs(x.upper))) for k, x in enumerate(body.inputs)]
    return [(k, limit) for k, limit in limits if np.isfinite(limit)]


def fast_actuators(body: Any) -> list[int]:
    """Return the numbers of the actuators with a limit of their rate."""
    motors = enumerate(each.motor for each in body.table.actuators)
    return [k for k, motor in motors if motor.is_electric or np.isfinite(motor.rate_limit)]


def weak_actuators(body: Any) -> list[int]:
    """Return the numbers of the electric motors that take a torque as input."""
    inputs = body.inputs[len(body.inputs) - len(body.table.actuators) :]
    pairs = enumerate(zip(body.table.actuators, inputs, strict=True))
    return [k for k, (each, taken) in pairs if each.motor.is_electric and taken.unit == "N m"]


def _largest_input(body: Any, k: int, limit: float) -> Any:
    """Return the largest magnitude of an input; of an electric motor, the stall torque of its robot."""
    actuator = k - len(body.inputs) + len(body.table.actuators)
    motor = body.table.actuators[actuator].motor if actuator in weak_actuators(body) else None
    return limit if motor is None else motor.own_stall_torque


def metrics_on_wheels(body: Any) -> tuple[Metric, ...]:
    """Return the metrics whose values `values_on_wheels` returns.

    Parameters
    ----------
    body : WheeledDynamics
        The robot.
    """
    arms, metrics = arms_of(body), []
    if arms is not None:
        metrics += [metric for metric in arms.metrics if metric.name.startswith("end effector")]
    if limits_of(body):
        metrics.append(Metric("effort", "", "largest |input| of a joint or wheel, relative to its limit"))
    if footprint_of(body) is not None:
        words = "distance of the zero-moment point from the edge of the support polygon"
        metrics.append(Metric("tip-over margin", "m", words, "smallest"))
    if body.stands:
        words = "smallest load of a wheel or support; negative where the robot tips over"
        metrics.append(Metric("load", "N", words, "smallest"))
        words = "no loads of wheels and supports balance them; tipping over is not simulated"
        metrics.append(Metric("tip over", "", words, "ever"))
    if body.slips:
        metrics.append(Metric("slip", "m/s", "largest velocity at which a wheel slides on the ground"))
    elif body.stands and body.groups:
        words = "smallest friction that a wheel, or an axle, has left before it slips"
        metrics.append(Metric("slip margin", "N", words, "smallest"))
    limits = {} if arms is None else {metric.name: metric for metric in arms.limit_metrics}
    if fast_actuators(body):
        words = "a joint or motor is faster than its limit, or than without load"
        limits[_FAST] = Metric(_FAST, "", words, "ever")
    if weak_actuators(body):
        limits[_WEAK] = Metric(_WEAK, "", "a torque is larger than its motor has at its rate", "ever")
    return (*metrics, *limits.values())


def values_on_wheels(body: Any, t: Any, q: Any, v: Any, a: Any, u: Any, reference: Any) -> Any:
    """Return the values of the metrics in a motion, shape (..., m).

    Parameters
    ----------
    body : WheeledDynamics
        The robot.
    t : float
        Time [s]; no metric depends on it.
    q, v, a, u : ndarray, shape (..., nq), (..., nv), (..., nv), (..., nu)
        State, acceleration and input.
    reference : Reference
        Desired values of the first coordinates.
    """
    state, values, arms = body.state(q, v), [], arms_of(body)
    if arms is not None and arms.tips:
        values += scalars(arms.pose_errors(body.robot, q[..., : int(body.robot.nq)], reference.q))
    limits = limits_of(body)
    if limits:
        inputs, effort = scalars(u), 0.0
        for k, limit in limits:
            effort = scalar_max(abs(number(inputs[k])) * (1.0 / _largest_input(body, k, limit)), effort)
        values.append(effort)
    if body.stands:
        values += _of_ground(body, state, a, u, q)
    if body.slips:
        values.append(_slip(body, state))
    exceeded: dict[str, Any] = {}
    if arms is not None and arms.limit_metrics:
        values_of_arms = arms.exceeded_limits(q[..., : int(body.robot.nq)], v[..., : int(body.robot.nv)])
        names = [metric.name for metric in arms.limit_metrics]
        exceeded = dict(zip(names, scalars(np.stack(values_of_arms, axis=-1)), strict=True))
    for k in fast_actuators(body):
        limit = body.table.actuators[k].motor.largest_rate * (1.0 + LIMIT_TOLERANCE)
        is_fast = abs(body.actuator_rates(state.rates)[k]) > limit
        exceeded[_FAST] = choose(is_fast, 1.0, exceeded.get(_FAST, 0.0))
    for k in weak_actuators(body):
        torque, rate = scalars(u)[k - len(body.table.actuators)], body.actuator_rates(state.rates)[k]
        is_weak = body.table.actuators[k].motor.lacks(number(torque), number(rate))
        exceeded[_WEAK] = choose(is_weak, 1.0, exceeded.get(_WEAK, 0.0))
    values += exceeded.values()
    return stacked([number(x) for x in values], q)


def _of_ground(body: Any, state: Any, a: Any, u: Any, q: Any) -> Vector:
    """Return the metrics of the ground reactions."""
    proper_a, values = body.proper_acceleration(state, state.to_body(scalars(a))), []
    fz, mx, my = ground_reaction(body, state, proper_a, q)
    corners = footprint_of(body)
    if corners is not None:
        wrench = stacked([ZERO, ZERO, fz, mx, my, ZERO], q)
        values += scalars(margin_of_wrench(corners, wrench, body.weight)[..., None])
    places = places_of(body, state.steering)
    loads = shared_loads(places, fz, mx, my)
    pulls, least = reduce(lower, loads.springs), reduce(lower, loads.values)  # of four, one may lift off
    values += [_without_rounding(choose(loads.tips > 0.0, pulls, least), fz), loads.tips]
    if not body.slips and body.groups:
        margins = margin(body, state, proper_a, u, loads.values, q)[2]
        values.append(_without_rounding(reduce(lower, margins), fz))
    return values


def _without_rounding(force: Any, fz: Any) -> Any:
    """Return a force, or 0 if it is rounding of the sum of the loads."""
    return choose(abs(number(force)) > WEIGHTLESS * abs(number(fz)), force, 0.0)


def _slip(body: Any, state: Any) -> Any:
    """Return the largest slip velocity of a wheel; a wheel with rollers slips along their axes."""
    squares: dict[int, Any] = {}
    for row in body.rows(state):
        if row.wheel >= 0:
            slip = row.slip(state)
            squares[row.wheel] = squares.get(row.wheel, ZERO) + slip * slip
    return square_root(reduce(scalar_max, squares.values()))


class Forces(NamedTuple):
    """Forces of the ground on the wheels.

    Attributes
    ----------
    names : tuple of str
        Names of the rows, such as ``"left rolling"``.
    values : ndarray, shape (..., k)
        Force of the ground on the robot along each row [N]; for a gear train, the transmitted force.
    determined : ndarray of bool, shape (k,)
        Whether rolling determines the force; of the others it determines only sums, which are shared with the
        least sum of squares.

    See Also
    --------
    WheeledRobot : its method `constraint_forces`

    Examples
    --------
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> still = 0 * robot.rest
    >>> forces = robot.constraint_forces(robot.rest, still, [3, 3])
    >>> forces.names[0], f"{forces.values[0]:.1f} N"
    ('left rolling', '28.1 N')
    """

    names: tuple[str, ...]
    values: Array
    determined: Array


def contact_loads(body: Any, state: Any, proper_a: Any, q: Array) -> ContactLoads:
    """Return the load of each contact, for arrays."""
    loads = shared_loads(places_of(body, state.steering), *ground_reaction(body, state, proper_a, q))
    names = (*body.table.names, *(f"support {k + 1}" for k in range(len(body.table.supports))))
    tips = np.broadcast_to(number(loads.tips), q.shape[:-1]) > 0
    return ContactLoads(names, stacked(loads.values, q), stacked(loads.springs, q), tips)


def rolling_margins(body: Any, state: Any, a: Any, u: Array, q: Array) -> tuple[ContactLoads, SlipMargins]:
    """Return loads and slip margins of rolling wheels, for arrays."""
    if not body.groups:
        raise InvalidArgument(
            "robot has wheels on a gear train, which share its force; expected ground=Coulomb()"
        )
    loads = contact_loads(body, state, a, q)
    rows = margin(body, state, a, u, list(np.moveaxis(loads.values, -1, 0)), q)
    names = tuple(" + ".join(body.table.names[k] for k in group.wheels) for group in body.groups)
    along, lateral, margins = (stacked(x, q) for x in rows)
    return loads, SlipMargins(names, margins, along, lateral)


def recorded_margins(body: Any, motion: Any) -> SlipMargins:
    """Return the slip margins of wheels that may slip, from the signals of a run."""
    signals = getattr(motion, "signals", None) or {}
    if not set(_FORCES) <= set(signals):
        raise InvalidArgument(
            "motion has no signals of the wheels' forces, expected the Rollout of a simulation"
        )
    along, across, loads = (np.asarray(signals[name][1]) for name in _FORCES)
    rollers = np.array([wheel.roller is not None for wheel in body.table.wheels])
    size = np.where(rollers, np.abs(along), np.hypot(along, across))
    return SlipMargins(body.table.names, body.mu * loads[..., : len(body.table)] - size, along, across)


@final
@dataclass(frozen=True, eq=False)
class TimeScaledMotion:
    """Rolling motion along a reference, with its speed multiplied by a factor.

    Parameters
    ----------
    body : RollingDynamics
        Rolling dynamics.
    motion : ReferenceMotion
        Motion at the original speed.
    efforts : ndarray, shape (arms,)
        Largest torques of the arms' joints [N m].
    """

    body: Any
    motion: ReferenceMotion
    efforts: Array

    def at(self, factor: float) -> tuple[ContactLoads, SlipMargins, TorqueMargins]:
        """Return loads, slip and torque margins of the motion at `factor` times its speed, (N, k) each.

        Parameters
        ----------
        factor : float
            Factor of the speed.
        """
        body, q, v = self.body, self.motion.q, factor * self.motion.v
        state, rates = body.state(q, v), factor**2 * self.motion.rates
        a = body.accelerations(state, list(np.moveaxis(rates, -1, 0)))
        proper_a = body.proper_acceleration(state, [number(x) for x in a])
        u = driving_inputs(body, q, v, rates)
        return *rolling_margins(body, state, proper_a, u, q), self._margins(v, u)

    def _margins(self, v: Array, u: Array) -> TorqueMargins:
        """Return the torque margins of arms and wheels."""
        body, na = self.body, self.body.na
        rates = v[:, 3 + na :] @ np.array([each.column for each in body.table.actuators], float).T
        margins = list((self.efforts - np.abs(u[:, :na])).T)
        for actuator, torque, rate in zip(body.table.actuators, u[:, na:].T, rates.T, strict=True):
            margins.append(actuator.motor.margin(torque, rate))
        return TorqueMargins(tuple(x.name for x in body.inputs), np.stack(margins, axis=-1))


def contacts_of(wheeled: Any, q: Array, v: Array, a: Array, u: Array, signals: Mapping[str, Any]) -> Contacts:
    """Return the contacts of a robot on wheels at the samples of a run.

    On `Coulomb` ground they are the signals of the run, means over the step before. On `Rolling` ground they
    are the constraint forces of state and input, without other external forces; their limits follow from the
    wheels' own friction and the loads of the recorded acceleration.

    Parameters
    ----------
    wheeled : WheeledRobot
        The robot.
    q, v, a, u : ndarray, shape (n, ...)
        Samples.
    signals : mapping of str to Signal
        Signals of the run.
    """
    table, body, n = wheeled.table, wheeled.array_dynamics, len(q)
    state, k = body.state(q, v), len(table)
    centres = [body.kinematics.centre(i, state.steering)[1] for i in range(k)]
    places = q[:, None, :2] + np.stack([stacked(state.outward(at), q) for at in centres], axis=1)
    heads = [body.kinematics.heading(i, state.steering) for i in range(k)]
    angles = np.arctan2(stacked([head.s for head in heads], q), stacked([head.c for head in heads], q))
    directions = q[:, 2:3] + angles + np.array([wheel.roller or 0.0 for wheel in table.wheels])
    is_known, forces, slips = np.ones((k, 2), bool), np.zeros((n, k, 2)), np.zeros((n, k, 2))
    loads, slides = np.full((n, k), np.nan), np.zeros((n, k), bool)
    rows = [(i, row.wheel, int(row.kind in _SECOND)) for i, row in enumerate(body.rows(state))]
    indices, wheels, second = np.array([row for row in rows if row[1] >= 0]).T
    if wheeled.mobility.is_regular:
        is_known[wheels, second] = wheeled.mobility.determined[indices]
    if body.slips:
        along, across, loads = (signals[name].values for name in _FORCES)
        forces, loads = np.stack([along, across], axis=-1), loads[:, :k]
        slips = np.stack([signals["slip_along"].values, signals["slip_across"].values], axis=-1)
        slides = signals["slides"].values > 0.5
    else:
        forces[:, wheels, second] = wheeled.constraint_forces(q, v, u).values[:, indices]
        if body.stands:
            loads = wheeled.contact_loads(q, v, a).values[:, :k]
        for row in body.rows(state, across=True):
            if row.kind == "across":  # rollers turn across their axes
                slips[:, row.wheel, 1] = row.slip(state)
    mus = [wheel.friction.across for wheel in table.wheels]
    across = [mu if w.roller is None else x for mu, x, w in zip(wheeled.mu, mus, table.wheels, strict=True)]
    limits = loads[..., None] * np.stack([wheeled.mu, across], axis=-1)
    turns = np.abs(v[:, 2:3]) > _MIN_YAW_RATE
    centre = q[:, :2] + np.stack([-v[:, 1], v[:, 0]], axis=-1) / np.where(turns, v[:, 2:3], 1.0)
    centre = np.where(turns, centre, np.inf)
    return Contacts(table.names, places, directions, forces, is_known, loads, limits, slips, slides, centre)
