"""Recursions over the joints of a robot: over scalars of any type, and by Pinocchio, state by state.

The algorithms over scalars follow Featherstone (2008), see `linkage`. Vectors are in the frame of each joint.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import isfinite, prod
from threading import local
from typing import Any

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, broadcast, finite_answer, vector
from pinmobile.robot.linkage import (
    BODY_JOINT,
    ONE,
    ZERO,
    Body,
    Linkage,
    Matrix,
    Placement,
    Vector,
    add,
    applied,
    cross,
    dot,
    exact,
    factor,
    plus,
    rotate_tensor,
    scale,
    sine_and_cosine,
    symmetric,
    transpose,
)
from pinmobile.robot.mounts import Mount


class LinkageKinematics:
    """Linkage at a configuration.

    Parameters
    ----------
    linkage : Linkage
        Tree of joints.
    places : sequence of Placement
        Placement of each joint's frame in its parent's frame, for a zero coordinate.
    q : list of scalars
        Configuration.
    """

    def __init__(self, linkage: Linkage, places: Sequence[Placement], q: Vector) -> None:
        self.linkage, self.R = linkage, [place.R for place in places]
        self.back = [transpose(R) for R in self.R]
        self.angles: list[tuple[Any, Any] | None] = []  # sine and cosine for revolute joints
        self.p: list[Vector] = []  # origins
        for i, (R, p) in enumerate(places):
            self.angles.append(sine_and_cosine(q[i]) if linkage.turns[i] else None)
            self.p.append(p if linkage.turns[i] else plus(p, [row[2] * q[i] for row in R]))

    def to_child(self, i: int, x: Vector) -> Vector:
        """Return a vector of the parent's frame in the frame of joint i."""
        x, angle = applied(self.back[i], x), self.angles[i]
        if angle is None:
            return x
        s, c = angle
        return [c * x[0] + s * x[1], c * x[1] - s * x[0], x[2]]

    def to_parent(self, i: int, x: Vector) -> Vector:
        """Return a vector of the frame of joint i in the parent's frame."""
        angle = self.angles[i]
        if angle is not None:
            s, c = angle
            x = [c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]]
        return applied(self.R[i], x)

    def tensor_to_parent(self, i: int, J: Matrix) -> Matrix:
        """Return a symmetric matrix of the frame of joint i in the parent's frame."""
        angle = self.angles[i]
        if angle is not None:
            s, c = angle
            xy, d = J[0][1], s * (J[0][0] - J[1][1])
            two_xy = c * xy
            change = s * (d + (two_xy + two_xy))
            J = symmetric(
                [
                    J[0][0] - change,
                    J[1][1] + change,
                    J[2][2],
                    c * d + xy * (c * c - s * s),
                    c * J[0][2] - s * J[1][2],
                    s * J[0][2] + c * J[1][2],
                ]
            )
        return rotate_tensor(self.R[i], J)

    def ancestors(self, i: int) -> list[int]:
        """Return joint i and its ancestors, up to the root."""
        joints = []
        while i >= 0:
            joints.append(i)
            i = self.linkage.parents[i]
        return joints

    def placement(self, i: int, place: Placement) -> Placement:
        """Return the placement of a frame, fixed to joint i, in the world."""
        columns, p = transpose(place.R), place.p
        for j in self.ancestors(i):
            columns, p = [self.to_parent(j, x) for x in columns], plus(self.p[j], self.to_parent(j, p))
        return Placement(transpose(columns), p)

    def jacobian(self, i: int, p: Vector) -> Matrix:
        """Return the Jacobian of a point fixed to joint i: velocity and angular velocity, 6 rows of n."""
        columns, ancestors, z = [[ZERO] * 6 for _ in self.R], self.ancestors(i), [ZERO, ZERO, ONE]
        for k, j in enumerate(ancestors):
            way, turn = ([-p[1], p[0], ZERO], z) if self.linkage.turns[j] else (z, [ZERO] * 3)
            for parent in ancestors[k:]:
                way, turn = self.to_parent(parent, way), self.to_parent(parent, turn)
            columns[j] = [*way, *turn]
            p = plus(self.p[j], self.to_parent(j, p))
        return transpose(columns)

    def first_moment(self, bodies: Sequence[Body]) -> Vector:
        """Return mass times centre of mass of all bodies, in the world."""
        masses, moments = [body.mass for body in bodies], [body.first for body in bodies]
        total = [ZERO] * 3
        for i in reversed(range(len(self.R))):
            moment = plus(self.to_parent(i, moments[i]), scale(masses[i], self.p[i]))
            parent = self.linkage.parents[i]
            if parent >= 0:
                masses[parent], moments[parent] = masses[parent] + masses[i], plus(moments[parent], moment)
            else:
                total = plus(total, moment)
        return total

    def mass_matrix(self, bodies: Sequence[Body]) -> Matrix:
        """Return M, in the order of the joints, by the composite-rigid-body algorithm."""
        linkage, n = self.linkage, len(self.R)
        composite, M = list(bodies), [[ZERO] * n for _ in range(n)]
        for i in reversed(range(n)):
            m, h, J = composite[i]
            if linkage.turns[i]:
                force, moment = [-h[1], h[0], ZERO], [row[2] for row in J]
            else:
                force, moment = [ZERO, ZERO, m], [h[1], -h[0], ZERO]
            for j in self.ancestors(i):
                M[i][j] = M[j][i] = moment[2] if linkage.turns[j] else force[2]
                if linkage.parents[j] >= 0:
                    force = self.to_parent(j, force)
                    moment = plus(self.to_parent(j, moment), cross(self.p[j], force))
            parent = linkage.parents[i]
            if parent >= 0:
                body = Body(m, self.to_parent(i, h), self.tensor_to_parent(i, J))
                composite[parent] = composite[parent].merge(body.shift(self.p[i]))
        return M


