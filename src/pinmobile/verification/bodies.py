"""Dynamics of a robot from its separate parts (body, arms, loads), by Newton's and Euler's laws."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.dh import JointType
from pinmobile.robot import BODY_JOINT, MobileRobot, Mount, add_scope, joints_of, named_frames, number
from pinmobile.wheels import Kinematics, Wheel, WheeledRobot

_DOWN = np.array([0, 0, -9.81])  # [m/s^2]
_POSE = ("x", "y", "psi")
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # for each of x, y, z, the other two


@dataclass
class _Link:
    """Rigid link, at n states.

    Parameters
    ----------
    parent : int
        Index of the parent link; -1 for the ground.
    T : ndarray, shape (n, 4, 4)
        Pose in the parent's frame.
    S : ndarray, shape (n, 6, m)
        Twist relative to the parent for each unit velocity, linear and angular, along the link's axes.
    columns : sequence of m int
        Indices of its coordinates in v.
    rotors : ndarray, shape (m,), or 0.0
        Inertia of the rotors at the joint [kg m^2].
    bodies : list of (float, ndarray, ndarray)
        Mass, centre of mass and inertia about this centre for each body on the link, in the link's frame.
    """

    parent: int
    T: Array
    S: Array
    columns: list[int]
    rotors: Array | float = 0.0
    bodies: list[tuple[float, Array, Array]] = field(default_factory=list)

    def add(self, body: pin.Inertia, placement: pin.SE3) -> None:
        """Add a body whose frame has a given placement on the link."""
        R, p = placement.rotation, placement.translation
        self.bodies.append((float(body.mass), p + R @ body.lever, R @ body.inertia @ R.T))


class Parts:
    """Links of a robot at n states.

    Parameters
    ----------
    robot : MobileRobot
        Robot; this class reads only its `body`, `mounts` and `loads`.
    q, v : ndarray, shape (n, nq) and (n, nv)
        States.
    fall : ndarray, shape (3,)
        Gravity along the inertial axes [m/s^2].
    """

    def __init__(self, robot: MobileRobot, q: Array, v: Array, fall: Array = _DOWN) -> None:
        self.nv, self.count = v.shape[1], len(q)
        self.v, self.fall = v, fall
        self.links = self._chain(robot, q)
        body = pin.Inertia(robot.body.mass, robot.body.com, robot.body.inertia)
        self.links[-1].add(body, pin.SE3.Identity())
        self._frames = {row.variable: (k, pin.SE3.Identity()) for k, row in enumerate(robot.dh)}
        self._frames["base_link"] = BODY_JOINT - 1, pin.SE3.Identity()
        for mount in robot.mounts:
            self._mount(mount, q)
        for load in robot.loads:
            link, placement = self._frames[load.frame]
            self.links[link].add(load.body, placement)

    def _chain(self, robot: MobileRobot, q: Array) -> list[_Link]:
        order = [_POSE.index(row.variable) for row in robot.dh]
        transforms = robot.dh.transforms(q[:, order])
        links = []
        for k, row in enumerate(robot.dh):
            S = np.zeros((self.count, 6, 1))
            S[:, 2 if row.joint is JointType.PRISMATIC else 5] = 1.0
            links.append(_Link(k - 1, transforms[:, k], S, [order[k]]))
        return links

    def _mount(self, mount: Mount, q: Array) -> None:
        """Add the links of an arm as read from its file; a locked joint has no coordinates."""
        arm, base = mount.arm, BODY_JOINT - 1
        model, reference, locked, posture = arm.file_model, arm.whole, arm.fixed_joints, arm.rest
        if mount.is_changed:  # to the numbers of the moving model
            model, reference, locked, posture = mount.model, mount.model, [], arm.posture
        free = [joint for joint in range(1, model.njoints) if joint not in locked]
        arm_q = np.array(np.broadcast_to(posture, (self.count, len(posture))))
        arm_q[:, [reference.idx_qs[joint] for joint in free]] = q[:, mount.q]
        arm_q = _file_configurations(model, arm_q)
        columns = {joint: [k] for k, joint in enumerate(free, mount.v.start)}
        self.links[base].add(model.inertias[0], mount.placement)
        first = len(self.links) - 1  # joint 1 of the arm is the next link
        for joint in range(1, model.njoints):
            parent, indices = model.parents[joint], columns.get(joint, [])
            foot = mount.placement if parent == 0 else pin.SE3.Identity()
            T, S = _joint_states(model, joint, foot, arm_q)
            rotors = np.array(model.armature)[model.idx_vs[joint] :][: len(indices)]
            link = _Link(first + parent if parent else base, T, S[..., : len(indices)], indices, rotors)
            link.add(model.inertias[joint], pin.SE3.Identity())
            self.links.append(link)
        prefixed_model = add_scope(mount.model, mount.name)
        for name, k in named_frames(prefixed_model).items():
            frame = prefixed_model.frames[k]
            link_index = first + free[frame.parentJoint - 1] if frame.parentJoint else base
            placement = frame.placement if frame.parentJoint else mount.placement * frame.placement
            self._frames[name] = link_index, placement

    def forces(self, a: Array, *, gravity: bool = True) -> Array:
        """Return the generalised forces for these states and accelerations, shape (..., n, nv)."""
        tau = np.zeros((*a.shape[:-1], self.nv))
        for link, wrench in zip(self.links, self._wrenches(a, gravity), strict=True):
            torque = apply(np.swapaxes(link.S, -1, -2), wrench)
            tau[..., link.columns] = torque + link.rotors * a[..., link.columns]
        return tau

    def ground_wrench(self, a: Array) -> Array:
        """Return the ground's wrench in the body frame, about its origin, shape (n, 6)."""
        return self._wrenches(a, gravity=True)[BODY_JOINT - 1]

    def _wrenches(self, a: Array, gravity: bool) -> list[Array]:
        """Return the wrench on each link with its descendants, in the link's frame, each (..., n, 6)."""
        rates: list[tuple[Array, Array]] = []  # twist and its derivative, along each link's own axes
        wrenches: list[Array] = []
        ground = np.zeros((*a.shape[:-1], 6))
        free_fall = ground - np.append(self.fall, np.zeros(3)) if gravity else ground  # the ground rises
        for link in self.links:
            twist, rate = rates[link.parent] if link.parent >= 0 else (ground, free_fall)
            relative = apply(link.S, self.v[:, link.columns])
            w = _move_twist(link.T, twist) + relative
            dw = _move_twist(link.T, rate) + apply(link.S, a[..., link.columns]) + _twist_rate(w, relative)
            rates.append((w, dw))
            wrenches.append(sum((_inertial_wrench(body, w, dw) for body in link.bodies), 0 * ground))
        for link, wrench in zip(reversed(self.links), reversed(wrenches), strict=True):
            if link.parent >= 0:
                wrenches[link.parent] += _move_wrench(link.T, wrench)
        return wrenches

    def moved_masses(self) -> tuple[Array, Array, Array]:
        """Return for each coordinate the moved mass (nv,) and second moment (n, nv), and the reach (n,) [m].

        The second moment of the mass is about the joint; for a prismatic joint, it is the mass. The reach is
        the largest distance from the body's origin to a joint or a centre of mass.
        """
        poses: list[Array] = []
        subtree: list[list[int]] = [[] for _ in self.links]
        for k, link in enumerate(self.links):
            poses.append(link.T if link.parent < 0 else poses[link.parent] @ link.T)
            ancestor = k
            while ancestor >= 0:
                subtree[ancestor].append(k)
                ancestor = self.links[ancestor].parent
        placed_bodies = [
            [(m, (T @ np.append(com, 1.0))[:, :3], np.trace(inertia) / 2) for m, com, inertia in link.bodies]
            for T, link in zip(poses, self.links, strict=True)
        ]
        masses, K = np.zeros(self.nv), np.zeros((self.count, self.nv))
        for k, link in enumerate(self.links):
            bodies = [body for j in subtree[k] for body in placed_bodies[j]]
            mass = sum(m for m, _, _ in bodies)
            moment = sum(
                (m * np.square(com - poses[k][:, :3, 3]).sum(-1) + spread for m, com, spread in bodies),
                np.zeros(self.count),
            )
            for column, S in zip(link.columns, np.moveaxis(link.S, -1, 0), strict=True):
                masses[column] = mass
                K[:, column] = np.where(S[:, 3:].any(-1), moment, mass)
        origin = poses[BODY_JOINT - 1][:, :3, 3]
        points = [com for bodies in placed_bodies for _, com, _ in bodies] + [T[:, :3, 3] for T in poses]
        return masses, K, np.linalg.norm(np.stack(points) - origin, axis=-1).max(0)


