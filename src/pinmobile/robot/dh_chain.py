"""Pinocchio on the DH chain: the model of a body, its arms and loads, and its calls in public order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from threading import local
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.dh import LECTURE_TABLE, DHTable, JointType
from pinmobile.errors import InvalidArgument
from pinmobile.robot.joints import BODY_JOINT
from pinmobile.robot.linkage import Linkage
from pinmobile.robot.mounts import Load, Mount, free_name
from pinmobile.urdf import Body

_BODY_LINK = "base_link"


def check_chain(table: DHTable) -> None:
    """Refuse a table whose last frame is not the planar pose (x, y, psi) for joint variables (y, x, psi).

    Raises
    ------
    InvalidArgument
        If it is one, or no table at all.
    """
    if not isinstance(table, DHTable):
        raise InvalidArgument(f"dh is a {type(table).__name__}, expected a DHTable")
    kinds = [row.joint for row in table]
    planar = kinds == [row.joint for row in LECTURE_TABLE]
    probes = np.array([[0, 0, 0], [0.7, -0.3, 1.1], [-1.0, 2.0, -2.5]])
    if planar:
        pose, expected = (dh.placements(probes)[:, -1] for dh in (table, LECTURE_TABLE))
        planar = bool(np.abs(pose - expected).max() < 1e-12)
    if not planar:
        raise InvalidArgument(
            f"dh with variables {table.variables} does not put its last frame at (x, y, psi), expected "
            "a chain of prismatic y, prismatic x, revolute psi whose last frame is the body's"
        )


def build_model(table: DHTable, body: Body) -> pin.Model:
    """Return the chain with the body on its last link as a Pinocchio model.

    It is the model that Pinocchio reads from `urdf.write`, but with rotations that are exact where the
    table's angles are multiples of pi / 2, so that gravity does not leak into the plane.
    """
    model = pin.Model()
    model.name = "pinmobile"
    parent = 0
    for row, placement in zip(table, table.transforms(np.zeros(len(table))), strict=True):
        joint = pin.JointModelPZ() if row.joint is JointType.PRISMATIC else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, pin.SE3(placement), row.variable)
        model.addJointFrame(parent)
    model.appendBodyToJoint(parent, pin.Inertia(body.mass, body.com, body.inertia), pin.SE3.Identity())
    model.addBodyFrame(_BODY_LINK, parent, pin.SE3.Identity(), -1)
    return model


def assemble(base: pin.Model, mounts: Sequence[Mount], loads: Sequence[tuple[str, Load]]) -> pin.Model:
    """Return the model of a body that carries arms, and loads at frames of either.

    Parameters
    ----------
    base : pin.Model
        The chain with the body; the body's frame is its last.
    mounts : sequence of Mount
        One after the other.
    loads : sequence of (str, Load)
        Each with the frame it is fixed to.
    """
    model, body = base.copy(), base.nframes - 1
    for mount in mounts:
        model = pin.appendModel(model, prefixed(mount._model, mount.name), body, mount.placement)
    for mount in mounts:
        # Pinocchio forgets it when it appends; each arm keeps its own, joint by joint.
        model.armature[mount.v] = mount._model.armature
    model.name = base.name
    for frame, load in loads:
        fixed = model.frames[named_frames(model)[frame]]
        model.appendBodyToJoint(fixed.parentJoint, load.body, fixed.placement)
    return model


def named_frames(model: pin.Model) -> dict[str, int]:
    """Return the frames by name, links before joints of the same name."""
    ids: dict[str, int] = {}
    for number in range(1, model.nframes):
        frame = model.frames[number]
        if frame.name not in ids or frame.type == pin.FrameType.BODY:
            ids[frame.name] = number
    return ids


def prefixed(model: pin.Model, name: str) -> pin.Model:
    """Return a copy with all names ``name/...``; a frame is numbered where a link has its name."""
    copy = model.copy()
    for joint in range(1, copy.njoints):
        copy.names[joint] = f"{name}/{copy.names[joint]}"
    taken = {frame.name for frame in copy.frames if frame.type == pin.FrameType.BODY}
    for frame in copy.frames:
        own = str(frame.name)
        if frame.type != pin.FrameType.BODY:
            # Pinocchio finds a link by its name alone.
            own = free_name(own, taken)
            taken.add(own)
        frame.name = f"{name}/{own}"
    return copy


def resistances(nv: int, mounts: Sequence[Mount]) -> tuple[Array, Array]:
    """Return damping and friction of the joints, each of shape (nv,); the base has none."""
    damping, friction = np.zeros((2, nv))
    for mount in mounts:
        damping[mount.v], friction[mount.v] = mount._model.damping, mount._model.friction
    return damping, friction


class Calls(NamedTuple):
    """Unchecked functions of one state in public order, for the thread alone that asked for them.

    For loops that run millions of times: they take float64 arrays of shape (nq,) and (nv,), and nothing else.
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
    integrate : callable
        The configuration, shape (nq,), that a displacement (nv,) leads to from q.
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
    integrate: Callable[[Array, Array], Array]
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
    turns : bool
        Whether an angle and the same some turns on are the same to it.
    """

    run: Callable[..., Any]
    name: str = ""
    options: tuple[str, ...] = ()
    order: Callable[[Any, Array], Array] = lambda engine, array: array
    turns: bool = True


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
        self.nq, self.nv = int(model.nq), int(model.nv)
        # Public index of each coordinate of the chain. Swapping two, it is its own inverse.
        self.order, self.order_q = np.arange(self.nv), np.arange(self.nq)
        self.order[:2] = self.order_q[:2] = 1, 0
        self.orders = {self.nv: self.order, self.nq: self.order_q}
        self._square = self.order[:, None], self.order
        self.public = _in_public_order(model)

    @cached_property
    def linkage(self) -> Linkage:
        """Its tree, over scalars; raises `NotTraceable` where a joint has other than one coordinate."""
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
            integrate=partial(pin.integrate, public),
            pose=lambda q: q[:BODY_JOINT],
            rate=lambda q, v: v[:BODY_JOINT],
            effort=(lambda q, wrench: np.concatenate([wrench, still]))
            if len(still)
            else lambda q, wrench: wrench,
        )

    def reorder(self, array: Array) -> Array:
        """Return an array (..., nv) or (..., nq) in chain order from public order, or the other way round."""
        order = self.orders[array.shape[-1]]
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
