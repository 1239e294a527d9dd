"""Laws of a robot's state by Pinocchio, one state after another."""

from __future__ import annotations

from collections.abc import Callable
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
    """Unchecked functions of one state in public order, for the thread alone that asked for them.

    For loops that run millions of times: they take float64 arrays of shape (nv,), and nothing else. What one
    returns, but for accelerations, is overwritten by the next call of any of them: copy what is kept. All
    else is that of the robot.

    Parameters
    ----------
    robot : System
        The robot.
    engine : PinocchioBackend
        Of it.

    Attributes
    ----------
    mass_matrix, nonlinear_effects, inverse_dynamics, gravity : callable
        M(q), n(q, v), tau(q, v, a) and g(q).
    integrate : callable
        The configuration after a displacement, of q and dq.
    pose, pose_rate : callable
        Those of the body, shape (3,): of q, and of q and v.
    generalized_force : callable
        The generalised force, shape (nv,), of q and a wrench (3,).
    """

    def __init__(self, robot: Any, engine: PinocchioBackend) -> None:
        data, public = engine.data, engine.public
        still = np.zeros(engine.nv - BODY_JOINT)
        self._robot = robot
        self.nq = self.nv = self.nu = engine.nv
        self.mass_matrix = partial(pin.crba, public, data)
        self.nonlinear_effects = partial(pin.nonLinearEffects, public, data)
        self.inverse_dynamics = partial(pin.rnea, public, data)
        self.gravity = partial(pin.computeGeneralizedGravity, public, data)
        self.integrate = np.add
        self.pose = lambda q: q[:BODY_JOINT]
        self.pose_rate = lambda q, v: v[:BODY_JOINT]
        self.generalized_force = lambda q, wrench: np.concatenate([wrench, still]) if len(still) else wrench
        self._accelerations = partial(pin.aba, public, data)

    def forward_dynamics(self, q: Array, v: Array, u: Array, f: Array | None = None) -> Array:
        """Return the acceleration, shape (nv,)."""
        return np.array(self._accelerations(q, v, u if f is None else u + f))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)


class _Workspace(local):
    """A `pin.Data` for each thread, made when it first asks; it goes away with the thread."""

    def __init__(self, model: pin.Model) -> None:
        self.data = model.createData()


class PinocchioBackend:
    """Pinocchio calls for any number of threads: the model is only read, and each thread has its own data.

    Parameters
    ----------
    model : pin.Model
        Chain whose first two joints are prismatic y and prismatic x, and what rides on the body.

    Attributes
    ----------
    public : pin.Model
        The same in public order, (x, y, psi, ...); its virtual links move otherwise.
    order : ndarray, shape (nv,)
        Public index of each coordinate of the chain. Swapping two, it is its own inverse.
    """

    def __init__(self, model: pin.Model) -> None:
        self.model, self.public, self._workspace = model, in_public_order(model), _Workspace(model)
        self.nv = int(model.nv)
        self.order = np.array([1, 0, *range(2, self.nv)])

    @property
    def data(self) -> pin.Data:
        """What Pinocchio writes into, this thread's own."""
        return self._workspace.data

    def each(self, law: Callable[..., Any], chain: bool = False, /, **arguments: ArrayLike) -> Array:
        """Return what ``law(model, data, *row)`` gives for each row of the arguments, shape (..., ...).

        Parameters
        ----------
        law : callable
            Of one state of the model in public order; what it returns is copied.
        chain : bool
            Whether it is of the chain's model, and rows are in the chain's order.
        **arguments : array_like, shape (..., nv)
            In public order; leading axes broadcast.

        Raises
        ------
        InvalidArgument
            If an argument has another last axis, or is not finite.
        NotFinite
            If an answer is not finite.
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
        """Return the inertia of the body and all that rides on it, in the body's frame, at a public q."""
        model, data = self.public, self.data
        pin.forwardKinematics(model, data, q)
        total = pin.Inertia(model.inertias[BODY_JOINT])
        to_body = data.oMi[BODY_JOINT].inverse()
        for joint in range(BODY_JOINT + 1, model.njoints):
            total += (to_body * data.oMi[joint]).act(model.inertias[joint])
        return total


