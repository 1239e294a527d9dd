"""The dynamics of a body on the chain, in public order, checked, for many states at once."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, broadcast, vector, wrap_angle
from pinmobile.robot.engine import Engine

__all__ = ["ChainDynamics", "Linearization"]


class Linearization(NamedTuple):
    """First-order model of forward dynamics about a state: d(dq, dv)/dt = A (dq, dv) + B dtau.

    Attributes
    ----------
    A : ndarray, shape (..., 2 nv, 2 nv)
        ``[[0, I], [da/dq, da/dv]]``.
    B : ndarray, shape (..., 2 nv, nv)
        ``[[0], [M^-1]]``.
    """

    A: Array
    B: Array


class ChainDynamics:
    """Abstract base: what follows from the Pinocchio model that its maker has set.

    All methods take and return, along the last axis and in the inertial frame: configuration
    q = (x, y, psi) [m, m, rad], velocity v = dq/dt [m/s, m/s, rad/s], acceleration a [m/s^2, m/s^2, rad/s^2]
    and generalised force tau = (Fx, Fy, Mz) [N, N, N m]. Leading axes broadcast; Pinocchio takes one
    configuration at a time, so they are looped over. All raise `InvalidArgument` for arguments of another
    last axis or that are not finite.
    """

    _engine: Engine

    @property
    def model(self) -> pin.Model:
        """The Pinocchio model, in the chain's order (y, x, psi)."""
        return self._engine.model

    @property
    def nq(self) -> int:
        """Size of q."""
        return int(self.model.nq)

    @property
    def nv(self) -> int:
        """Size of v and a."""
        return int(self.model.nv)

    @property
    def nu(self) -> int:
        """Size of the input, here the generalised force."""
        return self.nv

    @property
    def inertial_parameters(self) -> Array:
        """What `regressor` multiplies, shape (10,): m, m c, and Ixx, Ixy, Iyy, Ixz, Iyz, Izz about B [SI]."""
        return np.array(self.model.inertias[self.model.njoints - 1].toDynamicParameters())

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q), shape (..., nv, nv) [kg, kg m, kg m^2], by Pinocchio's CRBA."""
        return self._square(self._engine.each(pin.crba, self._q(q)))

    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return n(q, v), shape (..., nv) [N, N, N m], by Pinocchio's RNEA without acceleration."""
        return self._engine.reorder(self._engine.each(pin.nonLinearEffects, self._q(q), self._v("v", v)))

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return tau = M(q) a + n(q, v), shape (..., nv) [N, N, N m], by Pinocchio's RNEA."""
        arguments = self._q(q), self._v("v", v), self._v("a", a)
        return self._engine.reorder(self._engine.each(pin.rnea, *arguments))

    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Array:
        """Return a = M(q)^-1 (tau - n(q, v)), shape (..., nv) [m/s^2, m/s^2, rad/s^2], by Pinocchio's ABA."""
        arguments = self._q(q), self._v("v", v), self._v("tau", tau)
        return self._engine.reorder(self._engine.each(pin.aba, *arguments))

    def coriolis_matrix(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return C(q, v), shape (..., nv, nv): C v = n(q, v), and dM/dt - 2 C is skew-symmetric."""
        return self._square(self._engine.each(pin.computeCoriolisMatrix, self._q(q), self._v("v", v)))

    def kinetic_energy(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return v' M(q) v / 2, shape (...) [J]."""
        return self._engine.each(pin.computeKineticEnergy, self._q(q), self._v("v", v))

    def frame_placements(self, q: ArrayLike) -> Array:
        """Return T_0_k, the pose of each joint's frame, shape (..., 3, 4, 4); the last one is the body's."""

        def placements(model: pin.Model, data: pin.Data, q: Array) -> Array:
            pin.forwardKinematics(model, data, q)
            return np.stack([data.oMi[k].homogeneous for k in range(1, model.njoints)])

        return self._engine.each(placements, self._q(q))

    def jacobian(self, q: ArrayLike) -> Array:
        """Return J(psi), shape (..., nv, nv): v = J twist, with the body twist (forward, left, yaw rate)."""
        psi = self._q(q)[..., 2]
        J = np.zeros((*psi.shape, self.nv, self.nv))
        J[...] = np.eye(self.nv)
        J[..., 0, 0] = J[..., 1, 1] = np.cos(psi)
        J[..., 1, 0] = np.sin(psi)
        J[..., 0, 1] = -J[..., 1, 0]
        return J

    def regressor(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return Y(q, v, a), shape (..., nv, 10): tau = Y `inertial_parameters`."""
        arguments = self._q(q), self._v("v", v), self._v("a", a)
        Y = self._engine.each(pin.computeJointTorqueRegressor, *arguments)
        return Y[..., self._engine.order, -10:]

    def forward_dynamics_derivatives(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike
    ) -> tuple[Array, Array, Array]:
        """Return da/dq, da/dv, da/dtau = M^-1, each (..., nv, nv), by Pinocchio's ABA derivatives."""

        def derivatives(model: pin.Model, data: pin.Data, q: Array, v: Array, tau: Array) -> Array:
            return np.stack(pin.computeABADerivatives(model, data, q, v, tau))

        stacked = self._engine.each(derivatives, self._q(q), self._v("v", v), self._v("tau", tau))
        stacked = self._square(stacked)
        return stacked[..., 0, :, :], stacked[..., 1, :, :], stacked[..., 2, :, :]

    def linearize(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Linearization:
        """Return the first-order model of forward dynamics about (q, v, tau)."""
        by_q, by_v, by_tau = self.forward_dynamics_derivatives(q, v, tau)
        A = np.zeros((*by_q.shape[:-2], 2 * self.nv, 2 * self.nv))
        B = np.zeros((*by_q.shape[:-2], 2 * self.nv, self.nv))
        A[..., : self.nv, self.nv :] = np.eye(self.nv)
        A[..., self.nv :, : self.nv], A[..., self.nv :, self.nv :] = by_q, by_v
        B[..., self.nv :, :] = by_tau
        return Linearization(A, B)

    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Return the configuration that the displacement `dq` leads to from `q`, shape (..., nq)."""
        q, dq = self._q(q), self._v("dq", dq)
        broadcast(q=q, dq=dq)
        return q + dq

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Return the displacement from `q0` to `q1`, shape (..., nv); that of psi lies in (-pi, pi]."""
        q0, q1 = vector("q0", q0, self.nq), vector("q1", q1, self.nq)
        broadcast(q0=q0, q1=q1)
        displacement = q1 - q0
        displacement[..., 2] = wrap_angle(displacement[..., 2])
        return displacement

    def _q(self, q: ArrayLike) -> Array:
        return vector("q", q, self.nq)

    def _v(self, name: str, value: ArrayLike) -> Array:
        return vector(name, value, self.nv)

    def _square(self, matrices: Array) -> Array:
        order = self._engine.order
        return matrices[..., order[:, None], order]
