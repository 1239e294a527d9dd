"""Laws of a robot's state: by Pinocchio, one state after another, and of many at once compiled.

What is compiled belongs to the form of a robot, which is its kinematics and which of its numbers are zero.
Masses, centres of mass, inertias, rotors and places of arms are handed over.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from functools import cached_property, partial
from math import prod
from threading import local
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, affordable, broadcast, finite_answer
from pinmobile.compiled import Batched, processors
from pinmobile.compiled.batched import copied
from pinmobile.errors import NotTraceable
from pinmobile.robot.articulated import ArticulatedBody
from pinmobile.robot.joints import BODY_JOINT
from pinmobile.robot.linkage import Linkage
from pinmobile.robot.mounts import Mount


class Calls(NamedTuple):
    """Unchecked functions of one state in public order, for the thread alone that asked for them.

    For loops that run millions of times: they take float64 arrays of shape (nv,), and nothing else.
    What one returns is overwritten by the next call of any of them: copy what is kept.

    Attributes
    ----------
    mass_matrix : callable
        M(q), shape (nv, nv), by CRBA.
    nonlinear_effects : callable
        n(q, v), shape (nv,), by RNEA without acceleration.
    inverse_dynamics : callable
        tau(q, v, a), shape (nv,), by RNEA.
    forward_dynamics : callable
        The acceleration a(q, v, tau), shape (nv,), by ABA. Forces beside the input are added to it.
    gravity : callable
        g(q), shape (nv,).
    pose, rate : callable
        Those of the body, shape (3,): of q, and of q and v.
    effort : callable
        The generalised force, shape (nv,), of q and a wrench (3,).
    """

    mass_matrix: Callable[[Array], Array]
    nonlinear_effects: Callable[[Array, Array], Array]
    inverse_dynamics: Callable[[Array, Array, Array], Array]
    forward_dynamics: Callable[[Array, Array, Array], Array]
    gravity: Callable[[Array], Array]
    pose: Callable[[Array], Array]
    rate: Callable[[Array, Array], Array]
    effort: Callable[[Array, Array], Array]


class Law(NamedTuple):
    """What is computed of one state, and of many.

    Attributes
    ----------
    run : callable
        ``run(model, data, *row)`` returns an array; in the chain's order, as its arguments are.
    name : str
        Of the method by which `ArticulatedBody` does it, if many states are compiled.
    options : tuple of str
        What that takes after the state.
    order : callable
        ``order(engine, array)`` puts what `run` returns into public order.
    """

    run: Callable[..., Any]
    name: str = ""
    options: tuple[str, ...] = ()
    order: Callable[[Engine, Array], Array] = lambda engine, array: array


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
        self.public = _in_public_order(model)

    @cached_property
    def linkage(self) -> Linkage:
        """Its tree, over scalars; raises `NotTraceable` where a joint is neither revolute nor prismatic."""
        return Linkage.of(self.public)

    @property
    def data(self) -> pin.Data:
        """What Pinocchio writes into, this thread's own."""
        return self._workspace.data

    def calls(self) -> Calls:
        """Return what a loop calls, all on this thread's data: it is looked up once."""
        data, public = self.data, self.public
        still = np.zeros(self.nv - BODY_JOINT)
        return Calls(
            mass_matrix=partial(pin.crba, public, data),
            nonlinear_effects=partial(pin.nonLinearEffects, public, data),
            inverse_dynamics=partial(pin.rnea, public, data),
            forward_dynamics=partial(pin.aba, public, data),
            gravity=partial(pin.computeGeneralizedGravity, public, data),
            pose=lambda q: q[:BODY_JOINT],
            rate=lambda q, v: v[:BODY_JOINT],
            effort=(lambda q, wrench: np.concatenate([wrench, still]))
            if len(still)
            else lambda q, wrench: wrench,
        )

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


def _in_public_order(model: pin.Model) -> pin.Model:
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


MANY = 500
"""Number of states from which on they are compiled."""

_LARGEST = 12_000  # operations: building takes a second or two
_MOST = 128  # programs that stay
_FAR = 1e5  # [rad]: beyond, sine and cosine of compiled code lose digits
_lock = threading.Lock()
_known: OrderedDict[Any, Batched | None] = OrderedDict()


def stacked(
    engine: Engine, law: Law, body: Callable[[], ArticulatedBody | None], **arguments: Array
) -> Array:
    """Return what a law gives for states along leading axes that broadcast, in public order.

    Parameters
    ----------
    engine : Engine
        Of the robot.
    law : Law
        What is asked.
    body : callable
        Returns the robot by `ArticulatedBody.each_its_own`, None where it has none: asked of `MANY` states.
    **arguments : ndarray, shape (..., size)
        The states.

    Raises
    ------
    NotFinite
        If an answer is not finite.
    InvalidArgument
        If the answers would not fit into memory.
    """
    lead = broadcast(**arguments)
    model, data, n = engine.model, engine.data, prod(lead)
    if n >= MANY and law.name and (whole := body()) is not None:
        found = _compiled(whole, law, n, **arguments)
        if found is not None:
            return found
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


