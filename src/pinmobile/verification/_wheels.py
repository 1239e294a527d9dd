"""Methods for the dynamics of a robot on wheels: constraints, independent velocities, closed form, bodies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
import pinocchio as pin

from pinmobile import closed_form
from pinmobile.arrays import Array, instance, rotate
from pinmobile.compiled import vectorize
from pinmobile.errors import NotTraceable
from pinmobile.parts import Stepping, able, evolved
from pinmobile.plant import Step
from pinmobile.robot import BODY_JOINT, MultibodySystem, PinocchioBackend
from pinmobile.verification.bodies import WheelBodies, apply, composite_body, max_ratio, rotors, tree_motion
from pinmobile.wheels import AckermannSteering, Coulomb, WheeledRobot

ROUNDING = 1e-13  # hundreds of roundings, relative to the scale of the terms
SOLUTION = 1e-12  # bound for solutions of linear equations
DIFFERENCE = 1e-9  # bound for derivatives by finite differences of fourth order
_STEP = 1e-3  # step of finite differences, as a share of the time scale of the state
_STEER = 0.6  # [rad]
_H = 1e-3  # [s]: time step of slipping wheels
_SWEEPS, _TOLERANCE = 2000, 1e-15

BODIES, HAND, TREE = "Newton-Euler of the bodies", "closed form by hand", "Pinocchio's tree, null space"
KKT, PLANE, COMPILED = "Pinocchio's tree, KKT", "energies in the plane, null space", "compiled for ensembles"
STEP, RATE = "Coulomb's step", "rate of kinetic energy"

Row: TypeAlias = tuple[str, str, str, float, float]
"""Quantity, two methods, largest difference and bound."""


class _Scales(NamedTuple):
    """Scales of the compared terms: M (n, nv, nv), forces (n, nv), accelerations (n, nv) and power (n,)."""

    M: Array
    tau: Array
    a: Array
    power: Array


@final
class WheelTree(MultibodySystem):
    """Pinocchio's tree of a robot on wheels, with its dynamics in the coordinates of a `WheeledRobot`.

    Parameters
    ----------
    wheeled : WheeledRobot
        Robot on wheels.
    """

    def __init__(self, wheeled: WheeledRobot) -> None:
        model = wheeled.robot.model
        model.gravity.linear = np.array(wheeled.fall)
        model.inertias[BODY_JOINT] = wheeled.bare_body
        for wheel in wheeled.table.wheels:  # CRBA requires the descendants of a joint directly after it
            parent, place = BODY_JOINT, wheel.placement
            if wheel.steering != "fixed":
                pivot = pin.SE3(place.rotation, np.array([wheel.x, wheel.y, wheel.radius]))
                parent = model.addJoint(BODY_JOINT, pin.JointModelRZ(), pivot, f"{wheel.name}_steering")
                place = pin.SE3(np.eye(3), np.array([*wheel.trail, 0.0]))
            joint = model.addJoint(parent, pin.JointModelRY(), place, wheel.name)
            model.appendBodyToJoint(joint, wheel.inertia, pin.SE3.Identity())
        self._engine, self._wheeled = PinocchioBackend(model), wheeled
        self.mounts, self.loads = wheeled.mounts, wheeled.robot.loads

    def dynamics(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return M(q) by CRBA, with rotors, and n(q, v) by RNEA."""
        motion, G = tree_motion(self._wheeled, q, v, 0 * v)
        M = np.swapaxes(G, -1, -2) @ self.mass_matrix(motion[0]) @ G + rotors(self._wheeled)
        return M, np.einsum("...ki,...k->...i", G, self.inverse_dynamics(*motion))


def compare_wheeled(
    wheeled: WheeledRobot, states: int, rng: np.random.Generator
) -> tuple[tuple[Row, ...], str]:
    """Return the comparisons of all methods for a robot on wheels, and a missing method."""
    compare = _slip_rows if able(wheeled, Stepping) else _kkt_rows
    return compare(wheeled, states, rng)


