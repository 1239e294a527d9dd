"""A robot as its parts say: body, arms and loads by their own numbers, moved by Newton's and Euler's laws.

Nothing of the model that they are assembled into is read, so that what is wrong there is seen. The recursion
is that of Luh, Walker and Paul (1980) in NumPy: velocities and accelerations from the ground outwards, F = m
a and N = I alpha + omega x I omega of each body about its centre of mass, and the forces back inwards. Of
each of an arm's joints Pinocchio says how it moves by itself; of the base's the DH table does.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.dh import JointType
from pinmobile.robot import BODY_JOINT, MobileRobot, Mount, joints_of, named_frames, prefixed
from pinmobile.wheels import AckermannSteering, GearTrain, Wheel, WheeledRobot

_DOWN = np.array([0, 0, -9.81])  # [m/s^2]
_POSE = ("x", "y", "psi")
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # of x, y, z the other two


@dataclass
class _Link:
    """What moves as one, at n states.

    Parameters
    ----------
    parent : int
        Index of the link that it hangs on; -1: the ground.
    T : ndarray, shape (n, 4, 4)
        Its pose in the parent's frame.
    S : ndarray, shape (n, 6, m)
        Its twist against the parent, linear and angular, along its own axes, for each of its coordinates.
    columns : sequence of m int
        Where its coordinates are in v.
    rotors : ndarray, shape (m,)
        Inertia of the rotors, as the joint feels it [kg m^2].
    bodies : list of (float, ndarray, ndarray)
        Mass, centre of mass and inertia about that of each body on it, in its frame.
    """

    parent: int
    T: Array
    S: Array
    columns: list[int]
    rotors: Array
    bodies: list[tuple[float, Array, Array]] = field(default_factory=list)

    def add(self, body: pin.Inertia, placement: pin.SE3) -> None:
        """Add a body that is given in a frame at `placement` on the link."""
        R, p = placement.rotation, placement.translation
        self.bodies.append((float(body.mass), p + R @ body.lever, R @ body.inertia @ R.T))


class Parts:
    """The links of a robot at n states.

    Parameters
    ----------
    robot : MobileRobot
        Whose `body`, `mounts` and `loads` are read, and nothing else.
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
            links.append(_Link(k - 1, transforms[:, k], S, [order[k]], np.zeros(1)))
        return links

    def _mount(self, mount: Mount, q: Array) -> None:
        """Add the links of an arm as it was read; a joint that is locked has no coordinates."""
        arm, on_base = mount.arm, BODY_JOINT - 1
        whole, built, held, rest = arm.file_model, arm.whole, arm.held(), arm.rest
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
        own = prefixed(mount.model, mount.name)
        for name, number in named_frames(own).items():
            frame = own.frames[number]
            on_arm = first + free[frame.parentJoint - 1] if frame.parentJoint else on_base
            placement = frame.placement if frame.parentJoint else mount.placement * frame.placement
            self._frames[name] = on_arm, placement

    def forces(self, a: Array, *, gravity: bool = True) -> Array:
        """Return the generalised forces that these states and accelerations ask for, shape (n, nv)."""
        tau = np.zeros((self.count, self.nv))
        for link, wrench in zip(self.links, self._wrenches(a, gravity), strict=True):
            own = _times(link.S.transpose(0, 2, 1), wrench)
            tau[:, link.columns] = own + link.rotors * a[:, link.columns]
        return tau

    def ground_wrench(self, a: Array) -> Array:
        """Return what the ground exerts, in the body's frame and about its origin, shape (n, 6)."""
        return self._wrenches(a, gravity=True)[BODY_JOINT - 1]

    def _wrenches(self, a: Array, gravity: bool) -> list[Array]:
        """Return what moves each link and all that hangs on it, in its own frame, shape (n, 6) each."""
        rates: list[tuple[Array, Array]] = []  # twist and its derivative, along each link's own axes
        wrenches: list[Array] = []
        ground = np.zeros((self.count, 6))
        lifted = ground - np.append(self.fall, np.zeros(3)) if gravity else ground  # as if the ground rose
        for link in self.links:
            twist, rate = rates[link.parent] if link.parent >= 0 else (ground, lifted)
            own = _times(link.S, self.v[:, link.columns])
            w = _seen(link.T, twist) + own
            dw = _seen(link.T, rate) + _times(link.S, a[:, link.columns]) + _cross(w, own)
            rates.append((w, dw))
            wrenches.append(sum((_inertial(body, w, dw) for body in link.bodies), np.zeros((self.count, 6))))
        for link, wrench in zip(reversed(self.links), reversed(wrenches), strict=True):
            if link.parent >= 0:
                wrenches[link.parent] += _carried(link.T, wrench)
        return wrenches

    def beyond(self) -> tuple[Array, Array, Array]:
        """Return what each coordinate moves: mass (nv,), second moment (n, nv), and the reach (n,) [m].

        The second moment is that of the mass about the joint, or the mass itself where the joint slides; the
        reach is the largest distance from the body's origin to a joint or a centre of mass.
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
    """Return configurations with one number for each joint as a file's own model has them, shape (n, nq)."""
    parts, at = [q[:, :0]], 0
    for joint in joints_of(model):
        own = q[:, at : at + joint.nq - joint.continuous]
        parts.append(np.hstack([np.cos(own), np.sin(own)]) if joint.continuous else own)
        at += own.shape[1]
    return np.hstack(parts)


