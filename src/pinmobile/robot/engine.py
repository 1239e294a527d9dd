"""Pinocchio on the DH chain for one configuration at a time, and the order of the coordinates.

This is the one place that knows that the chain's first joint is y while the library says x first.
"""

from collections.abc import Callable
from functools import partial
from math import isfinite
from threading import local
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, broadcast, finite_answer

__all__ = ["BODY_JOINT", "Calls", "Engine"]

BODY_JOINT = 3
"""The joint of the chain that carries the body; those before it carry nothing."""


class Calls(NamedTuple):
    """Unchecked Pinocchio calls for one state in chain order, for the thread alone that asked for them.

    Attributes
    ----------
    inverse : callable
        tau by RNEA, shape (nv,), of q, v and a.
    forward : callable
        The acceleration by ABA, shape (nv,), of q, v and tau.
    gravity : callable
        g(q), shape (nv,).
    integrate : callable
        The configuration, shape (nq,), that a displacement (nv,) leads to from q.
    """

    inverse: Callable[[Array, Array, Array], Array]
    forward: Callable[[Array, Array, Array], Array]
    gravity: Callable[[Array], Array]
    integrate: Callable[[Array, Array], Array]


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
        self._orders = {self.nv: self.order, self.nq: self.order_q}
        self._square = self.order[:, None], self.order

    @property
    def data(self) -> pin.Data:
        """What Pinocchio writes into, this thread's own."""
        return self._workspace.data

    def calls(self) -> Calls:
        """Return what a loop calls, all on this thread's data: it is looked up once."""
        model, data = self.model, self.data
        return Calls(
            inverse=partial(pin.rnea, model, data),
            forward=partial(pin.aba, model, data),
            gravity=partial(pin.computeGeneralizedGravity, model, data),
            integrate=partial(pin.integrate, model),
        )

    def reorder(self, array: Array) -> Array:
        """Return an array (..., nv) or (..., nq) in chain order from public order, or the other way round."""
        order = self._orders[array.shape[-1]]
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

    def each(self, function: Callable[..., Array], **arguments: Array) -> Array:
        """Call `function(model, data, *row)` for each row of the arguments, in chain order.

        Leading axes broadcast; what comes back is stacked along them, still in chain order.

        Raises
        ------
        NotFinite
            If what comes back is not finite.
        """
        rows = []
        for argument in arguments.values():
            if argument.ndim != 1:
                return self._stacked(function, **arguments)
            rows.append(argument[self._orders[len(argument)]])
        # A copy: Pinocchio hands out views of its data.
        answer = np.array(function(self.model, self._workspace.data, *rows))
        return answer if isfinite(np.vdot(answer, answer)) else finite_answer(answer, **arguments)

    def _stacked(self, function: Callable[..., Array], **arguments: Array) -> Array:
        """Return what `each` does of arguments with leading axes."""
        model, data, lead = self.model, self.data, broadcast(**arguments)
        stacked = [
            self.reorder(np.broadcast_to(argument, (*lead, argument.shape[-1]))).reshape(
                -1, argument.shape[-1]
            )
            for argument in arguments.values()
        ]
        if stacked[0].shape[0] == 0:
            probes = (np.zeros(row.shape[1]) for row in stacked[1:])
            shape = np.asarray(function(model, data, pin.neutral(model), *probes)).shape
            return np.empty((*lead, *shape))
        results = [np.array(function(model, data, *row)) for row in zip(*stacked, strict=True)]
        return finite_answer(np.stack(results).reshape((*lead, *results[0].shape)), **arguments)
