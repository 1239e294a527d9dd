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
        arm, on_base = mount.arm, BODY_JOINT - 1
        whole, built, held, rest = arm.file_model, arm.whole, arm.fixed_joints, arm.rest
        if mount.is_changed:  # to numbers which are those of what moves
            whole, built, held, rest = mount.model, mount.model, [], arm.posture
        free = [joint for joint in range(1, whole.njoints) if joint not in held]
        own_q = np.array(np.broadcast_to(rest, (self.count, len(rest))))
        own_q[:, [built.idx_qs[joint] for joint in free]] = q[:, mount.q]
        own_q = _file_configurations(whole, own_q)
        columns = {joint: [k] for k, joint in enumerate(free, mount.v.start)}
        self.links[on_base].add(whole.inertias[0], mount.placement)
        first = len(self.links) - 1  # joint 1 of the arm is the next link
        for joint in range(1, whole.njoints):
            above, mine = whole.parents[joint], columns.get(joint, [])
            foot = mount.placement if above == 0 else pin.SE3.Identity()
            T, S = _moved(whole, joint, foot, own_q)
            rotors = np.array(whole.armature)[whole.idx_vs[joint] :][: len(mine)]
            link = _Link(first + above if above else on_base, T, S[..., : len(mine)], mine, rotors)
            link.add(whole.inertias[joint], pin.SE3.Identity())
            self.links.append(link)
        own = add_scope(mount.model, mount.name)
        for name, k in named_frames(own).items():
            frame = own.frames[k]
            on_arm = first + free[frame.parentJoint - 1] if frame.parentJoint else on_base
            placement = frame.placement if frame.parentJoint else mount.placement * frame.placement
            self._frames[name] = on_arm, placement

    def forces(self, a: Array, *, gravity: bool = True) -> Array:
        """Return the generalised forces for these states and accelerations, shape (..., n, nv)."""
        tau = np.zeros((*a.shape[:-1], self.nv))
        for link, wrench in zip(self.links, self._wrenches(a, gravity), strict=True):
            own = times(np.swapaxes(link.S, -1, -2), wrench)
            tau[..., link.columns] = own + link.rotors * a[..., link.columns]
        return tau

    def ground_wrench(self, a: Array) -> Array:
        """Return the ground's wrench in the body frame, about its origin, shape (n, 6)."""
        return self._wrenches(a, gravity=True)[BODY_JOINT - 1]

    def _wrenches(self, a: Array, gravity: bool) -> list[Array]:
        """Return the wrench on each link with its descendants, in the link's frame, each (..., n, 6)."""
        rates: list[tuple[Array, Array]] = []  # twist and its derivative, along each link's own axes
        wrenches: list[Array] = []
        ground = np.zeros((*a.shape[:-1], 6))
        lifted = ground - np.append(self.fall, np.zeros(3)) if gravity else ground  # the ground rises
        for link in self.links:
            twist, rate = rates[link.parent] if link.parent >= 0 else (ground, lifted)
            own = times(link.S, self.v[:, link.columns])
            w = _seen(link.T, twist) + own
            dw = _seen(link.T, rate) + times(link.S, a[..., link.columns]) + _cross(w, own)
            rates.append((w, dw))
            wrenches.append(sum((_inertial(body, w, dw) for body in link.bodies), 0 * ground))
        for link, wrench in zip(reversed(self.links), reversed(wrenches), strict=True):
            if link.parent >= 0:
                wrenches[link.parent] += _carried(link.T, wrench)
        return wrenches

    def beyond(self) -> tuple[Array, Array, Array]:
        """Return for each coordinate the moved mass (nv,) and second moment (n, nv), and the reach (n,) [m].

        The second moment of the mass is about the joint; for a prismatic joint, it is the mass. The reach is
        the largest distance from the body's origin to a joint or a centre of mass.
        """
        poses: list[Array] = []
        subtree: list[list[int]] = [[] for _ in self.links]
        for k, link in enumerate(self.links):
            poses.append(link.T if link.parent < 0 else poses[link.parent] @ link.T)
            above = k
            while above >= 0:
                subtree[above].append(k)
                above = self.links[above].parent
        placed = [
            [(m, (T @ np.append(com, 1.0))[:, :3], np.trace(inertia) / 2) for m, com, inertia in link.bodies]
            for T, link in zip(poses, self.links, strict=True)
        ]
        masses, K = np.zeros(self.nv), np.zeros((self.count, self.nv))
        for k, link in enumerate(self.links):
            bodies = [body for j in subtree[k] for body in placed[j]]
            mass = sum(m for m, _, _ in bodies)
            moment = sum(
                (m * np.square(com - poses[k][:, :3, 3]).sum(-1) + spread for m, com, spread in bodies),
                np.zeros(self.count),
            )
            for column, S in zip(link.columns, np.moveaxis(link.S, -1, 0), strict=True):
                masses[column] = mass
                K[:, column] = np.where(S[:, 3:].any(-1), moment, mass)
        origin = poses[BODY_JOINT - 1][:, :3, 3]
        points = [com for bodies in placed for _, com, _ in bodies] + [T[:, :3, 3] for T in poses]
        return masses, K, np.linalg.norm(np.stack(points) - origin, axis=-1).max(0)


