"""`Constraints`: the rows by which wheels hold a robot; `ConstrainedTree`: its tree under them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, frozen
from pinmobile.robot import BODY_JOINT, number
from pinmobile.wheels.kinematics import Kinematics, Row
from pinmobile.wheels.table import WheelTable
from pinmobile.wheels.tree import WheelTree

_REDUNDANT = 1e-10  # relative, of eigenvalues: rows that follow from others


class Forces(NamedTuple):
    """What the ground does at the wheels.

    Attributes
    ----------
    names : tuple of str
        Of the rows, such as ``"left rolling"``.
    values : ndarray, shape (..., k)
        Force of the ground on the robot along each row [N], of a gear train what it transmits.
    determined : ndarray of bool, shape (k,)
        Whether rolling determines it; of the others only sums are, and they are shared so that the sum of
        squares is least.
    """

    names: tuple[str, ...]
    values: Array
    determined: Array


@final
@dataclass(frozen=True, eq=False)
class Constraints:
    """The rows A(q) v = 0 of a wheel table, along the coordinates of the robot that it carries.

    Parameters
    ----------
    table : WheelTable
        The wheels.
    nv : int
        Number of coordinates that the wheels carry: body and arms.
    rows : tuple of int, optional
        Which rows; by default all.
    """

    table: WheelTable
    nv: int
    rows: tuple[int, ...] | None = None

    @cached_property
    def kinematics(self) -> Kinematics:
        """Of the table."""
        return Kinematics.of(self.table)

    @property
    def joints(self) -> int:
        """Number of steering coordinates and wheels."""
        return len(self.table.axes) + len(self.table)

    @cached_property
    def _at_zero(self) -> list[Row]:
        """The rows where steering angles and rates are zero."""
        zeros = [0.0] * self.joints
        found = self.kinematics.rows(zeros, [0.0] * BODY_JOINT, zeros)
        return found if self.rows is None else [found[i] for i in self.rows]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of each row its wheel and direction, such as ``"left rolling"``."""
        return tuple(
            f"{self.table.names[row.wheel]} {row.kind}" if row.wheel >= 0 else row.kind
            for row in self._at_zero
        )

    @cached_property
    def _still(self) -> Array:
        """The rows along the body's axes, shape (k, nv), steering angles at zero."""
        rows = self._at_zero
        A = np.zeros((len(rows), self.nv + self.joints))
        A[:, :BODY_JOINT] = [[number(x) for x in row.base] for row in rows]
        A[:, self.nv :] = [[number(x) for x in row.joints] for row in rows]
        return frozen(A)

    def base_of(self, row: int) -> Array:
        """Return the coefficients of the body twist in a row, steering angles at zero, shape (3,)."""
        return self._still[row, :BODY_JOINT]

    @cached_property
    def _steered(self) -> tuple[int, ...]:
        """Rows that change with a steering angle."""
        steered = {row for axis in self.table.axes for row in axis.wheels}
        return tuple(i for i, row in enumerate(self._at_zero) if row.wheel in steered)

    def at(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return A, shape (..., k, nv), and what A v changes at where nothing accelerates, (..., k)."""
        c, s, w = np.cos(q[..., 2]), np.sin(q[..., 2]), v[..., 2]
        ahead, aside = c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0]
        lead = q.shape[:-1] if v.ndim == 1 else np.broadcast_shapes(q.shape[:-1], v.shape[:-1])
        x, y = self._ahead_and_aside
        if not lead and not self._steered:  # of one state without detours
            A = self._still.copy()
            A[:, 0], A[:, 1] = c * x - s * y, s * x + c * y
            return A, (w * aside) * x - (w * ahead) * y
        A, drift = np.empty((*lead, *self._still.shape)), np.empty((*lead, len(self._still)))
        A[...] = self._still
        drift[...] = (w * aside)[..., None] * x - (w * ahead)[..., None] * y
        if self._steered:
            nv, axes = self.nv, len(self.table.axes)
            steering = [q[..., nv + k] for k in range(axes)]
            rates = [v[..., nv + k] for k in range(self.joints)]
            rows = self.kinematics.rows(steering, [ahead, aside, w], rates)
            for i in self._steered:
                row = rows[i if self.rows is None else self.rows[i]]
                for k, entry in enumerate(row.base):
                    A[..., i, k] = number(entry)
                for k in range(axes):
                    A[..., i, nv + k] = number(row.joints[k])
                drift[..., i] = number(row.drift)
        x, y = A[..., 0].copy(), A[..., 1]
        c, s = c[..., None], s[..., None]
        A[..., 0], A[..., 1] = c * x - s * y, s * x + c * y
        return A, drift

    @cached_property
    def _ahead_and_aside(self) -> tuple[Array, Array]:
        """Coefficients of the body's velocities forward and to the left, shape (k,) each."""
        return frozen(self._still[:, 0]), frozen(self._still[:, 1])


@final
@dataclass(frozen=True, eq=False)
class ConstrainedTree:
    """A tree that constraints hold: M a + n = force + A' lambda and A a = -dA/dt v, solved together.

    M may have no inverse, as that of wheels without inertia has none, if what rolls has mass.

    Parameters
    ----------
    tree : WheelTree
        Free of constraints.
    constraints, independent : Constraints
        All rows, and some from which the others follow.
    """

    tree: WheelTree
    constraints: Constraints
    independent: Constraints

    def accelerations(self, q: Array, v: Array, force: Array) -> Array:
        """Return a, shape (..., nv), under a generalised force."""
        M, n = self.tree.inertia_and_effects(q, v)
        return _solved(M, *self.independent.at(q, v), force - n)

    def forces(self, q: Array, v: Array, force: Array) -> tuple[Array, Array]:
        """Return a, and lambda of all rows, shape (..., k), the shortest that there is."""
        M, n = self.tree.inertia_and_effects(q, v)
        force = force - n
        a = _solved(M, *self.independent.at(q, v), force)
        rest = (M @ a[..., None])[..., 0] - force
        A_T = np.swapaxes(self.constraints.at(q, v)[0], -1, -2)
        return a, np.asarray(np.linalg.pinv(A_T, rcond=_REDUNDANT) @ rest[..., None])[..., 0]

    def project(self, q: Array, v: Array) -> Array:
        """Return the velocity with A v = 0 that is nearest in the mass metric, shape (..., nv)."""
        A, _ = self.independent.at(q, v)
        slips = A @ v if v.ndim == 1 == A.ndim - 1 else (A @ v[..., None])[..., 0]
        return v + _solved(self.tree.inertia(q), A, slips, np.zeros(v.shape[-1]))


def _solved(M: Array, A: Array, drift: Array, force: Array) -> Array:
    """Return x of M x = force + A' lambda and A x = -drift, of rows that do not follow from each other."""
    k, n = A.shape[-2:]
    lead: tuple[int, ...] = ()
    if M.ndim > 2 or A.ndim > 2 or force.ndim > 1:
        lead = np.broadcast_shapes(M.shape[:-2], A.shape[:-2], force.shape[:-1])
    K, right = np.zeros((*lead, n + k, n + k)), np.empty((*lead, n + k, 1))
    K[..., :n, :n], K[..., n:, :n], K[..., :n, n:] = M, A, A.swapaxes(-1, -2)
    right[..., :n, 0], right[..., n:, 0] = force, -drift
    return np.asarray(np.linalg.solve(K, right)[..., :n, 0])
