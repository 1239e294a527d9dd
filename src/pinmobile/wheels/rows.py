"""What a wheel table is made of: wheels, supports, couplings; coordinates and inputs that follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import NamedTuple, Protocol, final, runtime_checkable

import numpy as np

from pinmobile.arrays import (
    finite,
    non_negative,
    one_of,
    positive,
    positive_or_endless,
    scalar,
    sequence,
    text,
)
from pinmobile.constancy import constant
from pinmobile.errors import InvalidArgument, shown
from pinmobile.wheels.motors import Motor

FIXED, DRIVEN, FREE = "fixed", "driven", "free"
_STEERING = (FIXED, DRIVEN, FREE)
_LARGEST_ROLLER = 89.0  # degrees: nearer to 90, a turn of the wheel moves next to nothing along the rollers
TORQUE = Motor()  # a source of torque without limits


@final
@constant
@dataclass(frozen=True)
class Friction:
    """Dry friction between a wheel and the ground, and in the wheel.

    The defaults are usual magnitudes, not measurements.

    Parameters
    ----------
    mu : float
        Coefficient of friction: of a tyre in all directions, of a wheel with rollers along their axes.
    across : float
        That across the axes of rollers, which turn in their bearings.
    rolling : float
        Rolling resistance as a share of the load: a torque of at most ``rolling * radius * load`` that holds
        the wheel at rest.
    slip : float
        Slip velocity per force before the wheel slides [m/(N s)]; 0: none, which is Coulomb's law.
    """

    mu: float = 0.8
    across: float = 0.02
    rolling: float = 0.01
    slip: float = 0.0

    def __post_init__(self) -> None:
        for name, unit in (("mu", ""), ("across", ""), ("rolling", ""), ("slip", "m/(N s)")):
            object.__setattr__(self, name, non_negative(name, getattr(self, name), unit))


@final
@constant
@dataclass(frozen=True)
class Wheel:
    """One row of a wheel table.

    The wheel rolls along e = (cos angle, sin angle) of the body's frame where its rate is positive; n, a
    quarter of a turn to the left of e, is the direction of its axle.

    Parameters
    ----------
    name : str
        Its own; its coordinate is called so.
    x, y : float
        Where its steering pivot stands in the body's frame, or its centre where it does not steer [m].
    radius : float
        [m].
    angle : float
        Of its rolling direction e from the body's x [rad]; where it steers, at steering angle zero.
    steering : str
        ``"fixed"``; ``"driven"`` by an actuator about the vertical through its pivot; ``"free"``, as casters.
    trail : sequence of 2 floats
        Its centre from the pivot along e and n [m]; a caster trails: the first is negative.
    roller : float, optional
        Angle of the axis of the roller that is at the ground, from e [rad]; None: a tyre. Of an omni wheel 0,
        of a mecanum wheel pi / 4 or -pi / 4, the mirror of what is seen from above.
    mass : float
        [kg], part of the robot's whole.
    spin_inertia, yaw_inertia : float
        About the axle, and about the vertical through its centre [kg m^2]; what a motor's rotor adds is in
        `motor`.
    motor : Motor, optional
        What drives it; None: nothing, it only rolls along.
    friction : Friction
        Of its own.
    steering_limit : float
        Largest steering angle, to either side [rad]: a stop without rebound, found to what turns in a step.

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range, or a name is none.
    """

    name: str
    x: float
    y: float
    radius: float
    angle: float = 0.0
    steering: str = FIXED
    trail: tuple[float, float] = (0.0, 0.0)
    roller: float | None = None
    mass: float = 0.0
    spin_inertia: float = 0.0
    yaw_inertia: float = 0.0
    motor: Motor | None = None
    friction: Friction = Friction()
    steering_limit: float = np.inf

    def __post_init__(self) -> None:
        name = text("name", self.name)
        if not name.strip() or set('/,":') & set(name):
            raise InvalidArgument(
                f"name is {shown(name)}, expected a word without slash, comma, colon and quotation mark"
            )
        own = f"of wheel {name!r}"
        numbers = {key: scalar(f"{key} {own}", getattr(self, key)) for key in ("x", "y", "angle")}
        numbers["radius"] = positive(f"radius {own}", self.radius, "m")
        for key, unit in (("mass", "kg"), ("spin_inertia", "kg m^2"), ("yaw_inertia", "kg m^2")):
            numbers[key] = non_negative(f"{key} {own}", getattr(self, key), unit)
        one_of(f"steering {own}", self.steering, _STEERING)
        trail = finite(f"trail {own}", self.trail)
        if trail.shape != (2,):
            raise InvalidArgument(f"trail {own} has shape {trail.shape}, expected (2,): along e and n")
        if self.roller is not None:
            numbers["roller"] = self._roller(own)
        for key, kind in (("motor", Motor), ("friction", Friction)):
            value = getattr(self, key)
            if not isinstance(value, kind) and not (key == "motor" and value is None):
                raise InvalidArgument(f"{key} {own} is {shown(value)}, expected a {kind.__name__}")
        numbers["steering_limit"] = positive_or_endless(f"steering_limit {own}", self.steering_limit, "rad")
        for key, value in {**numbers, "trail": tuple(trail.tolist())}.items():
            object.__setattr__(self, key, value)

    def _roller(self, own: str) -> float:
        angle = scalar(f"roller {own}", self.roller)  # type: ignore[arg-type]
        if not abs(angle) <= radians(_LARGEST_ROLLER):
            raise InvalidArgument(
                f"roller {own} is {angle:.6g} rad, expected less than a right angle from the rolling "
                "direction (up to 89 degrees): the wheel could not drive"
            )
        return angle

    @property
    def centre(self) -> tuple[float, float]:
        """Where its centre stands in the body's frame at steering angle zero [m]."""
        c, s = cos(self.angle), sin(self.angle)
        along, across = self.trail
        return self.x + along * c - across * s, self.y + along * s + across * c


