"""Frames of a body on the chain and what it carries, in public order."""

from functools import cached_property, partial
from typing import Any

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, broadcast, one_of
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot.assembly import named_frames
from pinmobile.robot.configurations import ChainConfigurations
from pinmobile.robot.engine import BODY_JOINT, Engine, Law

__all__ = ["ChainKinematics"]


class ChainKinematics(ChainConfigurations):
    """Abstract base: what follows from the Pinocchio model without its masses.

    Conventions: see `ChainDynamics`.
    """

    def pose(self, q: ArrayLike) -> Array:
        """Return x, y and psi of the body, shape (..., 3) [m, m, rad]."""
        return self._q(q)[..., :BODY_JOINT].copy()

    def rate(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the rates of x, y and psi of the body, shape (..., 3) [m/s, m/s, rad/s]."""
        q, v = self._q(q), self._v("v", v)
        lead = broadcast(q=q, v=v)
        return np.array(np.broadcast_to(v[..., :BODY_JOINT], (*lead, BODY_JOINT)))

    @cached_property
    def _frames(self) -> dict[str, int]:
        return named_frames(self._model)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of the frames: the chain's, ``base_link``, and ``name/...`` of each arm."""
        return tuple(self._frames)

    @property
    def end_effector(self) -> str:
        """Default frame: the tip of the first arm, or the body's frame where there is none."""
        return self.mounts[0].tip if self.mounts else "base_link"

    def frame_name(self, frame: str | None = None) -> str:
        """Return the name of a frame, by default that of `end_effector`.

        Raises
        ------
        UnknownName
            If there is no such frame.
        """
        return self._frame(frame)[0]

    def frame_pose(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return T_0_f, the pose of a frame, shape (..., 4, 4).

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        frame : str, optional
            One of `frame_names`; by default `end_effector`.

        Raises
        ------
        UnknownName
            If there is no such frame.
        """
        name, number = self._frame(frame)

        def pose(model: pin.Model, data: pin.Data, q: Array) -> Array:
            pin.forwardKinematics(model, data, q)
            return np.asarray(pin.updateFramePlacement(model, data, number).homogeneous)

        return self._each(Law(pose, "frame_pose", (name,)), q=self._q(q))

    def frame_jacobian(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return J, shape (..., 6, nv): J v is the velocity of the frame's origin and the angular velocity.

        Both are along the axes of the inertial frame [m/s, rad/s].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        frame : str, optional
            One of `frame_names`; by default `end_effector`.

        Raises
        ------
        UnknownName
            If there is no such frame.
        """
        name, number = self._frame(frame)

        def jacobian(model: pin.Model, data: pin.Data, q: Array) -> Array:
            J = pin.computeFrameJacobian(model, data, q, number, pin.LOCAL_WORLD_ALIGNED)
            return np.asarray(J)

        return self._each(Law(jacobian, "frame_jacobian", (name,), Engine.reorder), q=self._here(q))

    def frame_drift(self, q: ArrayLike, v: ArrayLike, frame: str | None = None) -> Array:
        """Return dJ/dt v, shape (..., 6): a frame's acceleration where no coordinate accelerates.

        Of its origin, and angular, along the axes of the inertial frame [m/s^2, rad/s^2]: J a + dJ/dt v is
        the derivative of J v, see `frame_jacobian`.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        frame : str, optional
            One of `frame_names`; by default `end_effector`.

        Raises
        ------
        UnknownName
            If there is no such frame.
        """
        name, number = self._frame(frame)

        def drift(model: pin.Model, data: pin.Data, q: Array, v: Array) -> Array:
            pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
            reference = pin.LOCAL_WORLD_ALIGNED
            return np.asarray(pin.getFrameClassicalAcceleration(model, data, number, reference).vector)

        return self._each(Law(drift, "frame_drift", (name,)), q=self._q(q), v=self._v("v", v))

    def manipulability(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return sqrt(det J J'), shape (...), of base and arm together (Yoshikawa, 1985).

        The volume of the twists that velocities of length one give, in mixed units; zero where a direction
        is lost, so always for fewer than six coordinates.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        frame : str, optional
            One of `frame_names`; by default `end_effector`.

        Raises
        ------
        UnknownName
            If there is no such frame.
        """
        name, number = self._frame(frame)
        law = Law(partial(_volume, number, slice(None)), "manipulability", (name,))
        return self._each(law, q=self._here(q))

    def arm_manipulability(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return `manipulability` of the arm that carries the frame alone, the base held, shape (...).

        Raises
        ------
        InvalidArgument
            If the frame is on no arm.
        UnknownName
            If there is no such frame.
        """
        name, number = self._frame(frame)
        arms = [mount for mount in self.mounts if name.startswith(f"{mount.name}/")]
        if not arms:
            raise InvalidArgument(f"frame is {shown(name)}, expected one of an arm")
        law = Law(partial(_volume, number, arms[0].v), "manipulability", (name, arms[0].name))
        return self._each(law, q=self._here(q))

    def _frame(self, name: str | None) -> tuple[str, int]:
        name = self.end_effector if name is None else name
        return one_of("frame", name, self._frames), self._frames[name]

    def frame_placements(self, q: ArrayLike) -> Array:
        """Return T_0_k, the pose of each joint's frame, shape (..., joints, 4, 4).

        The third is the body's; it is the last one where nothing is mounted.
        """

        def placements(model: pin.Model, data: pin.Data, q: Array) -> Array:
            pin.forwardKinematics(model, data, q)
            return np.stack([data.oMi[k].homogeneous for k in range(1, model.njoints)])

        return self._each(Law(placements), q=self._q(q))

    def jacobian(self, q: ArrayLike) -> Array:
        """Return J(psi), shape (..., nv, nv): v = J twist, with the body twist (forward, left, yaw rate).

        What comes after the base is taken over as it is.
        """
        psi = self._q(q)[..., 2]
        J = np.zeros((*psi.shape, self.nv, self.nv))
        J[...] = np.eye(self.nv)
        J[..., 0, 0] = J[..., 1, 1] = np.cos(psi)
        J[..., 1, 0] = np.sin(psi)
        J[..., 0, 1] = -J[..., 1, 0]
        return J


def _volume(frame: int, part: slice, model: pin.Model, data: pin.Data, q: Array) -> Any:
    """Return sqrt(det J J') of some columns of a frame's Jacobian."""
    J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:, part]
    # The product of the singular values: det squares what is small.
    return np.linalg.svd(J, compute_uv=False).prod() if J.shape[1] >= len(J) else 0.0
