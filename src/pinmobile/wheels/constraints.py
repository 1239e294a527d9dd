"""`Constraints`: the rows by which wheels hold a robot; `ConstrainedTree`: its tree under them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, frozen
from pinmobile.constancy import constant
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
@constant
@dataclass(frozen=True, eq=False)
class Constraints:
    """The rows A(q) v = 0 of a wheel table, along the coordinates of the robot that it carries.

    Parameters
    ----------
    table : WheelTable
        The wheels.
    nq, nv : int
        Sizes of what the wheels carry: body and arms.
    """

    table: WheelTable
    nq: int
    nv: int

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
        return self.kinematics.rows(zeros, [0.0] * BODY_JOINT, zeros)

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
        still = self._still
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        lead = q.shape[:-1] if v.ndim == 1 else np.broadcast_shapes(q.shape[:-1], v.shape[:-1])
        A = np.empty((*lead, *still.shape))
        A[...] = still
        w, ahead, aside = v[..., 2], c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0]
        drift = (w * aside)[..., None] * still[:, 0] - (w * ahead)[..., None] * still[:, 1]
        drift = drift if drift.shape[:-1] == lead else np.array(np.broadcast_to(drift, (*lead, len(still))))
        if self._steered:
            n, nv, axes = self.nq, self.nv, len(self.table.axes)
            steering = [q[..., n + k] for k in range(axes)]
            rates = [v[..., nv + k] for k in range(self.joints)]
            rows = self.kinematics.rows(steering, [ahead, aside, w], rates)
            for i in self._steered:
                for k, x in enumerate(rows[i].base):
                    A[..., i, k] = number(x)
                for k in range(axes):
                    A[..., i, nv + k] = number(rows[i].joints[k])
                drift[..., i] = number(rows[i].drift)
        x, y = A[..., 0].copy(), A[..., 1]
        c, s = c[..., None], s[..., None]
        A[..., 0], A[..., 1] = c * x - s * y, s * x + c * y
        return A, drift


@final
@constant
@dataclass(frozen=True, eq=False)
class ConstrainedTree:
    """A tree that constraints hold: M a = force - n + A' lambda and A a = -dA/dt v.

    Parameters
    ----------
    tree : WheelTree
        Free of constraints.
    constraints : Constraints
        The rows.
    independent : tuple of int
        Rows from which the others follow.
    stiffness : float
        m where M has no inverse, as that of wheels without inertia has none: M + m A' A then takes its place,
        which what rolls does not feel [kg]; else 0.
    """

    tree: WheelTree
    constraints: Constraints
    independent: tuple[int, ...]
    stiffness: float = 0.0

    def accelerations(self, q: Array, v: Array, force: Array) -> Array:
        """Return a, shape (..., nv), under a generalised force."""
        A, drift = self.constraints.at(q, v)
        rows = list(self.independent)
        A, drift = A[..., rows, :], drift[..., rows]
        free, through = self._released(q, v, force, A, drift)
        G = A @ through
        multipliers = np.linalg.solve(G, -drift[..., None] - A @ free[..., None])
        return np.asarray(free + (through @ multipliers)[..., 0])

    def forces(self, q: Array, v: Array, force: Array) -> tuple[Array, Array]:
        """Return a, and lambda of all rows, shape (..., k), the shortest that there is."""
        A, drift = self.constraints.at(q, v)
        free, through = self._released(q, v, force, A, drift)
        G = A @ through
        wanted = -drift[..., None] - A @ free[..., None]
        multipliers = np.linalg.pinv(G, rcond=_REDUNDANT, hermitian=True) @ wanted
        a = np.asarray(free + (through @ multipliers)[..., 0])
        return a, np.asarray(multipliers[..., 0])

    def _released(self, q: Array, v: Array, force: Array, A: Array, drift: Array) -> tuple[Array, Array]:
        """Return the acceleration without constraints, and M^-1 A', shape (..., nv, k)."""
        M, n = self.tree.inertia_and_effects(q, v)
        force, A_T = force - n, np.swapaxes(A, -1, -2)
        if self.stiffness:
            force = force - self.stiffness * (A_T @ drift[..., None])[..., 0]
        right = np.empty((*force.shape, 1 + A.shape[-2]))
        right[..., 0], right[..., 1:] = force, A_T
        found = np.linalg.solve(self._metric(M, A), right)
        return np.asarray(found[..., 0]), np.asarray(found[..., 1:])

    def project(self, q: Array, v: Array) -> Array:
        """Return the velocity with A v = 0 that is nearest in the mass metric, shape (..., nv)."""
        M, _ = self.tree.inertia_and_effects(q, v)
        A = self.constraints.at(q, v)[0][..., list(self.independent), :]
        through = np.linalg.solve(self._metric(M, A), np.swapaxes(A, -1, -2))
        return np.asarray(v - (through @ np.linalg.solve(A @ through, A @ v[..., None]))[..., 0])

    def _metric(self, M: Array, A: Array) -> Array:
        return np.asarray(M + self.stiffness * np.swapaxes(A, -1, -2) @ A) if self.stiffness else M