class LinkageDynamics(LinkageKinematics):
    """A linkage at a configuration and a velocity."""

    def __init__(self, linkage: Linkage, places: Sequence[Placement], q: Vector, v: Vector) -> None:
        super().__init__(linkage, places, q)
        self.v = v
        self.w: list[Vector] = []  # angular velocities
        for i, parent in enumerate(linkage.parents):
            w = self.to_child(i, self.w[parent]) if parent >= 0 else [ZERO] * 3
            self.w.append([w[0], w[1], w[2] + self.v[i]] if linkage.turns[i] else w)

    def efforts(self, bodies: Sequence[Body], a: Vector, falling: bool = True) -> Vector:
        """Return forces and torques of the joints for given accelerations, by the Newton-Euler recursion.

        `falling` is whether gravity acts.
        """
        wrenches = zip(*self.wrenches(bodies, a, falling), self.linkage.turns, strict=True)
        return [moment[2] if turns else force[2] for force, moment, turns in wrenches]

    def wrenches(
        self, bodies: Sequence[Body], a: Vector, falling: bool = True
    ) -> tuple[list[Vector], list[Vector]]:
        """Return each joint's wrench on all bodies beyond: force, and moment about the joint's origin."""
        forces, moments = self._inertial(bodies, a, falling)
        for i in reversed(range(len(self.R))):
            parent = self.linkage.parents[i]
            if parent >= 0:
                force = self.to_parent(i, forces[i])
                moment = plus(self.to_parent(i, moments[i]), cross(self.p[i], force))
                forces[parent], moments[parent] = plus(forces[parent], force), plus(moments[parent], moment)
        return forces, moments

    def _inertial(
        self, bodies: Sequence[Body], a: Vector, falling: bool
    ) -> tuple[list[Vector], list[Vector]]:
        """Return the force that accelerates each body alone, and the moment about the origin of its frame."""
        forces, moments = [], []
        for (m, h, J), w, (line, spin, field) in zip(bodies, self.w, self._fields(a, falling), strict=True):
            forces.append(plus(scale(m, line), applied(field, h)))
            turning = plus(applied(J, spin), cross(w, applied(J, w)))
            moments.append(plus(turning, cross(h, line)))
        return forces, moments

    def _fields(self, a: Vector, falling: bool) -> list[tuple[Vector, Vector, Matrix]]:
        """Return each joint's proper acceleration of its origin, its angular acceleration, and its field.

        The field is the matrix that maps the position of a point on the joint to its acceleration relative to
        the origin.
        """
        linkage = self.linkage
        fields: list[tuple[Vector, Vector, Matrix]] = []
        for i, parent in enumerate(linkage.parents):
            if parent < 0:
                spin = [ZERO] * 3
                line = [exact(-g) for g in linkage.gravity.tolist()] if falling else [ZERO] * 3
            else:
                line, spin, field = fields[parent]
                line = plus(line, applied(field, self.p[i]))
            spin, line = self.to_child(i, spin), self.to_child(i, line)
            w, rate = self.w[i], self.v[i]
            if linkage.turns[i]:
                spin = [spin[0] + w[1] * rate, spin[1] - w[0] * rate, spin[2] + a[i]]
            else:
                double = rate + rate
                line = [line[0] + w[1] * double, line[1] - w[0] * double, line[2] + a[i]]
            fields.append((line, spin, _field(w, spin)))
        return fields

    def drift(self, i: int, p: Vector) -> tuple[Vector, Vector]:
        """Return the bias acceleration of a point fixed to joint i, and of its frame."""
        line, spin, field = self._fields([ZERO] * len(self.R), False)[i]
        line = plus(line, applied(field, p))
        for j in self.ancestors(i):
            line, spin = self.to_parent(j, line), self.to_parent(j, spin)
        return line, spin

    def accelerations(self, bodies: Sequence[Body], rotors: Vector, efforts: Vector) -> Vector:
        """Return the accelerations of the joints by the mass matrix, factored from the leaves of the tree."""
        n = len(efforts)
        bias, M = self.efforts(bodies, [ZERO] * n), self.mass_matrix(bodies)
        for i, rotor in enumerate(rotors):
            M[i][i] = M[i][i] + rotor
        right = [effort - bias_k for effort, bias_k in zip(efforts, bias, strict=True)]
        return factor(M)[0](right)

    def regressor(self, axes: Sequence[Matrix], first: int, a: Vector) -> list[Vector]:
        """Return the regressor for the ten parameters of each body, beginning with joint `first`.

        The parameters are m, m c, and xx, xy, yy, xz, yz, zz of the inertia about the origin of the joint's
        frame. They are along axes in which this frame has the orientation from `axes`.
        """
        linkage, n = self.linkage, len(self.R)
        rows = [[ZERO] * (10 * (n - first)) for _ in range(n)]
        fields = self._fields(a, True)
        ways: list[dict[int, tuple[Vector, Vector]]] = []  # motion of the frame of joint i by joint j
        for i, parent in enumerate(linkage.parents):
            zeros, z = [ZERO] * 3, [ZERO, ZERO, ONE]
            motions = {i: (zeros, z) if linkage.turns[i] else (z, zeros)}
            for j, (line, turn) in (ways[parent] if parent >= 0 else {}).items():
                motions[j] = self.to_child(i, plus(line, cross(turn, self.p[i]))), self.to_child(i, turn)
            ways.append(motions)
            if i >= first:
                w, line, spin = (applied(axes[i], x) for x in (self.w[i], *fields[i][:2]))
                field = transpose(_field(w, spin))
                for j, way in motions.items():
                    axis, turn = (applied(axes[i], x) for x in way)
                    numbers = [dot(axis, line), *plus(applied(field, axis), cross(line, turn))]
                    pairs = zip((turn, cross(turn, w)), (spin, w), strict=True)
                    squares = [[[x * y for y in right] for x in left] for left, right in pairs]
                    Q = add(*squares)
                    numbers += [Q[0][0], Q[0][1] + Q[1][0], Q[1][1]]
                    numbers += [Q[0][2] + Q[2][0], Q[1][2] + Q[2][1], Q[2][2]]
                    rows[j][10 * (i - first) : 10 * (i - first) + 10] = numbers
        return rows