def _file_configurations(model: pin.Model, q: Array) -> Array:
    """Return configurations with one number per joint in the form of a file's model, shape (n, nq)."""
    parts, column = [q[:, :0]], 0
    for joint in joints_of(model):
        entry = q[:, column : column + joint.nq - joint.continuous]
        parts.append(np.hstack([np.cos(entry), np.sin(entry)]) if joint.continuous else entry)
        column += entry.shape[1]
    return np.hstack(parts)


def _joint_states(model: pin.Model, joint: int, foot: pin.SE3, q: Array) -> tuple[Array, Array]:
    """Return T and S of one joint, with its placement relative to `foot`, for each state."""
    kind, placement = model.joints[joint], foot * model.jointPlacements[joint]
    data, T, S = kind.createData(), [], []
    for configuration in q:
        kind.calc(data, configuration)
        T.append((placement * data.M).homogeneous)
        S.append(np.reshape(data.S, (6, -1)))
    return np.stack(T), np.stack(S)


def _inertial_wrench(body: tuple[float, Array, Array], w: Array, dw: Array) -> Array:
    """Return the force and the moment about the link's origin for a motion of a body, shape (..., 6)."""
    mass, com, inertia = body
    omega, alpha = w[..., 3:], dw[..., 3:]
    acceleration = dw[..., :3] + _vector_product(omega, w[..., :3])
    force = mass * (
        acceleration + _vector_product(alpha, com) + _vector_product(omega, _vector_product(omega, com))
    )
    moment = alpha @ inertia.T + _vector_product(omega, omega @ inertia.T)
    return _concatenate([force, moment + _vector_product(com, force)])


