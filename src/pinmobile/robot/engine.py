"""Pinocchio on the DH chain for one configuration at a time, and the order of the coordinates.

This is the one place that knows that the chain's first joint is y while the library says x first.
"""

from collections.abc import Callable
from functools import cached_property, partial
from threading import local
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.robot.linkage import Linkage

__all__ = ["BODY_JOINT", "Calls", "Engine", "Law"]

BODY_JOINT = 3
"""The joint of the chain that carries the body; those before it carry nothing."""


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
