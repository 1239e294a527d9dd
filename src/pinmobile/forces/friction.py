"""Forces that oppose motion: viscous friction, rolling resistance, friction in joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, sequence, text
from pinmobile.errors import InvalidArgument, shown
from pinmobile.forces.force import spread
from pinmobile.parts import array, option, part
from pinmobile.plant import coordinates_of

_TWIST = ("forward", "left", "yaw")


@final
@part
class ViscousFriction:
    """Friction in proportion to the body twist (u, v, r): tau = -J(psi) (c * J(psi)^T v).

    Parameters
    ----------
    coefficients : array_like, shape (3,), optional
        The c above, in place of the three that follow.
    forward, left : float, optional
        Along the body's axes [N s/m]; none where left out.
    yaw : float, optional
        Against turning [N m s], likewise.
    """

    coefficients: Any = array(
        shapes=((3,),), lower=0, unit="N s/m, N s/m, N m s", labels=_TWIST, doc="viscous friction"
    )

    def __init__(
        self,
        coefficients: ArrayLike | None = None,
        *,
        forward: float | None = None,
        left: float | None = None,
        yaw: float | None = None,
    ) -> None:
        each = forward, left, yaw
        for name, value in zip(_TWIST, each, strict=True):
            if coefficients is not None and value is not None:
                raise InvalidArgument(f"{name} is {shown(value)} beside coefficients, expected one of them")
        given = [0.0 if x is None else x for x in each] if coefficients is None else coefficients
        self.__attrs_init__(given)  # type: ignore[attr-defined]

    def __repr__(self) -> str:
        each = zip(_TWIST, self.coefficients.tolist(), strict=True)
        return f"ViscousFriction({', '.join(f'{name}={value!r}' for name, value in each)})"

    @property
    def damping(self) -> Array:
        """Factor of the twist, shape (3,) [N s/m, N s/m, N m s]."""
        return self.coefficients  # type: ignore[no-any-return]

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        cos, sin = np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = _turned(cos, -sin, v)
        return spread(_turned(cos, sin, -self.coefficients * twist), t, q)


@final
@part
class RollingResistance:
    """Rolling resistance: a force of constant size against the body twist, regularised about rest.

    Component i along the body's axes is ``-force_i nu_i / sqrt(nu_i^2 + speed_i^2)`` with the twist nu:
    linear well below `speed`, of size `force` well above it. So it is smooth, and a body on which a smaller
    force acts creeps instead of standing still. About rest it is as stiff as a damper of force / speed: an
    explicit step must be shorter than about 2 mass speed / force.
    """

    force: Any = array(
        shapes=((3,),), lower=0, unit="N, N, N m", labels=_TWIST, doc="size of the rolling resistance"
    )
    speed: Any = array(
        default=0.01,
        shapes=((), (3,)),
        above=0,
        unit="m/s, m/s, rad/s",
        labels=_TWIST,
        doc="speed at which the resistance has 71 % of its size",
    )

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        cos, sin = np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = _turned(cos, -sin, v)
        return spread(_turned(cos, sin, -self.force * twist / np.hypot(twist, self.speed)), t, q)


def _turned(cos: Array, sin: Array, vector: Array) -> Array:
    """Return the first two components turned by the angle, the third as it is, shape (..., 3)."""
    x, y = vector[..., 0], vector[..., 1]
    along = cos * x - sin * y
    turned = np.empty((*along.shape, 3))
    turned[..., 0] = along
    turned[..., 1] = sin * x + cos * y
    turned[..., 2] = vector[..., 2]
    return turned


def _checked_names(name: str, value: object) -> tuple[str, ...]:
    given = sequence(name, value, "names of the coordinates")
    return tuple(text(f"{name}[{k}]", each) for k, each in enumerate(given))


def _names(friction: JointFriction) -> Sequence[str]:
    return friction.names


@final
@part
class JointFriction:
    """Viscous and dry friction of each coordinate, the dry one regularised about rest.

    Coordinate i feels ``-viscous_i v_i - coulomb_i v_i / sqrt(v_i^2 + speed_i^2)``: smooth, so that a joint
    on which a smaller force acts creeps instead of standing still. About rest the dry part is as stiff as a
    damper of coulomb / speed: an explicit step must be shorter than about 2 inertia speed / coulomb.
    """

    viscous: Any = array(
        shapes=((), ("n",)),
        lower=0,
        unit="N s/m or N m s/rad",
        labels=_names,
        doc="viscous friction of the coordinates",
    )
    coulomb: Any = array(
        default=0.0,
        shapes=((), ("n",)),
        lower=0,
        unit="N or N m",
        labels=_names,
        doc="dry friction of the coordinates",
    )
    speed: Any = array(
        default=0.01,
        shapes=((), ("n",)),
        above=0,
        unit="m/s or rad/s",
        doc="speed at which dry friction has 71 % of its size",
    )
    names: Sequence[str] = option(default=(), check=_checked_names, doc="names of the coordinates")

    def check(self) -> None:
        """Raise `InvalidArgument` where the arrays are of different numbers of coordinates."""
        sizes = {name: np.size(x) for name, x in vars(self).items() if np.ndim(x) and len(x)}
        if len(set(sizes.values())) > 1:
            told = ", ".join(f"{name} {size}" for name, size in sizes.items())
            raise InvalidArgument(f"numbers of coordinates are {told}, expected as many of each")

    @classmethod
    def of(cls, robot: Any, speed: ArrayLike = 0.01) -> Self:
        """Return the friction that the files of a robot's arms have.

        Parameters
        ----------
        robot : MobileRobot
            Its `joint_damping` and `joint_friction` are taken, and the names of its coordinates; the base
            has none.
        speed : array_like, shape () or (nv,)
            As in the class.

        Raises
        ------
        InvalidArgument
            If it has no such properties.
        """
        asked = ("joint_damping", "joint_friction", "coordinates")
        missing = [name for name in asked if not hasattr(robot, name)]
        if isinstance(robot, type) or missing:
            raise InvalidArgument(f"robot is {shown(robot)}, expected a MobileRobot")
        names = [one.name for one in coordinates_of(robot)]
        return cls(robot.joint_damping, robot.joint_friction, speed, names)

    @property
    def damping(self) -> Array:
        """Factor of the velocities, shape () or (nv,) [N s/m or N m s/rad]."""
        return np.asarray(self.viscous)

    def on_coordinates(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., nv) [N or N m].

        Raises
        ------
        InvalidArgument
            If it is the friction of another number of coordinates.
        """
        for name in ("viscous", "coulomb", "speed"):
            shape = np.shape(getattr(self, name))
            if shape and shape[-1] != v.shape[-1]:
                raise InvalidArgument(f"{name} has shape {shape}, expected () or ({v.shape[-1]},), as v has")
        return -self.viscous * v - self.coulomb * v / np.hypot(v, self.speed)  # type: ignore[no-any-return]
