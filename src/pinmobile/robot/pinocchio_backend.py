"""Laws of a robot's state by Pinocchio, one state after another."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import prod
from threading import local
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, broadcast, finite_answer
from pinmobile.robot.linkage import BODY_JOINT
from pinmobile.robot.mounts import Mount


class Law(NamedTuple):
    """What is computed of one state.

    Attributes
    ----------
    run : callable
        ``run(model, data, *row)`` returns an array; in the chain's order, as its arguments are.
    order : callable
        ``order(engine, array)`` puts what `run` returns into public order.
    """

    run: Callable[..., Any]
    order: Callable[[Engine, Array], Array] = lambda engine, array: array


class UncheckedDynamics:
    """Unchecked functions of one state in public order, for the thread alone that asked for them.

    For loops that run millions of times: they take float64 arrays of shape (nv,), and nothing else. What one
    returns, but for accelerations, is overwritten by the next call of any of them: copy what is kept. All
    else is that of the robot.

    Parameters
    ----------
    robot : System
        The robot.
    engine : Engine
        Of it.

    Attributes
    ----------
    mass_matrix, nonlinear_effects, inverse_dynamics, gravity : callable
        M(q), n(q, v), tau(q, v, a) and g(q).
    integrate : callable
        The configuration after a displacement, of q and dq.
    pose, rate : callable
        Those of the body, shape (3,): of q, and of q and v.
    effort : callable
        The generalised force, shape (nv,), of q and a wrench (3,).
    """

    def __init__(self, robot: Any, engine: Engine) -> None:
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
        self.rate = lambda q, v: v[:BODY_JOINT]
        self.effort = lambda q, wrench: np.concatenate([wrench, still]) if len(still) else wrench
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


class Engine:
    """Pinocchio calls for one configuration, in the order of the chain, for any number of threads.

    What rides on the body comes after it in either order. The model is only read, and what Pinocchio writes
    into is each thread's own.

    Parameters
    ----------
    model : pin.Model
        Chain whose first two joints are prismatic y and prismatic x.
    """

    def __init__(self, model: pin.Model) -> None:
        self.model, self._workspace = model, _Workspace(model)
        self.nv = int(model.nv)
        # Public index of each coordinate of the chain. Swapping two, it is its own inverse.
        self.order = np.array([1, 0, *range(2, self.nv)])
        self._square = self.order[:, None], self.order
        self.public = in_public_order(model)

    @property
    def data(self) -> pin.Data:
        """What Pinocchio writes into, this thread's own."""
        return self._workspace.data

    def reorder(self, array: Array) -> Array:
        """Return an array (..., nv) in chain order from public order, or the other way round."""
        order = self.order
        return array[order] if array.ndim == 1 else array[..., order]  # the first is six times as fast

    def reorder_square(self, matrices: Array) -> Array:
        """Return matrices (..., nv, nv) in chain order from public order, or the other way round."""
        return matrices[self._square] if matrices.ndim == 2 else matrices[..., *self._square]

    def composite(self, q: Array) -> pin.Inertia:
        """Return the inertia of the body and all that rides on it, in the body's frame, at a public q."""
        model, data = self.model, self.data
        pin.forwardKinematics(model, data, self.reorder(q))
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


def stacked(engine: Engine, law: Law, **arguments: Array) -> Array:
    """Return what a law gives for states along leading axes that broadcast, in public order.

    Parameters
    ----------
    engine : Engine
        Of the robot.
    law : Law
        What is asked.
    **arguments : ndarray, shape (..., size)
        The states.

    Raises
    ------
    NotFinite
        If an answer is not finite.
    """
    lead = broadcast(**arguments)
    model, data, n = engine.model, engine.data, prod(lead)
    columns = [
        engine.reorder(np.broadcast_to(x, (*lead, x.shape[-1]))).reshape(n, x.shape[-1])
        for x in arguments.values()
    ]
    if not n:
        probes = (np.zeros(column.shape[1]) for column in columns)
        shape = np.shape(law.order(engine, np.asarray(law.run(model, data, *probes))))
        return np.empty((*lead, *shape))
    rows = [np.array(law.run(model, data, *row)) for row in zip(*columns, strict=True)]
    answer = law.order(engine, np.stack(rows).reshape((*lead, *rows[0].shape)))
    return finite_answer(answer, **arguments)


