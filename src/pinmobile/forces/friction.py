"""Forces that oppose motion: viscous friction, rolling resistance, friction in joints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, frozen, sequence, text
from pinmobile.errors import InvalidArgument, shown
from pinmobile.forces.force import not_below_zero, numbers, spread, triple
from pinmobile.plant import Parameter, coordinates_of

_TWIST = ("forward", "left", "yaw")


def _broadcast(named: Mapping[str, Array]) -> tuple[Array, ...]:
    """Return arrays as of one shape.

    Raises
    ------
    InvalidArgument
        If their shapes do not fit.
    """
    try:
        return np.broadcast_arrays(*named.values())
    except ValueError:
        shapes = ", ".join(f"{name} {value.shape}" for name, value in named.items())
        raise InvalidArgument(f"shapes are {shapes}, expected shapes that broadcast") from None


@final
@dataclass(frozen=True, eq=False, init=False, repr=False)
class ViscousFriction:
    """Friction in proportion to the body twist (u, v, r): tau = -J(psi) (c * J(psi)^T v).

    Parameters
    ----------
    coefficients : array_like, shape (..., 3), optional
        The c above, in place of the three that follow.
    forward, left : array_like, shape (...)
        Along the body's axes [N s/m], not below zero; none where left out.
    yaw : array_like, shape (...)
        Against turning [N m s], likewise.

    Raises
    ------
    InvalidArgument
        If one has another shape, is not finite, or below zero; or if both ways to say it are taken.
    """

    coefficients: ArrayLike

    parameters: ClassVar[tuple[Parameter, ...]] = tuple(
        Parameter(
            f"viscous_{axis}", unit, f"viscous friction, {axis}", 0.0, attribute="coefficients", entry=k
        )
        for k, (axis, unit) in enumerate(zip(_TWIST, ("N s/m", "N s/m", "N m s"), strict=True))
    )

    @classmethod
    def nothing(cls) -> Self:
        """Return the force that is none, which a spread gives its size."""
        return cls(np.zeros(3))

    def __init__(
        self,
        coefficients: ArrayLike | None = None,
        *,
        forward: ArrayLike | None = None,
        left: ArrayLike | None = None,
        yaw: ArrayLike | None = None,
    ) -> None:
        said = {"forward": forward, "left": left, "yaw": yaw}
        given = {name: 0.0 if value is None else value for name, value in said.items()}
        each = {name: not_below_zero(name, numbers(name, value)) for name, value in given.items()}
        if coefficients is None:
            checked = frozen(np.stack(_broadcast(each), axis=-1))
        else:
            for name, value in said.items():
                if value is not None:
                    raise InvalidArgument(
                        f"{name} is {shown(value)} beside coefficients, expected one of them"
                    )
            checked = not_below_zero("coefficients", triple("coefficients", coefficients))
        object.__setattr__(self, "coefficients", checked)

    def __repr__(self) -> str:
        each = np.moveaxis(self.damping, -1, 0).tolist()
        told = (f"{name}={value!r}" for name, value in zip(_TWIST, each, strict=True))
        return f"ViscousFriction({', '.join(told)})"

    @property
    def damping(self) -> Array:
        """What the twist is multiplied by, shape (..., 3) [N s/m, N s/m, N m s]."""
        return np.asarray(self.coefficients)

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        cos, sin = np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = _turned(cos, -sin, v)
        return spread(_turned(cos, sin, -np.asarray(self.coefficients) * twist), t, q)


@final
@dataclass(frozen=True, eq=False)
class RollingResistance:
    """Rolling resistance: a force of constant size against the body twist, regularised about rest.

    Component i along the body's axes is ``-force_i nu_i / sqrt(nu_i^2 + speed_i^2)`` with the twist nu:
    linear well below `speed`, of size `force` well above it. So it is smooth, and a body on which a smaller
    force acts creeps instead of standing still. About rest it is as stiff as a damper of force / speed: an
    explicit step must be shorter than about 2 mass speed / force.

    Parameters
    ----------
    force : array_like, shape (..., 3)
        Size forward, left and in yaw [N, N, N m], not below zero.
    speed : array_like, shape (), (3,) or (..., 3)
        Where the resistance has reached 71 % of its size [m/s, m/s, rad/s], above zero.

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, a force below zero, or a speed not above it.
    """

    force: ArrayLike
    speed: ArrayLike = 0.01

    parameters: ClassVar[tuple[Parameter, ...]] = (
        *(
            Parameter(f"rolling_{axis}", unit, f"rolling resistance, {axis}", 0.0, attribute="force", entry=k)
            for k, (axis, unit) in enumerate((("forward", "N"), ("left", "N"), ("yaw", "N m")))
        ),
        Parameter(
            "rolling_speed", "m/s, rad/s", "where it has 71 % of its size", 0.0, False, attribute="speed"
        ),
    )

    @classmethod
    def nothing(cls) -> Self:
        """Return the force that is none, which a spread gives its size."""
        return cls(np.zeros(3))

    def __post_init__(self) -> None:
        force = not_below_zero("force", triple("force", self.force))
        speed = numbers("speed", self.speed)
        if speed.ndim and speed.shape[-1] != 3:
            raise InvalidArgument(f"speed has shape {speed.shape}, expected (), (3,) or (..., 3)")
        if not (speed > 0).all():
            raise InvalidArgument(f"speed is {speed.min()}, expected > 0")
        try:
            np.broadcast_shapes(force.shape, speed.shape)
        except ValueError:
            raise InvalidArgument(
                f"force and speed have shapes {force.shape} and {speed.shape}, expected shapes that broadcast"
            ) from None
        object.__setattr__(self, "force", force)
        object.__setattr__(self, "speed", speed)

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        cos, sin = np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = _turned(cos, -sin, v)
        return spread(_turned(cos, sin, -np.asarray(self.force) * twist / np.hypot(twist, self.speed)), t, q)


def _turned(cos: Array, sin: Array, vector: Array) -> Array:
    """Return the first two components turned by the angle, the third as it is, shape (..., 3)."""
    x, y = vector[..., 0], vector[..., 1]
    along = cos * x - sin * y
    turned = np.empty((*along.shape, 3))
    turned[..., 0] = along
    turned[..., 1] = sin * x + cos * y
    turned[..., 2] = vector[..., 2]
    return turned


_OF_ALL = (
    Parameter("joint_viscous", "N s/m, N m s/rad", "viscous friction", 0.0, attribute="viscous"),
    Parameter("joint_coulomb", "N, N m", "dry friction", 0.0, attribute="coulomb"),
    Parameter("joint_speed", "m/s, rad/s", "where dry friction has 71 %", 0.0, False, attribute="speed"),
)


def _parameters(names: Sequence[str]) -> tuple[Parameter, ...]:
    """Return the parameters of all coordinates together, then of each that has a name."""
    own = (
        replace(each, name=f"{each.name}_{name}", meaning=f"{each.meaning} of {name}", entry=k)
        for each in _OF_ALL[:2]
        for k, name in enumerate(names)
    )
    return (*_OF_ALL, *own)


@final
@dataclass(frozen=True, eq=False)
class JointFriction:
    """Viscous and dry friction of each coordinate, the dry one regularised about rest.

    Coordinate i feels ``-viscous_i v_i - coulomb_i v_i / sqrt(v_i^2 + speed_i^2)``: smooth, so that a joint
    on which a smaller force acts creeps instead of standing still. About rest the dry part is as stiff as a
    damper of coulomb / speed: an explicit step must be shorter than about 2 inertia speed / coulomb.

    Parameters
    ----------
    viscous : array_like, shape () or (..., nv)
        Of each coordinate [N s/m or N m s/rad], not below zero.
    coulomb : array_like, shape () or (..., nv)
        Size of the dry friction [N or N m], not below zero.
    speed : array_like, shape () or (..., nv)
        Where the dry friction has reached 71 % of its size [m/s or rad/s], above zero.
    names : sequence of str
        Of the coordinates: each then has parameters of its own, such as ``"joint_viscous_psi"``.

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, a friction below zero, or a speed not above it.
    """

    viscous: ArrayLike
    coulomb: ArrayLike = 0.0
    speed: ArrayLike = 0.01
    names: Sequence[str] = ()
    dry: bool = field(default=True, init=False, repr=False)

    parameters: ClassVar[tuple[Parameter, ...]] = _OF_ALL

    def __post_init__(self) -> None:
        given = {name: numbers(name, getattr(self, name)) for name in ("viscous", "coulomb", "speed")}
        for name in ("viscous", "coulomb"):
            not_below_zero(name, given[name])
        if not (given["speed"] > 0).all():
            raise InvalidArgument(f"speed is {given['speed'].min()}, expected > 0")
        _broadcast(given)
        names = sequence("names", self.names, "names of the coordinates")
        own = [text(f"names[{k}]", name) for k, name in enumerate(names)]
        for name in ("viscous", "coulomb") if own else ():
            if given[name].shape not in ((), (len(own),)):
                raise InvalidArgument(f"{name} has shape {given[name].shape}, expected () or ({len(own)},)")
            given[name] = np.broadcast_to(given[name], len(own))
        for name, value in {**given, "names": tuple(own), "parameters": _parameters(own)}.items():
            object.__setattr__(self, name, value)

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

    def varying(self, entries: Iterable[tuple[str, object]]) -> Self:
        """Return it, told what differs from robot to robot: where dry friction is zero for all, without it.

        Parameters
        ----------
        entries : iterable of (str, int)
            Attribute and entry of each.
        """
        dry = bool(np.any(self.coulomb)) or any(name == "coulomb" for name, _ in entries)
        return self if dry == self.dry else self._kept(replace(self), dry)

    def _kept(self, other: Self, dry: bool) -> Self:
        object.__setattr__(other, "dry", dry)
        return other

    def with_parameters(self, **values: Any) -> Self:
        """Return it with other values; what was told of what differs stays.

        Parameters
        ----------
        **values : array_like
            By attribute: viscous, coulomb, speed.
        """
        other = replace(self, **values)
        return self._kept(other, self.dry or bool(np.any(other.coulomb)))

    @property
    def damping(self) -> Array:
        """What velocities are multiplied by, shape () or (..., nv) [N s/m or N m s/rad]."""
        return np.asarray(self.viscous)

    def on_coordinates(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., nv) [N or N m].

        Raises
        ------
        InvalidArgument
            If it is the friction of another number of coordinates.
        """
        viscous, coulomb, speed = (np.asarray(x) for x in (self.viscous, self.coulomb, self.speed))
        for name, value in (("viscous", viscous), ("coulomb", coulomb), ("speed", speed)):
            if value.ndim and value.shape[-1] != v.shape[-1]:
                raise InvalidArgument(
                    f"{name} has shape {value.shape}, expected () or (..., {v.shape[-1]}), as v has"
                )
        found: Array = -viscous * v
        return found - coulomb * v / np.hypot(v, speed) if self.dry else found