def _file_configurations(model: pin.Model, q: Array) -> Array:
    """Return configurations with one number per joint in the form of a file's model, shape (n, nq)."""
    parts, at = [q[:, :0]], 0
    for joint in joints_of(model):
        own = q[:, at : at + joint.nq - joint.continuous]
        parts.append(np.hstack([np.cos(own), np.sin(own)]) if joint.continuous else own)
        at += own.shape[1]
    return np.hstack(parts)


def _moved(model: pin.Model, joint: int, foot: pin.SE3, q: Array) -> tuple[Array, Array]:
    """Return T and S of one joint, with its placement relative to `foot`, for each state."""
    kind, place = model.joints[joint], foot * model.jointPlacements[joint]
    data, T, S = kind.createData(), [], []
    for own in q:
        kind.calc(data, own)
        T.append((place * data.M).homogeneous)
        S.append(np.reshape(data.S, (6, -1)))
    return np.stack(T), np.stack(S)


def _inertial(body: tuple[float, Array, Array], w: Array, dw: Array) -> Array:
    """Return the force and the moment about the link's origin for a motion of a body, shape (..., 6)."""
    mass, com, inertia = body
    omega, alpha = w[..., 3:], dw[..., 3:]
    at_origin = dw[..., :3] + _vector_product(omega, w[..., :3])
    force = mass * (
        at_origin + _vector_product(alpha, com) + _vector_product(omega, _vector_product(omega, com))
    )
    moment = alpha @ inertia.T + _vector_product(omega, omega @ inertia.T)
    return _stacked([force, moment + _vector_product(com, force)])


def _seen(T: Array, twist: Array) -> Array:
    """Return a twist at the origin and along the axes of a frame with pose T."""
    R, p = T[..., :3, :3], T[..., :3, 3]
    velocity = twist[..., :3] + _vector_product(twist[..., 3:], p)
    turned = np.swapaxes(R, -1, -2)
    return _stacked([times(turned, velocity), times(turned, twist[..., 3:])])


def _carried(T: Array, wrench: Array) -> Array:
    """Return a wrench in a frame with pose T as a wrench in the parent's frame."""
    R, p = T[..., :3, :3], T[..., :3, 3]
    force = times(R, wrench[..., :3])
    return _stacked([force, times(R, wrench[..., 3:]) + _vector_product(p, force)])


def _cross(w: Array, twist: Array) -> Array:
    """Return the rate of a twist that is constant in a frame with angular velocity w."""
    linear = _vector_product(w[..., 3:], twist[..., :3]) + _vector_product(w[..., :3], twist[..., 3:])
    return _stacked([linear, _vector_product(w[..., 3:], twist[..., 3:])])


def _stacked(parts: list[Array]) -> Array:
    return np.concatenate(parts, axis=-1)


def _vector_product(a: Array, b: Array) -> Array:
    """Return a x b, shape (..., 3), with the bits of np.cross but faster."""
    return np.asarray(a.take(_NEXT, -1) * b.take(_LAST, -1) - a.take(_LAST, -1) * b.take(_NEXT, -1))


