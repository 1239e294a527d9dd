"""What a wheel table is made of: wheels, supports, couplings; coordinates and inputs that follow."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, radians, sin
from typing import Any, NamedTuple, final

import attrs
import numpy as np
import pinocchio as pin

from pinmobile.arrays import finite, frozen, one_of, sequence, text
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import Number, by_value, child, declare, is_symbolic, number, option, part
from pinmobile.wheels._motors import Motor

FIXED, DRIVEN, FREE = "fixed", "driven", "free"
_STEERING = (FIXED, DRIVEN, FREE)
_LARGEST_ROLLER = 89.0  # degrees: nearer to 90, a turn of the wheel moves next to nothing along the rollers
TORQUE = Motor()  # a source of torque without limits


@final
@part
@by_value
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

    mu: float = number(default=0.8, lower=0, doc="coefficient of friction")
    across: float = number(default=0.02, lower=0, fixed=True, doc="coefficient of friction across rollers")
    rolling: float = number(default=0.01, lower=0, fixed=True, doc="rolling resistance per load")
    slip: float = number(default=0.0, lower=0, unit="m/(N s)", fixed=True, doc="slip velocity per force")


@attrs.frozen
class _Two(Number):
    """Declaration of two numbers that are kept as a tuple."""

    def checked(self, name: str, value: Any) -> Any:
        """Return a tuple of floats."""
        return tuple(super().checked(name, value).tolist())


def _checked_name(name: str, value: Any) -> str:
    checked = text(name, value)
    if not checked.strip() or set('/,":.') & set(checked):
        raise InvalidArgument(
            f"{name} is {shown(checked)}, expected a word without slash, comma, colon, dot and quotation mark"
        )
    return checked


@final
@part
@by_value
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

    name: str = option(check=_checked_name)
    x: float = number(unit="m", doc="place forward")
    y: float = number(unit="m", doc="place to the left")
    radius: float = number(unit="m", above=0, doc="radius")
    angle: float = number(default=0.0, unit="rad", fixed=True, doc="angle of the rolling direction")
    steering: str = option(default=FIXED, check=lambda name, value: one_of(name, value, _STEERING))
    trail: tuple[float, float] = declare(
        _Two("centre from the pivot, along and across", "m", shapes=((2,),), fixed=True), (0.0, 0.0)
    )
    roller: float | None = number(
        default=None, unit="rad", optional=True, fixed=True, doc="angle of the rollers' axes"
    )
    mass: float = number(default=0.0, unit="kg", lower=0, fixed=True, doc="mass")
    spin_inertia: float = number(default=0.0, unit="kg m^2", lower=0, doc="inertia about the axle")
    yaw_inertia: float = number(
        default=0.0, unit="kg m^2", lower=0, fixed=True, doc="inertia about the vertical through its centre"
    )
    motor: Motor | None = child(Motor, default=None, optional=True, expected="a Motor")
    friction: Friction = child(Friction, default=Friction(), expected="a Friction")
    steering_limit: float = number(
        default=np.inf, unit="rad", above=0, endless=True, fixed=True, doc="largest steering angle"
    )

    def check(self) -> None:
        """Raise `InvalidArgument` where rollers are across the rolling direction."""
        if self.roller is not None and not abs(self.roller) <= radians(_LARGEST_ROLLER):
            raise InvalidArgument(
                f"roller of wheel {self.name!r} is {self.roller:.6g} rad, expected less than a right angle "
                "from the rolling direction (up to 89 degrees): the wheel could not drive"
            )

    @property
    def centre(self) -> tuple[float, float]:
        """Where its centre stands in the body's frame at steering angle zero [m]."""
        c, s = cos(self.angle), sin(self.angle)
        along, across = self.trail
        return self.x + along * c - across * s, self.y + along * s + across * c

    @property
    def placement(self) -> pin.SE3:
        """Pose of its centre in the body's frame at steering angle zero, y along the axle."""
        return pin.SE3(pin.utils.rotate("z", self.angle), np.array([*self.centre, self.radius]))

    @property
    def inertia(self) -> pin.Inertia:
        """Its inertia about its centre, y along the axle."""
        moments = np.diag([self.yaw_inertia, self.spin_inertia, self.yaw_inertia])
        return pin.Inertia(self.mass, np.zeros(3), moments)


@final
@part
@by_value
class Support:
    """A support without friction, such as a ball caster: it takes a load, and nothing else.

    Parameters
    ----------
    x, y : float
        Where it touches the ground, in the body's frame [m].
    """

    x: float = number(unit="m", fixed=True, doc="place forward")
    y: float = number(unit="m", fixed=True, doc="place to the left")


def _names(least: int) -> Any:
    """Return the check of a field of names of wheels."""

    def check(name: str, value: Any) -> tuple[str, ...]:
        names = tuple(text(f"one of {name}", one) for one in sequence(name, value, "names of wheels"))
        if len(names) < least or len(set(names)) < len(names):
            raise InvalidArgument(f"{name} is {shown(value)}, expected {least} different names or more")
        return names

    return check


@final
@part
@by_value
class GearTrain:
    """Wheels that turn together, as those of one side of a skid-steer base do: a chain or gears.

    Parameters
    ----------
    wheels : sequence of str
        Their names, two and more.
    ratios : sequence of floats, optional
        Rate of each, relative to each other; by default all turn alike.
    """

    wheels: tuple[str, ...] = option(check=_names(2))
    ratios: tuple[float, ...] = option(
        default=attrs.Factory(lambda train: (1.0,) * len(train.wheels), takes_self=True),
        check=lambda name, value: tuple(np.ravel(finite(name, value)).tolist()),
    )

    def check(self) -> None:
        """Raise `InvalidArgument` where there is not one ratio per wheel."""
        if len(self.ratios) != len(self.wheels) or not all(self.ratios):
            raise InvalidArgument(
                f"ratios is {shown(self.ratios)}, expected {len(self.wheels)} numbers other than zero, "
                "one per wheel"
            )


@final
@part
@by_value
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

    wheels: tuple[str, ...] = option(check=_names(2))
    motor: Motor = child(Motor, default=TORQUE, expected="a Motor")
    name: str = option(default="differential", check=_checked_name)


@final
@part
@by_value
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

    wheels: tuple[str, ...] = option(check=_names(1))
    axle: float = number(default=0.0, unit="m", fixed=True, doc="place of the fixed axle, forward")
    name: str = option(default="steering", check=_checked_name)


def column(values: Sequence[Any]) -> Any:
    """Return numbers or symbols, such as one for each wheel, as an array, shape (k,)."""
    return np.stack(values) if any(map(is_symbolic, values)) else frozen(values)


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
    path : str
        Where the table has its motor, such as ``"wheels.left.motor"``; "" of a steering axis.
    """

    name: str
    motor: Motor
    column: tuple[float, ...]
    path: str = ""
