"""The wheels of a model and their swivels, at rest: what a `WheelTable` is made from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.robot.linkage import Joint, turns_freely

_TRAIL = 1e-3  # [m]: a wheel nearer to its swivel than that does not trail
_ALONG = 0.995
"""Cosine beyond which two directions are the same: files have angles such as 1.57."""

Triple = tuple[float, float, float]


class Lump(NamedTuple):
    """Links that move together, at rest.

    Attributes
    ----------
    mass : float
        [kg]; zero of links that have none.
    com : tuple of 3 floats
        Centre of mass in the body's frame B [m].
    inertia : tuple of 3 tuples of 3 floats
        About it, along the axes of B [kg m^2].
    """

    mass: float
    com: Triple
    inertia: tuple[Triple, Triple, Triple]


class Swivel(NamedTuple):
    """A joint about the vertical that carries a wheel.

    Attributes
    ----------
    name : str
        Of the joint.
    x, y : float
        Where its axis stands in B [m].
    limit : float
        Largest angle to either side [rad]; infinite: it turns freely.
    lump : Lump
        All that turns with it, wheels included.
    """

    name: str
    x: float
    y: float
    limit: float
    lump: Lump

    def turning(self, wheel: WheelJoint, across: float) -> tuple[float, float]:
        """Return mass and yaw inertia that, at the wheel's centre, turn as all on the swivel does.

        A rigid body about a pivot acts in the plane by its first and second moment about it. A mass at the
        centre has the first one, along the trail; the rest of it is at the pivot, with the body. Where that
        is no mass, or nothing trails, the wheel's own is returned, the rest as at the pivot.

        Parameters
        ----------
        wheel : WheelJoint
            The wheel.
        across : float
            Its own inertia across its axle [kg m^2].
        """
        fork = self._about(self.lump) - self._about(wheel.lump)
        o = np.array([wheel.centre[0] - self.x, wheel.centre[1] - self.y])
        square = float(o @ o)
        if square > _TRAIL**2:
            first = self.lump.mass * float(o @ [self.lump.com[0] - self.x, self.lump.com[1] - self.y])
            mass = first / square
            yaw = fork + across + wheel.lump.mass * self._square(wheel.lump) - mass * square
            if mass > 0 and yaw > 0:
                return mass, yaw
        return wheel.lump.mass, across + max(fork, 0.0)

    def _square(self, lump: Lump) -> float:
        return (lump.com[0] - self.x) ** 2 + (lump.com[1] - self.y) ** 2

    def _about(self, lump: Lump) -> float:
        """Return the inertia of links about the axis [kg m^2]."""
        return lump.inertia[2][2] + lump.mass * self._square(lump)


class WheelJoint(NamedTuple):
    """A wheel of a model, at rest.

    Attributes
    ----------
    name : str
        Of the joint that is its axle.
    joint : int
        Number of that joint.
    centre : tuple of 3 floats
        Of the wheel, on its axle, in B [m].
    axis : tuple of 3 floats
        Unit vector of the axle there, level, in the sense that the joint turns.
    radius : float or None
        None where the model does not tell [m].
    lump : Lump
        All that turns with it.
    swivels : tuple of Swivel
        On the way from the body to it.
    carried : tuple of str
        Joints on it, such as those of rollers.
    effort : float
        Largest torque of the joint [N m]; infinite where there is none.
    damping, friction : float
        Of the joint [N m s/rad, N m].
    """

    name: str
    joint: int
    centre: Triple
    axis: Triple
    radius: float | None
    lump: Lump = Lump(0.0, (0.0, 0.0, 0.0), ((0.0, 0.0, 0.0),) * 3)
    swivels: tuple[Swivel, ...] = ()
    carried: tuple[str, ...] = ()
    effort: float = np.inf
    damping: float = 0.0
    friction: float = 0.0

    def moments(self) -> tuple[float, tuple[float, float], float, float]:
        """Return what tells a solid of revolution about its axle.

        Returns
        -------
        spin : float
            Moment about the axle [kg m^2].
        across : tuple of 2 floats
            Those across it, level and vertical [kg m^2].
        product : float
            The largest product of inertia in these axes [kg m^2].
        aside : float
            Distance of the centre of mass from the axle [m].
        """
        axle = np.array(self.axis)
        frame = np.stack([axle, np.cross([0.0, 0.0, 1.0], axle), [0.0, 0.0, 1.0]])
        inertia = frame @ np.array(self.lump.inertia) @ frame.T
        spin, level, vertical = inertia.diagonal().tolist()
        product = float(np.abs(inertia[np.triu_indices(3, 1)]).max())
        aside = np.linalg.norm(np.cross(np.subtract(self.lump.com, self.centre), axle))
        return spin, (level, vertical), product, float(aside)


class Undercarriage(NamedTuple):
    """What a robot stands on, as its model has it.

    Attributes
    ----------
    wheels : tuple of WheelJoint
        In the order of the model.
    supports : tuple of (float, float)
        Where what does not roll touches the ground, in B [m]: fixed casters and skids.
    """

    wheels: tuple[WheelJoint, ...] = ()
    supports: tuple[tuple[float, float], ...] = ()


def triple(values: Iterable[float]) -> Triple:
    """Return three numbers as floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def joint_axis(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Array:
    """Return the axis about which a joint turns, seen from a base; zeros where it slides."""
    # Of a model with one joint Pinocchio returns it without the second axis.
    jacobian = pin.getJointJacobian(model, data, joint, pin.WORLD).reshape(6, -1)
    return np.asarray(base.rotation.T @ jacobian[3:, model.idx_vs[joint]])


def seen_from(base: pin.SE3, joint: pin.SE3, own: Any) -> Any:
    """Return a placement or an inertia of a joint's frame in that of a base, to the last digit where same."""
    if joint == base:
        return own
    to_base = base.inverse() * joint
    return to_base.act(own)


def undercarriage_of(
    model: pin.Model,
    data: pin.Data,
    base: pin.SE3,
    root: int,
    wheels: Sequence[WheelJoint],
    supports: Sequence[tuple[float, float]],
    ground: float,
) -> Undercarriage:
    """Return the undercarriage of a model.

    Parameters
    ----------
    model, data
        With all joints at rest, Jacobians computed.
    base : pin.SE3
        Pose of B.
    root : int
        The joint of the root link.
    wheels : sequence of WheelJoint
        As `wheels_of` returns them.
    supports : sequence of (float, float)
        Where what does not roll touches the ground, in B [m].
    ground : float
        z of B in the frame of the root link [m].
    """
    found = []
    for wheel in wheels:
        swivels, joint = [], int(model.parents[wheel.joint])
        while joint > root:
            if model.nvs[joint] == 1 and abs(joint_axis(model, data, base, joint)[2]) > _ALONG:
                swivels.append(_swivel(model, data, base, joint))
            joint = int(model.parents[joint])
        hub = (base.inverse() * data.oMi[wheel.joint]).translation
        along = np.array(wheel.centre) - [0, 0, ground] - hub
        v, centre = model.idx_vs[wheel.joint], triple(hub + (along @ wheel.axis) * np.array(wheel.axis))
        lump = _lump_of(model, data, base, wheel.joint)
        effort, damping, friction = (float(x[v]) for x in (model.effortLimit, model.damping, model.friction))
        placed = wheel._replace(centre=centre, lump=lump, swivels=tuple(swivels))
        most = effort if effort > 0 else np.inf
        found.append(placed._replace(effort=most, damping=damping, friction=friction))
    return Undercarriage(tuple(found), tuple(supports))


def _lump_of(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Lump:
    total = pin.Inertia.Zero()
    for each in model.subtrees[joint]:
        if model.inertias[each].mass > 0:
            total += (base.inverse() * data.oMi[each]).act(model.inertias[each])
    first, second, third = (triple(row) for row in total.inertia)
    at = total.lever if total.mass > 0 else (base.inverse() * data.oMi[joint]).translation
    return Lump(float(total.mass), triple(at), (first, second, third))


def _swivel(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Swivel:
    x, y, _ = triple((base.inverse() * data.oMi[joint]).translation)
    limit = np.inf
    if not turns_freely(model, joint):
        q = Joint.of(model, joint).q
        limit = min(abs(float(model.lowerPositionLimit[q][0])), abs(float(model.upperPositionLimit[q][0])))
    return Swivel(str(model.names[joint]), x, y, limit, _lump_of(model, data, base, joint))