def times(matrices: Array, vectors: Array) -> Array:
    """Return the products of matrices and vectors along the last axes."""
    return np.asarray(np.einsum("...ij,...j->...i", matrices, vectors))


def off_by(difference: Array, scale: Array) -> float:
    """Return the largest difference, relative to a scale."""
    return float((np.abs(difference) / scale).max(initial=0.0))


def composite_body(robot: MobileRobot, q: Array) -> dict[str, Array]:
    """Return mass, yaw inertia and centre of mass of the robot with locked arms, at each configuration."""
    lumps = [robot.with_locked_arms(row) for row in q]
    found = ((lump.mass, lump.yaw_inertia, lump.com[:2]) for lump in lumps)
    return dict(zip(("mass", "yaw_inertia", "com"), map(np.array, zip(*found, strict=True)), strict=True))


def reflected(wheeled: WheeledRobot) -> Array:
    """Return the contribution of motor rotors to the mass matrix, shape (nv, nv)."""
    found, first = np.zeros((wheeled.nv, wheeled.nv)), wheeled.robot.nv
    for actuator in wheeled.table.actuators:
        own, motor = np.array(actuator.column), actuator.motor
        found[first:, first:] += motor.gear**2 * motor.rotor_inertia * np.outer(own, own)
    return found


def tree_motion(
    wheeled: WheeledRobot, q: Array, v: Array, a: Array
) -> tuple[tuple[Array, Array, Array], Array]:
    """Return configurations, velocities and accelerations of the tree of joints, shape (n, ...) each, and G.

    In the tree, each steered wheel has a separate angle before the wheel. Wheels with common steering share
    one coordinate: v_tree = G v.
    """
    table, nv, lead = wheeled.table, wheeled.robot.nv, q.shape[:-1]
    ns, steered = len(table.axes), {row: k for k, axis in enumerate(table.axes) for row in axis.wheels}
    steering, kinematics = list(np.moveaxis(q[..., nv : nv + ns], -1, 0)), Kinematics.of(table)
    size = nv + len(steered) + len(table)
    G, (whole, bent) = np.zeros((*lead, size, v.shape[-1])), np.zeros((2, *lead, size))
    G[..., np.arange(nv), np.arange(nv)], whole[..., :nv] = 1, q[..., :nv]
    at = nv
    for row, wheel in enumerate(table.wheels):
        if row in steered:
            k = steered[row]
            c, s, first, second = (number(x) for x in kinematics.heading(row, steering))
            own = np.cos(wheel.angle), np.sin(wheel.angle)
            whole[..., at] = np.arctan2(s * own[0] - c * own[1], c * own[0] + s * own[1])
            G[..., at, nv + k], bent[..., at] = first, second * v[..., nv + k] ** 2
            at += 1
        G[..., at, nv + ns + row], whole[..., at] = 1, q[..., nv + ns + row]
        at += 1
    return (whole, times(G, v), times(G, a) + bent), G


