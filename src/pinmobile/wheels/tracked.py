"""What a controller of the tracked state asks of wheels that roll: how they go along a reference, and slopes.

The tracked state of a robot on wheels is that of the reference's coordinates, x, y, psi and the arms, and the
independent velocities nu of `Reduced`: wheel angles do not matter.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.robot import number, slopes, vector_of as stacked

_BASE = 3
_OFF = 1e-6  # of the largest rate, beyond which wheels would slide sideways; of the largest force


class Followed(NamedTuple):
    """Wheels that roll along a reference.

    Attributes
    ----------
    q, v : ndarray, shape (N, nq), (N, nv)
        States, wheel angles zero.
    nu : ndarray, shape (N, m)
        Independent velocities.
    u : ndarray, shape (N, nu)
        Inputs of least norm.
    """

    q: Array
    v: Array
    nu: Array
    u: Array


def check_steers_not(body: Any) -> None:
    """Refuse wheels that steer, whose angles belong to the state.

    Raises
    ------
    InvalidArgument
        If there are such.
    """
    if body.table.axes:
        raise InvalidArgument(
            f"robot steers wheels about {len(body.table.axes)} axes, whose angles no reference leads, "
            "expected wheels that do not steer, or Backstepping(law, robot)"
        )


def followed(body: Any, reference: Any) -> Followed:
    """Return how a body on wheels that do not steer goes along a reference.

    Parameters
    ----------
    body : WheeledDynamics
        What rolls.
    reference : Reference
        q, v and a of body and arms, shape (N, ...).

    Raises
    ------
    InvalidArgument
        If wheels steer or cannot roll so, or no input does it.
    """
    check_steers_not(body)
    tracked = _BASE + body.na
    lead, joints = reference.q.shape[:-1], body.joints
    q = np.concatenate([reference.q, np.zeros((*lead, joints))], axis=-1)
    v = np.concatenate([reference.v, np.zeros((*lead, joints))], axis=-1)
    if q.shape[-1] != tracked + joints or v.shape[-1] != tracked + joints:
        raise InvalidArgument(
            f"reference has {reference.v.shape[-1]} coordinates, expected those of body and arms, {tracked}: "
            "a motion of both is WholeBody(robot, base, *joints)"
        )
    state = body.state(q, v)
    nu = stacked(body.freedom.velocities(state), q)
    rolls = _rolling(body, q, nu)
    off = np.abs(rolls - v)[..., :tracked].max(axis=-1)
    if (off > _OFF * (1 + np.abs(v).max())).any():
        k = int(np.argmax(off))
        raise InvalidArgument(
            f"reference moves the body by {off[k]:.3g} m/s, or rad/s, at its sample {k} as its wheels cannot "
            "roll, expected one that they can follow, such as Tangent(path)"
        )
    state, a = body.state(q, rolls), reference.a
    along = [state.c * a[..., 0] + state.s * a[..., 1], state.c * a[..., 1] - state.s * a[..., 0], a[..., 2]]
    offset = body.freedom.offset(state, along)
    rates = stacked([*offset[: nu.shape[-1] - body.na], *np.moveaxis(a[..., _BASE:], -1, 0)], q)
    own = body.reduced(q, rolls)
    force = np.einsum("...ij,...j->...i", own.M, rates) + own.n
    u = np.einsum("...ij,...j->...i", np.linalg.pinv(own.B), force)
    missed = np.abs(np.einsum("...ij,...j->...i", own.B, u) - force).max()
    if missed > _OFF * (1 + np.abs(force).max()):
        raise InvalidArgument(
            f"reference needs a force of {missed:.3g} N, or N m, that no motor of the robot exerts, expected "
            "a drive with a motor for each degree of freedom"
        )
    return Followed(q, rolls, nu, u)


def _rolling(body: Any, q: Any, nu: Any) -> Any:
    """Return v of independent velocities, shape (..., nv)."""
    still = np.zeros((*q.shape[:-1], body.nv))
    state = body.state(q, still)
    S, _ = body.freedom.solution(state)
    columns = np.moveaxis(nu, -1, 0)
    moved = [sum((number(x) * y for x, y in zip(row, columns, strict=True)), 0.0 * columns[0]) for row in S]
    return body.in_plane(state, moved, q)


def linearized(body: Any, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
    """Return the first-order model of the tracked state, A and B, see `WheeledRobot.linearize_tracked`.

    Parameters
    ----------
    body : WheeledDynamics
        Whose wheels do not steer.
    q, v, u : ndarray, shape (..., nq), (..., nv), (..., nu)
        State, which rolls, and input.
    """
    check_steers_not(body)
    n = _BASE + body.na
    q, v, u = (np.asarray(x, np.float64) for x in (q, v, u))
    lead = np.broadcast_shapes(q.shape[:-1], v.shape[:-1], u.shape[:-1])
    q, v, u = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v, u))
    nu = stacked(body.freedom.velocities(body.state(q, v)), q)
    m = nu.shape[-1]

    def rates(step: Array, q: Array, nu: Array, u: Array) -> Any:
        count = np.broadcast_shapes(step.shape[:-1], q.shape[:-1])
        moves = np.zeros((*count, body.nv), np.complex128)
        moves[..., :n] = step[..., :n]
        moved, velocities = body.integrate(q, moves), nu + step[..., n : n + m]
        rolls = _rolling(body, moved, velocities)
        own = body.reduced(moved, rolls)
        pushed = np.einsum("...ij,...j->...i", own.B, u + step[..., n + m :]) - own.n
        gained = np.linalg.solve(own.M, pushed[..., None])[..., 0]
        return np.concatenate([rolls[..., :n], gained], axis=-1)

    # Nothing follows from where the body is.
    found = slopes(rates, np.eye(n + m + u.shape[-1])[2:], q, nu, u)
    A = np.zeros((*lead, n + m, n + m))
    A[..., 2:] = found[..., : n + m - 2]
    return A, np.ascontiguousarray(found[..., n + m - 2 :])
