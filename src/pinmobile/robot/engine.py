"""Pinocchio on the DH chain for one configuration at a time, and the order of the coordinates.

This is the one place that knows that the chain's first joint is y while the library says x first.
"""

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, broadcast

__all__ = ["BODY_JOINT", "Engine"]

BODY_JOINT = 3
"""The joint of the chain that carries the body; those before it carry nothing."""


class Engine:
    """Unchecked Pinocchio calls for one configuration, in the order of the chain.

    What rides on the body comes after it in either order.

    Not for several threads at once: Pinocchio writes into one `pin.Data`.

    Parameters
    ----------
    model : pin.Model
        Chain whose first two joints are prismatic y and prismatic x.
    """

    def __init__(self, model: pin.Model) -> None:
        self.model, self.data = model, model.createData()
        # Public index of each coordinate of the chain. Swapping two, it is its own inverse.
        self.order, self.order_q = np.arange(model.nv), np.arange(model.nq)
        self.order[:2] = self.order_q[:2] = 1, 0
        self._orders = {model.nv: self.order, model.nq: self.order_q}

    def reorder(self, array: Array) -> Array:
        """Return an array (..., nv) or (..., nq) in chain order from public order, or the other way round."""
        return array[..., self._orders[array.shape[-1]]]

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Return tau by RNEA, shape (nv,); all is one state's, in chain order."""
        return pin.rnea(self.model, self.data, q, v, a)  # type: ignore[no-any-return]

    def forward(self, q: Array, v: Array, tau: Array) -> Array:
        """Return the acceleration by ABA, shape (nv,)."""
        return pin.aba(self.model, self.data, q, v, tau)  # type: ignore[no-any-return]

    def gravity(self, q: Array) -> Array:
        """Return g(q), shape (nv,)."""
        return pin.computeGeneralizedGravity(self.model, self.data, q)  # type: ignore[no-any-return]

    def integrate(self, q: Array, dq: Array) -> Array:
        """Return the configuration that a displacement leads to, shape (nq,)."""
        return pin.integrate(self.model, q, dq)  # type: ignore[no-any-return]

    def composite(self, q: Array) -> pin.Inertia:
        """Return the inertia of the body and all that rides on it, in the body's frame, at a public q."""
        model, data = self.model, self.data
        pin.forwardKinematics(model, data, self.reorder(q))
        total = pin.Inertia(model.inertias[BODY_JOINT])
        to_body = data.oMi[BODY_JOINT].inverse()
        for joint in range(BODY_JOINT + 1, model.njoints):
            total += (to_body * data.oMi[joint]).act(model.inertias[joint])
        return total

    def each(self, function: Callable[..., Array], *arguments: Array) -> Array:
        """Call `function(model, data, *row)` for each row of the arguments, in chain order.

        Leading axes broadcast; what comes back is stacked along them, still in chain order.
        """
        if all(argument.ndim == 1 for argument in arguments):
            rows = (argument[self._orders[len(argument)]] for argument in arguments)
            return np.array(function(self.model, self.data, *rows))
        names = ("q", "v", "a or tau")
        lead = broadcast(**dict(zip(names, arguments, strict=False)))
        stacked = [
            self.reorder(np.broadcast_to(argument, (*lead, argument.shape[-1]))).reshape(
                -1, argument.shape[-1]
            )
            for argument in arguments
        ]
        if stacked[0].shape[0] == 0:
            probes = (np.zeros(row.shape[1]) for row in stacked[1:])
            shape = np.asarray(function(self.model, self.data, pin.neutral(self.model), *probes)).shape
            return np.empty((*lead, *shape))
        # A copy: Pinocchio hands out views of its data.
        results = [np.array(function(self.model, self.data, *row)) for row in zip(*stacked, strict=True)]
        return np.stack(results).reshape((*lead, *results[0].shape))