@final
@constant
@dataclass(frozen=True)
class Support:
    """A support without friction, such as a ball caster: it takes a load, and nothing else.

    Parameters
    ----------
    x, y : float
        Where it touches the ground, in the body's frame [m].
    """

    x: float
    y: float

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            object.__setattr__(self, name, scalar(f"{name} of a support", getattr(self, name)))


@final
@constant
@dataclass(frozen=True)
class GearTrain:
    """Wheels that turn together, as those of one side of a skid-steer base do: a chain or gears.

    Parameters
    ----------
    wheels : sequence of str
        Their names, two and more.
    ratios : sequence of floats, optional
        Rate of each, relative to each other; by default all turn alike.
    """

    wheels: tuple[str, ...]
    ratios: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        names = _names("GearTrain", self.wheels, least=2)
        ratios = finite("ratios", self.ratios)
        ratios = ratios if ratios.size else np.ones(len(names))
        if ratios.shape != (len(names),) or not ratios.all():
            raise InvalidArgument(
                f"ratios is {shown(self.ratios)}, expected {len(names)} numbers other than zero, "
                "one per wheel"
            )
        object.__setattr__(self, "wheels", names)
        object.__setattr__(self, "ratios", tuple(ratios.tolist()))


@final
@constant
@dataclass(frozen=True)
class Differential:
    """An open differential: one motor that turns at the mean rate of its wheels, with equal torques on them.

    Parameters
    ----------
    wheels : sequence of 2 str
        Their names.
    motor : Motor
        What drives it.
    name : str
        That of its input.
    """

    wheels: tuple[str, ...]
    motor: Motor = TORQUE
    name: str = "differential"

    def __post_init__(self) -> None:
        names = _names("Differential", self.wheels, least=2)
        if not isinstance(self.motor, Motor):
            raise InvalidArgument(f"motor of a Differential is {shown(self.motor)}, expected a Motor")
        object.__setattr__(self, "wheels", names)
        object.__setattr__(self, "name", text("name of a Differential", self.name))


@final
@constant
@dataclass(frozen=True)
class Ackermann:
    """Wheels that one steering angle turns so that all axles meet in one point.

    The angle is that of a wheel in the middle, at y = 0 and the same x.

    Parameters
    ----------
    wheels : sequence of str
        Their names; they are steered, and their centres lie on their pivots.
    axle : float
        x of the fixed axle, on whose line they meet [m].
    name : str
        That of the steering coordinate.
    """

    wheels: tuple[str, ...]
    axle: float = 0.0
    name: str = "steering"

    def __post_init__(self) -> None:
        object.__setattr__(self, "wheels", _names("Ackermann", self.wheels, least=1))
        object.__setattr__(self, "axle", scalar("axle", self.axle))
        object.__setattr__(self, "name", text("name of an Ackermann", self.name))


def _names(kind: str, wheels: Sequence[str], least: int) -> tuple[str, ...]:
    names = tuple(text(f"a wheel of {kind}", name) for name in sequence("wheels", wheels, "names of wheels"))
    if len(names) < least or len(set(names)) < len(names):
        raise InvalidArgument(
            f"wheels of {kind} is {shown(wheels)}, expected {least} different names or more"
        )
    return names


Coupling = GearTrain | Differential | Ackermann


class Axis(NamedTuple):
    """A steering coordinate.

    Attributes
    ----------
    name : str
        Of the coordinate.
    wheels : tuple of int
        Rows that it turns.
    ackermann : float or None
        x of the axle on whose line their axles meet [m]; None: it is the one wheel's own angle.
    driven : bool
        Whether an actuator turns it.
    limit : float
        Largest angle to either side [rad].
    """

    name: str
    wheels: tuple[int, ...]
    ackermann: float | None
    driven: bool
    limit: float


class Actuator(NamedTuple):
    """One of the inputs of a drive.

    Attributes
    ----------
    name : str
        Of the input.
    motor : Motor
        What it is; of a steering axis one without limits.
    column : tuple of floats
        What its torque is to each steering coordinate and then each wheel; its rate is the product with
        theirs.
    """

    name: str
    motor: Motor
    column: tuple[float, ...]


@runtime_checkable
class Rows(Protocol):
    """What the kinematics asks of a wheel table."""

    @property
    def wheels(self) -> tuple[Wheel, ...]:
        """One row each."""

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """What holds whatever the friction."""

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The steering coordinates."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the wheels."""

    def __len__(self) -> int: ...

    def __hash__(self) -> int: ...
