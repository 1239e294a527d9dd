"""Pinocchio's functions of a robot's state, evaluated state by state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import isfinite, prod
from threading import local
from typing import Any

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, broadcast, finite_answer, vector
from pinmobile.robot.linkage import BODY_JOINT
from pinmobile.robot.mounts import Mount


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
    MobileRobot.law : property that returns this object
    vectorize : compile a function for many states

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot
    >>> law = MobileRobot.lecture().law  # once, before the loop
    >>> law.forward_dynamics(np.zeros(3), np.zeros(3), np.ones(3))
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
