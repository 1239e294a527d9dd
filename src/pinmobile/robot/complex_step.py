"""Slopes of a law by the complex step: exact but for rounding (Squire and Trapp, 1998)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pinmobile.arrays import Array

_STEP = 1e-30  # its square is nothing beside any number
_SAMPLES = 256  # of which slopes are found at once


def slopes(function: Callable[..., Any], directions: Array, *given: Array) -> Array:
    """Return the derivatives of a function along directions, shape (..., m, k).

    Parameters
    ----------
    function : callable
        ``function(step, *given)``, analytic in the step, shape (..., n); it broadcasts over leading axes, and
        returns an array of shape (..., m).
    directions : ndarray, shape (k, n)
        Of the steps.
    *given : ndarray, shape (..., size)
        Where the derivatives are taken; of one leading shape.
    """
    lead = given[0].shape[:-1]
    flat = [x.reshape(-1, 1, x.shape[-1]) for x in given]
    found = [
        function(1j * _STEP * directions, *(x[i : i + _SAMPLES] for x in flat)).imag / _STEP
        for i in range(0, len(flat[0]), _SAMPLES)
    ]
    whole = np.concatenate(found)  # (samples, k, m)
    return np.asarray(np.swapaxes(whole, -1, -2)).reshape(*lead, whole.shape[-1], len(directions))


def linearized(body: Any, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
    """Return A and B of a body that is pushed, as `MobileRobot.linearize` has them, of its law on arrays.

    Parameters
    ----------
    body : PlanarBody or ArticulatedBody
        Each of whose joints moves along or about one axis.
    q, v, u : ndarray, shape (..., nq), (..., nv), (..., nv)
        State and generalised force.
    """
    n = int(body.nv)
    q, v, u = (np.asarray(x, np.float64) for x in (q, v, u))
    lead = np.broadcast_shapes(q.shape[:-1], v.shape[:-1], u.shape[:-1])
    q, v, u = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v, u))

    def accelerations(step: Array, q: Array, v: Array, u: Array) -> Any:
        moved = body.integrate(q, step[..., :n]), v + step[..., n : 2 * n], u + step[..., 2 * n :]
        return body.forward_dynamics(*moved)

    # Nothing follows from where the body is.
    found = slopes(accelerations, np.eye(3 * n)[2:], q, v, u)
    A, B = np.zeros((*lead, 2 * n, 2 * n)), np.zeros((*lead, 2 * n, n))
    A[..., :n, n:] = np.eye(n)
    A[..., n:, 2:] = found[..., : 2 * n - 2]
    B[..., n:, :] = found[..., 2 * n - 2 :]
    return A, B