def _field(w: Vector, spin: Vector) -> Matrix:
    """Return [spin x] + [w x]^2."""
    xx, yy, zz = (x * x for x in w)
    xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
    return [
        [-(yy + zz), xy - spin[2], xz + spin[1]],
        [xy + spin[2], -(xx + zz), yz - spin[0]],
        [xz - spin[1], yz + spin[0], -(xx + yy)],
    ]


class UncheckedDynamics:
    """Unchecked functions of one state in public order, for use in the thread that created the object.

    The functions accept only float64 arrays of shape (nv,). The next call of any function overwrites earlier
    results, except accelerations: copy results that you keep. All other attributes are those of the robot.

    Parameters
    ----------
    robot : System
        Robot.
    engine : PinocchioBackend
        Pinocchio backend of the robot.

    Attributes
    ----------
    mass_matrix, nonlinear_effects, inverse_dynamics, gravity : callable
        M(q), n(q, v), tau(q, v, a) and g(q).
    integrate : callable
        Function of q and dq that returns the configuration q + dq.
    pose, pose_rate : callable
        Functions of q, and of q and v, that return the body's pose and its rate, shape (3,).
    generalized_force : callable
        Function of q and a wrench, shape (3,), that returns the generalised force, shape (nv,).

    See Also
    --------
    MobileRobot.dynamics : property that returns this object
    vectorize : compile a function for many states

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot
    >>> dynamics = MobileRobot.lecture().dynamics  # once, before the loop
    >>> dynamics.forward_dynamics(np.zeros(3), np.zeros(3), np.ones(3))
    array([ 0.0333,  0.0333, 10.    ])
    """

    def __init__(self, robot: Any, engine: PinocchioBackend) -> None:
        data, public = engine.data, engine.public
        zeros = np.zeros(engine.nv - BODY_JOINT)
        self._robot = robot
        self.nq = self.nv = self.nu = engine.nv
        self.mass_matrix = partial(pin.crba, public, data)
        self.nonlinear_effects = partial(pin.nonLinearEffects, public, data)
        self.inverse_dynamics = partial(pin.rnea, public, data)
        self.gravity = partial(pin.computeGeneralizedGravity, public, data)
        self.integrate = np.add
        self.pose = lambda q: q[:BODY_JOINT]
        self.pose_rate = lambda q, v: v[:BODY_JOINT]
        self.generalized_force = lambda q, wrench: np.concatenate([wrench, zeros]) if len(zeros) else wrench
        self._accelerations = partial(pin.aba, public, data)

    def forward_dynamics(self, q: Array, v: Array, u: Array, f: Array | None = None) -> Array:
        """Return the acceleration, shape (nv,) [m/s^2, m/s^2, rad/s^2, ...].

        Parameters
        ----------
        q, v : ndarray, shape (nv,)
            Configuration and velocity.
        u : ndarray, shape (nv,)
            Input, a generalised force [N, N, N m, ...].
        f : ndarray, shape (nv,), optional
            External generalised force [N, N, N m, ...].
        """
        return np.array(self._accelerations(q, v, u if f is None else u + f))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)


