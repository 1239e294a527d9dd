"""`WheelTree`: the Pinocchio tree of a robot whose wheels are joints."""

from __future__ import annotations

from functools import cached_property
from typing import final

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, finite_answer, frozen
from pinmobile.errors import InvalidArgument
from pinmobile.robot import BODY_JOINT, Engine, MobileRobot, System, number
from pinmobile.urdf import Body
from pinmobile.wheels.kinematics import Kinematics
from pinmobile.wheels.table import FIXED, Wheel, WheelTable


@final
class WheelTree(System):
    """The tree of a robot on wheels, and its dynamics in the coordinates of a `WheeledRobot`.

    In the tree each steered wheel has an angle of its own, right before the wheel; wheels that are steered
    together share one coordinate: v_tree = G v.

    Parameters
    ----------
    robot : MobileRobot
        The whole, wheels locked at their table angles.
    table : WheelTable
        Its wheels.
    fall : ndarray, shape (3,)
        Gravity along the axes of the plane [m/s^2].
    """

    def __init__(self, robot: MobileRobot, table: WheelTable, fall: Array) -> None:
        self._engine = Engine(_with_wheels(robot, table, fall))
        self.mounts, self.loads, self._robot, self._table = robot.mounts, robot.loads, robot, table
        self._kinematics, self._size = Kinematics.of(table), robot.nv + len(table.axes) + len(table)

    @property
    def _for_many(self) -> None:
        return None

    @cached_property
    def _reflected(self) -> Array:
        """What motors' rotors add to M, shape (nv, nv)."""
        M, first = np.zeros((self._size, self._size)), self._robot.nv
        for actuator in self._table.actuators:
            column = np.array(actuator.column)
            M[first:, first:] += actuator.motor.reflected_inertia * np.outer(column, column)
        return frozen(M)

    def state_of(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        """Return a public state as the tree's, its velocity's G, v_tree = G v, and dG/dt v."""
        lead = np.broadcast_shapes(q.shape[:-1], v.shape[:-1])
        q, v = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v))
        nv, axes = self._robot.nv, self._table.axes
        steering, rates = list(np.moveaxis(q[..., nv : nv + len(axes)], -1, 0)), v[..., nv : nv + len(axes)]
        steered = {row: k for k, axis in enumerate(axes) for row in axis.wheels}
        size = nv + len(steered) + len(self._table)
        G, bent = np.zeros((*lead, size, self._size)), np.zeros((*lead, size))
        G[..., np.arange(nv), np.arange(nv)] = 1
        angles, at = [], nv
        for row, wheel in enumerate(self._table.wheels):
            if row in steered:
                k, head = steered[row], self._kinematics.heading(row, steering)
                c, s, first, second = (number(x) for x in head)
                own = wheel.angle
                away = np.arctan2(s * np.cos(own) - c * np.sin(own), c * np.cos(own) + s * np.sin(own))
                angles.append(np.broadcast_to(away, lead))
                G[..., at, nv + k], bent[..., at] = first, second * rates[..., k] ** 2
                at += 1
            angles.append(q[..., nv + len(axes) + row])
            G[..., at, nv + len(axes) + row] = 1
            at += 1
        whole = np.concatenate([q[..., :nv], np.stack(angles, axis=-1)], axis=-1)
        return whole, np.einsum("...ij,...j->...i", G, v), G, bent

    def inertia(self, q: Array) -> Array:
        """Return M(q), shape (..., nv, nv), rotors included, unchecked."""
        if q.ndim == 1 and not self._table.axes:
            return np.array(pin.crba(self._engine.public, self._engine.data, q)) + self._reflected
        whole, _, G, _ = self.state_of(q, np.zeros(self._size))
        return np.asarray(np.swapaxes(G, -1, -2) @ self.mass_matrix(whole) @ G + self._reflected)

    def effects(self, q: Array, v: Array) -> Array:
        """Return n(q, v), shape (..., nv), unchecked."""
        whole, rates, G, bent = self.state_of(q, v)
        finite_answer(bent, q=q, v=v)
        return np.asarray(np.einsum("...ki,...k->...i", G, self.inverse_dynamics(whole, rates, bent)))

    def inertia_and_effects(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return M(q) and n(q, v), unchecked; of one state without detours."""
        if q.ndim > 1 or v.ndim > 1:
            return self.inertia(q), self.effects(q, v)
        if not self._table.axes:
            M, n = self._of_one(q, v, self._no_acceleration)
            return M + self._reflected, n
        whole, rates, G, bent = self.state_of(q, v)
        M, n = self._of_one(whole, rates, bent)
        return G.T @ M @ G + self._reflected, G.T @ n

    def _of_one(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Return the mass matrix and the inverse dynamics of one state of the tree."""
        engine = self._engine
        M = np.array(pin.crba(engine.public, engine.data, q))
        return M, np.array(pin.rnea(engine.public, engine.data, q, v, a))

    @cached_property
    def _no_acceleration(self) -> Array:
        return frozen(np.zeros(self._size))


def _steers(wheel: Wheel) -> bool:
    return wheel.steering != FIXED


def _with_wheels(robot: MobileRobot, table: WheelTable, fall: Array) -> pin.Model:
    """Return the tree of a robot whose wheels are joints, each after the steering axis that it hangs on.

    Pinocchio's CRBA takes what hangs on a joint to come right after it.
    """
    model, wheels = robot.model, sum(wheel.mass for wheel in table.wheels)
    model.gravity.linear = fall
    body = pin.Inertia(model.inertias[BODY_JOINT])
    if body.mass <= wheels:
        raise InvalidArgument(
            f"robot has a mass of {body.mass:.6g} kg, and its wheels {wheels:.6g} kg, which are part of it; "
            "expected the mass of the whole"
        )
    for wheel in table.wheels:
        body -= _placed(wheel).act(_inertia(wheel))
    model.inertias[BODY_JOINT] = _checked(body)
    for wheel in table.wheels:
        parent, place = BODY_JOINT, _placed(wheel)
        if _steers(wheel):
            pivot = pin.SE3(pin.utils.rotate("z", wheel.angle), np.array([wheel.x, wheel.y, wheel.radius]))
            parent = model.addJoint(BODY_JOINT, pin.JointModelRZ(), pivot, f"{wheel.name}_steering")
            place = pin.SE3(np.eye(3), np.array([*wheel.trail, 0.0]))
        joint = model.addJoint(parent, pin.JointModelRY(), place, wheel.name)
        model.appendBodyToJoint(joint, _inertia(wheel), pin.SE3.Identity())
    return model


def _placed(wheel: Wheel) -> pin.SE3:
    """Return the pose of a wheel's centre in the body's frame, its y along the axle, at angle zero."""
    return pin.SE3(pin.utils.rotate("z", wheel.angle), np.array([*wheel.centre, wheel.radius]))


def _inertia(wheel: Wheel) -> pin.Inertia:
    across = wheel.yaw_inertia
    return pin.Inertia(wheel.mass, np.zeros(3), np.diag([across, wheel.spin_inertia, across]))


def _checked(body: pin.Inertia) -> pin.Inertia:
    try:
        Body(body.mass, np.array(body.lever), np.array(body.inertia))
    except InvalidArgument as error:
        raise InvalidArgument(
            f"robot without its wheels is no body: {error}; expected a robot whose mass and inertia hold "
            "those of its wheels"
        ) from None
    return body