def frame_pose(number: int) -> Law:
    """Return the law of a frame's pose."""

    def pose(model: pin.Model, data: pin.Data, q: Array) -> Array:
        pin.forwardKinematics(model, data, q)
        return np.asarray(pin.updateFramePlacement(model, data, number).homogeneous)

    return Law(pose)


def _jacobian(number: int, model: pin.Model, data: pin.Data, q: Array) -> Array:
    return np.asarray(pin.computeFrameJacobian(model, data, q, number, pin.LOCAL_WORLD_ALIGNED))


def frame_jacobian(number: int) -> Law:
    """Return the law of a frame's Jacobian."""
    return Law(partial(_jacobian, number), Engine.reorder)


def frame_drift(number: int) -> Law:
    """Return the law of a frame's acceleration where no coordinate accelerates."""

    def drift(model: pin.Model, data: pin.Data, q: Array, v: Array) -> Array:
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        reference = pin.LOCAL_WORLD_ALIGNED
        return np.asarray(pin.getFrameClassicalAcceleration(model, data, number, reference).vector)

    return Law(drift)


def manipulability(number: int, part: slice = slice(None)) -> Law:
    """Return the law of sqrt(det J J') of a frame, of all columns of J or of those of an arm."""

    def volume(model: pin.Model, data: pin.Data, q: Array) -> float:
        J = _jacobian(number, model, data, q)[:, part]
        # The product of the singular values: det squares what is small.
        return float(np.linalg.svd(J, compute_uv=False).prod()) if J.shape[1] >= len(J) else 0.0

    return Law(volume)


def mount_wrench(mount: Mount, model: pin.Model, fixed: pin.Inertia) -> Law:
    """Return the law of what an arm exerts on the body.

    Parameters
    ----------
    mount : Mount
        The arm.
    model : pin.Model
        Of the whole robot.
    fixed : pin.Inertia
        In the body's frame, of what of the arm does not move on it.
    """
    roots = [joint for joint in mount.moving if model.parents[joint] == BODY_JOINT]
    to_mount = pin.SE3(np.eye(3), np.array(mount.at[:3])).inverse()

    def wrench(model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array) -> Array:
        pin.rnea(model, data, q, v, a)
        twist = data.v[BODY_JOINT]
        held = fixed * data.a_gf[BODY_JOINT] + twist.cross(fixed * twist)
        for joint in roots:
            held += data.liMi[joint].act(data.f[joint])
        return 0.0 - np.asarray(to_mount.act(held).vector)

    return Law(wrench)


def _placements(model: pin.Model, data: pin.Data, q: Array) -> Array:
    pin.forwardKinematics(model, data, q)
    return np.stack([data.oMi[k].homogeneous for k in range(1, model.njoints)])


def _kinetic_energy(model: pin.Model, data: pin.Data, q: Array, v: Array) -> Any:
    # Pinocchio's own leaves out the motors of joints that turn about an axis of their own.
    with np.errstate(over="ignore", invalid="ignore"):
        return np.vdot(v, pin.crba(model, data, q) @ v) / 2


def _derivatives(model: pin.Model, data: pin.Data, q: Array, v: Array, tau: Array) -> Array:
    return np.stack(pin.computeABADerivatives(model, data, q, v, tau))


def _of_bodies(engine: Engine, Y: Array) -> Array:
    """Return a regressor in public order without the columns of what is not there: the virtual links."""
    return Y[..., engine.order, 10 * (BODY_JOINT - 1) :]


MASS_MATRIX = Law(pin.crba, Engine.reorder_square)
NONLINEAR_EFFECTS = Law(pin.nonLinearEffects, Engine.reorder)
INVERSE_DYNAMICS = Law(pin.rnea, Engine.reorder)
FORWARD_DYNAMICS = Law(pin.aba, Engine.reorder)
GRAVITY = Law(pin.computeGeneralizedGravity, Engine.reorder)
KINETIC_ENERGY = Law(_kinetic_energy)
POTENTIAL_ENERGY = Law(pin.computePotentialEnergy)
REGRESSOR = Law(pin.computeJointTorqueRegressor, _of_bodies)
CORIOLIS_MATRIX = Law(pin.computeCoriolisMatrix, Engine.reorder_square)
DERIVATIVES = Law(_derivatives, Engine.reorder_square)


def _ground_wrench(model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array) -> Array:
    pin.rnea(model, data, q, v, a)
    return np.asarray(data.f[BODY_JOINT].vector)


GROUND_WRENCH = Law(_ground_wrench)
PLACEMENTS = Law(_placements)