class _Workspace(local):
    """One `pin.Data` per thread, made at the first access and freed with the thread."""

    def __init__(self, model: pin.Model) -> None:
        self.data = model.createData()


class PinocchioBackend:
    """Pinocchio calls for any number of threads: threads share the model, and each thread has its own data.

    Parameters
    ----------
    model : pin.Model
        Chain with prismatic y and prismatic x as the first two joints, with the body and its arms.

    Attributes
    ----------
    public : pin.Model
        The same model in public order, (x, y, psi, ...). Only its virtual links move differently.
    order : ndarray, shape (nv,)
        Public index of each coordinate of the chain. The permutation swaps two entries, so it is its own
        inverse.
    """

    def __init__(self, model: pin.Model) -> None:
        self.model, self.public, self._workspace = model, in_public_order(model), _Workspace(model)
        self.nv = int(model.nv)
        self.order = np.array([1, 0, *range(2, self.nv)])

    @property
    def data(self) -> pin.Data:
        """Pinocchio's workspace of the current thread."""
        return self._workspace.data

    def each(self, law: Callable[..., Any], chain: bool = False, /, **arguments: ArrayLike) -> Array:
        """Return ``law(model, data, *row)`` for each row of the arguments, shape (..., ...).

        Parameters
        ----------
        law : callable
            Function of one state. Its result is copied.
        chain : bool
            Whether to use the chain's model and the chain's order of coordinates.
        **arguments : array_like, shape (..., nv)
            Arguments in public order; leading axes broadcast.

        Raises
        ------
        InvalidArgument
            If an argument has another last axis, or is not finite.
        NotFinite
            If a result is not finite.
        """
        model, data = self.model if chain else self.public, self.data
        arrays = {name: vector(name, x, self.nv) for name, x in arguments.items()}
        given = [x[..., self.order] if chain else x for x in arrays.values()]
        lead = broadcast(**arrays)
        if not lead:
            answer = np.array(law(model, data, *given))
            return answer if isfinite(np.vdot(answer, answer)) else finite_answer(answer, **arrays)
        n = prod(lead)
        columns = [np.broadcast_to(x, (*lead, self.nv)).reshape(n, self.nv) for x in given]
        if not n:
            return np.empty((*lead, *np.shape(law(model, data, *np.zeros((len(given), self.nv))))))
        rows = [np.array(law(model, data, *row)) for row in zip(*columns, strict=True)]
        return finite_answer(np.stack(rows).reshape((*lead, *rows[0].shape)), **arrays)

    def composite(self, q: Array) -> pin.Inertia:
        """Return the composite inertia of the body and its arms, in the body frame, at a public q."""
        model, data = self.public, self.data
        pin.forwardKinematics(model, data, q)
        total = pin.Inertia(model.inertias[BODY_JOINT])
        to_body = data.oMi[BODY_JOINT].inverse()
        for joint in range(BODY_JOINT + 1, model.njoints):
            total += (to_body * data.oMi[joint]).act(model.inertias[joint])
        return total