def _move_twist(T: Array, twist: Array) -> Array:
    """Return a twist at the origin and along the axes of a frame with pose T."""
    R, p = T[..., :3, :3], T[..., :3, 3]
    velocity = twist[..., :3] + _vector_product(twist[..., 3:], p)
    R_T = np.swapaxes(R, -1, -2)
    return _concatenate([apply(R_T, velocity), apply(R_T, twist[..., 3:])])


def _move_wrench(T: Array, wrench: Array) -> Array:
    """Return a wrench in a frame with pose T as a wrench in the parent's frame."""
    R, p = T[..., :3, :3], T[..., :3, 3]
    force = apply(R, wrench[..., :3])
    return _concatenate([force, apply(R, wrench[..., 3:]) + _vector_product(p, force)])


def _twist_rate(w: Array, twist: Array) -> Array:
    """Return the rate of a twist that is constant in a frame with angular velocity w."""
    linear = _vector_product(w[..., 3:], twist[..., :3]) + _vector_product(w[..., :3], twist[..., 3:])
    return _concatenate([linear, _vector_product(w[..., 3:], twist[..., 3:])])


def _concatenate(parts: list[Array]) -> Array:
    return np.concatenate(parts, axis=-1)


def _vector_product(a: Array, b: Array) -> Array:
    """Return a x b, shape (..., 3), with the bits of np.cross but faster."""
    return np.asarray(a.take(_NEXT, -1) * b.take(_LAST, -1) - a.take(_LAST, -1) * b.take(_NEXT, -1))


def apply(matrices: Array, vectors: Array) -> Array:
    """Return the products of matrices and vectors along the last axes."""
    return np.asarray(np.einsum("...ij,...j->...i", matrices, vectors))


def max_ratio(difference: Array, scale: Array) -> float:
    """Return the largest difference, relative to a scale."""
    return float((np.abs(difference) / scale).max(initial=0.0))


def composite_body(robot: MobileRobot, q: Array) -> dict[str, Array]:
    """Return mass, yaw inertia and centre of mass of the robot with locked arms, at each configuration."""
    bodies = [robot.with_locked_arms(row) for row in q]
    values = ((body.mass, body.yaw_inertia, body.com[:2]) for body in bodies)
    return dict(zip(("mass", "yaw_inertia", "com"), map(np.array, zip(*values, strict=True)), strict=True))


def rotors(wheeled: WheeledRobot) -> Array:
    """Return the contribution of motor rotors to the mass matrix, shape (nv, nv)."""
    inertia, first = np.zeros((wheeled.nv, wheeled.nv)), wheeled.robot.nv
    for actuator in wheeled.table.actuators:
        column, motor = np.array(actuator.column), actuator.motor
        inertia[first:, first:] += motor.gear**2 * motor.rotor_inertia * np.outer(column, column)
    return inertia