def _states(wheeled: WheeledRobot, count: int, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return random q, v that may violate the rolling constraints, inputs u, and external forces."""
    nq, axes = wheeled.robot.nq, wheeled.table.axes
    q = rng.uniform(-np.pi, np.pi, (count, wheeled.nq))
    q[:, :nq] = wheeled.robot.random_configuration(rng, (count,))
    q[:, 2] = rng.uniform(-4 * np.pi, 4 * np.pi, count)
    for k, axis in enumerate(axes):
        limit = min(_STEER, 0.9 * axis.limit)
        q[:, nq + k] = rng.uniform(-limit, limit, count)
    v, u, f = (rng.normal(size=(count, n)) for n in (wheeled.nv, wheeled.nu, wheeled.nv))
    return q, v, u, f


def _scales(bodies: WheelBodies, wheeled: WheeledRobot, M: Array, v: Array, a: Array, rest: Array) -> _Scales:
    """Return the scales of `verify`, including forces other than gravity and inertia."""
    masses, K, reach = bodies.moved_masses()
    reach, nv = np.maximum(1.0, reach), v.shape[1]
    radii = np.append(np.ones(nv - len(wheeled.table)), wheeled.radius)
    speed, change = (np.square(x * radii).sum(-1) for x in (v, a))
    inertia = np.sqrt(masses * K)
    total = np.linalg.norm(bodies.fall) + np.sqrt(nv * change) * reach + nv * speed * reach
    tau = inertia * total[:, None] + np.abs(rest)
    acceleration = np.einsum("nij,nj->ni", np.abs(np.linalg.inv(M)), tau)
    return _Scales(
        np.sqrt(K[:, :, None] * K[:, None, :]), tau, acceleration, np.einsum("ni,ni->n", tau, np.abs(v))
    )


def _kkt_rows(wheeled: WheeledRobot, states: int, rng: np.random.Generator) -> tuple[tuple[Row, ...], str]:
    q, v, u, f = _states(wheeled, states, rng)
    v = wheeled.project(q, v)
    M, n = WheelTree(wheeled).dynamics(q, v)
    A, drift = wheeled.constraint_matrix(q), wheeled.constraint_drift(q, v)
    force = u @ wheeled.input_matrix.T + f
    # By KKT: M a + n = force + A' lambda and A a = -drift, of rows that do not follow from each other.
    free = sorted({*wheeled.mobility.choice.body, *(row for _, row in wheeled.mobility.choice.joints)})
    size, k = A.shape[-1], len(free)
    K, right = np.zeros((states, size + k, size + k)), np.concatenate([force - n, -drift[:, free]], axis=1)
    K[:, :size, :size], K[:, size:, :size], K[:, :size, size:] = M, A[:, free], np.swapaxes(A[:, free], 1, 2)
    a = np.linalg.solve(K, right[..., None])[:, :size, 0]
    inverse = np.linalg.pinv(np.swapaxes(A, -1, -2), rcond=1e-10)
    ground = apply(inverse, apply(M, a) + n - force)
    bodies, resting = WheelBodies(wheeled, q, v), WheelBodies(wheeled, q, 0 * v, weightless=True)
    columns = resting.forces(np.stack([np.broadcast_to(unit, a.shape) for unit in np.eye(wheeled.nv)]))
    forward, lateral, trains = _forces(wheeled, ground)
    contact = bodies.contact(forward, lateral) + trains @ bodies.trains()
    scales = _scales(bodies, wheeled, M, v, a, np.abs(force) + np.abs(apply(np.swapaxes(A, -1, -2), ground)))
    largest = np.abs(ground).max(-1, keepdims=True) + scales.tau[:, :2].max(-1, keepdims=True)
    plane, forces = wheeled.forward_dynamics(q, v, u, f), wheeled.constraint_forces(q, v, u, f).values
    rows: list[Row] = [
        ("M", "CRBA", BODIES, max_ratio(M - np.moveaxis(columns, 0, -1), scales.M), ROUNDING),
        ("M", "CRBA", PLANE, max_ratio(M - wheeled.mass_matrix(q), scales.M), ROUNDING),
        ("n", "RNEA", BODIES, max_ratio(n - bodies.forces(0 * a), scales.tau), ROUNDING),
        ("n", "RNEA", PLANE, max_ratio(n - wheeled.nonlinear_effects(q, v), scales.tau), ROUNDING),
        ("tau", KKT, BODIES, max_ratio(force + contact - bodies.forces(a), scales.tau), SOLUTION),
        ("a", KKT, PLANE, max_ratio(a - plane, scales.a), SOLUTION),
        ("lambda", KKT, PLANE, max_ratio(ground - forces, largest), SOLUTION),
        *_reduced_rows(wheeled, (M, n), q, v, u, a, f),
    ]
    power = np.einsum("ni,ni->n", v, force - wheeled.nonlinear_effects(q, 0 * v))
    rate = _rate(wheeled, wheeled.kinetic_energy, q, v, a)
    rows.append(("power", KKT, RATE, max_ratio(power - rate, scales.power), DIFFERENCE))
    try:
        compiled = vectorize(wheeled.array_dynamics.forward_dynamics, keep=False)(q, v, u, f)
    except NotTraceable as error:
        return tuple(rows), f"{COMPILED}: {error.reason}"
    rows.append(("a", COMPILED, PLANE, max_ratio(compiled - plane, scales.a), SOLUTION))
    return tuple(rows), ""


def _reduced_rows(
    wheeled: WheeledRobot, tree: tuple[Array, Array], q: Array, v: Array, u: Array, a: Array, f: Array
) -> Iterator[Row]:
    """Yield the rows of the dynamics in independent velocities."""
    plane, body, (M, n) = wheeled.reduced(q, v), wheeled.array_dynamics, tree
    S_T, state = np.swapaxes(plane.S, -1, -2), body.state(q, v)
    bias = body.in_plane(state, body.accelerations(state, [0.0] * plane.nu.shape[-1]), q)
    full = {"M": S_T @ M @ plane.S, "n": apply(S_T, n + apply(M, bias)), "B": S_T @ wheeled.input_matrix}
    diagonal = np.sqrt(np.einsum("nii->ni", full["M"]))
    pair = diagonal[:, :, None] * diagonal[:, None, :]
    # |v| of moving masses, by the metric of the kinetic energy: sqrt(M_ii) |rates|^2 sqrt(m), and gravity.
    rates = np.abs(v[:, : wheeled.robot.nv]).sum(-1) + np.abs(v[:, wheeled.robot.nv :]).sum(-1)
    weight = np.sqrt(wheeled.robot.with_locked_arms(wheeled.robot.rest).mass)
    size = diagonal * weight * (float(np.linalg.norm(body.fall)) + rates**2)[:, None]
    scales = {"M": pair, "n": size, "B": np.abs(full["B"]).max(axis=(1, 2), keepdims=True, initial=0.0) + 1.0}
    for quantity, scale in scales.items():
        difference = full[quantity] - getattr(plane, quantity)
        yield f"{quantity} of nu", TREE, PLANE, max_ratio(difference, scale), ROUNDING
    formulas = closed_form_of(wheeled, q, plane.nu)
    if formulas is not None:
        arms = wheeled.robot.nv - 3
        base = 3 - len(wheeled.mobility.choice.body)
        indices = [*range(base), *range(base + arms, plane.nu.shape[-1])]
        block = np.ix_(range(len(q)), indices, indices)
        yield "M of nu", TREE, HAND, max_ratio(full["M"][block] - formulas.M, pair[block]), ROUNDING
        for quantity in "nB" if not arms else "":
            difference = full[quantity] - getattr(formulas, quantity)
            yield f"{quantity} of nu", TREE, HAND, max_ratio(difference, scales[quantity]), ROUNDING
    rate = _rate(wheeled, wheeled.independent, q, v, a)
    force = apply(full["B"], u) - full["n"] + apply(S_T, f)
    nu_dot = np.linalg.solve(full["M"], force[..., None])[..., 0]
    speed = np.abs(rate).max(-1, keepdims=True) + np.abs(nu_dot).max(-1, keepdims=True) + rates[:, None] ** 2
    yield "nu'", TREE, "rate of nu as KKT moves it", max_ratio(nu_dot - rate, speed), DIFFERENCE


def closed_form_of(wheeled: WheeledRobot, q: Array, nu: Array) -> closed_form.ReducedModel | None:
    """Return the dynamics derived by hand, with locked arms; None on a ramp or without formulas."""
    table, robot = wheeled.table, wheeled.robot
    wheels, equal = table.wheels, _are_alike(wheeled)
    if wheeled.ground.ramp is not None or any(any(wheel.trail) for wheel in wheels):
        return None
    body: dict[str, Any] = composite_body(robot, q[:, : robot.nq])
    spins, common = np.array([wheel.spin_inertia for wheel in wheels]), 0.0
    for actuator in table.actuators:
        column, rotor = np.array(actuator.column[len(table.axes) :]), actuator.motor.reflected_inertia
        if np.count_nonzero(column) > 1:
            common += rotor  # of a differential, that turns at the mean rate of its wheels
        else:
            spins += rotor * column**2
    if table.couplings and not equal:
        return None
    if all(wheel.roller is not None and wheel.steering == "fixed" for wheel in wheels):
        columns = {key: np.array([getattr(wheel, key) for wheel in wheels]) for key in _ROW}
        model = closed_form.roller_drive(nu[:, :3], **body, **columns, spin_inertia=spins)
        motors = [k for k, wheel in enumerate(wheels) if wheel.motor is not None]
        return None if table.couplings else model._replace(B=model.B[..., motors])
    first = wheels[0]
    if any(wheel.roller is not None for wheel in wheels) or not equal or len(set(spins)) > 1:
        return None
    if len(wheels) == 2 and not table.axes and first.y > 0 and all(wheel.motor for wheel in wheels):
        return closed_form.differential_drive(
            nu[:, [0, 1]], **body, track=2 * first.y, radius=first.radius, spin_inertia=spins[0], axle=first.x
        )
    steering = next((each for each in table.couplings if isinstance(each, AckermannSteering)), None)
    if steering is None or len(wheels) != 4 or len(table.axes) != 1 or steering.axle or first.x:
        return None
    front = wheels[table.names.index(steering.wheels[0])]
    data = {"wheelbase": front.x, "radius": first.radius, "track": 2 * abs(first.y), "spin_inertia": spins[0]}
    model = closed_form.car(nu[:, [0, -1]], q[:, robot.nq], **body, **data, steered_inertia=front.yaw_inertia)
    M = model.M.copy()
    M[:, 0, 0] += common / first.radius**2
    return model._replace(M=M, B=model.B[..., [0, 2]])


_ROW = ("x", "y", "angle", "roller", "radius")


def _are_alike(wheeled: WheeledRobot) -> bool:
    """Return whether the wheels are alike, in pairs to the left and right, and roll forward."""
    wheels = wheeled.table.wheels
    points = {(wheel.x, wheel.y) for wheel in wheels}
    kinds = {(wheel.radius, wheel.angle, wheel.yaw_inertia, wheel.spin_inertia) for wheel in wheels}
    symmetric = all((x, -y) in points for x, y in points) and len({abs(y) for _, y in points}) == 1
    return symmetric and len(kinds) == 1 and not wheels[0].angle


def _forces(wheeled: WheeledRobot, values: Array) -> tuple[Array, Array, Array]:
    """Return the forces along and across the wheels, and those of gear trains, from the rows' forces."""
    forward, lateral = np.zeros((2, len(values), len(wheeled.table)))
    names = wheeled.constraint_names
    for k, name in enumerate(names):
        wheel, _, kind = name.rpartition(" ")
        if wheel:
            (lateral if kind == "lateral" else forward)[:, wheeled.table.names.index(wheel)] = values[:, k]
    return forward, lateral, values[:, [k for k, name in enumerate(names) if name == "train"]]


def _rate(
    wheeled: WheeledRobot, function: Callable[[Array, Array], Array], q: Array, v: Array, a: Array
) -> Array:
    """Return the rate of a function of the state along a motion, by finite differences of fourth order.

    The path q + v s + a s^2 / 2 has the state's velocity and acceleration, which determine the rate.
    """
    speed = 1 + np.abs(v[:, 2:]).max(-1) + np.sqrt(np.abs(a[:, 2:]).max(-1))
    h = (_STEP / speed)[:, None]

    def value(s: float) -> Array:
        end = wheeled.integrate(q, s * h * v + (s * h) ** 2 / 2 * a)
        return function(end, v + s * h * a)

    change = 8 * (value(1) - value(-1)) - (value(2) - value(-2))
    return np.asarray(change / (12 * (h if change.ndim > 1 else h[:, 0])))


def _slip_rows(wheeled: WheeledRobot, states: int, rng: np.random.Generator) -> tuple[tuple[Row, ...], str]:
    """Return the comparisons for a step on dry ground, and a missing method."""
    ground: Any = instance("ground", wheeled.ground, Coulomb, "one on which a step can be compared")
    robot = WheeledRobot(wheeled.robot, wheeled.table, evolved(ground, sweeps=_SWEEPS, tolerance=_TOLERANCE))
    q, v, u, f = _states(robot, states, rng)
    trains = WheelBodies(robot, q, v).trains()
    v = v - v @ np.linalg.pinv(trains) @ trains  # wheels on a train turn together from the start
    step = robot.step(0.0, q, v, u, _H, f, robot.initial_state(None))
    memory: Any = step.memory
    solved = np.broadcast_to(memory.missed, (len(q),)) == 0
    memory = type(memory)(*(x[solved] if np.ndim(x) and len(x) == states else x for x in memory))
    step = Step(step.q[solved], step.v[solved], memory)
    missing = f"{COMPILED}: a step is compiled within its loop only"
    if not solved.all():
        missing += f"; {np.sum(~solved)} of the states, whose loads and forces were not found"
    q, v, u, f = (x[solved] for x in (q, v, u, f))
    return tuple(_step_rows(robot, q, v, u, f, step)), missing


def _step_rows(robot: WheeledRobot, q: Array, v: Array, u: Array, f: Array, step: Step) -> Iterator[Row]:
    """Yield the comparisons for a step on dry ground: mean forces balance at mid-step."""
    memory: Any = step.memory
    nv = robot.robot.nv
    pairs = (q[:, 2], v), (step.q[:, 2], step.v)
    start, end = (rotate(np.cos(psi), -np.sin(psi), rates) for psi, rates in pairs)
    mean, rate = (start + end) / 2, (end - start) / _H
    middle = robot.integrate(q, _H / 2 * v)  # its shape is that which the first velocity leads to
    middle[:, 2] = q[:, 2] + _H / 2 * mean[:, 2]
    w = mean[:, 2]
    rate[:, 0], rate[:, 1] = rate[:, 0] - w * mean[:, 1], rate[:, 1] + w * mean[:, 0]
    turn = np.cos(middle[:, 2]), np.sin(middle[:, 2])
    v_mid, a_mid = rotate(*turn, mean), rotate(*turn, rate)
    bodies = WheelBodies(robot, middle, v_mid)
    contact = bodies.contact(memory.forces[:, 0::2], memory.forces[:, 1::2])
    for k, wheel in enumerate(_resisted_wheels(robot)):
        contact[:, nv + len(robot.table.axes) + wheel] += memory.holding[:, k]
    applied = u @ robot.input_matrix.T + f + contact
    M = robot.mass_matrix(middle)
    scales = _scales(bodies, robot, M, v_mid, a_mid, np.abs(applied))
    residual, trains = applied - bodies.forces(a_mid), bodies.trains()
    if len(trains):  # the step does not report forces in gear trains: left out
        residual = residual - residual @ np.linalg.pinv(trains) @ trains
        rates = np.abs(step.v @ trains.T).max()
        yield "trains", STEP, "rates that fit", float(rates / np.abs(step.v).max()), ROUNDING
    yield "tau", STEP, BODIES, max_ratio(residual, scales.tau), SOLUTION
    wrench, loads = bodies.wrench(a_mid), memory.loads
    points = np.stack(
        [*(x.p for x in bodies.wheels), *(np.tile([s.x, s.y], (len(q), 1)) for s in robot.table.supports)],
        axis=1,
    )
    reaction = np.column_stack(
        [loads.sum(-1), (loads * points[..., 1]).sum(-1), -(loads * points[..., 0]).sum(-1)]
    )
    upright = np.broadcast_to(memory.tips, (len(q),)) == 0
    size = scales.tau[:, [0, 2, 2]]
    yield "loads", STEP, BODIES, max_ratio((reaction - wrench[:, 2:5])[upright], size[upright]), SOLUTION
    limit = robot.mu * loads[:, : len(robot.table)]
    forward, lateral = memory.forces[:, 0::2], memory.forces[:, 1::2]
    tyre = np.array([wheel.roller is None for wheel in robot.table.wheels])
    force = np.where(tyre, np.hypot(forward, lateral), np.abs(forward))
    yield "cone", STEP, "mu times the load", max_ratio(np.maximum(force - limit, 0), size[:, :1]), SOLUTION
    power = np.einsum("ni,ni->n", v_mid, applied - robot.nonlinear_effects(middle, 0 * v))
    rise = _rate(robot, lambda x, y: robot.kinetic_energy(x, y), middle, v_mid, a_mid)
    yield "power", STEP, RATE, max_ratio(power - rise, scales.power), DIFFERENCE


def _resisted_wheels(robot: WheeledRobot) -> list[int]:
    """Return the wheels that rolling resistance holds; for wheels that turn together, the first one."""
    leader = list(range(len(robot.table)))
    for first, row, _ in robot.table.trains:
        leader[row] = first
    resisted = {leader[k] for k, wheel in enumerate(robot.table.wheels) if wheel.friction.rolling}
    return sorted(resisted)