def _moved(model: pin.Model, joint: int, foot: pin.SE3, q: Array) -> tuple[Array, Array]:
    """Return T and S of one joint by itself, whose place is seen from `foot`, for each state."""
    kind, place = model.joints[joint], foot * model.jointPlacements[joint]
    data, T, S = kind.createData(), [], []
    for own in q:
        kind.calc(data, own)
        T.append((place * data.M).homogeneous)
        S.append(np.reshape(data.S, (6, -1)))
    return np.stack(T), np.stack(S)


def _inertial(body: tuple[float, Array, Array], w: Array, dw: Array) -> Array:
    """Return the force and the moment about the link's origin that move a body so, shape (n, 6)."""
    mass, com, inertia = body
    omega, alpha = w[:, 3:], dw[:, 3:]
    at_origin = dw[:, :3] + _vector_product(omega, w[:, :3])
    force = mass * (
        at_origin + _vector_product(alpha, com) + _vector_product(omega, _vector_product(omega, com))
    )
    moment = alpha @ inertia.T + _vector_product(omega, omega @ inertia.T)
    return np.hstack([force, moment + _vector_product(com, force)])


def _seen(T: Array, twist: Array) -> Array:
    """Return a twist at the origin and along the axes of a frame with pose T."""
    R, p = T[:, :3, :3], T[:, :3, 3]
    velocity = twist[:, :3] + _vector_product(twist[:, 3:], p)
    turned = R.transpose(0, 2, 1)
    return np.hstack([_times(turned, velocity), _times(turned, twist[:, 3:])])


def _carried(T: Array, wrench: Array) -> Array:
    """Return a wrench in a frame with pose T as the parent feels it."""
    R, p = T[:, :3, :3], T[:, :3, 3]
    force = _times(R, wrench[:, :3])
    return np.hstack([force, _times(R, wrench[:, 3:]) + _vector_product(p, force)])


def _cross(w: Array, twist: Array) -> Array:
    """Return the rate of a twist that is fixed in a frame which itself moves with w."""
    linear = _vector_product(w[:, 3:], twist[:, :3]) + _vector_product(w[:, :3], twist[:, 3:])
    return np.hstack([linear, _vector_product(w[:, 3:], twist[:, 3:])])


def _vector_product(a: Array, b: Array) -> Array:
    """Return a x b, shape (..., 3): np.cross to the last bit, without its search for the axes."""
    return np.asarray(a.take(_NEXT, -1) * b.take(_LAST, -1) - a.take(_LAST, -1) * b.take(_NEXT, -1))


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))


class _Moving(NamedTuple):
    """A wheel at n states, all along the body's axes.

    Attributes
    ----------
    e, n : ndarray, shape (k, 2)
        Where it rolls to, and its axle.
    o, p : ndarray, shape (k, 2)
        Its centre from its pivot, and from the body's origin [m].
    axis : int
        Its steering coordinate; -1: none.
    first, turn, changing : ndarray, shape (k,)
        Its steering angle's rate per rate of that coordinate, its rate, and the part of the rate's derivative
        that is there where the coordinate does not accelerate.
    """

    e: Array
    n: Array
    o: Array
    p: Array
    axis: int
    first: Array
    turn: Array
    changing: Array