def _compiled(body: ArticulatedBody, law: Law, n: int, **arguments: Array) -> Array | None:
    """Return the same of n states, None where it cannot be compiled."""
    program = _program(body, law, [x.shape[-1] for x in arguments.values()])
    if program is None:
        return None
    affordable(f"{law.name} of {n:,} states", 1.0 * n * program.size, "ask for fewer at a time")
    near = [_near(body, x) if name == "q" else x for name, x in arguments.items()]
    answer, squares = program(*near, *body.numbers.values(), threads=processors())
    return answer if np.isfinite(squares).all() else finite_answer(answer, **arguments)


def _program(body: ArticulatedBody, law: Law, sizes: list[int]) -> Batched | None:
    frames = [fixed for fixed in body.frames if fixed.name in law.options]
    arms = [k for k, (name, _) in enumerate(body.arms) if name in law.options]
    if law.options and not (frames or arms):
        return None  # of a virtual link, which moves with a part of the pose
    key = law.name, body.form, *map(body.form_of, frames), *arms
    with _lock:
        if key in _known:
            _known.move_to_end(key)
            return _known[key]
    made = _made(body, law, sizes)
    with _lock:
        _known[key] = made
        while len(_known) > _MOST:
            _known.popitem(last=False)
    return made


def _made(body: ArticulatedBody, law: Law, sizes: list[int]) -> Batched | None:
    names, numbers = list(body.numbers), body.numbers.values()

    def of_one(*given: Any) -> Any:
        state, own = given[: len(sizes)], given[len(sizes) :]
        robot = copied(body, dict(zip(names, own, strict=True)), {})
        answer = getattr(robot, law.name)(*state, *law.options)
        return answer, np.sum(answer * answer)  # which is finite where the answer is

    shapes = [*((size,) for size in sizes), *(x.shape for x in numbers)]
    try:
        return Batched(of_one, shapes, alike=len(names), pure=True, largest=_LARGEST)
    except NotTraceable:
        return None


def _near(body: ArticulatedBody, q: Array) -> Array:
    """Return configurations whose angles are within some turns."""
    if max(q.max(), -q.min()) <= _FAR:
        return q
    near = np.arctan2(np.sin(q), np.cos(q))
    return np.where((np.abs(q) > _FAR) & body.linkage.turns, near, q)


def frame_pose(name: str, number: int) -> Law:
    """Return the law of a frame's pose."""

    def pose(model: pin.Model, data: pin.Data, q: Array) -> Array:
        pin.forwardKinematics(model, data, q)
        return np.asarray(pin.updateFramePlacement(model, data, number).homogeneous)

    return Law(pose, "frame_pose", (name,))


def _jacobian(number: int, model: pin.Model, data: pin.Data, q: Array) -> Array:
    return np.asarray(pin.computeFrameJacobian(model, data, q, number, pin.LOCAL_WORLD_ALIGNED))


def frame_jacobian(name: str, number: int) -> Law:
    """Return the law of a frame's Jacobian."""
    return Law(partial(_jacobian, number), "frame_jacobian", (name,), Engine.reorder)


def frame_drift(name: str, number: int) -> Law:
    """Return the law of a frame's acceleration where no coordinate accelerates."""

    def drift(model: pin.Model, data: pin.Data, q: Array, v: Array) -> Array:
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        reference = pin.LOCAL_WORLD_ALIGNED
        return np.asarray(pin.getFrameClassicalAcceleration(model, data, number, reference).vector)

    return Law(drift, "frame_drift", (name,))


def manipulability(name: str, number: int, part: slice = slice(None), *arm: str) -> Law:
    """Return the law of sqrt(det J J') of a frame, of all columns of J or of those of an arm."""

    def volume(model: pin.Model, data: pin.Data, q: Array) -> float:
        J = _jacobian(number, model, data, q)[:, part]
        # The product of the singular values: det squares what is small.
        return float(np.linalg.svd(J, compute_uv=False).prod()) if J.shape[1] >= len(J) else 0.0

    return Law(volume, "manipulability", (name, *arm))


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

    return Law(wrench, "mount_wrench", (mount.name,))


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


MASS_MATRIX = Law(pin.crba, "mass_matrix", order=Engine.reorder_square)
NONLINEAR_EFFECTS = Law(pin.nonLinearEffects, "nonlinear_effects", order=Engine.reorder)
INVERSE_DYNAMICS = Law(pin.rnea, "inverse_dynamics", order=Engine.reorder)
FORWARD_DYNAMICS = Law(pin.aba, "forward_dynamics", order=Engine.reorder)
GRAVITY = Law(pin.computeGeneralizedGravity, "gravity", order=Engine.reorder)
KINETIC_ENERGY = Law(_kinetic_energy, "kinetic_energy")
POTENTIAL_ENERGY = Law(pin.computePotentialEnergy, "potential_energy")
REGRESSOR = Law(pin.computeJointTorqueRegressor, "regressor", order=_of_bodies)
CORIOLIS_MATRIX = Law(pin.computeCoriolisMatrix, order=Engine.reorder_square)
DERIVATIVES = Law(_derivatives, order=Engine.reorder_square)


def _ground_wrench(model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array) -> Array:
    pin.rnea(model, data, q, v, a)
    return np.asarray(data.f[BODY_JOINT].vector)


GROUND_WRENCH = Law(_ground_wrench, "ground_wrench")
PLACEMENTS = Law(_placements)