def tree_motion(
    wheeled: WheeledRobot, q: Array, v: Array, a: Array
) -> tuple[tuple[Array, Array, Array], Array]:
    """Return configurations, velocities and accelerations of the tree of joints, shape (n, ...) each, and G.

    In the tree, each steered wheel has a separate angle before the wheel. Wheels with common steering share
    one coordinate: v_tree = G v.
    """
    table, nv, shape = wheeled.table, wheeled.robot.nv, q.shape[:-1]
    ns, axis_of = len(table.axes), {row: k for k, axis in enumerate(table.axes) for row in axis.wheels}
    steering, kinematics = list(np.moveaxis(q[..., nv : nv + ns], -1, 0)), Kinematics.of(table)
    size = nv + len(axis_of) + len(table)
    G, (tree_q, bias) = np.zeros((*shape, size, v.shape[-1])), np.zeros((2, *shape, size))
    G[..., np.arange(nv), np.arange(nv)], tree_q[..., :nv] = 1, q[..., :nv]
    column = nv
    for row, wheel in enumerate(table.wheels):
        if row in axis_of:
            k = axis_of[row]
            c, s, first, second = (number(x) for x in kinematics.heading(row, steering))
            e = np.cos(wheel.angle), np.sin(wheel.angle)
            tree_q[..., column] = np.arctan2(s * e[0] - c * e[1], c * e[0] + s * e[1])
            G[..., column, nv + k], bias[..., column] = first, second * v[..., nv + k] ** 2
            column += 1
        G[..., column, nv + ns + row], tree_q[..., column] = 1, q[..., nv + ns + row]
        column += 1
    return (tree_q, apply(G, v), apply(G, a) + bias), G


class _WheelState(NamedTuple):
    """Wheel at n states, along the body's axes.

    Attributes
    ----------
    e : ndarray, shape (n, 2)
        Rolling direction.
    o, p : ndarray, shape (n, 2)
        Centre relative to the pivot, and relative to the body's origin [m].
    steer, spin : int
        Coordinates in the tree; `steer` is -1 for a wheel without steering.
    """

    e: Array
    o: Array
    p: Array
    steer: int
    spin: int