class WheelBodies:
    """The bodies of a robot on wheels at n states.

    Parameters
    ----------
    wheeled : WheeledRobot
        Whose `robot`, `table` and `ground` are read.
    q, v : ndarray, shape (n, nq) and (n, nv)
        States.
    weightless : bool
        Whether there is no gravity.
    """

    def __init__(self, wheeled: WheeledRobot, q: Array, v: Array, *, weightless: bool = False) -> None:
        robot, self.table = wheeled.robot, wheeled.table
        nv, self.ns = robot.nv, len(wheeled.table.axes)
        g = float(np.linalg.norm(robot.model.gravity.linear))
        ramp = wheeled.ground.ramp
        fall = np.array([0.0, 0.0, -g]) if ramp is None else ramp.fall(g)
        self.fall = 0.0 * fall if weightless else fall
        self.parts = Parts(robot, q[:, :nv], v[:, :nv], self.fall)
        self.beyond = self.parts.beyond()
        self.c, self.s, self.nv = np.cos(q[:, 2]), np.sin(q[:, 2]), nv
        self.twist = np.column_stack([self._along(v), v[:, 2]])
        self.rates = v[:, nv:]
        self.wheels = [self._moving(row, q[:, nv : nv + self.ns]) for row in range(len(self.table))]
        self.reflected = np.zeros((self.rates.shape[1], self.rates.shape[1]))
        for actuator in self.table.actuators:
            column, rotor = np.array(actuator.column), actuator.motor.gear**2 * actuator.motor.rotor_inertia
            self.reflected += rotor * np.outer(column, column)
        for (
            wheel
        ) in self.table.wheels:  # the whole has them, at rest in the body: they are bodies of their own
            lever, inertia = np.array([*wheel.centre, wheel.radius]), _locked(wheel)
            self.parts.links[BODY_JOINT - 1].bodies.append((-wheel.mass, lever, -inertia))

    def _along(self, x: Array) -> Array:
        """Return the first two entries of each row along the body's axes."""
        return np.column_stack([self.c * x[:, 0] + self.s * x[:, 1], self.c * x[:, 1] - self.s * x[:, 0]])

    def _inertial(self, x: Array) -> Array:
        return np.column_stack([self.c * x[:, 0] - self.s * x[:, 1], self.s * x[:, 0] + self.c * x[:, 1]])

    def _moving(self, row: int, steering: Array) -> _Moving:
        wheel = self.table.wheels[row]
        axis = next((k for k, each in enumerate(self.table.axes) if row in each.wheels), -1)
        still = np.zeros(len(steering))
        angle, first, second, rate = still, still, still, still
        if axis >= 0:
            angle, first, rate = steering[:, axis], still + 1, self.rates[:, axis]
        for each in self.table.couplings:
            if isinstance(each, AckermannSteering) and wheel.name in each.wheels:
                # cot(angle) = cot(coordinate) - k, whose squared sines have `first` as ratio.
                k, c, s = wheel.y / (wheel.x - each.axle), np.cos(angle), np.sin(angle)
                first = 1 / (s**2 + (c - k * s) ** 2)
                second = -2 * (s * c - (c - k * s) * (s + k * c)) * first**2
                angle = np.arctan2(s, c - k * s)
        angle = angle + wheel.angle
        e = np.column_stack([np.cos(angle), np.sin(angle)])
        n = _quarter(e)
        o = wheel.trail[0] * e + wheel.trail[1] * n
        return _Moving(e, n, o, o + np.array([wheel.x, wheel.y]), axis, first, first * rate, second * rate**2)

    def _wrenches(self, a: Array) -> list[tuple[Array, Array]]:
        """Return for each wheel the force (k, 3) that moves it, and the moment (k, 3) about its centre."""
        found = []
        origin, pull = self._along(a), self._along(np.broadcast_to(self.fall, (len(a), 3)))
        w, alpha = self.twist[:, 2:], a[:, 2:3]
        for row, (wheel, at) in enumerate(zip(self.table.wheels, self.wheels, strict=True)):
            turning = alpha[:, 0] + at.changing
            if at.axis >= 0:
                turning = turning + at.first * a[:, self.nv + at.axis]
            whole = w + at.turn[:, None]
            pivot = at.p - at.o
            moved = origin + alpha * _quarter(pivot) - w**2 * pivot
            moved = moved + turning[:, None] * _quarter(at.o) - whole**2 * at.o
            force = np.column_stack(
                [wheel.mass * (moved - pull), np.full(len(a), -wheel.mass * self.fall[2])]
            )
            spin, faster = self.rates[:, self.ns + row, None], a[:, self.nv + self.ns + row, None]
            flat = wheel.spin_inertia * (faster * at.n - spin * whole * at.e)
            found.append((force, np.column_stack([flat, wheel.yaw_inertia * turning])))
        return found

    def wrench(self, a: Array) -> Array:
        """Return what moves the whole, along the body's axes and about its origin, shape (n, 6)."""
        total = self.parts.ground_wrench(a[:, : self.nv])
        for wheel, at, (force, moment) in zip(self.table.wheels, self.wheels, self._wrenches(a), strict=True):
            arm = np.column_stack([at.p, np.full(len(a), wheel.radius)])
            total = total + np.hstack([force, moment + np.cross(arm, force)])
        return total

    def forces(self, a: Array) -> Array:
        """Return the generalised forces that these accelerations ask for, shape (n, nv of the whole)."""
        tau = np.zeros_like(a)
        tau[:, : self.nv] = self.parts.forces(a[:, : self.nv])
        total = self.wrench(a)
        tau[:, :2], tau[:, 2] = self._inertial(total), total[:, 5]
        tau[:, self.nv :] = a[:, self.nv :] @ self.reflected
        for row, (at, (force, moment)) in enumerate(zip(self.wheels, self._wrenches(a), strict=True)):
            if at.axis >= 0:
                about = moment[:, 2] + _crossed(at.o, force)
                tau[:, self.nv + at.axis] += at.first * about
            tau[:, self.nv + self.ns + row] += np.einsum("ni,ni->n", moment[:, :2], at.n)
        return tau

    def contact(self, along: Array, across: Array) -> Array:
        """Return the generalised force of the ground's forces on the wheels, shape (n, nv of the whole).

        Parameters
        ----------
        along, across : ndarray, shape (n, wheels)
            Of a tyre along it and to its left; of a wheel with rollers along the axis of the one at
            the ground, and across that [N].
        """
        tau = np.zeros((len(along), self.nv + self.rates.shape[1]))
        for row, at in enumerate(self.wheels):
            gamma = self.table.wheels[row].roller or 0.0
            d = np.cos(gamma) * at.e + np.sin(gamma) * at.n
            force = along[:, row, None] * d + across[:, row, None] * _quarter(d)
            tau[:, :2] += self._inertial(force)
            tau[:, 2] += _crossed(at.p, force)
            if at.axis >= 0:
                tau[:, self.nv + at.axis] += at.first * _crossed(at.o, force)
            spun = self.table.wheels[row].radius * np.einsum("ni,ni->n", force, at.e)
            tau[:, self.nv + self.ns + row] -= spun
        return tau

    def trains(self) -> Array:
        """Return the rows of gear trains, r (ratio phi_1' - phi_k'), shape (pairs, nv of the whole)."""
        names, rows = self.table.names, []
        for train in self.table.couplings:
            if isinstance(train, GearTrain):
                first = names.index(train.wheels[0])
                radius = self.table.wheels[first].radius
                for name, ratio in zip(train.wheels[1:], train.ratios[1:], strict=True):
                    row = np.zeros(self.nv + self.rates.shape[1])
                    row[self.nv + self.ns + first] = radius * ratio / train.ratios[0]
                    row[self.nv + self.ns + names.index(name)] = -radius
                    rows.append(row)
        return np.reshape(rows, (len(rows), self.nv + self.rates.shape[1]))

    def moving(self) -> tuple[Array, Array, Array]:
        """Return what each coordinate moves: mass (nv,), second moment (n, nv), and the reach (n,) [m]."""
        masses, K, reach = self.beyond
        first = self.nv + self.ns
        masses = np.append(masses, np.zeros(self.rates.shape[1]))
        K = np.hstack([K, np.zeros((len(K), self.rates.shape[1]))])
        for row, (wheel, at) in enumerate(zip(self.table.wheels, self.wheels, strict=True)):
            if at.axis >= 0:
                k = self.nv + at.axis
                masses[k] += wheel.mass
                K[:, k] += at.first**2 * (
                    wheel.yaw_inertia + wheel.mass * np.square(np.array(wheel.trail)).sum()
                )
            own = wheel.spin_inertia + self.reflected[self.ns + row, self.ns + row]
            masses[first + row] = wheel.mass + own / wheel.radius**2
            K[:, first + row] = own
        return masses, K, reach


def _locked(wheel: Wheel) -> Array:
    """Return the inertia of a wheel about its centre at the table's angle, along the body's axes."""
    c, s = np.cos(wheel.angle), np.sin(wheel.angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return np.asarray(R @ np.diag([wheel.yaw_inertia, wheel.spin_inertia, wheel.yaw_inertia]) @ R.T)


def _quarter(x: Array) -> Array:
    """Return z x x: a quarter of a turn to the left."""
    return np.stack([-x[..., 1], x[..., 0]], axis=-1)


def _crossed(p: Array, force: Array) -> Array:
    """Return the moment of a force at p about the vertical."""
    return np.asarray(p[:, 0] * force[:, 1] - p[:, 1] * force[:, 0])