def in_public_order(model: pin.Model) -> pin.Model:
    """Return the model of the same robot on a chain with x as the first joint and y as the second.

    Translations commute: P1 Ty P2 Tx P3 = (P1 P2) Tx (P1 P2)^-1 P1 Ty (P2 P3). The joints have the same
    types, so one `pin.Data` serves both models.
    """
    public = model.copy()
    first, second, third = (model.jointPlacements[joint] for joint in range(1, BODY_JOINT + 1))
    placements = first * second, (first * second).inverse() * first, second * third
    for joint, placement in enumerate(placements, 1):
        public.jointPlacements[joint] = placement
    return public


def frame_pose(number: int, model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Return the pose of a frame."""
    pin.forwardKinematics(model, data, q)
    return np.asarray(pin.updateFramePlacement(model, data, number).homogeneous)


def frame_jacobian(number: int, model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Return the Jacobian of a frame of the chain's model, with columns in public order."""
    J = pin.computeFrameJacobian(model, data, q, number, pin.LOCAL_WORLD_ALIGNED)
    return np.asarray(J[:, [1, 0, *range(2, model.nv)]])


def frames_of(
    robot: Any, names: Sequence[str]
) -> tuple[Callable[[Array], list[pin.SE3]], Callable[[], list[Array]]]:
    """Return two unchecked functions for one thread: poses of frames at q, and then their Jacobians there.

    Parameters
    ----------
    robot : System
        Robot.
    names : sequence of str
        Names of frames, see `MobileRobot.frame_jacobian`.
    """
    engine, numbers = robot._numeric, [robot._frame(name)[1] for name in names]
    model, data, swap = engine.model, engine.data, np.eye(engine.nv)[engine.order]

    def poses(q: Array) -> list[pin.SE3]:
        pin.forwardKinematics(model, data, q @ swap)
        return [pin.updateFramePlacement(model, data, k) for k in numbers]

    def jacobians() -> list[Array]:
        pin.computeJointJacobians(model, data)
        return [pin.getFrameJacobian(model, data, k, pin.LOCAL_WORLD_ALIGNED) @ swap for k in numbers]

    return poses, jacobians


def frame_bias_acceleration(number: int, model: pin.Model, data: pin.Data, q: Array, v: Array) -> Array:
    """Return the bias acceleration of a frame."""
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    motion = pin.getFrameClassicalAcceleration(model, data, number, pin.LOCAL_WORLD_ALIGNED)
    return np.asarray(motion.vector)


def manipulability(number: int, part: slice, model: pin.Model, data: pin.Data, q: Array) -> float:
    """Return sqrt(det J J') of a frame, for the columns of J in a slice."""
    J = frame_jacobian(number, model, data, q)[:, part]
    # The product of singular values keeps digits that det(J J') loses by squaring.
    return float(np.linalg.svd(J, compute_uv=False).prod()) if J.shape[1] >= len(J) else 0.0


def joint_placements(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Return the poses of the frames of all joints."""
    pin.forwardKinematics(model, data, q)
    return np.stack([data.oMi[k].homogeneous for k in range(1, model.njoints)])


def kinetic_energy(model: pin.Model, data: pin.Data, q: Array, v: Array) -> Any:
    """Return v' M v / 2 with rotors; Pinocchio's function omits rotors of joints about arbitrary axes."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.vdot(v, pin.crba(model, data, q) @ v) / 2


def regressor(model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array) -> Array:
    """Return the regressor without the columns of the virtual links, which have no mass."""
    return np.asarray(pin.computeJointTorqueRegressor(model, data, q, v, a)[:, 10 * (BODY_JOINT - 1) :])


def derivatives(model: pin.Model, data: pin.Data, q: Array, v: Array, tau: Array) -> Array:
    """Return the derivatives of the acceleration with respect to q, v and tau, stacked."""
    return np.stack(pin.computeABADerivatives(model, data, q, v, tau))


def ground_wrench(model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array) -> Array:
    """Return the wrench of the ground on the body."""
    pin.rnea(model, data, q, v, a)
    return np.asarray(data.f[BODY_JOINT].vector)


def mount_wrench(
    mount: Mount, fixed: pin.Inertia, model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array
) -> Array:
    """Return the wrench of an arm on the body; `fixed` is the inertia of its parts fixed to the body."""
    pin.rnea(model, data, q, v, a)
    twist = data.v[BODY_JOINT]
    wrench = fixed * data.a_gf[BODY_JOINT] + twist.cross(fixed * twist)
    for joint in range(mount.joints.start, mount.joints.stop):
        if model.parents[joint] == BODY_JOINT:
            wrench += data.liMi[joint].act(data.f[joint])
    to_mount = pin.SE3(np.eye(3), np.array(mount.at[:3])).inverse()
    return 0.0 - np.asarray(to_mount.act(wrench).vector)
