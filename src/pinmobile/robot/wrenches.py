"""Wrenches inside a robot and between it and the ground, in the body's frame."""

from functools import cached_property

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, one_of
from pinmobile.errors import InvalidArgument
from pinmobile.robot.dynamics import ChainDynamics
from pinmobile.robot.engine import BODY_JOINT, Law
from pinmobile.robot.mounts import Mount

__all__ = ["ChainWrenches"]


class ChainWrenches(ChainDynamics):
    """Abstract base: the forces that Newton and Euler ask for between the bodies of the Pinocchio model.

    A wrench is (fx, fy, fz, mx, my, mz) [N, N, N, N m, N m, N m]. What rotors add to a joint's torque by
    their own spin is not in it. Other conventions: see `ChainDynamics`.
    """

    @cached_property
    def weight(self) -> float:
        """Weight of the robot with all that it carries [N]."""
        return float(pin.computeTotalMass(self._model) * np.linalg.norm(self._model.gravity.linear))

    def ground_wrench(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return what the ground exerts on the robot that moves so, shape (..., 6).

        Along the axes of the body's frame B, with the moment about its origin, which lies on the ground: the
        rate of the momentum of all bodies, less gravity. Whatever else acts from outside is in it.
        """
        return self._each(_GROUND_WRENCH, q=self._q(q), v=self._v("v", v), a=self._v("a", a))

    def mount_wrench(self, q: ArrayLike, v: ArrayLike, a: ArrayLike, mount: str | None = None) -> Array:
        """Return what an arm, with the loads on it, exerts on the body at its mount, shape (..., 6).

        Along the axes of the body's frame B (not turned by the mount's yaw), with the moment about the point
        of the mount. An arm at rest exerts its weight, (0, 0, -m g), and the moment of that,
        (-m g y, m g x, 0) with its centre of mass at x and y from the mount.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v, a : array_like, shape (..., nv)
            Velocity and acceleration [m/s, m/s, rad/s, ...; per s].
        mount : str, optional
            Name of one of `mounts`; by default that of the first.

        Raises
        ------
        InvalidArgument
            If no arm is mounted.
        UnknownName
            If nothing is mounted by that name.
        """
        arm = self._mount(mount)
        roots = [joint for joint in _joints(arm) if self._model.parents[joint] == BODY_JOINT]
        fixed = self._fixed(arm)
        to_mount = pin.SE3(np.eye(3), np.array(arm.at[:3])).inverse()

        def wrench(model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array) -> Array:
            pin.rnea(model, data, q, v, a)
            twist = data.v[BODY_JOINT]
            held = fixed * data.a_gf[BODY_JOINT] + twist.cross(fixed * twist)
            for joint in roots:
                held += data.liMi[joint].act(data.f[joint])
            return 0.0 - np.asarray(to_mount.act(held).vector)

        law = Law(wrench, "mount_wrench", (arm.name,))
        return self._each(law, q=self._q(q), v=self._v("v", v), a=self._v("a", a))

    def _mount(self, name: str | None) -> Mount:
        if not self.mounts:
            raise InvalidArgument("robot carries no arm, expected one: robot.mount(...)")
        known = {mount.name: mount for mount in self.mounts}
        wanted = self.mounts[0].name if name is None else name
        return known[one_of("mount", wanted, known)]

    def _fixed(self, mount: Mount) -> pin.Inertia:
        """Return the inertia, in the body's frame, of what of an arm does not move on the body."""
        fixed = mount.placement.act(mount._model.inertias[0])
        for name, load in self.loads:
            frame = self._model.frames[self._frames[name]]
            if frame.parentJoint == BODY_JOINT and name.startswith(f"{mount.name}/"):
                fixed += frame.placement.act(load.body)
        return fixed


def _ground_wrench(model: pin.Model, data: pin.Data, q: Array, v: Array, a: Array) -> Array:
    pin.rnea(model, data, q, v, a)
    return np.asarray(data.f[BODY_JOINT].vector)


_GROUND_WRENCH = Law(_ground_wrench, "ground_wrench")


def _joints(mount: Mount) -> range:
    return range(mount.joints.start, mount.joints.stop)