def in_public_order(model: pin.Model) -> pin.Model:
    """Return the same body on a chain whose first joint is x and whose second is y.

    Translations commute: P1 Ty P2 Tx P3 = (P1 P2) Tx (P1 P2)^-1 P1 Ty (P2 P3). The joints are of the same
    kinds, so one `pin.Data` serves both models.
    """
    public = model.copy()
    first, second, third = (model.jointPlacements[joint] for joint in range(1, BODY_JOINT + 1))
    swapped = first * second, (first * second).inverse() * first, second * third
    for joint, placement in enumerate(swapped, 1):
        public.jointPlacements[joint] = placement
    return public


def frame_pose(number: int, model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Return the pose of a frame."""
    pin.forwardKinematics(model, data, q)
    return np.asarray(pin.updateFramePlacement(model, data, number).homogeneous)


def frame_jacobian(number: int, model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Return the Jacobian of a frame, its columns in public order where the model is the chain's."""
    J = pin.computeFrameJacobian(model, data, q, number, pin.LOCAL_WORLD_ALIGNED)
    return np.asarray(J[:, [1, 0, *range(2, model.nv)]])


def frame_drift(number: int, model: pin.Model, data: pin.Data, q: Array, v: Array) -> Array:
    """Return the acceleration of a frame where no coordinate accelerates."""
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    found = pin.getFrameClassicalAcceleration(model, data, number, pin.LOCAL_WORLD_ALIGNED)
    return np.asarray(found.vector)


def manipulability(number: int, part: slice, model: pin.Model, data: pin.Data, q: Array) -> float:
    """Return sqrt(det J J') of a frame, of the columns of J that are a part."""
    J = frame_jacobian(number, model, data, q)[:, part]
    # The product of the singular values: det squares what is small.
    return float(np.linalg.svd(J, compute_uv=False).prod()) if J.shape[1] >= len(J) else 0.0


def joint_placements(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Return the poses of the frames of all joints."""
    pin.forwardKinematics(model, data, q)
    return np.stack([data.oMi[k].homogeneous for k in range(1, model.njoints)])


def kinetic_energy(model: pin.Model, data: pin.Data, q: Array, v: Array) -> Any:
    """Return v' M v / 2; Pinocchio's own leaves out the motors of joints about an axis of their own."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.vdot(v, pin.crba(model, data, q) @ v) / 2


def regressor(model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array) -> Array:
    """Return the regressor without the columns of what is not there: the virtual links."""
    return np.asarray(pin.computeJointTorqueRegressor(model, data, q, v, a)[:, 10 * (BODY_JOINT - 1) :])


def derivatives(model: pin.Model, data: pin.Data, q: Array, v: Array, tau: Array) -> Array:
    """Return the derivatives of the acceleration by q, v and tau, one after the other."""
    return np.stack(pin.computeABADerivatives(model, data, q, v, tau))


def ground_wrench(model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array) -> Array:
    """Return what the ground exerts on the body."""
    pin.rnea(model, data, q, v, a)
    return np.asarray(data.f[BODY_JOINT].vector)


def mount_wrench(
    mount: Mount, fixed: pin.Inertia, model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array
) -> Array:
    """Return what an arm exerts on the body; `fixed` is its inertia that does not move there."""
    pin.rnea(model, data, q, v, a)
    twist = data.v[BODY_JOINT]
    held = fixed * data.a_gf[BODY_JOINT] + twist.cross(fixed * twist)
    for joint in mount.moving:
        if model.parents[joint] == BODY_JOINT:
            held += data.liMi[joint].act(data.f[joint])
    to_mount = pin.SE3(np.eye(3), np.array(mount.at[:3])).inverse()
    return 0.0 - np.asarray(to_mount.act(held).vector)
