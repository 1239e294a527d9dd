"""What wheels stand on: ground on which they roll ideally or slip, level or a ramp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import cos, pi, sin
from typing import ClassVar, final

from pinmobile.arrays import Array, frozen, non_negative, positive, scalar, whole
from pinmobile.constancy import constant
from pinmobile.errors import InvalidArgument, shown
from pinmobile.wheels.platform import Platform
from pinmobile.wheels.slipping import led


@final
@constant
@dataclass(frozen=True)
class Ramp:
    """A plane that rises; x, y and psi are then those in the plane.

    Parameters
    ----------
    angle : float
        Of the plane with the level, in [0, pi / 2) [rad].
    direction : float
        Of the way straight up, from the inertial x axis [rad].
    """

    angle: float
    direction: float = 0.0

    def __post_init__(self) -> None:
        angle = scalar("angle of a Ramp", self.angle)
        if not 0 <= angle < pi / 2:
            raise InvalidArgument(f"angle of a Ramp is {angle:g} rad, expected one in [0, pi / 2)")
        object.__setattr__(self, "angle", angle)
        object.__setattr__(self, "direction", scalar("direction of a Ramp", self.direction))

    def fall(self, g: float) -> Array:
        """Return gravity along the axes of the plane, shape (3,) [m/s^2], from what it is straight down."""
        g = scalar("g", g)
        down = -g * sin(self.angle)
        return frozen([down * cos(self.direction), down * sin(self.direction), -g * cos(self.angle)])


def _ramp(ramp: object) -> None:
    if ramp is not None and not isinstance(ramp, Ramp):
        raise InvalidArgument(f"ramp is {shown(ramp)}, expected a Ramp(angle, direction) or None")


@final
@constant
@dataclass(frozen=True)
class Rolling:
    """Wheels roll without slip, whatever force that takes: constraints on the velocities.

    Parameters
    ----------
    ramp : Ramp, optional
        Which way the ground rises; None: it is level.

    Attributes
    ----------
    slips : bool
        Whether wheels may slip, here False.
    """

    ramp: Ramp | None = None
    slips: ClassVar[bool] = False
    mu: ClassVar[None] = None
    rounds: ClassVar[Mapping[str, float]] = {}

    def __post_init__(self) -> None:
        _ramp(self.ramp)

    def of_each_wheel(self) -> Rolling:
        """Return the ground on which each wheel has friction of its own: itself."""
        return self

    def check(self, platform: Platform, inertias: Array) -> None:
        """Refuse steering that nothing holds and that has no inertia.

        Parameters
        ----------
        platform : Platform
            What stands on it.
        inertias : ndarray, shape (axes + wheels,)
            Diagonal of its mass matrix, of steering axes and wheels [kg m^2].
        """
        for k in platform.mobility.choice.free:
            if not inertias[k] > 0:
                axis = platform.table.axes[k]
                wheel = platform.table.names[axis.wheels[0]]
                raise InvalidArgument(
                    f"{axis.name} of the table has no inertia about its axis, expected one > 0: give "
                    f"yaw_inertia of wheel {wheel!r}"
                )


@final
@constant
@dataclass(frozen=True)
class Coulomb:
    """Wheels stick while the ground can hold them, and slide beyond: dry friction of Coulomb's law.

    A robot on such ground has a step of its own: implicit in the velocities, impulses of all wheels found
    together, so that what sticks is at rest exactly and nothing is stiff. Steps of 0.01 s and less are of
    use; the error of fixed wheels falls with the square of the step, that of steered ones with the step.

    Loads depend on accelerations, these on friction, and friction on the loads: a step solves for all of
    them. Where friction presses the wheels on which it acts there may be several solutions. The step takes
    the one to which the accelerations of the step before lead; the signals state it: ``slides``, ``loads``
    and ``tips``, 1 where no loads balance the robot. ``missed`` is 1 where the step found no solution.

    Parameters
    ----------
    mu : float, optional
        Coefficient of friction of all wheels, along the axes of rollers for those that have some; None: each
        wheel's own, ``wheel.friction.mu``.
    ramp : Ramp, optional
        Which way the ground rises; None: it is level.
    sweeps : int
        Most rounds over all wheels in a pass; the signal ``missed`` says where they were too few.
    tolerance : float
        Largest change of a force in a round, as a share of the largest friction, at which it has been found.

    Attributes
    ----------
    slips : bool
        Whether wheels may slip, here True.
    """

    mu: float | None = None
    ramp: Ramp | None = None
    sweeps: int = 200
    tolerance: float = 1e-12
    slips: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _ramp(self.ramp)
        if self.mu is not None:
            object.__setattr__(self, "mu", non_negative("mu", self.mu))
        object.__setattr__(self, "sweeps", whole("sweeps", self.sweeps, least=1))
        object.__setattr__(self, "tolerance", positive("tolerance", self.tolerance))

    @property
    def rounds(self) -> Mapping[str, float]:
        """How its forces are found, by name."""
        return {name: getattr(self, name) for name in ("sweeps", "tolerance")}

    def of_each_wheel(self) -> Coulomb:
        """Return the ground on which each wheel has friction of its own."""
        return replace(self, mu=None)

    def check(self, platform: Platform, inertias: Array) -> None:
        """Refuse what cannot be computed where wheels slip: see `Rolling.check`."""
        if not platform.grounded:
            raise InvalidArgument(
                "robot does not tell where its body's origin is above the ground, on which the loads of its "
                "wheels depend; expected one read with ground=, or ground=Rolling()"
            )
        led(platform.table)
        platform._check_places()
        names = (*(axis.name for axis in platform.table.axes), *platform.table.names)
        for name, inertia in zip(names, inertias, strict=True):
            if not inertia > 0:
                raise InvalidArgument(
                    f"{name} of the table has no inertia about its axis, expected one > 0 where wheels slip: "
                    "give spin_inertia, and yaw_inertia of wheels that steer"
                )


Ground = Rolling | Coulomb