class WheelBodies:
    """Bodies of a robot on wheels at n states.

    Parameters
    ----------
    wheeled : WheeledRobot
        Robot; this class reads its `robot`, `table` and `ground`.
    q, v : ndarray, shape (n, nq) and (n, nv)
        States.
    weightless : bool
        Whether gravity is zero.
    """

    def __init__(self, wheeled: WheeledRobot, q: Array, v: Array, *, weightless: bool = False) -> None:
        robot, self.table = wheeled.robot, wheeled.table
        self.nv, self.ns, self.size = robot.nv, len(wheeled.table.axes), v.shape[1]
        g = float(np.linalg.norm(robot.model.gravity.linear))
        ramp = wheeled.ground.ramp
        fall = np.array([0.0, 0.0, -g]) if ramp is None else ramp.fall(g)
        self.fall = 0.0 * fall if weightless else fall
        self._motion = partial(tree_motion, wheeled, q, v)
        (tree_q, rates, _), self.G = self._motion(0 * v)
        self.parts = Parts(robot, tree_q, rates, self.fall)
        self.c, self.s = np.cos(q[:, 2]), np.sin(q[:, 2])
        self.wheels = list[_WheelState]()
        column = self.nv
        for row, wheel in enumerate(self.table.wheels):
            parent, steer, heading = BODY_JOINT - 1, -1, np.full(len(q), wheel.angle)
            if any(row in axis.wheels for axis in self.table.axes):
                steer, heading = column, heading + tree_q[:, column]
                column += 1
            e = np.column_stack([np.cos(heading), np.sin(heading)])
            o = wheel.trail[0] * e + wheel.trail[1] * _rotate_left(e)
            p = o + np.array([wheel.x, wheel.y])
            self.wheels.append(_WheelState(e, o, p, steer, column))
            hub = _pose(2, heading, np.column_stack([p, np.full(len(q), wheel.radius)]))
            if steer >= 0:
                pivot = np.tile([wheel.x, wheel.y, wheel.radius], (len(q), 1))
                self.parts.links.append(_Link(parent, _pose(2, heading, pivot), self._axis(5), [steer]))
                parent, hub = len(self.parts.links) - 1, _pose(2, 0 * heading, np.array([*wheel.trail, 0.0]))
            T = hub @ _pose(1, tree_q[:, column], np.zeros(3))
            inertia = np.diag([wheel.yaw_inertia, wheel.spin_inertia, wheel.yaw_inertia])
            body = wheel.mass, np.zeros(3), inertia
            self.parts.links.append(_Link(parent, T, self._axis(4), [column], bodies=[body]))
            # The body includes the wheels at rest; subtract them, since they are separate bodies.
            lever = np.array([*wheel.centre, wheel.radius])
            self.parts.links[BODY_JOINT - 1].bodies.append((-wheel.mass, lever, -_locked_inertia(wheel)))
            column += 1
        self.reflected = rotors(wheeled)

    def _axis(self, k: int) -> Array:
        return np.tile(np.eye(6)[:, [k]], (len(self.c), 1, 1))

    def wrench(self, a: Array) -> Array:
        """Return the wrench that accelerates the whole robot, in the body frame, shape (n, 6)."""
        return self.parts.ground_wrench(self._motion(a)[0][2])

    def forces(self, a: Array) -> Array:
        """Return the generalised forces for these accelerations, shape (..., n, nv of the whole)."""
        tree = self.parts.forces(self._motion(a)[0][2])
        return apply(np.swapaxes(self.G, -1, -2), tree) + a @ self.reflected

    def contact(self, forward: Array, lateral: Array) -> Array:
        """Return the generalised force of the ground's forces on the wheels, shape (n, nv of the whole).

        Parameters
        ----------
        forward, lateral : ndarray, shape (n, wheels)
            Forces along a tyre and to its left; for a wheel with rollers, along the axis of the roller at the
            ground and across this axis [N].
        """
        tau = np.zeros(self.G.shape[:2])
        for row, wheel in enumerate(self.wheels):
            gamma = self.table.wheels[row].roller or 0.0
            d = np.cos(gamma) * wheel.e + np.sin(gamma) * _rotate_left(wheel.e)
            force = forward[:, row, None] * d + lateral[:, row, None] * _rotate_left(d)
            tau[:, 0] += self.c * force[:, 0] - self.s * force[:, 1]
            tau[:, 1] += self.s * force[:, 0] + self.c * force[:, 1]
            tau[:, 2] += _moment(wheel.p, force)
            if wheel.steer >= 0:
                tau[:, wheel.steer] += _moment(wheel.o, force)
            tau[:, wheel.spin] -= self.table.wheels[row].radius * np.einsum("ni,ni->n", force, wheel.e)
        return apply(np.swapaxes(self.G, -1, -2), tau)

    def trains(self) -> Array:
        """Return the rows of gear trains, r (ratio phi_1' - phi_k'), shape (pairs, nv of the whole)."""
        rows, wheels = np.zeros((len(self.table.trains), self.size)), self.nv + self.ns
        for matrix_row, (first, row, ratio) in zip(rows, self.table.trains, strict=True):
            radius = self.table.wheels[first].radius
            matrix_row[wheels + first], matrix_row[wheels + row] = radius * ratio, -radius
        return rows

    def moved_masses(self) -> tuple[Array, Array, Array]:
        """Return the moved mass (nv,), its second moment (n, nv), and the reach (n,) [m], by coordinate."""
        masses, K, reach = self.parts.moved_masses()
        masses, K = (self.G[0] != 0).T @ masses, np.einsum("nki,nk->ni", self.G**2, K)
        K += self.reflected.diagonal()
        radii = np.array([wheel.radius for wheel in self.table.wheels])
        masses[self.nv + self.ns :] += K[0, self.nv + self.ns :] / radii**2
        return masses, K, reach


def _pose(axis: int, angle: Array, p: Array) -> Array:
    """Return the poses of frames that are rotated about y or z, shape (n, 4, 4)."""
    T = np.tile(np.eye(4), (len(angle), 1, 1))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T[:, i, i] = T[:, j, j] = np.cos(angle)
    T[:, j, i] = np.sin(angle)
    T[:, i, j] = -T[:, j, i]
    T[:, :3, 3] = p
    return T


def _locked_inertia(wheel: Wheel) -> Array:
    """Return the inertia of a wheel about its centre at the table's angle, along the body's axes."""
    R = pin.utils.rotate("z", wheel.angle)
    return np.asarray(R @ np.diag([wheel.yaw_inertia, wheel.spin_inertia, wheel.yaw_inertia]) @ R.T)


def _rotate_left(x: Array) -> Array:
    """Return z x x, the vector rotated by a quarter turn to the left."""
    return np.stack([-x[..., 1], x[..., 0]], axis=-1)


def _moment(p: Array, force: Array) -> Array:
    """Return the moment of a force at p about the vertical."""
    return np.asarray(p[:, 0] * force[:, 1] - p[:, 1] * force[:, 0])
