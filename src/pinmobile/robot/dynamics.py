"""The dynamics of a body on the chain, in public order, checked, for many states at once."""

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, broadcast, finite, finite_answer, vector
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot.engine import BODY_JOINT, Calls, Engine, Law
from pinmobile.robot.kinematics import ChainKinematics

__all__ = ["ChainDynamics", "Linearization"]


_STEP = 1e-4  # [s], of a central difference: its error is of the order of 1e-8 |v|^3 and 1e-12


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


class ChainDynamics(ChainKinematics):
    """Abstract base: what follows from the Pinocchio model that its maker has set.

    All methods take and return, along the last axis and in the inertial frame: configuration
    q = (x, y, psi) [m, m, rad], velocity v = dq/dt [m/s, m/s, rad/s], acceleration a [m/s^2, m/s^2, rad/s^2]
    and generalised force tau = (Fx, Fy, Mz) [N, N, N m]; after these come the arms' joints, one after the
    other, in their units. A joint without limits is (cos, sin) in q and one number in v. Leading axes
    broadcast. All raise `InvalidArgument` for arguments of another last axis or that are not finite, and
    `NotFinite` where the answer would not be. They may be called by several threads at once.

    Pinocchio takes one state at a time, some 5 to 20 microseconds each. From 500 states in a call on, they
    are compiled and run on all processors, in some 0.1 microseconds each, with the same answers but for
    rounding. The number of states alone decides, so the same call has the same bits at any time, and each
    state has its own whatever others there are. The first such call of a method takes 0.1 to 0.5 s for an arm
    and up to some seconds for a humanoid, less where its machine code is in the folder of an earlier process
    (``PINMOBILE_CACHE``); robots with other numbers on the same joints, as `with_parameters` makes them,
    share it, unless a number that was zero no longer is. However many they are, one after another go the
    states of `coriolis_matrix`, `forward_dynamics_derivatives`, `linearize`, `integrate_jacobian` and
    `frame_placements`; of robots with a ball joint; and of methods that take more than 12,000 operations, as
    forward dynamics of some 40 joints and the regressor of some 20 do.
    """

    @property
    def inertial_parameters(self) -> Array:
        """What `regressor` multiplies, shape (10 bodies,), those of the body and then of each joint's.

        m, m c, and Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin of the joint's frame [SI].
        """
        moving = range(BODY_JOINT, self._model.njoints)
        return np.concatenate([self._model.inertias[joint].toDynamicParameters() for joint in moving])

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q), shape (..., nv, nv) [kg, kg m, kg m^2], by Pinocchio's CRBA."""
        return self._each(_MASS_MATRIX, q=self._q(q))

    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return n(q, v), shape (..., nv) [N, N, N m], by Pinocchio's RNEA without acceleration."""
        return self._each(_NONLINEAR_EFFECTS, q=self._q(q), v=self._v("v", v))

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return tau = M(q) a + n(q, v), shape (..., nv) [N, N, N m], by Pinocchio's RNEA."""
        return self._each(_INVERSE_DYNAMICS, q=self._q(q), v=self._v("v", v), a=self._v("a", a))

    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, f: ArrayLike = 0.0) -> Array:
        """Return a = M(q)^-1 (tau + f - n(q, v)), shape (..., nv) [m/s^2, ...], by Pinocchio's ABA.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        tau : array_like, shape (..., nv)
            The input, a generalised force [N, N, N m, ...].
        f : array_like, shape (..., nv), optional
            Generalised forces beside it; 0: none.
        """
        arguments = {"q": self._q(q), "v": self._v("v", v), "tau": self._v("tau", tau)}
        if np.ndim(f) or f:
            force, beside = arguments["tau"], self._v("f", f)
            broadcast(tau=force, f=beside)
            with np.errstate(over="ignore"):
                arguments["tau"] = finite_answer(force + beside, tau=force, f=beside)
        return self._each(_FORWARD_DYNAMICS, **arguments)

    def effort(self, q: ArrayLike, wrench: ArrayLike) -> Array:
        """Return the generalised force of a wrench on the body, shape (..., nv) [N, N, N m, ...].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        wrench : array_like, shape (..., 3)
            Force along the inertial axes on the origin of the body's frame, and moment about it, (Fx, Fy, Mz)
            [N, N, N m].
        """
        q, wrench = self._q(q), vector("wrench", wrench, BODY_JOINT)
        whole = np.zeros((*broadcast(q=q, wrench=wrench), self.nv))
        whole[..., :BODY_JOINT] = wrench
        return whole

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the q and v with which a reference begins, shape (nq,) and (nv,).

        What it does not lead rests where `rest` has it.

        Parameters
        ----------
        reference : Reference
            Its first sample: q and v of the first n coordinates, n one of `leading`.

        Raises
        ------
        InvalidArgument
            If it is no reference, or has another number of coordinates.
        """
        if not (hasattr(reference, "q") and hasattr(reference, "v")):
            raise InvalidArgument(f"reference is {shown(reference)}, expected a Reference: q, v and a")
        v, q = finite("reference.v", reference.v), finite("reference.q", reference.q)
        if self.leading.get(v.size) != q.size or v.ndim != 1 or q.ndim != 1:
            pairs = ", ".join(f"({numbers},) and ({n},)" for n, numbers in self.leading.items())
            raise InvalidArgument(
                f"reference has q and v of shapes {q.shape} and {v.shape}, expected one of {pairs}"
            )
        rates = np.zeros(self.nv)
        rates[: v.size] = v
        return self._q(np.append(q, self.rest[q.size :]), "reference.q"), rates

    def calls(self) -> Calls:
        """Return unchecked functions of one state for this thread, for loops: see `Calls`.

        What a subclass overrides is as it has it.
        """
        own = (
            name for name in Calls._fields if getattr(type(self), name) is not getattr(ChainDynamics, name)
        )
        return self._engine.calls()._replace(**{name: getattr(self, name) for name in own})

    def coriolis_matrix(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return C(q, v), shape (..., nv, nv): C v = n(q, v), and dM/dt - 2 C is skew-symmetric."""
        return self._each(_CORIOLIS_MATRIX, q=self._here(q), v=self._v("v", v))

    def kinetic_energy(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return v' M(q) v / 2, shape (...) [J]."""
        return self._each(_KINETIC_ENERGY, q=self._q(q), v=self._v("v", v))

    def potential_energy(self, q: ArrayLike) -> Array:
        """Return the energy in the field of gravity, shape (...) [J]; zero where all is on the ground."""
        return self._each(_POTENTIAL_ENERGY, q=self._q(q))

    def gravity(self, q: ArrayLike) -> Array:
        """Return g(q), shape (..., nv) [N, N, N m]: what holds the robot at rest; none of it for the base."""
        return self._each(_GRAVITY, q=self._q(q))

    def regressor(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return Y(q, v, a), shape (..., nv, 10 bodies): tau = Y `inertial_parameters`, rotors left out."""
        return self._each(_REGRESSOR, q=self._q(q), v=self._v("v", v), a=self._v("a", a))

    def forward_dynamics_derivatives(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike
    ) -> tuple[Array, Array, Array]:
        """Return da/dq, da/dv, da/dtau = M^-1, each of shape (..., nv, nv), by Pinocchio's ABA derivatives.

        The first is by the displacement that `integrate` takes.
        """
        arguments = {"q": self._here(q), "v": self._v("v", v), "tau": self._v("tau", tau)}
        stacked = self._each(_DERIVATIVES, **arguments)
        return stacked[..., 0, :, :], stacked[..., 1, :, :], stacked[..., 2, :, :]

    def linearize(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Linearization:
        """Return the first-order model of forward dynamics about (q, v, tau).

        dq is the displacement that `integrate` takes. Where a joint turns about more than one axis, it turns
        itself while the robot moves: the first block of A is then -ad(v) instead of zero.
        """
        by_q, by_v, by_tau = self.forward_dynamics_derivatives(q, v, tau)
        A = np.zeros((*by_q.shape[:-2], 2 * self.nv, 2 * self.nv))
        B = np.zeros((*by_q.shape[:-2], 2 * self.nv, self.nv))
        A[..., : self.nv, self.nv :] = np.eye(self.nv)
        if self.nq != self.nv:
            A[..., : self.nv, : self.nv] = self._each(_TURNING, q=self._q(q), v=self._v("v", v))
        A[..., self.nv :, : self.nv], A[..., self.nv :, self.nv :] = by_q, by_v
        B[..., self.nv :, :] = by_tau
        return Linearization(A, B)


def _turning(model: pin.Model, data: pin.Data, q: Array, v: Array) -> Array:
    """Return how a displacement from a configuration that moves with v changes by itself."""
    ahead, behind = (pin.dIntegrate(model, q, h * v, pin.ARG0) for h in (_STEP, -_STEP))
    return np.asarray((ahead - behind) / (2 * _STEP))


def _kinetic_energy(model: pin.Model, data: pin.Data, q: Array, v: Array) -> Any:
    # Pinocchio's own leaves out the motors of joints that turn about an axis of their own.
    with np.errstate(over="ignore", invalid="ignore"):
        return np.vdot(v, pin.crba(model, data, q) @ v) / 2


def _derivatives(model: pin.Model, data: pin.Data, q: Array, v: Array, tau: Array) -> Array:
    return np.stack(pin.computeABADerivatives(model, data, q, v, tau))


def _of_bodies(engine: Engine, Y: Array) -> Array:
    """Return a regressor in public order without the columns of what is not there: the virtual links."""
    return Y[..., engine.order, 10 * (BODY_JOINT - 1) :]


_MASS_MATRIX = Law(pin.crba, "mass_matrix", order=Engine.reorder_square)
_NONLINEAR_EFFECTS = Law(pin.nonLinearEffects, "nonlinear_effects", order=Engine.reorder)
_INVERSE_DYNAMICS = Law(pin.rnea, "inverse_dynamics", order=Engine.reorder)
_FORWARD_DYNAMICS = Law(pin.aba, "forward_dynamics", order=Engine.reorder)
_GRAVITY = Law(pin.computeGeneralizedGravity, "gravity", order=Engine.reorder)
_KINETIC_ENERGY = Law(_kinetic_energy, "kinetic_energy")
_POTENTIAL_ENERGY = Law(pin.computePotentialEnergy, "potential_energy")
_REGRESSOR = Law(pin.computeJointTorqueRegressor, "regressor", order=_of_bodies)
_CORIOLIS_MATRIX = Law(pin.computeCoriolisMatrix, order=Engine.reorder_square)
_DERIVATIVES = Law(_derivatives, order=Engine.reorder_square)
_TURNING = Law(_turning, order=Engine.reorder_square)