class _Placed(NamedTuple):
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
        (whole, rates, _), self.G = self._motion(0 * v)
        self.parts = Parts(robot, whole, rates, self.fall)
        self.c, self.s = np.cos(q[:, 2]), np.sin(q[:, 2])
        self.wheels = list[_Placed]()
        column = self.nv
        for row, wheel in enumerate(self.table.wheels):
            parent, steer, heading = BODY_JOINT - 1, -1, np.full(len(q), wheel.angle)
            if any(row in axis.wheels for axis in self.table.axes):
                steer, heading = column, heading + whole[:, column]
                column += 1
            e = np.column_stack([np.cos(heading), np.sin(heading)])
            o = wheel.trail[0] * e + wheel.trail[1] * _quarter(e)
            p = o + np.array([wheel.x, wheel.y])
            self.wheels.append(_Placed(e, o, p, steer, column))
            hub = _pose(2, heading, np.column_stack([p, np.full(len(q), wheel.radius)]))
            if steer >= 0:
                pivot = np.tile([wheel.x, wheel.y, wheel.radius], (len(q), 1))
                self.parts.links.append(_Link(parent, _pose(2, heading, pivot), self._axis(5), [steer]))
                parent, hub = len(self.parts.links) - 1, _pose(2, 0 * heading, np.array([*wheel.trail, 0.0]))
            spun = hub @ _pose(1, whole[:, column], np.zeros(3))
            inertia = np.diag([wheel.yaw_inertia, wheel.spin_inertia, wheel.yaw_inertia])
            body = wheel.mass, np.zeros(3), inertia
            self.parts.links.append(_Link(parent, spun, self._axis(4), [column], bodies=[body]))
            # The body includes the wheels at rest; subtract them, since they are separate bodies.
            lever = np.array([*wheel.centre, wheel.radius])
            self.parts.links[BODY_JOINT - 1].bodies.append((-wheel.mass, lever, -_locked(wheel)))
            column += 1
        self.reflected = reflected(wheeled)

    def _axis(self, k: int) -> Array:
        return np.tile(np.eye(6)[:, [k]], (len(self.c), 1, 1))

    def wrench(self, a: Array) -> Array:
        """Return the wrench that accelerates the whole robot, in the body frame, shape (n, 6)."""
        return self.parts.ground_wrench(self._motion(a)[0][2])

    def forces(self, a: Array) -> Array:
        """Return the generalised forces for these accelerations, shape (..., n, nv of the whole)."""
        tree = self.parts.forces(self._motion(a)[0][2])
        return times(np.swapaxes(self.G, -1, -2), tree) + a @ self.reflected

    def contact(self, along: Array, across: Array) -> Array:
        """Return the generalised force of the ground's forces on the wheels, shape (n, nv of the whole).

        Parameters
        ----------
        along, across : ndarray, shape (n, wheels)
            Forces along a tyre and to its left; for a wheel with rollers, along the axis of the roller at the
            ground and across this axis [N].
        """
        tau = np.zeros(self.G.shape[:2])
        for row, at in enumerate(self.wheels):
            gamma = self.table.wheels[row].roller or 0.0
            d = np.cos(gamma) * at.e + np.sin(gamma) * _quarter(at.e)
            force = along[:, row, None] * d + across[:, row, None] * _quarter(d)
            tau[:, 0] += self.c * force[:, 0] - self.s * force[:, 1]
            tau[:, 1] += self.s * force[:, 0] + self.c * force[:, 1]
            tau[:, 2] += _crossed(at.p, force)
            if at.steer >= 0:
                tau[:, at.steer] += _crossed(at.o, force)
            tau[:, at.spin] -= self.table.wheels[row].radius * np.einsum("ni,ni->n", force, at.e)
        return times(np.swapaxes(self.G, -1, -2), tau)

    def trains(self) -> Array:
        """Return the rows of gear trains, r (ratio phi_1' - phi_k'), shape (pairs, nv of the whole)."""
        found, wheels = np.zeros((len(self.table.trains), self.size)), self.nv + self.ns
        for line, (first, row, ratio) in zip(found, self.table.trains, strict=True):
            radius = self.table.wheels[first].radius
            line[wheels + first], line[wheels + row] = radius * ratio, -radius
        return found

    def moving(self) -> tuple[Array, Array, Array]:
        """Return the moved mass (nv,), its second moment (n, nv), and the reach (n,) [m], by coordinate."""
        masses, K, reach = self.parts.beyond()
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


def _locked(wheel: Wheel) -> Array:
    """Return the inertia of a wheel about its centre at the table's angle, along the body's axes."""
    R = pin.utils.rotate("z", wheel.angle)
    return np.asarray(R @ np.diag([wheel.yaw_inertia, wheel.spin_inertia, wheel.yaw_inertia]) @ R.T)


def _quarter(x: Array) -> Array:
    """Return z x x, the vector rotated by a quarter turn to the left."""
    return np.stack([-x[..., 1], x[..., 0]], axis=-1)


def _crossed(p: Array, force: Array) -> Array:
    """Return the moment of a force at p about the vertical."""
    return np.asarray(p[:, 0] * force[:, 1] - p[:, 1] * force[:, 0])
